!> Normal impulses of contacts that act on each other through common nodes, as contacts
!> of cables do: M = A + B H B^T with A = C W C^T sparse, W = diag(1/m_node).
!>
!> As for single nodes (castnet_impulse_solver), everything hangs on the body's change of
!> twist delta: given it, the contacts fall into groups joined by common nodes, each a
!> small complementarity problem 0 <= j, 0 <= A j - s, s = g + B delta, and the six
!> equations H^-1 delta + B^T j(delta) = 0 are again the gradient of a convex, piecewise
!> quadratic function. A group is solved by block principal pivoting, its matrix factored
!> within its envelope; a factor is kept until a contact of its group begins or ceases to
!> push.
!>
!> A may be singular (two nodes and their cable on one face); a hair on its diagonal makes
!> it regular and moves velocities by 1e-12 of themselves, below what is asked for.
module castnet_coupled_solver
  use castnet_kinds, only: wp
  use castnet_contact_groups, only: contact_groups_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t
  use castnet_impulse_solver, only: impulse_problem_t, inverse_inertia_times, inertia_times, inertia_matrix
  use castnet_six_by_six, only: factor_symmetric, solve_symmetric
  implicit none
  private
  public :: coupled_solver_t, reserve_coupled_solver, solve_coupled

  real(wp), parameter :: hair = 1.0e-12_wp          !! on the diagonal of A, of itself [-]
  real(wp), parameter :: wrong_below = 1.0e-13_wp   !! slack below which an idle contact is violated, of the largest need [-]
  !> Residual above which impulses are refined, and above which they are no answer, of the largest need [-].
  real(wp), parameter :: refine_above = 1.0e-11_wp, accept_below = 1.0e-10_wp
  integer, parameter :: max_newton = 60
  integer, parameter :: max_refinement = 3

  !> Everything by position along the groups.
  type :: coupled_solver_t
    integer, allocatable :: row_start(:)            !! (capacity+1) where row p begins in `matrix`
    logical, allocatable :: counts(:), pushes(:)    !! (capacity)
    logical, allocatable :: factored(:), halved(:)  !! (capacity) groups whose factor, whose y is of the present set
    real(wp), allocatable :: matrix(:), factor(:)   !! rows' envelopes
    real(wp), allocatable :: need(:), s(:), j(:), slack(:) !! (capacity)
    real(wp), allocatable :: row(:, :)              !! (6,capacity) rows of B
    real(wp), allocatable :: y(:, :)                !! (6,capacity) L^-1 B
    real(wp), allocatable :: change(:, :)           !! (3,nodes of the net) change of velocity [m/s]
  end type coupled_solver_t

contains

  !> Room for `capacity` contacts on a net of `n_node` nodes.
  subroutine reserve_coupled_solver(work, capacity, n_node)
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: capacity, n_node
    if (allocated(work%change)) then
      if (size(work%change, 2) < n_node) deallocate (work%change)
    end if
    if (.not. allocated(work%change)) allocate (work%change(3, n_node), source=0.0_wp)
    if (allocated(work%pushes)) then
      if (size(work%pushes) >= capacity) return
      deallocate (work%row_start, work%counts, work%pushes, work%factored, work%halved, work%need, work%s, work%j, &
                  work%slack, work%row, work%y)
    end if
    allocate (work%row_start(capacity + 1), source=0)
    allocate (work%counts(capacity), work%pushes(capacity), work%factored(capacity), work%halved(capacity), source=.false.)
    allocate (work%need(capacity), work%s(capacity), work%j(capacity), work%slack(capacity), source=0.0_wp)
    allocate (work%row(6, capacity), work%y(6, capacity), source=0.0_wp)
  end subroutine reserve_coupled_solver

  !> Impulses of the whole list; `problem` as for the reduced form, `groups` of this list.
  !> Contacts with weight 0 are left out.
  subroutine solve_coupled(problem, list, groups, body, work, iterations, residual, converged)
    type(impulse_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual
    logical, intent(out) :: converged
    real(wp) :: delta(6), largest
    integer :: i, k
    largest = 0.0_wp
    do i = 1, list%n
      if (problem%weight(i) > 0.0_wp) largest = max(largest, abs(problem%need(i)))
    end do
    call gather(problem, list, groups, work)
    call assemble(list, groups, work)
    call search(problem%push_only, groups, body, work, largest, delta, iterations, converged)
    do k = 1, list%n
      problem%impulse(groups%order(k)) = work%j(k)
    end do
    do k = 1, max_refinement
      call measure_coupled(problem, list, body, work, residual)
      if (residual <= refine_above*largest) exit
      call refine(problem, groups, body, work)
    end do
    if (k > max_refinement) call measure_coupled(problem, list, body, work, residual)
    converged = converged .and. residual <= accept_below*largest
  end subroutine solve_coupled

  !> The problem by position, and the first guess of who pushes.
  subroutine gather(problem, list, groups, work)
    type(impulse_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer :: p, i, c, length
    length = 0
    do p = 1, list%n
      i = groups%order(p)
      do c = 1, 6
        work%row(c, p) = problem%row(i, c)
      end do
      work%need(p) = problem%need(i)
      work%counts(p) = problem%weight(i) > 0.0_wp
      work%pushes(p) = work%counts(p) .and. (work%need(p) > 0.0_wp .or. .not. problem%push_only)
      work%row_start(p) = length + 1
      length = length + p - groups%first(p) + 1
    end do
    work%row_start(list%n + 1) = length + 1
    work%factored(1:groups%n_group) = .false.
    work%halved(1:groups%n_group) = .false.
    if (allocated(work%matrix)) then
      if (size(work%matrix) < length) deallocate (work%matrix, work%factor)
    end if
    if (.not. allocated(work%matrix)) allocate (work%matrix(2*length), work%factor(2*length))
    work%matrix(1:length) = 0.0_wp
  end subroutine gather

  !> A within the envelope of each row.
  pure subroutine assemble(list, groups, work)
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer :: p, i, at
    do p = 1, list%n
      i = groups%order(p)
      call couple(list, groups, work, p, list%node_a(i), list%weight_a(i)*list%inverse_mass_a(i))
      if (list%node_b(i) /= list%node_a(i)) call couple(list, groups, work, p, list%node_b(i), &
                                                        list%share(i)*list%inverse_mass_b(i))
      at = work%row_start(p + 1) - 1
      work%matrix(at) = work%matrix(at)*(1.0_wp + hair)
    end do
  end subroutine assemble

  !> Add to row p what the impulses of contacts at `node` do to contact p through it.
  pure subroutine couple(list, groups, work, p, node, mobility)
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: p, node
    real(wp), intent(in) :: mobility  !! share of the node in contact p over its mass
    real(wp) :: share, cosine
    integer :: entry, k, q, at
    entry = groups%head(node)
    do while (entry /= 0)
      k = abs(entry)
      q = groups%place(k)
      if (q <= p) then
        share = merge(list%weight_a(k), list%share(k), entry > 0)
        cosine = 1.0_wp
        if (q < p) cosine = work%row(1, p)*work%row(1, q) + work%row(2, p)*work%row(2, q) + work%row(3, p)*work%row(3, q)
        at = work%row_start(p) + q - groups%first(p)
        work%matrix(at) = work%matrix(at) + mobility*share*cosine
      end if
      entry = merge(groups%next_a(k), groups%next_b(k), entry > 0)
    end do
  end subroutine couple

  !> Newton's search for the body's change of twist.
  pure subroutine search(push_only, groups, body, work, largest, delta, iterations, converged)
    logical, intent(in) :: push_only
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_solver_t), intent(inout) :: work
    real(wp), intent(in) :: largest
    real(wp), intent(out) :: delta(6)
    integer, intent(out) :: iterations
    logical, intent(out) :: converged
    real(wp) :: gradient(6), hessian(6, 6), trial_gradient(6), step(6), trial(6), phi, trial_phi, t
    real(wp) :: l(6, 6), scale(6)
    logical :: ok, moved
    integer :: cut
    delta = 0.0_wp
    iterations = 1
    call sweep(push_only, groups, body, work, largest, delta, gradient, phi, moved, converged)
    if (.not. body%free .or. .not. converged) return
    do iterations = 1, max_newton
      call curvature(groups, body, work, hessian)
      call factor_symmetric(hessian, l, scale, ok)
      if (.not. ok) exit
      call solve_symmetric(l, scale, -gradient, step)
      t = 1.0_wp
      do cut = 1, 40
        trial = delta + t*step
        call sweep(push_only, groups, body, work, largest, trial, trial_gradient, trial_phi, moved, converged)
        if (.not. converged) return
        ! Where no contact changed sides the full step is exact.
        if (.not. moved .and. cut == 1) then
          delta = trial
          return
        end if
        if (trial_phi < phi) exit
        t = 0.5_wp*t
      end do
      ! No step lowers phi any more: that is rounding.
      if (cut > 40) return
      delta = trial
      gradient = trial_gradient
      phi = trial_phi
    end do
    converged = .false.
  end subroutine search

  !> Every group at `delta`: impulses, F and phi.
  pure subroutine sweep(push_only, groups, body, work, largest, delta, gradient, phi, moved, ok)
    logical, intent(in) :: push_only
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_solver_t), intent(inout) :: work
    real(wp), intent(in) :: largest, delta(6)
    real(wp), intent(out) :: gradient(6), phi
    logical, intent(out) :: moved   !! a contact began or ceased to push
    logical, intent(out) :: ok
    integer :: g, p, c
    logical :: changed
    ok = .true.
    moved = .false.
    do p = 1, groups%start(groups%n_group + 1) - 1
      work%s(p) = work%need(p) + (work%row(1, p)*delta(1) + work%row(2, p)*delta(2) + work%row(3, p)*delta(3) &
                                  + work%row(4, p)*delta(4) + work%row(5, p)*delta(5) + work%row(6, p)*delta(6))
    end do
    gradient = inertia_times(body, delta)
    phi = 0.0_wp
    do c = 1, 6
      phi = phi + delta(c)*gradient(c)
    end do
    do g = 1, groups%n_group
      call solve_group(push_only, groups, work, g, largest, changed, ok)
      if (.not. ok) return
      moved = moved .or. changed
    end do
    do p = 1, groups%start(groups%n_group + 1) - 1
      if (.not. work%pushes(p)) cycle
      phi = phi + work%j(p)*work%s(p)
      do c = 1, 6
        gradient(c) = gradient(c) + work%j(p)*work%row(c, p)
      end do
    end do
  end subroutine sweep

  !> F's derivative on the present sets: H^-1 + sum of y y^T, A = L L^T, L Y = B.
  pure subroutine curvature(groups, body, work, hessian)
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_solver_t), intent(inout) :: work
    real(wp), intent(out) :: hessian(6, 6)  !! lower triangle
    integer :: g, p, c, d
    call inertia_matrix(body, hessian)
    do g = 1, groups%n_group
      if (.not. work%halved(g)) call forward(groups, work, groups%start(g), groups%start(g + 1) - 1)
      work%halved(g) = .true.
    end do
    do p = 1, groups%start(groups%n_group + 1) - 1
      if (.not. work%pushes(p)) cycle
      do c = 1, 6
        do d = c, 6
          hessian(d, c) = hessian(d, c) + work%y(d, p)*work%y(c, p)
        end do
      end do
    end do
  end subroutine curvature

  !> Complementarity of one group: guess who pushes, solve, correct the guess.
  pure subroutine solve_group(push_only, groups, work, g, largest, changed, ok)
    logical, intent(in) :: push_only
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: g
    real(wp), intent(in) :: largest
    logical, intent(out) :: changed, ok
    integer :: first, last, trial, n_wrong, least, patience, p, last_wrong
    first = groups%start(g)
    last = groups%start(g + 1) - 1
    changed = .false.
    ok = .true.
    least = huge(1)
    patience = 10
    do trial = 1, 100 + 20*(last - first + 1)
      if (.not. work%factored(g)) call factor_group(groups, work, first, last, ok)
      if (.not. ok) return
      work%factored(g) = .true.
      call solve_factored(groups, work, first, last)
      if (.not. push_only) return
      call slacks(groups, work, first, last)
      n_wrong = 0
      last_wrong = 0
      do p = first, last
        if (work%pushes(p)) then
          if (.not. work%j(p) < 0.0_wp) cycle
        else
          if (.not. (work%slack(p) < -wrong_below*largest .and. work%counts(p))) cycle
        end if
        n_wrong = n_wrong + 1
        last_wrong = p
        work%slack(p) = huge(1.0_wp)
      end do
      if (n_wrong == 0) return
      changed = .true.
      work%factored(g) = .false.
      work%halved(g) = .false.
      if (n_wrong < least) then
        least = n_wrong
        patience = 10
      else
        patience = patience - 1
      end if
      ! One at a time when all at once does not get anywhere (Murty's rule cannot cycle).
      do p = merge(first, last_wrong, patience > 0), last_wrong
        if (work%slack(p) >= huge(1.0_wp)) work%pushes(p) = .not. work%pushes(p)
      end do
    end do
    ok = .false.
  end subroutine solve_group

  !> L of the pushing contacts' rows; idle contacts' rows and columns are left out.
  pure subroutine factor_group(groups, work, first, last, ok)
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: first, last
    logical, intent(out) :: ok
    real(wp) :: sum
    integer :: p, q, k, p0, q0
    ok = .true.
    do p = first, last
      p0 = work%row_start(p) - groups%first(p)
      if (.not. work%pushes(p)) then
        work%factor(p0 + groups%first(p):p0 + p) = 0.0_wp
        cycle
      end if
      do q = groups%first(p), p - 1
        if (.not. work%pushes(q)) then
          work%factor(p0 + q) = 0.0_wp
          cycle
        end if
        q0 = work%row_start(q) - groups%first(q)
        sum = work%matrix(p0 + q)
        do k = max(groups%first(p), groups%first(q)), q - 1
          sum = sum - work%factor(p0 + k)*work%factor(q0 + k)
        end do
        ! The diagonal holds 1/L_qq.
        work%factor(p0 + q) = sum*work%factor(q0 + q)
      end do
      sum = work%matrix(p0 + p)
      do k = groups%first(p), p - 1
        sum = sum - work%factor(p0 + k)*work%factor(p0 + k)
      end do
      ! A redundant contact's pivot is the hair, or rounding about it.
      sum = max(sum, 0.25_wp*hair*work%matrix(p0 + p))
      ok = ok .and. sum > 0.0_wp
      if (.not. ok) return
      work%factor(p0 + p) = 1.0_wp/sqrt(sum)
    end do
  end subroutine factor_group

  !> A_SS j = s on the pushing contacts, 0 elsewhere.
  pure subroutine solve_factored(groups, work, first, last)
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: first, last
    real(wp) :: j
    integer :: p, k, p0
    do p = first, last
      j = 0.0_wp
      if (work%pushes(p)) then
        p0 = work%row_start(p) - groups%first(p)
        j = work%s(p)
        do k = groups%first(p), p - 1
          j = j - work%factor(p0 + k)*work%j(k)
        end do
        j = j*work%factor(p0 + p)
      end if
      work%j(p) = j
    end do
    do p = last, first, -1
      if (.not. work%pushes(p)) cycle
      p0 = work%row_start(p) - groups%first(p)
      j = work%j(p)*work%factor(p0 + p)
      work%j(p) = j
      do k = groups%first(p), p - 1
        work%j(k) = work%j(k) - work%factor(p0 + k)*j
      end do
    end do
  end subroutine solve_factored

  !> y of L Y = B, row by row.
  pure subroutine forward(groups, work, first, last)
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: first, last
    real(wp) :: y(6)
    integer :: p, k, c, p0
    do p = first, last
      if (.not. work%pushes(p)) cycle
      p0 = work%row_start(p) - groups%first(p)
      do c = 1, 6
        y(c) = work%row(c, p)
      end do
      do k = groups%first(p), p - 1
        if (.not. work%pushes(k)) cycle
        do c = 1, 6
          y(c) = y(c) - work%factor(p0 + k)*work%y(c, k)
        end do
      end do
      do c = 1, 6
        work%y(c, p) = y(c)*work%factor(p0 + p)
      end do
    end do
  end subroutine forward

  !> A j - s of one group.
  pure subroutine slacks(groups, work, first, last)
    type(contact_groups_t), intent(in) :: groups
    type(coupled_solver_t), intent(inout) :: work
    integer, intent(in) :: first, last
    real(wp) :: slack, j
    integer :: p, k, p0
    do p = first, last
      p0 = work%row_start(p) - groups%first(p)
      j = work%j(p)
      slack = work%matrix(p0 + p)*j - work%s(p)
      do k = groups%first(p), p - 1
        slack = slack + work%matrix(p0 + k)*work%j(k)
        work%slack(k) = work%slack(k) + work%matrix(p0 + k)*j
      end do
      work%slack(p) = slack
    end do
  end subroutine slacks

  !> Velocities that the impulses give, from the nodes' and the body's own motion, and the
  !> largest violation of the conditions.
  pure subroutine measure_coupled(problem, list, body, work, residual)
    type(impulse_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_solver_t), intent(inout) :: work
    real(wp), intent(out) :: residual
    real(wp) :: momentum(6), delta(6), p, q, short
    integer :: i, a, b, c
    do i = 1, list%n
      work%change(:, list%node_a(i)) = 0.0_wp
      work%change(:, list%node_b(i)) = 0.0_wp
    end do
    momentum = 0.0_wp
    do i = 1, list%n
      if (.not. abs(problem%impulse(i)) > 0.0_wp) cycle
      a = list%node_a(i)
      b = list%node_b(i)
      p = list%weight_a(i)*list%inverse_mass_a(i)*problem%impulse(i)
      q = list%share(i)*list%inverse_mass_b(i)*problem%impulse(i)
      do c = 1, 3
        work%change(c, a) = work%change(c, a) + p*list%normal(i, c)
        work%change(c, b) = work%change(c, b) + q*list%normal(i, c)
      end do
      do c = 1, 6
        momentum(c) = momentum(c) + problem%impulse(i)*problem%row(i, c)
      end do
    end do
    delta = 0.0_wp
    if (body%free) delta = -inverse_inertia_times(body, momentum)
    residual = 0.0_wp
    do i = 1, list%n
      a = list%node_a(i)
      b = list%node_b(i)
      p = list%weight_a(i)
      q = list%share(i)
      problem%gained(i) = ((list%normal(i, 1)*(p*work%change(1, a) + q*work%change(1, b)) &
                            + list%normal(i, 2)*(p*work%change(2, a) + q*work%change(2, b))) &
                           + list%normal(i, 3)*(p*work%change(3, a) + q*work%change(3, b))) &
                          - (problem%row(i, 1)*delta(1) + problem%row(i, 2)*delta(2) + problem%row(i, 3)*delta(3) &
                             + problem%row(i, 4)*delta(4) + problem%row(i, 5)*delta(5) + problem%row(i, 6)*delta(6))
      if (.not. problem%weight(i) > 0.0_wp) cycle
      short = problem%need(i) - problem%gained(i)
      if (abs(problem%impulse(i)) > 0.0_wp .or. .not. problem%push_only) then
        residual = max(residual, abs(short))
      else
        residual = max(residual, short)
      end if
    end do
  end subroutine measure_coupled

  !> M_SS dj = missing velocity on the contacts that push: hair and cancellation out.
  pure subroutine refine(problem, groups, body, work)
    type(impulse_problem_t), intent(inout) :: problem
    type(contact_groups_t), intent(in) :: groups
    type(body_inertia_t), intent(in) :: body
    type(coupled_solver_t), intent(inout) :: work
    real(wp) :: gradient(6), hessian(6, 6), l(6, 6), scale(6), epsilon(6)
    logical :: ok
    integer :: g, p, i, c
    do p = 1, problem%n
      i = groups%order(p)
      work%s(p) = problem%need(i) - problem%gained(i)
    end do
    epsilon = 0.0_wp
    if (body%free) then
      gradient = 0.0_wp
      do g = 1, groups%n_group
        call solve_factored(groups, work, groups%start(g), groups%start(g + 1) - 1)
      end do
      do p = 1, problem%n
        if (.not. work%pushes(p)) cycle
        do c = 1, 6
          gradient(c) = gradient(c) + work%j(p)*work%row(c, p)
        end do
      end do
      call curvature(groups, body, work, hessian)
      call factor_symmetric(hessian, l, scale, ok)
      if (.not. ok) return
      call solve_symmetric(l, scale, -gradient, epsilon)
    end if
    do p = 1, problem%n
      do c = 1, 6
        work%s(p) = work%s(p) + work%row(c, p)*epsilon(c)
      end do
    end do
    do g = 1, groups%n_group
      call solve_factored(groups, work, groups%start(g), groups%start(g + 1) - 1)
    end do
    do p = 1, problem%n
      if (.not. work%pushes(p)) cycle
      i = groups%order(p)
      problem%impulse(i) = problem%impulse(i) + work%j(p)
      if (problem%push_only) problem%impulse(i) = max(0.0_wp, problem%impulse(i))
    end do
  end subroutine refine

end module castnet_coupled_solver
