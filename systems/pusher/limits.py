# SPDX-License-Identifier: MIT
"""Limits of a pusher: its speed, and the box that it stays in."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, LeafSystem

from pinwm_drake.errors import require
from pinwm_drake.systems.ports import declare_vector
from pinwm_drake.systems.sampling import require_positive


class PusherLimits(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Limiter that keeps pushers slow enough, and inside a box.

                                            ┌──────────────┐
        pusher_velocity_W  (3 W) [m/s], W ─►│ PusherLimits │─► pusher_velocity_W  (3 W) [m/s], W
        pusher_state       (6 W): p_WP [m], │              │   direct feedthrough of both inputs,
                           v_WP [m/s], W   ─►│              │   for a consumer that samples it every `period` s
                                            └──────────────┘   and holds it

    A velocity that is too large is shortened; its direction is kept. Then each component is cut so that the pusher
    is no farther than at the wall one period later; a pusher that is outside already may only stay or come back. A
    velocity with a component that is not a finite number is replaced by zero, and so is one of a pusher whose
    position is none.

    Args:
        num_worlds: Number of worlds W, 1 or more.
        max_speed: Largest norm of the velocity, m/s.
        low: (3,) m, world: the least coordinates of the pusher's middle P.
        high: (3,) m, world: the largest coordinates of it.
        period: Time for which the consumer holds a velocity, s.

    Raises:
        ParameterError: A number is not positive, or the box is empty.
    """

    def __init__(self, num_worlds: int, max_speed: float, low: ArrayLike, high: ArrayLike, period: float) -> None:
        super().__init__()
        require_positive("num_worlds", num_worlds)
        self._max_speed = require_positive("max_speed", max_speed, "m/s")
        self._rate = 1 / require_positive("period", period, "s")
        low, high = np.array(low, float).reshape(3), np.array(high, float).reshape(3)
        require("pusher's box", f"{low} to {high} m", bool((low < high).all()), "low below high")
        # One row for each world: numpy would take twice as long to repeat them every time.
        self._low, self._high = np.tile(low, (num_worlds, 1)), np.tile(high, (num_worlds, 1))
        velocity = self.DeclareVectorInputPort("pusher_velocity_W", 3 * num_worlds)
        state = self.DeclareVectorInputPort("pusher_state", 6 * num_worlds)
        self._velocity, self._state = velocity, state
        inputs = {velocity.ticket(), state.ticket()}
        declare_vector(self, "pusher_velocity_W", 3 * num_worlds, self._CalcVelocity, inputs)

    def _CalcVelocity(self, context: Context) -> np.ndarray:
        p_WP = self._state.Eval(context).reshape(-1, 6)[:, :3]
        v_WP = shortened(self._velocity.Eval(context).reshape(-1, 3), self._max_speed)
        # Outside of the box, zero is the velocity nearest to the wall that leads no farther away.
        down = np.minimum((self._low - p_WP) * self._rate, 0.0)
        up = np.maximum((self._high - p_WP) * self._rate, 0.0)
        v_WP = np.minimum(np.maximum(v_WP, down), up)
        # A position that is no finite number shows in its limits.
        return finite(v_WP, down + up).ravel()


def shortened(vectors: np.ndarray, longest: float) -> np.ndarray:
    """Vectors (n, 3) no longer than `longest`, directions kept; zero where a component is not a finite number."""
    squares = np.einsum("ij,ij->i", vectors, vectors)
    if squares.max() <= longest**2:
        return vectors
    vectors = finite(vectors, vectors)
    # Divided by the largest component first, which is safe against overflow.
    largest = np.maximum(np.abs(vectors).max(axis=1), 1e-300)
    lengths = largest * np.linalg.norm(vectors / largest[:, None], axis=1)
    return vectors * np.minimum(longest / np.maximum(lengths, 1e-300), 1.0)[:, None]


def finite(vectors: np.ndarray, judged: np.ndarray) -> np.ndarray:
    """Copy of `vectors` (n, 3), zero in the rows in which `judged` (n, 3) has an entry that is not a finite number."""
    good = np.isfinite(judged)
    return vectors if good.all() else np.where(good.all(axis=1)[:, None], vectors, 0.0)
