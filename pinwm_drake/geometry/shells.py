# SPDX-License-Identifier: MIT
"""Closed shells of a triangle soup, judged by positions and not by the indices of a file."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pinwm_drake.errors import GeometryError

_JOIN = 1e-6  # of the largest extent: corners nearer to each other are one
_FLAT = 1e-12  # of the squared extent: a face of less area has none
_LEVEL = 1e-6  # rad: faces at an edge that differ by less lie on each other


@dataclass(frozen=True, eq=False)
class Shell:
    """A closed surface in one piece: each directed edge has one face on it, and one face on its reverse.

    Attributes:
        vertices: (n, 3) m.
        faces: (m, 3) int, wound as in the file.
        name: What to call it in a message.
    """

    vertices: np.ndarray
    faces: np.ndarray
    name: str = "part 1"

    @property
    def volume(self) -> float:
        """Volume inside [m^3]; negative where the faces are wound inwards."""
        corners = (self.vertices - self.vertices.mean(axis=0))[self.faces]
        return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)

    @property
    def bounds(self) -> np.ndarray:
        """Lowest and highest coordinates, (2, 3) m."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def turned(self) -> "Shell":
        """Return the shell with its faces wound the other way."""
        return Shell(self.vertices, np.ascontiguousarray(self.faces[:, ::-1]), self.name)


def closed_shells(vertices: np.ndarray, faces: np.ndarray) -> list[Shell]:
    """Split triangles into closed shells; where four faces or more meet at an edge, each shell keeps its own.

    Corners at the same position are one, whatever seams of materials or texture a file has. A face on which two corners
    are one is left out. So are a second copy of a face and a face without area, where the surface is closed without.

    Args:
        vertices: (n, 3) m, finite.
        faces: (m, 3) int.

    Returns:
        The shells, sorted by their bounds; a corner where shells meet is in each of them.

    Raises:
        GeometryError: The surface is open, or faces at an edge are wound against each other; the message is a phrase.
    """
    points, label = _joined(vertices)
    faces = label[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    whole, faces = faces, next((some for some in _candidates(points, faces) if _is_closed(some)), faces)
    if not len(faces) or not _is_closed(faces):
        raise GeometryError(_opening(points, whole))
    mates = _mates(points, faces)
    count = len(faces)
    _, shell = connected_components(_links(mates // 3, count), directed=False)
    # Corners that paired edges share; an edge goes from corner e to the next one of its face.
    after = np.arange(3 * count).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    same = np.concatenate([np.stack([mates[0], after[mates[1]]]), np.stack([after[mates[0]], mates[1]])], axis=1)
    _, corner = connected_components(_links(same, 3 * count), directed=False)
    corners, flat = corner.reshape(-1, 3), faces.ravel()
    position = np.zeros(corner.max() + 1, int)
    position[corner] = flat
    shells = []
    for number in range(shell.max() + 1):
        mine = corners[shell == number]
        used = np.unique(mine)
        used = used[np.argsort(position[used], kind="stable")]
        index = np.zeros(len(position), int)
        index[used] = np.arange(len(used))
        shells.append(Shell(points[position[used]], index[mine]))
    return sorted(shells, key=lambda shell: tuple(shell.bounds.ravel()))


def _joined(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (k, 3) in the order of a file, and the number of each vertex among them (n,)."""
    _, first, label = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    near = cKDTree(vertices[first]).query_pairs(_JOIN * float(np.ptp(vertices, axis=0).max()), output_type="ndarray")
    _, group = connected_components(_links(near.T, len(first)), directed=False)
    label = group[label.ravel()]
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[label.ravel()]


def _links(pairs: np.ndarray, count: int) -> coo_array:
    return coo_array((np.ones(pairs.shape[1], bool), (pairs[0], pairs[1])), shape=(count, count))


def _candidates(points: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """Return faces (m, 3) without second copies, without those and faces of no area, and all of them."""
    start = np.argmin(faces, axis=1)
    turned = np.stack([faces[np.arange(len(faces)), (start + k) % 3] for k in range(3)], axis=1)
    once = faces[np.sort(np.unique(turned, axis=0, return_index=True)[1])]
    corners = points[once]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return [once, once[area > _FLAT * np.ptp(points, axis=0).max() ** 2], faces]


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of each face's edges without direction (3m,), alike for alike ones, and the direction, ±1."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    _, key = np.unique(np.sort(ends, axis=1) @ [int(faces.max()) + 1, 1], return_inverse=True)
    return key.ravel(), np.where(ends[:, 0] < ends[:, 1], 1, -1)


def _is_closed(faces: np.ndarray) -> bool:
    if not len(faces):
        return False
    key, direction = _edges(faces)
    return not np.bincount(key, weights=direction).any()


def _opening(points: np.ndarray, faces: np.ndarray) -> str:
    """Say why a surface is not closed, and where."""
    if not len(faces):
        return "no faces that have an area"
    _, number, copies = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    key, direction = _edges(faces)
    balance, count = np.bincount(key, weights=direction), np.bincount(key)
    wrong = np.flatnonzero(balance)
    edge = int(np.flatnonzero(key == wrong[0])[0])
    ends = points[[faces[edge // 3, edge % 3], faces[edge // 3, (edge + 1) % 3]]]
    where = " to ".join(f"({', '.join(f'{x:.4g}' for x in end)})" for end in ends)
    at = f"at {len(wrong)} edges, the first from {where} m"
    if (count[wrong] % 2 == 0).all():
        return f"faces wound against each other {at}"
    twice = "; a face lies on another" if (copies[number.ravel()] > 1)[np.flatnonzero(balance[key]) // 3].any() else ""
    return f"an open surface {at}{twice}"


def _mates(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs of edges (2, k) of a closed surface, one of each direction, by the number 3 * face + corner."""
    key, direction = _edges(faces)
    order = np.lexsort((direction, key))
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    plain = starts[counts == 2]
    pairs = [np.stack([order[plain], order[plain + 1]])]
    _, patch = connected_components(_links(pairs[0] // 3, len(faces)), directed=False)
    for start, count in zip(starts[counts > 2], counts[counts > 2], strict=True):
        pairs.append(_around(points, faces, order[start : start + count], direction, patch))
    return np.concatenate(pairs, axis=1)


def _around(
    points: np.ndarray, faces: np.ndarray, edges: np.ndarray, direction: np.ndarray, patch: np.ndarray
) -> np.ndarray:
    """Pairs (2, k) of the edges where four faces or more meet: those between which the material is.

    Seen along the edge, material begins at a face with the edge's reverse and ends at one with the edge. Of faces that
    lie on each other an end comes first, so that bodies that touch along a face are two. Faces of one patch, which
    other edges join, belong together.
    """
    a, b, c = (points[faces[edges // 3, (edges + k) % 3]] for k in range(3))
    sign = direction[edges]
    along = (b - a)[0] * sign[0]
    along /= np.linalg.norm(along)
    out = (c - a) - np.outer((c - a) @ along, along)
    first = out[np.linalg.norm(out, axis=1).argmax()]
    angle = np.arctan2(out @ np.cross(along, first), out @ first)
    angle = np.mod(angle + _LEVEL, 2.0 * np.pi)
    order = np.argsort(angle, kind="stable")
    level = np.cumsum(np.diff(angle[order], prepend=angle[order[0]]) > _LEVEL)
    left = order[np.lexsort((-sign[order], level))].tolist()
    part = patch[edges // 3]
    pairs: list[tuple[int, int]] = []
    begun: list[int] = []
    for _ in range(2):  # around twice: material may go on past the first face
        ends = []
        for k in left:
            if sign[k] < 0:
                begun.append(k)
            elif begun:
                start = next((j for j in reversed(begun) if part[j] == part[k]), begun[-1])
                begun.remove(start)
                pairs.append((start, k))
            else:
                ends.append(k)
        left = ends
    return edges[np.array(pairs).T]
