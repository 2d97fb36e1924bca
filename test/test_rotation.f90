!> Vectors and rotations: identities of the algebra, against formulas written out here.
module test_rotation
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_vector, only: cross, dot, norm, unit
  use castnet_rotation, only: rotation_matrix, rotate, multiply, multiply_transposed, congruent, &
                              quaternion_product, normalise_quaternion, quaternion_from_rotation_vector
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_rotation

  real(wp), parameter :: round_off = 1.0e-15_wp
  real(wp), parameter :: back(4) = [1.0_wp, -1.0_wp, -1.0_wp, -1.0_wp] !! times a unit quaternion: its inverse

contains

  subroutine run_test_rotation()
    call test_case('rotation: a quarter turn about z takes x to y', quarter_turn)
    call test_case('rotation: quaternion, matrix and product agree', agreement)
    call test_case('rotation: the rate is the derivative of the exponential map', rate)
    call test_case('rotation: the exponential map is Rodrigues'' formula, also for tiny turns', exponential)
    call test_case('rotation: vectors without a direction', no_direction)
  end subroutine run_test_rotation

  subroutine quarter_turn()
    real(wp) :: q(4)
    q = [sqrt(0.5_wp), 0.0_wp, 0.0_wp, sqrt(0.5_wp)]
    call expect_close(rotate(q, [1.0_wp, 0.0_wp, 0.0_wp]), [0.0_wp, 1.0_wp, 0.0_wp], 'x turned', atol=round_off)
    call expect_close(rotate(back*q, [0.0_wp, 1.0_wp, 0.0_wp]), [1.0_wp, 0.0_wp, 0.0_wp], 'y turned back', atol=round_off)
    q = quaternion_from_rotation_vector([0.0_wp, 0.0_wp, 0.5_wp*pi])
    call expect_close(q, [sqrt(0.5_wp), 0.0_wp, 0.0_wp, sqrt(0.5_wp)], 'its quaternion', atol=round_off)
  end subroutine quarter_turn

  subroutine agreement()
    real(wp) :: p(4), q(4), v(3), r(3, 3), s(3, 3), a(3, 3)
    integer :: i, j
    p = normalise_quaternion([0.3_wp, -0.7_wp, 0.2_wp, 0.9_wp])
    q = normalise_quaternion([-1.1_wp, 0.4_wp, 0.5_wp, -0.2_wp])
    v = [1.3_wp, -0.4_wp, 2.2_wp]
    r = rotation_matrix(p)
    s = rotation_matrix(q)
    call expect_close(multiply(r, v), rotate(p, v), 'matrix and quaternion', atol=4*round_off)
    call expect_close(multiply_transposed(r, v), rotate(back*p, v), 'and back', atol=4*round_off)
    call expect_close(multiply_transposed(r, multiply(r, v)), v, 'there and back', atol=4*round_off)
    call expect_close(rotate(quaternion_product(p, q), v), rotate(p, rotate(q, v)), 'first q, then p', atol=8*round_off)
    call expect_close(multiply(rotation_matrix(quaternion_product(p, q)), v), multiply(r, multiply(s, v)), &
                      'as matrices', atol=8*round_off)
    call expect_close(cross(r(:, 1), r(:, 2)), r(:, 3), 'right-handed', atol=2*round_off)
    ! A tensor turned acts on a turned vector as the tensor does on the vector.
    a = reshape([2.0_wp, 0.1_wp, -0.3_wp, 0.1_wp, 3.0_wp, 0.2_wp, -0.3_wp, 0.2_wp, 4.0_wp], [3, 3])
    call expect_close(multiply(congruent(r, a), multiply(r, v)), multiply(r, multiply(a, v)), 'tensor turned', &
                      rtol=8*round_off)
    do i = 1, 3
      do j = 1, 3
        call expect_close(dot(r(:, i), r(:, j)), merge(1.0_wp, 0.0_wp, i == j), 'orthonormal', atol=2*round_off)
      end do
    end do
  end subroutine agreement

  !> q exp(omega h) against q + h dq/dt: central difference, error h^2/24 |omega|^3.
  subroutine rate()
    real(wp) :: q(4), omega(3), plus(4), minus(4), expected(4), h
    q = normalise_quaternion([0.3_wp, -0.7_wp, 0.2_wp, 0.9_wp])
    omega = [0.5_wp, -1.2_wp, 0.7_wp]
    h = 1.0e-4_wp
    plus = quaternion_product(q, quaternion_from_rotation_vector(h*omega))
    minus = quaternion_product(q, quaternion_from_rotation_vector(-h*omega))
    expected = 0.5_wp*quaternion_product(q, [0.0_wp, omega])
    call expect_close((plus - minus)/(2.0_wp*h), expected, 'dq/dt', atol=1.0e-8_wp)
    call expect_close(sum(q*expected), 0.0_wp, 'the length stays', atol=round_off)
  end subroutine rate

  subroutine exponential()
    real(wp) :: axis(3), v(3), turned(3), angle, angles(9)
    integer :: i
    axis = unit([1.0_wp, 2.0_wp, -0.5_wp])
    v = [0.3_wp, 1.0_wp, -0.7_wp]
    angles = [0.0_wp, 1.0e-200_wp, 1.0e-9_wp, 0.00999_wp, 0.01001_wp, 0.5_wp, 3.0_wp, 3.141_wp, 6.0_wp]
    do i = 1, size(angles)
      angle = angles(i)
      turned = v*cos(angle) + cross(axis, v)*sin(angle) + axis*dot(axis, v)*(1.0_wp - cos(angle))
      call expect_close(rotate(quaternion_from_rotation_vector(angle*axis), v), turned, 'turned', atol=4*round_off)
      call expect_close(sum(quaternion_from_rotation_vector(angle*axis)**2), 1.0_wp, 'unit', atol=2*round_off)
    end do
  end subroutine exponential

  subroutine no_direction()
    call expect_close(unit([0.0_wp, 0.0_wp, 0.0_wp]), [1.0_wp, 0.0_wp, 0.0_wp], 'no vector', atol=0.0_wp)
    call expect_close(unit([0.0_wp, 3.0e-200_wp, 4.0e-200_wp]), [0.0_wp, 0.6_wp, 0.8_wp], 'a tiny vector', atol=round_off)
    call expect_close(norm([2.0_wp, 3.0_wp, 6.0_wp]), 7.0_wp, 'length', atol=0.0_wp)
    call expect_close(normalise_quaternion([0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]), [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
                      'no quaternion', atol=0.0_wp)
    call expect_close(normalise_quaternion([-2.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]), [-1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
                      'the sign stays', atol=0.0_wp)
    call expect(all(abs(rotation_matrix([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]) - &
                        reshape([1, 0, 0, 0, 1, 0, 0, 0, 1], [3, 3])) <= 0.0_wp), 'no turn')
  end subroutine no_direction

end module test_rotation
