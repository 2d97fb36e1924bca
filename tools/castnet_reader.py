"""Read a castnet result file.

    from castnet_reader import Run
    run = Run("cubesat.h5")
    run.data        frames: an xarray.Dataset over time, node, cable (None without frames)
    run.history     energies, momenta, contacts: an xarray.Dataset over time
    run.static      masses, cables, faces ...: a dict of numpy arrays
    run.summary     capture measures and scalars: a dict of numpy arrays
    run.measures    the capture measures over verdict_time: an xarray.Dataset
    run.meta        the scene as read and as run, version, status: a dict

Frames alone need no reader of ours: xarray.open_dataset("cubesat.h5").
Everything is SI; angles are in degrees, rates in rad/s. Quaternions are body to
inertial, scalar first; angular velocities are in body axes.
"""
from __future__ import annotations

from functools import cached_property
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

VERDICTS = {0: "failed", 1: "marginal", 2: "captured"}


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3), body to inertial, of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _plain(value):
    """Bytes to text, arrays and scalars as numpy gives them."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").rstrip()
    if isinstance(value, np.ndarray) and value.dtype.kind in "SO":
        texts = [_plain(v) if isinstance(v, bytes) else v for v in value.ravel()]
        return texts[0] if len(texts) == 1 else texts
    return value


def _contents(group: h5py.Group | None) -> dict:
    """Datasets and attributes of a group as one dict; attributes never hide a dataset."""
    if group is None:
        return {}
    result = {name: _plain(value) for name, value in group.attrs.items()}
    result |= {name: _plain(item[()]) for name, item in group.items() if isinstance(item, h5py.Dataset)}
    return result


class Run:
    """One result file, read on demand and closed again at once."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"{self.path}: no such result file")
        try:
            with h5py.File(self.path) as file:
                groups = set(file)
        except OSError as problem:
            raise OSError(f"{self.path} is not a readable HDF5 file: {problem}") from problem
        if not groups & {"time", "history", "static", "meta"}:
            raise ValueError(f"{self.path} holds none of /time, /history, /static, /meta: not a castnet result")

    @property
    def name(self) -> str:
        """The file's name without .h5, .h5.part."""
        return self.path.name.removesuffix(".part").removesuffix(".h5")

    @cached_property
    def data(self) -> xr.Dataset | None:
        """The frames, in memory."""
        with h5py.File(self.path) as file:
            if "time" not in file or file["time"].shape[0] == 0:
                return None
        with xr.open_dataset(self.path, engine="h5netcdf", phony_dims="sort") as dataset:
            return dataset.load()

    @cached_property
    def history(self) -> xr.Dataset | None:
        """The rows of /history; vectors have the dimension xyz."""
        with h5py.File(self.path) as file:
            group = file.get("history")
            if group is None or "time" not in group or group["time"].shape[0] == 0:
                return None
            time = group["time"][()]
            variables = {}
            for name, item in group.items():
                if isinstance(item, h5py.Dataset) and name != "time" and item.shape[:1] == time.shape:
                    dims = ("time", "xyz")[: item.ndim]
                    units = _plain(item.attrs.get("units", b""))
                    variables[name] = (dims, item[()], {"units": units})
        return xr.Dataset(variables, coords={"time": time})

    @cached_property
    def static(self) -> dict:
        with h5py.File(self.path) as file:
            return _contents(file.get("static"))

    @cached_property
    def summary(self) -> dict:
        with h5py.File(self.path) as file:
            return _contents(file.get("summary"))

    @cached_property
    def meta(self) -> dict:
        with h5py.File(self.path) as file:
            return _contents(file.get("meta"))

    @cached_property
    def measures(self) -> xr.Dataset | None:
        """The capture measures over verdict_time; None where there is no target or no net."""
        time = np.atleast_1d(self.summary.get("verdict_time", []))
        if time.size == 0 or "coverage" not in self.summary:
            return None
        columns = {
            name: ("verdict_time", np.atleast_1d(value))
            for name, value in self.summary.items()
            if name != "verdict_time" and name != "impulse_percentiles" and np.shape(np.atleast_1d(value)) == time.shape
            and np.ndim(value) == 1
        }
        return xr.Dataset(columns, coords={"verdict_time": time})

    @property
    def has_net(self) -> bool:
        return self.data is not None and "node_position" in self.data

    @property
    def has_target(self) -> bool:
        return self.data is not None and "target_position" in self.data

    @property
    def first_contact(self) -> float:
        """Time of the first contact [s], NaN without one."""
        return float(np.squeeze(self.summary.get("first_contact", np.nan)))

    @cached_property
    def time(self) -> np.ndarray:
        """Times of the frames [s]."""
        return self.data["time"].values

    def frame(self, time: float) -> int:
        """The frame nearest to a time."""
        return int(np.argmin(np.abs(self.time - time)))

    @cached_property
    def cables(self) -> np.ndarray:
        """Node pairs of the cables (n_cable, 2), counted from 0."""
        return np.asarray(self.static["cable_nodes"], int).reshape(-1, 2)

    @cached_property
    def bullets(self) -> np.ndarray:
        """Nodes of the bullets, counted from 0; empty without bullets."""
        return np.atleast_1d(np.asarray(self.static.get("bullet_nodes", []), int))

    @property
    def target_solid(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The target's surface in body axes: vertices (n, 3) [m], triangles (m, 3) that turn outward."""
        if not self.has_target or "target_triangles" not in self.static:
            return None
        return np.asarray(self.static["target_vertices"], float), np.asarray(self.static["target_triangles"], int)
