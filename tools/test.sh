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
passed=0
failed=0
log=$(mktemp)

# Whatever happens, the sum is the last line; an end before the end is a failure.
finished=
finish() {
  rm -f "$log"
  [ -n "$finished" ] || failed=$((failed + 1))
  printf '\n%d passed, %d failed\n' $passed $failed
  [ $failed -eq 0 ] && [ $passed -gt 0 ]
  exit $?
}
trap finish EXIT

# Run one group of tests and add its last line to the sum. A group that ends without
# that line, or ends badly without owning up to a failure, counts as one failure.
run_group() {
  local name=$1 status line seconds=$SECONDS
  shift
  printf '\n== %s\n' "$name"
  "$@" </dev/null >"$log" 2>&1
  status=$?
  cat "$log"
  line=$(grep -aEo '^[0-9]+ passed, [0-9]+ failed$' "$log" | tail -1)
  if [ -z "$line" ]; then
    echo "$name: ended with exit code $status and without its counts"
    failed=$((failed + 1))
  else
    passed=$((passed + ${line%% *}))
    line=${line#*, }
    if [ "${line%% *}" -eq 0 ] && [ $status -ne 0 ]; then
      echo "$name: exit code $status although no test failed"
      failed=$((failed + 1))
    else
      failed=$((failed + ${line%% *}))
    fi
  fi
  echo "== $name: $((SECONDS - seconds)) s"
}

# Old counts of lines belong to an old build.
rm -f build/*/castnet/*.gcda
run_group "Fortran tests, check build" \
  fpm test --target unit --profile debug --flag "$(covered_check_flags)" --c-flag "$covered_c_flags" ${filter:+-- "$filter"}
run_group "Fortran tests, release build" \
  fpm test --target unit --profile release --flag "$(release_flags)" --c-flag "$(commit_flags)" ${filter:+-- "$filter"}
if [ -z "$filter" ]; then
  build_castnet
  for script in test/system/*.py; do
    run_group "$script" "$castnet_python" "$script" "$castnet"
  done
  # Commands and refusals once more with everything trapped and every line counted.
  build_checked
  for script in test_cli test_study test_accuracy; do
    run_group "$script.py, check build" "$castnet_python" test/system/$script.py "$castnet_checked"
  done
  run_group "Line coverage of src" "$castnet_python" tools/coverage.py
  run_group "Instructions a cable" "$castnet_python" tools/bench/instructions.py
fi
finished=yes
