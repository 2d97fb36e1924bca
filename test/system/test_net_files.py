#!/usr/bin/env python3
"""Nets from HDF5 files as Python writes them, good and hostile, through the program.

    test_net_files.py PATH_TO_CASTNET

A bad net is exit code 2 with the dataset named and no file written; nothing crashes,
hangs or prints a backtrace. A good one runs, whatever number type or storage it is in.
"""
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

CASTNET = str(Path(sys.argv[1]).resolve())
results: list[bool] = []

SCENE = """
&net
  kind = 'file'
  file = 'net.h5'
/
&time
  end_time = 0.01
  step = 1.0e-4
/
"""


def check(name: str, good: bool, seen: object = "") -> None:
    results.append(bool(good))
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f"\n      seen: {seen}"), flush=True)


def square() -> dict[str, np.ndarray]:
    """Four nodes, five cables, one face."""
    position = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
    nodes = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
    return {
        "node/position": position, "node/velocity": position * 0.1, "node/mass": np.full(4, 0.5),
        "node/fixed": np.array([0, 0, 0, 1]), "cable/nodes": nodes,
        "cable/natural_length": np.linalg.norm(position[nodes[:, 0]] - position[nodes[:, 1]], axis=1),
        "cable/axial_stiffness": np.full(5, 100.0), "cable/damping": np.full(5, 0.1), "face": np.array([[0, 1, 2, 3]]),
    }


def write(folder: Path, content: dict) -> None:
    """A dataset per entry; None leaves it out, a function writes it itself."""
    with h5py.File(folder / "net.h5", "w") as file:
        for name, data in content.items():
            if callable(data):
                data(file)
            elif data is not None:
                file[name] = data


def run(folder: Path, *more: str) -> subprocess.CompletedProcess:
    for old in folder.glob("out.h5*"):
        old.unlink()
    (folder / "scene.nml").write_text(SCENE)
    return subprocess.run([CASTNET, "run", str(folder / "scene.nml"), "--output", str(folder / "out.h5"), "--quiet", *more],
                          capture_output=True, text=True, timeout=60, check=False)


def good(folder: Path, name: str, changes: dict) -> None:
    write(folder, {**square(), **changes})
    done = run(folder)
    check(f"good: {name}", done.returncode == 0 and (folder / "out.h5").exists(), (done.returncode, done.stderr))


def bad(folder: Path, name: str, changes: dict, words: str) -> None:
    write(folder, {**square(), **changes})
    done = run(folder)
    check(f"bad: {name}", done.returncode == 2 and words in done.stderr and "Backtrace" not in done.stderr
          and not list(folder.glob("out.h5*")), (done.returncode, done.stderr))


def with_values(name: str, change) -> dict:
    data = square()[name].copy()
    change(data)
    return {name: data}


def put(index, value):
    def change(data):
        data[index] = value
    return change


def check_good(folder: Path) -> None:
    good(folder, "as the guide says", {})
    good(folder, "without cables and faces", {k: None for k in square() if k.startswith(("cable", "face"))})
    one = {k: None for k in square()}
    good(folder, "one node and no cable", {**one, "node/position": np.zeros((1, 3)), "node/velocity": np.ones((1, 3)),
                                           "node/mass": np.ones(1)})
    good(folder, "no cable, said so", {"cable/nodes": np.zeros((0, 2), int), "cable/natural_length": np.zeros(0),
                                       "cable/axial_stiffness": np.zeros(0), "cable/damping": np.zeros(0)})
    good(folder, "bool fixed", {"node/fixed": np.array([False, False, True, True])})
    good(folder, "all nodes fixed", {"node/fixed": np.ones(4, int)})
    good(folder, "single precision, big-endian, short integers", {
        "node/position": square()["node/position"].astype(">f4"), "cable/nodes": square()["cable/nodes"].astype(">u2"),
        "node/mass": np.array([1, 1, 1, 1])})
    good(folder, "compressed", {"node/position": lambda f: f.create_dataset(
        "node/position", data=square()["node/position"], compression="gzip", shuffle=True)})
    good(folder, "other things beside it", {"meta/author": "someone", "weather": np.ones(3)})
    write(folder, square())
    done = run(folder)
    with h5py.File(folder / "out.h5") as file:
        check("good: the output holds the net that was given",
              np.array_equal(file["static/cable_nodes"][()], square()["cable/nodes"])
              and np.array_equal(file["node_position"][0], square()["node/position"])
              and np.allclose(file["node_velocity"][:, 3], square()["node/velocity"][3], rtol=0, atol=0),
              (done.stderr, file["node_velocity"][:, 3]))


def check_bad(folder: Path) -> None:
    for name in square():
        if name not in ("node/fixed", "face"):
            bad(folder, f"no {name}", {name: None}, f"/{name}: missing")
        bad(folder, f"{name} is text", {name: "text"}, f"/{name}: ")
        bad(folder, f"{name} is a group", {name: lambda f, n=name: f.create_group(n)}, f"/{name}: ")
        bad(folder, f"{name} is a scalar", {name: 1}, f"/{name}: ")
        bad(folder, f"{name} is a compound", {name: np.zeros(4, dtype=[("a", "f8"), ("b", "i4")])}, f"/{name}: ")
        bad(folder, f"{name} is complex", {name: square()[name].astype(complex)}, f"/{name}: ")
        bad(folder, f"{name} has other sizes than the rest", {name: np.concatenate([square()[name]] * 2)}
            if name != "face" else {name: np.ones((1, 5), int)}, "is needed")
        bad(folder, f"{name} is transposed" if square()[name].ndim == 2 else f"{name} is a matrix",
            {name: square()[name].T if square()[name].ndim == 2 and square()[name].shape[0] != square()[name].shape[1]
             else square()[name][None, ...]}, f"/{name}: shape")
        bad(folder, f"{name} is a dead link", {name: lambda f, n=name: f.__setitem__(n, h5py.SoftLink("/nowhere"))}, f"/{name}: ")
        bad(folder, f"{name} is in another file", {name: lambda f, n=name: f.__setitem__(n, h5py.ExternalLink("no.h5", "/x"))},
            f"/{name}: ")
    for name in ("node/position", "node/velocity", "node/mass", "cable/natural_length", "cable/axial_stiffness", "cable/damping"):
        first = (2, 1) if square()[name].ndim == 2 else 2
        for value in (np.nan, np.inf, -np.inf, 1e200):
            bad(folder, f"{name} holds {value}", with_values(name, put(first, value)), f"/{name}[2")
    for name in ("node/mass", "cable/natural_length", "cable/axial_stiffness"):
        for value in (0.0, -1.0, -0.0, 1e-320):
            bad(folder, f"{name} holds {value}", with_values(name, put(1, value)), f"/{name}[1]")
    bad(folder, "cable/damping below 0", with_values("cable/damping", put(1, -1e-9)), "/cable/damping[1]")
    bad(folder, "a float for a node", {"cable/nodes": square()["cable/nodes"].astype(float)}, "/cable/nodes: not integers")
    for value in (-1, 4, 2**31, 2**62):
        bad(folder, f"node {value}", with_values("cable/nodes", put((3, 1), value)), "/cable/nodes[3,1]")
        bad(folder, f"corner {value}", with_values("face", put((0, 2), value)), "/face[0,2]")
    bad(folder, "an unsigned index beyond all", {"cable/nodes": square()["cable/nodes"].astype("u8") + np.uint64(2**64 - 5)}, "/cable/nodes[")
    bad(folder, "a loop", with_values("cable/nodes", put(2, 3)), "joins node 3 to itself")
    bad(folder, "a double", with_values("cable/nodes", put(4, [1, 0])), "join the same nodes 0 and 1")
    bad(folder, "a corner twice", with_values("face", put((0, 3), 0)), "names a node twice")
    bad(folder, "fixed = 2", with_values("node/fixed", put(1, 2)), "/node/fixed[1]: 2")
    bad(folder, "a misspelt option", {"node/fixd": np.ones(4)}, "did you mean fixed?")
    bad(folder, "a misspelt face", {"faces": np.array([[0, 1, 2, 3]])}, "did you mean face?")
    bad(folder, "no node", {"node/position": np.zeros((0, 3)), "node/velocity": np.zeros((0, 3)), "node/mass": np.zeros(0),
                            "node/fixed": None}, "at least one node")
    huge = {k: None for k in square()}
    for n, words in ((10**8, "memory"), (2**31, "possible"), (2**40, "possible"), (2**61, "possible")):
        bad(folder, f"{n} nodes that take no room in the file", {**huge, **{
            f"node/{name}": (lambda f, k=f"node/{name}", s=shape: f.create_dataset(k, s, "f8", chunks=(1024,) + s[1:]))
            for name, shape in (("position", (n, 3)), ("velocity", (n, 3)), ("mass", (n,)))}}, words)
    many = with_values("cable/nodes", put(0, 9))
    bad(folder, "several at once", {**many, **with_values("node/mass", put(0, -1))}, "/node/mass[0]")


def check_files(folder: Path) -> None:
    path = folder / "net.h5"

    def refused(name: str, content: bytes | None) -> None:
        path.unlink(missing_ok=True)
        if content is not None:
            path.write_bytes(content)
        done = run(folder)
        check(f"file: {name}", done.returncode in (2, 4) and "net.h5" in done.stderr and "Backtrace" not in done.stderr
              and len(done.stderr.splitlines()) <= 3, (done.returncode, done.stderr))

    refused("not there", None)
    refused("empty", b"")
    refused("text", b"0 0 0\n")
    write(folder, square())
    whole = path.read_bytes()
    for part in (8, 96, 512, len(whole) // 2, len(whole) - 1):
        refused(f"cut to {part} bytes", whole[:part])
    path.unlink()
    path.mkdir()
    done = run(folder)
    check("file: a folder", done.returncode == 2 and "folder" in done.stderr, (done.returncode, done.stderr))
    path.rmdir()
    chance = np.random.default_rng(11)
    crashes = []
    for k in range(150):
        data = bytearray(whole)
        for at in chance.integers(0, len(data), int(chance.integers(1, 6))):
            data[at] = int(chance.integers(0, 256))
        path.write_bytes(data)
        done = run(folder)
        if done.returncode not in (0, 2, 3, 4) or "Backtrace" in done.stderr:
            crashes.append((k, done.returncode, done.stderr[-200:]))
    check("file: 150 files with random bytes changed: no crash, no hang", not crashes, crashes[:5])


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="castnet_net_") as name:
        for part in (check_good, check_bad, check_files):
            try:
                part(Path(name))
            except Exception as error:  # noqa: BLE001 - a test that cannot go on has failed
                check(f"{part.__name__} runs to its end", False, repr(error))
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
