!> The closing threads within a step of `midpoint`: in parts of their own, the damping implicit.
!>
!> Light nodes at the rings make the thread fast: on the rocket's net c_t damps at 1e4 1/s,
!> the net's own cables below 200, and pieces grow short as the mouth closes. Taken once a step, with
!> velocities extrapolated to the midpoint, this held the step at a thirtieth of the net's.
!> So the step's one evaluation of the cables gives the threads' nodes an acceleration a,
!> and over the step they drift with it, and with the threads, in n parts of d = h/n, each of
!> them drift-kick-drift:
!>
!>     x -> x + d/2 v,   v1 = v + d (a - T M^-1 f),   x -> x + d/2 v1
!>
!> with g = dL/dx there and f the same weighted with what ring friction leaves. Without
!> tension that is the step as it is for every other node. A side has one tension, so its damping
!> can be taken implicitly by one division:
!>
!>     T = k_t (L - L_r) + c_t g.((1 - theta) v + theta v1)
!>     =>  T = (k_t (L - L_r) + c_t (g.v + theta d g.a))/(1 + theta G),   G = d c_t g.M^-1 f
!>
!> between 0 and T_w; what is right of the equals sign falls with T, so clipping its solution solves
!> the clipped law. theta = max(1/2, 1 - 1/G): the midpoint rule, of second order, while G <= 2,
!> beyond it dL/dt is damped away within the part. Sides share bullets and corners, two at
!> each; every side takes the velocities from before all of them. Together they pull at most
!> twice as hard on a motion as each alone, and 1 - 2 G/(1 + theta G) >= -1 for every G: the
!> damping is stable at any step.
!>
!> n follows from G <= 1 for a typical shape (`thread_weight`). A part costs a twentieth
!> of what a step costs, and nothing before the winches pull.
module castnet_thread_flow
  use castnet_kinds, only: wp
  use castnet_constants, only: tiny_length
  use castnet_closing_thread, only: thread_weight, turning_angle
  use castnet_model, only: closing_t
  use castnet_net, only: net_t
  use castnet_state, only: closing_state_t
  implicit none
  private
  public :: thread_flow_t, new_thread_flow, begin_threads, finish_threads

  integer, parameter :: most_parts = 64   !! of a step

  !> Scratch of one step. Entries of the paths in a row, one side after the other; a node on
  !> two sides has two entries, which move alike.
  type :: thread_flow_t
    real(wp) :: typical = 0.0_wp             !! eigenvalue of M^-1 sum g g^T for a typical shape [1/kg]
    integer, allocatable :: node(:)          !! (path)
    integer, allocatable :: shared(:, :)     !! (2,.) entry, the other entry of the same node
    real(wp), allocatable :: weight(:)       !! (path) 1/mass; 0: fixed [1/kg]
    logical :: any_fixed = .false.
    real(wp), allocatable :: x(:, :)         !! (path,3) [m]
    real(wp), allocatable :: v(:, :)         !! (path,3) [m/s]
    real(wp), allocatable :: v0(:, :)        !! (path,3) at the step's start [m/s]
    real(wp), allocatable :: a(:, :)         !! (path,3) by all but the threads [m/s2]
    real(wp), allocatable :: along(:, :)     !! (0:path,3) unit vector to the next entry, 0 at a side's end
    real(wp), allocatable :: piece(:)        !! (path) distance to it, 0 at a side's end [m]
    real(wp), allocatable :: left(:)         !! (0:path) part of the tension that friction leaves there
    real(wp), allocatable :: gradient(:, :)  !! (path,3) g
    real(wp), allocatable :: pull(:, :)      !! (path,3) f
    real(wp), allocatable :: kick(:, :)      !! (path,3) by the thread of the entry's own side [m/s]
    real(wp), allocatable :: term(:, :)      !! (path,4) of the sides' sums: g.v, g.a, g.M^-1 f, f.v
    real(wp), allocatable :: part_tension(:) !! (side) of a part [N]
    real(wp), allocatable :: yield(:)        !! (side) f.v before a kick [m/s]
    real(wp), allocatable :: tension(:)      !! (side) mean of the last step, at the winches; 0 before they pull [N]
  end type thread_flow_t

contains

  !> Allocate the scratch of one run.
  subroutine new_thread_flow(work, closing, net)
    type(thread_flow_t), intent(out) :: work
    type(closing_t), intent(in) :: closing
    type(net_t), intent(in) :: net
    integer :: n, sides, p, q, k
    n = size(closing%path_node)
    sides = size(closing%path_start) - 1
    work%typical = thread_weight(closing, net)
    work%node = closing%path_node
    work%weight = net%inverse_mass(closing%path_node)
    work%any_fixed = any(.not. work%weight > 0.0_wp)
    k = 0
    do p = 1, n
      k = k + count(closing%path_node == closing%path_node(p)) - 1
    end do
    allocate (work%shared(2, k))
    k = 0
    do p = 1, n
      do q = 1, n
        if (q == p .or. work%node(q) /= work%node(p)) cycle
        k = k + 1
        work%shared(:, k) = [p, q]
      end do
    end do
    allocate (work%x(n, 3), work%v(n, 3), work%v0(n, 3), work%a(n, 3), work%along(0:n, 3), work%piece(n), &
              work%gradient(n, 3), work%pull(n, 3), work%kick(n, 3), work%term(n, 4), source=0.0_wp)
    allocate (work%left(0:n), source=1.0_wp)
    allocate (work%part_tension(sides), work%yield(sides), work%tension(sides), source=0.0_wp)
  end subroutine new_thread_flow

  !> Before the cables' kick: where the nodes were when the step began.
  pure subroutine begin_threads(work, n_pad, h, x, v)
    type(thread_flow_t), intent(inout) :: work
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: h             !! [s]
    real(wp), intent(in) :: x(n_pad, 3)   !! at the midpoint [m]
    real(wp), intent(in) :: v(n_pad, 3)   !! at the step's start [m/s]
    integer :: c, p
    do c = 1, 3
      do p = 1, size(work%node)
        work%v0(p, c) = v(work%node(p), c)
        work%x(p, c) = x(work%node(p), c) - 0.5_wp*h*work%v0(p, c)
      end do
    end do
    work%v = work%v0
  end subroutine begin_threads

  !> After the cables' kick: all parts of the step, and what follows from them for the nodes.
  pure subroutine finish_threads(work, closing, latch, n_pad, h, v, x, next_x, ahead, winch_work, support_work)
    type(thread_flow_t), intent(inout) :: work
    type(closing_t), intent(in) :: closing
    type(closing_state_t), intent(in) :: latch
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: h                  !! [s]
    real(wp), intent(inout) :: v(n_pad, 3)     !! in: with the cables' kick; out: at the step's end [m/s]
    real(wp), intent(inout) :: x(n_pad, 3)     !! out: the midpoint that h/2 v leads from to the step's end [m]
    real(wp), intent(inout) :: next_x(n_pad, 3)!! out: h/2 v beyond the step's end [m]
    real(wp), intent(inout) :: ahead(n_pad, 3) !! out: the velocity extrapolated there [m/s]
    real(wp), intent(inout) :: winch_work      !! grows by the work on the nodes, exactly [J]
    real(wp), intent(inout) :: support_work    !! falls by what of it fixed nodes take away [J]
    real(wp) :: half
    integer :: n, k, c, p, i

    do c = 1, 3
      do p = 1, size(work%node)
        work%a(p, c) = (v(work%node(p), c) - work%v0(p, c))/h
      end do
    end do
    n = parts(work, closing, h)
    work%tension = 0.0_wp
    do k = 1, n
      call advance_part(work, closing, latch, size(work%node), h/n, winch_work, support_work)
      work%tension = work%tension + work%part_tension
    end do
    work%tension = work%tension/n
    ! The sums are those of every other node and of a run that goes on from the state.
    half = 0.5_wp*h
    do c = 1, 3
      do p = 1, size(work%node)
        i = work%node(p)
        v(i, c) = work%v(p, c)
        x(i, c) = work%x(p, c) - half*v(i, c)
        next_x(i, c) = (x(i, c) + half*v(i, c)) + half*v(i, c)
        ahead(i, c) = v(i, c) + 0.5_wp*(v(i, c) - work%v0(p, c))
      end do
    end do
  end subroutine finish_threads

  !> How many parts a step has.
  pure integer function parts(work, closing, h)
    type(thread_flow_t), intent(in) :: work
    type(closing_t), intent(in) :: closing
    real(wp), intent(in) :: h
    parts = ceiling(min(max(h*closing%damping*work%typical, 1.0_wp), real(most_parts, wp)))
  end function parts

  !> Drift, kick, drift over d.
  pure subroutine advance_part(work, closing, latch, n, d, winch_work, support_work)
    type(thread_flow_t), intent(inout) :: work
    type(closing_t), intent(in) :: closing
    type(closing_state_t), intent(in) :: latch
    integer, intent(in) :: n
    real(wp), intent(in) :: d  !! [s]
    real(wp), intent(inout) :: winch_work, support_work
    integer :: s, p, c, k

    call drift(n, 0.5_wp*d, work%v, work%x)
    call find_shape(work, closing, n)
    call find_terms(n, work%weight, work%gradient, work%pull, work%v, work%a, work%term)
    do s = 1, size(work%tension)
      associate (first => closing%path_start(s), last => closing%path_start(s + 1) - 1)
        work%part_tension(s) = side_tension(work, closing, latch%rest_length(s), first, last - first + 1, d)
        work%yield(s) = total(last - first + 1, work%term(first, 4))
        do c = 1, 3
          do p = first, last
            work%kick(p, c) = -(d*work%part_tension(s))*work%weight(p)*work%pull(p, c)
          end do
        end do
      end associate
    end do
    do c = 1, 3
      do p = 1, n
        work%v(p, c) = work%v(p, c) + (d*work%a(p, c) + work%kick(p, c))
      end do
      do k = 1, size(work%shared, 2)
        work%v(work%shared(1, k), c) = work%v(work%shared(1, k), c) + work%kick(work%shared(2, k), c)
      end do
    end do
    call drift(n, 0.5_wp*d, work%v, work%x)
    call credit_work(work, closing, n, d, winch_work, support_work)
  end subroutine advance_part

  pure subroutine drift(n, t, v, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: t, v(n, 3)
    real(wp), intent(inout) :: x(n, 3)
    integer :: c, p
    do c = 1, 3
      do p = 1, n
        x(p, c) = x(p, c) + t*v(p, c)
      end do
    end do
  end subroutine drift

  !> Pieces, what friction leaves of the tension, gradient and pull of every side.
  pure subroutine find_shape(work, closing, n)
    type(thread_flow_t), intent(inout) :: work
    type(closing_t), intent(in) :: closing
    integer, intent(in) :: n
    real(wp) :: scale
    integer :: s, p, c

    do p = 1, n - 1
      work%along(p, 1) = work%x(p + 1, 1) - work%x(p, 1)
      work%along(p, 2) = work%x(p + 1, 2) - work%x(p, 2)
      work%along(p, 3) = work%x(p + 1, 3) - work%x(p, 3)
      work%piece(p) = sqrt(work%along(p, 1)**2 + work%along(p, 2)**2 + work%along(p, 3)**2)
      ! Nodes on top of each other: the vector is short and the force fades out.
      scale = 1.0_wp/max(work%piece(p), tiny_length)
      work%along(p, 1) = work%along(p, 1)*scale
      work%along(p, 2) = work%along(p, 2)*scale
      work%along(p, 3) = work%along(p, 3)*scale
    end do
    do s = 1, size(work%tension)
      p = closing%path_start(s + 1) - 1
      work%along(p, :) = 0.0_wp
      work%piece(p) = 0.0_wp
      if (closing%ring_friction > 0.0_wp) call find_friction(work, closing%ring_friction, closing%path_start(s), p)
    end do
    do c = 1, 3
      do p = 1, n
        work%gradient(p, c) = work%along(p - 1, c) - work%along(p, c)
        work%pull(p, c) = work%left(p - 1)*work%along(p - 1, c) - work%left(p)*work%along(p, c)
      end do
    end do
  end subroutine find_shape

  !> e^(-mu A) of each piece of the side from entry first to last, A the angles that the thread
  !> has turned from the nearer end.
  pure subroutine find_friction(work, mu, first, last)
    type(thread_flow_t), intent(inout) :: work
    real(wp), intent(in) :: mu
    integer, intent(in) :: first, last
    real(wp) :: turned
    integer :: p
    turned = 0.0_wp
    work%left(first) = 0.0_wp
    do p = first + 1, last - 1
      turned = turned + turning_angle(work%along(p - 1, :), work%along(p, :))
      work%left(p) = turned
    end do
    do p = first, last - 1
      work%left(p) = exp(-mu*max(0.0_wp, min(work%left(p), turned - work%left(p))))
    end do
  end subroutine find_friction

  !> What the sums over a side are made of.
  pure subroutine find_terms(n, weight, gradient, pull, v, a, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: weight(n), gradient(n, 3), pull(n, 3), v(n, 3), a(n, 3)
    real(wp), intent(out) :: term(n, 4)
    integer :: p
    do p = 1, n
      term(p, 1) = gradient(p, 1)*v(p, 1) + gradient(p, 2)*v(p, 2) + gradient(p, 3)*v(p, 3)
      term(p, 2) = gradient(p, 1)*a(p, 1) + gradient(p, 2)*a(p, 2) + gradient(p, 3)*a(p, 3)
      term(p, 3) = weight(p)*(gradient(p, 1)*pull(p, 1) + gradient(p, 2)*pull(p, 2) + gradient(p, 3)*pull(p, 3))
      term(p, 4) = pull(p, 1)*v(p, 1) + pull(p, 2)*v(p, 2) + pull(p, 3)*v(p, 3)
    end do
  end subroutine find_terms

  !> T of the side of m entries from `first` (see above) [N]; slack, L <= L_r: 0.
  pure real(wp) function side_tension(work, closing, rest_length, first, m, d) result(tension)
    type(thread_flow_t), intent(in) :: work
    type(closing_t), intent(in) :: closing
    real(wp), intent(in) :: rest_length  !! L_r [m]
    integer, intent(in) :: first, m
    real(wp), intent(in) :: d            !! [s]
    real(wp) :: length, g, theta, rate
    tension = 0.0_wp
    length = total(m, work%piece(first))
    if (.not. length > rest_length) return
    g = d*closing%damping*total(m, work%term(first, 3))
    theta = 0.5_wp
    if (g > 2.0_wp) theta = 1.0_wp - 1.0_wp/g
    rate = total(m, work%term(first, 1)) + theta*d*total(m, work%term(first, 2))
    tension = (closing%stiffness*(length - rest_length) + closing%damping*rate)/(1.0_wp + theta*g)
    tension = min(max(tension, 0.0_wp), closing%max_tension)
  end function side_tension

  !> The impulse -d T f times the mean of the velocities before and after the part is the
  !> kinetic energy that it gave, exactly, however fast the light nodes move.
  pure subroutine credit_work(work, closing, n, d, winch_work, support_work)
    type(thread_flow_t), intent(inout) :: work
    type(closing_t), intent(in) :: closing
    integer, intent(in) :: n
    real(wp), intent(in) :: d
    real(wp), intent(inout) :: winch_work, support_work
    integer :: s, p
    do p = 1, n
      work%term(p, 4) = work%pull(p, 1)*work%v(p, 1) + work%pull(p, 2)*work%v(p, 2) + work%pull(p, 3)*work%v(p, 3)
    end do
    do s = 1, size(work%tension)
      associate (first => closing%path_start(s), last => closing%path_start(s + 1) - 1)
        winch_work = winch_work - 0.5_wp*d*work%part_tension(s)*(work%yield(s) + total(last - first + 1, work%term(first, 4)))
        if (.not. work%any_fixed) cycle
        do p = first, last
          if (.not. work%weight(p) > 0.0_wp) support_work = support_work + d*work%part_tension(s)*work%term(p, 4)
        end do
      end associate
    end do
  end subroutine credit_work

  !> Sum of x in four lanes.
  pure real(wp) function total(n, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n)
    real(wp) :: lane(4)
    integer :: i, k
    lane = 0.0_wp
    do i = 0, n - 4, 4
      do k = 1, 4
        lane(k) = lane(k) + x(i + k)
      end do
    end do
    do i = n - modulo(n, 4) + 1, n
      lane(1) = lane(1) + x(i)
    end do
    total = (lane(1) + lane(2)) + (lane(3) + lane(4))
  end function total

end module castnet_thread_flow
