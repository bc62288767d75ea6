from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.paper.baselines.dreamer.replay import Replay
from pinwm_drake.paper.baselines.recording import Episode, episode_file, read_episodes
from tests.paper.baselines.dreamer.small import numbered


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
