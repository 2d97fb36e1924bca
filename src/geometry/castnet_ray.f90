!> Rays against a shape: does what stands at these points stand in the way of a body that
!> moves along a direction?
module castnet_ray
  use castnet_kinds, only: wp
  use castnet_primitive, only: primitive_t, shape_box, shape_cylinder, shape_sphere, shape_capsule
  use castnet_rotation, only: multiply_transposed
  use castnet_shape, only: shape_t, signed_distance, shape_bounding_radius, shape_mesh
  implicit none
  private
  public :: any_ray_meets

contains

  !> Does any ray from one of the points, which lie outside of the shape, meet it?
  !> Closed forms for the primitives; a mesh is approached by its distance.
  pure logical function any_ray_meets(shape, n, point, direction) result(meets)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)     !! body axes [m]
    real(wp), intent(in) :: direction(3)    !! unit vector of every ray, body axes
    integer :: i, k
    meets = .false.
    if (shape%kind == shape_mesh) then
      do i = 1, n
        meets = approaches(shape, point(:, i), direction)
        if (meets) return
      end do
      return
    end if
    do k = 1, size(shape%parts)
      meets = part_met(shape%parts(k), n, point, direction)
      if (meets) return
    end do
  end function any_ray_meets

  !> One part: its own axes, then the closed form of its kind.
  pure logical function part_met(part, n, point, direction) result(meets)
    type(primitive_t), intent(in) :: part
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n), direction(3)
    real(wp) :: local(3), e(3)
    integer :: i
    e = multiply_transposed(part%rotation, direction)
    meets = .false.
    do i = 1, n
      local = multiply_transposed(part%rotation, point(:, i) - part%position)
      select case (part%kind)
      case (shape_box)
        meets = meets_box(part%half, local, e)
      case (shape_cylinder)
        meets = meets_cylinder(part%half(1), part%half(3), local, e)
      case (shape_sphere)
        meets = meets_ball(part%half(1), 0.0_wp, local, e)
      case (shape_capsule)
        meets = meets_cylinder(part%half(1), part%half(3), local, e) .or. &
                meets_ball(part%half(1), part%half(3), local, e) .or. &
                meets_ball(part%half(1), -part%half(3), local, e)
      end select
      if (meets) return
    end do
  end function part_met

  !> The ray's stretches between the three pairs of faces have something in common.
  pure logical function meets_box(half, p, e) result(meets)
    real(wp), intent(in) :: half(3), p(3), e(3)
    real(wp) :: first, last, inverse
    integer :: k
    first = 0.0_wp
    last = huge(1.0_wp)
    do k = 1, 3
      inverse = 1.0_wp/sign(max(abs(e(k)), 1.0e-30_wp), e(k))
      first = max(first, -p(k)*inverse - half(k)*abs(inverse))
      last = min(last, -p(k)*inverse + half(k)*abs(inverse))
    end do
    meets = first <= last
  end function meets_box

  !> |p_xy + t e_xy|**2 = radius**2 has a stretch in common with |p_z + t e_z| <= half_length, t >= 0.
  pure logical function meets_cylinder(radius, half_length, p, e) result(meets)
    real(wp), intent(in) :: radius, half_length, p(3), e(3)
    real(wp) :: a, b, c, root, inverse, first, last
    meets = .false.
    a = max(e(1)*e(1) + e(2)*e(2), 1.0e-24_wp)  ! along the axis: a stretch of 1e12 radii, or none
    b = p(1)*e(1) + p(2)*e(2)
    c = p(1)*p(1) + p(2)*p(2) - radius*radius
    root = b*b - a*c
    if (root < 0.0_wp) return
    root = sqrt(root)
    inverse = 1.0_wp/sign(max(abs(e(3)), 1.0e-30_wp), e(3))
    first = max(0.0_wp, (-b - root)/a, -p(3)*inverse - half_length*abs(inverse))
    last = min((-b + root)/a, -p(3)*inverse + half_length*abs(inverse))
    meets = first <= last
  end function meets_cylinder

  !> A ball whose centre lies at this height on the axis.
  pure logical function meets_ball(radius, height, p, e) result(meets)
    real(wp), intent(in) :: radius, height, p(3), e(3)
    real(wp) :: b, c
    b = p(1)*e(1) + p(2)*e(2) + (p(3) - height)*e(3)
    c = p(1)*p(1) + p(2)*p(2) + (p(3) - height)*(p(3) - height) - radius*radius
    meets = (b <= 0.0_wp .or. c <= 0.0_wp) .and. b*b >= c
  end function meets_ball

  !> Step along the ray by the distance to the shape, which cannot jump over it. Rays that
  !> graze it closer than a millionth of its size count as meeting it.
  pure logical function approaches(shape, point, direction) result(meets)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: point(3), direction(3)
    real(wp) :: p(3, 1), distance(1), normal(3, 1), radius, along
    integer :: i
    radius = shape_bounding_radius(shape)
    p(:, 1) = point
    meets = .false.
    do i = 1, 1000
      call signed_distance(shape, 1, p, distance, normal)
      meets = distance(1) <= 1.0e-6_wp*radius
      if (meets) return
      along = p(1, 1)*direction(1) + p(2, 1)*direction(2) + p(3, 1)*direction(3)
      if (along > radius) return  ! beyond the ball around it
      p(:, 1) = p(:, 1) + distance(1)*direction
    end do
    meets = .true.  ! crept along the surface
  end function approaches

end module castnet_ray
