"""Every scene of input/ is valid, is named in the folder's table, and stands on its own path."""
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    castnet, passed, failed = sys.argv[1], 0, 0
    table = (ROOT / "input" / "README.md").read_text(encoding="utf-8")
    for scene in sorted((ROOT / "input").glob("*.nml")):
        ran = subprocess.run([castnet, "check", str(scene)], capture_output=True, text=True, check=False)
        complaints = [] if ran.returncode == 0 else [f"exit {ran.returncode}: {ran.stderr.strip()}"]
        # The table gives the first of a family in full and then the rates: rocket_z_0.1, _0.4, _0.7.
        family, _, rate = scene.stem.rpartition("_")
        if f"`{scene.stem}`" not in table and not (f"`{family}_" in table and f"`_{rate}`" in table):
            complaints.append("not in input/README.md")
        print(("FAIL  " if complaints else "ok    ") + f"scenes: {scene.name}")
        for line in complaints:
            print("      " + line)
        passed, failed = passed + (not complaints), failed + bool(complaints)
    print(f"{passed} passed, {failed} failed")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
