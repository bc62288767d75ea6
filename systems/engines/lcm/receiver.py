# SPDX-License-Identifier: MIT
"""Receiver of a robot's states and images, as a station's ports show them."""

import io
import math
import time
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from PIL import Image
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from pinwm_drake.systems.engines.lcm.hearing import Hearing, hear_image, hear_session, hear_state, link_fault
from pinwm_drake.systems.engines.lcm.messages import Mailbox, Tally
from pinwm_drake.systems.engines.lcm.seal import Seal
from pinwm_drake.systems.ports import Immutable, declare_image, declare_value, declare_vector, unowned
from pinwm_drake.systems.scenario.schema import MEMORY, LcmLink

_MICRO = 1e-6  # s
_UNREADABLE = "cannot be read"
_LONGEST = 200  # characters of a fault
_WIDEST = 16384  # px
_IMAGES = 4  # images that wait
_TOLERANCE = 1e-9  # s, of a time-out: far more than rounding, far less than a period


class RobotReceiver(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Receiver that shows what is known of a robot by its messages.

        lcmt_drake_signal on the                 ┌───────────────┐─► pusher_state  (6): NaN where none has come for
        channel of states  ─────────────────────►│               │             `timeout`
                                                 │               │─► last_state    (6): the last one, however old
        lcmt_image_array on the                  │ RobotReceiver │─► pusher_time   (1): s, of the last state, or -1
        channel of images  ─────────────────────►│               │─► rgb, rgb_batch: white, alpha 0 before the first
                                                 │               │─► rgb_time      (1): s, of the exposure, or -1
        session  (1): the controller's, or 0 ───►│               │─► fault      Value[str]: what is wrong; or ""
                                                 └───────────────┘─► robot_time    (1): s, last state, robot's clock

    The state of the system, a `Hearing` and the last image, takes in every `period` the messages that have come. An
    image that cannot be used is white, a fault, and counted. Whatever else goes wrong with a message is a fault, too:
    nothing is raised.

    Args:
        lcm: LCM that the messages come through; somebody has to pump it.
        link: Channels, periods and time-out.
        width: px, of the images.
        height: px, of the images.
        first: (6,), state that `last_state` shows before the first message: p_WP [m], v_WP [m/s].
        tally: Counts messages that are not used.
        seal: Seal of this end; None where messages are not signed.
    """

    def __init__(
        self,
        lcm: DrakeLcmInterface,
        link: LcmLink,
        width: int,
        height: int,
        first: np.ndarray,
        tally: Tally,
        seal: Seal | None,
    ) -> None:
        super().__init__()
        self._link, self._first = link, np.asarray(first, float).reshape(6)
        self._white = np.full((height, width, 4), 255, np.uint8)
        self._white[..., 3] = 0
        self._tally = tally
        self._states = Mailbox(link.state_channel, lcmt_drake_signal, lcm, tally, seal)
        most = _most_bytes(width, height)
        self._images = Mailbox(link.image_channel, lcmt_image_array, lcm, tally, seal, most=most, waiting=_IMAGES)
        self._session = self.DeclareVectorInputPort("session", 1)
        self._known = self.DeclareAbstractState(AbstractValue.Make(_Known(Hearing(), self._white, "")))
        self.DeclarePeriodicUnrestrictedUpdateEvent(link.period, 0.0, unowned(self, self._Update))
        known = {self.abstract_state_ticket(self._known)}
        get, size = self._get, (width, height)
        declare_vector(self, "pusher_state", 6, self._CalcPusherState)
        declare_vector(self, "last_state", 6, lambda context: get(context).heard.values[:6] or self._first, known)
        declare_vector(self, "pusher_time", 1, lambda context: [max(get(context).heard.time, -1.0)], known)
        declare_image(self, "rgb", size, lambda context: get(context).picture, known)
        declare_value(self, "rgb_batch", object(), lambda context: get(context).picture[None], known)
        declare_vector(self, "rgb_time", 1, lambda context: [max(get(context).heard.image_time, -1.0)], known)
        declare_value(self, "fault", "", self._CalcFault, known | {self.time_ticket()})
        declare_vector(self, "robot_time", 1, self._CalcRobotTime, known)

    def _get(self, context: Context) -> "_Known":
        return context.get_abstract_state(int(self._known)).get_value()

    def _Update(self, context: Context, state: State) -> EventStatus:
        before = self._get(context)
        try:
            known = self._heard(before, context)
        except Exception as error:  # whatever somebody sent
            words = f"message cannot be handled: {type(error).__name__}: {error}"[:_LONGEST]
            self._tally.note(self._link.state_channel, "cannot be handled", words)
            known = replace(before, heard=replace(before.heard, fault=words), picture=self._white)
        if known is not before:
            state.get_mutable_abstract_state(int(self._known)).set_value(known)
        return EventStatus.Succeeded()

    def _heard(self, before: "_Known", context: Context) -> "_Known":
        """Return what is known after the messages that have come."""
        heard, link, now, known = before.heard, self._link, context.get_time(), before
        wall = now if link.url == MEMORY else time.monotonic()
        session = int(self._session.Eval(context)[0]) if self._session.HasValue(context) else 0
        heard = hear_session(heard, session, now)
        # A driver that begins anew is another run of it, which nobody takes the place of in a session.
        for message in self._states.take(adopt=session == 0 and now - heard.arrival > link.timeout):
            if message.dim < 0:
                heard = replace(heard, fault="robot's state cannot be read")
                self._tally.note(link.state_channel, _UNREADABLE)
            else:
                stamp = _MICRO * message.timestamp
                heard = hear_state(heard, stamp, list(message.val), now, wall, link.period, link.timeout)
        for images in self._images.take():
            if images.num_images != 1:
                number = f"{images.num_images} images; allowed: 1"
                known = self._unusable(known, "cannot be read" if images.num_images < 0 else f"has {number}")
                continue
            stamp = _MICRO * images.header.utime
            if stamp != heard.image_stamp or known.wrong:
                known = self._seen(known, images.images[0])
            heard = hear_image(heard, stamp, now, wall, link.period)
        if math.isfinite(heard.image_stamp):  # its time is known as soon as a state has come
            heard = hear_image(heard, heard.image_stamp, now, wall, link.period)
        return known if heard is known.heard else replace(known, heard=heard)

    def _seen(self, known: "_Known", image: lcmt_image) -> "_Known":
        height, width, _ = self._white.shape
        try:
            picture = pixels_of(image, (width, height))
        except ValueError as error:
            return self._unusable(known, str(error))
        picture[picture[..., 3] == 0, :3] = 255
        return replace(known, picture=picture, wrong="")

    def _unusable(self, known: "_Known", words: str) -> "_Known":
        wrong = f"image {words}"[:_LONGEST]
        self._tally.note(self._link.image_channel, "images that cannot be used", wrong)
        return replace(known, picture=self._white, wrong=wrong)

    def _CalcPusherState(self, context: Context) -> Sequence[float]:
        heard = self._get(context).heard
        fresh = heard.values and context.get_time() - heard.arrival <= self._link.timeout + _TOLERANCE
        return heard.values[:6] if fresh else 6 * [math.nan]

    def _CalcRobotTime(self, context: Context) -> list[float]:
        heard = self._get(context).heard
        return [heard.stamp if heard.values else -1.0]

    def _CalcFault(self, context: Context) -> str:
        known = self._get(context)
        return link_fault(known.heard, context.get_time(), self._link.timeout) or known.wrong


@dataclass(frozen=True, eq=False)
class _Known(Immutable):
    """State of the receiver: what was heard, the last image (height, width, 4) uint8, and its fault in words."""

    heard: Hearing
    picture: np.ndarray
    wrong: str


def pixels_of(image: lcmt_image, size: tuple[int, int] | None = None) -> np.ndarray:
    """Pixels (height, width, 4) uint8, RGBA, of an image as it is sent: plain, or packed by zlib or as PNG.

    What the header says is checked before anything is unpacked, and no more is unpacked than it says.

    Args:
        image: The image.
        size: Width and height, px, that it has to have; None for any up to 16384 px.

    Raises:
        ValueError: It is of another kind or size, or its bytes are not those of such an image; the words follow
            "image".
    """
    width, height, data = image.width, image.height, bytes(image.data)
    row, method = 4 * width, image.compression_method
    if image.pixel_format != lcmt_image.PIXEL_FORMAT_RGBA or image.channel_type != lcmt_image.CHANNEL_TYPE_UINT8:
        kind = f"got pixel format {image.pixel_format} of type {image.channel_type}"
        raise ValueError(f"cannot be used: {kind}; allowed: RGBA of uint8")
    if not (1 <= width <= _WIDEST and 1 <= height <= _WIDEST):
        raise ValueError(f"cannot be used: got {width} by {height} px; allowed: 1 to {_WIDEST}")
    if image.size != len(data):
        raise ValueError(f"cannot be used: got {len(data)} bytes of {image.size}; allowed: all of them")
    if method == lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED and len(data) != row * height:
        raise ValueError(f"cannot be used: got {len(data)} bytes; allowed: {row * height}")
    if size is not None and (width, height) != size:
        raise ValueError(f"has {width} by {height} px; allowed: {size[0]} by {size[1]}")
    if len(data) > _most_bytes(width, height):
        raise ValueError(f"cannot be used: got {len(data)} bytes; allowed: {_most_bytes(width, height)}")
    if image.row_stride not in (0, row):
        raise ValueError(f"cannot be used: got rows of {image.row_stride} bytes; allowed: {row}")
    if method == lcmt_image.COMPRESSION_METHOD_PNG:
        return _unpacked_png(data, (width, height))
    if method == lcmt_image.COMPRESSION_METHOD_ZLIB:
        unpacking = zlib.decompressobj()
        try:
            data = unpacking.decompress(data, row * height + 1)
        except zlib.error as error:
            raise ValueError(f"cannot be used: got unreadable bytes ({error})") from error
        if len(data) > row * height:
            raise ValueError(f"cannot be used: got more bytes than {row * height}; allowed: {row * height}")
        if not unpacking.eof or unpacking.unused_data:
            raise ValueError("cannot be used: got unreadable bytes (packed data that ends early or goes on)")
    elif method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        raise ValueError(f"cannot be used: got compression {method}; allowed: none, zlib, PNG")
    if len(data) != row * height:
        raise ValueError(f"cannot be used: got {len(data)} bytes; allowed: {row * height}")
    return np.frombuffer(data, np.uint8).reshape(height, width, 4).copy()


def _unpacked_png(data: bytes, size: tuple[int, int]) -> np.ndarray:
    """Pixels of a PNG file, whose own header has to say the same size, width and height in px."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data), formats=["PNG"])
            found = image.size
            pixels = np.array(image.convert("RGBA")) if found == size else None
    except Exception as error:  # Pillow raises many kinds
        raise ValueError(f"cannot be used: got unreadable PNG ({error})") from error
    if pixels is None:
        raise ValueError(f"cannot be used: got a PNG of {found[0]} by {found[1]} px; allowed: {size[0]} by {size[1]}")
    return pixels


def _most_bytes(width: int, height: int) -> int:
    """Largest size of a message with an image: packing may make noise a little larger."""
    return 5 * width * height + 4096
