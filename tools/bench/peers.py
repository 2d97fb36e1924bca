#!/usr/bin/env python3
"""castnet and other codes on the same net, in turns: time against error.

    pip install -r tools/bench/requirements-bench.txt
    tools/bench/peers.py [CASTNET] [--rounds 3] [--only kernel,precision,capture] [-o docs/figures/work_precision.png]

Three comparisons on the rocket net of the paper's Table 2 and its coarser and finer versions:
  kernel     nanoseconds per node and step of a net in flight, 125 to 25,925 nodes; every code's
             positions after up to 0.4 s against castnet's with the same method
  precision  0.5 s of flight (the horizon of chaos is 0.6 s): time of a run against the error of all
             nodes (root mean square), the bullets and the mouth's area, the reference being castnet's
             adaptive at 1e-13, itself held against rk4 at 1e-5 s
  capture    the whole rocket capture (case B, 0.4 rad/s, 10 s, contact on)
Every code starts from the arrays that castnet writes. Codes take turns; times are medians of
processor time (user and system) on one thread. Peers' times leave out imports, compilation and
set-up; castnet's are those of the whole process, less a run of two steps in the first two
comparisons, with everything in the third: there once with the last state written, which is what
the peers give, and once with 101 frames and 1001 history rows. Its flight alone is the first of
these less a run of two steps, as the peers are timed.
"""
import argparse
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", NUMBA_NUM_THREADS="1",
                  XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
import csv
import resource
import statistics
import subprocess
import sys
import tempfile
import time

import h5py
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
TOOLS = os.path.join(ROOT, "tools")
sys.path[:0] = [HERE, TOOLS]
import peer_codes
from bench_page import put
from bench_page import table as markdown
from castnet_runner import find_castnet

sys.path.remove(TOOLS)   # numba asks for a module named coverage and must not get tools/coverage.py

DEPLOYMENT = os.path.join(ROOT, "input", "deployment_rocket.nml")
CAPTURE = os.path.join(ROOT, "input", "rocket_x_0.4.nml")
FLIGHT = 0.5
CHECK_STEP = 1e-5
COMPARED = 0.4, 5e6   # flight after which kernels' positions are compared, in seconds and at most in steps times nodes
SHARE = {"numba": 2, "jax": 4, "warp": 10}   # of castnet's steps that a slower code takes: time is per step
COLOURS = {"castnet": "#c0561c", "numba": "#1f5a92", "jax": "#2d7d46", "warp": "#8a6d1a", "mujoco": "#7a3b8f", "scipy": "0.35"}
MARKERS = {"rk4": "o", "midpoint": "s", "adaptive": "^", "tendons": "D", "DOP853": "v"}


class Castnet:
    """The program as a peer: a process a run."""

    def __init__(self, program, folder):
        self.program, self.output = os.path.abspath(program), os.path.join(folder, "run.h5")

    def run(self, scene, **settings):
        """Processor seconds of the whole process."""
        words = [self.program, "run", scene, "--output", self.output, "--force", "--quiet", "--threads", "1"]
        for key, value in settings.items():
            words += ["--set", f"{key.replace('__', '/')}={value}"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def fly(self, net, method, step, steps, repeats=3, **more):
        """Seconds of so many steps of a net in flight (the least, less the least of two steps), and the last positions."""
        fixed = {"net__squares": f"{net['squares']},{net['squares']}", "net__mesh_length": repr(30.0 / net["squares"]),
                 "time__method": method, "output__vtk": ".false.", **more}

        def seconds(count):
            end = repr(step * count)
            return self.run(DEPLOYMENT, time__step=repr(step), time__end_time=end, output__frame_interval=end,
                            output__history_interval=end, **fixed)
        small, took = np.inf, np.inf
        for _ in range(repeats):
            small, took = min(small, seconds(2)), min(took, seconds(steps))
            if took > 0.2:
                break
        took -= small
        with h5py.File(self.output, "r") as data:
            return took, data["node_position"][-1]

    def net(self, squares):
        """The arrays of a net as castnet starts it; dampings by castnet's rule for zeta = 0.1."""
        net = {"squares": squares}
        self.fly(net, "rk4", 1e-5, 3)
        with h5py.File(self.output, "r") as data:
            static = data["static"]
            net.update(x=data["node_position"][0], v=data["node_velocity"][0], mass=static["node_mass"][:],
                       cables=static["cable_nodes"][:].astype(int), length=static["natural_length"][:],
                       bullets=static["bullet_nodes"][:].astype(int), border=static["perimeter_nodes"][:].astype(int))
            net["k"] = static["axial_stiffness"][:] / net["length"]
        ends = 1.0 / net["mass"][net["cables"]]
        net["c"] = 2.0 * 0.1 * np.sqrt(net["k"] / ends.sum(axis=1))
        net["stretch_rate"], net["compiled"] = net["k"] * ends.sum(axis=1), {}
        net["speed"] = float(np.linalg.norm(net["v"], axis=1).max())
        return net


def damped(net, method, step):
    """The net with the dampings that castnet's method applies: those of midpoint are corrected (midpoint_damping)."""
    if method != "midpoint":
        return net
    return {**net, "c": net["c"] / (1.0 + 0.4 * step * step * net["stretch_rate"])}


def clock(run, *arguments):
    """Processor seconds, of a short run the least of five, and the result."""
    best = np.inf
    for _ in range(5):
        began = time.process_time()
        result = run(*arguments)
        took = time.process_time() - began
        best = min(best, took)
        if took > 0.1:
            break
    return best, result


def available(names):
    """Those of the peers that are installed."""
    found = []
    for name in names:
        try:
            __import__(name)
            found.append(name)
        except ImportError as problem:
            print(f"{name} is left out: {problem}")
    return found


def compare_kernels(castnet, rounds, squares_list, table):
    peers = available(["numba", "jax", "warp"])
    makers = {"numba": peer_codes.numba_run, "jax": peer_codes.jax_run, "warp": peer_codes.warp_run}
    print("\nKernel: ns per node and step, medians; in brackets the ratio to castnet (median of the rounds' ratios)\n"
          f"and the largest difference of positions from castnet's after at most {COMPARED[0]} s of flight")
    for squares in squares_list:
        net = castnet.net(squares)
        nodes, step = len(net["mass"]), 2e-2 / squares / 4
        for method, guess in (("rk4", 35e-9), ("midpoint", 8e-9)):
            steps = max(50, round(0.6 / (nodes * guess)))
            runs = {name: makers[name](damped(net, method, step), method, step, steps) for name in peers}
            few = int(min(COMPARED[0] / step, COMPARED[1] / nodes))
            compared = castnet.fly(net, method, step, few, 1)[1]
            apart = {name: float(np.abs(run(few) - compared).max()) for name, run in runs.items()}
            times = {name: [] for name in ["castnet", *runs]}
            for _ in range(rounds):
                times["castnet"].append(castnet.fly(net, method, step, steps, 1)[0] / steps / nodes * 1e9)
                for name, run in runs.items():
                    count = max(10, steps // SHARE[name])
                    times[name].append(clock(run, count)[0] / count / nodes * 1e9)
            line = f"{nodes:6} {method:9} castnet {statistics.median(times['castnet']):7.1f}"
            for name in times:
                ratio = statistics.median(a / b for a, b in zip(times[name], times["castnet"]))
                table.append(("kernel", name, method, nodes, step, statistics.median(times[name]) * 1e-9, ratio,
                              apart.get(name, 0.0), "", ""))
                if name != "castnet":
                    line += f"   {name} {statistics.median(times[name]):8.1f} ({ratio:5.2f}, {apart[name]:.0e} m)"
            print(line, flush=True)


def kernel_page(table):
    """The kernels' rows as the page's table."""
    rows = {}
    for _, code, method, nodes, _, seconds, ratio, *_ in (row for row in table if row[0] == "kernel"):
        mark = "**" if ratio < (2 if code == "jax" else 1) else ""
        rows.setdefault((nodes, method), {})[code] = f"{1e9 * seconds:.1f}" + ("" if code == "castnet" else f" ({mark}{ratio:.2g}{mark})")
    codes = [code for code in COLOURS if any(code in row for row in rows.values())]
    return markdown(("nodes", "method", *codes), [(*key, *(row.get(code, "") for code in codes)) for key, row in rows.items()])


def mouth_area(net, x):
    """Length of the vector area of the net's border [m2]."""
    border = x[net["border"]]
    return 0.5 * np.linalg.norm(np.cross(border, np.roll(border, -1, axis=0)).sum(axis=0))


def compare_precision(castnet, rounds, table):
    net = castnet.net(20)
    longest = 2.5e-3
    reference = castnet.fly(net, "adaptive", longest, round(FLIGHT / longest), 1, time__tolerance=1e-13)[1]
    check = castnet.fly(net, "rk4", CHECK_STEP, round(FLIGHT / CHECK_STEP), 1)[1]
    apart = np.sqrt(((check - reference) ** 2).sum(axis=1).mean())
    print(f"\nThe reference and rk4 at {CHECK_STEP} s: nodes {apart:.1e} m apart")
    runs = {}
    for method, steps in (("rk4", (2.5e-3, 1e-3, 5e-4, 2.5e-4, 1e-4)), ("midpoint", (1.25e-3, 5e-4, 2.5e-4, 1e-4, 5e-5))):
        for step in steps:
            runs["castnet", method, step] = lambda m=method, s=step: castnet.fly(net, m, s, round(FLIGHT / s), 9)
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-11):
        runs["castnet", "adaptive", tolerance] = lambda t=tolerance: castnet.fly(
            net, "adaptive", longest, round(FLIGHT / longest), 9, time__tolerance=t)
    makers = {
        "numba": (peer_codes.numba_run, (("rk4", 1e-3), ("rk4", 2.5e-4), ("rk4", 1e-4), ("midpoint", 1.25e-3), ("midpoint", 2.5e-4),
                                         ("midpoint", 5e-5))),
        "jax": (peer_codes.jax_run, (("rk4", 1e-3), ("rk4", 2.5e-4), ("rk4", 1e-4), ("midpoint", 1.25e-3), ("midpoint", 2.5e-4),
                                     ("midpoint", 5e-5))),
        "warp": (peer_codes.warp_run, (("rk4", 1e-3), ("rk4", 2.5e-4), ("midpoint", 1.25e-3), ("midpoint", 2.5e-4))),
        "mujoco": (peer_codes.mujoco_run, (("tendons", 1e-3), ("tendons", 2.5e-4))),
    }
    for name in available([*makers, "scipy"]):
        if name == "scipy":
            for tolerance in (1e-5, 1e-7):
                runs[name, "DOP853", tolerance] = lambda f=peer_codes.scipy_run(net, None, tolerance, FLIGHT): clock(f)
            continue
        make, settings = makers[name]
        for method, step in settings:
            fly = make(damped(net, method, step), method, step, round(FLIGHT / step))
            runs[name, method, step] = lambda f=fly: clock(f)
    times, error = {key: [] for key in runs}, {}
    for _ in range(rounds):
        for key, run in runs.items():
            took, x = run()
            times[key].append(took)
            error[key] = (float(np.sqrt(((x - reference) ** 2).sum(axis=1).mean())),
                          float(np.linalg.norm((x - reference)[net["bullets"]], axis=1).max()),
                          float(abs(mouth_area(net, x) - mouth_area(net, reference))))
    print(f"\n{FLIGHT} s of flight\n{'code':8} {'method':9} {'step':>9} {'ms':>9} {'nodes, m':>9} {'bullets, m':>11} {'mouth, m2':>10}")
    for key in runs:
        seconds = statistics.median(times[key])
        print(f"{key[0]:8} {key[1]:9} {key[2]:9.3g} {1e3 * seconds:9.2f} {error[key][0]:9.1e} {error[key][1]:11.1e} "
              f"{error[key][2]:10.1e}")
        table.append(("precision", key[0], key[1], len(net["mass"]), key[2], seconds, "", *error[key]))


def compare_captures(castnet, rounds, table):
    net = castnet.net(20)
    target = {"position": (35.0, 0.0, 0.0), "rate": (0.0, 0.4, 0.0), "mass": 8226.0, "diameter": 3.9, "length": 11.047,
              "threshold": 2e-2}
    across = target["mass"] * (3 * (0.5 * target["diameter"]) ** 2 + target["length"] ** 2) / 12
    target["inertia"] = np.array((across, across, 0.5 * target["mass"] * (0.5 * target["diameter"]) ** 2))
    common = {"time__end_time": 10.0, "output__verdict_times": 10.0, "time__step": 0}
    last_only = {"output__frame_interval": 10.0, "output__history_interval": 10.0, "output__vtk": ".false."}

    def ours(method, alone=False, **more):
        settings, start = {**common, "time__method": method, **more}, 0.0
        if alone:
            brief = {**settings, "time__end_time": 3e-3, "output__verdict_times": 3e-3}
            start = statistics.median(castnet.run(CAPTURE, **brief) for _ in range(3))
        took = castnet.run(CAPTURE, **settings) - start
        with h5py.File(castnet.output, "r") as data:
            return took, (data["node_position"][-1], data["target_velocity"][-1])
    runs = {("castnet", "midpoint", "flight"): lambda: ours("midpoint", True, **last_only),
            ("castnet", "midpoint", "last state"): lambda: ours("midpoint", **last_only),
            ("castnet", "midpoint", "all output"): lambda: ours("midpoint", output__frame_interval=0.1),
            ("castnet", "rk4", "last state"): lambda: ours("rk4", **last_only)}
    found = available(["numba", "mujoco"])
    if "numba" in found:
        runs["numba", "rk4", "1e-3 s"] = lambda f=peer_codes.numba_capture(net, target, 1e-3, 10000): clock(f)
    if "mujoco" in found:
        runs["mujoco", "tendons", "1e-3 s"] = lambda f=peer_codes.mujoco_capture(net, target, 1e-3, 10000): clock(f)
    times, speed = {key: [] for key in runs}, {}
    for _ in range(rounds):
        for key, run in runs.items():
            took, (_, velocity) = run()
            times[key].append(took)
            speed[key] = 1e3 * float(np.linalg.norm(velocity))
    print("\nWhole rocket capture, 10 s\ncode     method                  ms  to the first  target's speed, mm/s")
    first = next(iter(runs))
    for key in runs:
        ratio = statistics.median(a / b for a, b in zip(times[key], times[first]))
        print(f"{key[0]:8} {key[1]:9} {key[2]:10} {1e3 * statistics.median(times[key]):8.1f} {ratio:13.1f} {speed[key]:21.2f}")
        table.append(("capture", *key[:2], len(net["mass"]), key[2], statistics.median(times[key]), ratio, speed[key], "", ""))


def draw(table, output):
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.8), width_ratios=(1.5, 1), layout="constrained")
    axis = axes[0]
    rows = [row for row in table if row[0] == "precision"]
    for code, method in dict.fromkeys(row[1:3] for row in rows):
        chosen = sorted((row[5], row[7]) for row in rows if row[1:3] == (code, method))
        axis.plot(*zip(*[(1e3 * a, 1e3 * b) for a, b in chosen]), marker=MARKERS[method], markersize=5, color=COLOURS[code],
                  linestyle="--" if method == "midpoint" else "-", linewidth=2.2 if code == "castnet" else 1.2,
                  label=f"{code}, {method}")
    axis.set(xscale="log", yscale="log", xlabel=f"processor time of {FLIGHT} s of flight, ms (one core)",
             ylabel="error of the nodes' positions (r.m.s.), mm", title="Error against time: the rocket's net, 445 nodes")
    figure.legend(fontsize="small", ncols=6, loc="outside lower center")
    axis = axes[1]
    rows = [row for row in table if row[0] == "kernel"]
    for code, method in dict.fromkeys(row[1:3] for row in rows):
        chosen = [(row[3], 1e9 * row[5]) for row in rows if row[1:3] == (code, method)]
        axis.plot(*zip(*chosen), marker=MARKERS[method], markersize=5, color=COLOURS[code],
                  linestyle="--" if method == "midpoint" else "-", linewidth=2.2 if code == "castnet" else 1.2)
    axis.set(xscale="log", yscale="log", xlabel="nodes", ylabel="ns per node and step", title="Cost of a step (colours as left)")
    for axis in axes:
        axis.grid(alpha=0.25)
    figure.savefig(output, dpi=110)
    print(output)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("castnet", nargs="?", help="the program (default: the newest build here)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="kernel,precision,capture")
    parser.add_argument("--squares", default="10,20,40,80,160")
    parser.add_argument("--csv", help="all numbers as a table")
    parser.add_argument("--page", action="store_true", help="put the kernels' table into docs/performance.md")
    parser.add_argument("-o", "--output", default=os.path.join(ROOT, "docs", "figures", "work_precision.png"))
    arguments = parser.parse_args()
    table, parts = [], arguments.only.split(",")
    with tempfile.TemporaryDirectory() as folder:
        castnet = Castnet(find_castnet(arguments.castnet), folder)
        if "capture" in parts:
            compare_captures(castnet, arguments.rounds, table)
        if "precision" in parts:
            compare_precision(castnet, arguments.rounds, table)
        if "kernel" in parts:
            compare_kernels(castnet, arguments.rounds, map(int, arguments.squares.split(",")), table)
    if "precision" in parts and "kernel" in parts:
        draw(table, arguments.output)
    if arguments.page and "kernel" in parts:
        put("peers", kernel_page(table))
    if arguments.csv:
        with open(arguments.csv, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(("part", "code", "method", "nodes", "step", "seconds", "ratio", "error", "error_bullets", "error_mouth"))
            writer.writerows(table)


if __name__ == "__main__":
    main()
