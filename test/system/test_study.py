#!/usr/bin/env python3
"""Studies give the same table, bit for bit, whatever happens on the way.

Usage: python3 test/system/test_study.py CASTNET
"""
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

import h5py
import numpy as np

CASTNET = os.path.abspath(sys.argv[1])
INPUT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "input")
passed = failed = 0

SCENE = """
&net squares = 4, 4 mesh_length = 0.175 cable_diameter = 1e-3 edge_cable_diameter = 3e-3 /
&bullets mass = 0.03 speed = 1.8 /
&target shape = 'box' dimensions = 0.1, 0.1, 0.3 mass = 3.5 position = 0.5, 0, 0 angular_velocity = 0, 1.5, 0 /
&contact threshold = 2e-3 /
&time end_time = 0.8 step = 1e-4 /
&perturb node_position = 1e-5 /
"""
STUDY = """
&study scene = 'scene.nml' seed = 7 seeds = {seeds} /
&vary key = 'target/angular_velocity(2)' from = 0 to = 3 count = 5 /
&vary key = 'contact/restitution' values = 1.0, 0.5 /
"""


def check(condition, words):
    global passed, failed
    if condition:
        passed += 1
        print("ok    study:", words)
    else:
        failed += 1
        print("FAIL  study:", words)


def table(path):
    """Every dataset of /case and /point."""
    with h5py.File(path) as f:
        return {g + "/" + k: v[()] for g in ("case", "point") for k, v in f[g].items()}


def same(a, b):
    if a.keys() != b.keys():
        return False
    for k in a:
        x, y = a[k], b[k]
        if x.shape != y.shape or x.dtype != y.dtype:
            return False
        if x.dtype.kind == "f":
            x, y = x.view(np.uint64), y.view(np.uint64)
        if not np.array_equal(x, y):
            return False
    return True


def run(folder, *words, **more):
    return subprocess.run([CASTNET, *words, "--no-progress"], cwd=folder, capture_output=True, text=True, **more)


def write(folder, name, text):
    with open(os.path.join(folder, name), "w") as f:
        f.write(text)


def main():
    folder = tempfile.mkdtemp(prefix="castnet_study_")
    write(folder, "scene.nml", SCENE)
    write(folder, "s.nml", STUDY.format(seeds=6))

    r = run(folder, "study", "s.nml", "--threads", "1", "--output", "one.h5")
    check(r.returncode == 0, "one thread ends with 0 " + r.stderr[-200:])
    one = table(os.path.join(folder, "one.h5"))
    check(one["case/case"].size == 60 and one["point/runs"].sum() == 60, "60 cases, 10 points")
    check(os.path.exists(os.path.join(folder, "one.csv")), "a CSV stands beside it")
    p, lo, hi = one["point/probability"], one["point/lower"], one["point/upper"]
    check(bool(np.all((lo <= p) & (p <= hi))), "each probability lies in its interval")
    run(folder, "study", "s.nml", "--threads", "2", "--output", "two.h5")
    check(same(one, table(os.path.join(folder, "two.h5"))), "two threads, same bits")

    # A case of the study is the scene with its values and seed: run by hand, same result.
    k = 37
    words = ["run", "scene.nml", "--output", "hand.h5", "--set", f"perturb/seed={one['case/seed'][k]}"]
    words += ["--set", f"target/angular_velocity=0,{float(one['case/target.angular_velocity(2)'][k])!r},0"]
    words += ["--set", f"contact/restitution={float(one['case/contact.restitution'][k])!r}"]
    r = run(folder, *words)
    with h5py.File(os.path.join(folder, "hand.h5")) as f:
        speed = np.sqrt((f["target_velocity"][-1] ** 2).sum())
        check(f["summary/coverage"][-1] == one["case/coverage"][k] and abs(speed - one["case/final_speed"][k]) < 1e-16,
              "a case run by hand is the case of the table")

    for n in (3, 7):
        for k in range(1, n + 1):
            r = run(folder, "study", "s.nml", "--shard", f"{k}/{n}", "--output", f"shard{n}.h5")
            if r.returncode != 0:
                check(False, f"shard {k}/{n}: {r.stderr[-200:]}")
        r = run(folder, "collect", "s.nml", "--output", f"shard{n}.h5")
        check(r.returncode == 0 and same(one, table(os.path.join(folder, f"shard{n}.h5"))), f"{n} shards, same bits")

    # Killed again and again, it loses only the cases in flight.
    rng = random.Random(3)
    kills = 0
    for _ in range(60):
        p = subprocess.Popen([CASTNET, "study", "s.nml", "--threads", "2", "--output", "kill.h5", "--quiet"], cwd=folder,
                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            p.wait(rng.uniform(0.02, 0.25))
            break
        except subprocess.TimeoutExpired:
            p.send_signal(signal.SIGKILL)
            p.wait()
            kills += 1
        if kills >= 20:
            break
    r = run(folder, "study", "s.nml", "--threads", "2", "--output", "kill.h5")
    check(r.returncode == 0 and same(one, table(os.path.join(folder, "kill.h5"))), f"{kills} kills, same bits {r.stderr[-200:]}")
    began = time.monotonic()
    r = run(folder, "study", "s.nml", "--output", "kill.h5")
    check(r.returncode == 0 and time.monotonic() - began < 2.0, "started again, it has nothing to do")

    # A signal ends it resumably.
    p = subprocess.Popen([CASTNET, "study", "s.nml", "--threads", "1", "--output", "stop.h5", "--quiet"], cwd=folder,
                         stderr=subprocess.DEVNULL)
    time.sleep(0.3)
    p.send_signal(signal.SIGUSR1)
    code = p.wait()
    check(code in (75, 0), "SIGUSR1 ends it with 75")
    r = run(folder, "study", "s.nml", "--output", "stop.h5")
    check(r.returncode == 0 and same(one, table(os.path.join(folder, "stop.h5"))), "and it goes on to the same bits")

    # Bad points are rows with a reason, and the rest is run.
    write(folder, "bad.nml", "&study scene = 'scene.nml' seed = 1 seeds = 1 /\n"
          "&vary key = 'time/step' values = " + ", ".join(["1e-4"] * 19 + ["0.01"]) + " /\n")
    r = run(folder, "study", "bad.nml")
    check(r.returncode == 0, "a study with 5 % unstable points ends with 0 " + r.stderr[-200:])
    if r.returncode == 0:
        bad = table(os.path.join(folder, "bad.h5"))
        check(int((bad["case/status"] == 2).sum()) == 1 and b"stability limit" in bad["case/reason"][19]
              and int((bad["case/status"] == 0).sum()) == 19, "and names them")

    # Another study on the same journal is refused.
    write(folder, "s.nml", STUDY.format(seeds=5))
    r = run(folder, "study", "s.nml", "--output", "one.h5")
    check(r.returncode in (2, 4) and "another study" in r.stderr, "another study on its journal is refused")
    shutil.rmtree(folder)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0)


main()
