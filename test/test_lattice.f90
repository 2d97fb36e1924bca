!> Nets of hexagons and triangles, round nets and irregular ones, all in random order: what becomes of
!> their cables, and whether the forces on their nodes are right whatever order they are summed in.
module test_lattice
  use, intrinsic :: iso_fortran_env, only: int64
  use bench_nets, only: shape_of
  use castnet_cable_layers, only: layers_t, arrange_layers
  use castnet_graph, only: graph_t, new_graph
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, method_adaptive, method_midpoint, method_rk4
  use castnet_net_builder, only: finish_net
  use castnet_node_paths, only: follow_paths
  use castnet_renumber, only: renumber_net
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: ready, fly, random_numbers, permutation, state_hash
  use test_net_builder, only: compare_forces, random_net
  use testing, only: test_case, expect, note
  implicit none
  private
  public :: run_test_lattice

  character(len=10), parameter :: kinds(5) = ['hexagonal ', 'radial    ', 'round     ', 'triangular', 'irregular ']

contains

  subroutine run_test_lattice()
    call test_case('lattice: hexagons become two diagonals', hexagons)
    call test_case('lattice: a spider''s net leaves its hub and a seam loose', spider)
    call test_case('lattice: a spiral has no seam', spiral)
    call test_case('lattice: triangles in a hexagon run along diagonals', triangles)
    call test_case('lattice: a lattice with strangers keeps its diagonals', strangers)
    call test_case('lattice: an irregular net is numbered along paths of its cables', paths)
    call test_case('lattice: loose cables begin evenly', even_layers)
    call test_case('lattice: forces on nets of every kind, cable by cable', forces)
    call test_case('lattice: the same bits on 1, 2 and 3 threads', same_bits)
  end subroutine run_test_lattice

  !> Nodes and cables in random order, ends swapped; random places, masses and cables.
  subroutine shuffled(cables, n, seed, model, x, v)
    integer, intent(in) :: cables(:, :), n
    integer, intent(inout) :: seed
    type(model_t), intent(out) :: model
    real(wp), allocatable, intent(out) :: x(:, :), v(:, :)
    integer :: node(n), cable(size(cables, 2)), other(2, size(cables, 2)), c
    logical :: fixed(n)
    node = permutation(n, seed)
    cable = permutation(size(cables, 2), seed)
    do c = 1, size(cables, 2)
      other(:, cable(c)) = node(cables(merge([1, 2], [2, 1], modulo(c, 3) == 0), c))
    end do
    allocate (x(n, 3), v(n, 3))
    call random_net(seed, n, other, fixed, x, v, model)
  end subroutine shuffled

  subroutine renumbered(cables, n, seed, model, x, v)
    integer, intent(in) :: cables(:, :), n
    integer, intent(inout) :: seed
    type(model_t), intent(out) :: model
    real(wp), allocatable, intent(out) :: x(:, :), v(:, :)
    call shuffled(cables, n, seed, model, x, v)
    call renumber_net(model%net, x, v)
    call finish_net(model%net)
  end subroutine renumbered

  !> However a net is shuffled, the lattice starts from another mesh.
  subroutine hexagons()
    type(model_t) :: model
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: cables(:, :)
    integer :: seed, i
    seed = 3
    do i = 1, 10
      call shape_of('hexagonal', 20 + i, x, cables)
      call renumbered(cables, size(x, 2), seed, model, x, v)
      call expect(model%net%plan%n_diagonal == 2, 'two diagonals')
      call expect(model%net%plan%n_loose <= 2, 'none loose but at the corners')
    end do
  end subroutine hexagons

  subroutine spider()
    type(model_t) :: model
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: cables(:, :)
    integer :: seed, i
    seed = 5
    do i = 20, 29
      call shape_of('radial', i, x, cables)
      call renumbered(cables, size(x, 2), seed, model, x, v)
      call expect(model%net%plan%n_diagonal == 2, 'two diagonals')
      ! The hub's spokes, and a cable of each ring.
      call expect(model%net%plan%n_loose <= 2*i + i/2, 'hub and seam')
    end do
  end subroutine spider

  !> A catching thread wound 12 times round 30 spokes: along it one diagonal, along the spokes another.
  subroutine spiral()
    integer, parameter :: spokes = 30, n = 12*spokes
    type(model_t) :: model
    real(wp), allocatable :: x(:, :), v(:, :)
    integer :: cables(2, 2*n - 1 - spokes), seed, i
    do i = 1, n - 1
      cables(:, i) = [i, i + 1]
    end do
    do i = 1, n - spokes
      cables(:, n - 1 + i) = [i, i + spokes]
    end do
    seed = 17
    call renumbered(cables, n, seed, model, x, v)
    call expect(model%net%plan%n_diagonal == 2, 'two diagonals')
    call expect(model%net%plan%n_loose == 0, 'no loose cable')
  end subroutine spiral

  !> Three diagonals; what joins the two halves across the fold is one row of cables in each of two directions.
  subroutine triangles()
    type(model_t) :: model
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: cables(:, :)
    integer :: seed, n, radius
    seed = 7
    do n = 20, 60, 10
      radius = nint(0.5774_wp*n)
      call shape_of('triangular', n, x, cables)
      call renumbered(cables, size(x, 2), seed, model, x, v)
      associate (plan => model%net%plan)
        call expect(plan%n_full == 3, 'three full diagonals')
        call expect(sum(plan%last(:3) - plan%first(:3) + 1) - count(plan%stiffness(:plan%start(3) + plan%last(3) - plan%first(3)) &
          <= 0.0_wp) == size(cables, 2) - 4*radius, 'all cables but those across the fold')
      end associate
    end do
  end subroutine triangles

  !> Nodes that follow a neighbour, counted cable by cable; the order holds every node once.
  subroutine paths()
    type(graph_t) :: graph
    real(wp), allocatable :: x(:, :)
    integer, allocatable :: cables(:, :), order(:), place(:)
    integer :: n, seed, i, c, followed
    do n = 11, 61, 25
      call shape_of('irregular', n, x, cables)
      seed = n
      place = permutation(size(x, 2), seed)
      cables = reshape(place(reshape(cables, [size(cables)])), shape(cables))
      call new_graph(size(x, 2), cables, huge(1), graph)
      allocate (order(size(x, 2)))
      call follow_paths(graph, order)
      place = 0
      do i = 1, size(order)
        call expect(place(order(i)) == 0, 'every node once')
        place(order(i)) = i
      end do
      followed = 0
      do c = 1, size(cables, 2)
        if (abs(place(cables(1, c)) - place(cables(2, c))) == 1) followed = followed + 1
      end do
      call expect(followed > 0.9_wp*size(x, 2), 'nine nodes of ten follow a neighbour')
      deallocate (order)
    end do
  end subroutine paths

  !> In a closed ring one cable can begin at every node, however the ring is numbered and its cables point:
  !> then there is one layer, and no phantom.
  subroutine even_layers()
    integer, parameter :: n = 300
    type(layers_t) :: layers
    integer :: cables(2, n), node(n), seed, i, from
    seed = 23
    do i = 1, 5
      node = permutation(n, seed)
      do from = 1, n
        cables(:, from) = node(merge([from, modulo(from, n) + 1], [modulo(from, n) + 1, from], modulo(from*i, 7) < 3))
      end do
      call arrange_layers(n, cables, layers)
      call expect(layers%n == n, 'no phantom')
      call expect(layers%n_layered == n, 'none single')
      call expect(all(layers%a == [(from, from=1, n)]), 'one begins at every node')
    end do
  end subroutine even_layers

  !> A few random cables across hexagons, and some chains: most of the lattice is still found.
  subroutine strangers()
    type(model_t) :: model
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: cables(:, :), more(:, :)
    real(wp) :: r(20)
    integer :: seed, n
    seed = 11
    call shape_of('hexagonal', 30, x, cables)
    n = size(x, 2)
    call random_numbers(seed, r)
    allocate (more(2, 10))
    more = min(n, 1 + int(0.5_wp*(1.0_wp + reshape(r, [2, 10]))*n))
    more(2, :) = merge(more(2, :), modulo(more(1, :), n) + 1, more(1, :) /= more(2, :))
    cables = reshape([cables, more, reshape([1, n + 1, n + 1, n + 2, n + 2, n + 3], [2, 3])], [2, size(cables, 2) + 13])
    call renumbered(cables, n + 3, seed, model, x, v)
    call note_plan(model)
    call expect(model%net%plan%n_loose < 0.15_wp*size(cables, 2), 'most cables are in diagonals')
  end subroutine strangers

  subroutine note_plan(model)
    type(model_t), intent(in) :: model
    character(len=80) :: line
    write (line, '(4(i0,a))') model%net%n_cable, ' cables: ', model%net%plan%n_diagonal, ' diagonals, ', &
      model%net%plan%n_layered, ' in layers, ', model%net%plan%n_loose - model%net%plan%n_layered, ' single'
    call note(trim(line))
  end subroutine note_plan

  subroutine forces()
    type(model_t) :: model
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: cables(:, :)
    integer :: seed, kind, n
    seed = 13
    do kind = 1, size(kinds)
      do n = 7, 57, 25
        call shape_of(trim(kinds(kind)), n, x, cables)
        call renumbered(cables, size(x, 2), seed, model, x, v)
        call compare_forces(model, x, v, trim(kinds(kind)))
      end do
      call note_plan(model)
    end do
  end subroutine forces

  subroutine same_bits()
    type(model_t) :: model
    type(state_t) :: state, start
    type(work_t) :: work
    real(wp), allocatable :: x(:, :), v(:, :)
    integer, allocatable :: cables(:, :)
    integer(int64) :: first
    integer :: seed, kind, method, n_thread
    seed = 19
    do kind = 1, size(kinds)
      call shape_of(trim(kinds(kind)), 45, x, cables)
      call renumbered(cables, size(x, 2), seed, model, x, v)
      allocate (start%node_position(model%net%n_pad, 3), start%node_velocity(model%net%n_pad, 3), source=0.0_wp)
      start%node_position(:size(x, 1), :) = x
      start%node_velocity(:size(x, 1), :) = v
      model%tolerance = 1.0e-6_wp
      do method = min(method_rk4, method_midpoint, method_adaptive), max(method_rk4, method_midpoint, method_adaptive)
        do n_thread = 1, 3
          state = start
          call ready(model, state, work, method, 1.0e-4_wp, n_thread)
          call fly(model, state, work, 3)
          if (n_thread == 1) first = state_hash(state)
          call expect(state_hash(state) == first, trim(kinds(kind))//': the same bits')
        end do
      end do
      deallocate (start%node_position, start%node_velocity)
      call expect(state%ledger%dissipated > 0.0_wp, 'cables have been taut')
    end do
  end subroutine same_bits

end module test_lattice
