# SPDX-License-Identifier: MIT
"""Hulls whose sides stand upright under a flat top: one outline of all heights, with straight sides and sharp corners.

Outlines of masks waver by a pixel, which turns the normals of a hull's sides by some 7 degrees: as much as a friction
of 0.12. What the heights have in common wavers less, and lines are fitted to what is straight in it.
"""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import manifold3d
import numpy as np
from scipy import ndimage

from pinwm_drake.geometry.hull.visual import Grid, focal_length

_ALIKE, _ENDS_ALIKE = 0.95, 0.8  # least overlap of a height's section with the common outline; near foot and top
_NEAR = 0.15  # of the height, where outlines that waver round off the edges of foot and top
_LEVELS = 4  # fewest heights
_TIGHT = 30  # percentile of the heights' sections, for the outline: hulls bulge half-way up between photos
_BAND = 3.0  # voxels around an outline that count
_PIXELS = 4.0  # by which outlines may waver; that or a voxel is the unit of what follows
_KNOB, _CRUMB = 2.0, 3e-3  # units that a knob or flange sticks out; share of the voxels that may
_FLAT = 1.5  # units, in which eight of ten heights of a top lie
_ROUND = 0.35, 1.2  # units, rms and largest distance of a circle's outline
_SIDES = 64  # of a circle
_STRAIGHT, _LONG = 0.7, 6.0  # units: how far a straight side wavers, and how long it is
_ENDS = 0.15  # of a side at each end, which the corner rounds off
_BOW = 0.12  # units by which the middle of an arc leaves the chord of its middle three fifths
_BEYOND = 3.0  # units of a corner from where the outline turns
_CURVED = 1.5, 0.1  # units: smoothing of what is no straight side, and its polygon's distance


def upright(
    values: np.ndarray, grid: Grid, floor: float, projections: Sequence[np.ndarray]
) -> manifold3d.Manifold | None:
    """Prism that a hull is; None for a hull with other sides, or with a top that is not flat and level.

    Args:
        values: (grid.shape) m, distances from the surface of the hull, positive inside.
        grid: Its points.
        floor: Height of the table, m, world.
        projections: (3, 4) each, of the photos of the masks.
    """
    voxel = grid.voxel
    pixels = [size for P in projections if (size := _pixel(P, grid)) > 0.0]
    unit = max(voxel, _PIXELS * float(np.median(pixels))) if pixels else voxel
    areas = (values > 0.0).sum(axis=(0, 1))
    foot = grid.level_above(floor)
    filled = areas[foot:][areas[foot:] > 0]
    if not len(filled):
        return None
    head = int(np.flatnonzero(areas > 0.5 * np.median(filled))[-1])
    if head - foot < _LEVELS:
        return None
    sections = values[:, :, foot:head]
    tight, common = np.percentile(np.clip(sections, -_BAND * voxel, _BAND * voxel), [_TIGHT, 50], axis=2)
    inside = common > 0.0
    stack = np.moveaxis(sections > 0.0, 2, 0)
    overlaps = (stack & inside).sum(axis=(1, 2)) / np.maximum((stack | inside).sum(axis=(1, 2)), 1)
    ends = int(np.ceil(_NEAR * len(overlaps)))
    if overlaps.min() < _ENDS_ALIKE or overlaps[ends:-ends].min() < _ALIKE:
        return None
    deep = common > 0.99 * min(_BAND * voxel, common.max())
    heights = np.array([_height(column) for column in values[deep][:, foot:]]) * voxel + grid.low[2] + foot * voxel
    if np.ptp(np.percentile(heights, [10, 90])) > _FLAT * unit:
        return None
    top = float(np.median(heights))
    if _sticks_out(values, common, grid, foot, top, _KNOB * unit):
        return None
    outlines = [_straightened(points, unit) for points in _contours(tight, grid)]
    made = manifold3d.CrossSection([o for o in outlines if len(o) > 2], manifold3d.FillRule.EvenOdd)
    if made.area() <= 0.0:
        return None
    return manifold3d.Manifold.extrude(made, top - floor).translate([0.0, 0.0, floor])


def _sticks_out(values: np.ndarray, common: np.ndarray, grid: Grid, foot: int, top: float, most: float) -> bool:
    """Flag: more than a crumb of a hull is over the top, or beside the common outline, by more than `most` [m]."""
    z = grid.low[2] + grid.voxel * np.arange(grid.shape[2])
    inside = values > 0.0
    over = inside[:, :, z > top + most]
    away = ndimage.distance_transform_edt(common <= 0.0) * grid.voxel
    beside = inside[:, :, foot:] & (away > most)[:, :, None]
    return bool(over.sum() + beside.sum() > _CRUMB * inside.sum())


def _pixel(P: np.ndarray, grid: Grid) -> float:
    """Size of a pixel at the middle of a grid, m; negative behind the camera."""
    middle = grid.low + 0.5 * grid.voxel * (np.array(grid.shape) - 1)
    return float(P[2, :3] @ middle + P[2, 3]) / focal_length(P)


def _height(column: np.ndarray) -> float:
    """Index, with its share, at which a column (n,) ends to be inside."""
    k = int(np.flatnonzero(column > 0.0)[-1]) if (column > 0.0).any() else 0
    if k + 1 == len(column):
        return float(k)
    return k + float(column[k] / (column[k] - column[k + 1]))


def _contours(common: np.ndarray, grid: Grid) -> list[np.ndarray]:
    """Closed lines (n, 2) [m] on which a field (nx, ny) is 0."""
    finer = 8
    fine = ndimage.zoom(common.astype(np.float64), finer, order=1, grid_mode=False)
    scale = (np.array(fine.shape) - 1) / (np.array(common.shape) - 1)
    lines, _ = cv2.findContours((fine > 0.0).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return [grid.low[:2] + grid.voxel * line[:, 0, ::-1] / scale for line in lines if len(line) > 4 * finer]


def _straightened(points: np.ndarray, unit: float) -> np.ndarray:
    """Polygon (m, 2) of a closed line (n, 2): a circle, or lines where it is straight and a smooth one elsewhere."""
    center, radius, off = _circle(points)
    if np.sqrt((off**2).mean()) < _ROUND[0] * unit and np.abs(off).max() < _ROUND[1] * unit:
        angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
        return np.asarray(center + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    turns = _needed(points, _STRAIGHT * unit, closed=True)
    smooth = ndimage.gaussian_filter1d(points, _CURVED[0] * unit / _spacing(points), axis=0, mode="wrap")
    runs = [np.arange(a, b + 1) % len(points) for a, b in pairwise([*turns, turns[0] + len(points)])]
    lines = [_line(points[run]) if _is_straight(points[run], unit) else None for run in runs]
    made: list[np.ndarray] = []
    for k, run in enumerate(runs):
        before, line, at = lines[k - 1], lines[k], points[run[0]]
        if before is not None and line is not None:
            made += _corner(before, line, at, _BEYOND * unit)
        elif before is not None or line is not None:
            known = before if before is not None else line
            assert known is not None
            made.append(known[0] + known[1] * float((at - known[0]) @ known[1]))
        if line is None:
            inner = smooth[run[1:-1]] if len(run) > 2 else np.empty((0, 2))
            made += list(inner[_needed(inner, _CURVED[1] * unit, closed=False)])
    return np.array(made)


def _spacing(points: np.ndarray) -> float:
    """Mean distance [m] between neighbours on a closed line (n, 2)."""
    return float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).mean())


def _circle(points: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Centre, radius and distances (n,) from it of the circle of least squares."""
    middle = points.mean(axis=0)
    p = points - middle
    x, y, c = np.linalg.lstsq(np.column_stack([2 * p, np.ones(len(p))]), (p**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(c + x * x + y * y, 0.0)))
    return middle + np.array([x, y]), radius, np.linalg.norm(p - [x, y], axis=1) - radius


def _needed(points: np.ndarray, most: float, *, closed: bool) -> list[int]:
    """Numbers, in their order, of the points (n, 2) [m] from whose polygon a line departs by `most` [m] at the most."""
    if len(points) < 3:
        return list(range(len(points)))
    kept = cv2.approxPolyDP((points - points[0]).astype(np.float32)[:, None], most, closed=closed)[:, 0] + points[0]
    return sorted({int(np.argmin(((points - one) ** 2).sum(axis=1))) for one in kept})


def _is_straight(points: np.ndarray, unit: float) -> bool:
    """Flag: an open line (n, 2) [m] is long and has no bow, as an arc has."""
    chord = points[-1] - points[0]
    length = float(np.linalg.norm(chord))
    if length <= _LONG * unit or len(points) < 8:
        return False
    across = (points - points[0]) @ np.array([-chord[1], chord[0]]) / length
    fifths = [float(part.mean()) for part in np.array_split(across, 5)]
    return abs(fifths[2] - 0.5 * (fifths[1] + fifths[3])) < _BOW * unit and abs(fifths[2]) < _STRAIGHT * unit


def _line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point (2,) and direction (2,) of the line of least squares through what is between two corners."""
    cut = int(_ENDS * len(points))
    inner = points[cut : len(points) - cut]
    middle = inner.mean(axis=0)
    along = np.linalg.svd(inner - middle, full_matrices=False)[2][0]
    return middle, along if along @ (points[-1] - points[0]) > 0 else -along


def _corner(
    before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray], at: np.ndarray, most: float
) -> list[np.ndarray]:
    """Where two lines meet; their points nearest to `at` where that is farther away than `most`."""
    across = before[1][0] * after[1][1] - before[1][1] * after[1][0]
    if abs(across) > 0.1:
        d = after[0] - before[0]
        meet = before[0] + before[1] * float((d[0] * after[1][1] - d[1] * after[1][0]) / across)
        if np.linalg.norm(meet - at) < most:
            return [meet]
    return [line[0] + line[1] * float((at - line[0]) @ line[1]) for line in (before, after)]
