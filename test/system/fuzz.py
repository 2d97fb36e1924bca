"""Hostile input: mutated scenes, studies, net files and meshes through `castnet check`.

    python3 test/system/fuzz.py PATH_TO_CASTNET [--count N] [--seed S] [--keep FOLDER]

Each input follows from the seed and its number alone. Whatever comes in, the exit code is
0 or 2, nothing crashes, hangs, prints a backtrace or writes a file; what is accepted is
written as an effective scene and must read back to the same text; some of what is accepted
is also set up as a run. Inputs that once failed are kept in fuzz_inputs/ and always run.
Prints 'N passed, N failed'.
"""
import argparse
import random
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import h5py
import numpy as np

np.seterr(all="ignore")
warnings.simplefilter("ignore")

HERE = Path(__file__).resolve().parent
BATCH = 250

NET = "&net squares = 4 4 mesh_length = 0.07 cable_diameter = 1e-3 /\n"
REST = ("&bullets mass = 0.03 speed = 1.8 /\n"
        "&target shape = 'box' dimensions = 0.1 0.1 0.3 mass = 3.5 position = 1.4 0 0 /\n"
        "&contact threshold = 0.002 /\n&time end_time = 0.01 /\n")
STUDIES = [
    "&study scene = 'base.nml' seed = 3 seeds = 8 question = 'map' /\n"
    "&vary key = 'target/angular_velocity(2)' from = 0 to = 4 count = 9 /\n"
    "&vary key = 'contact/impulses' values = 'push_only', 'equality' /\n",
    "&study scene = 'base.nml' question = 'threshold' /\n"
    "&search key = 'target/angular_velocity(2)' from = 0 to = 4 probability = 0.5 budget = 400 /\n"
    "&vary key = 'bullets/speed' distribution = 'normal' mean = 1.8 deviation = 0.1 /\n",
    "&study scene = 'base.nml' record = 'runs' file = 'out.h5' /\n"
    "&vary key = 'time/step' from = 1e-5 to = 1e-3 /\n&vary key = 'bullets/angle' from = 10 to = 40 /\n"
    "&sample kind = 'sobol' points = 64 /\n",
]
SCENES = [
    NET + REST,
    "&net kind = 'file' file = 'net.h5' /\n&time end_time = 0.01 /\n",
    "&include file = 'base.nml' /\n&time end_time = 0.02 /\n",
    "&target shape = 'compound' mass = 8 position = 3*0 inertia = 1 1 1 3*0 attitude = 0.6 0.8 0 0 /\n"
    "&part shape = 'capsule' dimensions = 0.2 0.4 /\n"
    "&part shape = 'box' dimensions = 3*0.3 position = 0 0 1 attitude = 1 1 1 1 /\n"
    "&time end_time = 1 step = 1e-3 /\n&environment gravity(3) = -9.81 /\n"
    "&output file = 'it''s.h5' frame_interval = 0.1 verdict_times = 0.5 1 vtk = F /\n&perturb seed = 7 target_rate = 1e-3 /\n",
]
TOKENS = [
    "NaN", "Inf", "-Infinity", "1e999", "-1e999", "1e-999", "1e308", "-1e-308", "0", "-0.0", "1d0", "1.5e+3", ".5", "5.",
    "2147483647", "2147483648", "-2147483649", "9223372036854775807", "9223372036854775808", "1" + 400 * "0", "0." + 400 * "3",
    "3*0.5", "0*1", "-1*1", "999999999*0", "99999999999999999999*0", "2*", "*", "3*'a'", "''", "'", '"', "'it''s'", '"a" "b"',
    ".true.", "T", "tough", "f", "1_8", "(1,2)", "()", "(1)", "(0)", "(99999999999)", "(1:2)", "(", ")", "=", "==", "/", "//", "&",
    "&&", "&end", "$end", "!", "! comment", "#", ";", ",", ",,", "\t", "\n", "\r\n", "\r", "\0", "\x7f", "\ufeff", "\u00a0", "é", "漢",
    "&net", "&part shape = 'sphere' dimensions = 1 /", "&include file = 'fuzz.nml' /", "&include file = 'base.nml' /",
    "&include file = '/dev/null' /", "&include file = '.' /", "&vary key = 'part(1)/dimensions(1)' values = 1 /",
    "kind = 'file'", "file = '/dev/zero'", "file = 'base.nml'", "key = 'net/squares(1)'", "squares = 100000 100000",
    "cables_per_side = 1000", "verdict_times = " + " ".join(map(str, range(3000))), "values = " + 500 * "1 ", "count = 1000000",
    "frame_interval = 1e-300", "end_time = 1e300", "step = 1e-300", "x" * 5000, "'" + "y" * 5000 + "'", "a%b", "a(1)%b", "%",
]

# Files that are large in one way: to be told what is wrong with them must not take long.
LARGE = {
    "groups": "&a /\n" * 800000, "ampersands": "&" * 4000000, "keys": "&net\n" + "squares=1\n" * 400000,
    "unknown keys": "&net\n" + "".join(f"k{i}=1\n" for i in range(350000)), "brackets": "&net squares" + "(" * 4000000,
    "quotes": "&net kind=" + "'" * 3999990, "open strings": "&net kind='\n" * 300000, "values": "&output verdict_times=" + "1 " * 1999000,
    "commas": "&output verdict_times=" + "," * 3999000, "slashes": "&net " + "/" * 3999000, "a long key": "&net " + "a" * 3999000 + "=1 /",
    "strays": "a " * 1999000, "parts": "&part shape='box' /\n" * 200000, "equals": "&net " + "=" * 3999000,
    "control characters": "&net " + "\x01 " * 1900000, "line ends": "\n" * 4000000, "a long number": "&time end_time=" + "9" * 3999000 + " /",
    "a long word": "&net kind='" + "a b" * 1300000 + "' /", "includes": "&include file='base.nml' /\n" * 100000,
    "varied keys": "&study scene='base.nml' /\n" + "&vary key='a' /\n" * 200000, "too large": " " * 5000000,
    "rising times": NET + REST.replace("0.01", "1e5") + "&output verdict_times=" + " ".join(f"{i * 0.5}" for i in range(100000)) + " /",
}


def corpus(castnet):
    texts = [p.read_text() for p in sorted((HERE.parents[1] / "input").glob("*.nml"))]
    texts += [subprocess.run([castnet, "check", "--effective", "base.nml"], cwd=FOLDER, capture_output=True, text=True).stdout]
    with tempfile.TemporaryDirectory() as name:
        subprocess.run([castnet, "init", "template", "--quiet"], cwd=name, check=True)
        texts.append((Path(name) / "template.nml").read_text())
    return texts + 3 * SCENES + 6 * STUDIES


def change_number(r, text):
    """One number becomes another, often a plausible one: so that much is accepted."""
    found = list(re.finditer(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eEdD][-+]?\d+)?", text))
    if not found:
        return text
    m = r.choice(found)
    try:
        value = float(m.group().lower().replace("d", "e"))
    except ValueError:
        return text
    new = r.choice([value * r.uniform(0.3, 3), value * 10 ** r.randint(-12, 12), -value, value + 1, r.randint(-3, 9), r.random(), 0])
    shown = r.choice(["{:g}", "{!r}", "{:.3e}", "{:.0f}"]).format(new)
    return text[:m.start()] + shown + text[m.end():]


def change_key(r, text):
    """One word loses, gains or swaps letters."""
    found = list(re.finditer(r"[A-Za-z_]{2,}", text))
    if not found:
        return text
    m = r.choice(found)
    w = list(m.group())
    i = r.randrange(len(w))
    kind = r.randrange(4)
    if kind == 0:
        del w[i]
    elif kind == 1:
        w.insert(i, r.choice("abcxyz_1"))
    elif kind == 2 and i > 0:
        w[i], w[i - 1] = w[i - 1], w[i]
    else:
        w[i] = w[i].swapcase()
    return text[:m.start()] + "".join(w) + text[m.end():]


def mutate(r, text, texts):
    lines = text.split("\n")
    kind = r.randrange(13)
    a, b = sorted((r.randrange(len(text) + 1), r.randrange(len(text) + 1)))
    b = min(b, a + r.choice([1, 2, 5, 20, 200]))
    if kind <= 3:
        return change_number(r, text)
    if kind == 4:
        return change_key(r, text)
    if kind == 5:
        return text[:a] + r.choice(["", " "]) + r.choice(TOKENS) + r.choice(["", " "]) + text[a:]
    if kind == 6:
        return text[:a] + text[b:]
    if kind == 7:
        return text[:a] + text[a:b] * r.choice([2, 2, 3, 50]) + text[b:]
    if kind == 8:
        i = r.randrange(len(lines))
        j = r.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]
        return "\n".join(lines)
    if kind == 9:
        i = r.randrange(len(lines))
        return "\n".join(lines[:i] + [lines[i]] + lines[i:])
    if kind == 10:
        other = r.choice(texts)
        return text[:a] + other[r.randrange(len(other) + 1):]
    if kind == 11:
        return text[:a] if r.random() < 0.5 else text.replace("\n", r.choice(["\r\n", "\r", " \n", "\n\n", "\t"]))
    words = list(re.finditer(r"\S+", text))
    if not words:
        return text
    m = r.choice(words)
    return text[:m.start()] + r.choice(TOKENS) + text[m.end():]


def scene_bytes(r, texts):
    text = r.choice(texts)
    gentle = r.random() < 0.3                    # numbers only: most of these are accepted
    for _ in range(r.choice([1, 1, 1, 2, 2, 3, 5, 9])):
        text = change_number(r, text) if gentle else mutate(r, text, texts)[:200000]
    if gentle:
        return text.encode()
    kind = r.randrange(40)
    if kind == 0:
        return text.encode("utf-16")
    if kind == 1:
        return text.encode("latin-1", "replace")
    data = bytearray(text.encode("utf-8", "replace"))
    if kind <= 4 and data:
        for _ in range(r.choice([1, 3, 30])):
            data[r.randrange(len(data))] = r.randrange(256)
    if kind == 5:
        data = b"\xef\xbb\xbf" + data
    return bytes(data)


def net_file(r, path):
    """A net with something wrong with it, or not."""
    n = r.choice([1, 2, 3, 9])
    nodes = {"position": np.arange(3.0 * n).reshape(n, 3), "velocity": np.zeros((n, 3)), "mass": np.ones(n)}
    m = max(0, n - 1)
    cables = {"nodes": np.array([[i, i + 1] for i in range(m)], dtype=np.int64).reshape(m, 2), "natural_length": np.full(m, 5.0),
              "axial_stiffness": np.full(m, 1.0e3), "damping": np.full(m, 0.1)}
    if r.random() < 0.3:
        nodes["fixed"] = np.zeros(n, dtype=r.choice([np.int8, np.int64, bool, np.float64]))
    faces = np.array([[0, 1, 2, 3]]) if n > 3 and r.random() < 0.3 else None
    for _ in range(r.choice([0, 1, 1, 1, 2, 3])):
        group = r.choice([nodes, cables])
        key = r.choice(sorted(group))
        if key not in group:
            continue
        value = group[key]
        if isinstance(value, tuple):
            continue
        value = np.atleast_1d(value)
        kind = r.randrange(14)
        if kind == 0:
            del group[key]
            group[key + r.choice(["s", "_", "x"])] = value
        elif kind == 1:
            del group[key]
        elif kind == 2 and value.dtype.kind in "fiub":
            group[key] = value.astype(r.choice([np.float32, np.int32, np.int8, np.uint64, np.complex128]))
        elif kind == 3:
            group[key] = value.reshape(-1)
        elif kind == 4:
            group[key] = value[: max(0, len(value) - 1)]
        elif kind == 5:
            group[key] = np.concatenate([value, value])
        elif kind == 6:
            group[key] = np.array([b"text", b"here"])
        elif kind == 7:
            group[key] = np.float64(1)
        elif kind == 8:
            group[key] = np.zeros((0,) + value.shape[1:])
        elif kind == 9 and value.size:
            value = value.copy()
            value.flat[r.randrange(value.size)] = r.choice([-1, 0, 2**31 - 1, 2**31, -(2**31), n, n - 1, 1, 10**18]) \
                if value.dtype.kind == "i" and value.dtype.itemsize == 8 else 1
            group[key] = value
        elif kind == 10 and value.size and value.dtype.kind == "f":
            value = value.copy()
            value.flat[r.randrange(value.size)] = r.choice([np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300, 1e-310, 1e18])
            group[key] = value
        elif kind == 11:
            group[key] = np.full(value.shape, np.nan)
        elif kind == 12:
            group[key] = ("huge", value)
        elif kind == 13 and value.ndim > 1:
            group[key] = value.T
    with h5py.File(path, "w") as f:
        for name, group in (("node", nodes), ("cable", cables)):
            if r.random() < 0.03:
                f[name] = 1.0
                continue
            for key, value in group.items():
                if isinstance(value, tuple):      # absurd size, nothing stored
                    shape = (r.choice([2**31, 2**33, 10**12]),) + value[1].shape[1:]
                    f.create_dataset(f"{name}/{key}", shape=shape, dtype=value[1].dtype, chunks=(1024,) + value[1].shape[1:])
                else:
                    f[f"{name}/{key}"] = value
        if faces is not None:
            f["face"] = faces + r.choice([0, 0, -1, n])
    spoil = r.random()
    if spoil < 0.1:                               # cut
        data = path.read_bytes()
        path.write_bytes(data[: r.randrange(len(data))])
    elif spoil < 0.2:                             # flipped bits
        data = bytearray(path.read_bytes())
        for _ in range(r.choice([1, 1, 3, 30])):
            data[r.randrange(len(data))] ^= 1 << r.randrange(8)
        path.write_bytes(bytes(data))


def mesh_file(r, path):
    """A box as STL (text or binary) or OBJ with something wrong with it, or not."""
    corner = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.3)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    corner = [list(p) for p in corner]
    for _ in range(r.choice([0, 0, 1, 2])):
        kind = r.randrange(8) if faces else 5
        if kind == 0:
            del faces[r.randrange(len(faces))]
        elif kind == 1:
            i = r.randrange(len(faces))
            faces[i] = faces[i][::-1]
        elif kind == 2:
            faces.append(r.choice(faces))
        elif kind == 3:
            corner[r.randrange(8)][r.randrange(3)] = r.choice([float("nan"), float("inf"), 1e30, -1e300, 1e-300, 0, 0.05, -0.1])
        elif kind == 4:
            faces[r.randrange(len(faces))] = (0, 0, r.randrange(8))
        elif kind == 5:
            scale = r.choice([1e-9, 1e9, -1, 1e-30])
            corner = [[scale * x for x in p] for p in corner]
        elif kind == 6:
            faces = r.choice([[], faces[:1], faces * 2])
        else:
            r.shuffle(faces)
    style = r.choice(["text", "binary", "obj"])
    if style == "text":
        data = "solid box\n" + "".join("facet normal 0 0 0\n outer loop\n" + "".join("  vertex %r %r %r\n" % tuple(corner[i]) for i in f)
                                       + " endloop\nendfacet\n" for f in faces) + "endsolid box\n"
    elif style == "obj":
        data = "# box\n" + "".join("v %r %r %r\n" % tuple(p) for p in corner) + "".join("f %d %d %d\n" % tuple(i + 1 for i in f) for f in faces)
    else:
        with np.errstate(all="ignore"):
            data = bytes(80) + ((len(faces) + r.choice([0, 0, 0, 1, -1, 2**31])) % 2**32).to_bytes(4, "little") + b"".join(
                np.array([[0, 0, 0], *(corner[i] for i in f)], dtype="<f4").tobytes() + b"\0\0" for f in faces)
    if isinstance(data, str):
        for _ in range(r.choice([0, 0, 1, 3])):
            data = mutate(r, data, [data])
        data = data.encode("utf-8", "replace")
    elif r.random() < 0.3 and data:
        data = bytearray(data)
        for _ in range(r.choice([1, 3, 30])):
            data[r.randrange(len(data))] = r.randrange(256)
    if r.random() < 0.15:
        data = data[: r.randrange(len(data) + 1)]
    path = path.with_suffix(".obj" if style == "obj" or r.random() < 0.1 else ".stl")
    path.write_bytes(bytes(data))
    return path.name


def override(r, keys):
    """A --set that is right, nearly right, or not at all."""
    key = r.choice(keys)
    value = r.choice(["1", "0.5", "2 3", "1,0,0", "3*1", ".true.", "'box'", "sphere", "net.h5", r.choice(TOKENS), r.choice(TOKENS)])
    text = r.choice([f"{key}={value}", f"{key}={value}", f"{key}({r.randint(0, 7)})={value}", change_key(r, f"{key}={value}"), value, f"={value}"])
    return text.replace("\0", "")


def check_overrides(castnet, r, keys):
    """What went wrong with a few random overrides of a sound scene; None if nothing."""
    words = [w for _ in range(r.choice([1, 1, 2, 4])) for w in ("--set", override(r, keys))]
    try:
        done = subprocess.run([castnet, "check", "base.nml", "--effective", *words], cwd=FOLDER, capture_output=True, timeout=20,
                              stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return f"{words}: hangs"
    said = done.stderr.decode("utf-8", "replace")
    if done.returncode not in (0, 2) or bad_words(said):
        return f"{words}: exit code {done.returncode}, {said[-300:]}"
    if done.returncode == 0:
        (FOLDER / "overridden.nml").write_bytes(done.stdout)
        again = subprocess.run([castnet, "check", "overridden.nml", "--effective"], cwd=FOLDER, capture_output=True, timeout=20)
        if again.stdout != done.stdout:
            return f"{words}: the effective scene does not read back"
    return None


def check_large(castnet, text):
    (FOLDER / "large.nml").write_text(text)
    try:
        done = subprocess.run([castnet, "check", "large.nml", "--effective"], cwd=FOLDER, capture_output=True, timeout=60)
    except subprocess.TimeoutExpired:
        return "hangs"
    said = done.stderr.decode("utf-8", "replace")
    if done.returncode not in (0, 2) or bad_words(said) or len(said) > 100000:
        return f"exit code {done.returncode}, {said[-300:]}"
    return None


def bad_words(text):
    return [w for w in ("Backtrace", "rror termination", "Program received", "Fortran runtime", "SIGSEGV", "At line") if w in text]


def check(castnet, names, timeout):
    """Run one batch. Returns {name: (verdict, effective text)}, or None and what went wrong."""
    try:
        done = subprocess.run([castnet, "check", "--effective", "--", *names], cwd=FOLDER, capture_output=True, timeout=timeout,
                              stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return None, "hangs"
    said = done.stderr.decode("utf-8", "replace")
    if done.returncode not in (0, 2) or bad_words(said):
        return None, f"exit code {done.returncode}: {said[-300:]}"
    parts = re.split(rb"(?m)^=== (\S+): (accepted|refused)\n", done.stdout)[1:]
    result = {parts[i].decode(): (parts[i + 1].decode(), parts[i + 2]) for i in range(0, len(parts), 3)}
    if len(result) != len(names):
        return None, f"{len(result)} verdicts for {len(names)} files"
    if done.returncode != (2 if any(v == "refused" for v, _ in result.values()) else 0):
        return None, f"exit code {done.returncode} does not fit the verdicts"
    return result, ""


def check_each(castnet, names):
    """A batch went wrong: find out which."""
    for name in names:
        result, wrong = check(castnet, [name, "base.nml"], 20)
        yield name, result and result[name], wrong


def run_batch(castnet, names, failures):
    """Verdicts of a batch; what is accepted must read back to the same text."""
    result, wrong = check(castnet, [*names, "base.nml"], 120)
    if result is None:
        result = {}
        for name, verdict, why in check_each(castnet, names):
            if verdict is None:
                failures.append((name, why))
            else:
                result[name] = verdict
    result.pop("base.nml", None)
    accepted = [n for n, (verdict, _) in result.items() if verdict == "accepted"]
    again = {}
    for n in accepted:
        again[f"again_{n}"] = n
        (FOLDER / f"again_{n}").write_bytes(result[n][1])
    if again:
        second, wrong = check(castnet, [*again, "base.nml"], 120)
        for a, n in again.items():
            if second is None:
                failures.append((n, f"effective scenes of its batch: {wrong}"))
            elif second[a][0] != "accepted":
                failures.append((n, "its effective scene is refused"))
            elif second[a][1] != result[n][1]:
                failures.append((n, "its effective scene reads back to another scene"))
    return accepted


def main():
    global FOLDER
    arguments = argparse.ArgumentParser()
    arguments.add_argument("castnet", type=lambda p: Path(p).resolve())
    arguments.add_argument("--count", type=int, default=3000)
    arguments.add_argument("--seed", type=int, default=20181)
    arguments.add_argument("--keep", type=Path, help="folder for inputs that fail")
    options = arguments.parse_args()
    failures, tried, accepted, runs = [], 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        FOLDER = Path(name)
        (FOLDER / "base.nml").write_text(NET + REST)
        net_file(random.Random(0), FOLDER / "net.h5")
        for scene in (HERE.parents[1] / "input").glob("*.nml"):
            shutil.copy(scene, FOLDER)
        kept = sorted((HERE / "fuzz_inputs").glob("*.nml"))
        for file in (HERE / "fuzz_inputs").glob("*"):
            if file.suffix != ".nml":
                shutil.copy(file, FOLDER)
        furniture = {p.name for p in FOLDER.iterdir()}
        texts = corpus(options.castnet)
        sources = [p.read_bytes() for p in kept] + [None] * options.count
        for start in range(0, len(sources), BATCH):
            names = []
            for i in range(start, min(start + BATCH, len(sources))):
                r = random.Random(f"{options.seed} {i - len(kept)}")
                names.append(f"f{i}.nml")
                data = sources[i]
                if data is None and r.random() < 0.1:
                    mesh = mesh_file(r, FOLDER / f"f{i}")
                    data = (f"&target shape = 'mesh' file = '{mesh}' mass = 3.5 position = 1.4 0 0 /\n" + NET + r.choice(["", "&contact threshold = 0.002 /\n"])
                            + "&bullets mass = 0.03 speed = 1.8 /\n&time end_time = 0.01 /\n").encode()
                elif data is None and r.random() < 0.1:
                    net_file(r, FOLDER / f"f{i}.h5")
                    data = f"&net kind = 'file' file = 'f{i}.h5' /\n&time end_time = 0.01 /\n".encode()
                (FOLDER / names[-1]).write_bytes(scene_bytes(r, texts) if data is None else data)
            before = sorted(p.name for p in FOLDER.iterdir())
            n_before = len(failures)
            good = run_batch(options.castnet, names, failures)
            new = [p.name for p in FOLDER.iterdir() if p.name not in before and not p.name.startswith("again_")]
            if new:
                failures.append((names[0], f"the batch wrote {new}"))
            accepted += len(good)
            tried += len(names)
            for n in good[::25]:
                runs += 1
                try:
                    done = subprocess.run([options.castnet, "check", n], cwd=FOLDER, capture_output=True, timeout=60, stdin=subprocess.DEVNULL)
                    if done.returncode not in (0, 2) or bad_words(done.stderr.decode("utf-8", "replace")):
                        failures.append((n, f"set up: exit code {done.returncode}, {done.stderr[-300:]}"))
                except subprocess.TimeoutExpired:
                    failures.append((n, "hangs when set up"))
            for n, why in failures[n_before:]:
                print(f"FAIL  seed {options.seed} {n}: {why}", flush=True)
                if options.keep:
                    options.keep.mkdir(exist_ok=True)
                    for file in (n.replace(".nml", e) for e in (".nml", ".h5", ".stl", ".obj")):
                        if (FOLDER / file).exists():
                            shutil.copy(FOLDER / file, options.keep / f"{options.seed}_{file}")
            for p in FOLDER.iterdir():
                if p.name not in furniture:
                    p.unlink()
        keys = [f"{g}/{k}" for g, block in re.findall(r"## `&(\w+)`(.*?)(?=\n## |\Z)", subprocess.run(
            [options.castnet, "schema", "--markdown"], capture_output=True, text=True).stdout, re.S)
            for k in re.findall(r"(?m)^\| `(\w+)`", block)]
        special = [("overrides", check_overrides(options.castnet, random.Random(f"{options.seed} set {i}"), keys))
                   for i in range(options.count // 10)]
        special += [(f"large: {what}", check_large(options.castnet, text)) for what, text in LARGE.items()]
        tried += len(special)
        for i, (what, why) in enumerate(special):
            if why:
                failures.append((f"{what} {i}", why))
                print(f"FAIL  seed {options.seed} {what}: {why}", flush=True)
    print(f"{tried} inputs, {accepted} accepted and read back, {runs} of them set up")
    failed = len({n for n, _ in failures})
    print(f"{tried - failed} passed, {failed} failed")
    return failed > 0


FOLDER = Path()
if __name__ == "__main__":
    sys.exit(main())
