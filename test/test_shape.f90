!> Shapes: signed distance and mass properties.
module test_shape
  use castnet_kinds, only: wp, i8
  use castnet_constants, only: pi
  use castnet_error, only: error_t
  use castnet_shape, only: shape_t, new_shape, new_compound, signed_distance, unit_inertia, shape_volume, shape_centroid, &
                           tessellate, shape_bounds, shape_bounding_radius, shape_length, surface_samples
  use castnet_surface, only: surface_t, surface_volume, surface_centroid, surface_inertia
  use solids, only: solid_t, primitives, panel_union, uniform, uniform_vector, surface_point, is_inside
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_shape

contains

  subroutine run_test_shape()
    call test_case('shape: mass properties of the rocket and the cubesat', mass_properties)
    call test_case('shape: the distance of a primitive is the least distance to its surface', least_distance)
    call test_case('shape: the normal is the gradient, and the distance is 1-Lipschitz', gradient)
    call test_case('shape: points on corners, edges, axes and at the centre have a finite unit normal', special_points)
    call test_case('shape: batches of any size give the same bits', batches)
    call test_case('shape: the distance of a union is exact outside, its sign everywhere', union_distance)
    call test_case('shape: -d n leads out of a union, also from deep inside and across seams', union_exit)
    call test_case('shape: re-entrant edges and seams of a union', union_corners)
    call test_case('shape: tessellations are closed, outward and converge to the solid', tessellations)
    call test_case('shape: bounds, samples and mass properties of a union', union_bulk)
    call test_case('shape: what is refused', refusals)
  end subroutine run_test_shape

  subroutine mass_properties()
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    real(wp) :: inertia(3, 3)
    call new_shape(shape, 'cylinder', [3.9_wp, 11.047_wp, 0.0_wp], error)
    call expect(.not. allocated(error), 'a cylinder')
    inertia = 8226.0_wp*unit_inertia(shape)
    call expect_close(inertia(3, 3), 15640.0_wp, 'rocket, axial', atol=0.5_wp)
    call expect_close(inertia(1, 1), 91476.0_wp, 'rocket, transverse', atol=0.5_wp)
    call new_shape(shape, 'box', [0.1_wp, 0.1_wp, 0.3_wp], error)
    inertia = 3.5_wp*unit_inertia(shape)
    call expect_close(inertia(1, 1), 0.029167_wp, 'cubesat, transverse', atol=5.0e-7_wp)
    call expect_close(inertia(3, 3), 0.0058333_wp, 'cubesat, axial', atol=5.0e-8_wp)
  end subroutine mass_properties

  !> p - d n must lie on the surface, no surface point may be nearer than |d|, and d < 0 inside only.
  subroutine least_distance()
    integer, parameter :: n_point = 400, n_surface = 4000
    type(solid_t) :: list(9)
    real(wp) :: p(3, n_point), d(n_point), g(3, n_point), foot(3, n_point), d_foot(n_point), g_foot(3, n_point)
    real(wp) :: s(3, n_surface), d_s(n_surface), g_s(3, n_surface), nearest, worst_foot, worst_near, worst_surface
    integer(i8) :: seed
    integer :: i, j, k
    list = primitives()
    seed = 20180911
    do k = 1, size(list)
      do i = 1, n_point
        p(:, i) = uniform_vector(seed, merge(0.7_wp, 0.2_wp, modulo(i, 2) == 0))
      end do
      do j = 1, n_surface
        s(:, j) = surface_point(list(k), 1, seed)
      end do
      call signed_distance(list(k)%shape, n_point, p, d, g)
      foot = p - spread(d, 1, 3)*g
      call signed_distance(list(k)%shape, n_point, foot, d_foot, g_foot)
      call signed_distance(list(k)%shape, n_surface, s, d_s, g_s)
      worst_foot = maxval(abs(d_foot))
      worst_surface = maxval(abs(d_s))
      worst_near = 0.0_wp
      do i = 1, n_point
        nearest = huge(1.0_wp)
        do j = 1, n_surface
          nearest = min(nearest, sum((p(:, i) - s(:, j))**2))
        end do
        worst_near = max(worst_near, abs(d(i)) - sqrt(nearest))
        call expect(d(i) < 0.0_wp .eqv. is_inside(list(k), 1, p(:, i), 0.0_wp), list(k)%word(1)//': sign')
      end do
      call expect_close(worst_foot, 0.0_wp, list(k)%word(1)//': foot on the surface', atol=4.0e-16_wp)
      call expect_close(worst_surface, 0.0_wp, list(k)%word(1)//': 0 on the surface', atol=4.0e-16_wp)
      call expect(worst_near < 1.0e-15_wp, list(k)%word(1)//': no surface point is nearer')
    end do
  end subroutine least_distance

  subroutine gradient()
    real(wp), parameter :: h = 1.0e-6_wp
    type(solid_t) :: list(10)
    real(wp) :: p(3, 7), d(7), g(3, 7), slope(3), q(3, 2), dq(2), gq(3, 2)
    integer(i8) :: seed
    integer :: i, k, axis
    list(:9) = primitives()
    list(10) = panel_union()
    seed = 77
    do k = 1, size(list)
      do i = 1, 300
        p = spread(uniform_vector(seed, 0.4_wp), 2, 7)
        do axis = 1, 3
          p(axis, 2*axis) = p(axis, 2*axis) + h
          p(axis, 2*axis + 1) = p(axis, 2*axis + 1) - h
        end do
        call signed_distance(list(k)%shape, 7, p, d, g)
        call expect_close(sqrt(sum(g(:, 1)**2)), 1.0_wp, 'unit normal', atol=1.0e-15_wp)
        q(:, 1) = p(:, 1)
        q(:, 2) = uniform_vector(seed, 0.4_wp)
        call signed_distance(list(k)%shape, 2, q, dq, gq)
        ! Deep inside a union where parts overlap the depth is a way out, not the least one.
        if (k < 10 .or. minval(dq) >= 0.0_wp) &
          call expect(abs(dq(1) - dq(2)) <= sqrt(sum((q(:, 1) - q(:, 2))**2)) + 1.0e-15_wp, '1-Lipschitz')
        ! Curvature up to 1/(distance to the evolute) is allowed for; kinks are left out.
        if (maxval(abs(g - spread(g(:, 1), 2, 7))) > 1.0e-3_wp) cycle
        if (k == 10 .and. d(1) < 0.0_wp) cycle
        slope = [d(2) - d(3), d(4) - d(5), d(6) - d(7)]/(2.0_wp*h)
        call expect_close(g(:, 1), slope, 'gradient', atol=1.0e-6_wp)
      end do
    end do
  end subroutine gradient

  subroutine special_points()
    type(solid_t) :: list(9)
    real(wp) :: p(3, 125), d(125), g(3, 125), h(3), x(5)
    integer :: i, j, k, m, n
    list = primitives()
    x = [-1.0_wp, -0.5_wp, 0.0_wp, 1.0_wp, 2.0_wp]
    do m = 1, size(list)
      h = 0.5_wp*list(m)%dimensions(:, 1)
      if (list(m)%word(1) /= 'box') h = [h(1), h(1), h(2)]
      n = 0
      do i = 1, 5
        do j = 1, 5
          do k = 1, 5
            n = n + 1
            p(:, n) = [x(i)*h(1), x(j)*h(2), x(k)*h(3)]
          end do
        end do
      end do
      call signed_distance(list(m)%shape, n, p, d, g)
      do i = 1, n
        call expect_close(sum(g(:, i)**2), 1.0_wp, list(m)%word(1)//': unit normal', atol=1.0e-15_wp)
      end do
    end do
    ! The distances one can say by heart, and the stated ties.
    call signed_distance(list(1)%shape, 4, reshape([0.05_wp, 0.1_wp, 0.15_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
                         0.08_wp, 0.14_wp, 0.15_wp, 0.05_wp, 0.1_wp + 1.0e-160_wp, 0.15_wp], [3, 4]), d(:4), g(:, :4))
    call expect_close(d(:4), [0.0_wp, -0.05_wp, 0.05_wp, 0.0_wp], 'box', atol=1.0e-16_wp)
    call expect_close(g(:, 1), [1.0_wp, 0.0_wp, 0.0_wp], 'box, corner', atol=0.0_wp)
    call expect_close(g(:, 2), [1.0_wp, 0.0_wp, 0.0_wp], 'box, centre', atol=0.0_wp)
    call expect_close(g(:, 3), [0.6_wp, 0.8_wp, 0.0_wp], 'box, edge', atol=1.0e-15_wp)
    call signed_distance(list(4)%shape, 3, reshape([0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, -0.3_wp, &
                         -0.13_wp, 0.0_wp, 0.29_wp], [3, 3]), d(:3), g(:, :3))
    call expect_close(d(:3), [-0.1_wp, 0.05_wp, 0.05_wp], 'cylinder', atol=1.0e-16_wp)
    call expect_close(g(:, 1), [1.0_wp, 0.0_wp, 0.0_wp], 'cylinder, axis', atol=0.0_wp)
    call expect_close(g(:, 2), [0.0_wp, 0.0_wp, -1.0_wp], 'cylinder, below', atol=0.0_wp)
    call expect_close(g(:, 3), [-0.6_wp, 0.0_wp, 0.8_wp], 'cylinder, rim', atol=1.0e-15_wp)
  end subroutine special_points

  subroutine batches()
    type(solid_t) :: list(10)
    real(wp) :: p(3, 131), d(131), g(3, 131), d1(1), g1(3)
    integer(i8) :: seed
    integer :: i, k
    list(:9) = primitives()
    list(10) = panel_union()
    seed = 5
    do i = 1, 131
      p(:, i) = uniform_vector(seed, 0.3_wp)
    end do
    do k = 1, size(list)
      call signed_distance(list(k)%shape, 131, p, d, g)
      do i = 1, 131
        call signed_distance(list(k)%shape, 1, p(:, i), d1, g1)
        call expect(abs(d1(1) - d(i)) <= 0.0_wp .and. maxval(abs(g1 - g(:, i))) <= 0.0_wp, 'the same bits')
      end do
    end do
  end subroutine batches

  !> Against scattered points of the parts' surfaces that no other part covers.
  subroutine union_distance()
    integer, parameter :: n_point = 300, n_surface = 20000
    type(solid_t) :: solid
    real(wp) :: p(3, n_point), d(n_point), g(3, n_point), foot(3, n_point), d_foot(n_point), g_foot(3, n_point)
    real(wp) :: s(3), nearest(n_point)
    logical :: covered, inside
    integer(i8) :: seed
    integer :: i, j, k, part
    solid = panel_union()
    seed = 4711
    do i = 1, n_point
      p(:, i) = uniform_vector(seed, merge(0.5_wp, 0.25_wp, modulo(i, 2) == 0))
    end do
    call signed_distance(solid%shape, n_point, p, d, g)
    foot = p - spread(d, 1, 3)*g
    call signed_distance(solid%shape, n_point, foot, d_foot, g_foot)
    nearest = huge(1.0_wp)
    do j = 1, n_surface
      part = 1 + modulo(j, solid%n)
      s = surface_point(solid, part, seed)
      covered = .false.
      do k = 1, solid%n
        if (k /= part) covered = covered .or. is_inside(solid, k, s, -1.0e-12_wp)
      end do
      if (covered) cycle
      do i = 1, n_point
        nearest(i) = min(nearest(i), sum((p(:, i) - s)**2))
      end do
    end do
    nearest = sqrt(nearest)
    do i = 1, n_point
      inside = .false.
      do k = 1, solid%n
        inside = inside .or. is_inside(solid, k, p(:, i), 0.0_wp)
      end do
      call expect(inside .eqv. d(i) < 0.0_wp, 'sign')
      call expect_close(d_foot(i), 0.0_wp, 'foot on the surface', atol=1.0e-8_wp)
      if (inside) then
        call expect(-d(i) > nearest(i) - 0.01_wp, 'no shallower than the surface')
      else
        call expect(d(i) < nearest(i) + 1.0e-15_wp, 'no surface point is nearer')
        call expect(d(i) > nearest(i) - 0.01_wp, 'and the surface is there')
      end if
    end do
  end subroutine union_distance

  !> From anywhere inside, one projection ends on the surface or outside.
  subroutine union_exit()
    type(solid_t) :: solid
    real(wp) :: p(3), d(1), g(3), d2(1)
    integer(i8) :: seed
    integer :: i, deep
    solid = panel_union()
    seed = 99
    deep = 0
    do i = 1, 20000
      p = uniform_vector(seed, 0.25_wp)
      call signed_distance(solid%shape, 1, p, d, g)
      if (d(1) >= 0.0_wp) cycle
      deep = deep + 1
      p = p - d(1)*g
      call signed_distance(solid%shape, 1, p, d2, g)
      call expect(d2(1) > -1.0e-8_wp, 'out after one projection')
    end do
    call expect(deep > 1000, 'there were points inside')
  end subroutine union_exit

  !> Two boxes that make an L (overlapping) and a bar (touching): depths by hand.
  subroutine union_corners()
    type(shape_t) :: corner, bar
    type(error_t), allocatable :: error
    real(wp) :: d(6), g(3, 6), p(3, 6), still(4, 2)
    still = spread([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 2, 2)
    call new_compound(corner, ['box', 'box'], reshape([2.0_wp, 1.0_wp, 4.0_wp, 1.0_wp, 2.0_wp, 4.0_wp], [3, 2]), &
                      reshape([1.0_wp, 0.5_wp, 0.0_wp, 0.5_wp, 1.0_wp, 0.0_wp], [3, 2]), still, error)
    p = reshape([0.99_wp, 0.99_wp, 0.0_wp, 0.9_wp, 0.9_wp, 0.0_wp, 0.3_wp, 0.4_wp, 0.0_wp, &
                 1.0_wp, 1.0_wp, 0.0_wp, 1.5_wp, 0.9_wp, 0.0_wp, 1.1_wp, 1.3_wp, 0.0_wp], [3, 6])
    call signed_distance(corner, 6, p, d, g)
    call expect_close(d, [-0.01_wp*sqrt(2.0_wp), -0.1_wp*sqrt(2.0_wp), -0.3_wp, 0.0_wp, -0.1_wp, 0.1_wp], &
                      'depth in an L', atol=1.0e-14_wp)
    call expect_close(g(:, 1), [sqrt(0.5_wp), sqrt(0.5_wp), 0.0_wp], 'towards the re-entrant edge', atol=1.0e-12_wp)
    ! Touching at x = 1, with rounding between them.
    call new_compound(bar, ['box', 'box'], reshape([1.0_wp, 0.4_wp, 0.4_wp, 0.7_wp, 0.4_wp, 0.4_wp], [3, 2]), &
                      reshape([0.5_wp, 0.0_wp, 0.0_wp, 1.35_wp + 1.0e-15_wp, 0.0_wp, 0.0_wp], [3, 2]), still, error)
    p = reshape([0.999_wp, 0.15_wp, 0.0_wp, 1.001_wp, 0.0_wp, -0.13_wp, 1.0_wp, 0.12_wp, 0.0_wp, &
                 1.0_wp, 0.2_wp, 0.0_wp, 1.0_wp, 0.21_wp, 0.0_wp, 1.0_wp + 5.0e-16_wp, 0.0_wp, 0.19_wp], [3, 6])
    call signed_distance(bar, 6, p, d, g)
    call expect_close(d, [-0.05_wp, -0.07_wp, -0.08_wp, 0.0_wp, 0.01_wp, -0.01_wp], 'depth near a seam', atol=1.0e-14_wp)
    call expect_close(g(:, 1), [0.0_wp, 1.0_wp, 0.0_wp], 'up from the seam', atol=1.0e-14_wp)
    call expect_close(g(:, 2), [0.0_wp, 0.0_wp, -1.0_wp], 'down from the seam', atol=1.0e-14_wp)
    call expect_close(g(:, 3), [0.0_wp, 1.0_wp, 0.0_wp], 'on the seam', atol=1.0e-14_wp)
    call expect_close(g(:, 6), [0.0_wp, 0.0_wp, 1.0_wp], 'in the gap', atol=1.0e-14_wp)
  end subroutine union_corners

  !> Volume and inertia of the inscribed polyhedron: below the solid's, by the facets' second-order share.
  subroutine tessellations()
    type(solid_t) :: list(9)
    type(surface_t) :: surface
    real(wp) :: share, own(3, 3), solid(3, 3)
    real(wp), allocatable :: d(:), g(:, :)
    integer :: k, i, n
    list = primitives()
    do k = 1, size(list)
      call tessellate(list(k)%shape, surface)
      n = size(surface%vertex, 2)
      call expect(is_closed(surface), list(k)%word(1)//': every edge twice, once each way')
      share = surface_volume(surface)/shape_volume(list(k)%shape)
      call expect(share > 0.985_wp .and. share < 1.0_wp + 1.0e-14_wp, list(k)%word(1)//': volume')
      own = surface_inertia(surface)
      solid = unit_inertia(list(k)%shape)
      call expect_close([(own(i, i), i=1, 3)], [(solid(i, i), i=1, 3)], list(k)%word(1)//': inertia', &
                        rtol=merge(1.0e-12_wp, 0.015_wp, list(k)%word(1) == 'box'))
      call expect_close([own(2, 1), own(3, 1), own(3, 2)], [0.0_wp, 0.0_wp, 0.0_wp], 'principal axes', atol=1.0e-15_wp)
      if (allocated(d)) deallocate (d, g)
      allocate (d(n), g(3, n))
      call signed_distance(list(k)%shape, n, surface%vertex, d, g)
      call expect(maxval(d) < 1.0e-15_wp, list(k)%word(1)//': vertices on or in the solid')
    end do
  end subroutine tessellations

  logical function is_closed(surface)
    type(surface_t), intent(in) :: surface
    integer, allocatable :: count(:, :)
    integer :: i, k, a, b, n
    n = size(surface%vertex, 2)
    allocate (count(n, n), source=0)
    do i = 1, size(surface%triangle, 2)
      do k = 1, 3
        a = surface%triangle(k, i)
        b = surface%triangle(modulo(k, 3) + 1, i)
        count(a, b) = count(a, b) + 1
      end do
    end do
    is_closed = maxval(count) == 1 .and. all(count == transpose(count))
  end function is_closed

  !> Three boxes side by side are one box; a turned box keeps its moments.
  subroutine union_bulk()
    type(shape_t) :: pieces, whole
    type(solid_t) :: solid
    type(error_t), allocatable :: error
    real(wp) :: lower(3), upper(3), expected(3, 3), c(3)
    real(wp), allocatable :: sample(:, :), d(:), g(:, :)
    integer :: i
    call new_compound(pieces, ['box', 'box', 'box'], reshape([0.1_wp, 0.2_wp, 0.3_wp, 0.2_wp, 0.1_wp, 0.3_wp, &
                      0.3_wp, 0.2_wp, 0.3_wp], [3, 3]), reshape([0.05_wp, 0.2_wp, 0.4_wp, 0.15_wp, 0.2_wp, 0.45_wp, &
                      0.35_wp, 0.2_wp, 0.4_wp], [3, 3]), reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.5_wp, 0.5_wp, 0.5_wp, &
                      0.5_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [4, 3]), error)
    ! The middle one, turned a third about (1,1,1), stands with edges 0.3, 0.2, 0.1 along x, y, z: apart from the others' boxes.
    call shape_bounds(pieces, lower, upper)
    call expect_close(lower, [0.0_wp, 0.1_wp, 0.25_wp], 'lower bounds', atol=1.0e-15_wp)
    call expect_close(upper, [0.5_wp, 0.3_wp, 0.55_wp], 'upper bounds', atol=1.0e-15_wp)
    call expect_close(shape_length(pieces), 0.5_wp, 'length', atol=1.0e-15_wp)
    call new_compound(whole, ['box', 'box'], reshape([0.1_wp, 0.2_wp, 0.3_wp, 0.3_wp, 0.2_wp, 0.3_wp], [3, 2]), &
                      reshape([0.05_wp, 0.0_wp, 0.0_wp, 0.25_wp, 0.0_wp, 0.0_wp], [3, 2]), &
                      spread([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 2, 2), error)
    c = shape_centroid(whole)
    call expect_close(c, [0.2_wp, 0.0_wp, 0.0_wp], 'centroid of two boxes side by side', atol=1.0e-15_wp)
    call expect_close(shape_volume(whole), 0.4_wp*0.2_wp*0.3_wp, 'volume', rtol=1.0e-15_wp)
    expected = 0.0_wp
    expected(1, 1) = (0.2_wp**2 + 0.3_wp**2)/12.0_wp
    expected(2, 2) = (0.4_wp**2 + 0.3_wp**2)/12.0_wp
    expected(3, 3) = (0.4_wp**2 + 0.2_wp**2)/12.0_wp
    call expect_close(reshape(unit_inertia(whole), [9]), reshape(expected, [9]), 'inertia as of one box', atol=1.0e-16_wp)
    solid = panel_union()
    call surface_samples(solid%shape, 100, sample)
    call expect(size(sample, 2) >= 20 .and. size(sample, 2) <= 100, 'samples of a union')
    allocate (d(size(sample, 2)), g(3, size(sample, 2)))
    call signed_distance(solid%shape, size(sample, 2), sample, d, g)
    call expect(maxval(abs(d)) < 1.0e-9_wp, 'on its surface')
    do i = 1, size(sample, 2)
      call expect(sqrt(sum(sample(:, i)**2)) <= shape_bounding_radius(solid%shape) + 1.0e-15_wp, 'in the bounding ball')
    end do
    call new_shape(whole, 'box', [0.1_wp, 0.2_wp, 0.3_wp], error)
    call surface_samples(whole, 100, sample)
    call expect(size(sample, 2) == 8, 'a box has eight corners')
  end subroutine union_bulk

  subroutine refusals()
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    call new_shape(shape, 'cone', [1.0_wp, 1.0_wp, 1.0_wp], error)
    call expect(allocated(error), 'an unknown word')
    deallocate (error)
    call new_shape(shape, 'cylinder', [1.0_wp, 0.0_wp, 1.0_wp], error)
    call expect(allocated(error), 'no length')
    if (allocated(error)) call expect(index(error%message, 'dimension 2') > 0, 'which dimension: '//error%message)
    deallocate (error)
    call new_shape(shape, 'sphere', [-1.0_wp, 0.0_wp, 0.0_wp], error)
    call expect(allocated(error), 'a negative diameter')
    deallocate (error)
    call new_compound(shape, ['box', 'cat'], spread([1.0_wp, 1.0_wp, 1.0_wp], 2, 2), spread([0.0_wp, 0.0_wp, 0.0_wp], 2, 2), &
                      spread([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 2, 2), error)
    call expect(allocated(error), 'an unknown part')
    if (allocated(error)) call expect(index(error%message, 'part 2') == 1, 'which part: '//error%message)
  end subroutine refusals

end module test_shape
