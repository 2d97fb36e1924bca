!> The bits of four captures, committed: the same in the check and the release build, at
!> any number of threads, on every processor. They are no reference for physics; they say
!> that a run elsewhere is this run. Who changes the model or the order of a sum changes
!> them, and says so in the commit.
module verify_state_hash
  use, intrinsic :: iso_fortran_env, only: int64
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_integrator, only: new_flow_work
  use castnet_model_builder, only: file_net_t
  use castnet_scene, only: scene_t
  use castnet_scene_file, only: read_scene_text
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, frame_taken
  use castnet_text, only: text_t
  use castnet_trigonometry, only: sine_cosine
  use scenes, only: state_hash
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_state_hash

  character(len=*), parameter :: nl = new_line('a')

  character(len=*), parameter :: cubesat = &
    "&net squares = 10, 10, mesh_length = 0.07, cable_diameter = 1e-3, edge_cable_diameter = 3e-3 /"//nl// &
    "&bullets mass = 0.03, speed = 1.8 /"//nl// &
    "&target shape = 'box', dimensions = 0.1, 0.1, 0.3, mass = 3.5, position = 0.1, 0, 0, "// &
    "angular_velocity = 0, 1.5, 0 /"//nl//"&contact threshold = 2e-3 /"//nl// &
    "&time end_time = 0.4, method = 'midpoint', step = 6e-5 /"//nl
  character(len=*), parameter :: rocket = &
    "&net squares = 20, 20, mesh_length = 1.5, cable_diameter = 1e-3 /"//nl// &
    "&bullets mass = 1, speed = 10 /"//nl// &
    "&target shape = 'cylinder', dimensions = 3.9, 11.047, mass = 8226, position = 2.5, 0, 0, "// &
    "angular_velocity = 0, 0.4, 0 /"//nl//"&contact threshold = 2e-2, restitution = 0.5, friction = 0.3 /"//nl// &
    "&time end_time = 0.9, method = 'rk4', step = 1e-3 /"//nl//"&perturb seed = 3, node_position = 1e-4, bullet_speed = 0.1 /"//nl
  character(len=*), parameter :: closing_scene = &
    "&net squares = 20, 20, mesh_length = 1.5, cable_diameter = 1e-3 /"//nl// &
    "&bullets mass = 1, speed = 10 /"//nl// &
    "&target shape = 'cylinder', dimensions = 3.9, 11.047, mass = 8226, position = 2.5, 0, 0, "// &
    "angular_velocity = 1.1, 0, 0 /"//nl//"&contact threshold = 2e-2 /"//nl// &
    "&closing winch_speed = 20, locked_length = 0.5, max_tension = 100, trigger = 'time', delay = 0.3 /"//nl
  character(len=*), parameter :: closing = closing_scene//"&time end_time = 0.8, method = 'rk4', step = 2e-4 /"//nl
  character(len=*), parameter :: closing_midpoint = closing_scene//"&time end_time = 0.8, method = 'midpoint', step = 1.5e-3 /"//nl

contains

  subroutine run_verify_state_hash()
    call test_case('state_hash: sine and cosine are within two units in the last place', test_trigonometry)
    call test_case('state_hash: the cubesat''s capture has its bits', test_cubesat)
    call test_case('state_hash: the rocket''s capture with friction has its bits', test_rocket)
    call test_case('state_hash: the closing net has its bits', test_closing)
    call test_case('state_hash: the closing net has its bits with midpoint', test_closing_midpoint)
  end subroutine run_verify_state_hash

  subroutine test_trigonometry()
    real(wp) :: a, s, c
    integer :: i
    do i = -2000, 2000
      a = 0.0031_wp*i
      call sine_cosine(a, s, c)
      call expect_close(s, sin(a), 'sine', atol=2.0_wp*epsilon(a))
      call expect_close(c, cos(a), 'cosine', atol=2.0_wp*epsilon(a))
    end do
  end subroutine test_trigonometry

  subroutine test_cubesat()
    call expect_bits(cubesat, 'cubesat', (-8177825430880983482_int64))
  end subroutine test_cubesat

  subroutine test_rocket()
    call expect_bits(rocket, 'rocket', (-3108386609937686823_int64))
  end subroutine test_rocket

  subroutine test_closing()
    call expect_bits(closing, 'closing', (-6503815362887959657_int64))
  end subroutine test_closing

  subroutine test_closing_midpoint()
    call expect_bits(closing_midpoint, 'closing with midpoint', 4248801124341574740_int64)
  end subroutine test_closing_midpoint

  subroutine expect_bits(text, name, expected)
    character(len=*), intent(in) :: text, name
    integer(int64), intent(in) :: expected
    integer, parameter :: threads(5) = [1, 2, 3, 4, 8]
    integer(int64) :: hash
    character(len=80) :: words
    integer :: i
    do i = 1, size(threads)
      hash = flown(text, threads(i))
      write (words, '(2a,i0,a,i0)') name, ' at ', threads(i), ' threads: ', hash
      if (i == 1) call note(trim(words))
      call expect(hash == expected, trim(words))
    end do
  end subroutine expect_bits

  !> Run a scene to its end on `n_thread` threads, whatever its size.
  integer(int64) function flown(text, n_thread) result(hash)
    character(len=*), intent(in) :: text
    integer, intent(in) :: n_thread
    type(scene_t) :: scene
    type(simulation_t) :: sim
    type(file_net_t), allocatable :: no_file
    type(error_t), allocatable :: error
    type(text_t) :: overrides(0)
    type(due_t) :: due
    character(len=:), allocatable :: warnings
    hash = 0
    call read_scene_text(text, 'hash.nml', overrides, scene, warnings, error)
    if (.not. allocated(error)) call start(sim, scene, n_thread, no_file, error)
    if (.not. allocated(error)) then
      call new_flow_work(sim%work%flow, sim%model, n_thread)
      sim%history_interval = sim%model%end_time
      do
        call run_to_next(sim, due, error)
        if (allocated(error)) exit
        sim%state%schedule%row_step = sim%state%step
        call frame_taken(sim)
        if (is_finished(sim)) exit
      end do
    end if
    call expect(.not. allocated(error), 'the run ends well')
    if (allocated(error)) then
      call note(error%message)
      return
    end if
    call expect(sim%state%first_contact >= 0.0_wp, 'the net meets the target')
    hash = state_hash(sim%state)
  end function flown

end module verify_state_hash
