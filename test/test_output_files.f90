!> Locks, refusals before a run starts, and the words for the operating system.
module test_output_files
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, exit_file, exit_done, exit_input
  use castnet_text, only: to_text, text_t
  use castnet_posix, only: create_file, read_file, remove_file, path_kind, path_nothing, path_file, process_id, host_name, &
                           process_start, time_stamp, wall_seconds, physical_memory, free_space, &
                           reserve_space, release_space, file_size, is_existing, system_words, process_is_alive
  use castnet_lock, only: lock_t, take_lock, release_lock
  use castnet_output_files, only: check_output, can_continue, stage_part, clear_leftovers
  use castnet_signals, only: stop_request_code
  use testing, only: test_case, expect, expect_equal
  implicit none
  private
  public :: run_test_output_files

contains

  subroutine run_test_output_files()
    call test_case('output_files: a lock is refused to a second, and given back', test_lock)
    call test_case('output_files: a lock of a dead process is stale, of another host is not', test_stale_lock)
    call test_case('output_files: what cannot be written is refused at the start', test_refusals)
    call test_case('output_files: a finished run is copied before it is gone on with', test_stage)
    call test_case('output_files: the words for the system mean what they say', test_posix)
  end subroutine run_test_output_files

  function output() result(path)
    character(len=:), allocatable :: path
    path = '/tmp/castnet_'//to_text(process_id())//'_files.h5'
  end function output

  subroutine test_lock()
    type(lock_t) :: lock, second
    type(error_t), allocatable :: error
    call take_lock(lock, output(), error)
    call expect(.not. allocated(error), 'the first lock')
    call expect_equal(path_kind(output()//'.lock'), path_file, 'OUTPUT.lock')
    call take_lock(second, output(), error)
    call expect(allocated(error), 'the second is refused')
    if (allocated(error)) then
      call expect_equal(error%code, exit_file, 'exit code')
      call expect(index(error%message, to_text(process_id())) > 0 .and. index(error%message, host_name()) > 0, &
                  'it says who holds it: '//error%message)
      deallocate (error)
    end if
    call release_lock(second)
    call expect_equal(path_kind(output()//'.lock'), path_file, 'the first lock is still there')
    call release_lock(lock)
    call expect_equal(path_kind(output()//'.lock'), path_nothing, 'given back')
  end subroutine test_lock

  subroutine test_stale_lock()
    type(lock_t) :: lock
    type(error_t), allocatable :: error
    integer :: ignored
    ! no process has this number (the largest that Linux gives is 4194304)
    call leave('4194305', host_name(), '1')
    call take_lock(lock, output(), error)
    call expect(.not. allocated(error), 'a dead process')
    call release_lock(lock)
    ! this process, but it started at another time: its number was another's before
    call leave(to_text(process_id()), host_name(), to_text(process_start(process_id()) + 1_i8))
    call take_lock(lock, output(), error)
    call expect(.not. allocated(error), 'a number that was given again')
    call release_lock(lock)
    call leave('4194305', 'another-host', '1')
    call take_lock(lock, output(), error)
    call expect(allocated(error), 'another host')
    if (allocated(error)) call expect(index(error%message, 'delete') > 0, 'what to do')
    if (allocated(error)) deallocate (error)
    ignored = remove_file(output()//'.lock')
    ignored = create_file(output()//'.lock', 'nonsense')
    call take_lock(lock, output(), error)
    call expect(allocated(error), 'a file that says nothing')
    ignored = remove_file(output()//'.lock')

  contains

    subroutine leave(process, host, started)
      character(len=*), intent(in) :: process, host, started
      ignored = remove_file(output()//'.lock')
      ignored = create_file(output()//'.lock', 'process '//process//new_line('a')//'host '//host//new_line('a')// &
                            'started '//started//new_line('a')//'since '//time_stamp()//new_line('a'))
    end subroutine leave

  end subroutine test_stale_lock

  subroutine test_refusals()
    type(text_t) :: none(0), scene(1)
    integer :: ignored
    call clear_leftovers(output())
    ignored = remove_file(output())
    call try(output(), none, .false., .false., '')
    call try('/tmp/castnet_no_such_folder/a.h5', none, .true., .false., 'make it first')
    call try('/tmp/', none, .true., .false., 'names a folder')
    call try('/tmp', none, .true., .false., 'is a folder')
    call try('/dev/null/a.h5', none, .true., .false., 'not a folder')
    call try('/tmp/'//repeat('x', 236), none, .true., .false., 'too long')
    call try('/tmp/'//repeat('x/', 2100)//'y', none, .true., .false., 'too long')
    ignored = create_file(output(), 'data')
    call try(output(), none, .false., .false., '--force')
    call try(output(), none, .true., .false., '')
    call try(output(), none, .false., .true., '')
    scene(1)%chars = output()
    call try(output(), scene, .true., .false., 'that is read here', exit_input)
    scene(1)%chars = output()//'.tmp'
    ignored = create_file(output()//'.tmp', 'data')
    call try(output(), scene, .true., .true., 'that is read here', exit_input)
    ignored = remove_file(output()//'.tmp')
    ignored = create_file(output()//'.part', 'data')
    call try(output(), none, .false., .true., 'both')
    ignored = remove_file(output())
    call try(output(), none, .false., .false., '--restart')
    call try(output(), none, .false., .true., '')
    ignored = create_file(output()//'.checkpoint', 'data')
    call clear_leftovers(output())
    call expect_equal(path_kind(output()//'.checkpoint'), path_nothing, 'an old checkpoint is cleared')
    call expect_equal(path_kind(output()//'.part'), path_file, 'OUTPUT.part is not')
    ignored = remove_file(output()//'.part')

  contains

    subroutine try(path, inputs, force, restarting, words, code)
      character(len=*), intent(in) :: path, words
      type(text_t), intent(in) :: inputs(:)
      logical, intent(in) :: force, restarting
      integer, intent(in), optional :: code   !! exit_file
      integer :: expected
      type(error_t), allocatable :: error
      expected = exit_file
      if (present(code)) expected = code
      call check_output(path, inputs, force, restarting, error)
      if (len(words) == 0) then
        if (allocated(error)) call expect(.false., 'accepted; seen: '//error%message)
      else if (allocated(error)) then
        call expect_equal(error%code, expected, 'exit code')
        call expect(index(error%message, words) > 0, 'it says "'//words//'": '//error%message)
      else
        call expect(.false., 'refused with "'//words//'"')
      end if
    end subroutine try

  end subroutine test_refusals

  subroutine test_stage()
    type(error_t), allocatable :: error
    character(len=:), allocatable :: bytes
    integer :: ignored
    call expect(.not. can_continue(output()), 'nothing to go on with')
    ignored = create_file(output(), repeat('0123456789', 200000))
    call expect(can_continue(output()), 'a finished run')
    call stage_part(output(), error)
    call expect(.not. allocated(error), 'copied')
    ignored = read_file(output()//'.part', bytes)
    call expect(bytes == repeat('0123456789', 200000), 'the copy')
    ignored = remove_file(output())
    ignored = remove_file(output()//'.part')
  end subroutine test_stage

  subroutine test_posix()
    character(len=:), allocatable :: path, bytes
    real(wp) :: now
    integer :: number
    path = output()
    call expect(len(time_stamp()) == 20, 'a time stamp: '//time_stamp())
    now = wall_seconds()
    call expect(wall_seconds() >= now, 'time does not run backwards')
    call expect(physical_memory() > 1000000_i8, 'memory')
    call expect(free_space('/tmp') > 0, 'free space')
    call expect(process_is_alive(process_id()) .and. .not. process_is_alive(4194305), 'processes')
    call expect_equal(create_file(path, 'abc'), 0, 'create')
    number = create_file(path, 'abc')
    call expect(is_existing(number), 'create again: '//system_words(number))
    call expect_equal(reserve_space(path, 3_i8, 100000_i8), 0, 'reserve')
    call expect_equal(int(file_size(path)), 3, 'size after reserving')
    call expect_equal(release_space(path), 0, 'release')
    number = read_file(path, bytes)
    call expect_equal(bytes, 'abc', 'content')
    number = reserve_space(path, 3_i8, 2_i8**60)
    call expect(number /= 0, 'an exabyte: '//system_words(number))
    number = remove_file(path)
    call expect(file_size(path) < 0, 'gone')
    call expect_equal(stop_request_code(), exit_done, 'no signal')
  end subroutine test_posix

end module test_output_files
