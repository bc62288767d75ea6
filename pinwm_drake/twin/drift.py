# SPDX-License-Identifier: MIT
"""Departures of a push from the physics of a twin: a random walk along its way, and frictions of its own."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.twin.twin import Twin

# Standard deviation of a position after a way of one metre [m] that an object may have, and the factor of that of its
# rim when it turns: before a push is seen, median and standard deviation of the logarithm. Out of the floor's plane it
# is `OUT_OF_PLANE` of it. From pushes of MuJoCo, Bullet and Drake and real ones, see docs/results/identification.md and
# docs/results/real.md: round objects turn by what the pusher's friction happens to be.
WALK, TURN = (1e-2, 0.35), (2.5, 0.45)
OUT_OF_PLANE = 0.1
# Walk and turn that a search chooses from, and those that are told apart when it is done.
DRIFTS = tuple((walk, turn) for walk in (5e-3, 1e-2, 2e-2) for turn in (1.0, 2.5))
FINE_DRIFTS = tuple((3e-3 * 2.0 ** (k / 2), 2.0 ** (n / 2)) for k in range(8) for n in range(6))
# Standard deviations of the logarithms of a push's frictions against those of the object: a face that rattles, a law of
# contact that is another one, or another place act on a whole push alike, and otherwise on the next one.
GRIPS = {"friction_floor": 0.05, "friction_pusher": 0.2}
# Names of those of a twin, among its nuisances and draws.
DRIFT, DRIFT_TURN = "drift", "drift_turn"


def way(X_WO: Pose, times: Tensor, radius: float) -> Tensor:
    """Way (..., n) [m] that objects have made up to each of their poses.

    A turn counts as what it moves the object's rim by.

    Args:
        X_WO: q (..., n, 4), p (..., n, 3), m.
        times: Times of the poses (n,) [s], in any order.
        radius: Radius of the object, m.
    """
    order = torch.argsort(times)
    q, p = X_WO.q[..., order, :], X_WO.p[..., order, :]
    turned = turn_between(q[..., :-1, :], q[..., 1:, :]).norm(dim=-1)
    step = (p[..., 1:, :] - p[..., :-1, :]).norm(dim=-1) + radius * turned
    made = torch.nn.functional.pad(step, (1, 0)).cumsum(-1)
    return torch.empty_like(made).index_copy(-1, order, made)


def chances(drifts: Sequence[tuple[float, float]]) -> Tensor:
    """Probabilities (K,) of drifts, before a push is seen; they add up to 1."""
    z = [
        [math.log(value / median) / sd for value, (median, sd) in zip(one, (WALK, TURN), strict=True)] for one in drifts
    ]
    return torch.softmax(-0.5 * torch.tensor(z, dtype=torch.float64).square().sum(-1), 0)


def drift(radius: float, walk: float, turn: float = 1.0) -> Tensor:
    """Return standard deviations (6,) of rotation vector [rad] and position [m], world, after a metre of way.

    That of a position in the floor's plane is `walk` [m], that of a rim that turns `turn` times as large; the object
    has a radius [m].
    """
    share = torch.tensor([OUT_OF_PLANE, OUT_OF_PLANE, turn, 1.0, 1.0, OUT_OF_PLANE], dtype=torch.float64)
    return walk * share * per_radius(radius)


def typical_drift(twin: Twin) -> tuple[float, float]:
    """Root mean square [m] of the drift of a twin after a way of one metre, and its turn; a small one without draws."""
    if twin.draws is None or DRIFT not in twin.draws.names:
        return DRIFTS[0]
    walks = twin.draws.column(DRIFT)
    turns = twin.draws.column(DRIFT_TURN) if DRIFT_TURN in twin.draws.names else np.ones(len(walks))
    walk = float(np.sqrt(np.mean(walks**2)))
    return walk, float(np.sqrt(np.mean((walks * turns) ** 2))) / walk if walk > 0.0 else 1.0


def grips(rows: np.ndarray) -> dict[str, np.ndarray]:
    """Factors (W,) of the frictions of a push that was not seen, for draws by their rows (W,); the same for each."""
    normal = np.random.default_rng(rows).normal(size=(len(GRIPS), len(rows)))
    return {name: np.exp(one * scale) for (name, scale), one in zip(GRIPS.items(), normal, strict=True)}


def per_radius(radius: float) -> Tensor:
    """Factors (6,) from a shift of the rim [m] to rotation vector [rad] and position [m]."""
    return torch.tensor([1.0 / radius] * 3 + [1.0] * 3, dtype=torch.float64)
