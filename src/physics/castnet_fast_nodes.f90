!> Nodes so fast that they could cross a thin part of the target, or come to lie nearer to
!> its far side, between two steps.
!>
!> Contact is looked for at the end of steps. A node that moves by no more than the
!> threshold in a step, against the body, is seen in the layer on the side from which it
!> came. One that moves farther is followed over the step, straight back along its
!> velocity in the body's moving frame; if it entered the layer on the way and is now
!> beyond the body or nearer to another side of it, it is put back to where it entered.
!> The impulses of the step's end then act there, and `release_fast` gives the node the
!> rest of the way with the velocity that it has then: x += r dv, with r the time since it
!> entered, and the body its share, X += r dV. So momentum, angular momentum and the common
!> centre of mass are kept as by any impulse.
!>
!> What other forces did to its velocity after it entered is reflected with the rest: a
!> bounce is exact without them and of first order in the step with them.
!>
!> Costs one pass over the velocities while no node is that fast, and else one more over the
!> nodes that are near. What passes both sieves is sieved by exact distances: a signed
!> distance changes by no more than its point moves. Cables are not followed.
module castnet_fast_nodes
  use castnet_kinds, only: wp
  use castnet_contact_projection, only: cable_incidence_t, energy_of_cables_at
  use castnet_model, only: model_t
  use castnet_near_list, only: near_list_t
  use castnet_rotation, only: multiply, multiply_transposed
  use castnet_shape, only: signed_distance, signed_distance_within, swept_contact
  use castnet_state, only: state_t
  use castnet_vector, only: cross
  implicit none
  private
  public :: fast_nodes_t, new_fast_nodes, look_for_fast, catch_fast, release_fast

  !> Normals closer than this belong to one side [-].
  real(wp), parameter :: same_side = 0.5_wp
  !> The node is put just inside the layer, so that it is found there [-].
  real(wp), parameter :: inside = 1.0_wp - 1.0e-6_wp

  !> The nodes caught at this step.
  type :: fast_nodes_t
    integer :: n = 0
    logical :: possible = .false.              !! some node is that fast at this step
    real(wp) :: way = 0.0_wp                   !! no node that reaches the layer has moved farther against the body [m]
    real(wp) :: slow = 0.0_wp                  !! squared speed of nodes that need no look [m2/s2]
    integer, allocatable :: node(:)            !! (n_node) counted from 1; while they are sieved, the candidates
    real(wp), allocatable :: rest(:)           !! (n_node) time since the node entered [s]; while sieved, its way [m]
    real(wp), allocatable :: back(:, :)        !! (3,n_node) by which it was put back [m]
    real(wp), allocatable :: before(:, :)      !! (3,n_node) its velocity then [m/s]
    real(wp), allocatable :: first(:, :), last(:, :) !! (3,n_node) scratch: ends of the ways, body axes [m]
    real(wp), allocatable :: distance(:, :)    !! (n_node,2) scratch: there [m]
    real(wp), allocatable :: normal(:, :)      !! (3,n_node) scratch
    real(wp) :: energy = 0.0_wp                !! elastic, of its cables before it was moved [J]
  end type fast_nodes_t

contains

  !> Room for a net.
  subroutine new_fast_nodes(fast, n_node)
    type(fast_nodes_t), intent(out) :: fast
    integer, intent(in) :: n_node
    allocate (fast%node(n_node), source=0)
    allocate (fast%rest(n_node), fast%back(3, n_node), fast%before(3, n_node), source=0.0_wp)
    allocate (fast%first(3, n_node), fast%last(3, n_node), fast%normal(3, n_node), source=0.0_wp)
    allocate (fast%distance(n_node, 2), source=0.0_wp)
  end subroutine new_fast_nodes

  !> Is any node fast enough to cross, and how far may one have come within the step?
  subroutine look_for_fast(model, state, radius, top, fast)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp), intent(in) :: radius             !! bounding radius of the target [m]
    real(wp), intent(in) :: top                !! largest squared speed of a node against the target's centre [m2/s2]
    type(fast_nodes_t), intent(inout) :: fast
    real(wp) :: spin, reach
    fast%n = 0
    fast%way = 0.0_wp
    fast%possible = .false.
    if (state%step == 0) return
    associate (body => state%target, threshold => model%contact%threshold)
      spin = sqrt(body%angular_velocity(1)**2 + body%angular_velocity(2)**2 + body%angular_velocity(3)**2) + abs(model%orbit_rate)
      ! A node that reaches the layer within the step lies within `reach` of the body's
      ! centre, so its way is at most h (|v - V| + spin reach): slower ones need no look.
      if (model%step*spin < 0.5_wp) then
        reach = (radius + threshold + model%step*sqrt(top))/(1.0_wp - model%step*spin)
        fast%way = model%step*(sqrt(top) + spin*reach)
        if (fast%way <= threshold) return
        fast%slow = threshold/model%step - spin*reach
        fast%slow = sign(fast%slow*fast%slow, fast%slow)
      else
        fast%way = 1.0e30_wp
        fast%slow = -1.0_wp
      end if
      fast%possible = .true.
    end associate
  end subroutine look_for_fast

  !> Put nodes that crossed within the last step back to where they entered the layer.
  subroutine catch_fast(model, state, r, near, fast, incidence)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: r(3, 3)            !! body to inertial
    type(near_list_t), intent(in) :: near      !! up to date
    type(fast_nodes_t), intent(inout) :: fast
    type(cable_incidence_t), intent(inout) :: incidence
    real(wp) :: hit(3), fraction
    logical :: crossed
    integer :: i, k, n
    fast%n = 0
    if (.not. fast%possible) return
    call list_ways(model, state, r, near, fast, n)
    call sieve_ways(model, fast, n)
    associate (net => model%net)
      do k = 1, n
        call follow(model, fast%first(:, k), fast%last(:, k), crossed, hit, fraction)
        if (.not. crossed) cycle
        i = fast%node(k)
        fast%n = fast%n + 1
        fast%node(fast%n) = i
        fast%rest(fast%n) = (1.0_wp - fraction)*model%step
        fast%back(:, fast%n) = multiply(r, fast%last(:, k) - hit)
        fast%before(:, fast%n) = [state%node_velocity(i, 1), state%node_velocity(i, 2), state%node_velocity(i, 3)]
      end do
      if (fast%n == 0) return
      fast%energy = energy_of_cables_at(net, net%n_pad, state%node_position, fast%node(1:fast%n), incidence)
      do k = 1, fast%n
        i = fast%node(k)
        state%node_position(i, :) = state%node_position(i, :) - fast%back(:, k)
      end do
    end associate
  end subroutine catch_fast

  !> The ways, in body axes, of fast nodes that end near enough to have been in the layer:
  !> those of the near list, unless some node may have come from beyond it within the step.
  subroutine list_ways(model, state, r, near, fast, n)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp), intent(in) :: r(3, 3)
    type(near_list_t), intent(in) :: near
    type(fast_nodes_t), intent(inout) :: fast
    integer, intent(out) :: n
    real(wp) :: rate(3), arm(3), u(3), way
    logical :: all_of_them
    integer :: i, k
    n = 0
    all_of_them = fast%way*(1.0_wp + 1.0e-9_wp) > near%skin
    associate (net => model%net, body => state%target, threshold => model%contact%threshold)
      rate = multiply(r, body%angular_velocity)
      if (.not. model%target%fixed) rate(2) = rate(2) + model%orbit_rate
      do k = 1, merge(net%n_node, near%n_node, all_of_them)
        i = k
        if (.not. all_of_them) i = near%node(k)
        u = [state%node_velocity(i, 1), state%node_velocity(i, 2), state%node_velocity(i, 3)] - body%velocity
        if (u(1)*u(1) + u(2)*u(2) + u(3)*u(3) <= fast%slow) cycle
        if (net%inverse_mass(i) <= 0.0_wp) cycle
        arm = [state%node_position(i, 1), state%node_position(i, 2), state%node_position(i, 3)] - body%position
        u = u - cross(rate, arm)
        way = model%step*sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3))
        if (way <= threshold) cycle
        if (sqrt(arm(1)*arm(1) + arm(2)*arm(2) + arm(3)*arm(3)) - way > near%radius + threshold) cycle
        n = n + 1
        fast%node(n) = i
        fast%rest(n) = way
        fast%last(:, n) = multiply_transposed(r, arm)
        fast%first(:, n) = fast%last(:, n) - model%step*multiply_transposed(r, u)
      end do
    end associate
  end subroutine list_ways

  !> Drop the ways that cannot have entered the layer from outside: those that end, or
  !> begin and end, too far from the body, and those that begin within the layer.
  subroutine sieve_ways(model, fast, n)
    type(model_t), intent(in) :: model
    type(fast_nodes_t), intent(inout) :: fast
    integer, intent(inout) :: n
    real(wp) :: longest
    integer :: k, kept
    if (n == 0) return
    associate (threshold => model%contact%threshold)
      longest = maxval(fast%rest(1:n))
      call signed_distance_within(model%target%shape, threshold + longest, n, fast%last, fast%distance(:, 1), fast%normal)
      kept = 0
      do k = 1, n
        if (fast%distance(k, 1) > threshold + fast%rest(k)) cycle
        kept = kept + 1
        fast%node(kept) = fast%node(k)
        fast%rest(kept) = fast%rest(k)
        fast%distance(kept, 1) = fast%distance(k, 1)
        fast%first(:, kept) = fast%first(:, k)
        fast%last(:, kept) = fast%last(:, k)
      end do
      n = kept
      if (n == 0) return
      call signed_distance_within(model%target%shape, threshold + 2.0_wp*longest, n, fast%first, fast%distance(:, 2), fast%normal)
      kept = 0
      do k = 1, n
        if (fast%distance(k, 2) <= inside*threshold) cycle
        if (fast%distance(k, 1) + fast%distance(k, 2) > 2.0_wp*threshold + fast%rest(k)) cycle
        kept = kept + 1
        fast%node(kept) = fast%node(k)
        fast%first(:, kept) = fast%first(:, k)
        fast%last(:, kept) = fast%last(:, k)
      end do
      n = kept
    end associate
  end subroutine sieve_ways

  !> The rest of the way, for nodes and body.
  subroutine release_fast(model, state, fast, incidence)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    type(fast_nodes_t), intent(inout) :: fast
    type(cable_incidence_t), intent(inout) :: incidence
    real(wp) :: gained(3)
    integer :: i, k
    if (fast%n == 0) return
    associate (net => model%net)
      do k = 1, fast%n
        i = fast%node(k)
        gained = fast%rest(k)*(state%node_velocity(i, :) - fast%before(:, k))
        state%node_position(i, :) = state%node_position(i, :) + fast%back(:, k) + gained
        state%target%position = state%target%position - net%node_mass(i)*model%target%inverse_mass*gained
      end do
      state%ledger%projection_work = state%ledger%projection_work - fast%energy + energy_of_cables_at(net, net%n_pad, &
                                     state%node_position, fast%node(1:fast%n), incidence)
    end associate
    fast%n = 0
  end subroutine release_fast

  !> Did a point enter the layer between p0 and p1 (body axes) and leave it, or change sides?
  subroutine follow(model, p0, p1, crossed, hit, fraction)
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: p0(3), p1(3)
    logical, intent(out) :: crossed
    real(wp), intent(out) :: hit(3)            !! where it entered, body axes [m]
    real(wp), intent(out) :: fraction          !! of the way [-]
    real(wp) :: a(3, 1), b(3, 1), f(1), d(1), normal(3, 1), end_distance(1), end_normal(3, 1)
    logical :: meets(1)
    a(:, 1) = p0
    b(:, 1) = p1
    call swept_contact(model%target%shape, 1, a, b, inside*model%contact%threshold, f, meets, d, normal)
    fraction = f(1)
    hit = p0 + fraction*(p1 - p0)
    crossed = meets(1) .and. fraction > 0.0_wp .and. fraction < 1.0_wp
    if (.not. crossed) return
    call signed_distance(model%target%shape, 1, b, end_distance, end_normal)
    if (end_distance(1) > model%contact%threshold) return
    crossed = end_normal(1, 1)*normal(1, 1) + end_normal(2, 1)*normal(2, 1) + end_normal(3, 1)*normal(3, 1) < same_side
  end subroutine follow

end module castnet_fast_nodes
