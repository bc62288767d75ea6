"""Predictions of a twin for the pusher's log of an episode, of its own capture or of another one."""

import hashlib
from dataclasses import replace
from pathlib import Path

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.capture.scene import Capture, PusherGeometry
from pinwm_drake.errors import InputError
from pinwm_drake.twin.origin import start_pose, time_offset
from pinwm_drake.twin.rollout import rollout
from pinwm_drake.twin.twin import Twin

# Differences that are taken for rounding: of gravity [m/s^2], and of a floor on which the object was said to rest [m].
_SAME_GRAVITY, _SAME_FLOOR = 1e-3, 1e-3


def predict_poses(twin: Twin, capture: Capture, episode: Episode, push: int | None) -> ObjectPoses:
    """The poses of the object that a twin predicts for the frames of an episode.

    Args:
        twin: The twin.
        capture: The capture of the episode, which says where the object starts.
        episode: The episode; of it, the pusher's log and the times of the frames are used.
        push: Number of the identified push that it is, see `origin.identified_push`; None for another one.

    Returns:
        The poses at `episode.t`.

    Raises:
        PinwmError: A mesh cannot be used, or the physics found no solution.
    """
    start, late = start_pose(twin, capture, push), time_offset(twin, push)
    found = rollout(_in_place_of(twin, capture), start, episode.trajectory, episode.t + late)
    return ObjectPoses(episode.t, found.p_WO, found.q_WO)


def mismatches(twin: Twin, capture: Capture) -> list[str]:
    """Differences of a capture's scene from that of the twin, in words."""
    found = []
    if _digest(twin.mesh_path) != _digest(capture.object.mesh_path):
        found.append(f"the twin's mesh is another one than {capture.object.mesh_path}; the twin's is used")
    if not _same_pusher(twin.pusher, capture.pusher):
        found.append(f"the twin's pusher is another one than that of {capture.folder}; the twin's is used")
    if abs(twin.gravity - capture.gravity) > _SAME_GRAVITY:
        found.append(
            f"gravity is {twin.gravity:g} m/s² in the twin; the {capture.gravity:g} m/s² of the capture are used"
        )
    ours, theirs = 1e3 * (twin.floor_height - _lift(twin)), 1e3 * capture.floor_height
    if abs(ours - theirs) > 1e3 * _SAME_FLOOR:
        found.append(f"the floor is {ours:.1f} mm high in the twin; the {theirs:.1f} mm of the capture are used")
    return found


def _in_place_of(twin: Twin, capture: Capture) -> Twin:
    """The twin with the gravity of a capture and, unless it is the same but for the lift, on its floor."""
    floor = capture.floor_height + _lift(twin)
    same = abs(twin.floor_height - floor) <= _SAME_FLOOR
    return replace(twin, gravity=capture.gravity, floor_height=twin.floor_height if same else floor)


def _lift(twin: Twin) -> float:
    return twin.nuisance["lift"].value if "lift" in twin.nuisance else 0.0


def _same_pusher(twin: PusherGeometry, capture: PusherGeometry) -> bool:
    if twin.shape is not None or capture.shape is not None:
        return twin.shape == capture.shape
    if twin.mesh_path is None or capture.mesh_path is None:
        return twin.mesh_path == capture.mesh_path
    return _digest(twin.mesh_path) == _digest(capture.mesh_path)


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(path, value=error.strerror, allowed="a file that can be read") from error
