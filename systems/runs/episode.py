"""An episode: a station, a pusher that follows a script, and what came of it."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.pusher.motion import ScriptedPush, StraightPush, TrajectoryReplay
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import PushStation

_REST_TIME = 0.1  # s
_REST_SPEED, _REST_TURN = 1e-3, 0.01  # m/s, rad/s
_PATIENCE = 3.0  # s, for the object to come to rest after the pusher has


@dataclass(frozen=True, eq=False)
class Record:
    """What happened, n times one period apart.

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
        """Whether the object was still all through the last 0.1 s."""
        last = self.object_state[self.t >= self.t[-1] - _REST_TIME]
        speed, turn = (np.linalg.norm(last[:, part], axis=1).max() for part in (np.s_[10:13], np.s_[7:10]))
        return bool(self.t[-1] >= _REST_TIME and speed < _REST_SPEED and turn < _REST_TURN)

    @property
    def displacement(self) -> np.ndarray:
        """(3,) m, world: from the first place of the object's origin to the last."""
        moved: np.ndarray = self.object_state[-1, 4:7] - self.object_state[0, 4:7]
        return moved

    @property
    def rotation(self) -> float:
        """rad, 0 to pi: angle between the object's first and last orientation."""
        share = float(np.abs(self.quaternions()[0] @ self.quaternions()[-1]))
        return 2 * math.acos(min(share, 1.0))

    def quaternions(self) -> np.ndarray:
        """(n, 4) wxyz, of unit norm."""
        q_WO = self.object_state[:, :4]
        unit: np.ndarray = q_WO / np.linalg.norm(q_WO, axis=1, keepdims=True)
        return unit

    def object_poses(self) -> ObjectPoses:
        """The object's poses, as captures hold them."""
        return ObjectPoses(self.t, self.object_state[:, 4:7], self.quaternions())

    def trajectory(self) -> PusherTrajectory:
        """The pusher's log, as captures hold it: where it was, and how fast it went on to the next row."""
        p_WP = self.pusher_state[:, :3]
        v_WP = np.zeros_like(p_WP)
        v_WP[:-1] = np.diff(p_WP, axis=0) / np.diff(self.t)[:, None]
        return PusherTrajectory(self.t, p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (len(p_WP), 1)), v_WP, None)


class Episode:
    """A station whose pusher makes a straight push, or follows a log.

    Attributes:
        station: The station, of one world.
        diagram: Of station and script.
        simulator: Of the diagram.
        end_time: s, when the pusher comes to rest.
        wall_time: s, that the simulator has taken since the last `advance` began.
    """

    def __init__(self, station: PushStation, log: PusherTrajectory | None = None) -> None:
        """Makes the diagram.

        Args:
            station: Its input is `pusher_velocity_W`.
            log: What the pusher follows; None for straight pushes.

        Raises:
            ParameterError: The station holds several worlds.
        """
        worlds, period = station.setup.scenario.num_worlds, station.setup.period
        if worlds != 1:
            raise ParameterError(f"num_worlds: got {worlds}; allowed: 1, for a scripted pusher")
        start = 0.0 if log is None else float(log.t[0])
        self.script = ScriptedPush(period) if log is None else TrajectoryReplay(log, period, start)
        self.end_time = 0.0 if log is None else float(log.t[-1]) - start
        builder = DiagramBuilder()
        self.station = builder.AddNamedSystem("station", station)
        builder.AddNamedSystem("script", self.script)
        builder.Connect(self.script.get_output_port(), station.GetInputPort("pusher_velocity_W"))
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.wall_time = 0.0
        self._rows: list[np.ndarray] = []

    def draw_place(self, generator: RandomGenerator) -> Place:
        """A start as `PushStation.SetRandomContext` draws it."""
        context = self.diagram.CreateDefaultContext()
        self.station.SetRandomContext(context, generator)
        return Place(self.station.object_pose(context), self._sample(context)[13:16])

    def begin(self, place: Place, push: StraightPush | None = None) -> None:
        """Puts everything into place, at rest, at time 0.

        Args:
            place: Of object and pusher; the pusher's is that of the push or the log where there is one.
            push: What the pusher does; None with a log, and for a pusher that stands.
        """
        context = self.diagram.CreateDefaultContext()
        p_WP = place.p_WP
        if isinstance(self.script, TrajectoryReplay):
            p_WP = self.script.start_position
        elif push is not None:
            p_WP, self.end_time = push.p_WP, push.end_time
            self.script.SetPush(self.script.GetMyMutableContextFromRoot(context), push)
        self.station.SetPlace(context, Place(place.X_WO, p_WP))
        self.simulator.reset_context(context)
        self.simulator.Initialize()
        self.simulator.ResetStatistics()  # or a simulation in real time would catch up with what that took

    def run(self, duration: float | None = None) -> Record:
        """Simulates to the end; see `advance`."""
        for _ in self.advance(duration):
            pass
        return self.record

    def advance(self, duration: float | None = None) -> Iterator[float]:
        """Simulates period by period.

        Args:
            duration: s; None for until the object rests after the pusher has stopped, and 3 s at most.

        Yields:
            The time, s: 0 before the first period, then the end of each.

        Raises:
            PinwmError: The physics found no solution.
        """
        period = self.station.setup.period
        steps = max(round(self.longest(duration) / period), 1)
        earliest, still, resting = self.end_time / period, round(_REST_TIME / period), 0
        context = self.simulator.get_context()
        self._rows, self.wall_time = [self._sample(context)], 0.0
        yield 0.0
        for k in range(1, steps + 1):
            began = time.perf_counter()
            self.simulator.AdvanceTo(k * period)
            self.wall_time += time.perf_counter() - began
            row = self._sample(context)
            self._rows.append(row)
            yield k * period
            slow = np.linalg.norm(row[10:13]) < _REST_SPEED and np.linalg.norm(row[7:10]) < _REST_TURN
            resting = resting + 1 if slow and k >= earliest else 0
            if duration is None and resting > still:
                break

    @property
    def record(self) -> Record:
        """What has happened since the last `advance` began."""
        table = np.array(self._rows)
        t = self.station.setup.period * np.arange(len(table))
        return Record(t, table[:, :13], table[:, 13:], self.wall_time)

    def longest(self, duration: float | None = None) -> float:
        """How long `run` takes at most, s of simulated time."""
        return self.end_time + _PATIENCE if duration is None else duration

    def _sample(self, context: Context) -> np.ndarray:
        """(19,): object_state and pusher_state."""
        mine = self.station.GetMyContextFromRoot(context)
        return np.concatenate(
            [self.station.GetOutputPort(name).Eval(mine) for name in ("object_state", "pusher_state")]
        )
