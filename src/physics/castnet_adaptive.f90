!> A step divided so that its error stays below a tolerance: classical Runge-Kutta with the
!> third-order solution embedded in it.
!>
!> With v4 the velocity at the fourth stage and v1 that at the end, y0 + h (k1 + 2 k2 + 2 k3 +
!> f(y1))/6 is of order three and differs from the fourth-order positions by h/6 (v4 - v1):
!> the error of the positions costs nothing but this difference. The higher order goes on.
!> A snap of a cable shows in it at once, because k3 and k4 feel a force that k1 did not.
!>
!> The scene's step stays what contact, output and closing see; only the flow between is
!> divided. So frames fall where they fall with the other methods, and the one number that
!> passes from step to step is `state%substep`.
module castnet_adaptive
  use castnet_kinds, only: wp
  use castnet_error, only: error_t, fail, exit_numerical
  use castnet_integrator, only: flow_work_t, rk4_step
  use castnet_model, only: model_t
  use castnet_shape, only: shape_bounding_radius
  use castnet_state, only: state_t, body_state_t, ledger_t
  use castnet_text, only: to_text
  implicit none
  private
  public :: adaptive_step

  real(wp), parameter :: caution = 0.9_wp                          !! of the part that would just do
  real(wp), parameter :: most_growth = 4.0_wp, least_growth = 0.2_wp
  real(wp), parameter :: smallest_part = 2.0_wp**(-16)             !! of the step

contains

  !> Advance by h in as many parts as the tolerance asks for. Errors: exit_numerical where no
  !> part above 2**-16 h meets it.
  subroutine adaptive_step(model, state, work, h, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(flow_work_t), intent(inout) :: work
    real(wp), intent(in) :: h !! [s]
    type(error_t), allocatable, intent(inout) :: error
    type(body_state_t) :: target_before
    type(ledger_t) :: ledger_before
    real(wp) :: left, part, wish, allowed, excess

    allowed = model%tolerance*error_scale(model)
    left = h
    wish = merge(state%substep, h, state%substep > 0.0_wp)
    do
      part = wish
      if (2.0_wp*wish > left) part = 0.5_wp*left    ! two equal parts, not one and a crumb
      if (wish >= left) part = left
      if (allocated(state%node_position)) call copy(size(work%start_x), state%node_position, state%node_velocity, &
                                                    work%start_x, work%start_v)
      if (allocated(state%target)) target_before = state%target
      ledger_before = state%ledger
      call rk4_step(model, state, work, part)
      excess = step_error(model, state, work, part)/allowed
      if (excess <= 1.0_wp) then
        left = left - part
        if (part < wish) then
          wish = max(wish, growth(excess)*part)     ! the part was cut by the step's end
        else
          wish = growth(excess)*part
        end if
        wish = min(wish, h)
        if (left <= 0.0_wp) exit
        cycle
      end if
      ! Too large, or not a number: once more from the start of the part.
      if (allocated(state%node_position)) call copy(size(work%start_x), work%start_x, work%start_v, &
                                                    state%node_position, state%node_velocity)
      if (allocated(state%target)) state%target = target_before
      state%ledger = ledger_before
      wish = growth(excess)*part
      if (wish >= smallest_part*h) cycle
      call fail(error, exit_numerical, 'step '//to_text(state%step)//', t = '//to_text(state%time)// &
                ' s: no part of the step above '//to_text(smallest_part*h)//' s meets time/tolerance = '// &
                to_text(model%tolerance)//'; try a larger tolerance or a smaller time/step')
      return
    end do
    state%substep = wish
  end subroutine adaptive_step

  !> What the tolerance is a part of: the mean cable length, without cables the target's
  !> radius [m].
  pure real(wp) function error_scale(model) result(scale)
    type(model_t), intent(in) :: model
    scale = 1.0_wp
    if (allocated(model%target)) scale = merge(shape_bounding_radius(model%target%shape), scale, &
                                               shape_bounding_radius(model%target%shape) > 0.0_wp)
    if (.not. allocated(model%net)) return
    if (model%net%n_cable > 0) scale = sum(model%net%natural_length)/model%net%n_cable
  end function error_scale

  !> By what to multiply a part whose error was so many times the allowed one. The error goes
  !> with the fourth power of the part.
  pure real(wp) function growth(excess)
    real(wp), intent(in) :: excess
    growth = least_growth
    if (.not. excess <= huge(1.0_wp)) return
    growth = min(most_growth, max(least_growth, caution/sqrt(sqrt(max(excess, 1.0e-8_wp)))))
  end function growth

  !> The largest error of a position over a step that has just been taken: of the nodes, of
  !> the target's centre, of its surface by turning [m].
  pure real(wp) function step_error(model, state, work, h)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(flow_work_t), intent(in) :: work
    real(wp), intent(in) :: h !! [s]
    real(wp) :: d(3)
    step_error = 0.0_wp
    if (allocated(model%net)) step_error = largest_difference(model%net%n_pad, model%net%n_node, work%vc, state%node_velocity)
    if (allocated(model%target)) then
      if (.not. model%target%fixed) then
        d = work%body_stage%velocity - state%target%velocity
        step_error = larger(step_error, d(1)**2 + d(2)**2 + d(3)**2)
        d = (work%body_stage%angular_velocity - state%target%angular_velocity)*shape_bounding_radius(model%target%shape)
        step_error = larger(step_error, d(1)**2 + d(2)**2 + d(3)**2)
      end if
    end if
    step_error = h/6.0_wp*sqrt(step_error)
  end function step_error

  !> Square of the largest difference between two vectors of a node; NaN if one is.
  pure real(wp) function largest_difference(n_pad, n, a, b) result(largest)
    integer, intent(in) :: n_pad, n
    real(wp), intent(in) :: a(n_pad, 3), b(n_pad, 3)
    integer :: i
    largest = 0.0_wp
    do i = 1, n
      largest = larger(largest, (a(i, 1) - b(i, 1))**2 + (a(i, 2) - b(i, 2))**2 + (a(i, 3) - b(i, 3))**2)
    end do
  end function largest_difference

  !> The larger of two numbers; `max` may drop a NaN.
  elemental real(wp) function larger(a, b)
    real(wp), intent(in) :: a, b
    larger = merge(a, b, a > b .or. a /= a)
  end function larger

  pure subroutine copy(n, x, v, x_to, v_to)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n), v(n)
    real(wp), intent(out) :: x_to(n), v_to(n)
    x_to = x
    v_to = v
  end subroutine copy

end module castnet_adaptive
