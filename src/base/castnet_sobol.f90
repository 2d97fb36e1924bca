!> Points of Sobol's sequence and of Latin hypercubes.
module castnet_sobol
  use castnet_kinds, only: wp, i8
  use castnet_rng, only: rng_t, seed_rng, uniform
  implicit none
  private
  public :: sobol_point, latin_hypercube, sobol_dimensions

  integer, parameter :: sobol_dimensions = 21  !! most varied keys of a Sobol design
  integer, parameter :: bits = 30

  !> Primitive polynomials (degree s, inner coefficients a) and initial direction numbers of
  !> dimensions 2 to 21. Source: S. Joe & F. Y. Kuo, SIAM J. Sci. Comput. 30, 2635 (2008),
  !> their table new-joe-kuo-6.
  integer, parameter :: degree_of(2:21) = [1, 2, 3, 3, 4, 4, 5, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 7, 7]
  integer, parameter :: inner(2:21) = [0, 1, 1, 2, 1, 4, 2, 4, 7, 11, 13, 14, 1, 13, 16, 19, 22, 25, 1, 4]
  integer, parameter :: initial(7, 2:21) = reshape([ &
    1, 0, 0, 0, 0, 0, 0, &
    1, 3, 0, 0, 0, 0, 0, &
    1, 3, 1, 0, 0, 0, 0, &
    1, 1, 1, 0, 0, 0, 0, &
    1, 1, 3, 3, 0, 0, 0, &
    1, 3, 5, 13, 0, 0, 0, &
    1, 1, 5, 5, 17, 0, 0, &
    1, 1, 5, 5, 5, 0, 0, &
    1, 1, 7, 11, 19, 0, 0, &
    1, 1, 5, 1, 1, 0, 0, &
    1, 1, 1, 3, 11, 0, 0, &
    1, 3, 5, 5, 31, 0, 0, &
    1, 3, 3, 9, 7, 49, 0, &
    1, 1, 1, 15, 21, 21, 0, &
    1, 3, 1, 13, 27, 49, 0, &
    1, 1, 1, 15, 7, 5, 0, &
    1, 3, 1, 15, 13, 25, 0, &
    1, 1, 5, 5, 19, 61, 0, &
    1, 3, 7, 11, 23, 15, 103, &
    1, 3, 7, 13, 13, 15, 69], [7, 20])

contains

  !> Point number `index` (from 0) of the sequence in [0, 1)^n, in Gray code order as usual.
  pure subroutine sobol_point(index, point)
    integer, intent(in) :: index
    real(wp), intent(out) :: point(:)  !! (n), n <= sobol_dimensions
    integer :: gray, j, k, x, v(bits)

    gray = ieor(index, ishft(index, -1))
    do j = 1, size(point)
      call directions(j, v)
      x = 0
      do k = 1, bits
        if (btest(gray, k - 1)) x = ieor(x, v(k))
      end do
      point(j) = real(x, wp)/2.0_wp**bits
    end do
  end subroutine sobol_point

  !> Direction numbers of one dimension, scaled by 2**bits.
  pure subroutine directions(dimension, v)
    integer, intent(in) :: dimension
    integer, intent(out) :: v(bits)
    integer :: s, k, i

    if (dimension == 1) then
      do k = 1, bits
        v(k) = ishft(1, bits - k)
      end do
      return
    end if
    s = degree_of(dimension)
    do k = 1, s
      v(k) = ishft(initial(k, dimension), bits - k)
    end do
    do k = s + 1, bits
      v(k) = ieor(v(k - s), ishft(v(k - s), -s))
      do i = 1, s - 1
        if (btest(inner(dimension), s - 1 - i)) v(k) = ieor(v(k), v(k - i))
      end do
    end do
  end subroutine directions

  !> A Latin hypercube: along each axis one point in each of the n equal intervals.
  pure subroutine latin_hypercube(seed, point)
    integer(i8), intent(in) :: seed
    real(wp), intent(out) :: point(:, :)  !! (dimensions, n) in (0, 1)
    type(rng_t) :: rng
    real(wp) :: u
    integer :: order(size(point, 2)), i, j, k, n, swap

    n = size(point, 2)
    call seed_rng(rng, seed)
    do j = 1, size(point, 1)
      do i = 1, n
        order(i) = i
      end do
      do i = n, 2, -1
        call uniform(rng, u)
        k = min(i, int(u*i) + 1)
        swap = order(i)
        order(i) = order(k)
        order(k) = swap
      end do
      do i = 1, n
        call uniform(rng, u)
        point(j, i) = (real(order(i) - 1, wp) + u)/real(n, wp)
      end do
    end do
  end subroutine latin_hypercube

end module castnet_sobol
