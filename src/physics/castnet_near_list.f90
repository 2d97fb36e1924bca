!> Nodes and cables that are near the body, so that most steps look at a few only.
!>
!> At a rebuild every node and cable within `skin` beyond the threshold is noted with its
!> exact distance. Until a node and the body's surface have come nearer to each other by
!> `skin` since then, nothing else can touch: a signed distance changes by no more than its
!> point moves against the surface, and a cable's point by no more than the cable's ends. The
!> surface moves with the body's centre and turns about it, by no more than the angle times
!> the bounding radius. While nothing is near, the skin is as wide as the way to the net.
!>
!> The same bound tells, step by step, which of those noted are worth another look. It is a
!> sieve only: what touches, and in which order it is listed, does not depend on when the
!> list was built.
module castnet_near_list
  use castnet_kinds, only: wp
  use castnet_net, only: net_t
  use castnet_broad_phase, only: net_box, box_gap, into_body_axes
  use castnet_shape, only: shape_t, signed_distance_within, segment_distance_within, shape_bounds, shape_bounding_radius
  implicit none
  private
  public :: near_list_t, reserve_near, rebuild_near, turned_by

  type :: near_list_t
    logical :: built = .false.
    real(wp) :: least_skin = 0.0_wp              !! where something is near [m]
    real(wp) :: skin = 0.0_wp                    !! of the present list [m]
    real(wp), allocatable :: reference(:, :)     !! (n_pad,3) nodes against the body's centre when it was built [m]
    real(wp) :: attitude(4) = 0.0_wp             !! the body's then
    real(wp) :: middle(3) = 0.0_wp, half(3) = 0.0_wp !! the body's box, body axes [m]
    real(wp) :: radius = 0.0_wp                  !! its bounding radius [m]
    integer :: n_node = 0, n_cable = 0
    integer, allocatable :: node(:), cable(:)    !! counted from 1, rising
    real(wp), allocatable :: node_distance(:), cable_distance(:) !! when it was built [m]
    real(wp), allocatable :: body(:, :), outside(:) !! (n_node,3), (n_node) scratch: noted nodes in body axes; outside of its box [m]
    integer, allocatable :: found(:)             !! scratch of a rebuild
    real(wp), allocatable :: a(:, :), b(:, :)    !! (3,:) scratch: points, or ends of segments, body axes [m]
    real(wp), allocatable :: fraction(:), distance(:), normal(:, :) !! scratch: of points or segments
    real(wp), allocatable :: end_distance(:), end_normal(:, :)      !! scratch: of segments' second ends
  end type near_list_t

contains

  !> Room for a net; the cables' only where they can touch.
  subroutine reserve_near(near, net, shape, with_cables, skin)
    type(near_list_t), intent(out) :: near
    type(net_t), intent(in) :: net
    type(shape_t), intent(in) :: shape
    logical, intent(in) :: with_cables
    real(wp), intent(in) :: skin
    real(wp) :: lower(3), upper(3)
    integer :: m
    m = net%n_node
    if (with_cables) m = max(m, net%n_cable)
    near%least_skin = skin
    call shape_bounds(shape, lower, upper)
    near%middle = 0.5_wp*(lower + upper)
    near%half = 0.5_wp*(upper - lower)
    near%radius = shape_bounding_radius(shape)
    allocate (near%reference(net%n_pad, 3), source=0.0_wp)
    allocate (near%node(net%n_node), near%cable(merge(net%n_cable, 0, with_cables)), near%found(m), source=0)
    allocate (near%body(net%n_node, 3), near%outside(net%n_node), source=0.0_wp)
    allocate (near%node_distance(net%n_node), near%cable_distance(size(near%cable)), source=0.0_wp)
    allocate (near%a(3, m), near%b(3, merge(m, 0, with_cables)), near%normal(3, m), source=0.0_wp)
    allocate (near%fraction(m), near%distance(m), source=0.0_wp)
    allocate (near%end_distance(merge(m, 0, with_cables)), near%end_normal(3, merge(m, 0, with_cables)), source=0.0_wp)
  end subroutine reserve_near

  !> How far the body's surface can have turned since the list was built [m]; huge when that
  !> was a quarter of a turn or more. With |q - q0| = 2 sin(angle/4) the angle is at most
  !> 2.1 |q - q0| for |q - q0| < 0.75.
  pure real(wp) function turned_by(near, attitude) result(way)
    type(near_list_t), intent(in) :: near
    real(wp), intent(in) :: attitude(4)
    real(wp) :: same, other
    same = sum((attitude - near%attitude)**2)
    other = sum((attitude + near%attitude)**2)   ! q and -q are one attitude
    way = huge(1.0_wp)
    if (min(same, other) < 0.5_wp) way = 2.1_wp*sqrt(min(same, other))*near%radius
  end function turned_by

  !> Note everything within the threshold and the skin of the body.
  subroutine rebuild_near(near, net, shape, n_pad, x, centre, attitude, r, threshold, with_cables, y, outside)
    type(near_list_t), intent(inout) :: near
    type(net_t), intent(in) :: net
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)                  !! inertial [m]
    real(wp), intent(in) :: centre(3), attitude(4), r(3, 3) !! the body: centre [m], attitude, and its matrix
    real(wp), intent(in) :: threshold                    !! [m]
    logical, intent(in) :: with_cables
    real(wp), intent(inout) :: y(n_pad, 3), outside(n_pad) !! scratch: body axes; outside of the body's box [m]
    real(wp) :: lower(3), upper(3), reach, gap
    integer :: i, k, c
    do c = 1, 3
      do i = 1, net%n_node
        near%reference(i, c) = x(i, c) - centre(c)
      end do
    end do
    near%attitude = attitude
    near%built = .true.
    near%skin = near%least_skin
    near%n_node = 0
    near%n_cable = 0
    reach = threshold + near%skin
    call net_box(net%n_node, n_pad, x, lower, upper)
    gap = box_gap(lower, upper, centre, near%radius)
    if (gap > reach) then
      near%skin = (gap - threshold)*(1.0_wp - 1.0e-9_wp)
      return
    end if
    call into_body_axes(net%n_node, n_pad, x, centre, r, near%middle, near%half, y, outside)
    k = 0
    gap = huge(1.0_wp)
    do i = 1, net%n_node
      gap = min(gap, outside(i))
      if (outside(i) > reach) cycle
      k = k + 1
      near%found(k) = i
      near%a(1, k) = y(i, 1)
      near%a(2, k) = y(i, 2)
      near%a(3, k) = y(i, 3)
    end do
    if (gap > reach .and. .not. with_cables) then
      near%skin = (gap - threshold)*(1.0_wp - 1.0e-9_wp)
      return
    end if
    call signed_distance_within(shape, reach, k, near%a, near%distance, near%normal)
    call keep(k, near%found, near%distance, reach, near%n_node, near%node, near%node_distance)
    if (.not. with_cables) return
    call segments_near_box(net%n_cable, net%cable_nodes, n_pad, y, near%middle, near%half, reach, k, near%found, near%a, near%b)
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
