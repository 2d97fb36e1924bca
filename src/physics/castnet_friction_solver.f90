!> Impulses of many node contacts at once with Coulomb friction, in the 6 x 6 form of
!> castnet_friction_problem.
!>
!> Newton's method with the exact derivative, and a step that is cut until |F| falls.
!> Friction's bound follows the normal impulse, so that F is no gradient; where Newton
!> stalls, castnet_friction_path leads it near a zero.
module castnet_friction_solver
  use castnet_kinds, only: wp
  use castnet_contact_list, only: body_inertia_t
  use castnet_friction_path, only: friction_path_t, begin_path, refine_path
  use castnet_friction_problem, only: friction_problem_t, pad, largest_speed, law, reaction, velocity_at, cone_derivative, sweep
  use castnet_six_by_six, only: solve_general
  implicit none
  private
  public :: solve_friction

  integer, parameter :: max_newton = 60
  integer, parameter :: max_cut = 30
  integer, parameter :: max_path = 80
  integer, parameter :: max_correction = 3
  !> A solve with a larger residual has not converged, of the largest speed [-].
  real(wp), parameter :: accept_below = 1.0e-10_wp
  !> Where Newton's method stalls at a residual below this it stalls in rounding, of the largest speed [-].
  real(wp), parameter :: enough_below = 1.0e-12_wp
  !> Residual above which impulses that cancelled are corrected, of the largest speed [-].
  real(wp), parameter :: correct_above = 1.0e-13_wp
  !> Velocities are found to this part of the largest one [-].
  real(wp), parameter :: tolerance = 1.0e-14_wp

contains

  !> Impulses of every contact. `residual` is the largest difference between a contact's
  !> impulse and its law at the velocities that the impulses give, over its mass [m/s].
  pure subroutine solve_friction(problem, body, iterations, residual, converged, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual
    logical, intent(out) :: converged
    real(wp), intent(out) :: twist(6)       !! change of the body's twist, inertial axes
    real(wp) :: delta(6), largest
    integer :: n_lane
    logical :: found
    call pad(problem, n_lane)
    largest = largest_speed(problem)
    delta = 0.0_wp
    iterations = 0
    found = .true.
    if (body%free .and. largest > 0.0_wp) call newton(problem, body, n_lane, delta, iterations, found)
    call settle(problem, body, n_lane, delta, largest, iterations, residual, twist)
    if (.not. found .and. residual > enough_below*largest + rounding(problem, body)) then
      ! Stalled, and not in rounding.
      call follow_path(problem, body, n_lane, delta, iterations)
      call settle(problem, body, n_lane, delta, largest, iterations, residual, twist)
    end if
    ! The law decides, not the search: it may end in rounding and still be right.
    converged = residual <= accept_below*largest + rounding(problem, body)
  end subroutine solve_friction

  !> The impulses at `delta`, corrected where rounding grew in them, and how far they are
  !> from their law.
  pure subroutine settle(problem, body, n_lane, delta, largest, iterations, residual, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(in) :: delta(6), largest
    integer, intent(inout) :: iterations
    real(wp), intent(out) :: residual
    real(wp), intent(out) :: twist(6)       !! change of the body's twist, inertial axes
    real(wp) :: before
    integer :: k
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
  end subroutine settle

  !> What rounding of the impulses may leave of the law [m/s]: nothing to speak of, but for
  !> nodes some 1e4 times heavier than the body.
  pure real(wp) function rounding(problem, body) result(left)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: push, turn, far, r, j
    integer :: i
    push = 0.0_wp
    turn = 0.0_wp
    far = 0.0_wp
    do i = 1, problem%n
      j = abs(problem%impulse(i, 1)) + abs(problem%impulse(i, 2)) + abs(problem%impulse(i, 3))
      r = abs(problem%arm(i, 1)) + abs(problem%arm(i, 2)) + abs(problem%arm(i, 3))
      push = push + j
      turn = turn + r*j
      far = max(far, r)
    end do
    push = body%inverse_mass*push + far*turn*maxval(abs(body%inverse_inertia))
    left = epsilon(1.0_wp)*(1.0_wp + problem%friction)*push
  end function rounding

  !> From zeros of the interpolated F, each nearer than the last, Newton's method to the
  !> true one.
  pure subroutine follow_path(problem, body, n_lane, delta, iterations)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(inout) :: delta(6)
    integer, intent(inout) :: iterations
    type(friction_path_t) :: path
    real(wp) :: trial(6)
    logical :: ok
    integer :: k
    call begin_path(path, problem, body)
    do k = 1, max_path
      call refine_path(path, problem, body, trial, ok)
      if (.not. ok) cycle
      delta = trial
      call newton(problem, body, n_lane, trial, iterations, ok)
      if (.not. ok) cycle
      delta = trial
      return
    end do
  end subroutine follow_path

  !> Newton's method on F.
  pure subroutine newton(problem, body, n_lane, delta, iterations, converged)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: n_lane
    real(wp), intent(inout) :: delta(6)
    integer, intent(inout) :: iterations
    logical, intent(out) :: converged
    real(wp) :: f(6), jacobian(6, 6), trial_f(6), trial_jacobian(6, 6), step(6), trial(6), size, trial_size, t, scale
    logical :: ok
    integer :: k, cut
    converged = .false.
    call sweep(problem%capacity, n_lane, problem%normal, problem%arm, problem%velocity, problem%mass, problem%rebound, &
               problem%friction, problem%push_only, body, delta, f, jacobian, scale)
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
                   problem%friction, problem%push_only, body, trial, trial_f, trial_jacobian, scale)
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
               problem%friction, problem%push_only, body, twist, f, jacobian, scale)
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

end module castnet_friction_solver
