# SPDX-License-Identifier: MIT
"""Masks of photos of an object at rest on a table, with or without its mesh, and what is doubtful about them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import trimesh

from pinwm_drake.masks.colours import evidence, histogram
from pinwm_drake.masks.consensus import Consensus, Segmenter, consensus, outline_of
from pinwm_drake.masks.grabcut import grown
from pinwm_drake.masks.outline import edge_strength, mesh_mask, settle
from pinwm_drake.masks.shots import CloseUp, Shot, aimed_at
from pinwm_drake.masks.start_pose import Outlines, StartPose, find_start_pose, misfit

FEWEST = 6  # photos, without which nothing tells object from table
# Least and largest radius of the ball in which the object is looked for, of the distance of the cameras.
_LEAST, _REACH = 0.1, 0.31
_LONGEST = 320  # px, of the boxes that are worked on
_ROOM = 0.35  # of the radius of a mesh, around it
_FITS = 0.15  # share of differing pixels up to which the outlines of a mesh lie on the masks
_SHOWN = 0.6  # share of the object's place that has to differ from the table
_LIKE, _RING = 0.5, (4, 25)  # of the median photo: share of the object's colours; px, of the ring around its place
_SCALE, _MIRRORED = 3.0, 0.6  # ratio of sizes of two units; of the misfit, that of a mirrored mesh that is right
_RIVAL = 0.3  # of the hull: size of a second thing
_NAMED = 3  # views of one doubt
_REMEDY = "take it away, or paint the mask of a photo that shows all of the object"
_CUT_OFF = 3  # px of a mask along the border of a photo
_NARROW = 16  # px, of a box in which nothing can be told


@dataclass(frozen=True, eq=False)
class Found:
    """Masks of photos.

    Attributes:
        masks: (H, W) bool of each photo.
        doubts: Name of a photo, or "" for all of them, and the reason why its mask is doubtful.
        pose: Pose of the mesh; None without one, or where it was not found.
        hull: Points (n, 3) [m, world] of the hull of all masks.
        voxel: m, between them.
    """

    masks: list[np.ndarray]
    doubts: list[tuple[str, str]]
    pose: StartPose | None
    hull: np.ndarray
    voxel: float


def find_masks(
    shots: Sequence[Shot],
    floor: float,
    *,
    known: Mapping[int, np.ndarray] | None = None,
    mesh: trimesh.Trimesh | None = None,
    guess: np.ndarray | None = None,
    size: float | None = None,
    segmenter: Segmenter | None = None,
) -> Found:
    """Find the masks of photos of an object at rest on a table.

    Args:
        shots: The photos, `FEWEST` or more.
        floor: Height of the table, m, world.
        known: Masks (H, W) bool that are right, by the number of the photo; they stay as they are.
        mesh: The object, m, frame O; or None.
        guess: X_WO (4, 4) [m], a pose that is tried besides others; or None.
        size: Largest extent of the object, m; None for what the cameras' distance tells. A mesh tells it better.
        segmenter: Network that cuts out an object; None for table and colours.
    """
    known = dict(known or {})
    middle = aimed_at(shots)
    middle[2] = floor
    far = float(np.median([np.linalg.norm(shot.p_WC - middle) for shot in shots]))
    extent = float(np.linalg.norm(mesh.extents)) if mesh is not None else size
    low, high = _LEAST * far, _REACH * far
    radius = high if extent is None else min(max(extent, low), high)
    near = [shot.close_up(box, _LONGEST) if _wide(box := shot.around(middle, radius)) else None for shot in shots]
    rows = [k for k, shot in enumerate(near) if shot is not None]
    seen = [shot for shot in near if shot is not None]
    sure = {rows.index(k): seen[rows.index(k)].cut(mask) for k, mask in known.items() if k in rows}
    found = consensus(seen, middle, radius, floor, sure, segmenter)
    doubts = [(shots[k].name, "the camera does not look at the object") for k in range(len(shots)) if k not in rows]
    if mesh is None and size is not None and radius != size:
        taken = f"the cameras' distance of {far:.2f} m allows {low:.3f} to {high:.3f} m: {radius:.3f} m was taken"
        doubts.append(("", f"--size is {size:g} m, and {taken}"))
    pose = None if mesh is None else _posed(seen, found, mesh, floor, guess)
    masks = [np.zeros(shot.shape, bool) for shot in shots]
    for k, shot, mask in zip(rows, seen, found.masks, strict=True):
        masks[k] = shot.pasted(mask)
    plain = list(masks)
    if mesh is not None and pose is not None:
        for k, photo in enumerate(shots):
            if _wide(box := photo.box(_corners(mesh, pose.X_WO), _ROOM)):
                close = photo.close_up(box, _LONGEST)
                masks[k] = close.pasted(mesh_mask(close, mesh, pose.X_WO))
        doubts += _doubts_of_mesh(Outlines.of(shots, plain), mesh, floor, pose, found)
    masks = [known.get(k, mask) for k, mask in enumerate(masks)]
    doubts += _doubts_of_all(found, seen)
    places = found.outlines if pose is None else [shot.cut(masks[k]) for k, shot in zip(rows, seen, strict=True)]
    alike = _alike(seen, found.masks, places)
    for k, first, place, like in zip(rows, found.earlier[0], places, alike, strict=True):
        doubts += [(shots[k].name, reason) for reason in _doubts(masks[k], first, place, like)]
    return Found(masks, _summed(doubts, len(shots)), pose, found.points, found.voxel)


def _posed(
    shots: Sequence[CloseUp], found: Consensus, mesh: trimesh.Trimesh, floor: float, guess: np.ndarray | None
) -> StartPose | None:
    """Pose of a mesh by the masks of any round, and by the edges of the photos where none of them fits."""
    poses: list[StartPose] = []
    for masks in (found.masks, *reversed(found.earlier)):
        pose = find_start_pose(Outlines.of(shots, masks), mesh, floor, guess)
        if pose is not None and pose.differing < _FITS:
            return pose
        poses += [] if pose is None else [pose]
    settled = [settle(shots, mesh, X) for pose in poses for X in (pose.X_WO, *pose.rivals)]
    if guess is not None:
        settled.append(settle(shots, mesh, guess))
    if not settled:
        return None
    best = max(settled, key=lambda X: edge_strength(shots, mesh, X))
    nearest = min(poses, key=lambda pose: pose.differing, default=None)
    if nearest is None:
        return StartPose(best, 1.0, np.inf, np.inf, [])
    return StartPose(best, misfit(Outlines.of(shots, found.masks), mesh, best), nearest.place, nearest.turn, [])


def _doubts_of_all(found: Consensus, shots: Sequence[CloseUp]) -> list[tuple[str, str]]:
    if not len(found.points):
        return [("", "the photos agree on no thing on the table; check poses, floor.height and --size")]
    doubts = []
    for share, (x, y, _) in found.rivals:
        if share > _RIVAL:
            where = f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm"
            doubts.append(("", f"a second thing stands at {where}, {share:.0%} as large as the one cut out: {_REMEDY}"))
    if len(found.apart) > 1 and len(found.apart[1]) > _RIVAL * len(found.apart[0]):
        first, second = found.apart[:2]
        x, y, _ = 1e3 * second.mean(axis=0)
        sides = [[outline_of(shot, points, found.voxel) for points in (first, second)] for shot in shots]
        gap = [shot.name for shot, (one, other) in zip(shots, sides, strict=True) if not (one & other).any()]
        named = f", apart in {', '.join(gap[:_NAMED])}" if gap else ""
        share = len(second) / len(first)
        text = f"masks hold two things{named}; one is at ({x:.0f}, {y:.0f}) mm, {share:.0%} as large as the other"
        doubts.append(("", f"{text}: {_REMEDY}"))
    return doubts


def _doubts_of_mesh(
    outlines: Outlines, mesh: trimesh.Trimesh, floor: float, pose: StartPose, found: Consensus
) -> list[tuple[str, str]]:
    """Reasons to doubt that a mesh is that of the object: its size, its hand, its outlines."""
    doubts = []
    if len(found.points):
        ratio = float(np.linalg.norm(mesh.extents) / (np.linalg.norm(np.ptp(found.points, axis=0)) + found.voxel))
        if not 1 / _SCALE < ratio < _SCALE:
            return [("", f"the mesh is {ratio:.3g} times as large as the object: is it in another unit?")]
    if outlines.shots and pose.differing > _FITS:
        turned = mesh.copy()
        turned.apply_transform(np.diag([-1.0, 1.0, 1.0, 1.0]))
        other = find_start_pose(outlines, turned, floor)
        if other is not None and other.differing < _MIRRORED * pose.differing and other.differing < _FITS:
            return [("", f"the mirrored mesh fits ({other.differing:.0%} differ, not {pose.differing:.0%}): mirror it")]
        text = f"outlines of the mesh and colours differ by {pose.differing:.0%} of the object"
        doubts.append(("", f"{text}: another object, a second one beside it, or the table's colours"))
    if pose.rivals:
        doubts.append(("", f"{len(pose.rivals)} other poses of the mesh fit nearly as well: look at the pictures"))
    return doubts


def _alike(shots: Sequence[CloseUp], masks: Sequence[np.ndarray], places: Sequence[np.ndarray]) -> list[float]:
    """Share of each photo's place of the object that has the object's colours, as a share of the median photo's."""
    colours = [cv2.cvtColor(shot.image, cv2.COLOR_RGB2LAB) for shot in shots]
    counts = np.sum([histogram(lab, mask) for lab, mask in zip(colours, masks, strict=True)], axis=0)
    shares = []
    for lab, place in zip(colours, places, strict=True):
        around = histogram(lab, grown(place, _RING[1]) & ~grown(place, _RING[0]))
        shares.append(float((evidence(lab, counts, around)[place] > 0).mean()) if place.any() else 0.0)
    return [share / max(float(np.median(shares)), 1e-6) for share in shares]


def _doubts(mask: np.ndarray, first: np.ndarray, place: np.ndarray, like: float) -> list[str]:
    """Reasons to doubt a mask (H, W).

    Args:
        mask: The mask.
        first: (h, w) bool, what differs from the table.
        place: (h, w) bool, where the object should be.
        like: See `_alike`.
    """
    if not mask.any():
        return ["no pixel of the object was found"]
    border = np.ones_like(mask)
    border[1:-1, 1:-1] = False
    if (mask & border).sum() > _CUT_OFF:
        return ["the edge of the photo cuts the object off"]
    if place.any() and ((first & place).sum() < _SHOWN * place.sum() or like < _LIKE):
        return ["the table shows where the object should be: moved between photos, hidden, or of the table's colour"]
    return []


def _summed(doubts: list[tuple[str, str]], number: int) -> list[tuple[str, str]]:
    """Doubts, where one of them that most photos share is told once."""
    reasons = [reason for name, reason in doubts if name]
    common = {reason for reason in reasons if reasons.count(reason) > number / 2}
    kept = [(name, reason) for name, reason in doubts if not name or reason not in common]
    return [("", f"in {reasons.count(reason)} of {number} photos {reason}") for reason in sorted(common)] + kept


def _corners(mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
    return np.asarray(mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3])


def _wide(box: tuple[int, int, int, int]) -> bool:
    return min(box[2] - box[0], box[3] - box[1]) >= _NARROW
