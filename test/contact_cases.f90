!> Small nets of loose nodes beside a body, for tests of contact.
module contact_cases
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_model, only: model_t
  use castnet_state, only: state_t, impulse_bins
  use castnet_shape, only: new_shape
  use castnet_rotation, only: rotation_matrix, multiply, congruent, rotate
  use castnet_contact_list, only: contact_list_t, body_inertia_t, reserve_contacts
  use castnet_vector, only: cross
  implicit none
  private
  public :: new_case, add_cables, set_body, momentum, angular_momentum, kinetic_energy, elastic_energy, centre_of_mass
  public :: random_t, uniform, uniform_point, normal_draw, random_quaternion, random_direction, random_contacts, &
            random_cable_contacts

  !> A small generator of the tests' own: xorshift, the same everywhere.
  type :: random_t
    integer(i8) :: s = 88172645463325252_i8
  end type random_t

contains

  real(wp) function uniform(random)
    type(random_t), intent(inout) :: random
    random%s = ieor(random%s, ishft(random%s, 13))
    random%s = ieor(random%s, ishft(random%s, -7))
    random%s = ieor(random%s, ishft(random%s, 17))
    uniform = real(ishft(random%s, -11), wp)*2.0_wp**(-53)
  end function uniform

  !> Three draws, one after the other. In which order a compiler evaluates the parts of an
  !> expression, or an argument of `merge` that is not taken, is its own choice; so that the
  !> samples are the same everywhere, the tests draw once a statement.
  function uniform_point(random) result(p)
    type(random_t), intent(inout) :: random
    real(wp) :: p(3)
    integer :: i
    do i = 1, 3
      p(i) = uniform(random)
    end do
  end function uniform_point

  !> Roughly normal: the sum of twelve.
  real(wp) function normal_draw(random)
    type(random_t), intent(inout) :: random
    integer :: i
    normal_draw = -6.0_wp
    do i = 1, 12
      normal_draw = normal_draw + uniform(random)
    end do
  end function normal_draw

  function random_direction(random) result(n)
    type(random_t), intent(inout) :: random
    real(wp) :: n(3)
    integer :: i
    do i = 1, 3
      n(i) = normal_draw(random)
    end do
    n = n/sqrt(n(1)**2 + n(2)**2 + n(3)**2)
  end function random_direction

  function random_quaternion(random) result(q)
    type(random_t), intent(inout) :: random
    real(wp) :: q(4)
    q(1) = normal_draw(random)
    q(2:4) = random_direction(random)
    q = q/sqrt(q(1)**2 + q(2)**2 + q(3)**2 + q(4)**2)
  end function random_quaternion

  !> A net of n loose nodes at rest at the origin, a body of the given shape, contact.
  subroutine new_case(model, state, n, mass, shape, dimensions, target_mass, threshold)
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    integer, intent(in) :: n
    real(wp), intent(in) :: mass(:)           !! of the nodes, one for all or each [kg]
    character(len=*), intent(in) :: shape
    real(wp), intent(in) :: dimensions(3), target_mass, threshold
    type(error_t), allocatable :: error
    integer :: i
    allocate (model%net, model%target, model%contact)
    associate (net => model%net)
      net%n_node = n
      net%n_pad = ((n + 7)/8)*8
      allocate (net%node_mass(n), net%fixed(n), net%is_bullet(n))
      allocate (net%inverse_mass(net%n_pad), source=0.0_wp)
      do i = 1, n
        net%node_mass(i) = mass(min(i, size(mass)))
        net%inverse_mass(i) = 1.0_wp/net%node_mass(i)
      end do
      net%fixed = .false.
      net%is_bullet = .false.
      allocate (net%cable_nodes(2, 0), net%natural_length(0), net%axial_stiffness(0), net%damping(0))
    end associate
    call new_shape(model%target%shape, shape, dimensions, error)
    call set_body(model, target_mass, [1.0_wp, 1.0_wp, 1.0_wp])
    model%contact%threshold = threshold
    allocate (state%node_position(model%net%n_pad, 3), state%node_velocity(model%net%n_pad, 3), source=0.0_wp)
    allocate (state%target)
    allocate (state%impulse_histogram(impulse_bins), source=0_i8)
  end subroutine new_case

  !> Mass and principal moments of the body; mass 0: fixed.
  subroutine set_body(model, mass, moments)
    type(model_t), intent(inout) :: model
    real(wp), intent(in) :: mass, moments(3)
    integer :: i
    model%target%fixed = .not. mass > 0.0_wp
    model%target%mass = mass
    model%target%inverse_mass = 0.0_wp
    model%target%inertia = 0.0_wp
    model%target%inverse_inertia = 0.0_wp
    if (model%target%fixed) return
    model%target%inverse_mass = 1.0_wp/mass
    do i = 1, 3
      model%target%inertia(i, i) = moments(i)
      model%target%inverse_inertia(i, i) = 1.0_wp/moments(i)
    end do
  end subroutine set_body

  !> Cables between pairs of nodes, all of one kind.
  subroutine add_cables(model, nodes, natural_length, axial_stiffness)
    type(model_t), intent(inout) :: model
    integer, intent(in) :: nodes(:, :)
    real(wp), intent(in) :: natural_length, axial_stiffness
    integer :: m
    m = size(nodes, 2)
    associate (net => model%net)
      deallocate (net%cable_nodes, net%natural_length, net%axial_stiffness, net%damping)
      net%n_cable = m
      allocate (net%cable_nodes(2, m), net%natural_length(m), net%axial_stiffness(m), net%damping(m))
      net%cable_nodes = nodes
      net%natural_length = natural_length
      net%axial_stiffness = axial_stiffness
      net%damping = 0.0_wp
    end associate
  end subroutine add_cables

  function momentum(model, state) result(p)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: p(3)
    integer :: i
    p = model%target%mass*state%target%velocity
    do i = 1, model%net%n_node
      p = p + model%net%node_mass(i)*state%node_velocity(i, :)
    end do
  end function momentum

  !> About the inertial origin.
  function angular_momentum(model, state) result(l)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: l(3), i_omega(3)
    integer :: i
    i_omega = multiply(model%target%inertia, state%target%angular_velocity)
    l = rotate(state%target%attitude, i_omega) + model%target%mass*cross(state%target%position, state%target%velocity)
    do i = 1, model%net%n_node
      l = l + model%net%node_mass(i)*cross(state%node_position(i, :), state%node_velocity(i, :))
    end do
  end function angular_momentum

  real(wp) function kinetic_energy(model, state) result(energy)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    integer :: i
    energy = 0.5_wp*model%target%mass*sum(state%target%velocity**2) &
             + 0.5_wp*sum(state%target%angular_velocity*multiply(model%target%inertia, state%target%angular_velocity))
    do i = 1, model%net%n_node
      energy = energy + 0.5_wp*model%net%node_mass(i)*sum(state%node_velocity(i, :)**2)
    end do
  end function kinetic_energy

  real(wp) function elastic_energy(model, state) result(energy)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: stretch
    integer :: c
    energy = 0.0_wp
    do c = 1, model%net%n_cable
      stretch = max(0.0_wp, sqrt(sum((state%node_position(model%net%cable_nodes(1, c), :) &
                                      - state%node_position(model%net%cable_nodes(2, c), :))**2)) - model%net%natural_length(c))
      energy = energy + 0.5_wp*model%net%axial_stiffness(c)/model%net%natural_length(c)*stretch**2
    end do
  end function elastic_energy

  function centre_of_mass(model, state) result(c)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp) :: c(3)
    integer :: i
    c = model%target%mass*state%target%position
    do i = 1, model%net%n_node
      c = c + model%net%node_mass(i)*state%node_position(i, :)
    end do
    c = c/(model%target%mass + sum(model%net%node_mass))
  end function centre_of_mass

  !> Random node contacts on a body of mass 1 and unit-size inertia: masses within
  !> `spread` decades about `mass`, arms about 1 m, speeds about 1 m/s.
  subroutine random_contacts(random, n, mass, spread, list, body)
    type(random_t), intent(inout) :: random
    integer, intent(in) :: n
    real(wp), intent(in) :: mass, spread
    type(contact_list_t), intent(inout) :: list
    type(body_inertia_t), intent(out) :: body
    real(wp) :: q(4), a(3, 3)
    integer :: i
    call reserve_contacts(list, n)
    list%n = n
    q = random_quaternion(random)
    a = 0.0_wp
    do i = 1, 3
      a(i, i) = 0.1_wp + 0.2_wp*uniform(random)
    end do
    body%free = .true.
    body%mass = 1.0_wp
    body%inverse_mass = 1.0_wp
    body%inertia = congruent(rotation_matrix(q), a)
    do i = 1, 3
      a(i, i) = 1.0_wp/a(i, i)
    end do
    body%inverse_inertia = congruent(rotation_matrix(q), a)
    do i = 1, n
      list%node_a(i) = i
      list%node_b(i) = i
      list%share(i) = 0.0_wp
      list%weight_a(i) = 1.0_wp
      list%inverse_mass_a(i) = 1.0_wp/(mass*10.0_wp**(spread*(uniform(random) - 0.5_wp)))
      list%inverse_mass_b(i) = 0.0_wp
      list%normal(i, :) = random_direction(random)
      list%arm(i, :) = 0.5_wp*list%normal(i, :) + 0.5_wp*random_direction(random)
      list%velocity(i, :) = random_direction(random)
      list%velocity(i, :) = list%velocity(i, :)*uniform(random)
      list%normal_velocity(i) = sum(list%velocity(i, :)*list%normal(i, :))
      list%gap(i) = 0.0_wp
      list%impulse(i) = 0.0_wp
      list%friction_impulse(i, :) = 0.0_wp
    end do
  end subroutine random_contacts

  !> Contacts at random points of random cables between n_node nodes, so that many share nodes.
  subroutine random_cable_contacts(random, n, n_node, mass, list, body)
    type(random_t), intent(inout) :: random
    integer, intent(in) :: n, n_node
    real(wp), intent(in) :: mass
    type(contact_list_t), intent(inout) :: list
    type(body_inertia_t), intent(out) :: body
    real(wp) :: w(n_node), flat(3)
    integer :: i
    call random_contacts(random, n, mass, 0.0_wp, list, body)
    do i = 1, n_node
      w(i) = 10.0_wp**(uniform(random) - 0.5_wp)/mass
    end do
    flat = random_direction(random)
    do i = 1, n
      list%node_a(i) = 1 + int(n_node*uniform(random))
      list%node_b(i) = 1 + int(n_node*uniform(random))
      list%share(i) = uniform(random)
      if (mod(i, 4) == 0) list%node_b(i) = list%node_a(i)
      if (list%node_b(i) == list%node_a(i)) list%share(i) = 0.0_wp
      list%weight_a(i) = 1.0_wp - list%share(i)
      list%inverse_mass_a(i) = w(list%node_a(i))
      list%inverse_mass_b(i) = merge(0.0_wp, w(list%node_b(i)), list%node_b(i) == list%node_a(i))
      ! Normals within a cone: a net on one side of a body, where all can be lifted at once.
      list%normal(i, :) = flat + 0.5_wp*random_direction(random)
      list%normal(i, :) = list%normal(i, :)/sqrt(sum(list%normal(i, :)**2))
      list%normal_velocity(i) = sum(list%velocity(i, :)*list%normal(i, :))
    end do
  end subroutine random_cable_contacts

end module contact_cases
