#!/usr/bin/env python3
"""What the contact model does to the probability of capture: the table of docs/validation.md.

    tools/contact_ensembles.py [--seeds N] [--castnet PROGRAM] [--fresh] [-o TABLE.md]

Four captures x five contact models, at the default method and step, the nodes nudged by a micrometre.
"""
import argparse
import sys
from dataclasses import replace

import numpy as np
from castnet_ensemble import Ensemble, cost, read, run, version_of, wilson
from castnet_runner import find_castnet

SCENES = {"cubesat": "cubesat, C, 1.5 rad/s", "cubesat_2.0": "cubesat, C, 2 rad/s",
          "rocket_x_0.4": "rocket, B, 0.4 rad/s", "rocket_x_0.7": "rocket, B, 0.7 rad/s"}
ROUGH, CABLES = {"contact/friction": "0.3"}, {"contact/detect": "'cables'"}
MODELS = {
    "the paper's (equality)": {"contact/impulses": "'equality'"},
    "push only (default)": {},
    "with friction 0.3": ROUGH,
    "with cables": CABLES,
    "cables and friction": CABLES | ROUGH,
}
DEFAULT = {"time/method": "'midpoint'", "time/step": "0.0"}


def enough(ensemble: Ensemble) -> Ensemble:
    """The ensemble itself, or what is there already if that has more runs."""
    if ensemble.table.is_file() and read(ensemble)["captured"].size > ensemble.seeds:
        return replace(ensemble, seeds=int(read(ensemble)["captured"].size))
    return ensemble


def ensembles(seeds: int) -> dict[tuple[str, str], Ensemble]:
    return {(scene, model): Ensemble(f"contact_{scene}_{i}", scene, DEFAULT | MODELS[model], seeds, 16 + i)
            for scene in SCENES for i, model in enumerate(MODELS)}


def spread(values: np.ndarray, digits: int = 3) -> str:
    return f"{values.mean():.{digits}g} +- {values.std(ddof=1):.2g}"


def cells(ensemble: Ensemble) -> str:
    cases = read(ensemble)
    k, n = int(cases["captured"].sum()), cases["captured"].size
    low, high = wilson(k, n)
    failed = f" ({cases['failed']} failed)" if cases["failed"] else ""
    return (f"{k} of {n}{failed} | {k / n:.2f} ({low:.2f} to {high:.2f}) | {spread(cases['coverage'])} | {spread(1e3 * cases['final_speed'])} | "
            f"{spread(1e3 * cases['spin_change'])} | {1e3 * np.max(cases['deepest_penetration']):.2g} | {cost(ensemble):.2g}")


def table(found: dict[tuple[str, str], Ensemble]) -> str:
    text = ["| capture | contact | captured | probability (95 %) | coverage at the end | speed, mm/s | change of spin, mrad/s | deepest, mm | s a run |",
            "|---|---|---|---|---|---|---|---|---|"]
    text += [f"| {SCENES[scene]} | {model} | {cells(ensemble)} |" for (scene, model), ensemble in found.items()]
    some = next(iter(found.values()))     # no commit in a plain build
    total = sum(cost(e) * e.seeds for e in found.values())
    commit = " ".join(version_of(some).split()[:4])
    return "\n".join([*text, "", f"{sum(e.seeds for e in found.values())} runs in {total:.0f} s of processor time, castnet {commit}.", ""])


def section(castnet: str, seeds: int = 16, fresh: bool = False) -> str:
    """The table, after running what is missing of it."""
    found = {key: ensemble if fresh else enough(ensemble) for key, ensemble in ensembles(seeds).items()}
    for ensemble in found.values():
        run(ensemble, castnet, fresh=fresh)
    return table(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--castnet")
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    text = section(find_castnet(options.castnet), options.seeds, options.fresh)
    if options.output:
        with open(options.output, "w") as f:
            f.write(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
