"""Verdict of a report on a twin, in a few lines."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.identification.history import History
from pinwm_drake.report.twin.comparison_frames import Shot
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.twin.twin import Twin

# By the intersection over union of the outlines in image and rendering, on average over the frames.
_GRADES = (
    (0.95, "good", "The twin reproduces the video"),
    (0.85, "fair", "The twin follows the video roughly"),
    (-np.inf, "poor", "The twin does not reproduce the video"),
)
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
        status, headline = next(words for least, *words in _GRADES if overlap.mean() >= least)
        worst, colour = int(overlap.argmin()), np.mean([shot.difference for shot in shots])
        lines.append(
            f"Outlines of image and rendering overlap by {100 * overlap.mean():.1f} % on average, "
            f"{100 * overlap[worst]:.1f} % in the worst frame (t = {shots[worst].t:.2f} s); "
            f"colours differ by {100 * colour:.1f} % on average."
        )
    if errors is not None:
        lines.append(f"Against ground truth, which was never fitted: {errors.words()} ({len(errors.t)} frames).")
    known = [name for name, estimate in twin.theta.items() if estimate.identifiable]
    others = [name for name in twin.theta if name not in known]
    known_words, other_words = (", ".join(names) or "none of the parameters" for names in (known, others))
    lines.append(f"The data determine {known_words}; they do not determine {other_words}.")
    final = np.array([history.loss[rows[-1]] for _, rows in history.starts()] if history is not None else [])
    if np.isfinite(final).any():
        best = float(np.nanmin(final))
        close = int((final <= best + _CLOSE * abs(best)).sum())
        starts = "1 random start" if len(final) == 1 else f"{len(final)} random starts"
        lines.append(f"{starts}; the best ends at a loss of {best:.4g}, and {close} within {_CLOSE:.0%} of it.")
    return Verdict(status, headline, lines)
