!> The strict pass of scene files: what is refused, with which words and where; what
!> is read, and that it survives being written and read again.
module test_scene_file
  use castnet_error, only: error_t, exit_input
  use castnet_kinds, only: wp
  use castnet_scene, only: scene_t, is_set
  use castnet_scene_check, only: finish_scene
  use castnet_scene_file, only: read_scene_text, read_scene
  use castnet_scene_schema, only: set_key, get_key, scene_groups
  use castnet_scene_text, only: effective_scene, scene_template, full_table
  use castnet_schema, only: schema_t
  use castnet_schema_entry, only: entry_t, kind_real, kind_integer, kind_logical, kind_word, kind_path
  use castnet_problems, only: problem_list_t
  use castnet_text, only: text_t, to_text, word_at, word_count, quoted, is_one_of
  use testing, only: test_case, expect, expect_equal, expect_close
  implicit none
  private
  public :: run_test_scene_file

  character(len=1), parameter :: nl = new_line('a'), tab = achar(9), cr = achar(13)
  character(len=*), parameter :: net = '&net squares = 10 10, mesh_length = 0.07 cable_diameter = 1e-3 /'//nl
  character(len=*), parameter :: bullets = '&bullets mass = 0.03, speed = 1.8 /'//nl
  character(len=*), parameter :: body = '&target shape = ''box'' dimensions = 0.1 0.1 0.3 mass = 3.5 position = 1.4 2*0 /'//nl
  character(len=*), parameter :: contact = '&contact threshold = 0.002 /'//nl
  character(len=*), parameter :: time = '&time end_time = 3 /'//nl

contains

  subroutine run_test_scene_file()
    call test_case('scene_file: what namelist users write is read', written_forms)
    call test_case('scene_file: 60 malformed scenes are refused, every problem named with its line', malformed)
    call test_case('scene_file: several problems are told in one go, in order', all_in_one_go)
    call test_case('scene_file: features not built are refused by name', pending)
    call test_case('scene_file: groups that contradict each other are refused', contradictions)
    call test_case('scene_file: defaults that follow from other keys', defaults)
    call test_case('scene_file: the effective scene reads back to the same scene', round_trip)
    call test_case('scene_file: every key of the table can be set and read by name', every_key)
    call test_case('scene_file: overrides win and are checked like the file', overrides)
    call test_case('scene_file: the template is a scene that is read', template)
    call test_case('scene_file: inertia tensors that no body has are refused', inertia)
    call test_case('scene_file: a key given without effect is warned of', without_effect)
  end subroutine run_test_scene_file

  !> Read a text that must be accepted.
  subroutine accept(text, scene, words)
    character(len=*), intent(in) :: text, words
    type(scene_t), intent(out) :: scene
    type(error_t), allocatable :: error
    type(text_t) :: none(0)
    character(len=:), allocatable :: warnings
    call read_scene_text(text, 's.nml', none, scene, warnings, error)
    call expect(.not. allocated(error), words//' is read')
    if (allocated(error)) call expect(.false., error%message)
  end subroutine accept

  !> Read a text that must be refused: as many lines as fragments, each fragment in its line's place.
  subroutine refuse(text, fragments)
    character(len=*), intent(in) :: text
    character(len=*), intent(in) :: fragments  !! separated by |
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    type(text_t) :: none(0)
    character(len=:), allocatable :: warnings, rest, message
    integer :: bar, line_end
    call read_scene_text(text, 's.nml', none, scene, warnings, error)
    if (.not. allocated(error)) then
      call expect(.false., 'refused: '//text)
      return
    end if
    call expect_equal(error%code, exit_input, 'exit code')
    call expect(.not. allocated(scene%net) .and. .not. allocated(scene%target), 'nothing is accepted')
    rest = fragments//'|'
    message = error%message//nl
    do while (len(rest) > 0 .and. len(message) > 0)
      bar = index(rest, '|')
      line_end = index(message, nl)
      call expect(index(message(:line_end), rest(:bar - 1)) > 0, '"'//rest(:bar - 1)//'" in: '//message(:line_end - 1))
      rest = rest(bar + 1:)
      message = message(line_end + 1:)
    end do
    call expect(len(rest) == 0, 'also told: '//rest)
    call expect(len(message) == 0, 'not also told: '//message)
  end subroutine refuse

  subroutine written_forms()
    type(scene_t) :: scene
    character(len=:), allocatable :: text
    text = '! a comment'//nl//'&NET'//nl//tab//'Squares(1) = 10 ! ten'//nl//' squares(2)=12,'//nl// &
           ' Mesh_Length=.07d0 cable_diameter'//nl//' = 1.E-3'//nl//'! inside'//nl//' clamp_tension = F'//nl//' /'//nl// &
           "&output file = 'it''s ""here"" – ünï.h5', verdict_times = 1,"//nl//'   2, 3 /'//nl// &
           "&target shape = ""Box"", dimensions = 2*0.1, 0.3 mass=3.5, position = 1.4,"//nl//'  2*0,'//nl//'/'//nl// &
           '&contact threshold=+2e-3 / ! end'//nl//'&time end_time=3. / &perturb seed = 12345678901234 /'
    call accept(text, scene, 'a scene in every style')
    if (.not. allocated(scene%net)) return
    call expect(all(scene%net%squares == [10, 12]), 'components')
    call expect_close(scene%net%mesh_length, 0.07_wp, 'd exponent')
    call expect_close(scene%net%cable_diameter, 1.0e-3_wp, 'value on the next line')
    call expect(.not. scene%net%clamp_tension, 'F')
    call expect_equal(trim(scene%output%file), 'it''s "here" – ünï.h5', 'quotes and UTF-8')
    call expect_close(scene%output%verdict_times, [1.0_wp, 2.0_wp, 3.0_wp], 'array over lines')
    call expect_equal(trim(scene%target%shape), 'box', 'words in any case')
    call expect_close(scene%target%position, [1.4_wp, 0.0_wp, 0.0_wp], 'repeat count')
    call expect(scene%perturb%seed == 12345678901234_8, '64-bit seed')
    call accept(achar(239)//achar(187)//achar(191)//net(:len(net) - 1)//cr//nl//'&time end_time=1/', scene, &
                'BOM, CRLF and no final newline')
    call accept('&time'//cr//'end_time=1'//cr//'/'//cr//net, scene, 'old Mac line ends')
  end subroutine written_forms

  subroutine malformed()
    character(len=*), parameter :: t = 's.nml:2: time/'
    ! spelling
    call refuse('&nett squares=1 1 /'//nl//body//time, 's.nml:1: nett: there is no group &nett; did you mean net?')
    call refuse(net//body//'&gravity g = 1 /'//nl//contact//time, 's.nml:3: gravity: there is no group &gravity')
    call refuse(net//'&time end_tme = 3 /', t//'end_tme: there is no such key; did you mean end_time?|'//t//'end_time: missing')
    call refuse(net//'&time end_time=1 mass=3 /', t//'mass: there is no such key')
    call refuse(net//'&time end_time = 3, method = ''rk5'' /', t//'method: seen ''rk5''; allowed: ''rk4''')
    call refuse(net//'&time end_time = 3, method = rk4 /', t//'method: seen rk4 without quotes')
    ! repetition
    call refuse(net//time//time, 's.nml:3: time: the group is repeated; it stands on line 2')
    call refuse(net//'&time end_time = 3'//nl//'end_time = 3 /', 's.nml:3: time/end_time: the key is repeated; it stands on line 2')
    call refuse(net//time//'&environment gravity(1)=1 gravity(1)=2 /', 's.nml:3: environment/gravity: the key is repeated')
    call refuse(net//time//'&environment gravity=3*0 gravity(1)=2 /', 's.nml:3: environment/gravity: the key is repeated')
    call refuse(net//time//'&environment gravity(1)=2 gravity=3*0 /', 's.nml:3: environment/gravity: the key is repeated')
    ! counts
    call refuse(net//time//'&environment gravity = 1 2 /', 's.nml:3: environment/gravity: seen 2 values; allowed: 3 numbers')
    call refuse(net//time//'&environment gravity = 1 2 3 4 /', 's.nml:3: environment/gravity: seen 4 values')
    call refuse(net//time//'&environment gravity = 4*0 /', 's.nml:3: environment/gravity: seen 4 values')
    call refuse(net//time//'&environment gravity(4) = 0 /', 's.nml:3: environment/gravity: seen index (4); allowed: (1) to (3)')
    call refuse(net//time//'&environment gravity(2) = 0 1 /', 's.nml:3: environment/gravity: seen 2 values for one component')
    call refuse(net//time//'&environment gravity(1:2) = 0 1 /', 's.nml:3: environment/gravity: seen index (1:2)')
    call refuse(net//time//'&environment gravity(0) = 0 /', 's.nml:3: environment/gravity: seen index (0)')
    call refuse(net//'&time end_time = 1 2 /', t//'end_time: seen 2 values; allowed: a number')
    call refuse(net//'&time end_time(1) = 1 /', t//'end_time: an index (1) on a key that takes none')
    call refuse(net//'&time end_time = /', t//'end_time: no value is given')
    call refuse(net//'&time end_time = , step = 0 /', t//'end_time: an empty value before a comma')
    call refuse(net//time//'&environment gravity = 1,,2 /', 's.nml:3: environment/gravity: an empty value')
    call refuse(net//time//'&environment gravity = 3* /', 's.nml:3: environment/gravity: seen "3* /"')
    call refuse(net//time//'&environment gravity = 0*1 /', 's.nml:3: environment/gravity: seen "0*1 /"')
    call refuse(net//time//'&environment gravity = 999999999999*1 /', 's.nml:3: environment/gravity: more than 100000 values')
    ! types
    call refuse(net//'&time end_time = ''3'' /', t//'end_time: seen ''3'', which is text; allowed: a number')
    call refuse(net//'&time end_time = three /', t//'end_time: seen three, which is not a number')
    call refuse(net//'&time end_time = 3s /', t//'end_time: seen 3s, which is not a number')
    call refuse(net//'&time end_time = .true. /', t//'end_time: seen .true., which is not a number')
    call refuse(net//'&time end_time = 1 allow_unstable = tough /', t//'allow_unstable: seen tough; allowed: .true. or .false.')
    call refuse(net//'&time end_time = 1 allow_unstable = 1 /', t//'allow_unstable: seen 1; allowed: .true. or .false.')
    call refuse(net//'&time end_time = 1 allow_unstable = ''T'' /', t//'allow_unstable: seen text ''T''')
    call refuse('&net squares = 2.5 3 mesh_length = 1 cable_diameter = 0.1 /'//nl//time, &
                's.nml:1: net/squares: seen 2.5, which is not a whole number')
    call refuse(net//time//'&output file = results.h5 /', 's.nml:3: output/file: seen results.h5 without quotes')
    call refuse(net//time//'&output file = out/results.h5 /', 's.nml:3: text after the / that ends the group: "results.h5 /"|'// &
                's.nml:3: output/file: seen out without quotes')
    ! numbers that are none, or out of range
    call refuse(net//'&time end_time = NaN /', t//'end_time: seen NaN, which must be finite')
    call refuse(net//'&time end_time = +Infinity /', t//'end_time: seen +Infinity, which must be finite')
    call refuse(net//'&time end_time = 1e999 /', t//'end_time: seen 1e999, which is larger than the largest double')
    call refuse(net//'&time end_time = 0 /', t//'end_time: seen 0; allowed: a number from 1e-9 to 1e9 [s]')
    call refuse(net//'&time end_time = -3 /', t//'end_time: seen -3; allowed')
    call refuse(net//'&time end_time = 1 step = -1e-5 /', t//'step: seen -1e-5; allowed')
    call refuse('&net squares = 0 3 mesh_length = 1 cable_diameter = 0.1 /'//nl//time, &
                's.nml:1: net/squares: seen 0; allowed: 2 whole')
    call refuse('&net squares = 3 3 mesh_length = 1 cable_diameter = 0.1 damping_ratio = -0.1 /'//nl//time, &
                's.nml:1: net/damping_ratio: seen -0.1')
    call refuse('&net squares = 3 99999999999999999999 mesh_length = 1 cable_diameter = 0.1 /'//nl//time, &
                's.nml:1: net/squares: seen 99999999999999999999, which does not fit')
    call refuse('&net squares = 2*100000 mesh_length = 1 cable_diameter = 0.1 /'//nl//time, &
                's.nml:1: net/squares: seen 100000 x 100000 squares with 1 cables a side: about 11 TiB of memory')
    call refuse(net//time//'&perturb seed = -1 /', 's.nml:3: perturb/seed: seen -1; allowed: a whole number at least 0')
    ! broken text
    call refuse(net//time//'&output file = ''out.h5 /'//nl//'/', 's.nml:3: the string "''out.h5 /" is not closed on its line')
    call refuse(net//'&time end_time = 3', 's.nml:2: time: the group that starts here has no final /')
    call refuse('&net squares = 1 1 mesh_length = 1 cable_diameter = 0.1'//nl//time, 's.nml:1: net: the group that starts here '// &
                'has no final / before &time on line 2')
    call refuse(net//'&time end_time = 3 &end', t(:len(t) - 1)//': seen &end; a group ends with /')
    call refuse('A cubesat'//nl//net//time, 's.nml:1: text outside groups: "A cubesat"')
    call refuse(net//time//'threshold = 0.1', 's.nml:3: threshold: this key stands outside any group')
    call refuse(net//'&time end_time 3 /', t(:len(t) - 1)//': seen "end_time 3 /"; expected key = value|'//t//'end_time: missing')
    call refuse(net//'&time end_time == 3 /', t//'end_time: seen "= 3 /"; expected a value')
    call refuse(net//'&time end_time = (3, 0) /', t//'end_time: seen "(3, 0) /"; expected a value')
    call refuse(net//'&time end_time = 3 step = 0;1 /', t//'step: seen 0;1, which is not a number')
    call refuse(net//time//'&output file = ''a'//achar(7)//''' /', &
                's.nml:3: a string holds a character that cannot be shown (code 7)')
    call refuse(net//'&time end_time = 3'//achar(0)//' /', 's.nml:2: a character that cannot be shown (code 0)')
    call refuse(net//time//'&output file = ''H'//achar(246)//'he'' /', 's.nml:3: a string holds a character that cannot')
    call refuse(net//'& time end_time = 3 /', 's.nml:2: seen &; a group starts with & and its name')
    call refuse('', 's.nml:1: time: the group &time is missing|s.nml:1: the scene has neither &net nor &target')
    call refuse(net, 's.nml:2: time: the group &time is missing; required')
  end subroutine malformed

  subroutine all_in_one_go()
    call refuse('&net'//nl//'  squares = 10'//nl//'  mesh_lenght = 0.07'//nl//'  cable_diameter = -1'//nl//'/'//nl// &
                '&target'//nl//'  shape = ''cylindre'''//nl//'  dimensions = 0.1, x, NaN'//nl//'/'//nl//'&time end_time = inf /', &
                's.nml:1: net/mesh_length: missing; required when kind = ''square''|'// &
                's.nml:2: net/squares: seen 1 value; allowed: 2 whole numbers|'// &
                's.nml:3: net/mesh_lenght: there is no such key; did you mean mesh_length?|'// &
                's.nml:4: net/cable_diameter: seen -1; allowed: a number from 1e-7 to 10 [m]|'// &
                's.nml:6: target/mass: missing; required unless fixed = .true.: mass, a number|'// &
                's.nml:6: target/position: missing; required: centre of mass|'// &
                's.nml:7: target/shape: seen ''cylindre''; allowed: ''box''|'// &
                's.nml:8: target/dimensions: seen x, which is not a number and NaN, which must be finite; allowed|'// &
                's.nml:10: time/end_time: seen inf, which must be finite')
  end subroutine all_in_one_go

  !> Whatever the schema calls not available yet is refused with these words.
  subroutine pending()
    type(scene_t), target :: bound
    type(scene_t) :: scene
    type(schema_t) :: table, part
    type(error_t), allocatable :: error
    integer :: i, k
    call full_table(bound, table, part)
    do i = 1, table%n
      associate (e => table%entries(i))
        do k = 1, word_count(trim(e%pending_words))
          call set_key(scene, e%name(), word_at(trim(e%pending_words), k), error)
          call refused_as_pending(word_at(trim(e%pending_words), k))
        end do
        if (e%only_zero) then
          call set_key(scene, e%name(), '0.125', error)
          call refused_as_pending(e%name())
        end if
        if (table%groups(table%find_group(trim(e%group)))%pending) then
          call set_key(scene, e%name(), '1', error)
          call refused_as_pending(e%name())
        end if
      end associate
    end do
  contains
    subroutine refused_as_pending(what)
      character(len=*), intent(in) :: what
      call expect(allocated(error), what//' is refused')
      if (.not. allocated(error)) return
      call expect(index(error%message, 'not available yet') > 0, what//': '//error%message)
      deallocate (error)
    end subroutine refused_as_pending
  end subroutine pending

  subroutine contradictions()
    character(len=*), parameter :: start = '&target mass=1, position = 3*0, ', part = '&part shape=''sphere'' dimensions=1 /'//nl
    call refuse(body//bullets//time, 's.nml:2: bullets: bullets without a &net')
    call refuse(net//contact//time, 's.nml:2: contact: contact needs both a &net and a &target; there is no &target')
    call refuse(body//contact//time, 's.nml:2: contact: contact needs both a &net and a &target; there is no &net')
    call refuse('&net kind = ''file'' /'//nl//time, 's.nml:1: net/file: missing; required when kind = ''file''')
    call refuse('&net kind = ''file'' file = '''' /'//nl//time, 's.nml:1: net/file: missing; required when kind = ''file''')
    call refuse('&net kind = ''file'' file = ''no_such_net.h5'' /'//nl//time, &
                's.nml:1: net/file: seen ''no_such_net.h5''; there is no')
    call refuse(start//'shape = ''box'' dimensions = 1 1 /'//nl//time, &
                's.nml:1: target/dimensions: seen 2 values; allowed: 3 for a box')
    call refuse(start//'shape = ''sphere'' dimensions = 1 1 /'//nl//time, &
                'target/dimensions: seen 2 values; allowed: 1 for a sphere')
    call refuse(start//'shape = ''sphere'' /'//nl//time, 's.nml:1: target/dimensions: missing; required for a box')
    call refuse(start//'shape = ''box'' dimensions(1) = 1 dimensions(3) = 1/'//nl//time, 'target/dimensions: only some components')
    call refuse(start//'shape = ''compound'' /'//nl//time, 's.nml:1: target/shape: seen ''compound'' without any &part')
    call refuse(body//part//time, 's.nml:2: part(1): a part belongs to a &target')
    call refuse(start//'shape = ''compound'' /'//nl//part//'&part shape = ''box'' dimensions = 1 1 /'//nl//time, &
                's.nml:3: part(2)/dimensions: seen 2 values; allowed: 3 for a box')
    call refuse(start//'shape = ''compound'' /'//nl//part//'&part shap = ''box'' /'//nl//time, &
                's.nml:3: part(2)/shap: there is no such key; did you mean shape?|s.nml:3: part(2)/shape: missing|'// &
                's.nml:3: part(2)/dimensions: missing')
    call refuse(start//'shape=''sphere'' dimensions=1 attitude = 4*0 /'//nl//time, 'target/attitude: seen a quaternion of length 0')
    call refuse(start//'shape=''sphere'' dimensions=1 phase = 30 /'//nl//time, &
                'target/phase: seen 30 for a body that does not turn; give phase_axis')
    call refuse(start//'shape=''sphere'' dimensions=1 phase = 30 phase_axis = 3*0 /'//nl//time, &
                'target/phase_axis: seen an axis of no length')
    call refuse('&target shape=''sphere'' dimensions=1 mass=1 position(1) = 1 position(2) = 0 /'//nl//time, &
                's.nml:1: target/position: seen 2 of its components; allowed: 3')
    call refuse(net//body//contact//time//'&output verdict_times = 1 4 /', &
                's.nml:5: output/verdict_times: seen 4; allowed: at most end_time = 3')
    call refuse(net//body//contact//time//'&output verdict_times = 2 1 /', 's.nml:5: output/verdict_times: seen 2 before 1')
    call refuse(net//'&time end_time = 3 step = 4 /', 's.nml:2: time/step: seen 4; allowed: at most end_time = 3')
    call refuse(net//'&time end_time = 1e9 step = 1e-9 /', 's.nml:2: time/step: seen 1e-9, which makes 1e18 steps')
    call refuse(net//time//'&output frame_interval = 1e-12 /', 's.nml:3: output/frame_interval: seen 1e-12, which makes')
    call refuse(net//time//'&output file = ''s.nml'' /', 's.nml:3: output/file: seen ''s.nml'', which would overwrite the scene')
    call refuse(net//time//'&output file = ''out/'' /', 's.nml:3: output/file: seen ''out/'', a folder')
  end subroutine contradictions

  subroutine defaults()
    type(scene_t) :: scene
    call accept(net//bullets//time, scene, 'a deployment')
    if (.not. allocated(scene%net)) return
    call expect(.not. (allocated(scene%target) .or. allocated(scene%contact) .or. allocated(scene%closing) .or. &
                       allocated(scene%environment) .or. allocated(scene%perturb) .or. allocated(scene%parts)), 'absent groups')
    call expect_close(scene%net%edge_cable_diameter, 1.0e-3_wp, 'edge_cable_diameter')
    call expect_close(scene%bullets%corner_cable_length, 0.07_wp*sqrt(2.0_wp), 'corner_cable_length', rtol=1.0e-15_wp)
    call expect_close(scene%output%frame_interval, 0.03_wp, 'frame_interval', rtol=1.0e-15_wp)
    call expect_close(scene%output%history_interval, 0.003_wp, 'history_interval', rtol=1.0e-15_wp)
    call expect_close(scene%output%verdict_times, [3.0_wp], 'verdict_times')
    call expect_equal(trim(scene%output%file), 's.h5', 'output file')
    call expect_close(scene%net%density, 1440.0_wp, 'density')
    call expect_close(scene%bullets%angle, 25.0_wp, 'angle')
    call accept(net//time//'&output frame_interval = 0.5 /', scene, 'a frame interval')
    call expect_close(scene%output%history_interval, 0.05_wp, 'history_interval follows', rtol=1.0e-15_wp)
  end subroutine defaults

  subroutine round_trip()
    character(len=*), parameter :: parts = '&part shape = ''box'' dimensions = 0.4 0.104 0.112 /'//nl// &
      '&part shape = ''capsule'' dimensions = 0.02, 0.3 position = 0.2 0 1e-3 attitude = 0.6 0.8 2*0 /'//nl
    call same_again(net//bullets//body//contact//time)
    call same_again(net//time)
    call same_again(body//time)
    call same_again('&target shape=''compound'' fixed=T position = 3*0.1 inertia = 1 1 1 3*0 /'//nl//parts//time)
    call same_again('&time end_time = 0.3333333333333333 step = 1.2345678901234567e-4 /'//nl//net)
    call same_again(net//time//'&environment gravity(3) = -9.81 /'//nl//'&perturb seed = 9223372036854775807 node_position=1e-12/')
    call same_again(net//time//'&output file = ''a ''''b'''' "c" – d.h5'' verdict_times = 0 1 2.5 vtk = f /')
  end subroutine round_trip

  subroutine same_again(text)
    character(len=*), intent(in) :: text
    type(scene_t) :: first, second
    call accept(text, first, 'a scene')
    if (.not. allocated(first%path)) return
    call accept(effective_scene(first), second, 'its effective scene')
    if (.not. allocated(second%path)) return
    call expect_equal(effective_scene(second), effective_scene(first), 'the effective scene of the effective scene')
    call expect((allocated(first%net) .eqv. allocated(second%net)) .and. (allocated(first%parts) .eqv. allocated(second%parts)) &
                .and. (allocated(first%perturb) .eqv. allocated(second%perturb)), 'the same groups')
    call expect(transfer(first%time%step, 1_8) == transfer(second%time%step, 1_8) .and. &
                transfer(first%time%end_time, 1_8) == transfer(second%time%end_time, 1_8), 'the same bits')
  end subroutine same_again

  !> Set each key to a value of its kind, read it back, and see that the effective scene holds it.
  subroutine every_key()
    type(scene_t), target :: bound
    type(scene_t) :: scene
    type(schema_t) :: table, part
    integer :: i, n
    n = 0
    allocate (scene%parts(1))
    call full_table(bound, table, part)
    do i = 1, table%n
      if (table%groups(table%find_group(trim(table%entries(i)%group)))%pending) cycle
      call one_key(scene, table%entries(i), '', n)
    end do
    do i = 1, part%n
      call one_key(scene, part%entries(i), '(1)', n)
    end do
    call expect(n > 50, 'seen '//to_text(n)//' keys')
  end subroutine every_key

  subroutine one_key(scene, entry, label, n)
    type(scene_t), intent(inout) :: scene
    type(entry_t), intent(in) :: entry
    character(len=*), intent(in) :: label
    integer, intent(inout) :: n
    type(error_t), allocatable :: error
    character(len=:), allocatable :: name, value, back
    real(wp) :: number
    integer :: i
    name = trim(entry%group)//label//'/'//trim(entry%key)
    select case (entry%kind)
    case (kind_real, kind_integer)
      number = max(entry%low, min(entry%high, 7.0_wp))
      if (entry%only_zero) number = 0.0_wp
      value = to_text(number)
      if (entry%kind == kind_real .and. number == 7.0_wp) value = '7.125'
      do i = 2, max(1, entry%count)
        value = value//', '//to_text(number)
      end do
    case (kind_logical)
      value = '.true.'
    case (kind_word)
      do i = 1, 9
        value = quoted(word_at(trim(entry%words), i))
        if (.not. is_one_of(word_at(trim(entry%words), i), trim(entry%pending_words))) exit
      end do
    case default
      value = '''some file.h5'''
    end select
    call set_key(scene, name, value, error)
    call expect(.not. allocated(error), name//' is set')
    if (allocated(error)) call expect(.false., error%message)
    call get_key(scene, name, back, error)
    call expect_equal(back, value, name)
    if (entry%is_array()) then
      call set_key(scene, name//'(2)', to_text(max(entry%low, 1.0_wp)), error)
      call get_key(scene, name//'(2)', back, error)
      call expect_equal(back, to_text(max(entry%low, 1.0_wp)), name//'(2)')
    end if
    call expect(.not. allocated(error), name//' is read')
    call set_key(scene, name, 'nonsense nonsense', error)
    if (entry%kind /= kind_path) call expect(allocated(error), name//' refuses nonsense')
    n = n + 1
  end subroutine one_key

  subroutine overrides()
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    type(problem_list_t) :: warnings
    type(text_t) :: list(4)
    character(len=:), allocatable :: warned
    list(1)%chars = 'time/end_time=5'
    list(2)%chars = 'Target/Position(2) = 0.25'
    list(3)%chars = 'contact/impulses=equality'
    list(4)%chars = 'perturb/seed=7'
    call read_scene_text(net//bullets//body//contact//time, 's.nml', list, scene, warned, error)
    call expect(.not. allocated(error), 'good overrides')
    if (allocated(error)) return
    call expect_close(scene%time%end_time, 5.0_wp, 'end_time')
    call expect_close(scene%target%position, [1.4_wp, 0.25_wp, 0.0_wp], 'one component')
    call expect_equal(trim(scene%contact%impulses), 'equality', 'a bare word')
    call expect(scene%perturb%seed == 7, 'a group that was not there')
    call expect_close(scene%output%frame_interval, 0.05_wp, 'defaults follow the override', rtol=1.0e-15_wp)
    list(1)%chars = 'time/end_tme=5'
    list(2)%chars = 'target/position(4)=1'
    list(3)%chars = 'perturb/seed=x'
    list(4)%chars = 'nonsense'
    call read_scene_text(net//bullets//body//contact//time, 's.nml', list, scene, warned, error)
    call expect(allocated(error), 'bad overrides')
    if (.not. allocated(error)) return
    call expect(index(error%message, '--set: time/end_tme: there is no such key; did you mean end_time?') > 0, 'unknown key')
    call expect(index(error%message, '--set: target/position(4): seen index (4)') > 0, 'index')
    call expect(index(error%message, '--set: perturb/seed: seen x, which is not a whole number') > 0, 'type')
    call expect(index(error%message, '--set: seen ''nonsense''; expected group/key=value') > 0, 'no =')
    ! a case of a study: values by name, then the checks between keys
    deallocate (error)
    call accept(net//bullets//body//contact//time, scene, 'a base scene')
    call set_key(scene, 'target/angular_velocity(2)', '1.5', error)
    call finish_scene(scene, warnings, error)
    call expect(.not. allocated(error), 'a good case')
    call set_key(scene, 'time/step', '4', error)
    call finish_scene(scene, warnings, error)
    call expect(allocated(error), 'a bad case')
  end subroutine overrides

  subroutine template()
    type(scene_t) :: scene
    call accept(scene_template(), scene, 'the template')
    if (.not. allocated(scene%target)) return
    call expect_close(scene%target%dimensions, [0.1_wp, 0.1_wp, 0.3_wp], 'the cubesat')
  end subroutine template

  subroutine inertia()
    character(len=*), parameter :: start = '&target shape=''sphere'' dimensions=1 mass=1 position=3*0 inertia = ', &
      no = 's.nml:1: target/inertia: no body has this tensor'
    type(scene_t) :: scene
    call refuse(start//'1 1 3 3*0 /'//nl//time, no)
    call refuse(start//'-1 1 1 3*0 /'//nl//time, no)
    call refuse(start//'6*0 /'//nl//time, no)
    call refuse(start//'1 1 1 2 0 0 /'//nl//time, no)
    call refuse(start//'1 1 1 1e6 0 0 /'//nl//time, no)
    call refuse(start//'1 1 0 3*0 /'//nl//time, no)
    call accept(start//'1 1 2 3*0 /'//nl//time, scene, 'a disc')
    call accept(start//'17023.3 124825.7 129112.2 397.1 -2171.4 344.2 /'//nl//time, scene, 'Envisat')
    call accept(start//'15640 91476 91476 3*0 /'//nl//time, scene, 'the rocket')
  end subroutine inertia

  subroutine without_effect()
    type(scene_t) :: scene
    type(error_t), allocatable :: error
    type(text_t) :: none(0)
    character(len=:), allocatable :: warnings
    call read_scene_text(net//body//'&time end_time=1 tolerance = 1e-6 /', 's.nml', none, scene, warnings, error)
    call expect(.not. allocated(error), 'is read')
    call expect(index(warnings, 's.nml:3: time/tolerance: has no effect here') > 0, 'tolerance: '//warnings)
    call expect(index(warnings, 'net and target, but no &contact') > 0, 'no contact: '//warnings)
  end subroutine without_effect

end module test_scene_file
