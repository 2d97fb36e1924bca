#!/usr/bin/env python3
"""The output file as its readers see it: xarray, h5py, and VTK's own HDF reader.

    test_output.py PATH_TO_CASTNET

VTK runs in a process of its own, because it answers a malformed file with a crash.
"""
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

ROOT = Path(__file__).resolve().parents[2]
INPUT = ROOT / "input"
results: list[bool] = []

TARGET_ONLY = """
&target
  shape = 'box'
  dimensions = 1.0, 2.0, 3.0
  mass = 6.0
  position = 1.0, 2.0, 3.0
  angular_velocity = 0.1, 0.2, 0.3
/
&time
  end_time = 1.0
  step = 1.0e-3
/
"""

VTK_READER = r"""
import json, sys
import vtk
from vtk.util.numpy_support import vtk_to_numpy
reader = vtk.vtkHDFReader()
reader.SetFileName(sys.argv[1])
reader.UpdateInformation()
steps = []
for step in range(reader.GetNumberOfSteps()):
    reader.SetStep(step)
    reader.Update()
    data = reader.GetOutputDataObject(0)
    tension = data.GetCellData().GetArray("tension")
    points = vtk_to_numpy(data.GetPoints().GetData()) if data.GetNumberOfPoints() else []
    steps.append({
        "time": reader.GetTimeValue(), "class": data.GetClassName(), "points": len(points),
        "point_sum": float(sum(abs(float(x)) for p in points for x in p)),
        "lines": data.GetNumberOfLines(), "polygons": data.GetNumberOfPolys(), "vertices": data.GetNumberOfVerts(),
        "tension_sum": None if tension is None else float(vtk_to_numpy(tension).astype(float).sum()),
        "first_line": [int(data.GetCell(0).GetPointId(i)) for i in range(2)] if data.GetNumberOfLines() else None,
    })
print(json.dumps(steps))
"""


def check(name: str, good: bool, seen: object = "") -> None:
    """Note one claim."""
    results.append(bool(good))
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f"\n      seen: {seen}"))


def run(castnet: str, scene: Path, output: Path, *more: str) -> subprocess.CompletedProcess:
    command = [castnet, "run", str(scene), "--output", str(output), *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def read_with_vtk(path: Path) -> list[dict]:
    """What VTK sees at every step; an empty list if it crashes."""
    done = subprocess.run([sys.executable, "-c", VTK_READER, str(path)], capture_output=True, text=True, timeout=300,
                          check=False)
    if done.returncode != 0:
        print(f"      vtk: exit code {done.returncode}: {done.stderr[-500:]}")
        return []
    return json.loads(done.stdout)


def datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    found: dict[str, h5py.Dataset] = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    return found


def check_common(label: str, path: Path, scene_text: str | None) -> None:
    """What holds for every run's file."""
    with open(path, "rb") as raw:
        start = raw.read(9)
    check(f"{label}: default format bound (superblock 0), so that a killed run's file opens", start[8] == 0, start)
    with h5py.File(path) as file:
        bare = [name for name, item in datasets(file).items()
                if not name.startswith("VTKHDF/") and item.dtype.kind not in "OS" and "units" not in item.attrs]
        check(f"{label}: every number has its units", not bare, bare)
        check(f"{label}: units are text", all(isinstance(item.attrs["units"], str) for item in datasets(file).values()
                                              if "units" in item.attrs))
        meta = file["meta"]
        text = {name: meta[name].asstr()[()] for name in ("scene", "effective_scene", "version", "compiler", "flags",
                                                          "start", "end", "status")}
        if scene_text is not None:
            check(f"{label}: /meta/scene is the scene as read", text["scene"] == scene_text, text["scene"][:200])
        check(f"{label}: /meta/effective_scene holds every group", "&time" in text["effective_scene"])
        check(f"{label}: /meta says by what it was made", all(text[k] for k in ("version", "compiler", "flags")), text)
        iso = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ"
        check(f"{label}: start and end in ISO 8601", all(re.fullmatch(iso, text[k]) for k in ("start", "end")), text)
        check(f"{label}: status complete, one session", text["status"] == "complete" and list(meta["sessions"]) == ["1"])
    check(f"{label}: nothing is left beside the output",
          sorted(p.name for p in path.parent.iterdir() if p.name.startswith(path.stem)) == [path.name],
          [p.name for p in path.parent.iterdir()])


def check_capture(castnet: str, folder: Path) -> None:
    """Net and target: everything is there."""
    path = folder / "capture.h5"
    done = run(castnet, INPUT / "cubesat.nml", path)
    check("capture: exit code 0", done.returncode == 0, done.stderr)
    check_common("capture", path, None)
    with xr.open_dataset(path) as data, xr.open_dataset(path, group="history") as history, \
            xr.open_dataset(path, group="static") as static, xr.open_dataset(path, group="summary") as summary:
        sizes = data.sizes
        frames, nodes, cables = sizes["time"], sizes["node"], sizes["cable"]
        wanted = {
            "node_position": ("time", "node", "xyz"), "node_velocity": ("time", "node", "xyz"),
            "cable_tension": ("time", "cable"), "target_position": ("time", "xyz"), "target_velocity": ("time", "xyz"),
            "target_attitude": ("time", "quaternion"), "target_angular_velocity": ("time", "xyz"),
        }
        check("capture: the root's variables and their dimensions",
              {name: data[name].dims for name in data.data_vars} == wanted, {n: data[n].dims for n in data.data_vars})
        check("capture: all float64", all(data[name].dtype == "float64" for name in wanted) and data.time.dtype == "float64")
        check("capture: coordinates", list(data.xyz.values) == ["x", "y", "z"]
              and list(data["quaternion"].values) == ["w", "x", "y", "z"] and sizes["xyz"] == 3)
        check("capture: 151 frames from 0 to 3 s", frames == 151 and data.time.values[0] == 0
              and 0 <= data.time.values[-1] - 3.0 < 1e-3 and (np.diff(data.time) > 0).all(), data.time.values)
        check("capture: every value is finite", all(np.isfinite(data[name]).all() for name in wanted))
        check("capture: unit quaternions", np.allclose((data.target_attitude ** 2).sum("quaternion"), 1, atol=1e-12))
        check("capture: history has a time of its own", history.sizes["time"] > 5 * frames
              and "xyz" in history.linear_momentum.dims and history.linear_momentum.dims == ("time", "xyz"))
        names = ("kinetic_net kinetic_target elastic dissipated contact_loss winch_work projection_work linear_momentum "
                 "angular_momentum max_tension contacts max_impulse min_impulse impulse_sum max_bullet_impulse "
                 "deepest_penetration").split()
        check("capture: history's columns", all(name in history for name in names), list(history))
        check("capture: contacts are counted in whole numbers", history.contacts.dtype.kind == "i" and history.contacts.sum() > 0)
        check("capture: static net", static.node_mass.sizes["node"] == nodes and static.cable_nodes.shape == (cables, 2)
              and static.natural_length.shape == (cables,) and static.axial_stiffness.shape == (cables,))
        ends = static.cable_nodes.values
        check("capture: cables join nodes that are there, counted from 0",
              ends.min() == 0 and ends.max() == nodes - 1 and (ends[:, 0] != ends[:, 1]).all())
        check("capture: four bullets, a perimeter, square faces", static.bullet_nodes.shape == (4,)
              and static.perimeter_nodes.size > 4 and static.faces.shape[1] == 4)
        length = np.linalg.norm(data.node_position.values[:, ends[:, 0]] - data.node_position.values[:, ends[:, 1]], axis=2)
        slack = length <= static.natural_length.values * (1 - 1e-12)
        check("capture: no tension in a slack cable, in every frame", (data.cable_tension.values[slack] == 0).all())
        check("capture: target's surface is closed", static.target_triangles.shape[1] == 3 and len(
            {tuple(sorted(e)) for t in static.target_triangles.values for e in zip(t, np.roll(t, 1))}) * 2
            == static.target_triangles.size)
        check("capture: summary over verdict_time", summary.coverage.dims == ("verdict_time",)
              and set("coverage largest_hole escape cqi mouth_area mouth_perimeter bullet_distance_min "
                      "bullet_distance_max verdict".split()) <= set(summary), list(summary))
        check("capture: thresholds beside the verdict", summary.attrs.get("captured_coverage") == 0.9
              and summary.attrs.get("captured_hole") == 30.0, summary.attrs)
        check("capture: captured says what the verdicts say", int(summary.captured) == int((summary.verdict == 2).all()))
        check("capture: first contact", 0.5 < float(summary.first_contact) < 2.0, float(summary.first_contact))
        check("capture: percentiles rise", (np.diff(summary.impulse_percentiles) >= 0).all()
              and list(summary.percentile.values) == [50, 95, 99, 99.9])
        seen = read_with_vtk(path)
        vertices = static.sizes["target_vertex"]
        check("capture: VTK reads every step", len(seen) == frames and all(s["class"] == "vtkPolyData" for s in seen), len(seen))
        check("capture: VTK's times", np.allclose([s["time"] for s in seen], data.time, atol=0, rtol=0))
        check("capture: VTK's points, lines and polygons", all(
            (s["points"], s["lines"], s["polygons"]) == (nodes + vertices, cables, static.sizes["target_triangle"])
            for s in seen))
        check("capture: VTK's lines start at the first cable's nodes", seen and seen[-1]["first_line"] == list(ends[0]))
        tension = data.cable_tension.values.sum(axis=1)
        check("capture: VTK's tension is the cables'", np.allclose([s["tension_sum"] for s in seen], tension, rtol=1e-5, atol=1e-5))
    with h5py.File(path) as file:
        points = file["VTKHDF/Points"][:].reshape(frames, nodes + vertices, 3)
        check("capture: points are the nodes in single precision",
              (points[:, :nodes] == file["node_position"][:].astype("f4")).all())
        check("capture: points of the target stay a rigid body", np.allclose(
            np.linalg.norm(points[:, nodes:] - file["target_position"][:][:, None, :], axis=2),
            np.linalg.norm(file["static/target_vertices"][:], axis=1), atol=1e-6))


def check_deployment(castnet: str, folder: Path) -> None:
    """A net and no target."""
    path = folder / "deployment.h5"
    done = run(castnet, INPUT / "deployment_cubesat.nml", path, "--set", "time/end_time=0.2")
    check("deployment: exit code 0", done.returncode == 0, done.stderr)
    check_common("deployment", path, None)
    with h5py.File(path) as file:
        names = set(file) | {f"static/{name}" for name in file["static"]}
        check("deployment: nothing of a target", not [n for n in names if "target" in n or n == "quaternion"], names)
        nodes = file["node_position"].shape[1]
    seen = read_with_vtk(path)
    check("deployment: VTK sees a net and no polygon",
          len(seen) == 11 and all(s["points"] == nodes and s["polygons"] == 0 for s in seen), len(seen))


def check_target_only(castnet: str, folder: Path) -> None:
    """A target and no net; and a path with a blank and an umlaut."""
    scene = folder / "nür ein Ziel.nml"
    scene.write_text(TARGET_ONLY, encoding="utf-8")
    path = folder / "nür ein Ziel.h5"
    done = run(castnet, scene, path)
    check("target only: exit code 0", done.returncode == 0, done.stderr)
    scene.rename(folder / "scene.txt")
    check_common("target only", path, TARGET_ONLY)
    with h5py.File(path) as file:
        names = set(file) | {f"static/{name}" for name in file["static"]}
        check("target only: nothing of a net", not [n for n in names if re.search("node|cable|face|bullet", n)], names)
    with xr.open_dataset(path) as data:
        check("target only: xarray", data.target_position.dims == ("time", "xyz") and data.sizes["time"] == 101)
    seen = read_with_vtk(path)
    check("target only: VTK sees polygons and no line",
          len(seen) == 101 and all(s["lines"] == 0 and s["polygons"] == 12 for s in seen), len(seen))


def check_vtk_off(castnet: str, folder: Path) -> None:
    path = folder / "plain.h5"
    done = run(castnet, INPUT / "cubesat.nml", path, "--set", "time/end_time=0.05", "--set", "output/vtk=.false.",
               "--set", "output/verdict_times=0.05")
    check("no vtk: exit code 0", done.returncode == 0, done.stderr)
    with h5py.File(path) as file:
        check("no vtk: no group /VTKHDF when the scene does not want it", "VTKHDF" not in file)


def main() -> int:
    castnet = str(Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as name:
        for part in (check_capture, check_deployment, check_target_only, check_vtk_off):
            try:
                part(castnet, Path(name))
            except Exception as error:  # noqa: BLE001 - a test that cannot go on has failed
                check(f"{part.__name__} runs to its end", False, repr(error))
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
