!> Impulses with friction where contacts act on each other through common nodes (cables)
!> or cannot be put into the 6 x 6 form (fixed nodes).
!>
!> With j_i = law_i(u_i - rho_i j_i) the impulse that a mass 1/rho_i would need (any rho > 0
!> says the same law) and P_i = -law_i', Newton's step solves
!>
!>     dj_i + P_i ((W - (1 - epsilon) rho) dj)_i = law_i - j_i,   W = A + G H G^T,
!>
!> A the couplings through nodes, which fall into groups, G H G^T those through the body:
!> a band matrix for each group and six equations for the body. epsilon > 0 because two
!> nodes and their cable on one face are one contact too many, and their impulses are not
!> unique: it keeps the step short along what does not matter, and is lowered as Newton's
!> method gets on. A step is kept when the error falls below the largest of the last eight:
!> where two contacts are nearly one, the way down leads over a ridge.
!>
!> Where that fails sweeps give other places to begin: contact by contact, each solved in
!> closed form, its mobility bounded by the trace of the body's part.
module castnet_coupled_friction
  use castnet_kinds, only: wp
  use castnet_contact_list, only: contact_list_t, body_inertia_t, shared_mobility
  use castnet_contact_groups, only: contact_groups_t
  use castnet_friction_problem, only: friction_problem_t, cone_impulse, cone_derivative
  use castnet_six_by_six, only: solve_general
  implicit none
  private
  public :: coupled_work_t, newton_work_t, reserve_coupled, solve_coupled_friction

  integer, parameter :: max_try = 10
  integer, parameter :: sweeps_at = 7        !! the try that begins with sweeps; later ones raise friction in steps
  !> Factors of rho by try: another rho says the same law and has its valleys elsewhere.
  real(wp), parameter :: rho(max_try) = [1.0_wp, 1.0_wp, 4.0_wp, 0.25_wp, 16.0_wp, 64.0_wp, 1.0_wp, 1.0_wp, 4.0_wp, 1.0_wp]
  integer, parameter :: sweeps_between = 60  !! sweeps before another try
  integer, parameter :: max_newton = 60      !! steps in one try
  integer, parameter :: max_cut = 6          !! halvings of a step
  integer, parameter :: memory = 8           !! errors that a step may go back to
  real(wp), parameter :: first_epsilon = 1.0e-2_wp, least_epsilon = 1.0e-10_wp, largest_epsilon = 0.3_wp
  !> The end of the search, of the largest speed [-].
  real(wp), parameter :: tolerance = 1.0e-13_wp
  real(wp), parameter :: accept_below = 1.0e-10_wp

  !> Nodes that the contacts touch, numbered from 1, and their change of velocity.
  type :: coupled_work_t
    integer :: n_node = 0
    integer, allocatable :: local(:)        !! (nodes of the net) number of a touched node, else 0
    integer, allocatable :: a(:), b(:)      !! (capacity) numbers of each contact's nodes
    real(wp), allocatable :: change(:, :)   !! (3,2 capacity) change of the nodes' velocities [m/s]
    real(wp), allocatable :: mobility(:)    !! (capacity) bound of a contact's own mobility [1/kg]
  end type coupled_work_t

  !> Newton's step; grown when needed.
  type :: newton_work_t
    real(wp), allocatable :: band(:)        !! one group's matrix, by diagonals
    real(wp), allocatable :: right(:, :)    !! (3n,7) law - j, and P G; then B^-1 of them
    real(wp), allocatable :: kept(:, :)     !! (3,n) impulses to go back to [N s]
    real(wp), allocatable :: slope(:, :, :) !! (3,3,n) P
  end type newton_work_t

contains

  !> Room for `capacity` contacts on a net of `n_node` nodes.
  subroutine reserve_coupled(work, capacity, n_node)
    type(coupled_work_t), intent(inout) :: work
    integer, intent(in) :: capacity, n_node
    if (allocated(work%local)) then
      if (size(work%local) < n_node) deallocate (work%local)
    end if
    if (.not. allocated(work%local)) allocate (work%local(n_node), source=0)
    if (allocated(work%a)) then
      if (size(work%a) >= capacity) return
      deallocate (work%a, work%b, work%change, work%mobility)
    end if
    allocate (work%a(capacity), work%b(capacity), source=0)
    allocate (work%change(3, 2*capacity), work%mobility(capacity), source=0.0_wp)
  end subroutine reserve_coupled

  !> Number the touched nodes in the order of the list.
  pure subroutine number_nodes(list, work)
    type(contact_list_t), intent(in) :: list
    type(coupled_work_t), intent(inout) :: work
    integer :: i, number
    do i = 1, list%n
      work%local(list%node_a(i)) = 0
      work%local(list%node_b(i)) = 0
    end do
    work%n_node = 0
    do i = 1, list%n
      call give_number(list%node_a(i), work, number)
      work%a(i) = number
      call give_number(list%node_b(i), work, number)
      work%b(i) = number
    end do
  end subroutine number_nodes

  pure subroutine give_number(node, work, number)
    integer, intent(in) :: node
    type(coupled_work_t), intent(inout) :: work
    integer, intent(out) :: number
    if (work%local(node) == 0) then
      work%n_node = work%n_node + 1
      work%local(node) = work%n_node
    end if
    number = work%local(node)
  end subroutine give_number

  !> Impulses of every contact.
  subroutine solve_coupled_friction(problem, list, body, work, groups, dense, iterations, residual, converged, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    type(contact_groups_t), intent(in) :: groups
    type(newton_work_t), intent(inout) :: dense
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual   !! [m/s]
    logical, intent(out) :: converged
    real(wp), intent(out) :: twist(6)   !! change of the body's twist, inertial axes
    real(wp) :: largest, change, error
    integer :: try
    call number_nodes(list, work)
    call set_mobilities(problem, list, body, work, largest)
    call reserve_newton(dense, list%n, widest(groups, list%n))
    iterations = 0
    do try = 1, max_try
      call begin(try)
      work%mobility(1:list%n) = rho(try)*work%mobility(1:list%n)
      call newton(problem, list, body, work, groups, dense, first_epsilon*merge(10.0_wp, 1.0_wp, try == 2), twist, largest, &
                  iterations, residual)
      work%mobility(1:list%n) = work%mobility(1:list%n)/rho(try)
      call measure(problem, list, work, twist, residual, error)
      converged = residual <= accept_below*largest
      if (converged) exit
    end do
  contains
    !> Where to begin: at rest, after sweeps, with friction raised from nothing.
    subroutine begin(try)
      integer, intent(in) :: try
      real(wp) :: friction
      integer :: k, steps
      if (try == sweeps_at) then
        do k = 1, sweeps_between
          call sweep(problem, list, body, work, twist, change)
          if (change <= tolerance*largest) exit
        end do
        iterations = iterations + sweeps_between
      else
        problem%impulse(1:list%n, :) = 0.0_wp
      end if
      if (try > sweeps_at) then
        friction = problem%friction
        steps = 4**(try - sweeps_at)
        do k = 0, steps - 1
          problem%friction = friction*k/steps
          call replay(problem, list, body, work, twist)
          call newton(problem, list, body, work, groups, dense, first_epsilon, twist, largest, iterations, residual)
        end do
        problem%friction = friction
      end if
      call replay(problem, list, body, work, twist)
    end subroutine begin
  end subroutine solve_coupled_friction

  !> Half the band of the widest group, in contacts.
  pure integer function widest(groups, n)
    type(contact_groups_t), intent(in) :: groups
    integer, intent(in) :: n
    integer :: p
    widest = 0
    do p = 1, n
      widest = max(widest, p - groups%first(p))
    end do
  end function widest

  pure subroutine set_mobilities(problem, list, body, work, largest)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    real(wp), intent(out) :: largest
    real(wp) :: r(3), turn(3, 3), rr
    integer :: i
    largest = 0.0_wp
    turn = body%inverse_inertia
    do i = 1, list%n
      r = list%arm(i, :)
      rr = r(1)*r(1) + r(2)*r(2) + r(3)*r(3)
      work%mobility(i) = list%weight_a(i)**2*list%inverse_mass_a(i) + list%share(i)**2*list%inverse_mass_b(i)
      ! tr([r] I^-1 [r]^T) = |r|^2 tr I^-1 - r.I^-1 r.
      if (body%free) work%mobility(i) = work%mobility(i) + body%inverse_mass &
                                        + rr*(turn(1, 1) + turn(2, 2) + turn(3, 3)) - quadratic(turn, r)
      if (.not. problem%mass(i) > 0.0_wp) cycle
      largest = max(largest, abs(problem%velocity(i, 1)), abs(problem%velocity(i, 2)), abs(problem%velocity(i, 3)))
    end do
  end subroutine set_mobilities

  pure real(wp) function quadratic(a, r)
    real(wp), intent(in) :: a(3, 3), r(3)
    quadratic = r(1)*(a(1, 1)*r(1) + a(1, 2)*r(2) + a(1, 3)*r(3)) + r(2)*(a(2, 1)*r(1) + a(2, 2)*r(2) + a(2, 3)*r(3)) &
                + r(3)*(a(3, 1)*r(1) + a(3, 2)*r(2) + a(3, 3)*r(3))
  end function quadratic

  !> Motion of nodes and body by the impulses as they stand.
  pure subroutine replay(problem, list, body, work, twist)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    real(wp), intent(out) :: twist(6)
    integer :: i
    work%change(:, 1:work%n_node) = 0.0_wp
    twist = 0.0_wp
    do i = 1, list%n
      call push(list, body, work, i, [problem%impulse(i, 1), problem%impulse(i, 2), problem%impulse(i, 3)], twist)
    end do
  end subroutine replay

  !> What one impulse does to its nodes and the body.
  pure subroutine push(list, body, work, i, j, twist)
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    integer, intent(in) :: i
    real(wp), intent(in) :: j(3)
    real(wp), intent(inout) :: twist(6)
    real(wp) :: p, q, t(3)
    integer :: a, b, c
    a = work%a(i)
    b = work%b(i)
    p = list%weight_a(i)*list%inverse_mass_a(i)
    q = list%share(i)*list%inverse_mass_b(i)
    do c = 1, 3
      work%change(c, a) = work%change(c, a) + p*j(c)
      work%change(c, b) = work%change(c, b) + q*j(c)
    end do
    if (.not. body%free) return
    t(1) = list%arm(i, 2)*j(3) - list%arm(i, 3)*j(2)
    t(2) = list%arm(i, 3)*j(1) - list%arm(i, 1)*j(3)
    t(3) = list%arm(i, 1)*j(2) - list%arm(i, 2)*j(1)
    do c = 1, 3
      twist(c) = twist(c) - body%inverse_mass*j(c)
      twist(c + 3) = twist(c + 3) - (body%inverse_inertia(c, 1)*t(1) + body%inverse_inertia(c, 2)*t(2) &
                                     + body%inverse_inertia(c, 3)*t(3))
    end do
  end subroutine push

  !> Relative velocity of a contact with everything as it stands.
  pure function present_velocity(problem, list, work, twist, i) result(u)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(coupled_work_t), intent(in) :: work
    real(wp), intent(in) :: twist(6)
    integer, intent(in) :: i
    real(wp) :: u(3), r(3), p, q
    integer :: a, b
    a = work%a(i)
    b = work%b(i)
    p = list%weight_a(i)
    q = list%share(i)
    r = [list%arm(i, 1), list%arm(i, 2), list%arm(i, 3)]
    u(1) = problem%velocity(i, 1) + (p*work%change(1, a) + q*work%change(1, b)) - (twist(1) + twist(5)*r(3) - twist(6)*r(2))
    u(2) = problem%velocity(i, 2) + (p*work%change(2, a) + q*work%change(2, b)) - (twist(2) + twist(6)*r(1) - twist(4)*r(3))
    u(3) = problem%velocity(i, 3) + (p*work%change(3, a) + q*work%change(3, b)) - (twist(3) + twist(4)*r(2) - twist(5)*r(1))
  end function present_velocity

  !> The impulse that the law wants of contact i, everything else as it stands.
  pure function wanted(problem, work, i, u) result(j)
    type(friction_problem_t), intent(in) :: problem
    type(coupled_work_t), intent(in) :: work
    integer, intent(in) :: i
    real(wp), intent(in) :: u(3)
    real(wp) :: j(3), n(3), before(3)
    before = u - work%mobility(i)*[problem%impulse(i, 1), problem%impulse(i, 2), problem%impulse(i, 3)]
    n = [problem%normal(i, 1), problem%normal(i, 2), problem%normal(i, 3)]
    j = cone_impulse(1.0_wp/work%mobility(i), before, n, problem%rebound(i), problem%friction, problem%push_only)
  end function wanted

  pure subroutine sweep(problem, list, body, work, twist, change)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    real(wp), intent(inout) :: twist(6)
    real(wp), intent(out) :: change   !! largest change of velocity by a contact's step [m/s]
    real(wp) :: u(3), j(3), step(3)
    integer :: i, c
    change = 0.0_wp
    do i = 1, list%n
      if (.not. problem%mass(i) > 0.0_wp .or. .not. work%mobility(i) > 0.0_wp) cycle
      u = present_velocity(problem, list, work, twist, i)
      j = wanted(problem, work, i, u)
      do c = 1, 3
        step(c) = j(c) - problem%impulse(i, c)
        problem%impulse(i, c) = j(c)
      end do
      if (abs(step(1)) + abs(step(2)) + abs(step(3)) <= 0.0_wp) cycle
      call push(list, body, work, i, step, twist)
      change = max(change, work%mobility(i)*max(abs(step(1)), abs(step(2)), abs(step(3))))
    end do
  end subroutine sweep

  !> Newton's method from the present impulses; the best ones seen are left.
  subroutine newton(problem, list, body, work, groups, dense, epsilon_at_first, twist, largest, iterations, residual)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    type(contact_groups_t), intent(in) :: groups
    type(newton_work_t), intent(inout) :: dense
    real(wp), intent(in) :: epsilon_at_first, largest
    real(wp), intent(inout) :: twist(6)
    integer, intent(inout) :: iterations
    real(wp), intent(out) :: residual
    real(wp) :: epsilon, error, before, t, errors(memory)
    integer :: n, step, i, c, cut
    logical :: ok
    n = list%n
    epsilon = epsilon_at_first
    call measure(problem, list, work, twist, residual, error)
    errors = error
    do step = 1, max_newton
      if (residual <= tolerance*largest) return
      call newton_step(problem, list, body, work, groups, dense, twist, epsilon, ok)
      if (.not. ok) return
      iterations = iterations + 1
      do i = 1, n
        do c = 1, 3
          dense%kept(c, i) = problem%impulse(i, c)
        end do
      end do
      before = error
      t = 1.0_wp
      do cut = 1, max_cut
        do i = 1, n
          do c = 1, 3
            problem%impulse(i, c) = dense%kept(c, i) + t*dense%right(3*(groups%place(i) - 1) + c, 1)
          end do
        end do
        call replay(problem, list, body, work, twist)
        call measure(problem, list, work, twist, residual, error)
        if (error < maxval(errors)) exit
        t = 0.5_wp*t
      end do
      if (cut == 1 .and. error < 0.5_wp*before) then
        epsilon = max(0.1_wp*epsilon, least_epsilon)
      else if (cut > 1 .or. error > before) then
        epsilon = min(4.0_wp*epsilon, largest_epsilon)
      end if
      errors(1 + mod(step, memory)) = error
    end do
  end subroutine newton

  !> Room for groups of a half band of `width` contacts.
  subroutine reserve_newton(work, n, width)
    type(newton_work_t), intent(inout) :: work
    integer, intent(in) :: n, width
    integer :: m
    m = (3*(3*width + 2) + 1)*3*n
    if (allocated(work%band)) then
      if (size(work%band) < m) deallocate (work%band)
    end if
    if (.not. allocated(work%band)) allocate (work%band(2*m), source=0.0_wp)
    if (allocated(work%right)) then
      if (size(work%right, 1) >= 3*n) return
      deallocate (work%right, work%kept, work%slope)
    end if
    allocate (work%right(6*n, 7), work%kept(3, 2*n), work%slope(3, 3, 2*n), source=0.0_wp)
  end subroutine reserve_newton

  !> Newton's step into the first column of `dense%right`, by position.
  pure subroutine newton_step(problem, list, body, work, groups, dense, twist, epsilon, ok)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(in) :: work
    type(contact_groups_t), intent(in) :: groups
    type(newton_work_t), intent(inout) :: dense
    real(wp), intent(in) :: twist(6), epsilon
    logical, intent(out) :: ok
    integer :: g, p, first, last, half
    do p = 1, list%n
      call set_row(problem, list, work, twist, groups%order(p), p, size(dense%right, 1), dense%slope(:, :, p), dense%right)
    end do
    ok = .true.
    do g = 1, groups%n_group
      first = groups%start(g)
      last = groups%start(g + 1) - 1
      half = 0
      do p = first, last
        half = max(half, p - groups%first(p))
      end do
      half = 3*half + 2
      call fill_band(list, work, groups, dense%slope, first, last, epsilon, half, dense%band)
      call eliminate_band(3*(last - first + 1), half, merge(7, 1, body%free), dense%band, size(dense%right, 1), 3*(first - 1), &
                          dense%right, ok)
      if (.not. ok) return
    end do
    if (body%free) call add_body(list, body, groups, size(dense%right, 1), dense%right, ok)
  end subroutine newton_step

  !> P, law - j and P G of one contact.
  pure subroutine set_row(problem, list, work, twist, i, p, m, slope, right)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(coupled_work_t), intent(in) :: work
    real(wp), intent(in) :: twist(6)
    integer, intent(in) :: i, p, m
    real(wp), intent(out) :: slope(3, 3)
    real(wp), intent(inout) :: right(m, 7)
    real(wp) :: u(3), j(3), n(3), x, y, z
    integer :: c, row
    slope = 0.0_wp
    j = 0.0_wp
    if (problem%mass(i) > 0.0_wp .and. work%mobility(i) > 0.0_wp) then
      u = present_velocity(problem, list, work, twist, i)
      j = wanted(problem, work, i, u)
      n = [problem%normal(i, 1), problem%normal(i, 2), problem%normal(i, 3)]
      do c = 1, 3
        u(c) = u(c) - work%mobility(i)*problem%impulse(i, c)
      end do
      slope = cone_derivative(1.0_wp/work%mobility(i), u, n, problem%rebound(i), problem%friction, problem%push_only)
    end if
    x = list%arm(i, 1)
    y = list%arm(i, 2)
    z = list%arm(i, 3)
    do c = 1, 3
      row = 3*(p - 1) + c
      right(row, 1) = j(c) - problem%impulse(i, c)
      ! G = [1, -[r]].
      right(row, 2) = slope(c, 1)
      right(row, 3) = slope(c, 2)
      right(row, 4) = slope(c, 3)
      right(row, 5) = slope(c, 3)*y - slope(c, 2)*z
      right(row, 6) = slope(c, 1)*z - slope(c, 3)*x
      right(row, 7) = slope(c, 2)*x - slope(c, 1)*y
    end do
  end subroutine set_row

  !> B = 1 + P (A - (1 - epsilon) rho) of one group by diagonals: b(2 half + 1 + row - column, column),
  !> with room for the rows' exchanges.
  pure subroutine fill_band(list, work, groups, slope, first, last, epsilon, half, b)
    type(contact_list_t), intent(in) :: list
    type(coupled_work_t), intent(in) :: work
    type(contact_groups_t), intent(in) :: groups
    real(wp), intent(in) :: slope(:, :, :), epsilon
    integer, intent(in) :: first, last, half
    real(wp), intent(inout) :: b(3*half + 1, *)
    real(wp) :: shared
    integer :: p, q, i, k
    do p = 1, 3*(last - first + 1)
      b(:, p) = 0.0_wp
    end do
    do p = first, last
      i = groups%order(p)
      shared = shared_mobility(list, i, i) - (1.0_wp - epsilon)*work%mobility(i)
      call put(slope(:, :, p), shared, p - first, p - first, half, b)
      do k = 1, 3
        b(2*half + 1, 3*(p - first) + k) = b(2*half + 1, 3*(p - first) + k) + 1.0_wp
      end do
      do q = groups%first(p), p - 1
        shared = shared_mobility(list, i, groups%order(q))
        if (.not. shared > 0.0_wp) cycle
        call put(slope(:, :, p), shared, p - first, q - first, half, b)
        call put(slope(:, :, q), shared, q - first, p - first, half, b)
      end do
    end do
  end subroutine fill_band

  !> P a into block (p, q) of a band matrix.
  pure subroutine put(slope, a, p, q, half, b)
    real(wp), intent(in) :: slope(3, 3), a
    integer, intent(in) :: p, q, half
    real(wp), intent(inout) :: b(3*half + 1, *)
    integer :: c, d, column
    do d = 1, 3
      column = 3*q + d
      do c = 1, 3
        b(2*half + 1 + 3*p + c - column, column) = slope(c, d)*a
      end do
    end do
  end subroutine put

  !> Gaussian elimination in the band with row exchanges; x in rows `at`+1 on of `right`.
  pure subroutine eliminate_band(n, half, n_right, b, m, at, right, ok)
    integer, intent(in) :: n, half, n_right, m, at
    real(wp), intent(inout) :: b(3*half + 1, n), right(m, 7)
    logical, intent(out) :: ok
    real(wp) :: factor(half), swap, pivot_value
    integer :: k, i, c, pivot, diagonal, below, last
    ok = .true.
    diagonal = 2*half + 1
    do k = 1, n
      below = min(half, n - k)
      pivot = 0
      do i = 1, below
        if (abs(b(diagonal + i, k)) > abs(b(diagonal + pivot, k))) pivot = i
      end do
      pivot_value = b(diagonal + pivot, k)
      if (.not. abs(pivot_value) > 1.0e-15_wp) then
        ok = .false.
        return
      end if
      last = min(n, k + 2*half)
      if (pivot /= 0) then
        do c = k, last
          swap = b(diagonal + k - c, c)
          b(diagonal + k - c, c) = b(diagonal + pivot + k - c, c)
          b(diagonal + pivot + k - c, c) = swap
        end do
        do c = 1, n_right
          swap = right(at + k, c)
          right(at + k, c) = right(at + k + pivot, c)
          right(at + k + pivot, c) = swap
        end do
      end if
      do i = 1, below
        factor(i) = b(diagonal + i, k)/pivot_value
      end do
      do c = k + 1, last
        swap = b(diagonal + k - c, c)
        if (.not. abs(swap) > 0.0_wp) cycle
        do i = 1, below
          b(diagonal + i + k - c, c) = b(diagonal + i + k - c, c) - factor(i)*swap
        end do
      end do
      do c = 1, n_right
        swap = right(at + k, c)
        do i = 1, below
          right(at + k + i, c) = right(at + k + i, c) - factor(i)*swap
        end do
      end do
    end do
    do c = 1, n_right
      do k = n, 1, -1
        right(at + k, c) = right(at + k, c)/b(diagonal, k)
        do i = 1, min(2*half, k - 1)
          right(at + k - i, c) = right(at + k - i, c) - b(diagonal - i, k)*right(at + k, c)
        end do
      end do
    end do
  end subroutine eliminate_band

  !> The body's part: with X = B^-1 P G and d0 = B^-1 (law - j) in `right`, the momentum
  !> z = G^T d of the step satisfies (1 + G^T X H) z = G^T d0, and d = d0 - X H z.
  pure subroutine add_body(list, body, groups, m, right, ok)
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(contact_groups_t), intent(in) :: groups
    integer, intent(in) :: m
    real(wp), intent(inout) :: right(m, 7)
    logical, intent(out) :: ok
    real(wp) :: gathered(6, 7), matrix(6, 6), z(6), h(6), r(3)
    integer :: p, c, row, i
    gathered = 0.0_wp
    do p = 1, list%n
      i = groups%order(p)
      r = [list%arm(i, 1), list%arm(i, 2), list%arm(i, 3)]
      row = 3*(p - 1)
      do c = 1, 7
        gathered(1, c) = gathered(1, c) + right(row + 1, c)
        gathered(2, c) = gathered(2, c) + right(row + 2, c)
        gathered(3, c) = gathered(3, c) + right(row + 3, c)
        gathered(4, c) = gathered(4, c) + (r(2)*right(row + 3, c) - r(3)*right(row + 2, c))
        gathered(5, c) = gathered(5, c) + (r(3)*right(row + 1, c) - r(1)*right(row + 3, c))
        gathered(6, c) = gathered(6, c) + (r(1)*right(row + 2, c) - r(2)*right(row + 1, c))
      end do
    end do
    do c = 1, 3
      matrix(:, c) = gathered(:, c + 1)*body%inverse_mass
      matrix(:, c + 3) = gathered(:, 5)*body%inverse_inertia(1, c) + gathered(:, 6)*body%inverse_inertia(2, c) &
                         + gathered(:, 7)*body%inverse_inertia(3, c)
    end do
    do c = 1, 6
      matrix(c, c) = matrix(c, c) + 1.0_wp
    end do
    call solve_general(matrix, gathered(:, 1), z, ok)
    if (.not. ok) return
    do c = 1, 3
      h(c) = body%inverse_mass*z(c)
      h(c + 3) = body%inverse_inertia(c, 1)*z(4) + body%inverse_inertia(c, 2)*z(5) + body%inverse_inertia(c, 3)*z(6)
    end do
    do p = 1, 3*list%n
      right(p, 1) = right(p, 1) - (right(p, 2)*h(1) + right(p, 3)*h(2) + right(p, 4)*h(3) + right(p, 5)*h(4) &
                                   + right(p, 6)*h(5) + right(p, 7)*h(6))
    end do
  end subroutine add_body

  !> Velocities after, and how far each impulse is from its law.
  pure subroutine measure(problem, list, work, twist, residual, error)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(coupled_work_t), intent(in) :: work
    real(wp), intent(in) :: twist(6)
    real(wp), intent(out) :: residual   !! largest [m/s]
    real(wp), intent(out) :: error      !! sum of their squares
    real(wp) :: u(3), j(3), off
    integer :: i, c
    residual = 0.0_wp
    error = 0.0_wp
    do i = 1, list%n
      u = present_velocity(problem, list, work, twist, i)
      do c = 1, 3
        problem%after(i, c) = u(c)
      end do
      if (.not. problem%mass(i) > 0.0_wp .or. .not. work%mobility(i) > 0.0_wp) cycle
      j = wanted(problem, work, i, u)
      do c = 1, 3
        off = work%mobility(i)*(j(c) - problem%impulse(i, c))
        residual = max(residual, abs(off))
        error = error + off*off
      end do
    end do
  end subroutine measure

end module castnet_coupled_friction
