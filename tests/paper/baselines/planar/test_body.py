# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.planar.body import make_planar_body
from tests.paper.baselines.planar.shapes import LEVEL, disc_body, square_body, t_body, write_boxes


def test_cells_cover_the_face_below(tmp_path):
    body = t_body(tmp_path)
    assert abs(len(body.cells) - 80) <= 4
    # The T's area is 0.008 m^2, its middle at the origin of the boxes' distances.
    assert len(body.cells) * body.size**2 == pytest.approx(0.008, rel=0.05)
    x, y = body.cells.T.abs()
    assert bool(((x < 0.05) & (y < 0.086)).all())
    assert not bool(((body.cells[:, 0].abs() > 0.02) & (body.cells[:, 1] > -0.015)).any())


def test_a_disc_has_the_second_moment_of_a_disc(tmp_path):
    body = disc_body(tmp_path, radius=0.05)
    moment = float(body.cells.square().sum(-1).mean()) + body.size**2 / 6.0
    assert moment == pytest.approx(0.5 * 0.05**2, rel=0.02)  # a polygon of 48 corners, cut into squares


def test_a_rim_carries_where_only_a_rim_touches(tmp_path):
    trimesh.creation.annulus(r_min=0.03, r_max=0.05, height=0.02, sections=24).export(tmp_path / "ring.obj")
    body = make_planar_body(tmp_path / "ring.obj", LEVEL, 0.0, 0.0, cells=60)
    radius = body.cells.norm(dim=-1)
    assert len(body.cells) == pytest.approx(60, abs=6)
    assert float(radius.min()) > 0.028
    assert float(radius.max()) < 0.05


def test_a_round_object_is_covered_as_seen_from_above(tmp_path):
    trimesh.creation.icosphere(subdivisions=2, radius=0.04).export(tmp_path / "ball.obj")
    body = make_planar_body(tmp_path / "ball.obj", LEVEL, 0.0, 0.0)
    assert len(body.cells) * body.size**2 == pytest.approx(math.pi * 0.04**2, rel=0.08)


def test_outlines_are_those_at_the_height_of_the_pusher(tmp_path):
    mesh = trimesh.creation.cone(radius=0.06, height=0.12, sections=64)  # its base at z = 0
    mesh.export(tmp_path / "cone.obj")
    for low, high, radius in ((0.04, 0.04, 0.04), (0.03, 0.06, 0.045)):
        outline = make_planar_body(tmp_path / "cone.obj", LEVEL, low, high).outlines
        assert outline.shape[0] == 1
        np.testing.assert_allclose(outline.norm(dim=-1), radius, rtol=1e-6)
    with pytest.raises(ParameterError, match=r"heights of the object, 0 to 0\.12 m"):
        make_planar_body(tmp_path / "cone.obj", LEVEL, 0.2, 0.2)


def test_outlines_turn_to_the_left(tmp_path):
    for outline in t_body(tmp_path).outlines:
        span = outline.roll(-1, 0) - outline
        after = span.roll(-1, 0)
        assert bool((span[:, 0] * after[:, 1] - span[:, 1] * after[:, 0] >= 0.0).all())


def test_neighbours_share_a_side(tmp_path):
    body = square_body(tmp_path)
    pairs = body.neighbours()
    assert len(pairs) == 2 * 9 * 8
    apart = (body.cells[pairs[:, 0]] - body.cells[pairs[:, 1]]).norm(dim=-1)
    np.testing.assert_allclose(apart, body.size, rtol=1e-9)


def test_planar_poses_follow_the_object_beyond_a_turn(tmp_path):
    path = write_boxes(tmp_path / "box.obj", ((0.1, 0.06, 0.04), (0.0, 0.0, 0.0)))
    # On its side: x of O points up, y along x of Q.
    half = math.sqrt(0.5)
    lying = np.array([half, 0.0, -half, 0.0])
    body = make_planar_body(path, torch.from_numpy(lying), 0.0, 0.0)
    np.testing.assert_allclose(np.ptp(body.cells.numpy(), axis=0) + body.size, [0.06, 0.04], rtol=0.1)
    yaw = np.linspace(0.3, 8.0, 30)
    turns = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=-1)
    w, z, q = turns[:, 0], turns[:, 3], lying
    q_WO = np.stack([w * q[0] - z * q[3], w * q[1] - z * q[2], w * q[2] + z * q[1], w * q[3] + z * q[0]], axis=-1)
    found = body.planar(q_WO, np.tile([0.1, 0.2, 0.05], (30, 1)))
    np.testing.assert_allclose(found[:, :2], np.tile([0.1, 0.2], (30, 1)))
    np.testing.assert_allclose(np.diff(found[:, 2]), np.diff(yaw), atol=1e-9)


def test_few_cells_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="cells: got 3; allowed: 4 or more"):
        t_body(tmp_path, cells=3)
