!> Many node contacts at once with Coulomb friction as six equations.
!>
!> A point mass is isotropic: given the body's change of twist delta, node i has the
!> relative velocity u = u_i - (delta_v + delta_w x r_i) before its own impulse, and its
!> impulse is known in closed form,
!>
!>     j_n = m max(0, c - u.n),   j_t = -min(m |u_t|, mu j_n) u_t/|u_t|,
!>
!> c the normal velocity after the impact: it sticks (v_t+ = 0) inside the cone and
!> slides against u_t on it. The cone is round; restitution acts on the normal only.
!> What remains is F(delta) = H^-1 delta + sum_i [j_i, r_i x j_i] = 0.
!>
!> There always is a solution, whatever the friction, the restitution and the masses: with
!> w_i the body's change of velocity at contact i, delta.F = delta.H^-1 delta + sum w_i.j_i,
!> and far out w_i.j_i >= 0, since a contact opposes the body's motion; so that F points
!> outwards on a large sphere and has a zero inside (Brouwer). It need not be the only one.
module castnet_friction_problem
  use castnet_kinds, only: wp
  use castnet_contact_list, only: body_inertia_t, lane
  implicit none
  private
  public :: friction_problem_t, reserve_friction, pad, largest_speed, cone_impulse, cone_derivative, velocity_at, law, &
            reaction, sweep, balance, stiffest

  !> One system of impulses with friction; arrays as long as the contact list's.
  type :: friction_problem_t
    integer :: n = 0
    integer :: capacity = 0
    logical :: push_only = .true.
    real(wp) :: friction = 0.0_wp
    real(wp), allocatable :: normal(:, :)       !! (capacity,3)
    real(wp), allocatable :: arm(:, :)          !! (capacity,3) [m]
    real(wp), allocatable :: velocity(:, :)     !! (capacity,3) relative velocity before [m/s]
    real(wp), allocatable :: mass(:)            !! 0 takes a contact out [kg]
    real(wp), allocatable :: rebound(:)         !! c, normal velocity after [m/s]
    real(wp), allocatable :: impulse(:, :)      !! (capacity,3) the answer, on the net [N s]
    real(wp), allocatable :: after(:, :)        !! (capacity,3) relative velocity after [m/s]
  end type friction_problem_t

contains

  !> Room for `capacity` contacts, a multiple of `lane`.
  subroutine reserve_friction(problem, capacity)
    type(friction_problem_t), intent(inout) :: problem
    integer, intent(in) :: capacity
    if (problem%capacity >= capacity .and. allocated(problem%normal)) return
    if (allocated(problem%normal)) deallocate (problem%normal, problem%arm, problem%velocity, problem%mass, &
                                               problem%rebound, problem%impulse, problem%after)
    allocate (problem%normal(capacity, 3), problem%arm(capacity, 3), problem%velocity(capacity, 3), source=0.0_wp)
    allocate (problem%impulse(capacity, 3), problem%after(capacity, 3), source=0.0_wp)
    allocate (problem%mass(capacity), problem%rebound(capacity), source=0.0_wp)
    problem%capacity = capacity
  end subroutine reserve_friction

  pure subroutine pad(problem, n_lane)
    type(friction_problem_t), intent(inout) :: problem
    integer, intent(out) :: n_lane
    integer :: i
    n_lane = ((problem%n + lane - 1)/lane)*lane
    do i = problem%n + 1, n_lane
      problem%normal(i, :) = [1.0_wp, 0.0_wp, 0.0_wp]
      problem%arm(i, :) = 0.0_wp
      problem%velocity(i, :) = 0.0_wp
      problem%mass(i) = 0.0_wp
      problem%rebound(i) = 0.0_wp
    end do
  end subroutine pad

  pure real(wp) function largest_speed(problem) result(largest)
    type(friction_problem_t), intent(in) :: problem
    integer :: i
    largest = 0.0_wp
    do i = 1, problem%n
      if (.not. problem%mass(i) > 0.0_wp) cycle
      largest = max(largest, abs(problem%velocity(i, 1)), abs(problem%velocity(i, 2)), abs(problem%velocity(i, 3)))
    end do
  end function largest_speed

  !> Impulse on a point of mass m that meets the surface at relative velocity u.
  pure function cone_impulse(mass, u, n, rebound, friction, push_only) result(j)
    real(wp), intent(in) :: mass, u(3), n(3), rebound, friction
    logical, intent(in) :: push_only
    real(wp) :: j(3), un, ut(3), speed, jn, grip
    un = u(1)*n(1) + u(2)*n(2) + u(3)*n(3)
    jn = mass*(rebound - un)
    if (push_only) jn = max(0.0_wp, jn)
    ut = u - un*n
    speed = sqrt(ut(1)*ut(1) + ut(2)*ut(2) + ut(3)*ut(3))
    grip = friction*max(0.0_wp, jn)
    ! The force that would stop it, unless that is more than friction can give.
    if (mass*speed > grip) then
      j = jn*n - (grip/max(speed, tiny(1.0_wp)))*ut
    else
      j = jn*n - mass*ut
    end if
  end function cone_impulse

  !> -d j/d u of `cone_impulse`.
  pure function cone_derivative(mass, u, n, rebound, friction, push_only) result(a)
    real(wp), intent(in) :: mass, u(3), n(3), rebound, friction
    logical, intent(in) :: push_only
    real(wp) :: a(3, 3), t(3), un, jn, speed, grip, slide, along
    integer :: c, d
    un = u(1)*n(1) + u(2)*n(2) + u(3)*n(3)
    t = u - un*n
    speed = sqrt(t(1)*t(1) + t(2)*t(2) + t(3)*t(3))
    jn = mass*(rebound - un)
    a = 0.0_wp
    if (push_only .and. jn <= 0.0_wp) return
    grip = friction*max(0.0_wp, jn)
    if (mass*speed > grip) then
      t = t/speed
      slide = grip/speed
    else
      t = 0.0_wp
      slide = mass
    end if
    along = merge(friction*mass, 0.0_wp, jn > 0.0_wp)
    do d = 1, 3
      do c = 1, 3
        a(c, d) = ((mass - slide)*n(c) - along*t(c))*n(d) - slide*t(c)*t(d)
      end do
      a(d, d) = a(d, d) + slide
    end do
  end function cone_derivative

  !> u_i - (delta_v + delta_w x r).
  pure function velocity_at(ux, uy, uz, rx, ry, rz, delta) result(u)
    real(wp), intent(in) :: ux, uy, uz, rx, ry, rz, delta(6)
    real(wp) :: u(3)
    u(1) = ux - (delta(1) + (delta(5)*rz - delta(6)*ry))
    u(2) = uy - (delta(2) + (delta(6)*rx - delta(4)*rz))
    u(3) = uz - (delta(3) + (delta(4)*ry - delta(5)*rx))
  end function velocity_at

  !> A contact's impulse by its law, the body's twist changed by `delta`.
  pure function law(problem, i, delta) result(j)
    type(friction_problem_t), intent(in) :: problem
    integer, intent(in) :: i
    real(wp), intent(in) :: delta(6)
    real(wp) :: j(3), u(3), n(3)
    u = velocity_at(problem%velocity(i, 1), problem%velocity(i, 2), problem%velocity(i, 3), &
                    problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3), delta)
    n = [problem%normal(i, 1), problem%normal(i, 2), problem%normal(i, 3)]
    j = cone_impulse(problem%mass(i), u, n, problem%rebound(i), problem%friction, problem%push_only)
  end function law

  !> Change of the body's twist by the reaction of the impulses.
  pure function reaction(problem, body) result(twist)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: twist(6), p(6)
    integer :: i
    twist = 0.0_wp
    if (.not. body%free) return
    p = 0.0_wp
    do i = 1, problem%n
      p(1) = p(1) + problem%impulse(i, 1)
      p(2) = p(2) + problem%impulse(i, 2)
      p(3) = p(3) + problem%impulse(i, 3)
      p(4) = p(4) + (problem%arm(i, 2)*problem%impulse(i, 3) - problem%arm(i, 3)*problem%impulse(i, 2))
      p(5) = p(5) + (problem%arm(i, 3)*problem%impulse(i, 1) - problem%arm(i, 1)*problem%impulse(i, 3))
      p(6) = p(6) + (problem%arm(i, 1)*problem%impulse(i, 2) - problem%arm(i, 2)*problem%impulse(i, 1))
    end do
    twist(1:3) = -body%inverse_mass*p(1:3)
    twist(4) = -(body%inverse_inertia(1, 1)*p(4) + body%inverse_inertia(1, 2)*p(5) + body%inverse_inertia(1, 3)*p(6))
    twist(5) = -(body%inverse_inertia(2, 1)*p(4) + body%inverse_inertia(2, 2)*p(5) + body%inverse_inertia(2, 3)*p(6))
    twist(6) = -(body%inverse_inertia(3, 1)*p(4) + body%inverse_inertia(3, 2)*p(5) + body%inverse_inertia(3, 3)*p(6))
  end function reaction

  !> F alone.
  pure function balance(problem, body, delta) result(f)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: delta(6)
    real(wp) :: f(6), j(3), r(3)
    integer :: i, c
    do c = 1, 3
      f(c) = body%mass*delta(c)
      f(c + 3) = body%inertia(c, 1)*delta(4) + body%inertia(c, 2)*delta(5) + body%inertia(c, 3)*delta(6)
    end do
    do i = 1, problem%n
      if (.not. problem%mass(i) > 0.0_wp) cycle
      j = law(problem, i, delta)
      r = [problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3)]
      f(1) = f(1) + j(1)
      f(2) = f(2) + j(2)
      f(3) = f(3) + j(3)
      f(4) = f(4) + (r(2)*j(3) - r(3)*j(2))
      f(5) = f(5) + (r(3)*j(1) - r(1)*j(3))
      f(6) = f(6) + (r(1)*j(2) - r(2)*j(1))
    end do
  end function balance

  !> H^-1 + sum m_i G_i^T G_i, G = [1, -[r]x]: F's derivative with every contact stuck.
  pure function stiffest(problem, body) result(a)
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: a(6, 6), r(3), m
    integer :: i, c, d
    a = 0.0_wp
    a(4:6, 4:6) = body%inertia
    do c = 1, 3
      a(c, c) = body%mass
    end do
    do i = 1, problem%n
      m = problem%mass(i)
      r = [problem%arm(i, 1), problem%arm(i, 2), problem%arm(i, 3)]
      do c = 1, 3
        a(c, c) = a(c, c) + m
        a(c + 3, c + 3) = a(c + 3, c + 3) + m*(r(1)*r(1) + r(2)*r(2) + r(3)*r(3))
        do d = 1, 3
          a(c + 3, d + 3) = a(c + 3, d + 3) - m*r(c)*r(d)
        end do
      end do
      a(4, 2) = a(4, 2) - m*r(3)
      a(4, 3) = a(4, 3) + m*r(2)
      a(5, 1) = a(5, 1) + m*r(3)
      a(5, 3) = a(5, 3) - m*r(1)
      a(6, 1) = a(6, 1) - m*r(2)
      a(6, 2) = a(6, 2) + m*r(1)
    end do
    do c = 1, 3
      do d = 4, 6
        a(c, d) = a(d, c)
      end do
    end do
  end function stiffest

  !> One pass over the contacts: F, its derivative, and the size of the terms that F is
  !> the sum of, in the norm of `measure` (what rounding leaves is a part of that).
  pure subroutine sweep(m, n, normal, arm, velocity, mass, rebound, friction, push_only, body, delta, f, &
                        jacobian, scale)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: normal(m, 3), arm(m, 3), velocity(m, 3), mass(m), rebound(m), friction
    logical, intent(in) :: push_only
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: delta(6)
    real(wp), intent(out) :: f(6), jacobian(6, 6), scale
    real(wp) :: sum_f(lane, 6), sum_a(lane, 3, 3), sum_b(lane, 3, 3), sum_c(lane, 3, 3), sum_d(lane, 3, 3), size(lane)
    real(wp) :: a(lane, 3, 3), ar(lane, 3, 3), j(lane, 3), nn(lane, 3), r(lane, 3), tau(lane, 3)
    real(wp) :: u1, u2, u3, un, t1, t2, t3, speed, jn, grip, stick, slide, active, mm, along, across, floor_impulse
    integer :: k, l, c, d, i
    sum_f = 0.0_wp
    sum_a = 0.0_wp
    sum_b = 0.0_wp
    sum_c = 0.0_wp
    sum_d = 0.0_wp
    size = 0.0_wp
    floor_impulse = merge(0.0_wp, -huge(1.0_wp), push_only)
    do k = 0, n - lane, lane
      do l = 1, lane
        i = k + l
        mm = mass(i)
        u1 = velocity(i, 1) - (delta(1) + (delta(5)*arm(i, 3) - delta(6)*arm(i, 2)))
        u2 = velocity(i, 2) - (delta(2) + (delta(6)*arm(i, 1) - delta(4)*arm(i, 3)))
        u3 = velocity(i, 3) - (delta(3) + (delta(4)*arm(i, 2) - delta(5)*arm(i, 1)))
        un = u1*normal(i, 1) + u2*normal(i, 2) + u3*normal(i, 3)
        t1 = u1 - un*normal(i, 1)
        t2 = u2 - un*normal(i, 2)
        t3 = u3 - un*normal(i, 3)
        speed = sqrt(t1*t1 + t2*t2 + t3*t3)
        jn = mm*(rebound(i) - un)
        active = merge(1.0_wp, 0.0_wp, jn > floor_impulse)
        jn = merge(jn, 0.0_wp, jn > floor_impulse)
        grip = friction*merge(jn, 0.0_wp, jn > 0.0_wp)
        stick = merge(1.0_wp, 0.0_wp, mm*speed <= grip)
        ! Tangential impulse -slide u_t; its derivative in u_t is -slide across, 0 along u_t.
        slide = merge(mm, grip/merge(speed, 1.0_wp, speed > 0.0_wp), stick > 0.5_wp)
        along = (1.0_wp - stick)/merge(speed, 1.0_wp, speed > 0.0_wp)
        tau(l, 1) = t1*along
        tau(l, 2) = t2*along
        tau(l, 3) = t3*along
        nn(l, 1) = normal(i, 1)
        nn(l, 2) = normal(i, 2)
        nn(l, 3) = normal(i, 3)
        r(l, 1) = arm(i, 1)
        r(l, 2) = arm(i, 2)
        r(l, 3) = arm(i, 3)
        j(l, 1) = jn*normal(i, 1) - slide*t1
        j(l, 2) = jn*normal(i, 2) - slide*t2
        j(l, 3) = jn*normal(i, 3) - slide*t3
        ! A = -dj/du = m active (n - [sliding] mu tau) n^T + slide (1 - n n^T - tau tau^T).
        along = mm*active
        across = merge(0.0_wp, friction*along*(1.0_wp - stick), jn <= 0.0_wp)
        a(l, 1, 1) = slide
        a(l, 2, 2) = slide
        a(l, 3, 3) = slide
        a(l, 1, 2) = along
        a(l, 1, 3) = across
        size(l) = size(l) + (abs(j(l, 1)) + abs(j(l, 2)) + abs(j(l, 3)))
      end do
      do l = 1, lane
        along = a(l, 1, 2)
        across = a(l, 1, 3)
        slide = a(l, 1, 1)
        do d = 1, 3
          do c = 1, 3
            a(l, c, d) = ((along - slide)*nn(l, c) - across*tau(l, c))*nn(l, d) - slide*tau(l, c)*tau(l, d)
          end do
          a(l, d, d) = a(l, d, d) + slide
        end do
      end do
      ! G = [1, -[r]x], F' = H^-1 + sum G^T A G.
      do c = 1, 3
        do l = 1, lane
          ar(l, c, 1) = a(l, c, 3)*r(l, 2) - a(l, c, 2)*r(l, 3)
          ar(l, c, 2) = a(l, c, 1)*r(l, 3) - a(l, c, 3)*r(l, 1)
          ar(l, c, 3) = a(l, c, 2)*r(l, 1) - a(l, c, 1)*r(l, 2)
          sum_f(l, c) = sum_f(l, c) + j(l, c)
        end do
      end do
      do l = 1, lane
        sum_f(l, 4) = sum_f(l, 4) + (r(l, 2)*j(l, 3) - r(l, 3)*j(l, 2))
        sum_f(l, 5) = sum_f(l, 5) + (r(l, 3)*j(l, 1) - r(l, 1)*j(l, 3))
        sum_f(l, 6) = sum_f(l, 6) + (r(l, 1)*j(l, 2) - r(l, 2)*j(l, 1))
      end do
      do d = 1, 3
        do l = 1, lane
          sum_a(l, 1, d) = sum_a(l, 1, d) + a(l, 1, d)
          sum_a(l, 2, d) = sum_a(l, 2, d) + a(l, 2, d)
          sum_a(l, 3, d) = sum_a(l, 3, d) + a(l, 3, d)
          sum_b(l, 1, d) = sum_b(l, 1, d) + ar(l, 1, d)
          sum_b(l, 2, d) = sum_b(l, 2, d) + ar(l, 2, d)
          sum_b(l, 3, d) = sum_b(l, 3, d) + ar(l, 3, d)
          sum_c(l, 1, d) = sum_c(l, 1, d) + (r(l, 2)*a(l, 3, d) - r(l, 3)*a(l, 2, d))
          sum_c(l, 2, d) = sum_c(l, 2, d) + (r(l, 3)*a(l, 1, d) - r(l, 1)*a(l, 3, d))
          sum_c(l, 3, d) = sum_c(l, 3, d) + (r(l, 1)*a(l, 2, d) - r(l, 2)*a(l, 1, d))
          sum_d(l, 1, d) = sum_d(l, 1, d) + (r(l, 2)*ar(l, 3, d) - r(l, 3)*ar(l, 2, d))
          sum_d(l, 2, d) = sum_d(l, 2, d) + (r(l, 3)*ar(l, 1, d) - r(l, 1)*ar(l, 3, d))
          sum_d(l, 3, d) = sum_d(l, 3, d) + (r(l, 1)*ar(l, 2, d) - r(l, 2)*ar(l, 1, d))
        end do
      end do
    end do
    jacobian = 0.0_wp
    f(1:3) = body%mass*delta(1:3)
    do c = 1, 3
      f(c + 3) = body%inertia(c, 1)*delta(4) + body%inertia(c, 2)*delta(5) + body%inertia(c, 3)*delta(6)
      jacobian(c, c) = body%mass
    end do
    jacobian(4:6, 4:6) = body%inertia
    do d = 1, 3
      f(d) = f(d) + total(sum_f(:, d))
      f(d + 3) = f(d + 3) + total(sum_f(:, d + 3))
      do c = 1, 3
        jacobian(c, d) = jacobian(c, d) + total(sum_a(:, c, d))
        jacobian(c, d + 3) = jacobian(c, d + 3) + total(sum_b(:, c, d))
        jacobian(c + 3, d) = jacobian(c + 3, d) + total(sum_c(:, c, d))
        jacobian(c + 3, d + 3) = jacobian(c + 3, d + 3) + total(sum_d(:, c, d))
      end do
    end do
    scale = sqrt(body%inverse_mass)*total(size) + tiny(1.0_wp)
  end subroutine sweep

  pure real(wp) function total(sums)
    real(wp), intent(in) :: sums(lane)
    total = ((sums(1) + sums(2)) + (sums(3) + sums(4))) + ((sums(5) + sums(6)) + (sums(7) + sums(8)))
  end function total

end module castnet_friction_problem
