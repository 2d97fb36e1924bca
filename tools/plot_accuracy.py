#!/usr/bin/env python3
"""Error against time of every method and step, from the file of `castnet accuracy`.

    tools/plot_accuracy.py SCENE.accuracy.h5 [-o PICTURE.png]

One panel per observable: a point per setting, the noise floor as a line. Below the line a
setting cannot be told from the reference; further left is cheaper.
"""
import argparse
import os

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

NAMES = {
    "bullets": "bullets", "centre_of_mass": "net's centre of mass", "mouth_area": "mouth area",
    "momentum_given": "momentum given to the target", "first_contact": "first contact", "coverage": "coverage",
    "largest_hole": "largest hole", "escape": "escape", "cqi": "CQI",
}
MARKERS = {"rk4": ("o", "#1f5a92"), "midpoint": ("s", "#c0561c"), "adaptive": ("^", "#2d7d46")}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("-o", "--output")
    arguments = parser.parse_args()
    output = arguments.output or os.path.splitext(arguments.file)[0] + ".png"
    with h5py.File(arguments.file, "r") as data:
        shown = [name for name in NAMES if "error_" + name in data]
        methods = [word.decode() for word in data["method"][:]]
        seconds, cheapest = data["seconds"][:], int(data["cheapest"][()])
        columns = 3
        rows = -(-len(shown) // columns)
        figure, axes = plt.subplots(rows, columns, figsize=(11, 3.0 * rows), squeeze=False, layout="constrained")
        for axis in axes.flat[len(shown):]:
            axis.remove()
        for axis, name in zip(axes.flat, shown):
            error, floor = data["error_" + name], data["floor_" + name][-1]
            unit = error.attrs["units"]
            unit = unit.decode() if isinstance(unit, bytes) else str(unit)
            least = max(floor, 1e-15) * 1e-2
            for method, (marker, colour) in MARKERS.items():
                chosen = [i for i, word in enumerate(methods) if word == method]
                axis.plot(seconds[chosen], np.maximum(error[:, -1][chosen], least), marker + "-", color=colour, label=method)
            if floor > 0:
                axis.axhline(floor, color="0.4", linestyle="--", label="noise floor")
            if cheapest > 0:
                axis.plot(seconds[cheapest - 1], max(error[cheapest - 1, -1], least), "o", markersize=14, fillstyle="none",
                          color="k", label="cheapest below every floor")
            axis.set(xscale="log", yscale="log", title=NAMES[name], xlabel="processor time of a run, s",
                     ylabel="error at the end" + ("" if unit == "1" else ", " + unit))
            axis.grid(alpha=0.25)
        handles, labels = axes.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, fontsize="small", ncols=len(labels), loc="outside lower center")
        figure.savefig(output, dpi=150)
    print(output)


if __name__ == "__main__":
    main()
