!> Nodes and cables that are near the body, so that most steps look at a few only.
!>
!> At a rebuild every node and cable within `skin` beyond the threshold is noted with its
!> exact distance. Until some node has moved by `skin` in body axes since then, nothing
!> else can touch: a signed distance changes by no more than its point moves, and a
!> cable's point by no more than the cable's ends. The same bound tells, step by step,
!> which of those noted are worth another look. It is a sieve only: what touches, and in
!> which order it is listed, does not depend on when the list was built.
module castnet_near_list
  use castnet_kinds, only: wp
  use castnet_net, only: net_t
  use castnet_shape, only: shape_t, signed_distance_within, segment_distance_within
  implicit none
  private
  public :: near_list_t, reserve_near, rebuild_near, largest_move

  type :: near_list_t
    logical :: built = .false.
    real(wp) :: skin = 0.0_wp                    !! [m]
    real(wp), allocatable :: reference(:, :)     !! (n_pad,3) nodes in body axes when it was built [m]
    integer :: n_node = 0, n_cable = 0
    integer, allocatable :: node(:), cable(:)    !! counted from 1, rising
    real(wp), allocatable :: node_distance(:), cable_distance(:) !! when it was built [m]
    integer, allocatable :: found(:)             !! scratch of a rebuild
    real(wp), allocatable :: a(:, :), b(:, :)    !! (3,:) scratch: points, or ends of segments, body axes [m]
    real(wp), allocatable :: fraction(:), distance(:), normal(:, :) !! scratch: of points or segments
    real(wp), allocatable :: end_distance(:), end_normal(:, :)      !! scratch: of segments' second ends
  end type near_list_t

contains

  !> Room for a net; the cables' only where they can touch.
  subroutine reserve_near(near, net, with_cables, skin)
    type(near_list_t), intent(out) :: near
    type(net_t), intent(in) :: net
    logical, intent(in) :: with_cables
    real(wp), intent(in) :: skin
    integer :: m
    m = net%n_node
    if (with_cables) m = max(m, net%n_cable)
    near%skin = skin
    allocate (near%reference(net%n_pad, 3), source=0.0_wp)
    allocate (near%node(net%n_node), near%cable(merge(net%n_cable, 0, with_cables)), near%found(m), source=0)
    allocate (near%node_distance(net%n_node), near%cable_distance(size(near%cable)), source=0.0_wp)
    allocate (near%a(3, m), near%b(3, merge(m, 0, with_cables)), near%normal(3, m), source=0.0_wp)
    allocate (near%fraction(m), near%distance(m), source=0.0_wp)
    allocate (near%end_distance(merge(m, 0, with_cables)), near%end_normal(3, merge(m, 0, with_cables)), source=0.0_wp)
  end subroutine reserve_near

  !> How far the fastest node has moved in body axes since the list was built [m].
  pure real(wp) function largest_move(n, n_pad, y, reference) result(move)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: y(n_pad, 3), reference(n_pad, 3)
    real(wp) :: most, dx, dy, dz
    integer :: i
    most = 0.0_wp
    do i = 1, n
      dx = y(i, 1) - reference(i, 1)
      dy = y(i, 2) - reference(i, 2)
      dz = y(i, 3) - reference(i, 3)
      most = max(most, dx*dx + dy*dy + dz*dz)
    end do
    move = sqrt(most)
  end function largest_move

  !> Note everything within `reach` of the body.
  subroutine rebuild_near(near, net, shape, n_pad, y, outside, middle, half, reach, with_cables)
    type(near_list_t), intent(inout) :: near
    type(net_t), intent(in) :: net
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: y(n_pad, 3), outside(n_pad)  !! body axes; outside of the body's box [m]
    real(wp), intent(in) :: middle(3), half(3), reach    !! the body's box; threshold and skin together [m]
    logical, intent(in) :: with_cables
    integer :: i, k
    near%reference(1:net%n_node, :) = y(1:net%n_node, :)
    near%built = .true.
    k = 0
    do i = 1, net%n_node
      if (outside(i) > reach) cycle
      k = k + 1
      near%found(k) = i
      near%a(1, k) = y(i, 1)
      near%a(2, k) = y(i, 2)
      near%a(3, k) = y(i, 3)
    end do
    call signed_distance_within(shape, reach, k, near%a, near%distance, near%normal)
    call keep(k, near%found, near%distance, reach, near%n_node, near%node, near%node_distance)
    near%n_cable = 0
    if (.not. with_cables) return
    call segments_near_box(net%n_cable, net%cable_nodes, n_pad, y, middle, half, reach, k, near%found, near%a, near%b)
    call segment_distance_within(shape, reach, k, near%a, near%b, near%fraction, near%distance, near%normal)
    call keep(k, near%found, near%distance, reach, near%n_cable, near%cable, near%cable_distance)
  end subroutine rebuild_near

  !> Those within reach, in their order.
  pure subroutine keep(n, found, distance, reach, n_kept, kept, kept_distance)
    integer, intent(in) :: n, found(:)
    real(wp), intent(in) :: distance(:), reach
    integer, intent(out) :: n_kept
    integer, intent(inout) :: kept(:)
    real(wp), intent(inout) :: kept_distance(:)
    integer :: k
    n_kept = 0
    do k = 1, n
      if (distance(k) > reach) cycle
      n_kept = n_kept + 1
      kept(n_kept) = found(k)
      kept_distance(n_kept) = distance(k)
    end do
  end subroutine keep

  !> Cables whose own box comes within reach of the body's.
  pure subroutine segments_near_box(n_cable, cable_nodes, n_pad, y, middle, half, reach, n, found, a, b)
    integer, intent(in) :: n_cable, n_pad
    integer, intent(in) :: cable_nodes(2, n_cable)
    real(wp), intent(in) :: y(n_pad, 3), middle(3), half(3), reach
    integer, intent(out) :: n
    integer, intent(inout) :: found(:)
    real(wp), intent(inout) :: a(:, :), b(:, :)
    real(wp) :: gap, low, high
    integer :: c, p, q, axis
    n = 0
    do c = 1, n_cable
      p = cable_nodes(1, c)
      q = cable_nodes(2, c)
      gap = -huge(1.0_wp)
      do axis = 1, 3
        low = min(y(p, axis), y(q, axis))
        high = max(y(p, axis), y(q, axis))
        gap = max(gap, max(low - middle(axis), middle(axis) - high) - half(axis))
      end do
      if (gap > reach) cycle
      n = n + 1
      found(n) = c
      do axis = 1, 3
        a(axis, n) = y(p, axis)
        b(axis, n) = y(q, axis)
      end do
    end do
  end subroutine segments_near_box

end module castnet_near_list
