# SPDX-License-Identifier: MIT
"""A rollout ends early where nothing moves any more, and tells the same as one that goes on."""

import numpy as np
import pytest
import torch

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.scene import make_scene, resting_height
from tests.capture.cube import SIDE, write_mesh

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    path = write_mesh(tmp_path_factory.mktemp("rest") / "cube.obj")
    pusher = PusherGeometry(None, PusherShape("sphere", 0.01))
    return make_scene(path, pusher, q_WO=LEVEL, gravity=9.81, support="patch")


def start(scene, height=0.0, speed_up=0.0):
    p = torch.tensor([[[0.0, 0.0, resting_height(scene, LEVEL) + height]]], dtype=torch.float64)
    V = torch.zeros(1, 1, 6, dtype=torch.float64)
    V[..., 5] = speed_up
    pusher = torch.tensor([[-SIDE / 2 - 0.015, 0.005, SIDE / 2]], dtype=torch.float64)
    return State(q_WB=LEVEL[None, None], p_WB=p, V_WB=V, q_WP=LEVEL[None], p_WP=pusher)


def test_a_rollout_that_ends_early_tells_what_one_with_gradients_does(cube):
    steps, pushed = 400, 60
    V_WP = torch.zeros(steps, 1, 6, dtype=torch.float64)
    V_WP[:pushed, :, 3] = 0.2
    parameters = Parameters.nominal(cube.model, friction_floor=0.3, friction_pusher=0.2)
    early = Stepper(cube.model).rollout(parameters, start(cube), V_WP, record_every=8)
    # Gradients need every step, so that this one goes on to the end.
    V_WP = V_WP.clone().requires_grad_()
    late = Stepper(cube.model).rollout(parameters, start(cube), V_WP, record_every=8)
    assert float(early.p_WB[-1, 0, 0, 0]) > 0.02
    for name in ("q_WB", "p_WB", "V_WB", "q_WP", "p_WP"):
        np.testing.assert_allclose(getattr(early, name).numpy(), getattr(late, name).detach().numpy(), atol=1e-10)


def test_what_is_thrown_up_comes_down_again(cube):
    # At the top it rests for a step, to the last digit.
    h = cube.model.time_step
    rise = 30
    thrown = start(cube, height=0.2, speed_up=9.81 * h * rise)
    V_WP = torch.zeros(200, 1, 6, dtype=torch.float64)
    found = Stepper(cube.model).rollout(Parameters.nominal(cube.model), thrown, V_WP)
    speed = found.V_WB[: rise + 2, 0, 0, 5]
    assert float(speed.abs().min()) < 1e-12
    assert float(found.p_WB[-1, 0, 0, 2]) == pytest.approx(resting_height(cube, LEVEL), abs=2e-4)
