# SPDX-License-Identifier: MIT
"""The request of a training: what `pinwm train` does."""

import math
from pathlib import Path
from typing import Annotated, Literal

from pinwm_drake.errors import require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, LAB, argument, option, request

_PI = {"le": math.pi + 1e-9, "allowed": "0 to pi"}


@request
class TrainRequest:
    """Request of a training.

    Raises:
        ParameterError: An option is out of range, or does not go with another one.
    """

    scene: Annotated[str, argument("Folder of a twin, or a scenario such as push_t.", "TWIN", completes="twin")]
    out: Annotated[Path, option("Folder of run and policy.", "--out", "-o", result="inside")]
    task: Annotated[str | None, option("Task, such as flip.", default="the scene's")] = None
    goals: Annotated[Literal["fixed", "random"], option("Goal of each episode.")] = "fixed"
    goal_reach: Annotated[float, option("Largest x and y of a random goal.", unit="m", ge=0)] = 0.1
    goal_turn: Annotated[float, option("Largest yaw of a random goal.", unit="rad", ge=0, default="π", **_PI)] = math.pi
    tolerance: Annotated[
        float | None, option("Largest distance from the goal in a success.", unit="m", default="the task's")
    ] = None
    turn_tolerance: Annotated[
        float | None, option("Largest angle from the goal in a success.", unit="rad", default="the task's")
    ] = None
    in_scene: Annotated[
        str | None,
        option("Scenario to place the object in.", "--scene", group=DATA, default="its own", completes="scene"),
    ] = None
    delta: Annotated[float, option("Relative half-width of the randomisation.", group=DATA, ge=0, lt=1)] = 0.1
    from_intervals: Annotated[bool, option("Draw parameters from the twin's posterior.", group=DATA)] = False
    friction_floor: Annotated[
        tuple[float, float] | None,
        option(
            "Friction on the floor, per episode.",
            group=DATA,
            metavar="MIN MAX",
            default="the twin's",
        ),
    ] = None
    friction_pusher: Annotated[
        tuple[float, float] | None,
        option(
            "Friction at the pusher, per episode.",
            group=DATA,
            metavar="MIN MAX",
            default="the twin's",
        ),
    ] = None
    teacher: Annotated[
        Path | None, option("Teacher's folder.", group=DATA, default="a new one", completes="policy")
    ] = None
    method: Annotated[
        Literal["distil", "ppo", "state"],
        option("Training method; `state` trains the teacher alone.", group=BUDGET),
    ] = "distil"
    minutes: Annotated[float | None, option("Time budget of the training.", group=BUDGET, unit="min", gt=0)] = None
    target: Annotated[float | None, option("Success rate to stop at.", group=BUDGET, gt=0, le=1)] = None
    worlds: Annotated[int, option("Parallel simulated worlds.", group=BUDGET, ge=1)] = 64
    steps: Annotated[int | None, option("RL steps in all worlds.", group=BUDGET, ge=1, default="by method")] = None
    episodes: Annotated[int | None, option("Episodes per evaluation.", group=BUDGET, ge=1, default="by method")] = None
    threads: Annotated[int | None, option("Torch threads.", group=BUDGET, ge=1, default="one a core")] = None
    resume: Annotated[bool, option("Continue an interrupted run.", group=BUDGET)] = False
    yaw: Annotated[
        float | None,
        option("Largest yaw of the object at the start.", group=LAB, unit="rad", ge=0, default="π/2", **_PI),
    ] = None
    max_translation: Annotated[
        float | None, option("Longest pusher translation in an action.", group=LAB, unit="m", default="the task's")
    ] = None
    latency: Annotated[
        tuple[float, float] | None,
        option(
            "Action delays.",
            group=LAB,
            unit="s",
            metavar="MIN MAX",
            allowed="0 or more, the least first",
            default="the station's or task's",
        ),
    ] = None
    lag: Annotated[
        tuple[float, float],
        option(
            "Time constants of the pusher's velocity.",
            group=LAB,
            unit="s",
            metavar="MIN MAX",
            allowed="0 or more, the least first",
        ),
    ] = (0.0, 0.0)
    acceleration: Annotated[
        float | None, option("Largest acceleration of the pusher.", group=LAB, unit="m/s²", gt=0, default="none")
    ] = None
    station: Annotated[
        Path | None,
        option("File station.yaml of the lab.", group=LAB),
    ] = None
    as_filmed: Annotated[bool, option("Use the camera pose of the twin's video.", group=LAB)] = False
    mask_error: Annotated[float, option("Outline error in training.", group=LAB, unit="px", ge=0, le=1)] = 0.0
    image_size: Annotated[
        int | None,
        option("Size of policy images.", group=LAB, unit="px", ge=1, default="the station's or task's"),
    ] = None
    frames: Annotated[int, option("Images that the policy sees.", group=LAB, ge=1)] = 3
    algorithm: Annotated[
        Literal["sac", "ppo"] | None,
        option("Teacher's RL algorithm.", group=ADVANCED, default="the task's"),
    ] = None
    round_steps: Annotated[
        int | None, option("RL steps between evaluations.", group=ADVANCED, ge=1, default="by method")
    ] = None
    rounds: Annotated[int | None, option("Student's rounds.", group=ADVANCED, ge=1, default="as needed")] = None
    images: Annotated[int | None, option("Student's images in a round.", group=ADVANCED, ge=1, default="as needed")] = (
        None
    )
    updates: Annotated[
        int | None, option("Student's updates in a round.", group=ADVANCED, ge=1, default="as needed")
    ] = None
    shift: Annotated[int | None, option("Random shift of student's images.", group=ADVANCED, unit="px")] = None
    history: Annotated[int | None, option("Past actions seen.", group=ADVANCED, ge=0, default="the task's")] = None
    auxiliary: Annotated[bool, option("Teach PPO to estimate the state as well.", group=ADVANCED)] = True
    device: Annotated[str, option("Device: cpu or cuda.", group=ADVANCED)] = "cpu"
    seed: Annotated[int, option("Random seed.", group=ADVANCED, ge=0)] = 0

    def __post_init__(self) -> None:
        """Check options that depend on each other."""
        from pinwm_drake.tasks.registry import task_names

        if self.device != "cpu":
            from pinwm_drake.learning.weights import require_device

            require_device("--device", self.device)

        draws = task_names("goal_range")
        drawn = self.goals == "fixed" or self.task in (None, *draws)
        require("--goals", f"{self.goals} with task {self.task}", drawn, f"fixed, or random with {', '.join(draws)}")
        for name, (least, most) in (("--latency", self.latency or (0.0, 0.0)), ("--lag", self.lag)):
            require(name, f"{least} to {most}", 0.0 <= least <= most, "0 or more, the least first")
        one = self.acceleration is None or not any(self.lag)
        require("--acceleration", f"{self.acceleration} with --lag {self.lag}", one, "one of the two")
        sized = self.station is None or self.image_size is None
        require("--image-size", f"{self.image_size} with --station", sized, "that of view.size in station.yaml")
        calibrated = self.station is None or not self.as_filmed
        require("--as-filmed", "it with --station", calibrated, "one of the two: a station has a camera of its own")
        learned = self.mask_error == 0.0 or self.method == "distil"
        require("--mask-error", f"{self.mask_error} with method {self.method}", learned, "with method distil")
        require("--no-auxiliary", f"method {self.method}", self.auxiliary or self.method == "ppo", "with method ppo")
        with_teacher = self.teacher is None or self.method == "distil"
        require("--teacher", f"one for method {self.method}", with_teacher, "with method distil")
