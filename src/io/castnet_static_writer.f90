!> The group /static of a run's file: what never changes. Indices count from 0.
module castnet_static_writer
  use castnet_kinds, only: i4
  use castnet_error, only: error_t
  use castnet_surface, only: surface_t
  use castnet_model, only: model_t
  use castnet_hdf5_file, only: hdf5_file_t, location_t, make_group, close_group, write_value, write_array, make_scale, &
                               attach_scales
  implicit none
  private
  public :: write_static

contains

  !> /static: the net's topology and material, the target's mass and surface.
  subroutine write_static(file, model, surface, error)
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface  !! of the target, body axes
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group
    call make_group(file, file%root, 'static', group, error)
    if (allocated(model%net)) call write_static_net(file, model, group, error)
    if (allocated(model%target)) call write_static_target(file, model, surface, group, error)
    call close_group(file, group)
  end subroutine write_static

  subroutine write_static_net(file, model, group, error)
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(location_t), intent(in) :: group
    type(error_t), allocatable, intent(inout) :: error
    associate (net => model%net)
      call write_array(file, group, 'node_mass', net%node_mass, 'kg', error)
      call attach_scales(file, group, 'node_mass', ['/node'], error)
      call write_array(file, group, 'fixed', merge(1_i4, 0_i4, net%fixed), '1', error)
      call attach_scales(file, group, 'fixed', ['/node'], error)
      if (net%n_cable > 0) then
        call dimension_of(file, group, 'end', 2, error)
        call write_array(file, group, 'cable_nodes', net%cable_nodes - 1, '1', error)
        call attach_scales(file, group, 'cable_nodes', [character(len=6) :: 'end', '/cable'], error)
        call write_array(file, group, 'natural_length', net%natural_length, 'm', error)
        call attach_scales(file, group, 'natural_length', ['/cable'], error)
        call write_array(file, group, 'axial_stiffness', net%axial_stiffness, 'N', error)
        call attach_scales(file, group, 'axial_stiffness', ['/cable'], error)
        call write_array(file, group, 'damping', net%damping, 'N s m-1', error)
        call attach_scales(file, group, 'damping', ['/cable'], error)
      end if
      if (allocated(net%bullet_nodes)) call write_nodes('bullet_nodes', 'bullet', net%bullet_nodes)
      if (allocated(net%perimeter_nodes)) call write_nodes('perimeter_nodes', 'perimeter', net%perimeter_nodes)
      if (allocated(net%corner_nodes)) call write_nodes('corner_nodes', 'net_corner', net%corner_nodes)
      if (allocated(net%faces)) then
        if (size(net%faces) > 0) then
          call dimension_of(file, group, 'face', size(net%faces, 2), error)
          call dimension_of(file, group, 'face_corner', 4, error)
          call write_array(file, group, 'faces', net%faces - 1, '1', error)
          call attach_scales(file, group, 'faces', [character(len=11) :: 'face_corner', 'face'], error)
        end if
      end if
    end associate

  contains

    !> A list of nodes along a dimension of its own.
    subroutine write_nodes(name, along, nodes)
      character(len=*), intent(in) :: name, along
      integer, intent(in) :: nodes(:)
      if (size(nodes) == 0) return
      call dimension_of(file, group, along, size(nodes), error)
      call write_array(file, group, name, nodes - 1, '1', error)
      call attach_scales(file, group, name, [along], error)
    end subroutine write_nodes

  end subroutine write_static_net

  subroutine write_static_target(file, model, surface, group, error)
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    type(location_t), intent(in) :: group
    type(error_t), allocatable, intent(inout) :: error
    associate (target => model%target)
      call write_value(file, group, 'target_mass', target%mass, 'kg', error)
      call write_value(file, group, 'target_fixed', merge(1_i4, 0_i4, target%fixed), '1', error)
      call dimension_of(file, group, 'column', 3, error)
      call write_array(file, group, 'target_inertia', target%inertia, 'kg m2', error)
      call attach_scales(file, group, 'target_inertia', [character(len=6) :: 'column', '/xyz'], error)
      if (.not. present(surface)) return
      if (.not. allocated(surface%vertex)) return
      call dimension_of(file, group, 'target_vertex', size(surface%vertex, 2), error)
      call write_array(file, group, 'target_vertices', surface%vertex, 'm', error)
      call attach_scales(file, group, 'target_vertices', [character(len=13) :: '/xyz', 'target_vertex'], error)
      if (size(surface%triangle) == 0) return
      call dimension_of(file, group, 'target_triangle', size(surface%triangle, 2), error)
      call dimension_of(file, group, 'triangle_corner', 3, error)
      call write_array(file, group, 'target_triangles', surface%triangle - 1, '1', error)
      call attach_scales(file, group, 'target_triangles', ['triangle_corner', 'target_triangle'], error)
    end associate
  end subroutine write_static_target

  !> A dimension scale that only counts: 0, 1, 2 ...
  subroutine dimension_of(file, group, name, n, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    character(len=*), intent(in) :: name
    integer, intent(in) :: n
    type(error_t), allocatable, intent(inout) :: error
    integer :: i
    call write_array(file, group, name, [(int(i, i4), i=0, n - 1)], '1', error)
    call make_scale(file, group, name, error)
  end subroutine dimension_of

end module castnet_static_writer
