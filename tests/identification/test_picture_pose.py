# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.identification.picture_pose import PictureReader
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.render import render
from pinwm_drake.spatial.poses import Pose, compose, identity, inverse
from pinwm_drake.spatial.rotations import quaternion_exp, turn_between
from tests.identification.samples import SIDE, surfels
from tests.rendering.boxes import look_at

SIZE, FINER = 32, 12  # px; the reader renders 4 pixels for each, and not 12
CAMERA = Camera.from_field_of_view(SIZE, SIZE, 0.9)
X_WC = inverse(look_at((0.05, -0.25, 0.3), (0.0, 0.0, 0.03)))
PIXEL = 0.4 / float(CAMERA.intrinsics[0])  # m, at the cube, which is 8 pixels wide
START = Pose(identity().q, torch.tensor([0.0, 0.0, SIDE / 2], dtype=torch.float64))
AWAY = np.array([0.0, 0.5, 0.2])


def reader(*, level, reach):
    mesh, pusher = trimesh.creation.box((SIDE, SIDE, SIDE)), trimesh.creation.icosphere(2, 0.01)
    return PictureReader(surfels(), CAMERA, X_WC, mesh, pusher, level=level, reach=reach, num_threads=1)


def taken(X_WO):
    """A picture, of more rendered pixels than the reader's."""
    shown = render(surfels(), CAMERA.scaled(FINER), compose(inverse(X_WC), X_WO), full=False, num_threads=1).color[0]
    return shown.reshape(SIZE, FINER, SIZE, FINER, 3).mean((1, 3)).numpy()


def read(image, *, level=True, reach=0.02, p_WP=AWAY):
    return reader(level=level, reach=reach).read(image, START, p_WP, np.random.default_rng(0))


def errors(found, X_WO):
    return float((found.p - X_WO.p).norm()), float(turn_between(found.q, X_WO.q).norm())


def turned(vector):
    return quaternion_exp(torch.tensor(vector, dtype=torch.float64))


def test_a_cube_that_slid_is_found_though_a_part_is_hidden_and_the_picture_blurred():
    X_WO = Pose(turned([0.0, 0.0, 0.3]), START.p + torch.tensor([0.018, -0.011, 0.0], dtype=torch.float64))
    image = taken(X_WO)
    place, angle = errors(read(image), X_WO)
    assert place < 0.1 * PIXEL
    assert angle < 0.02
    # The pusher stands before a corner, white as all that is not the object.
    p_WP = X_WO.p.numpy() - np.array([0.0, 0.5 * SIDE + 0.01, 0.0])
    hidden = reader(level=True, reach=0.02)._hidden(p_WP)
    assert 4 <= hidden.sum() < 100
    place, angle = errors(read(np.where(hidden[..., None], 1.0, image), p_WP=p_WP), X_WO)
    assert place < 0.2 * PIXEL
    assert angle < 0.04
    blurred = torch.nn.functional.avg_pool2d(torch.from_numpy(image).permute(2, 0, 1), 3, 1, 1, count_include_pad=False)
    # Of a cube of 8 pixels, this leaves too little to tell the turn well.
    place, _ = errors(read(blurred.permute(1, 2, 0).numpy()), X_WO)
    assert place < 0.5 * PIXEL


def test_a_cube_that_tips_over_its_edge_is_found():
    q_WO = turned([0.0, 0.6, 0.0])
    height = 0.5 * SIDE * (np.cos(0.6) + np.sin(0.6))  # of the middle above the edge
    X_WO = Pose(q_WO, torch.tensor([0.04, 0.01, height], dtype=torch.float64))
    place, angle = errors(read(taken(X_WO), level=False, reach=0.05), X_WO)
    assert place < 0.3 * PIXEL
    assert angle < 0.05


def test_a_picture_of_nothing_leaves_the_object_within_reach():
    found = read(np.ones((SIZE, SIZE, 3)))
    place, _ = errors(found, START)
    assert place < 0.04  # four standard deviations of the way that it is thought to have gone
    assert found.p[2] == pytest.approx(SIDE / 2)
