!> The output file of a run (design.md, "Output file"): what Python and ParaView open.
!>
!> The file is started as OUTPUT.tmp, written as OUTPUT.part and renamed to OUTPUT when the run is complete.
!> Whoever opens OUTPUT.part sees a whole file at any moment (castnet_safe_driver.c): no object is made
!> after it has its name but in groups that were made to grow.
!> Frames and rows gather in memory and go to the file together: at the latest `hold_seconds`
!> after the first of them, or when they are `hold_bytes` long, with every checkpoint and at
!> the end. First the disk space that they can take is set aside, so that HDF5 never meets a
!> full disk half-way, then they are written, then flushed. A run that is killed keeps every
!> frame that was flushed.
!>
!> Fortran's shape (xyz, node, time) is Python's (time, node, xyz); indices in the file
!> count from 0. One thread at a time may be in here.
module castnet_run_writer
  use castnet_kinds, only: wp, i4, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_surface, only: surface_t
  use castnet_model, only: model_t
  use castnet_state, only: state_t
  use castnet_record, only: history_row_t, summary_t
  use castnet_text, only: to_text, byte_text, folder_of
  use castnet_posix, only: wall_seconds, reserve_space, release_space, sync_path, rename_file, remove_file, copy_file, &
                           file_size, free_space, file_failure
  use castnet_hdf5_file, only: hdf5_file_t, create_hdf5, open_hdf5, close_file, flush_file, file_bytes, &
                               has_entry, write_array, make_scale, attach_scales, tell_scales, kind_double
  use castnet_hdf5_series, only: series_t, create_series, open_series, hold_frames, next_frames, write_held, truncate_series, &
                                 close_series, growth_bytes
  use castnet_hdf5_reader, only: dataset_t, ask_dataset, read_doubles, read_text
  use castnet_output_files, only: clear_leftovers
  use castnet_restart_check, only: check_same_scene
  use castnet_static_writer, only: write_static
  use castnet_meta_writer, only: run_info_t, write_meta, continue_meta, first_count, end_meta
  use castnet_history_writer, only: history_writer_t, create_history, reopen_history, store_row, is_block_full, &
                                    waiting_rows, write_rows, history_growth, close_history
  use castnet_summary_writer, only: prepare_summary, write_summary
  use castnet_vtkhdf_writer, only: vtkhdf_writer_t, create_vtkhdf, reopen_vtkhdf, hold_vtkhdf_frame, write_vtkhdf, &
                                   vtkhdf_growth, close_vtkhdf
  implicit none
  private
  public :: run_writer_t, run_info_t, open_run, reopen_run, write_frame, write_history, write_when_due, flush_run, &
            close_run, discard_run, run_bytes
  public :: status_complete, status_stopped, status_failed

  character(len=*), parameter :: status_complete = 'complete', status_stopped = 'stopped', status_failed = 'failed'

  !> Kept free behind the end, so that a file can be closed properly on a full disk [bytes].
  integer(i8), parameter :: tail = 65536_i8

  !> What a kill may cost, in wall time, and what memory it may take [s], [bytes].
  real(wp), parameter :: hold_seconds = 0.05_wp
  integer(i8), parameter :: hold_bytes = 4194304_i8

  integer, parameter :: n_series = 8
  integer, parameter :: s_time = 1, s_node_position = 2, s_node_velocity = 3, s_tension = 4, s_position = 5, &
                        s_velocity = 6, s_attitude = 7, s_rate = 8
  character(len=*), parameter :: series_name(n_series) = [character(len=23) :: 'time', 'node_position', &
    'node_velocity', 'cable_tension', 'target_position', 'target_velocity', 'target_attitude', 'target_angular_velocity']
  character(len=*), parameter :: series_units(n_series) = [character(len=7) :: 's', 'm', 'm s-1', 'N', 'm', 'm s-1', &
    '1', 'rad s-1']

  type :: run_writer_t
    private
    character(len=:), allocatable :: path, part
    type(hdf5_file_t) :: file
    type(series_t) :: series(n_series)
    logical :: has(n_series) = .false.            !! the scene has this part
    type(history_writer_t), allocatable :: history
    type(vtkhdf_writer_t), allocatable :: vtk
    type(surface_t), allocatable :: surface
    integer :: n_node = 0, n_cable = 0
    logical :: published = .true.                 !! the file has the name that others know, OUTPUT.part
    logical :: fresh = .false.                    !! of a run from its start: checkpoints of that name are an earlier one's
    integer(i8) :: held = 0                       !! frames in memory
    real(wp) :: held_since = 0.0_wp               !! wall time of the first of them [s]
    integer(i8) :: expected = 0                   !! bytes of the whole file, at most
    integer(i8) :: given_back = 0                 !! bytes of the old file when its copy takes its place
    character(len=:), allocatable :: session      !! name of this run's group in /meta/sessions
  end type run_writer_t

contains

  !> Start OUTPUT.part with everything that does not change. An old one is replaced, when the
  !> first frame is in the file, which is OUTPUT.tmp till then: a file without a step is none
  !> for ParaView. Who may do that is for the caller to know. Errors: exit_file.
  subroutine open_run(writer, path, scene_text, effective_text, model, surface, info, error)
    type(run_writer_t), intent(out) :: writer
    character(len=*), intent(in) :: path                  !! OUTPUT
    character(len=*), intent(in) :: scene_text            !! the scene as read
    character(len=*), intent(in) :: effective_text        !! with every default
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface      !! of the target, body axes; for pictures
    type(run_info_t), intent(in) :: info
    type(error_t), allocatable, intent(inout) :: error
    integer :: ignored
    if (allocated(error)) return
    call prepare(writer, path, model, surface)
    ignored = remove_file(path//'.tmp')
    call create_hdf5(writer%file, path//'.tmp', error)
    if (allocated(error)) return
    call write_dimensions(writer, error)
    call create_frames(writer, info%expected_frames - info%schedule%frames, error)
    allocate (writer%history)
    call create_history(writer%history, writer%file, info%expected_rows - info%schedule%rows, error)
    call write_static(writer%file, model, writer%surface, error)
    call prepare_summary(writer%file, error)
    call write_meta(writer%file, scene_text, effective_text, model, info, writer%session, error)
    if (info%vtk) then
      allocate (writer%vtk)
      call create_vtkhdf(writer%vtk, writer%file, model, writer%surface, info%expected_frames - info%schedule%frames, error)
    end if
    if (.not. allocated(error)) writer%expected = file_bytes(writer%file) + needed_bytes(writer, info)
    call check_room(writer, info, error)
    writer%published = .false.
    writer%fresh = .not. allocated(info%checkpoint)
    if (.not. allocated(error)) return
    call close_quietly(writer)
    ignored = remove_file(path//'.tmp')
  end subroutine open_run

  !> Go on with OUTPUT.part after a restart: what lies behind the checkpoint is cut off, in a
  !> copy that then takes the place of the file, so that who reads it sees nothing of this. On
  !> a disk without room for two it is done in the file itself.
  !> Errors: exit_file when the file is damaged, of another net, or ends before the checkpoint.
  subroutine reopen_run(writer, path, effective_text, model, surface, info, error)
    type(run_writer_t), intent(out) :: writer
    character(len=*), intent(in) :: path                  !! OUTPUT; OUTPUT.part must be there
    character(len=*), intent(in) :: effective_text        !! the scene of this run
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    type(run_info_t), intent(in) :: info                  !! with the checkpoint's schedule
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: frames, rows
    integer :: i, number
    logical :: in_copy
    real(wp), allocatable :: time(:)
    if (allocated(error)) return
    call prepare(writer, path, model, surface)
    call open_old(writer, in_copy, error)
    if (allocated(error)) return
    frames = info%schedule%frames - first_count(writer%file, '/meta/first_frame', error)
    rows = info%schedule%rows - first_count(writer%file, '/meta/first_row', error)
    call check_same_scene(read_text(writer%file, '/meta/effective_scene'), effective_text, writer%part, error)
    call check_frames(writer, frames, rows, error)
    if (allocated(error)) then
      call leave_old(writer, in_copy)
      return
    end if
    do i = 1, n_series
      if (.not. writer%has(i)) cycle
      call open_series(writer%file, writer%file%root, trim(series_name(i)), kind_double, writer%series(i), error)
      call truncate_series(writer%file, writer%series(i), frames, error)
    end do
    allocate (writer%history)
    call reopen_history(writer%history, writer%file, rows, error)
    if (has_entry(writer%file%root, 'VTKHDF')) then
      allocate (writer%vtk)
      if (.not. allocated(error)) call read_doubles(writer%file, '/time', frames, time, error)
      if (.not. allocated(error)) call reopen_vtkhdf(writer%vtk, writer%file, model, writer%surface, time(:frames), error)
    end if
    call prepare_summary(writer%file, error)
    call continue_meta(writer%file, info, writer%session, error)
    call flush_file(writer%file, error)
    call check_room(writer, info, error)
    if (in_copy .and. .not. allocated(error)) then
      number = rename_file(path//'.tmp', writer%part)
      if (number /= 0) call file_failure(error, number, 'cannot replace', writer%part)
    end if
    if (allocated(error)) call leave_old(writer, in_copy)
    writer%file%path = writer%part
  end subroutine reopen_run

  !> Open OUTPUT.part or a copy of it, OUTPUT.tmp.
  subroutine open_old(writer, in_copy, error)
    type(run_writer_t), intent(inout) :: writer
    logical, intent(out) :: in_copy
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: left
    integer :: ignored
    ignored = remove_file(writer%path//'.tmp')
    left = free_space(folder_of(writer%part)//'.')
    in_copy = left > 2*file_size(writer%part) + tail
    if (in_copy) in_copy = copy_file(writer%part, writer%path//'.tmp') == 0
    if (in_copy) then
      writer%given_back = max(0_i8, left - free_space(folder_of(writer%part)//'.'))
      call open_hdf5(writer%file, writer%path//'.tmp', .true., error)
      writer%file%path = writer%part
    else
      call open_hdf5(writer%file, writer%part, .true., error)
    end if
    if (.not. allocated(error)) return
    error%message = "cannot open the file '"//writer%part//"'; go on into a new file with --output"
    call leave_old(writer, in_copy)
  end subroutine open_old

  !> Nothing came of it.
  subroutine leave_old(writer, in_copy)
    type(run_writer_t), intent(inout) :: writer
    logical, intent(in) :: in_copy
    integer :: ignored
    call close_quietly(writer)
    if (in_copy) ignored = remove_file(writer%path//'.tmp')
  end subroutine leave_old

  !> Names, sizes, scratch.
  subroutine prepare(writer, path, model, surface)
    type(run_writer_t), intent(inout) :: writer
    character(len=*), intent(in) :: path
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    writer%path = path
    writer%part = path//'.part'
    if (present(surface)) writer%surface = surface
    writer%has(s_time) = .true.
    if (allocated(model%net)) then
      writer%n_node = model%net%n_node
      writer%n_cable = model%net%n_cable
      writer%has([s_node_position, s_node_velocity]) = writer%n_node > 0
      writer%has(s_tension) = writer%n_cable > 0
    end if
    if (allocated(model%target)) writer%has([s_position, s_velocity, s_attitude, s_rate]) = .true.
  end subroutine prepare

  ! ---- what stands from the start -------------------------------------------------

  !> Dimension scales of the root other than time: index, or the name of a component.
  subroutine write_dimensions(writer, error)
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    integer :: i
    associate (file => writer%file, root => writer%file%root)
      call write_array(file, root, 'xyz', ['x', 'y', 'z'], error)
      call make_scale(file, root, 'xyz', error)
      if (writer%has(s_attitude)) then
        call write_array(file, root, 'quaternion', ['w', 'x', 'y', 'z'], error)
        call make_scale(file, root, 'quaternion', error)
      end if
      if (writer%n_node > 0) then
        call write_array(file, root, 'node', [(int(i, i4), i=0, writer%n_node - 1)], '1', error)
        call make_scale(file, root, 'node', error)
      end if
      if (writer%n_cable > 0) then
        call write_array(file, root, 'cable', [(int(i, i4), i=0, writer%n_cable - 1)], '1', error)
        call make_scale(file, root, 'cable', error)
      end if
    end associate
  end subroutine write_dimensions

  !> The empty series of the root with their dimensions named.
  subroutine create_frames(writer, expected, error)
    type(run_writer_t), intent(inout) :: writer
    integer(i8), intent(in) :: expected             !! frames that will come, about
    type(error_t), allocatable, intent(inout) :: error
    integer :: i
    do i = 1, n_series
      if (.not. writer%has(i)) cycle
      select case (i)
      case (s_time)
        call create(i, [integer ::])
        call make_scale(writer%file, writer%file%root, 'time', error)
      case (s_node_position, s_node_velocity)
        call create(i, [3, writer%n_node])
        call name_dimensions(i, [character(len=4) :: 'xyz', 'node', 'time'])
      case (s_tension)
        call create(i, [writer%n_cable])
        call name_dimensions(i, [character(len=5) :: 'cable', 'time'])
      case (s_attitude)
        call create(i, [4])
        call name_dimensions(i, [character(len=10) :: 'quaternion', 'time'])
      case default
        call create(i, [3])
        call name_dimensions(i, [character(len=4) :: 'xyz', 'time'])
      end select
    end do

  contains

    subroutine create(k, frame)
      integer, intent(in) :: k, frame(:)
      call create_series(writer%file, writer%file%root, trim(series_name(k)), kind_double, frame, trim(series_units(k)), &
                         writer%series(k), error, expected=expected)
    end subroutine create

    subroutine name_dimensions(k, names)
      integer, intent(in) :: k
      character(len=*), intent(in) :: names(:)
      call attach_scales(writer%file, writer%file%root, trim(series_name(k)), names, error)
    end subroutine name_dimensions

  end subroutine create_frames

  ! ---- checks before the first step -----------------------------------------------

  !> Refuse at the start what would run into a full disk later, as far as it can be known.
  subroutine check_room(writer, info, error)
    type(run_writer_t), intent(in) :: writer
    type(run_info_t), intent(in) :: info
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: needed, left
    if (allocated(error)) return
    left = free_space(folder_of(writer%part)//'.')
    if (left >= 0) left = left + writer%given_back
    needed = needed_bytes(writer, info)
    if (left < 0 .or. left >= needed) return
    call fail(error, exit_file, "the disk of '"//writer%path//"' is too small: the run writes about "// &
              byte_text(real(needed, wp))//', '//byte_text(real(left, wp))// &
              ' are free; free disk space, choose another folder with --output or a longer output/frame_interval')
  end subroutine check_room

  !> Most bytes that the run still adds to its file.
  integer(i8) function needed_bytes(writer, info)
    type(run_writer_t), intent(in) :: writer
    type(run_info_t), intent(in) :: info
    needed_bytes = tail + frame_growth(writer, max(0_i8, info%expected_frames - info%schedule%frames)) &
                   + history_growth(writer%history, max(0_i8, info%expected_rows - info%schedule%rows))
  end function needed_bytes

  !> Do the series reach as far as the checkpoint, and are they of this net?
  subroutine check_frames(writer, frames, rows, error)
    type(run_writer_t), intent(in) :: writer
    integer(i8), intent(in) :: frames, rows
    type(error_t), allocatable, intent(inout) :: error
    type(dataset_t) :: found
    integer :: i
    if (allocated(error)) return
    if (frames < 0 .or. rows < 0) call fail(error, exit_file, "'"//writer%part// &
      "' starts after the checkpoint; go on into a new file with --output")
    do i = 1, n_series
      if (.not. writer%has(i)) cycle
      found = ask_dataset(writer%file, '/'//trim(series_name(i)))
      if (found%rank == 0) then
        call fail(error, exit_file, "'"//writer%part//"' lacks /"//trim(series_name(i))// &
                  '; go on into a new file with --output')
      else if (found%shape(found%rank) < frames) then
        call fail(error, exit_file, "'"//writer%part//"' holds "//to_text(found%shape(found%rank))// &
                  ' frames of /'//trim(series_name(i))//', the checkpoint was taken after '//to_text(frames)// &
                  '; go on into a new file with --output')
      else if (i == s_node_position .and. found%shape(2) /= writer%n_node .or. &
               i == s_tension .and. found%shape(1) /= writer%n_cable) then
        call fail(error, exit_file, "'"//writer%part//"' is of another net; go on into a new file with --output")
      end if
    end do
    found = ask_dataset(writer%file, '/history/time')
    if (found%rank /= 1 .or. found%shape(1) < rows) call fail(error, exit_file, "'"//writer%part// &
      "' holds fewer rows of /history than the checkpoint; go on into a new file with --output")
  end subroutine check_frames

  ! ---- while the run goes on --------------------------------------------------------

  !> Most bytes that so many frames add to the file.
  integer(i8) function frame_growth(writer, frames)
    type(run_writer_t), intent(in) :: writer
    integer(i8), intent(in) :: frames
    integer :: i
    frame_growth = 0
    do i = 1, n_series
      if (writer%has(i)) frame_growth = frame_growth + growth_bytes(writer%series(i), frames)
    end do
    if (allocated(writer%vtk)) frame_growth = frame_growth + vtkhdf_growth(writer%vtk, frames)
  end function frame_growth

  !> Set aside what the next write can take, and what closing takes.
  subroutine reserve(writer, bytes, error)
    type(run_writer_t), intent(inout) :: writer
    integer(i8), intent(in) :: bytes
    type(error_t), allocatable, intent(inout) :: error
    integer :: number
    if (writer%file%broken) return
    number = reserve_space(writer%file%path, file_bytes(writer%file), bytes + tail)
    if (number /= 0) call file_failure(error, number, 'cannot write to', writer%part)
  end subroutine reserve

  !> Take in a frame: it goes to the file when `write_when_due` finds that it is time, with
  !> the next checkpoint, or at the end. Errors: exit_file; the frames before stay readable.
  subroutine write_frame(writer, model, state, cable_tension, error)
    type(run_writer_t), intent(inout), target :: writer
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp), intent(in), contiguous :: cable_tension(:) !! (n_cable) [N]
    type(error_t), allocatable, intent(inout) :: error
    if (allocated(error)) return
    if (writer%held == 0) writer%held_since = wall_seconds()
    call hold_frames(writer%file, writer%series(s_time), [state%time], error)
    if (writer%has(s_node_position)) then
      call hold_net(s_node_position, state%node_position)
      call hold_net(s_node_velocity, state%node_velocity)
    end if
    if (writer%has(s_tension)) &
      call hold_frames(writer%file, writer%series(s_tension), cable_tension(1:writer%n_cable), error)
    if (writer%has(s_position)) then
      call hold_frames(writer%file, writer%series(s_position), state%target%position, error)
      call hold_frames(writer%file, writer%series(s_velocity), state%target%velocity, error)
      call hold_frames(writer%file, writer%series(s_attitude), state%target%attitude, error)
      call hold_frames(writer%file, writer%series(s_rate), state%target%angular_velocity, error)
    end if
    if (allocated(writer%vtk)) &
      call hold_vtkhdf_frame(writer%vtk, writer%file, state, writer%surface, cable_tension, error)
    writer%held = writer%held + 1
    call write_when_due(writer, error)

  contains

    !> One component after the other in memory, one node after the other in the file.
    subroutine hold_net(k, values)
      integer, intent(in) :: k
      real(wp), intent(in) :: values(:, :)        !! (n_pad,3)
      real(wp), pointer, contiguous :: node(:)    !! x y z of each
      integer :: i
      call next_frames(writer%file, writer%series(k), 3*writer%n_node, node, error)
      if (.not. associated(node)) return
      do i = 1, writer%n_node
        node(3*i - 2) = values(i, 1)
        node(3*i - 1) = values(i, 2)
        node(3*i) = values(i, 3)
      end do
    end subroutine hold_net

  end subroutine write_frame

  !> Write what is held if it is time to. To be called every few milliseconds of a run.
  subroutine write_when_due(writer, error)
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    if (allocated(error) .or. writer%held == 0) return
    if (.not. writer%published .or. sum(writer%series%held_bytes) >= hold_bytes .or. &
        wall_seconds() - writer%held_since >= hold_seconds) call flush_run(writer, error)
  end subroutine write_when_due

  !> Keep a row of /history; it reaches the file with the next frames or flush.
  subroutine write_history(writer, row, error)
    type(run_writer_t), intent(inout) :: writer
    type(history_row_t), intent(in) :: row
    type(error_t), allocatable, intent(inout) :: error
    if (allocated(error)) return
    call store_row(writer%history, row)
    if (is_block_full(writer%history)) call flush_run(writer, error)
  end subroutine write_history

  !> Write all frames and rows that wait, and flush: from here on a kill cannot take them
  !> away. To be called before a checkpoint is written, so that the file is never behind it.
  subroutine flush_run(writer, error)
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    integer :: i
    if (allocated(error)) return
    if (waiting_rows(writer%history) == 0 .and. writer%held == 0 .and. writer%published) return
    call reserve(writer, frame_growth(writer, writer%held) &
                 + history_growth(writer%history, int(waiting_rows(writer%history), i8)), error)
    if (allocated(error)) return
    do i = 1, n_series
      if (writer%has(i)) call write_held(writer%file, writer%series(i), error)
    end do
    if (allocated(writer%vtk)) call write_vtkhdf(writer%vtk, writer%file, error)
    call write_rows(writer%history, writer%file, error)
    call flush_file(writer%file, error)
    writer%held = 0
    if (.not. writer%published) call publish(writer, error)
  end subroutine flush_run

  !> Give the file the name that others know; an earlier run's file and checkpoints go only now.
  subroutine publish(writer, error)
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    integer :: number
    if (allocated(error)) return
    number = rename_file(writer%file%path, writer%part)
    if (number /= 0) call file_failure(error, number, 'cannot create', writer%part)
    if (allocated(error)) return
    writer%file%path = writer%part
    writer%published = .true.
    if (writer%fresh) call clear_leftovers(writer%path)
  end subroutine publish

  !> Write /summary and the status, close, and rename OUTPUT.part to OUTPUT when the run is
  !> complete. May be called with an error at hand: then the file is closed as well as it
  !> can be and the first error stays.
  subroutine close_run(writer, summary, status, error)
    type(run_writer_t), intent(inout) :: writer
    type(summary_t), intent(in) :: summary
    character(len=*), intent(in) :: status        !! status_complete, status_stopped, status_failed
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem
    integer :: number
    if (.not. writer%file%is_open) return
    call flush_run(writer, problem)
    if (allocated(problem) .and. .not. allocated(error)) call move_alloc(problem, error)
    if (allocated(problem)) deallocate (problem)
    call reserve(writer, 0_i8, problem)
    if (.not. allocated(problem)) then
      call write_summary(writer%file, summary, problem)
      call end_meta(writer%file, writer%session, status, problem)
    end if
    if (allocated(problem) .and. .not. allocated(error)) call move_alloc(problem, error)
    call close_everything(writer, error)
    if (writer%published) then
      number = release_space(writer%part)
    else
      number = remove_file(writer%file%path)
    end if
    if (allocated(error) .or. status /= status_complete) return
    number = sync_path(writer%part)
    if (number == 0) number = rename_file(writer%part, writer%path)
    if (number /= 0) call file_failure(error, number, "cannot finish '"//writer%path//"' from", writer%part, &
                                       'the file is complete: rename it yourself')
    number = sync_path(folder_of(writer%path)//'.')
  end subroutine close_run

  !> Bytes that a new run's file takes in the end, at most.
  pure integer(i8) function run_bytes(writer)
    type(run_writer_t), intent(in) :: writer
    run_bytes = writer%expected
  end function run_bytes

  !> Close a run that is of no use and take its file away.
  subroutine discard_run(writer)
    type(run_writer_t), intent(inout) :: writer
    integer :: ignored
    if (.not. writer%file%is_open) return
    call close_quietly(writer)
    ignored = remove_file(writer%file%path)
  end subroutine discard_run

  subroutine close_everything(writer, error)
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    integer :: i
    do i = 1, n_series
      call close_series(writer%file, writer%series(i))
    end do
    if (allocated(writer%history)) call close_history(writer%history, writer%file)
    ! Before anything is removed: what is made after could take its place while readers still see it.
    call tell_scales(writer%file, error)
    if (allocated(writer%vtk)) call close_vtkhdf(writer%vtk, writer%file)
    call close_file(writer%file, error)
  end subroutine close_everything

  subroutine close_quietly(writer)
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable :: ignored
    call close_everything(writer, ignored)
  end subroutine close_quietly

end module castnet_run_writer
