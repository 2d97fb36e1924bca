!> From a list of contacts to their impulses: what each contact must gain, which
!> solver finds it, and the rule that no event creates energy.
!>
!> `equality` (the paper's): approaching contacts only, v+ = -e v-, impulses of any
!> sign. `push_only`: 0 <= j, 0 <= v+ + e min(v-, 0), j (v+ + e min(v-, 0)) = 0 for
!> every contact in the list. Friction adds |j_t| <= mu j, sliding against v_t+.
!>
!> Newton's restitution applied to several contacts at once can create energy: a
!> contact that was parting slowly is pushed by its neighbour's rebound, and with
!> friction a single spinning body can (Kane's paradox). With e = 0 it cannot: then
!> j.v+ <= 0 at every contact, and the change of energy is sum j.v+ - j.M j/2. So the
!> event takes the largest e up to the scene's at which the kinetic energy does not grow
!> (and at which the solver finds an answer, which without friction it always does).
module castnet_contact_response
  use castnet_kinds, only: wp
  use castnet_model, only: contact_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t, lane
  use castnet_impulse_solver, only: impulse_problem_t, reserve_problem, solve_single, solve_reduced, measure, pad, &
                                    twist_of_impulses
  use castnet_friction_problem, only: friction_problem_t, reserve_friction
  use castnet_friction_solver, only: solve_friction
  use castnet_coupled_friction, only: coupled_work_t, reserve_coupled, solve_coupled_friction
  use castnet_contact_groups, only: contact_groups_t, reserve_groups, find_groups
  use castnet_coupled_solver, only: coupled_solver_t, reserve_coupled_solver, solve_coupled
  use castnet_dense_impulse, only: solve_dense
  use castnet_contact_projection, only: set_depths, mass_of
  implicit none
  private
  public :: contact_solver_t, reserve_solver, resolve_contacts, resolve_depths

  !> A gain of kinetic energy below this part of the work of all impulses is rounding [-].
  real(wp), parameter :: energy_rounding = 1.0e-13_wp
  integer, parameter :: max_trial = 60
  real(wp), parameter :: nearly = 1.0e-2_wp   !! residual of an event that is kept unconverged, of the largest speed [-]
  integer, parameter :: max_unsolved = 4      !! coefficients tried without an answer before the search gives up

  !> The solvers' scratch.
  type :: contact_solver_t
    type(impulse_problem_t) :: normal      !! without friction; also the projection's
    type(friction_problem_t) :: friction
    type(coupled_solver_t) :: pivoting     !! contacts that share nodes, without friction
    type(coupled_work_t) :: coupled        !! contacts that share nodes, with
    type(contact_groups_t) :: groups       !! of the present list, where they may be coupled
    logical :: coupled_contacts = .false.  !! of the present list: nodes are shared
  end type contact_solver_t

contains

  !> Room for a list on a net of `n_node` nodes.
  subroutine reserve_solver(solver, list, n_node, contact)
    type(contact_solver_t), intent(inout) :: solver
    type(contact_list_t), intent(in) :: list
    integer, intent(in) :: n_node
    type(contact_t), intent(in) :: contact
    call reserve_problem(solver%normal, list%capacity)
    if (contact%friction > 0.0_wp) call reserve_friction(solver%friction, list%capacity)
    if (contact%friction > 0.0_wp .and. contact%detect_cables) call reserve_coupled(solver%coupled, list%capacity, n_node)
    if (.not. contact%detect_cables) return
    call reserve_groups(solver%groups, list%capacity, n_node)
    call reserve_coupled_solver(solver%pivoting, list%capacity, n_node)
  end subroutine reserve_solver

  !> Impulses of every contact, into `list%impulse` and `list%friction_impulse`, and the
  !> body's change of twist, into the report; to apply them is the caller's.
  subroutine resolve_contacts(contact, body, list, solver, report)
    type(contact_t), intent(in) :: contact
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(inout) :: list
    type(contact_solver_t), intent(inout) :: solver
    type(impulse_report_t), intent(out) :: report
    type(contact_t) :: frictionless
    real(wp) :: low, high, e, low_loss, high_loss, work, residual
    integer :: trial, iterations, unsolved
    call reserve_solver(solver, list, maxval(max(list%node_a(1:list%n), list%node_b(1:list%n))), contact)
    call set_rows(list, solver%normal)
    solver%coupled_contacts = .false.
    if (contact%detect_cables) then
      ! For every solve of this list, the projection's too.
      call find_groups(list, solver%groups)
      solver%coupled_contacts = solver%groups%n_group < list%n
    end if
    call attempt(contact, body, list, solver, contact%restitution, report, work)
    if (report%energy_loss >= -energy_rounding*work .and. (report%converged .or. nearly_solved(list, solver, report))) return
    high = contact%restitution
    high_loss = report%energy_loss
    iterations = report%iterations
    unsolved = merge(0, 1, report%converged)
    low = 0.0_wp
    call attempt(contact, body, list, solver, low, report, work)
    low_loss = report%energy_loss
    iterations = iterations + report%iterations
    do trial = 1, max_trial
      if (high - low <= 1.0e-6_wp*high) exit
      ! The loss is concave in e on one set of pushing contacts: the chord's root is on
      ! the safe side, and as a rule the first one will do.
      e = min(max(low_loss, 0.0_wp)/max(low_loss - high_loss, tiny(1.0_wp)), 1.0_wp - 1.0e-12_wp)
      if (trial > 6) e = 0.5_wp
      e = low + (high - low)*e
      call attempt(contact, body, list, solver, e, report, work)
      iterations = iterations + report%iterations
      if (.not. report%converged) unsolved = unsolved + 1
      if (unsolved > max_unsolved) exit
      if (report%energy_loss < 0.0_wp .or. .not. report%converged) then
        high = e
        high_loss = report%energy_loss
      else
        low = e
        low_loss = report%energy_loss
        if (low_loss <= 1.0e-3_wp*work) exit
      end if
    end do
    if (abs(report%restitution - low) > 0.0_wp) then
      call attempt(contact, body, list, solver, low, report, work)
      iterations = iterations + report%iterations
    end if
    if (report%energy_loss < -energy_rounding*work .or. .not. report%converged) then
      ! A solve that did not converge: without friction there is one, and it never creates energy.
      frictionless = contact
      frictionless%friction = 0.0_wp
      residual = report%residual
      list%friction_impulse(1:list%n, :) = 0.0_wp
      call attempt(frictionless, body, list, solver, 0.0_wp, report, work)
      iterations = iterations + report%iterations
      ! Never silently: what is reported is how far the law with friction was from being met.
      report%residual = max(residual, report%residual)
      report%converged = .false.
    end if
    report%iterations = iterations
  end subroutine resolve_contacts

  !> Is a coupled event with friction that did not converge near enough to be kept? Its
  !> residual is reported; another restitution or no friction would be farther off.
  pure logical function nearly_solved(list, solver, report)
    type(contact_list_t), intent(in) :: list
    type(contact_solver_t), intent(in) :: solver
    type(impulse_report_t), intent(in) :: report
    real(wp) :: largest
    integer :: i
    nearly_solved = .false.
    if (.not. solver%coupled_contacts) return
    largest = 0.0_wp
    do i = 1, list%n
      largest = max(largest, abs(list%velocity(i, 1)), abs(list%velocity(i, 2)), abs(list%velocity(i, 3)))
    end do
    nearly_solved = report%residual <= nearly*largest
  end function nearly_solved

  !> Displacements that bring every contact with a negative gap back to the surface, as
  !> mass times displacement of each pair in `solver%normal%impulse` [kg m], and the
  !> body's: translation [m] and rotation vector [rad], inertial axes.
  subroutine resolve_depths(body, list, solver, shift)
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(in) :: list
    type(contact_solver_t), intent(inout) :: solver
    real(wp), intent(out) :: shift(6)
    real(wp) :: residual
    integer :: iterations
    logical :: converged
    call set_rows(list, solver%normal)
    call set_depths(list, solver%normal)
    call solve_normal(.false., body, list, solver, iterations, residual, converged)
    shift = twist_of_impulses(solver%normal, body)
  end subroutine resolve_depths

  !> Rows b_i = [n, r x n] and the effective masses of the contact points.
  pure subroutine set_rows(list, problem)
    type(contact_list_t), intent(in) :: list
    type(impulse_problem_t), intent(inout) :: problem
    integer :: i
    problem%n = list%n
    do i = 1, list%n
      problem%row(i, 1) = list%normal(i, 1)
      problem%row(i, 2) = list%normal(i, 2)
      problem%row(i, 3) = list%normal(i, 3)
      problem%row(i, 4) = list%arm(i, 2)*list%normal(i, 3) - list%arm(i, 3)*list%normal(i, 2)
      problem%row(i, 5) = list%arm(i, 3)*list%normal(i, 1) - list%arm(i, 1)*list%normal(i, 3)
      problem%row(i, 6) = list%arm(i, 1)*list%normal(i, 2) - list%arm(i, 2)*list%normal(i, 1)
      problem%inverse_weight(i) = list%weight_a(i)*list%weight_a(i)*list%inverse_mass_a(i) &
                                  + list%share(i)*list%share(i)*list%inverse_mass_b(i)
    end do
  end subroutine set_rows

  !> Solve with one coefficient of restitution; impulses into the list.
  subroutine attempt(contact, body, list, solver, e, report, work)
    type(contact_t), intent(in) :: contact
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(inout) :: list
    type(contact_solver_t), intent(inout) :: solver
    real(wp), intent(in) :: e
    type(impulse_report_t), intent(inout) :: report
    real(wp), intent(out) :: work  !! sum |j.(v- + v+)/2| and alike, what rounding is measured against [J]
    call set_needs(list, contact%push_only, e, solver%normal)
    report%restitution = e
    if (contact%friction > 0.0_wp) then
      call set_friction(list, contact, e, solver%normal, solver%friction)
      call solve_tangential(body, list, solver, report)
      call take_friction(solver%friction, list, report%energy_loss, work)
    else
      call solve_normal(contact%dense, body, list, solver, report%iterations, report%residual, report%converged)
      report%twist = twist_of_impulses(solver%normal, body)
      call take_normal(solver%normal, list, report%energy_loss, work)
    end if
  end subroutine attempt

  !> The solver with friction that fits: the 6 x 6 form where every contact has a mass of
  !> its own; else contacts coupled through nodes.
  subroutine solve_tangential(body, list, solver, report)
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(in) :: list
    type(contact_solver_t), intent(inout) :: solver
    type(impulse_report_t), intent(inout) :: report
    if (.not. (has_fixed_point(solver%normal) .or. solver%coupled_contacts)) then
      call solve_friction(solver%friction, body, report%iterations, report%residual, report%converged, report%twist)
      return
    end if
    call reserve_coupled(solver%coupled, list%capacity, maxval(max(list%node_a(1:list%n), list%node_b(1:list%n))))
    if (.not. solver%coupled_contacts) then
      call reserve_groups(solver%groups, list%capacity, maxval(max(list%node_a(1:list%n), list%node_b(1:list%n))))
      call find_groups(list, solver%groups)
    end if
    call solve_coupled_friction(solver%friction, list, solver%groups, body, solver%coupled, report%iterations, &
                                report%residual, report%converged, report%twist)
  end subroutine solve_tangential

  !> The frictionless solver that fits. Fixed nodes on a free target have no mass to put
  !> into the reduced form; and where that form's search does not end, pivoting does.
  subroutine solve_normal(dense, body, list, solver, iterations, residual, converged)
    logical, intent(in) :: dense
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(in) :: list
    type(contact_solver_t), intent(inout) :: solver
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual
    logical, intent(out) :: converged
    integer :: n_lane
    logical :: go_dense
    associate (problem => solver%normal)
      if (problem%n == 1) then
        call solve_single(problem, body)
        call pad(problem, n_lane)
        call measure(problem, body, n_lane, residual)
        iterations = 1
        converged = .true.
        return
      end if
      go_dense = dense .or. has_fixed_point(problem)
      if (.not. go_dense) then
        if (solver%coupled_contacts) then
          call solve_coupled(problem, list, solver%groups, body, solver%pivoting, iterations, residual, converged)
          call pad(problem, n_lane)
        else
          call solve_reduced(problem, body, iterations, residual, converged)
        end if
        go_dense = .not. converged
      end if
      if (go_dense) call solve_dense(problem, list, body, iterations, residual, converged)
    end associate
  end subroutine solve_normal

  !> Is any contact's point held by fixed nodes only?
  pure logical function has_fixed_point(problem)
    type(impulse_problem_t), intent(in) :: problem
    integer :: i
    has_fixed_point = .false.
    do i = 1, problem%n
      has_fixed_point = has_fixed_point .or. problem%inverse_weight(i) <= 0.0_wp
    end do
  end function has_fixed_point

  !> The normal velocity that each contact has to gain, and which contacts count.
  pure subroutine set_needs(list, push_only, e, problem)
    type(contact_list_t), intent(in) :: list
    logical, intent(in) :: push_only
    real(wp), intent(in) :: e
    type(impulse_problem_t), intent(inout) :: problem
    real(wp) :: mass
    integer :: i
    problem%push_only = push_only
    do i = 1, list%n
      mass = mass_of(problem%inverse_weight(i))
      if (push_only) then
        problem%need(i) = -e*min(list%normal_velocity(i), 0.0_wp) - list%normal_velocity(i)
        problem%weight(i) = mass
      else
        problem%need(i) = -(1.0_wp + e)*list%normal_velocity(i)
        problem%weight(i) = merge(mass, 0.0_wp, list%normal_velocity(i) < 0.0_wp)
      end if
    end do
  end subroutine set_needs

  !> The same contacts with their tangential motion.
  pure subroutine set_friction(list, contact, e, normal, problem)
    type(contact_list_t), intent(in) :: list
    type(contact_t), intent(in) :: contact
    real(wp), intent(in) :: e
    type(impulse_problem_t), intent(in) :: normal
    type(friction_problem_t), intent(inout) :: problem
    integer :: i, c
    problem%n = list%n
    problem%push_only = contact%push_only
    problem%friction = contact%friction
    do c = 1, 3
      do i = 1, list%n
        problem%normal(i, c) = list%normal(i, c)
        problem%arm(i, c) = list%arm(i, c)
        problem%velocity(i, c) = list%velocity(i, c)
      end do
    end do
    do i = 1, list%n
      problem%mass(i) = normal%weight(i)
      problem%rebound(i) = -e*min(list%normal_velocity(i), 0.0_wp)
    end do
  end subroutine set_friction

  !> Impulses into the list; the kinetic energy that they take away, -sum j (v- + v+)/2:
  !> the work of an impulse is its product with the mean velocity.
  pure subroutine take_normal(problem, list, loss, work)
    type(impulse_problem_t), intent(in) :: problem
    type(contact_list_t), intent(inout) :: list
    real(wp), intent(out) :: loss, work
    real(wp) :: term
    integer :: i
    loss = 0.0_wp
    work = 0.0_wp
    do i = 1, list%n
      term = problem%impulse(i)*(list%normal_velocity(i) + 0.5_wp*problem%gained(i))
      loss = loss - term
      work = work + problem%impulse(i)*problem%impulse(i)*problem%inverse_weight(i) + abs(term)
      list%impulse(i) = problem%impulse(i)
    end do
  end subroutine take_normal

  pure subroutine take_friction(problem, list, loss, work)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(inout) :: list
    real(wp), intent(out) :: loss, work
    real(wp) :: term, j(3)
    integer :: i
    loss = 0.0_wp
    work = 0.0_wp
    do i = 1, list%n
      j = problem%impulse(i, :)
      term = 0.5_wp*(j(1)*(list%velocity(i, 1) + problem%after(i, 1)) + j(2)*(list%velocity(i, 2) + problem%after(i, 2)) &
                     + j(3)*(list%velocity(i, 3) + problem%after(i, 3)))
      loss = loss - term
      work = work + (j(1)*j(1) + j(2)*j(2) + j(3)*j(3))/max(problem%mass(i), tiny(1.0_wp)) + abs(term)
      list%impulse(i) = j(1)*list%normal(i, 1) + j(2)*list%normal(i, 2) + j(3)*list%normal(i, 3)
      if (problem%push_only) list%impulse(i) = max(0.0_wp, list%impulse(i))
      list%friction_impulse(i, 1) = j(1) - list%impulse(i)*list%normal(i, 1)
      list%friction_impulse(i, 2) = j(2) - list%impulse(i)*list%normal(i, 2)
      list%friction_impulse(i, 3) = j(3) - list%impulse(i)*list%normal(i, 3)
    end do
  end subroutine take_friction

end module castnet_contact_response
