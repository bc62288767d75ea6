# SPDX-License-Identifier: MIT
"""A station whose pusher follows a script: its diagram, and the loop that runs it."""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.systems.ports import free_with
from pinwm_drake.systems.pusher.motion import ScriptedPush, StraightPush, TrajectoryReplay
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import SceneStation


class ScriptedStation:
    """A station with a scripted pusher, ready for one run after another. No run depends on an earlier one.

    Args:
        station: The station, of one world; its input is `pusher_velocity_W`.
        log: Log that the pusher follows; None for straight pushes.
        extend: Adds further systems to the diagram, which has "station" and "script" already.

    Attributes:
        diagram: Diagram of station, script and whatever else.
        script: System that moves the pusher.
        simulator: Simulator of the diagram.
        wall_time: s, that the simulator has taken since `begin`.
    """

    def __init__(
        self,
        station: SceneStation,
        log: PusherTrajectory | None = None,
        extend: Callable[[DiagramBuilder], None] = lambda builder: None,
    ) -> None:
        builder, period = DiagramBuilder(), station.setup.period
        builder.AddNamedSystem("station", station)
        script = ScriptedPush(period) if log is None else TrajectoryReplay(log, period, float(log.t[0]))
        builder.AddNamedSystem("script", script)
        builder.Connect(script.get_output_port(), station.GetInputPort("pusher_velocity_W"))
        extend(builder)
        self.diagram, self.station, self.script = builder.Build(), station, script
        self.simulator, self.wall_time = Simulator(self.diagram), 0.0
        free_with(self, self.diagram)

    def begin(self, place: Place, push: StraightPush | None = None) -> None:
        """Put everything into place, at rest, at time 0.

        Args:
            place: Of object and pusher; the pusher's is that of the push or the log where there is one.
            push: What the pusher does; None with a log, and for a pusher that stands.
        """
        context, p_WP = self.diagram.CreateDefaultContext(), place.p_WP
        if isinstance(self.script, TrajectoryReplay):
            p_WP = self.script.start_position
        elif push is not None:
            p_WP = push.p_WP
            self.script.SetPush(self.script.GetMyMutableContextFromRoot(context), push)
        self.station.SetPlace(context, Place(place.X_WO, p_WP))
        self.simulator.reset_context(context)
        self.simulator.Initialize()
        self.simulator.ResetStatistics()  # or a simulation in real time would catch up with what that took
        self.wall_time = 0.0

    def advance_to(self, times: Iterable[float]) -> Iterator[int]:
        """Simulate to one time after another.

        Args:
            times: s, increasing; those of 0 and before are there already.

        Yields:
            The number of each time, once it is reached.

        Raises:
            PinwmError: The physics found no solution.
        """
        for k, t in enumerate(times):
            # AdvanceTo(0) would make the step that begins at 0 already.
            if t > 0:
                began = time.perf_counter()
                self.simulator.AdvanceTo(t)
                self.wall_time += time.perf_counter() - began
            yield k

    def evaluate(self, port: str, context: Context | None = None) -> Any:
        """Return the value at an output port of the station: now, or in a context of the diagram."""
        context = self.simulator.get_context() if context is None else context
        return self.station.GetOutputPort(port).Eval(self.station.GetMyContextFromRoot(context))
