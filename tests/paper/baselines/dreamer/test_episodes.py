# SPDX-License-Identifier: MIT
"""Episodes that Dreamer learns from."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from benchmarks.scenes.point_mass import STEPS, PointMass, PointMassWorlds, Wandering
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.paper.baselines.dreamer.episodes import RandomPushes, Replay, collect
from pinwm_drake.paper.baselines.recording import Episode, episode_file, read_episodes
from pinwm_drake.tasks.push import PushTask
from tests.paper.baselines.dreamer.small import numbered


def test_a_collection_that_was_stopped_goes_on_with_the_same_episodes(tmp_path):
    def collected(name, number, **settings):
        return collect(PointMass(2, 8), partial(Wandering, 2), tmp_path / name, number, seed=5, **settings)

    seeds = []
    whole = collected("a", 5, on_batch=seeds.append)
    assert len(seeds) == len(set(seeds)) == 3
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [f"{k:05}.npz" for k in range(5)]
    collected("b", 3)  # stops amid the second batch
    for one, other in zip(whole, collected("b", 5), strict=True):
        np.testing.assert_array_equal(one.images, other.images)
        np.testing.assert_array_equal(one.rewards, other.rewards)
    assert all(len(one) == STEPS or one.terminated for one in whole)
    collected("a", 5, on_batch=seeds.append)
    assert len(seeds) == 3  # nothing is done twice
    with pytest.raises(InputError, match="scene"):
        collected("a", 5, about={"scene": "other"})
    # Nothing of a collection is lost to another one that would be longer.
    before = {path: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    with pytest.raises(InputError, match="scene"):
        collected("a", 8, about={"scene": "other"})
    assert {path: path.read_bytes() for path in (tmp_path / "a").iterdir()} == before


def test_most_pushes_head_for_the_object():
    task, worlds = PushTask(), 400
    object_state, p_WP = np.zeros((worlds, 13)), np.zeros((worlds, 3))
    object_state[:, 0], object_state[:, 4:6], p_WP[:, :2] = 1.0, (0.3, 0.1), (-0.1, 0.1)
    seen = {"state": task.state(object_state, p_WP)}
    pushes = RandomPushes(PointMassWorlds().spec("rgb"), worlds, np.random.default_rng(0))
    actions = [pushes(seen) for _ in range(3)]
    assert all(np.abs(one).max() <= 1.0 for one in actions)
    # The object is 0.4 m off along x; within 0.05 m of its middle is within 8 degrees, and the noise adds to that.
    angle = np.arctan2(actions[0][:, 1], actions[0][:, 0])
    assert 0.6 < np.mean(np.abs(angle) < 0.6) < 0.9
    # A push goes on for some actions.
    assert np.corrcoef(actions[0][:, 1], actions[2][:, 1])[0, 1] > 0.7


def test_episodes_come_back_as_they_were_written(tmp_path):
    for number, one in enumerate([numbered(3), numbered(5, 10, terminated=True)]):
        one.write(episode_file(tmp_path, number))
    a, b = read_episodes(tmp_path)
    assert (len(a), len(b)) == (3, 5)
    assert (bool(a.terminated), bool(b.terminated)) == (False, True)
    for name in ("images", "pusher", "actions", "rewards"):
        np.testing.assert_array_equal(getattr(b, name), getattr(numbered(5, 10), name))


def test_bad_files_are_refused(tmp_path):
    path = episode_file(tmp_path, 0)
    with pytest.raises(InputError, match="no such file"):
        Episode.read(path)
    one = numbered(3)
    Episode(one.images[:3], one.pusher, one.actions, one.rewards, one.terminated).write(path)
    with pytest.raises(InputError, match="3 actions, 3 images"):
        Episode.read(path)
    for wrong, words in (
        ({"images": one.images / 255.0}, "images float64"),
        ({"images": one.images[..., :1]}, "height, width, 3"),
        ({"actions": one.actions[:, :1]}, r"actions \(3, 1\)"),
        ({"actions": np.nan * one.actions}, r"actions in \[-1, 1\]"),
        ({"rewards": np.inf * one.rewards}, "finite positions and rewards"),
    ):
        replace(one, **wrong).write(path)
        with pytest.raises(InputError, match=words):
            Episode.read(path)
    one.write(path, {"seed": 1})
    with pytest.raises(InputError, match="seed"):
        Episode.read(path, {"seed": 2})


def test_what_an_action_did_stands_beside_it():
    # Steps 0 to 3 are of the first episode, 4 to 9 of the second, whose numbers go on from 4.
    replay = Replay([numbered(3), numbered(5, 4, terminated=True)])
    assert len(replay) == 10
    batch = replay.draw(200, 10, np.random.default_rng(0))
    number = batch.image[0, :, 0, 0, 0]
    assert number.tolist() == list(range(10))
    assert batch.first[0].tolist() == [n in (0, 4) for n in range(10)]
    assert batch.terminal[0].tolist() == [n == 9 for n in range(10)]
    # The action that led to step n has its predecessor's number; none led to the first ones.
    before = torch.tensor([0.0, 0, 1, 2, 0, 4, 5, 6, 7, 8]) / 100.0
    torch.testing.assert_close(batch.action[0], torch.stack([before, -before], 1))
    usual = np.array([1, 2, 3, 5, 6, 7, 8], float)
    assert replay.reward_scale == pytest.approx(usual.std())
    expected = torch.tensor([0.0, 1, 2, 3, 0, 5, 6, 7, 8, 9]) / usual.std()
    torch.testing.assert_close(batch.reward[0], expected.float())


def test_sequences_begin_anywhere_and_with_a_first_step():
    replay = Replay([numbered(3), numbered(5, 4)])
    batch = replay.draw(300, 4, np.random.default_rng(0))
    begins = batch.image[:, 0, 0, 0, 0]
    assert sorted(set(begins.tolist())) == list(range(7))
    assert batch.first[:, 0].all()
    assert not batch.action[:, 0].any()
    with pytest.raises(ParameterError, match="10"):
        replay.draw(1, 11, np.random.default_rng(0))


def test_a_bonus_does_not_outweigh_the_rest():
    one = numbered(200, terminated=True)
    one.rewards[:] = np.tile([-1.0, 1.0], 100)
    one.rewards[-1] = 1000.0
    replay = Replay([one])
    assert replay.reward_scale == pytest.approx(1.0, abs=0.01)
    assert replay.draw(1, 201, np.random.default_rng(0)).reward[0, -1] == 10.0


def test_episodes_of_other_sizes_are_refused():
    with pytest.raises(ParameterError, match="2 sizes"):
        Replay([numbered(3, size=8), numbered(3, size=16)])
    with pytest.raises(ParameterError, match="0 sizes"):
        Replay([])
