!> Every unit and verification test. One line per suite; `fpm @check -- contact` filters.
program main
  use testing, only: finish
  implicit none
  call finish()
end program main
