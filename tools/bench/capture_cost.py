#!/usr/bin/env python3
"""What a whole rocket capture costs: processor time (user and system) by parts.

    tools/bench/capture_cost.py [--rounds N] [--cases N] [PROGRAM ...]

Case B at 0.4 rad/s, 10 s, contact on, method 'midpoint', step 0, one thread. Programs (default:
the newest build here) take turns; least and median of the rounds, ms:

    start        castnet version
    two steps    a run to 3e-3 s: start, set-up, verdict and file
    last state   the run with its first and last state written
    rows         what 1001 rows of history cost on top of it
    frames       what 101 frames cost on top of it, without VTK
    all output   the run with the default frames, rows and VTK
    flight       last state less two steps
    study case   one of N captures with nudged nodes in a study: no process, no file of its own
"""
import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from castnet_runner import find_castnet  # noqa: E402

SCENE = ROOT / "input" / "rocket_x_0.4.nml"
CAPTURE = ["time/method=midpoint", "time/step=0", "time/end_time=10", "output/verdict_times=10"]
LAST = ["output/frame_interval=10", "output/history_interval=10", "output/vtk=.false."]
ROWS = ["output/frame_interval=10", "output/history_interval=0.01", "output/vtk=.false."]
FRAMES = ["output/history_interval=10", "output/vtk=.false."]
BRIEF = ["time/end_time=3e-3", "output/verdict_times=3e-3"]
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}
PARTS = ["start", "two steps", "last state", "rows", "frames", "all output", "flight", "study case"]
DIFFERENCES = ["rows", "frames", "flight"]


def cost(command, folder):
    """Milliseconds of processor time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=ENVIRONMENT, cwd=folder)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def capture(program, folder, settings):
    overrides = [word for setting in CAPTURE + settings for word in ("--set", setting)]
    return cost([program, "run", SCENE, *overrides, "--output", "capture.h5", "--force", "--quiet", "--threads", "1"], folder)


def study(program, folder, cases):
    (folder / "base.nml").write_text(
        f"&include file = '{SCENE}' /\n&time end_time = 10, method = 'midpoint', step = 0 /\n"
        "&output verdict_times = 10 /\n&perturb node_position = 1e-6 /\n", encoding="utf-8")
    (folder / "study.nml").write_text(
        f"&study scene = 'base.nml', seed = 1, seeds = {cases} /\n"
        "&vary key = 'target/angular_velocity(2)', values = 0.4 /\n", encoding="utf-8")
    return cost([program, "study", "study.nml", "--force", "--quiet", "--threads", "1"], folder) / cases


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", nargs="*", help="default: the newest build here")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--cases", type=int, default=30)
    arguments = parser.parse_args()
    programs = [str(Path(p).resolve()) for p in arguments.program] or [str(find_castnet(None))]
    times = {program: {part: [] for part in PARTS} for program in programs}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for _ in range(arguments.rounds):
            for program, of in times.items():
                of["start"].append(cost([program, "version"], folder))
                of["two steps"].append(capture(program, folder, LAST + BRIEF))
                of["last state"].append(capture(program, folder, LAST))
                of["rows"].append(capture(program, folder, ROWS) - of["last state"][-1])
                of["frames"].append(capture(program, folder, FRAMES) - of["last state"][-1])
                of["all output"].append(capture(program, folder, []))
                of["flight"].append(of["last state"][-1] - of["two steps"][-1])
                of["study case"].append(study(program, folder, arguments.cases))
    for program, of in times.items():
        print(program)
        for part in PARTS:
            # The least difference of two times that vary says nothing.
            least = "" if part in DIFFERENCES else f"least {min(of[part]):6.1f} ms, "
            print(f"    {part:12} {least:18}median {statistics.median(of[part]):6.1f} ms")


if __name__ == "__main__":
    main()
