!> The paper's contact against known answers: V9, V10, V11 of the validation page.
module verify_contact
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_model, only: model_t, contact_t
  use castnet_state, only: state_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t, reserve_contacts
  use castnet_contact_response, only: contact_solver_t, resolve_contacts
  use castnet_contact_event, only: contact_work_t, new_contact_work, handle_contacts
  use contact_cases, only: new_case, set_body, momentum, angular_momentum, kinetic_energy, random_t, &
                           random_direction, random_contacts
  use testing, only: test_case, expect, expect_close, note
  implicit none
  private
  public :: run_verify_contact

contains

  subroutine run_verify_contact()
    call test_case('contact: V9, one node on a spinning body', node_on_spinning_body)
    call test_case('contact: V10, two nodes on a rod, equality and complementarity', two_nodes_on_a_rod)
    call test_case('contact: V11, dense against reduced impulses', dense_against_reduced)
  end subroutine run_verify_contact

  !> e = 1: momentum, angular momentum and energy to rounding, v_r+ = -v_r-.
  subroutine node_on_spinning_body()
    type(model_t) :: model
    type(state_t) :: state
    type(contact_work_t) :: work
    type(error_t), allocatable :: error
    real(wp) :: p(3), l(3), energy, before, after, arm(3), surface(3), omega(3)
    call new_case(model, state, 1, [0.2_wp], 'box', [0.1_wp, 0.1_wp, 0.3_wp], 3.5_wp, 2.0e-3_wp)
    call set_body(model, 3.5_wp, [0.029167_wp, 0.029167_wp, 0.0058333_wp])
    call new_contact_work(work, model)
    state%target%position = [1.4_wp, 0.0_wp, 0.0_wp]
    state%target%velocity = [0.01_wp, -0.02_wp, 0.03_wp]
    state%target%angular_velocity = [1.5_wp, 0.4_wp, -0.7_wp]
    state%node_position(1, :) = [1.349_wp, 0.03_wp, 0.12_wp]
    state%node_velocity(1, :) = [1.8_wp, 0.3_wp, -0.2_wp]
    p = momentum(model, state)
    l = angular_momentum(model, state)
    energy = kinetic_energy(model, state)
    arm = state%node_position(1, :) - state%target%position
    before = approach()
    call handle_contacts(model, state, work, error)
    after = approach()
    call expect(before < -1.0_wp, 'the node approaches')
    call expect_close(after, -before, 'v_r+ = -v_r-', rtol=1.0e-14_wp)
    call expect_close(momentum(model, state), p, 'momentum', rtol=1.0e-15_wp)
    call expect_close(angular_momentum(model, state), l, 'angular momentum', rtol=1.0e-14_wp)
    call expect_close(kinetic_energy(model, state), energy, 'energy', rtol=1.0e-15_wp*4.0_wp)
  contains
    !> Relative velocity along the normal (-1,0,0) of the face that is hit.
    real(wp) function approach()
      omega = state%target%angular_velocity
      surface = state%target%velocity + [omega(2)*arm(3) - omega(3)*arm(2), omega(3)*arm(1) - omega(1)*arm(3), &
                                         omega(1)*arm(2) - omega(2)*arm(1)]
      approach = -(state%node_velocity(1, 1) - surface(1))
    end function approach
  end subroutine node_on_spinning_body

  !> Unit rod, I = 1/12, e = 1, contacts at +-a. M = [1 + 1 + 12 a^2, 1 - 12 a^2; ...]
  !> For a = 1/4: M = [2.75, 0.25; 0.25, 2.75], g = (2, 0.02).
  subroutine two_nodes_on_a_rod()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    real(wp) :: determinant, exact(2)
    integer :: i
    call reserve_contacts(list, 2)
    list%n = 2
    list%node_a(1:2) = [1, 2]
    list%node_b(1:2) = [1, 2]
    list%weight_a(1:2) = 1.0_wp
    list%inverse_mass_a(1:2) = 1.0_wp
    list%normal(1:2, :) = 0.0_wp
    list%normal(1:2, 2) = 1.0_wp
    list%arm(1, :) = [0.25_wp, 0.0_wp, 0.0_wp]
    list%arm(2, :) = [-0.25_wp, 0.0_wp, 0.0_wp]
    list%velocity(1:2, :) = 0.0_wp
    list%velocity(1:2, 2) = [-1.0_wp, -0.01_wp]
    list%normal_velocity(1:2) = list%velocity(1:2, 2)
    body%free = .true.
    body%mass = 1.0_wp
    body%inverse_mass = 1.0_wp
    do i = 1, 3
      body%inertia(i, i) = 1.0_wp/12.0_wp
      body%inverse_inertia(i, i) = 12.0_wp
    end do
    determinant = 2.75_wp**2 - 0.25_wp**2
    exact = [2.75_wp*2.0_wp - 0.25_wp*0.02_wp, 2.75_wp*0.02_wp - 0.25_wp*2.0_wp]/determinant
    do i = 1, 2
      contact%dense = i == 2
      contact%push_only = .false.
      call resolve_contacts(contact, body, list, solver, report)
      call expect_close(list%impulse(1:2), exact, 'equality', rtol=1.0e-14_wp)
      call expect_close(list%impulse(1:2), [0.732667_wp, -0.059333_wp], 'equality, as published', atol=5.0e-7_wp)
      contact%push_only = .true.
      call resolve_contacts(contact, body, list, solver, report)
      call expect_close(list%impulse(1:2), [2.0_wp/2.75_wp, 0.0_wp], 'complementarity', rtol=1.0e-14_wp)
      call expect_close(report%restitution, 1.0_wp, 'restitution stays', atol=0.0_wp)
    end do
  end subroutine two_nodes_on_a_rod

  !> Random contacts, targets of 1 kg and of 1 g against nodes of 1 g to 100 g.
  subroutine dense_against_reduced()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(contact_t) :: contact
    type(random_t) :: random
    integer, parameter :: sizes(5) = [1, 2, 6, 40, 400]
    real(wp), allocatable :: j(:)
    real(wp) :: worst, off
    integer :: i, k, light, push
    character(len=80) :: words
    worst = 0.0_wp
    do light = 0, 1
      do k = 1, 5
        do push = 0, 1
          do i = 1, merge(20, 1, sizes(k) < 100)
            call random_contacts(random, sizes(k), 0.01_wp, 2.0_wp, list, body)
            if (light == 1) then
              body%mass = body%mass*1.0e-3_wp
              body%inertia = body%inertia*1.0e-3_wp
              body%inverse_mass = body%inverse_mass*1.0e3_wp
              body%inverse_inertia = body%inverse_inertia*1.0e3_wp
            end if
            contact%push_only = push == 1
            contact%dense = .true.
            contact%restitution = 0.5_wp
            call resolve_contacts(contact, body, list, solver, report)
            allocate (j(list%n), source=list%impulse(1:list%n))
            contact%dense = .false.
            call resolve_contacts(contact, body, list, solver, report)
            off = maxval(abs(list%impulse(1:list%n) - j))/max(maxval(abs(j)), tiny(1.0_wp))
            worst = max(worst, off)
            call expect(off <= 1.0e-12_wp, 'dense and reduced impulses differ by more than 1e-12')
            deallocate (j)
          end do
        end do
      end do
    end do
    write (words, '(a,es9.2)') 'largest relative difference of impulses', worst
    call note(words)
  end subroutine dense_against_reduced

end module verify_contact
