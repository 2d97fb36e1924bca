!> The ledger at the end of a run: where the energy went, how well momentum was kept, the
!> smallest impulse and the deepest penetration. Gathered from the rows of /history.
module castnet_ledger_report
  use castnet_kinds, only: wp, i8
  use castnet_record, only: history_row_t
  use castnet_text, only: to_text
  implicit none
  private
  public :: ledger_report_t, add_row, report_lines

  type :: ledger_report_t
    private
    logical :: is_empty = .true.
    type(history_row_t) :: first, last
    integer(i8) :: contacts = 0
    real(wp) :: min_impulse = 0.0_wp, max_impulse = 0.0_wp, max_bullet_impulse = 0.0_wp   !! [N s]
    real(wp) :: deepest_penetration = 0.0_wp                                               !! [m]
    real(wp) :: max_tension = 0.0_wp                                                       !! [N]
    real(wp) :: drift_linear = 0.0_wp, drift_angular = 0.0_wp  !! largest change since the first row
  end type ledger_report_t

contains

  !> Take a row of /history into account.
  subroutine add_row(ledger, row)
    type(ledger_report_t), intent(inout) :: ledger
    type(history_row_t), intent(in) :: row
    if (ledger%is_empty) ledger%first = row
    ledger%is_empty = .false.
    ledger%last = row
    ledger%contacts = ledger%contacts + row%contacts
    ledger%min_impulse = min(ledger%min_impulse, row%min_impulse)
    ledger%max_impulse = max(ledger%max_impulse, row%max_impulse)
    ledger%max_bullet_impulse = max(ledger%max_bullet_impulse, row%max_bullet_impulse)
    ledger%deepest_penetration = max(ledger%deepest_penetration, row%deepest_penetration)
    ledger%max_tension = max(ledger%max_tension, row%max_tension)
    ledger%drift_linear = max(ledger%drift_linear, length(row%linear_momentum - ledger%first%linear_momentum))
    ledger%drift_angular = max(ledger%drift_angular, length(row%angular_momentum - ledger%first%angular_momentum))
  end subroutine add_row

  !> The report, several lines; '' before the first row.
  function report_lines(ledger) result(text)
    type(ledger_report_t), intent(in) :: ledger
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')
    real(wp) :: before, after, gained
    text = ''
    if (ledger%is_empty) return
    associate (a => ledger%first, b => ledger%last)
      before = a%kinetic_net + a%kinetic_target + a%elastic
      after = b%kinetic_net + b%kinetic_target + b%elastic
      gained = b%winch_work - a%winch_work + b%projection_work - a%projection_work + b%external_work - a%external_work
      text = 'energy: '//short(before)//' J at the start, '//short(after)//' J at the end (net '//short(b%kinetic_net)// &
             ', target '//short(b%kinetic_target)//', elastic '//short(b%elastic)//'); cables took '// &
             short(b%dissipated - a%dissipated)//', contact '//short(b%contact_loss - a%contact_loss)// &
             '; the winch gave '//short(b%winch_work - a%winch_work)//', position correction '// &
             short(b%projection_work - a%projection_work)//', outer forces '//short(b%external_work - a%external_work)// &
             '; not accounted for '//short(after - before - gained + b%dissipated - a%dissipated &
                                           + b%contact_loss - a%contact_loss)
      text = text//nl//'momentum: linear momentum changed by '//short(ledger%drift_linear)//' kg m/s'// &
             relative(ledger%drift_linear, length(a%linear_momentum))//', angular momentum by '// &
             short(ledger%drift_angular)//' kg m2/s'//relative(ledger%drift_angular, length(a%angular_momentum))
      text = text//nl//'contact: '//to_text(ledger%contacts)//' contacts; smallest impulse '//short(ledger%min_impulse)// &
             ' N s, largest '//short(ledger%max_impulse)//' N s (bullets '//short(ledger%max_bullet_impulse)// &
             '); deepest penetration '//short(ledger%deepest_penetration)//' m; largest tension '// &
             short(ledger%max_tension)//' N'
    end associate
  end function report_lines

  !> ' (x of its length)', when there is a length.
  function relative(change, whole) result(text)
    real(wp), intent(in) :: change, whole
    character(len=:), allocatable :: text
    text = ''
    if (whole > tiny(1.0_wp)*1.0e10_wp) text = ' ('//short(change/whole)//' of it)'
  end function relative

  !> Two digits for small things, four for others.
  function short(value) result(text)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=24) :: buffer
    if (.not. abs(value) > 0.0_wp) then
      text = '0'
    else if (abs(value) >= 1.0e-2_wp .and. abs(value) < 1.0e4_wp) then
      write (buffer, '(f12.4)') value
      text = trim(adjustl(buffer))
    else
      write (buffer, merge('(es12.1e3)', '(es10.1e2)', abs(value) < 1.0e-99_wp .or. abs(value) >= 1.0e99_wp)) value
      text = trim(adjustl(buffer))
      if (index(text, 'E') > 0) text(index(text, 'E'):index(text, 'E')) = 'e'
    end if
  end function short

  pure real(wp) function length(v)
    real(wp), intent(in) :: v(3)
    length = sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3))
  end function length

end module castnet_ledger_report
