!> Groups of a parsed file into the places of a schema table, with every problem told.
module castnet_schema_fill
  use castnet_namelist, only: group_t, item_t
  use castnet_problems, only: problem_list_t
  use castnet_scene_schema, only: groups_with_key, scene_groups
  use castnet_schema, only: schema_t
  use castnet_schema_entry, only: entry_t, most_components
  use castnet_text, only: to_text, did_you_mean, is_one_of
  implicit none
  private
  public :: fill_group, claim_group, tell

contains

  !> Note that a group is there; the same group twice in one file is a problem.
  subroutine claim_group(path, group, level, table, problems, repeated)
    character(len=*), intent(in) :: path
    type(group_t), intent(in) :: group
    integer, intent(in) :: level
    type(schema_t), intent(inout) :: table
    type(problem_list_t), intent(inout) :: problems
    logical, intent(out) :: repeated
    integer :: i
    repeated = .false.
    i = table%find_group(group%name)
    if (i == 0) return
    associate (g => table%groups(i))
      if (g%present .and. g%level == level) then
        call problems%add(path, group%line, group%name, 'the group is repeated; it stands on line '//to_text(g%line)//' already')
        repeated = .true.
        return
      end if
      g%present = .true.
      g%level = level
      g%line = group%line
      g%path = path
    end associate
  end subroutine claim_group

  !> The keys of one group. `level`: number of the file in the chain of includes.
  subroutine fill_group(path, group, level, table, problems)
    character(len=*), intent(in) :: path
    type(group_t), intent(in) :: group
    integer, intent(in) :: level
    type(schema_t), intent(inout) :: table
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: about
    integer :: i, k
    about = group%name
    if (table%label > 0) then
      about = about//'('//to_text(table%label)//')'
      table%groups(1)%present = .true.
      table%groups(1)%line = group%line
      table%groups(1)%path = path
    end if
    do i = 1, group%n
      if (problems%is_full()) return
      k = table%find(group%name, group%items(i)%key)
      if (k == 0) then
        call problems%add(path, group%items(i)%line, about//'/'//group%items(i)%key, &
                          'there is no such key'//suggestion(table, group%name, group%items(i)%key))
      else
        call fill_entry(path, about, group%items(i), level, table%entries(k), problems)
      end if
    end do
  end subroutine fill_group

  subroutine fill_entry(path, about, item, level, entry, problems)
    character(len=*), intent(in) :: path, about
    type(item_t), intent(in) :: item
    integer, intent(in) :: level
    type(entry_t), intent(inout) :: entry
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: problem
    if (is_repeated(item, level, entry)) then
      call problems%add(path, item%line, about//'/'//item%key, 'the key is repeated; it stands on line '// &
                        to_text(entry%line)//' already')
      return
    end if
    if (entry%level /= level .or. item%subscript == 0) entry%part_given = .false.
    entry%given = .true.
    entry%level = level
    entry%line = item%line
    entry%path = path
    if (item%subscript > 0 .and. item%subscript <= most_components) entry%part_given(item%subscript) = .true.
    entry%failed = any(item%values(:item%n)%broken)  ! told by the parser
    if (entry%failed) return
    call entry%set(item, problem)
    entry%failed = allocated(problem)
    if (allocated(problem)) call problems%add(path, item%line, about//'/'//item%key, problem)
  end subroutine fill_entry

  !> Given before in the same file: the whole key, or this component of it.
  logical function is_repeated(item, level, entry)
    type(item_t), intent(in) :: item
    integer, intent(in) :: level
    type(entry_t), intent(in) :: entry
    is_repeated = .false.
    if (.not. entry%given .or. entry%level /= level) return
    if (item%subscript == 0 .or. .not. any(entry%part_given)) then
      is_repeated = .true.
    else if (item%subscript <= most_components) then
      is_repeated = entry%part_given(item%subscript)
    end if
  end function is_repeated

  !> A key like it in this group, or the groups that have a key of this name.
  function suggestion(table, group, key) result(text)
    type(schema_t), intent(in) :: table
    character(len=*), intent(in) :: group, key
    character(len=:), allocatable :: text, others
    text = did_you_mean(key, table%keys_of(group))
    if (len(text) == 0 .and. is_one_of(group, scene_groups)) then
      others = groups_with_key(key)
      if (len(others) > 0) text = '; it is a key of '//others
    end if
    text = text//' (allowed: '//table%keys_of(group)//')'
  end function suggestion

  !> Tell about 'group/key' at the line where it was said, or where its group starts.
  subroutine tell(list, path, table, last_line, group, key, text)
    type(problem_list_t), intent(inout) :: list
    character(len=*), intent(in) :: path, group, key, text
    type(schema_t), intent(in) :: table
    integer, intent(in) :: last_line
    character(len=:), allocatable :: about
    integer :: i
    about = group
    if (table%label > 0) about = group//'('//to_text(table%label)//')'
    if (len(key) > 0) about = about//'/'//key
    i = table%find(group, key)
    if (i > 0) then
      if (table%entries(i)%given) then
        call list%add(table%entries(i)%path, table%entries(i)%line, about, text)
        return
      end if
    end if
    i = table%find_group(group)
    if (i > 0) then
      if (allocated(table%groups(i)%path)) then
        call list%add(table%groups(i)%path, table%groups(i)%line, about, text)
        return
      end if
    end if
    call list%add(path, last_line, about, text)
  end subroutine tell

end module castnet_schema_fill
