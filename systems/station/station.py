# SPDX-License-Identifier: MIT
"""Station: a pushing scene as one diagram with the same ports, whatever engine moves it."""

from typing import Literal

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantValueSource

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.systems.engines.engine import Engine
from pinwm_drake.systems.engines.lcm.engine import AddLcmEngine
from pinwm_drake.systems.engines.plant.engine import AddPlantEngine
from pinwm_drake.systems.engines.twin.engine import AddTwinEngine
from pinwm_drake.systems.engines.twin.world_model import WorldModel
from pinwm_drake.systems.ports import declare_vector
from pinwm_drake.systems.pusher.limits import PusherLimits
from pinwm_drake.systems.pusher.translation import PusherTranslation
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.systems.sdf.twin import contact_name
from pinwm_drake.systems.view.scene import AddSceneView

Command = Literal["velocity", "translation"]
STATION_ENGINES = (*ENGINES, "lcm")


class SceneStation(Diagram):  # type: ignore[misc]  # pydrake has no usable types
    """Station of an object on a floor, a pusher and a camera.

                                                   ┌─────────────┐
        pusher_velocity_W     (3 W) v_WP [m/s]     │             │─► object_state  (13 W): q_WO, p_WO [m], ω_WO, v_WO
        or, as chosen, ───────────────────────────►│ SceneStation │─► pusher_state   (6 W): p_WP [m], v_WP [m/s]
        pusher_translation_W  (3 W) d [m],         │             │─► rgb       ImageRgba8U
        over `horizon`                             │             │─► rgb_batch  Value[array]: (W, height, width, 4)
                                                   │             │─► rgb_time          (1): s, when they were taken
        session               (1), with "lcm"  ───►│             │─► pusher_time       (1): s, of pusher_state
                                                   │             │─► fault   Value[str]: of robot or camera; or ""
                                                   │             │─► contact_forces  Value[ContactForces]
                                                   └─────────────┘─► query_object    of SceneGraph

    World frame throughout. A velocity is sampled every `setup.period`, limited in speed and to the pusher's box, and
    held; a translation is sampled every `horizon`. `rgb` shows world 0, `rgb_batch` (uint8) all: the object where it is
    visible with alpha 255, white with alpha 0 elsewhere. W is 1 but for the twin. With the engine "lcm" a robot is
    behind the ports, NaN stands for what it does not know, and it moves in a session alone: see `AddLcmEngine`.

    Attributes:
        setup: Setup that it was made from.
        engine: Engine that moves it.
        world: The twin's WorldModel; None in other engines.
    """

    def __init__(
        self,
        setup: Setup,
        engine: str,
        command: Command,
        meshcat: Meshcat | None,
        lcm: DrakeLcmInterface | None,
        armed: bool,
    ) -> None:
        super().__init__()
        self.setup = setup
        self._start = StartDistribution(setup)
        builder = DiagramBuilder()
        if engine == "lcm":
            parts = AddLcmEngine(builder, setup, lcm, armed)
        elif engine == "twin":
            parts = AddTwinEngine(builder, setup)
        else:
            parts = AddPlantEngine(builder, setup, contact_name(engine))
        self.engine = parts
        self.world = parts.handle if isinstance(parts.handle, WorldModel) else None
        _add_command(builder, parts, setup, command)
        if parts.session is not None:
            builder.ExportInput(parts.session, "session")
        now = builder.AddNamedSystem("present", Clock())
        sound = builder.AddNamedSystem("no_fault", ConstantValueSource(AbstractValue.Make("")))
        outputs = {
            "object_state": parts.object_state,
            "pusher_state": parts.pusher_state,
            "rgb": parts.rgb,
            "rgb_batch": parts.rgb_batch,
            "rgb_time": parts.rgb_time or now.get_output_port(),
            "pusher_time": parts.pusher_time or now.get_output_port(),
            "fault": parts.fault or sound.get_output_port(),
            "contact_forces": parts.contact_forces,
            "query_object": parts.scene_graph.get_query_output_port(),
        }
        for name, port in outputs.items():
            builder.ExportOutput(port, name)
        if meshcat is not None:
            AddSceneView(
                builder, parts.name, parts.scene_graph, parts.object_state, parts.contact_forces, meshcat, setup
            )
        builder.BuildInto(self)
        self.set_name(f"station_{engine}")

    def SetPlace(self, context: Context, place: Place, world: int = 0) -> None:
        """Put object and pusher into place, at rest.

        Args:
            context: Context of the station, or of the outermost diagram around it, where there is one.
            place: Pose of the object and position of the pusher.
            world: Number of one of the twin's worlds.
        """
        self.engine.handle.SetObjectState(context, place.X_WO, np.zeros(6), world)
        self.engine.handle.SetPusherPosition(context, place.p_WP, world)

    def SetRandomContext(self, context: Context, generator: RandomGenerator) -> None:
        """Draws the start of every world from `scenario.start`.

        Drake calls a diagram's own code only, so that `SetRandomContext` of a diagram around the station does not come
        here: call this, with the context of that diagram.

        Args:
            context: Context of the station, or of the outermost diagram around it, where there is one.
            generator: Source of randomness; drawn from once.
        """
        numbers = np.random.default_rng(generator())
        for world in range(self.setup.scenario.num_worlds):
            self.SetPlace(context, self._start.draw(numbers), world)

    def object_pose(self, context: Context, world: int = 0) -> RigidTransform:
        """Pose X_WO of the object in a world; `context` as for `SetPlace`."""
        mine = self.GetMyContextFromRoot(context)
        state = self.GetOutputPort("object_state").Eval(mine)[13 * world :][:7]
        return RigidTransform(Quaternion(wxyz=state[:4] / np.linalg.norm(state[:4])), state[4:])


class Clock(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Time of the Context, s, as a vector (1)."""

    def __init__(self) -> None:
        super().__init__()
        declare_vector(self, "time", 1, lambda context: [context.get_time()], {self.time_ticket()})


def _add_command(builder: DiagramBuilder, parts: Engine, setup: Setup, command: Command) -> None:
    scenario, pusher = setup.scenario, setup.scenario.pusher
    W = scenario.num_worlds
    limits = builder.AddNamedSystem(
        "pusher_limits", PusherLimits(W, pusher.max_speed, pusher.low, pusher.high, setup.period)
    )
    builder.Connect(parts.pusher_state, limits.GetInputPort("pusher_state"))
    builder.Connect(limits.get_output_port(), parts.pusher_velocity)
    velocity = limits.GetInputPort("pusher_velocity_W")
    if command == "velocity":
        builder.ExportInput(velocity, "pusher_velocity_W")
        return
    translation = builder.AddNamedSystem(
        "pusher_translation", PusherTranslation(W, pusher.horizon, pusher.horizon * pusher.max_speed, setup.period)
    )
    builder.Connect(translation.get_output_port(), velocity)
    builder.ExportInput(translation.get_input_port(), "pusher_translation_W")


def make_station(
    scene: Scene,
    engine: str | None = None,
    *,
    command: Command = "velocity",
    meshcat: Meshcat | None = None,
    lcm: DrakeLcmInterface | None = None,
    armed: bool = False,
) -> SceneStation:
    """Assembles the station of a scenario.

    Args:
        scene: A setup, a scenario, the name or path of one, or the folder of a twin; see `load_setup`.
        engine: "twin", "hydroelastic", "point" or "lcm"; None for that of the scenario.
        command: Whether the input is `pusher_velocity_W` or `pusher_translation_W`.
        meshcat: Server that shows everything, if given.
        lcm: LCM that the messages of "lcm" go through; None to open the address that the scenario has.
        armed: Whether "lcm" sends commands: the robot does not move otherwise.

    Raises:
        InputError: The scenario, or one of its files, cannot be used.
        ParameterError: There is no such engine or command, one that is not the twin is to hold several worlds, or an
            address of LCM cannot be used.
    """
    setup = load_setup(scene)
    engine = engine or setup.scenario.engine
    require("engine", repr(engine), engine in STATION_ENGINES, ", ".join(STATION_ENGINES))
    require("command", repr(command), command in ("velocity", "translation"), "velocity, translation")
    if engine != "twin" and setup.scenario.num_worlds != 1:
        raise ParameterError(f"num_worlds: got {setup.scenario.num_worlds} with {engine}; allowed: 1, or the twin")
    return SceneStation(setup, engine, command, meshcat, lcm, armed)
