!> Deployment measures against motions whose answer is known, and the paper's nets.
module test_deployment
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_diagnostics, only: net_centre_of_mass
  use castnet_deployment, only: begin_deployment, observe_deployment, deployment_of, follow_mouth
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t
  use castnet_record, only: deployment_t
  use castnet_scene, only: scene_t
  use castnet_setup, only: set_up, step_report_t
  use castnet_state, only: state_t, deployment_state_t
  use castnet_stepper, only: work_t, advance
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_test_deployment

contains

  subroutine run_test_deployment()
    call test_case('deployment: a mouth that opens and shuts at steady rates', triangle)
    call test_case('deployment: a mouth that swings as a sine', sine)
    call test_case('deployment: a mouth that stays as it is', constant)
    call test_case('deployment: a flat net in steady flight', steady_flight)
    call test_case('deployment: no mouth, nothing gathered', no_mouth)
    call test_case('deployment: the paper''s nets open as far and as fast as they should', paper_nets)
    call test_case('deployment: undamped nets never open', undamped_nets)
  end subroutine run_test_deployment

  !> Up to 9 of 10 m2 in 3 s, down to nothing in 2 s: above 7.2 for a fifth of the time,
  !> above 8 for a ninth of it; the rows fall on the peak.
  subroutine triangle()
    type(deployment_state_t) :: seen
    type(deployment_t) :: found
    real(wp) :: time, area
    integer :: i
    do i = 0, 50
      time = 0.1_wp*i
      area = merge(3.0_wp*time, 4.5_wp*(5.0_wp - time), i <= 30)
      call follow_mouth(seen, time, max(area, 0.0_wp), [2.0_wp*time, 0.0_wp, 0.0_wp], 10.0_wp)
    end do
    found = deployment_of(seen, 10.0_wp)
    call expect_close(found%largest_mouth_area, 9.0_wp, 'largest area', rtol=1.0e-12_wp)
    call expect_close(found%deployment_time, 3.0_wp, 'when', rtol=1.0e-12_wp)
    call expect_close(found%deployment_distance, 6.0_wp, 'where', rtol=1.0e-12_wp)
    call expect_close(found%distance_travelled, 10.0_wp, 'whole way', rtol=1.0e-12_wp)
    call expect_close(found%effective_period, 1.0_wp, 'above 80 % of the largest', rtol=1.0e-9_wp)
    call expect_close(found%open_period, 5.0_wp/9.0_wp, 'above 80 % of the flat', rtol=1.0e-9_wp)
  end subroutine triangle

  !> A = A0 |sin|: above 0.8 A0 for (pi - 2 asin 0.8)/pi of the time.
  subroutine sine()
    integer, parameter :: rows = 2000
    type(deployment_state_t) :: seen
    type(deployment_t) :: found
    integer :: i
    do i = 0, rows
      call follow_mouth(seen, 3.0_wp*i/rows, 7.0_wp*abs(sin(3.0_wp*pi*i/rows)), [0.0_wp, 0.0_wp, 0.0_wp], 11.0_wp)
    end do
    found = deployment_of(seen, 11.0_wp)
    call expect_close(found%effective_period, 3.0_wp*(pi - 2.0_wp*asin(0.8_wp))/pi, 'above 80 %', rtol=1.0e-3_wp)
    call expect_close(found%open_period, 0.0_wp, 'never above 80 % of the flat', atol=0.0_wp)
  end subroutine sine

  subroutine constant()
    type(deployment_state_t) :: seen
    type(deployment_t) :: found
    integer :: i
    do i = 0, 7
      call follow_mouth(seen, 1.0_wp*i, 9.5_wp, [0.0_wp, 0.0_wp, 0.0_wp], 10.0_wp)
    end do
    found = deployment_of(seen, 10.0_wp)
    call expect_close(found%effective_period, 7.0_wp, 'always above', rtol=1.0e-12_wp)
    call expect_close(found%open_period, 7.0_wp, 'always above', rtol=1.0e-12_wp)
    call expect_close(found%deployment_time, 0.0_wp, 'the first row counts', atol=0.0_wp)
    ! Out of the bins' range, above and below: nothing is lost.
    call follow_mouth(seen, 8.0_wp, 50.0_wp, [0.0_wp, 0.0_wp, 0.0_wp], 10.0_wp)
    call follow_mouth(seen, 9.0_wp, 0.0_wp, [0.0_wp, 0.0_wp, 0.0_wp], 10.0_wp)
    call expect_close(sum(seen%time_at), 9.0_wp, 'all time counted', rtol=1.0e-12_wp)
  end subroutine constant

  subroutine steady_flight()
    real(wp), parameter :: speed = 2.5_wp, stretch = 0.95_wp
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    type(deployment_t) :: found
    integer :: i
    scene = shot(4, 0.5_wp, 1.0e-3_wp, 1.0e-3_wp, 0.1_wp, speed, 1.0_wp)
    scene%net%squares = [4, 6]
    scene%net%stowed_scale = stretch
    scene%bullets%angle = 0.0_wp
    scene%time%step = 1.0e-3_wp
    call build(scene, model, state, work)
    state%node_velocity(:model%net%n_node, 1) = speed
    call begin_deployment(model, state)
    call observe_deployment(model, state, net_centre_of_mass(model%net, state%node_position))
    do i = 1, 800
      call advance(model, state, work, error)
      if (modulo(i, 100) == 0) call observe_deployment(model, state, net_centre_of_mass(model%net, state%node_position))
    end do
    found = deployment_of(state%deployment, model%net%flat_area)
    call expect_close(model%net%flat_area, 4.0_wp*6.0_wp*0.25_wp, 'flat area', rtol=1.0e-14_wp)
    call expect_close(found%largest_mouth_area, stretch**2*model%net%flat_area, 'area', rtol=1.0e-12_wp)
    call expect_close(found%distance_travelled, speed*0.8_wp, 'way', rtol=1.0e-12_wp)
    call expect_close(found%effective_period, 0.8_wp, 'effective', rtol=1.0e-12_wp)
    call expect_close(found%open_period, 0.8_wp, 'open', rtol=1.0e-12_wp)
  end subroutine steady_flight

  subroutine no_mouth()
    type(model_t) :: model
    type(state_t) :: state
    call begin_deployment(model, state)
    call observe_deployment(model, state, [0.0_wp, 0.0_wp, 0.0_wp])
    call expect(.not. allocated(state%deployment), 'no net, nothing')
  end subroutine no_mouth

  !> physics.md section 6: cubesat 0.92-0.99 at 0.88-1.05 s, rocket 0.92-0.98 at 6.8-8.2 s.
  subroutine paper_nets()
    type(deployment_t) :: cubesat, rocket
    cubesat = free_flight(cubesat_scene(), 1.4_wp, 5.0e-5_wp)
    rocket = free_flight(rocket_scene(), 9.0_wp, 1.0e-3_wp)
    call say('cubesat', cubesat, 0.49_wp)
    call say('rocket', rocket, 900.0_wp)
    call within(cubesat%largest_mouth_area/0.49_wp, 0.92_wp, 0.99_wp, 'cubesat: part of the flat area')
    call within(cubesat%deployment_time, 0.88_wp, 1.05_wp, 'cubesat: time')
    call within(rocket%largest_mouth_area/900.0_wp, 0.92_wp, 0.98_wp, 'rocket: part of the flat area')
    call within(rocket%deployment_time, 6.8_wp, 8.2_wp, 'rocket: time')
  end subroutine paper_nets

  !> Without damping the nodes rattle about and the mouth stays below 0.4.
  subroutine undamped_nets()
    type(scene_t) :: scene
    type(deployment_t) :: cubesat, rocket
    scene = cubesat_scene()
    scene%net%damping_ratio = 0.0_wp
    cubesat = free_flight(scene, 2.0_wp, 1.0e-4_wp)
    scene = rocket_scene()
    scene%net%damping_ratio = 0.0_wp
    rocket = free_flight(scene, 12.0_wp, 1.0e-3_wp)
    call say('cubesat, undamped', cubesat, 0.49_wp)
    call say('rocket, undamped', rocket, 900.0_wp)
    call within(cubesat%largest_mouth_area/0.49_wp, 0.0_wp, 0.4_wp, 'cubesat')
    call within(rocket%largest_mouth_area/900.0_wp, 0.0_wp, 0.4_wp, 'rocket')
  end subroutine undamped_nets

  function cubesat_scene() result(scene)
    type(scene_t) :: scene
    scene = shot(10, 0.07_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp, 0.07_wp*sqrt(2.0_wp))
  end function cubesat_scene

  function rocket_scene() result(scene)
    type(scene_t) :: scene
    scene = shot(20, 1.5_wp, 1.0e-3_wp, 1.0e-3_wp, 1.0_wp, 10.0_wp, 1.5_wp*sqrt(2.0_wp))
  end function rocket_scene

  function shot(squares, mesh, diameter, edge, mass, speed, corner) result(scene)
    integer, intent(in) :: squares
    real(wp), intent(in) :: mesh, diameter, edge, mass, speed, corner
    type(scene_t) :: scene
    allocate (scene%net, scene%bullets)
    scene%time%method = 'rk4'
    scene%net%squares = squares
    scene%net%mesh_length = mesh
    scene%net%cable_diameter = diameter
    scene%net%edge_cable_diameter = edge
    scene%bullets%mass = mass
    scene%bullets%speed = speed
    scene%bullets%corner_cable_length = corner
    scene%time%end_time = 1.0_wp
    scene%output%verdict_times = [1.0_wp]
  end function shot

  subroutine build(scene, model, state, work)
    type(scene_t), intent(in) :: scene
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(work_t), intent(out) :: work
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    type(file_net_t), allocatable :: no_file
    call set_up(scene, 1, no_file, model, state, work, report, error)
    if (allocated(error)) call expect(.false., error%message)
  end subroutine build

  !> A row every hundredth of the flight.
  function free_flight(scene, end_time, step) result(found)
    type(scene_t), intent(in) :: scene
    real(wp), intent(in) :: end_time, step
    type(deployment_t) :: found
    type(scene_t) :: timed
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    integer :: i, n
    timed = scene
    timed%time%step = step
    call build(timed, model, state, work)
    call begin_deployment(model, state)
    call observe_deployment(model, state, net_centre_of_mass(model%net, state%node_position))
    n = nint(end_time/step)
    do i = 1, n
      call advance(model, state, work, error)
      if (modulo(i, n/200) == 0) call observe_deployment(model, state, net_centre_of_mass(model%net, state%node_position))
    end do
    found = deployment_of(state%deployment, model%net%flat_area)
  end function free_flight

  subroutine say(name, found, flat_area)
    character(len=*), intent(in) :: name
    type(deployment_t), intent(in) :: found
    real(wp), intent(in) :: flat_area
    character(len=110) :: words
    write (words, '(2a,f6.3,a,f6.2,a,f6.2,a,f6.2,a,f6.2,a)') name, ': area', found%largest_mouth_area/flat_area, ' at', &
      found%deployment_time, ' s and', found%deployment_distance, ' m, effective', found%effective_period, &
      ' s, open', found%open_period, ' s'
    call note(trim(words))
  end subroutine say

  subroutine within(value, low, high, words)
    real(wp), intent(in) :: value, low, high
    character(len=*), intent(in) :: words
    call expect_close(value, 0.5_wp*(low + high), words, atol=0.5_wp*(high - low))
  end subroutine within

end module test_deployment
