# SPDX-License-Identifier: MIT
"""Messages that wait, those that are not used, and the headers of images."""

import io
import math
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array
from PIL import Image
from pydrake.lcm import DrakeLcm

from pinwm_drake.systems.arm.messages import image_message
from pinwm_drake.systems.engines.lcm.messages import MOST_SIGNAL, Mailbox, Tally, decode
from pinwm_drake.systems.engines.lcm.receiver import pixels_of
from pinwm_drake.systems.engines.lcm.signal import signal_message

SIGNAL = signal_message(("a", "b"), np.array([1.0, 2.0]), 0.5).encode()
WIDTH, HEIGHT = 20, 10


def picture():
    return np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 4), np.uint8)


def packed(kind: str) -> lcmt_image:
    """Image message of a picture in an encoding."""
    image = image_message(picture(), 1.0).images[0]
    if kind == "none":
        image.data, image.compression_method = picture().tobytes(), lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED
    if kind == "png":
        image.data, image.compression_method = png(picture()), lcmt_image.COMPRESSION_METHOD_PNG
    image.size = len(image.data)
    return image


def png(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


@pytest.mark.parametrize("kind", ["none", "zlib", "png"])
def test_images_of_every_encoding_are_read(kind):
    np.testing.assert_array_equal(pixels_of(packed(kind), (WIDTH, HEIGHT)), picture())
    image = packed(kind)
    image.row_stride = 0  # which a sender may leave out
    np.testing.assert_array_equal(pixels_of(image), picture())


@pytest.mark.parametrize("kind", ["none", "zlib", "png"])
@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"size": 3}, "of 3; allowed: all of them"),
        ({"size": -1}, "of -1; allowed: all of them"),
        ({"width": 0}, "got 0 by 10 px; allowed: 1 to 16384"),
        ({"height": -5}, "got 20 by -5 px; allowed: 1 to 16384"),
        ({"width": 2**31 - 1, "height": 2**31 - 1}, "got 2147483647 by 2147483647 px; allowed: 1 to 16384"),
        ({"row_stride": 81}, "got rows of 81 bytes; allowed: 80"),
        ({"row_stride": -80}, "got rows of -80 bytes; allowed: 80"),
        ({"channel_type": 7}, "of type 7; allowed: RGBA of uint8"),
        ({"pixel_format": 0}, "got pixel format 0"),
        ({"compression_method": 99}, "got "),
    ],
)
def test_a_wrong_header_is_refused_before_unpacking(kind, fields, words, monkeypatch):
    def unpack(*_):
        raise AssertionError

    image = packed(kind)
    for name, value in fields.items():
        setattr(image, name, value)
    monkeypatch.setattr(zlib, "decompressobj", unpack)
    monkeypatch.setattr(Image, "open", unpack)
    with pytest.raises(ValueError, match=words):
        pixels_of(image, (WIDTH, HEIGHT))


@pytest.mark.parametrize("kind", ["none", "zlib", "png"])
def test_another_size_than_the_camera_s_is_refused_before_unpacking(kind):
    with pytest.raises(ValueError, match="has 20 by 10 px; allowed: 21 by 10"):
        pixels_of(packed(kind), (WIDTH + 1, HEIGHT))


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


@pytest.mark.parametrize(
    ("method", "data"),
    [
        (lcmt_image.COMPRESSION_METHOD_ZLIB, zlib.compress(bytes(4 * WIDTH * HEIGHT + 1))),
        (lcmt_image.COMPRESSION_METHOD_ZLIB, zlib.compress(bytes(4 * WIDTH * HEIGHT - 1))),
        (lcmt_image.COMPRESSION_METHOD_ZLIB, zlib.compress(bytes(4 * WIDTH * HEIGHT))[:-1]),
        (lcmt_image.COMPRESSION_METHOD_ZLIB, zlib.compress(bytes(4 * WIDTH * HEIGHT)) + b"x"),
        (lcmt_image.COMPRESSION_METHOD_ZLIB, b""),
        (lcmt_image.COMPRESSION_METHOD_PNG, png(picture())[:60]),
        (lcmt_image.COMPRESSION_METHOD_PNG, png(picture()[:, :-1])),
        (lcmt_image.COMPRESSION_METHOD_PNG, png(picture())[:33] + chunk(b"[/a]", b"x")),
        (lcmt_image.COMPRESSION_METHOD_PNG, b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", b"\0" * 13)),
        (lcmt_image.COMPRESSION_METHOD_PNG, b""),
    ],
)
def test_wrong_contents_are_refused(method, data):
    image = packed("zlib")
    image.compression_method, image.data, image.size = method, data, len(data)
    with pytest.raises(ValueError, match="cannot be used: got"):
        pixels_of(image, (WIDTH, HEIGHT))


def test_a_bomb_takes_no_memory():
    # 3900 bytes that become 4 MB, and a PNG whose header says 20000 by 20000 px.
    large = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 20000, 20000, 8, 6, 0, 0, 0))
    for method, data in (
        (lcmt_image.COMPRESSION_METHOD_ZLIB, zlib.compress(bytes(4_000_000), 9)),
        (lcmt_image.COMPRESSION_METHOD_PNG, large + chunk(b"IDAT", zlib.compress(bytes(10_000))) + chunk(b"IEND", b"")),
    ):
        image = packed("zlib")
        image.compression_method, image.data, image.size = method, data, len(data)
        tracemalloc.start()
        with pytest.raises(ValueError, match="cannot be used: got"):
            pixels_of(image, (WIDTH, HEIGHT))
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 500_000


@pytest.mark.parametrize("raw", [b"", SIGNAL[:-1], SIGNAL + b"x", SIGNAL[:8] + b"\x7f\xff\xff\xff" + SIGNAL[12:]])
def test_bytes_that_are_not_one_message_are_none(raw):
    assert decode(lcmt_drake_signal, raw).dim == -1
    assert decode(lcmt_image_array, raw).num_images == -1
    assert list(decode(lcmt_drake_signal, SIGNAL).val) == [1.0, 2.0]


def test_what_waits_is_bounded_and_what_is_lost_is_counted():
    lcm, tally = DrakeLcm("memq://"), Tally()
    mailbox = Mailbox("X", lcmt_drake_signal, lcm, tally, None, waiting=3)
    for k in range(5):
        lcm.Publish("X", signal_message(("a",), np.array([float(k)]), 0.0).encode())
    lcm.Publish("X", bytes(MOST_SIGNAL + 1000))
    lcm.HandleSubscriptions(0)
    taken = mailbox.take()
    assert [message.dim for message in taken] == [1, 1, -1]
    assert [message.val[0] for message in taken[:2]] == [3.0, 4.0]
    assert tally.counts == {"more than can wait": 3, "too large": 1}
    assert mailbox.take() == []


def test_counts_are_told_now_and_then():
    tally = Tally()
    assert tally.line(0.0) == ""
    tally.note("A", "bad")
    assert tally.line(0.0) == "messages not used: 1 bad; the last: A, bad"
    for k in range(100):
        tally.note("B", "worse", f"number {k}")
    assert tally.line(0.5) == ""
    assert tally.line(1.0) == "messages not used: 1 bad, 100 worse; the last: B, number 99"
    assert tally.line(5.0) == ""
    tally.note("A", "bad", "x" * 5000)
    assert tally.line(5.5).startswith("messages not used: 2 bad, 100 worse; the last: A, xxx")
    tally.note("A", "bad", "x" * 5000)
    assert tally.line(5.6) == ""
    assert len(tally.line(math.inf)) == 300
