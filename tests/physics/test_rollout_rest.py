# SPDX-License-Identifier: MIT
"""A rollout ends early where nothing moves any more, and tells the same as one that goes on."""

import numpy as np
import pytest
import torch
import trimesh

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


STEPS = 400


def pushes(last=0.0):
    """Velocities of a pusher that pushes for 60 steps, rests, and moves away in the last step of all."""
    V_WP = torch.zeros(STEPS, 1, 6, dtype=torch.float64)
    V_WP[:60, :, 3] = 0.2
    V_WP[-1, :, 3] = last
    return V_WP


def gradients(scene, state, V_WP, every):
    """The rollout, and the gradient of a sum over all its frames with respect to all that goes in."""
    nominal = Parameters.nominal(scene.model, friction_floor=0.3, friction_pusher=0.2)
    leaves = [
        tensor.clone().requires_grad_() for tensor in (*nominal.tensors(), state.p_WB, state.V_WB, state.p_WP, V_WP)
    ]
    *theta, p_WB, V_WB, p_WP, V = leaves
    state = State(q_WB=state.q_WB, p_WB=p_WB, V_WB=V_WB, q_WP=state.q_WP, p_WP=p_WP)
    found = Stepper(scene.model).rollout(Parameters(*theta), state, V, record_every=every)
    weights = torch.linspace(1.0, 2.0, len(found.p_WB), dtype=torch.float64)
    total = torch.zeros((), dtype=torch.float64)
    for k, frames in enumerate((found.q_WB, found.p_WB, found.V_WB, found.p_WP)):
        directions = torch.cos(torch.arange(frames[0].numel(), dtype=torch.float64) + k).reshape(frames[0].shape)
        total = total + (frames * directions).flatten(1).sum(1) @ weights
    total.backward()
    return found, [leaf.grad for leaf in leaves]


def assert_alike(one, other):
    """Alike to 1e-7 of the largest entry; below 1e-9 is rounding."""
    np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7 * np.abs(other).max() + 1e-9)


@pytest.mark.parametrize("every", [1, 8, STEPS])
def test_steps_at_rest_tell_what_single_ones_do(cube, every):
    # The pusher is away from the cube when it moves in the last step, so that only the rollout's early end differs.
    early, short = gradients(cube, start(cube), pushes(), every)
    late, long = gradients(cube, start(cube), pushes(-1e-9), every)
    assert early.p_WB.detach()[-1, 0, 0, 0] > 0.02
    for name in ("q_WB", "p_WB", "V_WB", "q_WP", "p_WP"):
        one, other = getattr(early, name).detach().numpy(), getattr(late, name).detach().numpy()
        np.testing.assert_allclose(one, other, atol=1e-10)
    for one, other in zip(short, long, strict=True):
        assert_alike(one.numpy(), other.numpy())


def test_the_gradient_of_what_could_roll_goes_on_at_rest(tmp_path):
    # A ball at rest: a speed at its start moves it in all steps, so that no step's gradient is that of the one before.
    pusher = PusherGeometry(None, PusherShape("sphere", 0.01))
    trimesh.creation.icosphere(subdivisions=4, radius=SIDE / 2).export(tmp_path / "ball.obj")
    ball = make_scene(tmp_path / "ball.obj", pusher, q_WO=LEVEL, gravity=9.81)
    V_WP = torch.zeros(50, 1, 6, dtype=torch.float64)
    _, short = gradients(ball, start(ball), V_WP, 50)
    V_WP[-1, :, 3] = -1e-9
    _, long = gradients(ball, start(ball), V_WP, 50)
    for one, other in zip(short, long, strict=True):
        assert_alike(one.numpy(), other.numpy())


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
