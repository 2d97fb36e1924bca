!> Which cases a study consists of: the points, and for each point its runs. A case is
!> known by its number alone: case = (point - 1) stride + run, where the stride is the runs
!> of a point, or the budget of a search (whose points are the combinations of the other
!> keys). Its seed and every drawn value follow from the study's seed and that number, so
!> neither order, threads, shards nor machines matter.
module castnet_study_design
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_input
  use castnet_rng, only: rng_t, seed_rng, uniform, normal, hash_seed, normal_quantile
  use castnet_sobol, only: sobol_point, latin_hypercube, sobol_dimensions
  use castnet_study_request, only: study_request_t, vary_group_t, grid_size, grid_value, is_search
  use castnet_text, only: to_text, text_t
  implicit none
  private
  public :: design_t, new_design, case_point, case_values, case_seed, is_drawn

  type :: design_t
    integer :: n_vary = 0
    integer(i8) :: n_point = 1
    integer(i8) :: n_case = 1                !! of a search: at most
    integer(i8) :: stride = 1                !! case numbers of a point
    integer(i8) :: seed = 0
    logical :: is_grid = .true.
    integer, allocatable :: size_of(:)       !! (n_vary) points along each grid key, 1 for drawn ones
    real(wp), allocatable :: unit(:, :)      !! (n_vary,n_point) of a design in the unit cube
  end type design_t

  integer(i8), parameter :: draw_stream = 7919_i8  !! keeps drawn keys and &perturb apart

contains

  !> Lay out a study. Errors: more keys than the Sobol table has dimensions.
  subroutine new_design(design, request, error)
    type(design_t), intent(out) :: design
    type(study_request_t), intent(in) :: request
    type(error_t), allocatable, intent(inout) :: error
    integer :: i

    design%n_vary = size(request%vary)
    design%stride = max(1, request%study%seeds)
    if (is_search(request)) design%stride = request%search%budget
    design%seed = request%study%seed
    design%is_grid = request%sample%kind == 'grid'
    allocate (design%size_of(design%n_vary), source=1)
    if (design%is_grid) then
      do i = 1, design%n_vary
        design%size_of(i) = max(1, grid_size(request%vary(i)))
        design%n_point = design%n_point*design%size_of(i)
      end do
    else
      design%n_point = max(1, request%sample%points)
      allocate (design%unit(design%n_vary, design%n_point))
      if (request%sample%kind == 'latin_hypercube') then
        call latin_hypercube(design%seed, design%unit)
      else
        if (design%n_vary > sobol_dimensions) then
          call fail(error, exit_input, 'sample/kind: seen ''sobol'' with '//to_text(design%n_vary)// &
                    ' varied keys; allowed: at most '//to_text(sobol_dimensions))
          return
        end if
        do i = 1, int(design%n_point)
          call sobol_point(i, design%unit(:, i))   ! from point 1: point 0 is a corner of every range
        end do
      end if
    end if
    design%n_case = design%n_point*design%stride
  end subroutine new_design

  !> The seed of one case.
  pure integer(i8) function case_seed(design, case)
    type(design_t), intent(in) :: design
    integer(i8), intent(in) :: case
    case_seed = hash_seed(design%seed, case)
  end function case_seed

  !> The point that a case belongs to.
  pure integer(i8) function case_point(design, case)
    type(design_t), intent(in) :: design
    integer(i8), intent(in) :: case             !! from 1
    case_point = (case - 1)/design%stride + 1
  end function case_point

  !> Is a value of this key drawn anew for each run, rather than belonging to a point?
  pure logical function is_drawn(design, vary)
    type(design_t), intent(in) :: design
    type(vary_group_t), intent(in) :: vary
    is_drawn = design%is_grid .and. .not. allocated(vary%values) .and. len_trim(vary%distribution) > 0
  end function is_drawn

  !> Values of the varied keys of one case, as namelist text and as numbers for the table
  !> (a word: its place in the list; a logical: 0 or 1).
  subroutine case_values(design, request, case, text, number)
    type(design_t), intent(in) :: design
    type(study_request_t), intent(in) :: request
    integer(i8), intent(in) :: case             !! from 1
    type(text_t), allocatable, intent(out) :: text(:)
    real(wp), allocatable, intent(out) :: number(:)
    type(rng_t) :: rng
    integer(i8) :: point, rest
    integer :: i, k

    point = case_point(design, case)
    allocate (text(design%n_vary), number(design%n_vary))
    call seed_rng(rng, hash_seed(design%seed + draw_stream, case))
    rest = point - 1
    do i = design%n_vary, 1, -1      ! the last key runs fastest
      associate (v => request%vary(i))
        k = int(modulo(rest, int(design%size_of(i), i8))) + 1
        rest = rest/design%size_of(i)
        if (.not. design%is_grid) then
          number(i) = quantile(v, design%unit(i, point))
        else if (allocated(v%values)) then
          number(i) = listed(v, k)
          text(i)%chars = trim(v%values(k))
          cycle
        else if (is_drawn(design, v)) then
          number(i) = drawn(v, rng)
        else
          number(i) = grid_value(v, k)
        end if
        text(i)%chars = to_text(number(i))
      end associate
    end do
  end subroutine case_values

  !> A listed value as a number.
  real(wp) function listed(v, k)
    type(vary_group_t), intent(in) :: v
    integer, intent(in) :: k
    integer :: status
    read (v%values(k), *, iostat=status) listed
    if (status == 0) return
    listed = real(k, wp)
    if (scan(v%values(k)(1:2), 'tT') > 0) listed = 1.0_wp
    if (scan(v%values(k)(1:2), 'fF') > 0 .and. index(v%values(k), '''') == 0) listed = 0.0_wp
  end function listed

  !> A point of the unit interval in the key's range or distribution.
  pure real(wp) function quantile(v, u)
    type(vary_group_t), intent(in) :: v
    real(wp), intent(in) :: u
    if (v%distribution == 'normal') then
      quantile = v%mean + v%deviation*normal_quantile(min(max(u, 1.0e-16_wp), 1.0_wp - 1.0e-16_wp))
    else if (v%spacing == 'log') then
      quantile = v%from*(v%to/v%from)**u
    else
      quantile = v%from + u*(v%to - v%from)
    end if
  end function quantile

  real(wp) function drawn(v, rng)
    type(vary_group_t), intent(in) :: v
    type(rng_t), intent(inout) :: rng
    real(wp) :: u
    if (v%distribution == 'normal') then
      call normal(rng, u)
      drawn = v%mean + v%deviation*u
    else
      call uniform(rng, u)
      drawn = v%from + u*(v%to - v%from)
    end if
  end function drawn

end module castnet_study_design
