!> What goes to the user: results on standard output, all else on standard error,
!> each message led by the program's name.
module castnet_terminal
  use castnet_process_guard, only: print_line, print_error
  implicit none
  private
  public :: say, tell, warn_lines

contains

  !> Lines of results.
  subroutine say(text)
    character(len=*), intent(in) :: text
    call print_line(text)
  end subroutine say

  !> A message for the user. The first line is led by 'castnet: '; lines that name a file
  !> and line stay as they are, for editors to jump to.
  subroutine tell(text)
    character(len=*), intent(in) :: text
    call print_error('castnet: '//text//new_line('a'))
  end subroutine tell

  !> Warnings, one per line.
  subroutine warn_lines(text)
    character(len=*), intent(in) :: text
    integer :: first, last
    first = 1
    do while (first <= len(text))
      last = index(text(first:)//new_line('a'), new_line('a')) + first - 2
      call tell('warning: '//text(first:last))
      first = last + 2
    end do
  end subroutine warn_lines

end module castnet_terminal
