# SPDX-License-Identifier: MIT
"""Which meshes are a sphere, capsule, cylinder or box, and which only look like one."""

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pinwm_drake.geometry import shapes
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.geometry.pieces import pack_pieces
from pinwm_drake.geometry.primitive import acting_pieces, fit, primitives_of
from pinwm_drake.geometry.stored_pieces import mesh_pieces, mesh_primitives
from pinwm_drake.models import OBJECT_NAMES, object_model
from tests.geometry.oracles import contacts, random_rotation

CREATE = trimesh.creation
# Size is told to this [m]: corners are exact, and coordinates are rounded to 1e-9 m.
EXACT = 3e-9


def moved(mesh: trimesh.Trimesh, seed: int = 0) -> trimesh.Trimesh:
    """Return a mesh in a random pose."""
    generator = np.random.default_rng(seed)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.random(rng=generator).as_matrix(), generator.normal(size=3)
    return mesh.copy().apply_transform(X)


def uncapped_centre(radius: float, length: float, sections: int) -> trimesh.Trimesh:
    """Return a prism whose caps have no vertex in the middle, as those of CAD programs."""
    angles = 2.0 * np.pi * np.arange(sections) / sections
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    points = [np.column_stack([ring, np.full(sections, z)]) for z in (-0.5 * length, 0.5 * length)]
    return trimesh.convex.convex_hull(np.concatenate(points))


def chamfered_box(edge: float, chamfer: float) -> trimesh.Trimesh:
    half, low = 0.5 * edge, 0.5 * edge - chamfer
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    places = [np.where(np.arange(3) == axis, half, low) for axis in range(3)]
    return trimesh.convex.convex_hull(np.concatenate([corners * place for place in places]))


# A prism of n sides is inside its cylinder by the sagitta r (1 - cos(pi / n)) in the middle of a side.
@pytest.mark.parametrize("make", [lambda r, h, n: CREATE.cylinder(r, h, sections=n), uncapped_centre])
@pytest.mark.parametrize("length", [0.004, 0.04, 0.04 * math.sqrt(3), 0.08, 0.3])
@pytest.mark.parametrize("sections", [33, 64, 256])
def test_prism_of_many_sides_is_a_cylinder_off_by_its_sagitta(make, length, sections):
    mesh = moved(make(0.04, length, sections), sections)
    found = fit(mesh.vertices)
    assert found.kind == "cylinder"
    assert found.size == pytest.approx((0.04, length), abs=EXACT)
    assert found.deviation == pytest.approx(0.04 * (1.0 - math.cos(math.pi / sections)), abs=EXACT)
    assert found.p == pytest.approx(mesh.bounds.mean(axis=0), abs=1e-4)


def test_sphere_is_off_by_the_distance_of_its_faces_from_the_centre():
    mesh = CREATE.icosphere(4, 0.03)
    least = np.einsum("fi,fi->f", mesh.face_normals, mesh.triangles[:, 0]).min()
    found = fit(moved(mesh).vertices)
    assert (found.kind, found.size) == ("sphere", pytest.approx((0.03,), abs=EXACT))
    assert found.deviation == pytest.approx(0.03 - least, abs=EXACT)


def test_capsule_is_found_and_its_deviation_is_the_largest_over_many_directions():
    mesh = moved(CREATE.capsule(0.06, 0.02, count=[64, 64]))
    found = fit(mesh.vertices)
    assert (found.kind, found.size) == ("capsule", pytest.approx((0.02, 0.06), abs=EXACT))
    # Support functions of convex bodies differ by no more than their Hausdorff distance, and by as much somewhere.
    n = np.random.default_rng(0).normal(size=(20_000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    seen = np.abs(found.reach(n) - (n @ mesh.vertices.T).max(axis=1)).max()
    assert 0.9 * found.deviation < seen <= found.deviation + EXACT


@pytest.mark.parametrize("size", [(0.05, 0.06, 0.07), (0.05, 0.05, 0.05), (0.1, 0.1, 0.01)])
def test_box_with_divided_faces_is_a_box(size):
    found = fit(moved(CREATE.box(size).subdivide().subdivide()).vertices)
    assert found.kind == "box"
    assert sorted(found.size) == pytest.approx(sorted(size), abs=EXACT)
    assert found.deviation < EXACT


def test_noise_below_the_tolerance_is_no_obstacle():
    generator = np.random.default_rng(0)
    mesh = CREATE.cylinder(0.04, 0.08, sections=96).subdivide()
    mesh.vertices += generator.normal(0.0, 2e-5, mesh.vertices.shape)
    found = fit(moved(mesh).vertices)
    assert found.kind == "cylinder"
    assert found.size == pytest.approx((0.04, 0.08), abs=6e-5)  # outermost ones of 3 sigma count


@pytest.mark.parametrize(
    "mesh",
    [
        CREATE.cylinder(0.04, 0.08, sections=16),
        CREATE.cylinder(0.06, 0.08, sections=32),  # 0.29 mm: within 0.5 %, not within 0.2 mm
        CREATE.cylinder(0.01, 0.08, sections=24),  # 0.09 mm: within 0.2 mm, not within 0.5 %
        CREATE.icosphere(2, 0.03),
        CREATE.torus(0.04, 0.01),
        CREATE.cone(0.04, 0.08),
        chamfered_box(0.05, 3e-4),
        trimesh.convex.convex_hull([v for v in uncapped_centre(0.04, 0.08, 64).vertices if v[0] > -0.03]),
    ],
    ids=["16 sides", "0.29 mm", "0.9 %", "coarse ball", "torus", "cone", "chamfer", "flat side"],
)
def test_what_is_off_by_more_is_refused(mesh):
    assert fit(moved(mesh).vertices) is None


def test_slanted_side_is_refused_from_where_it_leaves_the_tolerance():
    # A cone of half-angle a and length h leaves the best cylinder by h tan(a) / 2 at each end.
    for angle, kind in ((0.001, "cylinder"), (math.radians(1.0), None)):
        mesh = uncapped_centre(0.04, 0.08, 64)
        mesh.vertices[:, :2] *= 1.0 - mesh.vertices[:, 2:] * math.tan(angle) / 0.04
        found = fit(moved(mesh).vertices)
        assert (found and found.kind) == kind


def test_small_chamfer_leaves_the_faces_of_a_box_where_they_are():
    found = fit(moved(chamfered_box(0.05, 1e-4)).vertices)
    assert found.size == pytest.approx((0.05,) * 3, abs=EXACT)
    assert found.deviation == pytest.approx(1e-4 * 2.0 / math.sqrt(3.0), abs=EXACT)  # corner to the corner's face


def tube(inner: float) -> trimesh.Trimesh:
    return CREATE.annulus(inner, 0.04, 0.08, sections=64)


def test_ends_of_a_tube_are_open_and_its_pieces_stay_behind_it():
    mesh = tube(0.036)
    x, y, _ = mesh.vertices.T
    middles = np.pi * (2 * np.arange(64) + 1) / 64
    segments = [
        shapes.convex_hull(mesh.vertices[np.abs(np.angle((x + 1j * y) * np.exp(-1j * a))) < 0.06]) for a in middles
    ]
    (found,) = primitives_of(mesh, segments)
    assert (found.kind, found.open_ends) == ("cylinder", (True, True))
    shell, *behind = acting_pieces(segments, [found])
    assert (shell.hides, len(behind)) == (len(segments), len(segments))


def test_side_with_a_hole_is_no_cylinder():
    mesh = CREATE.cylinder(0.04, 0.08, sections=64)
    hole = CREATE.cylinder(0.01, 0.1, sections=16)
    hole.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    drilled = trimesh.boolean.difference([mesh, hole], engine="manifold")
    assert fit(drilled.vertices) is not None
    assert primitives_of(drilled, [shapes.convex_hull(mesh.vertices)]) == ()


WORDS = {"cube": "box", "mug": "cylinder", "mug_handle": "cylinder"}


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_shipped_objects(name):
    path = object_model(name).mesh_path
    found = mesh_primitives(path)
    assert [one.kind for one in found] == ([WORDS[name]] if name in WORDS else [])
    pieces = mesh_pieces(path)
    acting = acting_pieces(pieces, found)
    if name == "mug":
        assert found[0].size == (0.04, 0.08)
        assert found[0].open_ends == (False, True)
        assert acting[0].hides == len(pieces) == 65
    elif name == "mug_handle":  # wall and base are one cylinder, the handle's three pieces stay
        assert acting[0].hides == len(pieces) - 3 == 65
        assert load_mesh(path).bounds[0, 0] == pytest.approx(found[0].p[0] - 0.04, abs=1e-8)
    else:
        assert acting == pieces


def test_a_piece_of_a_wall_with_the_root_of_a_handle_leaves_the_wall_round():
    # As a decomposition makes it, which knows no handle.
    path = object_model("mug_handle").mesh_path
    (expected,), pieces = mesh_primitives(path), mesh_pieces(path)
    middle = np.array(expected.p)
    wall = [k for k, one in enumerate(pieces) if expected.depth(one.vertices).min() > -1e-6]
    k = max(wall, key=lambda k: pieces[k].vertices[:, 0].mean())
    root = pieces[k].vertices.mean(axis=0)
    root[:2] += 2.5e-3 * (root - middle)[:2] / np.linalg.norm((root - middle)[:2])
    pieces[k] = shapes.convex_hull(np.concatenate([pieces[k].vertices, root[None] + [[0, 0, -0.01], [0, 0, 0.01]]]))
    assert expected.depth(pieces[k].vertices).min() < -3e-4
    (found,) = primitives_of(load_mesh(path), pieces)
    assert (found.kind, found.open_ends) == ("cylinder", expected.open_ends)
    assert found.size == pytest.approx(expected.size, abs=1e-5)
    # The piece stays, as it stands out.
    assert len(acting_pieces(pieces, [found])) == 1 + len(pieces)


@pytest.mark.parametrize("name", ["mug", "mug_handle"])
@pytest.mark.parametrize("pusher", [shapes.sphere(0.01), shapes.capsule(0.008, 0.04), shapes.cylinder(0.008, 0.04)])
def test_pusher_meets_a_round_mug_as_its_pieces_outside_and_in_its_cavity(name, pusher):
    path, generator = object_model(name).mesh_path, np.random.default_rng(1)
    pieces, (shell,) = mesh_pieces(path), mesh_primitives(path)
    tables = [pack_pieces([body, [pusher]]) for body in (pieces, acting_pieces(pieces, [shell]))]
    margin, inside, met = 2e-3, 0, 0
    for _ in range(1500):
        X_WM = (random_rotation(generator), np.zeros(3))
        X_WP = (random_rotation(generator), generator.uniform(-0.065, 0.065, 3))
        flat, round_ = (min((c["phi"] for c in contacts(t, X_WM, X_WP, margin)), default=margin) for t in tables)
        # Facets are inside of the cylinder by its deviation at most; overlaps by a millimetre may be on another face.
        if flat > -1e-3:
            assert abs(flat - round_) < shell.deviation + 1e-9
            met += flat < margin
            p_MP = X_WM[0].T @ X_WP[1]
            in_it = shell.depth(p_MP[None])[0] > 0.0
            inside += in_it
            if in_it:  # nothing of the shell is in the way
                assert flat == round_
    assert inside > 25
    assert met > 75
