!> Triangle surfaces of the analytic solids, in their own axes: closed, outward.
module castnet_tessellation
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_primitive, only: shape_box, shape_cylinder, shape_sphere, shape_capsule
  use castnet_surface, only: surface_t
  implicit none
  private
  public :: tessellate_primitive, around

  integer, parameter :: around = 48  !! facets around a round shape

contains

  !> The surface of one solid. A round one is turned from a profile of rings between two poles;
  !> its vertices lie on the true surface.
  pure subroutine tessellate_primitive(kind, half, surface)
    integer, intent(in) :: kind
    real(wp), intent(in) :: half(3)
    type(surface_t), intent(out) :: surface
    real(wp) :: radius(around), height(around), angle
    integer :: i, caps
    select case (kind)
    case (shape_box)
      call tessellate_box(half, surface)
    case (shape_cylinder)
      radius(1:2) = half(1)
      height(1:2) = [-half(3), half(3)]
      call turn(radius(1:2), height(1:2), -half(3), half(3), surface)
    case (shape_sphere, shape_capsule)
      caps = around/4
      do i = 1, caps
        angle = 0.5_wp*pi*real(i, wp)/real(caps, wp)
        radius(i) = half(1)*sin(angle)
        height(i) = -half(3) - half(1)*cos(angle)
      end do
      do i = 1, caps
        radius(2*caps + 1 - i) = radius(i)
        height(2*caps + 1 - i) = -height(i)
      end do
      if (half(3) > 0.0_wp) then
        call turn(radius(:2*caps), height(:2*caps), -half(3) - half(1), half(3) + half(1), surface)
      else
        ! A sphere's equator must not stand twice.
        radius(caps + 1:2*caps - 1) = radius(caps + 2:2*caps)
        height(caps + 1:2*caps - 1) = height(caps + 2:2*caps)
        call turn(radius(:2*caps - 1), height(:2*caps - 1), -half(1), half(1), surface)
      end if
    case default
      allocate (surface%vertex(3, 0), surface%triangle(3, 0))
    end select
  end subroutine tessellate_primitive

  pure subroutine tessellate_box(half, surface)
    real(wp), intent(in) :: half(3)
    type(surface_t), intent(inout) :: surface
    integer :: i
    allocate (surface%vertex(3, 8), surface%triangle(3, 12))
    do i = 0, 7
      surface%vertex(1, i + 1) = merge(half(1), -half(1), btest(i, 0))
      surface%vertex(2, i + 1) = merge(half(2), -half(2), btest(i, 1))
      surface%vertex(3, i + 1) = merge(half(3), -half(3), btest(i, 2))
    end do
    surface%triangle = reshape([1, 3, 2, 2, 3, 4, 5, 6, 7, 6, 8, 7, 1, 2, 5, 2, 6, 5, &
                                3, 7, 4, 4, 7, 8, 1, 5, 3, 3, 5, 7, 2, 4, 6, 4, 8, 6], [3, 12])
  end subroutine tessellate_box

  !> Rings about z from the lowest to the highest, closed by a pole at each end.
  pure subroutine turn(radius, height, bottom, top, surface)
    real(wp), intent(in) :: radius(:), height(:), bottom, top
    type(surface_t), intent(inout) :: surface
    real(wp) :: angle
    integer :: rings, i, j, next, last, t
    rings = size(radius)
    last = rings*around + 2
    allocate (surface%vertex(3, last), surface%triangle(3, 2*around*rings))
    surface%vertex(:, 1) = [0.0_wp, 0.0_wp, bottom]
    surface%vertex(:, last) = [0.0_wp, 0.0_wp, top]
    t = 0
    do i = 1, rings
      do j = 1, around
        angle = 2.0_wp*pi*real(j - 1, wp)/real(around, wp)
        surface%vertex(:, node(i, j)) = [radius(i)*cos(angle), radius(i)*sin(angle), height(i)]
      end do
    end do
    do j = 1, around
      next = modulo(j, around) + 1
      surface%triangle(:, t + 1) = [1, node(1, next), node(1, j)]
      surface%triangle(:, t + 2) = [last, node(rings, j), node(rings, next)]
      t = t + 2
      do i = 1, rings - 1
        surface%triangle(:, t + 1) = [node(i, j), node(i, next), node(i + 1, j)]
        surface%triangle(:, t + 2) = [node(i, next), node(i + 1, next), node(i + 1, j)]
        t = t + 2
      end do
    end do
  contains
    pure integer function node(ring, place)
      integer, intent(in) :: ring, place
      node = 1 + (ring - 1)*around + place
    end function node
  end subroutine turn

end module castnet_tessellation
