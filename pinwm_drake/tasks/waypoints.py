# SPDX-License-Identifier: MIT
"""States on the way to a goal, in which episodes of a training begin, and what a plan does there."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from pinwm_drake.checkpoints import check_arrays, read_arrays, write_arrays

WAYPOINTS_FILE = "waypoints.npz"
_WORK = "waypoints"


@dataclass(frozen=True, eq=False)
class Waypoints:
    """States from which a task was done, and how.

    Attributes:
        object_state: (n, 13) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
        p_WP: (n, 3) m, world: positions of the pusher.
        action: (n, k) in [-1, 1], of norm 1 at most, along the task's axes.
        past: (n, m, k) the actions that were asked for before, the newest first; m is 0 where actions are not late.
    """

    object_state: np.ndarray = field(default_factory=lambda: np.zeros((0, 13)))
    p_WP: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    action: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    past: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))

    def __len__(self) -> int:
        return len(self.p_WP)

    def before(self, row: int, number: int) -> np.ndarray:
        """Actions (number, k) that were asked for before a waypoint, the newest first; zeros where none are known."""
        found = np.zeros((number, self.action.shape[1]))
        known = self.past[row : row + 1, :number].reshape(-1, found.shape[1])
        found[: len(known)] = known
        return found

    def digest(self) -> str | None:
        """SHA-256 of states and actions, which tells waypoints apart; None without any."""
        parts = (self.object_state, self.p_WP, self.action, self.past)
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest() if len(self) else None

    def write(self, folder: Path, about: Mapping[str, object], **more: np.ndarray) -> None:
        """Write them to a folder.

        Args:
            folder: Existing folder.
            about: What they follow from, as JSON takes it.
            more: Other arrays to keep with them.

        Raises:
            InputError: The file cannot be written.
        """
        write_arrays(folder / WAYPOINTS_FILE, about, {one.name: getattr(self, one.name) for one in fields(self)} | more)

    @classmethod
    def read(cls, folder: Path) -> "Waypoints":
        """Waypoints in a folder; none where it has no file of them.

        Raises:
            InputError: The file cannot be read, or holds other arrays.
        """
        path = folder / WAYPOINTS_FILE
        arrays = read_arrays(path, {}, _WORK, [one.name for one in fields(cls)])
        return cls() if arrays is None else cls.of_arrays(path, arrays)

    @classmethod
    def of_arrays(cls, path: Path, arrays: Mapping[str, np.ndarray]) -> "Waypoints":
        """Waypoints from the arrays of a file.

        Args:
            path: The file, for messages.
            arrays: An array for each attribute, as `read_arrays` makes sure of it; others are left alone.

        Raises:
            InputError: An array is of another kind or shape, or holds a number that is not finite.
        """
        names = [one.name for one in fields(cls)]
        n, k, m = len(np.atleast_1d(arrays["p_WP"])), arrays["action"].shape[-1:], arrays["past"].shape[1:2]
        rows = n if arrays["past"].size else None  # without a past there may be no rows of it
        shapes = {"object_state": (n, 13), "p_WP": (n, 3), "action": (n, *k), "past": (rows, *m, *k)}
        check_arrays(path, arrays, {name: ("f", shape) for name, shape in shapes.items()}, _WORK)
        return cls(*(arrays[name] for name in names))
