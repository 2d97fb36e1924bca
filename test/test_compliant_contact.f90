!> Springs and dampers at the contact against closed forms.
module test_compliant_contact
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, law_penalty, law_hunt_crossley, method_rk4, method_midpoint
  use castnet_state, only: state_t
  use castnet_error, only: error_t
  use castnet_shape, only: new_shape
  use castnet_stepper, only: work_t
  use castnet_compliant_contact, only: contact_rates
  use castnet_diagnostics, only: record_history, linear_momentum, angular_momentum
  use castnet_record, only: history_row_t
  use castnet_stable_step, only: spectrum_t, largest_stable_step
  use contact_cases, only: set_body
  use scenes, only: net_of, ready, fly
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_test_compliant_contact

  real(wp), parameter :: pi = 3.14159265358979323846_wp
  real(wp), parameter :: mass = 0.01_wp, threshold = 1.0e-3_wp, half = 0.5_wp

contains

  subroutine run_test_compliant_contact()
    call test_case('compliant: a node bounces on a spring as the closed form says', penalty_bounce)
    call test_case('compliant: Hunt and Crossley''s restitution', hunt_crossley_bounce)
    call test_case('compliant: friction decelerates by mu g', friction_decelerates)
    call test_case('compliant: momentum and energy with a free, spinning target', free_target)
    call test_case('compliant: the stable step of a node on its spring', stable_step)
  end subroutine run_test_compliant_contact

  !> A node at the layer's upper side above a box of 1 m, and another far away on a slack cable.
  subroutine node_above(law, stiffness, damping, speed, target_mass, model, state)
    integer, intent(in) :: law
    real(wp), intent(in) :: stiffness, damping, speed, target_mass
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(error_t), allocatable :: error
    real(wp) :: position(2, 3), velocity(2, 3)
    position = 0.0_wp
    velocity = 0.0_wp
    position(1, 3) = half + threshold
    position(2, 1) = 10.0_wp
    velocity(1, 3) = -speed
    call net_of([mass, mass], [.false., .false.], reshape([1, 2], [2, 1]), [1.0_wp], [100.0_wp], [0.0_wp], .true., &
                position, velocity, model, state)
    model%net%is_bullet = [.false., .false.]
    allocate (model%target, model%contact, state%target)
    call new_shape(model%target%shape, 'box', [2.0_wp*half, 2.0_wp*half, 2.0_wp*half], error)
    call set_body(model, target_mass, [0.1_wp, 0.2_wp, 0.25_wp])
    model%contact%law = law
    model%contact%threshold = threshold
    model%contact%stiffness = stiffness
    model%contact%damping = damping
  end subroutine node_above

  !> Total of energies and what the contact took [J].
  real(wp) function total_energy(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(history_row_t) :: row
    row = record_history(model, state)
    total_energy = row%kinetic_net + row%kinetic_target + row%elastic + row%contact_loss
  end function total_energy

  !> Half a period pi sqrt(m/k) without damping; with it, and a force that only pushes,
  !> restitution exp(-z (pi - 2 asin z)/sqrt(1 - z^2)), z = c/(2 sqrt(k m)) (the same
  !> quantity as the clamped rebound of a snapped cable).
  subroutine penalty_bounce()
    real(wp), parameter :: stiffness = 1000.0_wp, speed = 1.0_wp, z = 0.2_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: period, h, energy, leave, off
    integer :: i, method
    character(len=90) :: words
    period = pi*sqrt(mass/stiffness)
    h = period/2000.5_wp
    call node_above(law_penalty, stiffness, 0.0_wp, speed, 0.0_wp, model, state)
    call ready(model, state, work, method_rk4, h)
    energy = total_energy(model, state)
    off = 0.0_wp
    leave = -1.0_wp
    do i = 1, 2020
      call fly(model, state, work, 1)
      off = max(off, abs(total_energy(model, state)/energy - 1.0_wp))
      if (leave < 0.0_wp .and. state%node_position(1, 3) > half + threshold) &
        leave = state%time - (state%node_position(1, 3) - half - threshold)/state%node_velocity(1, 3)
    end do
    call expect_close(leave, period, 'half a period', rtol=1.0e-6_wp)
    call expect_close(state%node_velocity(1, 3), speed, 'leaves as fast as it came', rtol=1.0e-6_wp)
    call expect(off <= 1.0e-6_wp, 'energy of node and spring stays')
    call expect_close(state%first_contact, h, 'first contact is seen at the first step', rtol=1.0e-12_wp)
    call expect_close(state%tally%impulse_sum, 2.0_wp*mass*speed, 'the impulses counted are the change of momentum', rtol=1.0e-5_wp)
    call expect_close(state%tally%deepest_penetration, speed*sqrt(mass/stiffness) - threshold, 'depth', rtol=1.0e-5_wp)
    do method = method_rk4, method_midpoint
      call node_above(law_penalty, stiffness, 2.0_wp*z*sqrt(stiffness*mass), speed, 0.0_wp, model, state)
      call ready(model, state, work, method, h)
      call fly(model, state, work, 2100)
      off = state%node_velocity(1, 3)/speed/exp(-z*(pi - 2.0_wp*asin(z))/sqrt(1.0_wp - z*z)) - 1.0_wp
      ! The damper's force jumps as the node enters and leaves: some part of c v h is missed.
      call expect(abs(off) <= 2.0_wp*z*sqrt(stiffness/mass)*h, 'damped restitution')
      call expect_close(total_energy(model, state), 0.5_wp*mass*speed**2, 'damping''s share is in the ledger', rtol=2.0e-3_wp)
      write (words, '(a,i0,a,es9.2)') 'method ', method, ': relative error of the damped restitution ', off
      call note(words)
    end do
  end subroutine penalty_bounce

  !> m v dv/dp = -k p^(3/2) (1 + c v): what v loses going down, G(v0), it regains coming up,
  !> G(-v1), with G(v) = v/c - log(1 + c v)/c^2.
  subroutine hunt_crossley_bounce()
    real(wp), parameter :: stiffness = 2.0e4_wp, speed = 1.0_wp, c = 0.4_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: low, high, v
    integer :: i
    low = 0.0_wp
    high = speed
    do i = 1, 60
      v = 0.5_wp*(low + high)
      if (gain(-v) < gain(speed)) then
        low = v
      else
        high = v
      end if
    end do
    call node_above(law_hunt_crossley, stiffness, c, speed, 0.0_wp, model, state)
    call ready(model, state, work, method_rk4, 1.0e-5_wp)
    call fly(model, state, work, 3000)
    call expect(state%node_position(1, 3) > half + threshold, 'the node has left')
    call expect_close(state%node_velocity(1, 3), v, 'restitution', rtol=1.0e-6_wp)
    call expect_close(total_energy(model, state), 0.5_wp*mass*speed**2, 'energy and loss', rtol=1.0e-6_wp)
  contains
    real(wp) function gain(u)
      real(wp), intent(in) :: u
      gain = u/c - log(1.0_wp + c*u)/c**2
    end function gain
  end subroutine hunt_crossley_bounce

  !> A node that lies on the box under gravity and slides.
  subroutine friction_decelerates()
    real(wp), parameter :: stiffness = 1.0e4_wp, g = 9.80665_wp, mu = 0.3_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    call node_above(law_penalty, stiffness, 0.0_wp, 0.0_wp, 0.0_wp, model, state)
    model%contact%friction = mu
    model%gravity = [0.0_wp, 0.0_wp, -g]
    state%node_position(1, 3) = half + threshold - mass*g/stiffness
    state%node_velocity(1, 1) = 0.3_wp
    call ready(model, state, work, method_rk4, 1.0e-4_wp)
    call fly(model, state, work, 500)
    call expect_close(0.3_wp - state%node_velocity(1, 1), mu*g*state%time, 'speed lost', rtol=5.0e-4_wp)
    call fly(model, state, work, 3000)
    call expect(abs(state%node_velocity(1, 1)) < 1.0e-6_wp, 'the node comes to rest and does not turn round')
    call expect_close(state%node_position(1, 3), half + threshold - mass*g/stiffness, 'it neither sinks nor lifts', atol=1.0e-9_wp)
  end subroutine friction_decelerates

  !> Off the centre of a spinning box of 0.05 kg, sliding.
  subroutine free_target()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: p(3), l(3), energy
    integer :: law
    character(len=90) :: words
    do law = law_penalty, law_hunt_crossley
      call node_above(law, merge(1.0e3_wp, 2.0e4_wp, law == law_penalty), merge(0.5_wp, 0.3_wp, law == law_penalty), 1.0_wp, &
                      0.05_wp, model, state)
      model%contact%friction = 0.4_wp
      state%node_position(1, 1:2) = [0.2_wp, -0.1_wp]
      state%node_velocity(1, 1:2) = [0.7_wp, 0.2_wp]
      state%target%velocity = [0.1_wp, -0.05_wp, 0.02_wp]
      state%target%angular_velocity = [0.5_wp, -0.3_wp, 0.8_wp]
      p = linear_momentum(model, state)
      l = angular_momentum(model, state)
      energy = total_energy(model, state)
      call ready(model, state, work, method_rk4, 1.0e-5_wp)
      call fly(model, state, work, 3000)
      call expect(state%tally%contacts > 100, 'they meet')
      call expect(state%ledger%contact_loss > 0.0_wp, 'damping and friction take energy')
      call expect_close(linear_momentum(model, state), p, 'momentum', atol=1.0e-15_wp)
      call expect_close(angular_momentum(model, state), l, 'angular momentum', atol=1.0e-10_wp)
      call expect_close(total_energy(model, state), energy, 'energy', rtol=1.0e-6_wp)
      write (words, '(a,i0,2(a,es9.2))') 'law ', law, ': energy off by ', total_energy(model, state)/energy - 1.0_wp, &
        ', angular momentum by ', maxval(abs(angular_momentum(model, state) - l))
      call note(words)
    end do
  end subroutine free_target

  !> Without a body to move the bound is the node's own frequency; below the limit a node
  !> pressed on its spring stays, above it flies off.
  subroutine stable_step()
    real(wp), parameter :: stiffness = 1.0e4_wp, z = 0.05_wp, g = 9.80665_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(spectrum_t) :: spectrum
    real(wp) :: frequency2, rate, limit, rest
    integer :: i
    call node_above(law_penalty, stiffness, 2.0_wp*z*sqrt(stiffness*mass), 0.0_wp, 0.0_wp, model, state)
    call contact_rates(model, 1.0_wp, frequency2, rate)
    call expect_close(frequency2, stiffness/mass, 'frequency', rtol=1.0e-14_wp)
    call expect_close(rate, 2.0_wp*z*sqrt(stiffness/mass), 'damping rate', rtol=1.0e-14_wp)
    spectrum%highest_frequency = sqrt(frequency2)
    spectrum%largest_damping_rate = rate
    limit = largest_stable_step(method_rk4, spectrum)
    rest = half + threshold - mass*g/stiffness
    do i = 1, 2
      call node_above(law_penalty, stiffness, 2.0_wp*z*sqrt(stiffness*mass), 0.0_wp, 0.0_wp, model, state)
      model%gravity = [0.0_wp, 0.0_wp, -g]
      state%node_position(1, 3) = rest + 1.0e-7_wp
      call ready(model, state, work, method_rk4, merge(0.97_wp, 1.2_wp, i == 1)*limit)
      call fly(model, state, work, 300)
      if (i == 1) call expect(abs(state%node_position(1, 3) - rest) < 1.0e-7_wp, 'below the limit it settles')
      if (i == 2) call expect(abs(state%node_position(1, 3) - rest) > 1.0e-6_wp, 'above the limit it does not')
    end do
  end subroutine stable_step

end module test_compliant_contact
