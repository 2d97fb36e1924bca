!> The same bits whatever the number of threads, and in every run.
module test_threads
  use, intrinsic :: iso_fortran_env, only: int64
  use castnet_kinds, only: wp
  use castnet_model, only: model_t, method_rk4, method_midpoint
  use castnet_scene, only: scene_t
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t
  use scenes, only: cubesat_shot, shot, build, net_of, add_spinning_body, ready, fly, state_hash, random_numbers
  use testing, only: test_case, expect
  implicit none
  private
  public :: run_test_threads

contains

  subroutine run_test_threads()
    call test_case('threads: the same bits with 1, 2, 3, 4 and 8 threads', same_bits)
    call test_case('threads: a hash sees the last bit', hash_sees)
  end subroutine run_test_threads

  !> Nets of one chunk and of many, divided sides, a random graph with long and short
  !> offsets, gravity, a target beside; all taut in part, so that every branch counts.
  subroutine same_bits()
    integer, parameter :: threads(6) = [1, 2, 3, 4, 8, 8]
    character(len=12), parameter :: names(5) = ['cubesat     ', 'square      ', 'divided     ', 'graph       ', 'gravity     ']
    integer(int64) :: hash, first
    integer :: kind, method, i
    do kind = 1, size(names)
      do method = method_rk4, method_midpoint
        do i = 1, size(threads)
          hash = flown(kind, method, threads(i))
          if (i == 1) first = hash
          call expect(hash == first, trim(names(kind))//merge(', rk4     ', ', midpoint', method == method_rk4)// &
                      ': same bits with '//achar(iachar('0') + threads(i))//' threads')
        end do
      end do
    end do
  end subroutine same_bits

  integer(int64) function flown(kind, method, n_thread) result(hash)
    integer, intent(in) :: kind, method, n_thread
    type(scene_t) :: scene
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    real(wp), allocatable :: r(:)
    real(wp) :: inertia(3, 3)
    integer :: seed, n
    seed = 2024
    select case (kind)
    case (1)
      scene = cubesat_shot()
    case (3)
      scene = shot([18, 18], 0.07_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp)
      scene%net%cables_per_side = 2
    case default
      scene = shot([40, 33], 0.07_wp, 1.0e-3_wp, 3.0e-3_wp, 0.03_wp, 1.8_wp)
    end select
    if (kind == 4) then
      call random_graph(seed, model, state)
    else
      scene%net%stowed_scale = 1.0_wp
      call build(scene, model, state)
    end if
    if (kind == 5) then
      model%gravity = [0.1_wp, -9.0_wp, 0.3_wp]
      model%orbit_rate = 0.2_wp
      inertia = reshape([1.0_wp, 0.1_wp, 0.0_wp, 0.1_wp, 2.0_wp, 0.2_wp, 0.0_wp, 0.2_wp, 3.0_wp], [3, 3])
      call add_spinning_body(inertia, [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], [0.3_wp, 1.0_wp, -0.2_wp], model, state)
    end if
    n = model%net%n_node
    allocate (r(3*n))
    call random_numbers(seed, r)
    state%node_velocity(:n, :) = state%node_velocity(:n, :) + 2.0_wp*reshape(r, [n, 3])
    call ready(model, state, work, method, 2.0e-5_wp, n_thread)
    call fly(model, state, work, 25)
    call expect(state%ledger%dissipated > 0.0_wp, 'cables have been taut')
    hash = state_hash(state)
  end function flown

  !> 1500 nodes; runs along diagonals of several offsets, and strays.
  subroutine random_graph(seed, model, state)
    integer, intent(inout) :: seed
    type(model_t), intent(out) :: model
    type(state_t), intent(out) :: state
    integer, parameter :: n = 1500, runs = 4, strays = 300, m = runs*700 + strays
    integer, parameter :: offset(runs) = [1, 37, 400, 700]
    real(wp) :: r(4*m), x(n, 3), mass(n)
    integer :: cables(2, m), i, j, c
    call random_numbers(seed, r)
    c = 0
    do j = 1, runs
      do i = 1, 700
        c = c + 1
        cables(:, c) = [i + 10*j, i + 10*j + offset(j)]
      end do
    end do
    do i = 1, strays
      c = c + 1
      cables(1, c) = 1 + int(0.5_wp*(1.0_wp + r(i))*(n - 10))
      cables(2, c) = cables(1, c) + 1 + int(0.5_wp*(1.0_wp + r(m + i))*(n - cables(1, c) - 1))
    end do
    call random_numbers(seed, r)
    x = reshape(r(:3*n), [n, 3])
    mass = 1.5_wp + r(3*n + 1:4*n)
    call net_of(mass, [(modulo(i, 10) == 7, i=1, n)], cables, 50.0_wp*(1.1_wp + r(:m)), 0.6_wp + 0.5_wp*r(m + 1:2*m), &
                1.0_wp + r(2*m + 1:3*m), .true., x, 0.0_wp*x, model, state)
  end subroutine random_graph

  subroutine hash_sees()
    type(model_t) :: model
    type(state_t) :: state
    integer(int64) :: before
    call build(cubesat_shot(), model, state)
    before = state_hash(state)
    call expect(state_hash(state) == before, 'the same twice')
    state%node_velocity(77, 2) = nearest(1.0_wp, 1.0_wp)
    call expect(state_hash(state) /= before, 'another velocity')
    before = state_hash(state)
    state%node_velocity(77, 2) = nearest(state%node_velocity(77, 2), 1.0_wp)
    call expect(state_hash(state) /= before, 'by one bit')
  end subroutine hash_sees

end module test_threads
