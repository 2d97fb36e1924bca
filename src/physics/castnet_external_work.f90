!> Work that the surroundings do on net and target: gravity, the orbital frame, a constant
!> force. All three have a potential, so the work over a step is the potential's fall, and
!> no error of a quadrature enters the ledger. A torque in body axes has none, nor have
!> fixed nodes that are led along: the integrator adds their work stage by stage. A scene
!> without any of these never comes here.
!>
!> In the orbital frame (castnet_body_dynamics, `orbital_acceleration`) the tidal and
!> centrifugal forces have the potential n^2 (y^2 - 3 z^2)/2 per mass; Coriolis' force does
!> no work. With it kinetic energy and potential make Jacobi's integral.
module castnet_external_work
  use castnet_kinds, only: wp
  use castnet_model, only: model_t
  use castnet_state, only: state_t
  implicit none
  private
  public :: has_net_field, has_external_potential, external_potential

  integer, parameter :: lanes = 8

contains

  !> Do gravity or an orbit act on the nodes?
  pure logical function has_net_field(model)
    type(model_t), intent(in) :: model
    has_net_field = any(abs(model%gravity) > 0.0_wp) .or. abs(model%orbit_rate) > 0.0_wp
  end function has_net_field

  !> Is there a potential besides the cables' energy?
  pure logical function has_external_potential(model) result(has)
    type(model_t), intent(in) :: model
    has = has_net_field(model)
    if (allocated(model%target)) then
      if (.not. model%target%fixed) has = has .or. any(abs(model%target%external_force) > 0.0_wp)
    end if
  end function has_external_potential

  !> Potential of gravity, orbital frame and the target's constant force [J]; what is fixed
  !> has none. Sums in eight lanes, in a fixed order.
  pure real(wp) function external_potential(model, state) result(potential)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: part(lanes), n2
    integer :: i, k

    n2 = model%orbit_rate*model%orbit_rate
    potential = 0.0_wp
    if (allocated(model%net) .and. has_net_field(model)) then
      part = 0.0_wp
      associate (x => state%node_position, g => model%gravity, net => model%net)
        do i = 0, net%n_node - 1, lanes
          do k = 1, min(lanes, net%n_node - i)
            part(k) = part(k) + merge(0.0_wp, net%node_mass(i + k), net%fixed(i + k))* &
                      (0.5_wp*n2*(x(i + k, 2)*x(i + k, 2) - 3.0_wp*x(i + k, 3)*x(i + k, 3)) &
                       - (g(1)*x(i + k, 1) + g(2)*x(i + k, 2) + g(3)*x(i + k, 3)))
          end do
        end do
      end associate
      potential = ((part(1) + part(2)) + (part(3) + part(4))) + ((part(5) + part(6)) + (part(7) + part(8)))
    end if
    if (.not. allocated(model%target)) return
    if (model%target%fixed) return
    associate (x => state%target%position, f => model%target%external_force, g => model%gravity, m => model%target%mass)
      potential = potential + 0.5_wp*n2*m*(x(2)*x(2) - 3.0_wp*x(3)*x(3)) &
                  - ((f(1) + m*g(1))*x(1) + (f(2) + m*g(2))*x(2) + (f(3) + m*g(3))*x(3))
    end associate
  end function external_potential

end module castnet_external_work
