# SPDX-License-Identifier: MIT
"""The objects of the tasks as exact pieces, and approximate decomposition."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry import shapes
from pinwm_drake.geometry.convex import decompose, hollow_mug, mug_center, t_block
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.pieces import ConvexPiece, pack_pieces
from pinwm_drake.models import model_path
from tests.geometry.oracles import contacts

AT_ORIGIN = np.eye(3), np.zeros(3)
INNER_RADIUS, FLOOR_OF_MUG, OPENING = 0.036, 0.004 - mug_center(), 0.08 - mug_center()


def solid(pieces: list[ConvexPiece]) -> trimesh.Trimesh:
    hulls = [ConvexHull(piece.vertices) for piece in pieces]
    return trimesh.util.concatenate([trimesh.convex.convex_hull(hull.points) for hull in hulls])


def touching(pieces: list[ConvexPiece], radius: float, p_WP: np.ndarray, margin: float = 1e-4) -> list[dict]:
    table = pack_pieces([pieces, [shapes.sphere(radius)]])
    return contacts(table, AT_ORIGIN, (np.eye(3), p_WP), margin)


def test_the_origin_of_the_pieces_is_the_centre_of_mass():
    for pieces in (t_block(), hollow_mug(), hollow_mug(segments=7, wall=0.01)):
        np.testing.assert_allclose(mass_properties(solid(pieces), density=1.0).p_com, 0.0, atol=1e-9)


def test_the_pieces_have_the_mass_properties_of_the_models():
    for pieces, name in ((t_block(), "t_block/t_block.obj"), (hollow_mug(segments=64), "mug/mug.obj")):
        model = mass_properties(load_mesh(model_path(name)), mass=1.0)
        ours = mass_properties(solid(pieces), mass=1.0)
        # The mesh files carry nine digits.
        np.testing.assert_allclose(ours.p_com, model.p_com, atol=1e-9)
        np.testing.assert_allclose(ours.inertia, model.inertia, atol=1e-11)


@pytest.mark.nightly
def test_a_sphere_reaches_the_inside_of_the_mug():
    mug = hollow_mug()
    assert not touching(mug, 0.02, np.array([0.0, 0.0, 0.01]))
    # The inner wall: a facet in the direction of half a segment, at its inradius.
    half = np.pi / 16
    reach = INNER_RADIUS * np.cos(half)
    outward = np.array([np.cos(half), np.sin(half), 0.0])
    (contact,) = touching(mug, 0.01, (reach - 0.01) * outward)
    assert contact["phi"] == pytest.approx(0.0, abs=1e-12)
    # From the pusher (B) to the mug (A).
    np.testing.assert_allclose(contact["n"], outward, atol=1e-9)
    # The base, from inside and from outside.
    for side, height in ((-1.0, FLOOR_OF_MUG + 0.01), (1.0, -mug_center() - 0.01)):
        (contact,) = touching(mug, 0.01, np.array([0.005, 0.003, height]))
        assert contact["phi"] == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(contact["n"], [0.0, 0.0, side], atol=1e-9)
    # A ball wider than the opening rests on the rim: every contact is there.
    found = touching(mug, 0.05, np.array([0.0, 0.0, OPENING + np.sqrt(0.05**2 - INNER_RADIUS**2)]))
    assert found
    np.testing.assert_allclose([c["a"][2] for c in found], OPENING, atol=1e-9)


def test_a_sphere_passes_the_seam_of_two_pieces_without_a_bump():
    # The bar's and the stem's faces meet in the plane y = -0.015; a ball that rolls over the top feels one
    # height.
    block = t_block()
    for y in np.linspace(-0.02, -0.01, 21):
        gap = min(c["phi"] for c in touching(block, 0.01, np.array([0.0, y, 0.035]), 1e-3))
        assert gap == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"wall": 0.05}, "no inside"),
        ({"wall": 0.0}, "no inside"),
        ({"length": -1.0}, "no inside"),
        ({"segments": 2}, "segments of a mug are 2"),
    ],
)
def test_an_impossible_mug_is_refused(arguments, message):
    with pytest.raises(GeometryError, match=message):
        hollow_mug(**arguments)


def coarse_mug() -> trimesh.Trimesh:
    pieces = hollow_mug(segments=12)
    outer = pieces[0].vertices
    angles = 2.0 * np.pi * np.arange(12) / 12
    circle = np.column_stack([np.cos(angles), np.sin(angles)])

    def ring(radius: float, z: float) -> np.ndarray:
        return np.column_stack([radius * circle, np.full(12, z)])

    bottom, top = outer[:, 2].min(), OPENING
    rings = [ring(0.04, bottom), ring(0.04, top), ring(INNER_RADIUS, top), ring(INNER_RADIUS, FLOOR_OF_MUG)]
    vertices = np.concatenate([*rings, [[0.0, 0.0, bottom], [0.0, 0.0, FLOOR_OF_MUG]]])
    faces = []
    for k in range(12):
        following = (k + 1) % 12
        for lower in (0, 12, 24):
            a, b, c, d = lower + k, lower + following, lower + 12 + following, lower + 12 + k
            faces += [[a, b, c], [a, c, d]]
        faces += [[48, following, k], [49, 36 + k, 36 + following]]
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.nightly
def test_a_decomposed_mug_is_open_inside():
    # 12 segments: coacd needs seconds for them, 10 s for the 64 of the model.
    mesh = coarse_mug()
    assert mesh.is_watertight
    pieces = decompose(mesh, threshold=0.15)
    assert len(pieces) > 3
    # The inside is free for a ball of half the inner radius all along the axis, up to the base, and the ball
    # finds the base and the wall where they are, to the concavity that the pieces keep.
    for z in np.linspace(FLOOR_OF_MUG + 0.03, OPENING + 0.02, 10):
        assert not touching(pieces, 0.015, np.array([0.0, 0.0, z]))
    base = touching(pieces, 0.015, np.array([0.0, 0.0, FLOOR_OF_MUG + 0.0145]))
    assert base
    wall = touching(pieces, 0.015, np.array([INNER_RADIUS - 0.0145, 0.0, 0.01]))
    assert wall
    assert wall[0]["n"][0] > 0.9


def test_decomposition_follows_its_seed():
    ring = trimesh.creation.annulus(0.03, 0.04, 0.1, sections=6)
    first, second = (decompose(ring, threshold=0.2, seed=3) for _ in range(2))
    assert len(first) == len(second) > 2
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.vertices, two.vertices)


def test_a_decomposed_t_block_is_its_two_boxes():
    pieces = decompose(load_mesh(model_path("t_block/t_block.obj")))
    volumes = [ConvexHull(piece.vertices).volume for piece in pieces]
    np.testing.assert_allclose(volumes, [2e-4, 2e-4], rtol=1e-2)


def test_decompose_refuses_bad_arguments():
    box = trimesh.creation.box()
    with pytest.raises(GeometryError, match="threshold"):
        decompose(box, threshold=0.0)
    with pytest.raises(GeometryError, match="max_pieces"):
        decompose(box, max_pieces=0)
    with pytest.raises(GeometryError, match="watertight"):
        decompose(trimesh.Trimesh(box.vertices, box.faces[1:]))
