!> The group /summary of a run's file: capture measures at the verdict times, and what
!> one number says about the whole run.
module castnet_summary_writer
  use castnet_kinds, only: wp, i4
  use castnet_error, only: error_t
  use castnet_record, only: summary_t, thresholds_t
  use castnet_hdf5_file, only: hdf5_file_t, location_t, make_group, open_group, close_group, empty_group, &
                               has_entry, write_value, write_array, set_attribute, make_scale, attach_scales
  implicit none
  private
  public :: prepare_summary, write_summary

contains

  !> The group without anything, in a file that has it not yet or from a run that goes on:
  !> it stands from the start, because a link in an old group cannot be added while others
  !> read the file.
  subroutine prepare_summary(file, error)
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer, parameter :: entries = 48   ! and the attributes
    type(location_t) :: group
    if (file%broken) return
    if (has_entry(file%root, 'summary')) then
      call open_group(file, file%root, 'summary', group, error)
      call empty_group(file, group, error)
    else
      call make_group(file, file%root, 'summary', group, error, entries)
    end if
    call close_group(file, group)
  end subroutine prepare_summary

  !> Fill the group. The arrays over `verdict_time` are left out when nothing was judged.
  subroutine write_summary(file, summary, error)
    type(hdf5_file_t), intent(inout) :: file
    type(summary_t), intent(in) :: summary
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group
    call open_group(file, file%root, 'summary', group, error)
    if (allocated(summary%measures)) then
      if (size(summary%measures) > 0) call write_measures(file, group, summary, error)
    end if
    call write_array(file, group, 'percentile', [50.0_wp, 95.0_wp, 99.0_wp, 99.9_wp], 'percent', error)
    call make_scale(file, group, 'percentile', error)
    call write_array(file, group, 'impulse_percentiles', summary%impulse_percentiles, 'N s', error)
    call attach_scales(file, group, 'impulse_percentiles', ['percentile'], error)
    call write_value(file, group, 'captured', merge(1_i4, 0_i4, summary%captured), '1', error)
    call write_value(file, group, 'first_contact', summary%first_contact, 's', error)
    call write_value(file, group, 'closing_start', summary%closing_start, 's', error)
    associate (deployment => summary%deployment)
      call write_value(file, group, 'largest_mouth_area', deployment%largest_mouth_area, 'm2', error)
      call write_value(file, group, 'deployment_time', deployment%deployment_time, 's', error)
      call write_value(file, group, 'deployment_distance', deployment%deployment_distance, 'm', error)
      call write_value(file, group, 'distance_travelled', deployment%distance_travelled, 'm', error)
      call write_value(file, group, 'effective_period', deployment%effective_period, 's', error)
      call write_value(file, group, 'open_period', deployment%open_period, 's', error)
    end associate
    if (allocated(summary%self_contacts)) then
      call write_value(file, group, 'self_contacts', summary%self_contacts(1), '1', error)
      call write_value(file, group, 'self_contacts_taut', summary%self_contacts(2), '1', error)
      if (summary%keeps_cables_apart) &
        call write_value(file, group, 'self_contacts_unresolved', summary%self_contacts(3), '1', error)
    end if
    call write_value(file, group, 'wall_time', summary%wall_time, 's', error)
    call write_value(file, group, 'steps', summary%steps, '1', error)
    call write_value(file, group, 'force_evaluations', summary%force_evaluations, '1', error)
    call write_thresholds(file, group, summary%thresholds, error)
    call close_group(file, group)
  end subroutine write_summary

  subroutine write_measures(file, group, summary, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(summary_t), intent(in) :: summary
    type(error_t), allocatable, intent(inout) :: error
    real(wp) :: time(size(summary%measures))
    integer(i4) :: verdict(size(summary%measures))
    time = summary%measures%time
    verdict = summary%measures%verdict
    call write_array(file, group, 'verdict_time', time, 's', error)
    call make_scale(file, group, 'verdict_time', error)
    call column('coverage', summary%measures%coverage, '1')
    call column('largest_hole', summary%measures%largest_hole, 'degree')
    call column('escape', summary%measures%escape, '1')
    call column('cqi', summary%measures%cqi, '1')
    call column('mouth_area', summary%measures%mouth_area, 'm2')
    call column('mouth_perimeter', summary%measures%mouth_perimeter, 'm')
    call column('bullet_distance_min', summary%measures%bullet_distance_min, 'm')
    call column('bullet_distance_max', summary%measures%bullet_distance_max, 'm')
    call write_array(file, group, 'verdict', verdict, '1', error)
    call set_attribute(file, group, 'verdict', 'meaning', '0 failed, 1 marginal, 2 captured', error)
    call attach_scales(file, group, 'verdict', ['verdict_time'], error)

  contains

    subroutine column(name, values, units)
      character(len=*), intent(in) :: name, units
      real(wp), intent(in) :: values(:)
      real(wp) :: copy(size(values))
      copy = values
      call write_array(file, group, name, copy, units, error)
      call attach_scales(file, group, name, ['verdict_time'], error)
    end subroutine column

  end subroutine write_measures

  !> Without its thresholds a verdict says nothing: they stand beside it.
  subroutine write_thresholds(file, group, thresholds, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(thresholds_t), intent(in) :: thresholds
    type(error_t), allocatable, intent(inout) :: error
    call set_attribute(file, group%id, 'captured_coverage', thresholds%captured_coverage, error)
    call set_attribute(file, group%id, 'captured_hole', thresholds%captured_hole, error)
    call set_attribute(file, group%id, 'captured_escape', thresholds%captured_escape, error)
    call set_attribute(file, group%id, 'failed_coverage', thresholds%failed_coverage, error)
    call set_attribute(file, group%id, 'failed_escape', thresholds%failed_escape, error)
    call set_attribute(file, group%id, 'lasting_coverage', thresholds%lasting_coverage, error)
    call set_attribute(file, group%id, 'lasting_escape', thresholds%lasting_escape, error)
  end subroutine write_thresholds

end module castnet_summary_writer
