"""The paper's tasks as scenes: what is filmed, what its true parameters are, and where policies are tried."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pinwm_drake.cousins.randomization import FLIP_SPANS, Spans
from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.systems.runs.capture_options import SimulateOptions
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.registry import recipe_of


@dataclass(frozen=True)
class TaskScene:
    """Task with its scene, its object and the ranges of ignorance.

    Attributes:
        name: Name in folders and tables.
        task: Name of the task.
        scene: Scenario in which policies are trained and tried.
        object_name: Object that is filmed.
        friction, pusher_friction: True coefficients of friction.
        capture_seed: Seed of the capture of the experiment's first seed.
        episode: Episode that is identified from.
        spans: Ranges R.
    """

    name: str
    task: str
    scene: str
    object_name: str
    friction: float
    pusher_friction: float
    capture_seed: int
    episode: str
    spans: Spans

    @property
    def true_theta(self) -> dict[str, float]:
        """True values of `THETA`'s parameters, SI units."""
        return {name: estimate.value for name, estimate in load_setup(self.scene).twin.theta.items()}

    @property
    def max_translation(self) -> float | None:
        """Longest translation of an action that policies are trained for, m; None for that of the pusher's speed."""
        return recipe_of(self.task).max_translation

    def capture(self, seed: int, *, quick: bool) -> SimulateOptions:
        """Options of the capture; a quick one has fewer and smaller images."""
        small: dict[str, Any] = (
            {"size": 128, "static_views": 6, "frames": 12, "rate": 12.0, "supersampling": 1} if quick else {}
        )
        return SimulateOptions(
            object_name=self.object_name,
            friction=self.friction,
            pusher_friction=self.pusher_friction,
            seed=self.capture_seed + seed,
            task=self.task,
            **small,
        )


_ALL = (
    TaskScene("push", "push", "push_t", "t_block", 0.03, 0.03, 0, "0000", Spans()),
    TaskScene("flip", "flip", "flip_mug", "mug", 0.2, 0.9, 1, "0001", FLIP_SPANS),
    TaskScene("push-cube", "push", "push_cube_slippery", "cube", 0.03, 0.03, 0, "0000", Spans()),
    TaskScene("push-large-t", "push", "push_large_t", "large_t", 0.03, 0.03, 0, "0000", Spans()),
    TaskScene("flip-cube", "flip", "flip_cube", "cube", 0.2, 0.9, 2, "0000", FLIP_SPANS),
)
TASK_SCENES: Mapping[str, TaskScene] = {scene.name: scene for scene in _ALL}
TASKS = ("push", "flip")  # those of most tables


def task_scene(task: str) -> TaskScene:
    """Scene of a name.

    Raises:
        ParameterError: There is no such scene.
    """
    if task not in TASK_SCENES:
        raise ParameterError(f"--task: got {task!r}; allowed: {', '.join(TASK_SCENES)}")
    return TASK_SCENES[task]


@dataclass(frozen=True)
class SceneCell(Cell):
    """Cell of what is made in a task's scene.

    Attributes:
        task: Name of the scene.
        seed: Seed of the experiment.
        stand_in: Flag: in the stand-in for a robot; see `StandIn`.
    """

    task: str
    seed: int
    stand_in: bool = field(default=False, kw_only=True)

    @property
    def scene(self) -> TaskScene:
        """The scene."""
        return task_scene(self.task)

    @property
    def place(self) -> str:
        """Folder of what is made for the same scene."""
        return f"{self.task}-stand-in" if self.stand_in else self.task
