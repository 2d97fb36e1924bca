!> What physics reports and io writes: plain data, so that neither sees the other.
module castnet_record
  use castnet_kinds, only: wp, i8
  implicit none
  private
  public :: history_row_t, capture_measures_t, summary_t, thresholds_t, deployment_t
  public :: verdict_failed, verdict_marginal, verdict_captured

  integer, parameter :: verdict_failed = 0, verdict_marginal = 1, verdict_captured = 2

  !> One row of /history. Energies [J], momenta about the inertial origin, net + target.
  type :: history_row_t
    real(wp) :: time = 0.0_wp
    real(wp) :: kinetic_net = 0.0_wp, kinetic_target = 0.0_wp, elastic = 0.0_wp
    real(wp) :: dissipated = 0.0_wp, contact_loss = 0.0_wp, winch_work = 0.0_wp
    real(wp) :: projection_work = 0.0_wp, external_work = 0.0_wp
    real(wp) :: linear_momentum(3) = 0.0_wp          !! [kg m/s]
    real(wp) :: angular_momentum(3) = 0.0_wp         !! [kg m2/s]
    real(wp) :: max_tension = 0.0_wp                 !! [N]
    integer(i8) :: contacts = 0
    real(wp) :: max_impulse = 0.0_wp, min_impulse = 0.0_wp, impulse_sum = 0.0_wp
    real(wp) :: max_bullet_impulse = 0.0_wp          !! [N s]
    real(wp) :: deepest_penetration = 0.0_wp         !! [m], >= 0
    real(wp) :: contact_residual = 0.0_wp            !! [m/s]
    integer :: contact_iterations = 0
  end type history_row_t

  !> Thresholds of the verdict (physics.md section 4).
  type :: thresholds_t
    real(wp) :: captured_coverage = 0.9_wp, captured_hole = 30.0_wp, captured_escape = 0.0_wp
    real(wp) :: failed_coverage = 0.6_wp, failed_escape = 0.05_wp
    real(wp) :: lasting_coverage = 0.8_wp, lasting_escape = 0.0_wp
  end type thresholds_t

  !> Capture measures at one time.
  type :: capture_measures_t
    real(wp) :: time = 0.0_wp
    real(wp) :: coverage = 0.0_wp            !! fraction of directions [-]
    real(wp) :: largest_hole = 0.0_wp        !! half-angle of the largest empty cone [degree]
    real(wp) :: escape = 0.0_wp              !! fraction of free directions [-]
    real(wp) :: cqi = 0.0_wp                 !! capture quality index [-]
    real(wp) :: mouth_area = 0.0_wp          !! [m2]
    real(wp) :: mouth_perimeter = 0.0_wp     !! [m]
    real(wp) :: bullet_distance_min = 0.0_wp !! from the target's centre of mass [m]
    real(wp) :: bullet_distance_max = 0.0_wp
    integer :: verdict = verdict_failed
  end type capture_measures_t

  !> How the net deployed (castnet_deployment).
  type :: deployment_t
    real(wp) :: largest_mouth_area = 0.0_wp  !! [m2]
    real(wp) :: deployment_time = 0.0_wp     !! when the mouth was largest [s]
    real(wp) :: deployment_distance = 0.0_wp !! of the net's centre of mass from its start then [m]
    real(wp) :: distance_travelled = 0.0_wp  !! the same at the end [m]
    real(wp) :: effective_period = 0.0_wp    !! time with the mouth above 80 % of its largest area [s]
    real(wp) :: open_period = 0.0_wp         !! time with it above 80 % of the net's flat area [s]
  end type deployment_t

  !> /summary of a run.
  type :: summary_t
    type(capture_measures_t), allocatable :: measures(:)
    type(thresholds_t) :: thresholds
    logical :: captured = .false.
    real(wp) :: impulse_percentiles(4) = 0.0_wp !! 50, 95, 99, 99.9 [N s]
    real(wp) :: first_contact = 0.0_wp       !! [s], NaN: none
    real(wp) :: closing_start = 0.0_wp       !! [s], NaN: none
    type(deployment_t) :: deployment         !! all NaN without a mouth of known size
    integer(i8), allocatable :: self_contacts(:) !! (3) crossings of cables: all, of taut ones, not undone; where counted
    logical :: keeps_cables_apart = .false.
    real(wp) :: wall_time = 0.0_wp           !! [s]
    integer(i8) :: steps = 0, force_evaluations = 0
  end type summary_t

end module castnet_record
