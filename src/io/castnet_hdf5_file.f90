!> Thin verbs over HDF5, for everything that castnet writes or reads in that format.
!>
!> Files keep the default format bound, because only they can be opened after a kill.
!> Shapes are Fortran's in the arguments (first index fastest), so Python sees them
!> reversed. HDF5 is not thread-safe here: one thread at a time may be in this module.
!>
!> A call that fails marks its file broken, and nothing more is asked of HDF5 for it: the
!> library's own clean-up after a full disk may write, loop or abort. For the same reason
!> its clean-up at exit is switched off; a file is complete when `close_file` says so, and
!> otherwise stays as its last flush left it.
module castnet_hdf5_file
  use, intrinsic :: iso_c_binding, only: c_loc, c_ptr, c_int, c_null_char
  use hdf5, only: hid_t, hsize_t, size_t, h5open_f, h5dont_atexit_f, h5eset_auto_f, h5fcreate_f, h5fopen_f, h5fclose_f, &
                  h5fflush_f, h5fget_filesize_f, h5fis_hdf5_f, h5gcreate_f, h5gopen_f, h5gclose_f, h5gget_info_f, &
                  h5screate_simple_f, h5iinc_ref_f, h5idec_ref_f, &
                  h5screate_f, h5sclose_f, h5dcreate_f, h5dopen_f, h5dclose_f, h5dwrite_f, h5acreate_f, &
                  h5awrite_f, h5aclose_f, h5aopen_f, h5aexists_f, h5tcopy_f, h5tclose_f, h5tset_size_f, h5tset_cset_f, &
                  h5tset_strpad_f, h5ldelete_f, h5lexists_f, h5lmove_f, h5lcreate_soft_f, h5lcreate_hard_f, h5t_string, &
                  h5t_fortran_s1, h5t_cset_utf8_f, &
                  h5t_str_nullpad_f, h5lget_name_by_idx_f, h5p_group_create_f, h5pset_link_creation_order_f, &
                  h5pset_link_phase_change_f, h5pset_est_link_info_f, h5p_crt_order_tracked_f, h5_index_name_f, h5_iter_inc_f, &
                  h5t_native_double, h5t_native_real, h5t_native_integer, h5t_std_i32le, &
                  h5t_std_i64le, h5t_ieee_f64le, h5t_ieee_f32le, h5f_acc_trunc_f, h5f_acc_rdonly_f, h5f_acc_rdwr_f, &
                  h5f_scope_local_f, h5s_scalar_f, h5pcreate_f, h5pclose_f, h5p_file_access_f, h5p_dataset_xfer_f, &
                  h5pset_buffer_f, h5pset_btree_ratios_f, h5pset_cache_f, h5kind_to_type, h5_integer_kind
  use h5ds, only: h5dsset_scale_f
  use castnet_kinds, only: wp, sp, i4, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_posix, only: clear_system_error, system_error, system_words, is_disk_full, default_environment
  implicit none
  private
  public :: hdf5_file_t, location_t, check, joined, transfer_plan, keep_open, let_go
  public :: start_hdf5, create_hdf5, open_hdf5, flush_file, close_file, file_bytes, is_hdf5
  public :: make_group, open_group, close_group, empty_group, has_entry, remove_entry, rename_entry, link_entry, name_again
  public :: write_text, write_short_text, write_value, write_array, set_attribute, set_fixed_text
  public :: make_scale, attach_scales, tell_scales
  public :: most_rank, kind_double, kind_single, kind_integer, kind_long, memory_type, file_type, value_bytes

  integer, parameter :: kind_double = 1, kind_single = 2, kind_integer = 3, kind_long = 4

  !> Bytes for texts on their way to the file. The library's own choice is two buffers of
  !> 1 MiB, cleared at every text: a third of the processor time of a short run.
  integer(hsize_t), parameter :: conversion_buffer = 4096_hsize_t

  !> Bytes of a text that may change while others read the file.
  integer, parameter :: short_text = 32

  integer, parameter :: most_rank = 4             !! of a series

  !> A place in a file: the file itself or a group.
  type :: location_t
    integer(hid_t) :: id = -1
    character(len=:), allocatable :: name       !! for messages
  end type location_t

  integer, parameter :: longest_scale = 64        !! longer names are looked up in the file

  !> A dimension scale that this run has made.
  type :: scale_t
    character(len=longest_scale) :: name = ''   !! path from the root
    integer(i8) :: reference = 0
    integer(hid_t) :: id = -1                   !! held open until it is told who uses it
  end type scale_t

  !> A dataset's dimension along a scale, of which the scale is still to be told.
  type :: use_of_scale_t
    integer(i8) :: scale = 0, dataset = 0       !! references
    integer(c_int) :: dimension = 0             !! in C's order, from 0
  end type use_of_scale_t

  type :: hdf5_file_t
    type(location_t) :: root
    character(len=:), allocatable :: path
    logical :: is_open = .false.
    logical :: broken = .false.                 !! a call has failed
    type(scale_t), allocatable :: scales(:)     !! the first n_scale
    type(use_of_scale_t), allocatable :: uses(:) !! the first n_use
    integer :: n_scale = 0, n_use = 0
    integer(hid_t) :: transfer = -1             !! plan of all writing
    integer(hid_t) :: series_plan = -1          !! plan of the series that was made last
    integer :: series_kind = 0                  !! its kind
    integer(hsize_t) :: series_chunk(most_rank) = 0 !! and chunk, 0 behind its rank
    integer(hid_t) :: text = -1                 !! type of a text of variable length
    integer(hid_t) :: recent = -1               !! dataset that was made last, still open
    character(len=:), allocatable :: recent_name !! path from the root
    logical :: recent_is_ours = .false.         !! to be closed here
  end type hdf5_file_t

  interface
    integer(c_int) function castnet_use_safe_driver(access) bind(c)
      import :: c_int, hid_t
      integer(hid_t), value :: access
    end function castnet_use_safe_driver
    integer(i8) function castnet_reference(object) bind(c)
      import :: i8, hid_t
      integer(hid_t), value :: object
    end function castnet_reference
    integer(c_int) function castnet_name_dimensions(dataset, rank, scale) bind(c)
      import :: c_int, hid_t, i8
      integer(hid_t), value :: dataset
      integer(c_int), value :: rank
      integer(i8), intent(in) :: scale(*)
    end function castnet_name_dimensions
    integer(c_int) function castnet_refer_back(file, scale, open, n, dataset, dimension) bind(c)
      import :: c_int, hid_t, i8
      integer(hid_t), value :: file, open
      integer(i8), value :: scale
      integer(c_int), value :: n
      integer(i8), intent(in) :: dataset(*)
      integer(c_int), intent(in) :: dimension(*)
    end function castnet_refer_back
  end interface

  !> A number by its kind; of rank 0.
  interface write_value
    module procedure write_double, write_integer, write_long
  end interface write_value

  !> A whole array of fixed size.
  interface write_array
    module procedure write_doubles_1, write_doubles_2, write_singles_2, write_integers_1, write_integers_2, write_longs_1, &
      write_texts
  end interface write_array

  !> An attribute of a dataset or group, new or of the same kind and shape as before.
  interface set_attribute
    module procedure set_text, set_double, set_long, set_longs, set_text_of
  end interface set_attribute

contains

  !> Start the library once; later calls cost one comparison. Its own printing of errors
  !> and its work at exit are switched off. File locks of HDF5 are off unless the user has
  !> set HDF5_USE_FILE_LOCKING: our own lock keeps two writers apart, and a reader may then
  !> look into a run that is going on.
  subroutine start_hdf5()
    integer :: status
    if (h5t_native_double > 0) return
    call default_environment('HDF5_USE_FILE_LOCKING', 'FALSE')
    call h5dont_atexit_f(status)
    call h5open_f(status)
    call h5eset_auto_f(0, status)
  end subroutine start_hdf5

  !> Turn a failed call into an error_t, with the system's reason when it has one.
  subroutine check(file, status, doing, name, error)
    type(hdf5_file_t), intent(inout) :: file
    integer, intent(in) :: status                   !! of the HDF5 call, negative: failed
    character(len=*), intent(in) :: doing, name     !! 'write', the dataset
    type(error_t), allocatable, intent(inout) :: error
    integer :: number
    character(len=:), allocatable :: text
    if (status >= 0) return
    number = system_error()
    file%broken = .true.
    text = "cannot "//doing
    if (len(name) > 0) text = text//" '"//name//"'"
    text = text//" in '"//file%path//"'"
    if (number /= 0) text = text//': '//system_words(number)
    if (is_disk_full(number)) then
      text = text//'; free disk space or choose another folder with --output'
    else
      text = text//'; check that the disk is there, writable and not full'
    end if
    call fail(error, exit_file, text)
  end subroutine check

  ! ---- files and groups ---------------------------------------------------------

  !> Create a file, replacing one of the same name.
  subroutine create_hdf5(file, path, error)
    type(hdf5_file_t), intent(out) :: file
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: access
    integer :: status, ignored
    call begin_file(file, path)
    call safe_access(access, status)
    if (status >= 0) call h5fcreate_f(path, h5f_acc_trunc_f, file%root%id, status, access_prp=access)
    call check(file, status, 'create the file', '', error)
    call h5pclose_f(access, ignored)
    file%is_open = status >= 0
  end subroutine create_hdf5

  !> Open a file that is there, to read or to go on writing.
  subroutine open_hdf5(file, path, writable, error)
    type(hdf5_file_t), intent(out) :: file
    character(len=*), intent(in) :: path
    logical, intent(in) :: writable
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: access
    integer :: status, ignored
    call begin_file(file, path)
    if (writable) then
      call safe_access(access, status)
      if (status >= 0) call h5fopen_f(path, h5f_acc_rdwr_f, file%root%id, status, access_prp=access)
      call h5pclose_f(access, ignored)
    else
      call h5fopen_f(path, h5f_acc_rdonly_f, file%root%id, status)
    end if
    call check(file, status, 'open the file', '', error)
    file%is_open = status >= 0
  end subroutine open_hdf5

  !> Writers use the driver that keeps the file whole at every moment.
  subroutine safe_access(access, status)
    integer(hid_t), intent(out) :: access
    integer, intent(out) :: status
    call h5pcreate_f(h5p_file_access_f, access, status)
    ! No cache of chunks: a frame is written once and not read again, and every flush would go
    ! through all chunks that a cache holds, and write those whole that a number was added to.
    if (status >= 0) call h5pset_cache_f(access, 0, 0_size_t, 0_size_t, 0.0, status)
    if (status >= 0) status = castnet_use_safe_driver(access)
  end subroutine safe_access

  subroutine begin_file(file, path)
    type(hdf5_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path
    call start_hdf5()
    call clear_system_error()
    file%path = path
    file%root%name = '/'
  end subroutine begin_file

  !> Is this an HDF5 file?
  logical function is_hdf5(path)
    character(len=*), intent(in) :: path
    integer :: status
    call start_hdf5()
    call h5fis_hdf5_f(path, is_hdf5, status)
    if (status < 0) is_hdf5 = .false.
  end function is_hdf5

  !> Everything written so far goes to the operating system: from here on a kill cannot
  !> take it away.
  subroutine flush_file(file, error)
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    call let_go(file)
    call tell_scales(file, error)
    if (file%broken .or. .not. file%is_open) return
    call clear_system_error()
    call h5fflush_f(file%root%id, h5f_scope_local_f, status)
    call check(file, status, 'flush', '', error)
  end subroutine flush_file

  !> Close a file. A broken one is left to the operating system.
  subroutine close_file(file, error)
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    if (.not. file%is_open) return
    call let_go(file)
    call tell_scales(file, error)
    file%is_open = .false.
    if (file%broken) return
    if (file%transfer >= 0) call h5pclose_f(file%transfer, status)
    if (file%text >= 0) call h5tclose_f(file%text, status)
    if (file%series_plan >= 0) call h5pclose_f(file%series_plan, status)
    file%transfer = -1
    file%text = -1
    file%series_plan = -1
    call clear_system_error()
    call h5fclose_f(file%root%id, status)
    call check(file, status, 'close the file', '', error)
  end subroutine close_file

  !> Bytes of the file as HDF5 sees it, what is not yet flushed included.
  integer(i8) function file_bytes(file)
    type(hdf5_file_t), intent(in) :: file
    integer(hsize_t) :: bytes
    integer :: status
    call h5fget_filesize_f(file%root%id, bytes, status)
    file_bytes = merge(int(bytes, i8), 0_i8, status >= 0)
  end function file_bytes

  !> Create a group. With `entries` it is made to grow to about so many while others read the
  !> file: its links stand in its header, which has room for them (castnet_safe_driver.c).
  subroutine make_group(file, parent, name, group, error, entries)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    type(location_t), intent(out) :: group
    type(error_t), allocatable, intent(inout) :: error
    integer, intent(in), optional :: entries
    integer, parameter :: usual_name = 20, most_links = 65535
    integer(hid_t) :: plan
    integer :: status, ignored
    if (file%broken) return
    group%name = joined(parent, name)
    if (present(entries)) then
      call h5pcreate_f(h5p_group_create_f, plan, status)
      if (status >= 0) call h5pset_link_creation_order_f(plan, h5p_crt_order_tracked_f, status)
      if (status >= 0) call h5pset_link_phase_change_f(plan, most_links, 0, status)
      if (status >= 0) call h5pset_est_link_info_f(plan, entries, usual_name, status)
      if (status >= 0) call h5gcreate_f(parent%id, name, group%id, status, gcpl_id=plan)
      call h5pclose_f(plan, ignored)
    else
      call h5gcreate_f(parent%id, name, group%id, status)
    end if
    call check(file, status, 'create the group', group%name, error)
  end subroutine make_group

  subroutine open_group(file, parent, name, group, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    type(location_t), intent(out) :: group
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    if (file%broken) return
    group%name = joined(parent, name)
    call h5gopen_f(parent%id, name, group%id, status)
    call check(file, status, 'open the group', group%name, error)
  end subroutine open_group

  subroutine close_group(file, group)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(inout) :: group
    integer :: status
    if (file%broken .or. group%id < 0) return
    call h5gclose_f(group%id, status)
    group%id = -1
  end subroutine close_group

  !> Remove everything that a group holds, not its attributes.
  subroutine empty_group(file, group, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(error_t), allocatable, intent(inout) :: error
    character(len=256) :: name
    integer :: status, kind, n_link, largest, i
    if (file%broken) return
    call let_go(file)
    call h5gget_info_f(group%id, kind, n_link, largest, status)
    do i = 1, n_link
      if (status >= 0) call h5lget_name_by_idx_f(group%id, '.', h5_index_name_f, h5_iter_inc_f, 0_hsize_t, name, status)
      if (status >= 0) call h5ldelete_f(group%id, trim(name), status)
    end do
    call check(file, status, 'empty the group', group%name, error)
  end subroutine empty_group

  !> Is there a dataset or group of this name right here?
  logical function has_entry(parent, name)
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer :: status
    call h5lexists_f(parent%id, name, has_entry, status)
    if (status < 0) has_entry = .false.
  end function has_entry

  !> Remove a dataset, group or link. What it leads to goes with it if nothing else leads there.
  subroutine remove_entry(file, parent, name, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    if (file%broken) return
    call let_go(file)
    call h5ldelete_f(parent%id, name, status)
    call check(file, status, 'remove', joined(parent, name), error)
  end subroutine remove_entry

  subroutine rename_entry(file, parent, old, new, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: old, new
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    if (file%broken) return
    call let_go(file)
    call h5lmove_f(parent%id, old, parent%id, new, status)
    call check(file, status, 'rename', joined(parent, old), error)
  end subroutine rename_entry

  !> A soft link, a second name for what stands beside it.
  subroutine link_entry(file, parent, name, link, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, link      !! what is there; the new name
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    if (file%broken) return
    call h5lcreate_soft_f(name, parent%id, link, status)
    call check(file, status, 'link', joined(parent, link), error)
  end subroutine link_entry

  !> A second name that is as good as the first.
  subroutine name_again(file, parent, name, second, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, second
    type(error_t), allocatable, intent(inout) :: error
    integer :: status
    if (file%broken) return
    call h5lcreate_hard_f(parent%id, name, parent%id, second, status)
    call check(file, status, 'link', joined(parent, second), error)
  end subroutine name_again

  pure function joined(parent, name) result(path)
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: path
    if (parent%name == '/') then
      path = '/'//name
    else
      path = parent%name//'/'//name
    end if
  end function joined

  ! ---- datasets of fixed size -----------------------------------------------------

  integer(hid_t) function memory_type(kind)
    integer, intent(in) :: kind
    select case (kind)
    case (kind_double)
      memory_type = h5t_native_double
    case (kind_single)
      memory_type = h5t_native_real
    case (kind_integer)
      memory_type = h5t_native_integer
    case default
      memory_type = h5kind_to_type(i8, h5_integer_kind)
    end select
  end function memory_type

  integer(hid_t) function file_type(kind)
    integer, intent(in) :: kind
    select case (kind)
    case (kind_double)
      file_type = h5t_ieee_f64le
    case (kind_single)
      file_type = h5t_ieee_f32le
    case (kind_integer)
      file_type = h5t_std_i32le
    case default
      file_type = h5t_std_i64le
    end select
  end function file_type

  pure integer(i8) function value_bytes(kind)
    integer, intent(in) :: kind
    value_bytes = merge(8_i8, 4_i8, kind == kind_double .or. kind == kind_long)
  end function value_bytes

  !> Create a dataset of these types, write one buffer, set its units, close it.
  subroutine put(file, parent, name, memory, stored, shape, buffer, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer(hid_t), intent(in) :: memory, stored
    integer(hsize_t), intent(in) :: shape(:)          !! empty for a scalar
    type(c_ptr), intent(in) :: buffer
    character(len=*), intent(in), optional :: units
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: space, dataset
    integer :: status, ignored
    if (file%broken) return
    call clear_system_error()
    if (size(shape) == 0) then
      call h5screate_f(h5s_scalar_f, space, status)
    else
      call h5screate_simple_f(size(shape), shape, space, status)
    end if
    if (status >= 0) call h5dcreate_f(parent%id, name, stored, space, dataset, status)
    call check(file, status, 'create', joined(parent, name), error)
    if (status < 0) return
    call keep_open(file, dataset, joined(parent, name), .true.)
    call h5dwrite_f(dataset, memory, buffer, status, xfer_prp=transfer_plan(file))
    call check(file, status, 'write', joined(parent, name), error)
    if (present(units)) call set_text(file, dataset, 'units', units, error)
    if (file%broken) return
    call h5sclose_f(space, ignored)
  end subroutine put

  !> How values go to the file, one plan for all: to make one costs as much as to write a
  !> number. A full node of the tree of chunks keeps all that it can when it is split: what
  !> moves out of it is out of sight of who reads the file with the old tree in mind.
  integer(hid_t) function transfer_plan(file)
    type(hdf5_file_t), intent(inout) :: file
    integer :: status
    if (file%transfer < 0) then
      call h5pcreate_f(h5p_dataset_xfer_f, file%transfer, status)
      if (status >= 0) call h5pset_buffer_f(file%transfer, conversion_buffer, status)
      if (status >= 0) call h5pset_btree_ratios_f(file%transfer, 0.1, 0.5, 1.0, status)
    end if
    transfer_plan = file%transfer
  end function transfer_plan

  !> The dataset that was made last stays open: its dimensions are named next, and to open it
  !> again costs half as much as to make it.
  subroutine keep_open(file, dataset, name, ours)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: dataset
    character(len=*), intent(in) :: name     !! path from the root
    logical, intent(in) :: ours              !! nobody else closes it
    call let_go(file)
    file%recent = dataset
    file%recent_name = name
    file%recent_is_ours = ours
  end subroutine keep_open

  !> Close the dataset that was made last.
  subroutine let_go(file)
    type(hdf5_file_t), intent(inout) :: file
    integer :: ignored
    if (file%recent >= 0 .and. file%recent_is_ours .and. .not. file%broken) call h5dclose_f(file%recent, ignored)
    file%recent = -1
  end subroutine let_go

  !> Open a dataset, or take the one that is open.
  subroutine open_dataset(file, parent, name, dataset, status)
    type(hdf5_file_t), intent(in) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer(hid_t), intent(out) :: dataset
    integer, intent(out) :: status
    status = 0
    dataset = file%recent
    if (file%recent >= 0) then
      if (file%recent_name == joined(parent, name)) return
    end if
    call h5dopen_f(parent%id, name, dataset, status)
  end subroutine open_dataset

  !> Close it unless it stays open.
  subroutine close_dataset(file, dataset)
    type(hdf5_file_t), intent(in) :: file
    integer(hid_t), intent(in) :: dataset
    integer :: ignored
    if (dataset /= file%recent) call h5dclose_f(dataset, ignored)
  end subroutine close_dataset

  !> A text of any length (attributes end at 64 KB, datasets do not), UTF-8.
  subroutine write_text(file, parent, name, text, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, text
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable, target :: buffer
    type(c_ptr), target :: pointer_to_text
    integer(hid_t) :: text_type
    if (file%broken) return
    buffer = text//c_null_char
    pointer_to_text = c_loc(buffer)
    text_type = text_type_of(file)
    call put(file, parent, name, text_type, text_type, [integer(hsize_t) ::], c_loc(pointer_to_text), error=error)
  end subroutine write_text

  !> A text of at most 32 bytes, new or in the place of the one before: others may read the
  !> file meanwhile. A text of variable length would be put somewhere else.
  subroutine write_short_text(file, parent, name, text, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, text
    type(error_t), allocatable, intent(inout) :: error
    character(len=short_text), target :: buffer
    integer(hid_t) :: text_type, dataset
    integer :: status, ignored
    if (file%broken) return
    buffer = text//repeat(c_null_char, short_text)
    text_type = fixed_text_type(short_text)
    call h5tset_cset_f(text_type, h5t_cset_utf8_f, ignored)
    if (has_entry(parent, name)) then
      call h5dopen_f(parent%id, name, dataset, status)
      if (status >= 0) call h5dwrite_f(dataset, text_type, c_loc(buffer), status)
      call check(file, status, 'write', joined(parent, name), error)
      if (status >= 0) call h5dclose_f(dataset, ignored)
    else
      call put(file, parent, name, text_type, text_type, [integer(hsize_t) ::], c_loc(buffer), error=error)
      ! Without it xarray takes a text of fixed length for bytes.
      call set_attribute(file, parent, name, '_Encoding', 'utf-8', error)
    end if
    call free_type(text_type)
  end subroutine write_short_text

  !> Type of a text of fixed length, ASCII.
  integer(hid_t) function fixed_text_type(length)
    integer, intent(in) :: length
    integer :: status
    call h5tcopy_f(h5t_fortran_s1, fixed_text_type, status)
    call h5tset_size_f(fixed_text_type, int(length, size_t), status)
    call h5tset_strpad_f(fixed_text_type, h5t_str_nullpad_f, status)
  end function fixed_text_type

  !> Type of a text of variable length.
  integer(hid_t) function text_type_of(file)
    type(hdf5_file_t), intent(inout) :: file
    integer :: status
    if (file%text < 0) then
      call h5tcopy_f(h5t_string, file%text, status)
      call h5tset_cset_f(file%text, h5t_cset_utf8_f, status)
    end if
    text_type_of = file%text
  end function text_type_of

  subroutine free_type(id)
    integer(hid_t), intent(in) :: id
    integer :: status
    call h5tclose_f(id, status)
  end subroutine free_type

  !> Short texts as a one-dimensional dataset; trailing blanks are dropped.
  subroutine write_texts(file, parent, name, texts, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    character(len=*), intent(in) :: texts(:)
    type(error_t), allocatable, intent(inout) :: error
    character(len=len(texts) + 1), allocatable, target :: buffer(:)
    type(c_ptr), allocatable, target :: pointers(:)
    integer(hid_t) :: text_type
    integer :: i
    if (file%broken) return
    allocate (buffer(size(texts)), pointers(size(texts)))
    do i = 1, size(texts)
      buffer(i) = trim(texts(i))//c_null_char
      pointers(i) = c_loc(buffer(i))
    end do
    text_type = text_type_of(file)
    call put(file, parent, name, text_type, text_type, [size(texts, kind=hsize_t)], c_loc(pointers), error=error)
  end subroutine write_texts

  subroutine write_double(file, parent, name, value, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    real(wp), intent(in), target :: value
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_double), file_type(kind_double), [integer(hsize_t) ::], c_loc(value), &
             units, error)
  end subroutine write_double

  subroutine write_integer(file, parent, name, value, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    integer(i4), intent(in), target :: value
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_integer), file_type(kind_integer), [integer(hsize_t) ::], c_loc(value), &
             units, error)
  end subroutine write_integer

  subroutine write_long(file, parent, name, value, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    integer(i8), intent(in), target :: value
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_long), file_type(kind_long), [integer(hsize_t) ::], c_loc(value), &
             units, error)
  end subroutine write_long

  subroutine write_doubles_1(file, parent, name, values, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    real(wp), intent(in), target, contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_double), file_type(kind_double), shape(values, kind=hsize_t), &
             c_loc(values), units, error)
  end subroutine write_doubles_1

  subroutine write_doubles_2(file, parent, name, values, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    real(wp), intent(in), target, contiguous :: values(:, :)
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_double), file_type(kind_double), shape(values, kind=hsize_t), &
             c_loc(values), units, error)
  end subroutine write_doubles_2

  subroutine write_singles_2(file, parent, name, values, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    real(sp), intent(in), target, contiguous :: values(:, :)
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_single), file_type(kind_single), shape(values, kind=hsize_t), &
             c_loc(values), units, error)
  end subroutine write_singles_2

  subroutine write_integers_1(file, parent, name, values, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    integer(i4), intent(in), target, contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_integer), file_type(kind_integer), shape(values, kind=hsize_t), &
             c_loc(values), units, error)
  end subroutine write_integers_1

  subroutine write_integers_2(file, parent, name, values, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    integer(i4), intent(in), target, contiguous :: values(:, :)
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_integer), file_type(kind_integer), shape(values, kind=hsize_t), &
             c_loc(values), units, error)
  end subroutine write_integers_2

  subroutine write_longs_1(file, parent, name, values, units, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units
    integer(i8), intent(in), target, contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    call put(file, parent, name, memory_type(kind_long), file_type(kind_long), shape(values, kind=hsize_t), &
             c_loc(values), units, error)
  end subroutine write_longs_1

  ! ---- attributes and dimension scales --------------------------------------------

  !> Write one buffer to an attribute, which is created or else has this type and shape.
  subroutine put_attribute(file, object, name, memory, stored, shape, buffer, error)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: object, memory, stored
    character(len=*), intent(in) :: name
    integer(hsize_t), intent(in) :: shape(:)
    type(c_ptr), intent(in) :: buffer
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: space, attribute
    integer :: status, ignored
    logical :: there
    if (file%broken) return
    call clear_system_error()
    call h5aexists_f(object, name, there, status)
    space = -1
    if (status >= 0 .and. there) then
      call h5aopen_f(object, name, attribute, status)
    else if (status >= 0) then
      if (size(shape) == 0) then
        call h5screate_f(h5s_scalar_f, space, status)
      else
        call h5screate_simple_f(size(shape), shape, space, status)
      end if
      if (status >= 0) call h5acreate_f(object, name, stored, space, attribute, status)
    end if
    call check(file, status, 'create the attribute', name, error)
    if (status < 0) return
    call h5awrite_f(attribute, memory, buffer, status)
    call check(file, status, 'write the attribute', name, error)
    if (file%broken) return
    call h5aclose_f(attribute, ignored)
    if (space >= 0) call h5sclose_f(space, ignored)
  end subroutine put_attribute

  !> A text attribute that Python reads as str.
  subroutine set_text(file, object, name, text, error)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name, text
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable, target :: buffer
    type(c_ptr), target :: pointer_to_text
    integer(hid_t) :: text_type
    if (file%broken) return
    buffer = text//c_null_char
    pointer_to_text = c_loc(buffer)
    text_type = text_type_of(file)
    call put_attribute(file, object, name, text_type, text_type, [integer(hsize_t) ::], c_loc(pointer_to_text), error)
  end subroutine set_text

  !> A text attribute of fixed length, ASCII, as VTK wants its `Type`.
  subroutine set_fixed_text(file, object, name, text, error)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    character(len=*), intent(in), target :: text
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: text_type
    if (file%broken) return
    text_type = fixed_text_type(len(text))
    call put_attribute(file, object, name, text_type, text_type, [integer(hsize_t) ::], c_loc(text), error)
    call free_type(text_type)
  end subroutine set_fixed_text

  subroutine set_double(file, object, name, value, error)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    real(wp), intent(in), target :: value
    type(error_t), allocatable, intent(inout) :: error
    call put_attribute(file, object, name, memory_type(kind_double), file_type(kind_double), [integer(hsize_t) ::], &
                       c_loc(value), error)
  end subroutine set_double

  subroutine set_long(file, object, name, value, error)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(i8), intent(in), target :: value
    type(error_t), allocatable, intent(inout) :: error
    call put_attribute(file, object, name, memory_type(kind_long), file_type(kind_long), [integer(hsize_t) ::], &
                       c_loc(value), error)
  end subroutine set_long

  subroutine set_longs(file, object, name, values, error)
    type(hdf5_file_t), intent(inout) :: file
    integer(hid_t), intent(in) :: object
    character(len=*), intent(in) :: name
    integer(i8), intent(in), target, contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    call put_attribute(file, object, name, memory_type(kind_long), file_type(kind_long), shape(values, kind=hsize_t), &
                       c_loc(values), error)
  end subroutine set_longs

  !> An attribute on a dataset named by its place.
  subroutine set_text_of(file, parent, dataset, name, text, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: dataset, name, text
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: id
    integer :: status
    if (file%broken) return
    call open_dataset(file, parent, dataset, id, status)
    call check(file, status, 'open', joined(parent, dataset), error)
    if (status < 0) return
    call set_text(file, id, name, text, error)
    if (.not. file%broken) call close_dataset(file, id)
  end subroutine set_text_of

  !> Make a one-dimensional dataset the scale of a dimension of its own name.
  subroutine make_scale(file, parent, name, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: id
    integer :: status, holders
    type(scale_t) :: scale
    if (file%broken) return
    call open_dataset(file, parent, name, id, status)
    if (status >= 0) call h5dsset_scale_f(id, status, name)
    call check(file, status, 'make a dimension scale of', joined(parent, name), error)
    if (status < 0) return
    scale%name = joined(parent, name)
    scale%reference = castnet_reference(id)
    if (len(joined(parent, name)) <= longest_scale) then
      call h5iinc_ref_f(id, holders, status)
      if (status >= 0) scale%id = id
    end if
    call close_dataset(file, id)
    if (len(joined(parent, name)) > longest_scale) return
    if (.not. allocated(file%scales)) allocate (file%scales(8))
    if (file%n_scale == size(file%scales)) file%scales = [file%scales, file%scales]
    file%n_scale = file%n_scale + 1
    file%scales(file%n_scale) = scale
  end subroutine make_scale

  !> Name the dimensions of a dataset, in Fortran's order, by scales beside it or given by
  !> their path from the root ('/xyz'). The scales are told at the next flush, all at once.
  subroutine attach_scales(file, parent, dataset, scales, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: dataset
    character(len=*), intent(in) :: scales(:)
    type(error_t), allocatable, intent(inout) :: error
    type(use_of_scale_t) :: one
    integer(i8) :: reference(size(scales))
    integer(hid_t) :: id
    integer :: status, i, n
    if (file%broken) return
    n = size(scales)
    call open_dataset(file, parent, dataset, id, status)
    call check(file, status, 'open', joined(parent, dataset), error)
    if (status < 0) return
    do i = 1, n
      ! here dimensions count in C's order
      reference(n + 1 - i) = scale_reference(file, parent, trim(scales(i)))
    end do
    status = castnet_name_dimensions(id, n, reference)
    if (any(reference == 0)) status = -1
    call check(file, status, 'name the dimensions of', joined(parent, dataset), error)
    if (status < 0) return
    one%dataset = castnet_reference(id)
    call close_dataset(file, id)
    if (.not. allocated(file%uses)) allocate (file%uses(64))
    do i = 1, n
      one%scale = reference(i)
      one%dimension = i - 1
      if (file%n_use == size(file%uses)) file%uses = [file%uses, file%uses]
      file%n_use = file%n_use + 1
      file%uses(file%n_use) = one
    end do
  end subroutine attach_scales

  !> Of a scale beside a dataset or, with a '/' in front, anywhere; 0: there is none.
  integer(i8) function scale_reference(file, parent, name) result(reference)
    type(hdf5_file_t), intent(in) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: path
    integer(hid_t) :: id
    integer :: status, i
    path = name
    if (name(1:1) /= '/') path = joined(parent, name)
    do i = 1, file%n_scale
      if (file%scales(i)%name /= path) cycle
      reference = file%scales(i)%reference
      return
    end do
    reference = 0
    call h5dopen_f(parent%id, name, id, status)
    if (status < 0) return
    reference = castnet_reference(id)
    call h5dclose_f(id, status)
  end function scale_reference

  !> Tell every scale which datasets have come to use it, and let go of it.
  subroutine tell_scales(file, error)
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer :: i, holders, status
    if (file%n_use > 0) call tell_uses(file, error)
    if (file%broken) return
    do i = 1, file%n_scale
      if (file%scales(i)%id < 0) cycle
      call h5idec_ref_f(file%scales(i)%id, holders, status)
      file%scales(i)%id = -1
    end do
  end subroutine tell_scales

  !> One list a scale.
  subroutine tell_uses(file, error)
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer(i8), allocatable :: dataset(:)
    integer(c_int), allocatable :: dimension(:)
    logical, allocatable :: told(:), mine(:)
    integer(hid_t) :: id
    integer :: i, k, status
    if (file%broken) return
    associate (uses => file%uses(:file%n_use))
      allocate (told(size(uses)), source=.false.)
      do i = 1, size(uses)
        if (told(i)) cycle
        mine = uses%scale == uses(i)%scale
        dataset = pack(uses%dataset, mine)
        dimension = pack(uses%dimension, mine)
        told = told .or. mine
        id = -1
        do k = 1, file%n_scale
          if (file%scales(k)%reference == uses(i)%scale) id = file%scales(k)%id
        end do
        status = castnet_refer_back(file%root%id, uses(i)%scale, id, size(dataset), dataset, dimension)
        call check(file, status, 'complete a dimension scale', '', error)
        if (status < 0) return
      end do
    end associate
    file%n_use = 0
  end subroutine tell_uses

end module castnet_hdf5_file
