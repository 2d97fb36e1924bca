!> The group /meta of a run's file: everything that is needed to repeat the run, and the
!> lineage of its restarts, one group in /meta/sessions for each process that had a share.
module castnet_meta_writer
  use castnet_kinds, only: wp, i4, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_model, only: model_t
  use castnet_state, only: schedule_t
  use castnet_text, only: to_text
  use castnet_posix, only: time_stamp, host_name
  use castnet_hdf5_file, only: hdf5_file_t, location_t, make_group, open_group, close_group, has_entry, write_text, &
                               write_short_text, write_value
  use castnet_hdf5_reader, only: dataset_t, ask_dataset, read_longs, class_integer
  implicit none
  private
  public :: run_info_t, write_meta, continue_meta, first_count, end_meta

  !> What /meta says about how the file came to be, and what is known of the run ahead.
  type :: run_info_t
    character(len=:), allocatable :: version, compiler, flags
    character(len=:), allocatable :: contents     !! of the files that the scene reads, as checksums
    integer :: threads = 1
    logical :: vtk = .true.
    character(len=:), allocatable :: checkpoint   !! that this run goes on from; not allocated: from t = 0
    integer(i8) :: step = 0                       !! steps taken when it starts
    real(wp) :: time = 0.0_wp                     !! and the time [s]
    type(schedule_t) :: schedule                  !! and what has been put out by then
    integer(i8) :: expected_frames = 0            !! 0: not known
    integer(i8) :: expected_rows = 0
  end type run_info_t

contains

  !> Everything that is needed to repeat the run.
  subroutine write_meta(file, scene_text, effective_text, model, info, session, error)
    type(hdf5_file_t), intent(inout) :: file
    character(len=*), intent(in) :: scene_text, effective_text
    type(model_t), intent(in) :: model
    type(run_info_t), intent(in) :: info
    character(len=:), allocatable, intent(out) :: session  !! name of this process's group in /meta/sessions
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: meta, sessions
    call make_group(file, file%root, 'meta', meta, error)
    call write_text(file, meta, 'scene', scene_text, error)
    call write_text(file, meta, 'effective_scene', effective_text, error)
    call write_text(file, meta, 'contents', known(info%contents), error)
    call write_text(file, meta, 'version', known(info%version), error)
    call write_text(file, meta, 'compiler', known(info%compiler), error)
    call write_text(file, meta, 'flags', known(info%flags), error)
    call write_value(file, meta, 'threads', int(info%threads, i4), '1', error)
    call write_value(file, meta, 'step', model%step, 's', error)
    call write_value(file, meta, 'first_frame', info%schedule%frames, '1', error)
    call write_value(file, meta, 'first_row', info%schedule%rows, '1', error)
    call write_text(file, meta, 'start', time_stamp(), error)
    call write_short_text(file, meta, 'end', '', error)
    call write_short_text(file, meta, 'status', 'running', error)
    call make_group(file, meta, 'sessions', sessions, error, entries=16)
    call start_session(file, sessions, info, session, error)
    call close_group(file, sessions)
    call close_group(file, meta)
  end subroutine write_meta

  !> A restart: one session more, and the run goes on.
  subroutine continue_meta(file, info, session, error)
    type(hdf5_file_t), intent(inout) :: file
    type(run_info_t), intent(in) :: info
    character(len=:), allocatable, intent(out) :: session  !! name of this process's group in /meta/sessions
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: meta, sessions
    call open_group(file, file%root, 'meta', meta, error)
    call write_short_text(file, meta, 'status', 'running', error)
    call write_short_text(file, meta, 'end', '', error)
    call open_group(file, meta, 'sessions', sessions, error)
    call start_session(file, sessions, info, session, error)
    call close_group(file, sessions)
    call close_group(file, meta)
  end subroutine continue_meta

  !> One process's share of the run: the lineage of restarts, numbered from 1.
  subroutine start_session(file, sessions, info, name, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: sessions
    type(run_info_t), intent(in) :: info
    character(len=:), allocatable, intent(out) :: name
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: session
    integer :: number
    name = '1'
    if (file%broken) return
    number = 1
    do while (has_entry(sessions, to_text(number)))
      number = number + 1
    end do
    name = to_text(number)
    call make_group(file, sessions, name, session, error)
    call write_text(file, session, 'start', time_stamp(), error)
    call write_text(file, session, 'host', host_name(), error)
    call write_text(file, session, 'version', known(info%version), error)
    call write_text(file, session, 'compiler', known(info%compiler), error)
    call write_text(file, session, 'flags', known(info%flags), error)
    call write_value(file, session, 'threads', int(info%threads, i4), '1', error)
    call write_text(file, session, 'checkpoint', known(info%checkpoint), error)
    call write_value(file, session, 'from_step', info%step, '1', error)
    call write_value(file, session, 'from_time', info%time, 's', error)
    call write_short_text(file, session, 'end', '', error)
    call write_short_text(file, session, 'status', 'running', error)
    call close_group(file, session)
  end subroutine start_session

  function known(text) result(words)
    character(len=:), allocatable, intent(in) :: text
    character(len=:), allocatable :: words
    words = ''
    if (allocated(text)) words = text
  end function known

  !> How the run ended, for the file and for this session.
  subroutine end_meta(file, name, status, error)
    type(hdf5_file_t), intent(inout) :: file
    character(len=*), intent(in) :: name, status  !! name: as `write_meta` or `continue_meta` gave it
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: meta, session
    call open_group(file, file%root, 'meta', meta, error)
    call write_short_text(file, meta, 'status', status, error)
    call write_short_text(file, meta, 'end', time_stamp(), error)
    call open_group(file, meta, 'sessions/'//name, session, error)
    call write_short_text(file, session, 'end', time_stamp(), error)
    call write_short_text(file, session, 'status', status, error)
    call close_group(file, session)
    call close_group(file, meta)
  end subroutine end_meta

  !> A count that stands in /meta.
  integer(i8) function first_count(file, path, error)
    type(hdf5_file_t), intent(inout) :: file
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(inout) :: error
    type(dataset_t) :: found
    integer(i8), allocatable :: value(:)
    first_count = 0
    if (allocated(error)) return
    found = ask_dataset(file, path)
    if (found%class == class_integer .and. found%n_value == 1) then
      call read_longs(file, path, 1_i8, value, error)
      if (.not. allocated(error)) first_count = value(1)
    else
      call fail(error, exit_file, "'"//file%path//"' is not a run of castnet that can be continued: no "//path// &
                '; go on into a new file with --output')
    end if
  end function first_count

end module castnet_meta_writer
