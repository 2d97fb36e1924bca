!> Matrices of 3 x 3 blocks, one row of blocks for each contact, coupled as the contacts'
!> common nodes couple them: sparse Gaussian elimination for eight right sides at once.
!>
!> Contacts are eliminated from the last position to the first. Positions run breadth first,
!> so that those farthest out go first, and where the cables form a tree nothing fills in.
!> Pivots are blocks on the diagonal. The place of every block is found once a list.
module castnet_block_matrix
  use castnet_kinds, only: wp
  use castnet_contact_groups, only: contact_groups_t
  use castnet_contact_list, only: contact_list_t, shared_mobility, lane
  implicit none
  private
  public :: block_matrix_t, find_pattern, fill_matrix, eliminate

  !> A pivot block whose determinant is smaller is singular, of its largest entry's cube [-]: where contacts
  !> are redundant two of its three directions may be held by 1e-11 of the third.
  real(wp), parameter :: singular_below = 1.0e-26_wp

  !> Row p holds, besides its diagonal block, blocks (p,q) with q < p; slot k stands for
  !> (p,q), in `upper`, and (q,p), in `lower`.
  type :: block_matrix_t
    integer :: n = 0
    integer, allocatable :: first(:), last(:)        !! (n) slots of row p
    integer, allocatable :: other(:)                 !! (slots) q, falling along a row
    real(wp), allocatable :: coupling(:)             !! (slots) mobility of one at the other; 0: filled in [1/kg]
    real(wp), allocatable :: own(:)                  !! (n) mobility of a contact at itself [1/kg]
    real(wp), allocatable :: upper(:, :, :), lower(:, :, :) !! (3,3,slots)
    real(wp), allocatable :: diagonal(:, :, :)       !! (3,3,n) blocks, then their inverses
    logical, allocatable :: idle(:)                  !! (n) row p is that of the unit matrix
    real(wp), allocatable :: right(:, :, :)          !! (lane,3,n) right sides, then solutions
    integer, allocatable :: child(:), sibling(:), mark(:) !! (n) scratch of `find_pattern`
  end type block_matrix_t

contains

  !> Where the blocks of this list's matrix stand, and the couplings.
  subroutine find_pattern(list, groups, m)
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(in) :: groups
    type(block_matrix_t), intent(inout) :: m
    integer :: p, q, i, k, c, n_slot
    call reserve_rows(m, list%n)
    m%n = list%n
    m%child(1:m%n) = 0
    m%mark(1:m%n) = 0
    n_slot = 0
    do p = m%n, 1, -1
      i = groups%order(p)
      m%first(p) = n_slot + 1
      if (n_slot + p > size(m%other)) call grow(m, n_slot + p)
      call neighbours(groups, list%node_a(i), p, m, n_slot)
      if (list%node_b(i) /= list%node_a(i)) call neighbours(groups, list%node_b(i), p, m, n_slot)
      c = m%child(p)
      do while (c /= 0)
        do k = m%first(c) + 1, m%last(c)
          call take(m%other(k), p, m, n_slot)
        end do
        c = m%sibling(c)
      end do
      m%last(p) = n_slot
      call sort_falling(m%other(m%first(p):n_slot))
      m%own(p) = shared_mobility(list, i, i)
      do k = m%first(p), n_slot
        m%coupling(k) = shared_mobility(list, i, groups%order(m%other(k)))
      end do
      if (m%last(p) < m%first(p)) cycle
      q = m%other(m%first(p))
      m%sibling(p) = m%child(q)
      m%child(q) = p
    end do
    if (size(m%upper, 3) < n_slot) then
      deallocate (m%upper, m%lower)
      allocate (m%upper(3, 3, 2*n_slot), m%lower(3, 3, 2*n_slot))
    end if
  end subroutine find_pattern

  !> The contacts at a node that are numbered before p.
  pure subroutine neighbours(groups, node, p, m, n_slot)
    type(contact_groups_t), intent(in) :: groups
    integer, intent(in) :: node, p
    type(block_matrix_t), intent(inout) :: m
    integer, intent(inout) :: n_slot
    integer :: entry, k
    entry = groups%head(node)
    do while (entry /= 0)
      k = abs(entry)
      if (groups%place(k) < p) call take(groups%place(k), p, m, n_slot)
      entry = merge(groups%next_a(k), groups%next_b(k), entry > 0)
    end do
  end subroutine neighbours

  !> A slot for (p,q), once.
  pure subroutine take(q, p, m, n_slot)
    integer, intent(in) :: q, p
    type(block_matrix_t), intent(inout) :: m
    integer, intent(inout) :: n_slot
    if (m%mark(q) == p) return
    m%mark(q) = p
    n_slot = n_slot + 1
    m%other(n_slot) = q
  end subroutine take

  !> By insertion: a row has a few.
  pure subroutine sort_falling(a)
    integer, intent(inout) :: a(:)
    integer :: i, k, v
    do i = 2, size(a)
      v = a(i)
      do k = i - 1, 1, -1
        if (a(k) >= v) exit
        a(k + 1) = a(k)
      end do
      a(k + 1) = v
    end do
  end subroutine sort_falling

  subroutine reserve_rows(m, n)
    type(block_matrix_t), intent(inout) :: m
    integer, intent(in) :: n
    if (allocated(m%first)) then
      if (size(m%first) >= n) return
      deallocate (m%first, m%last, m%own, m%diagonal, m%idle, m%right, m%child, m%sibling, m%mark)
    end if
    allocate (m%first(2*n), m%last(2*n), m%child(2*n), m%sibling(2*n), m%mark(2*n), source=0)
    allocate (m%own(2*n), m%diagonal(3, 3, 2*n), m%right(lane, 3, 2*n), source=0.0_wp)
    allocate (m%idle(2*n), source=.false.)
    if (.not. allocated(m%other)) allocate (m%other(0), m%coupling(0), m%upper(3, 3, 0), m%lower(3, 3, 0))
  end subroutine reserve_rows

  subroutine grow(m, n_slot)
    type(block_matrix_t), intent(inout) :: m
    integer, intent(in) :: n_slot
    integer, allocatable :: other(:)
    real(wp), allocatable :: coupling(:)
    integer :: old
    old = size(m%other)
    allocate (other(2*n_slot), source=0)
    allocate (coupling(2*n_slot), source=0.0_wp)
    other(1:old) = m%other
    coupling(1:old) = m%coupling
    call move_alloc(other, m%other)
    call move_alloc(coupling, m%coupling)
  end subroutine grow

  !> 1 + P (along A - less rho): `slope` P of each row, `own` the rho.
  pure subroutine fill_matrix(m, slope, along, less, rho)
    type(block_matrix_t), intent(inout) :: m
    real(wp), intent(in) :: slope(3, 3, *), along, less, rho(*)
    real(wp) :: a
    integer :: p, k, q, c
    do p = 1, m%n
      if (.not. m%idle(p)) then
        a = along*m%own(p) - less*rho(p)
        m%diagonal(:, :, p) = a*slope(:, :, p)
        do c = 1, 3
          m%diagonal(c, c, p) = m%diagonal(c, c, p) + 1.0_wp
        end do
      end if
      do k = m%first(p), m%last(p)
        q = m%other(k)
        a = along*m%coupling(k)
        m%upper(:, :, k) = a*slope(:, :, p)
        m%lower(:, :, k) = a*slope(:, :, q)
      end do
    end do
  end subroutine fill_matrix

  !> Solve for the right sides in place. `negative`: the determinant is.
  pure subroutine eliminate(m, negative, ok)
    type(block_matrix_t), intent(inout) :: m
    logical, intent(out) :: negative, ok
    real(wp) :: determinant
    integer :: p, k, l, s, q
    ok = .true.
    negative = .false.
    do p = m%n, 1, -1
      if (m%idle(p)) then
        do k = m%first(p), m%last(p)
          q = m%other(k)
          if (.not. m%idle(q)) call subtract(m%lower(:, :, k), m%right(:, :, p), m%right(:, :, q))
        end do
        cycle
      end if
      call invert(m%diagonal(:, :, p), determinant, ok)
      if (.not. ok) return
      if (determinant < 0.0_wp) negative = .not. negative
      do k = m%first(p), m%last(p)
        q = m%other(k)
        if (m%idle(q)) cycle
        call times(m%lower(:, :, k), m%diagonal(:, :, p))
        call subtract(m%lower(:, :, k), m%right(:, :, p), m%right(:, :, q))
        call subtract_product(m%lower(:, :, k), m%upper(:, :, k), m%diagonal(:, :, q))
      end do
      do k = m%first(p), m%last(p)
        q = m%other(k)
        s = m%first(q)
        do l = k + 1, m%last(p)
          do while (m%other(s) /= m%other(l))
            s = s + 1
          end do
          if (.not. m%idle(q)) call subtract_product(m%lower(:, :, k), m%upper(:, :, l), m%upper(:, :, s))
          if (.not. m%idle(m%other(l))) call subtract_product(m%lower(:, :, l), m%upper(:, :, k), m%lower(:, :, s))
        end do
      end do
    end do
    do p = 1, m%n
      if (m%idle(p)) cycle
      do k = m%first(p), m%last(p)
        call subtract(m%upper(:, :, k), m%right(:, :, m%other(k)), m%right(:, :, p))
      end do
      call multiply_right(m%diagonal(:, :, p), m%right(:, :, p))
    end do
  end subroutine eliminate

  !> By cofactors.
  pure subroutine invert(a, determinant, ok)
    real(wp), intent(inout) :: a(3, 3)
    real(wp), intent(out) :: determinant
    logical, intent(out) :: ok
    real(wp) :: b(3, 3), size, inverse
    b(1, 1) = a(2, 2)*a(3, 3) - a(2, 3)*a(3, 2)
    b(1, 2) = a(1, 3)*a(3, 2) - a(1, 2)*a(3, 3)
    b(1, 3) = a(1, 2)*a(2, 3) - a(1, 3)*a(2, 2)
    b(2, 1) = a(2, 3)*a(3, 1) - a(2, 1)*a(3, 3)
    b(2, 2) = a(1, 1)*a(3, 3) - a(1, 3)*a(3, 1)
    b(2, 3) = a(1, 3)*a(2, 1) - a(1, 1)*a(2, 3)
    b(3, 1) = a(2, 1)*a(3, 2) - a(2, 2)*a(3, 1)
    b(3, 2) = a(1, 2)*a(3, 1) - a(1, 1)*a(3, 2)
    b(3, 3) = a(1, 1)*a(2, 2) - a(1, 2)*a(2, 1)
    determinant = a(1, 1)*b(1, 1) + a(1, 2)*b(2, 1) + a(1, 3)*b(3, 1)
    size = max(abs(a(1, 1)), abs(a(2, 1)), abs(a(3, 1)), abs(a(1, 2)), abs(a(2, 2)), abs(a(3, 2)), abs(a(1, 3)), &
               abs(a(2, 3)), abs(a(3, 3)))
    ok = abs(determinant) > singular_below*size*size*size
    if (.not. ok) return
    inverse = 1.0_wp/determinant
    a = inverse*b
  end subroutine invert

  !> a <- a b.
  pure subroutine times(a, b)
    real(wp), intent(inout) :: a(3, 3)
    real(wp), intent(in) :: b(3, 3)
    real(wp) :: x, y, z
    integer :: c
    do c = 1, 3
      x = a(c, 1)
      y = a(c, 2)
      z = a(c, 3)
      a(c, 1) = x*b(1, 1) + y*b(2, 1) + z*b(3, 1)
      a(c, 2) = x*b(1, 2) + y*b(2, 2) + z*b(3, 2)
      a(c, 3) = x*b(1, 3) + y*b(2, 3) + z*b(3, 3)
    end do
  end subroutine times

  !> c <- c - a b.
  pure subroutine subtract_product(a, b, c)
    real(wp), intent(in) :: a(3, 3), b(3, 3)
    real(wp), intent(inout) :: c(3, 3)
    integer :: i, k
    do k = 1, 3
      do i = 1, 3
        c(i, k) = c(i, k) - (a(i, 1)*b(1, k) + a(i, 2)*b(2, k) + a(i, 3)*b(3, k))
      end do
    end do
  end subroutine subtract_product

  !> y <- y - a x for every right side.
  pure subroutine subtract(a, x, y)
    real(wp), intent(in) :: a(3, 3), x(lane, 3)
    real(wp), intent(inout) :: y(lane, 3)
    integer :: l, c
    do c = 1, 3
      do l = 1, lane
        y(l, c) = y(l, c) - (a(c, 1)*x(l, 1) + a(c, 2)*x(l, 2) + a(c, 3)*x(l, 3))
      end do
    end do
  end subroutine subtract

  !> x <- a x for every right side.
  pure subroutine multiply_right(a, x)
    real(wp), intent(in) :: a(3, 3)
    real(wp), intent(inout) :: x(lane, 3)
    real(wp) :: x1, x2, x3
    integer :: l
    do l = 1, lane
      x1 = x(l, 1)
      x2 = x(l, 2)
      x3 = x(l, 3)
      x(l, 1) = a(1, 1)*x1 + a(1, 2)*x2 + a(1, 3)*x3
      x(l, 2) = a(2, 1)*x1 + a(2, 2)*x2 + a(2, 3)*x3
      x(l, 3) = a(3, 1)*x1 + a(3, 2)*x2 + a(3, 3)*x3
    end do
  end subroutine multiply_right

end module castnet_block_matrix
