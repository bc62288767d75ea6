"""Cells of random pushes that are recorded in the plant, and of the world models and policies that learn from them."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.training import FIGURE_FILE, TrainRequest, quickest_device, worlds_of
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.rounds import HISTORY_FILE
from pinwm_drake.paper.baselines.dreamer.collect import collect, random_pushes
from pinwm_drake.paper.baselines.dreamer.method import DreamerV2
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.training import BEHAVIOUR
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.plants import recording_plant
from pinwm_drake.paper.reproduce.policies import robot_options, say_rounds
from pinwm_drake.paper.reproduce.scenes import scene_folder, task_scene
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.systems.envs.options import environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.envs.training_worlds import training_options
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.registry import recipe_of

_STEPS, _FEW_STEPS = 30, 4  # actions of an episode
_QUICK = DreamerV2(
    networks=NetworkOptions(deter=16, hidden=16, latents=4, classes=4, depth=2, units=16, layers=1),
    model=ModelOptions(updates=2, batch_size=2, length=4),
    behaviour=BehaviourOptions(rounds=1, round_updates=2, episodes=2, batch_size=2, length=3, horizon=3),
)


@dataclass(frozen=True)
class TrajectoriesCell:
    """Cell of task-agnostic episodes: random pushes in Drake's hydroelastic plant with VTK's images.

    Attributes:
        task: Name of the task's scene.
        seed: Seed of the experiment.
        episodes: Number of episodes.
        steps: Number of actions of each.
        stand_in: Flag: in the stand-in for a robot; see `StandIn`.
    """

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
    def key(self) -> str:
        """Path of its folder."""
        return f"trajectories/{self.place}/seed-{self.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """None: it begins with nothing."""
        return ()

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * self.steps * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Records the episodes; see `Cell.make`."""
        scene = task_scene(self.task)
        setup = load_setup(scene.scene)
        translation = recipe_of(setup.task).max_translation
        options = training_options(observation="rgb_state", max_translation=translation, max_steps=self.steps)
        env = recording_plant(setup, options, root / self.key / "models", stand_in=self.stand_in)
        spec = policy_spec(environment_setup(setup, options), options, "rgb")
        explore, begun = random_pushes(spec, 1), count(1)

        def on_batch(seed: int) -> None:
            say(f"episode {next(begun)} of this run, of {self.episodes}")

        out, about = root / self.key / "episodes", {"scene": scene.scene, "engine": "hydroelastic", "steps": self.steps}
        about["stand_in"] = self.stand_in
        found = collect(env, explore, out, self.episodes, seed=self.seed, about=about, on_batch=on_batch)
        ended = sum(bool(one.terminated) for one in found)
        return {"episodes": len(found), "actions": sum(len(one) for one in found), "successes": ended}


@dataclass(frozen=True)
class DreamerCell:
    """Cell of a policy of Dreamer V2, which learns from recorded episodes.

    Attributes:
        trajectories: Cell of the episodes.
        quick: Flag: hardly any training, of small networks.
    """

    trajectories: TrajectoriesCell
    quick: bool = False

    @property
    def key(self) -> str:
        """Path of its folder."""
        about = self.trajectories
        return f"policies/{about.place}/dreamer-v2/seed-{about.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Cell of the episodes."""
        return (self.trajectories,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return 0.01 if self.quick else 1.3

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains it, on a GPU if there is one; the best round is found in worlds of the true theta; see `Cell.make`."""
        about, out = self.trajectories, prepare_folder(root / self.key)
        scene = task_scene(about.task)
        number, robot = 8 if self.quick else 64, robot_options(about.stand_in)
        request = TrainRequest(scene.scene, out, task=scene.task, delta=0.0, worlds=number, **robot)
        worlds = worlds_of(request)
        data, told = MethodData(trajectories=root / about.key / "episodes"), dict[str, Step]()
        method = _QUICK if self.quick else DreamerV2(device=quickest_device())
        method.train(data, worlds, out, seed=about.seed, resume=True, report=say_rounds(say, told))
        training_figure(out / FIGURE_FILE, {BEHAVIOUR: out / BEHAVIOUR / HISTORY_FILE})
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
