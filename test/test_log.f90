!> The log away from a terminal: what goes where is held by the system tests; here the
!> ledger, and that nothing is said where nothing should be.
module test_log
  use castnet_kinds, only: wp
  use castnet_record, only: history_row_t
  use castnet_log, only: log_t, new_log, log_progress, log_note, end_progress
  use castnet_ledger_report, only: ledger_report_t, add_row, report_lines
  use testing, only: test_case, expect, expect_equal
  implicit none
  private
  public :: run_test_log

contains

  subroutine run_test_log()
    call test_case('log: quiet is quiet', test_quiet)
    call test_case('log: the ledger tells drift, smallest impulse and deepest penetration', test_ledger)
  end subroutine run_test_log

  subroutine test_quiet()
    type(log_t) :: log
    call new_log(log, quiet=.true., progress=.true.)
    call expect(.not. log%progress, 'no progress when quiet')
    call log_note(log, 'THIS LINE MUST NOT BE SEEN')
    call log_progress(log, 0.5_wp, 'THIS LINE MUST NOT BE SEEN')
    call end_progress(log)
  end subroutine test_quiet

  !> Momentum (3,4,0) grows by 5e-10 of its length; energy 10 J falls to 9 J of which
  !> 0.75 J are accounted for, 1 J came from the winch.
  subroutine test_ledger()
    type(ledger_report_t) :: ledger
    type(history_row_t) :: row
    character(len=:), allocatable :: text
    call expect_equal(report_lines(ledger), '', 'no row, no report')
    row%kinetic_net = 10.0_wp
    row%linear_momentum = [3.0_wp, 4.0_wp, 0.0_wp]
    row%angular_momentum = [0.0_wp, 0.0_wp, 2.0_wp]
    call add_row(ledger, row)
    row%time = 1.0_wp
    row%kinetic_net = 4.0_wp
    row%elastic = 5.0_wp
    row%dissipated = 1.5_wp
    row%contact_loss = 0.25_wp
    row%winch_work = 1.0_wp
    row%linear_momentum(1) = 3.0_wp + 2.5e-9_wp
    row%contacts = 7
    row%min_impulse = -2.0e-6_wp
    row%max_impulse = 3.0e-4_wp
    row%deepest_penetration = 1.25e-4_wp
    call add_row(ledger, row)
    row%contacts = 4
    row%min_impulse = 0.0_wp
    row%deepest_penetration = 1.0e-4_wp
    call add_row(ledger, row)
    text = report_lines(ledger)
    call expect(index(text, 'linear momentum') > 0 .and. index(text, '5.0e-10') > 0, 'relative drift: '//text)
    call expect(index(text, '0.25') > 0, 'energy not accounted for: '//text)
    call expect(index(text, '11 contacts') > 0, 'contacts add up: '//text)
    call expect(index(text, '-2.0e-06') > 0, 'smallest impulse: '//text)
    call expect(index(text, '1.3e-04') > 0 .or. index(text, '1.2e-04') > 0, 'deepest penetration: '//text)
  end subroutine test_ledger

end module test_log
