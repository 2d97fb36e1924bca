!> Every unit and verification test. One line per suite; `fpm @check -- contact` filters.
program main
  use test_shape, only: run_test_shape
  use testing, only: finish
  use test_text, only: run_test_text
  implicit none
  call run_test_shape()
  call run_test_text()
  call finish()
end program main
