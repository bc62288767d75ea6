import numpy as np
import pytest

from benchmarks.point_mass import PointMass, PointMassWorlds, Wandering
from pinwm_drake.baselines.dreamer.collect import RandomPushes, collect
from pinwm_drake.errors import InputError
from pinwm_drake.tasks import PushTask


def test_each_world_gives_its_share_and_the_last_image_is_that_of_the_end(tmp_path):
    seen, env = [], PointMass(3, 8)

    class Watch(Wandering):
        def __call__(self, observation):
            seen.append(observation["image"][0])
            return super().__call__(observation)

    found = collect(env, Watch(3, 0), tmp_path, 4, seed=5)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{k:05}.npz" for k in range(4)]
    # The first two are of world 0, one after the other.
    first, second = found[:2]
    np.testing.assert_array_equal(first.images[:-1], np.stack(seen[: len(first)]))
    np.testing.assert_array_equal(second.images[0], seen[len(first)])
    assert not np.array_equal(first.images[-1], second.images[0])
    for one in found:
        # Rewards add up to the way towards the middle, and 1 more where it was reached.
        assert len(one) == 25 or one.terminated
        assert one.images.shape == (len(one) + 1, 8, 8, 3)


def test_a_collection_follows_from_its_seed_and_is_not_done_twice(tmp_path):
    about = {"seed": 5}
    first = collect(PointMass(2, 8), Wandering(2, 0), tmp_path / "a", 3, seed=5, about=about)
    other = collect(PointMass(2, 8), Wandering(2, 0), tmp_path / "b", 3, seed=5)
    for a, b in zip(first, other, strict=True):
        np.testing.assert_array_equal(a.images, b.images)
        np.testing.assert_array_equal(a.rewards, b.rewards)
    (tmp_path / "a" / "00001.npz").unlink()
    again = collect(PointMass(2, 8), Wandering(2, 0), tmp_path / "a", 3, seed=5, about=about, resume=True)
    np.testing.assert_array_equal(again[1].actions, first[1].actions)

    def refuse(seen):
        raise AssertionError

    kept = collect(PointMass(2, 8), refuse, tmp_path / "a", 3, seed=5, about=about, resume=True)
    np.testing.assert_array_equal(kept[2].actions, first[2].actions)
    with pytest.raises(InputError, match="seed"):
        collect(PointMass(2, 8), refuse, tmp_path / "a", 3, seed=5, about={"seed": 6}, resume=True)


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
