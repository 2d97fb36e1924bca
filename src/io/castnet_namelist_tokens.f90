!> The words of namelist text: where each starts and ends, and on which line.
module castnet_namelist_tokens
  use castnet_problems, only: problem_list_t
  use castnet_text, only: to_text, is_utf8
  implicit none
  private
  public :: token_t, token_list_t, scan_tokens, string_content, snippet
  public :: token_word, token_string, token_cut, token_group, token_slash, token_equals, token_open, token_close, &
            token_comma, token_bad, token_end

  integer, parameter :: token_end = 0, token_word = 1, token_string = 2, token_cut = 3, token_group = 4, &
                        token_slash = 5, token_equals = 6, token_open = 7, token_close = 8, token_comma = 9, token_bad = 10

  character(len=*), parameter :: word_ends = ' ,=()/!''"&'//achar(9)//achar(10)//achar(13)

  type :: token_t
    integer :: kind = token_end
    integer :: first = 1, last = 0   !! in the text
    integer :: line = 0
    integer :: quote = 0             !! strings: where the opening quote stands (after a repeat count)
  end type token_t

  type :: token_list_t
    integer :: n = 0
    type(token_t), allocatable :: list(:) !! (n), may be longer; the last is token_end
  end type token_list_t

contains

  !> Cut a text into tokens. Comments and blanks go; line ends may be LF, CRLF or CR.
  subroutine scan_tokens(path, text, tokens, problems)
    character(len=*), intent(in) :: path, text
    type(token_list_t), intent(out) :: tokens
    type(problem_list_t), intent(inout) :: problems
    integer :: i, line, n
    allocate (tokens%list(64))
    n = len(text)
    line = 1
    i = 1
    if (n >= 3) then
      if (text(1:3) == achar(239)//achar(187)//achar(191)) i = 4   ! byte-order mark
    end if
    do while (i <= n .and. .not. problems%is_full())
      select case (text(i:i))
      case (' ', achar(9))
        i = i + 1
      case (achar(10))
        line = line + 1
        i = i + 1
      case (achar(13))
        if (text(i + 1:min(i + 1, n)) /= achar(10)) line = line + 1
        i = i + 1
      case ('!')
        i = end_of_line(text, i) + 1
      case ('''', '"')
        call scan_string(path, text, i, (i), line, tokens, problems)
      case ('=')
        call single(token_equals)
      case ('(')
        call single(token_open)
      case (')')
        call single(token_close)
      case (',')
        call single(token_comma)
      case ('/')
        call single(token_slash)
      case default
        call scan_word(path, text, i, line, tokens, problems)
      end select
    end do
    call append(tokens, token_end, n + 1, n, line)
  contains
    subroutine single(kind)
      integer, intent(in) :: kind
      call append(tokens, kind, i, i, line)
      i = i + 1
    end subroutine single
  end subroutine scan_tokens

  !> A word, a group name, or a repeat count with its string.
  subroutine scan_word(path, text, i, line, tokens, problems)
    character(len=*), intent(in) :: path, text
    integer, intent(inout) :: i
    integer, intent(in) :: line
    type(token_list_t), intent(inout) :: tokens
    type(problem_list_t), intent(inout) :: problems
    integer :: last, kind
    kind = merge(token_group, token_word, text(i:i) == '&')
    last = scan(text(i + 1:), word_ends)
    last = merge(len(text), i + last - 1, last == 0)
    if (kind == token_word .and. last > i .and. last < len(text)) then
      if (text(last:last) == '*' .and. scan(text(last + 1:last + 1), '''"') > 0) then
        call scan_string(path, text, i, last + 1, line, tokens, problems)
        return
      end if
    end if
    if (is_visible(text(i:last))) then
      call append(tokens, kind, i, last, line)
    else
      call problems%add(path, line, '', 'a character that cannot be shown (code '//to_text(first_code(text(i:last)))// &
        ') or is not UTF-8; save the file as plain UTF-8 text')
      call append(tokens, token_bad, i, last, line)
    end if
    i = last + 1
  end subroutine scan_word

  !> A string from the quote at `quote`; `first` is where its repeat count starts.
  subroutine scan_string(path, text, first, quote, line, tokens, problems)
    character(len=*), intent(in) :: path, text
    integer, intent(inout) :: first
    integer, intent(in) :: quote, line
    type(token_list_t), intent(inout) :: tokens
    type(problem_list_t), intent(inout) :: problems
    character(len=1) :: mark
    integer :: i, last, start
    start = first
    mark = text(quote:quote)
    last = end_of_line(text, quote)
    i = quote + 1
    do while (i <= last)
      if (text(i:i) == mark) then
        if (i == last) exit
        if (text(i + 1:i + 1) /= mark) exit
        i = i + 1
      end if
      i = i + 1
    end do
    if (i > last) then
      call problems%add(path, line, '', 'the string '//snippet(text, quote)//' is not closed on its line')
      call append(tokens, token_cut, start, last, line, quote)
    else if (.not. is_visible(text(quote:i))) then
      call problems%add(path, line, '', 'a string holds a character that cannot be shown (code '// &
                        to_text(first_code(text(quote:i)))//') or is not UTF-8')
      call append(tokens, token_cut, start, i, line, quote)
    else
      call append(tokens, token_string, start, i, line, quote)
    end if
    first = min(i, last) + 1
  end subroutine scan_string

  !> What stands between the quotes; doubled quotes become one.
  pure function string_content(literal) result(content)
    character(len=*), intent(in) :: literal
    character(len=:), allocatable :: content
    integer :: i, n
    allocate (character(len=len(literal)) :: content)
    n = 0
    i = 2
    do while (i < len(literal))
      n = n + 1
      content(n:n) = literal(i:i)
      if (literal(i:i) == literal(1:1)) i = i + 1
      i = i + 1
    end do
    content = content(:n)
  end function string_content

  !> The text from `first` to the end of its line, quoted and cut for a message.
  pure function snippet(text, first) result(shown)
    character(len=*), intent(in) :: text
    integer, intent(in) :: first
    character(len=:), allocatable :: shown
    integer :: last, i
    if (first > len(text)) then
      shown = 'the end of the file'
      return
    end if
    last = min(end_of_line(text, first), first + 39)
    shown = trim(text(first:last))
    do i = 1, len(shown)
      if (iachar(shown(i:i)) < 32 .or. iachar(shown(i:i)) == 127) shown(i:i) = '?'
    end do
    ! not through the middle of a letter
    do i = 1, 3
      if (is_utf8(shown) .or. len(shown) == 0) exit
      if (last == first + 39) shown = shown(:len(shown) - 1)
    end do
    if (.not. is_utf8(shown)) then
      do i = 1, len(shown)
        if (iachar(shown(i:i)) > 127) shown(i:i) = '?'
      end do
    end if
    shown = '"'//shown//'"'
  end function snippet

  !> Last character of the line on which `first` stands, without its line end.
  pure integer function end_of_line(text, first) result(last)
    character(len=*), intent(in) :: text
    integer, intent(in) :: first
    last = scan(text(first:), achar(10)//achar(13))
    last = merge(len(text), first + last - 2, last == 0)
  end function end_of_line

  !> No control characters but the tab, and UTF-8.
  pure logical function is_visible(word)
    character(len=*), intent(in) :: word
    is_visible = first_code(word) < 0
  end function is_visible

  !> Code of the first control character, or of the first byte of bad UTF-8; -1: none.
  pure integer function first_code(word) result(code)
    character(len=*), intent(in) :: word
    integer :: i
    do i = 1, len(word)
      code = ichar(word(i:i))
      if ((code < 32 .and. code /= 9) .or. code == 127) return
    end do
    code = -1
    if (is_utf8(word)) return
    do i = 1, len(word)
      code = ichar(word(i:i))
      if (code > 127) return
    end do
  end function first_code

  subroutine append(tokens, kind, first, last, line, quote)
    type(token_list_t), intent(inout) :: tokens
    integer, intent(in) :: kind, first, last, line
    integer, intent(in), optional :: quote
    type(token_t), allocatable :: grown(:)
    if (tokens%n == size(tokens%list)) then
      allocate (grown(2*tokens%n))
      grown(:tokens%n) = tokens%list
      call move_alloc(grown, tokens%list)
    end if
    tokens%n = tokens%n + 1
    tokens%list(tokens%n) = token_t(kind, first, last, line, 0)
    if (present(quote)) tokens%list(tokens%n)%quote = quote
  end subroutine append

end module castnet_namelist_tokens
