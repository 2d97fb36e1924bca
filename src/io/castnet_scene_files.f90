!> The files that a scene reads: which they are, so that none is overwritten, and what was
!> in them, so that nothing goes on from other contents.
module castnet_scene_files
  use castnet_kinds, only: i8
  use castnet_archive, only: checksum
  use castnet_error, only: error_t, fail, exit_input
  use castnet_posix, only: read_file, system_words
  use castnet_scene, only: scene_t
  use castnet_study_request, only: vary_group_t
  use castnet_text, only: text_t, to_text, path_beside
  implicit none
  private
  public :: scene_files, data_contents, varied_contents, text_contents, check_same_contents

contains

  !> Every file that a run of the scene reads: its own, the included ones, net, mesh.
  subroutine scene_files(scene, files)
    type(scene_t), intent(in) :: scene
    type(text_t), allocatable, intent(out) :: files(:)
    type(text_t), allocatable :: data(:)
    integer :: i, n
    call data_files(scene, data)
    n = 1
    if (allocated(scene%included)) n = 1 + size(scene%included)
    allocate (files(n + size(data)))
    files(1)%chars = scene%path
    do i = 2, n
      files(i)%chars = scene%included(i - 1)%chars
    end do
    do i = 1, size(data)
      files(n + i)%chars = data(i)%chars
    end do
  end subroutine scene_files

  !> The net's and the mesh's file, where the scene has them.
  subroutine data_files(scene, files, keys)
    type(scene_t), intent(in) :: scene
    type(text_t), allocatable, intent(out) :: files(:)
    type(text_t), allocatable, intent(out), optional :: keys(:)  !! the keys that name them
    type(text_t) :: found(2), named(2)
    integer :: i, n
    n = 0
    if (allocated(scene%net)) then
      if (scene%net%kind == 'file') call add('net/file', scene%net%file)
    end if
    if (allocated(scene%target)) then
      if (scene%target%shape == 'mesh') call add('target/file', scene%target%file)
    end if
    allocate (files(n))
    if (present(keys)) allocate (keys(n))
    do i = 1, n
      files(i)%chars = found(i)%chars
      if (present(keys)) keys(i)%chars = named(i)%chars
    end do

  contains

    subroutine add(key, file)
      character(len=*), intent(in) :: key, file
      if (len_trim(file) == 0) return
      n = n + 1
      named(n)%chars = key
      found(n)%chars = path_beside(scene%path, trim(file))
    end subroutine add

  end subroutine data_files

  !> What is in the net's and the mesh's file: a line 'key: N bytes, checksum X' for each,
  !> '' for a scene without. A file that cannot be read has the reason there: whoever reads
  !> it for the run refuses it.
  function data_contents(scene) result(lines)
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: lines
    type(text_t), allocatable :: files(:), keys(:)
    integer :: i
    call data_files(scene, files, keys)
    lines = ''
    do i = 1, size(files)
      lines = lines//keys(i)%chars//': '//file_contents(files(i)%chars)//new_line('a')
    end do
  end function data_contents

  !> What is in the files that a study's varied keys name, as `data_contents`, one line for
  !> each value; where a key says whether a file is read, in the one that the scene names.
  function varied_contents(scene, vary) result(lines)
    type(scene_t), intent(in) :: scene             !! the study's base scene
    type(vary_group_t), intent(in) :: vary(:)
    character(len=:), allocatable :: lines
    type(scene_t) :: reader
    integer :: i, j
    lines = ''
    do i = 1, size(vary)
      select case (trim(vary(i)%key))
      case ('net/file', 'target/file')
        if (.not. allocated(vary(i)%values)) cycle
        do j = 1, size(vary(i)%values)
          lines = lines//trim(vary(i)%key)//': '// &
                  file_contents(path_beside(scene%path, without_quotes(trim(vary(i)%values(j)))))//new_line('a')
        end do
      case ('net/kind', 'target/shape')
        reader = scene
        if (allocated(reader%net)) reader%net%kind = 'file'
        if (allocated(reader%target)) reader%target%shape = 'mesh'
        lines = lines//data_contents(reader)
      end select
    end do
  end function varied_contents

  pure function without_quotes(text) result(words)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: words
    words = text
    if (len(text) < 2) return
    if (text(1:1) == "'" .or. text(1:1) == '"') words = text(2:len(text) - 1)
  end function without_quotes

  !> What is in the files that the scene includes, as `data_contents`, in their order. Their
  !> names are left out: the same study from another folder is the same study.
  function text_contents(scene) result(lines)
    type(scene_t), intent(in) :: scene
    character(len=:), allocatable :: lines
    integer :: i
    lines = ''
    if (.not. allocated(scene%included)) return
    do i = 1, size(scene%included)
      lines = lines//'include/file: '//file_contents(scene%included(i)%chars)//new_line('a')
    end do
  end function text_contents

  !> 'N bytes, checksum X': CRC-64, as 16 hexadecimal digits.
  function file_contents(path) result(text)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: text, bytes
    character(len=16) :: digits
    integer :: number
    number = read_file(path, bytes)
    if (number /= 0) then
      text = 'not readable ('//system_words(number)//')'
      return
    end if
    write (digits, '(z16.16)') checksum(bytes)
    text = to_text(len(bytes, kind=i8))//' bytes, checksum '//digits
  end function file_contents

  !> Refuse a restart when the net's or the mesh's file holds something else than when the
  !> checkpoint was written. Both texts are from `data_contents`. Errors: exit_input.
  subroutine check_same_contents(before, now, checkpoint, error)
    character(len=*), intent(in) :: before      !! of the checkpoint
    character(len=*), intent(in) :: now         !! of this run
    character(len=*), intent(in) :: checkpoint  !! its path, for the message
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: list
    integer :: first, last, colon
    if (allocated(error) .or. before == now) return
    list = ''
    first = 1
    do while (first <= len(now))
      last = first + index(now(first:), new_line('a')) - 2
      colon = first + index(now(first:last), ': ') - 1
      if (index(new_line('a')//before, new_line('a')//now(first:last)//new_line('a')) == 0) &
        list = list//new_line('a')//'  '//now(first:colon - 1)//': '//contents_of(now(first:colon - 1), before)// &
               ' then, '//now(colon + 2:last)//' now'
      first = last + 2
    end do
    call fail(error, exit_input, "cannot restart from '"//checkpoint//"': a file that the scene reads holds something else"// &
              ' than when it was written; put it back or run from the start'//list)
  end subroutine check_same_contents

  !> The words behind 'key: ' in lines of contents.
  pure function contents_of(key, lines) result(words)
    character(len=*), intent(in) :: key, lines
    character(len=:), allocatable :: words
    integer :: first, n
    words = 'no file'
    first = index(new_line('a')//lines, new_line('a')//key//': ')
    if (first == 0) return
    n = index(lines(first:), new_line('a'))
    words = lines(first + len(key) + 2:first + n - 2)
  end function contents_of

end module castnet_scene_files
