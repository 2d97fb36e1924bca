!> What contact costs: microseconds for one event of 400 contacts.
module bench_contact
  use castnet_kinds, only: wp, i8
  use castnet_model, only: contact_t
  use castnet_contact_list, only: contact_list_t, body_inertia_t, impulse_report_t
  use castnet_contact_response, only: contact_solver_t, resolve_contacts
  use contact_cases, only: random_t, random_contacts, uniform
  implicit none
  private
  public :: time_contacts

contains

  !> Print the cost of 400 contacts by every solver, nodes of 1 g on a body of 1 kg.
  subroutine time_contacts()
    type(contact_t) :: contact
    contact%restitution = 0.5_wp
    call time_one('400 nodes, reduced, push_only', contact, .false., 200)
    contact%push_only = .false.
    call time_one('400 nodes, reduced, equality', contact, .false., 200)
    contact%dense = .true.
    call time_one('400 nodes, dense, equality', contact, .false., 3)
    contact%push_only = .true.
    call time_one('400 nodes, dense, push_only', contact, .false., 3)
    contact%dense = .false.
    contact%friction = 0.3_wp
    call time_one('400 nodes, friction 0.3', contact, .false., 100)
    contact%friction = 0.0_wp
    contact%detect_cables = .true.
    call time_one('400 points of cables', contact, .true., 50)
    contact%friction = 0.3_wp
    call time_one('400 points of cables, friction 0.3', contact, .true., 20)
  end subroutine time_contacts

  subroutine time_one(name, contact, cables, repeats)
    character(len=*), intent(in) :: name
    type(contact_t), intent(in) :: contact
    logical, intent(in) :: cables
    integer, intent(in) :: repeats
    type(contact_list_t) :: list
    type(body_inertia_t) :: body
    type(contact_solver_t) :: solver
    type(impulse_report_t) :: report
    type(random_t) :: random
    integer(i8) :: t0, t1, rate
    integer :: i, k
    real(wp) :: best
    call random_contacts(random, 400, 1.0e-3_wp, 0.0_wp, list, body)
    ! Contacts on one side of the body: a net that has just arrived.
    do i = 1, 400
      list%normal(i, 3) = abs(list%normal(i, 3))
      list%velocity(i, 3) = list%velocity(i, 3) - 1.0_wp
      list%normal_velocity(i) = sum(list%velocity(i, :)*list%normal(i, :))
      if (.not. cables .or. mod(i, 3) == 0) cycle
      ! Two cables in three contacts, each sharing nodes with the next.
      list%node_b(i) = i + 1
      list%share(i) = uniform(random)
      list%weight_a(i) = 1.0_wp - list%share(i)
      list%inverse_mass_b(i) = list%inverse_mass_a(i)
    end do
    best = huge(1.0_wp)
    do k = 1, repeats
      call system_clock(t0, rate)
      call resolve_contacts(contact, body, list, solver, report)
      call system_clock(t1)
      best = min(best, real(t1 - t0, wp)/rate*1.0e6_wp)
    end do
    print '(2a,f12.1,a,i4,a,es9.2)', name, repeat(' ', max(0, 40 - len(name))), best, ' us, iterations', report%iterations, &
      ', residual', report%residual
  end subroutine time_one

end module bench_contact
