"""Checks of an episode's images: the object in them, its place, its motion, and sharpness."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.pictures import (
    Agreement,
    check_area,
    check_sharpness,
    compare,
    dilated,
    sharpness,
)
from pinwm_drake.capture.episode_tables import FRAMES_FILE
from pinwm_drake.capture.episodes import read_episode_image
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.refusals import attempt
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.spatial.poses import Pose, compose, inverse

_CONTRAST = 0.12  # of the range from black to white: a change that is not noise
_MOVED = 0.005  # share of the object's pixels that have to change
_MARGIN = 2  # px around the pusher that may be its own


@dataclass(frozen=True, eq=False)
class Video:
    """Images of an episode, and the known poses of the bodies in them.

    Attributes:
        folder: Folder of the episode.
        camera: Size and intrinsics (4,).
        X_WC: Pose of the camera; q (4,), p (3,) [m].
        file_names: The images, n paths from `folder`.
        t: (n,) [s].
        mesh: The object, m, O; or None.
        X_WO_at: Pose of the object in the world at a time [s], or None where that is not known.
        pusher: The pusher, m, P; or None.
        X_WP_at: Pose of the pusher in the world at a time [s], or None where that is not known.
    """

    folder: Path
    camera: Camera
    X_WC: Pose
    file_names: list[str]
    t: np.ndarray
    mesh: trimesh.Trimesh | None
    X_WO_at: Callable[[float], Pose | None]
    pusher: trimesh.Trimesh | None
    X_WP_at: Callable[[float], Pose | None]


@dataclass(eq=False)
class _Seen:
    """Findings in the images so far, by the number of each image.

    Attributes:
        first: Grey values and mask of the first image, and the pusher's pixels in it.
        sharp: File and sharpness of each image.
        empty: Images without the object.
        cut: Images in which the object touches the border.
        moved: The largest share of the object's pixels that changed since the first image.
        agreements: Agreement of mesh and mask in each image for which it is known.
        read: Number of images that could be read.
    """

    first: tuple[np.ndarray, np.ndarray, np.ndarray] | None
    sharp: list[tuple[Path, float | None]]
    empty: list[int]
    cut: list[int]
    moved: float
    agreements: list[tuple[int, Agreement]]
    read: int


def check_video(video: Video, findings: Findings, progress: Callable[[str], None]) -> None:
    """Checks the images of an episode.

    Args:
        video: The images.
        findings: Receives the problems.
        progress: Is told what comes next.
    """
    seen = _Seen(None, [], [], [], 0.0, [], 0)
    for k, name in enumerate(video.file_names):
        progress(f"{EPISODES}/{video.folder.name}/{name}")
        _look(video, k, seen, findings)
    table, count = video.folder / FRAMES_FILE, len(video.file_names)
    if seen.read and len(seen.empty) == seen.read:
        findings.error(InputError(table, value="images that never show the object", allowed="the object in view"))
        return
    if seen.empty:
        found = f"{len(seen.empty)} of {count} images without the object, first {video.file_names[seen.empty[0]]}"
        findings.warn(table, found, "images that show it", row=seen.empty[0] + 2)
    if seen.cut:
        found = f"{len(seen.cut)} of {count} images cut the object off, first {video.file_names[seen.cut[0]]}"
        findings.warn(table, found, "the whole object in view", row=seen.cut[0] + 2)
    if seen.read == count > 1 and seen.moved < _MOVED:
        found = f"an object at rest: {seen.moved:.2%} of its pixels change, beside the pusher's"
        findings.error(InputError(table, value=found, allowed="images of an object that is pushed"))
    check_sharpness(video.folder, seen.sharp, findings)
    _check_agreements(video, seen, findings)


def _look(video: Video, k: int, seen: _Seen, findings: Findings) -> None:
    """Checks one image, and notes its findings in `seen`."""
    name = video.file_names[k]
    if not is_file(video.folder / name):
        return  # its row in the table has been refused
    picture = attempt(lambda: read_episode_image(video.folder, name, video.camera), findings.error)
    if picture is None:
        return
    image, mask = picture
    seen.read += 1
    if not mask.any():
        seen.empty.append(k)
    else:
        if mask[[0, -1]].any() or mask[:, [0, -1]].any():
            seen.cut.append(k)
        check_area(video.folder / name, mask, findings)
        seen.sharp.append((video.folder / name, sharpness(image, mask)))
    hidden = _pusher_pixels(video, float(video.t[k]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if seen.first is None:
        seen.first = grey, mask, hidden
    seen.moved = max(seen.moved, _changed(seen.first, (grey, mask, hidden)))
    X_WO = video.X_WO_at(float(video.t[k]))
    if video.mesh is not None and X_WO is not None and mask.any():
        outline = silhouette(video.mesh, video.camera, compose(inverse(video.X_WC), X_WO))
        agreement = None if outline is None else compare(outline, mask, hidden)
        if agreement is not None:
            seen.agreements.append((k, agreement))


def _pusher_pixels(video: Video, t: float) -> np.ndarray:
    """Mask (H, W) bool of the pusher's pixels in the image of a time [s], and a little around them."""
    nowhere = np.zeros((video.camera.height, video.camera.width), bool)
    X_WP = video.X_WP_at(t)
    if video.pusher is None or X_WP is None:
        return nowhere
    covered = silhouette(video.pusher, video.camera, compose(inverse(video.X_WC), X_WP))
    return nowhere if covered is None else dilated(covered, _MARGIN)


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


def _check_agreements(video: Video, seen: _Seen, findings: Findings) -> None:
    poor = [(k, agreement) for k, agreement in seen.agreements if agreement.poor]
    if not poor:
        return
    k, worst = min(poor, key=lambda pair: pair[1].iou)
    several = "" if len(poor) == 1 else f"; {len(poor)} images like this, this one is the worst"
    findings.warn(
        video.folder / video.file_names[k],
        f"mask against mesh projected at t = {float(video.t[k]):.3f} s: {worst.words()}{several}",
        "outlines that agree; check scale, calibration, camera.json, X_WO and poses",
    )
