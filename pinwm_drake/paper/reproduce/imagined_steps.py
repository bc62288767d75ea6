"""Cells of images after one random action: those of the plant, and those that Dreamer V2 imagines."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder
from pinwm_drake.paper.baselines.dreamer.policy import read_dreamer
from pinwm_drake.paper.baselines.dreamer.training import read_world_model
from pinwm_drake.paper.imagined_step import SeenOutcomes, imagine, picture_errors, see_outcomes
from pinwm_drake.paper.one_step import Outcomes
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.predictions import ENGINE, OUTCOMES_FILE, OutcomesCell, summary
from pinwm_drake.paper.reproduce.recordings import DreamerCell
from pinwm_drake.paper.reproduce.scenes import task_scene
from pinwm_drake.paper.reproduce.systems import DREAMER
from pinwm_drake.systems.scenario.load import load_setup

SEEN_FILE = "seen.npz"
READOUT = "readout"
_READING = 0.5  # s, of a pose from an image


@dataclass(frozen=True)
class SeenOutcomesCell(Cell):
    """Cell of the plant's images of random actions, and of the errors of poses that are read from them.

    Attributes:
        outcomes: Cell of the actions.
    """

    path = "one-step/readout/{self.outcomes.task}"

    outcomes: OutcomesCell

    @property
    def origin(self) -> str:
        """Name of what tells the poses."""
        return READOUT

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.outcomes.draws * (2.0 + _READING) / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Takes the actions again, and reads the images after them; see `Cell.make`."""
        scene, outcomes = task_scene(self.outcomes.task).scene, Outcomes.read(root / self.outcomes.key / OUTCOMES_FILE)
        seen = see_outcomes(scene, ENGINE, outcomes)
        seen.write(prepare_folder(root / self.key) / SEEN_FILE)
        return summary(picture_errors(load_setup(scene), outcomes, seen, seen.after, num_threads=1))


@dataclass(frozen=True)
class ImaginedStepCell(Cell):
    """Cell of the errors of poses that are read from what Dreamer V2 imagines after random actions.

    Attributes:
        seen: Cell of the plant's images, of which the model sees those before the action.
        dreamer: Cell of the model.
    """

    path = "one-step/dreamer-v2/{self.dreamer.trajectories.task}/seed-{self.dreamer.trajectories.seed}"

    seen: SeenOutcomesCell
    dreamer: DreamerCell

    @property
    def origin(self) -> str:
        """Name of what tells the poses."""
        return DREAMER

    @property
    def outcomes(self) -> OutcomesCell:
        """Cell of the actions."""
        return self.seen.outcomes

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Images, their actions, and the model."""
        return (self.seen, self.outcomes, self.dreamer)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.outcomes.draws * _READING / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Imagines the images after the actions, and reads them; see `Cell.make`."""
        about, folder = self.outcomes, root / self.dreamer.key
        outcomes = Outcomes.read(root / about.key / OUTCOMES_FILE)
        seen = SeenOutcomes.read(root / self.seen.key / SEEN_FILE)
        policy, longest = read_dreamer(folder), float(outcomes.longest)
        unit = policy.spec.max_translation
        require("translation of an action", f"{longest:g} m", abs(longest - unit) < 1e-9, f"the model's, {unit:g} m")
        images = imagine(read_world_model(folder, policy), seen)
        return summary(picture_errors(load_setup(task_scene(about.task).scene), outcomes, seen, images, num_threads=1))
