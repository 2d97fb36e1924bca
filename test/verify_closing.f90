!> The closing thread against closed forms: two bullets on one thread in free space, the
!> capstan formula, and the balance of work and energy on a net.
module verify_closing
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_closing_thread, only: add_thread_force, update_closing, thread_length
  use castnet_diagnostics, only: net_kinetic_energy, elastic_energy, linear_momentum, angular_momentum
  use castnet_error, only: error_t, exit_input
  use castnet_integrator, only: midpoint_begin
  use castnet_model, only: model_t, closing_t, method_rk4, method_midpoint, trigger_time, trigger_contact, &
                           trigger_passed_target
  use castnet_model_builder, only: file_net_t
  use castnet_net_builder, only: finish_net
  use castnet_scene, only: scene_t
  use castnet_setup, only: set_up, step_report_t
  use castnet_state, only: state_t, closing_state_t
  use castnet_stepper, only: work_t, new_work, advance
  use scenes, only: closing_rocket, fly
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_verify_closing

  real(wp), parameter :: mass(2) = [1.0_wp, 3.0_wp]  !! of the two bullets on one thread [kg]
  real(wp), parameter :: reduced = mass(1)*mass(2)/(mass(1) + mass(2))

contains

  subroutine run_verify_closing()
    call test_case('closing: a stalled winch pulls two bullets together on parabolas', constant_tension)
    call test_case('closing: a held thread is a spring while taut, nothing when slack', spring_regime)
    call test_case('closing: a damped thread decays as the closed form, order 4 in the step', damped_regime)
    call test_case('closing: a steady winch against the closed form, order 1 in the step', steady_winch)
    call test_case('closing: a locked thread holds, gives the energy back and is never paid out', lock_holds)
    call test_case('closing: overloaded, a locked thread slips at the stall tension and comes back', lock_slips)
    call test_case('closing: ring friction follows the capstan formula from both ends', capstan)
    call test_case('closing: forces and moments balance, their power is -T dL/dt', force_balance)
    call test_case('closing: path ''bullets'' runs straight', straight_path)
    call test_case('closing: the ratchet never lengthens, tension stays in bounds, momentum is kept', ratchet)
    call test_case('closing: winch work is the change of energy, order 4 (rk4) and 2 (midpoint)', work_order)
    call test_case('closing: with damped cables the balance closes to the order of the ledger', work_with_damping)
    call test_case('closing: triggers by contact, time and passing the target, and the delay', triggers)
    call test_case('closing: the guard knows the thread''s limit', guard)
    call test_case('closing: under the limit energy less winch work never rises', energy_by_step)
    call test_case('closing: a run that goes on from a copy of its state is the same to the bit', resumed)
    call test_case('closing: a scene without it has no latches, no scratch, no work', absent)
  end subroutine run_verify_closing

  ! ---- Two bullets on one thread in free space -------------------------------------

  !> Bullets at x = 0 and x = gap joined by one pulling thread, approaching at `speed`,
  !> with the centre of mass at rest.
  subroutine two_bullets(gap, speed, rest_length, step, model, state, work)
    real(wp), intent(in) :: gap, speed, rest_length, step
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(work_t), intent(out) :: work
    allocate (model%net, model%closing, state%closing)
    model%net%n_node = 2
    allocate (model%net%node_mass(2), source=mass)
    allocate (model%net%fixed(2), source=.false.)
    allocate (model%net%cable_nodes(2, 0), model%net%natural_length(0), model%net%axial_stiffness(0), model%net%damping(0))
    call finish_net(model%net)
    model%closing%trigger = trigger_time
    model%closing%path_start = [1, 3]
    model%closing%path_node = [1, 2]
    model%closing%stiffness = 30.0_wp
    model%closing%max_tension = 1.0e12_wp
    model%method = method_rk4
    model%step = step
    allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3), source=0.0_wp)
    state%node_position(2, 1) = gap
    state%node_velocity(1, 1) = speed*mass(2)/sum(mass)
    state%node_velocity(2, 1) = -speed*mass(1)/sum(mass)
    state%closing%triggered = .true.
    state%closing%pulling = .true.
    state%closing%rest_length = rest_length
    call new_work(work, model, 1)
  end subroutine two_bullets

  !> T = T_w throughout: x = x0 + T t^2/(2 m), and the winch does T (L0 - L).
  subroutine constant_tension()
    real(wp), parameter :: pull = 5.0_wp, gap = 10.0_wp, t = 1.5_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    integer :: m
    do m = 1, 2
      call two_bullets(gap, 0.0_wp, 0.1_wp, 0.01_wp, model, state, work)
      model%closing%max_tension = pull
      model%closing%winch_speed = 20.0_wp
      if (m == 2) then
        model%method = method_midpoint
        call midpoint_begin(state)
        call new_work(work, model, 1)
      end if
      call fly(model, state, work, 150)
      call expect_close(state%node_position(1, 1), 0.5_wp*pull/mass(1)*t**2, 'first bullet', rtol=1.0e-12_wp)
      call expect_close(state%node_position(2, 1), gap - 0.5_wp*pull/mass(2)*t**2, 'second bullet', rtol=1.0e-12_wp)
      call expect_close(state%ledger%winch_work, 0.5_wp*pull**2*t**2*(1.0_wp/mass(1) + 1.0_wp/mass(2)), 'winch work', &
                        rtol=1.0e-12_wp)
      call expect_close(state%closing%rest_length(1), 0.1_wp, 'a stalled winch does not wind', atol=0.0_wp)
    end do
  end subroutine constant_tension

  !> L - L_r = A cos(w t), w^2 = k/mu, until slack at a quarter period; then L' = -A w.
  subroutine spring_regime()
    real(wp), parameter :: gap = 4.0_wp, rest = 3.0_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, t, seen, error(2)
    integer :: n, k
    w = sqrt(30.0_wp/reduced)
    do k = 1, 2
      n = 20*2**(k - 1)
      t = 0.9_wp*0.5_wp*pi/w
      call two_bullets(gap, 0.0_wp, rest, t/n, model, state, work)
      call fly(model, state, work, n)
      seen = state%node_position(2, 1) - state%node_position(1, 1) - rest
      error(k) = abs(seen - (gap - rest)*cos(w*t))
      call expect_close(state%ledger%winch_work, 0.5_wp*30.0_wp*((gap - rest)**2 - seen**2), 'winch work', rtol=3.0e-6_wp)
    end do
    call expect(error(1) < 3.0e-6_wp, 'spring to 3e-6 m with 20 steps')
    call expect(error(1)/error(2) > 12.0_wp, 'error falls with the fourth power of the step')
    ! Past the quarter period the bullets coast: nothing pushes them apart.
    call two_bullets(gap, 0.0_wp, rest, 1.0e-4_wp, model, state, work)
    n = ceiling(0.5_wp*pi/w/1.0e-4_wp) + 1
    call fly(model, state, work, n)
    seen = state%node_velocity(2, 1) - state%node_velocity(1, 1)
    call expect_close(seen, -w*(gap - rest), 'speed at the slack end', rtol=1.0e-6_wp)
    call fly(model, state, work, 2000)
    call expect_close(state%node_velocity(2, 1) - state%node_velocity(1, 1), seen, 'coasting', rtol=1.0e-14_wp)
    call expect_close(state%closing%rest_length(1), state%node_position(2, 1) - state%node_position(1, 1), &
                      'the ratchet takes up the slack', rtol=1.0e-12_wp)
  end subroutine spring_regime

  !> y'' + 2 z w y' + w^2 y = 0 from y = A at rest, while k y + c y' > 0.
  subroutine damped_regime()
    real(wp), parameter :: gap = 4.0_wp, rest = 3.0_wp, z = 0.3_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, wd, t, seen, error(2), expected
    integer :: n, k
    w = sqrt(30.0_wp/reduced)
    wd = w*sqrt(1.0_wp - z**2)
    t = 0.8_wp/w
    expected = (gap - rest)*exp(-z*w*t)*(cos(wd*t) + z*w/wd*sin(wd*t))
    do k = 1, 2
      n = 16*2**(k - 1)
      call two_bullets(gap, 0.0_wp, rest, t/n, model, state, work)
      model%closing%damping = 2.0_wp*z*sqrt(30.0_wp*reduced)
      call fly(model, state, work, n)
      call expect(tension_of(model, state, 1) > 0.0_wp, &
                  'still taut')
      seen = state%node_position(2, 1) - state%node_position(1, 1) - rest
      error(k) = abs(seen - expected)
    end do
    call expect(error(1) < 1.0e-6_wp, 'damped spring to 1e-6 m with 16 steps')
    call expect(error(1)/error(2) > 12.0_wp, 'error falls with the fourth power of the step')
  end subroutine damped_regime

  !> L_r = L0 - v t: L = L0 - v t + v/w sin(w t). The ratchet moves once a step, so order 1.
  subroutine steady_winch()
    real(wp), parameter :: gap = 4.0_wp, speed = 2.0_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, t, error(2)
    integer :: n, k
    w = sqrt(30.0_wp/reduced)
    t = 0.7_wp*pi/w
    do k = 1, 2
      n = 400*2**(k - 1)
      call two_bullets(gap, 0.0_wp, gap, t/n, model, state, work)
      model%closing%winch_speed = speed
      call fly(model, state, work, n)
      error(k) = abs(state%node_position(2, 1) - state%node_position(1, 1) &
                     - (gap - speed*t + speed/w*sin(w*t)))
    end do
    call expect(error(1) < 3.0e-3_wp, 'steady winch to 3 mm with 400 steps')
    call expect_close(error(1)/error(2), 2.0_wp, 'error halves with the step', atol=0.1_wp)
  end subroutine steady_winch

  !> Thrown apart from the locked length at speed v: out to v sqrt(mu/k), back after half a
  !> period at the same speed, then slack.
  subroutine lock_holds()
    real(wp), parameter :: locked = 0.5_wp, speed = 1.5_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: w, reach
    integer :: n, i
    w = sqrt(30.0_wp/reduced)
    call two_bullets(locked, -speed, locked, 1.0e-3_wp, model, state, work)
    model%closing%locked_length = locked
    model%closing%winch_speed = 20.0_wp
    state%closing%locked = .true.
    reach = 0.0_wp
    n = ceiling(pi/w/model%step) + 100
    do i = 1, n
      call advance(model, state, work, error)
      reach = max(reach, state%node_position(2, 1) - state%node_position(1, 1) - locked)
      call expect_close(state%closing%rest_length(1), locked, 'locked length', atol=0.0_wp)
    end do
    call expect_close(reach, speed/w, 'reach', rtol=1.0e-5_wp)
    call expect_close(state%node_velocity(2, 1) - state%node_velocity(1, 1), -speed, 'comes back as fast', rtol=1.0e-5_wp)
    call expect_close(state%ledger%winch_work, 0.0_wp, 'no work over the cycle', atol=1.0e-5_wp)
    call expect_close(tension_of(model, state, 1), 0.0_wp, &
                      'slack at the end', atol=0.0_wp)
  end subroutine lock_holds

  !> Energy mu v^2/2 = k s^2/2 + T_w (reach - s), s = T_w/k.
  subroutine lock_slips()
    real(wp), parameter :: locked = 0.5_wp, speed = 3.0_wp, stall = 4.0_wp, k = 30.0_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: reach, strongest
    integer :: i
    call two_bullets(locked, -speed, locked, 1.0e-3_wp, model, state, work)
    model%closing%locked_length = locked
    model%closing%max_tension = stall
    model%closing%winch_speed = 20.0_wp
    state%closing%locked = .true.
    reach = 0.0_wp
    strongest = 0.0_wp
    do i = 1, 1500
      call advance(model, state, work, error)
      reach = max(reach, state%node_position(2, 1) - state%node_position(1, 1) - locked)
      strongest = max(strongest, tension_of(model, state, 1))
    end do
    call expect_close(reach, (0.5_wp*reduced*speed**2 - 0.5_wp*stall**2/k)/stall + stall/k, 'reach', rtol=1.0e-5_wp)
    call expect_close(strongest, stall, 'slips at the stall tension', atol=0.0_wp)
    call expect_close(state%closing%rest_length(1), locked, 'nothing is paid out', atol=0.0_wp)
    call expect_close(state%node_velocity(2, 1) - state%node_velocity(1, 1), -speed, 'comes back as fast', rtol=1.0e-5_wp)
  end subroutine lock_slips

  !> T by its law, L and dL/dt by sums of its own [N].
  real(wp) function tension_of(model, state, s) result(tension)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    integer, intent(in) :: s
    real(wp) :: length, rate, d(3), w(3)
    integer :: p
    length = 0.0_wp
    rate = 0.0_wp
    associate (path => model%closing%path_node)
      do p = model%closing%path_start(s), model%closing%path_start(s + 1) - 2
        d = state%node_position(path(p + 1), :) - state%node_position(path(p), :)
        w = state%node_velocity(path(p + 1), :) - state%node_velocity(path(p), :)
        length = length + norm2(d)
        rate = rate + dot_product(d, w)/norm2(d)
      end do
    end associate
    tension = 0.0_wp
    if (length <= state%closing%rest_length(s)) return
    tension = model%closing%stiffness*(length - state%closing%rest_length(s)) + model%closing%damping*rate
    tension = min(max(tension, 0.0_wp), model%closing%max_tension)
  end function tension_of

  ! ---- Forces on a given polygon -------------------------------------------------------

  !> A thread over n pieces that turns by `angle` at each ring, unequal pieces, at stall.
  subroutine polygon(n, angle, friction, closing, latch, n_pad, x)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: angle, friction
    type(closing_t), intent(out) :: closing
    type(closing_state_t), intent(out) :: latch
    real(wp), intent(out) :: x(n_pad, 3)
    integer :: i
    x = 0.0_wp
    do i = 1, n
      x(i + 1, :) = x(i, :) + (1.0_wp + 0.1_wp*i)*[cos(angle*i), sin(angle*i), 0.0_wp]
    end do
    closing%path_start = [1, n + 2]
    closing%path_node = [(i, i=1, n + 1)]
    closing%ring_friction = friction
    closing%stiffness = 100.0_wp
    closing%max_tension = 7.0_wp
    latch%pulling = .true.
  end subroutine polygon

  !> With k rings of angle a, piece j of n carries T e^(-mu a min(j - 1, n - j)).
  subroutine capstan()
    integer, parameter :: n = 7, n_pad = 8
    real(wp), parameter :: angle = 0.4_wp, mu = 0.25_wp, full = 7.0_wp
    type(closing_t) :: closing
    type(closing_state_t) :: latch
    real(wp) :: x(n_pad, 3), v(n_pad, 3), force(n_pad, 3), expected(n_pad, 3), impulse(n_pad, 3), t(3), tension
    integer :: j
    call polygon(n, angle, mu, closing, latch, n_pad, x)
    v = 0.0_wp
    force = 0.0_wp
    impulse = 0.0_wp
    call add_thread_force(closing, latch, n_pad, x, v, force, 0.5_wp, impulse)
    expected = 0.0_wp
    do j = 1, n
      tension = full*exp(-mu*angle*min(j - 1, n - j))
      t = [cos(angle*j), sin(angle*j), 0.0_wp]
      expected(j, :) = expected(j, :) + tension*t
      expected(j + 1, :) = expected(j + 1, :) - tension*t
    end do
    do j = 1, n + 1
      call expect_close(force(j, :), expected(j, :), 'force on a node', atol=1.0e-13_wp)
    end do
    call expect(all(abs(impulse - 0.5_wp*force) < 1.0e-15_wp), 'impulse is share x force')
    closing%ring_friction = 0.0_wp
    force = 0.0_wp
    call add_thread_force(closing, latch, n_pad, x, v, force, 0.5_wp, impulse)
    call expect_close(sqrt(sum(force(4, :)**2)), 2.0_wp*full*sin(0.5_wp*angle), 'frictionless ring', rtol=1.0e-14_wp)
  end subroutine capstan

  !> Sum F = 0, sum x cross F = 0, with and without friction; without it sum F.v = -T dL/dt.
  subroutine force_balance()
    integer, parameter :: n = 7, n_pad = 8
    type(closing_t) :: closing
    type(closing_state_t) :: latch
    real(wp) :: x(n_pad, 3), v(n_pad, 3), force(n_pad, 3), impulse(n_pad, 3), moment(3), rate, d
    integer :: i, k
    do k = 0, 1
      call polygon(n, 0.9_wp, 0.3_wp*k, closing, latch, n_pad, x)
      do i = 1, n_pad
        x(i, 3) = 0.3_wp*modulo(7*i, 5)
        v(i, :) = [0.2_wp*modulo(3*i, 7) - 0.5_wp, 0.1_wp*modulo(5*i, 11), 0.3_wp - 0.1_wp*modulo(2*i, 9)]
      end do
      force = 0.0_wp
      impulse = 0.0_wp
      call add_thread_force(closing, latch, n_pad, x, v, force, 1.0_wp, impulse)
      call expect_close(sum(force, dim=1), [0.0_wp, 0.0_wp, 0.0_wp], 'sum of forces', atol=1.0e-14_wp)
      moment = 0.0_wp
      do i = 1, n_pad
        moment(1) = moment(1) + x(i, 2)*force(i, 3) - x(i, 3)*force(i, 2)
        moment(2) = moment(2) + x(i, 3)*force(i, 1) - x(i, 1)*force(i, 3)
        moment(3) = moment(3) + x(i, 1)*force(i, 2) - x(i, 2)*force(i, 1)
      end do
      call expect_close(moment, [0.0_wp, 0.0_wp, 0.0_wp], 'sum of moments', atol=1.0e-13_wp)
      if (k == 1) cycle
      d = 1.0e-5_wp
      rate = (thread_length(closing, 1, x + d*v) - thread_length(closing, 1, x - d*v))/(2.0_wp*d)
      call expect_close(sum(force*v), -7.0_wp*rate, 'power is -T dL/dt', rtol=1.0e-8_wp)
    end do
  end subroutine force_balance

  subroutine straight_path()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(scene_t) :: scene
    real(wp) :: d(3), force(104, 3), impulse(104, 3)
    integer :: s
    scene = small_scene(0.1_wp)
    scene%closing%path = 'bullets'
    call build(scene, model, state, work)
    do s = 1, 4
      d = state%node_position(model%net%bullet_nodes(s), :) - state%node_position(model%net%bullet_nodes(modulo(s, 4) + 1), :)
      call expect_close(thread_length(model%closing, s, state%node_position), sqrt(sum(d**2)), 'straight', rtol=1.0e-14_wp)
    end do
    state%closing%rest_length = 0.0_wp
    force = 0.0_wp
    impulse = 0.0_wp
    call add_thread_force(model%closing, state%closing, model%net%n_pad, state%node_position, state%node_velocity, &
                          force(:model%net%n_pad, :), 1.0_wp, impulse(:model%net%n_pad, :))
    do s = 1, model%net%n_node
      call expect(model%net%is_bullet(s) .eqv. any(abs(force(s, :)) > 0.0_wp), 'only bullets are pulled')
    end do
  end subroutine straight_path

  ! ---- A net with its four threads ---------------------------------------------------------

  !> A light net of 4 x 4 squares with winches that start at t = 0.
  function small_scene(damping_ratio) result(scene)
    real(wp), intent(in) :: damping_ratio
    type(scene_t) :: scene
    allocate (scene%net, scene%bullets, scene%closing)
    scene%time%method = 'rk4'
    scene%net%squares = 4
    scene%net%mesh_length = 0.5_wp
    scene%net%cable_diameter = 1.0e-3_wp
    scene%net%edge_cable_diameter = 1.0e-3_wp
    scene%net%damping_ratio = damping_ratio
    scene%net%stowed_scale = 1.01_wp
    scene%bullets%mass = 0.1_wp
    scene%bullets%speed = 1.0_wp
    scene%bullets%corner_cable_length = 0.7_wp
    scene%closing%trigger = 'time'
    scene%closing%winch_speed = 2.0_wp
    scene%closing%max_tension = 5.0_wp
    scene%closing%locked_length = 0.4_wp
    scene%time%end_time = 1.0_wp
    scene%output%verdict_times = [1.0_wp]
  end function small_scene

  subroutine build(scene, model, state, work, report, error)
    type(scene_t), intent(in) :: scene
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(work_t), intent(out) :: work
    type(step_report_t), intent(out), optional :: report
    type(error_t), allocatable, intent(out), optional :: error
    type(step_report_t) :: own
    type(error_t), allocatable :: problem
    type(file_net_t), allocatable :: no_file
    call set_up(scene, 1, no_file, model, state, work, own, problem)
    if (present(report)) report = own
    if (present(error)) then
      call move_alloc(problem, error)
    else if (allocated(problem)) then
      call expect(.false., problem%message)
    end if
  end subroutine build

  !> Energy of the net's nodes and cables less what the winches did [J].
  real(wp) function balance(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    balance = net_kinetic_energy(model%net, state%node_velocity) + elastic_energy(model%net, state%node_position) &
              - state%ledger%winch_work
  end function balance

  subroutine ratchet()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: before(4), tension, momentum(3), spin(3), most
    integer :: i, s
    scene = small_scene(0.1_wp)
    scene%closing%winch_speed = 5.0_wp
    scene%closing%ring_friction = 0.05_wp
    scene%time%step = 5.0e-5_wp
    call build(scene, model, state, work)
    momentum = linear_momentum(model, state)
    spin = angular_momentum(model, state)
    most = 0.0_wp
    call expect(state%closing%pulling, 'due at t = 0: pulls from t = 0')
    do i = 1, ceiling(1.0_wp/model%step)
      before = state%closing%rest_length
      call advance(model, state, work, error)
      do s = 1, 4
        tension = tension_of(model, state, s)
        most = max(most, tension)
        call expect(state%closing%rest_length(s) <= before(s), 'the ratchet never lengthens')
        call expect(state%closing%rest_length(s) >= 0.4_wp, 'it stops at the locked length')
        call expect(tension >= 0.0_wp .and. tension <= 5.0_wp, 'tension between 0 and stall')
      end do
    end do
    call expect(all(state%closing%locked), 'all sides locked after a second')
    call expect(most > 1.0_wp, 'the threads did pull')
    call expect_close(linear_momentum(model, state), momentum, 'linear momentum', rtol=1.0e-12_wp)
    ! RK4 does not keep it exactly; the net is 2 m wide.
    call expect_close(angular_momentum(model, state), spin, 'angular momentum', atol=1.0e-7_wp*momentum(1)*2.0_wp)
  end subroutine ratchet

  !> Net taut, threads pulling, cables undamped, for so short that nothing goes slack.
  subroutine work_order()
    character(len=8), parameter :: method(2) = ['rk4     ', 'midpoint']
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: start, off(2), energy
    character(len=80) :: words
    integer :: m, k, n
    do m = 1, 2
      do k = 1, 2
        scene = small_scene(0.0_wp)
        n = 40*2**(k - 1)
        if (m == 2) n = 4*n
        scene%time%step = 2.0e-3_wp/n
        scene%time%method = method(m)
        scene%time%allow_unstable = .true.
        call build(scene, model, state, work)
        start = balance(model, state)
        call fly(model, state, work, n)
        energy = start + state%ledger%winch_work
        off(k) = abs(balance(model, state) - start)
      end do
      write (words, '(2a,2es10.2,a,f7.2,a,es10.2,a)') trim(method(m)), ': imbalance', off, ' J, ratio', off(1)/off(2), &
        ', winch work', state%ledger%winch_work, ' J'
      call note(trim(words))
      call expect(abs(state%ledger%winch_work) > 1.0e-6_wp, 'the winch works')
      call expect(off(1) < 1.0e-3_wp*abs(state%ledger%winch_work), 'imbalance below a thousandth of the work')
      call expect(off(1)/off(2) > merge(10.0_wp, 3.0_wp, m == 1), 'imbalance falls with the method''s order')
    end do
  end subroutine work_order

  !> The ledger takes the cables' loss at the beginning of each step: first order.
  subroutine work_with_damping()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: start, off(2)
    integer :: k, n
    do k = 1, 2
      scene = small_scene(0.1_wp)
      n = 200*2**(k - 1)
      scene%time%step = 2.0e-3_wp/n
      call build(scene, model, state, work)
      start = balance(model, state)
      call fly(model, state, work, n)
      off(k) = abs(balance(model, state) + state%ledger%dissipated - start)
    end do
    call expect(state%ledger%dissipated > 0.0_wp, 'cables dissipate')
    call expect(off(1) < 0.02_wp*state%ledger%dissipated, 'imbalance below 2 % of the loss')
    call expect(off(1)/off(2) > 1.8_wp, 'imbalance falls with the step')
  end subroutine work_with_damping

  subroutine triggers()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    integer :: n
    scene = small_scene(0.1_wp)
    scene%time%step = 1.0e-4_wp
    scene%time%allow_unstable = .true.
    scene%closing%delay = 7.0e-4_wp
    call build(scene, model, state, work)
    do n = 1, 7
      call expect(.not. state%closing%pulling, 'before the delay nothing pulls')
      call fly(model, state, work, 1)
    end do
    call expect(state%closing%pulling, 'pulls at the first step at the due time')
    call expect_close(state%closing%start_time, 7.0e-4_wp, 'start', rtol=1.0e-12_wp)
    call expect_close(state%closing%rest_length(1), thread_length(model%closing, 1, state%node_position), &
                      'starts from the length as it is', atol=0.0_wp)

    scene%closing%trigger = 'contact'
    call build(scene, model, state, work)
    call fly(model, state, work, 20)
    call expect(.not. state%closing%triggered, 'no contact, no trigger')
    state%first_contact = 2.0e-3_wp
    call fly(model, state, work, 6)
    call expect(.not. state%closing%pulling, 'delay counts from first contact')
    call fly(model, state, work, 1)
    call expect(state%closing%pulling, 'pulls after the delay')

    scene%closing%trigger = 'passed_target'
    scene%closing%delay = 0.0_wp
    allocate (scene%target)
    scene%target%shape = 'sphere'
    scene%target%dimensions(1) = 0.1_wp
    scene%target%mass = 1.0_wp
    scene%target%position = [1.0_wp, 0.0_wp, 0.0_wp]
    call build(scene, model, state, work)
    call fly(model, state, work, 3)
    call expect(.not. state%closing%triggered, 'target ahead')
    state%node_position(:model%net%n_node, 1) = state%node_position(:model%net%n_node, 1) + 1.0_wp
    call fly(model, state, work, 1)
    call expect(state%closing%pulling, 'target passed')
  end subroutine triggers

  !> By hand, |dL/dx|^2 = 1/2 at a ring: a side has 19 inner perimeter nodes of three half cables, two corners
  !> of two halves, two bullets; corners and bullets belong to two sides.
  subroutine guard()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report, free
    type(error_t), allocatable :: error
    real(wp) :: cable, weight, damping
    scene = closing_rocket('rk4')
    call build(scene, model, state, work, report)
    deallocate (scene%closing)
    call build(scene, model, state, work, free)
    cable = 1440.0_wp*0.25_wp*pi*1.0e-6_wp*1.5_wp
    weight = 19.0_wp*0.5_wp/(1.5_wp*cable) + 2.0_wp*2.0_wp*0.5_wp/cable + 2.0_wp*2.0_wp/1.0_wp
    damping = 0.6_wp*sqrt(5.0_wp*100.0_wp/30.0_wp*1.0_wp)
    call expect_close(report%spectrum%largest_damping_rate - free%spectrum%largest_damping_rate, damping*weight, &
                      'damping rate of the thread', rtol=1.0e-10_wp)
    call expect_close(report%spectrum%highest_frequency**2 - free%spectrum%highest_frequency**2, &
                      5.0_wp*100.0_wp/30.0_wp*weight, 'squared frequency of the thread', rtol=1.0e-10_wp)
    call expect_close(report%stable_limit*report%spectrum%largest_damping_rate, 2.785293563_wp, &
                      'rk4 on a pure decay', rtol=1.0e-2_wp)
    call expect(report%step <= 0.7_wp*report%stable_limit*(1.0_wp + 1.0e-12_wp), 'the chosen step is below it')
    call expect(free%stable_limit > 4.5e-3_wp, 'without the thread the net allows 4.7 ms')

    scene = closing_rocket('rk4')
    scene%time%step = 1.0e-3_wp
    call build(scene, model, state, work, report, error)
    call expect(allocated(error), '1 ms is refused')
    if (.not. allocated(error)) return
    call expect_equal(error%code, exit_input, 'as bad input')
    call expect(index(error%message, 'closing thread') > 0, 'and says why')
  end subroutine guard

  !> A light net closed hard, at 0.9 of the limit, until all is a bundle.
  subroutine energy_by_step()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    real(wp) :: before, now, rise, scale
    character(len=80) :: words
    integer :: i
    scene = small_scene(0.1_wp)
    scene%net%stowed_scale = 0.5_wp
    scene%time%end_time = 0.6_wp
    call build(scene, model, state, work, report)
    scene%time%step = 0.9_wp*report%stable_limit
    call build(scene, model, state, work)
    before = balance(model, state)
    scale = before
    rise = 0.0_wp
    do i = 1, ceiling(0.6_wp/model%step)
      call advance(model, state, work, error)
      now = balance(model, state)
      rise = max(rise, now - before)
      scale = max(scale, abs(state%ledger%winch_work))
      before = now
    end do
    write (words, '(a,es10.2,a,es10.2)') 'limit', report%stable_limit, ' s, largest rise in a step, relative', rise/scale
    call note(trim(words))
    call expect(rise < 1.0e-9_wp*scale, 'the energy never rises')
    call expect(state%ledger%winch_work > 0.1_wp, 'while the winches work')
  end subroutine energy_by_step

  !> Latches, ratchet and velocities are all in the state; scratch remembers nothing.
  subroutine resumed()
    character(len=8), parameter :: method(2) = ['rk4     ', 'midpoint']
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: whole, half
    type(work_t) :: work, fresh
    integer :: m
    do m = 1, 2
      scene = small_scene(0.1_wp)
      scene%net%stowed_scale = 0.5_wp
      scene%closing%delay = 0.05_wp
      scene%time%step = 1.0e-4_wp
      scene%time%method = method(m)
      call build(scene, model, whole, work)
      call fly(model, whole, work, 900)
      half = whole
      call new_work(fresh, model, 1)
      call fly(model, whole, work, 900)
      call fly(model, half, fresh, 900)
      call expect(whole%closing%pulling .and. whole%ledger%winch_work > 0.0_wp, 'the winches work')
      call expect(all(whole%node_position == half%node_position), 'positions')
      call expect(all(whole%node_velocity == half%node_velocity), 'velocities')
      call expect(all(whole%closing%rest_length == half%closing%rest_length), 'ratchet')
      call expect(whole%ledger%winch_work == half%ledger%winch_work, 'winch work')
    end do
  end subroutine resumed

  subroutine absent()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    scene = small_scene(0.1_wp)
    deallocate (scene%closing)
    call build(scene, model, state, work)
    call expect(.not. allocated(model%closing), 'no model')
    call expect(.not. allocated(state%closing), 'no latches')
    call expect(.not. allocated(work%flow%cables%extra), 'no scratch')
    call fly(model, state, work, 5)
    call expect_close(state%ledger%winch_work, 0.0_wp, 'no work', atol=0.0_wp)
  end subroutine absent

end module verify_closing
