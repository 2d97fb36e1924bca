!> The contacts of one instant, and what the body opposes to them: plain data that
!> detection fills and the solvers read. Components run one after the other,
!> `(capacity,3)`, because the solvers run along the contacts.
!>
!> A contact pairs the point (1-s) x_a + s x_b of the net with the body. A node
!> contact has b = a and s = 0. Normals point out of the body, arms from the body's
!> centre of mass to the point, all in inertial axes.
module castnet_contact_list
  use castnet_kinds, only: wp
  implicit none
  private
  public :: contact_list_t, body_inertia_t, impulse_report_t, reserve_contacts, shared_mobility, lane

  !> Contacts are summed in this many interleaved partial sums: a fixed order that a
  !> vector unit follows, so that every build gives the same bits.
  integer, parameter :: lane = 8

  type :: contact_list_t
    integer :: n = 0                               !! contacts in the list
    integer :: capacity = 0                        !! room, a multiple of `lane`
    integer, allocatable :: node_a(:), node_b(:)   !! nodes, counted from 1
    real(wp), allocatable :: share(:)              !! s [-]
    real(wp), allocatable :: weight_a(:)           !! (1-s) [-]
    real(wp), allocatable :: inverse_mass_a(:)     !! of node a [1/kg]
    real(wp), allocatable :: inverse_mass_b(:)     !! of node b, 0 for a node contact [1/kg]
    real(wp), allocatable :: normal(:, :)          !! (capacity,3) out of the body, inertial
    real(wp), allocatable :: arm(:, :)             !! (capacity,3) from the centre of mass, inertial [m]
    real(wp), allocatable :: gap(:)                !! signed distance [m]
    real(wp), allocatable :: velocity(:, :)        !! (capacity,3) of the point against the body, inertial [m/s]
    real(wp), allocatable :: normal_velocity(:)    !! its part along the normal [m/s]
    real(wp), allocatable :: impulse(:)            !! normal impulse on the net [N s]
    real(wp), allocatable :: friction_impulse(:, :) !! (capacity,3) tangential impulse on the net, inertial [N s]
  end type contact_list_t

  !> The body's inertia in inertial axes; all zero inverses for a fixed body.
  type :: body_inertia_t
    logical :: free = .false.
    real(wp) :: mass = 0.0_wp, inverse_mass = 0.0_wp
    real(wp) :: inertia(3, 3) = 0.0_wp, inverse_inertia(3, 3) = 0.0_wp
  end type body_inertia_t

  !> How a solve went.
  type :: impulse_report_t
    integer :: iterations = 0
    real(wp) :: residual = 0.0_wp          !! largest violation of the contact conditions [m/s]
    real(wp) :: restitution = 0.0_wp       !! used: lowered when the scene's would create energy [-]
    real(wp) :: energy_loss = 0.0_wp       !! kinetic energy taken by the impulses [J]
    logical :: converged = .true.
    real(wp) :: twist(6) = 0.0_wp          !! change of the body's velocity and rate, inertial axes [m/s], [rad/s]
  end type impulse_report_t

contains

  !> Room for at least `n` contacts; what the list held is lost when it grows.
  subroutine reserve_contacts(list, n)
    type(contact_list_t), intent(inout) :: list
    integer, intent(in) :: n
    integer :: m
    if (list%capacity >= n .and. allocated(list%node_a)) return
    m = ((max(n, 2*list%capacity, lane) + lane - 1)/lane)*lane
    if (allocated(list%node_a)) then
      deallocate (list%node_a, list%node_b, list%share, list%weight_a, list%inverse_mass_a, list%inverse_mass_b)
      deallocate (list%normal, list%arm, list%gap, list%velocity, list%normal_velocity, list%impulse)
      deallocate (list%friction_impulse)
    end if
    allocate (list%node_a(m), list%node_b(m), source=0)
    allocate (list%share(m), list%weight_a(m), list%inverse_mass_a(m), list%inverse_mass_b(m), source=0.0_wp)
    allocate (list%gap(m), list%normal_velocity(m), list%impulse(m), source=0.0_wp)
    allocate (list%normal(m, 3), list%arm(m, 3), list%velocity(m, 3), list%friction_impulse(m, 3), source=0.0_wp)
    list%capacity = m
    list%n = 0
  end subroutine reserve_contacts

  !> Velocity of contact point i per impulse at contact point k through common nodes [1/kg].
  pure real(wp) function shared_mobility(list, i, k) result(mobility)
    type(contact_list_t), intent(in) :: list
    integer, intent(in) :: i, k
    mobility = 0.0_wp
    if (list%node_a(i) == list%node_a(k)) mobility = mobility + list%weight_a(i)*list%weight_a(k)*list%inverse_mass_a(i)
    if (list%node_b(i) == list%node_b(k)) mobility = mobility + list%share(i)*list%share(k)*list%inverse_mass_b(i)
    if (list%node_a(i) == list%node_b(k)) mobility = mobility + list%weight_a(i)*list%share(k)*list%inverse_mass_a(i)
    if (list%node_b(i) == list%node_a(k)) mobility = mobility + list%share(i)*list%weight_a(k)*list%inverse_mass_a(k)
  end function shared_mobility

end module castnet_contact_list
