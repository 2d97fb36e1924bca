!> An order of the nodes along paths of cables, for nets without a lattice.
!>
!> A cable between a node and the next one lies on a diagonal of offset 1 (castnet_cable_plan), the cheapest
!> place there is, and a path leads through nearly every node of a net: of four cables at a node two
!> are on it. It goes on to the neighbour that has the fewest others left to go to (Warnsdorff's
!> rule), so that few nodes are left behind, and not far from where the first of these lie, so that
!> what is joined stays close in memory. Random points joined to their Gabriel neighbours: 19 of 20 nodes follow
!> a neighbour.
module castnet_node_paths
  use castnet_graph, only: graph_t, breadth_first
  implicit none
  private
  public :: follow_paths

  integer, parameter :: width = 5       !! levels that a path may be ahead of the first node left behind
  integer, parameter :: most_looks = 40 !! nodes among which the next path's start is sought

contains

  !> order(i): which node comes i-th.
  subroutine follow_paths(graph, order)
    type(graph_t), intent(in) :: graph
    integer, intent(out) :: order(graph%n)
    integer :: by_level(graph%n), level(graph%n), free(graph%n), n_done, behind, node
    logical :: done(graph%n)

    node = minloc(graph%start(2:) - graph%start(:graph%n), dim=1)
    call breadth_first(graph, node, by_level, level)
    call breadth_first(graph, by_level(graph%n), order, level)   ! from one end of the net to the other
    by_level = order
    free = graph%start(2:) - graph%start(:graph%n)
    done = .false.
    behind = 1
    n_done = 0
    node = 0
    do while (n_done < graph%n)
      if (node > 0) node = next_on_path()
      if (node == 0) node = new_start()
      n_done = n_done + 1
      order(n_done) = node
      done(node) = .true.
      associate (around => graph%neighbour(graph%start(node):graph%start(node + 1) - 1))
        free(around) = free(around) - 1
      end associate
      do while (behind < graph%n .and. done(by_level(behind)))
        behind = behind + 1
      end do
    end do

  contains

    integer function next_on_path() result(best)
      integer :: k
      best = 0
      do k = graph%start(node), graph%start(node + 1) - 1
        call consider(graph%neighbour(k), width, best)
      end do
    end function next_on_path

    integer function new_start() result(best)
      integer :: k
      best = 0
      do k = behind, min(graph%n, behind + most_looks)
        call consider(by_level(k), 1, best)
      end do
    end function new_start

    !> Is this node better than the best so far?
    subroutine consider(other, ahead, best)
      integer, intent(in) :: other, ahead
      integer, intent(inout) :: best
      if (done(other) .or. level(other) > level(by_level(behind)) + ahead) return
      if (best > 0) then
        if (free(other) > free(best) .or. (free(other) == free(best) .and. level(other) >= level(best))) return
      end if
      best = other
    end subroutine consider

  end subroutine follow_paths

end module castnet_node_paths
