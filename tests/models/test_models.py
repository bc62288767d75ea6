# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import trimesh
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    GeometryInstance,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import PackageMap
from pydrake.systems.sensors import CameraInfo
from scipy.spatial import cKDTree

from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import OBJECT_NAMES, model_path, object_model, resolve
from pinwm_drake.models.paint import COLOURS, texts

# Coordinates in the files carry nine digits: 1e-9 of 0.1 m. Volumes and inertias are compared relatively.
DIGITS = 1e-9


# Those that are to be one closed surface; beside them stand the same in colours.
PLAIN = [f"{name}/{name}.obj" for name in OBJECT_NAMES]
# Those that are seen. What touches only is written by systems/sdf/shipped.py and tested there.
SEEN = [*PLAIN, *(f"{name}/{name}_visual.obj" for name in OBJECT_NAMES)]


def load(name: str) -> trimesh.Trimesh:
    return load_mesh(model_path(name))


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


@pytest.mark.parametrize("name", PLAIN)
def test_meshes_are_watertight_and_centred(name):
    mesh = load(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    # The ends of the handle stand in the wall, and count once.
    np.testing.assert_allclose(mesh.center_mass, 0, atol=4e-5 if "handle" in name else DIGITS)


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


def test_the_large_t_block_is_1_4_times_as_large():
    large, mesh = load("large_t/large_t.obj"), load("t_block/t_block.obj")
    np.testing.assert_allclose(large.vertices, 1.4 * mesh.vertices, atol=DIGITS)
    np.testing.assert_array_equal(large.faces, mesh.faces)
    assert large.volume == pytest.approx(1.4**3 * mesh.volume, rel=1e-7)


def test_cube_has_60_mm_sides():
    mesh = load("cube/cube.obj")
    np.testing.assert_allclose(mesh.bounds, [[-0.03] * 3, [0.03] * 3], atol=DIGITS)
    assert mesh.volume == pytest.approx(0.06**3, rel=DIGITS)


def read_obj(path):
    """Corners (n, 3), normals (m, 3); faces as (corner, normal) numbers (f, 3, 2), counted from 0; their colours."""
    corners, normals, faces, colours, colour = [], [], [], [], None
    for line in path.read_text().splitlines():
        kind, *rest = line.split()
        if kind == "v":
            corners.append([float(value) for value in rest])
        elif kind == "vn":
            normals.append([float(value) for value in rest])
        elif kind == "usemtl":
            (colour,) = rest
        elif kind == "f":
            faces.append([[int(value) - 1 for value in corner.split("//")] for corner in rest])
            colours.append(colour)
    return np.array(corners), np.array(normals), np.array(faces), np.array(colours)


@pytest.mark.parametrize("name", SEEN)
def test_normals_are_those_of_the_faces(name):
    corners, normals, faces, _ = read_obj(model_path(name))
    a, b, c = (corners[faces[:, k, 0]] for k in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    # Nine digits of 0.1 m: 1e-10 m across a cell of 1 mm or more.
    for k in range(3):
        np.testing.assert_allclose(across / area[:, None], normals[faces[:, k, 1]], atol=1e-5)


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_the_painted_surface_is_the_mesh(name):
    model = object_model(name)
    corners, _, faces, colours = read_obj(model.visual_path)
    triangles, mesh = corners[faces[:, :, 0]], load_mesh(model.mesh_path)
    soup = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)
    shared = name == "mug_handle"  # the ends of the handle, within the wall, are painted too
    assert soup.area == pytest.approx(mesh.area, rel=0.01 if shared else 1e-7)
    assert soup.volume == pytest.approx(mesh.volume, rel=1.1e-3 if shared else 1e-7)
    np.testing.assert_allclose(soup.bounds, mesh.bounds, atol=DIGITS)
    assert set(colours) <= set(COLOURS)
    assert len(set(colours)) >= 6


@pytest.mark.parametrize(("name", "turns"), [("t_block", 2), ("large_t", 2), ("cube", 4), ("mug", 64)])
def test_colours_show_which_way_an_object_has_turned(name, turns):
    corners, _, faces, colours = read_obj(object_model(name).visual_path)
    triangles = corners[faces[:, :, 0]]
    area = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    middles = triangles.mean(axis=1)
    places = cKDTree(middles)
    for k in range(1, turns):
        angle = 2 * math.pi * k / turns
        turned = middles @ np.array(
            [[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
        )
        nearest = places.query(turned)[1]
        # At least a tenth of the surface has another colour, also after one facet of the mug.
        share = area[colours != colours[nearest]].sum() / area.sum()
        assert share > (0.1 if name != "mug" or 4 <= k <= 60 else 0.02)


def test_painted_files_are_up_to_date():
    for path, text in texts().items():
        assert path.read_text() == text, f"run python -m pinwm_drake.models.paint: {path}"


@pytest.mark.parametrize("name", SEEN)
def test_drake_renders_the_files(name):
    scene_graph = SceneGraph()
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    geometry = GeometryInstance(RigidTransform(), Mesh(model_path(name)), "model")
    properties = PerceptionProperties()
    properties.AddProperty("label", "id", RenderLabel(7))
    geometry.set_perception_properties(properties)
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource(), geometry)
    query = scene_graph.get_query_output_port().Eval(scene_graph.CreateDefaultContext())
    core = RenderCameraCore("vtk", CameraInfo(40, 40, 0.5), ClippingRange(0.01, 10.0), RigidTransform())
    X_WC = RigidTransform([0, 0, -0.4])
    label = query.RenderLabelImage(ColorRenderCamera(core), scene_graph.world_frame_id(), X_WC)
    assert (np.asarray(label.data) == 7).sum() > 100


def test_urls_resolve_to_the_same_file():
    assert resolve("package://pinwm_models/mug/mug.obj") == model_path("mug/mug.obj")
    assert str(resolve("somewhere/else.obj")) == "somewhere/else.obj"


def test_drake_resolves_the_same_url():
    packages = PackageMap.MakeEmpty()
    packages.AddPackageXml(str(model_path("package.xml")))
    assert packages.ResolveUrl("package://pinwm_models/mug/mug.obj") == str(model_path("mug/mug.obj"))


def test_objects_are_found_by_name():
    model = object_model("mug")
    assert model.mesh_path == model_path("mug/mug.obj")
    assert model.visual_path == model_path("mug/mug_visual.obj")
    assert model.sdf_path == model_path("mug/mug.sdf")
    assert model.point_sdf_path == model_path("mug/mug_point.sdf")
    with pytest.raises(InputError, match=r"object 'teapot'; allowed: t_block, large_t, cube, mug, mug_handle"):
        object_model("teapot")


def test_unknown_models_are_answered_with_what_there_is():
    with pytest.raises(InputError, match=r"'t_block.obj'.*did you mean t_block/t_block.obj"):
        model_path("t_block.obj")
    with pytest.raises(InputError, match=r"\.\./pyproject\.toml.; allowed: arm/iiwa14\.sdf"):
        model_path("../pyproject.toml")
    with pytest.raises(InputError, match=r"package 'other'.*package://pinwm_models/"):
        resolve("package://other/mug/mug.obj")
