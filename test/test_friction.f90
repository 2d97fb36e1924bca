!> Coulomb friction of node contacts: its law, energy, sticking and sliding.
module test_friction
  use, intrinsic :: iso_fortran_env, only: compiler_options
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_model, only: model_t, contact_t
  use castnet_state, only: state_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t
  use castnet_contact_response, only: contact_solver_t, resolve_contacts
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts
  use contact_cases, only: new_case, set_body, momentum, angular_momentum, kinetic_energy, random_t, uniform, &
                           normal_draw, random_direction, random_contacts
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_test_friction

contains

  subroutine run_test_friction()
    call test_case('friction: contact law holds for every contact, up to 2000', law_holds)
    call test_case('friction: 1e5 random events never create energy', no_energy)
    call test_case('friction: events at which Newton''s method finds no zero', hard_events)
    call test_case('friction: Kane''s paradox, a single contact on a slender body', kane)
    call test_case('friction: a node on an incline sticks and slips at the right angle', incline)
    call test_case('friction: a block on an incline sticks and slips at the right angle', block_on_slope)
    call test_case('friction: a spinning body is braked by a net at rest', brake)
    call test_case('friction: without friction nothing changes', none_is_none)
  end subroutine run_test_friction

  !> Largest violation of the law at the velocities after [m/s], computed from the list's
  !> impulses, the bodies' own equations of motion and nothing else.
  real(wp) function violation(list, body, friction, e) result(worst)
    type(contact_list_t), intent(in) :: list
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: friction, e
    real(wp) :: p(6), twist(6), j(3), v(3), n(3), vn, vt(3), jn, jt(3), slack, speed, w
    integer :: i
    p = 0.0_wp
    do i = 1, list%n
      j = list%impulse(i)*list%normal(i, :) + list%friction_impulse(i, :)
      p(1:3) = p(1:3) + j
      p(4:6) = p(4:6) + cross3(list%arm(i, :), j)
    end do
    twist(1:3) = -body%inverse_mass*p(1:3)
    twist(4:6) = -matmul(body%inverse_inertia, p(4:6))
    worst = 0.0_wp
    do i = 1, list%n
      w = list%inverse_mass_a(i)
      n = list%normal(i, :)
      jn = list%impulse(i)
      jt = list%friction_impulse(i, :)
      v = list%velocity(i, :) + w*(jn*n + jt) - twist(1:3) - cross3(twist(4:6), list%arm(i, :))
      vn = sum(v*n)
      vt = v - vn*n
      slack = vn + e*min(list%normal_velocity(i), 0.0_wp)
      worst = max(worst, -slack, -jn*w)
      if (jn > 0.0_wp) worst = max(worst, abs(slack))
      worst = max(worst, abs(sum(jt*n))*w, w*(sqrt(sum(jt**2)) - friction*jn))
      speed = sqrt(sum(vt**2))
      ! It sticks, or friction is at its bound and straight against the sliding: both are
      ! mu jn |vt| + jt.vt = 0, whose roundings do not grow where the sliding is slow.
      worst = max(worst, w*(friction*jn*speed + sum(jt*vt)))
    end do
  end function violation

  pure function cross3(a, b) result(c)
    real(wp), intent(in) :: a(:), b(:)
    real(wp) :: c(3)
    c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function cross3

  subroutine law_holds()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    integer, parameter :: sizes(7) = [1, 2, 5, 20, 100, 400, 2000]
    real(wp), parameter :: masses(4) = [1.0e-5_wp, 1.0e-3_wp, 1.0e-1_wp, 10.0_wp]
    real(wp) :: worst, seen
    integer :: k, c, trial, most
    character(len=160) :: words
    do c = 1, 4
      worst = 0.0_wp
      most = 0
      do k = 1, 7
        do trial = 1, merge(40, 3, sizes(k) < 50)
          call random_contacts(random, sizes(k), masses(c), 2.0_wp, list, body)
          contact%friction = 10.0_wp**(2.0_wp*uniform(random) - 1.5_wp)
          contact%restitution = uniform(random)
          call resolve_contacts(contact, body, list, solver, report)
          seen = violation(list, body, contact%friction, report%restitution)
          worst = max(worst, seen)
          most = max(most, report%iterations)
          call expect(seen <= 1.0e-10_wp, 'law kept to 1e-10 m/s')
          call expect(report%converged .and. report%residual <= 1.0e-10_wp, 'and reported so')
        end do
      end do
      write (words, '(a,es8.1,a,es9.2,a,i0)') 'node mass', masses(c), ': worst violation', worst, ', most iterations ', most
      call note(words)
    end do
  end subroutine law_holds

  subroutine no_energy()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp) :: work, worst, gain, e
    integer :: trial, trials, n, lowered, stuck
    character(len=160) :: words
    lowered = 0
    stuck = 0
    worst = 0.0_wp
    gain = 0.0_wp
    ! The check build is sixty times slower.
    trials = merge(5000, 100000, index(compiler_options(), '-fcheck') > 0)
    do trial = 1, trials
      n = 1 + int(8.0_wp*uniform(random))
      call random_contacts(random, n, 10.0_wp**(5.0_wp*uniform(random) - 3.0_wp), 2.0_wp, list, body)
      e = uniform(random)
      contact%restitution = merge(1.0_wp, e, mod(trial, 2) == 0)
      contact%friction = 10.0_wp**(2.0_wp*uniform(random) - 1.0_wp)
      call resolve_contacts(contact, body, list, solver, report)
      work = sum((list%impulse(1:n)**2 + sum(list%friction_impulse(1:n, :)**2, 2))*list%inverse_mass_a(1:n))
      gain = max(gain, -report%energy_loss/max(work, tiny(1.0_wp)))
      call expect(report%energy_loss >= -1.0e-12_wp*work, 'an event created energy')
      if (report%residual > 1.0e-9_wp .or. .not. report%converged) stuck = stuck + 1
      worst = max(worst, report%residual)
      if (report%restitution < contact%restitution) lowered = lowered + 1
    end do
    write (words, '(a,f6.2,a,es9.2,a,es9.2)') 'restitution lowered in', 100.0_wp*lowered/trials, ' % of events, worst residual', &
      worst, ', largest relative gain', gain
    call note(words)
    call expect(stuck == 0, 'every event solved to 1e-9 m/s')
  end subroutine no_energy

  !> Two or three nodes much heavier than the body at friction 1.6 to 63: |F| has valleys that
  !> lead nowhere. Found among millions of random events; then such events at random.
  subroutine hard_events()
    integer(i8), parameter :: seeds(4) = [5496419884942629440_i8, 5851798113073749587_i8, 778851678108748849_i8, &
                                          1079566341386982806_i8]
    real(wp), parameter :: least(4) = [-1.0_wp, -1.0_wp, -1.0_wp, 0.0_wp], range(4) = [2.0_wp, 2.0_wp, 2.5_wp, 2.0_wp]
    type(random_t) :: random
    integer :: k
    do k = 1, 4
      random%s = seeds(k)
      call one_event(random, -3.0_wp, 5.0_wp, least(k), range(k))
    end do
    do k = 1, merge(500, 10000, index(compiler_options(), '-fcheck') > 0)
      call one_event(random, 0.0_wp, 2.0_wp, 0.0_wp, 2.0_wp)
    end do
  end subroutine hard_events

  !> Decades of the nodes' masses and of the coefficient of friction from `a` over `b`.
  subroutine one_event(random, mass_a, mass_b, friction_a, friction_b)
    type(random_t), intent(inout) :: random
    real(wp), intent(in) :: mass_a, mass_b, friction_a, friction_b
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    integer :: n
    n = 1 + int(8.0_wp*uniform(random))
    call random_contacts(random, n, 10.0_wp**(mass_a + mass_b*uniform(random)), 2.0_wp, list, body)
    contact%restitution = uniform(random)
    contact%friction = 10.0_wp**(friction_a + friction_b*uniform(random))
    call resolve_contacts(contact, body, list, solver, report)
    call expect(report%converged .and. report%residual <= 1.0e-9_wp, 'solved to 1e-9 m/s')
    call expect(violation(list, body, contact%friction, report%restitution) <= 1.0e-8_wp, 'and by its own count')
  end subroutine one_event

  !> A slender rod hit obliquely near its end, e = 1: Newton's law alone creates energy.
  subroutine kane()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp) :: angle, j(3), loss, u(3), a
    integer :: i, k, paradox
    paradox = 0
    do k = 1, 200
      call random_contacts(random, 1, 1.0e6_wp, 0.0_wp, list, body)
      body%mass = 1.0_wp
      body%inverse_mass = 1.0_wp
      body%inertia = 0.0_wp
      body%inverse_inertia = 0.0_wp
      do i = 1, 3
        body%inertia(i, i) = merge(1.0e-4_wp, 1.0_wp/12.0_wp, i == 1)
        body%inverse_inertia(i, i) = 1.0_wp/body%inertia(i, i)
      end do
      a = 0.5_wp*3.14159_wp*k/200.0_wp
      list%normal(1, :) = [sin(a), cos(a), 0.0_wp]
      list%arm(1, :) = [0.5_wp, 0.0_wp, 0.0_wp]
      angle = 2.0_wp*uniform(random)
      list%velocity(1, :) = -list%normal(1, :) + angle*[cos(a), -sin(a), 0.0_wp]
      list%normal_velocity(1) = -1.0_wp
      contact%restitution = 1.0_wp
      contact%friction = 0.5_wp
      call resolve_contacts(contact, body, list, solver, report)
      j = list%impulse(1)*list%normal(1, :) + list%friction_impulse(1, :)
      ! Energy of rod and (almost immovable) node, from the impulse alone.
      u = list%velocity(1, :)
      loss = -(sum(j*u) + 0.5_wp*(sum(j**2)*(1.0_wp + list%inverse_mass_a(1)) &
                                  + sum(cross3(list%arm(1, :), j)*matmul(body%inverse_inertia, cross3(list%arm(1, :), j)))))
      call expect(loss >= -1.0e-12_wp, 'the rod gained energy')
      call expect_close(report%energy_loss, loss, 'energy booked', atol=1.0e-12_wp)
      if (report%restitution < 1.0_wp) paradox = paradox + 1
    end do
    call expect(paradox > 0, 'the set holds paradox cases')
  end subroutine kane

  !> tan(angle) against mu; sliding with g (sin - mu cos). A step: gravity, contact, move.
  subroutine incline()
    real(wp), parameter :: mu = 0.5_wp, g = 9.81_wp, h = 1.0e-3_wp, parts(4) = [0.5_wp, 0.999_wp, 1.001_wp, 1.5_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: angle, speed, run, exact
    integer :: k, s, trial
    do trial = 1, 4
      angle = atan(mu)*parts(trial)
      call new_case(model, state, 1, [0.1_wp], 'box', [100.0_wp, 100.0_wp, 1.0_wp], 0.0_wp, 1.0e-3_wp)
      model%contact%friction = mu
      model%contact%restitution = 0.0_wp
      call new_contact_work(work, model)
      ! The slope stays level, gravity leans.
      state%node_position(1, :) = [0.0_wp, 0.0_wp, 0.5_wp]
      do s = 1, 1000
        state%node_velocity(1, :) = state%node_velocity(1, :) + h*g*[sin(angle), 0.0_wp, -cos(angle)]
        call handle_contacts(model, state, work, error)
        state%node_position(1, :) = state%node_position(1, :) + h*state%node_velocity(1, :)
      end do
      speed = state%node_velocity(1, 1)
      run = state%node_position(1, 1)
      exact = max(0.0_wp, g*(sin(angle) - mu*cos(angle)))*h*1000
      call expect_close(speed, exact, 'speed after a second', atol=1.0e-11_wp)
      if (trial <= 2) call expect_close(run, 0.0_wp, 'it sticks', atol=0.0_wp)
      if (trial > 2) call expect(run > 0.0_wp, 'it slips')
      k = trial
    end do
  end subroutine incline

  !> The body itself: a block on four nodes held fast, of which the loads of only three follow
  !> from statics. Whatever they are, it slides with g (sin - mu cos) and does not turn.
  subroutine block_on_slope()
    real(wp), parameter :: mu = 0.5_wp, g = 9.81_wp, h = 1.0e-3_wp, parts(4) = [0.5_wp, 0.999_wp, 1.001_wp, 1.2_wp]
    real(wp), parameter :: x(4) = [-0.3_wp, -0.3_wp, 0.3_wp, 0.3_wp], y(4) = [-0.3_wp, 0.3_wp, -0.3_wp, 0.3_wp]
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: angle, exact
    integer :: s, trial
    do trial = 1, 4
      angle = atan(mu)*parts(trial)
      call new_case(model, state, 4, [0.1_wp], 'box', [1.0_wp, 1.0_wp, 0.2_wp], 3.0_wp, 1.0e-3_wp)
      call set_body(model, 3.0_wp, [0.26_wp, 0.26_wp, 0.5_wp])
      model%net%inverse_mass = 0.0_wp
      model%net%fixed = .true.
      model%contact%friction = mu
      model%contact%restitution = 0.0_wp
      call new_contact_work(work, model)
      state%node_position(1:4, 1) = x
      state%node_position(1:4, 2) = y
      ! The slope stays level, gravity leans.
      state%target%position = [0.0_wp, 0.0_wp, 0.1_wp]
      do s = 1, 300
        state%target%velocity = state%target%velocity + h*g*[sin(angle), 0.0_wp, -cos(angle)]
        call handle_contacts(model, state, work, error)
        state%target%position = state%target%position + h*state%target%velocity
      end do
      exact = max(0.0_wp, g*(sin(angle) - mu*cos(angle)))*h*300
      call expect_close(state%target%velocity(1), exact, 'its speed', atol=1.0e-9_wp)
      call expect_close(state%target%velocity(2:3), [0.0_wp, 0.0_wp], 'along the slope', atol=1.0e-9_wp)
      call expect_close(state%target%angular_velocity, [0.0_wp, 0.0_wp, 0.0_wp], 'it does not turn', atol=1.0e-8_wp)
      if (trial > 2) call expect(state%target%position(1) > 0.0_wp, 'it slips')
      call expect(state%tally%contact_residual <= 1.0e-9_wp, 'the law holds')
    end do
  end subroutine block_on_slope

  !> Nodes at rest all round a ball's equator press on it while it spins.
  subroutine brake()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: a, l(3), p(3), spin, energy, r(3), inward(3)
    integer :: i, s
    call new_case(model, state, 24, [0.01_wp], 'sphere', [1.0_wp, 0.0_wp, 0.0_wp], 5.0_wp, 1.0e-3_wp)
    call set_body(model, 5.0_wp, [0.5_wp, 0.5_wp, 0.5_wp])
    model%contact%friction = 0.3_wp
    model%contact%restitution = 0.5_wp
    call new_contact_work(work, model)
    state%target%angular_velocity = [0.0_wp, 0.0_wp, 2.0_wp]
    do i = 1, 24
      a = 2.0_wp*3.14159265358979_wp*i/24.0_wp
      state%node_position(i, :) = 0.5_wp*[cos(a), sin(a), 0.0_wp]
    end do
    l = angular_momentum(model, state)
    p = momentum(model, state)
    do s = 1, 200
      spin = state%target%angular_velocity(3)
      do i = 1, 24
        ! Pressed on: each node is given the same inward speed every time.
        r = state%node_position(i, :)/sqrt(sum(state%node_position(i, :)**2))
        inward = -0.01_wp*r
        state%node_velocity(i, :) = state%node_velocity(i, :) - sum(state%node_velocity(i, :)*r)*r + inward
      end do
      energy = kinetic_energy(model, state)
      call handle_contacts(model, state, work, error)
      call expect(kinetic_energy(model, state) <= energy*(1.0_wp + 1.0e-14_wp), 'energy never grows')
      if (s < 20) call expect(state%target%angular_velocity(3) < spin, 'the spin falls')
    end do
    call expect_close(angular_momentum(model, state), l, 'angular momentum', atol=1.0e-12_wp)
    call expect_close(momentum(model, state), p, 'momentum', atol=1.0e-13_wp)
    ! In the end the nodes go round with the ball: I w = (I + n m r^2) w'.
    call expect_close(state%target%angular_velocity(3), 2.0_wp*0.5_wp/(0.5_wp + 24*0.01_wp*0.25_wp), 'common spin', rtol=1.0e-9_wp)
  end subroutine brake

  !> mu so small that it does nothing: the frictionless solver's impulses.
  subroutine none_is_none()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver, plain
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    real(wp), allocatable :: j(:)
    integer :: trial
    do trial = 1, 50
      call random_contacts(random, 30, 0.05_wp, 2.0_wp, list, body)
      contact%restitution = 0.5_wp
      contact%push_only = mod(trial, 2) == 0
      contact%friction = 0.0_wp
      call resolve_contacts(contact, body, list, plain, report)
      allocate (j(30), source=list%impulse(1:30))
      contact%friction = 1.0e-300_wp
      call resolve_contacts(contact, body, list, solver, report)
      call expect_close(list%impulse(1:30), j, 'impulses', rtol=1.0e-11_wp)
      deallocate (j)
    end do
  end subroutine none_is_none

end module test_friction
