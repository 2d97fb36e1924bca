!> Requests to stop that come from outside. The only mutable thing that outlives a call
!> in castnet is the flag that the handler sets (in the C file beside this one).
module castnet_signals
  use, intrinsic :: iso_c_binding, only: c_int
  use castnet_error, only: exit_done, exit_stopped, exit_interrupted
  implicit none
  private
  public :: install_signal_handlers, stop_request_code

  interface
    integer(c_int) function castnet_install_signals() bind(c)
      import :: c_int
    end function castnet_install_signals
    integer(c_int) function castnet_stop_request() bind(c)
      import :: c_int
    end function castnet_stop_request
  end interface

contains

  !> From here on SIGUSR1, SIGTERM, SIGHUP and SIGINT only leave a request, and a second
  !> one ends the process at once. What `nohup` ignores stays ignored. A file size limit
  !> becomes an error of the write that meets it.
  subroutine install_signal_handlers()
    integer(c_int) :: ignored
    ignored = castnet_install_signals()
  end subroutine install_signal_handlers

  !> The exit code that a signal has asked for: `exit_stopped`, `exit_interrupted`, or
  !> `exit_done` when none has come. Costs one load: ask after every step.
  integer function stop_request_code()
    select case (castnet_stop_request())
    case (0)
      stop_request_code = exit_done
    case (2)
      stop_request_code = exit_interrupted
    case default
      stop_request_code = exit_stopped
    end select
  end function stop_request_code

end module castnet_signals
