"""Films of the main demonstration, side by side, as frames of a page and as files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pinwm_drake.demo.page import DemoPush
from pinwm_drake.demo.policy import Performance
from pinwm_drake.demo.stages import Report
from pinwm_drake.files import prepare_folder
from pinwm_drake.report.page import Frame
from pinwm_drake.report.style import evenly
from pinwm_drake.report.video import write_video

FOLDER = "films"
_GAP = 4  # px, white, between two pictures
_MOST = 60  # frames of the policy's film


def write_films(
    out: Path, pushes: Sequence[DemoPush], performances: Sequence[Performance], report: Report
) -> dict[str, list[Frame]]:
    """Draws the films and writes each as MP4.

    Args:
        out: Folder of the results.
        pushes: The identified and the predicted push.
        performances: Of the policy.
        report: Called with the share that is done.

    Returns:
        The frames by name: "identified", "predicted" and "policy".

    Raises:
        InputError: A file cannot be written.
    """
    films = {name: _push_frames(push) for name, push in zip(("identified", "predicted"), pushes, strict=True)}
    films["policy"] = _policy_frames(performances, report)
    folder = prepare_folder(out / FOLDER)
    for name, frames in films.items():
        t = [frame[0] for frame in frames]
        rate = (len(t) - 1) / (t[-1] - t[0]) if t[-1] > t[0] else 1.0
        height, width = frames[0][1].shape[:2]
        write_video(folder / f"{name}.mp4", (frame[1] for frame in frames), rate=rate, size=(width, height))
    return films


def _push_frames(push: DemoPush) -> list[Frame]:
    """Camera and twin side by side, with the time and, where known, the distance from the truth."""
    frames, errors = [], push.errors
    for k, shot in enumerate(push.shots):
        words = f"t = {shot.t:.2f} s"
        if errors is not None and len(errors.t) == len(push.shots):
            millimetres, degrees = 1e3 * errors.position[k], np.degrees(errors.rotation[k])
            words += f"; {millimetres:.1f} mm and {degrees:.1f}° from the truth"
        frames.append((shot.t, _beside(shot.panels[:2]), words))
    return frames


def _policy_frames(performances: Sequence[Performance], report: Report) -> list[Frame]:
    """The episodes side by side from their first action on; one that has ended stays as it is."""
    frames = []
    steps = evenly(1 + max(performance.record.last for performance in performances), _MOST)
    for number, step in enumerate(steps):
        pictures = [performance.film.picture(performance.record, step) for performance in performances]
        words = "; ".join(_place(performance, step) for performance in performances)
        frames.append((step * performances[0].horizon, _beside(pictures), words))
        report((number + 1) / len(steps), f"action {step}")
    return frames


def _beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures of one size side by side, of even width and height."""
    height, width = (length // 2 * 2 for length in pictures[0].shape[:2])
    parts = [np.pad(one[:height, :width], ((0, 0), (0, _GAP), (0, 0)), constant_values=255) for one in pictures]
    return np.hstack(parts)[:, :-_GAP]


def _place(performance: Performance, step: int) -> str:
    """The number of the action and the outcome, once there is one."""
    record = performance.record
    ended = f", {record.result.outcome}" if step >= record.last else ""
    return f"{performance.engine}: action {min(step, record.last)}{ended}"
