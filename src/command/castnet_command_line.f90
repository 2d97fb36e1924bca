!> The command line as data: which command, which files, which options. All that is
!> wrong with it is told in one go.
module castnet_command_line
  use castnet_error, only: error_t, fail, exit_input
  use castnet_kinds, only: wp, i8
  use castnet_problems, only: problem_list_t
  use castnet_text, only: text_t, to_text, lower, did_you_mean, is_one_of, parse_integer, parse_duration, quoted, &
                          word_at, word_count
  implicit none
  private
  public :: options_t, parse_command_line, process_arguments, help_text, command_names

  integer, parameter :: most_threads = 1024

  !> What the user asked for. Texts that were not given are not allocated.
  type :: options_t
    character(len=:), allocatable :: command
    type(text_t), allocatable :: files(:)      !! scenes, a study, a name
    character(len=:), allocatable :: output, restart
    type(text_t), allocatable :: overrides(:)  !! 'group/key=value', in order
    integer :: threads = 0                     !! 0: not given
    real(wp) :: max_wall = huge(1.0_wp)        !! [s]
    integer :: shard = 1, shards = 1           !! this one, of how many
    logical :: timings = .false., force = .false., quiet = .false., no_progress = .false.
    logical :: help = .false., markdown = .false., effective = .false.
  end type options_t

  !> One option: the value it takes ('' for none) and the commands that know it.
  type :: option_t
    character(len=14) :: name
    character(len=16) :: value
    character(len=40) :: commands
    character(len=72) :: help
  end type option_t

  type :: command_t
    character(len=10) :: name
    character(len=20) :: arguments
    integer :: least = 0, most = 0             !! arguments
    character(len=72) :: help
  end type command_t

  type(command_t), parameter :: commands(*) = [ &
    command_t('run', 'SCENE.nml', 1, 1, 'run a scene and write its results'), &
    command_t('check', 'SCENE.nml', 1, huge(1), 'validate a scene or a study, and say what would run'), &
    command_t('study', 'STUDY.nml', 1, 1, 'run many variants of a scene and tell probabilities'), &
    command_t('collect', 'STUDY.nml', 1, 1, 'put the shards of a study into one table'), &
    command_t('accuracy', 'SCENE.nml', 1, 1, 'speed against error of the methods on a scene'), &
    command_t('init', 'NAME', 1, 1, 'write NAME.nml, a commented scene that runs'), &
    command_t('schema', '', 0, 0, 'every group and key of scenes and studies'), &
    command_t('version', '', 0, 0, 'version, git commit, compiler, flags, libraries')]

  type(option_t), parameter :: known(*) = [ &
    option_t('output', 'FILE', 'run study collect accuracy', 'HDF5 file of the results'), &
    option_t('restart', 'FILE', 'run', 'go on from a checkpoint'), &
    option_t('threads', 'N', 'run check study accuracy', 'threads to use'), &
    option_t('set', 'group/key=value', 'run check study collect accuracy', 'override a value of the scene; may be repeated'), &
    option_t('max-wall', 'HH:MM:SS', 'run study', 'stop, resumable, after this wall time'), &
    option_t('shard', 'K/N', 'study', 'run the K-th of N parts of a study'), &
    option_t('timings', '', 'run study accuracy', 'tell where the time went'), &
    option_t('force', '', 'run study collect accuracy init', 'replace files that exist'), &
    option_t('quiet', '', 'run check study collect accuracy init', 'only warnings and errors on stderr'), &
    option_t('no-progress', '', 'run study collect accuracy', 'no progress lines'), &
    option_t('markdown', '', 'schema', 'as a page of Markdown'), &
    option_t('effective', '', 'check', 'print the scene with every default'), &
    option_t('help', '', '', 'this help')]

contains

  !> The arguments of this process, without the program's name.
  function process_arguments() result(arguments)
    type(text_t), allocatable :: arguments(:)
    integer :: i, length
    allocate (arguments(command_argument_count()))
    do i = 1, size(arguments)
      call get_command_argument(i, length=length)
      allocate (character(len=length) :: arguments(i)%chars)
      if (length > 0) call get_command_argument(i, arguments(i)%chars)
    end do
  end function process_arguments

  !> Arguments to options. Errors: `exit_input`, with all that is wrong.
  subroutine parse_command_line(arguments, options, error)
    type(text_t), intent(in) :: arguments(:)
    type(options_t), intent(out) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(problem_list_t) :: problems
    character(len=:), allocatable :: given
    logical :: only_files
    integer :: i
    options%command = ''
    allocate (options%files(0), options%overrides(0))
    given = ''
    only_files = .false.
    i = 1
    do while (i <= size(arguments))
      associate (argument => arguments(i)%chars)
        if (argument == '--' .and. .not. only_files) then
          only_files = .true.
        else if (.not. only_files .and. len(argument) > 1 .and. index(argument, '-') == 1) then
          call take_option(arguments, i, options, given, problems)
        else if (len(options%command) == 0) then
          options%command = argument
          if (len(argument) == 0) options%command = ' '
        else
          call append(options%files, argument)
        end if
      end associate
      i = i + 1
    end do
    if (options%command == 'help') then
      options%help = .true.
      options%command = ''
      if (size(options%files) > 0) options%command = options%files(1)%chars
      if (.not. is_one_of(options%command, command_names())) options%command = ''
    end if
    if (options%help) return
    call check_command(options, given, problems)
    if (problems%n > 0) call fail(error, exit_input, problems%report()//new_line('a')// &
                                  'castnet --help tells what there is')
  end subroutine parse_command_line

  !> One option and its value. On return `i` is the last argument used.
  subroutine take_option(arguments, i, options, given, problems)
    type(text_t), intent(in) :: arguments(:)
    integer, intent(inout) :: i
    type(options_t), intent(inout) :: options
    character(len=:), allocatable, intent(inout) :: given
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: name, value, seen
    integer :: equals, k
    logical :: has_value
    seen = arguments(i)%chars
    equals = index(seen, '=')
    has_value = equals > 0
    value = ''
    if (has_value) then
      value = seen(equals + 1:)
      seen = seen(:equals - 1)
    end if
    if (seen == '-h') seen = '--help'
    name = seen(verify(seen//' ', '-'):)
    do k = 1, size(known)
      if ('--'//trim(known(k)%name) == seen) exit
    end do
    if (k > size(known)) then
      call problems%add('', 0, '', 'there is no option '//seen//suggestion(name))
      return
    end if
    given = given//trim(known(k)%name)//' '
    if (len_trim(known(k)%value) == 0) then
      if (has_value) call problems%add('', 0, seen, 'takes no value; seen '//quoted(value))
    else if (.not. has_value) then
      if (i == size(arguments)) then
        call problems%add('', 0, seen, 'needs a value: '//seen//' '//trim(known(k)%value))
        return
      end if
      i = i + 1
      value = arguments(i)%chars
    end if
    call set_option(trim(known(k)%name), value, options, problems)
  end subroutine take_option

  subroutine set_option(name, value, options, problems)
    character(len=*), intent(in) :: name, value
    type(options_t), intent(inout) :: options
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: problem
    integer(i8) :: long
    select case (name)
    case ('output')
      call take_path(options%output)
    case ('restart')
      call take_path(options%restart)
    case ('threads')
      call parse_integer(value, long, problem)
      if (allocated(problem) .or. long < 1 .or. long > most_threads) then
        call problems%add('', 0, '--threads', 'seen '//quoted(value)//'; allowed: a whole number from 1 to '//to_text(most_threads))
      else
        options%threads = int(long)
      end if
    case ('set')
      call append(options%overrides, value)
    case ('max-wall')
      call parse_duration(value, options%max_wall, problem)
      if (allocated(problem)) call problems%add('', 0, '--max-wall', 'seen '//quoted(value)//'; allowed: HH:MM:SS')
    case ('shard')
      call parse_shard(value, options, problems)
    case ('timings')
      options%timings = .true.
    case ('force')
      options%force = .true.
    case ('quiet')
      options%quiet = .true.
    case ('no-progress')
      options%no_progress = .true.
    case ('markdown')
      options%markdown = .true.
    case ('effective')
      options%effective = .true.
    case ('help')
      options%help = .true.
    end select
  contains
    subroutine take_path(place)
      character(len=:), allocatable, intent(inout) :: place
      if (len_trim(value) == 0) call problems%add('', 0, '--'//name, 'seen an empty path')
      place = value
    end subroutine take_path
  end subroutine set_option

  !> One text more. (Constructors of types with texts of any length go wrong in gfortran 12.)
  subroutine append(list, chars)
    type(text_t), allocatable, intent(inout) :: list(:)
    character(len=*), intent(in) :: chars
    type(text_t), allocatable :: grown(:)
    integer :: i
    allocate (grown(size(list) + 1))
    do i = 1, size(list)
      call move_alloc(list(i)%chars, grown(i)%chars)
    end do
    grown(size(grown))%chars = chars
    call move_alloc(grown, list)
  end subroutine append

  !> 'K/N' with 1 <= K <= N.
  subroutine parse_shard(value, options, problems)
    character(len=*), intent(in) :: value
    type(options_t), intent(inout) :: options
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: bad_first, bad_second
    integer(i8) :: k, n
    integer :: slash
    slash = index(value//'/', '/')
    call parse_integer(value(:slash - 1), k, bad_first)
    call parse_integer(value(min(slash + 1, len(value) + 1):), n, bad_second)
    if (allocated(bad_first) .or. allocated(bad_second) .or. k < 1 .or. k > n .or. n > 1000000) then
      call problems%add('', 0, '--shard', 'seen '//quoted(value)//'; allowed: K/N with K from 1 to N')
    else
      options%shard = int(k)
      options%shards = int(n)
    end if
  end subroutine parse_shard

  !> Is the command known, are its arguments and options right?
  subroutine check_command(options, given, problems)
    type(options_t), intent(in) :: options
    character(len=*), intent(in) :: given
    type(problem_list_t), intent(inout) :: problems
    type(command_t) :: command
    integer :: c, i, k
    if (len(options%command) == 0) then
      if (problems%n == 0) call problems%add('', 0, '', 'which command? one of: '//command_names())
      return
    end if
    do c = 1, size(commands)
      if (commands(c)%name == options%command .and. len_trim(options%command) > 0) exit
    end do
    if (c > size(commands)) then
      if (index(options%command, '.nml') > 0) then
        call problems%add('', 0, '', 'there is no command '//quoted(options%command)//'; did you mean castnet run '// &
                          options%command//'?')
      else
        call problems%add('', 0, '', 'there is no command '//quoted(options%command)// &
                          did_you_mean(options%command, command_names())//' (allowed: '//command_names()//')')
      end if
      return
    end if
    command = commands(c)
    if (size(options%files) < command%least) then
      call problems%add('', 0, '', 'castnet '//trim(command%name)//' needs '//trim(command%arguments))
    else if (size(options%files) > command%most) then
      call problems%add('', 0, '', 'castnet '//trim(command%name)//': one argument too many: '// &
                        quoted(options%files(command%most + 1)%chars))
    end if
    do i = 1, size(options%files)
      if (len_trim(options%files(i)%chars) == 0) call problems%add('', 0, '', 'an empty argument')
    end do
    do i = 1, word_count(given)
      do k = 1, size(known)
        if (known(k)%name == word_at(given, i)) exit
      end do
      if (len_trim(known(k)%commands) > 0 .and. .not. is_one_of(trim(command%name), trim(known(k)%commands))) &
        call problems%add('', 0, '--'//trim(known(k)%name), 'is no option of castnet '//trim(command%name)// &
                          '; it belongs to: '//trim(known(k)%commands))
    end do
  end subroutine check_command

  function suggestion(name) result(text)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text, list
    integer :: i
    list = ''
    do i = 1, size(known)
      list = list//trim(known(i)%name)//' '
    end do
    text = did_you_mean(name, list)
    i = index(text, 'mean ')
    if (i > 0) text = text(:i + 4)//'--'//text(i + 5:)
  end function suggestion

  !> Every command, blank-separated.
  function command_names() result(names)
    character(len=:), allocatable :: names
    integer :: i
    names = ''
    do i = 1, size(commands)
      names = names//trim(commands(i)%name)//' '
    end do
    names = trim(names)
  end function command_names

  !> Help for one command, or ('') for all.
  function help_text(command) result(text)
    character(len=*), intent(in) :: command
    character(len=:), allocatable :: text
    character(len=1), parameter :: nl = new_line('a')
    character(len=30) :: left
    integer :: i
    text = 'castnet: will this net catch that debris?'//nl//nl
    do i = 1, size(commands)
      if (len_trim(command) > 0 .and. commands(i)%name /= command) cycle
      left = 'castnet '//trim(commands(i)%name)//' '//commands(i)%arguments
      text = text//'  '//left//trim(commands(i)%help)//nl
    end do
    text = text//nl//'Options (an option given twice: the last wins; --option VALUE or --option=VALUE)'//nl
    do i = 1, size(known)
      if (len_trim(command) > 0 .and. len_trim(known(i)%commands) > 0 .and. &
          .not. is_one_of(command, trim(known(i)%commands))) cycle
      left = '--'//trim(known(i)%name)//' '//known(i)%value
      text = text//'  '//left//trim(known(i)%help)//nl
    end do
    text = text//nl//'Exit codes: 0 done, 1 a bug of ours, 2 bad usage or input, 3 numerical failure,'//nl// &
           '4 files, 75 stopped and resumable, 130 interrupted and resumable.'
  end function help_text

end module castnet_command_line
