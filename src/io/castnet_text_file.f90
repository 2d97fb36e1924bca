!> A whole text file into memory, with a bound on its size.
module castnet_text_file
  use castnet_error, only: error_t, fail, exit_input, exit_file
  use castnet_text, only: byte_text
  use castnet_kinds, only: wp
  implicit none
  private
  public :: read_text_file, write_text_file, file_exists

  integer, parameter :: most_bytes = 4*1024*1024  !! a scene is a page, a study's list may be long

contains

  !> Read a file, a pipe too. Missing, a folder, too large: `exit_input`; not readable: `exit_file`.
  subroutine read_text_file(path, text, error)
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(error_t), allocatable, intent(inout) :: error
    character(len=256) :: message
    integer :: unit, status, bytes
    logical :: exists
    text = ''
    inquire (file=path, exist=exists)
    if (.not. exists) then
      call fail(error, exit_input, path//': there is no such file')
      return
    end if
    open (newunit=unit, file=path, access='stream', form='unformatted', status='old', action='read', &
          iostat=status, iomsg=message)
    if (status /= 0) then
      call fail(error, merge(exit_file, exit_input, index(message, 'ermission') > 0), &
                path//': cannot be opened for reading ('//trim(message)//')')
      return
    end if
    inquire (unit=unit, size=bytes)
    if (bytes > most_bytes) then
      call fail(error, exit_input, path//': seen '//byte_text(real(bytes, wp))//'; allowed: a text of at most '// &
                byte_text(real(most_bytes, wp)))
    else if (bytes > 0) then
      deallocate (text)
      allocate (character(len=bytes) :: text)
      read (unit, iostat=status, iomsg=message) text
      if (status /= 0) call fail(error, exit_input, path//': cannot be read ('//trim(message)//')')
    else
      call read_pipe(unit, path, text, error)
    end if
    close (unit, iostat=status)
  end subroutine read_text_file

  !> What has no size beforehand, byte by byte.
  subroutine read_pipe(unit, path, text, error)
    integer, intent(in) :: unit
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(inout) :: text
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: grown
    character(len=1) :: byte
    integer :: n, status
    allocate (character(len=4096) :: grown)
    n = 0
    do
      read (unit, iostat=status) byte
      if (status /= 0) exit
      if (n == most_bytes) then
        call fail(error, exit_input, path//': seen more than '//byte_text(real(most_bytes, wp))//', the most a text may have')
        return
      end if
      if (n == len(grown)) grown = grown//repeat(' ', n)
      n = n + 1
      grown(n:n) = byte
    end do
    text = grown(:n)
  end subroutine read_pipe

  !> Write a new text file; an old one only with `replace`. Anything in the way: `exit_file`.
  subroutine write_text_file(path, text, replace, error)
    character(len=*), intent(in) :: path, text
    logical, intent(in) :: replace
    type(error_t), allocatable, intent(inout) :: error
    character(len=256) :: message
    integer :: unit, status, bytes
    if (file_exists(path) .and. .not. replace) then
      call fail(error, exit_file, path//': exists already; give another name, or --force to replace it')
      return
    end if
    open (newunit=unit, file=path, access='stream', form='unformatted', status='replace', action='write', &
          iostat=status, iomsg=message)
    if (status /= 0) then
      call fail(error, exit_file, path//': cannot be written ('//trim(message)//')')
      return
    end if
    write (unit, iostat=status, iomsg=message) text
    close (unit)
    ! A full disk is silent in flush and close: the size tells.
    inquire (file=path, size=bytes)
    if (status /= 0 .or. bytes /= len(text)) call fail(error, exit_file, path//': could not be written in full (disk full?)')
  end subroutine write_text_file

  logical function file_exists(path)
    character(len=*), intent(in) :: path
    inquire (file=path, exist=file_exists)
  end function file_exists

end module castnet_text_file
