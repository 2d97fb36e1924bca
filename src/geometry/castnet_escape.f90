!> In which directions can a body leave through a surface of triangles without meeting it?
!>
!> A direction is blocked when something of the surface stands in front of the body: a
!> point of the surface from which the way back meets the body, or a point of the body from
!> which the way ahead meets the surface. The points: corners, middles of the sides and
!> centre of every mesh square, and the outermost points of the body all around, so what
!> overlaps by less than about half a mesh at the rim of both can be missed.
!>
!> To be stopped the body must run into the surface: a part of the body that faces less than
!> ten degrees against the motion slides along what it meets. Without this a net that
!> clings to the sides of one end would seem to hold the body in every direction.
!>
!> A net that lies on a body cuts its edges: between two nodes on neighbouring faces the
!> square runs inside. A point inside the body counts as lying on the nearest part of its
!> surface. For the same reason the way ahead starts a little inside the body.
module castnet_escape
  use castnet_kinds, only: wp
  use castnet_ray, only: ray_lengths, misses
  use castnet_shape, only: shape_t, signed_distance, shape_bounding_radius, shape_bounds, surface_samples
  implicit none
  private
  public :: free_directions

  integer, parameter :: per_square = 9   !! points of a mesh square: 4 corners, 4 middles of sides, its centre
  integer, parameter :: most_starts = 64 !! points of the body
  real(wp), parameter :: inset = 0.05_wp !! of the way from such a point to the body's middle, where its ray starts

  real(wp), parameter :: glancing = 0.173648177666930349_wp !! sine of the angle up to which the body slides along

  !> The surface and the body, ready to be asked direction by direction.
  type :: scene_t
    integer :: n_square = 0
    real(wp), allocatable :: corner(:, :, :)     !! (3,4,n) [m]
    real(wp), allocatable :: middle(:, :)        !! (n,3) [m]
    real(wp), allocatable :: reach(:)            !! (n) radius about it that holds the square [m]
    real(wp), allocatable :: point(:, :)         !! (3,per_square*n)
    real(wp), allocatable :: distance(:)         !! from the body, negative inside [m]
    real(wp), allocatable :: normal(:, :)        !! outward normal of the body's nearest point
    real(wp), allocatable :: rim(:, :)           !! (3,:) points of the body
    real(wp), allocatable :: start(:, :)         !! (3,:) and where their rays start
    real(wp) :: lower(3) = 0.0_wp, upper(3) = 0.0_wp !! box that holds the body [m]
    real(wp) :: radius = 0.0_wp                  !! and ball [m]
  end type scene_t

contains

  !> For each direction that is to be judged: is the way free? Body axes throughout, the
  !> body's origin at zero. A direction not to be judged is returned as not free.
  pure subroutine free_directions(shape, corner, direction, judged, free)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: corner(:, :, :)        !! (3,4,n) corners of the mesh squares [m]
    real(wp), intent(in) :: direction(:, :)        !! (m,3) unit vectors
    logical, intent(in) :: judged(:)               !! (m)
    logical, intent(out) :: free(:)                !! (m)
    type(scene_t) :: scene
    real(wp), allocatable :: ahead(:, :)
    integer, allocatable :: near(:)
    real(wp) :: d(3)
    integer :: k, n_near
    logical :: blocked
    free = .false.
    if (.not. any(judged)) return
    call prepare(shape, corner, scene)
    allocate (near(scene%n_square), ahead(3, per_square*scene%n_square))
    do k = 1, size(judged)
      if (.not. judged(k)) cycle
      d = direction(k, :)
      call squares_ahead(scene%n_square, scene%middle, scene%reach, scene%lower, scene%upper, d, near, n_near)
      free(k) = n_near == 0
      if (free(k)) cycle
      call points_in_the_way(shape, scene, near(:n_near), d, ahead, blocked)
      if (blocked) cycle
      free(k) = .not. squares_in_the_way(shape, scene, near(:n_near), d)
    end do
  end subroutine free_directions

  pure subroutine prepare(shape, corner, scene)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: corner(:, :, :)
    type(scene_t), intent(out) :: scene
    real(wp) :: d(3)
    integer :: i, k, n
    n = size(corner, 3)
    scene%n_square = n
    scene%corner = corner
    scene%radius = shape_bounding_radius(shape)
    call shape_bounds(shape, scene%lower, scene%upper)
    allocate (scene%middle(n, 3), scene%reach(n), scene%point(3, per_square*n), scene%distance(per_square*n), &
              scene%normal(3, per_square*n))
    do i = 1, n
      scene%middle(i, :) = 0.25_wp*(corner(:, 1, i) + corner(:, 2, i) + corner(:, 3, i) + corner(:, 4, i))
      scene%reach(i) = 0.0_wp
      do k = 1, 4
        d = corner(:, k, i) - scene%middle(i, :)
        scene%reach(i) = max(scene%reach(i), sqrt(d(1)*d(1) + d(2)*d(2) + d(3)*d(3)))
        scene%point(:, per_square*(i - 1) + k) = corner(:, k, i)
        scene%point(:, per_square*(i - 1) + 4 + k) = 0.5_wp*(corner(:, k, i) + corner(:, modulo(k, 4) + 1, i))
      end do
      scene%point(:, per_square*i) = scene%middle(i, :)
    end do
    call signed_distance(shape, per_square*n, scene%point, scene%distance, scene%normal)
    call surface_samples(shape, most_starts, scene%rim)
    d = sum(scene%rim, dim=2)/real(size(scene%rim, 2), wp)
    scene%start = scene%rim
    do i = 1, size(scene%rim, 2)
      scene%start(:, i) = scene%rim(:, i) + inset*(d - scene%rim(:, i))
    end do
  end subroutine prepare

  !> Squares that can stand in the way: the way back from their middle meets the body's box,
  !> widened by their reach.
  pure subroutine squares_ahead(n, middle, reach, lower, upper, d, near, n_near)
    integer, intent(in) :: n
    real(wp), intent(in) :: middle(n, 3), reach(n), lower(3), upper(3), d(3)
    integer, intent(inout) :: near(:)
    integer, intent(out) :: n_near
    real(wp) :: inverse(3), centre(3), half(3), t1, t2, t3, w1, w2, w3, overlap(n)
    integer :: i
    inverse = 1.0_wp/sign(max(abs(d), 1.0e-30_wp), d)
    centre = 0.5_wp*(lower + upper)
    half = 0.5_wp*(upper - lower)
    do i = 1, n
      t1 = (middle(i, 1) - centre(1))*inverse(1)
      t2 = (middle(i, 2) - centre(2))*inverse(2)
      t3 = (middle(i, 3) - centre(3))*inverse(3)
      w1 = (half(1) + reach(i))*abs(inverse(1))
      w2 = (half(2) + reach(i))*abs(inverse(2))
      w3 = (half(3) + reach(i))*abs(inverse(3))
      overlap(i) = min(t1 + w1, t2 + w2, t3 + w3) - max(0.0_wp, t1 - w1, t2 - w2, t3 - w3)
    end do
    n_near = 0
    do i = 1, n
      if (overlap(i) < 0.0_wp) cycle
      n_near = n_near + 1
      near(n_near) = i
    end do
  end subroutine squares_ahead

  !> Does a point of these squares stand in front of the body?
  pure subroutine points_in_the_way(shape, scene, near, d, ahead, blocked)
    type(shape_t), intent(in) :: shape
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: near(:)
    real(wp), intent(in) :: d(3)
    real(wp), intent(inout) :: ahead(:, :)  !! scratch
    logical, intent(out) :: blocked
    integer :: i, k, n
    n = 0
    blocked = .true.
    do i = 1, size(near)
      do k = per_square*(near(i) - 1) + 1, per_square*near(i)
        if (scene%distance(k) <= 0.0_wp) then
          if (scene%normal(1, k)*d(1) + scene%normal(2, k)*d(2) + scene%normal(3, k)*d(3) > glancing) return
          cycle
        end if
        n = n + 1
        ahead(:, n) = scene%point(:, k)
      end do
    end do
    call runs_into(shape, n, ahead(:, :n), d, blocked)
  end subroutine points_in_the_way

  !> Does the body, moving along d, run into one of these points?
  pure subroutine runs_into(shape, n, point, d, blocked)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n), d(3)
    logical, intent(out) :: blocked
    real(wp) :: length(n), met(3, n), distance(n), normal(3, n)
    integer :: i, m
    call ray_lengths(shape, n, point, -d, length)
    m = 0
    do i = 1, n
      if (length(i) >= misses) cycle
      m = m + 1
      met(:, m) = point(:, i) - length(i)*d
    end do
    call signed_distance(shape, m, met(:, :m), distance(:m), normal(:, :m))
    blocked = .true.
    do i = 1, m
      if (normal(1, i)*d(1) + normal(2, i)*d(2) + normal(3, i)*d(3) > glancing) return
    end do
    blocked = .false.
  end subroutine runs_into

  !> Does the way ahead of a point on the body's front meet one of these squares? All seen
  !> along d: points and squares in the plane across it, heights along it.
  pure logical function squares_in_the_way(shape, scene, near, d) result(blocked)
    type(shape_t), intent(in) :: shape
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: near(:)
    real(wp), intent(in) :: d(3)
    real(wp) :: u(3), v(3), start(3, size(scene%start, 2)), square(3, 4)
    logical :: front(size(scene%start, 2))
    integer :: i, k
    call tangents(d, u, v)
    call on_the_front(shape, scene%rim, scene%radius, d, front)
    do k = 1, size(front)
      start(:, k) = seen(scene%start(:, k))
    end do
    blocked = .true.
    do i = 1, size(near)
      do k = 1, 4
        square(:, k) = seen(scene%corner(:, k, near(i)))
      end do
      do k = 1, size(front)
        if (.not. front(k)) cycle
        if (start(1, k) > max(square(1, 1), square(1, 2), square(1, 3), square(1, 4))) cycle
        if (start(1, k) < min(square(1, 1), square(1, 2), square(1, 3), square(1, 4))) cycle
        if (start(2, k) > max(square(2, 1), square(2, 2), square(2, 3), square(2, 4))) cycle
        if (start(2, k) < min(square(2, 1), square(2, 2), square(2, 3), square(2, 4))) cycle
        if (under_triangle(start(:, k), square(:, 1), square(:, 2), square(:, 3))) return
        if (under_triangle(start(:, k), square(:, 1), square(:, 3), square(:, 4))) return
      end do
    end do
    blocked = .false.
  contains
    pure function seen(p) result(s)
      real(wp), intent(in) :: p(3)
      real(wp) :: s(3)
      s(1) = p(1)*u(1) + p(2)*u(2) + p(3)*u(3)
      s(2) = p(1)*v(1) + p(2)*v(2) + p(3)*v(3)
      s(3) = p(1)*d(1) + p(2)*d(2) + p(3)*d(3)
    end function seen
  end function squares_in_the_way

  !> Points that face the motion: a small step along d takes them out of the body.
  pure subroutine on_the_front(shape, rim, radius, d, front)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: rim(:, :), radius, d(3)
    logical, intent(out) :: front(:)
    real(wp) :: moved(3, size(rim, 2)), distance(size(rim, 2)), normal(3, size(rim, 2))
    integer :: k
    do k = 1, size(rim, 2)
      moved(:, k) = rim(:, k) + 1.0e-4_wp*radius*d
    end do
    call signed_distance(shape, size(rim, 2), moved, distance, normal)
    front = distance > glancing*1.0e-4_wp*radius
  end subroutine on_the_front

  !> Is the triangle above the point? Sides count as inside.
  pure logical function under_triangle(p, a, b, c) result(under)
    real(wp), intent(in) :: p(3), a(3), b(3), c(3)
    real(wp) :: wa, wb, wc, total
    wa = (b(1) - p(1))*(c(2) - p(2)) - (b(2) - p(2))*(c(1) - p(1))
    wb = (c(1) - p(1))*(a(2) - p(2)) - (c(2) - p(2))*(a(1) - p(1))
    wc = (a(1) - p(1))*(b(2) - p(2)) - (a(2) - p(2))*(b(1) - p(1))
    total = wa + wb + wc
    under = .false.
    if (.not. abs(total) > 0.0_wp) return
    if (min(wa*total, wb*total, wc*total) < 0.0_wp) return
    under = (wa*a(3) + wb*b(3) + wc*c(3))/total >= p(3)
  end function under_triangle

  !> Two unit vectors across d and each other.
  pure subroutine tangents(d, u, v)
    real(wp), intent(in) :: d(3)
    real(wp), intent(out) :: u(3), v(3)
    real(wp) :: length
    integer :: k
    k = minloc(abs(d), dim=1)
    u = -d(k)*d
    u(k) = u(k) + 1.0_wp
    length = sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3))
    u = u/length
    v(1) = d(2)*u(3) - d(3)*u(2)
    v(2) = d(3)*u(1) - d(1)*u(3)
    v(3) = d(1)*u(2) - d(2)*u(1)
  end subroutine tangents

end module castnet_escape
