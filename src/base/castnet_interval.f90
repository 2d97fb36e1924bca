!> Confidence intervals of a probability from counted successes.
module castnet_interval
  use castnet_kinds, only: wp
  use castnet_rng, only: normal_quantile
  implicit none
  private
  public :: wilson_interval

contains

  !> Wilson's score interval: the p with |p_hat - p| <= z sqrt(p (1 - p)/n). Its coverage
  !> averages the nominal one down to small n and at p near 0 and 1, where the textbook
  !> interval has none. Source: Wilson 1927, JASA 22, 209; Brown, Cai & DasGupta 2001.
  pure subroutine wilson_interval(successes, runs, confidence, lower, upper)
    integer, intent(in) :: successes, runs
    real(wp), intent(in) :: confidence        !! for example 0.95
    real(wp), intent(out) :: lower, upper     !! 0 and 1 without a run
    real(wp) :: z, n, p, middle, half

    lower = 0.0_wp
    upper = 1.0_wp
    if (runs <= 0) return
    z = normal_quantile(0.5_wp*(1.0_wp + confidence))
    n = real(runs, wp)
    p = real(successes, wp)/n
    middle = (p + z*z/(2.0_wp*n))/(1.0_wp + z*z/n)
    half = z*sqrt(p*(1.0_wp - p)/n + z*z/(4.0_wp*n*n))/(1.0_wp + z*z/n)
    if (successes > 0) lower = max(0.0_wp, middle - half)
    if (successes < runs) upper = min(1.0_wp, middle + half)
  end subroutine wilson_interval

end module castnet_interval
