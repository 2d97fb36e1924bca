#!/usr/bin/env python3
"""Every figure of the paper that shows a result, from its scenes, and those it lacks.

    paper_figures.py [--only 9 13 energy] [--measured BULLETS.csv] [--folder out/figures]

Runs the scenes of input/ that the figures need (results that are there and not stale are
used again), then draws: 5, 9, 13, 14, 16, 17 (snapshots), 6 (bullets), 7 (differences),
10 (cubesat's motion), 11 (impulses), 12 (angular velocity), and deployment, measures,
tension, energy. Figures 1 to 4, 8 and 15 are sketches. --measured draws 6 and 7 against
a table of measured bullets (columns: bullet_differences.py); without it they compare
the mock-up with and without its link, and say so.
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from bullet_differences import COLUMNS, Trajectories, box, differences, direction_means
from castnet_drawing import (AXIS_COLOURS, BULLET_COLOURS, Camera, Scene3D, mark_contact, plot_vector, plt, scale_bar)
from castnet_reader import Run
from castnet_runner import ROOT, Job, find_castnet, run_all

CUBESAT = {"0": "cubesat_0.0", "1": "cubesat_1.0", "1.5": "cubesat", "2": "cubesat_2.0"}
ROCKET_Z = {rate: f"rocket_z_{rate}" for rate in ("0.1", "0.4", "0.7")}
ROCKET_X = {rate: f"rocket_x_{rate}" for rate in ("0.1", "0.4", "0.7")}
CLOSING = {"x": "rocket_closing_x_1.1", "z": "rocket_closing_z_1.1"}
DEPLOYMENT = {"parabolic flight": "deployment_parabolic_flight", "cubesat": "deployment_cubesat",
              "rocket": "deployment_rocket"}
CUBESAT_TIMES, ROCKET_TIMES = (0.3, 0.7, 1.5, 3.0), (1.5, 5.0, 7.5, 10.0)


class Book:
    """The results, read once, by scene name."""

    def __init__(self, folder: Path):
        self.folder, self.runs = folder, {}

    def __getitem__(self, scene: str) -> Run:
        if scene not in self.runs:
            self.runs[scene] = Run(self.folder / f"{scene}.h5")
        return self.runs[scene]


def verdict_at(run: Run, time: float) -> str:
    """The verdict's word at the verdict time nearest to `time`, by the strict thresholds.

    (Of the many verdict times of these runs only the first was judged strictly.)"""
    if run.measures is None:
        return ""
    limit = run.summary
    now = {name: float(value) for name, value in run.measures.sel(verdict_time=time, method="nearest").data_vars.items()}
    if (now["coverage"] >= limit["captured_coverage"] and now["largest_hole"] <= limit["captured_hole"]
            and now["escape"] <= limit["captured_escape"]):
        return "captured"
    if now["coverage"] <= limit["failed_coverage"] or now["escape"] >= limit["failed_escape"]:
        return "failed"
    return "marginal"


def snapshots(rows: dict[str, Run], times, title: str, verdicts=True):
    """Rows of snapshots at the paper's times, each column through one camera."""
    scenes = [Scene3D(run) for run in rows.values()]
    figure, axes = plt.subplots(len(rows), len(times), figsize=(3.3 * len(times), 3.0 * len(rows) + 0.7), squeeze=False)
    figure.subplots_adjust(left=0.05, right=0.995, bottom=0.01, top=1 - 0.72 / (3.0 * len(rows) + 0.7), wspace=0.02, hspace=0.04)
    figure.suptitle(title, x=0.01, y=0.995, ha="left", va="top", fontsize=11, fontweight="bold")
    for column, time in enumerate(times):
        frames = [scene.run.frame(time) for scene in scenes]
        camera = Camera.fitting(np.concatenate([scene.cloud(frame) for scene, frame in zip(scenes, frames)]))
        for row, (label, scene) in enumerate(zip(rows, scenes)):
            axis = axes[row, column]
            scene.draw(axis, frames[row], camera, width=0.8)
            if row == len(rows) - 1:
                scale_bar(axis, camera)
            if row == 0:
                axis.set_title(f"t = {scene.run.time[frames[row]]:.3g} s", y=0.99)
            if column == 0:
                axis.text(-0.02, 0.5, label, rotation=90, va="center", ha="right", transform=axis.transAxes, fontsize=9)
            if verdicts and column == len(times) - 1:
                axis.text(0.98, 0.97, verdict_at(scene.run, time), va="top", ha="right", transform=axis.transAxes,
                          fontsize=9, fontweight="bold", color="0.3")
    return figure


def grid_of_panels(count: int, title: str, columns=2, height=2.5, **keywords):
    rows = -(-count // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.6 * columns, height * rows + 0.6), squeeze=False,
                                layout="constrained", **keywords)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure, axes.ravel()


def figure_5(book, _):
    run = book["parabolic_flight"]
    touch = run.first_contact if np.isfinite(run.first_contact) else 1.2
    times = [0.4, 0.8, touch, touch + 0.3, touch + 0.8, run.time[-1]]
    return snapshots({"no link (as the paper)": run, "with link": book["parabolic_flight_link"]}, times,
                     "Fig. 5  Capture of the fixed Envisat mock-up", verdicts=False)


def figure_6(book, measured):
    runs = {"no link": ("-", Trajectories.of_run(book["parabolic_flight"])),
            "with link": (":", Trajectories.of_run(book["parabolic_flight_link"]))}
    if measured is not None:
        runs = {"castnet": runs["no link"], "measured": ("--", measured)}
    figure, axes = grid_of_panels(4, "Fig. 6  Bullets' trajectories, " + (
        "computed and measured" if measured is not None else
        "mock-up without and with its link (the flight's data are not public)"), sharex=True)
    for i, axis in enumerate(axes):
        for label, (line, path) in runs.items():
            for k, name in enumerate("xyz"):
                axis.plot(path.time, path.position[:, i, k], line, color=AXIS_COLOURS[k], label=f"{name}, {label}")
        axis.set(title=f"bullet {i + 1}", ylabel="position [m]")
        axis.axvline(book["parabolic_flight"].first_contact, color="0.5", linewidth=0.9, linestyle=(0, (4, 3)),
                     label="first contact")
    axes[0].legend(ncols=2, fontsize=6.5)
    for axis in axes[2:]:
        axis.set_xlabel("time [s]")
    return figure


def figure_7(book, measured):
    computed = Trajectories.of_run(book["parabolic_flight"])
    other = measured if measured is not None else Trajectories.of_run(book["parabolic_flight_link"])
    difference = differences(computed, other)
    touch = book["parabolic_flight"].first_contact
    title = "Fig. 7  Differences of the bullets' trajectories, " + (
        "computed against measured" if measured is not None else "with against without link, after first contact")
    if measured is None:
        difference = difference[other.time >= touch]
    figure, (axis,) = plt.subplots(1, 1, figsize=(9.2, 3.6), squeeze=False, layout="constrained")[0], [None]
    axis = figure.axes[0]
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    stats = []
    for k in range(12):
        b = box(difference[:, k])
        stats.append({"mean": b.mean, "med": b.median, "q1": b.lower, "q3": b.upper, "whislo": b.whiskers[0],
                      "whishi": b.whiskers[1], "fliers": b.outliers, "label": COLUMNS[k][7:].replace("_", " ")})
    axis.bxp(stats, showmeans=True, flierprops={"marker": "+", "markersize": 4, "markeredgecolor": "#c0392b"},
             meanprops={"marker": "D", "markersize": 4, "markerfacecolor": "#2471a3", "markeredgecolor": "none"},
             medianprops={"color": "#c0392b"})
    x, y, z, mean = direction_means(difference)
    axis.set(ylabel="difference [m]", ylim=(0, None), xlabel=f"bullet and axis      mean differences: x {100 * x:.2g} cm, "
             f"y {100 * y:.2g} cm, z {100 * z:.2g} cm; together {100 * mean:.2g} cm"
             "   (the paper, against the flight: 7.5, 7.6, 12; 9 cm)")
    return figure


def figure_9(book, _):
    return snapshots({f"{rate} rad/s": book[name] for rate, name in CUBESAT.items()}, CUBESAT_TIMES,
                     "Fig. 9  Cubesat, initial tumbling rate about a transverse axis (case C)")


def figure_10(book, _):
    run = book[CUBESAT["1"]]
    figure, (axis, lower) = grid_of_panels(2, "Fig. 10  Motion of the cubesat, 1 rad/s", columns=1, sharex=True)
    plot_vector(axis, run.time, run.data["target_position"].values)
    plot_vector(lower, run.time, run.data["target_velocity"].values)
    axis.set(ylabel="position [m]")
    lower.set(ylabel="velocity [m/s]", xlabel="time [s]")
    lower.axhline(0.1, color="0.6", linewidth=0.8, linestyle=":")
    lower.text(0.02, 0.1, "the paper's bound", va="bottom", fontsize=7, color="0.4")
    axis.legend(ncols=3)
    for each in (axis, lower):
        mark_contact(each, run)
    return figure


def figure_11(book, _):
    figure, axes = grid_of_panels(4, "Fig. 11  Largest impulse of one node, and of one bullet, per history row", sharex=True, sharey=True)
    for axis, (rate, name) in zip(axes, CUBESAT.items()):
        history = book[name].history
        for column, colour, label in (("max_bullet_impulse", "#d9a441", "bullets"), ("max_impulse", "#1f4e79", "nodes")):
            value = history[column].values
            hit = value > 0
            axis.plot(history.time.values[hit], value[hit], ".", markersize=3, color=colour, label=label)
        axis.axhline(3e-4, color="#c0392b", linewidth=0.8, linestyle="--", label="the paper's maximum")
        axis.set(title=f"{rate} rad/s", ylabel="impulse [N s]", xlabel="time [s]", yscale="log")
    axes[0].legend(loc="lower left")
    return figure


def figure_12(book, _):
    figure, axes = grid_of_panels(4, "Fig. 12  Angular velocity of the cubesat, body axes", sharex=True)
    for axis, (rate, name) in zip(axes, CUBESAT.items()):
        run = book[name]
        plot_vector(axis, run.time, run.data["target_angular_velocity"].values)
        mark_contact(axis, run)
        axis.set(title=f"initially {rate} rad/s about body y", ylabel="rad/s", xlabel="time [s]")
    axes[0].legend(ncols=3)
    return figure


def figure_13(book, _):
    return snapshots({f"{rate} rad/s": book[name] for rate, name in ROCKET_Z.items()}, ROCKET_TIMES,
                     'Fig. 13  Rocket stage, the paper\'s "z axis" (case A: like a propeller)')


def figure_14(book, _):
    return snapshots({f"{rate} rad/s": book[name] for rate, name in ROCKET_X.items()}, ROCKET_TIMES,
                     'Fig. 14  Rocket stage, the paper\'s "x axis" (case B: end over end)')


def figure_16(book, _):
    return snapshots({"1.1 rad/s": book[CLOSING["x"]]}, ROCKET_TIMES, 'Fig. 16  With closing, "x axis" (case B)')


def figure_17(book, _):
    return snapshots({"1.1 rad/s": book[CLOSING["z"]]}, ROCKET_TIMES, 'Fig. 17  With closing, "z axis" (case A)')


def mouth_area(run: Run) -> np.ndarray:
    """Area of the mouth in the plane across the flight [m2]: the polygon of the perimeter's nodes."""
    ring = np.asarray(run.static["perimeter_nodes"], int)
    y, z = np.moveaxis(run.data["node_position"].values[:, ring, 1:], -1, 0)
    return 0.5 * np.abs((y * np.roll(z, -1, axis=1) - z * np.roll(y, -1, axis=1)).sum(axis=1))


def figure_deployment(book, _):
    figure, axes = grid_of_panels(3, "Deployment without a target: area of the mouth", columns=3)
    for axis, (label, name) in zip(axes, DEPLOYMENT.items()):
        run = book[name]
        area = mouth_area(run)
        area_full = len(run.static["faces"]) * float(np.median(run.static["natural_length"])) ** 2
        axis.plot(run.time, area / area_full, color="#1f4e79")
        axis.axhline(0.8, color="0.6", linewidth=0.8, linestyle=":")
        peak = int(area.argmax())
        open_ = area >= 0.8 * area_full
        centre = (run.data["node_position"].values * run.static["node_mass"][:, None]).sum(axis=1) / run.static["node_mass"].sum()
        words = f"largest {area[peak] / area_full:.2f} at {run.time[peak]:.3g} s"
        if open_.any():
            inside = run.time[open_]
            words += (f"\nabove 0.8 for {np.gradient(run.time)[open_].sum():.2g} s,"
                      f"\nfrom {centre[open_][0, 0]:.3g} to {centre[open_][-1, 0]:.3g} m of flight")
            axis.axvspan(inside[0], inside[-1], color="#d6eaf8", zorder=0)
        axis.text(0.03, 0.97, words, transform=axis.transAxes, va="top", fontsize=7)
        axis.set(title=label, xlabel="time [s]", ylabel="area / full area", ylim=(0, 1.35))
    return figure


def figure_measures(book, _):
    names = {**{f"cubesat, {r} rad/s": n for r, n in CUBESAT.items()},
             **{f"rocket x, {r} rad/s": n for r, n in ROCKET_X.items()}, "rocket x, 1.1, closing": CLOSING["x"]}
    figure, axes = grid_of_panels(len(names), "Capture measures over time", columns=4, height=2.2)
    for axis, (label, name) in zip(axes, names.items()):
        run = book[name]
        measures = run.measures
        time = measures.verdict_time.values
        for column, words, colour, scale in (("coverage", "coverage", "#1e8449", 1), ("escape", "escape", "#c0392b", 1),
                                             ("largest_hole", "largest hole / 180 deg", "#9a6a00", 1 / 180)):
            axis.plot(time, measures[column].values * scale, color=colour, label=words)
        axis.plot(time, measures["cqi"].values / 10, color="#7d3c98", label="CQI / 10")
        axis.set(title=label, ylim=(-0.03, 1.05), xlabel="time [s]")
        mark_contact(axis, run)
    axes[0].legend(fontsize=6.5)
    return figure


def figure_tension(book, _):
    names = {"cubesat, 1.5 rad/s": "cubesat", "rocket x, 0.4 rad/s": ROCKET_X["0.4"], "rocket x, 1.1 rad/s, closing": CLOSING["x"]}
    figure, axes = grid_of_panels(3, "Cable tension: largest of all cables, and quantiles of the taut ones", columns=3)
    for axis, (label, name) in zip(axes, names.items()):
        run = book[name]
        axis.plot(run.history.time, np.where(run.history["max_tension"] > 0, run.history["max_tension"], np.nan),
                  color="#c0392b", linewidth=0.7, label="largest")
        tension = run.data["cable_tension"].values
        taut = np.where(tension > 0, tension, np.nan)
        some = np.isfinite(taut).any(axis=1)
        for share, colour in ((95, "#9a6a00"), (50, "#2471a3")):
            axis.plot(run.time[some], np.nanpercentile(taut[some], share, axis=1), color=colour, label=f"{share} %")
        axis.set(title=label, yscale="log", ylabel="N", xlabel="time [s]")
        mark_contact(axis, run)
    axes[0].legend()
    return figure


def figure_energy(book, _):
    names = {"cubesat, 1.5 rad/s": "cubesat", "rocket x, 0.4 rad/s": ROCKET_X["0.4"], "rocket x, 1.1 rad/s, closing": CLOSING["x"]}
    parts = {"kinetic_net": ("net, kinetic", "#2471a3"), "kinetic_target": ("target, kinetic above its least", "#9a6a00"),
             "elastic": ("elastic", "#c0392b"), "dissipated": ("lost in cables", "#7d3c98"),
             "contact_loss": ("lost at contacts", "#566573")}
    gains = {"winch_work": "winch", "projection_work": "projection"}
    figure, axes = grid_of_panels(3, "Energy ledger: what is there and what was lost add up to the start and the winch's work", columns=3, height=3.2)
    for axis, (label, name) in zip(axes, names.items()):
        history = book[name].history
        # Most of a tumbling stage's energy takes no part: only what moves is drawn.
        lines = {part: history[part].values - (history[part].values.min() if part == "kinetic_target" else 0.0) for part in parts}
        total = sum(lines.values())
        axis.stackplot(history.time.values, [np.maximum(line, 0) for line in lines.values()],
                       labels=[words for words, _ in parts.values()], colors=[c for _, c in parts.values()], alpha=0.75, linewidth=0)
        given = total[0] + sum(history[g].values for g in gains if g in history)
        axis.plot(history.time, given, color="black", linewidth=1.0, linestyle="--", label="start + winch + projection")
        axis.set(title=label, ylabel="J", xlabel="time [s]", xlim=(0, history.time.values[-1]))
        mark_contact(axis, book[name])
    axes[0].legend(fontsize=6.5, loc="lower left", frameon=True, framealpha=0.8)
    return figure


CUBESATS, ROCKETS_X, ROCKETS_Z = list(CUBESAT.values()), list(ROCKET_X.values()), list(ROCKET_Z.values())
PARABOLIC = ["parabolic_flight", "parabolic_flight_link"]
LEDGER = ["cubesat", ROCKET_X["0.4"], CLOSING["x"]]
FIGURES = {  # name: (drawing, scenes it needs)
    "5": (figure_5, PARABOLIC), "6": (figure_6, PARABOLIC), "7": (figure_7, PARABOLIC),
    "9": (figure_9, CUBESATS), "10": (figure_10, [CUBESAT["1"]]), "11": (figure_11, CUBESATS), "12": (figure_12, CUBESATS),
    "13": (figure_13, ROCKETS_Z), "14": (figure_14, ROCKETS_X), "16": (figure_16, [CLOSING["x"]]), "17": (figure_17, [CLOSING["z"]]),
    "deployment": (figure_deployment, list(DEPLOYMENT.values())),
    "measures": (figure_measures, [*CUBESATS, *ROCKETS_X, CLOSING["x"]]),
    "tension": (figure_tension, LEDGER), "energy": (figure_energy, LEDGER),
}


def job(scene: str, folder: Path) -> Job:
    """A scene's run; captures are judged all along the way, which changes nothing else.

    Nodes start a micrometre off: the scenes are symmetric, and what an exactly symmetric net does
    (a node that meets a thin rod in its very middle) no other net does."""
    settings = {"perturb/node_position": "1e-6", "perturb/seed": "1"}
    if not scene.startswith(("deployment", "parabolic")):
        end = 3.0 if scene.startswith("cubesat") else 13.0 if "closing" in scene else 12.5
        times = np.linspace(end / 50, end, 50)
        settings["output/verdict_times"] = ", ".join(f"{time:.4g}" for time in times)
    return Job(scene, folder / f"{scene}.h5", settings)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(FIGURES), metavar="NAME", help=f"of {', '.join(FIGURES)}")
    parser.add_argument("--measured", metavar="CSV", help="measured bullets for figures 6 and 7")
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "figures", help="where pictures go (out/figures)")
    parser.add_argument("--castnet", help="the program (default: the newest build here)")
    parser.add_argument("--at-once", type=int, default=2, help="runs at the same time (2)")
    parser.add_argument("--fresh", action="store_true", help="run every scene again")
    arguments = parser.parse_args()
    chosen = arguments.only or list(FIGURES)
    try:
        measured = Trajectories.of_csv(arguments.measured) if arguments.measured else None
    except (OSError, ValueError) as problem:
        print(f"paper_figures: {problem}", file=sys.stderr)
        return 2
    runs = arguments.folder / "runs"
    scenes = list(dict.fromkeys(scene for name in chosen for scene in FIGURES[name][1]))
    failed = run_all([job(scene, runs) for scene in scenes], find_castnet(arguments.castnet),
                     at_once=arguments.at_once, fresh=arguments.fresh)
    lost = {each.scene for each in failed}
    book, skipped = Book(runs), []
    for name in chosen:
        draw, needs = FIGURES[name]
        if lost & set(needs):
            skipped.append(name)
            continue
        figure = draw(book, measured)
        path = arguments.folder / (f"figure_{int(name):02d}.png" if name.isdigit() else f"{name}.png")
        figure.savefig(path)
        plt.close(figure)
        print(path)
    for name in skipped:
        print(f"figure {name} is not drawn: its scenes did not run", file=sys.stderr)
    return 1 if skipped else 0


if __name__ == "__main__":
    sys.exit(main())
