!> Contact systems and castnet's answers to them, as text for test/system/test_contact_solvers.py:
!>   contact_systems FILE
!> random ones, and those that a net meets which falls on a spinning box.
!>
!> A system: 'system' kind contacts friction restitution(used) residual converged; the
!> body's inverse mass and inverse inertia; then a line for each contact: its nodes, share,
!> their inverse masses, normal, arm, relative velocity before, normal and friction impulse.
program contact_systems
  use castnet_kinds, only: wp
  use castnet_error, only: error_t
  use castnet_contact_event, only: detect_contacts, body_inertia
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t
  use castnet_contact_response, only: contact_solver_t, resolve_contacts
  use castnet_integrator, only: rk4_step
  use castnet_model, only: model_t, contact_t, method_rk4
  use castnet_shape, only: new_shape
  use castnet_state, only: state_t
  use castnet_stepper, only: work_t, meet
  use contact_cases, only: random_t, uniform, random_contacts, random_cable_contacts, random_quaternion, random_direction, &
                           set_body
  use scenes, only: net_of, ready
  implicit none
  integer :: unit
  character(len=1024) :: file
  call get_command_argument(1, file)
  open (newunit=unit, file=trim(file), action='write', status='replace')
  call random_systems()
  call captured_systems(friction=0.0_wp, restitution=0.5_wp)
  call captured_systems(friction=0.3_wp, restitution=0.5_wp)
  call captured_systems(friction=1.0_wp, restitution=0.0_wp)
  close (unit)

contains

  subroutine random_systems()
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(random_t) :: random
    type(contact_t) :: contact
    real(wp) :: mass
    integer :: trial, n
    do trial = 1, 120
      n = 1 + int(30.0_wp*uniform(random))
      mass = 10.0_wp**(4.0_wp*uniform(random) - 3.0_wp)
      contact%detect_cables = mod(trial, 2) == 0
      if (contact%detect_cables) then
        call random_cable_contacts(random, n, n, mass, list, body)
      else
        call random_contacts(random, n, mass, 2.0_wp, list, body)
      end if
      contact%restitution = uniform(random)
      contact%friction = 0.0_wp
      if (mod(trial, 3) == 0) contact%friction = uniform(random)
      call answer('random', contact, body, list, solver)
    end do
  end subroutine random_systems

  !> 9 by 9 nodes and their cables onto a box half as wide; every tenth step with contacts.
  subroutine captured_systems(friction, restitution)
    real(wp), intent(in) :: friction, restitution
    integer, parameter :: side = 9
    real(wp), parameter :: pitch = 0.1_wp, h = 2.0e-4_wp
    type(model_t) :: model
    type(state_t) :: state
    type(work_t) :: work
    type(random_t) :: random
    type(contact_solver_t) :: solver
    type(error_t), allocatable :: error
    real(wp) :: position(side*side, 3), velocity(side*side, 3), r(3, 3), height
    integer :: nodes(2, 2*side*(side - 1)), i, k, c, step, met
    logical :: fixed(side*side)
    c = 0
    do i = 1, side
      do k = 1, side
        height = 0.3_wp + 0.01_wp*uniform(random)
        position((i - 1)*side + k, :) = [pitch*(i - 5), pitch*(k - 5), height]
        if (k < side) call join((i - 1)*side + k, (i - 1)*side + k + 1, c, nodes)
        if (i < side) call join((i - 1)*side + k, i*side + k, c, nodes)
      end do
    end do
    fixed = .false.
    velocity = spread([0.0_wp, 0.0_wp, -3.0_wp], 1, side*side)
    call net_of(spread(5.0e-3_wp, 1, side*side), fixed, nodes, spread(400.0_wp, 1, c), spread(pitch, 1, c), &
                spread(0.05_wp, 1, c), .true., position, velocity, model, state)
    model%net%is_bullet = spread(.false., 1, side*side)
    allocate (model%target, model%contact, state%target)
    call new_shape(model%target%shape, 'box', [0.4_wp, 0.3_wp, 0.2_wp], error)
    call set_body(model, 2.0_wp, [0.02_wp, 0.03_wp, 0.04_wp])
    state%target%attitude = random_quaternion(random)
    state%target%angular_velocity = 3.0_wp*random_direction(random)
    model%contact%threshold = 2.0e-3_wp
    model%contact%restitution = restitution
    model%contact%friction = friction
    model%contact%detect_cables = .true.
    call ready(model, state, work, method_rk4, h)
    met = 0
    do step = 1, 1500
      call rk4_step(model, state, work%flow, model%step)
      state%step = state%step + 1
      state%time = real(state%step, wp)*model%step
      call detect_contacts(model, state, work%contact, r)
      if (work%contact%list%n > 0) then
        met = met + 1
        if (mod(met, 10) == 0) call answer('captured', model%contact, body_inertia(model, r), work%contact%list, solver)
      end if
      call meet(model, state, work, error)
      if (allocated(error)) error stop
    end do
  end subroutine captured_systems

  pure subroutine join(a, b, c, nodes)
    integer, intent(in) :: a, b
    integer, intent(inout) :: c, nodes(:, :)
    c = c + 1
    nodes(:, c) = [a, b]
  end subroutine join

  subroutine answer(kind, contact, body, list, solver)
    character(len=*), intent(in) :: kind
    type(contact_t), intent(in) :: contact
    type(body_inertia_t), intent(in) :: body
    type(contact_list_t), intent(inout) :: list
    type(contact_solver_t), intent(inout) :: solver
    type(impulse_report_t) :: report
    integer :: i
    call resolve_contacts(contact, body, list, solver, report)
    write (unit, '(3a,i0,3(1x,es24.16),1x,i0)') 'system ', kind, ' ', list%n, contact%friction, report%restitution, &
      report%residual, merge(1, 0, report%converged)
    write (unit, '(10(1x,es24.16))') body%inverse_mass, body%inverse_inertia
    do i = 1, list%n
      write (unit, '(2(i0,1x),*(1x,es24.16))') list%node_a(i), list%node_b(i), list%share(i), list%inverse_mass_a(i), &
        list%inverse_mass_b(i), list%normal(i, :), list%arm(i, :), list%velocity(i, :), list%impulse(i), list%friction_impulse(i, :)
    end do
  end subroutine answer

end program contact_systems
