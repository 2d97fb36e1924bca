!> A study from a file, or from text, by the same strict pass as a scene: every problem of
!> the study, of its base scene and of each varied key against the scene's schema in one go.
module castnet_study_file
  use castnet_error, only: error_t, fail, exit_input
  use castnet_namelist, only: namelist_t, parse_namelist, item_t
  use castnet_problems, only: problem_list_t
  use castnet_scene, only: scene_t, is_set
  use castnet_scene_file, only: read_scene
  use castnet_scene_schema, only: split_key, key_reference_t, parse_override_value
  use castnet_schema, only: schema_t
  use castnet_schema_fill, only: fill_group, claim_group, tell
  use castnet_scene_text, only: group_text
  use castnet_study_check, only: check_study, study_place_t
  use castnet_study_request, only: study_request_t, vary_group_t
  use castnet_study_schema, only: study_table, vary_table, store_vary_lists, study_groups
  use castnet_text, only: text_t, to_text, did_you_mean, is_one_of, path_beside, name_of, without_extension, quoted
  use castnet_text_file, only: read_text_file
  implicit none
  private
  public :: read_study, read_study_text, effective_study, is_study_text

  integer, parameter :: most_vary = 100

contains

  !> Read and check a study. `overrides`: texts 'group/key=value'; those of the study's own
  !> groups are applied, the rest are kept for the base scene (`scene_overrides`).
  !> `warnings`: lines for the user, '' if none. Errors: as for `read_scene`.
  subroutine read_study(path, overrides, request, warnings, error)
    character(len=*), intent(in) :: path
    type(text_t), intent(in) :: overrides(:)
    type(study_request_t), intent(out) :: request
    character(len=:), allocatable, intent(out) :: warnings
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: text
    warnings = ''
    call read_text_file(path, text, error)
    if (allocated(error)) return
    call read_study_text(text, path, overrides, request, warnings, error)
  end subroutine read_study

  !> The same from text; `path` names it in messages, and says where its files are.
  subroutine read_study_text(text, path, overrides, request, warnings, error)
    character(len=*), intent(in) :: text, path
    type(text_t), intent(in) :: overrides(:)
    type(study_request_t), intent(out) :: request
    character(len=:), allocatable, intent(out) :: warnings
    type(error_t), allocatable, intent(inout) :: error
    type(study_request_t), target :: work
    type(namelist_t) :: document
    type(problem_list_t) :: problems, notes
    type(study_place_t) :: place
    integer :: i
    work%path = path
    work%text = text
    call parse_namelist(path, text, document, problems)
    place%last_line = document%last_line
    if (has_group(document, 'search') .or. any_search(overrides)) allocate (work%search)
    call study_table(work, place%table)
    allocate (work%vary(min(most_vary, count_vary(document))))
    allocate (place%vary(size(work%vary)))
    do i = 1, size(work%vary)
      call vary_table(work%vary(i), i, place%vary(i))
    end do
    call fill_study(document, place, problems)
    call split_overrides(overrides, work, place, problems)
    do i = 1, size(work%vary)
      call store_vary_lists(place%vary(i), work%vary(i))
    end do
    call check_base_and_keys(work, place, problems, notes)
    call check_study(work, place, problems, notes)
    warnings = notes%report()
    if (problems%n > 0) then
      call fail(error, exit_input, problems%report())
      return
    end if
    if (len_trim(work%study%file) == 0) work%study%file = without_extension(name_of(path))//'.h5'
    request = work
  end subroutine read_study_text

  !> Every group of the file into its place.
  subroutine fill_study(document, place, problems)
    type(namelist_t), intent(in) :: document
    type(study_place_t), intent(inout) :: place
    type(problem_list_t), intent(inout) :: problems
    integer :: i, vary
    logical :: repeated
    vary = 0
    do i = 1, document%n
      associate (group => document%groups(i))
        if (group%name == 'vary') then
          vary = vary + 1
          if (vary <= size(place%vary)) then
            call fill_group(document%path, group, 1, place%vary(vary), problems)
          else
            call problems%add(document%path, group%line, 'vary', 'more than '//to_text(most_vary)//' varied keys')
          end if
        else if (is_one_of(group%name, study_groups)) then
          call claim_group(document%path, group, 1, place%table, problems, repeated)
          call fill_group(document%path, group, merge(2, 1, repeated), place%table, problems)
        else if (len(group%name) > 0) then
          call problems%add(document%path, group%line, group%name, 'there is no group &'//group%name// &
            did_you_mean(group%name, study_groups)//' (allowed in a study: '//study_groups//')')
        end if
      end associate
    end do
  end subroutine fill_study

  !> Overrides of the study's groups are applied, the others kept for the scene.
  subroutine split_overrides(overrides, request, place, problems)
    type(text_t), intent(in) :: overrides(:)
    type(study_request_t), intent(inout) :: request
    type(study_place_t), intent(inout) :: place
    type(problem_list_t), intent(inout) :: problems
    type(key_reference_t) :: reference
    character(len=:), allocatable :: problem
    logical :: ours(size(overrides))
    integer :: i, n
    do i = 1, size(overrides)
      ours(i) = .false.
      n = index(overrides(i)%chars, '=')
      if (n == 0) cycle
      call split_key(overrides(i)%chars(:n - 1), reference, problem)
      if (allocated(problem)) cycle
      ours(i) = is_one_of(reference%group, study_groups)
      if (.not. ours(i)) cycle
      call override(reference, trim(adjustl(overrides(i)%chars(n + 1:))), place, problem)
      if (allocated(problem)) call problems%add('--set', 0, trim(overrides(i)%chars(:n - 1)), problem)
    end do
    allocate (request%scene_overrides(count(.not. ours)))
    n = 0
    do i = 1, size(overrides)
      if (ours(i)) cycle
      n = n + 1
      request%scene_overrides(n)%chars = overrides(i)%chars
    end do
  end subroutine split_overrides

  subroutine override(reference, value, place, problem)
    type(key_reference_t), intent(in) :: reference
    character(len=*), intent(in) :: value
    type(study_place_t), intent(inout) :: place
    character(len=:), allocatable, intent(inout) :: problem
    integer :: part
    part = reference%instance
    if (reference%group == 'vary') then
      if (part == 0 .and. size(place%vary) == 1) part = 1
      if (part < 1 .or. part > size(place%vary)) then
        problem = 'the study has '//to_text(size(place%vary))//' &vary groups; name one as vary(1)/...'
      else
        call set(place%vary(part))
      end if
    else
      call set(place%table)
    end if
  contains
    subroutine set(table)
      type(schema_t), intent(inout) :: table
      type(item_t) :: item
      integer :: i
      i = table%find(reference%group, reference%key)
      if (i == 0) then
        problem = 'there is no such key'//did_you_mean(reference%key, table%keys_of(reference%group))
        return
      end if
      call parse_override_value(table%entries(i), value, item, problem)
      if (allocated(problem)) return
      item%subscript = reference%subscript
      call table%entries(i)%set(item, problem)
      table%entries(i)%given = .true.
      table%entries(i)%failed = allocated(problem)
      table%entries(i)%path = '--set'
      table%entries(i)%line = 0
    end subroutine set
  end subroutine override

  !> Read the base scene; its problems are the study's.
  subroutine check_base_and_keys(request, place, problems, notes)
    type(study_request_t), intent(in) :: request
    type(study_place_t), intent(inout) :: place
    type(problem_list_t), intent(inout) :: problems, notes
    type(error_t), allocatable :: error
    character(len=:), allocatable :: warnings, path
    if (len_trim(request%study%scene) == 0) return
    path = path_beside(request%path, trim(request%study%scene))
    call read_scene(path, request%scene_overrides, place%base, warnings, error, resolve=.false.)
    place%has_base = .not. allocated(error)
    if (place%has_base) then
      if (len(warnings) > 0) call notes%add('', 0, '', warnings)
    else if (index(error%message, path//': ') == 1) then      ! the file itself cannot be read
      call tell(problems, request%path, place%table, place%last_line, 'study', 'scene', &
                'seen '//quoted(trim(request%study%scene))//'; '//error%message)
    else
      call problems%add('', 0, '', error%message)
    end if
  end subroutine check_base_and_keys

  !> Every group of a study with every key that has a value.
  function effective_study(request) result(text)
    type(study_request_t), intent(in) :: request
    character(len=:), allocatable :: text
    type(study_request_t), target :: copy
    type(schema_t) :: table, vary
    integer :: i, k
    copy = request
    call study_table(copy, table)
    text = group_text(table, 1)
    do k = 1, size(copy%vary)
      call vary_table(copy%vary(k), k, vary)
      text = text//group_text(vary, 1)
    end do
    do i = 2, table%n_group
      text = text//group_text(table, i)
    end do
    text = text(:len(text) - 1)
  end function effective_study

  !> Does this text hold a study rather than a scene?
  logical function is_study_text(text)
    character(len=*), intent(in) :: text
    type(namelist_t) :: document
    type(problem_list_t) :: ignored
    call parse_namelist('', text, document, ignored)
    is_study_text = has_group(document, 'study') .or. has_group(document, 'vary') .or. has_group(document, 'sample') .or. &
                    has_group(document, 'search')
  end function is_study_text

  logical function has_group(document, name)
    type(namelist_t), intent(in) :: document
    character(len=*), intent(in) :: name
    integer :: i
    has_group = .false.
    do i = 1, document%n
      if (document%groups(i)%name == name) has_group = .true.
    end do
  end function has_group

  integer function count_vary(document)
    type(namelist_t), intent(in) :: document
    integer :: i
    count_vary = 0
    do i = 1, document%n
      if (document%groups(i)%name == 'vary') count_vary = count_vary + 1
    end do
  end function count_vary

  logical function any_search(overrides)
    type(text_t), intent(in) :: overrides(:)
    integer :: i
    any_search = .false.
    do i = 1, size(overrides)
      if (index(adjustl(overrides(i)%chars), 'search/') == 1) any_search = .true.
    end do
  end function any_search

end module castnet_study_file
