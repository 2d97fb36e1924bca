!> The square net of physics.md section 1, and the plan that the force kernel runs by.
module test_net_builder
  use castnet_kinds, only: wp
  use castnet_constants, only: pi, degree
  use castnet_integrator, only: flow_work_t, new_flow_work, midpoint_step
  use castnet_model, only: model_t
  use castnet_scene, only: scene_t
  use castnet_state, only: state_t
  use scenes, only: cubesat_shot, rocket_shot, parabolic_shot, shot, build, net_of, random_numbers, words
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_net_builder, compare_forces, random_net

contains

  subroutine run_test_net_builder()
    call test_case('net_builder: the paper''s nets have the paper''s masses', masses)
    call test_case('net_builder: nodes, cables, faces and lengths count up', counts)
    call test_case('net_builder: the perimeter is a closed loop of neighbours', perimeter)
    call test_case('net_builder: faces are mesh squares', faces)
    call test_case('net_builder: bullets hang outside the corners and fly outward', bullets)
    call test_case('net_builder: stiffness and damping of each cable', material)
    call test_case('net_builder: a stowed net is slack and at rest', stowed)
    call test_case('cable_plan: square nets feel what each cable pulls', plan_square)
    call test_case('cable_plan: any graph feels what each cable pulls', plan_graph)
    call test_case('cable_plan: chains, double cables, one node', plan_special)
    call test_case('cable_plan: its size grows with the net only', plan_size)
  end subroutine run_test_net_builder

  !> 0.0428 +- 0.0001 and 1.4250 +- 0.0005 kg without bullets and corner cables; from the
  !> lengths: 1440 kg/m3 times (12.6 m of 1 mm + 2.8 m of 3 mm) and times 1260 m of 1 mm.
  subroutine masses()
    real(wp), parameter :: area = 0.25_wp*pi*1.0e-6_wp
    real(wp) :: net
    net = net_mass(cubesat_shot())
    call note('cubesat net '//words(net)//' kg, rocket net '//words(net_mass(rocket_shot()))//' kg')
    call expect_close(net, 0.0428_wp, 'cubesat net', atol=1.0e-4_wp)
    call expect_close(net, 1440.0_wp*area*(12.6_wp + 9.0_wp*2.8_wp), 'cubesat net by lengths', rtol=1.0e-13_wp)
    net = net_mass(rocket_shot())
    call expect_close(net, 1.4250_wp, 'rocket net', atol=5.0e-4_wp)
    call expect_close(net, 1440.0_wp*area*1260.0_wp, 'rocket net by lengths', rtol=1.0e-13_wp)
    net = net_mass(parabolic_shot())
    call expect_close(net, 1440.0_wp*area*(14.4_wp + 9.0_wp*3.2_wp), 'parabolic net by lengths', rtol=1.0e-13_wp)
  end subroutine masses

  real(wp) function net_mass(scene)
    type(scene_t), intent(in) :: scene
    type(model_t) :: model
    type(state_t) :: state
    call build(scene, model, state)
    net_mass = sum(model%net%node_mass, mask=.not. model%net%is_bullet)
  end function net_mass

  !> (ny+1)(nz+1) knots, (nz+1) ny + (ny+1) nz sides of `per_side` cables, 4 corner cables;
  !> rectangles too. The lengths add up whatever the division.
  subroutine counts()
    integer, parameter :: ny(3) = [3, 5, 1], nz(3) = [3, 2, 4]
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    integer :: per_side, k, sides, bullets
    do per_side = 1, 3
      do k = 1, 3
        do bullets = 0, 4, 4
          scene = shot([ny(k), nz(k)], 0.2_wp, 1.0e-3_wp, 2.0e-3_wp, 0.5_wp, 2.0_wp)
          scene%net%cables_per_side = per_side
          if (bullets == 0) deallocate (scene%bullets)
          call build(scene, model, state)
          sides = (nz(k) + 1)*ny(k) + (ny(k) + 1)*nz(k)
          associate (net => model%net)
            call expect_equal(net%n_node, (ny(k) + 1)*(nz(k) + 1) + sides*(per_side - 1) + bullets, 'nodes')
            call expect_equal(net%n_cable, sides*per_side + bullets, 'cables')
            call expect_equal(size(net%faces, 2), ny(k)*nz(k), 'faces')
            call expect_equal(size(net%bullet_nodes), bullets, 'bullets')
            call expect_equal(count(net%is_bullet), bullets, 'nodes that are bullets')
            call expect_equal(size(net%perimeter_nodes), 2*(ny(k) + nz(k))*per_side, 'perimeter')
            call expect_close(sum(net%natural_length(:sides*per_side)), 0.2_wp*sides, 'length', rtol=1.0e-13_wp)
            call expect_close(net%side_length, 0.2_wp*max(ny(k), nz(k)), 'longer side', rtol=1.0e-14_wp)
            call expect(.not. any(net%fixed), 'nothing is fixed')
            call expect(modulo(net%n_pad, 8) == 0 .and. net%n_pad >= net%n_node, 'padding')
            call expect(all(net%inverse_mass(net%n_node + 1:) == 0.0_wp), 'padding without mass')
            call expect_close(net%inverse_mass(:net%n_node)*net%node_mass, spread(1.0_wp, 1, net%n_node), '1/mass', rtol=1.0e-15_wp)
          end associate
        end do
      end do
    end do
  end subroutine counts

  !> Every node of the loop once, neighbours joined by a cable of the edge, the corners in
  !> order, every node of it on the net's outline.
  subroutine perimeter()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    integer :: per_side, i, n, a, b, at(4)
    real(wp) :: y, z
    do per_side = 1, 3
      scene = shot([4, 3], 0.2_wp, 1.0e-3_wp, 2.0e-3_wp, 0.5_wp, 2.0_wp)
      scene%net%cables_per_side = per_side
      scene%net%stowed_scale = 1.0_wp
      call build(scene, model, state)
      associate (net => model%net, loop => model%net%perimeter_nodes)
        n = size(loop)
        do i = 1, n
          a = loop(i)
          b = loop(modulo(i, n) + 1)
          call expect_equal(count(loop == a), 1, 'times that a node is in the loop')
          call expect(any((net%cable_nodes(1, :) == a .and. net%cable_nodes(2, :) == b) .or. &
                          (net%cable_nodes(1, :) == b .and. net%cable_nodes(2, :) == a)), 'a cable joins neighbours')
          y = abs(state%node_position(a, 2))
          z = abs(state%node_position(a, 3))
          call expect(abs(y - 0.4_wp) < 1.0e-14_wp .or. abs(z - 0.3_wp) < 1.0e-14_wp, 'on the outline')
          call expect(.not. net%is_bullet(a), 'no bullet')
        end do
        do i = 1, 4
          at(i) = findloc(loop, net%corner_nodes(i), dim=1)
        end do
        call expect(at(1) == 1 .and. all(at(2:) > at(:3)), 'corners in order')
      end associate
    end do
  end subroutine perimeter

  !> Four corners one mesh apart, round a square, all of one sense.
  subroutine faces()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: corner(4, 2), side(2), next(2)
    integer :: f, i
    scene = shot([4, 3], 0.2_wp, 1.0e-3_wp, 2.0e-3_wp, 0.5_wp, 2.0_wp)
    scene%net%stowed_scale = 1.0_wp
    scene%net%cables_per_side = 2
    call build(scene, model, state)
    do f = 1, size(model%net%faces, 2)
      corner = state%node_position(model%net%faces(:, f), 2:3)
      do i = 1, 4
        side = corner(modulo(i, 4) + 1, :) - corner(i, :)
        next = corner(modulo(i + 1, 4) + 1, :) - corner(modulo(i, 4) + 1, :)
        call expect_close(sqrt(sum(side**2)), 0.2_wp, 'side', rtol=1.0e-13_wp)
        call expect_close(side(1)*next(2) - side(2)*next(1), 0.04_wp, 'corner', rtol=1.0e-13_wp)
      end do
    end do
  end subroutine faces

  !> On the diagonals, stowed_scale x the corner cable outside the stowed corner; 25 degrees
  !> from +x, outward; the massless cables leave the bullets their own mass.
  subroutine bullets()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: reach, c, s, mean(3)
    integer :: i, b, k
    scene = cubesat_shot()
    call build(scene, model, state)
    ! Half diagonal of the stowed net and the stowed corner cable, sqrt(2) meshes long.
    reach = 0.15_wp*(0.5_wp*0.7_wp*sqrt(2.0_wp) + 0.07_wp*sqrt(2.0_wp))
    c = 1.8_wp*cos(25.0_wp*degree)
    s = 1.8_wp*sin(25.0_wp*degree)*sqrt(0.5_wp)
    associate (net => model%net, x => state%node_position, v => state%node_velocity)
      do i = 1, 4
        b = net%bullet_nodes(i)
        k = net%corner_nodes(i)
        call expect_close(net%node_mass(b), 0.03_wp, 'mass', rtol=1.0e-15_wp)
        call expect_close(x(b, 1), 0.0_wp, 'in the plane of the net')
        call expect_close(abs(x(b, 2:3)), [reach, reach]*sqrt(0.5_wp), 'on the diagonal', rtol=1.0e-14_wp)
        call expect(all(x(b, 2:3)*x(k, 2:3) > 0.0_wp), 'outside its own corner')
        call expect_close(v(b, :), [c, sign(s, x(b, 2)), sign(s, x(b, 3))], 'velocity', rtol=1.0e-14_wp)
        call expect(any(net%cable_nodes(1, :) == k .and. net%cable_nodes(2, :) == b), 'its cable')
      end do
      mean = sum(v, 1)
      call expect_close(mean, [4.0_wp*c, 0.0_wp, 0.0_wp], 'sum of velocities', atol=1.0e-15_wp)
    end associate

    ! A rectangle: along its own diagonals.
    scene = shot([4, 3], 0.2_wp, 1.0e-3_wp, 2.0e-3_wp, 0.5_wp, 2.0_wp)
    scene%bullets%corner_cable_length = 0.5_wp
    call build(scene, model, state)
    associate (net => model%net, x => state%node_position, v => state%node_velocity)
      do i = 1, 4
        b = net%bullet_nodes(i)
        call expect_close(abs(x(b, :)), 0.15_wp*[0.0_wp, 0.4_wp + 0.4_wp, 0.3_wp + 0.3_wp], 'rectangle', atol=1.0e-15_wp)
        call expect_close(abs(v(b, 2:3)), 2.0_wp*sin(25.0_wp*degree)*[0.8_wp, 0.6_wp], 'rectangle', rtol=1.0e-14_wp)
      end do
    end associate
  end subroutine bullets

  !> EA by the cable's own diameter; c = 2 zeta sqrt(k mu) of its two end nodes.
  subroutine material()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    real(wp), parameter :: thin = 4.456e8_wp*0.25_wp*pi*1.0e-6_wp
    real(wp) :: m(2), k, stiffness
    integer :: c, sides, n_edge
    scene = cubesat_shot()
    scene%net%cables_per_side = 2
    scene%net%damping_ratio = 0.3_wp
    call build(scene, model, state)
    sides = 2*11*10
    n_edge = 0
    do c = 1, model%net%n_cable
      m = model%net%node_mass(model%net%cable_nodes(:, c))
      k = model%net%axial_stiffness(c)/model%net%natural_length(c)
      call expect_close(model%net%damping(c), 2.0_wp*0.3_wp*sqrt(k*m(1)*m(2)/(m(1) + m(2))), 'damping', rtol=1.0e-13_wp)
      stiffness = model%net%axial_stiffness(c)
      if (c > 2*sides) then
        call expect_close(stiffness, 9.0_wp*thin, 'corner cable', rtol=1.0e-13_wp)
        call expect_close(model%net%natural_length(c), 0.07_wp*sqrt(2.0_wp), 'corner cable''s length', rtol=1.0e-14_wp)
      else if (stiffness > 2.0_wp*thin) then
        n_edge = n_edge + 1
        call expect_close(stiffness, 9.0_wp*thin, 'edge cable', rtol=1.0e-13_wp)
        call expect(any(model%net%perimeter_nodes == model%net%cable_nodes(1, c)) .and. &
                    any(model%net%perimeter_nodes == model%net%cable_nodes(2, c)), 'an edge cable is on the edge')
      else
        call expect_close(stiffness, thin, 'inner cable', rtol=1.0e-13_wp)
      end if
    end do
    call expect_equal(n_edge, 2*40, 'edge cables')
  end subroutine material

  subroutine stowed()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: d(3)
    integer :: c, n
    scene = rocket_shot()
    scene%net%cables_per_side = 2
    call build(scene, model, state)
    n = model%net%n_node - 4
    do c = 1, model%net%n_cable
      d = state%node_position(model%net%cable_nodes(2, c), :) - state%node_position(model%net%cable_nodes(1, c), :)
      call expect_close(sqrt(sum(d**2)), 0.15_wp*model%net%natural_length(c), 'stowed length', rtol=1.0e-12_wp)
    end do
    call expect(all(state%node_velocity(:n, :) == 0.0_wp), 'at rest')
    call expect_close(sum(state%node_position(:n, :), 1), [0.0_wp, 0.0_wp, 0.0_wp], 'about the origin', atol=1.0e-10_wp)
    call expect_close(maxval(state%node_position(:n, 2)), 0.15_wp*15.0_wp, 'half a side', rtol=1.0e-14_wp)
  end subroutine stowed

  !> Forces and dissipated power of one state by the plan, taken from a kick of one second:
  !> the midpoint step with h = 1 from rest reads x and velocity_ahead and gives v = a.
  subroutine forces_by_plan(model, x, v, n_thread, force, power)
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: x(:, :), v(:, :)
    integer, intent(in) :: n_thread
    real(wp), intent(out) :: force(:, :), power
    type(state_t) :: state
    type(flow_work_t) :: work
    integer :: i, n
    n = model%net%n_node
    allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3), &
              state%velocity_ahead(model%net%n_pad, 3), source=0.0_wp)
    state%node_position(:n, :) = x
    state%velocity_ahead(:n, :) = v
    call new_flow_work(work, model, n_thread)
    call midpoint_step(model, state, work, 1.0_wp)
    do i = 1, n
      force(i, :) = state%node_velocity(i, :)*model%net%node_mass(i)
    end do
    power = state%ledger%dissipated
    call expect(all(state%node_velocity(n + 1:, :) == 0.0_wp), 'padding stays at rest')
  end subroutine forces_by_plan

  !> The law of physics.md section 1, cable by cable.
  subroutine forces_by_cable(model, x, v, force, power)
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: x(:, :), v(:, :)
    real(wp), intent(out) :: force(:, :), power
    real(wp) :: d(3), l, rate, k, t
    integer :: c, a, b
    force = 0.0_wp
    power = 0.0_wp
    associate (net => model%net)
      do c = 1, net%n_cable
        a = net%cable_nodes(1, c)
        b = net%cable_nodes(2, c)
        d = x(b, :) - x(a, :)
        l = sqrt(sum(d**2))
        if (l <= net%natural_length(c)) cycle
        rate = sum(d*(v(b, :) - v(a, :)))/l
        k = net%axial_stiffness(c)/net%natural_length(c)
        t = k*(l - net%natural_length(c)) + net%damping(c)*rate
        if (net%clamp_tension) t = max(0.0_wp, t)
        force(a, :) = force(a, :) + t*d/l
        force(b, :) = force(b, :) - t*d/l
        power = power + (t - k*(l - net%natural_length(c)))*rate
      end do
      do a = 1, net%n_node
        if (net%fixed(a)) force(a, :) = 0.0_wp
      end do
    end associate
  end subroutine forces_by_cable

  !> Plan against loop on a random state, clamped or not, 1 and 3 threads: a node's sum has
  !> few terms, so the largest difference is a few units of round-off of the largest force.
  subroutine compare_forces(model, x, v, words_)
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: x(:, :), v(:, :)
    character(len=*), intent(in) :: words_
    real(wp), dimension(model%net%n_node, 3) :: plan, cables
    real(wp) :: plan_power, power, scale
    integer :: pass
    do pass = 1, 4
      model%net%clamp_tension = pass <= 2
      call forces_by_plan(model, x, v, merge(1, 3, modulo(pass, 2) == 1), plan, plan_power)
      call forces_by_cable(model, x, v, cables, power)
      scale = maxval(abs(cables)) + tiny(1.0_wp)
      call expect(maxval(abs(plan - cables)) <= 2.0e-13_wp*scale, words_//': forces')
      call expect_close(plan_power, power, words_//': power', rtol=1.0e-12_wp)
    end do
  end subroutine compare_forces

  subroutine plan_square()
    integer, parameter :: squares(2, 5) = reshape([10, 10, 30, 30, 1, 1, 40, 2, 3, 25], [2, 5])
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    real(wp), allocatable :: r(:), x(:, :), v(:, :)
    integer :: k, per_side, seed, n
    seed = 20240501
    do per_side = 1, 3
      do k = 1, size(squares, 2)
        scene = shot(squares(:, k), 0.07_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp)
        scene%net%cables_per_side = per_side
        scene%net%stowed_scale = 1.0_wp
        scene%net%damping_ratio = 0.5_wp
        call build(scene, model, state)
        n = model%net%n_node
        allocate (r(3*n))
        ! Half of the cables slack, rates that make many tensions negative.
        call random_numbers(seed, r)
        x = state%node_position(:n, :) + 0.02_wp*reshape(r, [n, 3])
        call random_numbers(seed, r)
        v = 20.0_wp*reshape(r, [n, 3])
        deallocate (r)
        call compare_forces(model, x, v, 'square net')
      end do
    end do
  end subroutine plan_square

  !> Random graphs with repeated cables, runs and strays, both ways round, some nodes fixed.
  subroutine plan_graph()
    type(model_t) :: model
    integer :: seed, trial, n, m, c, a, b, run, diagonals, loose  ! cables from a to a + b
    integer, allocatable :: cables(:, :)
    real(wp) :: r(4)
    logical, allocatable :: fixed(:)
    real(wp), allocatable :: x(:, :), v(:, :)
    seed = 77
    diagonals = 0
    loose = 0
    do trial = 1, 30
      call random_numbers(seed, r)
      n = 2 + int(200.0_wp*(1.0_wp + r(1)))
      m = 1 + int(300.0_wp*(1.0_wp + r(2)))
      allocate (cables(2, m), fixed(n), x(n, 3), v(n, 3))
      run = 0
      do c = 1, m
        call random_numbers(seed, r)
        if (run > 0) then          ! go on along a diagonal, with gaps
          run = run - 1
          a = a + 1 + merge(int(3.0_wp*(1.0_wp + r(1))), 0, r(2) > 0.8_wp)
        else
          a = 1 + int(0.5_wp*(1.0_wp + r(1))*(n - 1))
          b = 1 + int(0.5_wp*(1.0_wp + r(2))*(n - 1))
          run = merge(60, 0, r(3) > 0.6_wp)
        end if
        if (a + b > n .or. b < 1) then
          a = 1
          b = n - 1
          run = 0
        end if
        cables(:, c) = merge([a, a + b], [a + b, a], r(4) > 0.0_wp)
      end do
      call random_net(seed, n, cables, fixed, x, v, model)
      diagonals = diagonals + model%net%plan%n_diagonal
      loose = loose + model%net%plan%n_loose
      call compare_forces(model, x, v, 'random graph')
      deallocate (cables, fixed, x, v)
    end do
    call note('random graphs: '//words(real(diagonals, wp))//' diagonals, '//words(real(loose, wp))//' loose cables')
    call expect(diagonals > 30 .and. loose > 100, 'both kinds have been met')
  end subroutine plan_graph

  subroutine plan_special()
    type(model_t) :: model
    integer :: seed, i, n, kind
    integer, allocatable :: cables(:, :)
    logical, allocatable :: fixed(:)
    real(wp), allocatable :: x(:, :), v(:, :)
    seed = 5
    do kind = 1, 6
      n = 300
      select case (kind)
      case (1)      ! a chain
        cables = reshape([(i, i + 1, i=1, n - 1)], [2, n - 1])
      case (2)      ! backwards
        cables = reshape([(i + 1, i, i=n - 1, 1, -1)], [2, n - 1])
      case (3)      ! every cable twice
        cables = reshape([(i, i + 2, i + 2, i, i=1, n - 2)], [2, 2*(n - 2)])
      case (4)      ! a star: every offset once
        cables = reshape([(1, i, i=2, n)], [2, n - 1])
      case (5)      ! gaps as wide as a diagonal takes, and one wider
        cables = reshape([(8*i, 8*i + 1, i=1, 18), (9*i, 9*i + 3, i=1, 30)], [2, 48])
      case (6)      ! two nodes
        n = 2
        cables = reshape([2, 1], [2, 1])
      end select
      allocate (fixed(n), x(n, 3), v(n, 3))
      call random_net(seed, n, cables, fixed, x, v, model)
      call compare_forces(model, x, v, 'special graph')
      deallocate (fixed, x, v)
    end do
    ! One node, no cable; two coincident nodes, whose cable has no direction and no tension.
    do n = 1, 2
      cables = reshape([1, 2], [2, n - 1])
      allocate (fixed(n), x(n, 3), v(n, 3))
      call random_net(seed, n, cables, fixed, x, v, model)
      x = 0.0_wp
      call compare_forces(model, x, v, 'coincident nodes')
      deallocate (fixed, x, v)
    end do
  end subroutine plan_special

  !> Random masses, stiffness, damping, places; every tenth node fixed.
  subroutine random_net(seed, n, cables, fixed, x, v, model)
    integer, intent(inout) :: seed
    integer, intent(in) :: n, cables(:, :)
    logical, intent(out) :: fixed(n)
    real(wp), intent(out) :: x(n, 3), v(n, 3)
    type(model_t), intent(out) :: model
    type(state_t) :: state
    real(wp) :: r(3*n), mass(n), s(3*size(cables, 2))
    integer :: i, m
    m = size(cables, 2)
    call random_numbers(seed, r)
    x = reshape(r, [n, 3])
    call random_numbers(seed, r)
    v = 5.0_wp*reshape(r, [n, 3])
    call random_numbers(seed, r)
    mass = 1.5_wp + r(:n)
    do i = 1, n
      fixed(i) = modulo(i, 10) == 7
    end do
    call random_numbers(seed, s)
    call net_of(mass, fixed, cables, 50.0_wp*(1.1_wp + s(:m)), 0.9_wp + 0.5_wp*s(m + 1:2*m), 1.0_wp + s(2*m + 1:), .true., &
                x, v, model, state)
  end subroutine random_net

  !> Divided mesh sides make hundreds of short diagonals: forces of cables are stored once,
  !> not once per node and diagonal (which took 300 MB here).
  subroutine plan_size()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(flow_work_t) :: work
    integer :: stored, s
    scene = shot([100, 100], 0.07_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp)
    scene%net%cables_per_side = 2
    call build(scene, model, state)
    call new_flow_work(work, model, 1)
    stored = 0
    do s = 1, size(work%cables%slabs)
      stored = stored + size(work%cables%slabs(s)%force) + size(work%cables%slabs(s)%rest)
    end do
    call note('divided net: '//words(real(model%net%plan%n_diagonal, wp))//' diagonals, '// &
              words(real(stored, wp)/model%net%n_cable)//' numbers stored per cable')
    call expect(stored <= 10*(model%net%n_cable + model%net%n_node), 'a few numbers per cable and node')
  end subroutine plan_size

end module test_net_builder
