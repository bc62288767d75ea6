# SPDX-License-Identifier: MIT
"""Offset of a film's clock from a log's; or one line that names what is wrong with the two."""

from pathlib import Path

import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.station.clock.coarse import FEW, STEP, Guess, search, standardised
from pinwm_drake.station.clock.fine import ClockFit, find_jump, find_rate, rates_of_bands, refine
from pinwm_drake.station.clock.patches import PusherFilm, path_weights

SPAN = 1.5  # s, by which clocks may differ
# Least correlations of a film with its log: those of 44 rendered films are 0.37 and 1.18 at least.
_STILL, _SCORE = 0.33, 1.1
_ALIVE, _BOTH, _CLEAR = 0.5, 0.6, 0.05  # least correlations of motion and both parts of a cut film, and the gain
_NEAR = np.arange(-0.4, 0.45, 0.1)  # s, from the guess to offsets that parts of a film may have
_SURE = 0.025  # s, of the deviation
_RATES = (0.5, 24 / 30, 25 / 30, 24 / 25, 25 / 24, 30 / 25, 30 / 24, 2.0)
_BETTER = 0.15  # by which the score of another rate has to be higher
_FEWEST_OF_RATE = 16  # frames; fewer may suit a wrong rate by chance
_FRAMES = 60  # that are looked at for cuts
# Of a cut: gain in correlation, share of the motion on each side, and the piece that is missing, s.
_GAIN, _SHARE, _JUMP, _LONGEST_CUT = 0.012, 0.2, 0.06, 1.0
_DRIFT = 0.015  # s over a film, of a clock that runs too fast
_EXPLAINED = 0.8  # of the residual is left, at most, at the rate of a clock that drifts
_FASTEST = 0.03  # of a clock that drifts; beyond it the rate is wrong
_APART = 0.5  # of a drift, by which the bands of the patches differ from it at most, as a median


def find_clock(film: PusherFilm, path: Path, *, around: float = 0.0, span: float = SPAN) -> ClockFit:
    """Find the offset of a film's clock from its log's: the log's time is the film's, times the rate, plus the offset.

    Args:
        film: Film and log.
        path: The film, for messages.
        around: s, middle of the offsets that are tried.
        span: s, how far they go to both sides.

    Raises:
        InputError: The film does not show the log's motion: it is mirrored, cut, of another push, or its stamps are
            those of another clock.
    """
    guess = search(film, around - span, around + span)
    if not _trusted(guess):
        raise _explained(film, path, guess, around, span)
    if (cut := find_cut(film, guess.offset)) is not None:
        raise _cut_or_rate(film, path, guess.offset, cut)
    if (rate := _other_rate(film, guess, around, span)) is not None:
        raise _wrong_rate(path, film, rate.rate)
    fit = _with_drift(film, path, refine(film, guess.offset))
    if fit.deviation > _SURE:
        found = f"an offset of {fit.offset:.3f} s that is sure to {1e3 * 1.96 * fit.deviation:.0f} ms only"
        allowed = "a film that shows the pusher of this log start or stop, from the side; or --offset"
        raise InputError(path, value=found, allowed=allowed)
    return fit


def _trusted(guess: Guess) -> bool:
    return guess.still >= _STILL and guess.score >= _SCORE


def _explained(film: PusherFilm, path: Path, guess: Guess, around: float, span: float) -> InputError:
    """Error that says why a film does not show the motion of its log."""
    if _trusted(search(film.mirrored(), around - span, around + span, most=2 * FEW)):
        return InputError(path, value="a mirrored image", allowed="pictures as the camera sees, not flipped")
    if (rate := _other_rate(film, guess, around, span)) is not None:
        return _wrong_rate(path, film, rate.rate)
    low, high = film.log_t[0] - film.t[-1], film.log_t[-1] - film.t[0]
    wide = search(film, float(low), float(high), most=4 * FEW)
    if _trusted(wide):
        found = f"stamps of another clock: the log shows this motion {wide.offset - around:+.2f} s away"
        return InputError(path, value=found, allowed=f"clocks within {span:g} s, or --offset {wide.offset:.2f}")
    # Of a film that is cut, the guess may lie between the offsets of its parts.
    near = guess.offset + _NEAR if guess.motion > _ALIVE else _NEAR[:0]
    cuts = [cut for one in near if (cut := find_cut(film, float(one))) and cut[3] >= _BOTH and cut[2] >= _CLEAR]
    if cuts:
        return _cut(path, *max(cuts, key=lambda cut: cut[2])[:2])
    found = f"the log of another run: its motion agrees by {guess.still:.2f} within {span:g} s"
    allowed = f"{_STILL:g} or more; check --log, the columns' axes and the camera's pose"
    return InputError(path, value=found, allowed=allowed)


def find_cut(film: PusherFilm, offset: float) -> tuple[float, float, float, float] | None:
    """Place of a film at which its offset jumps, as where a piece was cut out; None where there is none.

    The template of an offset [s] is looked for in each frame at other offsets, and the frames before and after a place
    are free to agree on one each.

    Returns:
        Time [s] of the film, jump [s], gain in correlation, and the correlation of both parts.
    """
    chosen = np.unique(np.linspace(0, len(film.t) - 1, _FRAMES).round().astype(int))
    some, change = film.part(chosen), film.motion()
    weights = np.zeros(len(film.t))
    weights[:-1] += change
    weights[1:] += change
    weights = weights[chosen] / max(float(weights[chosen].sum()), 1e-9)
    seen = some.look(some.t + offset)
    template = path_weights(seen.centre) @ standardised(some, seen.patches)
    template /= max(float(np.linalg.norm(template)), 1e-9)
    offsets = offset + np.arange(-_LONGEST_CUT, _LONGEST_CUT + 0.5 * STEP, STEP)
    alike = np.stack([standardised(some, some.look(some.t + one).patches) @ template for one in offsets], axis=1)
    before = np.cumsum(weights[:, None] * alike, axis=0)
    after, share, apart = before[-1] - before, np.cumsum(weights), round(_JUMP / STEP)
    # Of what is left after a cut, the log is later: a piece is missing.
    later = np.maximum.accumulate(after[:, ::-1], axis=1)[:, ::-1]
    both = before[:, :-apart] + later[:, apart:]
    both[(share < _SHARE) | (share > 1 - _SHARE)] = -np.inf
    place, first = np.unravel_index(int(np.argmax(both)), both.shape)
    correlation = float(both[place, first])
    gain = correlation - float(before[-1].max())
    if gain < _GAIN or place + 1 >= len(some.t):
        return None
    second = first + apart + int(np.argmax(after[place, first + apart :]))
    return float(some.t[place + 1]), float(offsets[second] - offsets[first]), gain, correlation


def _cut(path: Path, time: float, jump: float) -> InputError:
    found = f"a film that is cut near {time:.2f} s: {jump:.2f} s are missing"
    return InputError(path, value=found, allowed="a film in one piece, or with stamps that tell the gap")


def _cut_or_rate(film: PusherFilm, path: Path, offset: float, cut: tuple[float, float, float, float]) -> InputError:
    """Error that names a cut, or the rate where that explains the film better; a wrong one looks like a cut too."""
    rate, residual = find_rate(film, offset)
    if len(film.t) >= _FEWEST_OF_RATE and abs(rate - 1) > _FASTEST and residual < find_jump(film, offset)[2]:
        return _wrong_rate(path, film, rate)
    return _cut(path, *cut[:2])


def _other_rate(film: PusherFilm, guess: Guess, around: float, span: float) -> Guess | None:
    """Guess at another rate that suits the film much better; None where there is none."""
    if guess.score > 2 - 2 * _BETTER or len(film.t) < _FEWEST_OF_RATE:
        return None
    found = guess
    for rate in _RATES:
        start = around + (1 - rate) * float(film.t[0])
        slack = abs(1 - rate) * float(film.t[-1] - film.t[0])
        other = search(film, start - span - slack, start + span + slack, rate, most=FEW)
        found = other if other.score > found.score else found
    better = found.score > guess.score + _BETTER and found.still > guess.still + 0.5 * _BETTER
    return found if better and _trusted(found) else None


def _wrong_rate(path: Path, film: PusherFilm, rate: float) -> InputError:
    now = 1 / float(np.median(np.diff(film.t)))
    found = f"stamps of another clock: a second of the film is {rate:.3g} s of the log"
    allowed = f"the right stamps; if {now:.4g} Hz is wrong, --rate {now / rate:.4g}"
    return InputError(path, value=found, allowed=allowed)


def _with_drift(film: PusherFilm, path: Path, fit: ClockFit) -> ClockFit:
    """Return the fit, or one at another rate where that explains the film much better and the patches' bands agree.

    Raises:
        InputError: A piece that is missing explains it better than a rate does, or the rate is not that of a drift.
    """
    if len(film.t) < _FEWEST_OF_RATE:
        return fit
    rate, residual = find_rate(film, fit.offset)
    if abs(rate - 1) * float(np.ptp(film.t)) < _DRIFT or residual > _EXPLAINED * fit.residual:
        return fit
    better = refine(film, fit.offset + (1 - rate) * float(np.mean(film.t)), rate)
    if better.deviation > _SURE:  # a film that hardly moves tells neither
        return better if abs(rate - 1) <= _FASTEST else fit
    time, jump, left = find_jump(film, fit.offset)
    if jump > _JUMP and left < _EXPLAINED * residual:
        raise _cut(path, time, jump)
    if abs(rate - 1) > _FASTEST:
        raise _wrong_rate(path, film, rate)
    # What hides part of the pusher, or moves beside it, looks like a drift in some of the bands.
    apart = float(np.median(np.abs(rates_of_bands(film, fit.offset) - rate)))
    return better if apart <= _APART * abs(rate - 1) else fit
