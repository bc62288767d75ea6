# SPDX-License-Identifier: MIT
"""Films and logs in event logs of LCM, with the messages that this project sends: images and named vectors.

An event is, big-endian: 0xEDA1DA01; number, int64; time, int64 [us]; length of the channel's name and of the message,
int32 each; both. The types are those that Drake ships; reading a log needs no package `lcm`.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pinwm_drake.capture.importers.film import Columns, Film, in_order
from pinwm_drake.errors import InputError, require_package
from pinwm_drake.reading.contents import guarded, opened

LCM_SUFFIXES = (".lcm", ".lcmlog", ".log")
_SYNC, _HEAD = 0xEDA1DA01, struct.Struct(">IqqII")
_MOST_BYTES, _LONGEST = 2**36, 2**28
# Channels of the formats, and what turns them into RGB or RGBA; None for as they are.
_FORMATS = {
    0: (1, cv2.COLOR_GRAY2RGB),
    1: (3, None),
    2: (3, cv2.COLOR_BGR2RGB),
    3: (4, None),
    4: (4, cv2.COLOR_BGRA2RGBA),
}
_PLAIN, _ZLIB = 0, 1


def is_lcm_log(path: Path) -> bool:
    """Flag: a file begins like an event log of LCM."""
    try:
        with guarded(path, "a file that can be read"), opened(path, _MOST_BYTES) as file:
            return file.read(4) == struct.pack(">I", _SYNC)
    except InputError:
        return False


def read_lcm_film(path: Path, channel: str | None = None) -> Film:
    """Read the stamps of a channel of `lcmt_image_array`; images are decoded when they are asked for.

    Args:
        path: The log.
        channel: Name of the channel; None for the only one.

    Raises:
        InputError: The log is damaged before its second image, or has no such channel.
        ParameterError: The package `drake`, which has the types, is not installed.
    """
    kinds = _types()
    name, notes = _channel(path, kinds["lcmt_image_array"], channel, "--topic")
    t = np.array(
        [_time(message.header.utime, time) for time, message in _messages(path, name, kinds["lcmt_image_array"])]
    )
    kept, told = in_order(path, t, "frame")

    def frames(numbers: Sequence[int]) -> Iterator[np.ndarray]:
        wanted = set(kept[list(numbers)].tolist())
        for k, (_, message) in enumerate(_messages(path, name, kinds["lcmt_image_array"])):
            if k in wanted:
                yield _picture(path, k + 1, message)

    return Film(path, t[kept], True, frames, (*notes, *told))


def read_lcm_log(path: Path, channel: str | None = None) -> Columns:
    """Read a channel of `lcmt_drake_signal`: a column for each of its names, and `t`.

    Args and errors are those of `read_lcm_film`.
    """
    kinds = _types()
    name, notes = _channel(path, kinds["lcmt_drake_signal"], channel, "--log-topic")
    rows = [
        (_time(message.timestamp, time), message) for time, message in _messages(path, name, kinds["lcmt_drake_signal"])
    ]
    names = list(rows[0][1].coord)
    if len(set(names)) < len(names):
        raise InputError(path, value=f"a name twice in {name}", allowed="each name of lcmt_drake_signal once")
    alike = [(time, message) for time, message in rows if list(message.coord) == names]
    values = np.array([message.val for _, message in alike]).reshape(len(alike), -1)
    lost = len(rows) - len(alike)
    notes += [f"{lost} messages of {name} with other names dropped"] if lost else []
    columns = {one: values[:, k] for k, one in enumerate(names)} | {"t": np.array([time for time, _ in alike])}
    return Columns(path, columns, np.arange(1, len(alike) + 1), "t", tuple(notes))


def events(path: Path, notes: list[str] | None = None) -> Iterator[tuple[str, float, bytes]]:
    """Channel, time [s] and message of each event; a log that is cut ends with its last whole event, by a note.

    Raises:
        InputError: It is no event log, or an event does not begin as one.
    """
    with guarded(path, "an event log of LCM"), opened(path, _MOST_BYTES) as file:
        number = 0
        while len(head := file.read(_HEAD.size)) == _HEAD.size:
            number += 1
            sync, _, time, name_size, size = _HEAD.unpack(head)
            if sync != _SYNC or name_size > 1000 or size > _LONGEST:
                raise InputError(path, row=number, value="no event", allowed="an event log of LCM")
            name, message = file.read(name_size), file.read(size)
            if len(name) + len(message) < name_size + size:
                break
            yield name.decode("utf-8", "replace"), 1e-6 * time, message
            head = b""
    if head and notes is not None:
        notes.append(f"the log is cut within event {number + (len(head) < _HEAD.size)}")


def _types() -> dict[str, Any]:
    require_package("drake", "lab", "logs of LCM")
    from drake import lcmt_drake_signal, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types

    return {"lcmt_drake_signal": lcmt_drake_signal, "lcmt_image_array": lcmt_image_array}


def _channel(path: Path, kind: Any, name: str | None, option: str) -> tuple[str, list[str]]:
    """Name of the channel with messages of a type, by their fingerprint, and notes on the log."""
    mark, notes = kind._get_packed_fingerprint(), list[str]()
    fitting = {channel: None for channel, _, message in events(path, notes) if message[:8] == mark}
    found = [channel for channel in fitting if name in (None, channel)]
    if len(found) == 1:
        return found[0], notes
    if not fitting:
        raise InputError(path, value=f"no message {kind.__name__}", allowed=f"a channel of {kind.__name__}")
    given = f"channel {name!a}" if name else f"{len(found)} channels"
    raise InputError(path, value=given, allowed=f"{option} with one of {', '.join(fitting)}")


def _messages(path: Path, name: str, kind: Any) -> Iterator[tuple[float, Any]]:
    mark = kind._get_packed_fingerprint()
    for number, (channel, time, message) in enumerate(events(path), 1):
        if channel == name and message[:8] == mark:
            with guarded(path, f"a message {kind.__name__} in event {number}"):
                decoded = kind.decode(message)
            yield time, decoded


def _time(stamp: int, recorded: float) -> float:
    """Time [s] of a message: its own stamp [us] where it has one."""
    return 1e-6 * stamp if stamp > 0 else recorded


def _picture(path: Path, number: int, message: Any) -> np.ndarray:
    """Picture (H, W, 3 or 4) uint8 of a message, its first image."""
    allowed = "8 bits a channel: grey, RGB, BGR, RGBA or BGRA; plain, or packed by zlib, JPEG or PNG"
    with guarded(path, allowed):
        image = message.images[0]
        channels, code = _FORMATS[image.pixel_format]
        if image.compression_method in (_PLAIN, _ZLIB):
            content = bytes(image.data)
            if image.compression_method == _ZLIB:
                content = zlib.decompressobj().decompress(content, _LONGEST)
            rows = np.frombuffer(content, np.uint8).reshape(image.height, -1)
            picture = np.ascontiguousarray(
                rows[:, : image.width * channels].reshape(image.height, image.width, channels)
            )
            return picture if code is None else cv2.cvtColor(picture, code)
        coded = cv2.imdecode(np.frombuffer(bytes(image.data), np.uint8), cv2.IMREAD_COLOR)
        return cv2.cvtColor(np.asarray(coded), cv2.COLOR_BGR2RGB)
