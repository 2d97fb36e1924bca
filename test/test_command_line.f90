!> The command line: what is understood and what is refused.
module test_command_line
  use castnet_command_line, only: options_t, parse_command_line, help_text
  use castnet_error, only: error_t, exit_input
  use castnet_kinds, only: wp
  use castnet_text, only: text_t, word_at, word_count
  use testing, only: test_case, expect, expect_equal, expect_close
  implicit none
  private
  public :: run_test_command_line

contains

  subroutine run_test_command_line()
    call test_case('command_line: options in both forms, the last wins', understood)
    call test_case('command_line: what is wrong is told with what is meant', refused)
    call test_case('command_line: help for all and for one', help)
  end subroutine run_test_command_line

  !> Parse a blank-separated line.
  subroutine parse(line, options, error)
    character(len=*), intent(in) :: line
    type(options_t), intent(out) :: options
    type(error_t), allocatable, intent(out) :: error
    type(text_t), allocatable :: arguments(:)
    integer :: i
    allocate (arguments(word_count(line)))
    do i = 1, size(arguments)
      arguments(i)%chars = word_at(line, i)
    end do
    call parse_command_line(arguments, options, error)
  end subroutine parse

  subroutine understood()
    type(options_t) :: options
    type(error_t), allocatable :: error
    call parse('run a.nml --output=x.h5 --threads 4 --set net/kind=file --output y.h5 --max-wall 01:00:00 '// &
               '--set time/step=1e-4 --force --no-progress --threads=2', options, error)
    call expect(.not. allocated(error), 'is understood')
    if (allocated(error)) return
    call expect_equal(options%command, 'run', 'command')
    call expect_equal(options%files(1)%chars, 'a.nml', 'file')
    call expect_equal(options%output, 'y.h5', 'the last output wins')
    call expect_equal(options%threads, 2, 'threads')
    call expect_equal(size(options%overrides), 2, 'overrides add up')
    call expect_equal(options%overrides(1)%chars, 'net/kind=file', 'an = in the value')
    call expect_close(options%max_wall, 3600.0_wp, 'max-wall')
    call expect(options%force .and. options%no_progress .and. .not. options%quiet, 'flags')
    call parse('study s.nml --shard 2/7', options, error)
    call expect(options%shard == 2 .and. options%shards == 7, 'shard')
    call parse('check -- --odd.nml', options, error)
    call expect(.not. allocated(error), 'after --')
    call expect_equal(options%files(1)%chars, '--odd.nml', 'a file that looks like an option')
    call parse('run --help', options, error)
    call expect(options%help .and. .not. allocated(error), 'help needs no file')
    call parse('help run', options, error)
    call expect(options%help .and. options%command == 'run', 'help as a command')
  end subroutine understood

  subroutine refused()
    call refuse('', 'which command?')
    call refuse('rnu a.nml', 'there is no command ''rnu''; did you mean run?')
    call refuse('a.nml', 'did you mean castnet run a.nml?')
    call refuse('run', 'castnet run needs SCENE.nml')
    call refuse('run a.nml b.nml', 'one argument too many: ''b.nml''')
    call refuse('run a.nml --ouput x', 'there is no option --ouput; did you mean --output?')
    call refuse('run a.nml --output', '--output: needs a value')
    call refuse('run a.nml --force=yes', '--force: takes no value')
    call refuse('run a.nml --threads 0', '--threads: seen ''0''; allowed')
    call refuse('run a.nml --threads two', '--threads: seen ''two''')
    call refuse('run a.nml --max-wall soon', '--max-wall: seen ''soon''; allowed: HH:MM:SS')
    call refuse('study a.nml --shard 3/2', '--shard: seen ''3/2''')
    call refuse('study a.nml --shard 1', '--shard: seen ''1''')
    call refuse('run a.nml --shard 1/2', '--shard: is no option of castnet run; it belongs to: study')
    call refuse('version now', 'one argument too many')
    call refuse('run -x a.nml', 'there is no option -x')
  end subroutine refused

  subroutine refuse(line, words)
    character(len=*), intent(in) :: line, words
    type(options_t) :: options
    type(error_t), allocatable :: error
    call parse(line, options, error)
    call expect(allocated(error), line//' is refused')
    if (.not. allocated(error)) return
    call expect_equal(error%code, exit_input, 'exit code')
    call expect(index(error%message, words) > 0, line//': '//error%message)
  end subroutine refuse

  subroutine help()
    call expect(index(help_text(''), '--shard K/N') > 0 .and. index(help_text(''), 'castnet init NAME') > 0, 'all')
    call expect(index(help_text('run'), '--shard') == 0 .and. index(help_text('run'), '--restart FILE') > 0, 'run only')
  end subroutine help

end module test_command_line
