!> Net on net: cables without a common node that pass through each other within a step,
!> each a straight line between its nodes. They are counted, or (`impulses`) kept apart.
!>
!> Keeping apart: where a pair would pass through, an inelastic impulse along the normal of
!> the two cables at the moment of their crossing, shared (1 - s), s and (1 - t), t by their
!> nodes, stops their approach; then both are moved apart along that normal, with the least
!> mass-weighted displacement, to a clearance on their own side. Impulse and displacement
!> together are what an impulse at the moment of the crossing would have done, so that
!> momentum is kept and the moment of momentum but for the clearance and the forces' change
!> within the step. Pair after pair, sweep after sweep, as cables that are moved may meet
!> others; what still crosses after the last sweep passes through, and is counted.
module castnet_self_contact
  use castnet_kinds, only: wp, i8
  use castnet_cable_pairs, only: cable_pairs_t, new_cable_pairs, update_pairs
  use castnet_contact_projection, only: cable_incidence_t, new_incidence, energy_of_cables_at
  use castnet_crossing, only: crossing_t, segments_cross
  use castnet_model, only: model_t, self_contact_none, self_contact_count, self_contact_taut
  use castnet_net, only: net_t
  use castnet_state, only: state_t, self_all, self_taut, self_unresolved
  implicit none
  private
  public :: self_contact_work_t, new_self_contact_work, remember_nodes, handle_self_contacts

  integer, parameter :: max_sweep = 10
  !> Between cables that have been kept apart, of the contact threshold [-].
  real(wp), parameter :: clearance_thresholds = 1.0e-2_wp

  !> One pair that passes through itself.
  type :: hit_t
    integer :: cable(2) = 0
    type(crossing_t) :: crossing
  end type hit_t

  !> Scratch, allocated once, where a scene asks for it.
  type :: self_contact_work_t
    logical :: wanted = .false.
    logical :: acted = .false.                 !! the last call changed velocities or positions
    type(cable_pairs_t) :: pairs
    type(cable_incidence_t) :: incidence
    real(wp), allocatable :: before(:, :)      !! (n_pad,3) nodes where the step began [m]
    integer :: n_hit = 0
    type(hit_t), allocatable :: hit(:)         !! pairs that pass through each other
    logical, allocatable :: looked_at(:)       !! (n_node) pairs with one of these nodes are looked at
  end type self_contact_work_t

contains

  !> Allocate the scratch of one run.
  subroutine new_self_contact_work(work, model)
    type(self_contact_work_t), intent(out) :: work
    type(model_t), intent(in) :: model
    if (.not. (allocated(model%contact) .and. allocated(model%net))) return
    work%wanted = model%contact%self_contact /= self_contact_none
    if (.not. work%wanted) return
    call new_cable_pairs(work%pairs, model%net)
    allocate (work%before(model%net%n_pad, 3), source=0.0_wp)
    allocate (work%hit(model%net%n_cable))
    allocate (work%looked_at(model%net%n_node), source=.true.)
    if (model%contact%self_contact /= self_contact_count) call new_incidence(work%incidence, model%net)
  end subroutine new_self_contact_work

  !> Where the nodes are at a step's start.
  subroutine remember_nodes(state, work)
    type(state_t), intent(in) :: state
    type(self_contact_work_t), intent(inout) :: work
    work%before = state%node_position
  end subroutine remember_nodes

  !> Cables that have passed through each other since the step's start: counted in
  !> `state%self_contacts`, and with `impulses` undone, into the ledger.
  subroutine handle_self_contacts(model, state, work)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(self_contact_work_t), intent(inout) :: work
    integer :: sweep, k
    logical :: undo, taut_only
    undo = model%contact%self_contact /= self_contact_count
    taut_only = model%contact%self_contact == self_contact_taut
    work%acted = .false.
    associate (net => model%net, counts => state%self_contacts)
      work%looked_at = .true.
      call find_hits(net, net%n_pad, state%node_position, undo, taut_only, work)
      do k = 1, work%n_hit
        counts(self_all) = counts(self_all) + work%hit(k)%crossing%n
        if (is_taut(net, net%n_pad, state%node_position, work%hit(k)%cable(1)) .and. &
            is_taut(net, net%n_pad, state%node_position, work%hit(k)%cable(2))) &
          counts(self_taut) = counts(self_taut) + work%hit(k)%crossing%n
      end do
      if (.not. undo) return
      do sweep = 1, max_sweep
        if (work%n_hit == 0) return
        call sort_hits(work%hit(:work%n_hit))
        ! A pair of which no node is moved now will stand as it stands.
        work%looked_at = .false.
        do k = 1, work%n_hit
          work%looked_at(net%cable_nodes(:, work%hit(k)%cable(1))) = .true.
          work%looked_at(net%cable_nodes(:, work%hit(k)%cable(2))) = .true.
          call hold_apart(model, net%n_pad, work%hit(k), state, work%incidence)
        end do
        work%acted = .true.
        call find_hits(net, net%n_pad, state%node_position, undo, taut_only, work)
      end do
      counts(self_unresolved) = counts(self_unresolved) + work%n_hit
    end associate
  end subroutine handle_self_contacts

  !> Every pair that has passed through itself, in no order; `through`: but for those that
  !> went through and back within the step.
  subroutine find_hits(net, n_pad, x, through, taut_only, work)
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)
    logical, intent(in) :: through, taut_only
    type(self_contact_work_t), intent(inout) :: work
    type(crossing_t) :: crossing
    real(wp) :: from(3, 4), to(3, 4)
    integer :: k, m, c, e, node(4)
    call update_pairs(work%pairs, net, n_pad, work%before, x)
    work%n_hit = 0
    do m = 1, work%pairs%n_close
      k = work%pairs%close(m)
      node = [net%cable_nodes(:, work%pairs%first(k)), net%cable_nodes(:, work%pairs%second(k))]
      if (.not. any(work%looked_at(node))) cycle
      do e = 1, 4
        do c = 1, 3
          from(c, e) = work%before(node(e), c)
          to(c, e) = x(node(e), c)
        end do
      end do
      call segments_cross(from, to, crossing)
      if (crossing%n == 0 .or. (through .and. modulo(crossing%n, 2) == 0)) cycle
      if (taut_only) then
        if (.not. (is_taut(net, n_pad, x, work%pairs%first(k)) .and. is_taut(net, n_pad, x, work%pairs%second(k)))) cycle
      end if
      if (work%n_hit == size(work%hit)) call grow(work%hit)
      work%n_hit = work%n_hit + 1
      work%hit(work%n_hit)%cable = [work%pairs%first(k), work%pairs%second(k)]
      work%hit(work%n_hit)%crossing = crossing
    end do
  end subroutine find_hits

  subroutine grow(hit)
    type(hit_t), allocatable, intent(inout) :: hit(:)
    type(hit_t), allocatable :: more(:)
    allocate (more(2*size(hit)))
    more(:size(hit)) = hit
    call move_alloc(more, hit)
  end subroutine grow

  !> By the first cable's number, then the second's: an order that the list of near pairs
  !> does not decide.
  pure subroutine sort_hits(hit)
    type(hit_t), intent(inout) :: hit(:)
    type(hit_t) :: held
    integer :: i, j
    do i = 2, size(hit)
      held = hit(i)
      j = i - 1
      do while (j > 0)
        if (hit(j)%cable(1) < held%cable(1)) exit
        if (hit(j)%cable(1) == held%cable(1) .and. hit(j)%cable(2) < held%cable(2)) exit
        hit(j + 1) = hit(j)
        j = j - 1
      end do
      hit(j + 1) = held
    end do
  end subroutine sort_hits

  !> Is this cable longer than its natural length?
  pure logical function is_taut(net, n_pad, x, cable)
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad, cable
    real(wp), intent(in) :: x(n_pad, 3)
    real(wp) :: square
    integer :: c
    square = 0.0_wp
    do c = 1, 3
      square = square + (x(net%cable_nodes(2, cable), c) - x(net%cable_nodes(1, cable), c))**2
    end do
    is_taut = square > net%natural_length(cable)**2
  end function is_taut

  !> Stop one pair's approach and put it back on its own side.
  subroutine hold_apart(model, n_pad, hit, state, incidence)
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_pad
    type(hit_t), intent(in) :: hit
    type(state_t), intent(inout) :: state
    type(cable_incidence_t), intent(inout) :: incidence
    real(wp) :: weight(4), inverse_mass, gap, rate, missing, before
    integer :: node(4), e
    associate (net => model%net, s => hit%crossing%share(1), t => hit%crossing%share(2), n => hit%crossing%normal)
      node = [net%cable_nodes(:, hit%cable(1)), net%cable_nodes(:, hit%cable(2))]
      weight = [-(1.0_wp - s), -s, 1.0_wp - t, t]
      inverse_mass = 0.0_wp
      gap = 0.0_wp
      rate = 0.0_wp
      do e = 1, 4
        inverse_mass = inverse_mass + weight(e)*weight(e)*net%inverse_mass(node(e))
        gap = gap + weight(e)*along(n, n_pad, state%node_position, node(e))
        rate = rate + weight(e)*along(n, n_pad, state%node_velocity, node(e))
      end do
      if (.not. inverse_mass > 0.0_wp) return
      if (rate < 0.0_wp) then
        call push(-rate/inverse_mass, node, weight, n, net%inverse_mass, n_pad, state%node_velocity)
        if (allocated(state%velocity_ahead)) &
          call push(-rate/inverse_mass, node, weight, n, net%inverse_mass, n_pad, state%velocity_ahead)
        state%ledger%contact_loss = state%ledger%contact_loss + 0.5_wp*rate*rate/inverse_mass
      end if
      missing = clearance_thresholds*model%contact%threshold - gap
      if (.not. missing > 0.0_wp) return
      before = energy_of_cables_at(net, n_pad, state%node_position, node, incidence)
      call push(missing/inverse_mass, node, weight, n, net%inverse_mass, n_pad, state%node_position)
      state%ledger%projection_work = state%ledger%projection_work &
                                     + (energy_of_cables_at(net, n_pad, state%node_position, node, incidence) - before)
    end associate
  end subroutine hold_apart

  !> Add j along the normal to two cables' nodes, shared by weight and mass.
  pure subroutine push(j, node, weight, normal, inverse_mass, n_pad, x)
    real(wp), intent(in) :: j, weight(4), normal(3), inverse_mass(:)
    integer, intent(in) :: node(4), n_pad
    real(wp), intent(inout) :: x(n_pad, 3)
    integer :: e, c
    do e = 1, 4
      do c = 1, 3
        x(node(e), c) = x(node(e), c) + j*weight(e)*inverse_mass(node(e))*normal(c)
      end do
    end do
  end subroutine push

  !> Component of a node's vector along n.
  pure real(wp) function along(n, n_pad, x, node)
    real(wp), intent(in) :: n(3)
    integer, intent(in) :: n_pad, node
    real(wp), intent(in) :: x(n_pad, 3)
    along = n(1)*x(node, 1) + n(2)*x(node, 2) + n(3)*x(node, 3)
  end function along

end module castnet_self_contact
