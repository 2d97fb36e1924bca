!> The four analytic solids in their own axes, centred on the origin, long axis z:
!> exact signed distance and outward normal of many points.
!>
!> Every loop is free of branches (`max`, `merge`), so that it vectorises; a divisor is
!> kept from zero, and where the nearest point is not unique (edges, axes, the centre)
!> the first axis wins: always a finite unit normal, the same one every time.
module castnet_primitive
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  implicit none
  private
  public :: primitive_t, primitive_distance, primitive_volume, primitive_unit_inertia
  public :: primitive_support
  public :: shape_none, shape_box, shape_cylinder, shape_sphere, shape_capsule, shape_compound, shape_mesh

  integer, parameter :: shape_none = 0, shape_box = 1, shape_cylinder = 2, shape_sphere = 3, &
                        shape_capsule = 4, shape_compound = 5, shape_mesh = 6

  !> Below this a length has no direction, and its square no meaning [m].
  real(wp), parameter :: tiny_distance = 1.0e-140_wp

  type :: primitive_t
    integer :: kind = shape_none
    real(wp) :: half(3) = 0.0_wp      !! box: half edges; else radius, radius, half length (of the axis for a capsule) [m]
    real(wp) :: position(3) = 0.0_wp  !! of the centre, body axes [m]
    real(wp) :: rotation(3, 3) = reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
    logical :: is_placed = .false.    !! position or rotation differs from the body's origin and axes
  end type primitive_t

contains

  !> Signed distance (negative inside) and its gradient, in the solid's own axes.
  pure subroutine primitive_distance(kind, half, n, point, distance, normal)
    integer, intent(in) :: kind, n
    real(wp), intent(in) :: half(3), point(3, n)      !! [m]
    real(wp), intent(out) :: distance(n), normal(3, n) !! [m], [-]
    select case (kind)
    case (shape_box)
      call box_distance(half, n, point, distance, normal)
    case (shape_cylinder)
      call cylinder_distance(half, n, point, distance, normal)
    case (shape_sphere)
      call capsule_distance(half(1), 0.0_wp, n, point, distance, normal)
    case (shape_capsule)
      call capsule_distance(half(1), half(3), n, point, distance, normal)
    case default
      distance = huge(1.0_wp)
      normal = 0.0_wp
    end select
  end subroutine primitive_distance

  !> Outside: the distance to the clamped point; inside: the nearest face.
  pure subroutine box_distance(half, n, point, distance, normal)
    integer, intent(in) :: n
    real(wp), intent(in) :: half(3), point(3, n)
    real(wp), intent(out) :: distance(n), normal(3, n)
    real(wp) :: q1, q2, q3, w1, w2, w3, face, square, edge, inverse
    logical :: on_face, first, second
    integer :: i
    do i = 1, n
      q1 = abs(point(1, i)) - half(1)
      q2 = abs(point(2, i)) - half(2)
      q3 = abs(point(3, i)) - half(3)
      face = max(q1, max(q2, q3))
      w1 = max(q1, 0.0_wp)
      w2 = max(q2, 0.0_wp)
      w3 = max(q3, 0.0_wp)
      square = w1*w1 + w2*w2 + w3*w3
      edge = sqrt(square)
      inverse = 1.0_wp/max(edge, tiny_distance)
      on_face = edge <= tiny_distance
      first = q1 >= face
      second = q2 >= face .and. .not. first
      w1 = merge(merge(1.0_wp, 0.0_wp, first), w1*inverse, on_face)
      w2 = merge(merge(1.0_wp, 0.0_wp, second), w2*inverse, on_face)
      w3 = merge(merge(0.0_wp, 1.0_wp, first .or. second), w3*inverse, on_face)
      distance(i) = merge(face, edge, on_face)
      normal(1, i) = merge(-w1, w1, point(1, i) < 0.0_wp)
      normal(2, i) = merge(-w2, w2, point(2, i) < 0.0_wp)
      normal(3, i) = merge(-w3, w3, point(3, i) < 0.0_wp)
    end do
  end subroutine box_distance

  !> The same in the half plane of radius and height.
  pure subroutine cylinder_distance(half, n, point, distance, normal)
    integer, intent(in) :: n
    real(wp), intent(in) :: half(3), point(3, n)
    real(wp), intent(out) :: distance(n), normal(3, n)
    real(wp) :: radius, q1, q3, w1, w3, face, edge, inverse, c, s
    logical :: on_face, on_axis, barrel
    integer :: i
    do i = 1, n
      radius = sqrt(point(1, i)*point(1, i) + point(2, i)*point(2, i))
      on_axis = radius <= tiny_distance
      inverse = 1.0_wp/max(radius, tiny_distance)
      c = merge(1.0_wp, point(1, i)*inverse, on_axis)
      s = merge(0.0_wp, point(2, i)*inverse, on_axis)
      q1 = radius - half(1)
      q3 = abs(point(3, i)) - half(3)
      face = max(q1, q3)
      w1 = max(q1, 0.0_wp)
      w3 = max(q3, 0.0_wp)
      edge = sqrt(w1*w1 + w3*w3)
      inverse = 1.0_wp/max(edge, tiny_distance)
      on_face = edge <= tiny_distance
      barrel = q1 >= q3
      w1 = merge(merge(1.0_wp, 0.0_wp, barrel), w1*inverse, on_face)
      w3 = merge(merge(0.0_wp, 1.0_wp, barrel), w3*inverse, on_face)
      distance(i) = merge(face, edge, on_face)
      normal(1, i) = w1*c
      normal(2, i) = w1*s
      normal(3, i) = merge(-w3, w3, point(3, i) < 0.0_wp)
    end do
  end subroutine cylinder_distance

  !> Distance to the axis piece |z| <= half_length, less the radius; a sphere has none.
  pure subroutine capsule_distance(radius, half_length, n, point, distance, normal)
    integer, intent(in) :: n
    real(wp), intent(in) :: radius, half_length, point(3, n)
    real(wp), intent(out) :: distance(n), normal(3, n)
    real(wp) :: z, length, inverse
    logical :: on_axis
    integer :: i
    do i = 1, n
      z = point(3, i) - max(-half_length, min(half_length, point(3, i)))
      length = sqrt(point(1, i)*point(1, i) + point(2, i)*point(2, i) + z*z)
      on_axis = length <= tiny_distance
      inverse = 1.0_wp/max(length, tiny_distance)
      distance(i) = length - radius
      normal(1, i) = merge(1.0_wp, point(1, i)*inverse, on_axis)
      normal(2, i) = merge(0.0_wp, point(2, i)*inverse, on_axis)
      normal(3, i) = merge(0.0_wp, z*inverse, on_axis)
    end do
  end subroutine capsule_distance

  !> Volume [m3].
  pure real(wp) function primitive_volume(kind, half) result(volume)
    integer, intent(in) :: kind
    real(wp), intent(in) :: half(3)
    select case (kind)
    case (shape_box)
      volume = 8.0_wp*half(1)*half(2)*half(3)
    case (shape_cylinder)
      volume = 2.0_wp*pi*half(1)**2*half(3)
    case (shape_sphere)
      volume = 4.0_wp/3.0_wp*pi*half(1)**3
    case (shape_capsule)
      volume = 2.0_wp*pi*half(1)**2*half(3) + 4.0_wp/3.0_wp*pi*half(1)**3
    case default
      volume = 0.0_wp
    end select
  end function primitive_volume

  !> Principal inertia of the uniform solid about its centre, per unit mass [m2].
  pure function primitive_unit_inertia(kind, half) result(inertia)
    integer, intent(in) :: kind
    real(wp), intent(in) :: half(3)
    real(wp) :: inertia(3), r2, h, barrel, caps, axial, across
    r2 = half(1)**2
    h = half(3)
    select case (kind)
    case (shape_box)
      inertia(1) = (half(2)**2 + half(3)**2)/3.0_wp
      inertia(2) = (half(1)**2 + half(3)**2)/3.0_wp
      inertia(3) = (half(1)**2 + half(2)**2)/3.0_wp
    case (shape_cylinder)
      inertia = [r2/4.0_wp + h*h/3.0_wp, r2/4.0_wp + h*h/3.0_wp, r2/2.0_wp]
    case (shape_sphere)
      inertia = 0.4_wp*r2
    case (shape_capsule)
      ! Shares of mass; the two half balls' centroids lie 3r/8 beyond the axis ends.
      barrel = h/(h + 2.0_wp/3.0_wp*half(1))
      caps = 1.0_wp - barrel
      axial = barrel*r2/2.0_wp + caps*0.4_wp*r2
      across = barrel*(r2/4.0_wp + h*h/3.0_wp) + caps*(0.4_wp*r2 + h*h + 0.75_wp*h*half(1))
      inertia = [across, across, axial]
    case default
      inertia = 0.0_wp
    end select
  end function primitive_unit_inertia

  !> The farthest point of the solid along a direction, own axes [m].
  pure function primitive_support(kind, half, direction) result(point)
    integer, intent(in) :: kind
    real(wp), intent(in) :: half(3), direction(3)
    real(wp) :: point(3), length
    point = sign(half, direction)
    select case (kind)
    case (shape_cylinder)
      length = sqrt(direction(1)**2 + direction(2)**2)
      if (length > 0.0_wp) then
        point(1:2) = half(1)/length*direction(1:2)
      else
        point(1:2) = 0.0_wp
      end if
    case (shape_sphere, shape_capsule)
      length = sqrt(direction(1)**2 + direction(2)**2 + direction(3)**2)
      point(1:2) = half(1)/length*direction(1:2)
      point(3) = sign(half(3), direction(3)) + half(1)/length*direction(3)
    end select
  end function primitive_support

end module castnet_primitive
