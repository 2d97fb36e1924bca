!> Polygons: area and perimeter of a closed loop in space, and the convex hull of points
!> in a plane.
module castnet_polygon
  use castnet_kinds, only: wp
  use castnet_exact, only: snap_to_grid, side_of_line
  implicit none
  private
  public :: loop_area, area_about_first, loop_perimeter, planar_hull

contains

  !> Area of the closed loop p1, p2, ..., pn, p1 [m2]: the norm of its vector area
  !> (1/2) sum p_i × p_i+1. For a plane loop its area; for a crooked one the area of its
  !> shadow on the plane where that is largest, so no surface spanned in it is smaller.
  pure real(wp) function loop_area(point) result(area)
    real(wp), intent(in) :: point(:, :)  !! (3,n) [m]
    real(wp), dimension(size(point, 2)) :: x, y, z
    integer :: i
    do i = 1, size(point, 2)
      x(i) = point(1, i) - point(1, 1)
      y(i) = point(2, i) - point(2, 1)
      z(i) = point(3, i) - point(3, 1)
    end do
    area = area_about_first(size(point, 2), x, y, z)
  end function loop_area

  !> The same of a loop seen from its first point, or far loops lose digits.
  pure real(wp) function area_about_first(n, x, y, z) result(area)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n), y(n), z(n)  !! the first is 0 [m]
    real(wp) :: nx(n), ny(n), nz(n), vector(3)
    integer :: i
    do i = 2, n - 1
      nx(i) = y(i)*z(i + 1) - z(i)*y(i + 1)
      ny(i) = z(i)*x(i + 1) - x(i)*z(i + 1)
      nz(i) = x(i)*y(i + 1) - y(i)*x(i + 1)
    end do
    vector = 0.0_wp
    do i = 2, n - 1
      vector(1) = vector(1) + nx(i)
      vector(2) = vector(2) + ny(i)
      vector(3) = vector(3) + nz(i)
    end do
    area = 0.5_wp*sqrt(vector(1)*vector(1) + vector(2)*vector(2) + vector(3)*vector(3))
  end function area_about_first

  !> Length of the closed loop [m].
  pure real(wp) function loop_perimeter(point) result(perimeter)
    real(wp), intent(in) :: point(:, :)  !! (3,n) [m]
    real(wp) :: d(3)
    integer :: i, n
    n = size(point, 2)
    perimeter = 0.0_wp
    do i = 1, n
      d = point(:, modulo(i, n) + 1) - point(:, i)
      perimeter = perimeter + sqrt(d(1)*d(1) + d(2)*d(2) + d(3)*d(3))
    end do
  end function loop_perimeter

  !> Corners of the convex hull of points in a plane, counter-clockwise from the leftmost
  !> (then lowest) one; points on an edge are no corners. Fewer than three when all
  !> points lie on a line. Andrew's monotone chain on the grid of castnet_exact.
  pure subroutine planar_hull(point, corner)
    real(wp), intent(in) :: point(:, :)              !! (2,n)
    integer, allocatable, intent(out) :: corner(:)   !! counted from 1
    real(wp) :: grid(2, size(point, 2))
    integer :: order(size(point, 2)), chain(2*size(point, 2) + 1)
    integer :: n, i, k, first
    n = size(point, 2)
    call snap_to_grid(point, grid)
    call sort_points(grid, order)
    k = 0
    do i = 1, n  ! lower chain, left to right
      call extend(grid, order(i), 1, chain, k)
    end do
    first = k
    do i = n - 1, 1, -1  ! upper chain, right to left
      call extend(grid, order(i), first, chain, k)
    end do
    if (k > 1) k = k - 1  ! the start stands at the end again
    if (k == 2) then
      if (all(abs(grid(:, chain(1)) - grid(:, chain(2))) < 0.5_wp)) k = 1
    end if
    corner = chain(:k)
  end subroutine planar_hull

  !> Add a point to the chain; corners that it leaves on its right or in its way are taken back.
  pure subroutine extend(grid, new, base, chain, k)
    real(wp), intent(in) :: grid(:, :)
    integer, intent(in) :: new, base  !! the chain's first `base` entries stay
    integer, intent(inout) :: chain(:), k
    do while (k > base)
      if (side_of_line(grid(:, chain(k - 1)), grid(:, chain(k)), grid(:, new)) > 0) exit
      k = k - 1
    end do
    k = k + 1
    chain(k) = new
  end subroutine extend

  !> Order of the points by x, then y, then number: heapsort.
  pure subroutine sort_points(grid, order)
    real(wp), intent(in) :: grid(:, :)
    integer, intent(out) :: order(:)
    integer :: i, last, swap
    order = [(i, i=1, size(order))]
    do i = size(order)/2, 1, -1
      call sift(grid, i, size(order), order)
    end do
    do last = size(order), 2, -1
      swap = order(1)
      order(1) = order(last)
      order(last) = swap
      call sift(grid, 1, last - 1, order)
    end do
  end subroutine sort_points

  !> Let the entry at `top` sink to its place in the heap.
  pure subroutine sift(grid, top, bottom, order)
    real(wp), intent(in) :: grid(:, :)
    integer, intent(in) :: top, bottom
    integer, intent(inout) :: order(:)
    integer :: parent, child, moved
    moved = order(top)
    parent = top
    do while (2*parent <= bottom)
      child = 2*parent
      if (child < bottom) then
        if (before(grid, order(child), order(child + 1))) child = child + 1
      end if
      if (.not. before(grid, moved, order(child))) exit
      order(parent) = order(child)
      parent = child
    end do
    order(parent) = moved
  end subroutine sift

  pure logical function before(grid, a, b)
    real(wp), intent(in) :: grid(:, :)
    integer, intent(in) :: a, b
    before = a < b
    if (grid(2, a) < grid(2, b)) before = .true.
    if (grid(2, a) > grid(2, b)) before = .false.
    if (grid(1, a) < grid(1, b)) before = .true.
    if (grid(1, a) > grid(1, b)) before = .false.
  end function before

end module castnet_polygon
