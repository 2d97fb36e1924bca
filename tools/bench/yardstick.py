#!/usr/bin/env python3
"""castnet's kernel against the C yardstick (grid_kernel.c), interleaved, medians.

    tools/bench/yardstick.py BENCH [--rounds N] [--squares 10,20,40,80,160]

BENCH is the built benchmark: fpm test --target bench --profile release --flag "..." --runner echo.
Times are processor time per node and step; each pair runs side by side, so that the ratio
holds on a busy machine too. General nets: the same net in random order.
"""
import argparse
import os
import statistics
import subprocess
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
FLAGS = "-O3 -march=native -ffp-contract=off -fno-math-errno -fno-trapping-math -mprefer-vector-width=512".split()


def nanoseconds(command):
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[3])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bench")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--squares", default="10,20,40,80,160")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        grid = os.path.join(folder, "grid")
        subprocess.run(["cc", *FLAGS, os.path.join(HERE, "grid_kernel.c"), "-o", grid, "-lm"], check=True)
        print(f"{'nodes':>7} {'method':9} {'castnet':>8} {'C':>8} {'ratio':>6} {'general':>8} {'to square':>9}   ns per node and step")
        for squares in map(int, arguments.squares.split(",")):
            for method in ("rk4", "midpoint"):
                commands = {
                    "castnet": [arguments.bench, "kernel", str(squares), method],
                    "c": [grid, str(squares + 1), method],
                    "general": [arguments.bench, "kernel", str(squares), method, "1", "shuffled"],
                }
                times = {name: [] for name in commands}
                for _ in range(arguments.rounds):
                    for name, command in commands.items():
                        times[name].append(nanoseconds(command))
                median = {name: statistics.median(values) for name, values in times.items()}
                ratio = statistics.median(a / b for a, b in zip(times["castnet"], times["c"]))
                general = statistics.median(a / b for a, b in zip(times["general"], times["castnet"]))
                print(f"{(squares + 1) ** 2 + 4:7d} {method:9} {median['castnet']:8.2f} {median['c']:8.2f} {ratio:6.2f} "
                      f"{median['general']:8.2f} {general:9.2f}", flush=True)


if __name__ == "__main__":
    main()
