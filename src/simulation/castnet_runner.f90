!> A run with its files: the loop of castnet_simulation, and whoever looks on.
module castnet_runner
  use castnet_kinds, only: wp, i8
  use castnet_checkpoint, only: write_checkpoint, read_checkpoint, checkpoint_path
  use castnet_diagnostics, only: cable_tensions
  use castnet_error, only: error_t, fail, exit_stopped, exit_done, exit_numerical
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t
  use castnet_monitors, only: watch_t, watch_row, watch_rest, tell_watch
  use castnet_lock, only: lock_t, take_lock, release_lock
  use castnet_log, only: log_t, log_note, log_warning, log_progress, progress_is_due, &
                         end_progress
  use castnet_output_files, only: check_output, protect_inputs, can_continue, stage_part
  use castnet_posix, only: wall_seconds
  use castnet_process_guard, only: guard_thread
  use castnet_record, only: summary_t, history_row_t
  use castnet_renumber, only: in_original_order
  use castnet_restart_check, only: check_same_scene
  use castnet_run_writer, only: run_writer_t, run_info_t, open_run, reopen_run, write_frame, write_history, &
                                write_when_due, flush_run, close_run, status_complete, status_stopped, status_failed
  use castnet_scene, only: scene_t
  use castnet_scene_files, only: data_contents, check_same_contents
  use castnet_scene_net, only: load_scene_net
  use castnet_setup, only: overlap_words
  use castnet_shape, only: tessellate
  use castnet_signals, only: install_signal_handlers, stop_request_code
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, take_measures, take_row, &
                                frame_taken, summarise, guard
  use castnet_state, only: state_t
  use castnet_surface, only: surface_t
  use castnet_text, only: to_text, text_t
  implicit none
  private
  public :: run_options_t, run_ledger_t, run_scene, prepare_scene, open_writer, observe

  !> Node-steps between two looks at the signals and the clock: some milliseconds at the
  !> most, a single step of a large net.
  integer, parameter :: node_steps_per_look = 200000

  !> What the command line says about a run.
  type :: run_options_t
    character(len=:), allocatable :: output     !! OUTPUT
    character(len=:), allocatable :: restart    !! checkpoint to go on from; not allocated: from t = 0
    integer :: threads = 1
    real(wp) :: max_wall = huge(1.0_wp)         !! [s]
    logical :: force = .false.                  !! replace an existing OUTPUT
    logical :: timings = .false.                !! measure the stages of a step
    type(text_t), allocatable :: inputs(:)      !! files that the run reads, never overwritten
    character(len=:), allocatable :: version, compiler, flags
  end type run_options_t

  !> What a run's history says in one look, for the run log.
  type :: run_ledger_t
    type(history_row_t) :: first, last
    real(wp) :: largest_rise = 0.0_wp         !! of energy less the works done on it, between two rows [J]
    real(wp) :: min_impulse = 0.0_wp          !! [N s]
    real(wp) :: max_impulse = 0.0_wp          !! bullets excluded [N s]
    real(wp) :: deepest_penetration = 0.0_wp  !! [m]
    real(wp) :: contact_residual = 0.0_wp     !! [m/s]
    real(wp) :: max_tension = 0.0_wp          !! [N]
    type(watch_t) :: watch
    logical :: started = .false.
  end type run_ledger_t

contains

  !> Everything before the first step: the net's file, model, state, step. Touches no file
  !> but reads. For `run` and `check` alike.
  subroutine prepare_scene(scene, n_thread, sim, error, resumed)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: n_thread
    type(simulation_t), intent(out) :: sim
    type(error_t), allocatable, intent(inout) :: error
    type(state_t), intent(in), optional :: resumed
    type(file_net_t), allocatable :: file_net

    call load_scene_net(scene, file_net, error)
    if (allocated(error)) return
    call start(sim, scene, n_thread, file_net, error, resumed)
  end subroutine prepare_scene

  !> Run a scene to its end, or until something stops it. Errors carry the exit code; what
  !> was written before stays.
  subroutine run_scene(scene, effective_text, options, log, sim, summary, ledger, error)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: effective_text  !! the scene with every default
    type(run_options_t), intent(in) :: options
    type(log_t), intent(inout) :: log
    type(simulation_t), intent(out) :: sim
    type(summary_t), intent(out) :: summary
    type(run_ledger_t), intent(out) :: ledger
    type(error_t), allocatable, intent(inout) :: error
    type(state_t), allocatable :: resumed
    type(lock_t) :: lock
    type(text_t) :: checkpoint(1)
    character(len=:), allocatable :: before, held, contents, warning

    call check_output(options%output, options%inputs, options%force, allocated(options%restart), error)
    if (allocated(error)) return
    contents = data_contents(scene)
    if (allocated(options%restart)) then
      checkpoint(1)%chars = options%restart
      call protect_inputs(options%output, [character(len=5) :: '', '.part', '.tmp', '.lock'], checkpoint, error)
      if (allocated(error)) return
      allocate (resumed)
      call read_checkpoint(options%restart, resumed, before, held, warning, error)
      if (allocated(error)) return
      if (allocated(warning)) call log_warning(log, warning)
      call check_same_scene(before, effective_text, options%restart, error)
      call check_same_contents(held, contents, options%restart, error)
      if (allocated(error)) return
    end if
    call prepare_scene(scene, options%threads, sim, error, resumed)
    if (allocated(error)) return
    if (sim%report%unstable) call log_warning(log, 'time/step: '//to_text(sim%report%step)// &
      ' s is above the stability limit, '//to_text(sim%report%stable_limit)//' s; the scene allows it')
    if (sim%report%overlap_node > 0 .and. .not. allocated(options%restart)) call log_warning(log, overlap_words(sim%report))
    call log_note(log, 'step '//to_text(sim%model%step)//' s, '//sim%report%reason)
    call take_lock(lock, options%output, error)
    if (allocated(error)) return
    call install_signal_handlers()
    !$omp parallel num_threads(options%threads)
    call guard_thread()
    !$omp end parallel
    call run_locked(scene, effective_text, contents, options, log, sim, summary, ledger, error)
    call release_lock(lock)
  end subroutine run_scene

  !> The run proper, with its files to itself.
  subroutine run_locked(scene, effective_text, contents, options, log, sim, summary, ledger, error)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: effective_text, contents
    type(run_options_t), intent(in) :: options
    type(log_t), intent(inout) :: log
    type(simulation_t), intent(inout) :: sim
    type(summary_t), intent(inout) :: summary
    type(run_ledger_t), intent(inout) :: ledger
    type(error_t), allocatable, intent(inout) :: error
    type(run_writer_t) :: writer
    type(due_t) :: due
    character(len=:), allocatable :: status
    real(wp) :: began, now, next_wall
    integer :: stop_code, look

    began = wall_seconds()
    call open_writer(sim, scene, effective_text, contents, options, writer, error)
    if (allocated(error)) return
    look = 64
    if (allocated(sim%model%net)) look = max(1, min(look, node_steps_per_look/max(1, sim%model%net%n_node)))
    sim%work%timings%wanted = options%timings
    next_wall = huge(1.0_wp)
    if (scene%output%checkpoint_wall_interval > 0.0_wp) next_wall = began + scene%output%checkpoint_wall_interval
    stop_code = exit_done
    do
      call run_to_next(sim, due, error, look)
      if (allocated(error)) exit
      call observe(sim, due, writer, ledger, error)
      call write_when_due(writer, error)
      if (due%row) call tell_progress(log, sim)
      if (allocated(error) .or. is_finished(sim)) exit
      stop_code = stop_request_code()
      now = wall_seconds()
      if (stop_code == exit_done .and. now - began > options%max_wall) stop_code = exit_stopped
      if (due%checkpoint .or. stop_code /= exit_done .or. now > next_wall) then
        call take_checkpoint(sim, writer, options%output, effective_text, contents, error)
        if (scene%output%checkpoint_wall_interval > 0.0_wp) &
          next_wall = wall_seconds() + scene%output%checkpoint_wall_interval
      end if
      if (allocated(error) .or. stop_code /= exit_done) exit
    end do
    call end_progress(log)
    call watch_rest(ledger%watch, sim%state, threshold_of(sim%model))
    call tell_watch(log, ledger%watch)

    if (allocated(error)) then
      if (error%code == exit_numerical) call tell_what_is_left(error, options%output, sim%state)
    end if
    status = status_complete
    if (stop_code /= exit_done) status = status_stopped
    if (allocated(error)) status = status_failed
    summary = summarise(sim, wall_seconds() - began)
    call close_run(writer, summary, status, error)
    if (stop_code /= exit_done) call fail(error, stop_code, 'stopped at t = '//to_text(sim%state%time)// &
      ' s; go on with --restart '//checkpoint_path(options%output))
  end subroutine run_locked

  !> Where a run that failed can be looked at, and what it can go on from.
  subroutine tell_what_is_left(error, output, state)
    type(error_t), intent(inout) :: error
    character(len=*), intent(in) :: output
    type(state_t), intent(in) :: state
    error%message = error%message//'; the frames before are in '//output//'.part'
    if (state%schedule%checkpoints > 0) then
      error%message = error%message//', the last good checkpoint, '//checkpoint_path(output)//', is of step '// &
                      to_text(state%schedule%checkpoint_step)
    else
      error%message = error%message//'; no checkpoint was due before'
    end if
  end subroutine tell_what_is_left

  subroutine tell_progress(log, sim)
    type(log_t), intent(inout) :: log
    type(simulation_t), intent(in) :: sim
    real(wp) :: fraction
    fraction = sim%state%time/sim%model%end_time
    if (progress_is_due(log, fraction)) call log_progress(log, fraction, &
      't = '//to_text(sim%state%time)//' s of '//to_text(sim%model%end_time)//' s')
  end subroutine tell_progress

  !> A new output file, or the one that the checkpoint's run left.
  subroutine open_writer(sim, scene, effective_text, contents, options, writer, error)
    type(simulation_t), intent(in) :: sim
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: effective_text, contents
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
    info%contents = contents
    info%compiler = options%compiler
    info%flags = options%flags
    info%threads = options%threads
    info%vtk = scene%output%vtk
    info%step = sim%state%step
    info%time = sim%state%time
    info%schedule = sim%state%schedule
    if (allocated(options%restart)) info%checkpoint = options%restart
    info%expected_frames = info%schedule%frames &
                           + ceiling((sim%model%end_time - sim%state%time)/sim%frame_interval, i8) + 1
    info%expected_rows = info%schedule%rows &
                         + ceiling((sim%model%end_time - sim%state%time)/sim%history_interval, i8) + 1
    if (allocated(options%restart)) then
      if (can_continue(options%output)) then
        call stage_part(options%output, error)
        call open_shown(.true.)
        return
      end if
    end if
    call open_shown(.false.)

  contains

    !> With the numbers of the file; a model that has them is not copied.
    subroutine open_shown(again)
      logical, intent(in) :: again
      if (is_renumbered(sim%model)) then
        call open_model(shown_model(sim%model), again)
      else
        call open_model(sim%model, again)
      end if
    end subroutine open_shown

    subroutine open_model(model, again)
      type(model_t), intent(in) :: model
      logical, intent(in) :: again
      if (again) then
        call reopen_run(writer, options%output, effective_text, model, surface, info, error)
      else
        call open_run(writer, options%output, scene%text, effective_text, model, surface, info, error)
      end if
    end subroutine open_model

  end subroutine open_writer

  !> Everything that is due at this step.
  subroutine observe(sim, due, writer, ledger, error)
    type(simulation_t), intent(inout) :: sim
    type(due_t), intent(in) :: due
    type(run_writer_t), intent(inout) :: writer
    type(run_ledger_t), intent(inout) :: ledger
    type(error_t), allocatable, intent(inout) :: error
    type(history_row_t) :: row
    real(wp), allocatable :: tension(:)

    if (due%verdict) call take_measures(sim)
    if (due%row) then
      row = take_row(sim)
      call enter(ledger, row)
      call watch_row(ledger%watch, row, threshold_of(sim%model))
      call write_history(writer, row, error)
    end if
    if (.not. due%frame) return
    if (allocated(sim%model%net)) then
      allocate (tension(sim%model%net%n_cable))
      call cable_tensions(sim%model%net, sim%state%node_position, sim%state%node_velocity, tension)
    else
      allocate (tension(0))
    end if
    if (is_renumbered(sim%model)) then
      call write_frame(writer, sim%model, shown_state(sim), tension, error)
    else
      call write_frame(writer, sim%model, sim%state, tension, error)
    end if
    call frame_taken(sim)
  end subroutine observe

  !> Contact threshold [m]; 0: there is no contact.
  pure real(wp) function threshold_of(model)
    type(model_t), intent(in) :: model
    threshold_of = 0.0_wp
    if (allocated(model%contact)) threshold_of = model%contact%threshold
  end function threshold_of

  !> Were the nodes of a net from a file renumbered for the kernel? Whatever is written
  !> carries the numbers of the file.
  pure logical function is_renumbered(model)
    type(model_t), intent(in) :: model
    is_renumbered = .false.
    if (allocated(model%net)) is_renumbered = allocated(model%net%original_node)
  end function is_renumbered

  function shown_model(model) result(shown)
    type(model_t), intent(in) :: model
    type(model_t) :: shown
    shown = model
    shown%net = in_original_order(model%net)
  end function shown_model

  function shown_state(sim) result(shown)
    type(simulation_t), intent(in) :: sim
    type(state_t) :: shown
    shown = sim%state
    associate (order => sim%model%net%original_node)
      shown%node_position(order, :) = sim%state%node_position(:size(order), :)
      shown%node_velocity(order, :) = sim%state%node_velocity(:size(order), :)
    end associate
  end function shown_state

  subroutine enter(ledger, row)
    type(run_ledger_t), intent(inout) :: ledger
    type(history_row_t), intent(in) :: row
    if (.not. ledger%started) then
      ledger%first = row
    else
      ledger%largest_rise = max(ledger%largest_rise, own_energy(row) - own_energy(ledger%last))
    end if
    ledger%started = .true.
    ledger%last = row
    ledger%min_impulse = min(ledger%min_impulse, row%min_impulse)
    ledger%max_impulse = max(ledger%max_impulse, row%max_impulse)
    ledger%deepest_penetration = max(ledger%deepest_penetration, row%deepest_penetration)
    ledger%contact_residual = max(ledger%contact_residual, row%contact_residual)
    ledger%max_tension = max(ledger%max_tension, row%max_tension)
  end subroutine enter

  !> Energy less all work done on it: what never rises [J].
  pure real(wp) function own_energy(row)
    type(history_row_t), intent(in) :: row
    own_energy = row%kinetic_net + row%kinetic_target + row%elastic &
                 - row%winch_work - row%projection_work - row%external_work
  end function own_energy

  !> A sound state only; the file first, so that it is never behind the checkpoint.
  subroutine take_checkpoint(sim, writer, output, effective_text, contents, error)
    type(simulation_t), intent(inout) :: sim
    type(run_writer_t), intent(inout) :: writer
    character(len=*), intent(in) :: output, effective_text, contents
    type(error_t), allocatable, intent(inout) :: error
    call guard(sim, error)
    if (allocated(error)) return
    call flush_run(writer, error)
    sim%state%schedule%checkpoints = sim%state%schedule%checkpoints + 1
    sim%state%schedule%checkpoint_step = sim%state%step
    call write_checkpoint(output, sim%state, effective_text, contents, error)
  end subroutine take_checkpoint

end module castnet_runner
