!> The run: step, guard, observe, until the end. One object holds it all, so that a study
!> can keep many side by side, each on its own thread; nothing here touches a file.
module castnet_simulation
  use castnet_kinds, only: wp, i8
  use castnet_capture_measures, only: measure_capture
  use castnet_deployment, only: begin_deployment, observe_deployment, deployment_of
  use castnet_diagnostics, only: record_history, impulse_percentiles
  use castnet_error, only: error_t
  use castnet_model, only: model_t, self_contact_count
  use castnet_model_builder, only: file_net_t
  use castnet_monitors, only: check_state, mechanical_energy
  use castnet_record, only: deployment_t, history_row_t, summary_t, thresholds_t, verdict_captured
  use castnet_scene, only: scene_t
  use castnet_setup, only: step_report_t, set_up
  use castnet_stable_step, only: spectrum_memory_t
  use castnet_state, only: state_t, tally_t
  use castnet_stepper, only: work_t, advance, meet, settle
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none
  private
  public :: simulation_t, due_t, start, run_to_next, is_finished, take_measures, take_row, frame_taken, summarise, guard

  !> Steps between two looks at the state's health.
  integer, parameter :: guard_interval = 64

  type :: simulation_t
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(thresholds_t) :: thresholds
    real(wp) :: frame_interval = 0.0_wp         !! [s]
    real(wp) :: history_interval = 0.0_wp       !! [s]
    real(wp) :: checkpoint_interval = 0.0_wp    !! simulated [s], 0: none
    real(wp), allocatable :: verdict_times(:)   !! ascending [s]
    real(wp) :: energy_start = 0.0_wp           !! kinetic and elastic at t = 0 [J]
    integer(i8) :: last_step = 0                !! the first step at or after end_time
  end type simulation_t

  !> Which observations are due now.
  type :: due_t
    logical :: frame = .false., row = .false., verdict = .false., checkpoint = .false.
  end type due_t

contains

  !> Set up a run at t = 0. Errors: those of `set_up`.
  subroutine start(sim, scene, n_thread, file_net, error, resumed, memory)
    type(simulation_t), intent(out) :: sim
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: n_thread
    type(file_net_t), allocatable, intent(inout) :: file_net
    type(error_t), allocatable, intent(inout) :: error
    type(state_t), intent(in), optional :: resumed !! go on from this state instead of t = 0
    type(spectrum_memory_t), intent(inout), optional :: memory !! of this thread's runs before
    integer(i8) :: taken

    call set_up(scene, n_thread, file_net, sim%model, sim%state, sim%work, sim%report, error, memory)
    if (allocated(error)) return
    ! At most one observation a step.
    sim%frame_interval = max(scene%output%frame_interval, sim%model%step)
    sim%history_interval = max(scene%output%history_interval, sim%model%step)
    if (scene%output%checkpoint_interval > 0.0_wp) &
      sim%checkpoint_interval = max(scene%output%checkpoint_interval, sim%model%step)
    sim%verdict_times = scene%output%verdict_times
    sim%energy_start = mechanical_energy(sim%model, sim%state)
    call begin_deployment(sim%model, sim%state)
    ! A node that starts within the threshold and approaches is in contact at once.
    if (allocated(sim%model%contact) .and. .not. present(resumed)) call meet(sim%model, sim%state, sim%work, error)
    if (present(resumed)) then
      taken = min(resumed%schedule%verdicts, size(sim%verdict_times, kind=i8))
      sim%state = resumed
      sim%state%schedule%verdicts = taken
      deallocate (sim%state%measures)
      allocate (sim%state%measures(size(sim%verdict_times)))
      sim%state%measures(:taken) = resumed%measures(:taken)
    end if
    sim%last_step = ceiling(sim%model%end_time/sim%model%step*(1.0_wp - 1.0e-12_wp), i8)
  end subroutine start

  !> Has the run reached its end?
  pure logical function is_finished(sim)
    type(simulation_t), intent(in) :: sim
    is_finished = sim%state%step >= sim%last_step
  end function is_finished

  !> Step until something is due, the end, or `most_steps`. Errors: exit 3 when the state is
  !> no longer sound.
  subroutine run_to_next(sim, due, error, most_steps)
    type(simulation_t), intent(inout) :: sim
    type(due_t), intent(out) :: due
    type(error_t), allocatable, intent(inout) :: error
    integer, intent(in), optional :: most_steps
    integer(i8) :: until

    until = min(sim%last_step, next_due(sim, sim%frame_interval), next_due(sim, sim%history_interval))
    if (sim%checkpoint_interval > 0.0_wp) until = min(until, next_due(sim, sim%checkpoint_interval))
    if (sim%state%schedule%verdicts < size(sim%verdict_times)) &
      until = min(until, step_at(sim, sim%verdict_times(sim%state%schedule%verdicts + 1)))
    if (present(most_steps)) until = min(until, sim%state%step + most_steps)
    if (sim%state%schedule%frame_step < 0) until = sim%state%step    ! the start itself

    do while (sim%state%step < until)
      call advance(sim%model, sim%state, sim%work, error)
      if (allocated(error)) return
      if (modulo(sim%state%step, int(guard_interval, i8)) == 0) then
        call settle(sim%model, sim%state, sim%work)
        call guard(sim, error)
        if (allocated(error)) return
      end if
    end do
    call settle(sim%model, sim%state, sim%work)
    due = what_is_due(sim)
    if (due%frame .or. due%verdict) call guard(sim, error)
  end subroutine run_to_next

  !> What is due at the present step and has not been taken. The end is due for everything
  !> but a checkpoint.
  pure function what_is_due(sim) result(due)
    type(simulation_t), intent(in) :: sim
    type(due_t) :: due
    associate (state => sim%state, schedule => sim%state%schedule)
      due%frame = is_due(sim, sim%frame_interval) .and. schedule%frame_step < state%step
      due%row = is_due(sim, sim%history_interval) .and. schedule%row_step < state%step
      if (schedule%verdicts < size(sim%verdict_times)) due%verdict = is_finished(sim) .or. &
          state%step >= step_at(sim, sim%verdict_times(schedule%verdicts + 1))
      if (sim%checkpoint_interval > 0.0_wp) due%checkpoint = is_due(sim, sim%checkpoint_interval) .and. &
          schedule%checkpoint_step < state%step .and. .not. is_finished(sim)
    end associate
  end function what_is_due

  !> Is this step the first at or after a multiple of the interval, or the end?
  pure logical function is_due(sim, interval)
    type(simulation_t), intent(in) :: sim
    real(wp), intent(in) :: interval !! at least a step [s]
    integer(i8) :: k
    k = nint(sim%state%time/interval, i8)
    is_due = step_at(sim, k*interval) == sim%state%step .or. is_finished(sim)
    if (k > 0) is_due = is_due .or. step_at(sim, (k - 1)*interval) == sim%state%step
  end function is_due

  !> The first step after this one at which a multiple of the interval is due.
  pure integer(i8) function next_due(sim, interval) result(step)
    type(simulation_t), intent(in) :: sim
    real(wp), intent(in) :: interval !! at least a step [s]
    integer(i8) :: k
    k = max(0_i8, floor(sim%state%time/interval, i8) - 1)
    step = step_at(sim, k*interval)
    do while (step <= sim%state%step)
      k = k + 1
      step = step_at(sim, k*interval)
    end do
  end function next_due

  !> The first step at or after a time, to rounding.
  pure integer(i8) function step_at(sim, time)
    type(simulation_t), intent(in) :: sim
    real(wp), intent(in) :: time
    step_at = ceiling(time/sim%model%step*(1.0_wp - 1.0e-12_wp), i8)
  end function step_at

  !> Capture measures of every verdict that is due.
  subroutine take_measures(sim)
    type(simulation_t), intent(inout) :: sim
    type(due_t) :: due
    integer(i8) :: k
    do
      due = what_is_due(sim)
      if (.not. due%verdict) exit
      k = sim%state%schedule%verdicts + 1
      sim%state%measures(k) = measure_capture(sim%model, sim%state, k == 1, sim%thresholds)
      sim%state%schedule%verdicts = k
    end do
  end subroutine take_measures

  !> The history row of now; the tally begins anew.
  function take_row(sim) result(row)
    type(simulation_t), intent(inout) :: sim
    type(history_row_t) :: row
    real(wp) :: centre(3)
    row = record_history(sim%model, sim%state, centre)
    call observe_deployment(sim%model, sim%state, centre)
    sim%state%tally = tally_t()
    sim%state%schedule%rows = sim%state%schedule%rows + 1
    sim%state%schedule%row_step = sim%state%step
  end function take_row

  !> A frame of now has been taken.
  subroutine frame_taken(sim)
    type(simulation_t), intent(inout) :: sim
    sim%state%schedule%frames = sim%state%schedule%frames + 1
    sim%state%schedule%frame_step = sim%state%step
  end subroutine frame_taken

  !> What the whole run says.
  function summarise(sim, wall_time) result(summary)
    type(simulation_t), intent(in) :: sim
    real(wp), intent(in) :: wall_time !! [s]
    type(summary_t) :: summary
    real(wp) :: nan

    nan = ieee_value(nan, ieee_quiet_nan)
    summary%thresholds = sim%thresholds
    summary%measures = sim%state%measures(:sim%state%schedule%verdicts)
    summary%captured = size(summary%measures) > 0 .and. all(summary%measures%verdict == verdict_captured)
    if (allocated(sim%state%impulse_histogram)) summary%impulse_percentiles = impulse_percentiles(sim%state%impulse_histogram)
    summary%first_contact = merge(sim%state%first_contact, nan, sim%state%first_contact >= 0.0_wp)
    summary%closing_start = nan
    if (allocated(sim%state%closing)) then
      if (sim%state%closing%pulling) summary%closing_start = sim%state%closing%start_time
    end if
    if (allocated(sim%state%deployment)) then
      summary%deployment = deployment_of(sim%state%deployment, sim%model%net%flat_area)
    else
      summary%deployment = deployment_t(nan, nan, nan, nan, nan, nan)
    end if
    if (allocated(sim%state%self_contacts)) then
      summary%self_contacts = sim%state%self_contacts
      summary%keeps_cables_apart = sim%model%contact%self_contact /= self_contact_count
    end if
    summary%wall_time = wall_time
    summary%steps = sim%state%step
    summary%force_evaluations = sim%state%force_evaluations
  end function summarise

  !> The monitors that stop a run.
  subroutine guard(sim, error)
    type(simulation_t), intent(in) :: sim
    type(error_t), allocatable, intent(inout) :: error
    call check_state(sim%model, sim%state, sim%energy_start, error)
  end subroutine guard

end module castnet_simulation
