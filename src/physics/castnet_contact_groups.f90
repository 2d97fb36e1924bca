!> Contacts that act on each other through common nodes, in groups: numbered breadth first
!> along the common nodes, so that their matrices have narrow envelopes.
module castnet_contact_groups
  use castnet_contact_list, only: contact_list_t
  implicit none
  private
  public :: contact_groups_t, reserve_groups, find_groups

  !> Positions p run along the groups, breadth first within each.
  type :: contact_groups_t
    integer :: n_group = 0
    integer, allocatable :: head(:)                 !! (nodes of the net) latest contact at a node, 0: none
    integer, allocatable :: low(:)                  !! (nodes of the net) first position that touches a node, 0: none yet
    integer, allocatable :: next_a(:), next_b(:)    !! (capacity) next contact at node a, b; negative: as its node b
    integer, allocatable :: order(:)                !! (capacity) contact at position p
    integer, allocatable :: place(:)                !! (capacity) position of a contact, 0: none yet
    integer, allocatable :: start(:)                !! (capacity+1) first position of each group
    integer, allocatable :: first(:)                !! (capacity) first position that p is coupled to
  end type contact_groups_t

contains

  !> Room for `capacity` contacts on a net of `n_node` nodes.
  subroutine reserve_groups(groups, capacity, n_node)
    type(contact_groups_t), intent(inout) :: groups
    integer, intent(in) :: capacity, n_node
    if (allocated(groups%head)) then
      if (size(groups%head) < n_node) deallocate (groups%head, groups%low)
    end if
    if (.not. allocated(groups%head)) allocate (groups%head(n_node), groups%low(n_node), source=0)
    if (allocated(groups%order)) then
      if (size(groups%order) >= capacity) return
      deallocate (groups%next_a, groups%next_b, groups%order, groups%place, groups%start, groups%first)
    end if
    allocate (groups%next_a(capacity), groups%next_b(capacity), groups%order(capacity), groups%place(capacity), &
              groups%start(capacity + 1), groups%first(capacity), source=0)
  end subroutine reserve_groups

  !> Number the contacts of the list. As many groups as contacts: none shares a node.
  pure subroutine find_groups(list, groups)
    type(contact_list_t), intent(in) :: list
    type(contact_groups_t), intent(inout) :: groups
    integer :: i, seed, last, here
    do i = 1, list%n
      groups%head(list%node_a(i)) = 0
      groups%head(list%node_b(i)) = 0
      groups%low(list%node_a(i)) = 0
      groups%low(list%node_b(i)) = 0
      groups%place(i) = 0
    end do
    ! Entry +i: contact i as its node a; -i: as its node b.
    do i = list%n, 1, -1
      groups%next_a(i) = groups%head(list%node_a(i))
      groups%head(list%node_a(i)) = i
      groups%next_b(i) = 0
      if (list%node_b(i) == list%node_a(i)) cycle
      groups%next_b(i) = groups%head(list%node_b(i))
      groups%head(list%node_b(i)) = -i
    end do
    groups%n_group = 0
    last = 0
    do seed = 1, list%n
      if (groups%place(seed) /= 0) cycle
      groups%n_group = groups%n_group + 1
      groups%start(groups%n_group) = last + 1
      last = last + 1
      groups%order(last) = seed
      groups%place(seed) = last
      here = last
      do while (here <= last)
        i = groups%order(here)
        groups%first(here) = here
        call visit(groups, list%node_a(i), here, last)
        if (list%node_b(i) /= list%node_a(i)) call visit(groups, list%node_b(i), here, last)
        here = here + 1
      end do
    end do
    groups%start(groups%n_group + 1) = last + 1
  end subroutine find_groups

  !> Number the other contacts at a node; the first time only, later all of them are.
  pure subroutine visit(groups, node, here, last)
    type(contact_groups_t), intent(inout) :: groups
    integer, intent(in) :: node, here
    integer, intent(inout) :: last
    integer :: entry, k
    if (groups%low(node) > 0) then
      groups%first(here) = min(groups%first(here), groups%low(node))
      return
    end if
    groups%low(node) = here
    entry = groups%head(node)
    do while (entry /= 0)
      k = abs(entry)
      if (groups%place(k) == 0) then
        last = last + 1
        groups%order(last) = k
        groups%place(k) = last
      end if
      entry = merge(groups%next_a(k), groups%next_b(k), entry > 0)
    end do
  end subroutine visit

end module castnet_contact_groups
