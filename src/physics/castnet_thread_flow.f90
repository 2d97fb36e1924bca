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
!> n follows from G <= 1 for a typical shape (`thread_weight`). Before the winches pull nothing
!> of this is done.
!>
!> The work of the threads is what the nodes got beyond a: sum m ((v1^2 - v0^2)/2 - a.(x1 - x0))
!> over the step, exactly, because x moves with the mean of v and v1 in every part.
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
  integer, parameter :: lanes = 4         !! sums of a side: L, g.v, g.a, g.M^-1 f

  !> Scratch of one step. Entries of the paths in a row, one side after the other; a node on
  !> two sides has two entries, which move alike.
  type :: thread_flow_t
    real(wp) :: typical = 0.0_wp             !! eigenvalue of M^-1 sum g g^T for a typical shape [1/kg]
    integer, allocatable :: node(:)          !! (path)
    integer, allocatable :: shared(:, :)     !! (2,.) entry, the other entry of the same node
    real(wp), allocatable :: weight(:)       !! (path) 1/mass; 0: fixed [1/kg]
    real(wp), allocatable :: mass(:)         !! (path) 0 for fixed nodes and for second entries [kg]
    logical :: any_fixed = .false.
    real(wp), allocatable :: x(:, :)         !! (path,3) [m]
    real(wp), allocatable :: v(:, :)         !! (path,3) [m/s]
    real(wp), allocatable :: x0(:, :)        !! (path,3) at the step's start [m]
    real(wp), allocatable :: v0(:, :)        !! (path,3) at the step's start [m/s]
    real(wp), allocatable :: a(:, :)         !! (path,3) by all but the threads [m/s2]
    real(wp), allocatable :: along(:, :)     !! (0:path,3) unit vector to the next entry, 0 at a side's end
    real(wp), allocatable :: piece(:)        !! (path) distance to it, 0 at a side's end [m]
    real(wp), allocatable :: left(:)         !! (0:path) part of the tension that friction leaves there
    real(wp), allocatable :: gradient(:, :)  !! (path,3) g
    real(wp), allocatable :: pull(:, :)      !! (path,3) f
    real(wp), allocatable :: term(:, :)      !! (lanes,path) of the sides' sums
    real(wp), allocatable :: part_tension(:) !! (side) of a part [N]
    real(wp), allocatable :: here(:)         !! (path) the same for every entry of the side [N]
    real(wp), allocatable :: kick(:, :)      !! (path,3) by the thread of the entry's own side [m/s]
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
    allocate (work%mass(n), source=0.0_wp)
    k = 0
    do p = 1, n
      k = k + count(work%node == work%node(p)) - 1
      if (work%weight(p) > 0.0_wp .and. .not. any(work%node(:p - 1) == work%node(p))) work%mass(p) = 1.0_wp/work%weight(p)
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
    allocate (work%x(n, 3), work%v(n, 3), work%x0(n, 3), work%v0(n, 3), work%a(n, 3), work%along(0:n, 3), work%piece(n), &
              work%gradient(n, 3), work%pull(n, 3), work%term(lanes, n), work%here(n), work%kick(n, 3), source=0.0_wp)
    allocate (work%left(0:n), source=1.0_wp)
    allocate (work%part_tension(sides), work%tension(sides), source=0.0_wp)
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
        work%x0(p, c) = x(work%node(p), c) - 0.5_wp*h*work%v0(p, c)
      end do
    end do
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
    real(wp), intent(inout) :: winch_work      !! grows by the work on the nodes [J]
    real(wp), intent(inout) :: support_work    !! falls by what of it fixed nodes take away [J]
    real(wp) :: d, half
    integer :: n, m, k, c, p, i

    m = size(work%node)
    do c = 1, 3
      do p = 1, m
        work%a(p, c) = (v(work%node(p), c) - work%v0(p, c))/h
      end do
    end do
    work%x = work%x0
    work%v = work%v0
    work%tension = 0.0_wp
    n = parts(work, closing, h)
    d = h/n
    call drift(3*m, 0.5_wp*d, work%v, work%x)
    do k = 1, n
      call find_tensions(work, closing, latch, m, d)
      call find_kicks(m, d, work%weight, work%here, work%pull, work%kick)
      call apply_kicks(work, m, d)
      call drift(3*m, merge(d, 0.5_wp*d, k < n), work%v, work%x)
      work%tension = work%tension + work%part_tension
      if (work%any_fixed) call credit_supports(work, m, d, winch_work, support_work)
    end do
    work%tension = work%tension/n
    if (any(work%tension > 0.0_wp)) winch_work = winch_work + gain_of_nodes(m, work%mass, work%x0, work%v0, work%a, &
                                                                            work%x, work%v)
    ! The sums are those of every other node and of a run that goes on from the state.
    half = 0.5_wp*h
    do c = 1, 3
      do p = 1, m
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

  pure subroutine drift(n, t, v, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: t, v(n)
    real(wp), intent(inout) :: x(n)
    integer :: k
    do k = 1, n
      x(k) = x(k) + t*v(k)
    end do
  end subroutine drift

  !> Shape and tension of every side, amid a part.
  pure subroutine find_tensions(work, closing, latch, n, d)
    type(thread_flow_t), intent(inout) :: work
    type(closing_t), intent(in) :: closing
    type(closing_state_t), intent(in) :: latch
    integer, intent(in) :: n
    real(wp), intent(in) :: d  !! [s]
    real(wp) :: sums(lanes)
    integer :: s, last

    call find_pieces(n, work%x, work%along, work%piece)
    do s = 1, size(work%tension)
      last = closing%path_start(s + 1) - 1
      work%along(last, :) = 0.0_wp
      work%piece(last) = 0.0_wp
      if (closing%ring_friction > 0.0_wp) call find_friction(work, closing%ring_friction, closing%path_start(s), last)
    end do
    call find_gradient(n, work%along, work%left, work%gradient, work%pull)
    call find_terms(n, work%piece, work%weight, work%gradient, work%pull, work%v, work%a, work%term)
    do s = 1, size(work%tension)
      associate (first => closing%path_start(s), after => closing%path_start(s + 1))
        sums = sum_in_order(after - first, work%term(1, first))
        work%part_tension(s) = tension_of(closing, latch%rest_length(s), d, sums)
        work%here(first:after - 1) = work%part_tension(s)
      end associate
    end do
  end subroutine find_tensions

  !> Unit vectors and distances from each entry to the next, across the sides' ends too.
  pure subroutine find_pieces(n, x, along, piece)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, 3)
    real(wp), intent(inout) :: along(0:n, 3), piece(n)
    real(wp) :: t(3), scale
    integer :: p
    do p = 1, n - 1
      t(1) = x(p + 1, 1) - x(p, 1)
      t(2) = x(p + 1, 2) - x(p, 2)
      t(3) = x(p + 1, 3) - x(p, 3)
      piece(p) = sqrt(t(1)*t(1) + t(2)*t(2) + t(3)*t(3))
      ! Nodes on top of each other: the vector is short and the force fades out.
      scale = 1.0_wp/max(piece(p), tiny_length)
      along(p, 1) = t(1)*scale
      along(p, 2) = t(2)*scale
      along(p, 3) = t(3)*scale
    end do
  end subroutine find_pieces

  pure subroutine find_gradient(n, along, left, gradient, pull)
    integer, intent(in) :: n
    real(wp), intent(in) :: along(0:n, 3), left(0:n)
    real(wp), intent(inout) :: gradient(n, 3), pull(n, 3)
    integer :: p, c
    do c = 1, 3
      do p = 1, n
        gradient(p, c) = along(p - 1, c) - along(p, c)
        pull(p, c) = left(p - 1)*along(p - 1, c) - left(p)*along(p, c)
      end do
    end do
  end subroutine find_gradient

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
  pure subroutine find_terms(n, piece, weight, gradient, pull, v, a, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: piece(n), weight(n), gradient(n, 3), pull(n, 3), v(n, 3), a(n, 3)
    real(wp), intent(inout) :: term(lanes, n)
    integer :: p
    do p = 1, n
      term(1, p) = piece(p)
      term(2, p) = gradient(p, 1)*v(p, 1) + gradient(p, 2)*v(p, 2) + gradient(p, 3)*v(p, 3)
      term(3, p) = gradient(p, 1)*a(p, 1) + gradient(p, 2)*a(p, 2) + gradient(p, 3)*a(p, 3)
      term(4, p) = weight(p)*(gradient(p, 1)*pull(p, 1) + gradient(p, 2)*pull(p, 2) + gradient(p, 3)*pull(p, 3))
    end do
  end subroutine find_terms

  !> All four sums over n entries, even and odd ones apart.
  pure function sum_in_order(n, term) result(sums)
    integer, intent(in) :: n
    real(wp), intent(in) :: term(lanes, n)
    real(wp) :: sums(lanes), odd(lanes)
    integer :: p, k
    sums = 0.0_wp
    odd = 0.0_wp
    do p = 1, n - 1, 2
      do k = 1, lanes
        sums(k) = sums(k) + term(k, p)
        odd(k) = odd(k) + term(k, p + 1)
      end do
    end do
    if (modulo(n, 2) == 1) sums = sums + term(:, n)
    sums = sums + odd
  end function sum_in_order

  !> T of a side (see above) [N]; slack, L <= L_r: 0.
  pure real(wp) function tension_of(closing, rest_length, d, sums) result(tension)
    type(closing_t), intent(in) :: closing
    real(wp), intent(in) :: rest_length  !! L_r [m]
    real(wp), intent(in) :: d            !! [s]
    real(wp), intent(in) :: sums(lanes)
    real(wp) :: g, theta
    tension = 0.0_wp
    if (.not. sums(1) > rest_length) return
    g = d*closing%damping*sums(4)
    theta = 0.5_wp
    if (g > 2.0_wp) theta = 1.0_wp - 1.0_wp/g
    tension = closing%stiffness*(sums(1) - rest_length) + closing%damping*(sums(2) + theta*d*sums(3))
    tension = min(max(tension/(1.0_wp + theta*g), 0.0_wp), closing%max_tension)
  end function tension_of

  pure subroutine find_kicks(n, d, weight, tension, pull, kick)
    integer, intent(in) :: n
    real(wp), intent(in) :: d, weight(n), tension(n), pull(n, 3)
    real(wp), intent(inout) :: kick(n, 3)
    integer :: p, c
    do c = 1, 3
      do p = 1, n
        kick(p, c) = -((d*tension(p))*weight(p))*pull(p, c)
      end do
    end do
  end subroutine find_kicks

  !> All accelerations over d, and the kicks, of both sides where a node is on two.
  pure subroutine apply_kicks(work, n, d)
    type(thread_flow_t), intent(inout) :: work
    integer, intent(in) :: n
    real(wp), intent(in) :: d
    integer :: k, c
    call add_all(3*n, d, work%a, work%kick, work%v)
    do c = 1, 3
      do k = 1, size(work%shared, 2)
        work%v(work%shared(1, k), c) = work%v(work%shared(1, k), c) + work%kick(work%shared(2, k), c)
      end do
    end do
  end subroutine apply_kicks

  pure subroutine add_all(n, d, a, kick, v)
    integer, intent(in) :: n
    real(wp), intent(in) :: d, a(n), kick(n)
    real(wp), intent(inout) :: v(n)
    integer :: k
    do k = 1, n
      v(k) = v(k) + (d*a(k) + kick(k))
    end do
  end subroutine add_all

  !> What fixed nodes, led along, take of the work in a part: the winches do it, the supports
  !> get it.
  pure subroutine credit_supports(work, n, d, winch_work, support_work)
    type(thread_flow_t), intent(in) :: work
    integer, intent(in) :: n
    real(wp), intent(in) :: d
    real(wp), intent(inout) :: winch_work, support_work
    real(wp) :: taken
    integer :: p
    taken = 0.0_wp
    do p = 1, n
      if (work%weight(p) > 0.0_wp) cycle
      taken = taken - d*work%here(p)*(work%pull(p, 1)*work%v(p, 1) + work%pull(p, 2)*work%v(p, 2) + work%pull(p, 3)*work%v(p, 3))
    end do
    winch_work = winch_work + taken
    support_work = support_work - taken
  end subroutine credit_supports

  !> Kinetic energy that the nodes got besides the work of their acceleration a [J].
  pure real(wp) function gain_of_nodes(n, mass, x0, v0, a, x, v) result(gain)
    integer, intent(in) :: n
    real(wp), intent(in) :: mass(n), x0(n, 3), v0(n, 3), a(n, 3), x(n, 3), v(n, 3)
    integer :: p, c
    gain = 0.0_wp
    do p = 1, n
      do c = 1, 3
        gain = gain + mass(p)*(0.5_wp*(v(p, c) - v0(p, c))*(v(p, c) + v0(p, c)) - a(p, c)*(x(p, c) - x0(p, c)))
      end do
    end do
  end function gain_of_nodes

end module castnet_thread_flow
