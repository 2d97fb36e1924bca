!> The reference of every group and key, from the schema tables: for a terminal and as a page.
module castnet_reference
  use castnet_scene, only: scene_t
  use castnet_scene_text, only: full_table
  use castnet_schema, only: schema_t
  use castnet_schema_entry, only: entry_t
  use castnet_study_request, only: study_request_t
  use castnet_study_schema, only: study_table, vary_table
  implicit none
  private
  public :: reference_text, reference_markdown

  character(len=1), parameter :: nl = new_line('a')

contains

  !> The reference for a terminal.
  function reference_text() result(text)
    character(len=:), allocatable :: text
    type(scene_t), target :: scene
    type(study_request_t), target :: request
    type(schema_t) :: table, part
    integer :: i
    call full_table(scene, table, part)
    text = 'Scene files: namelist groups. SI units, angles in degrees, rates in rad/s. A group that is left'//nl// &
           'out is not modelled. &include file = ''base.nml'' / takes keys from another file; own keys win.'//nl
    do i = 1, table%n_group
      text = text//group_reference(table, i)
      if (table%groups(i)%name == 'target') text = text//group_reference(part, 1)
    end do
    text = text//nl//'Study files: which keys of a scene are varied, and what is asked.'//nl
    call full_study_table(request, table, part)
    do i = 1, table%n_group
      text = text//group_reference(table, i)
      if (table%groups(i)%name == 'study') text = text//group_reference(part, 1)
    end do
  end function reference_text

  !> The tables of every key of a study.
  subroutine full_study_table(request, table, vary)
    type(study_request_t), target, intent(inout) :: request
    type(schema_t), intent(out) :: table, vary
    allocate (request%vary(1), request%search)
    call study_table(request, table)
    call vary_table(request%vary(1), 0, vary)
  end subroutine full_study_table

  function group_reference(table, group) result(text)
    type(schema_t), intent(in) :: table
    integer, intent(in) :: group
    character(len=:), allocatable :: text
    integer :: i
    associate (g => table%groups(group))
      text = nl//'&'//trim(g%name)//'  '//trim(g%help)
      if (g%required) text = text//' Required.'
      if (g%pending) text = text//' Not available yet.'
      text = text//nl
      do i = 1, table%n
        associate (e => table%entries(i))
          if (e%group /= g%name) cycle
          text = text//'  '//e%key(:25)//' '//e%allowed()//'; '//default_text(e)//nl// &
                 repeat(' ', 28)//trim(e%help)//nl
        end associate
      end do
    end associate
  end function group_reference

  !> 'default X', 'required', 'required when ...', or 'optional'.
  function default_text(e) result(text)
    type(entry_t), intent(in) :: e
    character(len=:), allocatable :: text
    if (e%need == 'always') then
      text = 'required'
    else if (e%need == 'unless fixed') then
      text = 'required unless fixed'
    else if (e%need == 'shape has dimensions') then
      text = 'required for solids'
    else if (e%need == 'law is compliant') then
      text = 'required for compliant laws'
    else if (len_trim(e%need) > 0) then
      text = 'required when '//trim(e%need)
    else if (len_trim(e%fallback) > 0) then
      text = 'default '//trim(e%fallback)
    else if (len_trim(e%initial) > 0) then
      text = 'default '//trim(e%initial)
    else
      text = 'optional'
    end if
  end function default_text

  !> The same as a page of Markdown tables.
  function reference_markdown() result(text)
    character(len=:), allocatable :: text
    type(scene_t), target :: scene
    type(study_request_t), target :: request
    type(schema_t) :: table, part
    integer :: i
    call full_table(scene, table, part)
    text = '# Scene reference'//nl//nl// &
           'Written by `castnet schema --markdown` from the table that the program reads scenes by.'//nl//nl// &
           'A scene is a file of namelist groups. Units are SI, angles are in degrees, rates in rad/s. A group that a scene'//nl// &
           'leaves out is not modelled and costs nothing. Paths are seen from the scene''s folder.'//nl//nl// &
           '`&include file = ''base.nml'' /` takes the keys of another file; the including file''s own keys win,'//nl// &
           'and its `&part` groups replace those included.'//nl
    do i = 1, table%n_group
      text = text//group_markdown(table, i)
      if (table%groups(i)%name == 'target') text = text//group_markdown(part, 1)
    end do
    text = text//nl//'# Study files'//nl//nl//'Which keys of a scene are varied, and what is asked. Paths are seen from the'//nl// &
           'study''s folder.'//nl
    call full_study_table(request, table, part)
    do i = 1, table%n_group
      text = text//group_markdown(table, i)
      if (table%groups(i)%name == 'study') text = text//group_markdown(part, 1)
    end do
  end function reference_markdown

  function group_markdown(table, group) result(text)
    type(schema_t), intent(in) :: table
    integer, intent(in) :: group
    character(len=:), allocatable :: text
    integer :: i
    associate (g => table%groups(group))
      text = nl//'## `&'//trim(g%name)//'`'//nl//nl//trim(g%help)
      if (g%required) text = text//' Required.'
      if (g%pending) text = text//' Not available yet.'
      text = text//nl//nl//'| key | allowed | default | meaning |'//nl//'|---|---|---|---|'//nl
      do i = 1, table%n
        associate (e => table%entries(i))
          if (e%group /= g%name) cycle
          text = text//'| `'//trim(e%key)//'` | '//e%allowed()//' | '//default_cell(e)//' | '//trim(e%help)//' |'//nl
        end associate
      end do
    end associate
  end function group_markdown

  function default_cell(e) result(text)
    type(entry_t), intent(in) :: e
    character(len=:), allocatable :: text
    text = default_text(e)
    if (index(text, 'default ') == 1) text = text(9:)
  end function default_cell

end module castnet_reference
