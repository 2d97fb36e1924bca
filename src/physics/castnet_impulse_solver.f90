!> Normal impulses of many node contacts at once, without friction (Shan, Guo, Gill
!> 2018, equations 2 to 17), in the exact 6 x 6 form.
!>
!> With rows b_i = [n_i, r_i x n_i], node masses m_i and H = diag(1/m_O I3, I_O^-1),
!> impulses j change the body's twist by delta = -H B^T j and the relative normal
!> velocities by M j, M = D^-1 + B H B^T, D = diag(m_i). Given delta each node stands
!> alone: to gain s_i = g_i + b_i delta it needs j_i = m_i s_i, and when it may only be
!> pushed, j_i = m_i max(0, s_i). What remains are six equations,
!>
!>     F(delta) = H^-1 delta + sum_i b_i m_i max(0, g_i + b_i delta) = 0,
!>
!> the gradient of the strictly convex, piecewise quadratic
!> phi = delta.H^-1 delta/2 + sum_i m_i max(0, s_i)^2/2. Newton's method jumps to the
!> minimum of the piece it stands on; a step that does not lower phi is cut to the
!> minimum along it. There are finitely many pieces and phi falls every time, so it
!> ends, after three passes over the contacts as a rule.
module castnet_impulse_solver
  use castnet_kinds, only: wp
  use castnet_contact_list, only: body_inertia_t, lane
  use castnet_six_by_six, only: factor_symmetric, solve_symmetric
  implicit none
  private
  public :: impulse_problem_t, reserve_problem, solve_single, solve_reduced, twist_of_impulses, pad, &
            inverse_inertia_times, inertia_times, inertia_matrix, measure

  integer, parameter :: max_iteration = 200
  integer, parameter :: max_refinement = 3
  !> Impulses are refined until the velocities they give are right to this [-].
  real(wp), parameter :: refine_above = 1.0e-14_wp

  !> One system of normal impulses; arrays as long as the contact list's.
  type :: impulse_problem_t
    integer :: n = 0
    integer :: capacity = 0
    logical :: push_only = .true.
    real(wp), allocatable :: row(:, :)          !! (capacity,6) b_i
    real(wp), allocatable :: weight(:)          !! m_i, 0 takes a contact out [kg]
    real(wp), allocatable :: inverse_weight(:)  !! 1/m_i [1/kg]
    real(wp), allocatable :: need(:)            !! g_i, normal velocity to gain [m/s]
    real(wp), allocatable :: impulse(:)         !! j_i, the answer [N s]
    real(wp), allocatable :: gained(:)          !! normal velocity gained with them [m/s]
    real(wp), allocatable :: held(:), active(:), short(:) !! scratch
  end type impulse_problem_t

contains

  !> Room for `capacity` contacts, a multiple of `lane`.
  subroutine reserve_problem(problem, capacity)
    type(impulse_problem_t), intent(inout) :: problem
    integer, intent(in) :: capacity
    if (problem%capacity >= capacity .and. allocated(problem%row)) return
    if (allocated(problem%row)) deallocate (problem%row, problem%weight, problem%inverse_weight, problem%need, &
                                            problem%impulse, problem%gained, problem%held, problem%active, problem%short)
    allocate (problem%row(capacity, 6), source=0.0_wp)
    allocate (problem%weight(capacity), problem%inverse_weight(capacity), problem%need(capacity), source=0.0_wp)
    allocate (problem%impulse(capacity), problem%gained(capacity), source=0.0_wp)
    allocate (problem%held(capacity), problem%active(capacity), problem%short(capacity), source=0.0_wp)
    problem%capacity = capacity
  end subroutine reserve_problem

  !> One contact, equation 5: j = g/(1/m_P + b H b).
  pure subroutine solve_single(problem, body)
    type(impulse_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: b(6), h(6), denominator, s
    problem%impulse(1) = 0.0_wp
    if (problem%weight(1) <= 0.0_wp) return
    b = problem%row(1, :)
    h = inverse_inertia_times(body, b)
    denominator = problem%inverse_weight(1) + (b(1)*h(1) + b(2)*h(2) + b(3)*h(3)) + (b(4)*h(4) + b(5)*h(5) + b(6)*h(6))
    s = problem%need(1)
    if (problem%push_only) s = max(0.0_wp, s)
    if (denominator > 0.0_wp) problem%impulse(1) = s/denominator
  end subroutine solve_single

  !> Every contact, in the 6 x 6 form. `converged` is .false. only when rounding kept the
  !> search from an end; `iterations` counts passes with a 6 x 6 solve.
  pure subroutine solve_reduced(problem, body, iterations, residual, converged)
    type(impulse_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual  !! largest violation of the contact conditions [m/s]
    logical, intent(out) :: converged
    real(wp) :: delta(6)
    integer :: n_lane
    call pad(problem, n_lane)
    iterations = 0
    converged = .true.
    delta = 0.0_wp
    if (body%free) then
      call search(problem%capacity, n_lane, problem%row, problem%weight, problem%need, body, problem%push_only, &
                  problem%held, delta, iterations, converged)
    end if
    call impulses_of(problem%capacity, n_lane, problem%row, problem%weight, problem%need, problem%push_only, delta, &
                     problem%impulse)
    call refine(problem, body, n_lane, residual)
  end subroutine solve_reduced

  !> Fill the last lanes with contacts that do nothing.
  pure subroutine pad(problem, n_lane)
    type(impulse_problem_t), intent(inout) :: problem
    integer, intent(out) :: n_lane  !! padded count
    integer :: i
    n_lane = ((problem%n + lane - 1)/lane)*lane
    do i = problem%n + 1, n_lane
      problem%row(i, :) = 0.0_wp
      problem%weight(i) = 0.0_wp
      problem%inverse_weight(i) = 0.0_wp
      problem%need(i) = 0.0_wp
      problem%impulse(i) = 0.0_wp
    end do
  end subroutine pad

  !> Newton's search for the body's change of twist `delta`.
  pure subroutine search(m, n, row, weight, need, body, push_only, held, delta, iterations, converged)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: row(m, 6), weight(m), need(m)
    type(body_inertia_t), intent(in) :: body
    logical, intent(in) :: push_only
    real(wp), intent(inout) :: held(m)
    real(wp), intent(inout) :: delta(6)
    integer, intent(out) :: iterations
    logical, intent(out) :: converged
    real(wp) :: gradient(6), trial_gradient(6), hessian(6, 6), step(6), trial(6), phi, trial_phi, change
    real(wp) :: l(6, 6), scale(6)
    logical :: ok
    converged = .true.
    held(1:n) = -1.0_wp
    call sweep(m, n, row, weight, need, body, push_only, delta, held, gradient, hessian, phi, change)
    do iterations = 1, max_iteration
      call factor_symmetric(hessian, l, scale, ok)
      if (.not. ok) exit
      call solve_symmetric(l, scale, -gradient, step)
      trial = delta + step
      if (.not. push_only) then
        delta = trial
        return
      end if
      call sweep(m, n, row, weight, need, body, push_only, trial, held, trial_gradient, hessian, trial_phi, change)
      if (change <= 0.0_wp) then
        delta = trial
        return
      end if
      if (.not. trial_phi < phi) then
        trial = delta + line_minimum(m, n, row, weight, need, body, delta, step)*step
        call sweep(m, n, row, weight, need, body, push_only, trial, held, trial_gradient, hessian, trial_phi, change)
        ! No step lowers phi any more: rounding decides which piece this is.
        if (.not. trial_phi < phi) return
      end if
      delta = trial
      gradient = trial_gradient
      phi = trial_phi
    end do
    converged = .false.
  end subroutine search

  !> One pass over the contacts at twist change `delta`: F, its derivative, phi, and
  !> how many contacts began or ceased to push since the last pass (`held`).
  pure subroutine sweep(m, n, row, weight, need, body, push_only, delta, held, gradient, hessian, phi, change)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: row(m, 6), weight(m), need(m)
    type(body_inertia_t), intent(in) :: body
    logical, intent(in) :: push_only
    real(wp), intent(in) :: delta(6)
    real(wp), intent(inout) :: held(m)
    real(wp), intent(out) :: gradient(6), hessian(6, 6), phi, change
    real(wp) :: sum_gradient(lane, 6), sum_hessian(lane, 21), sum_phi(lane), sum_change(lane)
    real(wp) :: active(lane), push(lane), part(lane), s, momentum(6), threshold
    integer :: k, l, c, d, e
    sum_gradient = 0.0_wp
    sum_hessian = 0.0_wp
    sum_phi = 0.0_wp
    sum_change = 0.0_wp
    threshold = merge(0.0_wp, -huge(1.0_wp), push_only)
    do k = 0, n - lane, lane
      do l = 1, lane
        s = need(k + l) + (row(k + l, 1)*delta(1) + row(k + l, 2)*delta(2) + row(k + l, 3)*delta(3) &
                           + row(k + l, 4)*delta(4) + row(k + l, 5)*delta(5) + row(k + l, 6)*delta(6))
        active(l) = merge(weight(k + l), 0.0_wp, s > threshold)
        push(l) = active(l)*s
        sum_phi(l) = sum_phi(l) + push(l)*s
        sum_change(l) = sum_change(l) + merge(1.0_wp, 0.0_wp, abs(active(l) - held(k + l)) > 0.0_wp)
        held(k + l) = active(l)
      end do
      e = 0
      do c = 1, 6
        do l = 1, lane
          part(l) = active(l)*row(k + l, c)
          sum_gradient(l, c) = sum_gradient(l, c) + push(l)*row(k + l, c)
        end do
        do d = 1, c
          e = e + 1
          do l = 1, lane
            sum_hessian(l, e) = sum_hessian(l, e) + part(l)*row(k + l, d)
          end do
        end do
      end do
    end do
    call inertia_matrix(body, hessian)
    momentum = inertia_times(body, delta)
    phi = total(sum_phi)
    change = total(sum_change)
    e = 0
    do c = 1, 6
      phi = phi + delta(c)*momentum(c)
      gradient(c) = momentum(c) + total(sum_gradient(:, c))
      do d = 1, c
        e = e + 1
        hessian(c, d) = hessian(c, d) + total(sum_hessian(:, e))
      end do
    end do
  end subroutine sweep

  !> The t in [0,1] at which phi(delta + t step) is least: the root of an increasing,
  !> piecewise linear derivative, by Newton within a shrinking bracket.
  pure real(wp) function line_minimum(m, n, row, weight, need, body, delta, step) result(t)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: row(m, 6), weight(m), need(m)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: delta(6), step(6)
    real(wp) :: momentum(6), step_momentum(6), low, high, slope, curvature, s, along
    integer :: i, k
    momentum = inertia_times(body, delta)
    step_momentum = inertia_times(body, step)
    low = 0.0_wp
    high = 1.0_wp
    t = 0.5_wp
    do k = 1, 100
      slope = 0.0_wp
      curvature = 0.0_wp
      do i = 1, 6
        slope = slope + step(i)*(momentum(i) + t*step_momentum(i))
        curvature = curvature + step(i)*step_momentum(i)
      end do
      do i = 1, n
        along = row_times(m, row, i, step)
        s = (need(i) + row_times(m, row, i, delta)) + t*along
        if (s <= 0.0_wp) cycle
        slope = slope + weight(i)*s*along
        curvature = curvature + weight(i)*along*along
      end do
      if (slope > 0.0_wp) then
        high = t
      else
        low = t
      end if
      if (high - low <= 1.0e-15_wp .or. .not. abs(slope) > 0.0_wp .or. curvature <= 0.0_wp) return
      s = t - slope/curvature
      if (abs(s - t) <= 1.0e-15_wp) return
      t = merge(s, 0.5_wp*(low + high), s > low .and. s < high)
    end do
  end function line_minimum

  !> j_i at a change of twist.
  pure subroutine impulses_of(m, n, row, weight, need, push_only, delta, impulse)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: row(m, 6), weight(m), need(m), delta(6)
    logical, intent(in) :: push_only
    real(wp), intent(inout) :: impulse(m)
    real(wp) :: s, threshold
    integer :: i
    threshold = merge(0.0_wp, -huge(1.0_wp), push_only)
    do i = 1, n
      s = need(i) + (row(i, 1)*delta(1) + row(i, 2)*delta(2) + row(i, 3)*delta(3) &
                     + row(i, 4)*delta(4) + row(i, 5)*delta(5) + row(i, 6)*delta(6))
      impulse(i) = weight(i)*merge(s, 0.0_wp, s > threshold)
    end do
  end subroutine impulses_of

  !> Velocities gained with the present impulses, and the largest violation of
  !> 0 <= gained - g, 0 <= j, complementary (or gained = g). The body's change of twist
  !> is that of the impulses, so that momentum is kept whatever the solver's error.
  pure subroutine measure(problem, body, n_lane, residual)
    type(impulse_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(out) :: residual
    real(wp) :: delta(6)
    delta = twist_of_impulses(problem, body)
    call measure_arrays(problem%capacity, n_lane, problem%row, problem%weight, problem%inverse_weight, problem%need, &
                        problem%push_only, problem%impulse, delta, problem%gained, residual)
  end subroutine measure

  pure subroutine measure_arrays(m, n, row, weight, inverse_weight, need, push_only, impulse, delta, gained, residual)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: row(m, 6), weight(m), inverse_weight(m), need(m), impulse(m), delta(6)
    logical, intent(in) :: push_only
    real(wp), intent(inout) :: gained(m)
    real(wp), intent(out) :: residual
    real(wp) :: worst(lane), short
    integer :: k, l, i
    worst = 0.0_wp
    do k = 0, n - lane, lane
      do l = 1, lane
        i = k + l
        gained(i) = inverse_weight(i)*impulse(i) - (row(i, 1)*delta(1) + row(i, 2)*delta(2) + row(i, 3)*delta(3) &
                                                    + row(i, 4)*delta(4) + row(i, 5)*delta(5) + row(i, 6)*delta(6))
        short = need(i) - gained(i)
        ! A contact at rest may gain more than it needs, never less.
        short = merge(abs(short), max(0.0_wp, short), impulse(i) > 0.0_wp .or. .not. push_only)
        worst(l) = max(worst(l), merge(short, 0.0_wp, weight(i) > 0.0_wp))
      end do
    end do
    residual = maxval(worst)
  end subroutine measure_arrays

  !> Correct impulses whose velocities are off because m_i s_i cancelled, as it does
  !> against a light target: M dj = missing velocity, on the contacts that push.
  pure subroutine refine(problem, body, n_lane, residual)
    type(impulse_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(out) :: residual
    real(wp) :: gradient(6), hessian(6, 6), l(6, 6), scale(6), phi, change, delta(6), largest
    logical :: ok
    integer :: k, i
    largest = 0.0_wp
    do i = 1, n_lane
      largest = max(largest, merge(abs(problem%need(i)), 0.0_wp, problem%weight(i) > 0.0_wp))
    end do
    do k = 1, max_refinement
      call measure(problem, body, n_lane, residual)
      if (residual <= refine_above*largest) return
      do i = 1, n_lane
        problem%active(i) = merge(problem%weight(i), 0.0_wp, abs(problem%impulse(i)) > 0.0_wp)
        problem%short(i) = problem%need(i) - problem%gained(i)
      end do
      delta = 0.0_wp
      call sweep(problem%capacity, n_lane, problem%row, problem%active, problem%short, body, .false., delta, &
                 problem%held, gradient, hessian, phi, change)
      call factor_symmetric(hessian, l, scale, ok)
      if (.not. ok) return
      call solve_symmetric(l, scale, -gradient, delta)
      do i = 1, n_lane
        problem%impulse(i) = problem%impulse(i) + problem%active(i)* &
                             (problem%short(i) + row_times(problem%capacity, problem%row, i, delta))
        if (problem%push_only) problem%impulse(i) = max(0.0_wp, problem%impulse(i))
      end do
    end do
    call measure(problem, body, n_lane, residual)
  end subroutine refine

  !> Change of the body's twist by the impulses' reaction, -H B^T j, inertial axes.
  pure function twist_of_impulses(problem, body) result(delta)
    type(impulse_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: delta(6), sums(lane, 6), momentum(6)
    integer :: k, l, c, n_lane
    delta = 0.0_wp
    if (.not. body%free) return
    n_lane = ((problem%n + lane - 1)/lane)*lane
    sums = 0.0_wp
    do k = 0, n_lane - lane, lane
      do c = 1, 6
        do l = 1, lane
          sums(l, c) = sums(l, c) + problem%impulse(k + l)*problem%row(k + l, c)
        end do
      end do
    end do
    do c = 1, 6
      momentum(c) = total(sums(:, c))
    end do
    delta = -inverse_inertia_times(body, momentum)
  end function twist_of_impulses

  !> b_i . delta.
  pure real(wp) function row_times(m, row, i, delta)
    integer, intent(in) :: m, i
    real(wp), intent(in) :: row(m, 6), delta(6)
    row_times = row(i, 1)*delta(1) + row(i, 2)*delta(2) + row(i, 3)*delta(3) &
                + row(i, 4)*delta(4) + row(i, 5)*delta(5) + row(i, 6)*delta(6)
  end function row_times

  !> The partial sums, from the first to the last.
  pure real(wp) function total(sums)
    real(wp), intent(in) :: sums(lane)
    total = ((sums(1) + sums(2)) + (sums(3) + sums(4))) + ((sums(5) + sums(6)) + (sums(7) + sums(8)))
  end function total

  !> H^-1 u: momentum and angular momentum of a twist.
  pure function inertia_times(body, u) result(p)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: u(6)
    real(wp) :: p(6)
    p(1) = body%mass*u(1)
    p(2) = body%mass*u(2)
    p(3) = body%mass*u(3)
    p(4) = body%inertia(1, 1)*u(4) + body%inertia(1, 2)*u(5) + body%inertia(1, 3)*u(6)
    p(5) = body%inertia(2, 1)*u(4) + body%inertia(2, 2)*u(5) + body%inertia(2, 3)*u(6)
    p(6) = body%inertia(3, 1)*u(4) + body%inertia(3, 2)*u(5) + body%inertia(3, 3)*u(6)
  end function inertia_times

  !> H p: twist of a momentum and angular momentum; zero for a fixed body.
  pure function inverse_inertia_times(body, p) result(u)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: p(6)
    real(wp) :: u(6)
    u(1) = body%inverse_mass*p(1)
    u(2) = body%inverse_mass*p(2)
    u(3) = body%inverse_mass*p(3)
    u(4) = body%inverse_inertia(1, 1)*p(4) + body%inverse_inertia(1, 2)*p(5) + body%inverse_inertia(1, 3)*p(6)
    u(5) = body%inverse_inertia(2, 1)*p(4) + body%inverse_inertia(2, 2)*p(5) + body%inverse_inertia(2, 3)*p(6)
    u(6) = body%inverse_inertia(3, 1)*p(4) + body%inverse_inertia(3, 2)*p(5) + body%inverse_inertia(3, 3)*p(6)
  end function inverse_inertia_times

  !> H^-1 as a matrix.
  pure subroutine inertia_matrix(body, a)
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(out) :: a(6, 6)
    a = 0.0_wp
    a(1, 1) = body%mass
    a(2, 2) = body%mass
    a(3, 3) = body%mass
    a(4:6, 4:6) = body%inertia
  end subroutine inertia_matrix

end module castnet_impulse_solver
