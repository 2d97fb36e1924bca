!> Closed triangle meshes: exact signed distance of points by a tree of boxes.
!>
!> The sign comes from the angle-weighted normals of faces, edges and corners (Baerentzen &
!> Aanaes, IEEE TVCG 11(3), 2005), which is exact for a closed surface that does not cut
!> itself. The tree has eight children a node and eight triangles a leaf, stored lane by lane,
!> so that one vector operation tests eight. A coarse grid holds, for each cell's centre, its
!> signed distance and nearest triangle: most points are settled by the first (distance is
!> 1-Lipschitz), the others start their search from the second. Queries keep nothing: any
!> number of threads may ask.
!>
!> Why not a library: of Debian's, CGAL and libigl are C++ templates without a C interface,
!> Embree works in single precision, GTS has no signed distance: ours is shorter than a shim.
module castnet_mesh
  use castnet_kinds, only: wp
  use castnet_mesh_check, only: sorted_order
  use castnet_surface, only: surface_t
  use castnet_vector, only: cross, dot, norm, unit
  implicit none
  private
  public :: mesh_t, build_mesh, mesh_distance, mesh_point, bounds_of_distance, facet_normal
  public :: lanes, stack_depth
  public :: leaf_a, leaf_ab, leaf_ac, leaf_n, leaf_gram, leaf_inverse, leaf_items

  integer, parameter :: lanes = 8
  integer, parameter :: stack_depth = 96              !! seven a level; 4 million triangles are 8 levels
  integer, parameter :: grid_most = 64                !! cells along the longest side
  real(wp), parameter :: far_away = 1.0e100_wp        !! box of no child; its square is still a number
  real(wp), parameter :: touching_ratio = 1.0e-9_wp   !! of the size: nearer, the surface gives the direction

  !> Items of a triangle in `leaf`: first corner, two sides from it, normal, the sides' products
  !> ab.ab, ab.ac, ac.ac, and 1/ab.ab, 1/ac.ac, 1/bc.bc.
  integer, parameter :: leaf_a = 1, leaf_ab = 4, leaf_ac = 7, leaf_n = 10, leaf_gram = 13, leaf_inverse = 16, &
                        leaf_items = 18

  !> All set by `build_mesh`; no default values, which gfortran 12 writes into module files that it
  !> cannot read back (a scalar allocatable component of a type with allocatable components).
  type :: mesh_t
    type(surface_t) :: surface                        !! as joined and checked
    real(wp) :: lower(3), upper(3)                    !! bounds [m]
    real(wp) :: extent                                !! largest [m]
    real(wp) :: radius                                !! of a ball about the origin that holds it [m]
    integer :: root                                   !! > 0: a node; < 0: a leaf
    real(wp), allocatable :: box(:, :, :)             !! (lanes,6,n_node) lower and upper of the children [m]
    integer, allocatable :: child(:, :)               !! (lanes,n_node) as `root`; 0: none
    real(wp), allocatable :: leaf(:, :, :)            !! (lanes,leaf_items,n_leaf); spare lanes repeat the first
    real(wp), allocatable :: feature_normal(:, :, :)  !! (3,6,lanes n_leaf) of edges ab, bc, ca and corners a, b, c
    integer :: cells(3)                               !! of the grid
    real(wp) :: origin(3), cell                       !! its lower corner and the cells' side [m]
    real(wp), allocatable :: cell_distance(:)         !! at the cells' centres [m]
    integer, allocatable :: cell_facet(:)             !! nearest there, lanes (leaf - 1) + lane
  end type mesh_t

contains

  !> Build the tables of a closed, outward surface (see `castnet_mesh_check`).
  subroutine build_mesh(surface, mesh)
    type(surface_t), intent(in) :: surface
    type(mesh_t), intent(out) :: mesh
    real(wp), allocatable :: centre(:, :)
    integer, allocatable :: order(:)
    integer :: i, m, n_node
    m = size(surface%triangle, 2)
    mesh%surface = surface
    mesh%lower = minval(surface%vertex, 2)
    mesh%upper = maxval(surface%vertex, 2)
    mesh%extent = maxval(mesh%upper - mesh%lower)
    mesh%radius = 0.0_wp
    do i = 1, size(surface%vertex, 2)
      mesh%radius = max(mesh%radius, norm(surface%vertex(:, i)))
    end do
    allocate (centre(3, m))
    do i = 1, m
      centre(:, i) = (surface%vertex(:, surface%triangle(1, i)) + surface%vertex(:, surface%triangle(2, i)) + &
                      surface%vertex(:, surface%triangle(3, i)))/3.0_wp
    end do
    order = [(i, i=1, m)]
    n_node = 0
    allocate (mesh%box(lanes, 6, m/lanes + 1), mesh%child(lanes, m/lanes + 1))
    call branch(surface, centre, order, 1, m, mesh%box, mesh%child, n_node, mesh%root)
    mesh%box = mesh%box(:, :, :n_node)
    mesh%child = mesh%child(:, :n_node)
    call set_leaves(surface, order, mesh)
    call fill_grid(mesh)
  end subroutine build_mesh

  !> Make a node, or a leaf, of a run of triangles. Runs start at multiples of eight, so that leaves are full.
  recursive subroutine branch(surface, centre, order, first, last, box, child, n_node, name)
    type(surface_t), intent(in) :: surface
    real(wp), intent(in) :: centre(:, :)
    integer, intent(inout) :: order(:)
    integer, intent(in) :: first, last
    real(wp), intent(inout) :: box(:, :, :)
    integer, intent(inout) :: child(:, :), n_node
    integer, intent(out) :: name
    integer :: start(lanes), stop(lanes), node, k, level, width, middle
    if (last - first < lanes) then
      name = -(1 + (first - 1)/lanes)
      return
    end if
    n_node = n_node + 1
    node = n_node
    name = node
    ! Three rounds of halving: run k is split into k and k + width.
    start = 1
    stop = 0
    start(1) = first
    stop(1) = last
    do level = 2, 0, -1
      width = 2**level
      do k = 1, lanes, 2*width
        if (stop(k) - start(k) < lanes) cycle
        call halve(centre, order, start(k), stop(k), middle)
        start(k + width) = middle + 1
        stop(k + width) = stop(k)
        stop(k) = middle
      end do
    end do
    do k = 1, lanes
      box(k, 1:3, node) = far_away
      box(k, 4:6, node) = -far_away
      child(k, node) = 0
      if (stop(k) < start(k)) cycle
      call bounds_of(surface, order(start(k):stop(k)), box(k, :, node))
      call branch(surface, centre, order, start(k), stop(k), box, child, n_node, child(k, node))
    end do
  end subroutine branch

  !> Sort a run along its longest side and cut it near its middle, at a multiple of eight from its start.
  subroutine halve(centre, order, first, last, middle)
    real(wp), intent(in) :: centre(:, :)
    integer, intent(inout) :: order(:)
    integer, intent(in) :: first, last
    integer, intent(out) :: middle
    integer :: axis
    axis = maxloc(maxval(centre(:, order(first:last)), 2) - minval(centre(:, order(first:last)), 2), 1)
    order(first:last) = order(first - 1 + sorted_order(centre(axis, order(first:last))))
    middle = first - 1 + lanes*((last - first + 2*lanes)/(2*lanes))
  end subroutine halve

  pure subroutine bounds_of(surface, list, bounds)
    type(surface_t), intent(in) :: surface
    integer, intent(in) :: list(:)
    real(wp), intent(out) :: bounds(:)
    integer :: i, k
    bounds(1:3) = huge(1.0_wp)
    bounds(4:6) = -huge(1.0_wp)
    do i = 1, size(list)
      do k = 1, 3
        bounds(1:3) = min(bounds(1:3), surface%vertex(:, surface%triangle(k, list(i))))
        bounds(4:6) = max(bounds(4:6), surface%vertex(:, surface%triangle(k, list(i))))
      end do
    end do
  end subroutine bounds_of

  !> Triangles in the tree's order, with the normals of their edges (the mean of the two faces') and
  !> corners (the faces' weighted by their angles there).
  subroutine set_leaves(surface, order, mesh)
    type(surface_t), intent(in) :: surface
    integer, intent(in) :: order(:)
    type(mesh_t), intent(inout) :: mesh
    real(wp), allocatable :: corner_normal(:, :), edge_normal(:, :, :), key(:)
    integer, allocatable :: pair(:)
    real(wp) :: a(3), b(3), n(3)
    integer :: i, k, m, nv, from, to, one, two, lane, page, source
    m = size(order)
    nv = size(surface%vertex, 2)
    allocate (corner_normal(3, nv), edge_normal(3, 3, m), key(3*m))
    corner_normal = 0.0_wp
    do i = 1, m
      associate (t => surface%triangle(:, i))
        n = face_normal(surface, i)
        do k = 1, 3
          from = t(k)
          to = t(modulo(k, 3) + 1)
          a = surface%vertex(:, to) - surface%vertex(:, from)
          b = surface%vertex(:, t(modulo(k + 1, 3) + 1)) - surface%vertex(:, from)
          corner_normal(:, from) = corner_normal(:, from) + atan2(norm(cross(a, b)), dot(a, b))*n
          key(3*i - 3 + k) = real(min(from, to), wp)*real(nv + 1, wp) + real(max(from, to), wp)
        end do
      end associate
    end do
    ! The two triangles at an edge stand side by side once the edges are sorted.
    pair = sorted_order(key)
    do i = 1, 3*m, 2
      one = (pair(i) + 2)/3
      two = (pair(i + 1) + 2)/3
      n = unit(face_normal(surface, one) + face_normal(surface, two))
      edge_normal(:, pair(i) - 3*(one - 1), one) = n
      edge_normal(:, pair(i + 1) - 3*(two - 1), two) = n
    end do
    page = (m + lanes - 1)/lanes
    allocate (mesh%leaf(lanes, leaf_items, page), mesh%feature_normal(3, 6, lanes*page))
    do i = 1, lanes*page
      page = (i + lanes - 1)/lanes
      lane = i - lanes*(page - 1)
      source = order(merge(i, lanes*(page - 1) + 1, i <= m))
      call set_facet(surface, source, mesh%leaf(lane, :, page))
      mesh%feature_normal(:, 1:3, i) = edge_normal(:, :, source)
      do k = 1, 3
        mesh%feature_normal(:, 3 + k, i) = unit(corner_normal(:, surface%triangle(k, source)))
      end do
    end do
  end subroutine set_leaves

  pure subroutine set_facet(surface, i, item)
    type(surface_t), intent(in) :: surface
    integer, intent(in) :: i
    real(wp), intent(out) :: item(:)
    real(wp) :: a(3), ab(3), ac(3)
    a = surface%vertex(:, surface%triangle(1, i))
    ab = surface%vertex(:, surface%triangle(2, i)) - a
    ac = surface%vertex(:, surface%triangle(3, i)) - a
    item(leaf_a:leaf_a + 2) = a
    item(leaf_ab:leaf_ab + 2) = ab
    item(leaf_ac:leaf_ac + 2) = ac
    item(leaf_n:leaf_n + 2) = face_normal(surface, i)
    item(leaf_gram:leaf_gram + 2) = [dot(ab, ab), dot(ab, ac), dot(ac, ac)]
    item(leaf_inverse:leaf_inverse + 2) = 1.0_wp/[dot(ab, ab), dot(ac, ac), dot(ac - ab, ac - ab)]
  end subroutine set_facet

  pure function face_normal(surface, i) result(n)
    type(surface_t), intent(in) :: surface
    integer, intent(in) :: i
    real(wp) :: n(3), a(3)
    a = surface%vertex(:, surface%triangle(1, i))
    n = unit(cross(surface%vertex(:, surface%triangle(2, i)) - a, surface%vertex(:, surface%triangle(3, i)) - a))
  end function face_normal

  !> The grid reaches a tenth of the size beyond the mesh.
  subroutine fill_grid(mesh)
    type(mesh_t), intent(inout) :: mesh
    real(wp) :: margin, p(3), d, g(3)
    integer :: i, j, k, n, facet
    margin = 0.1_wp*mesh%extent
    mesh%cell = (mesh%extent + 2.0_wp*margin)/grid_most
    mesh%cells = max(1, ceiling((mesh%upper - mesh%lower + 2.0_wp*margin)/mesh%cell - 1.0e-9_wp))
    mesh%origin = 0.5_wp*(mesh%lower + mesh%upper) - 0.5_wp*mesh%cell*real(mesh%cells, wp)
    n = product(mesh%cells)
    allocate (mesh%cell_distance(n), mesh%cell_facet(n))
    n = 0
    facet = 1
    do k = 1, mesh%cells(3)
      do j = 1, mesh%cells(2)
        do i = 1, mesh%cells(1)
          n = n + 1
          p = mesh%origin + mesh%cell*(real([i, j, k], wp) - 0.5_wp)
          call mesh_point(mesh, p, facet, d, g)
          mesh%cell_distance(n) = d
          mesh%cell_facet(n) = facet
        end do
      end do
    end do
  end subroutine fill_grid

  !> Signed distance and outward normal of many points. A point farther out than `limit` may get
  !> any distance above `limit` and any unit normal.
  pure subroutine mesh_distance(mesh, limit, n, point, distance, normal)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: limit                      !! [m]
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)                !! [m]
    real(wp), intent(out) :: distance(n), normal(3, n) !! [m], [-]
    real(wp) :: bound, beyond
    integer :: i, facet
    do i = 1, n
      call bounds_of_distance(mesh, point(:, i), bound, beyond, facet)
      if (bound > limit) then
        distance(i) = bound
        normal(:, i) = facet_normal(mesh, facet)
      else
        call mesh_point(mesh, point(:, i), facet, distance(i), normal(:, i))
      end if
    end do
  end subroutine mesh_distance

  !> What the grid knows of a point: its signed distance is at least `bound`, and at most `beyond` in
  !> magnitude; `facet` is near.
  pure subroutine bounds_of_distance(mesh, point, bound, beyond, facet)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: point(3)
    real(wp), intent(out) :: bound, beyond
    integer, intent(out) :: facet
    real(wp) :: place(3), x, y, z
    integer :: i, j, k, cell
    place = (point - mesh%origin)/mesh%cell
    ! Clamped before it becomes an integer: a point may be very far away.
    i = int(max(0.0_wp, min(place(1), mesh%cells(1) - 1.0_wp)))
    j = int(max(0.0_wp, min(place(2), mesh%cells(2) - 1.0_wp)))
    k = int(max(0.0_wp, min(place(3), mesh%cells(3) - 1.0_wp)))
    cell = 1 + i + mesh%cells(1)*(j + mesh%cells(2)*k)
    x = (place(1) - i - 0.5_wp)*mesh%cell
    y = (place(2) - j - 0.5_wp)*mesh%cell
    z = (place(3) - k - 0.5_wp)*mesh%cell
    facet = mesh%cell_facet(cell)
    z = sqrt(x*x + y*y + z*z)
    bound = mesh%cell_distance(cell) - z
    beyond = abs(mesh%cell_distance(cell)) + z
    x = max(mesh%lower(1) - point(1), point(1) - mesh%upper(1), 0.0_wp)
    y = max(mesh%lower(2) - point(2), point(2) - mesh%upper(2), 0.0_wp)
    z = max(mesh%lower(3) - point(3), point(3) - mesh%upper(3), 0.0_wp)
    z = sqrt(x*x + y*y + z*z)
    if (z > 0.0_wp) bound = max(bound, z)
  end subroutine bounds_of_distance

  pure function facet_normal(mesh, facet) result(n)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: facet
    real(wp) :: n(3)
    integer :: page, lane
    page = (facet + lanes - 1)/lanes
    lane = facet - lanes*(page - 1)
    n(1) = mesh%leaf(lane, leaf_n, page)
    n(2) = mesh%leaf(lane, leaf_n + 1, page)
    n(3) = mesh%leaf(lane, leaf_n + 2, page)
  end function facet_normal

  !> Signed distance, outward normal and nearest triangle of one point; `facet` comes in as a guess.
  pure subroutine mesh_point(mesh, point, facet, distance, normal)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: point(3)
    integer, intent(inout) :: facet
    real(wp), intent(out) :: distance, normal(3)
    real(wp) :: least, away(3), side(3)
    integer :: feature
    call closest(mesh, facet, point, least, away, feature)
    call descend(mesh, point, least, facet)
    call closest(mesh, facet, point, least, away, feature)
    if (feature == 0) then
      ! Over a face its plane says it all, to rounding.
      normal = facet_normal(mesh, facet)
      distance = away(1)*normal(1) + away(2)*normal(2) + away(3)*normal(3)
      return
    end if
    side = mesh%feature_normal(:, feature, facet)
    distance = sign(sqrt(least), away(1)*side(1) + away(2)*side(2) + away(3)*side(3))
    normal = side
    if (abs(distance) > touching_ratio*mesh%extent) normal = away/distance
  end subroutine mesh_point

  !> Search the tree for a triangle nearer than the squared distance `least`.
  pure subroutine descend(mesh, point, least, facet)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: point(3)
    real(wp), intent(inout) :: least
    integer, intent(inout) :: facet
    real(wp) :: waiting_distance(stack_depth), d(lanes), near
    integer :: waiting(stack_depth), height, node, k, best
    height = 0
    node = mesh%root
    do
      if (node < 0) then
        call leaf_distance2(mesh%leaf(:, :, -node), point, d)
        do k = 1, lanes
          if (d(k) >= least) cycle
          least = d(k)
          facet = lanes*(-node - 1) + k
        end do
      else
        call box_distance2(mesh%box(:, :, node), point, d)
        best = 0
        near = least
        ! The nearest child is next; the others wait.
        do k = 1, lanes
          if (d(k) >= least) cycle
          if (d(k) < near) then
            if (best > 0) then
              height = height + 1
              waiting(height) = mesh%child(best, node)
              waiting_distance(height) = near
            end if
            best = k
            near = d(k)
          else
            height = height + 1
            waiting(height) = mesh%child(k, node)
            waiting_distance(height) = d(k)
          end if
        end do
        if (best > 0) then
          node = mesh%child(best, node)
          cycle
        end if
      end if
      do
        if (height == 0) return
        node = waiting(height)
        height = height - 1
        if (waiting_distance(height + 1) < least) exit
      end do
    end do
  end subroutine descend

  !> Squared distances from a point to eight boxes.
  pure subroutine box_distance2(bounds, point, square)
    real(wp), intent(in) :: bounds(lanes, 6), point(3)
    real(wp), intent(out) :: square(lanes)
    real(wp) :: x, y, z
    integer :: k
    !GCC$ unroll 1
    do k = 1, lanes
      x = max(bounds(k, 1) - point(1), max(point(1) - bounds(k, 4), 0.0_wp))
      y = max(bounds(k, 2) - point(2), max(point(2) - bounds(k, 5), 0.0_wp))
      z = max(bounds(k, 3) - point(3), max(point(3) - bounds(k, 6), 0.0_wp))
      square(k) = x*x + y*y + z*z
    end do
  end subroutine box_distance2

  !> Squared distances from a point to the eight triangles of a leaf: to the plane where the foot
  !> lies in the triangle, else to the nearest of the three edges.
  pure subroutine leaf_distance2(f, point, square)
    real(wp), intent(in) :: f(lanes, leaf_items), point(3)
    real(wp), intent(out) :: square(lanes)
    real(wp) :: p1, p2, p3, a1, a2, v, w, t, r1, r2, r3, e1, e2, e3, height, first, second, third
    integer :: k
    do k = 1, lanes
      p1 = point(1) - f(k, leaf_a)
      p2 = point(2) - f(k, leaf_a + 1)
      p3 = point(3) - f(k, leaf_a + 2)
      a1 = f(k, leaf_ab)*p1 + f(k, leaf_ab + 1)*p2 + f(k, leaf_ab + 2)*p3
      a2 = f(k, leaf_ac)*p1 + f(k, leaf_ac + 1)*p2 + f(k, leaf_ac + 2)*p3
      height = f(k, leaf_n)*p1 + f(k, leaf_n + 1)*p2 + f(k, leaf_n + 2)*p3
      t = max(0.0_wp, min(1.0_wp, a1*f(k, leaf_inverse)))
      r1 = p1 - t*f(k, leaf_ab)
      r2 = p2 - t*f(k, leaf_ab + 1)
      r3 = p3 - t*f(k, leaf_ab + 2)
      first = r1*r1 + r2*r2 + r3*r3
      t = max(0.0_wp, min(1.0_wp, a2*f(k, leaf_inverse + 1)))
      r1 = p1 - t*f(k, leaf_ac)
      r2 = p2 - t*f(k, leaf_ac + 1)
      r3 = p3 - t*f(k, leaf_ac + 2)
      second = r1*r1 + r2*r2 + r3*r3
      e1 = f(k, leaf_ac) - f(k, leaf_ab)
      e2 = f(k, leaf_ac + 1) - f(k, leaf_ab + 1)
      e3 = f(k, leaf_ac + 2) - f(k, leaf_ab + 2)
      r1 = p1 - f(k, leaf_ab)
      r2 = p2 - f(k, leaf_ab + 1)
      r3 = p3 - f(k, leaf_ab + 2)
      t = max(0.0_wp, min(1.0_wp, (r1*e1 + r2*e2 + r3*e3)*f(k, leaf_inverse + 2)))
      r1 = r1 - t*e1
      r2 = r2 - t*e2
      r3 = r3 - t*e3
      third = r1*r1 + r2*r2 + r3*r3
      v = f(k, leaf_gram + 2)*a1 - f(k, leaf_gram + 1)*a2
      w = f(k, leaf_gram)*a2 - f(k, leaf_gram + 1)*a1
      t = f(k, leaf_gram)*f(k, leaf_gram + 2) - f(k, leaf_gram + 1)*f(k, leaf_gram + 1)
      third = min(first, min(second, third))
      square(k) = merge(height*height, third, v >= 0.0_wp .and. w >= 0.0_wp .and. v + w <= t)
    end do
  end subroutine leaf_distance2

  !> The nearest point of a triangle (Ericson, Real-Time Collision Detection, 5.1.5): squared
  !> distance, the vector from it to the point, and where it is: 0 face, 1 to 3 edge ab, bc, ca,
  !> 4 to 6 corner a, b, c.
  pure subroutine closest(mesh, facet, point, square, away, feature)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: facet
    real(wp), intent(in) :: point(3)
    real(wp), intent(out) :: square, away(3)
    integer, intent(out) :: feature
    real(wp) :: f(leaf_items), p1, p2, p3, a1, a2, b1, b2, c1, c2, v, w, height
    f = mesh%leaf(facet - lanes*((facet - 1)/lanes), :, (facet - 1)/lanes + 1)
    p1 = point(1) - f(leaf_a)
    p2 = point(2) - f(leaf_a + 1)
    p3 = point(3) - f(leaf_a + 2)
    ! Products of both sides with the vectors from the three corners.
    a1 = f(leaf_ab)*p1 + f(leaf_ab + 1)*p2 + f(leaf_ab + 2)*p3
    a2 = f(leaf_ac)*p1 + f(leaf_ac + 1)*p2 + f(leaf_ac + 2)*p3
    b1 = a1 - f(leaf_gram)
    b2 = a2 - f(leaf_gram + 1)
    c1 = a1 - f(leaf_gram + 1)
    c2 = a2 - f(leaf_gram + 2)
    v = 0.0_wp
    w = 0.0_wp
    if (a1 <= 0.0_wp .and. a2 <= 0.0_wp) then
      feature = 4
    else if (b1 >= 0.0_wp .and. b2 <= b1) then
      feature = 5
      v = 1.0_wp
    else if (c2 >= 0.0_wp .and. c1 <= c2) then
      feature = 6
      w = 1.0_wp
    else if (a1*b2 - b1*a2 <= 0.0_wp .and. a1 >= 0.0_wp .and. b1 <= 0.0_wp) then
      feature = 1
      v = a1/(a1 - b1)
    else if (c1*a2 - a1*c2 <= 0.0_wp .and. a2 >= 0.0_wp .and. c2 <= 0.0_wp) then
      feature = 3
      w = a2/(a2 - c2)
    else if (b1*c2 - c1*b2 <= 0.0_wp .and. b2 - b1 >= 0.0_wp .and. c1 - c2 >= 0.0_wp) then
      feature = 2
      w = (b2 - b1)/((b2 - b1) + (c1 - c2))
      v = 1.0_wp - w
    else
      feature = 0
      height = p1*f(leaf_n) + p2*f(leaf_n + 1) + p3*f(leaf_n + 2)
      away(1) = height*f(leaf_n)
      away(2) = height*f(leaf_n + 1)
      away(3) = height*f(leaf_n + 2)
      square = height*height
      return
    end if
    away(1) = p1 - (v*f(leaf_ab) + w*f(leaf_ac))
    away(2) = p2 - (v*f(leaf_ab + 1) + w*f(leaf_ac + 1))
    away(3) = p3 - (v*f(leaf_ab + 2) + w*f(leaf_ac + 2))
    square = away(1)*away(1) + away(2)*away(2) + away(3)*away(3)
  end subroutine closest

end module castnet_mesh
