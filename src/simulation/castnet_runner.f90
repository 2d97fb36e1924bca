!> A run with its files: the loop of castnet_simulation, and whoever looks on.
module castnet_runner
  use castnet_kinds, only: wp, i8
  use castnet_diagnostics, only: cable_tensions
  use castnet_error, only: error_t, fail, exit_stopped, exit_done
  use castnet_model_builder, only: file_net_t
  use castnet_posix, only: wall_seconds
  use castnet_record, only: summary_t
  use castnet_run_writer, only: run_writer_t, run_info_t, open_run, write_frame, write_history, close_run, &
                                status_complete, status_stopped, status_failed
  use castnet_scene, only: scene_t
  use castnet_scene_net, only: load_scene_net
  use castnet_shape, only: tessellate
  use castnet_signals, only: install_signal_handlers, stop_request_code
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, take_measures, take_row, &
                                frame_taken, summarise
  use castnet_surface, only: surface_t
  implicit none
  private
  public :: run_options_t, run_scene

  !> Steps between two looks at the signals and the clock.
  integer, parameter :: look_interval = 64

  !> What the command line says about a run.
  type :: run_options_t
    character(len=:), allocatable :: output     !! OUTPUT
    character(len=:), allocatable :: restart    !! checkpoint to go on from; not allocated: from t = 0
    integer :: threads = 1
    real(wp) :: max_wall = huge(1.0_wp)         !! [s]
    logical :: force = .false.                  !! replace an existing OUTPUT
    logical :: quiet = .false.
    logical :: progress = .true.
    logical :: timings = .false.
    character(len=:), allocatable :: version, compiler, flags
  end type run_options_t

contains

  !> Run a scene to its end, or until something stops it. Errors carry the exit code.
  subroutine run_scene(scene, effective_text, options, sim, summary, error)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: effective_text  !! the scene with every default
    type(run_options_t), intent(in) :: options
    type(simulation_t), intent(out) :: sim
    type(summary_t), intent(out) :: summary
    type(error_t), allocatable, intent(inout) :: error
    type(run_writer_t) :: writer
    type(file_net_t), allocatable :: file_net
    type(due_t) :: due
    character(len=:), allocatable :: status
    real(wp) :: began
    integer :: stop_code

    began = wall_seconds()
    call load_scene_net(scene, file_net, error)
    if (allocated(error)) return
    call start(sim, scene, options%threads, file_net, error)
    if (allocated(error)) return
    call open_writer(sim, scene, effective_text, options, writer, error)
    if (allocated(error)) return
    call install_signal_handlers()

    stop_code = exit_done
    do
      call run_to_next(sim, due, error, look_interval)
      if (allocated(error)) exit
      call observe(sim, due, writer, error)
      if (allocated(error) .or. is_finished(sim)) exit
      stop_code = stop_request_code()
      if (stop_code == exit_done .and. wall_seconds() - began > options%max_wall) stop_code = exit_stopped
      if (stop_code /= exit_done) exit
    end do

    status = status_complete
    if (stop_code /= exit_done) status = status_stopped
    if (allocated(error)) status = status_failed
    summary = summarise(sim, wall_seconds() - began)
    call close_run(writer, summary, status, error)
    if (stop_code /= exit_done) call fail(error, stop_code, 'stopped at t = ')
  end subroutine run_scene

  subroutine open_writer(sim, scene, effective_text, options, writer, error)
    type(simulation_t), intent(in) :: sim
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: effective_text
    type(run_options_t), intent(in) :: options
    type(run_writer_t), intent(out) :: writer
    type(error_t), allocatable, intent(inout) :: error
    type(surface_t), allocatable :: surface
    type(run_info_t) :: info

    if (allocated(sim%model%target)) then
      allocate (surface)
      call tessellate(sim%model%target%shape, surface)
    end if
    info%version = options%version
    info%compiler = options%compiler
    info%flags = options%flags
    info%threads = options%threads
    info%vtk = scene%output%vtk
    info%expected_frames = ceiling(sim%model%end_time/sim%frame_interval, i8) + 1
    info%expected_rows = ceiling(sim%model%end_time/sim%history_interval, i8) + 1
    call open_run(writer, options%output, scene%text, effective_text, sim%model, surface, info, error)
  end subroutine open_writer

  !> Everything that is due at this step.
  subroutine observe(sim, due, writer, error)
    type(simulation_t), intent(inout) :: sim
    type(due_t), intent(in) :: due
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    real(wp), allocatable :: tension(:)

    if (due%verdict) call take_measures(sim)
    if (due%row) call write_history(writer, take_row(sim), error)
    if (.not. due%frame) return
    if (allocated(sim%model%net)) then
      allocate (tension(sim%model%net%n_cable))
      call cable_tensions(sim%model%net, sim%state%node_position, sim%state%node_velocity, tension)
    else
      allocate (tension(0))
    end if
    call write_frame(writer, sim%model, sim%state, tension, error)
    call frame_taken(sim)
  end subroutine observe

end module castnet_runner
