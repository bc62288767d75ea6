import numpy as np
import pytest

from benchmarks.way_around.worlds import DISC, GOAL, STEP, Anyhow, AroundWorlds, Expert, sides
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.paper.baselines.diffusion.collection import collect_demonstrations
from pinwm_drake.paper.baselines.diffusion.demonstrations import read_demonstrations


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
