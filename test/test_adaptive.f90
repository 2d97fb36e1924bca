!> The divided step: it is rk4 where nothing has to be divided, its error follows the
!> tolerance, a snap is found, and its state goes on to the bit.
module test_adaptive
  use, intrinsic :: iso_fortran_env, only: int64
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_error, only: error_t, exit_numerical
  use castnet_integrator, only: new_flow_work
  use castnet_model, only: model_t, method_rk4, method_adaptive
  use castnet_model_builder, only: file_net_t
  use castnet_scene, only: scene_t
  use castnet_scene_file, only: read_scene_text
  use castnet_shape, only: new_shape
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, frame_taken
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, advance
  use castnet_text, only: text_t
  use scenes, only: chain, two_masses, add_spinning_body, ready, fly, mechanical_energy, state_hash, words
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_adaptive

  character(len=*), parameter :: nl = new_line('a')
  character(len=*), parameter :: capture = &
    "&net squares = 10, 10, mesh_length = 0.07, cable_diameter = 1e-3, edge_cable_diameter = 3e-3 /"//nl// &
    "&bullets mass = 0.03, speed = 1.8 /"//nl// &
    "&target shape = 'box', dimensions = 0.1, 0.1, 0.3, mass = 3.5, position = 0.1, 0, 0, "// &
    "angular_velocity = 0, 1.5, 0 /"//nl//"&contact threshold = 2e-3 /"//nl// &
    "&closing winch_speed = 2, locked_length = 0.1, max_tension = 1, trigger = 'time', delay = 0.2 /"//nl// &
    "&time end_time = 0.3, step = 1e-4, method = 'adaptive', tolerance = 1e-8 /"//nl

contains

  subroutine run_test_adaptive()
    call test_case('adaptive: with a loose tolerance it is rk4 to the bit', loose)
    call test_case('adaptive: the error of a vibration follows the tolerance, the cost its fourth root', proportional)
    call test_case('adaptive: the target''s turning is held to the tolerance', spinning)
    call test_case('adaptive: a damped snap rebounds by the closed form, however long the step', snap)
    call test_case('adaptive: the ledger closes to the tolerance', ledger)
    call test_case('adaptive: stopped and gone on, and on threads, a capture has the same bits', restart)
    call test_case('adaptive: a tolerance that no part meets is an error', impossible)
  end subroutine run_test_adaptive

  !> A mass on two taut cables between walls, displaced by a; x = a cos(w t), w^2 = 2 k/m.
  subroutine vibration(damping, model, state)
    real(wp), intent(in) :: damping
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    call chain([0.0_wp, 0.5_wp, 1.0_wp], [1.0_wp, 0.0_wp, 0.0_wp], [0.1_wp, 0.1_wp, 0.1_wp], [.true., .false., .true.], &
               40.0_wp, 0.4_wp, damping, model, state)
    state%node_position(2, 1) = state%node_position(2, 1) + amplitude()
  end subroutine vibration

  pure real(wp) function amplitude()
    amplitude = 0.05_wp
  end function amplitude

  pure real(wp) function omega()
    omega = sqrt(2.0_wp*40.0_wp/0.1_wp)
  end function omega

  subroutine loose()
    type(model_t) :: model
    type(state_t) :: a, b
    type(work_t) :: work
    call vibration(0.5_wp, model, a)
    b = a
    call ready(model, a, work, method_rk4, 0.01_wp)
    call fly(model, a, work, 50)
    model%tolerance = 1.0_wp
    call ready(model, b, work, method_adaptive, 0.01_wp)
    call fly(model, b, work, 50)
    call expect(state_hash(a) == state_hash(b), 'the same bits')
    call expect(a%force_evaluations == b%force_evaluations, 'at the same cost')
  end subroutine loose

  !> One step spans a third of the period: all of the accuracy comes from dividing it.
  subroutine proportional()
    real(wp), parameter :: tolerance(4) = [1.0e-4_wp, 1.0e-6_wp, 1.0e-8_wp, 1.0e-10_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: h, error(size(tolerance)), cost(size(tolerance)), slope
    integer :: i
    h = 2.0_wp/omega()
    do i = 1, size(tolerance)
      call vibration(0.0_wp, model, state)
      model%tolerance = tolerance(i)
      call ready(model, state, work, method_adaptive, h)
      call fly(model, state, work, 20)
      error(i) = abs(state%node_position(2, 1) - 0.5_wp - amplitude()*cos(omega()*state%time))
      cost(i) = real(state%force_evaluations, wp)
      call expect_close(state%time, 20*h, 'the time is the step''s', rtol=1.0e-15_wp)
      ! h**4 a w**4/72 is what one part may be off by.
      call expect(state%substep <= 3.0_wp*(72.0_wp*tolerance(i)*0.4_wp/amplitude())**0.25_wp/omega(), 'parts short enough')
      call expect(state%substep >= (72.0_wp*tolerance(i)*0.4_wp/amplitude())**0.25_wp/omega()/3.0_wp, 'and no shorter')
    end do
    do i = 2, size(tolerance)
      slope = log(error(i)/error(i - 1))/log(tolerance(i)/tolerance(i - 1))
      call expect(slope > 0.75_wp .and. slope < 1.25_wp, 'the error follows the tolerance: '//words(slope))
      slope = log(cost(i)/cost(i - 1))/log(tolerance(i)/tolerance(i - 1))
      call expect_close(slope, -0.25_wp, 'the cost its fourth root', atol=0.05_wp)
    end do
    call note('adaptive: errors of a vibration at tolerances 1e-4, 1e-6, 1e-8, 1e-10: '//words(error(1))//' '// &
              words(error(2))//' '//words(error(3))//' '//words(error(4)))
  end subroutine proportional

  !> V1's torque-free top: its rates at t = 10 are known.
  subroutine spinning()
    real(wp), parameter :: known(3) = [-0.5780626277323345_wp, -0.1607594427061393_wp, 0.9956834171530647_wp]
    real(wp), parameter :: tolerance(3) = [1.0e-5_wp, 1.0e-8_wp, 1.0e-11_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: refused
    real(wp) :: error(3), inertia(3, 3)
    integer :: i
    inertia = 0.0_wp
    inertia(1, 1) = 1.0_wp; inertia(2, 2) = 2.0_wp; inertia(3, 3) = 3.0_wp
    do i = 1, 3
      if (allocated(model%target)) deallocate (model%target, state%target)
      call add_spinning_body(inertia, [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [0.6_wp, 0.0_wp, 1.0_wp], model, state)
      call new_shape(model%target%shape, 'sphere', [2.0_wp, 0.0_wp, 0.0_wp], refused)
      state%substep = 0.0_wp
      state%step = 0
      model%tolerance = tolerance(i)
      call ready(model, state, work, method_adaptive, 2.5_wp)
      call fly(model, state, work, 4)
      error(i) = sqrt(sum((state%target%angular_velocity - known)**2))
      call expect(error(i) <= 300.0_wp*tolerance(i), 'the rate is right: '//words(error(i)))
    end do
    call expect(error(3) < 1.0e-4_wp*error(1), 'and better with a smaller tolerance')
  end subroutine spinning

  !> V6 clamped: exp(-z (pi - 2 asin z)/sqrt(1 - z^2)). A force of the wrong side, c v, over a
  !> part p of a step changes the speed by c v p/mu, and p can be at most what makes
  !> p^2 c v/(6 mu) the tolerance; the step itself spans a tenth of the taut phase.
  subroutine snap()
    real(wp), parameter :: mass(2) = [0.03_wp, 0.011_wp], k = 4000.0_wp, l0 = 0.1_wp, v = 1.8_wp, z = 0.106_wp
    real(wp), parameter :: tolerance(3) = [1.0e-5_wp, 1.0e-7_wp, 1.0e-9_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: mu, c, h, known, ratio, worst, part
    integer :: i, j
    mu = mass(1)*mass(2)/(mass(1) + mass(2))
    c = 2.0_wp*z*sqrt(k*mu)
    h = 0.1_wp*pi/sqrt(k/mu)
    known = exp(-z*(pi - 2.0_wp*asin(z))/sqrt(1.0_wp - z*z))
    do i = 1, size(tolerance)
      worst = 0.0_wp
      do j = 0, 7
        call two_masses(mass, k, l0, c, .true., (3.0_wp + j/8.0_wp)*v*h, v, model, state)
        model%tolerance = tolerance(i)
        call ready(model, state, work, method_adaptive, h)
        call fly(model, state, work, 25)
        ratio = (state%node_velocity(1, 1) - state%node_velocity(2, 1))/v
        worst = max(worst, abs(ratio - known))
      end do
      part = sqrt(6.0_wp*tolerance(i)*l0*mu/(c*v))
      call expect(worst <= 2.0_wp*c*part/mu, 'rebound: '//words(worst)//' of '//words(2.0_wp*c*part/mu))
      call note('adaptive: rebound of a snap off by '//words(worst)//' at tolerance '//words(tolerance(i)))
    end do
  end subroutine snap

  !> Energy and what the damping took, over a vibration: the quadrature is rk4's.
  subroutine ledger()
    real(wp), parameter :: tolerance(3) = [1.0e-4_wp, 1.0e-7_wp, 1.0e-10_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: begun, off(3)
    integer :: i
    do i = 1, 3
      call vibration(0.4_wp, model, state)
      begun = mechanical_energy(model, state)
      model%tolerance = tolerance(i)
      call ready(model, state, work, method_adaptive, 2.0_wp/omega())
      call fly(model, state, work, 30)
      off(i) = abs((mechanical_energy(model, state) + state%ledger%dissipated)/begun - 1.0_wp)
      call expect(off(i) <= 30.0_wp*tolerance(i), 'closes: '//words(off(i)))
    end do
    call expect(off(3) < 1.0e-4_wp*off(1), 'better with a smaller tolerance')
  end subroutine ledger

  subroutine restart()
    type(simulation_t) :: sim
    type(state_t) :: kept
    integer(int64) :: whole, again, threaded
    call fly_capture(sim, 1)
    whole = state_hash(sim%state)
    call expect(sim%state%substep > 0.0_wp, 'a part is kept')
    call expect(sim%state%force_evaluations > 5*sim%state%step, 'steps were divided')
    call expect(sim%state%first_contact > 0.0_wp, 'they met')
    call fly_capture(sim, 1, stop_at=1371, kept=kept)
    call fly_capture(sim, 1, resumed=kept)
    again = state_hash(sim%state)
    call expect(again == whole, 'the same bits after a restart')
    call fly_capture(sim, 3)
    threaded = state_hash(sim%state)
    call expect(threaded == whole, 'the same bits on three threads')
  end subroutine restart

  subroutine fly_capture(sim, n_thread, stop_at, kept, resumed)
    type(simulation_t), intent(out) :: sim
    integer, intent(in) :: n_thread
    integer, intent(in), optional :: stop_at
    type(state_t), intent(out), optional :: kept
    type(state_t), intent(in), optional :: resumed
    type(scene_t) :: scene
    type(file_net_t), allocatable :: none
    type(error_t), allocatable :: error
    type(text_t) :: no_overrides(0)
    type(due_t) :: due
    character(len=:), allocatable :: warnings
    call read_scene_text(capture, 'capture.nml', no_overrides, scene, warnings, error)
    if (.not. allocated(error)) then
      if (present(resumed)) then
        call start(sim, scene, 1, none, error, resumed)
      else
        call start(sim, scene, 1, none, error)
      end if
    end if
    if (allocated(error)) then
      call expect(.false., 'a scene that starts: '//error%message)
      return
    end if
    call new_flow_work(sim%work%flow, sim%model, n_thread)
    do while (.not. is_finished(sim))
      if (present(stop_at)) then
        if (sim%state%step >= stop_at) exit
        call run_to_next(sim, due, error, int(stop_at - sim%state%step))
      else
        call run_to_next(sim, due, error)
      end if
      if (allocated(error)) then
        call expect(.false., 'a flight without an error: '//error%message)
        return
      end if
      if (due%frame) call frame_taken(sim)
    end do
    if (present(kept)) kept = sim%state
  end subroutine fly_capture

  subroutine impossible()
    type(model_t) :: model
    type(state_t) :: state, before
    type(work_t) :: work
    type(error_t), allocatable :: error
    call vibration(0.5_wp, model, state)
    before = state
    model%tolerance = 1.0e-30_wp
    call ready(model, state, work, method_adaptive, 0.01_wp)
    call advance(model, state, work, error)
    call expect(allocated(error), 'an error')
    if (.not. allocated(error)) return
    call expect_equal(error%code, exit_numerical, 'exit code')
    call expect(index(error%message, 'time/tolerance') > 0, 'the key is named')
    call expect(state_hash(before) == state_hash(state), 'the state is that of the last good step')
  end subroutine impossible

end module test_adaptive
