"""Cells of recorded episodes in the plant, and of the policies that imitate them."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.training import FIGURE_FILE, TrainRequest, quickest_device, worlds_of
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.pin_wm import TEACHER
from pinwm_drake.learning.policy import read_policy, weights_digest
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.rounds import HISTORY_FILE
from pinwm_drake.paper.baselines.diffusion.actor import write_actor
from pinwm_drake.paper.baselines.diffusion.collection import collect_demonstrations
from pinwm_drake.paper.baselines.diffusion.method import STAGE, DiffusionPolicy
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions
from pinwm_drake.paper.reproduce.cell import Cell, Say
from pinwm_drake.paper.reproduce.plants import recording_plant
from pinwm_drake.paper.reproduce.policies import PolicyCell, robot_options, say_rounds
from pinwm_drake.paper.reproduce.scenes import task_scene
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.systems.envs.training_worlds import training_options
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.registry import recipe_of

_ANYWHERE = {"tolerance": 1.0, "turn_tolerance": 3.1}  # m, rad: everything is near


@dataclass(frozen=True)
class DemonstrationsCell:
    """Cell of episodes in which an expert succeeds, in Drake's hydroelastic plant with VTK's images.

    Attributes:
        expert: Cell of a policy whose teacher, which sees the state, is the expert.
        episodes: Number of episodes.
    """

    expert: PolicyCell
    episodes: int

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"demonstrations/{self.expert.place}/seed-{self.expert.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Cell of the expert."""
        return (self.expert,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return self.episodes * 25 * 0.5 / 3600.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Records the episodes; see `Cell.make`. A quick expert does nothing, and a quick task is done anywhere."""
        scene = task_scene(self.expert.task)
        expert = read_policy(root / self.expert.key / TEACHER / "policy")
        setup = load_setup(scene.scene)
        known = setup.task.to_document() if self.expert.quick else {}
        near = {name: value for name, value in _ANYWHERE.items() if name in known}
        options = training_options(
            observation="rgb_state", task=near, max_translation=recipe_of(setup.task).max_translation
        )
        env = recording_plant(setup, options, root / self.key / "models", stand_in=self.expert.stand_in)
        out = prepare_folder(root / self.key / "episodes")
        about = {
            "expert": weights_digest(expert),
            "scene": scene.scene,
            "engine": "hydroelastic",
            "stand_in": self.expert.stand_in,
        }
        begun = count(1)

        def on_batch(seed: int) -> None:
            say(f"episode {next(begun)} of this run, for {self.episodes} that succeed")

        collect_demonstrations(env, expert, out, self.episodes, seed=self.expert.seed, about=about, on_batch=on_batch)
        return {"episodes": self.episodes}


@dataclass(frozen=True)
class DiffusionCell:
    """Cell of a diffusion policy of demonstrations.

    Attributes:
        demonstrations: Cell of the demonstrations.
        quick: Flag: hardly any training, of a small network.
    """

    demonstrations: DemonstrationsCell
    quick: bool = False

    @property
    def key(self) -> str:
        """Path of its folder."""
        expert = self.demonstrations.expert
        return f"policies/{expert.place}/diffusion-policy/seed-{expert.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Cell of the demonstrations."""
        return (self.demonstrations,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return 0.01 if self.quick else 2.0

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Trains it, on a GPU if there is one, and evaluates it in worlds of the true theta; see `Cell.make`."""
        expert, out = self.demonstrations.expert, prepare_folder(root / self.key)
        scene = task_scene(expert.task)
        number, robot = 8 if self.quick else 64, robot_options(expert.stand_in)
        request = TrainRequest(scene.scene, out, task=scene.task, delta=0.0, worlds=number, **robot)
        worlds = worlds_of(request)
        method = DiffusionPolicy(device=quickest_device())
        if self.quick:
            few = TrainingOptions(updates=4, round_updates=4, batch_size=4, warmup=0, episodes=2)
            method = DiffusionPolicy(NetworkOptions(widths=(8, 16), channels=(8, 8, 8), sampling_steps=2), few)
        data, told = MethodData(demonstrations=root / self.demonstrations.key / "episodes"), dict[str, Step]()
        report = say_rounds(say, told)
        actor = method.train(data, worlds, out, seed=expert.seed, resume=True, report=report)
        write_actor(out / "policy", actor)
        training_figure(out / FIGURE_FILE, {STAGE: out / STAGE / HISTORY_FILE})
        return {
            name: {"updates": step.steps, "best": step.best, "seconds": step.seconds} for name, step in told.items()
        }
