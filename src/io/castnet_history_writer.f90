!> The group /history of a run's file: one row at every history interval, along a time
!> dimension of its own, so that `xarray.open_dataset(file, group='history')` works.
!>
!> Rows gather in memory and go to the file with the next frame, or when a block is full:
!> a small write for every row would cost more than the row is worth.
module castnet_history_writer
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_record, only: history_row_t
  use castnet_hdf5_file, only: hdf5_file_t, location_t, make_group, open_group, close_group, make_scale, attach_scales, &
                               kind_double, kind_long
  use castnet_hdf5_series, only: series_t, create_series, open_series, append_frames, truncate_series, close_series, &
                                 growth_bytes
  implicit none
  private
  public :: history_writer_t, create_history, reopen_history, store_row, is_block_full, waiting_rows, write_rows, &
            history_growth, close_history

  !> One column of the table.
  type :: column_t
    character(len=20) :: name
    character(len=10) :: units
    integer :: width = 1                        !! numbers in a row: 3 for a vector
  end type column_t

  integer, parameter :: n_real = 18, n_count = 2
  integer, parameter :: n_value = 22            !! numbers of all real columns in a row
  integer, parameter :: block = 1024            !! rows that wait at most

  !> In the order of `row_values`; the first is the dimension scale.
  type(column_t), parameter :: real_columns(n_real) = [ &
    column_t('time', 's'), column_t('kinetic_net', 'J'), column_t('kinetic_target', 'J'), column_t('elastic', 'J'), &
    column_t('dissipated', 'J'), column_t('contact_loss', 'J'), column_t('winch_work', 'J'), &
    column_t('projection_work', 'J'), column_t('external_work', 'J'), column_t('linear_momentum', 'kg m s-1', 3), &
    column_t('angular_momentum', 'kg m2 s-1', 3), column_t('max_tension', 'N'), column_t('max_impulse', 'N s'), &
    column_t('min_impulse', 'N s'), column_t('impulse_sum', 'N s'), column_t('max_bullet_impulse', 'N s'), &
    column_t('deepest_penetration', 'm'), column_t('contact_residual', 'm s-1')]

  !> In the order of `row_counts`.
  type(column_t), parameter :: count_columns(n_count) = [column_t('contacts', '1'), column_t('contact_iterations', '1')]

  type :: history_writer_t
    private
    type(series_t) :: reals(n_real), counts(n_count)
    integer :: waiting = 0
    real(wp), allocatable :: value(:, :)        !! (n_value, block)
    integer(i8), allocatable :: count(:, :)     !! (n_count, block)
  end type history_writer_t

contains

  pure function row_values(row) result(values)
    type(history_row_t), intent(in) :: row
    real(wp) :: values(n_value)
    values = [row%time, row%kinetic_net, row%kinetic_target, row%elastic, row%dissipated, row%contact_loss, &
              row%winch_work, row%projection_work, row%external_work, row%linear_momentum, row%angular_momentum, &
              row%max_tension, row%max_impulse, row%min_impulse, row%impulse_sum, row%max_bullet_impulse, &
              row%deepest_penetration, row%contact_residual]
  end function row_values

  pure function row_counts(row) result(counts)
    type(history_row_t), intent(in) :: row
    integer(i8) :: counts(n_count)
    counts = [row%contacts, int(row%contact_iterations, i8)]
  end function row_counts

  !> Create the group and its empty columns. The root must hold the scale `xyz`.
  subroutine create_history(history, file, expected, error)
    type(history_writer_t), intent(out) :: history
    type(hdf5_file_t), intent(inout) :: file
    integer(i8), intent(in) :: expected         !! rows that will come, about
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group
    type(column_t) :: column
    integer :: i
    call make_room(history)
    call make_group(file, file%root, 'history', group, error)
    do i = 1, n_real
      column = real_columns(i)
      if (column%width == 1) then
        call create_series(file, group, trim(column%name), kind_double, [integer ::], trim(column%units), &
                           history%reals(i), error, expected=expected)
      else
        call create_series(file, group, trim(column%name), kind_double, [column%width], trim(column%units), &
                           history%reals(i), error, expected=expected)
      end if
      if (i == 1) then
        call make_scale(file, group, 'time', error)
      else if (column%width == 1) then
        call attach_scales(file, group, trim(column%name), ['time'], error)
      else
        call attach_scales(file, group, trim(column%name), ['/xyz', 'time'], error)
      end if
    end do
    do i = 1, n_count
      call create_series(file, group, trim(count_columns(i)%name), kind_long, [integer ::], trim(count_columns(i)%units), &
                         history%counts(i), error, expected=expected)
      call attach_scales(file, group, trim(count_columns(i)%name), ['time'], error)
    end do
    call close_group(file, group)
  end subroutine create_history

  !> Go on with the group after a restart: keep the first `rows` rows.
  subroutine reopen_history(history, file, rows, error)
    type(history_writer_t), intent(out) :: history
    type(hdf5_file_t), intent(inout) :: file
    integer(i8), intent(in) :: rows
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group
    integer :: i
    call make_room(history)
    call open_group(file, file%root, 'history', group, error)
    do i = 1, n_real
      call open_series(file, group, trim(real_columns(i)%name), kind_double, history%reals(i), error)
      call truncate_series(file, history%reals(i), rows, error)
    end do
    do i = 1, n_count
      call open_series(file, group, trim(count_columns(i)%name), kind_long, history%counts(i), error)
      call truncate_series(file, history%counts(i), rows, error)
    end do
    call close_group(file, group)
  end subroutine reopen_history

  !> Memory for the rows that wait; what is not used is not touched.
  subroutine make_room(history)
    type(history_writer_t), intent(inout) :: history
    allocate (history%value(n_value, block), history%count(n_count, block))
  end subroutine make_room

  !> Keep a row until the next write; there must be room (`is_block_full`).
  subroutine store_row(history, row)
    type(history_writer_t), intent(inout) :: history
    type(history_row_t), intent(in) :: row
    history%waiting = history%waiting + 1
    history%value(:, history%waiting) = row_values(row)
    history%count(:, history%waiting) = row_counts(row)
  end subroutine store_row

  pure logical function is_block_full(history)
    type(history_writer_t), intent(in) :: history
    is_block_full = history%waiting == block
  end function is_block_full

  pure integer function waiting_rows(history)
    type(history_writer_t), intent(in) :: history
    waiting_rows = history%waiting
  end function waiting_rows

  !> Append the waiting rows to the file.
  subroutine write_rows(history, file, error)
    type(history_writer_t), intent(inout) :: history
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    real(wp) :: column(3*block)
    integer(i8) :: counts(block)
    integer :: i, k, first, width, n
    n = history%waiting
    if (n == 0) return
    first = 1
    do i = 1, n_real
      width = real_columns(i)%width
      do k = 1, n
        column(width*(k - 1) + 1:width*k) = history%value(first:first + width - 1, k)
      end do
      call append_frames(file, history%reals(i), column(1:width*n), error)
      first = first + width
    end do
    do i = 1, n_count
      counts(1:n) = history%count(i, 1:n)
      call append_frames(file, history%counts(i), counts(1:n), error)
    end do
    history%waiting = 0
  end subroutine write_rows

  !> Most bytes that writing so many rows adds to the file.
  integer(i8) function history_growth(history, rows)
    type(history_writer_t), intent(in) :: history
    integer(i8), intent(in) :: rows
    integer :: i
    history_growth = 0
    do i = 1, n_real
      history_growth = history_growth + growth_bytes(history%reals(i), rows)
    end do
    do i = 1, n_count
      history_growth = history_growth + growth_bytes(history%counts(i), rows)
    end do
  end function history_growth

  subroutine close_history(history, file)
    type(history_writer_t), intent(inout) :: history
    type(hdf5_file_t), intent(inout) :: file
    integer :: i
    do i = 1, n_real
      call close_series(file, history%reals(i))
    end do
    do i = 1, n_count
      call close_series(file, history%counts(i))
    end do
  end subroutine close_history

end module castnet_history_writer
