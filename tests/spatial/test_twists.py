import math

import numpy as np
import pytest
import torch
from pydrake.multibody.math import SpatialVelocity

from pinwm_drake.errors import StateError
from pinwm_drake.spatial.poses import Pose, identity
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.spatial.twists import integrate_pose, shift, velocity_between

# A handful of products of numbers of order one: a few roundings of float64 (2.2e-16 each).
ROUNDING = 1e-14


def random_tensor(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_shift_agrees_with_drake():
    V_WB, p_BC_W = random_tensor(20, 6), random_tensor(20, 3, seed=1)
    V_WC = shift(V_WB, p_BC_W)
    for i in range(20):
        expected = SpatialVelocity(V_WB[i, :3].numpy(), V_WB[i, 3:].numpy()).Shift(p_BC_W[i].numpy())
        np.testing.assert_allclose(V_WC[i], expected.get_coeffs(), atol=ROUNDING)


def test_shift_broadcasts_one_velocity_over_points():
    assert shift(random_tensor(6), random_tensor(5, 3)).shape == (5, 6)


def test_quarter_turn_while_moving():
    # ω = π/2 rad/s about z for 1 s turns x into y; v = (1, 2, 3) m/s for 1 s moves the origin there.
    V_WB = torch.tensor([0, 0, math.pi / 2, 1, 2, 3], dtype=torch.float64)
    X_WB = integrate_pose(identity(), V_WB, 1.0)
    x_axis = quaternion_to_matrix(X_WB.q)[:, 0]
    torch.testing.assert_close(x_axis, torch.tensor([0.0, 1, 0], dtype=torch.float64), rtol=0, atol=ROUNDING)
    torch.testing.assert_close(X_WB.p, torch.tensor([1.0, 2, 3], dtype=torch.float64), rtol=0, atol=ROUNDING)


def test_many_small_steps_equal_one_large_step():
    # The flow of a constant velocity: exp(ω h)ⁿ = exp(n ω h). 100 steps of rounding error add up.
    V_WB = random_tensor(4, 6)
    X_WB = whole = identity(4)
    for _ in range(100):
        X_WB = integrate_pose(X_WB, V_WB, 0.01)
    whole = integrate_pose(whole, V_WB, 1.0)
    torch.testing.assert_close(X_WB.q, whole.q, rtol=0, atol=100 * ROUNDING)
    torch.testing.assert_close(X_WB.p, whole.p, rtol=0, atol=100 * ROUNDING)


def test_velocity_between_inverts_integration():
    q = random_tensor(10, 4, seed=3)
    X_WB = Pose(q / q.norm(dim=-1, keepdim=True), random_tensor(10, 3))
    V_WB = random_tensor(10, 6, seed=4)
    found = velocity_between(X_WB, integrate_pose(X_WB, V_WB, 0.1), 0.1)
    # Dividing by h = 0.1 s makes the rounding of the pose ten times larger.
    torch.testing.assert_close(found, V_WB, rtol=0, atol=10 * ROUNDING)


def test_gradients():
    # At rest (V = 0) too, where |ω| has no gradient of its own.
    q, p = random_tensor(2, 4), random_tensor(2, 3)
    V_WB = torch.cat((random_tensor(1, 6), torch.zeros(1, 6, dtype=torch.float64)))
    inputs = [x.requires_grad_() for x in (q / q.norm(dim=-1, keepdim=True), p, V_WB)]
    assert torch.autograd.gradcheck(lambda q, p, V: integrate_pose(Pose(q, p), V, 0.1), inputs)
    assert torch.autograd.gradcheck(shift, (inputs[2], inputs[1]))


def test_wrong_shapes_are_named():
    with pytest.raises(StateError, match=r"V_WB: got shape \(3,\); allowed: \(\.\.\., 6\)"):
        shift(torch.zeros(3), torch.zeros(3))
    with pytest.raises(StateError, match="p_BC_W"):
        shift(torch.zeros(6), torch.zeros(6))
