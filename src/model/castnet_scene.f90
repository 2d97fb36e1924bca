!> What the user asks for: one type per namelist group of a scene, one component
!> per key, defaults in the declarations. A group that the scene leaves out is not
!> allocated, and then nothing of it is modelled. Plain data: who reads it from a
!> file is io's business, who turns it into a model is the builder's.
!>
!> A real that has no fixed default holds `unset` until the schema resolves it.
module castnet_scene
  use castnet_kinds, only: wp, i8
  use castnet_text, only: text_t
  implicit none
  private
  public :: scene_t, net_group_t, bullets_group_t, target_group_t, part_group_t, contact_group_t, &
            closing_group_t, environment_group_t, time_group_t, output_group_t, perturb_group_t
  public :: unset, is_set, word_length, path_length

  integer, parameter :: word_length = 24
  integer, parameter :: path_length = 4096
  real(wp), parameter :: unset = -huge(1.0_wp)  !! marks a real without a value

  type :: net_group_t
    character(len=word_length) :: kind = 'square'   !! 'square', 'file'
    integer :: squares(2) = 0                       !! mesh squares along y and z
    real(wp) :: mesh_length = unset                 !! [m]
    real(wp) :: cable_diameter = unset              !! [m]
    real(wp) :: edge_cable_diameter = unset         !! [m], default cable_diameter
    real(wp) :: density = 1440.0_wp                 !! [kg/m3]
    real(wp) :: elastic_modulus = 4.456e8_wp        !! [Pa]
    real(wp) :: damping_ratio = 0.1_wp              !! [-]
    integer :: cables_per_side = 1                  !! cables in one mesh side
    real(wp) :: stowed_scale = 0.15_wp              !! [-]
    logical :: clamp_tension = .true.               !! tension never negative
    character(len=path_length) :: file = ''
  end type net_group_t

  type :: bullets_group_t
    real(wp) :: mass = unset                        !! of each one [kg]
    real(wp) :: speed = unset                       !! [m/s]
    real(wp) :: angle = 25.0_wp                     !! from +x, outward along the diagonals [degree]
    real(wp) :: corner_cable_length = unset         !! [m], default sqrt(2) mesh lengths
  end type bullets_group_t

  type :: target_group_t
    character(len=word_length) :: shape = ''        !! 'box', 'cylinder', 'sphere', 'capsule', 'compound', 'mesh'
    real(wp) :: dimensions(3) = unset               !! [m]; as many as the shape needs
    real(wp) :: mass = unset                        !! [kg]
    real(wp) :: inertia(6) = unset                  !! xx yy zz xy xz yz, tensor entries [kg m2]; default uniform solid
    real(wp) :: position(3) = unset                 !! centre of mass, inertial [m]
    real(wp) :: velocity(3) = 0.0_wp                !! inertial [m/s]
    real(wp) :: attitude(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp] !! body to inertial, scalar first
    real(wp) :: angular_velocity(3) = 0.0_wp        !! body axes [rad/s]
    real(wp) :: phase = 0.0_wp                      !! turn of the attitude about phase_axis [degree]
    real(wp) :: phase_axis(3) = unset               !! body axes; default the direction of angular_velocity
    logical :: fixed = .false.
    real(wp) :: external_force(3) = 0.0_wp          !! inertial [N]
    real(wp) :: external_torque(3) = 0.0_wp         !! body axes [N m]
    character(len=path_length) :: file = ''         !! STL or OBJ for 'mesh'
  end type target_group_t

  type :: part_group_t
    character(len=word_length) :: shape = ''        !! 'box', 'cylinder', 'sphere', 'capsule'
    real(wp) :: dimensions(3) = unset
    real(wp) :: position(3) = 0.0_wp                !! of the part's centre, body axes [m]
    real(wp) :: attitude(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp] !! part to body, scalar first
  end type part_group_t

  type :: contact_group_t
    character(len=word_length) :: law = 'impulse'   !! 'impulse', 'penalty', 'hunt_crossley'
    character(len=word_length) :: detect = 'nodes'  !! 'nodes', 'cables'
    real(wp) :: restitution = 1.0_wp
    real(wp) :: friction = 0.0_wp
    real(wp) :: threshold = unset                   !! [m]
    character(len=word_length) :: impulses = 'push_only' !! 'push_only', 'equality'
    character(len=word_length) :: solver = 'reduced'     !! 'reduced', 'dense'
    real(wp) :: stiffness = unset                   !! compliant laws [N/m] or [N/m^1.5]
    real(wp) :: damping = unset                     !! compliant laws [N s/m] or [s/m]
    character(len=word_length) :: self_contact = 'none' !! 'none', 'count', 'taut', 'impulses'
  end type contact_group_t

  type :: closing_group_t
    character(len=word_length) :: trigger = 'contact' !! 'contact', 'time', 'passed_target'
    real(wp) :: delay = 0.0_wp                      !! [s]
    real(wp) :: winch_speed = unset                 !! per side [m/s]
    real(wp) :: locked_length = unset               !! per side [m]
    real(wp) :: max_tension = unset                 !! [N]
    character(len=word_length) :: path = 'perimeter' !! 'perimeter', 'bullets'
    real(wp) :: ring_friction = 0.0_wp              !! capstan coefficient [-]
  end type closing_group_t

  type :: environment_group_t
    real(wp) :: gravity(3) = 0.0_wp                 !! [m/s2]
    real(wp) :: orbit_rate = 0.0_wp                 !! [rad/s]
  end type environment_group_t

  type :: time_group_t
    real(wp) :: end_time = unset                    !! [s]
    real(wp) :: step = 0.0_wp                       !! [s], 0 = chosen
    character(len=word_length) :: method = 'midpoint' !! 'rk4', 'midpoint', 'adaptive'
    real(wp) :: tolerance = 1.0e-8_wp               !! for 'adaptive'
    logical :: allow_unstable = .false.
  end type time_group_t

  type :: output_group_t
    character(len=path_length) :: file = ''
    real(wp) :: frame_interval = unset              !! [s], default end_time/100
    real(wp) :: history_interval = unset            !! [s], default frame_interval/10
    real(wp) :: checkpoint_interval = 0.0_wp        !! simulated [s], 0 = none
    real(wp) :: checkpoint_wall_interval = 0.0_wp   !! wall [s], 0 = none
    real(wp), allocatable :: verdict_times(:)       !! [s], default the end
    logical :: vtk = .true.
  end type output_group_t

  type :: perturb_group_t
    integer(i8) :: seed = 0
    real(wp) :: node_position = 0.0_wp              !! standard deviation of each coordinate [m]
    real(wp) :: bullet_speed = 0.0_wp               !! [m/s]
    real(wp) :: bullet_angle = 0.0_wp               !! [degree]
    real(wp) :: target_position = 0.0_wp            !! of each coordinate [m]
    real(wp) :: target_rate = 0.0_wp                !! of each component [rad/s]
  end type perturb_group_t

  type :: scene_t
    character(len=:), allocatable :: path           !! the scene's file, as given
    character(len=:), allocatable :: text           !! the scene's text, as read
    type(text_t), allocatable :: included(:)        !! paths of the files that it includes, if any
    type(net_group_t), allocatable :: net
    type(bullets_group_t), allocatable :: bullets
    type(target_group_t), allocatable :: target
    type(part_group_t), allocatable :: parts(:)
    type(contact_group_t), allocatable :: contact
    type(closing_group_t), allocatable :: closing
    type(environment_group_t), allocatable :: environment
    type(time_group_t) :: time
    type(output_group_t) :: output
    type(perturb_group_t), allocatable :: perturb
  end type scene_t

contains

  !> Has this real been given a value?
  elemental logical function is_set(value)
    real(wp), intent(in) :: value
    is_set = value > 0.5_wp*unset
  end function is_set

end module castnet_scene
