#!/usr/bin/env python3
"""Line coverage of src by what ran on the check build since it was made.

    tools/coverage.py [LEAST]

tools/test.sh builds the check build with --coverage and runs on it the unit tests and the
system tests that take the error paths; this prints the share of lines that ran, by layer
and in all, and the files with the most lines that did not. Fails below LEAST (90) per cent.
Lines that no test can reach are not left out.
"""
import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ["base", "geometry", "model", "physics", "io", "simulation", "study", "command"]
SHOWN = 15


def counted_files() -> list[dict]:
    """Lines in all and lines that ran, of each file of src."""
    # Fortran and C have folders of their own.
    folders = sorted({str(path.parent.relative_to(ROOT)) for path in ROOT.glob("build/*/castnet/*.gcda")})
    if not folders:
        sys.exit("coverage: nothing was counted; build with --coverage and run something, as tools/test.sh does")
    done = subprocess.run(["gcovr", "--root", ".", "--filter", "src/", "--gcov-ignore-parse-errors", "all", "--json-summary", "-",
                           *folders], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"coverage: gcovr says\n{done.stderr[-2000:]}")
    return json.loads(done.stdout)["files"]


def share(covered: int, total: int) -> str:
    return f"{100.0 * covered / max(1, total):6.1f} %  {covered:6d} of {total} lines"


def main() -> int:
    least = float(sys.argv[1]) if len(sys.argv) > 1 else 90.0
    files = [f for f in counted_files() if f["line_total"] > 0]
    sums = defaultdict(lambda: [0, 0])
    for file in files:
        for name in (Path(file["filename"]).parts[1], "all"):
            sums[name][0] += file["line_covered"]
            sums[name][1] += file["line_total"]
    for name in [*LAYERS, "all"]:
        print(f"{name:<11}{share(*sums[name])}")
    print("\nmost lines that did not run:")
    files.sort(key=lambda f: f["line_covered"] - f["line_total"])
    for file in files[:SHOWN]:
        print(f"  {file['filename']:<42}{file['line_total'] - file['line_covered']:5d} of {file['line_total']}")
    # A source that no count mentions would be left out in silence.
    named = {f["filename"] for f in files}
    unseen = [str(p.relative_to(ROOT)) for p in sorted(ROOT.glob("src/*/*.f90"))
              if str(p.relative_to(ROOT)) not in named and has_code(p)]
    if unseen:
        print("no count at all: " + ", ".join(unseen))
    covered, total = sums["all"]
    good = not unseen and 100.0 * covered >= least * total
    print(f"{'ok   ' if good else 'FAIL '} line coverage of src is at least {least:g} %")
    print(f"{int(good)} passed, {int(not good)} failed")
    return 0 if good else 1


def has_code(path: Path) -> bool:
    """Modules of types and constants alone have no line that runs."""
    return "\ncontains" in path.read_text()


if __name__ == "__main__":
    sys.exit(main())
