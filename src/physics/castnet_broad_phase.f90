!> Which nodes might touch the body, on two levels (Shan, Guo, Gill 2018, figure 4):
!> the net's box against the body's; then every node against the body's box in body
!> axes. What comes out are candidates in body axes, for the exact distance. How far the
!> nodes have come since then says for how long that stays true.
module castnet_broad_phase
  use castnet_kinds, only: wp
  implicit none
  private
  public :: net_box, box_gap, into_body_axes, farthest_and_fastest, parallel_nodes

  !> Nodes from which on a thread each is worth a parallel region: one pass costs about
  !> 1 ns a node, a region some microseconds when the machine is shared.
  integer, parameter :: parallel_nodes = 20000

contains

  !> Axis-parallel box of the first n nodes [m].
  pure subroutine net_box(n, n_pad, x, lower, upper)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: x(n_pad, 3)        !! node positions, inertial [m]
    real(wp), intent(out) :: lower(3), upper(3)
    real(wp) :: least, most
    integer :: c, i
    do c = 1, 3
      least = x(1, c)
      most = x(1, c)
      do i = 2, n
        least = min(least, x(i, c))
        most = max(most, x(i, c))
      end do
      lower(c) = least
      upper(c) = most
    end do
  end subroutine net_box

  !> How far the net's box lies from the box about that ball, along the worst axis [m].
  pure real(wp) function box_gap(lower, upper, centre, radius)
    real(wp), intent(in) :: lower(3), upper(3), centre(3), radius
    box_gap = maxval(max(lower - centre, centre - upper)) - radius
  end function box_gap

  !> How far has any node come against the body's centre since `reference` was taken, and how
  !> fast is the fastest against it? One pass, the one that every step near the body pays.
  subroutine farthest_and_fastest(n, n_pad, x, v, centre, velocity, reference, move, top)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3), centre(3), velocity(3) !! inertial [m], [m/s]
    real(wp), intent(in) :: reference(n_pad, 3)  !! x - centre then [m]
    real(wp), intent(out) :: move                !! [m]
    real(wp), intent(out) :: top                 !! square of the speed [m2/s2]
    real(wp) :: most, fast
    integer, parameter :: chunk = 4096
    integer :: first
    most = 0.0_wp
    fast = 0.0_wp
    if (n < parallel_nodes) then
      call survey(1, n, n_pad, x, v, centre, velocity, reference, most, fast)
    else
      !$omp parallel do default(none) schedule(static) private(first) reduction(max: most, fast) &
      !$omp shared(n, n_pad, x, v, centre, velocity, reference)
      do first = 1, n, chunk
        call survey(first, min(n, first + chunk - 1), n_pad, x, v, centre, velocity, reference, most, fast)
      end do
      !$omp end parallel do
    end if
    move = sqrt(most)
    top = fast
  end subroutine farthest_and_fastest

  pure subroutine survey(first, last, n_pad, x, v, centre, velocity, reference, most, fast)
    integer, intent(in) :: first, last, n_pad
    real(wp), intent(in) :: x(n_pad, 3), v(n_pad, 3), centre(3), velocity(3), reference(n_pad, 3)
    real(wp), intent(inout) :: most, fast
    real(wp) :: dx, dy, dz
    integer :: i
    do i = first, last
      dx = (x(i, 1) - centre(1)) - reference(i, 1)
      dy = (x(i, 2) - centre(2)) - reference(i, 2)
      dz = (x(i, 3) - centre(3)) - reference(i, 3)
      most = max(most, dx*dx + dy*dy + dz*dz)
      fast = max(fast, (v(i, 1) - velocity(1))**2 + (v(i, 2) - velocity(2))**2 + (v(i, 3) - velocity(3))**2)
    end do
  end subroutine survey

  !> Node positions in body axes, y = R^T (x - centre), and how far outside of the box
  !> |y - middle| <= half each one is, along the worst axis (negative: inside).
  subroutine into_body_axes(n, n_pad, x, centre, r, middle, half, y, outside)
    integer, intent(in) :: n, n_pad
    real(wp), intent(in) :: x(n_pad, 3), centre(3), r(3, 3) !! inertial [m], body to inertial
    real(wp), intent(in) :: middle(3), half(3)              !! the body's box, body axes [m]
    real(wp), intent(inout) :: y(n_pad, 3), outside(n_pad)  !! [m]
    integer, parameter :: chunk = 4096
    integer :: first
    if (n < parallel_nodes) then
      call turn_nodes(1, n, n_pad, x, centre, r, middle, half, y, outside)
    else
      !$omp parallel do default(none) schedule(static) private(first) &
      !$omp shared(n, n_pad, x, centre, r, middle, half, y, outside)
      do first = 1, n, chunk
        call turn_nodes(first, min(n, first + chunk - 1), n_pad, x, centre, r, middle, half, y, outside)
      end do
      !$omp end parallel do
    end if
  end subroutine into_body_axes

  pure subroutine turn_nodes(first, last, n_pad, x, centre, r, middle, half, y, outside)
    integer, intent(in) :: first, last, n_pad
    real(wp), intent(in) :: x(n_pad, 3), centre(3), r(3, 3), middle(3), half(3)
    real(wp), intent(inout) :: y(n_pad, 3), outside(n_pad)
    real(wp) :: dx, dy, dz, u, v, w
    integer :: i
    do i = first, last
      dx = x(i, 1) - centre(1)
      dy = x(i, 2) - centre(2)
      dz = x(i, 3) - centre(3)
      u = r(1, 1)*dx + r(2, 1)*dy + r(3, 1)*dz
      v = r(1, 2)*dx + r(2, 2)*dy + r(3, 2)*dz
      w = r(1, 3)*dx + r(2, 3)*dy + r(3, 3)*dz
      y(i, 1) = u
      y(i, 2) = v
      y(i, 3) = w
      u = abs(u - middle(1)) - half(1)
      v = abs(v - middle(2)) - half(2)
      w = abs(w - middle(3)) - half(3)
      v = merge(u, v, u > v)
      outside(i) = merge(v, w, v > w)
    end do
  end subroutine turn_nodes

end module castnet_broad_phase
