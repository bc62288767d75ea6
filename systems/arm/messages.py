"""Messages of an arm's simulated driver over LCM, in and out; see `LcmLink`."""

from drake import lcmt_drake_signal, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from pydrake.geometry import SceneGraph
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.sensors import ImageToLcmImageArrayT, PixelType

from pinwm_drake.systems.cameras.object_camera import AddCaptureRig, ObjectImage
from pinwm_drake.systems.engines.lcm.signal import SignalReceiver, SignalSender
from pinwm_drake.systems.scenario.schema import LcmLink
from pinwm_drake.systems.scenario.setup import Setup

_SUPERSAMPLING = 3
_NAMES = ("px", "py", "pz", "vx", "vy", "vz")


def AddCommands(builder: DiagramBuilder, lcm: DrakeLcmInterface, link: LcmLink) -> SignalReceiver:
    """Adds the receiver of the commands (3): v_WP [m/s].

    Args:
        builder: Builder of the diagram, which pumps `lcm`.
        lcm: LCM that the messages go through.
        link: Names of the channels.

    Returns:
        The receiver, with the ports "values" and "time".
    """
    subscriber = LcmSubscriberSystem.Make(link.command_channel, lcmt_drake_signal, lcm)
    builder.AddNamedSystem("command_subscriber", subscriber)
    commands = builder.AddNamedSystem("commands", SignalReceiver(3, link.period, link.timeout))
    builder.Connect(subscriber.get_output_port(), commands.get_input_port())
    return commands


def AddState(builder: DiagramBuilder, lcm: DrakeLcmInterface, link: LcmLink, state: OutputPort) -> None:
    """Adds the sender of the tool's `state` (6), p_WP [m] and v_WP [m/s]; arguments as for `AddCommands`."""
    message = builder.AddNamedSystem("state_message", SignalSender(_NAMES))
    publisher = LcmPublisherSystem.Make(link.state_channel, lcmt_drake_signal, lcm, publish_period=link.period)
    builder.AddNamedSystem("state_publisher", publisher)
    builder.Connect(state, message.get_input_port())
    builder.Connect(message.get_output_port(), publisher.get_input_port())


def AddCamera(builder: DiagramBuilder, lcm: DrakeLcmInterface, scene_graph: SceneGraph, setup: Setup) -> None:
    """Adds the scenario's camera, which sends its pictures with the object cut out; arguments as for `AddCommands`."""
    camera, link = setup.camera, setup.scenario.lcm
    rig = AddCaptureRig(builder, scene_graph, camera, _SUPERSAMPLING, setup.X_WC)
    image = builder.AddNamedSystem("object_image", ObjectImage(camera.width, camera.height, _SUPERSAMPLING))
    builder.Connect(rig.sensor.color_image_output_port(), image.GetInputPort("color_image"))
    builder.Connect(rig.sensor.label_image_output_port(), image.GetInputPort("label_image"))
    packer = builder.AddNamedSystem("image_message", ImageToLcmImageArrayT(do_compress=True))
    port = packer.DeclareImageInputPort[PixelType.kRgba8U]("rgb")
    builder.Connect(image.GetOutputPort("rgb"), port)
    # Taken one period early, so that it has arrived when a controller acts.
    sender = LcmPublisherSystem.Make(
        link.image_channel,
        lcmt_image_array,
        lcm,
        publish_period=link.image_period,
        publish_offset=link.image_period - link.period,
        use_cpp_serializer=True,
    )
    builder.AddNamedSystem("image_sender", sender)
    builder.Connect(packer.get_output_port(), sender.get_input_port())
