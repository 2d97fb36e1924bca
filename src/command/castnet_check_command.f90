!> castnet check: is the scene (or study) sound, and what would run? Writes no file.
module castnet_check_command
  use castnet_command_line, only: options_t
  use castnet_error, only: error_t, fail, exit_done, exit_input
  use castnet_kinds, only: wp, i8
  use castnet_model_builder, only: file_net_t
  use castnet_posix, only: wall_seconds
  use castnet_run_command, only: output_path
  use castnet_scene, only: scene_t
  use castnet_scene_check, only: net_node_count
  use castnet_scene_file, only: read_scene_text
  use castnet_scene_net, only: load_scene_net
  use castnet_scene_text, only: effective_scene
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished
  use castnet_study_file, only: read_study_text, effective_study, is_study_text
  use castnet_setup, only: overlap_words
  use castnet_study_request, only: study_request_t, grid_size, is_search
  use castnet_terminal, only: warn_lines, say, tell
  use castnet_text, only: to_text, rounded_text, duration_text, path_beside
  use castnet_text_file, only: read_text_file
  implicit none
  private
  public :: check_files

  real(wp), parameter :: trial_seconds = 0.2_wp   !! of steps, to estimate the run's time

contains

  !> One file in detail; of several, each one's verdict.
  subroutine check_files(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    if (size(options%files) == 1) then
      call check_one(options, error)
    else
      call check_many(options, error)
    end if
  end subroutine check_files

  subroutine check_one(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t) :: scene
    character(len=:), allocatable :: warnings, path, text
    call read_text_file(options%files(1)%chars, text, error)
    if (allocated(error)) return
    if (is_study_text(text)) then
      call check_study_file(text, options, error)
      return
    end if
    call read_scene_text(text, options%files(1)%chars, options%overrides, scene, warnings, error)
    if (allocated(error)) return
    call warn_lines(warnings)
    call output_path(scene, options, path, error)
    if (allocated(error)) return
    if (options%effective) then
      call say(effective_scene(scene))
      return
    end if
    call check_run(scene, path, max(1, options%threads), error)
  end subroutine check_one

  !> A study: its points and runs.
  subroutine check_study_file(text, options, error)
    character(len=*), intent(in) :: text
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(study_request_t) :: request
    character(len=:), allocatable :: warnings
    integer :: i
    call read_study_text(text, options%files(1)%chars, options%overrides, request, warnings, error)
    if (allocated(error)) return
    call warn_lines(warnings)
    if (options%effective) then
      call say(effective_study(request))
      return
    end if
    call say('study            '//request%path//': sound')
    call say('scene            '//path_beside(request%path, trim(request%study%scene)))
    call say('question         '//trim(request%study%question))
    do i = 1, size(request%vary)
      call say('varies           '//trim(request%vary(i)%key)//', '//how_varied(request, i))
    end do
    if (is_search(request)) call say('searches         '//trim(request%search%key)//', '// &
      to_text(planned_runs(request)/request%search%budget)//' times, of at most '//to_text(request%search%budget)//' runs')
    if (is_search(request)) then
      call say('runs             at most '//to_text(planned_runs(request)))
    else
      call say('runs             '//to_text(planned_runs(request)))
    end if
    if (request%study%record == 'runs') call say('record           each run''s own file beside the table')
    call say('output           '//path_beside(request%path, trim(request%study%file)))
  end subroutine check_study_file

  !> Runs of a map; for a search, the most that it may use.
  function planned_runs(request) result(runs)
    type(study_request_t), intent(in) :: request
    integer(i8) :: runs
    integer :: i
    runs = request%study%seeds
    if (is_search(request)) runs = request%search%budget
    if (request%sample%kind == 'grid') then
      do i = 1, size(request%vary)
        runs = runs*max(1, grid_size(request%vary(i)))
      end do
    else
      runs = runs*max(1, request%sample%points)
    end if
  end function planned_runs

  !> Where the values of a varied key come from.
  function how_varied(request, i) result(text)
    type(study_request_t), intent(in) :: request
    integer, intent(in) :: i
    character(len=:), allocatable :: text
    associate (v => request%vary(i))
      if (request%sample%kind /= 'grid') then
        text = 'one value for each of '//to_text(request%sample%points)//' points of the design'
      else if (grid_size(v) > 0) then
        text = to_text(grid_size(v))//' values'
      else
        text = 'drawn anew for each run'
      end if
    end associate
  end function how_varied

  !> Set the run up, try a few steps, and tell what it would be.
  subroutine check_run(scene, path, threads, error)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: path
    integer, intent(in) :: threads
    type(error_t), allocatable, intent(inout) :: error
    type(simulation_t) :: sim
    type(file_net_t), allocatable :: file_net
    real(wp) :: seconds
    call load_scene_net(scene, file_net, error)
    if (allocated(error)) return
    call start(sim, scene, threads, file_net, error)
    if (allocated(error)) return
    call say('scene            '//scene%path//': sound')
    if (allocated(sim%model%net)) then
      call say('net              '//to_text(sim%model%net%n_node)//' nodes, '//to_text(sim%model%net%n_cable)//' cables, '// &
               rounded_text(sum(sim%model%net%node_mass, .not. sim%model%net%is_bullet), 5)//' kg without bullets')
      call say('highest frequency '//rounded_text(sim%report%spectrum%highest_frequency, 5)//' rad/s, largest damping rate '// &
               rounded_text(sim%report%spectrum%largest_damping_rate, 5)//' 1/s')
      call say('stable step      '//rounded_text(sim%report%stable_limit, 5)//' s ('//trim(scene%time%method)//')')
    end if
    if (allocated(sim%model%target)) call say('target           '//trim(scene%target%shape)//', '// &
      rounded_text(sim%model%target%mass, 5)//' kg'//trim(merge(', fixed', '       ', scene%target%fixed)))
    call say('step             '//to_text(sim%model%step)//' s, '//sim%report%reason)
    if (sim%report%unstable) call warn_lines('the step is above the stability limit')
    if (sim%report%overlap_node > 0) call warn_lines(overlap_words(sim%report))
    call say('steps            '//to_text(sim%last_step)//' to t = '//to_text(scene%time%end_time)//' s')
    call estimate_seconds(sim, seconds)
    if (seconds >= 0.0_wp) call say('estimated time   '//duration_text(seconds)//' without contact, '//to_text(threads)// &
                                    ' thread'//trim(merge('s', ' ', threads > 1)))
    call say('output           '//path)
  end subroutine check_run

  !> Wall seconds of the whole run, from a few of its first steps; negative: not known.
  subroutine estimate_seconds(sim, seconds)
    type(simulation_t), intent(inout) :: sim
    real(wp), intent(out) :: seconds
    type(error_t), allocatable :: error
    type(due_t) :: due
    real(wp) :: began
    integer(i8) :: steps
    sim%state%schedule%frame_step = 0       ! the start is taken
    sim%state%schedule%verdicts = size(sim%verdict_times)
    seconds = -1.0_wp
    steps = sim%state%step
    began = wall_seconds()
    do
      call run_to_next(sim, due, error, 16)
      if (allocated(error)) return
      if (is_finished(sim) .or. wall_seconds() - began > trial_seconds) exit
    end do
    seconds = (wall_seconds() - began)*real(sim%last_step, wp)/real(max(1_i8, sim%state%step - steps), wp)
  end subroutine estimate_seconds

  !> Each file's verdict, and with --effective its effective text, on standard output;
  !> exit code 2 if any is refused.
  subroutine check_many(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    integer :: i, refused, code
    refused = 0
    code = exit_input
    do i = 1, size(options%files)
      call check_quickly(options%files(i)%chars, options, refused, code)
    end do
    if (refused > 0) call fail(error, code, to_text(refused)//' of '//to_text(size(options%files))//' files refused')
  end subroutine check_many

  !> One of several files. Runs of small nets are set up, too.
  subroutine check_quickly(path, options, refused, code)
    character(len=*), intent(in) :: path
    type(options_t), intent(in) :: options
    integer, intent(inout) :: refused, code
    type(scene_t) :: scene
    type(study_request_t) :: request
    type(error_t), allocatable :: error
    character(len=:), allocatable :: warnings, text
    logical :: is_study
    is_study = .false.
    call read_text_file(path, text, error)
    if (.not. allocated(error)) then
      is_study = is_study_text(text)
      if (is_study) then
        call read_study_text(text, path, options%overrides, request, warnings, error)
      else
        call read_scene_text(text, path, options%overrides, scene, warnings, error)
        if (.not. allocated(error)) call set_up_small(scene, error)
      end if
    end if
    if (allocated(error)) then
      refused = refused + 1
      if (error%code /= exit_input) code = error%code
      call say('=== '//path//': refused')
      call tell(error%message)
      return
    end if
    call say('=== '//path//': accepted')
    if (.not. options%effective) return
    if (is_study) then
      call say(effective_study(request))
    else
      call say(effective_scene(scene))
    end if
  end subroutine check_quickly

  !> Build the run, unless its net is too large for a quick look.
  subroutine set_up_small(scene, error)
    type(scene_t), intent(in) :: scene
    type(error_t), allocatable, intent(inout) :: error
    type(simulation_t) :: sim
    type(file_net_t), allocatable :: file_net
    real(wp), parameter :: small_net = 2000.0_wp
    call load_scene_net(scene, file_net, error)
    if (allocated(error)) return
    if (allocated(scene%net) .and. .not. allocated(file_net)) then
      if (net_node_count(scene) > small_net) return
    end if
    call start(sim, scene, 1, file_net, error)
  end subroutine set_up_small

end module castnet_check_command
