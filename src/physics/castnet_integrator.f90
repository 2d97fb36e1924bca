!> One time step of net and target as one system, without contact impulses.
!>
!> Each stage is one sweep over the nodes (castnet_cable_force): tensions, forces and
!> the stage update chunk by chunk. The net couples to the target within a step only
!> through `gather_extra_force` (compliant contact); impulses come after the step. The closing
!> threads are such a force with rk4; with midpoint their nodes go through the step again
!> (castnet_thread_flow).
module castnet_integrator
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, method_adaptive, method_midpoint
  use castnet_net, only: net_t
  use castnet_state, only: state_t, body_state_t
  use castnet_body_dynamics, only: body_rate_t, body_rate, body_advance, body_rk4, body_alone, body_kick, &
                                   orbital_acceleration
  use castnet_cable_plan, only: cable_plan_t
  use castnet_cable_force, only: slab_t, chunk_size, new_slabs, slab_halo, chunk_cables, chunk_rest, &
                                 block_cables, loose_cables, sum_in_order
  use castnet_closing_thread, only: impulse_work
  use castnet_extra_force, only: has_extra_force, gather_extra_force
  use castnet_thread_flow, only: thread_flow_t, new_thread_flow, begin_threads, finish_threads
  implicit none
  private
  public :: flow_work_t, new_flow_work, rk4_step, midpoint_step, midpoint_begin, midpoint_damping, &
            midpoint_positions, midpoint_disturbed, midpoint_disturbed_at

  !> Scratch of the cable forces.
  type :: cable_work_t
    type(slab_t), allocatable :: slabs(:)
    real(wp), allocatable :: loose_force(:, :)     !! (0:n_loose,3), number 0 none [N]
    real(wp), allocatable :: loose_power(:)        !! (n_loose) of those in no block [W]
    real(wp), allocatable :: block_power(:)        !! (blocks) [W]
    real(wp), allocatable :: chunk_power(:)        !! (n_chunk) [W]
    real(wp), allocatable :: support_power(:)      !! (n_chunk) done by fixed nodes that are led along, where there are any [W]
    real(wp), allocatable :: weight(:)             !! (n_pad) 1/mass; 1 where a field has already divided [1/kg]
    real(wp), allocatable :: thread_impulse(:, :)  !! (n_pad,3) of the closing threads over a step of rk4, only with them [N s]
    real(wp), allocatable :: extra(:, :)           !! (n_pad,3) forces besides cables, only where a scene has some [N]
  end type cable_work_t

  !> Scratch of the integrator, allocated once.
  type :: flow_work_t
    type(cable_work_t) :: cables
    real(wp), allocatable :: xa(:, :), xb(:, :)                     !! (n_pad,3) stage positions
    real(wp), allocatable :: va(:, :), vb(:, :), vc(:, :)           !! (n_pad,3) stage velocities: rk4's second, third, fourth
    real(wp), allocatable :: start_x(:, :), start_v(:, :)           !! (n_pad,3) where a step began, 'adaptive' only
    type(thread_flow_t), allocatable :: threads    !! of midpoint, only with closing threads
    type(body_state_t) :: body_stage               !! the target at the last stage of rk4
    real(wp) :: body_force(3) = 0.0_wp             !! on the target besides external_force, inertial [N]
    real(wp) :: body_torque(3) = 0.0_wp            !! on the target besides external_torque, body axes [N m]
    logical :: midpoint_ready = .false.            !! xa holds the next midpoint
    logical :: positions_lag = .false.             !! state%node_position is still that of some step before
  end type flow_work_t

  integer, parameter :: loose_worth_threads = 1024 !! fewer loose cables are not worth a parallel region
  real(wp), parameter :: extrapolation = 0.4_wp    !! see midpoint_damping

  !> What a sweep does with the accelerations a of its nodes.
  integer, parameter :: stage_inner = 1   !! rk4: out = x0 + h v, v0 + h a
  integer, parameter :: stage_last = 2    !! rk4: the step's end from the velocities of all stages
  integer, parameter :: stage_kick = 3    !! midpoint: v0 = v0 + h a, out = the next midpoint

contains

  !> Allocate the scratch of one run.
  subroutine new_flow_work(work, model, n_thread)
    type(flow_work_t), intent(out) :: work
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_thread  !! threads for the net
    integer :: n

    if (.not. allocated(model%net)) return
    n = model%net%n_pad
    associate (plan => model%net%plan)
      call new_slabs(work%cables%slabs, plan, model%net%n_node, n_thread)
      allocate (work%cables%loose_force(0:plan%n_loose, 3), work%cables%loose_power(plan%n_loose), &
                work%cables%block_power(size(plan%block_start) - 1), source=0.0_wp)
    end associate
    allocate (work%cables%chunk_power((n + chunk_size - 1)/chunk_size), source=0.0_wp)
    if (any(model%net%fixed)) allocate (work%cables%support_power((n + chunk_size - 1)/chunk_size), source=0.0_wp)
    work%cables%weight = model%net%inverse_mass
    if (any(model%gravity /= 0.0_wp) .or. model%orbit_rate /= 0.0_wp) work%cables%weight = 1.0_wp
    if (has_extra_force(model)) allocate (work%cables%extra(n, 3), source=0.0_wp)
    if (allocated(model%closing)) then
      if (model%method == method_midpoint) then
        allocate (work%threads)
        call new_thread_flow(work%threads, model%closing, model%net)
      else
        allocate (work%cables%thread_impulse(n, 3), source=0.0_wp)
      end if
    end if
    allocate (work%xa(n, 3), work%xb(n, 3), work%vb(n, 3), source=0.0_wp)
    if (model%method /= method_midpoint) allocate (work%va(n, 3), work%vc(n, 3), source=0.0_wp)
    if (model%method == method_adaptive) allocate (work%start_x(n, 3), work%start_v(n, 3), source=0.0_wp)
  end subroutine new_flow_work

  !> Classical Runge-Kutta of order 4 for net and target together. No slopes are added up:
  !> the step's end follows from the velocities of the stages and the last acceleration
  !> (update_last), which saves a third of the memory traffic. The velocities at the last
  !> stage stay in work%vc and work%body_stage: castnet_adaptive finds the step's error in them.
  subroutine rk4_step(model, state, work, h)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(flow_work_t), intent(inout) :: work
    real(wp), intent(in) :: h !! [s]
    type(body_state_t), allocatable :: body
    type(body_rate_t) :: k(4)
    real(wp) :: power(2, 4)  !! of the cables' damping and of the supports at each stage [W]
    real(wp) :: work_done(2)
    logical :: has_net, moves
    integer :: n

    has_net = allocated(model%net)
    moves = .false.
    if (allocated(model%target)) moves = .not. model%target%fixed
    n = 0
    if (has_net) n = model%net%n_pad
    if (allocated(state%target)) body = state%target
    if (allocated(work%cables%thread_impulse)) work%cables%thread_impulse = 0.0_wp

    if (allocated(work%cables%extra)) call gather_extra_force(model, n, state%node_position, state%node_velocity, &
        body, state%closing, work%cables%extra, work%body_force, work%body_torque, h/6.0_wp, work%cables%thread_impulse, &
        state%ledger)
    if (moves) k(1) = body_rate(model, body, work%body_force, work%body_torque)
    if (has_net) call sweep(model, work%cables, stage_inner, n, 0.5_wp*h, state%node_position, state%node_velocity, &
        state%node_position, state%node_velocity, work%xa, work%va, power(:, 1))

    if (moves) body = body_advance(state%target, k(1), 0.5_wp*h)
    if (allocated(work%cables%extra)) call gather_extra_force(model, n, work%xa, work%va, &
        body, state%closing, work%cables%extra, work%body_force, work%body_torque, h/3.0_wp, work%cables%thread_impulse, &
        state%ledger)
    if (moves) k(2) = body_rate(model, body, work%body_force, work%body_torque)
    if (has_net) call sweep(model, work%cables, stage_inner, n, 0.5_wp*h, work%xa, work%va, &
        state%node_position, state%node_velocity, work%xb, work%vb, power(:, 2))

    if (moves) body = body_advance(state%target, k(2), 0.5_wp*h)
    if (allocated(work%cables%extra)) call gather_extra_force(model, n, work%xb, work%vb, &
        body, state%closing, work%cables%extra, work%body_force, work%body_torque, h/3.0_wp, work%cables%thread_impulse, &
        state%ledger)
    if (moves) k(3) = body_rate(model, body, work%body_force, work%body_torque)
    if (has_net) call sweep(model, work%cables, stage_inner, n, h, work%xb, work%vb, &
        state%node_position, state%node_velocity, work%xa, work%vc, power(:, 3))

    if (moves) body = body_advance(state%target, k(3), h)
    if (moves) work%body_stage = body
    if (allocated(work%cables%extra)) call gather_extra_force(model, n, work%xa, work%vc, &
        body, state%closing, work%cables%extra, work%body_force, work%body_torque, h/6.0_wp, work%cables%thread_impulse, &
        state%ledger)
    call credit_winch(work%cables, state)
    if (moves) then
      k(4) = body_rate(model, body, work%body_force, work%body_torque)
      state%ledger%external_work = state%ledger%external_work + torque_work(model, state%target, k(1), k(2), k(3), h)
      call body_rk4(state%target, k(1), k(2), k(3), k(4), h)
    end if
    if (has_net) call sweep(model, work%cables, stage_last, n, h/6.0_wp, work%xa, work%vc, &
        state%node_position, state%node_velocity, work%va, work%vb, power(:, 4))
    call credit_winch(work%cables, state)
    if (has_net) then
      work_done = h/6.0_wp*((power(:, 1) + 2.0_wp*(power(:, 2) + power(:, 3))) + power(:, 4))
      state%ledger%dissipated = state%ledger%dissipated + work_done(1)
      state%ledger%external_work = state%ledger%external_work + work_done(2)
    end if
    state%force_evaluations = state%force_evaluations + 4
  end subroutine rk4_step

  !> Make a state ready for `midpoint_step`: at the start there is no force to extrapolate
  !> the velocity with.
  subroutine midpoint_begin(state)
    type(state_t), intent(inout) :: state
    if (allocated(state%node_velocity)) state%velocity_ahead = state%node_velocity
  end subroutine midpoint_begin

  !> Drift-kick-drift with one force evaluation: half drift, force at the midpoint
  !> position with the velocity extrapolated there for the damping, kick, half drift.
  !>
  !> The second half drift and the next step's first are one addition, so the positions
  !> at the step's end are not stored: `midpoint_positions` gives them to whoever looks.
  !> That saves a third of the memory traffic; the bits are the same either way.
  subroutine midpoint_step(model, state, work, h)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(flow_work_t), intent(inout) :: work
    real(wp), intent(in) :: h !! [s]
    type(body_state_t), allocatable :: body
    real(wp) :: power(2)  !! of the cables' damping and of the supports [W]
    logical :: moves, coupled, reeled
    integer :: n

    moves = .false.
    if (allocated(model%target)) moves = .not. model%target%fixed
    coupled = allocated(work%cables%extra)
    if (allocated(model%net)) then
      n = model%net%n_pad
      if (.not. work%midpoint_ready) work%xa = state%node_position + (0.5_wp*h)*state%node_velocity
      if (coupled) then
        if (allocated(state%target)) body = state%target
        if (moves) call body_flow(model, body, 0.5_wp*h, state%ledger%external_work)
        call gather_extra_force(model, n, work%xa, state%velocity_ahead, body, state%closing, &
                                work%cables%extra, work%body_force, work%body_torque, h, work%cables%thread_impulse, &
                                state%ledger)
      end if
      reeled = .false.
      if (allocated(work%threads)) reeled = state%closing%pulling
      if (reeled) call begin_threads(work%threads, n, h, work%xa, state%node_velocity)
      call sweep(model, work%cables, stage_kick, n, h, work%xa, state%velocity_ahead, &
                 state%node_position, state%node_velocity, work%xb, work%vb, power)
      state%ledger%dissipated = state%ledger%dissipated + h*power(1)
      state%ledger%external_work = state%ledger%external_work + h*power(2)
      if (reeled) call finish_threads(work%threads, model%closing, state%closing, n, h, state%node_velocity, work%xa, &
                                      work%xb, work%vb, state%ledger%winch_work, state%ledger%external_work)
      call swap(work%xa, work%xb)    ! xa: the next midpoint, xb: this one
      call swap(state%velocity_ahead, work%vb)
      work%midpoint_ready = .true.
      work%positions_lag = .true.
      state%force_evaluations = state%force_evaluations + 1
    end if
    if (.not. moves) return
    if (coupled) then
      call body_kick(model%target, body, h*work%body_force, h*work%body_torque)
      call body_flow(model, body, 0.5_wp*h, state%ledger%external_work)
      state%target = body
    else
      call body_flow(model, state%target, h, state%ledger%external_work)
    end if
  end subroutine midpoint_step

  !> The damping that the one-stage method applies. It extrapolates velocities to the
  !> midpoint, v(t) + h/2 a(t - h/2), which damps a mode of frequency w 1 + (h w)^2/2 times
  !> too fast, and higher orders. Each cable's coefficient is divided by 1 + 0.4 (h w)^2 at
  !> the frequency of the cable alone between its two ends, w^2 = k/mu: second order in h, as
  !> the method is. 0.4, not 1/2, because what is damped are waves that are longer than one
  !> cable; chosen by ensembles (docs/performance.md). Without it a rocket's capture at 0.7
  !> of the stability limit is one with a damping ratio of 0.125 in place of 0.1.
  subroutine midpoint_damping(net, h)
    type(net_t), intent(inout) :: net
    real(wp), intent(in) :: h !! [s]
    real(wp) :: squared       !! w^2 [1/s2]
    integer :: c
    do c = 1, net%n_cable
      squared = net%axial_stiffness(c)/net%natural_length(c) &
                *(net%inverse_mass(net%cable_nodes(1, c)) + net%inverse_mass(net%cable_nodes(2, c)))
      associate (slot => net%plan%slot_of_cable(c))
        net%plan%applied_damping(slot) = net%plan%damping(slot)/(1.0_wp + extrapolation*h*h*squared)
      end associate
    end do
  end subroutine midpoint_damping

  !> Positions at the end of the last step, from its midpoint.
  subroutine midpoint_positions(state, work, h)
    type(state_t), intent(inout) :: state
    type(flow_work_t), intent(inout) :: work
    real(wp), intent(in) :: h !! [s]
    if (.not. work%positions_lag) return
    state%node_position = work%xb + (0.5_wp*h)*state%node_velocity
    work%positions_lag = .false.
  end subroutine midpoint_positions

  !> After impulses or a projection: the next midpoint has to be drifted anew.
  subroutine midpoint_disturbed(work)
    type(flow_work_t), intent(inout) :: work
    work%midpoint_ready = .false.
  end subroutine midpoint_disturbed

  !> The same where only these nodes' positions or velocities have changed: all others have
  !> their next midpoint, by the very sum that would be taken anew. The state is settled.
  subroutine midpoint_disturbed_at(state, work, h, node)
    type(state_t), intent(in) :: state
    type(flow_work_t), intent(inout) :: work
    real(wp), intent(in) :: h         !! [s]
    integer, intent(in) :: node(:)    !! counted from 1, may be repeated
    integer :: k, c
    if (.not. work%midpoint_ready) return
    do c = 1, 3
      do k = 1, size(node)
        work%xa(node(k), c) = state%node_position(node(k), c) + (0.5_wp*h)*state%node_velocity(node(k), c)
      end do
    end do
  end subroutine midpoint_disturbed_at

  !> Half of the work of the threads' impulse at this velocity: called before and after
  !> the velocities move.
  subroutine credit_winch(cables, state)
    type(cable_work_t), intent(in) :: cables
    type(state_t), intent(inout) :: state
    if (.not. allocated(cables%thread_impulse)) return
    state%ledger%winch_work = state%ledger%winch_work &
                              + impulse_work(size(state%node_velocity, 1), cables%thread_impulse, state%node_velocity)
  end subroutine credit_winch

  subroutine swap(a, b)
    real(wp), allocatable, intent(inout) :: a(:, :), b(:, :)
    real(wp), allocatable :: c(:, :)
    call move_alloc(a, c)
    call move_alloc(b, a)
    call move_alloc(c, b)
  end subroutine swap

  !> The target alone over h, by one Runge-Kutta step.
  subroutine body_flow(model, body, h, work_done)
    type(model_t), intent(in) :: model
    type(body_state_t), intent(inout) :: body
    real(wp), intent(in) :: h
    real(wp), intent(inout) :: work_done  !! by the external torque, added to [J]
    type(body_rate_t) :: k1, k2, k3, k4
    real(wp), parameter :: none(3) = 0.0_wp
    real(wp) :: turn(3)
    if (.not. abs(model%orbit_rate) > 0.0_wp) then
      call body_alone(model, body, h, turn)
      associate (torque => model%target%external_torque)
        work_done = work_done + (torque(1)*turn(1) + torque(2)*turn(2) + torque(3)*turn(3))
      end associate
      return
    end if
    k1 = body_rate(model, body, none, none)
    k2 = body_rate(model, body_advance(body, k1, 0.5_wp*h), none, none)
    k3 = body_rate(model, body_advance(body, k2, 0.5_wp*h), none, none)
    k4 = body_rate(model, body_advance(body, k3, h), none, none)
    work_done = work_done + torque_work(model, body, k1, k2, k3, h)
    call body_rk4(body, k1, k2, k3, k4, h)
  end subroutine body_flow

  !> Work of the external torque over a step that starts at `body` [J]: the torque times the
  !> integral of w by the step's own rule, h (w1 + 2 w2 + 2 w3 + w4)/6.
  pure real(wp) function torque_work(model, body, k1, k2, k3, h)
    type(model_t), intent(in) :: model
    type(body_state_t), intent(in) :: body
    type(body_rate_t), intent(in) :: k1, k2, k3
    real(wp), intent(in) :: h
    real(wp) :: turn(3)
    turn = h*(body%angular_velocity + h/6.0_wp*(k1%angular_velocity + k2%angular_velocity + k3%angular_velocity))
    associate (torque => model%target%external_torque)
      torque_work = torque(1)*turn(1) + torque(2)*turn(2) + torque(3)*turn(3)
    end associate
  end function torque_work

  !> One stage over all nodes. x, v: the stage's state. x0, v0: the step's start and, at
  !> the last stage, its end. out1, out2: positions and velocities of the next stage; at the
  !> last stage, velocities of the second and third. Nothing that is written is passed twice.
  subroutine sweep(model, cables, stage, n_pad, h, x, v, x0, v0, out1, out2, power)
    type(model_t), intent(in) :: model
    type(cable_work_t), intent(inout) :: cables
    integer, intent(in) :: stage, n_pad
    real(wp), intent(in) :: h
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(inout) :: x0(n_pad, 3), v0(n_pad, 3), out1(n_pad, 3), out2(n_pad, 3)
    real(wp), intent(out) :: power(2)  !! taken by the damping of all cables; done by moving supports [W]
    real(wp) :: floor_tension
    integer :: s

    floor_tension = 0.0_wp
    if (.not. model%net%clamp_tension) floor_tension = -huge(1.0_wp)
    if (model%net%plan%n_loose > 0) call sweep_loose(model%net%plan, cables, n_pad, x, v, floor_tension)
    if (size(cables%slabs) == 1) then
      call sweep_slab(model, cables, cables%slabs(1), stage, n_pad, h, floor_tension, x, v, x0, v0, out1, out2)
    else
      !$omp parallel do default(shared) private(s) schedule(static, 1) num_threads(size(cables%slabs))
      do s = 1, size(cables%slabs)
        call sweep_slab(model, cables, cables%slabs(s), stage, n_pad, h, floor_tension, x, v, x0, v0, out1, out2)
      end do
      !$omp end parallel do
    end if
    associate (plan => model%net%plan)
      power(1) = sum_in_order(size(cables%chunk_power), cables%chunk_power) &
                 + sum_in_order(plan%n_loose - plan%n_layered, cables%loose_power(plan%n_layered + 1:)) &
                 + sum_in_order(size(cables%block_power), cables%block_power)
    end associate
    power(2) = 0.0_wp
    if (allocated(cables%support_power)) power(2) = sum_in_order(size(cables%support_power), cables%support_power)
  end subroutine sweep

  !> Loose cables besides those that the sweep does as it goes: single ones and, for more than one slab, blocks,
  !> on the slabs' threads where there are many.
  subroutine sweep_loose(plan, cables, n_pad, x, v, floor_tension)
    type(cable_plan_t), intent(in) :: plan
    type(cable_work_t), intent(inout) :: cables
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3), floor_tension
    integer :: s, n, blocks, single

    n = size(cables%slabs)
    blocks = 0
    if (n > 1) blocks = size(cables%block_power)
    single = plan%n_loose - plan%n_layered
    if (plan%n_loose < loose_worth_threads) n = 1
    if (n == 1) then
      call share(1)
      return
    end if
    !$omp parallel do default(shared) private(s) schedule(static, 1) num_threads(n)
    do s = 1, n
      call share(s)
    end do
    !$omp end parallel do

  contains

    !> One of n equal parts.
    subroutine share(part)
      integer, intent(in) :: part
      if (blocks > 0) call block_cables(plan, begin(blocks, part), begin(blocks, part + 1) - 1, n_pad, x, v, floor_tension, &
                                        cables%loose_force, cables%block_power)
      call loose_cables(plan, plan%n_layered + begin(single, part), plan%n_layered + begin(single, part + 1) - 1, &
                        n_pad, x, v, floor_tension, cables%loose_force, cables%loose_power)
    end subroutine share

    integer function begin(all, part)
      integer, intent(in) :: all, part
      begin = int(int(all, 8)*(part - 1)/n) + 1
    end function begin

  end subroutine sweep_loose

  !> The chunks of one slab.
  subroutine sweep_slab(model, cables, slab, stage, n_pad, h, floor_tension, x, v, x0, v0, out1, out2)
    type(model_t), intent(in) :: model
    type(cable_work_t), intent(inout) :: cables
    type(slab_t), intent(inout) :: slab
    integer, intent(in) :: stage, n_pad
    real(wp), intent(in) :: h, floor_tension
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(inout) :: x0(n_pad, 3), v0(n_pad, 3), out1(n_pad, 3), out2(n_pad, 3)
    integer :: b, m, c, r, r1, r2, block, needed
    logical :: has_field, clean

    block = 1
    if (size(cables%slabs) > 1) block = size(cables%block_power) + 1   ! they are done already
    has_field = any(model%gravity /= 0.0_wp) .or. model%orbit_rate /= 0.0_wp
    clean = .false.
    associate (plan => model%net%plan, net => model%net, w => cables%weight, f => slab%force, rest => slab%other)
      call slab_halo(plan, slab, n_pad, x, v, floor_tension)
      do b = slab%first, slab%last, chunk_size
        m = min(chunk_size, slab%last - b + 1)
        call chunk_cables(plan, slab, b, b + m - 1, n_pad, x, v, floor_tension, cables%chunk_power((b - 1)/chunk_size + 1))
        needed = plan%block_needed((b - 1)/chunk_size + 1)
        if (block <= needed) then
          call block_cables(plan, block, needed, n_pad, x, v, floor_tension, cables%loose_force, cables%block_power)
          block = needed + 1
        end if
        call chunk_rest(plan, slab, b, b + m - 1, cables%loose_force, rest, clean)
        if (allocated(cables%extra)) then
          rest(:m, :) = rest(:m, :) + cables%extra(b:b + m - 1, :)
          clean = .false.
        end if
        ! Rows of the forces away from these nodes and, in either diagonal, of those towards them.
        r = b - slab%shift
        r1 = r - slab%offset(1)
        r2 = r - slab%offset(2)
        if (has_field .or. allocated(cables%support_power)) then
          call add_full_diagonals(m, r, slab, rest)
          r1 = r                             ! so that they count for nothing below
          r2 = r
          clean = .false.
          if (allocated(cables%support_power)) cables%support_power((b - 1)/chunk_size + 1) = &
              power_of_supports(m, net%fixed(b), n_pad, b, v, rest)
          ! Without a field, the update itself divides by the mass: one pass less.
          if (has_field) call force_to_acceleration(model, m, net%inverse_mass(b), n_pad, b, x, v, rest)
        end if
        do c = 1, 3
          select case (stage)
          case (stage_inner)
            call update_inner(m, h, f(r, c, 1), f(r1, c, 1), f(r, c, 2), f(r2, c, 2), rest(1, c), w(b), v(b, c), &
                              x0(b, c), v0(b, c), out1(b, c), out2(b, c))
          case (stage_last)
            call update_last(m, h, f(r, c, 1), f(r1, c, 1), f(r, c, 2), f(r2, c, 2), rest(1, c), w(b), &
                             out1(b, c), out2(b, c), v(b, c), x0(b, c), v0(b, c))
          case (stage_kick)
            call update_kick(m, h, f(r, c, 1), f(r1, c, 1), f(r, c, 2), f(r2, c, 2), rest(1, c), w(b), x(b, c), &
                             v0(b, c), out1(b, c), out2(b, c))
          end select
        end do
      end do
    end associate
  end subroutine sweep_slab

  !> A fixed node keeps the velocity that it is given: what leads it along works against the
  !> force on it [W].
  pure real(wp) function power_of_supports(m, fixed, n_pad, b, v, force) result(power)
    integer, intent(in) :: m, n_pad, b
    logical, intent(in) :: fixed(m)
    real(wp), intent(in) :: v(n_pad, 3)
    real(wp), intent(in) :: force(chunk_size, 3) !! [N]
    integer :: k
    power = 0.0_wp
    do k = 1, m
      if (fixed(k)) power = power - (force(k, 1)*v(b + k - 1, 1) + force(k, 2)*v(b + k - 1, 2) + force(k, 3)*v(b + k - 1, 3))
    end do
  end function power_of_supports

  !> Force -> acceleration, with gravity and the orbital frame on nodes that are free.
  subroutine force_to_acceleration(model, m, inverse_mass, n_pad, b, x, v, a)
    type(model_t), intent(in) :: model
    integer, intent(in) :: m, n_pad, b
    real(wp), intent(in) :: inverse_mass(m)
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(inout) :: a(chunk_size, 3)
    real(wp) :: frame(3), here(3), speed(3)
    integer :: c, k

    do c = 1, 3
      do k = 1, m
        a(k, c) = a(k, c)*inverse_mass(k)
      end do
      if (model%gravity(c) /= 0.0_wp) then
        do k = 1, m
          a(k, c) = a(k, c) + merge(model%gravity(c), 0.0_wp, inverse_mass(k) > 0.0_wp)
        end do
      end if
    end do
    if (model%orbit_rate /= 0.0_wp) then
      do k = 1, m
        here = x(b + k - 1, :)
        speed = v(b + k - 1, :)
        frame = orbital_acceleration(model%orbit_rate, here, speed)
        if (inverse_mass(k) > 0.0_wp) a(k, :) = a(k, :) + frame
      end do
    end if
  end subroutine force_to_acceleration

  !> The force of the full diagonals, before the rest.
  pure subroutine add_full_diagonals(m, r, slab, force)
    integer, intent(in) :: m, r                      !! nodes; row of the first one
    type(slab_t), intent(in) :: slab
    real(wp), intent(inout) :: force(chunk_size, 3)  !! [N]
    integer :: c, k
    do c = 1, 3
      do k = 0, m - 1
        force(1 + k, c) = (slab%force(r + k, c, 1) - slab%force(r + k - slab%offset(1), c, 1)) &
                          + (slab%force(r + k, c, 2) - slab%force(r + k - slab%offset(2), c, 2)) + force(1 + k, c)
      end do
    end do
  end subroutine add_full_diagonals

  ! In all updates: away1, back1, away2, back2 are the forces of the full diagonals' cables
  ! that begin and end at the nodes, rest all other force [N]; w is 1/mass [1/kg].

  !> A stage of rk4: from the step's start (x0, v0) with the slopes v and a.
  pure subroutine update_inner(m, h, away1, back1, away2, back2, rest, w, v, x0, v0, x_out, v_out)
    integer, intent(in) :: m
    real(wp), intent(in) :: h, away1(m), back1(m), away2(m), back2(m), rest(m), w(m), v(m), x0(m), v0(m)
    real(wp), intent(out) :: x_out(m), v_out(m)
    integer :: k
    !$omp simd simdlen(8)
    do k = 1, m
      x_out(k) = x0(k) + h*v(k)
      v_out(k) = v0(k) + h*(((away1(k) - back1(k)) + (away2(k) - back2(k)) + rest(k))*w(k))
    end do
  end subroutine update_inner

  !> The end of an rk4 step. With the stages' velocities v2 = v0 + h/2 a1, v3 = v0 + h/2 a2,
  !> v4 = v0 + h a3 the slopes need not be added up as they come:
  !> h/6 (a1 + 2 a2 + 2 a3) = ((v2 - v0) + 2 (v3 - v0) + (v4 - v0))/3.
  pure subroutine update_last(m, sixth, away1, back1, away2, back2, rest, w, v2, v3, v4, x0, v0)
    integer, intent(in) :: m
    real(wp), intent(in) :: sixth  !! of the step [s]
    real(wp), intent(in) :: away1(m), back1(m), away2(m), back2(m), rest(m), w(m), v2(m), v3(m), v4(m)
    real(wp), intent(inout) :: x0(m), v0(m)
    real(wp), parameter :: third = 1.0_wp/3.0_wp
    real(wp) :: a, v1
    integer :: k
    !$omp simd simdlen(8) private(a, v1)
    do k = 1, m
      a = ((away1(k) - back1(k)) + (away2(k) - back2(k)) + rest(k))*w(k)
      v1 = v0(k)
      x0(k) = x0(k) + sixth*((v1 + v4(k)) + 2.0_wp*(v2(k) + v3(k)))
      v0(k) = v1 + (third*(((v2(k) - v1) + (v4(k) - v1)) + 2.0_wp*(v3(k) - v1)) + sixth*a)
    end do
  end subroutine update_last

  !> The kick of the midpoint method and the drifts to the next midpoint.
  pure subroutine update_kick(m, h, away1, back1, away2, back2, rest, w, x, v0, x_out, v_out)
    integer, intent(in) :: m
    real(wp), intent(in) :: h, away1(m), back1(m), away2(m), back2(m), rest(m), w(m), x(m)
    real(wp), intent(inout) :: v0(m)
    real(wp), intent(out) :: x_out(m), v_out(m)
    real(wp) :: a, half
    integer :: k
    half = 0.5_wp*h
    !$omp simd simdlen(8) private(a)
    do k = 1, m
      a = ((away1(k) - back1(k)) + (away2(k) - back2(k)) + rest(k))*w(k)
      v0(k) = v0(k) + h*a
      x_out(k) = (x(k) + half*v0(k)) + half*v0(k)
      v_out(k) = v0(k) + half*a
    end do
  end subroutine update_kick

end module castnet_integrator
