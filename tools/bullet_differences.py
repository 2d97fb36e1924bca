"""Bullets' trajectories against measured ones: the differences of the paper's Figs. 6 and 7.

A table of measured bullets is a CSV file with one header line and the columns

    time, bullet_1_x, bullet_1_y, bullet_1_z, bullet_2_x, ... , bullet_4_z

time in s from the shot; positions in m, in the scene's inertial frame (x along the flight,
origin in the stowed net's centre of mass). Bullets are numbered as in /static/bullet_nodes. Rows in
order of time; an empty field is a sample that the cameras lost. Lines that begin with # are skipped.
"""
from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from castnet_reader import Run

COLUMNS = [f"bullet_{i}_{axis}" for i in range(1, 5) for axis in "xyz"]


@dataclass
class Trajectories:
    """Positions (n, 4, 3) [m] of the four bullets at times (n) [s]; NaN where lost."""

    time: np.ndarray
    position: np.ndarray

    @classmethod
    def of_run(cls, run: Run) -> Trajectories:
        if len(run.bullets) != 4:
            raise ValueError(f"{run.path}: four bullets are needed, the net has {len(run.bullets)}")
        return cls(run.time, run.data["node_position"].values[:, run.bullets])

    @classmethod
    def of_csv(cls, path: str | Path) -> Trajectories:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = [line for line in file if line.strip() and not line.lstrip().startswith("#")]
        reader = csv.DictReader(lines, skipinitialspace=True)
        names = [name.strip() for name in reader.fieldnames or []]
        lacking = [name for name in ["time", *COLUMNS] if name not in names]
        if lacking:
            raise ValueError(f"{path}: columns are missing: {', '.join(lacking)}")
        reader.fieldnames = names
        rows = []
        for number, row in enumerate(reader, 1):
            try:
                rows.append([float(row[name]) if (row[name] or "").strip() else np.nan for name in ["time", *COLUMNS]])
            except ValueError as problem:
                raise ValueError(f"{path}: row {number}: {problem}") from None
        table = np.array(rows).reshape(len(rows), 13)
        if len(rows) == 0 or not np.all(np.diff(table[:, 0]) > 0):
            raise ValueError(f"{path}: at least one row is needed, and times must grow")
        return cls(table[:, 0], table[:, 1:].reshape(-1, 4, 3))

    def at(self, time: np.ndarray) -> np.ndarray:
        """Positions at other times by straight lines between samples; NaN outside."""
        result = np.empty((len(time), 4, 3))
        for i in range(4):
            for k in range(3):
                result[:, i, k] = np.interp(time, self.time, self.position[:, i, k], left=np.nan, right=np.nan)
        return result


def differences(computed: Trajectories, measured: Trajectories) -> np.ndarray:
    """|computed - measured| (n, 12) [m] at the measured times, columns as COLUMNS."""
    return np.abs(computed.at(measured.time) - measured.position).reshape(-1, 12)


@dataclass
class Box:
    """What one box of Fig. 7 shows [m]."""

    mean: float
    median: float
    lower: float      # first quartile
    upper: float      # third quartile
    whiskers: tuple[float, float]  # smallest and largest sample within 1.5 box heights of the box
    outliers: np.ndarray


def box(samples: np.ndarray) -> Box:
    """Statistics of one column; quartiles by straight lines between the ordered samples."""
    samples = np.sort(samples[np.isfinite(samples)])
    if samples.size == 0:
        return Box(np.nan, np.nan, np.nan, np.nan, (np.nan, np.nan), samples)
    lower, median, upper = np.percentile(samples, [25, 50, 75])
    reach = 1.5 * (upper - lower)
    inside = samples[(samples >= lower - reach) & (samples <= upper + reach)]
    outliers = samples[(samples < lower - reach) | (samples > upper + reach)]
    return Box(samples.mean(), median, lower, upper, (inside[0], inside[-1]), outliers)


def direction_means(difference: np.ndarray) -> np.ndarray:
    """Mean difference along x, y, z over all bullets and times, and their mean: (4) [m]."""
    means = [np.nanmean(difference[:, k::3]) for k in range(3)]
    return np.array([*means, np.mean(means)])
