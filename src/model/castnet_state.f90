!> What changes in a run: exactly what a checkpoint holds, so that a restarted run
!> and an uninterrupted one are the same object with the same bits. No scratch here.
!>
!> Net arrays are stored one component after the other, `(n_pad, 3)`, because the
!> kernels run along the nodes; rows beyond `n_node` are padding and stay zero.
module castnet_state
  use castnet_kinds, only: wp, i8
  use castnet_record, only: capture_measures_t
  implicit none
  private
  public :: state_t, body_state_t, closing_state_t, deployment_state_t, ledger_t, tally_t, schedule_t
  public :: area_bins, area_bins_per_unit
  public :: self_all, self_taut, self_unresolved
  public :: impulse_bins, impulse_bin_low, impulse_bins_per_decade

  !> Impulses of single contacts are counted in logarithmic bins, so that their
  !> percentiles need no list that grows with the run: bin k holds impulses from
  !> low*10**((k-1)/per_decade), which resolves a percentile to 0.6 %.
  integer, parameter :: impulse_bins = 4000
  integer, parameter :: impulse_bins_per_decade = 200
  real(wp), parameter :: impulse_bin_low = 1.0e-14_wp !! [N s]

  !> The time that the mouth spent at each area is counted in bins, parts of the net's flat
  !> area: up to 1.28 of it, so that a stretched net fits.
  integer, parameter :: area_bins = 1024
  real(wp), parameter :: area_bins_per_unit = 800.0_wp

  !> What is counted of cables that pass through each other.
  integer, parameter :: self_all = 1, self_taut = 2, self_unresolved = 3

  !> The rigid target.
  type :: body_state_t
    real(wp) :: position(3) = 0.0_wp          !! centre of mass, inertial [m]
    real(wp) :: velocity(3) = 0.0_wp          !! inertial [m/s]
    real(wp) :: attitude(4) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp] !! unit quaternion, body to inertial, scalar first
    real(wp) :: angular_velocity(3) = 0.0_wp  !! body axes [rad/s]
  end type body_state_t

  !> Latches of the closing thread, one per side.
  type :: closing_state_t
    logical :: triggered = .false.
    real(wp) :: start_time = -1.0_wp          !! winches pull from here on [s]
    logical :: pulling = .false.
    real(wp) :: rest_length(4) = 0.0_wp       !! ratchet [m]
    logical :: locked(4) = .false.
  end type closing_state_t

  !> How the net has deployed, as seen at the history rows (castnet_deployment).
  type :: deployment_state_t
    logical :: begun = .false.                !! a row has been seen
    real(wp) :: start(3) = 0.0_wp             !! the net's centre of mass at t = 0 [m]
    real(wp) :: time = 0.0_wp                 !! of the last row [s]
    real(wp) :: area = 0.0_wp                 !! of the mouth at the last row [m2]
    real(wp) :: distance = 0.0_wp             !! of the centre of mass from its start at the last row [m]
    real(wp) :: largest_area = 0.0_wp         !! of the mouth so far [m2]
    real(wp) :: largest_time = 0.0_wp         !! when that was [s]
    real(wp) :: largest_distance = 0.0_wp     !! how far the net was then [m]
    real(wp) :: time_at(area_bins) = 0.0_wp   !! spent with the mouth in each bin of area [s]
  end type deployment_state_t

  !> Energy that left or entered net and target, since t = 0 [J].
  type :: ledger_t
    real(wp) :: dissipated = 0.0_wp           !! by the cables' damping, >= 0
    real(wp) :: contact_loss = 0.0_wp         !! by impulses
    real(wp) :: winch_work = 0.0_wp           !! done by the winch
    real(wp) :: projection_work = 0.0_wp      !! by moving nodes back to the surface
    real(wp) :: external_work = 0.0_wp        !! by gravity, external force and torque, orbital frame
  end type ledger_t

  !> What happened at contacts since the last history row.
  type :: tally_t
    integer(i8) :: contacts = 0               !! impulses applied
    real(wp) :: max_impulse = 0.0_wp          !! bullets excluded [N s]
    real(wp) :: min_impulse = 0.0_wp          !! bullets excluded [N s]
    real(wp) :: impulse_sum = 0.0_wp          !! bullets excluded [N s]
    real(wp) :: max_bullet_impulse = 0.0_wp   !! [N s]
    real(wp) :: deepest_penetration = 0.0_wp  !! after correction, >= 0 [m]
    real(wp) :: max_tension = 0.0_wp          !! [N]
    real(wp) :: contact_residual = 0.0_wp     !! largest complementarity residual [m/s]
    integer :: contact_iterations = 0         !! most iterations of one event
  end type tally_t

  !> How many of each output have been taken, and at which step the last one.
  type :: schedule_t
    integer(i8) :: frames = 0
    integer(i8) :: rows = 0
    integer(i8) :: verdicts = 0
    integer(i8) :: checkpoints = 0
    integer(i8) :: frame_step = -1, row_step = -1, checkpoint_step = 0
  end type schedule_t

  type :: state_t
    integer(i8) :: step = 0                   !! steps taken
    real(wp) :: time = 0.0_wp                 !! [s]
    integer(i8) :: force_evaluations = 0
    real(wp), allocatable :: node_position(:, :)     !! (n_pad,3) inertial [m]
    real(wp), allocatable :: node_velocity(:, :)     !! (n_pad,3) [m/s]
    real(wp), allocatable :: velocity_ahead(:, :)    !! (n_pad,3) extrapolated to the next midpoint, method 'midpoint' only [m/s]
    real(wp) :: substep = 0.0_wp              !! the part of a step that would be tried next, 'adaptive' only; 0: none yet [s]
    type(body_state_t), allocatable :: target
    type(closing_state_t), allocatable :: closing
    type(deployment_state_t), allocatable :: deployment !! with a mouth whose flat area is known
    type(ledger_t) :: ledger
    type(tally_t) :: tally
    type(schedule_t) :: schedule
    real(wp) :: first_contact = -1.0_wp       !! time of the first impulse [s], negative: none yet
    integer(i8), allocatable :: impulse_histogram(:) !! (impulse_bins), bullets excluded; allocated with contact
    type(capture_measures_t), allocatable :: measures(:) !! taken so far at the scene's verdict times
    integer(i8), allocatable :: self_contacts(:)     !! (3) crossings so far: all, of taut cables, not undone; where counted
    real(wp) :: skip_contact_until = 0.0_wp   !! proven: nothing can touch before this time [s]
  end type state_t

end module castnet_state
