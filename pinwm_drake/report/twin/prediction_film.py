# SPDX-License-Identifier: MIT
"""The film of a prediction: camera, twin and difference side by side."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.report.captions import write_caption
from pinwm_drake.report.twin.comparison_frames import PANELS, Cast, draw_shots
from pinwm_drake.report.video import write_video
from pinwm_drake.twin.predict import TWO_SIDED, Spread
from pinwm_drake.twin.twin import Twin

_PANEL = 480  # px
_RATES = (4.0, 60.0)  # 1/s, of a film; real time where the frames allow it


def write_prediction_film(
    path: Path,
    twin: Twin,
    episode: Episode,
    poses: ObjectPoses,
    push: int | None,
    *,
    spread: Spread | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> None:
    """Films a prediction, in real time where the rate allows it.

    Args:
        path: An .mp4 file; its folder exists.
        twin, episode, poses: The twin, and the poses of the object that it predicts for an episode with images.
        push: Number of the identified push that it is; None for another one.
        spread: Standard deviations of the prediction, which are written on the film; None for none.
        report: Called with the share of the frames that are drawn.

    Raises:
        InputError: An image cannot be read, or the file cannot be written.
    """
    cast = Cast.of(twin, push)
    shots = draw_shots(episode, poses, cast, size=_PANEL, most=len(episode.t), report=report)
    seconds = float(episode.t[-1] - episode.t[0])
    rate = float(np.clip((len(episode.t) - 1) / seconds if seconds > 0 else _RATES[0], *_RATES))
    height, width = shots[0].joined().shape[:2]
    captions = [[f"{PANELS[0]}  t = {shot.t:.2f} s", *PANELS[1:]] for shot in shots]
    if spread is not None:
        for caption, position, yaw in zip(captions, spread.position, spread.yaw, strict=True):
            sides = 1e3 * TWO_SIDED * float(position), np.degrees(TWO_SIDED * float(yaw))
            caption[1] += "  +-{:.1f} mm, {:.1f} deg (95 %)".format(*sides)
    frames = (write_caption(shot.joined(), *caption) for shot, caption in zip(shots, captions, strict=True))
    write_video(path, frames, rate=rate, size=(width, height))
