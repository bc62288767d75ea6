# SPDX-License-Identifier: MIT
"""Writing of frames as a video."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing

# VP9 is small and plays in browsers; MPEG-4 part 2 is there in every build of OpenCV.
_CODECS = ("vp09", "mp4v")


def write_video(path: Path, frames: Iterable[np.ndarray], *, rate: float, size: tuple[int, int]) -> None:
    """Write frames as an MP4 file.

    Args:
        path: File of the video; the suffix is .mp4 and the folder exists.
        frames: Pictures, each (height, width, 3) uint8, sRGB.
        rate: Frames per second of playback [1/s].
        size: (width, height) [px].

    Raises:
        InputError: When the file cannot be written.
    """
    with replacing(path) as temporary:
        # The first codec that this build of OpenCV has.
        writers = (cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*codec), rate, size) for codec in _CODECS)
        writer = next((writer for writer in writers if writer.isOpened()), None)
        if writer is None:
            raise InputError(path, allowed=f"a place where OpenCV can write MP4 ({', '.join(_CODECS)})")
        count = 0
        try:
            for frame in frames:
                writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
                count += 1
        finally:
            writer.release()
        # OpenCV says nothing when the disk is full; the table of frames, written last, is missing then, and no
        # frame is counted in what cannot be read.
        if count and int(cv2.VideoCapture(str(temporary)).get(cv2.CAP_PROP_FRAME_COUNT)) != count:
            raise InputError(
                path, value="a film that could not be written to its end", allowed="a disk with enough space"
            )
