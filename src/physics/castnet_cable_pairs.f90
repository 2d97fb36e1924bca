!> Pairs of cables without a common node that are near each other, so that most steps look
!> at a few only.
!>
!> When the list is built, every pair within `skin` is noted with its distance. Two points
!> that have moved by less than d relative to the net as a whole are nearer by less than 2 d:
!> until twice the largest move reaches the skin no other pair can touch, and of those noted
!> only pairs nearer than that. It is a sieve: what is found with it does not depend on when
!> it was built.
module castnet_cable_pairs
  use castnet_kinds, only: wp
  use castnet_crossing, only: segment_gap
  use castnet_net, only: net_t
  implicit none
  private
  public :: cable_pairs_t, new_cable_pairs, update_pairs

  real(wp), parameter :: skin_lengths = 0.2_wp      !! of a cable's mean natural length
  real(wp), parameter :: margin = 1.0e-9_wp         !! for the sieve's own rounding [-]

  type :: cable_pairs_t
    logical :: built = .false.
    real(wp) :: skin = 0.0_wp                       !! [m]
    real(wp) :: reach = 0.0_wp                      !! only pairs with at most this distance can touch [m]
    integer :: n = 0
    integer, allocatable :: first(:), second(:)     !! counted from 1, first < second, in no order
    real(wp), allocatable :: distance(:)            !! when it was built [m]
    real(wp), allocatable :: reference(:, :)        !! (n_pad,3) nodes then [m]
    real(wp), allocatable :: low(:, :), high(:, :)  !! (n_cable,3) scratch of a rebuild: the cables' boxes [m]
    integer, allocatable :: order(:)                !! cables along an axis, kept for the next rebuild
  end type cable_pairs_t

contains

  !> Allocate the list of one run.
  subroutine new_cable_pairs(pairs, net)
    type(cable_pairs_t), intent(out) :: pairs
    type(net_t), intent(in) :: net
    integer :: c
    if (net%n_cable > 0) pairs%skin = skin_lengths*sum(net%natural_length)/net%n_cable
    allocate (pairs%first(8*net%n_cable), pairs%second(8*net%n_cable), source=0)
    allocate (pairs%distance(8*net%n_cable), pairs%reference(net%n_pad, 3), source=0.0_wp)
    allocate (pairs%low(net%n_cable, 3), pairs%high(net%n_cable, 3), source=0.0_wp)
    allocate (pairs%order(net%n_cable))
    do c = 1, net%n_cable
      pairs%order(c) = c
    end do
  end subroutine new_cable_pairs

  !> Make the list and its reach good for a motion along straight lines.
  subroutine update_pairs(pairs, net, n_pad, before, after)
    type(cable_pairs_t), intent(inout) :: pairs
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: before(n_pad, 3), after(n_pad, 3)  !! nodes at the motion's ends [m]
    real(wp) :: reach
    reach = huge(1.0_wp)
    if (pairs%built) reach = 2.0_wp*max(largest_move(net%n_node, n_pad, pairs%reference, before), &
                                        largest_move(net%n_node, n_pad, pairs%reference, after))
    if (reach > pairs%skin) then
      reach = 2.0_wp*largest_move(net%n_node, n_pad, before, after)
      call rebuild(pairs, net, n_pad, before, max(pairs%skin, reach)*(1.0_wp + 2.0_wp*margin) + tiny(1.0_wp))
    end if
    pairs%reach = reach*(1.0_wp + margin) + tiny(1.0_wp)
  end subroutine update_pairs

  !> How far a node has moved relative to the middle of all moves, at most [m].
  pure real(wp) function largest_move(n, n_pad, x, y) result(move)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: x(n_pad, 3), y(n_pad, 3)
    real(wp) :: low(3), high(3), middle(3), most, dx, dy, dz
    integer :: i, c
    do c = 1, 3
      low(c) = huge(1.0_wp)
      high(c) = -huge(1.0_wp)
      do i = 1, n
        low(c) = min(low(c), y(i, c) - x(i, c))
        high(c) = max(high(c), y(i, c) - x(i, c))
      end do
      middle(c) = 0.5_wp*(low(c) + high(c))
    end do
    most = 0.0_wp
    do i = 1, n
      dx = y(i, 1) - x(i, 1) - middle(1)
      dy = y(i, 2) - x(i, 2) - middle(2)
      dz = y(i, 3) - x(i, 3) - middle(3)
      most = max(most, dx*dx + dy*dy + dz*dz)
    end do
    move = sqrt(most)
  end function largest_move

  !> Note every pair within reach: a sweep along the longest axis of the net.
  subroutine rebuild(pairs, net, n_pad, x, reach)
    type(cable_pairs_t), intent(inout) :: pairs
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), reach
    real(wp) :: extent(3), gap
    integer :: axis, other, third, c, i, j, k, m
    do k = 1, 3
      do c = 1, net%n_cable
        pairs%low(c, k) = min(x(net%cable_nodes(1, c), k), x(net%cable_nodes(2, c), k))
        pairs%high(c, k) = max(x(net%cable_nodes(1, c), k), x(net%cable_nodes(2, c), k)) + reach
      end do
      extent(k) = maxval(pairs%high(:, k)) - minval(pairs%low(:, k))
    end do
    axis = maxloc(extent, dim=1)
    other = modulo(axis, 3) + 1
    third = modulo(other, 3) + 1
    call sort_by(pairs%low(:, axis), pairs%order)
    pairs%reference = x
    pairs%built = .true.
    pairs%n = 0
    do k = 1, net%n_cable
      i = pairs%order(k)
      do m = k + 1, net%n_cable
        j = pairs%order(m)
        if (pairs%low(j, axis) > pairs%high(i, axis)) exit
        if (pairs%low(j, other) > pairs%high(i, other) .or. pairs%low(i, other) > pairs%high(j, other)) cycle
        if (pairs%low(j, third) > pairs%high(i, third) .or. pairs%low(i, third) > pairs%high(j, third)) cycle
        if (share_node(net%cable_nodes(:, i), net%cable_nodes(:, j))) cycle
        gap = segment_gap(x(net%cable_nodes(1, i), :), x(net%cable_nodes(2, i), :), &
                          x(net%cable_nodes(1, j), :), x(net%cable_nodes(2, j), :))
        if (gap > reach) cycle
        if (pairs%n == size(pairs%first)) call grow(pairs)
        pairs%n = pairs%n + 1
        pairs%first(pairs%n) = min(i, j)
        pairs%second(pairs%n) = max(i, j)
        pairs%distance(pairs%n) = gap
      end do
    end do
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
