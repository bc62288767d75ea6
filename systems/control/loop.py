# SPDX-License-Identifier: MIT
"""A policy that controls a station: the diagram, and a run of it from the first image to the last action."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.control.pilot import Acting, ControlStatus
from pinwm_drake.control.safety_filter import HALTED
from pinwm_drake.errors import StateError, require
from pinwm_drake.learning.bundle import Bundle
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm.driver import ArmDriver
from pinwm_drake.systems.arm.model import ArmName
from pinwm_drake.systems.control.controller import AddPolicyController
from pinwm_drake.systems.engines.lcm.engine import LcmHandle
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_setup
from pinwm_drake.systems.ports import free_with
from pinwm_drake.systems.scenario.load import Scene
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.systems.sdf.twin import ContactName
from pinwm_drake.systems.station.station import make_station

_LOOKS = 5  # times in an action at which faults, and a wish to stop, are looked for


@dataclass(frozen=True, eq=False)
class ControlRow:
    """State of a control loop after an action.

    Attributes:
        t: s, time of the simulation.
        status: Status of the controller.
        raw_action: (n,) m, world, along the task's axes: translation of the policy, before limits; NaN without one.
        p_WP: (3,) m, world: position of the pusher; NaN where it is not known.
        object_state: (13,) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world; NaN with a robot alone.
        distance: m, of the object from the goal, as the task measures it; NaN where it is not known.
        angle: rad, between the object's orientation and the goal's; NaN where it is not known.
        success: Flag: the task is done, by its own criterion.
    """

    t: float
    status: ControlStatus
    raw_action: np.ndarray
    p_WP: np.ndarray
    object_state: np.ndarray
    distance: float
    angle: float
    success: bool


class ControlLoop:
    """A controller and a station, and where wanted the simulated arm behind it, in one diagram.

    Args:
        bundle: The policy.
        limits: Limits of the pusher's motion.
        setup: The scene, of one world, as `environment_setup` makes it.
        engine: Engine of the station: "twin", "hydroelastic", "point" or "lcm".
        armed: Flag: the pusher may move. Without, everything is computed and nothing is sent.
        simulate_arm: Flag, with "lcm": an arm is simulated behind the station, in this process.
        arm: Name of that arm, of `ARMS`.
        contact: Contact model of the simulated arm.
        latency: s, of that arm's camera, from exposure to sending.
        meshcat: Shows the scene, the state and what the policy sees, if given; with "lcm", the simulated arm.
        recording: Flag: Meshcat keeps what was shown, for a recording.

    Attributes:
        station: The station.
        controller: The controller by the policy; disarmed until `listen`.
        driver: The simulated arm; None where there is none.
        simulator: Simulator of the diagram.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The station does not fit the policy, or an arm is wanted with another engine.
    """

    def __init__(
        self,
        bundle: Acting,
        limits: SafetyLimits,
        setup: Setup,
        engine: str,
        *,
        armed: bool = False,
        simulate_arm: bool = False,
        arm: ArmName = "iiwa",
        contact: ContactName = "hydroelastic",
        latency: float = 0.0,
        meshcat: Meshcat | None = None,
        recording: bool = False,
    ) -> None:
        require("engine", f"{engine!r} with a simulated arm", not simulate_arm or engine == "lcm", "lcm")
        spec = bundle.spec
        self.armed, self._horizon, self._begun = armed, spec.horizon, False
        self._task, self._stopped, self._pace = spec.task, False, (0.0, 0.0)
        builder = DiagramBuilder()
        self.driver: ArmDriver | None = None
        if engine == "lcm":
            setup = dataclasses.replace(setup, period=spec.horizon / _LOOKS)
            lcm = make_lcm(setup.scenario.lcm)
            self.station = make_station(setup, engine, lcm=lcm, armed=armed)
            if simulate_arm:
                driver = ArmDriver(setup, lcm, arm=arm, contact=contact, latency=latency, meshcat=meshcat)
                self.driver = builder.AddSystem(driver)
        else:
            self.station = make_station(setup, engine, meshcat=meshcat)
        builder.AddSystem(self.station)
        self.controller = AddPolicyController(builder, self.station, bundle, limits)
        self._shown = meshcat is not None
        if meshcat is not None:
            from pinwm_drake.systems.control.page import AddControlPage  # which loads Matplotlib

            watched = self.station if self.driver is None else self.driver
            AddControlPage(
                builder,
                self.controller,
                self.station.GetOutputPort("rgb"),
                watched.GetOutputPort("object_state"),
                watched.GetOutputPort("pusher_state"),
                meshcat,
                setup,
                engine=engine,
                recording=recording,
                look=self.driver is None,
            )
        diagram = builder.Build()
        free_with(self, diagram)
        self.simulator = Simulator(diagram)
        self._robot = engine == "lcm" and self.driver is None
        if self._robot:
            self.simulator.set_target_realtime_rate(1.0)  # a robot's time is not ours to choose

    def draw_place(self, generator: np.random.Generator) -> Place:
        """Random start of the scenario; with a simulated arm one that it reaches."""
        if self.driver is not None:
            return self.driver.draw_place(generator)
        return StartDistribution(self.station.setup).draw(generator)

    def begin(self, place: Place) -> None:
        """Put object and pusher into place, at rest, at time 0; a real robot is left where it is.

        Raises:
            StateError: With "lcm", it has begun before: old messages would be taken for new ones. Make another loop.
        """
        if self._begun and self.station.engine.name == "lcm":
            raise StateError(
                "begin: this loop has run over LCM before, whose old messages would count; make another loop"
            )
        self._begun = True
        context = self.simulator.get_system().CreateDefaultContext()
        if self.driver is not None:
            self.driver.SetPlace(context, place)
        elif self.station.engine.name != "lcm":
            self.station.SetPlace(context, place)
        self.simulator.reset_context(context)
        self.simulator.Initialize()
        self.simulator.ResetStatistics()  # or one in real time would catch up with what that took

    def listen(
        self,
        patience: float = 5.0,
        *,
        stop: Callable[[], str] = lambda: "",
        arming: Callable[[], None] = lambda: None,
    ) -> None:
        """Simulate until image and pusher's state have come, reset the controller, and arm it where it may move.

        After `stop` it may be called again, for another run from where object and pusher are then.

        Args:
            patience: s, longest time to wait, of the simulation.
            stop: Function that tells why to stop, in words; empty as long as it goes on.
            arming: Function that is called just before the controller is armed.

        Raises:
            StateError: Nothing has come in that time.
        """
        context = self.simulator.get_mutable_context()
        self._stopped, start = False, context.get_time()
        self.simulator.ResetStatistics()  # or one in real time would catch up with the time since the last run
        while not stop():
            self.simulator.AdvanceTo(self._next())
            mine = self.station.GetMyContextFromRoot(context)
            image = self.station.GetOutputPort("rgb_time").Eval(mine)[0] >= 0
            pusher = np.isfinite(self.station.GetOutputPort("pusher_state").Eval(mine)).all()
            missing = [name for name, there in (("image", image), ("state of the pusher", pusher)) if not there]
            if not missing:
                break
            if context.get_time() > start + patience:
                link = self.station.setup.scenario.lcm
                raise StateError(
                    f"lcm: no {' and no '.join(missing)} from {link.url} within {patience:g} s: "
                    "is `pinwm arm`, or the robot's driver, running?"
                )
        self.controller.Reset(context)
        if self.armed:
            arming()
            if not stop():
                self.controller.Arm(context)
        self.simulator.ResetStatistics()
        self._pace = time.monotonic(), context.get_time()

    def advance(self, duration: float, *, stop: Callable[[], str] = lambda: "") -> Iterator[ControlRow]:
        """Simulate action by action.

        Args:
            duration: s, longest duration of the run.
            stop: Function that tells why to stop, in words; empty as long as it goes on. It is asked five times in an
                action.

        Yields:
            The row before the first action, and after each. Nothing comes after a success, after a fault that latched,
            after the end of the task by the policy's own estimate, nor after a wish to stop.
        """
        context, row = self.simulator.get_context(), self.row()
        end = context.get_time() + duration
        yield row
        while context.get_time() < end - 0.5 * self._horizon and not (row.success or row.status.state in HALTED):
            action = self._next()
            for look in range(1 - _LOOKS, 1):
                if stop():
                    return
                self.simulator.AdvanceTo(action + look * self._horizon / _LOOKS)
                self._watch_pace()
            row = self.row()
            yield row

    def stop(self) -> None:
        """Disarms, and tells the robot at once, whatever state the simulation is in; a second call does nothing."""
        if self._stopped:
            return
        self._stopped = True
        self.controller.Disarm(self.simulator.get_mutable_context())
        handle = self.station.engine.handle
        if isinstance(handle, LcmHandle):
            handle.SendStop(self.simulator.get_context().get_time())
        if self._shown:
            self.simulator.get_system().ForcedPublish(self.simulator.get_context())

    def row(self) -> ControlRow:
        """Row of the present state."""
        root = self.simulator.get_context()
        station, watched = self.station, self.station if self.driver is None else self.driver
        state = watched.GetOutputPort("object_state").Eval(watched.GetMyContextFromRoot(root)).copy()
        p_WP = station.GetOutputPort("pusher_state").Eval(station.GetMyContextFromRoot(root))[:3].copy()
        progress = self._task.measure(state[None], p_WP[None])
        mine = self.controller.GetMyContextFromRoot(root)
        return ControlRow(
            t=root.get_time(),
            status=self.controller.status(root),
            raw_action=self.controller.GetOutputPort("raw_action").Eval(mine).copy(),
            p_WP=p_WP,
            object_state=state,
            distance=float(progress.distance[0]),
            angle=float(progress.angle[0]),
            success=bool(progress.success[0]),
        )

    def _watch_pace(self) -> None:
        """Latches the controller where a robot's time has run ahead of the simulation's, by an action."""
        if not self._robot:
            return
        context = self.simulator.get_mutable_context()
        began, start = self._pace
        late = (time.monotonic() - began) - (context.get_time() - start)
        if late > self._horizon:
            self.controller.Fail(context, f"controller is slower than real time: {late:.3f} s late")

    def _next(self) -> float:
        """Time [s] at which the action ends that goes on now."""
        return (round(self.simulator.get_context().get_time() / self._horizon) + 1) * self._horizon


def make_control_loop(
    bundle: Bundle,
    engine: str = "twin",
    *,
    scene: Scene | None = None,
    armed: bool = False,
    meshcat: Meshcat | None = None,
) -> ControlLoop:
    """Make the loop of a bundle in a simulated scene, within the bundle's own limits.

    Args:
        bundle: The policy.
        engine: Engine of the station: "twin", "hydroelastic" or "point".
        scene: The scene, see `load_setup`; None for the policy's own, `home_scene`.
        armed: Flag: the pusher may move.
        meshcat: Shows the scene, if given.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: The scene has another object, pusher, floor or camera than the policy was trained with.
    """
    spec = bundle.spec
    setup = policy_setup(spec, bundle.provenance, "bundle", scene)
    setup = environment_setup(setup, EnvOptions(image_size=spec.camera.width))
    return ControlLoop(bundle, bundle.limits, setup, engine, armed=armed, meshcat=meshcat)
