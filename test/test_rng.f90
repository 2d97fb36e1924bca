!> The generator against published numbers and against the distributions it claims.
module test_rng
  use castnet_kinds, only: wp, i8
  use castnet_rng, only: rng_t, seed_rng, next_bits, uniform, normal, hash_seed, splitmix_next, normal_quantile
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_rng

contains

  subroutine run_test_rng()
    call test_case('rng: splitmix64 gives the published numbers', splitmix_vectors)
    call test_case('rng: xoshiro256** gives the published numbers', xoshiro_vectors)
    call test_case('rng: a seeded stream, and seeds of cases, stay what they are', seeded_vectors)
    call test_case('rng: uniform deviates fill (0,1) evenly', uniform_moments)
    call test_case('rng: the quantile inverts the normal distribution', quantile_inverts)
    call test_case('rng: normal deviates have the moments and the distribution', normal_distribution)
    call test_case('rng: neighbouring seeds and cases are unrelated', seeds_differ)
  end subroutine run_test_rng

  !> A 64-bit number from its two halves.
  pure integer(i8) function word(high, low)
    integer(i8), intent(in) :: high, low
    word = ior(ishft(high, 32), low)
  end function word

  !> Seed 1234567: the list that implementations of splitmix64 are checked by.
  subroutine splitmix_vectors()
    integer(i8) :: state, bits, expected(5)
    integer :: i
    expected = [word(int(z'599ED017', i8), int(z'FB08FC85', i8)), word(int(z'2C73F084', i8), int(z'58540FA5', i8)), &
                word(int(z'883EBCE5', i8), int(z'A3F27C77', i8)), word(int(z'3FBEF740', i8), int(z'E9177B3F', i8)), &
                word(int(z'E3B83467', i8), int(z'08CB5ECD', i8))]
    state = 1234567_i8
    do i = 1, 5
      call splitmix_next(state, bits)
      call expect(bits == expected(i), 'a number of splitmix64')
    end do
  end subroutine splitmix_vectors

  !> State 1, 2, 3, 4: the list of the reference implementation.
  subroutine xoshiro_vectors()
    type(rng_t) :: rng
    integer(i8) :: bits, expected(10)
    integer :: i
    expected = [11520_i8, 0_i8, 1509978240_i8, 1215971899390074240_i8, 1216172134540287360_i8, 607988272756665600_i8, &
                word(int(z'E071C3C2', i8), int(z'E143F089', i8)), 8476171486693032832_i8, &
                word(int(z'9309685B', i8), int(z'465C23F9', i8)), 2904607092377533576_i8]
    do i = 1, 10
      call next_bits(rng, bits)
      call expect(bits == expected(i), 'a number of xoshiro256**')
    end do
  end subroutine xoshiro_vectors

  !> Computed with integers of any size (Python), so that no wrap of ours is in them.
  subroutine seeded_vectors()
    type(rng_t) :: rng
    integer(i8) :: bits
    integer :: i
    call seed_rng(rng, 42_i8)
    do i = 1, 1000
      call next_bits(rng, bits)
    end do
    call expect(bits == word(int(z'8DE5848C', i8), int(z'61AB8968', i8)), 'number 1000 of seed 42')
    call expect(hash_seed(1_i8, 1_i8) == 8182315847015789038_i8, 'seed of case 1 of study 1')
    call expect(hash_seed(1_i8, 2_i8) == 834844254806117752_i8, 'seed of case 2 of study 1')
    call expect(hash_seed(-5_i8, 0_i8) == 3253266212261548216_i8, 'seed of case 0 of study -5')
    call expect(hash_seed(4611686018427387904_i8, 12345678901_i8) == 4063626584376743767_i8, 'seed of a large case')
  end subroutine seeded_vectors

  !> Mean 1/2 and variance 1/12 within 5 standard errors; no bin of 100 off by more.
  subroutine uniform_moments()
    integer, parameter :: n = 1000000
    type(rng_t) :: rng
    real(wp) :: u, mean, square
    integer :: i, bin(100), k
    call seed_rng(rng, 2018_i8)
    mean = 0.0_wp; square = 0.0_wp; bin = 0
    do i = 1, n
      call uniform(rng, u)
      if (.not. (u > 0.0_wp .and. u < 1.0_wp)) call expect(.false., 'inside (0,1)')
      mean = mean + u
      square = square + (u - 0.5_wp)**2
      k = 1 + int(100.0_wp*u)
      bin(k) = bin(k) + 1
    end do
    call expect_close(mean/n, 0.5_wp, 'mean', atol=5.0_wp*sqrt(1.0_wp/12.0_wp/n))
    call expect_close(square/n, 1.0_wp/12.0_wp, 'variance', atol=5.0_wp*sqrt(1.0_wp/180.0_wp/n))
    call expect(maxval(abs(bin - n/100)) < 5*nint(sqrt(n/100.0_wp)), 'even bins')
  end subroutine uniform_moments

  !> Phi(x) = erfc(-x/sqrt 2)/2 of the quantile is the probability again. An error dx of x
  !> changes Phi by a relative (|x| + 1/|x|) dx at most: 1e-15 |x| (|x| + 1) and erfc's own.
  subroutine quantile_inverts()
    real(wp) :: p, x, worst
    integer :: i
    worst = 0.0_wp
    do i = 1, 4000
      p = 0.5_wp*10.0_wp**(-real(i, wp)/260.0_wp)
      x = normal_quantile(p)
      worst = max(worst, abs(0.5_wp*erfc(-x/sqrt(2.0_wp))/p - 1.0_wp)/(1.0_wp + x*x))
      if (p > 1.0e-6_wp) call expect_close(normal_quantile(1.0_wp - p), -x, 'the other tail', atol=1.0e-9_wp)
    end do
    call expect_close(worst, 0.0_wp, 'relative error of the probability', atol=4.0e-15_wp)
    call expect_close(normal_quantile(0.5_wp), 0.0_wp, 'median', atol=0.0_wp)
    call expect_close(normal_quantile(0.3_wp), -0.5244005127080407_wp, 'x(0.3)', rtol=1.0e-15_wp)
    call expect_close(normal_quantile(0.999_wp), 3.090232306167813_wp, 'x(0.999)', rtol=1.0e-15_wp)
    call expect_close(normal_quantile(1.0e-12_wp), -7.034483825301131_wp, 'x(1e-12)', rtol=1.0e-15_wp)
  end subroutine quantile_inverts

  !> Moments within 5 standard errors; Kolmogorov-Smirnov distance against erfc below the
  !> one that chance exceeds once in a million, 2.69/sqrt(n), from a histogram fine enough
  !> that its edges add nothing.
  subroutine normal_distribution()
    integer, parameter :: n = 400000, n_bin = 4000
    real(wp), parameter :: span = 6.0_wp
    type(rng_t) :: rng
    real(wp) :: x, moment(4), x_edge, distance
    integer :: i, k, bin(0:n_bin + 1), below
    call seed_rng(rng, 7_i8)
    moment = 0.0_wp; bin = 0
    do i = 1, n
      call normal(rng, x)
      do k = 1, 4
        moment(k) = moment(k) + x**k
      end do
      k = max(0, min(n_bin + 1, 1 + floor((x + span)/(2.0_wp*span)*n_bin)))
      bin(k) = bin(k) + 1
    end do
    moment = moment/n
    call expect_close(moment(1), 0.0_wp, 'mean', atol=5.0_wp*sqrt(1.0_wp/n))
    call expect_close(moment(2), 1.0_wp, 'second moment', atol=5.0_wp*sqrt(2.0_wp/n))
    call expect_close(moment(3), 0.0_wp, 'third moment', atol=5.0_wp*sqrt(15.0_wp/n))
    call expect_close(moment(4), 3.0_wp, 'fourth moment', atol=5.0_wp*sqrt(96.0_wp/n))
    below = bin(0)
    distance = 0.0_wp
    do k = 1, n_bin
      below = below + bin(k)
      x_edge = -span + 2.0_wp*span*k/n_bin
      distance = max(distance, abs(real(below, wp)/n - 0.5_wp*erfc(-x_edge/sqrt(2.0_wp))))
    end do
    call expect_close(distance, 0.0_wp, 'Kolmogorov-Smirnov distance', atol=2.69_wp/sqrt(real(n, wp)))
  end subroutine normal_distribution

  !> First deviates of 10,000 neighbouring cases: uncorrelated from one to the next.
  subroutine seeds_differ()
    integer, parameter :: n = 10000
    type(rng_t) :: rng
    real(wp) :: u(n), correlation
    integer :: i
    do i = 1, n
      call seed_rng(rng, hash_seed(3_i8, int(i, i8)))
      call uniform(rng, u(i))
    end do
    correlation = 0.0_wp
    do i = 1, n - 1
      correlation = correlation + (u(i) - 0.5_wp)*(u(i + 1) - 0.5_wp)
    end do
    call expect_close(12.0_wp*correlation/n, 0.0_wp, 'correlation of neighbours', atol=5.0_wp/sqrt(real(n, wp)))
    call expect(hash_seed(3_i8, 1_i8) /= hash_seed(4_i8, 1_i8), 'studies differ')
  end subroutine seeds_differ

end module test_rng
