"""The request of a reproduction."""

from collections.abc import Sequence
from dataclasses import dataclass

from pinwm_drake.errors import require
from pinwm_drake.paper.reproduce.predictions import OutcomesCell
from pinwm_drake.paper.reproduce.scenes import TASK_SCENES, TASKS, task_scene
from pinwm_drake.paper.reproduce.systems import PIN_WM, SYSTEMS
from pinwm_drake.paper.reproduce.twins import CaptureCell, IdentifiedCell, SurfelsCell, TrackedTwinCell, TwinCell

_REST, _QUICK_REST = 20, 1  # actions in which an object comes to rest, at most


@dataclass(frozen=True)
class ReproduceRequest:
    """Request of one table or several: fields named as the options of `pinwm reproduce`, which describes them.

    Raises:
        ParameterError: An option is none of those allowed.
    """

    tasks: Sequence[str] = TASKS
    methods: Sequence[str] | None = None
    seeds: int = 1
    episodes: int = 100
    draws: int = 200
    quick: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "tasks", tuple(dict.fromkeys(self.tasks)))
        for task in self.tasks:
            require("--task", repr(task), task in TASK_SCENES, ", ".join(TASK_SCENES))
        for name in self.methods or ():
            require("--methods", repr(name), name in SYSTEMS, f"all, {', '.join(SYSTEMS)}")
        for name in ("seeds", "episodes", "draws"):
            require(f"--{name}", getattr(self, name), getattr(self, name) >= 1, "1 or more")

    def chosen(self, names: Sequence[str]) -> list[str]:
        """Names of a table's systems, those of the request alone where it names some."""
        return [name for name in names if self.methods is None or name in self.methods]

    @property
    def max_steps(self) -> int | None:
        """Number of actions of an evaluated episode; None for the task's."""
        return 2 if self.quick else None

    def twin(
        self, task: str, seed: int, system: str = PIN_WM, only: str = "", *, stand_in: bool = False
    ) -> IdentifiedCell:
        """Cell of the twin that a system identifies, by one unknown alone where it is named; maybe in the stand-in."""
        surfels = SurfelsCell(CaptureCell(task, seed, quick=self.quick, stand_in=stand_in))
        return TwinCell(surfels, only=only) if system == PIN_WM else TrackedTwinCell(surfels, system, only)

    def outcomes(self, task: str, *, at_rest: bool = False) -> OutcomesCell:
        """Cell of what random actions do in the plant, as long as those that policies are trained with."""
        rest = (_QUICK_REST if self.quick else _REST) if at_rest else 0
        return OutcomesCell(task, self.draws, task_scene(task).max_translation, rest)
