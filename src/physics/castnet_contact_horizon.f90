!> How long nothing can touch: a proven bound, so that most of a flight needs no
!> contact detection at all.
!>
!> Between contacts, and with no winch pulling, the net's energy relative to its own
!> centre of mass, E = sum m_i |u_i|^2/2 + elastic, never rises: tensions are internal,
!> damping takes energy, the clamped law too, and uniform gravity is the same for every
!> node. So node i never moves faster than w_i = sqrt(2 E/m_i) against the centre of
!> mass, and after a time t it lies within w_i t of x_i + V t + g t^2/2. The target's
!> centre of mass lies at x_O + v_O t + (g + F/m_O) t^2/2 exactly, and the target within
!> its bounding radius R of that. With d_i = |x_i - x_O| - R - threshold, nothing touches
!> before the least t that solves d_i = (|V - v_O| + w_i) t + a t^2/2, a being the
!> difference of the two accelerations. A point of a cable is a mean of its two nodes and
!> no faster than the faster one, so the same holds with the segment's distance.
!>
!> With fixed nodes the net's momentum is not kept: then V = 0 and E is taken at rest,
!> where the supports do no work; gravity would feed that energy, and so do supports that
!> are led along: then there is no bound. In an orbital frame and with a winch that may pull there is none either.
!>
!> The exact flow obeys the bound; the integrator adds its own error when a slack cable
!> snaps taut, for which E is taken `energy_margin` times larger.
module castnet_contact_horizon
  use castnet_kinds, only: wp
  use castnet_cable_force, only: survey_cables
  use castnet_model, only: model_t, trigger_contact, trigger_time, law_impulse, self_contact_taut, self_contact_impulses
  use castnet_state, only: state_t
  use castnet_net, only: net_t
  use castnet_shape, only: shape_bounding_radius
  implicit none
  private
  public :: earliest_contact_time

  real(wp), parameter :: energy_margin = 1.5_wp
  integer, parameter :: lanes = 8  !! partial sums, in one order in every build

contains

  !> Nothing can touch before this time; `state%time` when nothing can be said [s].
  function earliest_contact_time(model, state) result(time)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: time
    real(wp) :: drift(3), energy, offset(3), radius, speed, reach, gap, wait
    integer :: i, a, b
    time = state%time
    if (.not. bound_exists(model, state)) return
    call net_motion(model%net, model%net%n_pad, state%node_position, state%node_velocity, drift, energy)
    speed = length(drift - state%target%velocity)
    offset = relative_acceleration(model)
    radius = shape_bounding_radius(model%target%shape) + model%contact%threshold
    associate (net => model%net, x => state%node_position, centre => state%target%position)
      wait = first_arrival(net%n_node, net%n_pad, x, centre, radius, net%inverse_mass, energy, speed, length(offset))
      if (model%contact%detect_cables) then
        do i = 1, net%n_cable
          a = net%cable_nodes(1, i)
          b = net%cable_nodes(2, i)
          gap = distance_to_segment(centre, [x(a, 1), x(a, 2), x(a, 3)], [x(b, 1), x(b, 2), x(b, 3)]) - radius
          reach = speed + sqrt(2.0_wp*energy*max(net%inverse_mass(a), net%inverse_mass(b)))
          wait = min(wait, time_to_cover(gap, reach, length(offset)))
        end do
      end if
    end associate
    ! A hair early: the bound's own rounding.
    time = state%time + wait*(1.0_wp - 1.0e-9_wp)
    if (allocated(model%closing)) then
      if (model%closing%trigger == trigger_time) time = min(time, max(state%time, model%closing%delay))
    end if
  end function earliest_contact_time

  !> The least time in which one of the nodes can cover its gap.
  pure real(wp) function first_arrival(n, n_pad, x, centre, radius, inverse_mass, energy, speed, acceleration) result(wait)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: x(n_pad, 3), centre(3), radius, inverse_mass(n_pad), energy, speed, acceleration
    real(wp) :: dx, dy, dz, gap, reach, denominator
    integer :: i
    wait = huge(1.0_wp)
    do i = 1, n
      dx = x(i, 1) - centre(1)
      dy = x(i, 2) - centre(2)
      dz = x(i, 3) - centre(3)
      gap = max(0.0_wp, sqrt(dx*dx + dy*dy + dz*dz) - radius)
      reach = speed + sqrt(2.0_wp*energy*inverse_mass(i))
      ! As time_to_cover, without its branches.
      denominator = max(reach + sqrt(reach*reach + 2.0_wp*acceleration*gap), max(gap, tiny(1.0_wp))*2.0e-30_wp)
      wait = min(wait, 2.0_wp*gap/denominator)
    end do
  end function first_arrival

  !> Does the net's energy keep from rising until something touches?
  pure logical function bound_exists(model, state)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    bound_exists = .not. abs(model%orbit_rate) > 0.0_wp .and. model%contact%law == law_impulse
    ! Cables that are held apart are moved, which may cost energy.
    if (any(model%contact%self_contact == [self_contact_taut, self_contact_impulses])) bound_exists = .false.
    if (any(model%net%fixed)) then
      if (any(abs(model%gravity) > 0.0_wp) .or. supports_move(model%net, state%node_velocity)) bound_exists = .false.
    end if
    if (.not. allocated(model%closing)) return
    select case (model%closing%trigger)
    case (trigger_contact)
      ! The trigger is the very event that is being bounded, until it has happened once.
      if (state%first_contact >= 0.0_wp) bound_exists = .false.
    case (trigger_time)
      if (state%time >= model%closing%delay) bound_exists = .false.
    case default
      bound_exists = .false.
    end select
    if (allocated(state%closing)) then
      if (state%closing%triggered) bound_exists = .false.
    end if
  end function bound_exists

  !> Is a fixed node led along? Then it does work on the net.
  pure logical function supports_move(net, v)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: v(:, :)
    integer :: i
    supports_move = .false.
    do i = 1, net%n_node
      if (net%fixed(i)) supports_move = supports_move .or. any(abs(v(i, :)) > 0.0_wp)
    end do
  end function supports_move

  !> Velocity of the net's frame of least energy, and the energy in it.
  pure subroutine net_motion(net, n_pad, x, v, drift, energy)
    type(net_t), intent(in) :: net
    integer, intent(in) :: n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3)
    real(wp), intent(out) :: drift(3), energy
    real(wp) :: part(lanes), largest
    integer :: i, k
    drift = 0.0_wp
    if (.not. any(net%fixed)) drift = mean_velocity(net, v)
    part = 0.0_wp
    do i = 0, net%n_node - lanes, lanes
      do k = 1, lanes
        part(k) = part(k) + merge(0.0_wp, net%node_mass(i + k), net%fixed(i + k))* &
                  ((v(i + k, 1) - drift(1))**2 + (v(i + k, 2) - drift(2))**2 + (v(i + k, 3) - drift(3))**2)
      end do
    end do
    do i = net%n_node - modulo(net%n_node, lanes) + 1, net%n_node
      part(1) = part(1) + merge(0.0_wp, net%node_mass(i), net%fixed(i))* &
                ((v(i, 1) - drift(1))**2 + (v(i, 2) - drift(2))**2 + (v(i, 3) - drift(3))**2)
    end do
    call survey_cables(net%plan, n_pad, x, v, energy, largest)
    energy = energy + 0.5_wp*(((part(1) + part(2)) + (part(3) + part(4))) + ((part(5) + part(6)) + (part(7) + part(8))))
    energy = energy_margin*energy
  end subroutine net_motion

  !> Of the net's centre of mass [m/s].
  pure function mean_velocity(net, v) result(mean)
    type(net_t), intent(in) :: net
    real(wp), intent(in), contiguous :: v(:, :)
    real(wp) :: mean(3), mass
    integer :: i
    mean = 0.0_wp
    mass = 0.0_wp
    do i = 1, net%n_node
      mass = mass + net%node_mass(i)
      mean(1) = mean(1) + net%node_mass(i)*v(i, 1)
      mean(2) = mean(2) + net%node_mass(i)*v(i, 2)
      mean(3) = mean(3) + net%node_mass(i)*v(i, 3)
    end do
    mean = mean/mass
  end function mean_velocity

  !> Acceleration of the target's centre of mass against the net's.
  pure function relative_acceleration(model) result(a)
    type(model_t), intent(in) :: model
    real(wp) :: a(3)
    a = 0.0_wp
    if (model%target%fixed) then
      a = -model%gravity
    else
      a = model%target%external_force*model%target%inverse_mass
      ! Without gravity the fixed nodes' net stays where it is, and so does V = 0.
    end if
  end function relative_acceleration

  !> The t of gap = speed t + acceleration t^2/2; 0 when already within reach.
  pure real(wp) function time_to_cover(gap, speed, acceleration) result(t)
    real(wp), intent(in) :: gap, speed, acceleration
    real(wp) :: denominator
    t = 0.0_wp
    if (.not. gap > 0.0_wp) return
    denominator = speed + sqrt(speed*speed + 2.0_wp*acceleration*gap)
    t = 1.0e30_wp
    if (denominator > gap*1.0e-29_wp) t = 2.0_wp*gap/denominator
  end function time_to_cover

  pure real(wp) function distance_to_segment(p, a, b) result(d)
    real(wp), intent(in) :: p(3), a(3), b(3)
    real(wp) :: u(3), q(3), s, square
    u = b - a
    q = p - a
    square = u(1)*u(1) + u(2)*u(2) + u(3)*u(3)
    s = q(1)*u(1) + q(2)*u(2) + q(3)*u(3)
    s = max(0.0_wp, min(1.0_wp, s/max(square, tiny(1.0_wp))))
    d = length(q - s*u)
  end function distance_to_segment

  pure real(wp) function length(v)
    real(wp), intent(in) :: v(3)
    length = sqrt(v(1)*v(1) + v(2)*v(2) + v(3)*v(3))
  end function length

end module castnet_contact_horizon
