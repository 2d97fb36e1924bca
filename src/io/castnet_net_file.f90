!> A net of any shape from an HDF5 file (design.md, "Net from a file"):
!>
!>   /node/position (n,3)  /node/velocity (n,3)  /node/mass (n)  optional /node/fixed (n)
!>   /cable/nodes (m,2) counted from 0  /cable/natural_length (m)  /cable/axial_stiffness (m)
!>   /cable/damping (m)  optional /face (k,4)
!>
!> Shapes as Python shows them. The file is a stranger's: every name, type, shape and value
!> is checked, and the memory that the net will need is known before any is taken. All
!> problems are reported together. A net of one node and no cable is a net; without the
!> group /cable there are no cables. No force moves a fixed node: it keeps its velocity.
module castnet_net_file
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_input
  use castnet_net, only: net_t
  use castnet_text, only: to_text, byte_text, did_you_mean, word_at, word_count, is_one_of
  use castnet_posix, only: path_kind, path_nothing, path_folder, physical_memory
  use castnet_problems, only: problem_list_t
  use castnet_hdf5_file, only: hdf5_file_t, open_hdf5, close_file, is_hdf5
  use castnet_hdf5_reader, only: dataset_t, ask_dataset, list_members, read_doubles, read_longs, class_none, &
                                 class_integer, class_real
  implicit none
  private
  public :: read_net_file

  !> What a run takes in memory, all modules together, measured on large nets and rounded
  !> up [bytes].
  integer(i8), parameter :: node_bytes = 700, cable_bytes = 500
  integer, parameter :: most_shown = 3          !! examples of one kind of problem

  !> Beyond these squares and sums leave the range of numbers, and nothing is a net [SI].
  real(wp), parameter :: most_position = 1.0e9_wp, most_velocity = 1.0e6_wp, mass_range(2) = [1.0e-15_wp, 1.0e12_wp], &
                         length_range(2) = [1.0e-9_wp, 1.0e9_wp], stiffness_range(2) = [1.0e-9_wp, 1.0e18_wp], &
                         damping_range(2) = [0.0_wp, 1.0e15_wp]

  character(len=*), parameter :: node_names = 'position velocity mass fixed', &
    cable_names = 'nodes natural_length axial_stiffness damping'

  !> The file, what is wrong with it so far, and its sizes.
  type :: reading_t
    type(hdf5_file_t) :: file
    type(problem_list_t) :: problems
    character(len=:), allocatable :: path
    integer(i8) :: n_node = 0, n_cable = 0, n_face = 0
    logical :: has_cables = .false., has_faces = .false., has_fixed = .false.
  end type reading_t

contains

  !> Read a net. `net` gets its nodes, cables and faces; what follows from them (padding,
  !> the cable plan) is the net builder's. Errors: exit_input, every problem named.
  subroutine read_net_file(path, net, position, velocity, error)
    character(len=*), intent(in) :: path
    type(net_t), intent(out) :: net
    real(wp), allocatable, intent(out) :: position(:, :)  !! (3,n_node) inertial [m]
    real(wp), allocatable, intent(out) :: velocity(:, :)  !! (3,n_node) [m/s]
    type(error_t), allocatable, intent(inout) :: error
    type(reading_t) :: r
    type(error_t), allocatable :: ignored
    if (allocated(error)) return
    r%path = path
    if (path_kind(path) == path_nothing) then
      call fail(error, exit_input, path//': there is no such net file')
    else if (path_kind(path) == path_folder) then
      call fail(error, exit_input, path//': a folder, where an HDF5 file of a net is wanted')
    else if (.not. is_hdf5(path)) then
      call fail(error, exit_input, path//': not an HDF5 file that can be read; a net file is HDF5 (h5py writes it)')
    else
      call open_hdf5(r%file, path, .false., error)
      if (allocated(error)) error%code = exit_input
    end if
    if (allocated(error)) return
    call check_names(r)
    call check_shapes(r)
    if (r%problems%n == 0) call check_memory(r)
    if (r%problems%n == 0) call read_nodes(r, net, position, velocity)
    if (r%problems%n == 0) call read_cables(r, net)
    if (r%problems%n == 0) call read_faces(r, net)
    call close_file(r%file, ignored)
    if (r%problems%n > 0) call fail(error, exit_input, r%problems%report())
  end subroutine read_net_file

  subroutine add(r, name, text)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name, text
    call r%problems%add(r%path, 0, name, text)
  end subroutine add

  ! ---- names, types and shapes ----------------------------------------------------

  !> A misspelt optional dataset must not be passed over in silence.
  subroutine check_names(r)
    type(reading_t), intent(inout) :: r
    call check_group('/node', node_names)
    call check_group('/cable', cable_names)
    call check_root()

  contains

    subroutine check_group(group, known)
      character(len=*), intent(in) :: group, known
      character(len=:), allocatable :: names, name
      integer :: i
      names = list_members(r%file, group)
      do i = 1, word_count(names)
        name = word_at(names, i)
        if (.not. is_one_of(name, known)) call add(r, group//'/'//name, 'not part of a net; '//group//' may hold '// &
                                                   known//did_you_mean(name, known))
      end do
    end subroutine check_group

    !> Other things may stand in the root, but not something that looks like ours.
    subroutine check_root()
      character(len=:), allocatable :: names, name
      integer :: i
      names = list_members(r%file, '/')
      do i = 1, word_count(names)
        name = word_at(names, i)
        if (is_one_of(name, 'node cable face')) cycle
        if (len(did_you_mean(name, 'node cable face')) > 0) &
          call add(r, '/'//name, 'not part of a net'//did_you_mean(name, 'node cable face'))
      end do
    end subroutine check_root

  end subroutine check_names

  subroutine check_shapes(r)
    type(reading_t), intent(inout) :: r
    type(dataset_t) :: found
    logical :: some
    found = ask_dataset(r%file, '/node/position')
    if (found%rank == 2) r%n_node = found%shape(2)
    if (found%rank == 2 .and. r%n_node == 0) call add(r, '/node/position', 'a net needs at least one node')
    call check_one(r, '/node/position', class_real, 3, r%n_node, 'n')
    call check_one(r, '/node/velocity', class_real, 3, r%n_node, 'n')
    call check_one(r, '/node/mass', class_real, 0, r%n_node, 'n')
    r%has_fixed = is_one_of('fixed', list_members(r%file, '/node'))
    if (r%has_fixed) call check_one(r, '/node/fixed', class_integer, 0, r%n_node, 'n')
    some = len(list_members(r%file, '/cable')) > 0
    if (some) then
      r%has_cables = .true.
      found = ask_dataset(r%file, '/cable/nodes')
      if (found%rank == 2) r%n_cable = found%shape(2)
      call check_one(r, '/cable/nodes', class_integer, 2, r%n_cable, 'm')
      call check_one(r, '/cable/natural_length', class_real, 0, r%n_cable, 'm')
      call check_one(r, '/cable/axial_stiffness', class_real, 0, r%n_cable, 'm')
      call check_one(r, '/cable/damping', class_real, 0, r%n_cable, 'm')
    end if
    found = ask_dataset(r%file, '/face')
    r%has_faces = is_one_of('face', list_members(r%file, '/'))
    if (.not. r%has_faces) return
    if (found%rank == 2) r%n_face = found%shape(2)
    call check_one(r, '/face', class_integer, 4, r%n_face, 'k')
  end subroutine check_shapes

  !> One dataset: is it there, numbers of the right kind, of shape (n) or (n,width)?
  subroutine check_one(r, name, class, width, n, letter)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name, letter    !! letter: what n is called in the message
    integer, intent(in) :: class                    !! class_integer: integers only
    integer, intent(in) :: width                    !! 0: one-dimensional
    integer(i8), intent(in) :: n
    type(dataset_t) :: found
    logical :: fits
    found = ask_dataset(r%file, name)
    if (found%class == class_none) then
      call add(r, name, 'missing; a dataset of shape '//wanted()//' is needed')
      return
    end if
    if (class == class_integer .and. found%class /= class_integer) then
      call add(r, name, 'not integers, where integers are needed')
    else if (found%class /= class_integer .and. found%class /= class_real) then
      call add(r, name, 'not numbers, where numbers are needed')
    end if
    if (width == 0) then
      fits = found%rank == 1 .and. found%shape(1) == n
    else
      fits = found%rank == 2 .and. found%shape(1) == width .and. found%shape(2) == n
    end if
    if (.not. fits) call add(r, name, 'shape '//shape_text(found)//', where '//wanted()//' is needed')

  contains

    function wanted() result(text)
      character(len=:), allocatable :: text
      if (width == 0) then
        text = '('//letter//')'
      else
        text = '('//letter//','//to_text(width)//')'
      end if
      if (n > 0) text = text//' with '//letter//' = '//to_text(n)
    end function wanted

  end subroutine check_one

  !> A shape as Python shows it.
  function shape_text(found) result(text)
    type(dataset_t), intent(in) :: found
    character(len=:), allocatable :: text
    integer :: i
    text = '('
    do i = found%rank, 1, -1
      text = text//to_text(found%shape(i))
      if (i > 1) text = text//','
    end do
    text = text//')'
  end function shape_text

  !> Refuse what this machine cannot hold, before anything is allocated.
  subroutine check_memory(r)
    type(reading_t), intent(inout) :: r
    integer(i8), parameter :: most = 268435455_i8  ! counts of values fit default integers
    integer(i8) :: needed
    if (max(r%n_node, r%n_cable, r%n_face) > most) then
      call add(r, 'the net', to_text(r%n_node)//' nodes, '//to_text(r%n_cable)//' cables and '//to_text(r%n_face)// &
               ' faces; at most '//to_text(most)//' of each are possible')
      return
    end if
    needed = node_bytes*r%n_node + cable_bytes*r%n_cable + 32*r%n_face
    if (needed > physical_memory()) call add(r, 'the net', to_text(r%n_node)//' nodes and '//to_text(r%n_cable)// &
      ' cables need about '//byte_text(real(needed, wp))//' of memory; this machine has '//byte_text(real(physical_memory(), wp)))
  end subroutine check_memory

  ! ---- values -----------------------------------------------------------------------

  subroutine read_nodes(r, net, position, velocity)
    type(reading_t), intent(inout) :: r
    type(net_t), intent(inout) :: net
    real(wp), allocatable, intent(out) :: position(:, :), velocity(:, :)
    real(wp), allocatable :: values(:)
    integer(i8), allocatable :: flags(:)
    integer :: n
    n = int(r%n_node)
    net%n_node = n
    call get_reals(r, '/node/position', 3*r%n_node, values)
    call check_size(r, '/node/position', values, most_position)
    position = reshape(values, [3, n])
    call get_reals(r, '/node/velocity', 3*r%n_node, values)
    call check_size(r, '/node/velocity', values, most_velocity)
    velocity = reshape(values, [3, n])
    call get_reals(r, '/node/mass', r%n_node, net%node_mass)
    call check_positive(r, '/node/mass', net%node_mass, mass_range)
    allocate (net%fixed(n), net%is_bullet(n))
    net%fixed = .false.
    net%is_bullet = .false.
    if (.not. r%has_fixed) return
    call get_longs(r, '/node/fixed', r%n_node, flags)
    call check_range(r, '/node/fixed', flags, 1, 0_i8, 1_i8)
    net%fixed = flags /= 0
  end subroutine read_nodes

  subroutine read_cables(r, net)
    type(reading_t), intent(inout) :: r
    type(net_t), intent(inout) :: net
    integer(i8), allocatable :: ends(:)
    integer :: m
    m = int(r%n_cable)
    net%n_cable = m
    if (r%has_cables) then
      call get_longs(r, '/cable/nodes', 2*r%n_cable, ends)
      call get_reals(r, '/cable/natural_length', r%n_cable, net%natural_length)
      call get_reals(r, '/cable/axial_stiffness', r%n_cable, net%axial_stiffness)
      call get_reals(r, '/cable/damping', r%n_cable, net%damping)
      call check_positive(r, '/cable/natural_length', net%natural_length, length_range)
      call check_positive(r, '/cable/axial_stiffness', net%axial_stiffness, stiffness_range)
      call check_positive(r, '/cable/damping', net%damping, damping_range)
      call check_range(r, '/cable/nodes', ends, 2, 0_i8, r%n_node - 1)
      call check_cables(r, ends)
      if (r%problems%n > 0) return
      net%cable_nodes = reshape(int(ends) + 1, [2, m])
    else
      allocate (net%cable_nodes(2, 0), net%natural_length(0), net%axial_stiffness(0), net%damping(0))
    end if
  end subroutine read_cables

  subroutine read_faces(r, net)
    type(reading_t), intent(inout) :: r
    type(net_t), intent(inout) :: net
    integer(i8), allocatable :: corners(:)
    integer(i8) :: k
    integer :: shown
    allocate (net%bullet_nodes(0), net%perimeter_nodes(0), net%corner_nodes(0))
    if (.not. r%has_faces) then
      allocate (net%faces(4, 0))
      return
    end if
    call get_longs(r, '/face', 4*r%n_face, corners)
    call check_range(r, '/face', corners, 4, 0_i8, r%n_node - 1)
    shown = 0
    do k = 1, r%n_face
      associate (c => corners(4*k - 3:4*k))
        if (c(1) /= c(2) .and. c(1) /= c(3) .and. c(1) /= c(4) .and. c(2) /= c(3) .and. c(2) /= c(4) .and. &
            c(3) /= c(4)) cycle
      end associate
      call count_problem(r, '/face', shown, 'face '//to_text(k - 1)//' names a node twice; its four corners must differ')
    end do
    call close_count(r, '/face', shown)
    if (r%problems%n == 0) net%faces = reshape(int(corners) + 1, [4, int(r%n_face)])
  end subroutine read_faces

  !> A cable joins two different nodes, and no other cable joins the same two.
  subroutine check_cables(r, ends)
    type(reading_t), intent(inout) :: r
    integer(i8), intent(in) :: ends(:)          !! (2 n_cable) counted from 0
    integer(i8), allocatable :: key(:), cable(:)
    integer(i8) :: k
    integer :: loops, doubles
    loops = 0
    do k = 1, r%n_cable
      if (ends(2*k - 1) == ends(2*k)) call count_problem(r, '/cable/nodes', loops, 'cable '//to_text(k - 1)// &
        ' joins node '//to_text(ends(2*k))//' to itself')
    end do
    call close_count(r, '/cable/nodes', loops)
    if (r%problems%n > 0) return                ! keys need ends in range
    allocate (key(r%n_cable), cable(r%n_cable))
    do k = 1, r%n_cable
      key(k) = min(ends(2*k - 1), ends(2*k))*r%n_node + max(ends(2*k - 1), ends(2*k))
      cable(k) = k - 1
    end do
    call sort(key, cable)
    doubles = 0
    do k = 2, r%n_cable
      if (key(k) == key(k - 1)) call count_problem(r, '/cable/nodes', doubles, 'cables '//to_text(cable(k - 1))//' and '// &
        to_text(cable(k))//' join the same nodes '//to_text(key(k)/r%n_node)//' and '//to_text(modulo(key(k), r%n_node))// &
        '; give one cable the sum of their stiffness')
    end do
    call close_count(r, '/cable/nodes', doubles)
  end subroutine check_cables

  !> Merge sort of keys, equal ones in the order given; `value` goes along.
  subroutine sort(key, value)
    integer(i8), intent(inout) :: key(:), value(:)
    integer(i8), allocatable :: key_2(:), value_2(:)
    integer(i8) :: n, run, low, middle, high, i, j, k
    n = size(key, kind=i8)
    allocate (key_2(n), value_2(n))
    run = 1
    do while (run < n)
      do low = 1, n, 2*run
        middle = min(low + run, n + 1)
        high = min(low + 2*run, n + 1)
        i = low
        j = middle
        do k = low, high - 1
          if (comes_first(i, j)) then
            key_2(k) = key(i); value_2(k) = value(i)
            i = i + 1
          else
            key_2(k) = key(j); value_2(k) = value(j)
            j = j + 1
          end if
        end do
      end do
      key = key_2
      value = value_2
      run = 2*run
    end do

  contains

    logical function comes_first(a, b)
      integer(i8), intent(in) :: a, b
      comes_first = b >= high
      if (a < middle .and. b < high) comes_first = key(a) <= key(b)
    end function comes_first

  end subroutine sort

  ! ---- small words --------------------------------------------------------------------

  subroutine get_reals(r, name, n, values)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: n
    real(wp), allocatable, intent(out) :: values(:)
    type(error_t), allocatable :: error
    call read_doubles(r%file, name, n, values, error)
    if (.not. allocated(error)) return
    call add(r, name, error%message)
    if (allocated(values)) values = 1.0_wp
  end subroutine get_reals

  subroutine get_longs(r, name, n, values)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: n
    integer(i8), allocatable, intent(out) :: values(:)
    type(error_t), allocatable :: error
    call read_longs(r%file, name, n, values, error)
    if (.not. allocated(error)) return
    call add(r, name, error%message)
    if (allocated(values)) values = 0
  end subroutine get_longs

  !> Note a problem; after a few of a kind only count.
  subroutine count_problem(r, name, shown, text)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name, text
    integer, intent(inout) :: shown
    shown = shown + 1
    if (shown <= most_shown) call add(r, name, text)
  end subroutine count_problem

  subroutine close_count(r, name, shown)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name
    integer, intent(in) :: shown
    if (shown > most_shown) call add(r, name, 'and '//to_text(shown - most_shown)//' more of this kind')
  end subroutine close_count

  !> The index of value k (from 1) as Python writes it.
  function place(k, width) result(text)
    integer(i8), intent(in) :: k
    integer, intent(in) :: width
    character(len=:), allocatable :: text
    if (width == 1) then
      text = '['//to_text(k - 1)//']'
    else
      text = '['//to_text((k - 1)/width)//','//to_text(modulo(k - 1, int(width, i8)))//']'
    end if
  end function place

  !> Components of vectors: finite, and none larger than `most`.
  subroutine check_size(r, name, values, most)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)           !! (3 n)
    real(wp), intent(in) :: most
    integer(i8) :: k
    integer :: shown
    shown = 0
    do k = 1, size(values, kind=i8)
      if (.not. ieee_is_finite(values(k))) then
        call count_problem(r, name//place(k, 3), shown, to_text(values(k))//', where a finite number is needed')
      else if (abs(values(k)) > most) then
        call count_problem(r, name//place(k, 3), shown, to_text(values(k))//', where '//to_text(-most)//' to '// &
                           to_text(most)//' is allowed')
      end if
    end do
    call close_count(r, name, shown)
  end subroutine check_size

  !> Positive numbers within limits; zero, too, where the lower limit is.
  subroutine check_positive(r, name, values, limits)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)
    real(wp), intent(in) :: limits(2)
    character(len=:), allocatable :: wanted
    integer(i8) :: k
    integer :: shown
    shown = 0
    do k = 1, size(values, kind=i8)
      if (ieee_is_finite(values(k))) then
        if (values(k) >= limits(1) .and. values(k) <= limits(2)) cycle
      end if
      wanted = 'a number '//trim(merge('> 0 ', '>= 0', limits(1) > 0.0_wp))//' is needed'
      if (ieee_is_finite(values(k))) then
        if (values(k) > 0.0_wp) wanted = to_text(limits(1))//' to '//to_text(limits(2))//' is allowed'
      end if
      call count_problem(r, name//place(k, 1), shown, to_text(values(k))//', where '//wanted)
    end do
    call close_count(r, name, shown)
  end subroutine check_positive

  subroutine check_range(r, name, values, width, low, high)
    type(reading_t), intent(inout) :: r
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: values(:), low, high
    integer, intent(in) :: width
    integer(i8) :: k
    integer :: shown
    shown = 0
    do k = 1, size(values, kind=i8)
      if (values(k) >= low .and. values(k) <= high) cycle
      call count_problem(r, name//place(k, width), shown, to_text(values(k))//', where '//to_text(low)//' to '// &
                         to_text(high)//' is allowed')
    end do
    call close_count(r, name, shown)
  end subroutine check_range

end module castnet_net_file
