!> A closed triangle surface, and the mass properties of the solid that it bounds.
module castnet_surface
  use castnet_kinds, only: wp
  implicit none
  private
  public :: surface_t, surface_volume, surface_centroid, surface_inertia, append_surface

  !> Counter-clockwise seen from outside.
  type :: surface_t
    real(wp), allocatable :: vertex(:, :)   !! (3,n) [m]
    integer, allocatable :: triangle(:, :)  !! (3,m) vertices counted from 1
  end type surface_t

contains

  !> Enclosed volume [m3], negative for an inward orientation (divergence theorem).
  pure real(wp) function surface_volume(surface) result(volume)
    type(surface_t), intent(in) :: surface
    real(wp) :: centroid(3), inertia(3, 3)
    call integrate(surface, volume, centroid, inertia)
  end function surface_volume

  !> Centroid of the solid [m].
  pure function surface_centroid(surface) result(centroid)
    type(surface_t), intent(in) :: surface
    real(wp) :: centroid(3), volume, place(3), inertia(3, 3)
    call integrate(surface, volume, place, inertia)
    centroid = place
  end function surface_centroid

  !> Inertia tensor of the uniform solid about its centroid, per unit mass [m2];
  !> off-diagonal entries are the tensor's (-sum x y).
  pure function surface_inertia(surface) result(inertia)
    type(surface_t), intent(in) :: surface
    real(wp) :: inertia(3, 3), volume, centroid(3), tensor(3, 3)
    call integrate(surface, volume, centroid, tensor)
    inertia = tensor
  end function surface_inertia

  !> Volume, centroid and second moments as sums over the tetrahedra between each triangle
  !> and the mean vertex: with a base near the solid nothing cancels that need not.
  !> For a tetrahedron at the base with edges a, b, c and s = a+b+c: volume a.(bxc)/6,
  !> first moment V s/4, second moment V (s s^T + a a^T + b b^T + c c^T)/20.
  pure subroutine integrate(surface, volume, centroid, inertia)
    type(surface_t), intent(in) :: surface
    real(wp), intent(out) :: volume, centroid(3), inertia(3, 3)
    real(wp) :: base(3), a(3), b(3), c(3), s(3), v, first(3), second(3, 3), trace
    integer :: i, j, k
    base = 0.0_wp
    volume = 0.0_wp; first = 0.0_wp; second = 0.0_wp
    do i = 1, size(surface%vertex, 2)
      base = base + surface%vertex(:, i)
    end do
    base = base/real(max(1, size(surface%vertex, 2)), wp)
    do i = 1, size(surface%triangle, 2)
      a = surface%vertex(:, surface%triangle(1, i)) - base
      b = surface%vertex(:, surface%triangle(2, i)) - base
      c = surface%vertex(:, surface%triangle(3, i)) - base
      s = a + b + c
      v = (a(1)*(b(2)*c(3) - b(3)*c(2)) + a(2)*(b(3)*c(1) - b(1)*c(3)) + a(3)*(b(1)*c(2) - b(2)*c(1)))/6.0_wp
      volume = volume + v
      first = first + v*s/4.0_wp
      do k = 1, 3
        do j = 1, 3
          second(j, k) = second(j, k) + v*(s(j)*s(k) + a(j)*a(k) + b(j)*b(k) + c(j)*c(k))/20.0_wp
        end do
      end do
    end do
    centroid = base
    inertia = 0.0_wp
    if (.not. abs(volume) > 0.0_wp) return
    first = first/volume
    do k = 1, 3
      do j = 1, 3
        second(j, k) = second(j, k)/volume - first(j)*first(k)
      end do
    end do
    centroid = base + first
    trace = second(1, 1) + second(2, 2) + second(3, 3)
    inertia = -second
    do k = 1, 3
      inertia(k, k) = trace - second(k, k)
    end do
  end subroutine integrate

  !> Add the triangles of another surface.
  pure subroutine append_surface(surface, more)
    type(surface_t), intent(inout) :: surface
    type(surface_t), intent(in) :: more
    real(wp), allocatable :: vertex(:, :)
    integer, allocatable :: triangle(:, :)
    integer :: n, m
    if (.not. allocated(surface%vertex)) then
      surface = more
      return
    end if
    n = size(surface%vertex, 2)
    m = size(surface%triangle, 2)
    allocate (vertex(3, n + size(more%vertex, 2)), triangle(3, m + size(more%triangle, 2)))
    vertex(:, :n) = surface%vertex
    vertex(:, n + 1:) = more%vertex
    triangle(:, :m) = surface%triangle
    triangle(:, m + 1:) = more%triangle + n
    call move_alloc(vertex, surface%vertex)
    call move_alloc(triangle, surface%triangle)
  end subroutine append_surface

end module castnet_surface
