"""The same net in other codes: numba, JAX, warp, MuJoCo, scipy.

Every maker takes a net (a dictionary, see peers.net_of), a method ('rk4', 'midpoint'), a step and
a number of steps, compiles, and returns a function that flies the net and gives the last
positions. Each code is written as it is fastest here, as far as we know: where a code profits
from knowing that the net is a square lattice, it is told so; castnet finds it out by itself.
"""
import math

import numpy as np


def lattice(net):
    """Nodes per side of a square net whose first side**2 nodes are its rows."""
    side = math.isqrt(len(net["mass"]))
    rows = net["cables"][(net["cables"] < side * side).all(axis=1)]
    steps = np.unique(np.diff(rows, axis=1))
    if len(net["mass"]) != side * side + 4 or sorted(abs(steps)) != [1, side]:
        raise ValueError("no square net in rows with four bullets")
    return side


def split(net):
    """Cables of a square net along its rows, across them, and at its corners: k, c and length."""
    side = lattice(net)
    shapes = {"row": (side, side - 1), "column": (side - 1, side)}
    parts = {name: {word: np.zeros(shape) for word in ("k", "c", "length")} for name, shape in shapes.items()}
    corners = []
    for e, (i, j) in enumerate(net["cables"]):
        i, j = min(i, j), max(i, j)
        if j >= side * side:
            corners.append((i, j, net["k"][e], net["c"][e], net["length"][e]))
            continue
        part = parts["row" if j - i == 1 else "column"]
        for word in ("k", "c", "length"):
            part[word][i // side, i % side] = net[word][e]
    return side, parts["row"], parts["column"], corners


# ---------------------------------------------------------------------------------------- numba

def numba_forces(net):
    """acceleration(x, v, out, force, dampings) on arrays (3, n): tensions row by row, which LLVM vectorises, then a gather."""
    import numba
    side, row, column, corners = split(net)
    ends = np.array([c[:2] for c in corners])
    corner_k, corner_length = (np.array([c[m] for c in corners]) for m in (2, 4))
    inverse = 1.0 / net["mass"]
    k_row, l_row = row["k"].ravel(), row["length"].ravel()
    k_col, l_col = column["k"].ravel(), column["length"].ravel()

    @numba.njit(fastmath=True, error_model="numpy", inline="always")
    def cables(m, i0, j0, e0, x, v, k, c, l0, force):
        for i in range(m):
            a, b, e = i0 + i, j0 + i, e0 + i
            dx, dy, dz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
            inverse_length = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            length = (dx * dx + dy * dy + dz * dz) * inverse_length
            rate = (dx * (v[0, b] - v[0, a]) + dy * (v[1, b] - v[1, a]) + dz * (v[2, b] - v[2, a])) * inverse_length
            stretch = length - l0[e]
            pull = k[e] * stretch + c[e] * rate
            pull = pull * inverse_length if (stretch > 0.0) & (pull > 0.0) else 0.0
            force[0, i], force[1, i], force[2, i] = pull * dx, pull * dy, pull * dz

    @numba.njit(fastmath=True, error_model="numpy")
    def acceleration(x, v, out, force, dampings):
        c_row, c_col, corner_c = dampings
        out[:] = 0.0
        for r in range(side):
            a = r * side
            cables(side - 1, a, a + 1, r * (side - 1), x, v, k_row, c_row, l_row, force)
            for d in range(3):
                for i in range(side - 1):
                    out[d, a + i] += force[d, i]
                for i in range(side - 1):
                    out[d, a + 1 + i] -= force[d, i]
        for r in range(side - 1):
            a, b = r * side, (r + 1) * side
            cables(side, a, b, a, x, v, k_col, c_col, l_col, force)
            for d in range(3):
                for i in range(side):
                    out[d, a + i] += force[d, i]
                for i in range(side):
                    out[d, b + i] -= force[d, i]
        for e in range(corner_k.size):
            i, j = ends[e, 0], ends[e, 1]
            d = x[:, j] - x[:, i]
            length = math.sqrt((d * d).sum())
            if length > corner_length[e]:
                rate = (d * (v[:, j] - v[:, i])).sum() / length
                pull = max(0.0, corner_k[e] * (length - corner_length[e]) + corner_c[e] * rate) / length
                out[:, i] += pull * d
                out[:, j] -= pull * d
        for d in range(3):
            for i in range(inverse.size):
                out[d, i] *= inverse[i]
    return acceleration


def numba_steps(net):
    """rk4 and midpoint of the whole net over n steps, stage updates in one pass each. Compiled once a net."""
    import numba
    if "numba" in net["compiled"]:
        return net["compiled"]["numba"]
    acceleration = numba_forces(net)
    width = lattice(net) + 8

    @numba.njit(fastmath=True, error_model="numpy")
    def stage(x0, v0, v, a, h, x_out, v_out, sum_x, sum_v, weight):
        for d in range(3):
            for i in range(x0.shape[1]):
                sum_x[d, i] += weight * v[d, i]
                sum_v[d, i] += weight * a[d, i]
                x_out[d, i] = x0[d, i] + h * v[d, i]
                v_out[d, i] = v0[d, i] + h * a[d, i]

    @numba.njit(fastmath=True, error_model="numpy")
    def rk4(x, v, h, n, dampings):
        xa, va, xb, vb = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
        a, sum_x, sum_v = np.empty_like(x), np.empty_like(x), np.empty_like(x)
        force = np.empty((3, width))
        for _ in range(n):
            sum_x[:] = 0.0
            sum_v[:] = 0.0
            acceleration(x, v, a, force, dampings)
            stage(x, v, v, a, 0.5 * h, xa, va, sum_x, sum_v, 1.0)
            acceleration(xa, va, a, force, dampings)
            stage(x, v, va, a, 0.5 * h, xb, vb, sum_x, sum_v, 2.0)
            acceleration(xb, vb, a, force, dampings)
            stage(x, v, vb, a, h, xa, va, sum_x, sum_v, 2.0)
            acceleration(xa, va, a, force, dampings)
            for d in range(3):
                for i in range(x.shape[1]):
                    x[d, i] += h / 6.0 * (sum_x[d, i] + va[d, i])
                    v[d, i] += h / 6.0 * (sum_v[d, i] + a[d, i])

    @numba.njit(fastmath=True, error_model="numpy")
    def midpoint(x, v, h, n, dampings):
        a = np.zeros_like(x)
        ahead = v.copy()
        force = np.empty((3, width))
        for d in range(3):
            for i in range(x.shape[1]):
                x[d, i] += 0.5 * h * v[d, i]
        for _ in range(n):
            acceleration(x, ahead, a, force, dampings)
            for d in range(3):
                for i in range(x.shape[1]):
                    v[d, i] += h * a[d, i]
                    x[d, i] += h * v[d, i]
                    ahead[d, i] = v[d, i] + 0.5 * h * a[d, i]
        for d in range(3):
            for i in range(x.shape[1]):
                x[d, i] -= 0.5 * h * v[d, i]
    net["compiled"]["numba"] = rk4, midpoint
    return rk4, midpoint


def numba_dampings(net):
    _, row, column, corners = split(net)
    return row["c"].ravel(), column["c"].ravel(), np.array([corner[3] for corner in corners])


def numba_run(net, method, step, steps):
    rk4, midpoint = numba_steps(net)
    fly, dampings = rk4 if method == "rk4" else midpoint, numba_dampings(net)

    def run(count=steps):
        x, v = np.ascontiguousarray(net["x"].T), np.ascontiguousarray(net["v"].T)
        fly(x, v, step, count, dampings)
        return x.T
    fly(np.ascontiguousarray(net["x"].T), np.ascontiguousarray(net["v"].T), step, 1, dampings)
    return run


def numba_capture(net, target, step, steps):
    """rk4 with a rigid cylinder, elastic impulses node by node, and positions pushed out: a script as one writes it."""
    import numba
    rk4, _ = numba_steps(net)
    dampings = numba_dampings(net)
    mass, body_mass, inertia = net["mass"], target["mass"], target["inertia"]
    radius, half, threshold = 0.5 * target["diameter"], 0.5 * target["length"], target["threshold"]

    @numba.njit(fastmath=True, error_model="numpy")
    def rotation(q):
        w, x, y, z = q
        return np.array(((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
                         (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
                         (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))))

    @numba.njit(fastmath=True, error_model="numpy")
    def turn(q, w, h):
        """Torque-free: the midpoint rule on Euler's equations and the quaternion."""
        for _ in range(2):
            rate = np.array(((inertia[1] - inertia[2]) * w[1] * w[2] / inertia[0],
                             (inertia[2] - inertia[0]) * w[2] * w[0] / inertia[1],
                             (inertia[0] - inertia[1]) * w[0] * w[1] / inertia[2]))
            m = w + 0.25 * h * rate
            b, c, d = 0.25 * h * m
            step_q = np.array((q[0] - q[1] * b - q[2] * c - q[3] * d, q[1] + q[0] * b + q[2] * d - q[3] * c,
                               q[2] + q[0] * c + q[3] * b - q[1] * d, q[3] + q[0] * d + q[1] * c - q[2] * b))
            q[:] = step_q / math.sqrt((step_q * step_q).sum())
            w += 0.5 * h * rate

    @numba.njit(fastmath=True, error_model="numpy")
    def distance(p):
        """Signed distance from the cylinder and the outward normal, body axes."""
        n = np.zeros(3)
        across = math.sqrt(p[0] * p[0] + p[1] * p[1])
        side, end = across - radius, abs(p[2]) - half
        if side > 0.0 and end > 0.0:
            d = math.sqrt(side * side + end * end)
            n[0], n[1], n[2] = p[0] / across * side / d, p[1] / across * side / d, math.copysign(end / d, p[2])
            return d, n
        if side > end:
            n[0], n[1] = p[0] / across, p[1] / across
            return side, n
        n[2] = math.copysign(1.0, p[2])
        return end, n

    @numba.njit(fastmath=True, error_model="numpy")
    def capture(x, v, position, velocity, q, w, h, n, dampings):
        reach = math.sqrt(radius * radius + half * half) + threshold
        for _ in range(n):
            rk4(x, v, h, 1, dampings)
            position += h * velocity
            turn(q, w, h)
            r = rotation(q)
            for i in range(mass.size):
                gx, gy, gz = x[0, i] - position[0], x[1, i] - position[1], x[2, i] - position[2]
                if gx * gx + gy * gy + gz * gz > reach * reach:
                    continue
                p = np.array((r[0, 0] * gx + r[1, 0] * gy + r[2, 0] * gz, r[0, 1] * gx + r[1, 1] * gy + r[2, 1] * gz,
                              r[0, 2] * gx + r[1, 2] * gy + r[2, 2] * gz))
                d, m = distance(p)
                if d > threshold:
                    continue
                normal = np.array((r[0, 0] * m[0] + r[0, 1] * m[1] + r[0, 2] * m[2],
                                   r[1, 0] * m[0] + r[1, 1] * m[1] + r[1, 2] * m[2],
                                   r[2, 0] * m[0] + r[2, 1] * m[1] + r[2, 2] * m[2]))
                arm = np.array((p[1] * m[2] - p[2] * m[1], p[2] * m[0] - p[0] * m[2], p[0] * m[1] - p[1] * m[0]))
                speed = ((v[:, i] - velocity) * normal).sum() - (w * arm).sum()
                if speed < 0.0:
                    j = -2.0 * speed / (1.0 / mass[i] + 1.0 / body_mass + (arm * arm / inertia).sum())
                    v[:, i] += j / mass[i] * normal
                    velocity -= j / body_mass * normal
                    w -= j * arm / inertia
                if d < 0.0:
                    x[:, i] -= d * normal

    def run():
        x, v = np.ascontiguousarray(net["x"].T), np.ascontiguousarray(net["v"].T)
        position, velocity = np.array(target["position"], float), np.zeros(3)
        q, w = np.array((1.0, 0.0, 0.0, 0.0)), np.array(target["rate"], float)
        capture(x, v, position, velocity, q, w, step, steps, dampings)
        return x.T, velocity
    x, v = np.ascontiguousarray(net["x"].T), np.ascontiguousarray(net["v"].T)
    capture(x, v, np.array(target["position"], float), np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0)),
            np.array(target["rate"], float), step, 1, dampings)
    return run


# ------------------------------------------------------------------------------------------ JAX

def jax_run(net, method, step, steps):
    """The lattice as shifted slices, which XLA turns into loops without gathers."""
    import jax
    import jax.numpy as jnp
    jax.config.update("jax_enable_x64", True)
    side, row, column, corners = split(net)
    row, column = ({word: jnp.asarray(part[word]) for word in part} for part in (row, column))
    n = side * side
    at = np.array([c[0] for c in corners])
    bullet = np.array([c[1] - n for c in corners])
    k, c, l0 = (jnp.asarray(np.array([corner[m] for corner in corners])) for m in (2, 3, 4))
    grid_mass, bullet_mass = jnp.asarray(net["mass"][:n].reshape(side, side)), jnp.asarray(net["mass"][n:])

    def pull(d, dv, k, c, l0):
        length = jnp.sqrt((d * d).sum(axis=0))
        rate = (d * dv).sum(axis=0) / length
        return jnp.where(length > l0, jnp.maximum(0.0, k * (length - l0) + c * rate), 0.0) / length * d

    def acceleration(x, v):
        (g, b), (gv, bv) = x, v
        f = pull(g[:, :, 1:] - g[:, :, :-1], gv[:, :, 1:] - gv[:, :, :-1], row["k"], row["c"], row["length"])
        total = jnp.pad(f, ((0, 0), (0, 0), (0, 1))) - jnp.pad(f, ((0, 0), (0, 0), (1, 0)))
        f = pull(g[:, 1:] - g[:, :-1], gv[:, 1:] - gv[:, :-1], column["k"], column["c"], column["length"])
        total = total + jnp.pad(f, ((0, 0), (0, 1), (0, 0))) - jnp.pad(f, ((0, 0), (1, 0), (0, 0)))
        f = pull(b[:, bullet] - g[:, at // side, at % side], bv[:, bullet] - gv[:, at // side, at % side], k, c, l0)
        total = total.at[:, at // side, at % side].add(f)
        return total / grid_mass, jnp.zeros_like(b).at[:, bullet].add(-f) / bullet_mass

    def plus(x, h, v):
        return x[0] + h * v[0], x[1] + h * v[1]

    def rk4(_, s):
        x, v = s[:2]
        a1 = acceleration(x, v)
        v2 = plus(v, 0.5 * step, a1)
        a2 = acceleration(plus(x, 0.5 * step, v), v2)
        v3 = plus(v, 0.5 * step, a2)
        a3 = acceleration(plus(x, 0.5 * step, v2), v3)
        v4 = plus(v, step, a3)
        a4 = acceleration(plus(x, step, v3), v4)
        return (tuple(x[m] + step / 6 * (v[m] + 2 * v2[m] + 2 * v3[m] + v4[m]) for m in (0, 1)),
                tuple(v[m] + step / 6 * (a1[m] + 2 * a2[m] + 2 * a3[m] + a4[m]) for m in (0, 1)), s[2])

    def midpoint(_, s):
        x, v, a = s
        x = plus(x, 0.5 * step, v)
        a = acceleration(x, plus(v, 0.5 * step, a))
        v = plus(v, step, a)
        return plus(x, 0.5 * step, v), v, a

    def pair(values):
        return jnp.asarray(values[:n].T.reshape(3, side, side)), jnp.asarray(values[n:].T)
    body = rk4 if method == "rk4" else midpoint
    x, v = pair(net["x"]), pair(net["v"])
    zero = tuple(jnp.zeros_like(part) for part in x)
    whole = jax.jit(lambda count, x, v: jax.lax.fori_loop(0, count, body, (x, v, zero))[0])
    whole(1, x, v)

    def run(count=steps):
        grid, bullets = whole(count, x, v)
        return np.concatenate([np.asarray(grid).reshape(3, n).T, np.asarray(bullets).T])
    return run


# ----------------------------------------------------------------------------------------- warp

def warp_run(net, method, step, steps):
    """One kernel a stage, a thread a node over a padded list of its cables."""
    import warp as wp
    wp.config.quiet = True
    wp.init()
    n = len(net["mass"])
    entries = [[] for _ in range(n)]
    for e, (i, j) in enumerate(net["cables"]):
        entries[i].append((j, e))
        entries[j].append((i, e))
    width = max(map(len, entries))
    other = np.array([[p[0] for p in row] + [-1] * (width - len(row)) for row in entries], np.int32)
    cable = np.array([[p[1] for p in row] + [0] * (width - len(row)) for row in entries], np.int32)
    kernels = warp_kernels(width)
    vec = wp.vec3d

    def array(values, kind):
        return wp.array(values, dtype=kind, device="cpu")
    other, cable = array(other, wp.int32), array(cable, wp.int32)
    k, c, l0 = (array(net[word], wp.float64) for word in ("k", "c", "length"))
    inverse = array(1.0 / net["mass"], wp.float64)
    xa, va, xb, vb, sx, sv = (array(np.zeros((n, 3)), vec) for _ in range(6))

    def launch(kernel, *arguments):
        wp.launch(kernel, dim=n, inputs=[other, cable, k, c, l0, inverse, *arguments], device="cpu")

    def run(count=steps):
        x, v = array(net["x"], vec), array(net["v"], vec)
        if method == "rk4":
            for _ in range(count):
                launch(kernels["first"], wp.float64(0.5 * step), x, v, xa, va, sx, sv)
                launch(kernels["middle"], wp.float64(0.5 * step), xa, va, x, v, xb, vb, sx, sv)
                launch(kernels["middle"], wp.float64(step), xb, vb, x, v, xa, va, sx, sv)
                launch(kernels["last"], wp.float64(step / 6), xa, va, x, v, sx, sv)
            return x.numpy()
        now, after = array(net["x"] + 0.5 * step * net["v"], vec), xb
        ahead, later = array(net["v"], vec), vb
        for _ in range(count):
            launch(kernels["kick"], wp.float64(step), now, ahead, v, after, later)
            now, after, ahead, later = after, now, later, ahead
        return now.numpy() - 0.5 * step * v.numpy()
    run(1)
    return run


def warp_kernels(width):
    import warp as wp
    count = wp.constant(width)

    @wp.func
    def acceleration(i: int, other: wp.array2d(dtype=wp.int32), cable: wp.array2d(dtype=wp.int32), k: wp.array(dtype=wp.float64),
                     c: wp.array(dtype=wp.float64), l0: wp.array(dtype=wp.float64), inverse: wp.array(dtype=wp.float64),
                     x: wp.array(dtype=wp.vec3d), v: wp.array(dtype=wp.vec3d)):
        force = wp.vec3d()
        for m in range(count):
            j = other[i, m]
            if j >= 0:
                e = cable[i, m]
                d = x[j] - x[i]
                length = wp.length(d)
                if length > l0[e]:
                    rate = wp.dot(d, v[j] - v[i]) / length
                    force += wp.max(wp.float64(0.0), k[e] * (length - l0[e]) + c[e] * rate) / length * d
        return inverse[i] * force

    @wp.kernel(enable_backward=False)
    def first(other: wp.array2d(dtype=wp.int32), cable: wp.array2d(dtype=wp.int32), k: wp.array(dtype=wp.float64),
              c: wp.array(dtype=wp.float64), l0: wp.array(dtype=wp.float64), inverse: wp.array(dtype=wp.float64), h: wp.float64,
              x: wp.array(dtype=wp.vec3d), v: wp.array(dtype=wp.vec3d), x_out: wp.array(dtype=wp.vec3d),
              v_out: wp.array(dtype=wp.vec3d), sx: wp.array(dtype=wp.vec3d), sv: wp.array(dtype=wp.vec3d)):
        i = wp.tid()
        a = acceleration(i, other, cable, k, c, l0, inverse, x, v)
        sx[i] = v[i]
        sv[i] = a
        x_out[i] = x[i] + h * v[i]
        v_out[i] = v[i] + h * a

    @wp.kernel(enable_backward=False)
    def middle(other: wp.array2d(dtype=wp.int32), cable: wp.array2d(dtype=wp.int32), k: wp.array(dtype=wp.float64),
               c: wp.array(dtype=wp.float64), l0: wp.array(dtype=wp.float64), inverse: wp.array(dtype=wp.float64), h: wp.float64,
               x: wp.array(dtype=wp.vec3d), v: wp.array(dtype=wp.vec3d), x0: wp.array(dtype=wp.vec3d),
               v0: wp.array(dtype=wp.vec3d), x_out: wp.array(dtype=wp.vec3d), v_out: wp.array(dtype=wp.vec3d),
               sx: wp.array(dtype=wp.vec3d), sv: wp.array(dtype=wp.vec3d)):
        i = wp.tid()
        a = acceleration(i, other, cable, k, c, l0, inverse, x, v)
        sx[i] = sx[i] + wp.float64(2.0) * v[i]
        sv[i] = sv[i] + wp.float64(2.0) * a
        x_out[i] = x0[i] + h * v[i]
        v_out[i] = v0[i] + h * a

    @wp.kernel(enable_backward=False)
    def last(other: wp.array2d(dtype=wp.int32), cable: wp.array2d(dtype=wp.int32), k: wp.array(dtype=wp.float64),
             c: wp.array(dtype=wp.float64), l0: wp.array(dtype=wp.float64), inverse: wp.array(dtype=wp.float64), h: wp.float64,
             x: wp.array(dtype=wp.vec3d), v: wp.array(dtype=wp.vec3d), x0: wp.array(dtype=wp.vec3d),
             v0: wp.array(dtype=wp.vec3d), sx: wp.array(dtype=wp.vec3d), sv: wp.array(dtype=wp.vec3d)):
        i = wp.tid()
        a = acceleration(i, other, cable, k, c, l0, inverse, x, v)
        x0[i] = x0[i] + h * (sx[i] + v[i])
        v0[i] = v0[i] + h * (sv[i] + a)

    @wp.kernel(enable_backward=False)
    def kick(other: wp.array2d(dtype=wp.int32), cable: wp.array2d(dtype=wp.int32), k: wp.array(dtype=wp.float64),
             c: wp.array(dtype=wp.float64), l0: wp.array(dtype=wp.float64), inverse: wp.array(dtype=wp.float64), h: wp.float64,
             x: wp.array(dtype=wp.vec3d), v: wp.array(dtype=wp.vec3d), v0: wp.array(dtype=wp.vec3d),
             x_out: wp.array(dtype=wp.vec3d), v_out: wp.array(dtype=wp.vec3d)):
        i = wp.tid()
        a = acceleration(i, other, cable, k, c, l0, inverse, x, v)
        v0[i] = v0[i] + h * a
        x_out[i] = x[i] + h * v0[i]
        v_out[i] = v0[i] + wp.float64(0.5) * h * a
    return {"first": first, "middle": middle, "last": last, "kick": kick}


# --------------------------------------------------------------------------------------- MuJoCo

def mujoco_model(net, step, target=None):
    """Nodes on three slides, cables as spatial tendons. Their dampers act in slack too: MuJoCo has no other."""
    import mujoco

    def words(values):
        return " ".join(repr(float(value)) for value in values)
    flags = 'constraint="disable"' if target is None else ""
    text = [f'<mujoco><option timestep="{step!r}" gravity="0 0 0" integrator="Euler" jacobian="sparse">'
            f'<flag eulerdamp="disable" {flags}/></option><default><geom contype="0" conaffinity="0" condim="1"/></default>'
            '<worldbody>']
    sphere = ""
    if target is not None:
        # Springs without loss at the contact surface, stiff enough to stop a bullet within the threshold.
        stiffness = (net["speed"] / target["threshold"]) ** 2
        text.append(f'<body pos="{words(target["position"])}"><freejoint/><inertial pos="0 0 0" mass="{target["mass"]!r}" '
                    f'diaginertia="{words(target["inertia"])}"/><geom type="cylinder" size="{0.5 * target["diameter"]!r} '
                    f'{0.5 * target["length"]!r}" contype="1" conaffinity="2" solref="-{stiffness!r} 0"/></body>')
        sphere = (f'<geom type="sphere" size="{target["threshold"]!r}" mass="0" contype="2" conaffinity="1" '
                  f'solref="-{stiffness!r} 0"/>')
    for i, (place, mass) in enumerate(zip(net["x"], net["mass"])):
        text.append(f'<body pos="{words(place)}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
                    f'<joint type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="{float(mass)!r}" '
                    f'diaginertia="1e-6 1e-6 1e-6"/>{sphere}<site name="n{i}"/></body>')
    text.append("</worldbody><tendon>")
    for (i, j), k, c, l0 in zip(net["cables"], net["k"], net["c"], net["length"]):
        text.append(f'<spatial springlength="0 {float(l0)!r}" stiffness="{float(k)!r}" damping="{float(c)!r}">'
                    f'<site site="n{i}"/><site site="n{j}"/></spatial>')
    text.append("</tendon></mujoco>")
    return mujoco.MjModel.from_xml_string("".join(text))


def mujoco_run(net, _, step, steps):
    import mujoco
    model = mujoco_model(net, step)

    def run(count=steps):
        data = mujoco.MjData(model)
        data.qvel[:] = net["v"].ravel()
        mujoco.mj_step(model, data, count)
        return net["x"] + data.qpos.reshape(-1, 3)
    return run


def mujoco_capture(net, target, step, steps):
    import mujoco
    model = mujoco_model(net, step, target)

    def run():
        data = mujoco.MjData(model)
        data.qvel[6:] = net["v"].ravel()
        data.qvel[3:6] = target["rate"]
        mujoco.mj_step(model, data, steps)
        return net["x"] + data.qpos[7:].reshape(-1, 3), data.qvel[:3].copy()
    return run


# ---------------------------------------------------------------------------------------- scipy

def scipy_run(net, _, tolerance, end):
    """solve_ivp, DOP853, on whole-array numpy."""
    from scipy.integrate import solve_ivp
    a, b = net["cables"].T
    n = len(net["mass"])
    shape = net["x"].shape

    def rate(_, y):
        x, v = y.reshape(2, *shape)
        d = x[b] - x[a]
        length = np.sqrt((d * d).sum(axis=1))
        stretch = length - net["length"]
        closing = ((v[b] - v[a]) * d).sum(axis=1) / length
        pull = np.where(stretch > 0, np.maximum(0, net["k"] * stretch + net["c"] * closing), 0) / length
        force = pull[:, None] * d
        total = np.stack([np.bincount(a, force[:, m], n) - np.bincount(b, force[:, m], n) for m in range(3)], axis=1)
        return np.concatenate([v.ravel(), (total / net["mass"][:, None]).ravel()])

    def run():
        y = solve_ivp(rate, (0, end), np.concatenate([net["x"].ravel(), net["v"].ravel()]), method="DOP853", rtol=tolerance,
                      atol=tolerance * 1e-2).y[:, -1]
        return y.reshape(2, *shape)[0]
    return run
