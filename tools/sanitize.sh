#!/usr/bin/env bash
# Memory and arithmetic under watch. Prints 'N passed, N failed'.
#
#   tools/sanitize.sh [PART ...]      all parts when none is named
#
#   unit [FILTER]  unit tests on a build with gcc's address and undefined-behaviour
#                  sanitizers, leaks included (10 minutes on one core); with FILTER those
#                  whose name contains it
#   runs           the commands and options of a working day on the same build (1 minute)
#   memcheck       the same commands under valgrind, without sanitizers (5 minutes)
#   memory         a run's memory after 1e3 and 1e4 steps (1 minute)
#
# The two builds take two minutes each. Not in CI.
set -uo pipefail
castnet_test_packages=libopenblas-dev   # LAPACK for the references of some tests
. "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
cd "$castnet_root" || exit 1

parts=
filter=
for word in "${@:-all}"; do
  case $word in
    all) parts="unit runs memcheck memory" ;;
    unit | runs | memcheck | memory) parts="$parts $word" ;;
    *) [ "$parts" = " unit" ] && [ -z "$filter" ] && filter=$word || lacking "'$word' is no part: unit [FILTER], runs, memcheck, memory" ;;
  esac
done
wanted() { case " $parts " in *" $1 "*) true ;; *) false ;; esac }
passed=0
failed=0
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# -O1: the tests stay fast, and every check is still in its place.
sanitizers="-fsanitize=address,undefined -fno-sanitize-recover=undefined"
flags="-O1 -g -fno-omit-frame-pointer -ffp-contract=off $sanitizers"
# Only what is not ours and is kept on purpose to the end of the process:
# libgomp's threads and HDF5's free lists, which live until the library is closed.
cat >"$scratch/leaks" <<'END'
leak:libgomp.so
leak:H5FL_
END
export ASAN_OPTIONS=detect_stack_use_after_return=0:exitcode=99
export LSAN_OPTIONS=suppressions=$scratch/leaks:print_suppressions=0:exitcode=99
export UBSAN_OPTIONS=print_stacktrace=1:halt_on_error=1:exitcode=99

# expect CODE NAME COMMAND...: the exit code, and no word of a sanitizer or of valgrind.
expect() {
  local code=$1 name=$2 seen
  shift 2
  "$@" </dev/null >"$scratch/log" 2>&1
  seen=$?
  if [ $seen -eq "$code" ] && ! grep -Eq 'Sanitizer|runtime error:|ERROR SUMMARY: [1-9]' "$scratch/log"; then
    passed=$((passed + 1))
    echo "ok    $name"
  else
    failed=$((failed + 1))
    echo "FAIL  $name: exit code $seen, expected $code"
    grep -E -A25 'Sanitizer|runtime error:|^==[0-9]+== (Invalid|Conditional|Use of|[0-9,]+ bytes)|^FAIL' "$scratch/log" | head -80
  fi
}

program() {
  (cd "$castnet_root" && fpm run castnet --profile "$1" --flag "$2" --c-flag "$3" --runner echo 2>/dev/null </dev/null) |
    grep -E '/castnet$' | tail -1
}

short="--set time/end_time=0.02 --set output/verdict_times=0.02 --set output/checkpoint_interval=0.005 --quiet"
touching="--set target/position=0.12,0,0 --set contact/friction=0.3"

# The commands and options of a working day, each once, on whatever program is given.
whole_runs() {
  local word=$1 castnet=$2 before=${3:-}
  local base="$castnet_root/input/cubesat.nml"
  rm -rf "$scratch/runs" && mkdir "$scratch/runs"
  printf "&study scene = '%s' seeds = 2 /\n&vary key = 'target/mass' values = 2, 3 /\n&vary key = 'contact/impulses' values = 'push_only', 'equality' /\n" \
    "$base" >"$scratch/runs/study.nml"
  expect 0 "$word: run" $before "$castnet" run "$base" $short --output "$scratch/runs/a.h5"
  expect 0 "$word: restart" $before "$castnet" run "$base" $short --set time/end_time=0.03 --set output/verdict_times=0.03 \
    --output "$scratch/runs/a.h5" --restart "$scratch/runs/a.h5.checkpoint"
  expect 0 "$word: contact with friction, dense solver" $before "$castnet" run "$base" $short $touching \
    --set "contact/solver='dense'" --output "$scratch/runs/b.h5"
  expect 0 "$word: contact of cables" $before "$castnet" run "$base" $short --set target/position=0.12,0,0 \
    --set "contact/detect='cables'" --output "$scratch/runs/c.h5"
  expect 0 "$word: penalty, midpoint" $before "$castnet" run "$base" $short --set target/position=0.12,0,0 \
    --set "contact/law='penalty'" --set contact/stiffness=100 --set "time/method='midpoint'" --output "$scratch/runs/d.h5"
  expect 0 "$word: a closing thread on two threads" $before "$castnet" run "$castnet_root/input/rocket_closing_x_1.1.nml" $short \
    --set "closing/trigger='time'" --set closing/delay=0 --threads 2 --output "$scratch/runs/e.h5"
  expect 3 "$word: a run that explodes" $before "$castnet" run "$base" --quiet --set time/step=4e-4 --set time/allow_unstable=T \
    --set time/end_time=0.3 --set output/verdict_times=0.3 --output "$scratch/runs/f.h5"
  expect 0 "$word: study on two threads" $before "$castnet" study "$scratch/runs/study.nml" --quiet --threads 2 \
    --set time/end_time=0.02 --set output/verdict_times=0.02
  expect 0 "$word: collect" $before "$castnet" collect "$scratch/runs/study.nml" --quiet --set time/end_time=0.02 --set output/verdict_times=0.02
  expect 0 "$word: check" $before "$castnet" check "$castnet_root/input/rocket.nml"
  expect 0 "$word: schema" $before "$castnet" schema
  expect 0 "$word: init" $before "$castnet" init "$scratch/runs/new" --quiet
  expect 2 "$word: a mesh that is refused" $before "$castnet" check "$castnet_root/test/system/fuzz_inputs/mesh_far_stl.nml"
  printf "&net squares = 'a', 1e999 /\n&ned /\n&target shape = 'bx' /\n" >"$scratch/runs/wrong.nml"
  expect 2 "$word: a wrong scene" $before "$castnet" check "$scratch/runs/wrong.nml"
}

build() {
  echo "castnet: building $1"
  fpm build --profile "$2" --flag "$3" --c-flag "$4" >"$scratch/log" 2>&1 </dev/null || {
    tail -40 "$scratch/log"
    lacking "the build $1 failed; the compiler's words stand above."
  }
}

if wanted unit; then
  build "with $sanitizers" debug "$flags" "$flags"
  expect 0 "sanitizers: unit tests $filter" fpm test --target unit --profile debug --flag "$flags" --c-flag "$flags" ${filter:+-- "$filter"}
fi
if wanted runs; then
  build "with $sanitizers" debug "$flags" "$flags"
  sanitized=$castnet_root/$(program debug "$flags" "$flags")
  whole_runs sanitizers "$sanitized"
  expect 0 "sanitizers: accuracy" "$sanitized" accuracy "$castnet_root/input/cubesat.nml" --quiet --threads 2 \
    --set time/end_time=0.02 --set output/verdict_times=0.02 --output "$scratch/runs/accuracy.h5"
fi

# A processor that valgrind knows; sanitizers and valgrind exclude each other.
flags=$(build_flags count)
if wanted memcheck || wanted memory; then
  build "for valgrind" release "$flags" "-O2 -g"
  counted=$castnet_root/$(program release "$flags" "-O2 -g")
fi
if wanted memcheck && command -v valgrind >/dev/null; then
  # Definite leaks only: HDF5 keeps its free lists, libgomp its threads.
  whole_runs memcheck "$counted" "valgrind -q --error-exitcode=99 --leak-check=full --show-leak-kinds=definite --errors-for-leak-kinds=definite"
elif wanted memcheck; then
  echo "skip  valgrind is not installed"
fi

# Resident memory must not grow with the number of steps.
memory() {
  /usr/bin/env python3 - "$counted" "$castnet_root/input/cubesat.nml" "$scratch" "$1" <<'END'
import resource, subprocess, sys
program, scene, scratch, steps = sys.argv[1:]
end = 5.0e-5 * int(steps)
subprocess.run([program, "run", scene, "--quiet", "--force", "--output", scratch + "/memory.h5", "--set", "target/position=0.12,0,0",
                "--set", f"time/end_time={end}", "--set", f"output/verdict_times={end}", "--set", f"output/frame_interval={end / 20}",
                "--set", f"output/history_interval={end / 200}", "--set", f"output/checkpoint_interval={end / 10}"],
               check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
END
}
if wanted memory; then
  few=$(memory 1000)
  many=$(memory 10000)
  # Some pages are the allocator's and vary from run to run: 256 KiB are 28 bytes a step.
  if [ -n "$few" ] && [ -n "$many" ] && [ $((many - few)) -le 256 ]; then
    passed=$((passed + 1))
    echo "ok    memory: $few KiB after 1e3 steps, $many KiB after 1e4"
  else
    failed=$((failed + 1))
    echo "FAIL  memory: $few KiB after 1e3 steps, $many KiB after 1e4"
  fi
fi
echo "$passed passed, $failed failed"
[ $failed -eq 0 ]
