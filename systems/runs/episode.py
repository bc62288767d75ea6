# SPDX-License-Identifier: MIT
"""An episode: a station, a pusher that follows a script, and what came of it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.common import RandomGenerator

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.errors import require
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.rest import REST_TIME, RestCount, is_slow
from pinwm_drake.systems.runs.scripted import ScriptedStation
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import SceneStation

_PATIENCE = 3.0  # s, for the object to come to rest after the pusher has


@dataclass(frozen=True, eq=False)
class Record:
    """Record of an episode: n samples, one period apart.

    Attributes:
        t: (n,) s, from 0.
        object_state: (n, 13), as the station's port has it.
        pusher_state: (n, 6), as the station's port has it.
        wall_time: s, that the simulator took.
    """

    t: np.ndarray
    object_state: np.ndarray
    pusher_state: np.ndarray
    wall_time: float

    @property
    def at_rest(self) -> bool:
        """Flag: the object was slow (`is_slow`) all through the last 0.1 s."""
        last = self.object_state[self.t >= self.t[-1] - REST_TIME]
        return bool(self.t[-1] >= REST_TIME and is_slow(last).all())

    @property
    def displacement(self) -> np.ndarray:
        """Displacement (3,) m, world, of the object's origin from its first place to its last."""
        return np.asarray(self.object_state[-1, 4:7] - self.object_state[0, 4:7])

    @property
    def rotation(self) -> float:
        """rad, 0 to pi: angle between the object's first and last orientation."""
        share = float(np.abs(self.quaternions()[0] @ self.quaternions()[-1]))
        return 2 * math.acos(min(share, 1.0))

    def quaternions(self) -> np.ndarray:
        """Orientations (n, 4) wxyz of the object, unit norm."""
        q_WO = self.object_state[:, :4]
        return np.asarray(q_WO / np.linalg.norm(q_WO, axis=1, keepdims=True))

    def object_poses(self) -> ObjectPoses:
        """Return the object's poses, as captures hold them."""
        return ObjectPoses(self.t, self.object_state[:, 4:7], self.quaternions())

    def trajectory(self) -> PusherTrajectory:
        """Return the pusher's log, as captures hold it: where it was, and how fast it went on to the next row."""
        p_WP = self.pusher_state[:, :3]
        v_WP = np.zeros_like(p_WP)
        v_WP[:-1] = np.diff(p_WP, axis=0) / np.diff(self.t)[:, None]
        return PusherTrajectory(self.t, p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (len(p_WP), 1)), v_WP, None)


class Episode(ScriptedStation):
    """A station whose pusher makes a straight push, or follows a log.

    Args:
        station: Its input is `pusher_velocity_W`.
        log: What the pusher follows; None for straight pushes.

    Attributes:
        end_time: s, when the pusher comes to rest.

    Raises:
        ParameterError: The station holds several worlds.
    """

    def __init__(self, station: SceneStation, log: PusherTrajectory | None = None) -> None:
        worlds = station.setup.scenario.num_worlds
        require("num_worlds", worlds, worlds == 1, "1, for a scripted pusher")
        super().__init__(station, log)
        self.end_time = 0.0 if log is None else float(log.t[-1]) - float(log.t[0])
        self._rows: list[np.ndarray] = []

    def draw_place(self, generator: RandomGenerator) -> Place:
        """Return a start as `SceneStation.SetRandomContext` draws it."""
        context = self.diagram.CreateDefaultContext()
        self.station.SetRandomContext(context, generator)
        return Place(self.station.object_pose(context), self.evaluate("pusher_state", context)[:3].copy())

    def begin(self, place: Place, push: StraightPush | None = None) -> None:
        """Put everything into place; see `ScriptedStation.begin`."""
        super().begin(place, push)
        if push is not None:
            self.end_time = push.end_time

    def run(self, duration: float | None = None) -> Record:
        """Simulate to the end; see `advance`."""
        for _ in self.advance(duration):
            pass
        return self.record

    def advance(self, duration: float | None = None) -> Iterator[float]:
        """Simulate period by period.

        Args:
            duration: s; None for until the object rests after the pusher has stopped, and 3 s at most.

        Yields:
            The time, s: 0 before the first period, then the end of each.

        Raises:
            PinwmError: The physics found no solution.
        """
        period = self.station.setup.period
        steps = max(round(self.longest(duration) / period), 1)
        earliest, rest = max(self.end_time / period, 1), RestCount(round(REST_TIME / period) + 1)
        self._rows = []
        for k in self.advance_to(k * period for k in range(steps + 1)):
            self._rows.append(np.concatenate([self.evaluate("object_state"), self.evaluate("pusher_state")]))
            yield k * period
            if rest.add(k >= earliest and bool(is_slow(self._rows[-1][:13]))) and duration is None:
                break

    @property
    def record(self) -> Record:
        """Record of all since the last `advance` began."""
        table = np.array(self._rows)
        t = self.station.setup.period * np.arange(len(table))
        return Record(t, table[:, :13], table[:, 13:], self.wall_time)

    def longest(self, duration: float | None = None) -> float:
        """Longest duration of `run`, s of simulated time."""
        return self.end_time + _PATIENCE if duration is None else duration
