# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.systems.runs.realism.uneven import draw_unevenness, write_with_feet

UPS = {"z": np.array([0.0, 0.0, 1.0]), "x": np.array([1.0, 0.0, 0.0]), "-y": np.array([0.0, -1.0, 0.0])}


@pytest.fixture
def block(tmp_path):
    path = tmp_path / "block.obj"
    trimesh.creation.box((0.08, 0.06, 0.05)).export(path)
    return path


@pytest.mark.parametrize("up", UPS.values(), ids=UPS)
def test_an_uneven_block_is_a_body_that_stands(block, up, tmp_path):
    mesh = load_mesh(block)
    for seed in range(5):
        found = draw_unevenness(mesh, [mesh.vertices], 0.5, up, np.random.default_rng(seed))
        off = np.linalg.norm(found.p_com) / mesh.extents.mean()
        assert 0.015 < off < 0.095
        moments = np.linalg.eigvalsh(found.inertia)
        assert 0 < moments[0] < moments[2] < moments[0] + moments[1]
        # Steiner: a lump makes the moments about the common centre differ from those of the solid.
        assert not np.allclose(found.inertia, mass_properties(mesh, mass=0.5).inertia, rtol=1e-3)
        height = found.feet @ up
        assert height == pytest.approx(np.full(len(found.feet), (mesh.vertices @ up).min() - 7e-5))
        # The centre of mass stands above the polygon of the feet.
        across = np.flatnonzero(up == 0.0)
        assert Delaunay(found.feet[:, across]).find_simplex(found.p_com[across]) >= 0


@pytest.mark.parametrize("up", UPS.values(), ids=UPS)
def test_feet_stand_out_below(block, up, tmp_path):
    mesh = load_mesh(block)
    feet = draw_unevenness(mesh, [mesh.vertices], 0.5, up, np.random.default_rng(0)).feet
    folder = tmp_path / "models"
    folder.mkdir()
    standing = load_mesh(write_with_feet(block, folder, feet, up))
    low = (mesh.vertices @ up).min()
    assert (standing.vertices @ up).min() == pytest.approx(low - 7e-5, abs=1e-9)
    below = standing.vertices[standing.vertices @ up < low - 5e-5]
    for point in below:
        assert np.linalg.norm(feet - point, axis=1).min() < 0.0031
    # Nothing else has changed.
    assert np.isin(mesh.vertices.round(8), standing.vertices.round(8)).all()


def test_an_object_that_rolls_lies_with_its_lump_below():
    # On one of its 32 sides, as a mug lies.
    mesh, side = trimesh.creation.cylinder(0.04, 0.08, sections=32), np.pi / 32
    up = -np.array([np.cos(side), np.sin(side), 0.0])
    for seed in range(5):
        found = draw_unevenness(mesh, [mesh.vertices], 0.5, up, np.random.default_rng(seed))
        across = found.p_com - [0.0, 0.0, found.p_com[2]]
        assert across @ -up > np.cos(1.01 * side) * np.linalg.norm(across)


def test_an_object_on_an_edge_has_no_feet():
    wedge = trimesh.creation.cylinder(0.001, 0.1)
    with pytest.raises(GeometryError, match="wide enough"):
        draw_unevenness(wedge, [wedge.vertices], 0.5, UPS["z"], np.random.default_rng(0))


def test_an_object_on_a_point_has_no_feet():
    cone = trimesh.creation.cone(0.03, 0.08)
    with pytest.raises(GeometryError, match="a face to stand on"):
        draw_unevenness(cone, [cone.vertices], 0.5, -UPS["z"], np.random.default_rng(0))
