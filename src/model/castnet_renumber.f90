!> Node numbers that suit the force kernel, for nets that come in any order.
!>
!> The kernel is fastest where cables join node a to node a + a constant (castnet_cable_plan).
!> So a net of squares, triangles or hexagons, flat or round a hub, gets its lattice back
!> (castnet_lattice) and is numbered row by row. There are several ways to do so, and what is no lattice
!> is numbered along paths of cables (castnet_node_paths) or breadth first, which at least keeps neighbours
!> close: the order that makes the cheapest sweep is taken. This is an order only: nothing depends on it but the speed.
module castnet_renumber
  use castnet_kinds, only: wp
  use castnet_cable_plan, only: sweep_cost
  use castnet_graph, only: graph_t, new_graph, breadth_first
  use castnet_lattice, only: find_lattice, find_honeycomb, fill_gaps, close_seam
  use castnet_net, only: net_t
  use castnet_node_paths, only: follow_paths
  implicit none
  private
  public :: renumber_net, in_original_order

  integer, parameter :: most_cables = 8        !! of a node in a lattice
  integer, parameter :: all_cables = huge(1)
  real(wp), parameter :: clearly = 0.97_wp     !! what a cheaper order costs, at most, of one that came before
  real(wp), parameter :: good_enough = 1.1_wp  !! cost of a sweep per cable that ends the search

contains

  !> Renumber a net and its state, unless that would change nothing. `net%original_node(i)`
  !> then is the number that node i came with. Cables keep their order.
  subroutine renumber_net(net, position, velocity)
    type(net_t), intent(inout) :: net
    real(wp), intent(inout) :: position(:, :), velocity(:, :) !! (n_node,3) [m], [m/s]
    integer, allocatable :: order(:)
    integer :: i
    if (net%n_cable == 0) return
    call find_order(net%n_node, net%cable_nodes(:, :net%n_cable), order)
    if (all(order == [(i, i=1, net%n_node)])) return
    call permute(net, order)
    position = position(order, :)
    velocity = velocity(order, :)
    net%original_node = order
  end subroutine renumber_net

  !> The net as it came, for whoever shows it: node arrays and numbers as in its file.
  function in_original_order(net) result(original)
    type(net_t), intent(in) :: net
    type(net_t) :: original
    integer, allocatable :: back(:)
    integer :: i
    original = net
    if (.not. allocated(net%original_node)) return
    allocate (back(net%n_node))
    do i = 1, net%n_node
      back(net%original_node(i)) = i
    end do
    call permute(original, back)
    deallocate (original%original_node)
  end function in_original_order

  !> Node i becomes what node order(i) was. Not the plan.
  subroutine permute(net, order)
    type(net_t), intent(inout) :: net
    integer, intent(in) :: order(:)
    integer, allocatable :: now(:)
    integer :: i
    allocate (now(size(order)))
    do i = 1, size(order)
      now(order(i)) = i
    end do
    net%node_mass = net%node_mass(order)
    net%fixed = net%fixed(order)
    if (allocated(net%is_bullet)) net%is_bullet = net%is_bullet(order)
    if (allocated(net%inverse_mass)) net%inverse_mass(:size(order)) = net%inverse_mass(order)
    do i = 1, size(net%cable_nodes, 2)
      net%cable_nodes(:, i) = now(net%cable_nodes(:, i))
    end do
    if (allocated(net%bullet_nodes)) net%bullet_nodes = now(net%bullet_nodes)
    if (allocated(net%perimeter_nodes)) net%perimeter_nodes = now(net%perimeter_nodes)
    if (allocated(net%corner_nodes)) net%corner_nodes = now(net%corner_nodes)
    if (allocated(net%faces)) then
      do i = 1, size(net%faces, 2)
        net%faces(:, i) = now(net%faces(:, i))
      end do
    end if
  end subroutine permute

  !> order(i): which node comes i-th.
  subroutine find_order(n, cable_nodes, order)
    integer, intent(in) :: n
    integer, intent(in) :: cable_nodes(:, :)
    integer, allocatable, intent(out) :: order(:)
    type(graph_t) :: graph
    integer :: at(2, n), patch(n), base(n), path(n), key(2, n), way, i
    real(wp) :: least

    least = huge(1.0_wp)
    base = [(i, i=1, n)]
    order = base
    call keep_cheaper(base, n, cable_nodes, order, least)
    if (found()) return
    call new_graph(n, cable_nodes, all_cables, graph)
    call breadth_first(graph, minloc(graph%start(2:) - graph%start(:n), dim=1), base, at(1, :))
    call keep_cheaper(base, n, cable_nodes, order, least)
    call follow_paths(graph, path)
    call keep_cheaper(path, n, cable_nodes, order, least)
    call new_graph(n, cable_nodes, most_cables, graph)
    call find_lattice(graph, at, patch)
    call fill_gaps(graph, .false., at, patch)
    call close_seam(graph, at, patch)
    do way = 1, 8
      select case (modulo(way, 4))
      case (1); key = at
      case (2); key = at([2, 1], :)
      case (3); key(1, :) = at(1, :); key(2, :) = at(1, :) + at(2, :)
      case (0); key(1, :) = at(1, :); key(2, :) = at(1, :) - at(2, :)
      end select
      if (way > 4) call fold_rows(patch, key)
      call keep_cheaper(by_rows(base, key, patch), n, cable_nodes, order, least)
      if (found()) return
    end do
    if (2*count(patch > 0) < n) then
      call new_graph(n, cable_nodes, 3, graph)
      call find_honeycomb(graph, at, patch)
      call new_graph(n, cable_nodes, most_cables, graph)
      call fill_gaps(graph, .true., at, patch)
      do way = 1, 3          ! rows of zigzags in each of three directions
        select case (way)
        case (1); key = at
        case (2); key(1, :) = at(1, :) + at(2, :); key(2, :) = floor_half(at(1, :) - at(2, :))
        case (3); key(1, :) = at(1, :) - at(2, :); key(2, :) = floor_half(at(1, :) + at(2, :) + 1)
        end select
        call keep_cheaper(by_rows(base, key, patch), n, cable_nodes, order, least)
      end do
    end if

  contains

    logical function found()
      found = least <= good_enough*size(cable_nodes, 2)
    end function found

  end subroutine find_order

  !> Put the rows of the second half of a patch each behind one of the first half. In a hexagon of triangles the
  !> rows grow and shrink again, and two of them are always as long together: so what joins a
  !> row to the next has one offset throughout.
  pure subroutine fold_rows(patch, key)
    integer, intent(in) :: patch(:)
    integer, intent(inout) :: key(:, :)
    integer :: low(0:maxval(patch)), high(0:maxval(patch)), rows(0:maxval(patch)), width, p
    low = huge(low)
    high = -huge(high)
    do p = 1, size(patch)
      if (patch(p) == 0) cycle
      low(patch(p)) = min(low(patch(p)), key(2, p))
      high(patch(p)) = max(high(patch(p)), key(2, p))
    end do
    rows = 1
    where (high >= low) rows = (high - low)/2 + 1
    width = maxval(key(1, :)) - minval(key(1, :)) + 1
    do p = 1, size(patch)
      if (patch(p) == 0) cycle
      key(2, p) = key(2, p) - low(patch(p))
      if (key(2, p) < rows(patch(p))) cycle
      key(2, p) = key(2, p) - rows(patch(p))
      key(1, p) = key(1, p) + width
    end do
  end subroutine fold_rows

  pure elemental integer function floor_half(i)
    integer, intent(in) :: i
    floor_half = (i - modulo(i, 2))/2
  end function floor_half

  !> Take `other` for the order if its sweep costs less.
  subroutine keep_cheaper(other, n, cable_nodes, order, least)
    integer, intent(in) :: n, other(n), cable_nodes(:, :)
    integer, intent(inout) :: order(n)
    real(wp), intent(inout) :: least
    integer :: now(n), i
    integer, allocatable :: nodes(:, :)
    real(wp) :: cost
    do i = 1, n
      now(other(i)) = i
    end do
    allocate (nodes, mold=cable_nodes)
    do i = 1, size(nodes, 2)
      nodes(:, i) = now(cable_nodes(:, i))
    end do
    cost = sweep_cost(n, nodes)
    if (cost >= clearly*least) return
    least = cost
    order = other
  end subroutine keep_cheaper

  !> Nodes by patch, then by row key(2,:), then by key(1,:); ties as in `base`. Those in no patch last.
  function by_rows(base, key, patch) result(order)
    integer, intent(in) :: base(:), key(:, :), patch(:)
    integer :: order(size(base))
    order = base
    call sort_by(order, key(1, :), patch)
    call sort_by(order, key(2, :), patch)
    call sort_by(order, patch, patch)
  end function by_rows

  !> Sort by counting; ties keep their order. Nodes in no patch come last.
  subroutine sort_by(order, key, patch)
    integer, intent(inout) :: order(:)
    integer, intent(in) :: key(:), patch(:)
    integer, allocatable :: bucket(:)
    integer :: before(size(order)), low, high, i, k
    low = 0
    high = 0
    if (any(patch > 0)) then
      low = minval(key, mask=patch > 0)
      high = maxval(key, mask=patch > 0)
    end if
    allocate (bucket(low:high + 2), source=0)
    do i = 1, size(order)
      k = merge(key(i), high + 1, patch(i) > 0)
      bucket(k + 1) = bucket(k + 1) + 1
    end do
    bucket(low) = 1
    do k = low + 1, high + 2
      bucket(k) = bucket(k) + bucket(k - 1)
    end do
    before = order
    do i = 1, size(order)
      k = merge(key(before(i)), high + 1, patch(before(i)) > 0)
      order(bucket(k)) = before(i)
      bucket(k) = bucket(k) + 1
    end do
  end subroutine sort_by

end module castnet_renumber
