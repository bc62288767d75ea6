"""Robot as an engine: commands out, images and the pusher's state in, all over LCM."""

from dataclasses import dataclass

import numpy as np
from drake import lcmt_drake_signal, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.geometry import SceneGraph
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, InputPort, LeafSystem, OutputPort
from pydrake.systems.lcm import LcmInterfaceSystem, LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource
from pydrake.systems.rendering import MultibodyPositionToGeometryPose
from pydrake.systems.sensors import LcmImageArrayToImages

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.engine import ContactForces, Engine
from pinwm_drake.systems.engines.lcm.images import ImageTime, ReceivedImage
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.signal import SignalReceiver, SignalSender
from pinwm_drake.systems.engines.plant.scene import scene_texts
from pinwm_drake.systems.scenario.schema import LcmLink
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution

_COMMAND = ("vx", "vy", "vz")


@dataclass(frozen=True, eq=False)
class LcmHandle:
    """Handle that refuses to put things into place, which takes more than a message; see `engine.Handle`.

    Attributes:
        lcm: Kept, as the systems that use it do not.
        armed: Whether commands are sent.
    """

    lcm: DrakeLcmInterface
    armed: bool

    def SetObjectState(self, context: Context, X_WO: RigidTransform, V_WO: np.ndarray, world: int = 0) -> None:
        """Refuses to set the object's state: raises ParameterError."""
        raise ParameterError("engine lcm: got a place for the object; allowed: to be put there by hand")

    def SetPusherPosition(self, context: Context, p_WP: np.ndarray, world: int = 0) -> None:
        """Refuses to put the pusher: raises ParameterError."""
        raise ParameterError("engine lcm: got a place for the pusher; allowed: to be moved there with the robot")


def AddLcmEngine(builder: DiagramBuilder, setup: Setup, lcm: DrakeLcmInterface | None, armed: bool) -> Engine:
    """Adds the systems that speak with a robot's driver as `LcmLink` says.

    What a robot does not know has no number: `object_state` is NaN throughout, and `contact_forces` has none. The
    pusher's state is NaN before the first message, and where none has come for `timeout`. `rgb` is the last image,
    white before the first, and `rgb_time` when that was taken, -1 before the first: see `Heard` for what is known of
    it. SceneGraph has the pusher, where it was last known to be, and the floor.

    Args:
        builder: Builder of the diagram.
        setup: The scene; `setup.scenario.lcm` says how the robot is reached.
        lcm: LCM that the messages go through; None to open the link's address.
        armed: Whether commands are sent. There is nothing in the diagram that could send them otherwise.

    Returns:
        The engine; its handle is an LcmHandle.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The address cannot be used.
    """
    link = setup.scenario.lcm
    lcm = lcm or make_lcm(link)
    builder.AddNamedSystem("lcm", LcmInterfaceSystem(lcm))
    pusher = SignalReceiver(6, link.period, link.timeout, first=_first_state(setup))
    builder.AddNamedSystem("pusher_receiver", pusher)
    states = LcmSubscriberSystem.Make(link.state_channel, lcmt_drake_signal, lcm)
    builder.AddNamedSystem("state_subscriber", states)
    builder.Connect(states.get_output_port(), pusher.get_input_port())
    image, time = _add_images(builder, setup, lcm, link)
    unknown = builder.AddNamedSystem("object_unknown", ConstantVectorSource(np.full(13, np.nan)))
    forces = builder.AddNamedSystem("no_forces", ConstantValueSource(AbstractValue.Make(ContactForces.none())))
    return Engine(
        name="lcm",
        pusher_velocity=_add_commands(builder, lcm, link, armed),
        object_state=unknown.get_output_port(),
        pusher_state=pusher.GetOutputPort("values"),
        rgb=image.GetOutputPort("rgb"),
        rgb_batch=image.GetOutputPort("rgb_batch"),
        contact_forces=forces.get_output_port(),
        scene_graph=_add_pusher_geometry(builder, setup, pusher.GetOutputPort("last")),
        handle=LcmHandle(lcm, armed),
        rgb_time=time,
    )


def _first_state(setup: Setup) -> np.ndarray:
    """State (6,) of the pusher that is shown before it is known: p_WP [m] and v_WP [m/s]."""
    return np.concatenate([StartDistribution(setup).middle().p_WP, np.zeros(3)])


def _add_commands(builder: DiagramBuilder, lcm: DrakeLcmInterface, link: LcmLink, armed: bool) -> InputPort:
    """Adds the input that takes velocities and, if the station is armed, sends them."""
    message = builder.AddNamedSystem("command_message", SignalSender(_COMMAND))
    if armed:
        sender = LcmPublisherSystem.Make(link.command_channel, lcmt_drake_signal, lcm, publish_period=link.period)
        builder.AddNamedSystem("command_publisher", sender)
        builder.Connect(message.get_output_port(), sender.get_input_port())
    return message.get_input_port()


def _add_images(
    builder: DiagramBuilder, setup: Setup, lcm: DrakeLcmInterface, link: LcmLink
) -> tuple[ReceivedImage, OutputPort]:
    """Adds the system that shows the last image, and the port of the time at which it was taken."""
    # Two subscribers, as Drake's own system for images reads C++ messages, and Python cannot look into these.
    packed = LcmSubscriberSystem.Make(link.image_channel, lcmt_image_array, lcm, use_cpp_serializer=True)
    stamped = LcmSubscriberSystem.Make(link.image_channel, lcmt_image_array, lcm)
    camera = setup.camera
    unpack = builder.AddNamedSystem("unpack_images", LcmImageArrayToImages())
    image = builder.AddNamedSystem("image", ReceivedImage(camera.width, camera.height, link.image_channel))
    time = builder.AddNamedSystem("image_time", ImageTime(link.period, link.timeout))
    builder.AddNamedSystem("image_subscriber", packed)
    builder.AddNamedSystem("stamp_subscriber", stamped)
    builder.Connect(packed.get_output_port(), unpack.get_input_port())
    builder.Connect(unpack.GetOutputPort("color_image"), image.get_input_port())
    builder.Connect(stamped.get_output_port(), time.get_input_port())
    return image, time.get_output_port()


def _add_pusher_geometry(builder: DiagramBuilder, setup: Setup, state: OutputPort) -> SceneGraph:
    """Adds a SceneGraph with pusher and floor, posed by a state (6)."""
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
        self._state = self.DeclareVectorInputPort("state", 6)
        self.DeclareVectorOutputPort("position", 3, self._CalcPosition)

    def _CalcPosition(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.nan_to_num(self._state.Eval(context)[:3]))
