!> Questions that choose their own points: where does P(capture) cross a value, and where
!> is it largest, along one key, from noisy yes-or-no runs within a budget.
module castnet_study_search
  use castnet_kinds, only: wp
  use castnet_interval, only: wilson_interval
  use castnet_rng, only: normal_quantile
  use castnet_study_request, only: first_points
  implicit none
  private
  public :: sampler_t, search_result_t, find_threshold, find_optimum

  !> Whoever can run cases at a value of the key.
  type, abstract :: sampler_t
  contains
    procedure(sample_i), deferred :: sample
  end type sampler_t

  abstract interface
    !> Run `runs(i)` more cases at x(i); how many gave an answer, and how many of them yes.
    subroutine sample_i(self, x, runs, answered, successes, stopped)
      import :: sampler_t, wp
      class(sampler_t), intent(inout) :: self
      real(wp), intent(in) :: x(:)
      integer, intent(in) :: runs(:)
      integer, intent(out) :: answered(:), successes(:)
      logical, intent(out) :: stopped
    end subroutine sample_i
  end interface

  type :: search_result_t
    real(wp), allocatable :: x(:)                   !! points, ascending
    integer, allocatable :: runs(:), successes(:)
    integer :: crossings = 0                        !! intervals between points over which the estimate crosses
    real(wp), allocatable :: bracket(:, :)          !! (2,crossings)
    real(wp) :: estimate = 0.0_wp                   !! of the first crossing, or the best value
    real(wp) :: lower = 0.0_wp, upper = 0.0_wp      !! its interval
    logical :: found = .false.
    logical :: stopped = .false.                    !! the sampler gave up: not to be believed
  end type search_result_t

  integer, parameter :: finest = 64                 !! brackets are not halved below this part of the range
  integer, parameter :: optimum_points = 16
  real(wp), parameter :: ridge = 1.0e3_wp           !! largest slope that a fit is free to take, per range

contains

  !> Where P crosses `probability`. The whole range is sampled first and again wherever the
  !> estimate crosses, so a curve that is not monotone shows all its crossings. The first
  !> one's place comes from a logistic fit to the points about it, its interval by the
  !> delta method.
  subroutine find_threshold(sampler, from, to, probability, confidence, budget, batch, result)
    class(sampler_t), intent(inout) :: sampler
    real(wp), intent(in) :: from, to, probability, confidence
    integer, intent(in) :: budget              !! most runs
    integer, intent(in) :: batch               !! runs added to a point at a time
    type(search_result_t), intent(out) :: result
    integer :: i, k, spent, runs, worst
    real(wp) :: middle

    allocate (result%x(0), result%runs(0), result%successes(0))
    runs = max(2, min(batch, budget/first_points))
    do i = 0, first_points - 1
      call add_point(result, from + (to - from)*i/(first_points - 1))
    end do
    call more_runs(sampler, result, [(k, k=1, first_points)], runs)
    spent = runs*first_points
    do while (spent < budget .and. .not. result%stopped)
      call find_brackets(result, probability)
      if (result%crossings == 0) then
        ! Nothing crosses: the points whose interval still holds the value get more runs.
        call most_uncertain(result, probability, confidence, 1, size(result%x), worst)
        if (worst == 0) exit
      else
        k = widest_bracket(result)
        i = findloc(result%x, result%bracket(1, k), dim=1)
        if (2*spent >= budget) then
          ! The second half goes evenly to the neighbourhood, whatever comes out: points that
          ! get runs until they please would bias the fit.
          worst = max(1, i - 1) - 1 + minloc(result%runs(max(1, i - 1):min(size(result%x), i + 2)), dim=1)
          runs = min(batch, budget - spent)
          call more_runs(sampler, result, [worst], runs)
          spent = spent + runs
          cycle
        end if
        call most_uncertain(result, probability, confidence, i, i + 1, worst)
        if (result%bracket(2, k) - result%bracket(1, k) > 1.5_wp*(to - from)/finest .and. &
            (worst == 0 .or. minval(result%runs(i:i + 1)) >= 4*batch)) then
          middle = 0.5_wp*(result%bracket(1, k) + result%bracket(2, k))
          call add_point(result, middle)
          worst = findloc(result%x, middle, dim=1)
        else if (worst == 0) then
          worst = merge(i, i + 1, result%runs(i) < result%runs(i + 1))
        end if
      end if
      runs = min(batch, budget - spent)
      call more_runs(sampler, result, [worst], runs)
      spent = spent + runs
    end do
    call find_brackets(result, probability)
    if (result%crossings > 0) call fit_crossing(result, from, to, probability, confidence)
  end subroutine find_threshold

  !> The value with the largest P: all points a batch, then the better half twice as many
  !> runs, and so on (successive halving).
  subroutine find_optimum(sampler, from, to, confidence, budget, batch, result)
    class(sampler_t), intent(inout) :: sampler
    real(wp), intent(in) :: from, to, confidence
    integer, intent(in) :: budget, batch
    type(search_result_t), intent(out) :: result
    integer, allocatable :: kept(:), order(:)
    integer :: i, k, runs, spent, n

    allocate (result%x(0), result%runs(0), result%successes(0))
    n = max(2, min(optimum_points, budget/max(1, batch)))
    do i = 0, n - 1
      call add_point(result, from + (to - from)*i/(n - 1))
    end do
    kept = [(i, i=1, n)]
    runs = max(1, min(batch, budget/n))
    spent = 0
    do
      if (spent + runs*size(kept) > budget) runs = (budget - spent)/size(kept)
      if (runs < 1) exit
      call more_runs(sampler, result, kept, runs)
      spent = spent + runs*size(kept)
      if (result%stopped) exit
      order = ranked(result, kept)
      kept = order(:max(1, (size(order) + 1)/2))
      if (size(kept) == 1) then
        runs = budget - spent
      else
        runs = 2*runs
      end if
      if (spent >= budget) exit
    end do
    order = ranked(result, kept)
    k = order(1)
    result%found = result%runs(k) > 0
    result%estimate = result%x(k)
    call wilson_interval(result%successes(k), result%runs(k), confidence, result%lower, result%upper)
  end subroutine find_optimum

  !> Points in falling order of their estimate; ties by their place.
  function ranked(result, points) result(order)
    type(search_result_t), intent(in) :: result
    integer, intent(in) :: points(:)
    integer :: order(size(points)), i, j, swap
    order = points
    do i = 2, size(order)
      j = i
      do while (j > 1)
        if (estimate_at(result, order(j)) <= estimate_at(result, order(j - 1))) exit
        swap = order(j)
        order(j) = order(j - 1)
        order(j - 1) = swap
        j = j - 1
      end do
    end do
  end function ranked

  pure real(wp) function estimate_at(result, i)
    type(search_result_t), intent(in) :: result
    integer, intent(in) :: i
    estimate_at = real(result%successes(i), wp)/real(max(1, result%runs(i)), wp)
  end function estimate_at

  !> Insert a point, keeping the order.
  subroutine add_point(result, x)
    type(search_result_t), intent(inout) :: result
    real(wp), intent(in) :: x
    integer :: k
    k = count(result%x < x)
    result%x = [result%x(:k), x, result%x(k + 1:)]
    result%runs = [result%runs(:k), 0, result%runs(k + 1:)]
    result%successes = [result%successes(:k), 0, result%successes(k + 1:)]
  end subroutine add_point

  subroutine more_runs(sampler, result, points, runs)
    class(sampler_t), intent(inout) :: sampler
    type(search_result_t), intent(inout) :: result
    integer, intent(in) :: points(:)
    integer, intent(in) :: runs
    integer :: answered(size(points)), successes(size(points)), wanted(size(points))
    wanted = runs
    call sampler%sample(result%x(points), wanted, answered, successes, result%stopped)
    result%runs(points) = result%runs(points) + answered
    result%successes(points) = result%successes(points) + successes
  end subroutine more_runs

  !> Neighbours between which the estimate crosses the value.
  subroutine find_brackets(result, probability)
    type(search_result_t), intent(inout) :: result
    real(wp), intent(in) :: probability
    real(wp) :: found(2, size(result%x))
    integer :: i, n
    n = 0
    do i = 1, size(result%x) - 1
      if (result%runs(i) == 0 .or. result%runs(i + 1) == 0) cycle
      if ((estimate_at(result, i) >= probability) .eqv. (estimate_at(result, i + 1) >= probability)) cycle
      n = n + 1
      found(:, n) = result%x(i:i + 1)
    end do
    result%crossings = n
    result%bracket = found(:, :n)
  end subroutine find_brackets

  pure integer function widest_bracket(result) result(k)
    type(search_result_t), intent(in) :: result
    k = maxloc(result%bracket(2, :) - result%bracket(1, :), dim=1)
  end function widest_bracket

  !> Of points first..last the one with fewest runs whose interval holds the value; 0: none.
  subroutine most_uncertain(result, probability, confidence, first, last, worst)
    type(search_result_t), intent(in) :: result
    real(wp), intent(in) :: probability, confidence
    integer, intent(in) :: first, last
    integer, intent(out) :: worst
    real(wp) :: lower, upper
    integer :: i
    worst = 0
    do i = first, last
      call wilson_interval(result%successes(i), result%runs(i), confidence, lower, upper)
      if (lower > probability .or. upper < probability) cycle
      if (worst == 0) then
        worst = i
      else if (result%runs(i) < result%runs(worst)) then
        worst = i
      end if
    end do
  end subroutine most_uncertain

  !> Logistic regression through the points about the first crossing: the window runs to
  !> half-way towards the next crossing, or to the end of the range.
  subroutine fit_crossing(result, from, to, probability, confidence)
    type(search_result_t), intent(inout) :: result
    real(wp), intent(in) :: from, to, probability, confidence
    real(wp) :: a, b, high, u, p, w, r, g(2), h(3), det, step(2), x, target, variance, z, scale
    integer :: i, pass

    high = to
    if (result%crossings > 1) high = 0.5_wp*(result%bracket(2, 1) + result%bracket(1, 2))
    scale = to - from
    a = 0.0_wp
    b = 0.0_wp
    h = 0.0_wp
    do pass = 1, 60
      g = 0.0_wp
      h = [1.0e-9_wp, 0.0_wp, 1.0e-9_wp]
      do i = 1, size(result%x)
        if (result%x(i) > high .or. result%runs(i) == 0) cycle
        u = (result%x(i) - result%bracket(1, 1))/scale
        p = 1.0_wp/(1.0_wp + exp(-max(-40.0_wp, min(40.0_wp, a + b*u))))
        r = result%successes(i) - result%runs(i)*p
        w = max(result%runs(i)*p*(1.0_wp - p), 1.0e-12_wp)
        g = g + [r, r*u]
        h = h + [w, w*u, w*u*u]
      end do
      ! A weak pull to a finite slope keeps perfectly separated data solvable.
      g(2) = g(2) - b/ridge**2
      h(3) = h(3) + 1.0_wp/ridge**2
      det = h(1)*h(3) - h(2)**2
      step = [h(3)*g(1) - h(2)*g(2), h(1)*g(2) - h(2)*g(1)]/det
      step = step*min(1.0_wp, 10.0_wp/max(1.0e-30_wp, maxval(abs(step))))
      a = a + step(1)
      b = b + step(2)
      if (maxval(abs(step)) < 1.0e-10_wp) exit
    end do
    result%found = b /= 0.0_wp
    if (.not. result%found) return
    target = log(probability/(1.0_wp - probability))
    x = (target - a)/b
    det = h(1)*h(3) - h(2)**2
    variance = (h(3) + x*x*h(1) - 2.0_wp*x*h(2))/det/b**2
    z = normal_quantile(0.5_wp*(1.0_wp + confidence))
    result%estimate = result%bracket(1, 1) + scale*x
    result%lower = max(from, result%estimate - z*scale*sqrt(max(variance, 0.0_wp)))
    result%upper = min(to, result%estimate + z*scale*sqrt(max(variance, 0.0_wp)))
  end subroutine fit_crossing

end module castnet_study_search
