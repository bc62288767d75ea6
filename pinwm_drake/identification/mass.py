# SPDX-License-Identifier: MIT
"""Mass of an object from the force on its pusher: at one and the same motion, forces grow with the mass.

The images tell how an object moves, to which only ratios to its mass matter. The posterior's draws are rolled out for
the nominal mass, and the forces of each are scaled to the measured ones. These are compared as impulses over windows
of time, since impacts are too short for their courses to agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from torch import Tensor

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.errors import SolverError
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.posterior import PRECISE, interval
from pinwm_drake.twin.twin import Twin

_WINDOWS = (0.1, 0.05, 0.025)  # s, the longest of which there are enough
_ENOUGH, _LEAST = 8, 3  # windows
_ROWS = 4  # of the log in a window, at least
_TOUCHES = 0.05  # share of the largest impulse: windows of less are not compared
_BEFORE, _STILL = 0.05, 5  # s before the first touch up to which the sensor reads its offset, and rows of that
_ALIKE = 0.7  # cosine of measured and simulated impulses: forces of less have another cause
_BOUND = 1.5  # of the median residual, from which on windows count less
_ROUNDS = 30
_MASSES = ("mass", "inertia_xx", "inertia_yy", "inertia_zz")


@dataclass(frozen=True, eq=False)
class MassScale:
    """Factor between an object's mass and the nominal one."""

    value: float
    draws: np.ndarray  # (m,), factors of the posterior's kept draws
    windows: int  # Number of windows that were compared
    window: float  # Their length, s
    alike: float  # Cosine of measured and simulated impulses, 0 to 1

    @property
    def words(self) -> str:
        """Account of the fit in words."""
        return (
            f"mass from the force on the pusher: {self.windows} windows of {self.window:g} s, "
            f"cosine {self.alike:.3f} to the twin's forces"
        )


def find_mass_scale(
    forwards: Sequence[Forward], values: Sequence[dict[str, Tensor]], seed: int
) -> MassScale | str | None:
    """Factor by which simulated forces on the pusher have to be scaled to be the measured ones.

    Args:
        forwards: The pushes; those without forces are left out.
        values: Values (1 + m,) of `UNKNOWNS` in each push, of the nominal mass: those found, then m draws.
        seed: Seed of the noise by which windows differ.

    Returns:
        The factor; in words why the forces do not tell it; None where there are none.
    """
    pushes, refusal = [], ""
    for forward, given in zip(forwards, values, strict=True):
        log = forward.episode.trajectory
        if log.force_W is None:
            continue
        if np.ptp(log.force_W, axis=0).max() == 0.0:
            refusal = "it never changes"
            continue
        try:
            pushes.append((log, *forward.pusher_impulses(given)))
        except SolverError as error:
            refusal = str(error)
    if not pushes:
        return refusal or None
    return fit_mass_scale(pushes, seed)


def fit_mass_scale(pushes: Sequence[tuple[PusherTrajectory, np.ndarray, np.ndarray]], seed: int) -> MassScale | str:
    """Factor of simulated impulses on the pusher by robust least squares.

    It is <measured, simulated> / <simulated, simulated>, over the impulses of all windows, each with Huber's weight.
    Windows are the samples of a Student distribution, so that few of them make a wide interval.

    Args:
        pushes: For each push its log with forces, times (T + 1, W) [s] at which steps begin and end, and impulses
            (T, W, 3) [N s] on the pusher; the first of the W worlds stands for the posterior, the others are its draws.
        seed: Seed of the noise.

    Returns:
        The factor, or in words why there is none.
    """
    slowest = max(float(np.median(np.diff(log.t))) for log, _, _ in pushes)
    windows = [window for window in _WINDOWS if window >= _ROWS * slowest]
    if not windows:
        return f"a row every {slowest:.3g} s is too few"
    for window in windows:
        parts = [_compared(*push, window) for push in pushes]
        measured, simulated = (np.concatenate(part) for part in zip(*parts, strict=True))
        if len(measured) >= _ENOUGH:
            break
    if len(measured) < _LEAST:
        return f"pusher and object touch for fewer than {_LEAST} windows of {windows[-1]:g} s"
    product = float((measured * simulated[:, 0]).sum())
    size = float(np.linalg.norm(measured) * np.linalg.norm(simulated[:, 0]))
    alike = product / size if size > 0.0 else 0.0
    if alike <= -_ALIKE:
        return "it points against the twin's: is it the force on the object instead of that on the pusher?"
    if alike < _ALIKE:
        return f"it does not follow the twin's (cosine {alike:.2f})"
    scales, errors = _robust(measured, simulated)
    noise = np.random.default_rng(seed).standard_t(len(measured) - 1, len(scales) - 1)
    draws = np.maximum(scales[1:] + errors[1:] * noise, 1e-2 * scales[0])
    return MassScale(float(scales[0]), draws, len(measured), window, alike)


def with_mass(twin: Twin, scale: MassScale | str | None) -> Twin:
    """Twin of the nominal mass with the result of `find_mass_scale`.

    With the mass its moments of inertia are scaled: their ratio is what the images tell.
    """
    if scale is None:
        return twin
    mass = twin.theta["mass"]
    if isinstance(scale, str):
        ignored = f"the force on the pusher is ignored: {scale}"
        theta = twin.theta | {"mass": replace(mass, note=f"{mass.note}; {ignored}")}
        return replace(twin, theta=theta, provenance=twin.provenance | {"force": {"note": ignored}})
    theta, factor = dict(twin.theta), scale.value
    for name in _MASSES:
        one = theta[name]
        ends = None if one.interval is None else (one.interval[0] * factor, one.interval[1] * factor)
        theta[name] = replace(one, value=one.value * factor, interval=ends)
    theta["mass"] = replace(
        theta["mass"],
        interval=interval(mass.value * scale.draws, mass.value * factor),
        identifiable=bool(scale.draws.std() < PRECISE * factor),
        note=scale.words,
    )
    about = {"note": scale.words, "windows": scale.windows, "window": scale.window, "cosine": scale.alike}
    found = replace(twin, theta=theta, provenance=twin.provenance | {"force": about})
    if twin.draws is None:
        return found
    factors = np.where(np.isin(twin.draws.names, _MASSES), scale.draws[:, None], 1.0)
    return replace(found, draws=replace(twin.draws, values=twin.draws.values * factors))


def _compared(
    log: PusherTrajectory, edges: np.ndarray, impulses: np.ndarray, window: float
) -> tuple[np.ndarray, np.ndarray]:
    """Measured (n, 3) and simulated (n, W, 3) impulses [N s] of the windows in which pusher and object touch."""
    first, last = max(edges[0].max(), log.t[0]), min(edges[-1].min(), log.t[-1])
    touches = np.flatnonzero(impulses[:, 0].any(axis=-1))
    touch = float(edges[touches[0] if len(touches) else -1, 0])
    # The first touch, whose impact may be half of all, comes in the middle of a window: none cuts it in two.
    first += (touch - 0.5 * window - first) % window
    ends = first + window * np.arange(int((last - first) / window + 1e-6) + 1)
    made = np.concatenate([np.zeros((1, *impulses.shape[1:])), np.cumsum(impulses, axis=0)])
    sums = [_at(ends, edges[:, world], made[:, world]) for world in range(edges.shape[1])]
    simulated = np.diff(np.stack(sums, 1), axis=0)
    assert log.force_W is not None
    # The sensor's reading before the pusher touches is its offset, where the log begins early enough to tell.
    free = log.t < touch - _BEFORE
    offset = np.median(log.force_W[free], axis=0) if free.sum() >= _STILL else np.zeros(3)
    felt = cumulative_trapezoid(log.force_W - offset, log.t, axis=0, initial=0)
    measured = np.diff(_at(ends, log.t, felt), axis=0)
    size = np.linalg.norm(simulated[:, 0], axis=-1)
    mine = size > _TOUCHES * size.max(initial=0.0)
    return measured[mine], simulated[mine]


def _at(ends: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (m, 3) at times t (m,), interpolated at others (n,): (n, 3)."""
    return np.stack([np.interp(ends, t, values[:, axis]) for axis in range(3)], -1)


def _robust(measured: np.ndarray, simulated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors (W,) of simulated (n, W, 3) that give measured (n, 3), by Huber's weights, and their standard errors."""
    n = len(measured)
    along, square = (measured[:, None] * simulated).sum(-1), (simulated**2).sum(-1)
    weights = np.ones_like(square)
    for _ in range(_ROUNDS):
        scales = (weights * along).sum(0) / (weights * square).sum(0)
        residuals = np.linalg.norm(measured[:, None] - scales[:, None] * simulated, axis=-1)
        bound = _BOUND * np.median(residuals, axis=0)
        weights = np.where(residuals > bound, bound / np.maximum(residuals, 1e-300), 1.0)
    pulls = weights * (along - scales * square)
    errors = np.sqrt((pulls**2).sum(0) * n / (n - 1)) / (weights * square).sum(0)
    return scales, errors
