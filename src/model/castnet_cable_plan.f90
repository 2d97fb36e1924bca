!> The cables in the order in which the force kernel runs through them.
!>
!> A cable joins node a to node a + offset. Cables of the same offset whose first
!> nodes follow each other form a **diagonal** (as in a sparse matrix stored by
!> diagonals): the kernel reads both ends with unit stride, no gather. Short gaps are
!> bridged by phantom cables of no stiffness. A square net is two diagonals (along y,
!> along z) and four loose corner cables. What does not fit a diagonal is **loose**:
!> its ends are gathered through an index. Where many cables are loose, most of them are put in layers, of
!> which only the second ends are gathered (castnet_cable_layers).
!>
!> Every diagonal has offset > 0, so that once all cables that begin at or before
!> node i are known, the force on node i is complete: one sweep over the nodes does
!> cables, forces and the stage update while the data are in the first cache.
module castnet_cable_plan
  use castnet_kinds, only: wp
  use castnet_cable_layers, only: layers_t, arrange_layers, chunk_size
  use castnet_graph, only: add_up
  implicit none
  private
  public :: cable_plan_t, build_cable_plan, sweep_cost, chunk_size

  integer, parameter :: longest_gap = 8     !! phantom cables in a row; beyond that a new diagonal begins
  integer, parameter :: shortest_run = 16   !! cables that make a diagonal worth its loop
  real(wp), parameter :: never_taut = 1.0e30_wp  !! natural length of a phantom cable [m]

  integer, parameter :: most_full = 3       !! diagonals that the kernel does best (castnet_cable_force)
  integer, parameter :: worth_layers = 16   !! cables besides diagonals that are worth being put in layers
  integer, parameter :: common_rank = 4     !! as many arrivals as every fourth node has are gathered in one loop

  ! What a sweep costs, in cables of the full diagonals. Measured; only ratios matter.
  real(wp), parameter :: cost_of_third = 1.3_wp  !! a cable of the third
  real(wp), parameter :: cost_of_other = 1.8_wp  !! a cable of a further diagonal
  real(wp), parameter :: cost_of_run = 20.0_wp   !! such a diagonal, besides its cables
  real(wp), parameter :: cost_of_loose = 2.4_wp  !! a cable in a layer
  real(wp), parameter :: cost_of_reach = 1.0_wp  !! the same, more, when its ends are far apart in memory
  integer, parameter :: far_apart = 4096         !! nodes

  type :: cable_plan_t
    integer :: n_diagonal = 0
    integer :: n_full = 0                      !! of them, the first ones, that have room for a cable at every node
    integer :: max_offset = 0
    integer, allocatable :: offset(:)          !! (n_diagonal) second node minus first node, > 0
    integer, allocatable :: first(:)           !! (n_diagonal) first node of its first cable
    integer, allocatable :: last(:)            !! (n_diagonal) first node of its last cable
    integer, allocatable :: start(:)           !! (n_diagonal) slot of its first cable
    integer :: n_loose = 0
    integer :: loose_start = 1                 !! slot of the first loose cable
    integer, allocatable :: loose_a(:), loose_b(:) !! (n_loose) end nodes; the same for phantoms
    integer :: n_layered = 0                   !! so many loose cables come first, in blocks whose first ends follow each other
    integer, allocatable :: block_start(:)     !! (blocks+1) loose cable that a block begins with
    integer, allocatable :: block_from(:)      !! (chunks+1) which blocks begin at a chunk's nodes
    integer, allocatable :: block_needed(:)    !! (chunks) the last block that the sums of the chunks up to this one read
    integer, allocatable :: arriving(:, :)     !! (n_node,:) loose cables that end at a node; 0: no more
    integer, allocatable :: end_from(:)        !! (chunks+1) where a chunk's ends of loose cables begin that neither says
    integer, allocatable :: end_node(:)        !! node of such an end; a node's follow in slot order
    integer, allocatable :: end_cable(:)       !! its loose cable; negative: this is the second end
    integer :: n_slot = 0                      !! cables and phantoms
    integer, allocatable :: slot_of_cable(:)   !! (n_cable)
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
    type(layers_t) :: layers
    integer :: n_cable, i, j, slot, d, c

    n_cable = size(cable_nodes, 2)
    call find_runs(n_node, cable_nodes, runs)
    call longest_first(runs)
    call drop_dear(n_node, runs)
    allocate (plan%slot_of_cable(n_cable))
    plan%n_diagonal = runs%n
    plan%n_full = count([(is_full(n_node, runs, d), d=1, runs%n)])
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
    call arrange_loose(n_node, cable_nodes, runs, layers)
    plan%n_loose = layers%n
    plan%n_layered = layers%n_layered
    plan%n_slot = slot - 1 + plan%n_loose
    allocate (plan%stiffness(plan%n_slot), source=0.0_wp)
    allocate (plan%damping(plan%n_slot), source=0.0_wp)
    allocate (plan%natural_length(plan%n_slot), source=never_taut)
    do c = 1, n_cable
      d = runs%run_of(c)
      if (d > 0) plan%slot_of_cable(c) = plan%start(d) + runs%low(c) - plan%first(d)
    end do
    do i = 1, plan%n_loose
      if (layers%cable(i) > 0) plan%slot_of_cable(layers%cable(i)) = plan%loose_start + i - 1
    end do
    do c = 1, n_cable
      j = plan%slot_of_cable(c)
      plan%natural_length(j) = natural_length(c)
      plan%stiffness(j) = axial_stiffness(c)/natural_length(c)
      plan%damping(j) = damping(c)
    end do
    plan%applied_damping = plan%damping
    call move_alloc(layers%a, plan%loose_a)
    call move_alloc(layers%b, plan%loose_b)
    call move_alloc(layers%block_start, plan%block_start)
    call move_alloc(layers%block_from, plan%block_from)
    call build_loose_incidence(plan, n_node)
  end subroutine build_cable_plan

  !> The cables in no run: in layers where there are many, else by offset and first node.
  subroutine arrange_loose(n_node, cable_nodes, runs, layers)
    integer, intent(in) :: n_node
    integer, intent(in) :: cable_nodes(:, :)
    type(runs_t), intent(in) :: runs
    type(layers_t), intent(out) :: layers
    integer, allocatable :: loose(:)
    loose = pack(runs%order, runs%run_of(runs%order) == 0)
    if (size(loose) >= worth_layers) then
      call arrange_layers(n_node, cable_nodes(:, loose), layers)
      where (layers%cable > 0)
        layers%cable = loose(max(1, layers%cable))
      end where
    end if
    if (layers%n_layered > 0) return
    layers%n = size(loose)
    layers%a = runs%low(loose)
    layers%b = runs%low(loose) + runs%step(loose)
    layers%cable = loose
    layers%block_start = [1]
    if (allocated(layers%block_from)) deallocate (layers%block_from)
    allocate (layers%block_from((n_node + chunk_size - 1)/chunk_size + 1), source=1)
  end subroutine arrange_loose

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

  !> Leave diagonals that are better as layers: short ones, and those with many phantoms.
  subroutine drop_dear(n_node, runs)
    integer, intent(in) :: n_node
    type(runs_t), intent(inout) :: runs
    integer :: new(0:runs%n), n_real(0:runs%n), d, n, c
    n_real = 0
    do c = 1, size(runs%run_of)
      n_real(runs%run_of(c)) = n_real(runs%run_of(c)) + 1
    end do
    new = 0
    n = 0
    do d = 1, runs%n
      if (cost_of_diagonal(n_node, runs, d) > cost_of_loose*n_real(d)) cycle
      n = n + 1
      new(d) = n
      runs%offset(n) = runs%offset(d)
      runs%first(n) = runs%first(d)
      runs%last(n) = runs%last(d)
    end do
    runs%n = n
    do c = 1, size(runs%run_of)
      runs%run_of(c) = new(runs%run_of(c))
    end do
  end subroutine drop_dear

  pure real(wp) function cost_of_diagonal(n_node, runs, d) result(cost)
    integer, intent(in) :: n_node, d
    type(runs_t), intent(in) :: runs
    cost = real(runs%last(d) - runs%first(d) + 1, wp)
    if (.not. is_full(n_node, runs, d)) then
      cost = cost_of_other*cost + cost_of_run
    else if (d > 2) then
      cost = cost_of_third*cost
    end if
  end function cost_of_diagonal

  !> The two longest in any case, the third if most nodes have such a cable.
  pure logical function is_full(n_node, runs, d)
    integer, intent(in) :: n_node, d
    type(runs_t), intent(in) :: runs
    is_full = d <= 2 .or. (d <= most_full .and. 2*(runs%last(d) - runs%first(d) + 1) > n_node)
  end function is_full

  !> What a sweep over cables that join these nodes costs, in cables of the full diagonals.
  real(wp) function sweep_cost(n_node, cable_nodes) result(cost)
    integer, intent(in) :: n_node
    integer, intent(in) :: cable_nodes(:, :)  !! (2,n_cable)
    type(runs_t) :: runs
    integer :: d, c
    call find_runs(n_node, cable_nodes, runs)
    call longest_first(runs)
    call drop_dear(n_node, runs)
    cost = 0.0_wp
    do d = 1, runs%n
      cost = cost + cost_of_diagonal(n_node, runs, d)
    end do
    do c = 1, size(runs%run_of)
      if (runs%run_of(c) == 0) &
        cost = cost + cost_of_loose + cost_of_reach*min(1.0_wp, real(runs%step(c), wp)/far_apart)
    end do
  end function sweep_cost

  !> The longest diagonals come first: the kernel is fastest with those.
  pure subroutine longest_first(runs)
    type(runs_t), intent(inout) :: runs
    integer :: place, d
    do place = 1, min(most_full, runs%n)
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

  !> Which loose cables end at which node: the order of the sum. First the blocks, then as many arrivals
  !> as enough nodes have, then what is left: in each chunk first ends of all nodes, second ones of all nodes, ...,
  !> so that no sum waits for the one before.
  subroutine build_loose_incidence(plan, n_node)
    type(cable_plan_t), intent(inout) :: plan
    integer, intent(in) :: n_node
    integer :: arrived(n_node), left(n_node), start(n_node + 1), fill, k, n_rank, n_chunk, chunk, i, rank, most
    integer, allocatable :: of_node(:)

    n_chunk = (n_node + chunk_size - 1)/chunk_size
    n_rank = 0
    if (plan%n_layered > 0) then
      arrived = 0
      do k = 1, plan%n_loose
        if (plan%loose_a(k) /= plan%loose_b(k)) arrived(plan%loose_b(k)) = arrived(plan%loose_b(k)) + 1
      end do
      do while (common_rank*count(arrived > n_rank) >= n_node)
        n_rank = n_rank + 1
      end do
    end if
    allocate (plan%arriving(n_node, n_rank), source=0)
    start = 0
    do fill = 0, 1
      left = 0
      arrived = 0
      do k = 1, plan%n_loose
        associate (a => plan%loose_a(k), b => plan%loose_b(k))
          if (k > plan%n_layered) call enter(a, k)
          if (a == b) cycle
          arrived(b) = arrived(b) + 1
          if (arrived(b) <= n_rank) then
            plan%arriving(b, arrived(b)) = k
          else
            call enter(b, -k)
          end if
        end associate
      end do
      if (fill == 1) exit
      start(2:) = left
      call add_up(start)
      allocate (of_node(start(n_node + 1) - 1))
    end do
    allocate (plan%end_from(n_chunk + 1), plan%end_node(size(of_node)), plan%end_cable(size(of_node)))
    k = 0
    do chunk = 1, n_chunk
      plan%end_from(chunk) = k + 1
      most = maxval(left((chunk - 1)*chunk_size + 1:min(n_node, chunk*chunk_size)))
      do rank = 0, most - 1
        do i = (chunk - 1)*chunk_size + 1, min(n_node, chunk*chunk_size)
          if (rank >= left(i)) cycle
          k = k + 1
          plan%end_node(k) = i
          plan%end_cable(k) = of_node(start(i) + rank)
        end do
      end do
    end do
    plan%end_from(n_chunk + 1) = k + 1
    call find_needed(plan, n_node)

  contains

    !> An end that no block adds up: counted first, then noted.
    subroutine enter(node, entry)
      integer, intent(in) :: node, entry
      if (fill == 1) of_node(start(node) + left(node)) = entry
      left(node) = left(node) + 1
    end subroutine enter

  end subroutine build_loose_incidence

  !> How far the blocks must be done before a chunk's sums can be taken.
  subroutine find_needed(plan, n_node)
    type(cable_plan_t), intent(inout) :: plan
    integer, intent(in) :: n_node
    integer :: block_of(0:plan%n_loose), chunk, n_chunk, i, last
    n_chunk = size(plan%block_from) - 1
    block_of = 0                              ! single cables are done before all blocks
    do i = 1, size(plan%block_start) - 1
      block_of(plan%block_start(i):plan%block_start(i + 1) - 1) = i
    end do
    allocate (plan%block_needed(n_chunk))
    last = 0
    do chunk = 1, n_chunk
      last = max(last, plan%block_from(chunk + 1) - 1)
      do i = (chunk - 1)*chunk_size + 1, min(n_node, chunk*chunk_size)
        last = max(last, maxval(block_of(plan%arriving(i, :))))
      end do
      do i = plan%end_from(chunk), plan%end_from(chunk + 1) - 1
        last = max(last, block_of(abs(plan%end_cable(i))))
      end do
      plan%block_needed(chunk) = last
    end do
  end subroutine find_needed

end module castnet_cable_plan
