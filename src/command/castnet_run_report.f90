!> What a finished run tells: the results on standard output, the ledger on standard error.
module castnet_run_report
  use castnet_kinds, only: wp, i8
  use castnet_log, only: log_t, log_note, log_result
  use castnet_record, only: summary_t, capture_measures_t, history_row_t, verdict_captured, verdict_marginal
  use castnet_runner, only: run_ledger_t
  use castnet_simulation, only: simulation_t
  use castnet_text, only: to_text
  implicit none
  private
  public :: report_result, report_ledger, report_timings

contains

  !> File, first contact, verdicts.
  subroutine report_result(log, output, sim, summary)
    type(log_t), intent(inout) :: log
    character(len=*), intent(in) :: output
    type(simulation_t), intent(in) :: sim
    type(summary_t), intent(in) :: summary
    integer :: k

    call log_result(log, 'output           '//output)
    if (allocated(sim%model%contact)) then
      if (sim%state%first_contact >= 0.0_wp) then
        call log_result(log, 'first contact    '//short(summary%first_contact)//' s')
      else
        call log_result(log, 'first contact    none')
      end if
    end if
    if (allocated(summary%self_contacts)) call log_result(log, 'net on net       '//crossings_text(summary))
    if (.not. (allocated(sim%model%net) .and. allocated(sim%model%target))) return
    do k = 1, size(summary%measures)
      call log_result(log, 'at '//short(summary%measures(k)%time)//' s'//verdict_text(summary%measures(k)))
    end do
  end subroutine report_result

  !> '1946 crossings of cables, 74 of taut ones'.
  function crossings_text(summary) result(text)
    type(summary_t), intent(in) :: summary
    character(len=:), allocatable :: text
    associate (counts => summary%self_contacts)
      text = to_text(counts(1))//' crossings of cables, '//to_text(counts(2))//' of taut ones'
      if (summary%keeps_cables_apart) text = text//'; '//to_text(counts(3))//' not undone'
    end associate
  end function crossings_text

  function verdict_text(m) result(text)
    type(capture_measures_t), intent(in) :: m
    character(len=:), allocatable :: text
    select case (m%verdict)
    case (verdict_captured)
      text = ' captured'
    case (verdict_marginal)
      text = ' marginal'
    case default
      text = ' failed'
    end select
    text = text//': coverage '//short(m%coverage)//', largest hole '//short(m%largest_hole)//' degrees, escape '// &
           short(m%escape)//', CQI '//short(m%cqi)
  end function verdict_text

  !> Energies, momenta, smallest impulse and deepest penetration over the rows of history.
  subroutine report_ledger(log, sim, ledger)
    type(log_t), intent(inout) :: log
    type(simulation_t), intent(in) :: sim
    type(run_ledger_t), intent(in) :: ledger

    associate (a => ledger%first, b => ledger%last)
      call log_note(log, 'energy           '//short(mechanical(a))//' J at first, '//short(mechanical(b))// &
                    ' J at the end; dissipated '//short(b%dissipated)//', lost in contact '//short(b%contact_loss)// &
                    ' J; largest rise between rows '//short(ledger%largest_rise)//' J')
      if (allocated(sim%model%closing)) call log_note(log, 'winch work       '//short(b%winch_work)//' J')
      if (b%projection_work /= 0.0_wp) call log_note(log, 'projection work  '//short(b%projection_work)//' J')
      if (b%external_work /= 0.0_wp) call log_note(log, 'external work    '//short(b%external_work)//' J')
      call log_note(log, 'momentum drift   linear '//short(distance(a%linear_momentum, b%linear_momentum))// &
                    ' kg m/s, angular '//short(distance(a%angular_momentum, b%angular_momentum))//' kg m2/s')
      if (allocated(sim%model%net)) call log_note(log, 'largest tension  '//short(ledger%max_tension)//' N')
      if (allocated(sim%model%contact)) call log_note(log, 'contact          smallest impulse '// &
        short(ledger%min_impulse)//' N s, deepest penetration '//short(ledger%deepest_penetration)// &
        ' m, largest residual '//short(ledger%contact_residual)//' m/s')
    end associate
  end subroutine report_ledger

  !> Where the time went.
  subroutine report_timings(log, sim, summary)
    type(log_t), intent(inout) :: log
    type(simulation_t), intent(in) :: sim
    type(summary_t), intent(in) :: summary
    integer(i8) :: rate
    real(wp) :: flow, contact, rest, per_node

    call system_clock(count_rate=rate)
    flow = real(sim%work%timings%flow, wp)/real(rate, wp)
    contact = real(sim%work%timings%contact, wp)/real(rate, wp)
    rest = summary%wall_time - flow - contact
    call log_result(log, 'time             '//short(summary%wall_time)//' s')
    call log_result(log, '  motion         '//share(flow))
    call log_result(log, '  contact        '//share(contact))
    call log_result(log, '  output, checks '//share(rest))
    if (.not. allocated(sim%model%net) .or. summary%steps == 0) return
    per_node = flow*1.0e9_wp/(real(sim%model%net%n_node, wp)*real(summary%steps, wp))
    call log_result(log, '  motion takes   '//short(per_node)//' ns per node and step')

  contains

    function share(seconds) result(text)
      real(wp), intent(in) :: seconds
      character(len=:), allocatable :: text
      text = short(seconds)//' s, '//short(100.0_wp*seconds/max(summary%wall_time, tiny(1.0_wp)))//' %'
    end function share

  end subroutine report_timings

  pure real(wp) function mechanical(row)
    type(history_row_t), intent(in) :: row
    mechanical = row%kinetic_net + row%kinetic_target + row%elastic
  end function mechanical

  pure real(wp) function distance(a, b)
    real(wp), intent(in) :: a(3), b(3)
    distance = sqrt((a(1) - b(1))**2 + (a(2) - b(2))**2 + (a(3) - b(3))**2)
  end function distance

  !> Four digits, for people.
  function short(value) result(text)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=24) :: buffer
    if (value == 0.0_wp) then
      text = '0'
    else if (abs(value) >= 1.0e-3_wp .and. abs(value) < 1.0e5_wp) then
      write (buffer, '(f0.4)') value
      text = trim(adjustl(buffer))
      if (text(1:1) == '.') text = '0'//text
      if (text(1:2) == '-.') text = '-0'//text(2:)
    else
      write (buffer, '(es11.3)') value
      text = trim(adjustl(buffer))
    end if
  end function short

end module castnet_run_report
