!> The group /VTKHDF of a run's file: net and target as transient PolyData that ParaView
!> 5.12+ and VTK 9.3+ open as they are.
!>
!> Points (float32) and the cables' tension are stored for every step; topology (int64)
!> is stored once, and every step's offsets point at it. The readers crash, rather than
!> complain, when a group of topology is missing though empty, or `NumberOfParts`, or
!> `ConnectivityIdOffsets`, or when an array of `Steps` is longer than `NSteps` says: so
!> all are here, and all grow together.
module castnet_vtkhdf_writer
  use castnet_kinds, only: wp, sp, i8
  use castnet_error, only: error_t
  use castnet_rotation, only: rotation_matrix, multiply
  use castnet_surface, only: surface_t
  use castnet_model, only: model_t
  use castnet_state, only: state_t
  use castnet_hdf5_file, only: hdf5_file_t, location_t, make_group, open_group, close_group, write_array, set_attribute, &
                               set_fixed_text, kind_double, kind_single, kind_long
  use castnet_hdf5_series, only: series_t, create_series, open_series, append_frames, hold_frames, write_held, truncate_series, &
                                 close_series, growth_bytes
  implicit none
  private
  public :: vtkhdf_writer_t, create_vtkhdf, reopen_vtkhdf, hold_vtkhdf_frame, write_vtkhdf, vtkhdf_growth, close_vtkhdf

  integer, parameter :: n_step_series = 6
  character(len=*), parameter :: step_series(n_step_series) = [character(len=21) :: 'Values', 'PartOffsets', &
    'NumberOfParts', 'PointOffsets', 'CellOffsets', 'ConnectivityIdOffsets']

  type :: vtkhdf_writer_t
    private
    integer :: n_node = 0, n_cable = 0, n_vertex = 0, n_triangle = 0
    type(location_t) :: steps
    type(series_t) :: points, tension, tension_offset
    type(series_t) :: step(n_step_series)       !! in the order of step_series
    real(sp), allocatable :: point(:)           !! scratch: one frame, x y z of each point
    real(sp), allocatable :: cell(:)            !! scratch: tension of lines, 0 for polygons
  end type vtkhdf_writer_t

contains

  !> Create the group with its topology and no step yet.
  subroutine create_vtkhdf(vtk, file, model, surface, error)
    type(vtkhdf_writer_t), intent(out) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface  !! of the target, body axes
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group, data, offsets
    integer :: i, width
    call measure(vtk, model, surface)
    call make_group(file, file%root, 'VTKHDF', group, error)
    call set_attribute(file, group%id, 'Version', [2_i8, 0_i8], error)
    call set_fixed_text(file, group%id, 'Type', 'PolyData', error)
    call write_array(file, group, 'NumberOfPoints', [int(vtk%n_node + vtk%n_vertex, i8)], '1', error)
    call create_series(file, group, 'Points', kind_single, [3], 'm', vtk%points, error, together=vtk%n_node + vtk%n_vertex)
    call write_topology(vtk, file, group, model, surface, error)
    call make_group(file, group, 'Steps', vtk%steps, error)
    call set_attribute(file, vtk%steps%id, 'NSteps', 0_i8, error)
    do i = 1, n_step_series
      width = merge(4, 1, i >= 5)
      if (width == 4) then
        call create_series(file, vtk%steps, trim(step_series(i)), kind_long, [4], '1', vtk%step(i), error)
      else if (i == 1) then
        call create_series(file, vtk%steps, trim(step_series(i)), kind_double, [integer ::], 's', vtk%step(i), error)
      else
        call create_series(file, vtk%steps, trim(step_series(i)), kind_long, [integer ::], '1', vtk%step(i), error)
      end if
    end do
    if (vtk%n_cable > 0) then
      call make_group(file, group, 'CellData', data, error)
      call create_series(file, data, 'tension', kind_single, [integer ::], 'N', vtk%tension, error, &
                         together=size(vtk%cell))
      call make_group(file, vtk%steps, 'CellDataOffsets', offsets, error)
      call create_series(file, offsets, 'tension', kind_long, [integer ::], '1', vtk%tension_offset, error)
      call close_group(file, offsets)
      call close_group(file, data)
    end if
    call close_group(file, group)
  end subroutine create_vtkhdf

  !> How many of everything, and scratch for one frame.
  subroutine measure(vtk, model, surface)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    if (allocated(model%net)) then
      vtk%n_node = model%net%n_node
      vtk%n_cable = model%net%n_cable
    end if
    if (present(surface)) then
      if (allocated(surface%vertex)) vtk%n_vertex = size(surface%vertex, 2)
      if (allocated(surface%triangle)) vtk%n_triangle = size(surface%triangle, 2)
    end if
    allocate (vtk%point(3*(vtk%n_node + vtk%n_vertex)), vtk%cell(vtk%n_cable + vtk%n_triangle))
    vtk%cell = 0.0_sp
  end subroutine measure

  !> The four groups of cells: only lines and polygons hold any.
  subroutine write_topology(vtk, file, group, model, surface, error)
    type(vtkhdf_writer_t), intent(in) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: group
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    type(error_t), allocatable, intent(inout) :: error
    integer :: none(2, 0)
    call write_cells(file, group, 'Vertices', none, error)
    if (vtk%n_cable > 0) then
      call write_cells(file, group, 'Lines', model%net%cable_nodes - 1, error)
    else
      call write_cells(file, group, 'Lines', none, error)
    end if
    if (vtk%n_triangle > 0) then
      call write_cells(file, group, 'Polygons', surface%triangle - 1 + vtk%n_node, error)
    else
      call write_cells(file, group, 'Polygons', none, error)
    end if
    call write_cells(file, group, 'Strips', none, error)
  end subroutine write_topology

  !> One group of cells of equal size, points counted from 0.
  subroutine write_cells(file, parent, name, corners, error)
    type(hdf5_file_t), intent(inout) :: file
    type(location_t), intent(in) :: parent
    character(len=*), intent(in) :: name
    integer, intent(in) :: corners(:, :)              !! (points of a cell, cells)
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group
    type(series_t) :: connectivity
    integer(i8), allocatable :: offset(:)
    integer :: i, n
    n = size(corners, 2)
    call make_group(file, parent, name, group, error)
    call write_array(file, group, 'NumberOfConnectivityIds', [size(corners, kind=i8)], '1', error)
    call write_array(file, group, 'NumberOfCells', [int(n, i8)], '1', error)
    offset = [(int(i, i8)*size(corners, 1), i=0, n)]
    call write_array(file, group, 'Offsets', offset, '1', error)
    ! A series, because HDF5 has no contiguous array without an element.
    call create_series(file, group, 'Connectivity', kind_long, [integer ::], '1', connectivity, error, &
                       together=max(1, size(corners)))
    call append_frames(file, connectivity, [int(corners, i8)], error)
    call close_series(file, connectivity)
    call close_group(file, group)
  end subroutine write_cells

  !> Go on with the group after a restart: keep the first `frames` steps.
  subroutine reopen_vtkhdf(vtk, file, model, surface, frames, error)
    type(vtkhdf_writer_t), intent(out) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    integer(i8), intent(in) :: frames
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: group, data, offsets
    integer :: i
    call measure(vtk, model, surface)
    call open_group(file, file%root, 'VTKHDF', group, error)
    call open_group(file, group, 'Steps', vtk%steps, error)
    call open_series(file, group, 'Points', kind_single, vtk%points, error)
    call truncate_series(file, vtk%points, frames*(vtk%n_node + vtk%n_vertex), error)
    do i = 1, n_step_series
      call open_series(file, vtk%steps, trim(step_series(i)), merge(kind_double, kind_long, i == 1), vtk%step(i), error)
      call truncate_series(file, vtk%step(i), frames, error)
    end do
    if (vtk%n_cable > 0) then
      call open_group(file, group, 'CellData', data, error)
      call open_series(file, data, 'tension', kind_single, vtk%tension, error)
      call truncate_series(file, vtk%tension, frames*size(vtk%cell), error)
      call open_group(file, vtk%steps, 'CellDataOffsets', offsets, error)
      call open_series(file, offsets, 'tension', kind_long, vtk%tension_offset, error)
      call truncate_series(file, vtk%tension_offset, frames, error)
      call close_group(file, offsets)
      call close_group(file, data)
    end if
    call set_attribute(file, vtk%steps%id, 'NSteps', frames, error)
    call close_group(file, group)
  end subroutine reopen_vtkhdf

  !> One step more, held in memory: net nodes first, then the target's vertices, turned and
  !> moved.
  subroutine hold_vtkhdf_frame(vtk, file, state, surface, cable_tension, error)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(state_t), intent(in) :: state
    type(surface_t), intent(in), optional :: surface
    real(wp), intent(in) :: cable_tension(:)          !! (n_cable) [N]
    type(error_t), allocatable, intent(inout) :: error
    integer(i8) :: frame, per_frame
    integer :: i
    real(wp) :: r(3, 3)
    frame = vtk%step(1)%length + vtk%step(1)%held
    do i = 1, vtk%n_node
      vtk%point(3*i - 2:3*i) = single(state%node_position(i, :))
    end do
    if (vtk%n_vertex > 0) r = rotation_matrix(state%target%attitude)
    do i = 1, vtk%n_vertex
      vtk%point(3*(vtk%n_node + i) - 2:3*(vtk%n_node + i)) = &
        single(state%target%position + multiply(r, surface%vertex(:, i)))
    end do
    per_frame = vtk%n_node + vtk%n_vertex
    call hold_frames(file, vtk%points, vtk%point, error)
    call hold_frames(file, vtk%step(1), [state%time], error)
    call hold_frames(file, vtk%step(2), [0_i8], error)
    call hold_frames(file, vtk%step(3), [1_i8], error)
    call hold_frames(file, vtk%step(4), [frame*per_frame], error)
    call hold_frames(file, vtk%step(5), [0_i8, 0_i8, 0_i8, 0_i8], error)
    call hold_frames(file, vtk%step(6), [0_i8, 0_i8, 0_i8, 0_i8], error)
    if (vtk%n_cable > 0) then
      vtk%cell(1:vtk%n_cable) = single(cable_tension(1:vtk%n_cable))
      call hold_frames(file, vtk%tension, vtk%cell, error)
      call hold_frames(file, vtk%tension_offset, [frame*size(vtk%cell)], error)
    end if
  end subroutine hold_vtkhdf_frame

  !> Write the steps that are held.
  subroutine write_vtkhdf(vtk, file, error)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer :: i
    if (vtk%step(1)%held == 0) return
    call write_held(file, vtk%points, error)
    do i = 1, n_step_series
      call write_held(file, vtk%step(i), error)
    end do
    call write_held(file, vtk%tension, error)
    call write_held(file, vtk%tension_offset, error)
    call set_attribute(file, vtk%steps%id, 'NSteps', vtk%step(1)%length, error)
  end subroutine write_vtkhdf

  !> Nearest single; what is out of range stays at its edge, so that nothing traps.
  elemental real(sp) function single(value)
    real(wp), intent(in) :: value
    single = real(max(-real(huge(1.0_sp), wp), min(real(huge(1.0_sp), wp), value)), sp)
  end function single

  !> Most bytes that so many more frames add to the file.
  integer(i8) function vtkhdf_growth(vtk, frames)
    type(vtkhdf_writer_t), intent(in) :: vtk
    integer(i8), intent(in) :: frames
    integer :: i
    vtkhdf_growth = growth_bytes(vtk%points, frames*(vtk%n_node + vtk%n_vertex))
    do i = 1, n_step_series
      vtkhdf_growth = vtkhdf_growth + growth_bytes(vtk%step(i), frames)
    end do
    if (vtk%n_cable > 0) vtkhdf_growth = vtkhdf_growth + growth_bytes(vtk%tension, frames*size(vtk%cell)) &
                                         + growth_bytes(vtk%tension_offset, frames)
  end function vtkhdf_growth

  subroutine close_vtkhdf(vtk, file)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    integer :: i
    call close_series(file, vtk%points)
    call close_series(file, vtk%tension)
    call close_series(file, vtk%tension_offset)
    do i = 1, n_step_series
      call close_series(file, vtk%step(i))
    end do
    call close_group(file, vtk%steps)
  end subroutine close_vtkhdf

end module castnet_vtkhdf_writer
