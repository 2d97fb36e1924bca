!> V3, V4: small vibrations of a chain of N masses between walls, and the stability of the
!> methods on them.
!>
!> omega_n = 2 sqrt(k/m) sin(n pi/(2 (N + 1))), mode shape sin(i n pi/(N + 1)); transverse
!> with k replaced by T/l of the pre-tensioned chain. In time:
!>   rk4: with z = h omega, amplitude^2 per step 1 - z^6/72 + z^8/576, phase lag z^5/120;
!>        stable to 2 sqrt(2).
!>   midpoint (drift-kick-drift): phase lead z^3/24 per step, stable to 2.
module verify_chain
  use castnet_kinds, only: wp
  use castnet_constants, only: pi
  use castnet_model, only: model_t, method_rk4, method_midpoint
  use castnet_stable_step, only: spectrum_t, net_spectrum, largest_stable_step, amplification
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: chain, ready, fly, words
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_chain

  integer, parameter :: n = 9                        !! masses between the walls
  real(wp), parameter :: k = 40.0_wp, m = 0.1_wp     !! [N/m], [kg]
  real(wp), parameter :: l = 0.5_wp, l0 = 0.4_wp     !! between the masses, natural [m]
  real(wp), parameter :: x_axis(3) = [1.0_wp, 0.0_wp, 0.0_wp]
  integer, parameter :: methods(2) = [method_rk4, method_midpoint]
  character(len=8), parameter :: method_name(2) = ['rk4     ', 'midpoint']

contains

  subroutine run_verify_chain()
    call test_case('verify V3: longitudinal frequencies of a chain', longitudinal)
    call test_case('verify V3: transverse frequencies of a chain', transverse)
    call test_case('verify V4: amplitude of rk4 per step', amplitude_per_step)
    call test_case('verify V3: the stability limits 2 sqrt(2) and 2 are where they should be', stability_limits)
    call test_case('verify V3: with damping the measured limit is the predicted one', damped_limits)
  end subroutine run_verify_chain

  real(wp) function frequency(mode, stiffness)
    integer, intent(in) :: mode
    real(wp), intent(in) :: stiffness
    frequency = 2.0_wp*sqrt(stiffness/m)*sin(mode*pi/(2.0_wp*(n + 1)))
  end function frequency

  real(wp) function shape(i, mode)
    integer, intent(in) :: i, mode
    shape = sin(i*mode*pi/(n + 1))
  end function shape

  !> The chain in its equilibrium, displaced by `amplitude` of a mode along axis c.
  subroutine displaced_chain(mode, c, amplitude, damping, model, state)
    integer, intent(in) :: mode, c
    real(wp), intent(in) :: amplitude, damping
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    real(wp) :: s(n + 2), mass(n + 2)
    logical :: fixed(n + 2)
    integer :: i
    s = [(l*i, i=0, n + 1)]
    mass = m
    fixed = .false.
    fixed([1, n + 2]) = .true.
    call chain(s, x_axis, mass, fixed, k, l0, damping, model, state)
    do i = 1, n
      state%node_position(i + 1, c) = state%node_position(i + 1, c) + amplitude*shape(i, mode)
    end do
  end subroutine displaced_chain

  !> How much of a mode is in the state: displacement and velocity.
  function part_of(state, mode, c) result(part)
    type(state_t), intent(in) :: state
    integer, intent(in) :: mode, c
    real(wp) :: part(2), rest
    integer :: i
    part = 0.0_wp
    do i = 1, n
      rest = merge(l*i, 0.0_wp, c == 1)
      part = part + [state%node_position(i + 1, c) - rest, state%node_velocity(i + 1, c)]*shape(i, mode)*2.0_wp/(n + 1)
    end do
  end function part_of

  !> Every mode over five of its periods. Along the chain everything is linear as long as it
  !> is taut, so what differs from A cos(omega t) is the method's phase and amplitude, whose
  !> size is known; the next order of z bounds the rest.
  subroutine longitudinal()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, z, part(2), phase, expected, measured, worst(2)
    integer :: mode, i, steps
    real(wp), parameter :: amplitude = 0.02_wp
    worst = 0.0_wp
    do i = 1, 2
      do mode = 1, n
        w = frequency(mode, k)
        steps = 500
        z = 5.0_wp*2.0_wp*pi/steps
        call displaced_chain(mode, 1, amplitude, 0.0_wp, model, state)
        call ready(model, state, work, methods(i), z/w)
        call fly(model, state, work, steps)
        part = part_of(state, mode, 1)
        ! After whole periods the phase is the method's error alone.
        phase = atan2(-part(2)/w, part(1))
        expected = steps*merge(-z**5/120.0_wp, z**3/24.0_wp, i == 1)
        call expect_close(phase, expected, trim(method_name(i))//': phase', rtol=0.02_wp)
        measured = w*(1.0_wp + (phase - expected)/(steps*z))
        worst(i) = max(worst(i), abs(measured/w - 1.0_wp))
        call expect_close(measured, w, trim(method_name(i))//': frequency', rtol=1.0e-6_wp)
        call expect(maxval(abs(state%node_position(:, 2:))) <= 0.0_wp, 'nothing sideways')
      end do
      call note('V3 longitudinal, '//trim(method_name(i))//': frequencies within '//words(worst(i))//' after the phase error')
    end do
  end subroutine longitudinal

  !> Sideways by 1e-5 of a mesh: the stretch that this makes changes the frequency by less
  !> than 1e-9; T = k (l - l0).
  subroutine transverse()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, z, part(2), phase, expected, measured, worst
    integer :: mode, c, steps
    worst = 0.0_wp
    do c = 2, 3
      do mode = 1, n
        w = frequency(mode, k*(l - l0)/l)
        ! The longitudinal limit binds: 2 sqrt(k/m) h < 2 sqrt(2) for every mode.
        steps = 2000
        z = 5.0_wp*2.0_wp*pi/steps
        call displaced_chain(mode, c, 1.0e-5_wp*l, 0.0_wp, model, state)
        call ready(model, state, work, method_rk4, z/w)
        call fly(model, state, work, steps)
        part = part_of(state, mode, c)
        phase = atan2(-part(2)/w, part(1))
        expected = -steps*z**5/120.0_wp
        measured = w*(1.0_wp + (phase - expected)/(steps*z))
        worst = max(worst, abs(measured/w - 1.0_wp))
        call expect_close(measured, w, 'frequency', rtol=2.0e-9_wp)
      end do
    end do
    call note('V3 transverse: frequencies within '//words(worst))
  end subroutine transverse

  !> omega^2 x^2 + v^2 of a mode is multiplied by the polynomial in every step, exactly.
  subroutine amplitude_per_step()
    real(wp), parameter :: z(6) = [0.1_wp, 0.5_wp, 1.0_wp, 2.0_wp, 2.6_wp, 2.9_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, before, now, part(2)
    integer :: i, j
    integer, parameter :: mode = 6
    w = frequency(mode, k)
    do i = 1, size(z)
      ! Small enough to stay taut at |R|^2 = 1.9 a step; large against round-off of l.
      call displaced_chain(mode, 1, 1.0e-3_wp, 0.0_wp, model, state)
      call ready(model, state, work, method_rk4, z(i)/w)
      before = (w*1.0e-3_wp)**2
      do j = 1, 5
        call fly(model, state, work, 1)
        part = part_of(state, mode, 1)
        now = (w*part(1))**2 + part(2)**2
        call expect_close(now/before, 1.0_wp - z(i)**6/72.0_wp + z(i)**8/576.0_wp, 'amplitude^2 per step', atol=1.0e-11_wp)
        before = now
      end do
    end do
    call note('V4 at z = 2.9: '//words(now/before*(1.0_wp - 2.9_wp**6/72.0_wp + 2.9_wp**8/576.0_wp)))
  end subroutine amplitude_per_step

  !> Does the highest mode grow for ever? Its largest amplitude in steps 3000 to 4000 against
  !> that in steps 1000 to 2000: at midpoint's limit the amplitude beats, so maxima are taken.
  logical function grows(method, damping, h)
    integer, intent(in) :: method
    real(wp), intent(in) :: damping, h
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: w, part(2), now, early, late
    integer :: i
    real(wp), parameter :: amplitude = 1.0e-9_wp
    w = frequency(n, k)
    call displaced_chain(n, 1, amplitude, damping, model, state)
    call ready(model, state, work, method, h)
    early = 0.0_wp
    late = 0.0_wp
    do i = 1, 400
      call fly(model, state, work, 10)
      part = part_of(state, n, 1)
      now = sqrt((w*part(1))**2 + part(2)**2)
      grows = now > 1.0e6_wp*w*amplitude
      if (grows) return
      if (i > 100 .and. i <= 200) early = max(early, now)
      if (i > 300) late = max(late, now)
    end do
    ! Decayed to round-off of the positions, the mode is stable.
    grows = late > 1.05_wp*early .and. late > 1.0e-3_wp*w*amplitude
  end function grows

  !> The step at which growth begins, by bisection between two fractions of a guess.
  real(wp) function measured_limit(method, damping, guess) result(limit)
    integer, intent(in) :: method
    real(wp), intent(in) :: damping, guess
    real(wp) :: low, high
    integer :: i
    low = 0.9_wp*guess
    high = 1.1_wp*guess
    do i = 1, 14
      limit = 0.5_wp*(low + high)
      if (grows(method, damping, limit)) then
        high = limit
      else
        low = limit
      end if
    end do
  end function measured_limit

  subroutine stability_limits()
    real(wp), parameter :: theory(2) = [2.0_wp*sqrt(2.0_wp), 2.0_wp]
    real(wp) :: z
    integer :: i
    do i = 1, 2
      z = measured_limit(methods(i), 0.0_wp, theory(i)/frequency(n, k))*frequency(n, k)
      call note('V3 '//trim(method_name(i))//' is stable to z = '//words(z)//', theory '//words(theory(i)))
      call expect_close(z, theory(i), trim(method_name(i))//': limit', rtol=1.0e-4_wp)
    end do
  end subroutine stability_limits

  !> In a uniform chain the damping rate of a mode is c/k of its omega^2, so the highest mode
  !> is the corner of the spectrum: the limit is where its amplification passes 1. The limit
  !> that users get may only be smaller.
  subroutine damped_limits()
    real(wp), parameter :: damping(4) = [0.05_wp, 0.2_wp, 0.8_wp, 4.0_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(spectrum_t) :: spectrum
    real(wp) :: w, g, low, high, h, measured, given
    integer :: i, j, b
    w = frequency(n, k)
    do i = 1, 2
      do j = 1, size(damping)
        g = damping(j)/k*w*w
        call displaced_chain(1, 1, 0.0_wp, damping(j), model, state)
        call net_spectrum(model%net, spectrum, state%node_position)
        call expect_close(spectrum%highest_frequency, w, 'highest frequency', rtol=1.0e-4_wp)
        call expect_close(spectrum%largest_damping_rate, g, 'largest damping rate', rtol=2.0e-4_wp)
        given = largest_stable_step(methods(i), spectrum)
        low = 0.5_wp*given
        high = 2.0_wp*given
        do b = 1, 50
          h = 0.5_wp*(low + high)
          if (amplification(methods(i), h*w, h*g) > 1.0_wp) then
            high = h
          else
            low = h
          end if
        end do
        measured = measured_limit(methods(i), damping(j), h)
        call note('V3 damped, '//trim(method_name(i))//', c/c_crit '//words(0.5_wp*g/w)//': limit '//words(measured*w)// &
                  '/omega, amplification says '//words(h*w)//', given '//words(given*w))
        call expect_close(measured, h, trim(method_name(i))//': measured limit', rtol=3.0e-4_wp)
        call expect(given <= measured*(1.0_wp + 1.0e-4_wp), trim(method_name(i))//': the given limit is not above')
      end do
    end do
  end subroutine damped_limits

end module verify_chain
