!> Segments against shapes: nearest and deepest points, and nodes in flight.
module test_segment
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_shape, only: shape_t, new_shape, signed_distance, segment_distance, swept_contact
  use solids, only: solid_t, primitives, panel_union, uniform, uniform_vector
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_segment

contains

  subroutine run_test_segment()
    call test_case('segment: nothing along a segment is nearer or deeper than the point found', random_segments)
    call test_case('segment: special positions of a box', box_positions)
    call test_case('segment: special positions of a cylinder', cylinder_positions)
    call test_case('segment: parallel, tangent, tiny and reversed segments', hard_segments)
    call test_case('segment: of a union', union_segments)
    call test_case('segment: batches of any size give the same bits', batches)
    call test_case('swept: a fast node never crosses a 0.5 mm panel', panel_crossing)
    call test_case('swept: the first contact is the first', first_contact)
  end subroutine run_test_segment

  !> d must be the signed distance at the fraction, and no sample along the segment less.
  subroutine check(solid, a, b, words)
    type(solid_t), intent(in) :: solid
    real(wp), intent(in) :: a(3), b(3)
    character(len=*), intent(in) :: words
    integer, parameter :: n = 500
    real(wp) :: p(3, 0:n), d(0:n), g(3, 0:n), t, least, normal(3), at(1), g_at(3)
    integer :: i
    call segment_distance(solid%shape, a, b, t, least, normal)
    call expect(t >= 0.0_wp .and. t <= 1.0_wp, words//': fraction')
    call signed_distance(solid%shape, 1, a + (b - a)*t, at, g_at)
    call expect_close(least, at(1), words//': the distance there', atol=1.0e-15_wp)
    call expect_close(normal, g_at, words//': the normal there', atol=1.0e-9_wp)
    do i = 0, n
      ! Half of the samples crowd about the point found.
      if (modulo(i, 2) == 0) then
        p(:, i) = a + (b - a)*(real(i, wp)/n)
      else
        p(:, i) = a + (b - a)*max(0.0_wp, min(1.0_wp, t + 0.02_wp*(real(i, wp)/n - 0.5_wp)**3))
      end if
    end do
    call signed_distance(solid%shape, n + 1, p, d, g)
    call expect(least <= minval(d) + 1.0e-12_wp, words//': least')
  end subroutine check

  subroutine random_segments()
    type(solid_t) :: list(9)
    real(wp) :: a(3), b(3)
    integer(i8) :: seed
    integer :: i, k
    list = primitives()
    seed = 31
    do k = 1, size(list)
      do i = 1, 400
        a = uniform_vector(seed, 0.6_wp)
        b = a + uniform_vector(seed, merge(0.6_wp, 0.05_wp, modulo(i, 2) == 0))
        call check(list(k), a, b, list(k)%word(1))
      end do
    end do
  end subroutine random_segments

  subroutine box_positions()
    type(shape_t) :: box
    type(error_t), allocatable :: error
    real(wp) :: t, d, g(3)
    call new_shape(box, 'box', [2.0_wp, 2.0_wp, 2.0_wp], error)
    ! Over a face: equally near from x = -1 to 1, whose middle is t = 0.4.
    call segment_distance(box, [-2.0_wp, 0.0_wp, 1.5_wp], [3.0_wp, 0.0_wp, 1.5_wp], t, d, g)
    call expect_close([t, d, g], [0.4_wp, 0.5_wp, 0.0_wp, 0.0_wp, 1.0_wp], 'over a face', atol=1.0e-15_wp)
    ! Through it, 0.2 below the top: equally deep from x = -0.8 to 0.8.
    call segment_distance(box, [-2.0_wp, 0.0_wp, 0.8_wp], [3.0_wp, 0.0_wp, 0.8_wp], t, d, g)
    call expect_close([t, d, g], [0.4_wp, -0.2_wp, 0.0_wp, 0.0_wp, 1.0_wp], 'through it', atol=1.0e-12_wp)
    ! Across an edge, square to it: the corner (1, ., 1) seen from the line x + z = 3.
    call segment_distance(box, [3.0_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 3.0_wp], t, d, g)
    call expect_close([t, d, g], [0.5_wp, sqrt(0.5_wp), sqrt(0.5_wp), 0.0_wp, sqrt(0.5_wp)], 'across an edge', atol=1.0e-15_wp)
    ! Cutting the edge: the line x + z = 1.8 is 0.2/2 deep in its middle.
    call segment_distance(box, [1.8_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 1.8_wp], t, d, g)
    call expect_close([t, d], [0.5_wp, -0.1_wp], 'cutting an edge', atol=1.0e-12_wp)
    ! The nearest corner, and the ends.
    call segment_distance(box, [2.0_wp, 2.0_wp, -7.0_wp], [2.0_wp, 2.0_wp, -3.0_wp], t, d, g)
    call expect_close([t, d], [1.0_wp, sqrt(6.0_wp)], 'an end', atol=1.0e-15_wp)
    call segment_distance(box, [2.0_wp, 2.0_wp, -7.0_wp], [2.0_wp, 2.0_wp, 9.0_wp], t, d, g)
    call expect_close([t, d], [0.4375_wp, sqrt(2.0_wp)], 'along an edge, its middle', atol=1.0e-15_wp)
    call segment_distance(box, [0.3_wp, 0.2_wp, 0.1_wp], [0.3_wp, 0.2_wp, 0.1_wp], t, d, g)
    call expect_close([t, d], [0.5_wp, -0.7_wp], 'no length, inside', atol=1.0e-12_wp)
  end subroutine box_positions

  subroutine cylinder_positions()
    type(shape_t) :: cylinder
    type(error_t), allocatable :: error
    real(wp) :: t, d, g(3)
    call new_shape(cylinder, 'cylinder', [2.0_wp, 4.0_wp, 0.0_wp], error)
    call segment_distance(cylinder, [1.5_wp, 0.0_wp, -1.0_wp], [1.5_wp, 0.0_wp, 9.0_wp], t, d, g)
    call expect_close([t, d, g], [0.15_wp, 0.5_wp, 1.0_wp, 0.0_wp, 0.0_wp], 'along the barrel', atol=1.0e-15_wp)
    call segment_distance(cylinder, [-3.0_wp, 0.6_wp, 2.5_wp], [1.0_wp, 0.6_wp, 2.5_wp], t, d, g)
    call expect_close([t, d, g], [0.75_wp, 0.5_wp, 0.0_wp, 0.0_wp, 1.0_wp], 'over a cap', atol=1.0e-15_wp)
    call segment_distance(cylinder, [-3.0_wp, 0.0_wp, 1.9_wp], [1.0_wp, 0.0_wp, 1.9_wp], t, d, g)
    call expect_close([t, d, g], [0.75_wp, -0.1_wp, 0.0_wp, 0.0_wp, 1.0_wp], 'under a cap', atol=1.0e-12_wp)
    call segment_distance(cylinder, [0.0_wp, 0.4_wp, -2.0_wp], [0.0_wp, 0.4_wp, 3.0_wp], t, d, g)
    call expect_close([t, d, g], [0.4_wp, -0.6_wp, 0.0_wp, 1.0_wp, 0.0_wp], 'in the barrel', atol=1.0e-12_wp)
    ! Square across the barrel, and over the rim.
    call segment_distance(cylinder, [2.0_wp, -3.0_wp, 0.5_wp], [2.0_wp, 5.0_wp, 0.5_wp], t, d, g)
    call expect_close([t, d, g], [0.375_wp, 1.0_wp, 1.0_wp, 0.0_wp, 0.0_wp], 'across the barrel', atol=1.0e-14_wp)
    call segment_distance(cylinder, [4.0_wp, 0.0_wp, 1.0_wp], [0.0_wp, 0.0_wp, 5.0_wp], t, d, g)
    call expect_close([t, d, g], [0.5_wp, sqrt(2.0_wp), sqrt(0.5_wp), 0.0_wp, sqrt(0.5_wp)], 'over the rim', atol=1.0e-14_wp)
  end subroutine cylinder_positions

  subroutine hard_segments()
    type(solid_t) :: list(9)
    real(wp) :: a(3), b(3), h(3), u(3), tilt, x(5)
    integer(i8) :: seed
    integer :: i, j, k, m
    list = primitives()
    seed = 8
    x = [-1.5_wp, -1.0_wp, 0.0_wp, 0.999_wp, 1.0_wp]
    do k = 1, size(list)
      h = 0.5_wp*list(k)%dimensions(:, 1)
      if (list(k)%word(1) /= 'box') h = [h(1), h(1), h(2)]
      do i = 1, 400
        ! Nearly along an axis, tilted by 1 down to 1e-18, through special places.
        m = 1 + modulo(i, 3)
        tilt = 10.0_wp**(-modulo(i, 19))
        do j = 1, 3
          u(j) = h(j)*x(1 + int(4.999_wp*uniform(seed)))
        end do
        b = uniform_vector(seed, 1.0_wp)*tilt
        b(m) = b(m) + 1.0_wp
        a = u - b*0.7_wp*uniform(seed)
        b = u + b*0.5_wp*uniform(seed)
        call check(list(k), a, b, list(k)%word(1)//' hard')
        call check(list(k), b, a, list(k)%word(1)//' hard, reversed')
        call check(list(k), u, u, list(k)%word(1)//' no length')
        call check(list(k), u, u + 1.0e-9_wp*(b - a), list(k)%word(1)//' tiny')
      end do
    end do
  end subroutine hard_segments

  !> Outside a union the parts' least is the union's; inside, the sign is all that is promised.
  subroutine union_segments()
    type(solid_t) :: solid
    real(wp) :: a(3), b(3), t, d, g(3), p(3, 0:200), ds(0:200), gs(3, 0:200)
    integer(i8) :: seed
    integer :: i, j
    solid = panel_union()
    seed = 17
    do i = 1, 400
      a = uniform_vector(seed, 0.6_wp)
      b = a + uniform_vector(seed, merge(0.5_wp, 0.05_wp, modulo(i, 2) == 0))
      call segment_distance(solid%shape, a, b, t, d, g)
      do j = 0, 200
        p(:, j) = a + (b - a)*(real(j, wp)/200)
      end do
      call signed_distance(solid%shape, 201, p, ds, gs)
      if (minval(ds) > 0.0_wp) then
        call expect(d <= minval(ds) + 1.0e-12_wp, 'least')
      else
        call expect(d < 1.0e-12_wp, 'sign')
      end if
    end do
  end subroutine union_segments

  subroutine batches()
    type(solid_t) :: list(10)
    integer, parameter :: n = 131
    real(wp) :: a(3, n), b(3, n), t(n), d(n), g(3, n), t1, d1, g1(3)
    integer(i8) :: seed
    integer :: i, k
    list(:9) = primitives()
    list(10) = panel_union()
    seed = 6
    do i = 1, n
      a(:, i) = uniform_vector(seed, 0.3_wp)
      b(:, i) = a(:, i) + uniform_vector(seed, 0.2_wp)
    end do
    do k = 1, size(list)
      call segment_distance(list(k)%shape, n, a, b, t, d, g)
      do i = 1, n
        call segment_distance(list(k)%shape, a(:, i), b(:, i), t1, d1, g1)
        call expect(abs(t1 - t(i)) <= 0.0_wp .and. abs(d1 - d(i)) <= 0.0_wp .and. maxval(abs(g1 - g(:, i))) <= 0.0_wp, &
                    'the same bits')
      end do
    end do
  end subroutine batches

  subroutine panel_crossing()
    type(shape_t) :: panel
    type(error_t), allocatable :: error
    real(wp) :: p0(3, 100), p1(3, 100), t(100), d(100), g(3, 100)
    logical :: hit(100)
    integer(i8) :: seed
    integer :: i
    call new_shape(panel, 'box', [0.4_wp, 0.3_wp, 0.0005_wp], error)
    seed = 3
    do i = 1, 100
      p0(:, i) = [0.15_wp, 0.1_wp, 0.25_wp]*uniform_vector(seed, 1.0_wp) + [0.0_wp, 0.0_wp, 0.253_wp]
      p1(:, i) = [0.15_wp, 0.1_wp, 0.25_wp]*uniform_vector(seed, 1.0_wp) - [0.0_wp, 0.0_wp, 0.253_wp]
    end do
    call swept_contact(panel, 100, p0, p1, 0.002_wp, t, hit, d, g)
    call expect(all(hit), 'every crossing is seen')
    call expect_close(t, (p0(3, :) - 0.00225_wp)/(p0(3, :) - p1(3, :)), 'when', atol=1.0e-12_wp)
    call expect_close(d, spread(0.002_wp, 1, 100), 'at the contact surface', atol=1.0e-14_wp)
    p0(1, :) = p0(1, :) + 1.0_wp
    p1(1, :) = p1(1, :) + 1.0_wp
    call swept_contact(panel, 100, p0, p1, 0.002_wp, t, hit, d, g)
    call expect(.not. any(hit), 'beside it, none')
  end subroutine panel_crossing

  !> Before the fraction nothing is within the limit; at it the distance is the limit; a miss is a miss.
  subroutine first_contact()
    type(solid_t) :: list(10)
    real(wp), parameter :: limit = 0.01_wp
    real(wp) :: p0(3), p1(3), t(1), d(1), g(3), p(3, 0:200), ds(0:200), gs(3, 0:200)
    logical :: hit(1)
    integer(i8) :: seed
    integer :: i, j, k, hits
    list(:9) = primitives()
    list(10) = panel_union()
    seed = 12
    do k = 1, size(list)
      hits = 0
      do i = 1, 300
        p0 = uniform_vector(seed, 0.6_wp)
        p1 = uniform_vector(seed, 0.6_wp)
        call swept_contact(list(k)%shape, 1, p0, p1, limit, t, hit, d, g)
        do j = 0, 200
          p(:, j) = p0 + (p1 - p0)*t(1)*(real(j, wp)/200)
        end do
        call signed_distance(list(k)%shape, 201, p, ds, gs)
        if (hit(1)) then
          hits = hits + 1
          if (t(1) > 0.0_wp) then
            call expect(minval(ds) >= limit - 1.0e-12_wp, 'nothing before')
            call expect_close(d(1), limit, 'at the limit', atol=1.0e-12_wp)
          else
            call expect(ds(0) <= limit, 'there from the start')
          end if
        else
          call expect(minval(ds) > limit, 'a miss')
          call expect(d(1) > limit .and. d(1) <= minval(ds) + 1.0e-12_wp, 'how near it came')
        end if
      end do
      call expect(hits > 5, list(k)%word(1)//': some hits')
    end do
  end subroutine first_contact

end module test_segment
