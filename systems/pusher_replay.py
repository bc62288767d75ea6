"""A recorded motion of a pusher, once more."""

import math

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.scene import pusher_motion
from pinwm_drake.systems.sampling import period_index, require_positive


class TrajectoryReplay(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Moves a pusher as a log says.

                        ┌──────────────────┐
                        │ TrajectoryReplay │─► pusher_velocity_W  (3) [m/s], W
                        └──────────────────┘   function of time, constant on [k, k + 1) period

    The velocity is the average over its period, so that a pusher that starts at `start_position` is on the log's
    line, which is straight between rows, at the end of every period. Before the first and after the last row it
    stands. These are the very velocities that identification uses (`scene.pusher_motion`). Pushers of a station only
    translate: turning is left out.
    """

    def __init__(self, trajectory: PusherTrajectory, period: float, start: float = 0.0) -> None:
        """Cuts the log into periods and declares the port.

        Args:
            trajectory: What was recorded.
            period: s.
            start: Time of the log at the context's time 0, s.

        Raises:
            ParameterError: The period is not positive.
        """
        super().__init__()
        self._period = require_positive("period", period, "s")
        periods = max(math.ceil((trajectory.t[-1] - start) / period), 0)
        motion = pusher_motion(trajectory, start, periods, period)
        self._v_WP = motion.V_WP[:, 3:].numpy()
        self._p_WP = motion.p_WP.numpy()
        self.DeclareVectorOutputPort("pusher_velocity_W", 3, self._CalcVelocity, {self.time_ticket()})

    @property
    def start_position(self) -> np.ndarray:
        """Where the pusher has to be at the context's time 0: p_WP (3,) m."""
        return self._p_WP.copy()

    def _CalcVelocity(self, context: Context, output: BasicVector) -> None:
        k = period_index(context.get_time(), self._period)
        output.SetFromVector(self._v_WP[k] if 0 <= k < len(self._v_WP) else np.zeros(3))
