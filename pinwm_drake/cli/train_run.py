"""What `pinwm train` does: one or two stages of training with a progress bar, and the policy at the end."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.distil import STAGE, DistilOptions, train_distil
from pinwm_drake.learning.policy import POLICY_FILE, Policy, read_policy, weights_digest, write_policy
from pinwm_drake.learning.ppo import PpoOptions, train_ppo
from pinwm_drake.learning.progress import Report, Step
from pinwm_drake.learning.rounds import CHECKPOINT_FILE, HISTORY_FILE
from pinwm_drake.learning.spec import Observes
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.tasks.push import PushTask

METHODS = ("distil", "ppo", "state")
_FIGURE = "training.png"


@dataclass(frozen=True)
class TrainRequest:
    """The options of `pinwm train`, as it describes them.

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
        """Checks what nothing else does."""
        if self.task != "push":
            raise ParameterError(f"--task: got {self.task!r}; allowed: push")
        if self.method not in METHODS:
            raise ParameterError(f"--method: got {self.method!r}; allowed: {', '.join(METHODS)}")
        for name in ("worlds", "threads", "steps", "round_steps", "rounds", "images"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ParameterError(f"--{name.replace('_', '-')}: got {value}; allowed: 1 or more")
        if self.seed < 0:
            raise ParameterError(f"--seed: got {self.seed}; allowed: 0 or more")
        if self.yaw is not None and not 0.0 <= self.yaw <= math.pi + 1e-9:
            raise ParameterError(f"--yaw: got {self.yaw}; allowed: 0 to pi")
        if self.teacher is not None and self.method != "distil":
            raise ParameterError(f"--teacher: got one for method {self.method}; allowed: with method distil")


def run_train(request: TrainRequest) -> None:
    """Trains a policy and writes it.

    Args:
        request: What is asked for.

    Raises:
        PinwmError: An option is out of range, the scene cannot be read, or a file cannot be written.
        SystemExit: With 1, when the user interrupts (Ctrl-C).
    """
    console, out = Console(), prepare_folder(request.out)
    stages = [out / stage for stage in ("teacher", "distil", "ppo")]
    if not request.resume and any((stage / CHECKPOINT_FILE).exists() for stage in stages):
        raise InputError(out, value="a training that was begun", allowed="a new folder, or --resume to go on")
    if request.threads is not None:
        torch.set_num_threads(request.threads)
    worlds = _training_worlds(request)
    begun = time.monotonic()
    try:
        with _bar(console) as bar:
            policy = _train(request, worlds, bar)
    except KeyboardInterrupt:
        console.print(f"interrupted; go on with --resume (rounds that are done are in {out})")
        raise SystemExit(1) from None
    figure = training_figure(
        out / _FIGURE, {stage.name: stage / HISTORY_FILE for stage in stages if (stage / HISTORY_FILE).exists()}
    )
    provenance = {
        "task": request.task,
        "method": request.method,
        "trained_in": worlds.about,
        "seed": request.seed,
        "worlds": request.worlds,
        "time": timestamp(),
        "versions": versions(),
    }
    write_policy(out, replace(policy, provenance=provenance))
    minutes = (time.monotonic() - begun) / 60
    console.print(f"trained for {minutes:.1f} minutes in this run; wrote {figure}", highlight=False, soft_wrap=True)
    console.print(
        f"wrote {out / POLICY_FILE}; try it with: pinwm evaluate {out} --engine hydroelastic",
        highlight=False,
        soft_wrap=True,
    )


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


def _train(request: TrainRequest, worlds: TrainingWorlds, bar: Progress) -> Policy:
    """The stages of a method, one after the other."""
    common: dict[str, Any] = {"seed": request.seed, "on_round": worlds.begin, "resume": request.resume}
    if request.method == "ppo":
        return _ppo(request, worlds, bar, "ppo", "rgb", PpoOptions.for_images(), common)
    teacher = _teacher(request, worlds, bar, common)
    if request.method == "state":
        return teacher
    env = worlds.worlds("rgb_state")
    with _task(bar, STAGE) as report:
        return train_distil(
            env,
            teacher,
            worlds.spec(env, "rgb"),
            request.out / STAGE,
            _with(DistilOptions(), rounds=request.rounds, round_images=request.images, shift=request.shift),
            about=worlds.about | {"teacher": weights_digest(teacher)},
            report=report,
            **common,
        )


def _teacher(request: TrainRequest, worlds: TrainingWorlds, bar: Progress, common: dict[str, Any]) -> Policy:
    """A policy of the state: trained, or read."""
    if request.teacher is not None:
        teacher = read_policy(request.teacher)
        if teacher.spec.observes != "state":
            raise InputError(request.teacher, value="a policy of images", allowed="one of the state")
        return teacher
    teacher = _ppo(request, worlds, bar, "teacher", "state", PpoOptions(), common)
    write_policy(request.out / "teacher" / "policy", teacher)
    return teacher


def _ppo(
    request: TrainRequest,
    worlds: TrainingWorlds,
    bar: Progress,
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
    with _task(bar, stage) as report:
        return train_ppo(
            env, spec, request.out / stage, options, stage=stage, about=worlds.about, report=report, **common
        )


def _with(options: Any, **values: Any) -> Any:
    """Options with those values that are given."""
    return replace(options, **{name: value for name, value in values.items() if value is not None})


def _bar(console: Console) -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:.0f} %  {task.fields[figures]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console)


@contextmanager
def _task(bar: Progress, stage: str) -> Iterator[Report]:
    """A line of the bar, which a stage tells where it stands."""
    task = bar.add_task(stage, total=1.0, figures="getting ready (the first run compiles for minutes)")

    def report(step: Step) -> None:
        figures = f"{step.steps:,} steps  loss {step.loss:.4f}  success {step.success:.0%} in {step.length:.0f}"
        bar.update(task, completed=step.done, figures=f"{figures}  best {step.best:.0%}")

    yield report
