!> V6: two masses fly apart and snap their slack cable taut at relative speed v.
!>
!> With reduced mass mu, omega = sqrt(k/mu), z = c/(2 sqrt(k mu)):
!>   without damping T_max = v sqrt(k mu), taut for pi/omega, rebound at v;
!>   damped, unclamped: taut for pi/(omega sqrt(1 - z^2)), rebound exp(-pi z/sqrt(1 - z^2));
!>   clamped, tension never negative: rebound exp(-z (pi - 2 asin z)/sqrt(1 - z^2)).
!> The step does not know when the cable becomes taut: a force that is wrong over part of a
!> step, c v there, changes the rebound by up to 2 z omega h of v.
module verify_snap
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_diagnostics, only: cable_tensions
  use castnet_model, only: model_t, method_rk4, method_midpoint
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: two_masses, ready, fly, mechanical_energy, words
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_snap

  real(wp), parameter :: mass(2) = [0.03_wp, 0.011_wp], k = 4000.0_wp, l0 = 0.1_wp, v = 1.8_wp
  integer, parameter :: methods(2) = [method_rk4, method_midpoint]
  character(len=8), parameter :: method_name(2) = ['rk4     ', 'midpoint']

contains

  subroutine run_verify_snap()
    call test_case('verify V6: the closed forms give the printed rebounds', printed_numbers)
    call test_case('verify V6: peak tension and duration of an undamped snap', undamped)
    call test_case('verify V6: rebound of a damped snap, clamped and unclamped', rebounds)
  end subroutine run_verify_snap

  real(wp) function reduced_mass()
    reduced_mass = mass(1)*mass(2)/(mass(1) + mass(2))
  end function reduced_mass

  real(wp) function rebound(z, clamp)
    real(wp), intent(in) :: z
    logical, intent(in) :: clamp
    rebound = exp(-pi*z/sqrt(1.0_wp - z*z))
    if (clamp) rebound = exp(-z*(pi - 2.0_wp*asin(z))/sqrt(1.0_wp - z*z))
  end function rebound

  subroutine printed_numbers()
    call expect_close(rebound(0.106_wp, .false.), 0.71541_wp, 'unclamped', atol=0.5e-5_wp)
    call expect_close(rebound(0.106_wp, .true.), 0.73180_wp, 'clamped', atol=0.5e-5_wp)
  end subroutine printed_numbers

  !> One snap, from `late` steps before taut to slack again.
  subroutine snap(method, z, clamp, wh, late, ratio, peak, duration, ledger)
    integer, intent(in) :: method
    real(wp), intent(in) :: z, wh, late      !! damping, omega h, when it becomes taut in a step [-]
    logical, intent(in) :: clamp
    real(wp), intent(out) :: ratio           !! speed after over speed before
    real(wp), intent(out) :: peak            !! largest tension seen at a step's end [N]
    real(wp), intent(out) :: duration        !! steps that end taut, times h [s]
    real(wp), intent(out) :: ledger          !! energy + dissipated - start, of the start
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, h, tension(1), length, start
    integer :: i
    w = sqrt(k/reduced_mass())
    h = wh/w
    call two_masses(mass, k, l0, 2.0_wp*z*sqrt(k*reduced_mass()), clamp, (3.0_wp + late)*v*h, v, model, state)
    start = mechanical_energy(model, state)
    call ready(model, state, work, method, h)
    peak = 0.0_wp
    duration = 0.0_wp
    do i = 1, ceiling(1.5_wp*pi/wh) + 10
      call fly(model, state, work, 1)
      length = state%node_position(2, 1) - state%node_position(1, 1)
      if (length > l0) duration = duration + h
      call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
      peak = max(peak, tension(1))
    end do
    call expect(length < l0, 'slack again')
    ratio = (state%node_velocity(1, 1) - state%node_velocity(2, 1))/v
    ledger = (mechanical_energy(model, state) + state%ledger%dissipated)/start - 1.0_wp
  end subroutine snap

  !> Undamped: the tension is continuous when the cable becomes taut, its rate is not: a
  !> part t of a step is integrated with the force of the wrong side, which changes the
  !> speed by at most k v h^2/mu, (omega h)^2 of v.
  subroutine undamped()
    real(wp), parameter :: wh = 0.01_wp
    real(wp) :: ratio, peak, duration, ledger, w, worst(3)
    integer :: i, j
    w = sqrt(k/reduced_mass())
    do i = 1, 2
      worst = 0.0_wp
      do j = 0, 7
        call snap(methods(i), 0.0_wp, .true., wh, j/8.0_wp, ratio, peak, duration, ledger)
        worst = max(worst, abs([ratio - 1.0_wp, peak/(v*sqrt(k*reduced_mass())) - 1.0_wp, duration*w/pi - 1.0_wp]))
        call expect_close(ledger, 0.0_wp, 'energy', atol=2.0_wp*wh**2)
      end do
      call note('V6 undamped, '//trim(method_name(i))//', omega h = 0.01: rebound, peak, duration off by '// &
                words(worst(1))//' '//words(worst(2))//' '//words(worst(3)))
      call expect(worst(1) <= wh**2, 'rebound')
      call expect(worst(2) <= wh**2, 'peak tension')
      call expect(worst(3) <= wh/pi, 'duration, to one step')
    end do
  end subroutine undamped

  !> Within 2 z omega h of both closed forms, whenever in a step it becomes taut; far enough
  !> apart that the two laws are told apart.
  subroutine rebounds()
    real(wp), parameter :: z(3) = [0.05_wp, 0.106_wp, 0.4_wp], wh(2) = [0.02_wp, 0.005_wp]
    real(wp) :: ratio, peak, duration, ledger, reference, worst, worst_ledger
    integer :: i, j, iz, ih, c
    do i = 1, 2
      do iz = 1, size(z)
        do ih = 1, size(wh)
          do c = 1, 2
            reference = rebound(z(iz), c == 1)
            worst = 0.0_wp
            worst_ledger = 0.0_wp
            do j = 0, 7
              call snap(methods(i), z(iz), c == 1, wh(ih), j/8.0_wp, ratio, peak, duration, ledger)
              worst = max(worst, abs(ratio - reference))
              worst_ledger = max(worst_ledger, abs(ledger))
            end do
            call expect(worst <= 2.0_wp*z(iz)*wh(ih), 'rebound within 2 z omega h')
            ! The rule's own stages: only the steps in which the law changes spoil its order.
            call expect(worst_ledger <= wh(ih)**2, 'ledger within (omega h)^2')
            if (iz == 2) call note('V6 '//trim(method_name(i))//', z = 0.106, omega h = '//words(wh(ih))// &
                merge(', clamped:   ', ', unclamped: ', c == 1)//words(reference)//', off by '//words(worst)// &
                ' of '//words(2.0_wp*z(iz)*wh(ih))//', ledger '//words(worst_ledger))
          end do
        end do
      end do
    end do
  end subroutine rebounds

end module verify_snap
