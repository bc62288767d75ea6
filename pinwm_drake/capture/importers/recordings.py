# SPDX-License-Identifier: MIT
"""Films and logs by the kind of the file or folder that holds them."""

from pathlib import Path

from pinwm_drake.capture.importers.bag import BAG_SUFFIXES, METADATA, read_bag_film, read_bag_log
from pinwm_drake.capture.importers.csv_log import read_csv
from pinwm_drake.capture.importers.film import Columns, Film
from pinwm_drake.capture.importers.lcm_log import is_lcm_log, read_lcm_film, read_lcm_log
from pinwm_drake.capture.importers.lerobot import is_lerobot, read_lerobot_film, read_lerobot_log
from pinwm_drake.capture.importers.video import VIDEO_SUFFIXES, read_image_folder, read_video
from pinwm_drake.capture.paths import is_file, is_folder
from pinwm_drake.errors import InputError


def read_film(
    path: Path, *, rate: float | None = None, stamps: Path | None = None, topic: str | None = None, number: int = 0
) -> Film:
    """Read a film: a video, a folder of images, a recording of ROS, a data set of LeRobot or a log of LCM.

    Args:
        path: File or folder.
        rate: Hz, of a video or images without times.
        stamps: File of the images' times.
        topic: Topic, camera or channel of the images; None for the only one.
        number: Number of an episode of a data set.

    Raises:
        InputError: It cannot be read, or is none of these.
    """
    if is_lerobot(path):
        return read_lerobot_film(path, number, topic)
    if _is_bag(path):
        return read_bag_film(path, topic)
    if is_folder(path):
        return read_image_folder(path, rate, stamps)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return read_video(path, rate)
    if is_lcm_log(path):
        return read_lcm_film(path, topic)
    found = f"a file {path.suffix or path.name}" if is_file(path) else "no such file or folder"
    allowed = "a video (.mp4), a folder of images, rosbag2, .mcap, a LeRobot data set or an LCM log"
    raise InputError(path, value=found, allowed=allowed)


def read_log(path: Path, *, topic: str | None = None, number: int = 0) -> Columns:
    """Read a log: CSV, a recording of ROS, a data set of LeRobot or a log of LCM; see `read_film`."""
    if is_lerobot(path):
        return read_lerobot_log(path, number)
    if _is_bag(path):
        return read_bag_log(path, topic)
    if is_lcm_log(path):
        return read_lcm_log(path, topic)
    if is_file(path):
        return read_csv(path)
    allowed = "a CSV file, rosbag2, .mcap, a LeRobot data set or an LCM log"
    raise InputError(path, value="a folder" if is_folder(path) else "no such file", allowed=allowed)


def _is_bag(path: Path) -> bool:
    return is_file(path / METADATA) or path.suffix.lower() in BAG_SUFFIXES
