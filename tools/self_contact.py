#!/usr/bin/env python3
"""Does it matter that a net's cables pass through each other? The tables of docs/net_on_net.md.

    tools/self_contact.py [SCENE ...] [--seeds N] [--counted N] [--cables N] [--castnet PROGRAM] [--fresh] [-o TABLES.md]

Counts of crossings (contact/self_contact = 'count') of a few runs, and ensembles whose cables pass through each other
against ensembles whose cables are held apart ('impulses'; 'taut': only where both are taut). Default method and step,
the nodes nudged by a micrometre. --cables: in each mesh side, so that a slack side can bend.
"""
import argparse
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from castnet_ensemble import Ensemble, cost, difference, read, run, version_of, wilson
from castnet_runner import Job, find_castnet, run_all

ROCKET = {"time/end_time": "10.0", "output/verdict_times": "10.0"}
SCENES = {   # scene: name, settings
    "cubesat": ("cubesat, C, 1.5 rad/s", {}),
    "cubesat_2.0": ("cubesat, C, 2 rad/s", {}),
    "rocket_x_0.4": ("rocket, B, 0.4 rad/s", ROCKET),
    "rocket_x_0.7": ("rocket, B, 0.7 rad/s", ROCKET),
    "rocket_closing_x_1.1": ("rocket, B, 1.1 rad/s, closing", {}),
}
OBSERVABLES = {   # column: heading, factor
    "coverage": ("coverage", 1.0),
    "largest_hole": ("largest hole, degrees", 1.0),
    "cqi": ("CQI", 1.0),
    "final_speed": ("target's speed, mm/s", 1e3),
    "spin_change": ("change of its spin, mrad/s", 1e3),
    "max_tension": ("largest tension, N", 1.0),
}
MODES = {"none": "passing through", "taut": "held apart where taut", "impulses": "held apart"}
KEY = "contact/self_contact"


def flights(castnet: str, scene: str, seeds: int, mode: str, folder: Path, more: dict[int, dict[str, str]] | None = None) -> list[Path]:
    """The files of runs of one scene, without frames."""
    jobs = []
    for seed in range(1, seeds + 1):
        settings = SCENES[scene][1] | {KEY: mode, "output/vtk": ".false.", "perturb/node_position": "1e-6", "perturb/seed": str(seed)}
        jobs.append(Job(scene, folder / f"{scene}_{mode}_{seed}{'_until' if more else ''}.h5", settings | (more or {}).get(seed, {})))
    if run_all(jobs, castnet, fresh=True):
        sys.exit("a run failed")
    return [job.output for job in jobs]


def summaries(files: list[Path], name: str) -> np.ndarray:
    values = []
    for path in files:
        with h5py.File(path) as f:
            values.append(float(f["summary"][name][()]))
    return np.array(values)


def mean_and_range(values: np.ndarray) -> str:
    return f"{values.mean():.4g} ({values.min():.4g} to {values.max():.4g})"


def counts(castnet: str, scenes: list[str], seeds: int) -> str:
    """Crossings of whole captures and of their flights up to first contact; what is left of them when cables are held apart."""
    text = ["| capture | crossings before contact | after | of taut cables, before | after | held apart where taut: collisions | not undone | "
            "held apart: collisions | not undone |", "|---" * 9 + "|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene in scenes:
            whole = flights(castnet, scene, seeds, "count", folder)
            contact = summaries(whole, "first_contact")
            until = {k + 1: {"time/end_time": repr(float(t)), "output/verdict_times": repr(float(t))} for k, t in enumerate(contact)}
            flown = flights(castnet, scene, seeds, "count", folder, until)
            cells = []
            for column in ("self_contacts", "self_contacts_taut"):
                before = summaries(flown, column)
                cells += [mean_and_range(before), mean_and_range(summaries(whole, column) - before)]
            for mode in ("taut", "impulses"):
                apart = flights(castnet, scene, seeds, mode, folder)
                cells += [mean_and_range(summaries(apart, column)) for column in ("self_contacts", "self_contacts_unresolved")]
            text.append(f"| {SCENES[scene][0]} | " + " | ".join(cells) + " |")
    return "\n".join([*text, "", f"Mean (and range) of {seeds} runs each.", ""])


def ensembles(scene: str, seeds: int, cables: int) -> list[Ensemble]:
    settings = SCENES[scene][1] | ({"net/cables_per_side": str(cables)} if cables > 1 else {})
    return [Ensemble(f"self_{mode}_{scene}_{cables}", scene, settings | {KEY: f"'{mode}'"}, seeds, 41 + i) for i, mode in enumerate(MODES)]


def captured(cases: dict[str, np.ndarray]) -> str:
    k, n = int(cases["captured"].sum()), cases["captured"].size
    low, high = wilson(k, n)
    return f"{k} of {n} ({low:.2f} to {high:.2f})" + (f", {cases['failed']} failed" if cases["failed"] else "")


def outcomes(castnet: str, scenes: list[str], seeds: int, cables: int, fresh: bool) -> str:
    names = list(MODES.values())
    first = ["| capture | captured (95 %): " + " | ".join(names) + " | s a run: " + " | ".join(names) + " |", "|---" * 7 + "|"]
    second = [f"| capture | observable | {names[0]} | " + " | ".join(f"{name} | change, 95 % | KS p" for name in names[1:]) + " |", "|---" * 9 + "|"]
    spent = 0.0
    for scene in scenes:
        name, found = SCENES[scene][0], ensembles(scene, seeds, cables)
        for ensemble in found:
            run(ensemble, castnet, fresh=fresh)
            spent += cost(ensemble) * ensemble.seeds
        cases = [read(ensemble) for ensemble in found]
        first.append(f"| {name} | " + " | ".join([*map(captured, cases), *(f"{cost(ensemble):.2g}" for ensemble in found)]) + " |")
        for column, (heading, factor) in OBSERVABLES.items():
            cells = [spread(cases[0][column], factor)]
            for other in cases[1:]:
                d = difference(cases[0][column], other[column])
                cells += [spread(other[column], factor), f"{100 * d.change:+.0f} +- {100 * d.half:.0f} %", f"{d.p:.1g}"]
            second.append(f"| {name} | {heading} | " + " | ".join(cells) + " |")
    return "\n".join([*first, "", *second, "", f"{seeds} runs of each kind, cables in each mesh side: {cables}; {spent:.0f} s of processor time; "
                      f"castnet {version_of(ensembles(scenes[0], seeds, cables)[0])}.", ""])


def spread(values: np.ndarray, factor: float) -> str:
    return f"{factor * values.mean():.3g} +- {factor * values.std(ddof=1):.2g}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--seeds", type=int, default=16, help="of each ensemble")
    parser.add_argument("--counted", type=int, default=4, help="runs whose crossings are counted")
    parser.add_argument("--cables", type=int, default=1, help="in each mesh side, of the ensembles")
    parser.add_argument("--castnet")
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    castnet = find_castnet(options.castnet)
    text = "\n".join([counts(castnet, options.scenes, options.counted) if options.counted else "",
                      outcomes(castnet, options.scenes, options.seeds, options.cables, options.fresh)])
    if options.output:
        Path(options.output).write_text(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
