!> Net on net: crossings are found and counted, and cables that are held apart stay so.
module test_self_contact
  use castnet_kinds, only: wp, i8
  use castnet_crossing, only: crossing_t, segments_cross, segment_gap
  use castnet_diagnostics, only: linear_momentum, angular_momentum, net_kinetic_energy
  use castnet_error, only: error_t
  use castnet_model, only: model_t, method_rk4, method_midpoint, self_contact_count, self_contact_impulses
  use castnet_shape, only: new_shape
  use castnet_state, only: state_t, self_all, self_taut, self_unresolved
  use castnet_stepper, only: work_t
  use castnet_vector, only: cross, dot
  use contact_cases, only: set_body, random_t, uniform, uniform_point
  use scenes, only: net_of, ready, fly, mechanical_energy, state_hash
  use testing, only: test_case, expect, expect_close, expect_equal
  implicit none
  private
  public :: run_test_self_contact

  integer, parameter :: n_loose = 40                     !! cables of the cloud
  real(wp), parameter :: threshold = 1.0e-3_wp, clearance = 1.0e-2_wp*threshold

contains

  subroutine run_test_self_contact()
    call test_case('self-contact: crossings of moving segments against finely sampled ones', crossings_against_samples)
    call test_case('self-contact: distance of two segments against samples', gap_against_samples)
    call test_case('self-contact: the count of a cloud of cables is the brute-force count', count_of_a_cloud)
    call test_case('self-contact: the inelastic impulse of two strings in closed form', two_strings)
    call test_case('self-contact: impulses keep momentum and lose what the ledger says', cloud_held_apart)
    call test_case('self-contact: a string thrown against a taut one does not pass', thrown_string)
    call test_case('self-contact: the list of near pairs and a restart decide nothing', list_decides_nothing)
  end subroutine run_test_self_contact

  !> The motion in many small parts: in each the volume's sign at both ends, and whether the
  !> lines meet within both segments. Pairs that meet at an end, or twice at once, are left out.
  subroutine crossings_against_samples()
    integer, parameter :: parts = 400
    type(random_t) :: random
    type(crossing_t) :: found
    real(wp) :: from(3, 4), to(3, 4), p(3, 4), u(3), v(3), w(3), n(3), side, side_before, s(2)
    integer :: trial, k, e, seen, compared, with_some
    logical :: doubtful
    compared = 0
    with_some = 0
    do trial = 1, 1000
      do e = 1, 4
        from(:, e) = uniform_point(random)
        to(:, e) = uniform_point(random)
      end do
      seen = 0
      doubtful = .false.
      side_before = 0.0_wp
      do k = 0, parts
        p = from + real(k, wp)/parts*(to - from)
        u = p(:, 2) - p(:, 1)
        v = p(:, 4) - p(:, 3)
        w = p(:, 3) - p(:, 1)
        n = cross(u, v)
        side = dot(n, w)
        doubtful = doubtful .or. (abs(side) < 1.0e-4_wp .and. dot(n, n) < 1.0e-2_wp)
        if (side*side_before < 0.0_wp) then
          s = [dot(cross(w, v), n), dot(cross(w, u), n)]/dot(n, n)
          doubtful = doubtful .or. any(abs(s) < 0.05_wp) .or. any(abs(s - 1.0_wp) < 0.05_wp)
          if (all(s > 0.0_wp .and. s < 1.0_wp)) seen = seen + 1
        end if
        side_before = side
      end do
      if (doubtful) cycle
      call segments_cross(from, to, found)
      if (found%n /= seen) call expect_equal(found%n, seen, 'crossings of a pair')
      compared = compared + 1
      if (seen > 0) with_some = with_some + 1
      if (found%n == 0) cycle
      p = from + found%time*(to - from)
      u = p(:, 1) + found%share(1)*(p(:, 2) - p(:, 1))
      v = p(:, 3) + found%share(2)*(p(:, 4) - p(:, 3))
      call expect_close(u, v, 'the two points at the crossing', atol=1.0e-10_wp)
      call expect_close(dot(found%normal, p(:, 2) - p(:, 1)), 0.0_wp, 'normal to the first', atol=1.0e-12_wp)
      call expect_close(dot(found%normal, p(:, 4) - p(:, 3)), 0.0_wp, 'normal to the second', atol=1.0e-12_wp)
    end do
    call expect(compared > 500 .and. with_some > 50, 'enough pairs are left to compare')
  end subroutine crossings_against_samples

  subroutine gap_against_samples()
    integer, parameter :: parts = 100
    type(random_t) :: random
    real(wp) :: p(3, 4), gap, least, d(3)
    integer :: trial, e, i, k
    do trial = 1, 30
      do e = 1, 4
        p(:, e) = uniform_point(random)
      end do
      if (trial == 28) p(:, 4) = p(:, 3) + 0.7_wp*(p(:, 2) - p(:, 1))   ! parallel
      if (trial == 29) p(:, 4) = p(:, 3)                                ! a point
      if (trial == 30) p(:, 2) = p(:, 1)
      least = huge(1.0_wp)
      do i = 0, parts
        do k = 0, parts
          d = (p(:, 1) + real(i, wp)/parts*(p(:, 2) - p(:, 1))) - (p(:, 3) + real(k, wp)/parts*(p(:, 4) - p(:, 3)))
          least = min(least, sqrt(dot(d, d)))
        end do
      end do
      gap = segment_gap(p(:, 1), p(:, 2), p(:, 3), p(:, 4))
      call expect(gap <= least + 1.0e-12_wp .and. gap >= least - 2.0e-2_wp, 'the least of all distances')
    end do
  end subroutine gap_against_samples

  !> Give a net a contact with a small target far away.
  subroutine far_target(model, state, mode)
    type(model_t), intent(inout) :: model
    type(state_t), intent(inout) :: state
    integer, intent(in) :: mode
    type(error_t), allocatable :: error
    model%net%is_bullet = spread(.false., 1, model%net%n_node)
    allocate (model%target, model%contact, state%target)
    call new_shape(model%target%shape, 'box', [0.1_wp, 0.1_wp, 0.1_wp], error)
    call set_body(model, 0.0_wp, [1.0_wp, 1.0_wp, 1.0_wp])
    state%target%position = [1.0e3_wp, 0.0_wp, 0.0_wp]
    model%contact%threshold = threshold
    model%contact%self_contact = mode
    allocate (state%self_contacts(3), source=0_i8)
  end subroutine far_target

  !> Cables without forces, in a unit box, every second of them longer than its natural length.
  subroutine cloud(mode, model, state)
    integer, intent(in) :: mode
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    type(random_t) :: random
    real(wp) :: position(2*n_loose, 3), velocity(2*n_loose, 3), mass(2*n_loose), natural(n_loose), one(n_loose)
    integer :: nodes(2, n_loose), c, i
    do c = 1, n_loose
      nodes(:, c) = [2*c - 1, 2*c]
      natural(c) = merge(1.0e-6_wp, 10.0_wp, modulo(c, 2) == 0)
    end do
    do i = 1, 2*n_loose
      position(i, :) = uniform_point(random)
      velocity(i, :) = uniform_point(random) - 0.5_wp
      mass(i) = 0.1_wp + uniform(random)
    end do
    one = 1.0_wp
    ! So soft that a pull changes nothing that is looked at.
    call net_of(mass, spread(.false., 1, 2*n_loose), nodes, 1.0e-25_wp*one, natural, 0.0_wp*one, .true., position, velocity, &
                model, state)
    call far_target(model, state, mode)
  end subroutine cloud

  !> Crossings of loose cables i and j on the straight way from one set of nodes to another.
  type(crossing_t) function crossings_of(i, j, before, after) result(found)
    integer, intent(in) :: i, j
    real(wp), intent(in) :: before(:, :), after(:, :)  !! (nodes,3)
    real(wp) :: from(3, 4), to(3, 4)
    integer :: e, node(4)
    node = [2*i - 1, 2*i, 2*j - 1, 2*j]
    do e = 1, 4
      from(:, e) = before(node(e), :)
      to(:, e) = after(node(e), :)
    end do
    call segments_cross(from, to, found)
  end function crossings_of

  !> Free flight is one motion along straight lines: looked at as a whole, pair by pair, it
  !> has the crossings that were counted in its steps.
  subroutine count_of_a_cloud()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(crossing_t) :: found
    real(wp), allocatable :: start(:, :)
    integer :: method, i, j, all_of_them, taut
    do method = method_rk4, method_midpoint
      call cloud(self_contact_count, model, state)
      start = state%node_position
      call ready(model, state, work, method, 0.01_wp)
      call fly(model, state, work, 150)
      all_of_them = 0
      taut = 0
      do i = 1, n_loose
        do j = i + 1, n_loose
          found = crossings_of(i, j, start, state%node_position)
          all_of_them = all_of_them + found%n
          if (modulo(i, 2) == 0 .and. modulo(j, 2) == 0) taut = taut + found%n
        end do
      end do
      call expect(taut > 5, 'there is something to count')
      call expect_equal(int(state%self_contacts(self_all)), all_of_them, 'crossings')
      call expect_equal(int(state%self_contacts(self_taut)), taut, 'of taut cables')
      call expect_equal(int(state%self_contacts(self_unresolved)), 0, 'none is undone, none tried')
    end do
  end subroutine count_of_a_cloud

  !> A cable along x at rest, and one along y that comes from above: j = v/w with the sum w of
  !> squared shares over masses, all nodes move by their part of it, and nothing approaches.
  subroutine two_strings()
    real(wp), parameter :: mass(4) = [1.0_wp, 2.0_wp, 0.5_wp, 0.3_wp], s = 0.3_wp, t = 0.6_wp, speed = 1.2_wp
    real(wp), parameter :: height = 0.0105_wp, sliding = 0.2_wp
    ! They meet where the upper one has slid to.
    real(wp), parameter :: met = s + sliding*height/speed, share(4) = [-(1.0_wp - met), -met, 1.0_wp - t, t]
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: position(4, 3), velocity(4, 3), w, j, p(3), l(3), gap, energy
    integer :: method, e
    do method = method_rk4, method_midpoint
      position = 0.0_wp
      velocity = 0.0_wp
      position(1:2, 1) = [-s, 1.0_wp - s]
      position(3:4, 2) = [-t, 1.0_wp - t]
      position(3:4, 3) = height
      velocity(3:4, 3) = -speed
      velocity(:, 1) = 0.1_wp
      velocity(3:4, 1) = 0.1_wp + sliding
      call net_of(mass, spread(.false., 1, 4), reshape([1, 2, 3, 4], [2, 2]), [1.0_wp, 1.0_wp], [9.0_wp, 9.0_wp], &
                  [0.0_wp, 0.0_wp], .true., position, velocity, model, state)
      call far_target(model, state, self_contact_impulses)
      p = linear_momentum(model, state)
      l = angular_momentum(model, state)
      energy = net_kinetic_energy(model%net, state%node_velocity)
      call ready(model, state, work, method, 1.0e-3_wp)
      call fly(model, state, work, 9)
      w = sum(share**2/mass)
      j = speed/w
      call expect_close(state%node_velocity(1, 3), -j*(1.0_wp - met)/mass(1), 'first node', rtol=1.0e-12_wp)
      call expect_close(state%node_velocity(2, 3), -j*met/mass(2), 'second node', rtol=1.0e-12_wp)
      call expect_close(state%node_velocity(3, 3), -speed + j*(1.0_wp - t)/mass(3), 'third node', rtol=1.0e-12_wp)
      call expect_close(state%node_velocity(4, 3), -speed + j*t/mass(4), 'fourth node', rtol=1.0e-12_wp)
      call expect_close(state%ledger%contact_loss, 0.5_wp*speed**2/w, 'energy lost', rtol=1.0e-12_wp)
      call expect_close(energy - net_kinetic_energy(model%net, state%node_velocity), 0.5_wp*speed**2/w, 'and gone', rtol=1.0e-12_wp)
      gap = 0.0_wp
      do e = 1, 4
        gap = gap + share(e)*state%node_position(e, 3)
      end do
      call expect_close(gap, clearance, 'the upper one is above', rtol=1.0e-9_wp)
      call expect_equal(int(state%self_contacts(self_all)), 1, 'one collision')
      call expect_equal(int(state%self_contacts(self_unresolved)), 0, 'undone')
      call expect_close(linear_momentum(model, state), p, 'momentum', atol=1.0e-15_wp)
      ! The impulse and the displacement together, but for the clearance: c/w times the sliding speed.
      l = angular_momentum(model, state) - l
      call expect_close(sqrt(dot(l, l)), clearance/w*sliding, 'moment of momentum', rtol=1.0e-9_wp)
    end do
  end subroutine two_strings

  !> Many collisions without any other force.
  subroutine cloud_held_apart()
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(crossing_t) :: found
    real(wp), allocatable :: start(:, :)
    real(wp) :: p(3), energy, last, begun
    integer :: k, i, j, passed
    call cloud(self_contact_impulses, model, state)
    call ready(model, state, work, method_midpoint, 0.01_wp)
    p = linear_momentum(model, state)
    begun = net_kinetic_energy(model%net, state%node_velocity)
    last = begun
    passed = 0
    do k = 1, 150
      start = state%node_position
      call fly(model, state, work, 1)
      energy = net_kinetic_energy(model%net, state%node_velocity)
      call expect(energy <= last*(1.0_wp + 1.0e-14_wp), 'no step raises the kinetic energy')
      last = energy
      do i = 1, n_loose
        do j = i + 1, n_loose
          found = crossings_of(i, j, start, state%node_position)
          if (modulo(found%n, 2) == 1) passed = passed + 1
        end do
      end do
    end do
    call expect(state%self_contacts(self_all) > 100, 'there are collisions')
    call expect_equal(passed, int(state%self_contacts(self_unresolved)), 'pairs that passed all the same')
    call expect_close(begun - energy, state%ledger%contact_loss, 'what the ledger says', rtol=1.0e-11_wp)
    call expect_close(linear_momentum(model, state), p, 'momentum', atol=1.0e-12_wp)
  end subroutine cloud_held_apart

  !> A taut string along x between fixed ends, and one along y with heavy ends thrown down at
  !> it: both give, and hold each other; without self-contact the thrown one is soon below.
  subroutine thrown_string()
    integer, parameter :: n = 6                                !! nodes of each
    real(wp), parameter :: stiffness = 500.0_wp, length = 0.2_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp) :: position(2*n, 3), velocity(2*n, 3), mass(2*n), natural(2*n - 2), one(2*n - 2), energy, own, lowest
    integer, parameter :: modes(2) = [self_contact_count, self_contact_impulses]
    integer :: nodes(2, 2*n - 2), m, i, k
    logical :: fixed(2*n)
    position = 0.0_wp
    velocity = 0.0_wp
    mass = 0.01_wp
    mass([n + 1, 2*n]) = 0.05_wp
    fixed = .false.
    fixed([1, n]) = .true.
    do i = 1, n
      position(i, 1) = length*(real(i - 1, wp) - 2.37_wp)
      position(n + i, 2) = length*(real(i - 1, wp) - 2.61_wp)
      position(n + i, 3) = 0.02_wp
    end do
    velocity(n + 1:, 3) = -1.0_wp
    do i = 1, n - 1
      nodes(:, i) = [i, i + 1]
      nodes(:, n - 1 + i) = [n + i, n + i + 1]
    end do
    one = 1.0_wp
    natural = 0.999_wp*length
    do m = 1, size(modes)
      call net_of(mass, fixed, nodes, stiffness*one, natural, 0.05_wp*one, .true., position, velocity, model, state)
      call far_target(model, state, modes(m))
      call ready(model, state, work, method_midpoint, 2.0e-4_wp)
      energy = mechanical_energy(model, state)
      lowest = 0.0_wp
      do k = 1, 100
        call fly(model, state, work, 10)
        own = mechanical_energy(model, state) - state%ledger%projection_work
        call expect(own <= energy + 1.0e-4_wp, 'energy does not rise')
        energy = own
        lowest = min(lowest, minval(state%node_position(2:n - 1, 3)))
      end do
      if (modes(m) == self_contact_count) then
        call expect_equal(int(state%self_contacts(self_all)), 1, 'passing through is one crossing')
        call expect_close(minval(state%node_position(n + 1:, 3)), 0.02_wp - 0.2_wp, 'and nothing else', atol=1.0e-3_wp)
      else
        call expect(state%self_contacts(self_all) > 1, 'they meet')
        call expect_equal(int(state%self_contacts(self_unresolved)), 0, 'no collision is left')
        call expect(lowest < -0.01_wp, 'the taut one gives')
        call expect(maxval(state%node_position(n + 3:n + 4, 3)) > minval(state%node_position(3:4, 3)), 'the thrown one is held')
      end if
    end do
  end subroutine thrown_string

  !> A list with another skin, made at other times, and a run that goes on from a state alone.
  subroutine list_decides_nothing()
    real(wp), parameter :: skin(3) = [1.0e-6_wp, 0.3_wp, 5.0_wp]
    type(model_t) :: model
    type(state_t) :: state, half_way
    type(work_t) :: work
    real(wp), allocatable :: ahead(:, :)
    integer(i8) :: counts(3)
    integer(i8) :: hash
    integer :: k
    do k = 1, size(skin)
      call cloud(self_contact_impulses, model, state)
      call ready(model, state, work, method_midpoint, 0.01_wp)
      work%self_contact%pairs%skin = skin(k)
      call fly(model, state, work, 40)
      half_way = state
      call fly(model, state, work, 40)
      if (k == 1) then
        hash = state_hash(state)
        counts = state%self_contacts
      end if
      call expect(state_hash(state) == hash, 'the same bits')
      call expect(all(state%self_contacts == counts), 'the same counts')
    end do
    ahead = half_way%velocity_ahead
    call ready(model, half_way, work, method_midpoint, 0.01_wp)
    half_way%velocity_ahead = ahead
    call fly(model, half_way, work, 40)
    call expect(state_hash(half_way) == hash, 'the same bits after a restart')
    call expect(all(half_way%self_contacts == counts), 'the same counts after a restart')
  end subroutine list_decides_nothing

end module test_self_contact
