!> A study: many captures side by side, one per thread at a time, and what they say.
!>
!> A case is a number; everything about it follows from that number (castnet_study_design),
!> so neither order, threads, shards nor a restart can change it. Finished cases go to a
!> journal at once; the table is made from the journal at the end.
module castnet_study
  use castnet_kinds, only: wp, i8
  use castnet_diagnostics, only: largest_tension
  use castnet_error, only: error_t, fail, exit_stopped, exit_done, exit_numerical, exit_input
  use castnet_interval, only: wilson_interval
  use castnet_lock, only: lock_t, take_lock, release_lock
  use castnet_log, only: log_t, log_note, log_warning, log_progress, end_progress
  use castnet_model_builder, only: file_net_t
  use castnet_posix, only: wall_seconds, path_kind, path_nothing, path_file, remove_file
  use castnet_problems, only: problem_list_t
  use castnet_scene, only: scene_t
  use castnet_scene_check, only: finish_scene
  use castnet_scene_files, only: text_contents, data_contents
  use castnet_scene_net, only: load_scene_net
  use castnet_scene_schema, only: set_key
  use castnet_signals, only: install_signal_handlers, stop_request_code
  use castnet_simulation, only: simulation_t, due_t, start, run_to_next, is_finished, take_measures, frame_taken, summarise
  use castnet_record, only: summary_t
  use castnet_study_design, only: design_t, new_design, case_values, case_seed
  use castnet_study_journal, only: journal_t, open_journal, append_case, sync_journal, read_journal, study_identity
  use castnet_study_record, only: case_row_t, point_row_t, n_measure, case_done, case_invalid, case_failed, case_missing
  use castnet_study_request, only: study_request_t
  use castnet_study_search, only: sampler_t, search_result_t, find_threshold, find_optimum
  use castnet_study_table, only: write_study_table
  use castnet_text, only: to_text, text_t, word_at
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none
  private
  public :: study_options_t, run_study, collect_study, journal_path

  real(wp), parameter :: sync_interval = 2.0_wp   !! between two times the journal is forced to the disk [s]
  integer, parameter :: steps_per_look = 256      !! between two looks at the signals

  type :: study_options_t
    character(len=:), allocatable :: output
    integer :: threads = 1
    integer :: shard = 1, shards = 1
    real(wp) :: max_wall = huge(1.0_wp)           !! [s]
    logical :: force = .false.
    character(len=:), allocatable :: version
  end type study_options_t

  !> What one batch of cases needs.
  type, extends(sampler_t) :: batch_t
    type(study_request_t) :: request
    type(scene_t) :: base                         !! unresolved, so that defaults follow varied keys
    type(design_t) :: design
    type(study_options_t) :: options
    type(journal_t) :: journal
    type(log_t) :: log
    type(case_row_t), allocatable :: rows(:)      !! by case number
    real(wp) :: began = 0.0_wp
    integer(i8) :: done = 0, wanted = 0
    integer(i8) :: next_case = 1                  !! of a search
    integer :: stop_code = exit_done
    type(error_t), allocatable :: error
  contains
    procedure :: sample => sample_cases
  end type batch_t

contains

  !> Run what is missing of a study, then make its table. Errors: exit_input, exit_file;
  !> exit_stopped when a signal or --max-wall ended it. A case that fails is a row.
  subroutine run_study(request, base, options, log, error)
    type(study_request_t), intent(in) :: request
    type(scene_t), intent(in) :: base
    type(study_options_t), intent(in) :: options
    type(log_t), intent(inout) :: log
    type(error_t), allocatable, intent(inout) :: error
    type(batch_t) :: batch
    type(case_row_t), allocatable :: kept(:)
    type(lock_t) :: lock
    type(search_result_t) :: found
    character(len=:), allocatable :: path
    integer :: ignored
    integer(i8) :: k

    batch%request = request
    batch%base = base
    batch%options = options
    batch%log = log
    batch%began = wall_seconds()
    if (request%study%record == 'runs') then
      call fail(error, exit_input, 'study/record: seen ''runs'', which is not available yet; allowed: ''table''')
      return
    end if
    call new_design(batch%design, request, error)
    if (allocated(error)) return
    if (options%shards > 1 .and. allocated(request%search)) then
      call fail(error, exit_input, '--shard: a search chooses its next cases from the last, so it cannot be divided')
      return
    end if
    path = journal_path(options%output, options%shard, options%shards)
    call take_lock(lock, path, error)
    if (allocated(error)) return
    if (options%force) then
      ignored = remove_file(path)
      ignored = remove_file(options%output)
    end if
    call open_journal(batch%journal, path, identity_of(request, base), columns(request), kept, error)
    if (.not. allocated(error)) then
      call install_signal_handlers()
      call place_rows(batch, kept)
      if (allocated(request%search)) then
        call run_search(batch, found)
      else
        call run_map(batch)
      end if
      call sync_journal(batch%journal)
      call end_progress(batch%log)
      if (allocated(batch%error)) call move_alloc(batch%error, error)
      if (.not. allocated(error) .and. batch%stop_code /= exit_done) then
        k = count(batch%rows%status /= case_missing)
        call fail(error, batch%stop_code, 'stopped after '//to_text(k)// &
                  ' cases; the same command goes on with what is missing')
      end if
      if (.not. allocated(error) .and. options%shards == 1) call make_table(batch, found, error)
    end if
    call release_lock(lock)
  end subroutine run_study

  !> Put the journals of all shards (and of an unsharded run) into one table.
  subroutine collect_study(request, base, options, log, missing, error)
    type(study_request_t), intent(in) :: request
    type(scene_t), intent(in) :: base
    type(study_options_t), intent(in) :: options
    type(log_t), intent(inout) :: log
    integer(i8), intent(out) :: missing            !! cases that no journal holds
    type(error_t), allocatable, intent(inout) :: error
    type(batch_t) :: batch
    type(case_row_t), allocatable :: rows(:)
    type(search_result_t) :: nothing
    type(text_t), allocatable :: paths(:)
    integer(i8) :: length
    integer :: i, n

    missing = 0
    batch%request = request
    batch%base = base
    batch%options = options
    batch%log = log
    call new_design(batch%design, request, error)
    if (allocated(error)) return
    call find_journals(options%output, options%shards, paths)
    n = size(paths)
    if (n == 0) then
      call fail(error, exit_input, 'collect: no journal of this study beside '//options%output// &
                '; run castnet study first, with the same --output and for shards --shard K/N')
      return
    end if
    allocate (batch%rows(0))
    do i = 1, n
      call read_journal(paths(i)%chars, identity_of(request, base), columns(request), rows, length, error)
      if (allocated(error)) return
      call place_rows(batch, rows)
      call log_note(log, to_text(size(rows))//' cases in '//paths(i)%chars)
    end do
    if (.not. allocated(request%search)) missing = batch%design%n_case - count(batch%rows%status /= case_missing)
    call make_table(batch, nothing, error)
  end subroutine collect_study

  !> OUTPUT.cases, OUTPUT.shard-K-of-N.cases.
  function journal_path(output, shard, shards) result(path)
    character(len=*), intent(in) :: output
    integer, intent(in) :: shard, shards
    character(len=:), allocatable :: path
    path = output//'.cases'
    if (shards > 1) path = output//'.shard-'//to_text(shard)//'-of-'//to_text(shards)//'.cases'
  end function journal_path

  !> Journals beside OUTPUT: the unsharded one, and those of any division up to 4096.
  subroutine find_journals(output, shards, paths)
    character(len=*), intent(in) :: output
    integer, intent(in) :: shards
    type(text_t), allocatable, intent(out) :: paths(:)
    integer, parameter :: most_shards = 4096
    type(text_t), allocatable :: found(:)
    integer :: k, n, total, last

    allocate (found(most_shards + 1))
    n = 0
    if (path_kind(journal_path(output, 1, 1)) == path_file) call add(journal_path(output, 1, 1))
    last = most_shards
    if (shards > 1) last = shards
    do total = max(2, shards), last
      if (path_kind(journal_path(output, 1, total)) /= path_file .and. &
          path_kind(journal_path(output, total, total)) /= path_file) cycle
      do k = 1, total
        if (path_kind(journal_path(output, k, total)) == path_file .and. n < most_shards) &
          call add(journal_path(output, k, total))
      end do
    end do
    allocate (paths(n))
    do k = 1, n
      paths(k)%chars = found(k)%chars
    end do

  contains

    subroutine add(path)
      character(len=*), intent(in) :: path
      n = n + 1
      found(n)%chars = path
    end subroutine add

  end subroutine find_journals

  !> Of the study's text, its scene's, and what is in every file that these name: with
  !> another net, mesh or included file a case of the same number is another capture.
  integer(i8) function identity_of(request, base)
    type(study_request_t), intent(in) :: request
    type(scene_t), intent(in) :: base
    integer :: i
    character(len=:), allocatable :: text
    text = request%text//base%text//text_contents(base)//data_contents(base)
    do i = 1, size(request%scene_overrides)
      text = text//request%scene_overrides(i)%chars
    end do
    identity_of = study_identity(text)
  end function identity_of

  !> Varied keys, the searched one last.
  pure integer function columns(request)
    type(study_request_t), intent(in) :: request
    columns = size(request%vary) + merge(1, 0, allocated(request%search))
  end function columns

  !> Rows read from a journal to their places.
  subroutine place_rows(batch, rows)
    type(batch_t), intent(inout) :: batch
    type(case_row_t), intent(in) :: rows(:)
    integer :: i
    if (.not. allocated(batch%rows)) allocate (batch%rows(0))
    if (allocated(batch%request%search)) then
      if (size(rows) > 0) call reserve_rows(batch, maxval(rows%case))
    else
      call reserve_rows(batch, batch%design%n_case)
    end if
    do i = 1, size(rows)
      if (rows(i)%case >= 1 .and. rows(i)%case <= size(batch%rows)) batch%rows(rows(i)%case) = rows(i)
    end do
  end subroutine place_rows

  subroutine reserve_rows(batch, n)
    type(batch_t), intent(inout) :: batch
    integer(i8), intent(in) :: n
    type(case_row_t), allocatable :: larger(:)
    if (n <= size(batch%rows)) return
    allocate (larger(n))
    larger(:size(batch%rows)) = batch%rows
    call move_alloc(larger, batch%rows)
  end subroutine reserve_rows

  !> Every case of the map that is this shard's and missing.
  subroutine run_map(batch)
    type(batch_t), intent(inout) :: batch
    integer(i8), allocatable :: cases(:)
    real(wp), allocatable :: no_value(:)
    integer(i8) :: k, n

    allocate (cases(batch%design%n_case))
    n = 0
    do k = batch%options%shard, batch%design%n_case, batch%options%shards
      if (batch%rows(k)%status /= case_missing) cycle
      n = n + 1
      cases(n) = k
    end do
    batch%wanted = n
    allocate (no_value(n), source=0.0_wp)
    call run_cases(batch, cases(:n), no_value)
  end subroutine run_map

  !> The search over its key, on the scene with the first values of the varied keys.
  subroutine run_search(batch, found)
    type(batch_t), intent(inout) :: batch
    type(search_result_t), intent(out) :: found
    associate (s => batch%request%search)
      batch%wanted = s%budget
      if (batch%request%study%question == 'threshold') then
        call find_threshold(batch, s%from, s%to, s%probability, s%confidence, s%budget, &
                            max(1, batch%request%study%seeds), found)
      else
        call find_optimum(batch, s%from, s%to, s%confidence, s%budget, max(1, batch%request%study%seeds), found)
      end if
    end associate
  end subroutine run_search

  !> More runs at values of the searched key; a case that the journal holds is not run again.
  subroutine sample_cases(self, x, runs, answered, successes, stopped)
    class(batch_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)
    integer, intent(in) :: runs(:)
    integer, intent(out) :: answered(:), successes(:)
    logical, intent(out) :: stopped
    integer(i8), allocatable :: cases(:), missing(:)
    real(wp), allocatable :: values(:), missing_values(:)
    integer :: i, k, n

    allocate (cases(sum(runs)), values(sum(runs)))
    n = 0
    do i = 1, size(x)
      do k = 1, runs(i)
        n = n + 1
        cases(n) = self%next_case
        values(n) = x(i)
        self%next_case = self%next_case + 1
      end do
    end do
    call reserve_rows(self, self%next_case - 1)
    missing = pack(cases, self%rows(cases)%status == case_missing)
    missing_values = pack(values, self%rows(cases)%status == case_missing)
    call run_cases(self, missing, missing_values)
    answered = 0
    successes = 0
    n = 0
    do i = 1, size(x)
      do k = 1, runs(i)
        n = n + 1
        associate (row => self%rows(cases(n)))
          if (row%status /= case_done) cycle
          answered(i) = answered(i) + 1
          if (row%measure(1) > 0.5_wp) successes(i) = successes(i) + 1
        end associate
      end do
    end do
    stopped = self%stop_code /= exit_done .or. allocated(self%error)
  end subroutine sample_cases

  !> Run cases over the threads, each on one; finished ones go to the journal at once.
  subroutine run_cases(batch, cases, values)
    type(batch_t), intent(inout) :: batch
    integer(i8), intent(in) :: cases(:)
    real(wp), intent(in) :: values(:)          !! of the searched key
    type(case_row_t) :: row
    real(wp) :: synced
    integer :: i
    logical :: finished, stop_now

    synced = wall_seconds()
    !$omp parallel do default(shared) private(i, row, finished, stop_now) schedule(dynamic, 1) &
    !$omp   num_threads(max(1, batch%options%threads))
    do i = 1, size(cases)
      !$omp critical (castnet_study_journal)
      stop_now = allocated(batch%error) .or. batch%stop_code /= exit_done
      !$omp end critical (castnet_study_journal)
      if (stop_now) cycle
      call run_case(batch, cases(i), values(i), row, finished)
      !$omp critical (castnet_study_journal)
      if (finished .and. .not. allocated(batch%error)) then
        batch%rows(row%case) = row
        call append_case(batch%journal, row, batch%error)
        if (wall_seconds() - synced > sync_interval) then
          call sync_journal(batch%journal)
          synced = wall_seconds()
        end if
        batch%done = batch%done + 1
        call log_progress(batch%log, real(batch%done, wp)/real(max(1_i8, batch%wanted), wp), progress_text(batch))
      end if
      if (batch%stop_code == exit_done) batch%stop_code = stop_request_code()
      if (batch%stop_code == exit_done .and. wall_seconds() - batch%began > batch%options%max_wall) &
        batch%stop_code = exit_stopped
      !$omp end critical (castnet_study_journal)
    end do
    !$omp end parallel do
  end subroutine run_cases

  function progress_text(batch) result(text)
    type(batch_t), intent(in) :: batch
    character(len=:), allocatable :: text
    character(len=16) :: rate
    write (rate, '(f0.1)') real(batch%done, wp)/max(1.0e-3_wp, wall_seconds() - batch%began)
    text = to_text(batch%done)//' of '//to_text(batch%wanted)//' cases, '//trim(rate)//' a second'
  end function progress_text

  !> One capture from a case's number to its row. `finished` is false when a signal came.
  subroutine run_case(batch, case, value, row, finished)
    type(batch_t), intent(in) :: batch
    integer(i8), intent(in) :: case
    real(wp), intent(in) :: value              !! of the searched key
    type(case_row_t), intent(out) :: row
    logical, intent(out) :: finished
    type(scene_t) :: scene
    type(simulation_t) :: sim
    type(file_net_t), allocatable :: file_net
    type(error_t), allocatable :: error
    type(problem_list_t) :: warnings
    type(text_t), allocatable :: text(:)
    type(due_t) :: due
    real(wp), allocatable :: number(:)
    real(wp) :: spin_before
    integer :: i

    row%case = case
    row%point = merge((case - 1)/batch%design%seeds + 1, 1_i8, .not. allocated(batch%request%search))
    row%seed = case_seed(batch%design, case)
    finished = .true.
    scene = batch%base
    call case_values(batch%design, batch%request, merge(case, 1_i8, .not. allocated(batch%request%search)), text, number)
    row%varied = number
    do i = 1, batch%design%n_vary
      call set_key(scene, trim(batch%request%vary(i)%key), text(i)%chars, error)
    end do
    if (allocated(batch%request%search)) then
      row%varied = [number, value]
      call set_key(scene, trim(batch%request%search%key), to_text(value), error)
    end if
    if (allocated(scene%perturb)) scene%perturb%seed = row%seed
    if (.not. allocated(error)) call finish_scene(scene, warnings, error)
    if (.not. allocated(error)) then
      !$omp critical (castnet_hdf5)
      call load_scene_net(scene, file_net, error)
      !$omp end critical (castnet_hdf5)
    end if
    if (.not. allocated(error)) call start(sim, scene, 1, file_net, error)
    if (allocated(error)) then
      call refuse(row, case_invalid, error)
      return
    end if
    spin_before = 0.0_wp
    if (allocated(sim%state%target)) spin_before = length(sim%state%target%angular_velocity)
    sim%history_interval = max(sim%model%end_time, sim%model%step)   ! no rows: the tally runs on
    do
      call run_to_next(sim, due, error, steps_per_look)
      if (allocated(error)) then
        call refuse(row, merge(case_failed, case_invalid, error%code == exit_numerical), error)
        return
      end if
      if (due%verdict) call take_measures(sim)
      if (due%frame .or. due%row) then
        if (allocated(sim%model%net)) sim%state%tally%max_tension = max(sim%state%tally%max_tension, &
          largest_tension(sim%model%net, sim%state%node_position, sim%state%node_velocity))
        call frame_taken(sim)
        sim%state%schedule%row_step = sim%state%step
      end if
      if (is_finished(sim)) exit
      if (stop_request_code() /= exit_done) then
        finished = .false.
        return
      end if
    end do
    row%status = case_done
    call measure_case(sim, spin_before, row)
  end subroutine run_case

  !> First line of the reason, and nothing measured.
  subroutine refuse(row, status, error)
    type(case_row_t), intent(inout) :: row
    integer, intent(in) :: status
    type(error_t), intent(in) :: error
    integer :: n
    row%status = status
    row%measure = ieee_value(1.0_wp, ieee_quiet_nan)
    n = index(error%message, new_line('a'))
    if (n == 0) n = len(error%message) + 1
    row%reason = error%message(:n - 1)
  end subroutine refuse

  !> The measures in the order of castnet_study_record.
  subroutine measure_case(sim, spin_before, row)
    type(simulation_t), intent(in) :: sim
    real(wp), intent(in) :: spin_before
    type(case_row_t), intent(inout) :: row
    type(summary_t) :: summary
    real(wp) :: nan, spin, speed
    integer :: n

    nan = ieee_value(nan, ieee_quiet_nan)
    summary = summarise(sim, 0.0_wp)
    row%measure = nan
    n = size(summary%measures)
    row%measure(1) = merge(1.0_wp, 0.0_wp, summary%captured)
    if (n > 0) then
      associate (m => summary%measures(n))
        row%measure(2:10) = [real(m%verdict, wp), m%coverage, m%largest_hole, m%escape, m%cqi, m%mouth_area, &
                             m%mouth_perimeter, m%bullet_distance_min, m%bullet_distance_max]
      end associate
    end if
    row%measure(11) = summary%first_contact
    if (allocated(sim%state%target)) then
      spin = length(sim%state%target%angular_velocity)
      speed = length(sim%state%target%velocity)
      row%measure(12:14) = [spin, speed, spin - spin_before]
    end if
    row%measure(15) = sim%state%tally%max_impulse
    row%measure(16) = sim%state%tally%max_tension
    row%measure(17) = sim%state%tally%deepest_penetration
    row%measure(18) = real(sim%state%step, wp)
  end subroutine measure_case

  pure real(wp) function length(a)
    real(wp), intent(in) :: a(3)
    length = sqrt(a(1)**2 + a(2)**2 + a(3)**2)
  end function length

  !> Rows and points to the table.
  subroutine make_table(batch, found, error)
    type(batch_t), intent(in) :: batch
    type(search_result_t), intent(in) :: found
    type(error_t), allocatable, intent(inout) :: error
    type(point_row_t), allocatable :: points(:)
    type(text_t), allocatable :: keys(:), notes(:)
    integer :: i

    allocate (keys(columns(batch%request)))
    do i = 1, size(batch%request%vary)
      keys(i)%chars = trim(batch%request%vary(i)%key)
    end do
    if (allocated(batch%request%search)) keys(size(keys))%chars = trim(batch%request%search%key)
    if (allocated(batch%request%search)) then
      call search_points(batch, found, points)
    else
      call map_points(batch, points)
    end if
    allocate (notes(8))
    notes(1)%chars = 'study'
    notes(2)%chars = batch%request%text
    notes(3)%chars = 'scene'
    notes(4)%chars = batch%base%text
    notes(5)%chars = 'version'
    notes(6)%chars = batch%options%version
    notes(7)%chars = 'answer'
    notes(8)%chars = answer_text(batch, found)
    call write_study_table(batch%options%output, keys, pack(batch%rows, batch%rows%status /= case_missing), points, &
                           notes, error)
    if (.not. allocated(error) .and. allocated(batch%request%search)) print '(a)', notes(8)%chars
  end subroutine make_table

  !> What a search found, in words.
  function answer_text(batch, found) result(text)
    type(batch_t), intent(in) :: batch
    type(search_result_t), intent(in) :: found
    character(len=:), allocatable :: text
    text = ''
    if (.not. allocated(batch%request%search)) return
    associate (s => batch%request%search)
      if (.not. allocated(found%x)) then
        text = 'run castnet study for the answer of a search'
      else if (batch%request%study%question == 'threshold') then
        if (.not. found%found) then
          text = 'P(captured) does not cross '//to_text(s%probability)//' between '//to_text(s%from)//' and '//to_text(s%to)
        else
          text = 'P(captured) crosses '//to_text(s%probability)//' at '//trim(s%key)//' = '//to_text(found%estimate)// &
                 ', '//to_text(s%confidence)//' interval '//to_text(found%lower)//' to '//to_text(found%upper)// &
                 ', by '//to_text(sum(found%runs))//' runs'
          if (found%crossings > 1) text = text//'; it crosses '//to_text(found%crossings)// &
                                          ' times, this is the first: the curve is not monotone'
        end if
      else
        text = 'P(captured) is largest at '//trim(s%key)//' = '//to_text(found%estimate)//', there between '// &
               to_text(found%lower)//' and '//to_text(found%upper)//' ('//to_text(s%confidence)//' interval)'
      end if
    end associate
  end function answer_text

  subroutine map_points(batch, points)
    type(batch_t), intent(in) :: batch
    type(point_row_t), allocatable, intent(out) :: points(:)
    type(text_t), allocatable :: text(:)
    integer(i8) :: p, k
    allocate (points(batch%design%n_point))
    do p = 1, batch%design%n_point
      call case_values(batch%design, batch%request, (p - 1)*batch%design%seeds + 1, text, points(p)%varied)
      do k = (p - 1)*batch%design%seeds + 1, p*batch%design%seeds
        if (batch%rows(k)%status /= case_done) cycle
        points(p)%runs = points(p)%runs + 1
        if (batch%rows(k)%measure(1) > 0.5_wp) points(p)%captured = points(p)%captured + 1
      end do
      call finish_point(points(p), 0.95_wp)
    end do
  end subroutine map_points

  subroutine search_points(batch, found, points)
    type(batch_t), intent(in) :: batch
    type(search_result_t), intent(in) :: found
    type(point_row_t), allocatable, intent(out) :: points(:)
    type(text_t), allocatable :: text(:)
    real(wp), allocatable :: number(:)
    integer :: i, n
    n = 0
    if (allocated(found%x)) n = size(found%x)
    allocate (points(n))
    call case_values(batch%design, batch%request, 1_i8, text, number)
    do i = 1, n
      points(i)%varied = [number, found%x(i)]
      points(i)%runs = found%runs(i)
      points(i)%captured = found%successes(i)
      call finish_point(points(i), batch%request%search%confidence)
    end do
  end subroutine search_points

  subroutine finish_point(point, confidence)
    type(point_row_t), intent(inout) :: point
    real(wp), intent(in) :: confidence
    point%probability = real(point%captured, wp)/real(max(1, point%runs), wp)
    if (point%runs == 0) point%probability = ieee_value(1.0_wp, ieee_quiet_nan)
    call wilson_interval(point%captured, point%runs, confidence, point%lower, point%upper)
  end subroutine finish_point

end module castnet_study
