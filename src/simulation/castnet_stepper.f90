!> One step of the paper's flowchart (Fig. 3): move net and target, find contacts,
!> apply their impulses, run the closing thread.
module castnet_stepper
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_integrator, only: flow_work_t, new_flow_work, rk4_step, midpoint_step
  use castnet_model, only: model_t, method_midpoint
  use castnet_state, only: state_t
  implicit none
  private
  public :: work_t, new_work, advance

  !> Nodes from which threads inside one run pay (docs/performance.md).
  integer, parameter :: nodes_worth_threads = 4096

  !> All scratch of a run, allocated once.
  type :: work_t
    type(flow_work_t) :: flow
  end type work_t

contains

  subroutine new_work(work, model, n_thread)
    type(work_t), intent(out) :: work
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_thread
    integer :: used
    used = 1
    if (allocated(model%net)) then
      if (model%net%n_node >= nodes_worth_threads) used = n_thread
    end if
    call new_flow_work(work%flow, model, used)
  end subroutine new_work

  !> Advance by one step.
  subroutine advance(model, state, work, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(work_t), intent(inout) :: work
    type(error_t), allocatable, intent(inout) :: error

    if (model%method == method_midpoint) then
      call midpoint_step(model, state, work%flow, model%step)
    else
      call rk4_step(model, state, work%flow, model%step)
    end if
    state%step = state%step + 1
    state%time = real(state%step, wp)*model%step
  end subroutine advance

end module castnet_stepper
