# SPDX-License-Identifier: MIT
"""Surfels on the surface of a mesh, to start a fit from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
import trimesh

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.rendering.patches import EVEN, Patches, farthest, keep_inside, line_creases, spread
from pinwm_drake.rendering.surfels import MAX_DEGREE, Surfels
from pinwm_drake.rendering.views import View
from pinwm_drake.rendering.visibility import Sight, as_surfels

# Samples of the surface for each surfel that is placed, and at least so many for finding out what is seen.
_CANDIDATES, _COVER = 4, 4000


def initial_surfels(
    mesh: trimesh.Trimesh,
    views: Sequence[View],
    number: int,
    *,
    degree: int = 0,
    opacity: float = 0.9,
    crease_share: float = 0.5,
    seed: int = 0,
    num_threads: int | None = None,
) -> Surfels:
    """Surfels on that part of a mesh which some view sees, flat on it, in the mean colour of the views that see them.

    Some line the creases: long, narrow ones just inside the borders of faces, which make outlines sharp. The others
    are spread evenly over the rest. What no view sees stays empty: nothing is known about it.

    Args:
        mesh: surface of the object in O, m; its parts may touch or overlap.
        views: views of the object, at least one.
        number: number of surfels.
        degree: degree of the spherical harmonics, which are 0 beyond the constant.
        opacity: opacity of each surfel, between 0 and 1.
        crease_share: share of the surfels that line creases, where there are any; 0 to 1.
        seed: seed of the samples.
        num_threads: threads of the renderer, which finds the visible parts.

    Returns:
        `number` surfels.

    Raises:
        RenderingError: an option out of range, no view, a mesh without area, or one that no view sees.
    """
    if number < 1 or not 0 <= degree <= MAX_DEGREE or not 0.0 < opacity < 1.0 or not 0.0 <= crease_share <= 1.0:
        raise RenderingError(
            f"initial_surfels got number={number}, degree={degree}, opacity={opacity}, crease_share={crease_share}; "
            f"allowed: 1 or more, 0 to {MAX_DEGREE}, above 0 and below 1, 0 to 1"
        )
    if not views or not mesh.area > 0.0:
        raise RenderingError(
            f"initial_surfels got {len(views)} views and a mesh of {mesh.area} m^2; allowed: a view, an area above 0"
        )
    generator = np.random.default_rng(seed)
    cover = spread(mesh, max(_CANDIDATES * number, _COVER), generator)
    sights = [Sight(view, mesh, cover, num_threads) for view in views]

    def seen(patches: Patches) -> np.ndarray:
        return np.any([sight.cosines(patches) > 0.0 for sight in sights], axis=0)

    fill = cover.select(seen(cover))
    pixel = float(np.median([sight.pixel for sight in sights]))
    if pixel <= 0.0:
        raise RenderingError("initial_surfels got a mesh behind the cameras; allowed: an object in front of them")
    rows = line_creases(mesh, pixel, int(crease_share * number), seen)
    rows = rows.select(generator.permutation(rows.number)[:number])
    while fill.number < number - rows.number:
        more = spread(mesh, cover.number, generator)
        more = more.select(seen(more))
        if more.number == 0:
            raise RenderingError("initial_surfels found nothing of the mesh in the views; allowed: an object in sight")
        fill = Patches.join(fill, more)
    chosen, gap = farthest(fill.points, rows.points, number - rows.number)
    fill = fill.select(chosen)
    # The last one's distance is about that of all; where the rows leave no room, it is small or 0.
    fill.scales[:] = EVEN * max(gap, 0.5 * pixel)
    keep_inside(fill, mesh)
    patches = Patches.join(rows, fill)
    sh = torch.zeros(number, (degree + 1) ** 2, 3)
    sh[:, 0] = torch.from_numpy((_colors(patches, sights) - 0.5) / Y0).float()
    return replace(as_surfels(patches, opacity), sh=sh)


def _colors(patches: Patches, sights: Sequence[Sight]) -> np.ndarray:
    """Mean colours (n, 3) in the views, each by the cosine of its angle; grey where no mask has a patch."""
    total, weights = np.zeros((patches.number, 3)), np.zeros((patches.number, 1))
    for sight in sights:
        colors, on_mask = sight.colors(patches)
        weight = np.where(on_mask, sight.cosines(patches), 0.0)[:, None]
        total += weight * colors
        weights += weight
    return np.where(weights > 0.0, total / np.maximum(weights, 1e-12), 0.5)
