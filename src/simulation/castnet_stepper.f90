!> One step of the paper's flowchart (Fig. 3): move net and target, find contacts,
!> apply their impulses, run the closing thread.
module castnet_stepper
  use castnet_kinds, only: wp, i8
  use castnet_adaptive, only: adaptive_step
  use castnet_closing_thread, only: update_closing
  use castnet_error, only: error_t
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts
  use castnet_external_work, only: has_net_field, has_external_potential, external_potential
  use castnet_integrator, only: flow_work_t, new_flow_work, rk4_step, midpoint_step, midpoint_positions, midpoint_disturbed, &
                                midpoint_disturbed_at
  use castnet_model, only: model_t, method_midpoint, method_adaptive
  use castnet_self_contact, only: self_contact_work_t, new_self_contact_work, remember_nodes, handle_self_contacts
  use castnet_state, only: state_t
  implicit none
  private
  public :: work_t, timings_t, new_work, advance, meet, settle

  !> Nodes from which one run uses threads: an estimate, not yet measured (docs/performance.md).
  integer, parameter :: nodes_worth_threads = 4096

  !> Time spent in the stages of a step, where it is wanted.
  type :: timings_t
    logical :: wanted = .false.
    integer(i8) :: flow = 0      !! ticks of the system clock: forces and integration
    integer(i8) :: contact = 0   !! detection, impulses, projection
  end type timings_t

  !> All scratch of a run, allocated once.
  type :: work_t
    type(flow_work_t) :: flow
    type(contact_work_t) :: contact
    type(self_contact_work_t) :: self_contact
    type(timings_t) :: timings
    logical :: has_potential = .false.             !! something outside does work
    logical :: has_field = .false.                 !! and it needs the nodes' positions
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
    work%has_potential = has_external_potential(model)
    work%has_field = has_net_field(model)
    if (.not. allocated(model%contact)) return
    call new_contact_work(work%contact, model)
    call new_self_contact_work(work%self_contact, model)
  end subroutine new_work

  !> Advance by one step.
  subroutine advance(model, state, work, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(work_t), intent(inout) :: work
    type(error_t), allocatable, intent(inout) :: error
    real(wp) :: potential
    integer(i8) :: began, moved, met

    if (work%timings%wanted) call system_clock(began)
    if (work%self_contact%wanted) call remember_nodes(state, work%self_contact)
    potential = 0.0_wp
    if (work%has_potential) potential = external_potential(model, state)
    select case (model%method)
    case (method_midpoint)
      call midpoint_step(model, state, work%flow, model%step)
    case (method_adaptive)
      call adaptive_step(model, state, work%flow, model%step, error)
      if (allocated(error)) return
    case default
      call rk4_step(model, state, work%flow, model%step)
    end select
    if (work%has_potential) then
      if (work%has_field) call settle(model, state, work)
      state%ledger%external_work = state%ledger%external_work + (potential - external_potential(model, state))
    end if
    state%step = state%step + 1
    state%time = real(state%step, wp)*model%step
    if (work%timings%wanted) call system_clock(moved)
    if (allocated(model%contact)) call meet(model, state, work, error)
    if (work%self_contact%wanted) then
      call settle(model, state, work)
      call handle_self_contacts(model, state, work%self_contact)
      if (work%self_contact%acted) call midpoint_disturbed(work%flow)
    end if
    if (allocated(model%closing)) then
      call settle(model, state, work)
      if (allocated(work%flow%threads)) then
        call update_closing(model, state, model%step, work%flow%threads%tension)
      else
        call update_closing(model, state, model%step)
      end if
    end if
    if (.not. work%timings%wanted) return
    call system_clock(met)
    work%timings%flow = work%timings%flow + (moved - began)
    work%timings%contact = work%timings%contact + (met - moved)
  end subroutine advance

  !> Contact between net and target at this instant. Nearly all of a flight it returns at
  !> once: nothing can touch before `skip_contact_until`.
  subroutine meet(model, state, work, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(work_t), intent(inout) :: work
    type(error_t), allocatable, intent(inout) :: error

    if (state%time < state%skip_contact_until) return
    call settle(model, state, work)
    call handle_contacts(model, state, work%contact, error)
    if (.not. work%contact%acted) return
    if (work%contact%acted_beyond) then
      call midpoint_disturbed(work%flow)
    else
      associate (list => work%contact%list)
        call midpoint_disturbed_at(state, work%flow, model%step, list%node_a(:list%n))
        call midpoint_disturbed_at(state, work%flow, model%step, list%node_b(:list%n))
      end associate
    end if
  end subroutine meet

  !> Bring the state to the end of the step for whoever looks at it.
  subroutine settle(model, state, work)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(work_t), intent(inout) :: work
    if (model%method == method_midpoint) call midpoint_positions(state, work%flow, model%step)
  end subroutine settle

end module castnet_stepper
