!> Triangle meshes from STL (text and binary) and OBJ files, read strictly: what is not
!> understood is refused with the file and the line or byte where it stands. The triangles
!> come as they are in the file; `castnet_mesh_check` makes a closed surface of them.
module castnet_mesh_file
  use, intrinsic :: iso_fortran_env, only: int8
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use castnet_kinds, only: wp, sp, i4, i8
  use castnet_error, only: error_t, fail, exit_input, exit_file
  use castnet_surface, only: surface_t
  use castnet_text, only: to_text, parse_real, parse_integer, byte_text, lower, quoted
  implicit none
  private
  public :: read_mesh_file

  integer(i8), parameter :: most_triangles = 4000000_i8
  real(wp), parameter :: bytes_per_triangle = 900.0_wp  !! of the finished mesh, all its tables
  integer(i8), parameter :: most_bytes = 1500000000_i8  !! of a text file, held in memory whole

  !> A text file walked line by line.
  type :: lines_t
    character(len=:), allocatable :: path, text
    integer :: place = 1     !! where the next line starts
    integer :: number = 0    !! of the current line
    integer :: first = 1, last = 0
  end type lines_t

  real(wp), parameter :: farthest = 1.0e6_wp   !! coordinate that is taken [m]; beyond it sizes overflow

contains

  !> Read a mesh file; STL or OBJ is told by the ending, text or binary STL by the content.
  !> Coordinates are metres as written. STL repeats every corner of every triangle.
  !> Errors (exit 2): anything malformed; (exit 4): a file that cannot be opened or read.
  subroutine read_mesh_file(path, surface, error)
    character(len=*), intent(in) :: path
    type(surface_t), intent(out) :: surface
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: ending
    ending = lower(path(index(path, '.', back=.true.) + 1:))
    select case (ending)
    case ('stl')
      call read_stl(path, surface, error)
    case ('obj')
      call read_obj(path, surface, error)
    case default
      call fail(error, exit_input, path//': a mesh file ends in .stl or .obj')
    end select
    if (allocated(error)) return
    if (size(surface%triangle, 2) < 4) call fail(error, exit_input, path//': '// &
      to_text(size(surface%triangle, 2))//' triangles; a closed surface has at least 4')
  end subroutine read_mesh_file

  !> A binary STL has exactly 84 + 50 bytes a triangle, whatever its header says.
  subroutine read_stl(path, surface, error)
    character(len=*), intent(in) :: path
    type(surface_t), intent(out) :: surface
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: bytes, count
    character(len=5) :: start
    integer :: unit
    call open_file(path, unit, bytes, error)
    if (allocated(error)) return
    count = -1
    start = ''
    if (bytes >= 84) count = counted(unit, path, error)
    if (bytes >= 5 .and. .not. allocated(error)) read (unit, pos=1) start
    if (.not. allocated(error)) then
      if (count >= 0 .and. bytes == 84_i8 + 50_i8*count) then
        call read_binary_stl(unit, path, count, surface, error)
      else if (lower(start) == 'solid') then
        close (unit)
        call read_text_stl(path, bytes, surface, error)
        return
      else if (count < 0) then
        call fail(error, exit_input, path//': '//to_text(bytes)//' bytes are no STL file: a text one starts with '// &
                  '"solid", a binary one has at least 84 bytes')
      else
        call fail(error, exit_input, path//', byte 81: a binary STL of '//to_text(count)//' triangles has '// &
                  to_text(84_i8 + 50_i8*count)//' bytes; this file has '//to_text(bytes)//' and does not start with "solid"')
      end if
    end if
    close (unit)
  end subroutine read_stl

  !> The number of triangles in a binary STL's header, unsigned, least byte first.
  integer(i8) function counted(unit, path, error)
    integer, intent(in) :: unit
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(inout) :: error
    integer(int8) :: byte(4)
    integer :: status, k
    counted = 0
    read (unit, pos=81, iostat=status) byte
    if (status /= 0) then
      call fail(error, exit_file, path//': cannot be read')
      return
    end if
    do k = 4, 1, -1
      counted = 256_i8*counted + iand(int(byte(k), i8), 255_i8)
    end do
  end function counted

  subroutine read_binary_stl(unit, path, count, surface, error)
    integer, intent(in) :: unit
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: count
    type(surface_t), intent(out) :: surface
    type(error_t), allocatable, intent(inout) :: error
    integer(int8) :: byte(50)
    real(sp) :: corner(9)
    integer :: status, i, k
    call check_size(path, count, error)
    if (allocated(error)) return
    allocate (surface%vertex(3, 3*count), surface%triangle(3, count))
    read (unit, pos=85, iostat=status)
    do i = 1, int(count)
      if (status == 0) read (unit, iostat=status) byte
      if (status /= 0) then
        call fail(error, exit_file, path//', byte '//to_text(85_i8 + 50_i8*(i - 1))//': cannot be read')
        return
      end if
      corner = little_endian(byte(13:48))
      if (.not. all(ieee_is_finite(corner))) then
        call fail(error, exit_input, path//', byte '//to_text(85_i8 + 50_i8*(i - 1))//': triangle '//to_text(i)// &
                  ' has a corner that is not a finite number')
        return
      else if (any(abs(corner) > farthest)) then
        call fail(error, exit_input, path//', byte '//to_text(85_i8 + 50_i8*(i - 1))//': triangle '//to_text(i)// &
                  ' has a corner beyond '//to_text(farthest)//' m')
        return
      end if
      surface%vertex(:, 3*i - 2:3*i) = reshape(real(corner, wp), [3, 3])
      surface%triangle(:, i) = [(3*i - 3 + k, k=1, 3)]
    end do
  end subroutine read_binary_stl

  !> Nine single-precision numbers, least byte first, on any machine.
  pure function little_endian(byte) result(value)
    integer(int8), intent(in) :: byte(36)
    real(sp) :: value(9)
    integer(i8) :: bits
    integer :: i, k
    do i = 1, 9
      bits = 0
      do k = 4, 1, -1
        bits = 256_i8*bits + iand(int(byte(4*i - 4 + k), i8), 255_i8)
      end do
      if (bits >= 2147483648_i8) bits = bits - 4294967296_i8
      value(i) = transfer(int(bits, i4), value(i))
    end do
  end function little_endian

  !> solid NAME / facet normal n n n / outer loop / 3 vertex x y z / endloop / endfacet / endsolid.
  !> The normals are not used: the order of the corners says which side is out.
  subroutine read_text_stl(path, bytes, surface, error)
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: bytes
    type(surface_t), intent(out) :: surface
    type(error_t), allocatable, intent(inout) :: error
    type(lines_t) :: file
    character(len=*), parameter :: wanted(9) = [character(len=9) :: 'solid', 'facet', 'outer', 'vertex', 'vertex', &
                                                'vertex', 'endloop', 'endfacet', 'endsolid']
    character(len=:), allocatable :: word
    integer :: state, n, most
    logical :: found
    call load(path, bytes, file, error)
    if (allocated(error)) return
    ! The shortest text of a triangle is longer than 60 bytes.
    most = int(min(bytes/60_i8 + 1_i8, most_triangles + 1_i8))
    call check_size(path, int(most, i8) - 1_i8, error)
    if (allocated(error)) return
    allocate (surface%vertex(3, 3*most))
    n = 0
    state = 1
    do
      call next_line(file, found)
      if (.not. found) exit
      word = lower(word_of(file))
      if (state == 2 .and. word == 'endsolid') state = 9
      if (word /= trim(wanted(state))) then
        call fail(error, exit_input, at(file)//shown(word)//' seen, '''//trim(wanted(state))//''' expected')
        return
      end if
      select case (state)
      case (2)
        if (n + 3 > 3*most) then
          call fail(error, exit_input, path//': more than '//to_text(most_triangles)//' triangles')
          return
        end if
      case (4, 5, 6)
        n = n + 1
        call three_numbers(file, surface%vertex(:, n), error)
        if (allocated(error)) return
      end select
      ! After a facet the next one, after a solid perhaps another.
      state = state + 1
      if (state == 9) state = 2
      if (state == 10) state = 1
    end do
    if (state /= 1) then
      call fail(error, exit_input, at(file)//'the file ends where '''//trim(wanted(state))//''' is expected')
      return
    end if
    surface%vertex = surface%vertex(:, :n)
    surface%triangle = reshape([(state, state=1, n)], [3, n/3])
  end subroutine read_text_stl

  !> v x y z and f a b c ...; a polygon must be convex and is cut into a fan. Vertices only:
  !> texture, normals, names and materials are passed over, curved surfaces refused.
  subroutine read_obj(path, surface, error)
    character(len=*), intent(in) :: path
    type(surface_t), intent(out) :: surface
    type(error_t), allocatable, intent(inout) :: error
    type(lines_t) :: file
    real(wp), allocatable :: vertex(:, :)
    integer, allocatable :: triangle(:, :)
    character(len=:), allocatable :: word
    integer(i8) :: bytes
    integer :: unit, n, m
    logical :: found
    call open_file(path, unit, bytes, error)
    if (allocated(error)) return
    close (unit)
    call load(path, bytes, file, error)
    if (allocated(error)) return
    allocate (vertex(3, 1024), triangle(3, 1024))
    n = 0
    m = 0
    do
      call next_line(file, found)
      if (.not. found) exit
      word = word_of(file)
      select case (word)
      case ('v')
        if (n == size(vertex, 2)) call grow_reals(vertex)
        n = n + 1
        call three_numbers(file, vertex(:, n), error)
      case ('f')
        call read_face(file, n, vertex, triangle, m, error)
        if (.not. allocated(error)) call check_size(path, int(m, i8), error)
      case ('vt', 'vn', 'vp', 'o', 'g', 's', 'l', 'p', 'usemtl', 'mtllib', 'usemap', 'maplib', 'bevel', 'c_interp', &
            'd_interp', 'lod', 'shadow_obj', 'trace_obj')
        continue
      case default
        call fail(error, exit_input, at(file)//shown(word)//' is no statement of a polygon OBJ file; read are v and f')
      end select
      if (allocated(error)) return
    end do
    surface%vertex = vertex(:, :n)
    surface%triangle = triangle(:, :m)
  end subroutine read_obj

  !> The corners of a face: i, i/t, i//n or i/t/n, from 1, or negative from the last vertex back.
  subroutine read_face(file, n, vertex, triangle, m, error)
    type(lines_t), intent(in) :: file
    integer, intent(in) :: n
    real(wp), intent(in) :: vertex(:, :)
    integer, allocatable, intent(inout) :: triangle(:, :)
    integer, intent(inout) :: m
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: word, problem
    integer, parameter :: most = 1000
    integer(i8) :: number
    integer :: corner(most), count, place, slash
    place = after_word(file, file%first)
    count = 0
    do while (place <= file%last)
      word = word_at_place(file, place)
      place = after_word(file, place)
      if (count == most) then
        call fail(error, exit_input, at(file)//'a face of more than '//to_text(most)//' corners')
        return
      end if
      count = count + 1
      slash = index(word//'/', '/')
      call parse_integer(word(:slash - 1), number, problem)
      if (allocated(problem)) then
        call fail(error, exit_input, at(file)//'corner '//shown(word)//' '//problem)
        return
      end if
      if (number < 0) number = n + 1 + number
      if (number < 1 .or. number > n) then
        call fail(error, exit_input, at(file)//'corner '//shown(word)//' is no vertex: '//to_text(n)//' stand before it')
        return
      end if
      corner(count) = int(number)
    end do
    if (count < 3) then
      call fail(error, exit_input, at(file)//'a face of '//to_text(count)//' corners; it needs at least 3')
      return
    end if
    call cut_polygon(file, corner(:count), vertex, triangle, m, error)
  end subroutine read_face

  !> A fan about the first corner, every triangle of which must face the polygon's way.
  subroutine cut_polygon(file, corner, vertex, triangle, m, error)
    type(lines_t), intent(in) :: file
    integer, intent(in) :: corner(:)
    real(wp), intent(in) :: vertex(:, :)
    integer, allocatable, intent(inout) :: triangle(:, :)
    integer, intent(inout) :: m
    type(error_t), allocatable, intent(inout) :: error
    integer, allocatable :: larger(:, :)
    real(wp) :: area(3, size(corner)), total(3), a(3), b(3)
    integer :: k
    do k = 2, size(corner) - 1
      a = vertex(:, corner(k)) - vertex(:, corner(1))
      b = vertex(:, corner(k + 1)) - vertex(:, corner(1))
      area(:, k) = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
    end do
    total = 0.0_wp
    do k = 2, size(corner) - 1
      total = total + area(:, k)
    end do
    do k = 2, size(corner) - 1
      if (size(corner) > 3 .and. .not. sum(area(:, k)*total) > 0.0_wp) then
        call fail(error, exit_input, at(file)//'a face of '//to_text(size(corner))//' corners that is not convex; '// &
                  'cut it into triangles')
        return
      end if
      if (m == size(triangle, 2)) then
        allocate (larger(3, 2*m))
        larger(:, :m) = triangle
        call move_alloc(larger, triangle)
      end if
      m = m + 1
      triangle(:, m) = [corner(1), corner(k), corner(k + 1)]
    end do
  end subroutine cut_polygon

  !> Three finite numbers after the line's first word.
  subroutine three_numbers(file, value, error)
    type(lines_t), intent(in) :: file
    real(wp), intent(out) :: value(3)
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: word, problem
    integer :: k, place
    value = 0.0_wp
    place = file%first
    do k = 1, 3
      place = after_word(file, place)
      if (place > file%last) then
        call fail(error, exit_input, at(file)//to_text(k - 1)//' numbers seen, 3 expected')
        return
      end if
      word = word_at_place(file, place)
      call parse_real(word, value(k), problem)
      if (.not. allocated(problem) .and. abs(value(k)) > farthest) problem = 'is beyond '//to_text(farthest)//' m'
      if (.not. allocated(problem)) cycle
      call fail(error, exit_input, at(file)//shown(word)//' '//problem)
      return
    end do
  end subroutine three_numbers

  subroutine grow_reals(vertex)
    real(wp), allocatable, intent(inout) :: vertex(:, :)
    real(wp), allocatable :: larger(:, :)
    integer :: n
    n = size(vertex, 2)
    allocate (larger(3, 2*n))
    larger(:, :n) = vertex
    call move_alloc(larger, vertex)
  end subroutine grow_reals

  !> Refuse what would not fit, before anything is allocated for it.
  subroutine check_size(path, count, error)
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: count
    type(error_t), allocatable, intent(inout) :: error
    if (count <= most_triangles) return
    call fail(error, exit_input, path//': '//to_text(count)//' triangles would need '// &
              byte_text(bytes_per_triangle*real(count, wp))//' of memory; at most '//to_text(most_triangles)// &
              ' are read. Contact does not see details far below a mesh side: simplify the mesh')
  end subroutine check_size

  subroutine open_file(path, unit, bytes, error)
    character(len=*), intent(in) :: path
    integer, intent(out) :: unit
    integer(i8), intent(out) :: bytes
    type(error_t), allocatable, intent(inout) :: error
    character(len=256) :: message
    integer :: status
    bytes = 0
    open (newunit=unit, file=path, access='stream', form='unformatted', status='old', action='read', &
          iostat=status, iomsg=message)
    if (status /= 0) then
      call fail(error, exit_file, 'reading the mesh '//path//': '//trim(message))
      return
    end if
    inquire (unit=unit, size=bytes)
  end subroutine open_file

  !> The whole of a text file.
  subroutine load(path, bytes, file, error)
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: bytes
    type(lines_t), intent(out) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer :: unit, status
    if (bytes > most_bytes) then
      call fail(error, exit_input, path//': a text file of '//byte_text(real(bytes, wp))//'; at most '// &
                byte_text(real(most_bytes, wp))//' are read. Write it as binary STL')
      return
    end if
    allocate (character(len=bytes) :: file%text)
    file%path = path
    open (newunit=unit, file=path, access='stream', form='unformatted', status='old', action='read', iostat=status)
    if (status == 0 .and. bytes > 0) read (unit, iostat=status) file%text
    if (status /= 0) call fail(error, exit_file, 'reading the mesh '//path//': it cannot be read')
    close (unit, iostat=status)
  end subroutine load

  !> Step to the next line that holds a word; # starts a comment.
  subroutine next_line(file, found)
    type(lines_t), intent(inout) :: file
    logical, intent(out) :: found
    integer :: stop_at, hash
    found = .false.
    do while (file%place <= len(file%text))
      file%number = file%number + 1
      stop_at = index(file%text(file%place:), new_line('a'))
      if (stop_at == 0) stop_at = len(file%text) - file%place + 2
      file%first = file%place
      file%last = file%place + stop_at - 2
      file%place = file%place + stop_at
      hash = index(file%text(file%first:file%last), '#')
      if (hash > 0) file%last = file%first + hash - 2
      do while (file%last >= file%first)
        if (.not. is_blank(file%text(file%last:file%last))) exit
        file%last = file%last - 1
      end do
      do while (file%first <= file%last)
        if (.not. is_blank(file%text(file%first:file%first))) exit
        file%first = file%first + 1
      end do
      found = file%first <= file%last
      if (found) return
    end do
  end subroutine next_line

  pure logical function is_blank(c)
    character, intent(in) :: c
    is_blank = c == ' ' .or. c == achar(9) .or. c == achar(13)
  end function is_blank

  !> The line's first word.
  pure function word_of(file) result(word)
    type(lines_t), intent(in) :: file
    character(len=:), allocatable :: word
    word = word_at_place(file, file%first)
  end function word_of

  !> The word that starts at a place.
  pure function word_at_place(file, place) result(word)
    type(lines_t), intent(in) :: file
    integer, intent(in) :: place
    character(len=:), allocatable :: word
    word = file%text(place:end_of_word(file, place))
  end function word_at_place

  pure integer function end_of_word(file, place) result(last)
    type(lines_t), intent(in) :: file
    integer, intent(in) :: place
    last = place
    do while (last < file%last)
      if (is_blank(file%text(last + 1:last + 1))) exit
      last = last + 1
    end do
  end function end_of_word

  !> Where the next word of the line starts, beyond its end if there is none.
  pure integer function after_word(file, place) result(next)
    type(lines_t), intent(in) :: file
    integer, intent(in) :: place
    next = end_of_word(file, place) + 1
    do while (next <= file%last)
      if (.not. is_blank(file%text(next:next))) exit
      next = next + 1
    end do
  end function after_word

  !> A word for a message: quoted, what cannot be printed as '?', not too long.
  pure function shown(word) result(text)
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: text
    integer :: i
    text = word(:min(len(word), 40))
    do i = 1, len(text)
      if (iachar(text(i:i)) < 32 .or. iachar(text(i:i)) > 126) text(i:i) = '?'
    end do
    if (len(word) > 40) text = text//'...'
    text = quoted(text)
  end function shown

  pure function at(file) result(text)
    type(lines_t), intent(in) :: file
    character(len=:), allocatable :: text
    text = file%path//':'//to_text(file%number)//': '
  end function at

end module castnet_mesh_file
