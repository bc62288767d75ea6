# SPDX-License-Identifier: MIT
"""Picture of the example for its page: photos, and the second push as the camera saw it and as the twin predicts it."""

from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.capture.images import read_pixels
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.experiments.prediction import predict
from pinwm_drake.guide.lab import LabFolder

_WIDTH, _QUALITY = 900, 80  # px; of JPEG, %


def write_picture(path: Path, lab: LabFolder, first_twin: Path) -> None:
    """Write a JPEG: a photo by the phone, one by the fixed camera, a frame of the film; and the predicted push."""
    episode = lab.capture / EPISODES / "0001"
    frames = sorted((episode / "rgb").glob("*.png"))
    shown = [lab.pictures("photos")[0], lab.pictures("photos/fixed")[0], frames[len(frames) // 2]]
    photos = [read_pixels(one)[..., :3] for one in shown]
    height = _WIDTH / sum(photo.shape[1] / photo.shape[0] for photo in photos)
    row = np.hstack(
        [_resized(photo, round(height * photo.shape[1] / photo.shape[0]), round(height)) for photo in photos]
    )
    strip = predict(first_twin, episode).filmstrip(frames=5, size=_WIDTH // 5)
    rows = [_resized(one, _WIDTH, round(one.shape[0] * _WIDTH / one.shape[1])) for one in (row, strip)]
    picture = cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


def _resized(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
