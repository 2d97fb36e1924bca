!> The one table of every group and key of a scene: reading, `castnet schema`, the
!> template of `castnet init`, the reference page, overrides and the effective scene all
!> come from it. A feature that gets built leaves the list of what is not available yet.
module castnet_scene_schema
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_input
  use castnet_namelist, only: item_t, parse_value_list
  use castnet_scene, only: scene_t, part_group_t
  use castnet_schema, only: schema_t
  use castnet_schema_entry, only: entry_t, kind_word, kind_path
  use castnet_text, only: lower, parse_integer, did_you_mean, to_text, quoted, is_one_of
  implicit none
  private
  public :: scene_table, part_table, store_lists, allocate_all_groups, scene_groups, groups_with_key
  public :: set_key, get_key, split_key, key_reference_t, parse_override_value, allocate_group

  ! Not available yet: a builder of one of these takes it out here, and nowhere else.
  character(len=*), parameter :: pending_laws = ''
  character(len=*), parameter :: pending_detect = ''
  character(len=*), parameter :: pending_shapes = ''
  character(len=*), parameter :: pending_methods = ''
  logical, parameter :: pending_friction = .false.
  logical, parameter :: pending_closing = .false.
  logical, parameter :: pending_orbit = .false.

  character(len=*), parameter :: scene_groups = &
    'net bullets target part contact closing environment time output perturb'

  ! Conditions under which a key is required or has an effect; `castnet_scene_check` knows what they mean.
  character(len=*), parameter :: square_net = 'kind = ''square''', file_net = 'kind = ''file'''
  character(len=*), parameter :: impulse_law = 'law = ''impulse''', compliant_law = 'law is compliant'

  !> The parts of 'group/key(i)', or of 'part(k)/key(i)'.
  type :: key_reference_t
    character(len=:), allocatable :: group, key
    integer :: instance = 0          !! of a repeated group; 0: not said
    integer :: subscript = 0         !! component; 0: the whole key
  end type key_reference_t

contains

  !> The table of a scene, bound to the groups that are allocated; parts: `part_table`.
  subroutine scene_table(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(out) :: table
    call table%start()
    if (allocated(scene%net)) call net_keys(scene, table)
    if (allocated(scene%bullets)) call bullets_keys(scene, table)
    if (allocated(scene%target)) call target_keys(scene, table)
    if (allocated(scene%contact)) call contact_keys(scene, table)
    if (allocated(scene%closing)) call closing_keys(scene, table)
    if (allocated(scene%environment)) call environment_keys(scene, table)
    call time_keys(scene, table)
    call output_keys(scene, table)
    if (allocated(scene%perturb)) call perturb_keys(scene, table)
  end subroutine scene_table

  subroutine net_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%net)
      call t%group('net', 'The net: point masses joined by cables that carry tension only.')
      call t%word_key('kind', g%kind, 'square file', 'a square-meshed net, or any net from an HDF5 file')
      call t%integer_array('squares', g%squares, 'mesh squares along y and z', 1, 100000, need=square_net)
      call t%real_key('mesh_length', g%mesh_length, 'm', 'side of one mesh square', low=1.0e-6_wp, high=1.0e6_wp, need=square_net)
      call t%real_key('cable_diameter', g%cable_diameter, 'm', 'diameter of the inner cables', &
                      low=1.0e-7_wp, high=10.0_wp, need=square_net)
      call t%real_key('edge_cable_diameter', g%edge_cable_diameter, 'm', 'diameter of the edge and corner cables', &
                      low=1.0e-7_wp, high=10.0_wp, use=square_net, fallback='cable_diameter')
      call t%real_key('density', g%density, 'kg/m3', 'density of the cables', low=1.0e-3_wp, high=1.0e6_wp, use=square_net)
      call t%real_key('elastic_modulus', g%elastic_modulus, 'Pa', 'elastic modulus of the cables', &
                      low=1.0e-3_wp, high=1.0e15_wp, use=square_net)
      call t%real_key('damping_ratio', g%damping_ratio, '-', &
                      'z in c = 2 z sqrt(k mu) of each cable, mu the reduced mass of its ends', &
                      low=0.0_wp, high=100.0_wp, use=square_net)
      call t%integer_key('cables_per_side', g%cables_per_side, 'cables in one mesh side', 1, 1000, use=square_net)
      call t%real_key('stowed_scale', g%stowed_scale, '-', 'size of the stowed net over that of the flat one', &
                      low=1.0e-3_wp, high=2.0_wp, use=square_net)
      call t%logical_key('clamp_tension', g%clamp_tension, 'tension is never negative, whatever the damping')
      call t%path_key('file', g%file, 'HDF5 file of the net, seen from the scene''s folder', need=file_net)
    end associate
  end subroutine net_keys

  subroutine bullets_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%bullets)
      call t%group('bullets', 'Four masses on cables at the corners of a square net, shot towards +x.')
      call t%real_key('mass', g%mass, 'kg', 'mass of each bullet', low=1.0e-9_wp, high=1.0e9_wp, need='always')
      call t%real_key('speed', g%speed, 'm/s', 'speed of each bullet at t = 0', low=0.0_wp, high=1.0e5_wp, need='always')
      call t%real_key('angle', g%angle, 'degree', 'angle of the shot from +x, outward along the diagonals', &
                      low=0.0_wp, high=90.0_wp)
      call t%real_key('corner_cable_length', g%corner_cable_length, 'm', 'natural length of the corner cables', &
                      low=1.0e-6_wp, high=2.0e6_wp, fallback='sqrt(2) x mesh_length')
    end associate
  end subroutine bullets_keys

  subroutine target_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%target)
      call t%group('target', 'The rigid body to catch.')
      call t%word_key('shape', g%shape, 'box cylinder sphere capsule compound mesh', &
                      'shape; ''compound'' is the union of the &part groups', need='always', pending=pending_shapes)
      call t%real_array('dimensions', g%dimensions, 'm', 'box: edges x, y, z; cylinder: diameter, length along body z; '// &
                        'sphere: diameter; capsule: diameter, length between the cap centres along body z', &
                        low=1.0e-9_wp, high=1.0e6_wp, least=1, need='shape has dimensions', use='shape has dimensions')
      call t%real_key('mass', g%mass, 'kg', 'mass', low=1.0e-9_wp, high=1.0e15_wp, need='unless fixed')
      call t%real_array('inertia', g%inertia, 'kg m2', 'tensor entries xx yy zz xy xz yz about the centre of mass, '// &
                        'body axes; xy = - sum m x y', low=-1.0e24_wp, high=1.0e24_wp, fallback='of the uniform solid')
      call t%real_array('position', g%position, 'm', 'centre of mass at t = 0, inertial axes', &
                        low=-1.0e9_wp, high=1.0e9_wp, need='always')
      call t%real_array('velocity', g%velocity, 'm/s', 'velocity of the centre of mass at t = 0, inertial axes', &
                        low=-1.0e6_wp, high=1.0e6_wp)
      call t%real_array('attitude', g%attitude, '-', 'quaternion at t = 0, scalar first, body to inertial axes', &
                        low=-1.0e6_wp, high=1.0e6_wp)
      call t%real_array('angular_velocity', g%angular_velocity, 'rad/s', 'rate at t = 0, body axes', &
                        low=-1.0e5_wp, high=1.0e5_wp)
      call t%real_key('phase', g%phase, 'degree', 'turns the attitude at t = 0 about phase_axis: where in its '// &
                      'tumbling the body starts', low=-1.0e6_wp, high=1.0e6_wp)
      call t%real_array('phase_axis', g%phase_axis, '-', 'axis of phase, body axes, any length', &
                        low=-1.0e6_wp, high=1.0e6_wp, fallback='the direction of angular_velocity')
      call t%logical_key('fixed', g%fixed, 'held in place: neither moves nor turns')
      call t%real_array('external_force', g%external_force, 'N', 'constant force at the centre of mass, inertial axes', &
                        low=-1.0e15_wp, high=1.0e15_wp)
      call t%real_array('external_torque', g%external_torque, 'N m', 'constant torque, body axes', &
                        low=-1.0e15_wp, high=1.0e15_wp)
      call t%path_key('file', g%file, 'STL or OBJ file of the shape in metres, seen from '// &
                      'the scene''s folder; its origin is the centre of mass if inertia is given, else the centroid is', &
                      need='shape = ''mesh''')
    end associate
  end subroutine target_keys

  !> The table of one &part; `number` is its place among them, for the messages.
  subroutine part_table(part, number, table)
    type(part_group_t), target, intent(inout) :: part
    integer, intent(in) :: number
    type(schema_t), intent(out) :: table
    call table%start()
    table%label = number
    associate (t => table, g => part)
      call t%group('part', 'One solid of a compound target; repeat the group for each.', repeats=.true.)
      call t%word_key('shape', g%shape, 'box cylinder sphere capsule', 'shape', need='always')
      call t%real_array('dimensions', g%dimensions, 'm', 'as for &target', low=1.0e-9_wp, high=1.0e6_wp, least=1, need='always')
      call t%real_array('position', g%position, 'm', 'centre of the part, body axes', low=-1.0e6_wp, high=1.0e6_wp)
      call t%real_array('attitude', g%attitude, '-', 'quaternion, scalar first, part to body axes', &
                        low=-1.0e6_wp, high=1.0e6_wp)
    end associate
  end subroutine part_table

  subroutine contact_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%contact)
      call t%group('contact', 'How net and target meet. Without it they pass through each other.')
      call t%word_key('law', g%law, 'impulse penalty hunt_crossley', &
                      'contact law: impulses, or springs and dampers at the nodes', pending=pending_laws)
      call t%word_key('detect', g%detect, 'nodes cables', 'what of the net can touch', pending=pending_detect)
      call t%real_key('restitution', g%restitution, '-', 'coefficient of restitution', low=0.0_wp, high=1.0_wp, use=impulse_law)
      call t%real_key('friction', g%friction, '-', 'coefficient of friction', low=0.0_wp, high=100.0_wp, &
                      only_zero=pending_friction)
      call t%real_key('threshold', g%threshold, 'm', 'distance from the surface at which contact begins', &
                      low=1.0e-9_wp, high=1.0e3_wp, need='always')
      call t%word_key('impulses', g%impulses, 'push_only equality', &
                      'impulses may only push, or solve the paper''s equality', use=impulse_law)
      call t%word_key('solver', g%solver, 'reduced dense', 'exact 6 x 6 form, or the dense matrix by elimination', use=impulse_law)
      call t%real_key('stiffness', g%stiffness, 'N/m', 'of the compliant laws (hunt_crossley: N/m^1.5)', &
                      low=1.0e-6_wp, high=1.0e15_wp, need=compliant_law, use=compliant_law)
      call t%real_key('damping', g%damping, 'N s/m', 'of the compliant laws (hunt_crossley: s/m)', &
                      low=0.0_wp, high=1.0e15_wp, use=compliant_law, fallback='0')
      call t%word_key('self_contact', g%self_contact, 'none count taut impulses', &
                      'the net''s cables among themselves: they pass through each other; the same, counted; held apart where '// &
                      'both are taut; held apart')
    end associate
  end subroutine contact_keys

  subroutine closing_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%closing)
      call t%group('closing', 'Winches in the bullets draw the mouth of the net shut.', pending=pending_closing)
      call t%word_key('trigger', g%trigger, 'contact time passed_target', 'what starts the winches: first contact; t = 0; '// &
                      'the net''s centre of mass beyond the target''s along +x')
      call t%real_key('delay', g%delay, 's', 'from the trigger to the first pull', low=0.0_wp, high=1.0e9_wp)
      call t%real_key('winch_speed', g%winch_speed, 'm/s', 'thread wound in per side and second, unloaded', &
                      low=1.0e-9_wp, high=1.0e5_wp, need='always')
      call t%real_key('locked_length', g%locked_length, 'm', 'thread left on each side when the winch stops', &
                      low=0.0_wp, high=1.0e6_wp, need='always')
      call t%real_key('max_tension', g%max_tension, 'N', 'tension at which the winch stalls', &
                      low=1.0e-9_wp, high=1.0e12_wp, need='always')
      call t%word_key('path', g%path, 'perimeter bullets', 'thread through the net''s edge, or between the bullets only')
      call t%real_key('ring_friction', g%ring_friction, '-', 'coefficient of friction at each ring (capstan)', &
                      low=0.0_wp, high=10.0_wp)
    end associate
  end subroutine closing_keys

  subroutine environment_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%environment)
      call t%group('environment', 'What acts on net and target alike.')
      call t%real_array('gravity', g%gravity, 'm/s2', 'uniform gravity, inertial axes', low=-1.0e6_wp, high=1.0e6_wp)
      call t%real_key('orbit_rate', g%orbit_rate, 'rad/s', 'rate n of the frame on the target''s circular orbit: '// &
                      'x along the velocity, y against the orbit normal, z to Earth', &
                      low=-1.0_wp, high=1.0_wp, only_zero=pending_orbit)
    end associate
  end subroutine environment_keys

  subroutine time_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%time)
      call t%group('time', 'How long, in what steps.', required=.true.)
      call t%real_key('end_time', g%end_time, 's', 'simulated time', low=1.0e-9_wp, high=1.0e9_wp, need='always')
      call t%real_key('step', g%step, 's', 'time step; 0 = chosen from the net''s stability limit', low=0.0_wp, high=1.0e6_wp)
      call t%word_key('method', g%method, 'rk4 midpoint adaptive', 'time integration', pending=pending_methods)
      call t%real_key('tolerance', g%tolerance, '-', 'error of a position per part of a step of ''adaptive'', over the mean '// &
                      'cable length', low=1.0e-14_wp, high=1.0_wp, use='method = ''adaptive''')
      call t%logical_key('allow_unstable', g%allow_unstable, 'a step above the stability limit: warn instead of refuse')
    end associate
  end subroutine time_keys

  subroutine output_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%output)
      call t%group('output', 'What is written, and when.')
      call t%path_key('file', g%file, 'HDF5 file of the results, seen from the scene''s folder; --output wins', &
                      fallback='the scene''s name with .h5, beside it')
      call t%real_key('frame_interval', g%frame_interval, 's', 'between frames of the whole state', &
                      low=1.0e-12_wp, high=1.0e9_wp, fallback='end_time/100')
      call t%real_key('history_interval', g%history_interval, 's', 'between rows of the history', &
                      low=1.0e-14_wp, high=1.0e9_wp, fallback='frame_interval/10')
      call t%real_key('checkpoint_interval', g%checkpoint_interval, 's', 'simulated time between checkpoints; 0 = none', &
                      low=0.0_wp, high=1.0e9_wp)
      call t%real_key('checkpoint_wall_interval', g%checkpoint_wall_interval, 's', 'wall time between checkpoints; 0 = none', &
                      low=0.0_wp, high=1.0e9_wp)
      call t%real_list('verdict_times', g%verdict_times, 's', 'times of the capture measures, rising', &
                       low=0.0_wp, high=1.0e9_wp, fallback='end_time')
      call t%logical_key('vtk', g%vtk, 'write /VTKHDF for ParaView into the same file')
    end associate
  end subroutine output_keys

  subroutine perturb_keys(scene, table)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(inout) :: table
    associate (t => table, g => scene%perturb)
      call t%group('perturb', 'Normal perturbations, drawn once at the start: standard deviations.')
      call t%long_key('seed', g%seed, 'seed of the draws')
      call t%real_key('node_position', g%node_position, 'm', 'of each coordinate of each net node', low=0.0_wp, high=1.0e3_wp)
      call t%real_key('bullet_speed', g%bullet_speed, 'm/s', 'of each bullet''s speed', low=0.0_wp, high=1.0e3_wp)
      call t%real_key('bullet_angle', g%bullet_angle, 'degree', 'of each bullet''s angle', low=0.0_wp, high=90.0_wp)
      call t%real_key('target_position', g%target_position, 'm', 'of each coordinate of the target', low=0.0_wp, high=1.0e3_wp)
      call t%real_key('target_rate', g%target_rate, 'rad/s', 'of each component of the target''s rate', &
                      low=0.0_wp, high=1.0e3_wp)
    end associate
  end subroutine perturb_keys

  !> Copy the lists of open length from the table to the scene.
  subroutine store_lists(table, scene)
    type(schema_t), intent(in) :: table
    type(scene_t), intent(inout) :: scene
    integer :: i
    i = table%find('output', 'verdict_times')
    if (i == 0) return
    if (allocated(table%entries(i)%real_list)) then
      scene%output%verdict_times = table%entries(i)%real_list
    else if (allocated(scene%output%verdict_times)) then
      deallocate (scene%output%verdict_times)
    end if
  end subroutine store_lists

  !> Every group present, with its defaults: for reading, the reference and the template.
  subroutine allocate_all_groups(scene)
    type(scene_t), intent(inout) :: scene
    if (.not. allocated(scene%net)) allocate (scene%net)
    if (.not. allocated(scene%bullets)) allocate (scene%bullets)
    if (.not. allocated(scene%target)) allocate (scene%target)
    if (.not. allocated(scene%contact)) allocate (scene%contact)
    if (.not. allocated(scene%closing)) allocate (scene%closing)
    if (.not. allocated(scene%environment)) allocate (scene%environment)
    if (.not. allocated(scene%perturb)) allocate (scene%perturb)
  end subroutine allocate_all_groups

  !> The groups that have a key of this name: '&bullets, &target'; '' if none.
  function groups_with_key(key) result(list)
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: list
    type(scene_t), target :: scene
    type(schema_t) :: table
    integer :: i
    call allocate_all_groups(scene)
    call scene_table(scene, table)
    list = ''
    do i = 1, table%n
      if (table%entries(i)%key == key) list = list//', &'//trim(table%entries(i)%group)
    end do
    if (len(list) > 0) list = list(3:)
  end function groups_with_key

  subroutine allocate_group(scene, name)
    type(scene_t), intent(inout) :: scene
    character(len=*), intent(in) :: name
    select case (name)
    case ('net')
      if (.not. allocated(scene%net)) allocate (scene%net)
    case ('bullets')
      if (.not. allocated(scene%bullets)) allocate (scene%bullets)
    case ('target')
      if (.not. allocated(scene%target)) allocate (scene%target)
    case ('contact')
      if (.not. allocated(scene%contact)) allocate (scene%contact)
    case ('closing')
      if (.not. allocated(scene%closing)) allocate (scene%closing)
    case ('environment')
      if (.not. allocated(scene%environment)) allocate (scene%environment)
    case ('perturb')
      if (.not. allocated(scene%perturb)) allocate (scene%perturb)
    end select
  end subroutine allocate_group

  !> Split 'group/key', 'group/key(i)' or 'part(k)/key(i)'.
  subroutine split_key(text, reference, problem)
    character(len=*), intent(in) :: text
    type(key_reference_t), intent(out) :: reference
    character(len=:), allocatable, intent(out) :: problem
    character(len=:), allocatable :: name
    integer :: slash
    name = lower(trim(adjustl(text)))
    slash = index(name, '/')
    reference%group = ''
    reference%key = ''
    if (slash < 2 .or. slash == len(name)) then
      problem = 'seen '//quoted(trim(text))//'; expected group/key, or group/key(2) for one component'
      return
    end if
    call split_index(name(:slash - 1), reference%group, reference%instance, problem)
    if (.not. allocated(problem)) call split_index(name(slash + 1:), reference%key, reference%subscript, problem)
  end subroutine split_key

  subroutine split_index(text, name, number, problem)
    character(len=*), intent(in) :: text
    character(len=:), allocatable, intent(out) :: name
    integer, intent(out) :: number
    character(len=:), allocatable, intent(inout) :: problem
    character(len=:), allocatable :: wrong
    integer(i8) :: long
    integer :: bracket
    number = 0
    bracket = index(text, '(')
    name = text
    if (bracket == 0) return
    name = trim(text(:bracket - 1))
    if (text(len(text):) /= ')') then
      problem = 'seen '//quoted(text)//'; the bracket is not closed'
      return
    end if
    call parse_integer(trim(adjustl(text(bracket + 1:len(text) - 1))), long, wrong)
    if (allocated(wrong) .or. long < 1 .or. long > 1000000) then
      problem = 'seen '//quoted(text)//'; expected one number in the brackets, such as (2)'
    else
      number = int(long)
    end if
  end subroutine split_index

  !> Value text of the command line or a study: as in a scene, but words and paths
  !> need no quotes.
  subroutine parse_override_value(entry, text, item, problem)
    type(entry_t), intent(in) :: entry
    character(len=*), intent(in) :: text
    type(item_t), intent(out) :: item
    character(len=:), allocatable, intent(out) :: problem
    logical :: bare
    bare = entry%kind == kind_word .or. entry%kind == kind_path
    if (bare .and. len(text) > 0) bare = scan(text(1:1), '''"') == 0
    if (bare) then
      allocate (item%values(1))
      item%n = 1
      item%values(1)%text = text
      item%values(1)%is_string = .true.
    else
      call parse_value_list(text, item, problem)
      if (.not. allocated(problem)) then
        if (any(item%values(:item%n)%broken)) problem = 'seen '//quoted(text)
      end if
    end if
  end subroutine parse_override_value

  !> Set one value of a scene by name: 'group/key', 'group/key(i)', 'part(k)/key(i)'.
  !> A group that the scene left out comes into being with its defaults. Checks type,
  !> count and range; what keys mean to each other is for `finish_scene`.
  subroutine set_key(scene, key, text, error)
    type(scene_t), target, intent(inout) :: scene
    character(len=*), intent(in) :: key, text
    type(error_t), allocatable, intent(inout) :: error
    type(schema_t) :: table
    type(item_t) :: item
    character(len=:), allocatable :: problem
    integer :: i, subscript
    call locate(scene, key, table, i, subscript, problem)
    if (.not. allocated(problem)) call parse_override_value(table%entries(i), text, item, problem)
    if (.not. allocated(problem)) then
      item%subscript = subscript
      call table%entries(i)%set(item, problem)
    end if
    if (allocated(problem)) then
      call fail(error, exit_input, trim(key)//': '//problem)
    else if (table%groups(1)%name /= 'part') then
      call store_lists(table, scene)
    end if
  end subroutine set_key

  !> The value of a key as namelist text; '' when it has none.
  subroutine get_key(scene, key, text, error)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: key
    character(len=:), allocatable, intent(out) :: text
    type(error_t), allocatable, intent(inout) :: error
    type(scene_t), target :: copy
    type(schema_t) :: table
    type(entry_t) :: component
    character(len=:), allocatable :: problem
    integer :: i, subscript
    copy = scene
    text = ''
    call locate(copy, key, table, i, subscript, problem)
    if (allocated(problem)) then
      call fail(error, exit_input, trim(key)//': '//problem)
    else if (subscript == 0) then
      text = table%entries(i)%text()
    else
      component = table%entries(i)
      component%count = 1
      if (associated(component%real_1)) component%real_0 => table%entries(i)%real_1(subscript)
      if (associated(component%integer_1)) component%integer_0 => table%entries(i)%integer_1(subscript)
      component%real_1 => null()
      component%integer_1 => null()
      text = component%text()
    end if
  end subroutine get_key

  !> Find a key: the table it stands in, its entry and its component.
  subroutine locate(scene, key, table, i, subscript, problem)
    type(scene_t), target, intent(inout) :: scene
    character(len=*), intent(in) :: key
    type(schema_t), intent(out) :: table
    integer, intent(out) :: i, subscript
    character(len=:), allocatable, intent(out) :: problem
    type(key_reference_t) :: reference
    integer :: part
    i = 0
    subscript = 0
    call split_key(key, reference, problem)
    if (allocated(problem)) return
    if (.not. is_one_of(reference%group, scene_groups)) then
      problem = 'there is no group &'//reference%group//did_you_mean(reference%group, scene_groups)
      return
    end if
    if (reference%group == 'part') then
      if (.not. allocated(scene%parts)) allocate (scene%parts(0))
      part = reference%instance
      if (part == 0 .and. size(scene%parts) == 1) part = 1
      if (part < 1 .or. part > size(scene%parts)) then
        problem = 'the scene has '//to_text(size(scene%parts))//' &part groups; name one as part(1)/...'
        return
      end if
      call part_table(scene%parts(part), part, table)
    else
      if (reference%instance > 0) then
        problem = 'only &part is repeated; write '//reference%group//'/'//reference%key
        return
      end if
      call allocate_group(scene, reference%group)
      call scene_table(scene, table)
      if (table%groups(table%find_group(reference%group))%pending) then
        problem = '&'//reference%group//' is not available yet'
        return
      end if
    end if
    i = table%find(reference%group, reference%key)
    subscript = reference%subscript
    if (i == 0) then
      problem = 'there is no key '//reference%key//' in &'//reference%group// &
        did_you_mean(reference%key, table%keys_of(reference%group))
    else if (subscript > max(1, table%entries(i)%count) .or. (subscript > 0 .and. table%entries(i)%count < 2)) then
      problem = 'index ('//to_text(subscript)//') on a key that holds '//table%entries(i)%allowed()
    end if
  end subroutine locate

end module castnet_scene_schema
