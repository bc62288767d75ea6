# SPDX-License-Identifier: MIT
"""Receiver of a robot's states and images, as a station's ports show them."""

import io
import math
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from PIL import Image
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from pinwm_drake.systems.engines.lcm.hearing import Hearing, hear_image, hear_session, hear_state, link_fault
from pinwm_drake.systems.ports import Immutable, declare_image, declare_value, declare_vector
from pinwm_drake.systems.scenario.schema import MEMORY, LcmLink

_MICRO = 1e-6  # s
_UNREADABLE = "image cannot be read"
_TOLERANCE = 1e-9  # s, of a time-out: far more than rounding, far less than a period


class RobotReceiver(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Receiver that shows what is known of a robot by its messages.

                                                   ┌───────────────┐─► pusher_state  (6): NaN where none has come for
        state_message  Value[lcmt_drake_signal] ──►│               │             `timeout`
                                                   │               │─► last_state    (6): the last one, however old
        image_message  Value[lcmt_image_array]  ──►│ RobotReceiver │─► pusher_time   (1): s, of the last state, or -1
                                                   │               │─► rgb, rgb_batch: white, alpha 0 before the first
        session  (1): the controller's, or 0  ────►│               │─► rgb_time      (1): s, of the exposure, or -1
                                                   │               │─► fault      Value[str]: what is wrong; or ""
                                                   └───────────────┘─► robot_time    (1): s, last state, robot's clock

    The state of the system, a `Hearing` and the last image, takes messages in every `period`. An image that cannot be
    used is white, and a fault: nothing is raised.

    Args:
        link: Address, periods and time-out.
        width: px, of the images.
        height: px, of the images.
        first: (6,), state that `last_state` shows before the first message: p_WP [m], v_WP [m/s].
    """

    def __init__(self, link: LcmLink, width: int, height: int, first: np.ndarray) -> None:
        super().__init__()
        self._link, self._first = link, np.asarray(first, float).reshape(6)
        self._white = np.full((height, width, 4), 255, np.uint8)
        self._white[..., 3] = 0
        self._states = self.DeclareAbstractInputPort("state_message", AbstractValue.Make(lcmt_drake_signal()))
        self._images = self.DeclareAbstractInputPort("image_message", AbstractValue.Make(lcmt_image_array()))
        self._session = self.DeclareVectorInputPort("session", 1)
        self._known = self.DeclareAbstractState(AbstractValue.Make(_Known(Hearing(), self._white, "")))
        self.DeclarePeriodicUnrestrictedUpdateEvent(link.period, 0.0, self._Update)
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
        before, link, now = self._get(context), self._link, context.get_time()
        heard, picture, wrong = before.heard, before.picture, before.wrong
        wall = now if link.url == MEMORY else time.monotonic()
        session = int(self._session.Eval(context)[0]) if self._session.HasValue(context) else 0
        heard = hear_session(heard, session, now)
        message, images = self._states.Eval(context), self._images.Eval(context)
        if message.dim < 0:
            heard = replace(heard, fault="robot's state cannot be read")
        elif message.timestamp or message.dim:
            stamp = _MICRO * message.timestamp
            heard = hear_state(heard, stamp, list(message.val), now, wall, link.period, link.timeout)
        if images.num_images < 0:
            picture, wrong = self._white, _UNREADABLE
        if images.num_images >= 1:
            stamp = _MICRO * images.header.utime
            if stamp != heard.image_stamp or before.wrong == _UNREADABLE:
                picture, wrong = self._seen(images.images[0])
            heard = hear_image(heard, stamp, now, wall, link.period)
        if heard is not before.heard or wrong != before.wrong:
            state.get_mutable_abstract_state(int(self._known)).set_value(_Known(heard, picture, wrong))
        return EventStatus.Succeeded()

    def _seen(self, image: lcmt_image) -> tuple[np.ndarray, str]:
        try:
            picture = pixels_of(image)
        except ValueError as error:
            return self._white, f"image cannot be used: {error}"
        if picture.shape != self._white.shape:
            (height, width, _), (wanted_height, wanted_width, _) = picture.shape, self._white.shape
            return self._white, f"image has {width} by {height} px; allowed: {wanted_width} by {wanted_height}"
        picture[picture[..., 3] == 0, :3] = 255
        return picture, ""

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


def pixels_of(image: lcmt_image) -> np.ndarray:
    """Pixels (height, width, 4) uint8, RGBA, of an image as it is sent: plain, or packed by zlib or as PNG.

    Raises:
        ValueError: It is of another kind, or its bytes are not those of such an image.
    """
    if image.pixel_format != lcmt_image.PIXEL_FORMAT_RGBA or image.channel_type != lcmt_image.CHANNEL_TYPE_UINT8:
        raise ValueError(f"got pixel format {image.pixel_format} of type {image.channel_type}; allowed: RGBA of uint8")
    if image.width < 1 or image.height < 1:
        raise ValueError(f"got {image.width} by {image.height} px; allowed: 1 or more")
    data = bytes(image.data)
    if image.compression_method == lcmt_image.COMPRESSION_METHOD_PNG:
        try:
            return np.array(Image.open(io.BytesIO(data), formats=["PNG"]).convert("RGBA"))
        except OSError as error:
            raise ValueError(f"got unreadable PNG ({error})") from error
    if image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB:
        try:
            data = zlib.decompress(data)
        except zlib.error as error:
            raise ValueError(f"got unreadable bytes ({error})") from error
    elif image.compression_method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        raise ValueError(f"got compression {image.compression_method}; allowed: none, zlib, PNG")
    if len(data) != (size := 4 * image.width * image.height):
        raise ValueError(f"got {len(data)} bytes; allowed: {size}")
    return np.frombuffer(data, np.uint8).reshape(image.height, image.width, 4).copy()
