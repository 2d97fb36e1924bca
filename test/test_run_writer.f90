!> The output file, with a small net and a box that a test makes up. What Python and VTK
!> see is held by test/system/test_output.py; here: shapes, counts, restart, full disk.
module test_run_writer
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, exit_file
  use castnet_model, only: model_t
  use castnet_state, only: state_t
  use castnet_surface, only: surface_t
  use castnet_record, only: history_row_t, summary_t
  use castnet_posix, only: path_kind, path_nothing, path_file, process_id, remove_file
  use castnet_text, only: to_text
  use castnet_hdf5_file, only: hdf5_file_t, open_hdf5, close_file
  use castnet_hdf5_reader, only: dataset_t, ask_dataset, read_doubles, read_longs, class_none
  use castnet_run_writer, only: run_writer_t, run_info_t, open_run, reopen_run, write_frame, write_history, flush_run, &
                                close_run, status_complete, status_stopped
  use testing, only: test_case, expect, expect_close, expect_equal
  implicit none
  private
  public :: run_test_run_writer

contains

  subroutine run_test_run_writer()
    call test_case('run_writer: every frame and row of a complete run', test_complete_run)
    call test_case('run_writer: a stopped run goes on behind its checkpoint', test_restart)
    call test_case('run_writer: parts that a scene lacks are not in the file', test_parts)
    call test_case('run_writer: a folder that is not there is an error, not a crash', test_no_folder)
  end subroutine run_test_run_writer

  function scratch(name) result(path)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: path
    path = '/tmp/castnet_'//to_text(process_id())//'_'//name
  end function scratch

  !> Three nodes, two cables, padding behind; a tetrahedron for a target.
  subroutine make_model(model, state, surface)
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(surface_t), intent(out) :: surface
    allocate (model%net)
    associate (net => model%net)
      net%n_node = 3
      net%n_pad = 8
      net%n_cable = 2
      net%node_mass = [1.0_wp, 2.0_wp, 3.0_wp]
      net%fixed = [.false., .true., .false.]
      net%cable_nodes = reshape([1, 2, 2, 3], [2, 2])
      net%natural_length = [0.5_wp, 0.6_wp]
      net%axial_stiffness = [10.0_wp, 20.0_wp]
      net%damping = [0.1_wp, 0.2_wp]
      net%bullet_nodes = [1, 3]
      allocate (net%faces(4, 0))
    end associate
    allocate (model%target)
    model%target%mass = 4.0_wp
    model%step = 1.0e-3_wp
    surface%vertex = reshape([0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, &
                              0.0_wp, 0.0_wp, 1.0_wp], [3, 4])
    surface%triangle = reshape([1, 3, 2, 1, 2, 4, 1, 4, 3, 2, 3, 4], [3, 4])
    allocate (state%node_position(8, 3), state%node_velocity(8, 3), state%target)
    state%node_position = 0.0_wp
    state%node_velocity = 0.0_wp
  end subroutine make_model

  !> A state that tells its frame in every number.
  subroutine move_to(state, frame)
    type(state_t), intent(inout) :: state
    integer, intent(in) :: frame
    integer :: i, k
    state%time = 0.25_wp*frame
    do k = 1, 3
      do i = 1, 3
        state%node_position(i, k) = 100.0_wp*frame + 10.0_wp*i + k
        state%node_velocity(i, k) = -state%node_position(i, k)
      end do
    end do
    if (.not. allocated(state%target)) return
    state%target%position = [1.0_wp, 2.0_wp, 3.0_wp]*frame
    state%target%angular_velocity = [0.0_wp, 0.0_wp, 1.0_wp*frame]
  end subroutine move_to

  subroutine write_some(writer, model, state, first, last, error)
    type(run_writer_t), intent(inout) :: writer
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    integer, intent(in) :: first, last
    type(error_t), allocatable, intent(inout) :: error
    type(history_row_t) :: row
    integer :: frame, k
    do frame = first, last
      call move_to(state, frame)
      do k = 0, 1
        row%time = 0.25_wp*frame + 0.125_wp*k
        row%elastic = 2.0_wp*frame + k
        row%contacts = 1000_i8*frame + k
        row%angular_momentum = [1.0_wp, 2.0_wp, 3.0_wp]*(2*frame + k)
        call write_history(writer, row, error)
      end do
      call write_frame(writer, model, state, [1.0_wp*frame, 2.0_wp*frame], error)
    end do
  end subroutine write_some

  !> Compare a whole dataset with values in the order of the file.
  subroutine expect_dataset(path, name, values)
    character(len=*), intent(in) :: path, name
    real(wp), intent(in) :: values(:)
    type(hdf5_file_t) :: file
    type(dataset_t) :: found
    type(error_t), allocatable :: error
    real(wp), allocatable :: seen(:)
    call open_hdf5(file, path, .false., error)
    found = ask_dataset(file, name)
    call expect(found%class /= class_none, name//' is there')
    if (found%class /= class_none) then
      call read_doubles(file, name, found%n_value, seen, error)
      call expect_close(seen, values, name, atol=0.0_wp)
    end if
    call close_file(file, error)
    call expect_no(error)
  end subroutine expect_dataset

  subroutine expect_no(error)
    type(error_t), allocatable, intent(in) :: error
    if (allocated(error)) call expect(.false., 'no error; seen: '//error%message)
  end subroutine expect_no

  !> Frames 0 to n-1 of write_some.
  subroutine expect_frames(path, n)
    character(len=*), intent(in) :: path
    integer, intent(in) :: n
    integer :: f, i, k
    call expect_dataset(path, '/time', [(0.25_wp*f, f=0, n - 1)])
    call expect_dataset(path, '/node_position', [(((100.0_wp*f + 10.0_wp*i + k, k=1, 3), i=1, 3), f=0, n - 1)])
    call expect_dataset(path, '/cable_tension', [((1.0_wp*f*i, i=1, 2), f=0, n - 1)])
    call expect_dataset(path, '/target_position', [((1.0_wp*f*i, i=1, 3), f=0, n - 1)])
    call expect_dataset(path, '/history/time', [(0.125_wp*f, f=0, 2*n - 1)])
    call expect_dataset(path, '/history/contacts', [((1000.0_wp*f + k, k=0, 1), f=0, n - 1)])
    call expect_dataset(path, '/history/angular_momentum', [((1.0_wp*f*i, i=1, 3), f=0, 2*n - 1)])
    call expect_dataset(path, '/VTKHDF/Steps/Values', [(0.25_wp*f, f=0, n - 1)])
    call expect_dataset(path, '/VTKHDF/Steps/PointOffsets', [(7.0_wp*f, f=0, n - 1)])
    call expect_dataset(path, '/VTKHDF/CellData/tension', &
                        [(1.0_wp*f, 2.0_wp*f, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, f=0, n - 1)])
  end subroutine expect_frames

  subroutine test_complete_run()
    type(run_writer_t) :: writer
    type(model_t) :: model
    type(state_t) :: state
    type(surface_t) :: surface
    type(run_info_t) :: info
    type(summary_t) :: summary
    type(error_t), allocatable :: error
    character(len=:), allocatable :: path
    integer :: ignored
    path = scratch('complete.h5')
    call make_model(model, state, surface)
    info%version = 'test'
    call open_run(writer, path, repeat('! a long scene'//new_line('a'), 10000), '&time /', model, surface, info, error)
    call write_some(writer, model, state, 0, 299, error)
    call expect_equal(path_kind(path), path_nothing, 'OUTPUT before the end')
    allocate (summary%measures(2))
    summary%measures%time = [1.0_wp, 2.0_wp]
    summary%measures%coverage = [0.5_wp, 0.75_wp]
    summary%measures%verdict = [0, 2]
    summary%self_contacts = [120_i8, 7_i8, 0_i8]
    call close_run(writer, summary, status_complete, error)
    call expect_no(error)
    call expect_equal(path_kind(path), path_file, 'OUTPUT at the end')
    call expect_equal(path_kind(path//'.part'), path_nothing, 'OUTPUT.part at the end')
    call expect_frames(path, 300)
    call expect_dataset(path, '/static/cable_nodes', [0.0_wp, 1.0_wp, 1.0_wp, 2.0_wp])
    call expect_dataset(path, '/static/bullet_nodes', [0.0_wp, 2.0_wp])
    call expect_dataset(path, '/summary/coverage', [0.5_wp, 0.75_wp])
    call expect_dataset(path, '/summary/verdict', [0.0_wp, 2.0_wp])
    call expect_dataset(path, '/summary/self_contacts', [120.0_wp])
    call expect_dataset(path, '/summary/self_contacts_taut', [7.0_wp])
    ignored = remove_file(path)
  end subroutine test_complete_run

  subroutine test_restart()
    type(run_writer_t) :: writer
    type(model_t) :: model
    type(state_t) :: state
    type(surface_t) :: surface
    type(run_info_t) :: info
    type(summary_t) :: summary
    type(error_t), allocatable :: error
    character(len=:), allocatable :: path
    integer :: ignored
    path = scratch('restart.h5')
    call make_model(model, state, surface)
    call open_run(writer, path, 'scene', 'effective', model, surface, info, error)
    call write_some(writer, model, state, 0, 9, error)
    call close_run(writer, summary, status_stopped, error)
    call expect_equal(path_kind(path), path_nothing, 'OUTPUT of a stopped run')
    call expect_frames(path//'.part', 10)
    info%checkpoint = 'some.checkpoint'
    info%schedule%frames = 6
    info%schedule%rows = 12
    call reopen_run(writer, path, 'effective', model, surface, info, error)
    call write_some(writer, model, state, 6, 12, error)
    call close_run(writer, summary, status_complete, error)
    call expect_no(error)
    call expect_frames(path, 13)
    ignored = remove_file(path)
    ! a new file for the rest, stopped, and continued in its turn
    call open_run(writer, path, 'scene', 'effective', model, surface, info, error)
    call write_some(writer, model, state, 6, 12, error)
    call close_run(writer, summary, status_stopped, error)
    info%schedule%frames = 8
    info%schedule%rows = 16
    call reopen_run(writer, path, 'effective', model, surface, info, error)
    call close_run(writer, summary, status_complete, error)
    call expect_no(error)
    call expect_dataset(path, '/time', [1.5_wp, 1.75_wp])
    call expect_dataset(path, '/history/time', [1.5_wp, 1.625_wp, 1.75_wp, 1.875_wp])
    ignored = remove_file(path)
    ! the checkpoint is ahead of the file
    call open_run(writer, path, 'scene', 'effective', model, surface, info, error)
    call close_run(writer, summary, status_stopped, error)
    call expect_no(error)
    info%schedule%frames = 9
    call reopen_run(writer, path, 'effective', model, surface, info, error)
    call expect(allocated(error), 'a file that ends before the checkpoint is refused')
    if (allocated(error)) call expect_equal(error%code, exit_file, 'exit code')
    if (allocated(error)) deallocate (error)
    info%schedule%frames = 0
    info%schedule%rows = 0
    call reopen_run(writer, path, '&net', model, surface, info, error)
    call expect(allocated(error), 'a file of another scene is refused')
    ignored = remove_file(path//'.part')
  end subroutine test_restart

  subroutine test_parts()
    type(run_writer_t) :: writer
    type(model_t) :: model
    type(state_t) :: state
    type(surface_t) :: surface
    type(run_info_t) :: info
    type(summary_t) :: summary
    type(hdf5_file_t) :: file
    type(dataset_t) :: found
    type(error_t), allocatable :: error
    character(len=:), allocatable :: path
    real(wp), allocatable :: no_tension(:)
    integer :: ignored
    path = scratch('parts.h5')
    call make_model(model, state, surface)
    deallocate (model%net)
    allocate (no_tension(0))
    call open_run(writer, path, 'scene', 'effective', model, surface, info, error)
    call write_frame(writer, model, state, no_tension, error)
    call close_run(writer, summary, status_complete, error)
    call expect_no(error)
    call open_hdf5(file, path, .false., error)
    found = ask_dataset(file, '/node_position')
    call expect_equal(found%class, class_none, 'node_position without a net')
    found = ask_dataset(file, '/cable')
    call expect_equal(found%class, class_none, 'cable without a net')
    found = ask_dataset(file, '/target_attitude')
    call expect_equal(int(found%n_value), 4, 'one attitude')
    call close_file(file, error)
    ignored = remove_file(path)
    call make_model(model, state, surface)
    deallocate (model%target, state%target)
    info%vtk = .false.
    call open_run(writer, path, 'scene', 'effective', model, info=info, error=error)
    call write_frame(writer, model, state, [1.0_wp, 2.0_wp], error)
    call close_run(writer, summary, status_complete, error)
    call expect_no(error)
    call open_hdf5(file, path, .false., error)
    found = ask_dataset(file, '/target_attitude')
    call expect_equal(found%class, class_none, 'target_attitude without a target')
    found = ask_dataset(file, '/VTKHDF/Points')
    call expect_equal(found%class, class_none, 'VTKHDF when not asked for')
    call close_file(file, error)
    ignored = remove_file(path)
  end subroutine test_parts

  subroutine test_no_folder()
    type(run_writer_t) :: writer
    type(model_t) :: model
    type(state_t) :: state
    type(surface_t) :: surface
    type(run_info_t) :: info
    type(error_t), allocatable :: error
    call make_model(model, state, surface)
    call open_run(writer, scratch('nowhere')//'/a.h5', 'scene', 'effective', model, surface, info, error)
    call expect(allocated(error), 'an error')
    if (allocated(error)) call expect_equal(error%code, exit_file, 'exit code')
  end subroutine test_no_folder

end module test_run_writer
