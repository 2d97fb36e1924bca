!> What never changes in a run. A part that the scene leaves out is not allocated.
module castnet_model
  use castnet_kinds, only: wp
  use castnet_net, only: net_t
  use castnet_shape, only: shape_t
  implicit none
  private
  public :: model_t, target_t, contact_t, closing_t
  public :: law_impulse, law_penalty, law_hunt_crossley, method_rk4, method_midpoint, method_adaptive
  public :: trigger_contact, trigger_time, trigger_passed_target
  public :: self_contact_none, self_contact_count, self_contact_taut, self_contact_impulses

  integer, parameter :: law_impulse = 1, law_penalty = 2, law_hunt_crossley = 3
  integer, parameter :: method_rk4 = 1, method_midpoint = 2, method_adaptive = 3
  integer, parameter :: trigger_contact = 1, trigger_time = 2, trigger_passed_target = 3
  integer, parameter :: self_contact_none = 0, self_contact_count = 1, self_contact_taut = 2, self_contact_impulses = 3

  !> The rigid target.
  type :: target_t
    type(shape_t) :: shape                     !! in body axes, origin at the centre of mass
    logical :: fixed = .false.
    real(wp) :: mass = 0.0_wp                  !! [kg]; 0 when fixed and not given
    real(wp) :: inverse_mass = 0.0_wp          !! 0 when fixed
    real(wp) :: inertia(3, 3) = 0.0_wp         !! about the centre of mass, body axes [kg m2]
    real(wp) :: inverse_inertia(3, 3) = 0.0_wp !! 0 when fixed
    real(wp) :: external_force(3) = 0.0_wp     !! inertial [N]
    real(wp) :: external_torque(3) = 0.0_wp    !! body axes [N m]
  end type target_t

  !> How net and target meet.
  type :: contact_t
    integer :: law = law_impulse
    logical :: detect_cables = .false.
    logical :: push_only = .true.
    logical :: dense = .false.
    real(wp) :: restitution = 1.0_wp
    real(wp) :: friction = 0.0_wp
    real(wp) :: threshold = 0.0_wp             !! [m]
    real(wp) :: stiffness = 0.0_wp, damping = 0.0_wp
    integer :: self_contact = self_contact_none !! of the net's cables with each other
  end type contact_t

  !> The closing thread (physics.md section 5).
  type :: closing_t
    integer :: trigger = trigger_contact
    real(wp) :: delay = 0.0_wp, winch_speed = 0.0_wp, locked_length = 0.0_wp, max_tension = 0.0_wp
    real(wp) :: ring_friction = 0.0_wp
    real(wp) :: stiffness = 0.0_wp             !! k_t [N/m]
    real(wp) :: damping = 0.0_wp               !! c_t [N s/m]
    integer, allocatable :: path_start(:)      !! (5) side s runs over path_node(path_start(s):path_start(s+1)-1)
    integer, allocatable :: path_node(:)       !! nodes along each side, bullets at the ends, counted from 1
  end type closing_t

  type :: model_t
    type(net_t), allocatable :: net
    type(target_t), allocatable :: target
    type(contact_t), allocatable :: contact
    type(closing_t), allocatable :: closing
    real(wp) :: gravity(3) = 0.0_wp            !! [m/s2]
    real(wp) :: orbit_rate = 0.0_wp            !! [rad/s]
    integer :: method = method_rk4
    real(wp) :: step = 0.0_wp                  !! [s]
    real(wp) :: end_time = 0.0_wp              !! [s]
    real(wp) :: tolerance = 0.0_wp             !! for 'adaptive'
  end type model_t

end module castnet_model
