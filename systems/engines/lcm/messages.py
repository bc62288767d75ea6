# SPDX-License-Identifier: MIT
"""Reception of LCM messages that may hold anything: what cannot be decoded is no exception in a simulator."""

from typing import Any

from drake import lcmt_drake_signal, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.lcm import LcmSubscriberSystem, PySerializer


def decode(kind: Any, raw: bytes) -> Any:
    """Message of an LCM type; one whose number of elements is -1 where the bytes are none."""
    try:
        return kind.decode(raw)
    except Exception:  # whatever somebody sent
        message = kind()
        setattr(message, {lcmt_drake_signal: "dim", lcmt_image_array: "num_images"}[kind], -1)
        return message


class _Serializer(PySerializer):  # type: ignore[misc]  # pydrake has no usable types
    def Deserialize(self, buffer: bytes, abstract_value: AbstractValue) -> None:
        abstract_value.set_value(decode(self._lcm_type, buffer))


def make_subscriber(channel: str, kind: Any, lcm: DrakeLcmInterface) -> LcmSubscriberSystem:
    """Make a subscriber that holds the last message of a channel, as `decode` gives it.

    Args:
        channel: Name of the channel.
        kind: lcmt_drake_signal or lcmt_image_array.
        lcm: LCM that the messages come through.
    """
    serializer = _Serializer(kind)
    system = LcmSubscriberSystem(channel, serializer, lcm)
    system.serializer = serializer  # a Python object, which Drake does not keep
    return system


class Mailbox:
    """Messages of a channel in the order in which they came, none of which is lost to a later one.

    Arguments as for `make_subscriber`. Somebody has to pump `lcm`.
    """

    def __init__(self, channel: str, kind: Any, lcm: DrakeLcmInterface) -> None:
        self._kind, self._raw = kind, list[bytes]()
        lcm.Subscribe(channel, self._raw.append)

    def take(self) -> list[Any]:
        """Take out the messages that came since the last time, as `decode` gives them."""
        taken, self._raw[:] = list(self._raw), []
        return [decode(self._kind, raw) for raw in taken]
