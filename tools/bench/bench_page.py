"""Tables of docs/performance.md that benchmarks write themselves, and the benchmark's program."""
import os
import re
import subprocess

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
PAGE = os.path.join(ROOT, "docs", "performance.md")


def flags(name):
    """The flags of a set in fpm.rsp."""
    with open(os.path.join(ROOT, "fpm.rsp"), encoding="utf-8") as file:
        return re.search(rf'@{name}\n(?:options .*\n)*?options .*--flag "([^"]*)"', file.read()).group(1)


def build_bench(name="release"):
    """Build test/bench.f90 with a set of flags; the program's path."""
    command = ["fpm", "test", "--target", "bench", "--profile", "release", "--flag", flags(name), "--runner", "echo"]
    out = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return os.path.join(ROOT, out.strip().splitlines()[-1].split()[0])


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def put(name, text, page=PAGE):
    """Replace what stands between the markers `name` of the page."""
    with open(page, encoding="utf-8") as file:
        old = file.read()
    pattern = re.compile(rf"(<!-- {name}: [^\n]*-->\n).*?(<!-- end of {name} -->)", re.S)
    if not pattern.search(old):
        raise SystemExit(f"no markers of {name} in {page}")
    with open(page, "w", encoding="utf-8") as file:
        file.write(pattern.sub(lambda m: f"{m.group(1)}\n{text}\n\n{m.group(2)}", old))
