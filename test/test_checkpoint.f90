!> Checkpoints: every bit comes back, and every damage is seen.
module test_checkpoint
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, exit_file, exit_input
  use castnet_state, only: state_t
  use castnet_record, only: capture_measures_t
  use castnet_posix, only: create_file, read_file, remove_file, path_kind, path_nothing, path_file, process_id
  use castnet_text, only: to_text
  use castnet_archive, only: checksum
  use castnet_checkpoint, only: write_checkpoint, read_checkpoint, state_hash, checkpoint_path
  use castnet_restart_check, only: check_same_scene
  use testing, only: test_case, expect, expect_equal
  implicit none
  private
  public :: run_test_checkpoint

contains

  subroutine run_test_checkpoint()
    call test_case('checkpoint: the checksum is CRC-64/XZ', test_checksum)
    call test_case('checkpoint: every component comes back to the bit', test_round_trip)
    call test_case('checkpoint: a state without parts comes back without them', test_bare_state)
    call test_case('checkpoint: every cut and every flipped bit is seen', test_damage)
    call test_case('checkpoint: the previous one serves when the last is damaged', test_previous)
    call test_case('checkpoint: a folder that is not there is exit 4', test_no_folder)
    call test_case('checkpoint: a restart with another scene is refused by name', test_same_scene)
  end subroutine run_test_checkpoint

  function output() result(path)
    character(len=:), allocatable :: path
    path = '/tmp/castnet_'//to_text(process_id())//'_checkpoint.h5'
  end function output

  subroutine clean()
    integer :: ignored
    ignored = remove_file(output()//'.checkpoint')
    ignored = remove_file(output()//'.checkpoint.previous')
  end subroutine clean

  !> A state in which every component differs from its default and from its neighbours.
  subroutine fill(state)
    type(state_t), intent(out) :: state
    integer :: i, k
    state%step = 2_i8**40 + 1
    state%time = 1.0_wp/3.0_wp
    state%force_evaluations = 2_i8**41 + 3
    allocate (state%node_position(8, 3), state%node_velocity(8, 3), state%velocity_ahead(8, 3))
    do k = 1, 3
      do i = 1, 8
        state%node_position(i, k) = i + k/7.0_wp
        state%node_velocity(i, k) = -i - k/11.0_wp
        state%velocity_ahead(i, k) = i*k/13.0_wp
      end do
    end do
    state%substep = 0.0123_wp
    state%node_position(1, 1) = -0.0_wp
    state%node_position(2, 1) = tiny(1.0_wp)*epsilon(1.0_wp)   ! subnormal
    allocate (state%target)
    state%target%position = [0.1_wp, 0.2_wp, 0.3_wp]
    state%target%velocity = [0.4_wp, 0.5_wp, 0.6_wp]
    state%target%attitude = [0.5_wp, -0.5_wp, 0.5_wp, -0.5_wp]
    state%target%angular_velocity = [0.7_wp, 0.8_wp, 0.9_wp]
    allocate (state%closing)
    state%closing%triggered = .true.
    state%closing%start_time = 1.25_wp
    state%closing%pulling = .true.
    state%closing%rest_length = [1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp]
    state%closing%locked = [.true., .false., .true., .false.]
    allocate (state%deployment)
    state%deployment%begun = .true.
    state%deployment%start = [5.1_wp, 5.2_wp, 5.3_wp]
    state%deployment%time = 5.4_wp
    state%deployment%area = 5.5_wp
    state%deployment%distance = 5.6_wp
    state%deployment%largest_area = 5.7_wp
    state%deployment%largest_time = 5.8_wp
    state%deployment%largest_distance = 5.9_wp
    state%deployment%time_at = [(i/7.0_wp, i=1, size(state%deployment%time_at))]
    state%ledger%dissipated = 0.11_wp
    state%ledger%contact_loss = 0.12_wp
    state%ledger%winch_work = 0.13_wp
    state%ledger%projection_work = 0.14_wp
    state%ledger%external_work = 0.15_wp
    state%tally%contacts = 2_i8**42 + 5
    state%tally%max_impulse = 0.21_wp
    state%tally%min_impulse = 0.22_wp
    state%tally%impulse_sum = 0.23_wp
    state%tally%max_bullet_impulse = 0.24_wp
    state%tally%deepest_penetration = 0.25_wp
    state%tally%max_tension = 0.26_wp
    state%tally%contact_residual = 0.27_wp
    state%tally%contact_iterations = 28
    state%schedule%frames = 31
    state%schedule%rows = 32
    state%schedule%verdicts = 33
    state%schedule%checkpoints = 34
    state%schedule%frame_step = 35
    state%schedule%row_step = 36
    state%schedule%checkpoint_step = 37
    state%first_contact = 0.41_wp
    state%impulse_histogram = [(int(i, i8)**7, i=1, 100)]
    state%self_contacts = [2_i8**43 + 1, 44_i8, 45_i8]
    allocate (state%measures(2))
    state%measures(1) = capture_measures_t(1.1_wp, 1.2_wp, 1.3_wp, 1.4_wp, 1.5_wp, 1.6_wp, 1.7_wp, 1.8_wp, 1.9_wp, 1)
    state%measures(2) = capture_measures_t(2.1_wp, 2.2_wp, 2.3_wp, 2.4_wp, 2.5_wp, 2.6_wp, 2.7_wp, 2.8_wp, 2.9_wp, 2)
    state%skip_contact_until = 0.42_wp
  end subroutine fill

  logical function same_bits(a, b)
    real(wp), intent(in) :: a(:), b(:)
    same_bits = size(a) == size(b)
    if (same_bits) same_bits = all(transfer(a, [integer(i8) ::]) == transfer(b, [integer(i8) ::]))
  end function same_bits

  subroutine test_checksum()
    call expect(checksum('123456789') == int(z'995DC9BBDF1939FA', i8), 'the published check value of CRC-64/XZ')
  end subroutine test_checksum

  subroutine test_round_trip()
    type(state_t) :: state, back
    type(error_t), allocatable :: error
    character(len=:), allocatable :: scene, contents, warning
    call fill(state)
    call write_checkpoint(output(), state, "&net"//new_line('a')//"/", 'net/file: 3', error)
    call read_checkpoint(checkpoint_path(output()), back, scene, contents, warning, error)
    call expect(.not. allocated(error), 'no error')
    call expect(.not. allocated(warning), 'no warning')
    call expect_equal(scene, "&net"//new_line('a')//"/", 'the scene')
    call expect_equal(contents, 'net/file: 3', 'the contents of its files')
    call expect_equal(path_kind(output()//'.tmp'), path_nothing, 'OUTPUT.tmp afterwards')
    call expect(back%step == state%step .and. back%force_evaluations == state%force_evaluations, 'counters')
    call expect(same_bits([back%time, back%first_contact, back%skip_contact_until, back%substep], &
                          [state%time, state%first_contact, state%skip_contact_until, state%substep]), 'times')
    call expect(same_bits([back%node_position], [state%node_position]), 'positions')
    call expect(all(shape(back%node_position) == [8, 3]), 'shape')
    call expect(same_bits([back%node_velocity], [state%node_velocity]), 'velocities')
    call expect(same_bits([back%velocity_ahead], [state%velocity_ahead]), 'accelerations')
    call expect(same_bits([back%target%position, back%target%velocity, back%target%attitude, &
                           back%target%angular_velocity], [state%target%position, state%target%velocity, &
                           state%target%attitude, state%target%angular_velocity]), 'target')
    call expect(same_bits([back%closing%start_time, back%closing%rest_length], &
                          [state%closing%start_time, state%closing%rest_length]), 'closing')
    call expect(back%closing%triggered .and. back%closing%pulling .and. &
                all(back%closing%locked .eqv. state%closing%locked), 'latches')
    call expect(back%deployment%begun .and. same_bits([back%deployment%start, back%deployment%time, back%deployment%area, &
                back%deployment%distance, back%deployment%largest_area, back%deployment%largest_time, &
                back%deployment%largest_distance, back%deployment%time_at], [state%deployment%start, &
                state%deployment%time, state%deployment%area, state%deployment%distance, state%deployment%largest_area, &
                state%deployment%largest_time, state%deployment%largest_distance, state%deployment%time_at]), 'deployment')
    call expect(all(back%impulse_histogram == state%impulse_histogram), 'histogram')
    call expect(all(back%self_contacts == state%self_contacts), 'crossings of cables')
    call expect(back%measures(2)%verdict == 2 .and. same_bits([back%measures%cqi], [state%measures%cqi]), 'measures')
    call expect(state_hash(back) == state_hash(state), 'the hash of the whole state')
    ! A new component of state_t changes this number: add it to exchange_state of
    ! castnet_checkpoint and to fill above, then correct the number here.
    call expect_equal(storage_size(state)/8, 720, 'bytes of state_t (see the comment in the test)')
    state%tally%contact_iterations = 29
    call expect(state_hash(back) /= state_hash(state), 'another state, another hash')
    call clean()
  end subroutine test_round_trip

  subroutine test_bare_state()
    type(state_t) :: state, back
    type(error_t), allocatable :: error
    character(len=:), allocatable :: scene, contents, warning
    call write_checkpoint(output(), state, '', '', error)
    call read_checkpoint(checkpoint_path(output()), back, scene, contents, warning, error)
    call expect(.not. allocated(error) .and. .not. allocated(warning), 'read')
    call expect(.not. allocated(back%node_position) .and. .not. allocated(back%target) .and. &
                .not. allocated(back%closing) .and. .not. allocated(back%impulse_histogram) .and. &
                .not. allocated(back%self_contacts) .and. .not. allocated(back%measures), 'nothing that was not there')
    call expect(state_hash(back) == state_hash(state), 'hash')
    call clean()
  end subroutine test_bare_state

  !> Every length and every single bit of a whole file.
  subroutine test_damage()
    type(state_t) :: state, back
    type(error_t), allocatable :: error
    character(len=:), allocatable :: scene, contents, warning, bytes, broken
    integer :: i, n_cut, n_flip, n_seen_cut, n_seen_flip
    state%time = 0.5_wp
    call write_checkpoint(output(), state, '&net', '', error)
    n_seen_cut = read_file(checkpoint_path(output()), bytes)
    call clean()
    n_cut = 0; n_flip = 0; n_seen_cut = 0; n_seen_flip = 0
    do i = 0, len(bytes) - 1, 7
      n_cut = n_cut + 1
      call try(bytes(1:i), n_seen_cut)
    end do
    do i = 0, 8*len(bytes) - 1, 13
      n_flip = n_flip + 1
      broken = bytes
      broken(i/8 + 1:i/8 + 1) = achar(ieor(iachar(bytes(i/8 + 1:i/8 + 1)), 2**mod(i, 8)))
      call try(broken, n_seen_flip)
    end do
    call expect_equal(n_seen_cut, n_cut, 'cut files that were refused')
    call expect_equal(n_seen_flip, n_flip, 'flipped bits that were refused')
    n_seen_cut = 0
    call try(bytes//'x', n_seen_cut)
    call expect_equal(n_seen_cut, 1, 'a file with one byte more was refused')

  contains

    subroutine try(content, count)
      character(len=*), intent(in) :: content
      integer, intent(inout) :: count
      integer :: ignored
      if (allocated(error)) deallocate (error)
      ignored = remove_file(output()//'.checkpoint')
      ignored = create_file(output()//'.checkpoint', content)
      call read_checkpoint(output()//'.checkpoint', back, scene, contents, warning, error)
      if (allocated(error)) then
        if (error%code == exit_file) count = count + 1
      end if
      ignored = remove_file(output()//'.checkpoint')
    end subroutine try

  end subroutine test_damage

  subroutine test_previous()
    type(state_t) :: state, back
    type(error_t), allocatable :: error
    character(len=:), allocatable :: scene, contents, warning, bytes
    integer :: ignored
    state%step = 1
    call write_checkpoint(output(), state, 's', '', error)
    call expect_equal(path_kind(output()//'.checkpoint.previous'), path_nothing, 'no previous one yet')
    state%step = 2
    call write_checkpoint(output(), state, 's', '', error)
    call expect_equal(path_kind(output()//'.checkpoint.previous'), path_file, 'the previous one')
    ignored = read_file(output()//'.checkpoint', bytes)
    ignored = remove_file(output()//'.checkpoint')
    call read_checkpoint(output()//'.checkpoint', back, scene, contents, warning, error)
    call expect(.not. allocated(error) .and. allocated(warning), 'a missing one: the previous with a warning')
    call expect(back%step == 1, 'its state')
    ignored = create_file(output()//'.checkpoint', bytes(1:len(bytes)/2))
    call read_checkpoint(output()//'.checkpoint', back, scene, contents, warning, error)
    call expect(.not. allocated(error) .and. allocated(warning), 'a cut one: the previous with a warning')
    call clean()
    call read_checkpoint(output()//'.checkpoint', back, scene, contents, warning, error)
    call expect(allocated(error), 'none at all: an error')
    call clean()
  end subroutine test_previous

  subroutine test_no_folder()
    type(state_t) :: state
    type(error_t), allocatable :: error
    call write_checkpoint('/tmp/castnet_no_such_folder/a.h5', state, '', '', error)
    call expect(allocated(error), 'an error')
    if (allocated(error)) call expect_equal(error%code, exit_file, 'exit code')
  end subroutine test_no_folder

  subroutine test_same_scene()
    character(len=*), parameter :: nl = new_line('a')
    character(len=*), parameter :: before = '&net'//nl//'  squares = 10 10'//nl//'/'//nl// &
      "&part"//nl//"  shape = 'box'"//nl//'/'//nl//"&part"//nl//"  shape = 'sphere'"//nl//'/'//nl// &
      '&time'//nl//'  end_time = 1.0'//nl//'/'//nl//'&output'//nl//'  frame_interval = 0.1'//nl//'/'
    type(error_t), allocatable :: error
    call check_same_scene(before, before, 'c', error)
    call expect(.not. allocated(error), 'the same scene')
    call check_same_scene(before, changed('end_time = 1.0', 'end_time = 2.0'), 'c', error)
    call expect(.not. allocated(error), 'another end time')
    call check_same_scene(before, changed('frame_interval = 0.1', 'frame_interval = 0.2'), 'c', error)
    call expect(.not. allocated(error), 'another frame interval')
    call check_same_scene(before, changed("'sphere'", "'box'"), 'c', error)
    call expect(allocated(error), 'another second part')
    if (allocated(error)) then
      call expect_equal(error%code, exit_input, 'exit code')
      call expect(index(error%message, 'part(2)/shape') > 0, 'named')
      call expect(index(error%message, 'net/squares') == 0, 'nothing else named')
      deallocate (error)
    end if
    call check_same_scene(before, changed('10 10', '10 12'), 'c', error)
    call expect(allocated(error), 'another net')
    if (allocated(error)) deallocate (error)
    call check_same_scene(before, before//nl//'&closing'//nl//'  delay = 0.0'//nl//'/', 'c', error)
    call expect(allocated(error), 'a group more')

  contains

    function changed(old, new) result(text)
      character(len=*), intent(in) :: old, new
      character(len=:), allocatable :: text
      integer :: at
      at = index(before, old)
      text = before(1:at - 1)//new//before(at + len(old):)
    end function changed

  end subroutine test_same_scene

end module test_checkpoint
