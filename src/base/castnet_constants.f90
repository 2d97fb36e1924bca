!> Mathematical constants and the tolerances that several modules share.
module castnet_constants
  use castnet_kinds, only: wp
  implicit none
  private
  public :: pi, degree, tiny_length

  real(wp), parameter :: pi = 3.14159265358979323846264338327950288_wp
  real(wp), parameter :: degree = pi/180.0_wp  !! one degree [rad]

  !> Shortest length that is divided by [m]: a cable whose ends coincide has no
  !> direction, and carries no tension, because any natural length is longer.
  real(wp), parameter :: tiny_length = 1.0e-30_wp

end module castnet_constants
