!> Contacts from what is near: exact signed distance in body axes, then gap, normal, arm
!> and relative velocity of every point within the threshold.
!>
!> A cable touches at the one point where it is nearest to the body or deepest in it,
!> unless an end of it is in contact and about as deep: then it lies on its nodes.
module castnet_narrow_phase
  use castnet_kinds, only: wp
  use castnet_net, only: net_t
  use castnet_shape, only: shape_t, signed_distance, signed_distance_within, segment_distance_within, is_convex
  use castnet_contact_list, only: contact_list_t
  use castnet_near_list, only: near_list_t
  implicit none
  private
  public :: append_nodes, append_cables, set_velocities, mend_normal

  !> A cable that is deeper than its ends by less than this part of the threshold lies on
  !> its nodes [-].
  real(wp), parameter :: lies_on_node = 1.0e-3_wp

contains

  !> Nodes within the threshold, as node contacts. A fixed node on a fixed target is no contact.
  subroutine append_nodes(near, move, threshold, net, shape, n_pad, x, centre, r, target_fixed, list)
    type(near_list_t), intent(inout) :: near
    real(wp), intent(in) :: move, threshold              !! since the near list was built; [m]
    type(net_t), intent(in) :: net
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)                  !! inertial [m]
    real(wp), intent(in) :: centre(3), r(3, 3)           !! body to inertial
    logical, intent(in) :: target_fixed
    type(contact_list_t), intent(inout) :: list
    real(wp) :: reach, box_reach
    integer :: k, i, n
    reach = (threshold + move)*(1.0_wp + 1.0e-12_wp)
    box_reach = threshold*(1.0_wp + 1.0e-12_wp) + 1.0e-12_wp*near%radius
    call place_noted(near%n_node, near%node, n_pad, x, centre, r, near%middle, near%half, near%body, near%outside)
    n = 0
    do k = 1, near%n_node
      ! Outside of the body's box by more than the threshold: no need of the exact distance.
      if (near%node_distance(k) > reach .or. near%outside(k) > box_reach) cycle
      n = n + 1
      near%found(n) = near%node(k)
      near%a(1, n) = near%body(k, 1)
      near%a(2, n) = near%body(k, 2)
      near%a(3, n) = near%body(k, 3)
    end do
    if (n == 0) return
    call signed_distance_within(shape, threshold, n, near%a, near%distance, near%normal)
    do k = 1, n
      if (.not. near%distance(k) <= threshold) cycle
      i = near%found(k)
      if (target_fixed .and. net%inverse_mass(i) <= 0.0_wp) cycle
      list%n = list%n + 1
      call set_point(list, list%n, i, i, 0.0_wp, net%inverse_mass(i), 0.0_wp, x(i, 1), x(i, 2), x(i, 3), centre, r, &
                     near%distance(k), near%normal(:, k))
    end do
  end subroutine append_nodes

  !> The noted nodes in body axes, and how far outside of the body's box each one is.
  pure subroutine place_noted(m, node, n_pad, x, centre, r, middle, half, y, outside)
    integer, intent(in) :: m, node(m), n_pad
    real(wp), intent(in) :: x(n_pad, 3), centre(3), r(3, 3), middle(3), half(3)
    real(wp), contiguous, intent(inout) :: y(:, :), outside(:) !! (>=m,3), (>=m) [m]
    real(wp) :: dx, dy, dz, u, v, w
    integer :: k
    do k = 1, m
      dx = x(node(k), 1) - centre(1)
      dy = x(node(k), 2) - centre(2)
      dz = x(node(k), 3) - centre(3)
      u = r(1, 1)*dx + r(2, 1)*dy + r(3, 1)*dz
      v = r(1, 2)*dx + r(2, 2)*dy + r(3, 2)*dz
      w = r(1, 3)*dx + r(2, 3)*dy + r(3, 3)*dz
      y(k, 1) = u
      y(k, 2) = v
      y(k, 3) = w
      outside(k) = max(max(abs(u - middle(1)) - half(1), abs(v - middle(2)) - half(2)), abs(w - middle(3)) - half(3))
    end do
  end subroutine place_noted

  !> Cables within the threshold that do not lie on their nodes. Comes after the nodes.
  subroutine append_cables(near, move, threshold, net, shape, n_pad, x, y, centre, r, target_fixed, node_gap, list)
    type(near_list_t), intent(inout) :: near
    real(wp), intent(in) :: move, threshold
    type(net_t), intent(in) :: net
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), y(n_pad, 3)
    real(wp), intent(in) :: centre(3), r(3, 3)
    logical, intent(in) :: target_fixed
    real(wp), intent(inout) :: node_gap(n_pad)           !! huge, and again huge after
    type(contact_list_t), intent(inout) :: list
    real(wp) :: reach, s, p(3), gap, g(3)
    integer :: k, c, a, b, n, n_node_contact
    reach = (threshold + move)*(1.0_wp + 1.0e-12_wp)
    n = 0
    do k = 1, near%n_cable
      if (near%cable_distance(k) > reach) cycle
      c = near%cable(k)
      a = net%cable_nodes(1, c)
      b = net%cable_nodes(2, c)
      if (target_fixed .and. net%inverse_mass(a) + net%inverse_mass(b) <= 0.0_wp) cycle
      n = n + 1
      near%found(n) = c
      near%a(1, n) = y(a, 1)
      near%a(2, n) = y(a, 2)
      near%a(3, n) = y(a, 3)
      near%b(1, n) = y(b, 1)
      near%b(2, n) = y(b, 2)
      near%b(3, n) = y(b, 3)
    end do
    if (n == 0) return
    n_node_contact = list%n
    do k = 1, n_node_contact
      node_gap(list%node_a(k)) = list%gap(k)
    end do
    if (is_convex(shape)) call sieve_cables(near, threshold, net, shape, n_pad, node_gap, n)
    call segment_distance_within(shape, threshold, n, near%a, near%b, near%fraction, near%distance, near%normal)
    do k = 1, n
      if (.not. near%distance(k) <= threshold) cycle
      c = near%found(k)
      a = net%cable_nodes(1, c)
      b = net%cable_nodes(2, c)
      if (near%distance(k) >= min(node_gap(a), node_gap(b)) - lies_on_node*threshold) cycle
      s = near%fraction(k)
      p = (1.0_wp - s)*x(a, :) + s*x(b, :)
      list%n = list%n + 1
      gap = near%distance(k)
      g = near%normal(:, k)
      if (gap < 0.0_wp) call mend_normal(shape, near%a(:, k), near%b(:, k), s, gap, g)
      call set_point(list, list%n, a, b, s, net%inverse_mass(a), net%inverse_mass(b), p(1), p(2), p(3), centre, r, gap, g)
    end do
    do k = 1, n_node_contact
      node_gap(list%node_a(k)) = huge(1.0_wp)
    end do
  end subroutine append_cables

  !> Drop the cables that cannot be contacts, by their ends alone: a convex solid's distance
  !> is convex along a cable, so it lies above the tangents at both ends, and nowhere below
  !> where these cross. Most cables near a body lie along a face of it, on their nodes.
  subroutine sieve_cables(near, threshold, net, shape, n_pad, node_gap, n)
    type(near_list_t), intent(inout) :: near
    real(wp), intent(in) :: threshold
    type(net_t), intent(in) :: net
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: node_gap(n_pad)              !! huge but for nodes in contact [m]
    integer, intent(inout) :: n                          !! candidates in near%found, near%a, near%b
    real(wp) :: v1, v2, v3, first, last, least, margin
    integer :: k, kept, c
    margin = 0.5_wp*lies_on_node*threshold               ! for rounding, on the safe side
    call signed_distance(shape, n, near%a, near%distance, near%normal)
    call signed_distance(shape, n, near%b, near%end_distance, near%end_normal)
    do k = 1, n
      v1 = near%b(1, k) - near%a(1, k)
      v2 = near%b(2, k) - near%a(2, k)
      v3 = near%b(3, k) - near%a(3, k)
      first = min(0.0_wp, near%normal(1, k)*v1 + near%normal(2, k)*v2 + near%normal(3, k)*v3)
      last = max(0.0_wp, near%end_normal(1, k)*v1 + near%end_normal(2, k)*v2 + near%end_normal(3, k)*v3)
      ! Where d_a + first t meets d_b - last (1 - t); without a crossing the lower end.
      least = near%distance(k)*last - near%end_distance(k)*first + first*last
      v1 = last - first
      least = least/merge(v1, 1.0_wp, v1 > 0.0_wp)
      near%fraction(k) = merge(least, near%distance(k), v1 > 0.0_wp)
      near%fraction(k) = min(near%fraction(k), near%distance(k), near%end_distance(k))
    end do
    kept = 0
    do k = 1, n
      least = near%fraction(k)
      if (least > threshold + margin) cycle
      c = near%found(k)
      if (least >= min(node_gap(net%cable_nodes(1, c)), node_gap(net%cable_nodes(2, c))) - margin) cycle
      kept = kept + 1
      near%found(kept) = c
      near%a(:, kept) = near%a(:, k)
      near%b(:, kept) = near%b(:, k)
    end do
    n = kept
  end subroutine sieve_cables

  !> The normal of a cable that has sunk in over an edge. Its deepest point is as far from
  !> one face as from the other, and neither face's normal n1, n2 is the way out: that is
  !> the gradient of the segment's depth, their mean across the segment u,
  !> n ~ (n2.u) n1 - (n1.u) n2, the common normal of cable and edge. It gains depth by
  !> |n| <= 1 for each unit moved, so that the gap along it is the depth over |n|.
  pure subroutine mend_normal(shape, a, b, s, gap, g)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: a(3), b(3), s       !! ends [m] and share, body axes
    real(wp), intent(inout) :: gap, g(3)        !! in: signed distance and its normal; out: along the normal
    real(wp) :: u(3), p(3, 2), d(2), n(3, 2), length, step, along(2), size
    integer :: i
    u = b - a
    length = sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3))
    if (.not. length > 0.0_wp .or. s <= 0.0_wp .or. s >= 1.0_wp) return
    u = u/length
    step = max(1.0e-3_wp*abs(gap), 1.0e-9_wp*length)/length
    p(:, 1) = a + max(0.0_wp, s - step)*length*u
    p(:, 2) = a + min(1.0_wp, s + step)*length*u
    call signed_distance(shape, 2, p, d, n)
    do i = 1, 2
      along(i) = n(1, i)*u(1) + n(2, i)*u(2) + n(3, i)*u(3)
    end do
    ! Falling before, rising after: a kink. Elsewhere the distance is smooth and g is right.
    if (.not. (along(1) < -1.0e-3_wp .and. along(2) > 1.0e-3_wp)) return
    g = (along(2)*n(:, 1) - along(1)*n(:, 2))/(along(2) - along(1))
    size = sqrt(g(1)*g(1) + g(2)*g(2) + g(3)*g(3))
    if (size < 1.0e-3_wp) return
    g = g/size
    gap = gap/size
  end subroutine mend_normal

  !> One contact of the list.
  pure subroutine set_point(list, c, a, b, s, inverse_mass_a, inverse_mass_b, px, py, pz, centre, r, gap, g)
    type(contact_list_t), intent(inout) :: list
    integer, intent(in) :: c, a, b
    real(wp), intent(in) :: s, inverse_mass_a, inverse_mass_b
    real(wp), intent(in) :: px, py, pz, centre(3), r(3, 3) !! the point, inertial [m]
    real(wp), intent(in) :: gap, g(3)                      !! [m], normal in body axes
    list%node_a(c) = a
    list%node_b(c) = b
    list%share(c) = s
    list%weight_a(c) = 1.0_wp - s
    list%inverse_mass_a(c) = inverse_mass_a
    list%inverse_mass_b(c) = inverse_mass_b
    list%gap(c) = gap
    list%normal(c, 1) = r(1, 1)*g(1) + r(1, 2)*g(2) + r(1, 3)*g(3)
    list%normal(c, 2) = r(2, 1)*g(1) + r(2, 2)*g(2) + r(2, 3)*g(3)
    list%normal(c, 3) = r(3, 1)*g(1) + r(3, 2)*g(2) + r(3, 3)*g(3)
    list%arm(c, 1) = px - centre(1)
    list%arm(c, 2) = py - centre(2)
    list%arm(c, 3) = pz - centre(3)
  end subroutine set_point

  !> Velocity of every contact point against the body's material point there. The arm
  !> ends at the net's point, not on the surface, so that impulse and reaction share one
  !> line of action and angular momentum is kept to rounding.
  pure subroutine set_velocities(n_pad, v, body_velocity, body_rate, list)
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: v(n_pad, 3)                  !! node velocities [m/s]
    real(wp), intent(in) :: body_velocity(3), body_rate(3) !! inertial axes [m/s], [rad/s]
    type(contact_list_t), intent(inout) :: list
    real(wp) :: p, q, u(3), w(3)
    integer :: c, a, b
    w = body_rate
    do c = 1, list%n
      a = list%node_a(c)
      b = list%node_b(c)
      p = list%weight_a(c)
      q = list%share(c)
      u(1) = p*v(a, 1) + q*v(b, 1) - body_velocity(1) - (w(2)*list%arm(c, 3) - w(3)*list%arm(c, 2))
      u(2) = p*v(a, 2) + q*v(b, 2) - body_velocity(2) - (w(3)*list%arm(c, 1) - w(1)*list%arm(c, 3))
      u(3) = p*v(a, 3) + q*v(b, 3) - body_velocity(3) - (w(1)*list%arm(c, 2) - w(2)*list%arm(c, 1))
      list%velocity(c, 1) = u(1)
      list%velocity(c, 2) = u(2)
      list%velocity(c, 3) = u(3)
      list%normal_velocity(c) = u(1)*list%normal(c, 1) + u(2)*list%normal(c, 2) + u(3)*list%normal(c, 3)
    end do
  end subroutine set_velocities

end module castnet_narrow_phase
