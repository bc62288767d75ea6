# SPDX-License-Identifier: MIT
"""The seam of methods: one signature for everything that is trained, learned or planned."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.learning.evaluation import Acts
from pinwm_drake.learning.progress import Report
from pinwm_drake.learning.spec import Observes, PolicySpec
from pinwm_drake.tasks.waypoints import Waypoints

Observation = Literal["state", "rgb", "rgb_state"]


@dataclass(frozen=True)
class MethodData:
    """Recorded data that a method may learn from; each method takes the part that it needs.

    Attributes:
        demonstrations: Folder of recorded episodes of an expert; None for none.
        trajectories: Folder of recorded task-agnostic episodes, as `collect` of Dreamer writes them; None for none.
    """

    demonstrations: Path | None = None
    trajectories: Path | None = None


class MakeWorlds(Protocol):
    """Worlds of one scene and task, in which the domains of episodes follow the method's distribution."""

    @property
    def about(self) -> dict[str, object]:
        """Description of scene, task and domains as JSON takes it: checkpoints of other ones are refused."""

    @property
    def waypoints(self) -> Waypoints:
        """States in which most episodes begin beside the scene's starts, and what is to be done there; maybe none."""

    def worlds(self, observation: Observation) -> VecEnv:
        """Worlds with the rewards of training, in one vectorised environment."""

    def spec(self, observes: Observes) -> PolicySpec:
        """Specification of a policy that acts in these worlds."""

    def begin(self, seed: int) -> None:
        """Draws the domains of the next round from a seed."""


class Method(Protocol):
    """A method that makes a policy or controller; a frozen dataclass whose fields are its settings."""

    def train(
        self,
        data: MethodData,
        make_worlds: MakeWorlds,
        out: Path,
        *,
        seed: int,
        resume: bool,
        report: Report,
    ) -> Acts:
        """Trains, with checkpoints under `out`, so that a run that was killed goes on with the same result.

        Args:
            data: Recorded data.
            make_worlds: Worlds to train in.
            out: Existing folder of the run.
            seed: Seed of networks and worlds, 0 or more.
            resume: Flag: goes on from checkpoints in `out`, where there are any.
            report: Called with the progress of each stage.

        Raises:
            PinwmError: A setting is out of range, a checkpoint cannot be used, or a file cannot be written.
        """
