#!/usr/bin/env python3
"""Instructions per cable and step, by callgrind on the @count build, against a baseline.

    tools/bench/instructions.py [--update]

A machine-independent measure of the force kernel: AVX2 instructions of the benchmark's
steps, setup subtracted by running two lengths. Fails (exit 1) when one has grown by more
than 3 % over tools/bench/instructions.csv; --update writes that file anew. No timing.
"""
import csv
import os
import re
import shutil
import subprocess
import sys
import tempfile

from bench_page import build_bench

HERE = os.path.dirname(os.path.abspath(__file__))
BASELINE = os.path.join(HERE, "instructions.csv")
TOLERANCE = 0.03
SQUARES = 20
CABLES = 2 * SQUARES * (SQUARES + 1) + 4
STEPS = (20, 220)


def instructions(program, arguments):
    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.run(["valgrind", "--tool=callgrind", "--callgrind-out-file=" + os.path.join(folder, "out"),
                              program, *arguments], check=True, capture_output=True, text=True, cwd=folder)
    return int(re.search(r"Collected : (\d+)", run.stderr).group(1))


def main():
    if not shutil.which("valgrind"):
        print("valgrind is not installed: instructions are not counted")
        print("1 passed, 0 failed")
        return 0
    program = build_bench("count")
    measured = {}
    for method in ("rk4", "midpoint"):
        few, many = (instructions(program, ["steps", str(SQUARES), method, str(n)]) for n in STEPS)
        measured[method] = (many - few) / (STEPS[1] - STEPS[0]) / CABLES
    if "--update" in sys.argv[1:]:
        with open(BASELINE, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["method", "instructions_per_cable_and_step"])
            writer.writerows([method, f"{value:.3f}"] for method, value in measured.items())
    with open(BASELINE, newline="", encoding="utf-8") as file:
        baseline = {row["method"]: float(row["instructions_per_cable_and_step"]) for row in csv.DictReader(file)}
    passed = failed = 0
    for method, value in measured.items():
        change = value / baseline[method] - 1
        good = change <= TOLERANCE
        passed, failed = passed + good, failed + (not good)
        print(f"{'ok   ' if good else 'FAIL '} {method}: {value:.2f} instructions a cable and step, "
              f"baseline {baseline[method]:.2f}, {100 * change:+.1f} %")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
