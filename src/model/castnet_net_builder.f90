!> Nets made from parameters: the square net of the paper's Fig. 1, stowed and shot.
module castnet_net_builder
  use castnet_kinds, only: wp
  use castnet_constants, only: pi, degree
  use castnet_cable_plan, only: build_cable_plan
  use castnet_net, only: net_t
  use castnet_perturb, only: perturbation_t
  use castnet_scene, only: net_group_t, bullets_group_t
  use castnet_trigonometry, only: sine_cosine
  implicit none
  private
  public :: square_net_nodes, build_square_net, finish_net, pair_damping

contains

  !> How many nodes `build_square_net` makes, bullets included.
  pure integer function square_net_nodes(group, bullets) result(n)
    type(net_group_t), intent(in) :: group
    type(bullets_group_t), allocatable, intent(in) :: bullets
    associate (ny => group%squares(1), nz => group%squares(2))
      n = (ny + 1)*(nz + 1) + ((nz + 1)*ny + (ny + 1)*nz)*(group%cables_per_side - 1)
    end associate
    if (allocated(bullets)) n = n + 4
  end function square_net_nodes

  !> A square net in the plane normal to the flight direction +x, its centre at the
  !> origin, scaled by `stowed_scale`, nodes at rest; bullets on corner cables outside
  !> their corners along the diagonals, shot at `angle` from +x outward along them.
  !> Source: physics.md section 1. Nodes: the grid row by row (y fastest), then the inner
  !> nodes of the mesh sides, then the bullets in order round the mouth.
  subroutine build_square_net(group, bullets, drawn, net, position, velocity)
    type(net_group_t), intent(in) :: group
    type(bullets_group_t), allocatable, intent(in) :: bullets
    type(perturbation_t), intent(in) :: drawn
    type(net_t), intent(out) :: net
    real(wp), allocatable, intent(out) :: position(:, :) !! (n_node,3) [m]
    real(wp), allocatable, intent(out) :: velocity(:, :) !! (n_node,3) [m/s]
    integer :: ny, nz, sides, n_grid, n_inner, n_bullet, iy, iz, j, c, k, a, b, perimeter_count
    real(wp) :: length, area, edge_area, outward(3), angle, sine, cosine, speed, scale
    logical :: at_edge
    real(wp), allocatable :: linear_density(:), half_mass(:, :)

    ny = group%squares(1)
    nz = group%squares(2)
    sides = (nz + 1)*ny + (ny + 1)*nz
    n_grid = (ny + 1)*(nz + 1)
    n_inner = sides*(group%cables_per_side - 1)
    n_bullet = merge(4, 0, allocated(bullets))
    net%n_node = n_grid + n_inner + n_bullet
    net%n_cable = sides*group%cables_per_side + n_bullet
    net%clamp_tension = group%clamp_tension
    net%side_length = maxval(group%squares)*group%mesh_length
    net%flat_area = real(ny, wp)*real(nz, wp)*group%mesh_length**2
    length = group%mesh_length/group%cables_per_side
    area = 0.25_wp*pi*group%cable_diameter**2
    edge_area = 0.25_wp*pi*group%edge_cable_diameter**2
    scale = group%stowed_scale

    allocate (position(net%n_node, 3), velocity(net%n_node, 3), source=0.0_wp)
    allocate (half_mass(net%n_node, 2), source=0.0_wp)
    allocate (net%fixed(net%n_node), net%is_bullet(net%n_node), source=.false.)
    allocate (net%cable_nodes(2, net%n_cable))
    allocate (net%natural_length(net%n_cable), net%axial_stiffness(net%n_cable), net%damping(net%n_cable))
    allocate (linear_density(net%n_cable))

    do iz = 0, nz
      do iy = 0, ny
        position(grid(iy, iz), 2) = (iy - 0.5_wp*ny)*group%mesh_length*scale
        position(grid(iy, iz), 3) = (iz - 0.5_wp*nz)*group%mesh_length*scale
      end do
    end do

    c = 0
    do iz = 0, nz
      at_edge = iz == 0 .or. iz == nz
      do iy = 0, ny - 1
        call add_side(grid(iy, iz), grid(iy + 1, iz))
      end do
    end do
    do iz = 0, nz - 1
      do iy = 0, ny
        at_edge = iy == 0 .or. iy == ny
        call add_side(grid(iy, iz), grid(iy, iz + 1))
      end do
    end do
    ! Half of every cable at each end, by direction first: the same bits for a node and for
    ! its image in a symmetric net, whatever the order of the cables.
    do k = 1, c
      a = merge(2, 1, k > (nz + 1)*ny*group%cables_per_side)
      do j = 1, 2
        b = net%cable_nodes(j, k)
        half_mass(b, a) = half_mass(b, a) + 0.5_wp*linear_density(k)*length
      end do
    end do
    net%node_mass = half_mass(:, 1) + half_mass(:, 2)

    net%corner_nodes = [grid(0, 0), grid(ny, 0), grid(ny, nz), grid(0, nz)]
    call trace_perimeter()
    allocate (net%faces(4, ny*nz))
    do iz = 0, nz - 1
      do iy = 0, ny - 1
        net%faces(:, iz*ny + iy + 1) = [grid(iy, iz), grid(iy + 1, iz), grid(iy + 1, iz + 1), grid(iy, iz + 1)]
      end do
    end do

    allocate (net%bullet_nodes(n_bullet))
    do k = 1, n_bullet
      a = net%corner_nodes(k)
      b = n_grid + n_inner + k
      net%bullet_nodes(k) = b
      net%is_bullet(b) = .true.
      net%node_mass(b) = bullets%mass
      outward = position(a, :)/sqrt(position(a, 2)**2 + position(a, 3)**2)
      position(b, :) = position(a, :) + scale*bullets%corner_cable_length*outward
      speed = bullets%speed + drawn%bullet_speed(k)
      angle = bullets%angle*degree + drawn%bullet_angle(k)
      call sine_cosine(angle, sine, cosine)
      velocity(b, :) = speed*sine*outward
      velocity(b, 1) = speed*cosine
      c = c + 1
      net%cable_nodes(:, c) = [a, b]
      net%natural_length(c) = bullets%corner_cable_length
      net%axial_stiffness(c) = group%elastic_modulus*edge_area
    end do
    call pair_damping(net, group%damping_ratio)
    call finish_net(net)

  contains

    pure integer function grid(jy, jz)
      integer, intent(in) :: jy, jz
      grid = jz*(ny + 1) + jy + 1
    end function grid

    !> One mesh side from grid node i to grid node f, in cables_per_side cables.
    subroutine add_side(i, f)
      integer, intent(in) :: i, f
      integer :: first_inner, previous, next
      real(wp) :: s
      ! Sides are added in order, so the inner nodes of side c follow from the count so far.
      first_inner = n_grid + (c/group%cables_per_side)*(group%cables_per_side - 1)
      previous = i
      do j = 1, group%cables_per_side
        next = f
        if (j < group%cables_per_side) then
          next = first_inner + j
          s = real(j, wp)/group%cables_per_side
          position(next, :) = (1.0_wp - s)*position(i, :) + s*position(f, :)
        end if
        c = c + 1
        net%cable_nodes(:, c) = [previous, next]
        net%natural_length(c) = length
        net%axial_stiffness(c) = group%elastic_modulus*merge(edge_area, area, at_edge)
        linear_density(c) = group%density*merge(edge_area, area, at_edge)
        previous = next
      end do
    end subroutine add_side

    !> The closed loop of edge nodes from corner to corner, inner nodes included.
    subroutine trace_perimeter()
      allocate (net%perimeter_nodes(2*(ny + nz)*group%cables_per_side))
      perimeter_count = 0
      do iy = 0, ny - 1
        call trace_side(iy, .false.)
      end do
      do iz = 0, nz - 1
        call trace_side((nz + 1)*ny + iz*(ny + 1) + ny, .false.)
      end do
      do iy = ny - 1, 0, -1
        call trace_side(nz*ny + iy, .true.)
      end do
      do iz = nz - 1, 0, -1
        call trace_side((nz + 1)*ny + iz*(ny + 1), .true.)
      end do
    end subroutine trace_perimeter

    !> First nodes of the cables of mesh side number `side` (from 0), either way round.
    subroutine trace_side(side, backward)
      integer, intent(in) :: side
      logical, intent(in) :: backward
      integer :: first, m
      first = side*group%cables_per_side
      do m = 1, group%cables_per_side
        perimeter_count = perimeter_count + 1
        if (backward) then
          net%perimeter_nodes(perimeter_count) = net%cable_nodes(2, first + group%cables_per_side + 1 - m)
        else
          net%perimeter_nodes(perimeter_count) = net%cable_nodes(1, first + m)
        end if
      end do
    end subroutine trace_side

  end subroutine build_square_net

  !> c = 2 zeta sqrt(k mu) with the reduced mass mu of each cable's end nodes; a fixed
  !> end counts as infinitely heavy. Source: physics.md section 1.
  subroutine pair_damping(net, damping_ratio)
    type(net_t), intent(inout) :: net
    real(wp), intent(in) :: damping_ratio !! zeta [-]
    real(wp) :: inverse(2), k
    integer :: c, e
    do c = 1, net%n_cable
      do e = 1, 2
        inverse(e) = 0.0_wp
        if (.not. net%fixed(net%cable_nodes(e, c))) inverse(e) = 1.0_wp/net%node_mass(net%cable_nodes(e, c))
      end do
      k = net%axial_stiffness(c)/net%natural_length(c)
      net%damping(c) = 0.0_wp
      if (inverse(1) + inverse(2) > 0.0_wp) net%damping(c) = 2.0_wp*damping_ratio*sqrt(k/(inverse(1) + inverse(2)))
    end do
  end subroutine pair_damping

  !> What every net needs once its nodes and cables are known, wherever they came from.
  subroutine finish_net(net)
    type(net_t), intent(inout) :: net
    integer, parameter :: lanes = 8
    integer :: i
    net%n_pad = ((net%n_node + lanes - 1)/lanes)*lanes
    if (allocated(net%inverse_mass)) deallocate (net%inverse_mass)
    allocate (net%inverse_mass(net%n_pad), source=0.0_wp)
    do i = 1, net%n_node
      if (.not. net%fixed(i)) net%inverse_mass(i) = 1.0_wp/net%node_mass(i)
    end do
    if (.not. allocated(net%is_bullet)) allocate (net%is_bullet(net%n_node), source=.false.)
    if (.not. allocated(net%bullet_nodes)) allocate (net%bullet_nodes(0))
    if (.not. allocated(net%corner_nodes)) allocate (net%corner_nodes(0))
    if (.not. allocated(net%perimeter_nodes)) allocate (net%perimeter_nodes(0))
    if (.not. allocated(net%faces)) allocate (net%faces(4, 0))
    call build_cable_plan(net%plan, net%n_node, net%cable_nodes, net%axial_stiffness, net%natural_length, net%damping)
  end subroutine finish_net

end module castnet_net_builder
