# SPDX-License-Identifier: MIT
import re
import struct
import zlib

import numpy as np
import pytest
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array

from pinwm_drake.capture.importers.lcm_log import events
from pinwm_drake.capture.importers.recordings import read_film, read_log
from pinwm_drake.errors import InputError


def picture(k: int) -> np.ndarray:
    image = np.full((6, 8, 4), 255, np.uint8)
    image[..., 1] = 30 * k
    return image


def image_message(k: int) -> bytes:
    image, message = lcmt_image(), lcmt_image_array()
    image.height, image.width, image.row_stride = 6, 8, 32
    image.data = zlib.compress(picture(k).tobytes())
    image.size = len(image.data)
    image.pixel_format, image.channel_type = lcmt_image.PIXEL_FORMAT_RGBA, lcmt_image.CHANNEL_TYPE_UINT8
    image.compression_method = lcmt_image.COMPRESSION_METHOD_ZLIB
    message.header.utime = 1000 + 40_000 * k
    message.num_images, message.images = 1, [image]
    return message.encode()


def signal_message(k: int) -> bytes:
    message = lcmt_drake_signal()
    message.dim, message.coord, message.val = 3, ["px", "py", "pz"], [0.01 * k, 0.0, 0.03]
    message.timestamp = 20_000 * k + 1
    return message.encode()


def event(number: int, channel: str, message: bytes) -> bytes:
    name = channel.encode()
    return struct.pack(">IqqII", 0xEDA1DA01, number, 10**6 * number, len(name), len(message)) + name + message


@pytest.fixture
def log(tmp_path):
    parts = [event(k, "IMAGES", image_message(k)) + event(k, "STATE", signal_message(k)) for k in range(6)]
    (tmp_path / "push.lcmlog").write_bytes(b"".join(parts) + event(9, "OTHER", b"x" * 20))
    return tmp_path / "push.lcmlog"


def test_images_and_signals_have_their_own_stamps(log):
    film, table = read_film(log), read_log(log)
    np.testing.assert_allclose(film.t, 1e-3 + 0.04 * np.arange(6))
    for frame, k in zip(film.frames([0, 2, 5]), (0, 2, 5), strict=True):
        np.testing.assert_array_equal(frame, picture(k))
    np.testing.assert_allclose(table.values["t"], 1e-6 + 0.02 * np.arange(6))
    np.testing.assert_allclose(table.values["px"], 0.01 * np.arange(6))


def test_a_log_that_is_cut_ends_with_its_last_event(log):
    assert read_log(log).notes == read_film(log).notes == ()
    log.write_bytes((whole := log.read_bytes())[:-10])
    assert len(list(events(log))) == 12
    assert read_log(log).notes == read_film(log).notes == ("the log is cut within event 13",)
    log.write_bytes(whole + whole[:9])
    assert read_log(log).notes == ("the log is cut within event 14",)


def test_a_file_that_gives_nothing_is_refused(tmp_path):
    (tmp_path / "a.lcm").symlink_to("/proc/self/mem")  # its reading fails
    with pytest.raises(InputError, match="Input/output error"):
        list(events(tmp_path / "a.lcm"))
    with pytest.raises(InputError, match=r"a file \.lcm; allowed: a video"):
        read_film(tmp_path / "a.lcm")


def test_what_is_wrong_is_named(log):
    with pytest.raises(InputError, match=re.escape("channel 'X'; allowed: --topic with one of IMAGES")):
        read_film(log, topic="X")
    data = bytearray(log.read_bytes())
    second = data.index(struct.pack(">I", 0xEDA1DA01), 4)
    data[second] = 0
    log.write_bytes(data)
    with pytest.raises(InputError, match="row 2: no event; allowed: an event log of LCM"):
        read_film(log)
