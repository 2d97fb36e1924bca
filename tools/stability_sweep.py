#!/usr/bin/env python3
"""Is the automatic step sound? The paper's captures with stiff fibres and any damping: energy ledgers of `step = 0`.

    tools/stability_sweep.py [--scene NAME] [--method NAME] [--castnet PROGRAM] [-o TABLE.md]

Four captures x three moduli x five damping ratios x both methods, a history row every hundredth of the run.
Told of each, as a share of what the net was given (the shot's energy and the winches' work):
- rise: the most that energy less the work of winches and projection ever stood above its start;
- balance: energy plus all that was dissipated, less all that was put in, at the end. Contact and damping are
  written down as they act, so this is the error of the integration and nothing else.
"""
import argparse
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from castnet_runner import INPUT, find_castnet

MODULI = {"0.4456 GPa": "4.456e8", "70 GPa": "70e9", "270 GPa": "270e9"}
RATIOS = ("0", "0.1", "0.5", "1", "2")
METHODS = ("midpoint", "rk4")
# scene: time at which it ends here, well after contact (and closing)
SCENES = {"cubesat": 1.6, "rocket_x_0.4": 8.0, "rocket_closing_x_1.1": 8.0, "rocket_closing_z_1.1": 8.0}
MOST_RISE = 0.01      # of what was given: the energy never rises by more
MOST_BALANCE = 0.10   # of what was given: snaps are of first order in the step


@dataclass
class Outcome:
    code: int
    words: str = ""
    step: float = np.nan
    rise: float = np.nan
    balance: float = np.nan
    evaluations: int = 0

    @property
    def sound(self) -> bool:
        return self.code == 0 and self.rise <= MOST_RISE and abs(self.balance) <= MOST_BALANCE


def fly(castnet: str, scene: Path, end: float, settings: dict[str, str], output: Path) -> Outcome:
    given = {"time/end_time": end, "output/verdict_times": end, "output/frame_interval": end, "output/history_interval": end / 400,
             "output/vtk": ".false.", "time/step": 0} | settings
    command = [castnet, "run", str(scene), "--output", str(output), "--force", "--quiet"]
    command += [word for key, value in given.items() for word in ("--set", f"{key}={value}")]
    result = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        return Outcome(result.returncode, result.stderr.strip().splitlines()[-1])
    with h5py.File(output) as f:
        history = {name: f["history"][name][()] for name in f["history"]}
        steps, evaluations = int(f["summary/steps"][()]), int(f["summary/force_evaluations"][()])
    output.unlink()
    return judge(history, end / steps, evaluations)


def judge(h: dict[str, np.ndarray], step: float, evaluations: int) -> Outcome:
    energy = h["kinetic_net"] + h["kinetic_target"] + h["elastic"]
    put_in = h["winch_work"] + h["projection_work"] + h.get("external_work", 0.0)
    given = h["kinetic_net"][0] + h["elastic"][0] + max(0.0, h["winch_work"].max())
    own = energy - put_in
    balance = own + h["dissipated"] + h["contact_loss"]
    return Outcome(0, "", step, float((own - own[0]).max() / given), float((balance[-1] - balance[0]) / given), evaluations)


def sweep(castnet: str, scenes: dict[str, float], moduli, ratios, methods, at_once: int = 2) -> dict[tuple, Outcome]:
    cases = [(s, m, z, w) for s in scenes for m in moduli for z in ratios for w in methods]
    with tempfile.TemporaryDirectory() as folder:
        def one(i: int) -> Outcome:
            scene, modulus, ratio, method = cases[i]
            return fly(castnet, INPUT / f"{scene}.nml", scenes[scene], {"net/elastic_modulus": MODULI[modulus], "net/damping_ratio": ratio,
                       "time/method": method}, Path(folder) / f"{i}.h5")
        with ThreadPoolExecutor(at_once) as pool:
            return dict(zip(cases, pool.map(one, range(len(cases)))))


def table(found: dict[tuple, Outcome]) -> str:
    text = ["| scene | modulus | method | " + " | ".join(f"ratio {z}" for z in RATIOS) + " |", "|---|---|---|" + "---|" * len(RATIOS)]
    for scene, modulus, method in dict.fromkeys((s, m, w) for s, m, _, w in found):
        cells = []
        for z in RATIOS:
            o = found[scene, modulus, z, method]
            cells.append(f"{o.step:.2g} s, {100 * o.rise:.2g}, {100 * o.balance:+.2g}" + ("" if o.sound else " **!**") if o.code == 0 else f"**exit {o.code}**")
        text.append(f"| {scene} | {modulus} | {method} | " + " | ".join(cells) + " |")
    bad = [key for key, o in found.items() if not o.sound]
    text += ["", f"{len(found)} runs; step, highest rise and balance at the end in % of what was given. "
             + (f"Unsound: {len(bad)}." if bad else "None blows up, none gains energy.")]
    return "\n".join(text) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--castnet")
    parser.add_argument("--scene", action="append", choices=list(SCENES))
    parser.add_argument("--method", action="append", choices=METHODS)
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    scenes = {name: SCENES[name] for name in options.scene or SCENES}
    found = sweep(find_castnet(options.castnet), scenes, MODULI, RATIOS, options.method or METHODS)
    text = table(found)
    for key, o in found.items():
        if not o.sound:
            print(*key, o, file=sys.stderr)
    if options.output:
        Path(options.output).write_text(text)
    else:
        print(text)
    return 0 if all(o.sound for o in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
