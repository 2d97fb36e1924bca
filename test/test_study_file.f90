!> The strict pass of study files, and of the keys that they vary.
module test_study_file
  use castnet_error, only: error_t, exit_input
  use castnet_kinds, only: wp
  use castnet_posix, only: create_file, remove_file
  use castnet_study_file, only: read_study_text, effective_study, is_study_text
  use castnet_study_request, only: study_request_t, grid_size, grid_value
  use castnet_text, only: text_t
  use testing, only: test_case, expect, expect_equal, expect_close
  implicit none
  private
  public :: run_test_study_file

  character(len=1), parameter :: nl = new_line('a')
  character(len=*), parameter :: base = 'test_study_base.nml'
  character(len=*), parameter :: study = '&study scene = '''//base//''' seed = 5 seeds = 8 /'//nl
  character(len=*), parameter :: rate = '&vary key = ''target/angular_velocity(2)'' '

contains

  subroutine run_test_study_file()
    integer :: status
    status = remove_file(base)
    status = create_file(base, '&net squares = 10 10 mesh_length = 0.07 cable_diameter = 1e-3 /'//nl// &
      '&bullets mass = 0.03 speed = 1.8 /'//nl//'&contact threshold = 0.002 /'//nl//'&time end_time = 3 /'//nl// &
      '&target shape = ''box'' dimensions = 0.1 0.1 0.3 mass = 3.5 position = 1.4 0 0 /'//nl//'&perturb node_position = 1e-6 /')
    call test_case('study_file: grids, lists, ranges and distributions are read', read_ones)
    call test_case('study_file: malformed studies are refused, every problem named with its line', malformed)
    call test_case('study_file: the effective study reads back to the same study', round_trip)
    call test_case('study_file: overrides of the study and of its scene', overrides)
    status = remove_file(base)
  end subroutine run_test_study_file

  subroutine accept(text, request)
    character(len=*), intent(in) :: text
    type(study_request_t), intent(out) :: request
    type(error_t), allocatable :: error
    type(text_t) :: none(0)
    character(len=:), allocatable :: warnings
    call read_study_text(text, 's.nml', none, request, warnings, error)
    call expect(.not. allocated(error), 'is read: '//text)
    if (allocated(error)) call expect(.false., error%message)
  end subroutine accept

  subroutine read_ones()
    type(study_request_t) :: request
    call accept(study//rate//'from = 0 to = 4 count = 9 /'//nl// &
                '&vary key = ''contact/impulses'' values = ''push_only'' ''equality'' /' &
                //nl//'&vary key=''bullets/speed'' distribution=''normal'' mean=1.8 deviation=0.05 /', request)
    if (.not. allocated(request%vary)) return
    call expect_equal(size(request%vary), 3, 'varied keys')
    call expect_equal(grid_size(request%vary(1)), 9, 'grid')
    call expect_close(grid_value(request%vary(1), 2), 0.5_wp, 'second value')
    call expect_close(grid_value(request%vary(1), 9), 4.0_wp, 'last value')
    call expect_equal(trim(request%vary(2)%values(2)), 'equality', 'a word')
    call expect_equal(trim(request%study%file), 's.h5', 'results')
    call accept(study//'&vary key=''time/step'' from=1e-5 to=1e-3 count=3 spacing=''log'' /', request)
    call expect_close(grid_value(request%vary(1), 2), 1.0e-4_wp, 'logarithmic', rtol=1.0e-14_wp)
    call accept(study//rate//'from=0 to=4 /'//nl//'&sample kind=''sobol'' points=64 /', request)
    call accept('&study scene='''//base//''' question=''threshold'' /'//nl// &
                '&search key=''target/angular_velocity(2)'' from=0 to=4 /', request)
    call expect_close(request%search%probability, 0.5_wp, 'probability')
    call accept(study//'&vary key=''contact/restitution'' values = 0 0.5 1 /', request)
    call expect_equal(grid_size(request%vary(1)), 3, 'list')
    call expect(is_study_text(study) .and. .not. is_study_text('&net /'), 'a study is told from a scene')
  end subroutine read_ones

  subroutine malformed()
    call refuse('', 's.nml:1: study: the group &study is missing')
    call refuse('&study /', 's.nml:1: study/scene: missing')
    call refuse('&study scene = ''nowhere.nml'' /', &
                's.nml:1: study/scene: seen ''nowhere.nml''; nowhere.nml: there is no such file')
    call refuse(study//'&very key = ''a'' /', 's.nml:2: very: there is no group &very; did you mean vary?')
    call refuse(study//rate//'fro = 0 to = 1 count = 2 /', 's.nml:2: vary(1)/fro: there is no such key; did you mean from?')
    call refuse(study//'&vary key = '''' values = 1 /', 's.nml:2: vary(1)/key: missing')
    call refuse(study//rate//'/', 's.nml:2: vary(1): no values; give values')
    call refuse(study//rate//'from = 0 to = 1 /', 's.nml:2: vary(1)/count: missing; required in a grid')
    call refuse(study//rate//'from = 0 count = 2 /', 's.nml:2: vary(1)/to: missing')
    call refuse(study//rate//'from = 0 to = 1 count = 2 values = 1 2 /', 's.nml:2: vary(1)/values: given together with')
    call refuse(study//rate//'from = 0 to = 1e9 count = 2 /', 's.nml:2: vary(1)/to: target/angular_velocity(2): seen 1e9; allowed')
    call refuse(study//rate//'from = 0 to = 1 count = 3 spacing = ''log'' /', 's.nml:2: vary(1)/spacing: seen ''log'' from 0 to 1')
    call refuse(study//rate//'values = 1 two /', 's.nml:2: vary(1)/values: target/angular_velocity(2): seen two, which is not a')
    call refuse(study//rate//'values = 1 /'//nl//rate//'values = 2 /', 's.nml:3: vary(2)/key: seen ''target/angular_velocity(2)''')
    call refuse(study//rate//'distribution = ''normal'' /', 's.nml:2: vary(1)/mean: missing')
    call refuse(study//rate//'distribution = ''uniform'' /', 's.nml:2: vary(1)/from: missing')
    call refuse(study//rate//'distribution = ''gauss'' from = 0 to = 1 count = 1 /', &
                's.nml:2: vary(1)/distribution: seen ''gauss''')
    call refuse(study//'&vary key = ''target/angular_velocity'' values = 1 /', &
                'vary(1)/key: target/angular_velocity: an array; name')
    call refuse(study//'&vary key = ''target/angular_velocty(2)'' values = 1 /', 'did you mean angular_velocity?')
    call refuse(study//'&vary key = ''traget/mass'' values = 1 /', &
                's.nml:2: vary(1)/key: traget/mass: there is no group &traget; did you')
    call refuse(study//'&vary key = ''target/angular_velocity(4)'' values = 1 /', &
                's.nml:2: vary(1)/key: target/angular_velocity(4): index')
    call refuse(study//'&vary key = ''mass'' values = 1 /', 's.nml:2: vary(1)/key: mass: seen ''mass''; expected group/key')
    call refuse(study//'&vary key = ''perturb/seed'' values = 1 /', 's.nml:2: vary(1)/key: perturb/seed: each run has its own seed')
    call refuse(study//'&vary key = ''part(1)/dimensions(1)'' values = 1 /', 'the scene has 0 &part groups')
    call refuse(study//'&vary key = ''net/cables_per_side'' from = 1 to = 2 count = 3 /', &
                'vary(1)/count: net/cables_per_side: seen 1.5')
    call refuse(study//rate//'from=0 to=1 count=2 /'//nl//'&sample kind = ''sobol'' points = 8 /', &
                's.nml:2: vary(1): a list or count')
    call refuse(study//rate//'from=0 to=1 /'//nl//'&sample kind = ''sobol'' /', 's.nml:3: sample/points: missing')
    call refuse(study//'&sample kind = ''sobol'' points = 8 /', 's.nml:2: sample/kind: seen ''sobol'' without a &vary group')
    call refuse('&study scene = '''//base//''' question = ''threshold'' /', 's.nml:1: study/question: seen ''threshold'' without')
    call refuse('&study scene = '''//base//''' question = ''optimum'' /'//nl//'&search key = ''bullets/speed'' from = 2 to = 1 /', &
                's.nml:2: search/to: seen 1; allowed: above from')
    call refuse('&study scene = '''//base//''' question = ''threshold'' /'//nl// &
                '&search key = ''bullets/speed'' from = 1 to = 2 budget = 17 /', &
                's.nml:2: search/budget: seen 17; allowed: at least 18')
    call refuse('&study scene = '''//base//''' question = ''threshold'' /'//nl// &
                '&search key = ''bullets/speed'' from = 1 to = 2 budget = 1000000 /'//nl//rate//'from = 0 to = 1 count = 101 /', &
                's.nml:1: study: 1.01e8 runs')
    call refuse('&study scene = '''//base//''' seeds = 1000000 /'//nl//rate//'from = 0 to = 1 count = 1000 /', &
                's.nml:1: study: 1e9 runs')
    call refuse('&study scene = '''//base//''' file = ''s.nml'' /', 's.nml:1: study/file: seen ''s.nml'', which would overwrite')
    call refuse(study//study, 's.nml:2: study: the group is repeated')
    call refuse(study//rate//'from = 0 to = 1 count = 2', 's.nml:2: vary: the group that starts here has no final /')
  end subroutine malformed

  !> Refused with these words, and by exit code 2.
  subroutine refuse(text, words)
    character(len=*), intent(in) :: text, words
    type(study_request_t) :: request
    type(error_t), allocatable :: error
    type(text_t) :: none(0)
    character(len=:), allocatable :: warnings
    call read_study_text(text, 's.nml', none, request, warnings, error)
    call expect(allocated(error), 'refused: '//text)
    if (.not. allocated(error)) return
    call expect_equal(error%code, exit_input, 'exit code')
    call expect(index(error%message, words) > 0, '"'//words//'" in: '//error%message)
    call expect(.not. allocated(request%vary), 'nothing is accepted')
  end subroutine refuse

  subroutine round_trip()
    call same_again(study//rate//'from = 0 to = 4 count = 9 /'//nl//'&vary key = ''contact/impulses'' values = ''push_only'' /')
    call same_again(study//'&vary key=''net/clamp_tension'' values = .true. f /'//nl//'&sample kind=''grid'' /')
    call same_again(study//rate//'distribution=''uniform'' from=-0.1 to=0.3333333333333333 /')
    call same_again('&study scene='''//base//''' question=''optimum'' record=''runs'' file=''out.h5'' /'//nl// &
                    '&search key=''bullets/angle'' from=10 to=40 confidence=0.9 budget=99 /')
  end subroutine round_trip

  subroutine same_again(text)
    character(len=*), intent(in) :: text
    type(study_request_t) :: first, second
    call accept(text, first)
    if (.not. allocated(first%vary)) return
    call accept(effective_study(first), second)
    if (.not. allocated(second%vary)) return
    call expect_equal(effective_study(second), effective_study(first), 'the effective study of the effective study')
  end subroutine same_again

  subroutine overrides()
    type(study_request_t) :: request
    type(error_t), allocatable :: error
    type(text_t) :: list(3)
    character(len=:), allocatable :: warnings
    list(1)%chars = 'study/seeds=2'
    list(2)%chars = 'time/end_time=1'
    list(3)%chars = 'vary/count=5'
    call read_study_text(study//rate//'from = 0 to = 4 count = 9 /', 's.nml', list, request, warnings, error)
    call expect(.not. allocated(error), 'is read')
    if (allocated(error)) return
    call expect_equal(request%study%seeds, 2, 'seeds')
    call expect_equal(request%vary(1)%count, 5, 'count')
    call expect_equal(size(request%scene_overrides), 1, 'for the scene')
    call expect_equal(request%scene_overrides(1)%chars, 'time/end_time=1', 'which')
    list(2)%chars = 'time/end_tiem=1'
    call read_study_text(study//rate//'from = 0 to = 4 count = 9 /', 's.nml', list, request, warnings, error)
    call expect(allocated(error), 'a bad override of the scene is refused')
  end subroutine overrides

end module test_study_file
