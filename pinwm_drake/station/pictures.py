# SPDX-License-Identifier: MIT
"""Pictures of a calibration's residuals: each photo with its corners and how far they are off, enlarged."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.station.bundle import Bundle
from pinwm_drake.station.lab import read_grey
from pinwm_drake.station.solve import Sighting

_KEPT, _LEFT_OUT, _WORDS = (60, 220, 60), (40, 40, 255), (0, 255, 255)  # blue, green, red
_LONG = 12.0  # px of an arrow for a residual of one standard deviation


def write_pictures(folder: Path, bundle: Bundle, sightings: Sequence[Sighting]) -> None:
    """Write a PNG for each photo: arrows from where a corner should be to where it was found, enlarged.

    Args:
        folder: Folder of the pictures, by the sets of the photos.
        bundle: The adjustment at its solution.
        sightings: The photos.

    Raises:
        InputError: A file cannot be read or written.
    """
    paths = {one.photo.name: one.photo.path for one in sightings}
    enlarged = max(round(_LONG / bundle.noise.pixel), 1)
    for photo in bundle.photos:
        image = cv2.cvtColor(read_grey(paths[photo.name]), cv2.COLOR_GRAY2BGR)
        errors = bundle.pixel_errors(photo)
        for pixel, error, kept in zip(photo.pixels - errors, errors, photo.kept, strict=True):
            start, end = pixel - 0.5, pixel - 0.5 + enlarged * np.clip(error, -200.0 / enlarged, 200.0 / enlarged)
            colour = _KEPT if kept else _LEFT_OUT
            cv2.arrowedLine(image, _point(start), _point(end), colour, 1, cv2.LINE_AA, 4, 0.25)
            cv2.circle(image, _point(start), 2 * 16, colour, -1, cv2.LINE_AA, 4)
        rms = float(np.sqrt((errors[photo.kept] ** 2).mean())) if photo.kept.any() else float("nan")
        words = f"{photo.name}: {rms:.3f} px on each axis, arrows x {enlarged}, {(~photo.kept).sum()} left out"
        cv2.putText(image, words, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(image, words, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _WORDS, 1, cv2.LINE_AA)
        path = (folder / photo.name).with_suffix(".png")
        prepare_folder(path.parent)
        with replacing(path) as temporary:
            if not cv2.imwrite(str(temporary), image):
                raise InputError(path, value="no picture written", allowed="a file that can be written")


def _point(pixel: np.ndarray) -> tuple[int, int]:
    """Point for OpenCV's drawing, in 1/16 px."""
    x, y = np.round(16.0 * pixel).astype(int)
    return int(x), int(y)
