!> Contact at the end of a time step (the lower half of the paper's figure 3): detect,
!> find the impulses, change velocities, put sunken nodes back, keep the books.
module castnet_contact_event
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_model, only: model_t, law_impulse
  use castnet_state, only: state_t, impulse_bins, impulse_bin_low, impulse_bins_per_decade
  use castnet_rotation, only: rotation_matrix, congruent, multiply, multiply_transposed, &
                              quaternion_product, quaternion_from_rotation_vector, normalise_quaternion
  use castnet_shape, only: signed_distance, segment_distance
  use castnet_compliant_contact, only: is_compliant, list_pushed
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t, reserve_contacts, lane
  use castnet_broad_phase, only: into_body_axes, farthest_and_fastest
  use castnet_near_list, only: near_list_t, reserve_near, rebuild_near, turned_by
  use castnet_narrow_phase, only: append_nodes, append_cables, set_velocities, mend_normal
  use castnet_contact_response, only: contact_solver_t, reserve_solver, resolve_contacts, resolve_depths
  use castnet_contact_projection, only: cable_incidence_t, new_incidence, energy_of_moved_cables, move_nodes, &
                                        largest_move
  use castnet_contact_horizon, only: earliest_contact_time
  use castnet_fast_nodes, only: fast_nodes_t, new_fast_nodes, look_for_fast, catch_fast, release_fast
  implicit none
  private
  public :: contact_work_t, new_contact_work, handle_contacts, detect_contacts, body_inertia

  !> Steps between two looks at how long nothing can touch. By the step's number, not by
  !> a counter of ours, so that a restarted run is the same.
  integer(i8), parameter :: horizon_stride = 64
  real(wp), parameter :: worth_skipping = 6.0_wp  !! steps: to ask costs as much as so many looks
  !> Passes of a projection at most. On a face one is enough; a cable over an edge, whose nearest point and normal
  !> change as it is lifted, took up to some twenty (with 4, captures at restitution 0 kept 0.3 mm and 7 mm).
  integer, parameter :: max_projection = 24
  !> Skin of the near list in contact thresholds: wide enough to be rebuilt once in some tens
  !> of steps, narrow enough to hold few. Cables cost more to look at than nodes.
  real(wp), parameter :: skin_thresholds = 24.0_wp, skin_thresholds_cables = 8.0_wp
  !> Depth that is left after a projection and not worth another one, of the threshold [-].
  real(wp), parameter :: projection_tolerance = 1.0e-6_wp

  !> Scratch of contact handling, allocated once.
  !> A node is moved at most so many times as far in an event as the deepest point lies deep.
  !> Where a cable is held from two sides close to each other (in the corner between two parts of
  !> a body), to have it out at once would be to turn it about that place: its ends would fly.
  real(wp), parameter :: most_moves = 16.0_wp

  type :: contact_work_t
    logical :: acted = .false.                 !! the last call changed velocities or positions
    logical :: acted_beyond = .false.          !! and not only at the nodes of `list`
    logical :: engaged = .false.               !! something is near
    real(wp) :: move = 0.0_wp                  !! of any node against the surface since the near list was built, at most [m]
    type(contact_list_t) :: list
    type(near_list_t) :: near
    type(contact_solver_t) :: solver
    type(cable_incidence_t) :: incidence
    type(fast_nodes_t) :: fast
    type(impulse_report_t) :: report
    real(wp), allocatable :: y(:, :)           !! (n_pad,3) nodes in body axes, where cables can touch; scratch [m]
    real(wp), allocatable :: moved(:, :)       !! (3,n_node) scratch of the projection, where cables can touch [m]
    real(wp), allocatable :: outside(:)        !! (n_pad) scratch: of the body's box [m]
    real(wp), allocatable :: node_gap(:)       !! (n_pad) scratch of the narrow phase [m]
  end type contact_work_t

contains

  !> Allocate the scratch of one run.
  subroutine new_contact_work(work, model)
    type(contact_work_t), intent(out) :: work
    type(model_t), intent(in) :: model
    real(wp) :: skin
    if (is_compliant(model)) call reserve_contacts(work%list, model%net%n_node)
    if (.not. is_modelled(model)) return
    call reserve_contacts(work%list, model%net%n_node + merge(model%net%n_cable, 0, model%contact%detect_cables))
    call reserve_solver(work%solver, work%list, model%net%n_node, model%contact)
    skin = merge(skin_thresholds_cables, skin_thresholds, model%contact%detect_cables)*model%contact%threshold
    call reserve_near(work%near, model%net, model%target%shape, model%contact%detect_cables, skin)
    call new_incidence(work%incidence, model%net)
    call new_fast_nodes(work%fast, model%net%n_node)
    allocate (work%y(model%net%n_pad, 3), work%outside(model%net%n_pad), source=0.0_wp)
    allocate (work%node_gap(model%net%n_pad), source=huge(1.0_wp))
    if (model%contact%detect_cables) allocate (work%moved(3, model%net%n_node))
  end subroutine new_contact_work

  !> Is there anything for impulses to do?
  pure logical function is_modelled(model)
    type(model_t), intent(in) :: model
    is_modelled = allocated(model%net) .and. allocated(model%target) .and. allocated(model%contact)
    if (is_modelled) is_modelled = model%contact%law == law_impulse .and. model%net%n_node > 0
  end function is_modelled

  !> Contact at the end of a step: impulses on node velocities and the target's twist, in
  !> push_only also sunken nodes back to the surface; ledger, tally, histogram and first
  !> contact. Costs a comparison while nothing can touch. No allocation. Compliant laws
  !> have acted within the step: of them the books are kept only.
  subroutine handle_contacts(model, state, work, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(contact_work_t), intent(inout) :: work
    type(error_t), allocatable, intent(inout) :: error
    real(wp) :: r(3, 3)
    work%acted = .false.
    work%acted_beyond = .false.
    if (is_compliant(model)) call watch_springs(model, state, work)
    if (.not. is_modelled(model)) return
    if (state%time < state%skip_contact_until) return
    call look_near(model, state, work, r)
    if (work%fast%possible) then
      call catch_fast(model, state, r, work%near, work%fast, work%incidence)
      if (work%fast%n > 0) call renew_near(model, state, work, r)
    end if
    call meet_at_end(model, state, work, r)
    if (work%fast%n == 0) return
    call release_fast(model, state, work%fast, work%incidence)
    work%acted = .true.
    work%acted_beyond = .true.
  end subroutine handle_contacts

  !> The contacts of this instant, detected, resolved and put back.
  subroutine meet_at_end(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(inout) :: r(3, 3)         !! the target's attitude
    call list_contacts(model, state, work, r)
    if (.not. work%engaged) then
      call look_ahead(model, state)
      return
    end if
    if (work%list%n == 0) return
    call exchange_impulses(model, state, work, r)
    if (model%contact%push_only) then
      call project_positions(model, state, work, r)
    else
      state%tally%deepest_penetration = max(state%tally%deepest_penetration, -minval(work%list%gap(1:work%list%n)))
    end if
  end subroutine meet_at_end

  !> Nothing is near: for how long? Asked now and then, and when an answer has just run out.
  subroutine look_ahead(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    real(wp) :: until
    if (mod(state%step, horizon_stride) /= 0_i8 .and. &
        state%skip_contact_until <= state%time - 0.999_wp*model%step) return
    until = earliest_contact_time(model, state)
    if (until >= state%time + worth_skipping*model%step) state%skip_contact_until = until
  end subroutine look_ahead

  !> Fill `work%list` with every contact of this instant; `r` is the target's attitude.
  subroutine detect_contacts(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(out) :: r(3, 3)
    call look_near(model, state, work, r)
    call list_contacts(model, state, work, r)
  end subroutine detect_contacts

  !> Bring the near list up to date: it stands while no node can have come from beyond it, now
  !> or on its way within the step.
  subroutine look_near(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(out) :: r(3, 3)           !! the target's attitude
    real(wp) :: top, way
    associate (net => model%net, body => state%target, near => work%near)
      r = rotation_matrix(body%attitude)
      call farthest_and_fastest(net%n_node, net%n_pad, state%node_position, state%node_velocity, body%position, &
                                body%velocity, near%reference, work%move, top)
      call look_for_fast(model, state, near%radius, top, work%fast)
      way = merge(work%fast%way, 0.0_wp, work%fast%possible)
      work%move = work%move + turned_by(near, body%attitude)
      if (.not. near%built .or. .not. work%move + way*(1.0_wp + 1.0e-9_wp) <= near%skin) call renew_near(model, state, work, r)
    end associate
  end subroutine look_near

  subroutine renew_near(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(in) :: r(3, 3)
    call rebuild_near(work%near, model%net, model%target%shape, model%net%n_pad, state%node_position, state%target%position, &
                      state%target%attitude, r, model%contact%threshold, model%contact%detect_cables, work%y, work%outside)
    work%move = 0.0_wp
  end subroutine renew_near

  !> The contacts among what is near.
  subroutine list_contacts(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(in) :: r(3, 3)
    real(wp) :: rate(3)
    work%list%n = 0
    associate (net => model%net, body => state%target, threshold => model%contact%threshold, near => work%near)
      work%engaged = near%n_node + near%n_cable > 0
      if (.not. work%engaged) return
      call append_nodes(near, work%move, threshold, net, model%target%shape, net%n_pad, state%node_position, &
                        body%position, r, model%target%fixed, work%list)
      if (model%contact%detect_cables) then
        call into_body_axes(net%n_node, net%n_pad, state%node_position, body%position, r, near%middle, near%half, &
                            work%y, work%outside)
        call append_cables(near, work%move, threshold, net, model%target%shape, net%n_pad, &
                           state%node_position, work%y, body%position, r, model%target%fixed, &
                           work%node_gap, work%list)
      end if
      if (work%list%n == 0) return
      rate = multiply(r, body%angular_velocity)
      ! Against the frame: its rate is (0, -n, 0). A fixed target is fixed in the frame.
      if (.not. model%target%fixed) rate(2) = rate(2) + model%orbit_rate
      call set_velocities(net%n_pad, state%node_velocity, body%velocity, rate, work%list)
    end associate
  end subroutine list_contacts

  !> The target's inertia in inertial axes.
  pure function body_inertia(model, r) result(body)
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: r(3, 3)
    type(body_inertia_t) :: body
    if (model%target%fixed) return
    body%free = .true.
    body%mass = model%target%mass
    body%inverse_mass = model%target%inverse_mass
    body%inertia = congruent(r, model%target%inertia)
    body%inverse_inertia = congruent(r, model%target%inverse_inertia)
  end function body_inertia

  !> Impulses of the list, and what they do.
  subroutine exchange_impulses(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(in) :: r(3, 3)
    type(body_inertia_t) :: body
    body = body_inertia(model, r)
    call resolve_contacts(model%contact, body, work%list, work%solver, work%report)
    call kick_nodes(model%net%n_pad, state%node_velocity, work%list)
    ! The velocity that 'midpoint' carries ahead jumps alike.
    if (allocated(state%velocity_ahead)) call kick_nodes(model%net%n_pad, state%velocity_ahead, work%list)
    if (body%free) then
      state%target%velocity = state%target%velocity + work%report%twist(1:3)
      state%target%angular_velocity = state%target%angular_velocity + multiply_transposed(r, work%report%twist(4:6))
      ! Impulses against the orbital frame, which turns at W = (0,-n,0), do the work
      ! W . (change of the spin's momentum) on the inertial spin besides their own loss.
      if (abs(model%orbit_rate) > 0.0_wp) state%ledger%external_work = state%ledger%external_work - model%orbit_rate* &
          (body%inertia(2, 1)*work%report%twist(4) + body%inertia(2, 2)*work%report%twist(5) &
           + body%inertia(2, 3)*work%report%twist(6))
    end if
    call keep_books(model, state, work)
  end subroutine exchange_impulses

  !> Velocities of the nodes after the impulses (equation 6).
  pure subroutine kick_nodes(n_pad, v, list)
    integer, intent(in) :: n_pad
    real(wp), intent(inout) :: v(n_pad, 3)
    type(contact_list_t), intent(in) :: list
    real(wp) :: p, q, push
    integer :: k, a, b, c
    do k = 1, list%n
      a = list%node_a(k)
      b = list%node_b(k)
      p = list%weight_a(k)*list%inverse_mass_a(k)
      q = list%share(k)*list%inverse_mass_b(k)
      do c = 1, 3
        push = list%impulse(k)*list%normal(k, c) + list%friction_impulse(k, c)
        v(a, c) = v(a, c) + p*push
        v(b, c) = v(b, c) + q*push
      end do
    end do
  end subroutine kick_nodes

  !> Ledger, tally, histogram, first contact.
  subroutine keep_books(model, state, work)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp) :: j
    integer :: k
    associate (tally => state%tally, list => work%list)
      tally%contact_residual = max(tally%contact_residual, work%report%residual)
      tally%contact_iterations = max(tally%contact_iterations, work%report%iterations)
      do k = 1, list%n
        j = list%impulse(k)
        if (.not. abs(j) > 0.0_wp) cycle
        work%acted = .true.
        call count_impulse(state, model%net%is_bullet(list%node_a(k)) .or. model%net%is_bullet(list%node_b(k)), j)
      end do
      if (work%acted) then
        state%ledger%contact_loss = state%ledger%contact_loss + work%report%energy_loss
        if (state%first_contact < 0.0_wp) state%first_contact = state%time
      end if
    end associate
  end subroutine keep_books

  !> One impulse [N s] into tally and histogram.
  pure subroutine count_impulse(state, of_bullet, j)
    type(state_t), intent(inout) :: state
    logical, intent(in) :: of_bullet
    real(wp), intent(in) :: j
    logical :: first_one
    integer :: bin
    associate (tally => state%tally)
      tally%contacts = tally%contacts + 1_i8
      if (of_bullet) then
        tally%max_bullet_impulse = max(tally%max_bullet_impulse, j)
        return
      end if
      ! Until the first impulse of a row all three are zero together.
      first_one = .not. (abs(tally%impulse_sum) > 0.0_wp .or. abs(tally%max_impulse) > 0.0_wp &
                         .or. abs(tally%min_impulse) > 0.0_wp)
      tally%min_impulse = merge(j, min(tally%min_impulse, j), first_one)
      tally%max_impulse = max(tally%max_impulse, j)
      tally%impulse_sum = tally%impulse_sum + j
      if (.not. allocated(state%impulse_histogram)) return
      bin = 1 + floor(impulse_bins_per_decade*log10(abs(j)/impulse_bin_low))
      bin = min(impulse_bins, max(1, bin))
      state%impulse_histogram(bin) = state%impulse_histogram(bin) + 1_i8
    end associate
  end subroutine count_impulse

  !> Books of a compliant law at the step's end: every node that is pushed counts as one
  !> contact, with the normal force times the step for its impulse.
  subroutine watch_springs(model, state, work)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp) :: deepest
    integer :: k
    associate (list => work%list, net => model%net)
      call list_pushed(model, net%n_pad, state%node_position, state%node_velocity, state%target, list%n, list%node_a, &
                       list%impulse, deepest)
      do k = 1, list%n
        call count_impulse(state, net%is_bullet(list%node_a(k)), model%step*list%impulse(k))
      end do
      if (list%n > 0 .and. state%first_contact < 0.0_wp) state%first_contact = state%time
      state%tally%deepest_penetration = max(state%tally%deepest_penetration, deepest)
    end associate
  end subroutine watch_springs

  !> Sunken points back onto the surface, and the elastic energy that it changes. Flat
  !> faces need one pass; over edges the linearised surface is corrected by another.
  subroutine project_positions(model, state, work, r)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(inout) :: r(3, 3)
    type(body_inertia_t) :: body
    real(wp) :: before, after, shift(6), deepest, budget, largest
    integer :: pass
    deepest = max(0.0_wp, -minval(work%list%gap(1:work%list%n)))
    if (deepest > 0.0_wp) then
      budget = most_moves*deepest
      do pass = 1, max_projection
        body = body_inertia(model, r)
        call resolve_depths(body, work%list, work%solver, shift)
        if (allocated(work%moved)) then
          largest = largest_move(work%list, work%solver%normal%impulse, work%moved)
          if (largest > budget) then
            work%solver%normal%impulse = work%solver%normal%impulse*(budget/largest)
            shift = shift*(budget/largest)
          end if
          budget = budget - largest
        end if
        associate (net => model%net)
          call energy_of_moved_cables(net, net%n_pad, state%node_position, work%list, work%solver%normal%impulse, &
                                      work%incidence, before)
          call move_nodes(net%n_pad, state%node_position, work%list, work%solver%normal%impulse)
          call energy_of_moved_cables(net, net%n_pad, state%node_position, work%list, work%solver%normal%impulse, &
                                      work%incidence, after)
        end associate
        state%ledger%projection_work = state%ledger%projection_work + (after - before)
        if (body%free) then
          state%target%position = state%target%position + shift(1:3)
          state%target%attitude = normalise_quaternion(quaternion_product( &
                                  quaternion_from_rotation_vector(shift(4:6)), state%target%attitude))
          r = rotation_matrix(state%target%attitude)
        end if
        work%acted = .true.
        call remeasure(model, state, work, r, deepest)
        if (deepest <= projection_tolerance*model%contact%threshold .or. budget <= 0.0_wp) exit
      end do
    end if
    state%tally%deepest_penetration = max(state%tally%deepest_penetration, deepest)
  end subroutine project_positions

  !> Gaps, normals, arms and cables' shares of the list after its points have moved.
  subroutine remeasure(model, state, work, r, deepest)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(contact_work_t), intent(inout) :: work
    real(wp), intent(in) :: r(3, 3)
    real(wp), intent(out) :: deepest  !! [m], >= 0
    integer :: k, m, n, n_node_contact
    deepest = 0.0_wp
    ! All nodes at once, then all cables: the distances of many cost much less than many distances.
    associate (list => work%list, near => work%near, shape => model%target%shape)
      n = 0
      do k = 1, list%n
        if (list%node_b(k) /= list%node_a(k)) cycle
        n = n + 1
        near%found(n) = k
        near%a(:, n) = in_body_axes(list%node_a(k))
      end do
      call signed_distance(shape, n, near%a, near%distance, near%normal)
      do m = 1, n
        deepest = max(deepest, -near%distance(m))
        call place(near%found(m), from_body(list%node_a(near%found(m))), near%distance(m), near%normal(:, m))
      end do
      n_node_contact = n
      if (n_node_contact == list%n) return
      n = 0
      do k = 1, list%n
        if (list%node_b(k) == list%node_a(k)) cycle
        n = n + 1
        near%found(n) = k
        near%a(:, n) = in_body_axes(list%node_a(k))
        near%b(:, n) = in_body_axes(list%node_b(k))
      end do
      call segment_distance(shape, n, near%a, near%b, near%fraction, near%distance, near%normal)
      do m = 1, n
        k = near%found(m)
        list%share(k) = near%fraction(m)
        list%weight_a(k) = 1.0_wp - near%fraction(m)
        deepest = max(deepest, -near%distance(m))
        if (near%distance(m) < 0.0_wp) call mend_normal(shape, near%a(:, m), near%b(:, m), near%fraction(m), &
                                                        near%distance(m), near%normal(:, m))
        call place(k, list%weight_a(k)*from_body(list%node_a(k)) + near%fraction(m)*from_body(list%node_b(k)), &
                   near%distance(m), near%normal(:, m))
      end do
    end associate

  contains

    !> From the body's centre of mass to a node, inertial axes [m].
    pure function from_body(i) result(arm)
      integer, intent(in) :: i
      real(wp) :: arm(3)
      arm(1) = state%node_position(i, 1) - state%target%position(1)
      arm(2) = state%node_position(i, 2) - state%target%position(2)
      arm(3) = state%node_position(i, 3) - state%target%position(3)
    end function from_body

    pure function in_body_axes(i) result(y)
      integer, intent(in) :: i
      real(wp) :: y(3)
      y = multiply_transposed(r, from_body(i))
    end function in_body_axes

    !> What was measured, to the list; the normal comes in body axes.
    subroutine place(contact, arm, gap, g)
      integer, intent(in) :: contact
      real(wp), intent(in) :: arm(3), gap, g(3)
      real(wp) :: normal(3)
      integer :: c
      normal = multiply(r, g)
      work%list%gap(contact) = gap
      do c = 1, 3
        work%list%arm(contact, c) = arm(c)
        work%list%normal(contact, c) = normal(c)
      end do
    end subroutine place

  end subroutine remeasure

end module castnet_contact_event
