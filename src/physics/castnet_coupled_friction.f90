!> Impulses with friction where contacts act on each other through common nodes (cables)
!> or cannot be put into the 6 x 6 form (fixed nodes), and where that form's search failed:
!> Gauss-Seidel on the contacts, each solved in closed form against the present motion of
!> its nodes and the body, and by turns Newton's method on all of them.
!>
!> A contact's own mobility is a_i 1 + G_i H G_i^T, isotropic but for the body's part;
!> bounding that part by its trace makes the local step a proximal one, which is
!> closed-form too. For light nodes on a heavy body the bound costs nothing.
!>
!> With j_i = law_i(u_i) at the local step's mass and P_i = -law_i', Newton's step solves
!> dj_i + P_i (W dj)_i - P_i rho_i dj_i = law_i - j_i, W = C M^-1 C^T + G H G^T all
!> couplings, rho_i the contact's own bound. Sweeps settle who pushes and who slides;
!> Newton's method does the last many digits, which sweeps gain one by one.
module castnet_coupled_friction
  use castnet_kinds, only: wp
  use castnet_contact_list, only: contact_list_t, body_inertia_t, shared_mobility
  use castnet_friction_problem, only: friction_problem_t, cone_impulse, cone_derivative
  implicit none
  private
  public :: coupled_work_t, newton_work_t, reserve_coupled, solve_coupled_friction, number_nodes

  integer, parameter :: max_sweep = 400
  integer, parameter :: first_newton = 6     !! sweeps before Newton's method is tried
  integer, parameter :: max_newton = 20      !! its steps in one try
  integer, parameter :: max_cut = 7          !! halvings of a step
  integer, parameter :: max_newton_size = 250 !! contacts up to which it is tried: its matrix has (3 n)^2 entries
  !> Sweeps stop when no impulse changes velocities by more than this part of the
  !> largest one [-].
  real(wp), parameter :: tolerance = 1.0e-13_wp

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
    real(wp), allocatable :: matrix(:), right(:)
    real(wp), allocatable :: kept(:, :)     !! (3,n) impulses to go back to [N s]
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

  !> Impulses of every contact, from those in `problem%impulse` on.
  subroutine solve_coupled_friction(problem, list, body, work, dense, iterations, residual, converged, twist)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    type(newton_work_t), intent(inout) :: dense
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual   !! [m/s]
    logical, intent(out) :: converged
    real(wp), intent(out) :: twist(6)   !! change of the body's twist, inertial axes
    real(wp) :: largest, change
    integer :: next_newton
    logical :: done
    call number_nodes(list, work)
    call set_mobilities(problem, list, body, work, largest)
    call replay(problem, list, body, work, twist)
    next_newton = first_newton
    do iterations = 1, max_sweep
      call sweep(problem, list, body, work, twist, change)
      if (change <= tolerance*largest) exit
      if (iterations < next_newton .or. list%n > max_newton_size) cycle
      call newton(problem, list, body, work, dense, twist, largest, done)
      if (done) exit
      next_newton = 2*iterations
    end do
    iterations = min(iterations, max_sweep)
    ! The velocities of many small changes have gathered rounding: once more from the impulses.
    call replay(problem, list, body, work, twist)
    call measure(problem, list, work, twist, residual)
    converged = residual <= 1.0e-10_wp*largest
  end subroutine solve_coupled_friction

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

  !> Newton's method from the present impulses, its steps cut until the law is nearer.
  subroutine newton(problem, list, body, work, dense, twist, largest, done)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(inout) :: work
    type(newton_work_t), intent(inout) :: dense
    real(wp), intent(inout) :: twist(6)
    real(wp), intent(in) :: largest
    logical, intent(out) :: done
    real(wp) :: size_now, size_next, t
    integer :: n, step, i, c, cut
    logical :: ok
    n = list%n
    call reserve_matrix(dense, 3*n)
    done = .false.
    do step = 1, max_newton
      call linearise(problem, list, body, work, twist, 3*n, dense%matrix, dense%right, size_now)
      done = size_now <= tolerance*largest
      if (done) return
      call eliminate(3*n, dense%matrix, dense%right, ok)
      if (.not. ok) return
      do i = 1, n
        do c = 1, 3
          dense%kept(c, i) = problem%impulse(i, c)
        end do
      end do
      t = 1.0_wp
      do cut = 0, max_cut
        if (cut == max_cut) t = 0.0_wp
        do i = 1, n
          do c = 1, 3
            problem%impulse(i, c) = dense%kept(c, i) + t*dense%right(3*(i - 1) + c)
          end do
        end do
        call replay(problem, list, body, work, twist)
        call measure(problem, list, work, twist, size_next)
        if (size_next < (1.0_wp - 1.0e-3_wp*t)*size_now) exit
        t = 0.5_wp*t
      end do
      ! Downhill nowhere along the step: sweeps must go on from here.
      if (cut > max_cut) return
    end do
  end subroutine newton

  subroutine reserve_matrix(work, m)
    type(newton_work_t), intent(inout) :: work
    integer, intent(in) :: m
    if (allocated(work%right)) then
      if (size(work%right) >= m) return
      deallocate (work%matrix, work%right, work%kept)
    end if
    allocate (work%matrix((2*m)*(2*m)), work%right(2*m), work%kept(3, (2*m)/3 + 1), source=0.0_wp)
  end subroutine reserve_matrix

  !> Matrix and right side of Newton's step; `size` is the largest difference between an
  !> impulse and its law, as a velocity.
  pure subroutine linearise(problem, list, body, work, twist, m, a, b, size)
    type(friction_problem_t), intent(in) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    type(coupled_work_t), intent(in) :: work
    real(wp), intent(in) :: twist(6)
    integer, intent(in) :: m
    real(wp), intent(inout) :: a(m, m), b(m)
    real(wp), intent(out) :: size
    real(wp) :: u(3), j(3), n(3), before(3), p(3, 3), w(3, 3), shared
    integer :: i, k, c, d, i0, k0
    size = 0.0_wp
    do i = 1, list%n
      i0 = 3*(i - 1)
      if (.not. problem%mass(i) > 0.0_wp .or. .not. work%mobility(i) > 0.0_wp) then
        do c = 1, 3
          a(i0 + c, :) = 0.0_wp
          a(i0 + c, i0 + c) = 1.0_wp
          b(i0 + c) = 0.0_wp
        end do
        cycle
      end if
      u = present_velocity(problem, list, work, twist, i)
      j = wanted(problem, work, i, u)
      n = [problem%normal(i, 1), problem%normal(i, 2), problem%normal(i, 3)]
      do c = 1, 3
        before(c) = u(c) - work%mobility(i)*problem%impulse(i, c)
        b(i0 + c) = j(c) - problem%impulse(i, c)
        size = max(size, work%mobility(i)*abs(b(i0 + c)))
      end do
      p = cone_derivative(1.0_wp/work%mobility(i), before, n, problem%rebound(i), problem%friction, problem%push_only)
      do k = 1, list%n
        k0 = 3*(k - 1)
        w = 0.0_wp
        if (body%free) w = body_mobility(list, body, i, k)
        shared = shared_mobility(list, i, k)
        if (k == i) shared = shared - work%mobility(i)
        do d = 1, 3
          w(d, d) = w(d, d) + shared
        end do
        do d = 1, 3
          do c = 1, 3
            a(i0 + c, k0 + d) = p(c, 1)*w(1, d) + p(c, 2)*w(2, d) + p(c, 3)*w(3, d)
          end do
        end do
      end do
      do c = 1, 3
        a(i0 + c, i0 + c) = a(i0 + c, i0 + c) + 1.0_wp
      end do
    end do
  end subroutine linearise

  !> G_i H G_k^T: velocity of the body's point at i for an impulse at k.
  pure function body_mobility(list, body, i, k) result(w)
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    integer, intent(in) :: i, k
    real(wp) :: w(3, 3), q(3, 3), x, y, z
    integer :: c
    ! q = I^-1 [r_k], [r] v = r x v.
    x = list%arm(k, 1)
    y = list%arm(k, 2)
    z = list%arm(k, 3)
    do c = 1, 3
      q(c, 1) = body%inverse_inertia(c, 2)*z - body%inverse_inertia(c, 3)*y
      q(c, 2) = body%inverse_inertia(c, 3)*x - body%inverse_inertia(c, 1)*z
      q(c, 3) = body%inverse_inertia(c, 1)*y - body%inverse_inertia(c, 2)*x
    end do
    ! w = 1/m - [r_i] q.
    x = list%arm(i, 1)
    y = list%arm(i, 2)
    z = list%arm(i, 3)
    do c = 1, 3
      w(1, c) = -(y*q(3, c) - z*q(2, c))
      w(2, c) = -(z*q(1, c) - x*q(3, c))
      w(3, c) = -(x*q(2, c) - y*q(1, c))
      w(c, c) = w(c, c) + body%inverse_mass
    end do
  end function body_mobility

  !> Gaussian elimination with row exchanges; x in `b`.
  pure subroutine eliminate(m, a, b, ok)
    integer, intent(in) :: m
    real(wp), intent(inout) :: a(m, m), b(m)
    logical, intent(out) :: ok
    real(wp) :: swap, factor
    integer :: k, i, c, pivot
    ok = .true.
    do k = 1, m
      pivot = k
      do i = k + 1, m
        if (abs(a(i, k)) > abs(a(pivot, k))) pivot = i
      end do
      if (.not. abs(a(pivot, k)) > 1.0e-13_wp) then
        ok = .false.
        return
      end if
      if (pivot /= k) then
        do c = k, m
          swap = a(k, c)
          a(k, c) = a(pivot, c)
          a(pivot, c) = swap
        end do
        swap = b(k)
        b(k) = b(pivot)
        b(pivot) = swap
      end if
      factor = 1.0_wp/a(k, k)
      do i = k + 1, m
        a(i, k) = a(i, k)*factor
        b(i) = b(i) - a(i, k)*b(k)
      end do
      do c = k + 1, m
        factor = a(k, c)
        if (.not. abs(factor) > 0.0_wp) cycle
        do i = k + 1, m
          a(i, c) = a(i, c) - a(i, k)*factor
        end do
      end do
    end do
    do k = m, 1, -1
      b(k) = b(k)/a(k, k)
      do i = 1, k - 1
        b(i) = b(i) - a(i, k)*b(k)
      end do
    end do
  end subroutine eliminate

  !> Velocities after, and how far each impulse is from its law.
  pure subroutine measure(problem, list, work, twist, residual)
    type(friction_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(coupled_work_t), intent(in) :: work
    real(wp), intent(in) :: twist(6)
    real(wp), intent(out) :: residual
    real(wp) :: u(3), j(3)
    integer :: i, c
    residual = 0.0_wp
    do i = 1, list%n
      u = present_velocity(problem, list, work, twist, i)
      do c = 1, 3
        problem%after(i, c) = u(c)
      end do
      if (.not. problem%mass(i) > 0.0_wp .or. .not. work%mobility(i) > 0.0_wp) cycle
      j = wanted(problem, work, i, u)
      do c = 1, 3
        residual = max(residual, work%mobility(i)*abs(j(c) - problem%impulse(i, c)))
      end do
    end do
  end subroutine measure

end module castnet_coupled_friction
