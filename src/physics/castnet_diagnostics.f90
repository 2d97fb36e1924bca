!> What can be said of a state without changing it: energies, momenta, tensions, the
!> impulses' distribution, and whether every number is still one.
!>
!> Sums run in eight lanes, lane k over the entries k, k + 8, ..., folded pairwise at the
!> end: an order that the compiler can vectorise and that no build, thread count or
!> vector length changes.
module castnet_diagnostics
  use castnet_kinds, only: wp, i8
  use castnet_cable_force, only: survey_cables
  use castnet_compliant_contact, only: is_compliant, spring_energy
  use castnet_error, only: error_t, fail, exit_numerical
  use castnet_model, only: model_t, target_t
  use castnet_net, only: net_t
  use castnet_record, only: history_row_t
  use castnet_rotation, only: rotate
  use castnet_state, only: state_t, body_state_t, impulse_bin_low, impulse_bins_per_decade
  implicit none
  private
  public :: net_kinetic_energy, target_kinetic_energy, elastic_energy
  public :: linear_momentum, angular_momentum, net_centre_of_mass
  public :: cable_tensions, largest_tension, record_history, impulse_percentiles
  public :: first_bad_node, check_finite

  integer, parameter :: lanes = 8

contains

  !> One row of /history: energies, momenta and tension of this state, ledger and tally
  !> as they stand. The caller clears the tally afterwards.
  function record_history(model, state) result(row)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(history_row_t) :: row
    row%time = state%time
    if (allocated(model%net)) then
      row%kinetic_net = net_kinetic_energy(model%net, state%node_velocity)
      call survey_net(model%net, state%node_position, state%node_velocity, row%elastic, row%max_tension)
      row%max_tension = max(state%tally%max_tension, row%max_tension)
      if (is_compliant(model)) row%elastic = row%elastic + spring_energy(model, state%node_position, state%target)
    end if
    if (allocated(model%target)) row%kinetic_target = target_kinetic_energy(model%target, state%target)
    row%linear_momentum = linear_momentum(model, state)
    row%angular_momentum = angular_momentum(model, state)
    row%dissipated = state%ledger%dissipated
    row%contact_loss = state%ledger%contact_loss
    row%winch_work = state%ledger%winch_work
    row%projection_work = state%ledger%projection_work
    row%external_work = state%ledger%external_work
    row%contacts = state%tally%contacts
    row%max_impulse = state%tally%max_impulse
    row%min_impulse = state%tally%min_impulse
    row%impulse_sum = state%tally%impulse_sum
    row%max_bullet_impulse = state%tally%max_bullet_impulse
    row%deepest_penetration = state%tally%deepest_penetration
    row%contact_residual = state%tally%contact_residual
    row%contact_iterations = state%tally%contact_iterations
  end function record_history

  !> Sum of m v.v/2 over the nodes [J].
  pure real(wp) function net_kinetic_energy(net, velocity) result(energy)
    type(net_t), intent(in) :: net
    real(wp), contiguous, intent(in) :: velocity(:, :)  !! (n_pad,3) [m/s]
    energy = 0.0_wp
    if (net%n_node > 0) energy = 0.5_wp*weighted_square(net%n_node, net%node_mass, velocity(:, 1), velocity(:, 2), velocity(:, 3))
  end function net_kinetic_energy

  !> m v.v/2 + w.I w/2 [J]; a fixed target's motion is prescribed and has no energy of its own.
  pure real(wp) function target_kinetic_energy(target, body) result(energy)
    type(target_t), intent(in) :: target
    type(body_state_t), intent(in) :: body
    real(wp) :: spin(3)
    energy = 0.0_wp
    if (target%fixed) return
    spin = body_spin(target, body)
    energy = 0.5_wp*(target%mass*(body%velocity(1)*body%velocity(1) + body%velocity(2)*body%velocity(2) + &
                                  body%velocity(3)*body%velocity(3)) + &
                     (body%angular_velocity(1)*spin(1) + body%angular_velocity(2)*spin(2) + &
                      body%angular_velocity(3)*spin(3)))
  end function target_kinetic_energy

  !> Sum of k (l - l0)**2/2 over the taut cables, k = EA/l0 [J].
  pure real(wp) function elastic_energy(net, position) result(energy)
    type(net_t), intent(in) :: net
    real(wp), intent(in), contiguous :: position(:, :)  !! (n_pad,3) [m]; else each guard would copy it
    real(wp) :: largest
    call survey_net(net, position, position, energy, largest)
  end function elastic_energy

  !> Elastic energy [J] and the largest tension [N], 0 when every cable is slack.
  pure subroutine survey_net(net, position, velocity, elastic, largest)
    type(net_t), intent(in) :: net
    real(wp), contiguous, intent(in) :: position(:, :), velocity(:, :)  !! (n_pad,3) [m], [m/s]
    real(wp), intent(out) :: elastic, largest
    call survey_cables(net%plan, size(position, 1), position, velocity, merge(0.0_wp, -huge(1.0_wp), net%clamp_tension), &
                       elastic, largest)
  end subroutine survey_net

  !> Linear momentum of net and target [kg m/s].
  pure function linear_momentum(model, state) result(momentum)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: momentum(3)
    integer :: c
    momentum = 0.0_wp
    if (allocated(model%net)) then
      do c = 1, 3
        momentum(c) = weighted_sum(model%net%n_node, model%net%node_mass, state%node_velocity(:, c))
      end do
    end if
    if (.not. allocated(model%target)) return
    if (model%target%fixed) return
    momentum = momentum + model%target%mass*state%target%velocity
  end function linear_momentum

  !> Angular momentum of net and target about the inertial origin [kg m2/s]:
  !> sum m x × v over the nodes, m r × v + R I w of the target.
  pure function angular_momentum(model, state) result(momentum)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: momentum(3)
    integer :: c, d, e
    momentum = 0.0_wp
    if (allocated(model%net)) then
      do c = 1, 3
        d = modulo(c, 3) + 1
        e = modulo(c + 1, 3) + 1
        momentum(c) = weighted_moment(model%net%n_node, model%net%node_mass, state%node_position(:, d), &
                                      state%node_velocity(:, e), state%node_position(:, e), state%node_velocity(:, d))
      end do
    end if
    if (.not. allocated(model%target)) return
    if (model%target%fixed) return
    associate (x => state%target%position, v => state%target%velocity, mass => model%target%mass)
      momentum(1) = momentum(1) + mass*(x(2)*v(3) - x(3)*v(2))
      momentum(2) = momentum(2) + mass*(x(3)*v(1) - x(1)*v(3))
      momentum(3) = momentum(3) + mass*(x(1)*v(2) - x(2)*v(1))
    end associate
    momentum = momentum + rotate(state%target%attitude, body_spin(model%target, state%target))
  end function angular_momentum

  !> Centre of mass of the net, fixed nodes and bullets included [m].
  pure function net_centre_of_mass(net, position) result(centre)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: position(:, :)  !! (n_pad,3) [m]
    real(wp) :: centre(3), part(lanes)
    integer :: c, i, k
    part = 0.0_wp
    do i = 0, net%n_node - 1, lanes
      do k = 1, min(lanes, net%n_node - i)
        part(k) = part(k) + net%node_mass(i + k)
      end do
    end do
    do c = 1, 3
      centre(c) = weighted_sum(net%n_node, net%node_mass, position(:, c))/fold(part)
    end do
  end function net_centre_of_mass

  !> Tension of every cable (physics.md section 1): k (l - l0) + c dl/dt while l > l0,
  !> else 0; never negative when the net clamps it.
  pure subroutine cable_tensions(net, position, velocity, tension)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: position(:, :), velocity(:, :)  !! (n_pad,3) [m], [m/s]
    real(wp), intent(out) :: tension(:)                     !! (n_cable) [N]
    integer :: i
    do i = 1, net%n_cable
      tension(i) = one_tension(net, position, velocity, i)
    end do
  end subroutine cable_tensions

  !> The largest of them, 0 when every cable is slack [N].
  pure real(wp) function largest_tension(net, position, velocity) result(largest)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: position(:, :), velocity(:, :)
    real(wp) :: elastic
    call survey_net(net, position, velocity, elastic, largest)
  end function largest_tension

  pure real(wp) function one_tension(net, position, velocity, i) result(tension)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: position(:, :), velocity(:, :)
    integer, intent(in) :: i
    real(wp) :: d(3), w(3), length, rate
    integer :: a, b
    a = net%cable_nodes(1, i)
    b = net%cable_nodes(2, i)
    d = position(b, :) - position(a, :)
    w = velocity(b, :) - velocity(a, :)
    length = sqrt(max(d(1)*d(1) + (d(2)*d(2) + d(3)*d(3)), 1.0e-60_wp))
    rate = (d(1)*w(1) + (d(2)*w(2) + d(3)*w(3)))/length
    tension = 0.0_wp
    if (.not. length > net%natural_length(i)) return
    tension = net%axial_stiffness(i)/net%natural_length(i)*(length - net%natural_length(i)) + net%damping(i)*rate
    if (net%clamp_tension) tension = max(0.0_wp, tension)
  end function one_tension

  !> The impulses below which 50, 95, 99 and 99.9 % of all contacts stayed [N s], from the
  !> bins of castnet_state, so to half a bin, 0.6 %; 0 when nothing has touched.
  pure function impulse_percentiles(histogram) result(impulse)
    integer(i8), intent(in) :: histogram(:)  !! contacts per logarithmic bin
    real(wp), parameter :: fraction(4) = [0.5_wp, 0.95_wp, 0.99_wp, 0.999_wp]
    real(wp) :: impulse(4)
    integer(i8) :: total, below
    integer :: bin, next
    impulse = 0.0_wp
    total = sum(histogram)
    if (total == 0) return
    below = 0
    next = 1
    do bin = 1, size(histogram)
      below = below + histogram(bin)
      do while (real(below, wp) >= fraction(next)*real(total, wp))
        impulse(next) = impulse_bin_low*10.0_wp**((real(bin, wp) - 0.5_wp)/real(impulse_bins_per_decade, wp))
        next = next + 1
        if (next > size(fraction)) return
      end do
    end do
  end function impulse_percentiles

  !> The first node with a position or velocity that is no finite number, 0 if there is none.
  !> Reads bits: a comparison with NaN would trap in the check build.
  pure integer function first_bad_node(n_node, position, velocity) result(node)
    integer, intent(in) :: n_node
    real(wp), intent(in) :: position(:, :), velocity(:, :)  !! (n_pad,3)
    integer :: i, c, bad
    bad = 0
    do c = 1, 3
      do i = 1, n_node
        bad = bad + merge(0, 1, is_finite(position(i, c))) + merge(0, 1, is_finite(velocity(i, c)))
      end do
    end do
    node = 0
    if (bad == 0) return
    do i = 1, n_node
      node = i
      if (.not. all(is_finite(position(i, :))) .or. .not. all(is_finite(velocity(i, :)))) return
    end do
  end function first_bad_node

  !> Fail with exit code 3 when the state holds a number that is none; says which.
  subroutine check_finite(model, state, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    type(error_t), allocatable, intent(inout) :: error
    integer :: node
    if (allocated(model%net)) then
      node = first_bad_node(model%net%n_node, state%node_position, state%node_velocity)
      if (node > 0 .and. allocated(model%net%original_node)) node = model%net%original_node(node)
      if (node > 0) then
        !$omp critical (castnet_text)
        call fail(error, exit_numerical, moment(state)//': the motion of net node '//number(int(node - 1, i8))// &
          ' (counted from 0) is no finite number any more; try a smaller time/step or a larger net/damping_ratio')
        !$omp end critical (castnet_text)
      end if
    end if
    if (.not. allocated(model%target)) return
    associate (body => state%target)
      if (all(is_finite(body%position)) .and. all(is_finite(body%velocity)) .and. all(is_finite(body%attitude)) .and. &
          all(is_finite(body%angular_velocity))) return
    end associate
    !$omp critical (castnet_text)
    call fail(error, exit_numerical, moment(state)// &
              ': the target''s motion is no finite number any more; try a smaller time/step')
    !$omp end critical (castnet_text)
  end subroutine check_finite

  !> 'step 120, t = 0.006 s'.
  pure function moment(state) result(words)
    type(state_t), intent(in) :: state
    character(len=:), allocatable :: words
    character(len=16) :: time
    write (time, '(es12.5)') state%time
    words = 'step '//number(state%step)//', t = '//trim(adjustl(time))//' s'
  end function moment

  pure function number(value) result(words)
    integer(i8), intent(in) :: value
    character(len=:), allocatable :: words
    character(len=20) :: buffer
    write (buffer, '(i0)') value
    words = trim(buffer)
  end function number

  !> Neither NaN nor infinite: the exponent's eleven bits are not all set.
  elemental logical function is_finite(x)
    real(wp), intent(in) :: x
    integer(i8), parameter :: exponent_bits = ishft(2047_i8, 52)
    is_finite = iand(transfer(x, 0_i8), exponent_bits) /= exponent_bits
  end function is_finite

  !> I w in body axes [kg m2/s].
  pure function body_spin(target, body) result(spin)
    type(target_t), intent(in) :: target
    type(body_state_t), intent(in) :: body
    real(wp) :: spin(3)
    integer :: i
    do i = 1, 3
      spin(i) = target%inertia(i, 1)*body%angular_velocity(1) + target%inertia(i, 2)*body%angular_velocity(2) + &
                target%inertia(i, 3)*body%angular_velocity(3)
    end do
  end function body_spin

  !> Sum of w x. Whole blocks of lanes first: a constant count is what vectorises.
  pure real(wp) function weighted_sum(n, w, x) result(total)
    integer, intent(in) :: n
    real(wp), intent(in) :: w(n), x(n)
    real(wp) :: part(lanes)
    integer :: i, k
    part = 0.0_wp
    do i = 0, n - lanes, lanes
      do k = 1, lanes
        part(k) = part(k) + w(i + k)*x(i + k)
      end do
    end do
    do k = 1, modulo(n, lanes)
      i = n - modulo(n, lanes)
      part(k) = part(k) + w(i + k)*x(i + k)
    end do
    total = fold(part)
  end function weighted_sum

  !> Sum of w (x x + y y + z z).
  pure real(wp) function weighted_square(n, w, x, y, z) result(total)
    integer, intent(in) :: n
    real(wp), intent(in) :: w(n), x(n), y(n), z(n)
    real(wp) :: part(lanes)
    integer :: i, k
    part = 0.0_wp
    do i = 0, n - lanes, lanes
      do k = 1, lanes
        part(k) = part(k) + w(i + k)*(x(i + k)*x(i + k) + y(i + k)*y(i + k) + z(i + k)*z(i + k))
      end do
    end do
    do k = 1, modulo(n, lanes)
      i = n - modulo(n, lanes)
      part(k) = part(k) + w(i + k)*(x(i + k)*x(i + k) + y(i + k)*y(i + k) + z(i + k)*z(i + k))
    end do
    total = fold(part)
  end function weighted_square

  !> Sum of w (x y - p q).
  pure real(wp) function weighted_moment(n, w, x, y, p, q) result(total)
    integer, intent(in) :: n
    real(wp), intent(in) :: w(n), x(n), y(n), p(n), q(n)
    real(wp) :: part(lanes)
    integer :: i, k
    part = 0.0_wp
    do i = 0, n - lanes, lanes
      do k = 1, lanes
        part(k) = part(k) + w(i + k)*(x(i + k)*y(i + k) - p(i + k)*q(i + k))
      end do
    end do
    do k = 1, modulo(n, lanes)
      i = n - modulo(n, lanes)
      part(k) = part(k) + w(i + k)*(x(i + k)*y(i + k) - p(i + k)*q(i + k))
    end do
    total = fold(part)
  end function weighted_moment

  !> The lanes, pairwise.
  pure real(wp) function fold(part)
    real(wp), intent(in) :: part(lanes)
    fold = ((part(1) + part(2)) + (part(3) + part(4))) + ((part(5) + part(6)) + (part(7) + part(8)))
  end function fold

end module castnet_diagnostics
