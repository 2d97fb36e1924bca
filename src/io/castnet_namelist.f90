!> Namelist text, read strictly: groups, keys, values and the line each stands on,
!> without knowing what they mean. What the compiler's own reader would swallow (half
!> an array, a cut string, text between groups, an empty value, a missing final /)
!> is a problem here, told with its line; reading then goes on, so that all are found.
module castnet_namelist
  use castnet_namelist_tokens, only: token_t, token_list_t, scan_tokens, string_content, snippet, token_word, token_string, &
                                     token_cut, token_group, token_slash, token_equals, token_open, token_close, &
                                     token_comma, token_bad, token_end
  use castnet_problems, only: problem_list_t
  use castnet_text, only: lower, parse_integer, to_text
  use castnet_kinds, only: i8
  implicit none
  private
  public :: value_t, item_t, group_t, namelist_t, parse_namelist, parse_value_list, most_values

  integer, parameter :: most_values = 100000  !! of one key, repeat counts expanded
  integer, parameter :: most_groups = 10000, most_items = 10000
  integer, parameter :: longest_name = 63     !! of a group or key; what is longer is cut, and unknown

  type :: value_t
    character(len=:), allocatable :: text  !! as written; quotes taken off
    logical :: is_string = .false.         !! written in quotes
    logical :: broken = .false.            !! already reported
    integer :: repeats = 1
  end type value_t

  type :: item_t
    character(len=:), allocatable :: key   !! lower case
    integer :: subscript = 0               !! 0: the whole key
    integer :: line = 0
    integer :: n = 0
    type(value_t), allocatable :: values(:) !! (n), may be longer
  end type item_t

  type :: group_t
    character(len=:), allocatable :: name  !! lower case; '': none, and told
    integer :: line = 0
    integer :: n = 0
    type(item_t), allocatable :: items(:)  !! (n), may be longer
  end type group_t

  type :: namelist_t
    character(len=:), allocatable :: path
    integer :: last_line = 1
    integer :: n = 0
    type(group_t), allocatable :: groups(:) !! (n), may be longer
  end type namelist_t

contains

  !> Parse a whole text. `path` is only for the messages.
  subroutine parse_namelist(path, text, document, problems)
    character(len=*), intent(in) :: path, text
    type(namelist_t), intent(out) :: document
    type(problem_list_t), intent(inout) :: problems
    type(token_list_t) :: tokens
    integer :: i, line
    document%path = path
    allocate (document%groups(8))
    call scan_tokens(path, text, tokens, problems)
    document%last_line = tokens%list(tokens%n)%line
    i = 1
    do while (tokens%list(i)%kind /= token_end .and. .not. problems%is_full())
      if (document%n >= most_groups) then
        call problems%add(path, tokens%list(i)%line, '', 'more than '//to_text(most_groups)//' groups; reading stopped here')
        return
      else if (tokens%list(i)%kind == token_group) then
        call parse_group(path, text, tokens, i, document, problems)
      else
        line = tokens%list(i)%line
        call report_stray(path, text, tokens, i, problems)
        do while (tokens%list(i)%line == line .and. tokens%list(i)%kind /= token_group .and. &
                  tokens%list(i)%kind /= token_end)
          i = i + 1
        end do
      end if
    end do
  end subroutine parse_namelist

  !> The values of an override, such as `1, 2*0` or `'box'`.
  subroutine parse_value_list(text, item, problem)
    character(len=*), intent(in) :: text
    type(item_t), intent(out) :: item
    character(len=:), allocatable, intent(out) :: problem
    type(token_list_t) :: tokens
    type(problem_list_t) :: problems
    integer :: i
    call scan_tokens('', text, tokens, problems)
    allocate (item%values(4))
    i = 1
    if (problems%n == 0) call parse_values('', text, tokens, i, item, '', problems)
    if (problems%n > 0) then
      problem = problems%report()
    else if (tokens%list(i)%kind /= token_end) then
      problem = 'unexpected '//snippet(text, tokens%list(i)%first)
    end if
  end subroutine parse_value_list

  !> One group, from its & to its /. On return `i` is the token after it.
  subroutine parse_group(path, text, tokens, i, document, problems)
    character(len=*), intent(in) :: path, text
    type(token_list_t), intent(in) :: tokens
    integer, intent(inout) :: i
    type(namelist_t), intent(inout) :: document
    type(problem_list_t), intent(inout) :: problems
    type(group_t) :: group
    group%name = lower(text(tokens%list(i)%first + 1:min(tokens%list(i)%last, tokens%list(i)%first + longest_name)))
    group%line = tokens%list(i)%line
    allocate (group%items(8))
    i = i + 1
    if (.not. is_name(group%name)) then
      call problems%add(path, group%line, '', 'seen &'//group%name//'; a group starts with & and its name'//hint(group%name))
      group%name = ''
      if (tokens%list(i)%kind == token_word .and. .not. is_key(tokens, i)) then   ! a blank between them
        group%name = lower(text(tokens%list(i)%first:tokens%list(i)%last))
        i = i + 1
      end if
    end if
    do
      if (problems%is_full()) exit
      if (group%n >= most_items) then
        call problems%add(path, tokens%list(i)%line, group%name, 'more than '//to_text(most_items)//' keys; reading stopped here')
        i = tokens%n
        exit
      end if
      associate (token => tokens%list(i))
        select case (token%kind)
        case (token_slash)
          call check_after_slash(path, text, tokens, i, problems)
          i = i + 1
          exit
        case (token_end)
          call problems%add(path, group%line, group%name, 'the group that starts here has no final /')
          exit
        case (token_group)
          if (lower(text(token%first + 1:token%last)) == 'end') then
            call problems%add(path, token%line, group%name, 'seen &end; a group ends with /')
            i = i + 1
          else
            call problems%add(path, group%line, group%name, 'the group that starts here has no final / before &'// &
                              text(token%first + 1:token%last)//' on line '//to_text(token%line))
          end if
          exit
        case (token_word)
          if (is_key(tokens, i)) then
            call parse_item(path, text, tokens, i, group, problems)
          else
            call problems%add(path, token%line, group%name, 'seen '//snippet(text, token%first)//'; expected key = value')
            call skip_to_key(tokens, i)
          end if
        case default
          if (token%kind /= token_bad .and. token%kind /= token_cut) &
            call problems%add(path, token%line, group%name, 'seen '//snippet(text, token%first)//'; expected key = value')
          call skip_to_key(tokens, i)
        end select
      end associate
    end do
    call append_group(document, group)
  end subroutine parse_group

  !> `key = values` or `key(i) = value`. On return `i` is the token after it.
  subroutine parse_item(path, text, tokens, i, group, problems)
    character(len=*), intent(in) :: path, text
    type(token_list_t), intent(in) :: tokens
    integer, intent(inout) :: i
    type(group_t), intent(inout) :: group
    type(problem_list_t), intent(inout) :: problems
    type(item_t) :: item
    character(len=:), allocatable :: about, problem
    integer(i8) :: subscript
    logical :: bad
    item%key = lower(text(tokens%list(i)%first:min(tokens%list(i)%last, tokens%list(i)%first + longest_name)))
    item%line = tokens%list(i)%line
    allocate (item%values(4))
    about = group%name//'/'//item%key
    bad = .false.
    if (.not. is_name(item%key)) then
      call problems%add(path, item%line, about, 'a key is letters, digits and _'//hint(item%key))
      bad = .true.
    end if
    i = i + 1
    if (tokens%list(i)%kind == token_open) then
      call parse_integer(text(tokens%list(i + 1)%first:tokens%list(i + 1)%last), subscript, problem)
      if (allocated(problem) .or. subscript < 1 .or. subscript > most_values .or. &
          tokens%list(i + 2)%kind /= token_close) then
        call problems%add(path, item%line, about, 'seen index '// &
          text(tokens%list(i)%first:tokens%list(closing(tokens, i))%last)//'; allowed: one component, such as (2)')
        bad = .true.
        subscript = 1
      end if
      item%subscript = int(subscript)
      i = closing(tokens, i) + 1
    end if
    i = i + 1      ! over the =
    call parse_values(path, text, tokens, i, item, about, problems)
    if (.not. bad) call append_item(group, item)
  end subroutine parse_item

  !> Values up to the next key, / or group.
  subroutine parse_values(path, text, tokens, i, item, about, problems)
    character(len=*), intent(in) :: path, text, about
    type(token_list_t), intent(in) :: tokens
    integer, intent(inout) :: i
    type(item_t), intent(inout) :: item
    type(problem_list_t), intent(inout) :: problems
    logical :: after_value
    integer :: total, line
    after_value = .false.
    total = 0
    line = tokens%list(max(1, i - 1))%line
    do
      if (problems%is_full()) return
      associate (token => tokens%list(i))
        select case (token%kind)
        case (token_word, token_string, token_cut)
          if (token%kind == token_word .and. is_key(tokens, i)) exit
          call add_value(path, text, token, item, total, about, problems)
          after_value = .true.
        case (token_comma)
          if (.not. after_value) then
            call problems%add(path, token%line, about, 'an empty value before a comma; every value is written out')
            call add_broken(item)
          end if
          after_value = .false.
        case (token_bad)
          call add_broken(item)      ! reported by the scanner
        case (token_equals, token_open, token_close)
          call problems%add(path, token%line, about, 'seen '//snippet(text, token%first)//'; expected a value')
          call add_broken(item)
          call skip_to_key(tokens, i)
          return
        case default
          exit
        end select
      end associate
      i = i + 1
    end do
    if (item%n == 0) then
      call problems%add(path, line, about, 'no value is given')
      call add_broken(item)
    end if
  end subroutine parse_values

  !> One token as a value, with its repeat count.
  subroutine add_value(path, text, token, item, total, about, problems)
    character(len=*), intent(in) :: path, text, about
    type(token_t), intent(in) :: token
    type(item_t), intent(inout) :: item
    integer, intent(inout) :: total
    type(problem_list_t), intent(inout) :: problems
    type(value_t) :: value
    character(len=:), allocatable :: word, problem
    integer(i8) :: repeats
    integer :: star
    word = text(token%first:token%last)
    repeats = 1
    star = 0
    if (token%quote > token%first) then
      star = token%quote - token%first
    else if (token%kind == token_word) then
      star = index(word, '*')
    end if
    if (star > 0) then
      call parse_integer(word(:star - 1), repeats, problem)
      if (allocated(problem) .or. repeats < 1 .or. scan(word(1:1), '+-') > 0 .or. &
          (star == len(word) .and. token%kind == token_word)) then
        call problems%add(path, token%line, about, 'seen '//snippet(text, token%first)// &
          '; a repeated value is written like 3*0.5')
        value%broken = .true.
        repeats = 1
      end if
    end if
    if (repeats + total > most_values) then
      if (total <= most_values) call problems%add(path, token%line, about, 'more than '//to_text(most_values)//' values')
      total = most_values + 1
      call add_broken(item)
      return
    end if
    total = total + int(repeats)
    value%repeats = int(repeats)
    value%is_string = token%kind /= token_word
    if (token%kind == token_cut) value%broken = .true.
    if (token%kind == token_string) then
      value%text = string_content(text(token%quote:token%last))
    else
      value%text = word(star + 1:)
    end if
    call append_value(item, value)
  end subroutine add_value

  !> Only a comment or a group may follow the / of a group on its line.
  subroutine check_after_slash(path, text, tokens, i, problems)
    character(len=*), intent(in) :: path, text
    type(token_list_t), intent(in) :: tokens
    integer, intent(inout) :: i
    type(problem_list_t), intent(inout) :: problems
    integer :: line
    line = tokens%list(i)%line
    if (tokens%list(i + 1)%line /= line) return
    if (tokens%list(i + 1)%kind == token_end .or. tokens%list(i + 1)%kind == token_group) return
    call problems%add(path, line, '', 'text after the / that ends the group: '//snippet(text, tokens%list(i + 1)%first)// &
                      '; a path needs quotes, a remark a !')
    do while (tokens%list(i + 1)%line == line .and. tokens%list(i + 1)%kind /= token_group .and. &
              tokens%list(i + 1)%kind /= token_end)
      i = i + 1
    end do
  end subroutine check_after_slash

  subroutine report_stray(path, text, tokens, i, problems)
    character(len=*), intent(in) :: path, text
    type(token_list_t), intent(in) :: tokens
    integer, intent(in) :: i
    type(problem_list_t), intent(inout) :: problems
    associate (token => tokens%list(i))
      if (token%kind == token_bad .or. token%kind == token_cut) return
      if (is_key(tokens, i)) then
        call problems%add(path, token%line, lower(text(token%first:token%last)), &
          'this key stands outside any group; a group runs from &name to /')
      else
        call problems%add(path, token%line, '', 'text outside groups: '//snippet(text, token%first)//'; a remark needs a !')
      end if
    end associate
  end subroutine report_stray

  !> Is token i a name followed by = , or by an index in brackets and = ?
  logical function is_key(tokens, i)
    type(token_list_t), intent(in) :: tokens
    integer, intent(in) :: i
    integer :: k
    is_key = .false.
    if (tokens%list(i)%kind /= token_word) return
    if (tokens%list(i + 1)%kind == token_equals) then
      is_key = .true.
    else if (tokens%list(i + 1)%kind == token_open) then
      k = closing(tokens, i + 1)
      if (k < tokens%n) is_key = tokens%list(k)%kind == token_close .and. tokens%list(k + 1)%kind == token_equals
    end if
  end function is_key

  !> The token of the bracket that closes the one at token i, at most a few tokens on.
  integer function closing(tokens, i) result(k)
    type(token_list_t), intent(in) :: tokens
    integer, intent(in) :: i
    k = i + 1
    do while (k < tokens%n .and. k < i + 8 .and. tokens%list(k)%kind /= token_close)
      k = k + 1
    end do
  end function closing

  !> Go on after a problem: to the next key, / or group.
  subroutine skip_to_key(tokens, i)
    type(token_list_t), intent(in) :: tokens
    integer, intent(inout) :: i
    do
      i = min(i + 1, tokens%n)
      select case (tokens%list(i)%kind)
      case (token_slash, token_group, token_end)
        return
      case (token_word)
        if (is_key(tokens, i)) return
      end select
    end do
  end subroutine skip_to_key

  pure logical function is_name(word)
    character(len=*), intent(in) :: word
    is_name = .false.
    if (len(word) == 0) return
    is_name = verify(word, 'abcdefghijklmnopqrstuvwxyz0123456789_') == 0 .and. verify(word(1:1), '0123456789_') > 0
  end function is_name

  !> A word for what cannot be seen on the screen.
  pure function hint(word) result(text)
    character(len=*), intent(in) :: word
    character(len=:), allocatable :: text
    text = ''
    if (index(word, achar(194)//achar(160)) > 0) text = ' (it holds a no-break space)'
  end function hint

  subroutine append_group(document, group)
    type(namelist_t), intent(inout) :: document
    type(group_t), intent(in) :: group
    type(group_t), allocatable :: grown(:)
    if (document%n == size(document%groups)) then
      allocate (grown(2*document%n))
      grown(:document%n) = document%groups
      call move_alloc(grown, document%groups)
    end if
    document%n = document%n + 1
    document%groups(document%n) = group
  end subroutine append_group

  subroutine append_item(group, item)
    type(group_t), intent(inout) :: group
    type(item_t), intent(in) :: item
    type(item_t), allocatable :: grown(:)
    if (group%n == size(group%items)) then
      allocate (grown(2*group%n))
      grown(:group%n) = group%items
      call move_alloc(grown, group%items)
    end if
    group%n = group%n + 1
    group%items(group%n) = item
  end subroutine append_item

  subroutine append_value(item, value)
    type(item_t), intent(inout) :: item
    type(value_t), intent(in) :: value
    type(value_t), allocatable :: grown(:)
    if (item%n == size(item%values)) then
      allocate (grown(2*item%n))
      grown(:item%n) = item%values
      call move_alloc(grown, item%values)
    end if
    item%n = item%n + 1
    item%values(item%n) = value
  end subroutine append_value

  subroutine add_broken(item)
    type(item_t), intent(inout) :: item
    type(value_t) :: value
    value%text = ''
    value%broken = .true.
    call append_value(item, value)
  end subroutine add_broken

end module castnet_namelist
