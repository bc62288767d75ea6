# SPDX-License-Identifier: MIT
"""Masks of the images of a push: the mesh follows the object, and what the pusher hides is taken away."""

from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pinwm_drake.masks.colours import evidence, histogram
from pinwm_drake.masks.consensus import guess_by_colours
from pinwm_drake.masks.grabcut import BACKGROUND, cut_out, grown
from pinwm_drake.masks.outline import mesh_mask
from pinwm_drake.masks.shots import Shot
from pinwm_drake.masks.start_pose import Outlines, refine

_ROOM, _LONGEST = 0.6, 240  # of the object's size, around it; px, of the boxes that are worked on
_SIZE = 160  # px, of the boxes in which the pose is refined
_ROUNDS = 2  # of colours and pose, for each image
_UNLIKE = -1.0  # evidence below which a pixel beside the pusher belongs to it or to what holds it
_WIDER = 2.0  # of the pusher: what holds it
_NEAR = 3  # px around the pusher, whose edge is not the object's
_EDGE = 25.0  # of Lab in bytes, least difference across the edge of what hides the object
_DIFFERS = 0.8  # IoU of colours and mesh below which an image is doubtful


def follow(
    images: Sequence[Callable[[], Shot]],
    mesh: trimesh.Trimesh,
    X_WO: np.ndarray,
    pusher: trimesh.Trimesh,
    X_WP: Sequence[np.ndarray],
) -> Iterator[tuple[np.ndarray, np.ndarray, str]]:
    """Follow an object that slides and turns on a table through the images of a camera that stands still.

    Args:
        images: Readers of the images in their order; the object rests in the first one.
        mesh: The object, m, frame O.
        X_WO: (4, 4) m, its pose in the first image.
        pusher: The pusher, m, frame P.
        X_WP: (4, 4) m, its pose in each image.

    Yields:
        Mask (H, W) bool, X_WO (4, 4), and a reason to doubt the mask, or "".
    """
    counts: np.ndarray | None = None
    before = X_WO
    for number, (read, X_P) in enumerate(zip(images, X_WP, strict=True)):
        whole = read()
        # As it moved from the image before last to the last one.
        X_WO, before = _ahead(before, X_WO), X_WO
        corners = mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3]
        box = whole.box(corners, _ROOM)
        if min(box[2] - box[0], box[3] - box[1]) < 16:
            X_WO = before
            yield np.zeros(whole.shape, bool), X_WO, "the object is out of the image"
            continue
        shot = whole.close_up(box, _LONGEST)
        lab, hidden = cv2.cvtColor(shot.image, cv2.COLOR_RGB2LAB), shot.outline(pusher, X_P)
        above = shot.outline(_held(pusher, X_P, 2 * mesh.scale), np.eye(4))
        if counts is None:
            counts = histogram(lab, grown(mesh_mask(shot, mesh, X_WO), -2) & ~grown(hidden | above, _NEAR))
        cut = np.zeros(shot.shape, bool)
        for _ in range(_ROUNDS if number else 1):
            outline = shot.outline(mesh, X_WO)
            behind = _hidden(lab, outline, hidden, above, counts)
            guess = guess_by_colours(lab, outline, None, counts)
            guess[behind] = BACKGROUND
            cut = cut_out(shot.image, guess)
            if number:
                near = grown(behind, _NEAR) if behind.any() else behind
                X_WO, _ = refine(Outlines.of([shot], [cut | (behind & outline)], _SIZE, [near]), mesh, X_WO)
        found = mesh_mask(shot, mesh, X_WO)
        behind = _hidden(lab, found, hidden, above, counts)
        found &= ~behind
        counts = counts + histogram(lab, grown(found, -2) & ~above)  # sides come into view, and lamps shade them anew
        union = int((found | cut).sum())
        agrees = (found & cut).sum() / union if union else 0.0
        yield (
            shot.pasted(found),
            X_WO,
            "" if agrees >= _DIFFERS else f"colours and mesh agree by {agrees:.2f} (IoU) only",
        )


def _hidden(
    lab: np.ndarray, outline: np.ndarray, pusher: np.ndarray, above: np.ndarray, counts: np.ndarray
) -> np.ndarray:
    """Pixels (h, w) bool of the pusher and of what holds it: above it, joined to it, not of the object's colours."""
    around = grown(outline, 20) & ~grown(outline, 2)
    unlike = (evidence(lab, counts, histogram(lab, around | pusher)) < _UNLIKE) & outline & above & ~pusher
    unlike &= ~in_the_shade(lab, unlike, outline & ~pusher & ~unlike)
    _, labels = cv2.connectedComponents((unlike | pusher).astype(np.uint8))
    touching = np.unique(labels[grown(pusher, 1) & (labels > 0)])
    return pusher | np.isin(labels, touching[touching > 0])


def in_the_shade(lab: np.ndarray, unlike: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Parts (h, w) bool that pass into the rest of the object without an edge: its own side in the shade.

    Args:
        lab: (h, w, 3) uint8, the image in Lab.
        unlike: (h, w) bool, pixels within the outline that have not the object's colours.
        rest: (h, w) bool, the others.
    """
    number, labels = cv2.connectedComponents(unlike.astype(np.uint8))
    shaded, beside = np.zeros_like(unlike), _mean_around(lab, rest)
    for part in (labels == k for k in range(1, number)):
        border = grown(part, 1) & rest
        if border.any():
            step = _mean_around(lab, part)[border] - beside[border]
            if np.median(np.linalg.norm(step, axis=1)) < _EDGE:
                shaded |= part
    return shaded


def _mean_around(lab: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Mean colours (h, w, 3) of the pixels of a mask within `_NEAR` px."""
    size, share = (2 * _NEAR + 1,) * 2, mask.astype(np.float32)
    sums = cv2.boxFilter(lab.astype(np.float32) * share[..., None], -1, size)
    return sums / np.maximum(cv2.boxFilter(share, -1, size), 1e-6)[..., None]


def _held(pusher: trimesh.Trimesh, X_WP: np.ndarray, height: float) -> trimesh.Trimesh:
    """Room [m, world] where what holds a pusher may be: above it, and wider than it."""
    low = pusher.vertices @ X_WP[:3, :3].T + X_WP[:3, 3]
    middle = low.mean(axis=0)
    wide = middle + (low - middle) * [_WIDER, _WIDER, 1]
    return trimesh.convex.convex_hull(np.concatenate([wide, wide + np.array([0, 0, height])]))


def _ahead(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Pose (4, 4) after another step like the one from `before` to `now`, in x, y and yaw."""
    step = Rotation.from_matrix(now[:3, :3] @ before[:3, :3].T).as_rotvec()[2]
    ahead = now.copy()
    ahead[:3, :3] = Rotation.from_rotvec([0, 0, step]).as_matrix() @ now[:3, :3]
    ahead[:2, 3] += now[:2, 3] - before[:2, 3]
    return ahead
