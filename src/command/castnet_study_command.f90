!> castnet study and castnet collect.
module castnet_study_command
  use castnet_kinds, only: i8
  use castnet_command_line, only: options_t
  use castnet_error, only: error_t
  use castnet_log, only: log_t, new_log, log_result, log_warning
  use castnet_scene, only: scene_t
  use castnet_output_files, only: check_csv, protect_inputs
  use castnet_scene_file, only: read_scene
  use castnet_scene_files, only: scene_files
  use castnet_study, only: study_options_t, run_study, collect_study, journal_path
  use castnet_study_file, only: read_study
  use castnet_study_request, only: study_request_t, is_search
  use castnet_terminal, only: warn_lines
  use castnet_text, only: path_beside, text_t, without_extension, to_text
  use castnet_version, only: version_number, git_commit, compiler_name, compiler_flags
  use omp_lib, only: omp_get_max_threads
  implicit none
  private
  public :: study_file, collect_file

contains

  !> Run a study, or what is missing of it.
  subroutine study_file(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(study_request_t) :: request
    type(scene_t) :: base
    type(study_options_t) :: study
    type(log_t) :: log

    call prepare(options, request, base, study, error)
    if (allocated(error)) return
    call new_log(log, options%quiet, .not. options%no_progress)
    call run_study(request, base, study, log, error)
    if (allocated(error)) return
    if (study%shards > 1) then
      call log_result(log, 'cases            '//journal_path(study%output, study%shard, study%shards)// &
                      '; castnet collect makes the table of all shards')
    else
      call log_result(log, 'output           '//study%output)
    end if
  end subroutine study_file

  !> Put what there is of a study into its table.
  subroutine collect_file(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(study_request_t) :: request
    type(scene_t) :: base
    type(study_options_t) :: study
    type(log_t) :: log
    integer(i8) :: missing

    call prepare(options, request, base, study, error)
    if (allocated(error)) return
    call new_log(log, options%quiet, .not. options%no_progress)
    call collect_study(request, base, study, log, missing, error)
    if (allocated(error)) return
    if (missing > 0 .and. is_search(request)) then
      call log_warning(log, to_text(missing)//' searches are not finished; run castnet study for them')
    else if (missing > 0) then
      call log_warning(log, to_text(missing)//' cases are missing; run castnet study for them')
    end if
    call log_result(log, 'output           '//study%output)
  end subroutine collect_file

  subroutine prepare(options, request, base, study, error)
    type(options_t), intent(in) :: options
    type(study_request_t), intent(out) :: request
    type(scene_t), intent(out) :: base
    type(study_options_t), intent(out) :: study
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: warnings

    call read_study(options%files(1)%chars, options%overrides, request, warnings, error)
    if (allocated(error)) return
    call warn_lines(warnings)
    call read_scene(path_beside(request%path, trim(request%study%scene)), request%scene_overrides, base, warnings, error, &
                    resolve=.false.)
    if (allocated(error)) return
    study%output = without_extension(request%path)//'.h5'
    if (len_trim(request%study%file) > 0) study%output = path_beside(request%path, trim(request%study%file))
    if (allocated(options%output)) study%output = options%output
    call protect_study_inputs(study%output, journal_path(study%output, options%shard, options%shards), request, base, error)
    if (allocated(error)) return
    study%threads = options%threads
    if (study%threads < 1) study%threads = omp_get_max_threads()
    study%shard = options%shard
    study%shards = options%shards
    study%max_wall = options%max_wall
    study%force = options%force
    study%version = version_number//' '//git_commit()
    study%compiler = compiler_name()
    study%flags = compiler_flags()
  end subroutine prepare

  !> Neither the table nor the CSV nor the journal may be a file that the study reads.
  subroutine protect_study_inputs(output, journal, request, base, error)
    character(len=*), intent(in) :: output, journal
    type(study_request_t), intent(in) :: request
    type(scene_t), intent(in) :: base
    type(error_t), allocatable, intent(inout) :: error
    type(text_t), allocatable :: inputs(:)
    type(text_t) :: own(1)
    call scene_files(base, inputs)
    own(1)%chars = request%path
    call protect_inputs(output, [character(len=4) :: '', '.tmp'], inputs, error)
    call protect_inputs(output, [character(len=4) :: '', '.tmp'], own, error)
    call protect_inputs(journal, [character(len=5) :: '', '.lock'], inputs, error)
    call protect_inputs(journal, [character(len=5) :: '', '.lock'], own, error)
    call check_csv(output, inputs, error)
    call check_csv(output, own, error)
  end subroutine protect_study_inputs

end module castnet_study_command
