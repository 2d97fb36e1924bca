!> What goes to the user: results on standard output, all else on standard error,
!> each message led by the program's name.
module castnet_terminal
  use, intrinsic :: iso_fortran_env, only: output_unit, error_unit
  implicit none
  private
  public :: say, tell, warn_lines

contains

  !> Lines of results.
  subroutine say(text)
    character(len=*), intent(in) :: text
    write (output_unit, '(a)') text
    flush (output_unit)
  end subroutine say

  !> A message for the user. The first line is led by 'castnet: '; lines that name a file
  !> and line stay as they are, for editors to jump to.
  subroutine tell(text)
    character(len=*), intent(in) :: text
    write (error_unit, '(2a)') 'castnet: ', text
    flush (error_unit)
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
