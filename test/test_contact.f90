!> Detection, impulses, projection and bookkeeping of contact, piece by piece.
module test_contact
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_model, only: model_t, contact_t
  use castnet_state, only: state_t
  use castnet_shape, only: signed_distance
  use castnet_rotation, only: rotation_matrix, multiply
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t, reserve_contacts
  use castnet_contact_response, only: contact_solver_t, resolve_contacts
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts, detect_contacts
  use castnet_contact_horizon, only: earliest_contact_time
  use castnet_broad_phase, only: net_box
  use contact_cases, only: new_case, add_cables, set_body, momentum, angular_momentum, kinetic_energy, &
                           elastic_energy, centre_of_mass, random_t, uniform, uniform_point, normal_draw, &
                           random_direction, random_quaternion, random_contacts
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_contact

contains

  subroutine run_test_contact()
    call test_case('contact: the net''s box is the least and largest of its nodes', boxes)
    call test_case('contact: two levels find what every node''s distance finds', detection)
    call test_case('contact: single impulse is several of one', single_is_several)
    call test_case('contact: M of the impulses is symmetric positive definite', positive_definite)
    call test_case('contact: elimination of the dense method against LAPACK', elimination)
    call test_case('contact: push_only satisfies its conditions up to 2000 contacts', complementarity)
    call test_case('contact: impulses conserve momentum, angular momentum and book the energy', event_ledger)
    call test_case('contact: no frictionless event creates energy', no_energy)
    call test_case('contact: projection keeps the common centre of mass and books the energy', projection)
    call test_case('contact: an orbital frame''s rate counts in contact velocities', orbital)
    call test_case('contact: fixed nodes and fixed targets', fixed_ends)
    call test_case('contact: tally, histogram and first contact', tally)
    call test_case('contact: nothing touches before the horizon', horizon)
  end subroutine run_test_contact

  subroutine boxes()
    real(wp) :: x(24, 3), lower(3), upper(3)
    type(random_t) :: random
    integer :: n, i, c
    do n = 1, 23
      x = 100.0_wp
      do c = 1, 3
        do i = 1, n
          x(i, c) = normal_draw(random)
        end do
      end do
      call net_box(n, 24, x, lower, upper)
      call expect(all(abs(lower - minval(x(1:n, :), 1)) <= 0.0_wp), 'lower corner')
      call expect(all(abs(upper - maxval(x(1:n, :), 1)) <= 0.0_wp), 'upper corner')
    end do
  end subroutine boxes

  subroutine detection()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(random_t) :: random
    character(len=8) :: shapes(4)
    real(wp) :: r(3, 3), d(1), g(3, 1), y(3, 1), far
    integer :: s, i, k, trial, seen
    shapes = [character(len=8) :: 'box', 'cylinder', 'sphere', 'capsule']
    do s = 1, 4
      call new_case(model, state, 100, [0.01_wp], trim(shapes(s)), [1.0_wp, 2.0_wp, 0.5_wp], 10.0_wp, 0.05_wp)
      call new_contact_work(work, model)
      seen = 0
      do trial = 1, 20
        state%target%position = uniform_point(random)
        state%target%attitude = random_quaternion(random)
        do i = 1, 100
          far = 2.0_wp*uniform(random)
          state%node_position(i, :) = state%target%position + far*random_direction(random)
        end do
        call detect_contacts(model, state, work, r)
        k = 0
        r = rotation_matrix(state%target%attitude)
        do i = 1, 100
          y(:, 1) = multiply(transpose(r), state%node_position(i, :) - state%target%position)
          call signed_distance(model%target%shape, 1, y, d, g)
          if (d(1) > 0.05_wp) cycle
          k = k + 1
          if (k > work%list%n) exit
          call expect_equal(work%list%node_a(k), i, 'node of contact')
          call expect_close(work%list%gap(k), d(1), 'gap', atol=1.0e-14_wp)
          call expect_close(work%list%normal(k, :), multiply(r, g(:, 1)), 'normal', atol=1.0e-13_wp)
        end do
        call expect_equal(work%list%n, k, 'number of contacts')
        seen = seen + k
      end do
      call expect(seen > 100, 'enough contacts were drawn')
    end do
  end subroutine detection

  subroutine single_is_several()
    type(contact_list_t) :: list, pair
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    integer :: trial
    do trial = 1, 200
      call random_contacts(random, 1, 0.1_wp, 4.0_wp, list, body)
      if (list%normal_velocity(1) > 0.0_wp) cycle
      contact%push_only = mod(trial, 2) == 0
      contact%restitution = uniform(random)
      call resolve_contacts(contact, body, list, solver, report)
      call reserve_contacts(pair, 2)
      pair%n = 2
      pair%node_a(1:2) = [1, 2]
      pair%node_b(1:2) = [1, 2]
      pair%weight_a(1:2) = 1.0_wp
      pair%inverse_mass_a(1:2) = list%inverse_mass_a(1)
      pair%normal(1:2, :) = spread(list%normal(1, :), 1, 2)
      pair%arm(1:2, :) = spread(list%arm(1, :), 1, 2)
      pair%velocity(1, :) = list%velocity(1, :)
      ! The second one parts so fast that it never matters.
      pair%velocity(2, :) = list%velocity(1, :) + 100.0_wp*list%normal(1, :)
      pair%normal_velocity(1) = list%normal_velocity(1)
      pair%normal_velocity(2) = list%normal_velocity(1) + 100.0_wp
      call resolve_contacts(contact, body, pair, solver, report)
      call expect_close(pair%impulse(1), list%impulse(1), 'impulse', rtol=1.0e-13_wp)
      call expect(.not. abs(pair%impulse(2)) > 0.0_wp, 'no impulse on the parting node')
    end do
  end subroutine single_is_several

  !> x.M x > 0 and y.M x = x.M y, from velocities gained by impulses.
  subroutine positive_definite()
    use castnet_dense_impulse, only: delassus_matrix
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(random_t) :: random
    real(wp), allocatable :: m(:, :), row(:, :), x(:)
    integer :: n, i, trial
    do trial = 1, 20
      n = 30
      call random_contacts(random, n, 0.1_wp, 2.0_wp, list, body)
      row = rows_of(list)
      m = delassus_matrix(list, body, row)
      call expect(maxval(abs(m - transpose(m))) <= 1.0e-14_wp*maxval(abs(m)), 'symmetric')
      allocate (x(n))
      do i = 1, n
        x(i) = normal_draw(random)
      end do
      call expect(dot_product(x, matmul(m, x)) > 0.99_wp*minval(list%inverse_mass_a(1:n))*sum(x**2), 'positive definite')
      deallocate (x)
    end do
  end subroutine positive_definite

  function rows_of(list) result(row)
    type(contact_list_t), intent(in) :: list
    real(wp), allocatable :: row(:, :)
    integer :: i
    allocate (row(list%n, 6))
    do i = 1, list%n
      row(i, 1:3) = list%normal(i, :)
      row(i, 4) = list%arm(i, 2)*list%normal(i, 3) - list%arm(i, 3)*list%normal(i, 2)
      row(i, 5) = list%arm(i, 3)*list%normal(i, 1) - list%arm(i, 1)*list%normal(i, 3)
      row(i, 6) = list%arm(i, 1)*list%normal(i, 2) - list%arm(i, 2)*list%normal(i, 1)
    end do
  end function rows_of

  !> General matrices, some whose first pivots are zero, and a singular one.
  subroutine elimination()
    use castnet_dense_impulse, only: solve_linear
    use lapack_in_tests, only: solution
    integer, parameter :: sizes(6) = [1, 2, 3, 8, 31, 100]
    type(random_t) :: random
    real(wp), allocatable :: matrix(:, :), a(:, :), b(:), x(:)
    logical :: regular
    integer :: k, n, i, j, trial
    do k = 1, size(sizes)
      n = sizes(k)
      do trial = 1, 5
        allocate (matrix(n, n), b(n))
        do j = 1, n
          b(j) = normal_draw(random)
          do i = 1, n
            matrix(i, j) = normal_draw(random)
          end do
        end do
        if (trial == 1 .and. n > 1) matrix(1:n/2, 1:n/2) = 0.0_wp
        a = matrix
        x = b
        call solve_linear(n, a, x, regular)
        call expect(regular, 'a random matrix is regular')
        call expect(maxval(abs(matmul(matrix, x) - b)) <= 1.0e-14_wp*n*maxval(abs(matrix))*maxval(abs(x)), 'it is solved')
        call expect_close(x, solution(matrix, b), 'as LAPACK solves it', atol=1.0e-9_wp*maxval(abs(x)))
        matrix(:, n) = 0.0_wp
        call solve_linear(n, matrix, b, regular)
        call expect(.not. regular, 'a singular matrix is seen')
        deallocate (matrix, b)
      end do
    end do
  end subroutine elimination

  !> Residual of 0 <= j, 0 <= v+ + e min(v-,0), computed here from the dense M.
  subroutine complementarity()
    use castnet_dense_impulse, only: delassus_matrix
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    integer, parameter :: sizes(6) = [2, 5, 20, 100, 400, 2000]
    real(wp), allocatable :: slack(:), j(:), m(:, :)
    real(wp) :: worst, masses(3)
    integer :: k, c, n
    character(len=80) :: words
    masses = [1.0e-6_wp, 1.0e-2_wp, 1.0_wp]
    contact%restitution = 0.7_wp
    do c = 1, 3
      do k = 1, 6
        n = sizes(k)
        call random_contacts(random, n, masses(c), 2.0_wp, list, body)
        call resolve_contacts(contact, body, list, solver, report)
        m = delassus_matrix(list, body, rows_of(list))
        allocate (j(n), source=list%impulse(1:n))
        allocate (slack(n))
        slack = list%normal_velocity(1:n) + matmul(m, j) + report%restitution*min(list%normal_velocity(1:n), 0.0_wp)
        worst = max(maxval(merge(abs(slack), 0.0_wp, j > 0.0_wp)), -minval(slack))
        call expect(minval(j) >= 0.0_wp, 'no impulse pulls')
        call expect(worst <= 1.0e-10_wp, 'residual below 1e-10')
        call expect(report%residual <= 1.0e-10_wp .and. report%converged, 'reported residual below 1e-10')
        if (n == 2000) then
          write (words, '(a,i0,a,es9.2,a,i0,a,f8.5)') 'n = ', n, ': residual', worst, ', iterations ', report%iterations, &
            ', restitution', report%restitution
          call note(words)
        end if
        deallocate (j, slack)
      end do
    end do
  end subroutine complementarity

  !> A random cloud of nodes on a spinning box, both kinds of impulses.
  subroutine event_ledger()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    type(random_t) :: random
    real(wp) :: p(3), l(3), energy, e_after
    integer :: trial
    do trial = 1, 40
      call random_cloud(random, model, state)
      model%contact%push_only = mod(trial, 2) == 0
      model%contact%dense = mod(trial/2, 2) == 1
      model%contact%restitution = uniform(random)
      if (mod(trial, 5) == 0) model%contact%restitution = 1.0_wp
      call new_contact_work(work, model)
      p = momentum(model, state)
      l = angular_momentum(model, state)
      energy = kinetic_energy(model, state)
      ! Positions on the surface or outside: no projection.
      call handle_contacts(model, state, work, error)
      call expect(state%tally%contacts > 3_i8, 'several contacts')
      e_after = kinetic_energy(model, state)
      call expect_close(momentum(model, state), p, 'momentum', atol=1.0e-14_wp*sqrt(2.0_wp*energy*20.0_wp))
      call expect_close(angular_momentum(model, state), l, 'angular momentum', atol=1.0e-13_wp*sqrt(2.0_wp*energy*20.0_wp))
      call expect_close(state%ledger%contact_loss, energy - e_after, 'energy booked', atol=1.0e-13_wp*energy)
      if (.not. model%contact%push_only .and. model%contact%restitution >= 1.0_wp) &
        call expect_close(e_after, energy, 'elastic equality keeps the energy', rtol=1.0e-13_wp)
      if (model%contact%push_only) call expect(state%tally%min_impulse >= 0.0_wp, 'no impulse pulls')
    end do
  end subroutine event_ledger

  !> Nodes just above the faces of a spinning, moving box.
  subroutine random_cloud(random, model, state)
    type(random_t), intent(inout) :: random
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    real(wp) :: r(3, 3), y(3), half(3), out, speed
    integer :: i, axis
    call new_case(model, state, 40, [0.1_wp], 'box', [1.0_wp, 2.0_wp, 0.5_wp], 3.0_wp, 0.01_wp)
    call set_body(model, 3.0_wp, [1.0_wp, 0.3_wp, 1.2_wp])
    half = [0.5_wp, 1.0_wp, 0.25_wp]
    state%target%position = random_direction(random)
    state%target%velocity = random_direction(random)
    state%target%angular_velocity = random_direction(random)
    state%target%attitude = random_quaternion(random)
    r = rotation_matrix(state%target%attitude)
    do i = 1, 40
      axis = 1 + int(3.0_wp*uniform(random))
      y = half*(2.0_wp*uniform_point(random) - 1.0_wp)
      out = 0.005_wp*uniform(random)
      y(axis) = sign(half(axis) + out, uniform(random) - 0.5_wp)
      state%node_position(i, :) = state%target%position + multiply(r, y)
      speed = uniform(random)
      state%node_velocity(i, :) = speed*random_direction(random)
    end do
  end subroutine random_cloud

  subroutine no_energy()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp) :: work, least, e
    integer :: trial, n, lowered
    character(len=80) :: words
    lowered = 0
    least = 1.0_wp
    do trial = 1, 20000
      n = 1 + int(12.0_wp*uniform(random))
      call random_contacts(random, n, 10.0_wp**(4.0_wp*uniform(random) - 3.0_wp), 2.0_wp, list, body)
      e = uniform(random)
      contact%restitution = merge(1.0_wp, e, mod(trial, 2) == 0)
      call resolve_contacts(contact, body, list, solver, report)
      work = sum(list%impulse(1:n)**2*list%inverse_mass_a(1:n))
      call expect(report%energy_loss >= -1.0e-12_wp*work, 'an event created energy')
      call expect(report%converged, 'converged')
      if (report%restitution < contact%restitution) lowered = lowered + 1
      least = min(least, report%restitution/max(contact%restitution, 1.0e-3_wp))
    end do
    write (words, '(a,f6.2,a,f6.3,a)') 'restitution lowered in', 100.0_wp*lowered/20000.0_wp, &
      ' % of random events, at most to', least, ' of the scene''s'
    call note(words)
  end subroutine no_energy

  !> Nodes pressed into a box by stretched cables.
  subroutine projection()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    type(random_t) :: random
    real(wp) :: c(3), elastic, d(40), g(3, 40), y(3, 40), r(3, 3), l(3)
    integer :: i, trial
    do trial = 1, 10
      call random_cloud(random, model, state)
      do i = 1, 40
        state%node_position(i, :) = state%node_position(i, :) - 0.003_wp*random_direction(random)
      end do
      call add_cables(model, reshape([([i, i + 1], i=1, 39)], [2, 39]), 0.3_wp, 50.0_wp)
      call new_contact_work(work, model)
      c = centre_of_mass(model, state)
      l = angular_momentum(model, state)
      elastic = elastic_energy(model, state)
      call handle_contacts(model, state, work, error)
      call expect_close(centre_of_mass(model, state), c, 'common centre of mass', atol=3.0e-16_wp*10.0_wp)
      call expect_close(state%ledger%projection_work, elastic_energy(model, state) - elastic, 'projection work', &
                        atol=1.0e-13_wp*elastic)
      call expect(abs(state%ledger%projection_work) > 0.0_wp, 'something was moved')
      r = rotation_matrix(state%target%attitude)
      do i = 1, 40
        y(:, i) = multiply(transpose(r), state%node_position(i, :) - state%target%position)
      end do
      call signed_distance(model%target%shape, 40, y, d, g)
      call expect(minval(d) >= -1.0e-8_wp, 'nothing is left below the surface')
      call expect_close(state%tally%deepest_penetration, max(0.0_wp, -minval(d)), 'depth after correction', atol=1.0e-12_wp)
      ! Equality leaves positions alone.
      call random_cloud(random, model, state)
      model%contact%push_only = .false.
      call new_contact_work(work, model)
      state%node_position(1, :) = state%target%position
      c = state%node_position(1, :)
      call handle_contacts(model, state, work, error)
      call expect_close(state%node_position(1, :), c, 'equality moves no node', atol=0.0_wp)
      call expect_close(state%tally%deepest_penetration, 0.25_wp, 'depth', rtol=1.0e-12_wp)
    end do
  end subroutine projection

  !> In a frame that turns at (0,-n,0), a body that stands still in it has the inertial
  !> rate (0,-n,0): a resting node is then no approaching node.
  subroutine orbital()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: r(3, 3)
    call new_case(model, state, 1, [0.1_wp], 'box', [1.0_wp, 1.0_wp, 1.0_wp], 3.0_wp, 0.01_wp)
    call new_contact_work(work, model)
    model%orbit_rate = 0.2_wp
    state%target%angular_velocity = [0.0_wp, -0.2_wp, 0.0_wp]
    state%node_position(1, :) = [0.505_wp, 0.1_wp, 0.3_wp]
    call detect_contacts(model, state, work, r)
    call expect_equal(work%list%n, 1, 'contacts')
    call expect_close(work%list%velocity(1, :), [0.0_wp, 0.0_wp, 0.0_wp], 'relative velocity', atol=1.0e-16_wp)
    call handle_contacts(model, state, work, error)
    call expect_equal(int(state%tally%contacts), 0, 'impulses')
  end subroutine orbital

  subroutine fixed_ends()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    ! A free node on a fixed wall rebounds by e; a fixed node there is no contact.
    call new_case(model, state, 2, [0.1_wp], 'box', [1.0_wp, 1.0_wp, 1.0_wp], 0.0_wp, 0.01_wp)
    call fix_node(2)
    call new_contact_work(work, model)
    model%contact%restitution = 0.5_wp
    state%node_position(1, :) = [0.505_wp, 0.1_wp, 0.3_wp]
    state%node_position(2, :) = [0.505_wp, -0.1_wp, 0.3_wp]
    state%node_velocity(1, :) = [-2.0_wp, 1.0_wp, 0.0_wp]
    call handle_contacts(model, state, work, error)
    call expect_equal(work%list%n, 1, 'contacts')
    call expect_close(state%node_velocity(1, :), [1.0_wp, 1.0_wp, 0.0_wp], 'rebound', atol=1.0e-15_wp)
    call expect_close(state%target%velocity, [0.0_wp, 0.0_wp, 0.0_wp], 'the wall stands', atol=0.0_wp)
    ! A free box runs squarely into two fixed pins and comes back.
    call new_case(model, state, 3, [0.1_wp], 'box', [1.0_wp, 1.0_wp, 1.0_wp], 3.0_wp, 0.01_wp)
    call fix_node(1)
    call fix_node(2)
    call new_contact_work(work, model)
    model%contact%restitution = 0.5_wp
    state%target%velocity = [2.0_wp, 0.0_wp, 0.0_wp]
    state%node_position(1, :) = [0.505_wp, 0.3_wp, 0.0_wp]
    state%node_position(2, :) = [0.505_wp, -0.3_wp, 0.0_wp]
    state%node_position(3, :) = [5.0_wp, 0.0_wp, 0.0_wp]
    call handle_contacts(model, state, work, error)
    call expect_equal(work%list%n, 2, 'contacts')
    call expect_close(state%target%velocity, [-1.0_wp, 0.0_wp, 0.0_wp], 'body rebounds off pins', atol=1.0e-14_wp)
    call expect_close(state%target%angular_velocity, [0.0_wp, 0.0_wp, 0.0_wp], 'without turning', atol=1.0e-14_wp)
    call expect_close(state%node_velocity(1, :), [0.0_wp, 0.0_wp, 0.0_wp], 'pins stand', atol=0.0_wp)
    call expect_close(state%ledger%contact_loss, 0.5_wp*3.0_wp*(4.0_wp - 1.0_wp), 'energy booked', rtol=1.0e-13_wp)
  contains
    subroutine fix_node(i)
      integer, intent(in) :: i
      model%net%fixed(i) = .true.
      model%net%inverse_mass(i) = 0.0_wp
    end subroutine fix_node
  end subroutine fixed_ends

  subroutine tally()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    integer :: bin
    call new_case(model, state, 3, [0.1_wp], 'box', [1.0_wp, 1.0_wp, 1.0_wp], 0.0_wp, 0.01_wp)
    model%net%is_bullet(3) = .true.
    call new_contact_work(work, model)
    state%time = 7.0_wp
    state%node_position(1, :) = [0.505_wp, 0.1_wp, 0.3_wp]
    state%node_position(2, :) = [0.505_wp, -0.1_wp, 0.3_wp]
    state%node_position(3, :) = [-0.505_wp, -0.1_wp, 0.3_wp]
    state%node_velocity(1, 1) = -1.0_wp
    state%node_velocity(2, 1) = -3.0_wp
    state%node_velocity(3, 1) = 9.0_wp
    call handle_contacts(model, state, work, error)
    call expect_equal(int(state%tally%contacts), 3, 'contacts')
    call expect_close(state%tally%max_impulse, 0.6_wp, 'largest', rtol=1.0e-14_wp)
    call expect_close(state%tally%min_impulse, 0.2_wp, 'smallest', rtol=1.0e-14_wp)
    call expect_close(state%tally%impulse_sum, 0.8_wp, 'sum', rtol=1.0e-14_wp)
    call expect_close(state%tally%max_bullet_impulse, 1.8_wp, 'bullet', rtol=1.0e-14_wp)
    call expect_close(state%first_contact, 7.0_wp, 'first contact', atol=0.0_wp)
    call expect_equal(int(sum(state%impulse_histogram)), 2, 'histogram')
    bin = 1 + floor(200.0_wp*log10(0.6_wp/1.0e-14_wp))
    call expect_equal(int(state%impulse_histogram(bin)), 1, 'bin of the largest')
    call expect(work%acted, 'says that it acted')
    ! Everything parts now: nothing more happens.
    call handle_contacts(model, state, work, error)
    call expect_equal(int(state%tally%contacts), 3, 'contacts')
    call expect(.not. work%acted, 'says that it did not act')
  end subroutine tally

  !> Straight flights from random places: touching happens only after the bound; and the
  !> bound is not idle: for one node it is the flight itself.
  subroutine horizon()
    type(model_t) :: model
    type(state_t) :: state
    type(random_t) :: random
    real(wp) :: t, dt, x(3), moved(3)
    integer :: trial, k, i
    do trial = 1, 30
      call new_case(model, state, 12, [0.1_wp], 'sphere', [1.0_wp, 0.0_wp, 0.0_wp], 3.0_wp, 0.01_wp)
      model%gravity = [0.0_wp, 0.0_wp, -9.0_wp]
      model%target%external_force = 2.0_wp*random_direction(random)
      state%target%position = [10.0_wp, 0.0_wp, 0.0_wp]
      state%target%velocity = random_direction(random)
      do i = 1, 12
        state%node_position(i, :) = 3.0_wp*random_direction(random)
        state%node_velocity(i, :) = 5.0_wp*random_direction(random) + [5.0_wp, 0.0_wp, 0.0_wp]
      end do
      t = earliest_contact_time(model, state)
      call expect(t > 0.05_wp, 'some time is skipped')
      do k = 1, 50
        dt = t*k/50.0_wp
        moved = state%target%position + dt*state%target%velocity &
                + 0.5_wp*dt**2*(model%gravity + model%target%external_force/3.0_wp)
        do i = 1, 12
          x = state%node_position(i, :) + dt*state%node_velocity(i, :) + 0.5_wp*dt**2*model%gravity
          call expect(sqrt(sum((x - moved)**2)) > 0.51_wp, 'touches before the bound')
        end do
      end do
    end do
    call new_case(model, state, 1, [0.1_wp], 'sphere', [1.0_wp, 0.0_wp, 0.0_wp], 3.0_wp, 0.01_wp)
    state%target%position = [10.51_wp, 0.0_wp, 0.0_wp]
    state%node_velocity(1, :) = [2.0_wp, 0.0_wp, 0.0_wp]
    call expect_close(earliest_contact_time(model, state), 5.0_wp, 'a single node''s flight', rtol=1.0e-8_wp)
    model%orbit_rate = 1.0e-3_wp
    call expect_close(earliest_contact_time(model, state), 0.0_wp, 'no bound in an orbital frame', atol=0.0_wp)
  end subroutine horizon

end module test_contact
