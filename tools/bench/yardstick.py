#!/usr/bin/env python3
"""castnet's kernel against the C yardstick (grid_kernel.c), on general nets, and on threads. Interleaved, medians.

    tools/bench/yardstick.py [--bench PROGRAM] [--only kernel,general,threads] [--rounds 7] [--squares 10,20,40,80,160] [--page]

Without --bench the benchmark is built first (fpm, release flags). Programs take turns, so that ratios
(medians of the rounds' ratios) hold on a busy machine too.
  kernel   processor time per node and step; C: the same law on a bare grid
  general  nets as files may hold them, nodes and cables in random order, to the square net as built
  threads  wall time on one and on two threads, and whether the bits are the same: needs an idle machine
--page puts the tables into docs/performance.md.
"""
import argparse
import os
import statistics
import subprocess
import tempfile

from bench_page import build_bench, put, table

HERE = os.path.dirname(os.path.abspath(__file__))
FLAGS = "-O3 -march=native -ffp-contract=off -fno-math-errno -fno-trapping-math -mprefer-vector-width=512".split()
METHODS = "rk4", "midpoint"
KINDS = {"shuffled": "square, shuffled", "holes": "square, every 100th cable missing", "hexagonal": "hexagons", "radial": "spider's net",
         "round": "squares in a circle", "triangular": "triangles in a hexagon", "irregular": "irregular"}


def run(command):
    """Nodes, ns per node and step, digest of the bits and number of cables (C: without the last)."""
    words = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return int(words[1]), float(words[3]), words[4], int(words[5]) if len(words) > 5 else 0


def take_turns(commands, rounds):
    """Of each command: medians of nanoseconds, of its ratio to the first, and the last answer."""
    answers = {name: [] for name in commands}
    for _ in range(rounds):
        for name, command in commands.items():
            answers[name].append(run(command))
    first = [a[1] for a in answers[next(iter(commands))]]
    return {name: (statistics.median(a[1] for a in got), statistics.median(a[1] / b for a, b in zip(got, first)), got[-1])
            for name, got in answers.items()}


def kernel(bench, squares_list, rounds):
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        grid = os.path.join(folder, "grid")
        subprocess.run(["cc", *FLAGS, os.path.join(HERE, "grid_kernel.c"), "-o", grid, "-lm"], check=True)
        for squares in squares_list:
            for method in METHODS:
                got = take_turns({"C": [grid, str(squares + 1), method], "castnet": [bench, "kernel", str(squares), method]}, rounds)
                rows.append((got["castnet"][2][0], method, f"{got['castnet'][0]:.1f}", f"{got['C'][0]:.1f}", f"{got['castnet'][1]:.2f}"))
    return table(("nodes", "method", "castnet", "C", "castnet / C"), rows)


def general(bench, squares_list, rounds):
    rows = []
    for squares in squares_list:
        for method in METHODS:
            words = [bench, "kernel", str(squares), method, "1"]
            got = take_turns({"square": words} | {kind: [*words, kind] for kind in KINDS}, rounds)
            rows.append((got["square"][2][0], method, f"{got['square'][0]:.1f}",
                         *(f"{got[kind][0]:.1f} ({got[kind][1]:.2f})" for kind in KINDS)))
    return table(("nodes", "method", "square net", *KINDS.values()), rows)


def threads(bench, squares_list, rounds):
    rows = []
    for squares in squares_list:
        for method in METHODS:
            words = [bench, "kernel", str(squares), method]
            # One thread by the wall too: OMP_NUM_THREADS says nothing here, the benchmark's own word counts.
            got = take_turns({2: [*words, "2"], 1: [*words, "1"]}, rounds)
            same = "yes" if got[1][2][2] == got[2][2][2] else "**no**"
            rows.append((got[1][2][0], method, f"{got[1][0]:.1f}", f"{got[2][0]:.1f}", f"{got[1][1]:.2f}", same))
    return table(("nodes", "method", "one thread", "two", "times faster", "same bits"), rows)


TABLES = {"kernel": kernel, "general": general, "threads": threads}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", help="test/bench.f90, built")
    parser.add_argument("--only", default=",".join(TABLES))
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--squares", default="10,20,40,80,160")
    parser.add_argument("--page", action="store_true")
    arguments = parser.parse_args()
    bench = arguments.bench or build_bench()
    squares = [int(word) for word in arguments.squares.split(",")]
    for name in arguments.only.split(","):
        text = TABLES[name](os.path.abspath(bench), squares, arguments.rounds)
        print(f"\n{name}: ns per node and step\n\n{text}", flush=True)
        if arguments.page:
            put(name, text)


if __name__ == "__main__":
    main()
