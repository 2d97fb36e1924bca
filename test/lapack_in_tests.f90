!> Dense eigenvalues and solutions for references: LAPACK with trapping switched off around it.
module lapack_in_tests
  use, intrinsic :: ieee_exceptions, only: ieee_get_halting_mode, ieee_set_halting_mode, ieee_set_flag, ieee_all, ieee_usual
  use castnet_kinds, only: wp
  implicit none
  private
  public :: symmetric_eigenvalues, spectral_radius, solution

  interface
    subroutine dsyev(jobz, uplo, n, a, lda, w, work, lwork, info)
      import :: wp
      character, intent(in) :: jobz, uplo
      integer, intent(in) :: n, lda, lwork
      real(wp), intent(inout) :: a(lda, *)
      real(wp), intent(out) :: w(*), work(*)
      integer, intent(out) :: info
    end subroutine dsyev
    subroutine dgeev(jobvl, jobvr, n, a, lda, wr, wi, vl, ldvl, vr, ldvr, work, lwork, info)
      import :: wp
      character, intent(in) :: jobvl, jobvr
      integer, intent(in) :: n, lda, ldvl, ldvr, lwork
      real(wp), intent(inout) :: a(lda, *)
      real(wp), intent(out) :: wr(*), wi(*), vl(ldvl, *), vr(ldvr, *), work(*)
      integer, intent(out) :: info
    end subroutine dgeev
    subroutine dgesv(n, nrhs, a, lda, ipiv, b, ldb, info)
      import :: wp
      integer, intent(in) :: n, nrhs, lda, ldb
      real(wp), intent(inout) :: a(lda, *), b(ldb, *)
      integer, intent(out) :: ipiv(*)
      integer, intent(out) :: info
    end subroutine dgesv
  end interface

contains

  !> Eigenvalues, ascending.
  function symmetric_eigenvalues(matrix) result(values)
    real(wp), intent(in) :: matrix(:, :)
    real(wp) :: values(size(matrix, 1))
    real(wp), allocatable :: a(:, :), work(:)
    logical :: halting(size(ieee_usual))
    integer :: n, info
    n = size(matrix, 1)
    a = matrix
    allocate (work(max(1, 34*n)))
    call ieee_get_halting_mode(ieee_usual, halting)
    call ieee_set_halting_mode(ieee_usual, .false.)
    call dsyev('N', 'U', n, a, n, values, work, size(work), info)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_usual, halting)
    if (info /= 0) values = -huge(1.0_wp)
  end function symmetric_eigenvalues

  !> Largest magnitude of the eigenvalues of a general matrix.
  real(wp) function spectral_radius(matrix) result(radius)
    real(wp), intent(in) :: matrix(:, :)
    real(wp), allocatable :: a(:, :), work(:), re(:), im(:)
    real(wp) :: none(1, 1), none_either(1, 1)
    logical :: halting(size(ieee_usual))
    integer :: n, info
    n = size(matrix, 1)
    a = matrix
    allocate (work(max(1, 34*n)), re(n), im(n))
    call ieee_get_halting_mode(ieee_usual, halting)
    call ieee_set_halting_mode(ieee_usual, .false.)
    call dgeev('N', 'N', n, a, n, re, im, none, 1, none_either, 1, work, size(work), info)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_usual, halting)
    radius = maxval(sqrt(re**2 + im**2))
    if (info /= 0) radius = huge(1.0_wp)
  end function spectral_radius

  !> x of A x = b; huge where LAPACK finds A singular.
  function solution(matrix, right) result(x)
    real(wp), intent(in) :: matrix(:, :), right(:)
    real(wp) :: x(size(right))
    real(wp) :: a(size(right), size(right)), b(size(right), 1)
    logical :: halting(size(ieee_usual))
    integer :: pivot(size(right)), n, info
    n = size(right)
    a = matrix
    b(:, 1) = right
    call ieee_get_halting_mode(ieee_usual, halting)
    call ieee_set_halting_mode(ieee_usual, .false.)
    call dgesv(n, 1, a, n, pivot, b, n, info)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_usual, halting)
    x = b(:, 1)
    if (info /= 0) x = huge(1.0_wp)
  end function solution

end module lapack_in_tests
