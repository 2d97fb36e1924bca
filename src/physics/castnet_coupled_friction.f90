!> Impulses with friction where contacts act on each other through common nodes (cables)
!> or cannot be put into the 6 x 6 form (fixed nodes).
!>
!> With j_i = law_i(u_i - rho_i j_i) the impulse that a mass 1/rho_i would need (any rho > 0
!> says the same law) and P_i = -law_i', Newton's step solves
!>
!>     dj_i + P_i ((W - (1 - epsilon) rho) dj)_i = law_i - j_i,   W = A + G H G^T,
!>
!> A the couplings through nodes, which fall into groups, G H G^T those through the body:
!> a sparse matrix of 3 x 3 blocks and six equations for the body. epsilon > 0 because two
!> nodes and their cable on one face are one contact too many, and their impulses are not
!> unique: it keeps the step short along what does not matter, and is lowered as Newton's
!> method gets on. A step is kept when the error falls below the largest of the last eight:
!> where two contacts are nearly one, the way down leads over a ridge.
!>
!> Where that fails a path is followed that starts at contacts which do not know of each
!> other: with W(t) = (1 - t) rho + t W every t is a system of contacts with friction, with
!> bounded impulses, and with one answer at t = 0. The curve of answers (j, t) from there
!> cannot end, return or run away before t = 1 (Chow, Mallet-Paret & Yorke 1978); it may turn
!> back in t on its way, and so it is followed by its arc. Which way along it is forward,
!> also after a bend where a contact slips or lets go, is told by the sign of the
!> determinant: dt > 0 where it is positive (Allgower & Georg 1990).
module castnet_coupled_friction
  use castnet_kinds, only: wp
  use castnet_block_matrix, only: block_matrix_t, find_pattern, fill_matrix, eliminate
  use castnet_contact_groups, only: contact_groups_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t, lane
  use castnet_friction_problem, only: friction_problem_t
  use castnet_six_by_six, only: solve_pair
  implicit none
  private
  public :: coupled_work_t, reserve_coupled, solve_coupled_friction

  !> Factors of rho by try: another rho says the same law and has its valleys and its path elsewhere.
  real(wp), parameter :: rho_factor(4) = [1.0_wp, 4.0_wp, 0.25_wp, 16.0_wp]
  integer, parameter :: max_newton = 20      !! steps in one try
  integer, parameter :: max_cut = 6          !! halvings of a step
  integer, parameter :: memory = 8           !! errors that a step may go back to
  real(wp), parameter :: first_epsilon = 1.0e-2_wp, least_epsilon = 1.0e-11_wp, largest_epsilon = 0.3_wp
  !> The end of the search, of the largest speed [-].
  real(wp), parameter :: tolerance = 1.0e-12_wp
  real(wp), parameter :: accept_below = 1.0e-10_wp

  integer, parameter :: max_path = 400       !! steps along a path
  integer, parameter :: max_correction = 6   !! Newton steps back to the path
  integer, parameter :: max_bend = 8         !! looks around one bend
  real(wp), parameter :: on_path = 1.0e-8_wp !! distance from the path, of the largest speed [-]
  real(wp), parameter :: first_arc = 0.1_wp, most_arc = 0.5_wp, least_arc = 1.0e-7_wp
  real(wp), parameter :: least_cosine = 0.3_wp  !! between tangents one after the other
  !> 1 - t from where Newton's method is first tried, its fall from one trial to the next, and at the end.
  real(wp), parameter :: first_look = 0.6_wp, look_every = 0.2_wp, least_left = 1.0e-11_wp
  integer, parameter :: newton_at_look = 40  !! steps of such a trial

  !> Everything by position along the groups; arrays of reals are padded to a multiple of `lane`.
  type :: coupled_work_t
    integer :: n = 0, n_lane = 0, n_node = 0
    integer, allocatable :: local(:)        !! (nodes of the net) number of a touched node, else 0
    integer, allocatable :: a(:), b(:)      !! (capacity) numbers of each contact's nodes
    real(wp), allocatable :: weight_a(:), weight_b(:) !! (capacity) shares of the nodes [-]
    real(wp), allocatable :: kick_a(:), kick_b(:)     !! (capacity) shares over the nodes' masses [1/kg]
    real(wp), allocatable :: normal(:, :), arm(:, :), before(:, :) !! (capacity,3)
    real(wp), allocatable :: rebound(:)     !! (capacity) normal velocity after [m/s]
    real(wp), allocatable :: rho(:)         !! (capacity) bound of a contact's own mobility [1/kg]
    real(wp), allocatable :: mass(:)        !! (capacity) 1/rho; 0 takes a contact out [kg]
    real(wp), allocatable :: impulse(:, :)  !! (capacity,3) [N s]
    real(wp), allocatable :: now(:, :)      !! (capacity,3) relative velocity with these impulses [m/s]
    real(wp), allocatable :: off(:, :)      !! (capacity,3) law - impulse [N s]
    real(wp), allocatable :: slip(:, :)     !! (capacity,3) direction of sliding, 0: sticks
    real(wp), allocatable :: slide(:), along(:), across(:) !! (capacity) parts of P [kg]
    real(wp), allocatable :: kept(:, :)     !! (capacity,3) impulses to go back to [N s]
    real(wp), allocatable :: place(:, :)    !! (capacity,3) the path's last place [N s]
    real(wp), allocatable :: way(:, :)      !! (capacity,3) tangent of the path
    real(wp), allocatable :: slope(:, :, :) !! (3,3,capacity) P [kg]
    real(wp), allocatable :: change(:, :)   !! (3,2 capacity) change of the nodes' velocities [m/s]
    real(wp) :: twist(6) = 0.0_wp           !! and of the body's
    real(wp) :: friction = 0.0_wp
    logical :: push_only = .true.
    real(wp) :: largest = 0.0_wp            !! speed before [m/s]
    real(wp) :: residual = 0.0_wp           !! largest distance of an impulse from its law [m/s]
    real(wp) :: error = 0.0_wp              !! sum of their squares
    integer :: iterations = 0
    type(block_matrix_t) :: matrix
  end type coupled_work_t

contains

  !> Room for `capacity` contacts, a multiple of `lane`, on a net of `n_node` nodes.
  subroutine reserve_coupled(work, capacity, n_node)
    type(coupled_work_t), intent(inout) :: work
    integer, intent(in) :: capacity, n_node
    integer :: m
    if (allocated(work%local)) then
      if (size(work%local) < n_node) deallocate (work%local)
    end if
    if (.not. allocated(work%local)) allocate (work%local(n_node), source=0)
    if (allocated(work%a)) then
      if (size(work%a) >= capacity) return
      deallocate (work%a, work%b, work%weight_a, work%weight_b, work%kick_a, work%kick_b, work%normal, work%arm, &
                  work%before, work%rebound, work%rho, work%mass, work%impulse, work%now, work%off, work%slip, &
                  work%slide, work%along, work%across, work%kept, work%place, work%way, work%slope, work%change)
    end if
    m = ((capacity + lane - 1)/lane)*lane
    allocate (work%a(m), work%b(m), source=0)
    allocate (work%weight_a(m), work%weight_b(m), work%kick_a(m), work%kick_b(m), work%rebound(m), work%rho(m), &
              work%mass(m), work%slide(m), work%along(m), work%across(m), source=0.0_wp)
    allocate (work%normal(m, 3), work%arm(m, 3), work%before(m, 3), work%impulse(m, 3), work%now(m, 3), work%off(m, 3), &
              work%slip(m, 3), work%kept(m, 3), work%place(m, 3), work%way(m, 3), source=0.0_wp)
    allocate (work%slope(3, 3, m), work%change(3, 2*m), source=0.0_wp)
  end subroutine reserve_coupled

  !> Impulses of every contact; `groups` of this list.
  subroutine solve_coupled_friction(problem, list, groups, body, work, iterations, residual, converged, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual   !! [m/s]
    logical, intent(out) :: converged
    real(wp), intent(out) :: twist(6)   !! change of the body's twist, inertial axes
    integer :: try, p, i, c
    call gather(problem, list, groups, body, work)
    call find_pattern(list, groups, work%matrix)
    work%iterations = 0
    do try = 1, size(rho_factor)
      call scale_mobilities(rho_factor(try), work)
      work%impulse(1:work%n_lane, :) = 0.0_wp
      call replay(body, work)
      call newton(body, first_epsilon, max_newton, work)
      if (work%residual > tolerance*work%largest) call follow_path(body, work)
      call scale_mobilities(1.0_wp/rho_factor(try), work)
      call measure(1.0_wp, 1.0_wp, work)
      converged = work%residual <= accept_below*work%largest
      if (converged) exit
    end do
    do p = 1, work%n
      i = groups%order(p)
      do c = 1, 3
        problem%impulse(i, c) = work%impulse(p, c)
        problem%after(i, c) = work%now(p, c)
      end do
    end do
    iterations = work%iterations
    residual = work%residual
    twist = work%twist
  end subroutine solve_coupled_friction

  !> The problem by position.
  subroutine gather(problem, list, groups, body, work)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    real(wp) :: r(3), turn(3, 3), rho
    integer :: i, p, c
    work%n = list%n
    work%n_lane = ((list%n + lane - 1)/lane)*lane
    work%friction = problem%friction
    work%push_only = problem%push_only
    work%largest = 0.0_wp
    work%n_node = 0
    do i = 1, list%n
      work%local(list%node_a(i)) = 0
      work%local(list%node_b(i)) = 0
    end do
    turn = body%inverse_inertia
    do p = 1, list%n
      i = groups%order(p)
      call give_number(list%node_a(i), work, work%a(p))
      call give_number(list%node_b(i), work, work%b(p))
      work%weight_a(p) = list%weight_a(i)
      work%weight_b(p) = list%share(i)
      work%kick_a(p) = list%weight_a(i)*list%inverse_mass_a(i)
      work%kick_b(p) = list%share(i)*list%inverse_mass_b(i)
      work%rebound(p) = problem%rebound(i)
      do c = 1, 3
        r(c) = list%arm(i, c)
        work%arm(p, c) = r(c)
        work%normal(p, c) = problem%normal(i, c)
        work%before(p, c) = problem%velocity(i, c)
        work%now(p, c) = problem%velocity(i, c)
      end do
      rho = list%weight_a(i)*work%kick_a(p) + list%share(i)*work%kick_b(p)
      ! tr([r] I^-1 [r]^T) = |r|^2 tr I^-1 - r.I^-1 r.
      if (body%free) rho = rho + body%inverse_mass &
                           + (r(1)*r(1) + r(2)*r(2) + r(3)*r(3))*(turn(1, 1) + turn(2, 2) + turn(3, 3)) - quadratic(turn, r)
      work%rho(p) = rho
      work%mass(p) = 0.0_wp
      if (.not. problem%mass(i) > 0.0_wp) cycle
      if (rho > 0.0_wp) work%mass(p) = 1.0_wp/rho
      work%largest = max(work%largest, abs(work%before(p, 1)), abs(work%before(p, 2)), abs(work%before(p, 3)))
    end do
    do p = work%n + 1, work%n_lane
      work%rho(p) = 1.0_wp
      work%mass(p) = 0.0_wp
      work%rebound(p) = 0.0_wp
      work%normal(p, :) = [1.0_wp, 0.0_wp, 0.0_wp]
      work%before(p, :) = 0.0_wp
      work%now(p, :) = 0.0_wp
    end do
  end subroutine gather

  pure subroutine give_number(node, work, number)
    integer, intent(in) :: node
    type(coupled_work_t), intent(inout) :: work
    integer, intent(inout) :: number
    if (work%local(node) == 0) then
      work%n_node = work%n_node + 1
      work%local(node) = work%n_node
    end if
    number = work%local(node)
  end subroutine give_number

  pure real(wp) function quadratic(a, r)
    real(wp), intent(in) :: a(3, 3), r(3)
    quadratic = r(1)*(a(1, 1)*r(1) + a(1, 2)*r(2) + a(1, 3)*r(3)) + r(2)*(a(2, 1)*r(1) + a(2, 2)*r(2) + a(2, 3)*r(3)) &
                + r(3)*(a(3, 1)*r(1) + a(3, 2)*r(2) + a(3, 3)*r(3))
  end function quadratic

  pure subroutine scale_mobilities(factor, work)
    real(wp), intent(in) :: factor
    type(coupled_work_t), intent(inout) :: work
    integer :: p
    do p = 1, work%n
      work%rho(p) = factor*work%rho(p)
      work%mass(p) = work%mass(p)/factor
    end do
  end subroutine scale_mobilities

  !> Motion of nodes, body and contacts by the impulses as they stand.
  pure subroutine replay(body, work)
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    real(wp) :: z(6), w(6), j(3), r(3)
    integer :: p, a, b, c
    work%change(:, 1:work%n_node) = 0.0_wp
    z = 0.0_wp
    do p = 1, work%n
      j = [work%impulse(p, 1), work%impulse(p, 2), work%impulse(p, 3)]
      r = [work%arm(p, 1), work%arm(p, 2), work%arm(p, 3)]
      a = work%a(p)
      b = work%b(p)
      do c = 1, 3
        work%change(c, a) = work%change(c, a) + work%kick_a(p)*j(c)
        work%change(c, b) = work%change(c, b) + work%kick_b(p)*j(c)
        z(c) = z(c) + j(c)
      end do
      z(4) = z(4) + (r(2)*j(3) - r(3)*j(2))
      z(5) = z(5) + (r(3)*j(1) - r(1)*j(3))
      z(6) = z(6) + (r(1)*j(2) - r(2)*j(1))
    end do
    w = 0.0_wp
    if (body%free) w = -twist_of(body, z)
    work%twist = w
    do p = 1, work%n
      a = work%a(p)
      b = work%b(p)
      r = [work%arm(p, 1), work%arm(p, 2), work%arm(p, 3)]
      work%now(p, 1) = work%before(p, 1) + (work%weight_a(p)*work%change(1, a) + work%weight_b(p)*work%change(1, b)) &
                       - (w(1) + w(5)*r(3) - w(6)*r(2))
      work%now(p, 2) = work%before(p, 2) + (work%weight_a(p)*work%change(2, a) + work%weight_b(p)*work%change(2, b)) &
                       - (w(2) + w(6)*r(1) - w(4)*r(3))
      work%now(p, 3) = work%before(p, 3) + (work%weight_a(p)*work%change(3, a) + work%weight_b(p)*work%change(3, b)) &
                       - (w(3) + w(4)*r(2) - w(5)*r(1))
    end do
  end subroutine replay

  !> H z.
  pure function twist_of(body, z) result(w)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: z(6)
    real(wp) :: w(6)
    integer :: c
    do c = 1, 3
      w(c) = body%inverse_mass*z(c)
      w(c + 3) = body%inverse_inertia(c, 1)*z(4) + body%inverse_inertia(c, 2)*z(5) + body%inverse_inertia(c, 3)*z(6)
    end do
  end function twist_of

  !> How far each impulse is from its law at the present velocities, and the law's derivative:
  !> the law sees u_0 + t (u - u_0) - s rho j.
  pure subroutine measure(t, s, work)
    real(wp), intent(in) :: t, s
    type(coupled_work_t), intent(inout) :: work
    call apply_law(size(work%rho), work%n_lane, work%normal, work%before, work%now, work%impulse, work%rho, work%mass, &
                   work%rebound, work%friction, merge(0.0_wp, -huge(1.0_wp), work%push_only), t, s, work%off, work%slip, &
                   work%slide, work%along, work%across, work%residual, work%error)
  end subroutine measure

  pure subroutine apply_law(m, n, normal, before, now, impulse, rho, mass, rebound, friction, floor_impulse, t, s, off, &
                            slip, slide, along, across, residual, error)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: normal(m, 3), before(m, 3), now(m, 3), impulse(m, 3), rho(m), mass(m), rebound(m)
    real(wp), intent(in) :: friction, floor_impulse, t, s
    real(wp), intent(inout) :: off(m, 3), slip(m, 3), slide(m), along(m), across(m)
    real(wp), intent(out) :: residual, error
    real(wp) :: u1, u2, u3, un, t1, t2, t3, speed, jn, grip, stick, active, held, worst(lane), squares(lane)
    integer :: k, l, i
    worst = 0.0_wp
    squares = 0.0_wp
    do k = 0, n - lane, lane
      do l = 1, lane
        i = k + l
        held = s*rho(i)
        u1 = before(i, 1) + t*(now(i, 1) - before(i, 1)) - held*impulse(i, 1)
        u2 = before(i, 2) + t*(now(i, 2) - before(i, 2)) - held*impulse(i, 2)
        u3 = before(i, 3) + t*(now(i, 3) - before(i, 3)) - held*impulse(i, 3)
        un = u1*normal(i, 1) + u2*normal(i, 2) + u3*normal(i, 3)
        t1 = u1 - un*normal(i, 1)
        t2 = u2 - un*normal(i, 2)
        t3 = u3 - un*normal(i, 3)
        speed = sqrt(t1*t1 + t2*t2 + t3*t3)
        jn = mass(i)*(rebound(i) - un)
        active = merge(1.0_wp, 0.0_wp, jn > floor_impulse)
        jn = merge(jn, 0.0_wp, jn > floor_impulse)
        grip = friction*merge(jn, 0.0_wp, jn > 0.0_wp)
        stick = merge(1.0_wp, 0.0_wp, mass(i)*speed <= grip)
        held = 1.0_wp/merge(speed, 1.0_wp, speed > 0.0_wp)
        slide(i) = active*merge(mass(i), grip*held, stick > 0.5_wp)
        off(i, 1) = (jn*normal(i, 1) - slide(i)*t1) - impulse(i, 1)
        off(i, 2) = (jn*normal(i, 2) - slide(i)*t2) - impulse(i, 2)
        off(i, 3) = (jn*normal(i, 3) - slide(i)*t3) - impulse(i, 3)
        held = held*(1.0_wp - stick)
        slip(i, 1) = t1*held
        slip(i, 2) = t2*held
        slip(i, 3) = t3*held
        along(i) = mass(i)*active
        across(i) = merge(0.0_wp, friction*along(i)*(1.0_wp - stick), jn <= 0.0_wp)
        u1 = rho(i)*off(i, 1)
        u2 = rho(i)*off(i, 2)
        u3 = rho(i)*off(i, 3)
        worst(l) = max(worst(l), max(abs(u1), max(abs(u2), abs(u3))))
        squares(l) = squares(l) + (u1*u1 + u2*u2 + u3*u3)
      end do
    end do
    residual = maxval(worst)
    error = ((squares(1) + squares(2)) + (squares(3) + squares(4))) + ((squares(5) + squares(6)) + (squares(7) + squares(8)))
  end subroutine apply_law

  !> Newton's method from the present impulses.
  subroutine newton(body, epsilon_at_first, max_step, work)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: epsilon_at_first
    integer, intent(in) :: max_step
    type(coupled_work_t), intent(inout) :: work
    real(wp) :: epsilon, before, t, errors(memory)
    integer :: step, p, c, cut
    logical :: ok, negative
    epsilon = epsilon_at_first
    call measure(1.0_wp, 1.0_wp, work)
    errors = work%error
    do step = 1, max_step
      if (work%residual <= tolerance*work%largest) return
      call linear_step(body, 1.0_wp, 1.0_wp - epsilon, 0.0_wp, work, negative, ok)
      if (.not. ok) return
      work%iterations = work%iterations + 1
      do c = 1, 3
        do p = 1, work%n
          work%kept(p, c) = work%impulse(p, c)
        end do
      end do
      before = work%error
      t = 1.0_wp
      do cut = 1, max_cut
        do p = 1, work%n
          do c = 1, 3
            work%impulse(p, c) = work%kept(p, c) + t*work%matrix%right(1, c, p)
          end do
        end do
        call replay(body, work)
        call measure(1.0_wp, 1.0_wp, work)
        if (work%error < maxval(errors)) exit
        t = 0.5_wp*t
      end do
      if (cut == 1 .and. work%error < 0.5_wp*before) then
        epsilon = max(0.1_wp*epsilon, least_epsilon)
      else if (cut > 1 .or. work%error > before) then
        epsilon = min(4.0_wp*epsilon, largest_epsilon)
      end if
      errors(1 + mod(step, memory)) = work%error
    end do
  end subroutine newton

  !> (1 + P (t W - s rho)) x = law - j, and = left P w, w = u - u_0 - rho j being what the law sees change
  !> with t on the path; from the last `measure`. x in `matrix%right(1,:,:)` and `(8,:,:)`.
  pure subroutine linear_step(body, t, s, left, work, negative, ok)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: t, s, left
    type(coupled_work_t), intent(inout) :: work
    logical, intent(out) :: negative   !! the determinant is
    logical, intent(out) :: ok
    logical :: body_negative
    integer :: p
    do p = 1, work%n
      call set_row(p, left, work)
    end do
    call fill_matrix(work%matrix, work%slope, t, s, work%rho)
    call eliminate(work%matrix, negative, ok)
    if (.not. (ok .and. body%free)) return
    call add_body(body, t, work, body_negative, ok)
    negative = negative .neqv. body_negative
  end subroutine linear_step

  !> P, law - j, P G and P w of one contact.
  pure subroutine set_row(p, left, work)
    integer, intent(in) :: p
    real(wp), intent(in) :: left
    type(coupled_work_t), intent(inout) :: work
    real(wp) :: n(3), s(3), w(3), a, b, x, y, z, p1, p2, p3
    integer :: c, d
    associate (right => work%matrix%right, slope => work%slope)
      work%matrix%idle(p) = .not. (work%along(p) > 0.0_wp .or. work%slide(p) > 0.0_wp)
      if (work%matrix%idle(p)) then
        right(:, :, p) = 0.0_wp
        slope(:, :, p) = 0.0_wp
        do c = 1, 3
          right(1, c, p) = work%off(p, c)
        end do
        return
      end if
      do c = 1, 3
        n(c) = work%normal(p, c)
        s(c) = work%slip(p, c)
        w(c) = left*((work%now(p, c) - work%before(p, c)) - work%rho(p)*work%impulse(p, c))
      end do
      x = work%arm(p, 1)
      y = work%arm(p, 2)
      z = work%arm(p, 3)
      do c = 1, 3
        a = (work%along(p) - work%slide(p))*n(c) - work%across(p)*s(c)
        b = work%slide(p)*s(c)
        do d = 1, 3
          slope(c, d, p) = a*n(d) - b*s(d)
        end do
        slope(c, c, p) = slope(c, c, p) + work%slide(p)
        p1 = slope(c, 1, p)
        p2 = slope(c, 2, p)
        p3 = slope(c, 3, p)
        right(1, c, p) = work%off(p, c)
        ! G = [1, -[r]].
        right(2, c, p) = p1
        right(3, c, p) = p2
        right(4, c, p) = p3
        right(5, c, p) = p3*y - p2*z
        right(6, c, p) = p1*z - p3*x
        right(7, c, p) = p2*x - p1*y
        right(8, c, p) = p1*w(1) + p2*w(2) + p3*w(3)
      end do
    end associate
  end subroutine set_row

  !> The body's part: with X = B^-1 P G and x0 = B^-1 of a right side, the momentum z = G^T x
  !> of the answer satisfies (1 + t G^T X H) z = G^T x0, and x = x0 - t X H z.
  pure subroutine add_body(body, t, work, negative, ok)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: t
    type(coupled_work_t), intent(inout) :: work
    logical, intent(out) :: negative, ok
    real(wp) :: g(lane, 6), matrix(6, 6), b(6, 2), z(6, 2), h(6, 2), x, y, w, push, pull
    integer :: p, c, l
    g = 0.0_wp
    associate (right => work%matrix%right)
      do p = 1, work%n
        x = work%arm(p, 1)
        y = work%arm(p, 2)
        w = work%arm(p, 3)
        do l = 1, lane
          g(l, 1) = g(l, 1) + right(l, 1, p)
          g(l, 2) = g(l, 2) + right(l, 2, p)
          g(l, 3) = g(l, 3) + right(l, 3, p)
          g(l, 4) = g(l, 4) + (y*right(l, 3, p) - w*right(l, 2, p))
          g(l, 5) = g(l, 5) + (w*right(l, 1, p) - x*right(l, 3, p))
          g(l, 6) = g(l, 6) + (x*right(l, 2, p) - y*right(l, 1, p))
        end do
      end do
      do c = 1, 3
        do l = 1, 6
          matrix(l, c) = t*g(c + 1, l)*body%inverse_mass
          matrix(l, c + 3) = t*(g(5, l)*body%inverse_inertia(1, c) + g(6, l)*body%inverse_inertia(2, c) &
                                + g(7, l)*body%inverse_inertia(3, c))
        end do
      end do
      do c = 1, 6
        matrix(c, c) = matrix(c, c) + 1.0_wp
        b(c, 1) = g(1, c)
        b(c, 2) = g(8, c)
      end do
      call solve_pair(matrix, b, z, negative, ok)
      if (.not. ok) return
      h(:, 1) = t*twist_of(body, z(:, 1))
      h(:, 2) = t*twist_of(body, z(:, 2))
      do p = 1, work%n
        if (work%matrix%idle(p)) cycle
        do c = 1, 3
          push = 0.0_wp
          pull = 0.0_wp
          do l = 1, 6
            push = push + right(l + 1, c, p)*h(l, 1)
            pull = pull + right(l + 1, c, p)*h(l, 2)
          end do
          right(1, c, p) = right(1, c, p) - push
          right(8, c, p) = right(8, c, p) - pull
        end do
      end do
    end associate
  end subroutine add_body

  !> Along the path from t = 0 towards t = 1, from where Newton's method goes on to the end as
  !> soon as it can. Lengths are measured with impulses over the fastest contact's and t over
  !> what is left of it, since impulses that must grow do so with 1/(1 - t).
  subroutine follow_path(body, work)
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    real(wp) :: t, t_kept, t_way, left, next_look, arc
    integer :: step, bends
    logical :: ok
    t = 0.0_wp
    t_kept = 0.0_wp
    left = 1.0_wp
    work%impulse(1:work%n_lane, :) = 0.0_wp
    call replay(body, work)
    call measure(0.0_wp, 0.0_wp, work)
    work%impulse(1:work%n, :) = work%off(1:work%n, :)
    call replay(body, work)
    call measure(0.0_wp, 0.0_wp, work)
    work%way(1:work%n, :) = 0.0_wp
    t_way = 0.0_wp
    call turn_along(body, t, left, work, t_way, ok)
    arc = first_arc
    next_look = first_look
    bends = 0
    do step = 1, max_path
      if (.not. ok) return
      work%place(1:work%n, :) = work%impulse(1:work%n, :)
      t_kept = t
      left = 1.0_wp - t
      if (left < next_look .and. t_way > 0.0_wp) then
        next_look = look_every*left
        call go(1.0_wp/t_way)
        call newton(body, max(least_epsilon, min(1.0e-2_wp, left)), newton_at_look, work)
        if (work%residual <= tolerance*work%largest) return
      end if
      if (left < least_left) return
      arc = min(1.6_wp*arc, max(most_arc, 0.2_wp*far(work)), most_arc/max(t_way, 1.0e-6_wp))
      do
        call go(arc)
        call back_to_path(body, t, left, t_way, work, ok)
        if (ok) call turn_along(body, t, 1.0_wp - t, work, t_way, ok)
        if (ok) bends = 0
        if (ok) exit
        arc = 0.4_wp*arc
        if (arc > least_arc) cycle
        ! A bend: what lies behind it tells the way on.
        bends = bends + 1
        if (bends > max_bend) return
        call go(least_arc*10.0_wp**mod(bends - 1, 4))
        call measure(t, t, work)
        work%way(1:work%n, :) = 0.0_wp
        t_way = 0.0_wp
        call turn_along(body, t, left, work, t_way, ok)
        arc = 1.0e-3_wp
      end do
    end do
  contains
    !> From the kept place along the tangent.
    subroutine go(length)
      real(wp), intent(in) :: length
      work%impulse(1:work%n, :) = work%place(1:work%n, :) + length*work%way(1:work%n, :)
      t = t_kept + left*length*t_way
      call replay(body, work)
    end subroutine go
  end subroutine follow_path

  !> Size of the impulses, as the path measures lengths.
  pure real(wp) function far(work)
    type(coupled_work_t), intent(in) :: work
    integer :: p
    far = 0.0_wp
    do p = 1, work%n
      far = far + (work%rho(p)/work%largest)**2*(work%impulse(p, 1)**2 + work%impulse(p, 2)**2 + work%impulse(p, 3)**2)
    end do
    far = sqrt(far)
  end function far

  !> Newton's method across the tangent.
  subroutine back_to_path(body, t, left, t_way, work, ok)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(inout) :: t
    real(wp), intent(in) :: left, t_way
    type(coupled_work_t), intent(inout) :: work
    logical, intent(out) :: ok
    real(wp) :: change, first, second, weight, last
    integer :: k, p, c
    logical :: negative
    ok = .false.
    last = 0.25_wp*huge(1.0_wp)
    do k = 1, max_correction
      if (t < 0.0_wp .or. t >= 1.0_wp) return
      call measure(t, t, work)
      ok = work%residual <= on_path*work%largest
      if (ok) return
      if (work%residual > 2.0_wp*last) return
      last = work%residual
      call linear_step(body, t, t, left, work, negative, ok)
      if (.not. ok) return
      ok = .false.
      work%iterations = work%iterations + 1
      first = 0.0_wp
      second = 0.0_wp
      do p = 1, work%n
        weight = (work%rho(p)/work%largest)**2
        do c = 1, 3
          first = first + weight*work%way(p, c)*work%matrix%right(1, c, p)
          second = second + weight*work%way(p, c)*work%matrix%right(8, c, p)
        end do
      end do
      if (.not. abs(t_way - second) > abs(first)) return
      change = -first/(t_way - second)
      t = t + left*change
      do p = 1, work%n
        do c = 1, 3
          work%impulse(p, c) = work%impulse(p, c) + (work%matrix%right(1, c, p) - change*work%matrix%right(8, c, p))
        end do
      end do
      call replay(body, work)
    end do
  end subroutine back_to_path

  !> The tangent where the last `measure` was made. Not ok where it has turned sharply: a shorter
  !> step will tell. With `t_way` 0 any tangent will do.
  subroutine turn_along(body, t, left, work, t_way, ok)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: t, left
    type(coupled_work_t), intent(inout) :: work
    real(wp), intent(inout) :: t_way
    logical, intent(out) :: ok
    real(wp) :: square, along, weight, forward
    integer :: p, c
    logical :: negative
    call linear_step(body, t, t, left, work, negative, ok)
    if (.not. ok) return
    square = 1.0_wp
    along = t_way
    do p = 1, work%n
      weight = (work%rho(p)/work%largest)**2
      do c = 1, 3
        square = square + weight*work%matrix%right(8, c, p)**2
        along = along - weight*work%way(p, c)*work%matrix%right(8, c, p)
      end do
    end do
    forward = merge(-1.0_wp, 1.0_wp, negative)/sqrt(square)
    ok = along*forward > least_cosine .or. .not. abs(t_way) > 0.0_wp
    if (.not. ok) return
    t_way = forward
    do p = 1, work%n
      do c = 1, 3
        work%way(p, c) = -forward*work%matrix%right(8, c, p)
      end do
    end do
  end subroutine turn_along

end module castnet_coupled_friction
