# SPDX-License-Identifier: MIT
"""Cells of predictions against the plant: those of twins, and those that Dreamer V2 imagines."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder
from pinwm_drake.identification.forward import inertia
from pinwm_drake.identification.history import HISTORY_FILE, History, read_history
from pinwm_drake.paper.baselines.dreamer.policy import read_dreamer
from pinwm_drake.paper.baselines.dreamer.training import read_world_model
from pinwm_drake.paper.one_step import (
    Outcomes,
    SeenOutcomes,
    imagine,
    outcomes_at_rest,
    picture_errors,
    plant_outcomes,
    see_outcomes,
    step_errors,
)
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.policies import DreamerCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import DREAMER, task_scene
from pinwm_drake.paper.reproduce.twins import IdentifiedCell
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.twin.rollout import NO_EFFECT, twin_scene
from pinwm_drake.twin.twin import Estimate, Twin

OUTCOMES_FILE, ENGINE = "outcomes.npz", "hydroelastic"
_REST, _QUICK_REST = 20, 1  # actions in which an object comes to rest, at most
_POINTS = 8  # of the curve over the iterations
_MOMENTS = ("moment_xx", "moment_yy", "moment_zz")


@dataclass(frozen=True)
class OutcomesCell(Cell):
    """Cell of random actions in Drake's hydroelastic plant, and what they do.

    Attributes:
        max_translation: m, translation of the pusher in each; None for the longest that its speed allows.
        rest: Number of actions of standing still, at the most, in which the object comes to rest after each; 0 where it
            is looked at when the action ends.
    """

    path = "outcomes{self.ending}/{self.task}"

    task: str
    draws: int
    max_translation: float | None
    rest: int = 0

    @property
    def ending(self) -> str:
        """Ending of the names of folders: when the object is looked at."""
        return "-at-rest" if self.rest else ""

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The actions, where they are followed to rest; otherwise nothing."""
        return (replace(self, rest=0),) if self.rest else ()

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return (2.5 + 0.4 * self.rest) * self.draws / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Draws the actions, or takes them again until the object rests; see `Cell.make`."""
        scene = task_scene(self.task).scene
        if self.rest:
            _, drawn = replace(self, rest=0).read(root)
            found = outcomes_at_rest(scene, ENGINE, drawn, self.rest)
        else:
            found = plant_outcomes(scene, ENGINE, self.draws, 0, max_translation=self.max_translation)
        found.write(prepare_folder(root / self.key) / OUTCOMES_FILE)
        return {"moved": float(np.linalg.norm(found.moved, axis=1).mean())}

    def read(self, root: Path) -> tuple[str, Outcomes]:
        """Scene and outcomes, once they are made."""
        return task_scene(self.task).scene, Outcomes.read(root / self.key / OUTCOMES_FILE)


def outcomes_cell(request: ReproduceRequest, task: str, *, at_rest: bool = False) -> OutcomesCell:
    """Cell of what random actions do in the plant, as long as those that policies are trained with."""
    rest = (_QUICK_REST if request.quick else _REST) if at_rest else 0
    return OutcomesCell(task, request.draws, task_scene(task).max_translation, rest)


@dataclass(frozen=True)
class OneStepCell(Cell):
    """Cell of a twin's errors after one random action, and of what they were while it was identified.

    Attributes:
        origin: Name of the identification, or "scene" for the scene's own parameters.
        twin: Cell of the twin; None for the scene's own.
        curve: Flag: errors of the best start's guesses on the way, too.
    """

    origin: str
    outcomes: OutcomesCell
    twin: IdentifiedCell | None
    curve: bool = False

    @property
    def key(self) -> str:
        """Path of its folder."""
        place = self.outcomes.task if self.twin is None else self.twin.surfels.capture.place
        return f"one-step{self.outcomes.ending}/{self.origin}/{place}"

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.outcomes.draws * (1 + self.curve * _POINTS) * (0.05 + 0.01 * self.outcomes.rest) / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Take the same actions in the twin; see `Cell.make`."""
        scene, outcomes = self.outcomes.read(root)
        rest = self.outcomes.rest
        if self.twin is None:
            return summary(step_errors(load_setup(scene), outcomes, rest))
        folder = root / self.twin.key
        setup = load_setup(scene, twin=folder)
        result: dict[str, Any] = summary(step_errors(setup, outcomes, rest))
        if self.curve:
            history = read_history(folder / HISTORY_FILE)
            result["curve"] = [
                {"iteration": int(history.iteration[row]), "loss": float(history.loss[row])}
                | summary(step_errors(replace(setup, twin=twin_at(setup.twin, history, row)), outcomes, rest))
                for row in guesses(history)
            ]
        return result


def guesses(history: History) -> list[int]:
    """Rows of the history of the best start: some of its guesses, evenly spaced, the last one included."""
    if not len(history.loss):
        return []
    best = max((rows for _, rows in history.starts()), key=lambda rows: (len(rows), -history.loss[rows[-1]]))
    return [int(best[k]) for k in np.unique(np.linspace(0, len(best) - 1, _POINTS).round().astype(int))]


def twin_at(twin: Twin, history: History, row: int) -> Twin:
    """Twin with the parameters of a guess that its identification made on the way."""
    guess = dict(zip(history.names, history.theta[row].tolist(), strict=True))
    theta = {name: replace(one, value=guess.get(name, one.value)) for name, one in twin.theta.items()}
    scene = twin_scene(twin, torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64))
    factors = {name: torch.tensor(guess.get(name, 1.0), dtype=torch.float64) for name in _MOMENTS}
    moments = inertia(scene, theta["mass"].value, factors).diagonal()
    for axis, value in zip("xyz", moments.tolist(), strict=True):
        name = f"inertia_{2 * axis}"
        theta[name] = replace(theta[name], value=value)
    shape = {name: Estimate(guess[name], None, False, "1") for name in NO_EFFECT if name in guess}
    return replace(twin, theta=theta, nuisance=twin.nuisance | shape, draws=None)


def summary(errors: np.ndarray) -> dict[str, Any]:
    """Mean, median and 95th percentile of translation [m] and rotation [rad] errors (n, 2)."""
    found = {}
    for name, values in zip(("translation", "rotation"), errors.T, strict=True):
        low, high = (float(np.quantile(values, share)) for share in (0.5, 0.95))
        found[name] = {"mean": float(values.mean()), "median": low, "high": high}
    return found


SEEN_FILE = "seen.npz"
_READING = 0.5  # s, of a pose from an image


@dataclass(frozen=True)
class SeenOutcomesCell(Cell):
    """Cell of the plant's images of random actions, and of the errors of poses that are read from them."""

    path, origin = "one-step/readout/{self.outcomes.task}", "readout"

    outcomes: OutcomesCell

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.outcomes.draws * (2.0 + _READING) / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Take the actions again, and read the images after them; see `Cell.make`."""
        scene, outcomes = self.outcomes.read(root)
        seen = see_outcomes(scene, ENGINE, outcomes)
        seen.write(prepare_folder(root / self.key) / SEEN_FILE)
        return summary(picture_errors(load_setup(scene), outcomes, seen, seen.after, num_threads=1))


@dataclass(frozen=True)
class ImaginedStepCell(Cell):
    """Cell of the errors of poses that are read from what Dreamer V2 imagines after random actions.

    Attributes:
        seen: Cell of the plant's images, of which the model sees those before the action.
    """

    path = "one-step/dreamer-v2/{self.dreamer.trajectories.task}/seed-{self.dreamer.trajectories.seed}"
    origin = DREAMER

    seen: SeenOutcomesCell
    dreamer: DreamerCell

    @property
    def outcomes(self) -> OutcomesCell:
        """Cell of the actions."""
        return self.seen.outcomes

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.outcomes.draws * _READING / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Imagines the images after the actions, and reads them; see `Cell.make`."""
        folder, (scene, outcomes) = root / self.dreamer.key, self.outcomes.read(root)
        seen = SeenOutcomes.read(root / self.seen.key / SEEN_FILE)
        policy, longest = read_dreamer(folder), float(outcomes.longest)
        unit = policy.spec.max_translation
        require("translation of an action", f"{longest:g} m", abs(longest - unit) < 1e-9, f"the model's, {unit:g} m")
        images = imagine(read_world_model(folder, policy), seen)
        return summary(picture_errors(load_setup(scene), outcomes, seen, images, num_threads=1))
