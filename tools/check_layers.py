#!/usr/bin/env python3
"""The layer rule, held from the `use` lines of the Fortran sources.

base <- geometry <- model <- physics <- simulation <- study <- command, and
model <- io <- simulation; physics and io never see each other. A module may use its
own layer and the ones it stands on. Prints every line that breaks the rule.

    check_layers.py [SRC]
"""
import re
import sys
from pathlib import Path

ORDER = ["base", "geometry", "model", "physics", "io", "simulation", "study", "command"]
ALLOWED = {layer: set(ORDER[: i + 1]) for i, layer in enumerate(ORDER)}
ALLOWED["io"].discard("physics")

USE = re.compile(r"^\s*use\s*(?:,\s*(?:non_)?intrinsic\s*)?(?:::)?\s*(castnet_\w+)", re.IGNORECASE)
MODULE = re.compile(r"^\s*module\s+(castnet_\w+)\s*$", re.IGNORECASE)


def problems(source: Path) -> list[str]:
    """One line for each module of an unknown layer or name and each forbidden use."""
    files = sorted(f for f in source.rglob("*") if f.suffix.lower() == ".f90")
    lines = {f: f.read_text(encoding="utf-8").splitlines() for f in files}
    home, found = {}, []
    for file in files:
        layer = file.relative_to(source).parts[0]
        if layer not in ALLOWED:
            found.append(f"{file}: '{layer}' is not a layer ({', '.join(ORDER)})")
        for line in lines[file]:
            if match := MODULE.match(line):
                home[match[1].lower()] = layer
                if match[1].lower() != file.stem.lower():
                    found.append(f"{file}: holds module {match[1]}, which belongs into {match[1]}.f90")
    for file in files:
        layer = file.relative_to(source).parts[0]
        for number, line in enumerate(lines[file], 1):
            if not (match := USE.match(line)):
                continue
            other = home.get(match[1].lower())
            if other is None:
                found.append(f"{file}:{number}: uses {match[1]}, which is not in {source}")
            elif other not in ALLOWED.get(layer, ()):
                found.append(f"{file}:{number}: {layer} may not use {match[1]} of {other}")
    return found


if __name__ == "__main__":
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent / "src"
    broken = problems(root)
    print("\n".join(broken) or "layers: every use line keeps to the rule")
    sys.exit(1 if broken else 0)
