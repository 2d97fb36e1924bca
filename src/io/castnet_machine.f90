!> What the machine offers.
module castnet_machine
  use castnet_kinds, only: wp
  implicit none
  private
  public :: memory_of_machine

  real(wp), parameter :: gibibyte = 1073741824.0_wp

contains

  !> Memory of the machine [bytes]; 64 GiB where it cannot be asked.
  function memory_of_machine() result(bytes)
    real(wp) :: bytes
    character(len=128) :: line
    real(wp) :: kibibytes
    integer :: unit, status
    bytes = 64.0_wp*gibibyte
    open (newunit=unit, file='/proc/meminfo', status='old', action='read', iostat=status)
    if (status /= 0) return
    do
      read (unit, '(a)', iostat=status) line
      if (status /= 0) exit
      if (line(:9) /= 'MemTotal:') cycle
      read (line(10:), *, iostat=status) kibibytes
      if (status == 0) bytes = 1024.0_wp*kibibytes
      exit
    end do
    close (unit)
  end function memory_of_machine

end module castnet_machine
