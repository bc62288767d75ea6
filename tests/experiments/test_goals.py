# SPDX-License-Identifier: MIT
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from pinwm_drake.cli.app import app
from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.experiments import training
from pinwm_drake.experiments.evaluation.run import evaluate
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import train
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.policy import read_policy
from pinwm_drake.learning.ppo import PpoOptions
from pinwm_drake.systems.envs.env import TaskEnv

pytestmark = pytest.mark.usefixtures("read_operators_once")

GOAL = (0.05, -0.04, 2.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a brief training whose episodes draw their goals."""
    folder = tmp_path_factory.mktemp("goals") / "run"
    short = {"worlds": 4, "image_size": 48, "frames": 2, "threads": 1, "steps": 256, "round_steps": 256}
    train(TrainRequest("push_t", folder, goals="random", rounds=1, images=64, updates=10, episodes=4, **short))
    return folder


@pytest.fixture(scope="module")
def bundle(run):
    exported = CliRunner().invoke(app, ["export", str(run), str(run.parent / "bundle"), "--no-arms"])
    assert exported.exit_code == 0, exported.output
    return read_bundle(run.parent / "bundle")


def test_the_bundle_is_told_the_goal_and_acts_as_the_policy_does(run, bundle):
    policy = read_policy(run)
    env = TaskEnv("push_t", "twin", task=policy.spec.task, observation="rgb", frames=2, image_size=48)
    assert bundle.contract["inputs"][2]["unit"] == ["m", "m", "rad"]
    for seed in range(3):
        seen, _ = env.reset(seed=seed)
        np.testing.assert_allclose(bundle.predict(seen)[0], limited(policy.predict(seen)[0]), atol=1e-4)
        other = seen | {"goal": seen["goal"] + np.array([0.05, 0.0, 1.0], np.float32)}
        assert not np.allclose(policy.predict(seen)[0], policy.predict(other)[0], atol=1e-3)


def limited(action):
    return action / max(np.linalg.norm(action), 1.0)


def test_a_bundle_for_a_goal_has_it_for_that_of_its_task(bundle):
    aimed, image = bundle.toward(GOAL), np.full(bundle.spec.image_shape, 255, np.uint8)
    image[20:30, 20:30] = 80
    assert aimed.spec.task.goal == GOAL
    assert aimed.spec.task.goal_size == 0
    p_WP = np.zeros(2)
    np.testing.assert_array_equal(
        aimed.act(image, p_WP), bundle.network.run(image, p_WP, np.array(GOAL))[0].astype(float)
    )
    assert not np.allclose(aimed.act(image, p_WP), bundle.toward((0.0, 0.0, 0.0)).act(image, p_WP), atol=1e-6)
    # The estimate is told from the goal: it is the same place in the world.
    far, near = (np.linalg.norm(one.step(image, p_WP)[1][9:11]) for one in (aimed, bundle.toward((0, 0, 0))))
    assert far == pytest.approx(np.linalg.norm(GOAL[:2]) * 10.0, abs=1e-4)  # the pusher, in 0.1 m
    assert near == pytest.approx(0.0, abs=1e-4)
    with pytest.raises(StateError, match="goal: got none"):
        bundle.act(image, p_WP)
    for goal in ((0.0, 0.0), (0.0, 0.0, float("nan"))):
        with pytest.raises(ParameterError, match="goal: got"):
            bundle.toward(goal)
    with pytest.raises(ParameterError, match="allowed: none"):
        read_bundle("push_t").toward(GOAL)


def test_it_is_evaluated_over_goals_and_controlled_towards_one(run, bundle, tmp_path):
    found = evaluate(EvaluateRequest(str(run), engine="twin", episodes=3, max_steps=3), tmp_path / "e", workers=1)
    assert found.episodes == 3
    rows = (tmp_path / "e" / "episodes.csv").read_text().splitlines()
    goals = {row.rsplit(",", 1)[1] for row in rows[1:]}
    assert len(goals) == 3
    assert all(len(goal.split()) == 3 for goal in goals)
    folder = str(run.parent / "bundle")
    refused = CliRunner().invoke(app, ["control", folder, "--engine", "twin", "--duration", "0.3"])
    assert refused.exit_code != 0
    assert "--goal" in str(refused.exception) + refused.output
    goal = ["--goal", *(str(value) for value in GOAL)]
    done = CliRunner().invoke(app, ["control", folder, "--engine", "twin", "--duration", "0.3", "--arm", *goal])
    assert done.exit_code == 0, done.output


@pytest.mark.nightly
@pytest.mark.parametrize("auxiliary", [True, False])
def test_goals_are_learned_from_images_at_once(tmp_path, monkeypatch, auxiliary):
    short = {"worlds": 4, "image_size": 48, "frames": 2, "threads": 1, "round_steps": 128, "episodes": 4}
    monkeypatch.setattr(training.PpoOptions, "for_images", _brief_rollouts)
    request = partial(TrainRequest, "push_t", goals="random", method="ppo", auxiliary=auxiliary, steps=256, **short)
    whole = train(request(tmp_path / "whole"))
    assert whole.spec.task.goal_size == 3

    def interrupt(step):
        if step.steps == 192:
            raise KeyboardInterrupt

    monkeypatch.setattr("pinwm_drake.learning.rounds._PERIOD", 0.0)
    with pytest.raises(KeyboardInterrupt):
        train(request(tmp_path / "killed"), report=interrupt)
    again = train(request(tmp_path / "killed", resume=True))
    for name, values in whole.actor.state_dict().items():
        np.testing.assert_array_equal(again.actor.state_dict()[name], values)


def _brief_rollouts(auxiliary):
    return PpoOptions(n_steps=16, batch_size=32, n_epochs=2, auxiliary=int(auxiliary))


@pytest.mark.parametrize("values", [{"goals": "many"}, {"goals": "random", "task": "flip"}, {"goal_turn": 7.0}])
def test_goals_that_make_no_sense_are_refused(tmp_path, values):
    with pytest.raises(ParameterError, match="goal"):
        TrainRequest(scene="push_t", out=tmp_path, **values)
