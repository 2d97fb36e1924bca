!> Normal impulses of contacts that act on each other through common nodes, as contacts
!> of cables do: M = A + B H B^T with A = C W C^T sparse, W = diag(1/m_node).
!>
!> As for single nodes (castnet_impulse_solver), everything hangs on the body's change of
!> twist delta: given it, the contacts fall into groups joined by common nodes, each a
!> small complementarity problem 0 <= j, 0 <= A j - s, s = g + B delta, and the six
!> equations H^-1 delta + B^T j(delta) = 0 are again the gradient of a convex, piecewise
!> quadratic function. A group is solved by block principal pivoting, its matrix factored
!> within its envelope after numbering the contacts breadth first.
!>
!> A may be singular (two nodes and their cable on one face); a hair on its diagonal makes
!> it regular and moves velocities by 1e-12 of themselves, below what is asked for.
module castnet_coupled_solver
  use castnet_kinds, only: wp
  use castnet_contact_list, only: contact_list_t, body_inertia_t
  use castnet_impulse_solver, only: impulse_problem_t, inverse_inertia_times, inertia_times, inertia_matrix
  use castnet_six_by_six, only: factor_symmetric, solve_symmetric
  implicit none
  private
  public :: group_work_t, reserve_groups, solve_coupled, shares_nodes, find_groups, find_envelope

  real(wp), parameter :: hair = 1.0e-12_wp          !! on the diagonal of A, of itself [-]
  real(wp), parameter :: wrong_below = 1.0e-13_wp   !! slack below which an idle contact is violated, of the largest need [-]
  integer, parameter :: max_newton = 60
  integer, parameter :: max_refinement = 3

  !> Groups of contacts; positions p run along the groups, breadth first within each.
  type :: group_work_t
    integer :: n_group = 0
    integer, allocatable :: head(:)                 !! (nodes of the net) latest contact at a node, 0: none
    integer, allocatable :: next_a(:), next_b(:)    !! (capacity) next contact at node a, b; negative: as its node b
    integer, allocatable :: order(:)                !! (capacity) contact at position p
    integer, allocatable :: place(:)                !! (capacity) position of a contact, 0: none yet
    integer, allocatable :: start(:)                !! (capacity+1) first position of each group
    integer, allocatable :: first(:)                !! (capacity) first position in row p's envelope
    integer, allocatable :: row_start(:)            !! (capacity+1) where row p begins in `matrix`
    logical, allocatable :: pushes(:)               !! (capacity) by position
    real(wp), allocatable :: matrix(:), factor(:)   !! rows' envelopes
    real(wp), allocatable :: s(:), j(:), slack(:)   !! (capacity) by position
    real(wp), allocatable :: y(:, :)                !! (6,capacity) L^-1 B
    real(wp), allocatable :: change(:, :)           !! (3,nodes of the net) change of velocity [m/s]
  end type group_work_t

contains

  !> Room for `capacity` contacts on a net of `n_node` nodes.
  subroutine reserve_groups(work, capacity, n_node)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: capacity, n_node
    if (allocated(work%head)) then
      if (size(work%head) < n_node) deallocate (work%head, work%change)
    end if
    if (.not. allocated(work%head)) then
      allocate (work%head(n_node), source=0)
      allocate (work%change(3, n_node), source=0.0_wp)
    end if
    if (allocated(work%order)) then
      if (size(work%order) >= capacity) return
      deallocate (work%next_a, work%next_b, work%order, work%place, work%start, work%first, work%row_start, &
                  work%pushes, work%s, work%j, work%slack, work%y)
    end if
    allocate (work%next_a(capacity), work%next_b(capacity), work%order(capacity), work%place(capacity), &
              work%start(capacity + 1), work%first(capacity), work%row_start(capacity + 1), source=0)
    allocate (work%pushes(capacity), source=.false.)
    allocate (work%s(capacity), work%j(capacity), work%slack(capacity), work%y(6, capacity), source=0.0_wp)
  end subroutine reserve_groups

  !> Does any node belong to two contacts?
  pure subroutine shares_nodes(list, work, shared)
    type(contact_list_t), intent(in) :: list
    type(group_work_t), intent(inout) :: work
    logical, intent(out) :: shared
    integer :: i
    shared = .false.
    do i = 1, list%n
      work%head(list%node_a(i)) = 0
      work%head(list%node_b(i)) = 0
    end do
    do i = 1, list%n
      if (work%head(list%node_a(i)) /= 0) shared = .true.
      work%head(list%node_a(i)) = i
      if (list%node_b(i) == list%node_a(i)) cycle
      if (work%head(list%node_b(i)) /= 0) shared = .true.
      work%head(list%node_b(i)) = i
    end do
  end subroutine shares_nodes

  !> Impulses of the whole list; `problem` as for the reduced form. Contacts with weight 0
  !> are left out.
  subroutine solve_coupled(problem, list, body, work, iterations, residual, converged)
    type(impulse_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(group_work_t), intent(inout) :: work
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual
    logical, intent(out) :: converged
    real(wp) :: delta(6), largest
    integer :: i, k
    largest = 0.0_wp
    do i = 1, list%n
      if (problem%weight(i) > 0.0_wp) largest = max(largest, abs(problem%need(i)))
    end do
    call find_groups(list, work)
    call assemble(list, work)
    do i = 1, list%n
      work%pushes(work%place(i)) = problem%weight(i) > 0.0_wp .and. (problem%need(i) > 0.0_wp .or. .not. problem%push_only)
    end do
    call search(problem, body, work, largest, delta, iterations, converged)
    do k = 1, list%n
      problem%impulse(work%order(k)) = work%j(k)
    end do
    do k = 1, max_refinement
      call measure_coupled(problem, list, body, work, residual)
      if (residual <= 1.0e-13_wp*largest) exit
      call refine(problem, body, work)
    end do
    if (k > max_refinement) call measure_coupled(problem, list, body, work, residual)
    converged = converged .and. residual <= 1.0e-10_wp*largest
  end subroutine solve_coupled

  !> Number the contacts breadth first along common nodes.
  pure subroutine find_groups(list, work)
    type(contact_list_t), intent(in) :: list
    type(group_work_t), intent(inout) :: work
    integer :: i, seed, last, here
    do i = 1, list%n
      work%head(list%node_a(i)) = 0
      work%head(list%node_b(i)) = 0
      work%place(i) = 0
    end do
    ! Entry +i: contact i as its node a; -i: as its node b.
    do i = list%n, 1, -1
      work%next_a(i) = work%head(list%node_a(i))
      work%head(list%node_a(i)) = i
      work%next_b(i) = 0
      if (list%node_b(i) == list%node_a(i)) cycle
      work%next_b(i) = work%head(list%node_b(i))
      work%head(list%node_b(i)) = -i
    end do
    work%n_group = 0
    last = 0
    do seed = 1, list%n
      if (work%place(seed) /= 0) cycle
      work%n_group = work%n_group + 1
      work%start(work%n_group) = last + 1
      last = last + 1
      work%order(last) = seed
      work%place(seed) = last
      here = last
      do while (here <= last)
        i = work%order(here)
        call visit(work, list%node_a(i), last)
        if (list%node_b(i) /= list%node_a(i)) call visit(work, list%node_b(i), last)
        here = here + 1
      end do
    end do
    work%start(work%n_group + 1) = last + 1
  end subroutine find_groups

  pure subroutine visit(work, node, last)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: node
    integer, intent(inout) :: last
    integer :: entry, k
    entry = work%head(node)
    do while (entry /= 0)
      k = abs(entry)
      if (work%place(k) == 0) then
        last = last + 1
        work%order(last) = k
        work%place(k) = last
      end if
      entry = merge(work%next_a(k), work%next_b(k), entry > 0)
    end do
  end subroutine visit

  !> A within the envelope of each row.
  subroutine assemble(list, work)
    type(contact_list_t), intent(in) :: list
    type(group_work_t), intent(inout) :: work
    integer :: p, i, length
    call find_envelope(list, work)
    length = work%row_start(list%n + 1) - 1
    if (allocated(work%matrix)) then
      if (size(work%matrix) < length) deallocate (work%matrix, work%factor)
    end if
    if (.not. allocated(work%matrix)) allocate (work%matrix(2*length), work%factor(2*length))
    work%matrix(1:length) = 0.0_wp
    do p = 1, list%n
      i = work%order(p)
      call couple(list, work, p, i, list%node_a(i), list%weight_a(i)*list%inverse_mass_a(i))
      if (list%node_b(i) /= list%node_a(i)) call couple(list, work, p, i, list%node_b(i), list%share(i)*list%inverse_mass_b(i))
      associate (diagonal => work%matrix(work%row_start(p + 1) - 1))
        diagonal = diagonal*(1.0_wp + hair)
      end associate
    end do
  end subroutine assemble

  !> First position to which each row's envelope reaches, and where the rows begin.
  pure subroutine find_envelope(list, work)
    type(contact_list_t), intent(in) :: list
    type(group_work_t), intent(inout) :: work
    integer :: p, i, length
    length = 0
    do p = 1, list%n
      i = work%order(p)
      work%first(p) = p
      call reach(work, list%node_a(i), p)
      if (list%node_b(i) /= list%node_a(i)) call reach(work, list%node_b(i), p)
      work%row_start(p) = length + 1
      length = length + p - work%first(p) + 1
    end do
    work%row_start(list%n + 1) = length + 1
  end subroutine find_envelope

  pure subroutine reach(work, node, p)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: node, p
    integer :: entry, k
    entry = work%head(node)
    do while (entry /= 0)
      k = abs(entry)
      work%first(p) = min(work%first(p), work%place(k))
      entry = merge(work%next_a(k), work%next_b(k), entry > 0)
    end do
  end subroutine reach

  !> Add to row p what the impulses of contacts at `node` do to contact i through it.
  pure subroutine couple(list, work, p, i, node, mobility)
    type(contact_list_t), intent(in) :: list
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: p, i, node
    real(wp), intent(in) :: mobility  !! share of the node in i over its mass
    real(wp) :: share, cosine
    integer :: entry, k, q, at
    entry = work%head(node)
    do while (entry /= 0)
      k = abs(entry)
      q = work%place(k)
      if (q <= p) then
        share = merge(list%weight_a(k), list%share(k), entry > 0)
        cosine = 1.0_wp
        if (q < p) cosine = list%normal(i, 1)*list%normal(k, 1) + list%normal(i, 2)*list%normal(k, 2) &
                            + list%normal(i, 3)*list%normal(k, 3)
        at = work%row_start(p) + q - work%first(p)
        work%matrix(at) = work%matrix(at) + mobility*share*cosine
      end if
      entry = merge(work%next_a(k), work%next_b(k), entry > 0)
    end do
  end subroutine couple

  !> Newton's search for the body's change of twist.
  pure subroutine search(problem, body, work, largest, delta, iterations, converged)
    type(impulse_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    type(group_work_t), intent(inout) :: work
    real(wp), intent(in) :: largest
    real(wp), intent(out) :: delta(6)
    integer, intent(out) :: iterations
    logical, intent(out) :: converged
    real(wp) :: gradient(6), hessian(6, 6), trial_gradient(6), trial_hessian(6, 6), step(6), trial(6), phi, trial_phi, t
    real(wp) :: l(6, 6), scale(6)
    logical :: ok, moved
    integer :: cut
    delta = 0.0_wp
    iterations = 1
    call sweep(problem, body, work, largest, delta, gradient, hessian, phi, moved, converged)
    if (.not. body%free .or. .not. converged) return
    do iterations = 1, max_newton
      call factor_symmetric(hessian, l, scale, ok)
      if (.not. ok) exit
      call solve_symmetric(l, scale, -gradient, step)
      t = 1.0_wp
      do cut = 1, 40
        trial = delta + t*step
        call sweep(problem, body, work, largest, trial, trial_gradient, trial_hessian, trial_phi, moved, converged)
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
      hessian = trial_hessian
      phi = trial_phi
    end do
    converged = .false.
  end subroutine search

  !> Every group at `delta`: impulses, F, its derivative and phi.
  pure subroutine sweep(problem, body, work, largest, delta, gradient, hessian, phi, moved, ok)
    type(impulse_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    type(group_work_t), intent(inout) :: work
    real(wp), intent(in) :: largest, delta(6)
    real(wp), intent(out) :: gradient(6), hessian(6, 6), phi
    logical, intent(out) :: moved   !! a contact began or ceased to push
    logical, intent(out) :: ok
    real(wp) :: b(6), momentum(6)
    integer :: g, p, i, c, d
    logical :: changed
    ok = .true.
    moved = .false.
    do p = 1, problem%n
      i = work%order(p)
      work%s(p) = problem%need(i) + (problem%row(i, 1)*delta(1) + problem%row(i, 2)*delta(2) + problem%row(i, 3)*delta(3) &
                                     + problem%row(i, 4)*delta(4) + problem%row(i, 5)*delta(5) + problem%row(i, 6)*delta(6))
    end do
    momentum = inertia_times(body, delta)
    gradient = momentum
    call inertia_matrix(body, hessian)
    phi = 0.0_wp
    do c = 1, 6
      phi = phi + delta(c)*momentum(c)
    end do
    do g = 1, work%n_group
      call solve_group(problem, work, work%start(g), work%start(g + 1) - 1, largest, changed, ok)
      if (.not. ok) return
      moved = moved .or. changed
      do p = work%start(g), work%start(g + 1) - 1
        if (.not. work%pushes(p)) cycle
        i = work%order(p)
        b = problem%row(i, :)
        phi = phi + work%j(p)*work%s(p)
        call forward(work, p, work%start(g), b)
        do c = 1, 6
          gradient(c) = gradient(c) + work%j(p)*problem%row(i, c)
          do d = 1, c
            hessian(c, d) = hessian(c, d) + work%y(c, p)*work%y(d, p)
          end do
        end do
      end do
    end do
  end subroutine sweep

  !> Complementarity of one group: guess who pushes, solve, correct the guess.
  pure subroutine solve_group(problem, work, first, last, largest, changed, ok)
    type(impulse_problem_t), intent(in) :: problem
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: first, last
    real(wp), intent(in) :: largest
    logical, intent(out) :: changed, ok
    integer :: trial, n_wrong, least, patience, p, last_wrong
    logical :: out
    changed = .false.
    ok = .true.
    least = huge(1)
    patience = 10
    do trial = 1, 100 + 20*(last - first + 1)
      call factor_group(work, first, last, ok)
      if (.not. ok) return
      call solve_factored(work, first, last)
      if (.not. problem%push_only) return
      call slacks(work, first, last)
      n_wrong = 0
      last_wrong = 0
      do p = first, last
        if (is_wrong(p)) then
          n_wrong = n_wrong + 1
          last_wrong = p
        end if
      end do
      if (n_wrong == 0) return
      changed = .true.
      if (n_wrong < least) then
        least = n_wrong
        patience = 10
      else
        patience = patience - 1
      end if
      do p = first, last
        ! One at a time when all at once does not get anywhere (Murty's rule cannot cycle).
        out = is_wrong(p) .and. (patience > 0 .or. p == last_wrong)
        if (out) work%slack(p) = huge(1.0_wp)
      end do
      do p = first, last
        if (work%slack(p) >= huge(1.0_wp)) work%pushes(p) = .not. work%pushes(p)
      end do
    end do
    ok = .false.
  contains
    pure logical function is_wrong(p)
      integer, intent(in) :: p
      if (work%pushes(p)) then
        is_wrong = work%j(p) < 0.0_wp
      else
        is_wrong = work%slack(p) < -wrong_below*largest .and. problem%weight(work%order(p)) > 0.0_wp
      end if
    end function is_wrong
  end subroutine solve_group

  !> L of the pushing contacts' rows; an idle contact's row is that of the unit matrix.
  pure subroutine factor_group(work, first, last, ok)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: first, last
    logical, intent(out) :: ok
    real(wp) :: sum
    integer :: p, q, k, p0, q0, from
    ok = .true.
    do p = first, last
      p0 = work%row_start(p) - work%first(p)
      if (.not. work%pushes(p)) then
        work%factor(work%row_start(p):work%row_start(p + 1) - 2) = 0.0_wp
        work%factor(work%row_start(p + 1) - 1) = 1.0_wp
        cycle
      end if
      do q = work%first(p), p
        if (.not. work%pushes(q)) then
          work%factor(p0 + q) = 0.0_wp
          cycle
        end if
        q0 = work%row_start(q) - work%first(q)
        from = max(work%first(p), work%first(q))
        sum = work%matrix(p0 + q)
        do k = from, q - 1
          sum = sum - work%factor(p0 + k)*work%factor(q0 + k)
        end do
        if (q < p) then
          ! The diagonal holds 1/L_qq.
          work%factor(p0 + q) = sum*work%factor(q0 + q)
        else
          ! A redundant contact's pivot is the hair, or rounding about it.
          sum = max(sum, 0.25_wp*hair*work%matrix(p0 + p))
          ok = ok .and. sum > 0.0_wp
          if (.not. ok) return
          work%factor(p0 + p) = 1.0_wp/sqrt(sum)
        end if
      end do
    end do
  end subroutine factor_group

  !> A_SS j = s on the pushing contacts, 0 elsewhere.
  pure subroutine solve_factored(work, first, last)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: first, last
    integer :: p, k, p0
    do p = first, last
      work%j(p) = 0.0_wp
      if (.not. work%pushes(p)) cycle
      p0 = work%row_start(p) - work%first(p)
      work%j(p) = work%s(p)
      do k = work%first(p), p - 1
        work%j(p) = work%j(p) - work%factor(p0 + k)*work%j(k)
      end do
      work%j(p) = work%j(p)*work%factor(p0 + p)
    end do
    do p = last, first, -1
      if (.not. work%pushes(p)) cycle
      p0 = work%row_start(p) - work%first(p)
      work%j(p) = work%j(p)*work%factor(p0 + p)
      do k = work%first(p), p - 1
        work%j(k) = work%j(k) - work%factor(p0 + k)*work%j(p)
      end do
    end do
  end subroutine solve_factored

  !> y_p of L Y = B, row by row.
  pure subroutine forward(work, p, first, b)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: p, first
    real(wp), intent(in) :: b(6)
    integer :: k, c, p0
    p0 = work%row_start(p) - work%first(p)
    do c = 1, 6
      work%y(c, p) = b(c)
    end do
    do k = max(first, work%first(p)), p - 1
      if (.not. work%pushes(k)) cycle
      do c = 1, 6
        work%y(c, p) = work%y(c, p) - work%factor(p0 + k)*work%y(c, k)
      end do
    end do
    do c = 1, 6
      work%y(c, p) = work%y(c, p)*work%factor(p0 + p)
    end do
  end subroutine forward

  !> A j - s of one group.
  pure subroutine slacks(work, first, last)
    type(group_work_t), intent(inout) :: work
    integer, intent(in) :: first, last
    integer :: p, k, p0
    do p = first, last
      work%slack(p) = -work%s(p)
    end do
    do p = first, last
      p0 = work%row_start(p) - work%first(p)
      work%slack(p) = work%slack(p) + work%matrix(p0 + p)*work%j(p)
      do k = work%first(p), p - 1
        work%slack(p) = work%slack(p) + work%matrix(p0 + k)*work%j(k)
        work%slack(k) = work%slack(k) + work%matrix(p0 + k)*work%j(p)
      end do
    end do
  end subroutine slacks

  !> Velocities that the impulses give, from the nodes' and the body's own motion, and the
  !> largest violation of the conditions.
  pure subroutine measure_coupled(problem, list, body, work, residual)
    type(impulse_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(group_work_t), intent(inout) :: work
    real(wp), intent(out) :: residual
    real(wp) :: momentum(6), delta(6), p, q, short
    integer :: i, a, b, c
    do i = 1, list%n
      work%change(:, list%node_a(i)) = 0.0_wp
      work%change(:, list%node_b(i)) = 0.0_wp
    end do
    momentum = 0.0_wp
    do i = 1, list%n
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
      problem%gained(i) = 0.0_wp
      do c = 1, 3
        problem%gained(i) = problem%gained(i) + list%normal(i, c)* &
                            (list%weight_a(i)*work%change(c, a) + list%share(i)*work%change(c, b))
      end do
      do c = 1, 6
        problem%gained(i) = problem%gained(i) - problem%row(i, c)*delta(c)
      end do
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
  pure subroutine refine(problem, body, work)
    type(impulse_problem_t), intent(inout) :: problem
    type(body_inertia_t), intent(in) :: body
    type(group_work_t), intent(inout) :: work
    real(wp) :: gradient(6), hessian(6, 6), l(6, 6), scale(6), epsilon(6), b(6)
    logical :: ok
    integer :: g, p, i, c, d
    gradient = 0.0_wp
    call inertia_matrix(body, hessian)
    do g = 1, work%n_group
      do p = work%start(g), work%start(g + 1) - 1
        i = work%order(p)
        work%s(p) = problem%need(i) - problem%gained(i)
      end do
      call solve_factored(work, work%start(g), work%start(g + 1) - 1)
      if (.not. body%free) cycle
      do p = work%start(g), work%start(g + 1) - 1
        if (.not. work%pushes(p)) cycle
        i = work%order(p)
        b = problem%row(i, :)
        call forward(work, p, work%start(g), b)
        do c = 1, 6
          gradient(c) = gradient(c) + work%j(p)*problem%row(i, c)
          do d = 1, c
            hessian(c, d) = hessian(c, d) + work%y(c, p)*work%y(d, p)
          end do
        end do
      end do
    end do
    epsilon = 0.0_wp
    if (body%free) then
      call factor_symmetric(hessian, l, scale, ok)
      if (.not. ok) return
      call solve_symmetric(l, scale, -gradient, epsilon)
    end if
    do g = 1, work%n_group
      do p = work%start(g), work%start(g + 1) - 1
        i = work%order(p)
        do c = 1, 6
          work%s(p) = work%s(p) + problem%row(i, c)*epsilon(c)
        end do
      end do
      call solve_factored(work, work%start(g), work%start(g + 1) - 1)
      do p = work%start(g), work%start(g + 1) - 1
        if (.not. work%pushes(p)) cycle
        i = work%order(p)
        problem%impulse(i) = problem%impulse(i) + work%j(p)
        if (problem%push_only) problem%impulse(i) = max(0.0_wp, problem%impulse(i))
      end do
    end do
  end subroutine refine

end module castnet_coupled_solver
