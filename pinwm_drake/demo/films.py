"""Films of the main demonstration, side by side, as frames of a page and as files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pinwm_drake.demo.policy import Performance
from pinwm_drake.demo.result import DemoPush
from pinwm_drake.demo.stages import Report
from pinwm_drake.files import prepare_folder
from pinwm_drake.report.video import write_video

Frames = list[tuple[float, np.ndarray, str]]  # time [s], picture (height, width, 3) uint8 sRGB, words

FOLDER = "films"
_GAP = 4  # px, white, between two pictures
_MOST = 60  # frames of the policy's film


def write_films(
    out: Path, pushes: Sequence[DemoPush], performances: Sequence[Performance], report: Report
) -> dict[str, Frames]:
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
    films = {name: push_frames(push) for name, push in zip(("identified", "predicted"), pushes, strict=True)}
    films["policy"] = policy_frames(performances, report)
    folder = prepare_folder(out / FOLDER)
    for name, frames in films.items():
        t = [frame[0] for frame in frames]
        rate = (len(t) - 1) / (t[-1] - t[0]) if t[-1] > t[0] else 1.0
        height, width = frames[0][1].shape[:2]
        write_video(folder / f"{name}.mp4", (frame[1] for frame in frames), rate=rate, size=(width, height))
    return films


def push_frames(push: DemoPush) -> Frames:
    """Camera and twin side by side."""
    return [(shot.t, _beside(shot.panels[:2]), _words(push, k)) for k, shot in enumerate(push.shots)]


def policy_frames(performances: Sequence[Performance], report: Report) -> Frames:
    """The episodes side by side from their first action on; one that has ended stays as it is."""
    last = max(performance.record.last for performance in performances)
    steps = np.unique(np.linspace(0, last, min(last + 1, _MOST)).round()).astype(int).tolist()
    frames = []
    for number, step in enumerate(steps):
        pictures = [performance.film.picture(performance.record, step) for performance in performances]
        words = "; ".join(_place(performance, step) for performance in performances)
        frames.append((step * performances[0].horizon, _beside(pictures), words))
        report((number + 1) / len(steps), f"action {step}")
    return frames


def _beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures of one size side by side, of even width and height."""
    height = pictures[0].shape[0] // 2 * 2
    gap = np.full((height, _GAP, 3), 255, np.uint8)
    parts = [part for picture in pictures for part in (picture[:height, : picture.shape[1] // 2 * 2], gap)]
    return np.concatenate(parts[:-1], axis=1)


def _words(push: DemoPush, k: int) -> str:
    """The time and, where known, the distance from the truth."""
    words, errors = f"t = {push.shots[k].t:.2f} s", push.errors
    if errors is None or len(errors.t) != len(push.shots):
        return words
    return f"{words}; {1e3 * errors.position[k]:.1f} mm and {np.degrees(errors.rotation[k]):.1f}° from the truth"


def _place(performance: Performance, step: int) -> str:
    """The number of the action and the outcome, once there is one."""
    record = performance.record
    action = min(step, record.last)
    ended = f", {record.result.outcome}" if step >= record.last else ""
    return f"{performance.engine}: action {action}{ended}"
