!> From a list of contacts to their impulses: what each contact must gain, which
!> solver finds it, and the rule that no event creates energy.
!>
!> `equality` (the paper's): approaching contacts only, v+ = -e v-, impulses of any
!> sign. `push_only`: 0 <= j, 0 <= v+ + e min(v-, 0), j (v+ + e min(v-, 0)) = 0 for
!> every contact in the list.
!>
!> Newton's restitution applied to several contacts at once can create energy: a
!> contact that was parting slowly is pushed by its neighbour's rebound. With e = 0 it
!> cannot (v+ is then a projection of v-), so the event takes the largest e up to the
!> scene's at which the kinetic energy does not grow.
module castnet_contact_response
  use castnet_kinds, only: wp
  use castnet_model, only: contact_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t
  use castnet_impulse_solver, only: impulse_problem_t, reserve_problem, solve_single, solve_reduced, measure, pad
  use castnet_dense_impulse, only: solve_dense
  use castnet_contact_projection, only: set_depths, mass_of
  implicit none
  private
  public :: resolve_contacts, resolve_depths

  !> A gain of kinetic energy below this part of the work of all impulses is rounding [-].
  real(wp), parameter :: energy_rounding = 1.0e-13_wp
  integer, parameter :: max_trial = 40

contains

  !> Impulses of every contact, into `list%impulse` and `list%friction_impulse`; what
  !> they do to net and target is the caller's.
  subroutine resolve_contacts(contact, body, list, problem, report)
    type(contact_t), intent(in) :: contact
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(inout) :: list
    type(impulse_problem_t), intent(inout) :: problem
    type(impulse_report_t), intent(out) :: report
    real(wp) :: low, high, e, low_loss, high_loss, work
    integer :: trial, iterations
    call reserve_problem(problem, list%capacity)
    call set_rows(list, problem)
    call attempt(contact, body, list, problem, contact%restitution, report, work)
    if (report%energy_loss < -energy_rounding*work) then
      high = contact%restitution
      high_loss = report%energy_loss
      iterations = report%iterations
      call attempt(contact, body, list, problem, 0.0_wp, report, work)
      iterations = iterations + report%iterations
      low = 0.0_wp
      low_loss = report%energy_loss
      do trial = 1, max_trial
        if (high - low <= 1.0e-3_wp*high) exit
        ! The loss is concave in e on one set of pushing contacts: the chord's root is on
        ! the safe side, and as a rule the first one will do.
        e = min(low_loss/max(low_loss - high_loss, tiny(1.0_wp)), 1.0_wp - 1.0e-12_wp)
        if (trial > 4) e = 0.5_wp
        e = low + (high - low)*e
        call attempt(contact, body, list, problem, e, report, work)
        iterations = iterations + report%iterations
        if (report%energy_loss < 0.0_wp) then
          high = e
          high_loss = report%energy_loss
        else
          low = e
          low_loss = report%energy_loss
          if (low_loss <= 1.0e-3_wp*work) exit
        end if
      end do
      if (report%restitution > low .or. report%restitution < low) then
        call attempt(contact, body, list, problem, low, report, work)
        iterations = iterations + report%iterations
      end if
      report%iterations = iterations
    end if
    list%impulse(1:list%n) = problem%impulse(1:list%n)
  end subroutine resolve_contacts

  !> Displacements that bring every contact with a negative gap back to the surface, as
  !> mass times displacement of each pair in `problem%impulse` [kg m].
  subroutine resolve_depths(body, list, problem)
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(in) :: list
    type(impulse_problem_t), intent(inout) :: problem
    real(wp) :: residual
    integer :: iterations
    logical :: converged
    call set_rows(list, problem)
    call set_depths(list, problem)
    call solve(.false., body, list, problem, iterations, residual, converged)
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

  !> Solve with one coefficient of restitution.
  subroutine attempt(contact, body, list, problem, e, report, work)
    type(contact_t), intent(in) :: contact
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(in) :: list
    type(impulse_problem_t), intent(inout) :: problem
    real(wp), intent(in) :: e
    type(impulse_report_t), intent(inout) :: report
    real(wp), intent(out) :: work  !! sum |j (v- + v+)/2| [J]
    call set_needs(list, contact%push_only, e, problem)
    call solve(contact%dense, body, list, problem, report%iterations, report%residual, report%converged)
    report%restitution = e
    call work_of_impulses(list, problem, report%energy_loss, work)
  end subroutine attempt

  !> The solver that fits the problem. Fixed nodes on a free target have no mass to put
  !> into the reduced form; and where that form's search does not end, pivoting does.
  subroutine solve(dense, body, list, problem, iterations, residual, converged)
    logical, intent(in) :: dense
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(in) :: list
    type(impulse_problem_t), intent(inout) :: problem
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual
    logical, intent(out) :: converged
    integer :: n_lane
    logical :: go_dense
    if (problem%n == 1) then
      call solve_single(problem, body)
      call pad(problem, n_lane)
      call measure(problem, body, n_lane, residual)
      iterations = 1
      converged = .true.
      return
    end if
    go_dense = dense .or. any(problem%inverse_weight(1:problem%n) <= 0.0_wp)
    if (.not. go_dense) then
      call solve_reduced(problem, body, iterations, residual, converged)
      go_dense = .not. converged
    end if
    if (go_dense) call solve_dense(problem, list, body, iterations, residual, converged)
  end subroutine solve

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

  !> Kinetic energy that the impulses take away, -sum j (v- + v+)/2. Exact for any
  !> masses: the work of an impulse is its product with the mean velocity.
  pure subroutine work_of_impulses(list, problem, loss, work)
    type(contact_list_t), intent(in) :: list
    type(impulse_problem_t), intent(in) :: problem
    real(wp), intent(out) :: loss, work
    real(wp) :: term
    integer :: i
    loss = 0.0_wp
    work = 0.0_wp
    do i = 1, list%n
      term = problem%impulse(i)*(list%normal_velocity(i) + 0.5_wp*problem%gained(i))
      loss = loss - term
      work = work + problem%impulse(i)*problem%impulse(i)*problem%inverse_weight(i) + abs(term)
    end do
  end subroutine work_of_impulses

end module castnet_contact_response
