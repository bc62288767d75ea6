# SPDX-License-Identifier: MIT
import dataclasses
import math

import pytest
import torch

from pinwm_drake.geometry.shapes import sphere
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from tests.physics.gradients import central_difference, flatten, functional, gradients, make_cotangents, rollout_frames
from tests.physics.scenes import ball, nominal, push_model, push_start, straight_push

STEPS, EVERY = 320, 10  # 32 frames of 10 steps

# Directions in which the push depends smoothly on its inputs. Out of the plane it does not: a pusher that moves
# vertically by more than compliance * load, about 1e-7 m/s, slips on the block instead of sticking.
PLANAR = {
    "mass": lambda v: v,
    "inertia": lambda v: torch.diag_embed(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)) * v[..., 2:, 2:],
    "friction": lambda v: v,
    "p_WB": lambda v: torch.tensor([1.0, 0.3, 0.0], dtype=torch.float64).expand_as(v),
    "q_WB": lambda v: torch.stack([-v[..., 3], 0 * v[..., 0], 0 * v[..., 0], v[..., 0]], -1),
    "V_WB": lambda v: torch.tensor([0.0, 0.0, 1.0, 0.1, 0.2, 0.0], dtype=torch.float64).expand_as(v),
    "p_WP": lambda v: torch.tensor([1.0, -0.4, 0.0], dtype=torch.float64).expand_as(v),
    "V_WP": lambda v: torch.tensor([0.0, 0.0, 0.0, 1.0, 0.5, 0.0], dtype=torch.float64).expand_as(v),
}


@pytest.fixture(scope="module", params=["sphere", "capsule"])
def push(request):
    model = push_model(request.param)
    stepper = Stepper(model)
    parameters = nominal(model, friction_floor=0.03, friction_pusher=0.03)
    inputs = flatten(parameters, push_start(model), straight_push(STEPS))
    cotangents = make_cotangents(inputs, STEPS // EVERY + 1, torch.Generator().manual_seed(1))
    return stepper, inputs, cotangents, gradients(stepper, inputs, cotangents, EVERY)[1]


@pytest.mark.parametrize("name", PLANAR)
def test_a_32_frame_push_agrees_with_central_differences(push, name):
    # The push has contacts with floor and pusher, an impact, and 300 steps of sliding contact.
    stepper, inputs, cotangents, gradient = push
    direction = PLANAR[name](inputs[name])
    parts = gradient[name] * direction
    analytic, scale = float(parts.sum()), float(parts.abs().sum())
    # Relative to the size of the parts, which may nearly cancel. Rounding is an error of about 1e-10 / step, truncation
    # one of step^4, and crossing a kink one of order 1: of several steps the best one tells.
    errors = [
        abs(central_difference(stepper, inputs, cotangents, EVERY, name, direction, step) - analytic) / scale
        for step in (1e-4, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)
    ]
    assert min(errors) < 1e-4, errors


@pytest.mark.parametrize("pusher", ["sphere", "capsule"])
def test_restitution_has_the_derivative_towards_larger_values(pusher):
    # Without friction of the floor what bounces stays away.
    model = push_model(pusher)
    stepper, parameters = Stepper(model), nominal(model, friction_floor=0.0, friction_pusher=0.03)
    inputs = flatten(parameters, push_start(model), straight_push(STEPS))
    cotangents = make_cotangents(inputs, STEPS // EVERY + 1, torch.Generator().manual_seed(1))
    analytic = float(gradients(stepper, inputs, cotangents, EVERY)[1]["restitution"].sum())
    ones = torch.ones_like(inputs["restitution"])
    step, value = 1e-6, {}
    for scale in range(3):
        moved = {**inputs, "restitution": scale * step * ones}
        with torch.no_grad():
            value[scale] = float(functional(rollout_frames(stepper, moved, EVERY), cotangents))
    one_sided = (-3.0 * value[0] + 4.0 * value[1] - value[2]) / (2.0 * step)
    # A one-sided second-order difference: error of order step, amplified by the push's length.
    assert one_sided == pytest.approx(analytic, rel=1e-3)


def test_a_ball_that_is_squeezed_aside_has_the_derivative_of_its_closed_form():
    # Nothing spins, but the normal turns while the pusher passes. The ball leaves with v H / s, of the pusher's speed v
    # and its middle at a distance s aside and H above, where both touch. How high it begins does not count.
    speed, aside, reach = 0.6, 0.015, 0.03
    model = Model(bodies=[ball()], pusher=[sphere(0.01)])
    p_WP = torch.tensor([[aside, 0.0, 0.0485]], dtype=torch.float64, requires_grad=True)
    rest = State.at_rest(model, 1, p_WB=(0.0, 0.0, 0.02))
    state = dataclasses.replace(rest, p_WP=p_WP)
    parameters = nominal(model, friction_floor=0.0, friction_pusher=0.0)
    V_WP = straight_push(4, velocity=(0.0, 0.0, -speed))
    end = Stepper(model).rollout(parameters, state, V_WP).V_WB[-1, 0, 0]
    height = math.sqrt(reach**2 - aside**2)
    assert float(end[3].detach()) == pytest.approx(-speed * height / aside, rel=1e-3)
    (found,) = torch.autograd.grad(end[3], p_WP)
    expected = [speed * (1.0 / height + height / aside**2), 0.0, 0.0]
    assert found[0].tolist() == pytest.approx(expected, rel=1e-3, abs=1e-3 * expected[0])
