!> Pairs of cables without a common node that are near each other, so that most steps look
!> at a few only.
!>
!> When the list is built, every pair within `skin` is noted with its distance. Cables that
!> have moved by c and d relative to the net as a whole are nearer by c + d at most: until
!> twice the largest move reaches the skin no other pair can touch, and of those noted only
!> pairs that were that near. It is a sieve: what is found with it does not depend on when it
!> was built.
module castnet_cable_pairs
  use castnet_kinds, only: wp
  use castnet_crossing, only: segment_gap
  use castnet_net, only: net_t
  implicit none
  private
  public :: cable_pairs_t, new_cable_pairs, update_pairs

  real(wp), parameter :: skin_lengths = 0.25_wp     !! of a cable's mean natural length
  real(wp), parameter :: margin = 1.0e-9_wp         !! for the sieve's own rounding [-]

  type :: cable_pairs_t
    logical :: built = .false.
    real(wp) :: skin = 0.0_wp                       !! [m]
    real(wp) :: reach = 0.0_wp                      !! distance up to which every pair is noted [m]
    integer :: n = 0
    integer, allocatable :: first(:), second(:)     !! counted from 1, first < second, in no order
    integer :: n_close = 0
    integer, allocatable :: close(:)                !! the pairs of the list that can touch now
    real(wp), allocatable :: distance(:)            !! when it was built [m]
    real(wp), allocatable :: reference(:, :)        !! (n_pad,3) nodes then [m]
    real(wp), allocatable :: node_move(:)           !! (n_pad) how far each has moved since, at the most [m]
    real(wp), allocatable :: cable_move(:)          !! (n_cable) and each cable [m]
    real(wp), allocatable :: key(:)                 !! (n_cable) scratch of a rebuild: where cables begin along the axis [m]
    real(wp), allocatable :: low(:, :), high(:, :)  !! (n_cable,3) and their boxes, in the order along the axis [m]
    integer, allocatable :: order(:)                !! cables along an axis, kept for the next rebuild
  end type cable_pairs_t

contains

  !> Allocate the list of one run.
  subroutine new_cable_pairs(pairs, net)
    type(cable_pairs_t), intent(out) :: pairs
    type(net_t), intent(in) :: net
    integer :: c
    if (net%n_cable > 0) pairs%skin = skin_lengths*sum(net%natural_length)/net%n_cable
    ! One more than there can be pairs in it.
    allocate (pairs%first(8*net%n_cable), pairs%second(8*net%n_cable), pairs%close(8*net%n_cable + 1), source=0)
    allocate (pairs%distance(8*net%n_cable), pairs%reference(net%n_pad, 3), source=0.0_wp)
    allocate (pairs%low(net%n_cable, 3), pairs%high(net%n_cable, 3), source=0.0_wp)
    allocate (pairs%key(net%n_cable), pairs%cable_move(net%n_cable), pairs%node_move(net%n_pad), source=0.0_wp)
    allocate (pairs%order(net%n_cable))
    do c = 1, net%n_cable
      pairs%order(c) = c
    end do
  end subroutine new_cable_pairs

  !> Make the list good for a motion along straight lines, and find those of it that can touch.
  subroutine update_pairs(pairs, net, n_pad, before, after)
    type(cable_pairs_t), intent(inout) :: pairs
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: before(n_pad, 3), after(n_pad, 3)  !! nodes at the motion's ends [m]
    real(wp) :: most
    logical :: outdated
    integer :: c, k
    if (net%n_cable == 0) return
    outdated = .not. pairs%built
    if (pairs%built) then
      pairs%node_move = 0.0_wp
      call add_moves(net%n_node, n_pad, pairs%reference, before, pairs%node_move)
      call add_moves(net%n_node, n_pad, pairs%reference, after, pairs%node_move)
      outdated = 2.0_wp*maxval(pairs%node_move) > pairs%reach*(1.0_wp - margin)
    end if
    if (outdated) then
      pairs%node_move = 0.0_wp
      call add_moves(net%n_node, n_pad, before, after, pairs%node_move)
      most = maxval(pairs%node_move)
      pairs%reach = max(pairs%skin, 2.0_wp*most*(1.0_wp + 2.0_wp*margin)) + tiny(1.0_wp)
      call rebuild(pairs, net, n_pad, before)
    end if
    do c = 1, net%n_cable
      pairs%cable_move(c) = max(pairs%node_move(net%cable_nodes(1, c)), pairs%node_move(net%cable_nodes(2, c))) &
                            *(1.0_wp + margin) + tiny(1.0_wp)
    end do
    pairs%n_close = 0
    do k = 1, pairs%n
      pairs%close(pairs%n_close + 1) = k
      pairs%n_close = pairs%n_close + merge(1, 0, pairs%distance(k) <= pairs%cable_move(pairs%first(k)) &
                                                                       + pairs%cable_move(pairs%second(k)))
    end do
  end subroutine update_pairs

  !> How far each node has moved relative to the middle of all moves, where that is more than
  !> is noted [m]. On a straight way it is no farther than at the farther end.
  pure subroutine add_moves(n, n_pad, x, y, move)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: x(n_pad, 3), y(n_pad, 3)
    real(wp), intent(inout) :: move(n_pad)
    real(wp) :: low, high, middle(3), dx, dy, dz
    integer :: i, c
    do c = 1, 3
      low = huge(1.0_wp)
      high = -huge(1.0_wp)
      do i = 1, n
        low = min(low, y(i, c) - x(i, c))
        high = max(high, y(i, c) - x(i, c))
      end do
      middle(c) = 0.5_wp*(low + high)
    end do
    do i = 1, n
      dx = y(i, 1) - x(i, 1) - middle(1)
      dy = y(i, 2) - x(i, 2) - middle(2)
      dz = y(i, 3) - x(i, 3) - middle(3)
      move(i) = max(move(i), sqrt(dx*dx + dy*dy + dz*dz))
    end do
  end subroutine add_moves

  !> Note every pair within reach: a sweep along the longest axis of the net.
  subroutine rebuild(pairs, net, n_pad, x)
    type(cable_pairs_t), intent(inout) :: pairs
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)
    real(wp) :: extent(3), gap
    integer :: axis, other, third, c, i, j, k, m
    do k = 1, 3
      extent(k) = maxval(x(1:net%n_node, k)) - minval(x(1:net%n_node, k))
    end do
    axis = maxloc(extent, dim=1)
    other = modulo(axis, 3) + 1
    third = modulo(other, 3) + 1
    do c = 1, net%n_cable
      pairs%key(c) = min(x(net%cable_nodes(1, c), axis), x(net%cable_nodes(2, c), axis))
    end do
    call sort_by(pairs%key, pairs%order)
    do k = 1, 3
      do m = 1, net%n_cable
        c = pairs%order(m)
        pairs%low(m, k) = min(x(net%cable_nodes(1, c), k), x(net%cable_nodes(2, c), k))
        pairs%high(m, k) = max(x(net%cable_nodes(1, c), k), x(net%cable_nodes(2, c), k)) + pairs%reach
      end do
    end do
    pairs%reference = x
    pairs%built = .true.
    pairs%n = 0
    do k = 1, net%n_cable
      i = pairs%order(k)
      do m = k + 1, net%n_cable
        if (pairs%low(m, axis) > pairs%high(k, axis)) exit
        ! One branch for four comparisons: mostly some fails, and which one nobody can tell.
        if (max(max(pairs%low(m, other) - pairs%high(k, other), pairs%low(k, other) - pairs%high(m, other)), &
                max(pairs%low(m, third) - pairs%high(k, third), pairs%low(k, third) - pairs%high(m, third))) > 0.0_wp) cycle
        j = pairs%order(m)
        if (share_node(net%cable_nodes(:, i), net%cable_nodes(:, j))) cycle
        gap = segment_gap(place(net%cable_nodes(1, i)), place(net%cable_nodes(2, i)), &
                          place(net%cable_nodes(1, j)), place(net%cable_nodes(2, j)))
        if (gap > pairs%reach) cycle
        if (pairs%n == size(pairs%first)) call grow(pairs)
        pairs%n = pairs%n + 1
        pairs%first(pairs%n) = min(i, j)
        pairs%second(pairs%n) = max(i, j)
        pairs%distance(pairs%n) = gap
      end do
    end do

  contains

    pure function place(node) result(p)
      integer, intent(in) :: node
      real(wp) :: p(3)
      p(1) = x(node, 1)
      p(2) = x(node, 2)
      p(3) = x(node, 3)
    end function place

  end subroutine rebuild

  pure logical function share_node(a, b)
    integer, intent(in) :: a(2), b(2)
    share_node = a(1) == b(1) .or. a(1) == b(2) .or. a(2) == b(1) .or. a(2) == b(2)
  end function share_node

  !> Twice the room; a crumpled net needs more than a spread one, how much nobody knows before.
  subroutine grow(pairs)
    type(cable_pairs_t), intent(inout) :: pairs
    integer, allocatable :: one(:)
    integer :: i
    allocate (one(size(pairs%first)), source=0)
    pairs%first = [(pairs%first(i), i=1, pairs%n), one]
    pairs%second = [(pairs%second(i), i=1, pairs%n), one]
    pairs%close = [pairs%close, one]
    pairs%distance = [(pairs%distance(i), i=1, pairs%n), real(one, wp)]
  end subroutine grow

  !> Put the order right by rising keys (Shell's sort: hardly any work on what is nearly
  !> sorted).
  pure subroutine sort_by(key, order)
    real(wp), intent(in) :: key(:)
    integer, intent(inout) :: order(:)
    integer :: gap, i, j, held
    gap = 1
    do while (gap < size(order)/3)
      gap = 3*gap + 1
    end do
    do while (gap > 0)
      do i = gap + 1, size(order)
        held = order(i)
        j = i - gap
        do while (j > 0)
          if (key(order(j)) <= key(held)) exit
          order(j + gap) = order(j)
          j = j - gap
        end do
        order(j + gap) = held
      end do
      gap = gap/3
    end do
  end subroutine sort_by

end module castnet_cable_pairs
