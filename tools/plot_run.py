#!/usr/bin/env python3
"""One page of pictures of any castnet run.

    plot_run.py RUN.h5 [--output PICTURE.png] [--times 0.5 1.1 1.8]

Snapshots in 3-D and a close-up of the end, the target's motion, impulses, energy
ledger, cable tension and capture measures. What the run does not hold does not appear.
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from castnet_drawing import Scene3D, mark_contact, plot_vector, plt, scale_bar, tension_legend
from castnet_reader import VERDICTS, Run


def snapshot_times(run: Run, wanted: list[float] | None) -> list[float]:
    """Three times: as wanted, or half-way to the first contact, there, and some time after it."""
    if wanted:
        return wanted
    first, end = float(run.time[0]), float(run.time[-1])
    touch = run.first_contact
    if np.isfinite(touch) and touch < end:
        return [first + 0.5 * (touch - first), touch, touch + 0.3 * (end - touch)]
    return list(np.linspace(first, end, 5)[1:4])


def panel_position(axis, run):
    displacement = run.data["target_position"].values - run.data["target_position"].values[0]
    plot_vector(axis, run.time, displacement)
    axis.set(title="target: displacement", ylabel="m")
    axis.legend(ncols=3)


def panel_velocity(axis, run):
    plot_vector(axis, run.time, run.data["target_velocity"].values)
    axis.set(title="target: velocity", ylabel="m/s")


def panel_spin(axis, run):
    plot_vector(axis, run.time, run.data["target_angular_velocity"].values)
    axis.set(title="target: angular velocity, body axes", ylabel="rad/s")


def panel_impulses(axis, run):
    history = run.history
    for name, colour, label in (("max_bullet_impulse", "#b9770e", "bullets"), ("max_impulse", "#1f4e79", "nodes")):
        if name in history and (history[name].values > 0).any():
            value = history[name].values
            hit = value > 0
            axis.plot(history.time.values[hit], value[hit], ".", markersize=2.6, color=colour, label=label)
    axis.set(title="largest impulse of one contact, per row", ylabel="N s", yscale="log")
    axis.legend(ncols=2)


ENERGIES = {
    "kinetic_net": ("net, kinetic", "#2471a3"), "kinetic_target": ("target, kinetic (change)", "#9a6a00"),
    "elastic": ("elastic", "#c0392b"), "dissipated": ("lost in cables", "#7d3c98"),
    "contact_loss": ("lost at contacts", "#566573"), "winch_work": ("winch work", "#1e8449"),
    "projection_work": ("projection work", "#cc6699"), "external_work": ("external work", "#117a65"),
}


def energies(history) -> dict:
    """The ledger's lines that are worth drawing: those above a thousandth of the largest [J].

    A tumbling rocket's own energy would dwarf all that happens: its change is shown."""
    values = {name: history[name].values for name in ENERGIES if name in history}
    if "kinetic_target" in values:
        start = values["kinetic_target"][0]
        values["kinetic_target"] = values["kinetic_target"] - start
        if np.abs(values["kinetic_target"]).max() < 1e-9 * start:
            del values["kinetic_target"]
    largest = max((float(np.abs(value).max()) for value in values.values()), default=0.0)
    return {name: value for name, value in values.items() if np.abs(value).max() > 1e-3 * largest}


def panel_energy(axis, run):
    for name, value in energies(run.history).items():
        label, colour = ENERGIES[name]
        axis.plot(run.history.time, value, color=colour, label=label)
    axis.set(title="energy", ylabel="J")
    axis.legend(ncols=2, fontsize=6.5)


def panel_tension(axis, run):
    history = run.history
    if history is not None and "max_tension" in history:
        axis.plot(history.time, history["max_tension"], color="#c0392b", linewidth=0.8, label="largest cable tension")
    taut = (run.data["cable_tension"].values > 0).mean(axis=1)
    axis.set(title="cable tension", ylabel="N", ylim=(0, None))
    axis.legend(loc="upper left")
    twin = axis.twinx()
    twin.plot(run.time, taut, color="#2471a3", linewidth=1.0)
    twin.set_ylabel("share of taut cables", color="#2471a3")
    twin.set_ylim(0, 1)
    twin.grid(False)


MEASURES = (("coverage", "coverage", "", "#1e8449", 1.0), ("largest_hole", "largest hole", "deg", "#9a6a00", 1 / 180),
            ("escape", "escape", "", "#c0392b", 1.0), ("cqi", "CQI", "", "#7d3c98", 0.1))


def panel_measures(axis, run):
    measures = run.measures
    time = measures.verdict_time.values
    axis.set_title("capture measures at the verdict times")
    if time.size <= 4:
        write_measures(axis, measures)
        return
    for name, label, _, colour, scale in MEASURES:
        words = label + {1.0: "", 0.1: " / 10"}.get(scale, " / 180 deg")
        axis.plot(time, measures[name].values * scale, color=colour, label=words)
    axis.set(ylim=(-0.03, None), xlim=(run.time[0], run.time[-1] * 1.03))
    axis.legend(ncols=2)


def write_measures(axis, measures):
    """A few verdicts are a table, not a plot."""
    axis.axis("off")
    lines = [("time", [f"{t:.3g} s" for t in measures.verdict_time.values])]
    lines += [(label, [f"{value:.3g} {unit}".strip() for value in measures[name].values]) for name, label, unit, *_ in MEASURES]
    lines += [("mouth area", [f"{value:.3g} m²" for value in measures["mouth_area"].values]),
              ("verdict", [VERDICTS.get(int(value), "?") for value in measures["verdict"].values])]
    for row, (label, values) in enumerate(lines):
        y = 0.93 - 0.14 * row
        axis.text(0.02, y, label, transform=axis.transAxes, va="center", color="0.35")
        for column, value in enumerate(values):
            axis.text(0.45 + 0.27 * column, y, value, transform=axis.transAxes, va="center",
                      fontweight="bold" if label == "verdict" else "normal")


def panels(run: Run) -> list:
    """The panels this run has data for."""
    chosen = []
    if run.has_target and np.ptp(run.data["target_position"].values, axis=0).max() > 0:
        chosen += [panel_position, panel_velocity]
    if run.has_target and np.abs(run.data["target_angular_velocity"].values).max() > 0:
        chosen.append(panel_spin)
    history = run.history
    if history is not None:
        if "contacts" in history and history["contacts"].values.sum() > 0:
            chosen.append(panel_impulses)
        if energies(history):
            chosen.append(panel_energy)
    if run.has_net and run.data.sizes.get("cable", 0) and "cable_tension" in run.data:
        chosen.append(panel_tension)
    if run.measures is not None and np.isfinite(run.measures["coverage"].values).any():
        chosen.append(panel_measures)
    return chosen


def headline(run: Run) -> str:
    words = [run.name]
    if run.measures is not None and "verdict" in run.measures:
        for time, verdict in zip(run.measures.verdict_time.values, run.measures["verdict"].values):
            words.append(f"{VERDICTS.get(int(verdict), '?')} at {time:.3g} s")
    if np.isfinite(run.first_contact):
        words.append(f"first contact at {run.first_contact:.3g} s")
    status = run.meta.get("status", "complete")
    if status != "complete":
        words.append(f"run {status}")
    return "  ·  ".join(words[:6])


def plot_run(run: Run, times: list[float] | None = None):
    """The whole page as a matplotlib figure."""
    chosen = panels(run)
    rows = -(-len(chosen) // 4)
    top = 7.0 if run.has_net or run.has_target else 0.6
    height = top + 0.35 + 2.3 * rows
    figure = plt.figure(figsize=(14.5, height))
    figure.suptitle(headline(run), x=0.03, y=1 - 0.22 / height, ha="left", va="center", fontsize=12, fontweight="bold")
    if top > 1:
        scene = Scene3D(run)
        upper = figure.add_gridspec(2, 4, left=0.02, right=0.985, top=1 - 0.5 / height, bottom=1 - (top - 0.35) / height,
                                    wspace=0.03, hspace=0.09)
        for place, time in zip(((0, 0), (0, 1), (1, 0)), snapshot_times(run, times)):
            axis = figure.add_subplot(upper[place])
            frame = run.frame(time)
            scale_bar(axis, scene.draw(axis, frame, width=0.8))
            axis.set_title(f"t = {run.time[frame]:.3g} s", y=0.96)
        axis = figure.add_subplot(upper[1, 1])
        scale_bar(axis, scene.draw(axis, -1, scene.camera(-1, azimuth=118.0), width=0.8))
        axis.set_title(f"t = {run.time[-1]:.3g} s, from the other side", y=0.96)
        axis = figure.add_subplot(upper[:, 2:])
        scale_bar(axis, scene.draw(axis, -1, scene.camera(-1, close_up=True), width=1.6))
        axis.set_title(f"t = {run.time[-1]:.3g} s", y=0.98)
        if scene.largest_tension > 0:
            tension_legend(figure, (0.80, 1 - (top - 0.15) / height, 0.16, 0.08 / height), scene.largest_tension)
    if rows:
        lower = figure.add_gridspec(rows, 4, left=0.05, right=0.955, top=1 - (top + 0.55) / height, bottom=0.5 / height,
                                    wspace=0.36, hspace=0.5)
        for number, draw in enumerate(chosen):
            axis = figure.add_subplot(lower[number // 4, number % 4])
            draw(axis, run)
            if axis.axison:
                mark_contact(axis, run)
            if number >= len(chosen) - 4:
                axis.set_xlabel("time [s]")
    return figure


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", help="result file of castnet run")
    parser.add_argument("-o", "--output", help="picture to write (default: the run's name with .png)")
    parser.add_argument("--times", type=float, nargs=3, metavar="T", help="times of the three snapshots before the end [s]")
    arguments = parser.parse_args()
    try:
        run = Run(arguments.run)
        picture = Path(arguments.output or run.path.with_name(run.name + ".png"))
        figure = plot_run(run, arguments.times)
        figure.savefig(picture)
    except (OSError, ValueError) as problem:
        print(f"plot_run: {problem}", file=sys.stderr)
        return 2
    print(picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
