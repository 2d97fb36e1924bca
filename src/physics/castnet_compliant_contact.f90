!> Compliant contact: forces of springs and dampers between nodes and target, at every
!> stage of the integrator, for comparison with the impulses of castnet_contact_event.
!>
!> A node at signed distance d from the target has sunk p = threshold - d into the layer
!> in which contact begins, the same as for impulses; q = dp/dt is its normal approach
!> velocity against the body's material point. The normal force pushes, never pulls:
!>
!>     penalty        F = max(0, k p + c q)                   k [N/m],     c [N s/m]
!>     hunt_crossley  F = max(0, k p^(3/2) (1 + c q))         k [N/m^1.5], c [s/m]
!>
!> (Hunt & Crossley 1975, J. Appl. Mech. 42(2), 440-445: the damping grows with depth, so
!> the force starts from and returns to zero). Friction is Coulomb's, regularised:
!> against the tangential velocity u, mu F |u|/sqrt(|u|^2 + s^2). The slip velocity s is
!> 1 mm/s, or so much more that friction brakes no contact point faster than the spring
!> turns it round, s = mu F/sqrt(k' m), k' the spring's slope dF/dp, m the lighter of
!> node and target: a node that should stick creeps by about s times load/(mu F).
!>
!> Energy: what the springs hold, sum k p^2/2 or (2/5) k p^(5/2), belongs to the elastic
!> energy; what damping and friction take belongs to the contact loss. Nodes touch, cables
!> do not. Restitution is not a number here: it follows from k, c, mass and speed.
module castnet_compliant_contact
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, law_impulse, law_penalty
  use castnet_rotation, only: rotation_matrix, multiply, multiply_transposed, normalise_quaternion
  use castnet_shape, only: signed_distance_within, shape_bounding_radius
  use castnet_state, only: body_state_t, ledger_t
  use castnet_vector, only: cross
  implicit none
  private
  public :: is_compliant, add_contact_force, spring_energy, list_pushed, contact_rates

  integer, parameter :: batch_size = 64
  real(wp), parameter :: least_slip = 1.0e-3_wp   !! [m/s]

  !> Nodes in the layer, some at a time, so that nothing is allocated.
  type :: batch_t
    integer :: n = 0
    integer :: node(batch_size) = 0
    real(wp) :: depth(batch_size) = 0.0_wp        !! p > 0 [m]
    real(wp) :: normal(3, batch_size) = 0.0_wp    !! out of the body, inertial axes
    real(wp) :: arm(3, batch_size) = 0.0_wp       !! from the centre of mass, inertial axes [m]
  end type batch_t

contains

  !> Has this model a compliant contact law, and something that can touch?
  pure logical function is_compliant(model)
    type(model_t), intent(in) :: model
    is_compliant = allocated(model%net) .and. allocated(model%target) .and. allocated(model%contact)
    if (is_compliant) is_compliant = model%contact%law /= law_impulse
  end function is_compliant

  !> Add the contact forces of one stage to those on nodes and body; the energy that
  !> damping and friction take over `share` to the ledger.
  subroutine add_contact_force(model, n_pad, x, v, body, force, body_force, body_torque, share, ledger)
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)    !! [m], [m/s]
    type(body_state_t), intent(in) :: body
    real(wp), intent(inout) :: force(n_pad, 3)          !! on the nodes [N]
    real(wp), intent(inout) :: body_force(3)            !! on the target, inertial [N]
    real(wp), intent(inout) :: body_torque(3)           !! on the target, body axes [N m]
    real(wp), intent(in) :: share                       !! of the step that this stage stands for [s]
    type(ledger_t), intent(inout) :: ledger
    type(batch_t) :: batch
    real(wp) :: r(3, 3), rate(3), f(3), torque(3), loss, push
    integer :: next, k, i, c
    r = rotation_matrix(normalise_quaternion(body%attitude))
    rate = surface_rate(model, body, r)
    torque = 0.0_wp
    next = 1
    do while (next <= model%net%n_node)
      call next_batch(model, n_pad, x, body%position, r, next, batch)
      do k = 1, batch%n
        i = batch%node(k)
        call one_force(model, i, [v(i, 1), v(i, 2), v(i, 3)], body%velocity, rate, batch%depth(k), batch%normal(:, k), &
                       batch%arm(:, k), f, push, loss)
        do c = 1, 3
          force(i, c) = force(i, c) + f(c)
          body_force(c) = body_force(c) - f(c)
        end do
        torque = torque - cross(batch%arm(:, k), f)
        ledger%contact_loss = ledger%contact_loss + share*loss
      end do
    end do
    body_torque = body_torque + multiply_transposed(r, torque)
    ! Against the orbital frame, which turns at (0,-n,0), forces do the work of that turn
    ! on the inertial spin besides.
    if (.not. model%target%fixed) ledger%external_work = ledger%external_work - share*model%orbit_rate*torque(2)
  end subroutine add_contact_force

  !> What the springs hold [J].
  real(wp) function spring_energy(model, x, body) result(energy)
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: x(:, :)                     !! (n_pad,3) [m]
    type(body_state_t), intent(in) :: body
    type(batch_t) :: batch
    real(wp) :: r(3, 3)
    integer :: next, k
    energy = 0.0_wp
    r = rotation_matrix(normalise_quaternion(body%attitude))
    next = 1
    do while (next <= model%net%n_node)
      call next_batch(model, size(x, 1), x, body%position, r, next, batch)
      do k = 1, batch%n
        associate (p => batch%depth(k), spring => model%contact%stiffness)
          if (model%contact%law == law_penalty) then
            energy = energy + 0.5_wp*spring*p*p
          else
            energy = energy + 0.4_wp*spring*p*p*sqrt(p)
          end if
        end associate
      end do
    end do
  end function spring_energy

  !> The nodes that are pushed at this instant, and how hard.
  subroutine list_pushed(model, n_pad, x, v, body, n, node, push, deepest)
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    type(body_state_t), intent(in) :: body
    integer, intent(out) :: n
    integer, intent(inout) :: node(:)                   !! (at least n_node) counted from 1, rising
    real(wp), intent(inout) :: push(:)                  !! normal force [N]
    real(wp), intent(out) :: deepest                    !! depth below the surface itself, >= 0 [m]
    type(batch_t) :: batch
    real(wp) :: r(3, 3), rate(3), f(3), one, loss
    integer :: next, k, i
    n = 0
    deepest = 0.0_wp
    r = rotation_matrix(normalise_quaternion(body%attitude))
    rate = surface_rate(model, body, r)
    next = 1
    do while (next <= model%net%n_node)
      call next_batch(model, n_pad, x, body%position, r, next, batch)
      do k = 1, batch%n
        i = batch%node(k)
        call one_force(model, i, [v(i, 1), v(i, 2), v(i, 3)], body%velocity, rate, batch%depth(k), batch%normal(:, k), &
                       batch%arm(:, k), f, one, loss)
        deepest = max(deepest, batch%depth(k) - model%contact%threshold)
        if (.not. one > 0.0_wp) cycle
        n = n + 1
        node(n) = i
        push(n) = one
      end do
    end do
  end subroutine list_pushed

  !> What contact adds to the square of the net's highest frequency and to its largest
  !> damping rate, with every node in contact at once: largest eigenvalues of sums are at
  !> most the sums of largest eigenvalues, and those of the body's six motions at most
  !> n (1/m + R^2/I_min). For 'hunt_crossley' at the depth to which the heaviest node
  !> sinks at `speed`; friction no faster than the spring (see the head).
  subroutine contact_rates(model, speed, stiffness_rate, damping_rate)
    type(model_t), intent(in) :: model
    real(wp), intent(in) :: speed                       !! of nodes against the body, largest to expect [m/s]
    real(wp), intent(out) :: stiffness_rate             !! [1/s2]
    real(wp), intent(out) :: damping_rate               !! [1/s]
    real(wp) :: lightest, heaviest, body, depth, slope, viscosity, least_inertia, friction
    lightest = maxval(model%net%inverse_mass(:model%net%n_node))
    heaviest = maxval(model%net%node_mass)
    body = 0.0_wp
    if (.not. model%target%fixed) then
      ! The smallest moment is at least the reciprocal of the inverse's trace.
      least_inertia = 1.0_wp/(model%target%inverse_inertia(1, 1) + model%target%inverse_inertia(2, 2) &
                              + model%target%inverse_inertia(3, 3))
      body = real(model%net%n_node, wp)*(model%target%inverse_mass &
             + (shape_bounding_radius(model%target%shape) + model%contact%threshold)**2/least_inertia)
    end if
    associate (contact => model%contact)
      slope = contact%stiffness
      viscosity = contact%damping
      if (contact%law /= law_penalty) then
        depth = (1.25_wp*heaviest*speed*speed/contact%stiffness)**0.4_wp
        slope = 1.5_wp*contact%stiffness*sqrt(depth)*(1.0_wp + contact%damping*speed)
        viscosity = contact%damping*contact%stiffness*depth*sqrt(depth)
      end if
      stiffness_rate = slope*(lightest + body)
      damping_rate = viscosity*(lightest + body)
      friction = 0.0_wp
      if (contact%friction > 0.0_wp .and. lightest > 0.0_wp) &
        friction = sqrt(slope*lightest) + sqrt(slope*heaviest)*body
      damping_rate = max(damping_rate, friction)
    end associate
  end subroutine contact_rates

  !> Force on one node [N], its normal part, and the power that damping and friction take [W].
  pure subroutine one_force(model, i, v, body_velocity, rate, p, normal, arm, f, push, loss)
    type(model_t), intent(in) :: model
    integer, intent(in) :: i
    real(wp), intent(in) :: v(3), body_velocity(3), rate(3), p, normal(3), arm(3)
    real(wp), intent(out) :: f(3), push, loss
    real(wp) :: u(3), q, spring, slope, mobility, slip, speed, drag
    u = v - body_velocity - cross(rate, arm)
    q = -(u(1)*normal(1) + u(2)*normal(2) + u(3)*normal(3))
    associate (contact => model%contact)
      if (contact%law == law_penalty) then
        spring = contact%stiffness*p
        slope = contact%stiffness
        push = max(0.0_wp, spring + contact%damping*q)
      else
        spring = contact%stiffness*p*sqrt(p)
        slope = 1.5_wp*contact%stiffness*sqrt(p)
        push = max(0.0_wp, spring*(1.0_wp + contact%damping*q))
      end if
      loss = (push - spring)*q
      f = push*normal
      if (.not. (contact%friction > 0.0_wp .and. push > 0.0_wp)) return
      mobility = max(model%net%inverse_mass(i), model%target%inverse_mass)
      slip = max(least_slip, contact%friction*push*sqrt(mobility/slope))
      u = u + q*normal
      speed = sqrt(u(1)*u(1) + u(2)*u(2) + u(3)*u(3))
      drag = contact%friction*push/sqrt(speed*speed + slip*slip)
      f = f - drag*u
      loss = loss + drag*speed*speed
    end associate
  end subroutine one_force

  !> The next nodes in the layer, from node `next` on.
  subroutine next_batch(model, n_pad, x, centre, r, next, batch)
    type(model_t), intent(in) :: model
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), centre(3), r(3, 3)
    integer, intent(inout) :: next
    type(batch_t), intent(inout) :: batch
    real(wp) :: a(3), reach, y(3, batch_size), distance(batch_size), normal(3, batch_size)
    integer :: node(batch_size), i, k, m
    reach = (shape_bounding_radius(model%target%shape) + model%contact%threshold)**2*(1.0_wp + 1.0e-12_wp)
    m = 0
    do i = next, model%net%n_node
      next = i + 1
      a = [x(i, 1) - centre(1), x(i, 2) - centre(2), x(i, 3) - centre(3)]
      if (a(1)*a(1) + a(2)*a(2) + a(3)*a(3) > reach) cycle
      if (model%target%fixed .and. model%net%inverse_mass(i) <= 0.0_wp) cycle
      m = m + 1
      node(m) = i
      y(:, m) = multiply_transposed(r, a)
      if (m == batch_size) exit
    end do
    batch%n = 0
    if (m == 0) return
    call signed_distance_within(model%target%shape, model%contact%threshold, m, y, distance, normal)
    do k = 1, m
      if (.not. distance(k) < model%contact%threshold) cycle
      batch%n = batch%n + 1
      i = node(k)
      batch%node(batch%n) = i
      batch%depth(batch%n) = model%contact%threshold - distance(k)
      batch%normal(:, batch%n) = multiply(r, normal(:, k))
      batch%arm(:, batch%n) = [x(i, 1) - centre(1), x(i, 2) - centre(2), x(i, 3) - centre(3)]
    end do
  end subroutine next_batch

  !> Rate of the body's surface against the frame, inertial axes: the frame's own is (0,-n,0).
  pure function surface_rate(model, body, r) result(rate)
    type(model_t), intent(in) :: model
    type(body_state_t), intent(in) :: body
    real(wp), intent(in) :: r(3, 3)
    real(wp) :: rate(3)
    rate = multiply(r, body%angular_velocity)
    if (.not. model%target%fixed) rate(2) = rate(2) + model%orbit_rate
  end function surface_rate

end module castnet_compliant_contact
