!> castnet: one call, one exit code.
program main
  use castnet_commands, only: run_command
  use castnet_process_guard, only: guard_process, end_process
  implicit none
  call guard_process()
  call end_process(run_command())
end program main
