# SPDX-License-Identifier: MIT
"""Factories of convex pieces and the table they are packed into."""

import numpy as np
import pytest

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry import shapes
from pinwm_drake.geometry.pieces import HULL, SPHERE, ConvexPiece, pack_pieces
from tests.geometry.oracles import random_rotation


def check_table(table):
    """Planes, loops, sides and edges of every hull fit together."""
    for p in range(len(table.pieces) - 1):
        kind, vertex, face, edge = table.pieces[p]
        vertices = table.vertices[vertex : table.pieces[p + 1, 1], :3]
        faces = range(face, table.pieces[p + 1, 2])
        edges = range(edge, table.pieces[p + 1, 3])
        reach = np.linalg.norm(vertices - table.piece_spheres[p, :3], axis=1)
        assert np.all(reach <= table.piece_spheres[p, 3] + 1e-12)
        if kind != HULL:
            assert not faces
            continue
        # Euler's formula: a closed surface without handles.
        assert len(vertices) - len(edges) + len(faces) == 2
        for f in faces:
            normal, offset = table.planes[f, :3], table.planes[f, 3]
            assert np.linalg.norm(normal) == pytest.approx(1.0)
            assert np.max(vertices @ normal) == pytest.approx(offset, abs=1e-12)
            corners = slice(table.faces[f], table.faces[f + 1])
            loop = table.vertices[table.corners[corners, 0], :3]
            np.testing.assert_allclose(loop @ normal, offset, atol=1e-7)
            # Counter-clockwise from outside, and inside of all of its sides.
            turns = np.cross(np.roll(loop, -1, axis=0) - loop, np.roll(loop, -2, axis=0) - np.roll(loop, -1, axis=0))
            assert np.all(turns @ normal > 0.0)
            inside = loop @ table.sides[corners, :3].T - table.sides[corners, 3]
            assert np.max(inside) < 1e-9
            for start, (v, e), following in zip(loop, table.corners[corners], np.roll(loop, -1, axis=0), strict=True):
                v0, v1, left, right = table.edges[e]
                assert (v == v0 and f == left) or (v == v1 and f == right)
                span = table.edge_lines[e, 3] * table.edge_lines[e, :3]
                np.testing.assert_allclose(np.abs(following - start), np.abs(span), atol=1e-12)


def test_shapes_are_placed_in_the_body_frame():
    generator = np.random.default_rng(1)
    R_BG, p_BG = random_rotation(generator), generator.normal(size=3)
    stick = shapes.capsule(0.01, 0.1, (R_BG, p_BG))
    np.testing.assert_allclose(stick.vertices, [p_BG - 0.05 * R_BG[:, 2], p_BG + 0.05 * R_BG[:, 2]])
    block = shapes.box(np.array([1.0, 2.0, 3.0]), (R_BG, p_BG))
    in_G = (block.vertices - p_BG) @ R_BG
    np.testing.assert_allclose(np.abs(in_G), np.tile([0.5, 1.0, 1.5], (8, 1)))
    check_table(pack_pieces([[stick, block], [shapes.cylinder(0.1, 0.2), shapes.sphere(0.1, p_BG)]]))


def test_convex_hull_merges_coplanar_triangles_and_drops_what_is_not_a_corner():
    block = shapes.box(np.array([0.1, 0.04, 0.05]))
    generator = np.random.default_rng(2)
    inside = generator.uniform(-0.5, 0.5, size=(50, 3)) * [0.1, 0.04, 0.05]
    on_face = inside[:20] * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.025]
    on_edge = np.array([[0.01, 0.02, 0.025], [-0.03, 0.02, 0.025]])
    hull = shapes.convex_hull(np.concatenate([inside, on_face, on_edge, block.vertices]))
    assert sorted(map(tuple, hull.vertices)) == sorted(map(tuple, block.vertices))
    assert sorted(len(face) for face in hull.faces) == [4] * 6
    check_table(pack_pieces([[hull]]))


@pytest.mark.parametrize("tolerance", [0.0, 1e-6, 1e-4, 1e-2])
def test_convex_hull_closes_whatever_it_merges(tolerance):
    generator = np.random.default_rng(3)
    for size in (4, 10, 200):
        cloud = generator.normal(size=(size, 3))
        # Rounded as a text file rounds, so that many triangles are nearly coplanar.
        hull = shapes.convex_hull(np.round(cloud * [0.05, 0.05, 0.02], 4), tolerance)
        table = pack_pieces([[hull]])
        if tolerance < 1e-4:
            check_table(table)


def test_convex_hull_of_the_released_pusher_closes(shared):
    from pinwm_drake.geometry.meshes import load_mesh

    mesh = load_mesh(shared / "data/pinwm_push_t/meshes/pusher.obj")
    hull = shapes.convex_hull(mesh.vertices)
    check_table(pack_pieces([[hull]]))
    # One rounded box, as large as the mesh.
    np.testing.assert_allclose(np.ptp(hull.vertices, axis=0), np.ptp(mesh.vertices, axis=0))
    assert len(hull.vertices) == 297


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: shapes.sphere(0.0), "radius of a sphere is 0.0"),
        (lambda: shapes.sphere(0.1, np.array([np.nan, 0.0, 0.0])), "p_BG of a sphere"),
        (lambda: shapes.capsule(0.1, -1.0), "length of a capsule is -1.0"),
        (lambda: shapes.cylinder(np.inf, 1.0), "radius of a cylinder is inf"),
        (lambda: shapes.cylinder(1.0, 1.0, (2.0 * np.eye(3), np.zeros(3))), "rotation matrix"),
        (lambda: shapes.box(np.array([1.0, 0.0, 1.0])), "edge length of a box is 0.0"),
        (lambda: shapes.box(np.array([1.0, 1.0])), "three finite numbers"),
        (lambda: shapes.convex_hull(np.zeros((3, 3))), "n of 4 or more"),
        (
            lambda: shapes.convex_hull(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])),
            "in one plane",
        ),
        (lambda: shapes.convex_hull(np.full((5, 3), np.nan)), "not finite"),
        (lambda: pack_pieces([[shapes.sphere(1.0)], []]), "body 1 has no pieces"),
        (lambda: pack_pieces([[ConvexPiece(7, np.zeros((1, 3)))]]), "kind 7"),
        (lambda: pack_pieces([[ConvexPiece(SPHERE, np.full((1, 3), np.inf), 1.0)]]), "not finite"),
        (lambda: pack_pieces([[ConvexPiece(HULL, np.eye(4, 3), 0.0, ((0, 1, 2),))]]), "do not close"),
    ],
)
def test_bad_shapes_are_refused_with_what_is_allowed(make, message):
    with pytest.raises(GeometryError, match=message) as error:
        make()
    assert "allowed" in str(error.value) or "must not" in str(error.value)
