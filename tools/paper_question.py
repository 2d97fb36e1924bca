#!/usr/bin/env python3
"""The paper's question as probabilities: up to which tumbling rate does the net hold the body?

    tools/paper_question.py [--threads N] [--folder out/studies] [--fresh] [--no-run]

Runs every study of input/studies that the page names (what is finished is not run again), draws the
figures and writes docs/capture_probability.md with the number of runs and the machine time. The
studies say method and step; every number on the page comes from their tables.
"""
from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from castnet_runner import ROOT, find_castnet  # noqa: E402
from plot_study import BLUE, RED, Study, band, chart, wilson  # noqa: E402
from validation_page import shrink, version_of  # noqa: E402

STUDIES = ROOT / "input" / "studies"
CASES = {
    "A": "long axis across the approach, turning about the approach like a propeller",
    "B": "long axis across the approach, end over end",
    "C": "long axis along the approach, end over end",
    "D": "long axis along the approach, turning about it",
}
#: Body -> cases, and the studies of each: one attitude, all phases, all phases with closing.
BODIES = {
    "cubesat": ("ABCD", {"named": "cubesat_case_{}", "phase": "cubesat_case_{}_phase"}),
    "rocket": ("ABC", {"named": "rocket_case_{}", "phase": "rocket_case_{}_phase", "closing": "rocket_closing_case_{}_phase"}),
}
#: What the paper saw, one run each: body, case, rate in rad/s, its words.
PAPER = [
    ("cubesat", "C", 0.0, "caught"), ("cubesat", "C", 1.0, "caught"), ("cubesat", "C", 1.5, "caught"), ("cubesat", "C", 2.0, "not caught"),
    ("rocket", "B", 0.1, "caught"), ("rocket", "B", 0.4, "caught"), ("rocket", "B", 0.7, "slips out"),
    ("rocket", "A", 0.1, "caught"), ("rocket", "A", 0.4, "caught"), ("rocket", "A", 0.7, "the arms do not cross"),
]
GREEN = "#2e8b57"
WORDS = {"named": "as named", "phase": "any phase", "closing": "any phase, with closing"}
COLOURS = {"named": RED, "phase": BLUE, "closing": GREEN}


def names() -> list[str]:
    return [pattern.format(case) for cases, kinds in BODIES.values() for pattern in kinds.values() for case in cases]


def run_study(castnet: str, name: str, folder: Path, threads: int | None, fresh: bool) -> None:
    """Run what is missing of a study, and add the time that it took to times.json."""
    output = folder / f"{name}.h5"
    words = [castnet, "study", str(STUDIES / f"{name}.nml"), "--output", str(output), "--quiet", "--no-progress"]
    words += ["--threads", str(threads)] if threads else []
    words += ["--force"] if fresh else []
    book = folder / "times.json"
    times = json.loads(book.read_text()) if book.is_file() else {}
    journal = Path(f"{output}.cases")
    if fresh or not journal.is_file():
        times.pop(name, None)
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        sys.exit(f"{name}: exit {done.returncode}\n{done.stderr}")
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    taken = times.get(name, {"processor": 0.0, "wall": 0.0})
    times[name] = {"processor": taken["processor"] + spent, "wall": taken["wall"] + time.monotonic() - began}
    book.write_text(json.dumps(times, indent=1))
    print(f"{name}: {times[name]['processor']:.0f} s of processor time", file=sys.stderr, flush=True)


def planned_runs(study: str) -> int:
    """Runs of a grid, from the study's text."""
    words = re.sub(r"!.*", "", study)
    number = lambda key: [int(n) for n in re.findall(rf"\b{key}\s*=\s*(\d+)", words)]  # noqa: E731
    return int(np.prod(number("count") + number("seeds")))


class Result:
    """A study by rate, and by rate and phase."""

    def __init__(self, path: Path):
        study = Study(path)
        self.planned = planned_runs(study.text)
        point = study.point
        self.rate_key = next(k for k, name in study.keys if "angular_velocity" in name)
        self.phase_key = next((k for k, name in study.keys if name == "target/phase"), None)
        self.point, self.runs = point, int(point["runs"].sum())
        self.failed = int((~study.done).sum())
        self.rate = np.unique(point[self.rate_key])
        here = [point[self.rate_key] == rate for rate in self.rate]
        self.n = np.array([point["runs"][h].sum() for h in here])
        self.hits = np.array([point["captured"][h].sum() for h in here])
        self.p = np.where(self.n > 0, self.hits / np.maximum(1, self.n), np.nan)
        self.lower, self.upper = wilson(self.hits, self.n)


def figure(body: str, results: dict[tuple[str, str], Result]):
    """Curves above, a map of rate against phase below for each kind that has one."""
    cases, kinds = BODIES[body]
    maps = [kind for kind in kinds if kind != "named"]
    plt.rcParams["axes.grid"] = False
    fig, axes = plt.subplots(1 + len(maps), len(cases), figsize=(3.1 * len(cases) + 0.9, 2.9 + 2.6 * len(maps)),
                             constrained_layout=True, squeeze=False)
    for column, case in enumerate(cases):
        for kind in kinds:
            r = results[kind, case]
            band(axes[0, column], r.rate, r.p, r.lower, r.upper, WORDS[kind], COLOURS[kind])
        axes[0, column].set_title(f"case {case}", fontsize=9)
        for row, kind in enumerate(maps, 1):
            r = results[kind, case]
            mesh = chart(axes[row, column], r.point[r.rate_key], r.point[r.phase_key], r.point["probability"],
                         r.point["lower"], r.point["upper"])
            axes[row, column].set_title(WORDS[kind].replace("any phase", "by phase"), fontsize=8)
            axes[row, column].set_ylabel("phase at the start, degrees" if column == 0 else "")
        for row in range(1 + len(maps)):
            axes[row, column].set_xlim(r_edges(results["phase", case].rate))
            axes[row, column].set_yticks(range(0, 180, 30) if case != "D" else range(0, 90, 15)) if row else None
        axes[-1, column].set_xlabel("rate, rad/s")
        if column:
            axes[0, column].set_ylabel("")
    axes[0, 0].legend(frameon=False, fontsize=7, loc="lower left")
    fig.colorbar(mesh, ax=axes[1:, -1].tolist(), label="probability of capture", shrink=0.8)
    return fig


def r_edges(rate):
    half = (rate[1] - rate[0]) / 2
    return rate[0] - half, rate[-1] + half


def table(body: str, results: dict[tuple[str, str], Result]) -> list[str]:
    """A line for each rate, case and kind side by side: captured of runs, and the 95 % interval."""
    cases, kinds = BODIES[body]
    lines = []
    for kind in kinds:
        lines += [f"**{WORDS[kind][0].upper()}{WORDS[kind][1:]}**", ""]
        lines += ["| rad/s | " + " | ".join(f"case {c}" for c in cases) + " |", "|---" * (1 + len(cases)) + "|"]
        for i, rate in enumerate(results[kind, cases[0]].rate):
            cells = [cell(results[kind, c], i) for c in cases]
            lines.append(f"| {rate:.3g} | " + " | ".join(cells) + " |")
        lines.append("")
    return lines


def cell(r: Result, i: int) -> str:
    return f"{r.hits[i]} of {r.n[i]}: {r.p[i]:.2f} ({r.lower[i]:.2f} to {r.upper[i]:.2f})"


def unfinished(results) -> str:
    """Says so where a study has not been run to its end."""
    lacking = [f"{BODIES[body][1][kind].format(case)} {r.runs + r.failed} of {r.planned}" for body in results
               for (kind, case), r in results[body].items() if r.runs + r.failed < r.planned]
    return f"\nNot run to their end, so that intervals are wider than they would be: {', '.join(lacking)} runs." if lacking else ""


def beside_the_paper(results) -> list[str]:
    """The paper's outcomes, and how probable a capture is in the same attitude and over all phases."""
    lines = ["| body, case | rad/s | the paper | captured, as named | captured, any phase |", "|---|---|---|---|---|"]
    for body, case, rate, words in PAPER:
        cells = []
        for kind in ("named", "phase"):
            r = results[body][kind, case]
            i = int(np.argmin(np.abs(r.rate - rate)))
            cells.append(cell(r, i) if abs(r.rate[i] - rate) < 1e-6 else "rate not run")
        lines.append(f"| {body}, {case} | {rate:.3g} | {words} | {cells[0]} | {cells[1]} |")
    return lines + [""]


def threshold(r: Result) -> str:
    """Between which rates of the grid the estimate falls below a half for the first time, and whether it comes back."""
    low = r.p < 0.5
    if low.all():
        return "below a half at every rate"
    if not low.any():
        return f"above a half at every rate up to {r.rate[-1]:.3g}"
    first = int(np.argmax(low))
    words = f"first below a half between {r.rate[first - 1]:.3g} and {r.rate[first]:.3g} rad/s" if first else \
        f"below a half already at {r.rate[0]:.3g}"
    back = [f"{x:.3g}" for x, bad in zip(r.rate[first:], low[first:]) if not bad]
    return words + (f"; above it again at {', '.join(back)}" if back else "")


PAGE = """# Up to which rate does a net hold a tumbling body?

The paper (Shan, Guo, Gill, JGCD 41(9), 2018) answers with single runs: its cubesat is caught up to 1.5 rad/s, its rocket
stage up to 0.4 rad/s end over end, and at 1.1 rad/s with the closing mechanism. A net is chaotic and one run of it proves
nothing, so here the answer is a probability. Written by `tools/paper_question.py`; do not edit by hand.

The paper names no attitudes. These are the cases of [`validation.md`](validation.md):

{cases}

*As named*: the body starts in the case's attitude, so that the rate also decides how it is turned when the net arrives; 16 runs
a rate. *Any phase*: it starts turned about its spin axis by each of some equally spaced phases, over the angle after which it
looks the same again; the curve counts all of them together, which is the answer for an attitude that nobody knows, and the
map below shows each. B and C are the same tumbling a quarter turn apart: over all phases they are one question, asked
twice with other seeds. Runs of one point differ by a micrometre (standard deviation) in the nodes' start. Bands and brackets
are 95 % intervals (Wilson); cells of a map are hatched where the interval holds 0.5. *Captured*: at the first verdict time
(cubesat 3 s, rocket 10 s) coverage >= 0.9, largest hole <= 30 degrees and no direction of escape, and at the rocket's second
(12.5 s, with closing 13 s) coverage >= 0.8 and no escape. Method: midpoint with the step chosen for it (`step = 0`), not the
paper's; contact at the nodes, restitution 1, no friction; closing as in `input/rocket_closing_x_1.1.nml`.

castnet {version}, commit {commit}. {runs} runs{failed}, {processor} of processor time.{unfinished}
"""


def page(results, times, castnet: str, figures: list[str]) -> str:
    runs = sum(r.runs for body in results.values() for r in body.values())
    failed = sum(r.failed for body in results.values() for r in body.values())
    spent = sum(times.get(name, {}).get("processor", 0.0) for name in names())
    commit = subprocess.run(["git", "log", "-1", "--format=%h", "--", "src", "app", "fpm.rsp"], cwd=ROOT, capture_output=True, text=True, check=False)
    version = version_of(castnet).split(",")[0]
    lines = [PAGE.format(cases="\n".join(f"- **{c}**: {words}" for c, words in CASES.items()), version=version,
                         commit=commit.stdout.strip() or "unknown", runs=runs,
                         unfinished=unfinished(results), failed=f", {failed} more not run to the end" if failed else "", processor=duration(spent))]
    lines += ["## Beside the paper's single runs", "", *beside_the_paper(results)]
    for body, (cases, kinds) in BODIES.items():
        found = results[body]
        lines += [f"## The {'cubesat' if body == 'cubesat' else 'rocket stage'}", "", f"![{figures[body][1]}](figures/{figures[body][0]})", ""]
        lines += ["| case | " + " | ".join(WORDS[kind] for kind in kinds) + " |", "|---" * (1 + len(kinds)) + "|"]
        lines += [f"| {case} | " + " | ".join(threshold(found[kind, case]) for kind in kinds) + " |" for case in cases]
        lines += ["", *table(body, found)]
    lines += ["## The studies", "", "| study | runs | processor time |", "|---|---|---|"]
    for body, (cases, kinds) in BODIES.items():
        for kind, pattern in kinds.items():
            for case in cases:
                name = pattern.format(case)
                lines.append(f"| `castnet study input/studies/{name}.nml` | {results[body][kind, case].runs} | "
                             f"{duration(times.get(name, {}).get('processor', 0.0))} |")
    return "\n".join(lines) + "\n"


def duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "studies", help="where the tables go")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "capture_probability.md")
    parser.add_argument("--castnet", help="the program (default: the newest build here)")
    parser.add_argument("--threads", type=int, help="cases at the same time (default: every core)")
    parser.add_argument("--only", nargs="+", metavar="STUDY", help="run these alone, and write no page")
    parser.add_argument("--fresh", action="store_true", help="run everything again")
    parser.add_argument("--no-run", action="store_true", help="from the tables that are there")
    arguments = parser.parse_args()
    castnet = find_castnet(arguments.castnet)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if not arguments.no_run:
        for name in arguments.only or names():
            run_study(castnet, name, arguments.folder, arguments.threads, arguments.fresh)
    if arguments.only:
        return 0
    results = {body: {(kind, case): Result(arguments.folder / f"{pattern.format(case)}.h5")
                      for kind, pattern in kinds.items() for case in cases} for body, (cases, kinds) in BODIES.items()}
    folder = arguments.page.parent / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    figures = {"cubesat": ("capture_cubesat.png", "Probability of capture of the cubesat"),
               "rocket": ("capture_rocket.png", "Probability of capture of the rocket stage")}
    for body, (file, _) in figures.items():
        picture = arguments.folder / file
        figure(body, results[body]).savefig(picture, dpi=120)
        shrink(picture, folder / file, 1500)
    book = arguments.folder / "times.json"
    times = json.loads(book.read_text()) if book.is_file() else {}
    arguments.page.write_text(page(results, times, castnet, figures), encoding="utf-8")
    print(arguments.page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
