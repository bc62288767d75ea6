# SPDX-License-Identifier: MIT
"""Offset of a log's clock to a millisecond, from the shifts of the pusher's patch in the images.

The template is the mean of all patches, each by the way that the pusher goes around it. The shift of each frame's patch
against it (Lucas and Kanade) is explained by

    shift = a + B (u - mean u) + velocity * step

with u the projected place of the pusher [px], a where the template has it, B what a camera that is calibrated wrongly
stretches, and `step` the change of the offset. Template, shifts and step are found in turn until the step is small.

What lies behind the pusher pulls at its edges, and does so otherwise in each part of the patch. So the same is done
with bands of the patch's rows too; offsets of all are weighed by what their residuals say, and how they differ tells
how sure the result is.
"""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.station.clock.patches import NOISE, PusherFilm, Seen, path_weights

_ROUNDS, _SMALL = 60, 5e-5  # s: below this step the search ends
_MOST_SHIFT = 3.0  # px in one round
_A, _B = 30.0, 0.02  # standard deviations before the film is seen: px, 1
_STEP, _RATE = 0.2, 0.03  # s, 1
_PLACES = np.arange(0.15, 0.9, 0.05)  # shares of the way after which a piece may be missing
_REST = 0.02  # weight of a frame at rest, of the heaviest
_TAIL = 2.5  # deviations beyond which a frame counts less
_ROUNDS_OF_WEIGHTS = 12
_BANDS = 3
# Residuals do not tell what shifts have in common from frame to frame. The factor multiplies the deviation that they
# tell, the floor [s] is added to it in squares, and the last multiplies the outcome, so that 95 % intervals hold the
# offset in 95 % of 40 rendered films; see docs/results/clock.md.
_FACTOR, _FLOOR, _WIDER = 4.0, 5e-4, 1.3


@dataclass(frozen=True, eq=False)
class ClockFit:
    """Offset of a film's clock from that of a log.

    Attributes:
        offset: s; the log's time is `rate` times the film's, plus this.
        deviation: s, its standard deviation.
        rate: Seconds of the log for each second of the film.
        residual: px, median of what is left of the patches' shifts.
    """

    offset: float
    deviation: float
    rate: float
    residual: float

    @property
    def interval(self) -> tuple[float, float]:
        """Interval [s] that holds the offset with 95 %."""
        return self.offset - 1.96 * self.deviation, self.offset + 1.96 * self.deviation


def refine(film: PusherFilm, offset: float, rate: float = 1.0) -> ClockFit:
    """Return the offset near a guess [s] at which the pusher stands still in its patches, with its deviation."""
    whole, _ = _refine(film, offset, rate)
    fits = [whole, *(_refine(film.band(k, _BANDS), whole.offset, rate)[0] for k in range(_BANDS))]
    offsets = np.array([fit.offset for fit in fits])
    told = (_FACTOR * np.array([fit.deviation for fit in fits])) ** 2 + _FLOOR**2
    weights = 1 / told
    for _ in range(_ROUNDS_OF_WEIGHTS):  # a band in which something else moves loses its say
        mean = float(weights @ offsets / weights.sum())
        weights = 1 / (told * (1 + (offsets - mean) ** 2 / (_TAIL**2 * told)))
    scatter = float(weights @ (offsets - mean) ** 2 / weights.sum())
    independent = float(weights.sum() ** 2 / (weights**2).sum())
    deviation = _WIDER * float(np.sqrt(1 / weights.sum() + scatter / independent))
    return ClockFit(mean, deviation, rate, whole.residual)


def find_rate(film: PusherFilm, offset: float) -> tuple[float, float]:
    """Return the seconds of the log for each second of the film, near 1, and the residual [px] that is left then."""
    fit, faster = _refine(film, offset, 1.0, film.t - np.mean(film.t), _RATE)
    return 1.0 + faster, fit.residual


def rates_of_bands(film: PusherFilm, offset: float) -> np.ndarray:
    """Return the rates (n,) of `find_rate` of each band of the patches alone."""
    return np.array([find_rate(film.band(k, _BANDS), offset)[0] for k in range(_BANDS)])


def find_jump(film: PusherFilm, offset: float) -> tuple[float, float, float]:
    """Return the time [s] of the film from which on the log is later, by how much [s], and the residual [px].

    The place is that of the least residual; a film that is cut has such a place.
    """
    way = np.cumsum(path_weights(film.look(film.t + offset).centre))
    found = []
    for share in _PLACES:
        first = int(np.searchsorted(way, share * way[-1])) + 1
        fit, jump = _refine(film, offset, 1.0, (np.arange(len(film.t)) >= first).astype(float), _STEP)
        found.append((fit.residual, float(film.t[min(first, len(film.t) - 1)]), jump))
    residual, time, jump = min(found)
    return time, jump, residual


def _refine(
    film: PusherFilm, offset: float, rate: float, shape: np.ndarray | None = None, spread: float = _RATE
) -> tuple[ClockFit, float]:
    """Offset [s] near a guess, with the deviation that residuals tell, and how much of a shape the log's times have.

    Args:
        film: Film and log.
        offset: s, the guess.
        rate: Seconds of the log for each second of the film.
        shape: (n,) that the log's times of frames are free to have besides; None for none.
        spread: Standard deviation of how much of it, before the film is seen.
    """
    shape, amount = np.zeros(len(film.t)) if shape is None else shape, 0.0
    n, shift = len(film.t), np.zeros((len(film.t), 2))
    for _ in range(_ROUNDS):
        log_t = film.t * rate + offset + amount * shape
        seen = film.look(log_t, shift)
        weights = path_weights(seen.centre)
        weights = weights + _REST * weights.max() + 1e-9
        weights /= weights.sum()
        change, information = _shifts(film, seen, weights)
        shift = shift + np.clip(change, -_MOST_SHIFT, _MOST_SHIFT)
        velocity = film.velocity(log_t)
        design = np.zeros((n, 2, 8))
        design[:, 0, 0] = design[:, 1, 1] = 1.0
        design[:, 0, 2:4] = design[:, 1, 4:6] = seen.centre - weights @ seen.centre
        design[:, :, 6] = velocity
        design[:, :, 7] = velocity * shape[:, None]
        fit = _regression(shift, information, design, spread)
        left = shift - design @ fit.values
        step, more = float(fit.values[6]), float(fit.values[7])
        # The next template is that of the model: what is left may be noise.
        shift = shift - left - velocity * step - design[:, :, 7] * more
        offset, amount = offset + step, amount + more
        if abs(step) + abs(more) < _SMALL:
            break
    residual = float(np.median(np.linalg.norm(left, axis=1)))
    return ClockFit(offset, fit.deviation, rate, residual), amount


def _shifts(film: PusherFilm, seen: Seen, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shifts (n, 2) [px] of patches against their mean, axes of the image, and information (n, 2, 2) on them."""
    patches = seen.patches - np.median(seen.patches, axis=(1, 2), keepdims=True)
    of = weights[:, None, None, None]
    template = (of * patches).sum(0)
    for _ in range(2):  # without what passes through some of the patches
        left = (patches - template) ** 2
        counts = of / (1 + left / (2 * ((of * left).sum(0) + NOISE**2)))
        template = (counts * patches).sum(0) / counts.sum(0)
    left = patches - template
    spread = (of * left**2).sum(0) + NOISE**2
    slope = np.stack([np.gradient(template, step, axis=k) for step, k in zip(film.step, (1, 0), strict=True)], axis=-1)
    trust = film.taper[None, :, None] / spread / (1 + left**2 / (4 * spread))
    curved = np.einsum("krcl,rcli,rclj->kij", trust, slope, slope, optimize=True)
    pulled = np.einsum("krcl,rcli->ki", trust * left, slope, optimize=True)
    ridge = np.eye(2) * (1e-3 * float(np.trace(curved, axis1=1, axis2=2).mean()) + 1e-9)
    own = -np.linalg.solve(curved + ridge, pulled[..., None])[..., 0]
    return np.einsum("ki,kij->kj", own, seen.axes), np.einsum("kia,kij,kjb->kab", seen.axes, curved, seen.axes)


@dataclass(frozen=True, eq=False)
class _Regression:
    values: np.ndarray  # (p,)
    deviation: float  # of the step of the offset


def _regression(y: np.ndarray, information: np.ndarray, design: np.ndarray, spread: float) -> _Regression:
    """Least squares of y (n, 2) by a design (n, 2, 8) and the model's prior, with weights that outliers lose.

    The prior of the last column has the standard deviation `spread`.
    """
    floor = (1e-9 * np.trace(information, axis1=1, axis2=2).mean() + 1e-12) * np.eye(2)
    root = np.linalg.cholesky(information + floor).transpose(0, 2, 1)
    target, columns = np.einsum("kij,kj->ki", root, y), root @ design
    prior = np.diag([_A**-2] * 2 + [_B**-2] * 4 + [_STEP**-2, spread**-2])
    weights, scale = np.ones(len(y)), 1.0
    for _ in range(_ROUNDS_OF_WEIGHTS):
        normal = np.einsum("k,kip,kiq->pq", weights, columns, columns) / scale**2 + prior
        values = np.linalg.solve(normal, np.einsum("k,kip,ki->p", weights, columns, target) / scale**2)
        left = target - columns @ values
        far = np.sqrt((left**2).mean(1))
        scale = max(1.2 * float(np.median(far)), 1e-6)
        weights = np.minimum(1.0, _TAIL * scale / np.maximum(far, 1e-12))
    # Residuals of neighbours are alike; so many fewer of them are independent.
    alike = float(np.clip((left[1:] * left[:-1]).sum() / max(float((left**2).sum()), 1e-12), 0.0, 0.95))
    deviation = float(np.sqrt(np.linalg.inv(normal)[6, 6] * (1 + alike) / (1 - alike)))
    return _Regression(values, deviation)
