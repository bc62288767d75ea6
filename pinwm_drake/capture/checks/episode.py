"""Checks of one episode: its camera, its tables, and in its images the object, its place, motion and sharpness."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.motion import check_motion
from pinwm_drake.capture.checks.pictures import Agreement, check_area, check_camera, check_sharpness, compare, sharpness
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
from pinwm_drake.capture.episodes import CAMERA_FILE, CAMERAS, View, pose_at, read_episode_image, read_fixed_camera
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.refusals import attempt
from pinwm_drake.capture.scene import EPISODES
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
            _Video(View(one.name, one, *seen, *frames), scene, poses, log, findings).check(progress)
    return number


def _whole(read: Callable[[], _Part], findings: Findings) -> _Part | None:
    """A table, or None where it has a problem, however small."""
    before = len(findings.problems)
    found = attempt(read, findings.error)
    return found if len(findings.problems) == before else None


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


@dataclass(eq=False)
class _Video:
    """Images of one camera, the poses of the bodies as far as they are known, and what has been seen so far.

    Attributes:
        view: The camera and its images.
        scene: The parts of the capture that have been read.
        poses: Poses of the object; None where they are not known.
        log: Poses of the pusher; None where they are not known.
        findings: Receives the problems.
        first: Grey values and mask of the first image, and the pusher's pixels in it.
        sharp, agreements: Sharpness by file, and agreement of mesh and mask by image, where they are known.
        empty, cut: Numbers of the images without the object, and of those in which it touches the border.
        moved: The largest share of the object's pixels that changed since the first image.
        read: Number of images that could be read.
    """

    view: View
    scene: Scene
    poses: ObjectPoses | None
    log: PusherTrajectory | None
    findings: Findings
    first: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    sharp: list[tuple[Path, float | None]] = field(default_factory=list)
    empty: list[int] = field(default_factory=list)
    cut: list[int] = field(default_factory=list)
    moved: float = 0.0
    agreements: list[tuple[int, Agreement]] = field(default_factory=list)
    read: int = 0

    def check(self, progress: Callable[[str], None]) -> None:
        """Checks the images; `progress` is told what comes next."""
        names, findings = self.view.file_names, self.findings
        for k, name in enumerate(names):
            progress(f"{EPISODES}/{self.view.folder.name}/{name}")
            if is_file(self.view.folder / name):  # otherwise its row in the table has been refused
                self._look(k)
        table, count = self.view.folder / FRAMES_FILE, len(names)
        if self.read and len(self.empty) == self.read:
            findings.error(InputError(table, value="images that never show the object", allowed="the object in view"))
            return
        if self.empty:
            found = f"{len(self.empty)} of {count} images without the object, first {names[self.empty[0]]}"
            findings.warn(table, found, "images that show it", row=self.empty[0] + 2)
        if self.cut:
            found = f"{len(self.cut)} of {count} images cut the object off, first {names[self.cut[0]]}"
            findings.warn(table, found, "the whole object in view", row=self.cut[0] + 2)
        if self.read == count > 1 and self.moved < _MOVED:
            found = f"an object at rest: {self.moved:.2%} of its pixels change, beside the pusher's"
            findings.error(InputError(table, value=found, allowed="images of an object that is pushed"))
        check_sharpness(self.view.folder, self.sharp, findings)
        poor = [(k, agreement) for k, agreement in self.agreements if agreement.poor]
        if poor:
            k, worst = min(poor, key=lambda pair: pair[1].iou)
            several = "" if len(poor) == 1 else f"; {len(poor)} images like this, this one is the worst"
            findings.warn(
                self.view.folder / names[k],
                f"mask against mesh projected at t = {float(self.view.t[k]):.3f} s: {worst.words()}{several}",
                "outlines that agree; check scale, calibration, camera.json, X_WO and poses",
            )

    def _look(self, k: int) -> None:
        """Checks one image, and notes what it shows."""
        view, name, time = self.view, self.view.file_names[k], float(self.view.t[k])
        path = view.folder / name
        picture = attempt(lambda: read_episode_image(view.folder, name, view.camera), self.findings.error)
        if picture is None:
            return
        image, mask = picture
        self.read += 1
        if not mask.any():
            self.empty.append(k)
        else:
            if mask[[0, -1]].any() or mask[:, [0, -1]].any():
                self.cut.append(k)
            check_area(path, mask, self.findings)
            self.sharp.append((path, sharpness(image, mask)))
        hidden = self._pusher_pixels(time)
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        self.first = self.first or (grey, mask, hidden)
        self.moved = max(self.moved, _changed(self.first, (grey, mask, hidden)))
        X_WO = self._object_pose(time)
        if self.scene.mesh is not None and X_WO is not None and mask.any():
            outline = silhouette(self.scene.mesh, view.camera, compose(inverse(view.X_WC), X_WO))
            agreement = None if outline is None else compare(outline, mask, hidden)
            if agreement is not None:
                self.agreements.append((k, agreement))

    def _object_pose(self, time: float) -> Pose | None:
        """Pose of the object at a time [s], where it is known: at the start, and in the table."""
        poses = self.poses
        if poses is not None and poses.t[0] - 1e-6 <= time <= poses.t[-1] + 1e-6:
            return pose_at(poses.t, poses.p_WO, poses.q_WO, time)
        return self.scene.X_WO if time == self.view.t[0] else None

    def _pusher_pixels(self, time: float) -> np.ndarray:
        """Mask (H, W) bool of the pusher's pixels in the image of a time [s], and a little around them."""
        view, log, covered = self.view, self.log, None
        if self.scene.pusher is not None and log is not None:
            X_WP = pose_at(log.t, log.p_WP, log.q_WP, time)
            covered = silhouette(self.scene.pusher, view.camera, compose(inverse(view.X_WC), X_WP))
        if covered is None:
            return np.zeros((view.camera.height, view.camera.width), bool)
        return cv2.dilate(covered.astype(np.uint8), np.ones((2 * _MARGIN + 1,) * 2, np.uint8)) > 0


def _changed(one: tuple[np.ndarray, np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """Share of the object's pixels that differ in two images, where the pusher is in neither.

    Args:
        one: Grey values, mask of the object, and pixels of the pusher, each (H, W).
        other: The same of the other image.
    """
    counts = ~(one[2] | other[2]) & (one[1] | other[1])
    change = counts & ((one[1] != other[1]) | (np.abs(one[0] - other[0]) > _CONTRAST))
    # A row of single pixels along an outline is no motion.
    kept = cv2.morphologyEx(change.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    return float(kept.sum()) / max(int(counts.sum()), 1)
