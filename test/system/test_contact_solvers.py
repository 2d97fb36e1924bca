#!/usr/bin/env python3
"""Contact impulses against an independent method.

    test_contact_solvers.py PATH_TO_CASTNET

The test program `contact_systems`, built beside castnet, writes random contact systems and
those of a net that falls on a spinning box, with castnet's answers. Without friction the
velocities after are those of least distance (mass for a metric) from the ones before among
all that meet 0 <= v+ + e min(v-, 0): scipy's non-negative least squares finds them from
nothing but that (Lawson and Hanson's LDP). Velocities are compared: where cables share
nodes the impulses themselves are not unique. With friction the answer need not be unique
either, and what is checked is Coulomb's law, momentum and energy, from the masses alone.
"""
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

CASTNET = Path(sys.argv[1]).resolve()
results: list[bool] = []


def check(name: str, good: bool, seen: object = "") -> None:
    results.append(bool(good))
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f"\n      seen: {seen}"), flush=True)


def finish() -> None:
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    sys.exit(0 if all(results) and results else 1)


def read(path: Path) -> list[dict]:
    lines = path.read_text().split("\n")
    systems, at = [], 0
    while at < len(lines) and lines[at].startswith("system"):
        _, kind, n, friction, restitution, residual, converged = lines[at].split()
        n = int(n)
        body = np.array(lines[at + 1].split(), float)
        rows = np.array([line.split() for line in lines[at + 2:at + 2 + n]], float)
        systems.append(dict(kind=kind, n=n, friction=float(friction), restitution=float(restitution),
                            residual=float(residual), converged=converged == "1", inverse_mass=body[0],
                            inverse_inertia=body[1:].reshape(3, 3, order="F"), a=rows[:, 0].astype(int),
                            b=rows[:, 1].astype(int), share=rows[:, 2], inverse_a=rows[:, 3], inverse_b=rows[:, 4],
                            normal=rows[:, 5:8], arm=rows[:, 8:11], velocity=rows[:, 11:14], impulse=rows[:, 14],
                            friction_impulse=rows[:, 15:18]))
        at += 2 + n
    return systems


def skew(r: np.ndarray) -> np.ndarray:
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def mobility_root(s: dict) -> np.ndarray:
    """F (3n x unknowns) with F F^T the mobility: relative velocities per change of the nodes'
    and the body's velocities in the metric of their masses."""
    numbers = {node: k for k, node in enumerate(sorted(set(s["a"]) | set(s["b"])))}
    f = np.zeros((3*s["n"], 3*len(numbers) + 6))
    turn = np.linalg.cholesky(s["inverse_inertia"])
    for i in range(s["n"]):
        rows = slice(3*i, 3*i + 3)
        a, b = numbers[s["a"][i]], numbers[s["b"][i]]
        f[rows, 3*a:3*a + 3] += (1 - s["share"][i])*np.sqrt(s["inverse_a"][i])*np.eye(3)
        if a != b:
            f[rows, 3*b:3*b + 3] += s["share"][i]*np.sqrt(s["inverse_b"][i])*np.eye(3)
        f[rows, -6:-3] = -np.sqrt(s["inverse_mass"])*np.eye(3)
        f[rows, -3:] = skew(s["arm"][i]) @ turn
    return f


def least_distance(g: np.ndarray, h: np.ndarray) -> np.ndarray:
    """x of least norm with g x >= h (Lawson and Hanson, Solving Least Squares Problems, ch. 23)."""
    scale = max(1e-300, np.abs(h).max())
    e = np.vstack([g.T, h[None, :]/scale])
    f = np.zeros(len(e))
    f[-1] = 1.0
    u, _ = nnls(e, f, maxiter=30*len(h) + 100)
    r = e @ u - f
    return -r[:-1]/r[-1]*scale


def solve(s: dict) -> dict:
    """Velocities by both, and how far castnet's are from the law."""
    n = s["n"]
    f = mobility_root(s)
    j = s["impulse"][:, None]*s["normal"] + s["friction_impulse"]
    change = f.T @ j.ravel()
    after = s["velocity"] + (f @ change).reshape(n, 3)
    before_n = np.einsum("ij,ij->i", s["velocity"], s["normal"])
    after_n = np.einsum("ij,ij->i", after, s["normal"])
    slack = after_n + s["restitution"]*np.minimum(before_n, 0)
    after_t = after - after_n[:, None]*s["normal"]
    speed = np.linalg.norm(after_t, axis=1)
    grip = np.linalg.norm(s["friction_impulse"], axis=1)
    own = np.einsum("ij,ij->i", f.reshape(n, 3, -1)[:, 0], f.reshape(n, 3, -1)[:, 0])
    # 0 <= j, 0 <= slack, one of them 0: the lesser one, j as the velocity that it gives.
    law = np.abs(np.minimum(own*s["impulse"], slack)).max()
    cone = (own*(grip - s["friction"]*s["impulse"])).max()
    # It sticks, or friction is at its bound and straight against the sliding.
    slip = (own*(s["friction"]*s["impulse"]*speed + np.einsum("ij,ij->i", s["friction_impulse"], after_t))).max()
    gain = change @ change/2 + (s["velocity"].ravel() @ j.ravel())
    scale = max(1e-300, np.abs(s["velocity"]).max())
    size = np.sum(np.abs(s["velocity"]*j)) + change @ change
    answer = dict(law=law/scale, cone=cone/scale, slip=slip/scale**2, gain=gain/max(size, 1e-300), least=s["impulse"].min())
    if s["friction"] == 0:
        rows = np.einsum("ic,icx->ix", s["normal"], f.reshape(n, 3, -1))
        x = least_distance(rows, -before_n - s["restitution"]*np.minimum(before_n, 0))
        answer["differs"] = np.abs(f @ (x - change)).max()/scale
    return answer


def main() -> None:
    built = sorted(CASTNET.parents[2].glob("gfortran_*/test/contact_systems"), key=lambda p: p.stat().st_mtime)
    check("the program contact_systems is built", bool(built), CASTNET.parents[2])
    if not built:
        finish()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder)/"systems.txt"
        done = subprocess.run([built[-1], file], capture_output=True, text=True, timeout=120)
        check("it runs", done.returncode == 0, done.stderr[-500:])
        systems = read(file) if file.exists() else []
    for kind in ("random", "captured"):
        for with_friction in (False, True):
            chosen = [s for s in systems if s["kind"] == kind and (s["friction"] > 0) == with_friction]
            name = f"{len(chosen)} {kind} systems {'with' if with_friction else 'without'} friction"
            check(f"{name}: there are enough", len(chosen) >= 30 and max(s["n"] for s in chosen) >= 10, len(chosen))
            if not chosen:
                continue
            answers = [solve(s) for s in chosen]

            def worst(key: str) -> float:
                return max(a[key] for a in answers)

            check(f"{name}: all converged", all(s["converged"] for s in chosen),
                  [s["residual"] for s in chosen if not s["converged"]])
            check(f"{name}: no impulse pulls", min(a["least"] for a in answers) >= 0, min(a["least"] for a in answers))
            check(f"{name}: law of the normal to {worst('law'):.1e} of the speeds", worst("law") <= 1e-9, worst("law"))
            check(f"{name}: no energy from nothing", worst("gain") <= 1e-11, worst("gain"))
            if with_friction:
                check(f"{name}: in the cone to {worst('cone'):.1e}", worst("cone") <= 1e-9, worst("cone"))
                check(f"{name}: sticks or slides against the motion to {worst('slip'):.1e}", worst("slip") <= 1e-9,
                      worst("slip"))
            else:
                check(f"{name}: the velocities of non-negative least squares to {worst('differs'):.1e}",
                      worst("differs") <= 1e-8, worst("differs"))
    finish()


main()
