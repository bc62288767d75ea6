# SPDX-License-Identifier: MIT
"""Forecast of the minutes and the memory of a training, by a brief one of the same kind on this machine."""

import math
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import method_of, worlds_of
from pinwm_drake.learning.distil import DistilOptions
from pinwm_drake.learning.images.window import part_size
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.pin_wm import Distillation, ImagePpo, StatePpo
from pinwm_drake.learning.policy import Policy, make_actor, write_policy
from pinwm_drake.learning.ppo import PpoOptions
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.sac import SacOptions
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.tasks.history import history_size

_BRIEF = 20  # actions and updates between two reports of a brief training, or twice that
_ROLLOUT = 8  # actions of each world in a brief rollout
_BEYOND = 0.05  # of a budget, from which on a forecast is beyond it
_GIB = 1 << 30


@dataclass(frozen=True)
class Forecast:
    """Time and memory of a training that runs through to its last round, or to the end of its budget.

    Attributes:
        minutes: min, of each stage by name.
        memory: GiB, of the process at most.
        budget: min, of all stages; infinite for none. The first round of each is done in any case.
    """

    minutes: dict[str, float]
    memory: float
    budget: float = math.inf

    def __str__(self) -> str:
        total = sum(self.minutes.values())
        if total < 1.0:
            return f"less than a minute and {self.memory:.1f} GiB of memory"
        stages = " and ".join(f"{name} {minutes:.0f}" for name, minutes in self.minutes.items())
        more = ""
        if total > self.budget * (1.0 + _BEYOND):
            more = f"; one round of each stage takes more than --minutes {self.budget:g}, and is done in any case"
        return f"up to {total:.0f} minutes ({stages}) and {self.memory:.1f} GiB of memory{more}"


def forecast(request: TrainRequest, report: Callable[[float], None] = lambda share: None) -> Forecast:
    """Forecast by one brief round of every stage, with the worlds and networks of the training itself.

    A budget of minutes limits it as it limits the training.

    The search of plans for waypoints, where a task has them, is not counted.

    Args:
        request: The training.
        report: Called with the share of the brief rounds that is done.

    Raises:
        PinwmError: An option is out of range, or the scene cannot be read.
    """
    if request.threads is not None:
        torch.set_num_threads(request.threads)
    worlds = worlds_of(request)
    method: Any = method_of(request, worlds.setup.task)
    stages = [method]
    if isinstance(method, Distillation):
        stages = [method] if isinstance(method.teacher, Path) else [method.teacher, method]
    minutes, kept, W = dict[str, float](), 0.0, request.worlds
    budget = math.inf if request.minutes is None else request.minutes
    for number, stage in enumerate(stages):
        clock = _Clock(partial(_tell, report, number, len(stages)))
        with TemporaryDirectory() as folder:
            brief = _brief(stage, W)
            if isinstance(brief, Distillation) and not isinstance(brief.teacher, Path):
                teacher, spec = Path(folder) / "untrained", worlds.spec("state")
                write_policy(teacher, Policy(spec, make_actor(spec)))
                brief = replace(brief, teacher=teacher)
            brief.train(MethodData(), worlds, Path(folder), seed=0, resume=False, report=clock)
        left = budget - sum(minutes.values()) if number + 1 == len(stages) else 0.5 * budget  # as a teacher has it
        minutes[clock.stage] = within(left, clock.seconds(stage, W) / 60.0, clock.rounds(stage))
        if not isinstance(stage, StatePpo):  # whose rollouts hold no images
            kept = max(kept, _kept(stage.options, worlds.spec("rgb"), W))
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return Forecast(minutes, (used + kept) / _GIB, budget)


def within(budget: float, minutes: float, rounds: int) -> float:
    """Minutes of a stage that ends with its budget, but not before its first round.

    Args:
        budget: min, that the stage may take.
        minutes: min, of all rounds.
        rounds: Number of rounds, 1 or more.
    """
    return min(minutes, max(budget, minutes / rounds))


def _tell(report: Callable[[float], None], number: int, stages: int, done: float) -> None:
    report((number + done) / stages)


class _Clock:
    def __init__(self, report: Callable[[float], None] = lambda share: None) -> None:
        self.stage = ""
        self._times: list[tuple[float, int]] = []
        self._report = report

    def __call__(self, step: Step) -> None:
        self.stage = step.stage
        self._times.append((time.monotonic(), step.steps))
        self._report(step.done)

    def seconds(self, stage: Any, worlds: int) -> float:
        """Time [s] of all rounds of a stage, from the brief one."""
        times, options = [t for t, _ in self._times], stage.options
        evaluation = (times[-1] - times[-2]) * options.episodes / worlds
        if isinstance(options, DistilOptions):
            # It reports at first, after 10 and 20 actions, after 10 and 20 updates, and at the end.
            action, update = (2.0 * (times[k + 1] - times[k]) / _BRIEF for k in (1, 3))
            collecting = options.round_images / worlds * action
            return float(options.rounds * (collecting + options.updates * update + evaluation))
        (begun, first), (ended, last) = self._times[-3], self._times[-2]
        return float(options.steps * (ended - begun) / (last - first) + self.rounds(stage) * evaluation)

    @staticmethod
    def rounds(stage: Any) -> int:
        """Number of rounds of a stage at most."""
        options = stage.options
        return int(options.rounds if isinstance(options, DistilOptions) else -(-options.steps // options.round_steps))


def _brief(stage: Any, worlds: int) -> Any:
    options: Any = stage.options
    if isinstance(stage, Distillation):
        few = {"rounds": 1, "round_images": _BRIEF * worlds, "updates": _BRIEF, "episodes": worlds}
        return replace(stage, options=replace(options, **few))
    steps = 2 * _BRIEF * worlds
    if isinstance(stage, StatePpo | ImagePpo):
        options, steps = replace(options, n_steps=_ROLLOUT), 2 * _ROLLOUT * worlds
    return replace(stage, options=replace(options, steps=steps, round_steps=steps, episodes=worlds))


def _kept(options: SacOptions | PpoOptions | DistilOptions, spec: PolicySpec, worlds: int) -> float:
    """Bytes that a stage keeps to learn from when it is full."""
    height, width, channels = spec.image_shape
    if isinstance(options, SacOptions):
        state = history_size(spec.task.state_size, spec.action_size, spec.history)
        numbers = 2 * state + spec.action_size + 3
        return 4.0 * numbers * min(options.steps, options.buffer_size)
    if isinstance(options, DistilOptions):
        height, width = part_size(spec)
        return 3.0 * height * width * min(options.rounds * options.round_images, options.keep)
    return 1.0 * options.n_steps * worlds * height * width * channels
