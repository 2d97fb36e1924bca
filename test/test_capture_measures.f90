!> Capture measures on surfaces whose measures are known in closed form.
!>
!> 1500 directions stand for the sphere: a region with a smooth rim is counted to a few
!> directions (tolerance 5/1500), because their spacing is even.
module test_capture_measures
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_value, ieee_quiet_nan
  use castnet_kinds, only: wp, i8
  use castnet_constants, only: pi, degree
  use castnet_capture_measures, only: measure_capture, judge_capture
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_record, only: capture_measures_t, thresholds_t, verdict_failed, verdict_marginal, verdict_captured
  use castnet_rng, only: rng_t, seed_rng, normal
  use castnet_rotation, only: rotate, normalise_quaternion, quaternion_product
  use castnet_shape, only: new_shape, new_compound
  use castnet_sky, only: fibonacci_directions
  use castnet_state, only: state_t
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_capture_measures

  real(wp), parameter :: few = 5.0_wp/1500.0_wp
  type(thresholds_t), parameter :: usual = thresholds_t()

contains

  subroutine run_test_capture_measures()
    call test_case('capture_measures: directions are even unit vectors', even_directions)
    call test_case('capture_measures: a closed net covers all', closed_ball)
    call test_case('capture_measures: a half ball covers half, its hole is 90 degrees', half_ball)
    call test_case('capture_measures: a hole of known angle', polar_hole)
    call test_case('capture_measures: two holes, the wider one counts', two_holes)
    call test_case('capture_measures: a flat net covers its solid angle', flat_net)
    call test_case('capture_measures: a net far away covers nothing', far_net)
    call test_case('capture_measures: a cage open at one end lets out what fits', open_cage)
    call test_case('capture_measures: a sock on one end can be slipped off', sock)
    call test_case('capture_measures: a body on a floor can leave upwards', floor)
    call test_case('capture_measures: bars across the opening hold what is wider than the gap', bars)
    call test_case('capture_measures: every shape leaves a cage through its own opening', shapes_leave)
    call test_case('capture_measures: mouth of a square, distances of bullets', mouth)
    call test_case('capture_measures: quality index of the target''s own hull is 0', own_hull)
    call test_case('capture_measures: quality index of a shifted, larger box', other_hull)
    call test_case('capture_measures: turning and moving everything changes nothing', turned)
    call test_case('capture_measures: the same bits in every build', same_bits)
    call test_case('capture_measures: what has no meaning is NaN', meaningless)
    call test_case('capture_measures: the verdict follows the thresholds', verdicts)
  end subroutine run_test_capture_measures

  !> A model with a free box target at the origin and no net node yet.
  subroutine start(model, state, word, dimensions)
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    character(len=*), intent(in) :: word
    real(wp), intent(in) :: dimensions(3)
    type(error_t), allocatable :: error
    allocate (model%net, model%target, state%target)
    call new_shape(model%target%shape, word, dimensions, error)
    call expect(.not. allocated(error), 'a shape')
    allocate (model%net%faces(4, 0), model%net%perimeter_nodes(0), model%net%bullet_nodes(0))
    allocate (state%node_position(0, 3), state%node_velocity(0, 3))
  end subroutine start

  !> Add an (n+1) x (m+1) sheet of nodes, given by its node positions, as n x m squares.
  subroutine add_sheet(model, state, sheet)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: sheet(:, :, :)  !! (3,n+1,m+1)
    real(wp), allocatable :: position(:, :)
    integer, allocatable :: faces(:, :)
    integer :: i, j, n, m, base, f
    n = size(sheet, 2)
    m = size(sheet, 3)
    base = model%net%n_node
    f = size(model%net%faces, 2)
    allocate (position(base + n*m, 3), faces(4, f + (n - 1)*(m - 1)))
    position(:base, :) = state%node_position
    faces(:, :f) = model%net%faces
    do j = 1, m
      do i = 1, n
        position(base + (j - 1)*n + i, :) = sheet(:, i, j)
      end do
    end do
    do j = 1, m - 1
      do i = 1, n - 1
        f = f + 1
        faces(:, f) = base + [(j - 1)*n + i, (j - 1)*n + i + 1, j*n + i + 1, j*n + i]
      end do
    end do
    model%net%n_node = base + n*m
    call move_alloc(position, state%node_position)
    call move_alloc(faces, model%net%faces)
    deallocate (state%node_velocity)
    allocate (state%node_velocity(model%net%n_node, 3))
    state%node_velocity = 0.0_wp
  end subroutine add_sheet

  !> The zone of a ball between two polar angles, n squares around and m down.
  subroutine add_zone(model, state, radius, from, to, n, m)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: radius, from, to  !! [m], polar angles [rad]
    integer, intent(in) :: n, m
    real(wp) :: sheet(3, n + 1, m + 1), polar, around
    integer :: i, j
    do j = 0, m
      polar = from + (to - from)*j/m
      do i = 0, n
        around = 2.0_wp*pi*modulo(i, n)/n
        sheet(:, i + 1, j + 1) = radius*[sin(polar)*cos(around), sin(polar)*sin(around), cos(polar)]
      end do
    end do
    call add_sheet(model, state, sheet)
  end subroutine add_zone

  !> A flat rectangle of n x m squares: corner o, edges u and v.
  subroutine add_plate(model, state, o, u, v, n, m)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: o(3), u(3), v(3)
    integer, intent(in) :: n, m
    real(wp) :: sheet(3, n + 1, m + 1)
    integer :: i, j
    do j = 0, m
      do i = 0, n
        sheet(:, i + 1, j + 1) = o + u*(real(i, wp)/n) + v*(real(j, wp)/m)
      end do
    end do
    call add_sheet(model, state, sheet)
  end subroutine add_plate

  !> A square tube about z, half width w, from z = -length to length, closed below.
  subroutine add_cage(model, state, w, length)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: w, length
    real(wp) :: up(3), x(3), y(3)
    up = [0.0_wp, 0.0_wp, 2.0_wp*length]
    x = [2.0_wp*w, 0.0_wp, 0.0_wp]
    y = [0.0_wp, 2.0_wp*w, 0.0_wp]
    call add_plate(model, state, [-w, -w, -length], x, up, 10, 12)
    call add_plate(model, state, [-w, w, -length], x, up, 10, 12)
    call add_plate(model, state, [-w, -w, -length], y, up, 10, 12)
    call add_plate(model, state, [w, -w, -length], y, up, 10, 12)
    call add_plate(model, state, [-w, -w, -length], x, y, 10, 10)
  end subroutine add_cage

  !> Share of the sphere inside a square cone about an axis with this tangent of its half
  !> opening: 4 asin(t**2/(1 + t**2))/(4 pi).
  pure real(wp) function square_cone(tangent)
    real(wp), intent(in) :: tangent
    square_cone = asin(tangent**2/(1.0_wp + tangent**2))/pi
  end function square_cone

  !> Unit length to round-off; mean 0 and second moments 1/3, as an even spread has them.
  subroutine even_directions()
    real(wp) :: d(1500, 3)
    integer :: c, e
    call fibonacci_directions(d)
    call expect_close(maxval(abs(sum(d**2, dim=2) - 1.0_wp)), 0.0_wp, 'unit vectors', atol=1.0e-12_wp)
    do c = 1, 3
      call expect_close(sum(d(:, c))/1500.0_wp, 0.0_wp, 'mean', atol=1.0e-3_wp)
      do e = 1, 3
        call expect_close(sum(d(:, c)*d(:, e))/1500.0_wp, merge(1.0_wp/3.0_wp, 0.0_wp, c == e), 'second moment', atol=1.0e-3_wp)
      end do
    end do
    call expect_close(d(1001, 2), sqrt(1.0_wp - d(1001, 3)**2)*sin(modulo(1000.0_wp*2.399963229728653322_wp, 2.0_wp*pi)), &
                      'number 1001 stands at 1000 golden angles', atol=1.0e-11_wp)
  end subroutine even_directions

  subroutine closed_ball()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    call add_zone(model, state, 0.3_wp, 0.0_wp, pi, 24, 16)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%coverage, 1.0_wp, 'coverage', atol=0.0_wp)
    call expect_close(m%largest_hole, 0.0_wp, 'hole', atol=0.0_wp)
    call expect_close(m%escape, 0.0_wp, 'escape', atol=0.0_wp)
    call expect_equal(m%verdict, verdict_captured, 'captured')
  end subroutine closed_ball

  !> A ball of radius 0.2 in a half ball of radius 0.3 runs into a point q of it, at no less than
  !> ten degrees, if q is not farther than 0.2 cos(10) beside its path: q.d >= sqrt(0.3**2 -
  !> (0.2 cos 10)**2). The most that the rim offers is q.d = 0.3 sqrt(1 - d_z**2): what points
  !> down steeper than that is free.
  subroutine half_ball()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    real(wp) :: steepest
    call start(model, state, 'sphere', [0.4_wp, 0.0_wp, 0.0_wp])
    call add_zone(model, state, 0.3_wp, 0.0_wp, 0.5_wp*pi, 48, 16)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%coverage, 0.5_wp, 'coverage', atol=0.0_wp)
    call expect_close(m%largest_hole, 90.0_wp, 'hole', atol=0.1_wp)
    steepest = sqrt(1.0_wp - (0.3_wp**2 - (0.2_wp*cos(10.0_wp*degree))**2)/0.3_wp**2)
    call expect_close(m%escape, 0.5_wp*(1.0_wp - steepest), 'escape', atol=few)
    call expect_equal(m%verdict, verdict_failed, 'failed')
  end subroutine half_ball

  !> The rim is a polygon of n great-circle arcs, tan(hole) = tan(angle) cos(pi/n). The climb's
  !> last step is 0.06 degree.
  subroutine polar_hole()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    real(wp) :: angle
    integer :: k
    do k = 1, 8
      angle = 10.0_wp*k*degree
      call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.1_wp])
      call add_zone(model, state, 0.4_wp, angle, pi, 48, 16)
      m = measure_capture(model, state, .true., usual)
      call expect_close(m%largest_hole, atan(tan(angle)*cos(pi/48))/degree, 'hole', atol=0.1_wp)
      call expect_close(m%coverage, 0.5_wp*(1.0_wp + cos(angle)), 'coverage', atol=few)
    end do
  end subroutine polar_hole

  subroutine two_holes()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.1_wp])
    call add_zone(model, state, 0.4_wp, 15.0_wp*degree, pi - 25.0_wp*degree, 48, 16)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%largest_hole, atan(tan(25.0_wp*degree)*cos(pi/48))/degree, 'the lower one', atol=0.1_wp)
  end subroutine two_holes

  !> A square of side 2 a at distance h: 4 asin(a**2/(a**2 + h**2)).
  subroutine flat_net()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    real(wp) :: h
    integer :: k
    do k = 1, 4
      h = 0.1_wp*k*k
      call start(model, state, 'sphere', [0.05_wp, 0.0_wp, 0.0_wp])
      call add_plate(model, state, [h, -0.5_wp, -0.5_wp], [0.0_wp, 1.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 1.0_wp], 20, 20)
      m = measure_capture(model, state, .true., usual)
      call expect_close(m%coverage, square_cone(0.5_wp/h), 'coverage', atol=few)
    end do
  end subroutine flat_net

  subroutine far_net()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    call add_plate(model, state, [100.0_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.1_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.1_wp], 4, 4)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%coverage, 0.0_wp, 'coverage', atol=0.0_wp)
    call expect_close(m%largest_hole, 180.0_wp, 'hole', atol=0.0_wp)
    call expect_close(m%escape, 1.0_wp, 'escape', atol=1.0_wp/1500.0_wp)
  end subroutine far_net

  !> A box of half width a and half height c in a cage of half width w and half height L,
  !> open above: it comes out along d unless its lower rim touches a wall below the top,
  !> |d_x|/d_z, |d_y|/d_z <= (w - a)/(L + c).
  subroutine open_cage()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    call add_cage(model, state, 0.25_wp, 0.3_wp)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%escape, square_cone(0.2_wp/0.45_wp), 'escape', atol=few)
    call expect_close(m%coverage, 1.0_wp - square_cone(0.25_wp/0.3_wp), 'coverage', atol=few)
    call expect_equal(m%verdict, verdict_failed, 'failed')
    ! With a lid it stays.
    call add_plate(model, state, [-0.25_wp, -0.25_wp, 0.3_wp], [0.5_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.5_wp, 0.0_wp], 10, 10)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%escape, 0.0_wp, 'closed', atol=0.0_wp)
    call expect_close(m%coverage, 1.0_wp, 'covered', atol=0.0_wp)
  end subroutine open_cage

  !> A sock: the net lies on the sides of the lower half of a box, and below it. It can be left
  !> upwards with sides and edges sliding at less than ten degrees: the cone about z, a share
  !> of (1 - cos 10)/2. Inside and outside of the sides by a hair alike.
  subroutine sock()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    real(wp) :: w, low
    integer :: k
    do k = -1, 1
      w = 0.05_wp + 1.0e-5_wp*k
      low = -0.15_wp - 1.0e-5_wp*k
      call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
      call add_plate(model, state, [-w, -w, low], [2.0_wp*w, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.15_wp], 6, 8)
      call add_plate(model, state, [-w, w, low], [2.0_wp*w, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.15_wp], 6, 8)
      call add_plate(model, state, [-w, -w, low], [0.0_wp, 2.0_wp*w, 0.0_wp], [0.0_wp, 0.0_wp, 0.15_wp], 6, 8)
      call add_plate(model, state, [w, -w, low], [0.0_wp, 2.0_wp*w, 0.0_wp], [0.0_wp, 0.0_wp, 0.15_wp], 6, 8)
      call add_plate(model, state, [-w, -w, low], [2.0_wp*w, 0.0_wp, 0.0_wp], [0.0_wp, 2.0_wp*w, 0.0_wp], 6, 6)
      m = measure_capture(model, state, .true., usual)
      call expect_close(m%escape, 0.5_wp*(1.0_wp - cos(10.0_wp*degree)), 'escape', atol=2.0_wp/1500.0_wp)
    end do
  end subroutine sock

  !> Touching a wide floor exactly, above and below by a hair: the upper half of all
  !> directions is free. (Downwards the leading edge runs into it, at whatever angle.)
  subroutine floor()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    integer :: k
    do k = -1, 1
      call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
      call add_plate(model, state, [-2.0_wp, -2.0_wp, -0.15_wp + 1.0e-6_wp*k], [4.0_wp, 0.0_wp, 0.0_wp], &
                     [0.0_wp, 4.0_wp, 0.0_wp], 60, 60)
      m = measure_capture(model, state, .true., usual)
      call expect_close(m%escape, 0.5_wp, 'escape', atol=0.0_wp)
    end do
  end subroutine floor

  !> The same cage with two strips across its top: the centre ray passes between them, the
  !> box does not; a smaller box does, in some directions.
  subroutine bars()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    integer :: k
    do k = 1, 2
      call start(model, state, 'box', merge([0.1_wp, 0.1_wp, 0.3_wp], [0.04_wp, 0.04_wp, 0.3_wp], k == 1))
      call add_cage(model, state, 0.06_wp, 0.3_wp)
      call add_plate(model, state, [-0.06_wp, -0.045_wp, 0.3_wp], [0.12_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.01_wp, 0.0_wp], 6, 1)
      call add_plate(model, state, [-0.06_wp, 0.035_wp, 0.3_wp], [0.12_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.01_wp, 0.0_wp], 6, 1)
      m = measure_capture(model, state, .true., usual)
      call expect(m%coverage < 1.0_wp, 'the centre ray passes')
      if (k == 1) call expect_close(m%escape, 0.0_wp, 'held', atol=0.0_wp)
      if (k == 2) call expect(m%escape > 0.0_wp, 'the small one is not')
    end do
  end subroutine bars

  !> Cylinder, capsule, ball and a compound of two boxes with the box's outline in a round
  !> cage: each is a body of radius 0.05 (or a square in it) and half height 0.15.
  subroutine shapes_leave()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    type(error_t), allocatable :: error
    real(wp) :: compound, box
    call start(model, state, 'cylinder', [0.1_wp, 0.3_wp, 0.0_wp])
    call add_cage(model, state, 0.25_wp, 0.3_wp)
    m = measure_capture(model, state, .true., usual)
    ! The lower rim of a cylinder reaches as far towards each wall as the box's.
    call expect_close(m%escape, square_cone(0.2_wp/0.45_wp), 'cylinder', atol=few)
    call start(model, state, 'capsule', [0.1_wp, 0.2_wp, 0.0_wp])
    call add_cage(model, state, 0.25_wp, 0.3_wp)
    m = measure_capture(model, state, .true., usual)
    ! The lower ball (centre z = -0.1) slides off the wall's upper edge: the edge (0.25, y, 0.3) must
    ! stay 0.05 away from its path, 0.25 d_z - 0.4 d_x >= 0.05 when d lies in a wall's plane; that
    ! is tan = 0.4798 there, a little less in the corners.
    call expect_close(m%escape, square_cone(0.4798_wp), 'capsule', atol=2.0_wp*few)
    call start(model, state, 'sphere', [0.1_wp, 0.0_wp, 0.0_wp])
    call add_cage(model, state, 0.25_wp, 0.3_wp)
    m = measure_capture(model, state, .true., usual)
    ! 0.25 d_z - 0.3 d_x >= 0.05: tan = 0.6314.
    call expect_close(m%escape, square_cone(0.6314_wp), 'ball', atol=2.0_wp*few)
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    call add_cage(model, state, 0.25_wp, 0.3_wp)
    m = measure_capture(model, state, .true., usual)
    box = m%escape
    call new_compound(model%target%shape, ['box', 'box'], reshape([0.1_wp, 0.1_wp, 0.15_wp, 0.1_wp, 0.1_wp, 0.15_wp], [3, 2]), &
                      reshape([0.0_wp, 0.0_wp, 0.075_wp, 0.0_wp, 0.0_wp, -0.075_wp], [3, 2]), &
                      reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [4, 2]), error)
    m = measure_capture(model, state, .true., usual)
    compound = m%escape
    call expect_close(compound, box, 'two half boxes', atol=1.0_wp/1500.0_wp)
  end subroutine shapes_leave

  subroutine mouth()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    call add_plate(model, state, [3.0_wp, -0.35_wp, -0.35_wp], [0.0_wp, 0.7_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.7_wp], 2, 2)
    model%net%perimeter_nodes = [1, 2, 3, 6, 9, 8, 7, 4]
    model%net%bullet_nodes = [1, 3, 9, 5]
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%mouth_area, 0.49_wp, 'area', rtol=1.0e-14_wp)
    call expect_close(m%mouth_perimeter, 2.8_wp, 'perimeter', rtol=1.0e-14_wp)
    call expect_close(m%bullet_distance_min, 3.0_wp, 'nearest bullet', rtol=1.0e-14_wp)
    call expect_close(m%bullet_distance_max, sqrt(9.0_wp + 2.0_wp*0.35_wp**2), 'farthest bullet', rtol=1.0e-14_wp)
  end subroutine mouth

  !> A net whose nodes are the target's corners (a compound's hull: of all its corners).
  subroutine own_hull()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    type(error_t), allocatable :: error
    integer :: k
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    do k = -1, 1, 2
      call add_plate(model, state, [-0.05_wp, -0.05_wp, 0.15_wp*k], [0.1_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.1_wp, 0.0_wp], 3, 3)
    end do
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%cqi, 0.0_wp, 'box', atol=1.0e-11_wp)
    call new_compound(model%target%shape, ['box', 'box'], reshape([0.1_wp, 0.1_wp, 0.1_wp, 0.1_wp, 0.1_wp, 0.1_wp], [3, 2]), &
                      reshape([0.0_wp, 0.0_wp, 0.1_wp, 0.0_wp, 0.0_wp, -0.1_wp], [3, 2]), &
                      reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [4, 2]), error)
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%cqi, 0.0_wp, 'two boxes, the hull of which it is', atol=1.0e-11_wp)
  end subroutine own_hull

  !> Twice as large and 0.2 m aside: 0.1 (8 - 1) + 0.1 (4 - 1) + 0.8 x 0.2/0.3.
  subroutine other_hull()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    integer :: k
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    do k = -1, 1, 2
      call add_plate(model, state, [0.1_wp, -0.1_wp, 0.3_wp*k], [0.2_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.2_wp, 0.0_wp], 3, 3)
    end do
    m = measure_capture(model, state, .true., usual)
    call expect_close(m%cqi, 0.7_wp + 0.3_wp + 0.8_wp*0.2_wp/0.3_wp, 'index', rtol=1.0e-10_wp)
  end subroutine other_hull

  !> A crumpled ball with a hole, seen from a turned and moved target. Numbers move by
  !> round-off; a direction on a rim may change sides.
  subroutine turned()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: a, b
    type(rng_t) :: rng
    real(wp) :: q(4), offset(3), deviate, x(3)
    integer :: i, k
    call seed_rng(rng, 77_i8)
    call start(model, state, 'cylinder', [0.1_wp, 0.3_wp, 0.0_wp])
    call add_zone(model, state, 0.25_wp, 50.0_wp*degree, pi, 20, 20)
    model%net%perimeter_nodes = [(i, i=1, 20)]
    model%net%bullet_nodes = [1, 6, 11, 16]
    do i = 1, model%net%n_node
      do k = 1, 3
        call normal(rng, deviate)
        state%node_position(i, k) = state%node_position(i, k) + 0.03_wp*deviate
      end do
    end do
    a = measure_capture(model, state, .true., usual)
    q = normalise_quaternion([0.3_wp, 0.5_wp, -0.2_wp, 0.7_wp])
    offset = [11.0_wp, -3.0_wp, 7.0_wp]
    do i = 1, model%net%n_node
      x = state%node_position(i, :)
      state%node_position(i, :) = rotate(q, x) + offset
    end do
    state%target%position = rotate(q, state%target%position) + offset
    state%target%attitude = quaternion_product(q, state%target%attitude)
    b = measure_capture(model, state, .true., usual)
    call expect(a%coverage > 0.7_wp .and. a%coverage < 1.0_wp .and. a%escape > 0.0_wp, 'a case in between')
    call expect_close(b%coverage, a%coverage, 'coverage', atol=1.001_wp/1500.0_wp)
    call expect_close(b%escape, a%escape, 'escape', atol=1.001_wp/1500.0_wp)
    call expect_close(b%largest_hole, a%largest_hole, 'hole', atol=1.0e-8_wp)
    call expect_close(b%cqi, a%cqi, 'index', rtol=1.0e-9_wp)
    call expect_close(b%mouth_area, a%mouth_area, 'mouth area', rtol=1.0e-12_wp)
    call expect_close(b%mouth_perimeter, a%mouth_perimeter, 'mouth perimeter', rtol=1.0e-12_wp)
    call expect_close(b%bullet_distance_max, a%bullet_distance_max, 'bullets', rtol=1.0e-12_wp)
  end subroutine turned

  !> A crumpled sheet of 441 nodes round a box, all from our own random numbers, measured in
  !> bits: the check build, the release build and other machines must give these.
  subroutine same_bits()
    type(model_t) :: model
    type(state_t) :: state
    type(capture_measures_t) :: m
    type(rng_t) :: rng
    real(wp) :: deviate
    character(len=200) :: line
    integer :: i, k
    call seed_rng(rng, 2018_i8)
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    call add_plate(model, state, [0.1_wp, -0.7_wp, -0.7_wp], [0.0_wp, 1.4_wp, 0.0_wp], [0.0_wp, 0.0_wp, 1.4_wp], 20, 20)
    model%net%perimeter_nodes = [1, 21, 441, 421]
    do i = 1, model%net%n_node
      state%node_position(i, 1) = 0.12_wp - sum(state%node_position(i, 2:3)**2)
      do k = 1, 3
        call normal(rng, deviate)
        state%node_position(i, k) = state%node_position(i, k) + 0.02_wp*deviate
      end do
    end do
    m = measure_capture(model, state, .true., usual)
    write (line, '(5(1x,z16.16))') m%coverage, m%escape, m%cqi, m%mouth_area, m%mouth_perimeter
    call expect_equal(trim(line), ' 3FE867C3ECE2A535 3FC604189374BC6A 404A3E1C61A93140 3FFE6FC7411803CD 401613581CCA8C03', 'bits')
  end subroutine same_bits

  subroutine meaningless()
    type(model_t) :: model, empty
    type(state_t) :: state
    type(capture_measures_t) :: m
    call start(model, state, 'box', [0.1_wp, 0.1_wp, 0.3_wp])
    m = measure_capture(empty, state, .true., usual)
    call expect(ieee_is_nan(m%coverage) .and. ieee_is_nan(m%cqi) .and. ieee_is_nan(m%mouth_area), 'no net')
    call expect_equal(m%verdict, verdict_marginal, 'no verdict')
    call add_plate(model, state, [3.0_wp, -0.35_wp, -0.35_wp], [0.0_wp, 0.7_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.7_wp], 2, 2)
    m = measure_capture(model, state, .true., usual)
    call expect(ieee_is_nan(m%mouth_area) .and. ieee_is_nan(m%bullet_distance_min), 'no perimeter, no bullets')
    call expect(.not. ieee_is_nan(m%coverage), 'but coverage')
    deallocate (model%net%faces)
    allocate (model%net%faces(4, 0))
    m = measure_capture(model, state, .true., usual)
    call expect(ieee_is_nan(m%coverage) .and. ieee_is_nan(m%escape) .and. .not. ieee_is_nan(m%cqi), 'no squares')
    model%net%perimeter_nodes = [1, 3, 9, 7]
    deallocate (model%target)
    m = measure_capture(model, state, .true., usual)
    call expect(ieee_is_nan(m%cqi) .and. ieee_is_nan(m%coverage), 'no target')
    call expect_close(m%mouth_area, 0.49_wp, 'but a mouth', rtol=1.0e-14_wp)
    state%node_position(2, 2) = ieee_value(1.0_wp, ieee_quiet_nan)
    m = measure_capture(model, state, .true., usual)
    call expect(ieee_is_nan(m%mouth_area), 'a broken state')
  end subroutine meaningless

  subroutine verdicts()
    call expect_equal(verdict(0.9_wp, 30.0_wp, 0.0_wp, .true.), verdict_captured, 'on the strict thresholds')
    call expect_equal(verdict(0.89_wp, 30.0_wp, 0.0_wp, .true.), verdict_marginal, 'too little coverage')
    call expect_equal(verdict(0.9_wp, 30.1_wp, 0.0_wp, .true.), verdict_marginal, 'too wide a hole')
    call expect_equal(verdict(0.9_wp, 20.0_wp, 0.001_wp, .true.), verdict_marginal, 'a way out')
    call expect_equal(verdict(0.6_wp, 20.0_wp, 0.0_wp, .true.), verdict_failed, 'failed by coverage')
    call expect_equal(verdict(0.95_wp, 20.0_wp, 0.05_wp, .true.), verdict_failed, 'failed by escape')
    call expect_equal(verdict(0.8_wp, 60.0_wp, 0.0_wp, .false.), verdict_captured, 'lasting')
    call expect_equal(verdict(0.79_wp, 10.0_wp, 0.0_wp, .false.), verdict_marginal, 'not lasting')
    call expect_equal(verdict(0.8_wp, 10.0_wp, 0.06_wp, .false.), verdict_failed, 'lost later')
  end subroutine verdicts

  integer function verdict(coverage, hole, escape, first)
    real(wp), intent(in) :: coverage, hole, escape
    logical, intent(in) :: first
    type(capture_measures_t) :: m
    m%coverage = coverage
    m%largest_hole = hole
    m%escape = escape
    call judge_capture(m, first, usual)
    verdict = m%verdict
  end function verdict

end module test_capture_measures
