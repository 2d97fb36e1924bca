!> Impulses of many node contacts at once with Coulomb friction, in the 6 x 6 form.
!>
!> A point mass is isotropic: given the body's change of twist delta, node i has the
!> relative velocity u = u_i - (delta_v + delta_w x r_i) before its own impulse, and its
!> impulse is known in closed form,
!>
!>     j_n = m max(0, c - u.n),   j_t = -min(m |u_t|, mu j_n) u_t/|u_t|,
!>
!> c the normal velocity after the impact: it sticks (v_t+ = 0) inside the cone and
!> slides against u_t on it. The cone is round; restitution acts on the normal only.
!> What remains are six equations, F(delta) = H^-1 delta + sum_i [j_i, r_i x j_i] = 0,
!> solved by Newton's method with the exact derivative and a step that is cut until |F|
!> falls. Friction's bound follows the normal impulse, so that F is no gradient; where
!> Newton stalls the bounds are frozen (Tresca friction, a convex problem) and renewed
!> by turns until they agree.
module castnet_friction_solver
  use castnet_kinds, only: wp
  use castnet_contact_list, only: body_inertia_t, lane
  use castnet_six_by_six, only: solve_general
  implicit none
  private
  public :: friction_problem_t, reserve_friction, solve_friction, cone_impulse, cone_derivative

  integer, parameter :: max_newton = 60
  integer, parameter :: max_cut = 30
  integer, parameter :: max_rise = 100
  integer, parameter :: max_renewal = 400
  integer, parameter :: max_correction = 3
  !> A solve with a larger residual has not converged, of the largest speed [-].
  real(wp), parameter :: accept_below = 1.0e-10_wp
  !> Residual above which impulses that cancelled are corrected, of the largest speed [-].
  real(wp), parameter :: correct_above = 1.0e-13_wp
  !> Velocities are found to this part of the largest one [-].
  real(wp), parameter :: tolerance = 1.0e-14_wp

  !> One system of impulses with friction; arrays as long as the contact list's.
  type :: friction_problem_t
    integer :: n = 0
    integer :: capacity = 0
    logical :: push_only = .true.
    real(wp) :: friction = 0.0_wp
    real(wp), allocatable :: normal(:, :)       !! (capacity,3)
    real(wp), allocatable :: arm(:, :)          !! (capacity,3) [m]
    real(wp), allocatable :: velocity(:, :)     !! (capacity,3) relative velocity before [m/s]
    real(wp), allocatable :: mass(:)            !! 0 takes a contact out [kg]
    real(wp), allocatable :: rebound(:)         !! c, normal velocity after [m/s]
    real(wp), allocatable :: impulse(:, :)      !! (capacity,3) the answer, on the net [N s]
    real(wp), allocatable :: after(:, :)        !! (capacity,3) relative velocity after [m/s]
    real(wp), allocatable :: bound(:)           !! frozen friction bounds [N s]
  end type friction_problem_t

contains

  !> Room for `capacity` contacts, a multiple of `lane`.
  subroutine reserve_friction(problem, capacity)
    type(friction_problem_t), intent(inout) :: problem
    integer, intent(in) :: capacity
    if (problem%capacity >= capacity .and. allocated(problem%normal)) return
    if (allocated(problem%normal)) deallocate (problem%normal, problem%arm, problem%velocity, problem%mass, &
                                               problem%rebound, problem%impulse, problem%after, problem%bound)
    allocate (problem%normal(capacity, 3), problem%arm(capacity, 3), problem%velocity(capacity, 3), source=0.0_wp)
    allocate (problem%impulse(capacity, 3), problem%after(capacity, 3), source=0.0_wp)
    allocate (problem%mass(capacity), problem%rebound(capacity), problem%bound(capacity), source=0.0_wp)
    problem%capacity = capacity
  end subroutine reserve_friction

  !> Impulse on a point of mass m that meets the surface at relative velocity u.
  pure function cone_impulse(mass, u, n, rebound, friction, push_only) result(j)
    real(wp), intent(in) :: mass, u(3), n(3), rebound, friction
    logical, intent(in) :: push_only
    real(wp) :: j(3), un, ut(3), speed, jn, grip
    un = u(1)*n(1) + u(2)*n(2) + u(3)*n(3)
    jn = mass*(rebound - un)
    if (push_only) jn = max(0.0_wp, jn)
    ut = u - un*n
    speed = sqrt(ut(1)*ut(1) + ut(2)*ut(2) + ut(3)*ut(3))
    grip = friction*max(0.0_wp, jn)
    ! The force that would stop it, unless that is more than friction can give.
    if (mass*speed > grip) then
      j = jn*n - (grip/max(speed, tiny(1.0_wp)))*ut
    else
      j = jn*n - mass*ut
    end if
  end function cone_impulse

  !> Impulses of every contact. `residual` is the largest difference between a contact's
  !> impulse and its law at the velocities that the impulses give, over its mass [m/s].
  pure subroutine solve_friction(problem, body, from_rest, iterations, residual, converged, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    logical, intent(in) :: from_rest        !! .false.: from `twist`, and impulses are kept where that is no better
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual
    logical, intent(out) :: converged
    real(wp), intent(inout) :: twist(6)     !! change of the body's twist, inertial axes
    real(wp) :: delta(6), largest, before
    integer :: n_lane, k
    call pad(problem, n_lane)
    largest = largest_speed(problem)
    delta = 0.0_wp
    if (.not. from_rest) delta = twist
    iterations = 0
    converged = .true.
    if (.not. from_rest) then
      call newton(problem, body, n_lane, problem%friction, .false., delta, iterations, converged)
      if (.not. converged) return
    else if (body%free .and. largest > 0.0_wp) then
      call newton(problem, body, n_lane, problem%friction, .false., delta, iterations, converged)
      if (.not. converged) call raise_friction(problem, body, n_lane, delta, iterations, converged)
      if (.not. converged) call renew_bounds(problem, body, n_lane, delta, iterations, converged)
    end if
    call impulses_at(problem, delta)
    call measure_law(problem, body, twist, residual)
    do k = 1, max_correction
      if (residual <= correct_above*largest .or. .not. body%free) exit
      iterations = iterations + 1
      before = residual
      call correct(problem, body, n_lane, twist)
      call measure_law(problem, body, twist, residual)
      if (residual < before) cycle
      ! Not a matter of rounding: back to what it was.
      call impulses_at(problem, delta)
      call measure_law(problem, body, twist, residual)
      exit
    end do
    ! The law decides, not the search: it may end in rounding and still be right.
    converged = residual <= accept_below*largest
  end subroutine solve_friction

  pure subroutine pad(problem, n_lane)
    type(friction_problem_t), intent(inout) :: problem
    integer, intent(out) :: n_lane
    integer :: i
    n_lane = ((problem%n + lane - 1)/lane)*lane
    do i = problem%n + 1, n_lane
      problem%normal(i, :) = [1.0_wp, 0.0_wp, 0.0_wp]
      problem%arm(i, :) = 0.0_wp
      problem%velocity(i, :) = 0.0_wp
      problem%mass(i) = 0.0_wp
      problem%rebound(i) = 0.0_wp
      problem%bound(i) = 0.0_wp
    end do
  end subroutine pad

  pure real(wp) function largest_speed(problem) result(largest)
    type(friction_problem_t), intent(in) :: problem
    integer :: i
    largest = 0.0_wp
    do i = 1, problem%n
      if (.not. problem%mass(i) > 0.0_wp) cycle
      largest = max(largest, abs(problem%velocity(i, 1)), abs(problem%velocity(i, 2)), abs(problem%velocity(i, 3)))
    end do
  end function largest_speed

  !> Newton's method on F. `frozen`: friction bounds from `problem%bound`.
  pure subroutine newton(problem, body, n_lane, friction, frozen, delta, iterations, converged)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(in) :: friction
    logical, intent(in) :: frozen
    real(wp), intent(inout) :: delta(6)
    integer, intent(inout) :: iterations
    logical, intent(out) :: converged
    real(wp) :: f(6), jacobian(6, 6), trial_f(6), trial_jacobian(6, 6), step(6), trial(6), size, trial_size, t, scale
    logical :: ok
    integer :: k, cut
    converged = .false.
    call sweep(problem%capacity, n_lane, problem%normal, problem%arm, problem%velocity, problem%mass, problem%rebound, &
               problem%bound, friction, problem%push_only, frozen, body, delta, f, jacobian, scale)
    size = measure(body, f)
    do k = 1, max_newton
      iterations = iterations + 1
      if (size <= tolerance*scale) then
        converged = .true.
        return
      end if
      call solve_general(jacobian, -f, step, ok)
      if (.not. ok) return
      t = 1.0_wp
      do cut = 1, max_cut
        trial = delta + t*step
        call sweep(problem%capacity, n_lane, problem%normal, problem%arm, problem%velocity, problem%mass, problem%rebound, &
                   problem%bound, friction, problem%push_only, frozen, body, trial, trial_f, trial_jacobian, scale)
        trial_size = measure(body, trial_f)
        if (trial_size < (1.0_wp - 1.0e-4_wp*t)*size) exit
        t = 0.5_wp*t
      end do
      if (cut > max_cut) then
        converged = size <= 100.0_wp*tolerance*scale
        return
      end if
      delta = trial
      f = trial_f
      jacobian = trial_jacobian
      size = trial_size
    end do
  end subroutine newton

  !> Raise the coefficient of friction from nothing, where the problem is convex, each
  !> solution the start of the next; the rise is halved where Newton fails.
  pure subroutine raise_friction(problem, body, n_lane, delta, iterations, converged)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(inout) :: delta(6)
    integer, intent(inout) :: iterations
    logical, intent(out) :: converged
    real(wp) :: reached, rise, trial(6)
    integer :: k
    logical :: ok
    converged = .false.
    delta = 0.0_wp
    call newton(problem, body, n_lane, 0.0_wp, .false., delta, iterations, ok)
    if (.not. ok) return
    reached = 0.0_wp
    rise = 0.25_wp
    do k = 1, max_rise
      trial = delta
      call newton(problem, body, n_lane, min(1.0_wp, reached + rise)*problem%friction, .false., trial, iterations, ok)
      if (ok) then
        delta = trial
        reached = min(1.0_wp, reached + rise)
        rise = 2.0_wp*rise
        converged = reached >= 1.0_wp
        if (converged) return
      else
        rise = 0.25_wp*rise
        if (rise < 1.0e-4_wp) return
      end if
    end do
  end subroutine raise_friction

  !> Freeze the friction bounds, solve, renew them, until they agree.
  pure subroutine renew_bounds(problem, body, n_lane, delta, iterations, converged)
    type(friction_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(inout) :: delta(6)
    integer, intent(inout) :: iterations
    logical, intent(out) :: converged
    real(wp) :: change, largest, bound, mix
    integer :: i, k
    logical :: ok
    delta = 0.0_wp
    problem%bound = 0.0_wp
    mix = 1.0_wp
    do k = 1, max_renewal
      if (k > 50) mix = 0.5_wp
      if (k > 200) mix = 0.2_wp
      call newton(problem, body, n_lane, problem%friction, .true., delta, iterations, ok)
      change = 0.0_wp
      largest = 0.0_wp
      do i = 1, problem%n
        bound = problem%friction*normal_impulse(problem, i, delta)
        change = max(change, abs(bound - problem%bound(i)))
        largest = max(largest, bound)
        problem%bound(i) = problem%bound(i) + mix*(bound - problem%bound(i))
      end do
      if (change <= 1.0e-14_wp*largest) exit
      ! Once the bounds are nearly right Newton's method on the whole is.
      if (mod(k, 10) == 0) then
        call newton(problem, body, n_lane, problem%friction, .false., delta, iterations, converged)
        if (converged) return
      end if
    end do
    converged = k <= max_renewal
  end subroutine renew_bounds

  pure real(wp) function normal_impulse(problem, i, delta) result(jn)
    type(friction_problem_t), intent(in) :: problem
    integer, intent(in) :: i
    real(wp), intent(in) :: delta(6)
    real(wp) :: u(3)
    u = velocity_at(problem%velocity(i, 1), problem%velocity(i, 2), problem%velocity(i, 3), &
                    problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3), delta)
    jn = max(0.0_wp, problem%mass(i)*(problem%rebound(i) - u(1)*problem%normal(i, 1) - u(2)*problem%normal(i, 2) &
                                      - u(3)*problem%normal(i, 3)))
  end function normal_impulse

  !> u_i - (delta_v + delta_w x r).
  pure function velocity_at(ux, uy, uz, rx, ry, rz, delta) result(u)
    real(wp), intent(in) :: ux, uy, uz, rx, ry, rz, delta(6)
    real(wp) :: u(3)
    u(1) = ux - (delta(1) + (delta(5)*rz - delta(6)*ry))
    u(2) = uy - (delta(2) + (delta(6)*rx - delta(4)*rz))
    u(3) = uz - (delta(3) + (delta(4)*ry - delta(5)*rx))
  end function velocity_at

  !> |F| as a velocity: its momentum over the mass, the largest of the two kinds. Any
  !> norm will do for the descent; this one needs no units.
  pure real(wp) function measure(body, f) result(size)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: f(6)
    real(wp) :: w(3)
    w(1) = body%inverse_inertia(1, 1)*f(4) + body%inverse_inertia(1, 2)*f(5) + body%inverse_inertia(1, 3)*f(6)
    w(2) = body%inverse_inertia(2, 1)*f(4) + body%inverse_inertia(2, 2)*f(5) + body%inverse_inertia(2, 3)*f(6)
    w(3) = body%inverse_inertia(3, 1)*f(4) + body%inverse_inertia(3, 2)*f(5) + body%inverse_inertia(3, 3)*f(6)
    size = sqrt(body%inverse_mass*(f(1)*f(1) + f(2)*f(2) + f(3)*f(3)) + (w(1)*f(4) + w(2)*f(5) + w(3)*f(6)))
  end function measure

  !> One pass over the contacts: F, its derivative, and the size of the terms that F is
  !> the sum of, in the norm of `measure` (what rounding leaves is a part of that).
  pure subroutine sweep(m, n, normal, arm, velocity, mass, rebound, bound, friction, push_only, frozen, body, delta, &
                        f, jacobian, scale)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: normal(m, 3), arm(m, 3), velocity(m, 3), mass(m), rebound(m), bound(m), friction
    logical, intent(in) :: push_only, frozen
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: delta(6)
    real(wp), intent(out) :: f(6), jacobian(6, 6), scale
    real(wp) :: sum_f(lane, 6), sum_a(lane, 3, 3), sum_b(lane, 3, 3), sum_c(lane, 3, 3), sum_d(lane, 3, 3), size(lane)
    real(wp) :: a(lane, 3, 3), ar(lane, 3, 3), j(lane, 3), nn(lane, 3), r(lane, 3), tau(lane, 3)
    real(wp) :: u1, u2, u3, un, t1, t2, t3, speed, jn, grip, stick, slide, active, mm, along, across, floor_impulse
    integer :: k, l, c, d, i
    sum_f = 0.0_wp
    sum_a = 0.0_wp
    sum_b = 0.0_wp
    sum_c = 0.0_wp
    sum_d = 0.0_wp
    size = 0.0_wp
    floor_impulse = merge(0.0_wp, -huge(1.0_wp), push_only)
    do k = 0, n - lane, lane
      do l = 1, lane
        i = k + l
        mm = mass(i)
        u1 = velocity(i, 1) - (delta(1) + (delta(5)*arm(i, 3) - delta(6)*arm(i, 2)))
        u2 = velocity(i, 2) - (delta(2) + (delta(6)*arm(i, 1) - delta(4)*arm(i, 3)))
        u3 = velocity(i, 3) - (delta(3) + (delta(4)*arm(i, 2) - delta(5)*arm(i, 1)))
        un = u1*normal(i, 1) + u2*normal(i, 2) + u3*normal(i, 3)
        t1 = u1 - un*normal(i, 1)
        t2 = u2 - un*normal(i, 2)
        t3 = u3 - un*normal(i, 3)
        speed = sqrt(t1*t1 + t2*t2 + t3*t3)
        jn = mm*(rebound(i) - un)
        active = merge(1.0_wp, 0.0_wp, jn > floor_impulse)
        jn = merge(jn, 0.0_wp, jn > floor_impulse)
        grip = merge(bound(i), friction*merge(jn, 0.0_wp, jn > 0.0_wp), frozen)
        stick = merge(1.0_wp, 0.0_wp, mm*speed <= grip)
        ! Tangential impulse -slide u_t; its derivative in u_t is -slide across, 0 along u_t.
        slide = merge(mm, grip/merge(speed, 1.0_wp, speed > 0.0_wp), stick > 0.5_wp)
        along = (1.0_wp - stick)/merge(speed, 1.0_wp, speed > 0.0_wp)
        tau(l, 1) = t1*along
        tau(l, 2) = t2*along
        tau(l, 3) = t3*along
        nn(l, 1) = normal(i, 1)
        nn(l, 2) = normal(i, 2)
        nn(l, 3) = normal(i, 3)
        r(l, 1) = arm(i, 1)
        r(l, 2) = arm(i, 2)
        r(l, 3) = arm(i, 3)
        j(l, 1) = jn*normal(i, 1) - slide*t1
        j(l, 2) = jn*normal(i, 2) - slide*t2
        j(l, 3) = jn*normal(i, 3) - slide*t3
        ! A = -dj/du = m active (n - [sliding] mu tau) n^T + slide (1 - n n^T - tau tau^T).
        along = mm*active
        across = merge(0.0_wp, friction*along*(1.0_wp - stick), frozen .or. jn <= 0.0_wp)
        a(l, 1, 1) = slide
        a(l, 2, 2) = slide
        a(l, 3, 3) = slide
        a(l, 1, 2) = along
        a(l, 1, 3) = across
        size(l) = size(l) + (abs(j(l, 1)) + abs(j(l, 2)) + abs(j(l, 3)))
      end do
      do l = 1, lane
        along = a(l, 1, 2)
        across = a(l, 1, 3)
        slide = a(l, 1, 1)
        do d = 1, 3
          do c = 1, 3
            a(l, c, d) = ((along - slide)*nn(l, c) - across*tau(l, c))*nn(l, d) - slide*tau(l, c)*tau(l, d)
          end do
          a(l, d, d) = a(l, d, d) + slide
        end do
      end do
      ! G = [1, -[r]x], F' = H^-1 + sum G^T A G.
      do c = 1, 3
        do l = 1, lane
          ar(l, c, 1) = a(l, c, 3)*r(l, 2) - a(l, c, 2)*r(l, 3)
          ar(l, c, 2) = a(l, c, 1)*r(l, 3) - a(l, c, 3)*r(l, 1)
          ar(l, c, 3) = a(l, c, 2)*r(l, 1) - a(l, c, 1)*r(l, 2)
          sum_f(l, c) = sum_f(l, c) + j(l, c)
        end do
      end do
      do l = 1, lane
        sum_f(l, 4) = sum_f(l, 4) + (r(l, 2)*j(l, 3) - r(l, 3)*j(l, 2))
        sum_f(l, 5) = sum_f(l, 5) + (r(l, 3)*j(l, 1) - r(l, 1)*j(l, 3))
        sum_f(l, 6) = sum_f(l, 6) + (r(l, 1)*j(l, 2) - r(l, 2)*j(l, 1))
      end do
      do d = 1, 3
        do l = 1, lane
          sum_a(l, 1, d) = sum_a(l, 1, d) + a(l, 1, d)
          sum_a(l, 2, d) = sum_a(l, 2, d) + a(l, 2, d)
          sum_a(l, 3, d) = sum_a(l, 3, d) + a(l, 3, d)
          sum_b(l, 1, d) = sum_b(l, 1, d) + ar(l, 1, d)
          sum_b(l, 2, d) = sum_b(l, 2, d) + ar(l, 2, d)
          sum_b(l, 3, d) = sum_b(l, 3, d) + ar(l, 3, d)
          sum_c(l, 1, d) = sum_c(l, 1, d) + (r(l, 2)*a(l, 3, d) - r(l, 3)*a(l, 2, d))
          sum_c(l, 2, d) = sum_c(l, 2, d) + (r(l, 3)*a(l, 1, d) - r(l, 1)*a(l, 3, d))
          sum_c(l, 3, d) = sum_c(l, 3, d) + (r(l, 1)*a(l, 2, d) - r(l, 2)*a(l, 1, d))
          sum_d(l, 1, d) = sum_d(l, 1, d) + (r(l, 2)*ar(l, 3, d) - r(l, 3)*ar(l, 2, d))
          sum_d(l, 2, d) = sum_d(l, 2, d) + (r(l, 3)*ar(l, 1, d) - r(l, 1)*ar(l, 3, d))
          sum_d(l, 3, d) = sum_d(l, 3, d) + (r(l, 1)*ar(l, 2, d) - r(l, 2)*ar(l, 1, d))
        end do
      end do
    end do
    jacobian = 0.0_wp
    f(1:3) = body%mass*delta(1:3)
    do c = 1, 3
      f(c + 3) = body%inertia(c, 1)*delta(4) + body%inertia(c, 2)*delta(5) + body%inertia(c, 3)*delta(6)
      jacobian(c, c) = body%mass
    end do
    jacobian(4:6, 4:6) = body%inertia
    do d = 1, 3
      f(d) = f(d) + total(sum_f(:, d))
      f(d + 3) = f(d + 3) + total(sum_f(:, d + 3))
      do c = 1, 3
        jacobian(c, d) = jacobian(c, d) + total(sum_a(:, c, d))
        jacobian(c, d + 3) = jacobian(c, d + 3) + total(sum_b(:, c, d))
        jacobian(c + 3, d) = jacobian(c + 3, d) + total(sum_c(:, c, d))
        jacobian(c + 3, d + 3) = jacobian(c + 3, d + 3) + total(sum_d(:, c, d))
      end do
    end do
    scale = sqrt(body%inverse_mass)*total(size) + tiny(1.0_wp)
  end subroutine sweep

  pure real(wp) function total(sums)
    real(wp), intent(in) :: sums(lane)
    total = ((sums(1) + sums(2)) + (sums(3) + sums(4))) + ((sums(5) + sums(6)) + (sums(7) + sums(8)))
  end function total

  !> Impulses of the law at `delta`.
  pure subroutine impulses_at(problem, delta)
    type(friction_problem_t), intent(inout) :: problem
    real(wp), intent(in) :: delta(6)
    real(wp) :: j(3)
    integer :: i
    do i = 1, problem%n
      j = law(problem, i, delta)
      problem%impulse(i, 1) = j(1)
      problem%impulse(i, 2) = j(2)
      problem%impulse(i, 3) = j(3)
    end do
  end subroutine impulses_at

  !> A contact's impulse by its law, the body's twist changed by `delta`.
  pure function law(problem, i, delta) result(j)
    type(friction_problem_t), intent(in) :: problem
    integer, intent(in) :: i
    real(wp), intent(in) :: delta(6)
    real(wp) :: j(3), u(3), n(3)
    u = velocity_at(problem%velocity(i, 1), problem%velocity(i, 2), problem%velocity(i, 3), &
                    problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3), delta)
    n = [problem%normal(i, 1), problem%normal(i, 2), problem%normal(i, 3)]
    j = cone_impulse(problem%mass(i), u, n, problem%rebound(i), problem%friction, problem%push_only)
  end function law

  !> Velocities that the impulses really give, with the body's exact reaction, and how
  !> far each impulse is from its law there.
  pure subroutine measure_law(problem, body, twist, residual)
    type(friction_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(out) :: twist(6), residual
    real(wp) :: u(3), j(3)
    integer :: i, c
    twist = reaction(problem, body)
    residual = 0.0_wp
    do i = 1, problem%n
      if (.not. problem%mass(i) > 0.0_wp) cycle
      j = law(problem, i, twist)
      u = velocity_at(problem%velocity(i, 1), problem%velocity(i, 2), problem%velocity(i, 3), &
                      problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3), twist)
      do c = 1, 3
        residual = max(residual, abs(j(c) - problem%impulse(i, c))/problem%mass(i))
        problem%after(i, c) = u(c) + problem%impulse(i, c)/problem%mass(i)
      end do
    end do
  end subroutine measure_law

  !> One Newton step on the impulses themselves, j = law(twist(j)), whose rounding does
  !> not grow where heavy nodes cancel against a light body: with rho = law - j,
  !> F' dtwist = -sum G^T rho and dj = rho - law' G dtwist.
  pure subroutine correct(problem, body, n_lane, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(in) :: twist(6)
    real(wp) :: f(6), jacobian(6, 6), scale, step(6), rho(3), u(3), n(3), g(3), a(3, 3)
    logical :: ok
    integer :: i, c
    call sweep(problem%capacity, n_lane, problem%normal, problem%arm, problem%velocity, problem%mass, problem%rebound, &
               problem%bound, problem%friction, problem%push_only, .false., body, twist, f, jacobian, scale)
    f = 0.0_wp
    do i = 1, problem%n
      rho = law(problem, i, twist) - problem%impulse(i, :)
      f(1) = f(1) + rho(1)
      f(2) = f(2) + rho(2)
      f(3) = f(3) + rho(3)
      f(4) = f(4) + (problem%arm(i, 2)*rho(3) - problem%arm(i, 3)*rho(2))
      f(5) = f(5) + (problem%arm(i, 3)*rho(1) - problem%arm(i, 1)*rho(3))
      f(6) = f(6) + (problem%arm(i, 1)*rho(2) - problem%arm(i, 2)*rho(1))
    end do
    call solve_general(jacobian, -f, step, ok)
    if (.not. ok) return
    do i = 1, problem%n
      if (.not. problem%mass(i) > 0.0_wp) cycle
      rho = law(problem, i, twist) - problem%impulse(i, :)
      u = velocity_at(problem%velocity(i, 1), problem%velocity(i, 2), problem%velocity(i, 3), &
                      problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3), twist)
      n = [problem%normal(i, 1), problem%normal(i, 2), problem%normal(i, 3)]
      a = cone_derivative(problem%mass(i), u, n, problem%rebound(i), problem%friction, problem%push_only)
      g = -velocity_at(0.0_wp, 0.0_wp, 0.0_wp, problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3), step)
      do c = 1, 3
        problem%impulse(i, c) = problem%impulse(i, c) + rho(c) + (a(c, 1)*g(1) + a(c, 2)*g(2) + a(c, 3)*g(3))
      end do
    end do
  end subroutine correct

  !> -d j/d u of `cone_impulse`.
  pure function cone_derivative(mass, u, n, rebound, friction, push_only) result(a)
    real(wp), intent(in) :: mass, u(3), n(3), rebound, friction
    logical, intent(in) :: push_only
    real(wp) :: a(3, 3), t(3), un, jn, speed, grip, slide, along
    integer :: c, d
    un = u(1)*n(1) + u(2)*n(2) + u(3)*n(3)
    t = u - un*n
    speed = sqrt(t(1)*t(1) + t(2)*t(2) + t(3)*t(3))
    jn = mass*(rebound - un)
    a = 0.0_wp
    if (push_only .and. jn <= 0.0_wp) return
    grip = friction*max(0.0_wp, jn)
    if (mass*speed > grip) then
      t = t/speed
      slide = grip/speed
    else
      t = 0.0_wp
      slide = mass
    end if
    along = merge(friction*mass, 0.0_wp, jn > 0.0_wp)
    do d = 1, 3
      do c = 1, 3
        a(c, d) = ((mass - slide)*n(c) - along*t(c))*n(d) - slide*t(c)*t(d)
      end do
      a(d, d) = a(d, d) + slide
    end do
  end function cone_derivative

  !> Change of the body's twist by the reaction of the impulses.
  pure function reaction(problem, body) result(twist)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: twist(6), p(6)
    integer :: i
    twist = 0.0_wp
    if (.not. body%free) return
    p = 0.0_wp
    do i = 1, problem%n
      p(1) = p(1) + problem%impulse(i, 1)
      p(2) = p(2) + problem%impulse(i, 2)
      p(3) = p(3) + problem%impulse(i, 3)
      p(4) = p(4) + (problem%arm(i, 2)*problem%impulse(i, 3) - problem%arm(i, 3)*problem%impulse(i, 2))
      p(5) = p(5) + (problem%arm(i, 3)*problem%impulse(i, 1) - problem%arm(i, 1)*problem%impulse(i, 3))
      p(6) = p(6) + (problem%arm(i, 1)*problem%impulse(i, 2) - problem%arm(i, 2)*problem%impulse(i, 1))
    end do
    twist(1:3) = -body%inverse_mass*p(1:3)
    twist(4) = -(body%inverse_inertia(1, 1)*p(4) + body%inverse_inertia(1, 2)*p(5) + body%inverse_inertia(1, 3)*p(6))
    twist(5) = -(body%inverse_inertia(2, 1)*p(4) + body%inverse_inertia(2, 2)*p(5) + body%inverse_inertia(2, 3)*p(6))
    twist(6) = -(body%inverse_inertia(3, 1)*p(4) + body%inverse_inertia(3, 2)*p(5) + body%inverse_inertia(3, 3)*p(6))
  end function reaction

end module castnet_friction_solver
