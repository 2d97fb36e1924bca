"""A page of pictures comes out of any run, and shows what the run holds and nothing else."""
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from castnet_reader import Run  # noqa: E402
from plot_run import panels  # noqa: E402

NET = "&net squares = 4, 4, mesh_length = 0.1, cable_diameter = 1e-3 /\n&bullets mass = 0.03, speed = 1.8 /\n"
TARGET = ("&target shape = 'box', dimensions = 0.1, 0.1, 0.2, mass = 1.0, position = 0.25, 0, 0,"
          " angular_velocity = 0.3, 0, 0 /\n")
SCENES = {  # name: (scene, panels that must be there)
    "net": (NET + "&time end_time = 0.2 /\n", {"energy", "tension"}),
    "target": (TARGET + "&time end_time = 0.2 /\n", {"spin"}),
    "capture": (NET + TARGET + "&contact threshold = 2e-3 /\n&time end_time = 0.5 /\n",
                {"position", "velocity", "spin", "impulses", "energy", "tension", "measures"}),
}

results: list[bool] = []


def check(name: str, good: bool, words: str = "") -> None:
    results.append(good)
    print(("ok    " if good else "FAIL  ") + name + ("" if good else f": {words}"))


def main() -> int:
    castnet = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        for name, (text, wanted) in SCENES.items():
            scene = Path(folder) / f"{name}.nml"
            scene.write_text(text, encoding="utf-8")
            ran = subprocess.run([castnet, "run", str(scene), "--quiet"], capture_output=True, text=True, check=False)
            result = scene.with_suffix(".h5")
            if ran.returncode != 0:
                check(f"pictures: {name} runs", False, f"exit {ran.returncode}: {ran.stderr.strip()}")
                continue
            seen = {panel.__name__.removeprefix("panel_") for panel in panels(Run(result))}
            check(f"pictures: the panels of '{name}'", seen == wanted, f"seen {sorted(seen)}, expected {sorted(wanted)}")
            drawn = subprocess.run([sys.executable, str(ROOT / "tools" / "plot_run.py"), str(result)],
                                   capture_output=True, text=True, check=False)
            picture = scene.with_suffix(".png")
            good = drawn.returncode == 0 and not drawn.stderr and picture.is_file() and picture.stat().st_size > 10_000
            check(f"pictures: '{name}' is drawn without a word of warning", good, drawn.stderr.strip() or "no picture")
        broken = Path(folder) / "broken.h5"
        broken.write_bytes(b"not HDF5")
        said = subprocess.run([sys.executable, str(ROOT / "tools" / "plot_run.py"), str(broken)],
                              capture_output=True, text=True, check=False)
        check("pictures: a file that is no result is refused in one sentence",
              said.returncode == 2 and said.stderr.count("\n") == 1, said.stderr)
    print(f"{sum(results)} passed, {len(results) - sum(results)} failed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
