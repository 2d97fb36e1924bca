!> Shapes in body axes.
module castnet_shape
  use castnet_kinds, only: wp
  implicit none
  private
  public :: shape_t

  type :: shape_t
    integer :: kind = 0
  end type shape_t

end module castnet_shape
