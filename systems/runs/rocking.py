# SPDX-License-Identifier: MIT
"""Choice of a poke that rocks an object without turning it over, which shows what a flip depends on."""

import numpy as np
import trimesh
from pydrake.math import RigidTransform

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.systems.pusher.choice import choose_poke
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.recorder import Recording, SceneRecorder

SPEEDS = (0.3, 0.5)  # m/s, of pokes whose speed is not given: faster ones make an object hop, which hides friction
RISES = (0.3, 0.8)  # rad, of the way over level: such pokes seldom turn the object over
_POKES, _DRAWS = 60, 1000  # that are tried, and drawn
_ROCKS = 0.001  # m, by which the centre of mass rises at least, and within which it comes back
_OVER = 0.3  # of the height of the centre of mass, by which it rises at most; over a cube's edge it is 0.41
_AFTER = 0.1  # s, after the end of a poke, when it has risen where it will
_SLIDES = 0.02  # m, by which the place below the centre of mass slips at least; friction does not show where it rolls
_SLIP = 0.5  # of the way of the centre of mass, that is slip at least


def rocking_poke(
    recorder: SceneRecorder,
    X_WO: RigidTransform,
    mesh: trimesh.Trimesh,
    shape: PusherShape,
    generator: np.random.Generator,
    speeds: tuple[float, float],
    number: int,
    *,
    rises: tuple[float, float] = RISES,
) -> tuple[StraightPush, Recording]:
    """Draws pokes of an object on the floor z = 0 until it slides and rocks, and lies as it did.

    Args:
        recorder: The scene.
        X_WO: Pose of the object, at rest.
        mesh: The object, m, frame O.
        shape: Shape of the pusher.
        generator: Source of randomness.
        speeds: m/s, of the pusher, least and most.
        number: Number of pictures of the recording.
        rises: rad, of the pusher's way over level, least and most.

    Raises:
        ParameterError: No poke rocks the object so.
    """
    mesh_W, p_OB = mesh.copy(), mass_properties(mesh, mass=1.0).p_com
    mesh_W.apply_transform(X_WO.GetAsMatrix4())
    top, tried = mesh_W.bounds[1, 2] - shape.radius, 0
    for _ in range(_DRAWS):
        try:
            poke = choose_poke(mesh_W, X_WO @ p_OB, shape, generator, floor_height=0.0, speeds=speeds, rises=rises)
        except ParameterError:  # at the height that it drew there is no side to be met; there may be at others
            continue
        # Over the top edge the least difference would decide.
        if poke.p_WP[2] + poke.distance * poke.direction_W[2] > top:
            continue
        try:
            recording = recorder.push(X_WO, poke, number, _Watch(poke, p_OB))
        except _NoRockError:
            pass
        else:
            if _rocked(recording.logged, p_OB):
                return poke, recording
        tried += 1
        if tried == _POKES:
            break
    low, high = speeds
    raise ParameterError(
        f"speed: got pokes of {low:g} to {high:g} m/s, none of {tried} of which makes the object slide and rock "
        f"and come back; allowed: a speed at which one does"
    )


class _NoRockError(Exception):
    """Sign that a poke need not be followed to its end."""


class _Watch:
    """Follower of a poke, until it has turned the object over, or is over and has not made it rise."""

    def __init__(self, poke: StraightPush, p_OB: np.ndarray) -> None:
        self._end, self._p_OB = poke.end_time + _AFTER, p_OB
        self._heights: list[float] = []

    def __call__(self, t: float, X_WO: RigidTransform) -> None:
        self._heights.append((X_WO @ self._p_OB)[2])
        rise = max(self._heights) - self._heights[0]
        if rise >= _OVER * self._heights[0] or (t > self._end and rise <= _ROCKS):
            raise _NoRockError


def _rocked(poses: list[RigidTransform], p_OB: np.ndarray) -> bool:
    centers = np.array([X @ p_OB for X in poses])
    heights = centers[:, 2]
    rise, change = heights.max() - heights[0], abs(heights[-1] - heights[0])
    below = centers * [1.0, 1.0, 0.0]
    moved = [after @ before.inverse() @ p for before, after, p in zip(poses[:-1], poses[1:], below[:-1], strict=True)]
    slip, way = _length(np.array(moved) - below[:-1]), _length(np.diff(centers, axis=0))
    return bool(_ROCKS < rise < _OVER * heights[0] and change < _ROCKS and slip > max(_SLIDES, _SLIP * way))


def _length(steps: np.ndarray) -> float:
    return float(np.linalg.norm(steps[:, :2], axis=1).sum())
