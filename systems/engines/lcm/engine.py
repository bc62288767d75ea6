# SPDX-License-Identifier: MIT
"""Robot as an engine: commands out, images and the pusher's state in, all over LCM."""

from dataclasses import dataclass, field
from time import sleep

import numpy as np
from drake import lcmt_drake_signal  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.geometry import SceneGraph
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.lcm import LcmInterfaceSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource, PassThrough
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.engine import ContactForces, Engine
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.messages import Tally, make_publisher
from pinwm_drake.systems.engines.lcm.receiver import RobotReceiver
from pinwm_drake.systems.engines.lcm.seal import Seal, seal_of
from pinwm_drake.systems.engines.lcm.signal import COMMAND_NAMES, CommandSender, signal_message
from pinwm_drake.systems.engines.plant.scene import scene_texts
from pinwm_drake.systems.ports import declare_vector
from pinwm_drake.systems.scenario.schema import MEMORY
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution


@dataclass(frozen=True, eq=False)
class LcmHandle:
    """Handle that refuses to put things into place, which takes more than a message; see `engine.Handle`.

    It keeps the LCM, as the systems that use it do not, and sends commands, each `period` [s], if it is armed; signed,
    where there is a seal. Its tally counts messages that were not used.
    """

    lcm: DrakeLcmInterface
    armed: bool
    channel: str
    period: float
    seal: Seal | None = None
    tally: Tally = field(default_factory=Tally)

    def SendStop(self, time: float) -> None:
        """Send zero of no session, past the diagram, where commands are sent at all.

        Drake's LCM keeps one message of a channel between two looks, and drops those that come after it. The zero comes
        right after the last command, so that it is sent again two periods later, when a driver has looked.

        Args:
            time: s, of the message's stamp.
        """
        if not self.armed:
            return
        self._send(time)
        if self.lcm.get_lcm_url() != MEMORY:
            sleep(2.0 * self.period)
            self._send(time)

    def _send(self, time: float) -> None:
        message = signal_message(COMMAND_NAMES, np.zeros(6), time).encode()
        self.lcm.Publish(self.channel, message if self.seal is None else self.seal.sign(self.channel, message))

    def SetObjectState(self, context: Context, X_WO: RigidTransform, V_WO: np.ndarray, world: int = 0) -> None:
        """Refuse to set the object's state: raise ParameterError; arguments as for `engine.Handle`."""
        raise ParameterError("engine lcm: a program cannot move the object of a robot; put it there by hand")

    def SetPusherPosition(self, context: Context, p_WP: np.ndarray, world: int = 0) -> None:
        """Refuse to put the pusher: raise ParameterError; arguments as for `engine.Handle`."""
        raise ParameterError("engine lcm: a program cannot place the pusher of a robot; move the robot there")


def AddLcmEngine(builder: DiagramBuilder, setup: Setup, lcm: DrakeLcmInterface | None, armed: bool) -> Engine:
    """Add the systems that speak with a robot's driver as `LcmLink` says; the engine's handle is an LcmHandle.

    What a robot does not know has no number: `object_state` is NaN throughout, and `contact_forces` has none. The
    pusher's state is NaN before the first message, and where none has come for `timeout`. `rgb` is the last image,
    white before the first, and `rgb_time` when that was taken, -1 before the first: see `Hearing` for what is known of
    it. `fault` says what is wrong with robot, camera or link. The input `session` is the controller's, 0 while it is
    not armed. SceneGraph has the pusher, where it was last known to be, and the floor.

    Args:
        builder: Builder of the diagram.
        setup: The scene; `setup.scenario.lcm` says how the robot is reached.
        lcm: LCM that the messages go through; None to open the link's address.
        armed: Whether commands are sent. There is nothing in the diagram that could send them otherwise.

    Raises:
        InputError: A mesh, or the key of the link, cannot be used.
        ParameterError: The address cannot be used.
    """
    link = setup.scenario.lcm
    lcm = lcm or make_lcm(link)
    builder.AddNamedSystem("lcm", LcmInterfaceSystem(lcm))
    camera, seal, tally = setup.camera, seal_of(link), Tally()
    first = np.concatenate([StartDistribution(setup).middle().p_WP, np.zeros(3)])
    listening = RobotReceiver(lcm, link, camera.width, camera.height, first, tally, seal)
    receiver = builder.AddNamedSystem("robot_receiver", listening)
    commands = builder.AddNamedSystem("command_message", CommandSender(link))
    session = builder.AddNamedSystem("session", PassThrough(1))
    for system in (receiver, commands):
        builder.Connect(session.get_output_port(), system.GetInputPort("session"))
    builder.Connect(receiver.GetOutputPort("robot_time"), commands.GetInputPort("robot_time"))
    if armed:
        sender = make_publisher(link.command_channel, lcmt_drake_signal, lcm, link.period, seal)
        builder.AddNamedSystem("command_publisher", sender)
        builder.Connect(commands.get_output_port(), sender.get_input_port())
    unknown = builder.AddNamedSystem("object_unknown", ConstantVectorSource(np.full(13, np.nan)))
    forces = builder.AddNamedSystem("no_forces", ConstantValueSource(AbstractValue.Make(ContactForces.none())))
    return Engine(
        name="lcm",
        pusher_velocity=commands.GetInputPort("pusher_velocity"),
        object_state=unknown.get_output_port(),
        pusher_state=receiver.GetOutputPort("pusher_state"),
        rgb=receiver.GetOutputPort("rgb"),
        rgb_batch=receiver.GetOutputPort("rgb_batch"),
        contact_forces=forces.get_output_port(),
        scene_graph=_add_pusher_geometry(builder, setup, receiver.GetOutputPort("last_state")),
        handle=LcmHandle(lcm, armed, link.command_channel, link.period, seal, tally),
        rgb_time=receiver.GetOutputPort("rgb_time"),
        pusher_time=receiver.GetOutputPort("pusher_time"),
        fault=receiver.GetOutputPort("fault"),
        session=session.get_input_port(),
    )


def _add_pusher_geometry(builder: DiagramBuilder, setup: Setup, state: OutputPort) -> SceneGraph:
    scene_graph = builder.AddNamedSystem("scene_graph", SceneGraph())
    plant = MultibodyPlant(0.0)
    plant.set_name("plant")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    parser = Parser(plant=plant)
    parser.SetStrictParsing()
    for text in scene_texts(setup, "hydroelastic")[1:]:
        parser.AddModelsFromString(text, "sdf")
    plant.Finalize()
    positions = builder.AddNamedSystem("pusher_position", _Position())
    poses = builder.AddNamedSystem("plant_poses", MultibodyPositionToGeometryPose(plant))
    poses.plant = plant  # which it refers to and does not keep
    builder.Connect(state, positions.get_input_port())
    builder.Connect(positions.get_output_port(), poses.get_input_port())
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(plant.get_source_id()))
    return scene_graph


class _Position(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Position (3) of a state (6), where it is finite, else zero: geometry must be somewhere."""

    def __init__(self) -> None:
        super().__init__()
        state = self.DeclareVectorInputPort("state", 6)
        declare_vector(self, "position", 3, lambda context: np.nan_to_num(state.Eval(context)[:3]))
