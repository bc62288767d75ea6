# SPDX-License-Identifier: MIT
"""Cells of policies, of the episodes that some of them learn from, and of their evaluations in a plant."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from pinwm_drake.documents import read_json
from pinwm_drake.experiments.evaluation.run import SUMMARY_FILE, EvaluationProgress, evaluate
from pinwm_drake.experiments.requests.evaluate import MPC as EVALUATED_MPC
from pinwm_drake.experiments.requests.evaluate import RANDOM, EvaluateRequest
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import FIGURE_FILE, quickest_device, train, worlds_of
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import Acts
from pinwm_drake.learning.method import Method, MethodData
from pinwm_drake.learning.pin_wm import TEACHER
from pinwm_drake.learning.policy import read_policy, weights_digest
from pinwm_drake.learning.progress import Report, Step
from pinwm_drake.learning.rounds import HISTORY_FILE
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.paper.baselines.diffusion.actor import write_actor
from pinwm_drake.paper.baselines.diffusion.demonstrations import collect_demonstrations
from pinwm_drake.paper.baselines.diffusion.method import STAGE, DiffusionPolicy
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions
from pinwm_drake.paper.baselines.dreamer.episodes import collect, random_pushes
from pinwm_drake.paper.baselines.dreamer.method import DreamerV2
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions
from pinwm_drake.paper.baselines.dreamer.options import NetworkOptions as DreamerSizes
from pinwm_drake.paper.baselines.dreamer.training import BEHAVIOUR
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import (
    DIFFUSION,
    DREAMER,
    MPC,
    NO_COUSINS,
    PIN_WM,
    RANDOM_ACTIONS,
    SCENE,
    SYSTEMS,
    TRUE_THETA,
    SceneCell,
)
from pinwm_drake.paper.reproduce.twins import IdentifiedCell, twin_cell
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.systems.envs.env import changed_options
from pinwm_drake.systems.envs.options import environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.envs.training_worlds import training_options
from pinwm_drake.systems.envs.vector import TaskVecEnv
from pinwm_drake.systems.mpc.waypoints import WaypointOptions
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.registry import recipe_of

_QUICK: dict[str, Any] = {
    "worlds": 8,
    "steps": 256,
    "round_steps": 256,
    "rounds": 1,
    "images": 64,
    "updates": 2,
    "episodes": 4,
}
_SILENCE = 60.0  # s, between two lines of a log
# Options of a training for the stand-in for a robot: a lab measures the 80 ms of its actions, and knows them to 10, and
# its masks to a pixel.
_ROBOT: dict[str, Any] = {"latency": (0.07, 0.09), "mask_error": 1.0}
_QUICK_SEARCH = WaypointOptions(strokes=64, sieves=((1, 4),), attempts=1, rounds=0)


@dataclass(frozen=True)
class PolicyCell(SceneCell):
    """Cell of a policy that a system trains.

    Attributes:
        twin: Cell of the twin that it is trained in; None for the scene's own parameters.
        history: Number of past states and actions that the policy sees.
    """

    path = "policies/{self.place}/{self.system}/seed-{self.seed}"
    times = 0.02, 0.45

    system: str
    twin: IdentifiedCell | None
    quick: bool = False
    history: int = 0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains the policy; see `Cell.make`."""
        scene, trained = self.scene, SYSTEMS[self.system]
        assert trained.domains is not None
        request = TrainRequest(
            scene=scene.scene if self.twin is None else str(root / self.twin.key),
            in_scene=None if self.twin is None else scene.scene,
            out=prepare_folder(root / self.key),
            task=scene.task,
            seed=self.seed,
            threads=1,
            resume=True,
            history=self.history,
            **(_ROBOT if self.stand_in else {}),
            # Others do not learn from the video where its camera is.
            as_filmed=self.stand_in and self.system in (PIN_WM, NO_COUSINS),
            **(_QUICK if self.quick else {}),
        )
        told: dict[str, Step] = {}
        report = say_rounds(say, told)
        search = _QUICK_SEARCH if self.quick else None
        train(request, domains=trained.domains(scene, self.seed), search=search, report=report)
        return {name: {"steps": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()}


def say_rounds(say: Say, told: dict[str, Step]) -> Report:
    """Report of a training that says a line when its success is another one, and each minute at the least.

    The dict takes the last progress of each stage, by name.
    """
    said = -math.inf

    def report(step: Step) -> None:
        nonlocal said
        known, now = not math.isnan(step.success), time.monotonic()
        if (known and (step.stage not in told or told[step.stage].success != step.success)) or now - said > _SILENCE:
            success = f", success {step.success:.0%}" if known else ""
            length = "" if math.isnan(step.length) else f" in {step.length:.0f} actions"
            say(f"{step.stage} {step.done:.0%}{success}{length}")
            said = now
        told[step.stage] = step

    return report


_ANYWHERE = {"tolerance": 1.0, "turn_tolerance": 3.1}  # m, rad: everything is near
_STEPS, _FEW_STEPS = 30, 4  # actions of an episode without a task
_QUICK_DREAMER = DreamerV2(
    networks=DreamerSizes(deter=16, hidden=16, latents=4, classes=4, depth=2, units=16, layers=1),
    model=ModelOptions(updates=2, batch_size=2, length=4),
    behaviour=BehaviourOptions(rounds=1, round_updates=2, episodes=2, batch_size=2, length=3, horizon=3),
)
_QUICK_DIFFUSION = DiffusionPolicy(
    NetworkOptions(widths=(8, 16), channels=(8, 8, 8), sampling_steps=2),
    TrainingOptions(updates=4, round_updates=4, batch_size=4, warmup=0, episodes=2),
)


@dataclass(frozen=True)
class DemonstrationsCell(Cell):
    """Cell of episodes in which an expert succeeds, in Drake's hydroelastic plant with VTK's images.

    Attributes:
        expert: Cell of a policy whose teacher, which sees the state, is the expert.
    """

    path = "demonstrations/{self.expert.place}/seed-{self.expert.seed}"

    expert: PolicyCell
    episodes: int

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * 25 * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Record the episodes; see `Cell.make`. A quick expert does nothing, and a quick task is done anywhere."""
        cell, folder = self.expert, root / self.key
        expert, near = read_policy(root / cell.key / TEACHER / "policy"), {}
        if cell.quick:
            known = load_setup(cell.scene.scene).task.to_document()
            near = {name: value for name, value in _ANYWHERE.items() if name in known}
        env, _ = recording_plant(cell.scene.scene, folder / "models", stand_in=cell.stand_in, task=near)
        about = {"expert": weights_digest(expert), **_origin(cell)}
        out, told = prepare_folder(folder / "episodes"), _counted(say, f"for {self.episodes} that succeed")
        collect_demonstrations(env, expert, out, self.episodes, seed=cell.seed, about=about, on_batch=told)
        return {"episodes": self.episodes}


@dataclass(frozen=True)
class DiffusionCell(Cell):
    """Cell of a diffusion policy of demonstrations."""

    path = "policies/{self.demonstrations.expert.place}/diffusion-policy/seed-{self.demonstrations.expert.seed}"
    times = 0.01, 2.0

    demonstrations: DemonstrationsCell
    quick: bool = False

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains it, on a GPU if there is one, and evaluates it in worlds of the true theta; see `Cell.make`."""
        data = MethodData(demonstrations=root / self.demonstrations.key / "episodes")
        method = _QUICK_DIFFUSION if self.quick else DiffusionPolicy(device=quickest_device())
        out = root / self.key
        actor, told = _trained(method, data, self.demonstrations.expert, out, STAGE, say, quick=self.quick)
        write_actor(out / "policy", actor)
        return {
            name: {"updates": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()
        }


@dataclass(frozen=True)
class TrajectoriesCell(SceneCell):
    """Cell of task-agnostic episodes: random pushes in Drake's hydroelastic plant with VTK's images.

    Attributes:
        steps: Number of actions of each.
    """

    path = "trajectories/{self.place}/seed-{self.seed}"

    episodes: int
    steps: int

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * self.steps * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Record the episodes; see `Cell.make`."""
        folder = root / self.key
        models, stand_in = folder / "models", self.stand_in
        env, spec = recording_plant(self.scene.scene, models, stand_in=stand_in, max_steps=self.steps)
        about, told = {**_origin(self), "steps": self.steps}, _counted(say, f"of {self.episodes}")
        explore, out = random_pushes(spec, 1), folder / "episodes"
        found = collect(env, explore, out, self.episodes, seed=self.seed, about=about, on_batch=told)
        ended = sum(bool(one.terminated) for one in found)
        return {"episodes": len(found), "actions": sum(len(one) for one in found), "successes": ended}


@dataclass(frozen=True)
class DreamerCell(Cell):
    """Cell of a policy of Dreamer V2, which learns from recorded episodes."""

    path = "policies/{self.trajectories.place}/dreamer-v2/seed-{self.trajectories.seed}"
    times = 0.01, 1.3

    trajectories: TrajectoriesCell
    quick: bool = False

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains it, on a GPU if there is one; the best round is found in worlds of the true theta; see `Cell.make`."""
        data, out = MethodData(trajectories=root / self.trajectories.key / "episodes"), root / self.key
        method = _QUICK_DREAMER if self.quick else DreamerV2(device=quickest_device())
        _, told = _trained(method, data, self.trajectories, out, BEHAVIOUR, say, quick=self.quick)
        return {name: {"steps": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()}


def dreamer(task: str, seed: int, quick: bool, *, stand_in: bool = False) -> DreamerCell:
    """Cell of the policy of Dreamer V2 of a task's scene, from 100 episodes, or from 2 for a quick one."""
    episodes, steps = (2, _FEW_STEPS) if quick else (100, _STEPS)
    return DreamerCell(TrajectoriesCell(task, seed, episodes, steps, stand_in=stand_in), quick)


def recording_plant(scene: str, folder: Path, *, stand_in: bool, **changes: Any) -> tuple[TaskVecEnv, PolicySpec]:
    """Drake's hydroelastic plant of a scene as one world for Stable-Baselines3: the one that policies are tried in.

    Args:
        scene: Scene as it is believed to be; see `load_setup`.
        folder: Folder for meshes of a stand-in; it has to stay.
        stand_in: Flag: the stand-in for a robot, with its camera, light, masks and late actions.

    Returns:
        The world, and the specification of a policy that sees its images.

    Raises:
        InputError: A file of the scene cannot be used.
        ParameterError: An option is none of those allowed.
    """
    setup = load_setup(scene)
    translation = recipe_of(setup.task).max_translation
    options = training_options(observation="rgb_state", max_translation=translation, **changes)
    spec = policy_spec(environment_setup(setup, options), options, "rgb")
    if not stand_in:
        return TaskVecEnv(setup, 1, options, engine="hydroelastic"), spec
    station = StandIn()
    options = changed_options(options, {"latency": (station.latency, station.latency)})
    env = TaskVecEnv(station.true_scene(setup, prepare_folder(folder)), 1, options, engine="hydroelastic")
    env.worlds.spoil = station.spoil()
    return env, spec


def _origin(cell: SceneCell) -> dict[str, object]:
    return {"scene": cell.scene.scene, "engine": "hydroelastic", "stand_in": cell.stand_in}


def _counted(say: Say, words: str) -> Callable[[int], None]:
    """Return the function that says the number of each episode."""
    begun = count(1)
    return lambda seed: say(f"episode {next(begun)} of this run, {words}")


def _trained(
    method: Method, data: MethodData, origin: SceneCell, out: Path, stage: str, say: Say, *, quick: bool
) -> tuple[Any, dict[str, Step]]:
    """Policy of a method, trained beside worlds of the true theta, and the last progress of each stage."""
    scene, told = origin.scene, dict[str, Step]()
    number, robot = 8 if quick else 64, _ROBOT if origin.stand_in else {}
    request = TrainRequest(scene.scene, prepare_folder(out), task=scene.task, delta=0.0, worlds=number, **robot)
    report = say_rounds(say, told)
    policy: Acts = method.train(data, worlds_of(request), out, seed=origin.seed, resume=True, report=report)
    training_figure(out / FIGURE_FILE, {stage: out / stage / HISTORY_FILE})
    return policy, told


_DEMONSTRATIONS = 100
_SECONDS = {"push": 20.0, "flip": 9.0}  # of an episode, by task, the mean of the rows in docs/results/tables.md


@dataclass(frozen=True)
class EvaluationCell(SceneCell):
    """Cell of an evaluation in Drake's hydroelastic plant with VTK's images.

    Attributes:
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
        """Run the episodes; see `Cell.make`."""
        scene = self.scene
        subject = None if self.subject is None else str(root / self.subject.key / self.inside)
        given: dict[str, Any] = {"policy": subject}
        if self.system in (MPC, RANDOM_ACTIONS):
            given = {"policy": EVALUATED_MPC if self.system == MPC else RANDOM, "model": subject, "task": scene.task}
        request = EvaluateRequest(
            scene=scene.scene,
            episodes=self.episodes,
            max_steps=self.max_steps,
            stand_in=self.stand_in,
            other_object=True,  # the true one, of which a twin's mesh may be a scan
            **given,
        )

        def progress(now: EvaluationProgress) -> None:
            if now.evaluation is not None and now.drawn is None and now.done % 10 == 0:
                say(f"{now.done} of {now.total} episodes, success {now.evaluation.success_rate:.0%}")

        out = root / self.key
        evaluate(request, out, workers=1, resume=True, progress=progress)
        results: dict[str, Any] = read_json(out / SUMMARY_FILE)["results"].value
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
