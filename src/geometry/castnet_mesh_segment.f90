!> Segments and moving points against a closed triangle mesh.
!>
!> Outside, the nearest point of a segment is exact: the tree is searched for the triangle
!> nearest to the whole segment. Inside, the segment is cut where it pierces the surface, and
!> in each piece between the least of the signed distance is found by cutting planes (its
!> slopes are the normals), which is exact where the solid is convex about the piece.
module castnet_mesh_segment
  use castnet_kinds, only: wp
  use castnet_mesh, only: mesh_t, mesh_point, bounds_of_distance, facet_normal, lanes, stack_depth, &
                          leaf_a, leaf_ab, leaf_ac, leaf_n, leaf_gram, leaf_inverse, leaf_items
  implicit none
  private
  public :: mesh_segments, mesh_sweep

  integer, parameter :: most_crossings = 64
  integer, parameter :: most_cuts = 40
  integer, parameter :: most_steps = 400
  real(wp), parameter :: shortest_stretch = 1.0e-9_wp !! of the segment, between two crossings
  real(wp), parameter :: flat_slope = 1.0e-12_wp  !! sine of an angle that is none
  real(wp), parameter :: tie_ratio = 1.0e-12_wp   !! of the size: equally near
  real(wp), parameter :: sweep_ratio = 1.0e-11_wp !! of the size: arrived

  !> What a search along a segment has found.
  type :: found_t
    real(wp) :: least = huge(1.0_wp)          !! distance to the surface [m]
    real(wp) :: tie = 0.0_wp                  !! [m]
    logical :: is_met = .false.               !! else `least` is where the search began
    real(wp) :: first = 0.5_wp, last = 0.5_wp !! fractions between which it is met [-]
    integer :: n_crossing = 0
    real(wp) :: crossing(most_crossings) = 0.0_wp
  end type found_t

contains

  !> For each segment a + (b - a) t, 0 <= t <= 1: where the signed distance is least, that distance
  !> and the normal there. A segment farther out than `limit` may get any distance above `limit`.
  pure subroutine mesh_segments(mesh, limit, n, a, b, fraction, distance, normal)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: limit
    integer, intent(in) :: n
    real(wp), intent(in) :: a(3, n), b(3, n)                        !! [m]
    real(wp), intent(out) :: fraction(n), distance(n), normal(3, n) !! [-], [m], [-]
    real(wp) :: v(3), bound, beyond, half_length
    integer :: i, facet
    do i = 1, n
      v = b(:, i) - a(:, i)
      half_length = 0.5_wp*sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3))
      call bounds_of_distance(mesh, a(:, i) + 0.5_wp*v, bound, beyond, facet)
      if (bound - half_length > limit) then
        fraction(i) = 0.5_wp
        distance(i) = bound - half_length
        normal(:, i) = facet_normal(mesh, facet)
      else
        call mesh_segment(mesh, limit, a(:, i), v, bound, beyond, facet, fraction(i), distance(i), normal(:, i))
      end if
    end do
  end subroutine mesh_segments

  !> The distance to the surface is met at an end, over an edge of the mesh, or where the segment
  !> pierces a face: over the inside of a face it is met all along, to the next edge or end.
  pure subroutine mesh_segment(mesh, limit, a, v, bound, beyond, facet, fraction, distance, normal)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: limit
    real(wp), intent(in) :: a(3), v(3)        !! start and whole way [m]
    real(wp), intent(in) :: bound, beyond     !! what the grid knows of the middle: d >= bound, |d| <= beyond
    integer, intent(in) :: facet              !! near the middle
    real(wp), intent(out) :: fraction, distance, normal(3)
    type(found_t) :: found
    real(wp) :: d, g(3), far
    integer :: near, k
    near = facet
    found%tie = tie_ratio*mesh%extent
    found%least = min(beyond, max(0.0_wp, limit)) + 2.0_wp*found%tie
    do k = 0, 1
      call bounds_of_distance(mesh, a + real(k, wp)*v, d, far, near)
      if (d > found%least) cycle
      call mesh_point(mesh, a + real(k, wp)*v, near, d, g)
      call offer(real(k, wp), abs(d), found)
    end do
    call search_tree(mesh, a, v, found)
    near = facet
    if (found%n_crossing == 0) then
      ! All on one side. Nothing nearer than the limit: any point tells which.
      fraction = 0.5_wp*(found%first + found%last)
      if (.not. found%is_met) then
        fraction = 0.5_wp
        if (bound > 0.0_wp) then
          distance = max(found%least, bound - 0.5_wp*sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3)))
          normal = facet_normal(mesh, facet)
          return
        end if
      end if
      call mesh_point(mesh, a + fraction*v, near, distance, normal)
      if (distance > found%least + 4.0_wp*found%tie .and. found%is_met) then
        ! Equally near at separate places: the first.
        fraction = found%first
        call mesh_point(mesh, a + fraction*v, near, distance, normal)
      end if
      if (distance >= -found%tie) return
    end if
    fraction = 0.5_wp
    call mesh_point(mesh, a + 0.5_wp*v, near, distance, normal)
    call search_inside(mesh, a, v, found%crossing(:found%n_crossing), near, fraction, distance, normal)
  end subroutine mesh_segment

  !> The least signed distance of a segment that is inside somewhere: stretch by stretch.
  pure subroutine search_inside(mesh, a, v, crossing, near, fraction, distance, normal)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: a(3), v(3), crossing(:)
    integer, intent(inout) :: near
    real(wp), intent(inout) :: fraction, distance, normal(3)  !! in: of the middle
    real(wp) :: cut(0:most_crossings + 1), d, g(3), t
    integer :: k, i, last
    last = size(crossing) + 1
    cut(0) = 0.0_wp
    ! Insertion: there are two or four of them.
    do k = 1, size(crossing)
      t = crossing(k)
      do i = k - 1, 1, -1
        if (cut(i) <= t) exit
        cut(i + 1) = cut(i)
      end do
      cut(i + 1) = t
    end do
    cut(last) = 1.0_wp
    do k = 0, 1
      t = real(k, wp)
      call mesh_point(mesh, a + t*v, near, d, g)
      if (d < distance) call keep(t, d, g, fraction, distance, normal)
    end do
    do k = 1, last
      if (cut(k) - cut(k - 1) <= shortest_stretch) cycle
      t = 0.5_wp*(cut(k - 1) + cut(k))
      call mesh_point(mesh, a + t*v, near, d, g)
      if (d >= 0.0_wp) cycle
      if (d < distance) call keep(t, d, g, fraction, distance, normal)
      call deepen(mesh, a, v, [cut(k - 1), t, cut(k)], d, g, near, fraction, distance, normal)
    end do
    if (distance <= 0.0_wp) return
    ! Only touched: a crossing is as near as the surface gets.
    call mesh_point(mesh, a + cut(1)*v, near, distance, normal)
    fraction = cut(1)
  end subroutine search_inside

  pure subroutine keep(t, d, g, fraction, distance, normal)
    real(wp), intent(in) :: t, d, g(3)
    real(wp), intent(out) :: fraction, distance, normal(3)
    fraction = t
    distance = d
    normal = g
  end subroutine keep

  !> Look for less on an inside stretch: the tangents at both ends of a bracket meet below the
  !> least (Kelley 1960), until they meet at it.
  pure subroutine deepen(mesh, a, v, place, d_middle, g_middle, near, fraction, distance, normal)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: a(3), v(3)
    real(wp), intent(in) :: place(3)                   !! from, middle, to
    real(wp), intent(in) :: d_middle, g_middle(3)
    integer, intent(inout) :: near
    real(wp), intent(inout) :: fraction, distance, normal(3)
    real(wp) :: g(3), low, high, d_low, d_high, s_low, s_high, x, value, rate
    integer :: k
    low = place(2)
    d_low = d_middle
    s_low = g_middle(1)*v(1) + g_middle(2)*v(2) + g_middle(3)*v(3)
    high = low
    d_high = d_low
    s_high = s_low
    if (abs(s_low) <= flat_slope*sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3))) return
    if (s_high > 0.0_wp) then
      low = place(1)
      call mesh_point(mesh, a + low*v, near, d_low, g)
      s_low = g(1)*v(1) + g(2)*v(2) + g(3)*v(3)
      if (d_low < distance) call keep(low, d_low, g, fraction, distance, normal)
    else
      high = place(3)
      call mesh_point(mesh, a + high*v, near, d_high, g)
      s_high = g(1)*v(1) + g(2)*v(2) + g(3)*v(3)
      if (d_high < distance) call keep(high, d_high, g, fraction, distance, normal)
    end if
    do k = 1, most_cuts
      if (s_low >= 0.0_wp .or. s_high <= 0.0_wp) exit
      x = (d_high - d_low + s_low*low - s_high*high)/(s_low - s_high)
      if (d_low + s_low*(x - low) >= distance - tie_ratio*mesh%extent) exit
      if (x <= low .or. x >= high) exit
      call mesh_point(mesh, a + x*v, near, value, g)
      rate = g(1)*v(1) + g(2)*v(2) + g(3)*v(3)
      if (value < distance) call keep(x, value, g, fraction, distance, normal)
      if (rate < 0.0_wp) then
        low = x
        d_low = value
        s_low = rate
      else
        high = x
        d_high = value
        s_high = rate
      end if
    end do
  end subroutine deepen

  !> Distance from a segment to the surface, and where the segment pierces it.
  pure subroutine search_tree(mesh, a, v, found)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: a(3), v(3)
    type(found_t), intent(inout) :: found
    real(wp) :: d(lanes), waiting_distance(stack_depth), reach
    integer :: waiting(stack_depth), height, node, k
    height = 1
    waiting(1) = mesh%root
    waiting_distance(1) = 0.0_wp
    do while (height > 0)
      node = waiting(height)
      height = height - 1
      reach = found%least + found%tie
      if (waiting_distance(height + 1) > reach*reach) cycle
      if (node < 0) then
        call try_leaf(mesh%leaf(:, :, -node), a, v, found)
        cycle
      end if
      call boxes_gap2(mesh%box(:, :, node), a, v, reach, d)
      do k = 1, lanes
        if (d(k) > reach*reach .or. mesh%child(k, node) == 0) cycle
        ! The nearest on top.
        height = height + 1
        waiting(height) = mesh%child(k, node)
        waiting_distance(height) = d(k)
        if (height == 1) cycle
        if (waiting_distance(height - 1) < d(k)) then
          waiting(height) = waiting(height - 1)
          waiting_distance(height) = waiting_distance(height - 1)
          waiting(height - 1) = mesh%child(k, node)
          waiting_distance(height - 1) = d(k)
        end if
      end do
    end do
  end subroutine search_tree

  !> Lower bounds of the squared distances from a segment to eight boxes: that of its own box; huge
  !> where the segment does not meet the box widened by `reach`, which for a slanting one says more.
  pure subroutine boxes_gap2(bounds, a, v, reach, square)
    real(wp), intent(in) :: bounds(lanes, 6), a(3), v(3), reach
    real(wp), intent(out) :: square(lanes)
    real(wp), parameter :: steepest = 1.0e150_wp  ! times a box of no child still a number
    real(wp) :: low(3), high(3), inverse(3), x, y, z, enter, leave, p, q
    integer :: k
    low = min(a, a + v)
    high = max(a, a + v)
    do k = 1, 3
      inverse(k) = sign(steepest, v(k))
      if (abs(v(k)) > 1.0_wp/steepest) inverse(k) = 1.0_wp/v(k)
    end do
    !GCC$ unroll 1
    do k = 1, lanes
      x = max(bounds(k, 1) - high(1), max(low(1) - bounds(k, 4), 0.0_wp))
      y = max(bounds(k, 2) - high(2), max(low(2) - bounds(k, 5), 0.0_wp))
      z = max(bounds(k, 3) - high(3), max(low(3) - bounds(k, 6), 0.0_wp))
      p = (bounds(k, 1) - reach - a(1))*inverse(1)
      q = (bounds(k, 4) + reach - a(1))*inverse(1)
      enter = min(p, q)
      leave = max(p, q)
      p = (bounds(k, 2) - reach - a(2))*inverse(2)
      q = (bounds(k, 5) + reach - a(2))*inverse(2)
      enter = max(enter, min(p, q))
      leave = min(leave, max(p, q))
      p = (bounds(k, 3) - reach - a(3))*inverse(3)
      q = (bounds(k, 6) + reach - a(3))*inverse(3)
      enter = max(enter, max(min(p, q), 0.0_wp))
      leave = min(leave, min(max(p, q), 1.0_wp))
      square(k) = merge(x*x + y*y + z*z, huge(1.0_wp), enter <= leave + 1.0e-9_wp)
    end do
  end subroutine boxes_gap2

  !> The edges of eight triangles, and where the segment pierces them.
  pure subroutine try_leaf(f, a, v, found)
    real(wp), intent(in) :: f(lanes, leaf_items), a(3), v(3)
    type(found_t), intent(inout) :: found
    real(wp) :: square(lanes, 3), t(lanes, 3), corner(lanes, 3), side(lanes, 3), piercing(lanes), reach
    integer :: i, k
    do i = 1, 3
      corner(:, i) = f(:, leaf_a + i - 1)
      side(:, i) = f(:, leaf_ab + i - 1)
    end do
    call edge(corner, side, f(:, leaf_inverse), a, v, t(:, 1), square(:, 1))
    do i = 1, 3
      side(:, i) = f(:, leaf_ac + i - 1)
    end do
    call edge(corner, side, f(:, leaf_inverse + 1), a, v, t(:, 2), square(:, 2))
    do i = 1, 3
      corner(:, i) = corner(:, i) + side(:, i)
      side(:, i) = f(:, leaf_ab + i - 1) - side(:, i)
    end do
    call edge(corner, side, f(:, leaf_inverse + 2), a, v, t(:, 3), square(:, 3))
    reach = (found%least + found%tie)**2
    do i = 1, 3
      do k = 1, lanes
        if (square(k, i) <= reach) call offer(t(k, i), sqrt(square(k, i)), found)
      end do
    end do
    call pierce(f, a, v, found%tie, piercing)
    do k = 1, lanes
      if (piercing(k) > 1.0_wp) cycle
      call offer(piercing(k), 0.0_wp, found)
      if (found%n_crossing == most_crossings) cycle
      found%n_crossing = found%n_crossing + 1
      found%crossing(found%n_crossing) = piercing(k)
    end do
  end subroutine try_leaf

  !> Where a segment pierces eight triangles; 2 where it does not, or lies in their plane.
  pure subroutine pierce(f, a, v, tie, t)
    real(wp), intent(in) :: f(lanes, leaf_items), a(3), v(3), tie
    real(wp), intent(out) :: t(lanes)
    real(wp), parameter :: leak = 1.0e-9_wp  ! a crossing on an edge is seen from both sides
    real(wp) :: p1, p2, p3, start, rise, x, a1, a2, b, c, determinant, crosses
    integer :: k
    !GCC$ unroll 1
    do k = 1, lanes
      p1 = a(1) - f(k, leaf_a)
      p2 = a(2) - f(k, leaf_a + 1)
      p3 = a(3) - f(k, leaf_a + 2)
      start = p1*f(k, leaf_n) + p2*f(k, leaf_n + 1) + p3*f(k, leaf_n + 2)
      rise = v(1)*f(k, leaf_n) + v(2)*f(k, leaf_n + 1) + v(3)*f(k, leaf_n + 2)
      ! Numbers for conditions: with logicals gfortran 12 does not vectorise this loop.
      crosses = merge(1.0_wp, 0.0_wp, start*(start + rise) <= 0.0_wp)* &
                merge(1.0_wp, 0.0_wp, max(abs(start), abs(start + rise)) > tie)
      x = max(0.0_wp, min(1.0_wp, -start/merge(rise, 1.0_wp, abs(rise) > 1.0e-200_wp)))
      p1 = p1 + x*v(1)
      p2 = p2 + x*v(2)
      p3 = p3 + x*v(3)
      a1 = f(k, leaf_ab)*p1 + f(k, leaf_ab + 1)*p2 + f(k, leaf_ab + 2)*p3
      a2 = f(k, leaf_ac)*p1 + f(k, leaf_ac + 1)*p2 + f(k, leaf_ac + 2)*p3
      b = f(k, leaf_gram + 2)*a1 - f(k, leaf_gram + 1)*a2
      c = f(k, leaf_gram)*a2 - f(k, leaf_gram + 1)*a1
      determinant = f(k, leaf_gram)*f(k, leaf_gram + 2) - f(k, leaf_gram + 1)*f(k, leaf_gram + 1)
      crosses = crosses*merge(1.0_wp, 0.0_wp, b >= -leak*determinant)*merge(1.0_wp, 0.0_wp, c >= -leak*determinant)
      t(k) = merge(x, 2.0_wp, crosses*merge(1.0_wp, 0.0_wp, b + c <= (1.0_wp + leak)*determinant) > 0.5_wp)
    end do
  end subroutine pierce

  !> Where a segment is nearest to eight edges (Ericson, Real-Time Collision Detection, 5.1.9).
  pure subroutine edge(corner, side, inverse, a, v, t_edge, square)
    real(wp), intent(in) :: corner(lanes, 3), side(lanes, 3), inverse(lanes), a(3), v(3)
    real(wp), intent(out) :: t_edge(lanes), square(lanes)
    real(wp) :: r1, r2, r3, vv, ww, vw, vr, wr, s, t, denominator, inverse_vv
    integer :: k
    vv = v(1)*v(1) + v(2)*v(2) + v(3)*v(3)
    inverse_vv = 1.0_wp/merge(vv, 1.0_wp, vv > 0.0_wp)
    !GCC$ unroll 1
    do k = 1, lanes
      r1 = a(1) - corner(k, 1)
      r2 = a(2) - corner(k, 2)
      r3 = a(3) - corner(k, 3)
      ww = side(k, 1)*side(k, 1) + side(k, 2)*side(k, 2) + side(k, 3)*side(k, 3)
      vw = v(1)*side(k, 1) + v(2)*side(k, 2) + v(3)*side(k, 3)
      vr = v(1)*r1 + v(2)*r2 + v(3)*r3
      wr = side(k, 1)*r1 + side(k, 2)*r2 + side(k, 3)*r3
      denominator = vv*ww - vw*vw
      t = max(0.0_wp, min(1.0_wp, (vw*wr - vr*ww)/merge(denominator, 1.0_wp, denominator > 1.0e-24_wp*vv*ww)))
      s = max(0.0_wp, min(1.0_wp, (vw*t + wr)*inverse(k)))
      t = max(0.0_wp, min(1.0_wp, (vw*s - vr)*inverse_vv))
      t_edge(k) = t
      square(k) = (r1 + t*v(1) - s*side(k, 1))**2 + (r2 + t*v(2) - s*side(k, 2))**2 + (r3 + t*v(3) - s*side(k, 3))**2
    end do
  end subroutine edge

  !> Take a nearer place, or widen the piece that is equally near.
  pure subroutine offer(t, distance, found)
    real(wp), intent(in) :: t, distance
    type(found_t), intent(inout) :: found
    if (distance > found%least + found%tie) return
    if (distance < found%least - found%tie .or. .not. found%is_met) then
      found%first = t
      found%last = t
    else
      found%first = min(found%first, t)
      found%last = max(found%last, t)
    end if
    found%least = merge(min(found%least, distance), distance, found%is_met)
    found%is_met = .true.
  end subroutine offer

  !> First fraction of the way from p0 to p1 at which the signed distance is `limit` or less, 2 if
  !> there is none: each step goes as far as the distance lets it without passing anything.
  pure subroutine mesh_sweep(mesh, p0, p1, limit, fraction)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: p0(3), p1(3), limit
    real(wp), intent(out) :: fraction
    real(wp) :: v(3), length, t, d, g(3), nearest(1), least(1), normal(3, 1)
    integer :: facet, k
    fraction = 2.0_wp
    call mesh_segments(mesh, limit, 1, p0, p1, nearest, least, normal)
    if (least(1) > limit) return
    v = p1 - p0
    length = sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3))
    fraction = 0.0_wp
    call bounds_of_distance(mesh, p0, d, t, facet)
    t = 0.0_wp
    do k = 1, most_steps
      call mesh_point(mesh, p0 + fraction*v, facet, d, g)
      if (d <= limit + sweep_ratio*mesh%extent) return
      t = fraction + (d - limit)/length
      if (t > nearest(1) .or. t <= fraction) exit
      fraction = t
    end do
    ! A grazing way: the steps have become shorter than any use, or passed the nearest point by rounding.
    if (t > nearest(1)) fraction = nearest(1)
  end subroutine mesh_sweep

end module castnet_mesh_segment
