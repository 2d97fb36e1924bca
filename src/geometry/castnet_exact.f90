!> On which side of a line or plane does a point lie? Answered without round-off.
!>
!> A hull built from rounded answers can contradict itself and fall apart where points lie
!> in one plane, as a net's do. So points are first moved to a cubic grid of 2**40 steps
!> along their largest extent (1e-12 of it, far below anything that matters), where
!> differences of coordinates are exact reals and determinants fit into 128 bits.
module castnet_exact
  use castnet_kinds, only: wp
  implicit none
  private
  public :: snap_to_grid, side_of_line, side_of_plane

  integer, parameter :: i16 = selected_int_kind(38)  !! 128 bits
  integer, parameter :: grid_bits = 40

contains

  !> Grid coordinates of points in any number of dimensions: whole numbers, 0 to 2**40.
  pure subroutine snap_to_grid(point, grid)
    real(wp), intent(in) :: point(:, :)  !! (dimension,n), finite
    real(wp), intent(out) :: grid(:, :)  !! (dimension,n) [-]
    real(wp) :: lower(size(point, 1)), extent
    integer :: i, shift
    grid = 0.0_wp
    if (size(point, 2) == 0) return
    lower = minval(point, dim=2)
    extent = maxval(maxval(point, dim=2) - lower)
    if (.not. extent > tiny(1.0_wp)) return
    shift = grid_bits - exponent(extent)
    do i = 1, size(point, 2)
      grid(:, i) = anint(scale(point(:, i) - lower, shift))
    end do
  end subroutine snap_to_grid

  !> 1 when c lies to the left of the line from a to b, -1 to the right, 0 on it.
  !> |(b - a) × (c - a)| < 2**83: a real decides unless the two products nearly cancel.
  pure integer function side_of_line(a, b, c) result(side)
    real(wp), intent(in) :: a(2), b(2), c(2)  !! grid coordinates
    real(wp) :: left, right
    integer(i16) :: u(2), v(2)
    left = (b(1) - a(1))*(c(2) - a(2))
    right = (b(2) - a(2))*(c(1) - a(1))
    if (abs(left - right) > 4.0_wp*epsilon(1.0_wp)*(abs(left) + abs(right))) then
      side = merge(1, -1, left > right)
      return
    end if
    u = int(b - a, i16)
    v = int(c - a, i16)
    side = signum(u(1)*v(2) - u(2)*v(1))
  end function side_of_line

  !> 1 when d lies on the side of the plane a, b, c from which they run counter-clockwise,
  !> -1 on the other, 0 in it: the sign of ((b - a) × (c - a)).(d - a), below 2**126.
  pure integer function side_of_plane(a, b, c, d) result(side)
    real(wp), intent(in) :: a(3), b(3), c(3), d(3)  !! grid coordinates
    integer(i16) :: u(3), v(3), w(3)
    u = int(b - a, i16)
    v = int(c - a, i16)
    w = int(d - a, i16)
    side = signum((u(2)*v(3) - u(3)*v(2))*w(1) + (u(3)*v(1) - u(1)*v(3))*w(2) + (u(1)*v(2) - u(2)*v(1))*w(3))
  end function side_of_plane

  pure integer function signum(x)
    integer(i16), intent(in) :: x
    signum = 0
    if (x > 0) signum = 1
    if (x < 0) signum = -1
  end function signum

end module castnet_exact
