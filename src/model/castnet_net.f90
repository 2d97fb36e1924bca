!> The net: point masses joined by tension-only cables. Topology and material only;
!> where the nodes are and how they move is state. Built once, never changed.
module castnet_net
  use castnet_kinds, only: wp
  use castnet_cable_plan, only: cable_plan_t
  implicit none
  private
  public :: net_t

  type :: net_t
    integer :: n_node = 0
    integer :: n_pad = 0                             !! leading size of the state's net arrays, >= n_node
    integer :: n_cable = 0
    logical :: clamp_tension = .true.                !! tension never negative
    real(wp), allocatable :: node_mass(:)            !! (n_node) [kg]
    real(wp), allocatable :: inverse_mass(:)         !! (n_pad) 1/mass; 0 for fixed nodes and padding [1/kg]
    logical, allocatable :: fixed(:)                 !! (n_node)
    logical, allocatable :: is_bullet(:)             !! (n_node)
    integer, allocatable :: cable_nodes(:, :)        !! (2,n_cable), counted from 1
    real(wp), allocatable :: natural_length(:)       !! (n_cable) [m]
    real(wp), allocatable :: axial_stiffness(:)      !! (n_cable) EA [N]
    real(wp), allocatable :: damping(:)              !! (n_cable) [N s/m]
    integer, allocatable :: bullet_nodes(:)          !! (4) or empty, counted from 1, in order round the mouth
    integer, allocatable :: perimeter_nodes(:)       !! closed loop of the net's edge, counted from 1, without the bullets
    integer, allocatable :: corner_nodes(:)          !! (4) or empty: the net corner that each bullet hangs on
    integer, allocatable :: faces(:, :)              !! (4,n_face) mesh squares, counted from 1, for coverage
    integer, allocatable :: original_node(:)         !! (n_node) number that each node came with; unallocated: its own
    real(wp) :: side_length = 0.0_wp                 !! squares x mesh length of the longer side [m], 0 for a net from a file
    real(wp) :: flat_area = 0.0_wp                   !! of the net spread out [m2], 0 for a net from a file
    type(cable_plan_t) :: plan                       !! the cables as the force kernel wants them
  end type net_t

end module castnet_net
