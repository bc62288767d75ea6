"""The training of a policy in the cousins of a twin, in one or two stages, with all files that it leaves."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from pinwm_drake.errors import InputError, require
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.distil import STAGE, DistilOptions, train_distil
from pinwm_drake.learning.policy import Policy, read_policy, weights_digest, write_policy
from pinwm_drake.learning.ppo import PpoOptions, train_ppo
from pinwm_drake.learning.progress import Report, silent
from pinwm_drake.learning.rounds import CHECKPOINT_FILE, HISTORY_FILE
from pinwm_drake.learning.spec import Observes
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.tasks.push import PushTask

METHODS = ("distil", "ppo", "state")
FIGURE_FILE = "training.png"
_STAGES = ("teacher", "distil", "ppo")


@dataclass(frozen=True)
class TrainRequest:
    """A training, named and in units as the options of `pinwm train`, which describes them.

    Raises:
        ParameterError: An option is none of those allowed.
    """

    scene: str
    out: Path
    task: str = "push"
    method: str = "distil"
    delta: float = 0.1
    from_intervals: bool = False
    yaw: float | None = None
    tolerance: float = PushTask.tolerance
    turn_tolerance: float = PushTask.turn_tolerance
    seed: int = 0
    worlds: int = 64
    image_size: int = 64
    frames: int = 3
    max_translation: float = 0.02
    steps: int | None = None
    round_steps: int | None = None
    rounds: int | None = None
    images: int | None = None
    shift: int | None = None
    teacher: Path | None = None
    threads: int | None = None
    resume: bool = False

    def __post_init__(self) -> None:
        """Checks the options that nothing else checks."""
        require("--task", repr(self.task), self.task == "push", "push")
        require("--method", repr(self.method), self.method in METHODS, ", ".join(METHODS))
        for name in ("worlds", "threads", "steps", "round_steps", "rounds", "images"):
            value = getattr(self, name)
            require(f"--{name.replace('_', '-')}", value, value is None or value >= 1, "1 or more")
        require("--seed", self.seed, self.seed >= 0, "0 or more")
        require("--yaw", self.yaw, self.yaw is None or 0.0 <= self.yaw <= math.pi + 1e-9, "0 to pi")
        with_teacher = self.teacher is None or self.method == "distil"
        require("--teacher", f"one for method {self.method}", with_teacher, "with method distil")


def train(request: TrainRequest, *, report: Report = silent) -> Policy:
    """Trains a policy and writes it to `request.out`, with checkpoints, `training.png` and each stage's history.

    A run that was interrupted or killed goes on with `request.resume`.

    Args:
        request: The training.
        report: Called with where the training stands.

    Returns:
        The best policy, with its provenance.

    Raises:
        PinwmError: An option is out of range, the scene cannot be read, or a file cannot be written.
    """
    out = prepare_folder(request.out)
    stages = [out / stage for stage in _STAGES]
    if not request.resume and any((stage / CHECKPOINT_FILE).exists() for stage in stages):
        raise InputError(out, value="a training that was begun", allowed="a new folder, or --resume to go on")
    if request.threads is not None:
        torch.set_num_threads(request.threads)
    worlds = _training_worlds(request)
    policy = _train(request, worlds, report)
    histories = {stage.name: stage / HISTORY_FILE for stage in stages if (stage / HISTORY_FILE).exists()}
    training_figure(out / FIGURE_FILE, histories)
    policy = replace(policy, provenance=_provenance(request, worlds))
    write_policy(out, policy)
    return policy


def _provenance(request: TrainRequest, worlds: TrainingWorlds) -> dict[str, Any]:
    return {
        "task": request.task,
        "method": request.method,
        "trained_in": worlds.about,
        "seed": request.seed,
        "worlds": request.worlds,
        "time": timestamp(),
        "versions": versions(),
    }


def _training_worlds(request: TrainRequest) -> TrainingWorlds:
    return TrainingWorlds(
        request.scene,
        num_worlds=request.worlds,
        image_size=request.image_size,
        frames=request.frames,
        max_translation=request.max_translation,
        delta=request.delta,
        from_intervals=request.from_intervals,
        seed=request.seed,
        yaw=request.yaw,
        tolerance=request.tolerance,
        turn_tolerance=request.turn_tolerance,
    )


def _train(request: TrainRequest, worlds: TrainingWorlds, report: Report) -> Policy:
    """The stages of a method, one after the other."""
    common: dict[str, Any] = {
        "seed": request.seed,
        "on_round": worlds.begin,
        "resume": request.resume,
        "report": report,
    }
    if request.method == "ppo":
        return _ppo(request, worlds, "ppo", "rgb", PpoOptions.for_images(), common)
    teacher = _teacher(request, worlds, common)
    if request.method == "state":
        return teacher
    env = worlds.worlds("rgb_state")
    return train_distil(
        env,
        teacher,
        worlds.spec(env, "rgb"),
        request.out / STAGE,
        _with(DistilOptions(), rounds=request.rounds, round_images=request.images, shift=request.shift),
        about=worlds.about | {"teacher": weights_digest(teacher)},
        **common,
    )


def _teacher(request: TrainRequest, worlds: TrainingWorlds, common: dict[str, Any]) -> Policy:
    """A policy of the state: trained, or read."""
    if request.teacher is not None:
        teacher = read_policy(request.teacher)
        if teacher.spec.observes != "state":
            raise InputError(request.teacher, value="a policy of images", allowed="one of the state")
        return teacher
    teacher = _ppo(request, worlds, "teacher", "state", PpoOptions(), common)
    write_policy(request.out / "teacher" / "policy", teacher)
    return teacher


def _ppo(
    request: TrainRequest,
    worlds: TrainingWorlds,
    stage: str,
    observes: Observes,
    options: PpoOptions,
    common: dict[str, Any],
) -> Policy:
    """A stage of PPO; `shift` is of images only."""
    env = worlds.worlds("rgb_state" if observes == "rgb" else "state")
    options = _with(options, steps=request.steps, round_steps=request.round_steps)
    if observes == "rgb":
        options = _with(options, shift=request.shift)
    spec = worlds.spec(env, observes)
    return train_ppo(env, spec, request.out / stage, options, stage=stage, about=worlds.about, **common)


def _with(options: Any, **values: Any) -> Any:
    """Options with those values that are given."""
    return replace(options, **{name: value for name, value in values.items() if value is not None})
