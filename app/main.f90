!> Until the command layer lands: castnet run SCENE [--output FILE] [--set group/key=value].
program main
  use, intrinsic :: iso_fortran_env, only: error_unit
  use castnet_error, only: error_t
  use castnet_record, only: summary_t
  use castnet_runner, only: run_options_t, run_scene
  use castnet_scene, only: scene_t
  use castnet_scene_file, only: read_scene
  use castnet_scene_text, only: effective_scene
  use castnet_simulation, only: simulation_t
  use castnet_text, only: text_t
  implicit none
  type(scene_t) :: scene
  type(run_options_t) :: options
  type(simulation_t) :: sim
  type(summary_t) :: summary
  type(error_t), allocatable :: error
  type(text_t), allocatable :: overrides(:)
  character(len=:), allocatable :: warnings
  character(len=4096) :: word, path
  integer :: i, n
  n = 0
  do i = 1, command_argument_count()
    call get_command_argument(i, word)
    if (word == '--set') n = n + 1
  end do
  allocate (overrides(n))
  n = 0
  call get_command_argument(2, path)
  i = 3
  do while (i < command_argument_count())
    call get_command_argument(i, word)
    if (word == '--output') then
      call get_command_argument(i + 1, word)
      options%output = trim(word)
    else if (word == '--set') then
      call get_command_argument(i + 1, word)
      n = n + 1
      overrides(n)%chars = trim(word)
    end if
    i = i + 2
  end do
  call read_scene(trim(path), overrides, scene, warnings, error)
  if (.not. allocated(error)) then
    if (len(warnings) > 0) write (error_unit, '(a)') warnings
    if (.not. allocated(options%output)) options%output = trim(scene%output%file)
    options%version = 'unknown'
    options%compiler = 'unknown'
    options%flags = 'unknown'
    call run_scene(scene, effective_scene(scene), options, sim, summary, error)
  end if
  if (allocated(error)) then
    write (error_unit, '(a)') 'castnet: '//error%message
    call exit(error%code)
  end if
  print *, 'first contact', summary%first_contact, ' captured ', summary%captured, ' wall', summary%wall_time
  do i = 1, size(summary%measures)
    print *, summary%measures(i)
  end do
end program main
