!> A small harness: named cases, checks that do not stop the case, NaN fails, and the
!> counts on the last line. One command-line argument filters the cases by substring.
module testing
  use, intrinsic :: iso_fortran_env, only: output_unit
  use castnet_kinds, only: wp
  implicit none
  private
  public :: test_case, expect, expect_close, expect_equal, note, finish, selected

  interface expect_close
    module procedure expect_close_scalar, expect_close_vector
  end interface expect_close

  interface expect_equal
    module procedure expect_equal_integer, expect_equal_text
  end interface expect_equal

  integer :: n_passed = 0, n_failed = 0
  logical :: case_failed = .false.

contains

  !> Does the filter of the command line let this name through?
  logical function selected(name)
    character(len=*), intent(in) :: name
    character(len=256) :: filter
    selected = .true.
    if (command_argument_count() == 0) return
    call get_command_argument(1, filter)
    selected = index(name, trim(filter)) > 0
  end function selected

  !> Run one case. `name` reads 'module: what is claimed'.
  subroutine test_case(name, procedure)
    character(len=*), intent(in) :: name
    interface
      subroutine procedure()
      end subroutine procedure
    end interface
    character(len=16) :: duration
    real(wp) :: start, stop
    if (.not. selected(name)) return
    case_failed = .false.
    call cpu_time(start)
    call procedure()
    call cpu_time(stop)
    ! Where the suite's time goes; never a claim.
    duration = ''
    if (stop - start >= 1.0_wp) write (duration, '(a,f0.1,a)') '  (', stop - start, ' s)'
    if (case_failed) then
      n_failed = n_failed + 1
      write (output_unit, '(3a)') 'FAIL  ', name, trim(duration)
    else
      n_passed = n_passed + 1
      write (output_unit, '(3a)') 'ok    ', name, trim(duration)
    end if
    flush (output_unit)
  end subroutine test_case

  !> Claim a condition.
  subroutine expect(condition, words)
    logical, intent(in) :: condition
    character(len=*), intent(in) :: words
    if (condition) return
    case_failed = .true.
    write (output_unit, '(2a)') '      expected: ', words
  end subroutine expect

  !> Claim |actual - expected| <= atol + rtol |expected|; NaN fails.
  subroutine expect_close_scalar(actual, expected, words, rtol, atol)
    real(wp), intent(in) :: actual, expected
    character(len=*), intent(in) :: words
    real(wp), intent(in), optional :: rtol, atol
    real(wp) :: tolerance
    tolerance = 0.0_wp
    if (present(atol)) tolerance = tolerance + atol
    if (present(rtol)) tolerance = tolerance + rtol*abs(expected)
    if (abs(actual - expected) <= tolerance) return
    case_failed = .true.
    write (output_unit, '(3a,es23.15,a,es23.15,a,es10.2,a,es10.2)') '      ', words, ': seen', actual, &
      ', expected', expected, ', off by', actual - expected, ', tolerance', tolerance
  end subroutine expect_close_scalar

  !> The same for each element, the tolerance by the largest expected magnitude.
  subroutine expect_close_vector(actual, expected, words, rtol, atol)
    real(wp), intent(in) :: actual(:), expected(:)
    character(len=*), intent(in) :: words
    real(wp), intent(in), optional :: rtol, atol
    real(wp) :: tolerance
    integer :: i
    if (size(actual) /= size(expected)) then
      case_failed = .true.
      write (output_unit, '(3a,i0,a,i0)') '      ', words, ': size ', size(actual), ', expected ', size(expected)
      return
    end if
    tolerance = 0.0_wp
    if (present(atol)) tolerance = tolerance + atol
    if (present(rtol) .and. size(expected) > 0) tolerance = tolerance + rtol*maxval(abs(expected))
    do i = 1, size(actual)
      if (abs(actual(i) - expected(i)) <= tolerance) cycle
      case_failed = .true.
      write (output_unit, '(3a,i0,a,es23.15,a,es23.15,a,es10.2)') '      ', words, '(', i, '): seen', actual(i), &
        ', expected', expected(i), ', tolerance', tolerance
      return
    end do
  end subroutine expect_close_vector

  subroutine expect_equal_integer(actual, expected, words)
    integer, intent(in) :: actual, expected
    character(len=*), intent(in) :: words
    if (actual == expected) return
    case_failed = .true.
    write (output_unit, '(3a,i0,a,i0)') '      ', words, ': seen ', actual, ', expected ', expected
  end subroutine expect_equal_integer

  subroutine expect_equal_text(actual, expected, words)
    character(len=*), intent(in) :: actual, expected, words
    if (actual == expected .and. len(actual) == len(expected)) return
    case_failed = .true.
    write (output_unit, '(6a)') '      ', words, ': seen "', actual, '", expected "', expected//'"'
  end subroutine expect_equal_text

  !> A measured figure, for the log.
  subroutine note(words)
    character(len=*), intent(in) :: words
    write (output_unit, '(2a)') '      ', words
  end subroutine note

  !> Print the counts; a run without a case is a failure.
  subroutine finish()
    if (n_passed + n_failed == 0) then
      write (output_unit, '(a)') 'no test case matches'
      n_failed = 1
    end if
    write (output_unit, '(i0,a,i0,a)') n_passed, ' passed, ', n_failed, ' failed'
    flush (output_unit)
    if (n_failed > 0) error stop 1
  end subroutine finish

end module testing
