!> The net file that a scene names, read once before the run is set up.
module castnet_scene_net
  use castnet_error, only: error_t
  use castnet_model_builder, only: file_net_t
  use castnet_net_file, only: read_net_file
  use castnet_scene, only: scene_t
  use castnet_text, only: path_beside
  implicit none
  private
  public :: load_scene_net

contains

  !> Read the net of a scene with net/kind = 'file'; otherwise `file_net` stays unallocated.
  !> Errors: those of `read_net_file`.
  subroutine load_scene_net(scene, file_net, error)
    type(scene_t), intent(in) :: scene
    type(file_net_t), allocatable, intent(out) :: file_net
    type(error_t), allocatable, intent(inout) :: error
    if (.not. allocated(scene%net)) return
    if (scene%net%kind /= 'file') return
    allocate (file_net)
    call read_net_file(path_beside(scene%path, trim(scene%net%file)), file_net%net, file_net%position, file_net%velocity, error)
    if (allocated(error)) deallocate (file_net)
  end subroutine load_scene_net

end module castnet_scene_net
