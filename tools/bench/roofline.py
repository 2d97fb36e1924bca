#!/usr/bin/env python3
"""What a cable and a node-step of the force kernel cost, against what this core can do, measured in one go.

    tools/bench/roofline.py [--bench PROGRAM] [--count PROGRAM] [--rounds 5] [--squares 10,20,40,80,160] [--page]

The ceilings come from machine.c: additions and multiplications (without fusing them, as castnet's flags
say), 1/sqrt from square root and divide, bytes from the caches and from memory. Arithmetic and bytes
of a step are counted from the kernel's own formulas (below; bytes are those of the arrays that a sweep
streams through, written lines read first); instructions are callgrind's of the @count build, AVX2, if
valgrind is there. Ceiling: the slowest of the three, each alone. Programs are built where not given.
--page puts the table into docs/performance.md.
"""
import argparse
import os
import shutil
import statistics
import subprocess
import tempfile

from bench_page import build_bench, put, table
from instructions import instructions

HERE = os.path.dirname(os.path.abspath(__file__))
FLAGS = "-O3 -march=native -ffp-contract=off -fno-math-errno -fno-trapping-math -mprefer-vector-width=512".split()

CABLE = 29                     # additions, multiplications and maxima of the tension law, beside one root and one division
INNER, LAST, KICK = 27, 63, 36  # of a node's update in the three directions
PARAMETERS = 6                 # doubles of a node's two cables: stiffness, natural length, damping
# doubles of a node that a sweep reads and writes (a line that is only written is read first)
STREAMS = {"rk4": 3 * (6 + 6 + 1 + PARAMETERS + 2 * 6) - 6 + (6 + 6 + 6 + 1 + PARAMETERS + 6), "midpoint": 9 + 1 + PARAMETERS + 3 + 2 * 6}
FLOPS = {"rk4": 3 * INNER + LAST, "midpoint": KICK}
SWEEPS = {"rk4": 4, "midpoint": 1}
ARRAYS = {"rk4": 21 + 1 + PARAMETERS, "midpoint": 15 + 1 + PARAMETERS}   # doubles of a node that a step touches


def ceilings():
    with tempfile.TemporaryDirectory() as folder:
        program = os.path.join(folder, "machine")
        subprocess.run(["cc", *FLAGS, os.path.join(HERE, "machine.c"), "-o", program, "-lm"], check=True)
        lines = subprocess.run([program], check=True, capture_output=True, text=True).stdout.split("\n")
    return {name: float(value) for name, value in (line.split() for line in lines if line)}


def bandwidth(machine, footprint):
    """Of the smallest measured footprint that holds so many bytes [1e9 bytes/s]."""
    sizes = sorted(int(name) for name in machine if name.isdigit())
    return machine[str(next((size for size in sizes if size >= footprint), sizes[-1]))]


def measure(bench, squares, method, rounds):
    words = [[*subprocess.run([bench, "kernel", str(squares), method], check=True, capture_output=True, text=True).stdout.split()]
             for _ in range(rounds)]
    return int(words[0][1]), int(words[0][5]), statistics.median(float(w[3]) for w in words)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", help="test/bench.f90, built with the release flags")
    parser.add_argument("--count", help="the same with those of @count")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--squares", default="10,20,40,80,160")
    parser.add_argument("--page", action="store_true")
    arguments = parser.parse_args()
    bench = os.path.abspath(arguments.bench or build_bench())
    counted = shutil.which("valgrind") and os.path.abspath(arguments.count or build_bench("count"))
    machine = ceilings()
    rows = []
    for squares in map(int, arguments.squares.split(",")):
        for method in ("rk4", "midpoint"):
            nodes, cables, took = measure(bench, squares, method, arguments.rounds)
            each = SWEEPS[method] * cables / nodes               # cable evaluations of a node-step
            flops = CABLE * each + FLOPS[method]
            bound = {"arithmetic": flops / machine["add_mul"], "root and divide": each / machine["root_divide"],
                     "bytes": 8 * STREAMS[method] / bandwidth(machine, 8 * ARRAYS[method] * nodes)}
            limit = max(bound, key=bound.get)
            code = ""
            if counted:
                few, many = 2, max(6, 40000 // nodes)
                code = (instructions(counted, ["steps", str(squares), method, str(many)])
                        - instructions(counted, ["steps", str(squares), method, str(few)])) / (many - few) / nodes
                code = f"{code:.0f} ({code / each:.0f})"
            rows.append((nodes, method, f"{took:.1f}", f"{took / each:.2f}", code, f"{flops:.0f}", 8 * STREAMS[method],
                         *(f"{value:.1f}" for value in bound.values()), f"{bound[limit] / took:.0%} ({limit})"))
    sizes = sorted((int(name) for name in machine if name.isdigit()))
    words = (f"This core, measured beside it: {machine['fma']:.0f}e9 fused multiply-adds a second, {machine['add_mul']:.0f}e9 additions "
             f"and multiplications, {1 / machine['root_divide']:.2f} ns a root with division; triad "
             + ", ".join(f"{machine[str(size)]:.0f}" for size in sizes)
             + " GB/s over " + ", ".join(f"{size / 2**20:.3g}" for size in sizes) + " MiB.")
    head = ("nodes", "method", "ns a node-step", "ns a cable", "instructions, AVX2 (a cable)", "operations", "bytes",
            "ns: arithmetic", "root and divide", "bytes alone", "of the ceiling")
    text = words + "\n\n" + table(head, rows)
    print(text)
    if arguments.page:
        put("roofline", text)


if __name__ == "__main__":
    main()
