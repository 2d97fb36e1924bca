!> What a person sees while a program runs: results on standard output, everything else
!> on standard error; progress as one line that moves on a terminal, elsewhere as one line
!> each 10 %. Colour only on a terminal, and not when NO_COLOR is set.
module castnet_log
  use castnet_kinds, only: wp
  use castnet_text, only: to_text, duration_text
  use castnet_posix, only: is_terminal, wall_seconds
  use castnet_process_guard, only: print_line, print_error
  implicit none
  private
  public :: log_t, new_log, log_result, log_note, log_warning, log_progress, progress_is_due, end_progress

  real(wp), parameter :: redraw_interval = 0.1_wp   !! between two moves of the line [s]
  character(len=1), parameter :: escape = achar(27), return = achar(13)

  type :: log_t
    logical :: quiet = .false.          !! no notes and no progress; warnings and errors stay
    logical :: progress = .true.
    logical, private :: terminal = .false., colour = .false.
    logical, private :: line_is_open = .false.
    integer, private :: tenths = 0      !! tenths of the way already told
    real(wp), private :: began = 0.0_wp, drawn = -huge(1.0_wp)
  end type log_t

contains

  !> A log that knows where it speaks.
  subroutine new_log(log, quiet, progress)
    type(log_t), intent(out) :: log
    logical, intent(in) :: quiet        !! --quiet
    logical, intent(in) :: progress     !! not --no-progress
    integer :: length
    log%quiet = quiet
    log%progress = progress .and. .not. quiet
    log%terminal = is_terminal(2)
    call get_environment_variable('NO_COLOR', length=length)
    log%colour = log%terminal .and. length == 0
    log%began = wall_seconds()
  end subroutine new_log

  !> A result or requested data: standard output, always.
  subroutine log_result(log, text)
    type(log_t), intent(inout) :: log
    character(len=*), intent(in) :: text
    call end_progress(log)
    call print_line(text)
  end subroutine log_result

  !> What may be of interest: standard error, unless quiet.
  subroutine log_note(log, text)
    type(log_t), intent(inout) :: log
    character(len=*), intent(in) :: text
    if (log%quiet) return
    call end_progress(log)
    call write_error(text)
  end subroutine log_note

  !> What the user should know before trusting a result: standard error, always.
  subroutine log_warning(log, text)
    type(log_t), intent(inout) :: log
    character(len=*), intent(in) :: text
    call end_progress(log)
    call write_error(painted(log, '33', 'warning:')//' '//text)
  end subroutine log_warning

  !> How far the work is: costs a look at the clock on a terminal, less elsewhere. `text`
  !> says it in the work's own unit ('t = 1.2 s of 3 s').
  subroutine log_progress(log, fraction, text)
    type(log_t), intent(inout) :: log
    real(wp), intent(in) :: fraction    !! 0 to 1
    character(len=*), intent(in) :: text
    integer :: tenths
    if (.not. progress_is_due(log, fraction)) return
    tenths = tenths_of(fraction)
    if (log%terminal) then
      log%drawn = wall_seconds()
      call print_error(return//escape//'[K'//line(log, fraction, text))
      log%line_is_open = .true.
    else
      call write_error(line(log, fraction, text))
    end if
    log%tenths = max(tenths, log%tenths)
  end subroutine log_progress

  !> Would `log_progress` say anything now? To ask costs less than to put its words together.
  logical function progress_is_due(log, fraction)
    type(log_t), intent(in) :: log
    real(wp), intent(in) :: fraction    !! 0 to 1
    progress_is_due = .false.
    if (.not. log%progress) return
    if (log%terminal) then
      progress_is_due = fraction >= 1.0_wp .or. wall_seconds() - log%drawn >= redraw_interval
    else
      progress_is_due = tenths_of(fraction) > log%tenths
    end if
  end function progress_is_due

  pure integer function tenths_of(fraction)
    real(wp), intent(in) :: fraction
    tenths_of = int(10.0_wp*max(0.0_wp, min(1.0_wp, fraction)))
  end function tenths_of

  !> ' 42 %  t = 1.2 s of 3 s  0:00:05 left'
  function line(log, fraction, text)
    type(log_t), intent(in) :: log
    real(wp), intent(in) :: fraction
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: line
    real(wp) :: spent
    character(len=3) :: percent
    write (percent, '(i3)') int(100.0_wp*max(0.0_wp, min(1.0_wp, fraction)))
    line = percent//' %  '//text
    spent = wall_seconds() - log%began
    if (fraction > 0.01_wp .and. fraction < 1.0_wp) &
      line = line//'  '//duration_text(spent*(1.0_wp - fraction)/fraction)//' left'
  end function line

  !> End the moving line, so that what follows stands on its own.
  subroutine end_progress(log)
    type(log_t), intent(inout) :: log
    if (.not. log%line_is_open) return
    call print_error(new_line('a'))
    log%line_is_open = .false.
  end subroutine end_progress

  function painted(log, colour, word) result(text)
    type(log_t), intent(in) :: log
    character(len=*), intent(in) :: colour, word
    character(len=:), allocatable :: text
    text = word
    if (log%colour) text = escape//'['//colour//'m'//word//escape//'[0m'
  end function painted

  subroutine write_error(text)
    character(len=*), intent(in) :: text
    call print_error(text//new_line('a'))
  end subroutine write_error

end module castnet_log
