#!/usr/bin/env python3
"""Does it matter that a net's cables pass through each other? The tables of docs/net_on_net.md.

    tools/self_contact.py [SCENE ...] [--seeds N] [--counted N] [--castnet PROGRAM] [--fresh] [-o TABLES.md]

Counts of crossings (contact/self_contact = 'count') of a few runs, and ensembles whose cables pass through each other
against ensembles whose cables are held apart ('impulses'): default method and step, the nodes nudged by a micrometre.
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
OBSERVABLES = {   # column: heading, unit, factor
    "coverage": ("coverage", "", 1.0),
    "largest_hole": ("largest hole", "degree", 1.0),
    "cqi": ("CQI", "", 1.0),
    "final_speed": ("target's speed", "mm/s", 1e3),
    "spin_change": ("change of its spin", "mrad/s", 1e3),
    "max_tension": ("largest tension", "N", 1.0),
    "first_contact": ("first contact", "s", 1.0),
}
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
    """Crossings of whole captures and of their flights up to first contact."""
    text = ["| capture | crossings before contact | after | of taut cables, before | after | held apart: collisions | not undone |",
            "|---|---|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as name:
        for scene in scenes:
            whole = flights(castnet, scene, seeds, "count", Path(name))
            contact = summaries(whole, "first_contact")
            until = {k + 1: {"time/end_time": repr(float(t)), "output/verdict_times": repr(float(t))} for k, t in enumerate(contact)}
            flown = flights(castnet, scene, seeds, "count", Path(name), until)
            apart = flights(castnet, scene, seeds, "impulses", Path(name))
            cells = []
            for column in ("self_contacts", "self_contacts_taut"):
                before = summaries(flown, column)
                cells += [mean_and_range(before), mean_and_range(summaries(whole, column) - before)]
            cells += [mean_and_range(summaries(apart, column)) for column in ("self_contacts", "self_contacts_unresolved")]
            text.append(f"| {SCENES[scene][0]} | " + " | ".join(cells) + " |")
    return "\n".join([*text, "", f"Mean (and range) of {seeds} runs each.", ""])


def pair(scene: str, seeds: int) -> tuple[Ensemble, Ensemble]:
    return tuple(Ensemble(f"self_{mode}_{scene}", scene, SCENES[scene][1] | {KEY: f"'{mode}'"}, seeds, seed)
                 for mode, seed in (("none", 41), ("impulses", 42)))


def captured(cases: dict[str, np.ndarray]) -> str:
    k, n = int(cases["captured"].sum()), cases["captured"].size
    low, high = wilson(k, n)
    return f"{k} of {n} ({low:.2f} to {high:.2f})" + (f", {cases['failed']} failed" if cases["failed"] else "")


def outcomes(castnet: str, scenes: list[str], seeds: int, fresh: bool) -> str:
    first = ["| capture | captured, passing through (95 %) | held apart | s a run | |", "|---|---|---|---|---|"]
    second = ["| capture | observable | passing through | held apart | change of the mean, 95 % | KS p |", "|---|---|---|---|---|---|"]
    spent = 0.0
    for scene in scenes:
        both = pair(scene, seeds)
        for ensemble in both:
            run(ensemble, castnet, fresh=fresh)
            spent += cost(ensemble) * ensemble.seeds
        a, b = (read(ensemble) for ensemble in both)
        first.append(f"| {SCENES[scene][0]} | {captured(a)} | {captured(b)} | {cost(both[0]):.2g} | {cost(both[1]):.2g} |")
        for column, (heading, unit, factor) in OBSERVABLES.items():
            d = difference(a[column], b[column])
            second.append(f"| {SCENES[scene][0]} | {heading} {unit} | {d.reference[0] * factor:.4g} +- {d.reference[1] * factor:.2g} | "
                          f"{d.candidate[0] * factor:.4g} +- {d.candidate[1] * factor:.2g} | {100 * d.change:+.1f} +- {100 * d.half:.1f} % | {d.p:.2g} |")
    commit = " ".join(version_of(pair(scenes[0], seeds)[0]).split()[:4])
    return "\n".join([*first, "", *second, "", f"{spent:.0f} s of processor time, castnet {commit}.", ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--seeds", type=int, default=64, help="of each ensemble")
    parser.add_argument("--counted", type=int, default=4, help="runs whose crossings are counted")
    parser.add_argument("--castnet")
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    castnet = find_castnet(options.castnet)
    text = "\n".join([counts(castnet, options.scenes, options.counted) if options.counted else "",
                      outcomes(castnet, options.scenes, options.seeds, options.fresh)])
    if options.output:
        Path(options.output).write_text(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
