!> What this program is: version, commit, compiler, flags.
!>
!> The commit comes from the build (castnet_commit.c), or from the archive that git made
!> of a commit; otherwise it is not known, and says so.
module castnet_version
  use, intrinsic :: iso_c_binding, only: c_char, c_int
  use, intrinsic :: iso_fortran_env, only: compiler_version, compiler_options
  implicit none
  private
  public :: version_number, git_commit, compiler_name, compiler_flags, build_profile

  character(len=*), parameter :: version_number = '0.1.0'

  ! git archive puts the commit here (.gitattributes: export-subst).
  character(len=*), parameter :: archive_commit = '$Format:%H$'

  interface
    integer(c_int) function castnet_commit(text, room) bind(c, name='castnet_commit')
      import :: c_char, c_int
      character(kind=c_char), intent(out) :: text(*)
      integer(c_int), value :: room
    end function castnet_commit
  end interface

contains

  !> The commit this was built from, or 'unknown'.
  function git_commit() result(commit)
    character(len=:), allocatable :: commit
    character(kind=c_char) :: text(64)
    integer :: i, length
    length = castnet_commit(text, size(text))
    if (length > 0) then
      allocate (character(len=length) :: commit)
      do i = 1, length
        commit(i:i) = text(i)
      end do
    else if (archive_commit(1:1) /= '$') then
      commit = archive_commit
    else
      commit = 'unknown'
    end if
  end function git_commit

  function compiler_name() result(name)
    character(len=:), allocatable :: name
    name = compiler_version()
  end function compiler_name

  !> Flags that this was compiled with, each once, without paths and without the list of
  !> processor features that -march stands for.
  function compiler_flags() result(flags)
    character(len=:), allocatable :: flags, all, word
    integer :: blank
    all = compiler_options()//' '
    flags = ''
    do while (len(all) > 0)
      blank = index(all, ' ')
      word = all(:blank - 1)
      all = all(blank + 1:)
      if (word == '-I' .or. word == '-J' .or. word == '-o') all = all(index(all, ' ') + 1:)
      if (is_noise(word) .or. index(flags//' ', ' '//word//' ') > 0) cycle
      flags = flags//' '//word
    end do
    flags = trim(adjustl(flags))
  end function compiler_flags

  pure logical function is_noise(word)
    character(len=*), intent(in) :: word
    is_noise = len(word) == 0 .or. index(word, '-I') == 1 .or. index(word, '-J') == 1 .or. word == '-o' .or. &
               word == '-imultiarch' .or. index(word, '--param') == 1 .or. index(word, '-fpre-include') == 1 .or. &
               index(word, '-') /= 1 .or. &
               (index(word, '-m') == 1 .and. index(word, '-march=') /= 1 .and. index(word, '-mtune=') /= 1)
  end function is_noise

  !> 'release', 'check' or 'debug', by the flags.
  function build_profile() result(profile)
    character(len=:), allocatable :: profile, flags
    flags = compiler_options()
    if (index(flags, '-O3') > 0 .or. index(flags, '-O2') > 0) then
      profile = 'release'
    else if (index(flags, '-fcheck=all') > 0) then
      profile = 'check'
    else
      profile = 'debug'
    end if
  end function build_profile

end module castnet_version
