# SPDX-License-Identifier: MIT
"""Offset of a log's clock to some hundredths of a second, from the energy of motion and patches that stand still."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.station.clock.patches import PusherFilm, path_weights

STEP = 0.02  # s
_LEAST_WAY = 15.0  # px that the pusher has to go in the film
_FRAMES = 48  # that are looked at for each offset
FEW = 40  # offsets that a quick search looks at: those with the most alike motion
_CONTRAST = 30.0  # patches with less contrast than this count less


@dataclass(frozen=True)
class Guess:
    """Guess of an offset.

    Attributes:
        offset: s, time of the log at time 0 of the film.
        motion: Correlation of the images' changes with the pusher's speed, -1 to 1.
        still: Correlation of the patches around the pusher with each other, -1 to 1.
        rate: Seconds of the log for each second of the film.
    """

    offset: float
    motion: float
    still: float
    rate: float = 1.0

    @property
    def score(self) -> float:
        """Sum of both correlations."""
        return self.motion + self.still


def search(film: PusherFilm, low: float, high: float, rate: float = 1.0, most: int = 400) -> Guess:
    """Return the guess of the highest score between two offsets [s]; one of score -2 where the pusher moves in none.

    Patches are looked at for `most` offsets, those with the most alike motion.
    """
    offsets = np.arange(low, high + 0.5 * STEP, STEP)
    alike = motion_correlations(film, offsets, rate)
    some = film.some(_FRAMES)
    if len(offsets) > most:
        chosen = np.argsort(alike)[-most:]
        offsets, alike = offsets[chosen], alike[chosen]
    pairs = zip(offsets.tolist(), alike.tolist(), strict=True)
    still = np.array([stillness(some, offset, rate) if motion > -1 else -1.0 for offset, motion in pairs])
    best = int(np.argmax(alike + still))
    return Guess(float(offsets[best]), float(alike[best]), float(still[best]), rate)


def motion_correlations(film: PusherFilm, offsets: np.ndarray, rate: float = 1.0) -> np.ndarray:
    """Correlations (k,) of the images' changes with the pusher's, for offsets (k,) [s]; -1 where it does not move."""
    changes = film.motion()
    changes = changes - changes.mean()
    found = np.full(len(offsets), -1.0)
    for k, offset in enumerate(offsets.tolist()):
        way = np.linalg.norm(np.diff(film.project(film.place(film.t * rate + offset)), axis=0), axis=1)
        if way.sum() >= _LEAST_WAY:
            root = np.sqrt(way) - np.sqrt(way).mean()
            found[k] = changes @ root / max(float(np.linalg.norm(changes) * np.linalg.norm(root)), 1e-9)
    return found


def stillness(film: PusherFilm, offset: float, rate: float = 1.0) -> float:
    """Mean correlation of the patches of pairs of frames, by the way that the pusher goes around both; -1 for none."""
    seen = film.look(film.t * rate + offset)
    weights = path_weights(seen.centre)
    if weights.sum() < _LEAST_WAY:
        return -1.0
    flat = standardised(film, seen.patches)
    total = weights @ flat
    own = float((weights**2) @ (flat**2).sum(1))
    return (float(total @ total) - own) / float(weights.sum() ** 2 - (weights**2).sum())


def standardised(film: PusherFilm, patches: np.ndarray) -> np.ndarray:
    """Patches (n, rows, columns, c) as rows (n, k) without their mean, of unit norm where they have contrast."""
    taper = film.taper.astype(np.float32)
    mean = patches.sum(1).transpose(0, 2, 1) @ taper / (taper.sum() * patches.shape[1])
    flat = ((patches - mean[:, None, None]) * np.sqrt(taper)[:, None]).reshape(len(patches), -1)
    return flat / (np.linalg.norm(flat, axis=1, keepdims=True) + np.float32(_CONTRAST))
