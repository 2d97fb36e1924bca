!> Numbers as text and back, spelling suggestions, durations, paths.
module test_text
  use castnet_kinds, only: wp, i8
  use castnet_text, only: to_text, rounded_text, lower, edit_distance, closest_word, word_at, word_count, is_one_of, parse_real, &
                          parse_integer, parse_logical, parse_duration, duration_text, byte_text, path_beside, &
                          name_of, without_extension, quoted, is_utf8, did_you_mean
  use testing, only: test_case, expect, expect_equal, expect_close
  implicit none
  private
  public :: run_test_text

contains

  subroutine run_test_text()
    call test_case('text: reals are written shortest and read back to the same bits', round_trip)
    call test_case('text: what is not a finite double is refused', bad_reals)
    call test_case('text: integers and logicals are read strictly', integers_and_logicals)
    call test_case('text: a misspelt word finds its neighbour', spelling)
    call test_case('text: durations and sizes', durations)
    call test_case('text: paths beside a scene', paths)
    call test_case('text: UTF-8 is recognised', utf8)
  end subroutine run_test_text

  subroutine round_trip()
    real(wp) :: value, back
    integer(i8) :: bits
    integer :: i
    character(len=:), allocatable :: problem, text
    call expect_equal(to_text(0.1_wp), '0.1', 'a tenth')
    call expect_equal(to_text(1440.0_wp), '1440', 'density')
    call expect_equal(to_text(4.456e8_wp), '4.456e8', 'modulus')
    call expect_equal(to_text(-5.0e-5_wp), '-5e-5', 'step')
    call expect_equal(to_text(0.0_wp), '0', 'zero')
    call expect_equal(to_text(-0.00125_wp), '-0.00125', 'small')
    call expect_equal(to_text(1.0_wp/3.0_wp), '0.3333333333333333', 'a third')
    call expect_equal(to_text(123456.5_wp), '123456.5', 'plain')
    call expect_equal(to_text(huge(1.0_wp)), '1.7976931348623157e308', 'largest')
    call expect_equal(to_text(-12_i8), '-12', 'integer')
    call expect_equal(to_text(.true.), '.true.', 'logical')
    call expect_equal(rounded_text(1.0_wp/3.0_wp, 3), '0.333', 'a third to three digits')
    call expect_equal(rounded_text(-99996.0_wp, 4), '-1e5', 'rounded up to the next power of ten')
    call expect_equal(rounded_text(4.9996e-5_wp, 4), '5e-5', 'digits that say nothing are left out')
    bits = 88172645463325252_i8
    do i = 1, 4000
      bits = ieor(bits, ishft(bits, 13))
      bits = ieor(bits, ishft(bits, -7))
      bits = ieor(bits, ishft(bits, 17))
      ! any sign and mantissa, exponents of normal numbers only
      value = transfer(ior(iand(bits, not(ishft(2047_i8, 52))), ishft(1_i8 + mod(abs(bits/7), 2046_i8), 52)), value)
      text = to_text(value)
      call parse_real(text, back, problem)
      if (allocated(problem) .or. back /= value .or. len(text) > 24) exit
    end do
    call expect(i == 4001, 'every double reads back to itself, seen '//text)
  end subroutine round_trip

  subroutine bad_reals()
    character(len=12), parameter :: bad(21) = [character(len=12) :: 'NaN', 'nan(1)', '+Inf', '-infinity', '1e999', '-1e309', &
      '1.8e308', '1e-999', '', '.', 'e5', '1e', '1e+', '1.2.3', '1,5', '--1', '1_wp', '0x10', '1+3', 'tough', '1e9999999999']
    character(len=10), parameter :: good(8) = [character(len=10) :: '1', '+1.', '.5', '-.5E+3', '1d-3', '0e99999', '007', '1.7e308']
    real(wp), parameter :: values(8) = [1.0_wp, 1.0_wp, 0.5_wp, -500.0_wp, 1.0e-3_wp, 0.0_wp, 7.0_wp, 1.7e308_wp]
    real(wp) :: value
    character(len=:), allocatable :: problem
    integer :: i
    do i = 1, size(bad)
      call parse_real(trim(bad(i)), value, problem)
      call expect(allocated(problem), bad(i)//' is refused')
    end do
    do i = 1, size(good)
      call parse_real(trim(good(i)), value, problem)
      call expect(.not. allocated(problem), good(i)//' is read')
      call expect_close(value, values(i), good(i))
    end do
  end subroutine bad_reals

  subroutine integers_and_logicals()
    integer(i8) :: value
    logical :: flag
    character(len=:), allocatable :: problem
    call parse_integer('-9223372036854775807', value, problem)
    call expect(.not. allocated(problem) .and. value == -huge(value), 'the smallest')
    call parse_integer('9223372036854775808', value, problem)
    call expect(allocated(problem), 'beyond 64 bits')
    call parse_integer('2.0', value, problem)
    call expect(allocated(problem), 'a real is no integer')
    call parse_integer('+', value, problem)
    call expect(allocated(problem), 'a sign is no integer')
    call parse_logical('.TRUE.', flag, problem)
    call expect(flag .and. .not. allocated(problem), '.TRUE.')
    call parse_logical('f', flag, problem)
    call expect(.not. flag .and. .not. allocated(problem), 'f')
    call parse_logical('tough', flag, problem)
    call expect(allocated(problem), 'tough is not true')
    call parse_logical('', flag, problem)
    call expect(allocated(problem), 'nothing is not a logical')
  end subroutine integers_and_logicals

  subroutine spelling()
    character(len=*), parameter :: keys = 'mesh_length cable_diameter density mass speed'
    call expect_equal(edit_distance('kitten', 'sitting'), 3, 'kitten, sitting')
    call expect_equal(edit_distance('', 'abc'), 3, 'empty')
    call expect_equal(edit_distance('mesh', 'mehs'), 1, 'swapped neighbours')
    call expect_equal(closest_word('Mesh_Lenght', keys), 'mesh_length', 'swap')
    call expect_equal(closest_word('cable', keys), 'cable_diameter', 'the start of a word')
    call expect_equal(closest_word('gravity', keys), '', 'nothing close')
    call expect_equal(did_you_mean('mas', keys), '; did you mean mass?', 'one letter')
    call expect_equal(word_count(keys), 5, 'five words')
    call expect_equal(word_at(keys, 3), 'density', 'the third')
    call expect_equal(word_at(keys, 6), '', 'beyond')
    call expect(is_one_of('speed', keys) .and. .not. is_one_of('spee', keys), 'membership')
    call expect_equal(lower('ÄBC-Z'), 'Äbc-z', 'ASCII only')
    call expect_equal(quoted('it''s'), '''it''''s''', 'quotes')
  end subroutine spelling

  subroutine durations()
    real(wp) :: seconds
    character(len=:), allocatable :: problem
    call parse_duration('01:30:05', seconds, problem)
    call expect_close(seconds, 5405.0_wp, 'HH:MM:SS')
    call parse_duration('100:00:00', seconds, problem)
    call expect_close(seconds, 360000.0_wp, 'more than 99 hours')
    call parse_duration('90', seconds, problem)
    call expect_close(seconds, 90.0_wp, 'seconds')
    call parse_duration('1:60:00', seconds, problem)
    call expect(allocated(problem), '60 minutes')
    call parse_duration('1:2:3:4', seconds, problem)
    call expect(allocated(problem), 'four parts')
    call parse_duration('-1:00', seconds, problem)
    call expect(allocated(problem), 'negative')
    call parse_duration('', seconds, problem)
    call expect(allocated(problem), 'nothing')
    call expect_equal(duration_text(3725.4_wp), '1:02:05', 'text')
    call expect_equal(byte_text(312.0_wp*1024**2), '312 MiB', 'bytes')
    call expect_equal(byte_text(1.5_wp*1024.0_wp**3), '1.5 GiB', 'bytes with a point')
  end subroutine durations

  subroutine paths()
    call expect_equal(path_beside('in/cubesat.nml', 'net.h5'), 'in/net.h5', 'beside')
    call expect_equal(path_beside('in/cubesat.nml', '/x/net.h5'), '/x/net.h5', 'absolute')
    call expect_equal(path_beside('cubesat.nml', 'net.h5'), 'net.h5', 'no folder')
    call expect_equal(name_of('a/b/c.nml'), 'c.nml', 'name')
    call expect_equal(without_extension('a.b/c.d.nml'), 'a.b/c.d', 'extension')
    call expect_equal(without_extension('a.b/.c'), 'a.b/.c', 'hidden file')
  end subroutine paths

  subroutine utf8()
    call expect(is_utf8('Envisat – Höhe 漢'), 'UTF-8')
    call expect(.not. is_utf8(achar(200)//'a'), 'Latin-1')
    call expect(.not. is_utf8(achar(192)//achar(128)), 'overlong')
    call expect(.not. is_utf8(achar(237)//achar(160)//achar(128)), 'surrogate')
    call expect(.not. is_utf8('a'//achar(226)//achar(128)), 'cut')
  end subroutine utf8

end module test_text
