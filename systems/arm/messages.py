# SPDX-License-Identifier: MIT
"""Messages of an arm's simulated driver over LCM; see `LcmLink`."""

import zlib

import numpy as np
from drake import (  # type: ignore[import-untyped]  # LCM's types
    lcmt_image,
    lcmt_image_array,
    lcmt_panda_command,
    lcmt_panda_status,
)
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import PandaCommandReceiver, PandaCommandSender, PandaControlMode, PandaStatusSender
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort, State
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.primitives import Demultiplexer, Multiplexer
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.systems.arm.model import JOINTS
from pinwm_drake.systems.engines.lcm.seal import Seal
from pinwm_drake.systems.ports import unowned
from pinwm_drake.systems.sampling import period_index, whole_multiple
from pinwm_drake.systems.scenario.schema import LcmLink

_NOISE = 1.0  # of 255 levels, rms
_SELDOM = 4  # periods between statuses of a Panda, as the plant computes its torques anew for each
# Not the names that a Panda's own driver listens to: nothing simulated is to move a robot.
PANDA_COMMAND, PANDA_STATUS = "PINWM_PANDA_COMMAND", "PINWM_PANDA_STATUS"
STATE_NAMES = ("px", "py", "pz", "vx", "vy", "vz", "session", "sequence", "mode", "fault")


class ImageSender(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Sender of a camera's pictures, with the noise (one level of 255, rms) and the delay of a real one.

                             ┌─────────────┐
        rgb  ImageRgba8U ───►│ ImageSender │─► lcmt_image_array on the image channel, RGBA packed by zlib, stamped with
                             └─────────────┘   the time that it shows [us]

    Pictures are timed such that each comes two periods before a controller acts that acts at multiples of
    `image_period`.

    Args:
        lcm: LCM that the messages go through.
        link: Channel and periods.
        width: px.
        height: px.
        latency: s, from the moment that a picture shows to that at which it is sent; a period at least.
        seal: Signs the messages; None where nobody does.
    """

    def __init__(
        self, lcm: DrakeLcmInterface, link: LcmLink, width: int, height: int, latency: float, seal: Seal | None = None
    ) -> None:
        super().__init__()
        self._lcm, self._channel, self._seal = lcm, link.image_channel, seal
        self._rgb = self.DeclareAbstractInputPort("rgb", AbstractValue.Make(ImageRgba8U(width, height)))
        self._waiting = self.DeclareAbstractState(AbstractValue.Make(()))
        self._period, self._pause = link.period, whole_multiple("lcm.image_period", link.image_period, link.period)
        self._late = max(round(latency / link.period), 1)
        self._first = (self._pause - 2 - self._late) % self._pause
        # Where both are due, Drake sends first.
        self.DeclarePeriodicUnrestrictedUpdateEvent(link.period, 0.0, unowned(self, self._Update))
        self.DeclarePeriodicPublishEvent(link.period, 0.0, unowned(self, self._Send))

    def _Update(self, context: Context, state: State) -> EventStatus:
        kept, number = self._pictures(context), period_index(context.get_time(), self._period)
        waiting = tuple(entry for entry in kept if entry[0] > number)
        if number % self._pause == self._first:
            waiting = (*waiting, (number + self._late, self._taken(context)))
        elif len(waiting) == len(kept):
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(int(self._waiting)).set_value(waiting)
        return EventStatus.Succeeded()

    def _Send(self, context: Context) -> EventStatus:
        number = period_index(context.get_time(), self._period)
        for due, message in self._pictures(context):
            if due == number:
                signed = message if self._seal is None else self._seal.sign(self._channel, message)
                self._lcm.Publish(self._channel, signed)
        return EventStatus.Succeeded()

    def _pictures(self, context: Context) -> tuple[tuple[int, bytes], ...]:
        """Pictures that wait: numbers of the periods in which they are sent, and messages."""
        return context.get_abstract_state(int(self._waiting)).get_value()

    def _taken(self, context: Context) -> bytes:
        time, picture = context.get_time(), np.array(self._rgb.Eval(context).data)
        # The noise of a moment, so that a context that is copied goes on the same.
        noise = np.random.default_rng(round(1e6 * time)).normal(0.0, _NOISE, (*picture.shape[:2], 3))
        seen = picture[..., 3] > 0
        noisy = np.clip(np.rint(picture[..., :3] + noise), 0, 254).astype(np.uint8)
        picture[..., :3][seen] = noisy[seen]
        return bytes(image_message(picture, time).encode())


def image_message(picture: np.ndarray, time: float) -> lcmt_image_array:
    """Message of a picture (height, width, 4) uint8, RGBA, stamped with a time [s]."""
    image, message = lcmt_image(), lcmt_image_array()
    image.height, image.width = picture.shape[:2]
    image.row_stride = 4 * image.width
    image.data = zlib.compress(np.ascontiguousarray(picture).tobytes(), 1)
    image.size = len(image.data)
    image.pixel_format, image.channel_type = lcmt_image.PIXEL_FORMAT_RGBA, lcmt_image.CHANNEL_TYPE_UINT8
    image.compression_method = lcmt_image.COMPRESSION_METHOD_ZLIB
    message.header.utime = round(1e6 * time)
    message.num_images, message.images = 1, [image]
    return message


def AddPandaMessages(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    period: float,
    plant: MultibodyPlant,
    arm: ModelInstanceIndex,
    wanted: OutputPort,
) -> OutputPort:
    """Add the messages of a Panda's joints to a diagram; they go through `lcmt_panda_command`, as a driver takes it.

    Commands and `lcmt_panda_status` are published on the channels `PANDA_COMMAND` and `PANDA_STATUS`, for whoever
    watches.

    Args:
        builder: Builder of the diagram.
        lcm: LCM that the messages go through.
        period: s, of the commands that are published; statuses come every fourth.
        plant: The plant.
        arm: The Panda's model instance in it.
        wanted: Port (14) of the angles [rad] and velocities [rad/s] that are wanted.

    Returns:
        An output port (14) with the same, as the commands have them.
    """
    mode = PandaControlMode.kPosition | PandaControlMode.kVelocity
    sender = builder.AddNamedSystem("panda_command_sender", PandaCommandSender(JOINTS, mode))
    receiver = builder.AddNamedSystem("panda_command_receiver", PandaCommandReceiver(JOINTS, mode))
    status = builder.AddNamedSystem("panda_status_sender", PandaStatusSender(JOINTS))
    targets, measured, both = (
        Demultiplexer(2 * JOINTS, JOINTS),
        Demultiplexer(2 * JOINTS, JOINTS),
        Multiplexer([JOINTS] * 2),
    )
    for name, system in (("panda_targets", targets), ("panda_measured", measured), ("panda_commands", both)):
        builder.AddNamedSystem(name, system)
    builder.Connect(wanted, targets.get_input_port())
    builder.Connect(plant.get_state_output_port(arm), measured.get_input_port())
    builder.Connect(sender.get_output_port(), receiver.get_input_port(0))
    builder.Connect(measured.get_output_port(0), receiver.GetInputPort("position_measured"))
    torque = plant.get_net_actuation_output_port(arm)
    for name in ("torque_commanded", "torque_measured"):
        builder.Connect(torque, status.GetInputPort(name))
    for number, name in enumerate(("position", "velocity")):
        builder.Connect(targets.get_output_port(number), sender.GetInputPort(name))
        builder.Connect(receiver.GetOutputPort(name), both.get_input_port(number))
        builder.Connect(targets.get_output_port(number), status.GetInputPort(f"{name}_commanded"))
        builder.Connect(measured.get_output_port(number), status.GetInputPort(f"{name}_measured"))
    for channel, kind, source, every in (
        (PANDA_COMMAND, lcmt_panda_command, sender, period),
        (PANDA_STATUS, lcmt_panda_status, status, _SELDOM * period),
    ):
        publisher = LcmPublisherSystem.Make(channel, kind, lcm, every, use_cpp_serializer=True)
        builder.AddNamedSystem(f"{channel.lower()}_publisher", publisher)
        builder.Connect(source.get_output_port(), publisher.get_input_port())
    return both.get_output_port()
