!> The monitors: limits, what is named when a run stops, what is warned of and when.
module test_monitors
  use castnet_kinds, only: wp
  use castnet_error, only: error_t, exit_numerical
  use castnet_model, only: model_t
  use castnet_monitors, only: check_state, mechanical_energy, watch_t, watch_row, watch_rest, tell_watch
  use castnet_log, only: log_t, new_log
  use castnet_record, only: history_row_t
  use castnet_state, only: state_t
  use testing, only: test_case, expect, expect_close, expect_equal
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_positive_inf
  implicit none
  private
  public :: run_test_monitors

contains

  subroutine run_test_monitors()
    call test_case('monitors: a sound state passes', test_sound)
    call test_case('monitors: an explosion stops, with node, cable and advice', test_explosion)
    call test_case('monitors: a number that is none stops, net or target', test_not_finite)
    call test_case('monitors: warnings begin at their limits and keep the first time', test_watch)
  end subroutine run_test_monitors

  !> Three nodes in a row, two slack cables, the last node flying.
  subroutine make(model, state)
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    allocate (model%net)
    associate (net => model%net)
      net%n_node = 3
      net%n_pad = 8
      net%n_cable = 2
      net%node_mass = [1.0_wp, 2.0_wp, 3.0_wp]
      net%cable_nodes = reshape([1, 2, 2, 3], [2, 2])
      net%natural_length = [2.0_wp, 2.0_wp]
      net%axial_stiffness = [10.0_wp, 20.0_wp]
      net%damping = [0.1_wp, 0.2_wp]
    end associate
    model%step = 1.0e-3_wp
    allocate (state%node_position(8, 3), state%node_velocity(8, 3), source=0.0_wp)
    state%node_position(:3, 1) = [0.0_wp, 1.0_wp, 2.0_wp]
    state%node_velocity(3, 2) = 2.0_wp
    state%step = 7
    state%time = 0.25_wp
  end subroutine make

  subroutine test_sound()
    type(model_t) :: model
    type(state_t) :: state
    type(error_t), allocatable :: error
    call make(model, state)
    call expect_close(mechanical_energy(model, state), 6.0_wp, 'm v2/2', rtol=1.0e-14_wp)
    call check_state(model, state, 6.0_wp, error)
    call expect(.not. allocated(error), 'the energy that was put in')
    call check_state(model, state, 5.1_wp, error)
    call expect(.not. allocated(error), 'below 1.2 times')
    state%ledger%winch_work = 3.0_wp
    call check_state(model, state, 2.1_wp, error)
    call expect(.not. allocated(error), 'the winch put it in')
  end subroutine test_sound

  subroutine test_explosion()
    type(model_t) :: model
    type(state_t) :: state
    type(error_t), allocatable :: error
    call make(model, state)
    call check_state(model, state, 4.9_wp, error)
    call seen('the fastest node is 2 (counted from 0) at 2')
    call make(model, state)
    call check_state(model, state, 4.9_wp, error)
    call seen('at the cable of nodes 1 and 2')
    call make(model, state)
    model%net%original_node = [3, 1, 2]
    call check_state(model, state, 4.9_wp, error)
    call seen('the fastest node is 1 (counted from 0) at 2')
    call make(model, state)
    model%net%n_cable = 0
    call check_state(model, state, 4.9_wp, error)
    call seen('try a smaller time/step than 0.001 s')

  contains

    subroutine seen(words)
      character(len=*), intent(in) :: words
      call expect(allocated(error), 'stopped')
      if (.not. allocated(error)) return
      call expect_equal(error%code, exit_numerical, 'exit code')
      call expect(index(error%message, words) > 0 .and. index(error%message, 'step 7, t = 0.25 s') > 0, &
                  'it says "'//words//'": '//error%message)
      deallocate (error)
    end subroutine seen

  end subroutine test_explosion

  subroutine test_not_finite()
    type(model_t) :: model
    type(state_t) :: state
    type(error_t), allocatable :: error
    integer :: k
    do k = 1, 4
      call make(model, state)
      allocate (model%target, state%target)
      model%target%mass = 1.0_wp
      state%target%attitude = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
      select case (k)
      case (1)
        state%node_velocity(2, 3) = ieee_value(1.0_wp, ieee_quiet_nan)
      case (2)
        state%node_position(2, 1) = ieee_value(1.0_wp, ieee_positive_inf)
      case (3)
        state%target%angular_velocity(2) = ieee_value(1.0_wp, ieee_quiet_nan)
      case (4)
        state%target%attitude(1) = ieee_value(1.0_wp, ieee_positive_inf)
      end select
      call check_state(model, state, 6.0_wp, error)
      call expect(allocated(error), 'stopped')
      if (.not. allocated(error)) cycle
      call expect_equal(error%code, exit_numerical, 'exit code')
      if (k <= 2) call expect(index(error%message, 'net node 1 (counted from 0)') > 0, error%message)
      if (k > 2) call expect(index(error%message, 'target''s motion') > 0, error%message)
      deallocate (error)
    end do
  end subroutine test_not_finite

  subroutine test_watch()
    type(watch_t) :: watch
    type(history_row_t) :: row
    type(state_t) :: state
    type(log_t) :: log
    row%kinetic_net = 100.0_wp
    call watch_row(watch, row, 0.01_wp)
    row%time = 1.0_wp
    row%kinetic_net = 100.9_wp
    row%deepest_penetration = 0.01_wp
    row%contact_residual = 1.0e-6_wp
    call watch_row(watch, row, 0.01_wp)
    call expect(watch%rise%since < 0.0_wp .and. watch%penetration%since < 0.0_wp .and. watch%residual%since < 0.0_wp, &
                'at the limit')
    call expect_close(watch%rise%value, 0.9_wp/100.9_wp, 'the rise', rtol=1.0e-13_wp)
    row%time = 2.0_wp
    row%kinetic_net = 110.9_wp
    row%winch_work = 10.0_wp
    call watch_row(watch, row, 0.01_wp)
    call expect(watch%rise%since < 0.0_wp, 'what the winch did is no rise')
    row%time = 3.0_wp
    row%kinetic_net = 113.9_wp
    row%deepest_penetration = 0.011_wp
    row%contact_residual = 2.0e-6_wp
    call watch_row(watch, row, 0.01_wp)
    row%time = 4.0_wp
    row%kinetic_net = 130.0_wp
    call watch_row(watch, row, 0.0_wp)
    call expect_close(watch%rise%since, 3.0_wp, 'a rise, first', rtol=0.0_wp)
    call expect_close(watch%penetration%since, 3.0_wp, 'a penetration, first', rtol=0.0_wp)
    call expect_close(watch%residual%since, 3.0_wp, 'a residual, first', rtol=0.0_wp)
    call expect_close(watch%penetration%value, 1.1_wp, 'its worst, in thresholds', rtol=1.0e-15_wp)
    state%tally%deepest_penetration = 0.05_wp
    call watch_rest(watch, state, 0.01_wp)
    call expect_close(watch%penetration%value, 5.0_wp, 'what came after the last row', rtol=1.0e-15_wp)
    call new_log(log, .true., .false.)
    call tell_watch(log, watch_t())   ! nothing to tell, nothing told
  end subroutine test_watch

end module test_monitors
