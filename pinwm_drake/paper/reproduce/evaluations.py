"""Cells of evaluations in a plant that no policy was trained in."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.evaluation.run import SUMMARY_FILE, EvaluationProgress, evaluate
from pinwm_drake.experiments.requests.evaluate import MPC as EVALUATED_MPC
from pinwm_drake.experiments.requests.evaluate import RANDOM, EvaluateRequest
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.policies import DemonstrationsCell, DiffusionCell, PolicyCell, dreamer
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.scenes import SceneCell
from pinwm_drake.paper.reproduce.systems import (
    DIFFUSION,
    DREAMER,
    MPC,
    RANDOM_ACTIONS,
    SCENE,
    SYSTEMS,
    TRUE_THETA,
)
from pinwm_drake.paper.reproduce.twins import twin_cell

_DEMONSTRATIONS = 100
_SECONDS = {"push": 20.0, "flip": 9.0}  # of an episode, by task, the mean of the rows in docs/tables.md


@dataclass(frozen=True)
class EvaluationCell(SceneCell):
    """Cell of an evaluation in Drake's hydroelastic plant with VTK's images.

    Attributes:
        system: Name of the system.
        episodes: Number of episodes.
        subject: Cell of the policy; for what plans of the twin to plan with, for chance None.
        max_steps: Number of actions of an episode; None for the task's.
        inside: Path of the policy in its cell's folder.
    """

    system: str
    episodes: int
    subject: Cell | None
    max_steps: int | None = None
    inside: str = ""

    @property
    def key(self) -> str:
        """Path of its folder."""
        kind = "stand-in" if self.stand_in else "evaluations"
        return f"{kind}/{self.task}/{self.system}/seed-{self.seed}"

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        known = _SECONDS[self.scene.task]
        return self.episodes * (known if self.max_steps is None else 0.5 * self.max_steps) / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Runs the episodes; see `Cell.make`."""
        scene = self.scene
        subject = None if self.subject is None else str(root / self.subject.key / self.inside)
        given: dict[str, Any] = {"policy": subject}
        if self.system in (MPC, RANDOM_ACTIONS):
            given = {"policy": EVALUATED_MPC if self.system == MPC else RANDOM, "model": subject, "task": scene.task}
        request = EvaluateRequest(
            scene=scene.scene, episodes=self.episodes, max_steps=self.max_steps, stand_in=self.stand_in, **given
        )

        def progress(now: EvaluationProgress) -> None:
            if now.evaluation is not None and now.drawn is None and now.done % 10 == 0:
                say(f"{now.done} of {now.total} episodes, success {now.evaluation.success_rate:.0%}")

        out = root / self.key
        evaluate(request, out, workers=1, resume=True, progress=progress)
        results: dict[str, Any] = json.loads((out / SUMMARY_FILE).read_text(encoding="utf-8"))["results"]
        return results


def evaluated(request: ReproduceRequest, task: str, name: str, seed: int, *, stand_in: bool = False) -> EvaluationCell:
    """Cell of the evaluation of a system in a task's scene, with those that it needs.

    In the stand-in for a robot, it is filmed, identified and trained there too.
    """
    about, quick = SYSTEMS[name], request.quick
    twin, inside = None if about.twin == SCENE else twin_cell(request, task, seed, about.twin, stand_in=stand_in), ""
    subject: Cell | None = twin
    if name == DIFFUSION:
        expert = PolicyCell(task, seed, TRUE_THETA, None, quick, stand_in=stand_in)
        subject = DiffusionCell(DemonstrationsCell(expert, 2 if quick else _DEMONSTRATIONS), quick)
        inside = "policy"
    elif name == DREAMER:
        subject = dreamer(task, seed, quick, stand_in=stand_in)
    elif about.domains is not None:
        subject = PolicyCell(task, seed, name, twin, quick, about.history, stand_in=stand_in)
    return EvaluationCell(task, seed, name, request.episodes, subject, request.max_steps, inside, stand_in=stand_in)
