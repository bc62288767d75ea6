# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.capture.checks.motion import approach
from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp


def moves(*points, t=None):
    """A pusher that goes from point to point [m], a second each."""
    p_WP = np.array(points, float)
    q_WP = np.tile([1.0, 0, 0, 0], (len(points), 1))
    return PusherTrajectory(np.arange(len(points)) * 1.0, p_WP, q_WP, np.zeros_like(p_WP), None)


def at(x, y, z, turn=0.0):
    q = quaternion_exp(torch.tensor([0.0, 0.0, turn], dtype=torch.float64))
    return Pose(q, torch.tensor([x, y, z], dtype=torch.float64))


@pytest.mark.parametrize("side", [0.02, 0.1, 1.0, 4.0])
def test_distances_are_those_of_the_surfaces_whatever_the_size(side):
    box, ball = trimesh.creation.box((side, side, side)), trimesh.creation.icosphere(3, radius=0.02)
    # Past the middle of a face, 30 mm from it.
    path = moves((-2 * side, side / 2 + 0.05, 0.0), (2 * side, side / 2 + 0.05, 0.0))
    found = approach(box, at(0, 0, 0), ball, path, end=1.0)
    # Points on the ball are some 2 mm apart: on a radius of 20 mm that is 0.03 mm; steps are 3 mm.
    assert found.distance == pytest.approx(0.03, abs=1e-4)
    assert not found.inside


def test_distances_to_an_edge_and_with_a_turn():
    box, ball = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.icosphere(4, radius=0.01)
    # Turned by 45 deg, its edge is at 0.05 sqrt(2).
    path = moves((0.2, 0.3, 0.0), (0.2, -0.3, 0.0))
    found = approach(box, at(0.1, 0, 0, np.pi / 4), ball, path, end=1.0)
    assert found.distance == pytest.approx(0.1 - 0.01 - 0.05 * np.sqrt(2), abs=5e-4)
    assert found.t == pytest.approx(0.5, abs=0.01)


def test_only_the_time_of_the_images_counts():
    box, ball = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.icosphere(3, radius=0.01)
    path = moves((-0.3, 0, 0), (-0.1, 0, 0), (0.0, 0, 0))
    assert approach(box, at(0, 0, 0), ball, path, end=1.0).distance == pytest.approx(0.04, abs=1e-3)
    assert approach(box, at(0, 0, 0), ball, path, end=2.0).distance < 2e-3


def test_what_is_inside_from_the_start_is_told():
    box, ball = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.icosphere(3, radius=0.01)
    assert approach(box, at(0, 0, 0), ball, moves((0, 0, 0)), end=0.0).inside
    assert approach(ball, at(0, 0, 0), box, moves((0, 0, 0)), end=0.0).inside
    assert not approach(box, at(0, 0, 0), ball, moves((0.2, 0, 0)), end=0.0).inside
