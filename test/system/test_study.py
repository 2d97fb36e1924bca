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
INPUT = os.path.abspath(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "input"))
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


def check_overlap(folder):
    """A target that starts inside the net's plane, among sound ones: named, and the rest is run."""
    write(folder, "overlap.nml", "&study scene = 'scene.nml' /\n&vary key = 'target/position(1)' values = "
          + ", ".join(["0.5"] * 19 + ["0.0"]) + " /\n")
    r = run(folder, "study", "overlap.nml")
    check(r.returncode == 0, "a study with a start inside the target ends with 0 " + r.stderr[-200:])
    if r.returncode == 0:
        rows = table(os.path.join(folder, "overlap.h5"))
        check(rows["case/status"].tolist() == [0] * 19 + [2] and b"starts inside the target" in rows["case/reason"][19],
              "names it and runs the others")
        check(rows["point/runs"].tolist() == [1] * 19 + [0] and np.isnan(rows["point/probability"][19]), "and does not count it")
    r = run(folder, "run", "scene.nml", "--set", "target/position(1)=0", "--output", "overlap_run.h5")
    check(r.returncode == 0 and "warning: target/position: the net starts inside the target" in r.stderr, "a single run warns of it")


def check_varied_files(folder):
    """A mesh that a varied key names is part of the study: with another in its place the journal is refused."""
    corner = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    write(folder, "mesh_scene.nml", SCENE.replace("shape = 'box' dimensions = 0.1, 0.1, 0.3", "shape = 'mesh' file = 'a.obj'"))
    write(folder, "meshes.nml", "&study scene = 'mesh_scene.nml' /\n&vary key = 'target/file' values = 'a.obj', 'b.obj' /\n")

    def mesh(name, size):
        write(folder, name, "".join(f"v {size * x} {size * y} {size * z}\n" for x, y, z in corner)
              + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")

    mesh("a.obj", 0.1)
    mesh("b.obj", 0.2)
    r = run(folder, "study", "meshes.nml", "--set", "time/end_time=0.01")
    check(r.returncode == 0, "a study over meshes " + r.stderr[-200:])
    r = run(folder, "study", "meshes.nml", "--set", "time/end_time=0.01")
    check(r.returncode == 0, "goes on " + r.stderr[-200:])
    mesh("b.obj", 0.3)
    r = run(folder, "study", "meshes.nml", "--set", "time/end_time=0.01")
    check(r.returncode == 2 and "another study" in r.stderr, "and is another one when the second mesh has changed " + r.stderr[-200:])


def check_searches(folder):
    """One search for each combination of the other keys; shards divide them; collect answers."""
    write(folder, "search.nml", "&study scene = 'scene.nml' seed = 3 seeds = 4 question = 'threshold' /\n"
          "&vary key = 'contact/restitution' values = 1.0, 0.5 /\n"
          "&vary key = 'target/position(2)' distribution = 'uniform' from = -0.05 to = 0.05 /\n"
          "&search key = 'net/mesh_length' from = 0.05 to = 0.25 probability = 0.3 budget = 60 /\n")
    r = run(folder, "study", "search.nml", "--output", "search_whole.h5")
    check(r.returncode == 0, "two searches end with 0 " + r.stderr[-200:])
    whole = table(os.path.join(folder, "search_whole.h5"))
    with h5py.File(os.path.join(folder, "search_whole.h5")) as f:
        search = {k: v[()] for k, v in f["search"].items()}
    e, point = whole["case/contact.restitution"], whole["case/point"]
    check(search["contact.restitution"].tolist() == [1.0, 0.5] and (e == 1.0).any() and (e == 0.5).any(),
          "each value of the other key has its search")
    check(all((e[whole["case/case"] <= 60] == 1.0)) and all((e[whole["case/case"] > 60] == 0.5)), "with its own case numbers")
    check(np.unique(whole["case/target.position(2)"]).size == e.size, "a drawn key is drawn for each run")
    sound = whole["case/status"] == 0
    check(all(whole["point/runs"][p - 1] == (sound & (point == p)).sum() and
              whole["point/captured"][p - 1] == whole["case/captured"][sound & (point == p)].sum() for p in np.unique(point)),
          "/case/point is the line of /point")
    check(r.stdout.count("P(captured)") == 2 and "contact/restitution = 0.5: " in r.stdout, "and an answer for each")
    r = run(folder, "study", "search.nml", "--shard", "2/2", "--output", "parts.h5")
    r = run(folder, "collect", "search.nml", "--output", "parts.h5")
    check("1 searches are not finished" in r.stderr and "not finished" in r.stdout, "collect says which search is not finished")
    r = run(folder, "study", "search.nml", "--shard", "1/2", "--output", "parts.h5")
    r = run(folder, "collect", "search.nml", "--output", "parts.h5")
    check(r.returncode == 0 and same(whole, table(os.path.join(folder, "parts.h5"))), "sharded searches, same bits")
    r = run(folder, "study", "search.nml", "--set", "vary(1)/values=1.0", "--shard", "1/2", "--output", "single.h5")
    check(r.returncode == 2 and "cannot be divided" in r.stderr, "a single search cannot be divided")


def check_runs(folder):
    """record = 'runs': the same table, and each run's file; kills and lost files are made good."""
    words = ["--set", "study/record=runs", "--output"]
    write(folder, "kept.nml", STUDY.format(seeds=3))
    run(folder, "study", "kept.nml", "--output", "plain.h5")
    plain = table(os.path.join(folder, "plain.h5"))
    r = run(folder, "study", "kept.nml", "--threads", "2", *words, "kept.h5")
    check(r.returncode == 0 and same(plain, table(os.path.join(folder, "kept.h5"))), "with the runs' files, same table " + r.stderr[-200:])
    check("30 runs of" in r.stderr, "and says beforehand what they take")
    runs = os.path.join(folder, "kept.runs")
    check(sorted(os.listdir(runs)) == [f"case_{k:06d}.h5" for k in range(1, 31)], "a file for each case")
    with h5py.File(os.path.join(runs, "case_000030.h5")) as f:
        check(f["summary/coverage"][-1] == plain["case/coverage"][29] and f["meta/status"][()] == b"complete",
              "which is the run of its row")
    os.remove(os.path.join(runs, "case_000007.h5"))
    r = run(folder, "study", "kept.nml", *words, "kept.h5")
    check(r.returncode == 0 and len(os.listdir(runs)) == 30 and same(plain, table(os.path.join(folder, "kept.h5"))),
          "a lost file is made again")
    rng = random.Random(5)
    for _ in range(6):
        p = subprocess.Popen([CASTNET, "study", "kept.nml", "--threads", "2", *words, "torn.h5", "--quiet"], cwd=folder,
                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            p.wait(rng.uniform(0.1, 0.6))
        except subprocess.TimeoutExpired:
            p.send_signal(signal.SIGKILL)
            p.wait()
    r = run(folder, "study", "kept.nml", "--threads", "2", *words, "torn.h5")
    torn = os.path.join(folder, "torn.runs")
    sound = r.returncode == 0 and sorted(os.listdir(torn)) == sorted(os.listdir(runs))
    for name in os.listdir(torn) if sound else []:
        with h5py.File(os.path.join(torn, name)) as a, h5py.File(os.path.join(runs, name)) as b:
            sound = sound and np.array_equal(a["node_position"][()], b["node_position"][()])
    check(sound and same(plain, table(os.path.join(folder, "torn.h5"))), "killed six times, the same files and table")
    big = ["--set", "study/seeds=100000", "--set", "output/frame_interval=1e-4"]
    try:
        r = run(folder, "study", "kept.nml", *words, "big.h5", *big, timeout=60)
        check(r.returncode == 4 and "too small" in r.stderr and os.listdir(os.path.join(folder, "big.runs")) == [],
              "more than the disk holds is refused before the first run")
    except subprocess.TimeoutExpired:
        print("skip  this disk holds terabytes")


def check_races(folder):
    """Thousands of the shortest cases: values pass through text, and threads must not meet there."""
    write(folder, "body.nml", "&target shape = 'sphere' dimensions = 1 mass = 1 position = 0, 0, 0 /\n"
          "&time end_time = 1e-3 step = 1e-3 /\n")
    write(folder, "many.nml", "&study scene = 'body.nml' seed = 7 seeds = 4000 /\n"
          "&vary key = 'target/velocity(1)' distribution = 'uniform' from = 1 to = 2 /\n")
    run(folder, "study", "many.nml", "--threads", "1", "--output", "many1.h5")
    run(folder, "study", "many.nml", "--threads", "4", "--output", "many4.h5")
    one, four = (table(os.path.join(folder, f"many{n}.h5")) for n in (1, 4))
    check(bool((one["case/status"] == 0).all()) and same(one, four), "4000 short cases on four threads, same bits")


def check_clusters(folder):
    """The scripts for GNU parallel and Dask give the table of one process."""
    tools = os.path.join(os.path.dirname(INPUT), "tools", "cluster")
    write(folder, "spread.nml", STUDY.format(seeds=2))
    run(folder, "study", "spread.nml", "--output", "spread_whole.h5")
    whole = table(os.path.join(folder, "spread_whole.h5"))
    options = os.environ | {"CASTNET": CASTNET}

    def script(name, *words, more=None):
        command = [sys.executable] if name.endswith(".py") else ["bash"]
        return subprocess.run(command + [os.path.join(tools, name), "spread.nml", "3", *words], cwd=folder, capture_output=True,
                              text=True, env=options | (more or {}), stdin=subprocess.DEVNULL, timeout=300)

    if shutil.which("parallel"):
        r = script("study_parallel.sh", "-j", "2", more={"CASTNET_OPTIONS": "--output parallel.h5"})
        check(r.returncode == 0 and same(whole, table(os.path.join(folder, "parallel.h5"))),
              "GNU parallel, same bits " + r.stderr[-300:])
        r = script("study_parallel.sh", more={"CASTNET_OPTIONS": "--set study/sead=1"})
        check(r.returncode != 0 and "did you mean seed" in r.stderr, "and a shard that fails fails the script")
    else:
        print("skip  GNU parallel is not installed")
    try:
        import distributed  # noqa: F401
    except ImportError:
        print("skip  the package distributed is not installed")
        return
    r = script("study_dask.py", "--", "--output", "dask.h5")
    check(r.returncode == 0 and same(whole, table(os.path.join(folder, "dask.h5"))), "Dask, same bits " + r.stderr[-300:])
    r = script("study_dask.py", "--", "--set", "study/sead=1")
    check(r.returncode != 0 and "did you mean seed" in r.stderr, "and a shard that fails fails the script")


def check_pictures(folder):
    """plot_study.py draws each kind of study: a curve, a map, a search, many keys."""
    write(folder, "design.nml", "&study scene = 'scene.nml' seed = 5 /\n&sample kind = 'sobol' points = 32 /\n"
          "&vary key = 'target/angular_velocity(2)' from = 0 to = 3 /\n&vary key = 'bullets/speed' from = 1.5 to = 2.5 /\n"
          "&vary key = 'target/position(1)' from = 0.3 to = 0.6 /\n")
    run(folder, "study", "design.nml")
    write(folder, "line.nml", "&study scene = 'scene.nml' seed = 5 seeds = 6 /\n&vary key = 'bullets/speed' from = 1.5 to = 2.5 count = 3 /\n")
    run(folder, "study", "line.nml")
    tool = os.path.join(os.path.dirname(INPUT), "tools", "plot_study.py")
    for name, words in (("line", "a curve"), ("one", "a map"), ("search_whole", "a search"), ("design", "a ranking")):
        picture = os.path.join(folder, name + ".png")
        r = subprocess.run([sys.executable, tool, os.path.join(folder, name + ".h5"), "-o", picture], capture_output=True, text=True)
        check(r.returncode == 0 and os.path.getsize(picture) > 10000, "plot_study.py draws " + words + " " + r.stderr[-300:])


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
    journal = os.path.join(folder, "kill.h5.cases")
    with open(journal, "rb") as f:
        before = f.read()
    r = run(folder, "study", "s.nml", "--output", "kill.h5")
    with open(journal, "rb") as f:
        check(r.returncode == 0 and f.read() == before, "started again, it has nothing to do")

    # A signal ends it resumably.
    p = subprocess.Popen([CASTNET, "study", "s.nml", "--threads", "1", "--output", "stop.h5", "--quiet"], cwd=folder,
                         stderr=subprocess.DEVNULL)
    # The first case in the journal: by then the study listens.
    journal = os.path.join(folder, "stop.h5.cases")
    while p.poll() is None and not (os.path.exists(journal) and os.path.getsize(journal) > 100):
        time.sleep(0.002)
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

    check_overlap(folder)
    check_varied_files(folder)
    check_searches(folder)
    check_runs(folder)
    check_races(folder)
    check_clusters(folder)
    check_pictures(folder)

    # Another study on the same journal is refused.
    write(folder, "s.nml", STUDY.format(seeds=5))
    r = run(folder, "study", "s.nml", "--output", "one.h5")
    check(r.returncode in (2, 4) and "another study" in r.stderr, "another study on its journal is refused")
    shutil.rmtree(folder)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0)


main()
