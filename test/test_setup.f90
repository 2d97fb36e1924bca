!> How a run finds its step, and what it refuses.
module test_setup
  use castnet_kinds, only: wp
  use castnet_error, only: error_t, exit_input
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t
  use castnet_scene, only: scene_t
  use castnet_setup, only: set_up, step_report_t
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: cubesat_shot, words
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_setup

contains

  subroutine run_test_setup()
    call test_case('setup: step = 0 takes 0.7 of the limit, or what threshold and spin allow', chosen_steps)
    call test_case('setup: midpoint, the default: its own limit, a threshold, less where nothing damps', &
                   chosen_midpoint_steps)
    call test_case('setup: a step above the limit is refused, or warned of', refused_steps)
    call test_case('setup: at zeta = 2 the damped limit counts', damped_limit)
    call test_case('setup: a body starts where its phase says', phases)
    call test_case('setup: a net that starts inside the target is seen', overlaps)
    call test_case('setup: a perturbed start does not loosen the limit', perturbed_limit)
  end subroutine run_test_setup

  subroutine try(scene, report, error)
    type(scene_t), intent(in) :: scene
    type(step_report_t), intent(out) :: report
    type(error_t), allocatable, intent(out) :: error
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(file_net_t), allocatable :: no_file
    call set_up(scene, 1, no_file, model, state, work, report, error)
  end subroutine try

  subroutine add_target(scene)
    type(scene_t), intent(inout) :: scene
    allocate (scene%target)
    scene%target%shape = 'box'
    scene%target%dimensions = [0.1_wp, 0.1_wp, 0.3_wp]
    scene%target%mass = 3.5_wp
    scene%target%position = [1.4_wp, 0.0_wp, 0.0_wp]
  end subroutine add_target

  !> Closed forms: a quarter turn about y, about the body's z.
  subroutine phases()
    real(wp), parameter :: r = 0.70710678118654752440_wp
    type(scene_t) :: scene
    scene = cubesat_shot()
    call add_target(scene)
    scene%target%phase = 90.0_wp
    scene%target%angular_velocity = [0.0_wp, 1.5_wp, 0.0_wp]
    call expect_close(attitude(), [r, 0.0_wp, r, 0.0_wp], 'about the rate, from 1 0 0 0', atol=1.0e-15_wp)
    scene%target%attitude = [r, 0.0_wp, r, 0.0_wp]
    call expect_close(attitude(), [0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp], 'on top of the attitude', atol=1.0e-15_wp)
    scene%target%angular_velocity = [0.0_wp, -3.0_wp, 0.0_wp]
    call expect_close(attitude(), [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 'the other way round', atol=1.0e-15_wp)
    ! Body axes: z of this body lies along x, so a turn about its z is one about x.
    scene%target%phase_axis = [0.0_wp, 0.0_wp, 7.0_wp]
    call expect_close(attitude(), [0.5_wp, 0.5_wp, 0.5_wp, 0.5_wp], 'about an axis of the body', atol=1.0e-15_wp)
    scene%target%phase = 0.0_wp
    call expect_close(attitude(), [r, 0.0_wp, r, 0.0_wp], 'no phase', atol=0.0_wp)
  contains
    function attitude() result(q)
      real(wp) :: q(4)
      type(model_t) :: model
      type(state_t) :: state
      type(work_t) :: work
      type(step_report_t) :: report
      type(error_t), allocatable :: error
      type(file_net_t), allocatable :: no_file
      call set_up(scene, 1, no_file, model, state, work, report, error)
      call expect(.not. allocated(error), 'no error')
      q = state%target%attitude
    end function attitude
  end subroutine phases

  subroutine chosen_steps()
    type(scene_t) :: scene
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    scene = cubesat_shot()
    scene%time%method = 'rk4'
    call try(scene, report, error)
    call expect(.not. allocated(error), 'no error')
    call expect_close(report%step, 0.7_wp*report%stable_limit, 'of a free shot', rtol=1.0e-14_wp)

    call add_target(scene)
    allocate (scene%contact)
    scene%contact%threshold = 1.0e-3_wp
    call try(scene, report, error)
    call expect_close(report%step, 1.0e-3_wp/(10.0_wp*1.8_wp), 'by the threshold', rtol=1.0e-14_wp)

    deallocate (scene%net, scene%bullets, scene%contact)
    scene%target%angular_velocity = [0.0_wp, 3.0_wp, 4.0_wp]
    call try(scene, report, error)
    call expect_close(report%step, 0.01_wp/5.0_wp, 'by the spin', rtol=1.0e-14_wp)
    scene%target%angular_velocity = 0.0_wp
    call try(scene, report, error)
    call expect_close(report%step, 1.0e-2_wp, 'by the end', rtol=1.0e-14_wp)
  end subroutine chosen_steps

  !> The stowed net lies in the plane x = 0 round the origin: its middle node is 0.04 m from the
  !> back face of a box of 0.1 m about x = 0.01 m, the nearest of its faces.
  subroutine overlaps()
    type(scene_t) :: scene
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    scene = cubesat_shot()
    call add_target(scene)
    allocate (scene%contact)
    scene%contact%threshold = 2.0e-3_wp
    call try(scene, report, error)
    call expect_equal(report%overlap_node, 0, 'far away')
    scene%target%position = [0.01_wp, 0.0_wp, 0.0_wp]
    call try(scene, report, error)
    call expect(report%overlap_node > 0, 'seen')
    call expect_close(report%overlap, 0.04_wp, 'its depth', atol=1.0e-3_wp)
    scene%target%position = [0.0501_wp, 0.0_wp, 0.0_wp]
    call try(scene, report, error)
    call expect_equal(report%overlap_node, 0, 'just before it')
  end subroutine overlaps

  subroutine chosen_midpoint_steps()
    type(scene_t) :: scene
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    scene = cubesat_shot()
    call try(scene, report, error)
    call expect_close(report%step, 0.7_wp*report%stable_limit, 'of a free shot', rtol=1.0e-14_wp)
    call expect(report%stable_limit < 2.0_wp/report%spectrum%highest_frequency, 'damping lowers its limit')
    call add_target(scene)
    allocate (scene%contact)
    scene%contact%threshold = 1.0e-4_wp
    call try(scene, report, error)
    call expect_close(report%step, 1.0e-4_wp/1.8_wp, 'by the threshold', rtol=1.0e-14_wp)
    scene = cubesat_shot()
    scene%net%damping_ratio = 0.0_wp
    call try(scene, report, error)
    call expect_close(report%step, 0.5_wp/report%spectrum%highest_frequency, 'undamped', rtol=1.0e-14_wp)
  end subroutine chosen_midpoint_steps

  subroutine refused_steps()
    type(scene_t) :: scene
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    scene = cubesat_shot()
    scene%time%method = 'rk4'
    scene%time%step = 1.84e-4_wp
    call try(scene, report, error)
    call expect(.not. allocated(error) .and. .not. report%unstable, 'just below')
    scene%time%step = 1.85e-4_wp
    call try(scene, report, error)
    call expect(allocated(error), 'refused')
    if (.not. allocated(error)) return
    call expect_equal(error%code, exit_input, 'exit code')
    call expect(index(error%message, 'time/step') == 1 .and. index(error%message, '1844') > 0, 'message with the limit: '// &
                error%message)
    scene%time%allow_unstable = .true.
    call try(scene, report, error)
    call expect(.not. allocated(error) .and. report%unstable, 'warned of')
    ! The paper's step with 70 GPa (physics.md section 6).
    scene%time%allow_unstable = .false.
    scene%net%elastic_modulus = 70.0e9_wp
    scene%time%step = 5.0e-5_wp
    call try(scene, report, error)
    call expect(allocated(error), '70 GPa refused')
  end subroutine refused_steps

  !> physics.md section 6: the true limit of the cubesat net at zeta = 2 is 3.3e-5 s; ours
  !> is on the safe side of it.
  subroutine damped_limit()
    type(scene_t) :: scene
    type(step_report_t) :: report
    type(error_t), allocatable :: error
    scene = cubesat_shot()
    scene%time%method = 'rk4'
    scene%net%damping_ratio = 2.0_wp
    call try(scene, report, error)
    call note('limit at zeta = 2: '//words(report%stable_limit))
    call expect(report%stable_limit > 3.1e-5_wp .and. report%stable_limit <= 3.3e-5_wp, 'damped limit')
  end subroutine damped_limit

  subroutine perturbed_limit()
    type(scene_t) :: scene
    type(step_report_t) :: plain, shaken
    type(error_t), allocatable :: error
    scene = cubesat_shot()
    call try(scene, plain, error)
    allocate (scene%perturb)
    scene%perturb%seed = 3
    scene%perturb%node_position = 5.0e-3_wp
    call try(scene, shaken, error)
    call note('limit '//words(plain%stable_limit)//', perturbed by half a stowed mesh '//words(shaken%stable_limit))
    call expect_close(shaken%stable_limit, plain%stable_limit, 'limit', rtol=1.0e-12_wp)
  end subroutine perturbed_limit

end module test_setup
