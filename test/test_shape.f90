!> Shapes: distances, segments, mass properties.
module test_shape
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_shape, only: shape_t, new_shape, unit_inertia, shape_volume, tessellate
  use castnet_surface, only: surface_t, surface_volume, surface_inertia
  use castnet_constants, only: pi
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_shape

contains

  subroutine run_test_shape()
    call test_case('shape: mass properties of the rocket and the cubesat', mass_properties)
  end subroutine run_test_shape

  subroutine mass_properties()
    type(shape_t) :: shape
    type(error_t), allocatable :: error
    real(wp) :: inertia(3, 3)
    call new_shape(shape, 'cylinder', [3.9_wp, 11.047_wp, 0.0_wp], error)
    call expect(.not. allocated(error), 'a cylinder')
    inertia = 8226.0_wp*unit_inertia(shape)
    call expect_close(inertia(3, 3), 15640.0_wp, 'rocket, axial', atol=0.5_wp)
    call expect_close(inertia(1, 1), 91476.0_wp, 'rocket, transverse', atol=0.5_wp)
    call new_shape(shape, 'box', [0.1_wp, 0.1_wp, 0.3_wp], error)
    inertia = 3.5_wp*unit_inertia(shape)
    call expect_close(inertia(1, 1), 0.029167_wp, 'cubesat, transverse', atol=5.0e-7_wp)
    call expect_close(inertia(3, 3), 0.0058333_wp, 'cubesat, axial', atol=5.0e-8_wp)
  end subroutine mass_properties

end module test_shape
