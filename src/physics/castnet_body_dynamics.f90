!> The rigid target: Newton's and Euler's equations (paper eq. 1), attitude as a unit
!> quaternion from body to inertial axes, angular velocity in body axes.
module castnet_body_dynamics
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, target_t
  use castnet_state, only: body_state_t
  implicit none
  private
  public :: body_rate_t, body_rate, body_advance, body_rk4, body_alone, body_kick, orbital_acceleration

  !> Time derivative of a body state.
  type :: body_rate_t
    real(wp) :: position(3)         !! [m/s]
    real(wp) :: velocity(3)         !! [m/s2]
    real(wp) :: attitude(4)         !! [1/s]
    real(wp) :: angular_velocity(3) !! [rad/s2]
  end type body_rate_t

contains

  !> Rates under external and extra forces, gravity and the orbital frame.
  !> r'' = F/m + g; q' = q (0, w)/2 [less the frame's turning]; w' = I^-1 (t - w x I w).
  pure function body_rate(model, body, force, torque) result(rate)
    type(model_t), intent(in) :: model
    type(body_state_t), intent(in) :: body
    real(wp), intent(in) :: force(3)   !! besides external_force, inertial [N]
    real(wp), intent(in) :: torque(3)  !! besides external_torque, body axes [N m]
    type(body_rate_t) :: rate
    real(wp) :: w(3), h(3), t(3), q(4), n

    w = body%angular_velocity
    q = body%attitude
    n = model%orbit_rate
    associate (target => model%target)
      rate%position = body%velocity
      rate%velocity = (force + target%external_force)*target%inverse_mass + model%gravity
      if (n /= 0.0_wp) rate%velocity = rate%velocity + orbital_acceleration(n, body%position, body%velocity)

      rate%attitude(1) = 0.5_wp*(-q(2)*w(1) - q(3)*w(2) - q(4)*w(3))
      rate%attitude(2) = 0.5_wp*(q(1)*w(1) + q(3)*w(3) - q(4)*w(2))
      rate%attitude(3) = 0.5_wp*(q(1)*w(2) + q(4)*w(1) - q(2)*w(3))
      rate%attitude(4) = 0.5_wp*(q(1)*w(3) + q(2)*w(2) - q(3)*w(1))
      if (n /= 0.0_wp) then
        ! The frame turns at (0,-n,0): q' = q (0,w)/2 - (0,0,-n,0) q/2.
        rate%attitude(1) = rate%attitude(1) - 0.5_wp*n*q(3)
        rate%attitude(2) = rate%attitude(2) + 0.5_wp*n*q(4)
        rate%attitude(3) = rate%attitude(3) + 0.5_wp*n*q(1)
        rate%attitude(4) = rate%attitude(4) - 0.5_wp*n*q(2)
      end if

      h = product3(target%inertia, w)
      t(1) = torque(1) + target%external_torque(1) - (w(2)*h(3) - w(3)*h(2))
      t(2) = torque(2) + target%external_torque(2) - (w(3)*h(1) - w(1)*h(3))
      t(3) = torque(3) + target%external_torque(3) - (w(1)*h(2) - w(2)*h(1))
      rate%angular_velocity = product3(target%inverse_inertia, t)
    end associate
  end function body_rate

  !> Acceleration in a frame on a circular orbit of rate n, x along the velocity, y
  !> against the orbit normal, z to Earth (Clohessy-Wiltshire, design.md section 1).
  pure function orbital_acceleration(n, x, v) result(a)
    real(wp), intent(in) :: n    !! orbit rate [rad/s]
    real(wp), intent(in) :: x(3) !! [m]
    real(wp), intent(in) :: v(3) !! [m/s]
    real(wp) :: a(3)             !! [m/s2]
    a(1) = 2.0_wp*n*v(3)
    a(2) = -n*n*x(2)
    a(3) = 3.0_wp*n*n*x(3) - 2.0_wp*n*v(1)
  end function orbital_acceleration

  !> body + h rate.
  pure function body_advance(body, rate, h) result(moved)
    type(body_state_t), intent(in) :: body
    type(body_rate_t), intent(in) :: rate
    real(wp), intent(in) :: h
    type(body_state_t) :: moved
    moved%position = body%position + h*rate%position
    moved%velocity = body%velocity + h*rate%velocity
    moved%attitude = body%attitude + h*rate%attitude
    moved%angular_velocity = body%angular_velocity + h*rate%angular_velocity
  end function body_advance

  !> Combine the four slopes of a Runge-Kutta step and renormalise the quaternion.
  pure subroutine body_rk4(body, k1, k2, k3, k4, h)
    type(body_state_t), intent(inout) :: body
    type(body_rate_t), intent(in) :: k1, k2, k3, k4
    real(wp), intent(in) :: h
    real(wp) :: s
    s = h/6.0_wp
    body%position = body%position + s*(k1%position + 2.0_wp*(k2%position + k3%position) + k4%position)
    body%velocity = body%velocity + s*(k1%velocity + 2.0_wp*(k2%velocity + k3%velocity) + k4%velocity)
    body%attitude = body%attitude + s*(k1%attitude + 2.0_wp*(k2%attitude + k3%attitude) + k4%attitude)
    body%angular_velocity = body%angular_velocity + s*(k1%angular_velocity &
      + 2.0_wp*(k2%angular_velocity + k3%angular_velocity) + k4%angular_velocity)
    body%attitude = body%attitude/sqrt(body%attitude(1)**2 + body%attitude(2)**2 + body%attitude(3)**2 + body%attitude(4)**2)
  end subroutine body_rk4

  !> One Runge-Kutta step of the body outside any orbital frame with nothing but its external
  !> force and torque: `body_rate`, `body_advance` and `body_rk4` written out for the one case
  !> that nearly every step is, to the same bits at a sixth of the time.
  pure subroutine body_alone(model, body, h, turn)
    type(model_t), intent(in) :: model
    type(body_state_t), intent(inout) :: body
    real(wp), intent(in) :: h                !! [s]
    real(wp), intent(out) :: turn(3)         !! integral of the spin by the step's own rule, body axes [rad]
    real(wp) :: a, middle, v, s, torque(3), inertia(3, 3), inverse(3, 3), ahead(3)
    real(wp) :: q(4), q1(4), q2(4), q3(4), q4(4)
    real(wp) :: x(4), y(4), z(4), x_rate(4), y_rate(4), z_rate(4) !! spin at the four stages, and its rates
    integer :: c, k
    s = h/6.0_wp
    do c = 1, 3
      a = (0.0_wp + model%target%external_force(c))*model%target%inverse_mass + model%gravity(c)
      v = body%velocity(c)
      middle = v + (0.5_wp*h)*a
      body%position(c) = body%position(c) + s*(v + 2.0_wp*(middle + middle) + (v + h*a))
      body%velocity(c) = v + s*(a + 2.0_wp*(a + a) + a)
    end do
    torque = 0.0_wp + model%target%external_torque
    inertia = model%target%inertia
    inverse = model%target%inverse_inertia
    ahead = [0.5_wp*h, 0.5_wp*h, h]
    ! The spin needs no attitude: by components first, so that no number waits for a vector of them.
    x(1) = body%angular_velocity(1)
    y(1) = body%angular_velocity(2)
    z(1) = body%angular_velocity(3)
    do k = 1, 4
      call spin_rate(x(k), y(k), z(k), x_rate(k), y_rate(k), z_rate(k))
      if (k == 4) exit
      x(k + 1) = x(1) + ahead(k)*x_rate(k)
      y(k + 1) = y(1) + ahead(k)*y_rate(k)
      z(k + 1) = z(1) + ahead(k)*z_rate(k)
    end do
    q = body%attitude
    q1 = attitude_rate(q, x(1), y(1), z(1))
    q2 = attitude_rate(q + ahead(1)*q1, x(2), y(2), z(2))
    q3 = attitude_rate(q + ahead(2)*q2, x(3), y(3), z(3))
    q4 = attitude_rate(q + ahead(3)*q3, x(4), y(4), z(4))
    turn(1) = h*(x(1) + h/6.0_wp*(x_rate(1) + x_rate(2) + x_rate(3)))
    turn(2) = h*(y(1) + h/6.0_wp*(y_rate(1) + y_rate(2) + y_rate(3)))
    turn(3) = h*(z(1) + h/6.0_wp*(z_rate(1) + z_rate(2) + z_rate(3)))
    body%angular_velocity(1) = x(1) + s*(x_rate(1) + 2.0_wp*(x_rate(2) + x_rate(3)) + x_rate(4))
    body%angular_velocity(2) = y(1) + s*(y_rate(1) + 2.0_wp*(y_rate(2) + y_rate(3)) + y_rate(4))
    body%angular_velocity(3) = z(1) + s*(z_rate(1) + 2.0_wp*(z_rate(2) + z_rate(3)) + z_rate(4))
    q = q + s*(q1 + 2.0_wp*(q2 + q3) + q4)
    body%attitude = q/sqrt(q(1)**2 + q(2)**2 + q(3)**2 + q(4)**2)

  contains

    !> w' = I^-1 (t - w x I w).
    pure subroutine spin_rate(w1, w2, w3, rate1, rate2, rate3)
      real(wp), intent(in) :: w1, w2, w3
      real(wp), intent(out) :: rate1, rate2, rate3
      real(wp) :: h1, h2, h3, t1, t2, t3
      h1 = inertia(1, 1)*w1 + inertia(1, 2)*w2 + inertia(1, 3)*w3
      h2 = inertia(2, 1)*w1 + inertia(2, 2)*w2 + inertia(2, 3)*w3
      h3 = inertia(3, 1)*w1 + inertia(3, 2)*w2 + inertia(3, 3)*w3
      t1 = torque(1) - (w2*h3 - w3*h2)
      t2 = torque(2) - (w3*h1 - w1*h3)
      t3 = torque(3) - (w1*h2 - w2*h1)
      rate1 = inverse(1, 1)*t1 + inverse(1, 2)*t2 + inverse(1, 3)*t3
      rate2 = inverse(2, 1)*t1 + inverse(2, 2)*t2 + inverse(2, 3)*t3
      rate3 = inverse(3, 1)*t1 + inverse(3, 2)*t2 + inverse(3, 3)*t3
    end subroutine spin_rate

    !> q' = q (0, w)/2.
    pure function attitude_rate(p, w1, w2, w3) result(rate)
      real(wp), intent(in) :: p(4), w1, w2, w3
      real(wp) :: rate(4)
      rate(1) = 0.5_wp*(-p(2)*w1 - p(3)*w2 - p(4)*w3)
      rate(2) = 0.5_wp*(p(1)*w1 + p(3)*w3 - p(4)*w2)
      rate(3) = 0.5_wp*(p(1)*w2 + p(4)*w1 - p(2)*w3)
      rate(4) = 0.5_wp*(p(1)*w3 + p(2)*w2 - p(3)*w1)
    end function attitude_rate

  end subroutine body_alone

  !> Change of velocity and spin by an impulse and an angular impulse.
  pure subroutine body_kick(target, body, impulse, angular_impulse)
    type(target_t), intent(in) :: target
    type(body_state_t), intent(inout) :: body
    real(wp), intent(in) :: impulse(3)         !! inertial [N s]
    real(wp), intent(in) :: angular_impulse(3) !! about the centre of mass, body axes [N m s]
    body%velocity = body%velocity + target%inverse_mass*impulse
    body%angular_velocity = body%angular_velocity + product3(target%inverse_inertia, angular_impulse)
  end subroutine body_kick

  !> a b, written out: the same bits in every build.
  pure function product3(a, b) result(c)
    real(wp), intent(in) :: a(3, 3), b(3)
    real(wp) :: c(3)
    c(1) = a(1, 1)*b(1) + a(1, 2)*b(2) + a(1, 3)*b(3)
    c(2) = a(2, 1)*b(1) + a(2, 2)*b(2) + a(2, 3)*b(3)
    c(3) = a(3, 1)*b(1) + a(3, 2)*b(2) + a(3, 3)*b(3)
  end function product3

end module castnet_body_dynamics
