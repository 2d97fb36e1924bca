!> Number kinds, in one place.
module castnet_kinds
  use, intrinsic :: iso_fortran_env, only: real32, real64, int32, int64
  implicit none
  private
  public :: wp, sp, i4, i8

  integer, parameter :: wp = real64  !! every physical quantity
  integer, parameter :: sp = real32  !! seeds of reciprocal roots, picture points
  integer, parameter :: i4 = int32
  integer, parameter :: i8 = int64   !! counters of steps, contacts, bytes

end module castnet_kinds
