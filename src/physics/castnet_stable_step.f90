!> The largest step at which a method is stable on the taut net, damping included.
!>
!> The taut net is linear: M x'' + C x' + K x = 0 with K and C sums over the cables of
!> k and c times n n^T between the ends. The highest frequency and the largest damping
!> rate are the largest eigenvalues of M^-1/2 K M^-1/2 and M^-1/2 C M^-1/2, found by
!> Lanczos and widened to the safe side. Where the directions of the taut cables are
!> not known (nets from a file), n n^T is replaced by its bound 1: any shape of the net
!> is then covered. Limits are those of the method's amplification over all modes with
!> at most that frequency and that damping rate.
module castnet_stable_step
  use castnet_kinds, only: wp
  use castnet_closing_thread, only: thread_weight
  use castnet_model, only: closing_t, method_rk4, method_midpoint, method_adaptive
  use castnet_net, only: net_t
  implicit none
  private
  public :: spectrum_t, spectrum_memory_t, net_spectrum, widen_by_thread, largest_stable_step, amplification

  integer, parameter :: n_kept = 4   !! limits that are remembered: net, with its threads, with its contact

  !> Bounds of the taut net's modes.
  type :: spectrum_t
    real(wp) :: highest_frequency = 0.0_wp     !! undamped, of the taut net [rad/s]
    real(wp) :: largest_damping_rate = 0.0_wp  !! largest eigenvalue of M^-1 C [1/s]
  end type spectrum_t

  !> What was found last, for runs one after the other that share a net (a study's cases):
  !> with it they get the same bits for a comparison of the numbers. For one thread.
  type :: spectrum_memory_t
    private
    integer, allocatable :: cable_nodes(:, :)
    real(wp), allocatable :: number(:)         !! all others that the spectrum follows from
    type(spectrum_t) :: spectrum
    integer :: n_limit = 0
    integer :: method(n_kept) = 0
    type(spectrum_t) :: limit_of(n_kept)
    real(wp) :: limit(n_kept) = 0.0_wp         !! [s]
  end type spectrum_memory_t

  integer, parameter :: most_iterations = 300
  integer, parameter :: look_interval = 10     !! iterations between two looks at the Ritz value
  real(wp), parameter :: settled = 1.0e-6_wp   !! relative change of the Ritz value that ends the iteration
  real(wp), parameter :: safety = 1.0e-4_wp    !! Ritz values come from below: widened by this

contains

  !> Bounds for a net. `position`: a state in which the cables point as in the taut net
  !> (the stowed square net does); without it the bound for any shape.
  subroutine net_spectrum(net, spectrum, position, memory)
    type(net_t), intent(in) :: net
    type(spectrum_t), intent(out) :: spectrum
    real(wp), intent(in), optional :: position(:, :)   !! (>=n_node,3) [m]
    type(spectrum_memory_t), intent(inout), optional :: memory
    logical :: known

    known = .false.
    if (present(memory)) call recall_net(memory, net, position, known)
    if (known) then
      spectrum = memory%spectrum
    else
      call find_spectrum(net, spectrum, position)
      if (present(memory)) memory%spectrum = spectrum
    end if
  end subroutine net_spectrum

  !> Is this the net of the memory? If not, it is from now on.
  subroutine recall_net(memory, net, position, known)
    type(spectrum_memory_t), intent(inout) :: memory
    type(net_t), intent(in) :: net
    real(wp), intent(in), optional :: position(:, :)
    logical, intent(out) :: known
    real(wp), allocatable :: number(:)
    number = [net%axial_stiffness, net%natural_length, net%damping, net%inverse_mass(:net%n_node)]
    if (present(position)) number = [number, reshape(position(:net%n_node, :), [3*net%n_node])]
    known = .false.
    if (allocated(memory%number)) known = size(number) == size(memory%number) &
        .and. size(net%cable_nodes) == size(memory%cable_nodes)
    if (known) known = all(net%cable_nodes == memory%cable_nodes) .and. .not. any(abs(number - memory%number) > 0.0_wp)
    if (known) return
    memory%cable_nodes = net%cable_nodes
    call move_alloc(number, memory%number)
  end subroutine recall_net

  !> The spectrum by computation.
  subroutine find_spectrum(net, spectrum, position)
    type(net_t), intent(in) :: net
    type(spectrum_t), intent(out) :: spectrum
    real(wp), intent(in), optional :: position(:, :)
    real(wp), allocatable :: direction(:, :), weight(:)
    real(wp) :: d(3), length
    integer :: e

    if (net%n_cable == 0) return
    allocate (direction(3, net%n_cable), weight(net%n_cable))
    direction = 0.0_wp
    direction(1, :) = 1.0_wp      ! all along one line: the graph Laplacian, n n^T <= 1
    if (present(position)) then
      do e = 1, net%n_cable
        d = position(net%cable_nodes(2, e), :) - position(net%cable_nodes(1, e), :)
        length = sqrt(d(1)**2 + d(2)**2 + d(3)**2)
        if (length > 0.0_wp) direction(:, e) = d/length
      end do
    end if
    weight = net%axial_stiffness/net%natural_length
    spectrum%highest_frequency = sqrt(largest_eigenvalue(net, direction, weight))
    if (any(net%damping > 0.0_wp)) spectrum%largest_damping_rate = largest_eigenvalue(net, direction, net%damping)
  end subroutine find_spectrum

  !> The same bounds with the closing threads pulling: each adds k_t g g^T to K and, but with
  !> midpoint, which takes it implicitly (castnet_thread_flow), c_t g g^T to C, which couples
  !> all nodes of a side. Largest eigenvalues of sums are at most the sums of largest
  !> eigenvalues. Left out: the stiffness T/l across a taut piece
  !> of length l, which has no bound where nodes meet; measured on the rocket's net, the
  !> damping's share sets the limit.
  subroutine widen_by_thread(spectrum, closing, net, method)
    type(spectrum_t), intent(inout) :: spectrum
    type(closing_t), intent(in) :: closing
    type(net_t), intent(in) :: net
    integer, intent(in) :: method
    real(wp) :: weight
    weight = thread_weight(closing, net)
    spectrum%highest_frequency = sqrt(spectrum%highest_frequency**2 + closing%stiffness*weight)
    if (method == method_midpoint) return
    spectrum%largest_damping_rate = spectrum%largest_damping_rate + closing%damping*weight
  end subroutine widen_by_thread

  !> Largest eigenvalue of M^-1/2 (sum w n n^T) M^-1/2 by Lanczos, widened.
  real(wp) function largest_eigenvalue(net, direction, weight) result(largest)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: direction(:, :)  !! (3,n_cable)
    real(wp), intent(in) :: weight(:)        !! (n_cable)
    real(wp), allocatable :: q(:, :), before(:, :), r(:, :), root(:), scaled(:, :), along(:, :)
    real(wp) :: alpha(most_iterations), beta(0:most_iterations), previous
    integer :: n, k, i, j

    n = net%n_node
    allocate (q(n, 3), before(n, 3), r(n, 3), root(n), scaled(n, 3))
    root = sqrt(net%inverse_mass(:n))
    ! sqrt(w) n by slot: the kernel's own order, which vectorises.
    allocate (along(net%plan%n_slot, 3), source=0.0_wp)
    do i = 1, net%n_cable
      along(net%plan%slot_of_cable(i), :) = sqrt(weight(i))*direction(:, i)
    end do
    ! A rough start has a part in every mode; it only has to be the same every time.
    do j = 1, 3
      do i = 1, n
        q(i, j) = merge(1.0_wp + 0.5_wp*modulo(7*i + 3*j, 11)/11.0_wp, -1.0_wp - 0.5_wp*modulo(5*i + j, 13)/13.0_wp, &
                        modulo(modulo(i, 5)*(modulo(i, 5) + 3*j) + i/7, 5) > 1)
      end do
    end do
    where (spread(root, 2, 3) == 0.0_wp) q = 0.0_wp
    largest = 0.0_wp
    beta(0) = sqrt(inner(3*n, q, q))
    if (beta(0) == 0.0_wp) return
    q = q/beta(0)
    before = 0.0_wp
    beta(0) = 0.0_wp
    previous = 0.0_wp
    do k = 1, most_iterations
      call apply(q, r)
      r = r - beta(k - 1)*before
      alpha(k) = inner(3*n, r, q)
      r = r - alpha(k)*q
      beta(k) = sqrt(inner(3*n, r, r))
      if (modulo(k, look_interval) == 0 .or. beta(k) <= 1.0e-12_wp*abs(alpha(1)) .or. k == most_iterations) then
        largest = largest_tridiagonal(k, alpha, beta(1:))
        if (abs(largest - previous) <= settled*largest .or. beta(k) <= 1.0e-12_wp*abs(alpha(1))) exit
        previous = largest
      end if
      before = q
      q = r/beta(k)
    end do
    largest = largest*(1.0_wp + safety)

  contains

    subroutine apply(x, y)
      real(wp), intent(in) :: x(:, :)
      real(wp), intent(out) :: y(:, :)
      real(wp) :: pull
      integer :: c, d, i, a, b, m, slot
      do c = 1, 3
        do i = 1, n
          scaled(i, c) = root(i)*x(i, c)
          y(i, c) = 0.0_wp
        end do
      end do
      associate (plan => net%plan)
        do d = 1, plan%n_diagonal
          m = plan%last(d) - plan%first(d) + 1
          call add_cables(m, plan%first(d), plan%offset(d), n, plan%n_slot, plan%start(d), along, scaled, y)
        end do
        do i = 1, plan%n_loose
          a = plan%loose_a(i)
          b = plan%loose_b(i)
          slot = plan%loose_start + i - 1
          pull = along(slot, 1)*(scaled(a, 1) - scaled(b, 1)) + along(slot, 2)*(scaled(a, 2) - scaled(b, 2)) &
                 + along(slot, 3)*(scaled(a, 3) - scaled(b, 3))
          do c = 1, 3
            y(a, c) = y(a, c) + pull*along(slot, c)
            y(b, c) = y(b, c) - pull*along(slot, c)
          end do
        end do
      end associate
      do c = 1, 3
        do i = 1, n
          y(i, c) = root(i)*y(i, c)
        end do
      end do
    end subroutine apply

  end function largest_eigenvalue

  !> y += n (n . (x_a - x_b)) at a, and its opposite at b, for m cables (a, a + offset), ...
  pure subroutine add_cables(m, first, offset, n, n_slot, start, along, x, y)
    integer, intent(in) :: m, first, offset, n, n_slot, start
    real(wp), intent(in) :: along(n_slot, 3), x(n, 3)
    real(wp), intent(inout) :: y(n, 3)
    integer, parameter :: block = 256
    real(wp) :: s(block)
    integer :: k, c, i, j, e, length
    do i = first, first + m - 1, block
      length = min(block, first + m - i)
      j = i + offset
      e = start + i - first
      do k = 0, length - 1
        s(k + 1) = along(e + k, 1)*(x(i + k, 1) - x(j + k, 1)) + along(e + k, 2)*(x(i + k, 2) - x(j + k, 2)) &
                   + along(e + k, 3)*(x(i + k, 3) - x(j + k, 3))
      end do
      do c = 1, 3
        do k = 0, length - 1
          y(i + k, c) = y(i + k, c) + s(k + 1)*along(e + k, c)
        end do
        do k = 0, length - 1
          y(j + k, c) = y(j + k, c) - s(k + 1)*along(e + k, c)
        end do
      end do
    end do
  end subroutine add_cables

  !> Sum of x y in eight lanes.
  pure real(wp) function inner(n, x, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n), y(n)
    real(wp) :: part(8)
    integer :: i, k
    part = 0.0_wp
    do i = 0, n - 8, 8
      do k = 1, 8
        part(k) = part(k) + x(i + k)*y(i + k)
      end do
    end do
    do i = n - modulo(n, 8) + 1, n
      part(1) = part(1) + x(i)*y(i)
    end do
    inner = ((part(1) + part(2)) + (part(3) + part(4))) + ((part(5) + part(6)) + (part(7) + part(8)))
  end function inner

  !> Largest eigenvalue of a symmetric tridiagonal matrix by Sturm bisection.
  pure real(wp) function largest_tridiagonal(n, alpha, beta) result(value)
    integer, intent(in) :: n
    real(wp), intent(in) :: alpha(:), beta(:)
    integer, parameter :: n_probe = 8
    real(wp) :: low, high, off, probe(n_probe), d(n_probe), top(n_probe)
    integer :: i, k, step

    low = maxval(alpha(:n))
    high = low
    do i = 1, n
      off = 0.0_wp
      if (i > 1) off = off + beta(i - 1)
      if (i < n) off = off + beta(i)
      high = max(high, alpha(i) + off)
    end do
    ! Three halvings at a time: divisions wait for each other in one sequence, not in seven.
    do step = 1, 20
      probe(4) = 0.5_wp*(low + high)
      probe(2) = 0.5_wp*(low + probe(4))
      probe(6) = 0.5_wp*(probe(4) + high)
      probe(1) = 0.5_wp*(low + probe(2))
      probe(3) = 0.5_wp*(probe(2) + probe(4))
      probe(5) = 0.5_wp*(probe(4) + probe(6))
      probe(7) = 0.5_wp*(probe(6) + high)
      probe(8) = high
      top = -huge(1.0_wp)
      d = 1.0_wp
      do i = 1, n
        off = 0.0_wp
        if (i > 1) off = beta(i - 1)**2
        do k = 1, n_probe
          d(k) = alpha(i) - probe(k) - off/d(k)
          top(k) = max(top(k), d(k))
          d(k) = merge(-1.0e-290_wp, d(k), abs(d(k)) < 1.0e-290_wp)
        end do
      end do
      ! Is some eigenvalue above the probe?
      k = 4
      do i = 1, 3
        if (top(k) > 0.0_wp) then
          low = probe(k)
          k = k + 2/i
        else
          high = probe(k)
          k = k - 2/i
        end if
      end do
    end do
    value = high
  end function largest_tridiagonal

  !> The largest h at which the method damps every mode of the spectrum; huge: no limit.
  real(wp) function largest_stable_step(method, spectrum, memory) result(h)
    integer, intent(in) :: method
    type(spectrum_t), intent(in) :: spectrum
    type(spectrum_memory_t), intent(inout), optional :: memory
    integer :: k

    if (present(memory)) then
      do k = 1, min(memory%n_limit, n_kept)
        associate (of => memory%limit_of(k))
          if (memory%method(k) /= method .or. abs(of%highest_frequency - spectrum%highest_frequency) > 0.0_wp &
              .or. abs(of%largest_damping_rate - spectrum%largest_damping_rate) > 0.0_wp) cycle
        end associate
        h = memory%limit(k)
        return
      end do
    end if
    h = find_limit(method, spectrum)
    if (.not. present(memory)) return
    k = modulo(memory%n_limit, n_kept) + 1
    memory%n_limit = memory%n_limit + 1
    memory%method(k) = method
    memory%limit_of(k) = spectrum
    memory%limit(k) = h
  end function largest_stable_step

  !> The same by computation.
  pure real(wp) function find_limit(method, spectrum) result(h)
    integer, intent(in) :: method
    type(spectrum_t), intent(in) :: spectrum
    integer, parameter :: grid = 400, coarse = 8
    real(wp) :: low, high
    integer :: step, stretch

    h = huge(1.0_wp)
    if (spectrum%highest_frequency <= 0.0_wp .and. spectrum%largest_damping_rate <= 0.0_wp) return
    high = 4.0_wp/max(spectrum%highest_frequency, 0.5_wp*spectrum%largest_damping_rate)
    ! Walk up from a small step, so that an island of stability beyond the limit does not
    ! count; coarsely first, then over the last stretch again.
    do stretch = coarse, grid, coarse
      if (.not. all_stable(method, spectrum, high*stretch/grid)) exit
    end do
    low = 0.0_wp
    if (stretch > coarse) low = high*(stretch - coarse)/grid
    do step = stretch - coarse + 1, grid
      if (.not. all_stable(method, spectrum, high*step/grid)) exit
      low = high*step/grid
    end do
    high = high*step/grid
    do step = 1, 40
      h = 0.5_wp*(low + high)
      if (all_stable(method, spectrum, h)) then
        low = h
      else
        high = h
      end if
    end do
    h = low
  end function find_limit

  !> Are all modes up to the spectrum's corner stable at h?
  pure logical function all_stable(method, spectrum, h)
    integer, intent(in) :: method
    type(spectrum_t), intent(in) :: spectrum
    real(wp), intent(in) :: h
    integer, parameter :: samples = 12
    real(wp), parameter :: slack = 1.0e-9_wp
    real(wp) :: w, g
    integer :: i

    w = h*spectrum%highest_frequency
    g = h*spectrum%largest_damping_rate
    all_stable = .true.
    do i = 1, samples
      all_stable = all_stable .and. amplification(method, w, g*i/samples) <= 1.0_wp + slack
      all_stable = all_stable .and. amplification(method, w*i/samples, g) <= 1.0_wp + slack
    end do
    all_stable = all_stable .and. amplification(method, w, 0.0_wp) <= 1.0_wp + slack
    all_stable = all_stable .and. amplification(method, 0.0_wp, g) <= 1.0_wp + slack
  end function all_stable

  !> Largest factor by which one step multiplies a mode x'' + (g/h) x' + (w/h)^2 x = 0.
  !> rk4: |R(z)|, R = 1 + z + z^2/2 + z^3/6 + z^4/24, at both roots z of z^2 + g z + w^2.
  !> midpoint: spectral radius of the step's 3 x 3 matrix on (x, h v, h^2 a).
  pure real(wp) function amplification(method, w, g) result(factor)
    integer, intent(in) :: method
    real(wp), intent(in) :: w  !! h omega [-]
    real(wp), intent(in) :: g  !! h gamma [-]
    complex(wp) :: z(2), root
    integer :: i

    factor = 0.0_wp
    select case (method)
    case (method_midpoint)
      factor = midpoint_radius(w*w, g)
    case default
      root = sqrt(cmplx(0.25_wp*g*g - w*w, 0.0_wp, wp))
      z(1) = -0.5_wp*g + root
      z(2) = -0.5_wp*g - root
      do i = 1, 2
        factor = max(factor, abs(1.0_wp + z(i)*(1.0_wp + z(i)/2.0_wp*(1.0_wp + z(i)/3.0_wp*(1.0_wp + z(i)/4.0_wp)))))
      end do
    end select
  end function amplification

  !> Spectral radius of drift-kick-drift with extrapolated damping velocity: with
  !> A' = -W (x + V/2) - G (V + A/2), V' = V + A', x' = x + V + A'/2, the characteristic
  !> polynomial is l^3 + a2 l^2 + a1 l + a0 with the coefficients below.
  pure real(wp) function midpoint_radius(w, g) result(radius)
    real(wp), intent(in) :: w  !! (h omega)^2 [-]
    real(wp), intent(in) :: g  !! h gamma [-]
    real(wp) :: a2, a1, a0, root, p, q, d, s, quadratic_b, quadratic_c
    integer :: k

    ! x'' eliminated: (l-1)^2 l + W l (l+1)^2/4 ... written out from the 3 x 3 matrix.
    a2 = -2.0_wp + w + 1.5_wp*g
    a1 = 1.0_wp - 2.0_wp*g
    a0 = 0.5_wp*g
    ! One real root by Newton from outside the roots' bound, then the other two.
    root = -(1.0_wp + max(abs(a2), abs(a1), abs(a0)))
    do k = 1, 200
      p = ((root + a2)*root + a1)*root + a0
      q = (3.0_wp*root + 2.0_wp*a2)*root + a1
      if (q == 0.0_wp) exit
      s = p/q
      root = root - s
      if (abs(s) <= 1.0e-15_wp*max(1.0_wp, abs(root))) exit
    end do
    quadratic_b = a2 + root
    quadratic_c = a1 + root*quadratic_b
    d = 0.25_wp*quadratic_b**2 - quadratic_c
    if (d >= 0.0_wp) then
      radius = max(abs(root), 0.5_wp*abs(quadratic_b) + sqrt(d))
    else
      radius = max(abs(root), sqrt(max(quadratic_c, 0.0_wp)))
    end if
  end function midpoint_radius

end module castnet_stable_step
