!> Scenes and small models that several tests and the benchmark share.
module scenes
  use, intrinsic :: iso_fortran_env, only: int64
  use castnet_kinds, only: wp
  use castnet_diagnostics, only: net_kinetic_energy, target_kinetic_energy, elastic_energy
  use castnet_error, only: error_t
  use castnet_integrator, only: new_flow_work, midpoint_begin
  use castnet_model, only: model_t, method_rk4, method_midpoint
  use castnet_model_builder, only: file_net_t, build_model
  use castnet_net_builder, only: finish_net
  use castnet_scene, only: scene_t
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, new_work, advance, settle
  use testing, only: expect
  implicit none
  private
  public :: shot, cubesat_shot, parabolic_shot, rocket_shot, closing_rocket, build, add_spinning_body
  public :: net_of, chain, two_masses, ready, fly, mechanical_energy, state_hash, random_numbers, permutation, words

contains

  !> A square net with bullets and nothing to meet. Without `corner`: sqrt(2) meshes.
  function shot(squares, mesh, diameter, edge, bullet_mass, speed) result(scene)
    integer, intent(in) :: squares(2)
    real(wp), intent(in) :: mesh, diameter, edge, bullet_mass, speed
    type(scene_t) :: scene
    allocate (scene%net, scene%bullets)
    scene%net%squares = squares
    scene%net%mesh_length = mesh
    scene%net%cable_diameter = diameter
    scene%net%edge_cable_diameter = edge
    scene%bullets%mass = bullet_mass
    scene%bullets%speed = speed
    scene%bullets%corner_cable_length = sqrt(2.0_wp)*mesh
    scene%time%end_time = 10.0_wp
    allocate (scene%output%verdict_times(0))
  end function shot

  !> The nets of paper Tables 1 and 2, with physics.md's diameters.
  function cubesat_shot() result(scene)
    type(scene_t) :: scene
    scene = shot([10, 10], 0.07_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp)
  end function cubesat_shot

  function parabolic_shot() result(scene)
    type(scene_t) :: scene
    scene = shot([10, 10], 0.08_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp)
  end function parabolic_shot

  function rocket_shot() result(scene)
    type(scene_t) :: scene
    scene = shot([20, 20], 1.5_wp, 1.0e-3_wp, 1.0e-3_wp, 1.0_wp, 10.0_wp)
  end function rocket_shot

  !> Model and state of a scene without files; a scene that is refused fails the case.
  subroutine build(scene, model, state)
    type(scene_t), intent(in) :: scene
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(file_net_t), allocatable :: no_file
    type(error_t), allocatable :: error
    call build_model(scene, no_file, model, state, error)
    call expect(.not. allocated(error), 'the scene builds')
  end subroutine build

  !> A free body with this inertia tensor, and nothing else.
  subroutine add_spinning_body(inertia, attitude, angular_velocity, model, state)
    real(wp), intent(in) :: inertia(3, 3), attitude(4), angular_velocity(3)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    real(wp) :: c(3, 3)
    integer :: i, j, i1, i2, j1, j2
    allocate (model%target, state%target)
    model%target%mass = 1.0_wp
    model%target%inverse_mass = 1.0_wp
    model%target%inertia = inertia
    do j = 1, 3
      do i = 1, 3
        i1 = modulo(i, 3) + 1; i2 = modulo(i + 1, 3) + 1
        j1 = modulo(j, 3) + 1; j2 = modulo(j + 1, 3) + 1
        c(i, j) = inertia(i1, j1)*inertia(i2, j2) - inertia(i1, j2)*inertia(i2, j1)
      end do
    end do
    model%target%inverse_inertia = c/(inertia(1, 1)*c(1, 1) + inertia(1, 2)*c(1, 2) + inertia(1, 3)*c(1, 3))
    state%target%attitude = attitude
    state%target%angular_velocity = angular_velocity
  end subroutine add_spinning_body

  !> Any net: k = EA/l0 per cable. Positions and velocities (n,3).
  subroutine net_of(mass, fixed, cable_nodes, stiffness, natural_length, damping, clamp, position, velocity, model, state)
    real(wp), intent(in) :: mass(:)
    logical, intent(in) :: fixed(:)
    integer, intent(in) :: cable_nodes(:, :)
    real(wp), intent(in) :: stiffness(:), natural_length(:), damping(:) !! k [N/m], [m], [N s/m]
    logical, intent(in) :: clamp
    real(wp), intent(in) :: position(:, :), velocity(:, :)
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    integer :: n
    n = size(mass)
    allocate (model%net)
    model%net%n_node = n
    model%net%n_cable = size(cable_nodes, 2)
    model%net%clamp_tension = clamp
    model%net%node_mass = mass
    model%net%fixed = fixed
    model%net%cable_nodes = cable_nodes
    model%net%natural_length = natural_length
    model%net%axial_stiffness = stiffness*natural_length
    model%net%damping = damping
    call finish_net(model%net)
    allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3), source=0.0_wp)
    state%node_position(:n, :) = position
    state%node_velocity(:n, :) = velocity
  end subroutine net_of

  !> A chain along `direction`: nodes at distances `s` from the origin, equal cables
  !> between neighbours, at rest.
  subroutine chain(s, direction, mass, fixed, stiffness, natural_length, damping, model, state)
    real(wp), intent(in) :: s(:)              !! [m]
    real(wp), intent(in) :: direction(3)      !! unit
    real(wp), intent(in) :: mass(:)
    logical, intent(in) :: fixed(:)
    real(wp), intent(in) :: stiffness, natural_length, damping
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    real(wp) :: position(size(s), 3), one(size(s) - 1)
    integer :: i, nodes(2, size(s) - 1)
    do i = 1, size(s)
      position(i, :) = s(i)*direction
    end do
    do i = 1, size(s) - 1
      nodes(:, i) = [i, i + 1]
    end do
    one = 1.0_wp
    call net_of(mass, fixed, nodes, stiffness*one, natural_length*one, damping*one, .true., position, 0.0_wp*position, &
                model, state)
  end subroutine chain

  !> Two masses on the x axis, `gap` short of taut, flying apart at relative speed v with
  !> their centre of mass at rest.
  subroutine two_masses(mass, stiffness, natural_length, damping, clamp, gap, speed, model, state)
    real(wp), intent(in) :: mass(2), stiffness, natural_length, damping, gap, speed
    logical, intent(in) :: clamp
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    real(wp) :: position(2, 3), velocity(2, 3), share
    share = mass(2)/(mass(1) + mass(2))
    position = 0.0_wp
    velocity = 0.0_wp
    position(1, 1) = -share*(natural_length - gap)
    position(2, 1) = (1.0_wp - share)*(natural_length - gap)
    velocity(1, 1) = -share*speed
    velocity(2, 1) = (1.0_wp - share)*speed
    call net_of(mass, [.false., .false.], reshape([1, 2], [2, 1]), [stiffness], [natural_length], [damping], clamp, &
                position, velocity, model, state)
  end subroutine two_masses

  !> Make a model ready to step. `n_thread` given: threads whatever the net's size.
  subroutine ready(model, state, work, method, step, n_thread)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    type(work_t), intent(out) :: work
    integer, intent(in) :: method
    real(wp), intent(in) :: step
    integer, intent(in), optional :: n_thread
    model%method = method
    model%step = step
    call new_work(work, model, 1)
    if (present(n_thread)) call new_flow_work(work%flow, model, n_thread)
    if (method == method_midpoint) call midpoint_begin(state)
  end subroutine ready

  !> Take n steps.
  subroutine fly(model, state, work, n)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(work_t), intent(inout) :: work
    integer, intent(in) :: n
    type(error_t), allocatable :: error
    integer :: i
    do i = 1, n
      call advance(model, state, work, error)
      if (allocated(error)) then
        call expect(.false., 'a step without an error: '//error%message)
        return
      end if
    end do
    call settle(model, state, work)
  end subroutine fly

  !> The paper's rocket net with the winches of physics.md section 5.
  function closing_rocket(method) result(scene)
    character(len=*), intent(in) :: method
    type(scene_t) :: scene
    allocate (scene%net, scene%bullets, scene%closing)
    scene%time%method = method
    scene%net%squares = 20
    scene%net%mesh_length = 1.5_wp
    scene%net%cable_diameter = 1.0e-3_wp
    scene%net%edge_cable_diameter = 1.0e-3_wp
    scene%bullets%mass = 1.0_wp
    scene%bullets%speed = 10.0_wp
    scene%bullets%corner_cable_length = 1.5_wp*sqrt(2.0_wp)
    scene%closing%winch_speed = 20.0_wp
    scene%closing%max_tension = 100.0_wp
    scene%closing%locked_length = 0.5_wp
    scene%time%end_time = 10.0_wp
    scene%output%verdict_times = [10.0_wp]
  end function closing_rocket

  !> Kinetic and elastic energy of net and target [J].
  real(wp) function mechanical_energy(model, state) result(energy)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    energy = 0.0_wp
    if (allocated(model%net)) energy = net_kinetic_energy(model%net, state%node_velocity) + &
                                       elastic_energy(model%net, state%node_position)
    if (allocated(model%target)) energy = energy + target_kinetic_energy(model%target, state%target)
  end function mechanical_energy

  !> A hash of every bit of nodes, target and ledger.
  integer(int64) function state_hash(state) result(hash)
    type(state_t), intent(in) :: state
    hash = 1469598103934665603_int64
    if (allocated(state%node_position)) then
      call mix(hash, reshape(state%node_position, [size(state%node_position)]))
      call mix(hash, reshape(state%node_velocity, [size(state%node_velocity)]))
    end if
    if (allocated(state%velocity_ahead)) call mix(hash, reshape(state%velocity_ahead, [size(state%velocity_ahead)]))
    if (allocated(state%target)) call mix(hash, [state%target%position, state%target%velocity, state%target%attitude, &
                                                 state%target%angular_velocity])
    call mix(hash, [state%time, state%ledger%dissipated, state%ledger%external_work])
  end function state_hash

  !> Rotations and exclusive or only: nothing that overflows.
  subroutine mix(hash, values)
    integer(int64), intent(inout) :: hash
    real(wp), intent(in) :: values(:)
    integer :: i
    do i = 1, size(values)
      hash = ieor(ishftc(hash, 13), transfer(values(i), 0_int64))
      hash = ieor(hash, ishft(ishftc(hash, 29), -7))
    end do
  end subroutine mix

  !> Numbers between -1 and 1 from a Lehmer generator (Park and Miller), the same everywhere.
  subroutine random_numbers(seed, values)
    integer, intent(inout) :: seed           !! 1 .. 2147483646
    real(wp), intent(out) :: values(:)
    integer :: i
    do i = 1, size(values)
      seed = int(modulo(16807_int64*seed, 2147483647_int64))
      values(i) = 2.0_wp*real(seed, wp)/2147483647.0_wp - 1.0_wp
    end do
  end subroutine random_numbers

  !> 1..n in random order.
  function permutation(n, seed) result(p)
    integer, intent(in) :: n
    integer, intent(inout) :: seed
    integer :: p(n), i, j, k
    real(wp) :: r(1)
    p = [(i, i=1, n)]
    do i = n, 2, -1
      call random_numbers(seed, r)
      j = max(1, min(i, 1 + int(0.5_wp*(r(1) + 1.0_wp)*i)))
      k = p(i); p(i) = p(j); p(j) = k
    end do
  end function permutation

  !> A number in a note.
  function words(value) result(text)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=24) :: buffer
    write (buffer, '(es14.6)') value
    text = trim(adjustl(buffer))
  end function words

end module scenes
