# SPDX-License-Identifier: MIT
"""Memory of a search, so that it can go on: results of its phases, state of the one at hand, every evaluation."""

import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.checkpoints import check_arrays, read_arrays, write_arrays
from pinwm_drake.errors import InputError
from pinwm_drake.identification.adam import AdamState
from pinwm_drake.identification.history import Log

CHECKPOINT_FILE = "identify_checkpoint.npz"


class Checkpoint:
    """The memory of one search, in a file where there is a folder for it."""

    def __init__(
        self, folder: Path | None, about: Mapping[str, object], *, resume: bool, every: int, size: int | None = None
    ) -> None:
        """Checkpoint without contents, or as an earlier run left it.

        Args:
            folder: Folder of the checkpoint file; None for no file.
            about: Inputs that the search depends on; a checkpoint of another search is refused.
            resume: Whether to go on from the file, if there is one.
            every: Steps of Adam between two writes.
            size: Number of unknowns; None where they are not known.

        Raises:
            InputError: The checkpoint is of another search, or cannot be read.
        """
        self.path = None if folder is None else folder / CHECKPOINT_FILE
        self.about, self.every = dict(about), every
        self.done: dict[str, np.ndarray] = {}  # results of the phases that ended, as PHASE.NAME
        self.log = Log()
        self.begun = time.monotonic()
        stored = read_arrays(self.path, self.about, "identify", ["seconds"]) if self.path and resume else None
        if stored is not None and self.path is not None:
            _check(self.path, stored, size)
            self.begun -= float(stored.pop("seconds"))
            self.log = Log({name: stored.pop(f"log.{name}") for name in self.log.arrays()})
            self.done = stored

    @property
    def seconds(self) -> float:
        """Wall time [s] of the search, all runs together."""
        return time.monotonic() - self.begun

    def end(self, phase: str, results: Mapping[str, object]) -> None:
        """Keep the result of a phase, and drop its state."""
        self.done = {name: array for name, array in self.done.items() if not name.startswith("now.")}
        for name, value in results.items():
            self.done[f"{phase}.{name}"] = np.asarray(value)
        self._write({})

    def result(self, phase: str) -> dict[str, Tensor]:
        """Return the result of a phase by name; empty where it has not ended."""
        names = [name for name in self.done if name.startswith(f"{phase}.")]
        return {name.removeprefix(f"{phase}."): torch.from_numpy(self.done[name]) for name in names}

    def save_adam(self, phase: str, state: AdamState) -> None:
        """Keep the state of a phase of Adam, every few steps."""
        if state.iteration % self.every == 0:
            self._write({f"now.{phase}.{name}": np.asarray(value) for name, value in vars(state).items()})

    def load_adam(self, phase: str) -> AdamState | None:
        """State in which a phase of Adam was interrupted."""
        found = self.result(f"now.{phase}")
        if not found:
            return None
        return AdamState(int(found.pop("iteration")), scale=float(found.pop("scale")), **found)

    def _write(self, extra: Mapping[str, np.ndarray]) -> None:
        if self.path is None:
            return
        history = {f"log.{name}": array for name, array in self.log.arrays().items()}
        write_arrays(self.path, self.about, {**self.done, **extra, **history, "seconds": np.array(self.seconds)})


def _check(path: Path, arrays: Mapping[str, np.ndarray], size: int | None) -> None:
    """Raise InputError where arrays of a checkpoint do not fit the number of unknowns, or each other."""
    n = len(np.atleast_1d(arrays.get("log.loss", np.zeros(0))))
    wanted: dict[str, tuple[str, tuple[int | None, ...]]] = {
        "seconds": ("f", ()),
        "log.iteration": ("i", (n,)),
        "log.stage": ("U", (n,)),
        "log.start": ("i", (n,)),
    }
    if n or "log.theta" not in arrays:
        wanted["log.theta"] = ("f", (n, size))
    for name, array in arrays.items():
        field, W = name.rpartition(".")[2], len(np.atleast_1d(array))
        if field in ("z", "first", "second", "best_z"):
            wanted[name] = ("f", (size,) if array.ndim == 1 else (W, size))
        elif field == "iteration" and name != "log.iteration":
            wanted[name] = ("i", ())
        elif field == "scale" and name.startswith("now."):
            wanted[name] = ("f", ())
        elif field == "corrections":
            wanted[name] = ("f", (None,) * array.ndim)
    for phase in {name.rpartition(".")[0] for name in arrays if name.startswith("now.")}:
        for one in fields(AdamState):
            if f"{phase}.{one.name}" not in arrays:
                raise InputError(path, value=f"no array {phase}.{one.name}", allowed="a checkpoint of `identify`")
    check_arrays(path, arrays, wanted, "identify")
    for name, array in arrays.items():
        if name in wanted or name == "log.theta":  # (0,) where nothing was evaluated
            continue
        if name.rpartition(".")[2] not in ("loss", "best_loss", "objective"):
            raise InputError(path, value=f"an array {name}", allowed="a checkpoint of `identify`")
        if array.dtype.kind != "f":
            raise InputError(path, value=f"{name} of {array.dtype}", allowed="numbers")
        if not (array > -np.inf).all():  # infinite where the physics has no solution
            raise InputError(path, value=f"{name} with NaN or -inf", allowed="numbers, or infinity")
