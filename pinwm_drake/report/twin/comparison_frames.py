"""Small pictures of an episode for a page or a film: camera, twin and difference side by side."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.report.evaluation.pictures import Cast, Picture, draw_frame, window_of
from pinwm_drake.report.style import evenly

PANELS = ("camera", "twin", "difference")


@dataclass(frozen=True, eq=False)
class Shot:
    """Panels of one frame, and the measures of their agreement.

    Attributes:
        t: Time of the frame, s.
        overlap: Intersection over union of the outlines in the image and in the rendering.
        difference: Mean absolute difference of the colours, 0 to 1, on the pixels where one of them shows the object.
        panels: Camera, twin and difference: (height, width, 3) uint8 each, sRGB, of one size.
    """

    t: float
    overlap: float
    difference: float
    panels: tuple[np.ndarray, np.ndarray, np.ndarray]

    def joined(self) -> np.ndarray:
        """Picture of the three panels side by side."""
        return np.concatenate(self.panels, axis=1)


def draw_shots(
    episode: Episode,
    poses: ObjectPoses,
    cast: Cast,
    *,
    size: int,
    most: int,
    report: Callable[[float], None] = lambda share: None,
) -> list[Shot]:
    """Draws the frames of an episode as camera, twin and difference.

    Args:
        episode: The episode, of n frames.
        poses: Poses of the object at its frames.
        cast: Object, pusher and corrections.
        size: The longer side of a panel [px] at most.
        most: Number of frames at most; of more, this many at equal distances.
        report: Called with the share that is done.

    Returns:
        Panels of each of the chosen frames, all of one size with even width and height.

    Raises:
        InputError: An image cannot be used.
    """
    window = window_of(episode, poses, cast.mesh)
    chosen = evenly(len(episode.t), most)
    shots = []
    for number, k in enumerate(chosen):
        picture = draw_frame(episode, k, poses, cast)
        shots.append(_shot(picture, window, size))
        report((number + 1) / len(chosen))
    return shots


def _shot(picture: Picture, window: tuple[slice, slice], size: int) -> Shot:
    either = picture.mask | (picture.covered & ~picture.hidden)
    difference = float(np.abs(picture.image - picture.rendered)[either].mean()) if either.any() else 0.0
    panels = [_shrunk(part[window], size) for part in (picture.image, picture.rendered, picture.shown_difference())]
    return Shot(picture.t, picture.overlap(), difference, (panels[0], panels[1], panels[2]))


def _shrunk(picture: np.ndarray, size: int) -> np.ndarray:
    """Picture in uint8 from one in [0, 1], made smaller where it is too large."""
    pixels = Image.fromarray((255 * np.clip(picture, 0, 1) + 0.5).astype(np.uint8))
    share = min(1.0, size / max(pixels.size))
    # Even numbers, as video needs them.
    width, height = (max(2 * round(0.5 * share * length), 2) for length in pixels.size)
    return np.asarray(pixels.resize((width, height), Image.Resampling.LANCZOS))
