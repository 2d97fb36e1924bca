!> The one error object: a message for the user and the exit code it ends with.
!> Success is "not allocated". Only `main` turns it into an exit.
module castnet_error
  implicit none
  private
  public :: error_t, fail
  public :: exit_done, exit_bug, exit_input, exit_numerical, exit_file, exit_stopped, exit_interrupted

  integer, parameter :: exit_done = 0
  integer, parameter :: exit_bug = 1           !! a bug of ours
  integer, parameter :: exit_input = 2         !! bad usage or input, nothing written
  integer, parameter :: exit_numerical = 3     !! numerical failure, last good checkpoint kept
  integer, parameter :: exit_file = 4          !! disk full, permission, lock, corrupt restart
  integer, parameter :: exit_stopped = 75      !! stopped early and resumable
  integer, parameter :: exit_interrupted = 130 !! Ctrl-C, also resumable

  type :: error_t
    integer :: code = exit_bug            !! exit code of the process
    character(len=:), allocatable :: message !! what was done, on what, what was seen, what is allowed; may hold several lines
  end type error_t

contains

  !> Raise an error; the first one wins.
  subroutine fail(error, code, message)
    type(error_t), allocatable, intent(inout) :: error
    integer, intent(in) :: code
    character(len=*), intent(in) :: message
    if (allocated(error)) return
    allocate (error)
    error%code = code
    error%message = message
  end subroutine fail

end module castnet_error
