# SPDX-License-Identifier: MIT
"""Faults that a rehearsal brings about: what they do to the messages between a controller and a robot.

A fault of a channel is a function from a message (bytes) to the messages that are passed on in its place, each with a
delay [s]. It is made anew for every trial, so that it may remember what has passed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types

from pinwm_drake.systems.arm.messages import image_message
from pinwm_drake.systems.engines.lcm.receiver import pixels_of

Channel = Literal["image", "state", "command", "policy", "process"]
Passed = list[tuple[float, bytes]]
Disturb = Callable[[bytes], Passed]

IMAGE_LIMIT, SILENCE, CONTENT, PACE = "image age", "silence", "next message", "action"
STALL = 0.5  # s, of a policy or process that stands still
_LATE, _QUEUE = 0.5, 5.0  # s
_MODE, _FAULT, _SESSION, _SEQUENCE, _EXPIRY = 8, 9, 3, 4, 5  # places in a state and in a command


@dataclass(frozen=True)
class FaultKind:
    """Kind of fault.

    Attributes:
        name: Short name.
        words: What happens.
        channel: Messages that it disturbs; "policy" and "process" are the controller's own.
        known: After what it can be known at the earliest: the next message, the limit of an image's age, the time-out
            of a silence, or the end of an action.
        make: Function that makes the fault of a channel, from the channel's last messages, the oldest first; None for
            those of policy and process.
    """

    name: str
    words: str
    channel: Channel
    known: str
    make: Callable[[list[bytes]], Disturb] | None = None


def _pixels(message: bytes) -> tuple[float, np.ndarray]:
    """Stamp [s] of an image message, and its pixels (height, width, 4) uint8."""
    array = lcmt_image_array.decode(message)
    return 1e-6 * array.header.utime, pixels_of(array.images[0])


def _changed(kind: type, change: Callable[[Any], None]) -> Callable[[list[bytes]], Disturb]:
    """Fault that changes every message of one of LCM's types."""

    def disturb(message: bytes) -> Passed:
        decoded = kind.decode(message)  # type: ignore[attr-defined]
        change(decoded)
        return [(0.0, decoded.encode())]

    return lambda past: disturb


def _drawn(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[list[bytes]], Disturb]:
    """Fault that changes the pixels of every image."""

    def disturb(message: bytes) -> Passed:
        stamp, pixels = _pixels(message)
        return [(0.0, image_message(change(pixels), stamp).encode())]

    return lambda past: disturb


def _white(pixels: np.ndarray) -> np.ndarray:
    pixels[..., :3], pixels[..., 3] = 255, 0
    return pixels


def _covered(pixels: np.ndarray) -> np.ndarray:
    seen = pixels[pixels[..., 3] > 0]
    pixels[:] = seen[len(seen) // 2] if len(seen) else (90, 90, 90, 255)
    return pixels


def _shifted(pixels: np.ndarray) -> np.ndarray:
    """Pixels moved by a third of the image to the side where there is room."""
    width = pixels.shape[1]
    u = np.nonzero(pixels[..., 3].any(axis=0))[0]
    way = width // 3 if len(u) and u.mean() < width / 2 else -(width // 3)
    return np.asarray(np.roll(pixels, way, axis=1))


def _speck(pixels: np.ndarray) -> np.ndarray:
    """Pixels of the object but for two white: a mask that has lost it."""
    rows, columns = np.nonzero(pixels[..., 3])
    kept = pixels.copy()
    _white(pixels)
    for row, column in list(zip(rows, columns, strict=True))[:2]:
        pixels[row, column] = kept[row, column]
    return pixels


def _frozen(past: list[bytes]) -> Disturb:
    pixels = _pixels(past[-1])[1]
    return _drawn(lambda _: pixels)(past)


def _repeated(past: list[bytes]) -> Disturb:
    last = past[-1]
    return lambda message: [(0.0, last)]


def _grey(array: lcmt_image_array) -> None:
    """Make an image of one channel, as another camera's driver sends it."""
    image = array.images[0]
    grey = pixels_of(image)[..., :1].tobytes()
    image.pixel_format, image.row_stride = lcmt_image.PIXEL_FORMAT_GRAY, image.width
    image.data, image.size = grey, len(grey)
    image.compression_method = lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED


def _torn(array: lcmt_image_array) -> None:
    image = array.images[0]
    image.data = image.data[: len(image.data) // 2]
    image.size = len(image.data)


def _stamped(offset: float) -> Callable[[list[bytes]], Disturb]:

    def change(array: lcmt_image_array) -> None:
        array.header.utime += round(1e6 * offset)

    return _changed(lcmt_image_array, change)


def _late(delay: float) -> Callable[[list[bytes]], Disturb]:
    return lambda past: lambda message: [(delay, message)]


def _lost(past: list[bytes]) -> Disturb:
    return lambda message: []


def _signal(change: Callable[[lcmt_drake_signal], None]) -> Callable[[list[bytes]], Disturb]:

    def fitted(signal: lcmt_drake_signal) -> None:
        change(signal)
        signal.dim = len(signal.val)
        signal.coord = (list(signal.coord) + [""] * len(signal.val))[: len(signal.val)]

    return _changed(lcmt_drake_signal, fitted)


def _set(*values: tuple[int, float]) -> Callable[[lcmt_drake_signal], None]:
    def change(signal: lcmt_drake_signal) -> None:
        vector = list(signal.val)
        for place, value in values:
            vector[place] = value
        signal.val = vector

    return change


def _cut(size: int) -> Callable[[lcmt_drake_signal], None]:
    def change(signal: lcmt_drake_signal) -> None:
        signal.val = list(signal.val)[:size]

    return change


def _back(signal: lcmt_drake_signal) -> None:
    signal.timestamp -= 10_000_000


def _foreign(past: list[bytes]) -> Disturb:
    other = float(1 + np.random.default_rng().integers(1 << 48))

    def disturb(message: bytes) -> Passed:
        signal = lcmt_drake_signal.decode(message)
        signal.val = [-signal.val[0], -signal.val[1], signal.val[2], other, *signal.val[_SEQUENCE:]]
        return [(0.0, message), (0.0025, signal.encode())]

    return disturb


def _replayed(past: list[bytes]) -> Disturb:
    session = lcmt_drake_signal.decode(past[-1]).val[_SESSION]
    old = next(message for message in past if lcmt_drake_signal.decode(message).val[_SESSION] == session)
    return lambda message: [(0.0, message), (0.0025, old)]


_ALL = float("nan")
KINDS: tuple[FaultKind, ...] = (
    FaultKind("white images", "the camera sees nothing", "image", CONTENT, _drawn(_white)),
    FaultKind("lost mask", "two pixels of the object are left", "image", CONTENT, _drawn(_speck)),
    FaultKind("mask of all", "every pixel shows the object", "image", CONTENT, _drawn(_covered)),
    FaultKind("jumping mask", "the object is a third of an image elsewhere", "image", CONTENT, _drawn(_shifted)),
    FaultKind("frozen images", "the same pixels under new stamps", "image", PACE, _frozen),
    FaultKind("repeated image", "the same message again and again", "image", IMAGE_LIMIT, _repeated),
    FaultKind("late images", f"images come {_LATE:g} s late", "image", IMAGE_LIMIT, _late(_LATE)),
    FaultKind("no images", "the camera is silent", "image", IMAGE_LIMIT, _lost),
    FaultKind("small images", "every other row and column", "image", CONTENT, _drawn(lambda p: p[::2, ::2])),
    FaultKind("grey images", "one channel in the place of four", "image", CONTENT, _changed(lcmt_image_array, _grey)),
    FaultKind("torn images", "half of the bytes are missing", "image", CONTENT, _changed(lcmt_image_array, _torn)),
    FaultKind("images of the past", "stamps are 1 s back", "image", CONTENT, _stamped(-1.0)),
    FaultKind("images of the future", "stamps are 1 s ahead", "image", CONTENT, _stamped(1.0)),
    FaultKind("no states", "the robot is silent", "state", SILENCE, _lost),
    FaultKind("late states", f"states come {_LATE:g} s late", "state", SILENCE, _late(_LATE)),
    FaultKind("repeated state", "the same message again and again", "state", SILENCE, _repeated),
    FaultKind("NaN in states", "the pusher is nowhere", "state", CONTENT, _signal(_set((0, _ALL)))),
    FaultKind("pusher outside", "the pusher is 1 m away", "state", CONTENT, _signal(_set((0, 1.0)))),
    FaultKind("short states", "three values are left", "state", CONTENT, _signal(_cut(3))),
    FaultKind("robot's clock goes back", "stamps are 10 s back", "state", SILENCE, _signal(_back)),
    FaultKind(
        "robot latched", "the robot tells of a fault", "state", CONTENT, _signal(_set((_MODE, 2.0), (_FAULT, 1.0)))
    ),
    FaultKind("no commands", "the robot hears nothing", "command", SILENCE, _lost),
    FaultKind("queue of commands", f"commands come {_QUEUE:g} s late", "command", SILENCE, _late(_QUEUE)),
    FaultKind("late commands", f"commands come {_LATE:g} s late", "command", SILENCE, _late(_LATE)),
    FaultKind("second controller", "somebody else commands too", "command", CONTENT, _foreign),
    FaultKind("replayed commands", "old commands come again", "command", CONTENT, _replayed),
    FaultKind("commands of no session", "three values are left", "command", CONTENT, _signal(_cut(3))),
    FaultKind("expired commands", "commands end before they begin", "command", CONTENT, _signal(_set((_EXPIRY, 0.0)))),
    FaultKind("NaN in commands", "a velocity is no number", "command", CONTENT, _signal(_set((0, _ALL)))),
    FaultKind("policy fails", "the policy raises an exception", "policy", PACE),
    FaultKind("policy of NaN", "the policy answers no number", "policy", PACE),
    FaultKind("slow policy", f"the policy takes {STALL:g} s", "policy", PACE),
    FaultKind("stopped process", f"the controller's process stands still for {STALL:g} s", "process", SILENCE),
)


def kind_of(name: str) -> FaultKind:
    """Kind of fault of a name."""
    return next(kind for kind in KINDS if kind.name == name)
