"""The layer rule holds in src/, and the check that says so can see a broken rule."""
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from check_layers import problems  # noqa: E402


def a_broken_rule_is_seen() -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder)
        modules = {
            "base/castnet_kinds.f90": "module castnet_kinds\nend module",
            "physics/castnet_force.f90": "module castnet_force\nuse castnet_kinds, only: wp\nend module",
            "io/castnet_writer.f90": "module castnet_writer\n  use, non_intrinsic :: castnet_force\nend module",
        }
        for name, text in modules.items():
            (source / name).parent.mkdir(parents=True)
            (source / name).write_text(text)
        seen = problems(source)
        good = len(seen) == 1 and "io may not use castnet_force of physics" in seen[0]
        return [] if good else [f"expected one complaint about io using physics, seen {seen}"]


def main() -> int:
    passed = failed = 0
    for name, complaints in (
        ("layers: src keeps to the rule", problems(ROOT / "src")),
        ("layers: a broken rule is seen", a_broken_rule_is_seen()),
    ):
        print(("FAIL  " if complaints else "ok    ") + name)
        for line in complaints:
            print("      " + line)
        passed, failed = passed + (not complaints), failed + bool(complaints)
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
