"""Ensembles for the tables in docs/: study files made from a scene and what is set differently, run, read, compared."""
from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from castnet_runner import INPUT, ROOT
from scipy import stats

OUT = ROOT / "out" / "ensembles"
NUDGE = "1e-6"          # standard deviation of every node coordinate at the start [m]
Z = 1.959963984540054   # of a 95 % interval


@dataclass(frozen=True)
class Ensemble:
    """Runs of one scene of input/ that differ by a nudge of the nodes."""

    name: str
    scene: str
    settings: dict[str, str] = field(default_factory=dict)   # 'group/key': value as a scene file has it
    seeds: int = 64
    seed: int = 1                                            # of the study: two ensembles that are compared differ in it

    @property
    def table(self) -> Path:
        return OUT / f"{self.name}.h5"


def write_files(ensemble: Ensemble) -> Path:
    """The scene and the study of an ensemble; returns the study file."""
    OUT.mkdir(parents=True, exist_ok=True)
    groups: dict[str, list[str]] = {"perturb": [f"node_position = {NUDGE}"]}
    for key, value in ensemble.settings.items():
        group, name = key.split("/")
        groups.setdefault(group, []).append(f"{name} = {value}")
    base = os.path.relpath(INPUT / f"{ensemble.scene}.nml", OUT)
    lines = [f"&include file = '{base}' /"] + [f"&{group} {', '.join(keys)} /" for group, keys in groups.items()]
    scene = OUT / f"{ensemble.name}_scene.nml"
    study = OUT / f"{ensemble.name}.nml"
    for path, text in ((scene, "\n".join(lines)),
                       (study, f"&study scene = '{scene.name}', seed = {ensemble.seed}, seeds = {ensemble.seeds} /")):
        if not path.is_file() or path.read_text() != text + "\n":
            path.write_text(text + "\n")
    return study


def run(ensemble: Ensemble, castnet: str, *, fresh: bool = False) -> None:
    """Run what is missing of an ensemble. What it cost is kept beside the table."""
    study = write_files(ensemble)
    note = ensemble.table.with_suffix(".cost")
    identity = study.read_text() + (OUT / f"{ensemble.name}_scene.nml").read_text()
    if not fresh and ensemble.table.is_file() and note.is_file() and json.loads(note.read_text())["of"] == identity:
        return
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    result = subprocess.run([castnet, "study", str(study), "--output", str(ensemble.table), "--force", "--quiet"],
                            stdin=subprocess.DEVNULL, capture_output=True, text=True,
                            check=False)
    if result.returncode != 0:
        sys.exit(f"{ensemble.name}: castnet study ended with {result.returncode}\n{result.stderr}")
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    note.write_text(json.dumps({"of": identity, "seconds": spent, "each": spent / ensemble.seeds}))
    print(f"{ensemble.name}: {ensemble.seeds} runs, {spent:.1f} s of processor time", file=sys.stderr, flush=True)


def cost(ensemble: Ensemble) -> float:
    """Processor time of one run [s]."""
    return json.loads(ensemble.table.with_suffix(".cost").read_text())["each"]


def read(ensemble: Ensemble) -> dict[str, np.ndarray]:
    """The columns of /case, of the runs that ended; with 'failed', the number of those that did not."""
    with h5py.File(ensemble.table) as f:
        cases = {name: column[()] for name, column in f["case"].items()}
    done = cases["status"] == 0
    failed = int(np.sum(~done))
    cases = {name: column[done] for name, column in cases.items() if name != "reason"}
    cases["failed"] = failed
    return cases


def version_of(ensemble: Ensemble) -> str:
    with h5py.File(ensemble.table) as f:
        text = f["meta/version"][()]
    return text.decode() if isinstance(text, bytes) else str(text)


def wilson(k: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval."""
    p = k / n
    middle = (p + Z * Z / (2 * n)) / (1 + Z * Z / n)
    half = Z * np.sqrt(p * (1 - p) / n + Z * Z / (4 * n * n)) / (1 + Z * Z / n)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass
class Difference:
    """A candidate's observable against a reference's."""

    reference: tuple[float, float]   # mean, standard deviation
    candidate: tuple[float, float]
    change: float                    # of the mean, relative
    half: float                      # half-width of its 95 % interval (Welch)
    p: float                         # two-sample Kolmogorov-Smirnov


def difference(reference: np.ndarray, candidate: np.ndarray) -> Difference:
    a, b = (np.asarray(x, float)[np.isfinite(x)] for x in (reference, candidate))
    if a.size < 2 or b.size < 2:
        return Difference((np.nan, np.nan), (np.nan, np.nan), np.nan, np.nan, np.nan)
    va, vb = a.var(ddof=1) / a.size, b.var(ddof=1) / b.size
    freedom = (va + vb) ** 2 / (va**2 / (a.size - 1) + vb**2 / (b.size - 1)) if va + vb > 0 else 1.0
    half = stats.t.ppf(0.975, freedom) * np.sqrt(va + vb)
    scale = abs(a.mean()) or 1.0
    return Difference((a.mean(), a.std(ddof=1)), (b.mean(), b.std(ddof=1)), (b.mean() - a.mean()) / scale, half / scale,
                      float(stats.ks_2samp(a, b).pvalue))
