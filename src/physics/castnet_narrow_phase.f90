!> Contacts from candidates: exact signed distance in body axes, then gap, normal, arm
!> and relative velocity of every point within the threshold.
module castnet_narrow_phase
  use castnet_kinds, only: wp
  use castnet_shape, only: shape_t, signed_distance
  use castnet_contact_list, only: contact_list_t, reserve_contacts
  implicit none
  private
  public :: candidates_t, reserve_candidates, select_candidates, measure_gaps, append_node_contacts, set_velocities

  !> Nodes near the body, packed.
  type :: candidates_t
    integer :: n = 0
    integer, allocatable :: node(:)            !! counted from 1
    real(wp), allocatable :: point(:, :)       !! (3,n) body axes [m]
    real(wp), allocatable :: distance(:)       !! [m]
    real(wp), allocatable :: normal(:, :)      !! (3,n) body axes
  end type candidates_t

contains

  !> Room for every node of the net.
  subroutine reserve_candidates(candidates, n)
    type(candidates_t), intent(out) :: candidates
    integer, intent(in) :: n
    allocate (candidates%node(n), source=0)
    allocate (candidates%point(3, n), candidates%distance(n), candidates%normal(3, n), source=0.0_wp)
  end subroutine reserve_candidates

  !> Pack the nodes that are at most `reach` outside of the body's box.
  pure subroutine select_candidates(n, n_pad, y, outside, reach, candidates)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: y(n_pad, 3), outside(n_pad), reach !! body axes [m]
    type(candidates_t), intent(inout) :: candidates
    integer :: i, k
    k = 0
    do i = 1, n
      if (outside(i) > reach) cycle
      k = k + 1
      candidates%node(k) = i
      candidates%point(1, k) = y(i, 1)
      candidates%point(2, k) = y(i, 2)
      candidates%point(3, k) = y(i, 3)
    end do
    candidates%n = k
  end subroutine select_candidates

  !> Signed distances and normals of the candidates.
  pure subroutine measure_gaps(shape, candidates)
    type(shape_t), intent(in) :: shape
    type(candidates_t), intent(inout) :: candidates
    call signed_distance(shape, candidates%n, candidates%point, candidates%distance, candidates%normal)
  end subroutine measure_gaps

  !> Candidates within the threshold, as node contacts. A fixed node on a fixed target
  !> is no contact.
  subroutine append_node_contacts(candidates, threshold, n_pad, x, inverse_mass, centre, r, target_fixed, list)
    type(candidates_t), intent(in) :: candidates
    real(wp), intent(in) :: threshold
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), inverse_mass(n_pad) !! inertial [m], [1/kg]
    real(wp), intent(in) :: centre(3), r(3, 3)               !! body to inertial
    logical, intent(in) :: target_fixed
    type(contact_list_t), intent(inout) :: list
    real(wp) :: g(3)
    integer :: k, i, c
    c = list%n
    do k = 1, candidates%n
      if (.not. candidates%distance(k) <= threshold) cycle
      i = candidates%node(k)
      if (target_fixed .and. inverse_mass(i) <= 0.0_wp) cycle
      c = c + 1
      g = candidates%normal(:, k)
      list%node_a(c) = i
      list%node_b(c) = i
      list%share(c) = 0.0_wp
      list%weight_a(c) = 1.0_wp
      list%inverse_mass_a(c) = inverse_mass(i)
      list%inverse_mass_b(c) = 0.0_wp
      list%gap(c) = candidates%distance(k)
      list%normal(c, 1) = r(1, 1)*g(1) + r(1, 2)*g(2) + r(1, 3)*g(3)
      list%normal(c, 2) = r(2, 1)*g(1) + r(2, 2)*g(2) + r(2, 3)*g(3)
      list%normal(c, 3) = r(3, 1)*g(1) + r(3, 2)*g(2) + r(3, 3)*g(3)
      list%arm(c, 1) = x(i, 1) - centre(1)
      list%arm(c, 2) = x(i, 2) - centre(2)
      list%arm(c, 3) = x(i, 3) - centre(3)
    end do
    list%n = c
  end subroutine append_node_contacts

  !> Velocity of every contact point against the body's material point there. The arm
  !> ends at the net's point, not on the surface, so that impulse and reaction share one
  !> line of action and angular momentum is kept to rounding.
  pure subroutine set_velocities(n_pad, v, body_velocity, body_rate, list)
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: v(n_pad, 3)                  !! node velocities [m/s]
    real(wp), intent(in) :: body_velocity(3), body_rate(3) !! inertial axes [m/s], [rad/s]
    type(contact_list_t), intent(inout) :: list
    real(wp) :: p, q, u(3), w(3)
    integer :: c, a, b
    w = body_rate
    do c = 1, list%n
      a = list%node_a(c)
      b = list%node_b(c)
      p = list%weight_a(c)
      q = list%share(c)
      u(1) = p*v(a, 1) + q*v(b, 1) - body_velocity(1) - (w(2)*list%arm(c, 3) - w(3)*list%arm(c, 2))
      u(2) = p*v(a, 2) + q*v(b, 2) - body_velocity(2) - (w(3)*list%arm(c, 1) - w(1)*list%arm(c, 3))
      u(3) = p*v(a, 3) + q*v(b, 3) - body_velocity(3) - (w(1)*list%arm(c, 2) - w(2)*list%arm(c, 1))
      list%velocity(c, 1) = u(1)
      list%velocity(c, 2) = u(2)
      list%velocity(c, 3) = u(3)
      list%normal_velocity(c) = u(1)*list%normal(c, 1) + u(2)*list%normal(c, 2) + u(3)*list%normal(c, 3)
    end do
  end subroutine set_velocities

end module castnet_narrow_phase
