# SPDX-License-Identifier: MIT
from collections import Counter

import numpy as np
import pytest
import trimesh
from pydrake.geometry import AddCompliantHydroelasticProperties, Mesh, ProximityProperties
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.geometry.pieces import CYLINDER, HULL, SPHERE, ConvexPiece
from pinwm_drake.geometry.shapes import box, convex_hull
from pinwm_drake.systems.sdf.collision import as_box, plain_pieces, volume_mesh


def box_with_a_point_on_an_edge(size, depth, slivers):
    """A box, and in each of two of its faces a corner more, on an edge, that deep [m] inside of it.

    The loops of so many of the two begin where a sliver is the first triangle of the fan.
    """
    piece = box([size] * 3)
    first = piece.faces[0]
    a, b = first[:2]
    between = 0.4 * piece.vertices[a] + 0.6 * piece.vertices[b]
    inwards = np.mean([piece.vertices[k] for k in first], axis=0) - between
    point = between + depth * inwards / np.linalg.norm(inwards)
    more = len(piece.vertices)
    faces = []
    for face in piece.faces:
        loop = list(face)
        k = next((k for k in range(4) if {loop[k - 1], loop[k]} == {a, b}), None)
        if k is not None:
            loop.insert(k, more)
            k = loop.index(more) - (1 if slivers > 0 else 2)
            slivers -= 1
            loop = loop[k:] + loop[:k]
        faces.append(tuple(loop))
    return ConvexPiece(HULL, np.concatenate([piece.vertices, [point]]), 0.0, tuple(faces))


def tetrahedra(text):
    """Corners (n, 4, 3) of a VTK file."""
    lines = text.splitlines()
    points = int(lines[4].split()[1])
    corners = np.array([[float(x) for x in line.split()] for line in lines[5 : 5 + points]])
    cells = int(lines[5 + points].split()[1])
    return corners[np.array([[int(k) for k in line.split()[1:]] for line in lines[6 + points : 6 + points + cells]])]


def volumes(text):
    """Volumes (n,) as Drake counts them: the fourth corner is on the side from which the others turn left."""
    a, b, c, d = tetrahedra(text).swapaxes(0, 1)
    return np.einsum("nk,nk->n", np.cross(b - a, c - a), d - a) / 6.0


def closed(text):
    """Whether each side of a tetrahedron with the middle, which is their fourth corner, is one of another as well."""
    sides = [frozenset(map(tuple, each[[j, k]])) for each in tetrahedra(text) for j, k in ((0, 1), (1, 2), (2, 0))]
    return set(Counter(sides).values()) == {2}


def registered(path):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    properties = ProximityProperties()
    AddCompliantHydroelasticProperties(0.01, 1e6, properties)
    plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(), Mesh(str(path)), "pieces", properties)
    return builder.Build()


@pytest.mark.parametrize("depth", [0.0, 1e-8, -1e-8])
@pytest.mark.parametrize("slivers", [1, 2])
@pytest.mark.parametrize("size", [1e-2, 1.0])
def test_slivers_of_a_face_do_not_keep_drake_from_reading_it(size, slivers, depth, tmp_path):
    piece = box_with_a_point_on_an_edge(size, size * depth, slivers)
    text, _ = volume_mesh([piece], 2.0)
    assert volumes(text).min() > 0
    assert closed(text)
    assert volumes(text).sum() == pytest.approx(size**3, rel=1e-6)
    path = tmp_path / "pieces.vtk"
    path.write_text(text)
    registered(path)


def test_a_small_piece_of_a_large_object_is_whole():
    large, small = box([0.2, 0.2, 0.2]), box([1e-3, 1e-3, 1e-3], (np.eye(3), np.array([0.3, 0.0, 0.0])))
    text, depth = volume_mesh([large, small], 0.2)
    assert volumes(text).sum() == pytest.approx(0.2**3 + 1e-9, rel=1e-12)
    assert depth == pytest.approx(0.1)


CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5


@pytest.mark.parametrize("turn", [[0, 0, 0], [0.3, -0.2, 0.5], [-0.4, 0.6, -0.1]])
@pytest.mark.parametrize("order", range(4))
def test_a_box_is_found_where_it_is(turn, order):
    sizes, R, p = np.array([0.1, 0.04, 0.05]), RollPitchYaw(turn).ToRotationMatrix(), np.array([0.01, -0.02, 0.03])
    rows = np.random.default_rng(order).permutation(8)
    found, X = as_box(convex_hull((CORNERS * sizes)[rows] @ R.matrix().T + p))
    np.testing.assert_allclose(found, sizes, rtol=1e-12)
    np.testing.assert_allclose(X.translation(), p, atol=1e-12)
    np.testing.assert_allclose(X.rotation().matrix(), R.matrix(), atol=1e-9)


def test_a_slab_is_the_box_about_it_where_another_hull_covers_what_that_adds():
    outer, inner = 0.02, 0.019
    corners = np.array([[x, s * (outer if x else inner), z] for x in (0.0, 0.004) for s in (-1, 1) for z in (0.0, 0.1)])
    slab, cover = convex_hull(corners), box([0.05] * 3)
    assert plain_pieces([slab])[0] is slab
    made = plain_pieces([slab, convex_hull(cover.vertices * [0.08, 0.9, 4.0] + [0.002, 0.0, 0.05])])[0]
    found, _ = as_box(made)
    np.testing.assert_allclose(sorted(found), [0.004, 0.04, 0.1], atol=1e-9)


def test_round_hulls_are_round():
    ball = trimesh.creation.icosphere(5, 0.03)
    rod = trimesh.creation.cylinder(0.02, 0.1, sections=64)
    found = plain_pieces([convex_hull(np.asarray(mesh.vertices)) for mesh in (ball, rod)])
    assert [piece.kind for piece in found] == [SPHERE, CYLINDER]
    assert [piece.radius for piece in found] == pytest.approx([0.03, 0.02], abs=5e-5)


def test_what_is_nearly_a_box_is_none():
    leaning, tapered, dented = np.tile(CORNERS, (3, 1, 1))
    leaning[:, 0] += 1e-4 * leaning[:, 1]
    tapered[:, 0] *= 1 + 1e-4 * tapered[:, 2]
    dented[0] *= 1 - 1e-4
    for corners in (leaning, tapered, dented, 1.0 * CORNERS[:7]):
        assert as_box(convex_hull(0.05 * corners)) is None
    # A prism over a regular hexagon, and one over a pentagon, whose corners are ten.
    for n in (6, 5, 4, 3):
        ring = 0.05 * np.exp(2j * np.pi * np.arange(n) / n)
        prism = np.vstack([np.column_stack([ring.real, ring.imag, np.full(n, z)]) for z in (0, 0.07)])
        assert (as_box(convex_hull(prism)) is None) == (n != 4)
