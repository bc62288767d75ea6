"""Trainings of the trial, each judged by the same evaluation: success and actions against steps and CPU minutes."""

import csv
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.short_horizon.learner import Learner, LearnerOptions
from benchmarks.short_horizon.networks import teacher_spec
from benchmarks.short_horizon.worlds import PushWorlds
from pinwm_drake.files import replacing
from pinwm_drake.learning.policy import Policy
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.rounds import EVALUATION_SEED, HISTORY_FILE
from pinwm_drake.learning.sac import SacOptions, train_sac
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds

WORLDS = 64
SETTINGS = {
    "horizon 8": LearnerOptions(horizon=8, arrival=True, noise=0.3),
    "horizon 8, loud": LearnerOptions(horizon=8, gamma=0.98, arrival=True, noise=0.6, entropy=0.001),
    "horizon 4, loud": LearnerOptions(horizon=4, gamma=0.98, arrival=True, noise=0.6, entropy=0.001),
    "horizon 16, loud": LearnerOptions(arrival=True, noise=0.6, entropy=0.003),
    "horizon 16, loud, bonus as a reward": LearnerOptions(noise=0.6, entropy=0.003),
    "half zeroth order": LearnerOptions(horizon=8, gamma=0.98, arrival=True, noise=0.6, entropy=0.001, share=0.5),
    "zeroth order alone": LearnerOptions(horizon=8, gamma=0.98, arrival=True, noise=0.6, entropy=0.001, share=0.0),
}


@dataclass(frozen=True)
class Row:
    """An evaluation in the course of a training.

    Attributes:
        steps: Number of actions of all worlds so far.
        success: Share of the evaluation's episodes that succeeded.
        length: Mean number of actions of those episodes.
        seconds: s of the CPU since the training began, evaluations included.
        noise: Standard deviation of the actions, before the tanh; NaN of SAC.
        norm: Median norm of the actor's gradient since the last evaluation; NaN of SAC.
        skipped: Number of updates that were left out so far.
        failures: Number of actions so far whose physics found no solution.
    """

    steps: int
    success: float
    length: float
    seconds: float
    noise: float = float("nan")
    norm: float = float("nan")
    skipped: int = 0
    failures: int = 0


@dataclass(frozen=True)
class Budget:
    """End of a training, and its evaluations.

    Attributes:
        minutes: min of the CPU, after which a training ends.
        steps: Number of actions of all worlds, after which it ends; learning rates fall towards it.
        round_steps: Number of actions between two evaluations.
        episodes: Number of episodes in an evaluation.
    """

    minutes: float = 10.0
    steps: int = 1_600_000
    round_steps: int = 40_000
    episodes: int = 128


def train_short(training: TrainingWorlds, options: LearnerOptions, budget: Budget, path: Path, seed: int) -> Learner:
    """Trains by gradient through the step, with a line and a row in a CSV file for each evaluation."""
    began, rows, norms = time.process_time(), [], []
    torch.manual_seed(seed)
    env, spec, worlds = training.worlds("state"), teacher_spec(training), PushWorlds(training, WORLDS, seed)
    learner = Learner(worlds, spec, options)
    due = budget.round_steps
    while learner.steps < budget.steps and time.process_time() - began < 60.0 * budget.minutes:
        norms.append(learner.update(1.0 - learner.steps / budget.steps)["norm"])
        if learner.steps < due:
            continue
        due += budget.round_steps
        found = evaluate_worlds(env, Policy(spec, learner.actor), budget.episodes, seed=EVALUATION_SEED)
        noise, norm = float(learner.actor.log_std.detach().exp().mean()), float(np.nanmedian(norms))
        seconds = time.process_time() - began
        rows.append(
            Row(
                learner.steps,
                found.success_rate,
                found.mean_steps,
                seconds,
                noise,
                norm,
                learner.skipped,
                worlds.failures,
            )
        )
        norms.clear()
        _write(path, rows)
        _say(path.stem, rows[-1])
    return learner


def train_control(training: TrainingWorlds, budget: Budget, path: Path, folder: Path, seed: int) -> None:
    """Trains with SAC as `pinwm train` does, with the same line and row for each evaluation."""
    began, seconds = time.process_time(), {}

    def report(step: Step) -> None:
        seconds[step.steps] = time.process_time() - began

    options = SacOptions(
        steps=min(SacOptions().steps, budget.steps), round_steps=budget.round_steps, episodes=budget.episodes
    )
    train_sac(
        training.worlds("state"),
        replace(teacher_spec(training), head="dither"),
        folder,
        options,
        stage="teacher",
        seed=seed,
        about=training.about,
        on_round=training.begin,
        report=report,
    )
    history = csv.DictReader((folder / HISTORY_FILE).read_text().splitlines())
    rounds = [(int(one["steps"]), float(one["success"]), float(one["length"])) for one in history]
    rows = [Row(*one, seconds[one[0]]) for one in rounds]
    _write(path, rows)
    for row in rows:
        _say(path.stem, row)


def read_rows(path: Path) -> list[Row]:
    """Rows of a training that was written."""
    with path.open(newline="") as file:
        return [
            Row(
                int(one["steps"]),
                *(float(one[name]) for name in ("success", "length", "seconds", "noise", "norm")),
                int(one["skipped"]),
                int(one["failures"]),
            )
            for one in csv.DictReader(file)
        ]


def _write(path: Path, rows: list[Row]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def _say(name: str, row: Row) -> None:
    more = f"noise {row.noise:.2f}, |g| {row.norm:.3g}, {row.skipped} left out, {row.failures} failures"
    print(
        f"{name}: {row.steps:,} steps, {row.seconds:.0f} s, {100 * row.success:.0f} % in {row.length:.1f}; {more}",
        flush=True,
    )
