"""Run scenes with castnet, several at a time, and only those whose result is missing or stale."""
from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
INPUT = ROOT / "input"


@dataclass
class Job:
    """One run: a scene of input/ (by name), where its result goes, and what is set differently."""

    scene: str
    output: Path
    settings: dict[str, str] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        return INPUT / f"{self.scene}.nml"

    def command(self, castnet: str) -> list[str]:
        words = [castnet, "run", str(self.path), "--output", str(self.output), "--force", "--quiet", "--no-progress"]
        for key, value in self.settings.items():
            words += ["--set", f"{key}={value}"]
        return words


def find_castnet(given: str | None = None) -> str:
    """The program: as given, from CASTNET, the newest of the builds here, or from PATH."""
    builds = sorted(ROOT.glob("build/gfortran_*/app/castnet"), key=lambda f: f.stat().st_mtime)
    for candidate in (given, os.environ.get("CASTNET"), builds[-1] if builds else None, shutil.which("castnet")):
        if candidate:
            if not os.access(candidate, os.X_OK):
                sys.exit(f"{candidate} is not a program; build castnet first: fpm @release")
            return str(Path(candidate).resolve())
    sys.exit("castnet is not built: run fpm @release, or say where it is with --castnet")


def sources(scene: Path) -> list[Path]:
    """A scene and all that it includes."""
    found = [scene]
    for name in re.findall(r"^\s*&include\s+file\s*=\s*'([^']+)'", scene.read_text(), re.MULTILINE | re.IGNORECASE):
        found += sources(scene.parent / name)
    return found


def is_fresh(job: Job, castnet: str) -> bool:
    """Is the result newer than the program and the scene's files, and made by the same command?"""
    note = job.output.with_suffix(".command")
    if not job.output.is_file() or not note.is_file() or note.read_text() != "\n".join(job.command(castnet)):
        return False
    made = job.output.stat().st_mtime
    return all(made > source.stat().st_mtime for source in [Path(castnet), *sources(job.path)])


def run_all(jobs: list[Job], castnet: str, *, at_once: int = 2, fresh: bool = False) -> list[Job]:
    """Run the jobs that need it, `at_once` together, one thread each. Returns those that failed."""
    wanted = [job for job in jobs if fresh or not is_fresh(job, castnet)]
    started = time.monotonic()
    done = 0

    def work(job: Job) -> Job | None:
        nonlocal done
        job.output.parent.mkdir(parents=True, exist_ok=True)
        surroundings = os.environ | {"OMP_NUM_THREADS": "1"}
        result = subprocess.run(job.command(castnet), stdin=subprocess.DEVNULL, capture_output=True, text=True,
                                env=surroundings, check=False)
        done += 1
        mark = "done" if result.returncode == 0 else f"exit {result.returncode}"
        print(f"[{done}/{len(wanted)}] {job.output.stem}: {mark}", file=sys.stderr, flush=True)
        if result.returncode != 0:
            print("    " + " ".join(job.command(castnet)) + "\n    "
                  + result.stderr.strip().replace("\n", "\n    "), file=sys.stderr, flush=True)
            return job
        job.output.with_suffix(".command").write_text("\n".join(job.command(castnet)))
        return None

    with ThreadPoolExecutor(at_once) as pool:
        failed = [job for job in pool.map(work, wanted) if job is not None]
    print(f"{len(wanted)} runs in {time.monotonic() - started:.0f} s, {len(jobs) - len(wanted)} results were there already",
          file=sys.stderr)
    return failed
