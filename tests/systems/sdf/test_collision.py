from collections import Counter

import numpy as np
import pytest
from pydrake.geometry import AddCompliantHydroelasticProperties, Mesh, ProximityProperties
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.geometry.pieces import HULL, ConvexPiece
from pinwm_drake.geometry.shapes import box
from pinwm_drake.systems.sdf.collision import volume_mesh


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
