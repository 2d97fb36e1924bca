#!/usr/bin/env python3
"""Whatever moment everything stops at, the output file is whole.

    test_write_order.py PATH_TO_CASTNET

A killed process is one thing; a machine that goes down, or a scheduler that kills all of a
job, can stop the writing of a file between any two writes. Every write of a run's file is
noted, and done again one by one on another file: after each, h5py must open it and VTK must
show it, with as many steps as its arrays hold; after some, xarray (which takes longest).
"""
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import vtk
import xarray as xr

ROOT = Path(__file__).resolve().parents[2]
CASTNET = str(Path(sys.argv[1]).resolve())
SCENE = [str(ROOT / "input" / "cubesat.nml"), "--set", "output/checkpoint_interval=0.05", "--threads", "1"]
results: list[bool] = []
XARRAY_EVERY = 25


def check(name: str, good: bool, seen: object = "") -> bool:
    """Note one claim."""
    results.append(bool(good))
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f"\n      seen: {seen}"), flush=True)
    return bool(good)


def command(output: Path, end: float, *more: str) -> list[str]:
    return [CASTNET, "run", *SCENE, "--output", str(output), "--set", f"time/end_time={end}", "--set",
            f"output/verdict_times={end}", *more]


def changes(log: Path):
    """What was noted: kind, offset or length, bytes."""
    data = memoryview(log.read_bytes())
    at = 0
    while at < len(data):
        kind, where, n = struct.unpack_from("<QQQ", data, at)
        at += 24
        n = n if kind == ord("w") else 0
        yield chr(kind), where, data[at:at + n]
        at += n


def look(path: Path, with_xarray: bool) -> str:
    """What h5py, xarray or VTK find wrong; '' if nothing."""
    with h5py.File(path) as file:
        file.visititems(lambda name, item: item[-1:] if isinstance(item, h5py.Dataset) and item.shape else None)
        steps = file["VTKHDF/Steps"]
        n = int(steps.attrs["NSteps"])
        lengths = {name: steps[name].shape[0] for name in (
            "Values", "PartOffsets", "NumberOfParts", "PointOffsets", "CellOffsets", "ConnectivityIdOffsets",
            "CellDataOffsets/tension")}
        if n < 1 or set(lengths.values()) != {n}:
            return f"{n} steps, {lengths}"
        if file["VTKHDF/Points"].shape[0] < steps["PointOffsets"][n - 1] + file["VTKHDF/NumberOfPoints"][0]:
            return "fewer points than steps"
    if with_xarray:
        with xr.open_dataset(path) as data, xr.open_dataset(path, group="history") as history:
            data.load()
            history.load()
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    if reader.GetNumberOfSteps() != n:
        return f"VTK sees {reader.GetNumberOfSteps()} steps of {n}"
    for step in {0, n - 1}:
        reader.SetStep(step)
        reader.Update()
        if reader.GetOutputDataObject(0).GetNumberOfPoints() == 0:
            return f"VTK sees nothing in step {step} of {n}"
    return ""


def fault(path: Path, with_xarray: bool) -> str:
    """`look` in a process of its own, because VTK crashes rather than complains."""
    source, sink = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(source)
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        try:
            words = look(path, with_xarray)
        except BaseException as error:  # noqa: BLE001 - whatever the reader says is the finding
            words = repr(error)
        os.write(sink, words.encode()[:1000])
        os._exit(0)
    os.close(sink)
    with os.fdopen(source, "rb") as pipe:
        words = pipe.read().decode()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return words if code == 0 else f"the reader ends with {code}"


def replay(name: str, log: Path, copy: Path, fewest: int) -> None:
    """Do again what was noted, on a copy of what the file was before."""
    faults, states, seen = [], 0, False
    handle = os.open(copy, os.O_RDWR | os.O_CREAT, 0o644)
    for kind, where, content in changes(log):
        if kind == "w":
            os.pwrite(handle, content, where)
        elif kind == "t":
            os.ftruncate(handle, where)
        seen = seen or kind == "r"
        if not seen or kind == "t" and states % 8:
            continue
        states += 1
        if words := fault(copy, states % XARRAY_EVERY == 0):
            faults.append((states, words))
    os.close(handle)
    check(f"{name}: the file is whole for h5py, xarray and VTK after each of {states} writes", not faults and states >= fewest,
          (len(faults), faults[:4]))


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="castnet_writes_") as name:
        folder = Path(name).resolve()
        library, log, output = folder / "log_writes.so", folder / "log", folder / "a.h5"
        done = subprocess.run([os.environ.get("CC") or shutil.which("cc") or "gcc", "-shared", "-fPIC", "-O1", "-o", library,
                               Path(__file__).with_name("log_writes.c"), "-ldl"], capture_output=True, text=True, check=False)
        if check("the noting of writes compiles", done.returncode == 0, done.stderr):
            noting = {**os.environ, "LD_PRELOAD": str(library), "CASTNET_WRITE_LOG": str(log), "CASTNET_WRITE_LOG_OF": str(output)}
            done = subprocess.run(command(output, 0.2), env=noting, capture_output=True, text=True, timeout=600, check=False)
            if check("a run whose writes are noted", done.returncode == 0, done.stderr):
                replay("a run", log, folder / "copy.h5", 100)
            for old in [log, *folder.glob("a.h5*")]:
                old.unlink(missing_ok=True)
            # one that was killed, and goes on in the file that it left
            process = subprocess.Popen(command(output, 3.0), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            checkpoint, part = folder / "a.h5.checkpoint", folder / "a.h5.part"
            while process.poll() is None and not (folder / "a.h5.checkpoint.previous").exists():
                time.sleep(0.002)
            process.send_signal(signal.SIGKILL)
            process.wait()
            time.sleep(0.2)
            if check("a run that is killed has a checkpoint", checkpoint.exists() and part.exists()):
                shutil.copy(part, folder / "copy.h5")
                done = subprocess.run(command(output, 0.3, "--restart", str(checkpoint)), env=noting, capture_output=True,
                                      text=True, timeout=600, check=False)
                if check("its restart", done.returncode == 0, done.stderr):
                    replay("a restart", log, folder / "copy.h5", 50)
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
