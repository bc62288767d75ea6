# SPDX-License-Identifier: MIT
import numpy as np
import trimesh

from pinwm_drake.masks.shading import unexplained
from pinwm_drake.masks.shots import Shot
from tests.masks.scenes import FOCAL, SIZE, cameras, photo

WHITE = np.array([220.0, 220.0, 215.0])


def test_a_cup_is_told_from_one_that_is_turned_over():
    wall = trimesh.creation.box((0.07, 0.07, 0.05))
    cup = wall.difference(trimesh.creation.box((0.06, 0.06, 0.05)).apply_translation([0, 0, 0.005]), engine="manifold")
    X_WO, over = np.eye(4), np.diag([1.0, -1, -1, 1])
    X_WO[2, 3] = over[2, 3] = 0.025
    K = np.array([[FOCAL, 0, SIZE / 2 - 0.5], [0, FOCAL, SIZE / 2 - 0.5], [0, 0, 1]])
    views = cameras()[:4]
    shots = [Shot("", photo(X, [(cup, X_WO, WHITE)])[0], K, np.linalg.inv(X)) for X in views]
    for shot in shots:
        assert (shot.outline(cup, X_WO) == shot.outline(cup, over)).mean() > 0.999  # outlines do not tell
    assert unexplained(shots, cup, X_WO) < 0.8 * unexplained(shots, cup, over)
    black = [Shot("", np.zeros_like(shot.image), K, shot.X_CW) for shot in shots]
    assert unexplained(black, cup, X_WO) == 1.0
