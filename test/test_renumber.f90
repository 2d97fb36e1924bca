!> Nets in random order get their lattice back, and nobody outside sees it.
module test_renumber
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, method_midpoint
  use castnet_net, only: net_t
  use castnet_net_builder, only: finish_net
  use castnet_renumber, only: renumber_net, in_original_order
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: build, cubesat_shot, net_of, ready, fly, random_numbers, permutation
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_renumber

contains

  subroutine run_test_renumber()
    call test_case('renumber: a shuffled square net runs along diagonals again', lattice)
    call test_case('renumber: with cables missing here and there too', holes)
    call test_case('renumber: numbers and arrays come back as they were', round_trip)
    call test_case('renumber: a ring of odd length and a lone node are left whole', no_lattice)
    call test_case('renumber: a shuffled net flies as the square one does', same_flight)
  end subroutine run_test_renumber

  !> The cubesat's net with its nodes and cables in random order.
  subroutine shuffled(model, state, node)
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    integer, allocatable, intent(out) :: node(:)  !! shuffled number of each node of the square net
    type(model_t) :: square
    type(state_t) :: start
    integer, allocatable :: cable(:)
    integer :: seed, n, m
    call build(cubesat_shot(), square, start)
    n = square%net%n_node
    m = square%net%n_cable
    seed = 20
    node = permutation(n, seed)
    cable = permutation(m, seed)
    allocate (model%net)
    model%net = square%net
    associate (net => model%net, old => square%net)
      net%node_mass(node) = old%node_mass
      net%fixed(node) = old%fixed
      net%is_bullet(node) = old%is_bullet
      net%bullet_nodes = node(old%bullet_nodes)
      net%perimeter_nodes = node(old%perimeter_nodes)
      net%corner_nodes = node(old%corner_nodes)
      net%faces = reshape(node(reshape(old%faces, [size(old%faces)])), shape(old%faces))
      net%cable_nodes(1, cable) = node(old%cable_nodes(2, :))
      net%cable_nodes(2, cable) = node(old%cable_nodes(1, :))
      net%natural_length(cable) = old%natural_length
      net%axial_stiffness(cable) = old%axial_stiffness
      net%damping(cable) = old%damping
    end associate
    call finish_net(model%net)
    state = start
    state%node_position(node, :) = start%node_position(:n, :)
    state%node_velocity(node, :) = start%node_velocity(:n, :)
  end subroutine shuffled

  !> All cables but the four of the corners, and a handful beside them, in few diagonals.
  subroutine lattice()
    type(model_t) :: model
    type(state_t) :: state
    integer, allocatable :: node(:)
    real(wp), allocatable :: x(:, :), v(:, :)
    call shuffled(model, state, node)
    call expect(model%net%plan%n_loose > 200, 'shuffled: nearly every cable is loose')
    x = state%node_position(:model%net%n_node, :)
    v = state%node_velocity(:model%net%n_node, :)
    call renumber_net(model%net, x, v)
    call finish_net(model%net)
    call expect(model%net%plan%n_loose <= 4, 'renumbered: only corner cables are loose')
    call expect(model%net%plan%n_diagonal == 2, 'renumbered: two diagonals')
  end subroutine lattice

  !> Every fiftieth cable of the shuffled net is gone.
  subroutine holes()
    type(model_t) :: model
    type(state_t) :: state
    integer, allocatable :: node(:), kept(:)
    real(wp), allocatable :: x(:, :), v(:, :)
    integer :: c
    call shuffled(model, state, node)
    associate (net => model%net)
      ! The bullets' cables stay: without them a bullet would be a lone node.
      kept = pack([(c, c=1, net%n_cable)], [(modulo(c, 50) /= 7 .or. any(net%is_bullet(net%cable_nodes(:, c))), c=1, net%n_cable)])
      net%n_cable = size(kept)
      net%cable_nodes = net%cable_nodes(:, kept)
      net%natural_length = net%natural_length(kept)
      net%axial_stiffness = net%axial_stiffness(kept)
      net%damping = net%damping(kept)
    end associate
    call finish_net(model%net)
    x = state%node_position(:model%net%n_node, :)
    v = state%node_velocity(:model%net%n_node, :)
    call renumber_net(model%net, x, v)
    call finish_net(model%net)
    call expect(model%net%plan%n_loose <= 4, 'only corner cables are loose')
    call expect(model%net%plan%n_diagonal == 2, 'two diagonals')
  end subroutine holes

  subroutine round_trip()
    type(model_t) :: model
    type(state_t) :: state
    type(net_t) :: before, after
    integer, allocatable :: node(:)
    real(wp), allocatable :: x(:, :), v(:, :)
    call shuffled(model, state, node)
    before = model%net
    x = state%node_position(:before%n_node, :)
    v = state%node_velocity(:before%n_node, :)
    call renumber_net(model%net, x, v)
    call finish_net(model%net)
    after = in_original_order(model%net)
    call expect(.not. allocated(after%original_node), 'no longer renumbered')
    call expect(all(after%cable_nodes == before%cable_nodes), 'cables')
    call expect(all(after%faces == before%faces), 'faces')
    call expect(all(after%bullet_nodes == before%bullet_nodes), 'bullets')
    call expect(all(after%perimeter_nodes == before%perimeter_nodes), 'perimeter')
    call expect(all(after%is_bullet .eqv. before%is_bullet), 'flags')
    call expect_close(after%node_mass, before%node_mass, 'masses', atol=0.0_wp)
    call expect_close(after%inverse_mass, before%inverse_mass, 'inverse masses', atol=0.0_wp)
    call expect_close(x(:, 2), state%node_position(model%net%original_node, 2), 'positions', atol=0.0_wp)
    call expect_close(v(:, 1), state%node_velocity(model%net%original_node, 1), 'velocities', atol=0.0_wp)
  end subroutine round_trip

  subroutine no_lattice()
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: x(8, 3), v(8, 3)
    integer :: i, cables(2, 7)
    logical :: seen(8)
    do i = 1, 7
      cables(:, i) = [modulo(3*i, 7) + 1, modulo(3*i + 3, 7) + 1]
    end do
    call random_positions(x)
    v = 0.0_wp
    call net_of([(real(i, wp), i=1, 8)], [(.false., i=1, 8)], cables, [(1.0_wp, i=1, 7)], [(1.0_wp, i=1, 7)], &
                [(0.0_wp, i=1, 7)], .true., x, v, model, state)
    call renumber_net(model%net, x, v)
    if (.not. allocated(model%net%original_node)) return
    seen = .false.
    seen(model%net%original_node) = .true.
    call expect(all(seen), 'every node once')
    call expect_close(model%net%node_mass, real(model%net%original_node, wp), 'masses go along', atol=0.0_wp)
  end subroutine no_lattice

  subroutine random_positions(x)
    real(wp), intent(out) :: x(:, :)
    integer :: seed, c
    seed = 3
    do c = 1, 3
      call random_numbers(seed, x(:, c))
    end do
  end subroutine random_positions

  !> Before chaos, 0.05 s: the same positions to rounding's growth.
  subroutine same_flight()
    type(model_t) :: square, model
    type(state_t) :: start, state
    type(work_t) :: work
    integer, allocatable :: node(:)
    real(wp), allocatable :: x(:, :), v(:, :)
    real(wp), parameter :: h = 5.0e-5_wp
    integer :: n
    call build(cubesat_shot(), square, start)
    call ready(square, start, work, method_midpoint, h)
    call fly(square, start, work, 1000)
    call shuffled(model, state, node)
    n = model%net%n_node
    x = state%node_position(:n, :)
    v = state%node_velocity(:n, :)
    call renumber_net(model%net, x, v)
    call finish_net(model%net)
    state%node_position(:n, :) = x
    state%node_velocity(:n, :) = v
    call ready(model, state, work, method_midpoint, h)
    call fly(model, state, work, 1000)
    x(model%net%original_node, :) = state%node_position(:n, :)
    call expect_close(x(node, 2), start%node_position(:n, 2), 'positions', atol=1.0e-8_wp)
  end subroutine same_flight

end module test_renumber
