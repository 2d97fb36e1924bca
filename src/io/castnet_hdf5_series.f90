!> Datasets of an HDF5 file that grow along one dimension, a frame or a block at a time.
!> The growing dimension is Fortran's last, Python's first. Frames may be held in memory
!> and written many at once: a call of HDF5 costs as much as some kilobytes of values.
module castnet_hdf5_series
  use, intrinsic :: iso_c_binding, only: c_loc, c_ptr, c_f_pointer, c_int8_t
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use hdf5, only: hid_t, hsize_t, h5screate_simple_f, h5sclose_f, h5sselect_hyperslab_f, h5pcreate_f, h5pset_chunk_f, &
                  h5pset_fill_value_f, h5pset_fill_time_f, h5d_fill_time_never_f, h5pget_chunk_f, h5pclose_f, h5dcreate_f, &
                  h5dopen_f, h5dclose_f, h5dwrite_f, h5dset_extent_f, h5dget_space_f, h5dget_create_plist_f, &
                  h5sget_simple_extent_ndims_f, &
                  h5sget_simple_extent_dims_f, h5s_unlimited_f, h5s_select_set_f, h5p_dataset_create_f
  use castnet_kinds, only: wp, sp, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_hdf5_file, only: hdf5_file_t, location_t, check, joined, transfer_plan, keep_open, let_go, set_attribute, &
                               most_rank, kind_double, kind_single, kind_long, memory_type, file_type, value_bytes
  use castnet_posix, only: clear_system_error
  implicit none
  private
  public :: series_t, create_series, open_series, append_frames, hold_frames, next_frames, write_held, &
            truncate_series, close_series, growth_bytes, frames_a_chunk

  !> Chunks of small frames hold about this much, of large ones at most the second [bytes]:
  !> an almost empty file stays small, a long one reads fast. Where it is known how many frames
  !> come, chunks hold about the third: HDF5 takes as long for a chunk as for the copy of 64 KiB.
  integer(i8), parameter :: small_chunk = 8192_i8, large_chunk = 4194304_i8, known_chunk = 65536_i8
  integer(i8), parameter :: most_frames_per_chunk = 256_i8, most_expected = 1024_i8

  type :: series_t
    character(len=:), allocatable :: name       !! with its groups, for messages
    integer(hid_t) :: id = -1
    integer :: kind = kind_double
    integer :: rank = 0                         !! dimensions, the growing one included
    integer(hsize_t) :: shape(most_rank) = 1    !! of one frame, in shape(1:rank-1)
    integer(i8) :: length = 0                   !! frames in the file so far
    integer(i8) :: held = 0                     !! and in memory
    integer(c_int8_t), allocatable :: bytes(:)  !! their values; room for more
    integer(i8) :: held_bytes = 0
    integer(i8) :: room = 65536                 !! bytes to begin with
    integer(i8) :: frames_per_chunk = 1
    integer(i8) :: block_bytes = 0              !! of all chunks side by side that hold a block of frames
    integer :: block_chunks = 1                 !! how many they are
  end type series_t

  !> Append one or more frames: values one after the other, Fortran order.
  interface append_frames
    module procedure append_doubles, append_longs
  end interface append_frames

  !> Room in memory for the values of the next frames, for the caller to write them there.
  interface next_frames
    module procedure next_doubles, next_singles
  end interface next_frames

contains

  !> Create an empty series. NaN (reals) or 0 is told as its fill value.
  subroutine create_series(file, parent, name, kind, frame, units, series, error, together, expected)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name, units     !! no units attribute when blank
    integer, intent(in) :: kind                     !! kind_double ...
    integer, intent(in) :: frame(:)                 !! shape of one frame, empty for a number
    type(series_t), intent(out) :: series
    type(error_t), allocatable, intent(inout) :: error
    integer, intent(in), optional :: together       !! frames that are always appended together
    integer(i8), intent(in), optional :: expected   !! frames that will come, about
    integer(hsize_t) :: chunk(most_rank), extent(most_rank), most(most_rank)
    integer(hid_t) :: space, plan
    integer :: status, ignored
    if (file%broken) return
    call clear_system_error()
    series%name = joined(parent, name)
    series%kind = kind
    series%rank = size(frame) + 1
    series%shape(1:size(frame)) = frame
    call choose_chunk(series, chunk, together, expected)
    extent = series%shape
    extent(series%rank) = 0
    most = series%shape
    most(series%rank) = h5s_unlimited_f
    call h5screate_simple_f(series%rank, extent(1:series%rank), space, status, most(1:series%rank))
    if (status >= 0) call creation_plan(file, kind, chunk(1:series%rank), plan, status)
    if (status >= 0) call h5dcreate_f(parent%id, name, file_type(kind), space, series%id, status, plan)
    call check(file, status, 'create', series%name, error)
    if (status < 0) return
    call keep_open(file, series%id, series%name, .false.)
    call h5sclose_f(space, ignored)
    if (len_trim(units) > 0) call set_attribute(file, series%id, 'units', units, error)
  end subroutine create_series

  !> The plan of a series: chunks and fill value. Kept for the next of the same kind, as the
  !> columns of a table are. HDF5 fills no new chunk: it would go through a buffer for that, and
  !> no length is told before all that it counts is written (castnet_safe_driver.c).
  subroutine creation_plan(file, kind, chunk, plan, status)
    type(hdf5_file_t), intent(inout) :: file
    integer, intent(in) :: kind
    integer(hsize_t), intent(in) :: chunk(:)
    integer(hid_t), intent(out) :: plan
    integer, intent(out) :: status
    real(wp), target :: nan_double
    real(sp), target :: nan_single
    integer(hsize_t) :: padded(most_rank)
    padded = 0
    padded(:size(chunk)) = chunk
    plan = file%series_plan
    status = 0
    if (plan >= 0 .and. file%series_kind == kind .and. all(file%series_chunk == padded)) return
    if (plan >= 0) call h5pclose_f(plan, status)
    call h5pcreate_f(h5p_dataset_create_f, plan, status)
    if (status >= 0) call h5pset_chunk_f(plan, size(chunk), chunk, status)
    if (status >= 0) call h5pset_fill_time_f(plan, h5d_fill_time_never_f, status)
    if (status >= 0 .and. kind == kind_double) then
      nan_double = ieee_value(nan_double, ieee_quiet_nan)
      call h5pset_fill_value_f(plan, memory_type(kind), c_loc(nan_double), status)
    else if (status >= 0 .and. kind == kind_single) then
      nan_single = ieee_value(nan_single, ieee_quiet_nan)
      call h5pset_fill_value_f(plan, memory_type(kind), c_loc(nan_single), status)
    end if
    file%series_plan = plan
    file%series_kind = kind
    file%series_chunk = padded
  end subroutine creation_plan

  !> A frame in a chunk; many if the frame is small, a part of it if it is large.
  subroutine choose_chunk(series, chunk, together, expected)
    type(series_t), intent(inout) :: series
    integer(hsize_t), intent(out) :: chunk(:)
    integer, intent(in), optional :: together
    integer(i8), intent(in), optional :: expected
    integer(i8) :: bytes
    integer :: longest
    chunk = 1
    chunk(1:series%rank - 1) = series%shape(1:series%rank - 1)
    bytes = max(1_i8, product(chunk(1:series%rank - 1))*value_bytes(series%kind))
    series%frames_per_chunk = max(1_i8, min(most_frames_per_chunk, small_chunk/bytes))
    if (present(expected)) then
      series%frames_per_chunk = max(series%frames_per_chunk, min(expected, most_expected, known_chunk/bytes))
      series%room = min(expected*bytes, large_chunk)
    end if
    if (present(together)) &
      series%frames_per_chunk = max(series%frames_per_chunk, min(int(together, i8), large_chunk/bytes))
    chunk(series%rank) = series%frames_per_chunk
    if (bytes > large_chunk .and. series%rank > 1) then
      longest = maxloc(chunk(1:series%rank - 1), 1)
      chunk(longest) = max(1_i8, chunk(longest)*large_chunk/bytes)
    end if
    call count_chunks(series, chunk)
  end subroutine choose_chunk

  !> Of frames of so many bytes, as many as come, about: how many to a chunk?
  pure integer function frames_a_chunk(expected, bytes)
    integer(i8), intent(in) :: expected, bytes
    frames_a_chunk = int(max(1_i8, min(expected, known_chunk/max(1_i8, bytes))))
  end function frames_a_chunk

  !> What a block of frames costs on the disk: edge chunks are stored in full.
  subroutine count_chunks(series, chunk)
    type(series_t), intent(inout) :: series
    integer(hsize_t), intent(in) :: chunk(:)
    integer(i8) :: bytes
    integer :: i
    bytes = value_bytes(series%kind)*chunk(series%rank)
    series%block_chunks = 1
    do i = 1, series%rank - 1
      series%block_chunks = series%block_chunks*int((series%shape(i) + chunk(i) - 1)/chunk(i))
      bytes = bytes*chunk(i)
    end do
    series%block_bytes = bytes*series%block_chunks
  end subroutine count_chunks

  !> Open a series that `create_series` made.
  subroutine open_series(file, parent, name, kind, series, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer, intent(in) :: kind
    type(series_t), intent(out) :: series
    type(error_t), allocatable, intent(inout) :: error
    integer(hsize_t) :: chunk(most_rank), extent(most_rank), most(most_rank)
    integer(hid_t) :: space, plan
    integer :: status, ignored
    if (file%broken) return
    series%name = joined(parent, name)
    series%kind = kind
    call h5dopen_f(parent%id, name, series%id, status)
    if (status >= 0) call h5dget_space_f(series%id, space, status)
    if (status >= 0) call h5sget_simple_extent_ndims_f(space, series%rank, status)
    if (status >= 0 .and. series%rank > most_rank) status = -1
    if (status >= 0) call h5sget_simple_extent_dims_f(space, extent(1:series%rank), most(1:series%rank), status)
    if (status >= 0) call h5dget_create_plist_f(series%id, plan, status)
    if (status >= 0) call h5pget_chunk_f(plan, series%rank, chunk(1:series%rank), status)
    call check(file, status, 'open', series%name, error)
    if (status < 0) return
    series%length = extent(series%rank)
    series%shape(1:series%rank - 1) = extent(1:series%rank - 1)
    series%frames_per_chunk = chunk(series%rank)
    call count_chunks(series, chunk)
    call h5pclose_f(plan, ignored)
    call h5sclose_f(space, ignored)
  end subroutine open_series

  !> Most bytes that the file may grow by when `frames` more are appended: new chunks, and
  !> nodes of the tree that finds them. A node holds 64 chunks, and at least 32 once it has
  !> been split; the first split makes a root besides.
  pure integer(i8) function growth_bytes(series, frames)
    type(series_t), intent(in) :: series
    integer(i8), intent(in) :: frames
    integer(i8) :: before, after, nodes, node
    before = chunk_blocks(series, series%length)
    after = chunk_blocks(series, series%length + frames)
    growth_bytes = (after - before)*series%block_bytes
    if (after == before) return
    before = before*series%block_chunks
    after = after*series%block_chunks
    if (after <= 64) then
      nodes = merge(1_i8, 0_i8, before == 0)
    else
      nodes = 2 + (after - before)/32
    end if
    ! 65 keys of size, filter mask and offsets, 64 addresses
    node = 24 + 65*(8 + 8*(series%rank + 1)) + 64*8
    growth_bytes = growth_bytes + nodes*node
  end function growth_bytes

  pure integer(i8) function chunk_blocks(series, length)
    type(series_t), intent(in) :: series
    integer(i8), intent(in) :: length
    chunk_blocks = (length + series%frames_per_chunk - 1)/series%frames_per_chunk
  end function chunk_blocks

  subroutine append_doubles(file, series, values, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout) :: series
    real(wp), intent(in), target, contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    call append(file, series, kind_double, size(values, kind=i8), c_loc(values), error)
  end subroutine append_doubles

  subroutine append_longs(file, series, values, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout) :: series
    integer(i8), intent(in), target, contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    call append(file, series, kind_long, size(values, kind=i8), c_loc(values), error)
  end subroutine append_longs

  !> Make the dataset longer by as many frames as the values fill, and write them there.
  subroutine append(file, series, kind, n_value, buffer, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout) :: series
    integer, intent(in) :: kind
    integer(i8), intent(in) :: n_value
    type(c_ptr), intent(in) :: buffer
    type(error_t), allocatable, intent(inout) :: error
    integer(hsize_t) :: extent(most_rank), start(most_rank), count(most_rank)
    integer(i8) :: frame
    integer(hid_t) :: space, memory
    integer :: status, ignored, r
    if (file%broken .or. n_value == 0) return
    r = series%rank
    frame = product(series%shape(1:r - 1))
    if (kind /= series%kind .or. mod(n_value, frame) /= 0) then
      call fail(error, exit_file, "internal: values do not fit the frames of '"//series%name//"'")
      file%broken = .true.
      return
    end if
    call clear_system_error()
    count = series%shape
    count(r) = n_value/frame
    extent = series%shape
    extent(r) = series%length + count(r)
    start = 0
    start(r) = series%length
    call h5dset_extent_f(series%id, extent(1:r), status)
    if (status >= 0) call h5dget_space_f(series%id, space, status)
    if (status >= 0) call h5sselect_hyperslab_f(space, h5s_select_set_f, start(1:r), count(1:r), status)
    if (status >= 0) call h5screate_simple_f(r, count(1:r), memory, status)
    if (status >= 0) call h5dwrite_f(series%id, memory_type(kind), buffer, status, memory, space, transfer_plan(file))
    call check(file, status, 'append to', series%name, error)
    if (status < 0) return
    series%length = extent(r)
    call h5sclose_f(memory, ignored)
    call h5sclose_f(space, ignored)
  end subroutine append

  !> Keep a copy of as many frames as the values fill in memory, until `write_held`.
  subroutine hold_frames(file, series, values, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout), target :: series
    real(wp), intent(in), contiguous :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    real(wp), pointer, contiguous :: place(:)
    call next_doubles(file, series, size(values), place, error)
    if (associated(place)) place = values
  end subroutine hold_frames

  !> Associated as long as the file is not broken; to be filled before anything else is held.
  subroutine next_doubles(file, series, n_value, values, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout), target :: series
    integer, intent(in) :: n_value
    real(wp), pointer, contiguous, intent(out) :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: first
    nullify (values)
    call make_room(file, series, kind_double, int(n_value, i8), first, error)
    if (first > 0) call c_f_pointer(c_loc(series%bytes(first)), values, [n_value])
  end subroutine next_doubles

  !> The same in single precision.
  subroutine next_singles(file, series, n_value, values, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout), target :: series
    integer, intent(in) :: n_value
    real(sp), pointer, contiguous, intent(out) :: values(:)
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: first
    nullify (values)
    call make_room(file, series, kind_single, int(n_value, i8), first, error)
    if (first > 0) call c_f_pointer(c_loc(series%bytes(first)), values, [n_value])
  end subroutine next_singles

  !> Make room behind what is held for as many frames as the values fill.
  subroutine make_room(file, series, kind, n_value, first, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout) :: series
    integer, intent(in) :: kind
    integer(i8), intent(in) :: n_value
    integer(i8), intent(out) :: first           !! byte of the first value, 0: there is none
    type(error_t), allocatable, intent(inout) :: error
    integer(c_int8_t), allocatable :: larger(:)
    integer(i8) :: n, frame
    first = 0
    if (file%broken .or. n_value == 0) return
    frame = product(series%shape(1:series%rank - 1))
    if (kind /= series%kind .or. mod(n_value, frame) /= 0) then
      call fail(error, exit_file, "internal: values do not fit the frames of '"//series%name//"'")
      file%broken = .true.
      return
    end if
    n = n_value*value_bytes(kind)
    if (.not. allocated(series%bytes)) allocate (series%bytes(max(n, series%room)))
    if (series%held_bytes + n > size(series%bytes, kind=i8)) then
      allocate (larger(2*(series%held_bytes + n)))
      larger(:series%held_bytes) = series%bytes(:series%held_bytes)
      call move_alloc(larger, series%bytes)
    end if
    first = series%held_bytes + 1
    series%held_bytes = series%held_bytes + n
    series%held = series%held + n_value/frame
  end subroutine make_room

  !> Append what is held.
  subroutine write_held(file, series, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout), target :: series
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: n_value
    if (series%held == 0) return
    n_value = series%held_bytes/value_bytes(series%kind)
    call append(file, series, series%kind, n_value, c_loc(series%bytes), error)
    series%held = 0
    series%held_bytes = 0
  end subroutine write_held

  !> Cut a series to its first `length` frames; no effect if it is not longer.
  subroutine truncate_series(file, series, length, error)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout) :: series
    integer(i8), intent(in) :: length
    type(error_t), allocatable, intent(inout) :: error
    integer(hsize_t) :: extent(most_rank)
    integer :: status
    if (file%broken .or. series%length <= length) return
    extent = series%shape
    extent(series%rank) = max(0_i8, length)
    call h5dset_extent_f(series%id, extent(1:series%rank), status)
    call check(file, status, 'shorten', series%name, error)
    if (status >= 0) series%length = extent(series%rank)
  end subroutine truncate_series

  subroutine close_series(file, series)
    type(hdf5_file_t), intent(inout) :: file
    type(series_t), intent(inout) :: series
    integer :: status
    if (file%broken .or. series%id < 0) return
    if (file%recent == series%id) call let_go(file)
    call h5dclose_f(series%id, status)
    series%id = -1
  end subroutine close_series

end module castnet_hdf5_series
