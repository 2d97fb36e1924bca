!> A zero of the six equations of friction where Newton's method finds none: a path of
!> simplices (Merrill 1972; Eaves and Saigal 1972), which ends at a zero of any continuous
!> function that points outwards far out, as this one does. Friction at a high coefficient
!> and nodes heavier than the body give it valleys that lead nowhere; a path of simplices
!> does not descend and is not misled by them.
!>
!> Space is cut into simplices of one size, in six dimensions and a seventh, the level. At
!> level 0 the vertices carry the artificial function y - centre, whose zero is known, at
!> level 1 the true one. From the simplex about the centre the path goes through the faces
!> on which the function, interpolated linearly, has a zero: each simplex has either no such
!> face or two, so that the path cannot branch or return, and it leaves level 0 for good
!> when it has reached level 1. Then the size is halved about the zero found.
!>
!> Coordinates are y = L^T delta, L L^T = H^-1 + sum m_i G_i^T G_i, in which the function is
!> much like the identity.
module castnet_friction_path
  use castnet_kinds, only: wp
  use castnet_contact_list, only: body_inertia_t
  use castnet_friction_problem, only: friction_problem_t, balance, stiffest
  implicit none
  private
  public :: friction_path_t, begin_path, refine_path

  integer, parameter :: first_pivots = 1000   !! simplices of the first path at most; eight times as many after a failure
  integer, parameter :: most_pivots = 64000
  !> Where the centre lies in its simplex: anywhere inside, but on no plane of symmetry.
  real(wp), parameter :: inside(6) = [0.871_wp, 0.693_wp, 0.562_wp, 0.438_wp, 0.297_wp, 0.139_wp]

  type :: friction_path_t
    real(wp) :: l(6, 6) = 0.0_wp       !! y = L^T delta
    real(wp) :: centre(6) = 0.0_wp     !! the zero as found so far, y
    real(wp) :: size = 0.0_wp          !! of the simplices
    real(wp) :: slope(6, 6) = 0.0_wp   !! derivative of the artificial function
    integer :: max_pivot = first_pivots
  end type friction_path_t

contains

  !> Start at no change of twist.
  pure subroutine begin_path(path, problem, body)
    type(friction_path_t), intent(out) :: path
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp) :: f(6), nothing(6)
    call factor(stiffest(problem, body), path%l)
    call reset_slope(path)
    nothing = 0.0_wp
    f = function_at(path, problem, body, nothing)
    path%size = sqrt(f(1)*f(1) + f(2)*f(2) + f(3)*f(3) + f(4)*f(4) + f(5)*f(5) + f(6)*f(6))
  end subroutine begin_path

  pure subroutine reset_slope(path)
    type(friction_path_t), intent(inout) :: path
    integer :: k
    path%slope = 0.0_wp
    do k = 1, 6
      path%slope(k, k) = 1.0_wp
    end do
  end subroutine reset_slope

  !> Follow a path from the centre to level 1, where `delta` is the zero of the interpolated
  !> function. The next simplices are half the size, or larger when the way was too long.
  pure subroutine refine_path(path, problem, body, delta, ok)
    type(friction_path_t), intent(inout) :: path
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(out) :: delta(6)
    logical, intent(out) :: ok
    real(wp) :: label(6, 8), weight(8), origin(6), y(6)
    integer :: base(7), order(7), enter, leave, pivot, k
    origin = path%centre - path%size*inside
    base = 0
    order = [1, 2, 3, 4, 5, 6, 7]
    do k = 1, 8
      label(:, k) = label_of(path, problem, body, origin, vertex(base, order, k))
    end do
    enter = 8
    ok = .false.
    do pivot = 1, path%max_pivot
      call leave_through(label, enter, weight, leave)
      if (leave == 0) exit
      ok = leave == 1 .and. order(1) == 7
      if (ok) exit
      ! Back to level 0: rounding has led astray.
      if (leave == 8 .and. order(7) == 7) exit
      call reflect(base, order, label, leave, enter)
      label(:, enter) = label_of(path, problem, body, origin, vertex(base, order, enter))
    end do
    delta = 0.0_wp
    if (ok) then
      y = 0.0_wp
      do k = 2, 8
        y = y + weight(k)*(origin + path%size*real(first_six(vertex(base, order, k)), wp))
      end do
      path%centre = y
      ! The next artificial function is this piece of the interpolated one.
      do k = 2, 7
        path%slope(:, order(k)) = (label(:, k + 1) - label(:, k))/path%size
      end do
      path%size = 0.5_wp*path%size
    else
      call reset_slope(path)
      path%size = 8.0_wp*path%size
      path%max_pivot = min(8*path%max_pivot, most_pivots)
    end if
    delta = back(path%l, path%centre)
  end subroutine refine_path

  pure function first_six(v) result(w)
    integer, intent(in) :: v(7)
    integer :: w(6)
    w = v(1:6)
  end function first_six

  !> Vertex k of the simplex: from the base one unit along each axis in turn.
  pure function vertex(base, order, k) result(v)
    integer, intent(in) :: base(7), order(7), k
    integer :: v(7), m
    v = base
    do m = 1, k - 1
      v(order(m)) = v(order(m)) + 1
    end do
  end function vertex

  !> The neighbour across the face opposite to vertex `leave`; `enter` is its new vertex,
  !> whose label is still to be set.
  pure subroutine reflect(base, order, label, leave, enter)
    integer, intent(inout) :: base(7), order(7)
    real(wp), intent(inout) :: label(6, 8)
    integer, intent(in) :: leave
    integer, intent(out) :: enter
    integer :: k, axis
    select case (leave)
    case (1)
      axis = order(1)
      base(axis) = base(axis) + 1
      order = [order(2), order(3), order(4), order(5), order(6), order(7), axis]
      do k = 1, 7
        label(:, k) = label(:, k + 1)
      end do
      enter = 8
    case (8)
      axis = order(7)
      base(axis) = base(axis) - 1
      order = [axis, order(1), order(2), order(3), order(4), order(5), order(6)]
      do k = 8, 2, -1
        label(:, k) = label(:, k - 1)
      end do
      enter = 1
    case default
      axis = order(leave)
      order(leave) = order(leave - 1)
      order(leave - 1) = axis
      enter = leave
    end select
  end subroutine reflect

  pure function label_of(path, problem, body, origin, v) result(f)
    type(friction_path_t), intent(in) :: path
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: origin(6)
    integer, intent(in) :: v(7)
    real(wp) :: f(6), y(6)
    integer :: k
    y = origin + path%size*real(v(1:6), wp)
    if (v(7) == 0) then
      f = 0.0_wp
      do k = 1, 6
        f = f + path%slope(:, k)*(y(k) - path%centre(k))
      end do
    else
      f = function_at(path, problem, body, y)
    end if
  end function label_of

  !> F in the coordinates y: L^-1 F(L^-T y).
  pure function function_at(path, problem, body, y) result(f)
    type(friction_path_t), intent(in) :: path
    type(friction_problem_t), intent(in) :: problem
    type(body_inertia_t), intent(in) :: body
    real(wp), intent(in) :: y(6)
    real(wp) :: f(6)
    integer :: i, k
    f = balance(problem, body, back(path%l, y))
    do i = 1, 6
      do k = 1, i - 1
        f(i) = f(i) - path%l(i, k)*f(k)
      end do
      f(i) = f(i)/path%l(i, i)
    end do
  end function function_at

  !> L^-T y.
  pure function back(l, y) result(x)
    real(wp), intent(in) :: l(6, 6), y(6)
    real(wp) :: x(6)
    integer :: i, k
    do i = 6, 1, -1
      x(i) = y(i)
      do k = i + 1, 6
        x(i) = x(i) - l(k, i)*x(k)
      end do
      x(i) = x(i)/l(i, i)
    end do
  end function back

  pure subroutine factor(a, l)
    real(wp), intent(in) :: a(6, 6)
    real(wp), intent(out) :: l(6, 6)
    real(wp) :: sum
    integer :: i, j, k
    l = 0.0_wp
    do j = 1, 6
      do i = j, 6
        sum = a(i, j)
        do k = 1, j - 1
          sum = sum - l(i, k)*l(j, k)
        end do
        if (i == j) then
          l(j, j) = sqrt(max(sum, epsilon(1.0_wp)*a(j, j)))
        else
          l(i, j) = sum/l(j, j)
        end if
      end do
    end do
  end subroutine factor

  !> The weights of the vertices at which the interpolated function vanishes on the face
  !> opposite to vertex `enter` are moved towards that vertex until another weight is zero:
  !> the vertex opposite to the face through which the path leaves. 0: there is none.
  pure subroutine leave_through(label, enter, weight, leave)
    real(wp), intent(in) :: label(6, 8)
    integer, intent(in) :: enter
    real(wp), intent(out) :: weight(8)
    integer, intent(out) :: leave
    real(wp) :: a(7, 9), row(9), factor, least, ratio
    integer :: place(7), i, k, c, pivot
    weight = 0.0_wp
    leave = 0
    c = 0
    do k = 1, 8
      if (k == enter) cycle
      c = c + 1
      place(c) = k
      a(1, c) = 1.0_wp
      a(2:7, c) = label(:, k)
    end do
    a(:, 8) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp]
    a(1, 9) = 1.0_wp
    a(2:7, 9) = label(:, enter)
    do i = 2, 7
      factor = maxval(abs(a(i, 1:7)))
      if (factor > 0.0_wp) a(i, :) = a(i, :)/factor
    end do
    do k = 1, 7
      pivot = k
      do i = k + 1, 7
        if (abs(a(i, k)) > abs(a(pivot, k))) pivot = i
      end do
      if (.not. abs(a(pivot, k)) > 0.0_wp) return
      row = a(k, :)
      a(k, :) = a(pivot, :)
      a(pivot, :) = row
      do i = 1, 7
        if (i == k) cycle
        factor = a(i, k)/a(k, k)
        do c = k + 1, 9
          a(i, c) = a(i, c) - factor*a(k, c)
        end do
      end do
    end do
    least = huge(1.0_wp)
    do i = 1, 7
      a(i, 8) = a(i, 8)/a(i, i)
      a(i, 9) = a(i, 9)/a(i, i)
      if (a(i, 9) <= 0.0_wp) cycle
      ratio = max(a(i, 8), 0.0_wp)/a(i, 9)
      if (ratio >= least) cycle
      least = ratio
      leave = place(i)
    end do
    if (leave == 0) return
    do i = 1, 7
      weight(place(i)) = a(i, 8) - least*a(i, 9)
    end do
    weight(leave) = 0.0_wp
    weight(enter) = least
  end subroutine leave_through

end module castnet_friction_path
