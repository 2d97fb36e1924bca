!> Nets from HDF5 files: the layout, and that no bad file is passed over or crashes.
module test_net_file
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use castnet_kinds, only: wp, i4, i8
  use castnet_error, only: error_t, exit_input
  use castnet_net, only: net_t
  use castnet_text, only: to_text
  use castnet_posix, only: process_id, remove_file, create_file, physical_memory
  use castnet_hdf5_file, only: hdf5_file_t, location_t, create_hdf5, close_file, make_group, close_group, write_array, &
                               kind_double
  use castnet_hdf5_series, only: series_t, create_series, close_series
  use castnet_net_file, only: read_net_file
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_net_file

  !> A net as a test wants it written; what is not allocated is left out.
  type :: draft_t
    real(wp), allocatable :: position(:, :), velocity(:, :), mass(:), natural_length(:), axial_stiffness(:), damping(:)
    integer(i4), allocatable :: fixed(:), nodes(:, :), face(:, :)
  end type draft_t

contains

  subroutine run_test_net_file()
    call test_case('net_file: a square of four nodes is read as it was written', test_good)
    call test_case('net_file: one node and no cable is a net', test_one_node)
    call test_case('net_file: what is missing or misshapen is named', test_shapes)
    call test_case('net_file: values that cannot be are named, all at once', test_values)
    call test_case('net_file: loops and doubles', test_doubles)
    call test_case('net_file: sizes are refused before memory is taken', test_sizes)
    call test_case('net_file: other files', test_other_files)
  end subroutine run_test_net_file

  function path() result(name)
    character(len=:), allocatable :: name
    name = '/tmp/castnet_'//to_text(process_id())//'_net.h5'
  end function path

  !> A square with one diagonal: 4 nodes, 5 cables, one face; node 3 fixed.
  type(draft_t) function square() result(draft)
    draft%position = reshape([0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, &
                              1.0_wp], [3, 4])
    draft%velocity = 2.0_wp*draft%position
    draft%mass = [1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp]
    draft%fixed = [0, 0, 0, 1]
    draft%nodes = reshape([0, 1, 1, 2, 2, 3, 3, 0, 0, 2], [2, 5])
    draft%natural_length = [1.0_wp, 1.1_wp, 1.2_wp, 1.3_wp, 1.4_wp]
    draft%axial_stiffness = [10.0_wp, 11.0_wp, 12.0_wp, 13.0_wp, 14.0_wp]
    draft%damping = [0.0_wp, 0.1_wp, 0.2_wp, 0.3_wp, 0.4_wp]
    draft%face = reshape([0, 1, 2, 3], [4, 1])
  end function square

  subroutine write_draft(draft)
    type(draft_t), intent(in) :: draft
    type(hdf5_file_t) :: file
    type(location_t) :: group
    type(error_t), allocatable :: error
    call create_hdf5(file, path(), error)
    call make_group(file, file%root, 'node', group, error)
    if (allocated(draft%position)) call write_array(file, group, 'position', draft%position, 'm', error)
    if (allocated(draft%velocity)) call write_array(file, group, 'velocity', draft%velocity, 'm', error)
    if (allocated(draft%mass)) call write_array(file, group, 'mass', draft%mass, 'kg', error)
    if (allocated(draft%fixed)) call write_array(file, group, 'fixed', draft%fixed, '1', error)
    call close_group(file, group)
    if (allocated(draft%nodes) .or. allocated(draft%damping)) then
      call make_group(file, file%root, 'cable', group, error)
      if (allocated(draft%nodes)) call write_array(file, group, 'nodes', draft%nodes, '1', error)
      if (allocated(draft%natural_length)) &
        call write_array(file, group, 'natural_length', draft%natural_length, 'm', error)
      if (allocated(draft%axial_stiffness)) &
        call write_array(file, group, 'axial_stiffness', draft%axial_stiffness, 'N', error)
      if (allocated(draft%damping)) call write_array(file, group, 'damping', draft%damping, '1', error)
      call close_group(file, group)
    end if
    if (allocated(draft%face)) call write_array(file, file%root, 'face', draft%face, '1', error)
    call close_file(file, error)
    call expect(.not. allocated(error), 'the test can write its file')
  end subroutine write_draft

  !> The message that a draft gives, '' if it is accepted.
  function complaint(draft) result(message)
    type(draft_t), intent(in) :: draft
    character(len=:), allocatable :: message
    call write_draft(draft)
    message = complaint_of_file()
  end function complaint

  function complaint_of_file() result(message)
    character(len=:), allocatable :: message
    type(net_t) :: net
    real(wp), allocatable :: position(:, :), velocity(:, :)
    type(error_t), allocatable :: error
    integer :: ignored
    call read_net_file(path(), net, position, velocity, error)
    message = ''
    if (allocated(error)) then
      message = error%message
      call expect_equal(error%code, exit_input, 'exit code')
    end if
    ignored = remove_file(path())
  end function complaint_of_file

  subroutine expect_named(message, words)
    character(len=*), intent(in) :: message, words
    call expect(index(message, words) > 0, 'the message names "'//words//'"; seen: '//message)
  end subroutine expect_named

  subroutine test_good()
    type(draft_t) :: draft
    type(net_t) :: net
    real(wp), allocatable :: position(:, :), velocity(:, :)
    type(error_t), allocatable :: error
    integer :: ignored
    draft = square()
    call write_draft(draft)
    call read_net_file(path(), net, position, velocity, error)
    if (allocated(error)) call expect(.false., 'accepted; seen: '//error%message)
    if (allocated(error)) return
    call expect_equal(net%n_node, 4, 'nodes')
    call expect_equal(net%n_cable, 5, 'cables')
    call expect_close([position], [draft%position], 'position', atol=0.0_wp)
    call expect_close([velocity], [draft%velocity], 'velocity', atol=0.0_wp)
    call expect_close(net%node_mass, draft%mass, 'mass', atol=0.0_wp)
    call expect(all(net%fixed .eqv. [.false., .false., .false., .true.]), 'fixed')
    call expect(all(net%cable_nodes == draft%nodes + 1), 'cable nodes, counted from 1')
    call expect_close(net%natural_length, draft%natural_length, 'natural length', atol=0.0_wp)
    call expect_close(net%axial_stiffness, draft%axial_stiffness, 'axial stiffness', atol=0.0_wp)
    call expect_close(net%damping, draft%damping, 'damping', atol=0.0_wp)
    call expect(all(net%faces(:, 1) == [1, 2, 3, 4]), 'face, counted from 1')
    ignored = remove_file(path())
  end subroutine test_good

  subroutine test_one_node()
    type(draft_t) :: draft
    draft%position = reshape([1.0_wp, 2.0_wp, 3.0_wp], [3, 1])
    draft%velocity = draft%position
    draft%mass = [1.0_wp]
    call expect_equal(complaint(draft), '', 'one node, no cable')
    draft = square()
    draft%nodes(1, :) = 0
    draft%nodes(2, :) = [1, 2, 3, 1, 2]
    draft%nodes = draft%nodes(:, 1:2)
    draft%natural_length = draft%natural_length(1:2)
    draft%axial_stiffness = draft%axial_stiffness(1:2)
    draft%damping = draft%damping(1:2)
    call expect_equal(complaint(draft), '', 'a node without a cable')
  end subroutine test_one_node

  subroutine test_shapes()
    type(draft_t) :: draft
    character(len=:), allocatable :: message
    draft = square()
    deallocate (draft%mass, draft%damping)
    draft%velocity = draft%velocity(:, 1:3)
    draft%natural_length = draft%natural_length(1:4)
    message = complaint(draft)
    call expect_named(message, '/node/mass: missing')
    call expect_named(message, '/cable/damping: missing')
    call expect_named(message, '/node/velocity: shape (3,3), where (n,3) with n = 4 is needed')
    call expect_named(message, '/cable/natural_length: shape (4)')
    draft = square()
    draft%position = transpose(draft%position)
    call expect_named(complaint(draft), '/node/position: shape (3,4)')
    draft = square()
    draft%face = draft%face(1:3, :)
    call expect_named(complaint(draft), '/face: shape (1,3)')
  end subroutine test_shapes

  subroutine test_values()
    type(draft_t) :: draft
    character(len=:), allocatable :: message
    draft = square()
    draft%position(2, 3) = ieee_value(1.0_wp, ieee_quiet_nan)
    draft%mass(1) = 0.0_wp
    draft%mass(2) = -1.0_wp
    message = complaint(draft)
    call expect_named(message, '/node/position[2,1]: NaN')
    call expect_named(message, '/node/mass[0]: 0')
    call expect_named(message, '/node/mass[1]: -1')
    draft = square()
    draft%natural_length(5) = 0.0_wp
    draft%axial_stiffness(1) = -1.0_wp
    draft%damping(2) = -1.0_wp
    draft%nodes(1, 3) = 4
    draft%nodes(2, 4) = -1
    message = complaint(draft)
    call expect_named(message, '/cable/natural_length[4]')
    call expect_named(message, '/cable/axial_stiffness[0]')
    call expect_named(message, '/cable/damping[1]')
    call expect_named(message, '/cable/nodes[2,0]: 4, where 0 to 3 is allowed')
    call expect_named(message, '/cable/nodes[3,1]: -1')
    draft = square()
    draft%fixed(1) = 2
    call expect_named(complaint(draft), '/node/fixed[0]: 2')
    draft = square()
    draft%face(4, 1) = 0
    call expect_named(complaint(draft), 'face 0 names a node twice')
    draft%face(4, 1) = 7
    call expect_named(complaint(draft), '/face[0,3]: 7')
  end subroutine test_values

  subroutine test_doubles()
    type(draft_t) :: draft
    draft = square()
    draft%nodes(:, 2) = [2, 2]
    call expect_named(complaint(draft), 'cable 1 joins node 2 to itself')
    draft = square()
    draft%nodes(:, 4) = [1, 0]
    call expect_named(complaint(draft), 'cables 0 and 3 join the same nodes 0 and 1')
  end subroutine test_doubles

  !> A file that claims 2**31 nodes without holding any.
  subroutine test_sizes()
    type(hdf5_file_t) :: file
    type(location_t) :: group
    type(error_t), allocatable :: error
    character(len=:), allocatable :: message
    ! twice what fits this machine, unless that is more than any net may have
    if (physical_memory()/350_i8 < 268435455_i8) then
      call claim(int(physical_memory()/350_i8))
      message = complaint_of_file()
      call expect_named(message, 'of memory; this machine has')
      call note(message)
    end if
    call claim(2147483647)
    message = complaint_of_file()
    call expect_named(message, 'are possible')

  contains

    subroutine claim(n)
      integer, intent(in) :: n
      type(series_t) :: series
      integer :: i
      character(len=8), parameter :: names(3) = ['position', 'velocity', 'mass    ']
      call create_hdf5(file, path(), error)
      call make_group(file, file%root, 'node', group, error)
      do i = 1, 3
        if (i < 3) then
          call create_series(file, group, trim(names(i)), kind_double, [3], 'm', series, error)
        else
          call create_series(file, group, trim(names(i)), kind_double, [integer ::], 'm', series, error)
        end if
        call stretch(file, series, int(n, i8))
        call close_series(file, series)
      end do
      call close_group(file, group)
      call close_file(file, error)
      call expect(.not. allocated(error), 'the test can write its file')
    end subroutine claim

    !> Make a series longer without writing to it.
    subroutine stretch(file, series, n)
      use hdf5, only: h5dset_extent_f, hsize_t
      type(hdf5_file_t), intent(inout) :: file
      type(series_t), intent(inout) :: series
      integer(i8), intent(in) :: n
      integer(hsize_t) :: extent(2)
      integer :: status
      extent = series%shape(1:2)
      extent(series%rank) = n
      call h5dset_extent_f(series%id, extent(1:series%rank), status)
      call expect(status >= 0 .and. file%is_open, 'stretched')
    end subroutine stretch

  end subroutine test_sizes

  subroutine test_other_files()
    integer :: ignored
    call expect_named(complaint_of_file(), 'there is no such net file')
    ignored = create_file(path(), 'x,y,z'//new_line('a')//'1,2,3')
    call expect_named(complaint_of_file(), 'not an HDF5 file')
    ignored = create_file(path(), '')
    call expect_named(complaint_of_file(), 'not an HDF5 file')
  end subroutine test_other_files

end module test_net_file
