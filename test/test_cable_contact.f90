!> Cables in contact: coupled impulses, degenerate systems, bodies that nodes let through.
module test_cable_contact
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_model, only: model_t, contact_t, method_rk4
  use castnet_state, only: state_t, impulse_bins
  use castnet_shape, only: new_shape, new_compound
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t, reserve_contacts
  use castnet_contact_response, only: contact_solver_t, resolve_contacts
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts
  use castnet_stepper, only: work_t
  use castnet_vector, only: cross
  use contact_cases, only: new_case, add_cables, set_body, momentum, angular_momentum, kinetic_energy, elastic_energy, &
                           centre_of_mass, random_t, uniform, normal_draw, random_direction, random_quaternion, &
                           random_contacts, random_cable_contacts
  use scenes, only: net_of, ready, fly
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_cable_contact

contains

  subroutine run_test_cable_contact()
    call test_case('cables: coupled impulses against the dense method', coupled_against_dense)
    call test_case('cables: two nodes and their cable on one face', degenerate)
    call test_case('cables: 2000 coupled contacts to 1e-10', many)
    call test_case('cables: friction of coupled contacts keeps its law and energy', coupled_friction)
    call test_case('cables: friction of 1 to 3 on patches of net is solved', patches_with_friction)
    call test_case('cables: an event keeps momentum and books its energy', event_ledger)
    call test_case('cables: a sphere that falls through nodes is held by cables', sphere)
    call test_case('cables: the edge of a box rides on a cable', edge)
    call test_case('cables: a net squeezed between two parts of a body is not thrown about', squeezed)
    call test_case('cables: zero-length and duplicate cables do no harm', odd_cables)
  end subroutine run_test_cable_contact

  subroutine coupled_against_dense()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report, dense_report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp), allocatable :: gained(:)
    real(wp) :: worst
    integer :: trial, n
    character(len=100) :: words
    contact%detect_cables = .true.
    worst = 0.0_wp
    do trial = 1, 300
      n = 2 + int(30.0_wp*uniform(random))
      call random_cable_contacts(random, n, n, 10.0_wp**(3.0_wp*uniform(random) - 3.0_wp), list, body)
      contact%restitution = uniform(random)
      contact%dense = .true.
      call resolve_contacts(contact, body, list, solver, dense_report)
      allocate (gained(n), source=solver%normal%gained(1:n))
      contact%dense = .false.
      call resolve_contacts(contact, body, list, solver, report)
      call expect(report%converged .and. report%residual <= 1.0e-10_wp, 'converged to 1e-10 m/s')
      call expect(minval(list%impulse(1:n)) >= 0.0_wp, 'no impulse pulls')
      ! Restitution is lowered by a search that ends within a thousandth of the energy.
      if (abs(report%restitution - dense_report%restitution) <= 0.0_wp) then
        worst = max(worst, maxval(abs(solver%normal%gained(1:n) - gained)))
        call expect_close(solver%normal%gained(1:n), gained, 'velocities gained', atol=1.0e-9_wp)
      end if
      deallocate (gained)
    end do
    write (words, '(a,es9.2)') 'largest difference of velocities [m/s]', worst
    call note(words)
  end subroutine coupled_against_dense

  !> Three rows of rank two: impulses are not unique, velocities are. The middle of the
  !> cable and both ends approach at 1: all must leave at e.
  subroutine degenerate()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    integer :: i, dense
    call reserve_contacts(list, 3)
    list%n = 3
    list%node_a(1:3) = [1, 2, 1]
    list%node_b(1:3) = [1, 2, 2]
    list%share(1:3) = [0.0_wp, 0.0_wp, 0.5_wp]
    list%weight_a(1:3) = [1.0_wp, 1.0_wp, 0.5_wp]
    list%inverse_mass_a(1:3) = 10.0_wp
    list%inverse_mass_b(1:3) = [0.0_wp, 0.0_wp, 10.0_wp]
    list%normal(1:3, :) = 0.0_wp
    list%normal(1:3, 3) = 1.0_wp
    list%arm(1:3, :) = 0.0_wp
    list%arm(1:3, 1) = [-1.0_wp, 1.0_wp, 0.0_wp]
    list%velocity(1:3, :) = 0.0_wp
    list%velocity(1:3, 3) = -1.0_wp
    list%normal_velocity(1:3) = -1.0_wp
    contact%detect_cables = .true.
    contact%restitution = 0.5_wp
    do dense = 0, 1
      contact%dense = dense == 1
      do i = 1, 2
        body = body_inertia_t()
        if (i == 2) then
          body%free = .true.
          body%mass = 2.0_wp
          body%inverse_mass = 0.5_wp
          body%inertia = reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
          body%inverse_inertia = body%inertia
        end if
        call resolve_contacts(contact, body, list, solver, report)
        call expect_close(list%normal_velocity(1:3) + solver%normal%gained(1:3), [0.5_wp, 0.5_wp, 0.5_wp], 'rebound', &
                          atol=1.0e-10_wp)
        call expect(minval(list%impulse(1:3)) >= 0.0_wp, 'no impulse pulls')
        call expect_close(list%impulse(1) + list%impulse(2) + list%impulse(3), &
                          merge(0.3_wp, 1.5_wp/(1.0_wp/0.2_wp + 0.5_wp), i == 1), 'together', rtol=1.0e-9_wp)
      end do
    end do
  end subroutine degenerate

  !> A square net laid on a face: every node and every cable's point, in one group.
  subroutine many()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    integer, parameter :: side = 26
    real(wp) :: w(side*side)
    integer :: i, k, c, trial, right, n
    character(len=120) :: words
    contact%detect_cables = .true.
    do trial = 1, 2
      n = side*side + 2*side*(side - 1)
      call random_contacts(random, n, 1.0e-3_wp, 0.0_wp, list, body)
      do i = 1, side*side
        ! Bullets among threads: masses over five decades make the system ill-conditioned.
        w(i) = 1.0e3_wp*10.0_wp**(merge(5.0_wp, 0.5_wp, trial == 2)*(uniform(random) - 0.5_wp))
      end do
      c = 0
      do i = 1, side
        do k = 1, side
          right = (i - 1)*side + k
          call add(right, right)
          if (k < side) call add(right, right + 1)
          if (i < side) call add(right, right + side)
        end do
      end do
      call expect_equal(c, n, 'contacts')
      contact%restitution = 0.3_wp
      call resolve_contacts(contact, body, list, solver, report)
      call expect(report%converged .and. report%residual <= 1.0e-10_wp, 'residual below 1e-10')
      call expect(minval(list%impulse(1:n)) >= 0.0_wp, 'no impulse pulls')
      write (words, '(i0,a,es9.2,a,i0,a,f8.5)') n, ' contacts: residual', report%residual, ', iterations ', &
        report%iterations, ', restitution', report%restitution
      call note(words)
    end do
  contains
    subroutine add(a, b)
      integer, intent(in) :: a, b
      c = c + 1
      list%node_a(c) = a
      list%node_b(c) = b
      list%share(c) = uniform(random)
      if (a == b) list%share(c) = 0.0_wp
      list%weight_a(c) = 1.0_wp - list%share(c)
      list%inverse_mass_a(c) = w(a)
      list%inverse_mass_b(c) = merge(0.0_wp, w(b), a == b)
      list%normal(c, 1) = 0.1_wp*normal_draw(random)
      list%normal(c, 2) = 0.1_wp*normal_draw(random)
      list%normal(c, 3) = 1.0_wp
      list%normal(c, :) = list%normal(c, :)/sqrt(sum(list%normal(c, :)**2))
      list%normal_velocity(c) = sum(list%velocity(c, :)*list%normal(c, :))
    end subroutine add
  end subroutine many

  subroutine coupled_friction()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp) :: work, worst
    integer :: trial, n, i, stuck
    character(len=100) :: words
    contact%detect_cables = .true.
    worst = 0.0_wp
    stuck = 0
    do trial = 1, 500
      n = 2 + int(20.0_wp*uniform(random))
      call random_cable_contacts(random, n, n, 10.0_wp**(2.0_wp*uniform(random) - 3.0_wp), list, body)
      contact%restitution = uniform(random)
      contact%friction = uniform(random)
      call resolve_contacts(contact, body, list, solver, report)
      work = sum((list%impulse(1:n)**2 + sum(list%friction_impulse(1:n, :)**2, 2))*solver%normal%inverse_weight(1:n))
      call expect(report%energy_loss >= -1.0e-11_wp*work, 'an event created energy')
      do i = 1, n
        call expect(sqrt(sum(list%friction_impulse(i, :)**2)) <= contact%friction*list%impulse(i)*(1.0_wp + 1.0e-9_wp) &
                    + 1.0e-14_wp, 'inside the cone')
      end do
      if (.not. report%converged) stuck = stuck + 1
      worst = max(worst, report%residual)
    end do
    write (words, '(a,es9.2,a,i0)') 'worst residual', worst, ', not converged: ', stuck
    call note(words)
    call expect(stuck == 0, 'every event is solved')
  end subroutine coupled_friction

  !> A patch of net in motion against a spinning body, contacts at some of its nodes and
  !> cables: velocities that belong together, as in a capture. Friction of 1 to 3, without
  !> rebound, so that there is an answer: everything sticks to the body, if nothing better.
  subroutine patches_with_friction()
    integer, parameter :: side = 4
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp) :: x(3, side*side), v(3, side*side), w(side*side), rate(3), spread
    integer :: trial, i, stuck
    contact%detect_cables = .true.
    contact%restitution = 0.0_wp
    stuck = 0
    do trial = 1, 300
      call random_contacts(random, 4*side*side, 0.01_wp, 0.0_wp, list, body)
      list%n = 0
      contact%friction = 1.0_wp + 2.0_wp*uniform(random)
      rate = random_direction(random)
      spread = 0.5_wp*uniform(random)
      do i = 1, side*side
        x(:, i) = [0.2_wp*((i - 1)/side) - 0.3_wp, 0.2_wp*mod(i - 1, side) - 0.3_wp, 0.3_wp]
        v(:, i) = 0.5_wp*random_direction(random)
        v(3, i) = v(3, i) - uniform(random)
        w(i) = 50.0_wp + 100.0_wp*uniform(random)
      end do
      do i = 1, side*side
        if (uniform(random) < 0.5_wp) call add(i, i)
        if (mod(i, side) /= 0 .and. uniform(random) < 0.6_wp) call add(i, i + 1)
        if (i + side <= side*side .and. uniform(random) < 0.6_wp) call add(i, i + side)
      end do
      call resolve_contacts(contact, body, list, solver, report)
      if (.not. report%converged .or. report%residual > 1.0e-9_wp) stuck = stuck + 1
    end do
    call expect(stuck == 0, 'every event is solved')
  contains
    subroutine add(a, b)
      integer, intent(in) :: a, b
      real(wp) :: s
      integer :: c
      s = uniform(random)
      if (a == b) s = 0.0_wp
      list%n = list%n + 1
      c = list%n
      list%node_a(c) = a
      list%node_b(c) = b
      list%share(c) = s
      list%weight_a(c) = 1.0_wp - s
      list%inverse_mass_a(c) = w(a)
      list%inverse_mass_b(c) = merge(0.0_wp, w(b), a == b)
      list%arm(c, :) = (1.0_wp - s)*x(:, a) + s*x(:, b)
      list%velocity(c, :) = (1.0_wp - s)*v(:, a) + s*v(:, b) - cross(rate, list%arm(c, :))
      list%normal(c, :) = spread*random_direction(random)
      list%normal(c, 3) = list%normal(c, 3) + 1.0_wp
      list%normal(c, :) = list%normal(c, :)/sqrt(sum(list%normal(c, :)**2))
      list%normal_velocity(c) = sum(list%velocity(c, :)*list%normal(c, :))
    end subroutine add
  end subroutine patches_with_friction

  !> A patch of cables, stretched, falls on a spinning box over its edges.
  subroutine event_ledger()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    type(random_t) :: random
    real(wp) :: p(3), l(3), c(3), energy, elastic, after
    integer :: trial, i, k, m, nodes(2, 84)
    m = 0
    do i = 1, 7
      do k = 1, 7
        if (k < 7) call join(7*(i - 1) + k, 7*(i - 1) + k + 1)
        if (i < 7) call join(7*(i - 1) + k, 7*i + k)
      end do
    end do
    do trial = 1, 20
      call new_case(model, state, 49, [0.05_wp], 'box', [0.5_wp, 0.4_wp, 0.3_wp], 3.0_wp, 0.01_wp)
      call set_body(model, 3.0_wp, [0.06_wp, 0.08_wp, 0.1_wp])
      call add_cables(model, nodes, 0.14_wp, 50.0_wp)
      model%contact%detect_cables = .true.
      model%contact%restitution = 0.2_wp*mod(trial, 6)
      if (trial > 10) model%contact%friction = 0.3_wp
      state%target%angular_velocity = random_direction(random)
      state%target%attitude = random_quaternion(random)
      do i = 1, 7
        do k = 1, 7
          state%node_position(7*(i - 1) + k, :) = [0.16_wp*(i - 4), 0.16_wp*(k - 4), &
                                                   0.15_wp + 0.15_wp*uniform(random)]
          state%node_velocity(7*(i - 1) + k, :) = [0.0_wp, 0.0_wp, -1.0_wp] + 0.2_wp*random_direction(random)
        end do
      end do
      call new_contact_work(work, model)
      p = momentum(model, state)
      l = angular_momentum(model, state)
      c = centre_of_mass(model, state)
      energy = kinetic_energy(model, state)
      elastic = elastic_energy(model, state)
      call handle_contacts(model, state, work, error)
      after = kinetic_energy(model, state)
      call expect(any(work%list%node_a(1:work%list%n) /= work%list%node_b(1:work%list%n)), 'cables are in contact')
      call expect_close(momentum(model, state), p, 'momentum', atol=1.0e-14_wp*10.0_wp)
      call expect_close(state%ledger%contact_loss, energy - after, 'energy booked', atol=1.0e-11_wp*energy)
      call expect_close(centre_of_mass(model, state), c, 'common centre of mass', atol=1.0e-15_wp)
      call expect_close(state%ledger%projection_work, elastic_energy(model, state) - elastic, 'projection work', &
                        atol=1.0e-12_wp*elastic)
      call expect(state%ledger%contact_loss >= -1.0e-12_wp*energy, 'no energy is created')
    end do
  contains
    subroutine join(a, b)
      integer, intent(in) :: a, b
      m = m + 1
      nodes(:, m) = [a, b]
    end subroutine join
  end subroutine event_ledger

  !> A net of 5 x 5 squares on a frame, mesh 0.1 m, and a ball of 1.05 to 1.4 meshes that
  !> comes through the middle of the middle square.
  subroutine sphere()
    real(wp), parameter :: mesh = 0.1_wp
    real(wp), parameter :: diameters(3) = [1.05_wp, 1.2_wp, 1.4_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: position(36, 3), lowest
    logical :: fixed(36)
    integer :: i, k, m, d, cables, s, nodes(2, 60)
    m = 0
    do i = 1, 6
      do k = 1, 6
        position(6*(i - 1) + k, :) = mesh*[i - 3.5_wp, k - 3.5_wp, 0.0_wp]
        fixed(6*(i - 1) + k) = i == 1 .or. i == 6 .or. k == 1 .or. k == 6
        if (k < 6) then
          m = m + 1
          nodes(:, m) = [6*(i - 1) + k, 6*(i - 1) + k + 1]
        end if
        if (i < 6) then
          m = m + 1
          nodes(:, m) = [6*(i - 1) + k, 6*i + k]
        end if
      end do
    end do
    do d = 1, 3
      do cables = 0, 1
        call net_of(spread(3.0e-3_wp, 1, 36), fixed, nodes, spread(500.0_wp, 1, 60), spread(mesh*0.999_wp, 1, 60), &
                    spread(0.2_wp, 1, 60), .true., position, 0.0_wp*position, model, state)
        allocate (model%target, state%target, model%contact)
        call new_shape(model%target%shape, 'sphere', [diameters(d)*mesh, 0.0_wp, 0.0_wp], error)
        call set_body(model, 0.02_wp, [4.0e-5_wp, 4.0e-5_wp, 4.0e-5_wp])
        model%contact%threshold = 5.0e-4_wp
        model%contact%restitution = 0.5_wp
        model%contact%detect_cables = cables == 1
        state%target%position = [0.0_wp, 0.0_wp, 0.1_wp]
        state%target%velocity = [0.0_wp, 0.0_wp, -0.1_wp]
        call ready(model, state, work, method_rk4, 2.0e-4_wp)
        lowest = 0.1_wp
        do s = 1, 300
          call fly(model, state, work, 50)
          lowest = min(lowest, state%target%position(3))
        end do
        if (cables == 0) then
          call expect(state%target%position(3) < -0.15_wp, 'nodes let it through')
          call expect_equal(int(state%tally%contacts), 0, 'without a touch')
        else
          call expect(lowest > -0.5_wp*diameters(d)*mesh, 'cables hold it')
          call expect(state%tally%contacts > 0, 'it touches')
          call expect(state%tally%deepest_penetration < 1.0e-4_wp, 'it does not sink in')
        end if
      end do
    end do
  end subroutine sphere

  !> A box on its edge comes down across a taut line, between two of its nodes; gravity.
  subroutine edge()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: position(4, 3)
    integer :: i
    position = 0.0_wp
    position(:, 1) = [-1.5_wp, -0.5_wp, 0.5_wp, 1.5_wp]
    call net_of(spread(0.1_wp, 1, 4), [.true., .false., .false., .true.], reshape([1, 2, 2, 3, 3, 4], [2, 3]), &
                spread(2000.0_wp, 1, 3), spread(1.0_wp, 1, 3), spread(5.0_wp, 1, 3), .true., position, 0.0_wp*position, &
                model, state)
    allocate (model%target, state%target, model%contact)
    call new_shape(model%target%shape, 'box', [0.2_wp, 0.4_wp, 0.2_wp], error)
    call set_body(model, 1.0_wp, [0.02_wp, 0.007_wp, 0.02_wp])
    model%contact%threshold = 2.0e-3_wp
    model%contact%restitution = 0.0_wp
    model%contact%friction = 1.0_wp
    model%contact%detect_cables = .true.
    model%gravity = [0.0_wp, 0.0_wp, -1.0_wp]
    ! Turned by 45 degrees about y, its edge along y points down.
    state%target%attitude = [cos(0.392699081698724_wp), 0.0_wp, sin(0.392699081698724_wp), 0.0_wp]
    state%target%position = [0.0_wp, 0.0_wp, 0.15_wp]
    call ready(model, state, work, method_rk4, 1.0e-3_wp)
    call fly(model, state, work, 500)
    call expect(state%tally%contacts > 10, 'it came to the line')
    call expect_close(state%tally%deepest_penetration, 0.0_wp, 'depth', atol=1.0e-5_wp)
    ! The line carries it: somewhere below, near its balance, edge above the line's lowest point.
    call expect(state%target%position(3) > -0.3_wp, 'it rides on the line')
    call expect(work%contact%list%n > 0, 'still in contact')
    do i = 1, work%contact%list%n
      call expect(work%contact%list%node_a(i) /= work%contact%list%node_b(i), 'by the cable, not by a node')
    end do
    ! The same without cables: it falls.
    model%contact%detect_cables = .false.
    call net_of_again()
    call fly(model, state, work, 1500)
    call expect(state%target%position(3) < -0.9_wp, 'nodes let it pass')
  contains
    subroutine net_of_again()
      state%node_position(:4, :) = position
      state%node_velocity = 0.0_wp
      state%target%position = [0.0_wp, 0.0_wp, 0.15_wp]
      state%target%velocity = 0.0_wp
      state%target%angular_velocity = 0.0_wp
      state%skip_contact_until = 0.0_wp
      call ready(model, state, work, method_rk4, 1.0e-3_wp)
    end subroutine net_of_again
  end subroutine edge

  !> Cables in the corner between a panel's thin edge and the rod that holds it, where places close
  !> to each other are pushed apart (nodes as in a capture of Envisat, nudged): no event moves a node
  !> farther than sixteen times the depth of the deepest point (along the way out: over a right angle
  !> at most sqrt 2 times the distance to a face), and each keeps the common centre of mass. (Without
  !> a bound the ends were thrown by up to 950 times the depth, in one capture with 5.9 kJ.)
  subroutine squeezed()
    real(wp), parameter :: half_spacing = 1.0e-3_wp  !! of the points that the depth is looked for at, at most [m]
    integer, parameter :: n = 5, nodes(2, 4) = reshape([4, 3, 1, 2, 2, 3, 3, 5], [2, 4])
    real(wp), parameter :: middle(3, 2) = reshape([0.0_wp, 0.0_wp, 0.0_wp, 8.0_wp, 0.0_wp, 0.0_wp], [3, 2])
    real(wp), parameter :: size_of(3, 2) = reshape([2.0_wp, 0.25_wp, 0.25_wp, 14.0_wp, 0.1_wp, 5.0_wp], [3, 2])
    real(wp), parameter :: place(3, n) = reshape([1.20_wp, -1.03_wp, 0.07_wp, 0.93_wp, 0.42_wp, -0.18_wp, 1.005_wp, -0.05_wp, &
                                                  0.31_wp, 0.11_wp, -0.90_wp, 0.51_wp, 1.13_wp, -0.37_wp, -1.25_wp], [3, n])
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    type(random_t) :: random
    real(wp) :: before(n, 3), c(3), depth, farthest, worst
    integer :: trial, i, deep
    character(len=80) :: words
    deep = 0
    worst = 0.0_wp
    do trial = 1, 400
      call new_case(model, state, n, [0.003_wp], 'box', [1.0_wp, 1.0_wp, 1.0_wp], 7000.0_wp, 0.02_wp)
      call new_compound(model%target%shape, ['box', 'box'], size_of, middle, spread([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 2, 2), error)
      call set_body(model, 7000.0_wp, [17.0e3_wp, 125.0e3_wp, 129.0e3_wp])
      call add_cables(model, nodes, 1.5_wp, 1000.0_wp)
      model%contact%detect_cables = .true.
      model%contact%restitution = 0.0_wp
      do i = 1, n
        state%node_position(i, :) = place(:, i) + 0.1_wp*uniform(random)*random_direction(random)
      end do
      before = state%node_position(:n, :)
      depth = deepest_point()
      call new_contact_work(work, model)
      c = centre_of_mass(model, state)
      call handle_contacts(model, state, work, error)
      farthest = maxval(norm2(state%node_position(:n, :) - before, 2))
      if (.not. depth > 1.0e-3_wp) cycle
      deep = deep + 1
      worst = max(worst, farthest/depth)
      call expect(farthest <= 16.0_wp*sqrt(2.0_wp)*(depth + half_spacing), 'no node is moved much farther than the net was deep')
      call expect_close(centre_of_mass(model, state), c, 'common centre of mass', atol=1.0e-13_wp)
    end do
    call expect(deep > 100, 'many lie in the body')
    write (words, '(i0, a, f0.1, a)') deep, ' events, farthest move ', worst, ' times the depth'
    call note(words)

  contains

    real(wp) function deepest_point()
      real(wp) :: q(3), d
      integer :: e, f, part
      deepest_point = 0.0_wp
      do e = 1, size(nodes, 2)
        do f = 0, 1000
          do part = 1, 2
            q = before(nodes(1, e), :) + f/1000.0_wp*(before(nodes(2, e), :) - before(nodes(1, e), :))
            d = maxval(abs(q - middle(:, part)) - 0.5_wp*size_of(:, part))
            deepest_point = max(deepest_point, -d)
          end do
        end do
      end do
    end function deepest_point

  end subroutine squeezed

  subroutine odd_cables()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    call new_case(model, state, 4, [0.1_wp], 'box', [1.0_wp, 1.0_wp, 1.0_wp], 3.0_wp, 0.01_wp)
    call add_cables(model, reshape([1, 2, 1, 2, 3, 4, 1, 3], [2, 4]), 1.0_wp, 1.0_wp)
    model%contact%detect_cables = .true.
    model%contact%restitution = 0.0_wp
    call new_contact_work(work, model)
    ! Cable 1-2 twice across an edge of the box, 3 and 4 at one place.
    state%node_position(1, :) = [0.8_wp, 0.0_wp, 0.205_wp]
    state%node_position(2, :) = [0.205_wp, 0.0_wp, 0.8_wp]
    state%node_position(3, :) = [0.505_wp, 0.3_wp, 0.3_wp]
    state%node_position(4, :) = [0.505_wp, 0.3_wp, 0.3_wp]
    state%node_velocity(:4, :) = spread([-1.0_wp, 0.0_wp, -1.0_wp], 1, 4)
    call handle_contacts(model, state, work, error)
    call expect_equal(work%list%n, 4, 'two nodes and the cable twice')
    call expect(all(abs(state%node_velocity) < 10.0_wp), 'finite')
    call expect(work%report%residual <= 1.0e-10_wp .and. work%report%converged, 'solved')
    call expect(state%tally%min_impulse >= 0.0_wp, 'no impulse pulls')
  end subroutine odd_cables

end module test_cable_contact
