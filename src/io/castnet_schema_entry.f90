!> One key as data: what it may hold, what it means, where its value lives; and the
!> verbs on it: take values, say what is wrong with them, show the value as text.
module castnet_schema_entry
  use castnet_kinds, only: wp, i8
  use castnet_namelist, only: item_t, value_t, most_values
  use castnet_scene, only: word_length, path_length, unset, is_set
  use castnet_text, only: to_text, lower, parse_real, parse_integer, parse_logical, is_one_of, quoted, &
                          word_at, word_count, closest_word, is_utf8
  implicit none
  private
  public :: entry_t, kind_real, kind_integer, kind_logical, kind_word, kind_path, kind_words, most_components

  integer, parameter :: kind_real = 1, kind_integer = 2, kind_logical = 3, kind_word = 4, kind_path = 5, kind_words = 6
  integer, parameter :: most_components = 6

  !> One key and the place of its value. Exactly one of the pointers is associated,
  !> or none for a list of open length, which is kept here and copied by its owner.
  type :: entry_t
    character(len=16) :: group = ''
    character(len=32) :: key = ''
    integer :: kind = 0
    integer :: count = 1                     !! values; 0: as many as wanted
    integer :: least = 1                     !! fewest values
    character(len=12) :: unit = ''
    real(wp) :: low = -huge(1.0_wp), high = huge(1.0_wp)
    logical :: above = .false.               !! low itself is not allowed
    character(len=128) :: words = ''         !! allowed words
    character(len=64) :: pending_words = ''  !! of these, not available yet
    logical :: only_zero = .false.           !! other values than 0 not available yet
    character(len=40) :: need = ''           !! '': optional; 'always', or the condition under which it is required
    character(len=40) :: use = ''            !! condition under which it has an effect; '': always
    character(len=56) :: fallback = ''       !! the default in words, when it is computed
    character(len=40) :: noun = 'a path in quotes' !! what a text is
    character(len=128) :: initial = ''       !! the default as text
    character(len=160) :: help = ''
    real(wp), pointer :: real_0 => null(), real_1(:) => null()
    integer, pointer :: integer_0 => null(), integer_1(:) => null()
    integer(i8), pointer :: long_0 => null()
    logical, pointer :: logical_0 => null()
    character(len=word_length), pointer :: word_0 => null()
    character(len=path_length), pointer :: path_0 => null()
    real(wp), allocatable :: real_list(:)
    character(len=word_length), allocatable :: word_list(:)
    ! where the value was given, while a file is read
    logical :: given = .false.
    logical :: failed = .false.              !! what was given could not be taken, and that has been told
    integer :: level = 0                     !! number of the file in the chain of includes
    integer :: line = 0
    character(len=:), allocatable :: path
    logical :: part_given(most_components) = .false.
  contains
    procedure :: set => set_entry
    procedure :: text => entry_text
    procedure :: has_value
    procedure :: allowed
    procedure :: is_array
    procedure :: name => entry_name
  end type entry_t

contains

  !> 'group/key'.
  pure function entry_name(self) result(text)
    class(entry_t), intent(in) :: self
    character(len=:), allocatable :: text
    text = trim(self%group)//'/'//trim(self%key)
  end function entry_name

  pure logical function is_array(self)
    class(entry_t), intent(in) :: self
    is_array = self%count > 1
  end function is_array

  !> Give the key the values of an item: the whole key, or one component. Nothing is
  !> stored unless all is right. `problem`: what was seen and what is allowed.
  subroutine set_entry(self, item, problem)
    class(entry_t), intent(inout) :: self
    type(item_t), intent(in) :: item
    character(len=:), allocatable, intent(out) :: problem
    real(wp), allocatable :: reals(:)
    integer(i8), allocatable :: longs(:)
    integer :: total, i
    total = 0
    do i = 1, item%n
      total = total + item%values(i)%repeats
    end do
    call check_count(self, item, total, problem)
    if (allocated(problem)) return
    select case (self%kind)
    case (kind_real)
      call read_reals(self, item, total, reals, problem)
      if (.not. allocated(problem)) call store_reals(self, item%subscript, reals)
    case (kind_integer)
      call read_integers(self, item, total, longs, problem)
      if (.not. allocated(problem)) call store_integers(self, item%subscript, longs)
    case (kind_words)
      call store_words(self, item, total, problem)
    case default
      call set_scalar(self, item%values(1), problem)
    end select
  end subroutine set_entry

  subroutine check_count(self, item, total, problem)
    type(entry_t), intent(in) :: self
    type(item_t), intent(in) :: item
    integer, intent(in) :: total
    character(len=:), allocatable, intent(inout) :: problem
    if (item%subscript > 0) then
      if (self%count <= 1) then
        problem = 'an index ('//to_text(item%subscript)//') on a key that takes none; allowed: '//self%allowed()
      else if (item%subscript > self%count) then
        problem = 'seen index ('//to_text(item%subscript)//'); allowed: (1) to ('//to_text(self%count)//')'
      else if (total /= 1) then
        problem = 'seen '//to_text(total)//' values for one component; allowed: 1'
      end if
    else if (self%count == 0) then
      if (total > most_values) problem = 'more than '//to_text(most_values)//' values'
    else if (total > self%count .or. total < self%least) then
      problem = 'seen '//to_text(total)//' value'//trim(merge('s', ' ', total /= 1))//'; allowed: '//self%allowed()
    end if
  end subroutine check_count

  !> Reals of an item, repeats written out, each one in range.
  subroutine read_reals(self, item, total, reals, problem)
    type(entry_t), intent(in) :: self
    type(item_t), intent(in) :: item
    integer, intent(in) :: total
    real(wp), allocatable, intent(out) :: reals(:)
    character(len=:), allocatable, intent(inout) :: problem
    character(len=:), allocatable :: wrong, seen
    real(wp) :: value
    integer :: i, n
    allocate (reals(total))
    n = 0
    do i = 1, item%n
      associate (v => item%values(i))
        seen = v%text
        value = 0.0_wp
        if (v%is_string) then
          wrong = 'is text'
          seen = shown(v%text)
        else
          call parse_real(v%text, value, wrong)
        end if
        if (.not. allocated(wrong)) then
          if (value < self%low .or. value > self%high .or. (self%above .and. value == self%low)) then
            wrong = ''
          else if (self%only_zero .and. value /= 0.0_wp) then
            wrong = 'is not available yet'
          end if
        end if
        if (allocated(wrong)) then
          call add_seen(problem, self, seen, wrong)
          deallocate (wrong)
        end if
        reals(n + 1:n + v%repeats) = value
        n = n + v%repeats
      end associate
    end do
    call add_allowed(problem, self)
  end subroutine read_reals

  subroutine read_integers(self, item, total, longs, problem)
    type(entry_t), intent(in) :: self
    type(item_t), intent(in) :: item
    integer, intent(in) :: total
    integer(i8), allocatable, intent(out) :: longs(:)
    character(len=:), allocatable, intent(inout) :: problem
    character(len=:), allocatable :: wrong, seen
    integer(i8) :: value
    integer :: i, n
    allocate (longs(total))
    n = 0
    do i = 1, item%n
      associate (v => item%values(i))
        seen = v%text
        value = 0
        if (v%is_string) then
          wrong = 'is text'
          seen = shown(v%text)
        else
          call parse_integer(v%text, value, wrong)
        end if
        if (.not. allocated(wrong)) then
          if (real(value, wp) < self%low .or. real(value, wp) > self%high) wrong = ''
        end if
        if (allocated(wrong)) then
          call add_seen(problem, self, seen, wrong)
          deallocate (wrong)
        end if
        longs(n + 1:n + v%repeats) = value
        n = n + v%repeats
      end associate
    end do
    call add_allowed(problem, self)
  end subroutine read_integers

  !> A logical, a word, a path.
  subroutine set_scalar(self, value, problem)
    class(entry_t), intent(inout) :: self
    type(value_t), intent(in) :: value
    character(len=:), allocatable, intent(inout) :: problem
    character(len=:), allocatable :: word
    logical :: flag
    select case (self%kind)
    case (kind_logical)
      if (value%is_string) then
        problem = 'seen text '//shown(value%text)//'; allowed: '//self%allowed()
        return
      end if
      call parse_logical(value%text, flag, problem)
      if (allocated(problem)) then
        problem = 'seen '//bare(value%text)//'; allowed: '//self%allowed()
      else
        self%logical_0 = flag
      end if
    case (kind_word)
      word = lower(trim(value%text))
      if (.not. value%is_string) then
        problem = 'seen '//bare(value%text)//' without quotes; allowed: '//self%allowed()//did_you_mean_quoted(word, self%words)
      else if (.not. is_one_of(word, trim(self%words))) then
        problem = 'seen '//shown(value%text)//'; allowed: '//self%allowed()//did_you_mean_quoted(word, self%words)
      else if (is_one_of(word, trim(self%pending_words))) then
        problem = 'seen '//shown(value%text)//', which is not available yet; allowed: '//self%allowed()
      else
        self%word_0 = word
      end if
    case (kind_path)
      call check_path(value, trim(self%noun), problem)
      if (.not. allocated(problem)) self%path_0 = value%text
    end select
  end subroutine set_scalar

  subroutine check_path(value, noun, problem)
    type(value_t), intent(in) :: value
    character(len=*), intent(in) :: noun
    character(len=:), allocatable, intent(inout) :: problem
    integer :: n, i
    n = len(value%text)
    if (.not. value%is_string) then
      problem = 'seen '//bare(value%text)//' without quotes; allowed: '//noun
    else if (n > path_length) then
      problem = 'seen a text of '//to_text(n)//' bytes; allowed: at most '//to_text(path_length)
    else if (.not. is_utf8(value%text)) then
      problem = 'seen a text that is not UTF-8'
    else if (n > 0) then
      if (value%text(n:n) == ' ' .or. value%text(1:1) == ' ') problem = 'seen '//shown(value%text)// &
        '; allowed: '//noun//', without a blank at either end'
      do i = 1, n
        if (iachar(value%text(i:i)) < 32 .or. iachar(value%text(i:i)) == 127) problem = 'seen a text with a control character'
      end do
    end if
  end subroutine check_path

  subroutine store_reals(self, subscript, reals)
    class(entry_t), intent(inout) :: self
    integer, intent(in) :: subscript
    real(wp), intent(in) :: reals(:)
    if (self%count == 0) then
      self%real_list = reals
    else if (associated(self%real_0)) then
      self%real_0 = reals(1)
    else if (subscript > 0) then
      self%real_1(subscript) = reals(1)
    else
      self%real_1 = unset
      self%real_1(:size(reals)) = reals
    end if
  end subroutine store_reals

  subroutine store_integers(self, subscript, longs)
    class(entry_t), intent(inout) :: self
    integer, intent(in) :: subscript
    integer(i8), intent(in) :: longs(:)
    if (associated(self%long_0)) then
      self%long_0 = longs(1)
    else if (associated(self%integer_0)) then
      self%integer_0 = int(longs(1))
    else if (subscript > 0) then
      self%integer_1(subscript) = int(longs(1))
    else
      self%integer_1 = int(longs)
    end if
  end subroutine store_integers

  subroutine store_words(self, item, total, problem)
    class(entry_t), intent(inout) :: self
    type(item_t), intent(in) :: item
    integer, intent(in) :: total
    character(len=:), allocatable, intent(inout) :: problem
    character(len=word_length) :: list(total)
    integer :: i, n
    n = 0
    do i = 1, item%n
      if (len(item%values(i)%text) > word_length .or. len_trim(item%values(i)%text) == 0) then
        problem = 'seen '//shown(item%values(i)%text)//'; allowed: 1 to '//to_text(word_length)//' characters'
        return
      end if
      list(n + 1:n + item%values(i)%repeats) = item%values(i)%text
      n = n + item%values(i)%repeats
    end do
    self%word_list = list
  end subroutine store_words

  !> A text in quotes for a message, cut when long.
  pure function shown(text) result(words)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: words
    words = quoted(bare(text))
  end function shown

  pure function bare(text) result(words)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: words
    integer, parameter :: longest = 80
    words = text
    if (len(text) <= longest) return
    words = text(:longest)
    do while (.not. is_utf8(words) .and. len(words) > longest - 4)   ! not through a letter
      words = words(:len(words) - 1)
    end do
    words = words//'...'
  end function bare

  !> 'seen 3, nan (must be finite)': each wrong value, up to a few.
  subroutine add_seen(problem, self, seen, wrong)
    character(len=:), allocatable, intent(inout) :: problem
    type(entry_t), intent(in) :: self
    character(len=*), intent(in) :: seen, wrong
    character(len=:), allocatable :: words
    words = bare(seen)
    if (wrong == 'is not available yet' .and. self%only_zero) then
      words = words//', which is not available yet'
    else if (len(wrong) > 0) then
      words = words//', which '//wrong
    end if
    if (.not. allocated(problem)) then
      problem = 'seen '//words
    else if (len(problem) < 300) then
      problem = problem//' and '//words
    end if
  end subroutine add_seen

  subroutine add_allowed(problem, self)
    character(len=:), allocatable, intent(inout) :: problem
    type(entry_t), intent(in) :: self
    if (allocated(problem)) problem = problem//'; allowed: '//self%allowed()
  end subroutine add_allowed

  function did_you_mean_quoted(word, words) result(text)
    character(len=*), intent(in) :: word, words
    character(len=:), allocatable :: text
    text = closest_word(word, trim(words))
    if (len(text) > 0) text = '; did you mean '//quoted(text)//'?'
  end function did_you_mean_quoted

  !> What the key may hold, in words.
  function allowed(self) result(text)
    class(entry_t), intent(in) :: self
    character(len=:), allocatable :: text
    character(len=:), allocatable :: noun
    integer :: i
    select case (self%kind)
    case (kind_logical)
      text = '.true. or .false.'
    case (kind_path)
      text = trim(self%noun)
    case (kind_words)
      text = 'numbers or words'
    case (kind_word)
      text = ''
      do i = 1, word_count(trim(self%words))
        if (i > 1) text = text//', '
        text = text//quoted(word_at(trim(self%words), i))
        if (is_one_of(word_at(trim(self%words), i), trim(self%pending_words))) text = text//' (not available yet)'
      end do
    case default
      noun = trim(merge('number      ', 'whole number', self%kind == kind_real))
      if (self%count == 0) then
        text = noun//'s'
      else if (self%count == 1) then
        text = 'a '//noun
      else if (self%least < self%count) then
        text = to_text(self%least)//' to '//to_text(self%count)//' '//noun//'s'
      else
        text = to_text(self%count)//' '//noun//'s'
      end if
      text = text//range_text(self)
      if (len_trim(self%unit) > 0) text = text//' ['//trim(self%unit)//']'
      if (self%only_zero) text = text//' (only 0: others are not available yet)'
    end select
  end function allowed

  pure function range_text(self) result(text)
    type(entry_t), intent(in) :: self
    character(len=:), allocatable :: text
    text = ''
    if (self%low > -huge(1.0_wp) .and. self%high < huge(1.0_wp) .and. .not. self%above) then
      text = ' from '//to_text(self%low)//' to '//to_text(self%high)
    else
      if (self%low > -huge(1.0_wp)) text = trim(merge(' above   ', ' at least', self%above))//' '//to_text(self%low)
      if (len(text) > 0) text = ' '//trim(adjustl(text))
      if (self%high < huge(1.0_wp)) then
        if (len(text) > 0) text = text//' and'
        text = text//' at most '//to_text(self%high)
      end if
    end if
  end function range_text

  !> Has the key a value (or a default)?
  logical function has_value(self)
    class(entry_t), intent(in) :: self
    has_value = .true.
    if (self%kind == kind_words) then
      has_value = allocated(self%word_list)
    else if (self%count == 0) then
      has_value = allocated(self%real_list)
      if (has_value) has_value = size(self%real_list) > 0
    else if (associated(self%real_0)) then
      has_value = is_set(self%real_0)
    else if (associated(self%real_1)) then
      has_value = all(is_set(self%real_1(:self%least)))
    else if (associated(self%integer_0)) then
      has_value = self%integer_0 >= self%low
    else if (associated(self%integer_1)) then
      has_value = all(self%integer_1 >= self%low)
    else if (associated(self%word_0)) then
      has_value = len_trim(self%word_0) > 0
    else if (associated(self%path_0)) then
      has_value = len_trim(self%path_0) > 0
    end if
  end function has_value

  !> The value as namelist text that reads back to itself; '' without a value.
  function entry_text(self) result(text)
    class(entry_t), intent(in) :: self
    character(len=:), allocatable :: text
    integer :: i
    text = ''
    if (self%kind /= kind_real .or. .not. associated(self%real_1)) then
      if (.not. self%has_value()) return
    end if
    if (self%kind == kind_words) then
      do i = 1, size(self%word_list)
        text = text//', '//list_word(trim(self%word_list(i)))
      end do
      text = text(3:)
    else if (self%count == 0) then
      text = real_list_text(self%real_list)
    else if (associated(self%real_0)) then
      text = to_text(self%real_0)
    else if (associated(self%real_1)) then
      i = count(is_set(self%real_1))
      if (i > 0 .and. all(is_set(self%real_1(:i)))) text = real_list_text(self%real_1(:i))
    else if (associated(self%integer_0)) then
      text = to_text(self%integer_0)
    else if (associated(self%integer_1)) then
      text = to_text(self%integer_1(1))
      do i = 2, size(self%integer_1)
        text = text//', '//to_text(self%integer_1(i))
      end do
    else if (associated(self%long_0)) then
      text = to_text(self%long_0)
    else if (associated(self%logical_0)) then
      text = to_text(self%logical_0)
    else if (associated(self%word_0)) then
      text = quoted(trim(self%word_0))
    else if (associated(self%path_0)) then
      text = quoted(trim(self%path_0))
    end if
  end function entry_text

  !> A word of a list: numbers and logicals as they are, the rest in quotes.
  pure function list_word(word) result(text)
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: text, problem
    real(wp) :: number
    logical :: flag
    text = word
    call parse_real(word, number, problem)
    if (allocated(problem)) call parse_logical(word, flag, problem)
    if (allocated(problem)) text = quoted(word)
  end function list_word

  pure function real_list_text(values) result(text)
    real(wp), intent(in) :: values(:)
    character(len=:), allocatable :: text
    integer :: i
    text = to_text(values(1))
    do i = 2, size(values)
      text = text//', '//to_text(values(i))
    end do
  end function real_list_text

end module castnet_schema_entry
