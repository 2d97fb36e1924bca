#!/usr/bin/env python3
"""Nothing lost: kills, signals, full and read-only disks, damaged checkpoints, locks.

    test_faults.py PATH_TO_CASTNET [KILLS]

A run that was interrupted in any way and restarted must end in the bits of the run that
was not. KILLS (default 30) SIGKILLs fall at random moments over three scenes; the seed
is printed. Tests that need a mount say so and are left out where mounting is forbidden.
"""
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

ROOT = Path(__file__).resolve().parents[2]
INPUT = ROOT / "input"
CASTNET = str(Path(sys.argv[1]).resolve())
KILLS = int(sys.argv[2]) if len(sys.argv) > 2 else 30
results: list[bool] = []

CUBESAT = (INPUT / "cubesat.nml", ["output/checkpoint_interval=0.1"])
DEPLOYMENT = (INPUT / "deployment_cubesat.nml", ["output/checkpoint_interval=0.05"])
MIDPOINT = (DEPLOYMENT[0], [*DEPLOYMENT[1], "time/method='midpoint'"])
CLOSING = (INPUT / "rocket_closing_x_1.1.nml", ["output/checkpoint_interval=0.5", "output/frame_interval=0.05",
                                                  "time/end_time=7.5", "output/verdict_times=7.5"])

VTK_READER = r"""
import json, sys
import vtk
for path in sys.argv[1:]:
    print(path, flush=True)
    reader = vtk.vtkHDFReader()
    reader.SetFileName(path)
    reader.UpdateInformation()
    steps = reader.GetNumberOfSteps()
    for step in {0, steps // 2, steps - 1} if steps > 0 else set():
        reader.SetStep(step)
        reader.Update()
        if reader.GetOutputDataObject(0).GetNumberOfPoints() == 0:
            sys.exit(3)
"""


def check(name: str, good: bool, seen: object = "") -> bool:
    """Note one claim."""
    results.append(bool(good))
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f"\n      seen: {seen}"), flush=True)
    return bool(good)


def command(scene, output: Path, *more: str) -> list[str]:
    path, settings = scene
    line = [CASTNET, "run", str(path), "--output", str(output)]
    for setting in settings:
        line += ["--set", setting]
    return line + list(more)


def run(scene, output: Path, *more: str) -> subprocess.CompletedProcess:
    return subprocess.run(command(scene, output, *more), capture_output=True, text=True, timeout=600, check=False)


def start(scene, output: Path, *more: str) -> subprocess.Popen:
    """With Ctrl-C as at a prompt: what a shell starts behind the scenes would ignore it."""
    return subprocess.Popen(command(scene, output, *more), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))


def beside(output: Path, ending: str) -> Path:
    return output.with_name(output.name + ending)


def restart(scene, output: Path, *more: str) -> subprocess.CompletedProcess:
    return run(scene, output, "--restart", str(beside(output, ".checkpoint")), *more)


def values(path: Path) -> dict[str, bytes]:
    """Every result of a run to the bit: all but /meta and the wall time."""
    found: dict[str, bytes] = {}

    def add(name: str, item) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("meta/") and name != "summary/wall_time":
            data = item[()]
            found[name] = repr(data.tolist()).encode() if item.dtype.kind == "O" else np.asarray(data).tobytes()

    with h5py.File(path) as file:
        file.visititems(add)
    return found


def different(path: Path, reference: dict[str, bytes]) -> list[str]:
    """Names of what is not the same, to the bit."""
    seen = values(path)
    return sorted(name for name in seen.keys() | reference.keys() if seen.get(name) != reference.get(name))


def digest(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir()) if p.is_file()}


def wait_for(condition, seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.002)
    return False


def standing(process: subprocess.Popen) -> bool:
    try:
        return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
    except OSError:
        return False


def caught(scene, output: Path, ending: str, *more: str) -> subprocess.Popen:
    """A run that stands still (SIGSTOP) in its middle, with OUTPUT+ending there: what is done to it
    then does not hang on how fast the machine is. `let_go` lets it run on."""
    for _ in range(10):
        for old in output.parent.glob(output.name + "*"):
            old.unlink()
        process = start(scene, output, *more)
        wait_for(lambda: beside(output, ending).exists() or process.poll() is not None)
        process.send_signal(signal.SIGSTOP)
        wait_for(lambda: standing(process) or process.poll() is not None)
        if process.poll() is None and beside(output, ".part").exists():
            return process
        process.kill()
        process.communicate()
    raise RuntimeError("the run was always over before it was caught")


def let_go(process: subprocess.Popen, *signals: int) -> tuple[int, str]:
    """Send signals to a run that stands still, let it go on to its end; exit code and words."""
    for number in signals:
        process.send_signal(number)
    process.send_signal(signal.SIGCONT)
    words = process.communicate(timeout=300)[1]
    return process.returncode, words


def short(done: subprocess.CompletedProcess) -> bool:
    """At most three lines of error, and no backtrace."""
    return len(done.stderr.strip().splitlines()) <= 3 and "Backtrace" not in done.stderr and "#0" not in done.stderr


@contextmanager
def small_disk(size: str):
    """A tmpfs of a given size, or None where mounting is forbidden."""
    folder = Path(tempfile.mkdtemp(prefix="castnet_disk_"))
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True,
                          text=True, check=False)
    try:
        if done.returncode != 0:
            print(f"skip  no tmpfs can be mounted here: {done.stderr.strip()}")
            yield None
        else:
            yield folder
    finally:
        if done.returncode == 0:
            subprocess.run(["umount", str(folder)], check=False)
        folder.rmdir()


# ---- kills ---------------------------------------------------------------------------


def readable(path: Path) -> str:
    """What h5py and xarray find wrong with a killed run's file; '' if nothing."""
    try:
        with h5py.File(path) as file:
            file.visititems(lambda name, item: item[()] if isinstance(item, h5py.Dataset) else None)
            lengths = {name: file[name].shape[0] for name in file
                       if isinstance(file[name], h5py.Dataset) and file[name].maxshape[0] is None}
            if len(set(lengths.values())) != 1:
                return f"uneven frames: {lengths}"
            for name in lengths:
                if np.isnan(file[name][()]).any():
                    return f"a frame of {name} is not there"
        with xr.open_dataset(path) as data, xr.open_dataset(path, group="history") as history:
            data.load()
            history.load()
    except Exception as error:  # noqa: BLE001 - whatever the reader says is the finding
        return repr(error)
    return ""


def check_vtk(name: str, paths: list[Path]) -> None:
    """All files in one process: starting VTK takes longer than reading."""
    done = subprocess.run([sys.executable, "-c", VTK_READER, *map(str, paths)], capture_output=True, text=True,
                          timeout=600, check=False)
    check(name, done.returncode == 0 and len(done.stdout.splitlines()) == len(paths),
          f"exit code {done.returncode} at {done.stdout.splitlines()[-1:]} {done.stderr[-300:]}")


def check_kills(folder: Path) -> None:
    seed = int(os.environ.get("CASTNET_SEED", random.randrange(10**9)))
    print(f"      {KILLS} kills, CASTNET_SEED={seed}")
    # a method that carries something from step to step is the harder test
    probe = run(MIDPOINT, folder / "probe.h5", "--set", "time/end_time=0.01")
    deployment = DEPLOYMENT if "not available yet" in probe.stderr else MIDPOINT
    chance = random.Random(seed)
    for label, scene in (("cubesat", CUBESAT), ("deployment", deployment), ("closing", CLOSING)):
        reference_path = folder / "reference.h5"
        began = time.monotonic()
        done = run(scene, reference_path, "--force", "--threads", "1")
        duration = time.monotonic() - began
        if not check(f"kills, {label}: the reference runs", done.returncode == 0, done.stderr):
            continue
        reference = values(reference_path)
        faults, kept, restarts, kills, frames = [], [], 0, 0, 0
        while kills < KILLS // 3:
            output = folder / "killed.h5"
            for old in folder.glob("killed.h5*"):
                old.unlink()
            more: list[str] = []
            while True:  # one run, killed again and again until it is through
                process = start(scene, output, *more, "--threads", chance.choice("124"))
                if kills < KILLS // 3 and chance.random() < 0.8:
                    time.sleep(chance.uniform(0.0, 1.1 * duration))
                    process.kill()
                    kills += 1
                process.communicate()
                if process.returncode == 0:
                    break
                if process.returncode != -signal.SIGKILL:
                    faults.append(f"exit code {process.returncode}")
                    break
                time.sleep(0.05)
                part = beside(output, ".part")
                if part.exists():
                    if fault := readable(part):
                        faults.append(fault)
                    copy = folder / f"copy_{kills}.h5"
                    shutil.copy(part, copy)
                    kept.append(copy)
                    with h5py.File(part) as file:
                        frames += file["time"].shape[0]
                has_checkpoint = any(beside(output, e).exists() for e in (".checkpoint", ".checkpoint.previous"))
                more = ["--restart", str(beside(output, ".checkpoint"))] if has_checkpoint else ["--force"]
                restarts += has_checkpoint
            if output.exists() and (names := different(output, reference)):
                faults.append(f"other bits: {names}")
        check(f"kills, {label}: {kills} kills, {restarts} restarts, {frames} frames kept; files whole, final bits the same",
              not faults, faults[:5])
        check_vtk(f"kills, {label}: VTK opens all {len(kept)} files", kept)
        for old in kept:
            old.unlink()


# ---- signals and limits ------------------------------------------------------------------


def check_signals(folder: Path) -> None:
    output = folder / "signal.h5"
    reference_path = folder / "signal_reference.h5"
    run(CUBESAT, reference_path, "--threads", "1")
    reference = values(reference_path)
    for name, number, code in (("SIGUSR1", signal.SIGUSR1, 75), ("SIGTERM", signal.SIGTERM, 75), ("SIGINT", signal.SIGINT, 130)):
        seen, words = let_go(caught(CUBESAT, output, ".checkpoint"), number)
        check(f"signals: {name} gives exit code {code} and says how to go on", seen == code and "--restart" in words, (seen, words))
        check(f"signals: {name} leaves .part and .checkpoint, no lock", not output.exists() and
              sorted(p.name[len(output.name):] for p in folder.glob("signal.h5*")) in
              (['.checkpoint', '.checkpoint.previous', '.part'], ['.checkpoint', '.part']), list(folder.glob("signal.h5*")))
        with h5py.File(beside(output, ".part")) as file:
            check(f"signals: {name} is told in /meta", file["meta/status"].asstr()[()] == "stopped")
        done = restart(CUBESAT, output, "--threads", "2")
        check(f"signals: after {name} the restart ends in the same bits, on two threads",
              done.returncode == 0 and not different(output, reference),
              (done.returncode, done.stderr, output.exists() and different(output, reference)))
    # two that wait together: the second comes while the first is only a request
    seen, words = let_go(caught(CUBESAT, output, ".part"), signal.SIGTERM, signal.SIGUSR1)
    check("signals: a second one ends it at once, exit code 75", seen == 75 and "--restart" not in words
          and beside(output, ".lock").exists(), (seen, words))
    slow = (CUBESAT[0], ["time/step=2.0e-6"])
    done = run(slow, folder / "wall.h5", "--max-wall", "00:00:01")
    check("signals: --max-wall stops with 75 and a checkpoint", done.returncode == 75
          and beside(folder / "wall.h5", ".checkpoint").exists(), (done.returncode, done.stderr))


# ---- restarts --------------------------------------------------------------------------


def stopped(scene, output: Path) -> None:
    """Leave a stopped run with at least two checkpoints."""
    let_go(caught(scene, output, ".checkpoint.previous"), signal.SIGTERM)


def check_restarts(folder: Path) -> None:
    output = folder / "restart.h5"
    reference_path = folder / "restart_reference.h5"
    run(CUBESAT, reference_path)
    reference = values(reference_path)
    stopped(CUBESAT, output)
    before = digest(folder)
    other = (CUBESAT[0], [*CUBESAT[1], "target/mass=4.0", "contact/restitution=0.5"])
    done = restart(other, output)
    check("restart: another scene is refused, each difference named", done.returncode == 2 and "target/mass" in done.stderr
          and "contact/restitution" in done.stderr and "net/" not in done.stderr, (done.returncode, done.stderr))
    check("restart: and nothing was touched", digest(folder) == before)
    new = folder / "restart_new.h5"
    done = run(CUBESAT, new, "--restart", str(beside(output, ".checkpoint")))
    with h5py.File(new) as file, h5py.File(reference_path) as whole:
        n = file["time"].shape[0]
        check("restart: into a new file, which holds the rest to the bit", done.returncode == 0 and
              0 < n < whole["time"].shape[0] and all(np.array_equal(file[k][()], whole[k][-n:]) for k in
                                                     ("time", "node_position", "cable_tension", "target_attitude")), done.stderr)
        check("restart: lineage in /meta", file["meta/sessions/1/checkpoint"].asstr()[()].endswith(".checkpoint")
              and file["meta/sessions/1/from_step"][()] > 0)
    done = restart(CUBESAT, output)
    check("restart: and into the same file as well", done.returncode == 0 and not different(output, reference), done.stderr)
    with h5py.File(output) as file:
        check("restart: two sessions in /meta", sorted(file["meta/sessions"]) == ["1", "2"])
    longer = folder / "longer.h5"
    done = run((CUBESAT[0], [*CUBESAT[1], "time/end_time=2.0", "output/verdict_times=3.0"]), longer)
    if done.returncode != 0:  # verdicts must lie within the run
        done = run((CUBESAT[0], [*CUBESAT[1], "time/end_time=2.0", "output/verdict_times=2.0"]), longer)
    done = restart(CUBESAT, longer)
    check("restart: a finished run goes on to a later end and is the longer run to the bit",
          done.returncode == 0 and not different(longer, reference), (done.stderr, different(longer, reference)))


def check_replacing(folder: Path) -> None:
    """--force without room for a new file, here by a limit on the length of files: what it would have replaced stands."""
    output = folder / "replaced.h5"
    stopped(CUBESAT, output)
    before = digest(folder)
    ends = []
    for length in (4096, 61440, 100000):
        done = subprocess.run(command(CUBESAT, output, "--force", "--quiet"), capture_output=True, text=True, timeout=300, check=False,
                              preexec_fn=lambda n=length: resource.setrlimit(resource.RLIMIT_FSIZE, (n, n)))
        ends.append(done.returncode if short(done) else done.stderr)
    check("replacing: --force without room: exit code 4", ends == 3*[4], ends)
    left = digest(folder)
    check("replacing: the old .part and its checkpoints are there, nothing else", left == before and len(left) == 3,
          (sorted(before), sorted(left)))


def check_damaged_checkpoints(folder: Path) -> None:
    output = folder / "damaged.h5"
    reference_path = folder / "damaged_reference.h5"
    run(CUBESAT, reference_path)
    reference = values(reference_path)
    chance = random.Random(7)
    for label in ("truncated", "bit-flipped", "empty", "missing"):
        stopped(CUBESAT, output)
        path = beside(output, ".checkpoint")
        data = bytearray(path.read_bytes())
        if label == "bit-flipped":
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data[: {"truncated": len(data) // 2, "empty": 0}.get(label, len(data))])
        if label == "missing":
            path.unlink()
        done = restart(CUBESAT, output)
        check(f"checkpoint: {label}: the previous one serves, with a warning, and the bits are the same",
              done.returncode == 0 and "warning" in done.stderr and not different(output, reference),
              (done.returncode, done.stderr))
    stopped(CUBESAT, output)
    for ending in (".checkpoint", ".checkpoint.previous"):
        path = beside(output, ending)
        path.write_bytes(path.read_bytes()[:-1])
    before = digest(folder)
    done = restart(CUBESAT, output)
    check("checkpoint: both damaged: exit code 4, said in short, and nothing was touched",
          done.returncode == 4 and short(done) and digest(folder) == before, (done.returncode, done.stderr))
    done = run(CUBESAT, folder / "x.h5", "--restart", str(folder / "no_such.checkpoint"))
    check("checkpoint: none there: exit code 4", done.returncode == 4 and short(done), (done.returncode, done.stderr))


# ---- the files that a scene reads ---------------------------------------------------------


def net_scene(folder: Path) -> tuple[Path, list[str]]:
    """A scene that includes another and reads a net and a mesh."""
    y, z = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    position = np.stack([np.zeros(16), 0.1 * y.ravel(), 0.1 * z.ravel()], axis=1)
    cables = [[4 * i + j, 4 * i + j + 1] for i in range(4) for j in range(3)] + [[4 * i + j, 4 * i + j + 4] for i in range(3) for j in range(4)]
    with h5py.File(folder / "net.h5", "w") as file:
        file["node/position"] = position
        file["node/velocity"] = position * [0, 1, 1] + [2.0, 0, 0]
        file["node/mass"] = np.full(16, 0.01)
        file["cable/nodes"] = np.array(cables)
        for name, value in (("natural_length", 0.1), ("axial_stiffness", 100.0), ("damping", 0.01)):
            file[f"cable/{name}"] = np.full(len(cables), value)
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)])
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    (folder / "body.obj").write_text("".join("v %g %g %g\n" % tuple(c) for c in corners)
                                     + "".join("f %d %d %d %d\n" % q for q in quads))
    (folder / "base.nml").write_text("&net kind = 'file' file = 'net.h5' /\n&target shape = 'mesh' file = 'body.obj' mass = 2 "
                                     "position = 0.5 0.15 0.15 /\n&contact threshold = 0.005 /\n")
    scene = folder / "net_scene.nml"
    scene.write_text("&include file = 'base.nml' /\n&time end_time = 0.3 step = 2e-5 /\n&output checkpoint_interval = 0.02 /\n")
    return scene, []


def check_contents(folder: Path) -> None:
    scene = net_scene(folder)
    output = folder / "out.h5"
    done = run(scene, folder / "reference.h5")
    if not check("contents: a net, a mesh and an included file make a run", done.returncode == 0, done.stderr):
        return
    reference = values(folder / "reference.h5")
    with h5py.File(folder / "reference.h5") as file:
        told = file["meta/contents"].asstr()[()]
        check("contents: /meta tells what was in the files", told.count("checksum") == 2 and "net/file" in told, told)
    for changed, key in (("net.h5", "net/file"), ("body.obj", "target/file")):
        stopped(scene, output)
        path = folder / changed
        kept = path.read_bytes()
        if changed == "net.h5":
            with h5py.File(path, "r+") as file:
                file["node/mass"][3] = 0.02
        else:
            path.write_bytes(kept.replace(b"0.1", b"0.2"))
        before = digest(folder)
        done = restart(scene, output)
        check(f"contents: a restart with another {changed} is refused by name, nothing touched", done.returncode == 2
              and key in done.stderr and short(done) and digest(folder) == before, (done.returncode, done.stderr))
        path.unlink()
        done = restart(scene, output)
        check(f"contents: and without {changed}", done.returncode == 2 and key in done.stderr and short(done),
              (done.returncode, done.stderr))
        path.write_bytes(kept)
        done = restart(scene, output)
        check(f"contents: with the old {changed} it ends in the same bits", done.returncode == 0 and not different(output, reference),
              (done.returncode, done.stderr))
    for old in folder.glob("out.h5*"):
        old.unlink()
    study = folder / "study.nml"
    study.write_text("&study scene = 'net_scene.nml' seeds = 1 /\n&vary key = 'target/mass' values = 2, 3 /\n")

    def answer(*words: str) -> subprocess.CompletedProcess:
        return subprocess.run([CASTNET, *map(str, words)], capture_output=True, text=True, timeout=300, check=False)

    before = digest(folder)
    for name in ("net_scene.nml", "base.nml", "net.h5", "body.obj"):
        for words in (("run", scene[0]), ("accuracy", scene[0]), ("study", study), ("collect", study)):
            done = answer(*words, "--output", folder / name, "--force")
            check(f"contents: {words[0]} does not write over {name}, not even with --force", done.returncode == 2
                  and short(done) and digest(folder) == before, (done.returncode, done.stderr))
    done = answer("study", study, "--output", study, "--force")
    check("contents: nor a study over its own text", done.returncode == 2 and digest(folder) == before, (done.returncode, done.stderr))
    for words in (("accuracy", scene[0]), ("study", study)):
        done = answer(*words, "--output", folder / "table.csv", "--force")
        check(f"contents: {words[0]}'s CSV may not be its HDF5 file", done.returncode == 2 and digest(folder) == before,
              (done.returncode, done.stderr))
    (folder / "out.csv").symlink_to(folder / "base.nml")
    for words in (("accuracy", scene[0]), ("study", study)):
        done = answer(*words, "--output", output, "--force")
        check(f"contents: nor {words[0]}'s CSV an input by another name", done.returncode == 2 and not output.exists()
              and (folder / "base.nml").read_text().startswith("&net"), (done.returncode, done.stderr))
    (folder / "out.csv").unlink()
    done = answer("study", study, "--output", output, "--set", "time/end_time=0.01")
    check("contents: the study runs", done.returncode == 0, done.stderr)
    again = answer("study", study.resolve(), "--output", output.resolve(), "--set", "time/end_time=0.01")
    check("contents: and again", again.returncode == 0, again.stderr)
    for name in ("base.nml", "body.obj"):
        path = folder / name
        kept = path.read_bytes()
        path.write_bytes(kept.replace(b"0.1", b"0.2"))
        done = answer("study", study, "--output", output, "--set", "time/end_time=0.01")
        check(f"contents: with another {name} its cases are another study's", done.returncode == 2 and "another study" in done.stderr,
              (done.returncode, done.stderr))
        path.write_bytes(kept)


# ---- the end of the process --------------------------------------------------------------------


def check_crash(folder: Path) -> None:
    """A bug of ours, here made by a signal, is told in two lines: exit code 1, no backtrace."""
    output = folder / "crash.h5"
    reference_path = folder / "crash_reference.h5"
    run(CUBESAT, reference_path)
    reference = values(reference_path)
    for number in (signal.SIGSEGV, signal.SIGABRT, signal.SIGFPE, signal.SIGBUS, signal.SIGILL):
        code, words = let_go(caught(CUBESAT, output, ".checkpoint", "--no-progress"), number)
        expected = "another kind of processor" if number == signal.SIGILL else "a bug of ours"
        check(f"crash: {number.name}: exit code 1, two lines, no backtrace", code == 1 and expected in words
              and len([w for w in words.splitlines() if "step" not in w]) <= 2 and "Backtrace" not in words, (code, words))
    done = restart(CUBESAT, output)
    check("crash: the run goes on from its checkpoint to the same bits", done.returncode == 0 and not different(output, reference),
          (done.returncode, done.stderr))
    ends = []
    for kilobytes in (150000, 250000, 350000, 450000):
        limited = subprocess.run(["bash", "-c", f'ulimit -v {kilobytes}; exec "$@"', "bash", *command(CUBESAT, folder / "memory.h5"),
                                  "--quiet", "--force", "--set", "net/squares=560,560", "--set", "output/checkpoint_interval=0",
                                  "--set", "time/end_time=1e-4", "--set", "output/verdict_times=1e-4"],
                                 capture_output=True, text=True, timeout=300, check=False)
        said = {0: "", 1: "memory ran out", 2: "of memory; this machine has", 127: "cannot", 4: "memory"}.get(limited.returncode)
        ends.append((limited.returncode, limited.stderr) if said is None or said not in limited.stderr or not short(limited) else None)
    check("crash: little memory is told, before or where it ends, in three lines at most", ends == 4*[None], ends)
    study = folder / "small_stack.nml"
    masses = ", ".join(str(2 + i / 100) for i in range(100))  # enough for the second thread to get one
    study.write_text(f"&study scene = '{CUBESAT[0]}' /\n&vary key = 'target/mass' values = {masses} /\n")
    small = subprocess.run([CASTNET, "study", str(study), "--quiet", "--threads", "2", "--set", "time/end_time=0.01",
                            "--set", "output/verdict_times=0.01"], env={**os.environ, "OMP_STACKSIZE": "20K"},
                           capture_output=True, text=True, timeout=300, check=False)
    check("crash: a thread's stack that is full is told", small.returncode == 1 and "stack of a thread" in small.stderr and short(small),
          (small.returncode, small.stderr))


# ---- monitors -----------------------------------------------------------------------------------


def check_monitors(folder: Path) -> None:
    """A run that goes wrong stops with what is needed to go on; one that is doubtful says so."""
    output = folder / "monitor.h5"
    good = run(CUBESAT, output)
    check("monitors: a sound run warns of nothing", good.returncode == 0 and "warning" not in good.stderr, good.stderr)
    output.unlink()
    # rk4 just above its limit grows slowly enough for a row of history to see it before the end
    unstable = (CUBESAT[0], ["time/method=rk4", "time/step=3e-4", "time/allow_unstable=.true.", "output/checkpoint_interval=0.001"])
    done = run(unstable, output, "--quiet")
    words = done.stderr
    check("monitors: an explosion is exit code 3 with node, cable, advice and what is left", done.returncode == 3
          and all(w in words for w in ("fastest node", "at the cable of nodes", "smaller time/step", "monitor.h5.part",
                                       "last good checkpoint, " + str(beside(output, ".checkpoint")))), (done.returncode, words))
    check("monitors: the energy's rise was warned of", "warning: energy: it rose by" in words, words)
    with h5py.File(beside(output, ".part")) as file:
        check("monitors: every frame that was kept is sound, and the file says that the run failed",
              np.isfinite(file["node_position"][()]).all() and file["meta/status"].asstr()[()] == "failed")
    again = restart(unstable, output, "--quiet")
    check("monitors: the checkpoint is sound: going on from it ends at the same step", again.returncode == 3
          and again.stderr.split("step ")[-1] == words.split("step ")[-1], (again.stderr, words))
    none = (CUBESAT[0], [*unstable[1][:3], "output/checkpoint_interval=0"])
    done = run(none, folder / "none.h5", "--quiet")
    check("monitors: without a checkpoint it says so", done.returncode == 3 and "no checkpoint was due" in done.stderr, done.stderr)
    soft = (CUBESAT[0], ["contact/law='penalty'", "contact/stiffness=0.01"])
    done = run(soft, folder / "soft.h5", "--quiet")
    check("monitors: a net that sinks into the target is warned of", done.returncode == 0
          and "contact thresholds behind" in done.stderr and short(done), (done.returncode, done.stderr))


# ---- locks and files -----------------------------------------------------------------------


def check_locks(folder: Path) -> None:
    output = folder / "lock.h5"
    process = caught(CUBESAT, output, ".part")
    done = run(CUBESAT, output, "--force")
    check("lock: a second run on the same output is refused, even with --force", done.returncode == 4 and short(done)
          and str(process.pid) in done.stderr, (done.returncode, done.stderr))
    process.kill()
    process.communicate()
    check("lock: a killed run leaves its lock", beside(output, ".lock").exists())
    done = run(CUBESAT, output, "--force")
    check("lock: which is known to be stale", done.returncode == 0 and not beside(output, ".lock").exists(), done.stderr)


def read_while_written(output: Path) -> tuple[int, list[str]]:
    """Open and read a run's file as often as can be while it starts, is stopped, goes on and ends: how often there were
    frames, and what went wrong. Python's own file and HDF5's ask for the file's length at different times."""
    scene = (CUBESAT[0], ["time/step=1.0e-6", "time/end_time=0.3", "output/verdict_times=0.3", "output/frame_interval=0.001"])
    part, troubles, seen, openings = beside(output, ".part"), [], 0, 0
    for words in ([], ["--restart", str(beside(output, ".checkpoint"))]):
        process = start(scene, output, *words)
        began = seen
        while process.poll() is None:
            try:
                with open(part, "rb") as held:
                    openings += 1
                    with h5py.File(held if openings % 2 else part, "r") as file:
                        frames = file["time"].shape[0]
                        seen += frames > 0
                        for name in ("time", "node_position", "cable_tension", "history/time", "VTKHDF/Points", "VTKHDF/CellData/tension"):
                            if not np.isfinite(file[name][()]).all():
                                troubles.append(f"{name} has holes")
                        for group in ("summary", "meta/sessions"):
                            file[group].visititems(lambda _, item: item[()] if isinstance(item, h5py.Dataset) else None)
            except FileNotFoundError:
                continue
            except Exception as error:  # noqa: BLE001 - whatever the reader says is the finding
                if "stat info" not in str(error) and "real path" not in str(error):  # it was renamed just now
                    troubles.append(repr(error))
            if not words and seen == began + 15:
                process.send_signal(signal.SIGTERM)
        process.communicate()
        troubles += [] if process.returncode == (0 if words else 75) else [f"exit code {process.returncode}"]
    return seen, troubles


def check_files(folder: Path) -> None:
    output = folder / "files.h5"
    scene = (CUBESAT[0], ["time/end_time=0.05", "output/verdict_times=0.05"])

    def refused(name: str, target: Path, *more: str, words: str) -> None:
        before = digest(folder)
        done = run(scene, target, *more)
        check(f"files: {name}: exit code 4, one sentence, nothing touched", done.returncode == 4 and short(done)
              and words in done.stderr and digest(folder) == before, (done.returncode, done.stderr))

    refused("a folder that is not there", folder / "none" / "a.h5", words="is not there")
    refused("a name that is too long", folder / ("x" * 240), words="too long")
    refused("a path that is too long", folder / ("y/" * 2100) / "a.h5", words="too long")
    run(scene, output)
    refused("an output that is there", output, words="--force")
    done = run(scene, output, "--force")
    check("files: --force replaces it", done.returncode == 0, done.stderr)
    before = values(output)
    output.rename(beside(output, ".part"))
    refused("an unfinished run that is there", output, words="--restart")
    beside(output, ".part").rename(output)
    check("files: and is still the same", values(output) == before)
    for part in (output, beside(output, ".part")):
        part.unlink(missing_ok=True)
    process = caught((CUBESAT[0], ["time/step=2.0e-5"]), output, ".part")
    with h5py.File(beside(output, ".part")) as file:
        early = file["time"].shape[0]
        code, _ = let_go(process)
        check("files: a reader may hold the file open while it is written", code == 0 and early < 151, (code, early))
    output.unlink()
    times, troubles = read_while_written(output)
    check("files: a reader may open and read the file at any moment while it is written, stopped, gone on with and ended",
          times > 0 and not troubles, (times, troubles[:2]))
    link = folder / "link.h5.part"
    victim = folder / "victim.txt"
    victim.write_text("precious")
    link.symlink_to(victim)
    beside(folder / "link.h5", ".tmp").symlink_to(victim)
    run(scene, folder / "link.h5", "--force")
    check("files: a link laid in the way is replaced, not followed", victim.read_text() == "precious")
    for words, code, name in ((["schema"], 4, "results that cannot be written are exit code 4"),
                              (command(scene, folder / "mute.h5")[1:], 4, "also those of a run, whose file is there")):
        done = subprocess.run([CASTNET, *words], stdout=open("/dev/full", "w"), stderr=subprocess.PIPE, text=True, check=False)
        check(f"files: {name}", done.returncode == code and "standard output" in done.stderr, (done.returncode, done.stderr))
    check("files: which is complete", (folder / "mute.h5").exists())
    done = subprocess.run(command(scene, folder / "deaf.h5"), stdout=subprocess.PIPE, stderr=open("/dev/full", "w"), check=False)
    check("files: a log that cannot be written does not end a run", done.returncode == 0 and (folder / "deaf.h5").exists(),
          done.returncode)
    strange = folder / "a b; touch oops $(touch oops) 'ü'.h5"
    done = run(scene, strange)
    check("files: no shell sees a file's name", done.returncode == 0 and strange.exists() and not (folder / "oops").exists()
          and not Path("oops").exists(), done.stderr)


def check_disks() -> None:
    with small_disk("1m") as disk:
        if disk is None:
            return
        output = disk / "run.h5"
        done = run(CUBESAT, output)
        check("full disk: known beforehand: exit code 4 at the start, nothing left", done.returncode == 4 and short(done)
              and "free" in done.stderr and not list(disk.iterdir()), (done.returncode, done.stderr, list(disk.iterdir())))
        # a run that fits, and a neighbour who takes the rest while it runs
        few = (CUBESAT[0], ["time/step=1.0e-5", "output/vtk=.false.", "output/frame_interval=0.05",
                            "output/history_interval=0.01", "output/checkpoint_interval=0.05"])
        with tempfile.TemporaryDirectory() as roomy:
            run(few, Path(roomy) / "reference.h5")
            reference = values(Path(roomy) / "reference.h5")
        process = caught(few, output, ".checkpoint.previous", "--no-progress")
        filler = disk / "filler"
        with open(filler, "wb", buffering=0) as out:
            try:
                while True:
                    out.write(b"x" * 4096)
            except OSError:
                pass
        code, words = let_go(process)
        check("full disk: in the middle: exit code 4, at most three lines, what to do", code == 4
              and len(words.strip().splitlines()) <= 3 and "free disk space" in words, (code, words))
        fault = readable(beside(output, ".part"))
        with h5py.File(beside(output, ".part")) as file:
            frames = file["time"].shape[0]
            check(f"full disk: the {frames} frames before are there", not fault and 0 < frames < 61, fault)
        filler.unlink()
        done = restart(few, output)
        check("full disk: with room again the restart ends in the same bits", done.returncode == 0 and
              not different(output, reference), (done.returncode, done.stderr))
        kept = digest(disk)
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=False)
        done = run(CUBESAT, disk / "new.h5")
        check("read-only disk: exit code 4, one sentence, earlier data intact", done.returncode == 4 and short(done)
              and "ead-only" in done.stderr and digest(disk) == kept, (done.returncode, done.stderr))
        done = run(few, output, "--force")
        check("read-only disk: --force does not help", done.returncode == 4 and digest(disk) == kept, done.stderr)


def check_study_disk() -> None:
    """A study's table on a full disk: exit code 4, the journal keeps the cases, collect makes the table."""
    with small_disk("256k") as disk, tempfile.TemporaryDirectory() as roomy:
        if disk is None:
            return
        text = ("&study scene = 'base.nml' seeds = 2 /\n&vary key = 'target/angular_velocity(2)' from = 0 to = 4 count = 10 /\n")
        base = (f"&include file = '{CUBESAT[0]}' /\n&time end_time = 0.01 /\n&output verdict_times = 0.01 /\n"
                "&perturb bullet_speed = 0.01 /\n")

        def study(command: str, folder: Path) -> subprocess.CompletedProcess:
            return subprocess.run([CASTNET, command, str(folder / "s.nml"), "--quiet"], capture_output=True, text=True,
                                  timeout=300, check=False)

        def fill(left: int) -> None:
            with open(disk / "filler", "wb", buffering=0) as out:
                try:
                    while os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize > left:
                        out.write(b"x" * 4096)
                except OSError:
                    pass

        for folder in (disk, Path(roomy)):
            (folder / "s.nml").write_text(text)
            (folder / "base.nml").write_text(base)
        done = study("study", Path(roomy))
        check("study disk: with room it ends", done.returncode == 0, done.stderr)
        size = {e: (Path(roomy) / f"s{e}").stat().st_size for e in (".h5", ".h5.cases", ".csv")}
        reference = values(Path(roomy) / "s.h5")
        for what in ("table", "CSV"):
            for old in disk.glob("s.*"):
                if old.name != "s.nml":
                    old.unlink()
            if what == "table":
                fill(size[".h5.cases"] + size[".h5"] // 2)
            else:
                (disk / "s.csv").mkdir()     # the table has room, its neighbour is in the way
            done = study("study", disk)
            held = {p.name for p in disk.iterdir()} - {"s.nml", "base.nml", "filler"}
            check(f"study disk: no {what}: exit code 4, what to do, no half a file", done.returncode == 4 and short(done)
                  and held == ({"s.h5.cases"} if what == "table" else {"s.h5.cases", "s.h5", "s.csv"}),
                  (done.returncode, done.stderr, held))
            check(f"study disk: no {what}: every case is in the journal",
                  (disk / "s.h5.cases").stat().st_size == size[".h5.cases"])
            (disk / "filler").unlink() if what == "table" else (disk / "s.csv").rmdir()
            done = study("collect", disk)
            check(f"study disk: no {what}: collect makes table and CSV from the journal", done.returncode == 0
                  and not different(disk / "s.h5", reference)
                  and (disk / "s.csv").read_bytes() == (Path(roomy) / "s.csv").read_bytes(), (done.returncode, done.stderr))
        (disk / "s.h5.cases").unlink()
        kept = digest(disk)
        fill(4096)
        done = study("study", disk)
        left = {p.name: d for p, d in ((disk / n, h) for n, h in digest(disk).items()) if p.name in kept}
        check("study disk: full at the journal: exit code 4, what to do, the earlier table intact", done.returncode == 4
              and short(done) and left == kept, (done.returncode, done.stderr))


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="castnet_faults_") as name:
        for number, part in enumerate((check_files, check_contents, check_locks, check_monitors, check_crash, check_signals, check_restarts,
                                       check_replacing, check_damaged_checkpoints, check_kills)):
            folder = Path(name) / str(number)
            folder.mkdir()
            try:
                part(folder)
            except Exception as error:  # noqa: BLE001 - a test that cannot go on has failed
                check(f"{part.__name__} runs to its end", False, repr(error))
        for part in (check_disks, check_study_disk):
            try:
                part()
            except Exception as error:  # noqa: BLE001
                check(f"{part.__name__} runs to its end", False, repr(error))
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
