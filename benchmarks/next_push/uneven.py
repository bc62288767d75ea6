"""Objects that are no uniform solids on flat faces: a lump within, and feet that stand out of the face below."""

import dataclasses

import numpy as np
from scipy.spatial import ConvexHull

from benchmarks.next_push.engines.rollout import Theta
from benchmarks.next_push.objects import Thing

FOOT_HEIGHT = 7e-5  # m, by which feet stand out
_OFF = (0.02, 0.08)  # of the object's mean extent, from the uniform solid's centre of mass to the true one
_LUMP_SHARE = (0.15, 0.40)  # of the mass
_LUMP_RADIUS = 0.008  # m
_FEET = (3, 4)
_OUTWARDS = (0.6, 0.95)  # of the way from the middle to the outline
_SAFE = 0.006  # m, from the centre of mass to the edge of the polygon of feet, at least
_ATTEMPTS = 1000


def uneven(thing: Thing, theta: Theta, generator: np.random.Generator) -> Theta:
    """The truth about an object whose mass is not spread evenly, and which stands on three or four places.

    Args:
        thing: The object.
        theta: The truth about it as a uniform solid on an even face.
        generator: Source of randomness.

    Returns:
        The same mass and frictions, with another centre of mass, the inertia that belongs to it, and feet.
    """
    p_com, inertia = _with_lump(thing, theta, generator)
    return dataclasses.replace(theta, p_com=p_com, inertia=inertia, feet=_feet(thing, p_com, generator))


def _with_lump(thing: Thing, theta: Theta, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass (3,) m and inertia (3, 3) of a uniform solid, a share of whose mass is a ball somewhere within."""
    extent = float(thing.mesh().extents.mean())
    for _ in range(_ATTEMPTS):
        share, off = generator.uniform(*_LUMP_SHARE), generator.uniform(*_OFF) * extent
        # A place within one of the convex pieces.
        weights = generator.dirichlet(np.ones(4))
        hull = thing.hulls[generator.integers(len(thing.hulls))]
        place = weights @ hull[generator.choice(len(hull), 4, replace=False)]
        away = place - theta.p_com
        if not np.isclose(share * np.linalg.norm(away), off, rtol=0.15):
            continue
        about = theta.mass * (1 - share) * share * (away @ away * np.eye(3) - np.outer(away, away))
        ball = 0.4 * share * theta.mass * _LUMP_RADIUS**2 * np.eye(3)
        return theta.p_com + share * away, (1 - share) * theta.inertia + about + ball
    raise RuntimeError(f"{thing.name}: no place for a lump")


def _feet(thing: Thing, p_com: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Feet (n, 3) m, frame O, in whose polygon the centre of mass stands."""
    base = thing.base_points()
    low, outline = base[:, 2].min() - FOOT_HEIGHT, base[ConvexHull(base[:, :2]).vertices][:, :2]
    middle = outline.mean(axis=0)
    for _ in range(_ATTEMPTS):
        number = int(generator.integers(_FEET[0], _FEET[1] + 1))
        start = generator.integers(len(outline), size=number)
        share = generator.uniform(size=(number, 1))
        edge = share * outline[start] + (1 - share) * outline[(start + 1) % len(outline)]
        feet = middle + generator.uniform(*_OUTWARDS, (number, 1)) * (edge - middle)
        hull = ConvexHull(feet)
        inside = -(hull.equations[:, :2] @ p_com[:2] + hull.equations[:, 2]).max()
        if len(hull.vertices) == number and inside > _SAFE:
            return np.column_stack([feet, np.full(number, low)])
    raise RuntimeError(f"{thing.name}: no feet around its centre of mass")
