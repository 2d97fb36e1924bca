!> Node numbers that suit the force kernel, for nets that come in any order.
!>
!> The kernel is fastest where cables join node a to node a + a constant (castnet_cable_plan).
!> So a net of squares gets its lattice back: integer coordinates spread from one mesh
!> square over the others by two rules. The fourth corner of a square is p + w - r; and
!> only where no square helps any further (cables are missing), of two cables at a node
!> that share no square one goes on where the other came from.
!> Nodes are then numbered row by row. What is no lattice is numbered breadth first, which
!> at least keeps neighbours close. This is an order only: nothing depends on its being
!> right but the speed.
module castnet_renumber
  use castnet_kinds, only: wp
  use castnet_net, only: net_t
  implicit none
  private
  public :: renumber_net, in_original_order

  integer, parameter :: unknown = huge(1)

contains

  !> Renumber a net and its state, unless that would change nothing. `net%original_node(i)`
  !> then is the number that node i came with. Cables keep their order.
  subroutine renumber_net(net, position, velocity)
    type(net_t), intent(inout) :: net
    real(wp), intent(inout) :: position(:, :), velocity(:, :) !! (n_node,3) [m], [m/s]
    integer, allocatable :: order(:)
    integer :: i
    if (net%n_cable == 0) return
    call find_order(net%n_node, net%n_cable, net%cable_nodes, order)
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
  subroutine find_order(n, m, cable_nodes, order)
    integer, intent(in) :: n, m
    integer, intent(in) :: cable_nodes(2, m)
    integer, allocatable, intent(out) :: order(:)
    integer, allocatable :: start(:), neighbour(:), at(:, :)
    integer :: placed
    call build_adjacency(n, m, cable_nodes, start, neighbour)
    allocate (at(2, n), order(n))
    call find_lattice(n, start, neighbour, at, placed)
    if (2*placed >= n) then
      call row_by_row(n, at, order)
    else
      call breadth_first(n, start, neighbour, order)
    end if
  end subroutine find_order

  subroutine build_adjacency(n, m, cable_nodes, start, neighbour)
    integer, intent(in) :: n, m
    integer, intent(in) :: cable_nodes(2, m)
    integer, allocatable, intent(out) :: start(:), neighbour(:)
    integer, allocatable :: next(:)
    integer :: c, e, a
    allocate (start(n + 1), neighbour(2*m))
    start = 0
    do c = 1, m
      do e = 1, 2
        start(cable_nodes(e, c) + 1) = start(cable_nodes(e, c) + 1) + 1
      end do
    end do
    start(1) = 1
    do a = 1, n
      start(a + 1) = start(a + 1) + start(a)
    end do
    next = start(:n)
    do c = 1, m
      do e = 1, 2
        a = cable_nodes(e, c)
        neighbour(next(a)) = cable_nodes(3 - e, c)
        next(a) = next(a) + 1
      end do
    end do
  end subroutine build_adjacency

  !> Integer coordinates of the nodes of squares; `unknown` elsewhere.
  subroutine find_lattice(n, start, neighbour, at, placed)
    integer, intent(in) :: n, start(:), neighbour(:)
    integer, intent(out) :: at(2, n), placed
    integer, allocatable :: queue(:)
    logical, allocatable :: queued(:)
    integer :: p, k, head, tail, corner(4), ring, before
    placed = 0
    at = unknown
    call first_square(n, start, neighbour, corner)
    if (corner(1) == 0) return
    ! A ring buffer: a node comes again when a neighbour has been placed.
    ring = n + 1
    allocate (queue(0:ring), queued(n))
    queued = .false.
    at(:, corner(1)) = [0, 0]
    at(:, corner(2)) = [1, 0]
    at(:, corner(3)) = [1, 1]
    at(:, corner(4)) = [0, 1]
    placed = 4
    queue(0:3) = corner
    queued(corner) = .true.
    head = 0
    tail = 4
    do
      do while (head /= tail)
        p = queue(head)
        head = modulo(head + 1, ring + 1)
        queued(p) = .false.
        do k = start(p), start(p + 1) - 1
          call try(p, neighbour(k), .false.)
        end do
      end do
      before = placed
      do p = 1, n
        if (at(1, p) == unknown) cycle
        do k = start(p), start(p + 1) - 1
          call try(p, neighbour(k), .true.)
        end do
      end do
      if (placed == before) exit
    end do

  contains

    !> Place q, a neighbour of the placed node p, if its place is known.
    subroutine try(p, q, straight)
      integer, intent(in) :: p, q
      logical, intent(in) :: straight  !! by the second rule
      integer :: l, place(2)
      if (at(1, q) /= unknown) return
      call place_neighbour(p, q, start, neighbour, at, straight, place)
      if (place(1) == unknown) return
      at(:, q) = place
      placed = placed + 1
      call enqueue(q)
      do l = start(q), start(q + 1) - 1
        if (at(1, neighbour(l)) /= unknown) call enqueue(neighbour(l))
      end do
    end subroutine try

    subroutine enqueue(node)
      integer, intent(in) :: node
      if (queued(node)) return
      queued(node) = .true.
      queue(tail) = node
      tail = modulo(tail + 1, ring + 1)
    end subroutine enqueue

  end subroutine find_lattice

  !> Coordinates of q, a neighbour of the placed node p; `unknown` if the rule does not speak
  !> or not clearly.
  subroutine place_neighbour(p, q, start, neighbour, at, straight, place)
    integer, intent(in) :: p, q, start(:), neighbour(:), at(:, :)
    logical, intent(in) :: straight    !! the second rule, else the first
    integer, intent(out) :: place(2)
    integer :: k, r, w, n_straight
    logical :: in_square
    place = unknown
    n_straight = 0
    in_square = .false.
    do k = start(p), start(p + 1) - 1
      r = neighbour(k)
      if (r == q .or. at(1, r) == unknown) cycle
      w = fourth_corner(p, r, q, start, neighbour, at)
      if (w > 0) then
        in_square = .true.
        if (straight .or. at(1, w) == unknown) cycle
        place = at(:, p) + at(:, w) - at(:, r)
      else if (straight) then
        n_straight = n_straight + 1
        place = 2*at(:, p) - at(:, r)
      end if
    end do
    if (place(1) == unknown) return
    if (straight) then
      if (n_straight /= 1 .or. .not. in_square) place = unknown
      do k = start(p), start(p + 1) - 1
        if (all(at(:, neighbour(k)) == place)) place = unknown
      end do
    end if
    if (place(1) == unknown) return
    if (sum(abs(place - at(:, p))) /= 1) place = unknown
  end subroutine place_neighbour

  !> A node besides p that joins r and q, a placed one if there is one; 0: none.
  integer function fourth_corner(p, r, q, start, neighbour, at) result(w)
    integer, intent(in) :: p, r, q, start(:), neighbour(:), at(:, :)
    integer :: k, l
    w = 0
    do k = start(q), start(q + 1) - 1
      if (neighbour(k) == p) cycle
      do l = start(r), start(r + 1) - 1
        if (neighbour(l) /= neighbour(k)) cycle
        if (w == 0) w = neighbour(k)
        if (at(1, neighbour(k)) /= unknown) w = neighbour(k)
      end do
    end do
  end function fourth_corner

  !> Any four nodes in a square; zeros without one. At most the first few hundred nodes are tried.
  subroutine first_square(n, start, neighbour, corner)
    integer, intent(in) :: n, start(:), neighbour(:)
    integer, intent(out) :: corner(4)
    integer :: p, k, l, w, none(2, n)
    none = unknown
    corner = 0
    do p = 1, min(n, 500)
      do k = start(p), start(p + 1) - 1
        do l = k + 1, start(p + 1) - 1
          w = fourth_corner(p, neighbour(k), neighbour(l), start, neighbour, none)
          if (w == 0 .or. w == neighbour(k) .or. w == neighbour(l) .or. neighbour(k) == neighbour(l)) cycle
          corner = [p, neighbour(k), w, neighbour(l)]
          return
        end do
      end do
    end do
  end subroutine first_square

  !> Placed nodes by rows, then the others as they came.
  subroutine row_by_row(n, at, order)
    integer, intent(in) :: n, at(2, n)
    integer, intent(out) :: order(n)
    integer :: first(n), i, c, low, high, k
    integer, allocatable :: bucket(:)
    first = [(i, i=1, n)]
    ! Counting sorts keep ties in order: by column, then by row, unplaced last.
    do c = 1, 2
      low = minval(at(c, :))
      high = maxval(at(c, :), mask=at(c, :) /= unknown)
      allocate (bucket(low:high + 2), source=0)
      do i = 1, n
        k = min(at(c, first(i)), high + 1)
        bucket(k + 1) = bucket(k + 1) + 1
      end do
      bucket(low) = 1
      do k = low + 1, high + 2
        bucket(k) = bucket(k) + bucket(k - 1)
      end do
      do i = 1, n
        k = min(at(c, first(i)), high + 1)
        order(bucket(k)) = first(i)
        bucket(k) = bucket(k) + 1
      end do
      first = order
      deallocate (bucket)
    end do
  end subroutine row_by_row

  !> Breadth first from a node of least degree, component by component.
  subroutine breadth_first(n, start, neighbour, order)
    integer, intent(in) :: n, start(:), neighbour(:)
    integer, intent(out) :: order(n)
    logical :: seen(n)
    integer :: head, tail, i, k, root
    seen = .false.
    root = minloc(start(2:n + 1) - start(1:n), dim=1)
    head = 1
    tail = 0
    do i = 0, n
      if (i > 0) root = i
      if (seen(root)) cycle
      tail = tail + 1
      order(tail) = root
      seen(root) = .true.
      do while (head <= tail)
        do k = start(order(head)), start(order(head) + 1) - 1
          if (seen(neighbour(k))) cycle
          tail = tail + 1
          order(tail) = neighbour(k)
          seen(neighbour(k)) = .true.
        end do
        head = head + 1
      end do
    end do
  end subroutine breadth_first

end module castnet_renumber
