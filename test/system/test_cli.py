"""The program as its user meets it: exit codes, what is told on which stream, and that
bad input writes nothing.

    python3 test/system/test_cli.py PATH_TO_CASTNET
"""
import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

castnet = Path(sys.argv[1]).resolve()
passed, failed = 0, 0

NET = "&net squares = 10 10 mesh_length = 0.07 cable_diameter = 1e-3 /\n"
BULLETS = "&bullets mass = 0.03 speed = 1.8 /\n"
TARGET = "&target shape = 'box' dimensions = 0.1 0.1 0.3 mass = 3.5 position = 1.4 0 0 /\n"
CONTACT = "&contact threshold = 0.002 /\n"
TIME = "&time end_time = 0.01 /\n"
SCENE = NET + BULLETS + TARGET + CONTACT + TIME

# Malformed scenes: text, and for each problem 'line: words'.
MALFORMED = {
    "misspelt group": ("&nte squares = 1 1 /\n" + NET + TIME, ["1: nte: there is no group", "did you mean net?"]),
    "misspelt key": (NET + "&time end_tiem = 1 /\n", ["2: time/end_tiem: ", "did you mean end_time?", "2: time/end_time: missing"]),
    "misspelt word": (NET + "&time end_time = 1 method = 'rk' /", ["2: time/method: seen 'rk'; allowed: 'rk4'"]),
    "key of another group": (NET + "&time end_time = 1 mass = 1 /", ["2: time/mass: ", "it is a key of &bullets, &target"]),
    "flag = tough": (NET + "&time end_time = 1 allow_unstable = tough /", ["2: time/allow_unstable: seen tough"]),
    "1e999": (NET + "&time end_time = 1e999 /", ["2: time/end_time: seen 1e999"]),
    "-1e999": (NET + "&time end_time = -1e999 /", ["2: time/end_time: seen -1e999"]),
    "NaN": (NET + "&time end_time = NaN /", ["2: time/end_time: seen NaN, which must be finite"]),
    "Infinity": (NET + "&time end_time = Infinity /", ["2: time/end_time: seen Infinity"]),
    "equal keys": (NET + "&time end_time = 1\nend_time = 2 /", ["3: time/end_time: the key is repeated; it stands on line 2"]),
    "equal groups": (NET + TIME + TIME, ["3: time: the group is repeated; it stands on line 2"]),
    "half an array": (NET + TIME + "&environment gravity = 0 0 /", ["3: environment/gravity: seen 2 values; allowed: 3"]),
    "too long an array": (NET + TIME + "&environment gravity = 4*0 /", ["3: environment/gravity: seen 4 values"]),
    "index too large": (NET + TIME + "&environment gravity(7) = 0 /", ["3: environment/gravity: seen index (7)"]),
    "array section": (NET + TIME + "&environment gravity(1:3) = 3*0 /", ["3: environment/gravity: seen index (1:3)"]),
    "cut string": (NET + TIME + "&output file = 'a.h5\n/", ["3: the string", "not closed"]),
    "no final /": (NET + "&time end_time = 1\n", ["2: time: the group that starts here has no final /"]),
    "no / before the next": ("&net squares = 1 1 mesh_length = 1 cable_diameter = 0.1\n" + TIME, ["1: net: the group", "line 2"]),
    "&end": (NET + "&time end_time = 1 &end\n", ["2: time: seen &end; a group ends with /"]),
    "text between groups": (NET + "here comes time\n" + TIME, ["2: text outside groups"]),
    "key between groups": (NET + "end_time = 1\n" + TIME, ["2: end_time: this key stands outside any group"]),
    "text after /": (NET + "&time end_time = 1 / seconds\n", ["2: text after the /"]),
    "unquoted path": (NET + TIME + "&output file = out.h5 /", ["3: output/file: seen out.h5 without quotes"]),
    "number for text": (NET + TIME + "&output file = 3 /", ["3: output/file: seen 3 without quotes"]),
    "text for a number": (NET + "&time end_time = '1' /", ["2: time/end_time: seen '1', which is text"]),
    "word for a number": (NET + "&time end_time = one /", ["2: time/end_time: seen one, which is not a number"]),
    "number for a logical": (NET + "&time end_time = 1 allow_unstable = 1 /", ["2: time/allow_unstable: seen 1"]),
    "real for an integer": (NET + TIME + "&perturb seed = 1.5 /", ["3: perturb/seed: seen 1.5, which is not a whole number"]),
    "integer too large": (NET + TIME + "&perturb seed = 9223372036854775808 /", ["3: perturb/seed: seen 9223372036854775808"]),
    "negative damping": ("&net squares = 2*9 mesh_length = 1 cable_diameter = 0.01 damping_ratio = -1 /\n" + TIME, ["1: net/damping_ratio: seen -1"]),
    "no squares": ("&net squares = 0 9 mesh_length = 1 cable_diameter = 0.01 /\n" + TIME, ["1: net/squares: seen 0"]),
    "no such machine": ("&net squares = 2*100000 mesh_length = 1 cable_diameter = 0.01 /\n" + TIME, ["1: net/squares: ", "TiB of memory; this machine has"]),
    "empty value": (NET + TIME + "&environment gravity = 0,,0 /", ["3: environment/gravity: an empty value"]),
    "empty key": (NET + "&time end_time = /", ["2: time/end_time: no value is given"]),
    "missing group": (NET, ["2: time: the group &time is missing"]),
    "missing keys": (TIME + "&target /", ["2: target/shape: missing", "2: target/position: missing", "2: target/mass: missing"]),
    "nothing to run": (TIME, ["nothing to move"]),
    "bullets without net": (TARGET + BULLETS + TIME, ["2: bullets: bullets without a &net"]),
    "contact without target": (NET + CONTACT + TIME, ["2: contact: contact needs both"]),
    "compound without part": ("&target shape = 'compound' mass = 1 position = 3*0 /\n" + TIME, ["1: target/shape: seen 'compound' without any &part"]),
    "part without compound": (TARGET + "&part shape = 'sphere' dimensions = 1 /\n" + TIME, ["2: part(1): a part belongs to"]),
    "zero quaternion": (TARGET.replace(" /", " attitude = 4*0 /") + TIME, ["1: target/attitude: seen a quaternion of length 0"]),
    "impossible inertia": (TARGET.replace(" /", " inertia = 1 1 3 3*0 /") + TIME, ["1: target/inertia: no body has this tensor"]),
    "too few dimensions": (TARGET.replace("0.1 0.1 0.3", "0.1 0.1") + TIME, ["1: target/dimensions: seen 2 values; allowed: 3 for a box"]),
    "verdict after the end": (SCENE + "&output verdict_times = 1 /", ["6: output/verdict_times: seen 1; allowed: at most end_time"]),
    "verdicts backwards": (SCENE + "&output verdict_times = 0.01 0.005 /", ["6: output/verdict_times: seen 0.01 before 0.005"]),
    "net file missing": ("&net kind = 'file' file = 'nowhere.h5' /\n" + TIME, ["1: net/file: seen 'nowhere.h5'"]),
    "mesh not there": (TARGET.replace("'box'", "'mesh'") + TIME, ["1: target/"]),
    "scene as output": (NET + TIME + "&output file = 'scene.nml' /", ["3: output/file: seen 'scene.nml', which would overwrite"]),
    "Latin-1": ((NET + TIME + "&output file = 'H\xf6he.h5' /").encode("latin-1"), ["3: a string holds a character"]),
    "zero byte": ((NET + "&time end_time = 1\0 /").encode(), ["2: a character that cannot be shown (code 0)"]),
    "UTF-16": ((NET + TIME).encode("utf-16"), ["1: a character that cannot be shown"]),
    "empty file": ("", ["nothing to move", "&time is missing"]),
    "include missing": ("&include file = 'base.nml' /\n" + NET + TIME, ["1: include/file: base.nml: there is no such file"]),
    "include itself": ("&include file = 'scene.nml' /\n" + NET + TIME, ["1: include/file: seen 'scene.nml'", "a circle"]),
    "many at once": ("&net squares = 1 mesh_lenght = x /\n&time end_time = -1 step = NaN /\nstray\n",
                     ["1: net/squares: seen 1 value", "1: net/mesh_lenght: ", "2: time/end_time: seen -1", "2: time/step: seen NaN", "3: text outside groups",
                      "1: net/mesh_length: missing", "1: net/cable_diameter: missing"]),
}

BAD_USAGE = {
    "no command": ([], "which command?"),
    "unknown command": (["rnu", "scene.nml"], "did you mean run?"),
    "scene as command": (["scene.nml"], "did you mean castnet run scene.nml?"),
    "unknown option": (["run", "scene.nml", "--ouput", "x.h5"], "did you mean --output?"),
    "option without value": (["run", "scene.nml", "--output"], "--output: needs a value"),
    "option of another command": (["check", "scene.nml", "--shard", "1/2"], "is no option of castnet check"),
    "no scene": (["run"], "needs SCENE.nml"),
    "two scenes": (["run", "scene.nml", "scene.nml"], "one argument too many"),
    "missing scene": (["run", "nowhere.nml"], "there is no such file"),
    "folder as scene": (["check", "folder"], "folder: cannot be read"),
    "no threads": (["run", "scene.nml", "--threads", "0"], "--threads: seen '0'"),
    "bad duration": (["run", "scene.nml", "--max-wall", "1h"], "--max-wall: seen '1h'"),
    "bad override": (["run", "scene.nml", "--set", "time/end_tiem=1"], "did you mean end_time?"),
    "override out of range": (["check", "scene.nml", "--set", "time/end_time=-1"], "--set: time/end_time: seen -1"),
    "output is the scene": (["run", "scene.nml", "--output", "./scene.nml"], "would overwrite the scene"),
    "output is a folder": (["run", "scene.nml", "--output", "folder/"], "a folder; allowed: a file"),
}


def snapshot(folder):
    return {p.relative_to(folder): (p.stat().st_mtime_ns, p.read_bytes() if p.is_file() else None)
            for p in sorted(folder.rglob("*"))}


def run(folder, *arguments):
    return subprocess.run([castnet, *map(str, arguments)], cwd=folder, capture_output=True, timeout=60,
                          stdin=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})


def expect(name, condition, detail=""):
    global passed, failed
    if condition:
        passed += 1
    else:
        failed += 1
        print(f"FAIL  {name}: {detail}")


def refuse(name, folder, arguments, words):
    before = snapshot(folder)
    done = run(folder, *arguments)
    said = done.stderr.decode("utf-8", "replace")
    expect(name, done.returncode == 2, f"exit code {done.returncode}\n{said}")
    expect(name, done.stdout == b"", f"printed {done.stdout[:200]!r}")
    expect(name, snapshot(folder) == before, "wrote or touched a file")
    expect(name, said.startswith("castnet: "), f"starts {said[:40]!r}")
    expect(name, "Backtrace" not in said and "At line" not in said and "rror termination" not in said, said)
    for word in words:
        expect(name, word in said, f"no {word!r} in:\n{said}")


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case, (text, words) in MALFORMED.items():
            (folder / "scene.nml").write_bytes(text if isinstance(text, bytes) else text.encode())
            for command in ("check", "run"):
                refuse(f"{command}, {case}", folder, [command, "scene.nml"], ["scene.nml:" + words[0] if words[0][0].isdigit() else words[0], *words[1:]])
        (folder / "scene.nml").write_text(SCENE)
        (folder / "folder").mkdir()
        for case, (arguments, words) in BAD_USAGE.items():
            refuse(case, folder, arguments, [words])
        good(folder)
    expect("the stack is not executable", not stack_is_executable())
    print(f"{passed} passed, {failed} failed")
    return failed > 0


def stack_is_executable():
    """By the program header PT_GNU_STACK (64-bit ELF). An internal procedure that is passed on makes it so,
    and systems that allow no such stack refuse the program."""
    text = castnet.read_bytes()
    order = "<" if text[5] == 1 else ">"
    start, = struct.unpack_from(order + "Q", text, 32)
    size, number = struct.unpack_from(order + "HH", text, 54)
    for i in range(number):
        kind, flags = struct.unpack_from(order + "II", text, start + i*size)
        if kind == 0x6474E551:
            return bool(flags & 1)
    return True


def good(folder):
    """What must succeed, and what it says on which stream."""
    before = snapshot(folder)
    for arguments, words in ((["--help"], "castnet run SCENE.nml"), (["run", "--help"], "--restart FILE"),
                             (["version"], "HDF5"), (["schema"], "mesh_length"), (["schema", "--markdown"], "| `mesh_length` |"),
                             (["check", "scene.nml"], "125 nodes, 224 cables"),
                             (["check", "scene.nml", "--effective"], "corner_cable_length = 0.0989949")):
        done = run(folder, *arguments)
        expect(" ".join(arguments), done.returncode == 0 and words in done.stdout.decode() and done.stderr == b"",
               f"exit code {done.returncode}, {done.stdout[-300:]!r}, {done.stderr!r}")
    expect("nothing written", snapshot(folder) == before)
    page = Path(__file__).resolve().parents[2] / "docs" / "scene_reference.md"
    expect("docs/scene_reference.md is what castnet schema --markdown prints",
           page.read_bytes() == run(folder, "schema", "--markdown").stdout)

    # a study, and one that is not
    (folder / "study.nml").write_text("&study scene = 'scene.nml' seeds = 3 /\n"
                                      "&vary key = 'target/angular_velocity(2)' from = 0 to = 4 count = 9 /\n")
    done = run(folder, "check", "study.nml")
    expect("study", done.returncode == 0 and b"27" in done.stdout, done.stderr.decode())
    (folder / "study.nml").write_text("&study scene = 'scene.nml' /\n&vary key = 'target/angular_velocty(2)' values = 1 /\n")
    refuse("bad study", folder, ["check", "study.nml"], ["study.nml:2: vary(1)/key: ", "did you mean angular_velocity?"])

    # every style that namelist users write
    styles = "\ufeff! Net – test\r\n&NET\r\n\tSquares(1)=2,\r\n Squares(2) = 2 mesh_length=.5D0\r\n cable_diameter = 1.E-3 /! end\r\n&TIME end_time\r\n = 1\r\n/"
    (folder / "styles.nml").write_bytes(styles.encode())
    done = run(folder, "check", "styles.nml")
    expect("styles", done.returncode == 0, done.stderr.decode())
    spaced = folder / "a folder – ü"
    spaced.mkdir()
    (spaced / "my scene.nml").write_text("&include file = '../styles.nml' /\n&time end_time = 0.01 /")
    done = run(folder, "check", f"{spaced}/my scene.nml", "--effective")
    expect("include, path with spaces and UTF-8", done.returncode == 0 and b"end_time = 0.01" in done.stdout, done.stderr.decode())

    # included keys give way to own ones, by key and by component; paths are seen from the included file
    (folder / "sub").mkdir()
    (folder / "sub" / "base.nml").write_text(
        "&target shape = 'compound' mass = 2 position = 1 2 3 /\n&part shape = 'sphere' dimensions = 1 /\n"
        "&part shape = 'sphere' dimensions = 2 position = 1 0 0 /\n&output file = 'r.h5' /\n" + TIME)
    (folder / "own.nml").write_text("&include file = 'sub/base.nml' /\n&target position(2) = 5 /\n&part shape = 'box' dimensions = 3*1 /\n")
    done = run(folder, "check", "own.nml", "--effective")
    text = done.stdout.decode()
    expect("include", done.returncode == 0 and "position = 1, 5, 3" in text and text.count("&part") == 1 and "shape = 'box'" in text
           and "mass = 2" in text and "file = 'sub/r.h5'" in text, text + done.stderr.decode())
    (folder / "sub" / "base.nml").write_text("&time end_time = -1 /")
    refuse("a problem in an included file", folder, ["check", "own.nml"], ["sub/base.nml:1: time/end_time: seen -1"])

    # the effective scene reads back to itself
    first = run(folder, "check", "scene.nml", "--effective").stdout
    (folder / "effective.nml").write_bytes(first)
    expect("round trip", run(folder, "check", "effective.nml", "--effective").stdout == first)

    # init: a scene that is sound; it does not replace what is there
    done = run(folder, "init", "fresh")
    expect("init", done.returncode == 0 and (folder / "fresh.nml").exists(), done.stderr.decode())
    expect("init's scene", run(folder, "check", "fresh.nml").returncode == 0)
    (folder / "fresh.nml").write_text("mine")
    done = run(folder, "init", "fresh.nml")
    expect("init keeps what is there", done.returncode == 4 and (folder / "fresh.nml").read_text() == "mine")
    expect("init --force", run(folder, "init", "fresh", "--force").returncode == 0)
    expect("init nowhere", run(folder, "init", "nowhere/fresh").returncode == 4)

    # a warning does not stop a run
    (folder / "through.nml").write_text(NET + TARGET + TIME)
    done = run(folder, "check", "through.nml")
    expect("warning", done.returncode == 0 and b"they pass through each other" in done.stderr, done.stderr.decode())

    # run writes beside the scene, and a file that is there is not replaced without --force
    done = run(folder, "run", "scene.nml", "--quiet")
    expect("run", done.returncode == 0 and (folder / "scene.h5").exists(), done.stderr.decode())


sys.exit(main())
