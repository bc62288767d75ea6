"""Checks of one episode: its camera, its tables, its images."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.motion import check_motion
from pinwm_drake.capture.checks.pictures import check_camera
from pinwm_drake.capture.checks.scene import Scene
from pinwm_drake.capture.checks.static import in_picture, unseen
from pinwm_drake.capture.checks.video import Video
from pinwm_drake.capture.episode_tables import (
    FRAMES_FILE,
    POSES_FILE,
    ObjectPoses,
    read_frame_table,
    read_object_poses,
    read_trajectory,
)
from pinwm_drake.capture.episodes import CAMERA_FILE, CAMERAS, View, read_fixed_camera
from pinwm_drake.capture.refusals import attempt
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.documents import read_json
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose, compose, inverse

_FEWEST_IMAGES = 8
_DROPPED = 1.8  # times the usual time between images
_START = 0.005, 2.0  # m and deg between object.X_WO and the first pose of the table
_Part = TypeVar("_Part")


def check_episode(name: str, scene: Scene, findings: Findings, progress: Callable[[str], None]) -> int:
    """Checks `episodes/<name>` and returns the number of its images; `progress` is told what comes next."""
    folder, error = scene.folder / EPISODES / name, findings.error
    log = _whole(lambda: read_trajectory(folder, error), findings)
    poses = _whole(lambda: read_object_poses(folder, error), findings)
    log_t = None if log is None else log.t
    number = 0
    for one in (folder, *sorted(path for path in (folder / CAMERAS).glob("*") if path.is_dir())):
        frames = attempt(partial(read_frame_table, one, log_t, error), error)
        t = frames[1] if frames is not None and bool(np.isfinite(frames[1]).all()) else None
        seen = _check_view(one, scene, findings)
        if one is folder and log is not None:
            check_motion(folder, log, t, scene, findings)
        number += 0 if frames is None else len(frames[0])
        if frames is None or t is None:
            continue
        _check_times(one, t, findings)
        if one is folder and poses is not None:
            _check_start(folder, poses, scene, t, findings)
        if seen is not None:
            Video(View(one.name, one, *seen, *frames), scene, poses, log, findings).check(progress)
    return number


def _whole(read: Callable[[], _Part], findings: Findings) -> _Part | None:
    """A table, or None where it has a problem, however small."""
    before = findings.errors
    found = attempt(read, findings.error)
    return found if findings.errors == before else None


def _check_view(folder: Path, scene: Scene, findings: Findings) -> tuple[Camera, Pose] | None:
    """Checks `camera.json`; returns the camera and its pose X_WC, or None where they could not be read."""
    seen = attempt(lambda: read_fixed_camera(folder), findings.error)
    if seen is None:
        return None
    camera, X_WC = seen
    check_camera(folder / CAMERA_FILE, camera, findings)
    mesh, X_WO = scene.mesh, scene.X_WO
    if mesh is not None and X_WO is not None and not in_picture(mesh, camera, compose(inverse(X_WC), X_WO)):
        findings.error(unseen(read_json(folder / CAMERA_FILE)["transform_matrix"]))
    return seen


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


def _check_start(folder: Path, poses: ObjectPoses, scene: Scene, t: np.ndarray, findings: Findings) -> None:
    """Warns where the table of poses begins elsewhere than X_WO, or does not last as long as the images."""
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
