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
  public :: cable_plan_t, build_cable_plan, sweep_cost

  integer, parameter :: longest_gap = 8     !! phantom cables in a row; beyond that a new diagonal begins
  integer, parameter :: shortest_run = 16   !! cables that make a diagonal worth its loop
  real(wp), parameter :: never_taut = 1.0e30_wp  !! natural length of a phantom cable [m]

  ! What a sweep costs, in cables of a diagonal (measured: docs/performance.md).
  real(wp), parameter :: cost_of_loose = 2.5_wp  !! a loose cable
  real(wp), parameter :: cost_of_other = 1.8_wp  !! a cable of a diagonal beyond the two full ones
  real(wp), parameter :: cost_of_run = 20.0_wp   !! such a diagonal, besides its cables

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

  !> Cables in runs of one offset.
  type :: runs_t
    integer :: n = 0
    integer, allocatable :: offset(:), first(:), last(:)  !! first n: second node minus first; first nodes
    integer, allocatable :: low(:), step(:)               !! (n_cable) first node, second minus first
    integer, allocatable :: order(:)                      !! (n_cable) by step, then by first node
    integer, allocatable :: run_of(:)                     !! (n_cable) 0: in none
  end type runs_t

contains

  !> Arrange cables for the kernel. Lengths and stiffnesses must be positive.
  subroutine build_cable_plan(plan, n_node, cable_nodes, axial_stiffness, natural_length, damping)
    type(cable_plan_t), intent(out) :: plan
    integer, intent(in) :: n_node
    integer, intent(in) :: cable_nodes(:, :)       !! (2,n_cable), counted from 1
    real(wp), intent(in) :: axial_stiffness(:)     !! EA [N]
    real(wp), intent(in) :: natural_length(:)      !! [m]
    real(wp), intent(in) :: damping(:)             !! [N s/m]
    type(runs_t) :: runs
    integer :: n_cable, i, j, slot, d, c

    n_cable = size(cable_nodes, 2)
    call find_runs(n_node, cable_nodes, runs)
    plan%reversed = cable_nodes(1, :) > cable_nodes(2, :)
    allocate (plan%slot_of_cable(n_cable))
    plan%n_diagonal = runs%n
    call longest_first(runs)
    plan%offset = runs%offset(:runs%n)
    plan%first = runs%first(:runs%n)
    plan%last = runs%last(:runs%n)
    allocate (plan%start(plan%n_diagonal))
    if (plan%n_diagonal > 0) plan%max_offset = maxval(plan%offset)
    slot = 1
    do d = 1, plan%n_diagonal
      plan%start(d) = slot
      slot = slot + plan%last(d) - plan%first(d) + 1
    end do
    plan%loose_start = slot
    plan%n_loose = count(runs%run_of == 0)
    plan%n_slot = slot - 1 + plan%n_loose
    allocate (plan%stiffness(plan%n_slot), source=0.0_wp)
    allocate (plan%damping(plan%n_slot), source=0.0_wp)
    allocate (plan%natural_length(plan%n_slot), source=never_taut)
    allocate (plan%loose_a(plan%n_loose), plan%loose_b(plan%n_loose))

    slot = plan%loose_start
    do i = 1, n_cable
      c = runs%order(i)
      d = runs%run_of(c)
      if (d > 0) then
        plan%slot_of_cable(c) = plan%start(d) + runs%low(c) - plan%first(d)
      else
        plan%slot_of_cable(c) = slot
        plan%loose_a(slot - plan%loose_start + 1) = runs%low(c)
        plan%loose_b(slot - plan%loose_start + 1) = runs%low(c) + runs%step(c)
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

  !> Cut the cables, sorted by offset and first node, into runs; short ones stay loose. Two cables
  !> between the same nodes cannot share a diagonal, so a repeated first node also ends a run.
  subroutine find_runs(n_node, cable_nodes, runs)
    integer, intent(in) :: n_node
    integer, intent(in) :: cable_nodes(:, :)
    type(runs_t), intent(out) :: runs
    integer :: n_cable, begin, finish, i, j

    n_cable = size(cable_nodes, 2)
    allocate (runs%low(n_cable), runs%step(n_cable), runs%order(n_cable))
    allocate (runs%run_of(n_cable), source=0)
    allocate (runs%offset(n_cable/shortest_run), runs%first(n_cable/shortest_run), runs%last(n_cable/shortest_run))
    do i = 1, n_cable
      runs%low(i) = minval(cable_nodes(:, i))
      runs%step(i) = abs(cable_nodes(2, i) - cable_nodes(1, i))
    end do
    call sort_cables(n_cable, n_node, runs%low, runs%step, runs%order)
    begin = 1
    do while (begin <= n_cable)
      finish = begin
      do while (finish < n_cable)
        i = runs%order(finish); j = runs%order(finish + 1)
        if (runs%step(j) /= runs%step(i)) exit
        if (runs%low(j) == runs%low(i) .or. runs%low(j) - runs%low(i) > longest_gap) exit
        finish = finish + 1
      end do
      if (finish - begin + 1 >= shortest_run) then
        runs%n = runs%n + 1
        runs%offset(runs%n) = runs%step(runs%order(begin))
        runs%first(runs%n) = runs%low(runs%order(begin))
        runs%last(runs%n) = runs%low(runs%order(finish))
        runs%run_of(runs%order(begin:finish)) = runs%n
      end if
      begin = finish + 1
    end do
  end subroutine find_runs

  !> What a sweep over cables that join these nodes costs, in cables of a diagonal.
  real(wp) function sweep_cost(n_node, cable_nodes) result(cost)
    integer, intent(in) :: n_node
    integer, intent(in) :: cable_nodes(:, :)  !! (2,n_cable)
    type(runs_t) :: runs
    integer :: d
    call find_runs(n_node, cable_nodes, runs)
    call longest_first(runs)
    cost = cost_of_loose*count(runs%run_of == 0)
    do d = 1, runs%n
      associate (slots => real(runs%last(d) - runs%first(d) + 1, wp))
        cost = cost + merge(slots, cost_of_other*slots + cost_of_run, d <= 2)
      end associate
    end do
  end function sweep_cost

  !> The two longest diagonals come first: the kernel is fastest with those.
  pure subroutine longest_first(runs)
    type(runs_t), intent(inout) :: runs
    integer :: place, d
    do place = 1, min(2, runs%n)
      d = place - 1 + maxloc(runs%last(place:runs%n) - runs%first(place:runs%n), dim=1)
      if (d == place) cycle
      runs%offset([place, d]) = runs%offset([d, place])
      runs%first([place, d]) = runs%first([d, place])
      runs%last([place, d]) = runs%last([d, place])
      where (runs%run_of == place)
        runs%run_of = d
      elsewhere (runs%run_of == d)
        runs%run_of = place
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
