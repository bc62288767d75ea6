"""PIN-WM's policies: RL in domains of a twin, from the state, from images, or from images by way of a teacher.

Source: Li et al., "PIN-WM" (RSS 2025), which trains with PPO from images; the teacher, by SAC or PPO, and its
student are this project's.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

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


@dataclass(frozen=True)
class _Trained:
    """Policy that an algorithm trains.

    Attributes:
        options: Settings of the algorithm.
        until: What ends it before its last round.
        device: Device of the networks, as torch names it.
    """

    options: Any
    until: Until = ANY
    device: str = "cpu"


@dataclass(frozen=True)
class StatePpo(_Trained):
    """PPO of a policy that sees the state."""

    options: PpoOptions = field(default_factory=PpoOptions)

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> Policy:
        """Trains the policy in `out/teacher`, and writes it there; see `Method.train`."""
        run, shown = _run(self, make_worlds, out, TEACHER, seed, resume, report), make_worlds.waypoints
        policy = train_ppo(make_worlds.worlds("state"), make_worlds.spec("state"), self.options, run, shown=shown)
        write_policy(run.folder / "policy", policy)
        return policy


@dataclass(frozen=True)
class StateSac(_Trained):
    """SAC of a policy that sees the state."""

    options: SacOptions = field(default_factory=SacOptions)

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> Policy:
        """Trains the policy in `out/teacher`, and writes it there; see `Method.train`."""
        run = _run(self, make_worlds, out, TEACHER, seed, resume, report)
        spec = replace(make_worlds.spec("state"), head="dither", width=_SAC_WIDTH)
        policy = train_sac(make_worlds.worlds("state"), spec, self.options, run)
        write_policy(run.folder / "policy", policy)
        return policy


@dataclass(frozen=True)
class ImagePpo(_Trained):
    """PPO of a policy that sees images, with a critic that sees the state."""

    options: PpoOptions = field(default_factory=PpoOptions.for_images)

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> Policy:
        """Trains the policy in `out/ppo`; see `Method.train`."""
        run = _run(self, make_worlds, out, IMAGES, seed, resume, report)
        return train_ppo(make_worlds.worlds("rgb_state"), make_worlds.spec("rgb"), self.options, run)


@dataclass(frozen=True)
class Distillation:
    """A teacher that sees the state, and a student of images that learns from it.

    Attributes:
        teacher: Training of the teacher; or the folder of a trained one, a policy of the state.
        options: Settings of the distillation.
        until: What ends the training before its last round; of the minutes, a teacher takes half at most.
        device: Device of the networks, as torch names it.
    """

    teacher: StateSac | StatePpo | Path = field(default_factory=StateSac)
    options: DistilOptions = field(default_factory=DistilOptions)
    until: Until = ANY
    device: str = "cpu"

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> Policy:
        """Trains the student in `out/distil`, after its teacher where there is none yet; see `Method.train`."""
        if isinstance(self.teacher, Path):
            teacher = read_policy(self.teacher)
            if teacher.spec.observes != "state":
                raise InputError(self.teacher, value="a policy of images", allowed="one of the state")
        else:
            until = self.until.within(0.5 * self.until.minutes)
            own = replace(self.teacher, until=until, device=self.device)
            teacher = own.train(data, make_worlds, out, seed=seed, resume=resume, report=report)
        spent = 0.0 if isinstance(self.teacher, Path) else minutes_of(out / TEACHER)
        run = replace(
            _run(self, make_worlds, out, STAGE, seed, resume, report),
            until=self.until.within(self.until.minutes - spent),
            about={**make_worlds.about, "teacher": weights_digest(teacher)},
        )
        spec = replace(make_worlds.spec("rgb"), head=teacher.spec.head, width=teacher.spec.width)
        if isinstance(self.teacher, Path) and teacher.spec.history != spec.history:
            raise InputError(
                self.teacher, value=f"one with a history of {teacher.spec.history}", allowed=f"{spec.history}"
            )
        return train_distil(make_worlds.worlds("rgb_state"), teacher, spec, self.options, run)


def _run(
    method: _Trained | Distillation,
    make_worlds: MakeWorlds,
    out: Path,
    stage: str,
    seed: int,
    resume: bool,
    report: Report,
) -> StageRun:
    """Run of a stage of a method's training, in a folder of its name."""
    about, begin = make_worlds.about, make_worlds.begin
    return StageRun(out / stage, stage, seed, about, begin, resume, method.until, method.device, report)
