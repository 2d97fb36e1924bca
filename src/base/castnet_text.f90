!> Small helpers for text: numbers to the shortest text that reads back to the same
!> bits and back again strictly, lower case, spelling suggestions, durations, paths.
module castnet_text
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_is_finite
  use castnet_kinds, only: wp, i8
  implicit none
  private
  public :: text_t
  public :: to_text, rounded_text, lower, edit_distance, closest_word, did_you_mean, word_at, word_count, is_one_of
  public :: parse_real, parse_integer, parse_logical, parse_duration, duration_text, byte_text
  public :: path_beside, folder_of, name_of, without_extension, quoted, is_utf8, replace_all

  !> One text of any length, for lists of them.
  type :: text_t
    character(len=:), allocatable :: chars
  end type text_t

  !> A value as text. Reals: the fewest digits that read back to the same bits.
  interface to_text
    module procedure real_to_text, integer_to_text, long_to_text, logical_to_text
  end interface to_text

contains

  !> The shortest decimal text that reads back to the same double. Plain notation
  !> for everyday sizes, otherwise d.ddde+x. NaN and infinities: 'NaN', 'Infinity', '-Infinity'.
  pure function real_to_text(value) result(text)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    character(len=8), parameter :: formats(3) = ['(es32.14', '(es32.15', '(es32.16']
    real(wp) :: back
    integer :: i, exponent
    if (ieee_is_nan(value)) then
      text = 'NaN'
      return
    else if (abs(value) < 1.0e4_wp) then
      ! Small whole numbers, most of a scene's: plain, and without writing and reading.
      if (.not. abs(value - anint(value)) > 0.0_wp .and. sign(1.0_wp, value) > 0.0_wp) then
        text = to_text(nint(value))
        return
      end if
    end if
    if (.not. ieee_is_finite(value)) then
      text = merge('-Infinity', ' Infinity', value < 0.0_wp)
      text = trim(adjustl(text))
      return
    end if
    do i = 1, size(formats)
      write (buffer, formats(i)//'e3)') value
      ! Rounding up to 15 digits may pass the largest double: such a text is no candidate.
      if (i < size(formats) .and. abs(value) > 1.7976931348623e308_wp) cycle
      read (buffer, *) back
      if (back == value) exit
    end do
    i = index(buffer, 'E')
    read (buffer(i + 1:), *) exponent
    text = plain_or_scientific(adjustl(buffer(:i - 1)), exponent)
  end function real_to_text

  !> Mantissa 'd.ddd' and decimal exponent as the friendlier of the two notations.
  pure function plain_or_scientific(mantissa, exponent) result(text)
    character(len=*), intent(in) :: mantissa
    integer, intent(in) :: exponent
    character(len=:), allocatable :: text
    character(len=:), allocatable :: digits, sign
    integer :: n
    digits = trim(mantissa)
    sign = ''
    if (digits(1:1) == '-') then
      sign = '-'
      digits = digits(2:)
    end if
    digits = digits(1:1)//digits(3:)
    n = max(1, verify(digits, '0', back=.true.))
    digits = digits(:n)
    if (digits == '0') then
      text = sign//'0'
    else if (exponent >= n - 1 .and. exponent <= 6 .and. exponent - n < 4) then
      text = sign//digits//repeat('0', exponent - n + 1)
    else if (exponent >= 0 .and. exponent <= 6 .and. n > exponent + 1) then
      text = sign//digits(:exponent + 1)//'.'//digits(exponent + 2:)
    else if (exponent < 0 .and. exponent >= -4) then
      text = sign//'0.'//repeat('0', -exponent - 1)//digits
    else
      if (n > 1) digits = digits(1:1)//'.'//digits(2:)
      text = sign//digits//'e'//to_text(exponent)
    end if
  end function plain_or_scientific

  !> A real rounded to so many significant digits (1 to 17), as short as `to_text` has it.
  pure function rounded_text(value, digits) result(text)
    real(wp), intent(in) :: value
    integer, intent(in) :: digits
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    character(len=12) :: form
    real(wp) :: rounded
    write (form, '(a,i0,a)') '(es32.', digits - 1, 'e3)'
    write (buffer, form) value
    read (buffer, *) rounded
    text = to_text(rounded)
  end function rounded_text

  pure function integer_to_text(value) result(text)
    integer, intent(in) :: value
    character(len=:), allocatable :: text
    text = long_to_text(int(value, i8))
  end function integer_to_text

  pure function long_to_text(value) result(text)
    integer(i8), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=24) :: buffer
    write (buffer, '(i0)') value
    text = trim(buffer)
  end function long_to_text

  !> '.true.' or '.false.', as a scene wants it.
  pure function logical_to_text(value) result(text)
    logical, intent(in) :: value
    character(len=:), allocatable :: text
    text = trim(merge('.true. ', '.false.', value))
  end function logical_to_text

  !> ASCII upper case to lower case; other bytes (UTF-8) stay.
  pure function lower(text) result(small)
    character(len=*), intent(in) :: text
    character(len=len(text)) :: small
    integer :: i, code
    small = text
    do i = 1, len(text)
      code = iachar(text(i:i))
      if (code >= 65 .and. code <= 90) small(i:i) = achar(code + 32)
    end do
  end function lower

  !> Fewest insertions, deletions, replacements and swaps of neighbours from one
  !> word to the other (optimal string alignment).
  pure integer function edit_distance(a, b) result(distance)
    character(len=*), intent(in) :: a, b
    integer :: row(0:len(b), 0:2), i, j, cost
    row(:, 1) = [(j, j=0, len(b))]
    row(:, 0) = row(:, 1)
    do i = 1, len(a)
      row(:, 2) = row(:, 0)   ! two rows back
      row(:, 0) = row(:, 1)   ! the row before
      row(0, 1) = i
      do j = 1, len(b)
        cost = merge(0, 1, a(i:i) == b(j:j))
        row(j, 1) = min(row(j, 0) + 1, row(j - 1, 1) + 1, row(j - 1, 0) + cost)
        if (i > 1 .and. j > 1) then
          if (a(i:i) == b(j - 1:j - 1) .and. a(i - 1:i - 1) == b(j:j)) &
            row(j, 1) = min(row(j, 1), row(j - 2, 2) + 1)
        end if
      end do
    end do
    distance = row(len(b), 1)
  end function edit_distance

  !> The word of a blank-separated list that is close enough to be meant; '' if none.
  !> Close: at most a third of the letters differ, or one is the start of the other.
  pure function closest_word(word, list) result(best)
    character(len=*), intent(in) :: word, list
    character(len=:), allocatable :: best, candidate, typed
    integer :: i, distance, least
    best = ''
    typed = lower(trim(word))
    if (len(typed) == 0 .or. len(typed) > 64) return
    least = huge(least)
    do i = 1, word_count(list)
      candidate = word_at(list, i)
      distance = edit_distance(typed, candidate)
      if (len(typed) >= 3 .and. distance > 1) then
        if (index(candidate, typed) == 1 .or. index(typed, candidate) == 1) distance = 1
      end if
      if (3*distance > max(len(typed), len(candidate), 3)) cycle
      if (distance >= least) cycle
      least = distance
      best = candidate
    end do
  end function closest_word

  !> "; did you mean X?", or nothing when no word of the list is close.
  pure function did_you_mean(word, list) result(text)
    character(len=*), intent(in) :: word, list
    character(len=:), allocatable :: text
    text = closest_word(word, list)
    if (len(text) > 0) text = '; did you mean '//text//'?'
  end function did_you_mean

  !> Number of words in a blank-separated list.
  pure integer function word_count(list)
    character(len=*), intent(in) :: list
    integer :: i
    word_count = 0
    do i = 1, len(list)
      if (list(i:i) == ' ') cycle
      if (i == 1) then
        word_count = word_count + 1
      else if (list(i - 1:i - 1) == ' ') then
        word_count = word_count + 1
      end if
    end do
  end function word_count

  !> Word number n of a blank-separated list; '' beyond its end.
  pure function word_at(list, n) result(word)
    character(len=*), intent(in) :: list
    integer, intent(in) :: n
    character(len=:), allocatable :: word
    integer :: i, first, length
    word = ''
    first = 1
    do i = 1, n
      length = verify(list(first:), ' ')
      if (length == 0) return
      first = first + length - 1
      length = scan(list(first:)//' ', ' ') - 1
      if (i == n) word = list(first:first + length - 1)
      first = first + length
      if (first > len(list)) exit
    end do
  end function word_at

  !> Is `word` one of the blank-separated words?
  pure logical function is_one_of(word, list)
    character(len=*), intent(in) :: word, list
    is_one_of = len_trim(word) > 0 .and. index(' '//list//' ', ' '//trim(word)//' ') > 0
  end function is_one_of

  !> A real from text, strictly: sign, digits with at most one point, exponent with
  !> e or d. `problem` says what is wrong; not allocated: fine. Never traps, never gives NaN or Inf.
  pure subroutine parse_real(text, value, problem)
    character(len=*), intent(in) :: text
    real(wp), intent(out) :: value
    character(len=:), allocatable, intent(out) :: problem
    character(len=:), allocatable :: number
    integer :: mantissa_end, exponent, leading, status
    value = 0.0_wp
    number = lower(trim(text))
    if (is_one_of(strip_sign(number), 'nan inf infinity') .or. index(strip_sign(number), 'nan(') == 1) then
      problem = 'must be finite'
      return
    end if
    call scan_real(number, mantissa_end, leading, exponent, status)
    if (status /= 0) then
      problem = 'is not a number'
      return
    end if
    if (leading == -huge(leading)) return         ! zero, whatever its exponent
    if (leading + exponent > 308) then
      problem = 'is larger than the largest double, 1.8e308'
    else if (leading + exponent == 308) then
      call read_huge(number(:mantissa_end), exponent, value, problem)
    else if (leading + exponent < -308) then
      problem = 'is smaller than the smallest normal double, 2.3e-308'
    else
      number = number(:mantissa_end)//'e'//to_text(exponent)
      read (number, *, iostat=status) value
      if (status /= 0) problem = 'is not a number'
    end if
  end subroutine parse_real

  !> A number whose leading digit stands at 1e308: scaled by ten to see whether it fits.
  pure subroutine read_huge(mantissa, exponent, value, problem)
    character(len=*), intent(in) :: mantissa
    integer, intent(in) :: exponent
    real(wp), intent(out) :: value
    character(len=:), allocatable, intent(inout) :: problem
    character(len=:), allocatable :: number
    integer :: status
    number = mantissa//'e'//to_text(exponent - 1)
    read (number, *, iostat=status) value
    if (abs(value) >= 1.7976931348623157e307_wp) then
      problem = 'is larger than the largest double, 1.8e308'
      value = 0.0_wp
    else
      number = mantissa//'e'//to_text(exponent)
      read (number, *, iostat=status) value
    end if
  end subroutine read_huge

  !> Grammar of a real. `leading`: decimal position of the first non-zero digit, -huge for zero.
  pure subroutine scan_real(number, mantissa_end, leading, exponent, status)
    character(len=*), intent(in) :: number
    integer, intent(out) :: mantissa_end, leading, exponent, status
    integer :: i, point, digits, n
    character(len=:), allocatable :: problem
    integer(i8) :: long
    status = 1
    exponent = 0
    leading = -huge(leading)
    mantissa_end = 0
    n = len(number)
    i = 1
    if (n == 0) return
    if (scan(number(1:1), '+-') == 1) i = 2
    point = 0
    digits = 0
    do while (i <= n)
      if (number(i:i) == '.') then
        if (point > 0) return
        point = i
      else if (is_digit(number(i:i))) then
        digits = digits + 1
        if (leading == -huge(leading) .and. number(i:i) /= '0') leading = i
      else
        exit
      end if
      i = i + 1
    end do
    if (digits == 0) return
    mantissa_end = i - 1
    if (point == 0) point = i
    if (leading /= -huge(leading)) leading = merge(point - leading - 1, point - leading, leading < point)
    if (i <= n) then
      if (scan(number(i:i), 'ed') == 0 .or. i == n) return
      call parse_integer(number(i + 1:), long, problem)
      if (allocated(problem)) then
        if (problem == 'is not a whole number') return
        long = merge(-1000000_i8, 1000000_i8, number(i + 1:i + 1) == '-')
      end if
      exponent = int(max(-1000000_i8, min(1000000_i8, long)))
    end if
    status = 0
  end subroutine scan_real

  !> A 64-bit integer from text, strictly: sign and digits.
  pure subroutine parse_integer(text, value, problem)
    character(len=*), intent(in) :: text
    integer(i8), intent(out) :: value
    character(len=:), allocatable, intent(out) :: problem
    character(len=:), allocatable :: digits
    integer :: i
    integer(i8) :: sign, digit
    value = 0
    digits = strip_sign(trim(text))
    if (len(digits) == 0 .or. verify(digits, '0123456789') > 0) then
      problem = 'is not a whole number'
      return
    end if
    sign = merge(-1_i8, 1_i8, text(1:1) == '-')
    do i = 1, len(digits)
      digit = iachar(digits(i:i)) - iachar('0')
      if (value > (huge(value) - digit)/10) then
        problem = 'does not fit in 64 bits'
        value = 0
        return
      end if
      value = 10*value + digit
    end do
    value = sign*value
  end subroutine parse_integer

  !> A logical from text: .true. .false. .t. .f. true false t f, any case; nothing else.
  pure subroutine parse_logical(text, value, problem)
    character(len=*), intent(in) :: text
    logical, intent(out) :: value
    character(len=:), allocatable, intent(out) :: problem
    value = is_one_of(lower(text), '.true. true .t. t')
    if (.not. value .and. .not. is_one_of(lower(text), '.false. false .f. f')) problem = 'is not .true. or .false.'
  end subroutine parse_logical

  !> Seconds from 'HH:MM:SS' (or 'MM:SS', or plain seconds); hours may pass 99.
  pure subroutine parse_duration(text, seconds, problem)
    character(len=*), intent(in) :: text
    real(wp), intent(out) :: seconds
    character(len=:), allocatable, intent(out) :: problem
    character(len=:), allocatable :: rest, reason
    integer(i8) :: part, total
    integer :: colon, n
    rest = trim(adjustl(text))
    total = 0
    n = 0
    seconds = 0.0_wp
    do
      n = n + 1
      colon = scan(rest//':', ':')
      call parse_integer(rest(:colon - 1), part, reason)
      if (allocated(reason) .or. part < 0 .or. part > 1000000000_i8 .or. n > 3 .or. (n > 1 .and. part > 59)) then
        problem = 'is not a duration HH:MM:SS'
        return
      end if
      if (scan(rest(:1), '+-') > 0) problem = 'is not a duration HH:MM:SS'
      total = 60*total + part
      if (colon > len(rest)) exit
      rest = rest(colon + 1:)
    end do
    seconds = real(total, wp)
  end subroutine parse_duration

  !> Seconds as 'H:MM:SS', for progress lines; rounded to the second.
  pure function duration_text(seconds) result(text)
    real(wp), intent(in) :: seconds
    character(len=:), allocatable :: text
    character(len=32) :: buffer
    integer(i8) :: total
    if (.not. abs(seconds) < 1.0e15_wp) then
      text = '?'
      return
    end if
    total = nint(max(0.0_wp, seconds), i8)
    write (buffer, '(i0,a,i2.2,a,i2.2)') total/3600, ':', mod(total/60, 60_i8), ':', mod(total, 60_i8)
    text = trim(buffer)
  end function duration_text

  !> Bytes as '312 MiB' or '1.4 GiB'.
  pure function byte_text(bytes) result(text)
    real(wp), intent(in) :: bytes
    character(len=:), allocatable :: text
    character(len=3), parameter :: units(7) = ['B  ', 'KiB', 'MiB', 'GiB', 'TiB', 'PiB', 'EiB']
    character(len=16) :: buffer
    real(wp) :: value
    integer :: i
    value = bytes
    do i = 1, size(units) - 1
      if (value < 1024.0_wp) exit
      value = value/1024.0_wp
    end do
    if (value < 9.95_wp .and. i > 1) then
      write (buffer, '(f3.1)') value
    else
      write (buffer, '(i0)') nint(min(value, 1.0e15_wp), i8)
    end if
    text = trim(buffer)//' '//trim(units(i))
  end function byte_text

  !> `path` as seen from the folder of `anchor`: what a scene says about a file is
  !> meant relative to the scene. Absolute paths stay.
  pure function path_beside(anchor, path) result(full)
    character(len=*), intent(in) :: anchor, path
    character(len=:), allocatable :: full
    full = trim(path)
    if (len(full) == 0) return
    if (full(1:1) == '/') return
    full = folder_of(anchor)//full
  end function path_beside

  !> The folder of a path with its final '/'; '' when there is none.
  pure function folder_of(path) result(folder)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: folder
    folder = path(:index(path, '/', back=.true.))
  end function folder_of

  !> The last part of a path.
  pure function name_of(path) result(name)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: name
    name = trim(path(index(path, '/', back=.true.) + 1:))
  end function name_of

  !> A path without the extension of its last part; a leading point is no extension.
  pure function without_extension(path) result(stem)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: stem
    integer :: point, start
    stem = trim(path)
    start = index(stem, '/', back=.true.)
    point = index(stem, '.', back=.true.)
    if (point > start + 1) stem = stem(:point - 1)
  end function without_extension

  !> Text in single quotes as a namelist wants it: quotes inside are doubled.
  pure function quoted(text) result(literal)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: literal
    literal = ''''//replace_all(text, '''', '''''')//''''
  end function quoted

  !> Every occurrence of `old` replaced by `new`.
  pure function replace_all(text, old, new) result(changed)
    character(len=*), intent(in) :: text, old, new
    character(len=:), allocatable :: changed
    integer :: first, found, n
    n = 0
    first = 1
    do                      ! how many
      found = index(text(first:), old)
      if (found == 0) exit
      n = n + 1
      first = first + found - 1 + len(old)
    end do
    allocate (character(len=len(text) + n*(len(new) - len(old))) :: changed)
    n = 0
    first = 1
    do
      found = index(text(first:), old)
      if (found == 0) exit
      changed(n + 1:n + found - 1) = text(first:first + found - 2)
      n = n + found - 1
      changed(n + 1:n + len(new)) = new
      n = n + len(new)
      first = first + found - 1 + len(old)
    end do
    changed(n + 1:) = text(first:)
  end function replace_all

  !> Is the text well-formed UTF-8 (no overlong forms, no surrogates)?
  pure logical function is_utf8(text)
    character(len=*), intent(in) :: text
    integer :: i, k, code, tail, low
    is_utf8 = .false.
    i = 1
    do while (i <= len(text))
      code = ichar(text(i:i))
      low = 128
      select case (code)
      case (0:127)
        tail = 0
      case (194:223)
        tail = 1
      case (224:239)
        tail = 2
        if (code == 224) low = 160
      case (240:244)
        tail = 3
        if (code == 240) low = 144
      case default
        return
      end select
      if (i + tail > len(text)) return
      do k = 1, tail
        if (ichar(text(i + k:i + k)) < merge(low, 128, k == 1) .or. ichar(text(i + k:i + k)) > 191) return
      end do
      if (code == 237 .and. tail == 2) then
        if (ichar(text(i + 1:i + 1)) > 159) return
      else if (code == 244) then
        if (ichar(text(i + 1:i + 1)) > 143) return
      end if
      i = i + tail + 1
    end do
    is_utf8 = .true.
  end function is_utf8

  pure logical function is_digit(letter)
    character(len=1), intent(in) :: letter
    is_digit = letter >= '0' .and. letter <= '9'
  end function is_digit

  pure function strip_sign(text) result(rest)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: rest
    rest = text
    if (len(rest) == 0) return
    if (rest(1:1) == '+' .or. rest(1:1) == '-') rest = rest(2:)
  end function strip_sign

end module castnet_text
