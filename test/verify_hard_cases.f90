!> Contact where it is hardest: extreme masses, edges and corners, nodes that start inside,
!> hundreds of contacts on one face, a taut net over an edge. Momentum, energy and
!> penetration are what is asked of each.
module verify_hard_cases
  use, intrinsic :: iso_fortran_env, only: compiler_options
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_model, only: model_t, method_rk4
  use castnet_state, only: state_t
  use castnet_shape, only: new_shape, signed_distance
  use castnet_stepper, only: work_t
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts
  use castnet_diagnostics, only: record_history
  use castnet_record, only: history_row_t
  use contact_cases, only: new_case, set_body, momentum, angular_momentum, kinetic_energy, centre_of_mass, random_t, uniform, &
                           uniform_point, random_direction
  use scenes, only: net_of, ready, fly
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_hard_cases

contains

  subroutine run_verify_hard_cases()
    call test_case('hard cases: nodes a million times lighter and heavier than the target', mass_ratios)
    call test_case('hard cases: nodes on edges, corners and faces', edges_and_corners)
    call test_case('hard cases: nodes that start inside', starts_inside)
    call test_case('hard cases: 400 contacts on one face', one_face)
    call test_case('hard cases: a fixed target, restitution 0 and 1', fixed_target)
    call test_case('hard cases: a taut cable pressed over the edges of a box', taut_over_edges)
    call test_case('hard cases: a taut net pressed over the edges of a box for 10 s', taut_net)
  end subroutine run_verify_hard_cases

  !> 40 nodes about a box of 1 kg, sunk in by up to the threshold; without friction and with it.
  subroutine mass_ratios()
    real(wp), parameter :: ratios(4) = [1.0e-6_wp, 1.0e-3_wp, 1.0e3_wp, 1.0e6_wp]
    integer, parameter :: n = 40
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    type(random_t) :: random
    real(wp) :: p(3), l(3), energy, scale, rise, worst_p, worst_l, lag, approach, side(3)
    integer :: i, k, e, f
    character(len=160) :: words
    do k = 1, size(ratios)
      rise = -huge(1.0_wp)
      worst_p = 0.0_wp
      worst_l = 0.0_wp
      lag = 0.0_wp
      do e = 0, 1
        do f = 0, 1
          call new_case(model, state, n, [ratios(k)], 'box', [1.0_wp, 0.8_wp, 0.6_wp], 1.0_wp, 2.0e-3_wp)
          call set_body(model, 1.0_wp, [0.083_wp, 0.113_wp, 0.137_wp])
          model%contact%restitution = real(e, wp)
          model%contact%friction = 0.3_wp*f
          do i = 1, n
            side = [1.0_wp, 0.8_wp, 0.6_wp]*(uniform_point(random) - 0.5_wp)
            select case (mod(i, 3))
            case (0)
              side(1) = sign(0.5_wp + 1.0e-3_wp*(uniform(random) - 0.5_wp), side(1))
            case (1)
              side(2) = sign(0.4_wp + 1.0e-3_wp*(uniform(random) - 0.5_wp), side(2))
            case (2)
              side(3) = sign(0.3_wp + 1.0e-3_wp*(uniform(random) - 0.5_wp), side(3))
            end select
            state%node_position(i, :) = side
            state%node_velocity(i, :) = random_direction(random)
          end do
          state%target%angular_velocity = [0.3_wp, -0.2_wp, 0.5_wp]
          call new_contact_work(work, model)
          p = momentum(model, state)
          l = angular_momentum(model, state)
          energy = kinetic_energy(model, state)
          scale = sqrt(2.0_wp*energy*(1.0_wp + n*ratios(k)))
          call handle_contacts(model, state, work, error)
          call expect(.not. allocated(error), 'no error')
          rise = max(rise, kinetic_energy(model, state)/energy - 1.0_wp)
          worst_p = max(worst_p, maxval(abs(momentum(model, state) - p))/scale)
          worst_l = max(worst_l, maxval(abs(angular_momentum(model, state) - l))/scale)
          approach = state%tally%contact_residual
          lag = max(lag, approach)
          call expect(state%tally%deepest_penetration <= 1.0e-8_wp, 'nothing is left inside')
          call expect(state%tally%contacts > 0, 'they touch')
          call expect(state%tally%min_impulse >= 0.0_wp, 'no impulse pulls')
        end do
      end do
      write (words, '(a,es7.0,4(a,es9.1))') 'ratio ', ratios(k), ': energy rises by ', rise, ', momentum off ', worst_p, &
        ', angular ', worst_l, ', residual [m/s] ', lag
      call note(words)
      call expect(rise <= 1.0e-12_wp, 'energy never rises')
      call expect(worst_p <= 1.0e-13_wp, 'momentum')
      ! The projection moves nodes after the impulses: angular momentum changes by depth times momentum.
      call expect(worst_l <= 2.0e-2_wp, 'angular momentum but for the projection')
      call expect(lag <= 1.0e-6_wp, 'the conditions of contact hold')
    end do
  end subroutine mass_ratios

  !> Straight at the centre of mass of a box at rest; e = 1: each node comes back.
  subroutine edges_and_corners()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: v(3), energy, y(3, 1), d(1), normal(3, 1)
    integer :: i, j, k, n
    n = 0
    call new_case(model, state, 26, [0.01_wp], 'box', [1.0_wp, 0.8_wp, 0.6_wp], 0.0_wp, 1.0e-3_wp)
    do i = -1, 1
      do j = -1, 1
        do k = -1, 1
          if (i == 0 .and. j == 0 .and. k == 0) cycle
          n = n + 1
          state%node_position(n, :) = [0.5_wp*i, 0.4_wp*j, 0.3_wp*k]
          state%node_velocity(n, :) = -state%node_position(n, :)
          y(:, 1) = state%node_position(n, :)
          call signed_distance(model%target%shape, 1, y, d, normal)
          call expect_close(d(1), 0.0_wp, 'on the surface', atol=1.0e-15_wp)
          call expect_close(sum(normal(:, 1)**2), 1.0_wp, 'a unit normal', rtol=1.0e-14_wp)
          call expect(sum(normal(:, 1)*y(:, 1)) > 0.0_wp, 'that points outwards')
        end do
      end do
    end do
    call new_contact_work(work, model)
    energy = kinetic_energy(model, state)
    call handle_contacts(model, state, work, error)
    call expect(state%tally%contacts == 26, 'all touch')
    call expect_close(kinetic_energy(model, state), energy, 'energy', rtol=1.0e-14_wp)
    do i = 1, n
      v = state%node_velocity(i, :)
      y(:, 1) = state%node_position(i, :)
      call signed_distance(model%target%shape, 1, y, d, normal)
      call expect(sum(v*normal(:, 1)) > 0.0_wp, 'every node leaves the surface')
    end do
  end subroutine edges_and_corners

  !> At the very centre, just under an edge, deep in: out in one event, with the common
  !> centre of mass where it was.
  subroutine starts_inside()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: c(3), p(3), y(3, 1), d(1), normal(3, 1), energy
    integer :: i, free
    do free = 0, 1
      call new_case(model, state, 4, [0.01_wp], 'box', [1.0_wp, 0.8_wp, 0.6_wp], real(free, wp), 1.0e-3_wp)
      model%contact%restitution = 0.0_wp
      state%node_position(1, :) = 0.0_wp
      state%node_position(2, :) = [0.499_wp, 0.399_wp, 0.0_wp]
      state%node_position(3, :) = [0.1_wp, 0.2_wp, 0.25_wp]
      state%node_position(4, :) = [-0.4999_wp, -0.3999_wp, -0.2999_wp]
      state%node_velocity(3, 3) = -1.0_wp
      call new_contact_work(work, model)
      c = centre_of_mass(model, state)
      p = momentum(model, state)
      energy = kinetic_energy(model, state)
      call handle_contacts(model, state, work, error)
      call expect(.not. allocated(error), 'no error')
      call expect(kinetic_energy(model, state) <= energy, 'nobody is shot out: no energy is gained')
      if (free == 1) call expect_close(momentum(model, state), p, 'momentum', atol=1.0e-16_wp)
      if (free == 1) call expect_close(centre_of_mass(model, state), c, 'centre of mass', atol=1.0e-14_wp)
      call expect(state%tally%deepest_penetration <= 1.0e-6_wp, 'all are out, as the tally says')
      if (free == 1) cycle
      do i = 1, 4
        y(:, 1) = state%node_position(i, :)
        call signed_distance(model%target%shape, 1, y, d, normal)
        call expect(d(1) >= -1.0e-8_wp, 'every node is out')
      end do
    end do
  end subroutine starts_inside

  !> A 20 x 20 carpet that comes down flat on a free box: one elastic collision of two
  !> masses, although the body's motion alone would leave 394 of 400 impulses open.
  subroutine one_face()
    integer, parameter :: side = 20, n = side*side
    real(wp), parameter :: m = 1.0e-4_wp, body = 0.5_wp, v = 2.0_wp
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: total, after(2)
    integer :: i, j, k, dense
    total = n*m
    do dense = 0, 1
      call new_case(model, state, n, [m], 'box', [1.0_wp, 1.0_wp, 1.0_wp], body, 1.0e-3_wp)
      model%contact%dense = dense == 1
      k = 0
      do i = 1, side
        do j = 1, side
          k = k + 1
          state%node_position(k, :) = [(i - 10.5_wp)*0.045_wp, (j - 10.5_wp)*0.045_wp, 0.5_wp + 5.0e-4_wp]
          state%node_velocity(k, 3) = -v
        end do
      end do
      call new_contact_work(work, model)
      call handle_contacts(model, state, work, error)
      after = [(body - total)/(body + total)*v, -2.0_wp*total/(body + total)*v]
      call expect_close(state%node_velocity(1:n, 3), spread(after(1), 1, n), 'nodes', rtol=1.0e-12_wp)
      call expect_close(state%target%velocity(3), after(2), 'target', rtol=1.0e-12_wp)
      call expect(maxval(abs(state%target%angular_velocity)) <= 1.0e-12_wp, 'the target does not turn')
      call expect(state%tally%contact_residual <= 1.0e-10_wp, 'residual')
      call expect(state%tally%contacts == n, 'all touch')
    end do
  end subroutine one_face

  !> v+ = -e v- along the normal, the tangential velocity as it was.
  subroutine fixed_target()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    integer :: e
    do e = 0, 1
      call new_case(model, state, 2, [1.0e-6_wp, 1.0e6_wp], 'sphere', [1.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, 1.0e-3_wp)
      model%contact%restitution = real(e, wp)
      state%node_position(1, :) = [0.0_wp, 0.0_wp, 0.5_wp]
      state%node_position(2, :) = [-0.5_wp, 0.0_wp, 0.0_wp]
      state%node_velocity(1, :) = [0.3_wp, -0.4_wp, -2.0_wp]
      state%node_velocity(2, :) = [3.0_wp, 0.1_wp, 0.2_wp]
      call new_contact_work(work, model)
      call handle_contacts(model, state, work, error)
      call expect_close(state%node_velocity(1, :), [0.3_wp, -0.4_wp, 2.0_wp*e], 'light node', atol=1.0e-15_wp)
      call expect_close(state%node_velocity(2, :), [-3.0_wp*e, 0.1_wp, 0.2_wp], 'heavy node', atol=1.0e-14_wp)
      call expect(maxval(abs(state%target%velocity)) + maxval(abs(state%target%angular_velocity)) <= 0.0_wp, 'the target stays')
    end do
  end subroutine fixed_target

  !> 31 nodes between two fixed ends below the top of a fixed box, stretched by a third:
  !> nodes and cables ride on both edges. For 0.5 s: nodes with friction, cables without and with it.
  subroutine taut_over_edges()
    integer, parameter :: n = 31
    real(wp), parameter :: m = 1.0e-3_wp, stiffness = 200.0_wp, h = 1.0e-4_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    type(history_row_t) :: row
    real(wp) :: position(n, 3), s, start, own, rise
    logical :: fixed(n)
    integer :: nodes(2, n - 1), i, run, k
    character(len=160) :: words
    do run = 1, 3
      fixed = .false.
      fixed([1, n]) = .true.
      do i = 1, n
        s = real(i - 1, wp)/(n - 1)
        ! A tent over the box's top, which it is to come down on.
        position(i, :) = [0.6_wp*(s - 0.5_wp), 0.013_wp*s, 0.15_wp - 0.5_wp*abs(s - 0.5_wp)]
        if (i < n) nodes(:, i) = [i, i + 1]
      end do
      call net_of(spread(m, 1, n), fixed, nodes, spread(stiffness, 1, n - 1), spread(0.017_wp, 1, n - 1), &
                  spread(0.05_wp, 1, n - 1), .true., position, 0.0_wp*position, model, state)
      model%net%is_bullet = spread(.false., 1, n)
      allocate (model%target, model%contact, state%target)
      call new_shape(model%target%shape, 'box', [0.2_wp, 0.2_wp, 0.2_wp], error)
      call set_body(model, 0.0_wp, [1.0_wp, 1.0_wp, 1.0_wp])
      model%contact%threshold = 1.0e-3_wp
      model%contact%restitution = 0.1_wp
      model%contact%friction = merge(0.0_wp, 0.2_wp, run == 2)
      model%contact%detect_cables = run > 1
      call ready(model, state, work, method_rk4, h)
      row = record_history(model, state)
      start = row%kinetic_net + row%elastic
      rise = 0.0_wp
      do k = 1, 50
        call fly(model, state, work, 100)
        row = record_history(model, state)
        own = row%kinetic_net + row%elastic - row%projection_work
        rise = max(rise, (own - start)/start)
        start = own
      end do
      write (words, '(2(a,es9.2),a,i0,2(a,es9.2))') 'deepest ', state%tally%deepest_penetration, ' m, largest rise of energy ', &
        rise, ', contacts ', state%tally%contacts, ', least impulse ', state%tally%min_impulse, ', residual ', &
        state%tally%contact_residual
      call note(words)
      call expect(state%tally%contacts > 100, 'it rides on the box')
      call expect(state%tally%deepest_penetration <= 1.0e-4_wp, 'less than 0.1 mm inside after correction')
      call expect(rise <= 1.0e-4_wp, 'energy less the projection''s work does not rise from row to row')
      call expect(state%tally%min_impulse >= 0.0_wp, 'no impulse pulls')
      call expect(state%tally%contact_residual <= 1.0e-10_wp, 'the conditions of contact hold')
    end do
  end subroutine taut_over_edges

  !> Four such cables side by side and their cross cables, 10 s with friction (1 s in the check
  !> build): it settles, and hardly moves any more.
  subroutine taut_net()
    integer, parameter :: n = 13, rows = 4
    real(wp), parameter :: h = 5.0e-4_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(error_t), allocatable :: error
    type(history_row_t) :: row
    real(wp) :: position(n*rows, 3), settled(n*rows, 3), s, start, own, rise, first, drift
    logical :: fixed(n*rows)
    integer :: nodes(2, (n - 1)*rows + n*(rows - 1)), i, k, c, seconds
    character(len=160) :: words
    fixed = .false.
    c = 0
    do k = 1, rows
      do i = 1, n
        s = real(i - 1, wp)/(n - 1)
        position((k - 1)*n + i, :) = [0.6_wp*(s - 0.5_wp), 0.05_wp*(k - 2.2_wp) + 0.013_wp*s, 0.15_wp - 0.5_wp*abs(s - 0.5_wp)]
        fixed((k - 1)*n + i) = i == 1 .or. i == n
        if (i < n) call join((k - 1)*n + i, (k - 1)*n + i + 1)
        if (k < rows) call join((k - 1)*n + i, k*n + i)
      end do
    end do
    call net_of(spread(2.0e-3_wp, 1, n*rows), fixed, nodes, spread(80.0_wp, 1, c), spread(0.043_wp, 1, c), spread(0.5_wp, 1, c), &
                .true., position, 0.0_wp*position, model, state)
    model%net%is_bullet = spread(.false., 1, n*rows)
    allocate (model%target, model%contact, state%target)
    call new_shape(model%target%shape, 'box', [0.2_wp, 0.2_wp, 0.2_wp], error)
    call set_body(model, 0.0_wp, [1.0_wp, 1.0_wp, 1.0_wp])
    model%contact%threshold = 1.0e-3_wp
    model%contact%restitution = 0.1_wp
    model%contact%friction = 0.2_wp
    model%contact%detect_cables = .true.
    call ready(model, state, work, method_rk4, h)
    row = record_history(model, state)
    first = row%kinetic_net + row%elastic
    start = first
    rise = 0.0_wp
    seconds = merge(1, 10, index(compiler_options(), '-fcheck') > 0)
    do k = 1, 10*seconds
      if (k == 9*seconds) settled = state%node_position(1:n*rows, :)
      call fly(model, state, work, 200)
      row = record_history(model, state)
      own = row%kinetic_net + row%elastic - row%projection_work
      rise = max(rise, (own - start)/first)
      start = own
    end do
    ! On top of the box; the spans beside it may go on swinging.
    drift = 0.0_wp
    do k = 1, rows
      do i = 6, 8
        drift = max(drift, maxval(abs(state%node_position((k - 1)*n + i, :) - settled((k - 1)*n + i, :))))
      end do
    end do
    write (words, '(4(a,es9.2),a,i0)') 'deepest', state%tally%deepest_penetration, ' m, rise of energy', rise, &
      ', residual', state%tally%contact_residual, ', moved at the end', drift, ' m, contacts ', state%tally%contacts
    call note(words)
    call expect(state%tally%contacts > 1000, 'it rides on the box')
    call expect(state%tally%deepest_penetration <= 1.0e-3_wp, 'never farther inside than the contact threshold')
    call expect(rise <= 1.0e-4_wp, 'energy less the projection''s work does not rise from row to row')
    call expect(state%tally%min_impulse >= 0.0_wp, 'no impulse pulls')
    call expect(state%tally%contact_residual <= 1.0e-9_wp, 'the conditions of contact hold')
    ! Not nothing: the spans still swing a little and tug at it.
    if (seconds == 10) call expect(drift <= 1.0e-3_wp, 'it stays within a millimetre in the last second')
  contains
    subroutine join(a, b)
      integer, intent(in) :: a, b
      c = c + 1
      nodes(:, c) = [a, b]
    end subroutine join
  end subroutine taut_net

end module verify_hard_cases
