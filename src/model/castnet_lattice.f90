!> Integer coordinates for the nodes of a net that hangs together like a lattice.
!>
!> Nothing but the cables is looked at: not where the nodes are (a net may be folded) and not
!> their numbers. Coordinates spread from one mesh over the others by two rules. The
!> fourth corner of a square is p + w - r, and so is that of two triangles with a side in common;
!> and only where no square helps any further (cables are missing), of two cables at a node
!> that share no square one goes on where the other came from. Where they cannot spread any
!> further a new **patch** begins.
!>
!> Hexagons: every second node of a net of hexagons is a node of a lattice of triangles, whose sides
!> are the ways over one node of the other kind. Its coordinates give those of a brick wall: rows
!> of zigzags, every second node joined to the next row.
!>
!> A net that closes round a hub or a tube meets itself in a ragged seam, where coordinates differ by
!> its period; `close_seam` finds that and cuts the net along a straight line.
!>
!> All this serves an order of the nodes (castnet_renumber): nothing depends on its being right but speed.
module castnet_lattice
  use castnet_graph, only: graph_t, breadth_first
  use castnet_kinds, only: i8
  implicit none
  private
  public :: find_lattice, find_honeycomb, fill_gaps, close_seam

  integer, parameter :: unknown = huge(1)    !! no coordinate
  integer, parameter :: most_visits = 200    !! a node, by the second rule, on average

  integer, parameter :: unit(2, 4) = reshape([1, 0, 0, 1, -1, 0, 0, -1], [2, 4]) !! steps along rows and columns

contains

  !> Coordinates of the nodes of squares or triangles, patch by patch; zeros elsewhere.
  subroutine find_lattice(graph, at, patch)
    type(graph_t), intent(in) :: graph
    integer, intent(out) :: at(2, graph%n)
    integer, intent(out) :: patch(graph%n) !! counted from 1; 0: in none
    integer :: queue(0:graph%n), front(graph%n), p, corner(4), head, tail, n_patch
    logical :: queued(graph%n)
    at = 0
    patch = 0
    queued = .false.
    n_patch = 0
    do p = 1, graph%n
      if (patch(p) > 0) cycle
      call free_square(graph, p, patch, corner)
      if (corner(1) == 0) cycle
      n_patch = n_patch + 1
      patch(corner) = n_patch
      at(:, corner) = reshape([0, 0, 1, 0, 1, 1, 0, 1], [2, 4])
      head = 0
      tail = 4
      queue(0:3) = corner
      queued(corner) = .true.
      call spread_patch()
    end do

  contains

    subroutine spread_patch()
      integer :: s, k, n_front, before
      integer(i8) :: visits
      front(:4) = corner
      n_front = 4
      visits = 0
      do
        do while (head /= tail)
          s = queue(head)
          head = modulo(head + 1, graph%n + 1)
          queued(s) = .false.
          do k = graph%start(s), graph%start(s + 1) - 1
            call try(s, graph%neighbour(k), .false., n_front)
          end do
        end do
        call leave_behind(n_front)
        visits = visits + n_front
        if (visits > most_visits*int(graph%n, i8)) exit
        before = n_front
        do s = 1, before
          do k = graph%start(front(s)), graph%start(front(s) + 1) - 1
            call try(front(s), graph%neighbour(k), .true., n_front)
          end do
        end do
        if (n_front == before) exit
      end do
    end subroutine spread_patch

    !> Keep those with a neighbour in no patch.
    subroutine leave_behind(n_front)
      integer, intent(inout) :: n_front
      integer :: s, kept
      kept = 0
      do s = 1, n_front
        if (all(patch(graph%neighbour(graph%start(front(s)):graph%start(front(s) + 1) - 1)) > 0)) cycle
        kept = kept + 1
        front(kept) = front(s)
      end do
      n_front = kept
    end subroutine leave_behind

    !> Place q, a neighbour of the placed node s, if its place is known.
    subroutine try(s, q, straight, n_front)
      integer, intent(in) :: s, q
      logical, intent(in) :: straight  !! by the second rule
      integer, intent(inout) :: n_front
      integer :: l, place(2)
      if (patch(q) > 0) return
      call place_neighbour(graph, s, q, at, patch, straight, place)
      if (place(1) == unknown) return
      at(:, q) = place
      patch(q) = n_patch
      n_front = n_front + 1
      front(n_front) = q
      call enqueue(q)
      do l = graph%start(q), graph%start(q + 1) - 1
        if (patch(graph%neighbour(l)) == n_patch) call enqueue(graph%neighbour(l))
      end do
    end subroutine try

    !> A ring buffer: a node comes again when a neighbour has been placed.
    subroutine enqueue(node)
      integer, intent(in) :: node
      if (queued(node)) return
      queued(node) = .true.
      queue(tail) = node
      tail = modulo(tail + 1, graph%n + 1)
    end subroutine enqueue

  end subroutine find_lattice

  !> Coordinates of q, a neighbour of the placed node p; `unknown` if the rule does not speak
  !> or not clearly.
  subroutine place_neighbour(graph, p, q, at, patch, straight, place)
    type(graph_t), intent(in) :: graph
    integer, intent(in) :: p, q, at(:, :), patch(:)
    logical, intent(in) :: straight    !! the second rule, else the first
    integer, intent(out) :: place(2)
    integer :: k, r, w, n_straight
    logical :: in_square
    place = unknown
    n_straight = 0
    in_square = .false.
    do k = graph%start(p), graph%start(p + 1) - 1
      r = graph%neighbour(k)
      if (r == q .or. patch(r) /= patch(p)) cycle
      w = fourth_corner(graph, p, r, q, patch)
      if (w > 0) then
        in_square = .true.
        if (straight .or. patch(w) /= patch(p)) cycle
        place = at(:, p) + at(:, w) - at(:, r)
      else if (straight) then
        n_straight = n_straight + 1
        place = 2*at(:, p) - at(:, r)
      end if
    end do
    if (place(1) == unknown) return
    if (straight) then
      if (n_straight /= 1 .or. .not. in_square) place = unknown
      do k = graph%start(p), graph%start(p + 1) - 1
        if (all(at(:, graph%neighbour(k)) == place) .and. patch(graph%neighbour(k)) == patch(p)) place = unknown
      end do
    end if
    if (place(1) == unknown) return
    if (maxval(abs(place - at(:, p))) /= 1) place = unknown
  end subroutine place_neighbour

  !> A node besides p that joins r and q, one of p's patch if there is one; 0: none.
  integer function fourth_corner(graph, p, r, q, patch) result(w)
    type(graph_t), intent(in) :: graph
    integer, intent(in) :: p, r, q, patch(:)
    integer :: k, l
    w = 0
    do k = graph%start(q), graph%start(q + 1) - 1
      if (graph%neighbour(k) == p) cycle
      do l = graph%start(r), graph%start(r + 1) - 1
        if (graph%neighbour(l) /= graph%neighbour(k)) cycle
        if (w == 0 .or. patch(graph%neighbour(k)) == patch(p)) w = graph%neighbour(k)
      end do
    end do
  end function fourth_corner

  !> Four nodes in a square with p, all in no patch; zeros without one.
  subroutine free_square(graph, p, patch, corner)
    type(graph_t), intent(in) :: graph
    integer, intent(in) :: p, patch(:)
    integer, intent(out) :: corner(4)
    integer :: k, l
    do k = graph%start(p), graph%start(p + 1) - 1
      do l = k + 1, graph%start(p + 1) - 1
        corner = [p, graph%neighbour(k), fourth_corner(graph, p, graph%neighbour(k), graph%neighbour(l), patch), &
                  graph%neighbour(l)]
        if (corner(3) == 0 .or. any(corner(3) == corner([2, 4])) .or. corner(2) == corner(4)) cycle
        if (all(patch(corner) == 0)) return
      end do
    end do
    corner = 0
  end subroutine free_square

  !> Brick coordinates of the nodes of hexagons, patch by patch; zeros elsewhere.
  subroutine find_honeycomb(graph, at, patch)
    type(graph_t), intent(in) :: graph
    integer, intent(out) :: at(2, graph%n), patch(graph%n)
    type(graph_t) :: triangles
    integer :: order(graph%n), level(graph%n)
    logical :: even(graph%n)
    if (graph%n == 0) return
    call breadth_first(graph, 1, order, level)
    even = modulo(level, 2) == 1
    call over_one(graph, even, triangles)
    call find_lattice(triangles, at, patch)
    call turn_upright(graph, triangles, even, at, patch)
    call place_odd(graph, even, at, patch)
    where (patch > 0)
      at(1, :) = 2*at(1, :) + at(2, :) + merge(0, 1, even)
    end where
  end subroutine find_honeycomb

  !> The even nodes, joined where one odd node lies between.
  subroutine over_one(graph, even, triangles)
    type(graph_t), intent(in) :: graph
    logical, intent(in) :: even(:)
    type(graph_t), intent(out) :: triangles
    integer :: fill, p, k, l, b
    triangles%n = graph%n
    allocate (triangles%start(graph%n + 1))
    do fill = 0, 1
      b = 1
      triangles%start = 1
      do p = 1, graph%n
        triangles%start(p) = b
        if (even(p)) then
          do k = graph%start(p), graph%start(p + 1) - 1
            if (even(graph%neighbour(k))) cycle
            do l = graph%start(graph%neighbour(k)), graph%start(graph%neighbour(k) + 1) - 1
              if (graph%neighbour(l) == p .or. .not. even(graph%neighbour(l))) cycle
              if (fill == 1) triangles%neighbour(b) = graph%neighbour(l)
              b = b + 1
            end do
          end do
        end if
      end do
      triangles%start(graph%n + 1) = b
      if (fill == 0) allocate (triangles%neighbour(b - 1))
    end do
  end subroutine over_one

  !> Mirror and turn each patch so that sides run along (1,0), (0,1) and (1,-1), and odd nodes join
  !> (i,j), (i+1,j) and (i,j+1).
  subroutine turn_upright(graph, triangles, even, at, patch)
    type(graph_t), intent(in) :: graph, triangles
    logical, intent(in) :: even(:)
    integer, intent(inout) :: at(:, :)
    integer, intent(in) :: patch(:)
    integer :: vote(0:maxval(patch)), p, q, k, d(2)
    vote = 0
    do p = 1, graph%n
      do k = triangles%start(p), triangles%start(p + 1) - 1
        q = triangles%neighbour(k)
        if (patch(p) == 0 .or. patch(p) /= patch(q)) cycle
        d = at(:, q) - at(:, p)
        if (maxval(abs(d)) == 1) vote(patch(p)) = vote(patch(p)) + d(1)*d(2)
      end do
    end do
    do p = 1, graph%n
      if (vote(patch(p)) > 0 .and. patch(p) > 0) at(2, p) = -at(2, p)
    end do
    vote = 0
    do p = 1, graph%n
      if (even(p) .or. graph%start(p + 1) - graph%start(p) /= 3) cycle
      associate (corner => graph%neighbour(graph%start(p):graph%start(p + 1) - 1))
        if (any(patch(corner) == 0) .or. any(patch(corner) /= patch(corner(1)))) cycle
        k = modulo(sum(at(1, corner)), 3)
        vote(patch(corner(1))) = vote(patch(corner(1))) + merge(1, 0, k == 1) - merge(1, 0, k == 2)
      end associate
    end do
    do p = 1, graph%n
      if (vote(patch(p)) < 0 .and. patch(p) > 0) at(:, p) = -at(:, p)
    end do
  end subroutine turn_upright

  !> Odd nodes are where their even neighbours say; one with a single neighbour that has a place takes
  !> the first of three places that is free.
  subroutine place_odd(graph, even, at, patch)
    type(graph_t), intent(in) :: graph
    logical, intent(in) :: even(:)
    integer, intent(inout) :: at(:, :), patch(:)
    integer, parameter :: step(2, 3) = reshape([0, 0, 1, 0, 0, 1], [2, 3])
    integer :: p, q, k, l, s, n_here, low(2), one, sought
    logical :: taken
    do sought = 2, 1, -1
      do p = 1, graph%n
        if (even(p) .or. patch(p) > 0) cycle
        n_here = 0
        low = unknown
        one = 0
        do k = graph%start(p), graph%start(p + 1) - 1
          q = graph%neighbour(k)
          if (patch(q) == 0 .or. .not. even(q)) cycle
          if (one == 0) one = q
          if (patch(q) /= patch(one)) cycle
          n_here = n_here + 1
          low = min(low, at(:, q))
        end do
        if (n_here == 0 .or. n_here < sought) cycle
        if (n_here == 1) then
          do s = 1, 3
            low = at(:, one) - step(:, s)
            taken = .false.
            do l = graph%start(one), graph%start(one + 1) - 1
              q = graph%neighbour(l)
              if (patch(q) == patch(one) .and. .not. even(q)) taken = taken .or. all(at(:, q) == low)
            end do
            if (.not. taken) exit
          end do
        end if
        at(:, p) = low
        patch(p) = patch(one)
      end do
    end do
  end subroutine place_odd

  !> Nodes that the rules did not reach, where at least two of their neighbours have one and the same place
  !> for them. A node without a place would shift the rest of its row.
  subroutine fill_gaps(graph, brick, at, patch)
    type(graph_t), intent(in) :: graph
    logical, intent(in) :: brick       !! a wall of bricks: nodes with even x - y have no neighbour above, others none below
    integer, intent(inout) :: at(:, :), patch(:)
    integer :: p, k, s, best, most
    integer, allocatable :: place(:, :), votes(:)
    allocate (place(2, 0), votes(0))
    do p = 1, graph%n
      if (patch(p) > 0) cycle
      associate (around => graph%neighbour(graph%start(p):graph%start(p + 1) - 1))
        if (count(patch(around) > 0) < 2) cycle
        most = 4*size(around)
        if (size(votes) < most) then
          deallocate (place, votes)
          allocate (place(2, most), votes(most))
        end if
        votes(:most) = 0
        do k = 1, size(around)
          if (patch(around(k)) == 0) cycle
          do s = 1, 4
            if (brick .and. modulo(sum(at(:, around(k))), 2) == 0 .and. unit(2, s) == 1) cycle
            if (brick .and. modulo(sum(at(:, around(k))), 2) == 1 .and. unit(2, s) == -1) cycle
            if (.not. has_step(graph, at, patch, around(k), unit(:, s))) call vote(at(:, around(k)) + unit(:, s))
          end do
        end do
        best = maxloc(votes(:most), dim=1)
        if (votes(best) < 2) cycle
        at(:, p) = place(:, best)
        patch(p) = maxval(patch(around))
      end associate
    end do

  contains

    subroutine vote(here)
      integer, intent(in) :: here(2)
      integer :: i
      do i = 1, size(votes)
        if (votes(i) > 0 .and. any(place(:, i) /= here)) cycle
        place(:, i) = here
        votes(i) = votes(i) + 1
        exit
      end do
    end subroutine vote

  end subroutine fill_gaps

  !> Does a cable lead from node p this way?
  pure logical function has_step(graph, at, patch, p, step)
    type(graph_t), intent(in) :: graph
    integer, intent(in) :: at(:, :), patch(:), p, step(2)
    integer :: l
    has_step = .false.
    do l = graph%start(p), graph%start(p + 1) - 1
      associate (q => graph%neighbour(l))
        if (patch(q) == patch(p)) has_step = has_step .or. all(at(:, q) - at(:, p) == step)
      end associate
    end do
  end function has_step

  !> Cut the largest patch along a straight line if it closes in itself. The period: what a cable's step
  !> across the seam differs by from a unit step that both its ends have room for. Most votes win.
  subroutine close_seam(graph, at, patch)
    type(graph_t), intent(in) :: graph
    integer, intent(inout) :: at(:, :)
    integer, intent(in) :: patch(:)
    integer :: p, k, u, largest, votes, period(2), one(2), n_right, along, low, turns
    integer, allocatable :: many(:), seam(:, :), d(:, :)
    if (maxval(patch) == 0) return
    allocate (many(maxval(patch)), source=0)
    do p = 1, graph%n
      if (patch(p) > 0) many(patch(p)) = many(patch(p)) + 1
    end do
    largest = maxloc(many, dim=1)
    votes = 0
    period = 0
    call long_cables(graph, at, patch, largest, seam)
    d = at(:, seam(2, :)) - at(:, seam(1, :))
    do k = 1, size(seam, 2)
      do u = 1, 4
        if (has_step(graph, at, patch, seam(1, k), unit(:, u)) .or. has_step(graph, at, patch, seam(2, k), -unit(:, u))) cycle
        one = unit(:, u) - d(:, k)
        if (one(1) < 0 .or. (one(1) == 0 .and. one(2) < 0)) one = -one
        if (all(one == period)) then       ! the majority's name in one pass
          votes = votes + 1
        else if (votes == 0) then
          period = one
          votes = 1
        else
          votes = votes - 1
        end if
      end do
    end do
    if (maxval(abs(period)) < 3) return
    n_right = 0
    do k = 1, size(seam, 2)
      if (sum(abs(d(:, k) - period)) <= 2 .or. sum(abs(d(:, k) + period)) <= 2) n_right = n_right + 1
    end do
    if (2*n_right < size(seam, 2)) return
    along = maxloc(abs(period), dim=1)
    low = minval(at(along, :), mask=patch == largest)
    do p = 1, graph%n
      if (patch(p) /= largest) cycle
      turns = (at(along, p) - low)/abs(period(along))*sign(1, period(along))
      at(:, p) = at(:, p) - turns*period
    end do
  end subroutine close_seam

  !> The cables of a patch that are longer than a unit step, or its diagonal: those across its seam.
  subroutine long_cables(graph, at, patch, number, ends)
    type(graph_t), intent(in) :: graph
    integer, intent(in) :: at(:, :), patch(:), number
    integer, allocatable, intent(out) :: ends(:, :)  !! (2,:) the lower node first
    integer :: fill, n, p, k
    do fill = 0, 1
      n = 0
      do p = 1, graph%n
        if (patch(p) /= number) cycle
        do k = graph%start(p), graph%start(p + 1) - 1
          associate (q => graph%neighbour(k))
            if (patch(q) /= number .or. q < p) cycle
            if (maxval(abs(at(:, q) - at(:, p))) <= 1) cycle
            n = n + 1
            if (fill == 1) ends(:, n) = [p, q]
          end associate
        end do
      end do
      if (fill == 0) allocate (ends(2, n))
    end do
  end subroutine long_cables

end module castnet_lattice
