!> Shapes in body axes: what others ask of a target's geometry.
!>
!> A shape is one primitive, a union of placed primitives, or a closed triangle mesh.
!> Nothing here changes after construction, and no procedure keeps anything between
!> calls: many threads may ask the same shape.
module castnet_shape
  use castnet_kinds, only: wp
  use castnet_error, only: error_t, fail, exit_input
  use castnet_primitive, only: primitive_t, primitive_distance, primitive_volume, primitive_unit_inertia, &
                               primitive_support, shape_none, shape_box, shape_cylinder, &
                               shape_sphere, shape_capsule, shape_compound, shape_mesh
  use castnet_rotation, only: rotation_matrix, normalise_quaternion, multiply, multiply_transposed, congruent
  use castnet_surface, only: surface_t, append_surface, surface_volume, surface_centroid, surface_inertia
  use castnet_segment, only: primitive_segments
  use castnet_compound, only: compound_distance, compound_segments, to_part
  use castnet_tessellation, only: tessellate_primitive
  use castnet_mesh, only: mesh_t, build_mesh, mesh_distance
  use castnet_mesh_check, only: close_surface
  use castnet_mesh_file, only: read_mesh_file
  use castnet_mesh_segment, only: mesh_segments, mesh_sweep
  implicit none
  private
  public :: shape_t, new_shape, new_compound, new_mesh_shape, new_surface_shape, move_shape
  public :: signed_distance, signed_distance_within, segment_distance, segment_distance_within, swept_contact
  public :: shape_bounding_radius, shape_bounds, shape_volume, shape_centroid, unit_inertia, shape_length, is_convex
  public :: tessellate, surface_samples
  public :: shape_none, shape_box, shape_cylinder, shape_sphere, shape_capsule, shape_compound, shape_mesh

  type :: shape_t
    integer :: kind = shape_none
    real(wp) :: dimensions(3) = 0.0_wp              !! as the scene gives them; 0 for a compound or a mesh [m]
    type(primitive_t), allocatable :: parts(:)      !! one for a primitive, several for a compound, none for a mesh
    type(mesh_t), allocatable :: mesh               !! for a mesh alone
  end type shape_t

  interface segment_distance
    module procedure segment_distance_one, segment_distance_many
  end interface segment_distance

contains

  !> A primitive at the body's origin, long axis along body z.
  !> Box: edge lengths; cylinder: diameter, length; sphere: diameter; capsule: diameter,
  !> length between the cap centres. Errors: unknown word, a size that is not positive.
  subroutine new_shape(shape, word, dimensions, error)
    type(shape_t), intent(out) :: shape
    character(len=*), intent(in) :: word       !! 'box', 'cylinder', 'sphere', 'capsule'
    real(wp), intent(in) :: dimensions(3)      !! [m]; those that the shape does not need are ignored
    type(error_t), allocatable, intent(inout) :: error
    allocate (shape%parts(1))
    call new_primitive(shape%parts(1), word, dimensions, error)
    if (allocated(error)) return
    shape%kind = shape%parts(1)%kind
    shape%dimensions(:dimensions_needed(shape%kind)) = dimensions(:dimensions_needed(shape%kind))
  end subroutine new_shape

  !> The union of placed primitives. Errors: as `new_shape`, no part, no attitude.
  subroutine new_compound(shape, words, dimensions, position, attitude, error)
    type(shape_t), intent(out) :: shape
    character(len=*), intent(in) :: words(:)     !! (n)
    real(wp), intent(in) :: dimensions(:, :)     !! (3,n) [m]
    real(wp), intent(in) :: position(:, :)       !! (3,n) of each part's centre, body axes [m]
    real(wp), intent(in) :: attitude(:, :)       !! (4,n) part to body, scalar first
    type(error_t), allocatable, intent(inout) :: error
    character(len=12) :: number
    integer :: i
    if (size(words) == 0) then
      call fail(error, exit_input, 'shape ''compound'': no part is given; at least one is needed')
      return
    end if
    allocate (shape%parts(size(words)))
    do i = 1, size(words)
      call new_primitive(shape%parts(i), words(i), dimensions(:, i), error)
      if (.not. all(abs(position(:, i)) < huge(1.0_wp)) .or. .not. all(abs(attitude(:, i)) < 1.0e100_wp)) &
        call fail(error, exit_input, 'position or attitude is not a finite number')
      if (.not. any(abs(attitude(:, i)) > 0.0_wp)) &
        call fail(error, exit_input, 'attitude 0 0 0 0 is no rotation; 1 0 0 0 turns nothing')
      if (allocated(error)) then
        write (number, '(i0)') i
        error%message = 'part '//trim(number)//': '//error%message
        return
      end if
      associate (part => shape%parts(i))
        part%position = position(:, i)
        part%rotation = rotation_matrix(normalise_quaternion(attitude(:, i)))
        part%is_placed = .true.
      end associate
    end do
    shape%kind = shape_compound
  end subroutine new_compound

  !> A closed triangle mesh from an STL or OBJ file, in metres, axes as the file's. Errors: see
  !> `read_mesh_file` and `close_surface`.
  subroutine new_mesh_shape(shape, path, error)
    type(shape_t), intent(out) :: shape
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(inout) :: error
    type(surface_t) :: surface
    call read_mesh_file(path, surface, error)
    if (allocated(error)) return
    call new_surface_shape(shape, surface, path, error)
  end subroutine new_mesh_shape

  !> The same from triangles in memory; `name` stands in messages.
  subroutine new_surface_shape(shape, surface, name, error)
    type(shape_t), intent(out) :: shape
    type(surface_t), intent(in) :: surface
    character(len=*), intent(in) :: name
    type(error_t), allocatable, intent(inout) :: error
    type(surface_t) :: closed
    closed = surface
    call close_surface(closed, name, error)
    if (allocated(error)) return
    shape%kind = shape_mesh
    allocate (shape%mesh)
    call build_mesh(closed, shape%mesh)
  end subroutine new_surface_shape

  !> Move a shape in its body axes, so that the point `origin` becomes the body's origin (a mesh's or
  !> a compound's centroid, for example). A primitive becomes a compound of one part.
  subroutine move_shape(shape, origin)
    type(shape_t), intent(inout) :: shape
    real(wp), intent(in) :: origin(3)               !! body axes [m]
    type(surface_t) :: surface
    integer :: i
    if (shape%kind == shape_mesh) then
      surface = shape%mesh%surface
      do i = 1, size(surface%vertex, 2)
        surface%vertex(:, i) = surface%vertex(:, i) - origin
      end do
      call build_mesh(surface, shape%mesh)
    else
      shape%kind = shape_compound
      do i = 1, size(shape%parts)
        shape%parts(i)%position = shape%parts(i)%position - origin
        shape%parts(i)%is_placed = .true.
      end do
    end if
  end subroutine move_shape

  subroutine new_primitive(part, word, dimensions, error)
    type(primitive_t), intent(out) :: part
    character(len=*), intent(in) :: word
    real(wp), intent(in) :: dimensions(3)
    type(error_t), allocatable, intent(inout) :: error
    character(len=24) :: value
    integer :: i
    select case (word)
    case ('box')
      part%kind = shape_box
      part%half = 0.5_wp*max(-huge(1.0_wp), dimensions)
    case ('cylinder')
      part%kind = shape_cylinder
      part%half = 0.5_wp*[dimensions(1), dimensions(1), dimensions(2)]
    case ('sphere')
      part%kind = shape_sphere
      part%half = [0.5_wp*dimensions(1), 0.5_wp*dimensions(1), 0.0_wp]
    case ('capsule')
      part%kind = shape_capsule
      part%half = 0.5_wp*[dimensions(1), dimensions(1), dimensions(2)]
    case default
      call fail(error, exit_input, 'shape '''//trim(word)//''' is unknown; allowed: box, cylinder, sphere, capsule')
      return
    end select
    do i = 1, dimensions_needed(part%kind)
      if (dimensions(i) > 0.0_wp .and. dimensions(i) < 1.0e9_wp) cycle
      write (value, '(es12.4)') dimensions(i)
      call fail(error, exit_input, 'shape '''//trim(word)//''': dimension '//char(ichar('0') + i)//' is'// &
                trim(value)//' m; it must be larger than 0 and below 1e9')
      return
    end do
  end subroutine new_primitive

  pure integer function dimensions_needed(kind) result(count)
    integer, intent(in) :: kind
    select case (kind)
    case (shape_box)
      count = 3
    case (shape_cylinder, shape_capsule)
      count = 2
    case (shape_sphere)
      count = 1
    case default
      count = 0
    end select
  end function dimensions_needed

  !> Is the shape known to be convex? Then so is its signed distance.
  pure logical function is_convex(shape)
    type(shape_t), intent(in) :: shape
    is_convex = shape%kind == shape_box .or. shape%kind == shape_cylinder .or. shape%kind == shape_sphere .or. &
                shape%kind == shape_capsule
  end function is_convex

  !> Signed distance (negative inside) and outward unit normal, its gradient, of many
  !> points in body axes. Exact for primitives, meshes and outside compounds; inside compounds
  !> see `castnet_compound`.
  pure subroutine signed_distance(shape, n, point, distance, normal)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)                !! body axes [m]
    real(wp), intent(out) :: distance(n), normal(3, n) !! [m], [-]
    call signed_distance_within(shape, huge(1.0_wp), n, point, distance, normal)
  end subroutine signed_distance

  !> The same, but a point farther out than `limit` may get any distance above `limit` and any unit
  !> normal: what contact asks for, and cheaper for a mesh.
  pure subroutine signed_distance_within(shape, limit, n, point, distance, normal)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: limit                      !! [m]
    integer, intent(in) :: n
    real(wp), intent(in) :: point(3, n)                !! body axes [m]
    real(wp), intent(out) :: distance(n), normal(3, n) !! [m], [-]
    select case (shape%kind)
    case (shape_compound)
      call compound_distance(shape%parts, n, point, distance, normal)
    case (shape_mesh)
      call mesh_distance(shape%mesh, limit, n, point, distance, normal)
    case default
      call primitive_distance(shape%kind, shape%parts(1)%half, n, point, distance, normal)
    end select
  end subroutine signed_distance_within

  !> The point a + (b - a) fraction of each segment that is nearest to, or deepest in, the shape,
  !> its signed distance and the outward normal there. Where a whole piece of the segment is equally
  !> near, its middle (a mesh: of what it can tell). Exact for primitives, and outside of compounds
  !> and meshes; the deepest point in these is that of a part, or of a convex stretch.
  pure subroutine segment_distance_many(shape, n, a, b, fraction, distance, normal)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n
    real(wp), intent(in) :: a(3, n), b(3, n)           !! ends, body axes [m]
    real(wp), intent(out) :: fraction(n), distance(n)  !! 0 to 1 [-], [m]
    real(wp), intent(out) :: normal(3, n)
    call segment_distance_within(shape, huge(1.0_wp), n, a, b, fraction, distance, normal)
  end subroutine segment_distance_many

  !> The same, but a segment farther out than `limit` may get any distance above `limit`.
  pure subroutine segment_distance_within(shape, limit, n, a, b, fraction, distance, normal)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: limit                      !! [m]
    integer, intent(in) :: n
    real(wp), intent(in) :: a(3, n), b(3, n)           !! ends, body axes [m]
    real(wp), intent(out) :: fraction(n), distance(n)  !! 0 to 1 [-], [m]
    real(wp), intent(out) :: normal(3, n)
    select case (shape%kind)
    case (shape_compound)
      call compound_segments(shape%parts, n, a, b, fraction, distance, normal)
    case (shape_mesh)
      call mesh_segments(shape%mesh, limit, n, a, b, fraction, distance, normal)
    case default
      call primitive_segments(shape%kind, shape%parts(1)%half, n, a, b, fraction, distance, normal)
    end select
  end subroutine segment_distance_within

  !> The same for one segment; slower than many at once.
  pure subroutine segment_distance_one(shape, a, b, fraction, distance, normal)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: a(3), b(3)            !! ends, body axes [m]
    real(wp), intent(out) :: fraction, distance   !! 0 to 1 [-], [m]
    real(wp), intent(out) :: normal(3)
    real(wp) :: t(1), d(1)
    call segment_distance_many(shape, 1, a, b, t, d, normal)
    fraction = t(1)
    distance = d(1)
  end subroutine segment_distance_one

  !> First contact of nodes that move straight from p0 to p1 in body axes: the least fraction of
  !> the way at which the signed distance is `limit` or less; 0 for a node that starts there.
  !> A node that misses has hit false, fraction 1 and the distance at its nearest point.
  !> Primitives: Newton's method along the way, which never passes the first contact, because a
  !> convex solid's signed distance is convex along it; meshes: steps as long as the distance.
  !> One node after the other: meant for the few that could cross.
  pure subroutine swept_contact(shape, n, p0, p1, limit, fraction, hit, distance, normal)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: n
    real(wp), intent(in) :: p0(3, n), p1(3, n)         !! [m]
    real(wp), intent(in) :: limit                      !! [m]
    real(wp), intent(out) :: fraction(n)               !! [-]
    logical, intent(out) :: hit(n)
    real(wp), intent(out) :: distance(n), normal(3, n) !! at the fraction; [m], [-]
    real(wp) :: t, d(1)
    integer :: i, k
    do i = 1, n
      fraction(i) = 2.0_wp
      if (shape%kind == shape_mesh) then
        call mesh_sweep(shape%mesh, p0(:, i), p1(:, i), limit, fraction(i))
      else
        do k = 1, size(shape%parts)
          call swept_part(shape%parts(k), p0(:, i), p1(:, i), limit, t)
          fraction(i) = min(fraction(i), t)
        end do
      end if
      hit(i) = fraction(i) <= 1.0_wp
      if (hit(i)) then
        call signed_distance(shape, 1, p0(:, i) + (p1(:, i) - p0(:, i))*fraction(i), d, normal(:, i))
        distance(i) = d(1)
      else
        fraction(i) = 1.0_wp
        call segment_distance_one(shape, p0(:, i), p1(:, i), t, distance(i), normal(:, i))
      end if
    end do
  end subroutine swept_contact

  !> The same for one node and one convex part; fraction 2: none.
  pure subroutine swept_part(part, p0, p1, limit, fraction)
    type(primitive_t), intent(in) :: part
    real(wp), intent(in) :: p0(3), p1(3), limit
    real(wp), intent(out) :: fraction
    integer, parameter :: most_steps = 60  ! a grazing way (double root) gains one bit a step
    real(wp) :: first(3), last(3), v(3), nearest(1), d(1), g(3), rate
    integer :: k
    call to_part(part, 1, p0, first)
    call to_part(part, 1, p1, last)
    fraction = 2.0_wp
    call primitive_segments(part%kind, part%half, 1, first, last, nearest, d, g)
    if (d(1) > limit) return
    v = last - first
    fraction = 0.0_wp
    do k = 1, most_steps
      call primitive_distance(part%kind, part%half, 1, first + v*fraction, d, g)
      if (d(1) <= limit) return
      rate = g(1)*v(1) + g(2)*v(2) + g(3)*v(3)
      if (rate >= 0.0_wp) return
      if (fraction - (d(1) - limit)/rate <= fraction) return
      fraction = min(nearest(1), fraction - (d(1) - limit)/rate)
      if (fraction >= nearest(1)) return
    end do
  end subroutine swept_part

  !> Radius of a ball about the body's origin that holds the shape [m].
  pure real(wp) function shape_bounding_radius(shape) result(radius)
    type(shape_t), intent(in) :: shape
    real(wp) :: reach
    integer :: k
    radius = 0.0_wp
    if (shape%kind == shape_mesh) then
      radius = shape%mesh%radius
      return
    end if
    do k = 1, size(shape%parts)
      associate (part => shape%parts(k))
        select case (part%kind)
        case (shape_box)
          reach = sqrt(part%half(1)**2 + part%half(2)**2 + part%half(3)**2)
        case (shape_cylinder)
          reach = sqrt(part%half(1)**2 + part%half(3)**2)
        case default
          reach = part%half(1) + part%half(3)
        end select
        radius = max(radius, reach + sqrt(part%position(1)**2 + part%position(2)**2 + part%position(3)**2))
      end associate
    end do
  end function shape_bounding_radius

  !> Axis-parallel box in body axes that holds the shape, tight [m].
  pure subroutine shape_bounds(shape, lower, upper)
    type(shape_t), intent(in) :: shape
    real(wp), intent(out) :: lower(3), upper(3)
    real(wp) :: direction(3), reach
    integer :: k, axis
    if (shape%kind == shape_mesh) then
      lower = shape%mesh%lower
      upper = shape%mesh%upper
      return
    end if
    lower = huge(1.0_wp)
    upper = -huge(1.0_wp)
    do k = 1, size(shape%parts)
      associate (part => shape%parts(k))
        do axis = 1, 3
          direction = part%rotation(axis, :)
          reach = sum(direction*primitive_support(part%kind, part%half, direction))
          lower(axis) = min(lower(axis), part%position(axis) - reach)
          upper(axis) = max(upper(axis), part%position(axis) + reach)
        end do
      end associate
    end do
  end subroutine shape_bounds

  !> Volume [m3]; parts of a compound are taken not to overlap.
  pure real(wp) function shape_volume(shape) result(volume)
    type(shape_t), intent(in) :: shape
    integer :: k
    volume = 0.0_wp
    if (shape%kind == shape_mesh) then
      volume = surface_volume(shape%mesh%surface)
      return
    end if
    do k = 1, size(shape%parts)
      volume = volume + primitive_volume(shape%parts(k)%kind, shape%parts(k)%half)
    end do
  end function shape_volume

  !> Centroid of the uniform solid, body axes [m]; parts of a compound are taken not to overlap.
  pure function shape_centroid(shape) result(centroid)
    type(shape_t), intent(in) :: shape
    real(wp) :: centroid(3), share
    integer :: k
    centroid = 0.0_wp
    if (shape%kind == shape_mesh) then
      centroid = surface_centroid(shape%mesh%surface)
      return
    end if
    do k = 1, size(shape%parts)
      share = primitive_volume(shape%parts(k)%kind, shape%parts(k)%half)
      centroid = centroid + share*shape%parts(k)%position
    end do
    centroid = centroid/shape_volume(shape)
  end function shape_centroid

  !> Inertia tensor of the uniform solid per unit mass [m2], body axes, about its centroid
  !> (not about the body's origin); parts of a compound are taken not to overlap.
  pure function unit_inertia(shape) result(inertia)
    type(shape_t), intent(in) :: shape
    real(wp) :: inertia(3, 3), own(3), diagonal(3, 3), arm(3), centroid(3), share, total
    integer :: i, j, k
    inertia = 0.0_wp
    if (shape%kind == shape_mesh) then
      inertia = surface_inertia(shape%mesh%surface)
      return
    end if
    total = shape_volume(shape)
    centroid = shape_centroid(shape)
    do k = 1, size(shape%parts)
      associate (part => shape%parts(k))
        share = primitive_volume(part%kind, part%half)/total
        own = primitive_unit_inertia(part%kind, part%half)
        arm = part%position - centroid
        diagonal = 0.0_wp
        do i = 1, 3
          diagonal(i, i) = own(i)
        end do
        inertia = inertia + share*congruent(part%rotation, diagonal)
        do i = 1, 3
          inertia(i, i) = inertia(i, i) + share*(arm(1)**2 + arm(2)**2 + arm(3)**2)
          do j = 1, 3
            inertia(i, j) = inertia(i, j) - share*arm(i)*arm(j)
          end do
        end do
      end associate
    end do
  end function unit_inertia

  !> The largest extent along a body axis [m].
  pure real(wp) function shape_length(shape) result(length)
    type(shape_t), intent(in) :: shape
    real(wp) :: lower(3), upper(3)
    call shape_bounds(shape, lower, upper)
    length = maxval(upper - lower)
  end function shape_length

  !> Closed triangle surface for a picture, outward; a compound gives each part's.
  pure subroutine tessellate(shape, surface)
    type(shape_t), intent(in) :: shape
    type(surface_t), intent(out) :: surface
    type(surface_t) :: piece
    integer :: i, k
    if (shape%kind == shape_mesh) then
      surface = shape%mesh%surface
      return
    end if
    do k = 1, size(shape%parts)
      call tessellate_primitive(shape%parts(k)%kind, shape%parts(k)%half, piece)
      do i = 1, size(piece%vertex, 2)
        piece%vertex(:, i) = shape%parts(k)%position + multiply(shape%parts(k)%rotation, piece%vertex(:, i))
      end do
      call append_surface(surface, piece)
    end do
  end subroutine tessellate

  !> Up to `most` points on the convex hull, corners first of all: the farthest points along
  !> evenly spread directions, none twice. A box gives its eight corners.
  pure subroutine surface_samples(shape, most, point)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: most
    real(wp), allocatable, intent(out) :: point(:, :)  !! (3,count) body axes [m]
    real(wp), parameter :: golden = 2.39996322972865332_wp  ! angle of the sunflower [rad]
    real(wp) :: found(3, most), direction(3), best(3), z, near
    integer :: i, k, count
    near = 1.0e-6_wp*shape_length(shape)
    count = 0
    do i = 1, most
      z = 1.0_wp - (2.0_wp*real(i, wp) - 1.0_wp)/real(most, wp)
      direction = [sqrt(1.0_wp - z*z)*cos(golden*i), sqrt(1.0_wp - z*z)*sin(golden*i), z]
      best = farthest_point(shape, direction)
      do k = 1, count
        if (maxval(abs(found(:, k) - best)) < near) exit
      end do
      if (k <= count) cycle
      count = count + 1
      found(:, count) = best
    end do
    point = found(:, :count)
  end subroutine surface_samples

  !> The point of the shape farthest along a direction, body axes [m].
  pure function farthest_point(shape, direction) result(best)
    type(shape_t), intent(in) :: shape
    real(wp), intent(in) :: direction(3)
    real(wp) :: best(3), candidate(3), reach, far
    integer :: k, n
    far = -huge(1.0_wp)
    best = 0.0_wp
    if (shape%kind == shape_mesh) then
      n = size(shape%mesh%surface%vertex, 2)
    else
      n = size(shape%parts)
    end if
    do k = 1, n
      if (shape%kind == shape_mesh) then
        candidate = shape%mesh%surface%vertex(:, k)
      else
        associate (part => shape%parts(k))
          candidate = part%position + multiply(part%rotation, &
                      primitive_support(part%kind, part%half, multiply_transposed(part%rotation, direction)))
        end associate
      end if
      reach = direction(1)*candidate(1) + direction(2)*candidate(2) + direction(3)*candidate(3)
      if (reach <= far) cycle
      far = reach
      best = candidate
    end do
  end function farthest_point

end module castnet_shape
