!> Unions of placed primitives.
!>
!> Outside, and inside wherever the way out of the deepest part leads out of the union,
!> the signed distance is exact. Where parts overlap or touch, that way may end inside
!> another part; then the depth returned is that of the shortest of these ways out: straight
!> along each part's face directions through whatever follows, or out of one part after the
!> other (which finds re-entrant edges). The sign is exact, -d n from the point leads to the
!> surface of the union, and a seam between touching parts counts as inside: gaps below
!> 1e-9 of the size are closed.
module castnet_compound
  use castnet_kinds, only: wp
  use castnet_primitive, only: primitive_t, primitive_distance, shape_box, shape_cylinder
  use castnet_rotation, only: multiply, multiply_transposed
  use castnet_segment, only: primitive_segments
  implicit none
  private
  public :: compound_distance, compound_segments, to_part

  integer, parameter :: block = 64            !! points handled at a time
  real(wp), parameter :: seam_ratio = 1.0e-9_wp
  real(wp), parameter :: probe = 8.0_wp       !! how far beyond a surface point is looked at, in seams
  integer, parameter :: most_projections = 8

contains

  !> Signed distance of the union and the direction of its gradient.
  pure subroutine compound_distance(parts, n, point, distance, normal)
    type(primitive_t), intent(in) :: parts(:)
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)                !! body axes [m]
    real(wp), intent(out) :: distance(n), normal(3, n) !! [m], [-]
    real(wp) :: seam
    integer :: start, count
    seam = seam_ratio*compound_size(parts)
    do start = 1, n, block
      count = min(block, n - start + 1)
      call union_block(parts, seam, count, point(1, start), distance(start), normal(1, start))
    end do
  end subroutine compound_distance

  pure subroutine union_block(parts, seam, n, point, distance, normal)
    type(primitive_t), intent(in) :: parts(:)
    integer, intent(in) :: n
    real(wp), intent(in) :: seam, point(3, n)
    real(wp), intent(out) :: distance(n), normal(3, n)
    real(wp) :: local(3, block), d(block), g(3, block), second(block), x, y, z
    logical :: nearer
    integer :: i, k
    do i = 1, n
      distance(i) = huge(1.0_wp)
      second(i) = huge(1.0_wp)
      normal(1, i) = 1.0_wp
      normal(2, i) = 0.0_wp
      normal(3, i) = 0.0_wp
    end do
    do k = 1, size(parts)
      call to_part(parts(k), n, point, local)
      call primitive_distance(parts(k)%kind, parts(k)%half, n, local, d, g)
      associate (r => parts(k)%rotation)
        do i = 1, n
          nearer = d(i) < distance(i)
          second(i) = min(second(i), max(d(i), distance(i)))
          distance(i) = min(distance(i), d(i))
          x = r(1, 1)*g(1, i) + r(1, 2)*g(2, i) + r(1, 3)*g(3, i)
          y = r(2, 1)*g(1, i) + r(2, 2)*g(2, i) + r(2, 3)*g(3, i)
          z = r(3, 1)*g(1, i) + r(3, 2)*g(2, i) + r(3, 3)*g(3, i)
          normal(1, i) = merge(x, normal(1, i), nearer)
          normal(2, i) = merge(y, normal(2, i), nearer)
          normal(3, i) = merge(z, normal(3, i), nearer)
        end do
      end associate
    end do
    ! The way out of the deepest part can meet another one only if that is no farther than its depth.
    do i = 1, n
      if (distance(i) > seam .or. second(i) > max(0.0_wp, -distance(i)) + probe*seam) cycle
      call leave_union(parts, seam, point(:, i), distance(i), normal(:, i))
    end do
  end subroutine union_block

  !> The shortest way out of a point in the union that may lie in or near several parts.
  pure subroutine leave_union(parts, seam, point, distance, normal)
    type(primitive_t), intent(in) :: parts(:)
    real(wp), intent(in) :: seam, point(3)
    real(wp), intent(inout) :: distance, normal(3)  !! in: of the deepest part alone
    real(wp) :: d, g(3), direction(3), turned(3, 6), way, shortest, p(3)
    integer :: i, k, count
    if (is_clear(parts, seam, point - distance*normal, normal)) return
    shortest = huge(1.0_wp)
    direction = normal
    do k = 1, size(parts)
      call part_distance(parts(k), point, d, g)
      if (d > seam) cycle
      if (d > 0.0_wp) then
        if (is_clear(parts, seam, point, g)) then
          ! On an edge between touching parts: outside after all.
          distance = d
          normal = g
          return
        end if
      end if
      call exit_directions(parts(k), g, count, turned)
      do i = 1, count
        way = straight_way(parts, seam, point, turned(:, i))
        if (way >= shortest) cycle
        if (.not. is_clear(parts, seam, point + way*turned(:, i), turned(:, i))) cycle
        shortest = way
        direction = turned(:, i)
      end do
    end do
    p = point
    do i = 1, most_projections
      call deepest_part(parts, p, d, g)
      if (d >= -seam) exit
      p = p - d*g
    end do
    way = sqrt((p(1) - point(1))**2 + (p(2) - point(2))**2 + (p(3) - point(3))**2)
    if (way > seam .and. way < shortest .and. d >= -seam) then
      if (is_clear(parts, seam, p, (p - point)/way)) then
        shortest = way
        direction = (p - point)/way
      end if
    end if
    if (shortest >= huge(1.0_wp)) return
    distance = -shortest
    normal = direction
  end subroutine leave_union

  !> Is a surface point free along a direction, not the inside of another part?
  pure logical function is_clear(parts, seam, point, direction)
    type(primitive_t), intent(in) :: parts(:)
    real(wp), intent(in) :: seam, point(3), direction(3)
    real(wp) :: d, g(3)
    call deepest_part(parts, point + probe*seam*direction, d, g)
    is_clear = d > -seam
  end function is_clear

  !> How far along a direction the union lasts: out of one part, through those that follow.
  pure real(wp) function straight_way(parts, seam, point, direction) result(way)
    type(primitive_t), intent(in) :: parts(:)
    real(wp), intent(in) :: seam, point(3), direction(3)
    real(wp) :: enter, leave, before
    integer :: k, round
    way = 0.0_wp
    do round = 1, size(parts)
      before = way
      do k = 1, size(parts)
        associate (part => parts(k))
          call ray_interval(part%kind, part%half, multiply_transposed(part%rotation, point - part%position), &
                            multiply_transposed(part%rotation, direction), seam, enter, leave)
        end associate
        if (enter <= way + seam) way = max(way, leave)
      end do
      if (way <= before) exit
    end do
  end function straight_way

  !> Directions along which a convex part is left soonest or squarely, body axes.
  pure subroutine exit_directions(part, outward, count, direction)
    type(primitive_t), intent(in) :: part
    real(wp), intent(in) :: outward(3)
    integer, intent(out) :: count
    real(wp), intent(out) :: direction(3, 6)
    real(wp) :: axis(3), across(3), along, length
    integer :: k
    count = 0
    direction = 0.0_wp
    if (part%kind == shape_box) then
      do k = 1, 3
        call add_both(part%rotation(:, k), count, direction)
      end do
      return
    end if
    axis = part%rotation(:, 3)
    along = axis(1)*outward(1) + axis(2)*outward(2) + axis(3)*outward(3)
    across = outward - along*axis
    length = sqrt(across(1)**2 + across(2)**2 + across(3)**2)
    call add_both(axis, count, direction)
    if (part%kind /= shape_cylinder) call add_both(outward, count, direction)
    if (length > 1.0e-3_wp) then
      call add_both(across/length, count, direction)
    else
      call add_both(part%rotation(:, 1), count, direction)
    end if
  end subroutine exit_directions

  !> Append v and -v.
  pure subroutine add_both(v, count, direction)
    real(wp), intent(in) :: v(3)
    integer, intent(inout) :: count
    real(wp), intent(inout) :: direction(3, 6)
    direction(:, count + 1) = v
    direction(:, count + 2) = -v
    count = count + 2
  end subroutine add_both

  !> The piece enter <= t <= leave of the line origin + t direction in a convex solid, own axes;
  !> enter > leave: none. A line along a flat face counts as inside up to `slack` beyond it, so that
  !> it is not lost between two touching parts.
  pure subroutine ray_interval(kind, half, origin, direction, slack, enter, leave)
    integer, intent(in) :: kind
    real(wp), intent(in) :: half(3), origin(3), direction(3), slack
    real(wp), intent(out) :: enter, leave
    real(wp) :: first, last, other_first, other_last
    integer :: k
    enter = -huge(1.0_wp)
    leave = huge(1.0_wp)
    select case (kind)
    case (shape_box)
      do k = 1, 3
        call slab(half(k), origin(k), direction(k), slack, first, last)
        enter = max(enter, first)
        leave = min(leave, last)
      end do
    case (shape_cylinder)
      call slab(half(3), origin(3), direction(3), slack, enter, leave)
      call ball([origin(1), origin(2), 0.0_wp], [direction(1), direction(2), 0.0_wp], half(1), first, last)
      enter = max(enter, first)
      leave = min(leave, last)
    case default
      ! A capsule is the hull of what the line has in its two balls and its barrel.
      call slab(half(3), origin(3), direction(3), slack, enter, leave)
      call ball([origin(1), origin(2), 0.0_wp], [direction(1), direction(2), 0.0_wp], half(1), first, last)
      enter = max(enter, first)
      leave = min(leave, last)
      if (enter > leave) call none(enter, leave)
      do k = -1, 1, 2
        call ball(origin - [0.0_wp, 0.0_wp, real(k, wp)*half(3)], direction, half(1), other_first, other_last)
        if (other_first > other_last) cycle
        enter = min(enter, other_first)
        leave = max(leave, other_last)
      end do
    end select
    if (enter > leave) call none(enter, leave)
  end subroutine ray_interval

  pure subroutine none(enter, leave)
    real(wp), intent(out) :: enter, leave
    enter = huge(1.0_wp)
    leave = -huge(1.0_wp)
  end subroutine none

  !> |x| <= half along a line.
  pure subroutine slab(half, origin, direction, slack, enter, leave)
    real(wp), intent(in) :: half, origin, direction, slack
    real(wp), intent(out) :: enter, leave
    real(wp) :: t1, t2
    if (abs(direction) < 1.0e-12_wp) then
      enter = -huge(1.0_wp)
      leave = huge(1.0_wp)
      if (abs(origin) > half + slack) call none(enter, leave)
      return
    end if
    t1 = (-half - origin)/direction
    t2 = (half - origin)/direction
    enter = min(t1, t2)
    leave = max(t1, t2)
  end subroutine slab

  !> |origin + t direction| <= radius along a line.
  pure subroutine ball(origin, direction, radius, enter, leave)
    real(wp), intent(in) :: origin(3), direction(3), radius
    real(wp), intent(out) :: enter, leave
    real(wp) :: speed2, middle, rest(3), reach
    speed2 = direction(1)**2 + direction(2)**2 + direction(3)**2
    if (speed2 < 1.0e-24_wp) then
      enter = -huge(1.0_wp)
      leave = huge(1.0_wp)
      if (origin(1)**2 + origin(2)**2 + origin(3)**2 > radius**2) call none(enter, leave)
      return
    end if
    middle = -(origin(1)*direction(1) + origin(2)*direction(2) + origin(3)*direction(3))/speed2
    rest = origin + middle*direction
    reach = (radius**2 - (rest(1)**2 + rest(2)**2 + rest(3)**2))/speed2
    if (reach < 0.0_wp) then
      call none(enter, leave)
      return
    end if
    enter = middle - sqrt(reach)
    leave = middle + sqrt(reach)
  end subroutine ball

  !> The part whose signed distance is least, its distance and normal in body axes.
  pure subroutine deepest_part(parts, point, distance, normal)
    type(primitive_t), intent(in) :: parts(:)
    real(wp), intent(in) :: point(3)
    real(wp), intent(out) :: distance, normal(3)
    real(wp) :: d, g(3)
    integer :: k
    distance = huge(1.0_wp)
    normal = [1.0_wp, 0.0_wp, 0.0_wp]
    do k = 1, size(parts)
      call part_distance(parts(k), point, d, g)
      if (d >= distance) cycle
      distance = d
      normal = g
    end do
  end subroutine deepest_part

  pure subroutine part_distance(part, point, distance, normal)
    type(primitive_t), intent(in) :: part
    real(wp), intent(in) :: point(3)
    real(wp), intent(out) :: distance, normal(3)
    real(wp) :: d(1), g(3)
    call primitive_distance(part%kind, part%half, 1, multiply_transposed(part%rotation, point - part%position), d, g)
    distance = d(1)
    normal = multiply(part%rotation, g)
  end subroutine part_distance

  !> Nearest or deepest points of segments: the part that comes nearest decides where, the union how deep.
  pure subroutine compound_segments(parts, n, a, b, fraction, distance, normal)
    type(primitive_t), intent(in) :: parts(:)
    integer, intent(in) :: n
    real(wp), intent(in) :: a(3, n), b(3, n)                        !! ends, body axes [m]
    real(wp), intent(out) :: fraction(n), distance(n), normal(3, n) !! [-], [m], [-]
    real(wp) :: seam
    integer :: start, count
    seam = seam_ratio*compound_size(parts)
    do start = 1, n, block
      count = min(block, n - start + 1)
      call segment_union(parts, seam, count, a(1, start), b(1, start), fraction(start), distance(start), normal(1, start))
    end do
  end subroutine compound_segments

  pure subroutine segment_union(parts, seam, n, a, b, fraction, distance, normal)
    type(primitive_t), intent(in) :: parts(:)
    integer, intent(in) :: n
    real(wp), intent(in) :: seam, a(3, n), b(3, n)
    real(wp), intent(out) :: fraction(n), distance(n), normal(3, n)
    real(wp) :: first(3, block), last(3, block), t(block), d(block), g(3, block), point(3, block)
    integer :: i, k
    distance = huge(1.0_wp)
    fraction = 0.5_wp
    do k = 1, size(parts)
      call to_part(parts(k), n, a, first)
      call to_part(parts(k), n, b, last)
      call primitive_segments(parts(k)%kind, parts(k)%half, n, first, last, t, d, g)
      do i = 1, n
        fraction(i) = merge(t(i), fraction(i), d(i) < distance(i))
        distance(i) = min(distance(i), d(i))
      end do
    end do
    do i = 1, n
      point(:, i) = a(:, i) + (b(:, i) - a(:, i))*fraction(i)
    end do
    call union_block(parts, seam, n, point, distance, normal)
  end subroutine segment_union

  !> Body axes to a part's own.
  pure subroutine to_part(part, n, point, local)
    type(primitive_t), intent(in) :: part
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)
    real(wp), intent(out) :: local(3, n)
    real(wp) :: x, y, z
    integer :: i
    associate (r => part%rotation)
      do i = 1, n
        x = point(1, i) - part%position(1)
        y = point(2, i) - part%position(2)
        z = point(3, i) - part%position(3)
        local(1, i) = r(1, 1)*x + r(2, 1)*y + r(3, 1)*z
        local(2, i) = r(1, 2)*x + r(2, 2)*y + r(3, 2)*z
        local(3, i) = r(1, 3)*x + r(2, 3)*y + r(3, 3)*z
      end do
    end associate
  end subroutine to_part

  pure real(wp) function compound_size(parts) result(size_m)
    type(primitive_t), intent(in) :: parts(:)
    integer :: k
    size_m = 0.0_wp
    do k = 1, size(parts)
      size_m = max(size_m, maxval(abs(parts(k)%position)) + sum(parts(k)%half))
    end do
  end function compound_size

end module castnet_compound
