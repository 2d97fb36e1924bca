!> Scenes as text: the effective scene, which reads back to the same scene, and the
!> commented template of `castnet init`.
module castnet_scene_text
  use castnet_scene, only: scene_t, part_group_t
  use castnet_scene_schema, only: scene_table, part_table, allocate_all_groups
  use castnet_schema, only: schema_t
  use castnet_schema_entry, only: entry_t, kind_word
  use castnet_text, only: to_text, quoted
  implicit none
  private
  public :: effective_scene, scene_template, full_table, group_text

  character(len=1), parameter :: nl = new_line('a')

contains

  !> Every group of a scene with every key that has a value; keys without one as comments.
  function effective_scene(scene) result(text)
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: text
    type(scene_t), target :: copy
    type(schema_t) :: table
    integer :: i, k
    copy = scene
    call scene_table(copy, table)
    text = ''
    do i = 1, table%n_group
      text = text//group_text(table, i)
      if (table%groups(i)%name == 'target' .and. allocated(copy%parts)) text = text//parts_text(copy%parts)
    end do
    if (allocated(copy%parts) .and. .not. allocated(copy%target)) text = text//parts_text(copy%parts)
    k = len(text)
    if (k > 1) text = text(:k - 1)
  end function effective_scene

  function parts_text(parts) result(text)
    type(part_group_t), target, intent(inout) :: parts(:)
    character(len=:), allocatable :: text
    type(schema_t) :: table
    integer :: i
    text = ''
    do i = 1, size(parts)
      call part_table(parts(i), i, table)
      text = text//group_text(table, 1)
    end do
  end function parts_text

  function group_text(table, group) result(text)
    type(schema_t), intent(in) :: table
    integer, intent(in) :: group
    character(len=:), allocatable :: text, value
    integer :: i
    text = '&'//trim(table%groups(group)%name)//nl
    do i = 1, table%n
      associate (e => table%entries(i))
        if (e%group /= table%groups(group)%name) cycle
        value = e%text()
        if (len(value) > 0) then
          text = text//'  '//trim(e%key)//' = '//value//nl
        else
          text = text//'  ! '//trim(e%key)//': '//trim(absent(e))//nl
        end if
      end associate
    end do
    text = text//'/'//nl//nl
  end function group_text

  !> What a key without a value means.
  function absent(e) result(text)
    type(entry_t), intent(in) :: e
    character(len=:), allocatable :: text
    text = 'not set'
    if (len_trim(e%fallback) > 0) text = trim(e%fallback)
  end function absent

  !> The table of every key, as in a scene with every group and one part.
  !> `scene` is what it is bound to, and must live as long.
  subroutine full_table(scene, table, part)
    type(scene_t), target, intent(inout) :: scene
    type(schema_t), intent(out) :: table, part
    call allocate_all_groups(scene)
    if (.not. allocated(scene%parts)) allocate (scene%parts(1))
    call scene_table(scene, table)
    call part_table(scene%parts(1), 0, part)
  end subroutine full_table

  !> A commented scene that runs: the cubesat of the paper. Optional groups and keys
  !> are there as comments.
  function scene_template() result(text)
    character(len=:), allocatable :: text
    type(scene_t), target :: scene
    type(schema_t) :: table, part
    integer :: i
    call full_table(scene, table, part)
    text = '! A net thrown at a tumbling three-unit cubesat. Every key there is stands here; what is commented'//nl// &
           '! out is optional, with its default. SI units, angles in degrees, rates in rad/s.'//nl// &
           '!   castnet check FILE    says what would run'//nl//'!   castnet run FILE      runs it'//nl
    do i = 1, table%n_group
      text = text//nl//template_group(table, i)
      if (table%groups(i)%name == 'target') text = text//nl//template_group(part, 1)
    end do
  end function scene_template

  function template_group(table, group) result(text)
    type(schema_t), intent(in) :: table
    integer, intent(in) :: group
    character(len=:), allocatable :: text, value, mark, line
    logical :: used
    integer :: i
    associate (g => table%groups(group))
      select case (g%name)
      case ('net', 'bullets', 'target', 'contact', 'time', 'output')
        used = .true.
      case default
        used = .false.
      end select
      text = '! '//trim(g%help)//nl
      if (g%pending) text = '! '//trim(g%help)//' Not available yet.'//nl
      mark = trim(merge('!', ' ', .not. used))
      text = text//mark//'&'//trim(g%name)//nl
      do i = 1, table%n
        associate (e => table%entries(i))
          if (e%group /= g%name) cycle
          value = example(trim(e%group)//'/'//trim(e%key))
          mark = '  '
          if (len(value) == 0 .or. .not. used) mark = '! '
          if (len(value) == 0) value = trim(e%initial)
          if (len(value) == 0) value = '('//absent(e)//')'
          line = mark//trim(e%key)//' = '//value
          if (len(line) < 38) line = line//repeat(' ', 38 - len(line))
          text = text//line//'  ! '//remark(e)//nl
        end associate
      end do
      text = text//trim(merge('!', ' ', .not. used))//'/'//nl
    end associate
  end function template_group

  !> Meaning, unit and words of a key, for the end of its line.
  function remark(e) result(text)
    type(entry_t), intent(in) :: e
    character(len=:), allocatable :: text
    text = trim(e%help)
    if (e%kind == kind_word) text = text//': '//e%allowed()
    if (len_trim(e%unit) > 0 .and. e%unit /= '-') text = '['//trim(e%unit)//'] '//text
    if (e%only_zero) text = text//' (not available yet)'
  end function remark

  !> Values of the template's scene (the paper's Table 2, long axis along the approach).
  pure function example(key) result(value)
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: value
    select case (key)
    case ('net/kind')
      value = '''square'''
    case ('net/squares')
      value = '10, 10'
    case ('net/mesh_length')
      value = '0.07'
    case ('net/cable_diameter')
      value = '0.001'
    case ('net/edge_cable_diameter')
      value = '0.003'
    case ('bullets/mass')
      value = '0.03'
    case ('bullets/speed')
      value = '1.8'
    case ('bullets/angle')
      value = '25'
    case ('target/shape')
      value = '''box'''
    case ('target/dimensions')
      value = '0.1, 0.1, 0.3'
    case ('target/mass')
      value = '3.5'
    case ('target/position')
      value = '1.4, 0, 0'
    case ('target/attitude')
      value = '0.70710678, 0, 0.70710678, 0'
    case ('target/angular_velocity')
      value = '0, 1.5, 0'
    case ('contact/threshold')
      value = '0.002'
    case ('time/end_time')
      value = '3'
    case ('time/step')
      value = '5e-5'
    case ('part/shape')
      value = '''box'''
    case ('part/dimensions')
      value = '0.1, 0.1, 0.3'
    case ('closing/winch_speed')
      value = '20'
    case ('closing/locked_length')
      value = '0.5'
    case ('closing/max_tension')
      value = '100'
    case default
      value = ''
    end select
  end function example

end module castnet_scene_text
