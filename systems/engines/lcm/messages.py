# SPDX-License-Identifier: MIT
"""Reception of LCM messages that may hold anything: what cannot be decoded is no exception in a simulator."""

import io
import math
from collections import Counter, deque
from typing import Any

from drake import lcmt_drake_signal, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.lcm import LcmPublisherSystem, PySerializer

from pinwm_drake.systems.engines.lcm.seal import TRAILER, Seal

MOST_SIGNAL = 4096  # bytes of a vector's message
_WAITING = 256  # messages that wait to be taken
_PAUSE = 1.0  # s, between two lines
_LONGEST = 300  # characters of a line
_TOO_LARGE, _TOO_MANY = "too large", "more than can wait"


class Tally:
    """Counts of messages that were not used, and a line about them now and then.

    Attributes:
        counts: Numbers of messages by the reason.
    """

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self._last, self._told, self._due = "", 0, -math.inf

    def note(self, channel: str, reason: str, words: str = "") -> None:
        """Count a message.

        Args:
            channel: Name of its channel.
            reason: Why it was not used; one of a few.
            words: Details of this message.
        """
        self.counts[reason] += 1
        self._last = f"{channel}, {words or reason}"

    def line(self, now: float) -> str:
        """Line of the counts; empty where they have not changed, and within a second after the last one.

        Args:
            now: s, of a clock that does not go back; infinite to have all told.
        """
        total = self.counts.total()
        if total == self._told or now < self._due:
            return ""
        self._told, self._due = total, now + _PAUSE
        counts = ", ".join(f"{number} {reason}" for reason, number in self.counts.items())
        return f"messages not used: {counts}; the last: {self._last}"[:_LONGEST]


def decode(kind: Any, raw: bytes) -> Any:
    """Message of an LCM type; one whose number of elements is -1 where the bytes are none, or more than one."""
    try:
        stream = io.BytesIO(raw)
        message = kind.decode(stream)
        if not stream.read(1):
            return message
    except Exception:  # whatever somebody sent
        pass
    message = kind()
    setattr(message, {lcmt_drake_signal: "dim", lcmt_image_array: "num_images"}[kind], -1)
    return message


class Mailbox:
    """Messages of a channel in the order in which they came, as many as can wait.

    Somebody has to pump `lcm`. What the seal does not verify is dropped and counted.

    Args:
        channel: Name of the channel.
        kind: lcmt_drake_signal or lcmt_image_array.
        lcm: LCM that the messages come through.
        tally: Counts what is not used.
        seal: Seal of this end; None where messages are not signed.
        most: Largest size of a message, bytes.
        waiting: Largest number of messages that wait; of more, the oldest are dropped.
    """

    def __init__(
        self,
        channel: str,
        kind: Any,
        lcm: DrakeLcmInterface,
        tally: Tally,
        seal: Seal | None,
        *,
        most: int = MOST_SIGNAL,
        waiting: int = _WAITING,
    ) -> None:
        self._channel, self._kind, self._tally, self._seal = channel, kind, tally, seal
        self._most, self._raw = most, deque[bytes](maxlen=waiting)
        lcm.Subscribe(channel, self._keep)

    def take(self, *, adopt: bool = False) -> list[Any]:
        """Take out the messages that came since the last time, as `decode` gives them.

        Args:
            adopt: Flag: another run of the driver is taken for the present one; see `Seal.verify`.
        """
        taken = list(self._raw)
        self._raw.clear()
        if self._seal is not None:
            opened = [self._seal.verify(self._channel, raw, adopt=adopt) for raw in taken]
            for _, reason in opened:
                if reason:
                    self._tally.note(self._channel, reason)
            taken = [message for message, reason in opened if not reason]
        return [decode(self._kind, raw) for raw in taken]

    def _keep(self, raw: bytes) -> None:
        if len(raw) > self._most + TRAILER:
            self._tally.note(self._channel, _TOO_LARGE, f"{len(raw)} bytes; allowed: {self._most}")
            if self._seal is not None:
                return
            raw = b""  # which is no message
        if len(self._raw) == self._raw.maxlen:
            self._tally.note(self._channel, _TOO_MANY)
        self._raw.append(raw)


def make_publisher(
    channel: str, kind: Any, lcm: DrakeLcmInterface, period: float, seal: Seal | None
) -> LcmPublisherSystem:
    """Make a publisher of a message each period [s], signed where there is a seal; other arguments as for `Mailbox`."""
    serializer = _Serializer(kind, channel, seal)
    system = LcmPublisherSystem(channel, serializer, lcm, period)
    system.serializer = serializer  # a Python object, which Drake does not keep
    return system


class _Serializer(PySerializer):  # type: ignore[misc]  # pydrake has no usable types
    def __init__(self, kind: Any, channel: str, seal: Seal | None) -> None:
        super().__init__(kind)
        self._channel, self._seal = channel, seal

    def Serialize(self, abstract_value: AbstractValue) -> bytes:
        message: bytes = abstract_value.get_value().encode()
        return message if self._seal is None else self._seal.sign(self._channel, message)
