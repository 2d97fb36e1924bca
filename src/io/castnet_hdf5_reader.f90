!> Reading whole datasets of an HDF5 file that others may have written: ask first what
!> stands there and how much memory it would take, then read, converted to our kinds.
module castnet_hdf5_reader
  use, intrinsic :: iso_c_binding, only: c_loc, c_ptr, c_null_ptr, c_associated, c_char, c_f_pointer, c_null_char
  use hdf5, only: hid_t, hsize_t, h5dopen_f, h5dclose_f, h5dget_space_f, h5dget_type_f, h5dread_f, h5sclose_f, &
                  h5tget_class_f, h5tclose_f, h5sget_simple_extent_ndims_f, h5sget_simple_extent_dims_f, &
                  h5sget_simple_extent_type_f, h5lexists_f, h5oget_info_by_name_f, h5o_info_t, h5o_type_dataset_f, &
                  h5gn_members_f, h5lget_name_by_idx_f, h5_index_name_f, h5_iter_inc_f, h5tis_variable_str_f, &
                  h5dvlen_reclaim_f, h5p_default_f, h5t_enum_f, &
                  h5t_integer_f, h5t_float_f, h5s_scalar_f, h5s_simple_f
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_process_guard, only: forget_refusal
  use castnet_hdf5_file, only: hdf5_file_t, memory_type, kind_double, kind_long
  implicit none
  private
  public :: dataset_t, ask_dataset, list_members, read_doubles, read_longs, read_text
  public :: class_none, class_integer, class_real, class_other

  integer, parameter :: class_none = 0, class_integer = 1, class_real = 2, class_other = 3
  integer, parameter :: most_rank = 32  !! HDF5's own limit

  !> What stands at a path.
  type :: dataset_t
    integer :: class = class_none             !! class_none: there is no such dataset
    integer :: rank = 0
    integer(i8) :: shape(most_rank) = 0       !! Fortran order
    integer(i8) :: n_value = 0                !! product of the shape, huge when that overflows
  end type dataset_t

contains

  !> Ask for a dataset by its path from the root. Never fails: what cannot be read is of
  !> `class_other`.
  type(dataset_t) function ask_dataset(file, path) result(found)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(hid_t) :: id, space, type_id
    integer(hsize_t) :: extent(most_rank), most(most_rank)
    integer :: status, class, form, i
    if (.not. is_dataset(file, path)) return
    found%class = class_other
    call h5dopen_f(file%root%id, path, id, status)
    if (status < 0) return
    call h5dget_type_f(id, type_id, status)
    if (status >= 0) then
      call h5tget_class_f(type_id, class, status)
      ! numpy's bool is an enumeration of integers
      if (status >= 0 .and. (class == h5t_integer_f .or. class == h5t_enum_f)) found%class = class_integer
      if (status >= 0 .and. class == h5t_float_f) found%class = class_real
      call h5tclose_f(type_id, status)
    end if
    call h5dget_space_f(id, space, status)
    if (status >= 0) then
      call h5sget_simple_extent_type_f(space, form, status)
      if (form == h5s_simple_f) then
        call h5sget_simple_extent_ndims_f(space, found%rank, status)
        call h5sget_simple_extent_dims_f(space, extent(1:found%rank), most(1:found%rank), status)
        found%shape(1:found%rank) = extent(1:found%rank)
      else if (form /= h5s_scalar_f) then
        found%class = class_other
      end if
      call h5sclose_f(space, status)
    end if
    found%n_value = 1
    do i = 1, found%rank
      if (found%shape(i) > 0) then
        if (found%n_value > huge(1_i8)/found%shape(i)) then
          found%n_value = huge(1_i8)
          exit
        end if
      end if
      found%n_value = found%n_value*found%shape(i)
    end do
    call h5dclose_f(id, status)
  end function ask_dataset

  !> Does every part of the path exist, and is the last a dataset?
  logical function is_dataset(file, path)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    type(h5o_info_t), target :: info
    integer :: status, i
    is_dataset = .false.
    do i = 2, len(path) + 1
      if (i <= len(path)) then
        if (path(i:i) /= '/') cycle
      end if
      call h5lexists_f(file%root%id, path(1:i - 1), is_dataset, status)
      if (status < 0) is_dataset = .false.
      if (.not. is_dataset) return
    end do
    call h5oget_info_by_name_f(file%root%id, path, info, status)
    is_dataset = status >= 0
    if (is_dataset) is_dataset = info%type == h5o_type_dataset_f
  end function is_dataset

  !> Names of what a group holds, dead links too, separated by blanks; '' when there is no
  !> such group. Names with blanks in them come with '_' instead.
  function list_members(file, path) result(names)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: names
    character(len=256) :: name
    integer :: n, i, k, status
    names = ''
    call h5gn_members_f(file%root%id, path, n, status)
    if (status < 0) return
    do i = 0, min(n, 1000) - 1
      name = ''
      call h5lget_name_by_idx_f(file%root%id, path, h5_index_name_f, h5_iter_inc_f, int(i, hsize_t), name, status)
      if (status < 0) cycle
      do k = 1, len_trim(name)
        if (name(k:k) <= ' ') name(k:k) = '_'
      end do
      names = names//' '//trim(name)
    end do
  end function list_members

  !> All values of a numeric dataset as doubles, Fortran order.
  subroutine read_doubles(file, path, n, values, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: n                                !! as `ask_dataset` said
    real(wp), allocatable, target, intent(out) :: values(:)     !! (n)
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: id
    type(c_ptr) :: buffer
    integer :: status
    allocate (values(n), stat=status)
    if (status /= 0) then
      call forget_refusal()
      call fail(error, exit_file, "no memory to read '"//path//"' of '"//file%path//"'")
      return
    end if
    if (n == 0) return
    call h5dopen_f(file%root%id, path, id, status)
    if (status >= 0) then
      buffer = c_loc(values)
      call h5dread_f(id, memory_type(kind_double), buffer, status)
      call complain(file, path, status, error)
      call h5dclose_f(id, status)
    else
      call complain(file, path, status, error)
    end if
  end subroutine read_doubles

  !> All values of an integer dataset as 64-bit integers, Fortran order.
  subroutine read_longs(file, path, n, values, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: n
    integer(i8), allocatable, target, intent(out) :: values(:)  !! (n)
    type(error_t), allocatable, intent(inout) :: error
    integer(hid_t) :: id
    type(c_ptr) :: buffer
    integer :: status
    allocate (values(n), stat=status)
    if (status /= 0) then
      call fail(error, exit_file, "no memory to read '"//path//"' of '"//file%path//"'")
      return
    end if
    if (n == 0) return
    call h5dopen_f(file%root%id, path, id, status)
    if (status >= 0) then
      buffer = c_loc(values)
      call h5dread_f(id, memory_type(kind_long), buffer, status)
      call complain(file, path, status, error)
      call h5dclose_f(id, status)
    else
      call complain(file, path, status, error)
    end if
  end subroutine read_longs

  !> A text that `write_text` wrote; '' when it is not there or not such a text.
  function read_text(file, path) result(text)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: text
    type(c_ptr), target :: stored
    type(c_ptr) :: buffer
    integer(hid_t) :: id, type_id, space
    integer :: status, ignored
    logical :: variable
    text = ''
    if (.not. is_dataset(file, path)) return
    call h5dopen_f(file%root%id, path, id, status)
    if (status < 0) return
    call h5dget_type_f(id, type_id, status)
    call h5tis_variable_str_f(type_id, variable, status)
    call h5dget_space_f(id, space, ignored)
    call h5sget_simple_extent_type_f(space, ignored, status)
    if (status >= 0 .and. ignored == h5s_scalar_f .and. variable) then
      stored = c_null_ptr
      buffer = c_loc(stored)
      call h5dread_f(id, type_id, buffer, status)
      if (status >= 0 .and. c_associated(stored)) then
        text = from_c(stored)
        call h5dvlen_reclaim_f(type_id, space, h5p_default_f, buffer, ignored)
      end if
    end if
    call h5sclose_f(space, ignored)
    call h5tclose_f(type_id, ignored)
    call h5dclose_f(id, ignored)
  end function read_text

  !> The text at a C address, up to its final zero.
  function from_c(address) result(text)
    type(c_ptr), intent(in) :: address
    character(len=:), allocatable :: text
    character(kind=c_char), pointer :: chars(:)
    integer(i8) :: n, i
    n = 0
    call c_f_pointer(address, chars, [huge(1_i8)/2])
    do while (chars(n + 1) /= c_null_char)
      n = n + 1
    end do
    allocate (character(len=n) :: text)
    do i = 1, n
      text(i:i) = chars(i)
    end do
  end function from_c

  subroutine complain(file, path, status, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: status
    type(error_t), allocatable, intent(inout) :: error
    if (status >= 0) return
    call fail(error, exit_file, "cannot read '"//path//"' of '"//file%path// &
              "': the file is damaged, or needs a filter that is not here; write it again without compression")
  end subroutine complain

end module castnet_hdf5_reader
