!> Checkpoints: the whole of `state_t`, to the bit, and the scene that it belongs to with
!> the checksums of the files that the scene reads.
!>
!> A format of our own rather than HDF5: a few dozen arrays that nobody plots, written in
!> one call whose every failure the system reports at once, covered by one checksum, and
!> free of a library that a full disk can leave in an unknown state.
!>
!>   bytes  1-8   'CASTNETC'
!>          9-16  1 as a 64-bit integer: byte order and version of the format
!>         17-24  bytes of the payload
!>         25-32  CRC-64 of the payload
!>         33-    payload: name, kind, shape, values of each component
!>
!> Beside OUTPUT: written to OUTPUT.tmp, forced to the disk, read back and compared,
!> OUTPUT.checkpoint kept as OUTPUT.checkpoint.previous, and then replaced in one act. At
!> no moment is there no good checkpoint.
module castnet_checkpoint
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_file
  use castnet_state, only: state_t, body_state_t, closing_state_t, deployment_state_t
  use castnet_record, only: capture_measures_t
  use castnet_text, only: folder_of
  use castnet_posix, only: create_file, read_file, rename_file, remove_file, link_file, sync_path, file_failure, path_kind, &
                           path_nothing, path_folder, system_words
  use castnet_archive, only: archive_t, start_saving, start_loading, archived_bytes, exchange, exchange_presence, &
                             is_used_up, checksum
  implicit none
  private
  public :: write_checkpoint, read_checkpoint, state_hash, checkpoint_path

  character(len=8), parameter :: magic = 'CASTNETC'
  integer(i8), parameter :: format_version = 1
  integer, parameter :: header_length = 32

contains

  !> Where the checkpoints of a run stand.
  pure function checkpoint_path(output) result(path)
    character(len=*), intent(in) :: output
    character(len=:), allocatable :: path
    path = output//'.checkpoint'
  end function checkpoint_path

  !> Write OUTPUT.checkpoint. On an error the one that was there is still there.
  subroutine write_checkpoint(output, state, effective_scene, contents, error)
    character(len=*), intent(in) :: output            !! OUTPUT: the checkpoint stands beside it
    type(state_t), intent(in) :: state
    character(len=*), intent(in) :: effective_scene   !! every group and key with its value
    character(len=*), intent(in) :: contents          !! of the files that the scene reads
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: bytes, seen, aside, path
    integer :: number, ignored
    if (allocated(error)) return
    path = checkpoint_path(output)
    aside = output//'.tmp'
    bytes = packed(state, effective_scene, contents)
    ignored = remove_file(aside)
    number = create_file(aside, bytes)
    if (number /= 0) then
      call file_failure(error, number, 'cannot write the checkpoint', aside, 'check that the folder is there and writable')
    else
      number = read_file(aside, seen)
      if (number /= 0 .or. len(seen, kind=i8) /= len(bytes, kind=i8)) then
        call fail(error, exit_file, "the checkpoint '"//aside//"' cannot be read back; check the disk")
      else if (seen /= bytes) then
        call fail(error, exit_file, "the checkpoint '"//aside//"' reads back other than it was written; check the disk")
      end if
    end if
    if (allocated(error)) then
      ignored = remove_file(aside)
      return
    end if
    call keep_previous(path)
    number = rename_file(aside, path)
    if (number /= 0) call file_failure(error, number, 'cannot put the checkpoint in its place', path, &
                                       'it stands beside it as .tmp')
    ignored = sync_path(folder_of(path)//'.')
  end subroutine write_checkpoint

  !> A second name for the checkpoint that is about to be replaced. A file system without
  !> such names gets a rename: then there is no checkpoint of the plain name for a moment,
  !> and `read_checkpoint` finds the previous one.
  subroutine keep_previous(path)
    character(len=*), intent(in) :: path
    integer :: number
    if (path_kind(path) == path_nothing) return
    number = remove_file(path//'.previous')
    number = link_file(path, path//'.previous')
    if (number /= 0) number = rename_file(path, path//'.previous')
  end subroutine keep_previous

  !> Read a checkpoint; if it is damaged or missing the previous one, with a warning.
  !> Errors: exit_file when neither is good.
  subroutine read_checkpoint(path, state, effective_scene, contents, warning, error)
    character(len=*), intent(in) :: path                           !! FILE of --restart FILE
    type(state_t), intent(out) :: state
    character(len=:), allocatable, intent(out) :: effective_scene, contents
    character(len=:), allocatable, intent(out) :: warning          !! allocated when the previous one was used
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: problem, second
    if (allocated(error)) return
    call read_one(path, state, effective_scene, contents, problem)
    if (.not. allocated(problem)) return
    call read_one(path//'.previous', state, effective_scene, contents, second)
    if (allocated(second)) then
      call fail(error, exit_file, "cannot restart from '"//path//"': "//problem//"; its '.previous': "//second// &
                '; name another checkpoint or run the scene from the start')
    else
      warning = "the checkpoint '"//path//"' cannot be used: "//problem//"; going on from '"//path//".previous'"
    end if
  end subroutine read_checkpoint

  subroutine read_one(path, state, effective_scene, contents, problem)
    character(len=*), intent(in) :: path
    type(state_t), intent(out) :: state
    character(len=:), allocatable, intent(out) :: effective_scene, contents, problem
    character(len=:), allocatable :: bytes
    integer :: number
    select case (path_kind(path))
    case (path_nothing)
      problem = 'there is no such file'
      return
    case (path_folder)
      problem = 'it is a folder'
      return
    end select
    number = read_file(path, bytes)
    if (number /= 0) then
      problem = system_words(number)
    else
      call unpack(bytes, state, effective_scene, contents, problem)
    end if
  end subroutine read_one

  !> The file's bytes.
  function packed(state, effective_scene, contents) result(bytes)
    type(state_t), intent(in) :: state
    character(len=*), intent(in) :: effective_scene, contents
    character(len=:), allocatable :: bytes, payload, scene, held
    type(archive_t) :: archive
    type(state_t) :: copy
    scene = effective_scene
    held = contents
    copy = state
    call start_saving(archive)
    call exchange(archive, 'effective_scene', scene)
    call exchange(archive, 'contents', held)
    call exchange_state(archive, copy)
    payload = archived_bytes(archive)
    bytes = magic//eight(format_version)//eight(len(payload, kind=i8))//eight(checksum(payload))//payload
  end function packed

  pure function eight(value) result(bytes)
    integer(i8), intent(in) :: value
    character(len=8) :: bytes
    bytes = transfer(value, bytes)
  end function eight

  subroutine unpack(bytes, state, effective_scene, contents, problem)
    character(len=*), intent(in) :: bytes
    type(state_t), intent(inout) :: state
    character(len=:), allocatable, intent(inout) :: effective_scene, contents, problem
    type(archive_t) :: archive
    integer(i8) :: number(3)
    if (len(bytes, kind=i8) < header_length) then
      problem = 'it is cut short'
      return
    end if
    number = transfer(bytes(9:header_length), number)
    if (bytes(1:8) /= magic) then
      problem = 'it is no checkpoint of castnet'
    else if (number(1) /= format_version) then
      problem = 'it is of another version of castnet or another kind of machine'
    else if (number(2) > len(bytes, kind=i8) - header_length) then
      problem = 'it is cut short'
    else if (number(2) /= len(bytes, kind=i8) - header_length) then
      problem = 'it is longer than it says'
    else if (number(3) /= checksum(bytes(header_length + 1:))) then
      problem = 'its checksum is wrong'
    end if
    if (allocated(problem)) return
    call start_loading(archive, bytes(header_length + 1:))
    call exchange(archive, 'effective_scene', effective_scene)
    call exchange(archive, 'contents', contents)
    call exchange_state(archive, state)
    if (allocated(archive%problem)) then
      problem = 'it is of another version of castnet: '//archive%problem
    else if (.not. is_used_up(archive)) then
      problem = 'it is of another version of castnet: it holds more than a state'
    end if
  end subroutine unpack

  !> Every component of `state_t`, once: a new one is one line here.
  subroutine exchange_state(archive, state)
    type(archive_t), intent(inout) :: archive
    type(state_t), intent(inout) :: state
    logical :: there
    call exchange(archive, 'step', state%step)
    call exchange(archive, 'time', state%time)
    call exchange(archive, 'force_evaluations', state%force_evaluations)
    call exchange(archive, 'node_position', state%node_position)
    call exchange(archive, 'node_velocity', state%node_velocity)
    call exchange(archive, 'velocity_ahead', state%velocity_ahead)
    call exchange(archive, 'substep', state%substep)
    there = allocated(state%target)
    call exchange_presence(archive, 'target', there)
    if (there) then
      if (.not. allocated(state%target)) allocate (state%target)
      call exchange_body(archive, state%target)
    end if
    there = allocated(state%closing)
    call exchange_presence(archive, 'closing', there)
    if (there) then
      if (.not. allocated(state%closing)) allocate (state%closing)
      call exchange_closing(archive, state%closing)
    end if
    there = allocated(state%deployment)
    call exchange_presence(archive, 'deployment', there)
    if (there) then
      if (.not. allocated(state%deployment)) allocate (state%deployment)
      call exchange_deployment(archive, state%deployment)
    end if
    call exchange(archive, 'ledger/dissipated', state%ledger%dissipated)
    call exchange(archive, 'ledger/contact_loss', state%ledger%contact_loss)
    call exchange(archive, 'ledger/winch_work', state%ledger%winch_work)
    call exchange(archive, 'ledger/projection_work', state%ledger%projection_work)
    call exchange(archive, 'ledger/external_work', state%ledger%external_work)
    call exchange(archive, 'tally/contacts', state%tally%contacts)
    call exchange(archive, 'tally/max_impulse', state%tally%max_impulse)
    call exchange(archive, 'tally/min_impulse', state%tally%min_impulse)
    call exchange(archive, 'tally/impulse_sum', state%tally%impulse_sum)
    call exchange(archive, 'tally/max_bullet_impulse', state%tally%max_bullet_impulse)
    call exchange(archive, 'tally/deepest_penetration', state%tally%deepest_penetration)
    call exchange(archive, 'tally/max_tension', state%tally%max_tension)
    call exchange(archive, 'tally/contact_residual', state%tally%contact_residual)
    call exchange(archive, 'tally/contact_iterations', state%tally%contact_iterations)
    call exchange(archive, 'schedule/frames', state%schedule%frames)
    call exchange(archive, 'schedule/rows', state%schedule%rows)
    call exchange(archive, 'schedule/verdicts', state%schedule%verdicts)
    call exchange(archive, 'schedule/checkpoints', state%schedule%checkpoints)
    call exchange(archive, 'schedule/frame_step', state%schedule%frame_step)
    call exchange(archive, 'schedule/row_step', state%schedule%row_step)
    call exchange(archive, 'schedule/checkpoint_step', state%schedule%checkpoint_step)
    call exchange(archive, 'first_contact', state%first_contact)
    call exchange(archive, 'impulse_histogram', state%impulse_histogram)
    call exchange_measures(archive, state%measures)
    call exchange(archive, 'self_contacts', state%self_contacts)
    call exchange(archive, 'skip_contact_until', state%skip_contact_until)
  end subroutine exchange_state

  subroutine exchange_body(archive, body)
    type(archive_t), intent(inout) :: archive
    type(body_state_t), intent(inout) :: body
    call exchange(archive, 'target/position', body%position)
    call exchange(archive, 'target/velocity', body%velocity)
    call exchange(archive, 'target/attitude', body%attitude)
    call exchange(archive, 'target/angular_velocity', body%angular_velocity)
  end subroutine exchange_body

  subroutine exchange_closing(archive, closing)
    type(archive_t), intent(inout) :: archive
    type(closing_state_t), intent(inout) :: closing
    call exchange(archive, 'closing/triggered', closing%triggered)
    call exchange(archive, 'closing/start_time', closing%start_time)
    call exchange(archive, 'closing/pulling', closing%pulling)
    call exchange(archive, 'closing/rest_length', closing%rest_length)
    call exchange(archive, 'closing/locked', closing%locked)
  end subroutine exchange_closing

  subroutine exchange_deployment(archive, deployment)
    type(archive_t), intent(inout) :: archive
    type(deployment_state_t), intent(inout) :: deployment
    call exchange(archive, 'deployment/begun', deployment%begun)
    call exchange(archive, 'deployment/start', deployment%start)
    call exchange(archive, 'deployment/time', deployment%time)
    call exchange(archive, 'deployment/area', deployment%area)
    call exchange(archive, 'deployment/distance', deployment%distance)
    call exchange(archive, 'deployment/largest_area', deployment%largest_area)
    call exchange(archive, 'deployment/largest_time', deployment%largest_time)
    call exchange(archive, 'deployment/largest_distance', deployment%largest_distance)
    call exchange(archive, 'deployment/time_at', deployment%time_at)
  end subroutine exchange_deployment

  !> The capture measures taken so far, as a table.
  subroutine exchange_measures(archive, measures)
    type(archive_t), intent(inout) :: archive
    type(capture_measures_t), allocatable, intent(inout) :: measures(:)
    real(wp), allocatable :: table(:, :)
    integer :: i
    if (archive%saving .and. allocated(measures)) then
      allocate (table(10, size(measures)))
      do i = 1, size(measures)
        associate (m => measures(i))
          table(:, i) = [m%time, m%coverage, m%largest_hole, m%escape, m%cqi, m%mouth_area, m%mouth_perimeter, &
                         m%bullet_distance_min, m%bullet_distance_max, real(m%verdict, wp)]
        end associate
      end do
    end if
    call exchange(archive, 'measures', table)
    if (archive%saving) return
    if (allocated(measures)) deallocate (measures)
    if (allocated(archive%problem) .or. .not. allocated(table)) return
    if (size(table, 1) /= 10) then
      archive%problem = 'measures has another shape'
      return
    end if
    allocate (measures(size(table, 2)))
    do i = 1, size(measures)
      measures(i) = capture_measures_t(table(1, i), table(2, i), table(3, i), table(4, i), table(5, i), table(6, i), &
                                       table(7, i), table(8, i), table(9, i), nint(table(10, i)))
    end do
  end subroutine exchange_measures

  !> A number that two states share only if every bit of them is the same (but for one
  !> chance in 2**64): for tests of reproducibility.
  integer(i8) function state_hash(state)
    type(state_t), intent(in) :: state
    type(archive_t) :: archive
    type(state_t) :: copy
    copy = state
    call start_saving(archive)
    call exchange_state(archive, copy)
    state_hash = checksum(archived_bytes(archive))
  end function state_hash

end module castnet_checkpoint
