#!/usr/bin/env python3
"""How often do a net's cables pass through each other? The model lets them.

    tools/self_contact.py [SCENE ...] [--seeds N] [--castnet PROGRAM] [-o TABLE.md]

A crossing is a pair of cables without a common node whose straight lines between their nodes pass through each other
from one frame to the next (nodes led along straight lines between frames; twice within one frame interval is not
seen). It is counted as taut when both cables are longer than their natural length at the later frame: a slack cable
is no straight line, so that only those are certain. Touching: pairs nearer than the mean of their diameters, at the
frames. Runs are captures at the default method and step, nodes nudged by a micrometre.
"""
import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from castnet_runner import INPUT, find_castnet

SCENES = {"cubesat": ("1e-3", "3.0"), "cubesat_2.0": ("1e-3", "3.0"), "rocket_x_0.4": ("5e-3", "10.0"), "rocket_x_0.7": ("5e-3", "10.0"),
          "rocket_closing_x_1.1": ("5e-3", "10.0")}


def pairs_without_common_node(cables: np.ndarray) -> np.ndarray:
    i, j = np.triu_indices(len(cables), 1)
    shared = (cables[i][:, :, None] == cables[j][:, None, :]).any(axis=(1, 2))
    return np.stack([i[~shared], j[~shared]])


def volume(p: np.ndarray) -> np.ndarray:
    """Signed volume (6 x) of the tetrahedra on two segments; p (segment end 4, n, 3)."""
    return np.einsum("ij,ij->i", np.cross(p[1] - p[0], p[3] - p[2]), p[2] - p[0])


def crossings(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Which pairs (4, n, 3) pass through each other between two instants."""
    times = np.linspace(0.0, 1.0, 5)
    values = np.array([volume(before + t * (after - before)) for t in times])
    crossed = np.zeros(before.shape[1], bool)
    for k in range(4):
        turn = np.flatnonzero(values[k] * values[k + 1] < 0.0)
        if not turn.size:
            continue
        b, d = before[:, turn], (after - before)[:, turn]
        low, high = np.full(turn.size, times[k]), np.full(turn.size, times[k + 1])
        start = np.sign(values[k][turn])
        for _ in range(30):
            middle = 0.5 * (low + high)
            same = np.sign(volume(b + middle[:, None] * d)) == start
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        p = b + low[:, None] * d
        crossed[turn] |= gap(p)[1]
    return crossed


def gap(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the two lines' nearest points, clamped to the segments, and whether both lie inside."""
    u, v, w = p[1] - p[0], p[3] - p[2], p[0] - p[2]
    a, b, c, d, e = (np.einsum("ij,ij->i", x, y) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    det = a * c - b * b
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (b * e - c * d) / det, (a * e - b * d) / det
    inside = (s > 0) & (s < 1) & (t > 0) & (t < 1)
    s = np.clip(np.nan_to_num(s), 0, 1)
    t = np.clip((b * s + e) / c, 0, 1)
    s = np.clip((b * t - d) / a, 0, 1)
    return np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1), inside


def count(path: Path) -> dict[str, float]:
    with h5py.File(path) as f:
        x, time = f["node_position"][()], f["time"][()]
        cables, natural = f["static/cable_nodes"][()], f["static/natural_length"][()]
        stiffness = f["static/axial_stiffness"][()]
        first = float(f["summary/first_contact"][()])
    modulus = 4.456e8
    diameter = np.sqrt(4.0 * stiffness / (np.pi * modulus))
    pairs = pairs_without_common_node(cables)
    reach = 0.5 * (diameter[pairs[0]] + diameter[pairs[1]])
    ends = x[:, cables]                                   # time, cable, end, xyz
    low, high = ends.min(axis=2), ends.max(axis=2)
    taut = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1) > natural
    total = dict.fromkeys(("before", "after", "taut before", "taut after", "touching"), 0.0)
    for k in range(len(time) - 1):
        lo, hi = np.minimum(low[k], low[k + 1]), np.maximum(high[k], high[k + 1])
        near = np.flatnonzero(np.all((lo[pairs[0]] <= hi[pairs[1]] + reach[:, None]) & (lo[pairs[1]] <= hi[pairs[0]] + reach[:, None]), axis=1))
        if not near.size:
            continue
        i, j = pairs[:, near]
        at = [np.stack([ends[m, i, 0], ends[m, i, 1], ends[m, j, 0], ends[m, j, 1]]) for m in (k, k + 1)]
        crossed = crossings(*at)
        tight = crossed & taut[k + 1, i] & taut[k + 1, j]
        word = "after" if time[k + 1] > first else "before"
        total[word] += crossed.sum()
        total["taut " + word] += tight.sum()
        if time[k + 1] > 0.5 * first:                     # not the stowed net, which lies on itself
            total["touching"] += (gap(at[1])[0] < reach[near]).sum() / np.sum(time > 0.5 * first)
    return total


def fly(castnet: str, scene: str, seed: int, folder: Path) -> dict[str, float]:
    interval, end = SCENES[scene]
    output = folder / f"{scene}_{seed}.h5"
    settings = {"time/end_time": end, "output/verdict_times": end, "output/frame_interval": interval, "output/vtk": ".false.",
                "perturb/node_position": "1e-6", "perturb/seed": seed}
    command = [castnet, "run", str(INPUT / f"{scene}.nml"), "--output", str(output), "--force", "--quiet"]
    command += [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "1"})
    found = count(output)
    output.unlink()
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--castnet")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    castnet = find_castnet(options.castnet)
    text = ["| capture | crossings before contact | after | of taut pairs, before | after | touching at a frame |", "|---|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        for scene in options.scenes:
            runs = [fly(castnet, scene, seed, Path(folder)) for seed in range(1, options.seeds + 1)]
            cells = []
            for name in ("before", "after", "taut before", "taut after", "touching"):
                v = np.array([r[name] for r in runs])
                cells.append(f"{v.mean():.4g} ({v.min():.4g} to {v.max():.4g})")
            text.append(f"| {scene} | " + " | ".join(cells) + " |")
    text = "\n".join(text) + "\n"
    if options.output:
        Path(options.output).write_text(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
