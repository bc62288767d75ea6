# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.math import RotationMatrix

from pinwm_drake.errors import StateError
from pinwm_drake.spatial.rotations import (
    matrix_to_quaternion,
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_exp,
    quaternion_log,
    quaternion_multiply,
    quaternion_to_matrix,
    rotate,
    turn_between,
)

# A handful of products of numbers of order one: a few roundings of float64 (2.2e-16 each).
ROUNDING = 1e-14


def random_quaternions(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    q = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    return q / q.norm(dim=-1, keepdim=True)


def random_vectors(count: int, seed: int = 1) -> torch.Tensor:
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def drake_rotation(q: torch.Tensor) -> RotationMatrix:
    return RotationMatrix(Quaternion(wxyz=q.numpy()))


def assert_close(actual: torch.Tensor, expected: torch.Tensor, atol: float = ROUNDING) -> None:
    torch.testing.assert_close(actual, expected, rtol=0, atol=atol)


def test_quaternions_agree_with_drake():
    q_AB, q_BC, v_B = random_quaternions(50), random_quaternions(50, seed=2), random_vectors(50)
    q_AC, R_AB, v_A = quaternion_multiply(q_AB, q_BC), quaternion_to_matrix(q_AB), rotate(q_AB, v_B)
    for i in range(50):
        R_AB_drake, R_BC_drake = drake_rotation(q_AB[i]), drake_rotation(q_BC[i])
        np.testing.assert_allclose(R_AB[i], R_AB_drake.matrix(), atol=ROUNDING)
        np.testing.assert_allclose(v_A[i], R_AB_drake.multiply(v_B[i].numpy()), atol=ROUNDING)
        product = (R_AB_drake @ R_BC_drake).matrix()
        np.testing.assert_allclose(quaternion_to_matrix(q_AC[i]), product, atol=ROUNDING)


def test_matrix_to_quaternion_agrees_with_drake_in_every_branch():
    # Rotations by nearly π about each axis make each component in turn the largest.
    half_turns = torch.eye(4, dtype=torch.float64)[[1, 2, 3]] + 1e-3
    q = normalize_quaternion(torch.cat((random_quaternions(50), half_turns, torch.eye(4, dtype=torch.float64))))
    found = matrix_to_quaternion(quaternion_to_matrix(q))
    for i in range(len(q)):
        assert found[i, 0] >= 0
        expected = drake_rotation(q[i]).ToQuaternion().wxyz()
        # The two choose their sign for themselves where w = 0.
        sign = math.copysign(1.0, float(found[i].numpy() @ expected))
        np.testing.assert_allclose(found[i], sign * expected, atol=ROUNDING)


def test_conjugate_is_the_inverse():
    q = random_quaternions(20)
    one = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).expand(20, 4)
    assert_close(quaternion_multiply(q, quaternion_conjugate(q)), one)


def test_exponential_of_a_turn_about_an_axis():
    # exp(θ z) is a rotation by θ about z: (cos θ/2, 0, 0, sin θ/2).
    for angle in (0.0, 1e-9, 1e-3, 0.019, 0.021, 0.5, 3.0):
        q = quaternion_exp(torch.tensor([0.0, 0.0, angle], dtype=torch.float64))
        expected = torch.tensor([math.cos(angle / 2), 0, 0, math.sin(angle / 2)], dtype=torch.float64)
        assert_close(q, expected)


def test_exponential_agrees_with_drakes_angle_axis():
    for theta in random_vectors(20):
        angle = float(theta.norm())
        expected = RotationMatrix(AngleAxis(angle=angle, axis=(theta / angle).numpy()))
        R = quaternion_to_matrix(quaternion_exp(theta))
        np.testing.assert_allclose(R, expected.matrix(), atol=ROUNDING)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-4, 0.0199, 0.0201, 1.0, 3.1])
def test_logarithm_inverts_the_exponential(size):
    theta = random_vectors(10)
    theta = size * theta / theta.norm(dim=-1, keepdim=True)
    assert_close(quaternion_log(quaternion_exp(theta)), theta)
    assert_close(quaternion_log(-quaternion_exp(theta)), theta)


def test_logarithm_takes_the_shorter_way_round():
    q = quaternion_exp(torch.tensor([0.0, 0.0, 1.5 * math.pi], dtype=torch.float64))
    expected = torch.tensor([0.0, 0.0, -0.5 * math.pi], dtype=torch.float64)
    assert_close(quaternion_log(q), expected)


def test_turn_between_known_rotations():
    q_AB = random_quaternions(4)
    angles = torch.tensor([0.0, 1e-7, 1.0, math.pi], dtype=torch.float64)
    axis = torch.tensor([[0.6, 0.0, 0.8]], dtype=torch.float64)
    q_AC = quaternion_multiply(q_AB, quaternion_exp(angles[:, None] * axis))
    assert_close(turn_between(q_AB, q_AC).norm(dim=-1), angles)
    assert_close(turn_between(q_AB, -q_AC).norm(dim=-1), angles)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.0199, 0.0201, 1.0, 3.0])
def test_gradients_of_exponential_and_logarithm(size):
    # gradcheck compares with central differences; its defaults are step 1e-6, tolerances 1e-5 and 1e-3.
    theta = random_vectors(3)
    theta = (size * theta / theta.norm(dim=-1, keepdim=True)).requires_grad_()
    assert torch.autograd.gradcheck(quaternion_exp, (theta,))
    q = quaternion_exp(theta.detach()).requires_grad_()
    assert torch.autograd.gradcheck(quaternion_log, (q,))


def test_gradients_of_products_and_conversions():
    q, p = random_quaternions(3).requires_grad_(), random_quaternions(3, seed=5).requires_grad_()
    v = random_vectors(3).requires_grad_()
    assert torch.autograd.gradcheck(quaternion_multiply, (q, p))
    assert torch.autograd.gradcheck(rotate, (q, v))
    assert torch.autograd.gradcheck(turn_between, (q, p))
    assert torch.autograd.gradcheck(lambda q: matrix_to_quaternion(quaternion_to_matrix(q)), (q,))


def test_the_gradient_at_the_identity_is_finite():
    theta = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    q = quaternion_exp(theta)
    quaternion_log(q).sum().backward()
    # d log(exp θ) / dθ = 1 at zero.
    assert_close(theta.grad, torch.ones(3, dtype=torch.float64))


def test_batch_axes_broadcast():
    q, v = random_quaternions(6).reshape(2, 3, 4), random_vectors(3)
    assert rotate(q, v).shape == (2, 3, 3)
    assert_close(rotate(q, v)[1, 2], rotate(q[1, 2], v[2]))
    assert quaternion_multiply(q, q[0]).shape == (2, 3, 4)
    assert quaternion_to_matrix(q).shape == (2, 3, 3, 3)


def test_wrong_shapes_are_named():
    with pytest.raises(StateError, match=r"q_AB: got shape \(3,\); allowed: \(\.\.\., 4\)"):
        quaternion_to_matrix(torch.zeros(3))
    with pytest.raises(StateError, match="v_B"):
        rotate(torch.zeros(4), torch.zeros(2))
    with pytest.raises(StateError, match="theta_A"):
        quaternion_exp(torch.tensor(1.0))
    with pytest.raises(StateError, match="R_AB"):
        matrix_to_quaternion(torch.zeros(2, 3))


def test_a_turn_leads_from_one_orientation_to_the_other():
    generator = torch.Generator().manual_seed(4)
    q_AB = torch.randn(50, 4, generator=generator, dtype=torch.float64)
    q_AB = q_AB / q_AB.norm(dim=-1, keepdim=True)
    turn = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    turn = turn * (3.0 / turn.norm(dim=-1, keepdim=True)).clamp_max(1.0)
    q_AC = quaternion_multiply(quaternion_exp(turn), q_AB)
    torch.testing.assert_close(turn_between(q_AB, q_AC), turn, rtol=0.0, atol=1e-12)
    torch.testing.assert_close(turn_between(q_AB[:1], q_AC)[0], turn[0], rtol=0.0, atol=1e-12)
