!> Attitudes: unit quaternions, scalar first, that turn body axes into inertial axes,
!> and their matrices. v_inertial = r v_body = q v_body q*. Products are written out.
module castnet_rotation
  use castnet_kinds, only: wp
  use castnet_trigonometry, only: sine_cosine
  implicit none
  private
  public :: rotation_matrix, rotate, multiply, multiply_transposed
  public :: quaternion_product, normalise_quaternion
  public :: quaternion_from_rotation_vector, congruent

contains

  !> Matrix of a unit quaternion: v_inertial = r v_body.
  pure function rotation_matrix(q) result(r)
    real(wp), intent(in) :: q(4)  !! unit, scalar first, body to inertial
    real(wp) :: r(3, 3)
    real(wp) :: xx, yy, zz, xy, xz, yz, wx, wy, wz
    xx = q(2)*q(2); yy = q(3)*q(3); zz = q(4)*q(4)
    xy = q(2)*q(3); xz = q(2)*q(4); yz = q(3)*q(4)
    wx = q(1)*q(2); wy = q(1)*q(3); wz = q(1)*q(4)
    r(1, 1) = 1.0_wp - 2.0_wp*(yy + zz)
    r(2, 1) = 2.0_wp*(xy + wz)
    r(3, 1) = 2.0_wp*(xz - wy)
    r(1, 2) = 2.0_wp*(xy - wz)
    r(2, 2) = 1.0_wp - 2.0_wp*(xx + zz)
    r(3, 2) = 2.0_wp*(yz + wx)
    r(1, 3) = 2.0_wp*(xz + wy)
    r(2, 3) = 2.0_wp*(yz - wx)
    r(3, 3) = 1.0_wp - 2.0_wp*(xx + yy)
  end function rotation_matrix

  !> r v.
  pure function multiply(r, v) result(u)
    real(wp), intent(in) :: r(3, 3), v(3)
    real(wp) :: u(3)
    u(1) = r(1, 1)*v(1) + r(1, 2)*v(2) + r(1, 3)*v(3)
    u(2) = r(2, 1)*v(1) + r(2, 2)*v(2) + r(2, 3)*v(3)
    u(3) = r(3, 1)*v(1) + r(3, 2)*v(2) + r(3, 3)*v(3)
  end function multiply

  !> r^T v: inertial to body when r is an attitude.
  pure function multiply_transposed(r, v) result(u)
    real(wp), intent(in) :: r(3, 3), v(3)
    real(wp) :: u(3)
    u(1) = r(1, 1)*v(1) + r(2, 1)*v(2) + r(3, 1)*v(3)
    u(2) = r(1, 2)*v(1) + r(2, 2)*v(2) + r(3, 2)*v(3)
    u(3) = r(1, 3)*v(1) + r(2, 3)*v(2) + r(3, 3)*v(3)
  end function multiply_transposed

  !> r a r^T: a tensor given in body axes, in inertial axes.
  pure function congruent(r, a) result(c)
    real(wp), intent(in) :: r(3, 3), a(3, 3)
    real(wp) :: c(3, 3), ra(3, 3)
    integer :: i, j
    do j = 1, 3
      do i = 1, 3
        ra(i, j) = r(i, 1)*a(1, j) + r(i, 2)*a(2, j) + r(i, 3)*a(3, j)
      end do
    end do
    do j = 1, 3
      do i = 1, 3
        c(i, j) = ra(i, 1)*r(j, 1) + ra(i, 2)*r(j, 2) + ra(i, 3)*r(j, 3)
      end do
    end do
  end function congruent

  !> v_inertial of v_body. For many vectors use `rotation_matrix` once.
  pure function rotate(q, v) result(u)
    real(wp), intent(in) :: q(4), v(3)
    real(wp) :: u(3), t(3)
    t(1) = 2.0_wp*(q(3)*v(3) - q(4)*v(2))
    t(2) = 2.0_wp*(q(4)*v(1) - q(2)*v(3))
    t(3) = 2.0_wp*(q(2)*v(2) - q(3)*v(1))
    u(1) = v(1) + q(1)*t(1) + (q(3)*t(3) - q(4)*t(2))
    u(2) = v(2) + q(1)*t(2) + (q(4)*t(1) - q(2)*t(3))
    u(3) = v(3) + q(1)*t(3) + (q(2)*t(2) - q(3)*t(1))
  end function rotate

  !> a b (Hamilton): first turn by b, then by a.
  pure function quaternion_product(a, b) result(c)
    real(wp), intent(in) :: a(4), b(4)
    real(wp) :: c(4)
    c(1) = a(1)*b(1) - a(2)*b(2) - a(3)*b(3) - a(4)*b(4)
    c(2) = a(1)*b(2) + a(2)*b(1) + a(3)*b(4) - a(4)*b(3)
    c(3) = a(1)*b(3) - a(2)*b(4) + a(3)*b(1) + a(4)*b(2)
    c(4) = a(1)*b(4) + a(2)*b(3) - a(3)*b(2) + a(4)*b(1)
  end function quaternion_product

  !> q/|q|; the sign is kept. A zero quaternion gives no turn.
  pure function normalise_quaternion(q) result(u)
    real(wp), intent(in) :: q(4)
    real(wp) :: u(4), scale
    u = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    scale = max(abs(q(1)), abs(q(2)), abs(q(3)), abs(q(4)))
    if (.not. scale > 0.0_wp) return
    u = q
    if (scale < 1.0e-140_wp .or. scale > 1.0e140_wp) u = q/scale
    u = u/sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3) + u(4)*u(4))
  end function normalise_quaternion

  !> Exponential map: the turn by |v| about v [rad]. With a body-axes increment the
  !> new attitude is q exp(v), with an inertial one exp(v) q.
  pure function quaternion_from_rotation_vector(v) result(q)
    real(wp), intent(in) :: v(3)
    real(wp) :: q(4)
    real(wp) :: angle_squared, half_angle, sine, sine_ratio
    angle_squared = v(1)*v(1) + v(2)*v(2) + v(3)*v(3)
    if (angle_squared < 1.0e-4_wp) then
      ! Taylor series of cos(a/2) and sin(a/2)/a: the next terms are below 1e-22.
      q(1) = 1.0_wp - angle_squared/8.0_wp*(1.0_wp - angle_squared/48.0_wp*(1.0_wp - angle_squared/120.0_wp* &
             (1.0_wp - angle_squared/224.0_wp)))
      sine_ratio = 0.5_wp*(1.0_wp - angle_squared/24.0_wp*(1.0_wp - angle_squared/80.0_wp* &
                   (1.0_wp - angle_squared/168.0_wp)))
    else
      half_angle = 0.5_wp*sqrt(angle_squared)
      call sine_cosine(half_angle, sine, q(1))
      sine_ratio = 0.5_wp*sine/half_angle
    end if
    q(2:4) = sine_ratio*v
  end function quaternion_from_rotation_vector

end module castnet_rotation
