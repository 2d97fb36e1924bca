!> Which nodes cables join, and walks over it.
module castnet_graph
  implicit none
  private
  public :: graph_t, new_graph, breadth_first, add_up

  !> Who is joined to whom: neighbours of node i are neighbour(start(i):start(i+1)-1).
  type :: graph_t
    integer :: n = 0
    integer, allocatable :: start(:), neighbour(:)
  end type graph_t

contains

  !> The graph of the cables whose ends have at most `most` cables each. A hub is no node of a lattice.
  subroutine new_graph(n, cable_nodes, most, graph)
    integer, intent(in) :: n, cable_nodes(:, :), most
    type(graph_t), intent(out) :: graph
    integer :: degree(n), next(n), c, e, a
    logical :: kept
    degree = 0
    do c = 1, size(cable_nodes, 2)
      do e = 1, 2
        degree(cable_nodes(e, c)) = degree(cable_nodes(e, c)) + 1
      end do
    end do
    graph%n = n
    allocate (graph%start(n + 1), source=0)
    do c = 1, size(cable_nodes, 2)
      kept = degree(cable_nodes(1, c)) <= most .and. degree(cable_nodes(2, c)) <= most
      do e = 1, 2
        if (kept) graph%start(cable_nodes(e, c) + 1) = graph%start(cable_nodes(e, c) + 1) + 1
      end do
    end do
    call add_up(graph%start)
    allocate (graph%neighbour(graph%start(n + 1) - 1))
    next = graph%start(:n)
    do c = 1, size(cable_nodes, 2)
      if (degree(cable_nodes(1, c)) > most .or. degree(cable_nodes(2, c)) > most) cycle
      do e = 1, 2
        a = cable_nodes(e, c)
        graph%neighbour(next(a)) = cable_nodes(3 - e, c)
        next(a) = next(a) + 1
      end do
    end do
  end subroutine new_graph

  !> From numbers of entries, one place late, to where each row begins.
  pure subroutine add_up(start)
    integer, intent(inout) :: start(:)
    integer :: a
    start(1) = 1
    do a = 2, size(start)
      start(a) = start(a) + start(a - 1)
    end do
  end subroutine add_up

  !> Breadth first from `root`, then from the first node not yet reached, and so on. A later part's
  !> levels follow those of the part before.
  subroutine breadth_first(graph, root, order, level)
    type(graph_t), intent(in) :: graph
    integer, intent(in) :: root
    integer, intent(out) :: order(graph%n)
    integer, intent(out) :: level(graph%n)  !! cables from the root, counted from 1; ascending along `order`
    integer :: head, tail, i, k, from, next
    level = 0
    head = 1
    tail = 0
    from = root
    do i = 0, graph%n
      if (i > 0) from = i
      if (level(from) > 0) cycle
      next = 1
      if (tail > 0) next = level(order(tail)) + 1
      call reach(from, next)
      do while (head <= tail)
        do k = graph%start(order(head)), graph%start(order(head) + 1) - 1
          if (level(graph%neighbour(k)) == 0) call reach(graph%neighbour(k), level(order(head)) + 1)
        end do
        head = head + 1
      end do
    end do

  contains

    subroutine reach(node, at)
      integer, intent(in) :: node, at
      tail = tail + 1
      order(tail) = node
      level(node) = at
    end subroutine reach

  end subroutine breadth_first

end module castnet_graph
