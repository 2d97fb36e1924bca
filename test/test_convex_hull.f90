!> Hulls and polygons against closed forms, and against the definition of a hull.
module test_convex_hull
  use castnet_kinds, only: wp, i8
  use castnet_constants, only: pi
  use castnet_convex_hull, only: hull_t, convex_hull
  use castnet_polygon, only: loop_area, loop_perimeter, planar_hull
  use castnet_rng, only: rng_t, seed_rng, uniform, normal
  use castnet_rotation, only: rotate, normalise_quaternion
  use testing, only: test_case, expect, expect_close, expect_equal
  implicit none
  private
  public :: run_test_convex_hull

contains

  subroutine run_test_convex_hull()
    call test_case('convex_hull: tetrahedron, box and octahedron have their volume, area and centre', solids)
    call test_case('convex_hull: a lattice full of coplanar points is a box', lattice)
    call test_case('convex_hull: a prism with two round faces', prism)
    call test_case('convex_hull: of random points is closed, convex and holds them all', definition)
    call test_case('convex_hull: flat, straight and single sets have no volume and do not crash', degenerate)
    call test_case('convex_hull: a tilted sheet, exact to the grid', tilted_sheet)
    call test_case('convex_hull: the same points give the same bits, turned ones the same numbers', repeats)
    call test_case('convex_hull: area and perimeter of loops', loops)
    call test_case('convex_hull: corners in the plane', plane_corners)
  end subroutine run_test_convex_hull

  !> The eight corners of a box with edges e, lower corner at o.
  pure function box(o, e) result(point)
    real(wp), intent(in) :: o(3), e(3)
    real(wp) :: point(3, 8)
    integer :: i
    do i = 0, 7
      point(:, i + 1) = o + e*[real(ibits(i, 0, 1), wp), real(ibits(i, 1, 1), wp), real(ibits(i, 2, 1), wp)]
    end do
  end function box

  subroutine solids()
    type(hull_t) :: hull
    real(wp) :: point(3, 8), octahedron(3, 7)
    call convex_hull(reshape([0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, &
                              0.0_wp, 0.0_wp, 1.0_wp], [3, 4]), hull)
    call expect_equal(hull%dimension, 3, 'a solid')
    call expect_equal(size(hull%triangle, 2), 4, 'four faces')
    call expect_close(hull%volume, 1.0_wp/6.0_wp, 'tetrahedron', rtol=1.0e-15_wp)
    call expect_close(hull%area, 1.5_wp + sqrt(3.0_wp)/2.0_wp, 'its area', rtol=1.0e-15_wp)
    call expect_close(hull%centre, [0.25_wp, 0.25_wp, 0.25_wp], 'its centre', rtol=1.0e-15_wp)
    point = box([-3.0_wp, 10.0_wp, 0.5_wp], [0.1_wp, 0.2_wp, 0.3405_wp])
    call convex_hull(point, hull)
    call expect_equal(size(hull%triangle, 2), 12, 'two triangles a face')
    call expect_close(hull%volume, 0.1_wp*0.2_wp*0.3405_wp, 'box', rtol=1.0e-13_wp)
    call expect_close(hull%area, 2.0_wp*(0.1_wp*0.2_wp + 0.1_wp*0.3405_wp + 0.2_wp*0.3405_wp), 'its area', rtol=1.0e-13_wp)
    call expect_close(hull%centre, [-2.95_wp, 10.1_wp, 0.67025_wp], 'its centre', rtol=1.0e-14_wp)
    octahedron = 0.0_wp  ! with a point in the middle
    octahedron(1, 1) = 2.0_wp; octahedron(1, 2) = -2.0_wp
    octahedron(2, 3) = 2.0_wp; octahedron(2, 4) = -2.0_wp
    octahedron(3, 5) = 2.0_wp; octahedron(3, 6) = -2.0_wp
    call convex_hull(octahedron, hull)
    call expect_equal(size(hull%triangle, 2), 8, 'eight faces')
    call expect_close(hull%volume, 32.0_wp/3.0_wp, 'octahedron 4/3 a**3', rtol=1.0e-14_wp)
    call expect_close(hull%area, 16.0_wp*sqrt(3.0_wp), 'its area 4 sqrt 3 a**2', rtol=1.0e-14_wp)
    call expect_close(hull%centre, [0.0_wp, 0.0_wp, 0.0_wp], 'its centre', atol=1.0e-14_wp)
  end subroutine solids

  !> 12 x 9 x 7 points, every one also stored twice: hundreds in each plane, lines full of them.
  subroutine lattice()
    integer, parameter :: n = 12*9*7
    type(hull_t) :: hull
    real(wp) :: point(3, 2*n)
    integer :: i
    do i = 0, n - 1
      point(:, i + 1) = [0.1_wp*modulo(i, 12), 0.07_wp*modulo(i/12, 9), 0.3_wp*(i/108)]
    end do
    point(:, n + 1:) = point(:, :n)
    call convex_hull(point, hull)
    call expect_close(hull%volume, 1.1_wp*0.56_wp*1.8_wp, 'volume', rtol=1.0e-12_wp)
    call expect_close(hull%area, 2.0_wp*(1.1_wp*0.56_wp + 1.1_wp*1.8_wp + 0.56_wp*1.8_wp), 'area', rtol=1.0e-12_wp)
    call expect_close(hull%centre, [0.55_wp, 0.28_wp, 0.9_wp], 'centre', rtol=1.0e-12_wp)
  end subroutine lattice

  !> A right prism over a regular n-gon of radius r and height h.
  subroutine prism()
    integer, parameter :: n = 48
    real(wp), parameter :: r = 1.95_wp, h = 11.047_wp
    type(hull_t) :: hull
    real(wp) :: point(3, 2*n), angle
    integer :: i
    do i = 1, n
      angle = 2.0_wp*pi*i/n
      point(:, i) = [r*cos(angle), r*sin(angle), -h/2.0_wp]
      point(:, n + i) = [r*cos(angle), r*sin(angle), h/2.0_wp]
    end do
    call convex_hull(point, hull)
    call expect_close(hull%volume, 0.5_wp*n*r*r*sin(2.0_wp*pi/n)*h, 'volume', rtol=1.0e-11_wp)
    call expect_close(hull%area, n*r*r*sin(2.0_wp*pi/n) + 2.0_wp*n*r*sin(pi/n)*h, 'area', rtol=1.0e-11_wp)
    call expect_close(hull%centre, [0.0_wp, 0.0_wp, 0.0_wp], 'centre', atol=1.0e-10_wp)
  end subroutine prism

  !> What makes a hull: every edge has two faces, seen in opposite directions (Euler: m = 2 v - 4),
  !> and no point lies above a face, to the grid's 1e-12.
  subroutine definition()
    integer, parameter :: n = 400
    type(hull_t) :: hull
    type(rng_t) :: rng
    real(wp) :: point(3, n), base(3), face(3)
    integer, allocatable :: edge(:, :)
    logical :: corner(n)
    integer :: i, t, k, round, a, b
    call seed_rng(rng, 31_i8)
    allocate (edge(n, n))
    do round = 1, 4
      do i = 1, n
        do k = 1, 3
          call normal(rng, point(k, i))
        end do
        if (round == 2) point(:, i) = point(:, i)/sqrt(sum(point(:, i)**2))  ! all on a sphere
        if (round == 3) point(:, i) = anint(3.0_wp*point(:, i))              ! few places, many planes
        if (round == 4) point(3, i) = 1.0e-11_wp*point(3, i)                 ! all but flat
      end do
      call convex_hull(point, hull)
      edge = 0
      corner = .false.
      do t = 1, size(hull%triangle, 2)
        corner(hull%triangle(:, t)) = .true.
        do k = 1, 3
          a = hull%triangle(k, t)
          b = hull%triangle(modulo(k, 3) + 1, t)
          edge(a, b) = edge(a, b) + 1
        end do
        base = point(:, hull%triangle(1, t))
        face = times(point(:, hull%triangle(2, t)) - base, point(:, hull%triangle(3, t)) - base)
        face = face/max(sqrt(sum(face**2)), 1.0e-30_wp)
        if (round == 4) cycle  ! slivers thinner than the grid have no direction
        do i = 1, n
          if (sum(face*(point(:, i) - base)) > 1.0e-10_wp) call expect(.false., 'no point above a face')
        end do
      end do
      call expect(all(edge == transpose(edge)) .and. maxval(edge) == 1, 'each edge once each way')
      call expect_equal(size(hull%triangle, 2), 2*count(corner) - 4, 'Euler')
      if (round == 2) call expect_equal(count(corner), n, 'every point of a sphere is a corner')
      call expect(hull%volume > 0.0_wp, 'a volume')
    end do
  end subroutine definition

  pure function times(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function times

  subroutine degenerate()
    type(hull_t) :: hull
    real(wp) :: flat(3, 30), none(3, 0)
    integer :: i
    do i = 0, 29
      flat(:, i + 1) = [2.5_wp, 0.2_wp*modulo(i, 6), 0.3_wp*(i/6)]
    end do
    call convex_hull(flat, hull)
    call expect_equal(hull%dimension, 2, 'flat')
    call expect_close(hull%volume, 0.0_wp, 'no volume', atol=0.0_wp)
    call expect_close(hull%area, 2.0_wp*1.0_wp*1.2_wp, 'two sides', rtol=1.0e-14_wp)
    call expect_close(hull%centre, [2.5_wp, 0.5_wp, 0.6_wp], 'centre', rtol=1.0e-14_wp)
    flat(3, :) = 0.0_wp
    call convex_hull(flat, hull)
    call expect_equal(hull%dimension, 1, 'straight')
    call expect_close(hull%area, 0.0_wp, 'no area', atol=0.0_wp)
    call expect_close(hull%centre, [2.5_wp, 0.5_wp, 0.0_wp], 'middle', rtol=1.0e-14_wp)
    flat(2, :) = -7.0_wp
    call convex_hull(flat, hull)
    call expect_equal(hull%dimension, 0, 'one place')
    call expect_close(hull%centre, [2.5_wp, -7.0_wp, 0.0_wp], 'that place', atol=0.0_wp)
    call convex_hull(none, hull)
    call expect_equal(hull%dimension, -1, 'nothing')
    call expect_close(hull%volume, 0.0_wp, 'of nothing', atol=0.0_wp)
    call convex_hull(flat(:, :1), hull)
    call expect_equal(hull%dimension, 0, 'one point')
  end subroutine degenerate

  !> Turning a flat lattice leaves it flat to round-off only: volume below 1e-11 of the
  !> cube around it, area and centre as before.
  subroutine tilted_sheet()
    type(hull_t) :: hull
    real(wp) :: sheet(3, 121), q(4)
    integer :: i
    q = normalise_quaternion([0.3_wp, 0.5_wp, -0.2_wp, 0.7_wp])
    do i = 0, 120
      sheet(:, i + 1) = rotate(q, [0.1_wp*modulo(i, 11), 0.1_wp*(i/11), 0.0_wp]) + [3.0_wp, -1.0_wp, 2.0_wp]
    end do
    call convex_hull(sheet, hull)
    call expect_close(hull%volume, 0.0_wp, 'no volume', atol=1.0e-11_wp)
    call expect_close(hull%area, 2.0_wp, 'two sides', rtol=1.0e-10_wp)
    call expect_close(hull%centre, rotate(q, [0.5_wp, 0.5_wp, 0.0_wp]) + [3.0_wp, -1.0_wp, 2.0_wp], 'centre', rtol=1.0e-6_wp)
  end subroutine tilted_sheet

  subroutine repeats()
    integer, parameter :: n = 441
    type(hull_t) :: first, second, turned
    type(rng_t) :: rng
    real(wp) :: point(3, n), other(3, n), q(4)
    integer :: i, k
    call seed_rng(rng, 5_i8)
    q = normalise_quaternion([0.9_wp, -0.1_wp, 0.4_wp, 0.2_wp])
    do i = 1, n
      do k = 1, 3
        call uniform(rng, point(k, i))
      end do
      other(:, i) = rotate(q, point(:, i)) + [100.0_wp, 0.0_wp, -30.0_wp]
    end do
    call convex_hull(point, first)
    call convex_hull(point, second)
    call convex_hull(other, turned)
    call expect(all(transfer([first%volume, first%area, first%centre], [0_i8]) == &
                    transfer([second%volume, second%area, second%centre], [0_i8])), 'the same bits')
    call expect_close(turned%volume, first%volume, 'turned volume', rtol=1.0e-11_wp)
    call expect_close(turned%area, first%area, 'turned area', rtol=1.0e-11_wp)
    call expect_close(turned%centre, rotate(q, first%centre) + [100.0_wp, 0.0_wp, -30.0_wp], 'turned centre', rtol=1.0e-12_wp)
  end subroutine repeats

  !> A square; the same folded by 90 degrees about its middle line, whose vector area is
  !> that of two half squares at right angles; a loop far from the origin.
  subroutine loops()
    real(wp) :: square(3, 8), folded(3, 6)
    integer :: i
    do i = 0, 7
      square(:, i + 1) = [5.0_wp, 1.0_wp, 1.0_wp]
    end do
    square(2, 2:5) = [1.5_wp, 2.0_wp, 2.0_wp, 2.0_wp]
    square(3, 4:7) = [1.5_wp, 2.0_wp, 2.0_wp, 2.0_wp]
    square(2, 6) = 1.5_wp
    square(3, 8) = 1.5_wp
    call expect_close(loop_area(square), 1.0_wp, 'unit square', rtol=1.0e-14_wp)
    call expect_close(loop_perimeter(square), 4.0_wp, 'its edge', rtol=1.0e-14_wp)
    call expect_close(loop_area(square + 1.0e6_wp), 1.0_wp, 'far away', rtol=1.0e-9_wp)
    folded = reshape([0.0_wp, 0.0_wp, 0.5_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.5_wp, 0.0_wp, 0.0_wp, &
                      0.5_wp, 1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.5_wp], [3, 6])
    call expect_close(loop_area(folded), 0.5_wp*sqrt(2.0_wp), 'folded square', rtol=1.0e-14_wp)
    call expect_close(loop_area(square(:, :2)), 0.0_wp, 'two points', atol=0.0_wp)
    call expect_close(loop_perimeter(square(:, :0)), 0.0_wp, 'no point', atol=0.0_wp)
  end subroutine loops

  subroutine plane_corners()
    integer, allocatable :: corner(:)
    real(wp) :: point(2, 9)
    integer :: i
    do i = 0, 8
      point(:, i + 1) = [0.1_wp*modulo(i, 3), 0.1_wp*(i/3)]
    end do
    call planar_hull(point, corner)
    call expect_equal(size(corner), 4, 'four corners of nine points')
    if (size(corner) == 4) call expect(all(corner == [1, 3, 9, 7]), 'counter-clockwise from the lower left')
    call planar_hull(point(:, 4:6), corner)
    call expect_equal(size(corner), 2, 'ends of a line')
    call planar_hull(point(:, [2, 2, 2]), corner)
    call expect_equal(size(corner), 1, 'one place')
    call planar_hull(point(:, :0), corner)
    call expect_equal(size(corner), 0, 'nothing')
  end subroutine plane_corners

end module test_convex_hull
