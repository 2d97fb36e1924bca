!> Cable tensions and the forces that they put on the nodes.
!>
!> A sweep runs through the nodes in chunks that fit the first cache. For each chunk:
!> tensions of the cables that begin in it, then force on its nodes and the stage update
!> of the integrator in one loop. Sums are taken in one fixed order, so the bits do
!> not depend on the number of threads: chunks are the same whoever works on them,
!> and a thread's range first recomputes the few cables that reach in from before.
!>
!> Forces of cables are kept for a window of nodes only, as long as the longest cable
!> reaches and a few chunks more: they never leave the second cache, whatever the net's size.
!>
!> The loops are free of branches (`merge`, `max`), so that the compiler turns each of
!> them into full-width vector code under the release flags. `simdlen(8)`: for processors that it
!> knows by name gfortran takes vectors of half the width, a fifth slower here.
module castnet_cable_force
  use castnet_kinds, only: wp
  use castnet_cable_plan, only: cable_plan_t, chunk_size
  implicit none
  private
  public :: slab_t, chunk_size, new_slabs, slab_halo, chunk_cables, chunk_rest, block_cables, loose_cables, sum_in_order, &
            survey_cables, slot_tensions

  integer, parameter :: lanes = 8         !! partial sums of a fixed-order sum
  integer, parameter :: window = 8*chunk_size !! nodes that a slab's forces move on by
  real(wp), parameter :: smallest_square = 1.0e-60_wp !! keeps the reciprocal of a length finite [m2]

  !> A range of nodes that one thread works on, with the forces of its cables on their
  !> first ends. The first two diagonals have a row for every node of the window, zero where
  !> no cable begins, which saves the kernel all comparisons. Other nets may have hundreds of
  !> short diagonals: those have rows for their cables only. A long third one is kept as the first two are.
  type :: slab_t
    integer :: first = 1, last = 0          !! nodes; first is at the start of a chunk
    integer :: reach = 0                    !! longest offset of the full diagonals
    integer :: offset(3) = 0                !! of the full diagonals; 0 where there is none
    integer :: shift = 0                    !! node i is row i - shift of the window
    logical :: moves = .false.              !! the window is shorter than the slab
    real(wp), allocatable :: force(:, :, :) !! (window,3,2 or 3) of cable (a, a+offset) [N]
    integer, allocatable :: base(:)         !! (n_diagonal) from the third on, the cable from a is row base + a of
    real(wp), allocatable :: rest(:, :)     !! (:,3) [N]
    integer, allocatable :: near_from(:)    !! (chunks + 1) where a chunk begins in `near`
    integer, allocatable :: near(:)         !! further diagonals with cables that begin or end in a chunk, ascending
    real(wp), allocatable :: other(:, :)    !! (chunk_size,3) scratch: forces on a chunk's nodes besides the full diagonals' [N]
  end type slab_t

contains

  !> Divide n_node nodes into at most n_slab ranges of whole chunks.
  subroutine new_slabs(slabs, plan, n_node, n_slab)
    type(slab_t), allocatable, intent(out) :: slabs(:)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: n_node, n_slab
    integer :: n_chunk, s, used, d, begin, finish, rows, full

    full = plan%n_full
    n_chunk = (n_node + chunk_size - 1)/chunk_size
    used = max(1, min(n_slab, n_chunk))
    allocate (slabs(used))
    do s = 1, used
      slabs(s)%first = int(int(n_chunk, 8)*(s - 1)/used)*chunk_size + 1
      slabs(s)%last = min(n_node, int(int(n_chunk, 8)*s/used)*chunk_size)
      slabs(s)%offset(:full) = plan%offset(:full)
      slabs(s)%reach = maxval(slabs(s)%offset)
      slabs(s)%moves = slabs(s)%last - slabs(s)%first + 1 > window
      slabs(s)%shift = slabs(s)%first - 1 - rows_before(slabs(s))
      allocate (slabs(s)%other(chunk_size, 3), source=0.0_wp)
      allocate (slabs(s)%force(rows_before(slabs(s)) + window, 3, max(2, full)), source=0.0_wp)
      allocate (slabs(s)%base(plan%n_diagonal), source=0)
      call find_near(slabs(s), plan)
      rows = 0
      do d = plan%n_full + 1, plan%n_diagonal
        begin = max(plan%first(d), slabs(s)%first - plan%offset(d))
        finish = min(plan%last(d), slabs(s)%last)
        slabs(s)%base(d) = rows + 1 - begin
        rows = rows + max(0, finish - begin + 1)
      end do
      allocate (slabs(s)%rest(rows, 3), source=0.0_wp)
    end do
  end subroutine new_slabs

  !> Which diagonals besides the full ones matter to each chunk: there may be hundreds.
  subroutine find_near(slab, plan)
    type(slab_t), intent(inout) :: slab
    type(cable_plan_t), intent(in) :: plan
    integer :: fill, chunk, n_chunk, d, k
    integer, allocatable :: next(:)
    n_chunk = (slab%last - slab%first + chunk_size)/chunk_size
    allocate (slab%near_from(n_chunk + 1), source=0)
    do fill = 0, 1
      do d = plan%n_full + 1, plan%n_diagonal
        k = 0                          ! last chunk that has it
        call mark(plan%first(d), plan%last(d))
        call mark(plan%first(d) + plan%offset(d), plan%last(d) + plan%offset(d))
      end do
      if (fill == 1) exit
      slab%near_from(1) = 1
      do chunk = 1, n_chunk
        slab%near_from(chunk + 1) = slab%near_from(chunk + 1) + slab%near_from(chunk)
      end do
      next = slab%near_from(:n_chunk)
      allocate (slab%near(slab%near_from(n_chunk + 1) - 1))
    end do

  contains

    subroutine mark(first, last)
      integer, intent(in) :: first, last   !! nodes
      integer :: c
      if (last < slab%first .or. first > slab%last) return
      do c = max(k, (max(first, slab%first) - slab%first)/chunk_size), (min(last, slab%last) - slab%first)/chunk_size
        if (fill == 0) then
          slab%near_from(c + 2) = slab%near_from(c + 2) + 1
        else
          slab%near(next(c + 1)) = d
          next(c + 1) = next(c + 1) + 1
        end if
        k = c + 1
      end do
    end subroutine mark

  end subroutine find_near

  !> Rows of the window before its first chunk: the reach, in whole cache lines.
  pure integer function rows_before(slab)
    type(slab_t), intent(in) :: slab
    rows_before = lanes*((slab%reach + lanes - 1)/lanes)
  end function rows_before

  !> Make room for the chunk that begins at node `begin`: keep what reaches into it.
  subroutine move_window(slab, begin)
    type(slab_t), intent(inout) :: slab
    integer, intent(in) :: begin
    integer :: rows, by, c, d, k
    rows = rows_before(slab)
    if (begin + chunk_size - 1 - slab%shift <= rows + window) return
    by = begin - 1 - rows - slab%shift
    do d = 1, size(slab%force, 3)
      do c = 1, 3
        do k = 1, rows
          slab%force(k, c, d) = slab%force(k + by, c, d)
        end do
      end do
    end do
    slab%shift = slab%shift + by
  end subroutine move_window

  !> Start a sweep: the window at the slab's start, with the cables that begin before it and may end in it.
  subroutine slab_halo(plan, slab, n_pad, x, v, floor_tension)
    type(cable_plan_t), intent(in) :: plan
    type(slab_t), intent(inout) :: slab
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(in) :: floor_tension
    real(wp) :: power(chunk_size)
    integer :: d, begin, finish, a


    if (slab%moves) then
      slab%shift = slab%first - 1 - rows_before(slab)
      slab%force(:rows_before(slab), :, :) = 0.0_wp
    end if
    do d = 1, plan%n_diagonal
      begin = max(slab%first - plan%offset(d), plan%first(d))
      finish = min(slab%first - 1, plan%last(d))
      do a = begin, finish, chunk_size
        call diagonal_cables(min(chunk_size, finish - a + 1), a, d, plan, slab, n_pad, x, v, floor_tension, power)
      end do
    end do
  end subroutine slab_halo

  !> Forces of the diagonal cables that begin at nodes begin..finish, and the power
  !> that their damping takes from them.
  subroutine chunk_cables(plan, slab, begin, finish, n_pad, x, v, floor_tension, power)
    type(cable_plan_t), intent(in) :: plan
    type(slab_t), intent(inout) :: slab
    integer, intent(in) :: begin, finish               !! one chunk
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3)                !! node positions [m]
    real(wp), intent(in) :: v(n_pad, 3)                !! node velocities [m/s]
    real(wp), intent(in) :: floor_tension              !! 0 clamps, -huge does not [N]
    real(wp), intent(out) :: power                     !! [W]
    real(wp) :: p(chunk_size), total(lanes)
    integer :: d, lo, hi, k, rows, full, chunk, i

    total = 0.0_wp
    if (slab%moves) call move_window(slab, begin)
    full = plan%n_full
    chunk = (begin - slab%first)/chunk_size + 1
    do i = 1, full + slab%near_from(chunk + 1) - slab%near_from(chunk)
      d = i
      if (i > full) d = slab%near(slab%near_from(chunk) + i - full - 1)
      lo = max(begin, plan%first(d))
      hi = min(finish, plan%last(d))
      if (d <= full .and. slab%moves) then      ! else these rows never were anything but zero
        if (lo > begin) slab%force(begin - slab%shift:min(lo - 1, finish) - slab%shift, :, d) = 0.0_wp
        if (hi < finish) slab%force(max(hi + 1, begin) - slab%shift:finish - slab%shift, :, d) = 0.0_wp
      end if
      if (hi < lo) cycle
      call diagonal_cables(hi - lo + 1, lo, d, plan, slab, n_pad, x, v, floor_tension, p)
      rows = lanes*((hi - lo + lanes)/lanes)
      p(hi - lo + 2:rows) = 0.0_wp
      do k = 1, rows, lanes
        total = total + p(k:k + lanes - 1)
      end do
    end do
    power = ((total(1) + total(5)) + (total(2) + total(6))) + ((total(3) + total(7)) + (total(4) + total(8)))
  end subroutine chunk_cables

  !> m cables (a, a + offset), (a + 1, a + 1 + offset), ... of diagonal d.
  subroutine diagonal_cables(m, a, d, plan, slab, n_pad, x, v, floor_tension, power)
    integer, intent(in) :: m, a, d
    type(cable_plan_t), intent(in) :: plan
    type(slab_t), intent(inout) :: slab
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(in) :: floor_tension
    real(wp), intent(out) :: power(chunk_size)
    integer :: slot, b, row

    slot = plan%start(d) + a - plan%first(d)
    b = a + plan%offset(d)
    if (d <= plan%n_full) then
      row = a - slab%shift
      call strided_tension(m, x(a, 1), x(a, 2), x(a, 3), x(b, 1), x(b, 2), x(b, 3), &
                           v(a, 1), v(a, 2), v(a, 3), v(b, 1), v(b, 2), v(b, 3), &
                           plan%stiffness(slot), plan%natural_length(slot), plan%applied_damping(slot), floor_tension, &
                           slab%force(row, 1, d), slab%force(row, 2, d), slab%force(row, 3, d), power)
    else
      row = slab%base(d) + a
      call strided_tension(m, x(a, 1), x(a, 2), x(a, 3), x(b, 1), x(b, 2), x(b, 3), &
                           v(a, 1), v(a, 2), v(a, 3), v(b, 1), v(b, 2), v(b, 3), &
                           plan%stiffness(slot), plan%natural_length(slot), plan%applied_damping(slot), floor_tension, &
                           slab%rest(row, 1), slab%rest(row, 2), slab%rest(row, 3), power)
    end if
  end subroutine diagonal_cables

  !> The tension law: T = max(floor, k (l - l0) + c dl/dt) while l > l0, else 0.
  !> Source: physics.md section 1. The force on the first end points to the second.
  !> y and z are added before x: so a net that is symmetric about the flight direction x
  !> stays symmetric to the last bit, although it is chaotic.
  pure subroutine tension_law(dx, dy, dz, du, dv, dw, stiffness, natural_length, damping, floor_tension, pull, power)
    real(wp), intent(in) :: dx, dy, dz  !! from the first end to the second [m]
    real(wp), intent(in) :: du, dv, dw  !! how that changes [m/s]
    real(wp), intent(in) :: stiffness, natural_length, damping
    real(wp), intent(in) :: floor_tension
    real(wp), intent(out) :: pull       !! tension over length [N/m]
    real(wp), intent(out) :: power      !! dissipated [W]
    real(wp) :: length, inverse, rate, spring, tension, stretch
    length = sqrt(max(dx*dx + (dy*dy + dz*dz), smallest_square))
    inverse = 1.0_wp/length
    stretch = length - natural_length
    rate = (dx*du + (dy*dv + dz*dw))*inverse
    spring = stiffness*stretch
    tension = merge(max(floor_tension, spring + damping*rate), 0.0_wp, stretch > 0.0_wp)
    power = merge((tension - spring)*rate, 0.0_wp, stretch > 0.0_wp)
    pull = tension*inverse
  end subroutine tension_law

  !> Cables whose first and whose second ends follow each other.
  pure subroutine strided_tension(m, ax, ay, az, bx, by, bz, au, av, aw, bu, bv, bw, &
                                  stiffness, natural_length, damping, floor_tension, fx, fy, fz, power)
    integer, intent(in) :: m
    real(wp), intent(in) :: ax(m), ay(m), az(m), bx(m), by(m), bz(m) !! end positions [m]
    real(wp), intent(in) :: au(m), av(m), aw(m), bu(m), bv(m), bw(m) !! end velocities [m/s]
    real(wp), intent(in) :: stiffness(m), natural_length(m), damping(m)
    real(wp), intent(in) :: floor_tension
    real(wp), intent(out) :: fx(m), fy(m), fz(m)  !! force on the first end [N]
    real(wp), intent(out) :: power(m)             !! dissipated [W]
    real(wp) :: dx, dy, dz, pull
    integer :: k

    !$omp simd simdlen(8) private(dx, dy, dz, pull)
    do k = 1, m
      dx = bx(k) - ax(k)
      dy = by(k) - ay(k)
      dz = bz(k) - az(k)
      call tension_law(dx, dy, dz, bu(k) - au(k), bv(k) - av(k), bw(k) - aw(k), &
                       stiffness(k), natural_length(k), damping(k), floor_tension, pull, power(k))
      fx(k) = pull*dx
      fy(k) = pull*dy
      fz(k) = pull*dz
    end do
  end subroutine strided_tension

  !> Forces of the loose cables in blocks first..last and the power that their damping takes.
  subroutine block_cables(plan, first, last, n_pad, x, v, floor_tension, force, power)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: first, last
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(in) :: floor_tension
    real(wp), intent(inout) :: force(0:plan%n_loose, 3)  !! on the first end [N]
    real(wp), intent(inout) :: power(:)                  !! (blocks) [W]
    real(wp) :: p(chunk_size), total(lanes)
    integer :: i, k, m, a, slot
    do i = first, last
      k = plan%block_start(i)
      m = plan%block_start(i + 1) - k
      a = plan%loose_a(k)
      slot = plan%loose_start + k - 1
      call half_gathered_tension(m, x(a, 1), x(a, 2), x(a, 3), v(a, 1), v(a, 2), v(a, 3), plan%loose_b(k), n_pad, x, v, &
                                 plan%stiffness(slot), plan%natural_length(slot), plan%applied_damping(slot), floor_tension, &
                                 force(k, 1), force(k, 2), force(k, 3), p)
      if (m < chunk_size) p(m + 1:lanes*((m + lanes - 1)/lanes)) = 0.0_wp
      total = 0.0_wp
      do k = 1, m, lanes
        total = total + p(k:k + lanes - 1)
      end do
      power(i) = ((total(1) + total(5)) + (total(2) + total(6))) + ((total(3) + total(7)) + (total(4) + total(8)))
    end do
  end subroutine block_cables

  !> Cables whose first ends follow each other and whose second ends are gathered.
  pure subroutine half_gathered_tension(m, ax, ay, az, au, av, aw, b, n_pad, x, v, stiffness, natural_length, damping, &
                                        floor_tension, fx, fy, fz, power)
    integer, intent(in) :: m, n_pad
    real(wp), intent(in) :: ax(m), ay(m), az(m), au(m), av(m), aw(m) !! first ends [m], [m/s]
    integer, intent(in) :: b(m)                                      !! second ends
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(in) :: stiffness(m), natural_length(m), damping(m)
    real(wp), intent(in) :: floor_tension
    real(wp), intent(out) :: fx(m), fy(m), fz(m)  !! force on the first end [N]
    real(wp), intent(out) :: power(m)             !! dissipated [W]
    real(wp) :: dx, dy, dz, pull
    integer :: k

    !$omp simd simdlen(8) private(dx, dy, dz, pull)
    do k = 1, m
      dx = x(b(k), 1) - ax(k)
      dy = x(b(k), 2) - ay(k)
      dz = x(b(k), 3) - az(k)
      call tension_law(dx, dy, dz, v(b(k), 1) - au(k), v(b(k), 2) - av(k), v(b(k), 3) - aw(k), &
                       stiffness(k), natural_length(k), damping(k), floor_tension, pull, power(k))
      fx(k) = pull*dx
      fy(k) = pull*dy
      fz(k) = pull*dz
    end do
  end subroutine half_gathered_tension

  !> Loose cables first..last, both of whose ends are gathered.
  subroutine loose_cables(plan, first, last, n_pad, x, v, floor_tension, force, power)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: first, last
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(in) :: floor_tension
    real(wp), intent(inout) :: force(0:plan%n_loose, 3)  !! on the first end [N]
    real(wp), intent(inout) :: power(plan%n_loose)     !! dissipated [W]
    real(wp) :: dx, dy, dz, pull
    integer :: k, a, b, slot

    do k = first, last
      a = plan%loose_a(k)
      b = plan%loose_b(k)
      slot = plan%loose_start + k - 1
      dx = x(b, 1) - x(a, 1)
      dy = x(b, 2) - x(a, 2)
      dz = x(b, 3) - x(a, 3)
      call tension_law(dx, dy, dz, v(b, 1) - v(a, 1), v(b, 2) - v(a, 2), v(b, 3) - v(a, 3), &
                       plan%stiffness(slot), plan%natural_length(slot), plan%applied_damping(slot), floor_tension, pull, power(k))
      force(k, 1) = pull*dx
      force(k, 2) = pull*dy
      force(k, 3) = pull*dz
    end do
  end subroutine loose_cables

  !> Elastic energy of all cables, sum of k (l - l0)**2/2 over the taut ones, and the
  !> largest tension, in one pass along the plan. Sums in lanes, folded at the end: they stay in
  !> registers, and the order is the same in every build.
  pure subroutine survey_cables(plan, n_pad, x, v, elastic, largest)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)  !! [m], [m/s]
    real(wp), intent(out) :: elastic                  !! [J]
    real(wp), intent(out) :: largest                  !! 0 when every cable is slack [N]
    real(wp) :: ends(chunk_size, 12), part(lanes, 3)
    integer :: d, a, b, m, slot, n, c

    part(:, :2) = 0.0_wp
    part(:, 3) = 1.0_wp
    do d = 1, plan%n_diagonal
      a = plan%first(d)
      b = a + plan%offset(d)
      slot = plan%start(d)
      n = plan%last(d) - a + 1
      m = lanes*(n/lanes)
      call survey_lanes(m, x(a, 1), x(a, 2), x(a, 3), x(b, 1), x(b, 2), x(b, 3), &
                        v(a, 1), v(a, 2), v(a, 3), v(b, 1), v(b, 2), v(b, 3), &
                        plan%stiffness(slot), plan%natural_length(slot), plan%damping(slot), part)
      if (m == n) cycle
      n = n - m
      do c = 1, 3
        ends(:n, c) = x(a + m:a + m + n - 1, c)
        ends(:n, c + 3) = x(b + m:b + m + n - 1, c)
        ends(:n, c + 6) = v(a + m:a + m + n - 1, c)
        ends(:n, c + 9) = v(b + m:b + m + n - 1, c)
      end do
      call survey_ends(plan, slot + m, n, ends, part)
    end do
    do a = 1, plan%n_loose, chunk_size
      m = min(chunk_size, plan%n_loose - a + 1)
      call gather_ends(plan, a, m, n_pad, x, v, ends)
      call survey_ends(plan, plan%loose_start + a - 1, m, ends, part)
    end do
    n = lanes/2
    do while (n >= 1)
      call add(n, part(n + 1, 1), part(1, 1))
      call keep_larger(n, part(n + 1, 2), part(n + 1, 3), part(1, 2), part(1, 3))
      n = n/2
    end do
    elastic = 0.5_wp*part(1, 1)
    largest = part(1, 2)/part(1, 3)
  end subroutine survey_cables

  !> The same of m cables whose ends stand side by side: what is missing in the last lanes is
  !> filled up with cables of no stiffness.
  pure subroutine survey_ends(plan, slot, m, ends, part)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: slot, m                   !! of the first one; cables
    real(wp), intent(inout) :: ends(chunk_size, 12)  !! as of `gather_ends`
    real(wp), intent(inout) :: part(lanes, 3)
    real(wp) :: law(chunk_size, 3)
    integer :: full, c
    full = lanes*((m + lanes - 1)/lanes)
    law(:m, 1) = plan%stiffness(slot:slot + m - 1)
    law(:m, 2) = plan%natural_length(slot:slot + m - 1)
    law(:m, 3) = plan%damping(slot:slot + m - 1)
    if (m < full) then
      law(m + 1:full, :) = 0.0_wp
      do c = 1, 12
        ends(m + 1:full, c) = 0.0_wp
      end do
    end if
    call survey_lanes(full, ends(1, 1), ends(1, 2), ends(1, 3), ends(1, 4), ends(1, 5), ends(1, 6), &
                      ends(1, 7), ends(1, 8), ends(1, 9), ends(1, 10), ends(1, 11), ends(1, 12), &
                      law(1, 1), law(1, 2), law(1, 3), part)
  end subroutine survey_ends

  !> Add twice the elastic energy of m cables to the sums, and keep what is pulled harder than
  !> before. A tension is compared as a fraction, tension times length over length: the
  !> division, half of a cable's time, is left to the end.
  pure subroutine survey_lanes(m, ax, ay, az, bx, by, bz, au, av, aw, bu, bv, bw, stiffness, natural_length, damping, part)
    integer, intent(in) :: m                   !! a multiple of lanes: a constant count is what stays in registers
    real(wp), intent(in) :: ax(m), ay(m), az(m), bx(m), by(m), bz(m), au(m), av(m), aw(m), bu(m), bv(m), bw(m)
    real(wp), intent(in) :: stiffness(m), natural_length(m), damping(m)
    real(wp), intent(inout) :: part(lanes, 3)  !! twice the energy [J]; fractions' upper and lower parts [N m], [m]
    real(wp) :: dx, dy, dz, now, stretch, spring, pull, twice(lanes), moment(lanes), length(lanes)
    logical :: larger
    integer :: i, k

    twice = part(:, 1)
    moment = part(:, 2)
    length = part(:, 3)
    do i = 0, m - lanes, lanes
      do k = 1, lanes
        dx = bx(i + k) - ax(i + k)
        dy = by(i + k) - ay(i + k)
        dz = bz(i + k) - az(i + k)
        now = sqrt(dx*dx + (dy*dy + dz*dz))
        stretch = max(now - natural_length(i + k), 0.0_wp)
        spring = stiffness(i + k)*stretch
        twice(k) = twice(k) + spring*stretch
        pull = spring*now + damping(i + k)*(dx*(bu(i + k) - au(i + k)) + (dy*(bv(i + k) - av(i + k)) + dz*(bw(i + k) - aw(i + k))))
        pull = merge(pull, 0.0_wp, stretch > 0.0_wp)
        larger = pull*length(k) > moment(k)*now
        moment(k) = merge(pull, moment(k), larger)
        length(k) = merge(now, length(k), larger)
      end do
    end do
    part(:, 1) = twice
    part(:, 2) = moment
    part(:, 3) = length
  end subroutine survey_lanes

  !> Of two lists of fractions keep the larger ones.
  pure subroutine keep_larger(m, other_moment, other_length, moment, length)
    integer, intent(in) :: m
    real(wp), intent(in) :: other_moment(m), other_length(m)
    real(wp), intent(inout) :: moment(m), length(m)
    logical :: larger
    integer :: k
    do k = 1, m
      larger = other_moment(k)*length(k) > moment(k)*other_length(k)
      moment(k) = merge(other_moment(k), moment(k), larger)
      length(k) = merge(other_length(k), length(k), larger)
    end do
  end subroutine keep_larger

  !> Positions and velocities of both ends of the m loose cables from the first on.
  pure subroutine gather_ends(plan, first, m, n_pad, x, v, ends)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: first, m, n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)     !! [m], [m/s]
    real(wp), intent(inout) :: ends(chunk_size, 12)
    integer :: k, c
    do c = 1, 3
      do k = 1, m
        ends(k, c) = x(plan%loose_a(first + k - 1), c)
        ends(k, c + 3) = x(plan%loose_b(first + k - 1), c)
        ends(k, c + 6) = v(plan%loose_a(first + k - 1), c)
        ends(k, c + 9) = v(plan%loose_b(first + k - 1), c)
      end do
    end do
  end subroutine gather_ends

  !> Tension of every slot of the plan [N], phantoms included, by the law of `tension_law`.
  pure subroutine slot_tensions(plan, n_pad, x, v, floor_tension, tension)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)  !! [m], [m/s]
    real(wp), intent(in) :: floor_tension             !! 0 clamps, -huge does not [N]
    real(wp), intent(out) :: tension(plan%n_slot)
    real(wp) :: ends(chunk_size, 12)
    integer :: d, a, b, m, slot

    do d = 1, plan%n_diagonal
      a = plan%first(d)
      b = a + plan%offset(d)
      slot = plan%start(d)
      m = plan%last(d) - a + 1
      call tensions_of(m, x(a, 1), x(a, 2), x(a, 3), x(b, 1), x(b, 2), x(b, 3), &
                       v(a, 1), v(a, 2), v(a, 3), v(b, 1), v(b, 2), v(b, 3), &
                       plan%stiffness(slot), plan%natural_length(slot), plan%damping(slot), floor_tension, tension(slot))
    end do
    do a = 1, plan%n_loose, chunk_size
      m = min(chunk_size, plan%n_loose - a + 1)
      slot = plan%loose_start + a - 1
      call gather_ends(plan, a, m, n_pad, x, v, ends)
      call tensions_of(m, ends(1, 1), ends(1, 2), ends(1, 3), ends(1, 4), ends(1, 5), ends(1, 6), &
                       ends(1, 7), ends(1, 8), ends(1, 9), ends(1, 10), ends(1, 11), ends(1, 12), &
                       plan%stiffness(slot), plan%natural_length(slot), plan%damping(slot), floor_tension, tension(slot))
    end do
  end subroutine slot_tensions

  pure subroutine tensions_of(m, ax, ay, az, bx, by, bz, au, av, aw, bu, bv, bw, &
                              stiffness, natural_length, damping, floor_tension, tension)
    integer, intent(in) :: m
    real(wp), intent(in) :: ax(m), ay(m), az(m), bx(m), by(m), bz(m), au(m), av(m), aw(m), bu(m), bv(m), bw(m)
    real(wp), intent(in) :: stiffness(m), natural_length(m), damping(m), floor_tension
    real(wp), intent(out) :: tension(m)
    real(wp) :: dx, dy, dz, length, rate, stretch
    integer :: k
    do k = 1, m
      dx = bx(k) - ax(k)
      dy = by(k) - ay(k)
      dz = bz(k) - az(k)
      length = sqrt(max(dx*dx + (dy*dy + dz*dz), smallest_square))
      rate = (dx*(bu(k) - au(k)) + (dy*(bv(k) - av(k)) + dz*(bw(k) - aw(k))))/length
      stretch = length - natural_length(k)
      tension(k) = merge(max(floor_tension, stiffness(k)*stretch + damping(k)*rate), 0.0_wp, stretch > 0.0_wp)
    end do
  end subroutine tensions_of

  !> Force on the nodes begin..finish from cables that are in neither of the first two
  !> diagonals: a full third one, further diagonals in their order, then loose cables: blocks, arrivals, the others in slot order. `rest` is
  !> zero where there are none; so it is not written again while it stays so (`clean`).
  subroutine chunk_rest(plan, slab, begin, finish, loose_force, rest, clean)
    type(cable_plan_t), intent(in) :: plan
    type(slab_t), intent(in) :: slab
    integer, intent(in) :: begin, finish
    real(wp), intent(in) :: loose_force(0:plan%n_loose, 3)
    real(wp), intent(inout) :: rest(chunk_size, 3) !! [N]
    logical, intent(inout) :: clean
    integer :: c, d, o, lo, hi, chunk, i, k

    chunk = (begin - slab%first)/chunk_size + 1
    if (plan%n_full == 3) then
      k = begin - slab%shift
      do c = 1, 3
        call difference(finish - begin + 1, slab%force(k, c, 3), slab%force(k - slab%offset(3), c, 3), rest(1, c))
      end do
    else if (.not. clean) then
      rest = 0.0_wp
    end if
    clean = plan%n_full < 3 .and. slab%near_from(chunk) == slab%near_from(chunk + 1)
    do i = slab%near_from(chunk), slab%near_from(chunk + 1) - 1
      d = slab%near(i)
      lo = max(begin, plan%first(d))
      hi = min(finish, plan%last(d))
      do c = 1, 3
        if (hi >= lo) call add(hi - lo + 1, slab%rest(slab%base(d) + lo, c), rest(lo - begin + 1, c))
      end do
      o = plan%offset(d)
      lo = max(begin, plan%first(d) + o)
      hi = min(finish, plan%last(d) + o)
      do c = 1, 3
        if (hi >= lo) call subtract(hi - lo + 1, slab%rest(slab%base(d) + lo - o, c), rest(lo - begin + 1, c))
      end do
    end do
    if (plan%n_layered > 0) then
      clean = .false.
      do i = plan%block_from((begin - 1)/chunk_size + 1), plan%block_from((begin - 1)/chunk_size + 2) - 1
        k = plan%block_start(i)
        do c = 1, 3
          call add(plan%block_start(i + 1) - k, loose_force(k, c), rest(plan%loose_a(k) - begin + 1, c))
        end do
      end do
      do i = 1, size(plan%arriving, 2)
        do c = 1, 3
          call subtract_arriving(finish - begin + 1, plan%arriving(begin, i), plan%n_loose, loose_force(0, c), rest(1, c))
        end do
      end do
    end if
    k = (begin - 1)/chunk_size + 1
    if (plan%end_from(k) == plan%end_from(k + 1)) return
    clean = .false.
    call add_ends(plan, plan%end_from(k), plan%end_from(k + 1) - 1, begin, loose_force, rest)
  end subroutine chunk_rest

  !> total = away - back: cables that begin and end here.
  pure subroutine difference(m, away, back, total)
    integer, intent(in) :: m
    real(wp), intent(in) :: away(m), back(m)
    real(wp), intent(out) :: total(m)
    integer :: k
    do k = 1, m
      total(k) = away(k) - back(k)
    end do
  end subroutine difference

  !> total = total + away: cables that begin here.
  pure subroutine add(m, away, total)
    integer, intent(in) :: m
    real(wp), intent(in) :: away(m)
    real(wp), intent(inout) :: total(m)
    integer :: k
    do k = 1, m
      total(k) = total(k) + away(k)
    end do
  end subroutine add

  !> total = total - back: cables that end here.
  pure subroutine subtract(m, back, total)
    integer, intent(in) :: m
    real(wp), intent(in) :: back(m)
    real(wp), intent(inout) :: total(m)
    integer :: k
    do k = 1, m
      total(k) = total(k) - back(k)
    end do
  end subroutine subtract

  !> total = total - force of the cable that arrives; number 0 has none.
  pure subroutine subtract_arriving(m, arriving, n, force, total)
    integer, intent(in) :: m, arriving(m), n
    real(wp), intent(in) :: force(0:n)
    real(wp), intent(inout) :: total(m)
    integer :: k
    do k = 1, m
      total(k) = total(k) - force(arriving(k))
    end do
  end subroutine subtract_arriving

  !> Ends low..high of loose cables, at nodes of the chunk from `begin`.
  subroutine add_ends(plan, low, high, begin, loose_force, force)
    type(cable_plan_t), intent(in) :: plan
    integer, intent(in) :: low, high, begin
    real(wp), intent(in) :: loose_force(0:plan%n_loose, 3)
    real(wp), intent(inout) :: force(chunk_size, 3)
    real(wp) :: towards
    integer :: j, k, i

    do j = low, high
      i = plan%end_node(j) - begin + 1
      k = abs(plan%end_cable(j))
      ! A factor, not a branch: at which end of its cable a node lies nobody can predict.
      towards = real(sign(1, plan%end_cable(j)), wp)
      force(i, 1) = force(i, 1) + towards*loose_force(k, 1)
      force(i, 2) = force(i, 2) + towards*loose_force(k, 2)
      force(i, 3) = force(i, 3) + towards*loose_force(k, 3)
    end do
  end subroutine add_ends

  !> Sum in index order: the same bits whoever computed the terms.
  pure real(wp) function sum_in_order(n, term) result(total)
    integer, intent(in) :: n
    real(wp), intent(in) :: term(n)
    integer :: k
    total = 0.0_wp
    do k = 1, n
      total = total + term(k)
    end do
  end function sum_in_order

end module castnet_cable_force
