# SPDX-License-Identifier: MIT
"""The episodes of an evaluation on disk: a file for each that is done, so that a run that was ended can go on."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from pinwm_drake.checkpoints import check_arrays, read_arrays, write_arrays
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import EpisodeResult
from pinwm_drake.report.evaluation.episode import EpisodeRecord

_TABLES = ("q_WO", "p_WO", "p_WP", "views", "at", "goal")
_TIMES = ("seconds", "cpu_seconds")
_FIGURES = ("success", "steps", "distance", "angle", "start_distance", "start_angle", "coverage")


class EpisodeStore:
    """A folder of `SEED.npz`; a `parallel.Store`."""

    def __init__(self, folder: Path, about: Mapping[str, object], *, resume: bool) -> None:
        """Make the folder.

        Args:
            folder: The folder; made if need be.
            about: Settings that results depend on; episodes of other settings are refused.
            resume: Flag: the folder may hold episodes already.

        Raises:
            InputError: The folder holds episodes without `resume`, or cannot be written to.
        """
        # A worker may be in another folder.
        self._folder, self._about = prepare_folder(folder).absolute(), dict(about)
        if not resume and any(folder.glob("*.npz")):
            raise InputError(
                folder, value="episodes of an evaluation", allowed="a new folder, or --resume to go on with them"
            )

    def write(self, seed: int, record: EpisodeRecord) -> None:
        """Keep an episode.

        Raises:
            InputError: The file cannot be written.
        """
        arrays = {name: np.asarray(getattr(record, name)) for name in (*_TABLES, *_TIMES)}
        arrays |= {name: np.asarray(getattr(record.result, name)) for name in (*_FIGURES, "failure")}
        write_arrays(self._path(seed), self._about, arrays)

    def read(self, seed: int) -> EpisodeRecord | None:
        """Return the episode of a seed; None where there is none.

        Raises:
            InputError: It cannot be read, or is of other settings; the message names what differs.
        """
        arrays = read_arrays(self._path(seed), self._about, "test", (*_TABLES, *_FIGURES, *_TIMES, "failure"))
        if arrays is None:
            return None
        n, m = (len(np.atleast_1d(arrays[name])) for name in ("p_WO", "views"))
        wanted: dict[str, tuple[str, tuple[int | None, ...]]] = {
            **dict.fromkeys(_TIMES, ("f", ())),
            **{name: ("f", (n, columns)) for name, columns in (("q_WO", 4), ("p_WO", 3), ("p_WP", 3))},
            "views": ("u", (m, None, None, 3)),
            "at": ("i", (m,)),
            "goal": ("f", (None,)),
            "success": ("b", ()),
            "steps": ("i", ()),
            "failure": ("U", ()),
        }
        check_arrays(self._path(seed), arrays, wanted, "test")
        lone = all(arrays[name].shape == () and arrays[name].dtype.kind == "f" for name in _FIGURES[2:])
        if not lone or not 0 <= arrays["steps"] <= n - 1:
            value = f"{arrays['steps']} steps with {n} rows"
            raise InputError(self._path(seed), value=value, allowed="figures of one episode, and a row for each step")
        figures = {name: arrays[name].item() for name in _FIGURES}
        result = EpisodeResult(seed=seed, failure=str(arrays["failure"]), **figures)
        tables = {name: arrays[name] for name in _TABLES}
        wall, cpu = (float(arrays[name]) for name in _TIMES)
        return EpisodeRecord(result, **tables, seconds=wall, cpu_seconds=cpu)

    def holding(self, seed: int) -> AbstractContextManager[None]:
        """Context in which an episode is run: nothing, as no two evaluations share a folder."""
        return nullcontext()

    def _path(self, seed: int) -> Path:
        return self._folder / f"{seed:06d}.npz"
