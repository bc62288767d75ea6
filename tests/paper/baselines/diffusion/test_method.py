# SPDX-License-Identifier: MIT
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.way_around.worlds import AroundWorlds, Expert, MakeAround
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning import rounds
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.progress import silent
from pinwm_drake.learning.weights import device_of, weights
from pinwm_drake.paper.baselines.diffusion.actor import read_actor
from pinwm_drake.paper.baselines.diffusion.demonstrations import (
    Episode,
    Windows,
    collect_demonstrations,
    read_demonstrations,
)
from pinwm_drake.paper.baselines.diffusion.method import STAGE, DiffusionPolicy, _Learner, _learning_rate
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions
from pinwm_drake.paper.baselines.recording import episode_file

pytest.importorskip("diffusers")

TINY = NetworkOptions(widths=(16, 24), channels=(8,), keypoints=4, image_features=8, step_features=16, sampling_steps=2)
SHORT = DiffusionPolicy(TINY, TrainingOptions(updates=30, round_updates=10, batch_size=8, warmup=4, episodes=4))


class Killed(Exception):
    pass


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    folder = tmp_path_factory.mktemp("around") / "demonstrations"
    collect_demonstrations(AroundWorlds(), Expert(), folder, 50)
    return folder


def train(method, demonstrations, out, *, seed=0, resume=False, report=silent):
    return method.train(MethodData(demonstrations), MakeAround(), out, seed=seed, resume=resume, report=report)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, demonstrations):
    """A training that nothing stopped: its policy and its folder."""
    out = tmp_path_factory.mktemp("whole")
    return train(SHORT, demonstrations, out), out


# After the first round, amid the second, and amid the first.
@pytest.mark.parametrize("done", [0.34, 0.5, 0.2])
def test_a_training_that_was_killed_goes_on_with_the_same_result(tmp_path, demonstrations, whole, monkeypatch, done):
    monkeypatch.setattr(rounds, "_PERIOD", 0.0)
    monkeypatch.setattr("pinwm_drake.paper.baselines.diffusion.method._TOLD", 5)

    def kill(step):
        if step.done >= done:
            raise Killed

    with pytest.raises(Killed):
        train(SHORT, demonstrations, tmp_path, report=kill)
    rest = train(SHORT, demonstrations, tmp_path, resume=True)
    a, b = weights(whole[0].network), weights(rest.network)
    assert all(np.array_equal(a[name], b[name]) for name in a)
    files = [out / STAGE / "checkpoint.npz" for out in (whole[1], tmp_path)]
    with np.load(files[0]) as one, np.load(files[1]) as two:
        assert all(np.array_equal(one[name], two[name]) for name in one.files if name != "history")
    again = weights(read_actor(tmp_path / STAGE / "policy").network)
    assert all(np.array_equal(a[name], again[name]) for name in a)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_training_on_a_gpu_gives_the_policy_of_one_on_the_cpu(tmp_path, demonstrations, whole):
    found = train(replace(SHORT, device="cuda"), demonstrations, tmp_path)
    assert device_of(found.network).type == "cpu"
    a, b = weights(whole[0].network), weights(found.network)
    assert all(np.allclose(a[name], b[name], rtol=0.0, atol=1e-3) for name in a)


def test_the_policy_is_the_moving_average_of_the_best_round(tmp_path, demonstrations):
    once = replace(SHORT, training=replace(SHORT.training, updates=10))
    found = weights(train(once, demonstrations, tmp_path).network)
    with np.load(tmp_path / STAGE / "checkpoint.npz") as file:
        best, average, own = (
            {name.removeprefix(part): file[name] for name in file.files if name.startswith(part)}
            for part in ("best.", "ema.module.", "net.")
        )
    assert found.keys() == best.keys() == average.keys()
    assert all(np.array_equal(found[name], best[name]) for name in found)
    assert all(np.array_equal(found[name], average[name]) for name in found)
    assert not all(np.array_equal(found[name], own[name]) for name in found)


def test_the_learning_rate_rises_evenly_and_falls_along_half_a_cosine():
    options = TrainingOptions(learning_rate=0.4, warmup=4)
    rates = [_learning_rate(options, update, 104) for update in (0, 1, 3, 4, 29, 54, 104)]
    assert rates == pytest.approx([0.1, 0.2, 0.4, 0.4, 0.2 * (1 + math.sqrt(0.5)), 0.2, 0.0], abs=1e-9)


def test_the_moving_average_begins_with_the_first_weights_and_forgets_slower_and_slower(demonstrations):
    options = TrainingOptions(updates=3, round_updates=3, batch_size=8, warmup=0, average_power=0.5, average_most=0.4)
    windows = Windows(read_demonstrations(demonstrations), TINY.observations, TINY.horizon)
    torch.manual_seed(0)
    learner, seen = _Learner(DiffusionPolicy(TINY, options), windows, 2), []
    for _ in learner.learn(0, np.random.default_rng(0), []):
        seen.append({name: value.detach().double() for name, value in learner._network.named_parameters()})
    # The first average is a copy; the next decays are 1 - 2^-0.5 = 0.29, and 1 - 3^-0.5 = 0.42 cut at 0.4.
    for name, value in learner.averaged.named_parameters():
        average = 0.2928932 * seen[0][name] + 0.7071068 * seen[1][name]
        average = 0.4 * average + 0.6 * seen[2][name]
        torch.testing.assert_close(value.detach().double(), average, rtol=0.0, atol=1e-6)


@pytest.mark.skipif(torch.cuda.is_available(), reason="a GPU is there")
def test_a_device_that_is_not_there_is_refused():
    with pytest.raises(ParameterError, match="device: got cuda; allowed: cpu"):
        DiffusionPolicy(device="cuda")


def test_a_training_of_other_demonstrations_is_refused(tmp_path, demonstrations, whole):
    collect_demonstrations(AroundWorlds(), Expert(), tmp_path / "fewer", 20)
    with pytest.raises(InputError, match="demonstrations"):
        train(SHORT, tmp_path / "fewer", whole[1], resume=True)
    with pytest.raises(InputError, match="seed"):
        train(SHORT, demonstrations, whole[1], seed=1, resume=True)
    with pytest.raises(ParameterError, match="demonstrations"):
        train(SHORT, None, tmp_path / "none")


def test_demonstrations_of_other_images_are_refused(tmp_path):
    moved = np.zeros((3, 2), np.float32)
    Episode(np.zeros((4, 16, 16, 3), np.uint8), np.zeros((4, 2), np.float32), moved).write(
        episode_file(tmp_path, 0), {}
    )
    with pytest.raises(InputError, match=r"\(16, 16, 2\).*\(32, 32, 2\)"):
        train(SHORT, tmp_path, tmp_path / "out")


def test_the_moving_average_follows_the_weights(tmp_path, demonstrations):
    # After update n it is (1 - d) w + d average with d = 1 - (1 + n)^-p; with a power near 0 it is the weights' own.
    slow, quick = (
        TrainingOptions(updates=5, round_updates=5, batch_size=8, warmup=0, episodes=1, average_power=power)
        for power in (3.0, 1e-9)
    )
    for name, options in (("slow", slow), ("quick", quick)):
        train(DiffusionPolicy(TINY, options), demonstrations, tmp_path / name)
        with np.load(tmp_path / name / STAGE / "checkpoint.npz") as file:
            names = [key.removeprefix("net.") for key in file.files if key.startswith("net.")]
            apart = max(np.abs(file[f"net.{key}"] - file[f"ema.module.{key}"]).max() for key in names)
        assert (apart < 1e-6) == (name == "quick")
