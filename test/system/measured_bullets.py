"""A table of measured bullets is read, and the statistics of the paper's Fig. 7 come out as by hand."""
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from bullet_differences import COLUMNS, Trajectories, box, differences, direction_means  # noqa: E402
from castnet_reader import Run  # noqa: E402

results: list[bool] = []


def check(name: str, seen, wanted, tolerance=1e-12) -> None:
    good = bool(np.allclose(seen, wanted, rtol=0, atol=tolerance))
    results.append(good)
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f": seen {seen}, expected {wanted}"))


def straight_run(path: Path) -> None:
    """A result in which bullet i moves from i along x at 1 m/s, y = i t, z = 0; frames at 0, 1, 2, 3, 4 s."""
    time = np.arange(5.0)
    position = np.zeros((5, 5, 3))
    for i in range(1, 5):
        position[:, i] = np.column_stack([i + time, i * time, 0 * time])
    with h5py.File(path, "w") as file:
        for name, values in (("time", time), ("node", np.arange(5.0)), ("xyz", np.arange(3.0))):
            file[name] = values
            file[name].make_scale(name)
        file["node_position"] = position
        for axis, name in enumerate(("time", "node", "xyz")):
            file["node_position"].dims[axis].attach_scale(file[name])
        file["static/bullet_nodes"] = np.arange(1, 5)


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        straight_run(Path(folder) / "run.h5")
        # Measured half-way between frames; off by 0.1, 0.2, 0.3, 0.4 in x of bullet 1, by a
        # steady 0.05 in its y, by nothing elsewhere; one sample of bullet 2 lost.
        table = Path(folder) / "measured.csv"
        with open(table, "w", encoding="utf-8") as file:
            file.write("# from the cameras\ntime, " + ", ".join(COLUMNS) + "\n")
            for row, time in enumerate((0.5, 1.5, 2.5, 3.5)):
                truth = np.array([[i + time, i * time, 0.0] for i in range(1, 5)])
                truth[0, 0] -= 0.1 * (row + 1)
                truth[0, 1] += 0.05
                fields = [repr(float(v)) for v in truth.ravel()]
                if row == 2:
                    fields[3] = ""
                file.write(f"{time}, " + ", ".join(fields) + "\n")
        run = Run(Path(folder) / "run.h5")
        difference = differences(Trajectories.of_run(run), Trajectories.of_csv(table))
        check("bullets: twelve columns at the measured times", difference.shape, (4, 12))
        check("bullets: differences by hand", difference[:, 0], [0.1, 0.2, 0.3, 0.4])
        check("bullets: a lost sample is not a difference", np.isnan(difference).sum(), 1)
        seen = box(difference[:, 0])
        check("bullets: mean, median and quartiles by hand",
              [seen.mean, seen.median, seen.lower, seen.upper], [0.25, 0.25, 0.175, 0.325])
        check("bullets: whiskers end at samples", seen.whiskers, (0.1, 0.4))
        # x: (0.1 + 0.2 + 0.3 + 0.4) / 15 samples, one being lost; y: 4 x 0.05 / 16; z: 0.
        check("bullets: means by direction by hand", direction_means(difference),
              [1.0 / 15, 0.0125, 0.0, (1.0 / 15 + 0.0125) / 3])
        # Quartiles of 1, 2, 3, 4, 100 are 2 and 4: 100 lies above 4 + 1.5 x 2 = 7.
        seen = box(np.array([100.0, 1.0, 4.0, 2.0, 3.0]))
        check("bullets: an outlier stands outside the whiskers", [*seen.whiskers, *seen.outliers], [1.0, 4.0, 100.0])
        table.write_text("time, bullet_1_x\n0, 1\n", encoding="utf-8")
        try:
            Trajectories.of_csv(table)
            complaint = ""
        except ValueError as problem:
            complaint = str(problem)
        check("bullets: missing columns are named", "bullet_4_z" in complaint and "measured.csv" in complaint, True)
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
