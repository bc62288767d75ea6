"""Cells of policies that systems train."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import train
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.progress import Report, Step
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.scenes import scene_folder, task_scene
from pinwm_drake.paper.reproduce.systems import NO_COUSINS, PIN_WM, SYSTEMS
from pinwm_drake.paper.reproduce.twins import IdentifiedCell
from pinwm_drake.systems.mpc.sampling import SamplingOptions
from pinwm_drake.systems.mpc.waypoints import WaypointOptions

_QUICK: dict[str, Any] = {
    "worlds": 8,
    "steps": 256,
    "round_steps": 256,
    "rounds": 1,
    "images": 64,
    "updates": 2,
    "episodes": 4,
}
_SILENCE = 60.0  # s, between two lines of a log
# Of a robot: a lab measures the 80 ms of its actions, and knows them to 10, and its masks to a pixel.
_ROBOT: dict[str, Any] = {"latency": (0.07, 0.09), "mask_error": 1.0}
_QUICK_SEARCH = WaypointOptions(attempts=1, rounds=0, planner=SamplingOptions(samples=8, first_iterations=1))


@dataclass(frozen=True)
class PolicyCell(Cell):
    """Cell of a policy that a system trains.

    Attributes:
        task: Name of the task's scene.
        system: Name of the system.
        seed: Seed of the experiment.
        twin: Cell of the twin that it is trained in; None for the scene's own parameters.
        quick: Flag: hardly any training.
        history: Number of past states and actions that the policy sees.
        stand_in: Flag: for the stand-in for a robot; see `robot_options`.
    """

    path = "policies/{self.place}/{self.system}/seed-{self.seed}"
    times = 0.02, 0.45

    task: str
    system: str
    seed: int
    twin: IdentifiedCell | None
    quick: bool = False
    history: int = 0
    stand_in: bool = False

    @property
    def place(self) -> str:
        """Folder of what is made for the same scene."""
        return scene_folder(self.task, self.stand_in)

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains the policy; see `Cell.make`."""
        scene, trained = task_scene(self.task), SYSTEMS[self.system]
        assert trained.domains is not None
        request = TrainRequest(
            scene=scene.scene if self.twin is None else str(root / self.twin.key),
            in_scene=None if self.twin is None else scene.scene,
            out=prepare_folder(root / self.key),
            task=scene.task,
            seed=self.seed,
            threads=1,
            resume=True,
            history=self.history,
            **robot_options(self.stand_in),
            # Others do not learn from the video where its camera is.
            as_filmed=self.stand_in and self.system in (PIN_WM, NO_COUSINS),
            **(_QUICK if self.quick else {}),
        )
        told: dict[str, Step] = {}
        report = say_rounds(say, told)
        search = _QUICK_SEARCH if self.quick else None
        train(request, domains=trained.domains(scene, self.seed), search=search, report=report)
        return {name: {"steps": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()}


def robot_options(stand_in: bool) -> dict[str, Any]:
    """Options of a `TrainRequest` by which a training expects what a lab knows of its robot.

    Args:
        stand_in: Flag: for the stand-in for a robot: actions that take effect 0.07 to 0.09 s late, and masks that are
            wrong by up to a pixel. There are none of these without it.
    """
    return _ROBOT if stand_in else {}


def say_rounds(say: Say, told: dict[str, Step]) -> Report:
    """Report of a training that says a line when its success is another one, and each minute at the least.

    Args:
        say: Called with the lines.
        told: Dict that takes the last progress of each stage, by name.
    """
    said = -math.inf

    def report(step: Step) -> None:
        nonlocal said
        known, now = not math.isnan(step.success), time.monotonic()
        if (known and (step.stage not in told or told[step.stage].success != step.success)) or now - said > _SILENCE:
            success = f", success {step.success:.0%}" if known else ""
            length = "" if math.isnan(step.length) else f" in {step.length:.0f} actions"
            say(f"{step.stage} {step.done:.0%}{success}{length}")
            said = now
        told[step.stage] = step

    return report
