!> Benchmarks, driven by tools/bench. One line of results each; arguments:
!>   kernel SQUARES METHOD [THREADS] [KIND]       nanoseconds per node and step, no contact; a digest of
!>                                                the bits reached; cables. KIND: shuffled, holes, hexagonal,
!>                                                radial, round, triangular, irregular: nets as files
!>                                                may hold them, about as large
!>   steps SQUARES METHOD N                       so many steps and no timing, for instruction counts
!>   capture SCENE [group/key=value ...]          a whole run without files, stage by stage
!>   memory SQUARES [KIND]                        a few steps of a large net, bytes per node
!>   contact                                      microseconds per contact event
program bench
  use bench_contact, only: time_contacts
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t
  use castnet_integrator, only: new_flow_work
  use castnet_net_builder, only: finish_net
  use castnet_scene, only: scene_t
  use castnet_scene_file, only: read_scene
  use castnet_setup, only: set_up, step_report_t
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, take_measures, take_row, frame_taken
  use castnet_record, only: history_row_t
  use castnet_runner, only: prepare_scene
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, advance, settle
  use castnet_text, only: text_t
  use bench_nets, only: general_net
  use scenes, only: shot
  implicit none
  character(len=256) :: mode
  logical :: on_threads = .false.

  call get_command_argument(1, mode)
  select case (mode)
  case ('kernel')
    call time_kernel()
  case ('steps')
    call take_steps()
  case ('capture')
    call time_capture()
  case ('memory')
    call measure_memory()
  case ('contact')
    call time_contacts()
  case default
    print '(a)', 'bench kernel SQUARES METHOD [THREADS] [KIND] | steps SQUARES METHOD N | '// &
      'capture SCENE [group/key=value ...] | memory SQUARES [KIND] | contact'
  end select

contains

  integer function whole(k, default)
    integer, intent(in) :: k, default
    character(len=32) :: word
    call get_command_argument(k, word)
    whole = default
    if (len_trim(word) > 0) read (word, *) whole
  end function whole

  !> Processor time, which a busy machine disturbs less; on several threads the wall's.
  real(wp) function seconds()
    integer(i8) :: ticks, rate
    if (on_threads) then
      call system_clock(ticks, rate)
      seconds = real(ticks, wp)/real(rate, wp)
    else
      call cpu_time(seconds)
    end if
  end function seconds

  subroutine stop_on(error)
    type(error_t), allocatable, intent(in) :: error
    if (.not. allocated(error)) return
    print '(a)', error%message
    stop 1
  end subroutine stop_on

  !> The rocket's net with more or fewer squares, in flight.
  subroutine large_shot(squares, method, scene)
    integer, intent(in) :: squares
    character(len=*), intent(in) :: method
    type(scene_t), intent(out) :: scene
    scene = shot([squares, squares], 30.0_wp/squares, 1.0e-3_wp, 1.0e-3_wp, 1.0_wp, 10.0_wp)
    scene%time%method = method
    scene%time%step = 2.0e-2_wp/squares/4
  end subroutine large_shot

  subroutine time_kernel()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(file_net_t), allocatable :: net
    type(error_t), allocatable :: error
    character(len=32) :: method, how
    real(wp) :: t0, best
    integer :: i, k, n_step

    call get_command_argument(3, method)
    call get_command_argument(5, how)
    on_threads = whole(4, 1) > 1
    call large_shot(whole(2, 20), method, scene)
    if (len_trim(how) > 0) call general_net(trim(how), whole(2, 20), scene, net)
    call set_up(scene, 1, net, model, state, work, report, error)
    call stop_on(error)
    ! Threads as asked for, however small the net.
    if (on_threads) call new_flow_work(work%flow, model, whole(4, 1))
    n_step = max(4, 1000000/model%net%n_node)
    best = huge(1.0_wp)
    do k = 1, 12
      t0 = seconds()
      do i = 1, n_step
        call advance(model, state, work, error)
      end do
      best = min(best, (seconds() - t0)/n_step/model%net%n_node*1.0e9_wp)
    end do
    call settle(model, state, work)
    print '(a,1x,i0,1x,a,1x,f0.3,1x,z16.16,1x,i0)', 'kernel', model%net%n_node, trim(method), best, &
      digest(state%node_position(:model%net%n_node, :)), model%net%n_cable
  end subroutine time_kernel

  subroutine take_steps()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(file_net_t), allocatable :: net
    type(error_t), allocatable :: error
    character(len=32) :: method
    integer :: i
    call get_command_argument(3, method)
    call large_shot(whole(2, 20), method, scene)
    call set_up(scene, 1, net, model, state, work, report, error)
    call stop_on(error)
    do i = 1, whole(4, 100)
      call advance(model, state, work, error)
    end do
  end subroutine take_steps

  !> Any change of any bit shows.
  integer(i8) function digest(x)
    real(wp), intent(in) :: x(:, :)
    integer :: i, c
    digest = 0
    do c = 1, size(x, 2)
      do i = 1, size(x, 1)
        digest = ieor(ishftc(digest, 7), transfer(x(i, c), digest))
      end do
    end do
  end function digest

  !> Everything of a run but its files: set-up, steps, rows, frames' guards, verdicts.
  subroutine time_capture()
    type(scene_t) :: scene
    type(simulation_t) :: sim
    type(due_t) :: due
    type(history_row_t) :: row
    type(error_t), allocatable :: error
    type(text_t), allocatable :: overrides(:)
    character(len=256) :: path, word
    character(len=:), allocatable :: warnings
    real(wp) :: t0, t(5), took(4)
    integer :: i

    call get_command_argument(2, path)
    allocate (overrides(max(0, command_argument_count() - 2)))
    do i = 1, size(overrides)
      call get_command_argument(2 + i, word)
      overrides(i)%chars = trim(word)
    end do
    t(1) = seconds()
    call read_scene(trim(path), overrides, scene, warnings, error)
    call stop_on(error)
    t(2) = seconds()
    call prepare_scene(scene, 1, sim, error)
    call stop_on(error)
    t(3) = seconds()
    took = 0.0_wp
    do
      t0 = seconds()
      call run_to_next(sim, due, error)
      took(1) = took(1) + seconds() - t0
      call stop_on(error)
      t0 = seconds()
      if (due%row) row = take_row(sim)
      took(2) = took(2) + seconds() - t0
      t0 = seconds()
      if (due%verdict) call take_measures(sim)
      took(3) = took(3) + seconds() - t0
      if (due%frame) call frame_taken(sim)
      if (is_finished(sim)) exit
    end do
    t(4) = seconds()
    print '(a,1x,a,f0.3,a,f0.3,a,f0.3,a,f0.3,a,f0.3,a,f0.3,a,i0,a,es9.2,a,f0.4,a,es10.3)', 'capture', 'total ', &
      1.0e3_wp*(t(4) - t(1)), ' ms: read ', 1.0e3_wp*(t(2) - t(1)), ' set up ', 1.0e3_wp*(t(3) - t(2)), ' steps ', &
      1.0e3_wp*took(1), ' rows ', 1.0e3_wp*took(2), ' verdicts ', 1.0e3_wp*took(3), ' ms; ', sim%state%step, ' steps of ', &
      sim%model%step, ' s; first contact ', sim%state%first_contact, ' target speed ', sqrt(sum(sim%state%target%velocity**2))
  end subroutine time_capture

  !> Peak memory of a process that sets up and steps a large net.
  subroutine measure_memory()
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(step_report_t) :: report
    type(file_net_t), allocatable :: net
    type(error_t), allocatable :: error
    integer :: unit, status, i, kilobytes
    character(len=128) :: line, kind
    real(wp) :: t0, took

    call large_shot(whole(2, 1000), 'midpoint', scene)
    call get_command_argument(3, kind)
    if (len_trim(kind) > 0) call general_net(trim(kind), whole(2, 1000), scene, net)
    t0 = seconds()
    call set_up(scene, 1, net, model, state, work, report, error)
    call stop_on(error)
    took = seconds() - t0
    do i = 1, 5
      call advance(model, state, work, error)
    end do
    kilobytes = 0
    open (newunit=unit, file='/proc/self/status', action='read', iostat=status)
    do while (status == 0)
      read (unit, '(a)', iostat=status) line
      if (line(:6) == 'VmHWM:') read (line(7:), *) kilobytes
    end do
    close (unit)
    print '(a,1x,i0,a,f0.1,a,f0.1,a)', 'memory', model%net%n_node, ' nodes ', 1024.0_wp*kilobytes/model%net%n_node, &
      ' bytes per node; set up in ', took, ' s'
  end subroutine measure_memory

end program bench
