!> One row of a study's table: plain data between the study that makes it and io that keeps it.
module castnet_study_record
  use castnet_kinds, only: wp, i8
  implicit none
  private
  public :: case_row_t, point_row_t, search_row_t, n_measure, measure_name, measure_units
  public :: case_done, case_invalid, case_failed, case_missing, reason_length

  integer, parameter :: case_missing = -1  !! not run yet
  integer, parameter :: case_done = 0
  integer, parameter :: case_invalid = 2   !! the scene was refused
  integer, parameter :: case_failed = 3    !! numerical failure
  integer, parameter :: reason_length = 240

  !> What is recorded of each run, in this order.
  integer, parameter :: n_measure = 18
  character(len=20), parameter :: measure_name(n_measure) = [character(len=20) :: &
    'captured', 'verdict', 'coverage', 'largest_hole', 'escape', 'cqi', 'mouth_area', 'mouth_perimeter', &
    'bullet_distance_min', 'bullet_distance_max', 'first_contact', 'final_spin', 'final_speed', 'spin_change', &
    'max_impulse', 'max_tension', 'deepest_penetration', 'steps']
  character(len=8), parameter :: measure_units(n_measure) = [character(len=8) :: &
    '1', '1', '1', 'degree', '1', '1', 'm2', 'm', 'm', 'm', 's', 'rad s-1', 'm s-1', 'rad s-1', 'N s', 'N', 'm', '1']

  type :: case_row_t
    integer(i8) :: case = 0        !! from 1
    integer(i8) :: point = 0       !! from 1
    integer(i8) :: seed = 0
    integer :: status = case_missing
    real(wp), allocatable :: varied(:)    !! numbers; a word's place in its list, a logical as 0 or 1
    real(wp) :: measure(n_measure) = 0.0_wp
    character(len=reason_length) :: reason = ''
  end type case_row_t

  type :: point_row_t
    integer :: runs = 0, captured = 0
    real(wp) :: probability = 0.0_wp, lower = 0.0_wp, upper = 1.0_wp
    real(wp), allocatable :: varied(:)
  end type point_row_t

  !> What one search found; NaN where the question has no such number.
  type :: search_row_t
    real(wp), allocatable :: varied(:)        !! the keys besides the searched one
    integer :: runs = 0
    integer :: crossings = 0                  !! of a threshold: intervals over which the estimate crosses
    logical :: found = .false.
    real(wp) :: estimate = 0.0_wp             !! of the searched key
    real(wp) :: lower = 0.0_wp, upper = 0.0_wp
    real(wp) :: probability = 0.0_wp          !! asked for, or at the best value
    real(wp) :: probability_lower = 0.0_wp, probability_upper = 0.0_wp
  end type search_row_t

end module castnet_study_record
