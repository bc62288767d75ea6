# SPDX-License-Identifier: MIT
"""Voids, overlaps and nests of closed bodies in files of every format, against sums of boxes and balls."""

import warnings

import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import GeometryError, InputError
from pinwm_drake.geometry.meshes import load_mesh, load_pieces, mass_properties
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.scene import make_scene

OUTER, INNER = (0.1, 0.06, 0.05), (0.04, 0.03, 0.02)


def body(size, at=(0.0, 0.0, 0.0), *, void=False):
    mesh = trimesh.creation.box(extents=size)
    mesh.apply_translation(at)
    if void:
        mesh.invert()
    return mesh


def summed(*terms):
    """Volume, centre, and inertia / mass of boxes (sign, size, centre), by the parallel axis theorem."""
    volume, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for sign, size, centre in terms:
        size, centre = np.array(size), np.array(centre)
        own = sign * np.prod(size)
        volume, moment = volume + own, moment + own * centre
        inertia += own * (np.diag(size @ size - size**2) / 12 + centre @ centre * np.eye(3) - np.outer(centre, centre))
    centre = moment / volume
    return volume, centre, inertia / volume - (centre @ centre * np.eye(3) - np.outer(centre, centre))


ORIGIN = (0.0, 0.0, 0.0)
CASES = {
    "void": (
        [body(OUTER), body(INNER, (0.02, 0.005, 0), void=True)],
        [(1, OUTER, ORIGIN), (-1, INNER, (0.02, 0.005, 0))],
    ),
    "void, all wound inwards": ([body(OUTER, void=True), body(INNER)], [(1, OUTER, ORIGIN), (-1, INNER, ORIGIN)]),
    "body in a void in a body": (
        [body((0.01, 0.01, 0.01), (0.02, 0, 0)), body(INNER, (0.01, 0, 0), void=True), body(OUTER)],
        [(1, OUTER, ORIGIN), (-1, INNER, (0.01, 0, 0)), (1, (0.01, 0.01, 0.01), (0.02, 0, 0))],
    ),
    "void against the wall": (
        [body(OUTER), body(INNER, (0.03, 0.015, 0), void=True)],
        [(1, OUTER, ORIGIN), (-1, INNER, (0.03, 0.015, 0))],
    ),
    "two overlap, one apart": (
        [body(OUTER), body(OUTER, (0.05, 0, 0)), body(INNER, (0.3, 0, 0))],
        [(1, (0.15, 0.06, 0.05), (0.025, 0, 0)), (1, INNER, (0.3, 0, 0))],
    ),
    "two overlap, a void in one": (
        [body(OUTER), body(OUTER, (0.05, 0, 0)), body((0.02, 0.02, 0.02), (-0.03, 0, 0), void=True)],
        [(1, (0.15, 0.06, 0.05), (0.025, 0, 0)), (-1, (0.02, 0.02, 0.02), (-0.03, 0, 0))],
    ),
    "a face shared": ([body(OUTER), body(OUTER, (0.1, 0, 0))], [(1, (0.2, 0.06, 0.05), (0.05, 0, 0))]),
    "an edge shared": ([body(OUTER), body(OUTER, (0.1, 0.06, 0))], [(1, OUTER, ORIGIN), (1, OUTER, (0.1, 0.06, 0))]),
    "a corner shared": (
        [body(OUTER), body(OUTER, (0.1, 0.06, 0.05))],
        [(1, OUTER, ORIGIN), (1, OUTER, (0.1, 0.06, 0.05))],
    ),
    "apart, one wound inwards": (
        [body(OUTER), body(OUTER, (0.3, 0, 0), void=True)],
        [(1, OUTER, ORIGIN), (1, OUTER, (0.3, 0, 0))],
    ),
    "the same twice": ([body(OUTER), body(OUTER)], [(1, OUTER, ORIGIN)]),
}


def agree(mesh, terms):
    volume, centre, inertia = summed(*terms)
    found = mass_properties(mesh, density=2.0)
    assert mesh.volume == pytest.approx(volume, rel=1e-6)
    assert found.mass == pytest.approx(2.0 * volume, rel=1e-6)
    np.testing.assert_allclose(found.p_com, centre, atol=1e-8)
    np.testing.assert_allclose(found.inertia / found.mass, inertia, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply", "off", "glb"])
@pytest.mark.parametrize("case", CASES)
def test_mass_properties_of_bodies_in_one_mesh(tmp_path, recwarn, case, kind):
    # Floats of 4 bytes, in three of the formats, round positions by 4e-9 m.
    bodies, terms = CASES[case]
    path = tmp_path / f"mesh.{kind.removesuffix('_ascii')}"
    whole = trimesh.util.concatenate(bodies)
    whole.export(path, file_type=kind)
    mesh = load_mesh(path)
    assert mesh.is_watertight
    agree(mesh, terms)
    assert not recwarn.list
    # What was never in a file is counted alike.
    assert mass_properties(whole, mass=1.0).p_com == pytest.approx(summed(*terms)[1], abs=1e-12)


@pytest.mark.parametrize("inner_at", [ORIGIN, (0.03, 0.015, 0.015)])
def test_a_body_in_a_body_of_its_winding_counts_once_with_a_warning(tmp_path, inner_at):
    path = tmp_path / "mesh.stl"
    trimesh.util.concatenate([body(OUTER), body(INNER, inner_at)]).export(path)
    with pytest.warns(UserWarning, match="part 2 lies in part 1 and is wound as it is"):
        mesh = load_mesh(path)
    agree(mesh, [(1, OUTER, ORIGIN)])


def test_a_scene_of_nodes_with_transforms(tmp_path):
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = [-0.1, 0.0, 0.02]
    shift = np.eye(4)
    shift[:3, 3] = [0.1, 0.0, 0.0]
    scene = trimesh.Scene()
    scene.add_geometry(body(OUTER), transform=shift)
    scene.add_geometry(body(INNER, (0.01, 0, 0), void=True), transform=shift)
    scene.add_geometry(body(OUTER), transform=mirror)
    scene.export(tmp_path / "scene.glb")
    agree(
        load_mesh(tmp_path / "scene.glb"),
        [(1, OUTER, (0.1, 0, 0)), (-1, INNER, (0.11, 0, 0)), (1, OUTER, (-0.1, 0, 0.02))],
    )


def test_a_hollow_ball(tmp_path):
    # 2/5 (R^5 - r^5) / (R^3 - r^3); 1280 faces are inscribed, and smaller in volume by 1.5 %: both alike.
    ball, hollow = (trimesh.creation.icosphere(3, radius) for radius in (0.05, 0.04))
    share = ball.volume / (4 / 3 * np.pi * 0.05**3)
    hollow.invert()
    trimesh.util.concatenate([ball, hollow]).export(tmp_path / "ball.ply")
    found = mass_properties(load_mesh(tmp_path / "ball.ply"), density=1.0)
    assert found.mass == pytest.approx(share * 4 / 3 * np.pi * (0.05**3 - 0.04**3), rel=1e-5)
    thick = 2 / 5 * (0.05**5 - 0.04**5) / (0.05**3 - 0.04**3)
    np.testing.assert_allclose(np.diag(found.inertia) / found.mass, thick, rtol=0.01)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([body(OUTER), body(OUTER, (0.05, 0, 0), void=True)], "part 1 and part 2, which cross and are wound against"),
        ([body(OUTER), body(OUTER, void=True)], "part 2, a void that fills part 1"),
    ],
)
def test_what_is_no_solid_names_its_bodies(tmp_path, bodies, message):
    whole = trimesh.util.concatenate(bodies)
    whole.export(tmp_path / "mesh.stl")
    with pytest.raises(InputError, match=f"mesh.stl: got {message}"):
        load_mesh(tmp_path / "mesh.stl")
    with pytest.raises(GeometryError, match=message):
        mass_properties(whole, mass=1.0)


def test_contact_is_with_what_can_be_touched(tmp_path):
    # A void and what is in it cannot; the pieces are those of the full box, and the body's mass that of the hollow one.
    bodies, terms = CASES["body in a void in a body"]
    path = tmp_path / "mesh.stl"
    trimesh.util.concatenate(bodies).export(path)
    (piece,) = load_pieces(path)
    np.testing.assert_allclose(np.ptp(piece.vertices, axis=0), OUTER, atol=1e-8)
    assert len(mesh_pieces(path)) == 1
    q_WO = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    scene = make_scene(path, PusherGeometry(None, PusherShape("sphere", 0.01)), q_WO=q_WO, gravity=9.8)
    np.testing.assert_allclose(scene.p_OB.numpy(), summed(*terms)[1], atol=1e-8)


def test_no_warning_of_numbers_leaves_the_reader(tmp_path):
    trimesh.util.concatenate(CASES["void"][0]).export(tmp_path / "mesh.stl")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_mesh(tmp_path / "mesh.stl")
