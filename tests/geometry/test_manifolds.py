# SPDX-License-Identifier: MIT
"""Which contacts parallel features give, and that rounding does not change them."""

import numpy as np
import pytest

from pinwm_drake.geometry import shapes
from pinwm_drake.geometry.pieces import ConvexPiece, pack_pieces
from tests.geometry.oracles import contacts, random_rotation

GROUND = shapes.box(np.array([0.1, 0.1, 0.05]))
AT_ORIGIN = np.eye(3), np.zeros(3)
MARGIN = 1e-3


def about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def points(one: ConvexPiece, X_WA, two: ConvexPiece = GROUND, X_WB=AT_ORIGIN, gap: float = 0.0) -> np.ndarray:
    """Contact points (N, 3), sorted; all must have this gap and the same normal."""
    found = contacts(pack_pieces([[one], [two]]), X_WA, X_WB, MARGIN)
    assert found
    for contact in found:
        assert contact["phi"] == pytest.approx(gap, abs=1e-12)
        np.testing.assert_allclose(contact["n"], found[0]["n"], atol=1e-12)
    return np.array(sorted(np.round(contact["a"], 9).tolist() for contact in found))


def test_a_box_face_on_a_box_face_gives_its_four_corners():
    small = shapes.box(np.array([0.02, 0.02, 0.05]))
    corners = points(small, (np.eye(3), np.array([0.03, 0.02, 0.05])))
    np.testing.assert_allclose(corners[:, :2], [[0.02, 0.01], [0.02, 0.03], [0.04, 0.01], [0.04, 0.03]], atol=1e-9)
    # The other way round the small face is the one below.
    corners = points(GROUND, (np.eye(3), np.array([0.0, 0.0, 0.05])), small)
    np.testing.assert_allclose(np.abs(corners[:, :2]), 0.01, atol=1e-9)


def test_equal_boxes_turned_by_45_degrees_meet_in_edge_crossings():
    found = points(GROUND, (about_z(np.pi / 4), np.array([0.0, 0.0, 0.05])))
    # The overlap is an octagon with corners (0.05, 0.05 tan 22.5 deg); four of them remain.
    assert found.shape == (4, 3)
    expected = np.sort([0.05, 0.05 * np.tan(np.pi / 8)])
    np.testing.assert_allclose(np.sort(np.abs(found[:, :2]), axis=1), np.tile(expected, (4, 1)), atol=1e-9)
    assert np.linalg.matrix_rank(found[:, :2] - found[:, :2].mean(axis=0)) == 2


def test_a_box_edge_on_a_face_gives_both_ends():
    bar = shapes.box(np.array([0.06, 0.02, 0.02]))
    height = 0.025 + 0.01 * np.sqrt(2.0)
    found = points(bar, (about_x(np.pi / 4), np.array([0.0, 0.0, height])))
    np.testing.assert_allclose(found, [[-0.03, 0.0, 0.025], [0.03, 0.0, 0.025]], atol=1e-9)
    # It ends at the border of the face where the bar overhangs.
    found = points(bar, (about_x(np.pi / 4), np.array([0.04, 0.0, height])))
    np.testing.assert_allclose(found, [[0.01, 0.0, 0.025], [0.05, 0.0, 0.025]], atol=1e-9)


@pytest.mark.parametrize("make", [shapes.capsule, shapes.cylinder])
@pytest.mark.parametrize("gap", [5e-4, 0.0, -5e-4])
def test_an_upright_stick_touches_a_vertical_face_twice(make, gap):
    X_WA = np.eye(3), np.array([0.06 + gap, 0.0, 0.01])
    # Longer than the face: where its line of contact leaves the face.
    found = points(make(0.01, 0.1), X_WA, gap=gap)
    np.testing.assert_allclose(found[:, 2], [-0.025, 0.025], atol=1e-9)
    # Shorter: its own ends.
    found = points(make(0.01, 0.02), X_WA, gap=gap)
    np.testing.assert_allclose(found[:, 2], [0.0, 0.02], atol=1e-9)
    np.testing.assert_allclose(found[:, 0], 0.05 + gap, atol=1e-9)


@pytest.mark.parametrize("make", [shapes.capsule, shapes.cylinder])
def test_a_lying_stick_touches_a_face_twice(make):
    found = points(make(0.02, 0.06), (about_x(np.pi / 2), np.array([0.0, 0.0, 0.045])))
    np.testing.assert_allclose(found, [[0.0, -0.03, 0.025], [0.0, 0.03, 0.025]], atol=1e-9)


def test_a_standing_cylinder_touches_with_points_about_its_axis():
    foot = shapes.cylinder(0.02, 0.1)
    found = points(foot, (np.eye(3), np.array([0.0, 0.0, 0.075])))
    assert len(found) == 4
    np.testing.assert_allclose(np.linalg.norm(found[:, :2], axis=1), 0.02, atol=1e-9)
    np.testing.assert_allclose(found.mean(axis=0), [0.0, 0.0, 0.025], atol=1e-9)
    # They are the points that the table has for the floor.
    table = pack_pieces([[foot], [GROUND]])
    for contact in contacts(table, (np.eye(3), np.array([0.0, 0.0, 0.075])), AT_ORIGIN, MARGIN):
        places = table.floor_points[table.floor_owners == 0, :3]
        assert np.min(np.linalg.norm(places - contact["row"][1:4], axis=1)) < 1e-15
    # Half over the border: the support ends where the rim crosses the edge.
    found = points(foot, (np.eye(3), np.array([0.05, 0.0, 0.075])))
    assert np.max(found[:, 0]) == pytest.approx(0.05, abs=1e-9)
    on_edge = found[found[:, 0] > 0.05 - 1e-9]
    np.testing.assert_allclose(np.sort(on_edge[:, 1]), [-0.02, 0.02], atol=1e-9)
    # A box on a cylinder that is smaller than its face.
    found = points(GROUND, (np.eye(3), np.array([0.0, 0.0, 0.075])), foot)
    assert len(found) == 4


def test_sticks_side_by_side_touch_at_both_ends_of_their_overlap():
    capsule, cylinder = shapes.capsule(0.02, 0.1), shapes.cylinder(0.03, 0.1)
    for one, two in ((capsule, capsule), (capsule, cylinder), (cylinder, cylinder)):
        X_WA = np.eye(3), np.array([one.radius + two.radius, 0.0, 0.03])
        found = points(one, X_WA, two)
        np.testing.assert_allclose(found, [[two.radius, 0.0, -0.02], [two.radius, 0.0, 0.05]], atol=1e-9)
        # Ends of both at the same place come once.
        found = points(one, (np.eye(3), np.array([one.radius + two.radius, 0.0, 0.0])), two)
        np.testing.assert_allclose(found, [[two.radius, 0.0, -0.05], [two.radius, 0.0, 0.05]], atol=1e-9)


def test_cylinders_end_to_end_and_crosswise():
    wide, narrow = shapes.cylinder(0.03, 0.1), shapes.cylinder(0.02, 0.1)
    found = points(narrow, (np.eye(3), np.array([0.0, 0.0, 0.1])), wide)
    assert len(found) == 4
    np.testing.assert_allclose(np.linalg.norm(found[:, :2], axis=1), 0.02, atol=1e-9)
    for stick in (shapes.capsule(0.02, 0.1), narrow):
        found = points(stick, (about_x(np.pi / 2), np.array([0.0, 0.0, 0.07])), wide)
        np.testing.assert_allclose(found, [[0.0, -0.03, 0.05], [0.0, 0.03, 0.05]], atol=1e-9)


def resting_scenes():
    """Poses with parallel features, many of them with several equal alternatives."""
    on_top = np.array([0.0, 0.0, 0.05])
    turned = about_z(0.3)
    yield shapes.box(np.array([0.1, 0.1, 0.05])), (np.eye(3), on_top)
    yield shapes.box(np.array([0.1, 0.1, 0.05])), (turned, on_top)
    yield shapes.box(np.array([0.1, 0.1, 0.05])), (np.eye(3), np.array([0.02, 0.1, 0.0]))
    yield shapes.capsule(0.01, 0.1), (np.eye(3), np.array([0.06, 0.0, 0.0]))
    yield shapes.capsule(0.01, 0.05), (np.eye(3), np.array([0.06, 0.0, 0.0]))
    yield shapes.capsule(0.01, 0.1), (about_x(np.pi / 2), np.array([0.0, 0.0, 0.035]))
    yield shapes.cylinder(0.01, 0.1), (np.eye(3), np.array([0.06, 0.0, 0.0]))
    yield shapes.cylinder(0.01, 0.05), (np.eye(3), np.array([0.06, 0.0, 0.0]))
    yield shapes.cylinder(0.02, 0.05), (np.eye(3), on_top)
    yield shapes.cylinder(0.02, 0.06), (about_x(np.pi / 2), np.array([0.0, 0.0, 0.045]))


@pytest.mark.parametrize("number", range(10))
@pytest.mark.parametrize("gap", [1e-5, 0.0, -1e-5])
def test_rounding_of_the_pose_does_not_change_the_features(number, gap):
    piece, (R_WA, p_WA) = list(resting_scenes())[number]
    table = pack_pieces([[piece], [GROUND]])
    lift = gap * p_WA / np.linalg.norm(p_WA)
    generator = np.random.default_rng(number)
    expected = contacts(table, (R_WA, p_WA + lift), AT_ORIGIN, MARGIN)
    assert len(expected) >= 2
    for _ in range(50):
        R_noisy = R_WA + 1e-16 * generator.normal(size=(3, 3))
        p_noisy = p_WA + lift + 1e-16 * generator.normal(size=3)
        R_WB = np.eye(3) + 1e-16 * generator.normal(size=(3, 3))
        found = contacts(table, (R_noisy, p_noisy), (R_WB, 1e-16 * generator.normal(size=3)), MARGIN)
        assert len(found) == len(expected)
        for contact, other in zip(found, expected, strict=True):
            assert contact["kinds"] == other["kinds"]
            np.testing.assert_allclose(contact["row"], other["row"], atol=1e-9)


def test_the_same_poses_give_the_same_bits():
    generator = np.random.default_rng(5)
    cloud = generator.normal(size=(60, 3))
    hull = shapes.convex_hull(0.04 * cloud / np.linalg.norm(cloud, axis=1, keepdims=True))
    for one in (hull, shapes.cylinder(0.03, 0.05), shapes.capsule(0.02, 0.05)):
        table = pack_pieces([[one], [hull]])
        for _ in range(10):
            X_WA = random_rotation(generator), 0.05 * generator.normal(size=3)
            first, second = (contacts(table, X_WA, AT_ORIGIN, 0.05) for _ in range(2))
            assert [c["row"].tobytes() for c in first] == [c["row"].tobytes() for c in second]


def test_a_tilted_face_keeps_only_what_is_within_the_margin():
    # One edge touches, the opposite one is 0.1 sin(0.05) = 5 mm up: inside a margin of 10 mm, outside of one
    # of 1 mm.
    X_WA = about_x(0.05), np.array([0.0, 0.0, 0.025 + 0.05 * np.sin(0.05) + 0.025 * np.cos(0.05)])
    table = pack_pieces([[GROUND], [GROUND]])
    assert len(contacts(table, X_WA, AT_ORIGIN, 1e-3)) == 2
    assert len(contacts(table, X_WA, AT_ORIGIN, 1e-2)) == 4


def test_rows_are_never_written_beyond_the_end():
    from pinwm_drake.geometry.entry import collide_bodies, collide_floor

    pieces = [GROUND, shapes.cylinder(0.02, 0.05), shapes.capsule(0.02, 0.05)]
    table = pack_pieces([pieces, pieces])
    X_WA = np.eye(3), np.array([0.0, 0.0, 0.05])
    for room in range(12):
        rows = np.full((room + 4, 16), -1.0)
        count = collide_bodies(table, 0, *X_WA, 1, *AT_ORIGIN, 0.1, rows[:room], 0)
        count = collide_floor(table, 0, np.ones(3), *X_WA, np.zeros(6), 0.0, 0.0, 0.1, rows[:room], count)
        assert count == room
        assert np.all(rows[room:] == -1.0)
