#!/usr/bin/env bash
# From a clean clone to every test: installs what is missing, builds, runs the Fortran
# tests in the check build (everything trapped, every line counted) and in the release
# build, then every system test on the release and some on the check build, and holds the
# share of src's lines that ran to 90 %. The last line is 'N passed, N failed'; the exit
# code is not zero if anything failed. Can be run again without harm.
#
#   tools/test.sh [FILTER]     only Fortran cases whose name contains FILTER, no system tests
set -uo pipefail
castnet_test_packages=libopenblas-dev   # LAPACK for the references of some tests
. "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
cd "$castnet_root" || exit 1

filter=${1:-}
work=$(mktemp -d)
groups=0                 # that should come to an end

# Whatever happens, the sum is the last line; an end before the end is a failure.
finish() {
  local counts=(0 0 0)
  touch "$work/counts"
  read -r -a counts < <(awk '{ n++; p += $1; f += $2 } END { print n + 0, p + 0, f + 0 }' "$work/counts")
  if [ "${counts[0]}" -ne $groups ] || [ $groups -eq 0 ]; then
    echo "only ${counts[0]} of $groups groups of tests came to their end"
    counts[2]=$((counts[2] + 1))
  fi
  rm -rf "$work"
  printf '\n%d passed, %d failed\n' "${counts[1]}" "${counts[2]}"
  [ "${counts[2]}" -eq 0 ] && [ "${counts[1]}" -gt 0 ]
  exit $?
}
trap finish EXIT

# Run one group of tests, print what it said in one piece, and add its last line to the
# counts. A group that ends without that line, or ends badly without owning up to a
# failure, counts as one failure.
run_group() {
  local name=$1 status line log passed=0 failed=0 seconds=$SECONDS
  shift
  log=$(mktemp -p "$work")
  "$@" </dev/null >"$log" 2>&1
  status=$?
  line=$(grep -aEo '^[0-9]+ passed, [0-9]+ failed$' "$log" | tail -1)
  if [ -z "$line" ]; then
    echo "$name: ended with exit code $status and without its counts" >>"$log"
    failed=1
  else
    passed=${line%% *}
    line=${line#*, }
    failed=${line%% *}
    if [ "$failed" -eq 0 ] && [ $status -ne 0 ]; then
      echo "$name: exit code $status although no test failed" >>"$log"
      failed=1
    fi
  fi
  {
    flock 9
    printf '\n== %s\n' "$name"
    cat "$log"
    echo "== $name: $((SECONDS - seconds)) s"
    echo "$passed $failed" >>"$work/counts"
  } 9>"$work/lock"
}

# Old counts of lines belong to an old build.
rm -f build/*/castnet/*.gcda
build_castnet
unit=$(built_tests release "$(release_flags)" "$(commit_flags)") || exit 1
if [ -z "$filter" ]; then build_checked; fi
unit_checked=$(built_tests debug "$(covered_check_flags)" "$covered_c_flags") || exit 1

# Two rows of groups side by side, one for each core; all is built by now (but what the last
# of the first row needs: fpm would not bear two builds at once).
checked=(test_cli test_study test_accuracy test_net_files)
groups=2
if [ -z "$filter" ]; then
  scripts=(test/system/*.py)
  groups=$((groups + ${#checked[@]} + ${#scripts[@]} + 2))
fi
{
  run_group "Fortran tests, check build" "$unit_checked" ${filter:+"$filter"}
  if [ -z "$filter" ]; then
    # Commands and refusals once more with everything trapped and every line counted.
    for script in "${checked[@]}"; do
      run_group "$script.py, check build" "$castnet_python" test/system/$script.py "$castnet_checked"
    done
    run_group "Line coverage of src" "$castnet_python" tools/coverage.py
    run_group "Instructions a cable" "$castnet_python" tools/bench/instructions.py
  fi
} &
{
  run_group "Fortran tests, release build" "$unit" ${filter:+"$filter"}
  if [ -z "$filter" ]; then
    for script in "${scripts[@]}"; do
      run_group "$script" "$castnet_python" "$script" "$castnet"
    done
  fi
} &
wait
