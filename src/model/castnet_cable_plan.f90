!> The cables in the order and grouping in which the force kernel runs through them.
module castnet_cable_plan
  use castnet_kinds, only: wp
  implicit none
  private
  public :: cable_plan_t

  type :: cable_plan_t
    integer :: n_run = 0
  end type cable_plan_t

end module castnet_cable_plan
