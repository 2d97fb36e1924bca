!> The version of the HDF5 library that is linked.
module castnet_hdf5_version
  use hdf5, only: h5get_libversion_f
  use castnet_hdf5_file, only: start_hdf5
  use castnet_text, only: to_text
  implicit none
  private
  public :: hdf5_version

contains

  function hdf5_version() result(version)
    character(len=:), allocatable :: version
    integer :: major, minor, release, status
    call start_hdf5()
    call h5get_libversion_f(major, minor, release, status)
    version = to_text(major)//'.'//to_text(minor)//'.'//to_text(release)
    if (status /= 0) version = 'unknown'
  end function hdf5_version

end module castnet_hdf5_version
