!> How the process begins and ends: whatever ends it in another way than `end_process` is
!> told to the user as a bug of ours, exit code 1 (in the C file beside this one).
module castnet_process_guard
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  private
  public :: guard_process, end_process

  interface
    !> To be called first: crashes and errors of the Fortran runtime end in one sentence.
    subroutine guard_process() bind(c, name='castnet_guard_process')
    end subroutine guard_process

    subroutine castnet_end_process(code) bind(c)
      import :: c_int
      integer(c_int), value :: code
    end subroutine castnet_end_process
  end interface

contains

  !> End the process. Through the C library: Fortran's own `stop` talks on standard error.
  subroutine end_process(code)
    integer, intent(in) :: code
    call castnet_end_process(int(code, c_int))
  end subroutine end_process

end module castnet_process_guard
