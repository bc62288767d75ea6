# SPDX-License-Identifier: MIT
"""Pictures of an object of surfels that turns once."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.orbit import AZIMUTH, ELEVATION, Orbit, square_camera
from pinwm_drake.report.video import write_video

FRAME_RATE = 24  # of turntables [1/s]


def turntable(
    surfels: Surfels,
    *,
    size: int,
    num_frames: int,
    up: np.ndarray | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> Iterator[np.ndarray]:
    """Draws an object from all around: frames (size, size, 3) uint8, sRGB.

    Args:
        surfels: The object; one set of colours.
        size: Width and height [px].
        num_frames: Number of pictures in a turn.
        up: (3,), the axis it turns about, object frame; None for z.
        report: Called with the share of the frames that are done.

    Raises:
        RenderingError: There are no surfels.
    """
    orbit, camera = Orbit.around(surfels, up), square_camera(size)
    for k in range(num_frames):
        # The camera goes clockwise, seen from above: the object seems to turn counter-clockwise, as angles do.
        X_CO = orbit.pose(AZIMUTH - 2 * math.pi * k / num_frames, ELEVATION)
        with torch.no_grad():
            color = render(surfels, camera, X_CO, full=False).color[0]
        yield to_bytes(color)
        report((k + 1) / num_frames)


def write_turntable(
    path: Path,
    surfels: Surfels,
    *,
    size: int,
    num_frames: int,
    up: np.ndarray | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> None:
    """Film one turn: write the frames of `turntable`, of an even size, to an .mp4 file whose folder exists.

    Arguments are as for `turntable`.

    Raises:
        InputError: The file cannot be written.
        RenderingError: There are no surfels.
    """
    frames = turntable(surfels, size=size, num_frames=num_frames, up=up, report=report)
    write_video(path, frames, rate=FRAME_RATE, size=(size, size))


def to_bytes(color: torch.Tensor) -> np.ndarray:
    """Picture (height, width, 3) in uint8 from one in [0, 1]; values beyond are cut off."""
    return (255 * color.detach().clamp(0, 1) + 0.5).to(torch.uint8).numpy()
