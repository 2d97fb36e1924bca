!> The small unknowns of a throw, drawn once at its start from the scene's seed.
!>
!> Every deviate is drawn in a fixed order whether its standard deviation is zero or not,
!> and the nodes come last: switching one of them on, or changing the net, never changes
!> the others. The order: speed of bullets 1 to 4, angle of bullets 1 to 4, target position
!> x y z, target rate x y z, then x y z of node 1, of node 2, and so on.
module castnet_perturb
  use castnet_kinds, only: wp
  use castnet_constants, only: degree
  use castnet_model, only: model_t
  use castnet_rng, only: rng_t, seed_rng, normal
  use castnet_scene, only: perturb_group_t
  use castnet_state, only: state_t
  implicit none
  private
  public :: perturbation_t, draw_perturbation, apply_perturbation

  !> What is added to the nominal start. The builder adds the bullets' parts to the shot.
  type :: perturbation_t
    real(wp) :: bullet_speed(4) = 0.0_wp            !! [m/s]
    real(wp) :: bullet_angle(4) = 0.0_wp            !! [rad]
    real(wp) :: target_position(3) = 0.0_wp         !! inertial [m]
    real(wp) :: target_rate(3) = 0.0_wp             !! body axes [rad/s]
    real(wp), allocatable :: node_position(:, :)    !! (n_node,3) inertial [m]
  end type perturbation_t

contains

  !> Draw every deviate of one throw. Independent normal deviates times the group's
  !> standard deviations; the same seed and node count give the same bits everywhere.
  pure subroutine draw_perturbation(perturb, n_node, drawn)
    type(perturb_group_t), intent(in) :: perturb
    integer, intent(in) :: n_node                   !! 0 without a net
    type(perturbation_t), intent(out) :: drawn
    type(rng_t) :: rng
    integer :: i
    call seed_rng(rng, perturb%seed)
    call draw(rng, perturb%bullet_speed, drawn%bullet_speed)
    call draw(rng, perturb%bullet_angle*degree, drawn%bullet_angle)
    call draw(rng, perturb%target_position, drawn%target_position)
    call draw(rng, perturb%target_rate, drawn%target_rate)
    allocate (drawn%node_position(n_node, 3))
    do i = 1, n_node
      call draw(rng, perturb%node_position, drawn%node_position(i, :))
    end do
  end subroutine draw_perturbation

  !> Independent normal deviates of one standard deviation.
  pure subroutine draw(rng, deviation, values)
    type(rng_t), intent(inout) :: rng
    real(wp), intent(in) :: deviation
    real(wp), intent(out) :: values(:)
    real(wp) :: deviate
    integer :: i
    do i = 1, size(values)
      call normal(rng, deviate)
      values(i) = deviation*deviate
    end do
  end subroutine draw

  !> Move nodes and target of a built state. Fixed nodes stay where they are held; a fixed
  !> target may stand elsewhere, but it does not turn. Bullets' shots are the builder's.
  pure subroutine apply_perturbation(drawn, model, state)
    type(perturbation_t), intent(in) :: drawn
    type(model_t), intent(in) :: model
    type(state_t), intent(inout) :: state
    integer :: i, k
    if (allocated(model%net)) then
      do i = 1, model%net%n_node
        if (model%net%fixed(i)) cycle
        k = i
        if (allocated(model%net%original_node)) k = model%net%original_node(i)
        state%node_position(i, :) = state%node_position(i, :) + drawn%node_position(k, :)
      end do
    end if
    if (.not. allocated(model%target)) return
    state%target%position = state%target%position + drawn%target_position
    if (.not. model%target%fixed) state%target%angular_velocity = state%target%angular_velocity + drawn%target_rate
  end subroutine apply_perturbation

end module castnet_perturb
