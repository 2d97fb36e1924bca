!> The commands: each a short procedure. What they print on standard output is a result,
!> the rest goes to standard error; the exit code says how it ended.
module castnet_commands
  use castnet_accuracy_command, only: accuracy_file
  use castnet_check_command, only: check_files
  use castnet_command_line, only: options_t, parse_command_line, process_arguments, help_text
  use castnet_error, only: error_t, fail, exit_done, exit_bug, exit_input
  use castnet_hdf5_version, only: hdf5_version
  use castnet_reference, only: reference_text, reference_markdown
  use castnet_run_command, only: run_file
  use castnet_scene_text, only: scene_template
  use castnet_study_command, only: study_file, collect_file
  use castnet_terminal, only: say, tell
  use castnet_text, only: text_t
  use castnet_text_file, only: write_text_file
  use castnet_version, only: version_number, git_commit, compiler_name, compiler_flags, build_profile
  implicit none
  private
  public :: run_command

contains

  !> Do what the command line asks. Returns the exit code.
  integer function run_command() result(code)
    type(options_t) :: options
    type(error_t), allocatable :: error
    call parse_command_line(process_arguments(), options, error)
    if (.not. allocated(error)) call dispatch(options, error)
    code = exit_done
    if (.not. allocated(error)) return
    code = error%code
    if (len(error%message) > 0) call tell(error%message)
  end function run_command

  subroutine dispatch(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    if (options%help) then
      call say(help_text(options%command))
      return
    end if
    select case (options%command)
    case ('run')
      call run_file(options, error)
    case ('check')
      call check_files(options, error)
    case ('init')
      call init(options, error)
    case ('schema')
      if (options%markdown) then
        call say(reference_markdown())
      else
        call say(reference_text())
      end if
    case ('version')
      call version()
    case ('study')
      call study_file(options, error)
    case ('collect')
      call collect_file(options, error)
    case ('accuracy')
      call accuracy_file(options, error)
    case default
      call fail(error, exit_bug, 'the command '//options%command//' is known but not built in')
    end select
  end subroutine dispatch

  !> NAME.nml, a commented scene that runs.
  subroutine init(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: path
    integer :: n
    path = options%files(1)%chars
    n = len(path)
    if (path(n:) == '/') then
      call fail(error, exit_input, 'init: seen '//path//'; allowed: a name, from which NAME.nml is made')
      return
    end if
    if (index(path, '.nml', back=.true.) == 0 .or. index(path, '.nml', back=.true.) /= n - 3) path = path//'.nml'
    call write_text_file(path, scene_template(), options%force, error)
    if (.not. allocated(error) .and. .not. options%quiet) &
      call tell('wrote '//path//'; castnet check '//path//' says what it would run')
  end subroutine init

  subroutine version()
    call say('castnet '//version_number)
    call say('commit   '//git_commit())
    call say('compiler '//compiler_name())
    call say('flags    '//compiler_flags())
    call say('profile  '//build_profile())
    call say('HDF5     '//hdf5_version())
    call say('LAPACK   not used')
  end subroutine version

end module castnet_commands
