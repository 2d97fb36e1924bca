!> Solids for the geometry tests: shapes to try, points of their true surfaces and an
!> inside test, each written from the definition of the solid alone.
module solids
  use castnet_kinds, only: wp, i8
  use castnet_constants, only: pi
  use castnet_error, only: error_t
  use castnet_shape, only: shape_t, new_shape, new_compound
  implicit none
  private
  public :: solid_t, primitives, panel_union, uniform, uniform_vector, surface_point, is_inside

  !> One solid, or a union of placed ones, as the test knows it.
  type :: solid_t
    integer :: n = 0
    character(len=8) :: word(8) = ''
    real(wp) :: dimensions(3, 8) = 0.0_wp
    real(wp) :: position(3, 8) = 0.0_wp
    real(wp) :: attitude(4, 8) = 0.0_wp
    type(shape_t) :: shape
  end type solid_t

contains

  !> A deterministic stream of numbers in 0 to 1 (Lehmer, 2^31 - 1): good enough to scatter points.
  real(wp) function uniform(seed)
    integer(i8), intent(inout) :: seed
    seed = modulo(48271_i8*seed, 2147483647_i8)
    uniform = real(seed, wp)/2147483647.0_wp
  end function uniform

  function uniform_vector(seed, half) result(v)
    integer(i8), intent(inout) :: seed
    real(wp), intent(in) :: half
    real(wp) :: v(3)
    integer :: i
    do i = 1, 3
      v(i) = half*(2.0_wp*uniform(seed) - 1.0_wp)
    end do
  end function uniform_vector

  !> The four primitives, flat and slender ones among them.
  function primitives() result(list)
    type(solid_t) :: list(9)
    call single(list(1), 'box', [0.1_wp, 0.2_wp, 0.3_wp])
    call single(list(2), 'box', [0.5_wp, 0.4_wp, 0.0005_wp])
    call single(list(3), 'box', [0.3_wp, 0.3_wp, 0.3_wp])
    call single(list(4), 'cylinder', [0.2_wp, 0.5_wp, 0.0_wp])
    call single(list(5), 'cylinder', [0.5_wp, 0.01_wp, 0.0_wp])
    call single(list(6), 'cylinder', [0.02_wp, 0.6_wp, 0.0_wp])
    call single(list(7), 'sphere', [0.4_wp, 0.0_wp, 0.0_wp])
    call single(list(8), 'capsule', [0.2_wp, 0.3_wp, 0.0_wp])
    call single(list(9), 'capsule', [0.05_wp, 0.5_wp, 0.0_wp])
  end function primitives

  subroutine single(solid, word, dimensions)
    type(solid_t), intent(out) :: solid
    character(len=*), intent(in) :: word
    real(wp), intent(in) :: dimensions(3)
    type(error_t), allocatable :: error
    solid%n = 1
    solid%word(1) = word
    solid%dimensions(:, 1) = dimensions
    solid%attitude(:, 1) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    call new_shape(solid%shape, word, dimensions, error)
    if (allocated(error)) error stop 'solids: a primitive was refused'
  end subroutine single

  !> A satellite: a body, a turned panel that crosses it, a boom that touches, a ball on its end.
  function panel_union() result(solid)
    type(solid_t) :: solid
    type(error_t), allocatable :: error
    solid%n = 4
    solid%word(:4) = [character(len=8) :: 'box', 'box', 'cylinder', 'sphere']
    solid%dimensions(:, 1) = [0.4_wp, 0.2_wp, 0.2_wp]
    solid%dimensions(:, 2) = [0.1_wp, 0.9_wp, 0.02_wp]
    solid%dimensions(:, 3) = [0.05_wp, 0.3_wp, 0.0_wp]
    solid%dimensions(:, 4) = [0.12_wp, 0.0_wp, 0.0_wp]
    solid%position(:, 2) = [0.05_wp, 0.1_wp, 0.03_wp]
    solid%position(:, 3) = [0.0_wp, 0.0_wp, 0.25_wp]
    solid%position(:, 4) = [0.01_wp, 0.0_wp, 0.42_wp]
    solid%attitude(:, 1) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    solid%attitude(:, 2) = [0.9_wp, 0.1_wp, -0.2_wp, 0.3_wp]/sqrt(0.95_wp)
    solid%attitude(:, 3) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    solid%attitude(:, 4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    call new_compound(solid%shape, solid%word(:4), solid%dimensions(:, :4), solid%position(:, :4), &
                      solid%attitude(:, :4), error)
    if (allocated(error)) error stop 'solids: the compound was refused'
  end function panel_union

  !> A point of one part's surface, scattered over it; edges and rims come up too.
  function surface_point(solid, part, seed) result(p)
    type(solid_t), intent(in) :: solid
    integer, intent(in) :: part
    integer(i8), intent(inout) :: seed
    real(wp) :: p(3), h(3), angle, c, s, choice, z, length
    integer :: axis
    h = 0.5_wp*solid%dimensions(:, part)
    angle = 2.0_wp*pi*uniform(seed)
    c = cos(angle)
    s = sin(angle)
    choice = uniform(seed)
    p = 0.0_wp
    select case (solid%word(part))
    case ('box')
      p = h*uniform_vector(seed, 1.0_wp)
      axis = 1 + int(2.999_wp*choice)
      p(axis) = sign(h(axis), uniform(seed) - 0.5_wp)
      if (uniform(seed) < 0.1_wp) p(modulo(axis, 3) + 1) = sign(h(modulo(axis, 3) + 1), uniform(seed) - 0.5_wp)
    case ('cylinder')
      if (choice < 0.5_wp) then
        p = [h(1)*c, h(1)*s, h(2)*(2.0_wp*uniform(seed) - 1.0_wp)]
      else if (choice < 0.9_wp) then
        length = h(1)*sqrt(uniform(seed))
        p = [length*c, length*s, sign(h(2), uniform(seed) - 0.5_wp)]
      else
        p = [h(1)*c, h(1)*s, sign(h(2), uniform(seed) - 0.5_wp)]
      end if
    case ('sphere', 'capsule')
      z = 2.0_wp*uniform(seed) - 1.0_wp
      p = h(1)*[sqrt(1.0_wp - z*z)*c, sqrt(1.0_wp - z*z)*s, z]
      if (solid%word(part) == 'capsule') then
        p(3) = p(3) + sign(h(2), p(3))
        if (choice < 0.5_wp) p = [h(1)*c, h(1)*s, h(2)*(2.0_wp*uniform(seed) - 1.0_wp)]
      end if
    end select
    p = solid%position(:, part) + turned(solid%attitude(:, part), p)
  end function surface_point

  !> Is a point inside a part by more than `margin`? The solids' defining inequalities.
  logical function is_inside(solid, part, point, margin)
    type(solid_t), intent(in) :: solid
    integer, intent(in) :: part
    real(wp), intent(in) :: point(3), margin
    real(wp) :: p(3), h(3), q(4)
    h = 0.5_wp*solid%dimensions(:, part)
    q = solid%attitude(:, part)
    p = turned([q(1), -q(2), -q(3), -q(4)], point - solid%position(:, part))
    select case (solid%word(part))
    case ('box')
      is_inside = all(abs(p) < h - margin)
    case ('cylinder')
      is_inside = sqrt(p(1)**2 + p(2)**2) < h(1) - margin .and. abs(p(3)) < h(2) - margin
    case ('sphere')
      is_inside = sqrt(sum(p**2)) < h(1) - margin
    case default
      p(3) = p(3) - max(-h(2), min(h(2), p(3)))
      is_inside = sqrt(sum(p**2)) < h(1) - margin
    end select
  end function is_inside

  !> q v q*, by the textbook sum.
  function turned(q, v) result(u)
    real(wp), intent(in) :: q(4), v(3)
    real(wp) :: u(3), w(3)
    w = [q(3)*v(3) - q(4)*v(2), q(4)*v(1) - q(2)*v(3), q(2)*v(2) - q(3)*v(1)]
    u = (q(1)**2 - sum(q(2:4)**2))*v + 2.0_wp*sum(q(2:4)*v)*q(2:4) + 2.0_wp*q(1)*w
  end function turned

end module solids
