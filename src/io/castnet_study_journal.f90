!> The cases of a study as they finish: one file that only grows, the study's source of
!> truth. The table is made from it, and can be made anew at any time.
!>
!>   header   'CASTNETS', format, identity of the study, varied keys, bytes of a record
!>   record   case, point, seed, status, values, measures, reason, CRC-64 of the rest
!>
!> A record that a kill cut short fails its checksum and is dropped with all behind it;
!> its case is then simply run again.
module castnet_study_journal
  use castnet_kinds, only: wp, i8
  use castnet_archive, only: checksum
  use castnet_error, only: error_t, fail, exit_file, exit_input
  use castnet_posix, only: append_file, read_file, sync_path, file_failure, path_kind, path_nothing
  use castnet_study_record, only: case_row_t, n_measure, reason_length
  implicit none
  private
  public :: journal_t, open_journal, append_case, sync_journal, read_journal, study_identity

  integer, parameter :: header_bytes = 40
  integer(i8), parameter :: format_version = 1

  type :: journal_t
    character(len=:), allocatable :: path
    integer(i8) :: length = 0          !! bytes that are good
    integer :: n_vary = 0
    logical :: unsynced = .false.
  end type journal_t

contains

  !> What makes two studies the same: every character of their text and their scene's. A
  !> case is known by its number, and more runs a point would number the cases anew.
  pure integer(i8) function study_identity(text)
    character(len=*), intent(in) :: text
    study_identity = checksum(text)
  end function study_identity

  !> Open or make a journal; `rows` are the cases it holds. Errors: exit_file; exit_input
  !> when it belongs to another study.
  subroutine open_journal(journal, path, identity, n_vary, rows, error)
    type(journal_t), intent(out) :: journal
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: identity
    integer, intent(in) :: n_vary
    type(case_row_t), allocatable, intent(out) :: rows(:)
    type(error_t), allocatable, intent(inout) :: error
    integer :: number

    journal%path = path
    journal%n_vary = n_vary
    allocate (rows(0))
    if (path_kind(path) == path_nothing) then
      number = append_file(path, 0_i8, header(identity, n_vary))
      journal%length = header_bytes
      if (number /= 0) call file_failure(error, number, 'cannot write', path, 'choose another folder with --output')
    else
      call read_journal(path, identity, n_vary, rows, journal%length, error)
      ! What lies behind the last good record is cut off now.
      if (.not. allocated(error)) then
        number = append_file(path, journal%length, '')
        if (number /= 0) call file_failure(error, number, 'cannot write', path, 'choose another folder with --output')
      end if
    end if
  end subroutine open_journal

  !> Every good record. Errors as `open_journal`.
  subroutine read_journal(path, identity, n_vary, rows, length, error)
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: identity
    integer, intent(in) :: n_vary
    type(case_row_t), allocatable, intent(out) :: rows(:)
    integer(i8), intent(out) :: length           !! bytes that are good
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: bytes
    integer(i8) :: n, k, size_of, at
    integer :: number
    logical :: good

    allocate (rows(0))
    length = 0
    number = read_file(path, bytes)
    if (number /= 0) then
      call file_failure(error, number, 'cannot read', path, 'check that it is there and readable')
      return
    end if
    if (len(bytes) < header_bytes) then
      call fail(error, exit_file, "'"//path//"' is no journal of a study; remove it or choose another --output")
      return
    end if
    if (bytes(1:8) /= 'CASTNETS' .or. to_long(bytes(9:16)) /= format_version) then
      call fail(error, exit_file, "'"//path//"' is no journal of this castnet's studies; remove it or choose another --output")
      return
    end if
    if (to_long(bytes(17:24)) /= identity .or. to_long(bytes(25:32)) /= n_vary) then
      call fail(error, exit_input, "'"//path//"' holds the cases of another study or scene; choose another --output, or "// &
                '--force to begin anew')
      return
    end if
    size_of = record_bytes(n_vary)
    n = (len(bytes, kind=i8) - header_bytes)/size_of
    deallocate (rows)
    allocate (rows(n))
    do k = 1, n
      at = header_bytes + (k - 1)*size_of
      call unpack_record(bytes(at + 1:at + size_of), n_vary, rows(k), good)
      if (.not. good) exit
    end do
    rows = rows(:k - 1)
    length = header_bytes + (k - 1)*size_of
  end subroutine read_journal

  !> Write one finished case behind the others. Errors: exit_file; those before stay.
  subroutine append_case(journal, row, error)
    type(journal_t), intent(inout) :: journal
    type(case_row_t), intent(in) :: row
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: bytes
    integer :: number

    bytes = packed_record(row)
    number = append_file(journal%path, journal%length, bytes)
    if (number /= 0) then
      call file_failure(error, number, 'cannot write a finished case to', journal%path, &
                        'make room and start the study again: it does only what is missing')
      return
    end if
    journal%length = journal%length + len(bytes)
    journal%unsynced = .true.
  end subroutine append_case

  !> Force what was written to the disk.
  subroutine sync_journal(journal)
    type(journal_t), intent(inout) :: journal
    integer :: ignored
    if (journal%unsynced) ignored = sync_path(journal%path)
    journal%unsynced = .false.
  end subroutine sync_journal

  function header(identity, n_vary) result(bytes)
    integer(i8), intent(in) :: identity
    integer, intent(in) :: n_vary
    character(len=header_bytes) :: bytes
    bytes = 'CASTNETS'//from_long(format_version)//from_long(identity)//from_long(int(n_vary, i8))// &
            from_long(record_bytes(n_vary))
  end function header

  pure integer(i8) function record_bytes(n_vary)
    integer, intent(in) :: n_vary
    record_bytes = 8*(4 + n_vary + n_measure + 1) + reason_length
  end function record_bytes

  function packed_record(row) result(bytes)
    type(case_row_t), intent(in) :: row
    character(len=:), allocatable :: bytes
    integer :: i
    bytes = from_long(row%case)//from_long(row%point)//from_long(row%seed)//from_long(int(row%status, i8))
    do i = 1, size(row%varied)
      bytes = bytes//from_long(transfer(row%varied(i), 0_i8))
    end do
    do i = 1, n_measure
      bytes = bytes//from_long(transfer(row%measure(i), 0_i8))
    end do
    bytes = bytes//row%reason
    bytes = bytes//from_long(checksum(bytes))
  end function packed_record

  subroutine unpack_record(bytes, n_vary, row, good)
    character(len=*), intent(in) :: bytes
    integer, intent(in) :: n_vary
    type(case_row_t), intent(out) :: row
    logical, intent(out) :: good
    integer :: i, at, n
    n = len(bytes)
    good = to_long(bytes(n - 7:n)) == checksum(bytes(1:n - 8))
    if (.not. good) return
    row%case = to_long(bytes(1:8))
    row%point = to_long(bytes(9:16))
    row%seed = to_long(bytes(17:24))
    row%status = int(to_long(bytes(25:32)))
    allocate (row%varied(n_vary))
    at = 32
    do i = 1, n_vary
      row%varied(i) = transfer(to_long(bytes(at + 1:at + 8)), 0.0_wp)
      at = at + 8
    end do
    do i = 1, n_measure
      row%measure(i) = transfer(to_long(bytes(at + 1:at + 8)), 0.0_wp)
      at = at + 8
    end do
    row%reason = bytes(at + 1:at + reason_length)
  end subroutine unpack_record

  pure function from_long(value) result(bytes)
    integer(i8), intent(in) :: value
    character(len=8) :: bytes
    bytes = transfer(value, bytes)
  end function from_long

  pure integer(i8) function to_long(bytes)
    character(len=8), intent(in) :: bytes
    to_long = transfer(bytes, 0_i8)
  end function to_long

end module castnet_study_journal
