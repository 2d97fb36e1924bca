!> What can be said of a state without changing it: energies, momenta, tensions, the
!> impulses' distribution, and whether every number is still one.
!>
!> Sums run in eight lanes, lane k over the entries k, k + 8, ..., folded pairwise at the
!> end: an order that the compiler can vectorise and that no build, thread count or
!> vector length changes.
module castnet_diagnostics
  use castnet_kinds, only: wp, i8
  use castnet_cable_force, only: survey_cables, slot_tensions
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
  public :: first_bad_node, check_finite, all_finite

  integer, parameter :: lanes = 8
  integer, parameter :: n_sum = 11

  !> Sums over the nodes.
  type :: node_sums_t
    real(wp) :: mass = 0.0_wp          !! [kg]
    real(wp) :: moment(3) = 0.0_wp     !! of m x [kg m]
    real(wp) :: momentum(3) = 0.0_wp   !! of m v [kg m/s]
    real(wp) :: spin(3) = 0.0_wp       !! of m x × v [kg m2/s]
    real(wp) :: square = 0.0_wp        !! of m v.v [J]
  end type node_sums_t

contains

  !> One row of /history: energies, momenta and tension of this state, ledger and tally
  !> as they stand. The caller clears the tally afterwards. One pass over the nodes, one over
  !> the cables: rows are to cost next to nothing beside the steps between them.
  function record_history(model, state, centre) result(row)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp), intent(out), optional :: centre(3)  !! of mass of the net; 0 without one [m]
    type(history_row_t) :: row
    type(node_sums_t) :: sums
    row%time = state%time
    if (allocated(model%net)) then
      call sum_nodes(model%net, state%node_position, state%node_velocity, sums)
      row%kinetic_net = 0.5_wp*sums%square
      call survey_net(model%net, state%node_position, state%node_velocity, row%elastic, row%max_tension)
      row%max_tension = max(state%tally%max_tension, row%max_tension)
      if (is_compliant(model)) row%elastic = row%elastic + spring_energy(model, state%node_position, state%target)
    end if
    if (allocated(model%target)) row%kinetic_target = target_kinetic_energy(model%target, state%target)
    row%linear_momentum = sums%momentum + target_momentum(model, state)
    row%angular_momentum = sums%spin + target_spin(model, state)
    if (present(centre)) centre = sums%moment/max(sums%mass, tiny(1.0_wp))
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
    call survey_cables(net%plan, size(position, 1), position, velocity, elastic, largest)
  end subroutine survey_net

  !> Linear momentum of net and target [kg m/s].
  pure function linear_momentum(model, state) result(momentum)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: momentum(3)
    type(node_sums_t) :: sums
    if (allocated(model%net)) call sum_nodes(model%net, state%node_position, state%node_velocity, sums)
    momentum = sums%momentum + target_momentum(model, state)
  end function linear_momentum

  !> Angular momentum of net and target about the inertial origin [kg m2/s]:
  !> sum m x × v over the nodes, m r × v + R I w of the target.
  pure function angular_momentum(model, state) result(momentum)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: momentum(3)
    type(node_sums_t) :: sums
    if (allocated(model%net)) call sum_nodes(model%net, state%node_position, state%node_velocity, sums)
    momentum = sums%spin + target_spin(model, state)
  end function angular_momentum

  !> The target's share of the momentum [kg m/s]; a fixed one has none.
  pure function target_momentum(model, state) result(momentum)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: momentum(3)
    momentum = 0.0_wp
    if (.not. allocated(model%target)) return
    if (.not. model%target%fixed) momentum = model%target%mass*state%target%velocity
  end function target_momentum

  !> The target's share of the angular momentum [kg m2/s].
  pure function target_spin(model, state) result(momentum)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: momentum(3)
    momentum = 0.0_wp
    if (.not. allocated(model%target)) return
    if (model%target%fixed) return
    associate (x => state%target%position, v => state%target%velocity, mass => model%target%mass)
      momentum(1) = mass*(x(2)*v(3) - x(3)*v(2))
      momentum(2) = mass*(x(3)*v(1) - x(1)*v(3))
      momentum(3) = mass*(x(1)*v(2) - x(2)*v(1))
    end associate
    momentum = momentum + rotate(state%target%attitude, body_spin(model%target, state%target))
  end function target_spin

  !> Centre of mass of the net, fixed nodes and bullets included [m].
  pure function net_centre_of_mass(net, position) result(centre)
    type(net_t), intent(in) :: net
    real(wp), intent(in), contiguous :: position(:, :)  !! (n_pad,3) [m]
    real(wp) :: centre(3)
    type(node_sums_t) :: sums
    call sum_nodes(net, position, position, sums)
    centre = sums%moment/sums%mass
  end function net_centre_of_mass

  !> Tension of every cable (physics.md section 1): k (l - l0) + c dl/dt while l > l0,
  !> else 0; never negative when the net clamps it.
  pure subroutine cable_tensions(net, position, velocity, tension)
    type(net_t), intent(in) :: net
    real(wp), intent(in), contiguous :: position(:, :), velocity(:, :)  !! (n_pad,3) [m], [m/s]
    real(wp), intent(out) :: tension(:)                                 !! (n_cable) [N]
    real(wp) :: of_slot(net%plan%n_slot)
    integer :: i
    call slot_tensions(net%plan, size(position, 1), position, velocity, &
                       merge(0.0_wp, -huge(1.0_wp), net%clamp_tension), of_slot)
    do i = 1, net%n_cable
      tension(i) = of_slot(net%plan%slot_of_cable(i))
    end do
  end subroutine cable_tensions

  !> The largest of them, 0 when every cable is slack [N].
  pure real(wp) function largest_tension(net, position, velocity) result(largest)
    type(net_t), intent(in) :: net
    real(wp), intent(in), contiguous :: position(:, :), velocity(:, :)
    real(wp) :: elastic
    call survey_net(net, position, velocity, elastic, largest)
  end function largest_tension

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

  !> Is every value a finite number?
  pure logical function all_finite(values)
    real(wp), intent(in) :: values(:)
    all_finite = all(is_finite(values))
  end function all_finite

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

  !> All sums over the nodes that a row of history tells.
  pure subroutine sum_nodes(net, position, velocity, sums)
    type(net_t), intent(in) :: net
    real(wp), intent(in), contiguous :: position(:, :), velocity(:, :)  !! (n_pad,3) [m], [m/s]
    type(node_sums_t), intent(out) :: sums
    real(wp) :: part(lanes, n_sum), rest(lanes, 7)
    integer :: whole, n
    part = 0.0_wp
    n = modulo(net%n_node, lanes)
    whole = net%n_node - n
    call add_nodes(whole, net%node_mass, position(:, 1), position(:, 2), position(:, 3), &
                   velocity(:, 1), velocity(:, 2), velocity(:, 3), part)
    if (n > 0) then
      rest = 0.0_wp
      rest(:n, 1) = net%node_mass(whole + 1:whole + n)
      rest(:n, 2:4) = position(whole + 1:whole + n, :)
      rest(:n, 5:7) = velocity(whole + 1:whole + n, :)
      call add_nodes(lanes, rest(:, 1), rest(:, 2), rest(:, 3), rest(:, 4), rest(:, 5), rest(:, 6), rest(:, 7), part)
    end if
    sums%mass = fold(part(:, 1))
    sums%moment = [fold(part(:, 2)), fold(part(:, 3)), fold(part(:, 4))]
    sums%momentum = [fold(part(:, 5)), fold(part(:, 6)), fold(part(:, 7))]
    sums%spin = [fold(part(:, 8)), fold(part(:, 9)), fold(part(:, 10))]
    sums%square = fold(part(:, 11))
  end subroutine sum_nodes

  !> Add whole blocks of nodes to the parts of the sums: a constant count is what vectorises.
  pure subroutine add_nodes(n, mass, x, y, z, u, v, w, part)
    integer, intent(in) :: n                        !! a multiple of lanes
    real(wp), intent(in) :: mass(n), x(n), y(n), z(n), u(n), v(n), w(n)
    real(wp), intent(inout) :: part(lanes, n_sum)
    real(wp) :: mx, my, mz, mu, mv, mw
    integer :: i, k
    do i = 0, n - lanes, lanes
      do k = 1, lanes
        mx = mass(i + k)*x(i + k)
        my = mass(i + k)*y(i + k)
        mz = mass(i + k)*z(i + k)
        mu = mass(i + k)*u(i + k)
        mv = mass(i + k)*v(i + k)
        mw = mass(i + k)*w(i + k)
        part(k, 1) = part(k, 1) + mass(i + k)
        part(k, 2) = part(k, 2) + mx
        part(k, 3) = part(k, 3) + my
        part(k, 4) = part(k, 4) + mz
        part(k, 5) = part(k, 5) + mu
        part(k, 6) = part(k, 6) + mv
        part(k, 7) = part(k, 7) + mw
        part(k, 8) = part(k, 8) + (my*w(i + k) - mz*v(i + k))
        part(k, 9) = part(k, 9) + (mz*u(i + k) - mx*w(i + k))
        part(k, 10) = part(k, 10) + (mx*v(i + k) - my*u(i + k))
        part(k, 11) = part(k, 11) + (mu*u(i + k) + mv*v(i + k) + mw*w(i + k))
      end do
    end do
  end subroutine add_nodes

  !> The lanes, pairwise.
  pure real(wp) function fold(part)
    real(wp), intent(in) :: part(lanes)
    fold = ((part(1) + part(2)) + (part(3) + part(4))) + ((part(5) + part(6)) + (part(7) + part(8)))
  end function fold

end module castnet_diagnostics
