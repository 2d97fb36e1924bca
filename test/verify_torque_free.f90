!> V1, V2: a rigid body without torque against Landau & Lifshitz, Mechanics, section 37.
!>
!> With I3 > I2 > I1, 2E = sum I w^2 and M^2 = sum I^2 w^2 > 2 E I2:
!>   w1 = A1 cn(tau), w2 = A2 sn(tau), w3 = A3 dn(tau),
!>   tau = t sqrt((I3 - I2)(M^2 - 2E I1)/(I1 I2 I3)),
!>   k^2 = (I2 - I1)(2E I3 - M^2)/((I3 - I2)(M^2 - 2E I1)),
!> and w2 changes sign every 2 K(k) of tau.
module verify_torque_free
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_model, only: model_t, method_rk4, method_midpoint
  use castnet_rotation, only: rotate, rotation_matrix, quaternion_from_rotation_vector, quaternion_product, congruent
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use castnet_vector, only: cross, dot, norm
  use scenes, only: add_spinning_body, ready, fly, words
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_torque_free

  real(wp), parameter :: back(4) = [1.0_wp, -1.0_wp, -1.0_wp, -1.0_wp] !! times a unit quaternion: its inverse
  real(wp), parameter :: principal(3) = [1.0_wp, 2.0_wp, 3.0_wp]    !! [kg m2]

  !> The closed form's constants.
  type :: top_t
    real(wp) :: amplitude(3), rate, parameter, momentum
  end type top_t

contains

  subroutine run_verify_torque_free()
    call test_case('verify V1: the closed form gives the printed numbers', printed_numbers)
    call test_case('verify V1: a free top follows Jacobi''s functions, order 4', jacobi_top)
    call test_case('verify V1: a full inertia tensor turns as its principal axes do', turned_axes)
    call test_case('verify V1: the attitude precesses as the closed form says', precession)
    call test_case('verify V2: the middle axis flips on time', dzhanibekov)
  end subroutine run_verify_torque_free

  function top_of(w0) result(top)
    real(wp), intent(in) :: w0(3)       !! w2 small at t = 0, w1, w3 > 0
    type(top_t) :: top
    real(wp) :: e2, m2
    associate (i => principal)
      e2 = i(1)*w0(1)**2 + i(2)*w0(2)**2 + i(3)*w0(3)**2
      m2 = i(1)**2*w0(1)**2 + i(2)**2*w0(2)**2 + i(3)**2*w0(3)**2
      top%amplitude(1) = sqrt((e2*i(3) - m2)/(i(1)*(i(3) - i(1))))
      top%amplitude(2) = sqrt((e2*i(3) - m2)/(i(2)*(i(3) - i(2))))
      top%amplitude(3) = sqrt((m2 - e2*i(1))/(i(3)*(i(3) - i(1))))
      top%rate = sqrt((i(3) - i(2))*(m2 - e2*i(1))/(i(1)*i(2)*i(3)))
      top%parameter = (i(2) - i(1))*(e2*i(3) - m2)/((i(3) - i(2))*(m2 - e2*i(1)))
      top%momentum = sqrt(m2)
    end associate
  end function top_of

  !> Angular velocity of a top that starts with w2 = 0.
  function spin_at(top, t) result(w)
    type(top_t), intent(in) :: top
    real(wp), intent(in) :: t
    real(wp) :: w(3), sn, cn, dn
    call jacobi(top%rate*t, top%parameter, sn, cn, dn)
    w = top%amplitude*[cn, sn, dn]
  end function spin_at

  !> sn, cn, dn by the arithmetic-geometric mean (Abramowitz & Stegun 16.4).
  subroutine jacobi(u, m, sn, cn, dn)
    real(wp), intent(in) :: u, m
    real(wp), intent(out) :: sn, cn, dn
    real(wp) :: a(0:12), c(0:12), b, phi, before
    integer :: n, k
    a(0) = 1.0_wp
    b = sqrt(1.0_wp - m)
    c(0) = sqrt(m)
    do n = 1, 12
      a(n) = 0.5_wp*(a(n - 1) + b)
      c(n) = 0.5_wp*(a(n - 1) - b)
      b = sqrt(a(n - 1)*b)
      if (c(n) <= epsilon(1.0_wp)*a(n)) exit
    end do
    n = min(n, 12)
    phi = 2.0_wp**n*a(n)*u
    before = phi
    do k = n, 1, -1
      before = phi
      phi = 0.5_wp*(phi + asin(c(k)*sin(phi)/a(k)))
    end do
    sn = sin(phi)
    cn = cos(phi)
    dn = sqrt(1.0_wp - m*sn**2)
  end subroutine jacobi

  !> K by the arithmetic-geometric mean.
  real(wp) function complete_integral(m) result(k)
    real(wp), intent(in) :: m
    real(wp) :: a, b, c
    integer :: n
    a = 1.0_wp
    b = sqrt(1.0_wp - m)
    do n = 1, 20
      c = 0.5_wp*(a + b)
      b = sqrt(a*b)
      a = c
    end do
    k = 0.5_wp*pi/a
  end function complete_integral

  subroutine printed_numbers()
    type(top_t) :: top
    top = top_of([0.6_wp, 0.0_wp, 1.0_wp])
    call expect_close(spin_at(top, 10.0_wp), [-0.5780626277323345_wp, -0.1607594427061393_wp, 0.9956834171530647_wp], &
                      'w at t = 10', atol=1.0e-13_wp)
    call expect_close(4.0_wp*complete_integral(top%parameter)/top%rate, 6.485572551922632_wp, 'period', atol=1.0e-13_wp)
  end subroutine printed_numbers

  !> w at t = 10 in n steps, body axes turned by `turn` from the principal axes.
  function flown(method, n, turn, attitude) result(w)
    integer, intent(in) :: method, n
    real(wp), intent(in) :: turn(4)                    !! principal to body axes
    real(wp), intent(out), optional :: attitude(4)     !! of the principal axes at the end
    real(wp) :: w(3), inertia(3, 3)
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    inertia = 0.0_wp
    inertia(1, 1) = principal(1)
    inertia(2, 2) = principal(2)
    inertia(3, 3) = principal(3)
    call add_spinning_body(congruent(rotation_matrix(turn), inertia), back*turn, &
                           rotate(turn, [0.6_wp, 0.0_wp, 1.0_wp]), model, state)
    call ready(model, state, work, method, 10.0_wp/n)
    call fly(model, state, work, n)
    w = rotate(back*turn, state%target%angular_velocity)
    if (present(attitude)) attitude = quaternion_product(state%target%attitude, turn)
  end function flown

  !> The error at 1e-10 follows from the order: twice h^4 of the error at a step 8 times as large.
  subroutine jacobi_top()
    real(wp), parameter :: none(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    real(wp) :: reference(3), error(4), order
    integer :: i, n(4)
    n = [250, 500, 1000, 2000]
    reference = spin_at(top_of([0.6_wp, 0.0_wp, 1.0_wp]), 10.0_wp)
    do i = 1, 4
      error(i) = maxval(abs(flown(method_rk4, n(i), none) - reference))
    end do
    order = log(error(1)/error(3))/log(4.0_wp)
    call note('V1 errors at h = 0.04, 0.02, 0.01, 0.005: '//words(error(1))//' '//words(error(2))//' '// &
              words(error(3))//' '//words(error(4)))
    call note('V1 observed order of rk4: '//words(order)//' (0.04 to 0.01), '//words(log(error(3)/error(4))/log(2.0_wp)))
    call expect_close(order, 4.0_wp, 'order of rk4', atol=0.1_wp)
    call expect_close(log(error(3)/error(4))/log(2.0_wp), 4.0_wp, 'order of rk4, last halving', atol=0.1_wp)
    call expect(error(4) <= 1.0e-10_wp, 'within 1e-10 at h = 0.005')
    call expect(error(4) <= 2.0_wp*error(1)/8.0_wp**4, 'as its order says')
    ! The target moves by rk4 in a 'midpoint' run too.
    call expect_close(flown(method_midpoint, 2000, none), reference, 'midpoint run', atol=1.0e-10_wp)
  end subroutine jacobi_top

  !> The same motion seen from axes in which the tensor is full: only round-off differs.
  subroutine turned_axes()
    real(wp) :: turn(4)
    turn = quaternion_from_rotation_vector([0.7_wp, -1.1_wp, 0.4_wp])
    call expect_close(flown(method_rk4, 2000, turn), spin_at(top_of([0.6_wp, 0.0_wp, 1.0_wp]), 10.0_wp), &
                      'w in principal axes', atol=1.0e-10_wp)
  end subroutine turned_axes

  !> About the fixed direction of M the third axis turns at
  !> phi' = M (I1 w1^2 + I2 w2^2)/(I1^2 w1^2 + I2^2 w2^2), and I w stays M in inertial axes.
  subroutine precession()
    real(wp), parameter :: none(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    integer, parameter :: intervals = 4000
    type(top_t) :: top
    real(wp) :: q(4), w(3), axis(3), along(3), across(3), third(3), angle, phi, rate, m0(3), h
    integer :: i
    top = top_of([0.6_wp, 0.0_wp, 1.0_wp])
    m0 = principal*[0.6_wp, 0.0_wp, 1.0_wp]
    w = flown(method_rk4, 4000, none, q)
    call expect_close(rotate(q, principal*w), m0, 'angular momentum in inertial axes', atol=2.0e-11_wp)

    h = 10.0_wp/intervals
    phi = 0.0_wp
    do i = 0, intervals     ! Simpson: h^4/180 of a fourth derivative of order 10, times 10 s
      w = spin_at(top, i*h)
      rate = top%momentum*(principal(1)*w(1)**2 + principal(2)*w(2)**2)/ &
             (principal(1)**2*w(1)**2 + principal(2)**2*w(2)**2)
      if (i == 0 .or. i == intervals) then
        phi = phi + rate*h/3.0_wp
      else
        phi = phi + rate*h/3.0_wp*merge(4.0_wp, 2.0_wp, modulo(i, 2) == 1)
      end if
    end do
    axis = m0/norm(m0)
    third = [0.0_wp, 0.0_wp, 1.0_wp]
    along = third - dot(third, axis)*axis
    along = along/norm(along)
    across = cross(axis, along)
    third = rotate(q, [0.0_wp, 0.0_wp, 1.0_wp])
    angle = atan2(dot(third, across), dot(third, along))
    call expect_close(cos(angle - phi), 1.0_wp, 'precession, cosine', atol=1.0e-15_wp)
    call expect_close(sin(angle - phi), 0.0_wp, 'precession angle', atol=1.0e-10_wp)
    call note('V1 precession after 10 s: '//words(phi)//' rad, off by '//words(sin(angle - phi)))
  end subroutine precession

  !> w0 = (0.01, 1, 0.01): w2 changes sign every 2K/rate; energy and |M| stay to the order.
  subroutine dzhanibekov()
    real(wp), parameter :: w0(3) = [0.01_wp, 1.0_wp, 0.01_wp], none(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    real(wp), parameter :: h = 0.01_wp
    real(wp) :: inertia(3, 3), before, now, crossing(5), flip, energy, momentum
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(top_t) :: top
    integer :: i, n

    top = top_of(w0)
    flip = 2.0_wp*complete_integral(top%parameter)/top%rate
    call expect_close(flip, 19.55286709863_wp, 'flip time', atol=1.0e-9_wp)
    inertia = 0.0_wp
    do i = 1, 3
      inertia(i, i) = principal(i)
    end do
    call add_spinning_body(inertia, none, w0, model, state)
    call ready(model, state, work, method_rk4, h)
    n = 0
    do i = 1, 10000
      before = state%target%angular_velocity(2)
      call fly(model, state, work, 1)
      now = state%target%angular_velocity(2)
      if (before*now > 0.0_wp) cycle
      n = n + 1
      crossing(n) = (i - 1)*h + zero_in_step(before, now)
      if (n == 5) exit
    end do
    do i = 1, n - 1
      call expect_close(crossing(i + 1) - crossing(i), flip, 'time between flips', atol=1.0e-6_wp)
    end do
    call expect(n == 5, 'five flips')
    energy = 0.5_wp*sum(principal*state%target%angular_velocity**2)
    momentum = norm(principal*state%target%angular_velocity)
    call expect_close(energy, 0.5_wp*sum(principal*w0**2), 'energy', rtol=1.0e-9_wp)
    call expect_close(momentum, norm(principal*w0), 'angular momentum', rtol=1.0e-9_wp)
    call expect_close(norm(rotate(state%target%attitude, principal*state%target%angular_velocity) - principal*w0), 0.0_wp, &
                      'direction of the angular momentum', atol=1.0e-8_wp)
    call note('V2 flips after '//words(crossing(2) - crossing(1))//', '//words(crossing(5) - crossing(4))// &
              ' s, closed form '//words(flip)//' s')

  contains

    !> Where w2 is zero in the last step: its cubic through both ends with their rates
    !> (I2 w2' = (I3 - I1) w3 w1), by bisection; error h^4/384 of the fourth derivative.
    real(wp) function zero_in_step(f0, f1) result(t)
      real(wp), intent(in) :: f0, f1
      real(wp) :: low, high, s, value, g0, g1, w(3)
      integer :: k
      w = state%target%angular_velocity
      g1 = (principal(3) - principal(1))/principal(2)*w(3)*w(1)*h
      ! The rate changes by its own derivative over a step; w1, w3 hardly change there.
      g0 = f1 - f0 + (f1 - f0 - g1)
      low = 0.0_wp
      high = 1.0_wp
      do k = 1, 50
        s = 0.5_wp*(low + high)
        value = f0*(1.0_wp + 2.0_wp*s)*(1.0_wp - s)**2 + f1*s*s*(3.0_wp - 2.0_wp*s) + &
                g0*s*(1.0_wp - s)**2 - g1*s*s*(1.0_wp - s)
        if (value*f0 > 0.0_wp) then
          low = s
        else
          high = s
        end if
      end do
      t = low*h
    end function zero_in_step

  end subroutine dzhanibekov

end module verify_torque_free
