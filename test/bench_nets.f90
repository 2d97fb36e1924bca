!> Nets as files may hold them, for the benchmark of the force kernel: nodes and cables in
!> random order, and no hint of how they hang together.
module bench_nets
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_model_builder, only: file_net_t, build_model
  use castnet_net_builder, only: finish_net
  use castnet_scene, only: scene_t
  use castnet_state, only: state_t
  use scenes, only: random_numbers
  implicit none
  private
  public :: general_net, shape_of

contains

  !> Make the scene's square net one from a file: `shuffled` is the same net, `holes` lacks one
  !> cable in a hundred; the kinds of `shape_of` have about as many nodes.
  subroutine general_net(kind, squares, scene, file)
    character(len=*), intent(in) :: kind
    integer, intent(in) :: squares
    type(scene_t), intent(inout) :: scene
    type(file_net_t), allocatable, intent(out) :: file
    type(model_t) :: model
    type(state_t) :: state
    type(file_net_t), allocatable :: none
    type(error_t), allocatable :: error
    real(wp), allocatable :: x(:, :)
    integer, allocatable :: cables(:, :)
    integer :: c

    select case (kind)
    case ('shuffled', 'holes')
      call build_model(scene, none, model, state, error)
      if (allocated(error)) error stop 'no square net'
      x = transpose(state%node_position(:model%net%n_node, :))
      cables = model%net%cable_nodes
      if (kind == 'holes') cables = cables(:, pack([(c, c=1, size(cables, 2))], [(modulo(c, 101) /= 50, c=1, size(cables, 2))]))
    case default
      call shape_of(kind, squares + 1, x, cables)
    end select
    call scatter(x, cables, file)
    scene%net%kind = 'file'
    scene%time%allow_unstable = .true.   ! the bound for any shape is lower
    deallocate (scene%bullets)
  end subroutine general_net

  !> About n x n nodes of one kind, in the plane x = 0, and the cables between them: `hexagonal`,
  !> `radial` (a spider's net), `round` (squares in a circle), `triangular` (in a hexagon), `irregular`.
  subroutine shape_of(kind, n, x, cables)
    character(len=*), intent(in) :: kind
    integer, intent(in) :: n
    real(wp), allocatable, intent(out) :: x(:, :)      !! (3,nodes) [m]
    integer, allocatable, intent(out) :: cables(:, :)  !! (2,cables)
    select case (kind)
    case ('hexagonal')
      call honeycomb(n, x, cables)
    case ('radial')
      call spider(n, x, cables)
    case ('round')
      call cut_out([1.0_wp, 0.0_wp], [0.0_wp, 1.0_wp], nint(0.5642_wp*n), .false., x, cables)
    case ('triangular')
      call cut_out([1.0_wp, 0.0_wp], [0.5_wp, 0.8660254037844386_wp], nint(0.5774_wp*n), .true., x, cables)
    case ('irregular')
      call gabriel(n*n, x, cables)
    case default
      error stop 'no such shape'
    end select
  end subroutine shape_of

  !> The lattice of steps e1 and e2 within a circle, or with e2 - e1 for a third step within a hexagon.
  subroutine cut_out(e1, e2, radius, hexagon, x, cables)
    real(wp), intent(in) :: e1(2), e2(2)
    integer, intent(in) :: radius
    logical, intent(in) :: hexagon
    real(wp), allocatable, intent(out) :: x(:, :)
    integer, allocatable, intent(out) :: cables(:, :)
    integer, parameter :: step(2, 3) = reshape([1, 0, 0, 1, -1, 1], [2, 3])
    integer :: number(-radius - 1:radius + 1, -radius - 1:radius + 1), i, j, s, n, c, other
    logical :: inside
    number = 0
    n = 0
    allocate (x(3, (2*radius + 1)**2), cables(2, 3*(2*radius + 1)**2))
    do j = -radius, radius
      do i = -radius, radius
        inside = i*i + j*j <= radius*radius
        if (hexagon) inside = abs(i + j) <= radius
        if (.not. inside) cycle
        n = n + 1
        number(i, j) = n
        x(:, n) = [0.0_wp, i*e1 + j*e2]*15.0_wp/radius
      end do
    end do
    c = 0
    do j = -radius, radius
      do i = -radius, radius
        do s = 1, merge(3, 2, hexagon)
          other = number(i + step(1, s), j + step(2, s))
          if (number(i, j) == 0 .or. other == 0) cycle
          c = c + 1
          cables(:, c) = [number(i, j), other]
        end do
      end do
    end do
    x = x(:, :n)
    cables = cables(:, :c)
  end subroutine cut_out

  !> n random points; two are joined if no other lies in the circle between them (a Gabriel graph):
  !> no lattice at all, in the mean two cables a node.
  subroutine gabriel(n, x, cables)
    integer, intent(in) :: n
    real(wp), allocatable, intent(out) :: x(:, :)
    integer, allocatable, intent(out) :: cables(:, :)
    integer :: side, seed, i, j, k, c, here(2), low(2), high(2), a, b, count_near
    integer, allocatable :: head(:, :), next(:), near(:)
    real(wp) :: p(2*n), middle(2), radius
    seed = 4711
    call random_numbers(seed, p)
    side = max(1, int(sqrt(n/2.0_wp)))
    allocate (head(side, side), next(n), near(n), source=0)
    allocate (x(3, n), cables(2, 3*n))
    do i = 1, n
      x(:, i) = [0.0_wp, p(2*i - 1), p(2*i)]*15.0_wp
      here = cell(p(2*i - 1:2*i))
      next(i) = head(here(1), here(2))
      head(here(1), here(2)) = i
    end do
    c = 0
    do i = 1, n
      here = cell(p(2*i - 1:2*i))
      low = max(1, here - 3)
      high = min(side, here + 3)
      count_near = 0
      do b = low(2), high(2)
        do a = low(1), high(1)
          j = head(a, b)
          do while (j > 0)
            count_near = count_near + 1
            near(count_near) = j
            j = next(j)
          end do
        end do
      end do
      do a = 1, count_near
        j = near(a)
        if (j <= i) cycle
        middle = 0.5_wp*(p(2*i - 1:2*i) + p(2*j - 1:2*j))
        radius = sum((p(2*i - 1:2*i) - middle)**2)
        do b = 1, count_near
          k = near(b)
          if (k == i .or. k == j) cycle
          if (sum((p(2*k - 1:2*k) - middle)**2) < radius) exit
        end do
        if (b <= count_near) cycle
        c = c + 1
        cables(:, c) = [i, j]
      end do
    end do
    cables = cables(:, :c)

  contains

    function cell(point)
      real(wp), intent(in) :: point(2)
      integer :: cell(2)
      cell = min(side, 1 + int(0.5_wp*(point + 1.0_wp)*side))
    end function cell

  end subroutine gabriel

  !> A sheet of hexagons: rows of zigzags, every second node joined to the next row.
  subroutine honeycomb(n, x, cables)
    integer, intent(in) :: n
    real(wp), allocatable, intent(out) :: x(:, :)
    integer, allocatable, intent(out) :: cables(:, :)
    integer :: i, j, c, node
    allocate (x(3, n*n), cables(2, 2*n*n))
    c = 0
    do j = 1, n
      do i = 1, n
        node = (j - 1)*n + i
        x(:, node) = [0.0_wp, 0.87_wp*i, 1.5_wp*j + 0.25_wp*merge(1, -1, modulo(i + j, 2) == 0)]*30.0_wp/n
        if (i < n) call join(node, node + 1)
        if (j < n .and. modulo(i + j, 2) == 0) call join(node, node + n)
      end do
    end do
    cables = cables(:, :c)
  contains
    subroutine join(a, b)
      integer, intent(in) :: a, b
      c = c + 1
      cables(:, c) = [a, b]
    end subroutine join
  end subroutine honeycomb

  !> Spokes from a hub and rings across them.
  subroutine spider(n, x, cables)
    integer, intent(in) :: n
    real(wp), allocatable, intent(out) :: x(:, :)
    integer, allocatable, intent(out) :: cables(:, :)
    integer :: spoke, ring, c, spokes, node
    real(wp) :: angle
    spokes = 2*n
    allocate (x(3, 1 + spokes*(n/2)), cables(2, 2*spokes*(n/2)))
    x(:, 1) = 0.0_wp
    c = 0
    do ring = 1, n/2
      do spoke = 1, spokes
        node = 1 + (ring - 1)*spokes + spoke
        angle = 6.283185307179586_wp*spoke/spokes
        x(:, node) = [0.0_wp, cos(angle), sin(angle)]*15.0_wp*ring/(n/2)
        cables(:, c + 1) = [merge(1, node - spokes, ring == 1), node]
        cables(:, c + 2) = [node, merge(node + 1 - spokes, node + 1, spoke == spokes)]
        c = c + 2
      end do
    end do
  end subroutine spider

  !> Nodes and cables in random order, folded to a third: cables of the rocket's net, slightly taut once it opens.
  subroutine scatter(x, cables, file)
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: cables(:, :)
    type(file_net_t), allocatable, intent(out) :: file
    integer, allocatable :: node(:), cable(:)
    real(wp) :: d(3)
    integer :: n, m, c, seed
    n = size(x, 2)
    m = size(cables, 2)
    seed = 12345
    node = permutation(n, seed)
    cable = permutation(m, seed)
    allocate (file)
    associate (net => file%net)
      net%n_node = n
      net%n_cable = m
      allocate (net%node_mass(n), net%fixed(n), net%is_bullet(n), net%cable_nodes(2, m), net%natural_length(m), &
                net%axial_stiffness(m), net%damping(m), file%position(3, n), file%velocity(3, n), net%faces(4, 0))
      allocate (net%bullet_nodes(0), net%perimeter_nodes(0), net%corner_nodes(0))
      net%node_mass = 1.4_wp/n
      net%fixed = .false.
      net%is_bullet = .false.
      net%axial_stiffness = 100.0_wp
      file%position(:, node) = x
      file%velocity(:, node) = 0.3_wp*x           ! it opens, and its cables grow taut
      net%cable_nodes(1, cable) = node(cables(1, :))
      net%cable_nodes(2, cable) = node(cables(2, :))
      do c = 1, m
        d = file%position(:, net%cable_nodes(2, c)) - file%position(:, net%cable_nodes(1, c))
        net%natural_length(c) = max(1.0e-3_wp, 1.02_wp*sqrt(d(1)**2 + d(2)**2 + d(3)**2))
        net%damping(c) = 0.1_wp*sqrt(100.0_wp/net%natural_length(c)*2.8_wp/n)
      end do
    end associate
    call finish_net(file%net)
  end subroutine scatter

  function permutation(n, seed) result(p)
    integer, intent(in) :: n
    integer, intent(inout) :: seed
    integer, allocatable :: p(:)
    real(wp) :: r(1)
    integer :: i, j, k
    p = [(i, i=1, n)]
    do i = n, 2, -1
      call random_numbers(seed, r)
      j = min(i, 1 + int(0.5_wp*(r(1) + 1.0_wp)*i))
      k = p(i); p(i) = p(j); p(j) = k
    end do
  end function permutation

end module bench_nets
