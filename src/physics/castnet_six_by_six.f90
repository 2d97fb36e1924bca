!> Linear systems of the body's six velocities, by hand: LAPACK's call costs more
!> than the work, and may trap.
module castnet_six_by_six
  use castnet_kinds, only: wp
  implicit none
  private
  public :: factor_symmetric, solve_symmetric, solve_general, solve_pair

contains

  !> A = L D L^T of a symmetric positive definite 6 x 6 matrix, scaled to a unit
  !> diagonal first because three rows are masses and three are moments of inertia.
  !> `l` holds L below the diagonal and 1/D on it, `scale` the scaling.
  pure subroutine factor_symmetric(a, l, scale, ok)
    real(wp), intent(in) :: a(6, 6)   !! lower triangle is read
    real(wp), intent(out) :: l(6, 6), scale(6)
    logical, intent(out) :: ok        !! .false.: not positive definite
    real(wp) :: d(6), s
    integer :: i, j, k
    l = 0.0_wp
    d = 0.0_wp
    ok = .true.
    do i = 1, 6
      ok = ok .and. a(i, i) > 0.0_wp
      scale(i) = 1.0_wp/sqrt(merge(a(i, i), 1.0_wp, a(i, i) > 0.0_wp))
    end do
    if (.not. ok) return
    do j = 1, 6
      s = a(j, j)*scale(j)*scale(j)
      do k = 1, j - 1
        s = s - l(j, k)*l(j, k)*d(k)
      end do
      if (.not. s > 0.0_wp) then
        ok = .false.
        return
      end if
      d(j) = s
      l(j, j) = 1.0_wp/s
      do i = j + 1, 6
        s = a(i, j)*scale(i)*scale(j)
        do k = 1, j - 1
          s = s - l(i, k)*l(j, k)*d(k)
        end do
        l(i, j) = s*l(j, j)
      end do
    end do
  end subroutine factor_symmetric

  !> x of A x = b, from the factors.
  pure subroutine solve_symmetric(l, scale, b, x)
    real(wp), intent(in) :: l(6, 6), scale(6), b(6)
    real(wp), intent(out) :: x(6)
    integer :: i, k
    do i = 1, 6
      x(i) = b(i)*scale(i)
      do k = 1, i - 1
        x(i) = x(i) - l(i, k)*x(k)
      end do
    end do
    do i = 1, 6
      x(i) = x(i)*l(i, i)
    end do
    do i = 6, 1, -1
      do k = i + 1, 6
        x(i) = x(i) - l(k, i)*x(k)
      end do
    end do
    do i = 1, 6
      x(i) = x(i)*scale(i)
    end do
  end subroutine solve_symmetric

  !> x of A x = b for any regular 6 x 6 matrix: elimination with row exchanges.
  pure subroutine solve_general(a, b, x, ok)
    real(wp), intent(in) :: a(6, 6), b(6)
    real(wp), intent(out) :: x(6)
    logical, intent(out) :: ok        !! .false.: singular to working precision
    real(wp) :: m(6, 7), row(7), scale(6), factor
    integer :: i, j, k, pivot
    x = 0.0_wp
    ok = .true.
    do i = 1, 6
      scale(i) = max(abs(a(i, 1)), abs(a(i, 2)), abs(a(i, 3)), abs(a(i, 4)), abs(a(i, 5)), abs(a(i, 6)))
      if (.not. scale(i) > 0.0_wp) then
        ok = .false.
        return
      end if
      m(i, 1:6) = a(i, :)/scale(i)
      m(i, 7) = b(i)/scale(i)
    end do
    do k = 1, 6
      pivot = k
      do i = k + 1, 6
        if (abs(m(i, k)) > abs(m(pivot, k))) pivot = i
      end do
      if (.not. abs(m(pivot, k)) > 1.0e-14_wp) then
        ok = .false.
        return
      end if
      row = m(k, :)
      m(k, :) = m(pivot, :)
      m(pivot, :) = row
      do i = k + 1, 6
        factor = m(i, k)/m(k, k)
        do j = k + 1, 7
          m(i, j) = m(i, j) - factor*m(k, j)
        end do
      end do
    end do
    do i = 6, 1, -1
      x(i) = m(i, 7)
      do k = i + 1, 6
        x(i) = x(i) - m(i, k)*x(k)
      end do
      x(i) = x(i)/m(i, i)
    end do
  end subroutine solve_general

  !> X of A X = B with two right sides, for any regular 6 x 6 matrix of numbers alike in size.
  pure subroutine solve_pair(a, b, x, negative, ok)
    real(wp), intent(in) :: a(6, 6), b(6, 2)
    real(wp), intent(out) :: x(6, 2)
    logical, intent(out) :: negative  !! the determinant is
    logical, intent(out) :: ok        !! .false.: singular to working precision
    real(wp) :: m(6, 8), row(8), factor
    integer :: i, j, k, pivot
    x = 0.0_wp
    ok = .true.
    negative = .false.
    m(:, 1:6) = a
    m(:, 7:8) = b
    do k = 1, 6
      pivot = k
      do i = k + 1, 6
        if (abs(m(i, k)) > abs(m(pivot, k))) pivot = i
      end do
      factor = maxval(abs(a(:, k)))
      if (.not. abs(m(pivot, k)) > 1.0e-15_wp*factor) then
        ok = .false.
        return
      end if
      if (pivot /= k) then
        row = m(k, :)
        m(k, :) = m(pivot, :)
        m(pivot, :) = row
        negative = .not. negative
      end if
      if (m(k, k) < 0.0_wp) negative = .not. negative
      do i = k + 1, 6
        factor = m(i, k)/m(k, k)
        do j = k + 1, 8
          m(i, j) = m(i, j) - factor*m(k, j)
        end do
      end do
    end do
    do j = 1, 2
      do i = 6, 1, -1
        x(i, j) = m(i, 6 + j)
        do k = i + 1, 6
          x(i, j) = x(i, j) - m(i, k)*x(k, j)
        end do
        x(i, j) = x(i, j)/m(i, i)
      end do
    end do
  end subroutine solve_pair

end module castnet_six_by_six
