#!/usr/bin/env python3
"""castnet and peers on the same net: time of a run against its error, in one figure.

    pip install -r tools/bench/requirements-bench.txt
    tools/bench/peers.py CASTNET [--rounds 5] [-o docs/work_precision.png]

The rocket net of the paper's Table 2 flies without a target for END seconds. Every code
starts from the positions, masses, stiffnesses and dampings that castnet writes. Codes take
turns (interleaved), times are medians of processor time on one thread without the time to
compile; errors are the farthest bullet's distance from castnet's rk4 at 2e-5 s. END lies
before the horizon of chaos (castnet accuracy: about 0.6 s), so that an error is one.
"""
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", NUMBA_NUM_THREADS="1",
                  XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
import argparse
import statistics
import subprocess
import tempfile
import time

import h5py
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
SCENE = os.path.join(ROOT, "input", "deployment_rocket.nml")
END = 0.5
COLOURS = {"castnet": "#c0561c", "C on a grid": "0.3", "numba": "#1f5a92", "jax": "#2d7d46", "mujoco": "#7a3b8f", "scipy": "#8a6d1a"}


def castnet(program, method, step, folder):
    """Seconds of the run proper, final positions, and the net."""
    out = os.path.join(folder, "run.h5")
    subprocess.run([program, "run", SCENE, "--output", out, "--force", "--quiet", "--set", f"time/method={method}", "--set",
                    f"time/step={step!r}", "--set", f"time/end_time={END}", "--set", f"output/frame_interval={END}", "--set",
                    f"output/history_interval={END}", "--set", f"output/verdict_times={END}", "--set", "output/vtk=.false."],
                   check=True)
    with h5py.File(out, "r") as data:
        static = data["static"]
        net = {"x": data["node_position"][0], "v": data["node_velocity"][0], "mass": static["node_mass"][:],
               "cables": static["cable_nodes"][:].astype(int), "length": static["natural_length"][:],
               "k": static["axial_stiffness"][:] / static["natural_length"][:], "bullets": static["bullet_nodes"][:].astype(int)}
        return float(data["summary/wall_time"][()]), data["node_position"][-1], net


def add_damping(net, ratio=0.1):
    mass, cables = net["mass"], net["cables"]
    reduced = 1.0 / (1.0 / mass[cables[:, 0]] + 1.0 / mass[cables[:, 1]])
    net["c"] = 2.0 * ratio * np.sqrt(net["k"] * reduced)


def numpy_acceleration(net):
    a, b = net["cables"].T
    n = len(net["mass"])

    def acceleration(x, v):
        d = x[b] - x[a]
        length = np.sqrt((d * d).sum(axis=1))
        u = d / length[:, None]
        stretch = length - net["length"]
        pull = np.where(stretch > 0, np.maximum(0, net["k"] * stretch + net["c"] * ((v[b] - v[a]) * u).sum(axis=1)), 0)
        force = pull[:, None] * u
        total = np.stack([np.bincount(a, force[:, i], n) - np.bincount(b, force[:, i], n) for i in range(3)], axis=1)
        return total / net["mass"][:, None]
    return acceleration


def scipy_run(net, tolerance):
    from scipy.integrate import solve_ivp
    acceleration = numpy_acceleration(net)
    shape = net["x"].shape

    def rate(_, y):
        x, v = y.reshape(2, *shape)
        return np.concatenate([v.ravel(), acceleration(x, v).ravel()])

    def run():
        y = solve_ivp(rate, (0, END), np.concatenate([net["x"].ravel(), net["v"].ravel()]), method="DOP853", rtol=tolerance,
                      atol=tolerance * 1e-2).y[:, -1]
        return y.reshape(2, *shape)[0]
    return run


def numba_run(net, method, step):
    import numba
    a, b = (np.ascontiguousarray(net["cables"][:, i]) for i in range(2))
    k, c, l0, mass = net["k"], net["c"], net["length"], net["mass"]

    @numba.njit(fastmath=True)
    def acceleration(x, v, out):
        out[:] = 0.0
        for e in range(a.size):
            i, j = a[e], b[e]
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            if length > l0[e]:
                rate = (dx * (v[j, 0] - v[i, 0]) + dy * (v[j, 1] - v[i, 1]) + dz * (v[j, 2] - v[i, 2])) / length
                pull = max(0.0, k[e] * (length - l0[e]) + c[e] * rate) / length
                out[i, 0] += pull * dx; out[i, 1] += pull * dy; out[i, 2] += pull * dz
                out[j, 0] -= pull * dx; out[j, 1] -= pull * dy; out[j, 2] -= pull * dz
        for i in range(mass.size):
            for m in range(3):
                out[i, m] /= mass[i]

    @numba.njit(fastmath=True)
    def rk4(x, v, h, n):
        a1, a2, a3, a4 = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
        for _ in range(n):
            acceleration(x, v, a1)
            v2 = v + 0.5 * h * a1
            acceleration(x + 0.5 * h * v, v2, a2)
            v3 = v + 0.5 * h * a2
            acceleration(x + 0.5 * h * v2, v3, a3)
            v4 = v + h * a3
            acceleration(x + h * v3, v4, a4)
            x += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    @numba.njit(fastmath=True)
    def midpoint(x, v, h, n):
        acc = np.zeros_like(x)
        for _ in range(n):
            x += 0.5 * h * v
            ahead = v + 0.5 * h * acc
            acceleration(x, ahead, acc)
            v += h * acc
            x += 0.5 * h * v
    steps = round(END / step)

    def run():
        x, v = net["x"].copy(), net["v"].copy()
        (rk4 if method == "rk4" else midpoint)(x, v, END / steps, steps)
        return x
    return run


def jax_run(net, method, step):
    import jax
    import jax.numpy as jnp
    jax.config.update("jax_enable_x64", True)
    n = len(net["mass"])
    a, b = (jnp.asarray(net["cables"][:, i]) for i in range(2))
    k, c, l0, mass = (jnp.asarray(net[name]) for name in ("k", "c", "length", "mass"))
    # a padded list of every node's cables: a gather is faster than a scatter here
    entries = [[] for _ in range(n)]
    for e, (i, j) in enumerate(net["cables"]):
        entries[i].append((e, 1.0))
        entries[j].append((e, -1.0))
    width = max(map(len, entries))
    index = jnp.asarray([[p[0] for p in row] + [0] * (width - len(row)) for row in entries])
    sign = jnp.asarray([[p[1] for p in row] + [0.0] * (width - len(row)) for row in entries])[:, :, None]

    def acceleration(x, v):
        d = x[b] - x[a]
        length = jnp.sqrt((d * d).sum(axis=1))
        rate = (d * (v[b] - v[a])).sum(axis=1) / length
        stretch = length - l0
        pull = jnp.where(stretch > 0, jnp.maximum(0, k * stretch + c * rate), 0) / length
        return (sign * (pull[:, None] * d)[index]).sum(axis=1) / mass[:, None]
    steps = round(END / step)
    h = END / steps

    def rk4(_, s):
        x, v = s[:2]
        a1 = acceleration(x, v)
        v2 = v + 0.5 * h * a1
        a2 = acceleration(x + 0.5 * h * v, v2)
        v3 = v + 0.5 * h * a2
        a3 = acceleration(x + 0.5 * h * v2, v3)
        v4 = v + h * a3
        a4 = acceleration(x + h * v3, v4)
        return x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), s[2]

    def midpoint(_, s):
        x, v, acc = s
        x = x + 0.5 * h * v
        acc = acceleration(x, v + 0.5 * h * acc)
        v = v + h * acc
        return x + 0.5 * h * v, v, acc
    body = rk4 if method == "rk4" else midpoint
    whole = jax.jit(lambda x, v: jax.lax.fori_loop(0, steps, body, (x, v, jnp.zeros_like(x)))[0])
    x, v = jnp.asarray(net["x"]), jnp.asarray(net["v"])
    return lambda: np.asarray(whole(x, v))


def mujoco_run(net, step):
    """Nodes on three slides, cables as spatial tendons. Their dampers act in slack too: MuJoCo has no other."""
    import mujoco
    text = [f'<mujoco><option timestep="{step!r}" gravity="0 0 0" integrator="Euler"><flag contact="disable" '
            'constraint="disable" eulerdamp="disable"/></option><worldbody>']
    for i, (place, mass) in enumerate(zip(net["x"], net["mass"])):
        text.append(f'<body pos="{place[0]!r} {place[1]!r} {place[2]!r}">'.replace("np.float64(", "").replace(")", "")
                    + '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>'
                    f'<inertial pos="0 0 0" mass="{float(mass)!r}" diaginertia="1e-6 1e-6 1e-6"/><site name="n{i}"/></body>')
    text.append("</worldbody><tendon>")
    for (i, j), k, c, l0 in zip(net["cables"], net["k"], net["c"], net["length"]):
        text.append(f'<spatial springlength="0 {float(l0)!r}" stiffness="{float(k)!r}" damping="{float(c)!r}">'
                    f'<site site="n{i}"/><site site="n{j}"/></spatial>')
    text.append("</tendon></mujoco>")
    model = mujoco.MjModel.from_xml_string("".join(text))

    def run():
        data = mujoco.MjData(model)
        data.qvel[:] = net["v"].ravel()
        for _ in range(round(END / step)):
            mujoco.mj_step(model, data)
        return net["x"] + data.qpos.reshape(-1, 3)
    return run


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("castnet")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", default=os.path.join(ROOT, "docs", "work_precision.png"))
    arguments = parser.parse_args()
    program = os.path.abspath(arguments.castnet)
    with tempfile.TemporaryDirectory() as folder:
        _, reference, net = castnet(program, "rk4", 2e-5, folder)
        add_damping(net)
        runs = {}
        for method, steps in (("rk4", (2.5e-3, 1e-3, 2.5e-4, 1e-4)), ("midpoint", (1.25e-3, 5e-4, 2.5e-4, 1e-4))):
            for step in steps:
                runs["castnet", method, step] = lambda m=method, s=step: castnet(program, m, s, folder)[:2]
        makers = {
            "numba": lambda: {("numba", m, s): numba_run(net, m, s) for m, s in (("rk4", 1e-3), ("rk4", 2.5e-4), ("midpoint", 1.25e-3),
                                                                                   ("midpoint", 2.5e-4))},
            "jax": lambda: {("jax", m, s): jax_run(net, m, s) for m, s in (("rk4", 1e-3), ("rk4", 2.5e-4), ("midpoint", 1.25e-3),
                                                                               ("midpoint", 2.5e-4))},
            "mujoco": lambda: {("mujoco", "tendons", s): mujoco_run(net, s) for s in (1e-3, 5e-4)},
            "scipy": lambda: {("scipy", "DOP853", s): scipy_run(net, s) for s in (1e-5, 1e-8)},
        }
        for name, make in makers.items():
            try:
                peer = make()
                for run in peer.values():
                    run()  # compiles
                runs.update(peer)
            except ImportError as problem:
                print(f"{name} is left out: {problem}")
        times = {key: [] for key in runs}
        error = {}
        for _ in range(arguments.rounds):
            for key, run in runs.items():
                began = time.process_time()
                result = run()
                took = time.process_time() - began
                if key[0] == "castnet":
                    took, result = result
                times[key].append(took)
                error[key] = float(np.linalg.norm((result - reference)[net["bullets"]], axis=1).max())
    median = {key: statistics.median(values) for key, values in times.items()}
    print(f"{'code':9} {'method':9} {'step':>9} {'seconds':>10} {'error, m':>10}")
    for key in runs:
        print(f"{key[0]:9} {key[1]:9} {key[2]:9.3g} {median[key]:10.5f} {error[key]:10.2e}")
    figure, axis = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for code, method in dict.fromkeys(key[:2] for key in runs):
        chosen = [key for key in runs if key[:2] == (code, method)]
        axis.plot([median[key] for key in chosen], [error[key] for key in chosen], marker="s" if method == "midpoint" else "o",
                  linestyle="--" if method == "midpoint" else "-", color=COLOURS[code], label=f"{code}, {method}")
    axis.set(xscale="log", yscale="log", xlabel=f"time of a run of {END} s, s (one core)", ylabel="error of the bullets, m")
    axis.grid(alpha=0.25)
    axis.legend(fontsize="x-small", ncols=2)
    figure.savefig(arguments.output, dpi=160)
    print(arguments.output)


if __name__ == "__main__":
    main()
