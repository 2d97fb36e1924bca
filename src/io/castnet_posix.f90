!> What the operating system knows: files, folders, disk space, processes, clocks.
!> Thin words over the C file beside this one. Functions that can fail return 0 or the
!> system's error number; `system_words` turns that into words, `file_failure` into an
!> `error_t` whose sentence says what to do.
module castnet_posix
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_int64_t, c_double, c_null_char
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_process_guard, only: forget_refusal
  implicit none
  private
  public :: create_file, append_file, read_file, copy_file, sync_path, rename_file, remove_file, remove_if_unchanged, link_file
  public :: make_folder
  public :: path_kind, path_nothing, path_file, path_folder, path_other
  public :: file_size, same_file, may_write, longest_name, longest_path, free_space, reserve_space, release_space
  public :: is_terminal, process_id, process_is_alive, process_start, host_name
  public :: wall_seconds, time_stamp, physical_memory, default_environment
  public :: system_error, clear_system_error, system_words, is_disk_full, is_existing, file_failure

  integer, parameter :: path_nothing = 0, path_file = 1, path_folder = 2, path_other = 3

  interface
    integer(c_int) function castnet_create_file(path, data, n) bind(c)
      import :: c_char, c_int, c_int64_t
      character(kind=c_char), intent(in) :: path(*), data(*)
      integer(c_int64_t), value :: n
    end function castnet_create_file
    integer(c_int) function castnet_read_file(path, data, n, done) bind(c)
      import :: c_char, c_int, c_int64_t
      character(kind=c_char), intent(in) :: path(*)
      character(kind=c_char), intent(out) :: data(*)
      integer(c_int64_t), value :: n
      integer(c_int64_t), intent(out) :: done
    end function castnet_read_file
    integer(c_int) function castnet_append_file(path, length, data, n) bind(c)
      import :: c_char, c_int, c_int64_t
      character(kind=c_char), intent(in) :: path(*), data(*)
      integer(c_int64_t), value :: length, n
    end function castnet_append_file
    integer(c_int) function castnet_copy_file(from, to) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: from(*), to(*)
    end function castnet_copy_file
    integer(c_int) function castnet_sync_path(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_sync_path
    integer(c_int) function castnet_rename(from, to) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: from(*), to(*)
    end function castnet_rename
    integer(c_int) function castnet_make_folder(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_make_folder
    integer(c_int) function castnet_remove_file(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_remove_file
    integer(c_int) function castnet_remove_if_unchanged(path, data, n) bind(c)
      import :: c_char, c_int, c_int64_t
      character(kind=c_char), intent(in) :: path(*), data(*)
      integer(c_int64_t), value :: n
    end function castnet_remove_if_unchanged
    integer(c_int) function castnet_link(from, to) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: from(*), to(*)
    end function castnet_link
    integer(c_int) function castnet_path_kind(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_path_kind
    integer(c_int64_t) function castnet_file_size(path) bind(c)
      import :: c_char, c_int64_t
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_file_size
    integer(c_int) function castnet_same_file(a, b) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: a(*), b(*)
    end function castnet_same_file
    integer(c_int) function castnet_may_write(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_may_write
    integer(c_int) function castnet_longest_name(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_longest_name
    integer(c_int) function castnet_longest_path() bind(c)
      import :: c_int
    end function castnet_longest_path
    integer(c_int64_t) function castnet_free_space(path) bind(c)
      import :: c_char, c_int64_t
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_free_space
    integer(c_int) function castnet_reserve_space(path, from, bytes) bind(c)
      import :: c_char, c_int, c_int64_t
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int64_t), value :: from, bytes
    end function castnet_reserve_space
    integer(c_int) function castnet_release_space(path) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function castnet_release_space
    integer(c_int) function castnet_is_terminal(unit) bind(c)
      import :: c_int
      integer(c_int), value :: unit
    end function castnet_is_terminal
    integer(c_int) function castnet_process() bind(c)
      import :: c_int
    end function castnet_process
    integer(c_int) function castnet_process_alive(id) bind(c)
      import :: c_int
      integer(c_int), value :: id
    end function castnet_process_alive
    integer(c_int64_t) function castnet_process_start(id) bind(c)
      import :: c_int, c_int64_t
      integer(c_int), value :: id
    end function castnet_process_start
    integer(c_int) function castnet_host_name(name, n) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(out) :: name(*)
      integer(c_int), value :: n
    end function castnet_host_name
    real(c_double) function castnet_wall_seconds() bind(c)
      import :: c_double
    end function castnet_wall_seconds
    subroutine castnet_time_stamp(text, n) bind(c)
      import :: c_char, c_int
      character(kind=c_char), intent(out) :: text(*)
      integer(c_int), value :: n
    end subroutine castnet_time_stamp
    integer(c_int64_t) function castnet_physical_memory() bind(c)
      import :: c_int64_t
    end function castnet_physical_memory
    subroutine castnet_default_environment(name, value) bind(c)
      import :: c_char
      character(kind=c_char), intent(in) :: name(*), value(*)
    end subroutine castnet_default_environment
    integer(c_int) function castnet_errno() bind(c)
      import :: c_int
    end function castnet_errno
    subroutine castnet_clear_errno() bind(c)
    end subroutine castnet_clear_errno
    subroutine castnet_error_text(number, text, n) bind(c)
      import :: c_char, c_int
      integer(c_int), value :: number, n
      character(kind=c_char), intent(out) :: text(*)
    end subroutine castnet_error_text
    integer(c_int) function castnet_is_full(number) bind(c)
      import :: c_int
      integer(c_int), value :: number
    end function castnet_is_full
    integer(c_int) function castnet_exists_code() bind(c)
      import :: c_int
    end function castnet_exists_code
  end interface

contains

  !> Create a file that must not exist yet with these bytes, and force it to the disk.
  integer function create_file(path, bytes)
    character(len=*), intent(in) :: path, bytes
    create_file = castnet_create_file(path//c_null_char, bytes, len(bytes, kind=c_int64_t))
  end function create_file

  !> Cut a file to `length` bytes (0 also makes it) and write these behind.
  integer function append_file(path, length, bytes)
    character(len=*), intent(in) :: path, bytes
    integer(i8), intent(in) :: length
    append_file = castnet_append_file(path//c_null_char, int(length, c_int64_t), bytes, len(bytes, kind=c_int64_t))
  end function append_file

  !> All bytes of a file.
  integer function read_file(path, bytes)
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: bytes
    integer(c_int64_t) :: n, done
    integer :: stat
    n = castnet_file_size(path//c_null_char)
    if (n < 0) then
      read_file = int(-n)
      bytes = ''
      return
    end if
    allocate (character(len=n) :: bytes, stat=stat)
    if (stat /= 0) then
      call forget_refusal()
      read_file = 12  ! out of memory, everywhere
      bytes = ''
      return
    end if
    read_file = castnet_read_file(path//c_null_char, bytes, n, done)
    if (done < n) bytes = bytes(1:done)
  end function read_file

  !> Copy a file to a name that must not exist yet.
  integer function copy_file(from, to)
    character(len=*), intent(in) :: from, to
    copy_file = castnet_copy_file(from//c_null_char, to//c_null_char)
  end function copy_file

  !> Force a file or a folder to the disk.
  integer function sync_path(path)
    character(len=*), intent(in) :: path
    sync_path = castnet_sync_path(path//c_null_char)
  end function sync_path

  !> Give a file another name, replacing what had it, in one indivisible act.
  integer function rename_file(from, to)
    character(len=*), intent(in) :: from, to
    rename_file = castnet_rename(from//c_null_char, to//c_null_char)
  end function rename_file

  !> Make a folder, if it is not there; the one that it stands in must be.
  integer function make_folder(path)
    character(len=*), intent(in) :: path
    make_folder = castnet_make_folder(path//c_null_char)
  end function make_folder

  integer function remove_file(path)
    character(len=*), intent(in) :: path
    remove_file = castnet_remove_file(path//c_null_char)
  end function remove_file

  !> Remove a file if it still holds exactly these bytes (at most 1024); not 0 if it does not.
  integer function remove_if_unchanged(path, bytes)
    character(len=*), intent(in) :: path, bytes
    remove_if_unchanged = castnet_remove_if_unchanged(path//c_null_char, bytes, len(bytes, kind=c_int64_t))
  end function remove_if_unchanged

  !> A second name for a file; the name must not exist yet.
  integer function link_file(from, to)
    character(len=*), intent(in) :: from, to
    link_file = castnet_link(from//c_null_char, to//c_null_char)
  end function link_file

  !> What stands at a path: `path_nothing`, `path_file`, `path_folder` or `path_other`.
  integer function path_kind(path)
    character(len=*), intent(in) :: path
    path_kind = castnet_path_kind(path//c_null_char)
    if (path_kind < 0) path_kind = path_other
  end function path_kind

  !> Bytes of a file, negative if there is none.
  integer(i8) function file_size(path)
    character(len=*), intent(in) :: path
    file_size = castnet_file_size(path//c_null_char)
  end function file_size

  !> Are these two names of one existing file?
  logical function same_file(a, b)
    character(len=*), intent(in) :: a, b
    same_file = castnet_same_file(a//c_null_char, b//c_null_char) /= 0
  end function same_file

  !> 0 if this process may write here, else why not.
  integer function may_write(path)
    character(len=*), intent(in) :: path
    may_write = castnet_may_write(path//c_null_char)
  end function may_write

  !> Most characters in the name of a file in this folder, -1 if not known.
  integer function longest_name(folder)
    character(len=*), intent(in) :: folder
    longest_name = castnet_longest_name(folder//c_null_char)
  end function longest_name

  integer function longest_path()
    longest_path = castnet_longest_path()
  end function longest_path

  !> Bytes free for this process where a path is, -1 if not known.
  integer(i8) function free_space(path)
    character(len=*), intent(in) :: path
    free_space = castnet_free_space(path//c_null_char)
  end function free_space

  !> Set aside `bytes` of disk behind byte `from` of a file, size unchanged: later writes
  !> there cannot fail for want of space.
  integer function reserve_space(path, from, bytes)
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: from, bytes
    reserve_space = castnet_reserve_space(path//c_null_char, int(from, c_int64_t), int(bytes, c_int64_t))
  end function reserve_space

  !> Give back what is set aside behind the end of a file.
  integer function release_space(path)
    character(len=*), intent(in) :: path
    release_space = castnet_release_space(path//c_null_char)
  end function release_space

  !> Is this descriptor (1 standard output, 2 standard error) a terminal?
  logical function is_terminal(descriptor)
    integer, intent(in) :: descriptor
    is_terminal = castnet_is_terminal(int(descriptor, c_int)) /= 0
  end function is_terminal

  integer function process_id()
    process_id = castnet_process()
  end function process_id

  logical function process_is_alive(id)
    integer, intent(in) :: id
    process_is_alive = castnet_process_alive(int(id, c_int)) /= 0
  end function process_is_alive

  !> When a process of this machine started (ticks since the machine did), -1 if not known.
  integer(i8) function process_start(id)
    integer, intent(in) :: id
    process_start = castnet_process_start(int(id, c_int))
  end function process_start

  function host_name() result(name)
    character(len=:), allocatable :: name
    character(len=256) :: buffer
    if (castnet_host_name(buffer, int(len(buffer), c_int)) /= 0) buffer = 'unknown'//c_null_char
    name = until_zero(buffer)
  end function host_name

  !> Seconds of a clock that never jumps; only differences mean something.
  real(wp) function wall_seconds()
    wall_seconds = castnet_wall_seconds()
  end function wall_seconds

  !> Now, ISO 8601, UTC.
  function time_stamp() result(text)
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    call castnet_time_stamp(buffer, int(len(buffer), c_int))
    text = until_zero(buffer)
  end function time_stamp

  !> Memory of the machine, or the limit of this process or of its job if that is less [bytes].
  integer(i8) function physical_memory()
    physical_memory = castnet_physical_memory()
  end function physical_memory

  !> Set a variable of the environment unless the user has.
  subroutine default_environment(name, value)
    character(len=*), intent(in) :: name, value
    call castnet_default_environment(name//c_null_char, value//c_null_char)
  end subroutine default_environment

  !> Number of the last system call that failed in this thread.
  integer function system_error()
    system_error = castnet_errno()
  end function system_error

  subroutine clear_system_error()
    call castnet_clear_errno()
  end subroutine clear_system_error

  !> A system error number in words.
  function system_words(number) result(words)
    integer, intent(in) :: number
    character(len=:), allocatable :: words
    character(len=256) :: buffer
    call castnet_error_text(int(number, c_int), buffer, int(len(buffer), c_int))
    words = until_zero(buffer)
  end function system_words

  !> Does this number mean that no space is left (disk, quota, file size limit)?
  logical function is_disk_full(number)
    integer, intent(in) :: number
    is_disk_full = castnet_is_full(int(number, c_int)) /= 0
  end function is_disk_full

  !> Does this number mean that the name is taken?
  logical function is_existing(number)
    integer, intent(in) :: number
    is_existing = number == castnet_exists_code()
  end function is_existing

  !> Raise exit_file: what was being done, on which path, the system's words, what to do.
  subroutine file_failure(error, number, doing, path, advice)
    type(error_t), allocatable, intent(inout) :: error
    integer, intent(in) :: number                      !! system error number
    character(len=*), intent(in) :: doing, path        !! 'cannot write the checkpoint', its path
    character(len=*), intent(in), optional :: advice   !! what to do; the full disk's is known here
    character(len=:), allocatable :: text
    text = doing//" '"//path//"': "//system_words(number)
    if (is_disk_full(number)) then
      text = text//'; free disk space or choose another folder with --output'
    else if (present(advice)) then
      text = text//'; '//advice
    end if
    call fail(error, exit_file, text)
  end subroutine file_failure

  function until_zero(buffer) result(text)
    character(len=*), intent(in) :: buffer
    character(len=:), allocatable :: text
    integer :: zero
    zero = index(buffer, c_null_char)
    if (zero == 0) zero = len(buffer) + 1
    text = buffer(1:zero - 1)
  end function until_zero

end module castnet_posix
