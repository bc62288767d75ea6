# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch

from pinwm_drake.geometry.entry import contact_adjoint, contact_from_features, tangents, tangents_adjoint
from pinwm_drake.geometry.features import CIRCLE, LINE, PLANE, POINT
from pinwm_drake.geometry.features_torch import contacts_from_features, tangent_frames
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_to_matrix

PAIRS = [
    (POINT, PLANE),
    (PLANE, POINT),
    (POINT, POINT),
    (POINT, LINE),
    (LINE, POINT),
    (LINE, LINE),
    (CIRCLE, PLANE),
    (PLANE, CIRCLE),
    (CIRCLE, POINT),
    (POINT, CIRCLE),
    (CIRCLE, LINE),
    (LINE, CIRCLE),
    (LINE, PLANE),
    (PLANE, LINE),
]
RADIUS = {POINT: 0.011, LINE: 0.013, PLANE: 0.0, CIRCLE: 0.03}


def random_pair(rng, kinds):
    """Two features about 5 cm apart, in bodies at random poses. Lines meet rims near their witness points."""
    R_A, R_B = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
    R_A, R_B = R_A * np.linalg.det(R_A), R_B * np.linalg.det(R_B)
    p_A, p_B = rng.normal(size=(2, 3)) * 0.05
    row = np.zeros(16)
    for side, kind in ((0, kinds[0]), (8, kinds[1])):
        row[side] = kind
        row[side + 1 : side + 4] = rng.normal(size=3) * 0.03
        direction = rng.normal(size=3)
        row[side + 4 : side + 7] = direction / np.linalg.norm(direction)
        row[side + 7] = RADIUS[kind]
    if set(kinds) == {CIRCLE, LINE}:
        # The narrow phase gives the line's witness point.
        for _ in range(5):
            _, n, a, b = evaluate(row, R_A, p_A, R_B, p_B)
            if kinds[0] == LINE:
                row[1:4] = R_A.T @ (a + RADIUS[LINE] * n - p_A)
            else:
                row[9:12] = R_B.T @ (b - RADIUS[LINE] * n - p_B)
    if set(kinds) == {LINE, PLANE}:
        # A line that crosses the rim of a disc, 2 cm above it.
        disc, line = (0, 8) if kinds[0] == PLANE else (8, 0)
        row[disc + 7] = RADIUS[CIRCLE]
        u = row[disc + 4 : disc + 7]
        out = np.cross(u, rng.normal(size=3))
        x = row[disc + 1 : disc + 4] + RADIUS[CIRCLE] * out / np.linalg.norm(out) + 0.02 * u
        (R, p), (Q, q) = ((R_A, p_A), (R_B, p_B)) if disc == 0 else ((R_B, p_B), (R_A, p_A))
        row[line + 1 : line + 4] = Q.T @ (R @ x + p - q)
    return row, R_A, p_A, R_B, p_B


def evaluate(row, R_A, p_A, R_B, p_B):
    n, a, b = np.zeros(3), np.zeros(3), np.zeros(3)
    phi = contact_from_features(row, R_A, p_A, R_B, p_B, n, a, b)
    return phi, n, a, b


@pytest.mark.parametrize("kinds", PAIRS)
def test_kernel_agrees_with_torch_forward_and_backward(kinds):
    rng = np.random.default_rng(17)
    for _ in range(10):
        row, R_A, p_A, R_B, p_B = random_pair(rng, kinds)
        phi, n, a, b = evaluate(row, R_A, p_A, R_B, p_B)
        np.testing.assert_allclose(a - b, phi * n, atol=1e-15)
        n_bar, c_bar, phi_bar = rng.normal(size=3), rng.normal(size=3), rng.normal()
        twists = np.zeros((2, 6))
        contact_adjoint(row, R_A, p_A, R_B, p_B, n, a, b, phi, n_bar, c_bar, phi_bar, twists[0], twists[1])

        moved = torch.zeros(2, 6, dtype=torch.float64, requires_grad=True)
        turn = quaternion_to_matrix(quaternion_exp(moved[:, :3]))
        R = turn @ torch.from_numpy(np.stack([R_A, R_B]))
        p = torch.from_numpy(np.stack([p_A, p_B])) + moved[:, 3:]
        got = contacts_from_features(torch.from_numpy(row), R[0], p[0], R[1], p[1])
        for ours, theirs in zip((phi, n, a, b), got, strict=True):
            np.testing.assert_allclose(ours, theirs.detach().numpy(), atol=1e-13)
        loss = (got[1] * torch.from_numpy(n_bar)).sum() + phi_bar * got[0]
        loss = loss + (0.5 * (got[2] + got[3]) * torch.from_numpy(c_bar)).sum()
        loss.backward()
        scale = float(moved.grad.abs().max())
        np.testing.assert_allclose(twists, moved.grad.numpy(), atol=1e-9 * scale)


@pytest.mark.parametrize("kinds", PAIRS)
def test_kernel_agrees_with_central_differences(kinds):
    rng = np.random.default_rng(23)
    row, R_A, p_A, R_B, p_B = random_pair(rng, kinds)
    phi, n, a, b = evaluate(row, R_A, p_A, R_B, p_B)
    n_bar, c_bar, phi_bar = rng.normal(size=3), rng.normal(size=3), rng.normal()
    twists = np.zeros((2, 6))
    contact_adjoint(row, R_A, p_A, R_B, p_B, n, a, b, phi, n_bar, c_bar, phi_bar, twists[0], twists[1])

    def loss(move):
        turn = quaternion_to_matrix(quaternion_exp(torch.from_numpy(move.reshape(2, 6)[:, :3]))).numpy()
        phi, n, a, b = evaluate(row, turn[0] @ R_A, p_A + move[3:6], turn[1] @ R_B, p_B + move[9:12])
        return n_bar @ n + phi_bar * phi + c_bar @ (a + b) / 2

    step = 1e-6
    numeric = [(loss(step * unit) - loss(-step * unit)) / (2 * step) for unit in np.eye(12)]
    # Truncation: step^2 over a distance of 1 cm squared, 1e-8; rounding: 1e-16 / step.
    np.testing.assert_allclose(twists.ravel(), numeric, atol=1e-6 * np.abs(numeric).max())


def test_tangents_are_orthonormal_smooth_at_the_horizontal_and_have_the_right_adjoint():
    rng = np.random.default_rng(5)
    for n in (*rng.normal(size=(20, 3)), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])):
        n = n / np.linalg.norm(n)
        t = np.array(tangents(*n)).reshape(2, 3)
        frame = np.stack([n, *t])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        normal = torch.from_numpy(n).requires_grad_()
        frames = tangent_frames(normal)
        np.testing.assert_allclose(frames.detach().numpy(), frame, atol=1e-15)
        bars = rng.normal(size=(2, 3))
        (frames[1:] * torch.from_numpy(bars)).sum().backward()
        ours = np.array(tangents_adjoint(*n, t[0], bars[0], bars[1]))
        flat = np.eye(3) - np.outer(n, n)
        # A normal stays a unit vector: only the part along the sphere counts.
        np.testing.assert_allclose(flat @ ours, flat @ normal.grad.numpy(), atol=1e-13)
    just_above, just_below = (np.array(tangents(1.0, 0.0, z)) for z in (1e-12, -1e-12))
    np.testing.assert_allclose(just_above, just_below, atol=1e-11)
