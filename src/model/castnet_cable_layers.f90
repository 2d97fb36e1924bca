!> Cables that fit no diagonal, in layers.
!>
!> Each cable begins at one of its ends and arrives at the other; which is which is free. Let about
!> as many begin at every node, and take one of each node's: that is a **layer**, whose first
!> ends follow each other, so that only second ends have to be gathered and the sum over what begins at
!> the nodes runs with unit stride. Nodes that have no cable left for a layer get a phantom. A layer is cut
!> where a chunk of the sweep ends and where many nodes in a row have none; what is too
!> short then stays single.
module castnet_cable_layers
  use castnet_graph, only: add_up
  implicit none
  private
  public :: layers_t, arrange_layers, chunk_size

  integer, parameter :: chunk_size = 128     !! nodes that a sweep does at a time; all their data stay in the first cache
  integer, parameter :: longest_gap = 4      !! phantoms in a row
  integer, parameter :: shortest_block = 8   !! cables that are worth a loop
  integer, parameter :: even_passes = 3
  integer, parameter :: most_reached = 400   !! nodes that a search for one with too few cables looks at

  !> First the cables in blocks, block by block, then the single ones.
  type :: layers_t
    integer :: n = 0                         !! cables and phantoms
    integer :: n_layered = 0                 !! of them in blocks
    integer, allocatable :: a(:), b(:)       !! (n) first and second end; the same for a phantom
    integer, allocatable :: cable(:)         !! (n) which of the cables given; 0: a phantom
    integer, allocatable :: block_start(:)   !! (blocks + 1) where each block begins
    integer, allocatable :: block_from(:)    !! (chunks + 1) which blocks begin in a chunk's nodes
  end type layers_t

contains

  !> Arrange cables between the given nodes.
  subroutine arrange_layers(n_node, ends, layers)
    integer, intent(in) :: n_node
    integer, intent(in) :: ends(:, :)        !! (2,cables), counted from 1
    type(layers_t), intent(out) :: layers
    integer :: first(size(ends, 2)), second(size(ends, 2)), order(size(ends, 2)), start(n_node + 1)
    logical :: single(size(ends, 2))
    integer :: n, chunk, n_chunk, low, high, rank, most, pass, n_block, k

    n = size(ends, 2)
    n_chunk = (n_node + chunk_size - 1)/chunk_size
    call point_evenly(n_node, ends, first, second)
    call sort_by_ends(n_node, first, second, start, order)
    allocate (layers%block_from(n_chunk + 1))
    do pass = 1, 2                           ! count, then fill
      n_block = 0
      layers%n = 0
      single = .true.
      do chunk = 1, n_chunk
        layers%block_from(chunk) = n_block + 1
        low = (chunk - 1)*chunk_size + 1
        high = min(n_node, chunk*chunk_size)
        most = maxval(start(low + 1:high + 1) - start(low:high))
        do rank = 1, most
          call cut_blocks()
        end do
      end do
      layers%block_from(n_chunk + 1) = n_block + 1
      layers%n_layered = layers%n
      if (pass == 1) then
        k = layers%n + count(single)
        allocate (layers%a(k), layers%b(k), layers%cable(k), layers%block_start(n_block + 1))
      end if
    end do
    layers%block_start(n_block + 1) = layers%n + 1
    do k = 1, n
      if (single(k)) call append(first(order(k)), second(order(k)), order(k))
    end do

  contains

    !> The blocks of one layer in one chunk.
    subroutine cut_blocks()
      integer :: i, from, to, n_here
      from = 0
      do i = low, high + 1
        if (i <= high) then
          if (start(i) + rank > start(i + 1)) cycle   ! no cable of this rank
        end if
        if (from > 0) then
          if (i > high .or. i - to > longest_gap + 1) then
            if (n_here >= shortest_block) call take_block(from, to)
            from = 0
          end if
        end if
        if (from == 0) then
          from = i
          n_here = 0
        end if
        to = i
        n_here = n_here + 1
      end do
    end subroutine cut_blocks

    subroutine take_block(from, to)
      integer, intent(in) :: from, to
      integer :: i, c
      n_block = n_block + 1
      if (pass == 2) layers%block_start(n_block) = layers%n + 1
      do i = from, to
        c = start(i) + rank - 1
        if (c < start(i + 1)) then
          single(c) = .false.
          call append(i, second(order(c)), order(c))
        else
          call append(i, i, 0)
        end if
      end do
    end subroutine take_block

    subroutine append(a, b, cable)
      integer, intent(in) :: a, b, cable
      layers%n = layers%n + 1
      if (pass == 1) return
      layers%a(layers%n) = a
      layers%b(layers%n) = b
      layers%cable(layers%n) = cable
    end subroutine append

  end subroutine arrange_layers

  !> Choose first ends so that as many cables begin at every node as its net allows: each of two
  !> neighbours in turn, then along chains of cables, all turned round, from a node with too many to one with too few.
  subroutine point_evenly(n_node, ends, first, second)
    integer, intent(in) :: n_node, ends(:, :)
    integer, intent(out) :: first(:), second(:)
    integer :: beginning(n_node), k, pass
    beginning = 0
    do pass = 0, even_passes
      do k = 1, size(first)
        if (pass == 0) then
          first(k) = minval(ends(:, k))
          second(k) = maxval(ends(:, k))
          beginning(first(k)) = beginning(first(k)) + 1
        end if
        if (beginning(first(k)) > beginning(second(k)) + 1) call turn(k)
      end do
    end do
    call along_chains(size(first)/n_node)
    call along_chains(size(first)/n_node + 1)

  contains

    subroutine turn(cable)
      integer, intent(in) :: cable
      integer :: from
      from = first(cable)
      beginning(from) = beginning(from) - 1
      beginning(second(cable)) = beginning(second(cable)) + 1
      first(cable) = second(cable)
      second(cable) = from
    end subroutine turn

    !> From nodes where more than `mean` begin, breadth first over second ends to one where fewer do, never far.
    subroutine along_chains(mean)
      integer, intent(in) :: mean
      integer :: start(n_node + 1), at(2*size(ends, 2)), queue(most_reached), by(n_node), i, j, c, head, tail, node
      call incident(n_node, ends, start, at)
      by = 0                                  ! the cable that a node was reached by; -1: where the chain begins
      do i = 1, n_node
        do while (beginning(i) > mean .and. by(i) == 0)
          queue(1) = i
          by(i) = -1
          head = 1
          tail = 1
          node = 0                        ! none found
          search: do while (head <= tail)
            do j = start(queue(head)), start(queue(head) + 1) - 1
              c = at(j)
              if (first(c) /= queue(head) .or. by(second(c)) /= 0) cycle
              if (tail == most_reached) exit search
              tail = tail + 1
              queue(tail) = second(c)
              by(second(c)) = c
              if (beginning(second(c)) >= mean) cycle
              node = second(c)
              exit search
            end do
            head = head + 1
          end do search
          if (node == 0) exit             ! what was reached stays marked: from there no other search gets anywhere
          do while (by(node) > 0)
            c = by(node)
            node = first(c)
            call turn(c)
          end do
          by(queue(:tail)) = 0
        end do
      end do
    end subroutine along_chains

  end subroutine point_evenly

  !> The cables at node i are at(start(i):start(i+1)-1).
  pure subroutine incident(n_node, ends, start, at)
    integer, intent(in) :: n_node, ends(:, :)
    integer, intent(out) :: start(n_node + 1), at(2*size(ends, 2))
    integer :: next(n_node), k, e
    start = 0
    do k = 1, size(ends, 2)
      do e = 1, 2
        start(ends(e, k) + 1) = start(ends(e, k) + 1) + 1
      end do
    end do
    call add_up(start)
    next = start(:n_node)
    do k = 1, size(ends, 2)
      do e = 1, 2
        at(next(ends(e, k))) = k
        next(ends(e, k)) = next(ends(e, k)) + 1
      end do
    end do
  end subroutine incident

  !> Order cables by first, then by second end. Those that begin at node i are order(start(i):start(i+1)-1).
  subroutine sort_by_ends(n_node, first, second, start, order)
    integer, intent(in) :: n_node, first(:), second(:)
    integer, intent(out) :: start(n_node + 1), order(:)
    integer :: by_second(size(first)), next(n_node), k
    call count_up(second)
    do k = 1, size(first)
      by_second(next(second(k))) = k
      next(second(k)) = next(second(k)) + 1
    end do
    call count_up(first)
    do k = 1, size(first)
      associate (f => first(by_second(k)))
        order(next(f)) = by_second(k)
        next(f) = next(f) + 1
      end associate
    end do

  contains

    subroutine count_up(key)
      integer, intent(in) :: key(:)
      integer :: i
      start = 0
      do i = 1, size(key)
        start(key(i) + 1) = start(key(i) + 1) + 1
      end do
      call add_up(start)
      next = start(:n_node)
    end subroutine count_up

  end subroutine sort_by_ends

end module castnet_cable_layers
