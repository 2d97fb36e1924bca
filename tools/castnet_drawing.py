"""Draw a net and a target in 3-D on a matplotlib axis, without a display or OpenGL.

Perspective by hand and the painter's algorithm: the target's surface is cut into
small triangles, each cable into short pieces, and all of them are drawn from back to
front, so that a net round a body is hidden and seen as it would be. Also the shared
colours and the plain line panels.
"""
from __future__ import annotations

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import PolyCollection  # noqa: E402
from matplotlib.colors import LogNorm, to_rgb  # noqa: E402
from scipy.spatial import cKDTree  # noqa: E402

from castnet_reader import Run, rotation  # noqa: E402

BULLET_COLOURS = ("#c0392b", "#2471a3", "#1e8449", "#9a6a00")
AXIS_COLOURS = ("#c0392b", "#1e8449", "#2471a3")
SLACK = np.array(to_rgb("#2b5c8a"))
SOLID = np.array(to_rgb("#d9b26a"))
PAPER = np.array(to_rgb("#ffffff"))
LIGHTS = ((np.array([-0.55, -0.5, 0.67]), 0.55), (np.array([0.6, -0.7, -0.1]), 0.18))

plt.rcParams.update({
    "font.size": 8.5, "axes.titlesize": 9, "axes.labelsize": 8.5, "legend.fontsize": 7.5,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#e3e3e3", "grid.linewidth": 0.6, "lines.linewidth": 1.2,
    "legend.frameon": False, "figure.dpi": 120, "savefig.dpi": 120,
})


def tension_colours(tension: np.ndarray, largest: float) -> np.ndarray:
    """Slack cables blue; taut ones from orange to dark red over three decades of tension."""
    colour = np.tile(SLACK, (len(tension), 1))
    floor = max(largest, 1e-30) * 1e-3
    taut = tension > floor
    if taut.any():
        strength = np.log10(np.clip(tension[taut] / floor, 1, None)) / 3
        colour[taut] = plt.get_cmap("YlOrRd")(0.35 + 0.6 * np.clip(strength, 0, 1))[:, :3]
    return colour


class Camera:
    """A perspective camera that looks at `centre` from a direction and fits a radius."""

    def __init__(self, centre, radius, azimuth=-62.0, elevation=22.0, distance=4.5):
        a, e = np.radians([azimuth, elevation])
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        self.axes = np.array([right, np.cross(back, right), back])
        self.centre, self.radius, self.distance = np.asarray(centre, float), float(radius), distance
        self.eye = self.centre + back * self.distance * self.radius
        self.window = (np.array([-1.02, -1.02]), np.array([1.02, 1.02]))

    @classmethod
    def fitting(cls, cloud, **angles) -> Camera:
        """The camera that shows all of a cloud of points (n, 3)."""
        middle = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
        camera = cls(middle, np.linalg.norm(cloud - middle, axis=1).max(), **angles)
        picture, _ = camera.project(cloud)
        camera.window = picture.min(axis=0) - 0.07, picture.max(axis=0) + 0.07
        return camera

    def project(self, points):
        """Picture coordinates (..., 2), the fitted sphere near |1|, and depth (larger = nearer)."""
        local = (np.asarray(points, float) - self.centre) @ self.axes.T / self.radius
        scale = self.distance / np.maximum(self.distance - local[..., 2], 0.2)
        return local[..., :2] * scale[..., None], local[..., 2]


def refine(points, corners, largest):
    """Triangles (n, 3, 3), halved until no edge is longer than `largest`."""
    triangles = points[corners]
    for _ in range(12):
        sides = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        longest = sides.argmax(axis=1)
        split = sides.max(axis=1) > largest
        if not split.any():
            break
        rows = np.arange(len(triangles))[split]
        a, b, c = (triangles[rows, (longest[split] + k) % 3] for k in range(3))
        middle = (a + b) / 2
        triangles = np.concatenate([
            triangles[~split], np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        ])
    return triangles


def creases(points, corners):
    """Edges (n, 2, 3) at which the surface turns by more than 35 degrees."""
    triangles = points[corners]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    edges = {}
    for number, triangle in enumerate(np.round(triangles, 9)):
        keys = [tuple(point) for point in triangle]
        for i in range(3):
            edges.setdefault(frozenset((keys[i], keys[(i + 1) % 3])), []).append(number)
    sharp = [
        sorted(edge) for edge, sides in edges.items()
        if len(edge) == 2 and (len(sides) != 2 or normals[sides[0]] @ normals[sides[1]] < 0.82)
    ]
    return np.array(sharp).reshape(-1, 2, 3)


class Scene3D:
    """What one run looks like; draws any frame of it."""

    def __init__(self, run: Run):
        self.run = run
        self.solid = run.target_solid
        self.largest_tension = 0.0
        if run.has_net and "cable_tension" in run.data and run.data.sizes.get("cable", 0):
            # The snap of the opening net would leave everything after it colourless.
            self.largest_tension = float(np.quantile(run.data["cable_tension"].values.max(axis=1), 0.9))
        if self.solid is not None:
            self.target_radius = float(np.linalg.norm(self.solid[0], axis=1).max())
            self.triangles = refine(*self.solid, self.target_radius / 12)
            self.normals = np.cross(self.triangles[:, 1] - self.triangles[:, 0], self.triangles[:, 2] - self.triangles[:, 0])
            self.normals /= np.maximum(np.linalg.norm(self.normals, axis=1), 1e-300)[:, None]
            self.nearest = cKDTree(self.triangles.mean(axis=1))
            self.creases = creases(*self.solid)

    def cloud(self, frame: int, close_up=False) -> np.ndarray:
        """All points of a frame (n, 3), or those of the target and of the net near it."""
        data, clouds = self.run.data, []
        if self.run.has_net:
            clouds.append(data["node_position"].values[frame])
        if self.solid is not None:
            centre = data["target_position"].values[frame]
            if close_up:
                near = 2.2 * self.target_radius
                clouds = [c[np.linalg.norm(c - centre, axis=1) < near] for c in clouds]
            clouds.append(self.triangles.reshape(-1, 3) @ rotation(data["target_attitude"].values[frame]).T + centre)
        return np.concatenate(clouds)

    def camera(self, frame: int, close_up=False, **angles) -> Camera:
        """A camera that fits the frame's cloud."""
        return Camera.fitting(self.cloud(frame, close_up), **angles)

    def draw(self, axis, frame: int, camera: Camera | None = None, *, width=0.9) -> Camera:
        """Draw one frame; returns the camera."""
        run, data = self.run, self.run.data
        camera = camera or self.camera(frame)
        primitives = []  # (depth, polygon in the picture, face colour, edge colour, line width)
        if self.solid is not None:
            self._add_target(primitives, camera, data["target_position"].values[frame],
                             rotation(data["target_attitude"].values[frame]))
        if run.has_net:
            self._add_net(primitives, camera, frame, width)
        order = np.argsort([p[0] for p in primitives], kind="stable")
        chosen = [primitives[i] for i in order]
        axis.add_collection(PolyCollection(
            [p[1] for p in chosen], facecolors=[p[2] for p in chosen], edgecolors=[p[3] for p in chosen],
            linewidths=[p[4] for p in chosen], capstyle="round", joinstyle="round"))
        low, high = camera.window
        # Widen the window to the shape of the axes, so that one unit is one unit both ways.
        place, (wide, tall) = axis.get_position(), axis.figure.get_size_inches()
        shape = place.width * wide / (place.height * tall)
        middle, size = (low + high) / 2, high - low
        size = np.array([max(size[0], size[1] * shape), max(size[1], size[0] / shape)])
        axis.set(xlim=middle[0] + size[0] * np.array([-0.5, 0.5]), ylim=middle[1] + size[1] * np.array([-0.5, 0.5]),
                 xticks=[], yticks=[])
        axis.grid(False)
        for spine in axis.spines.values():
            spine.set_visible(False)
        return camera

    def _add_target(self, primitives, camera, position, attitude):
        world = self.triangles @ attitude.T + position
        normal = self.normals @ attitude.T
        middle = world.mean(axis=1)
        facing = np.einsum("ij,ij->i", normal, camera.eye - middle) > 0
        light = 0.52 + sum(power * np.clip(normal @ (way / np.linalg.norm(way)), 0, 1) for way, power in LIGHTS)
        picture, depth = camera.project(world)
        depth = depth.mean(axis=1)
        for i in np.flatnonzero(facing):
            colour = np.clip(SOLID * light[i], 0, 1)
            primitives.append((depth[i], picture[i], colour, colour, 0.9))
        if len(self.creases):
            pieces = np.linspace(0, 1, 13)[:, None, None]
            line = self.creases[:, 0] * (1 - pieces) + self.creases[:, 1] * pieces
            picture, depth = camera.project(line @ attitude.T + position)
            for k in range(len(pieces) - 1):
                for i in range(len(self.creases)):
                    primitives.append((depth[k:k + 2, i].mean() + 0.9 * self.bias(camera), picture[k:k + 2, i],
                                       "none", (0.25, 0.2, 0.1), 0.7))

    def bias(self, camera):
        """Depth by which a cable on a surface is preferred to that surface's triangles."""
        return 0.06 * self.target_radius / camera.radius if self.solid is not None else 0.0

    def _near_target(self, camera, points, depth, frame):
        """Depths at which cable pieces are drawn, and which lie close to the target.

        With contact at the nodes alone a cable cuts the body's corners. A piece just under
        a face that looks at the camera is drawn on that face, so that one sees where the net lies."""
        if self.solid is None:
            return depth, np.zeros(len(points), bool)
        attitude = rotation(self.run.data["target_attitude"].values[frame])
        position = self.run.data["target_position"].values[frame]
        away, triangle = self.nearest.query((points - position) @ attitude)
        centre = self.triangles[triangle].mean(axis=1) @ attitude.T + position
        normal = self.normals[triangle] @ attitude.T
        under = (np.einsum("ij,ij->i", points - centre, normal) <= 0) & (away < 0.5 * self.target_radius)
        faces = np.einsum("ij,ij->i", normal, camera.eye - centre) > 0
        _, surface = camera.project(centre)
        raised = np.where(under & faces, np.maximum(depth, surface + 0.5 * self.bias(camera)), depth)
        return raised, under | (away < 0.25 * self.target_radius)

    def _add_net(self, primitives, camera, frame, width):
        run, data = self.run, self.run.data
        position = data["node_position"].values[frame]
        bias = self.bias(camera)
        for face in np.asarray(run.static.get("faces", np.empty((0, 4))), int):
            picture, depth = camera.project(position[face])
            primitives.append((depth.mean() - bias, picture, (*SLACK, 0.06), "none", 0.0))
        if len(run.cables):
            tension = data["cable_tension"].values[frame] if "cable_tension" in data else np.zeros(len(run.cables))
            colour = tension_colours(tension, self.largest_tension)
            pieces = np.linspace(0, 1, 7)[:, None, None]
            ends = position[run.cables]
            world = ends[:, 0] * (1 - pieces) + ends[:, 1] * pieces
            picture, depth = camera.project(world)
            stiff = np.asarray(run.static.get("axial_stiffness", np.ones(len(run.cables))), float)
            thick = width * np.where(stiff > 2 * np.median(stiff), 1.7, 1.0)
            if self.solid is not None:
                # What the body hides shines through a little.
                for line in picture.transpose(1, 0, 2):
                    primitives.append((np.inf, line[[0, -1]], "none", (*(SLACK * 0.7), 0.16), 0.5 * width))
            for k in range(len(pieces) - 1):
                middle = depth[k:k + 2].mean(axis=0)
                fade = np.clip(0.45 - 0.35 * middle, 0.0, 0.6)[:, None]
                shade = colour * (1 - fade) + PAPER * fade
                place, near = self._near_target(camera, world[k:k + 2].mean(axis=0), middle, frame)
                for i in range(len(run.cables)):
                    line = picture[k:k + 2, i]
                    if not near[i]:
                        # A pale rim, a little behind, so that a nearer cable is seen to cross a farther one.
                        primitives.append((place[i] + bias - 0.05, line, "none", (1, 1, 1, 0.8), thick[i] + 1.6))
                    primitives.append((place[i] + bias, line, "none", shade[i], thick[i]))
        if len(run.bullets):
            picture, depth = camera.project(position[run.bullets])
            turn = np.linspace(0, 2 * np.pi, 17)
            for i in range(len(run.bullets)):
                size = 0.026 * camera.distance / (camera.distance - depth[i])
                circle = picture[i] + size * np.column_stack([np.cos(turn), np.sin(turn)])
                primitives.append((depth[i] + bias + 0.01, circle, BULLET_COLOURS[i % 4], "white", 0.6))


def scale_bar(axis, camera: Camera) -> None:
    """A bar of a round length at the depth of the picture's centre, in the lower right corner."""
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    target = 0.3 * (right - left) * camera.radius
    power = 10 ** np.floor(np.log10(target))
    length = power * max(k for k in (1, 2, 5) if k * power <= target)
    end, y = right - 0.03 * (right - left), bottom + 0.03 * (top - bottom)
    axis.plot([end - length / camera.radius, end], [y, y], color="0.25", linewidth=1.4, solid_capstyle="butt")
    words = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
    axis.text(end - length / camera.radius / 2, y + 0.012 * (top - bottom), words, ha="center", va="bottom",
              fontsize=7, color="0.25")


def tension_legend(figure, place, largest: float) -> None:
    """The colour bar that belongs to tension_colours."""
    axis = figure.add_axes(place)
    table = plt.get_cmap("YlOrRd")(np.linspace(0.35, 0.95, 128))
    map_ = matplotlib.colors.ListedColormap(table)
    bar = figure.colorbar(plt.cm.ScalarMappable(LogNorm(largest * 1e-3, largest), map_), cax=axis, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_label("cable tension [N]; blue: slack or less", fontsize=7.5)
    axis.tick_params(labelsize=7)


def mark_contact(axis, run: Run) -> None:
    """A thin line at the first contact."""
    if np.isfinite(run.first_contact):
        axis.axvline(run.first_contact, color="0.55", linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)


def plot_vector(axis, time, values, names="xyz", **style):
    """Three components in the axes' colours."""
    for i, name in enumerate(names):
        axis.plot(time, values[:, i], color=AXIS_COLOURS[i], label=name, **style)
