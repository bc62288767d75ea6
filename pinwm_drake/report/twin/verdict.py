"""Verdict of a report on a twin, in a few lines."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.identification.history import History
from pinwm_drake.report.twin.comparison_frames import Shot
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.twin.twin import Twin

# Intersection over union of the outlines in image and rendering, on average over the frames.
_GOOD, _FAIR = 0.95, 0.85
_CLOSE = 0.05  # relative, of final losses that count as the same


@dataclass(frozen=True)
class Verdict:
    """Verdict on a twin, in words.

    Attributes:
        status: "good", "fair", "poor" or, without pictures, "unknown".
        headline: One sentence.
        lines: Grounds of the verdict, one sentence each.
    """

    status: str
    headline: str
    lines: list[str]


def judge(twin: Twin, shots: list[Shot], errors: PoseErrors | None, history: History | None) -> Verdict:
    """The verdict, from the images; ground truth is reported beside it.

    Args:
        twin: The twin.
        shots: The identified episode's frames; none where they are not at hand.
        errors: Errors of the identified poses, where the truth is known.
        history: History of the optimiser, or None.
    """
    status, headline = "unknown", "No images at hand: how well the twin reproduces the video is not shown"
    lines = []
    if shots:
        overlap = np.array([shot.overlap for shot in shots])
        status, headline = _grade(float(overlap.mean()))
        worst = int(overlap.argmin())
        colour = float(np.mean([shot.difference for shot in shots]))
        lines.append(
            f"Outlines of image and rendering overlap by {_percent(overlap.mean())} on average, "
            f"{_percent(overlap[worst])} in the worst frame (t = {shots[worst].t:.2f} s); "
            f"colours differ by {_percent(colour)} on average."
        )
    if errors is not None:
        lines.append(f"Against ground truth, which was never fitted: {errors.words()} ({len(errors.t)} frames).")
    known = [name for name, estimate in twin.theta.items() if estimate.identifiable]
    others = [name for name in twin.theta if name not in known]
    lines.append(f"The data determine {_listed(known)}; they do not determine {_listed(others)}.")
    if history is not None:
        lines += _agreement(history)
    return Verdict(status, headline, lines)


def _grade(overlap: float) -> tuple[str, str]:
    if overlap >= _GOOD:
        return "good", "The twin reproduces the video"
    if overlap >= _FAIR:
        return "fair", "The twin follows the video roughly"
    return "poor", "The twin does not reproduce the video"


def _agreement(history: History) -> list[str]:
    """Number of random starts that ended at the same loss, in a sentence; empty without a history."""
    final = np.array([history.loss[rows[-1]] for _, rows in history.starts()])
    if not len(final) or not np.isfinite(final).any():
        return []
    best = float(np.nanmin(final))
    close = int((final <= best + _CLOSE * abs(best)).sum())
    starts = "1 random start" if len(final) == 1 else f"{len(final)} random starts"
    return [f"{starts}; the best ends at a loss of {best:.4g}, and {close} within {_CLOSE:.0%} of it."]


def _listed(names: list[str]) -> str:
    return ", ".join(names) if names else "none of the parameters"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
