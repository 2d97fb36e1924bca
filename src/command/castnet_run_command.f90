!> castnet run: a scene file to a file of results.
module castnet_run_command
  use castnet_command_line, only: options_t
  use castnet_error, only: error_t, fail, exit_input, exit_file
  use castnet_posix, only: same_file
  use castnet_record, only: summary_t
  use castnet_log, only: log_t, new_log
  use castnet_run_report, only: report_result, report_ledger, report_timings
  use castnet_runner, only: run_options_t, run_ledger_t, run_scene
  use castnet_scene, only: scene_t
  use castnet_scene_file, only: read_scene
  use castnet_scene_files, only: scene_files
  use castnet_scene_text, only: effective_scene
  use castnet_simulation, only: simulation_t
  use castnet_terminal, only: warn_lines
  use castnet_text, only: path_beside
  use castnet_version, only: version_number, git_commit, compiler_name, compiler_flags
  implicit none
  private
  public :: run_file, output_path

contains

  !> Read the scene, run it, tell what came out.
  subroutine run_file(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t) :: scene
    type(run_options_t) :: run
    type(simulation_t) :: sim
    type(summary_t) :: summary
    type(run_ledger_t) :: ledger
    type(log_t) :: log
    character(len=:), allocatable :: warnings
    call read_scene(options%files(1)%chars, options%overrides, scene, warnings, error)
    if (allocated(error)) return
    call warn_lines(warnings)
    call output_path(scene, options, run%output, error)
    if (allocated(error)) return
    if (allocated(options%restart)) run%restart = options%restart
    run%threads = max(1, options%threads)
    run%max_wall = options%max_wall
    run%force = options%force
    run%timings = options%timings
    run%version = version_number//' '//git_commit()
    run%compiler = compiler_name()
    run%flags = compiler_flags()
    call scene_files(scene, run%inputs)
    call new_log(log, options%quiet, .not. options%no_progress)
    call run_scene(scene, effective_scene(scene), run, log, sim, summary, ledger, error)
    ! When a file failed, that is what is to be seen.
    if (allocated(error)) then
      if (error%code == exit_file) return
    end if
    if (ledger%started) call report_ledger(log, sim, ledger)
    if (options%timings) call report_timings(log, sim, summary)
    if (allocated(error)) return
    call report_result(log, run%output, sim, summary)
  end subroutine run_file

  !> --output wins over the scene; the scene's own path is seen from the scene's folder.
  subroutine output_path(scene, options, path, error)
    type(scene_t), intent(in) :: scene
    type(options_t), intent(in) :: options
    character(len=:), allocatable, intent(out) :: path
    type(error_t), allocatable, intent(inout) :: error
    path = path_beside(scene%path, trim(scene%output%file))
    if (allocated(options%output)) path = options%output
    if (path(len(path):) == '/') then
      call fail(error, exit_input, '--output: seen '//path//', a folder; allowed: a file')
    else if (path == scene%path .or. same_file(path, scene%path)) then
      call fail(error, exit_input, '--output: seen '//path//', which would overwrite the scene itself')
    end if
  end subroutine output_path

end module castnet_run_command
