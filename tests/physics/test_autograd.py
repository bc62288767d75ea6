# SPDX-License-Identifier: MIT
"""The rollout as a node of autograd: what is changed between forward and backward is an error, not another gradient."""

import pytest
import torch

from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.stepper import Stepper
from tests.physics.scenes import nominal, push_model, push_start, straight_push

STEPS = 20


@pytest.fixture
def push():
    """Friction and velocity that need gradients, and the rollout of them."""
    model = push_model("sphere")
    parameters = nominal(model, friction_floor=0.1)
    friction, V = parameters.friction.clone().requires_grad_(), straight_push(STEPS).requires_grad_()

    def roll():
        changed = Parameters(parameters.mass, parameters.inertia, friction, parameters.restitution)
        return Stepper(model, num_threads=1).rollout(changed, push_start(model), V, record_every=10)

    return friction, V, roll


@pytest.mark.parametrize("which", ["friction", "velocity", "trajectory"])
def test_a_change_in_place_is_an_error(push, which):
    friction, V, roll = push
    trajectory = roll()
    with torch.no_grad():
        {"friction": friction, "velocity": V, "trajectory": trajectory.q_WB}[which].mul_(0.5)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        trajectory.p_WB.sum().backward()


def test_a_second_derivative_is_an_error(push):
    friction, _, roll = push
    (gradient,) = torch.autograd.grad(roll().p_WB.sum(), friction, create_graph=True)
    with pytest.raises(RuntimeError, match=r"once_differentiable|does not require grad"):
        gradient.square().sum().backward()


def test_a_graph_that_is_kept_gives_the_same_gradient_twice(push):
    friction, _, roll = push
    loss = roll().p_WB.sum()
    first, second = (torch.autograd.grad(loss, friction, retain_graph=True)[0] for _ in range(2))
    assert torch.equal(first, second)
    assert first.abs().sum() > 0
