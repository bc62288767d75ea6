"""Confidence interval of a success rate."""

import math
from statistics import NormalDist

from pinwm_drake.errors import ParameterError


def wilson_interval(successes: int, episodes: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a rate, without correction for continuity.

    It holds the rates p at which the observed rate lies within z standard deviations sqrt(p (1 - p) / n) of p, so that
    it stays within 0 and 1 and says something even where every episode succeeded.

    Args:
        successes: Number of episodes that succeeded, 0 to `episodes`.
        episodes: Number of episodes n, 1 or more.
        confidence: Confidence of the interval, between 0 and 1.

    Returns:
        The low and the high end, 0 to 1.

    Raises:
        ParameterError: The numbers are no such counts, or the confidence is out of range.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 22
    (1927), 209-212.
    """
    if episodes < 1 or not 0 <= successes <= episodes:
        raise ParameterError(f"successes: got {successes} of {episodes}; allowed: 0 to n, of 1 or more")
    if not 0 < confidence < 1:
        raise ParameterError(f"confidence: got {confidence}; allowed: more than 0, less than 1")
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    n, p = episodes, successes / episodes
    middle = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # At its ends the closed form is off by a rounding error.
    low = 0.0 if successes == 0 else (middle - half) / scale
    high = 1.0 if successes == episodes else (middle + half) / scale
    return low, high
