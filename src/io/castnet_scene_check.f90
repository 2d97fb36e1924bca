!> What keys of a scene mean to each other: required keys, contradictions, sizes; then
!> the defaults that follow from other keys.
module castnet_scene_check
  use castnet_error, only: error_t, fail, exit_input
  use castnet_kinds, only: wp
  use castnet_posix, only: physical_memory
  use castnet_problems, only: problem_list_t
  use castnet_scene, only: scene_t, is_set
  use castnet_scene_schema, only: scene_table, part_table
  use castnet_schema, only: schema_t
  use castnet_schema_entry, only: entry_t
  use castnet_schema_fill, only: tell
  use castnet_text, only: to_text, byte_text, path_beside, name_of, without_extension, quoted
  use castnet_text_file, only: file_exists
  implicit none
  private
  public :: check_scene, resolve_scene, finish_scene, place_of_scene_t, net_node_count

  !> Where things were said, for the messages: the table of the scene, one per &part,
  !> and the last line of the scene's file for what was never said.
  type :: place_of_scene_t
    type(schema_t) :: table
    type(schema_t), allocatable :: parts(:)
    integer :: last_line = 0
  end type place_of_scene_t

  real(wp), parameter :: bytes_per_node = 1200.0_wp   !! state, stages, cables, incidence
  real(wp), parameter :: always_there = 1.0e9_wp      !! not worth asking the machine [bytes]
  real(wp), parameter :: most_steps = 1.0e13_wp, most_frames = 1.0e8_wp, most_rows = 1.0e9_wp

contains

  !> Check and complete a scene whose values were set one by one (a case of a study).
  !> Messages name keys without lines.
  subroutine finish_scene(scene, warnings, error)
    type(scene_t), target, intent(inout) :: scene
    type(problem_list_t), intent(inout) :: warnings
    type(error_t), allocatable, intent(inout) :: error
    type(place_of_scene_t) :: place
    type(problem_list_t) :: problems
    integer :: i
    if (.not. allocated(scene%path)) scene%path = 'scene.nml'
    call scene_table(scene, place%table)
    if (allocated(scene%parts)) then
      allocate (place%parts(size(scene%parts)))
      do i = 1, size(scene%parts)
        call part_table(scene%parts(i), i, place%parts(i))
      end do
    end if
    call check_scene(scene, place, problems, warnings)
    if (problems%n > 0) then
      call fail(error, exit_input, problems%report())
    else
      call resolve_scene(scene)
    end if
  end subroutine finish_scene

  !> Every problem between keys. The table must be bound to this scene.
  subroutine check_scene(scene, place, problems, warnings)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    integer :: i
    call check_needs(scene, scene%path, place%table, place%last_line, problems, warnings)
    if (allocated(place%parts)) then
      do i = 1, size(place%parts)
        call check_needs(scene, scene%path, place%parts(i), place%last_line, problems, warnings)
      end do
    end if
    call check_groups(scene, place, problems, warnings)
    if (allocated(scene%net)) call check_net(scene, place, problems)
    if (allocated(scene%target)) call check_target(scene, place, problems, warnings)
    if (allocated(scene%parts)) call check_parts(scene, place, problems, warnings)
    call check_times(scene, place, problems, warnings)
  end subroutine check_scene

  !> Missing keys, half-given arrays, keys without effect.
  subroutine check_needs(scene, path, table, last_line, problems, warnings)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: path
    type(schema_t), intent(in) :: table
    integer, intent(in) :: last_line
    type(problem_list_t), intent(inout) :: problems, warnings
    integer :: i
    do i = 1, table%n
      associate (e => table%entries(i))
        if (len_trim(e%need) > 0 .and. .not. e%failed .and. .not. e%has_value() .and. .not. is_begun(e)) then
          if (is_missing_group(table, trim(e%group))) then
            call tell(problems, path, table, last_line, trim(e%group), '', 'the group &'//trim(e%group)// &
                      ' is missing; required, with '//trim(e%key))
          else if (holds(scene, trim(e%need))) then
            call tell(problems, path, table, last_line, trim(e%group), trim(e%key), &
                      'missing; required'//condition_text(trim(e%need))//': '//trim(e%help)//', '//e%allowed())
          end if
        else if (e%is_array() .and. associated(e%real_1)) then
          if (any(is_set(e%real_1)) .and. len(e%text()) == 0) &
            call tell(problems, path, table, last_line, trim(e%group), trim(e%key), &
                      'only some components are given; allowed: '//e%allowed())
          if (len(e%text()) > 0 .and. count(is_set(e%real_1)) < e%least) &
            call tell(problems, path, table, last_line, trim(e%group), trim(e%key), &
                      'seen '//to_text(count(is_set(e%real_1)))//' of its components; allowed: '//e%allowed())
        end if
        if (len_trim(e%use) > 0 .and. e%given) then
          if (.not. holds(scene, trim(e%use))) call tell(warnings, path, table, last_line, trim(e%group), trim(e%key), &
            'has no effect here: it is used only'//condition_text(trim(e%use)))
        end if
      end associate
    end do
  end subroutine check_needs

  !> An array with some components.
  logical function is_begun(e)
    type(entry_t), intent(in) :: e
    is_begun = .false.
    if (associated(e%real_1)) is_begun = any(is_set(e%real_1))
  end function is_begun

  !> A required group that the file does not have.
  logical function is_missing_group(table, name)
    type(schema_t), intent(in) :: table
    character(len=*), intent(in) :: name
    integer :: i
    i = table%find_group(name)
    is_missing_group = table%groups(i)%required .and. .not. table%groups(i)%present
  end function is_missing_group

  !> The conditions that the schema names.
  logical function holds(scene, condition)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: condition
    holds = .false.
    select case (condition)
    case ('always')
      holds = .true.
    case ('kind = ''square''')
      holds = scene%net%kind == 'square'
    case ('kind = ''file''')
      holds = scene%net%kind == 'file'
    case ('unless fixed')
      holds = .not. scene%target%fixed
    case ('shape has dimensions')
      holds = dimensions_of(scene%target%shape) > 0
    case ('shape = ''mesh''')
      holds = scene%target%shape == 'mesh'
    case ('law = ''impulse''')
      holds = scene%contact%law == 'impulse'
    case ('law is compliant')
      holds = scene%contact%law == 'penalty' .or. scene%contact%law == 'hunt_crossley'
    case ('method = ''adaptive''')
      holds = scene%time%method == 'adaptive'
    end select
  end function holds

  pure function condition_text(condition) result(text)
    character(len=*), intent(in) :: condition
    character(len=:), allocatable :: text
    select case (condition)
    case ('always')
      text = ''
    case ('unless fixed')
      text = ' unless fixed = .true.'
    case ('shape has dimensions')
      text = ' for a box, cylinder, sphere or capsule'
    case ('law is compliant')
      text = ' for the laws ''penalty'' and ''hunt_crossley'''
    case default
      text = ' when '//condition
    end select
  end function condition_text

  !> Which groups go together.
  subroutine check_groups(scene, place, problems, warnings)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    logical :: net, target
    integer :: i
    net = allocated(scene%net)
    target = allocated(scene%target)
    do i = 1, place%table%n_group
      associate (g => place%table%groups(i))
        if (g%pending) call problem(g%name, '', 'the group &'//trim(g%name)//' is not available yet')
      end associate
    end do
    if (.not. net .and. .not. target) call problems%add(scene%path, place%last_line, '', &
      'the scene has neither &net nor &target: there is nothing to move')
    if (allocated(scene%bullets)) then
      if (.not. net) then
        call problem('bullets', '', 'bullets without a &net; they hang on its corners')
      else if (scene%net%kind == 'file') then
        call problem('bullets', '', 'bullets need a net of kind = ''square''; in a net from a file they are nodes like others')
      end if
    end if
    if (allocated(scene%contact)) then
      if (scene%contact%law /= 'impulse' .and. scene%contact%detect == 'cables') call problem('contact', 'detect', &
        'seen ''cables'' with law = '''//trim(scene%contact%law)//'''; springs act on nodes only: '// &
        'give detect = ''nodes'' or law = ''impulse''')
      if (scene%contact%law /= 'impulse' .and. scene%contact%self_contact /= 'none' .and. &
          scene%contact%self_contact /= 'count') call problem('contact', 'self_contact', &
        'seen '//quoted(trim(scene%contact%self_contact))//' with law = '//quoted(trim(scene%contact%law))// &
        '; cables are held apart by impulses only: give self_contact = ''count'' or law = ''impulse''')
    end if
    if (allocated(scene%contact) .and. .not. (net .and. target)) call problem('contact', '', &
      'contact needs both a &net and a &target; there is no &'//trim(merge('net   ', 'target', .not. net)))
    if (net .and. target .and. .not. allocated(scene%contact)) call warnings%add(scene%path, place%last_line, '', &
      'net and target, but no &contact: they pass through each other')
    if (allocated(scene%closing)) then
      if (.not. allocated(scene%bullets)) call problem('closing', '', 'closing without &bullets; the winches sit in them')
      if (scene%closing%trigger /= 'time' .and. .not. target) call problem('closing', 'trigger', &
        'seen '//quoted(trim(scene%closing%trigger))//' without a &target; allowed then: ''time''')
      if (scene%closing%trigger == 'contact' .and. target .and. .not. allocated(scene%contact)) &
        call problem('closing', 'trigger', 'seen ''contact'' without a &contact group; allowed then: ''time'', ''passed_target''')
      if (net .and. is_set(scene%closing%locked_length)) then
        if (is_set(scene%net%mesh_length) .and. minval(scene%net%squares) > 0) then
          if (scene%closing%locked_length >= minval(scene%net%squares)*scene%net%mesh_length) &
            call tell(warnings, scene%path, place%table, place%last_line, 'closing', 'locked_length', &
              'seen '//to_text(scene%closing%locked_length)//', not less than a side of the net: nothing is drawn shut')
        end if
      end if
    end if
  contains
    subroutine problem(group, key, text)
      character(len=*), intent(in) :: group, key, text
      call tell(problems, scene%path, place%table, place%last_line, trim(group), key, text)
    end subroutine problem
  end subroutine check_groups

  !> Sizes that no machine holds, and a file that is not there.
  subroutine check_net(scene, place, problems)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: path
    real(wp) :: nodes, need, memory
    if (scene%net%kind == 'file') then
      if (len_trim(scene%net%file) == 0) return
      path = path_beside(scene%path, trim(scene%net%file))
      if (.not. file_exists(path)) call tell(problems, scene%path, place%table, place%last_line, 'net', 'file', &
        'seen '//quoted(trim(scene%net%file))//'; there is no file '//path)
    else if (minval(scene%net%squares) > 0) then
      nodes = net_node_count(scene)
      need = bytes_per_node*nodes
      if (need < always_there) return
      memory = real(physical_memory(), wp)
      if (need > memory .or. nodes > 5.0e8_wp) call tell(problems, scene%path, place%table, place%last_line, 'net', 'squares', &
        'seen '//to_text(scene%net%squares(1))//' x '//to_text(scene%net%squares(2))//' squares with '// &
        to_text(scene%net%cables_per_side)//' cables a side: about '//byte_text(need)//' of memory; this machine has '// &
        byte_text(memory))
    end if
  end subroutine check_net

  !> Nodes of a square net, bullets included. Real, because absurd nets overflow integers.
  pure real(wp) function net_node_count(scene) result(nodes)
    type(scene_t), intent(in) :: scene
    real(wp) :: a, b
    a = real(scene%net%squares(1), wp)
    b = real(scene%net%squares(2), wp)
    nodes = (a + 1)*(b + 1) + (a*(b + 1) + b*(a + 1))*(scene%net%cables_per_side - 1)
    if (allocated(scene%bullets)) nodes = nodes + 4
  end function net_node_count

  subroutine check_target(scene, place, problems, warnings)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    character(len=:), allocatable :: path
    associate (t => scene%target)
      call check_dimensions(t%shape, t%dimensions, place%table, scene%path, place%last_line, 'target', problems)
      call check_quaternion(t%attitude, place%table, scene%path, place%last_line, 'target', problems, warnings)
      if (all(is_set(t%phase_axis))) then
        if (all(t%phase_axis == 0.0_wp)) call tell(problems, scene%path, place%table, place%last_line, 'target', 'phase_axis', &
          'seen an axis of no length; allowed: any other, it is normalised')
      else if (t%phase /= 0.0_wp .and. all(t%angular_velocity == 0.0_wp)) then
        call tell(problems, scene%path, place%table, place%last_line, 'target', 'phase', &
                  'seen '//to_text(t%phase)//' for a body that does not turn; give phase_axis')
      end if
      if (all(is_set(t%inertia))) then
        if (.not. is_inertia(t%inertia)) call tell(problems, scene%path, place%table, place%last_line, 'target', 'inertia', &
          'no body has this tensor; allowed: xx yy zz xy xz yz, positive definite, no principal moment above the sum '// &
          'of the other two')
      end if
      if (t%shape == 'compound' .and. .not. allocated(scene%parts)) &
        call tell(problems, scene%path, place%table, place%last_line, 'target', 'shape', &
                  'seen ''compound'' without any &part group; give one for each solid')
      if (t%fixed .and. (any(t%velocity /= 0.0_wp) .or. any(t%angular_velocity /= 0.0_wp))) &
        call tell(warnings, scene%path, place%table, place%last_line, 'target', 'fixed', &
                  'a fixed target does not move: its velocity and angular_velocity are taken as 0')
      if (t%shape == 'mesh' .and. len_trim(t%file) > 0) then
        path = path_beside(scene%path, trim(t%file))
        if (.not. file_exists(path)) call tell(problems, scene%path, place%table, place%last_line, 'target', 'file', &
          'seen '//quoted(trim(t%file))//'; there is no file '//path)
      end if
    end associate
  end subroutine check_target

  subroutine check_parts(scene, place, problems, warnings)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    logical :: compound
    integer :: i
    compound = .false.
    if (allocated(scene%target)) compound = scene%target%shape == 'compound' .or. len_trim(scene%target%shape) == 0
    do i = 1, size(scene%parts)
      if (.not. compound) call tell(problems, scene%path, place%parts(i), place%last_line, 'part', '', &
        'a part belongs to a &target with shape = ''compound''')
      call check_dimensions(scene%parts(i)%shape, scene%parts(i)%dimensions, place%parts(i), scene%path, &
                            place%last_line, 'part', problems)
      call check_quaternion(scene%parts(i)%attitude, place%parts(i), scene%path, place%last_line, 'part', problems, warnings)
    end do
  end subroutine check_parts

  !> As many dimensions as the shape has.
  subroutine check_dimensions(shape, dimensions, table, path, last_line, group, problems)
    character(len=*), intent(in) :: shape, path, group
    real(wp), intent(in) :: dimensions(3)
    type(schema_t), intent(in) :: table
    integer, intent(in) :: last_line
    type(problem_list_t), intent(inout) :: problems
    integer :: seen, wanted
    seen = count(is_set(dimensions))
    if (.not. all(is_set(dimensions(:seen)))) return      ! told already: only some components
    wanted = dimensions_of(shape)
    if (seen == 0 .or. wanted <= 0 .or. seen == wanted) return
    call tell(problems, path, table, last_line, group, 'dimensions', 'seen '//to_text(seen)//' value'// &
              trim(merge('s', ' ', seen > 1))//'; allowed: '//to_text(wanted)//' for a '//trim(shape))
  end subroutine check_dimensions

  pure integer function dimensions_of(shape)
    character(len=*), intent(in) :: shape
    select case (shape)
    case ('box')
      dimensions_of = 3
    case ('cylinder', 'capsule')
      dimensions_of = 2
    case ('sphere')
      dimensions_of = 1
    case default
      dimensions_of = 0
    end select
  end function dimensions_of

  subroutine check_quaternion(q, table, path, last_line, group, problems, warnings)
    real(wp), intent(in) :: q(4)
    type(schema_t), intent(in) :: table
    character(len=*), intent(in) :: path, group
    integer, intent(in) :: last_line
    type(problem_list_t), intent(inout) :: problems, warnings
    real(wp) :: length
    if (.not. all(is_set(q))) return
    length = sqrt(q(1)**2 + q(2)**2 + q(3)**2 + q(4)**2)
    if (length < 1.0e-6_wp) then
      call tell(problems, path, table, last_line, group, 'attitude', &
                'seen a quaternion of length '//to_text(length)//'; allowed: any other, it is normalised')
    else if (abs(length - 1.0_wp) > 1.0e-3_wp) then
      call tell(warnings, path, table, last_line, group, 'attitude', &
                'has length '//to_text(length)//' and is normalised to 1')
    end if
  end subroutine check_quaternion

  !> Can a body have this inertia? With J = tr(I)/2 - I, the second moments of mass:
  !> J positive semidefinite (the triangle inequality on the principal moments), I positive definite.
  pure logical function is_inertia(entries)
    real(wp), intent(in) :: entries(6)  !! xx yy zz xy xz yz
    real(wp), parameter :: slack = 1.0e-9_wp
    real(wp) :: s(6), half
    half = 0.5_wp*(entries(1) + entries(2) + entries(3))
    is_inertia = .false.
    if (.not. half > 0.0_wp) return
    s = entries/half
    if (any(abs(s) > 2.0_wp)) return
    is_inertia = smallest_minors([1.0_wp - s(1), 1.0_wp - s(2), 1.0_wp - s(3), -s(4), -s(5), -s(6)]) >= -slack .and. &
                 smallest_minors(s) > slack*slack
  end function is_inertia

  !> Smallest principal minor of a symmetric 3 x 3 matrix: negative unless it is semidefinite.
  pure real(wp) function smallest_minors(a) result(least)
    real(wp), intent(in) :: a(6)
    least = min(a(1), a(2), a(3), a(1)*a(2) - a(4)**2, a(1)*a(3) - a(5)**2, a(2)*a(3) - a(6)**2, &
                a(1)*(a(2)*a(3) - a(6)**2) - a(4)*(a(4)*a(3) - a(6)*a(5)) + a(5)*(a(4)*a(6) - a(2)*a(5)))
  end function smallest_minors

  !> Times against each other, and numbers of steps and rows that no run ends.
  subroutine check_times(scene, place, problems, warnings)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    real(wp) :: end_time, interval
    integer :: i
    end_time = scene%time%end_time
    call check_output_file(scene, place, problems)
    if (allocated(scene%output%verdict_times)) then
      associate (v => scene%output%verdict_times)
        do i = 2, size(v)
          if (v(i) > v(i - 1)) cycle
          call problem('output', 'verdict_times', 'seen '//to_text(v(i - 1))//' before '//to_text(v(i))//'; allowed: rising times')
          exit
        end do
        if (is_set(end_time) .and. any(v > end_time)) call problem('output', 'verdict_times', &
          'seen '//to_text(maxval(v))//'; allowed: at most end_time = '//to_text(end_time))
      end associate
      i = place%table%find('output', 'verdict_times')
      if (place%table%entries(i)%given .and. .not. (allocated(scene%net) .and. allocated(scene%target))) &
        call tell(warnings, scene%path, place%table, place%last_line, 'output', 'verdict_times', &
                  'has no effect here: capture is judged only with both a &net and a &target')
    end if
    if (.not. is_set(end_time)) return
    if (scene%time%step > end_time) call problem('time', 'step', &
      'seen '//to_text(scene%time%step)//'; allowed: at most end_time = '//to_text(end_time))
    if (scene%time%step > 0.0_wp) call check_number('time', 'step', scene%time%step, most_steps, 'steps')
    interval = scene%output%frame_interval
    if (is_set(interval)) call check_number('output', 'frame_interval', interval, most_frames, 'frames')
    interval = scene%output%history_interval
    if (is_set(interval)) call check_number('output', 'history_interval', interval, most_rows, 'rows')
    interval = scene%output%checkpoint_interval
    if (interval > 0.0_wp) call check_number('output', 'checkpoint_interval', interval, most_rows, 'checkpoints')
  contains
    subroutine problem(group, key, text)
      character(len=*), intent(in) :: group, key, text
      call tell(problems, scene%path, place%table, place%last_line, group, key, text)
    end subroutine problem

    subroutine check_number(group, key, interval, most, what)
      character(len=*), intent(in) :: group, key, what
      real(wp), intent(in) :: interval, most
      if (end_time/interval > most) call problem(group, key, 'seen '//to_text(interval)//', which makes '// &
        to_text(anint(end_time/interval))//' '//what//'; allowed: at most '//to_text(most))
    end subroutine check_number
  end subroutine check_times

  !> The results must not fall on what is read.
  subroutine check_output_file(scene, place, problems)
    type(scene_t), intent(in) :: scene
    type(place_of_scene_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: path, other
    path = path_beside(scene%path, trim(scene%output%file))
    if (len(path) == 0) path = without_extension(scene%path)//'.h5'
    other = ''
    if (path == scene%path) other = 'the scene itself'
    if (allocated(scene%net)) then
      if (len_trim(scene%net%file) > 0 .and. scene%net%kind == 'file') then
        if (path == path_beside(scene%path, trim(scene%net%file))) other = 'the file of the net'
      end if
    end if
    if (len(other) > 0) call tell(problems, scene%path, place%table, place%last_line, 'output', 'file', &
      'seen '//quoted(trim(scene%output%file))//', which would overwrite '//other//'; give another file')
    if (path(len(path):) == '/') call tell(problems, scene%path, place%table, place%last_line, 'output', 'file', &
      'seen '//quoted(trim(scene%output%file))//', a folder; allowed: a file')
  end subroutine check_output_file

  !> Defaults that follow from other keys. Does nothing to what is set already.
  subroutine resolve_scene(scene)
    type(scene_t), intent(inout) :: scene
    if (allocated(scene%net)) then
      if (scene%net%kind == 'square') call give(scene%net%edge_cable_diameter, scene%net%cable_diameter)
    end if
    if (allocated(scene%bullets)) call give(scene%bullets%corner_cable_length, sqrt(2.0_wp)*scene%net%mesh_length)
    if (allocated(scene%contact)) then
      if (scene%contact%law /= 'impulse') call give(scene%contact%damping, 0.0_wp)
    end if
    if (allocated(scene%target)) then
      if (scene%target%fixed) then
        scene%target%velocity = 0.0_wp
        scene%target%angular_velocity = 0.0_wp
      end if
    end if
    call give(scene%output%frame_interval, scene%time%end_time/100.0_wp)
    call give(scene%output%history_interval, scene%output%frame_interval/10.0_wp)
    if (.not. allocated(scene%output%verdict_times)) scene%output%verdict_times = [scene%time%end_time]
    if (len_trim(scene%output%file) == 0) scene%output%file = without_extension(name_of(scene%path))//'.h5'
  contains
    subroutine give(value, default)
      real(wp), intent(inout) :: value
      real(wp), intent(in) :: default
      if (.not. is_set(value)) value = default
    end subroutine give
  end subroutine resolve_scene

end module castnet_scene_check
