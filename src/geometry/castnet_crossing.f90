!> Two segments whose ends move along straight lines: do they pass through each other?
!>
!> They can only while their four ends lie in one plane. The volume of the tetrahedron on
!> them, (b - a) x (d - c) . (c - a), is a cubic in time; each of its roots is looked at,
!> and one at which the lines meet within both segments is a crossing. The cubic is kept in
!> Bernstein form: its first and last coefficient are the volumes at the two instants, to
!> the bit, so that no crossing falls between two steps or is counted in both.
module castnet_crossing
  use castnet_kinds, only: wp
  use castnet_vector, only: cross, dot
  implicit none
  private
  public :: crossing_t, segments_cross, segment_gap

  integer, parameter :: bisections = 50  !! of a time within [0, 1]

  !> The first crossing of a pair.
  type :: crossing_t
    integer :: n = 0                     !! how often the pair passes through each other
    real(wp) :: time = 0.0_wp            !! within the motion, 0 to 1 [-]
    real(wp) :: share(2) = 0.0_wp        !! where on each segment, from its first end [-]
    real(wp) :: normal(3) = 0.0_wp       !! unit, from the first segment to the second as they stood before
  end type crossing_t

contains

  !> Segments from point 1 to 2 and from 3 to 4.
  pure subroutine segments_cross(from, to, found)
    real(wp), intent(in) :: from(3, 4), to(3, 4)  !! the ends before and after
    type(crossing_t), intent(out) :: found
    real(wp) :: u(3, 2), v(3, 2), w(3, 2), b(0:3), stop_at(3), low, high
    logical :: above, above_next
    integer :: axis, k, n_stop
    do axis = 1, 3
      if (max(from(axis, 1), from(axis, 2), to(axis, 1), to(axis, 2)) &
          < min(from(axis, 3), from(axis, 4), to(axis, 3), to(axis, 4))) return
      if (max(from(axis, 3), from(axis, 4), to(axis, 3), to(axis, 4)) &
          < min(from(axis, 1), from(axis, 2), to(axis, 1), to(axis, 2))) return
    end do
    u(:, 1) = from(:, 2) - from(:, 1)
    v(:, 1) = from(:, 4) - from(:, 3)
    w(:, 1) = from(:, 3) - from(:, 1)
    u(:, 2) = to(:, 2) - to(:, 1)
    v(:, 2) = to(:, 4) - to(:, 3)
    w(:, 2) = to(:, 3) - to(:, 1)
    b(0) = volume(u(:, 1), v(:, 1), w(:, 1))
    b(1) = (volume(u(:, 2), v(:, 1), w(:, 1)) + volume(u(:, 1), v(:, 2), w(:, 1)) + volume(u(:, 1), v(:, 1), w(:, 2)))/3.0_wp
    b(2) = (volume(u(:, 2), v(:, 2), w(:, 1)) + volume(u(:, 2), v(:, 1), w(:, 2)) + volume(u(:, 1), v(:, 2), w(:, 2)))/3.0_wp
    b(3) = volume(u(:, 2), v(:, 2), w(:, 2))
    if (all(b >= 0.0_wp) .or. all(b < 0.0_wp)) return
    call turning_points(b, n_stop, stop_at)
    n_stop = n_stop + 1
    stop_at(n_stop) = 1.0_wp
    low = 0.0_wp
    above = b(0) >= 0.0_wp
    do k = 1, n_stop
      high = stop_at(k)
      above_next = value(b, high) >= 0.0_wp
      if (above .neqv. above_next) call look_at(u, v, w, root(b, low, high, above), above, found)
      low = high
      above = above_next
    end do
  end subroutine segments_cross

  !> u x v . w.
  pure real(wp) function volume(u, v, w)
    real(wp), intent(in) :: u(3), v(3), w(3)
    volume = (u(2)*v(3) - u(3)*v(2))*w(1) + (u(3)*v(1) - u(1)*v(3))*w(2) + (u(1)*v(2) - u(2)*v(1))*w(3)
  end function volume

  !> Do the lines meet within both segments at this time?
  pure subroutine look_at(u, v, w, time, from_above, found)
    real(wp), intent(in) :: u(3, 2), v(3, 2), w(3, 2)  !! before and after
    real(wp), intent(in) :: time
    logical, intent(in) :: from_above                  !! the volume was not negative before
    type(crossing_t), intent(inout) :: found
    real(wp) :: p(3), q(3), r(3), n(3), square, s, t
    p = u(:, 1) + time*(u(:, 2) - u(:, 1))
    q = v(:, 1) + time*(v(:, 2) - v(:, 1))
    r = w(:, 1) + time*(w(:, 2) - w(:, 1))
    n = cross(p, q)
    square = dot(n, n)
    if (.not. square > tiny(1.0_wp)) return
    s = dot(cross(r, q), n)/square
    t = dot(cross(r, p), n)/square
    if (s < 0.0_wp .or. s > 1.0_wp .or. t < 0.0_wp .or. t > 1.0_wp) return
    found%n = found%n + 1
    if (found%n > 1) return
    found%time = time
    found%share = [s, t]
    found%normal = merge(n, -n, from_above)/sqrt(square)
  end subroutine look_at

  !> Times within (0, 1) at which the cubic stops to rise or to fall, rising.
  pure subroutine turning_points(b, n, time)
    real(wp), intent(in) :: b(0:3)
    integer, intent(out) :: n
    real(wp), intent(out) :: time(3)
    real(wp) :: d(0:2), square, half, under_root, q
    integer :: k
    n = 0
    time = 1.0_wp
    do k = 0, 2
      d(k) = b(k + 1) - b(k)
    end do
    square = (d(0) - d(1)) + (d(2) - d(1))
    half = d(1) - d(0)
    under_root = half*half - square*d(0)
    if (under_root <= 0.0_wp) return
    q = -(half + sign(sqrt(under_root), half))
    call add_quotient(q, square, n, time)
    call add_quotient(d(0), q, n, time)
    if (n == 2) then
      if (time(1) > time(2)) time(1:2) = [time(2), time(1)]
    end if
  end subroutine turning_points

  !> Append above/below where it lies within (0, 1); without a division that could overflow.
  pure subroutine add_quotient(above, below, n, time)
    real(wp), intent(in) :: above, below
    integer, intent(inout) :: n
    real(wp), intent(inout) :: time(3)
    if (.not. (abs(above) > 0.0_wp .and. abs(above) < abs(below))) return
    if ((above > 0.0_wp) .neqv. (below > 0.0_wp)) return
    n = n + 1
    time(n) = above/below
  end subroutine add_quotient

  !> The time in (low, high] from which on the cubic is on its other side.
  pure real(wp) function root(b, low, high, above)
    real(wp), intent(in) :: b(0:3), low, high
    logical, intent(in) :: above     !! it is not negative at `low`
    real(wp) :: lower, middle
    integer :: k
    lower = low
    root = high
    do k = 1, bisections
      middle = 0.5_wp*(lower + root)
      if ((value(b, middle) >= 0.0_wp) .eqv. above) then
        lower = middle
      else
        root = middle
      end if
    end do
  end function root

  !> De Casteljau; at 0 and 1 the ends' coefficients exactly.
  pure real(wp) function value(b, time)
    real(wp), intent(in) :: b(0:3), time
    real(wp) :: rest, p, q, r
    rest = 1.0_wp - time
    p = rest*b(0) + time*b(1)
    q = rest*b(1) + time*b(2)
    r = rest*b(2) + time*b(3)
    p = rest*p + time*q
    q = rest*q + time*r
    value = rest*p + time*q
  end function value

  !> Distance of the segments from a to b and from c to d (Ericson, Real-Time Collision
  !> Detection, 5.1.9).
  pure real(wp) function segment_gap(a, b, c, d) result(gap)
    real(wp), intent(in) :: a(3), b(3), c(3), d(3)
    real(wp) :: u(3), v(3), w(3), uu, vv, uv, uw, vw, det, s, t
    u = b - a
    v = d - c
    w = a - c
    uu = max(dot(u, u), tiny(1.0_wp))
    vv = max(dot(v, v), tiny(1.0_wp))
    uv = dot(u, v)
    uw = dot(u, w)
    vw = dot(v, w)
    det = uu*vv - uv*uv
    s = 0.0_wp
    if (det > epsilon(1.0_wp)*uu*vv) s = min(1.0_wp, max(0.0_wp, (uv*vw - uw*vv)/det))
    t = min(1.0_wp, max(0.0_wp, (uv*s + vw)/vv))
    s = min(1.0_wp, max(0.0_wp, (uv*t - uw)/uu))
    w = (w + s*u) - t*v
    gap = sqrt(dot(w, w))
  end function segment_gap

end module castnet_crossing
