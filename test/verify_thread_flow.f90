!> The closing threads within a step of `midpoint`: closed forms of two bullets, far beyond the
!> step that explicit damping allows too; forces against those of rk4; a light ring against
!> rk4 at a fine step; momentum and books.
module verify_thread_flow
  use castnet_kinds, only: wp
  use castnet_closing_thread, only: add_thread_force, thread_length
  use castnet_diagnostics, only: net_kinetic_energy, elastic_energy
  use castnet_error, only: error_t
  use castnet_integrator, only: midpoint_begin
  use castnet_model, only: model_t, method_rk4, method_midpoint, trigger_time
  use castnet_model_builder, only: file_net_t
  use castnet_net_builder, only: finish_net
  use castnet_scene, only: scene_t
  use castnet_setup, only: set_up, step_report_t
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, new_work, advance
  use castnet_vector, only: cross
  use scenes, only: closing_rocket, fly
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_verify_thread_flow

  real(wp), parameter :: spring = 30.0_wp   !! k_t [N/m]

contains

  subroutine run_verify_thread_flow()
    call test_case('thread_flow: two bullets on a damped thread against the closed form, order 2', damped)
    call test_case('thread_flow: damping a hundred thousand times too stiff for the step creeps as it should', creep)
    call test_case('thread_flow: two threads that pull against each other''s grain never gain energy', doubled)
    call test_case('thread_flow: rings, corners and friction get the force of a stage of rk4', same_force)
    call test_case('thread_flow: a light ring at fifty times the explicit step flies as with rk4', light_ring)
    call test_case('thread_flow: momentum is kept, winch work is what the nodes got, led supports pay theirs', books)
    call test_case('thread_flow: a slack thread leaves the step as it is', slack)
    call test_case('thread_flow: an open net closes as with rk4 at seven times its step, and gains no energy', closing_net)
    call test_case('thread_flow: a run that goes on from a copy of its state is the same to the bit, with eighteen parts', resumed)
    call test_case('thread_flow: the automatic step of the closing rocket is the net''s', automatic_step)
  end subroutine run_verify_thread_flow

  !> Free nodes without cables, and one thread over each of the given paths, pulling.
  subroutine free_nodes(mass, x, v, path_start, path_node, rest_length, step, model, state, fixed)
    real(wp), intent(in) :: mass(:), x(:, :), v(:, :)    !! (n), (n,3) [kg], [m], [m/s]
    integer, intent(in) :: path_start(:), path_node(:)
    real(wp), intent(in) :: rest_length, step            !! [m], [s]
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    logical, intent(in), optional :: fixed(:)
    integer :: n
    n = size(mass)
    allocate (model%net, model%closing, state%closing)
    model%net%n_node = n
    model%net%node_mass = mass
    allocate (model%net%fixed(n), source=.false.)
    if (present(fixed)) model%net%fixed = fixed
    allocate (model%net%cable_nodes(2, 0), model%net%natural_length(0), model%net%axial_stiffness(0), model%net%damping(0))
    call finish_net(model%net)
    model%closing%trigger = trigger_time
    model%closing%path_start = path_start
    model%closing%path_node = path_node
    model%closing%stiffness = spring
    model%closing%max_tension = 1.0e12_wp
    model%method = method_midpoint
    model%step = step
    allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3), source=0.0_wp)
    state%node_position(:n, :) = x
    state%node_velocity(:n, :) = v
    state%closing%triggered = .true.
    state%closing%pulling = .true.
    state%closing%rest_length = rest_length
    call midpoint_begin(state)
  end subroutine free_nodes

  !> Two bullets of 1 and 3 kg at x = 0 and `gap`, at rest but for dL/dt = `rate`.
  subroutine two_bullets(gap, rate, rest_length, damping, step, model, state, work)
    real(wp), intent(in) :: gap, rate, rest_length, damping, step
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(work_t), intent(out) :: work
    real(wp) :: x(2, 3), v(2, 3)
    x = 0.0_wp
    v = 0.0_wp
    x(2, 1) = gap
    v(1, 1) = -0.75_wp*rate
    v(2, 1) = 0.25_wp*rate
    call free_nodes([1.0_wp, 3.0_wp], x, v, [1, 3], [1, 2], rest_length, step, model, state)
    model%closing%damping = damping
    call new_work(work, model, 1)
  end subroutine two_bullets

  real(wp) function kinetic(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    integer :: i
    kinetic = 0.0_wp
    do i = 1, model%net%n_node
      if (model%net%fixed(i)) cycle
      kinetic = kinetic + 0.5_wp*model%net%node_mass(i)*sum(state%node_velocity(i, :)**2)
    end do
  end function kinetic

  !> y'' + 2 z w y' + w^2 y = 0 from y = 1 m at rest, with one and with four parts to a step.
  subroutine damped()
    real(wp), parameter :: mu = 0.75_wp, ratio(2) = [0.3_wp, 0.9_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, z, wd, t, error(3), expected
    character(len=80) :: words
    integer :: m, k, n
    w = sqrt(spring/mu)
    t = 0.8_wp/w
    do m = 1, 2
      z = ratio(m)
      wd = w*sqrt(1.0_wp - z**2)
      expected = exp(-z*w*t)*(cos(wd*t) + z*w/wd*sin(wd*t))
      do k = 1, 3
        n = 10*2**(k - 1)
        call two_bullets(4.0_wp, 0.0_wp, 3.0_wp, 2.0_wp*z*sqrt(spring*mu), t/n, model, state, work)
        call fly(model, state, work, n)
        error(k) = abs(state%node_position(2, 1) - state%node_position(1, 1) - 3.0_wp - expected)
        call expect_close(state%ledger%winch_work, kinetic(model, state), 'the work is the kinetic energy', rtol=1.0e-13_wp)
      end do
      write (words, '(a,f4.1,a,3es10.2)') 'ratio', z, ': errors', error
      call note(trim(words))
      call expect(error(1) < 1.0e-3_wp, 'to a millimetre with ten steps')
      call expect(error(1)/error(2) > 3.7_wp .and. error(2)/error(3) > 3.7_wp, 'of second order')
    end do
  end subroutine damped

  !> Of m y'' + c y' + k y = m g a huge c leaves c y' + k y = m g: y = m g/k (1 - e^(-k t/c)). Thrown
  !> apart, two bullets lose their relative velocity at once and never turn round.
  subroutine creep()
    real(wp), parameter :: step = 0.01_wp, lag = 0.5_wp, pull = 3.0_wp, light = 1.0e-6_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: x(2, 3), before, now
    integer :: i
    ! Explicit damping bears h c/m < 2; here it is 1.5e5.
    x = 0.0_wp
    x(2, 1) = 3.0_wp
    call free_nodes([1.0_wp, light], x, 0.0_wp*x, [1, 3], [1, 2], 3.0_wp - 1.0e-9_wp, step, model, state, &
                    fixed=[.true., .false.])
    model%closing%damping = spring*lag
    model%gravity = [pull/light, 0.0_wp, 0.0_wp]
    call new_work(work, model, 1)
    call fly(model, state, work, 50)
    call expect_close(state%node_position(2, 1) - 3.0_wp, pull/spring*(1.0_wp - exp(-50.0_wp*step/lag)), 'creeps', rtol=1.0e-3_wp)

    call two_bullets(4.0_wp, 7.0_wp, 3.999_wp, 1.0e7_wp, step, model, state, work)
    before = kinetic(model, state)
    do i = 1, 20
      call fly(model, state, work, 1)
      now = kinetic(model, state)
      call expect(now <= before, 'loses energy')
      call expect(state%node_velocity(2, 1) - state%node_velocity(1, 1) > -1.0e-4_wp, 'does not turn round')
      before = now
    end do
    call expect(state%node_velocity(2, 1) - state%node_velocity(1, 1) < 1.0e-4_wp, 'stopped')
  end subroutine creep

  !> Two threads over the same two nodes: together twice the weight that each knows of, the
  !> worst case of sides that share nodes. Undamped otherwise and without a spring.
  subroutine doubled()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: x(2, 3), v(2, 3), before, now
    integer :: k, i
    x = 0.0_wp
    v = 0.0_wp
    x(2, 1) = 4.0_wp
    v(2, 1) = 1.0_wp
    do k = -3, 6
      call free_nodes([1.0_wp, 3.0_wp], x, v, [1, 3, 5], [1, 2, 2, 1], 1.0_wp, 0.01_wp, model, state)
      model%closing%stiffness = 0.0_wp
      model%closing%damping = 10.0_wp**k
      call new_work(work, model, 1)
      before = kinetic(model, state)
      do i = 1, 100
        call fly(model, state, work, 1)
        now = kinetic(model, state)
        call expect(now <= before*(1.0_wp + 1.0e-14_wp), 'the energy never rises')
        before = now
      end do
      call expect_close(state%node_velocity(1, 1) + 3.0_wp*state%node_velocity(2, 1), 3.0_wp, 'momentum', rtol=1.0e-13_wp)
    end do
  end subroutine doubled

  !> A step so short that it is a stage: (v1 - v0)/h against add_thread_force, with two sides that
  !> share a corner and a bullet, with friction, tension between the bounds and at stall.
  subroutine same_force()
    integer, parameter :: n = 7
    real(wp), parameter :: h = 1.0e-9_wp, mass(n) = [1.0_wp, 0.02_wp, 0.01_wp, 0.03_wp, 2.0_wp, 0.01_wp, 0.5_wp]
    integer, parameter :: start(3) = [1, 6, 10], path(9) = [1, 2, 3, 4, 5, 5, 4, 6, 7]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: x(n, 3), v(n, 3), pull(n), friction
    real(wp), allocatable :: force(:, :), impulse(:, :), expected(:, :)
    integer :: i, k
    do i = 1, n
      x(i, :) = [1.3_wp*i, 0.4_wp*modulo(5*i, 7), 0.3_wp*modulo(7*i, 5)]
      v(i, :) = [0.2_wp*modulo(3*i, 7) - 0.5_wp, 0.1_wp*modulo(5*i, 11), 0.3_wp - 0.1_wp*modulo(2*i, 9)]
    end do
    pull = 0.0_wp
    do k = 1, 4
      friction = 0.0_wp
      if (k > 2) friction = 0.3_wp
      call free_nodes(mass, x, v, start, path, 5.0_wp, h, model, state)
      model%closing%damping = 2.0_wp
      model%closing%ring_friction = friction
      if (modulo(k, 2) == 0) model%closing%max_tension = 7.0_wp
      allocate (force(model%net%n_pad, 3), impulse(model%net%n_pad, 3), source=0.0_wp)
      call add_thread_force(model%closing, state%closing, model%net%n_pad, state%node_position, state%node_velocity, force, &
                            1.0_wp, impulse)
      call new_work(work, model, 1)
      call fly(model, state, work, 1)
      expected = state%node_velocity(:n, :) - v
      do i = 1, n
        call expect_close(mass(i)*expected(i, :)/h, force(i, :), 'force on a node', rtol=1.0e-4_wp, atol=1.0e-5_wp)
      end do
      call expect(all(work%flow%threads%tension > 1.0_wp), 'both sides pull')
      deallocate (force, impulse)
    end do
  end subroutine same_force

  !> A ring of 1 g between bullets of 1 kg, thrown sideways: c_t g.g/m damps at up to 2e4 1/s while
  !> the bullets need seconds. rk4 needs steps of 1e-4 s to be stable; here 5e-3 s do.
  subroutine light_ring()
    real(wp), parameter :: t = 0.3_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: x(3, 3), v(3, 3), fine(3, 3), off(2)
    character(len=80) :: words
    integer :: k
    x = reshape([0.0_wp, 1.2_wp, 3.0_wp, 0.0_wp, 0.9_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.1_wp], [3, 3])
    v = reshape([0.0_wp, 0.0_wp, -1.0_wp, 0.2_wp, 0.5_wp, -0.1_wp, 0.0_wp, -0.4_wp, 0.3_wp], [3, 3])
    call free_nodes([1.0_wp, 1.0e-3_wp, 1.0_wp], x, v, [1, 4], [1, 2, 3], 0.5_wp, 2.0e-5_wp, model, state)
    model%closing%damping = 5.0_wp
    model%method = method_rk4
    call new_work(work, model, 1)
    call fly(model, state, work, nint(t/model%step))
    fine = state%node_position(:3, :)
    do k = 1, 2
      call free_nodes([1.0_wp, 1.0e-3_wp, 1.0_wp], x, v, [1, 4], [1, 2, 3], 0.5_wp, 5.0e-3_wp/2**(k - 1), model, state)
      model%closing%damping = 5.0_wp
      call new_work(work, model, 1)
      call fly(model, state, work, nint(t/model%step))
      off(k) = max(norm2(state%node_position(1, :) - fine(1, :)), norm2(state%node_position(3, :) - fine(3, :)))
    end do
    write (words, '(a,2es10.2,a)') 'bullets off by', off, ' m at 5 and 2.5 ms'
    call note(trim(words))
    call expect(off(1) < 1.0e-4_wp, 'within a tenth of a millimetre')
    call expect(off(2) < 0.5_wp*off(1), 'closer with half the step')
  end subroutine light_ring

  !> Four free nodes, then one of the bullets led along at a given velocity.
  subroutine books()
    real(wp), parameter :: mass(4) = [1.0_wp, 0.02_wp, 0.01_wp, 2.0_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: x(4, 3), v(4, 3), momentum(3), now(3), spin(3), before
    integer :: i, k
    do i = 1, 4
      x(i, :) = [1.1_wp*i, 0.3_wp*modulo(3*i, 5), 0.2_wp*i**2]
      v(i, :) = [0.3_wp - 0.2_wp*i, 0.1_wp*modulo(5*i, 3), 0.4_wp - 0.1_wp*i]
    end do
    do k = 1, 2
      call free_nodes(mass, x, v, [1, 5], [1, 2, 3, 4], 3.0_wp, 1.0e-3_wp, model, state, &
                      fixed=[k == 2, .false., .false., .false.])
      model%closing%damping = 3.0_wp
      model%closing%ring_friction = 0.2_wp
      model%closing%winch_speed = 1.0_wp
      model%closing%max_tension = 40.0_wp
      call new_work(work, model, 1)
      before = kinetic(model, state)
      momentum = matmul(mass, v)
      call fly(model, state, work, 300)
      call expect(state%ledger%winch_work > 1.0_wp, 'the winch works')
      call expect_close(kinetic(model, state) - before, state%ledger%winch_work + state%ledger%external_work, &
                        'the nodes got what was done on them', rtol=1.0e-12_wp)
      if (k == 2) then
        call expect(abs(state%ledger%external_work) > 1.0_wp, 'the support takes its share')
        call expect_close(state%node_position(1, :), x(1, :) + 0.3_wp*v(1, :), 'and goes its way', rtol=1.0e-12_wp)
        cycle
      end if
      now = 0.0_wp
      spin = 0.0_wp
      do i = 1, 4
        now = now + mass(i)*state%node_velocity(i, :)
        spin = spin + mass(i)*(cross(state%node_position(i, :), state%node_velocity(i, :)) - cross(x(i, :), v(i, :)))
      end do
      call expect_close(now, momentum, 'linear momentum', atol=1.0e-13_wp)
      call expect_close(spin, [0.0_wp, 0.0_wp, 0.0_wp], 'angular momentum', atol=1.0e-12_wp)
    end do
  end subroutine books

  !> With L < L_r nothing but the cables acts: the parts lead where one step leads.
  subroutine slack()
    type(scene_t) :: scene
    type(model_t) :: model, bare
    type(state_t) :: state, other
    type(work_t) :: work, plain
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    type(file_net_t), allocatable :: no_file
    scene = closing_rocket('midpoint')
    scene%time%step = 1.0e-3_wp
    call set_up(scene, 1, no_file, model, state, work, report, error)
    deallocate (scene%closing)
    call set_up(scene, 1, no_file, bare, other, plain, report, error)
    call expect(.not. allocated(error), 'set up')
    state%closing%pulling = .true.
    state%closing%rest_length = 1.0e6_wp
    model%closing%winch_speed = 0.0_wp
    state%closing%locked = .true.
    call fly(model, state, work, 300)
    call fly(bare, other, plain, 300)
    call expect(maxval(abs(other%node_velocity)) > 5.0_wp, 'the net flies')
    call expect_close(maxval(abs(state%node_position - other%node_position)), 0.0_wp, 'positions', atol=1.0e-9_wp)
    call expect_close(state%ledger%winch_work, 0.0_wp, 'no work', atol=0.0_wp)
  end subroutine slack

  !> The rocket's net, nearly flat, wound in at once: sides and winch work after 1.2 s, when half of
  !> the thread is in, long after single nodes went their own ways.
  subroutine closing_net()
    character(len=8), parameter :: method(2) = ['rk4     ', 'midpoint']
    real(wp), parameter :: step(2) = [2.0e-4_wp, 1.5e-3_wp], t = 1.2_wp
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    type(file_net_t), allocatable :: no_file
    real(wp) :: length(2), done(2), start, now, rise
    character(len=80) :: words
    integer :: m, i
    do m = 1, 2
      scene = closing_rocket('midpoint')
      scene%time%method = method(m)
      scene%time%step = step(m)
      scene%net%stowed_scale = 0.95_wp
      scene%net%squares = 10
      scene%bullets%mass = 0.3_wp
      scene%closing%trigger = 'time'
      scene%closing%max_tension = 30.0_wp
      scene%closing%winch_speed = 10.0_wp
      call set_up(scene, 1, no_file, model, state, work, report, error)
      call expect(.not. allocated(error), 'set up')
      start = energy(model, state)
      rise = 0.0_wp
      do i = 1, nint(t/step(m))
        call advance(model, state, work, error)
        now = energy(model, state) - state%ledger%winch_work
        rise = max(rise, now - start)
      end do
      length(m) = thread_length(model%closing, 1, state%node_position)
      done(m) = state%ledger%winch_work
      write (words, '(2a,f8.4,a,f8.3,a,es9.2)') trim(method(m)), ': side', length(m), ' m, work', done(m), ' J, rise', rise
      call note(trim(words))
      call expect(rise < 1.0e-3_wp*start, 'energy less winch work does not rise')
    end do
    call expect(length(1) < 12.0_wp .and. done(1) > 1.0_wp, 'it closes')
    call expect_close(length(2), length(1), 'side', rtol=2.0e-2_wp)
    call expect_close(done(2), done(1), 'winch work', rtol=2.0e-2_wp)
  end subroutine closing_net

  subroutine resumed()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: whole, half
    type(work_t) :: work, fresh
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    type(file_net_t), allocatable :: no_file
    scene = closing_rocket('midpoint')
    scene%time%step = 1.5e-3_wp
    scene%net%stowed_scale = 0.95_wp
    scene%closing%trigger = 'time'
    call set_up(scene, 1, no_file, model, whole, work, report, error)
    call fly(model, whole, work, 70)
    half = whole
    call new_work(fresh, model, 1)
    call fly(model, whole, work, 70)
    call fly(model, half, fresh, 70)
    call expect(abs(whole%ledger%winch_work) > 1.0e-2_wp, 'the winches work')
    call expect(all(whole%node_position == half%node_position), 'positions')
    call expect(all(whole%node_velocity == half%node_velocity), 'velocities')
    call expect(all(whole%closing%rest_length == half%closing%rest_length), 'ratchet')
    call expect(whole%ledger%winch_work == half%ledger%winch_work, 'winch work')
  end subroutine resumed

  real(wp) function energy(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    energy = net_kinetic_energy(model%net, state%node_velocity) + elastic_energy(model%net, state%node_position)
  end function energy

  !> The threads add their stiffness to the net's squared frequency and no damping: the limit
  !> falls by no more than the frequency rises, not thirtyfold. What is above it is refused.
  subroutine automatic_step()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report, free
    real(wp) :: ratio
    type(error_t), allocatable :: error
    type(file_net_t), allocatable :: no_file
    scene = closing_rocket('midpoint')
    call set_up(scene, 1, no_file, model, state, work, report, error)
    deallocate (scene%closing)
    call set_up(scene, 1, no_file, model, state, work, free, error)
    call expect(.not. allocated(error), 'set up')
    call expect_close(report%spectrum%largest_damping_rate, free%spectrum%largest_damping_rate, 'damping', rtol=1.0e-14_wp)
    call expect(report%spectrum%highest_frequency > free%spectrum%highest_frequency, 'stiffness counts')
    ratio = free%spectrum%highest_frequency/report%spectrum%highest_frequency
    call expect(report%stable_limit < free%stable_limit .and. report%stable_limit > ratio*free%stable_limit, 'the limit')
    call expect(report%step > 1.5e-3_wp, 'the chosen step')
    ! With contact, one threshold at the speed of bullets and winches together.
    scene = closing_rocket('midpoint')
    allocate (scene%target, scene%contact)
    scene%target%shape = 'sphere'
    scene%target%dimensions(1) = 2.0_wp
    scene%target%mass = 1000.0_wp
    scene%target%position = [50.0_wp, 0.0_wp, 0.0_wp]
    scene%contact%threshold = 2.0e-2_wp
    call set_up(scene, 1, no_file, model, state, work, free, error)
    call expect(.not. allocated(error), 'set up')
    call expect_close(free%step, 2.0e-2_wp/(10.0_wp + 20.0_wp), 'with contact', rtol=1.0e-14_wp)
    ! Faster than 100 N on two sides of 30 m make a bullet of 1 kg it does not get.
    scene%closing%winch_speed = 1.0e4_wp
    call set_up(scene, 1, no_file, model, state, work, free, error)
    call expect_close(free%step, 2.0e-2_wp/(10.0_wp + sqrt(6000.0_wp)), 'with fast winches', rtol=1.0e-14_wp)
    scene = closing_rocket('midpoint')
    scene%time%step = 1.05_wp*report%stable_limit
    call set_up(scene, 1, no_file, model, state, work, report, error)
    call expect(allocated(error), 'above the limit: refused')
    if (.not. allocated(error)) return
    call expect(index(error%message, 'closing thread') > 0, 'and says why')
  end subroutine automatic_step

end module verify_thread_flow
