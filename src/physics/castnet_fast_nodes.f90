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
!> Costs one pass over the velocities while no node is that fast. Cables are not followed.
module castnet_fast_nodes
  use castnet_kinds, only: wp
  use castnet_contact_projection, only: cable_incidence_t, energy_of_cables_at
  use castnet_model, only: model_t
  use castnet_rotation, only: rotation_matrix, multiply, multiply_transposed
  use castnet_shape, only: signed_distance, swept_contact
  use castnet_state, only: state_t
  use castnet_vector, only: cross
  implicit none
  private
  public :: fast_nodes_t, new_fast_nodes, catch_fast, release_fast

  !> Normals closer than this belong to one side [-].
  real(wp), parameter :: same_side = 0.5_wp
  !> The node is put just inside the layer, so that it is found there [-].
  real(wp), parameter :: inside = 1.0_wp - 1.0e-6_wp

  !> The nodes caught at this step.
  type :: fast_nodes_t
    integer :: n = 0
    integer, allocatable :: node(:)            !! (n_node) counted from 1
    real(wp), allocatable :: rest(:)           !! (n_node) time since the node entered [s]
    real(wp), allocatable :: back(:, :)        !! (3,n_node) by which it was put back [m]
    real(wp), allocatable :: before(:, :)      !! (3,n_node) its velocity then [m/s]
    real(wp), allocatable :: square(:)         !! (n_node) scratch: squared speeds against the body's centre [m2/s2]
    real(wp) :: energy = 0.0_wp                !! elastic, of its cables before it was moved [J]
  end type fast_nodes_t

contains

  !> Room for a net.
  subroutine new_fast_nodes(fast, n_node)
    type(fast_nodes_t), intent(out) :: fast
    integer, intent(in) :: n_node
    allocate (fast%node(n_node), source=0)
    allocate (fast%rest(n_node), fast%back(3, n_node), fast%before(3, n_node), fast%square(n_node), source=0.0_wp)
  end subroutine new_fast_nodes

  !> Put nodes that crossed within the last step back to where they entered the layer.
  subroutine catch_fast(model, state, radius, fast, incidence)
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    real(wp), intent(in) :: radius             !! bounding radius of the target [m]
    type(fast_nodes_t), intent(inout) :: fast
    type(cable_incidence_t), intent(inout) :: incidence
    real(wp) :: r(3, 3), rate(3), arm(3), u(3), way, spin, p0(3), p1(3), hit(3), top, reach, slow
    logical :: crossed
    integer :: i, k
    fast%n = 0
    if (state%step == 0) return
    associate (net => model%net, body => state%target, threshold => model%contact%threshold)
      spin = sqrt(body%angular_velocity(1)**2 + body%angular_velocity(2)**2 + body%angular_velocity(3)**2) + abs(model%orbit_rate)
      call squared_speeds(net%n_node, net%n_pad, state%node_velocity, body%velocity, fast%square, top)
      ! A node that reaches the layer within the step lies within `reach` of the body's
      ! centre, so its way is at most h (|v - V| + spin reach): slower ones need no look.
      if (model%step*spin < 0.5_wp) then
        reach = (radius + threshold + model%step*sqrt(top))/(1.0_wp - model%step*spin)
        slow = threshold/model%step - spin*reach
        if (sqrt(top) <= slow) return
        slow = sign(slow*slow, slow)
      else
        slow = -1.0_wp
      end if
      r = rotation_matrix(body%attitude)
      rate = multiply(r, body%angular_velocity)
      if (.not. model%target%fixed) rate(2) = rate(2) + model%orbit_rate
      do i = 1, net%n_node
        if (fast%square(i) <= slow) cycle
        if (net%inverse_mass(i) <= 0.0_wp) cycle
        arm = [state%node_position(i, 1), state%node_position(i, 2), state%node_position(i, 3)] - body%position
        u = [state%node_velocity(i, 1), state%node_velocity(i, 2), state%node_velocity(i, 3)] - body%velocity - cross(rate, arm)
        way = model%step*sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3))
        if (way <= threshold) cycle
        if (sqrt(arm(1)*arm(1) + arm(2)*arm(2) + arm(3)*arm(3)) - way > radius + threshold) cycle
        p1 = multiply_transposed(r, arm)
        p0 = p1 - model%step*multiply_transposed(r, u)
        call follow(model, p0, p1, crossed, hit, way)
        if (.not. crossed) cycle
        fast%n = fast%n + 1
        fast%node(fast%n) = i
        fast%rest(fast%n) = (1.0_wp - way)*model%step
        fast%back(:, fast%n) = multiply(r, p1 - hit)
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

  !> Squared speeds of the nodes against the body's centre of mass, and the largest [m2/s2].
  pure subroutine squared_speeds(n, n_pad, v, centre, square, top)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: v(n_pad, 3), centre(3)
    real(wp), intent(out) :: square(n), top
    integer, parameter :: lanes = 8   ! partial maxima, which the compiler keeps side by side
    real(wp) :: part(lanes)
    integer :: i, k
    do i = 1, n
      square(i) = (v(i, 1) - centre(1))**2 + (v(i, 2) - centre(2))**2 + (v(i, 3) - centre(3))**2
    end do
    part = 0.0_wp
    do i = 0, n - lanes, lanes
      do k = 1, lanes
        part(k) = merge(square(i + k), part(k), square(i + k) > part(k))
      end do
    end do
    top = maxval(part)
    do i = n - modulo(n, lanes) + 1, n
      top = max(top, square(i))
    end do
  end subroutine squared_speeds

end module castnet_fast_nodes
