# SPDX-License-Identifier: MIT
"""Doubts about units: values that no capture of a table-top object has, and the factor that makes them plausible.

Each function returns errors that are meant as warnings. `docs/reference/formats/capture.md` has the table of bounds.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.episode_tables import FRAMES_FILE, TRAJECTORY_FILE, PusherTrajectory
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.views import project
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.spatial.rotations import quaternion_to_matrix

DURATION = 0.1, 60.0  # s, of a push
INTERVAL = 0.002, 0.5  # s, between images
SPEED = 0.005, 3.0  # m/s, the highest of the pusher
EXTENT = 0.005, 1.0  # m, of the object
PUSHER_EXTENT = 0.001, 0.5  # m
DENSITY = 10.0, 25e3  # kg/m^3: foam and gold
GRAVITY = 9.75, 9.85  # m/s^2; on the ground it is 9.76 to 9.83
WAY = 0.005, 5.0  # m, diagonal of the box around the pusher's way
FARTHEST_PUSHER = 1.0  # m, from the object, at its nearest
FARTHEST_POSE = 10.0  # m, of the object from the world's origin
SCALE = 0.4, 2.5  # size of the object in a camera's model, for its size in the mask
LONGEST = 300.0, 5.0  # s, of a push and between images: beyond them nothing is computed

_TIMES = (
    *((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")),
    *((1e3, "seconds divided by 1000"), (60.0, "minutes")),
)
_LENGTHS = (
    *((1e-3, "millimetres"), (1e-2, "centimetres"), (0.0254, "inches"), (0.3048, "feet"), (1e-6, "micrometres")),
    *((1e3, "metres divided by 1000"), (1e2, "metres divided by 100")),
)
_FRAME_RATES = 24.0, 30.0, 60.0, 120.0  # Hz
_NEAR_UNIT = 1.5  # between a measured factor and that of a unit
_SAME = 1.1  # between two measured values that agree


# In words, unit, value, bounds, and power of the unit of time in the value.
_Value = tuple[str, str, float, tuple[float, float], int]


def _within(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= value <= bounds[1]


def _proposal(factor: float, unit: str, what: str) -> str:
    """Question that proposes a factor: "are they milliseconds? divide by 1000"."""
    change = f"divide by {1 / factor:.6g}" if factor < 1 else f"multiply by {factor:.6g}"
    return f"{what} {unit}? {change}"


def _nearest(factor: float, units: Sequence[tuple[float, str]]) -> tuple[float, str] | None:
    """Return the unit nearest to a measured factor, or None where none is near."""
    found = min(units, key=lambda unit: abs(math.log(unit[0] / factor)))
    return found if abs(math.log(found[0] / factor)) <= math.log(_NEAR_UNIT) else None


def time_doubts(folder: Path, t: np.ndarray | None, trajectory: PusherTrajectory | None) -> list[InputError]:
    """Doubts about the times of an episode.

    Args:
        folder: The episode.
        t: (n,) [s], those of its images; None where they are not known.
        trajectory: The pusher's log; None where it is not known.
    """
    clocks = [] if t is None or trajectory is None else _clock_doubts(folder, t, trajectory)
    if clocks:
        return clocks
    values: list[_Value] = []
    if trajectory is not None and len(trajectory.t) > 1:
        length = float(trajectory.t[-1] - trajectory.t[0])
        speed = _speed(trajectory)
        values.append((f"times that run over {length:,.4g} s", "s", length, DURATION, 1))
        if speed > 0:
            values.append((f"a pusher at {1000 * speed:,.3g} mm/s at most", "m/s", speed, SPEED, -1))
    if t is not None and len(t) > 1:
        interval = float(np.median(np.diff(t)))
        values.append((f"an image each {interval:.4g} s", "s", interval, INTERVAL, 1))
    odd = [value for value in values if not _within(value[2], value[3])]
    if not any(power > 0 for *_, power in odd):
        return [] if trajectory is None else _velocity_doubts(folder, trajectory)
    found = ", ".join(words for words, *_ in odd)
    allowed = ", ".join(f"{low:g} to {high:g} {unit}" for _, unit, _, (low, high), _ in odd)

    def fits(factor: float) -> bool:
        return all(_within(value * factor**power, bounds) for _, _, value, bounds, power in values)

    steps = None if t is None or len(t) < 2 else np.diff(t)
    if steps is not None and bool((steps == 1).all()) and any(fits(1 / rate) for rate in _FRAME_RATES):
        allowed += "; are they numbers of frames? divide by the frames per second"
    else:
        allowed += "".join(f"; {_proposal(*unit, 'are they')}" for unit in [one for one in _TIMES if fits(one[0])][:1])
    return [InputError(folder / (FRAMES_FILE if trajectory is None else TRAJECTORY_FILE), value=found, allowed=allowed)]


def _clock_doubts(folder: Path, t: np.ndarray, trajectory: PusherTrajectory) -> list[InputError]:
    """Doubts where images and log have clocks of different units."""
    if min(len(t), len(trajectory.t)) < 2:
        return []
    images, log = float(t[-1] - t[0]), float(trajectory.t[-1] - trajectory.t[0])
    unit = _nearest(log / images, _TIMES[:4])
    if unit is None:
        return []
    found = f"times over {images:,.4g} s, against {log:.4g} s of {TRAJECTORY_FILE}"
    return [InputError(folder / FRAMES_FILE, value=found, allowed=f"one clock; {_proposal(*unit, 'are they')}")]


def _velocity_doubts(folder: Path, trajectory: PusherTrajectory) -> list[InputError]:
    """Doubts where the velocities have another unit of length than the positions."""
    commanded, speed = float(np.linalg.norm(trajectory.v_WP, axis=1).max()), _speed(trajectory)
    for factor, unit in _LENGTHS[:2]:
        if commanded > 0 and speed > 0 and 1 / _SAME < commanded * factor / speed < _SAME:
            found = f"vx, vy, vz up to {commanded:.4g} m/s, while the positions move at up to {speed:.3g} m/s"
            allowed = f"m/s; {_proposal(factor, f'{unit} per second', 'are they')}"
            return [InputError(folder / TRAJECTORY_FILE, value=found, allowed=allowed)]
    return []


def _speed(trajectory: PusherTrajectory) -> float:
    if len(trajectory.t) < 2:
        return 0.0
    return float((np.linalg.norm(np.diff(trajectory.p_WP, axis=0), axis=1) / np.diff(trajectory.t)).max())


def require_computable(folder: Path, t: np.ndarray | None, trajectory: PusherTrajectory) -> list[InputError]:
    """Doubts about the times of an episode that is to be computed.

    Args:
        folder: The episode.
        t: (n,) [s], those of its images; None without images.
        trajectory: The pusher's log.

    Raises:
        InputError: It lasts more than 300 s, or its images are 5 s apart: a computation would not end.
    """
    doubts = time_doubts(folder, t, trajectory)
    interval = float(np.median(np.diff(t))) if t is not None and len(t) > 1 else 0.0
    if trajectory.t[-1] - trajectory.t[0] > LONGEST[0] or interval > LONGEST[1]:
        raise doubts[0]
    return doubts


def position_doubts(
    folder: Path, trajectory: PusherTrajectory, mesh: trimesh.Trimesh, X_WO: Pose, pusher: trimesh.Trimesh | None
) -> list[InputError]:
    """Doubts about the positions of a pusher [m] that never comes near an object [m, O] at X_WO, or hardly moves.

    Args:
        folder: The episode.
        trajectory: The pusher's log.
        mesh: The object.
        X_WO: Pose of the object at the start.
        pusher: Surface of the pusher, m, P; None where it is not known.
    """
    middle = quaternion_to_matrix(X_WO.q).numpy() @ np.mean(mesh.bounds, axis=0) + X_WO.p.numpy()
    reach = 0.5 * float(np.linalg.norm(mesh.extents))
    reach += 0.0 if pusher is None else 0.5 * float(np.linalg.norm(pusher.extents))

    def near(factor: float) -> float:
        return float(np.linalg.norm(factor * trajectory.p_WP - middle, axis=1).min())

    way = float(np.linalg.norm(np.ptp(trajectory.p_WP, axis=0)))
    if near(1.0) <= reach + FARTHEST_PUSHER and _within(way, WAY):
        return []
    start = {unit: float(np.linalg.norm(unit[0] * trajectory.p_WP[0] - middle)) for unit in _LENGTHS}
    fitting = [
        unit
        for unit in _LENGTHS
        if near(unit[0]) <= 1.1 * reach and start[unit] >= 0.5 * reach and _within(way * unit[0], (WAY[0], EXTENT[1]))
    ]
    if not fitting:
        return []
    found = f"a pusher that moves {way:.3g} m and comes within {near(1.0):.3g} m of the object's middle"
    words = "; ".join(_proposal(*unit, "are px, py, pz") for unit in fitting[:3])
    return [InputError(folder / TRAJECTORY_FILE, value=found, allowed=f"a pusher that reaches the object; {words}")]


def size_doubts(path: Path, mesh: trimesh.Trimesh, bounds: tuple[float, float] = EXTENT) -> list[InputError]:
    """Doubts about the extent [m] of a mesh or shape; `path` is the file that has it."""
    extent = float(mesh.extents.max())
    if _within(extent, bounds):
        return []
    words = [_proposal(*unit, "is it in") for unit in _LENGTHS[:4] if _within(extent * unit[0], bounds)]
    words += [_proposal(*unit, "is it in") for unit in _LENGTHS[5:] if _within(extent * unit[0], bounds)]
    allowed = "; ".join([f"{bounds[0]:g} to {bounds[1]:g} m", *words[:3]])
    return [InputError(path, value=f"an extent of {extent:.3g} m", allowed=allowed)]


def scene_doubts(
    path: Path,
    *,
    mesh: trimesh.Trimesh | None,
    X_WO: Pose | None,
    floor_height: float | None,
    gravity: float | None,
    mass: float | None,
) -> list[InputError]:
    """Doubts about the numbers of a `capture.yaml`, as far as they are known.

    Args:
        path: The file.
        mesh: The object, m, O.
        X_WO: Its pose, m.
        floor_height: m.
        gravity: m/s^2.
        mass: kg.
    """
    doubts = []
    if gravity is not None and not _within(gravity, GRAVITY):
        units = ((1e-2, "cm/s^2"), (1e-3, "mm/s^2"), (0.3048, "ft/s^2"))
        words = [f"; {_proposal(*unit, 'is it in')}" for unit in units if _within(gravity * unit[0], (9.7, 9.9))]
        doubts.append(
            InputError(path, value=f"gravity = {gravity:g}", allowed="".join(["9.8 m/s^2, on the ground", *words[:1]]))
        )
    volume = 0.0 if mesh is None else abs(float(mesh.volume))
    if mass is not None and volume > 0 and not _within(mass / volume, DENSITY):
        density = mass / volume
        masses = ((1e-3, "grams"), (1e3, "tonnes"), (0.4536, "pounds"))
        words = [f"; {_proposal(*unit, 'is it in')}" for unit in masses if _within(density * unit[0], DENSITY)]
        found = f"object.mass = {mass:g}, a density of {density:.3g} kg/m^3"
        allowed = f"{DENSITY[0]:g} to {DENSITY[1]:g} kg/m^3"
        doubts.append(InputError(path, value=found, allowed="".join([allowed, *words[:1]])))
    if X_WO is not None and float(X_WO.p.norm()) > FARTHEST_POSE:
        words = []
        if mesh is not None and floor_height is not None:
            low = float((mesh.vertices @ quaternion_to_matrix(X_WO.q)[2].numpy()).min())
            gaps = {unit: abs(unit[0] * float(X_WO.p[2]) + low - floor_height) for unit in _LENGTHS[:4]}
            best = min(gaps, key=gaps.__getitem__)
            words = [f"; {_proposal(*best, 'is it in')}"] if gaps[best] < 0.02 else []
        found = f"object.X_WO.p = {[float(f'{x:.4g}') for x in X_WO.p.tolist()]}"
        doubts.append(InputError(path, value=found, allowed=f"within {FARTHEST_POSE:g} m" + "".join(words)))
    return doubts


class Seen(NamedTuple):
    """Object as a camera sees it."""

    camera: Camera
    X_WC: Pose
    size: float  # px, diagonal of the box around its mask


def seen_size(mask: np.ndarray) -> float:
    """Diagonal [px] of the box around a mask (H, W) bool that is not empty."""
    rows, columns = np.nonzero(mask)
    return float(np.hypot(np.ptp(rows) + 1, np.ptp(columns) + 1))


def scale_doubts(path: Path, views: Sequence[Seen], mesh: trimesh.Trimesh, X_WO: Pose) -> list[InputError]:
    """Doubts about the unit of camera poses, by the size of the object [m, O] in its masks.

    Args:
        path: File of the poses.
        views: The object in static views.
        mesh: The object.
        X_WO: Its pose in their world.
    """
    if not views:
        return []
    factor = 1.0
    for _ in range(3):  # the size is not quite inverse to the distance
        factor *= float(np.median([_size_in_model(view, mesh, X_WO, factor) / view.size for view in views]))
    if _within(factor, SCALE):
        return []
    unit = _nearest(factor, _LENGTHS)
    found = f"camera poses that show the object {factor:.3g} times as large as its masks do"
    words = "" if unit is None else f"; {_proposal(*unit, 'are poses in')}"
    scale = factor if unit is None else unit[0]
    return [InputError(path, value=found, allowed=f"poses and mesh in metres{words} (at import: --scale {scale:.3g})")]


def _size_in_model(view: Seen, mesh: trimesh.Trimesh, X_WO: Pose, factor: float) -> float:
    """Diagonal [px] of the box around the object in a camera that is `factor` times as far away."""
    p_WO = X_WO.p
    X_WC = Pose(view.X_WC.q, p_WO + factor * (view.X_WC.p - p_WO))
    pixels, depths = project(view.camera, compose(inverse(X_WC), X_WO), torch.tensor(np.array(mesh.vertices)))
    if bool((depths > 0).all()):
        return float((pixels.amax(0) - pixels.amin(0)).norm())
    # Too near: as a ball far away.
    distance = max(float((X_WC.p - p_WO).norm()), 1e-9)
    return float(view.camera.intrinsics[0]) * float(np.linalg.norm(mesh.extents)) / distance
