!> V7: one end of a straight cable is pulled at speed v.
!>
!> A step of tension v sqrt(EA mu_L) runs along it at sqrt(E/rho) (mu_L mass per length), and
!> doubles where it meets a fixed end. The lumped cable's front is as wide as its damping
!> and dispersion make it, so speeds are taken from momentum (plateau x time, exact for the
!> sum over the nodes) and from where the tension passes half its plateau.
module verify_pulled_cable
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_diagnostics, only: cable_tensions
  use castnet_model, only: model_t, method_rk4
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: chain, ready, fly, words
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_pulled_cable

contains

  subroutine run_verify_pulled_cable()
    call test_case('verify V7: a pulled cable has its plateau, its wave speed and its doubling', pulled)
  end subroutine run_verify_pulled_cable

  subroutine pulled()
    integer, parameter :: n = 400
    real(wp), parameter :: length = 1.0_wp, l0 = length/n, v = 1.3_wp
    real(wp), parameter :: area = 0.25_wp*pi*1.0e-6_wp, density = 1440.0_wp, modulus = 4.456e8_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: s(n + 1), mass(n + 1), tension(n), k, plateau, speed, h, t, front(2), passed(2), before(2), now(2), mean
    logical :: fixed(n + 1)
    integer :: i, j, station(2)

    plateau = v*sqrt(modulus*area*density*area)
    speed = sqrt(modulus/density)
    call expect_close(plateau/v, 0.6291_wp, 'plateau per speed', atol=0.5e-4_wp)
    call expect_close(speed, 556.28_wp, 'wave speed', atol=0.5e-2_wp)

    k = modulus*area/l0
    s = [(l0*i, i=0, n)]
    mass = density*area*l0
    mass([1, n + 1]) = 0.5_wp*mass(1)
    fixed = .false.
    fixed([1, n + 1]) = .true.
    ! Half of critical for a node between two cables: the front spreads but does not ring.
    call chain(s, [1.0_wp, 0.0_wp, 0.0_wp], mass, fixed, k, l0, 0.5_wp*sqrt(k*mass(2)), model, state)
    state%node_velocity(n + 1, 1) = v        ! a fixed node keeps the velocity it is given
    h = 0.5_wp/sqrt(k/mass(2))
    call ready(model, state, work, method_rk4, h)

    station = [3*n/4, n/4]
    passed = -1.0_wp
    before = 0.0_wp
    front = 0.0_wp
    do j = 1, nint(1.7_wp*length/speed/h)
      call fly(model, state, work, 1)
      t = state%time
      call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
      now = tension(station)
      do i = 1, 2
        if (passed(i) < 0.0_wp .and. now(i) >= 0.5_wp*plateau) &
          passed(i) = t - h*(now(i) - 0.5_wp*plateau)/(now(i) - before(i))
      end do
      before = now
      if (front(1) <= 0.0_wp .and. t >= 0.8_wp*length/speed) then
        ! Behind the front the plateau; the nodes carry the front's way x mass x v.
        mean = sum(tension(n/2:9*n/10))/(9*n/10 - n/2 + 1)
        front(1) = sum(mass(2:n)*state%node_velocity(2:n, 1))/(density*area*v) + 0.5_wp*l0
        call expect_close(mean, plateau, 'plateau', rtol=2.0e-3_wp)
        call expect_close(front(1), speed*t, 'front by momentum', rtol=2.0e-3_wp)
        call note('V7 plateau '//words(mean/v)//' N per m/s, front by momentum at '//words(front(1)/t)//' m/s')
      end if
    end do
    call expect_close((station(1) - station(2))*l0/(passed(2) - passed(1)), speed, 'speed between two stations', rtol=5.0e-3_wp)
    call note('V7 speed between two stations '//words((station(1) - station(2))*l0/(passed(2) - passed(1)))//' m/s')
    ! The wave is on its way back from the fixed end.
    mean = sum(tension(n/10:4*n/10))/(4*n/10 - n/10 + 1)
    call expect_close(mean, 2.0_wp*plateau, 'doubled at the fixed end', rtol=2.0e-3_wp)
    call expect_close(sum(tension(9*n/10:))/(n - 9*n/10 + 1), plateau, 'and not yet at the pulled end', rtol=2.0e-3_wp)
    call note('V7 at the fixed end '//words(mean/plateau)//' plateaus')
  end subroutine pulled

end module verify_pulled_cable
