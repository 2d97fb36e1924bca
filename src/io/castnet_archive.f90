!> A row of named values as bytes, written and read by the same list of calls: a type is
!> stored by one procedure that calls `exchange` once for each component, whichever way
!> the archive runs, so that saving and loading cannot drift apart.
!>
!> Each value is preceded by its name, kind and shape; loading compares them before it
!> believes a size. Bytes are this machine's own: bits survive exactly.
module castnet_archive
  use castnet_kinds, only: wp, i4, i8
  implicit none
  private
  public :: archive_t, start_saving, start_loading, archived_bytes, exchange, exchange_presence, is_used_up, checksum

  integer, parameter :: name_length = 32
  integer(i8), parameter :: first_size = 65536_i8

  type :: archive_t
    logical :: saving = .true.
    character(len=:), allocatable :: problem     !! what does not fit; allocated once something does not
    character(len=:), allocatable, private :: bytes
    integer(i8), private :: used = 0             !! bytes written or read so far
  end type archive_t

  !> One component: stored when saving, set when loading. One-dimensional reals and logicals
  !> are of declared size; the other arrays are allocatable, and come back not allocated if
  !> they were saved so.
  interface exchange
    module procedure exchange_real, exchange_long, exchange_integer, exchange_logical, exchange_text, &
      exchange_reals, exchange_reals_2, exchange_longs_1, exchange_logicals
  end interface exchange

contains

  subroutine start_saving(archive)
    type(archive_t), intent(out) :: archive
    allocate (character(len=first_size) :: archive%bytes)
  end subroutine start_saving

  !> Read from these bytes.
  subroutine start_loading(archive, bytes)
    type(archive_t), intent(out) :: archive
    character(len=*), intent(in) :: bytes
    archive%saving = .false.
    archive%bytes = bytes
  end subroutine start_loading

  !> What has been saved.
  function archived_bytes(archive) result(bytes)
    type(archive_t), intent(in) :: archive
    character(len=:), allocatable :: bytes
    bytes = archive%bytes(1:archive%used)
  end function archived_bytes

  !> Has everything been read?
  logical function is_used_up(archive)
    type(archive_t), intent(in) :: archive
    is_used_up = archive%used == len(archive%bytes, kind=i8)
  end function is_used_up

  ! ---- bytes ------------------------------------------------------------------------

  subroutine put(archive, bytes)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: bytes
    character(len=:), allocatable :: larger
    integer(i8) :: needed
    needed = archive%used + len(bytes, kind=i8)
    if (needed > len(archive%bytes, kind=i8)) then
      allocate (character(len=2*needed) :: larger)
      larger(1:archive%used) = archive%bytes(1:archive%used)
      call move_alloc(larger, archive%bytes)
    end if
    archive%bytes(archive%used + 1:needed) = bytes
    archive%used = needed
  end subroutine put

  !> The next n bytes; a problem when there are fewer.
  subroutine take(archive, name, n, bytes)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: n
    character(len=:), allocatable, intent(out) :: bytes
    if (allocated(archive%problem)) return
    if (n < 0 .or. n > len(archive%bytes, kind=i8) - archive%used) then
      archive%problem = 'it ends before '//trim(name)
      return
    end if
    bytes = archive%bytes(archive%used + 1:archive%used + n)
    archive%used = archive%used + n
  end subroutine take

  !> Name, kind, shape; `present` is false for an array that is not allocated. When loading
  !> a rank of -1 says so, and the shape comes back in `extent`.
  subroutine exchange_header(archive, name, kind, rank, extent, present)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    character(len=1), intent(in) :: kind
    integer, intent(in) :: rank
    integer(i8), intent(inout) :: extent(2)
    logical, intent(inout) :: present
    character(len=:), allocatable :: bytes
    character(len=name_length) :: label
    integer(i8) :: header(3)
    label = name
    if (archive%saving) then
      header = [merge(int(rank, i8), -1_i8, present), extent]
      call put(archive, label//kind//transfer(header, repeat(' ', 24)))
      return
    end if
    call take(archive, name, int(name_length + 25, i8), bytes)
    if (allocated(archive%problem)) return
    if (bytes(1:name_length) /= label .or. bytes(name_length + 1:name_length + 1) /= kind) then
      archive%problem = 'it holds '//trim(bytes(1:name_length))//' where '//name//' should stand'
      return
    end if
    header = transfer(bytes(name_length + 2:), header)
    present = header(1) >= 0
    if (present .and. header(1) /= rank) archive%problem = name//' has another shape'
    if (any(header(2:3) < 0)) archive%problem = name//' has a negative size'
    extent = header(2:3)
    ! the product of a shape that has been believed must fit what is left
    if (maxval(extent) > len(archive%bytes, kind=i8)) archive%problem = name//' is larger than the file'
  end subroutine exchange_header

  ! ---- values -------------------------------------------------------------------------

  subroutine exchange_real(archive, name, value)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: value
    real(wp) :: one(1)
    one(1) = value
    call exchange_reals(archive, name, one)
    value = one(1)
  end subroutine exchange_real

  subroutine exchange_long(archive, name, value)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    integer(i8), intent(inout) :: value
    character(len=:), allocatable :: bytes
    integer(i8) :: extent(2)
    logical :: there
    extent = 1
    there = .true.
    call exchange_header(archive, name, 'i', 0, extent, there)
    if (archive%saving) then
      call put(archive, transfer(value, repeat(' ', 8)))
    else
      call take(archive, name, 8_i8, bytes)
      if (.not. allocated(archive%problem)) value = transfer(bytes, value)
    end if
  end subroutine exchange_long

  subroutine exchange_integer(archive, name, value)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    integer(i4), intent(inout) :: value
    integer(i8) :: long
    long = value
    call exchange_long(archive, name, long)
    if (abs(long) <= huge(value)) value = int(long, i4)
  end subroutine exchange_integer

  subroutine exchange_logical(archive, name, value)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    logical, intent(inout) :: value
    integer(i8) :: long
    long = merge(1_i8, 0_i8, value)
    call exchange_long(archive, name, long)
    value = long /= 0
  end subroutine exchange_logical

  !> Is this part there? The caller allocates it when loading.
  subroutine exchange_presence(archive, name, present)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    logical, intent(inout) :: present
    call exchange_logical(archive, name, present)
    if (allocated(archive%problem)) present = .false.
  end subroutine exchange_presence

  subroutine exchange_text(archive, name, text)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    character(len=:), allocatable, intent(inout) :: text
    character(len=:), allocatable :: bytes
    integer(i8) :: extent(2)
    logical :: there
    extent = 0
    there = allocated(text)
    if (there) extent(1) = len(text, kind=i8)
    call exchange_header(archive, name, 't', 1, extent, there)
    if (archive%saving) then
      if (there) call put(archive, text)
      return
    end if
    if (allocated(text)) deallocate (text)
    if (allocated(archive%problem) .or. .not. there) return
    call take(archive, name, extent(1), bytes)
    call move_alloc(bytes, text)
  end subroutine exchange_text

  !> An array whose size is fixed by its declaration.
  subroutine exchange_reals(archive, name, values)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    real(wp), intent(inout) :: values(:)
    real(wp), allocatable :: copy(:)
    copy = values
    call exchange_reals_1(archive, name, copy)
    if (archive%saving .or. allocated(archive%problem)) return
    if (.not. allocated(copy)) then
      archive%problem = name//' is missing'
    else if (size(copy) /= size(values)) then
      archive%problem = name//' has another size'
    else
      values = copy
    end if
  end subroutine exchange_reals

  subroutine exchange_reals_1(archive, name, values)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(inout) :: values(:)
    character(len=:), allocatable :: bytes
    integer(i8) :: extent(2)
    logical :: there
    extent = 1
    there = allocated(values)
    if (there) extent(1) = size(values, kind=i8)
    call exchange_header(archive, name, 'r', 1, extent, there)
    if (archive%saving) then
      if (there) call put_reals(archive, values, extent(1))
      return
    end if
    if (allocated(values)) deallocate (values)
    if (allocated(archive%problem) .or. .not. there) return
    call take(archive, name, 8*extent(1), bytes)
    if (.not. allocated(archive%problem)) values = transfer(bytes, [real(wp) ::], extent(1))
  end subroutine exchange_reals_1

  subroutine exchange_reals_2(archive, name, values)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(inout) :: values(:, :)
    character(len=:), allocatable :: bytes
    integer(i8) :: extent(2)
    logical :: there
    extent = 1
    there = allocated(values)
    if (there) extent = shape(values, kind=i8)
    call exchange_header(archive, name, 'r', 2, extent, there)
    if (archive%saving) then
      if (there) call put_reals(archive, values, product(extent))
      return
    end if
    if (allocated(values)) deallocate (values)
    if (allocated(archive%problem) .or. .not. there) return
    if (extent(2) > 0) then
      if (extent(1) > len(archive%bytes, kind=i8)/extent(2)) archive%problem = name//' is larger than the file'
    end if
    call take(archive, name, 8*product(extent), bytes)
    if (.not. allocated(archive%problem)) &
      values = reshape(transfer(bytes, [real(wp) ::], product(extent)), int(extent))
  end subroutine exchange_reals_2

  subroutine put_reals(archive, values, n)
    type(archive_t), intent(inout) :: archive
    integer(i8), intent(in) :: n
    real(wp), intent(in) :: values(n)
    character(len=:), allocatable :: bytes
    allocate (character(len=8*n) :: bytes)
    bytes = transfer(values, bytes)
    call put(archive, bytes)
  end subroutine put_reals

  subroutine exchange_longs_1(archive, name, values)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    integer(i8), allocatable, intent(inout) :: values(:)
    character(len=:), allocatable :: bytes
    integer(i8) :: extent(2)
    logical :: there
    extent = 1
    there = allocated(values)
    if (there) extent(1) = size(values, kind=i8)
    call exchange_header(archive, name, 'i', 1, extent, there)
    if (archive%saving) then
      if (.not. there) return
      allocate (character(len=8*extent(1)) :: bytes)
      bytes = transfer(values, bytes)
      call put(archive, bytes)
      return
    end if
    if (allocated(values)) deallocate (values)
    if (allocated(archive%problem) .or. .not. there) return
    call take(archive, name, 8*extent(1), bytes)
    if (.not. allocated(archive%problem)) values = transfer(bytes, [integer(i8) ::], extent(1))
  end subroutine exchange_longs_1

  !> Logicals of a fixed number.
  subroutine exchange_logicals(archive, name, values)
    type(archive_t), intent(inout) :: archive
    character(len=*), intent(in) :: name
    logical, intent(inout) :: values(:)
    integer(i8), allocatable :: copy(:)
    copy = merge(1_i8, 0_i8, values)
    call exchange_longs_1(archive, name, copy)
    if (archive%saving .or. allocated(archive%problem)) return
    if (.not. allocated(copy)) then
      archive%problem = name//' is missing'
    else if (size(copy) /= size(values)) then
      archive%problem = name//' has another size'
    else
      values = copy /= 0
    end if
  end subroutine exchange_logicals

  !> CRC-64 (ECMA-182, reflected): finds every single and double flip and every burst up
  !> to 64 bits; anything else slips through once in 2**64.
  pure integer(i8) function checksum(bytes) result(crc)
    character(len=*), intent(in) :: bytes
    integer(i8), parameter :: polynomial = int(z'C96C5795D7870F42', i8)
    integer(i8) :: table(0:255), entry
    integer(i8) :: i
    integer :: bit, k
    do k = 0, 255
      entry = k
      do bit = 1, 8
        if (btest(entry, 0)) then
          entry = ieor(shiftr(entry, 1), polynomial)
        else
          entry = shiftr(entry, 1)
        end if
      end do
      table(k) = entry
    end do
    crc = not(0_i8)
    do i = 1, len(bytes, kind=i8)
      crc = ieor(shiftr(crc, 8), table(iand(int(ieor(crc, int(iachar(bytes(i:i)), i8))), 255)))
    end do
    crc = not(crc)
  end function checksum

end module castnet_archive
