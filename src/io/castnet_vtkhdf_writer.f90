!> The group /VTKHDF of a run's file: net and target as transient PolyData that ParaView
!> 5.12+ and VTK 9.3+ open as they are.
!>
!> Points (float32) and the cables' tension are stored for every step; topology (int64)
!> is stored once, and every step's offsets point at it. The readers crash, rather than
!> complain, when a group of topology is missing though empty, or `NumberOfParts`, or
!> `ConnectivityIdOffsets`, or when an array of `Steps` is longer or shorter than `NSteps`
!> says: so all are here, and all must grow at once, whenever the run is killed and whenever
!> the file is read.
!>
!> Eight things cannot be written at once, but one byte can. While the run goes on there are
!> two groups of steps, `Steps_1` and `Steps_2`, and `Steps` is a soft link to one of them.
!> The other is brought up to date, out of sight; then the link is turned to it, in a write
!> that comes after all others (castnet_safe_driver.c: the header of /VTKHDF was made before
!> what it holds). At the end the one that is shown becomes `Steps`, and the other goes.
module castnet_vtkhdf_writer
  use castnet_kinds, only: wp, sp, i8
  use castnet_error, only: error_t
  use castnet_rotation, only: rotation_matrix, multiply
  use castnet_surface, only: surface_t
  use castnet_model, only: model_t
  use castnet_state, only: state_t
  use castnet_hdf5_file, only: hdf5_file_t, location_t, make_group, open_group, close_group, has_entry, remove_entry, &
                               rename_entry, link_entry, name_again, write_array, set_attribute, set_fixed_text, kind_double, &
                               kind_single, kind_long
  use castnet_hdf5_series, only: series_t, create_series, open_series, append_frames, next_frames, write_held, truncate_series, &
                                 close_series, growth_bytes, frames_a_chunk
  implicit none
  private
  public :: vtkhdf_writer_t, create_vtkhdf, reopen_vtkhdf, hold_vtkhdf_frame, write_vtkhdf, vtkhdf_growth, close_vtkhdf

  !> Arrays of a group of steps; the last stands in CellDataOffsets. `CellOffsets` has a second
  !> name, ConnectivityIdOffsets: four zeros a step are all that either says.
  enum, bind(c)
    enumerator :: s_value = 1, s_part, s_parts, s_point, s_cell, s_tension
  end enum
  character(len=*), parameter :: step_series(s_cell) = [character(len=13) :: 'Values', 'PartOffsets', 'NumberOfParts', &
    'PointOffsets', 'CellOffsets']
  character(len=*), parameter :: shown_steps = 'Steps', steps_name(2) = ['Steps_1', 'Steps_2']
  integer, parameter :: most_entries = 12         !! of /VTKHDF

  type :: steps_t
    type(location_t) :: group
    type(series_t) :: series(s_tension)
  end type steps_t

  type :: vtkhdf_writer_t
    private
    integer :: n_node = 0, n_cable = 0, n_vertex = 0, n_triangle = 0
    type(location_t) :: group
    type(series_t) :: points, tension
    type(steps_t) :: steps(2)
    integer :: shown = 0                        !! which of the two `Steps` leads to
    real(wp), allocatable :: time(:)            !! of the last frames, from the first that one of the two lacks; room for more
    integer(i8) :: frames = 0                   !! so far, those in memory included
    integer(i8) :: before_time = 0              !! of these, before time(1)
    integer :: n_point = 0, n_cell = 0          !! net nodes and vertices; lines and polygons
  end type vtkhdf_writer_t

contains

  !> Create the group with its topology and no step yet.
  subroutine create_vtkhdf(vtk, file, model, surface, expected, error)
    type(vtkhdf_writer_t), intent(out) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface  !! of the target, body axes
    integer(i8), intent(in) :: expected               !! frames that will come, about
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: data
    call measure(vtk, model, surface)
    call make_group(file, file%root, 'VTKHDF', vtk%group, error, entries=most_entries)
    call set_attribute(file, vtk%group%id, 'Version', [2_i8, 0_i8], error)
    call set_fixed_text(file, vtk%group%id, 'Type', 'PolyData', error)
    call write_array(file, vtk%group, 'NumberOfPoints', [int(vtk%n_point, i8)], '1', error)
    call create_series(file, vtk%group, 'Points', kind_single, [3], 'm', vtk%points, error, &
                       together=vtk%n_point*frames_a_chunk(expected, 12_i8*vtk%n_point))
    call write_topology(vtk, file, vtk%group, model, surface, error)
    if (vtk%n_cable > 0) then
      call make_group(file, vtk%group, 'CellData', data, error)
      call create_series(file, data, 'tension', kind_single, [integer ::], 'N', vtk%tension, error, &
                         together=vtk%n_cell*frames_a_chunk(expected, 4_i8*vtk%n_cell))
      call close_group(file, data)
    end if
    call create_steps(vtk, file, error)
  end subroutine create_vtkhdf

  !> Both groups of steps, without any, and the link.
  subroutine create_steps(vtk, file, error)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    type(location_t) :: offsets
    integer :: copy, i
    do copy = 1, 2
      associate (steps => vtk%steps(copy))
        call make_group(file, vtk%group, steps_name(copy), steps%group, error)
        call set_attribute(file, steps%group%id, 'NSteps', 0_i8, error)
        call create_series(file, steps%group, trim(step_series(s_value)), kind_double, [integer ::], 's', &
                           steps%series(s_value), error)
        do i = s_part, s_point
          call create_series(file, steps%group, trim(step_series(i)), kind_long, [integer ::], '1', steps%series(i), error)
        end do
        call create_series(file, steps%group, trim(step_series(s_cell)), kind_long, [4], '1', steps%series(s_cell), error)
        call name_again(file, steps%group, trim(step_series(s_cell)), 'ConnectivityIdOffsets', error)
        if (vtk%n_cable > 0) then
          call make_group(file, steps%group, 'CellDataOffsets', offsets, error)
          call create_series(file, offsets, 'tension', kind_long, [integer ::], '1', steps%series(s_tension), error)
          call close_group(file, offsets)
        end if
      end associate
    end do
    allocate (vtk%time(64))
    call show_steps(vtk, file, 1, error)
  end subroutine create_steps

  !> Have `Steps` lead to one of the two groups. It stays the last entry, so that nothing else
  !> in the header of /VTKHDF moves.
  subroutine show_steps(vtk, file, copy, error)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    integer, intent(in) :: copy
    type(error_t), allocatable, intent(inout) :: error
    if (vtk%shown > 0) call remove_entry(file, vtk%group, shown_steps, error)
    call link_entry(file, vtk%group, steps_name(copy), shown_steps, error)
    vtk%shown = copy
  end subroutine show_steps

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
    vtk%n_point = vtk%n_node + vtk%n_vertex
    vtk%n_cell = vtk%n_cable + vtk%n_triangle
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

  !> Go on with the group after a restart: keep the first steps. What tells of them is made anew.
  subroutine reopen_vtkhdf(vtk, file, model, surface, time, error)
    type(vtkhdf_writer_t), intent(out) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(model_t), intent(in) :: model
    type(surface_t), intent(in), optional :: surface
    real(wp), intent(in) :: time(:)                   !! of the steps to keep [s]
    type(error_t), allocatable, intent(inout) :: error
    character(len=*), parameter :: old(3) = [character(len=7) :: shown_steps, steps_name]
    type(location_t) :: data
    integer(i8) :: frames
    integer :: i
    frames = size(time, kind=i8)
    call measure(vtk, model, surface)
    call open_group(file, file%root, 'VTKHDF', vtk%group, error)
    call open_series(file, vtk%group, 'Points', kind_single, vtk%points, error)
    call truncate_series(file, vtk%points, frames*vtk%n_point, error)
    if (vtk%n_cable > 0) then
      call open_group(file, vtk%group, 'CellData', data, error)
      call open_series(file, data, 'tension', kind_single, vtk%tension, error)
      call truncate_series(file, vtk%tension, frames*vtk%n_cell, error)
      call close_group(file, data)
    end if
    if (file%broken) return
    do i = 1, size(old)
      if (has_entry(vtk%group, trim(old(i)))) call remove_entry(file, vtk%group, trim(old(i)), error)
    end do
    call create_steps(vtk, file, error)
    if (file%broken) return
    vtk%time = [time, vtk%time]
    vtk%frames = frames
    call bring_up_to_date(vtk, file, vtk%shown, error)
  end subroutine reopen_vtkhdf

  !> One step more, held in memory: net nodes first, then the target's vertices, turned and
  !> moved.
  subroutine hold_vtkhdf_frame(vtk, file, state, surface, cable_tension, error)
    type(vtkhdf_writer_t), intent(inout), target :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(state_t), intent(in) :: state
    type(surface_t), intent(in), optional :: surface
    real(wp), intent(in) :: cable_tension(:)          !! (n_cable) [N]
    type(error_t), allocatable, intent(inout) :: error
    integer :: i, n
    real(wp) :: r(3, 3)
    real(sp), pointer, contiguous :: point(:), cell(:)  !! x y z of each point; tension of lines, 0 for polygons
    call next_frames(file, vtk%points, 3*vtk%n_point, point, error)
    if (.not. associated(point) .and. vtk%n_point > 0) return
    do i = 1, vtk%n_node
      point(3*i - 2) = single(state%node_position(i, 1))
      point(3*i - 1) = single(state%node_position(i, 2))
      point(3*i) = single(state%node_position(i, 3))
    end do
    if (vtk%n_vertex > 0) r = rotation_matrix(state%target%attitude)
    do i = vtk%n_node + 1, vtk%n_point
      point(3*i - 2:3*i) = single(state%target%position + multiply(r, surface%vertex(:, i - vtk%n_node)))
    end do
    if (vtk%n_cable > 0) then
      call next_frames(file, vtk%tension, vtk%n_cell, cell, error)
      if (.not. associated(cell)) return
      cell(:vtk%n_cable) = single(cable_tension(1:vtk%n_cable))
      cell(vtk%n_cable + 1:) = 0.0_sp
    end if
    n = int(vtk%frames - vtk%before_time) + 1
    if (n > size(vtk%time)) call make_room(vtk%time, 2*n)
    vtk%time(n) = state%time
    vtk%frames = vtk%frames + 1
  end subroutine hold_vtkhdf_frame

  subroutine make_room(values, n)
    real(wp), allocatable, intent(inout) :: values(:)
    integer, intent(in) :: n
    real(wp), allocatable :: larger(:)
    allocate (larger(n))
    larger(:size(values)) = values
    call move_alloc(larger, values)
  end subroutine make_room

  !> Write the steps that are held.
  subroutine write_vtkhdf(vtk, file, error)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable, intent(inout) :: error
    integer :: hidden, n_known
    if (steps_length(vtk, vtk%shown) == vtk%frames) return
    call write_held(file, vtk%points, error)
    call write_held(file, vtk%tension, error)
    hidden = 3 - vtk%shown
    call bring_up_to_date(vtk, file, hidden, error)
    call show_steps(vtk, file, hidden, error)
    ! Times that both hold are of no more use.
    n_known = int(minval([steps_length(vtk, 1), steps_length(vtk, 2)]) - vtk%before_time)
    if (n_known <= 0) return
    vtk%time(:size(vtk%time) - n_known) = vtk%time(n_known + 1:)
    vtk%before_time = vtk%before_time + n_known
  end subroutine write_vtkhdf

  pure integer(i8) function steps_length(vtk, copy)
    type(vtkhdf_writer_t), intent(in) :: vtk
    integer, intent(in) :: copy
    steps_length = vtk%steps(copy)%series(s_value)%length
  end function steps_length

  !> Append the steps that one of the groups lacks.
  subroutine bring_up_to_date(vtk, file, copy, error)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    integer, intent(in) :: copy
    type(error_t), allocatable, intent(inout) :: error
    integer(i8), allocatable :: frame(:), zero(:)
    integer(i8) :: first, i
    if (file%broken) return
    first = steps_length(vtk, copy)
    frame = [(i, i=first, vtk%frames - 1)]
    allocate (zero(4*size(frame)), source=0_i8)
    associate (series => vtk%steps(copy)%series)
      call append_frames(file, series(s_value), vtk%time(first - vtk%before_time + 1:vtk%frames - vtk%before_time), error)
      call append_frames(file, series(s_part), zero(:size(frame)), error)
      call append_frames(file, series(s_parts), 1 + zero(:size(frame)), error)
      call append_frames(file, series(s_point), frame*vtk%n_point, error)
      call append_frames(file, series(s_cell), zero, error)
      if (vtk%n_cable > 0) call append_frames(file, series(s_tension), frame*vtk%n_cell, error)
    end associate
    call set_attribute(file, vtk%steps(copy)%group%id, 'NSteps', vtk%frames, error)
  end subroutine bring_up_to_date

  !> Nearest single; what is out of range stays at its edge, so that nothing traps.
  elemental real(sp) function single(value)
    real(wp), intent(in) :: value
    single = real(max(-real(huge(1.0_sp), wp), min(real(huge(1.0_sp), wp), value)), sp)
  end function single

  !> Most bytes that so many more frames add to the file.
  integer(i8) function vtkhdf_growth(vtk, frames)
    type(vtkhdf_writer_t), intent(in) :: vtk
    integer(i8), intent(in) :: frames
    integer(i8) :: lacking
    integer :: copy, i
    vtkhdf_growth = growth_bytes(vtk%points, frames*vtk%n_point)
    if (vtk%n_cable > 0) vtkhdf_growth = vtkhdf_growth + growth_bytes(vtk%tension, frames*vtk%n_cell)
    do copy = 1, 2
      lacking = max(0_i8, steps_length(vtk, vtk%shown) - steps_length(vtk, copy))
      do i = 1, merge(s_tension, s_cell, vtk%n_cable > 0)
        vtkhdf_growth = vtkhdf_growth + growth_bytes(vtk%steps(copy)%series(i), frames + lacking)
      end do
    end do
  end function vtkhdf_growth

  !> The file holds plain `Steps` from here on.
  subroutine close_vtkhdf(vtk, file)
    type(vtkhdf_writer_t), intent(inout) :: vtk
    type(hdf5_file_t), intent(inout) :: file
    type(error_t), allocatable :: ignored       !! the file knows that it is broken, and closing tells
    integer :: copy, i
    call close_series(file, vtk%points)
    call close_series(file, vtk%tension)
    do copy = 1, 2
      do i = 1, s_tension
        call close_series(file, vtk%steps(copy)%series(i))
      end do
      call close_group(file, vtk%steps(copy)%group)
    end do
    if (vtk%shown > 0 .and. .not. file%broken) then
      call remove_entry(file, vtk%group, shown_steps, ignored)
      call remove_entry(file, vtk%group, steps_name(3 - vtk%shown), ignored)
      call rename_entry(file, vtk%group, steps_name(vtk%shown), shown_steps, ignored)
    end if
    call close_group(file, vtk%group)
  end subroutine close_vtkhdf

end module castnet_vtkhdf_writer
