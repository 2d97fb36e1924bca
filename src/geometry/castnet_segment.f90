!> The point of a segment that is nearest to, or deepest in, an analytic solid.
!>
!> The solids are convex, so their signed distance is convex along a segment and has one
!> least value. Outside it is the least of half the squared distance, whose slope F is
!> increasing: for box and capsule F is linear between the points where a face plane is
!> crossed, so that one pass over those points brackets the zero and one interpolation
!> gives it exactly; for a cylinder F is convex on the side where its zero lies, so that
!> Newton's method from beyond it comes down monotonically. These passes are free of
!> branches and vectorise over segments. Inside (few segments) comes second, one by one.
!>
!> Where a whole piece of the segment is equally near (parallel to a face within 1e-13 of
!> its length), its middle is taken.
module castnet_segment
  use castnet_kinds, only: wp
  use castnet_primitive, only: primitive_distance, shape_box, shape_cylinder
  implicit none
  private
  public :: primitive_segments

  integer, parameter :: block = 64                  !! segments handled at a time
  integer, parameter :: newton_steps = 16           !! to rounding, also where a segment grazes a rim
  real(wp), parameter :: parallel = 1.0e-13_wp      !! sine below which a segment is parallel to a face
  real(wp), parameter :: touching = 1.0e-12_wp      !! distance from which the inside is looked at, of the size
  real(wp), parameter :: tiny_divisor = 1.0e-200_wp

contains

  !> For each segment a + (b - a) t, 0 <= t <= 1: where the signed distance to the solid is
  !> least, that distance and the outward normal there, all in the solid's own axes.
  pure subroutine primitive_segments(kind, half, n, a, b, fraction, distance, normal)
    integer, intent(in) :: kind, n
    real(wp), intent(in) :: half(3), a(3, n), b(3, n)               !! [m]
    real(wp), intent(out) :: fraction(n), distance(n), normal(3, n) !! [-], [m], [-]
    integer :: start, count
    do start = 1, n, block
      count = min(block, n - start + 1)
      call segment_block(kind, half, count, a(1, start), b(1, start), fraction(start), distance(start), normal(1, start))
    end do
  end subroutine primitive_segments

  pure subroutine segment_block(kind, half, n, a, b, fraction, distance, normal)
    integer, intent(in) :: kind, n
    real(wp), intent(in) :: half(3), a(3, n), b(3, n)
    real(wp), intent(out) :: fraction(n), distance(n), normal(3, n)
    real(wp) :: v(3, block), point(3, block), deeper, p(3), d(1), g(3)
    integer :: i
    do i = 1, n
      v(1, i) = b(1, i) - a(1, i)
      v(2, i) = b(2, i) - a(2, i)
      v(3, i) = b(3, i) - a(3, i)
    end do
    select case (kind)
    case (shape_box)
      call box_fractions(half, n, a, v, fraction)
    case (shape_cylinder)
      call cylinder_fractions(half(1), half(3), n, a, v, fraction)
    case default
      call capsule_fractions(half(3), n, a, v, fraction)
    end select
    do i = 1, n
      point(1, i) = a(1, i) + v(1, i)*fraction(i)
      point(2, i) = a(2, i) + v(2, i)*fraction(i)
      point(3, i) = a(3, i) + v(3, i)*fraction(i)
    end do
    call primitive_distance(kind, half, n, point, distance, normal)
    if (kind /= shape_box .and. kind /= shape_cylinder) return
    do i = 1, n
      if (distance(i) > touching*(half(1) + half(2) + half(3))) cycle
      if (kind == shape_box) then
        deeper = deepest_in_box(half, a(:, i), v(:, i))
      else
        deeper = deepest_in_cylinder(half(1), half(3), a(:, i), v(:, i))
      end if
      p = a(:, i) + v(:, i)*deeper
      call primitive_distance(kind, half, 1, p, d, g)
      if (d(1) > distance(i)) cycle
      fraction(i) = deeper
      distance(i) = d(1)
      normal(:, i) = g
    end do
  end subroutine segment_block

  !> Least distance to a box: the zero of F(t) = e(t).v, e = y - clamp(y), y = a + v t.
  pure subroutine box_fractions(half, n, a, v, fraction)
    integer, intent(in) :: n
    real(wp), intent(in) :: half(3), a(3, n), v(3, n)
    real(wp), intent(out) :: fraction(n)
    real(wp) :: t(block), low(block), high(block), flat_low(block), flat_high(block)
    real(wp) :: plane, slope
    integer :: i, k, axis
    do i = 1, n
      low(i) = 0.0_wp
      high(i) = 1.0_wp
      flat_low(i) = 2.0_wp
      flat_high(i) = -1.0_wp
      t(i) = 0.0_wp
    end do
    call cut(half, n, a, v, t, low, high, flat_low, flat_high)
    t(:n) = 1.0_wp
    call cut(half, n, a, v, t, low, high, flat_low, flat_high)
    do k = 1, 6
      axis = (k + 1)/2
      plane = merge(half(axis), -half(axis), k == 2*axis)
      do i = 1, n
        slope = v(axis, i)
        slope = merge(slope, 1.0_wp, abs(slope) > tiny_divisor)
        t(i) = max(0.0_wp, min(1.0_wp, (plane - a(axis, i))/slope))
      end do
      call cut(half, n, a, v, t, low, high, flat_low, flat_high)
    end do
    call close_bracket(half, n, a, v, low, high, flat_low, flat_high, fraction)
  end subroutine box_fractions

  !> Narrow the bracket of F's zero by the points t; where F vanishes, keep the zone.
  pure subroutine cut(half, n, a, v, t, low, high, flat_low, flat_high)
    integer, intent(in) :: n
    real(wp), intent(in) :: half(3), a(3, n), v(3, n), t(n)
    real(wp), intent(inout) :: low(n), high(n), flat_low(n), flat_high(n)
    real(wp) :: slope(block), square(block), speed
    logical :: is_flat
    integer :: i
    call slopes(half, n, a, v, t, slope, square)
    do i = 1, n
      speed = v(1, i)*v(1, i) + v(2, i)*v(2, i) + v(3, i)*v(3, i)
      is_flat = slope(i)*slope(i) <= parallel**2*square(i)*speed
      low(i) = merge(max(low(i), t(i)), low(i), slope(i) < 0.0_wp .and. .not. is_flat)
      high(i) = merge(min(high(i), t(i)), high(i), slope(i) > 0.0_wp .and. .not. is_flat)
      flat_low(i) = merge(min(flat_low(i), t(i)), flat_low(i), is_flat)
      flat_high(i) = merge(max(flat_high(i), t(i)), flat_high(i), is_flat)
    end do
  end subroutine cut

  !> F = e.v and e.e with e = y - clamp(y). A coordinate within rounding of its face is on it:
  !> the rounding times a long v would outweigh a small slope across the other faces.
  pure subroutine slopes(half, n, a, v, t, slope, square)
    integer, intent(in) :: n
    real(wp), intent(in) :: half(3), a(3, n), v(3, n), t(n)
    real(wp), intent(out) :: slope(n), square(n)
    real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
    real(wp) :: y1, y2, y3
    integer :: i
    do i = 1, n
      y1 = a(1, i) + v(1, i)*t(i)
      y2 = a(2, i) + v(2, i)*t(i)
      y3 = a(3, i) + v(3, i)*t(i)
      y1 = y1 - max(-half(1), min(half(1), y1))
      y2 = y2 - max(-half(2), min(half(2), y2))
      y3 = y3 - max(-half(3), min(half(3), y3))
      y1 = merge(0.0_wp, y1, abs(y1) <= rounding*(abs(a(1, i)) + half(1)))
      y2 = merge(0.0_wp, y2, abs(y2) <= rounding*(abs(a(2, i)) + half(2)))
      y3 = merge(0.0_wp, y3, abs(y3) <= rounding*(abs(a(3, i)) + half(3)))
      slope(i) = y1*v(1, i) + y2*v(2, i) + y3*v(3, i)
      square(i) = y1*y1 + y2*y2 + y3*y3
    end do
  end subroutine slopes

  !> The zero of F, linear between low and high, or the middle of the zone where F vanishes.
  pure subroutine close_bracket(half, n, a, v, low, high, flat_low, flat_high, fraction)
    integer, intent(in) :: n
    real(wp), intent(in) :: half(3), a(3, n), v(3, n), low(n), high(n), flat_low(n), flat_high(n)
    real(wp), intent(out) :: fraction(n)
    real(wp) :: first(block), last(block), square(block), t
    integer :: i
    call slopes(half, n, a, v, low, first, square)
    call slopes(half, n, a, v, high, last, square)
    do i = 1, n
      t = last(i) - first(i)
      t = low(i) - first(i)*(high(i) - low(i))/merge(t, 1.0_wp, t > tiny_divisor)
      t = max(low(i), min(high(i), t))
      fraction(i) = merge(0.5_wp*(flat_low(i) + flat_high(i)), t, flat_high(i) >= flat_low(i))
    end do
  end subroutine close_bracket

  !> Least distance to the axis piece |z| <= h of a capsule (h = 0: a sphere's centre),
  !> which is also the deepest point. The piece is a box without breadth.
  pure subroutine capsule_fractions(half_length, n, a, v, fraction)
    integer, intent(in) :: n
    real(wp), intent(in) :: half_length, a(3, n), v(3, n)
    real(wp), intent(out) :: fraction(n)
    real(wp) :: t(block), low(block), high(block), flat_low(block), flat_high(block), half(3), plane, slope
    integer :: i, k
    half = [0.0_wp, 0.0_wp, half_length]
    do i = 1, n
      low(i) = 0.0_wp
      high(i) = 1.0_wp
      flat_low(i) = 2.0_wp
      flat_high(i) = -1.0_wp
      t(i) = 0.0_wp
    end do
    call cut(half, n, a, v, t, low, high, flat_low, flat_high)
    t(:n) = 1.0_wp
    call cut(half, n, a, v, t, low, high, flat_low, flat_high)
    do k = 1, 2
      plane = merge(half_length, -half_length, k == 2)
      do i = 1, n
        slope = v(3, i)
        slope = merge(slope, 1.0_wp, abs(slope) > tiny_divisor)
        t(i) = max(0.0_wp, min(1.0_wp, (plane - a(3, i))/slope))
      end do
      call cut(half, n, a, v, t, low, high, flat_low, flat_high)
    end do
    call close_bracket(half, n, a, v, low, high, flat_low, flat_high, fraction)
  end subroutine capsule_fractions

  !> Least distance to a cylinder of radius R and half length h. With u = rho - R and w = |z| - h
  !> the least of max(u,0)^2 + max(w,0)^2 lies between the segment's points nearest the axis and
  !> nearest the middle plane: on the way s between them u rises and w falls.
  !> rho^2 = rho_0^2 + A s^2, A = v_x^2 + v_y^2, and where both are positive
  !> F(s) = A s (1 - R/rho) + v_z^2 s - K, K = |v_z| (w + |v_z| s).
  pure subroutine cylinder_fractions(radius, half_length, n, a, v, fraction)
    integer, intent(in) :: n
    real(wp), intent(in) :: radius, half_length, a(3, n), v(3, n)
    real(wp), intent(out) :: fraction(n)
    real(wp), dimension(block) :: across, climb, rho2, from, way, offset, span, top, x, low
    real(wp) :: beyond, inverse, rate, slope, u, w, s
    integer :: i, k
    call cylinder_way(radius, half_length, n, a, v, across, climb, rho2, from, way, offset, span, top)
    do i = 1, n
      ! u is positive from `low` on, w until `beyond`; if that is before `low`, `low` is as good as any.
      u = max(radius*radius - rho2(i), 0.0_wp)
      s = sqrt(u/merge(across(i), 1.0_wp, across(i) > tiny_divisor)) - offset(i)
      s = merge(s, merge(huge(1.0_wp), 0.0_wp, u > 0.0_wp), across(i) > tiny_divisor)
      low(i) = min(max(0.0_wp, s), span(i))
      beyond = span(i) + (top(i) - half_length)/merge(climb(i), 1.0_wp, climb(i) > tiny_divisor)
      s = span(i)
      span(i) = max(low(i), min(s, beyond))
      top(i) = top(i) + climb(i)*(s - span(i)) - half_length
    end do
    call start_beyond(radius, n, across, climb, rho2, offset, span, top, low, x)
    do k = 1, newton_steps
      do i = 1, n
        s = offset(i) + x(i)
        u = sqrt(rho2(i) + across(i)*s*s)
        inverse = 1.0_wp/max(u, tiny_divisor)
        w = max(top(i) + climb(i)*(span(i) - x(i)), 0.0_wp)
        slope = max(u - radius, 0.0_wp)*across(i)*s*inverse - w*climb(i)
        rate = across(i)*(1.0_wp - radius*rho2(i)*inverse*inverse*inverse) + climb(i)*climb(i)
        x(i) = max(low(i), min(span(i), x(i) - slope/max(rate, tiny_divisor)))
      end do
    end do
    do i = 1, n
      fraction(i) = max(0.0_wp, min(1.0_wp, from(i) + way(i)*x(i)))
    end do
  end subroutine cylinder_fractions

  !> A start beyond the zero of F, and near it also where the segment grazes the rim and F is
  !> nearly a cube: from far away Newton's method would gain only a third a step there.
  !> 1 - R/rho = (A s^2 - e)/(rho (rho + R)) with e = R^2 - rho_0^2, and rho is largest at the far
  !> end, so that with d = s - s_u, s_u the zero of u (or 0), a cube and a line in d stay below F.
  pure subroutine start_beyond(radius, n, across, climb, rho2, offset, span, top, low, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: radius
    real(wp), intent(in), dimension(n) :: across, climb, rho2, offset, span, top, low
    real(wp), intent(out) :: x(n)
    real(wp) :: far, rho, e, s_u, alpha, cube, line, rest, quarter, sixteenth, share
    integer :: i
    do i = 1, n
      far = offset(i) + span(i)
      rho = sqrt(rho2(i) + across(i)*far*far)
      alpha = across(i)/max(rho*(rho + radius), tiny_divisor)
      e = radius*radius - rho2(i)
      s_u = sqrt(max(e, 0.0_wp)/max(across(i), tiny_divisor))
      rest = max(climb(i)*(top(i) + climb(i)*(far - s_u)), 0.0_wp)
      cube = alpha*across(i)*far*far*far
      line = climb(i)*climb(i) + alpha*(abs(e) + max(e, 0.0_wp))
      ! The cube root from above, without a library call: y^(1/4 + 1/16 + 1/64), y <= 1.
      share = min(1.0_wp, rest/max(cube, tiny_divisor))
      quarter = sqrt(sqrt(share))
      sixteenth = sqrt(sqrt(quarter))
      share = far*(quarter*sixteenth*sqrt(sqrt(sixteenth)))
      share = min(share, rest/max(line, tiny_divisor))
      x(i) = max(low(i), min(span(i), s_u + share - offset(i)))
    end do
  end subroutine start_beyond

  !> The way from the point nearest the axis (x = 0) to the point nearest the middle plane (x = span).
  pure subroutine cylinder_way(radius, half_length, n, a, v, across, climb, rho2, from, way, offset, span, top)
    integer, intent(in) :: n
    real(wp), intent(in) :: radius, half_length, a(3, n), v(3, n)
    real(wp), intent(out) :: across(n), climb(n)  !! A, 0 when parallel to the axis; |v_z|, 0 when parallel to the caps
    real(wp), intent(out) :: rho2(n)              !! squared distance of the line from the axis
    real(wp), intent(out) :: from(n), way(n)      !! t = from + way x, way = 1 or -1
    real(wp), intent(out) :: offset(n)            !! x_0: x = -x_0 is where the line is nearest the axis
    real(wp), intent(out) :: span(n)
    real(wp), intent(out) :: top(n)               !! |z| at x = span; |z| = top + |v_z| (span - x)
    real(wp) :: square, along, reach, t_axis, t_plane, first, last
    logical :: no_across, no_along
    integer :: i
    do i = 1, n
      square = v(1, i)*v(1, i) + v(2, i)*v(2, i)
      along = v(3, i)*v(3, i)
      no_across = square <= parallel**2*(square + along)
      no_along = along <= parallel**2*(square + along)
      across(i) = merge(0.0_wp, square, no_across)
      climb(i) = merge(0.0_wp, abs(v(3, i)), no_along)
      square = merge(1.0_wp, square, no_across)
      along = merge(1.0_wp, v(3, i), no_along)
      t_axis = merge(0.5_wp, -(a(1, i)*v(1, i) + a(2, i)*v(2, i))/square, no_across)
      t_plane = -a(3, i)/along
      rho2(i) = (a(1, i) + v(1, i)*t_axis)**2 + (a(2, i) + v(2, i)*t_axis)**2
      ! Along a cap: equally near over the chord in the barrel, so its middle; no chord: nearest the axis.
      reach = sqrt(max(radius*radius - rho2(i), 0.0_wp)/square)
      first = max(0.0_wp, min(1.0_wp, t_axis - reach))
      last = max(0.0_wp, min(1.0_wp, t_axis + reach))
      ! Along the barrel: equally near over the piece between the caps.
      reach = half_length/abs(along)
      from(i) = merge(0.5_wp*(max(0.0_wp, min(1.0_wp, t_plane - reach)) + max(0.0_wp, min(1.0_wp, t_plane + reach))), &
                      max(0.0_wp, min(1.0_wp, t_axis)), no_across)
      t_plane = merge(0.5_wp*(first + last), max(0.0_wp, min(1.0_wp, t_plane)), no_along)
      from(i) = merge(0.5_wp, from(i), no_across .and. no_along)
      t_plane = merge(0.5_wp, t_plane, no_across .and. no_along)
      way(i) = merge(1.0_wp, -1.0_wp, t_plane >= from(i))
      offset(i) = max(0.0_wp, (from(i) - t_axis)*way(i))
      span(i) = (t_plane - from(i))*way(i)
      top(i) = abs(a(3, i) + v(3, i)*t_plane)
    end do
  end subroutine cylinder_way

  !> Where a segment that enters a cylinder is deepest: the least of max(u, w), which is where the
  !> rising u meets the falling w. u - w is convex: Newton's method from beyond, one segment.
  pure real(wp) function deepest_in_cylinder(radius, half_length, a, v) result(fraction)
    real(wp), intent(in) :: radius, half_length, a(3), v(3)
    real(wp), dimension(1) :: across, climb, rho2, from, way, offset, span, top
    real(wp) :: x, s, rho, w, reach, middle, step
    integer :: k
    call cylinder_way(radius, half_length, 1, a, v, across, climb, rho2, from, way, offset, span, top)
    if (.not. across(1) > 0.0_wp .and. .not. climb(1) > 0.0_wp) then
      fraction = 0.5_wp
    else if (.not. across(1) > 0.0_wp) then
      ! Along the axis: equally deep while the barrel is nearer than the caps.
      reach = max(0.0_wp, half_length + sqrt(rho2(1)) - radius)/abs(v(3))
      middle = -a(3)/v(3)
      fraction = 0.5_wp*(max(0.0_wp, min(1.0_wp, middle - reach)) + max(0.0_wp, min(1.0_wp, middle + reach)))
    else if (.not. climb(1) > 0.0_wp) then
      ! Along the caps: equally deep while a cap is nearer than the barrel.
      w = max(0.0_wp, radius + top(1) - half_length)
      reach = sqrt(max(0.0_wp, w*w - rho2(1))/across(1))
      middle = -(a(1)*v(1) + a(2)*v(2))/across(1)
      fraction = 0.5_wp*(max(0.0_wp, min(1.0_wp, middle - reach)) + max(0.0_wp, min(1.0_wp, middle + reach)))
    else
      x = span(1)
      do k = 1, 60
        s = offset(1) + x
        rho = sqrt(rho2(1) + across(1)*s*s)
        w = top(1) + climb(1)*(span(1) - x) - half_length
        step = ((rho - radius) - w)/(across(1)*s/max(rho, tiny_divisor) + climb(1))
        step = x - max(0.0_wp, min(span(1), x - step))
        x = x - step
        if (abs(step) <= 1.0e-15_wp) exit
      end do
      fraction = max(0.0_wp, min(1.0_wp, from(1) + way(1)*x))
    end if
  end function deepest_in_cylinder

  !> Where a segment that enters a box is deepest: the least of the largest of six linear
  !> functions is at an end or where two of them meet; of equals the middle.
  pure real(wp) function deepest_in_box(half, a, v) result(fraction)
    real(wp), intent(in) :: half(3), a(3), v(3)
    real(wp) :: t(17), value(17), least, first, last, side
    integer :: i, j, k, sign_i
    t(1:2) = [0.0_wp, 1.0_wp]
    k = 2
    do i = 1, 3
      k = k + 1
      t(k) = crossing(-2.0_wp*a(i), 2.0_wp*v(i))
      do j = i + 1, 3
        do sign_i = -1, 1, 2
          side = real(sign_i, wp)
          ! side*y_i - h_i = y_j - h_j, and the same with -y_j.
          t(k + 1) = crossing((half(i) - half(j)) - (side*a(i) - a(j)), side*v(i) - v(j))
          t(k + 2) = crossing((half(i) - half(j)) - (side*a(i) + a(j)), side*v(i) + v(j))
          k = k + 2
        end do
      end do
    end do
    do i = 1, k
      value(i) = max(abs(a(1) + v(1)*t(i)) - half(1), abs(a(2) + v(2)*t(i)) - half(2), abs(a(3) + v(3)*t(i)) - half(3))
    end do
    least = minval(value(:k)) + 1.0e-13_wp*(half(1) + half(2) + half(3))
    first = 1.0_wp
    last = 0.0_wp
    do i = 1, k
      if (value(i) > least) cycle
      first = min(first, t(i))
      last = max(last, t(i))
    end do
    fraction = 0.5_wp*(first + last)
  contains
    pure real(wp) function crossing(rise, rate)
      real(wp), intent(in) :: rise, rate
      crossing = 0.0_wp
      if (abs(rate) > tiny_divisor) crossing = max(0.0_wp, min(1.0_wp, rise/rate))
    end function crossing
  end function deepest_in_box

end module castnet_segment
