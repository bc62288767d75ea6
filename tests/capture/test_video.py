# SPDX-License-Identifier: MIT
import re
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from pinwm_drake.capture.importers import video
from pinwm_drake.capture.importers.film import in_order, time_unit
from pinwm_drake.capture.importers.video import read_image_folder, read_video
from pinwm_drake.errors import InputError

SIZE = 64, 48
# Levels of grey that a codec may lose on plain pictures.
LOSS = 5


def plain(level: int) -> np.ndarray:
    return np.full((SIZE[1], SIZE[0], 3), level, np.uint8)


def write_mp4(path: Path, count: int = 12, rate: float = 25.0) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate, SIZE)
    for k in range(count):
        writer.write(plain(20 * k))
    writer.release()
    return path


def with_durations(path: Path, ticks: list[int]) -> None:
    """Give each frame of an MP4 file a duration of its own, in ticks of its clock: a new table stts."""
    data = path.read_bytes()
    table = struct.pack(">II", 0, len(ticks)) + b"".join(struct.pack(">II", 1, tick) for tick in ticks)
    at = data.index(b"stts") - 4
    (size,) = struct.unpack(">I", data[at : at + 4])
    box = struct.pack(">I", 8 + len(table)) + b"stts" + table
    grown = bytearray(data[:at] + box + data[at + size :])
    assert data.index(b"mdat") < data.index(b"moov")  # so that no offset into the pictures moves
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        place = data.index(name) - 4
        (old,) = struct.unpack(">I", data[place : place + 4])
        grown[place : place + 4] = struct.pack(">I", old + len(box) - size)
    path.write_bytes(grown)


def ticks_of_a_second(path: Path) -> int:
    data = path.read_bytes()
    return struct.unpack(">I", data[data.index(b"mdhd") + 16 : data.index(b"mdhd") + 20])[0]


def test_a_video_has_its_stamps_and_pictures(tmp_path):
    film = read_video(write_mp4(tmp_path / "push.mp4"))
    np.testing.assert_allclose(film.t, np.arange(12) / 25, atol=1e-6)
    assert not film.shared
    assert film.notes == ()
    assert film.rate == pytest.approx(25)
    means = [frame.mean() for frame in film.frames([0, 3, 11])]
    np.testing.assert_allclose(means, [0, 60, 220], atol=LOSS)


def test_a_variable_rate_is_read_and_missing_frames_are_counted(tmp_path):
    path = write_mp4(tmp_path / "push.mp4")
    second = ticks_of_a_second(path)
    step = second // 25
    # Two frames are missing; the last ones come sooner, so that the film is as long as its header says.
    steps = [*[step] * 4, 3 * step, *[step] * 3, *[step // 2] * 4]
    with_durations(path, steps)
    film = read_video(path)
    np.testing.assert_allclose(film.t, np.cumsum([0, *steps[:-1]]) / second, atol=1e-3)
    assert film.notes == ("2 frames missing in 1 gaps, the first 0.160 s from the start",)


def test_a_rate_replaces_the_stamps(tmp_path):
    film = read_video(write_mp4(tmp_path / "push.mp4"), rate=10.0)
    np.testing.assert_allclose(film.t, np.arange(12) / 10)


@pytest.mark.parametrize(
    ("content", "words"), [(b"", "no contents"), (b"not a video" * 100, "got contents that are no video")]
)
def test_what_is_no_video_is_refused(tmp_path, content, words):
    (tmp_path / "push.mp4").write_bytes(content)
    with pytest.raises(InputError, match=rf"push\.mp4: {words}"):
        read_video(tmp_path / "push.mp4")


def test_a_video_that_is_cut_off_is_refused_or_told(tmp_path):
    path = write_mp4(tmp_path / "push.mp4")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"push\.mp4"):
        read_video(path)


def write_pictures(folder: Path, names: list[str]) -> Path:
    folder.mkdir()
    for k, name in enumerate(names):
        Image.fromarray(plain(10 * k)).save(folder / name)
    return folder


def test_images_come_in_the_order_of_their_numbers(tmp_path):
    folder = write_pictures(tmp_path / "a", [f"frame{k}.png" for k in (10, 2, 1)])
    film = read_image_folder(folder, rate=20.0)
    np.testing.assert_allclose(film.t, [0, 0.05, 0.1])
    assert [frame[0, 0, 0] for frame in film.frames([0, 1, 2])] == [20, 10, 0]


def test_stamps_beside_images_are_found_and_their_unit_is_told(tmp_path):
    folder = write_pictures(tmp_path / "a", ["0.png", "1.png", "2.png"])
    (folder / "stamps.csv").write_text("file,stamp\n0.png,1700000000000\n1.png,1700000000033\n2.png,1700000000066\n")
    film = read_image_folder(folder)
    np.testing.assert_allclose(film.t - 1.7e9, [0, 0.033, 0.066], atol=1e-6)
    assert film.shared
    assert film.notes == ("times of stamps.csv taken for ms",)


def test_names_may_be_stamps(tmp_path):
    folder = write_pictures(tmp_path / "a", [f"{1_700_000_000_000_000_000 + k * 40_000_000}.png" for k in range(3)])
    np.testing.assert_allclose(np.diff(read_image_folder(folder).t), 0.04, atol=1e-6)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (None, "got images without times; allowed: --rate"),
        ("t\n0\n1\n", "got 2 rows; allowed: 3, one for each image"),
        ("file\na\nb\nc\n", "allowed: a column t, time, stamp, timestamp"),
    ],
)
def test_images_without_times_are_refused(tmp_path, stamps, words):
    folder = write_pictures(tmp_path / "a", ["a.png", "b.png", "c.png"])
    if stamps is not None:
        (folder / "times.csv").write_text(stamps)
    with pytest.raises(InputError, match=re.escape(words)):
        read_image_folder(folder)


def test_stamps_that_do_not_increase_are_dropped_and_counted():
    kept, notes = in_order(Path("a"), np.array([0.0, 0.1, 0.1, np.nan, 0.2, 0.15, 0.3]), "frame")
    assert kept.tolist() == [0, 1, 4, 6]
    assert notes == [
        "1 frame without a time dropped",
        "1 frame with the time of the one before dropped",
        "1 frame with a time that goes backwards dropped",
    ]


def test_gaps_of_a_log_are_told():
    _, notes = in_order(Path("a"), np.array([0.0, 0.01, 0.02, 0.5, 0.51]), "row")
    assert notes == ["1 gaps between rows, the longest of 0.48 s; the pusher moves straight over them"]


@pytest.mark.parametrize(
    ("values", "unit"),
    [
        (np.arange(10) * 0.02, "s"),
        (np.arange(10) * 20, "ms"),
        (np.arange(10) * 20_000, "us"),
        (1.7e9 + np.arange(10) * 0.02, "s"),
        (1.7e12 + np.arange(10) * 20, "ms"),
        (1.7e18 + np.arange(10) * 2e7, "ns"),
    ],
)
def test_units_of_time_are_told_by_their_size(values, unit):
    assert time_unit(Path("a"), values)[0] == unit


def test_a_time_of_no_unit_is_refused():
    with pytest.raises(InputError, match=r"allowed: a unit: t=NAME\[s\]"):
        time_unit(Path("a"), np.arange(10) * 1e-9 / 7)


def test_a_film_of_too_many_frames_is_refused_and_not_cut(tmp_path, monkeypatch):
    path = write_mp4(tmp_path / "a.mp4", count=6)
    monkeypatch.setattr(video, "_MOST_FRAMES", 6)
    assert len(read_video(path).t) == 6
    monkeypatch.setattr(video, "_MOST_FRAMES", 5)
    with pytest.raises(InputError, match="more of them; allowed: 5 frames at most"):
        read_video(path)
