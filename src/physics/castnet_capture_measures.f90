module castnet_capture_measures
  use castnet_kinds, only: wp
  use castnet_model, only: model_t
  use castnet_state, only: state_t
  use castnet_record, only: capture_measures_t, thresholds_t
  implicit none
  private
  public :: measure_capture
contains
  function measure_capture(model, state, first, thresholds) result(m)
    type(model_t), intent(in) :: model
    type(state_t), intent(in) :: state
    logical, intent(in) :: first
    type(thresholds_t), intent(in) :: thresholds
    type(capture_measures_t) :: m
    m%time = state%time
  end function
end module
