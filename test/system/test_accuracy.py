#!/usr/bin/env python3
"""castnet accuracy on a small net: files, orders before chaos, the sentence.

    test/system/test_accuracy.py CASTNET
"""
import csv
import os
import subprocess
import sys
import tempfile

import h5py
import numpy as np

SCENE = """&net squares = 4, 4 mesh_length = 0.2 cable_diameter = 1.0e-3 /
&bullets mass = 0.03 speed = 1.8 /
&time end_time = 0.2 /
"""
results = []


def check(name, holds):
    results.append(bool(holds))
    print(("ok    " if holds else "FAIL  ") + "accuracy: " + name)


def main():
    program = os.path.abspath(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "small.nml")
        with open(path, "w", encoding="utf-8") as file:
            file.write(SCENE)
        command = [program, "accuracy", path, "--quiet"]
        run = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        check("exit code 0", run.returncode == 0)
        check("one sentence on stdout", run.stdout.count("\n") == 1 and run.stdout.rstrip().endswith("."))
        check("nothing is overwritten without --force", subprocess.run(command, capture_output=True, cwd=folder).returncode == 4)
        check("no other files", sorted(os.listdir(folder)) == ["small.accuracy.csv", "small.accuracy.h5", "small.nml"])
        with h5py.File(os.path.join(folder, "small.accuracy.h5"), "r") as data:
            methods = [word.decode() for word in data["method"][:]]
            step, error = data["step"][:], data["error_bullets"][:]
            check("steps divide the looks", np.allclose((data["time"][0] / step) % 1.0 % 0.999999, 0.0, atol=1e-5))
            check("five steps of rk4, four of midpoint, three tolerances of adaptive",
                  methods == ["rk4"] * 5 + ["midpoint"] * 4 + ["adaptive"] * 3)
            fixed, tolerance = np.array(methods) != "adaptive", data["tolerance"][:]
            check("tolerances fall", not tolerance[fixed].any() and (np.diff(tolerance[~fixed]) < 0).all())
            check("an error for every setting and time", error.shape == (12, 200) and np.isfinite(error).all())
            check("momentum is kept, so the centre of mass has no error", data["error_centre_of_mass"][:].max() < 1e-9)
            evaluations = data["force_evaluations"][:]
            check("four evaluations a step of rk4, one of midpoint",
                  np.allclose((evaluations * step / np.where(np.array(methods) == "rk4", 4, 1))[fixed], 0.2))
            check("a smaller tolerance costs more", (np.diff(evaluations[~fixed]) > 0).all() and evaluations[~fixed][0] >= evaluations[0])
            mark = int(data["cheapest"][()])
            below = data["below_floor"][:] > 0
            check("the mark is the fastest below the floor", mark == 0 and not below.any() or mark > 0 and below[mark - 1] and
                  data["seconds"][:][below].min() == data["seconds"][mark - 1])
        with open(os.path.join(folder, "small.accuracy.csv"), newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        check("CSV and HDF5 agree", float(rows[0]["step"]) == step[0] and float(rows[0]["error"]) == error[0, -1])
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
