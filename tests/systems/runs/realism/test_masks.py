# SPDX-License-Identifier: MIT
import numpy as np

from pinwm_drake.systems.runs.realism.masks import blurred, ragged


def test_masks_are_wrong_by_so_much_and_no_more():
    picture = np.full((80, 80, 4), (255, 255, 255, 0), np.uint8)
    picture[20:60, 20:60] = (200, 10, 10, 255)
    behind = np.array([90, 90, 90], np.uint8)
    for wider, inner, outer in ((1.0, 40, 43), (-1.0, 37, 40)):
        wrong = ragged(picture, wider, behind, np.random.default_rng(0), most=1.5)
        mask = wrong[..., 3] > 0
        assert inner**2 - 20 <= mask.sum() <= outer**2 + 20
        assert (mask.sum() > 1600) == (wider > 0)
        assert not mask[:18].any()
        assert mask[22:58, 22:58].all()
        # What the mask adds is what is behind the object.
        assert (wrong[mask & (picture[..., 3] == 0), :3] == behind).all()


def test_motion_blurs_across_the_way():
    moments = []
    for k in range(4):
        picture = np.full((10, 20, 4), (255, 255, 255, 0), np.uint8)
        picture[:, k : 8 + k] = (200, 0, 0, 255)
        moments.append(picture)
    mean = blurred(moments, np.array([100, 100, 100], np.uint8))
    np.testing.assert_array_equal(mean[0, :, 3] > 0, (np.arange(20) >= 1) & (np.arange(20) < 10))
    np.testing.assert_array_equal(mean[0, 5, :3], [200, 0, 0])
    np.testing.assert_array_equal(mean[0, 9, :3], [150, 50, 50])
