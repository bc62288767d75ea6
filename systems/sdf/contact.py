# SPDX-License-Identifier: MIT
"""Coefficients of Drake's contacts: the constants of floor, pusher and supports, and those that follow from theta.

Drake gives coefficients to surfaces, theta gives them to pairs of bodies: `Surfaces.of_pairs` finds the surfaces whose
pairs have the friction and the restitution that are wanted.
"""

import math
from dataclasses import dataclass

from scipy.optimize import brentq

# Where no bounce is wanted [s/m]: Hunt and Crossley's force, k x (1 + d v), vanishes as soon as the bodies part at
# 1 / d, 2 mm/s. Much more would stop an impact within one time step, and Drake's "lagged" friction, which goes by the
# normal force of the step before, would be missing in it: an off-centre impact then turned the T-block by 30 % less.
_NO_BOUNCE = 500.0
REFERENCE_SPEED = 0.12  # m/s, of approach, at which restitution is meant
FLOOR_SIDE, FLOOR_DEPTH = 4.0, 0.02  # m
# m, from the origin: an edge of the floor's tetrahedra, which would divide the contact surface, starts in its middle.
FLOOR_MIDDLE = (0.9, 0.35)
FLOOR_MODULUS = 3e9  # Pa, reached half-way down: 3e11 Pa/m
# Pa/m, of the soft pieces that carry an object. The floor is a hundred times as stiff, so that they touch in its plane.
# In the plane of the object's faces, as with a soft floor, the front of an edge would plough: damping lets a side that
# moves against the floor carry 1 + d v times as much, at 1 m/s twenty times, and a poked mug stood still and tipped.
SUPPORT_GRADIENT = 3e9
FLOOR_DISSIPATION = 20.0  # s/m
PUSHER_MODULUS = 1e9  # Pa, at its middle
PUSHER_RESOLUTION = 0.002  # m, edges of its tetrahedra
# Of the object's triangles, for each metre of its mean extent. A face's friction torque is up to 0.9 % too small
# with it (T-block); half of it takes more than twice as long.
LONGEST_EDGE = 0.28
# Point contact, N/m, of a pair: a small sphere on the floor, and a convex piece at the pusher.
FLOOR_STIFFNESS = 1e6
# With much more, "lagged" friction is wrong in impacts: see `systems/engines/plant/scene.py`.
PUSHER_STIFFNESS = 5e4
# m, of the spheres on which an object stands. Those on a face stand out by as much, and the corners' by a tenth.
SUPPORT_RADIUS, CORNER_RADIUS = 1e-5, 1e-6
PUSHER_MASS = 1.0  # kg
DRIVE_STIFFNESS, DRIVE_DAMPING = 1e7, 1e5  # N/m, N s/m


def surface_frictions(floor_pair: float, pusher_pair: float) -> tuple[float, float, float]:
    """Coefficients of the surfaces of object, floor and pusher, so that the pairs have those that are wanted.

    Drake gives a pair of surfaces with coefficients a and b the coefficient 2 a b / (a + b). A pair's coefficient p
    with one surface at a then needs b = a p / (2 a - p), which there is for a > p / 2: the object takes the larger
    one of both pairs.

    Args:
        floor_pair: Coefficient of object and floor, 0 or more.
        pusher_pair: Coefficient of object and pusher, 0 or more.

    Returns:
        Of object, floor and pusher.
    """
    a = max(floor_pair, pusher_pair)
    if a == 0:
        return 0.0, 0.0, 0.0
    floor, pusher = (a * pair / (2 * a - pair) for pair in (floor_pair, pusher_pair))
    return a, floor, pusher


def dissipation_of(restitution: float, speed: float) -> float:
    """Hunt and Crossley's dissipation d for which bodies that meet at a speed part at `restitution` times it.

    The force is f(x) (1 + d v) with the overlap x and v = x'. Then v dv / (1 + d v) = f(x) dx / m, so that
    v - log(1 + d v) / d is the same before (v = u) and after (v = -e u) the contact:
    d u (1 + e) = log((1 + d u) / (1 - e d u)).

    Args:
        restitution: e, 0 to below 1. It holds at one speed only: faster bodies bounce less.
        speed: u, m/s, more than 0.

    Returns:
        d, s/m. For e = 0, which would take an infinite one, 500: bodies part at 2 mm/s or slower.

    Source: Hunt and Crossley (1975), "Coefficient of restitution interpreted as damping in vibroimpact".
    """
    if restitution * speed * _NO_BOUNCE <= 1:
        return _NO_BOUNCE

    def excess(a: float) -> float:
        return math.log((1 + a) / (1 - restitution * a)) - a * (1 + restitution)

    # With a = d u: negative for small a, towards infinity at a = 1 / e.
    high = 1 / restitution
    last = (1 - 1e-15) * high
    if excess(last) <= 0:  # for e below about 0.026 the root is nearer to 1 / e than numbers are
        return last / speed
    return float(brentq(excess, 1e-6 * high, last)) / speed


@dataclass(frozen=True)
class Surfaces:
    """Coefficients of Drake's geometries that give the pairs those of theta.

    Coulomb coefficients are those of surfaces; Hunt and Crossley's dissipation [s/m] is that of a pair with the object.
    """

    friction_object: float
    friction_floor: float
    friction_pusher: float
    dissipation_floor: float
    dissipation_pusher: float

    @classmethod
    def of_pairs(
        cls,
        friction_floor: float,
        friction_pusher: float,
        restitution_floor: float = 0.0,
        restitution_pusher: float = 0.0,
        reference_speed: float = REFERENCE_SPEED,
    ) -> "Surfaces":
        """Surfaces of pairs with given Coulomb coefficients, and restitutions at a speed of approach [m/s]."""
        mu_object, mu_floor, mu_pusher = surface_frictions(friction_floor, friction_pusher)
        floor = min(dissipation_of(restitution_floor, reference_speed), FLOOR_DISSIPATION)
        return cls(mu_object, mu_floor, mu_pusher, floor, dissipation_of(restitution_pusher, reference_speed))
