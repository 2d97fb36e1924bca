!> Triangle meshes: distances against brute force and against the analytic solids, files good and bad.
module test_mesh
  use castnet_kinds, only: wp, sp, i8
  use castnet_constants, only: pi
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t, build_model
  use castnet_scene, only: scene_t
  use castnet_state, only: state_t
  use castnet_shape, only: shape_t, new_shape, new_mesh_shape, new_surface_shape, move_shape, signed_distance, &
                           signed_distance_within, segment_distance, segment_distance_within, swept_contact, tessellate, &
                           shape_volume, shape_centroid, unit_inertia, shape_bounds, shape_bounding_radius, surface_samples
  use castnet_surface, only: surface_t, append_surface
  use castnet_posix, only: process_id
  use castnet_text, only: to_text
  use solids, only: uniform, uniform_vector
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_mesh

  character(len=:), allocatable :: folder  !! where the files of this test are written and removed

contains

  subroutine run_test_mesh()
    folder = '/tmp/castnet_'//to_text(process_id())//'_mesh_'
    call test_case('mesh: a box of many triangles is the box', box_mesh)
    call test_case('mesh: distance, sign and normal of a ring against all its triangles and its winding number', ring_distance)
    call test_case('mesh: on corners, edges and faces the normal is finite and outward', on_the_surface)
    call test_case('mesh: a cylinder of facets converges to the cylinder, second order in distance, first in normal', convergence)
    call test_case('mesh: mass properties of the rocket from its facets', mass_properties)
    call test_case('mesh: a limit changes nothing below it', limits)
    call test_case('mesh: segments are nearest or deepest where no sample is more so', segments)
    call test_case('mesh: a fast node never crosses a panel', panel_crossing)
    call test_case('mesh: text STL, binary STL and OBJ give the same solid', files_agree)
    call test_case('mesh: OBJ polygons, relative corners and comments', obj_details)
    call test_case('mesh: an inside-out surface is turned, a cavity kept', orientation)
    call test_case('mesh: what no solid is made of is refused with its place', refused_surfaces)
    call test_case('mesh: malformed files are refused with line or byte', refused_files)
    call test_case('mesh: damaged files are refused or read, and crash nothing', damaged_files)
    call test_case('mesh: moved to its centroid it keeps its moments', moved)
    call test_case('mesh: a free target turns about its solid''s centroid', targets)
    call remove(['ring.stl       ', 'ring_binary.STL', 'ring.obj       ', 'off.obj        ', 'cube.obj       ', 'bad.obj        ', &
                 'bad.ply        ', 'bad.stl        ', 'bad.STL        '])
  end subroutine run_test_mesh

  subroutine remove(names)
    character(len=*), intent(in) :: names(:)
    integer :: unit, status, i
    do i = 1, size(names)
      open (newunit=unit, file=folder//trim(names(i)), status='old', iostat=status)
      if (status == 0) close (unit, status='delete')
    end do
  end subroutine remove

  ! Surfaces ------------------------------------------------------------------------------------

  !> A box of m x m squares a face, two triangles each, every triangle with corners of its own.
  function grid_box(half, m) result(surface)
    real(wp), intent(in) :: half(3)
    integer, intent(in) :: m
    type(surface_t) :: surface
    real(wp) :: x(3, 4)
    integer :: axis, side, i, j, c, t, u, v
    allocate (surface%vertex(3, 36*m*m), surface%triangle(3, 12*m*m))
    t = 0
    do axis = 1, 3
      u = modulo(axis, 3) + 1
      v = modulo(axis + 1, 3) + 1
      do side = -1, 1, 2
        do i = 0, m - 1
          do j = 0, m - 1
            do c = 1, 4
              x(axis, c) = side*half(axis)
              x(u, c) = half(u)*(2.0_wp*(i + merge(1, 0, c == 2 .or. c == 3))/m - 1.0_wp)
              x(v, c) = half(v)*(2.0_wp*(j + merge(1, 0, c >= 3))/m - 1.0_wp)
            end do
            if (side < 0) x = x(:, [1, 4, 3, 2])
            surface%vertex(:, 3*t + 1:3*t + 6) = x(:, [1, 2, 3, 1, 3, 4])
            t = t + 2
          end do
        end do
      end do
    end do
    do i = 1, t
      surface%triangle(:, i) = [3*i - 2, 3*i - 1, 3*i]
    end do
  end function grid_box

  !> A ring (torus) with corners shared; not convex.
  function ring(radius, tube, n, m) result(surface)
    real(wp), intent(in) :: radius, tube
    integer, intent(in) :: n, m
    type(surface_t) :: surface
    real(wp) :: a, b
    integer :: i, j, t
    allocate (surface%vertex(3, n*m), surface%triangle(3, 2*n*m))
    t = 0
    do i = 0, n - 1
      do j = 0, m - 1
        a = 2.0_wp*pi*i/n
        b = 2.0_wp*pi*j/m
        surface%vertex(:, 1 + i*m + j) = [(radius + tube*cos(b))*cos(a), (radius + tube*cos(b))*sin(a), tube*sin(b)]
        surface%triangle(:, t + 1) = [at(i, j), at(i + 1, j), at(i + 1, j + 1)]
        surface%triangle(:, t + 2) = [at(i, j), at(i + 1, j + 1), at(i, j + 1)]
        t = t + 2
      end do
    end do
  contains
    integer function at(p, q)
      integer, intent(in) :: p, q
      at = 1 + modulo(p, n)*m + modulo(q, m)
    end function at
  end function ring

  !> A cylinder of n facets around; corners on the true surface.
  function facet_cylinder(radius, half_length, n) result(surface)
    real(wp), intent(in) :: radius, half_length
    integer, intent(in) :: n
    type(surface_t) :: surface
    real(wp) :: a
    integer :: i, j
    allocate (surface%vertex(3, 2*n + 2), surface%triangle(3, 4*n))
    do i = 1, n
      a = 2.0_wp*pi*(i - 1)/n
      j = modulo(i, n) + 1
      surface%vertex(:, i) = [radius*cos(a), radius*sin(a), -half_length]
      surface%vertex(:, n + i) = [radius*cos(a), radius*sin(a), half_length]
      surface%triangle(:, 4*i - 3) = [i, j, n + j]
      surface%triangle(:, 4*i - 2) = [i, n + j, n + i]
      surface%triangle(:, 4*i - 1) = [2*n + 1, j, i]
      surface%triangle(:, 4*i) = [2*n + 2, n + i, n + j]
    end do
    surface%vertex(:, 2*n + 1) = [0.0_wp, 0.0_wp, -half_length]
    surface%vertex(:, 2*n + 2) = [0.0_wp, 0.0_wp, half_length]
  end function facet_cylinder

  subroutine make(shape, surface)
    type(shape_t), intent(out) :: shape
    type(surface_t), intent(in) :: surface
    type(error_t), allocatable :: error
    call new_surface_shape(shape, surface, 'surface', error)
    if (allocated(error)) then
      call expect(.false., error%message)
      error stop 'test_mesh: a good surface was refused'
    end if
  end subroutine make

  ! Distances -----------------------------------------------------------------------------------

  subroutine box_mesh()
    integer, parameter :: n = 3000
    type(shape_t) :: mesh, box
    type(error_t), allocatable :: error
    real(wp) :: p(3, n), d(n), g(3, n), d_box(n), g_box(3, n), lower(3), upper(3)
    integer(i8) :: seed
    integer :: i
    call make(mesh, grid_box([0.05_wp, 0.05_wp, 0.15_wp], 9))
    call new_shape(box, 'box', [0.1_wp, 0.1_wp, 0.3_wp], error)
    seed = 1
    do i = 1, n
      p(:, i) = uniform_vector(seed, 10.0_wp**(-modulo(i, 3)))*[1.0_wp, 1.0_wp, 2.0_wp]
    end do
    call signed_distance(mesh, n, p, d, g)
    call signed_distance(box, n, p, d_box, g_box)
    call expect_close(d, d_box, 'distance', atol=1.0e-15_wp)
    do i = 1, n
      ! Deep inside several faces are nearly equally near.
      if (d_box(i) > -0.01_wp) call expect_close(g(:, i), g_box(:, i), 'normal', atol=1.0e-9_wp)
    end do
    call expect_close(shape_volume(mesh), 0.003_wp, 'volume', rtol=1.0e-12_wp)
    call expect_close(reshape(unit_inertia(mesh), [9]), reshape(unit_inertia(box), [9]), 'inertia', atol=1.0e-15_wp)
    call shape_bounds(mesh, lower, upper)
    call expect_close([lower, upper], [-0.05_wp, -0.05_wp, -0.15_wp, 0.05_wp, 0.05_wp, 0.15_wp], 'bounds', atol=0.0_wp)
    call expect_close(shape_bounding_radius(mesh), sqrt(2*0.05_wp**2 + 0.15_wp**2), 'radius', rtol=1.0e-15_wp)
  end subroutine box_mesh

  !> Every triangle by the variational condition (solve in the plane, then its three edges), and the
  !> sign by the solid angle that the surface fills (Van Oosterom & Strackee 1983).
  subroutine ring_distance()
    integer, parameter :: n = 400
    type(shape_t) :: mesh
    type(surface_t) :: surface
    real(wp) :: p(3, n), d(n), g(3, n), least, a(3, 3), turns
    integer(i8) :: seed
    integer :: i, k, c, inside
    surface = ring(0.3_wp, 0.1_wp, 31, 17)
    call make(mesh, surface)
    seed = 2
    do i = 1, n
      p(:, i) = uniform_vector(seed, 0.5_wp)*[1.0_wp, 1.0_wp, 0.4_wp]
    end do
    call signed_distance(mesh, n, p, d, g)
    inside = 0
    do i = 1, n
      least = huge(1.0_wp)
      turns = 0.0_wp
      do k = 1, size(surface%triangle, 2)
        do c = 1, 3
          a(:, c) = surface%vertex(:, surface%triangle(c, k)) - p(:, i)
        end do
        least = min(least, triangle_distance(a))
        turns = turns + solid_angle(a)
      end do
      turns = turns/(4.0_wp*pi)
      if (turns > 0.5_wp) inside = inside + 1
      call expect_close(d(i), merge(-least, least, turns > 0.5_wp), 'distance', atol=1.0e-14_wp)
      call expect_close(sum(g(:, i)**2), 1.0_wp, 'unit normal', atol=1.0e-14_wp)
    end do
    call expect(inside > 40 .and. inside < n - 40, 'inside and outside were seen')
    p = p - spread(d, 1, 3)*g
    call signed_distance(mesh, n, p, d, g)
    call expect_close(d, spread(0.0_wp, 1, n), 'the foot is on the surface', atol=1.0e-15_wp)
  end subroutine ring_distance

  !> Distance of the origin from a triangle of three corners.
  real(wp) function triangle_distance(a)
    real(wp), intent(in) :: a(3, 3)
    real(wp) :: u(3), v(3), uu, uv, vv, s, t, determinant, w(3)
    integer :: k
    u = a(:, 2) - a(:, 1)
    v = a(:, 3) - a(:, 1)
    uu = sum(u*u)
    uv = sum(u*v)
    vv = sum(v*v)
    determinant = uu*vv - uv*uv
    s = (uv*sum(v*a(:, 1)) - vv*sum(u*a(:, 1)))/determinant
    t = (uv*sum(u*a(:, 1)) - uu*sum(v*a(:, 1)))/determinant
    triangle_distance = huge(1.0_wp)
    if (s >= 0.0_wp .and. t >= 0.0_wp .and. s + t <= 1.0_wp) then
      triangle_distance = sqrt(sum((a(:, 1) + s*u + t*v)**2))
      return
    end if
    do k = 1, 3
      u = a(:, modulo(k, 3) + 1) - a(:, k)
      s = max(0.0_wp, min(1.0_wp, -sum(u*a(:, k))/sum(u*u)))
      w = a(:, k) + s*u
      triangle_distance = min(triangle_distance, sqrt(sum(w*w)))
    end do
  end function triangle_distance

  real(wp) function solid_angle(a)
    real(wp), intent(in) :: a(3, 3)
    real(wp) :: length(3), volume
    length = sqrt(sum(a*a, 1))
    volume = a(1, 1)*(a(2, 2)*a(3, 3) - a(3, 2)*a(2, 3)) + a(2, 1)*(a(3, 2)*a(1, 3) - a(1, 2)*a(3, 3)) + &
             a(3, 1)*(a(1, 2)*a(2, 3) - a(2, 2)*a(1, 3))
    solid_angle = 2.0_wp*atan2(volume, product(length) + sum(a(:, 1)*a(:, 2))*length(3) + &
                               sum(a(:, 2)*a(:, 3))*length(1) + sum(a(:, 3)*a(:, 1))*length(2))
  end function solid_angle

  subroutine on_the_surface()
    type(shape_t) :: mesh
    type(surface_t) :: surface
    real(wp), allocatable :: p(:, :), d(:), g(:, :), q(:, :), d_q(:), g_q(:, :)
    integer :: i, k, n, m
    surface = ring(0.3_wp, 0.1_wp, 24, 12)
    call make(mesh, surface)
    n = size(surface%vertex, 2)
    m = size(surface%triangle, 2)
    allocate (p(3, n + 4*m), d(n + 4*m), g(3, n + 4*m), q(3, n + 4*m), d_q(n + 4*m), g_q(3, n + 4*m))
    p(:, :n) = surface%vertex
    do i = 1, m
      associate (v => surface%vertex, t => surface%triangle(:, i))
        do k = 1, 3
          p(:, n + 4*(i - 1) + k) = 0.5_wp*(v(:, t(k)) + v(:, t(modulo(k, 3) + 1)))
        end do
        p(:, n + 4*i) = (v(:, t(1)) + v(:, t(2)) + v(:, t(3)))/3.0_wp
      end associate
    end do
    call signed_distance(mesh, size(d), p, d, g)
    call expect_close(d, spread(0.0_wp, 1, size(d)), 'on the surface', atol=1.0e-15_wp)
    call expect_close(sum(g**2, 1), spread(1.0_wp, 1, size(d)), 'unit normals', atol=1.0e-14_wp)
    q = p + 1.0e-4_wp*g
    call signed_distance(mesh, size(d), q, d_q, g_q)
    call expect(minval(d_q) > 0.5e-4_wp, 'they lead out')
    q = p - 1.0e-4_wp*g
    call signed_distance(mesh, size(d), q, d_q, g_q)
    call expect(maxval(d_q) < -0.5e-4_wp, 'and in')
  end subroutine on_the_surface

  !> Chords lie below the arc by R (1 - cos(pi/N)): the distance is off by O(1/N^2), the normal by O(1/N).
  subroutine convergence()
    integer, parameter :: n = 2000
    type(shape_t) :: mesh, cylinder
    type(error_t), allocatable :: error
    real(wp) :: p(3, n), d(n), g(3, n), d0(n), g0(3, n), off_d(3), off_g(3), angle, out
    integer(i8) :: seed
    integer :: i, k
    call new_shape(cylinder, 'cylinder', [0.2_wp, 0.5_wp, 0.0_wp], error)
    seed = 3
    do i = 1, n
      ! Contacts: within 5 mm of the barrel or a cap, not over the rim.
      angle = 2.0_wp*pi*uniform(seed)
      out = 0.005_wp*(2.0_wp*uniform(seed) - 1.0_wp)
      if (modulo(i, 2) == 0) then
        p(:, i) = [(0.1_wp + out)*cos(angle), (0.1_wp + out)*sin(angle), 0.2_wp*(2.0_wp*uniform(seed) - 1.0_wp)]
      else
        p(:, i) = [0.09_wp*cos(angle), 0.09_wp*sin(angle), 0.25_wp + out]
      end if
    end do
    call signed_distance(cylinder, n, p, d0, g0)
    do k = 1, 3
      call make(mesh, facet_cylinder(0.1_wp, 0.25_wp, 32*2**k))
      call signed_distance(mesh, n, p, d, g)
      off_d(k) = maxval(abs(d - d0))
      off_g(k) = maxval(abs(g - g0))
      call expect(off_d(k) < 1.01_wp*0.1_wp*(1.0_wp - cos(pi/(32*2**k))), 'distance within the chord''s height')
    end do
    do k = 1, 2
      call expect_close(log(off_d(k)/off_d(k + 1))/log(2.0_wp), 2.0_wp, 'order of the distance', atol=0.1_wp)
      call expect_close(log(off_g(k)/off_g(k + 1))/log(2.0_wp), 1.0_wp, 'order of the normal', atol=0.1_wp)
    end do
  end subroutine convergence

  !> The polygon's own closed forms: area (N/2) R^2 sin(2 pi/N), so that both moments converge as 1/N^2.
  subroutine mass_properties()
    type(shape_t) :: mesh
    real(wp) :: inertia(3, 3), off(2)
    integer :: k
    do k = 1, 2
      call make(mesh, facet_cylinder(1.95_wp, 5.5235_wp, 100*2**k))
      inertia = 8226.0_wp*unit_inertia(mesh)
      off(k) = 8226.0_wp*1.95_wp**2/2.0_wp - inertia(3, 3)
      call expect_close(inertia(3, 3), 15640.0_wp, 'axial', rtol=1.0e-3_wp)
      call expect_close(inertia(1, 1), 91476.0_wp, 'transverse', rtol=1.0e-3_wp)
    end do
    call expect_close(log(off(1)/off(2))/log(2.0_wp), 2.0_wp, 'order', atol=0.01_wp)
  end subroutine mass_properties

  subroutine limits()
    integer, parameter :: n = 2000
    type(shape_t) :: mesh
    real(wp) :: p(3, n), q(3, n), t(n), t2(n), d(n), g(3, n), d2(n), g2(3, n), limit
    integer(i8) :: seed
    integer :: i
    call make(mesh, ring(0.3_wp, 0.1_wp, 40, 20))
    seed = 4
    limit = 0.02_wp
    do i = 1, n
      p(:, i) = uniform_vector(seed, merge(0.5_wp, 5.0_wp, modulo(i, 3) > 0))*[1.0_wp, 1.0_wp, 0.4_wp]
      q(:, i) = p(:, i) + uniform_vector(seed, 0.1_wp)
    end do
    call signed_distance(mesh, n, p, d, g)
    call signed_distance_within(mesh, limit, n, p, d2, g2)
    do i = 1, n
      if (d(i) <= limit) then
        call expect(abs(d(i) - d2(i)) <= 0.0_wp .and. maxval(abs(g(:, i) - g2(:, i))) <= 0.0_wp, 'the same bits')
      else
        call expect(d2(i) > limit .and. abs(sum(g2(:, i)**2) - 1.0_wp) < 1.0e-14_wp, 'above the limit')
      end if
    end do
    call segment_distance(mesh, n, p, q, t, d, g)
    call segment_distance_within(mesh, limit, n, p, q, t2, d2, g2)
    do i = 1, n
      if (d(i) <= limit) then
        call expect(abs(d(i) - d2(i)) <= 1.0e-15_wp, 'segments: the same')
      else
        call expect(d2(i) > limit, 'segments: above the limit')
      end if
    end do
  end subroutine limits

  subroutine segments()
    integer, parameter :: n = 300
    type(shape_t) :: mesh, box
    type(error_t), allocatable :: error
    real(wp) :: a(3), b(3), t, d, g(3), t0, d0, g0(3), p(3, 0:n), ds(0:n), gs(3, 0:n)
    integer(i8) :: seed
    integer :: i, j, k
    call make(mesh, grid_box([0.05_wp, 0.1_wp, 0.15_wp], 7))
    call new_shape(box, 'box', [0.1_wp, 0.2_wp, 0.3_wp], error)
    seed = 5
    do i = 1, 600
      a = uniform_vector(seed, 0.25_wp)
      b = a + uniform_vector(seed, merge(0.3_wp, 0.03_wp, modulo(i, 2) == 0))
      if (modulo(i, 5) == 0) b(1 + modulo(i, 3)) = a(1 + modulo(i, 3))   ! parallel to two faces
      call segment_distance(mesh, a, b, t, d, g)
      call segment_distance(box, a, b, t0, d0, g0)
      call expect_close(d, d0, 'as the box', atol=2.0e-12_wp)
      call segment_distance(mesh, a, a, t, d, g)
      call signed_distance(box, 1, a, ds(0:0), gs(:, 0:0))
      call expect_close(d, ds(0), 'no length', atol=1.0e-15_wp)
    end do
    ! Over a face and along an edge: the middle of the piece that is equally near.
    call segment_distance(mesh, [-0.2_wp, 0.02_wp, 0.17_wp], [0.3_wp, 0.02_wp, 0.17_wp], t, d, g)
    call expect_close([t, d, g], [0.4_wp, 0.02_wp, 0.0_wp, 0.0_wp, 1.0_wp], 'over a face', atol=1.0e-12_wp)
    call segment_distance(mesh, [0.08_wp, -0.5_wp, 0.19_wp], [0.08_wp, 0.3_wp, 0.19_wp], t, d, g)
    call expect_close([t, d, g], [0.625_wp, 0.05_wp, 0.6_wp, 0.0_wp, 0.8_wp], 'along an edge', atol=1.0e-12_wp)
    ! A solid that is not convex: exact outside, the right sign and a good depth inside.
    call make(mesh, ring(0.3_wp, 0.1_wp, 32, 16))
    do i = 1, 400
      a = uniform_vector(seed, 0.5_wp)*[1.0_wp, 1.0_wp, 0.4_wp]
      b = a + uniform_vector(seed, merge(0.8_wp, 0.05_wp, modulo(i, 2) == 0))*[1.0_wp, 1.0_wp, 0.4_wp]
      call segment_distance(mesh, a, b, t, d, g)
      do j = 0, n
        p(:, j) = a + (b - a)*(real(j, wp)/n)
      end do
      call signed_distance(mesh, n + 1, p, ds, gs)
      k = minloc(ds, 1) - 1
      if (ds(k) > 0.0_wp) then
        call expect(d <= ds(k) + 1.0e-14_wp, 'ring: least outside')
      else
        call expect(d <= 0.98_wp*ds(k), 'ring: as deep as any sample, nearly')
      end if
      call signed_distance(mesh, 1, a + (b - a)*t, ds(0:0), gs(:, 0:0))
      call expect_close(d, ds(0), 'ring: the distance there', atol=1.0e-15_wp)
    end do
  end subroutine segments

  subroutine panel_crossing()
    integer, parameter :: n = 200
    type(shape_t) :: mesh, panel
    type(error_t), allocatable :: error
    real(wp) :: p0(3, n), p1(3, n), t(n), d(n), g(3, n), t0(n), d0(n), g0(3, n)
    logical :: hit(n), hit0(n)
    integer(i8) :: seed
    integer :: i
    call make(mesh, grid_box([0.2_wp, 0.15_wp, 0.00025_wp], 10))
    call new_shape(panel, 'box', [0.4_wp, 0.3_wp, 0.0005_wp], error)
    seed = 6
    do i = 1, n
      p0(:, i) = uniform_vector(seed, 0.3_wp)
      p1(:, i) = uniform_vector(seed, 0.3_wp)
    end do
    call swept_contact(mesh, n, p0, p1, 0.002_wp, t, hit, d, g)
    call swept_contact(panel, n, p0, p1, 0.002_wp, t0, hit0, d0, g0)
    call expect(all(hit .eqv. hit0), 'the same hits')
    call expect(count(hit) > n/5, 'there were hits')
    do i = 1, n
      if (.not. hit(i)) cycle
      call expect_close(t(i), t0(i), 'when', atol=1.0e-8_wp)
      call expect_close(d(i), d0(i), 'how near', atol=1.0e-10_wp)
      call expect(t(i) <= t0(i) + 1.0e-12_wp, 'not late')
    end do
  end subroutine panel_crossing

  ! Files ---------------------------------------------------------------------------------------

  subroutine files_agree()
    type(surface_t) :: surface, one, two, three
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    surface = ring(0.3_wp, 0.1_wp, 20, 10)
    surface%vertex = real(real(surface%vertex, sp), wp)  ! what an STL can hold
    call write_text_stl(folder//'ring.stl', surface)
    call new_mesh_shape(shape, folder//'ring.stl', error)
    call report(error, 'text STL')
    call tessellate(shape, one)
    call write_binary_stl(folder//'ring_binary.STL', surface, 'solid no text file')
    call new_mesh_shape(shape, folder//'ring_binary.STL', error)
    call report(error, 'binary STL')
    call tessellate(shape, two)
    call write_obj(folder//'ring.obj', surface)
    call new_mesh_shape(shape, folder//'ring.obj', error)
    call report(error, 'OBJ')
    call tessellate(shape, three)
    call expect(size(one%vertex, 2) == 200, 'corners joined')
    call expect(all(abs(corners(one) - corners(surface)) <= 0.0_wp), 'text STL: the triangles')
    call expect(all(abs(corners(two) - corners(surface)) <= 0.0_wp), 'binary STL: the triangles')
    call expect(all(abs(corners(three) - corners(surface)) <= 0.0_wp), 'OBJ: the triangles')
  end subroutine files_agree

  function corners(surface) result(x)
    type(surface_t), intent(in) :: surface
    real(wp), allocatable :: x(:)
    integer :: i
    allocate (x(9*size(surface%triangle, 2)))
    do i = 1, size(surface%triangle, 2)
      x(9*i - 8:9*i) = reshape(surface%vertex(:, surface%triangle(:, i)), [9])
    end do
  end function corners

  subroutine report(error, words)
    type(error_t), allocatable, intent(in) :: error
    character(len=*), intent(in) :: words
    if (allocated(error)) then
      call expect(.false., words//': '//error%message)
      error stop 'test_mesh: a good file was refused'
    end if
  end subroutine report

  subroutine write_text_stl(path, surface)
    character(len=*), intent(in) :: path
    type(surface_t), intent(in) :: surface
    integer :: unit, i, k
    open (newunit=unit, file=path, action='write', status='replace')
    write (unit, '(a)') 'solid ring'
    do i = 1, size(surface%triangle, 2)
      write (unit, '(a,/,a)') ' facet normal 0 0 1', '  outer loop'
      do k = 1, 3
        write (unit, '(a,3es24.16)') '   vertex ', surface%vertex(:, surface%triangle(k, i))
      end do
      write (unit, '(a,/,a)') '  endloop', ' endfacet'
    end do
    write (unit, '(a)') 'endsolid ring'
    close (unit)
  end subroutine write_text_stl

  subroutine write_binary_stl(path, surface, title)
    character(len=*), intent(in) :: path, title
    type(surface_t), intent(in) :: surface
    character(len=80) :: header
    integer :: unit, i, k
    header = title
    open (newunit=unit, file=path, action='write', status='replace', access='stream', form='unformatted')
    write (unit) header, size(surface%triangle, 2)
    do i = 1, size(surface%triangle, 2)
      write (unit) [0.0_sp, 0.0_sp, 0.0_sp]
      do k = 1, 3
        write (unit) real(surface%vertex(:, surface%triangle(k, i)), sp)
      end do
      write (unit) achar(0), achar(0)
    end do
    close (unit)
  end subroutine write_binary_stl

  subroutine write_obj(path, surface)
    character(len=*), intent(in) :: path
    type(surface_t), intent(in) :: surface
    integer :: unit, i
    open (newunit=unit, file=path, action='write', status='replace')
    write (unit, '(a)') '# a ring', 'o ring'
    do i = 1, size(surface%vertex, 2)
      write (unit, '(a,3es24.16)') 'v', surface%vertex(:, i)
    end do
    do i = 1, size(surface%triangle, 2)
      write (unit, '(a,3(1x,i0,a))') 'f', surface%triangle(1, i), '//1', surface%triangle(2, i), '/2/3', &
        surface%triangle(3, i), '/4'
    end do
    close (unit)
  end subroutine write_obj

  subroutine write_lines(path, lines)
    character(len=*), intent(in) :: path, lines(:)
    integer :: unit, i
    open (newunit=unit, file=path, action='write', status='replace')
    do i = 1, size(lines)
      write (unit, '(a)') trim(lines(i))
    end do
    close (unit)
  end subroutine write_lines

  !> A unit cube of six squares, in the ways that exporters write it.
  subroutine obj_details()
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    character(len=40) :: lines(18)
    lines = [character(len=40) :: '# cube', 'mtllib cube.mtl', '', 'v 0 0 0', 'v 1. 0 0 1.0', 'v 1 1 0', 'v 0 1 0 ', &
             'v 0 0 1', achar(9)//'v 1e0 0 1   # corner', 'v 1 1 1'//achar(13), 'v 0 +1 1.00E+00', 's off', &
             'f 4 3 2 1', 'f 5 6 7 8', 'f -8 -7 -3 -4', 'f 2 3 7 6', 'f 3/1 4/2 8/3 7/4', 'f 4//1 1//1 5//1 8//1']
    call write_lines(folder//'cube.obj', lines)
    call new_mesh_shape(shape, folder//'cube.obj', error)
    call report(error, 'cube')
    call expect_close(shape_volume(shape), 1.0_wp, 'volume', rtol=1.0e-14_wp)
    call expect_close(shape_centroid(shape), [0.5_wp, 0.5_wp, 0.5_wp], 'centroid', atol=1.0e-15_wp)
  end subroutine obj_details

  subroutine orientation()
    type(shape_t) :: shape
    type(surface_t) :: outer, inner
    real(wp) :: p(3, 3), d(3), g(3, 3)
    outer = grid_box([0.2_wp, 0.2_wp, 0.2_wp], 2)
    outer%triangle = outer%triangle([1, 3, 2], :)
    call make(shape, outer)
    call expect_close(shape_volume(shape), 0.064_wp, 'turned', rtol=1.0e-12_wp)
    outer%triangle = outer%triangle([1, 3, 2], :)
    inner = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 2)
    inner%triangle = inner%triangle([1, 3, 2], :)
    call append_surface(outer, inner)
    call make(shape, outer)
    call expect_close(shape_volume(shape), 0.056_wp, 'with a cavity', rtol=1.0e-12_wp)
    p = 0.0_wp
    p(1, :) = [0.0_wp, 0.13_wp, 0.25_wp]
    call signed_distance(shape, 3, p, d, g)
    call expect_close(d, [0.1_wp, -0.03_wp, 0.05_wp], 'in the cavity, in the wall, outside', atol=1.0e-15_wp)
  end subroutine orientation

  subroutine refused_surfaces()
    type(surface_t) :: surface, other
    surface = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 2)
    surface%triangle = surface%triangle(:, 2:)
    call refuse(surface, 'the surface is open')
    surface = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 2)
    surface%triangle(:, 7) = surface%triangle([1, 3, 2], 7)
    call refuse(surface, 'face opposite ways')
    surface = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 2)
    surface%vertex(:, surface%triangle(2, 5)) = 0.5_wp*(surface%vertex(:, surface%triangle(1, 5)) + &
                                                        surface%vertex(:, surface%triangle(3, 5)))
    call refuse(surface, 'triangle 5 has no area')
    surface = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 2)
    other = surface
    other%vertex(1:2, :) = other%vertex(1:2, :) + 0.2_wp
    call append_surface(surface, other)
    call refuse(surface, 'triangles meet at one edge')
    surface = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 2)
    other = grid_box([0.05_wp, 0.05_wp, 0.05_wp], 1)
    other%vertex(1, :) = other%vertex(1, :) + 1.0_wp
    other%triangle = other%triangle([1, 3, 2], :)
    call append_surface(surface, other)
    call refuse(surface, 'inside out')
    call refuse(grid_box([100.0_wp, 1000.0_wp, 100.0_wp], 1), 'millimetres')
    call refuse(grid_box([1.0e-4_wp, 1.0e-4_wp, 1.0e-4_wp], 1), 'from 1 mm to 1 km')
  end subroutine refused_surfaces

  subroutine refuse(surface, words)
    type(surface_t), intent(in) :: surface
    character(len=*), intent(in) :: words
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    call new_surface_shape(shape, surface, 'x.stl', error)
    call expect(allocated(error), 'refused: '//words)
    if (.not. allocated(error)) return
    call expect(index(error%message, words) > 0 .and. index(error%message, 'x.stl: ') == 1, &
                'says "'//words//'": '//error%message)
    call expect(error%code == 2, 'as bad input')
  end subroutine refuse

  subroutine refused_files()
    type(surface_t) :: surface
    integer :: unit
    character(len=40) :: lines(8)
    lines = [character(len=40) :: 'v 0 0 0', 'v 1 0 0', 'v 0 1 0', 'v 0 0 1', 'f 1 3 2', 'f 1 2 4', 'f 2 3 4', 'f 1 4 3']
    call refuse_line(lines, 2, 'v 1 nan 0', 'bad.obj:2: ')
    call refuse_line(lines, 2, 'v 1 0', 'bad.obj:2: 2 numbers seen')
    call refuse_line(lines, 2, 'v 1 0 1e999', 'bad.obj:2: ')
    call refuse_line(lines, 2, 'v 1 0 2*3', 'bad.obj:2: ')
    call refuse_line(lines, 6, 'f 1 2 5', 'bad.obj:6: corner ''5'' is no vertex')
    call refuse_line(lines, 6, 'f 1 2 0', 'bad.obj:6: corner ''0''')
    call refuse_line(lines, 6, 'f 1 2 99999999999', 'bad.obj:6: ')
    call refuse_line(lines, 6, 'f 1 2 -5', 'bad.obj:6: ')
    call refuse_line(lines, 6, 'f 1 2', 'bad.obj:6: a face of 2 corners')
    call refuse_line(lines, 6, 'curv 0 1', 'bad.obj:6: ''curv''')
    call refuse_line(lines, 6, '', '3 triangles')
    call refuse_line(lines, 6, 'f 1 2 2', 'the surface is open')
    call refuse_path(folder//'none.obj', 'none.obj')
    call write_lines(folder//'bad.ply', lines)
    call refuse_path(folder//'bad.ply', 'ends in .stl or .obj')
    call write_lines(folder//'bad.stl', ['solid x              ', 'facet normal 0 0 1   ', 'outer loop           ', &
                                         'vertex 0 0 0         ', 'vertex 1 0 0         ', 'endloop              '])
    call refuse_path(folder//'bad.stl', 'bad.stl:6: ''endloop'' seen, ''vertex'' expected')
    call write_lines(folder//'bad.stl', ['solid x              ', 'facet normal 0 0 1   ', 'outer loop           '])
    call refuse_path(folder//'bad.stl', 'the file ends where ''vertex''')
    call write_lines(folder//'bad.stl', ['solid x ', 'endsolid'])
    call refuse_path(folder//'bad.stl', '0 triangles')
    call write_lines(folder//'bad.stl', ['hello'])
    call refuse_path(folder//'bad.stl', 'no STL')
    ! Binary: a count that the file's length denies, and a corner that is no number.
    surface = grid_box([0.1_wp, 0.1_wp, 0.1_wp], 1)
    call write_binary_stl(folder//'bad.stl', surface, 'binary')
    open (newunit=unit, file=folder//'bad.stl', access='stream', form='unformatted', status='old')
    write (unit, pos=81) -1
    close (unit)
    call refuse_path(folder//'bad.stl', 'byte 81: a binary STL of 4294967295 triangles')
    surface%vertex(2, 4) = 0.1_wp
    call write_binary_stl(folder//'bad.stl', surface, 'binary')
    open (newunit=unit, file=folder//'bad.stl', access='stream', form='unformatted', status='old')
    write (unit, pos=84 + 50 + 12 + 1) int(z'7fc00000')
    close (unit)
    call refuse_path(folder//'bad.stl', 'byte 135: triangle 2')
  end subroutine refused_files

  !> Good files with a few bytes changed, cut, dropped or doubled.
  subroutine damaged_files()
    integer, parameter :: n = 150
    character(len=4), parameter :: ending(3) = ['.stl', '.STL', '.obj']
    type(surface_t) :: surface
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    character(len=:), allocatable :: good, text
    integer(i8) :: seed
    integer :: unit, bytes, i, j, k, a, b, refused
    surface = ring(0.3_wp, 0.1_wp, 5, 4)
    seed = 1234
    do k = 1, 3
      if (k == 1) call write_text_stl(folder//'bad'//ending(k), surface)
      if (k == 2) call write_binary_stl(folder//'bad'//ending(k), surface, 'binary')
      if (k == 3) call write_obj(folder//'bad'//ending(k), surface)
      open (newunit=unit, file=folder//'bad'//ending(k), access='stream', form='unformatted', status='old')
      inquire (unit=unit, size=bytes)
      allocate (character(len=bytes) :: good)
      read (unit) good
      close (unit)
      refused = 0
      do i = 1, n
        text = good
        do j = 1, 1 + modulo(i, 3)
          a = 1 + int(uniform(seed)*(len(text) - 1))
          b = min(len(text), a + int(60*uniform(seed)))
          select case (int(5*uniform(seed)))
          case (0)
            text(a:a) = achar(int(255*uniform(seed)))
          case (1)
            text(a:a) = text(b:b)
          case (2)
            text = text(:a)//text(b:)
          case (3)
            text = text(:b)//text(a:)
          case default
            if (modulo(i, 7) == 0) text = text(:a)
          end select
        end do
        open (newunit=unit, file=folder//'bad'//ending(k), access='stream', form='unformatted', status='replace')
        write (unit) text
        close (unit)
        if (allocated(error)) deallocate (error)
        call new_mesh_shape(shape, folder//'bad'//ending(k), error)
        if (.not. allocated(error)) cycle
        refused = refused + 1
        call expect(error%code == 2 .and. index(error%message, folder//'bad'//ending(k)) == 1, 'refused as bad input')
      end do
      call expect(refused > n/2, 'most are refused')
      deallocate (good)
    end do
  end subroutine damaged_files

  !> A good tetrahedron with one line replaced.
  subroutine refuse_line(lines, number, text, words)
    character(len=*), intent(in) :: lines(:), text, words
    integer, intent(in) :: number
    character(len=len(lines)) :: changed(size(lines))
    changed = lines
    changed(number) = text
    call write_lines(folder//'bad.obj', changed)
    call refuse_path(folder//'bad.obj', words)
  end subroutine refuse_line

  subroutine refuse_path(path, words)
    character(len=*), intent(in) :: path, words
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    call new_mesh_shape(shape, path, error)
    call expect(allocated(error), 'refused: '//words)
    if (.not. allocated(error)) return
    call expect(index(error%message, words) > 0, 'says "'//words//'": '//error%message)
  end subroutine refuse_path

  subroutine moved()
    type(shape_t) :: shape
    type(surface_t) :: surface
    real(wp) :: before(3, 3), d(1), g(3, 1)
    real(wp), allocatable :: sample(:, :)
    surface = grid_box([0.1_wp, 0.2_wp, 0.3_wp], 3)
    surface%vertex = surface%vertex + 5.0_wp
    call make(shape, surface)
    before = unit_inertia(shape)
    call move_shape(shape, shape_centroid(shape))
    call expect_close(shape_centroid(shape), [0.0_wp, 0.0_wp, 0.0_wp], 'centroid', atol=1.0e-13_wp)
    call expect_close(reshape(unit_inertia(shape), [9]), reshape(before, [9]), 'inertia', atol=1.0e-13_wp)
    call signed_distance(shape, 1, [0.0_wp, 0.0_wp, 0.0_wp], d, g)
    call expect_close(d(1), -0.1_wp, 'distance', atol=1.0e-13_wp)
    call surface_samples(shape, 100, sample)
    call expect(size(sample, 2) == 8, 'its samples are the corners')
  end subroutine moved

  !> A mesh is moved to its centroid unless its inertia is given; a compound must be placed there.
  subroutine targets()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(file_net_t), allocatable :: no_net
    type(error_t), allocatable :: error
    type(surface_t) :: surface
    surface = grid_box([0.1_wp, 0.2_wp, 0.3_wp], 2)
    surface%vertex = surface%vertex + 5.0_wp
    call write_obj(folder//'off.obj', surface)
    allocate (scene%target)
    scene%path = folder//'scene.nml'
    scene%target%shape = 'mesh'
    scene%target%file = folder//'off.obj'
    scene%target%mass = 12.0_wp
    scene%target%position = 0.0_wp
    call build_model(scene, no_net, model, state, error)
    call report(error, 'mesh target')
    call expect_close(shape_centroid(model%target%shape), [0.0_wp, 0.0_wp, 0.0_wp], 'moved', atol=1.0e-13_wp)
    call expect_close(model%target%inertia(1, 1), 0.16_wp + 0.36_wp, 'uniform', rtol=1.0e-12_wp)
    scene%target%inertia = [1.0_wp, 1.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    call build_model(scene, no_net, model, state, error)
    call report(error, 'mesh target with inertia')
    call expect_close(shape_centroid(model%target%shape), [5.0_wp, 5.0_wp, 5.0_wp], 'not moved', atol=1.0e-13_wp)
    deallocate (scene%target)
    allocate (scene%target, scene%parts(2))
    scene%target%shape = 'compound'
    scene%target%mass = 1.0_wp
    scene%target%position = 0.0_wp
    scene%parts(1)%shape = 'sphere'
    scene%parts(1)%dimensions = 1.0_wp
    scene%parts(2) = scene%parts(1)
    scene%parts(2)%position = [2.0_wp, 0.0_wp, 0.0_wp]
    call build_model(scene, no_net, model, state, error)
    call expect(allocated(error), 'a compound off its centroid')
    if (.not. allocated(error)) return
    call expect(index(error%message, 'is at 1, 0, 0 m') > 0, error%message)
    deallocate (error)
    scene%parts(1)%position = [-2.0_wp, 0.0_wp, 0.0_wp]
    call build_model(scene, no_net, model, state, error)
    call report(error, 'compound on its centroid')
  end subroutine targets

end module test_mesh
