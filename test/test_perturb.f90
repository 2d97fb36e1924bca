!> &perturb: drawn once, in a fixed order, with the deviations asked for.
module test_perturb
  use castnet_kinds, only: wp, i8
  use castnet_constants, only: degree
  use castnet_model, only: model_t
  use castnet_perturb, only: perturbation_t, draw_perturbation, apply_perturbation
  use castnet_scene, only: perturb_group_t
  use castnet_state, only: state_t
  use testing, only: test_case, expect, expect_close
  implicit none
  private
  public :: run_test_perturb

contains

  subroutine run_test_perturb()
    call test_case('perturb: the same seed gives the same bits, another seed others', same_seed)
    call test_case('perturb: switching one deviation on leaves the others alone', independent)
    call test_case('perturb: the spread is the one asked for', spread)
    call test_case('perturb: fixed nodes stay, a fixed target does not turn', fixed_stays)
  end subroutine run_test_perturb

  pure function everything(seed) result(perturb)
    integer(i8), intent(in) :: seed
    type(perturb_group_t) :: perturb
    perturb = perturb_group_t(seed=seed, node_position=1.0e-3_wp, bullet_speed=0.1_wp, bullet_angle=2.0_wp, &
                              target_position=0.05_wp, target_rate=0.01_wp)
  end function everything

  subroutine same_seed()
    type(perturbation_t) :: a, b, c
    call draw_perturbation(everything(11_i8), 30, a)
    call draw_perturbation(everything(11_i8), 30, b)
    call draw_perturbation(everything(12_i8), 30, c)
    call expect(all(transfer(a%node_position, [0_i8]) == transfer(b%node_position, [0_i8])), 'nodes repeat')
    call expect(all(transfer(a%bullet_speed, [0_i8]) == transfer(b%bullet_speed, [0_i8])), 'bullets repeat')
    call expect(all(transfer(a%node_position, [0_i8]) /= transfer(c%node_position, [0_i8])), 'another seed differs')
  end subroutine same_seed

  subroutine independent()
    type(perturbation_t) :: a, b
    type(perturb_group_t) :: perturb
    perturb = everything(5_i8)
    call draw_perturbation(perturb, 30, a)
    perturb%bullet_speed = 0.0_wp
    perturb%target_rate = 0.0_wp
    call draw_perturbation(perturb, 40, b)
    call expect_close(b%bullet_speed, [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 'speed off', atol=0.0_wp)
    call expect_close(b%target_rate, [0.0_wp, 0.0_wp, 0.0_wp], 'rate off', atol=0.0_wp)
    call expect_close(b%bullet_angle, a%bullet_angle, 'angle', atol=0.0_wp)
    call expect_close(b%target_position, a%target_position, 'target', atol=0.0_wp)
    call expect_close(b%node_position(30, :), a%node_position(30, :), 'node 30 of a larger net', atol=0.0_wp)
  end subroutine independent

  !> 1000 throws: standard deviations within 5 standard errors, sigma/sqrt(2 n).
  subroutine spread()
    integer, parameter :: n = 1000, n_node = 10
    type(perturbation_t) :: drawn
    real(wp) :: square(5)
    integer :: i
    square = 0.0_wp
    do i = 1, n
      call draw_perturbation(everything(int(i, i8)), n_node, drawn)
      square(1) = square(1) + sum(drawn%node_position**2)/(3*n_node)
      square(2) = square(2) + sum(drawn%bullet_speed**2)/4
      square(3) = square(3) + sum(drawn%bullet_angle**2)/4
      square(4) = square(4) + sum(drawn%target_position**2)/3
      square(5) = square(5) + sum(drawn%target_rate**2)/3
    end do
    square = sqrt(square/n)
    call expect_close(square(1), 1.0e-3_wp, 'nodes', rtol=5.0_wp/sqrt(2.0_wp*n*3*n_node))
    call expect_close(square(2), 0.1_wp, 'speed', rtol=5.0_wp/sqrt(8.0_wp*n))
    call expect_close(square(3), 2.0_wp*degree, 'angle', rtol=5.0_wp/sqrt(8.0_wp*n))
    call expect_close(square(4), 0.05_wp, 'position', rtol=5.0_wp/sqrt(6.0_wp*n))
    call expect_close(square(5), 0.01_wp, 'rate', rtol=5.0_wp/sqrt(6.0_wp*n))
  end subroutine spread

  subroutine fixed_stays()
    type(model_t) :: model
    type(state_t) :: state
    type(perturbation_t) :: drawn
    allocate (model%net, model%target, state%target, state%node_position(8, 3))
    model%net%n_node = 2
    allocate (model%net%fixed(2))
    model%net%fixed = [.true., .false.]
    model%target%fixed = .true.
    state%node_position = 0.0_wp
    call draw_perturbation(everything(1_i8), 2, drawn)
    call apply_perturbation(drawn, model, state)
    call expect_close(state%node_position(1, :), [0.0_wp, 0.0_wp, 0.0_wp], 'fixed node', atol=0.0_wp)
    call expect_close(state%node_position(2, :), drawn%node_position(2, :), 'free node', atol=0.0_wp)
    call expect(all(state%node_position(3:, :) == 0.0_wp), 'padding stays zero')
    call expect_close(state%target%position, drawn%target_position, 'target moved', atol=0.0_wp)
    call expect_close(state%target%angular_velocity, [0.0_wp, 0.0_wp, 0.0_wp], 'and does not turn', atol=0.0_wp)
    model%target%fixed = .false.
    call apply_perturbation(drawn, model, state)
    call expect_close(state%target%angular_velocity, drawn%target_rate, 'a free one does', atol=0.0_wp)
  end subroutine fixed_stays

end module test_perturb
