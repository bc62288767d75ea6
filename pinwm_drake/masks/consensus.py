# SPDX-License-Identifier: MIT
"""Masks of a thing on a table without a mesh: what differs from the table, agrees in all photos, and has an edge."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pinwm_drake.geometry.hull.visual import Grid, carve, parts
from pinwm_drake.masks import grabcut, plane
from pinwm_drake.masks.colours import evidence, histogram
from pinwm_drake.masks.grabcut import cut_out, grown
from pinwm_drake.masks.shots import CloseUp

Segmenter = Callable[[CloseUp, np.ndarray, tuple[float, float, float, float]], np.ndarray]
"""Mask (h, w) bool of a photo, from a point (2,) and a box (left, top, right, bottom) [px] on and around the object."""

_VOXELS = 72  # along the diameter of the ball in which the thing is looked for
_ROUNDS = ((4, 8), (2, 6))  # photos that may miss a point of the hull, of 24: at first, and where nothing is left
_OF = 24
_LOWEST = 3  # layers of the grid, one of which a thing on the table reaches
_LIFT = 1e-3  # m, of the lowest points above the table
_BEYOND = 0.5  # of the radius: how fast a part counts less with its distance from the middle
_SURE = 0.4  # of the threshold: a pixel that differs less is table
_ON_TABLE = 0.7  # share of the ring around the hull that is table: the others have the room behind the thing
_KEPT = 0.5  # of the points of a hull: where fewer are left, the thing has the colours of the table
# Pixels: from the hull to the middle of the ring and its width; around the hull; sure ones within hull and mask; and
# depth in the hull, of the largest, that is sure.
_RING, _NEAR, _SURROUNDINGS, _INNER, _DEEP = (4, 12), 4, 25, 4, 0.6
_PART, _LIKE = 0.005, 0.3  # of the hull: size of a part that GrabCut left out; share of it with the object's colours


@dataclass(frozen=True, eq=False)
class Consensus:
    """Masks and the hull that they have in common.

    Attributes:
        masks: (h, w) bool of each close-up.
        outlines: (h, w) bool of each: where the hull is.
        points: (n, 3) m, world: points of the hull.
        voxel: m, between them.
        apart: Points (n, 3) [m] of the parts that the hull falls into where every photo is right, the largest first.
        rivals: Size of every other part that the photos agree on, as a share of the hull, and its middle (3,) [m].
        earlier: The masks of each round before: what differs from the table, and what GrabCut first made of it.
    """

    masks: list[np.ndarray]
    outlines: list[np.ndarray]
    points: np.ndarray
    voxel: float
    apart: list[np.ndarray]
    rivals: list[tuple[float, np.ndarray]]
    earlier: list[list[np.ndarray]]


def consensus(
    shots: Sequence[CloseUp],
    middle: np.ndarray,
    radius: float,
    floor: float,
    known: Mapping[int, np.ndarray],
    segmenter: Segmenter | None = None,
) -> Consensus:
    """Find the masks of a thing on a table.

    Args:
        shots: Close-ups of the same place.
        middle: (3,) m, world: where the thing is, more or less.
        radius: m, of a ball around it that holds the thing.
        floor: Height of the table, m, world.
        known: Masks (h, w) bool that are right, by the number of the shot.
        segmenter: Network that takes the place of table and GrabCut; or None.
    """
    projections = [shot.P for shot in shots]
    low = np.array([middle[0] - radius, middle[1] - radius, floor + _LIFT])
    high = np.array([middle[0] + radius, middle[1] + radius, floor + 2 * radius])
    grid = Grid.between(low, high, 2 * radius / _VOXELS)
    differences: list[np.ndarray] = []
    least = 0.0
    if segmenter is None:
        differences = plane.differences(shots, floor)
        least = plane.threshold(differences)
        masks = [_cleaned(layer > least) for layer in differences]
    else:
        masks = [_asked(segmenter, shot, middle, radius) for shot in shots]
    masks = [known.get(k, mask) for k, mask in enumerate(masks)]
    found: Consensus | None = None
    earlier: list[list[np.ndarray]] = []
    for misses in _ROUNDS:
        votes: list[np.ndarray] = list(masks)
        if found is None and segmenter is None:  # what the other photos do not show says nothing
            for k in set(range(len(masks))) - known.keys():
                votes[k] = np.where(differences[k] >= plane.UNSEEN, np.float32(-1), masks[k])
        points, rivals = _hull(votes, projections, grid, misses, middle, sorted(known))
        if found is not None and len(points) < _KEPT * len(found.points):
            break
        outlines, earlier = [outline_of(shot, points, grid.voxel) for shot in shots], [*earlier, masks]
        if segmenter is not None:
            masks = [mask & grown(hull, 2 * _NEAR) for mask, hull in zip(masks, outlines, strict=True)]
        else:
            masks = _cut(shots, masks, outlines, differences, least, known, found is None)
        found = Consensus(masks, outlines, points, grid.voxel, [], rivals if found is None else found.rivals, earlier)
    assert found is not None
    sharp = list(found.masks)
    for k in range(len(differences)):
        sharp[k] = sharp[k] if k in known else sharp[k] & (differences[k] > least)  # without the closing of gaps
    return replace(found, apart=_apart(sharp, projections, found.points, grid.voxel))


def _cut(
    shots: Sequence[CloseUp],
    masks: Sequence[np.ndarray],
    outlines: Sequence[np.ndarray],
    differences: Sequence[np.ndarray],
    least: float,
    known: Mapping[int, np.ndarray],
    first: bool,
) -> list[np.ndarray]:
    """Masks by GrabCut; what stands before the room gets the colours that the photos before the table show."""
    plain = [_on_table(hull, layer < least) for hull, layer in zip(outlines, differences, strict=True)]
    cut, colours = list(masks), [cv2.cvtColor(shot.image, cv2.COLOR_RGB2LAB) for shot in shots]
    if first:
        for k in {k for k, on_table in enumerate(plain) if on_table} - known.keys():
            table = differences[k] < _SURE * least
            cut[k] = cut_out(shots[k].image, _guess_by_table(outlines[k], masks[k], table))
    sources = [k for k, on_table in enumerate(plain) if on_table or k in known] or range(len(shots))
    counts = np.sum([histogram(colours[k], cut[k]) for k in sources], axis=0)
    for k, shot in enumerate(shots):
        if k not in known and not (first and plain[k]):
            guess = guess_by_colours(colours[k], outlines[k], cut[k] if plain[k] else None, counts)
            cut[k] = cut_out(shot.image, guess)
            if not plain[k]:
                cut[k] |= room_coloured(colours[k], outlines[k], cut[k], counts)
    return cut


def room_coloured(lab: np.ndarray, hull: np.ndarray, mask: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Parts (H, W) bool of the object that GrabCut took for the room, whose colours are not those beside them.

    GrabCut knows the room's colours, not their places: a part of the object with the colour of a thing elsewhere is
    left out.

    Args:
        lab: (H, W, 3) uint8, the photo in Lab.
        hull: (H, W) bool, the outline of the hull.
        mask: (H, W) bool, what GrabCut found.
        counts: Histogram of the object's colours.
    """
    number, labels = cv2.connectedComponents((grown(hull, -1) & ~mask).astype(np.uint8), connectivity=4)
    found, outside, least = np.zeros_like(mask), ~grown(hull, _RING[0]), _PART * hull.sum()
    for part in (labels == k for k in range(1, number)):
        beside = grown(part, _RING[1]) & outside
        if part.sum() >= least and beside.any():
            like = part & (evidence(lab, counts, histogram(lab, beside)) > 0)
            like &= grown(grown(like, -1), 1)
            if like.sum() >= max(least, _LIKE * part.sum()):
                found |= like
    return found


def _hull(
    masks: Sequence[np.ndarray],
    projections: Sequence[np.ndarray],
    grid: Grid,
    misses: Sequence[int],
    middle: np.ndarray,
    known: Sequence[int],
) -> tuple[np.ndarray, list[tuple[float, np.ndarray]]]:
    """Points of the part of the hull that is large and near the middle, and the other parts; see `Consensus`.

    Nothing is outside of the masks of the photos in `known`.
    """
    sure = carve([masks[k] for k in known], [projections[k] for k in known], grid, 0, 0.0)
    for allowed in misses:
        flags = carve(masks, projections, grid, round(allowed * len(masks) / _OF)) & sure
        if flags.any():
            break
    labels, sizes = parts(flags)
    if not len(sizes):
        return np.zeros((0, 3)), []
    stands = np.isin(np.arange(1, len(sizes) + 1), labels[:, :, :_LOWEST])  # what hovers is no thing on a table
    sizes = np.where(stands, sizes, 0)
    if not sizes.any():
        return np.zeros((0, 3)), []
    points, labels = grid.points(), labels.ravel()
    middles = np.array([points[labels == k + 1].mean(axis=0) for k in range(len(sizes))])
    reach = _BEYOND * 0.5 * grid.voxel * _VOXELS
    best = int(np.argmax(sizes * np.exp(-np.linalg.norm(middles[:, :2] - middle[:2], axis=1) / reach)))
    rivals = [(sizes[k] / sizes[best], middles[k]) for k in range(len(sizes)) if k != best]
    return points[labels == best + 1].astype(float), rivals


def outline_of(shot: CloseUp, points: np.ndarray, voxel: float) -> np.ndarray:
    """Where the points of a hull are seen, (h, w) bool: each is a square as large as a voxel looks."""
    seen = np.zeros(shot.shape, bool)
    if not len(points):
        return seen
    at, depths = shot.project(points)
    at = np.round(at[depths > 0]).astype(int)
    at = at[(at >= 0).all(axis=1) & (at < shot.shape[::-1]).all(axis=1)]
    seen[at[:, 1], at[:, 0]] = True
    return grown(seen, int(0.5 * voxel * shot.K[0, 0] / np.median(depths) + 1))


def _apart(
    masks: Sequence[np.ndarray], projections: Sequence[np.ndarray], points: np.ndarray, voxel: float
) -> list[np.ndarray]:
    """Points (n, 3) [m] of the parts of a hull that no mask (h, w) bool cuts, the largest first."""
    rows = [k for k, mask in enumerate(masks) if mask.any()]
    if not len(points) or not rows:
        return []
    grid = Grid.between(points.min(axis=0), points.max(axis=0), voxel)
    flags = carve([masks[k] for k in rows], [projections[k] for k in rows], grid, 0)
    labels, sizes = parts(flags, corners=False)
    return [grid.points()[labels.ravel() == k + 1].astype(float) for k in np.argsort(-sizes, kind="stable")]


def _cleaned(mask: np.ndarray) -> np.ndarray:
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    return cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0


def _on_table(hull: np.ndarray, table: np.ndarray) -> bool:
    ring = grown(hull, _RING[1]) & ~grown(hull, _RING[0])
    return bool(ring.any() and table[ring].mean() > _ON_TABLE)


def _guess_by_table(hull: np.ndarray, mask: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Guess for GrabCut from what differs from the table; all masks (H, W) bool."""
    near = grown(hull, 2 * _NEAR)
    guess = np.full(hull.shape, grabcut.BACKGROUND, np.uint8)
    guess[near] = grabcut.MAYBE_BACKGROUND
    guess[hull | (near & mask)] = grabcut.MAYBE_OBJECT
    guess[near & ~mask & ~hull & table] = grabcut.BACKGROUND
    guess[grown(hull & mask, -_INNER)] = grabcut.OBJECT
    return guess


def guess_by_colours(lab: np.ndarray, hull: np.ndarray, mask: np.ndarray | None, counts: np.ndarray) -> np.ndarray:
    """Guess for GrabCut around the outline of a hull or mesh.

    Args:
        lab: (H, W, 3) uint8, the photo in Lab.
        hull: (H, W) bool, the outline.
        mask: (H, W) bool, a mask that is nearly right; None for colours alone.
        counts: Histogram of the object's colours.
    """
    near = grown(hull, _NEAR)
    if mask is None:
        around = grown(hull, _SURROUNDINGS) & ~near
        mask = evidence(lab, counts, histogram(lab, around)) > 0
    guess = np.full(hull.shape, grabcut.BACKGROUND, np.uint8)
    guess[near] = grabcut.MAYBE_BACKGROUND
    guess[near & mask] = grabcut.MAYBE_OBJECT
    guess[grown(hull & mask, -_INNER)] = grabcut.OBJECT
    depth = cv2.distanceTransform(hull.astype(np.uint8), cv2.DIST_L2, 5)
    guess[depth > _DEEP * max(float(depth.max()), 1.0)] = grabcut.OBJECT
    return guess


def _asked(segmenter: Segmenter, shot: CloseUp, middle: np.ndarray, radius: float) -> np.ndarray:
    """Mask by a network, which is told the middle and a box around the ball."""
    left, top, right, bottom = shot.around(middle, radius)
    (point,), _ = shot.project(middle[None])
    return segmenter(shot, point, (left, top, right, bottom))
