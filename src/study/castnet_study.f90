!> A study: many captures side by side, one per thread at a time, and what they say.
!>
!> A case is a number; everything about it follows from that number (castnet_study_design),
!> so neither order, threads, shards nor a restart can change it. Finished cases go to a
!> journal at once; the table is made from the journal at the end.
module castnet_study
  use castnet_kinds, only: wp, i8
  use castnet_error, only: error_t, fail, exit_stopped, exit_done, exit_input, exit_file
  use castnet_lock, only: lock_t, take_lock, release_lock
  use castnet_log, only: log_t, log_note, log_result, log_progress, end_progress
  use castnet_posix, only: wall_seconds, path_kind, path_file, remove_file, make_folder, free_space, file_failure
  use castnet_process_guard, only: guard_thread
  use castnet_runner, only: run_options_t
  use castnet_scene, only: scene_t
  use castnet_scene_files, only: text_contents, data_contents, varied_contents
  use castnet_signals, only: install_signal_handlers, stop_request_code
  use castnet_stable_step, only: spectrum_memory_t
  use castnet_study_case, only: case_setting_t, run_case, run_file, has_run_file, expected_run_bytes
  use castnet_study_design, only: new_design
  use castnet_study_journal, only: journal_t, open_journal, append_case, sync_journal, read_journal, study_identity
  use castnet_study_record, only: case_row_t, case_done, case_missing
  use castnet_study_request, only: study_request_t, is_search
  use castnet_study_result, only: make_table, columns
  use castnet_study_search, only: sampler_t, search_result_t, find_threshold, find_optimum
  use castnet_text, only: to_text, byte_text, text_t, without_extension
  use omp_lib, only: omp_get_thread_num
  implicit none
  private
  public :: study_options_t, run_study, collect_study, journal_path

  real(wp), parameter :: sync_interval = 2.0_wp   !! between two times the journal is forced to the disk [s]

  type :: study_options_t
    character(len=:), allocatable :: output
    integer :: threads = 1
    integer :: shard = 1, shards = 1
    real(wp) :: max_wall = huge(1.0_wp)           !! [s]
    logical :: force = .false.
    character(len=:), allocatable :: version, compiler, flags
  end type study_options_t

  !> What one batch of cases needs.
  type, extends(sampler_t) :: batch_t
    type(case_setting_t) :: setting
    type(study_options_t) :: options
    type(journal_t) :: journal
    type(log_t) :: log
    type(case_row_t), allocatable :: rows(:)      !! by case number
    type(spectrum_memory_t), allocatable :: memory(:) !! of each thread
    real(wp) :: began = 0.0_wp
    integer(i8) :: done = 0, wanted = 0
    integer(i8) :: next_case = 1                  !! of a search
    logical :: replay = .false.                   !! a search runs nothing: it asks the rows alone
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
    type(search_result_t), allocatable :: found(:)
    character(len=:), allocatable :: path
    integer :: ignored

    call prepare(batch, request, base, options, log, error)
    if (allocated(error)) return
    if (options%shards > 1 .and. is_search(request) .and. batch%setting%design%n_point == 1) then
      call fail(error, exit_input, '--shard: a search chooses its next cases from the last, so it cannot be divided; '// &
                'searches at several values of a &vary key can')
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
      call tell_kept(batch, size(kept))
      if (request%study%record == 'runs') call prepare_folder(batch, error)
    end if
    if (.not. allocated(error)) then
      allocate (found(0))
      if (is_search(request)) then
        call run_searches(batch, found)
      else
        call run_map(batch)
      end if
      call sync_journal(batch%journal)
      call end_progress(batch%log)
      call finish(batch, found, error)
    end if
    call release_lock(lock)
  end subroutine run_study

  !> Everything that the cases share.
  subroutine prepare(batch, request, base, options, log, error)
    type(batch_t), intent(out) :: batch
    type(study_request_t), intent(in) :: request
    type(scene_t), intent(in) :: base
    type(study_options_t), intent(in) :: options
    type(log_t), intent(in) :: log
    type(error_t), allocatable, intent(inout) :: error
    batch%setting%request = request
    batch%setting%base = base
    batch%setting%run%threads = 1
    batch%setting%run%version = options%version
    batch%setting%run%compiler = options%compiler
    batch%setting%run%flags = options%flags
    batch%options = options
    batch%log = log
    batch%began = wall_seconds()
    allocate (batch%rows(0), batch%memory(max(1, options%threads)))
    call new_design(batch%setting%design, request, error)
  end subroutine prepare

  !> What a study that is started again need not do.
  subroutine tell_kept(batch, n)
    type(batch_t), intent(inout) :: batch
    integer, intent(in) :: n
    if (n > 0) call log_note(batch%log, to_text(n)//' cases are there already, in '//batch%journal%path)
  end subroutine tell_kept

  !> A signal, a failure, or the table.
  subroutine finish(batch, found, error)
    type(batch_t), intent(inout) :: batch
    type(search_result_t), intent(in) :: found(:)
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: answer
    if (allocated(batch%error)) then
      call move_alloc(batch%error, error)
    else if (batch%stop_code /= exit_done) then
      call fail(error, batch%stop_code, 'stopped after '//to_text(count(batch%rows%status /= case_missing))// &
                ' cases; the same command goes on with what is missing')
    else if (batch%options%shards == 1) then
      call make_table(batch%setting, batch%rows, found, batch%options%output, batch%options%version, answer, error)
      if (.not. allocated(error) .and. len(answer) > 0) call log_result(batch%log, answer)
    end if
  end subroutine finish

  ! ---- the runs' own files ------------------------------------------------------------

  !> OUTPUT without its ending, and '.runs/'. A finished case whose file is gone is run
  !> again. Errors: exit_file, also when the files will not fit.
  subroutine prepare_folder(batch, error)
    type(batch_t), intent(inout) :: batch
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: folder
    integer(i8) :: k, bytes, files, left
    integer :: number

    folder = without_extension(batch%options%output)//'.runs'
    number = make_folder(folder)
    if (number /= 0) then
      call file_failure(error, number, 'cannot make the folder of the runs', folder, 'choose another place with --output')
      return
    end if
    batch%setting%folder = folder//'/'
    do k = 1, size(batch%rows)
      if (batch%rows(k)%status /= case_done) cycle
      if (.not. has_run_file(batch%setting%folder, k)) batch%rows(k)%status = case_missing
    end do
    call expect_files(batch, files, bytes, error)
    if (allocated(error) .or. files == 0) return
    left = free_space(batch%setting%folder//'.')
    call log_note(batch%log, 'at most '//to_text(files)//' runs of '//byte_text(real(bytes, wp))//' each into '//folder)
    if (left < 0 .or. real(left, wp) >= real(files, wp)*real(bytes, wp)) return
    call fail(error, exit_file, "the disk of '"//folder//"' is too small: "//to_text(files)//' runs write up to '// &
              byte_text(real(files, wp)*real(bytes, wp))//', '//byte_text(real(left, wp))// &
              ' are free; free disk space, choose another place with --output, a longer output/frame_interval or '// &
              'record = ''table''')
  end subroutine prepare_folder

  !> Most files that are still written, and the bytes of the first that can be.
  subroutine expect_files(batch, files, bytes, error)
    type(batch_t), intent(in) :: batch
    integer(i8), intent(out) :: files, bytes
    type(error_t), allocatable, intent(inout) :: error
    integer, parameter :: most_tried = 20
    integer(i8) :: p, k
    integer :: tried
    real(wp) :: value

    files = 0
    bytes = 0
    tried = 0
    value = 0.0_wp
    if (is_search(batch%setting%request)) value = batch%setting%request%search%from
    associate (design => batch%setting%design)
      do p = 1, design%n_point
        do k = (p - 1)*design%stride + 1, p*design%stride
          if (.not. is_ours(batch, p, k)) cycle
          if (k <= size(batch%rows)) then
            if (batch%rows(k)%status /= case_missing) cycle
          end if
          files = files + 1
          if (bytes > 0 .or. tried == most_tried) cycle
          bytes = expected_run_bytes(batch%setting, k, value, error)
          if (allocated(error)) return
          tried = tried + 1
        end do
      end do
    end associate
  end subroutine expect_files

  !> Does this shard run that case? Cases are dealt out in turn, searches as a whole.
  pure logical function is_ours(batch, point, case)
    type(batch_t), intent(in) :: batch
    integer(i8), intent(in) :: point, case
    integer(i8) :: number
    number = merge(point, case, is_search(batch%setting%request))
    is_ours = modulo(number - 1, int(batch%options%shards, i8)) == batch%options%shard - 1
  end function is_ours

  ! ---- shards ---------------------------------------------------------------------------

  !> Put the journals of all shards (and of an unsharded run) into one table.
  subroutine collect_study(request, base, options, log, missing, error)
    type(study_request_t), intent(in) :: request
    type(scene_t), intent(in) :: base
    type(study_options_t), intent(in) :: options
    type(log_t), intent(inout) :: log
    integer(i8), intent(out) :: missing            !! cases that no journal holds; of searches, those not finished
    type(error_t), allocatable, intent(inout) :: error
    type(batch_t) :: batch
    type(case_row_t), allocatable :: rows(:)
    type(search_result_t), allocatable :: found(:)
    type(text_t), allocatable :: paths(:)
    integer(i8) :: length
    integer :: i, n

    missing = 0
    call prepare(batch, request, base, options, log, error)
    if (allocated(error)) return
    call find_journals(options%output, options%shards, paths)
    n = size(paths)
    if (n == 0) then
      call fail(error, exit_input, 'collect: no journal of this study beside '//options%output// &
                '; run castnet study first, with the same --output and for shards --shard K/N')
      return
    end if
    do i = 1, n
      call read_journal(paths(i)%chars, identity_of(request, base), columns(request), rows, length, error)
      if (allocated(error)) return
      call place_rows(batch, rows)
      call log_note(log, to_text(size(rows))//' cases in '//paths(i)%chars)
    end do
    batch%options%shard = 1
    batch%options%shards = 1
    allocate (found(0))
    if (is_search(request)) then
      batch%replay = .true.
      call run_searches(batch, found)
      missing = count(found%stopped)
    else
      missing = batch%setting%design%n_case - count(batch%rows%status /= case_missing)
    end if
    call finish(batch, found, error)
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
    text = request%text//base%text//text_contents(base)//data_contents(base)//varied_contents(base, request%vary)
    do i = 1, size(request%scene_overrides)
      text = text//request%scene_overrides(i)%chars
    end do
    identity_of = study_identity(text)
  end function identity_of

  !> Rows read from a journal to their places.
  subroutine place_rows(batch, rows)
    type(batch_t), intent(inout) :: batch
    type(case_row_t), intent(in) :: rows(:)
    integer :: i
    associate (n_case => batch%setting%design%n_case)
      if (.not. is_search(batch%setting%request)) then
        call reserve_rows(batch, n_case)
      else if (size(rows) > 0) then
        call reserve_rows(batch, min(n_case, maxval(rows%case)))
      end if
    end associate
    do i = 1, size(rows)
      if (rows(i)%case >= 1 .and. rows(i)%case <= size(batch%rows)) batch%rows(rows(i)%case) = rows(i)
    end do
  end subroutine place_rows

  !> Room for cases 1 to n. A search asks for little more each time: it gets more at once.
  subroutine reserve_rows(batch, n)
    type(batch_t), intent(inout) :: batch
    integer(i8), intent(in) :: n
    type(case_row_t), allocatable :: larger(:)
    integer(i8) :: room
    if (n <= size(batch%rows)) return
    room = min(batch%setting%design%n_case, max(n, 2*size(batch%rows, kind=i8)))
    allocate (larger(room))
    larger(:size(batch%rows)) = batch%rows
    call move_alloc(larger, batch%rows)
  end subroutine reserve_rows

  !> Every case of the map that is this shard's and missing.
  subroutine run_map(batch)
    type(batch_t), intent(inout) :: batch
    integer(i8), allocatable :: cases(:)
    real(wp), allocatable :: no_value(:)
    integer(i8) :: k, n

    allocate (cases(batch%setting%design%n_case))
    n = 0
    do k = batch%options%shard, batch%setting%design%n_case, batch%options%shards
      if (batch%rows(k)%status /= case_missing) cycle
      n = n + 1
      cases(n) = k
    end do
    batch%wanted = n
    allocate (no_value(n), source=0.0_wp)
    call run_cases(batch, cases(:n), no_value)
  end subroutine run_map

  !> A search for each combination of the varied keys that is this shard's.
  subroutine run_searches(batch, found)
    type(batch_t), intent(inout) :: batch
    type(search_result_t), allocatable, intent(out) :: found(:)
    integer(i8) :: p, n
    integer :: seeds
    n = batch%setting%design%n_point
    allocate (found(n))
    seeds = max(1, batch%setting%request%study%seeds)
    associate (s => batch%setting%request%search, shard => batch%options%shard, shards => batch%options%shards)
      batch%wanted = s%budget*((n - shard)/shards + 1)
      do p = shard, n, shards
        batch%next_case = (p - 1)*batch%setting%design%stride + 1
        if (batch%setting%request%study%question == 'threshold') then
          call find_threshold(batch, s%from, s%to, s%probability, s%confidence, s%budget, seeds, found(p))
        else
          call find_optimum(batch, s%from, s%to, s%confidence, s%budget, seeds, found(p))
        end if
        if (batch%stop_code /= exit_done .or. allocated(batch%error)) exit
      end do
    end associate
  end subroutine run_searches

  !> More runs at values of the searched key; a case that the journal holds is not run
  !> again. `stopped` when not all of them have been run.
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
    if (.not. self%replay) call run_cases(self, missing, missing_values)
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
    stopped = any(self%rows(cases)%status == case_missing)
  end subroutine sample_cases

  !> Run cases over the threads, each on one; finished ones go to the journal at once.
  subroutine run_cases(batch, cases, values)
    type(batch_t), intent(inout) :: batch
    integer(i8), intent(in) :: cases(:)
    real(wp), intent(in) :: values(:)          !! of the searched key
    type(case_row_t) :: row
    type(error_t), allocatable :: problem
    real(wp) :: synced
    integer :: i
    logical :: finished, stop_now

    synced = wall_seconds()
    !$omp parallel do default(shared) private(i, row, finished, stop_now, problem) schedule(dynamic, 1) &
    !$omp   num_threads(size(batch%memory))
    do i = 1, size(cases)
      call guard_thread()
      !$omp critical (castnet_text)
      stop_now = allocated(batch%error) .or. batch%stop_code /= exit_done
      !$omp end critical (castnet_text)
      if (stop_now) cycle
      call run_case(batch%setting, batch%memory(omp_get_thread_num() + 1), cases(i), values(i), row, finished, problem)
      !$omp critical (castnet_text)
      if (allocated(problem)) then
        if (.not. allocated(batch%error)) call move_alloc(problem, batch%error)
        if (allocated(problem)) deallocate (problem)
      else if (finished .and. .not. allocated(batch%error)) then
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
      !$omp end critical (castnet_text)
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

end module castnet_study
