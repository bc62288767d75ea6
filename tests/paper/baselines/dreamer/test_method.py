# SPDX-License-Identifier: MIT
import csv
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from benchmarks.scenes.point_mass import PointMassWorlds, Wandering
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning import rounds
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.progress import silent
from pinwm_drake.learning.weights import device_of, weights
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.paper.baselines.dreamer import training
from pinwm_drake.paper.baselines.dreamer.episodes import collect
from pinwm_drake.paper.baselines.dreamer.method import EPISODES, DreamerV2
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.policy import read_dreamer
from pinwm_drake.paper.baselines.recording import episode_file
from tests.paper.baselines.dreamer.small import SIZES, numbered

SHORT = DreamerV2(
    episodes=3,
    networks=SIZES,
    model=ModelOptions(updates=6, batch_size=2, length=5),
    behaviour=BehaviourOptions(rounds=2, round_updates=4, episodes=2, batch_size=2, length=3, horizon=3),
)


class Killed(Exception):
    pass


def trained(method, out, *, data=None, resume=False, report=silent):
    out.mkdir(exist_ok=True)
    return method.train(data or MethodData(), PointMassWorlds(2, 8), out, seed=0, resume=resume, report=report)


def alike(a, b):
    pairs = [(weights(getattr(a, part)), weights(getattr(b, part))) for part in ("perception", "actor")]
    return all(np.array_equal(left[name], right[name]) for left, right in pairs for name in left)


# In the model's training, after 4 of its 6 updates; and in the second round of the behaviour's.
@pytest.mark.parametrize(("stage", "done"), [("model", 0.6), ("behaviour", 0.7)])
def test_a_training_that_was_killed_goes_on_with_the_same_result(tmp_path, monkeypatch, stage, done):
    monkeypatch.setattr(training, "_PERIOD", -1.0)
    monkeypatch.setattr(rounds, "_PERIOD", -1.0)
    monkeypatch.setattr(training, "_TOLD", 2)
    whole = trained(SHORT, tmp_path / "a")

    def kill(step):
        if step.stage == stage and step.done >= done:
            raise Killed

    with pytest.raises(Killed):
        trained(SHORT, tmp_path / "b", report=kill)
    assert (tmp_path / "b" / stage / rounds.ROUND_FILE).exists() == (stage == "behaviour")
    rest = trained(SHORT, tmp_path / "b", resume=True)
    assert alike(whole, rest)
    assert alike(rest, read_dreamer(tmp_path / "b"))
    model = weights(training.read_world_model(tmp_path / "b", rest))
    assert all(np.array_equal(model[f"perception.{name}"], one) for name, one in weights(rest.perception).items())
    assert {"decoder.pusher.0.weight", "reward.0.weight"} <= set(model)
    curves = [(tmp_path / one / "model" / training.CURVE_FILE).read_text() for one in "ab"]
    assert curves[0] == curves[1]
    assert [row["updates"] for row in csv.DictReader(curves[0].splitlines())] == ["2", "4", "6"]
    assert len(list((tmp_path / "b" / EPISODES).iterdir())) == 3


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_training_on_a_gpu_gives_a_policy_on_the_cpu(tmp_path):
    used = []
    method = replace(SHORT, device="cuda")
    policy = trained(method, tmp_path, report=lambda step: used.append(torch.cuda.memory_allocated() > 0))
    assert any(used)
    assert all(device_of(getattr(policy, part)).type == "cpu" for part in ("perception", "actor"))
    assert alike(policy, read_dreamer(tmp_path))
    assert alike(policy, trained(method, tmp_path, resume=True))


def test_a_training_with_other_settings_is_refused(tmp_path):
    trained(SHORT, tmp_path)
    with pytest.raises(InputError, match="model"):
        trained(replace(SHORT, model=replace(SHORT.model, kl_scale=0.5)), tmp_path, resume=True)
    with pytest.raises(InputError, match="behaviour"):
        trained(replace(SHORT, behaviour=replace(SHORT.behaviour, entropy=0.5)), tmp_path, resume=True)
    with pytest.raises(InputError, match="episodes"):
        trained(replace(SHORT, episodes=2), tmp_path, resume=True)


def test_a_world_model_that_is_not_there_or_of_other_sizes_is_refused(tmp_path):
    policy = trained(SHORT, tmp_path / "a")
    with pytest.raises(InputError, match="no such file"):
        training.read_world_model(tmp_path, policy)
    with pytest.raises(InputError, match="of the policy's sizes"):
        training.read_world_model(tmp_path / "a", replace(policy, networks=replace(SIZES, depth=2)))


def recorded(folder, *, first=0, **shape):
    """A folder with two episodes, as `MethodData`."""
    folder.mkdir()
    for number in range(2):
        numbered(6, first=first + 10 * number, **shape).write(episode_file(folder, number))
    return MethodData(trajectories=folder)


def test_a_training_does_not_go_on_with_other_trajectories(tmp_path):
    one, other = recorded(tmp_path / "one"), recorded(tmp_path / "other", first=1)
    policy = trained(SHORT, tmp_path / "a", data=one)
    assert alike(policy, trained(SHORT, tmp_path / "a", data=one, resume=True))
    with pytest.raises(InputError, match="trajectories"):
        trained(SHORT, tmp_path / "a", data=other, resume=True)


def test_trajectories_of_other_worlds_or_too_few_are_refused_before_the_training(tmp_path):
    def silence(step):
        pytest.fail("it trains")

    with pytest.raises(InputError, match=r"row 1: got .*\(16, 16, 2\).*allowed: \(8, 8, 2\)"):
        trained(SHORT, tmp_path / "a", data=recorded(tmp_path / "large", size=16), report=silence)
    few = recorded(tmp_path / "few")
    long = replace(SHORT, behaviour=replace(SHORT.behaviour, length=15))
    with pytest.raises(ParameterError, match=r"behaviour\.length: got 15; allowed: up to 14, all recorded steps"):
        trained(long, tmp_path / "b", data=few, report=silence)


@pytest.mark.skipif(torch.cuda.is_available(), reason="a GPU is there")
def test_a_device_that_is_not_there_is_refused():
    with pytest.raises(ParameterError, match="device: got cuda; allowed: cpu"):
        DreamerV2(device="cuda")


def test_a_folder_of_trajectories_without_any_is_refused(tmp_path):
    with pytest.raises(InputError, match="no episode"):
        trained(SHORT, tmp_path, data=MethodData(trajectories=tmp_path / "none"))


@pytest.mark.nightly
def test_a_point_mass_is_moved_to_the_middle_after_learning_from_random_episodes_alone(tmp_path):
    worlds = PointMassWorlds(16, 16)
    recorded = tmp_path / "recorded"
    collect(worlds.worlds("rgb_state"), partial(Wandering, 16), recorded, 100, seed=1)
    method = DreamerV2(
        networks=NetworkOptions(deter=64, hidden=64, latents=8, classes=8, units=64),
        model=ModelOptions(updates=600, length=12, learning_rate=1e-3),
        behaviour=BehaviourOptions(
            rounds=2,
            round_updates=80,
            batch_size=8,
            length=12,
            horizon=10,
            actor_rate=1e-3,
            critic_rate=1e-3,
        ),
    )
    data = MethodData(trajectories=recorded)
    policy = method.train(data, worlds, tmp_path, seed=0, resume=False, report=silent)
    found = evaluate_worlds(worlds.worlds("rgb_state"), policy, 128, seed=99)
    chance = evaluate_worlds(worlds.worlds("rgb_state"), Wandering(16, 2), 128, seed=99)
    assert chance.success_rate < 0.25
    assert found.success_rate > 0.9
    # As `Homing`, which knows place and velocity, does in 3.6.
    assert found.mean_steps < 0.5 * chance.mean_steps
