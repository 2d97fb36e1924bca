!> What a study asks for: one type per namelist group of a study file, one component per
!> key. Which case gets which values is for the study's design; plain data here.
module castnet_study_request
  use castnet_kinds, only: wp, i8
  use castnet_scene, only: word_length, path_length, unset, is_set
  use castnet_text, only: text_t
  implicit none
  private
  public :: study_request_t, study_group_t, vary_group_t, sample_group_t, search_group_t, grid_size, grid_value
  public :: is_search, first_points

  integer, parameter :: first_points = 9            !! of a threshold: looked at before anything is assumed

  type :: study_group_t
    character(len=path_length) :: scene = ''        !! base scene, seen from the study's folder
    integer(i8) :: seed = 0
    character(len=word_length) :: question = 'map'  !! 'map', 'threshold', 'optimum'
    integer :: seeds = 1                            !! runs per point
    character(len=word_length) :: record = 'table'  !! 'table', 'runs': each run's own file beside it
    character(len=path_length) :: file = ''         !! results, default the study's name with .h5
  end type study_group_t

  !> One varied key: a list, a grid (from, to, count), a range for a design (from, to), or a distribution.
  type :: vary_group_t
    character(len=path_length) :: key = ''          !! 'group/key', 'group/key(i)', 'part(k)/key(i)'
    character(len=word_length), allocatable :: values(:) !! as written: numbers, words or logicals
    real(wp) :: from = unset, to = unset            !! grid, range, or limits of 'uniform'
    integer :: count = 0                            !! grid points
    character(len=word_length) :: spacing = 'linear' !! 'linear', 'log'
    character(len=word_length) :: distribution = '' !! '', 'uniform' (from, to), 'normal' (mean, deviation)
    real(wp) :: mean = unset, deviation = unset
  end type vary_group_t

  type :: sample_group_t
    character(len=word_length) :: kind = 'grid'     !! 'grid', 'latin_hypercube', 'sobol'
    integer :: points = 0                           !! for the designs that are no grid
  end type sample_group_t

  !> Where the sequential search looks, and when it is content.
  type :: search_group_t
    character(len=path_length) :: key = ''
    real(wp) :: from = unset, to = unset
    real(wp) :: probability = 0.5_wp                !! the value that P(capture) crosses
    real(wp) :: confidence = 0.95_wp                !! of the interval that is told
    integer :: budget = 1000                        !! most runs, for each combination of the varied keys
  end type search_group_t

  type :: study_request_t
    character(len=:), allocatable :: path           !! the study's file, as given
    character(len=:), allocatable :: text           !! the study's text, as read
    type(study_group_t) :: study
    type(vary_group_t), allocatable :: vary(:)      !! allocated, maybe empty
    type(sample_group_t) :: sample
    type(search_group_t), allocatable :: search
    type(text_t), allocatable :: scene_overrides(:) !! 'group/key=value' of the command line, for the base scene
  end type study_request_t

contains

  !> Does the study choose its own points along a key?
  pure logical function is_search(request)
    type(study_request_t), intent(in) :: request
    is_search = request%study%question /= 'map' .and. allocated(request%search)
  end function is_search

  !> Points of a list or grid; 0 for a range or a distribution.
  pure integer function grid_size(vary)
    type(vary_group_t), intent(in) :: vary
    grid_size = 0
    if (allocated(vary%values)) then
      grid_size = size(vary%values)
    else if (len_trim(vary%distribution) == 0) then
      grid_size = max(0, vary%count)
    end if
  end function grid_size

  !> Value number i of a grid (from, to, count); both ends exact, one point is `from`.
  pure real(wp) function grid_value(vary, i) result(value)
    type(vary_group_t), intent(in) :: vary
    integer, intent(in) :: i   !! 1 to count
    real(wp) :: s
    value = vary%from
    if (i == 1 .or. vary%count == 1) return
    if (i == vary%count) then
      value = vary%to
      return
    end if
    s = real(i - 1, wp)/real(vary%count - 1, wp)
    if (vary%spacing == 'log') then
      value = vary%from*(vary%to/vary%from)**s
    else
      value = vary%from + s*(vary%to - vary%from)
    end if
  end function grid_value

end module castnet_study_request
