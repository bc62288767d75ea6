"""Cells of episodes that are recorded in the plant, and of the policies that learn from them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import FIGURE_FILE, quickest_device, worlds_of
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import Acts
from pinwm_drake.learning.method import Method, MethodData
from pinwm_drake.learning.pin_wm import TEACHER
from pinwm_drake.learning.policy import read_policy, weights_digest
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.rounds import HISTORY_FILE
from pinwm_drake.paper.baselines.diffusion.actor import write_actor
from pinwm_drake.paper.baselines.diffusion.collection import collect_demonstrations
from pinwm_drake.paper.baselines.diffusion.method import STAGE, DiffusionPolicy
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions
from pinwm_drake.paper.baselines.dreamer.collect import collect, random_pushes
from pinwm_drake.paper.baselines.dreamer.method import DreamerV2
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions
from pinwm_drake.paper.baselines.dreamer.options import NetworkOptions as DreamerSizes
from pinwm_drake.paper.baselines.dreamer.training import BEHAVIOUR
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.policies import PolicyCell, robot_options, say_rounds
from pinwm_drake.paper.reproduce.scenes import scene_folder, task_scene
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.systems.envs.env import changed_options
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.envs.training_worlds import training_options
from pinwm_drake.systems.envs.vector import TaskVecEnv
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.registry import recipe_of

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
        episodes: Number of episodes.
    """

    path = "demonstrations/{self.expert.place}/seed-{self.expert.seed}"

    expert: PolicyCell
    episodes: int

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * 25 * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Records the episodes; see `Cell.make`. A quick expert does nothing, and a quick task is done anywhere."""
        scene, stand_in = task_scene(self.expert.task).scene, self.expert.stand_in
        expert = read_policy(root / self.expert.key / TEACHER / "policy")
        setup = load_setup(scene)
        known = setup.task.to_document() if self.expert.quick else {}
        near = {name: value for name, value in _ANYWHERE.items() if name in known}
        options = training_options(
            observation="rgb_state", task=near, max_translation=recipe_of(setup.task).max_translation
        )
        env = recording_plant(setup, options, root / self.key / "models", stand_in=stand_in)
        about = {"expert": weights_digest(expert), "scene": scene, "engine": "hydroelastic", "stand_in": stand_in}
        out, told = prepare_folder(root / self.key / "episodes"), _counted(say, f"for {self.episodes} that succeed")
        collect_demonstrations(env, expert, out, self.episodes, seed=self.expert.seed, about=about, on_batch=told)
        return {"episodes": self.episodes}


@dataclass(frozen=True)
class DiffusionCell(Cell):
    """Cell of a diffusion policy of demonstrations.

    Attributes:
        demonstrations: Cell of the demonstrations.
        quick: Flag: hardly any training, of a small network.
    """

    path = "policies/{self.demonstrations.expert.place}/diffusion-policy/seed-{self.demonstrations.expert.seed}"
    times = 0.01, 2.0

    demonstrations: DemonstrationsCell
    quick: bool = False

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains it, on a GPU if there is one, and evaluates it in worlds of the true theta; see `Cell.make`."""
        data = MethodData(demonstrations=root / self.demonstrations.key / "episodes")
        method = _QUICK_DIFFUSION if self.quick else DiffusionPolicy(device=quickest_device())
        out = prepare_folder(root / self.key)
        actor, told = _trained(method, data, self.demonstrations.expert, out, STAGE, say, quick=self.quick)
        write_actor(out / "policy", actor)
        return {
            name: {"updates": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()
        }


@dataclass(frozen=True)
class TrajectoriesCell(Cell):
    """Cell of task-agnostic episodes: random pushes in Drake's hydroelastic plant with VTK's images.

    Attributes:
        task: Name of the task's scene.
        seed: Seed of the experiment.
        episodes: Number of episodes.
        steps: Number of actions of each.
        stand_in: Flag: in the stand-in for a robot; see `StandIn`.
    """

    path = "trajectories/{self.place}/seed-{self.seed}"

    task: str
    seed: int
    episodes: int
    steps: int
    stand_in: bool = False

    @property
    def place(self) -> str:
        """Folder of what is made for the same scene."""
        return scene_folder(self.task, self.stand_in)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * self.steps * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Records the episodes; see `Cell.make`."""
        scene, stand_in = task_scene(self.task).scene, self.stand_in
        setup = load_setup(scene)
        translation = recipe_of(setup.task).max_translation
        options = training_options(observation="rgb_state", max_translation=translation, max_steps=self.steps)
        env = recording_plant(setup, options, root / self.key / "models", stand_in=stand_in)
        explore = random_pushes(policy_spec(environment_setup(setup, options), options, "rgb"), 1)
        about = {"scene": scene, "engine": "hydroelastic", "steps": self.steps, "stand_in": stand_in}
        out, told = root / self.key / "episodes", _counted(say, f"of {self.episodes}")
        found = collect(env, explore, out, self.episodes, seed=self.seed, about=about, on_batch=told)
        ended = sum(bool(one.terminated) for one in found)
        return {"episodes": len(found), "actions": sum(len(one) for one in found), "successes": ended}


@dataclass(frozen=True)
class DreamerCell(Cell):
    """Cell of a policy of Dreamer V2, which learns from recorded episodes.

    Attributes:
        trajectories: Cell of the episodes.
        quick: Flag: hardly any training, of small networks.
    """

    path = "policies/{self.trajectories.place}/dreamer-v2/seed-{self.trajectories.seed}"
    times = 0.01, 1.3

    trajectories: TrajectoriesCell
    quick: bool = False

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains it, on a GPU if there is one; the best round is found in worlds of the true theta; see `Cell.make`."""
        data, out = MethodData(trajectories=root / self.trajectories.key / "episodes"), prepare_folder(root / self.key)
        method = _QUICK_DREAMER if self.quick else DreamerV2(device=quickest_device())
        _, told = _trained(method, data, self.trajectories, out, BEHAVIOUR, say, quick=self.quick)
        return {name: {"steps": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()}


def dreamer(task: str, seed: int, quick: bool, *, stand_in: bool = False) -> DreamerCell:
    """Cell of the policy of Dreamer V2 of a task and seed, from 100 episodes, or from 2 where hardly any is to be done.

    Args:
        task: Name of the task's scene.
        seed: Seed of the experiment.
        quick: Flag: hardly any training.
        stand_in: Flag: in the stand-in for a robot.
    """
    few = TrajectoriesCell(task, seed, 2, _FEW_STEPS, stand_in)
    return DreamerCell(few if quick else TrajectoriesCell(task, seed, 100, _STEPS, stand_in), quick)


def recording_plant(setup: Setup, options: EnvOptions, folder: Path, *, stand_in: bool) -> TaskVecEnv:
    """Drake's hydroelastic plant of a scene as one world for Stable-Baselines3: the one that policies are tried in.

    Args:
        setup: The scene as it is believed to be.
        options: Options of the environment.
        folder: Folder for meshes of a stand-in; it has to stay.
        stand_in: Flag: the stand-in for a robot, with its camera, light, masks and late actions.

    Raises:
        InputError: A file of the scene cannot be used.
        ParameterError: An option is none of those allowed.
    """
    if not stand_in:
        return TaskVecEnv(setup, 1, options, engine="hydroelastic")
    station = StandIn()
    options = changed_options(options, {"latency": (station.latency, station.latency)})
    env = TaskVecEnv(station.true_scene(setup, prepare_folder(folder)), 1, options, engine="hydroelastic")
    env.worlds.spoil = station.spoil()
    return env


def _counted(say: Say, words: str) -> Callable[[int], None]:
    """Function that says the number of each episode."""
    begun = count(1)
    return lambda seed: say(f"episode {next(begun)} of this run, {words}")


def _trained(
    method: Method,
    data: MethodData,
    origin: PolicyCell | TrajectoriesCell,
    out: Path,
    stage: str,
    say: Say,
    *,
    quick: bool,
) -> tuple[Any, dict[str, Step]]:
    """Policy of a method, trained beside worlds of the true theta, and the last progress of each stage."""
    scene, told = task_scene(origin.task), dict[str, Step]()
    number, robot = 8 if quick else 64, robot_options(origin.stand_in)
    request = TrainRequest(scene.scene, out, task=scene.task, delta=0.0, worlds=number, **robot)
    report = say_rounds(say, told)
    policy: Acts = method.train(data, worlds_of(request), out, seed=origin.seed, resume=True, report=report)
    training_figure(out / FIGURE_FILE, {stage: out / stage / HISTORY_FILE})
    return policy, told
