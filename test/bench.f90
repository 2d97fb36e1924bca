!> Benchmark: nanoseconds per node and step without contact, microseconds per contact
!> event; one thread.
program bench
  use bench_contact, only: time_contacts
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t
  use castnet_scene, only: scene_t
  use castnet_setup, only: set_up, step_report_t
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, advance
  use scenes, only: shot, rocket_shot, cubesat_shot
  implicit none

  call time_net('rocket', rocket_shot(), 1.0e-3_wp)
  call time_net('cubesat', cubesat_shot(), 5.0e-5_wp)
  call time_net('large', shot([160, 160], 0.2_wp, 1.0e-3_wp, 1.0e-3_wp, 0.03_wp, 1.8_wp), 1.0e-4_wp)
  call time_contacts()

contains

  subroutine time_net(name, scene_of_net, step)
    character(len=*), intent(in) :: name
    type(scene_t), intent(in) :: scene_of_net
    real(wp), intent(in) :: step
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(file_net_t), allocatable :: no_file
    type(error_t), allocatable :: error
    character(len=8) :: method(2)
    integer(i8) :: t0, t1, rate
    integer :: i, k, m, n_step
    real(wp) :: best

    method = ['rk4     ', 'midpoint']
    do m = 1, 2
      scene = scene_of_net
      scene%time%step = step
      scene%time%method = method(m)
      call set_up(scene, 1, no_file, model, state, work, report, error)
      if (allocated(error)) then
        print '(a)', error%message
        stop
      end if
      print '(a,3(a,es12.4))', name, ': frequency', report%spectrum%highest_frequency, ' limit', report%stable_limit, &
        ' damping', report%spectrum%largest_damping_rate
      n_step = max(50, 4000000/model%net%n_node/10)
      best = huge(1.0_wp)
      do k = 1, 7
        call system_clock(t0, rate)
        do i = 1, n_step
          call advance(model, state, work, error)
        end do
        call system_clock(t1)
        best = min(best, real(t1 - t0, wp)/rate/n_step/model%net%n_node*1.0e9_wp)
      end do
      print '(a,1x,a,i8,a,f8.2,a,f10.4,3es14.6)', name, method(m), model%net%n_node, ' nodes', best, &
        ' ns per node-step, t=', state%time, state%node_position(model%net%n_node, :)
    end do
  end subroutine time_net

end program bench
