# SPDX-License-Identifier: MIT
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.rendering.registration import register, registered
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.spatial.rotations import quaternion_exp
from tests.rendering.boxes import box, views_around

UP = np.array([0.0, 0.0, 1.0])


def moved(x, y, yaw):
    turn = quaternion_exp(torch.tensor([0.0, 0.0, math.radians(yaw)], dtype=torch.float64))
    return Pose(turn, torch.tensor([x * 1e-3, y * 1e-3, 0.0], dtype=torch.float64))


@pytest.mark.parametrize("error", [(5.0, -3.0, 4.0), (-9.0, 8.0, -7.0)])
def test_the_object_is_found_where_the_masks_have_it(error):
    mesh = box()
    truth = views_around(mesh, size=160)
    # What is written has the object elsewhere.
    written = [replace(view, X_CO=compose(view.X_CO, moved(*error))) for view in truth]
    found = register(written, mesh, UP)
    left = compose(moved(*error), found.X_OS)
    assert float(left.p.norm()) < 3e-4
    assert 2.0 * math.acos(min(float(left.q[0].abs()), 1.0)) < math.radians(0.3)
    assert found.shift == pytest.approx(float(inverse(moved(*error)).p.norm()), abs=3e-4)
    assert math.degrees(found.turn) == pytest.approx(abs(error[2]), abs=0.3)
    assert found.differing[1] < 0.02 < found.differing[0]
    for view, right in zip(registered(written, found), truth, strict=True):
        assert torch.allclose(view.X_CO.p, right.X_CO.p, atol=5e-4)


def test_a_pose_that_is_right_stays_as_it_is():
    mesh = box()
    found = register(views_around(mesh, size=96), mesh, UP)
    assert (found.shift, found.turn) == (0.0, 0.0)
    assert found.differing[0] == found.differing[1] < 0.02


def test_an_object_on_its_side_moves_on_the_floor():
    # The floor's normal is x of O.
    mesh = box()
    turn = Pose(quaternion_exp(torch.tensor([0.05, 0.0, 0.0], dtype=torch.float64)),
                torch.tensor([0.0, 4e-3, -3e-3], dtype=torch.float64))  # fmt: skip
    written = [replace(view, X_CO=compose(view.X_CO, turn)) for view in views_around(mesh, size=160)]
    found = register(written, mesh, np.array([1.0, 0.0, 0.0]))
    left = compose(turn, found.X_OS)
    assert float(left.p.norm()) < 3e-4
    assert abs(float(found.X_OS.p[0])) < 1e-12


def test_views_without_the_object_tell_nothing():
    mesh = box()
    views = [replace(view, mask=torch.zeros_like(view.mask)) for view in views_around(mesh)]
    assert register(views, mesh, UP).differing == (0.0, 0.0)
