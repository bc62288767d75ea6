# SPDX-License-Identifier: MIT
"""The request of an evaluation: what `pinwm evaluate` does."""

import math
from pathlib import Path
from typing import Annotated, Literal

from pinwm_drake.errors import require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, FLATTEN, LAB, argument, option, request

MPC, RANDOM = "mpc", "random"
_LARGEST = 2**31  # one more than the largest seed of an episode


@request
class EvaluateRequest:
    """Options of an evaluation on which its results depend.

    Raises:
        ParameterError: An option is out of range, or does not go with another one.
    """

    policy: Annotated[
        str,
        argument(
            "Folder of a policy or bundle, the name of a bundle that ships, mpc or random.",
            "POLICY",
            completes="policy",
        ),
    ]
    scene: Annotated[
        str | None,
        option(
            "Scenario that ships, a .scenario.yaml file, or a twin's folder.",
            group=DATA,
            default="the policy's",
            completes="scene",
        ),
    ] = None
    engine: Annotated[
        Literal["twin", "hydroelastic", "point"], option("Physics engine of the episodes.", group=DATA)
    ] = "hydroelastic"
    episodes: Annotated[int, option("Number of episodes.", group=BUDGET, ge=1)] = 100
    seed: Annotated[
        int, option("Seed of the first episode; the others follow it.", group=ADVANCED, ge=0, le=_LARGEST - 1)
    ] = 0
    tolerance: Annotated[
        float | None, option("Largest distance from the goal in a success.", unit="m", default="the policy's")
    ] = None
    turn_tolerance: Annotated[
        float | None, option("Largest angle from the goal in a success.", unit="rad", default="the policy's")
    ] = None
    yaw: Annotated[
        float | None,
        option(
            "Largest yaw of the object at the start.",
            group=LAB,
            unit="rad",
            ge=0,
            le=math.pi + 1e-9,
            allowed="0 to pi",
            default="the scene's",
        ),
    ] = None
    latency: Annotated[
        float | None,
        option(
            "Delay of an action.",
            group=LAB,
            unit="s",
            ge=0,
            default="0; that of the policy's training, where it never was 0",
        ),
    ] = None
    max_steps: Annotated[
        int | None, option("Largest number of actions in an episode.", group=BUDGET, default="the policy's")
    ] = None
    max_translation: Annotated[
        float | None,
        option(
            "Longest pusher translation in an action, for mpc and random.", group=LAB, unit="m", default="the task's"
        ),
    ] = None
    model: Annotated[
        str | None,
        option("Twin or scenario that mpc plans with.", group=DATA, default="the scene", completes="twin"),
    ] = None
    task: Annotated[str | None, option("Task of mpc and random: push or flip.", default="the scene's")] = None
    stand_in: Annotated[
        bool,
        option("Evaluate in the stand-in for a robot: shifted camera, late actions, ragged masks.", group=LAB),
    ] = False
    other_object: Annotated[
        bool, option("Admit a scene of another object, pusher or floor than the policy's.", group=LAB)
    ] = False

    def __post_init__(self) -> None:
        """Check options that depend on each other."""
        last = _LARGEST - self.episodes
        require("--seed", self.seed, self.seed <= last, f"0 to {last}")
        plant = not self.stand_in or self.engine != "twin"
        require("--stand-in", f"one with engine {self.engine}", plant, "with hydroelastic, point")
        own = not self.stand_in or not self.latency
        require("--latency", "one beside that of the stand-in", own, "without --stand-in")
        free = self.max_translation is None or self.policy in (MPC, RANDOM)
        require("--max-translation", "one beside a policy, which has its own", free, "with mpc, random")
        named = self.task is None or self.policy in (MPC, RANDOM)
        require("--task", "one beside a policy, which has its own", named, "with mpc, random")
        require("--model", "one", self.model is None or self.policy == MPC, "with mpc")

    @property
    def seeds(self) -> range:
        """Seeds of the episodes, one for each."""
        return range(self.seed, self.seed + self.episodes)


@request
class EvaluateRun:
    """Request of `pinwm evaluate`: an evaluation, its folder and its processes."""

    evaluation: Annotated[EvaluateRequest, FLATTEN]
    out: Annotated[
        Path,
        option("Folder for evaluation.json, episodes.csv, episodes.mp4, report.html.", "--out", "-o", result="inside"),
    ] = Path("evaluation")
    workers: Annotated[
        int | None, option("Processes of the episodes.", group=BUDGET, ge=1, default="one a core, within free memory")
    ] = None
    executor: Annotated[Literal["joblib", "ray"], option("Library that runs the processes.", group=ADVANCED)] = "joblib"
    resume: Annotated[bool, option("Continue an interrupted run.", group=BUDGET)] = False
