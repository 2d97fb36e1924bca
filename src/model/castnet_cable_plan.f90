!> The cables in the order in which the force kernel runs through them.
!>
!> A cable joins node a to node a + offset. Cables of the same offset whose first
!> nodes follow each other form a **diagonal** (as in a sparse matrix stored by
!> diagonals): the kernel reads both ends with unit stride, no gather. Short gaps are
!> bridged by phantom cables of no stiffness. A square net is two diagonals (along y,
!> along z) and four loose corner cables. What does not fit a diagonal is **loose**:
!> its ends are gathered through an index.
!>
!> Every diagonal has offset > 0, so that once all cables that begin at or before
!> node i are known, the force on node i is complete: one sweep over the nodes does
!> cables, forces and the stage update while the data are in the first cache.
module castnet_cable_plan
  use castnet_kinds, only: wp
  implicit none
  private
  public :: cable_plan_t, build_cable_plan

  integer, parameter :: longest_gap = 8     !! phantom cables in a row; beyond that a new diagonal begins
  integer, parameter :: shortest_run = 16   !! cables that make a diagonal worth its loop
  real(wp), parameter :: never_taut = 1.0e30_wp  !! natural length of a phantom cable [m]

  type :: cable_plan_t
    integer :: n_diagonal = 0
    integer :: max_offset = 0
    integer, allocatable :: offset(:)          !! (n_diagonal) second node minus first node, > 0
    integer, allocatable :: first(:)           !! (n_diagonal) first node of its first cable
    integer, allocatable :: last(:)            !! (n_diagonal) first node of its last cable
    integer, allocatable :: start(:)           !! (n_diagonal) slot of its first cable
    integer :: n_loose = 0
    integer :: loose_start = 1                 !! slot of the first loose cable
    integer, allocatable :: loose_a(:), loose_b(:) !! (n_loose) end nodes
    integer :: n_loose_node = 0
    integer, allocatable :: loose_node(:)      !! (n_loose_node) nodes with loose cables, ascending
    integer, allocatable :: loose_pointer(:)   !! (n_loose_node+1) into loose_entry
    integer, allocatable :: loose_entry(:)     !! loose cable; negative: this node is its second end
    integer :: n_slot = 0                      !! cables and phantoms
    integer, allocatable :: slot_of_cable(:)   !! (n_cable)
    logical, allocatable :: reversed(:)        !! (n_cable) slot runs from the cable's second node to its first
    real(wp), allocatable :: stiffness(:)      !! (n_slot) k = EA / natural length, 0 for phantoms [N/m]
    real(wp), allocatable :: natural_length(:) !! (n_slot) [m]
    real(wp), allocatable :: damping(:)        !! (n_slot) [N s/m]
    real(wp), allocatable :: applied_damping(:) !! (n_slot) the same as the method applies it (midpoint_damping) [N s/m]
  end type cable_plan_t

contains

  !> Arrange cables for the kernel. Lengths and stiffnesses must be positive.
  subroutine build_cable_plan(plan, n_node, cable_nodes, axial_stiffness, natural_length, damping)
    type(cable_plan_t), intent(out) :: plan
    integer, intent(in) :: n_node
    integer, intent(in) :: cable_nodes(:, :)       !! (2,n_cable), counted from 1
    real(wp), intent(in) :: axial_stiffness(:)     !! EA [N]
    real(wp), intent(in) :: natural_length(:)      !! [m]
    real(wp), intent(in) :: damping(:)             !! [N s/m]
    integer, allocatable :: order(:), low(:), offset(:), run_of(:)
    integer :: n_cable, i, j, begin, finish, n_real, slot, d, c
    integer, allocatable :: off(:), first(:), last(:)

    n_cable = size(cable_nodes, 2)
    allocate (low(n_cable), offset(n_cable), order(n_cable), run_of(n_cable))
    allocate (off(n_cable), first(n_cable), last(n_cable))
    allocate (plan%slot_of_cable(n_cable), plan%reversed(n_cable))
    do c = 1, n_cable
      low(c) = minval(cable_nodes(:, c))
      offset(c) = abs(cable_nodes(2, c) - cable_nodes(1, c))
      plan%reversed(c) = cable_nodes(1, c) > cable_nodes(2, c)
    end do
    call sort_cables(n_cable, n_node, low, offset, order)

    ! Cut the sorted list into runs; short ones stay loose. Two cables between the same
    ! nodes cannot share a diagonal, so a repeated first node also ends a run.
    run_of = 0
    begin = 1
    do while (begin <= n_cable)
      finish = begin
      do while (finish < n_cable)
        i = order(finish); j = order(finish + 1)
        if (offset(j) /= offset(i)) exit
        if (low(j) == low(i) .or. low(j) - low(i) > longest_gap) exit
        finish = finish + 1
      end do
      n_real = finish - begin + 1
      if (n_real >= shortest_run) then
        plan%n_diagonal = plan%n_diagonal + 1
        d = plan%n_diagonal
        off(d) = offset(order(begin)); first(d) = low(order(begin)); last(d) = low(order(finish))
        run_of(order(begin:finish)) = d
      end if
      begin = finish + 1
    end do

    call longest_first(plan%n_diagonal, off, first, last, run_of)
    plan%offset = off(:plan%n_diagonal)
    plan%first = first(:plan%n_diagonal)
    plan%last = last(:plan%n_diagonal)
    allocate (plan%start(plan%n_diagonal))
    if (plan%n_diagonal > 0) plan%max_offset = maxval(plan%offset)
    slot = 1
    do d = 1, plan%n_diagonal
      plan%start(d) = slot
      slot = slot + plan%last(d) - plan%first(d) + 1
    end do
    plan%loose_start = slot
    plan%n_loose = count(run_of == 0)
    plan%n_slot = slot - 1 + plan%n_loose
    allocate (plan%stiffness(plan%n_slot), source=0.0_wp)
    allocate (plan%damping(plan%n_slot), source=0.0_wp)
    allocate (plan%natural_length(plan%n_slot), source=never_taut)
    allocate (plan%loose_a(plan%n_loose), plan%loose_b(plan%n_loose))

    slot = plan%loose_start
    do i = 1, n_cable
      c = order(i)
      d = run_of(c)
      if (d > 0) then
        plan%slot_of_cable(c) = plan%start(d) + low(c) - plan%first(d)
      else
        plan%slot_of_cable(c) = slot
        plan%loose_a(slot - plan%loose_start + 1) = low(c)
        plan%loose_b(slot - plan%loose_start + 1) = low(c) + offset(c)
        slot = slot + 1
      end if
      j = plan%slot_of_cable(c)
      plan%natural_length(j) = natural_length(c)
      plan%stiffness(j) = axial_stiffness(c)/natural_length(c)
      plan%damping(j) = damping(c)
    end do
    plan%applied_damping = plan%damping
    call build_loose_incidence(plan, n_node)
  end subroutine build_cable_plan

  !> The two longest diagonals come first: the kernel is fastest with those.
  pure subroutine longest_first(n, offset, first, last, run_of)
    integer, intent(in) :: n
    integer, intent(inout) :: offset(:), first(:), last(:), run_of(:)
    integer :: place, d
    do place = 1, min(2, n)
      d = place - 1 + maxloc(last(place:n) - first(place:n), dim=1)
      if (d == place) cycle
      offset([place, d]) = offset([d, place])
      first([place, d]) = first([d, place])
      last([place, d]) = last([d, place])
      where (run_of == place)
        run_of = d
      elsewhere (run_of == d)
        run_of = place
      end where
    end do
  end subroutine longest_first

  !> Order cables by offset, then by first node, by two counting sorts.
  subroutine sort_cables(n_cable, n_node, low, offset, order)
    integer, intent(in) :: n_cable, n_node
    integer, intent(in) :: low(n_cable), offset(n_cable)
    integer, intent(out) :: order(n_cable)
    integer :: by_low(n_cable), position(0:n_node + 1), c, i

    position = 0
    do c = 1, n_cable
      position(low(c) + 1) = position(low(c) + 1) + 1
    end do
    do i = 1, n_node + 1
      position(i) = position(i) + position(i - 1)
    end do
    do c = 1, n_cable
      position(low(c)) = position(low(c)) + 1
      by_low(position(low(c))) = c
    end do
    position = 0
    do c = 1, n_cable
      position(offset(c) + 1) = position(offset(c) + 1) + 1
    end do
    do i = 1, n_node + 1
      position(i) = position(i) + position(i - 1)
    end do
    do i = 1, n_cable
      c = by_low(i)
      position(offset(c)) = position(offset(c)) + 1
      order(position(offset(c))) = c
    end do
  end subroutine sort_cables

  !> Which loose cables end at which node, in slot order: the order of the sum.
  subroutine build_loose_incidence(plan, n_node)
    type(cable_plan_t), intent(inout) :: plan
    integer, intent(in) :: n_node
    integer, allocatable :: degree(:), row(:)
    integer :: i, k

    allocate (degree(n_node), row(n_node), source=0)
    do k = 1, plan%n_loose
      degree(plan%loose_a(k)) = degree(plan%loose_a(k)) + 1
      degree(plan%loose_b(k)) = degree(plan%loose_b(k)) + 1
    end do
    plan%n_loose_node = count(degree > 0)
    allocate (plan%loose_node(plan%n_loose_node), plan%loose_pointer(plan%n_loose_node + 1))
    allocate (plan%loose_entry(2*plan%n_loose))
    k = 0
    plan%loose_pointer(1) = 1
    do i = 1, n_node
      if (degree(i) == 0) cycle
      k = k + 1
      plan%loose_node(k) = i
      plan%loose_pointer(k + 1) = plan%loose_pointer(k) + degree(i)
      row(i) = plan%loose_pointer(k)
    end do
    do k = 1, plan%n_loose
      plan%loose_entry(row(plan%loose_a(k))) = k
      row(plan%loose_a(k)) = row(plan%loose_a(k)) + 1
      plan%loose_entry(row(plan%loose_b(k))) = -k
      row(plan%loose_b(k)) = row(plan%loose_b(k)) + 1
    end do
  end subroutine build_loose_incidence

end module castnet_cable_plan
