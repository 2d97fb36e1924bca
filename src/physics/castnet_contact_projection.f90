!> Positions back onto the surface. Velocities alone do not hold a taut net out of a
!> body: nodes below the surface (d < 0) are moved back along the normal, with the least
!> mass-weighted displacement of net and target together. That is the impulse problem
!> with depths for velocities: displacements come in the same pairs as impulses, so
!> the common centre of mass stays, and the target turns by its share.
module castnet_contact_projection
  use castnet_kinds, only: wp
  use castnet_net, only: net_t
  use castnet_contact_list, only: contact_list_t
  use castnet_impulse_solver, only: impulse_problem_t
  implicit none
  private
  public :: cable_incidence_t, new_incidence, energy_of_moved_cables, energy_of_cables_at, move_nodes, largest_move, &
            set_depths, mass_of

  !> The cables at each node, for the elastic energy of those that are moved.
  type :: cable_incidence_t
    integer, allocatable :: start(:)    !! (n_node+1)
    integer, allocatable :: cable(:)    !! cables of node i: cable(start(i):start(i+1)-1)
    integer, allocatable :: stamp(:)    !! (n_cable) last sum in which a cable was counted
    integer :: present = 0
  end type cable_incidence_t

contains

  !> Build the incidence of a net.
  subroutine new_incidence(incidence, net)
    type(cable_incidence_t), intent(out) :: incidence
    type(net_t), intent(in) :: net
    integer, allocatable :: next(:)
    integer :: c, side, i
    allocate (incidence%start(net%n_node + 1), source=0)
    allocate (incidence%cable(2*net%n_cable), incidence%stamp(net%n_cable), source=0)
    do c = 1, net%n_cable
      do side = 1, 2
        i = net%cable_nodes(side, c)
        incidence%start(i + 1) = incidence%start(i + 1) + 1
      end do
    end do
    incidence%start(1) = 1
    do i = 1, net%n_node
      incidence%start(i + 1) = incidence%start(i + 1) + incidence%start(i)
    end do
    allocate (next(net%n_node + 1), source=incidence%start)
    do c = 1, net%n_cable
      do side = 1, 2
        i = net%cable_nodes(side, c)
        incidence%cable(next(i)) = c
        next(i) = next(i) + 1
      end do
    end do
  end subroutine new_incidence

  !> Elastic energy of every cable at a node that the projection moves (impulse > 0) [J].
  subroutine energy_of_moved_cables(net, n_pad, x, list, moved, incidence, energy)
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)
    type(contact_list_t), intent(in) :: list
    real(wp), intent(in) :: moved(:)                    !! > 0 for contacts that are moved
    type(cable_incidence_t), intent(inout) :: incidence
    real(wp), intent(out) :: energy
    integer :: k
    call forget_counted(incidence)
    energy = 0.0_wp
    do k = 1, list%n
      if (.not. moved(k) > 0.0_wp) cycle
      call add_cables_of(net, n_pad, x, list%node_a(k), incidence, energy)
      if (list%node_b(k) /= list%node_a(k)) &
        call add_cables_of(net, n_pad, x, list%node_b(k), incidence, energy)
    end do
  end subroutine energy_of_moved_cables

  !> Elastic energy of every cable at the given nodes [J].
  real(wp) function energy_of_cables_at(net, n_pad, x, node, incidence) result(energy)
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)
    integer, intent(in) :: node(:)                      !! counted from 1
    type(cable_incidence_t), intent(inout) :: incidence
    integer :: k
    call forget_counted(incidence)
    energy = 0.0_wp
    do k = 1, size(node)
      call add_cables_of(net, n_pad, x, node(k), incidence, energy)
    end do
  end function energy_of_cables_at

  !> From here on no cable has been counted.
  pure subroutine forget_counted(incidence)
    type(cable_incidence_t), intent(inout) :: incidence
    incidence%present = incidence%present + 1
    if (incidence%present == huge(1)) then
      incidence%stamp = 0
      incidence%present = 1
    end if
  end subroutine forget_counted

  !> Add the elastic energy of a node's cables that have not been counted yet [J].
  pure subroutine add_cables_of(net, n_pad, x, node, incidence, energy)
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad, node                  !! counted from 1
    real(wp), intent(in) :: x(n_pad, 3)
    type(cable_incidence_t), intent(inout) :: incidence
    real(wp), intent(inout) :: energy
    real(wp) :: dx, dy, dz, stretch
    integer :: e, c, a, b
    do e = incidence%start(node), incidence%start(node + 1) - 1
      c = incidence%cable(e)
      if (incidence%stamp(c) == incidence%present) cycle
      incidence%stamp(c) = incidence%present
      a = net%cable_nodes(1, c)
      b = net%cable_nodes(2, c)
      dx = x(b, 1) - x(a, 1)
      dy = x(b, 2) - x(a, 2)
      dz = x(b, 3) - x(a, 3)
      stretch = max(0.0_wp, sqrt(dx*dx + dy*dy + dz*dz) - net%natural_length(c))
      energy = energy + 0.5_wp*net%axial_stiffness(c)/net%natural_length(c)*stretch*stretch
    end do
  end subroutine add_cables_of

  !> 1/w; a fixed point has no mass to speak of, and solvers that divide by w are not
  !> given one: any positive number says that the contact counts.
  elemental real(wp) function mass_of(inverse_mass)
    real(wp), intent(in) :: inverse_mass
    mass_of = 1.0_wp/merge(inverse_mass, 1.0_wp, inverse_mass > 0.0_wp)
  end function mass_of

  !> The depth that each contact has to gain; those above the surface may not lose more
  !> than their gap.
  pure subroutine set_depths(list, problem)
    type(contact_list_t), intent(in) :: list
    type(impulse_problem_t), intent(inout) :: problem
    integer :: i
    problem%n = list%n
    problem%push_only = .true.
    do i = 1, list%n
      problem%need(i) = -list%gap(i)
      problem%weight(i) = mass_of(problem%inverse_weight(i))
    end do
  end subroutine set_depths

  !> How far the displacements would move any node [m].
  real(wp) function largest_move(list, moment, move) result(largest)
    type(contact_list_t), intent(in) :: list
    real(wp), intent(in) :: moment(:)           !! mass times displacement of each contact [kg m]
    real(wp), intent(inout) :: move(:, :)       !! (3,n_node) scratch
    real(wp) :: normal(3)
    integer :: k, a, b
    do k = 1, list%n
      move(:, list%node_a(k)) = 0.0_wp
      move(:, list%node_b(k)) = 0.0_wp
    end do
    largest = 0.0_wp
    do k = 1, list%n
      if (.not. moment(k) > 0.0_wp) cycle
      a = list%node_a(k)
      b = list%node_b(k)
      normal = list%normal(k, :)
      move(:, a) = move(:, a) + list%weight_a(k)*list%inverse_mass_a(k)*moment(k)*normal
      move(:, b) = move(:, b) + list%share(k)*list%inverse_mass_b(k)*moment(k)*normal
    end do
    do k = 1, list%n
      largest = max(largest, sum(move(:, list%node_a(k))**2), sum(move(:, list%node_b(k))**2))
    end do
    largest = sqrt(largest)
  end function largest_move

  !> Move the nodes by their share of the pairs' displacements.
  pure subroutine move_nodes(n_pad, x, list, moment)
    integer, intent(in) :: n_pad
    real(wp), intent(inout) :: x(n_pad, 3)
    type(contact_list_t), intent(in) :: list
    real(wp), intent(in) :: moment(:)  !! mass times displacement of each contact [kg m]
    real(wp) :: p, q
    integer :: k, a, b
    do k = 1, list%n
      if (.not. moment(k) > 0.0_wp) cycle
      a = list%node_a(k)
      b = list%node_b(k)
      p = list%weight_a(k)*list%inverse_mass_a(k)*moment(k)
      q = list%share(k)*list%inverse_mass_b(k)*moment(k)
      x(a, 1) = x(a, 1) + p*list%normal(k, 1)
      x(a, 2) = x(a, 2) + p*list%normal(k, 2)
      x(a, 3) = x(a, 3) + p*list%normal(k, 3)
      x(b, 1) = x(b, 1) + q*list%normal(k, 1)
      x(b, 2) = x(b, 2) + q*list%normal(k, 2)
      x(b, 3) = x(b, 3) + q*list%normal(k, 3)
    end do
  end subroutine move_nodes

end module castnet_contact_projection
