!> Energies, momenta, tensions and guards against sums done by hand.
module test_diagnostics
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_positive_inf
  use castnet_kinds, only: wp, i8
  use castnet_cable_plan, only: build_cable_plan
  use castnet_diagnostics, only: net_kinetic_energy, target_kinetic_energy, elastic_energy, linear_momentum, &
                                 angular_momentum, net_centre_of_mass, cable_tensions, largest_tension, &
                                 record_history, impulse_percentiles, first_bad_node, check_finite
  use castnet_error, only: error_t, exit_numerical
  use castnet_model, only: model_t
  use castnet_record, only: history_row_t
  use castnet_rotation, only: rotate
  use castnet_state, only: state_t, impulse_bins, impulse_bin_low, impulse_bins_per_decade
  use testing, only: test_case, expect, expect_close, expect_equal
  implicit none
  private
  public :: run_test_diagnostics

contains

  subroutine run_test_diagnostics()
    call test_case('diagnostics: energies and momenta are the sums over nodes and body', sums_by_hand)
    call test_case('diagnostics: a row agrees with plain sums over a net of every kind of cable', row_by_hand)
    call test_case('diagnostics: a turning net has angular momentum I w', turning_net)
    call test_case('diagnostics: tension follows the law, clamped or not', tension_law)
    call test_case('diagnostics: a fixed target has no momentum and no energy', fixed_target)
    call test_case('diagnostics: impulse percentiles come out of the bins', percentiles)
    call test_case('diagnostics: the first bad node is found and named', bad_node)
    call test_case('diagnostics: a scene without net or target has rows too', empty_scene)
    call test_case('diagnostics: a row copies ledger and tally', row_copies)
  end subroutine run_test_diagnostics

  !> 700 nodes, two diagonals of several chunks, one with gaps, and 260 loose cables that run
  !> either way, a third of them taut: a row against sums in the order of the file, and every
  !> tension against the law.
  subroutine row_by_hand()
    integer, parameter :: n = 700, n_loose = 260
    type(model_t) :: model
    type(state_t) :: state
    type(history_row_t) :: row
    integer :: nodes(2, 2*n + n_loose), i, m
    real(wp), allocatable :: tension(:)
    real(wp) :: kinetic, elastic, largest, p(3), l(3), moment(3), along(3), length, stretch, pull, centre(3), error
    call build(n, model, state)
    deallocate (model%target, state%target)
    m = 0
    do i = 1, n - 1
      m = m + 1
      nodes(:, m) = [i, i + 1]
    end do
    do i = 1, n - 26
      if (modulo(i, 40) < 3) cycle
      m = m + 1
      nodes(:, m) = [i + 26, i]
    end do
    do i = 1, n_loose
      m = m + 1
      nodes(:, m) = [1 + modulo(37*i, n), 1 + modulo(37*i + 101 + modulo(i*i, 211), n)]
    end do
    associate (net => model%net)
      net%n_cable = m
      net%cable_nodes = nodes(:, :m)
      net%natural_length = [(0.3_wp + 0.01_wp*modulo(11*i, 37), i=1, m)]
      net%axial_stiffness = [(300.0_wp + 5.0_wp*modulo(3*i, 29), i=1, m)]
      net%damping = [(0.1_wp*modulo(i, 7), i=1, m)]
      call build_cable_plan(net%plan, n, net%cable_nodes, net%axial_stiffness, net%natural_length, net%damping)
      call expect(net%plan%n_diagonal >= 2 .and. net%plan%n_loose > 128, 'diagonals and loose cables')
      do i = 1, n
        state%node_position(i, :) = [0.9_wp*sin(12.9_wp*i), 0.5_wp*sin(7.1_wp*i + 1.0_wp), 0.4_wp*sin(3.7_wp*i + 2.0_wp)]
        state%node_velocity(i, :) = [3.0_wp*sin(5.3_wp*i), 2.0_wp*sin(1.7_wp*i), -4.0_wp*sin(2.3_wp*i + 1.0_wp)]
      end do
      kinetic = 0.0_wp; p = 0.0_wp; l = 0.0_wp; moment = 0.0_wp
      do i = 1, n
        kinetic = kinetic + 0.5_wp*net%node_mass(i)*sum(state%node_velocity(i, :)**2)
        p = p + net%node_mass(i)*state%node_velocity(i, :)
        l = l + net%node_mass(i)*times(state%node_position(i, :), state%node_velocity(i, :))
        moment = moment + net%node_mass(i)*state%node_position(i, :)
      end do
      allocate (tension(m))
      call cable_tensions(net, state%node_position, state%node_velocity, tension)
      elastic = 0.0_wp; largest = 0.0_wp; error = 0.0_wp
      do i = 1, m
        along = state%node_position(nodes(2, i), :) - state%node_position(nodes(1, i), :)
        length = norm2(along)
        stretch = max(0.0_wp, length - net%natural_length(i))
        pull = 0.0_wp
        if (stretch > 0.0_wp) pull = net%axial_stiffness(i)/net%natural_length(i)*stretch + net%damping(i)* &
          dot_product(along, state%node_velocity(nodes(2, i), :) - state%node_velocity(nodes(1, i), :))/length
        if (net%clamp_tension) pull = max(0.0_wp, pull)
        elastic = elastic + 0.5_wp*net%axial_stiffness(i)/net%natural_length(i)*stretch**2
        largest = max(largest, pull)
        error = max(error, abs(tension(i) - pull))
      end do
      row = record_history(model, state, centre)
      call expect_close(row%kinetic_net, kinetic, 'kinetic', rtol=1.0e-13_wp)
      call expect_close(row%elastic, elastic, 'elastic', rtol=1.0e-13_wp)
      call expect_close(row%max_tension, largest, 'largest tension', rtol=1.0e-13_wp)
      call expect_close(error, 0.0_wp, 'tensions', atol=1.0e-13_wp*largest)
      call expect_close(row%linear_momentum, p, 'momentum', atol=1.0e-13_wp*kinetic)
      call expect_close(row%angular_momentum, l, 'angular momentum', atol=1.0e-13_wp*kinetic)
      call expect_close(centre, moment/sum(net%node_mass), 'centre of mass', atol=1.0e-13_wp)
    end associate
  end subroutine row_by_hand

  !> n nodes along a crooked line, cables between neighbours, a target beside them.
  subroutine build(n, model, state)
    integer, intent(in) :: n
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    integer :: i
    allocate (model%net, model%target, state%target)
    model%net%n_node = n
    model%net%n_pad = 8*((n + 7)/8)
    model%net%n_cable = n - 1
    allocate (model%net%node_mass(n), model%net%cable_nodes(2, n - 1), model%net%natural_length(n - 1), &
              model%net%axial_stiffness(n - 1), model%net%damping(n - 1))
    allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3))
    state%node_position = 0.0_wp
    state%node_velocity = 0.0_wp
    do i = 1, n
      model%net%node_mass(i) = 0.01_wp*real(1 + modulo(i, 3), wp)
      state%node_position(i, :) = [0.1_wp*i, 0.03_wp*modulo(7*i, 5), 0.02_wp*modulo(3*i, 4)]
      state%node_velocity(i, :) = [1.0_wp - 0.2_wp*modulo(i, 4), 0.5_wp*modulo(i, 3), -0.3_wp*modulo(i, 5)]
    end do
    do i = 1, n - 1
      model%net%cable_nodes(:, i) = [i, i + 1]
    end do
    model%net%natural_length = 0.11_wp
    model%net%axial_stiffness = 350.0_wp
    model%net%damping = 0.4_wp
    call build_cable_plan(model%net%plan, n, model%net%cable_nodes, model%net%axial_stiffness, &
                          model%net%natural_length, model%net%damping)
    model%target%mass = 3.5_wp
    model%target%inertia = reshape([0.03_wp, 0.001_wp, -0.002_wp, 0.001_wp, 0.04_wp, 0.003_wp, &
                                    -0.002_wp, 0.003_wp, 0.02_wp], [3, 3])
    state%target%position = [1.0_wp, -2.0_wp, 0.5_wp]
    state%target%velocity = [0.1_wp, 0.2_wp, -0.3_wp]
    state%target%attitude = [0.5_wp, -0.5_wp, 0.5_wp, 0.5_wp]
    state%target%angular_velocity = [0.7_wp, -0.1_wp, 1.5_wp]
    state%time = 0.25_wp
    state%step = 500_i8
  end subroutine build

  !> 19 nodes fill two blocks of lanes and part of a third; reordering n terms of one sign
  !> changes a sum by less than n units of round-off.
  subroutine sums_by_hand()
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: kinetic, elastic, p(3), l(3), centre(3), mass, length, m, x(3), v(3)
    integer :: i
    call build(19, model, state)
    kinetic = 0.0_wp; elastic = 0.0_wp; p = 0.0_wp; l = 0.0_wp; centre = 0.0_wp; mass = 0.0_wp
    do i = 1, 19
      m = model%net%node_mass(i)
      x = state%node_position(i, :)
      v = state%node_velocity(i, :)
      kinetic = kinetic + 0.5_wp*m*sum(v**2)
      p = p + m*v
      l = l + m*times(x, v)
      centre = centre + m*x
      mass = mass + m
    end do
    do i = 1, 18
      length = sqrt(sum((state%node_position(i + 1, :) - state%node_position(i, :))**2))
      if (length > 0.11_wp) elastic = elastic + 0.5_wp*350.0_wp/0.11_wp*(length - 0.11_wp)**2
    end do
    call expect_close(net_kinetic_energy(model%net, state%node_velocity), kinetic, 'kinetic', rtol=1.0e-14_wp)
    call expect_close(elastic_energy(model%net, state%node_position), elastic, 'elastic', rtol=1.0e-14_wp)
    call expect_close(net_centre_of_mass(model%net, state%node_position), centre/mass, 'centre', rtol=1.0e-14_wp)
    associate (body => state%target, inertia => model%target%inertia)
      p = p + 3.5_wp*body%velocity
      l = l + 3.5_wp*times(body%position, body%velocity) + rotate(body%attitude, matmul(inertia, body%angular_velocity))
      call expect_close(target_kinetic_energy(model%target, body), 0.5_wp*3.5_wp*0.14_wp + &
        0.5_wp*sum(body%angular_velocity*matmul(inertia, body%angular_velocity)), 'target', rtol=1.0e-14_wp)
    end associate
    call expect_close(linear_momentum(model, state), p, 'momentum', rtol=1.0e-14_wp)
    call expect_close(angular_momentum(model, state), l, 'angular momentum', rtol=1.0e-14_wp)
  end subroutine sums_by_hand

  pure function times(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function times

  !> v = w × x: L = sum m (x.x w - x (x.w)).
  subroutine turning_net()
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: w(3), l(3), x(3)
    integer :: i
    call build(11, model, state)
    deallocate (model%target)
    w = [0.3_wp, -1.2_wp, 0.8_wp]
    l = 0.0_wp
    do i = 1, 11
      x = state%node_position(i, :)
      state%node_velocity(i, :) = times(w, x)
      l = l + model%net%node_mass(i)*(sum(x**2)*w - x*sum(x*w))
    end do
    call expect_close(angular_momentum(model, state), l, 'I w', rtol=1.0e-14_wp)
    call expect_close(net_kinetic_energy(model%net, state%node_velocity), 0.5_wp*sum(w*l), 'w.I w/2', rtol=1.0e-14_wp)
  end subroutine turning_net

  !> One cable of 0.11 m at 0.12 m: k (l - l0) = 350/0.11 x 0.01 N, then damping 0.4 x rate.
  subroutine tension_law()
    type(model_t) :: model
    type(state_t) :: state
    real(wp) :: tension(1), static
    static = 350.0_wp/0.11_wp*0.01_wp
    call build(2, model, state)
    state%node_position(1:2, :) = reshape([0.0_wp, 0.0_wp, 0.0_wp, 0.12_wp, 0.0_wp, 0.0_wp], [2, 3])
    state%node_velocity = 0.0_wp
    state%node_velocity(2, :) = [5.0_wp, 2.0_wp, 0.0_wp]
    call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
    call expect_close(tension(1), static + 0.4_wp*2.0_wp, 'stretching', rtol=1.0e-13_wp)
    call expect_close(largest_tension(model%net, state%node_position, state%node_velocity), tension(1), 'largest', atol=0.0_wp)
    state%node_velocity(2, 2) = -200.0_wp
    call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
    call expect_close(tension(1), 0.0_wp, 'clamped', atol=0.0_wp)
    model%net%clamp_tension = .false.
    call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
    call expect_close(tension(1), static - 0.4_wp*200.0_wp, 'unclamped', rtol=1.0e-13_wp)
    state%node_position(2, 2) = 0.10_wp
    call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
    call expect_close(tension(1), 0.0_wp, 'slack', atol=0.0_wp)
    state%node_position(2, 2) = 0.0_wp
    call cable_tensions(model%net, state%node_position, state%node_velocity, tension)
    call expect_close(tension(1), 0.0_wp, 'ends together', atol=0.0_wp)
  end subroutine tension_law

  subroutine fixed_target()
    type(model_t) :: model
    type(state_t) :: state
    call build(9, model, state)
    deallocate (model%net)
    model%target%fixed = .true.
    call expect_close(linear_momentum(model, state), [0.0_wp, 0.0_wp, 0.0_wp], 'momentum', atol=0.0_wp)
    call expect_close(angular_momentum(model, state), [0.0_wp, 0.0_wp, 0.0_wp], 'angular momentum', atol=0.0_wp)
    call expect_close(target_kinetic_energy(model%target, state%target), 0.0_wp, 'energy', atol=0.0_wp)
  end subroutine fixed_target

  !> 500 contacts in bin 1001 (1e-9), 460 in 2001 (1e-4), 35 in 2401 (1e-2), 5 in 2601 (0.1):
  !> a bin's middle is 10**(1/400) above its lower edge.
  subroutine percentiles()
    integer(i8) :: histogram(impulse_bins)
    real(wp) :: impulse(4), middle
    histogram = 0
    call expect_close(impulse_percentiles(histogram), [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 'no contact', atol=0.0_wp)
    histogram(1001) = 500
    histogram(2001) = 460
    histogram(2401) = 35
    histogram(2601) = 5
    impulse = impulse_percentiles(histogram)
    middle = impulse_bin_low*10.0_wp**(0.5_wp/impulse_bins_per_decade)
    call expect_close(impulse(1), middle*1.0e5_wp, 'median', rtol=1.0e-12_wp)
    call expect_close(impulse(2), middle*1.0e10_wp, '95 %', rtol=1.0e-12_wp)
    call expect_close(impulse(3), middle*1.0e12_wp, '99 %', rtol=1.0e-12_wp)
    call expect_close(impulse(4), middle*1.0e13_wp, '99.9 %', rtol=1.0e-12_wp)
  end subroutine percentiles

  subroutine bad_node()
    type(model_t) :: model
    type(state_t) :: state
    type(error_t), allocatable :: error
    call build(19, model, state)
    call expect_equal(first_bad_node(19, state%node_position, state%node_velocity), 0, 'none')
    call check_finite(model, state, error)
    call expect(.not. allocated(error), 'no error')
    state%node_velocity(17, 2) = ieee_value(1.0_wp, ieee_quiet_nan)
    state%node_position(18, 1) = ieee_value(1.0_wp, ieee_positive_inf)
    call expect_equal(first_bad_node(19, state%node_position, state%node_velocity), 17, 'NaN')
    call expect_equal(first_bad_node(16, state%node_position, state%node_velocity), 0, 'not beyond the net')
    call check_finite(model, state, error)
    call expect(allocated(error), 'an error')
    if (.not. allocated(error)) return
    call expect_equal(error%code, exit_numerical, 'exit code')
    call expect(index(error%message, 'node 16 (counted from 0)') > 0, 'names the node')
    call expect(index(error%message, 'step 500, t = 2.50000E-01 s') > 0, 'names step and time')
    deallocate (error, model%net)
    state%target%attitude(3) = ieee_value(1.0_wp, ieee_quiet_nan)
    call check_finite(model, state, error)
    call expect(allocated(error), 'an error of the target')
  end subroutine bad_node

  subroutine empty_scene()
    type(model_t) :: model
    type(state_t) :: state
    type(history_row_t) :: row
    state%time = 3.0_wp
    row = record_history(model, state)
    call expect_close(row%time, 3.0_wp, 'time', atol=0.0_wp)
    call expect_close(row%linear_momentum, [0.0_wp, 0.0_wp, 0.0_wp], 'momentum', atol=0.0_wp)
  end subroutine empty_scene

  subroutine row_copies()
    type(model_t) :: model
    type(state_t) :: state
    type(history_row_t) :: row
    call build(19, model, state)
    state%ledger%dissipated = 1.0_wp
    state%ledger%contact_loss = 2.0_wp
    state%ledger%winch_work = 3.0_wp
    state%ledger%projection_work = 4.0_wp
    state%ledger%external_work = 5.0_wp
    state%tally%contacts = 6_i8
    state%tally%max_impulse = 7.0_wp
    state%tally%min_impulse = -8.0_wp
    state%tally%impulse_sum = 9.0_wp
    state%tally%max_bullet_impulse = 10.0_wp
    state%tally%deepest_penetration = 11.0_wp
    state%tally%max_tension = 1.0e9_wp
    state%tally%contact_residual = 12.0_wp
    state%tally%contact_iterations = 13
    row = record_history(model, state)
    call expect_close([row%dissipated, row%contact_loss, row%winch_work, row%projection_work, row%external_work, &
                       real(row%contacts, wp), row%max_impulse, row%min_impulse, row%impulse_sum, &
                       row%max_bullet_impulse, row%deepest_penetration, row%max_tension, row%contact_residual, &
                       real(row%contact_iterations, wp)], &
                      [1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp, 5.0_wp, 6.0_wp, 7.0_wp, -8.0_wp, 9.0_wp, 10.0_wp, 11.0_wp, &
                       1.0e9_wp, 12.0_wp, 13.0_wp], 'copies', atol=0.0_wp)
    call expect_close(row%kinetic_net, net_kinetic_energy(model%net, state%node_velocity), 'kinetic', atol=0.0_wp)
    call expect_close(row%elastic, elastic_energy(model%net, state%node_position), 'elastic', atol=0.0_wp)
  end subroutine row_copies

end module test_diagnostics
