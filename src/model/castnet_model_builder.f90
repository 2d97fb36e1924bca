!> From a scene to the model of a run and its state at t = 0.
module castnet_model_builder
  use castnet_constants, only: pi
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_input
  use castnet_model, only: model_t, target_t, contact_t, closing_t, law_impulse, law_penalty, law_hunt_crossley, &
                           self_contact_none, self_contact_count, self_contact_taut, self_contact_impulses, &
                           method_rk4, method_midpoint, method_adaptive, trigger_contact, trigger_time, trigger_passed_target
  use castnet_net, only: net_t
  use castnet_net_builder, only: square_net_nodes, build_square_net, finish_net
  use castnet_renumber, only: renumber_net
  use castnet_perturb, only: perturbation_t, draw_perturbation, apply_perturbation
  use castnet_rotation, only: normalise_quaternion, quaternion_product
  use castnet_scene, only: scene_t, target_group_t, part_group_t, closing_group_t, is_set
  use castnet_shape, only: shape_t, new_shape, new_compound, new_mesh_shape, move_shape, unit_inertia, shape_centroid, &
                           shape_length
  use castnet_state, only: state_t, impulse_bins
  use castnet_text, only: path_beside, to_text
  use castnet_trigonometry, only: sine_cosine
  implicit none
  private
  public :: file_net_t, build_model

  !> A net that was read from a file, with its state at t = 0.
  type :: file_net_t
    type(net_t) :: net
    real(wp), allocatable :: position(:, :)  !! (3,n_node) [m]
    real(wp), allocatable :: velocity(:, :)  !! (3,n_node) [m/s]
  end type file_net_t

  !> Closing thread: stiffness k_t = 5 T_w/(squares x mesh length), damping ratio 0.3 on
  !> the bullets (physics.md section 5: a stiffer thread loses the capture).
  real(wp), parameter :: thread_stretch = 5.0_wp, thread_damping_ratio = 0.3_wp

contains

  !> Build everything that the scene asks for; `model%step` is left to the simulation,
  !> which knows the stability limits. The scene is complete: its defaults are resolved.
  !> Errors: a shape that cannot be made, a mesh file that cannot be read.
  subroutine build_model(scene, file_net, model, state, error)
    type(scene_t), intent(in) :: scene
    type(file_net_t), allocatable, intent(inout) :: file_net !! for kind 'file'; its net moves into the model
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(error_t), allocatable, intent(inout) :: error
    type(perturbation_t) :: drawn
    real(wp), allocatable :: position(:, :), velocity(:, :)
    integer :: n_node

    n_node = 0
    if (allocated(file_net)) then
      n_node = file_net%net%n_node
    else if (allocated(scene%net)) then
      n_node = square_net_nodes(scene%net, scene%bullets)
    end if
    if (allocated(scene%perturb)) call draw_perturbation(scene%perturb, n_node, drawn)

    if (allocated(file_net)) then
      allocate (model%net)
      model%net = file_net%net
      model%net%clamp_tension = scene%net%clamp_tension
      position = transpose(file_net%position)
      velocity = transpose(file_net%velocity)
      call renumber_net(model%net, position, velocity)
      call finish_net(model%net)
    else if (allocated(scene%net)) then
      allocate (model%net)
      call build_square_net(scene%net, scene%bullets, drawn, model%net, position, velocity)
    end if
    if (allocated(model%net)) then
      allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3), source=0.0_wp)
      state%node_position(:n_node, :) = position
      state%node_velocity(:n_node, :) = velocity
    end if

    if (allocated(scene%target)) then
      allocate (model%target, state%target)
      !$omp critical (castnet_text)
      call build_target(scene%target, scene%parts, mesh_path(scene), model%target, error)
      !$omp end critical (castnet_text)
      if (allocated(error)) return
      state%target%position = scene%target%position
      state%target%velocity = scene%target%velocity
      state%target%attitude = first_attitude(scene%target)
      state%target%angular_velocity = scene%target%angular_velocity
    end if

    if (allocated(scene%contact) .and. allocated(model%net) .and. allocated(model%target)) then
      allocate (model%contact)
      call build_contact(scene, model%contact)
      allocate (state%impulse_histogram(impulse_bins), source=0_i8)
    end if
    if (allocated(scene%closing)) then
      allocate (model%closing, state%closing)
      call build_closing(scene%closing, model%net, scene%bullets%mass, model%closing)
    end if
    if (allocated(scene%environment)) then
      model%gravity = scene%environment%gravity
      model%orbit_rate = scene%environment%orbit_rate
    end if

    model%end_time = scene%time%end_time
    model%tolerance = scene%time%tolerance
    select case (trim(scene%time%method))
    case ('rk4')
      model%method = method_rk4
    case ('midpoint')
      model%method = method_midpoint
    case ('adaptive')
      model%method = method_adaptive
    end select
    if (allocated(scene%perturb)) call apply_perturbation(drawn, model, state)
  end subroutine build_model

  !> The attitude at t = 0: the scene's, turned by `phase` about an axis of the body. The
  !> rate is in body axes and stays.
  pure function first_attitude(target) result(q)
    type(target_group_t), intent(in) :: target
    real(wp) :: q(4), axis(3), s, c
    q = normalise_quaternion(target%attitude)
    if (target%phase == 0.0_wp) return
    axis = target%angular_velocity
    if (all(is_set(target%phase_axis))) axis = target%phase_axis
    axis = axis/maxval(abs(axis))
    axis = axis/sqrt(axis(1)**2 + axis(2)**2 + axis(3)**2)
    call sine_cosine(target%phase*pi/360.0_wp, s, c)
    q = normalise_quaternion(quaternion_product(q, [c, s*axis(1), s*axis(2), s*axis(3)]))
  end function first_attitude

  !> The mesh file, seen from the scene's folder.
  function mesh_path(scene) result(path)
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: path
    path = trim(scene%target%file)
    if (allocated(scene%path)) path = path_beside(scene%path, path)
  end function mesh_path

  !> Shape and mass properties. Without `inertia`, those of the uniform solid; its centroid is then
  !> the centre of mass, to which a mesh is moved and at which a compound must be placed.
  subroutine build_target(group, parts, path, target, error)
    type(target_group_t), intent(in) :: group
    type(part_group_t), allocatable, intent(in) :: parts(:)
    character(len=*), intent(in) :: path             !! of the mesh
    type(target_t), intent(out) :: target
    type(error_t), allocatable, intent(inout) :: error
    real(wp), allocatable :: dimensions(:, :), position(:, :), attitude(:, :)
    character(len=len(group%shape)), allocatable :: shapes(:)
    integer :: i

    select case (trim(group%shape))
    case ('compound')
      allocate (dimensions(3, size(parts)), position(3, size(parts)), attitude(4, size(parts)))
      shapes = parts%shape
      do i = 1, size(parts)
        dimensions(:, i) = parts(i)%dimensions
        position(:, i) = parts(i)%position
        attitude(:, i) = normalise_quaternion(parts(i)%attitude)
      end do
      call new_compound(target%shape, shapes, dimensions, position, attitude, error)
    case ('mesh')
      call new_mesh_shape(target%shape, path, error)
    case default
      call new_shape(target%shape, trim(group%shape), group%dimensions, error)
    end select
    if (allocated(error)) return

    target%fixed = group%fixed
    target%external_force = group%external_force
    target%external_torque = group%external_torque
    if (is_set(group%mass)) target%mass = group%mass
    if (is_set(group%inertia(1))) then
      target%inertia(1, :) = [group%inertia(1), group%inertia(4), group%inertia(5)]
      target%inertia(2, :) = [group%inertia(4), group%inertia(2), group%inertia(6)]
      target%inertia(3, :) = [group%inertia(5), group%inertia(6), group%inertia(3)]
    else
      if (.not. target%fixed) call centre_solid(target%shape, group%shape == 'mesh', error)
      if (allocated(error)) return
      target%inertia = target%mass*unit_inertia(target%shape)
    end if
    if (target%fixed) return
    target%inverse_mass = 1.0_wp/target%mass
    call invert_symmetric(target%inertia, target%inverse_inertia)
  end subroutine build_target

  !> A uniform solid turns about its centroid. A file's origin means nothing: a mesh is moved. Parts
  !> are placed by hand: a compound off its centroid is an error of the scene.
  subroutine centre_solid(shape, may_move, error)
    type(shape_t), intent(inout) :: shape
    logical, intent(in) :: may_move
    type(error_t), allocatable, intent(inout) :: error
    real(wp), parameter :: tolerance = 1.0e-6_wp  ! of the length
    real(wp) :: centroid(3)
    centroid = shape_centroid(shape)
    if (may_move) then
      call move_shape(shape, centroid)
    else if (maxval(abs(centroid)) > tolerance*shape_length(shape)) then
      call fail(error, exit_input, 'target: the origin of body axes is the centre of mass, but the centroid of the '// &
                '&part solids is at '// &
                to_text(rounded(centroid(1)))//', '//to_text(rounded(centroid(2)))//', '// &
                to_text(rounded(centroid(3)))//' m; move the parts by the opposite, or give inertia')
    end if
  end subroutine centre_solid

  !> To a micrometre, for a message.
  pure real(wp) function rounded(x)
    real(wp), intent(in) :: x
    rounded = real(nint(x*1.0e6_wp, i8), wp)/1.0e6_wp
  end function rounded

  !> Inverse of a symmetric 3 x 3 matrix by cofactors.
  pure subroutine invert_symmetric(a, b)
    real(wp), intent(in) :: a(3, 3)
    real(wp), intent(out) :: b(3, 3)
    real(wp) :: determinant
    b(1, 1) = a(2, 2)*a(3, 3) - a(2, 3)*a(3, 2)
    b(1, 2) = a(1, 3)*a(3, 2) - a(1, 2)*a(3, 3)
    b(1, 3) = a(1, 2)*a(2, 3) - a(1, 3)*a(2, 2)
    b(2, 2) = a(1, 1)*a(3, 3) - a(1, 3)*a(3, 1)
    b(2, 3) = a(1, 3)*a(2, 1) - a(1, 1)*a(2, 3)
    b(3, 3) = a(1, 1)*a(2, 2) - a(1, 2)*a(2, 1)
    determinant = a(1, 1)*b(1, 1) + a(1, 2)*b(1, 2) + a(1, 3)*b(1, 3)
    b(2, 1) = b(1, 2)
    b(3, 1) = b(1, 3)
    b(3, 2) = b(2, 3)
    b = b/determinant
  end subroutine invert_symmetric

  subroutine build_contact(scene, contact)
    type(scene_t), intent(in) :: scene
    type(contact_t), intent(out) :: contact
    associate (group => scene%contact)
      select case (trim(group%law))
      case ('penalty')
        contact%law = law_penalty
      case ('hunt_crossley')
        contact%law = law_hunt_crossley
      case default
        contact%law = law_impulse
      end select
      contact%detect_cables = group%detect == 'cables'
      contact%push_only = group%impulses == 'push_only'
      contact%dense = group%solver == 'dense'
      contact%restitution = group%restitution
      contact%friction = group%friction
      contact%threshold = group%threshold
      if (is_set(group%stiffness)) contact%stiffness = group%stiffness
      if (is_set(group%damping)) contact%damping = group%damping
      select case (trim(group%self_contact))
      case ('count')
        contact%self_contact = self_contact_count
      case ('taut')
        contact%self_contact = self_contact_taut
      case ('impulses')
        contact%self_contact = self_contact_impulses
      case default
        contact%self_contact = self_contact_none
      end select
    end associate
  end subroutine build_contact

  !> A thread on each of the four sides, from bullet to bullet, through the perimeter
  !> nodes between them or straight ('bullets').
  subroutine build_closing(group, net, bullet_mass, closing)
    type(closing_group_t), intent(in) :: group
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: bullet_mass
    type(closing_t), intent(out) :: closing
    integer :: s, k, n, first(5)

    select case (trim(group%trigger))
    case ('time')
      closing%trigger = trigger_time
    case ('passed_target')
      closing%trigger = trigger_passed_target
    case default
      closing%trigger = trigger_contact
    end select
    closing%delay = group%delay
    closing%winch_speed = group%winch_speed
    closing%locked_length = group%locked_length
    closing%max_tension = group%max_tension
    closing%ring_friction = group%ring_friction
    closing%stiffness = thread_stretch*group%max_tension/net%side_length
    closing%damping = 2.0_wp*thread_damping_ratio*sqrt(closing%stiffness*bullet_mass)

    n = size(net%perimeter_nodes)
    do s = 1, 4
      first(s) = findloc(net%perimeter_nodes, net%corner_nodes(s), dim=1)
    end do
    first(5) = n + 1
    allocate (closing%path_start(5), closing%path_node(0))
    do s = 1, 4
      closing%path_start(s) = size(closing%path_node) + 1
      closing%path_node = [closing%path_node, net%bullet_nodes(s)]
      if (group%path == 'perimeter') then
        do k = first(s), first(s + 1)
          closing%path_node = [closing%path_node, net%perimeter_nodes(modulo(k - 1, n) + 1)]
        end do
      end if
      closing%path_node = [closing%path_node, net%bullet_nodes(modulo(s, 4) + 1)]
    end do
    closing%path_start(5) = size(closing%path_node) + 1
  end subroutine build_closing

end module castnet_model_builder
