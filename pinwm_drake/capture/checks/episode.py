# SPDX-License-Identifier: MIT
"""Checks of one episode: its camera, its tables, and in its images the object, its place, motion and sharpness."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.motion import check_motion
from pinwm_drake.capture.checks.pictures import check_area, check_camera, check_sharpness, compare, sharpness
from pinwm_drake.capture.checks.scene import Scene
from pinwm_drake.capture.checks.static import in_picture, unseen
from pinwm_drake.capture.episode_tables import (
    FRAMES_FILE,
    POSES_FILE,
    ObjectPoses,
    PusherTrajectory,
    read_frame_table,
    read_object_poses,
    read_trajectory,
)
from pinwm_drake.capture.episodes import (
    CAMERA_FILE,
    CAMERAS,
    START_FILE,
    View,
    is_filmed,
    pose_at,
    read_episode_image,
    read_fixed_camera,
    read_start,
)
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.refusals import attempt
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.capture.units import time_doubts
from pinwm_drake.documents import read_json
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.spatial.poses import Pose, compose, inverse

_FEWEST_IMAGES = 8
_DROPPED = 1.8  # times the usual time between images
_START = 0.005, 2.0  # m and deg between object.X_WO and the first pose of the table
_CONTRAST = 0.12  # of the range from black to white: a change that is not noise
_MOVED = 0.005  # share of the object's pixels that have to change
_MARGIN = 2  # px around the pusher that may be its own
_Part = TypeVar("_Part")


def check_episode(name: str, scene: Scene, findings: Findings, progress: Callable[[str], None]) -> int:
    """Check `episodes/<name>` and return the number of its images; `progress` is told what comes next."""
    folder, error = scene.folder / EPISODES / name, findings.error
    log = _whole(lambda: read_trajectory(folder, error), findings)
    poses = _whole(lambda: read_object_poses(folder, error), findings)
    attempt(lambda: read_start(folder), error)
    if poses is not None and not is_filmed(folder):
        findings.warn(folder, f"no {CAMERA_FILE} and no {FRAMES_FILE}", "a film, or `pinwm identify --poses`")
        if log is not None:
            check_motion(folder, log, None, scene, findings)
        return 0
    log_t = None if log is None else log.t
    number = 0
    for one in (folder, *sorted(path for path in (folder / CAMERAS).glob("*") if path.is_dir())):
        frames = attempt(partial(read_frame_table, one, log_t, error), error)
        t = frames[1] if frames is not None and bool(np.isfinite(frames[1]).all()) else None
        seen = _check_view(one, scene, findings)
        if one is folder:
            findings.doubt(time_doubts(folder, t, log))
        if one is folder and log is not None:
            check_motion(folder, log, t, scene, findings)
        number += 0 if frames is None else len(frames[0])
        if frames is None or t is None:
            continue
        _check_times(one, t, findings)
        if one is folder and poses is not None:
            _check_start(folder, poses, scene, t, findings)
        if seen is not None:
            _check_images(View(one.name, one, *seen, *frames), scene, poses, log, findings, progress)
    return number


def _whole(read: Callable[[], _Part], findings: Findings) -> _Part | None:
    """Return a table, or None where it has a problem, however small."""
    before = len(findings.problems)
    found = attempt(read, findings.error)
    return found if len(findings.problems) == before else None


def _check_view(folder: Path, scene: Scene, findings: Findings) -> tuple[Camera, Pose] | None:

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
    own = attempt(lambda: read_start(folder), lambda _: None)
    start = scene.X_WO if own is None else own.X_WO
    if start is not None:
        away = float(np.linalg.norm(poses.p_WO[0] - start.p.numpy()))
        turn = 2 * np.degrees(np.arccos(min(abs(float(poses.q_WO[0] @ start.q.numpy())), 1.0)))
        if away > _START[0] or turn > _START[1]:
            where = "object.X_WO" if own is None else START_FILE
            found = f"a first pose {1000 * away:.1f} mm and {turn:.1f} deg from {where}"
            findings.warn(path, found, f"an episode that starts at {where}; {START_FILE} says another start", row=2)


def _check_images(
    view: View,
    scene: Scene,
    poses: ObjectPoses | None,
    log: PusherTrajectory | None,
    findings: Findings,
    progress: Callable[[str], None],
) -> None:
    """Check the images of one camera, with the poses of both bodies as far as they are known."""
    names, table, read, moved = view.file_names, view.folder / FRAMES_FILE, 0, 0.0
    first: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    empty, cut, poor = [], [], []
    sharp: list[tuple[Path, float | None]] = []
    for k, (name, time) in enumerate(zip(names, view.t.tolist(), strict=True)):
        progress(f"{EPISODES}/{view.folder.name}/{name}")
        if not is_file(view.folder / name):
            continue  # its row in the table has been refused
        picture = attempt(partial(read_episode_image, view.folder, name, view.camera), findings.error)
        if picture is None:
            continue
        image, mask = picture
        read += 1
        hidden = _pusher_pixels(view, scene, log, time)
        shown = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), mask, hidden
        first = first or shown
        moved = max(moved, _changed(first, shown))
        if not mask.any():
            empty.append(k)
            continue
        if mask[[0, -1]].any() or mask[:, [0, -1]].any():
            cut.append(k)
        check_area(view.folder / name, mask, findings)
        sharp.append((view.folder / name, sharpness(image, mask)))
        X_WO = scene.X_WO if time == view.t[0] else None
        if poses is not None and poses.t[0] - 1e-6 <= time <= poses.t[-1] + 1e-6:
            X_WO = pose_at(poses.t, poses.p_WO, poses.q_WO, time)
        if scene.mesh is not None and X_WO is not None:
            outline = silhouette(scene.mesh, view.camera, compose(inverse(view.X_WC), X_WO))
            agreement = None if outline is None else compare(outline, mask, hidden)
            if agreement is not None and agreement.poor:
                poor.append((agreement.iou, k, agreement.words()))
    if read and len(empty) == read:
        findings.error(InputError(table, value="images that never show the object", allowed="the object in view"))
        return
    if empty:
        found = f"{len(empty)} of {len(names)} images without the object, first {names[empty[0]]}"
        findings.warn(table, found, "images that show it", row=empty[0] + 2)
    if cut:
        found = f"{len(cut)} of {len(names)} images cut the object off, first {names[cut[0]]}"
        findings.warn(table, found, "the whole object in view", row=cut[0] + 2)
    if read == len(names) > 1 and moved < _MOVED:
        found = f"an object at rest: {moved:.2%} of its pixels change, beside the pusher's"
        findings.error(InputError(table, value=found, allowed="images of an object that is pushed"))
    check_sharpness(view.folder, sharp, findings)
    if poor:
        _, k, words = min(poor)
        several = "" if len(poor) == 1 else f"; {len(poor)} images like this, this one is the worst"
        found = f"mask against mesh projected at t = {float(view.t[k]):.3f} s: {words}{several}"
        expected = "outlines that agree; check scale, calibration, camera.json, X_WO and poses"
        findings.warn(view.folder / names[k], found, expected)


def _pusher_pixels(view: View, scene: Scene, log: PusherTrajectory | None, time: float) -> np.ndarray:
    """Mask (H, W) bool of the pusher's pixels in the image of a time [s], and a little around them."""
    covered = None
    if scene.pusher is not None and log is not None:
        X_WP = pose_at(log.t, log.p_WP, log.q_WP, time)
        covered = silhouette(scene.pusher, view.camera, compose(inverse(view.X_WC), X_WP))
    if covered is None:
        return np.zeros((view.camera.height, view.camera.width), bool)
    return cv2.dilate(covered.astype(np.uint8), np.ones((2 * _MARGIN + 1,) * 2, np.uint8)) > 0


def _changed(one: tuple[np.ndarray, np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """Share of the object's pixels that differ in two images: grey values, its mask and the pusher's, each (H, W)."""
    counts = ~(one[2] | other[2]) & (one[1] | other[1])
    change = counts & ((one[1] != other[1]) | (np.abs(one[0] - other[0]) > _CONTRAST))
    # A row of single pixels along an outline is no motion.
    kept = cv2.morphologyEx(change.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return float(kept.sum()) / max(int(counts.sum()), 1)
