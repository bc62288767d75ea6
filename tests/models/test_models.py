import math

import numpy as np
import pytest
import trimesh
from pinwm_drake.models import model_names, model_path, resolve
from pydrake.multibody.parsing import PackageMap

from pinwm_drake.errors import InputError

# Coordinates in the files carry nine digits: 1e-9 of 0.1 m. Volumes and inertias are compared relatively.
DIGITS = 1e-9


def load(name: str) -> trimesh.Trimesh:
    return trimesh.load(model_path(name), force="mesh")


def contains(mesh: trimesh.Trimesh, point: np.ndarray) -> bool:
    """Whether the solid angles of all triangles add up to 4π (van Oosterom and Strackee 1983, eq. 8)."""
    corners = mesh.triangles - point
    a, b, c = (corners[:, k] for k in range(3))
    A, B, C = (np.linalg.norm(corners[:, k], axis=1) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    scale = (
        A * B * C + np.einsum("ij,ij->i", a, b) * C + np.einsum("ij,ij->i", b, c) * A + np.einsum("ij,ij->i", c, a) * B
    )
    return bool(2 * np.arctan2(volume, scale).sum() > 2 * math.pi)


@pytest.mark.parametrize("name", [name for name in model_names() if name.endswith(".obj")])
def test_meshes_are_watertight_and_centred(name):
    mesh = load(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    np.testing.assert_allclose(mesh.center_mass, 0, atol=DIGITS)


def test_t_block_is_the_union_of_its_bar_and_stem():
    mesh = load("t_block/t_block.obj")
    assert len(mesh.split()) == 1
    np.testing.assert_allclose(mesh.bounds, [[-0.05, -0.055, -0.025], [0.05, 0.085, 0.025]], atol=DIGITS)
    # Two boxes a × b × c of equal mass, 70 mm apart along y: I_zz/m = (a² + b²)/12 + 0.035².
    assert mesh.volume == pytest.approx(2 * 0.1 * 0.04 * 0.05, rel=DIGITS)
    expected = (0.1**2 + 0.04**2) / 12 + 0.035**2
    assert mesh.moment_inertia[2, 2] / mesh.volume == pytest.approx(expected, rel=1e-7)


def test_t_block_has_the_shape_of_the_released_capture(shared):
    ours = load("t_block/t_block.obj")
    theirs = trimesh.load(shared / "data/pinwm_push_t/meshes/object.obj", force="mesh")
    np.testing.assert_allclose(ours.bounds, theirs.bounds, atol=DIGITS)
    assert ours.volume == pytest.approx(theirs.volume, rel=DIGITS)
    # Points 0.1 mm on either side of the middle of each of its triangles. Theirs is two boxes that touch: the
    # triangles of the stem's end and, at their middles, those of the bar's side lie inside the whole.
    offset = 1e-4 * theirs.face_normals
    assert all(contains(ours, point) for point in theirs.triangles_center - offset)
    hidden = [contains(ours, point) for point in theirs.triangles_center + offset]
    assert sum(hidden) == 4


def test_mug_is_hollow_with_a_closed_base():
    mesh = load("mug/mug.obj")
    segments, R, r, length, wall = 64, 0.040, 0.036, 0.080, 0.004
    np.testing.assert_allclose(mesh.extents, [2 * R, 2 * R, length], atol=DIGITS)
    # A regular n-gon of circumradius ρ has the area n/2 sin(2π/n) ρ².
    polygon = segments / 2 * math.sin(2 * math.pi / segments)
    assert mesh.volume == pytest.approx(polygon * (R**2 * length - r**2 * (length - wall)), rel=1e-7)
    bottom = mesh.bounds[0, 2]
    axis_points = bottom + np.array([0.5 * wall, 1.5 * wall, 0.5 * length, 0.99 * length])
    assert [contains(mesh, np.array([1e-3, 2e-3, z])) for z in axis_points] == [True, False, False, False]
    assert contains(mesh, np.array([0.038, 0.0, 0.0]))


def test_urls_resolve_to_the_same_file():
    assert resolve("package://pinwm_models/mug/mug.obj") == model_path("mug/mug.obj")
    assert str(resolve("somewhere/else.obj")) == "somewhere/else.obj"


def test_drake_resolves_the_same_url():
    packages = PackageMap.MakeEmpty()
    packages.AddPackageXml(str(model_path("package.xml")))
    assert packages.ResolveUrl("package://pinwm_models/mug/mug.obj") == str(model_path("mug/mug.obj"))


def test_unknown_models_are_answered_with_what_there_is():
    with pytest.raises(InputError, match=r"'t_block.obj'.*did you mean t_block/t_block.obj"):
        model_path("t_block.obj")
    with pytest.raises(InputError, match=r"mug/mug\.obj"):
        model_path("../pyproject.toml")
    with pytest.raises(InputError, match=r"package 'other'.*package://pinwm_models/"):
        resolve("package://other/mug/mug.obj")
