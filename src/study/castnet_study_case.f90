!> One case of a study: from its number to a scene, a run, and a row of the table; where the
!> study asks for it, also the run's own file.
!>
!> Cases run side by side. What must not stands in the one lock `castnet_text`: HDF5, which
!> is not thread-safe, and everything that makes text. gfortran (12) keeps the length that a
!> function with a result of deferred length returns in static storage, so two threads that
!> call such a function at one place may cut each other's text short - and a value that is
!> set by its text would be another value. The stepping makes no text but for an error.
module castnet_study_case
  use castnet_kinds, only: wp, i8
  use castnet_diagnostics, only: largest_tension
  use castnet_error, only: error_t, fail, exit_done, exit_input, exit_numerical, exit_file
  use castnet_model_builder, only: file_net_t
  use castnet_posix, only: path_kind, path_file
  use castnet_problems, only: problem_list_t
  use castnet_record, only: summary_t
  use castnet_run_writer, only: run_writer_t, close_run, discard_run, run_bytes, status_complete, status_failed
  use castnet_runner, only: run_options_t, run_ledger_t, open_writer, observe
  use castnet_scene, only: scene_t
  use castnet_scene_check, only: finish_scene
  use castnet_scene_files, only: data_contents
  use castnet_scene_net, only: load_scene_net
  use castnet_scene_schema, only: set_key
  use castnet_scene_text, only: effective_scene
  use castnet_setup, only: overlap_words
  use castnet_signals, only: stop_request_code
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, take_measures, frame_taken, summarise
  use castnet_stable_step, only: spectrum_memory_t
  use castnet_study_design, only: design_t, case_point, case_values, case_seed
  use castnet_study_record, only: case_row_t, case_done, case_invalid, case_failed
  use castnet_study_request, only: study_request_t, is_search
  use castnet_text, only: to_text, text_t
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none
  private
  public :: case_setting_t, run_case, run_file, has_run_file, expected_run_bytes

  integer, parameter :: steps_per_look = 256      !! between two looks at the signals

  !> What all cases of a study share.
  type :: case_setting_t
    type(study_request_t) :: request
    type(scene_t) :: base                         !! unresolved, so that defaults follow varied keys
    type(design_t) :: design
    character(len=:), allocatable :: folder       !! of the runs' own files, with its final '/'; not allocated: none
    type(run_options_t) :: run                    !! what these files say of the program
  end type case_setting_t

contains

  !> One capture from a case's number to its row. `finished` is false when a signal came.
  !> Errors: exit_file, of the run's own file alone; a case that fails is a row.
  subroutine run_case(setting, memory, case, value, row, finished, error)
    type(case_setting_t), intent(in) :: setting
    type(spectrum_memory_t), intent(inout) :: memory !! of this thread's cases before
    integer(i8), intent(in) :: case
    real(wp), intent(in) :: value              !! of the searched key
    type(case_row_t), intent(out) :: row
    logical, intent(out) :: finished
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t) :: scene
    type(simulation_t) :: sim
    type(run_writer_t) :: writer
    type(run_ledger_t) :: ledger
    type(error_t), allocatable :: problem
    real(wp) :: spin_before, max_tension

    finished = .true.
    call start_case(setting, memory, case, value, row, scene, sim, problem)
    if (allocated(problem)) then
      call refuse(row, case_invalid, problem)
      return
    end if
    spin_before = 0.0_wp
    if (allocated(sim%state%target)) spin_before = length(sim%state%target%angular_velocity)
    if (allocated(setting%folder)) then
      call open_run_file(setting, case, scene, sim, writer, error)
      if (allocated(error)) return
    else
      sim%history_interval = max(sim%model%end_time, sim%model%step)   ! no rows: the tally runs on
    end if
    call advance_case(sim, writer, allocated(setting%folder), ledger, max_tension, finished, problem, error)
    if (allocated(problem)) then
      call refuse(row, merge(case_failed, case_invalid, problem%code == exit_numerical), problem)
    else if (finished) then
      row%status = case_done
      call measure_case(sim, ledger, spin_before, max_tension, row)
    end if
    if (allocated(setting%folder)) call close_run_file(sim, writer, finished, problem, error)
  end subroutine run_case

  !> From a case's number to a run at t = 0. A net that starts inside the target is refused:
  !> where a single run warns, no one reads the warnings of thousands.
  subroutine start_case(setting, memory, case, value, row, scene, sim, problem)
    type(case_setting_t), intent(in) :: setting
    type(spectrum_memory_t), intent(inout) :: memory
    integer(i8), intent(in) :: case
    real(wp), intent(in) :: value
    type(case_row_t), intent(out) :: row
    type(scene_t), intent(out) :: scene
    type(simulation_t), intent(out) :: sim
    type(error_t), allocatable, intent(inout) :: problem
    type(file_net_t), allocatable :: file_net

    row%case = case
    row%point = case_point(setting%design, case)
    row%seed = case_seed(setting%design, case)
    !$omp critical (castnet_text)
    call set_case(setting, case, value, row, scene, problem)
    if (.not. allocated(problem)) call load_scene_net(scene, file_net, problem)
    !$omp end critical (castnet_text)
    if (.not. allocated(problem)) call start(sim, scene, 1, file_net, problem, memory=memory)
    if (allocated(problem) .or. sim%report%overlap_node == 0) return
    !$omp critical (castnet_text)
    call fail(problem, exit_input, overlap_words(sim%report))
    !$omp end critical (castnet_text)
  end subroutine start_case

  !> The base scene with a case's values.
  subroutine set_case(setting, case, value, row, scene, problem)
    type(case_setting_t), intent(in) :: setting
    integer(i8), intent(in) :: case
    real(wp), intent(in) :: value
    type(case_row_t), intent(inout) :: row
    type(scene_t), intent(out) :: scene
    type(error_t), allocatable, intent(inout) :: problem
    type(problem_list_t) :: warnings
    type(text_t), allocatable :: text(:)
    real(wp), allocatable :: number(:)
    integer :: i
    scene = setting%base
    call case_values(setting%design, setting%request, case, text, number)
    row%varied = number
    do i = 1, setting%design%n_vary
      call set_key(scene, trim(setting%request%vary(i)%key), text(i)%chars, problem)
    end do
    if (is_search(setting%request)) then
      row%varied = [number, value]
      call set_key(scene, trim(setting%request%search%key), to_text(value), problem)
    end if
    if (allocated(scene%perturb)) scene%perturb%seed = row%seed
    if (.not. allocated(problem)) call finish_scene(scene, warnings, problem)
  end subroutine set_case

  !> Step to the end, or until a signal. What the table keeps is taken at the frames, with
  !> or without a file, so that the file does not change the table.
  subroutine advance_case(sim, writer, keeps_file, ledger, max_tension, finished, problem, error)
    type(simulation_t), intent(inout) :: sim
    type(run_writer_t), intent(inout) :: writer
    logical, intent(in) :: keeps_file
    type(run_ledger_t), intent(inout) :: ledger
    real(wp), intent(out) :: max_tension              !! [N]
    logical, intent(out) :: finished
    type(error_t), allocatable, intent(inout) :: problem !! of the run
    type(error_t), allocatable, intent(inout) :: error   !! of its file
    type(due_t) :: due

    max_tension = 0.0_wp
    finished = .true.
    do
      call run_to_next(sim, due, problem, steps_per_look)
      if (allocated(problem)) return
      if (due%frame .and. allocated(sim%model%net)) max_tension = max(max_tension, &
        largest_tension(sim%model%net, sim%state%node_position, sim%state%node_velocity))
      if (keeps_file) then
        if (due%frame .or. due%row .or. due%verdict) then
          !$omp critical (castnet_text)
          call observe(sim, due, writer, ledger, error)
          !$omp end critical (castnet_text)
          if (allocated(error)) return
        end if
      else
        if (due%verdict) call take_measures(sim)
        if (due%frame) call frame_taken(sim)
        if (due%row) sim%state%schedule%row_step = sim%state%step
      end if
      if (is_finished(sim)) return
      if (stop_request_code() /= exit_done) then
        finished = .false.
        return
      end if
    end do
  end subroutine advance_case

  !> First line of the reason, and nothing measured.
  subroutine refuse(row, status, error)
    type(case_row_t), intent(inout) :: row
    integer, intent(in) :: status
    type(error_t), intent(in) :: error
    integer :: n
    row%status = status
    row%measure = ieee_value(1.0_wp, ieee_quiet_nan)
    n = index(error%message, new_line('a'))
    if (n == 0) n = len(error%message) + 1
    row%reason = error%message(:n - 1)
  end subroutine refuse

  !> The measures in the order of castnet_study_record. Rows of a history take the tally
  !> with them; then the ledger has what it held.
  subroutine measure_case(sim, ledger, spin_before, max_tension, row)
    type(simulation_t), intent(in) :: sim
    type(run_ledger_t), intent(in) :: ledger
    real(wp), intent(in) :: spin_before, max_tension
    type(case_row_t), intent(inout) :: row
    type(summary_t) :: summary
    real(wp) :: nan, spin, speed
    integer :: n

    nan = ieee_value(nan, ieee_quiet_nan)
    summary = summarise(sim, 0.0_wp)
    row%measure = nan
    n = size(summary%measures)
    row%measure(1) = merge(1.0_wp, 0.0_wp, summary%captured)
    if (n > 0) then
      associate (m => summary%measures(n))
        row%measure(2:10) = [real(m%verdict, wp), m%coverage, m%largest_hole, m%escape, m%cqi, m%mouth_area, &
                             m%mouth_perimeter, m%bullet_distance_min, m%bullet_distance_max]
      end associate
    end if
    row%measure(11) = summary%first_contact
    if (allocated(sim%state%target)) then
      spin = length(sim%state%target%angular_velocity)
      speed = length(sim%state%target%velocity)
      row%measure(12:14) = [spin, speed, spin - spin_before]
    end if
    row%measure(15) = max(sim%state%tally%max_impulse, ledger%max_impulse)
    row%measure(16) = max_tension
    row%measure(17) = max(sim%state%tally%deepest_penetration, ledger%deepest_penetration)
    row%measure(18) = real(sim%state%step, wp)
  end subroutine measure_case

  ! ---- the run's own file ---------------------------------------------------------------

  !> FOLDER/case_000001.h5
  pure function run_file(folder, case) result(path)
    character(len=*), intent(in) :: folder
    integer(i8), intent(in) :: case
    character(len=:), allocatable :: path, number
    number = to_text(case)
    path = folder//'case_'//repeat('0', max(0, 6 - len(number)))//number//'.h5'
  end function run_file

  !> Is the file of a case that was run to its end there?
  logical function has_run_file(folder, case)
    character(len=*), intent(in) :: folder
    integer(i8), intent(in) :: case
    has_run_file = path_kind(run_file(folder, case)) == path_file
  end function has_run_file

  !> An old file of the same case is replaced: it is the same run.
  subroutine open_run_file(setting, case, scene, sim, writer, error)
    type(case_setting_t), intent(in) :: setting
    integer(i8), intent(in) :: case
    type(scene_t), intent(in) :: scene
    type(simulation_t), intent(in) :: sim
    type(run_writer_t), intent(inout) :: writer
    type(error_t), allocatable, intent(inout) :: error
    type(run_options_t) :: options
    options = setting%run
    !$omp critical (castnet_text)
    options%output = run_file(setting%folder, case)
    call open_writer(sim, scene, effective_scene(scene), data_contents(scene), options, writer, error)
    !$omp end critical (castnet_text)
    if (allocated(error)) error%code = exit_file
  end subroutine open_run_file

  !> A run that a signal cut short is done anew: its file goes. One that failed keeps its
  !> .part, with the last good frames.
  subroutine close_run_file(sim, writer, finished, problem, error)
    type(simulation_t), intent(in) :: sim
    type(run_writer_t), intent(inout) :: writer
    logical, intent(in) :: finished
    type(error_t), allocatable, intent(in) :: problem
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: status
    status = status_complete
    if (allocated(problem)) status = status_failed
    !$omp critical (castnet_text)
    if (finished .and. .not. allocated(error)) then
      call close_run(writer, summarise(sim, 0.0_wp), status, error)
    else
      call discard_run(writer)
    end if
    !$omp end critical (castnet_text)
  end subroutine close_run_file

  !> Bytes that the file of one case takes, at most; 0 when the case cannot be started.
  !> Writes that file and takes it away again. Errors: exit_file.
  integer(i8) function expected_run_bytes(setting, case, value, error) result(bytes)
    type(case_setting_t), intent(in) :: setting
    integer(i8), intent(in) :: case
    real(wp), intent(in) :: value
    type(error_t), allocatable, intent(inout) :: error
    type(case_row_t) :: row
    type(scene_t) :: scene
    type(simulation_t) :: sim
    type(run_writer_t) :: writer
    type(error_t), allocatable :: problem
    type(spectrum_memory_t) :: memory
    bytes = 0
    call start_case(setting, memory, case, value, row, scene, sim, problem)
    if (allocated(problem)) return
    call open_run_file(setting, case, scene, sim, writer, error)
    if (allocated(error)) return
    bytes = run_bytes(writer)
    call discard_run(writer)
  end function expected_run_bytes

  pure real(wp) function length(a)
    real(wp), intent(in) :: a(3)
    length = sqrt(a(1)**2 + a(2)**2 + a(3)**2)
  end function length

end module castnet_study_case
