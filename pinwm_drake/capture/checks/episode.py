"""Checks of one episode: its camera, its tables, its images."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from pinwm_drake.capture.checks.camera import check_camera
from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.motion import check_motion
from pinwm_drake.capture.checks.scene import Scene
from pinwm_drake.capture.checks.static import in_picture, unseen
from pinwm_drake.capture.checks.video import Video, check_video
from pinwm_drake.capture.episode_tables import (
    FRAMES_FILE,
    POSES_FILE,
    ObjectPoses,
    PusherTrajectory,
    read_frame_table,
    read_object_poses,
    read_trajectory,
)
from pinwm_drake.capture.episodes import CAMERA_FILE, CAMERAS, pose_at, read_fixed_camera
from pinwm_drake.capture.refusals import attempt
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.documents import read_json
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose, compose, inverse

_FEWEST_IMAGES = 8
_DROPPED = 1.8  # times the usual time between images
_START = 0.005, 2.0  # m and deg between object.X_WO and the first pose of the table


def check_episode(name: str, scene: Scene, findings: Findings, progress: Callable[[str], None]) -> int:
    """Checks the episode in `episodes/<name>`.

    Args:
        name: Name of the episode.
        scene: The parts of the capture that have been read so far.
        findings: Receives the problems.
        progress: Is told what comes next.

    Returns:
        Number of images of the episode, of all of its cameras.
    """
    folder = scene.folder / EPISODES / name
    before = findings.errors
    trajectory = attempt(lambda: read_trajectory(folder, findings.error), findings.error)
    log = trajectory if findings.errors == before else None
    before = findings.errors
    poses = attempt(lambda: read_object_poses(folder, findings.error), findings.error)
    known = poses if findings.errors == before else None
    cameras = [folder, *sorted(path for path in (folder / CAMERAS).glob("*") if path.is_dir())]
    number = 0
    for place, one in enumerate(cameras):
        frames = attempt(partial(read_frame_table, one, _times(log), findings.error), findings.error)
        t = frames[1] if frames is not None and bool(np.isfinite(frames[1]).all()) else None
        seen = _check_view(one, scene, findings)
        if place == 0 and log is not None:
            check_motion(folder, log, t, scene, findings)
        number += 0 if frames is None else len(frames[0])
        if frames is None or t is None:
            continue
        _check_times(one, t, findings)
        if place == 0:
            _check_start(folder, known, scene, t, findings)
        if seen is not None:
            check_video(_video(one, seen, frames[0], t, scene, known, log), findings, progress)
    return number


def _times(log: PusherTrajectory | None) -> np.ndarray | None:
    return None if log is None else log.t


def _video(
    folder: Path,
    seen: tuple[Camera, Pose],
    names: list[str],
    t: np.ndarray,
    scene: Scene,
    poses: ObjectPoses | None,
    log: PusherTrajectory | None,
) -> Video:
    """Images of one camera, and the poses of the bodies as far as they are known."""
    return Video(
        folder=folder,
        camera=seen[0],
        X_WC=seen[1],
        file_names=names,
        t=t,
        mesh=scene.mesh,
        X_WO_at=lambda time: _pose_at(poses, scene, float(t[0]), time),
        pusher=scene.pusher,
        X_WP_at=lambda time: None if log is None else pose_at(log.t, log.p_WP, log.q_WP, time),
    )


def _check_view(folder: Path, scene: Scene, findings: Findings) -> tuple[Camera, Pose] | None:
    """Checks `camera.json`; returns the camera and its pose X_WC, or None where they could not be read."""
    seen = attempt(lambda: read_fixed_camera(folder), findings.error)
    if seen is None:
        return None
    camera, X_WC = seen
    check_camera(folder / CAMERA_FILE, camera, findings)
    if scene.mesh is None or scene.X_WO is None:
        return seen
    if not in_picture(scene.mesh, camera, compose(inverse(X_WC), scene.X_WO)):
        findings.error(unseen(read_json(folder / CAMERA_FILE)["transform_matrix"]))
    return seen


def _pose_at(poses: ObjectPoses | None, scene: Scene, start: float, time: float) -> Pose | None:
    """Pose of the object at a time [s], where it is known: at the start, and in the table."""
    if poses is not None and poses.t[0] - 1e-6 <= time <= poses.t[-1] + 1e-6:
        return pose_at(poses.t, poses.p_WO, poses.q_WO, time)
    return scene.X_WO if time == start else None


def _check_times(folder: Path, t: np.ndarray, findings: Findings) -> None:
    """Warns of few images and of gaps between them."""
    path = folder / FRAMES_FILE
    if len(t) < _FEWEST_IMAGES:
        findings.warn(path, f"{len(t)} images", f"{_FEWEST_IMAGES} or more")
        return
    gaps = np.diff(t)
    if (gaps <= 0).any():
        return  # refused with its row
    usual = float(np.median(gaps))
    wide = np.nonzero(gaps > _DROPPED * usual)[0]
    if len(wide):
        k = int(wide[0])
        found = f"gaps between images ({len(wide)}), the first of {gaps[k]:.4g} s before this row"
        findings.warn(path, found, f"an image each {usual:.4g} s, as usual here", row=k + 3)


def _check_start(folder: Path, poses: ObjectPoses | None, scene: Scene, t: np.ndarray, findings: Findings) -> None:
    """Warns where the table of poses begins elsewhere than X_WO, or does not last as long as the images."""
    if poses is None:
        return
    path = folder / POSES_FILE
    if poses.t[0] > t[0] + 1e-6 or poses.t[-1] < t[-1] - 1e-6:
        found = f"poses from {poses.t[0]:.4g} s to {poses.t[-1]:.4g} s"
        findings.warn(path, found, f"those of all images: {t[0]:.4g} s to {t[-1]:.4g} s")
    if scene.X_WO is not None:
        away = float(np.linalg.norm(poses.p_WO[0] - scene.X_WO.p.numpy()))
        turn = 2 * np.degrees(np.arccos(min(abs(float(poses.q_WO[0] @ scene.X_WO.q.numpy())), 1.0)))
        if away > _START[0] or turn > _START[1]:
            found = f"a first pose {1000 * away:.1f} mm and {turn:.1f} deg from object.X_WO"
            findings.warn(path, found, "an episode that starts at object.X_WO", row=2)
