# SPDX-License-Identifier: MIT
"""PIN-WM's policies: RL in domains of a twin, from the state, from images, or from images by way of a teacher.

Source: Li et al., "PIN-WM" (RSS 2025), which trains with PPO from images; the teacher, by SAC or PPO, and its
student are this project's.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from pinwm_drake.errors import InputError
from pinwm_drake.learning.distil import STAGE, DistilOptions, train_distil
from pinwm_drake.learning.method import MakeWorlds, MethodData
from pinwm_drake.learning.policy import Policy, read_policy, weights_digest, write_policy
from pinwm_drake.learning.ppo import PpoOptions, train_ppo
from pinwm_drake.learning.progress import Report
from pinwm_drake.learning.rounds import ANY, StageRun, Until, minutes_of
from pinwm_drake.learning.sac import SacOptions, train_sac

TEACHER, IMAGES = "teacher", "ppo"  # folders of stages, beside STAGE of the distillation
STAGES = (TEACHER, STAGE, IMAGES)
_SAC_WIDTH = 128  # of networks: an update on 512 steps takes 10 ms, where it takes 25 ms with 256


class _Staged:
    stage: ClassVar[str]
    until: Until
    device: str

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> Policy:
        """Trains the policy in a folder of `out` with the name of the stage; see `Method.train`."""
        folder, about, begin = out / self.stage, make_worlds.about, make_worlds.begin
        run = StageRun(folder, self.stage, seed, about, begin, resume, self.until, self.device, report)
        return self._train(data, make_worlds, run)

    def _train(self, data: MethodData, make_worlds: MakeWorlds, run: StageRun) -> Policy:
        raise NotImplementedError


@dataclass(frozen=True)
class _Trained(_Staged):
    options: Any
    until: Until = ANY
    device: str = "cpu"


@dataclass(frozen=True)
class StatePpo(_Trained):
    """PPO of a policy that sees the state; it is written beside its checkpoints, too."""

    stage = TEACHER
    options: PpoOptions = field(default_factory=PpoOptions)

    def _train(self, data: MethodData, make_worlds: MakeWorlds, run: StageRun) -> Policy:
        worlds, spec, shown = make_worlds.worlds("state"), make_worlds.spec("state"), make_worlds.waypoints
        policy = train_ppo(worlds, spec, self.options, run, shown=shown)
        write_policy(run.folder / "policy", policy)
        return policy


@dataclass(frozen=True)
class StateSac(_Trained):
    """SAC of a policy that sees the state; it is written beside its checkpoints, too."""

    stage = TEACHER
    options: SacOptions = field(default_factory=SacOptions)

    def _train(self, data: MethodData, make_worlds: MakeWorlds, run: StageRun) -> Policy:
        spec = replace(make_worlds.spec("state"), head="dither", width=_SAC_WIDTH)
        policy = train_sac(make_worlds.worlds("state"), spec, self.options, run)
        write_policy(run.folder / "policy", policy)
        return policy


@dataclass(frozen=True)
class ImagePpo(_Trained):
    """PPO of a policy that sees images, with a critic that sees the state."""

    stage = IMAGES
    options: PpoOptions = field(default_factory=PpoOptions.for_images)

    def _train(self, data: MethodData, make_worlds: MakeWorlds, run: StageRun) -> Policy:
        return train_ppo(make_worlds.worlds("rgb_state"), make_worlds.spec("rgb"), self.options, run)


def read_teacher(folder: Path, history: int) -> Policy:
    """Read the policy that teaches a student with a history of this many actions.

    Raises:
        InputError: It cannot be read, sees images, or has another history.
    """
    teacher = read_policy(folder)
    if teacher.spec.observes != "state":
        raise InputError(folder, value="a policy of images", allowed="one of the state")
    if (own := teacher.spec.history) != history:
        raise InputError(folder, value=f"one with a history of {own}", allowed=f"{history}")
    return teacher


@dataclass(frozen=True)
class Distillation(_Staged):
    """A teacher that sees the state, which is trained where there is none yet, and a student of images.

    Attributes:
        teacher: Training of the teacher; or the folder of a trained one, a policy of the state.
        options: Settings of the distillation.
        until: What ends the training before its last round; of the minutes, a teacher takes half at most.
        device: Device of the networks, as torch names it.
    """

    stage = STAGE
    teacher: StateSac | StatePpo | Path = field(default_factory=StateSac)
    options: DistilOptions = field(default_factory=DistilOptions)
    until: Until = ANY
    device: str = "cpu"

    def _train(self, data: MethodData, make_worlds: MakeWorlds, run: StageRun) -> Policy:
        spec, spent = make_worlds.spec("rgb"), 0.0
        if isinstance(self.teacher, Path):
            teacher = read_teacher(self.teacher, spec.history)
        else:
            out, until = run.folder.parent, self.until.within(0.5 * self.until.minutes)
            own = replace(self.teacher, until=until, device=self.device)
            teacher = own.train(data, make_worlds, out, seed=run.seed, resume=run.resume, report=run.report)
            spent = minutes_of(out / TEACHER)
        about = {**make_worlds.about, "teacher": weights_digest(teacher)}
        run = replace(run, until=self.until.within(self.until.minutes - spent), about=about)
        spec = replace(spec, head=teacher.spec.head, width=teacher.spec.width)
        return train_distil(make_worlds.worlds("rgb_state"), teacher, spec, self.options, run)
