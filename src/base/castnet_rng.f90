!> Random numbers of ours: the same ones on every machine, compiler and thread.
!>
!> xoshiro256** (Blackman & Vigna 2021, doi 10.1145/3460772) seeded through splitmix64
!> (Steele, Lea & Flood 2014, doi 10.1145/2660193.2660195). A generator is a plain value:
!> each run, each case, each thread holds its own.
!>
!> Fortran's integers are signed and must not overflow, so sums and products modulo 2**64
!> are put together from pieces that cannot. Normal deviates come from the inverse of the
!> normal distribution with + - * / and sqrt only: the libraries' logarithms differ in the
!> last bit between machines, and then so would every capture.
module castnet_rng
  use castnet_kinds, only: wp, i8
  implicit none
  private
  public :: rng_t, seed_rng, next_bits, uniform, normal, hash_seed
  public :: splitmix_next, normal_quantile

  !> The state of one generator. `s` is never all zero.
  type :: rng_t
    integer(i8) :: s(4) = [1_i8, 2_i8, 3_i8, 4_i8]
  end type rng_t

  integer(i8), parameter :: low_half = 4294967295_i8  !! 2**32 - 1

  ! 64-bit constants with the top bit set are no literals of a signed kind: high and low halves.
  integer(i8), parameter :: golden = ior(ishft(int(z'9E3779B9', i8), 32), int(z'7F4A7C15', i8))
  integer(i8), parameter :: mix_1 = ior(ishft(int(z'BF58476D', i8), 32), int(z'1CE4E5B9', i8))
  integer(i8), parameter :: mix_2 = ior(ishft(int(z'94D049BB', i8), 32), int(z'133111EB', i8))

contains

  !> Start a generator: four numbers of splitmix64 from the seed. Every seed is good, 0 too.
  pure subroutine seed_rng(rng, seed)
    type(rng_t), intent(out) :: rng
    integer(i8), intent(in) :: seed
    integer(i8) :: state
    integer :: i
    state = seed
    do i = 1, 4
      call splitmix_next(state, rng%s(i))
    end do
  end subroutine seed_rng

  !> The next 64 random bits of xoshiro256**.
  pure subroutine next_bits(rng, bits)
    type(rng_t), intent(inout) :: rng
    integer(i8), intent(out) :: bits
    integer(i8) :: carry
    bits = ishftc(times_5(rng%s(2)), 7)
    bits = add(bits, ishft(bits, 3))  ! times 9
    carry = ishft(rng%s(2), 17)
    rng%s(3) = ieor(rng%s(3), rng%s(1))
    rng%s(4) = ieor(rng%s(4), rng%s(2))
    rng%s(2) = ieor(rng%s(2), rng%s(3))
    rng%s(1) = ieor(rng%s(1), rng%s(4))
    rng%s(3) = ieor(rng%s(3), carry)
    rng%s(4) = ishftc(rng%s(4), 45)
  end subroutine next_bits

  !> A uniform deviate in the open interval (0, 1): (k + 1/2)/2**52, k = 0 .. 2**52 - 1,
  !> exact and symmetric about 1/2, so that neither 0 nor 1 ever comes.
  pure subroutine uniform(rng, deviate)
    type(rng_t), intent(inout) :: rng
    real(wp), intent(out) :: deviate
    integer(i8) :: bits
    call next_bits(rng, bits)
    deviate = (real(ishft(bits, -12), wp) + 0.5_wp)*2.0_wp**(-52)
  end subroutine uniform

  !> A standard normal deviate: one uniform number each, so that draws can be counted.
  pure subroutine normal(rng, deviate)
    type(rng_t), intent(inout) :: rng
    real(wp), intent(out) :: deviate
    real(wp) :: probability
    call uniform(rng, probability)
    deviate = normal_quantile(probability)
  end subroutine normal

  !> The seed of one case of a study: depends on nothing but the two numbers, so that a
  !> shard, a rerun or a longer study gives the same case the same seed. Never negative,
  !> because users paste it into a scene. Two cases of 2**20 share one with odds of 1e-7.
  pure integer(i8) function hash_seed(study_seed, case_index) result(seed)
    integer(i8), intent(in) :: study_seed, case_index
    integer(i8) :: state
    state = study_seed
    call splitmix_next(state, seed)
    state = add(seed, multiply(case_index, golden))
    call splitmix_next(state, seed)
    seed = ibclr(seed, 63)
  end function hash_seed

  !> One number of splitmix64; the state moves on.
  pure subroutine splitmix_next(state, bits)
    integer(i8), intent(inout) :: state
    integer(i8), intent(out) :: bits
    state = add(state, golden)
    bits = multiply(ieor(state, ishft(state, -30)), mix_1)
    bits = multiply(ieor(bits, ishft(bits, -27)), mix_2)
    bits = ieor(bits, ishft(bits, -31))
  end subroutine splitmix_next

  !> a + b modulo 2**64, from two sums of 32 bits.
  elemental integer(i8) function add(a, b)
    integer(i8), intent(in) :: a, b
    integer(i8) :: low, high
    low = iand(a, low_half) + iand(b, low_half)
    high = ishft(a, -32) + ishft(b, -32) + ishft(low, -32)
    add = ior(ishft(high, 32), iand(low, low_half))
  end function add

  !> 5 a modulo 2**64.
  elemental integer(i8) function times_5(a)
    integer(i8), intent(in) :: a
    times_5 = add(a, ishft(a, 2))
  end function times_5

  !> a b modulo 2**64, from products of 16 by 32 bits, which fit.
  elemental integer(i8) function multiply(a, b)
    integer(i8), intent(in) :: a, b
    integer(i8) :: b_low, b_high
    integer :: k
    b_low = iand(b, low_half)
    b_high = ishft(b, -32)
    multiply = 0
    do k = 0, 3
      multiply = add(multiply, ishft(ibits(a, 16*k, 16)*b_low, 16*k))
      if (k < 2) multiply = add(multiply, ishft(ibits(a, 16*k, 16)*b_high, 16*k + 32))
    end do
  end function multiply

  !> The x below which a standard normal deviate lies with this probability, 0 < p < 1,
  !> to 1e-15 relative. Rational approximations of Wichura 1988, algorithm AS 241
  !> (doi 10.2307/2347330), PPND16: one about the middle, two for the tails.
  elemental real(wp) function normal_quantile(probability) result(x)
    real(wp), intent(in) :: probability
    real(wp), parameter :: middle_top(8) = [3.3871328727963666080e0_wp, 1.3314166789178437745e2_wp, &
      1.9715909503065514427e3_wp, 1.3731693765509461125e4_wp, 4.5921953931549871457e4_wp, &
      6.7265770927008700853e4_wp, 3.3430575583588128105e4_wp, 2.5090809287301226727e3_wp]
    real(wp), parameter :: middle_bottom(8) = [1.0_wp, 4.2313330701600911252e1_wp, &
      6.8718700749205790830e2_wp, 5.3941960214247511077e3_wp, 2.1213794301586595867e4_wp, &
      3.9307895800092710610e4_wp, 2.8729085735721942674e4_wp, 5.2264952788528545610e3_wp]
    real(wp), parameter :: near_top(8) = [1.42343711074968357734e0_wp, 4.63033784615654529590e0_wp, &
      5.76949722146069140550e0_wp, 3.64784832476320460504e0_wp, 1.27045825245236838258e0_wp, &
      2.41780725177450611770e-1_wp, 2.27238449892691845833e-2_wp, 7.74545014278341407640e-4_wp]
    real(wp), parameter :: near_bottom(8) = [1.0_wp, 2.05319162663775882187e0_wp, &
      1.67638483018380384940e0_wp, 6.89767334985100004550e-1_wp, 1.48103976427480074590e-1_wp, &
      1.51986665636164571966e-2_wp, 5.47593808499534494600e-4_wp, 1.05075007164441684324e-9_wp]
    real(wp), parameter :: far_top(8) = [6.65790464350110377720e0_wp, 5.46378491116411436990e0_wp, &
      1.78482653991729133580e0_wp, 2.96560571828504891230e-1_wp, 2.65321895265761230930e-2_wp, &
      1.24266094738807843860e-3_wp, 2.71155556874348757815e-5_wp, 2.01033439929228813265e-7_wp]
    real(wp), parameter :: far_bottom(8) = [1.0_wp, 5.99832206555887937690e-1_wp, &
      1.36929880922735805310e-1_wp, 1.48753612908506148525e-2_wp, 7.86869131145613259100e-4_wp, &
      1.84631831751005468180e-5_wp, 1.42151175831644588870e-7_wp, 2.04426310338993978564e-15_wp]
    real(wp) :: from_middle, r
    from_middle = probability - 0.5_wp
    if (abs(from_middle) <= 0.425_wp) then
      r = 0.180625_wp - from_middle*from_middle
      x = from_middle*polynomial(middle_top, r)/polynomial(middle_bottom, r)
      return
    end if
    r = sqrt(-logarithm(min(probability, 1.0_wp - probability)))
    if (r <= 5.0_wp) then
      x = polynomial(near_top, r - 1.6_wp)/polynomial(near_bottom, r - 1.6_wp)
    else
      x = polynomial(far_top, r - 5.0_wp)/polynomial(far_bottom, r - 5.0_wp)
    end if
    if (from_middle < 0.0_wp) x = -x
  end function normal_quantile

  !> c(1) + c(2) x + ... by Horner's rule.
  pure real(wp) function polynomial(c, x)
    real(wp), intent(in) :: c(:), x
    integer :: i
    polynomial = c(size(c))
    do i = size(c) - 1, 1, -1
      polynomial = polynomial*x + c(i)
    end do
  end function polynomial

  !> Natural logarithm of a positive normal number: x = m 2**e with sqrt(1/2) <= m < sqrt 2,
  !> log m = 2 (z + z**3/3 + z**5/5 + ...), z = (m - 1)/(m + 1), |z| < 0.1716: the first
  !> term left out, z**23/23, is below 1e-18.
  elemental real(wp) function logarithm(x)
    real(wp), intent(in) :: x
    real(wp), parameter :: log_2 = 0.693147180559945309417232121458176568_wp
    real(wp) :: m, z, z2, series
    integer :: e, k
    e = exponent(x)
    m = fraction(x)
    if (m < 0.707106781186547524_wp) then
      m = 2.0_wp*m
      e = e - 1
    end if
    z = (m - 1.0_wp)/(m + 1.0_wp)
    z2 = z*z
    series = 1.0_wp/21.0_wp
    do k = 19, 1, -2
      series = series*z2 + 1.0_wp/real(k, wp)
    end do
    logarithm = real(e, wp)*log_2 + 2.0_wp*z*series
  end function logarithm

end module castnet_rng
