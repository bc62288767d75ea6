"""Coefficients of Drake's contacts from those of pairs of bodies."""

import math

from scipy.optimize import brentq

# Where no bounce is wanted [s/m]: Hunt and Crossley's force, k x (1 + d v), vanishes as soon as the bodies part at
# 1 / d, 2 mm/s. Much more would stop an impact within one time step, and Drake's "lagged" friction, which goes by the
# normal force of the step before, would be missing in it: an off-centre impact then turned the T-block by 30 % less.
_NO_BOUNCE = 500.0


def surface_frictions(floor_pair: float, pusher_pair: float) -> tuple[float, float, float]:
    """Coefficients of the surfaces of object, floor and pusher, so that the pairs have those that are wanted.

    Drake gives a pair of surfaces with coefficients a and b the coefficient 2 a b / (a + b). A pair's coefficient p
    with one surface at a then needs b = a p / (2 a - p), which there is for a > p / 2: the object takes the larger
    one of both pairs.

    Args:
        floor_pair: Of object and floor, 0 or more.
        pusher_pair: Of object and pusher, 0 or more.

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
    return float(brentq(excess, 1e-6 * high, (1 - 1e-15) * high)) / speed
