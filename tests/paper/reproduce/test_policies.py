# SPDX-License-Identifier: MIT
"""Cells of policies and of what they learn from."""

from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.paper.baselines.diffusion.demonstrations import read_demonstrations
from pinwm_drake.paper.baselines.dreamer.policy import read_dreamer
from pinwm_drake.paper.baselines.recording import read_episodes
from pinwm_drake.paper.reproduce.policies import TrajectoriesCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import read_results, reproduce, tables_of
from pinwm_drake.parallel import Executor


@pytest.mark.nightly
def test_random_pushes_are_recorded_in_the_plant_dreamt_of_and_evaluated(tmp_path: Path):
    request = ReproduceRequest(tasks=("push",), methods=("dreamer-v2",), episodes=1, quick=True)
    tables = tables_of(["policies"])
    reproduce(tables, request, tmp_path, executor=Executor(workers=1))
    episodes = read_episodes(tmp_path / "trajectories/push/seed-0/episodes")
    assert [len(one) for one in episodes] == [4, 4]
    assert episodes[0].images.shape == (5, 64, 64, 3)
    assert episodes[0].images.min() < 200  # the object, on white
    policy = read_dreamer(tmp_path / "policies/push/dreamer-v2/seed-0")
    assert policy.spec.max_steps > 4
    assert (tmp_path / "policies/push/dreamer-v2/seed-0/training.png").exists()
    (done,) = read_results(tables, request, tmp_path).values()
    assert done is not None
    assert done["result"]["episodes"] == 1
    assert done["settings"]["subject"]["kind"] == "DreamerCell"


@pytest.mark.nightly
def test_for_the_stand_in_they_are_recorded_in_it(tmp_path: Path):
    plain, stand_in = (TrajectoriesCell("push", 0, 1, 3, stand_in=flag) for flag in (False, True))
    assert plain.key != stand_in.key
    found = []
    for cell in (plain, stand_in):
        cell.make(tmp_path, print)
        found += read_episodes(tmp_path / cell.key / "episodes")
    assert not np.array_equal(found[0].images[0], found[1].images[0])  # lamp, camera and mask
    # Actions are late by most of an action's time: the pusher has hardly gone after the first one.
    moves = [np.linalg.norm(one.pusher[1] - one.pusher[0]) for one in found]
    assert moves[1] < 0.5 * moves[0]


def test_an_expert_is_recorded_in_the_plant_imitated_and_evaluated(tmp_path: Path):
    pytest.importorskip("diffusers")
    request = ReproduceRequest(tasks=("push",), methods=("diffusion-policy",), episodes=1, quick=True)
    tables = tables_of(["policies"])
    reproduce(tables, request, tmp_path, executor=Executor(workers=1))
    episodes = read_demonstrations(tmp_path / "demonstrations/push/seed-0/episodes")
    assert len(episodes) == 2
    assert episodes[0].image.shape[1:] == (64, 64, 3)
    assert episodes[0].image.min() < 200  # the object, on white
    assert (tmp_path / "policies/push/diffusion-policy/seed-0/training.png").exists()
    (done,) = read_results(tables, request, tmp_path).values()
    assert done is not None
    assert done["result"]["episodes"] == 1
    assert done["settings"]["subject"]["kind"] == "DiffusionCell"
