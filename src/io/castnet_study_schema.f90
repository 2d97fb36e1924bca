!> The table of every group and key of a study file, as `castnet_scene_schema` is of a scene.
module castnet_study_schema
  use castnet_kinds, only: wp
  use castnet_schema, only: schema_t
  use castnet_study_request, only: study_request_t, vary_group_t
  implicit none
  private
  public :: study_table, vary_table, store_vary_lists, study_groups

  character(len=*), parameter :: study_groups = 'study vary sample search'
  character(len=*), parameter :: key_noun = 'a key in quotes, ''group/key(i)'''

contains

  !> The table of a study request, without its &vary groups; &search only if allocated.
  subroutine study_table(request, table)
    type(study_request_t), target, intent(inout) :: request
    type(schema_t), intent(out) :: table
    call table%start()
    associate (t => table, g => request%study)
      call t%group('study', 'What is asked, of which scene.', required=.true.)
      call t%path_key('scene', g%scene, 'base scene, seen from the study''s folder', need='always')
      call t%long_key('seed', g%seed, 'seed of the study: each case''s own seed follows from it')
      call t%word_key('question', g%question, 'map threshold optimum', 'all points; where the probability of '// &
                      'capture crosses a value; where it is best')
      call t%integer_key('seeds', g%seeds, 'runs per point, each with its own draws of &perturb; in a search, '// &
                         'runs added to a point at a time', 1, 10000000)
      call t%word_key('record', g%record, 'table runs', 'a row per case, or also each run''s own file')
      call t%path_key('file', g%file, 'HDF5 file of the results, seen from the study''s folder; --output wins', &
                      fallback='the study''s name with .h5, beside it')
    end associate
    associate (t => table, g => request%sample)
      call t%group('sample', 'How points are laid out over the varied keys.')
      call t%word_key('kind', g%kind, 'grid latin_hypercube sobol', 'every combination, or a design of so many points')
      call t%integer_key('points', g%points, 'points of the design', 1, 100000000, need='a design', use='a design')
    end associate
    if (.not. allocated(request%search)) return
    associate (t => table, g => request%search)
      call t%group('search', 'For the questions ''threshold'' and ''optimum'': along which key, and how sure. '// &
                   'Each combination of the &vary keys has a search of its own; keys drawn '// &
                   'from a distribution are drawn for each run.')
      call t%path_key('key', g%key, 'key along which is searched', need='always', noun=key_noun)
      call t%real_key('from', g%from, '', 'lower end', need='always')
      call t%real_key('to', g%to, '', 'upper end', need='always')
      call t%real_key('probability', g%probability, '-', 'probability of capture whose crossing is sought', &
                      low=1.0e-6_wp, high=0.999999_wp, use='question = ''threshold''')
      call t%real_key('confidence', g%confidence, '-', 'confidence of the interval that is told', &
                      low=0.5_wp, high=0.999999_wp)
      call t%integer_key('budget', g%budget, 'most runs of one search', 2, 100000000)
    end associate
  end subroutine study_table

  !> The table of one &vary; `number` is its place among them.
  subroutine vary_table(vary, number, table)
    type(vary_group_t), target, intent(inout) :: vary
    integer, intent(in) :: number
    type(schema_t), intent(out) :: table
    call table%start()
    table%label = number
    associate (t => table, g => vary)
      call t%group('vary', 'One varied key; repeat the group for each. Give values, or from, to, count, or a '// &
                   'distribution; from and to alone are a range for a design.', repeats=.true.)
      call t%path_key('key', g%key, 'key of the scene', need='always', noun=key_noun)
      call t%word_list('values', g%values, 'list of its values: numbers, words or logicals')
      call t%real_key('from', g%from, '', 'first value, or lower end')
      call t%real_key('to', g%to, '', 'last value, or upper end')
      call t%integer_key('count', g%count, 'values from first to last', 1, 1000000, fallback='none')
      call t%word_key('spacing', g%spacing, 'linear log', 'of the values from first to last')
      call t%word_key('distribution', g%distribution, 'uniform normal', 'drawn for each run: uniform from, to; '// &
                      'normal with mean, deviation')
      call t%real_key('mean', g%mean, '', 'of ''normal''', need='distribution = ''normal''', use='distribution = ''normal''')
      call t%real_key('deviation', g%deviation, '', 'standard deviation of ''normal''', low=0.0_wp, &
                      need='distribution = ''normal''', use='distribution = ''normal''')
    end associate
  end subroutine vary_table

  !> Copy the list of values from the table to its &vary.
  subroutine store_vary_lists(table, vary)
    type(schema_t), intent(in) :: table
    type(vary_group_t), intent(inout) :: vary
    integer :: i
    i = table%find('vary', 'values')
    if (allocated(table%entries(i)%word_list)) vary%values = table%entries(i)%word_list
  end subroutine store_vary_lists

end module castnet_study_schema
