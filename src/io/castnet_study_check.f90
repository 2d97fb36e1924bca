!> What keys of a study mean to each other and to the scene that they vary.
module castnet_study_check
  use castnet_error, only: error_t
  use castnet_kinds, only: wp
  use castnet_problems, only: problem_list_t
  use castnet_scene, only: scene_t, is_set
  use castnet_scene_schema, only: set_key, get_key, split_key, key_reference_t, allocate_all_groups
  use castnet_schema, only: schema_t
  use castnet_schema_fill, only: tell
  use castnet_study_request, only: study_request_t, vary_group_t, grid_size, grid_value, &
                                   is_search, first_points
  use castnet_text, only: to_text, quoted, path_beside, without_extension, lower
  implicit none
  private
  public :: check_study, study_place_t

  !> Where things were said, and the base scene if it is sound.
  type :: study_place_t
    type(schema_t) :: table
    type(schema_t), allocatable :: vary(:)
    integer :: last_line = 0
    type(scene_t) :: base
    logical :: has_base = .false.
  end type study_place_t

  real(wp), parameter :: most_cases = 1.0e8_wp
  integer, parameter :: most_tried = 2000   !! values of one key that are tried on the scene, both ends among them

contains

  !> Every problem between keys, and of every varied key with its values on the scene.
  subroutine check_study(request, place, problems, warnings)
    type(study_request_t), intent(in) :: request
    type(study_place_t), intent(inout) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    integer :: i
    if (.not. place%has_base) then
      ! keys can still be checked against a scene that has every group
      call allocate_all_groups(place%base)
      if (.not. allocated(place%base%parts)) allocate (place%base%parts(100))
      place%base%path = ''
    end if
    call check_required(request, place, problems)
    do i = 1, size(request%vary)
      call check_vary(request, i, place, problems, warnings)
    end do
    call check_question(request, place, problems, warnings)
    call check_size(request, place, problems)
    call check_files(request, place, problems)
  end subroutine check_study

  !> Missing keys and keys without effect.
  subroutine check_required(request, place, problems)
    type(study_request_t), intent(in) :: request
    type(study_place_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems
    integer :: i
    if (.not. place%table%groups(1)%present .and. .not. place%table%entries(1)%has_value()) then
      call tell(problems, request%path, place%table, place%last_line, 'study', '', &
                'the group &study is missing; required, with scene')
    else
      call missing(place%table, 'always')
    end if
    if (request%sample%kind /= 'grid') call missing(place%table, 'a design')
    do i = 1, size(request%vary)
      call missing(place%vary(i), 'always')
      if (request%vary(i)%distribution == 'normal') call missing(place%vary(i), 'distribution = ''normal''')
    end do
  contains
    subroutine missing(table, need)
      type(schema_t), intent(in) :: table
      character(len=*), intent(in) :: need
      integer :: k
      do k = 1, table%n
        associate (e => table%entries(k))
          if (e%need == need .and. .not. e%failed .and. .not. e%has_value()) &
            call tell(problems, request%path, table, place%last_line, trim(e%group), trim(e%key), &
                      'missing; required: '//trim(e%help)//', '//e%allowed())
        end associate
      end do
    end subroutine missing
  end subroutine check_required

  !> One varied key: is it a scalar of the scene, said in one way, with values that it may have?
  subroutine check_vary(request, i, place, problems, warnings)
    type(study_request_t), intent(in) :: request
    integer, intent(in) :: i
    type(study_place_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    integer :: k
    logical :: range
    associate (v => request%vary(i))
      if (len_trim(v%key) > 0) then
        do k = 1, i - 1
          if (same_key(request%vary(k)%key, v%key)) call problem('key', &
            'seen '//quoted(trim(v%key))//', which vary('//to_text(k)//') varies already')
        end do
      end if
      range = is_set(v%from) .or. is_set(v%to)
      if (allocated(v%values) .and. (range .or. v%count > 0 .or. len_trim(v%distribution) > 0)) then
        call problem('values', 'given together with from, to, count or a distribution; allowed: one way to say the values')
        return
      end if
      if (.not. allocated(v%values) .and. .not. range .and. len_trim(v%distribution) == 0) then
        call problem('', 'no values; give values, or from, to, count, or a distribution')
        return
      end if
      if (v%distribution == 'normal' .and. range) call problem('distribution', &
        'seen ''normal'' with from and to; allowed: mean and deviation')
      if (v%distribution /= 'normal' .and. (is_set(v%mean) .or. is_set(v%deviation))) call problem('mean', &
        'mean and deviation belong to distribution = ''normal''')
      if (range .or. v%distribution == 'uniform') then
        if (.not. is_set(v%from)) call problem('from', 'missing; required: lower end, beside to')
        if (.not. is_set(v%to)) call problem('to', 'missing; required: upper end, beside from')
      end if
      if (len_trim(v%distribution) > 0 .and. v%count > 0) call problem('count', 'has no meaning for a distribution')
      if (range .and. v%count == 0 .and. len_trim(v%distribution) == 0 .and. request%sample%kind == 'grid' .and. &
          is_set(v%from) .and. is_set(v%to)) call problem('count', &
        'missing; required in a grid: the number of values from first to last')
      if (request%sample%kind /= 'grid' .and. (allocated(v%values) .or. v%count > 0)) call problem('', &
        'a list or count in a '//trim(request%sample%kind)//' design; allowed: from and to, or a distribution')
      if (v%spacing == 'log' .and. is_set(v%from) .and. is_set(v%to)) then
        if (.not. (v%from*v%to > 0.0_wp)) call problem('spacing', 'seen ''log'' from '//to_text(v%from)//' to '// &
          to_text(v%to)//'; allowed: ends of the same sign, not 0')
      end if
      if (is_set(v%from) .and. is_set(v%to) .and. v%count /= 1 .and. v%from >= v%to) then
        if (.not. (v%count > 1 .and. v%from > v%to)) call problem('to', 'seen '//to_text(v%to)//'; allowed: above from = '// &
                                                                to_text(v%from))
      end if
      if (len_trim(v%key) > 0) call try_values(request, i, place, problems)
    end associate
  contains
    subroutine problem(key, text)
      character(len=*), intent(in) :: key, text
      call tell(problems, request%path, place%vary(i), place%last_line, 'vary', key, text)
    end subroutine problem
  end subroutine check_vary

  !> The key on the scene, with each of its values (of a long grid, some and both ends).
  subroutine try_values(request, i, place, problems)
    type(study_request_t), intent(in) :: request
    integer, intent(in) :: i
    type(study_place_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: problem
    integer :: k, n
    associate (v => request%vary(i))
      call check_key(trim(v%key), place%base, problem)
      if (allocated(problem)) then
        call tell(problems, request%path, place%vary(i), place%last_line, 'vary', 'key', problem)
        return
      end if
      n = grid_size(v)
      if (allocated(v%values)) then
        do k = 1, min(n, most_tried)
          call try_one(trim(v%values(k)), 'values')
          if (allocated(problem)) return
        end do
      else if (is_set(v%from) .and. is_set(v%to)) then
        call try_one(to_text(v%from), 'from')
        if (.not. allocated(problem)) call try_one(to_text(v%to), 'to')
        if (v%spacing == 'log' .and. .not. v%from*v%to > 0.0_wp) return
        do k = 2, min(n - 1, most_tried)
          if (allocated(problem)) return
          call try_one(to_text(grid_value(v, k)), 'count')
        end do
      else if (is_set(v%mean)) then
        call try_one(to_text(v%mean), 'mean')
      end if
    end associate
  contains
    subroutine try_one(value, key)
      character(len=*), intent(in) :: value, key
      call try_value(trim(request%vary(i)%key), value, place%base, problem)
      if (allocated(problem)) call tell(problems, request%path, place%vary(i), place%last_line, 'vary', key, problem)
    end subroutine try_one
  end subroutine try_values

  !> Is this the name of one value of the scene?
  subroutine check_key(key, base, problem)
    character(len=*), intent(in) :: key
    type(scene_t), intent(in) :: base
    character(len=:), allocatable, intent(out) :: problem
    type(error_t), allocatable :: error
    character(len=:), allocatable :: text
    type(key_reference_t) :: reference
    call get_key(base, key, text, error)
    if (allocated(error)) then
      problem = error%message
      return
    end if
    call split_key(key, reference, problem)
    if (reference%subscript == 0) then
      ! one value cannot set an array, whatever the value
      call try_value(key, '1', base, problem)
      if (allocated(problem)) then
        if (index(problem, 'seen 1 value;') == 0) deallocate (problem)
      end if
      if (allocated(problem)) problem = key//': an array; name one component, such as '//key//'(1)'
    end if
    if (.not. allocated(problem) .and. reference%group == 'perturb' .and. reference%key == 'seed') &
      problem = key//': each run has its own seed; set study/seed'
  end subroutine check_key

  !> May the key have this value?
  subroutine try_value(key, value, base, problem)
    character(len=*), intent(in) :: key, value
    type(scene_t), intent(in) :: base
    character(len=:), allocatable, intent(out) :: problem
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    scene = base
    call set_key(scene, key, value, error)
    if (allocated(error)) problem = error%message
  end subroutine try_value

  logical function same_key(a, b)
    character(len=*), intent(in) :: a, b
    type(key_reference_t) :: first, second
    character(len=:), allocatable :: problem
    same_key = .false.
    if (len_trim(a) == 0 .or. len_trim(b) == 0) return
    call split_key(a, first, problem)
    call split_key(b, second, problem)
    same_key = first%group == second%group .and. first%key == second%key .and. first%instance == second%instance .and. &
               first%subscript == second%subscript
  end function same_key

  !> A map needs varied keys, the searches their &search.
  subroutine check_question(request, place, problems, warnings)
    type(study_request_t), intent(in) :: request
    type(study_place_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems, warnings
    character(len=:), allocatable :: wrong
    integer :: i
    if (request%study%question == 'map') then
      if (allocated(request%search)) call tell(warnings, request%path, place%table, place%last_line, 'search', '', &
        'has no effect for question = ''map''')
      if (size(request%vary) == 0 .and. request%study%seeds == 1) call tell(warnings, request%path, place%table, &
        place%last_line, 'study', '', 'neither a &vary group nor seeds above 1: one run')
    else if (.not. allocated(request%search)) then
      call tell(problems, request%path, place%table, place%last_line, 'study', 'question', &
                'seen '//quoted(trim(request%study%question))//' without a &search group; give its key, from and to')
    end if
    if (request%study%seeds > 1 .and. place%has_base .and. .not. allocated(place%base%perturb) .and. &
        all(len_trim(request%vary%distribution) == 0)) call tell(warnings, request%path, place%table, place%last_line, &
      'study', 'seeds', 'the scene has no &perturb and no key is drawn: all runs of a point are the same')
    if (request%sample%kind /= 'grid' .and. size(request%vary) == 0) call tell(problems, request%path, place%table, &
      place%last_line, 'sample', 'kind', 'seen '//quoted(trim(request%sample%kind))//' without a &vary group')
    if (request%sample%kind == 'grid' .and. request%sample%points > 0) call tell(warnings, request%path, place%table, &
      place%last_line, 'sample', 'points', 'has no effect in a grid')
    if (.not. allocated(request%search)) return
    associate (s => request%search)
      if (is_set(s%from) .and. is_set(s%to)) then
        if (s%from >= s%to) call tell(problems, request%path, place%table, place%last_line, 'search', 'to', &
          'seen '//to_text(s%to)//'; allowed: above from = '//to_text(s%from))
      end if
      if (request%study%question == 'threshold' .and. s%budget < 2*first_points) &
        call tell(problems, request%path, place%table, place%last_line, 'search', 'budget', 'seen '//to_text(s%budget)// &
                  '; allowed: at least '//to_text(2*first_points)//', two runs at each of the '//to_text(first_points)// &
                  ' points that are looked at first')
      if (len_trim(s%key) == 0) return
      do i = 1, size(request%vary)
        if (same_key(request%vary(i)%key, s%key)) call tell(problems, request%path, place%table, place%last_line, 'search', 'key', &
          'seen '//quoted(trim(s%key))//', which vary('//to_text(i)//') varies already')
      end do
      call check_key(trim(s%key), place%base, wrong)
      if (allocated(wrong)) then
        call tell(problems, request%path, place%table, place%last_line, 'search', 'key', wrong)
        return
      end if
      if (is_set(s%from)) call try_value(trim(s%key), to_text(s%from), place%base, wrong)
      if (allocated(wrong)) call tell(problems, request%path, place%table, place%last_line, 'search', 'from', wrong)
      if (is_set(s%to)) call try_value(trim(s%key), to_text(s%to), place%base, wrong)
      if (allocated(wrong)) call tell(problems, request%path, place%table, place%last_line, 'search', 'to', wrong)
    end associate
  end subroutine check_question

  !> Numbers of cases that no one runs.
  subroutine check_size(request, place, problems)
    type(study_request_t), intent(in) :: request
    type(study_place_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems
    real(wp) :: cases
    integer :: i
    cases = real(request%study%seeds, wp)
    if (is_search(request)) cases = real(request%search%budget, wp)
    if (request%sample%kind == 'grid') then
      do i = 1, size(request%vary)
        cases = cases*real(max(1, grid_size(request%vary(i))), wp)
        if (cases > 1.0e300_wp) exit
      end do
    else
      cases = cases*real(max(1, request%sample%points), wp)
    end if
    if (cases > most_cases) call tell(problems, request%path, place%table, place%last_line, 'study', '', &
      to_text(cases)//' runs; allowed: at most '//to_text(most_cases))
  end subroutine check_size

  !> The results must not fall on what is read.
  subroutine check_files(request, place, problems)
    type(study_request_t), intent(in) :: request
    type(study_place_t), intent(in) :: place
    type(problem_list_t), intent(inout) :: problems
    character(len=:), allocatable :: path
    path = path_beside(request%path, trim(request%study%file))
    if (len(path) == 0) path = without_extension(request%path)//'.h5'
    if (path == request%path .or. path == path_beside(request%path, trim(request%study%scene))) &
      call tell(problems, request%path, place%table, place%last_line, 'study', 'file', &
                'seen '//quoted(trim(request%study%file))//', which would overwrite the study or its scene')
    if (path(len(path):) == '/') call tell(problems, request%path, place%table, place%last_line, 'study', 'file', &
      'seen '//quoted(trim(request%study%file))//', a folder; allowed: a file')
  end subroutine check_files

end module castnet_study_check
