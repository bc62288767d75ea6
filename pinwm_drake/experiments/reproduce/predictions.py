"""Cells of a twin's predictions against the plant."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.experiments.one_step import one_step_errors
from pinwm_drake.experiments.reproduce.cell import Cell, Say
from pinwm_drake.experiments.reproduce.scenes import task_scene
from pinwm_drake.experiments.reproduce.twins import TwinCell


@dataclass(frozen=True)
class OneStepCell:
    """Cell of errors after one random action, in Drake's hydroelastic plant.

    Attributes:
        task: Name of the task's scene.
        origin: Name of the identification, or "scene" for the scene's own parameters.
        seed: Seed of the experiment.
        draws: Number of actions.
        twin: Cell of the twin; None for the scene's own.
    """

    task: str
    origin: str
    seed: int
    draws: int
    twin: TwinCell | None

    @property
    def key(self) -> str:
        """Path of its folder."""
        place = f"{self.task}/seed-{self.seed}" if self.twin is None else self.twin.surfels.capture.place
        return f"one-step/{self.origin}/{place}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The twin, where there is one."""
        return () if self.twin is None else (self.twin,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.draws / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Draws the actions; see `Cell.make`."""
        scene = task_scene(self.task).scene
        twin = None if self.twin is None else str(root / self.twin.key)
        found = one_step_errors(scene, twin, "hydroelastic", self.draws, self.seed)
        return {name: _summary(values) for name, values in zip(("translation", "rotation"), found.T, strict=True)}


def _summary(values: np.ndarray) -> dict[str, float]:
    low, high = (float(np.quantile(values, share)) for share in (0.5, 0.95))
    return {"mean": float(values.mean()), "median": low, "high": high}
