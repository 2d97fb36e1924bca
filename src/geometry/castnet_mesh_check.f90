!> Makes one closed, outward surface of a file's triangles, or says what is wrong with them.
!>
!> Corners are joined as little as needed: as indexed, then where they are the same numbers,
!> then within 1e-6 of the size (single-precision text). A surface that is inside out as a
!> whole is turned; anything else that is not a closed solid is refused.
module castnet_mesh_check
  use castnet_kinds, only: wp
  use castnet_error, only: error_t, fail, exit_input
  use castnet_surface, only: surface_t, surface_volume
  use castnet_text, only: to_text
  implicit none
  private
  public :: close_surface, sorted_order

  real(wp), parameter :: join_ratio = 1.0e-6_wp       !! of the size, joined at the last try
  real(wp), parameter :: flat_ratio = 1.0e-10_wp      !! area over squared longest side: no direction
  real(wp), parameter :: least_size = 1.0e-3_wp, largest_size = 1.0e3_wp  !! [m]

contains

  !> Join corners, check that the surface bounds a solid, turn it outward.
  !> Errors (exit 2): size that is not a target's in metres, triangle without area, open or
  !> over-used edge, neighbours that face opposite ways, shell inside out.
  subroutine close_surface(surface, path, error)
    type(surface_t), intent(inout) :: surface
    character(len=*), intent(in) :: path              !! for messages
    type(error_t), allocatable, intent(inout) :: error
    type(surface_t) :: joined
    character(len=:), allocatable :: problem
    real(wp) :: extent
    integer :: attempt
    extent = maxval(maxval(surface%vertex, 2) - minval(surface%vertex, 2))
    if (.not. (extent >= least_size .and. extent <= largest_size)) then
      call fail(error, exit_input, path//': the mesh is '//length_text(extent)// &
                ' m long; from 1 mm to 1 km are taken. Coordinates are metres: was it drawn in millimetres?')
      return
    end if
    do attempt = 1, 3
      joined = surface
      select case (attempt)
      case (2)
        call join(joined, 0.0_wp)
      case (3)
        call join(joined, join_ratio*extent)
      end select
      if (attempt == 3) call drop_collapsed(joined)
      call find_problem(joined, problem)
      if (.not. allocated(problem)) exit
    end do
    if (.not. allocated(problem)) call face_outward(joined, problem)
    if (allocated(problem)) then
      call fail(error, exit_input, path//': '//problem)
      return
    end if
    call drop_unused(joined)
    surface = joined
  end subroutine close_surface

  !> Give corners within `tolerance` of each other one number. Sorted along a skew direction, so that
  !> the corners of a flat face do not all come at once.
  subroutine join(surface, tolerance)
    type(surface_t), intent(inout) :: surface
    real(wp), intent(in) :: tolerance
    real(wp), parameter :: skew(3) = [0.6_wp, 0.48_wp, 0.64_wp]
    real(wp), allocatable :: key(:)
    integer, allocatable :: order(:), first(:)
    real(wp) :: slack
    integer :: i, j, k, a, b
    associate (vertex => surface%vertex)
      allocate (key(size(vertex, 2)), first(size(vertex, 2)))
      do i = 1, size(vertex, 2)
        key(i) = skew(1)*vertex(1, i) + skew(2)*vertex(2, i) + skew(3)*vertex(3, i)
        first(i) = i
      end do
      order = sorted_order(key)
      slack = 2.0_wp*tolerance
      do i = 1, size(order)
        a = order(i)
        if (first(a) /= a) cycle
        do j = i + 1, size(order)
          b = order(j)
          if (key(b) - key(a) > slack) exit
          if (first(b) /= b) cycle
          if (maxval(abs(vertex(:, a) - vertex(:, b))) <= tolerance) first(b) = a
        end do
      end do
    end associate
    do i = 1, size(surface%triangle, 2)
      do k = 1, 3
        surface%triangle(k, i) = first(surface%triangle(k, i))
      end do
    end do
  end subroutine join

  !> A triangle two of whose corners were joined is an edge: its neighbours meet there.
  subroutine drop_collapsed(surface)
    type(surface_t), intent(inout) :: surface
    integer :: i, n
    n = 0
    do i = 1, size(surface%triangle, 2)
      associate (t => surface%triangle(:, i))
        if (t(1) == t(2) .or. t(2) == t(3) .or. t(3) == t(1)) cycle
        n = n + 1
        surface%triangle(:, n) = t
      end associate
    end do
    surface%triangle = surface%triangle(:, :n)
  end subroutine drop_collapsed

  subroutine drop_unused(surface)
    type(surface_t), intent(inout) :: surface
    integer, allocatable :: number(:)
    integer :: i, k, n
    allocate (number(size(surface%vertex, 2)), source=0)
    do i = 1, size(surface%triangle, 2)
      do k = 1, 3
        number(surface%triangle(k, i)) = 1
      end do
    end do
    n = 0
    do i = 1, size(number)
      if (number(i) == 0) cycle
      n = n + 1
      number(i) = n
      surface%vertex(:, n) = surface%vertex(:, i)
    end do
    surface%vertex = surface%vertex(:, :n)
    do i = 1, size(surface%triangle, 2)
      do k = 1, 3
        surface%triangle(k, i) = number(surface%triangle(k, i))
      end do
    end do
  end subroutine drop_unused

  !> What keeps the triangles from bounding a solid; not allocated: nothing.
  subroutine find_problem(surface, problem)
    type(surface_t), intent(in) :: surface
    character(len=:), allocatable, intent(out) :: problem
    real(wp), allocatable :: key(:)
    integer, allocatable :: order(:), way(:)
    real(wp) :: a(3), b(3), c(3), area(3), longest
    integer :: i, k, n, m, first, last, from, to
    n = size(surface%vertex, 2)
    m = size(surface%triangle, 2)
    allocate (key(3*m), way(3*m))
    do i = 1, m
      associate (t => surface%triangle(:, i))
        a = surface%vertex(:, t(2)) - surface%vertex(:, t(1))
        b = surface%vertex(:, t(3)) - surface%vertex(:, t(1))
        c = b - a
        area = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
        longest = max(sum(a*a), sum(b*b), sum(c*c))
        if (.not. sqrt(sum(area*area)) > flat_ratio*longest) then
          problem = 'triangle '//to_text(i)//' has no area, near '//place(surface%vertex(:, t(1)))// &
                    '; mend the mesh before using it'
          return
        end if
        do k = 1, 3
          from = t(k)
          to = t(modulo(k, 3) + 1)
          key(3*i - 3 + k) = real(min(from, to), wp)*real(n + 1, wp) + real(max(from, to), wp)
          way(3*i - 3 + k) = merge(1, -1, from < to)
        end do
      end associate
    end do
    order = sorted_order(key)
    first = 1
    do while (first <= 3*m)
      last = first
      do while (last < 3*m)
        if (key(order(last + 1)) > key(order(first))) exit
        last = last + 1
      end do
      i = (order(first) + 2)/3
      k = order(first) - 3*(i - 1)
      from = surface%triangle(k, i)
      to = surface%triangle(modulo(k, 3) + 1, i)
      if (last == first) then
        problem = 'the surface is open: triangle '//to_text(i)//' has no neighbour at its edge'
      else if (last > first + 1) then
        problem = 'not the surface of one solid: '//to_text(last - first + 1)//' triangles meet at one edge (triangle '// &
                  to_text(i)//' is one)'
      else if (way(order(first)) + way(order(last)) /= 0) then
        problem = 'triangles '//to_text(i)//' and '//to_text((order(last) + 2)/3)//' face opposite ways at their edge'
      end if
      if (allocated(problem)) then
        problem = problem//' from '//place(surface%vertex(:, from))//' to '//place(surface%vertex(:, to))// &
                  '; a target must be a closed surface'
        return
      end if
      first = last + 1
    end do
  end subroutine find_problem

  !> Turn a surface that is inside out; of several shells those that stay inside out must be cavities.
  subroutine face_outward(surface, problem)
    type(surface_t), intent(inout) :: surface
    character(len=:), allocatable, intent(out) :: problem
    integer, allocatable :: shell(:)
    real(wp), allocatable :: volume(:), lower(:, :), upper(:, :)
    real(wp) :: total
    integer :: i, k, n
    logical :: is_cavity
    call number_shells(surface, shell, n)
    if (n == 0) then           ! every triangle collapsed when its corners were joined
      problem = 'the surface encloses no volume'
      return
    end if
    allocate (volume(n), lower(3, n), upper(3, n))
    total = 0.0_wp
    do i = 1, n
      call measure_shell(surface, shell, i, volume(i), lower(:, i), upper(:, i))
      total = total + volume(i)
    end do
    if (.not. abs(total) > 1.0e-12_wp*product(maxval(upper, 2) - minval(lower, 2))) then
      problem = 'the surface encloses no volume'
      return
    end if
    if (total < 0.0_wp) then
      volume = -volume
      do i = 1, size(surface%triangle, 2)
        surface%triangle(:, i) = surface%triangle([1, 3, 2], i)
      end do
    end if
    do i = 1, n
      if (volume(i) > 0.0_wp) cycle
      is_cavity = .false.
      do k = 1, n
        is_cavity = is_cavity .or. (volume(k) > -volume(i) .and. all(lower(:, k) < lower(:, i)) &
                                    .and. all(upper(:, k) > upper(:, i)))
      end do
      if (is_cavity) cycle
      problem = 'of '//to_text(n)//' shells the one near '//place(lower(:, i))// &
                ' is inside out; turn its triangles or leave it out'
      return
    end do
  end subroutine face_outward

  !> Number the connected pieces: triangles that share a corner.
  subroutine number_shells(surface, shell, n)
    type(surface_t), intent(in) :: surface
    integer, allocatable, intent(out) :: shell(:)    !! of each triangle
    integer, intent(out) :: n
    integer, allocatable :: parent(:), number(:)
    integer :: i, k, a, b
    allocate (parent(size(surface%vertex, 2)), number(size(surface%vertex, 2)), shell(size(surface%triangle, 2)))
    parent = [(i, i=1, size(parent))]
    do i = 1, size(shell)
      a = root(parent, surface%triangle(1, i))
      do k = 2, 3
        b = root(parent, surface%triangle(k, i))
        parent(b) = a
      end do
    end do
    n = 0
    number = 0
    do i = 1, size(shell)
      a = root(parent, surface%triangle(1, i))
      if (number(a) == 0) then
        n = n + 1
        number(a) = n
      end if
      shell(i) = number(a)
    end do
  end subroutine number_shells

  !> The last of a chain of parents, which is halved on the way.
  integer function root(parent, i)
    integer, intent(inout) :: parent(:)
    integer, intent(in) :: i
    root = i
    do while (parent(root) /= root)
      parent(root) = parent(parent(root))
      root = parent(root)
    end do
  end function root

  subroutine measure_shell(surface, shell, number, volume, lower, upper)
    type(surface_t), intent(in) :: surface
    integer, intent(in) :: shell(:), number
    real(wp), intent(out) :: volume, lower(3), upper(3)
    type(surface_t) :: piece
    integer :: i, k
    allocate (piece%vertex, source=surface%vertex)
    allocate (piece%triangle(3, count(shell == number)))
    lower = huge(1.0_wp)
    upper = -huge(1.0_wp)
    k = 0
    do i = 1, size(shell)
      if (shell(i) /= number) cycle
      k = k + 1
      piece%triangle(:, k) = surface%triangle(:, i)
      lower = min(lower, minval(surface%vertex(:, surface%triangle(:, i)), 2))
      upper = max(upper, maxval(surface%vertex(:, surface%triangle(:, i)), 2))
    end do
    volume = surface_volume(piece)
  end subroutine measure_shell

  pure function length_text(length) result(text)
    real(wp), intent(in) :: length
    character(len=:), allocatable :: text
    character(len=16) :: buffer
    write (buffer, '(g0.4)') length
    text = trim(buffer)
  end function length_text

  pure function place(point) result(text)
    real(wp), intent(in) :: point(3)
    character(len=:), allocatable :: text
    character(len=48) :: buffer
    write (buffer, '("(",g0.5,", ",g0.5,", ",g0.5,")")') point
    text = trim(buffer)
  end function place

  !> The order that sorts real keys upward; equal keys keep theirs (merge sort).
  pure function sorted_order(key) result(order)
    real(wp), intent(in) :: key(:)
    integer, allocatable :: order(:)
    integer, allocatable :: other(:)
    integer :: n, width, start, i, j, k, middle, last
    n = size(key)
    allocate (order(n), other(n))
    order = [(i, i=1, n)]
    width = 1
    do while (width < n)
      do start = 1, n, 2*width
        middle = min(start + width - 1, n)
        last = min(start + 2*width - 1, n)
        i = start
        j = middle + 1
        do k = start, last
          if (j > last) then
            other(k) = order(i)
            i = i + 1
          else if (i > middle) then
            other(k) = order(j)
            j = j + 1
          else if (key(order(j)) < key(order(i))) then
            other(k) = order(j)
            j = j + 1
          else
            other(k) = order(i)
            i = i + 1
          end if
        end do
      end do
      order = other
      width = 2*width
    end do
  end function sorted_order

end module castnet_mesh_check
