!> Groups and keys as one table of data: it drives reading, the effective text, the
!> reference, the template and overrides. Which keys there are: `castnet_scene_schema`.
module castnet_schema
  use castnet_kinds, only: wp, i8
  use castnet_scene, only: word_length, path_length
  use castnet_schema_entry, only: entry_t, kind_real, kind_integer, kind_logical, kind_word, kind_path, kind_words
  implicit none
  private
  public :: group_entry_t, schema_t

  !> One group: its words in the reference and what is seen of it while reading.
  type :: group_entry_t
    character(len=16) :: name = ''
    character(len=160) :: help = ''
    logical :: required = .false.
    logical :: repeats = .false.
    logical :: pending = .false.             !! not available yet
    logical :: present = .false.
    integer :: level = 0
    integer :: line = 0
    character(len=:), allocatable :: path
  end type group_entry_t

  type :: schema_t
    integer :: n = 0, n_group = 0
    type(entry_t), allocatable :: entries(:)        !! (n), may be longer
    type(group_entry_t), allocatable :: groups(:)   !! (n_group), may be longer
    integer :: label = 0                            !! number of a repeated group's instance, for messages
  contains
    procedure :: start
    procedure :: group
    procedure :: real_key, real_array, real_list, integer_key, integer_array, long_key, logical_key, word_key, path_key, &
                 word_list
    procedure :: find
    procedure :: find_group
    procedure :: keys_of
    procedure :: group_names
  end type schema_t

contains

  !> An empty table.
  subroutine start(self)
    class(schema_t), intent(inout) :: self
    self%n = 0
    self%n_group = 0
    allocate (self%entries(80), self%groups(12))
  end subroutine start

  !> The keys that follow belong to this group.
  subroutine group(self, name, help, required, repeats, pending)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: name, help
    logical, intent(in), optional :: required, repeats, pending
    self%n_group = self%n_group + 1
    associate (g => self%groups(self%n_group))
      g%name = name
      g%help = help
      if (present(required)) g%required = required
      if (present(repeats)) g%repeats = repeats
      if (present(pending)) g%pending = pending
    end associate
  end subroutine group

  !> A scalar real; `low` is allowed, `above` is not.
  subroutine real_key(self, key, place, unit, help, low, above, high, need, use, fallback, only_zero)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, unit, help
    real(wp), target, intent(inout) :: place
    real(wp), intent(in), optional :: low, above, high
    character(len=*), intent(in), optional :: need, use, fallback
    logical, intent(in), optional :: only_zero
    call new_entry(self, key, kind_real, unit, help, need, use, fallback)
    associate (e => self%entries(self%n))
      e%real_0 => place
      call set_range(e, low, above, high)
      if (present(only_zero)) e%only_zero = only_zero
    end associate
    call keep_initial(self%entries(self%n))
  end subroutine real_key

  !> Real components; `least` of them when fewer than all will do.
  subroutine real_array(self, key, place, unit, help, low, above, high, need, use, fallback, least)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, unit, help
    real(wp), target, intent(inout) :: place(:)
    real(wp), intent(in), optional :: low, above, high
    character(len=*), intent(in), optional :: need, use, fallback
    integer, intent(in), optional :: least
    call new_entry(self, key, kind_real, unit, help, need, use, fallback)
    associate (e => self%entries(self%n))
      e%real_1 => place
      e%count = size(place)
      e%least = e%count
      if (present(least)) e%least = least
      call set_range(e, low, above, high)
    end associate
    call keep_initial(self%entries(self%n))
  end subroutine real_array

  !> Reals of open number, kept in the entry: the owner copies them in and out.
  subroutine real_list(self, key, list, unit, help, low, above, high, need, use, fallback)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, unit, help
    real(wp), allocatable, intent(in) :: list(:)
    real(wp), intent(in), optional :: low, above, high
    character(len=*), intent(in), optional :: need, use, fallback
    call new_entry(self, key, kind_real, unit, help, need, use, fallback)
    associate (e => self%entries(self%n))
      e%count = 0
      if (allocated(list)) e%real_list = list
      call set_range(e, low, above, high)
    end associate
    call keep_initial(self%entries(self%n))
  end subroutine real_list

  subroutine integer_key(self, key, place, help, low, high, need, use, fallback)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, help
    integer, target, intent(inout) :: place
    integer, intent(in) :: low, high
    character(len=*), intent(in), optional :: need, use, fallback
    call new_entry(self, key, kind_integer, '', help, need, use, fallback)
    self%entries(self%n)%integer_0 => place
    call set_range(self%entries(self%n), low=real(low, wp), high=real(high, wp))
    call keep_initial(self%entries(self%n))
  end subroutine integer_key

  subroutine integer_array(self, key, place, help, low, high, need, use, fallback)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, help
    integer, target, intent(inout) :: place(:)
    integer, intent(in) :: low, high
    character(len=*), intent(in), optional :: need, use, fallback
    call new_entry(self, key, kind_integer, '', help, need, use, fallback)
    associate (e => self%entries(self%n))
      e%integer_1 => place
      e%count = size(place)
      e%least = e%count
      call set_range(e, low=real(low, wp), high=real(high, wp))
    end associate
    call keep_initial(self%entries(self%n))
  end subroutine integer_array

  !> A 64-bit whole number, from 0 on.
  subroutine long_key(self, key, place, help)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, help
    integer(i8), target, intent(inout) :: place
    call new_entry(self, key, kind_integer, '', help)
    self%entries(self%n)%long_0 => place
    call set_range(self%entries(self%n), low=0.0_wp)
    call keep_initial(self%entries(self%n))
  end subroutine long_key

  subroutine logical_key(self, key, place, help, use)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, help
    logical, target, intent(inout) :: place
    character(len=*), intent(in), optional :: use
    call new_entry(self, key, kind_logical, '', help, use=use)
    self%entries(self%n)%logical_0 => place
    call keep_initial(self%entries(self%n))
  end subroutine logical_key

  !> One of the blank-separated `words`.
  subroutine word_key(self, key, place, words, help, need, use, pending)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, words, help
    character(len=word_length), target, intent(inout) :: place
    character(len=*), intent(in), optional :: need, use, pending
    call new_entry(self, key, kind_word, '', help, need, use)
    associate (e => self%entries(self%n))
      e%word_0 => place
      e%words = words
      if (present(pending)) e%pending_words = pending
    end associate
    call keep_initial(self%entries(self%n))
  end subroutine word_key

  !> A path, or any other text (of a path's length): say what in `noun`.
  subroutine path_key(self, key, place, help, need, use, fallback, noun)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, help
    character(len=path_length), target, intent(inout) :: place
    character(len=*), intent(in), optional :: need, use, fallback, noun
    call new_entry(self, key, kind_path, '', help, need, use, fallback)
    self%entries(self%n)%path_0 => place
    if (present(noun)) self%entries(self%n)%noun = noun
    call keep_initial(self%entries(self%n))
  end subroutine path_key

  !> Short texts of open number (numbers, words or logicals as written), kept in the entry.
  subroutine word_list(self, key, list, help)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, help
    character(len=word_length), allocatable, intent(in) :: list(:)
    call new_entry(self, key, kind_words, '', help)
    self%entries(self%n)%count = 0
    if (allocated(list)) self%entries(self%n)%word_list = list
    call keep_initial(self%entries(self%n))
  end subroutine word_list

  subroutine new_entry(self, key, kind, unit, help, need, use, fallback)
    class(schema_t), intent(inout) :: self
    character(len=*), intent(in) :: key, unit, help
    integer, intent(in) :: kind
    character(len=*), intent(in), optional :: need, use, fallback
    self%n = self%n + 1
    associate (e => self%entries(self%n))
      e%group = self%groups(self%n_group)%name
      e%key = key
      e%kind = kind
      e%unit = unit
      e%help = help
      if (present(need)) e%need = need
      if (present(use)) e%use = use
      if (present(fallback)) e%fallback = fallback
    end associate
  end subroutine new_entry

  subroutine set_range(e, low, above, high)
    type(entry_t), intent(inout) :: e
    real(wp), intent(in), optional :: low, above, high
    if (present(low)) e%low = low
    if (present(high)) e%high = high
    if (present(above)) then
      e%low = above
      e%above = .true.
    end if
  end subroutine set_range

  !> What the place holds when the table is made: the default, if it is a fresh object.
  subroutine keep_initial(e)
    type(entry_t), intent(inout) :: e
    if (e%kind == kind_path) return
    if (e%count == 0) return
    e%initial = e%text()
  end subroutine keep_initial

  !> Index of a key in the table, 0 if there is none.
  integer function find(self, group_name, key)
    class(schema_t), intent(in) :: self
    character(len=*), intent(in) :: group_name, key
    do find = 1, self%n
      if (self%entries(find)%key == key .and. self%entries(find)%group == group_name) return
    end do
    find = 0
  end function find

  integer function find_group(self, name)
    class(schema_t), intent(in) :: self
    character(len=*), intent(in) :: name
    do find_group = 1, self%n_group
      if (self%groups(find_group)%name == name) return
    end do
    find_group = 0
  end function find_group

  !> The keys of a group, blank-separated.
  function keys_of(self, name) result(list)
    class(schema_t), intent(in) :: self
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: list
    integer :: i
    list = ''
    do i = 1, self%n
      if (self%entries(i)%group == name) list = list//trim(self%entries(i)%key)//' '
    end do
    list = trim(list)
  end function keys_of

  function group_names(self) result(list)
    class(schema_t), intent(in) :: self
    character(len=:), allocatable :: list
    integer :: i
    list = ''
    do i = 1, self%n_group
      list = list//trim(self%groups(i)%name)//' '
    end do
    list = trim(list)
  end function group_names

end module castnet_schema
