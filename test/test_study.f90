!> What a study rests on: intervals, designs, searches, the journal.
module test_study
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t
  use castnet_interval, only: wilson_interval
  use castnet_posix, only: process_id, remove_file, append_file, read_file
  use castnet_rng, only: rng_t, seed_rng, uniform
  use castnet_sobol, only: sobol_point, latin_hypercube
  use castnet_study_design, only: design_t, new_design, case_point, case_values, case_seed, is_drawn
  use castnet_study_journal, only: journal_t, open_journal, append_case
  use castnet_study_record, only: case_row_t, case_done
  use castnet_study_request, only: study_request_t
  use castnet_study_search, only: sampler_t, search_result_t, find_threshold, find_optimum
  use castnet_text, only: to_text, text_t
  use testing, only: test_case, expect, expect_close, expect_equal, note
  implicit none
  private
  public :: run_test_study

  !> Yes-or-no runs with a known probability.
  type, extends(sampler_t) :: coin_t
    type(rng_t) :: rng
    integer :: curve = 1
    integer :: tossed = 0
  contains
    procedure :: sample => toss
  end type coin_t

contains

  subroutine run_test_study()
    call test_case('study: Wilson''s interval solves its equation', test_wilson)
    call test_case('study: 95 % intervals hold the truth 95 times in 100', test_coverage)
    call test_case('study: Sobol''s points', test_sobol)
    call test_case('study: a Latin hypercube has one point in each row and column', test_hypercube)
    call test_case('study: a grid runs through every combination, each case with its own seed', test_grid)
    call test_case('study: each combination has a search of its own, drawn keys are drawn', test_search_cases)
    call test_case('study: a threshold on a logistic curve is found and its interval holds it', test_threshold)
    call test_case('study: a curve that is not monotone shows both crossings', test_two_crossings)
    call test_case('study: the optimum of a hump', test_optimum)
    call test_case('study: a journal gives back every case and drops a cut one', test_journal)
  end subroutine run_test_study

  !> Lower and upper end p solve (p_hat - p)**2 = z**2 p (1 - p)/n.
  subroutine test_wilson()
    real(wp), parameter :: z = 1.959963984540054_wp
    real(wp) :: lower, upper, p
    integer :: k
    do k = 0, 10
      call wilson_interval(k, 10, 0.95_wp, lower, upper)
      p = k/10.0_wp
      if (k > 0) call expect_close((p - lower)**2, z*z*lower*(1.0_wp - lower)/10.0_wp, 'lower end', atol=1.0e-14_wp)
      if (k < 10) call expect_close((p - upper)**2, z*z*upper*(1.0_wp - upper)/10.0_wp, 'upper end', atol=1.0e-14_wp)
      call expect(lower <= p .and. p <= upper, 'the estimate lies inside')
    end do
    call wilson_interval(0, 0, 0.95_wp, lower, upper)
    call expect_close(upper - lower, 1.0_wp, 'no run, no knowledge', atol=0.0_wp)
  end subroutine test_wilson

  !> Bernoulli cases of known p: Wilson's interval covers between 92 and 98 % of them at
  !> n = 40 (its exact coverage oscillates about 95 %; Brown, Cai & DasGupta 2001, fig. 5);
  !> three standard deviations of 4000 repeats are 1 %.
  subroutine test_coverage()
    type(rng_t) :: rng
    real(wp) :: lower, upper, p, u
    integer :: k, i, j, inside, successes
    call seed_rng(rng, 20261121_i8)
    do k = 1, 9
      p = 0.1_wp*k
      inside = 0
      do i = 1, 4000
        successes = 0
        do j = 1, 40
          call uniform(rng, u)
          if (u < p) successes = successes + 1
        end do
        call wilson_interval(successes, 40, 0.95_wp, lower, upper)
        if (lower <= p .and. p <= upper) inside = inside + 1
      end do
      call expect(inside > 4000*0.91_wp .and. inside < 4000*0.99_wp, 'coverage at p = '//to_text(p)//': '// &
                  to_text(inside/4000.0_wp))
    end do
  end subroutine test_coverage

  !> The first points as printed in every text on the sequence, and the property behind
  !> them: 2**m points put one in each of the 2**m intervals of every axis.
  subroutine test_sobol()
    real(wp) :: x(21), seen(3, 4)
    logical :: hit(0:63)
    integer :: i, j, k
    do i = 1, 4
      call sobol_point(i, x)
      seen(:, i) = x(:3)
    end do
    call expect_close(seen(1, :), [0.5_wp, 0.75_wp, 0.25_wp, 0.375_wp], 'dimension 1', atol=0.0_wp)
    call expect_close(seen(2, :), [0.5_wp, 0.25_wp, 0.75_wp, 0.375_wp], 'dimension 2', atol=0.0_wp)
    call expect_close(seen(3, :), [0.5_wp, 0.25_wp, 0.75_wp, 0.625_wp], 'dimension 3', atol=0.0_wp)
    do j = 1, 21
      hit = .false.
      do i = 0, 63
        call sobol_point(i, x)
        k = int(x(j)*64)
        call expect(.not. hit(k), 'one point an interval, dimension '//to_text(j))
        hit(k) = .true.
      end do
    end do
  end subroutine test_sobol

  subroutine test_hypercube()
    real(wp) :: x(5, 40)
    integer :: j, i, hits(40)
    call latin_hypercube(7_i8, x)
    do j = 1, 5
      hits = 0
      do i = 1, 40
        call expect(x(j, i) > 0.0_wp .and. x(j, i) < 1.0_wp, 'inside')
        hits(int(x(j, i)*40) + 1) = hits(int(x(j, i)*40) + 1) + 1
      end do
      call expect(all(hits == 1), 'one point an interval')
    end do
    call expect(any(x(1, :) /= x(2, :)), 'axes differ')
  end subroutine test_hypercube

  subroutine test_grid()
    type(study_request_t) :: request
    type(design_t) :: design
    type(error_t), allocatable :: error
    type(text_t), allocatable :: text(:)
    real(wp), allocatable :: number(:)
    integer(i8) :: seeds(24)
    integer :: k, i, a, b
    allocate (request%vary(2))
    request%vary(1)%key = 'a/b'
    request%vary(1)%values = [character(len=24) :: '1.5', '2.5', '9']
    request%vary(2)%key = 'c/d'
    request%vary(2)%from = 1.0_wp
    request%vary(2)%to = 100.0_wp
    request%vary(2)%count = 2
    request%vary(2)%spacing = 'log'
    request%study%seeds = 4
    call new_design(design, request, error)
    call expect(.not. allocated(error), 'no error')
    call expect_equal(int(design%n_case), 24, 'cases')
    do k = 1, 24
      call case_values(design, request, int(k, i8), text, number)
      a = (k - 1)/8 + 1
      b = modulo((k - 1)/4, 2) + 1
      call expect_equal(text(1)%chars, trim(request%vary(1)%values(a)), 'first key')
      call expect_close(number(2), merge(1.0_wp, 100.0_wp, b == 1), 'second key', atol=0.0_wp)
      seeds(k) = case_seed(design, int(k, i8))
    end do
    do k = 1, 24
      do i = 1, k - 1
        call expect(seeds(i) /= seeds(k), 'seeds differ')
      end do
    end do
  end subroutine test_grid

  !> Three values of a list, a drawn key, searches of at most 20 runs: cases 1 to 20 belong to
  !> the first value, 21 to 40 to the second; every case has its own draw.
  subroutine test_search_cases()
    type(study_request_t) :: request
    type(design_t) :: design
    type(error_t), allocatable :: error
    type(text_t), allocatable :: text(:)
    real(wp), allocatable :: number(:)
    real(wp) :: drawn(60)
    integer :: k
    allocate (request%vary(2), request%search)
    request%study%question = 'threshold'
    request%study%seeds = 7                       ! runs at a time: no matter here
    request%search%budget = 20
    request%vary(1)%key = 'a/b'
    request%vary(1)%values = [character(len=24) :: '1.5', '2.5', '9']
    request%vary(2)%key = 'c/d'
    request%vary(2)%distribution = 'uniform'
    request%vary(2)%from = 10.0_wp
    request%vary(2)%to = 20.0_wp
    call new_design(design, request, error)
    call expect(.not. allocated(error), 'no error')
    call expect_equal(int(design%n_point), 3, 'searches')
    call expect_equal(int(design%n_case), 60, 'most cases')
    call expect(is_drawn(design, request%vary(2)) .and. .not. is_drawn(design, request%vary(1)), 'which key is drawn')
    do k = 1, 60
      call expect_equal(int(case_point(design, int(k, i8))), (k - 1)/20 + 1, 'search of a case')
      call case_values(design, request, int(k, i8), text, number)
      call expect_equal(text(1)%chars, trim(request%vary(1)%values((k - 1)/20 + 1)), 'value of its search')
      drawn(k) = number(2)
      call expect(drawn(k) >= 10.0_wp .and. drawn(k) <= 20.0_wp .and. .not. any(drawn(:k - 1) == drawn(k)), 'drawn anew')
    end do
    request%study%question = 'map'                ! then &search has no effect
    deallocate (design%size_of)
    call new_design(design, request, error)
    call expect_equal(int(design%n_case), 21, 'a map of the same file')
  end subroutine test_search_cases

  !> Curve 1: logistic about 0.37, width 0.05. Curve 2: up at 0.3, down at 0.7.
  !> Curve 3: a hump at 0.6.
  pure real(wp) function probability(curve, x)
    integer, intent(in) :: curve
    real(wp), intent(in) :: x
    select case (curve)
    case (1)
      probability = 1.0_wp/(1.0_wp + exp((x - 0.37_wp)/0.05_wp))
    case (2)
      probability = 1.0_wp/(1.0_wp + exp(-(x - 0.3_wp)/0.02_wp)) - 1.0_wp/(1.0_wp + exp(-(x - 0.7_wp)/0.02_wp))
    case default
      probability = 0.95_wp*exp(-((x - 0.6_wp)/0.2_wp)**2)
    end select
  end function probability

  subroutine toss(self, x, runs, answered, successes, stopped)
    class(coin_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)
    integer, intent(in) :: runs(:)
    integer, intent(out) :: answered(:), successes(:)
    logical, intent(out) :: stopped
    real(wp) :: u
    integer :: i, k
    answered = runs
    successes = 0
    stopped = .false.
    do i = 1, size(x)
      do k = 1, runs(i)
        call uniform(self%rng, u)
        if (u < probability(self%curve, x(i))) successes(i) = successes(i) + 1
      end do
    end do
    self%tossed = self%tossed + sum(runs)
  end subroutine toss

  !> Two hundred searches of 600 runs: the nominal 95 % interval must hold the true 0.37 in
  !> at least 90 % (three standard deviations of 200 repeats are 5 %).
  subroutine test_threshold()
    type(coin_t) :: coin
    type(search_result_t) :: result
    integer :: i, inside, found
    real(wp) :: worst
    inside = 0
    found = 0
    worst = 0.0_wp
    do i = 1, 200
      call seed_rng(coin%rng, int(i, i8))
      coin%tossed = 0
      call find_threshold(coin, 0.0_wp, 1.0_wp, 0.5_wp, 0.95_wp, 600, 10, result)
      call expect(coin%tossed <= 600, 'within the budget')
      if (.not. result%found) cycle
      found = found + 1
      worst = max(worst, abs(result%estimate - 0.37_wp))
      if (result%lower <= 0.37_wp .and. 0.37_wp <= result%upper) inside = inside + 1
    end do
    call note('found '//to_text(found)//' of 200, interval holds the truth in '//to_text(inside)//', worst error '//to_text(worst))
    call expect(found >= 198, 'found')
    call expect(inside >= 180, 'interval')
    call expect(worst < 0.06_wp, 'no estimate is far off')
  end subroutine test_threshold

  subroutine test_two_crossings()
    type(coin_t) :: coin
    type(search_result_t) :: result
    coin%curve = 2
    call seed_rng(coin%rng, 5_i8)
    call find_threshold(coin, 0.0_wp, 1.0_wp, 0.5_wp, 0.95_wp, 1500, 10, result)
    call expect_equal(result%crossings, 2, 'crossings')
    call expect_close(result%estimate, 0.3_wp, 'the first', atol=0.02_wp)
  end subroutine test_two_crossings

  subroutine test_optimum()
    type(coin_t) :: coin
    type(search_result_t) :: result
    integer :: i, good
    coin%curve = 3
    good = 0
    do i = 1, 50
      call seed_rng(coin%rng, int(i, i8))
      call find_optimum(coin, 0.0_wp, 1.0_wp, 0.95_wp, 1000, 10, result)
      if (abs(result%estimate - 0.6_wp) < 0.1_wp) good = good + 1
    end do
    call note('optimum within 0.1 in '//to_text(good)//' of 50')
    call expect(good >= 45, 'near the top')
  end subroutine test_optimum

  subroutine test_journal()
    type(journal_t) :: journal
    type(case_row_t), allocatable :: rows(:)
    type(case_row_t) :: row
    type(error_t), allocatable :: error
    character(len=:), allocatable :: path, bytes
    integer :: k, ignored
    path = '/tmp/castnet_'//to_text(process_id())//'_journal.cases'
    ignored = remove_file(path)
    call open_journal(journal, path, 42_i8, 2, rows, error)
    do k = 1, 5
      row%case = k
      row%point = 2*k
      row%seed = 3_i8**k
      row%status = case_done
      row%varied = [0.5_wp*k, -1.0_wp/k]
      row%measure = k/7.0_wp
      row%reason = 'none'
      call append_case(journal, row, error)
    end do
    call expect(.not. allocated(error), 'written')
    ignored = read_file(path, bytes)
    ignored = append_file(path, len(bytes, i8) - 9, '')     ! as a kill would leave it
    call open_journal(journal, path, 42_i8, 2, rows, error)
    call expect_equal(size(rows), 4, 'whole records')
    call expect_close(rows(4)%varied, [2.0_wp, -0.25_wp], 'values', atol=0.0_wp)
    call append_case(journal, row, error)
    call open_journal(journal, path, 42_i8, 2, rows, error)
    call expect_equal(size(rows), 5, 'goes on behind the last whole record')
    call expect(rows(5)%seed == 3_i8**5, 'the fifth')
    call open_journal(journal, path, 43_i8, 2, rows, error)
    call expect(allocated(error), 'another study''s journal is refused')
    ignored = remove_file(path)
  end subroutine test_journal

end module test_study
