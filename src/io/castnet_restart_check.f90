!> May this scene go on from that checkpoint? The effective scenes are compared key by key:
!> only the end time and &output may differ.
module castnet_restart_check
  use castnet_error, only: error_t, fail, exit_input
  use castnet_text, only: to_text
  implicit none
  private
  public :: check_same_scene

  integer, parameter :: most_named = 12  !! differences that are listed

  !> One key of a scene.
  type :: entry_t
    character(len=:), allocatable :: key    !! 'group/key', 'part(2)/key' for a repeated group
    character(len=:), allocatable :: value
  end type entry_t

contains

  !> Refuse a restart whose scene differs in anything but time/end_time and output/*.
  !> Every difference is named. The texts are effective scenes as castnet prints them:
  !> '&group', then one 'key = value' a line.
  subroutine check_same_scene(before, now, checkpoint, error)
    character(len=*), intent(in) :: before      !! scene of the checkpoint
    character(len=*), intent(in) :: now         !! scene of this run
    character(len=*), intent(in) :: checkpoint  !! its path, or that of OUTPUT.part, for the message
    type(error_t), allocatable, intent(inout) :: error
    type(entry_t), allocatable :: old(:), new(:)
    character(len=:), allocatable :: list
    integer :: i, k, n
    if (allocated(error)) return
    if (before == now) return
    call split(before, old)
    call split(now, new)
    n = 0
    list = ''
    do i = 1, size(old)
      if (may_differ(old(i)%key)) cycle
      k = place_of(new, old(i)%key)
      if (k == 0) then
        call add(old(i)%key//': '//old(i)%value//' there, not in this scene')
      else if (new(k)%value /= old(i)%value) then
        call add(old(i)%key//': '//old(i)%value//' there, '//new(k)%value//' in this scene')
      end if
    end do
    do i = 1, size(new)
      if (may_differ(new(i)%key)) cycle
      if (place_of(old, new(i)%key) == 0) call add(new(i)%key//': not there, '//new(i)%value//' in this scene')
    end do
    if (n == 0) return
    if (n > most_named) list = list//new_line('a')//'  and '//to_text(n - most_named)//' more'
    call fail(error, exit_input, "cannot restart from '"//checkpoint//"': only time/end_time and the keys of &output"// &
              ' may change in a restart, but'//list)

  contains

    subroutine add(text)
      character(len=*), intent(in) :: text
      n = n + 1
      if (n <= most_named) list = list//new_line('a')//'  '//text
    end subroutine add

  end subroutine check_same_scene

  pure logical function may_differ(key)
    character(len=*), intent(in) :: key
    may_differ = key == 'time/end_time' .or. index(key, 'output/') == 1 .or. key == 'output'
  end function may_differ

  pure integer function place_of(entries, key) result(k)
    type(entry_t), intent(in) :: entries(:)
    character(len=*), intent(in) :: key
    do k = 1, size(entries)
      if (entries(k)%key == key) return
    end do
    k = 0
  end function place_of

  !> The keys of an effective scene. A group without keys is an entry of its own name; a
  !> line without '=' goes on with the value before it.
  subroutine split(text, entries)
    character(len=*), intent(in) :: text
    type(entry_t), allocatable, intent(out) :: entries(:)
    type(entry_t), allocatable :: found(:)
    character(len=:), allocatable :: line, group
    integer :: start, length, equals, n, n_found, i
    ! At most an entry a line.
    n_found = 1
    do i = 1, len(text)
      if (text(i:i) == new_line('a')) n_found = n_found + 1
    end do
    allocate (found(n_found))
    n_found = 0
    group = ''
    start = 1
    do while (start <= len(text))
      length = index(text(start:), new_line('a')) - 1
      if (length < 0) length = len(text) - start + 1
      line = trim(adjustl(text(start:start + length - 1)))
      start = start + length + 1
      if (len(line) == 0) cycle
      if (line(1:1) == '!' .or. line == '/') cycle
      equals = index(line, '=')
      if (line(1:1) == '&') then
        group = trim(line(2:))
        n = 1
        do i = 1, n_found
          if (found(i)%key == group .or. index(found(i)%key, group//'(') == 1 .and. index(found(i)%key, '/') == 0) n = n + 1
        end do
        if (n > 1) group = group//'('//to_text(n)//')'
        call add(group, 'given')
      else if (equals > 0 .and. line(1:1) /= "'") then
        call add(group//'/'//trim(line(1:equals - 1)), trim(adjustl(line(equals + 1:))))
      else if (n_found > 0) then
        found(n_found)%value = found(n_found)%value//' '//line
      end if
    end do
    allocate (entries(n_found))
    do i = 1, n_found
      call move_alloc(found(i)%key, entries(i)%key)
      call move_alloc(found(i)%value, entries(i)%value)
    end do

  contains

    ! Component by component: gfortran 12 loses the texts of a structure constructor.
    subroutine add(key, value)
      character(len=*), intent(in) :: key, value
      n_found = n_found + 1
      found(n_found)%key = key
      found(n_found)%value = value
    end subroutine add

  end subroutine split

end module castnet_restart_check
