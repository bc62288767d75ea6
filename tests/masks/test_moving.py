# SPDX-License-Identifier: MIT
import numpy as np
import trimesh

from pinwm_drake.masks.moving import follow, in_the_shade
from pinwm_drake.masks.shots import Shot
from tests.masks.scenes import BLUE, FOCAL, SIZE, block, cameras, iou, photo, pose

GREY = np.array([60.0, 60.0, 65.0])


def test_a_push_is_followed_and_what_holds_the_pusher_is_no_object():
    X_WC = cameras()[1]
    K = np.array([[FOCAL, 0, SIZE / 2 - 0.5], [0, FOCAL, SIZE / 2 - 0.5], [0, 0, 1]])
    tip, rod = trimesh.creation.cylinder(0.008, 0.02), trimesh.creation.cylinder(0.006, 0.1)
    rod.apply_translation([0, 0, 0.06])
    towards = X_WC[:2, 3] / np.linalg.norm(X_WC[:2, 3])
    shots, labels, poses, pushers = [], [], [], []
    for k in range(5):
        step = 0.006 * k
        poses.append(pose(0.01 - step * towards[0], -0.005 - step * towards[1], 0.6 + 0.05 * k))
        X_WP = np.eye(4)
        X_WP[:3, 3] = [*(poses[-1][:2, 3] + 0.05 * towards), 0.02]
        pushers.append(X_WP)
        things = [(block(), poses[-1], BLUE), (tip, X_WP, GREY), (rod, X_WP, GREY)]
        image, label = photo(X_WC, things, seed=k)
        shots.append(Shot(str(k), image, K, np.linalg.inv(X_WC)))
        labels.append(label)
    assert (labels[2] == 3).sum() > 200  # the rod is seen
    readers = [lambda shot=shot: shot for shot in shots]
    found = list(follow(readers, block(), poses[0], tip, pushers))
    assert [doubt for _, _, doubt in found] == [""] * 5
    for (mask, X_WO, _), label, true in zip(found, labels, poses, strict=True):
        assert iou(mask, label == 1) > 0.9  # the bar of the issue for the worst image
        assert mask[label > 1].mean() < 0.2
        assert np.linalg.norm(X_WO[:3, 3] - true[:3, 3]) < 3e-3


def test_a_side_in_the_shade_has_no_edge_and_a_rod_before_it_has_one():
    lightness = np.tile(np.clip(20 + 4 * np.arange(60), 0, 200), (40, 1))  # a round side, darker to the left
    lightness[:, 45:50] = 60  # a rod before the light side
    lab = np.stack([lightness, *np.full((2, 40, 60), 128)], -1).astype(np.uint8)
    unlike = lightness < 90
    shaded = in_the_shade(lab, unlike, ~unlike)
    assert shaded[:, :17].all()
    assert not shaded[:, 45:50].any()
