!> The log away from a terminal. What goes where is held by the system tests; here, that
!> nothing is said where nothing should be.
module test_log
  use castnet_kinds, only: wp
  use castnet_log, only: log_t, new_log, log_progress, log_note, end_progress
  use testing, only: test_case, expect
  implicit none
  private
  public :: run_test_log

contains

  subroutine run_test_log()
    call test_case('log: quiet is quiet', test_quiet)
  end subroutine run_test_log

  subroutine test_quiet()
    type(log_t) :: log
    call new_log(log, quiet=.true., progress=.true.)
    call expect(.not. log%progress, 'no progress when quiet')
    call log_note(log, 'THIS LINE MUST NOT BE SEEN')
    call log_progress(log, 0.5_wp, 'THIS LINE MUST NOT BE SEEN')
    call end_progress(log)
  end subroutine test_quiet

end module test_log
