"""Choice of a poke that rocks an object without turning it over, which shows what a flip depends on."""

import math

import numpy as np
import trimesh
from pydrake.math import RigidTransform

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.systems.pusher.choice import choose_poke
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.recorder import PushRecorder, Recording

SPEEDS = (0.4, 0.8)  # m/s, of pokes whose speed is not given
_RISES = (0.1, 0.7)  # rad, of the way over level: such pokes tip an object at times, and seldom turn it over
_POKES = 60  # that are tried
_ROCKS = 0.0015  # m, by which the centre of mass rises at least
_SAME_FACE = math.radians(15)  # between the object's up before and after, but for a roll about its axis of symmetry


def rocking_poke(
    recorder: PushRecorder,
    X_WO: RigidTransform,
    mesh: trimesh.Trimesh,
    shape: PusherShape,
    generator: np.random.Generator,
    speeds: tuple[float, float],
    number: int,
) -> tuple[StraightPush, Recording]:
    """Draws pokes of an object on the floor z = 0 until one rocks it and leaves it on the face that it was on.

    Args:
        recorder: The scene.
        X_WO: Pose of the object, at rest.
        mesh: The object, m, frame O.
        shape: Shape of the pusher.
        generator: Source of randomness.
        speeds: m/s, of the pusher, least and most.
        number: Number of pictures of the recording.

    Returns:
        The poke, and what was recorded of it.

    Raises:
        ParameterError: None of 60 pokes rocks the object so.
    """
    mesh_W, p_OB = mesh.copy(), mass_properties(mesh, mass=1.0).p_com
    axis = mesh.symmetry_axis if mesh.symmetry == "radial" else None
    mesh_W.apply_transform(X_WO.GetAsMatrix4())
    for _ in range(_POKES):
        try:
            poke = choose_poke(mesh_W, X_WO @ p_OB, shape, generator, floor_height=0.0, speeds=speeds, rises=_RISES)
        except ParameterError:  # at the height that it drew there is no side to be met; there may be at others
            continue
        recording = recorder.push(X_WO, poke, number)
        if _rocked(recording.logged, p_OB, axis):
            return poke, recording
    low, high = speeds
    raise ParameterError(
        f"speed: got pokes of {low:g} to {high:g} m/s, none of {_POKES} of which rocks the object and lets it come "
        f"back; allowed: a speed at which one does"
    )


def _rocked(poses: list[RigidTransform], p_OB: np.ndarray, axis: np.ndarray | None) -> bool:
    """Flag: an object rocked, by the height of its centre of mass (3,) [m, O], and lies as it did before.

    Args:
        poses: Poses X_WO in order.
        p_OB: Centre of mass (3,) [m, O].
        axis: Unit axis of rotational symmetry (3,) [O], about which the object may have rolled; None without one.
    """
    heights = np.array([(X @ p_OB)[2] for X in poses])
    before, after = (poses[k].rotation().matrix()[2] for k in (0, -1))
    if axis is None:
        turned = math.acos(np.clip(before @ after, -1.0, 1.0))
    else:
        turned = abs(math.acos(np.clip(before @ axis, -1.0, 1.0)) - math.acos(np.clip(after @ axis, -1.0, 1.0)))
    return bool(heights.max() - heights[0] > _ROCKS and turned < _SAME_FACE)
