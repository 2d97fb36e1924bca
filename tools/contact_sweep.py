#!/usr/bin/env python3
"""How deep does anything stand in the target after correction? Every capture of the paper, any restitution and friction.

    tools/contact_sweep.py [SCENE ...] [--castnet PROGRAM] [-o TABLE.md]

Each scene of input/ that holds a target x nodes and cables in contact x restitution 0, 0.5, 1 x friction 0, 0.3, 1, at the
default method and step. Told of each scene: the deepest penetration and the largest residual of the contact law over
all of its runs and steps, and where they were.
"""
import argparse
import itertools
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from castnet_runner import INPUT, find_castnet, sources

DETECT, RESTITUTION, FRICTION = ("nodes", "cables"), (0.0, 0.5, 1.0), (0.0, 0.3, 1.0)


@dataclass
class Outcome:
    code: int
    words: str = ""
    depth: float = np.nan         # [m]
    residual: float = np.nan      # [m/s]
    impulse: float = np.nan       # least normal impulse [N s]; below zero only where contact pulls


def captures() -> list[str]:
    """The scenes with a target, as a user names them: those that others include stand for themselves too."""
    return [path.stem for path in sorted(INPUT.glob("*.nml"))
            if any("&target" in source.read_text() and "shape" in source.read_text() for source in sources(path))]


def fly(castnet: str, scene: str, settings: dict[str, object], output: Path) -> Outcome:
    command = [castnet, "run", str(INPUT / f"{scene}.nml"), "--output", str(output), "--force", "--quiet", "--set", "output/vtk=.false."]
    command += [word for key, value in settings.items() for word in ("--set", f"contact/{key}={value}")]
    result = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        return Outcome(result.returncode, result.stderr.strip().splitlines()[-1])
    with h5py.File(output) as f:
        history = f["history"]
        depth, residual = float(history["deepest_penetration"][()].max()), float(history["contact_residual"][()].max())
        impulse = float(np.nanmin(history["min_impulse"][()]))
    output.unlink()
    return Outcome(0, "", depth, residual, impulse)


def worst(cases: dict[tuple, Outcome], measure: str) -> str:
    done = {key: getattr(o, measure) for key, o in cases.items() if o.code == 0}
    if not done:
        return "-"
    (detect, e, mu), value = max(done.items(), key=lambda item: item[1])
    return f"{value:.2g} ({detect}, e = {e:g}, mu = {mu:g})"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=captures())
    parser.add_argument("--castnet")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    castnet = find_castnet(options.castnet)
    settings = list(itertools.product(DETECT, RESTITUTION, FRICTION))
    text = ["| scene | deepest, nodes, m | deepest, cables, m | largest residual, m/s |", "|---|---|---|---|"]
    failed, least = 0, np.inf
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        for scene in options.scenes:
            def one(i: int, scene: str = scene) -> Outcome:
                detect, e, mu = settings[i]
                return fly(castnet, scene, {"detect": f"'{detect}'", "restitution": e, "friction": mu}, Path(folder) / f"{i}.h5")
            found = dict(zip(settings, pool.map(one, range(len(settings)))))
            for key, o in found.items():
                if o.code != 0:
                    failed += 1
                    print(scene, *key, f"exit {o.code}: {o.words}", file=sys.stderr)
            least = min([least, *(o.impulse for o in found.values() if o.code == 0)])
            parts = [worst({key: o for key, o in found.items() if key[0] == detect}, "depth") for detect in DETECT]
            text.append(f"| {scene} | {parts[0]} | {parts[1]} | {worst(found, 'residual')} |")
            print(text[-1], file=sys.stderr, flush=True)
    text = "\n".join([*text, "", f"{len(options.scenes) * len(settings)} runs, {failed} failed. Least impulse: {least:.2g} N s."]) + "\n"
    if options.output:
        Path(options.output).write_text(text)
    else:
        print(text)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
