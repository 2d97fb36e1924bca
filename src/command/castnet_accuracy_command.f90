!> castnet accuracy: speed against error of the methods on a scene.
module castnet_accuracy_command
  use castnet_accuracy, only: accuracy_t, measure_accuracy
  use castnet_accuracy_table, only: write_accuracy, accuracy_sentence
  use castnet_command_line, only: options_t
  use castnet_error, only: error_t
  use castnet_log, only: log_t, new_log, log_note
  use castnet_output_files, only: check_output, check_csv
  use castnet_scene, only: scene_t
  use castnet_scene_file, only: read_scene
  use castnet_scene_files, only: scene_files
  use castnet_scene_text, only: effective_scene
  use castnet_terminal, only: say, warn_lines
  use castnet_text, only: text_t, without_extension
  use castnet_version, only: version_number, git_commit
  implicit none
  private
  public :: accuracy_file

contains

  !> Read the scene, fly it with every setting, tell the conclusion. Files: OUTPUT, by
  !> default the scene's name with .accuracy.h5, and the CSV beside it.
  subroutine accuracy_file(options, error)
    type(options_t), intent(in) :: options
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t) :: scene
    type(accuracy_t) :: result
    type(log_t) :: log
    type(text_t), allocatable :: inputs(:)
    character(len=:), allocatable :: warnings, path
    call read_scene(options%files(1)%chars, options%overrides, scene, warnings, error)
    if (allocated(error)) return
    call warn_lines(warnings)
    path = without_extension(scene%path)//'.accuracy.h5'
    if (allocated(options%output)) path = options%output
    call scene_files(scene, inputs)
    call check_output(path, inputs, options%force, .false., error)
    call check_csv(path, inputs, error)
    if (allocated(error)) return
    call new_log(log, options%quiet, .not. options%no_progress)
    call measure_accuracy(scene, max(1, options%threads), log, result, error)
    if (allocated(error)) return
    call write_accuracy(path, effective_scene(scene), version_number//' '//git_commit(), result, error)
    if (allocated(error)) return
    call log_note(log, 'output '//path)
    call say(accuracy_sentence(result))
  end subroutine accuracy_file

end module castnet_accuracy_command
