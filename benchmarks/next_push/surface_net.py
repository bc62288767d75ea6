# SPDX-License-Identifier: MIT
"""Surface of a field of signed distances, as a mesh: what a scanner's software makes of its volume."""

import numpy as np


def surface_net(field: np.ndarray, spacing: float, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the closed surface where a field on a grid changes its sign.

    Args:
        field: (nx, ny, nz) m, negative inside; positive all over the border of the grid, nowhere 0.
        spacing: m, of the grid.
        origin: (3,) m, place of the grid's first point.

    Returns:
        Corners (n, 3) m and triangles (m, 3), turned outwards.

    Source: S. Gibson, "Constrained elastic surface nets", MICCAI 1998, without the relaxation: the corner of a cell is
        the mean of the places where the cell's edges meet the surface.
    """
    inside = field < 0
    shape = np.array(field.shape)
    total, count = np.zeros((*(shape - 1), 3)), np.zeros(shape - 1)
    for axis in range(3):
        low, high = _ends(field, axis)
        at = np.argwhere((low < 0) != (high < 0))
        share = low[tuple(at.T)] / (low[tuple(at.T)] - high[tuple(at.T)])
        place = at + share[:, None] * np.eye(3)[axis]
        for cell in _cells(at, axis):
            np.add.at(total, tuple(cell.T), place)
            np.add.at(count, tuple(cell.T), 1)
    crossed = count > 0
    number = np.full(shape - 1, -1)
    number[crossed] = np.arange(crossed.sum())
    corners = origin + spacing * total[crossed] / count[crossed][:, None]
    quads = []
    for axis in range(3):
        low, high = _ends(inside, axis)
        at = np.argwhere(low != high)
        around = np.stack([number[tuple(cell.T)] for cell in _cells(at, axis)], axis=1)
        outwards = low[tuple(at.T)]  # the surface faces up the axis
        quads.append(np.where(outwards[:, None], around, around[:, ::-1]))
    loops = np.concatenate(quads)
    return corners, np.concatenate([loops[:, [0, 1, 2]], loops[:, [0, 2, 3]]])


def _ends(values: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Values at the lower and upper ends of all grid edges along an axis."""
    length = values.shape[axis]
    return np.take(values, range(length - 1), axis), np.take(values, range(1, length), axis)


def _cells(edges: np.ndarray, axis: int) -> list[np.ndarray]:
    """Return the four cells (n, 3) around each edge (n, 3) along an axis, counter-clockwise seen from its upper end."""
    u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
    return [edges - u - v, edges - v, edges, edges - u]
