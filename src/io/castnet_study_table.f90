!> A study's table: HDF5 for xarray, CSV for everyone. Made whole beside its place and
!> renamed into it, from rows sorted by case: the same bytes of data however they came.
module castnet_study_table
  use castnet_kinds, only: wp, i4, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_hdf5_file, only: hdf5_file_t, location_t, create_hdf5, close_file, flush_file, make_group, close_group, &
                               write_array, write_text, write_value, make_scale, attach_scales, set_attribute
  use castnet_posix, only: create_file, rename_file, remove_file, sync_path, file_failure
  use castnet_study_record, only: case_row_t, point_row_t, search_row_t, n_measure, measure_name, measure_units, reason_length
  use castnet_text, only: to_text, text_t, without_extension, replace_all
  implicit none
  private
  public :: write_study_table, column_name

contains

  !> 'target/angular_velocity(2)' as a column: '/' parts groups in HDF5, so it becomes '.'.
  function column_name(key) result(name)
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: name
    name = replace_all(trim(key), '/', '.')
  end function column_name

  !> Write PATH (HDF5) and the CSV beside it. Errors: exit_file; the table before stays.
  subroutine write_study_table(path, keys, rows, points, searches, notes, error)
    character(len=*), intent(in) :: path
    type(text_t), intent(in) :: keys(:)              !! varied keys
    type(case_row_t), intent(in) :: rows(:)          !! by case
    type(point_row_t), intent(in) :: points(:)
    type(search_row_t), intent(in) :: searches(:)    !! none for a map
    type(text_t), intent(in) :: notes(:)             !! name, text, name, text, ... for /meta
    type(error_t), allocatable, intent(inout) :: error
    type(hdf5_file_t) :: file
    type(location_t) :: group
    integer :: ignored, i

    ignored = remove_file(path//'.tmp')
    call create_hdf5(file, path//'.tmp', error)
    if (allocated(error)) return
    call make_group(file, file%root, 'case', group, error)
    call write_cases(file, group, keys, rows, error)
    call close_group(file, group)
    call make_group(file, file%root, 'point', group, error)
    call write_points(file, group, keys, points, error)
    call close_group(file, group)
    if (size(searches) > 0) then
      call make_group(file, file%root, 'search', group, error)
      call write_searches(file, group, keys(:size(keys) - 1), searches, error)
      call close_group(file, group)
    end if
    call make_group(file, file%root, 'meta', group, error)
    do i = 1, size(notes) - 1, 2
      call write_text(file, group, notes(i)%chars, notes(i + 1)%chars, error)
    end do
    call close_group(file, group)
    call flush_file(file, error)
    call close_file(file, error)
    if (.not. allocated(error)) call put_in_place(path, error)
    if (allocated(error)) then
      ignored = remove_file(path//'.tmp')
      return
    end if
    call write_csv(without_extension(path)//'.csv', keys, rows, error)
  end subroutine write_study_table

  subroutine put_in_place(path, error)
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(inout) :: error
    integer :: number
    number = sync_path(path//'.tmp')
    if (number == 0) number = rename_file(path//'.tmp', path)
    if (number /= 0) call file_failure(error, number, 'cannot write', path, 'check the folder and run castnet collect')
  end subroutine put_in_place

  subroutine write_cases(file, group, keys, rows, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(text_t), intent(in) :: keys(:)
    type(case_row_t), intent(in) :: rows(:)
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: long(size(rows))
    integer(i4) :: short(size(rows))
    real(wp) :: values(size(rows))
    character(len=reason_length) :: reasons(size(rows))
    integer :: i, k

    if (size(rows) == 0) return
    long = rows%case
    call write_array(file, group, 'case', long, '1', error)
    call make_scale(file, group, 'case', error)
    long = rows%point
    call longs('point')
    long = rows%seed
    call longs('seed')
    do k = 1, size(keys)
      do i = 1, size(rows)
        values(i) = rows(i)%varied(k)
      end do
      call doubles(column_name(keys(k)%chars), '')
      call set_attribute(file, group, column_name(keys(k)%chars), 'key', keys(k)%chars, error)
    end do
    do k = 1, n_measure
      values = rows%measure(k)
      call doubles(trim(measure_name(k)), trim(measure_units(k)))
    end do
    short = rows%status
    call write_array(file, group, 'status', short, '1', error)
    call set_attribute(file, group, 'status', 'meaning', '0 done, 2 scene refused, 3 numerical failure', error)
    call attach_scales(file, group, 'status', ['case'], error)
    reasons = rows%reason
    call write_array(file, group, 'reason', reasons, error)
    call attach_scales(file, group, 'reason', ['case'], error)

  contains

    subroutine longs(name)
      character(len=*), intent(in) :: name
      call write_array(file, group, name, long, '1', error)
      call attach_scales(file, group, name, ['case'], error)
    end subroutine longs

    subroutine doubles(name, units)
      character(len=*), intent(in) :: name, units
      call write_array(file, group, name, values, units, error)
      call attach_scales(file, group, name, ['case'], error)
    end subroutine doubles

  end subroutine write_cases

  subroutine write_points(file, group, keys, points, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(text_t), intent(in) :: keys(:)
    type(point_row_t), intent(in) :: points(:)
    type(error_t), allocatable, intent(inout) :: error
    integer(i4) :: short(size(points))
    integer(i8) :: long(size(points))
    real(wp) :: values(size(points))
    integer :: i, k

    if (size(points) == 0) return
    do i = 1, size(points)
      long(i) = i
    end do
    call write_array(file, group, 'point', long, '1', error)
    call make_scale(file, group, 'point', error)
    do k = 1, size(keys)
      do i = 1, size(points)
        values(i) = points(i)%varied(k)
      end do
      call doubles(column_name(keys(k)%chars))
      call set_attribute(file, group, column_name(keys(k)%chars), 'key', keys(k)%chars, error)
    end do
    short = points%runs
    call counts('runs')
    short = points%captured
    call counts('captured')
    values = points%probability
    call doubles('probability')
    values = points%lower
    call doubles('lower')
    values = points%upper
    call doubles('upper')

  contains

    subroutine counts(name)
      character(len=*), intent(in) :: name
      call write_array(file, group, name, short, '1', error)
      call attach_scales(file, group, name, ['point'], error)
    end subroutine counts

    subroutine doubles(name)
      character(len=*), intent(in) :: name
      call write_array(file, group, name, values, '1', error)
      call attach_scales(file, group, name, ['point'], error)
    end subroutine doubles

  end subroutine write_points

  !> One row for each combination of the keys besides the searched one.
  subroutine write_searches(file, group, keys, searches, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(text_t), intent(in) :: keys(:)
    type(search_row_t), intent(in) :: searches(:)
    type(error_t), allocatable, intent(inout) :: error
    integer :: i, k

    call write_array(file, group, 'search', [(int(i, i8), i=1, size(searches))], '1', error)
    call make_scale(file, group, 'search', error)
    do k = 1, size(keys)
      call doubles(column_name(keys(k)%chars), [(searches(i)%varied(k), i=1, size(searches))])
      call set_attribute(file, group, column_name(keys(k)%chars), 'key', keys(k)%chars, error)
    end do
    call counts('runs', int(searches%runs, i4))
    call counts('crossings', int(searches%crossings, i4))
    call counts('found', merge(1_i4, 0_i4, searches%found))
    call doubles('estimate', searches%estimate)
    call doubles('lower', searches%lower)
    call doubles('upper', searches%upper)
    call doubles('probability', searches%probability)
    call doubles('probability_lower', searches%probability_lower)
    call doubles('probability_upper', searches%probability_upper)

  contains

    subroutine counts(name, values)
      character(len=*), intent(in) :: name
      integer(i4), intent(in) :: values(:)
      call write_array(file, group, name, values, '1', error)
      call attach_scales(file, group, name, ['search'], error)
    end subroutine counts

    subroutine doubles(name, values)
      character(len=*), intent(in) :: name
      real(wp), intent(in) :: values(:)
      call write_array(file, group, name, values, '1', error)
      call attach_scales(file, group, name, ['search'], error)
    end subroutine doubles

  end subroutine write_searches

  !> One row a case, numbers to the last bit.
  subroutine write_csv(path, keys, rows, error)
    character(len=*), intent(in) :: path
    type(text_t), intent(in) :: keys(:)
    type(case_row_t), intent(in) :: rows(:)
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: bytes, line
    integer :: i, k, number, used

    line = 'case,point,seed'
    do k = 1, size(keys)
      line = line//','//column_name(keys(k)%chars)
    end do
    do k = 1, n_measure
      line = line//','//trim(measure_name(k))
    end do
    line = line//',status,reason'//new_line('a')
    allocate (character(len=len(line) + 800*max(1, size(rows))) :: bytes)
    used = 0
    call add(line)
    do i = 1, size(rows)
      line = to_text(rows(i)%case)//','//to_text(rows(i)%point)//','//to_text(rows(i)%seed)
      do k = 1, size(keys)
        line = line//','//to_text(rows(i)%varied(k))
      end do
      do k = 1, n_measure
        line = line//','//to_text(rows(i)%measure(k))
      end do
      line = line//','//to_text(rows(i)%status)//',"'//replace_all(trim(rows(i)%reason), '"', '''')//'"'//new_line('a')
      call add(line)
    end do
    number = remove_file(path//'.tmp')
    number = create_file(path//'.tmp', bytes(:used))
    if (number == 0) number = rename_file(path//'.tmp', path)
    if (number == 0) return
    call file_failure(error, number, 'cannot write', path, 'check the folder and run castnet collect')
    number = remove_file(path//'.tmp')

  contains

    subroutine add(text)
      character(len=*), intent(in) :: text
      character(len=:), allocatable :: larger
      if (used + len(text) > len(bytes)) then
        allocate (character(len=2*len(bytes) + len(text)) :: larger)
        larger(:used) = bytes(:used)
        call move_alloc(larger, bytes)
      end if
      bytes(used + 1:used + len(text)) = text
      used = used + len(text)
    end subroutine add

  end subroutine write_csv

end module castnet_study_table
