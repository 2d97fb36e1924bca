!> Speed against error on one scene: methods and steps against a reference made here.
!>
!> A tension-only net is chaotic (physics.md section 4), so one run's distance from another
!> is an error only up to the horizon where a tiny perturbation has grown to it. After that
!> only ensembles compare: every setting, the reference too, flies the same `members`
!> perturbed starts. **Error** is the distance of its mean from the reference's mean; the
!> **floor** is the spread of the reference's members. A setting is good enough when no
!> observable's error at the end is above its floor. Up to the horizon the unperturbed runs
!> give an **order** of convergence.
module castnet_accuracy
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_is_nan
  use castnet_kinds, only: wp, i8
  use castnet_diagnostics, only: net_centre_of_mass
  use castnet_error, only: error_t, fail, exit_input
  use castnet_log, only: log_t, log_progress, end_progress
  use castnet_model_builder, only: file_net_t
  use castnet_polygon, only: loop_area
  use castnet_posix, only: wall_seconds
  use castnet_process_guard, only: guard_thread
  use castnet_scene, only: scene_t
  use castnet_scene_net, only: load_scene_net
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, take_measures, frame_taken
  use castnet_text, only: rounded_text
  implicit none
  private
  public :: accuracy_t, setting_t, setting_words, is_below, measure_accuracy, observable_name, observable_unit, n_observable

  integer, parameter :: n_look = 200       !! equal times at which runs are compared; every step divides them
  integer, parameter :: members = 12       !! a mean's error is then 0.4 of the spread
  integer, parameter :: n_halving(2) = [5, 4]       !! steps of rk4 and midpoint: 0.7 of the limit, halved
  real(wp), parameter :: tolerances(3) = [1.0e-4_wp, 1.0e-6_wp, 1.0e-8_wp] !! of adaptive, with its automatic step
  real(wp), parameter :: safe = 0.7_wp              !! of the limit
  integer, parameter :: reference_halvings = 6
  real(wp), parameter :: nudge = 1.0e-6_wp          !! of every node in the ensembles, unless the scene perturbs [m]
  real(wp), parameter :: tiny_nudge = 1.0e-12_wp    !! whose growth gives the horizon [m]
  real(wp), parameter :: horizon_distance = 1.0e-6_wp !! to which it may have grown [m]

  integer, parameter :: n_observable = 9, n_track = 4
  character(len=*), parameter :: observable_name(n_observable) = [character(len=16) :: 'bullets', 'centre_of_mass', &
    'mouth_area', 'momentum_given', 'first_contact', 'coverage', 'largest_hole', 'escape', 'cqi']
  character(len=*), parameter :: observable_unit(n_observable) = [character(len=6) :: 'm', 'm', 'm2', 'N s', 's', '1', &
    'degree', '1', '1']

  !> What an observable can tell apart at all: rounding, one of 1500 rays. A floor is never
  !> below it. First contact is known to a step of the setting besides.
  real(wp), parameter :: resolution(n_observable) = [1.0e-9_wp, 1.0e-9_wp, 1.0e-9_wp, 1.0e-9_wp, 1.0e-9_wp, &
    1.0_wp/1500.0_wp, 0.1_wp, 1.0_wp/1500.0_wp, 1.0e-4_wp]

  !> What one run says.
  type :: flight_t
    real(wp), allocatable :: track(:, :)   !! (components, n_look) of the first four observables
    real(wp), allocatable :: node(:, :, :) !! (n_node,3,n_look), only where asked for [m]
    real(wp) :: last(n_track + 1:n_observable) = 0.0_wp !! the rest, at the end
    real(wp) :: seconds = 0.0_wp           !! processor time where one thread runs, else the wall's
    integer(i8) :: evaluations = 0
    type(error_t), allocatable :: error
  end type flight_t

  !> One method with one step.
  type :: setting_t
    character(len=8) :: method = ''
    real(wp) :: step = 0.0_wp, of_limit = 0.0_wp        !! [s], [-]
    real(wp) :: tolerance = 0.0_wp                      !! of 'adaptive', else 0
    real(wp) :: seconds = 0.0_wp                        !! of one run, the fastest member [s]
    integer(i8) :: evaluations = 0                      !! of forces, in one run
    real(wp) :: error(n_observable, n_look) = 0.0_wp    !! of the mean
    real(wp) :: single(n_observable, n_look) = 0.0_wp   !! of the unperturbed run
    real(wp) :: order(n_observable) = 0.0_wp            !! at the horizon, against the setting before; NaN: none
    logical :: below_floor = .false.
    logical :: failed = .false.                         !! a run broke down
  end type setting_t

  type :: accuracy_t
    real(wp) :: time(n_look) = 0.0_wp                   !! [s]
    real(wp) :: growth(n_look) = 0.0_wp                 !! of the tiny nudge, the farthest node [m]
    real(wp) :: horizon = 0.0_wp                        !! [s]
    real(wp) :: floor(n_observable, n_look) = 0.0_wp    !! spread of the reference
    type(setting_t) :: reference
    type(setting_t), allocatable :: settings(:)
    integer :: cheapest = 0                             !! the fastest setting below the floor; 0: none
    integer :: n_member = members
    logical :: used(n_observable) = .true.              !! false: this scene has no such observable
  end type accuracy_t

contains

  !> Fly everything. Errors: a scene without net, what `start` refuses.
  subroutine measure_accuracy(scene, n_thread, log, result, error)
    type(scene_t), intent(in) :: scene         !! with its defaults
    integer, intent(in) :: n_thread            !! runs side by side
    type(log_t), intent(inout) :: log
    type(accuracy_t), intent(out) :: result
    type(error_t), allocatable, intent(inout) :: error
    type(file_net_t), allocatable :: file_net
    type(flight_t), allocatable :: reference(:), flights(:)
    real(wp) :: limit(2), longest
    integer :: m, k, s

    if (.not. allocated(scene%net)) then
      call fail(error, exit_input, 'accuracy: the scene has no &net, so there is nothing to compare')
      return
    end if
    call load_scene_net(scene, file_net, error)
    if (allocated(error)) return
    do m = 1, 2
      call method_limit(scene, file_net, method_name(m), limit(m), longest, error)
      if (allocated(error)) return
    end do
    call method_limit(scene, file_net, 'adaptive', limit(1), longest, error)
    if (allocated(error)) return
    do k = 1, n_look
      result%time(k) = scene%time%end_time*k/n_look
    end do
    allocate (result%settings(sum(n_halving) + size(tolerances)))
    s = 0
    do m = 1, 2
      do k = 1, n_halving(m)
        s = s + 1
        result%settings(s) = new_setting(scene, method_name(m), limit(m), k - 1)
      end do
    end do
    do k = 1, size(tolerances)
      result%settings(s + k) = new_setting(scene, 'adaptive', longest/safe, 0)
      result%settings(s + k)%of_limit = result%settings(s + k)%step/limit(1)
      result%settings(s + k)%tolerance = tolerances(k)
    end do
    result%reference = new_setting(scene, method_name(1), limit(1), reference_halvings)

    call fly_members(scene, file_net, result%reference, n_thread, reference)
    call move_first_error(reference, error)
    if (allocated(error)) return
    call log_progress(log, 0.5_wp, 'reference at '//rounded_text(result%reference%step, 3)//' s')
    call grow_nudge(scene, file_net, result)
    call take_floor(reference, result)
    do s = 1, size(result%settings)
      call fly_members(scene, file_net, result%settings(s), n_thread, flights)
      call log_progress(log, 0.5_wp + 0.5_wp*s/size(result%settings), setting_words(result%settings(s)))
      call compare(flights, reference, result, result%settings(s))
    end do
    call end_progress(log)
    call take_orders(result)
    do s = 1, size(result%settings)
      if (.not. result%settings(s)%below_floor) cycle
      if (result%cheapest > 0) then
        if (result%settings(s)%seconds >= result%settings(result%cheapest)%seconds) cycle
      end if
      result%cheapest = s
    end do
  end subroutine measure_accuracy

  !> A setting in words: 'rk4 at 1e-3 s'.
  function setting_words(setting) result(words)
    type(setting_t), intent(in) :: setting
    character(len=:), allocatable :: words
    words = trim(setting%method)//' at '//rounded_text(setting%step, 3)//' s'
    if (setting%tolerance > 0.0_wp) words = words//' and a tolerance of '//rounded_text(setting%tolerance, 3)
  end function setting_words

  pure function method_name(m) result(name)
    integer, intent(in) :: m
    character(len=8) :: name
    name = merge('rk4     ', 'midpoint', m == 1)
  end function method_name

  !> The stability limit of a method on this scene, and the step that it would choose.
  subroutine method_limit(scene, file_net, method, limit, step, error)
    type(scene_t), intent(in) :: scene
    type(file_net_t), allocatable, intent(in) :: file_net
    character(len=*), intent(in) :: method
    real(wp), intent(out) :: limit, step   !! [s]
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t) :: changed
    type(file_net_t), allocatable :: net
    type(simulation_t) :: sim
    changed = scene
    changed%time%method = method
    changed%time%step = 0.0_wp
    if (allocated(file_net)) net = file_net
    limit = 0.0_wp
    step = 0.0_wp
    call start(sim, changed, 1, net, error)
    if (allocated(error)) return
    limit = min(sim%report%stable_limit, scene%time%end_time/10)
    step = min(sim%report%step, safe*limit)
  end subroutine method_limit

  !> 0.7 of the limit, halved; a whole number of steps between two looks.
  function new_setting(scene, method, limit, halvings) result(setting)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: method
    real(wp), intent(in) :: limit
    integer, intent(in) :: halvings
    type(setting_t) :: setting
    real(wp) :: between
    setting%method = method
    between = scene%time%end_time/n_look
    setting%step = between/ceiling(between*2.0_wp**halvings/(safe*limit))
    setting%of_limit = setting%step/limit
  end function new_setting

  !> All members of a setting; the first is not perturbed.
  subroutine fly_members(scene, file_net, setting, n_thread, flights)
    type(scene_t), intent(in) :: scene
    type(file_net_t), allocatable, intent(in) :: file_net
    type(setting_t), intent(inout) :: setting
    integer, intent(in) :: n_thread
    type(flight_t), allocatable, intent(out) :: flights(:)
    integer :: m
    allocate (flights(members))
    !$omp parallel do default(shared) private(m) schedule(dynamic, 1) num_threads(n_thread)
    do m = 1, members
      call guard_thread()
      call fly(scene, file_net, setting, m - 1, nudge, .false., n_thread == 1, flights(m))
    end do
    !$omp end parallel do
    setting%seconds = minval(flights%seconds)
    setting%evaluations = flights(1)%evaluations
    do m = 1, members
      setting%failed = setting%failed .or. allocated(flights(m)%error)
    end do
  end subroutine fly_members

  !> One run. Member 0 is the scene as it stands, but for a perturbation by `distance`
  !> where `kept` asks for the nodes.
  subroutine fly(scene, file_net, setting, member, distance, keep_nodes, alone, flight)
    type(scene_t), intent(in) :: scene
    type(file_net_t), allocatable, intent(in) :: file_net
    type(setting_t), intent(in) :: setting
    real(wp), intent(in) :: distance
    integer, intent(in) :: member
    logical, intent(in) :: keep_nodes, alone
    type(flight_t), intent(inout) :: flight
    type(scene_t) :: changed
    type(file_net_t), allocatable :: net
    type(simulation_t) :: sim
    type(due_t) :: due
    real(wp) :: began
    integer :: look

    changed = scene
    changed%time%method = setting%method
    changed%time%step = setting%step
    if (setting%tolerance > 0.0_wp) changed%time%tolerance = setting%tolerance
    changed%time%allow_unstable = .true.
    changed%output%frame_interval = scene%time%end_time/n_look
    changed%output%history_interval = scene%time%end_time
    changed%output%checkpoint_interval = 0.0_wp
    changed%output%verdict_times = [scene%time%end_time]
    if (member > 0) then
      if (.not. allocated(changed%perturb)) then
        allocate (changed%perturb)
        changed%perturb%node_position = distance
      end if
      changed%perturb%seed = changed%perturb%seed + member
    end if
    if (allocated(file_net)) net = file_net
    began = seconds(alone)
    call start(sim, changed, 1, net, flight%error)
    if (allocated(flight%error)) return
    if (keep_nodes) allocate (flight%node(sim%model%net%n_node, 3, n_look))
    do
      call run_to_next(sim, due, flight%error)
      if (allocated(flight%error)) return
      if (due%frame) then
        look = nint(sim%state%time/changed%output%frame_interval)
        if (look >= 1 .and. look <= n_look) call observe(sim, look, flight)
        call frame_taken(sim)
      end if
      if (is_finished(sim)) exit
    end do
    call take_measures(sim)
    flight%seconds = seconds(alone) - began
    flight%evaluations = sim%state%force_evaluations
    flight%last = ieee_value(1.0_wp, ieee_quiet_nan)
    if (sim%state%first_contact >= 0.0_wp) flight%last(5) = sim%state%first_contact
    associate (measures => sim%state%measures(1))
      flight%last(6:9) = [measures%coverage, measures%largest_hole, measures%escape, measures%cqi]
    end associate
  end subroutine fly

  real(wp) function seconds(alone)
    logical, intent(in) :: alone
    if (alone) then
      call cpu_time(seconds)
    else
      seconds = wall_seconds()
    end if
  end function seconds

  !> Where each observable stands among the components of `track`.
  pure subroutine bounds_of(observable, n_bullet, first, last)
    integer, intent(in) :: observable, n_bullet
    integer, intent(out) :: first, last
    integer :: ends(0:n_track)
    ends = [0, 3*n_bullet, 3*n_bullet + 3, 3*n_bullet + 4, 3*n_bullet + 7]
    first = ends(observable - 1) + 1
    last = ends(observable)
  end subroutine bounds_of

  subroutine observe(sim, look, flight)
    type(simulation_t), intent(in) :: sim
    integer, intent(in) :: look
    type(flight_t), intent(inout) :: flight
    integer :: i, n
    associate (net => sim%model%net, x => sim%state%node_position)
      n = size(net%bullet_nodes)
      if (.not. allocated(flight%track)) allocate (flight%track(3*n + 7, n_look), source=0.0_wp)
      do i = 1, n
        flight%track(3*i - 2:3*i, look) = x(net%bullet_nodes(i), :)
      end do
      flight%track(3*n + 1:3*n + 3, look) = net_centre_of_mass(net, x)
      if (size(net%perimeter_nodes) > 2) flight%track(3*n + 4, look) = loop_area(transpose(x(net%perimeter_nodes, :)))
      if (allocated(sim%model%target)) flight%track(3*n + 5:, look) = sim%model%target%mass*sim%state%target%velocity
      if (allocated(flight%node)) flight%node(:, :, look) = x(:net%n_node, :)
    end associate
  end subroutine observe

  !> The tiny nudge's growth, and the horizon: the last look before it is too large.
  subroutine grow_nudge(scene, file_net, result)
    type(scene_t), intent(in) :: scene
    type(file_net_t), allocatable, intent(in) :: file_net
    type(accuracy_t), intent(inout) :: result
    type(scene_t) :: bare
    type(flight_t) :: a, b
    integer :: k
    bare = scene
    if (allocated(bare%perturb)) deallocate (bare%perturb)
    call fly(bare, file_net, result%reference, 0, 0.0_wp, .true., .true., a)
    call fly(bare, file_net, result%reference, 1, tiny_nudge, .true., .true., b)
    if (allocated(a%error) .or. allocated(b%error)) return
    do k = 1, n_look
      result%growth(k) = sqrt(maxval(sum((a%node(:, :, k) - b%node(:, :, k))**2, dim=2)))
    end do
    k = 0
    do while (k < n_look)
      if (result%growth(k + 1) > horizon_distance) exit
      k = k + 1
    end do
    if (k > 0) result%horizon = result%time(k)
  end subroutine grow_nudge

  !> Spread of the reference's members, and which observables there are.
  subroutine take_floor(reference, result)
    type(flight_t), intent(in) :: reference(:)
    type(accuracy_t), intent(inout) :: result
    real(wp), allocatable :: mean(:, :)
    real(wp) :: last(n_track + 1:n_observable)
    integer :: m, o, first, end_, n_bullet
    n_bullet = (size(reference(1)%track, 1) - 7)/3
    call take_mean(reference, mean, last)
    do o = 1, n_observable
      if (o <= n_track) then
        call bounds_of(o, n_bullet, first, end_)
        result%used(o) = end_ >= first .and. any(abs(mean(first:end_, :)) > 0.0_wp)
        do m = 1, members
          result%floor(o, :) = result%floor(o, :) + sum((reference(m)%track(first:end_, :) - mean(first:end_, :))**2, dim=1)
        end do
      else
        result%used(o) = .not. ieee_is_nan(last(o))
        if (.not. result%used(o)) cycle
        do m = 1, members
          result%floor(o, :) = result%floor(o, :) + (reference(m)%last(o) - last(o))**2
        end do
      end if
    end do
    result%floor = sqrt(result%floor/(members - 1))
    do o = 1, n_observable
      result%floor(o, :) = max(result%floor(o, :), resolution(o))
    end do
  end subroutine take_floor

  subroutine take_mean(flights, mean, last)
    type(flight_t), intent(in) :: flights(:)
    real(wp), allocatable, intent(out) :: mean(:, :)
    real(wp), intent(out) :: last(n_track + 1:n_observable)
    integer :: m
    mean = flights(1)%track
    last = flights(1)%last
    do m = 2, size(flights)
      mean = mean + flights(m)%track
      last = last + flights(m)%last
    end do
    mean = mean/size(flights)
    last = last/size(flights)
  end subroutine take_mean

  !> Errors of a setting, and whether all are below the floor at the end.
  subroutine compare(flights, reference, result, setting)
    type(flight_t), intent(in) :: flights(:), reference(:)
    type(accuracy_t), intent(in) :: result
    type(setting_t), intent(inout) :: setting
    real(wp), allocatable :: mean(:, :), wanted(:, :)
    real(wp) :: last(n_track + 1:n_observable), wanted_last(n_track + 1:n_observable)
    integer :: o, first, end_
    setting%error = ieee_value(1.0_wp, ieee_quiet_nan)
    setting%single = setting%error
    if (setting%failed) return
    call take_mean(flights, mean, last)
    call take_mean(reference, wanted, wanted_last)
    setting%below_floor = .true.
    do o = 1, n_observable
      if (.not. result%used(o)) cycle
      if (o <= n_track) then
        call bounds_of(o, (size(mean, 1) - 7)/3, first, end_)
        setting%error(o, :) = sqrt(sum((mean(first:end_, :) - wanted(first:end_, :))**2, dim=1))
        setting%single(o, :) = sqrt(sum((flights(1)%track(first:end_, :) - reference(1)%track(first:end_, :))**2, dim=1))
      else
        setting%error(o, :) = abs(last(o) - wanted_last(o))
        setting%single(o, :) = abs(flights(1)%last(o) - reference(1)%last(o))
      end if
      setting%below_floor = setting%below_floor .and. is_below(result, setting, o)
    end do
  end subroutine compare

  !> Is the error at the end below the floor? First contact is known to a step of the setting
  !> besides. A NaN is above any floor.
  pure logical function is_below(result, setting, observable)
    type(accuracy_t), intent(in) :: result
    type(setting_t), intent(in) :: setting
    integer, intent(in) :: observable
    real(wp) :: known
    known = result%floor(observable, n_look)
    if (observable_name(observable) == 'first_contact') known = max(known, setting%step)
    is_below = setting%error(observable, n_look) <= known
  end function is_below

  !> log(e1/e2)/log(h1/h2) of the unperturbed runs at the horizon.
  subroutine take_orders(result)
    type(accuracy_t), intent(inout) :: result
    real(wp) :: e(2), smallest
    integer :: s, o, k
    k = nint(result%horizon/result%time(1))
    do s = 1, size(result%settings)
      result%settings(s)%order = ieee_value(1.0_wp, ieee_quiet_nan)
      if (s == 1 .or. k == 0) cycle
      if (result%settings(s)%method /= result%settings(s - 1)%method .or. result%settings(s)%tolerance > 0.0_wp) cycle
      do o = 1, n_track
        if (.not. result%used(o)) cycle
        e = [result%settings(s - 1)%single(o, k), result%settings(s)%single(o, k)]
        smallest = 1.0e-13_wp
        if (.not. (e(1) > smallest .and. e(2) > smallest)) cycle
        result%settings(s)%order(o) = log(e(1)/e(2))/log(result%settings(s - 1)%step/result%settings(s)%step)
      end do
    end do
  end subroutine take_orders

  subroutine move_first_error(flights, error)
    type(flight_t), intent(inout) :: flights(:)
    type(error_t), allocatable, intent(inout) :: error
    integer :: m
    do m = 1, size(flights)
      if (.not. allocated(flights(m)%error)) cycle
      call move_alloc(flights(m)%error, error)
      return
    end do
  end subroutine move_first_error

end module castnet_accuracy
