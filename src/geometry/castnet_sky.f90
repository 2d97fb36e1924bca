!> What a surface covers of the sky around the origin: which of many directions meet it,
!> and how wide the largest gap is.
!>
!> A triangle A, B, C covers the direction d when d = a A + b B + c C with no negative
!> factor, that is when d.(B × C), d.(C × A) and d.(A × B) have the sign of A.(B × C). Two
!> triangles with a common edge ask the same question of it, with the same bits: no ray
!> slips through a seam.
module castnet_sky
  use castnet_kinds, only: wp
  implicit none
  private
  public :: fibonacci_directions, covered_directions, largest_gap

contains

  !> n directions spread evenly over the sphere: z falls in equal steps, each turned by the
  !> golden angle (Swinbank & Purser 2006, doi 10.1256/qj.05.227). The turn is a recurrence:
  !> cosines of a library would differ between builds.
  pure subroutine fibonacci_directions(direction)
    real(wp), intent(out) :: direction(:, :)  !! (n,3) unit vectors, z from +1 to -1
    real(wp), parameter :: cosine = -0.737368878078319901518240381367410673_wp
    real(wp), parameter :: sine = 0.675490294261523642344386198119627881_wp
    real(wp) :: c, s, z, radius, swap
    integer :: k, n
    n = size(direction, 1)
    c = 1.0_wp
    s = 0.0_wp
    do k = 1, n
      z = 1.0_wp - real(2*k - 1, wp)/real(n, wp)
      radius = sqrt(1.0_wp - z*z)
      direction(k, 1) = radius*c
      direction(k, 2) = radius*s
      direction(k, 3) = z
      swap = c*cosine - s*sine
      s = c*sine + s*cosine
      c = swap
    end do
  end subroutine fibonacci_directions

  !> Which directions of `fibonacci_directions` meet a triangle. Only the directions in a
  !> triangle's range of z are asked; the range errs on the safe side, so it decides nothing.
  pure subroutine covered_directions(direction, corner, covered)
    real(wp), contiguous, intent(in) :: direction(:, :)   !! (n,3) of `fibonacci_directions`
    real(wp), intent(in) :: corner(:, :, :)   !! (3,3,m) corners of each triangle as seen from the origin [m]
    logical, intent(out) :: covered(:)        !! (n)
    real(wp) :: inside(size(direction, 1)), p(3), q(3), r(3), volume
    integer :: k, t, first, last
    inside = -1.0_wp
    do t = 1, size(corner, 3)
      p = cross(corner(:, 2, t), corner(:, 3, t))
      q = cross(corner(:, 3, t), corner(:, 1, t))
      r = cross(corner(:, 1, t), corner(:, 2, t))
      volume = corner(1, 1, t)*p(1) + corner(2, 1, t)*p(2) + corner(3, 1, t)*p(3)
      if (.not. abs(volume) > 0.0_wp) cycle  ! seen edge-on: covers nothing
      if (volume < 0.0_wp) then
        p = -p
        q = -q
        r = -r
      end if
      call range_of_z(corner(:, :, t), size(direction, 1), first, last)
      do k = first, last
        inside(k) = max(inside(k), min(direction(k, 1)*p(1) + direction(k, 2)*p(2) + direction(k, 3)*p(3), &
                                       direction(k, 1)*q(1) + direction(k, 2)*q(2) + direction(k, 3)*q(3), &
                                       direction(k, 1)*r(1) + direction(k, 2)*r(2) + direction(k, 3)*r(3)))
      end do
    end do
    covered = inside >= 0.0_wp
  end subroutine covered_directions

  !> Numbers of the directions that can meet a triangle: those in the z range of a cap about
  !> its mean direction that holds its corners. A cap below a half sphere holds the sides too.
  pure subroutine range_of_z(corner, n, first, last)
    real(wp), intent(in) :: corner(3, 3)
    integer, intent(in) :: n
    integer, intent(out) :: first, last
    real(wp) :: u(3, 3), axis(3), length, reach, spread, radius, low, high
    integer :: k
    first = 1
    last = n
    axis = 0.0_wp
    do k = 1, 3
      length = sqrt(corner(1, k)*corner(1, k) + corner(2, k)*corner(2, k) + corner(3, k)*corner(3, k))
      if (.not. length > 0.0_wp) return
      u(:, k) = corner(:, k)/length
      axis = axis + u(:, k)
    end do
    length = sqrt(axis(1)*axis(1) + axis(2)*axis(2) + axis(3)*axis(3))
    if (length < 0.1_wp) return
    axis = axis/length
    reach = 1.0_wp
    do k = 1, 3
      reach = min(reach, axis(1)*u(1, k) + axis(2)*u(2, k) + axis(3)*u(3, k))
    end do
    reach = reach - 1.0e-9_wp
    if (reach <= 0.0_wp) return
    spread = sqrt(max(0.0_wp, 1.0_wp - reach*reach))
    radius = sqrt(max(0.0_wp, 1.0_wp - axis(3)*axis(3)))
    high = axis(3)*reach + radius*spread
    low = axis(3)*reach - radius*spread
    if (axis(3) >= reach) high = 1.0_wp
    if (-axis(3) >= reach) low = -1.0_wp
    first = max(1, floor(0.5_wp*real(n, wp)*(1.0_wp - high)))
    last = min(n, ceiling(0.5_wp*real(n, wp)*(1.0_wp - low)) + 1)
  end subroutine range_of_z

  !> Half-angle of the largest cone that holds none of the surface [rad]. The cone's axis is
  !> the uncovered direction farthest from the surface, moved uphill in
  !> steps down to 0.06 degree; the distance of an axis is exact, to the nearest side of a triangle. Gaps
  !> that no direction hits are not seen. 0 when all directions are covered, pi when none is.
  pure subroutine largest_gap(direction, covered, corner, half_angle)
    real(wp), intent(in) :: direction(:, :)   !! (n,3)
    logical, intent(in) :: covered(:)         !! (n) by `covered_directions`
    real(wp), intent(in) :: corner(:, :, :)   !! (3,3,m)
    real(wp), intent(out) :: half_angle
    real(wp), parameter :: pi = 3.14159265358979323846_wp
    real(wp), allocatable :: side(:, :), bound(:)
    real(wp) :: axis(3), trial(3), cosine, best
    integer :: first, i, k
    half_angle = 0.0_wp
    if (all(covered)) return
    half_angle = pi
    if (.not. any(covered)) return
    call collect_sides(corner, side)
    call nearest_covered(direction, covered, bound)
    ! A covered direction is a point of the surface, so `bound` is the least cosine that the
    ! exact distance can have. From the most promising direction on, few need more than this.
    best = 1.0_wp
    first = minloc(bound, dim=1)
    do i = 0, size(covered)
      k = merge(first, i, i == 0)
      if (bound(k) >= best) cycle
      trial = direction(k, :)
      cosine = nearest_side(side, trial)
      if (cosine >= best) cycle
      best = cosine
      axis = trial
    end do
    if (best < 1.0_wp) call climb(side, axis, best)
    half_angle = acos(max(-1.0_wp, min(1.0_wp, best)))
  end subroutine largest_gap

  !> Cosine of the angle from each uncovered direction to the nearest covered one; 2 for
  !> covered ones.
  pure subroutine nearest_covered(direction, covered, bound)
    real(wp), intent(in) :: direction(:, :)
    logical, intent(in) :: covered(:)
    real(wp), allocatable, intent(out) :: bound(:)
    real(wp), allocatable :: x(:), y(:), z(:)
    real(wp) :: largest
    integer :: i, k, n
    x = pack(direction(:, 1), covered)
    y = pack(direction(:, 2), covered)
    z = pack(direction(:, 3), covered)
    n = size(x)
    allocate (bound(size(covered)))
    bound = 2.0_wp
    do k = 1, size(covered)
      if (covered(k)) cycle
      largest = -1.0_wp
      do i = 1, n
        largest = max(largest, direction(k, 1)*x(i) + direction(k, 2)*y(i) + direction(k, 3)*z(i))
      end do
      bound(k) = largest
    end do
  end subroutine nearest_covered

  !> Sides of the triangles as arcs: ends P and Q, pole n = P × Q/|P × Q|, and the normals
  !> n × P and Q × n of the wedge over the arc.
  pure subroutine collect_sides(corner, side)
    real(wp), intent(in) :: corner(:, :, :)
    real(wp), allocatable, intent(out) :: side(:, :)  !! (arcs,15)
    real(wp) :: p(3), q(3), pole(3), length
    integer :: t, k, n
    allocate (side(3*size(corner, 3), 15))
    n = 0
    do t = 1, size(corner, 3)
      do k = 1, 3
        p = corner(:, k, t)
        q = corner(:, modulo(k, 3) + 1, t)
        length = sqrt(p(1)*p(1) + p(2)*p(2) + p(3)*p(3))
        if (.not. length > 0.0_wp) cycle
        p = p/length
        length = sqrt(q(1)*q(1) + q(2)*q(2) + q(3)*q(3))
        if (.not. length > 0.0_wp) cycle
        q = q/length
        pole = cross(p, q)
        length = sqrt(pole(1)*pole(1) + pole(2)*pole(2) + pole(3)*pole(3))
        n = n + 1
        side(n, 1:3) = p
        side(n, 4:6) = q
        side(n, 7:15) = 0.0_wp
        if (length < 1.0e-14_wp) cycle  ! an arc without length has no wedge: its ends count
        pole = pole/length
        side(n, 7:9) = pole
        side(n, 10:12) = cross(pole, p)
        side(n, 13:15) = cross(q, pole)
      end do
    end do
    if (n < size(side, 1)) side = side(:n, :)
  end subroutine collect_sides

  !> Cosine of the angle between a direction and the nearest arc: over the arc's wedge its
  !> distance from the great circle, else the nearer end.
  pure real(wp) function nearest_side(side, d) result(cosine)
    real(wp), contiguous, intent(in) :: side(:, :)
    real(wp), intent(in) :: d(3)
    real(wp) :: ends, height, over, least
    integer :: i
    ends = -1.0_wp
    least = 1.0_wp
    do i = 1, size(side, 1)
      ends = max(ends, d(1)*side(i, 1) + d(2)*side(i, 2) + d(3)*side(i, 3), &
                 d(1)*side(i, 4) + d(2)*side(i, 5) + d(3)*side(i, 6))
      height = d(1)*side(i, 7) + d(2)*side(i, 8) + d(3)*side(i, 9)
      over = min(d(1)*side(i, 10) + d(2)*side(i, 11) + d(3)*side(i, 12), &
                 d(1)*side(i, 13) + d(2)*side(i, 14) + d(3)*side(i, 15))
      least = min(least, merge(height*height, 1.0_wp, over > 0.0_wp))
    end do
    cosine = max(ends, sqrt(max(0.0_wp, 1.0_wp - least)))
    if (.not. least < 1.0_wp) cosine = ends
  end function nearest_side

  !> Move the axis of an empty cone to where the cone is wider: steps along eight tangents,
  !> halved when none helps. A step never leaves the cone, so it stays in the same gap.
  pure subroutine climb(side, axis, cosine)
    real(wp), contiguous, intent(in) :: side(:, :)
    real(wp), intent(inout) :: axis(3), cosine
    real(wp), parameter :: half = 0.707106781186547524_wp
    real(wp) :: step, limit, u(3), v(3), trial(3), found, length
    integer :: k
    step = 0.06_wp  ! about half the distance between neighbours of 1500 directions [rad]
    do while (step > 1.0e-3_wp)
      limit = min(step, 0.9_wp*sqrt(max(0.0_wp, 1.0_wp - cosine*cosine)))
      if (cosine < 0.0_wp) limit = step
      u = 0.0_wp
      u(minloc(abs(axis), dim=1)) = 1.0_wp
      u = cross(axis, u)
      u = u/sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3))
      v = cross(axis, u)
      do k = 0, 7
        select case (k/2)
        case (0)
          trial = u
        case (1)
          trial = v
        case (2)
          trial = half*(u + v)
        case default
          trial = half*(u - v)
        end select
        trial = axis + merge(limit, -limit, modulo(k, 2) == 0)*trial
        length = sqrt(trial(1)*trial(1) + trial(2)*trial(2) + trial(3)*trial(3))
        trial = trial/length
        found = nearest_side(side, trial)
        if (found < cosine) exit
      end do
      if (k > 7) then
        step = 0.5_wp*step
      else
        axis = trial
        cosine = found
      end if
    end do
  end subroutine climb

  pure function cross(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c(1) = a(2)*b(3) - a(3)*b(2)
    c(2) = a(3)*b(1) - a(1)*b(3)
    c(3) = a(1)*b(2) - a(2)*b(1)
  end function cross

end module castnet_sky
