#!/usr/bin/env python3
"""Does the one-stage method bias a capture? Ensembles of `midpoint` at its automatic step against fine `rk4`.

    tools/method_ensembles.py [NAME ...] [--castnet PROGRAM] [--list] [--fresh] [-o TABLE.md]

NAME is a comparison (all of them by default): the plain captures, then with restitution 0.1 and friction 0.3 (soft),
with the closing mechanism, with the cables in contact. What is there already is not run again.
"""
import argparse
import sys

from castnet_ensemble import Ensemble, cost, difference, read, run, version_of, wilson
from castnet_runner import find_castnet

OBSERVABLES = {   # column: heading, unit, factor
    "final_speed": ("speed", "mm/s", 1e3),
    "spin_change": ("change of spin", "mrad/s", 1e3),
    "first_contact": ("first contact", "s", 1.0),
    "coverage": ("coverage", "", 1.0),
    "cqi": ("CQI", "", 1.0),
}

ROCKET = {"time/end_time": "10.0", "output/verdict_times": "10.0"}
CUBESAT: dict[str, str] = {}
CLOSING: dict[str, str] = {}
PLASTIC = {"contact/restitution": "0.1"}
ROUGH = {"contact/friction": "0.3"}
CABLES = {"contact/detect": "'cables'"}

# name: scene, settings of both, step of rk4, runs of rk4, runs of midpoint
COMPARISONS = {
    "rocket": ("rocket_x_0.4", ROCKET, "5e-5", 256, 512),
    "cubesat": ("cubesat", CUBESAT, "1e-5", 768, 2048),
    "rocket_soft": ("rocket_x_0.4", ROCKET | ROUGH | PLASTIC, "2e-4", 96, 192),
    "rocket_closing_x": ("rocket_closing_x_1.1", CLOSING, "1e-4", 192, 512),
    "rocket_closing_z": ("rocket_closing_z_1.1", CLOSING, "1e-4", 192, 512),
    "rocket_cables": ("rocket_x_0.4", ROCKET | CABLES, "2e-4", 96, 192),
    "cubesat_soft": ("cubesat", CUBESAT | ROUGH | PLASTIC, "3e-5", 96, 192),
    "cubesat_cables": ("cubesat", CUBESAT | CABLES, "3e-5", 96, 192),
}
MARGIN = 0.05


def pair(name: str, fraction: float = 0.0) -> tuple[Ensemble, Ensemble]:
    scene, both, step, fine, cheap = COMPARISONS[name]
    return (Ensemble(f"{name}_rk4", scene, both | {"time/method": "'rk4'", "time/step": step}, fine, 1),
            Ensemble(f"{name}_midpoint", scene, both | {"time/method": "'midpoint'", "time/step": "0.0"}, cheap, 2))


def word(d) -> str:
    """Of the mean against the margin, by its interval."""
    low, high = d.change - d.half, d.change + d.half
    if -MARGIN <= low and high <= MARGIN:
        return "within 5 %"
    return "**beyond 5 %**" if low > MARGIN or high < -MARGIN else "not resolved"


def captured(cases) -> str:
    k, n = int(cases["captured"].sum()), cases["captured"].size
    low, high = wilson(k, n)
    return f"{k} of {n} ({low:.2f} to {high:.2f})" + (f", {cases['failed']} failed" if cases["failed"] else "")


def rows(name: str) -> list[str]:
    fine, cheap = pair(name)
    a, b = read(fine), read(cheap)
    text = []
    for column, (heading, unit, factor) in OBSERVABLES.items():
        d = difference(a[column], b[column])
        text.append(f"| {name} | {heading} {unit} | {d.reference[0] * factor:.4g} +- {d.reference[1] * factor:.2g} | "
                    f"{d.candidate[0] * factor:.4g} +- {d.candidate[1] * factor:.2g} | {100 * d.change:+.1f} +- {100 * d.half:.1f} % | "
                    f"{word(d)} | {d.p:.2g} |")
    return text


def table(names: list[str]) -> str:
    head = ["| ensemble | rk4 step | runs | s each | captured | midpoint step | runs | s each | captured |", "|---|---|---|---|---|---|---|---|---|"]
    body = ["| ensemble | observable | rk4 | midpoint | change of the mean, 95 % | | KS p |", "|---|---|---|---|---|---|---|"]
    for name in names:
        fine, cheap = pair(name)
        a, b = read(fine), read(cheap)
        end = {"rocket": 10.0, "cubesat": 3.0}[name.split("_")[0]] if "closing" not in name else 13.0
        head.append(f"| {name} | {COMPARISONS[name][2]} | {fine.seeds} | {cost(fine):.2g} | {captured(a)} | {end / b['steps'][0]:.3g} | "
                    f"{cheap.seeds} | {cost(cheap):.2g} | {captured(b)} |")
        body += rows(name)
    return "\n".join([f"castnet {version_of(pair(names[0])[1]).splitlines()[0]}", "", *head, "", *body, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(COMPARISONS), metavar="NAME")
    parser.add_argument("--castnet")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    if options.list:
        print("\n".join(COMPARISONS))
        return 0
    castnet = find_castnet(options.castnet)
    for name in options.names:
        for ensemble in pair(name):
            run(ensemble, castnet, fresh=options.fresh)
    text = table(options.names)
    if options.output:
        with open(options.output, "w") as f:
            f.write(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
