!> OUTPUT.lock: one process at a time writes a run's files.
!>
!> The lock names the process, when it started, and its host. It is created in one act
!> that fails if it is there. One of a dead process on this host is stale and taken over; a
!> process that was given a dead one's number is told from it by its start. About another
!> host nothing can be known here: the user decides.
module castnet_lock
  use castnet_kinds, only: i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_text, only: to_text, parse_integer
  use castnet_posix, only: create_file, link_file, remove_file, read_file, remove_if_unchanged, is_existing, process_id, &
                           process_is_alive, &
                           process_start, host_name, time_stamp, file_failure
  implicit none
  private
  public :: lock_t, take_lock, release_lock

  integer, parameter :: most_tries = 100

  type :: lock_t
    private
    character(len=:), allocatable :: path
    character(len=:), allocatable :: content     !! ours; not allocated: no lock is held
  end type lock_t

contains

  !> Take OUTPUT.lock, or say who holds it. Errors: exit_file.
  subroutine take_lock(lock, output, error)
    type(lock_t), intent(out) :: lock
    character(len=*), intent(in) :: output
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: ours, theirs
    integer :: try, number
    if (allocated(error)) return
    lock%path = output//'.lock'
    ours = 'process '//to_text(process_id())//new_line('a')//'host '//host_name()//new_line('a')// &
           'started '//to_text(process_start(process_id()))//new_line('a')//'since '//time_stamp()//new_line('a')
    do try = 1, most_tries
      number = create_whole(lock%path, ours)
      if (number == 0) then
        lock%content = ours
        return
      end if
      if (.not. is_existing(number)) then
        call file_failure(error, number, 'cannot write', lock%path, &
                          'choose a folder that is there and writable with --output')
        return
      end if
      number = read_file(lock%path, theirs)
      if (number /= 0) cycle                     ! gone in between
      if (.not. is_stale(theirs)) then
        call fail(error, exit_file, held(output, theirs, lock%path))
        return
      end if
      number = remove_if_unchanged(lock%path, theirs)
    end do
    call fail(error, exit_file, "cannot take '"//lock%path//"': others keep taking and leaving it; try again")
  end subroutine take_lock

  !> Create a file that is never seen half written, even if this process is killed: made
  !> aside, then given its name. Where a file system has no second names, made in place.
  integer function create_whole(path, bytes) result(number)
    character(len=*), intent(in) :: path, bytes
    character(len=:), allocatable :: aside
    integer :: ignored
    aside = path//'.'//to_text(process_id())
    ignored = remove_file(aside)
    number = create_file(aside, bytes)
    if (number /= 0) return
    number = link_file(aside, path)
    ignored = remove_file(aside)
    if (number /= 0 .and. .not. is_existing(number)) number = create_file(path, bytes)
  end function create_whole

  !> Give the lock back; nothing happens if none is held or it is no longer ours.
  subroutine release_lock(lock)
    type(lock_t), intent(inout) :: lock
    integer :: ignored
    if (.not. allocated(lock%content)) return
    ignored = remove_if_unchanged(lock%path, lock%content)
    deallocate (lock%content)
  end subroutine release_lock

  !> Is the process that wrote this gone for certain? A lock that is being written just now
  !> is empty: it is young, and its writer is given the benefit of the doubt by reading again.
  logical function is_stale(content)
    character(len=*), intent(in) :: content
    integer(i8) :: process, started
    is_stale = .false.
    if (field(content, 'host') /= host_name()) return
    process = number_of(field(content, 'process'))
    started = number_of(field(content, 'started'))
    if (process <= 0 .or. process > huge(1)) return
    is_stale = .not. process_is_alive(int(process))
    if (.not. is_stale .and. started > 0) is_stale = process_start(int(process)) /= started
  end function is_stale

  !> The sentence for a lock that is held.
  function held(output, content, path) result(text)
    character(len=*), intent(in) :: output, content, path
    character(len=:), allocatable :: text
    if (len(field(content, 'process')) == 0) then
      text = "'"//path//"' is there but does not say whose it is; if no castnet writes '"//output//"', delete it"
      return
    end if
    text = "another castnet writes '"//output//"': process "//field(content, 'process')//' on '//field(content, 'host')// &
           ' since '//field(content, 'since')//'; wait for it or choose another file with --output'
    if (field(content, 'host') /= host_name()) text = text//"; if it is gone, delete '"//path//"'"
  end function held

  !> What follows a word at the start of a line.
  function field(content, word) result(value)
    character(len=*), intent(in) :: content, word
    character(len=:), allocatable :: value
    integer :: first, last
    value = ''
    first = index(new_line('a')//content, new_line('a')//word//' ')
    if (first == 0) return
    first = first + len(word) + 1
    last = index(content(first:), new_line('a'))
    if (last == 0) last = len(content) - first + 2
    value = content(first:first + last - 2)
  end function field

  integer(i8) function number_of(text)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: problem
    call parse_integer(text, number_of, problem)
    if (allocated(problem)) number_of = -1
  end function number_of

end module castnet_lock
