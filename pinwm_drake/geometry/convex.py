# SPDX-License-Identifier: MIT
"""Objects as unions of convex pieces: decomposed meshes, and the two objects of the tasks exactly."""

import numpy as np
import trimesh

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.meshes import outer_mesh
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.shapes import box, convex_hull


def decompose(
    mesh: trimesh.Trimesh, *, threshold: float = 0.05, max_pieces: int = 32, seed: int = 0
) -> list[ConvexPiece]:
    """Approximates a mesh by convex pieces that leave its hollows open, but fill its closed voids.

    Args:
        mesh: Watertight, m.
        threshold: Concavity that a piece may keep, 0.01 to 1, as a fraction of the mesh's extent: smaller
            follows the mesh more closely with more pieces.
        max_pieces: No more pieces than this; reaching it can close hollows.
        seed: Seed of the search. The same seed gives the same pieces.

    Returns:
        The pieces, frame of the mesh.

    Raises:
        GeometryError: A mesh that is not watertight, or an argument out of its range.

    Source: X. Wei et al., "Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity and
    Tree Search", ACM ToG 41(4), 2022; the package coacd.
    """
    if not 0.01 <= threshold <= 1.0:
        raise GeometryError(f"threshold of decompose is {threshold}; allowed: 0.01 to 1")
    if max_pieces < 1:
        raise GeometryError(f"max_pieces of decompose is {max_pieces}; allowed: 1 or more")
    try:
        mesh = outer_mesh(mesh)
    except GeometryError as error:
        raise GeometryError(f"decompose got {error}; allowed: watertight, two faces at every edge") from error
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)),
        threshold=threshold,
        max_convex_hull=max_pieces,
        seed=seed,
    )
    return [convex_hull(np.asarray(vertices)) for vertices, _ in parts]


def t_block() -> list[ConvexPiece]:
    """Return the T-block: bar 100 x 40 mm, stem 40 x 100 mm, 50 mm thick.

    Returns:
        Bar and stem in the body frame B: z is the thickness, the bar is along x at -y, the stem points to +y.
        Both have the same volume, so that the origin, half way between their centres, is the centre of mass.
    """
    bar = box(np.array([0.1, 0.04, 0.05]), (np.eye(3), np.array([0.0, -0.035, 0.0])))
    stem = box(np.array([0.04, 0.1, 0.05]), (np.eye(3), np.array([0.0, 0.035, 0.0])))
    return [bar, stem]


def hollow_mug(
    length: float = 0.08, diameter: float = 0.08, wall: float = 0.004, segments: int = 16
) -> list[ConvexPiece]:
    """Return a mug without handle: a base, and a wall of segments; its inside is open.

    The outline is a regular polygon with a corner on the x axis, inscribed in the circle of the diameter; the
    inside is the same polygon, smaller by the wall at its corners.

    Args:
        length: m. Along z of B, base included.
        diameter: m. Across the corners of the outline.
        wall: m. Thickness of wall and base.
        segments: Number of segments of the wall, 3 or more.

    Returns:
        The base, then the segments, in the body frame B: z is the axis, the base is at -z and the opening at
        +z. The origin is the centre of mass for a uniform density (see `mug_center`).

    Raises:
        GeometryError: A length that is not positive, a wall that leaves no inside, or fewer than 3 segments.
    """
    if not isinstance(segments, int) or segments < 3:
        raise GeometryError(f"segments of a mug are {segments}; allowed: a whole number of 3 or more")
    bottom = -mug_center(length, diameter, wall)
    angles = 2.0 * np.pi * np.arange(segments + 1) / segments
    outline = np.column_stack([np.cos(angles), np.sin(angles)])
    # The last corner is the first one exactly.
    outline[-1] = outline[0]
    outer, inner = 0.5 * diameter * outline, (0.5 * diameter - wall) * outline
    pieces = [_prism(outer[:-1], bottom, bottom + wall)]
    for k in range(segments):
        corners = np.array([inner[k], outer[k], outer[k + 1], inner[k + 1]])
        pieces.append(_prism(corners, bottom + wall, bottom + length))
    return pieces


def mug_center(length: float = 0.08, diameter: float = 0.08, wall: float = 0.004) -> float:
    """Height [m] of a mug's centre of mass over the underside of its base, with lengths [m] as for `hollow_mug`.

    Raises:
        GeometryError: A length that is not positive, or a wall that leaves no inside.
    """
    if not (0.0 < wall < length and wall < 0.5 * diameter and np.isfinite(length + diameter)):
        raise GeometryError(
            f"a mug of length {length}, diameter {diameter}, wall {wall} has no inside; "
            "allowed: a positive wall below the length and below half the diameter"
        )
    # Outer prism minus the hollow, in units of the outer cross section.
    hollow = (1.0 - 2.0 * wall / diameter) ** 2 * (length - wall)
    return float((0.5 * length**2 - hollow * 0.5 * (length + wall)) / (length - hollow))


def _prism(outline: np.ndarray, low: float, high: float) -> ConvexPiece:
    """Return the prism over a convex polygon (n, 2), counter-clockwise, m, between two heights."""
    ends = [np.column_stack([outline, np.full(len(outline), z)]) for z in (low, high)]
    return convex_hull(np.concatenate(ends))
