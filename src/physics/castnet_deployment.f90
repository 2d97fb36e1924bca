!> How a net deploys, in the measures that the field uses: the largest mouth area and when
!> and where it is reached, how far the net has travelled, and for how long the mouth
!> stays open. Gathered at the history rows, of which nothing is kept: the time that the
!> mouth spent at each area goes into bins, between two rows as if the area ran straight,
!> because the level that "80 % of the largest area" means is known at the end only.
module castnet_deployment
  use castnet_kinds, only: wp
  use castnet_diagnostics, only: net_centre_of_mass, all_finite
  use castnet_model, only: model_t
  use castnet_polygon, only: area_about_first
  use castnet_record, only: deployment_t
  use castnet_state, only: state_t, deployment_state_t, area_bins, area_bins_per_unit
  implicit none
  private
  public :: begin_deployment, observe_deployment, deployment_of, follow_mouth

  real(wp), parameter :: open_fraction = 0.8_wp  !! of the largest, or the flat, area that counts as open

contains

  !> Make the state ready to gather, where the net has a mouth of known size; call at t = 0.
  subroutine begin_deployment(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    if (.not. allocated(model%net)) return
    if (size(model%net%perimeter_nodes) < 3 .or. model%net%flat_area <= 0.0_wp) return
    allocate (state%deployment)
    state%deployment%start = net_centre_of_mass(model%net, state%node_position)
  end subroutine begin_deployment

  !> Take in the state of now; call at each history row.
  subroutine observe_deployment(model, state, centre)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: centre(3)  !! of mass of the net [m]
    if (.not. allocated(state%deployment)) return
    ! No node is amiss where their sum is a number.
    if (.not. all_finite(centre)) return
    call follow_mouth(state%deployment, state%time, mouth_area(model, state), centre, model%net%flat_area)
  end subroutine observe_deployment

  !> Area of the mouth [m2].
  pure real(wp) function mouth_area(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: seen(size(model%net%perimeter_nodes), 3)
    integer :: i, c
    associate (node => model%net%perimeter_nodes, position => state%node_position)
      do c = 1, 3
        do i = 1, size(node)
          seen(i, c) = position(node(i), c) - position(node(1), c)
        end do
      end do
      mouth_area = area_about_first(size(node), seen(:, 1), seen(:, 2), seen(:, 3))
    end associate
  end function mouth_area

  !> One more row: mouth area and centre of mass at a time.
  subroutine follow_mouth(deployment, time, area, centre, flat_area)
    type(deployment_state_t), intent(inout) :: deployment
    real(wp), intent(in) :: time       !! [s]
    real(wp), intent(in) :: area       !! [m2]
    real(wp), intent(in) :: centre(3)  !! [m]
    real(wp), intent(in) :: flat_area  !! of the net spread out, > 0 [m2]
    real(wp) :: way(3)

    way = centre - deployment%start
    deployment%distance = sqrt(way(1)*way(1) + way(2)*way(2) + way(3)*way(3))
    if (deployment%begun) call spread_time(deployment%time_at, deployment%area/flat_area, area/flat_area, &
                                           time - deployment%time)
    if (area > deployment%largest_area) then
      deployment%largest_area = area
      deployment%largest_time = time
      deployment%largest_distance = deployment%distance
    end if
    deployment%begun = .true.
    deployment%time = time
    deployment%area = area
  end subroutine follow_mouth

  !> Add the time that a straight run from area a to area b spends in each bin.
  pure subroutine spread_time(time_at, a, b, duration)
    real(wp), intent(inout) :: time_at(area_bins)  !! [s]
    real(wp), intent(in) :: a, b                   !! parts of the flat area
    real(wp), intent(in) :: duration               !! [s]
    real(wp) :: low, high, share
    integer :: first, last, k

    low = min(a, b)*area_bins_per_unit
    high = max(a, b)*area_bins_per_unit
    first = int(min(low, area_bins - 1.0_wp))
    last = int(min(high, area_bins - 1.0_wp))
    if (first == last) then
      time_at(first + 1) = time_at(first + 1) + duration
      return
    end if
    do k = first, last
      share = min(high, real(k + 1, wp)) - max(low, real(k, wp))
      if (k == last) share = high - max(low, real(k, wp))
      time_at(k + 1) = time_at(k + 1) + duration*(share/(high - low))
    end do
  end subroutine spread_time

  !> The measures of the run so far.
  pure function deployment_of(seen, flat_area) result(deployment)
    type(deployment_state_t), intent(in) :: seen
    real(wp), intent(in) :: flat_area  !! [m2]
    type(deployment_t) :: deployment
    deployment%largest_mouth_area = seen%largest_area
    deployment%deployment_time = seen%largest_time
    deployment%deployment_distance = seen%largest_distance
    deployment%distance_travelled = seen%distance
    deployment%effective_period = time_above(seen%time_at, open_fraction*seen%largest_area/flat_area)
    deployment%open_period = time_above(seen%time_at, open_fraction)
  end function deployment_of

  !> Time above a part of the flat area; within a bin it is spread evenly [s].
  pure real(wp) function time_above(time_at, level) result(time)
    real(wp), intent(in) :: time_at(area_bins)
    real(wp), intent(in) :: level
    integer :: k, bin
    bin = int(min(level*area_bins_per_unit, area_bins - 1.0_wp))
    time = time_at(bin + 1)*max(0.0_wp, real(bin + 1, wp) - level*area_bins_per_unit)
    do k = bin + 1, area_bins - 1
      time = time + time_at(k + 1)
    end do
  end function time_above

end module castnet_deployment
