# SPDX-License-Identifier: MIT
"""Requests of a reproduction: what `pinwm reproduce` does. Light, as the command line reads it."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from pinwm_drake.errors import require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, FLATTEN, argument, option, request

REPORT = "report"
_QUICK_DRAWS = 3


@request
class ReproduceRequest:
    """Request of one table or several.

    Raises:
        ParameterError: An option is none of those allowed.
    """

    tasks: Annotated[
        tuple[str, ...],
        option("Task, such as push, flip or push-cube; repeat it.", "--task", default="push and flip"),
    ] = ("push", "flip")
    methods: tuple[str, ...] | None = None
    seeds: Annotated[int, Field(ge=1)] = 1
    episodes: Annotated[int, option("Number of episodes of each evaluation.", group=BUDGET, ge=1)] = 100
    draws: Annotated[int, option("Number of actions for the one-step errors.", group=BUDGET, ge=1)] = 200
    quick: Annotated[bool, option("Use tiny budgets, one episode and three draws, as a trial run.", group=BUDGET)] = (
        False
    )

    def __post_init__(self) -> None:
        """Check the names; what is named twice counts once."""
        from pinwm_drake.paper.reproduce.systems import SYSTEMS, TASK_SCENES

        object.__setattr__(self, "tasks", tuple(dict.fromkeys(self.tasks)))
        for task in self.tasks:
            require("--task", repr(task), task in TASK_SCENES, ", ".join(TASK_SCENES))
        for name in self.methods or ():
            require("--methods", repr(name), name in SYSTEMS, f"all, {', '.join(SYSTEMS)}")

    def chosen(self, names: Sequence[str]) -> list[str]:
        """Names of a table's systems, those of the request alone where it names some."""
        return [name for name in names if self.methods is None or name in self.methods]

    @property
    def max_steps(self) -> int | None:
        """Number of actions of an evaluated episode; None for the task's."""
        return 2 if self.quick else None


@request
class ReproduceRun:
    """Request of tables, with folder and processes."""

    tables: Annotated[
        tuple[str, ...],
        argument(
            "Tables to make, such as policies or one-step; all; or report.",
            "TABLE...",
        ),
    ]
    seeds: Annotated[
        int | None,
        option(
            "Number of seeds, each with a capture of its own.",
            group=BUDGET,
            ge=1,
            default="1; for report all there are",
        ),
    ] = None
    work: Annotated[ReproduceRequest, FLATTEN] = dataclasses.field(default_factory=ReproduceRequest)
    systems: Annotated[str, option("Systems to compare, separated by commas, or all.", "--methods", default="all")] = (
        "all"
    )
    out: Annotated[Path, option("Folder of the cells, each made once.", "--out", "-o", group=DATA, result="inside")] = (
        Path("out/reproduce")
    )
    report: Annotated[Path | None, option("Markdown file of the report.", group=DATA, default="OUT/report.md")] = None
    plan_only: Annotated[bool, option("Print the plan and end.", "--plan")] = False
    resume: Annotated[bool, option("Continue with the cells that are already made.", group=BUDGET)] = True
    workers: Annotated[
        int | None, option("Number of processes.", group=BUDGET, default="one a core, within free memory")
    ] = None
    executor: Annotated[Literal["joblib", "ray"], option("Library that runs the processes.", group=ADVANCED)] = "joblib"

    def resolved(self) -> ReproduceRequest:
        """Request of the tables, with the systems and the budget."""
        names = tuple(name.strip() for name in self.systems.split(","))
        chosen = dataclasses.replace(self.work, methods=None if "all" in names else names, seeds=self.seeds or 1)
        if chosen.quick:
            chosen = dataclasses.replace(chosen, episodes=1, draws=min(chosen.draws, _QUICK_DRAWS))
        return chosen
