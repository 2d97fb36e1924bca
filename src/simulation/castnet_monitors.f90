!> What is watched while a run goes on. Each monitor has a limit and an action:
!>
!>   monitor       limit                                                        action
!>   finite        every number of the motion                                   stop
!>   energy        1.2 times all that was put in                                stop
!>   energy rise   0.01 of all that was put in, between two rows of history     warn
!>   penetration   one contact threshold behind the surface, after correction   warn
!>   contact       1e-6 m/s by which an event misses its conditions             warn
!>
!> A stop is exit code 3: it names the node, the cable at it that is strained most, and what
!> to try. A warning is said once, with the worst of the run and the time of the first.
module castnet_monitors
  use castnet_kinds, only: wp
  use castnet_compliant_contact, only: is_compliant, spring_energy
  use castnet_diagnostics, only: check_finite, net_kinetic_energy, target_kinetic_energy, elastic_energy
  use castnet_error, only: error_t, fail, exit_numerical
  use castnet_log, only: log_t, log_warning
  use castnet_model, only: model_t
  use castnet_net, only: net_t
  use castnet_record, only: history_row_t
  use castnet_state, only: state_t
  use castnet_text, only: to_text
  implicit none
  private
  public :: check_state, mechanical_energy, watch_t, watch_row, watch_rest, tell_watch

  !> Energy above this multiple of all that was put in is an explosion. A sound run never
  !> gains more than rounding; an unstable one passes any factor within a few dozen steps.
  real(wp), parameter :: explosion = 1.2_wp
  !> One-stage steps show the elastic energy of a taut net with an error of their own:
  !> 1e-4 of the shot's energy between rows on the paper's nets.
  real(wp), parameter :: rise_limit = 0.01_wp
  real(wp), parameter :: penetration_limit = 1.0_wp   !! contact thresholds
  real(wp), parameter :: residual_limit = 1.0e-6_wp   !! [m/s]

  !> The worst of one monitor so far, and when it first passed its limit.
  type :: worst_t
    real(wp) :: value = 0.0_wp
    real(wp) :: since = -1.0_wp  !! [s]; negative: never
  end type worst_t

  !> The monitors that warn.
  type :: watch_t
    type(worst_t) :: rise, penetration, residual
    real(wp) :: before = -huge(1.0_wp)  !! energy less the works done on it, at the last row [J]
  end type watch_t

contains

  !> Is every number finite, and the energy one that the run can have? Errors: exit_numerical.
  subroutine check_state(model, state, energy_start, error)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    real(wp), intent(in) :: energy_start    !! kinetic and elastic at t = 0 [J]
    type(error_t), allocatable, intent(inout) :: error
    real(wp) :: energy, given, speed
    integer :: node, cable

    call check_finite(model, state, error)
    if (allocated(error) .or. .not. allocated(model%net)) return
    energy = mechanical_energy(model, state)
    given = energy_given(state, energy_start)
    if (energy <= explosion*given + tiny(1.0_wp)) return
    call fastest_node(model%net, state%node_velocity, node, speed)
    cable = most_strained_cable(model%net, state%node_position, node)
    !$omp critical (castnet_text)
    call fail(error, exit_numerical, 'step '//to_text(state%step)//', t = '//to_text(state%time)// &
              ' s: the energy has grown to '//to_text(energy)//' J where at most '//to_text(given)// &
              ' J were put in; the fastest node is '//to_text(shown_node(model%net, node))//' (counted from 0) at '// &
              to_text(speed)//' m/s'//cable_words(model%net, cable)//'; try a smaller time/step than '// &
              to_text(model%step)//' s')
    !$omp end critical (castnet_text)
  end subroutine check_state

  !> All energy that the run was given so far [J].
  pure real(wp) function energy_given(state, energy_start)
    type(state_t), intent(in) :: state
    real(wp), intent(in) :: energy_start
    associate (ledger => state%ledger)
      energy_given = energy_start + max(0.0_wp, ledger%winch_work) + max(0.0_wp, ledger%projection_work) &
                     + max(0.0_wp, ledger%external_work)
    end associate
  end function energy_given

  pure subroutine fastest_node(net, velocity, node, speed)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: velocity(:, :)  !! (n_pad,3)
    integer, intent(out) :: node
    real(wp), intent(out) :: speed          !! [m/s]
    real(wp) :: square
    integer :: i
    node = 1
    speed = -1.0_wp
    do i = 1, net%n_node
      square = velocity(i, 1)**2 + velocity(i, 2)**2 + velocity(i, 3)**2
      if (square > speed) then
        speed = square
        node = i
      end if
    end do
    speed = sqrt(max(0.0_wp, speed))
  end subroutine fastest_node

  !> Of the cables at a node; 0: it has none.
  pure integer function most_strained_cable(net, position, node) result(cable)
    type(net_t), intent(in) :: net
    real(wp), intent(in) :: position(:, :)  !! (n_pad,3)
    integer, intent(in) :: node
    real(wp) :: along(3), strain, largest
    integer :: k
    cable = 0
    largest = -huge(1.0_wp)
    do k = 1, net%n_cable
      if (net%cable_nodes(1, k) /= node .and. net%cable_nodes(2, k) /= node) cycle
      along = position(net%cable_nodes(2, k), :) - position(net%cable_nodes(1, k), :)
      strain = sqrt(along(1)**2 + along(2)**2 + along(3)**2)/net%natural_length(k)
      if (strain <= largest) cycle
      largest = strain
      cable = k
    end do
  end function most_strained_cable

  !> A node's number as the user's file counts it.
  pure integer function shown_node(net, node)
    type(net_t), intent(in) :: net
    integer, intent(in) :: node
    shown_node = node - 1
    if (allocated(net%original_node)) shown_node = net%original_node(node) - 1
  end function shown_node

  pure function cable_words(net, cable) result(words)
    type(net_t), intent(in) :: net
    integer, intent(in) :: cable
    character(len=:), allocatable :: words
    words = ''
    if (cable > 0) words = ', at the cable of nodes '//to_text(shown_node(net, net%cable_nodes(1, cable)))//' and '// &
                           to_text(shown_node(net, net%cable_nodes(2, cable)))
  end function cable_words

  !> Kinetic and elastic energy of net and target [J].
  real(wp) function mechanical_energy(model, state) result(energy)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    energy = 0.0_wp
    if (allocated(model%net)) energy = energy + net_kinetic_energy(model%net, state%node_velocity) &
                                       + elastic_energy(model%net, state%node_position)
    if (allocated(model%target)) energy = energy + target_kinetic_energy(model%target, state%target)
    if (is_compliant(model)) energy = energy + spring_energy(model, state%node_position, state%target)
  end function mechanical_energy

  !> Look at a row of history.
  pure subroutine watch_row(watch, row, threshold)
    type(watch_t), intent(inout) :: watch
    type(history_row_t), intent(in) :: row
    real(wp), intent(in) :: threshold   !! of contact [m]; 0: there is none
    real(wp) :: own, given
    own = row%kinetic_net + row%kinetic_target + row%elastic - row%winch_work - row%projection_work - row%external_work
    given = max(abs(own), abs(watch%before)) + max(0.0_wp, row%winch_work)
    if (watch%before > -huge(1.0_wp) .and. given > 0.0_wp) &
      call note(watch%rise, (own - watch%before)/given, rise_limit, row%time)
    watch%before = own
    if (threshold > 0.0_wp) call note(watch%penetration, row%deepest_penetration/threshold, penetration_limit, row%time)
    call note(watch%residual, row%contact_residual, residual_limit, row%time)
  end subroutine watch_row

  !> What happened since the last row.
  pure subroutine watch_rest(watch, state, threshold)
    type(watch_t), intent(inout) :: watch
    type(state_t), intent(in) :: state
    real(wp), intent(in) :: threshold   !! of contact [m]; 0: there is none
    if (threshold > 0.0_wp) &
      call note(watch%penetration, state%tally%deepest_penetration/threshold, penetration_limit, state%time)
    call note(watch%residual, state%tally%contact_residual, residual_limit, state%time)
  end subroutine watch_rest

  pure subroutine note(worst, value, limit, time)
    type(worst_t), intent(inout) :: worst
    real(wp), intent(in) :: value, limit, time
    worst%value = max(worst%value, value)
    if (value > limit .and. worst%since < 0.0_wp) worst%since = time
  end subroutine note

  !> Say what passed its limit, each once.
  subroutine tell_watch(log, watch)
    type(log_t), intent(inout) :: log
    type(watch_t), intent(in) :: watch
    if (watch%rise%since >= 0.0_wp) call log_warning(log, 'energy: it rose by up to '//percent(watch%rise%value)// &
      ' between two rows of /history with no work done on it, first before t = '//to_text(watch%rise%since)// &
      ' s; try a smaller time/step')
    if (watch%penetration%since >= 0.0_wp) call log_warning(log, 'contact: the net lay up to '// &
      to_text(watch%penetration%value)//' contact thresholds behind the target''s surface, first before t = '// &
      to_text(watch%penetration%since)//' s; try a smaller time/step, or with a compliant law a larger contact/stiffness')
    if (watch%residual%since >= 0.0_wp) call log_warning(log, 'contact: the conditions of at least one event were missed '// &
      'by up to '//to_text(watch%residual%value)//' m/s, more than '//to_text(residual_limit)//' m/s, first before t = '// &
      to_text(watch%residual%since)//' s; no energy was created; /history/contact_residual says when')
  end subroutine tell_watch

  pure function percent(share) result(text)
    real(wp), intent(in) :: share
    character(len=:), allocatable :: text
    text = to_text(real(nint(min(1.0e6_wp, 1000.0_wp*share)), wp)/10.0_wp)//' %'
  end function percent

end module castnet_monitors
