# SPDX-License-Identifier: MIT
import numpy as np

from benchmarks.scenes.point_mass import STEPS, PointMass, Wandering
from pinwm_drake.paper.baselines.recording import record_episodes


def test_each_world_gives_one_episode_whose_last_image_is_that_of_the_end():
    seen, begins, explore = [], [], Wandering(3, 0)

    def act(observation, starts):
        seen.append(observation["image"].copy())
        begins.append(starts.copy())
        return 2.0 * explore(observation)

    found = record_episodes(PointMass(3, 8), act, 5)
    assert len(found) == 3
    np.testing.assert_array_equal(begins[0], True)
    for world, (one, info) in enumerate(found):
        T = len(one.actions)
        assert T == STEPS or info["success"]
        assert one.images.shape == (T + 1, 8, 8, 3)
        assert len(one.pusher) == T + 1
        np.testing.assert_array_equal(one.images[:-1], np.stack([image[world] for image in seen[:T]]))
        # What follows the end is of the next episode.
        if len(seen) > T:
            assert begins[T][world]
            assert not np.array_equal(one.images[-1], seen[T][world])
        assert np.abs(one.actions).max() <= 1.0
        # Rewards add up to the way towards the middle, and 1 more where it was reached.
        assert one.rewards.shape == (T,)
        assert one.rewards.sum() - info["success"] > -(2.0**0.5)
