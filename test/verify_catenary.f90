!> V5: an elastic cable of 10 m hung over 8 m, its own weight only.
!>
!> Continuous (Irvine, Cable Structures): with tension's horizontal part H and total weight W,
!>   span = H L0/EA + 2 (H/w) asinh(W/(2 H)),   sag = w L0^2/(8 EA) + (H/w)(sqrt(1 + (W/2H)^2) - 1).
!> Lumped, N equal cables and half of each cable's weight at its nodes: cable j carries
!> V_j = (w L0/N)(j - (N + 1)/2), T_j = sqrt(H^2 + V_j^2), l_j = l0 (1 + T_j/EA), and
!> sum l_j H/T_j = span; the sag is the depth of the middle node.
module verify_catenary
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_diagnostics, only: cable_tensions
  use castnet_model, only: model_t, method_rk4
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: chain, ready, fly, words
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_catenary

  real(wp), parameter :: length = 10.0_wp, span = 8.0_wp
  real(wp), parameter :: area = 0.25_wp*pi*1.0e-6_wp           ! a cable of 1 mm
  real(wp), parameter :: stiffness = 4.456e8_wp*area           ! EA [N]
  real(wp), parameter :: g = 9.81_wp, weight = 1440.0_wp*area*g !! per length [N/m]

contains

  subroutine run_verify_catenary()
    call test_case('verify V5: the closed forms give the printed numbers', printed_numbers)
    call test_case('verify V5: a damped cable comes to rest on the lumped catenary', hung_cable)
    call test_case('verify V5: the lumped catenary goes to the continuous one as 1/N^2', refinement)
  end subroutine run_verify_catenary

  !> H by bisection: the span falls short for a small H.
  subroutine continuous(h, sag)
    real(wp), intent(out) :: h, sag
    real(wp) :: low, high, s
    integer :: i
    low = 1.0e-4_wp
    high = 1.0_wp
    do i = 1, 100
      h = 0.5_wp*(low + high)
      s = h*length/stiffness + 2.0_wp*h/weight*asinh(0.5_wp*weight*length/h)
      if (s < span) then
        low = h
      else
        high = h
      end if
    end do
    sag = weight*length**2/(8.0_wp*stiffness) + h/weight*(sqrt(1.0_wp + (0.5_wp*weight*length/h)**2) - 1.0_wp)
  end subroutine continuous

  !> H, node depths (0:n) and tensions for n cables.
  subroutine lumped(n, h, x, depth, tension)
    integer, intent(in) :: n
    real(wp), intent(out) :: h, x(0:n), depth(0:n), tension(n)
    real(wp) :: low, high, l0, v
    integer :: i, j
    l0 = length/n
    low = 1.0e-4_wp
    high = 1.0_wp
    do i = 1, 100
      h = 0.5_wp*(low + high)
      x(0) = 0.0_wp
      depth(0) = 0.0_wp
      do j = 1, n
        v = weight*l0*(j - 0.5_wp*(n + 1))
        tension(j) = sqrt(h**2 + v**2)
        x(j) = x(j - 1) + l0*(1.0_wp + tension(j)/stiffness)*h/tension(j)
        depth(j) = depth(j - 1) - l0*(1.0_wp + tension(j)/stiffness)*v/tension(j)
      end do
      if (x(n) < span) then
        low = h
      else
        high = h
      end if
    end do
  end subroutine lumped

  subroutine printed_numbers()
    real(wp) :: h, sag, x(0:20), depth(0:20), tension(20)
    call expect_close(stiffness, 349.97342161_wp, 'EA', rtol=1.0e-10_wp)
    call expect_close(weight, 0.0110948486154_wp, 'weight', rtol=1.0e-10_wp)
    call continuous(h, sag)
    call expect_close([h, sag], [0.037506218156974_wp, 2.6554360854003_wp], 'continuous', rtol=1.0e-11_wp)
    call lumped(10, h, x(:10), depth(:10), tension(:10))
    call expect_close([h, depth(5)], [0.037406396065605_wp, 2.6697087332229_wp], 'N = 10', rtol=1.0e-11_wp)
    call lumped(20, h, x, depth, tension)
    call expect_close([h, depth(10)], [0.037481199159872_wp, 2.6589775070983_wp], 'N = 20', rtol=1.0e-11_wp)
  end subroutine printed_numbers

  !> From a straight, slightly stretched start, with a drag of the test's own on the nodes:
  !> the cables' damping alone does not stop the swinging. Rest is reached to round-off, so
  !> only round-off is left in the answer.
  subroutine hung_cable()
    integer :: n
    do n = 10, 20, 10
      call hang(n)
    end do
  end subroutine hung_cable

  subroutine hang(n)
    integer, intent(in) :: n
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: s(n + 1), mass(n + 1), h, x(0:n), depth(0:n), tension(n), seen(n), k, step, sag, l0
    logical :: fixed(n + 1)
    integer :: i
    l0 = length/n
    k = stiffness/l0
    s = [(span*i/n, i=0, n)]
    mass = weight/g*l0
    fixed = .false.
    fixed([1, n + 1]) = .true.
    call chain(s, [1.0_wp, 0.0_wp, 0.0_wp], mass, fixed, k, l0, 0.1_wp*sqrt(k*mass(1)), model, state)
    model%gravity = [0.0_wp, 0.0_wp, -g]
    step = 1.2_wp/sqrt(k/mass(1))
    call ready(model, state, work, method_rk4, step)
    do i = 1, nint(60.0_wp/step)
      call fly(model, state, work, 1)
      state%node_velocity = state%node_velocity*(1.0_wp - 2.0_wp*step)
    end do
    call lumped(n, h, x, depth, tension)
    call expect_close(state%node_position(:n + 1, 1), x, 'x', atol=1.0e-10_wp)
    call expect_close(-state%node_position(:n + 1, 3), depth, 'depth', atol=1.0e-10_wp)
    call cable_tensions(model%net, state%node_position, state%node_velocity, seen)
    call expect_close(seen, tension, 'tension', atol=1.0e-10_wp)
    sag = -state%node_position(n/2 + 1, 3)
    i = n/2
    h = seen(i)*(state%node_position(i + 1, 1) - state%node_position(i, 1))/ &
        sqrt(sum((state%node_position(i + 1, :) - state%node_position(i, :))**2))
    call note('V5 N = '//words(real(n, wp))//': H '//words(h)//' N, sag '//words(sag)//' m, off by '//words(sag - depth(n/2)))
  end subroutine hang

  subroutine refinement()
    real(wp) :: h, sag, limit_h, limit_sag, x(0:80), depth(0:80), tension(80), error(3)
    integer :: i, n
    call continuous(limit_h, limit_sag)
    do i = 1, 3
      n = 10*2**i
      call lumped(n, h, x(:n), depth(:n), tension(:n))
      sag = depth(n/2)
      error(i) = sag - limit_sag
    end do
    call expect_close(log(error(1)/error(2))/log(2.0_wp), 2.0_wp, 'order', atol=0.05_wp)
    call expect_close(log(error(2)/error(3))/log(2.0_wp), 2.0_wp, 'order', atol=0.02_wp)
  end subroutine refinement

end module verify_catenary
