!> Nodes that would cross thin things between two steps.
module test_fast_nodes
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_model, only: model_t, method_rk4, method_midpoint
  use castnet_state, only: state_t
  use castnet_shape, only: new_shape
  use castnet_stepper, only: work_t
  use castnet_diagnostics, only: linear_momentum, angular_momentum
  use contact_cases, only: set_body, kinetic_energy, centre_of_mass
  use scenes, only: net_of, ready, fly
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_test_fast_nodes

  real(wp), parameter :: thickness = 5.0e-4_wp, threshold = 1.0e-3_wp, top = 0.5_wp*thickness + threshold

contains

  subroutine run_test_fast_nodes()
    call test_case('fast nodes: a panel of 0.5 mm is not crossed, whatever the step', panel_holds)
    call test_case('fast nodes: order of a bouncing node''s trajectory', order_of_a_bounce)
    call test_case('fast nodes: momentum, energy and centre of mass with a free panel', free_panel)
    call test_case('fast nodes: a panel that sweeps over a node at rest', turning_panel)
  end subroutine run_test_fast_nodes

  !> A node above a panel in the plane z = 0, and another far away on a slack cable.
  subroutine node_over_panel(height, speed, mass, model, state)
    real(wp), intent(in) :: height, speed, mass   !! of the node [m], [m/s]; of the panel, 0: fixed [kg]
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(error_t), allocatable :: error
    real(wp) :: position(2, 3), velocity(2, 3)
    position = 0.0_wp
    velocity = 0.0_wp
    position(1, :) = [0.1_wp, 0.2_wp, height]
    position(2, :) = [10.0_wp, 0.0_wp, 5.0_wp]
    velocity(1, 3) = -speed
    call net_of([0.01_wp, 0.01_wp], [.false., .false.], reshape([1, 2], [2, 1]), [1.0_wp], [100.0_wp], [0.0_wp], .true., &
                position, velocity, model, state)
    model%net%is_bullet = [.false., .false.]
    allocate (model%target, model%contact, state%target)
    call new_shape(model%target%shape, 'box', [1.0_wp, 1.0_wp, thickness], error)
    call set_body(model, mass, [0.1_wp, 0.1_wp, 0.2_wp])
    model%contact%threshold = threshold
  end subroutine node_over_panel

  !> Ways of 0.1 to 50 mm in a step at 1 m/s, from many heights: back with the speed it had.
  subroutine panel_holds()
    real(wp), parameter :: steps(7) = [1.0e-4_wp, 9.0e-4_wp, 1.1e-3_wp, 1.7e-3_wp, 2.6e-3_wp, 1.0e-2_wp, 5.0e-2_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: height
    integer :: i, k, method, kept
    do method = method_rk4, method_midpoint
      do k = 1, size(steps)
        kept = 0
        do i = 1, 20
          height = 2.0e-3_wp + (0.03_wp + 0.0137_wp*i)*1.0e-2_wp
          call node_over_panel(height, 1.0_wp, 0.0_wp, model, state)
          call ready(model, state, work, method, steps(k))
          call fly(model, state, work, 3 + ceiling(0.02_wp/steps(k)))
          if (abs(state%node_velocity(1, 3) - 1.0_wp) < 1.0e-12_wp .and. state%node_position(1, 3) > 0.0_wp) kept = kept + 1
        end do
        call expect(kept == 20, 'every node comes back')
      end do
    end do
  end subroutine panel_holds

  !> Under gravity; the exact flight is reflected at the layer's upper side. A node that is
  !> slow in terms of the threshold bounces from where it is found, one that would cross
  !> from where it entered: but both with the velocity of the step's end, to which gravity has
  !> added since. So the order is one, with impulses at the end of steps.
  subroutine order_of_a_bounce()
    real(wp), parameter :: g = 9.80665_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: height, speed, finish, touch, fall, exact, error(3)
    integer :: regime, k, i, n, method
    character(len=120) :: words
    do method = method_rk4, method_midpoint
      do regime = 1, 2
        error = 0.0_wp
        do k = 1, 3
          ! Mean over heights: where in a step the node touches is chance.
          do i = 1, 40
            speed = merge(0.2_wp, 100.0_wp, regime == 1)
            height = top + 0.05_wp*speed + (i - 0.5_wp)/40.0_wp*speed*4.0e-3_wp
            call node_over_panel(height, speed, 0.0_wp, model, state)
            model%gravity = [0.0_wp, 0.0_wp, -g]
            finish = 0.1_wp
            n = 25*2**k
            call ready(model, state, work, method, finish/n)
            call fly(model, state, work, n)
            touch = (sqrt(speed**2 + 2.0_wp*g*(height - top)) - speed)/g
            fall = speed + g*touch
            exact = top + fall*(finish - touch) - 0.5_wp*g*(finish - touch)**2
            error(k) = error(k) + abs(state%node_position(1, 3) - exact)/40.0_wp
          end do
        end do
        write (words, '(a,i0,a,f6.1,a,3es9.2,a,2f6.2)') 'method ', method, ', ', speed, ' m/s: error of the position [m] ', error, &
          ', order ', log(error(1)/error(2))/log(2.0_wp), log(error(2)/error(3))/log(2.0_wp)
        call note(words)
        call expect(error(1) > 1.5_wp*error(2) .and. error(2) > 1.5_wp*error(3), 'first order')
      end do
    end do
  end subroutine order_of_a_bounce

  !> 50 m/s against a free panel of 0.3 kg, off its centre.
  subroutine free_panel()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: p(3), l(3), c(3), energy
    integer :: method
    do method = method_rk4, method_midpoint
      call node_over_panel(0.123_wp, 50.0_wp, 0.3_wp, model, state)
      state%target%velocity = [0.0_wp, 0.0_wp, 2.0_wp]
      p = linear_momentum(model, state)
      l = angular_momentum(model, state)
      c = centre_of_mass(model, state)
      energy = kinetic_energy(model, state)
      call ready(model, state, work, method, 1.0e-3_wp)
      call fly(model, state, work, 10)
      call expect(state%tally%contacts == 1, 'one contact')
      call expect_close(linear_momentum(model, state), p, 'momentum', atol=1.0e-14_wp)
      call expect_close(angular_momentum(model, state), l, 'angular momentum', atol=1.0e-7_wp)
      call expect_close(kinetic_energy(model, state), energy, 'energy', rtol=1.0e-8_wp)
      call expect_close(centre_of_mass(model, state), c + p/(0.3_wp + 0.02_wp)*state%time, 'centre of mass', atol=1.0e-13_wp)
    end do
  end subroutine free_panel

  !> The panel's rim passes a node at rest by 20 mm a step: the node is hit all the same.
  subroutine turning_panel()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    integer :: method
    do method = method_rk4, method_midpoint
      call node_over_panel(0.05_wp, 0.0_wp, 1.0e3_wp, model, state)
      call set_body(model, 1.0e3_wp, [1.0e2_wp, 1.0e2_wp, 2.0e2_wp])
      state%node_position(1, :) = [0.4_wp, 0.1_wp, 0.053_wp]
      state%target%angular_velocity = [0.0_wp, -5.0_wp, 0.0_wp]
      call ready(model, state, work, method, 1.0e-2_wp)
      call fly(model, state, work, 6)
      call expect(state%tally%contacts == 1, 'it is hit')
      call expect(state%node_velocity(1, 3) > 3.0_wp, 'and thrown ahead of the rim')
    end do
  end subroutine turning_panel

end module test_fast_nodes
