!> Forces on nodes and target besides the cables: closing thread, compliant contact.
!> A scene without either never comes here. The one-stage method's threads are not among
!> them: castnet_thread_flow.
module castnet_extra_force
  use castnet_kinds, only: wp
  use castnet_closing_thread, only: add_thread_force
  use castnet_compliant_contact, only: is_compliant, add_contact_force
  use castnet_model, only: model_t, method_midpoint
  use castnet_state, only: body_state_t, closing_state_t, ledger_t
  implicit none
  private
  public :: has_extra_force, gather_extra_force

contains

  !> Does this model have forces besides cables, gravity and impulses?
  pure logical function has_extra_force(model)
    type(model_t), intent(in) :: model
    has_extra_force = has_thread_force(model) .or. is_compliant(model)
  end function has_extra_force

  pure logical function has_thread_force(model)
    type(model_t), intent(in) :: model
    has_thread_force = allocated(model%closing) .and. model%method /= method_midpoint
  end function has_thread_force

  !> All extra forces at one stage.
  subroutine gather_extra_force(model, n_pad, x, v, body, closing, force, body_force, body_torque, &
                                share, thread_impulse, ledger)
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)    !! [m], [m/s]
    type(body_state_t), allocatable, intent(in) :: body
    type(closing_state_t), allocatable, intent(in) :: closing
    real(wp), intent(out) :: force(n_pad, 3)            !! on the nodes [N]
    real(wp), intent(out) :: body_force(3)              !! on the target, inertial [N]
    real(wp), intent(out) :: body_torque(3)             !! on the target, body axes [N m]
    real(wp), intent(in) :: share                       !! of the step that this stage stands for [s]
    real(wp), allocatable, intent(inout) :: thread_impulse(:, :) !! (n_pad,3) grows by share x thread force; where there is one [N s]
    type(ledger_t), intent(inout) :: ledger             !! grows by what contact's damping and friction take

    force = 0.0_wp
    body_force = 0.0_wp
    body_torque = 0.0_wp
    if (has_thread_force(model)) &
      call add_thread_force(model%closing, closing, n_pad, x, v, force, share, thread_impulse)
    if (is_compliant(model)) &
      call add_contact_force(model, n_pad, x, v, body, force, body_force, body_torque, share, ledger)
  end subroutine gather_extra_force

end module castnet_extra_force
