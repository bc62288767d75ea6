"""Cells of policies, and of their evaluations in a plant that none was trained in."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.evaluation.request import MPC as EVALUATED_MPC
from pinwm_drake.experiments.evaluation.request import RANDOM, EvaluateRequest
from pinwm_drake.experiments.evaluation.run import SUMMARY_FILE, EvaluationProgress, evaluate
from pinwm_drake.experiments.reproduce.cell import Cell, Say
from pinwm_drake.experiments.reproduce.scenes import task_scene
from pinwm_drake.experiments.reproduce.systems import MPC, SCENE, system
from pinwm_drake.experiments.reproduce.twins import TwinCell
from pinwm_drake.experiments.training import TrainRequest, train
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.progress import Step

_QUICK: dict[str, Any] = {
    "worlds": 8,
    "steps": 512,
    "round_steps": 512,
    "rounds": 1,
    "images": 256,
    "updates": 20,
    "episodes": 8,
}


@dataclass(frozen=True)
class PolicyCell:
    """Cell of a policy that a system trains.

    Attributes:
        task: Name of the task's scene.
        system: Name of the system.
        seed: Seed of the experiment.
        twin: Cell of the twin that it is trained in; None for the scene's own parameters.
        quick: Flag: hardly any training.
    """

    task: str
    system: str
    seed: int
    twin: TwinCell | None
    quick: bool = False

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"policies/{self.task}/{self.system}/seed-{self.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The twin, where there is one."""
        return () if self.twin is None else (self.twin,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return 0.02 if self.quick else 0.45

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains the policy; see `Cell.make`."""
        scene, trained = task_scene(self.task), system(self.system)
        assert trained.domains is not None
        request = TrainRequest(
            scene=scene.scene if self.twin is None else str(root / self.twin.key),
            in_scene=None if self.twin is None else scene.scene,
            out=prepare_folder(root / self.key),
            task=scene.task,
            seed=self.seed,
            threads=1,
            resume=True,
            **(_QUICK if self.quick else {}),
        )
        told: dict[str, Step] = {}

        def report(step: Step) -> None:
            if step.success == step.success and (step.stage not in told or told[step.stage].success != step.success):
                say(f"{step.stage} {step.done:.0%}, success {step.success:.0%} in {step.length:.0f} actions")
            told[step.stage] = step

        train(request, domains=trained.domains(scene, self.seed), report=report)
        return {name: {"steps": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()}


@dataclass(frozen=True)
class EvaluationCell:
    """Cell of an evaluation in Drake's hydroelastic plant with VTK's images.

    Attributes:
        task: Name of the task's scene.
        system: Name of the system.
        seed: Seed of the experiment.
        episodes: Number of episodes.
        subject: Cell of the policy; for what plans of the twin to plan with, for chance None.
        max_steps: Number of actions of an episode; None for the task's.
    """

    task: str
    system: str
    seed: int
    episodes: int
    subject: PolicyCell | TwinCell | None
    max_steps: int | None = None

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"evaluations/{self.task}/{self.system}/seed-{self.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The policy or twin, where there is one."""
        return () if self.subject is None else (self.subject,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * (self.max_steps or 30) * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Runs the episodes; see `Cell.make`."""
        scene = task_scene(self.task)
        subject = None if self.subject is None else str(root / self.subject.key)
        given: dict[str, Any] = {"policy": subject}
        if not isinstance(self.subject, PolicyCell):
            given = {"policy": EVALUATED_MPC if self.system == MPC else RANDOM, "model": subject, "task": scene.task}
        request = EvaluateRequest(scene=scene.scene, episodes=self.episodes, max_steps=self.max_steps, **given)

        def progress(now: EvaluationProgress) -> None:
            if now.evaluation is not None and now.drawn is None and now.done % 10 == 0:
                say(f"{now.done} of {now.total} episodes, success {now.evaluation.success_rate:.0%}")

        out = root / self.key
        evaluate(request, out, workers=1, resume=True, progress=progress)
        results: dict[str, Any] = json.loads((out / SUMMARY_FILE).read_text(encoding="utf-8"))["results"]
        return results


def evaluated(
    task: str, name: str, seed: int, episodes: int, twin: TwinCell, *, quick: bool, max_steps: int | None = None
) -> EvaluationCell:
    """Cell of the evaluation of a system, with those that it needs.

    Args:
        task: Name of the task's scene.
        name: Name of the system.
        seed: Seed of the experiment.
        episodes: Number of episodes.
        twin: Cell of the twin of the system's identification.
        quick: Flag: hardly any training.
        max_steps: Number of actions of an episode; None for the task's.
    """
    about = system(name)
    used = None if about.twin == SCENE else twin
    subject = used if about.domains is None else PolicyCell(task, name, seed, used, quick)
    return EvaluationCell(task, name, seed, episodes, subject, max_steps)
