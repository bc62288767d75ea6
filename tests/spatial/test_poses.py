# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from pinwm_drake.errors import StateError
from pinwm_drake.spatial.poses import Pose, compose, identity, inverse, pose_to_matrix, transform

# A handful of products of numbers of order one: a few roundings of float64 (2.2e-16 each).
ROUNDING = 1e-14


def random_poses(count: int, seed: int) -> Pose:
    generator = torch.Generator().manual_seed(seed)
    q = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    p = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return Pose(q / q.norm(dim=-1, keepdim=True), p)


def drake_transform(X: Pose, i: int) -> RigidTransform:
    return RigidTransform(Quaternion(wxyz=X.q[i].numpy()), X.p[i].numpy())


def test_poses_agree_with_drake():
    X_AB, X_BC = random_poses(20, seed=0), random_poses(20, seed=1)
    X_AC, X_BA, p_AC = compose(X_AB, X_BC), inverse(X_AB), transform(X_AB, X_BC.p)
    for i in range(20):
        X_AB_drake, X_BC_drake = drake_transform(X_AB, i), drake_transform(X_BC, i)
        expected = (X_AB_drake @ X_BC_drake).GetAsMatrix4()
        np.testing.assert_allclose(pose_to_matrix(X_AC)[i], expected, atol=ROUNDING)
        np.testing.assert_allclose(pose_to_matrix(X_BA)[i], X_AB_drake.inverse().GetAsMatrix4(), atol=ROUNDING)
        np.testing.assert_allclose(p_AC[i], X_AB_drake.multiply(X_BC.p[i].numpy()), atol=ROUNDING)


def test_identity_changes_nothing():
    X_AB = random_poses(3, seed=2)
    for composed in (compose(identity(3), X_AB), compose(X_AB, identity(3))):
        assert torch.equal(composed.q, X_AB.q)
        assert torch.equal(composed.p, X_AB.p)
    with pytest.raises(StateError, match="-1"):
        identity(-1)


def test_gradients():
    X_AB, X_BC = random_poses(2, seed=3), random_poses(2, seed=4)
    parts = [part.requires_grad_() for part in (*X_AB, *X_BC)]

    def through(q_AB, p_AB, q_BC, p_BC):
        return pose_to_matrix(inverse(compose(Pose(q_AB, p_AB), Pose(q_BC, p_BC))))

    assert torch.autograd.gradcheck(through, parts)


def test_one_pose_moves_many_points():
    X_AB = random_poses(1, seed=5)
    points = torch.randn(7, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    moved = transform(X_AB, points)
    assert moved.shape == (7, 3)
    matrix = pose_to_matrix(X_AB)[0]
    torch.testing.assert_close(moved, points @ matrix[:3, :3].T + matrix[:3, 3], rtol=0, atol=ROUNDING)


def test_wrong_shapes_are_named():
    with pytest.raises(StateError, match="p_AB"):
        transform(Pose(torch.zeros(4), torch.zeros(2)), torch.zeros(3))
