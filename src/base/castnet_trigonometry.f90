!> Sine and cosine of our own. The system's differ in the last bit from one processor to
!> the next (it picks its code by what the processor can do); a run must not.
module castnet_trigonometry
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  implicit none
  private
  public :: sine_cosine

contains

  !> Sine and cosine by reduction to |r| <= pi/4 and Taylor's series, whose next terms are
  !> below 1e-19 there; products, sums and divisions only. Within two units in the last
  !> place for |angle| up to some thousand turns.
  pure subroutine sine_cosine(angle, sine, cosine)
    real(wp), intent(in) :: angle  !! [rad]
    real(wp), intent(out) :: sine, cosine
    real(wp), parameter :: half_pi_high = 1.57079632673412561417_wp       !! first 33 bits of pi/2: k times it is exact
    real(wp), parameter :: half_pi_low = 6.07710050650619224932e-11_wp    !! the rest
    real(wp) :: r, square, s, c
    integer :: k, n

    k = nint(angle/(0.5_wp*pi))
    r = (angle - k*half_pi_high) - k*half_pi_low
    square = r*r
    s = 0.0_wp
    c = 0.0_wp
    do n = 9, 1, -1
      s = (1.0_wp + s)*(-square/real(2*n*(2*n + 1), wp))
      c = (1.0_wp + c)*(-square/real((2*n - 1)*2*n, wp))
    end do
    s = r + r*s
    c = 1.0_wp + c
    select case (modulo(k, 4))
    case (0)
      sine = s
      cosine = c
    case (1)
      sine = c
      cosine = -s
    case (2)
      sine = -s
      cosine = -c
    case default
      sine = -c
      cosine = s
    end select
  end subroutine sine_cosine

end module castnet_trigonometry
