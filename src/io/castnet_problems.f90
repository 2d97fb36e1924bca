!> Every problem of an input file, collected so that all are told in one go as
!> `file:line: group/key: what was seen, what is allowed`.
module castnet_problems
  use castnet_text, only: to_text
  implicit none
  private
  public :: problem_list_t

  integer, parameter :: most_reported = 200  !! more than anyone reads; the rest is counted
  integer, parameter :: most_told = 5000     !! then reading may stop: this is no scene

  type :: problem_t
    character(len=:), allocatable :: path
    integer :: line = 0
    character(len=:), allocatable :: text
  end type problem_t

  type :: problem_list_t
    integer :: n = 0
    integer, private :: told = 0        !! times that something was told, repetitions included
    type(problem_t), allocatable, private :: items(:)
  contains
    procedure :: add
    procedure :: is_full
    procedure :: report
    procedure :: clear
  end type problem_list_t

contains

  !> Add one problem. `line` 0: the whole file. `about` is 'group/key', or ''.
  !> The same words about the same place are added once.
  subroutine add(self, path, line, about, text)
    class(problem_list_t), intent(inout) :: self
    character(len=*), intent(in) :: path, about, text
    integer, intent(in) :: line
    type(problem_t), allocatable :: grown(:)
    type(problem_t) :: item
    integer :: i
    self%told = self%told + 1
    item%path = path
    item%line = line
    item%text = text
    if (len(about) > 0) item%text = about//': '//text
    if (.not. allocated(self%items)) allocate (self%items(16))
    do i = max(1, self%n - 20), self%n
      if (self%items(i)%line == line .and. self%items(i)%text == item%text .and. self%items(i)%path == path) return
    end do
    self%n = self%n + 1
    if (self%n > size(self%items)) then
      allocate (grown(2*size(self%items)))
      grown(:self%n - 1) = self%items(:self%n - 1)
      call move_alloc(grown, self%items)
    end if
    self%items(self%n) = item
  end subroutine add

  !> So many problems that nothing is gained by reading on.
  pure logical function is_full(self)
    class(problem_list_t), intent(in) :: self
    is_full = self%told >= most_told
  end function is_full

  !> All problems, one per line, by file in the order met and by line within a file.
  function report(self) result(text)
    class(problem_list_t), intent(in) :: self
    character(len=:), allocatable :: text
    integer, allocatable :: order(:)
    integer :: i, k, kept, moved
    text = ''
    kept = 0
    if (allocated(self%items)) kept = self%n
    allocate (order(kept))
    do i = 1, kept
      order(i) = i
      do k = i, 2, -1
        if (.not. comes_before(self, order(k), order(k - 1))) exit
        moved = order(k)
        order(k) = order(k - 1)
        order(k - 1) = moved
      end do
    end do
    do i = 1, min(kept, most_reported)
      if (i > 1) text = text//new_line('a')
      text = text//one_line(self%items(order(i)))
    end do
    if (self%n > most_reported) text = text//new_line('a')//'... and '//to_text(self%n - most_reported)// &
      trim(merge(' more, and reading stopped', ' more                     ', self%is_full()))
  end function report

  subroutine clear(self)
    class(problem_list_t), intent(inout) :: self
    self%n = 0
    self%told = 0
    if (allocated(self%items)) deallocate (self%items)
  end subroutine clear

  logical function comes_before(self, a, b)
    class(problem_list_t), intent(in) :: self
    integer, intent(in) :: a, b
    comes_before = self%items(a)%path == self%items(b)%path .and. self%items(a)%line < self%items(b)%line
  end function comes_before

  function one_line(item) result(text)
    type(problem_t), intent(in) :: item
    character(len=:), allocatable :: text
    text = item%path
    if (item%line > 0) text = text//':'//to_text(item%line)
    if (len(text) > 0) text = text//': '
    text = text//item%text
  end function one_line

end module castnet_problems
