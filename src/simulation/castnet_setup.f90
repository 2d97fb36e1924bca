!> From a scene to a run that is ready to step: model, state, scratch and the step.
module castnet_setup
  use castnet_kinds, only: wp, i8
  use castnet_closing_thread, only: update_closing
  use castnet_compliant_contact, only: is_compliant, contact_rates
  use castnet_error, only: error_t, fail, exit_input
  use castnet_integrator, only: midpoint_begin, midpoint_damping
  use castnet_model, only: model_t, method_midpoint, self_contact_none
  use castnet_model_builder, only: file_net_t, build_model
  use castnet_net, only: net_t
  use castnet_net_builder, only: build_square_net
  use castnet_perturb, only: perturbation_t
  use castnet_rotation, only: rotation_matrix, multiply_transposed
  use castnet_scene, only: scene_t
  use castnet_stable_step, only: spectrum_t, spectrum_memory_t, net_spectrum, widen_by_thread, largest_stable_step
  use castnet_shape, only: shape_bounding_radius, signed_distance
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, new_work
  use castnet_text, only: to_text
  implicit none
  private
  public :: step_report_t, set_up, choose_step, overlap_words

  real(wp), parameter :: safe_fraction = 0.7_wp   !! of the stability limit, where the step is chosen for the user
  !> One-stage steps are stable on any taut net up to the limit, but cables that go slack and
  !> taut again pump energy into a net that hardly damps. Step times highest frequency up to
  !> which it does not, undamped, and what each unit of damping adds: measured with
  !> tools/stability_sweep.py.
  real(wp), parameter :: undamped_phase = 0.5_wp, phase_by_damping = 25.0_wp
  !> Of the contact threshold that a bullet may cross in a step. One-stage steps stay
  !> unbiased up to a whole threshold (docs/performance.md); the paper's rule is a tenth, and
  !> 'adaptive' keeps it, because it meets the target at its steps' ends as rk4 does. Winches
  !> add to the bullets' speed what they wind in: closing round the target alone, midpoint is
  !> unbiased at the net's limit, but with contact only where this speed counts too.
  real(wp), parameter :: threshold_fraction = 0.1_wp, threshold_fraction_midpoint = 1.0_wp
  real(wp), parameter :: radians_per_step = 0.01_wp  !! of a target that spins alone
  integer, parameter :: steps_at_least = 1000     !! where nothing else limits the step

  !> How the step was found, for `castnet check` and the run log.
  type :: step_report_t
    type(spectrum_t) :: spectrum
    real(wp) :: stable_limit = huge(1.0_wp)  !! [s]; huge: none
    real(wp) :: step = 0.0_wp                !! [s]
    logical :: unstable = .false.            !! above the limit, allowed by the scene
    character(len=:), allocatable :: reason  !! what set the step
    real(wp) :: overlap = 0.0_wp             !! depth of the deepest node inside the target at t = 0 [m]
    integer :: overlap_node = 0              !! which one; 0: none lies deeper than the contact threshold
  end type step_report_t

contains

  !> Build a run. Errors: what the builder refuses, a step above the limit.
  subroutine set_up(scene, n_thread, file_net, model, state, work, report, error, memory)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: n_thread
    type(file_net_t), allocatable, intent(inout) :: file_net
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(work_t), intent(out) :: work
    type(step_report_t), intent(out) :: report
    type(error_t), allocatable, intent(inout) :: error
    type(spectrum_memory_t), intent(inout), optional :: memory !! of runs before this one

    call build_model(scene, file_net, model, state, error)
    if (allocated(error)) return
    call choose_step(scene, model, state, report, error, memory)
    if (allocated(error)) return
    call find_overlap(model, state, report)
    model%step = report%step
    if (model%method == method_midpoint .and. allocated(model%net)) call midpoint_damping(model%net, model%step)
    call new_work(work, model, n_thread)
    if (model%method == method_midpoint) call midpoint_begin(state)
    if (allocated(model%closing)) call update_closing(model, state, 0.0_wp)
    allocate (state%measures(size(scene%output%verdict_times)))
    if (.not. allocated(model%contact)) return
    if (model%contact%self_contact /= self_contact_none) allocate (state%self_contacts(3), source=0_i8)
  end subroutine set_up

  !> The step: the scene's own, refused above the limit (or warned of), or 0.7 of the
  !> limit and at most a tenth of the threshold ('midpoint': one threshold) per step at
  !> the bullets' speed ('midpoint': with the winches').
  subroutine choose_step(scene, model, state, report, error, memory)
    type(scene_t), intent(in) :: scene
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(step_report_t), intent(out) :: report
    type(error_t), allocatable, intent(inout) :: error
    type(spectrum_memory_t), intent(inout), optional :: memory
    type(perturbation_t) :: nominal
    type(net_t) :: net
    real(wp), allocatable :: position(:, :), velocity(:, :)
    real(wp) :: spin, net_limit, fraction, ratio, phase, speed
    character(len=:), allocatable :: thread, whose

    thread = ''
    ratio = 0.0_wp
    if (allocated(model%net)) then
      if (scene%net%kind == 'square') then
        ! Directions of the taut net are those of the stowed one, without its perturbation.
        call build_square_net(scene%net, scene%bullets, nominal, net, position, velocity)
        call net_spectrum(model%net, report%spectrum, position, memory)
      else
        call net_spectrum(model%net, report%spectrum, memory=memory)
      end if
      report%stable_limit = largest_stable_step(model%method, report%spectrum, memory)
      ! The largest damping ratio of the net's own modes, near enough: threads do not damp them.
      if (report%spectrum%highest_frequency > 0.0_wp) &
        ratio = 0.5_wp*report%spectrum%largest_damping_rate/report%spectrum%highest_frequency
      if (allocated(model%closing)) then
        net_limit = report%stable_limit
        call widen_by_thread(report%spectrum, model%closing, model%net, model%method)
        report%stable_limit = largest_stable_step(model%method, report%spectrum, memory)
        !$omp critical (castnet_text)
        thread = ' with its closing thread (without it '//to_text(net_limit)//' s)'
        !$omp end critical (castnet_text)
      end if
      if (is_compliant(model)) then
        net_limit = report%stable_limit
        call widen_by_contact(report%spectrum, scene, model, state)
        report%stable_limit = largest_stable_step(model%method, report%spectrum, memory)
        !$omp critical (castnet_text)
        thread = thread//' with the springs of its contact (without them '//to_text(net_limit)//' s)'
        !$omp end critical (castnet_text)
      end if
    end if

    if (scene%time%step > 0.0_wp) then
      report%step = scene%time%step
      report%reason = 'given by the scene'
      if (report%step <= report%stable_limit) return
      report%unstable = .true.
      if (scene%time%allow_unstable) return
      !$omp critical (castnet_text)
      call fail(error, exit_input, 'time/step: '//to_text(scene%time%step)//' s is above the stability limit of '// &
                trim(scene%time%method)//' on this net'//thread//', '//to_text(report%stable_limit)//' s (highest frequency '// &
                to_text(report%spectrum%highest_frequency)//' rad/s, largest damping rate '// &
                to_text(report%spectrum%largest_damping_rate)//' 1/s); give step = 0 to have one chosen, or '// &
                'allow_unstable = .true. to be warned only')
      !$omp end critical (castnet_text)
      return
    end if

    report%step = scene%time%end_time/steps_at_least
    report%reason = 'end_time/1000'
    if (allocated(state%target)) then
      spin = sqrt(sum(state%target%angular_velocity**2))
      if (spin*report%step > radians_per_step) then
        report%step = radians_per_step/spin
        report%reason = '0.01 rad of the target''s spin'
      end if
    end if
    if (report%stable_limit < huge(1.0_wp)) then
      report%step = safe_fraction*report%stable_limit
      report%reason = '0.7 of the stability limit'
    end if
    if (model%method == method_midpoint .and. report%spectrum%highest_frequency > 0.0_wp) then
      phase = undamped_phase + phase_by_damping*ratio
      if (report%step*report%spectrum%highest_frequency > phase) then
        report%step = phase/report%spectrum%highest_frequency
        report%reason = 'what a net with hardly any damping bears'
      end if
    end if
    if (allocated(model%contact) .and. allocated(scene%bullets)) then
      fraction = merge(threshold_fraction_midpoint, threshold_fraction, model%method == method_midpoint)
      speed = scene%bullets%speed
      whose = 'the bullets'' speed'
      if (model%method == method_midpoint .and. allocated(model%closing)) then
        speed = speed + closing_speed(model, scene%bullets%mass)
        whose = 'the speed of bullets and winches together'
      end if
      if (report%step*speed > fraction*model%contact%threshold) then
        report%step = fraction*model%contact%threshold/speed
        report%reason = 'a tenth of the contact threshold at '//whose
        if (model%method == method_midpoint) report%reason = 'the contact threshold at '//whose
      end if
    end if
    report%step = min(report%step, scene%time%end_time)
  end subroutine choose_step

  !> What the winches can add to a bullet's speed: theirs, and no more than the work of two sides at
  !> the stall tension on the way to the middle, T_w side = m v^2/2 [m/s].
  pure real(wp) function closing_speed(model, bullet_mass) result(speed)
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: bullet_mass  !! [kg]
    speed = min(model%closing%winch_speed, sqrt(2.0_wp*model%closing%max_tension*model%net%side_length/bullet_mass))
  end function closing_speed

  !> Does the net start inside the target? Contact pushes such nodes out, at once and a long
  !> way: a scene that nobody means.
  subroutine find_overlap(model, state, report)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(step_report_t), intent(inout) :: report
    real(wp), allocatable :: point(:, :), distance(:), normal(:, :)
    real(wp) :: r(3, 3)
    integer :: i, n
    if (.not. allocated(model%contact)) return
    n = model%net%n_node
    allocate (point(3, n), distance(n), normal(3, n))
    r = rotation_matrix(state%target%attitude)
    do i = 1, n
      point(:, i) = multiply_transposed(r, state%node_position(i, :) - state%target%position)
    end do
    call signed_distance(model%target%shape, n, point, distance, normal)
    i = minloc(distance, dim=1)
    if (.not. distance(i) < -model%contact%threshold) return
    report%overlap = -distance(i)
    report%overlap_node = i
    if (allocated(model%net%original_node)) report%overlap_node = model%net%original_node(i)
  end subroutine find_overlap

  !> What is to be said of a net that starts inside the target.
  function overlap_words(report) result(words)
    type(step_report_t), intent(in) :: report
    character(len=:), allocatable :: words
    character(len=12) :: depth
    write (depth, '(es9.2)') report%overlap
    words = 'target/position: the net starts inside the target: its node '//to_text(report%overlap_node - 1)// &
            ' (counted from 0) lies '//trim(adjustl(depth))//' m deep'
  end function overlap_words

  !> The spectrum with every contact spring pushing, at the speed of the shot.
  subroutine widen_by_contact(spectrum, scene, model, state)
    type(spectrum_t), intent(inout) :: spectrum
    type(scene_t), intent(in) :: scene
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: speed, stiffness_rate, damping_rate
    integer :: i
    speed = 0.0_wp
    do i = 1, model%net%n_node
      speed = max(speed, sqrt(state%node_velocity(i, 1)**2 + state%node_velocity(i, 2)**2 + state%node_velocity(i, 3)**2))
    end do
    if (allocated(scene%bullets)) speed = max(speed, scene%bullets%speed)
    if (.not. model%target%fixed) speed = speed + sqrt(sum(state%target%velocity**2)) &
      + (shape_bounding_radius(model%target%shape) + model%contact%threshold)*sqrt(sum(state%target%angular_velocity**2))
    call contact_rates(model, speed, stiffness_rate, damping_rate)
    spectrum%highest_frequency = sqrt(spectrum%highest_frequency**2 + stiffness_rate)
    spectrum%largest_damping_rate = spectrum%largest_damping_rate + damping_rate
  end subroutine widen_by_contact

end module castnet_setup
