from functools import partial

import numpy as np
import pytest

from benchmarks.point_mass import STEPS, PointMass, PointMassWorlds, Wandering
from pinwm_drake.errors import InputError
from pinwm_drake.paper.baselines.dreamer.collect import RandomPushes, collect
from pinwm_drake.tasks.push import PushTask


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
