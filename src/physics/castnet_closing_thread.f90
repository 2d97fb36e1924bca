!> The closing thread (physics.md section 5): on each of the four sides a thread runs from
!> bullet to bullet through rings at the perimeter nodes and winches in the bullets wind it
!> in, so that the mouth closes behind the target.
!>
!> Along a side the thread slides, so it has one tension T and one length
!> L = sum |x(i+1) - x(i)|; node i feels T (t(i) - t(i-1)) with t(i) the unit vector to the
!> next node, the bullets at the ends only the inward half. The tension follows from the
!> length paid out, the ratchet L_r:
!>
!>     T = k_t (L - L_r) + c_t dL/dt,  0 <= T <= T_w,  and T = 0 while L <= L_r,
!>     L_r <- min(L_r, L) - v_w h max(0, 1 - T/T_w)   once a step, never below `locked_length`.
!>
!> Here are the ratchet of every method and the force at a stage of `rk4` (and so of
!> `adaptive`), where dL/dt is that of the stage and c_t part of the stability limit;
!> `midpoint` takes dL/dt implicitly (castnet_thread_flow).
!>
!> - The thread pulls and never pushes: slack (L <= L_r) means T = 0, as for the cables.
!> - T_w is the winch's stall tension and the slip clutch's at once, so it bounds T also
!>   when the side is locked: a locked side is a tension-only line of that length that
!>   yields at T_w (then L > locked_length + T_w/k_t) and comes back when the load is gone.
!>   The thread is never paid out: neither slip nor slack makes L_r longer.
!> - With ring friction the tension falls at every ring by the capstan factor e^(-mu theta),
!>   theta the angle by which the thread turns there. A winch sits in each bullet, so it
!>   falls from both ends towards the middle: T(j) = T e^(-mu min(A(j), A_all - A(j))), A(j)
!>   the angles up to segment j. That is the loss of a thread that is wound in; one that is
!>   dragged out of held winches would be helped by its rings, which is left out.
!> - The work done on the nodes is the ledger's `winch_work`. What the thread itself stores,
!>   damps away or rubs off at its rings counts with the winch, so this work can fall again;
!>   energy of net and target less it never rises.
module castnet_closing_thread
  use castnet_kinds, only: wp
  use castnet_constants, only: tiny_length
  use castnet_model, only: model_t, closing_t, trigger_contact, trigger_time, trigger_passed_target
  use castnet_net, only: net_t
  use castnet_state, only: state_t, closing_state_t
  implicit none
  private
  public :: add_thread_force, impulse_work, update_closing, thread_length, thread_weight, turning_angle

  !> Part of a step by which a time may lie short of its due time: rounding.
  real(wp), parameter :: rounding = 1.0e-6_wp

  !> Mean square of |t(i) - t(i-1)| at the rings (0.5: a turn of 41 degrees at each) for which
  !> the thread's stability limit is taken. It is 0 on the open net and 4 where the thread
  !> doubles back at every ring; on the rocket's closing net it was 0.1 to 0.8 most of the
  !> time, 1.3 at the most. Beyond the limit of the shape of the moment the rate of L of the
  !> light nodes grows, but only until T meets 0 or T_w: the tension chatters about its mean
  !> and the net does not feel it. Measured on ensembles (rocket's net, 20 and 40 squares,
  !> T_w 100 and 1000 N, bullets 1 and 10 kg): the net's energy is that of steps ten times
  !> smaller, within the spread of 1 to 3 %, up to 2.7 times this limit; 1.1 to 5 times as
  !> much from four times the limit on.
  real(wp), parameter :: ring_turning = 0.5_wp

contains

  !> Add the forces of all pulling threads at one stage.
  subroutine add_thread_force(closing, latch, n_pad, x, v, force, share, impulse)
    type(closing_t), intent(in) :: closing
    type(closing_state_t), intent(in) :: latch
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3) !! [m], [m/s]
    real(wp), intent(inout) :: force(n_pad, 3)       !! [N]
    real(wp), intent(in) :: share                    !! of the step that this stage stands for [s]
    real(wp), intent(inout) :: impulse(n_pad, 3)     !! of the threads over the step: adds share x force [N s]
    real(wp) :: length, rate, turning, tension
    integer :: s

    if (.not. latch%pulling) return
    do s = 1, size(closing%path_start) - 1
      call measure_side(closing, s, n_pad, x, v, length, rate, turning)
      tension = thread_law(closing, latch%rest_length(s), length, rate)
      if (tension > 0.0_wp) call pull_side(closing, s, tension, turning, n_pad, x, force, share, impulse)
    end do
  end subroutine add_thread_force

  !> Half of J.v over the nodes [J]. Taken with the velocities before and after the step, it
  !> is the kinetic energy that the threads' impulse J gave the nodes, exactly, however fast
  !> the light ones move; a quadrature of the power is not once c_t shapes the step.
  pure real(wp) function impulse_work(n_pad, impulse, v) result(work)
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: impulse(n_pad, 3), v(n_pad, 3) !! [N s], [m/s]
    integer :: i
    work = 0.0_wp
    do i = 1, n_pad
      work = work + 0.5_wp*(impulse(i, 1)*v(i, 1) + impulse(i, 2)*v(i, 2) + impulse(i, 3)*v(i, 3))
    end do
  end function impulse_work

  !> T = k_t (L - L_r) + c_t dL/dt between 0 and T_w while L > L_r, else 0 [N].
  pure real(wp) function thread_law(closing, rest_length, length, rate) result(tension)
    type(closing_t), intent(in) :: closing
    real(wp), intent(in) :: rest_length, length  !! L_r, L [m]
    real(wp), intent(in) :: rate                 !! dL/dt [m/s]
    tension = 0.0_wp
    if (.not. length > rest_length) return
    tension = closing%stiffness*(length - rest_length) + closing%damping*rate
    tension = min(max(tension, 0.0_wp), closing%max_tension)
  end function thread_law

  !> Length of side s, its rate, and with ring friction the angle that it turns in all.
  pure subroutine measure_side(closing, s, n_pad, x, v, length, rate, turning)
    type(closing_t), intent(in) :: closing
    integer, intent(in) :: s, n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(out) :: length  !! [m]
    real(wp), intent(out) :: rate    !! [m/s]
    real(wp), intent(out) :: turning !! [rad], 0 without friction
    real(wp) :: t(3), before(3), piece, w(3)
    integer :: p, a, b

    length = 0.0_wp
    rate = 0.0_wp
    turning = 0.0_wp
    do p = closing%path_start(s), closing%path_start(s + 1) - 2
      a = closing%path_node(p)
      b = closing%path_node(p + 1)
      call direction(n_pad, x, a, b, t, piece)
      w = v(b, :) - v(a, :)
      length = length + piece
      rate = rate + (t(1)*w(1) + t(2)*w(2) + t(3)*w(3))
      if (closing%ring_friction > 0.0_wp) then
        if (p > closing%path_start(s)) turning = turning + turning_angle(before, t)
        before = t
      end if
    end do
  end subroutine measure_side

  !> Force of side s on its nodes: each piece pulls its two ends together.
  pure subroutine pull_side(closing, s, tension, turning, n_pad, x, force, share, impulse)
    type(closing_t), intent(in) :: closing
    integer, intent(in) :: s, n_pad
    real(wp), intent(in) :: tension  !! at the winches [N]
    real(wp), intent(in) :: turning  !! of the whole side [rad]
    real(wp), intent(in) :: x(n_pad, 3)
    real(wp), intent(inout) :: force(n_pad, 3)
    real(wp), intent(in) :: share
    real(wp), intent(inout) :: impulse(n_pad, 3)
    real(wp) :: t(3), before(3), piece, pull(3), turned, here
    integer :: p, a, b

    turned = 0.0_wp
    here = tension
    do p = closing%path_start(s), closing%path_start(s + 1) - 2
      a = closing%path_node(p)
      b = closing%path_node(p + 1)
      call direction(n_pad, x, a, b, t, piece)
      if (closing%ring_friction > 0.0_wp) then
        if (p > closing%path_start(s)) turned = turned + turning_angle(before, t)
        before = t
        here = tension*exp(-closing%ring_friction*max(0.0_wp, min(turned, turning - turned)))
      end if
      pull = here*t
      force(a, :) = force(a, :) + pull
      force(b, :) = force(b, :) - pull
      impulse(a, :) = impulse(a, :) + share*pull
      impulse(b, :) = impulse(b, :) - share*pull
    end do
  end subroutine pull_side

  !> Unit vector from node a to node b and their distance. Nodes on top of each other
  !> have no direction: then the vector is short and the force fades out.
  pure subroutine direction(n_pad, x, a, b, t, distance)
    integer, intent(in) :: n_pad, a, b
    real(wp), intent(in) :: x(n_pad, 3)
    real(wp), intent(out) :: t(3), distance
    t = x(b, :) - x(a, :)
    distance = sqrt(t(1)*t(1) + t(2)*t(2) + t(3)*t(3))
    t = t/max(distance, tiny_length)
  end subroutine direction

  !> Angle between two unit vectors, exact also where it is small [rad].
  pure real(wp) function turning_angle(s, t) result(angle)
    real(wp), intent(in) :: s(3), t(3)
    real(wp) :: d(3)
    d = t - s
    angle = 2.0_wp*asin(min(1.0_wp, 0.5_wp*sqrt(d(1)*d(1) + d(2)*d(2) + d(3)*d(3))))
  end function turning_angle

  !> Length of the thread of side s [m].
  pure real(wp) function thread_length(closing, s, position) result(length)
    type(closing_t), intent(in) :: closing
    integer, intent(in) :: s
    real(wp), intent(in), contiguous :: position(:, :)  !! (n_pad,3) [m]
    real(wp) :: t(3), piece
    integer :: p
    length = 0.0_wp
    do p = closing%path_start(s), closing%path_start(s + 1) - 2
      call direction(size(position, 1), position, closing%path_node(p), closing%path_node(p + 1), t, piece)
      length = length + piece
    end do
  end function thread_length

  !> Once a step, after the contacts: trigger, start, and wind the ratchet. Also called
  !> once at t = 0, with h = 0, so that what is due then starts then.
  subroutine update_closing(model, state, h, tension)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: h                     !! step just taken [s]
    real(wp), intent(in), optional :: tension(:)  !! (side) over that step; else that of the state as it is now [N]
    real(wp) :: pull
    integer :: s

    associate (closing => model%closing, latch => state%closing)
      if (.not. latch%triggered) then
        call check_trigger(model, state)
        if (.not. latch%triggered) return
      end if
      if (latch%pulling) then
        do s = 1, size(closing%path_start) - 1
          if (latch%locked(s)) cycle
          if (present(tension)) then
            pull = tension(s)
          else
            pull = tension_now(closing, latch%rest_length(s), s, state%node_position, state%node_velocity)
          end if
          call wind_side(closing, latch, s, state%node_position, pull, h)
        end do
      else if (state%time >= latch%start_time - rounding*model%step) then
        latch%pulling = .true.
        latch%start_time = state%time
        do s = 1, size(closing%path_start) - 1
          latch%rest_length(s) = thread_length(closing, s, state%node_position)
          call lock_if_due(closing, latch, s)
        end do
      end if
    end associate
  end subroutine update_closing

  !> Has what the winches wait for happened? Sets the time at which they start.
  subroutine check_trigger(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    associate (closing => model%closing, latch => state%closing)
      select case (closing%trigger)
      case (trigger_contact)
        latch%triggered = state%first_contact >= 0.0_wp
        if (latch%triggered) latch%start_time = state%first_contact + closing%delay
      case (trigger_time)
        latch%triggered = .true.
        latch%start_time = closing%delay
      case (trigger_passed_target)
        if (.not. allocated(state%target)) return
        latch%triggered = centre_along_flight(model%net, state%node_position) > state%target%position(1)
        if (latch%triggered) latch%start_time = state%time + closing%delay
      end select
    end associate
  end subroutine check_trigger

  !> x of the net's centre of mass, bullets included, summed in node order [m].
  pure real(wp) function centre_along_flight(net, position) result(centre)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: position(:, :)
    real(wp) :: mass
    integer :: i
    centre = 0.0_wp
    mass = 0.0_wp
    do i = 1, net%n_node
      centre = centre + net%node_mass(i)*position(i, 1)
      mass = mass + net%node_mass(i)
    end do
    centre = centre/mass
  end function centre_along_flight

  !> L_r <- min(L_r, L) - v_w h max(0, 1 - T/T_w), and lock.
  subroutine wind_side(closing, latch, s, position, tension, h)
    type(closing_t), intent(in) :: closing
    type(closing_state_t), intent(inout) :: latch
    integer, intent(in) :: s
    real(wp), intent(in), contiguous :: position(:, :)
    real(wp), intent(in) :: tension  !! [N]
    real(wp), intent(in) :: h
    latch%rest_length(s) = min(latch%rest_length(s), thread_length(closing, s, position)) &
                           - closing%winch_speed*h*max(0.0_wp, 1.0_wp - tension/closing%max_tension)
    call lock_if_due(closing, latch, s)
  end subroutine wind_side

  !> Tension of side s at the winches by this position and velocity [N].
  pure real(wp) function tension_now(closing, rest_length, s, position, velocity) result(tension)
    type(closing_t), intent(in) :: closing
    real(wp), intent(in) :: rest_length  !! L_r [m]
    integer, intent(in) :: s
    real(wp), intent(in), contiguous :: position(:, :), velocity(:, :)  !! (n_pad,3) [m], [m/s]
    real(wp) :: length, rate, turning
    call measure_side(closing, s, size(position, 1), position, velocity, length, rate, turning)
    tension = thread_law(closing, rest_length, length, rate)
  end function tension_now

  subroutine lock_if_due(closing, latch, s)
    type(closing_t), intent(in) :: closing
    type(closing_state_t), intent(inout) :: latch
    integer, intent(in) :: s
    if (latch%rest_length(s) > closing%locked_length) return
    latch%rest_length(s) = closing%locked_length
    latch%locked(s) = .true.
  end subroutine lock_if_due

  !> Largest eigenvalue of M^-1 sum g g^T, g = dL/dx of each side: the threads add to the
  !> net's highest squared frequency at most k_t times this, to its damping rate c_t times
  !> this. Sides that share nodes add up (Gershgorin on the sides' products) [1/kg].
  !>
  !> For a shape as crumpled as `ring_turning`, not for any shape: see there.
  pure real(wp) function thread_weight(closing, net) result(weight)
    type(closing_t), intent(in) :: closing
    type(net_t), intent(in) :: net
    real(wp) :: row
    integer :: s, p, q, t
    weight = 0.0_wp
    do s = 1, size(closing%path_start) - 1
      row = 0.0_wp
      do p = closing%path_start(s), closing%path_start(s + 1) - 1
        do t = 1, size(closing%path_start) - 1
          do q = closing%path_start(t), closing%path_start(t + 1) - 1
            if (closing%path_node(q) == closing%path_node(p)) row = row &
              + typical_pull(closing, s, p)*typical_pull(closing, t, q)*net%inverse_mass(closing%path_node(p))
          end do
        end do
      end do
      weight = max(weight, row)
    end do
  end function thread_weight

  !> |dL/dx| at entry p of side s: 1 at a bullet, |t(i) - t(i-1)| of the typical turn at a ring.
  pure real(wp) function typical_pull(closing, s, p)
    type(closing_t), intent(in) :: closing
    integer, intent(in) :: s, p
    typical_pull = sqrt(ring_turning)
    if (p == closing%path_start(s) .or. p == closing%path_start(s + 1) - 1) typical_pull = 1.0_wp
  end function typical_pull

end module castnet_closing_thread
