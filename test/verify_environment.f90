!> V8 and the surroundings: uniform gravity, a constant force and torque, the orbital
!> frame, and the work that they do.
!>
!> Clohessy and Wiltshire's equations x'' = 2 n z', y'' = -n^2 y, z'' = 3 n^2 z - 2 n x' have
!> the solution, with zc = 4 z0 - 2 x0'/n and c, s = cos, sin(n t),
!>   x = x0 + (x0' - 2 n z0 + 2 n zc) t + 2 (z0 - zc) s + 2 z0'/n (1 - c),
!>   y = y0 c + y0'/n s,   z = zc + (z0 - zc) c + z0'/n s.
module verify_environment
  use castnet_kinds, only: wp
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts
  use castnet_diagnostics, only: net_centre_of_mass
  use castnet_error, only: error_t
  use castnet_model, only: model_t, contact_t, method_rk4, method_midpoint
  use castnet_rotation, only: quaternion_from_rotation_vector, quaternion_product
  use castnet_shape, only: new_shape
  use castnet_state, only: state_t, impulse_bins
  use castnet_stepper, only: work_t
  use scenes, only: net_of, chain, add_spinning_body, ready, fly, mechanical_energy, random_numbers, words
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_environment

  integer, parameter :: methods(2) = [method_rk4, method_midpoint]

contains

  subroutine run_verify_environment()
    call test_case('verify V8: a hanging chain stretches by its weight', hanging_chain)
    call test_case('verify V8: released, its centre of mass falls with g', falling_chain)
    call test_case('verify: gravity, force and torque do the work that they should', work_of_constant_loads)
    call test_case('verify: node and target follow Clohessy and Wiltshire', clohessy_wiltshire)
    call test_case('verify: the attitude is relative to the orbital frame', orbital_attitude)
    call test_case('verify: Jacobi''s integral stays in the orbital frame', jacobi_integral)
    call test_case('verify: a fixed target is fixed in the orbital frame', fixed_in_orbit)
    call test_case('verify: supports that are led along do their work', moving_support)
    call test_case('verify: an elastic impact in the orbital frame keeps Jacobi''s integral', impact_in_orbit)
  end subroutine run_verify_environment

  !> N masses under each other: cable j carries N + 1 - j of them, so the tip hangs
  !> (m g/k) N (N + 1)/2 below its place at rest. At equilibrium nothing moves but by
  !> round-off; damped, the chain goes there.
  subroutine hanging_chain()
    integer, parameter :: n = 12
    real(wp), parameter :: m = 0.02_wp, k = 40.0_wp, l0 = 0.1_wp, g = 9.81_wp, down(3) = [0.0_wp, 0.0_wp, -1.0_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: s(n + 1), mass(n + 1), drop
    logical :: fixed(n + 1)
    integer :: j, i
    mass = m
    fixed = .false.
    fixed(1) = .true.
    drop = m*g/k*n*(n + 1)/2.0_wp
    do i = 1, 2
      s(1) = 0.0_wp
      do j = 1, n
        s(j + 1) = s(j) + l0 + merge(1.0_wp, 0.5_wp, i == 1)*m*g/k*(n + 1 - j)
      end do
      call chain(s, down, mass, fixed, k, l0, merge(0.0_wp, 4.0_wp, i == 1), model, state)
      model%gravity = g*down
      call ready(model, state, work, method_rk4, 2.0e-3_wp)
      call fly(model, state, work, merge(1000, 15000, i == 1))
      call expect_close(-state%node_position(n + 1, 3) - n*l0, drop, 'tip stretch', atol=1.0e-12_wp)
      call expect(maxval(abs(state%node_velocity)) < 1.0e-11_wp, 'at rest')
    end do
    call note('V8 tip stretch '//words(-state%node_position(n + 1, 3) - n*l0)//', off by '// &
              words(-state%node_position(n + 1, 3) - n*l0 - drop)//' m')
  end subroutine hanging_chain

  !> g t^2/2 is of degree 2: both methods are exact, whatever the cables do inside.
  subroutine falling_chain()
    integer, parameter :: n = 12
    real(wp), parameter :: m = 0.02_wp, k = 40.0_wp, l0 = 0.1_wp, g = 9.81_wp, down(3) = [0.0_wp, 0.0_wp, -1.0_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: s(n), mass(n), start(3), t, top
    logical :: fixed(n)
    integer :: j, i
    mass = m
    fixed = .false.
    s(1) = 0.0_wp
    do j = 2, n
      s(j) = s(j - 1) + l0 + m*g/k*(n + 1 - j)
    end do
    do i = 1, 2
      call chain(s, down, mass, fixed, k, l0, 0.1_wp, model, state)
      model%gravity = g*down
      start = net_centre_of_mass(model%net, state%node_position)
      call ready(model, state, work, methods(i), 1.0e-3_wp)
      call fly(model, state, work, 500)
      t = state%time
      ! 500 additions of positions below 2 m.
      call expect_close(net_centre_of_mass(model%net, state%node_position), start + 0.5_wp*g*t**2*down, &
                        'centre of mass', atol=1.0e-12_wp)
      top = state%node_position(1, 3)
      call expect(top < -1.5_wp*0.5_wp*g*t**2, 'the top has been pulled down by the rest')
    end do
  end subroutine falling_chain

  !> A free body: F x for the force, the gain of energy for gravity and torque.
  subroutine work_of_constant_loads()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp), parameter :: force(3) = [0.3_wp, -0.2_wp, 0.5_wp], g(3) = [0.0_wp, 1.0_wp, -9.81_wp], none(3) = 0.0_wp
    real(wp) :: inertia(3, 3), error(2), start
    integer :: i, j, n
    inertia = 0.0_wp
    do i = 1, 3
      inertia(i, i) = real(i, wp)
    end do
    do i = 1, 2
      call add_body(none, [0.0_wp, 0.0_wp, 0.0_wp])
      model%target%external_force = force
      call ready(model, state, work, methods(i), 0.01_wp)
      call fly(model, state, work, 300)
      call expect_close(state%target%position, 4.5_wp*force, 'path under a force', rtol=1.0e-13_wp)
      call expect_close(state%ledger%external_work, 4.5_wp*sum(force**2), 'its work', rtol=1.0e-13_wp)

      call add_body(none, [0.0_wp, 0.0_wp, 0.0_wp])
      model%target%external_torque = [0.0_wp, 0.4_wp, 0.0_wp]
      call ready(model, state, work, methods(i), 0.01_wp)
      call fly(model, state, work, 300)
      call expect_close(state%target%angular_velocity, [0.0_wp, 0.6_wp, 0.0_wp], 'spin under a torque', atol=1.0e-13_wp)
      call expect_close(state%ledger%external_work, 0.36_wp, 'its work', rtol=1.0e-13_wp)

      ! Everything at once on a tumbling body: the ledger balances to the order of rk4.
      do j = 1, 2
        n = 150*j
        call add_body([1.0_wp, 2.0_wp, -1.0_wp], [0.5_wp, 1.0_wp, -0.7_wp])
        model%target%external_force = force
        model%target%external_torque = [0.1_wp, -0.4_wp, 0.3_wp]
        model%gravity = g
        start = mechanical_energy(model, state)
        call ready(model, state, work, methods(i), 3.0_wp/n)
        call fly(model, state, work, n)
        error(j) = abs(mechanical_energy(model, state) - start - state%ledger%external_work)
      end do
      call expect(error(2) < 1.0e-7_wp*abs(start), 'ledger of force, torque and gravity')
      call expect(error(2) < error(1)/12.0_wp, 'whose error falls as h^4')
      call note('ledger off by '//words(error(1))//', '//words(error(2))//' J at h, h/2')

      ! A fixed target takes no work.
      call add_body(none, none)
      model%target%fixed = .true.
      model%target%external_force = force
      model%gravity = g
      call ready(model, state, work, methods(i), 0.01_wp)
      call fly(model, state, work, 10)
      call expect_close(state%ledger%external_work, 0.0_wp, 'work on a fixed target')
      call expect_close(state%target%position, none, 'which stays')
    end do

  contains

    subroutine add_body(velocity, spin)
      real(wp), intent(in) :: velocity(3), spin(3)
      if (allocated(model%target)) deallocate (model%target, state%target)
      model%gravity = 0.0_wp
      state%ledger%external_work = 0.0_wp
      call add_spinning_body(inertia, [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], spin, model, state)
      state%target%velocity = velocity
    end subroutine add_body

  end subroutine work_of_constant_loads

  !> The closed form at the top of this file.
  function orbit_at(n, x0, v0, t) result(x)
    real(wp), intent(in) :: n, x0(3), v0(3), t
    real(wp) :: x(3), c, s, zc
    c = cos(n*t)
    s = sin(n*t)
    zc = 4.0_wp*x0(3) - 2.0_wp*v0(1)/n
    x(1) = x0(1) + (v0(1) - 2.0_wp*n*x0(3) + 2.0_wp*n*zc)*t + 2.0_wp*(x0(3) - zc)*s + 2.0_wp*v0(3)/n*(1.0_wp - c)
    x(2) = x0(2)*c + v0(2)/n*s
    x(3) = zc + (x0(3) - zc)*c + v0(3)/n*s
  end function orbit_at

  !> A net of one node and no cable, and a target, over one orbit; order 4 and 2.
  subroutine clohessy_wiltshire()
    real(wp), parameter :: n = 0.5_wp, x0(3) = [3.0_wp, -1.0_wp, 2.0_wp], v0(3) = [-0.4_wp, 0.6_wp, 0.3_wp], t = 12.0_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: position(1, 3), velocity(1, 3), inertia(3, 3), node(2), body(2)
    integer :: i, j, steps, no_cable(2, 0)
    real(wp) :: none(0)
    inertia = 0.0_wp
    inertia(1, 1) = 1.0_wp
    inertia(2, 2) = 1.0_wp
    inertia(3, 3) = 1.0_wp
    position(1, :) = x0
    velocity(1, :) = v0
    do i = 1, 2
      do j = 1, 2
        steps = 1200*j
        call net_of([0.3_wp], [.false.], no_cable, none, none, none, .true., position, velocity, model, state)
        call add_spinning_body(inertia, [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.0_wp], model, state)
        state%target%position = x0
        state%target%velocity = v0
        model%orbit_rate = n
        call ready(model, state, work, methods(i), t/steps)
        call fly(model, state, work, steps)
        node(j) = maxval(abs(state%node_position(1, :) - orbit_at(n, x0, v0, t)))
        body(j) = maxval(abs(state%target%position - orbit_at(n, x0, v0, t)))
      end do
      call note('orbit, errors of the node at h, h/2: '//words(node(1))//' '//words(node(2))//', of the target '// &
                words(body(1))//' '//words(body(2)))
      call expect_close(log(body(1)/body(2))/log(2.0_wp), 4.0_wp, 'order, target', atol=0.2_wp)
      call expect_close(log(node(1)/node(2))/log(2.0_wp), merge(4.0_wp, 2.0_wp, i == 1), 'order, node', atol=0.2_wp)
      call expect(body(2) < 1.0e-9_wp, 'target')
      call expect(node(2) < merge(1.0e-9_wp, 1.0e-3_wp, i == 1), 'node')
    end do
  end subroutine clohessy_wiltshire

  !> The frame turns at (0,-n,0) against inertial axes: an attitude q in them is
  !> exp((0,n t,0)) q in the frame. At rest in inertial axes; turning with the frame; tumbling.
  subroutine orbital_attitude()
    real(wp), parameter :: n = 0.3_wp, t = 8.0_wp
    real(wp), parameter :: start(4) = [0.5_wp, -0.5_wp, 0.5_wp, 0.5_wp], unturned(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: inertia(3, 3), turn(4), inertial(4)
    integer :: i
    inertia = 0.0_wp
    do i = 1, 3
      inertia(i, i) = real(i, wp)
    end do
    turn = quaternion_from_rotation_vector([0.0_wp, n*t, 0.0_wp])

    call run(start, [0.0_wp, 0.0_wp, 0.0_wp], n)
    call expect_close(state%target%attitude, quaternion_product(turn, start), 'at rest in inertial axes', atol=1.0e-12_wp)
    call run(unturned, [0.0_wp, -n, 0.0_wp], n)
    call expect_close(state%target%attitude, unturned, 'turning with the frame', atol=1.0e-12_wp)
    call run(start, [0.4_wp, 1.1_wp, -0.2_wp], 0.0_wp)
    inertial = state%target%attitude
    call run(start, [0.4_wp, 1.1_wp, -0.2_wp], n)
    call expect_close(state%target%attitude, quaternion_product(turn, inertial), 'tumbling', atol=1.0e-10_wp)

  contains

    subroutine run(attitude, spin, rate)
      real(wp), intent(in) :: attitude(4), spin(3), rate
      if (allocated(model%target)) deallocate (model%target, state%target)
      call add_spinning_body(inertia, attitude, spin, model, state)
      model%orbit_rate = rate
      call ready(model, state, work, method_rk4, 2.0e-3_wp)
      call fly(model, state, work, nint(t/2.0e-3_wp))
    end subroutine run

  end subroutine orbital_attitude

  !> Kinetic and elastic energy less the work of the frame: constant to the method's order
  !> for taut cables without damping, a free and a fixed node, and a tumbling target.
  subroutine jacobi_integral()
    integer, parameter :: nodes = 5
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: inertia(3, 3), x(nodes, 3), v(nodes, 3), error(2), start, r(15)
    integer :: i, j, k, seed, cables(2, 4)
    seed = 4711
    call random_numbers(seed, r)
    x = reshape(r, [nodes, 3])
    do k = 1, nodes
      x(k, 1) = x(k, 1) + 2.0_wp*k
    end do
    call random_numbers(seed, r)
    v = reshape(r, [nodes, 3])
    v(1, :) = 0.0_wp
    cables = reshape([1, 2, 2, 3, 3, 4, 4, 5], [2, 4])
    inertia = 0.0_wp
    do i = 1, 3
      inertia(i, i) = real(i, wp)
    end do
    do i = 1, 2
      do j = 1, 2
        call net_of([0.3_wp, 0.1_wp, 0.2_wp, 0.1_wp, 0.4_wp], [.true., .false., .false., .false., .false.], cables, &
                    [8.0_wp, 5.0_wp, 6.0_wp, 7.0_wp], [0.1_wp, 0.1_wp, 0.1_wp, 0.1_wp], [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
                    .true., x, v, model, state)
        call add_spinning_body(inertia, [0.5_wp, -0.5_wp, 0.5_wp, 0.5_wp], [0.5_wp, 1.0_wp, -0.7_wp], model, state)
        state%target%position = [1.0_wp, 2.0_wp, 3.0_wp]
        model%orbit_rate = 0.6_wp
        start = mechanical_energy(model, state)
        call ready(model, state, work, methods(i), 4.0e-3_wp/j)
        call fly(model, state, work, 1000*j)
        error(j) = abs(mechanical_energy(model, state) - state%ledger%external_work - start)
      end do
      call expect(abs(state%ledger%external_work) > 0.1_wp*start, 'the frame does work')
      call note('Jacobi''s integral, relative change at h, h/2: '//words(error(1)/start)//' '//words(error(2)/start))
      call expect(error(2) < merge(1.0e-8_wp, 1.0e-4_wp, i == 1)*start, 'small')
      call expect(error(2) < error(1)/merge(12.0_wp, 3.0_wp, i == 1), 'of the method''s order')
      call expect(maxval(abs(state%node_position(1, :) - x(1, :))) <= 0.0_wp, 'a fixed node stays')
    end do
  end subroutine jacobi_integral

  !> Its surface does not move: the node's velocity is mirrored on the face.
  subroutine fixed_in_orbit()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: inertia(3, 3), position(1, 3), velocity(1, 3)
    integer :: no_cable(2, 0)
    real(wp) :: none(0)
    inertia = 0.0_wp
    inertia(1, 1) = 1.0_wp
    inertia(2, 2) = 1.0_wp
    inertia(3, 3) = 1.0_wp
    position(1, :) = [0.505_wp, 0.3_wp, 0.8_wp]
    velocity(1, :) = [-1.0_wp, 0.2_wp, -0.3_wp]
    call net_of([0.3_wp], [.false.], no_cable, none, none, none, .true., position, velocity, model, state)
    call add_spinning_body(inertia, [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.0_wp], model, state)
    model%target%fixed = .true.
    model%target%inverse_mass = 0.0_wp
    model%target%inverse_inertia = 0.0_wp
    call new_shape(model%target%shape, 'box', [1.0_wp, 1.0_wp, 2.0_wp], error)
    allocate (model%contact, state%impulse_histogram(impulse_bins))
    state%impulse_histogram = 0
    model%contact%threshold = 0.01_wp
    model%orbit_rate = 0.5_wp
    call new_contact_work(work, model)
    call handle_contacts(model, state, work, error)
    call expect_close(state%node_velocity(1, :), [1.0_wp, 0.2_wp, -0.3_wp], 'mirrored', atol=1.0e-14_wp)
  end subroutine fixed_in_orbit

  !> A chain between a wall and an end that is pulled away at v and swung aside: energy and
  !> damping's loss are what the support has put in, to the order of the method.
  subroutine moving_support()
    integer, parameter :: n = 6
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: s(n), mass(n), start, error(2)
    logical :: fixed(n)
    integer :: i, j
    s = [(0.11_wp*j, j=1, n)]
    mass = 0.02_wp
    fixed = .false.
    fixed([1, n]) = .true.
    do i = 1, 2
      do j = 1, 2
        call chain(s, [0.0_wp, 0.6_wp, 0.8_wp], mass, fixed, 50.0_wp, 0.1_wp, 0.05_wp, model, state)
        state%node_velocity(n, :) = [0.05_wp, 0.2_wp, 0.3_wp]
        start = mechanical_energy(model, state)
        call ready(model, state, work, methods(i), 2.0e-3_wp/j)
        call fly(model, state, work, 300*j)
        error(j) = abs(mechanical_energy(model, state) + state%ledger%dissipated - state%ledger%external_work - start)
      end do
      call expect(state%ledger%external_work > 0.5_wp*start, 'the support has worked')
      call expect_close(state%node_position(n, :), 0.66_wp*[0.0_wp, 0.6_wp, 0.8_wp] + 0.6_wp*[0.05_wp, 0.2_wp, 0.3_wp], &
                        'and moved as it was told', atol=1.0e-13_wp)
      call note('work of a support '//words(state%ledger%external_work)//' J, balance off by '//words(error(1))//' '// &
                words(error(2))//' J at h, h/2')
      call expect(error(2) < error(1)/merge(12.0_wp, 3.0_wp, i == 1), 'the balance is of the method''s order')
      call expect(error(2) < merge(1.0e-6_wp, 1.0e-2_wp, i == 1)*start, 'and small')
    end do
  end subroutine moving_support

  !> One node against a spinning box off its centre, e = 1: impulses are elastic against the
  !> turning frame, and the integral ½ m v² + ½ w I w - W . L stays to round-off.
  subroutine impact_in_orbit()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: inertia(3, 3), position(1, 3), velocity(1, 3), start, ended
    integer :: no_cable(2, 0)
    real(wp) :: none(0)
    inertia = 0.0_wp
    inertia(1, 1) = 1.0_wp
    inertia(2, 2) = 2.0_wp
    inertia(3, 3) = 3.0_wp
    position(1, :) = [0.505_wp, 0.3_wp, 0.8_wp]
    velocity(1, :) = [-1.0_wp, 0.2_wp, -0.3_wp]
    call net_of([0.3_wp], [.false.], no_cable, none, none, none, .true., position, velocity, model, state)
    call add_spinning_body(inertia, [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [0.2_wp, 0.1_wp, -0.3_wp], model, state)
    call new_shape(model%target%shape, 'box', [1.0_wp, 1.0_wp, 2.0_wp], error)
    allocate (model%contact, state%impulse_histogram(impulse_bins))
    state%impulse_histogram = 0
    model%contact%threshold = 0.01_wp
    model%orbit_rate = 0.5_wp
    call new_contact_work(work, model)
    start = mechanical_energy(model, state)
    call handle_contacts(model, state, work, error)
    ended = mechanical_energy(model, state)
    call expect(.not. allocated(error), 'no error')
    call expect(state%tally%contacts == 1, 'one contact')
    call expect(abs(ended - start) > 0.01_wp*start, 'the inertial energies change')
    call expect_close(ended - state%ledger%external_work + state%ledger%contact_loss, start, 'the integral', rtol=1.0e-14_wp)
    call expect_close(state%ledger%contact_loss, 0.0_wp, 'no loss', atol=1.0e-14_wp*start)
  end subroutine impact_in_orbit

end module verify_environment
