!> What a study says: its rows, the points that they belong to, the answers of its searches,
!> and the table of all that.
module castnet_study_result
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_interval, only: wilson_interval
  use castnet_study_case, only: case_setting_t
  use castnet_study_design, only: case_values, is_drawn
  use castnet_study_record, only: case_row_t, point_row_t, search_row_t, case_done, case_missing
  use castnet_study_request, only: study_request_t, is_search
  use castnet_study_search, only: search_result_t
  use castnet_study_table, only: write_study_table
  use castnet_text, only: to_text, rounded_text, text_t
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none
  private
  public :: make_table, columns

contains

  !> Varied keys, the searched one last.
  pure integer function columns(request)
    type(study_request_t), intent(in) :: request
    columns = size(request%vary) + merge(1, 0, is_search(request))
  end function columns

  !> Rows, points and answers to the table at `output`. Errors: exit_file.
  subroutine make_table(setting, rows, found, output, version, answer, error)
    type(case_setting_t), intent(in) :: setting
    type(case_row_t), intent(in) :: rows(:)          !! by case number
    type(search_result_t), intent(in) :: found(:)    !! one for each point of a search, else none
    character(len=*), intent(in) :: output, version
    character(len=:), allocatable, intent(out) :: answer !! of a search, a line for each; '' for a map
    type(error_t), allocatable, intent(inout) :: error
    type(case_row_t), allocatable :: done(:)
    type(point_row_t), allocatable :: points(:)
    type(search_row_t), allocatable :: searches(:)
    type(text_t), allocatable :: keys(:), notes(:)
    integer :: i

    associate (request => setting%request)
      allocate (keys(columns(request)))
      do i = 1, size(request%vary)
        keys(i)%chars = trim(request%vary(i)%key)
      end do
      answer = ''
      done = pack(rows, rows%status /= case_missing)
      if (is_search(request)) then
        keys(size(keys))%chars = trim(request%search%key)
        call search_points(setting, found, points, done)
        call search_rows(setting, found, searches)
        answer = all_answers(setting, found, searches)
      else
        call map_points(setting, rows, points)
        allocate (searches(0))
      end if
      allocate (notes(8))
      notes(1)%chars = 'study'
      notes(2)%chars = request%text
      notes(3)%chars = 'scene'
      notes(4)%chars = setting%base%text
      notes(5)%chars = 'version'
      notes(6)%chars = version
      notes(7)%chars = 'answer'
      notes(8)%chars = answer
    end associate
    call write_study_table(output, keys, done, points, searches, notes, error)
  end subroutine make_table

  subroutine map_points(setting, rows, points)
    type(case_setting_t), intent(in) :: setting
    type(case_row_t), intent(in) :: rows(:)
    type(point_row_t), allocatable, intent(out) :: points(:)
    integer(i8) :: p, k
    allocate (points(setting%design%n_point))
    do p = 1, setting%design%n_point
      points(p)%varied = point_values(setting, p)
      do k = (p - 1)*setting%design%stride + 1, p*setting%design%stride
        if (rows(k)%status /= case_done) cycle
        points(p)%runs = points(p)%runs + 1
        if (rows(k)%measure(1) > 0.5_wp) points(p)%captured = points(p)%captured + 1
      end do
      call finish_point(points(p), 0.95_wp)
    end do
  end subroutine map_points

  !> The values of a point's keys; one that is drawn for each run has none.
  function point_values(setting, point) result(number)
    type(case_setting_t), intent(in) :: setting
    integer(i8), intent(in) :: point
    real(wp), allocatable :: number(:)
    type(text_t), allocatable :: text(:)
    integer :: i
    call case_values(setting%design, setting%request, (point - 1)*setting%design%stride + 1, text, number)
    do i = 1, size(number)
      if (is_drawn(setting%design, setting%request%vary(i))) number(i) = ieee_value(1.0_wp, ieee_quiet_nan)
    end do
  end function point_values

  !> Every value that was looked at, one search after the other. A row's point was its
  !> search; now it is the line of /point that counts it.
  subroutine search_points(setting, found, points, rows)
    type(case_setting_t), intent(in) :: setting
    type(search_result_t), intent(in) :: found(:)
    type(point_row_t), allocatable, intent(out) :: points(:)
    type(case_row_t), intent(inout) :: rows(:)
    integer, allocatable :: first(:)
    integer :: i, k, n, at
    allocate (first(size(found) + 1))
    first(1) = 0
    do k = 1, size(found)
      n = 0
      if (allocated(found(k)%x)) n = size(found(k)%x)
      first(k + 1) = first(k) + n
    end do
    allocate (points(first(size(found) + 1)))
    do k = 1, size(found)
      do i = 1, first(k + 1) - first(k)
        associate (point => points(first(k) + i))
          point%varied = [point_values(setting, int(k, i8)), found(k)%x(i)]
          point%runs = found(k)%runs(i)
          point%captured = found(k)%successes(i)
          call finish_point(point, setting%request%search%confidence)
        end associate
      end do
    end do
    do i = 1, size(rows)
      k = int(rows(i)%point)
      at = 0
      if (first(k + 1) > first(k)) at = findloc(found(k)%x, rows(i)%varied(size(rows(i)%varied)), dim=1)
      rows(i)%point = merge(first(k) + at, 0, at > 0)
    end do
  end subroutine search_points

  subroutine finish_point(point, confidence)
    type(point_row_t), intent(inout) :: point
    real(wp), intent(in) :: confidence
    point%probability = real(point%captured, wp)/real(max(1, point%runs), wp)
    if (point%runs == 0) point%probability = ieee_value(1.0_wp, ieee_quiet_nan)
    call wilson_interval(point%captured, point%runs, confidence, point%lower, point%upper)
  end subroutine finish_point

  subroutine search_rows(setting, found, rows)
    type(case_setting_t), intent(in) :: setting
    type(search_result_t), intent(in) :: found(:)
    type(search_row_t), allocatable, intent(out) :: rows(:)
    real(wp) :: nan
    integer :: k
    nan = ieee_value(nan, ieee_quiet_nan)
    allocate (rows(size(found)))
    do k = 1, size(found)
      rows(k)%varied = point_values(setting, int(k, i8))
      rows(k)%estimate = nan
      rows(k)%lower = nan
      rows(k)%upper = nan
      rows(k)%probability = nan
      rows(k)%probability_lower = nan
      rows(k)%probability_upper = nan
      if (allocated(found(k)%x)) call fill(found(k), rows(k))
    end do

  contains

    subroutine fill(result, row)
      type(search_result_t), intent(in) :: result
      type(search_row_t), intent(inout) :: row
      integer :: i
      row%runs = sum(result%runs)
      row%found = result%found .and. .not. result%stopped
      if (setting%request%study%question == 'threshold') then
        row%crossings = result%crossings
        row%probability = setting%request%search%probability
      end if
      if (.not. row%found) return
      row%estimate = result%estimate
      if (setting%request%study%question == 'threshold') then
        row%lower = result%lower
        row%upper = result%upper
      else
        i = findloc(result%x, result%estimate, dim=1)
        row%probability = real(result%successes(i), wp)/real(max(1, result%runs(i)), wp)
        row%probability_lower = result%lower
        row%probability_upper = result%upper
      end if
    end subroutine fill

  end subroutine search_rows

  !> A line for each search; with several, each begins with the keys that it belongs to.
  function all_answers(setting, found, rows) result(text)
    type(case_setting_t), intent(in) :: setting
    type(search_result_t), intent(in) :: found(:)
    type(search_row_t), intent(in) :: rows(:)
    character(len=:), allocatable :: text
    integer :: k
    text = ''
    do k = 1, size(rows)
      if (k > 1) text = text//new_line('a')
      if (size(rows) > 1) text = text//place(k)//': '
      text = text//answer_text(setting%request, found(k), rows(k))
    end do

  contains

    function place(point) result(words)
      integer, intent(in) :: point
      character(len=:), allocatable :: words
      type(text_t), allocatable :: values(:)
      real(wp), allocatable :: number(:)
      integer :: i
      words = ''
      call case_values(setting%design, setting%request, (point - 1)*setting%design%stride + 1, values, number)
      do i = 1, size(values)
        if (is_drawn(setting%design, setting%request%vary(i))) cycle
        if (len(words) > 0) words = words//', '
        words = words//trim(setting%request%vary(i)%key)//' = '//values(i)%chars
      end do
    end function place

  end function all_answers

  !> What one search found, in words.
  function answer_text(request, result, row) result(text)
    type(study_request_t), intent(in) :: request
    type(search_result_t), intent(in) :: result
    type(search_row_t), intent(in) :: row
    character(len=:), allocatable :: text
    associate (s => request%search)
      if (.not. allocated(result%x) .or. result%stopped) then
        text = 'not finished, '//to_text(row%runs)//' runs so far; castnet study goes on'
      else if (request%study%question == 'threshold') then
        if (.not. row%found) then
          text = 'P(captured) does not cross '//to_text(s%probability)//' between '//to_text(s%from)//' and '// &
                 to_text(s%to)//' ('//to_text(row%runs)//' runs)'
        else
          text = 'P(captured) crosses '//to_text(s%probability)//' at '//trim(s%key)//' = '//rounded_text(row%estimate, 4)// &
                 ', '//to_text(s%confidence)//' interval '//rounded_text(row%lower, 4)//' to '//rounded_text(row%upper, 4)// &
                 ', by '//to_text(row%runs)//' runs'
          if (row%crossings > 1) text = text//'; it crosses '//to_text(row%crossings)// &
                                        ' times, this is the first: the curve is not monotone'
        end if
      else if (.not. row%found) then
        text = 'no run gave an answer'
      else
        text = 'P(captured) is largest at '//trim(s%key)//' = '//rounded_text(row%estimate, 4)//', there between '// &
               rounded_text(row%probability_lower, 4)//' and '// &
               rounded_text(row%probability_upper, 4)//' ('//to_text(s%confidence)// &
               ' interval), by '//to_text(row%runs)//' runs'
      end if
    end associate
  end function answer_text

end module castnet_study_result
