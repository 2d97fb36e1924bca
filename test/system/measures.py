"""Capture measures and the ledger of a run, computed again from its frames with numpy and scipy.

Nothing of castnet is used but its file: rays by Moeller and Trumbore, hulls by Qhull, holes and
escape by brute force over a fine net of points. Each difference is bounded by how fine that is.
"""
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from scipy.spatial import ConvexHull

ROOT = Path(__file__).resolve().parents[2]
TIMES = [0.9, 1.06, 1.14, 1.2, 1.26, 1.8, 3.0]  # before, at and after first contact; frames stand there too
PER_SIDE = 8  # points along a triangle's side in brute force
GLANCING = np.sin(np.radians(10.0))
results: list[bool] = []


def check(name: str, seen, wanted, tolerance=0.0, relative=0.0) -> None:
    seen, wanted = np.asarray(seen, float), np.asarray(wanted, float)
    good = bool(np.all(np.abs(seen - wanted) <= tolerance + relative * np.abs(wanted)))
    results.append(good)
    print(("ok    " if good else "FAIL  ") + name)
    if not good:
        print(f"      seen {seen}\n      wanted {wanted}\n      tolerance {tolerance} + {relative} relative")


def matrix(q: np.ndarray) -> np.ndarray:
    """Body to inertial."""
    w, v = q[0], q[1:]
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * skew + 2 * skew @ skew


def fibonacci(n: int) -> np.ndarray:
    k = np.arange(n)
    z = 1 - (2 * k + 1) / n
    angle = k * np.pi * (3 - np.sqrt(5))
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])


def hits(direction: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Which rays from the origin meet a triangle (Moeller & Trumbore 1997)."""
    met = np.zeros(len(direction), bool)
    for a, b, c in triangle:
        e1, e2 = b - a, c - a
        p = np.cross(direction, e2)
        det = p @ e1
        with np.errstate(divide="ignore", invalid="ignore"):
            u = -(p @ a) / det
            q = np.cross(-a, e1)
            v = direction @ q / det
            t = (e2 @ q) / det
            met |= (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return met


def fine_points(triangle: np.ndarray) -> np.ndarray:
    """Points of every triangle on a lattice, corners and sides included."""
    i, j = np.meshgrid(np.arange(PER_SIDE), np.arange(PER_SIDE), indexing="ij")
    keep = i + j < PER_SIDE
    u, v = i[keep] / (PER_SIDE - 1), j[keep] / (PER_SIDE - 1)
    weight = np.stack([1 - u - v, u, v])
    return np.einsum("kp,tkx->tpx", weight, triangle).reshape(-1, 3)


def hull(point: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Volume, area and centroid by Qhull."""
    found = ConvexHull(point)
    middle = point[found.vertices].mean(axis=0)
    corner = point[found.simplices] - middle
    volume = np.abs(np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))) / 6
    return found.volume, found.area, middle + (volume[:, None] * corner.sum(axis=1) / 4).sum(axis=0) / volume.sum()


def largest_hole(direction: np.ndarray, triangle: np.ndarray, point: np.ndarray) -> float:
    """Half-angle of the largest empty cone with its axis on a grid of 20,000 directions [degree]."""
    fine = fibonacci(20000)
    fine = fine[~hits(fine, triangle)]
    if len(fine) == 0:
        return 0.0
    unit = point / np.linalg.norm(point, axis=1, keepdims=True)
    nearest = np.concatenate([(part @ unit.T).max(axis=1) for part in np.array_split(fine, 40)])
    return float(np.degrees(np.arccos(np.clip(nearest.min(), -1, 1))))


def way_out_of_a_box(half: np.ndarray, direction: np.ndarray, point: np.ndarray) -> float:
    """Share of these directions along which a box runs into none of the points."""
    depth = np.abs(point) - half
    inside = np.all(depth <= 0, axis=1)
    nearest = np.zeros_like(point)
    face = depth.argmax(axis=1)
    rows = np.arange(len(point))
    nearest[rows, face] = np.sign(point[rows, face])
    outside = point[~inside]
    free = 0
    for d in np.where(direction == 0, 1e-30, direction):
        if (nearest[inside] @ d > GLANCING).any():
            continue
        enter = (outside - np.sign(d) * half) / d  # back along d
        leave = (outside + np.sign(d) * half) / d
        first = np.maximum(enter.max(axis=1), 0)
        met = first <= leave.min(axis=1)
        facing = np.abs(d)[enter.argmax(axis=1)]
        free += not (met & (facing > GLANCING)).any()
    return free / 1500


def measures_again(file: h5py.File) -> None:
    static, summary = file["static"], file["summary"]
    times = file["time"][()]
    face = static["faces"][()]
    first = np.concatenate([face[:, [0, 1, 2]], face[:, [0, 2, 3]]])
    target = hull(static["target_vertices"][()])
    extent = np.ptp(static["target_vertices"][()], axis=0)
    is_box = len(static["target_vertices"]) == 8
    direction = fibonacci(1500)
    for i, time in enumerate(summary["verdict_time"][()]):
        at = int(np.abs(times - time).argmin())
        check(f"measures: a frame stands at {time:.2f} s", times[at], time)
        r = matrix(file["target_attitude"][at])
        position = (file["node_position"][at] - file["target_position"][at]) @ r
        triangle = position[first]
        point = fine_points(triangle)
        covered = hits(direction, triangle)
        name = f"at {time:.2f} s"
        # A ray through a seam may fall on either side of it.
        check(f"measures: coverage {name}", summary["coverage"][i], covered.mean(), 1.1 / 1500)
        if not covered.all():
            # Axes 1 degree apart, points of the surface up to 2 degrees apart at its rim.
            check(f"measures: largest hole {name}", summary["largest_hole"][i], largest_hole(direction, triangle, point), 1.0)
        if is_box:
            # Nine points a square against 72: a few directions at the rim of the way out.
            check(f"measures: escape {name}", summary["escape"][i],
                  way_out_of_a_box(extent / 2, direction[~covered], point), 6.1 / 1500)
        volume, area, centre = hull(position)
        index = 0.1 * abs(volume - target[0]) / target[0] + 0.1 * abs(area - target[1]) / target[1] \
            + 0.8 * np.linalg.norm(centre - target[2]) / extent.max()
        # A round target is measured in closed form, its vertices stand for 0.3 % less.
        check(f"measures: quality index {name}", summary["cqi"][i], index, 0, 1e-9 if is_box else 6e-3)
        loop = position[static["perimeter_nodes"][()]]
        after = np.roll(loop, -1, axis=0)
        check(f"measures: mouth area {name}", summary["mouth_area"][i], np.linalg.norm(np.cross(loop, after).sum(axis=0)) / 2,
              0, 1e-10)
        check(f"measures: mouth perimeter {name}", summary["mouth_perimeter"][i],
              np.linalg.norm(after - loop, axis=1).sum(), 0, 1e-12)
        bullets = np.linalg.norm(position[static["bullet_nodes"][()]], axis=1)
        check(f"measures: bullets {name}", [summary["bullet_distance_min"][i], summary["bullet_distance_max"][i]],
              [bullets.min(), bullets.max()], 0, 1e-12)


def verdicts_again(summary: h5py.Group) -> None:
    """The thresholds stand beside the verdict: it must follow from them."""
    limit = summary.attrs
    wanted = []
    for i, (coverage, hole, escape) in enumerate(zip(summary["coverage"], summary["largest_hole"], summary["escape"])):
        good = (coverage >= limit["captured_coverage"] and hole <= limit["captured_hole"]
                and escape <= limit["captured_escape"]) if i == 0 else \
            (coverage >= limit["lasting_coverage"] and escape <= limit["lasting_escape"])
        bad = coverage <= limit["failed_coverage"] or escape >= limit["failed_escape"]
        wanted.append(0 if bad else 2 if good else 1)
    check("measures: the verdicts follow from the thresholds", summary["verdict"][()], wanted)
    check("measures: captured means every verdict says so", summary["captured"][()], all(v == 2 for v in wanted))


def ledger_again(file: h5py.File) -> None:
    """Rows of /history that stand at frames, from positions and velocities."""
    static, history = file["static"], file["history"]
    mass, (a, b) = static["node_mass"][()], static["cable_nodes"][()].T
    natural, inertia = static["natural_length"][()], static["target_inertia"][()]
    stiffness, body = static["axial_stiffness"][()] / natural, static["target_mass"][()]
    row_time = history["time"][()]
    for at, time in enumerate(file["time"][()]):
        if at % 30:
            continue
        row = int(np.abs(row_time - time).argmin())
        name = f"at {time:.2f} s"
        check(f"ledger: a row stands {name}", row_time[row], time)
        x, v = file["node_position"][at], file["node_velocity"][at]
        r, w = matrix(file["target_attitude"][at]), file["target_angular_velocity"][at]
        xt, vt = file["target_position"][at], file["target_velocity"][at]
        length = np.linalg.norm(x[b] - x[a], axis=1)
        check(f"ledger: kinetic energy of the net {name}", history["kinetic_net"][row], 0.5 * (mass * (v * v).sum(axis=1)).sum(),
              0, 1e-12)
        check(f"ledger: of the target {name}", history["kinetic_target"][row], 0.5 * body * vt @ vt + 0.5 * w @ inertia @ w, 0, 1e-12)
        check(f"ledger: elastic energy {name}", history["elastic"][row],
              (0.5 * stiffness * np.maximum(0, length - natural) ** 2).sum(), 1e-15, 1e-9)
        momentum = (mass[:, None] * v).sum(axis=0) + body * vt
        check(f"ledger: linear momentum {name}", history["linear_momentum"][row], momentum, 1e-13 * np.linalg.norm(momentum) + 1e-15)
        spin = (mass[:, None] * np.cross(x, v)).sum(axis=0) + body * np.cross(xt, vt) + r @ inertia @ w
        scale = (mass * np.linalg.norm(x, axis=1) * np.linalg.norm(v, axis=1)).sum() + np.linalg.norm(inertia @ w)
        check(f"ledger: angular momentum {name}", history["angular_momentum"][row], spin, 1e-13 * scale)
        check(f"ledger: no frame pulls harder than the row says {name}",
              max(0.0, file["cable_tension"][at].max() - history["max_tension"][row]), 0.0, 1e-12)


def main() -> int:
    builds = sorted(ROOT.glob("build/gfortran_*/app/castnet"), key=lambda f: f.stat().st_mtime)
    castnet = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("CASTNET", builds[-1] if builds else "castnet"))
    with tempfile.TemporaryDirectory() as folder:
        for shape, settings in (("box", []), ("cylinder", ["target/shape='cylinder'", "target/dimensions=0.11,0.3"])):
            path = Path(folder) / f"{shape}.h5"
            times = TIMES if shape == "box" else TIMES[1:4]
            words = [str(castnet), "run", str(ROOT / "input" / "cubesat.nml"), "--output", str(path), "--quiet", "--no-progress"]
            for setting in [f"output/verdict_times={','.join(map(str, times))}", *settings]:
                words += ["--set", setting]
            ran = subprocess.run(words, capture_output=True, text=True, check=False)
            check(f"measures: the {shape} runs", ran.returncode, 0)
            if ran.returncode != 0:
                print("      " + ran.stderr.strip())
                continue
            with h5py.File(path) as file:
                measures_again(file)
                verdicts_again(file["summary"])
                if shape == "box":
                    ledger_again(file)
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
