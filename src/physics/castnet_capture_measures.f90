!> Has the net caught the target? Measures of one state and the verdict on them
!> (physics.md section 4). All seen from the target: its centre of mass, its body axes.
!>
!> A measure that has no meaning is NaN: all but the mouth without a target, coverage, hole,
!> escape without mesh squares, the mouth without a perimeter, distances without bullets.
module castnet_capture_measures
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use castnet_kinds, only: wp
  use castnet_constants, only: degree
  use castnet_convex_hull, only: hull_t, convex_hull
  use castnet_diagnostics, only: first_bad_node
  use castnet_escape, only: free_directions
  use castnet_model, only: model_t
  use castnet_net, only: net_t
  use castnet_polygon, only: loop_area, loop_perimeter
  use castnet_record, only: capture_measures_t, thresholds_t, verdict_failed, verdict_marginal, verdict_captured
  use castnet_rotation, only: rotation_matrix, multiply_transposed
  use castnet_shape, only: shape_t, shape_length
  use castnet_shape_hull, only: measure_shape_hull
  use castnet_sky, only: fibonacci_directions, covered_directions, largest_gap
  use castnet_state, only: state_t
  implicit none
  private
  public :: measure_capture, judge_capture

  integer, parameter :: n_direction = 1500

contains

  !> All measures and the verdict at this moment. Thread-safe; scratch is local.
  function measure_capture(model, state, first, thresholds) result(measures)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    logical, intent(in) :: first              !! the first judged time: the strict thresholds
    type(thresholds_t), intent(in) :: thresholds
    type(capture_measures_t) :: measures
    real(wp), allocatable :: seen(:, :)
    logical :: with_target
    measures = nothing_measured(state%time)
    if (.not. allocated(model%net)) return
    if (first_bad_node(model%net%n_node, state%node_position, state%node_velocity) > 0) return
    with_target = allocated(model%target)
    call body_view(model, state, seen)
    if (size(model%net%perimeter_nodes) > 2) then
      measures%mouth_area = loop_area(seen(:, model%net%perimeter_nodes))
      measures%mouth_perimeter = loop_perimeter(seen(:, model%net%perimeter_nodes))
    end if
    if (.not. with_target) return
    call bullet_distances(model%net, seen, measures)
    measures%cqi = capture_quality_index(model%target%shape, seen)
    if (size(model%net%faces, 2) == 0) return
    call measure_sky(model%target%shape, model%net%faces, seen, measures)
    call judge_capture(measures, first, thresholds)
  end function measure_capture

  !> The verdict on coverage, hole and escape, which must be numbers. Failed on the failed
  !> thresholds; captured on the strict ones at the first judged time, on the lasting ones
  !> later; else marginal.
  pure subroutine judge_capture(measures, first, thresholds)
    type(capture_measures_t), intent(inout) :: measures
    logical, intent(in) :: first
    type(thresholds_t), intent(in) :: thresholds
    logical :: captured
    if (first) then
      captured = measures%coverage >= thresholds%captured_coverage .and. &
                 measures%largest_hole <= thresholds%captured_hole .and. measures%escape <= thresholds%captured_escape
    else
      captured = measures%coverage >= thresholds%lasting_coverage .and. measures%escape <= thresholds%lasting_escape
    end if
    measures%verdict = verdict_marginal
    if (captured) measures%verdict = verdict_captured
    if (measures%coverage <= thresholds%failed_coverage .or. measures%escape >= thresholds%failed_escape) &
      measures%verdict = verdict_failed
  end subroutine judge_capture

  !> NaN everywhere, and a verdict that claims nothing.
  function nothing_measured(time) result(measures)
    real(wp), intent(in) :: time
    type(capture_measures_t) :: measures
    real(wp) :: nan
    nan = ieee_value(1.0_wp, ieee_quiet_nan)
    measures = capture_measures_t(time=time, coverage=nan, largest_hole=nan, escape=nan, cqi=nan, mouth_area=nan, &
                                  mouth_perimeter=nan, bullet_distance_min=nan, bullet_distance_max=nan, &
                                  verdict=verdict_marginal)
  end function nothing_measured

  !> Positions of the nodes as the target sees them [m]; without a target as they are.
  pure subroutine body_view(model, state, seen)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp), allocatable, intent(out) :: seen(:, :)  !! (3,n_node)
    real(wp) :: r(3, 3)
    integer :: i
    allocate (seen(3, model%net%n_node))
    do i = 1, model%net%n_node
      seen(:, i) = state%node_position(i, :)
    end do
    if (.not. allocated(model%target)) return
    r = rotation_matrix(state%target%attitude)
    do i = 1, model%net%n_node
      seen(:, i) = multiply_transposed(r, seen(:, i) - state%target%position)
    end do
  end subroutine body_view

  !> Nearest and farthest bullet from the target's centre of mass [m].
  pure subroutine bullet_distances(net, seen, measures)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: seen(:, :)
    type(capture_measures_t), intent(inout) :: measures
    real(wp) :: distance(size(net%bullet_nodes))
    integer :: i
    if (size(net%bullet_nodes) == 0) return
    do i = 1, size(net%bullet_nodes)
      associate (b => net%bullet_nodes(i))
        distance(i) = sqrt(seen(1, b)*seen(1, b) + seen(2, b)*seen(2, b) + seen(3, b)*seen(3, b))
      end associate
    end do
    measures%bullet_distance_min = minval(distance)
    measures%bullet_distance_max = maxval(distance)
  end subroutine bullet_distances

  !> 0.1 |Vn - Vt|/Vt + 0.1 |Sn - St|/St + 0.8 |qn - qt|/Lc from volume, area and centre of
  !> mass of the convex hulls of all net nodes, bullets included, and of the target; Lc is
  !> the target's largest extent along a body axis (Barnes & Botta 2020).
  pure real(wp) function capture_quality_index(shape, seen) result(cqi)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: seen(:, :)  !! (3,n_node) body axes [m]
    type(hull_t) :: hull
    real(wp) :: volume, area, centre(3), d(3)
    call measure_shape_hull(shape, volume, area, centre)
    call convex_hull(seen, hull)
    d = hull%centre - centre
    cqi = 0.1_wp*abs(hull%volume - volume)/volume + 0.1_wp*abs(hull%area - area)/area + &
          0.8_wp*sqrt(d(1)*d(1) + d(2)*d(2) + d(3)*d(3))/shape_length(shape)
  end function capture_quality_index

  !> Coverage, largest hole and escape over 1500 directions. A direction in which a ray from
  !> the centre of mass meets the net is blocked at once; castnet_escape judges the others.
  pure subroutine measure_sky(shape, faces, seen, measures)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: faces(:, :)
    real(wp), intent(in) :: seen(:, :)
    type(capture_measures_t), intent(inout) :: measures
    real(wp), allocatable :: square(:, :, :), triangle(:, :, :), direction(:, :)
    logical, allocatable :: covered(:), free(:)
    real(wp) :: half_angle
    integer :: i
    allocate (square(3, 4, size(faces, 2)), triangle(3, 3, 2*size(faces, 2)), direction(n_direction, 3), &
              covered(n_direction), free(n_direction))
    do i = 1, size(faces, 2)
      square(:, :, i) = seen(:, faces(:, i))
      triangle(:, :, 2*i - 1) = square(:, [1, 2, 3], i)
      triangle(:, :, 2*i) = square(:, [1, 3, 4], i)
    end do
    call fibonacci_directions(direction)
    call covered_directions(direction, triangle, covered)
    call largest_gap(direction, covered, triangle, half_angle)
    call free_directions(shape, square, direction, .not. covered, free)
    measures%coverage = real(count(covered), wp)/real(n_direction, wp)
    measures%largest_hole = half_angle/degree
    measures%escape = real(count(free), wp)/real(n_direction, wp)
  end subroutine measure_sky

end module castnet_capture_measures
