!> The files beside OUTPUT, and what is said about them before a run starts: everything
!> that would stop a run at its end is better found at its start.
module castnet_output_files
  use castnet_error, only: error_t, fail, exit_file, exit_input
  use castnet_text, only: to_text, text_t, folder_of, name_of, without_extension
  use castnet_posix, only: path_kind, path_nothing, path_file, path_folder, same_file, may_write, longest_name, &
                           longest_path, remove_file, copy_file, rename_file, file_failure
  implicit none
  private
  public :: check_output, check_csv, protect_inputs, can_continue, stage_part, clear_leftovers

  !> The longest ending that is added to OUTPUT.
  character(len=*), parameter :: longest_ending = '.checkpoint.previous'

contains

  !> May a run write here? Nothing is written or touched. Errors: exit_file, one sentence
  !> that says what to do; exit_input for an output that is also read.
  subroutine check_output(output, inputs, force, restarting, error)
    character(len=*), intent(in) :: output       !! OUTPUT
    type(text_t), intent(in) :: inputs(:)        !! files that the run reads: never overwritten, --force or not
    logical, intent(in) :: force                 !! --force: existing files may be replaced
    logical, intent(in) :: restarting            !! --restart: OUTPUT.part or OUTPUT is gone on with
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: folder
    integer :: number
    if (allocated(error)) return
    folder = folder_of(output)//'.'
    if (len(name_of(output)) == 0) then
      call refuse("'"//output//"' names a folder, not a file; add a name, as in --output "//output//'run.h5')
    else if (len(output) + len(longest_ending) >= longest_path()) then
      call refuse("the path of the output is too long: "//to_text(len(output))//' bytes, at most '// &
                  to_text(longest_path() - len(longest_ending) - 1)//' are possible; choose a shorter --output')
    else if (path_kind(folder) == path_nothing .and. .not. is_file(folder_of(output))) then
      call refuse("the folder '"//folder_of(output)//"' of the output is not there; make it first or choose another"// &
                  ' with --output')
    else if (path_kind(folder) /= path_folder) then
      call refuse("'"//folder_of(output)//"' is not a folder that can be used; choose another with --output")
    else if (longest_name(folder) > 0 .and. len(name_of(output)) + len(longest_ending) > longest_name(folder)) then
      call refuse("the name of the output is too long: "//to_text(len(name_of(output)))//' bytes, at most '// &
                  to_text(longest_name(folder) - len(longest_ending))//' are possible; choose a shorter --output')
    else if (path_kind(output) == path_folder) then
      call refuse("'"//output//"' is a folder; choose a file with --output")
    end if
    if (allocated(error)) return
    number = may_write(folder)
    if (number /= 0) call file_failure(error, number, 'cannot write into the folder of', output, &
                                       'choose another folder with --output')
    call protect_inputs(output, [character(len=24) :: '', '.part', '.tmp', '.lock', '.checkpoint', '.checkpoint.previous'], &
                        inputs, error)
    if (force .or. allocated(error)) return
    if (path_kind(output) /= path_nothing .and. path_kind(output//'.part') /= path_nothing) then
      call refuse("both '"//output//"' and '"//output//".part' are there; choose another --output or replace them with --force")
    else if (restarting) then
      return
    else if (path_kind(output) /= path_nothing) then
      call refuse("'"//output//"' is there already; choose another --output or replace it with --force")
    else if (path_kind(output//'.part') /= path_nothing) then
      call refuse("'"//output//".part' of an unfinished run is there; go on with --restart "//output// &
                  '.checkpoint, choose another --output or replace it with --force')
    end if

  contains

    subroutine refuse(text)
      character(len=*), intent(in) :: text
      call fail(error, exit_file, text)
    end subroutine refuse

  end subroutine check_output

  !> Refuse to write over a file that is read, by whatever name; --force does not help.
  !> Errors: exit_input.
  subroutine protect_inputs(output, endings, inputs, error)
    character(len=*), intent(in) :: output
    character(len=*), intent(in) :: endings(:)   !! of the files that will be written: '' for OUTPUT itself
    type(text_t), intent(in) :: inputs(:)
    type(error_t), allocatable, intent(inout) :: error
    integer :: i, k
    do i = 1, size(inputs)
      do k = 1, size(endings)
        if (same_file(output//trim(endings(k)), inputs(i)%chars)) call fail(error, exit_input, "the output '"// &
          output//trim(endings(k))//"' is a file that is read here ("//inputs(i)%chars//'); choose another with --output')
      end do
    end do
  end subroutine protect_inputs

  !> May the table's CSV be written beside it? Errors: exit_input.
  subroutine check_csv(output, inputs, error)
    character(len=*), intent(in) :: output
    type(text_t), intent(in) :: inputs(:)
    type(error_t), allocatable, intent(inout) :: error
    if (allocated(error)) return
    if (without_extension(output)//'.csv' == output) call fail(error, exit_input, "--output: seen '"//output// &
      "', the name of the CSV that is written beside the HDF5 file; allowed: another ending, as in "// &
      without_extension(output)//'.h5')
    call protect_inputs(without_extension(output), ['.csv'], inputs, error)
  end subroutine check_csv

  !> Does a folder's path, less its final '/', name something that is no folder?
  logical function is_file(folder)
    character(len=*), intent(in) :: folder
    is_file = .false.
    if (len(folder) > 1) is_file = path_kind(folder(1:len(folder) - 1)) /= path_nothing
  end function is_file

  !> Is there a file that a restart can go on with? If not, it starts a new one.
  logical function can_continue(output)
    character(len=*), intent(in) :: output
    can_continue = path_kind(output//'.part') == path_file .or. path_kind(output) == path_file
  end function can_continue

  !> Make sure that OUTPUT.part is there to go on with: a finished OUTPUT is copied, and
  !> stays as it is until the longer run is complete.
  subroutine stage_part(output, error)
    character(len=*), intent(in) :: output
    type(error_t), allocatable, intent(inout) :: error
    integer :: number
    if (allocated(error)) return
    if (path_kind(output//'.part') == path_file) return
    number = remove_file(output//'.tmp')
    number = copy_file(output, output//'.tmp')
    if (number == 0) number = rename_file(output//'.tmp', output//'.part')
    if (number /= 0) call file_failure(error, number, 'cannot copy the finished run to go on with it:', output//'.part', &
                                       'check the folder')
  end subroutine stage_part

  !> Remove the checkpoints that an earlier run of the same name left, so that they are not
  !> taken for this run's. To be called when the new OUTPUT.part is in its place: a run that
  !> cannot start leaves everything as it was.
  subroutine clear_leftovers(output)
    character(len=*), intent(in) :: output
    integer :: ignored
    ignored = remove_file(output//'.checkpoint')
    ignored = remove_file(output//'.checkpoint.previous')
  end subroutine clear_leftovers

end module castnet_output_files
