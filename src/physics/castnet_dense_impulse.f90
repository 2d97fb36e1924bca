!> The paper's own way (equations 13 to 17): build the dense matrix M of all contacts
!> and solve M j = g by elimination. For comparison with the reduced form; it allocates
!> its matrix at every call and costs O(n^3).
!>
!> With `push_only` the complementarity problem is solved by block principal pivoting
!> (Judice and Pires 1994), which ends for every symmetric positive definite M.
module castnet_dense_impulse
  use castnet_kinds, only: wp
  use castnet_contact_list, only: contact_list_t, body_inertia_t, shared_mobility
  use castnet_impulse_solver, only: impulse_problem_t, inverse_inertia_times, pad
  implicit none
  private
  public :: solve_dense, delassus_matrix, solve_linear

contains

  !> M of equation 15, with the coupling of contacts that share a node:
  !> M = C W C^T + B H B^T [1/kg].
  function delassus_matrix(list, body, row) result(m)
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: row(:, :)  !! (>= n,6) [n, r x n]
    real(wp), allocatable :: m(:, :)
    real(wp) :: h(6), b(6), cosine
    integer :: i, k
    allocate (m(list%n, list%n))
    do k = 1, list%n
      b = row(k, :)
      h = inverse_inertia_times(body, b)
      do i = 1, list%n
        cosine = list%normal(i, 1)*list%normal(k, 1) + list%normal(i, 2)*list%normal(k, 2) + list%normal(i, 3)*list%normal(k, 3)
        m(i, k) = row(i, 1)*h(1) + row(i, 2)*h(2) + row(i, 3)*h(3) + row(i, 4)*h(4) + row(i, 5)*h(5) + row(i, 6)*h(6) &
                  + cosine*shared_mobility(list, i, k)
      end do
    end do
  end function delassus_matrix

  !> Impulses of the whole list by dense algebra. `iterations` counts solves.
  subroutine solve_dense(problem, list, body, iterations, residual, converged)
    type(impulse_problem_t), intent(inout) :: problem
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    integer, intent(out) :: iterations
    real(wp), intent(out) :: residual  !! largest violation of the contact conditions [m/s]
    logical, intent(out) :: converged
    real(wp), allocatable :: m(:, :), slack(:)
    logical, allocatable :: pushes(:), wrong(:)
    integer :: n, n_wrong, least, patience, last, n_lane, i
    real(wp) :: largest
    n = problem%n
    call pad(problem, n_lane)
    m = delassus_matrix(list, body, problem%row)
    allocate (slack(n), wrong(n))
    pushes = problem%weight(1:n) > 0.0_wp .and. (problem%need(1:n) > 0.0_wp .or. .not. problem%push_only)
    least = n + 1
    patience = 10
    converged = .false.
    largest = maxval(abs(problem%need(1:n)))
    do iterations = 1, 50 + 10*n
      call solve_on(m, pushes, problem%need(1:n), problem%impulse)
      if (.not. problem%push_only) then
        converged = .true.
        exit
      end if
      call slacks(m, problem%impulse, problem%need, slack)
      ! Below rounding neither sign is wrong; the impulse is clamped at the end.
      wrong = merge(problem%impulse(1:n) < 0.0_wp, slack < -1.0e-13_wp*largest, pushes) .and. problem%weight(1:n) > 0.0_wp
      n_wrong = count(wrong)
      if (n_wrong == 0) then
        converged = .true.
        exit
      end if
      if (n_wrong < least) then
        least = n_wrong
        patience = 10
      else if (patience > 0) then
        patience = patience - 1
      else
        ! One at a time, the last first: Murty's rule, which cannot cycle.
        last = findloc(wrong, .true., dim=1, back=.true.)
        wrong = .false.
        wrong(last) = .true.
      end if
      pushes = pushes .neqv. wrong
    end do
    if (problem%push_only) problem%impulse(1:n) = max(0.0_wp, problem%impulse(1:n))
    call slacks(m, problem%impulse, problem%need, slack)
    problem%gained(1:n) = slack + problem%need(1:n)
    residual = 0.0_wp
    do i = 1, n
      if (.not. problem%weight(i) > 0.0_wp) cycle
      residual = max(residual, merge(abs(slack(i)), max(0.0_wp, -slack(i)), &
                                     problem%impulse(i) > 0.0_wp .or. .not. problem%push_only))
    end do
  end subroutine solve_dense

  !> M_SS j_S = g_S on the chosen contacts, zero elsewhere. A singular M_SS (two nodes
  !> and their cable on one face) is made regular by a hair on its diagonal, which
  !> moves the velocities by 1e-13 of themselves.
  subroutine solve_on(m, chosen, need, impulse)
    real(wp), intent(in) :: m(:, :), need(:)
    logical, intent(in) :: chosen(:)
    real(wp), intent(inout) :: impulse(:)
    real(wp), allocatable :: a(:, :), b(:)
    integer, allocatable :: set(:)
    logical :: regular
    integer :: i, k
    set = pack([(i, i=1, size(chosen))], chosen)
    k = size(set)
    impulse(1:size(chosen)) = 0.0_wp
    if (k == 0) return
    allocate (a(k, k), b(k))
    a(:, :) = m(set, set)
    b(:) = need(set)
    call solve_linear(k, a, b, regular)
    if (.not. regular) then
      a(:, :) = m(set, set)
      b(:) = need(set)
      do i = 1, k
        a(i, i) = a(i, i)*(1.0_wp + 1.0e-13_wp)
      end do
      call solve_linear(k, a, b, regular)
    end if
    if (regular) impulse(set) = b
  end subroutine solve_on

  subroutine slacks(m, impulse, need, slack)
    real(wp), intent(in) :: m(:, :), impulse(:), need(:)
    real(wp), intent(out) :: slack(:)
    integer :: i
    slack = -need(1:size(slack))
    do i = 1, size(slack)
      slack = slack + m(:, i)*impulse(i)
    end do
  end subroutine slacks

  !> Solve A x = b by elimination with row exchanges, as LAPACK's dgesv does; column by
  !> column, so that the inner loop runs along memory. Not regular: a pivot is zero or NaN,
  !> and b has no meaning.
  pure subroutine solve_linear(n, a, b, regular)
    integer, intent(in) :: n
    real(wp), intent(inout) :: a(n, n)  !! the matrix; L and U on return
    real(wp), intent(inout) :: b(n)     !! the right side; x on return
    logical, intent(out) :: regular
    integer :: pivot(n), j, k
    regular = .false.
    do j = 1, n
      do k = 1, j - 1
        call exchange_rows(n, k, pivot(k), a(:, j))
      end do
      do k = 1, j - 1
        a(k + 1:n, j) = a(k + 1:n, j) - a(k, j)*a(k + 1:n, k)
      end do
      pivot(j) = j - 1 + maxloc(abs(a(j:n, j)), dim=1)
      if (.not. abs(a(pivot(j), j)) > 0.0_wp) return
      do k = 1, j
        call exchange_rows(n, j, pivot(j), a(:, k))
      end do
      a(j + 1:n, j) = a(j + 1:n, j)/a(j, j)
    end do
    do k = 1, n
      call exchange_rows(n, k, pivot(k), b)
    end do
    do k = 1, n
      b(k + 1:n) = b(k + 1:n) - b(k)*a(k + 1:n, k)
    end do
    do k = n, 1, -1
      b(k) = b(k)/a(k, k)
      b(1:k - 1) = b(1:k - 1) - b(k)*a(1:k - 1, k)
    end do
    regular = .true.
  end subroutine solve_linear

  pure subroutine exchange_rows(n, i, k, column)
    integer, intent(in) :: n, i, k
    real(wp), intent(inout) :: column(n)
    real(wp) :: held
    held = column(i)
    column(i) = column(k)
    column(k) = held
  end subroutine exchange_rows

end module castnet_dense_impulse
