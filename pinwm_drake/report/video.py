"""Writes frames as a video."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.report.output import replacing

# VP9 is small and plays in browsers; MPEG-4 part 2 is there in every build of OpenCV.
_CODECS = ("vp09", "mp4v")


def write_video(path: Path, frames: Iterable[np.ndarray], *, rate: float, size: tuple[int, int]) -> None:
    """Writes an MP4 file.

    Args:
        path: Where to; the suffix is .mp4 and the folder exists.
        frames: Each (height, width, 3) uint8, sRGB.
        rate: Frames per second of playback [1/s].
        size: (width, height) [px].

    Raises:
        InputError: When the file cannot be written.
    """
    with replacing(path) as temporary:
        writer = _open(temporary, rate, size)
        if writer is None:
            raise InputError(path, allowed=f"a place where OpenCV can write MP4 ({', '.join(_CODECS)})")
        try:
            for frame in frames:
                writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        finally:
            writer.release()


def _open(path: Path, rate: float, size: tuple[int, int]) -> cv2.VideoWriter | None:
    """The writer of the first codec that this build of OpenCV has, or None."""
    for codec in _CODECS:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, size)
        if writer.isOpened():
            return writer
    return None
