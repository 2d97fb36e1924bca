!> A scene from a file, or from text: the strict pass. Every problem of the file, of
!> the files that it includes and of the overrides is told in one go; a scene with a
!> problem is no scene. `&include file = 'base.nml' /` takes keys from another file;
!> the keys of the including file win, and its &part groups replace those included.
module castnet_scene_file
  use castnet_error, only: error_t, fail, exit_input
  use castnet_namelist, only: namelist_t, group_t, item_t, parse_namelist
  use castnet_problems, only: problem_list_t
  use castnet_scene, only: scene_t, part_group_t
  use castnet_scene_check, only: check_scene, resolve_scene, place_of_scene_t
  use castnet_scene_schema, only: scene_table, part_table, store_lists, scene_groups, split_key, key_reference_t, &
                                  parse_override_value, allocate_group
  use castnet_schema, only: schema_t
  use castnet_schema_fill, only: fill_group, claim_group
  use castnet_text, only: text_t, to_text, did_you_mean, is_one_of, path_beside, folder_of, quoted
  use castnet_text_file, only: read_text_file
  implicit none
  private
  public :: read_scene, read_scene_text

  integer, parameter :: deepest_include = 8
  integer, parameter :: most_parts = 1000

  !> One file of a chain of includes, base first.
  type :: source_t
    type(namelist_t) :: document
    character(len=:), allocatable :: path
    character(len=:), allocatable :: prefix   !! from the scene's folder to the file's
  end type source_t

  type :: source_list_t
    integer :: n = 0
    type(source_t), allocatable :: list(:)
  end type source_list_t

contains

  !> Read, check and complete a scene. `overrides`: texts 'group/key=value' that win over
  !> the file. `warnings`: lines for the user, '' if none. With `resolve` false the
  !> defaults that follow from other keys stay open (a study sets keys before).
  !> Errors: `exit_input` with every problem; `exit_file` when the file may not be read.
  subroutine read_scene(path, overrides, scene, warnings, error, resolve)
    character(len=*), intent(in) :: path
    type(text_t), intent(in) :: overrides(:)
    type(scene_t), intent(out) :: scene
    character(len=:), allocatable, intent(out) :: warnings
    type(error_t), allocatable, intent(inout) :: error
    logical, intent(in), optional :: resolve
    character(len=:), allocatable :: text
    warnings = ''
    call read_text_file(path, text, error)
    if (allocated(error)) return
    call read_scene_text(text, path, overrides, scene, warnings, error, resolve)
  end subroutine read_scene

  !> The same from text; `path` names it in messages, and says where its files are.
  subroutine read_scene_text(text, path, overrides, scene, warnings, error, resolve)
    character(len=*), intent(in) :: text, path
    type(text_t), intent(in) :: overrides(:)
    type(scene_t), intent(out) :: scene
    character(len=:), allocatable, intent(out) :: warnings
    type(error_t), allocatable, intent(inout) :: error
    logical, intent(in), optional :: resolve
    type(scene_t), target :: work
    type(problem_list_t) :: problems, notes
    type(source_list_t) :: sources
    type(place_of_scene_t) :: place
    warnings = ''
    work%path = path
    work%text = text
    allocate (sources%list(4))
    call gather(path, '', text, path//new_line('a'), 1, sources, problems)
    place%last_line = sources%list(sources%n)%document%last_line
    call note_included(sources, work)
    call allocate_groups(sources, overrides, work)
    call scene_table(work, place%table)
    call bind_parts(sources, work, place)
    call fill_scene(sources, place, problems)
    call apply_overrides(overrides, place, problems)
    call store_lists(place%table, work)
    call check_scene(work, place, problems, notes)
    warnings = notes%report()
    if (problems%n > 0) then
      call fail(error, exit_input, problems%report())
      return
    end if
    scene = work
    if (present(resolve)) then
      if (.not. resolve) return
    end if
    call resolve_scene(scene)
  end subroutine read_scene_text

  !> Paths of all files but the scene's own, which is the last.
  subroutine note_included(sources, scene)
    type(source_list_t), intent(in) :: sources
    type(scene_t), intent(inout) :: scene
    integer :: i
    if (sources%n == 1) return
    allocate (scene%included(sources%n - 1))
    do i = 1, sources%n - 1
      scene%included(i)%chars = sources%list(i)%path
    end do
  end subroutine note_included

  !> Parse a file and, before it, the files that it includes.
  recursive subroutine gather(path, prefix, text, chain, depth, sources, problems)
    character(len=*), intent(in) :: path, prefix, text
    character(len=*), intent(in) :: chain       !! files being read, one per line
    integer, intent(in) :: depth
    type(source_list_t), intent(inout) :: sources
    type(problem_list_t), intent(inout) :: problems
    type(source_t) :: source
    type(source_t), allocatable :: grown(:)
    integer :: i
    call parse_namelist(path, text, source%document, problems)
    source%path = path
    source%prefix = prefix
    do i = 1, source%document%n
      if (source%document%groups(i)%name == 'include') &
        call include_file(source%document%groups(i), path, prefix, chain, depth, sources, problems)
    end do
    if (sources%n == size(sources%list)) then
      allocate (grown(2*sources%n))
      grown(:sources%n) = sources%list
      call move_alloc(grown, sources%list)
    end if
    sources%n = sources%n + 1
    sources%list(sources%n) = source
  end subroutine gather

  !> One &include group.
  recursive subroutine include_file(group, path, prefix, chain, depth, sources, problems)
    type(group_t), intent(in) :: group
    character(len=*), intent(in) :: path, prefix, chain
    integer, intent(in) :: depth
    type(source_list_t), intent(inout) :: sources
    type(problem_list_t), intent(inout) :: problems
    type(error_t), allocatable :: error
    character(len=:), allocatable :: text, file, full
    integer :: i
    file = ''
    do i = 1, group%n
      associate (item => group%items(i))
        if (item%key /= 'file') then
          call problems%add(path, item%line, 'include/'//item%key, 'there is no such key; allowed: file'// &
                            did_you_mean(item%key, 'file'))
        else if (len(file) > 0 .or. item%n /= 1 .or. item%subscript > 0) then
          call problems%add(path, item%line, 'include/file', 'one file per &include; repeat the group for more')
        else if (.not. item%values(1)%broken) then
          file = item%values(1)%text
          if (.not. item%values(1)%is_string .or. len_trim(file) == 0) then
            call problems%add(path, item%line, 'include/file', 'seen '//file//'; allowed: a path in quotes')
            return
          end if
        else
          return
        end if
      end associate
    end do
    if (len(file) == 0) then
      call problems%add(path, group%line, 'include/file', 'missing; the file whose keys are taken')
      return
    end if
    full = path_beside(path, file)
    if (depth >= deepest_include) then
      call problems%add(path, group%line, 'include/file', 'more than '//to_text(deepest_include)//' files deep')
    else if (index(new_line('a')//chain, new_line('a')//full//new_line('a')) > 0) then
      call problems%add(path, group%line, 'include/file', 'seen '//quoted(file)//', which includes this file: a circle')
    else if (sources%n >= 100) then
      call problems%add(path, group%line, 'include/file', 'more than 100 included files')
    else
      call read_text_file(full, text, error)
      if (allocated(error)) then
        call problems%add(path, group%line, 'include/file', error%message)
      else
        call gather(full, folder_of(path_beside(prefix, file)), text, chain//full//new_line('a'), depth + 1, sources, problems)
      end if
    end if
  end subroutine include_file

  !> Allocate the groups that any file or override names.
  subroutine allocate_groups(sources, overrides, scene)
    type(source_list_t), intent(in) :: sources
    type(text_t), intent(in) :: overrides(:)
    type(scene_t), intent(inout) :: scene
    type(key_reference_t) :: reference
    character(len=:), allocatable :: problem
    integer :: i, k
    do i = 1, sources%n
      do k = 1, sources%list(i)%document%n
        call allocate_group(scene, sources%list(i)%document%groups(k)%name)
      end do
    end do
    do i = 1, size(overrides)
      k = index(overrides(i)%chars, '=')
      if (k == 0) cycle
      call split_key(overrides(i)%chars(:k - 1), reference, problem)
      if (.not. allocated(problem)) call allocate_group(scene, reference%group)
    end do
  end subroutine allocate_groups

  !> The &part groups of the last file that has any, each with its own table.
  subroutine bind_parts(sources, scene, place)
    type(source_list_t), intent(in) :: sources
    type(scene_t), target, intent(inout) :: scene
    type(place_of_scene_t), intent(inout) :: place
    integer :: i, n
    n = 0
    do i = sources%n, 1, -1
      n = min(most_parts, count_parts(sources%list(i)%document))
      if (n > 0) exit
    end do
    if (n == 0) return
    allocate (scene%parts(n), place%parts(n))
    do i = 1, n
      call part_table(scene%parts(i), i, place%parts(i))
    end do
  end subroutine bind_parts

  integer function count_parts(document)
    type(namelist_t), intent(in) :: document
    integer :: i
    count_parts = 0
    do i = 1, document%n
      if (document%groups(i)%name == 'part') count_parts = count_parts + 1
    end do
  end function count_parts

  !> Every group of every file into its place, base first.
  subroutine fill_scene(sources, place, problems)
    type(source_list_t), intent(inout) :: sources
    type(place_of_scene_t), intent(inout) :: place
    type(problem_list_t), intent(inout) :: problems
    type(schema_t) :: scratch_table
    type(part_group_t), target :: scratch
    integer :: i, k, part, last
    logical :: repeated
    last = 0
    do i = 1, sources%n
      if (count_parts(sources%list(i)%document) > 0) last = i
    end do
    do i = 1, sources%n
      part = 0
      associate (document => sources%list(i)%document)
        do k = 1, document%n
          call lead_paths(document%groups(k), sources%list(i)%prefix)
          select case (document%groups(k)%name)
          case ('include', '')
          case ('part')
            part = part + 1
            if (i == last .and. part <= most_parts) then
              call fill_group(document%path, document%groups(k), i, place%parts(part), problems)
            else if (part <= most_parts) then
              scratch = part_group_t()
              call part_table(scratch, part, scratch_table)
              call fill_group(document%path, document%groups(k), i, scratch_table, problems)
            else
              call problems%add(document%path, document%groups(k)%line, 'part', 'more than '//to_text(most_parts)//' parts')
            end if
          case default
            if (is_one_of(document%groups(k)%name, scene_groups)) then
              call claim_group(document%path, document%groups(k), i, place%table, problems, repeated)
              ! a level of its own: the keys of a repeated group are checked, not called repeated
              call fill_group(document%path, document%groups(k), i + merge(1000, 0, repeated), place%table, problems)
            else
              call problems%add(document%path, document%groups(k)%line, document%groups(k)%name, &
                'there is no group &'//document%groups(k)%name//did_you_mean(document%groups(k)%name, scene_groups//' include')// &
                ' (allowed: '//scene_groups//' include)')
            end if
          end select
        end do
      end associate
    end do
  end subroutine fill_scene

  !> Paths of an included file are seen from its own folder.
  subroutine lead_paths(group, prefix)
    type(group_t), intent(inout) :: group
    character(len=*), intent(in) :: prefix
    integer :: i
    if (len(prefix) == 0) return
    do i = 1, group%n
      if (group%items(i)%key /= 'file' .or. group%items(i)%n /= 1) cycle
      associate (value => group%items(i)%values(1))
        if (value%is_string .and. .not. value%broken .and. len_trim(value%text) > 0) &
          value%text = path_beside(prefix, value%text)
      end associate
    end do
  end subroutine lead_paths

  !> 'group/key=value' texts, after the files; each wins over what stood before.
  subroutine apply_overrides(overrides, place, problems)
    type(text_t), intent(in) :: overrides(:)
    type(place_of_scene_t), intent(inout) :: place
    type(problem_list_t), intent(inout) :: problems
    type(key_reference_t) :: reference
    character(len=:), allocatable :: problem, value
    integer :: i, equals
    do i = 1, size(overrides)
      equals = index(overrides(i)%chars, '=')
      if (equals == 0) then
        call problems%add('--set', 0, '', 'seen '//quoted(overrides(i)%chars)//'; expected group/key=value')
        cycle
      end if
      value = trim(adjustl(overrides(i)%chars(equals + 1:)))
      call split_key(overrides(i)%chars(:equals - 1), reference, problem)
      if (.not. allocated(problem)) then
        if (reference%group == 'part') then
          call override_part(reference, value, place, problem)
        else if (.not. is_one_of(reference%group, scene_groups)) then
          problem = 'there is no group &'//reference%group//did_you_mean(reference%group, scene_groups)
        else if (reference%instance > 0) then
          problem = 'only &part is repeated'
        else
          call override(place%table, reference, value, problem)
        end if
      end if
      if (allocated(problem)) call problems%add('--set', 0, trim(overrides(i)%chars(:equals - 1)), problem)
    end do
  end subroutine apply_overrides

  subroutine override_part(reference, value, place, problem)
    type(key_reference_t), intent(in) :: reference
    character(len=*), intent(in) :: value
    type(place_of_scene_t), intent(inout) :: place
    character(len=:), allocatable, intent(inout) :: problem
    integer :: part, n
    n = 0
    if (allocated(place%parts)) n = size(place%parts)
    part = reference%instance
    if (part == 0 .and. n == 1) part = 1
    if (part < 1 .or. part > n) then
      problem = 'the scene has '//to_text(n)//' &part groups; name one as part(1)/...'
    else
      call override(place%parts(part), reference, value, problem)
    end if
  end subroutine override_part

  subroutine override(table, reference, value, problem)
    type(schema_t), intent(inout) :: table
    type(key_reference_t), intent(in) :: reference
    character(len=*), intent(in) :: value
    character(len=:), allocatable, intent(inout) :: problem
    type(item_t) :: item
    integer :: i
    i = table%find(reference%group, reference%key)
    if (i == 0) then
      problem = 'there is no such key'//did_you_mean(reference%key, table%keys_of(reference%group))
      return
    end if
    associate (e => table%entries(i))
      call parse_override_value(e, value, item, problem)
      if (allocated(problem)) return
      item%subscript = reference%subscript
      call e%set(item, problem)
      e%given = .true.
      e%failed = allocated(problem)
      e%line = 0
      e%path = '--set'
    end associate
  end subroutine override

end module castnet_scene_file
