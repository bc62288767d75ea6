# SPDX-License-Identifier: MIT
"""Contacts with the floor: gap and normal against Drake and closed forms, and which points are kept."""

import numpy as np
import pytest

from pinwm_drake.geometry import shapes
from pinwm_drake.geometry.convex import hollow_mug, t_block
from pinwm_drake.geometry.entry import collide_floor
from pinwm_drake.geometry.floor import MAX_FLOOR_POINTS
from pinwm_drake.geometry.pieces import RIM_CORNERS, PieceTable, pack_pieces
from tests.geometry.oracles import DrakePair, evaluate, random_rotation, separations
from tests.geometry.test_manifolds import about_x

FLOOR = np.eye(3), np.zeros(3)


def floor_contacts(table: PieceTable, X_WB, margin: float, height: float = 0.0) -> list[dict]:
    rows = np.zeros((64, 16))
    count = collide_floor(table, 0, np.ones(3), *X_WB, np.zeros(6), 0.0, height, margin, rows, 0)
    return [evaluate(rows[k], X_WB, FLOOR) for k in range(count)]


@pytest.mark.parametrize("name", ["sphere", "box", "hull"])
def test_gap_against_drake(name):
    # Drake's half space supports the sphere only; the floor is a large box there (exact for boxes and hulls).
    generator = np.random.default_rng(1)
    cloud = generator.normal(size=(20, 3))
    piece = {
        "sphere": shapes.sphere(0.02, np.array([0.01, 0.0, 0.02])),
        "box": shapes.box(np.array([0.1, 0.04, 0.05])),
        "hull": shapes.convex_hull(0.04 * cloud / np.linalg.norm(cloud, axis=1, keepdims=True)),
    }[name]
    height = 0.013
    drake = DrakePair(piece, shapes.box(np.array([4.0, 4.0, 1.0])))
    table = pack_pieces([[piece]])
    for _ in range(100):
        X_WB = (
            random_rotation(generator),
            np.array([*generator.uniform(-1.0, 1.0, size=2), 0.05 * generator.normal()]),
        )
        distance, _ = drake.distance(X_WB, (np.eye(3), np.array([0.0, 0.0, height - 0.5])))
        found = floor_contacts(table, X_WB, 0.2, height)
        nearest = min(found, key=lambda c: c["phi"])
        # Drake stops too early now and then (see test_distances), by less than this.
        assert nearest["phi"] == pytest.approx(distance, abs=1e-6)
        for contact in found:
            np.testing.assert_array_equal(contact["n"], [0.0, 0.0, 1.0])
            assert contact["b"][2] == pytest.approx(height, abs=1e-15)


@pytest.mark.parametrize("name", ["sphere", "capsule", "cylinder", "box", "mug", "t_block"])
def test_gap_against_the_lowest_point(name):
    generator = np.random.default_rng(2)
    X_BG = random_rotation(generator), 0.02 * generator.normal(size=3)
    body = {
        "sphere": [shapes.sphere(0.02, X_BG[1])],
        "capsule": [shapes.capsule(0.02, 0.06, X_BG)],
        "cylinder": [shapes.cylinder(0.02, 0.06, X_BG)],
        "box": [shapes.box(np.array([0.1, 0.04, 0.05]), X_BG)],
        "mug": hollow_mug(),
        "t_block": t_block(),
    }[name]
    ground = shapes.box(np.array([4.0, 4.0, 1.0]))
    table = pack_pieces([body])
    for _ in range(50):
        X_WB = random_rotation(generator), np.array([0.3, -0.2, 0.05 * generator.normal()])
        up = np.array([[0.0, 0.0, 1.0]])
        lowest = min(separations(p, X_WB, ground, (np.eye(3), np.array([0.0, 0.0, -0.5])), up)[0] for p in body)
        found = floor_contacts(table, X_WB, 0.5)
        # Between two corners a rim is higher than its circle.
        above = 0.02 * (1.0 - np.cos(np.pi / RIM_CORNERS)) if name == "cylinder" else 0.0
        assert lowest - 1e-12 <= min(c["phi"] for c in found) <= lowest + above + 1e-12
        assert not floor_contacts(table, X_WB, lowest - 1e-9)


def test_a_block_lies_on_all_its_corners():
    # Inner corners of the T carry load too, as long as there are few: see `pieces`.
    table = pack_pieces([t_block()])
    found = floor_contacts(table, (np.eye(3), np.array([0.0, 0.0, 0.025])), 1e-3)
    places = sorted(np.round(c["a"][:2], 9).tolist() for c in found)
    bar = [[x, y] for x in (-0.05, 0.05) for y in (-0.055, -0.015)]
    stem = [[x, y] for x in (-0.02, 0.02) for y in (-0.015, 0.085)]
    assert places == sorted(bar + stem)


def test_an_upright_mug_keeps_outermost_points_whatever_the_rounding():
    table = pack_pieces([hollow_mug(segments=32)])
    height = -table.floor_points[:, 2].min()
    generator = np.random.default_rng(3)
    expected = None
    for _ in range(50):
        R_WB = np.eye(3) + 1e-16 * generator.normal(size=(3, 3))
        found = floor_contacts(table, (R_WB, np.array([0.0, 0.0, height + 1e-16 * generator.normal()])), 1e-3)
        assert len(found) <= MAX_FLOOR_POINTS
        places = np.array([c["a"] for c in found])
        np.testing.assert_allclose(np.linalg.norm(places[:, :2], axis=1), 0.04, atol=1e-12)
        np.testing.assert_allclose(places[:, :2].mean(axis=0), 0.0, atol=1e-12)
        rows = np.array([c["row"] for c in found])
        expected = rows if expected is None else expected
        np.testing.assert_array_equal(rows, expected)


def test_the_deepest_point_survives_the_reduction():
    table = pack_pieces([hollow_mug(segments=32)])
    generator = np.random.default_rng(4)
    for _ in range(50):
        tilt = about_x(0.02 * generator.normal())
        X_WB = tilt @ random_rotation_about_z(generator), np.array([0.0, 0.0, 0.033])
        found = floor_contacts(table, X_WB, 5e-3)
        lowest = np.min(table.floor_points[:, :3] @ X_WB[0][2]) + 0.033
        # Points of the same depth to 1e-7 m count as equal.
        assert min(c["phi"] for c in found) == pytest.approx(lowest, abs=1e-7)


def random_rotation_about_z(generator: np.random.Generator) -> np.ndarray:
    angle = generator.uniform(0.0, 2.0 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_a_cylinder_stands_on_eight_points_and_rolls_on_two():
    table = pack_pieces([[shapes.cylinder(0.03, 0.1)]])
    standing = floor_contacts(table, (np.eye(3), np.array([0.0, 0.0, 0.05])), 1e-3)
    assert len(standing) == 8
    np.testing.assert_allclose([np.linalg.norm(c["a"][:2]) for c in standing], 0.03, atol=1e-12)
    lying = floor_contacts(table, (about_x(np.pi / 2), np.array([0.0, 0.0, 0.03])), 1e-3)
    assert [c["kinds"] for c in lying] == [(3, 2), (3, 2)]
    np.testing.assert_allclose(sorted(c["a"][1] for c in lying), [-0.0494, 0.0494], atol=1e-12)
    np.testing.assert_allclose([c["phi"] for c in lying], 0.0, atol=1e-15)


@pytest.mark.parametrize("tilt", [3e-4, 0.01, 0.3, 1.2])
def test_a_tilted_cylinder_rests_on_the_corners_beside_its_lowest_place(tilt):
    radius, turn = 0.03, 2.0 * np.pi / RIM_CORNERS
    cylinder = shapes.cylinder(radius, 0.1)
    height = 0.05 * np.cos(tilt) + radius * np.sin(tilt)
    X_WB = about_x(tilt), np.array([0.0, 0.0, height])
    found = [c for c in floor_contacts(pack_pieces([[cylinder]]), X_WB, 1e-3) if c["kinds"] == (0, 2)]
    places = np.array([X_WB[0].T @ (c["a"] - X_WB[1]) for c in found])
    np.testing.assert_allclose(np.linalg.norm(places[:, :2], axis=1), radius, atol=1e-12)
    angles = np.arctan2(places[:, 1], places[:, 0])
    assert len({round(float(angle / turn)) for angle in angles}) == len(found)
    np.testing.assert_allclose(angles / turn, np.round(angles / turn), atol=1e-9)
    lowest = sorted(c["phi"] for c in found)[0]
    assert -1e-12 <= lowest <= radius * np.sin(tilt) * (1.0 - np.cos(0.5 * turn)) + 1e-12


def test_a_cylinder_that_tips_from_its_side_to_a_corner_has_no_jump_of_its_gap():
    table, radius = pack_pieces([[shapes.cylinder(0.03, 0.1)]]), 0.03
    gaps = []
    for tilt in np.linspace(0.0, 0.3, 3001):
        X_WB = about_x(0.5 * np.pi - tilt), np.array([0.0, 0.0, radius * np.cos(tilt) + 0.05 * np.sin(tilt)])
        gaps.append(min(c["phi"] for c in floor_contacts(table, X_WB, 1e-3)))
    # Above that of a round rim by what is between two corners, and by the inset of the side.
    assert min(gaps) >= -1e-12
    assert max(gaps) <= radius * (1.0 - np.cos(np.pi / RIM_CORNERS))
    assert np.abs(np.diff(gaps)).max() < 0.02 * radius * 1e-4 * 1.2  # the inset times the change of the tilt


def test_a_capsule_and_a_sphere_touch_with_their_ends():
    table = pack_pieces([[shapes.capsule(0.02, 0.06), shapes.sphere(0.02)]])
    found = floor_contacts(table, (about_x(np.pi / 2), np.array([0.0, 0.0, 0.02])), 1e-3)
    assert len(found) == 3
    np.testing.assert_allclose([c["phi"] for c in found], 0.0, atol=1e-15)
