!> Vectors of three, written out so that every build sums in the same order.
!> Hot loops write these products in place: a call from another module is not inlined.
module castnet_vector
  use castnet_kinds, only: wp
  implicit none
  private
  public :: cross, dot, norm, unit

contains

  !> a x b.
  pure function cross(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c(1) = a(2)*b(3) - a(3)*b(2)
    c(2) = a(3)*b(1) - a(1)*b(3)
    c(3) = a(1)*b(2) - a(2)*b(1)
  end function cross

  !> a . b, summed from the first component to the last.
  pure real(wp) function dot(a, b)
    real(wp), intent(in) :: a(3), b(3)
    dot = a(1)*b(1) + a(2)*b(2) + a(3)*b(3)
  end function dot

  !> Length of v. No guard against overflow, which costs three times as much.
  pure real(wp) function norm(v)
    real(wp), intent(in) :: v(3)
    norm = sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3))
  end function norm

  !> v/|v|; a vector without a direction gives the x axis.
  pure function unit(v) result(u)
    real(wp), intent(in) :: v(3)
    real(wp) :: u(3), w(3), scale
    u = [1.0_wp, 0.0_wp, 0.0_wp]
    scale = max(abs(v(1)), abs(v(2)), abs(v(3)))
    if (.not. scale > 0.0_wp) return
    ! Not u itself: gfortran 12 may have the result in a strided section of the caller's,
    ! and then hands a procedure that gets u the wrong numbers.
    w = v
    ! Squares of very small or large components would leave the range of reals.
    if (scale < 1.0e-140_wp .or. scale > 1.0e140_wp) w = v/scale
    u = w/norm(w)
  end function unit

end module castnet_vector
