!> Rays against a shape: how far is it from points outside to a shape, along one direction?
module castnet_ray
  use castnet_kinds, only: wp
  use castnet_primitive, only: primitive_t, shape_box, shape_cylinder, shape_sphere, shape_capsule
  use castnet_rotation, only: multiply_transposed
  use castnet_shape, only: shape_t, signed_distance, shape_bounding_radius, shape_mesh
  implicit none
  private
  public :: ray_lengths, misses

  real(wp), parameter :: misses = huge(1.0_wp)  !! length of a ray that never meets the shape

contains

  !> Way from each point, outside of the shape, to its surface along the direction, or
  !> `misses`. Closed forms for the primitives; a mesh is approached by its distance.
  pure subroutine ray_lengths(shape, n, point, direction, length)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)     !! body axes [m]
    real(wp), intent(in) :: direction(3)    !! unit vector of every ray, body axes
    real(wp), intent(out) :: length(n)      !! [m]
    integer :: i, k
    length = misses
    if (shape%kind == shape_mesh) then
      do i = 1, n
        length(i) = approach(shape, point(:, i), direction)
      end do
      return
    end if
    do k = 1, size(shape%parts)
      call lengths_to_part(shape%parts(k), n, point, direction, length)
    end do
  end subroutine ray_lengths

  !> One part: its own axes, then the closed form of its kind.
  pure subroutine lengths_to_part(part, n, point, direction, length)
    type(primitive_t), intent(in) :: part
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n), direction(3)
    real(wp), intent(inout) :: length(n)
    real(wp) :: p(3), e(3), h
    integer :: i
    e = multiply_transposed(part%rotation, direction)
    h = part%half(3)
    do i = 1, n
      p = multiply_transposed(part%rotation, point(:, i) - part%position)
      select case (part%kind)
      case (shape_box)
        length(i) = min(length(i), to_box(part%half, p, e))
      case (shape_cylinder)
        length(i) = min(length(i), to_cylinder(part%half(1), h, p, e))
      case (shape_sphere)
        length(i) = min(length(i), to_ball(part%half(1), 0.0_wp, p, e))
      case (shape_capsule)
        length(i) = min(length(i), to_cylinder(part%half(1), h, p, e), to_ball(part%half(1), h, p, e), &
                        to_ball(part%half(1), -h, p, e))
      end select
    end do
  end subroutine lengths_to_part

  !> The ray's stretches between the three pairs of faces have something in common.
  pure real(wp) function to_box(half, p, e) result(length)
    real(wp), intent(in) :: half(3), p(3), e(3)
    real(wp) :: first, last, inverse
    integer :: k
    first = 0.0_wp
    last = misses
    do k = 1, 3
      inverse = 1.0_wp/sign(max(abs(e(k)), 1.0e-30_wp), e(k))
      first = max(first, -p(k)*inverse - half(k)*abs(inverse))
      last = min(last, -p(k)*inverse + half(k)*abs(inverse))
    end do
    length = merge(first, misses, first <= last)
  end function to_box

  !> |p_xy + t e_xy|**2 = radius**2 has a stretch in common with |p_z + t e_z| <= half_length, t >= 0.
  pure real(wp) function to_cylinder(radius, half_length, p, e) result(length)
    real(wp), intent(in) :: radius, half_length, p(3), e(3)
    real(wp) :: a, b, c, root, inverse, first, last
    length = misses
    a = max(e(1)*e(1) + e(2)*e(2), 1.0e-24_wp)  ! along the axis: a stretch of 1e12 radii, or none
    b = p(1)*e(1) + p(2)*e(2)
    c = p(1)*p(1) + p(2)*p(2) - radius*radius
    root = b*b - a*c
    if (root < 0.0_wp) return
    root = sqrt(root)
    inverse = 1.0_wp/sign(max(abs(e(3)), 1.0e-30_wp), e(3))
    first = max(0.0_wp, (-b - root)/a, -p(3)*inverse - half_length*abs(inverse))
    last = min((-b + root)/a, -p(3)*inverse + half_length*abs(inverse))
    if (first <= last) length = first
  end function to_cylinder

  !> A ball whose centre lies at this height on the axis.
  pure real(wp) function to_ball(radius, height, p, e) result(length)
    real(wp), intent(in) :: radius, height, p(3), e(3)
    real(wp) :: b, c
    b = p(1)*e(1) + p(2)*e(2) + (p(3) - height)*e(3)
    c = p(1)*p(1) + p(2)*p(2) + (p(3) - height)*(p(3) - height) - radius*radius
    length = misses
    if (c <= 0.0_wp) length = 0.0_wp
    if (c > 0.0_wp .and. b < 0.0_wp .and. b*b >= c) length = max(0.0_wp, -b - sqrt(b*b - c))
  end function to_ball

  !> Step along the ray by the distance to the shape, which cannot jump over it. Rays that
  !> graze it closer than a millionth of its size count as meeting it.
  pure real(wp) function approach(shape, point, direction) result(length)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: point(3), direction(3)
    real(wp) :: p(3, 1), distance(1), normal(3, 1), radius, along
    integer :: i
    radius = shape_bounding_radius(shape)
    length = 0.0_wp
    do i = 1, 1000
      p(:, 1) = point + length*direction
      call signed_distance(shape, 1, p, distance, normal)
      if (distance(1) <= 1.0e-6_wp*radius) return
      along = p(1, 1)*direction(1) + p(2, 1)*direction(2) + p(3, 1)*direction(3)
      if (along > radius) exit  ! beyond the ball around it
      length = length + distance(1)
    end do
    if (i <= 1000) length = misses  ! else it crept along the surface
  end function approach

end module castnet_ray
