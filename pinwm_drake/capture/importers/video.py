# SPDX-License-Identifier: MIT
"""Films in video files, with the time stamps that they hold, and in folders of images."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.capture.importers.csv_log import read_csv
from pinwm_drake.capture.importers.film import Film, in_order, stamps_of_names, time_unit
from pinwm_drake.capture.paths import is_file, is_folder, require_file
from pinwm_drake.capture.static_views import is_picture
from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import require_contents
from pinwm_drake.reading.pictures import opened_picture

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".gif")
_STAMP_FILES = ("stamps.csv", "timestamps.csv", "frames.csv", "times.csv")
_STAMP_COLUMNS = ("t", "time", "stamp", "timestamp")
_MOST_FRAMES = 100_000
_MOST_BYTES = 2**36
_DIGITS = re.compile(r"\d+", re.ASCII)


def read_video(path: Path, rate: float | None = None) -> Film:
    """Read the stamps of a video file; its pictures are decoded when they are asked for.

    Args:
        path: The file, of any codec that OpenCV decodes.
        rate: Hz; None for the stamps in the file.

    Raises:
        InputError: It is no video, is cut off before its second frame, or has no stamps and no rate is given.
    """
    capture, stamps = _opened(path), list[float]()
    try:
        announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        while capture.grab():
            if len(stamps) == _MOST_FRAMES:
                allowed = f"{_MOST_FRAMES} frames at most: cut out the part with the push"
                raise InputError(path, value="more of them", allowed=allowed)
            stamps.append(1e-3 * float(capture.get(cv2.CAP_PROP_POS_MSEC)))
    finally:
        capture.release()
    if len(stamps) < 2:
        raise InputError(path, value=f"a video of {len(stamps)} frames that can be read", allowed="two frames or more")
    notes = []
    if announced > len(stamps) + 1:
        notes.append(f"the file is cut: {announced} frames announced, {len(stamps)} can be read")
    t = np.array(stamps) if rate is None else np.arange(len(stamps)) / rate
    if rate is None and not (np.diff(t) > 0).mean() > 0.5:
        raise InputError(path, value="a video without time stamps", allowed="--rate, the frames in a second")
    kept, told = in_order(path, t, "frame")

    def frames(numbers: Sequence[int]) -> Iterator[np.ndarray]:
        wanted = kept[list(numbers)].tolist()
        capture = _opened(path)
        try:
            at = -1
            for number in wanted:
                while at < number:
                    if not capture.grab():
                        raise InputError(path, value=f"frame {number} that cannot be read", allowed="a whole video")
                    at += 1
                ok, picture = capture.retrieve()
                if not ok:
                    raise InputError(path, value=f"frame {number} that cannot be decoded", allowed="a whole video")
                yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
        finally:
            capture.release()

    return Film(path, t[kept], False, frames, (*notes, *told))


def _opened(path: Path) -> cv2.VideoCapture:
    require_file(path, "a video")
    require_contents(path, _MOST_BYTES)
    # A path with a % would be read as the pattern of a sequence of images.
    capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InputError(path, value="contents that are no video", allowed="MP4 or another video that OpenCV decodes")
    return capture


def read_image_folder(folder: Path, rate: float | None = None, stamps: Path | None = None) -> Film:
    """Read a folder of images as a film, in the order of the numbers in their names.

    Their times are those of a file of stamps: that given, or `stamps.csv`, `timestamps.csv`, `frames.csv` or
    `times.csv` in the folder, with a row for each image; or `rate`; or the names themselves, as nanoseconds since 1970.

    Args:
        folder: The folder.
        rate: Hz; None for none.
        stamps: CSV file with a column `t`, `time`, `stamp` or `timestamp`; None to look for one.

    Raises:
        InputError: There are fewer than two images, there is no way to tell their times, or numbers do not fit.
    """
    if not is_folder(folder):
        raise InputError(folder, value="no such folder", allowed="a folder of images")
    pictures = sorted((path for path in folder.iterdir() if is_picture(path)), key=_number)
    if len(pictures) < 2:
        raise InputError(folder, value=f"{len(pictures)} images", allowed="a folder with two images or more")
    notes, shared = list[str](), True
    named = stamps_of_names([path.stem for path in pictures])
    found = stamps or next((folder / name for name in _STAMP_FILES if is_file(folder / name)), None)
    if found is not None and (stamps is not None or rate is None):
        t, words = _read_stamps(found, pictures)
        notes += words
    elif rate is not None:
        t, shared = np.arange(len(pictures)) / rate, False
    elif named is not None:
        unit, seconds = time_unit(folder, named)
        t = named * seconds
        notes.append(f"names taken for times in {unit}")
    else:
        raise InputError(folder, value="images without times", allowed="--rate, --stamps FILE, or a stamps.csv in it")
    kept, told = in_order(folder, t, "frame")
    chosen = [pictures[k] for k in kept.tolist()]

    def frames(numbers: Sequence[int]) -> Iterator[np.ndarray]:
        for number in numbers:
            with opened_picture(chosen[number]) as image:
                alpha = "A" in image.getbands() or "transparency" in image.info
                yield np.asarray(image.convert("RGBA" if alpha else "RGB"))

    return Film(folder, t[kept], shared, frames, (*notes, *told))


def _read_stamps(path: Path, pictures: list[Path]) -> tuple[np.ndarray, list[str]]:
    table = read_csv(path)
    name = next((one for one in table.values if one.strip().lower().split("[")[0] in _STAMP_COLUMNS), None)
    if name is None:
        raise InputError(path, row=1, value=",".join(table.values), allowed=f"a column {', '.join(_STAMP_COLUMNS)}")
    t = table.values[name]
    if len(t) != len(pictures):
        raise InputError(path, value=f"{len(t)} rows", allowed=f"{len(pictures)}, one for each image beside it")
    unit, seconds = time_unit(path, t)
    return t * seconds, [] if unit == "s" else [f"times of {path.name} taken for {unit}"]


def _number(path: Path) -> tuple[list[int], str]:
    """Key by which names sort as a person counts: frame2 before frame10."""
    return [int(digits) for digits in _DIGITS.findall(path.stem)], path.name
