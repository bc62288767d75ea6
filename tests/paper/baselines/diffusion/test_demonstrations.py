# SPDX-License-Identifier: MIT
"""Demonstrations."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.way_around.worlds import DISC, GOAL, STEP, Anyhow, AroundWorlds, Expert, sides
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.paper.baselines.diffusion.demonstrations import (
    Episode,
    Windows,
    collect_demonstrations,
    digest,
    read_demonstrations,
)
from pinwm_drake.paper.baselines.recording import episode_file


def episode(length, first=0):
    """Image values, positions and actions tell the number of the observation."""
    numbers = np.arange(first, first + length + 1)
    image = np.broadcast_to(numbers[:, None, None, None], (length + 1, 4, 4, 3)).astype(np.uint8)
    pusher = np.tile(numbers[:, None] / 100.0, (1, 2)).astype(np.float32)
    return Episode(image, pusher, pusher[:-1])


def test_episodes_are_read_as_they_were_written(tmp_path):
    for number, one in enumerate((episode(4), episode(6, first=20))):
        one.write(episode_file(tmp_path, number), {})
    again = read_demonstrations(tmp_path)
    assert [len(one) for one in again] == [4, 6]
    assert np.array_equal(again[1].image, episode(6, first=20).image)
    assert digest(again) == digest([episode(4), episode(6, first=20)])
    assert digest(again) != digest([episode(4), episode(6, first=21)])
    assert digest(again) != digest([again[0], replace(again[1], image=255 - again[1].image)])
    # A run that was killed while it wrote leaves a file that has another name yet.
    (tmp_path / ".00002.4242.npz").write_bytes(b"half")
    assert len(read_demonstrations(tmp_path)) == 2


def test_windows_hold_the_past_and_what_was_done_then_within_an_episode():
    windows = Windows([episode(4), episode(3, first=20)], 2, 4)
    assert len(windows) == 7
    image, pusher, action = windows.take(np.arange(7))
    assert image[:, 0, 0, ::3].tolist() == [[0, 0], [0, 1], [1, 2], [2, 3], [20, 20], [20, 21], [21, 22]]
    assert np.array_equal(np.round(100 * pusher[..., 0]), image[:, 0, 0, ::3])
    assert np.round(100 * action[..., 1]).astype(int).tolist() == [
        [0, 0, 1, 2],
        [0, 1, 2, 3],
        [1, 2, 3, 3],
        [2, 3, 3, 3],
        [20, 20, 21, 22],
        [20, 21, 22, 22],
        [21, 22, 22, 22],
    ]


def test_windows_are_drawn_evenly():
    windows = Windows([episode(4), episode(3, first=20)], 1, 1)
    image, _, _ = windows.draw(7000, np.random.default_rng(0))
    numbers, counts = np.unique(image[:, 0, 0, 0], return_counts=True)
    assert numbers.tolist() == [0, 1, 2, 3, 20, 21, 22]
    assert np.abs(counts - 1000).max() < 150  # five standard deviations of 29


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"action": np.full((4, 2), 1.5, np.float32)}, "actions in"),
        ({"action": np.zeros((5, 2), np.float32)}, r"action \(T, n\)"),
        ({"image": np.zeros((5, 4, 4, 3), np.float32)}, "uint8"),
        ({"image": np.zeros((5, 8, 8, 3), np.uint8)}, "as in 00000"),
    ],
)
def test_episodes_that_do_not_fit_are_named(tmp_path, change, words):
    episode(4).write(episode_file(tmp_path, 0), {})
    one = episode(4)
    arrays = {"image": one.image, "pusher": one.pusher, "action": one.action} | change
    Episode(**arrays).write(episode_file(tmp_path, 1), {})
    with pytest.raises(InputError, match=words) as found:
        read_demonstrations(tmp_path)
    assert found.value.path.endswith("00001.npz")


def test_a_folder_without_episodes_is_refused(tmp_path):
    with pytest.raises(InputError, match="no episode"):
        read_demonstrations(tmp_path)


class Steady:
    """The expert's ways by the place of the disc alone, so that batches depend on nothing else."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        way = np.where(observation["state"][:, 2] > 0.0, 1.0, -1.0)
        return Expert().predict(observation, way, np.zeros(len(way), bool))[0], None


def test_successful_episodes_are_recorded_from_start_to_goal(tmp_path):
    collect_demonstrations(AroundWorlds(8), Expert(), tmp_path, 12)
    found = read_demonstrations(tmp_path)
    assert len(found) == 12
    for one in found:
        # Actions join the positions: x' = x + STEP * a.
        assert np.allclose(np.diff(one.pusher, axis=0), STEP * one.action, atol=1e-6)
        moved = one.pusher[-1, 0] - one.pusher[0, 0]
        assert 2.0 * DISC + GOAL < moved < 1.5
        assert one.image.shape == (len(one) + 1, 32, 32, 3)
        assert not np.array_equal(one.image[-1], one.image[-2])
    assert {-1.0, 1.0} == set(sides(tmp_path))


def test_a_recording_that_was_stopped_goes_on_with_the_same_episodes(tmp_path):
    def record(name, number, on_batch=None):
        collect_demonstrations(AroundWorlds(4), Steady(), tmp_path / name, number, seed=3, on_batch=on_batch)

    seeds = []
    record("a", 10, seeds.append)
    assert len(seeds) == len(set(seeds)) == 3
    record("b", 6)  # stops amid the second batch
    record("b", 10)
    for a, b in zip(read_demonstrations(tmp_path / "a"), read_demonstrations(tmp_path / "b"), strict=True):
        assert np.array_equal(a.action, b.action)
        assert np.array_equal(a.image, b.image)
    with pytest.raises(InputError, match="seed"):
        collect_demonstrations(AroundWorlds(4), Steady(), tmp_path / "a", 12, seed=4)


def test_an_expert_that_fails_is_given_up(tmp_path):
    with pytest.raises(ParameterError, match="0 successes"):
        collect_demonstrations(AroundWorlds(8), Anyhow(), tmp_path, 2)
    with pytest.raises(ParameterError, match="episodes"):
        collect_demonstrations(AroundWorlds(8), Expert(), tmp_path, 0)
