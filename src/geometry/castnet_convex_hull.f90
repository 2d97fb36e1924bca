!> Convex hull of points in space: its triangles, volume, area and centre of mass.
!>
!> Quickhull (Barber, Dobkin & Huhdanpaa 1996, doi 10.1145/235815.235821) on the exact
!> sides of castnet_exact: only facets that a point sees strictly are replaced, so points
!> in one plane, on one line or in one place need no tolerance and cannot break the mesh.
!> The order of all choices is fixed: the same points give the same bits.
module castnet_convex_hull
  use castnet_kinds, only: wp
  use castnet_exact, only: snap_to_grid, side_of_plane
  use castnet_polygon, only: planar_hull, loop_area
  implicit none
  private
  public :: hull_t, convex_hull

  type :: hull_t
    integer :: dimension = -1              !! 3 solid, 2 flat, 1 on a line, 0 one place, -1 no point
    integer, allocatable :: triangle(:, :) !! (3,m) points counted from 1, counter-clockwise from outside; flat: none
    real(wp) :: volume = 0.0_wp            !! [m3]
    real(wp) :: area = 0.0_wp              !! of the whole surface, a flat hull has two sides [m2]
    real(wp) :: centre(3) = 0.0_wp         !! of the uniform solid; flat: of the sheet; on a line: its middle [m]
  end type hull_t

  !> A mesh that grows: facets by number, dead ones are used again.
  type :: mesh_t
    integer :: n_facet = 0                     !! numbers given out so far
    integer :: n_free = 0
    integer, allocatable :: free(:)            !! dead facets
    integer, allocatable :: corner(:, :)       !! (3,:) points, counter-clockwise from outside
    integer, allocatable :: neighbour(:, :)    !! (3,:) facet across the edge from corner k to k + 1
    real(wp), allocatable :: normal(:, :)      !! (3,:) outward, not of unit length, on the grid
    real(wp), allocatable :: doubt(:)          !! heights below this are decided exactly
    integer, allocatable :: mark(:)            !! round in which a facet was seen, negative: and not visible
    logical, allocatable :: alive(:)
    integer, allocatable :: first_outside(:)   !! head of the list of points that this facet sees, 0 none
    integer, allocatable :: farthest(:)        !! the highest of them
    real(wp), allocatable :: height(:)         !! and how high, times the normal's length
    integer, allocatable :: next_outside(:)    !! (n) the list
    integer, allocatable :: spoke(:)           !! (n) new facet whose rim edge starts at this point
  end type mesh_t

contains

  !> Hull of any number of finite points. No error: degenerate sets say so in `dimension`.
  !> Cost about n log n.
  pure subroutine convex_hull(point, hull)
    real(wp), intent(in) :: point(:, :)  !! (3,n) [m]
    type(hull_t), intent(out) :: hull
    real(wp), allocatable :: grid(:, :)
    type(mesh_t) :: mesh
    integer :: seed(4)
    allocate (grid(3, size(point, 2)))
    call snap_to_grid(point, grid)
    call find_seed(grid, seed, hull%dimension)
    select case (hull%dimension)
    case (3)
      call start_mesh(grid, seed, mesh)
      call grow(grid, mesh)
      call collect(mesh, hull%triangle)
      call measure_solid(point, hull)
    case (2)
      allocate (hull%triangle(3, 0))
      call measure_sheet(point, grid, seed, hull)
    case default
      allocate (hull%triangle(3, 0))
      if (hull%dimension >= 0) hull%centre = 0.5_wp*(point(:, seed(1)) + point(:, seed(2)))
    end select
  end subroutine convex_hull

  !> Four points that span as much as is easily found, as far as they span anything:
  !> the ends along the longest axis, the farthest from their line, the farthest from that plane.
  pure subroutine find_seed(grid, seed, dimension)
    real(wp), intent(in) :: grid(:, :)
    integer, intent(out) :: seed(4), dimension
    real(wp) :: u(3), normal(3), best, reach
    integer :: i, axis
    seed = 1
    dimension = -1
    if (size(grid, 2) == 0) return
    axis = maxloc(maxval(grid, dim=2), dim=1)
    seed(1) = minloc(grid(axis, :), dim=1)
    seed(2) = maxloc(grid(axis, :), dim=1)
    dimension = 0
    if (.not. grid(axis, seed(2)) > grid(axis, seed(1))) return
    dimension = 1
    u = grid(:, seed(2)) - grid(:, seed(1))
    best = 0.0_wp
    do i = 1, size(grid, 2)
      normal = cross(u, grid(:, i) - grid(:, seed(1)))
      reach = normal(1)*normal(1) + normal(2)*normal(2) + normal(3)*normal(3)
      if (reach > best) then
        best = reach
        seed(3) = i
      end if
    end do
    if (.not. best > 0.0_wp) return
    dimension = 2
    normal = cross(u, grid(:, seed(3)) - grid(:, seed(1)))
    best = -1.0_wp
    do i = 1, size(grid, 2)
      u = grid(:, i) - grid(:, seed(1))
      reach = abs(normal(1)*u(1) + normal(2)*u(2) + normal(3)*u(3))
      if (.not. reach > best) cycle
      if (side_of_plane(grid(:, seed(1)), grid(:, seed(2)), grid(:, seed(3)), grid(:, i)) == 0) cycle
      best = reach
      seed(4) = i
      dimension = 3
    end do
  end subroutine find_seed

  !> The tetrahedron of the seed; every other point goes to a facet that sees it.
  pure subroutine start_mesh(grid, seed, mesh)
    real(wp), intent(in) :: grid(:, :)
    integer, intent(in) :: seed(4)
    type(mesh_t), intent(out) :: mesh
    integer :: a, b, c, d, i, n, most, facet(4)
    n = size(grid, 2)
    most = 4*n + 16  ! alive at most 2 n, and new ones before the old ones go
    allocate (mesh%free(most), mesh%corner(3, most), mesh%neighbour(3, most), mesh%normal(3, most), mesh%doubt(most), &
              mesh%mark(most), mesh%alive(most), mesh%first_outside(most), mesh%farthest(most), mesh%height(most), &
              mesh%next_outside(n), mesh%spoke(n))
    mesh%alive = .false.
    mesh%mark = 0
    mesh%next_outside = 0
    a = seed(1); b = seed(2); c = seed(3); d = seed(4)
    if (side_of_plane(grid(:, a), grid(:, b), grid(:, c), grid(:, d)) > 0) then
      b = seed(3)
      c = seed(2)
    end if
    call add_facet(grid, mesh, a, b, c, facet(1))
    call add_facet(grid, mesh, b, a, d, facet(2))
    call add_facet(grid, mesh, c, b, d, facet(3))
    call add_facet(grid, mesh, a, c, d, facet(4))
    mesh%neighbour(:, facet(1)) = [facet(2), facet(3), facet(4)]
    mesh%neighbour(:, facet(2)) = [facet(1), facet(4), facet(3)]
    mesh%neighbour(:, facet(3)) = [facet(1), facet(2), facet(4)]
    mesh%neighbour(:, facet(4)) = [facet(1), facet(3), facet(2)]
    do i = 1, n
      if (any(seed == i)) cycle
      call place(grid, mesh, facet, i)
    end do
  end subroutine start_mesh

  !> Take the highest point of each facet that sees any, until none does.
  pure subroutine grow(grid, mesh)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(inout) :: mesh
    integer, allocatable :: visible(:), new(:), todo(:)
    logical, allocatable :: queued(:)
    integer :: n_visible, n_new, n_todo, f, apex, round, i
    allocate (visible(size(mesh%alive)), new(size(mesh%alive)), todo(size(mesh%alive)), queued(size(mesh%alive)))
    queued = .false.
    n_todo = 0
    round = 0
    do f = 1, mesh%n_facet
      call queue(mesh, f, queued, todo, n_todo)
    end do
    do while (n_todo > 0)
      f = todo(n_todo)
      n_todo = n_todo - 1
      queued(f) = .false.
      if (.not. mesh%alive(f) .or. mesh%first_outside(f) == 0) cycle
      apex = mesh%farthest(f)
      round = round + 1
      call find_visible(grid, mesh, f, round, visible, n_visible)
      call raise_cone(grid, mesh, apex, round, visible, n_visible, new, n_new)
      call hand_over(grid, mesh, apex, visible, n_visible, new, n_new)
      do i = 1, n_new
        call queue(mesh, new(i), queued, todo, n_todo)
      end do
    end do
  end subroutine grow

  !> Note a facet that sees points, once.
  pure subroutine queue(mesh, facet, queued, todo, n_todo)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: facet
    logical, intent(inout) :: queued(:)
    integer, intent(inout) :: todo(:), n_todo
    if (mesh%first_outside(facet) == 0 .or. queued(facet)) return
    queued(facet) = .true.
    n_todo = n_todo + 1
    todo(n_todo) = facet
  end subroutine queue

  !> All facets that the highest point of facet f sees strictly: they hang together.
  pure subroutine find_visible(grid, mesh, f, round, visible, n_visible)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: f, round
    integer, intent(inout) :: visible(:)
    integer, intent(out) :: n_visible
    integer :: i, k, other
    n_visible = 1
    visible(1) = f
    mesh%mark(f) = round
    i = 0
    do while (i < n_visible)
      i = i + 1
      do k = 1, 3
        other = mesh%neighbour(k, visible(i))
        if (abs(mesh%mark(other)) == round) cycle
        if (sees(grid, mesh, other, mesh%farthest(f))) then
          mesh%mark(other) = round
          n_visible = n_visible + 1
          visible(n_visible) = other
        else
          mesh%mark(other) = -round
        end if
      end do
    end do
  end subroutine find_visible

  !> New facets from every rim edge of the visible ones to the apex.
  pure subroutine raise_cone(grid, mesh, apex, round, visible, n_visible, new, n_new)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: apex, round, n_visible, visible(:)
    integer, intent(inout) :: new(:)
    integer, intent(out) :: n_new
    integer :: i, k, beyond, start, finish
    n_new = 0
    do i = 1, n_visible
      do k = 1, 3
        beyond = mesh%neighbour(k, visible(i))
        if (mesh%mark(beyond) == round) cycle
        start = mesh%corner(k, visible(i))
        finish = mesh%corner(modulo(k, 3) + 1, visible(i))
        n_new = n_new + 1
        call add_facet(grid, mesh, start, finish, apex, new(n_new))
        mesh%spoke(start) = new(n_new)
        mesh%neighbour(1, new(n_new)) = beyond
        where (mesh%neighbour(:, beyond) == visible(i)) mesh%neighbour(:, beyond) = new(n_new)
      end do
    end do
    do i = 1, n_new  ! the rim is one closed line: each facet's next one starts where it ends
      beyond = mesh%spoke(mesh%corner(2, new(i)))
      mesh%neighbour(2, new(i)) = beyond
      mesh%neighbour(3, beyond) = new(i)
    end do
  end subroutine raise_cone

  !> Points that the visible facets saw go to a new facet that sees them, or are inside now.
  pure subroutine hand_over(grid, mesh, apex, visible, n_visible, new, n_new)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: apex, n_visible, n_new, visible(:), new(:)
    integer :: i, point, next
    do i = 1, n_visible
      point = mesh%first_outside(visible(i))
      do while (point > 0)
        next = mesh%next_outside(point)
        if (point /= apex) call place(grid, mesh, new(:n_new), point)
        point = next
      end do
      mesh%alive(visible(i)) = .false.
      mesh%n_free = mesh%n_free + 1
      mesh%free(mesh%n_free) = visible(i)
    end do
  end subroutine hand_over

  pure subroutine add_facet(grid, mesh, a, b, c, facet)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: a, b, c
    integer, intent(out) :: facet
    real(wp) :: u(3), v(3)
    if (mesh%n_free > 0) then
      facet = mesh%free(mesh%n_free)
      mesh%n_free = mesh%n_free - 1
    else
      mesh%n_facet = mesh%n_facet + 1
      facet = mesh%n_facet
    end if
    mesh%corner(:, facet) = [a, b, c]
    mesh%alive(facet) = .true.
    mesh%first_outside(facet) = 0
    mesh%farthest(facet) = 0
    mesh%height(facet) = 0.0_wp
    mesh%mark(facet) = 0
    u = grid(:, b) - grid(:, a)
    v = grid(:, c) - grid(:, a)
    mesh%normal(:, facet) = cross(u, v)
    ! Round-off of the normal and of its product with a difference of at most 2**40 a
    ! component: below 8 units of the sum of the absolute products.
    mesh%doubt(facet) = 8.0_wp*epsilon(1.0_wp)*2.0_wp**40* &
      (abs(u(2)*v(3)) + abs(u(3)*v(2)) + abs(u(3)*v(1)) + abs(u(1)*v(3)) + abs(u(1)*v(2)) + abs(u(2)*v(1)))
  end subroutine add_facet

  !> Height of a point over a facet, times the normal's length.
  pure real(wp) function height_over(grid, mesh, facet, point) result(height)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: facet, point
    integer :: base
    base = mesh%corner(1, facet)
    height = mesh%normal(1, facet)*(grid(1, point) - grid(1, base)) + &
             mesh%normal(2, facet)*(grid(2, point) - grid(2, base)) + &
             mesh%normal(3, facet)*(grid(3, point) - grid(3, base))
  end function height_over

  !> Is the point strictly outside of the facet's plane?
  pure logical function sees(grid, mesh, facet, point)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: facet, point
    real(wp) :: height
    height = height_over(grid, mesh, facet, point)
    sees = height > 0.0_wp
    if (abs(height) > mesh%doubt(facet)) return
    associate (corner => mesh%corner(:, facet))
      sees = side_of_plane(grid(:, corner(1)), grid(:, corner(2)), grid(:, corner(3)), grid(:, point)) > 0
    end associate
  end function sees

  !> Put the point on the list of the first of these facets that sees it; if none does, the
  !> point is inside for good.
  pure subroutine place(grid, mesh, facets, point)
    real(wp), intent(in) :: grid(:, :)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: facets(:), point
    real(wp) :: height
    integer :: k, f
    do k = 1, size(facets)
      f = facets(k)
      if (.not. sees(grid, mesh, f, point)) cycle
      height = height_over(grid, mesh, f, point)
      if (mesh%first_outside(f) == 0 .or. height > mesh%height(f)) then
        mesh%farthest(f) = point
        mesh%height(f) = height
      end if
      mesh%next_outside(point) = mesh%first_outside(f)
      mesh%first_outside(f) = point
      return
    end do
  end subroutine place

  !> The living facets.
  pure subroutine collect(mesh, triangle)
    type(mesh_t), intent(in) :: mesh
    integer, allocatable, intent(out) :: triangle(:, :)
    integer :: f, m
    allocate (triangle(3, count(mesh%alive)))
    m = 0
    do f = 1, mesh%n_facet
      if (.not. mesh%alive(f)) cycle
      m = m + 1
      triangle(:, m) = mesh%corner(:, f)
    end do
  end subroutine collect

  !> Sums over the tetrahedra between each triangle and one corner, on the points themselves.
  pure subroutine measure_solid(point, hull)
    real(wp), intent(in) :: point(:, :)
    type(hull_t), intent(inout) :: hull
    real(wp) :: base(3), a(3), b(3), c(3), normal(3), volume, area, moment(3), sheet(3), extent
    integer :: t
    base = point(:, hull%triangle(1, 1))
    moment = 0.0_wp
    sheet = 0.0_wp
    do t = 1, size(hull%triangle, 2)
      a = point(:, hull%triangle(1, t)) - base
      b = point(:, hull%triangle(2, t)) - base
      c = point(:, hull%triangle(3, t)) - base
      normal = cross(b - a, c - a)
      area = 0.5_wp*sqrt(normal(1)*normal(1) + normal(2)*normal(2) + normal(3)*normal(3))
      volume = (a(1)*normal(1) + a(2)*normal(2) + a(3)*normal(3))/6.0_wp
      hull%volume = hull%volume + volume
      hull%area = hull%area + area
      moment = moment + 0.25_wp*volume*(a + b + c)
      sheet = sheet + area/3.0_wp*(a + b + c)
    end do
    hull%volume = max(0.0_wp, hull%volume)
    extent = maxval(maxval(point, dim=2) - minval(point, dim=2))
    ! A volume that round-off made has no centre: the surface has, and then the middle.
    if (hull%volume > 1.0e-9_wp*extent**3) then
      hull%centre = base + moment/hull%volume
    else if (hull%area > 1.0e-9_wp*extent**2) then
      hull%centre = base + sheet/hull%area
    else
      hull%centre = 0.5_wp*(maxval(point, dim=2) + minval(point, dim=2))
    end if
  end subroutine measure_solid

  !> All points in one plane: the planar hull of their shadow along the normal's largest component.
  pure subroutine measure_sheet(point, grid, seed, hull)
    real(wp), intent(in) :: point(:, :), grid(:, :)
    integer, intent(in) :: seed(4)
    type(hull_t), intent(inout) :: hull
    integer, allocatable :: corner(:)
    real(wp) :: normal(3), a(3), b(3), piece, total
    integer :: axis, i
    normal = abs(cross(grid(:, seed(2)) - grid(:, seed(1)), grid(:, seed(3)) - grid(:, seed(1))))
    axis = maxloc(normal, dim=1)
    call planar_hull(grid([modulo(axis, 3) + 1, modulo(axis + 1, 3) + 1], :), corner)
    hull%area = 2.0_wp*loop_area(point(:, corner))
    total = 0.0_wp
    do i = 2, size(corner) - 1
      a = point(:, corner(i)) - point(:, corner(1))
      b = point(:, corner(i + 1)) - point(:, corner(1))
      normal = cross(a, b)
      piece = sqrt(normal(1)*normal(1) + normal(2)*normal(2) + normal(3)*normal(3))
      total = total + piece
      hull%centre = hull%centre + piece*(a + b)/3.0_wp
    end do
    if (total > 0.0_wp) hull%centre = hull%centre/total
    hull%centre = point(:, corner(1)) + hull%centre
  end subroutine measure_sheet

  pure function cross(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c(1) = a(2)*b(3) - a(3)*b(2)
    c(2) = a(3)*b(1) - a(1)*b(3)
    c(3) = a(1)*b(2) - a(2)*b(1)
  end function cross

end module castnet_convex_hull
