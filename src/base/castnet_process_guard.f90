!> How the process begins, speaks and ends: whatever ends it in another way than
!> `end_process` is told to the user as a bug of ours, exit code 1, and results that could
!> not be written are exit code 4 (in the C file beside this one).
module castnet_process_guard
  use, intrinsic :: iso_c_binding, only: c_int, c_char, c_int64_t
  implicit none
  private
  public :: guard_process, guard_thread, forget_refusal, end_process, print_line, print_error

  interface
    !> To be called first: crashes and errors of the Fortran runtime end in one sentence.
    subroutine guard_process() bind(c, name='castnet_guard_process')
    end subroutine guard_process

    !> To be called by every thread of a team: a stack that is full is told as well. Costs
    !> nothing the second time.
    subroutine guard_thread() bind(c, name='castnet_guard_thread')
    end subroutine guard_thread

    !> To be called where memory was refused and that was told to the user: if the process ends
    !> in another way later, that was not the reason.
    subroutine forget_refusal() bind(c, name='castnet_forget_refusal')
    end subroutine forget_refusal

    subroutine castnet_end_process(code) bind(c)
      import :: c_int
      integer(c_int), value :: code
    end subroutine castnet_end_process

    subroutine castnet_print(text, n) bind(c)
      import :: c_char, c_int64_t
      character(kind=c_char), intent(in) :: text(*)
      integer(c_int64_t), value :: n
    end subroutine castnet_print

    subroutine castnet_print_error(text, n) bind(c)
      import :: c_char, c_int64_t
      character(kind=c_char), intent(in) :: text(*)
      integer(c_int64_t), value :: n
    end subroutine castnet_print_error
  end interface

contains

  !> End the process. Through the C library: Fortran's own `stop` talks on standard error.
  subroutine end_process(code)
    integer, intent(in) :: code
    call castnet_end_process(int(code, c_int))
  end subroutine end_process

  !> Lines of results to standard output. A failure is told when the process ends.
  subroutine print_line(text)
    character(len=*), intent(in) :: text
    call castnet_print(text//new_line('a'), len(text, kind=c_int64_t) + 1)
  end subroutine print_line

  !> Words for standard error, as they are: no end of line is added, no failure told.
  subroutine print_error(text)
    character(len=*), intent(in) :: text
    call castnet_print_error(text, len(text, kind=c_int64_t))
  end subroutine print_error

end module castnet_process_guard
