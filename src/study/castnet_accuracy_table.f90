!> What `castnet accuracy` found, as HDF5 for xarray and CSV for everyone.
module castnet_accuracy_table
  use castnet_kinds, only: wp
  use castnet_accuracy, only: accuracy_t, setting_words, is_below, observable_name, observable_unit, n_observable
  use castnet_error, only: error_t
  use castnet_hdf5_file, only: hdf5_file_t, create_hdf5, close_file, write_array, write_value, write_text, set_attribute, &
                               make_scale, attach_scales
  use castnet_text, only: to_text, rounded_text, without_extension
  use castnet_text_file, only: write_text_file
  implicit none
  private
  public :: write_accuracy, accuracy_sentence

contains

  !> PATH and the CSV beside it. Errors: exit_file.
  subroutine write_accuracy(path, scene_text, version, result, error)
    character(len=*), intent(in) :: path, scene_text, version
    type(accuracy_t), intent(in) :: result
    type(error_t), allocatable, intent(inout) :: error
    type(hdf5_file_t) :: file
    real(wp), allocatable :: values(:, :)
    character(len=24) :: words(max(n_observable, size(result%settings)))
    integer :: o, s, n

    n = size(result%settings)
    call create_hdf5(file, path, error)
    if (allocated(error)) return
    associate (settings => result%settings)
      call write_array(file, file%root, 'time', result%time, 's', error)
      call make_scale(file, file%root, 'time', error)
      call write_array(file, file%root, 'setting', [(real(s, wp), s=1, n)], '1', error)
      call make_scale(file, file%root, 'setting', error)
      words(:n) = settings%method
      call write_array(file, file%root, 'method', words(:n), error)
      call column('step', settings%step, 's')
      call column('step_of_limit', settings%of_limit, '1')
      call column('tolerance', settings%tolerance, '1')
      call column('seconds', settings%seconds, 's')
      call column('force_evaluations', real(settings%evaluations, wp), '1')
      call column('below_floor', merge(1.0_wp, 0.0_wp, settings%below_floor), '1')
      call write_array(file, file%root, 'growth', result%growth, 'm', error)
      call attach_scales(file, file%root, 'growth', ['time'], error)
      allocate (values(size(result%time), n))
      do o = 1, n_observable
        if (.not. result%used(o)) cycle
        do s = 1, n
          values(:, s) = settings(s)%error(o, :)
        end do
        call table('error_'//trim(observable_name(o)), o)
        do s = 1, n
          values(:, s) = settings(s)%single(o, :)
        end do
        call table('single_'//trim(observable_name(o)), o)
        call write_array(file, file%root, 'floor_'//trim(observable_name(o)), result%floor(o, :), &
                         trim(observable_unit(o)), error)
        call attach_scales(file, file%root, 'floor_'//trim(observable_name(o)), ['time'], error)
        call column('order_'//trim(observable_name(o)), settings%order(o), '1')
      end do
    end associate
    call write_value(file, file%root, 'horizon', result%horizon, 's', error)
    call write_value(file, file%root, 'reference_step', result%reference%step, 's', error)
    call write_value(file, file%root, 'cheapest', result%cheapest, '1', error)
    call write_value(file, file%root, 'members', result%n_member, '1', error)
    call write_text(file, file%root, 'scene', scene_text, error)
    call write_text(file, file%root, 'version', version, error)
    call write_text(file, file%root, 'conclusion', accuracy_sentence(result), error)
    call close_file(file, error)
    if (allocated(error)) return
    call write_text_file(without_extension(path)//'.csv', csv(result), .true., error)

  contains

    subroutine column(name, column_values, units)
      character(len=*), intent(in) :: name, units
      real(wp), intent(in) :: column_values(:)
      real(wp) :: copy(size(column_values))
      copy = column_values
      call write_array(file, file%root, name, copy, units, error)
      call attach_scales(file, file%root, name, ['setting'], error)
    end subroutine column

    subroutine table(name, observable)
      character(len=*), intent(in) :: name
      integer, intent(in) :: observable
      call write_array(file, file%root, name, values, trim(observable_unit(observable)), error)
      call attach_scales(file, file%root, name, ['time   ', 'setting'], error)
    end subroutine table

  end subroutine write_accuracy

  !> A row per setting and observable, at the end of the run.
  function csv(result) result(text)
    type(accuracy_t), intent(in) :: result
    character(len=:), allocatable :: text
    character(len=*), parameter :: newline = new_line('a')
    integer :: s, o, n
    n = size(result%time)
    text = 'method,step,step_of_limit,tolerance,seconds,force_evaluations,observable,unit,error,floor,'// &
           'order_at_horizon,below_floor'//newline
    do s = 1, size(result%settings)
      associate (setting => result%settings(s))
        do o = 1, n_observable
          if (.not. result%used(o)) cycle
          text = text//trim(setting%method)//','//to_text(setting%step)//','//to_text(setting%of_limit)//','// &
                 to_text(setting%tolerance)//','//to_text(setting%seconds)//','//to_text(setting%evaluations)//','// &
                 trim(observable_name(o))//','// &
                 trim(observable_unit(o))//','//to_text(setting%error(o, n))//','//to_text(result%floor(o, n))//','// &
                 to_text(setting%order(o))//','// &
                 trim(merge('1', '0', is_below(result, setting, o)))//newline
        end do
      end associate
    end do
  end function csv

  !> The conclusion in words.
  function accuracy_sentence(result) result(sentence)
    type(accuracy_t), intent(in) :: result
    character(len=:), allocatable :: sentence
    if (result%cheapest == 0) then
      sentence = 'No setting stays below the noise floor of '//to_text(result%n_member)// &
                 ' perturbed references (rk4 at '//rounded_text(result%reference%step, 3)//' s) in every observable.'
      return
    end if
    associate (best => result%settings(result%cheapest))
      sentence = 'The cheapest setting whose error is below the noise floor is '//setting_words(best)//': '// &
                 rounded_text(best%seconds, 3)//' s of processor time a run, '// &
                 to_text(best%evaluations)//' force evaluations, against '//rounded_text(result%reference%seconds, 3)// &
                 ' s of the reference, rk4 at '//rounded_text(result%reference%step, 3)//' s; single runs converge up to '// &
                 rounded_text(result%horizon, 3)//' s, after that only ensembles do.'
    end associate
  end function accuracy_sentence

end module castnet_accuracy_table
