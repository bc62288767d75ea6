# SPDX-License-Identifier: MIT
"""The seam of tasks: a task of some twenty lines is trained, evaluated, exported and controlled as push is."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError
from pinwm_drake.experiments.evaluation.run import evaluate
from pinwm_drake.experiments.golden_samples import export_bundle
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import train
from pinwm_drake.learning.policy import Policy, make_actor, read_policy, write_policy
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.models import model_path
from pinwm_drake.systems.control.loop import ControlLoop
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.registry import register
from pinwm_drake.tasks.task import Progress, Task


@register
@dataclass(frozen=True)
class SlideTask(Task):
    """An object is to be moved 10 cm along the world's x, with any turn."""

    name: ClassVar[str] = "toy_slide"
    axes: ClassVar[tuple[str, ...]] = ("x", "y")
    state_size: ClassVar[int] = 6
    max_steps: ClassVar[int] = 6
    distance: float = 0.1

    def measure(self, object_state, p_WP):
        away = np.abs(object_state[:, 4] - self.distance)
        reach = np.linalg.norm(p_WP[:, :2] - object_state[:, 4:6], axis=1)
        still = np.linalg.norm(object_state[:, 10:13], axis=1) < 0.01
        return Progress(away, np.zeros_like(away), reach, still, still & (away < 0.02))

    def rewards(self, before, after):
        return before.distance - after.distance + after.success

    def state(self, object_state, p_WP):
        seen = np.concatenate([object_state[:, 4:6], object_state[:, 10:12], p_WP[:, :2]], axis=1)
        return np.clip(10 * seen, -20, 20).astype(np.float32)


@register
class LiftTask(SlideTask):
    """The same with a pusher that moves up and down too."""

    name: ClassVar[str] = "toy_lift"
    axes: ClassVar[tuple[str, ...]] = ("x", "y", "z")


def scenario(folder, task: str) -> str:
    path = folder / f"{task}.scenario.yaml"
    shipped = model_path("scenarios/push_t.scenario.yaml").read_text()
    path.write_text(f"{shipped}\ntask: {{name: {task}, distance: 0.05}}\n")
    return str(path)


@pytest.mark.nightly
def test_a_task_of_its_own_is_trained_evaluated_and_exported(tmp_path):
    scene = scenario(tmp_path, "toy_slide")
    short = {"worlds": 4, "image_size": 32, "frames": 2, "threads": 1, "steps": 256, "round_steps": 256}
    train(TrainRequest(scene, tmp_path / "run", rounds=1, images=64, updates=10, episodes=4, **short))
    policy = read_policy(tmp_path / "run")
    assert policy.spec.task == SlideTask(0.05)
    assert policy.spec.max_steps == 6
    assert policy.provenance["task"] == "toy_slide"
    found = evaluate(
        EvaluateRequest(str(tmp_path / "run"), scene, "twin", episodes=2), tmp_path / "evaluation", workers=1
    )
    assert found.episodes == 2
    assert "success in the task toy_slide" in (tmp_path / "evaluation/report.html").read_text()
    bundle = export_bundle(str(tmp_path / "run"), str(tmp_path / "bundle"), scene=scene, arms=False)
    assert bundle.spec == policy.spec
    assert bundle.contract["spec"]["task"] == {"name": "toy_slide", "distance": 0.05}


def test_a_task_in_three_dimensions_is_exported_and_controlled(tmp_path):
    scene = scenario(tmp_path, "toy_lift")
    setup = environment_setup(load_setup(scene), options := EnvOptions(frames=2, max_translation=0.02, image_size=32))
    spec = policy_spec(setup, options, "rgb")
    assert len(spec.pusher_low) == spec.action_size == 3
    torch.manual_seed(0)
    actor = make_actor(spec).eval()
    with torch.no_grad():
        actor.head.weight.mul_(20.0)  # decided
    write_policy(tmp_path / "policy", Policy(spec, actor))
    bundle = export_bundle(tmp_path / "policy", tmp_path / "bundle", scene=scene, arms=False)
    env = TaskEnv(setup, "twin", options)
    assert env.action_space.shape == (3,)
    env.reset(seed=0)
    before = env.run.p_WP[0]
    env.step(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(env.run.p_WP[0] - before, [0.0, 0.0, 0.02], atol=1e-6)
    loop = ControlLoop(bundle, default_limits(bundle.spec), setup, "twin", armed=True)
    loop.begin(loop.draw_place(np.random.default_rng(0)))
    loop.listen()
    *_, last = loop.advance(0.3)
    assert last.status.reason == ""
    assert last.raw_action.shape == (3,)
    assert abs(last.raw_action[2]) > 0


def test_a_scenario_with_an_unknown_task_names_file_and_key(tmp_path):
    path = scenario(tmp_path, "juggle")
    with pytest.raises(InputError, match=r"juggle.scenario.yaml: got task = .*allowed: .*one of .*toy_slide"):
        load_setup(path)
