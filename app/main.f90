!> castnet: one call, one exit code. The process ends through the C library, because
!> Fortran's own `stop` talks on standard error.
program main
  use, intrinsic :: iso_c_binding, only: c_int
  use castnet_commands, only: run_command
  implicit none
  interface
    subroutine end_process(code) bind(c, name='exit')
      import :: c_int
      integer(c_int), value :: code
    end subroutine end_process
  end interface
  integer :: code
  code = run_command()
  call end_process(int(code, c_int))
end program main
