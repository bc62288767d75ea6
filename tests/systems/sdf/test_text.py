# SPDX-License-Identifier: MIT
import math
import re
from itertools import product

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Box, Cylinder, Role
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CalcContactFrictionFromSurfaceProperties,
)
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.patch import resting_normals
from pinwm_drake.geometry.stored_pieces import mesh_primitives
from pinwm_drake.models import OBJECT_NAMES, PUSHER_NAMES, model_path, object_model
from pinwm_drake.models.paint import HANDLE_CENTER
from pinwm_drake.systems.sdf.contact import Surfaces
from pinwm_drake.systems.sdf.shipped import PUSHERS, shipped_pieces, shipped_supports, texts
from pinwm_drake.systems.sdf.text import floor_sdf, object_sdf, pusher_sdf
from pinwm_drake.systems.sdf.twin import twin_solid
from tests.systems.scenes import base_of, base_triangles, mean_radius, setup_of

ENDS = [".sdf", "_point.sdf"]
NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")

SUPPORT = ("package://pinwm_models/cube/cube_support.vtk", 0.03)


def loaded(*paths, strings=()):
    """The plant and scene graph of models; any warning of Drake's is an error."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = Parser(plant=plant)
    parser.SetStrictParsing()
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    for path in paths:
        parser.AddModels(str(path))
    for text in strings:
        parser.AddModelsFromString(text, "sdf")
    plant.Finalize()
    return plant, scene_graph, builder.Build()


def properties(scene_graph, geometry):
    return scene_graph.model_inspector().GetProximityProperties(geometry)


def pair_friction(plant, scene_graph, first, second):
    """The coefficients of all pairs of geometries of two bodies, as Drake combines them."""
    found = set()
    for a in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(first)):
        for b in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(second)):
            mu = (properties(scene_graph, k).GetProperty("material", "coulomb_friction") for k in (a, b))
            pair = CalcContactFrictionFromSurfaceProperties(*mu)
            found |= {pair.static_friction(), pair.dynamic_friction()}
    return sorted(found)


# Of the volume, what pieces count twice: the ends of the handle stand in the wall.
SHARED = {"mug_handle": 1.1e-3}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_shipped_objects_have_the_mass_of_a_uniform_solid(name, end):
    plant, _, _ = loaded(model_path(f"{name}/{name}{end}"))
    body = plant.GetBodyByName("object")
    about = mass_properties(load_mesh(object_model(name).mesh_path), mass=1.0)
    inertia = body.default_spatial_inertia()
    assert inertia.get_mass() == 1.0
    np.testing.assert_allclose(inertia.get_com(), about.p_com, atol=1e-9)
    # Nine digits.
    turning = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(turning, about.inertia, rtol=1e-8, atol=1e-12)
    assert len(plant.GetVisualGeometriesForBody(body)) == 1


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_what_touches_in_hydroelastic_contact_is_the_surface_in_small_triangles(name):
    mesh, fine = load_mesh(object_model(name).mesh_path), load_mesh(model_path(f"{name}/{name}_contact.obj"))
    # The wall of a mug has 256 sides for 64; outside of its circle. The handle covers
    # 7e-9 m^3 of what that adds, and open ends are 1 um lower.
    disc, side = regular(256) - regular(64) if name.startswith("mug") else np.zeros(2)
    loose = {"mug_handle": 1e-4, "mug": 2e-5}.get(name, 1e-7)
    assert fine.volume == pytest.approx(mesh.volume + 0.08 * disc, rel=loose)
    assert fine.area == pytest.approx(mesh.area + 2.0 * disc + 0.08 * side, rel=loose)
    np.testing.assert_allclose(fine.bounds, mesh.bounds, atol=3.1e-6 if name.startswith("mug") else 1e-9)
    assert fine.edges_unique_length.max() <= 0.28 * mesh.extents.mean() + 1e-9
    plant, scene_graph, _ = loaded(object_model(name).sdf_path)
    inspector = scene_graph.model_inspector()
    surface, volume = (
        inspector.maybe_get_hydroelastic_mesh(one)
        for one in plant.GetCollisionGeometriesForBody(plant.GetBodyByName("object"))
    )
    # The mesh of a rigid one is its surface, that of a compliant one its volume.
    assert surface.num_triangles() == len(fine.faces)
    tetrahedra = [volume.CalcTetrahedronVolume(k) for k in range(volume.num_elements())]
    assert min(tetrahedra) > 0
    filled = mesh.volume
    if name.startswith("mug"):  # a floor gets into no cavity
        filled += 0.08 * regular(256)[0] - load_mesh(object_model("mug").mesh_path).volume
    assert sum(tetrahedra) == pytest.approx(filled, rel=SHARED.get(name, 1e-6))


def plane_sides(piece):
    """Outward normals (n, 3) and levels (n,) of the planes of a hull."""
    hull = trimesh.convex.convex_hull(piece.vertices)
    return hull.face_normals, (hull.face_normals * hull.triangles[:, 0]).sum(axis=1)


def closest(mesh, point):
    """The point (3,) of a mesh that is nearest to a point (3,)."""
    near = trimesh.triangles.closest_point(mesh.triangles, np.tile(point, (len(mesh.faces), 1)))
    return near[np.linalg.norm(near - point, axis=1).argmin()]


def regular(sides: int) -> np.ndarray:
    """Area [m^2] and perimeter [m] of the regular polygon in a mug's outline."""
    a = 2.0 * np.pi / sides
    r = 0.04 if sides == 64 else 0.04 / np.cos(np.pi / sides)
    return np.array([0.5 * sides * r * r * np.sin(a), 2.0 * sides * r * np.sin(0.5 * a)])


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_triangles_are_small_enough_for_the_friction_torque_of_the_face(name):
    # Drake has a contact in the centroid of each: 0.03 % (mug), 0.6 % (cube) and 0.9 % (T-blocks) too little.
    _, radius, _ = base_of(name)
    fine = load_mesh(model_path(f"{name}/{name}_contact.obj"))
    assert mean_radius(base_triangles(fine)) == pytest.approx(radius, rel=0.01)


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_pieces_make_up_the_object(name):
    mesh, pieces, rng = load_mesh(object_model(name).mesh_path), shipped_pieces(name), np.random.default_rng(0)
    planes = [plane_sides(piece) for piece in pieces]
    hulls = [trimesh.convex.convex_hull(piece.vertices) for piece in pieces]
    assert sum(hull.volume for hull in hulls) == pytest.approx(mesh.volume, rel=SHARED.get(name, 1e-6))
    together = np.concatenate([piece.vertices for piece in pieces])
    np.testing.assert_allclose([together.min(axis=0), together.max(axis=0)], mesh.bounds, atol=1e-9)
    plant, scene_graph, _ = loaded(object_model(name).point_sdf_path)
    inspector = scene_graph.model_inspector()
    of_body = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("object"))
    mine = [k for k in of_body if inspector.GetName(k).split("::")[-1].startswith("piece")]
    assert len(mine) == len(pieces)
    for k, piece in zip(mine, pieces, strict=True):
        shape = inspector.GetShape(k)
        hollow = name.startswith("mug")
        assert isinstance(shape, Cylinder if hollow and k == mine[0] else Box)
        if isinstance(shape, Box):
            X_OB, half = inspector.GetPoseInFrame(k), 0.5 * shape.size()
            assert (half + 1e-9 > np.abs(X_OB.inverse() @ piece.vertices.T).T).all()
            corners = (X_OB @ (np.array(list(product((-1, 1), repeat=3))) * half).T).T
            distance = np.linalg.norm(corners[:, None] - piece.vertices, axis=2)
            assert hollow or (len(piece.vertices) == 8 and distance.min(axis=0).max() < 1e-9)
            # What the box of a slab, or of a part of a handle, adds is inside the others but for 15 micrometres.
            inside = (X_OB @ (rng.uniform(-1.0, 1.0, (500, 3)) * half).T).T
            out = np.min([(inside @ n.T - level).max(axis=1) for n, level in planes], axis=0)
            assert out.max() < 1.5e-5
        else:
            x, y, z = np.abs(inspector.GetPoseInFrame(k).inverse() @ piece.vertices.T)
            assert np.hypot(x, y) == pytest.approx(shape.radius(), abs=1e-4)
            assert z == pytest.approx(0.5 * shape.length(), abs=1e-9)


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_a_sphere_meets_an_object_along_its_normal(name):
    mesh, rng, radius = load_mesh(object_model(name).mesh_path), np.random.default_rng(1), 0.01
    planes = [plane_sides(piece) for piece in shipped_pieces(name)]
    plant, _, diagram = loaded(object_model(name).point_sdf_path, model_path("pusher/sphere.sdf"))
    context = diagram.CreateDefaultContext()
    mine = plant.GetMyMutableContextFromRoot(context)
    plant.SetFreeBodyPose(mine, plant.GetBodyByName("object"), RigidTransform())
    on, faces = trimesh.sample.sample_surface(mesh, 300, seed=1)
    normals = mesh.face_normals[faces] + 0.8 * rng.normal(size=on.shape)
    angles = []
    for point in on + 0.02 * normals / np.linalg.norm(normals, axis=1)[:, None]:
        out = point - closest(mesh, point)
        if np.linalg.norm(out) < radius or any((n @ point < level).all() for n, level in planes):
            continue  # in a cavity, or inside
        center = closest(mesh, point) + (radius - 1e-4) * out / np.linalg.norm(out)
        out = center - closest(mesh, center)
        plant.SetPositions(mine, plant.GetModelInstanceByName("pusher"), center)
        query = plant.get_geometry_query_input_port().Eval(mine)
        names = query.inspector().GetName
        pairs = [
            (pair.depth, pair.nhat_BA_W * (1 if "pusher" in names(pair.id_A) else -1))
            for pair in query.ComputePointPairPenetration()
            if any("piece" in names(k) for k in (pair.id_A, pair.id_B))
            and any("pusher" in names(k) for k in (pair.id_A, pair.id_B))
        ]
        cosine = max(pairs, key=lambda pair: pair[0])[1] @ out / np.linalg.norm(out)
        angles.append(np.arccos(min(cosine, 1.0)))
    assert len(angles) > 100
    # Sides of a mug's 64 are 5.6 degrees apart; the hull of a mesh would be touched up to 85 degrees off.
    assert np.degrees(max(angles)) < (6.0 if name.startswith("mug") else 0.1)


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_an_object_stands_on_twelve_spheres_and_nothing_else(name):
    mesh, supports = load_mesh(object_model(name).mesh_path), shipped_supports(name)
    centres, radii = np.array([centre for centre, _ in supports]), np.array([radius for _, radius in supports])
    normals = resting_normals(mesh)
    for normal in np.eye(3)[2] * np.array([[1], [-1]]):
        assert min(np.linalg.norm(normal - other) for other in normals) < 1e-6
        # How far below the object's lowest point the spheres reach: 10 µm on the face, 1 µm at corners.
        out = (centres @ normal + radii) - (mesh.vertices @ normal).max()
        assert (out > 5e-6).sum() == 12
        np.testing.assert_allclose(out[out > 5e-6], 1e-5, atol=1e-8)
        middle = centres[out > 5e-6].mean(axis=0)
        # The weight is then the same on each of them, where the centre of mass is above the middle of the face.
        aside = -HANDLE_CENTER[:2] if name == "mug_handle" else np.zeros(2)
        np.testing.assert_allclose(middle[:2], aside, atol=2e-3)
    # The rims of what is round stand out over a facet by its sagitta.
    round_ = max((one.deviation for one in mesh_primitives(object_model(name).mesh_path)), default=0.0)
    assert ((centres @ normals[0] + radii) - (mesh.vertices @ normals[0]).max()).max() < 1.1e-5 + round_


@pytest.mark.parametrize("name", PUSHER_NAMES)
def test_pushers_have_three_driven_slides(name):
    plant, scene_graph, _ = loaded(model_path(f"pusher/{name}.sdf"))
    assert (plant.num_positions(), plant.num_actuators()) == (3, 3)
    for k, axis in enumerate("xyz"):
        joint = plant.GetJointByName(f"pusher_{axis}")
        np.testing.assert_array_equal(joint.translation_axis(), np.eye(3)[k])
        assert plant.GetJointActuatorByName(f"pusher_{axis}").has_controller()
        assert math.isinf(plant.GetJointActuatorByName(f"pusher_{axis}").effort_limit())
    (geometry,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("pusher"))
    shape = scene_graph.model_inspector().GetShape(geometry)
    assert type(shape).__name__.lower() == name
    assert shape.radius() == PUSHERS[name].radius
    if name != "sphere":
        assert shape.length() == PUSHERS[name].length


def test_shipped_files_are_friction_0_1_in_every_pair_and_the_floor_stands_still():
    for end in ENDS:
        plant, scene_graph, _ = loaded(
            model_path(f"cube/cube{end}"), model_path("floor/floor.sdf"), model_path("pusher/sphere.sdf")
        )
        for other in ("floor", "pusher"):
            np.testing.assert_allclose(pair_friction(plant, scene_graph, "object", other), 0.1, rtol=1e-12)
        assert plant.num_velocities() == 9
        (floor,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("floor"))
        inspector = scene_graph.model_inspector()
        top = inspector.GetPoseInFrame(floor).translation()[2] + 0.5 * inspector.GetShape(floor).height()
        assert top == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(("floor", "pusher"), [(0.03, 0.03), (0.2, 0.9), (0.3, 0.0), (0.0, 0.0), (1 / 3, 0.07)])
def test_pairs_have_the_friction_of_theta_to_the_last_digits(floor, pusher):
    surfaces = Surfaces.of_pairs(floor, pusher)
    solid = twin_solid(setup_of("cube", 0.1).twin)
    uri = "package://pinwm_models/cube/cube.obj"
    plant, scene_graph, _ = loaded(
        strings=(
            object_sdf("cube", solid, uri, uri, SUPPORT, surfaces, ""),
            floor_sdf(surfaces, 0.25, ""),
            pusher_sdf(PUSHERS["sphere"], None, surfaces, ""),
        )
    )
    for other, wanted in (("floor", floor), ("pusher", pusher)):
        np.testing.assert_allclose(pair_friction(plant, scene_graph, "object", other), wanted, rtol=1e-12)
    (geometry,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("floor"))
    assert scene_graph.model_inspector().GetPoseInFrame(geometry).translation()[2] == pytest.approx(0.24)
    assert scene_graph.model_inspector().NumGeometriesWithRole(Role.kPerception) == 2


def test_names_with_special_characters_are_escaped():
    solid = twin_solid(setup_of("cube", 0.1).twin)
    uri = "package://pinwm_models/cube/cube.obj"
    text = object_sdf("a<b> & 'c\"", solid, uri, uri, SUPPORT, Surfaces.of_pairs(0.1, 0.1), "x < y & z -- done")
    plant, _, _ = loaded(strings=(text,))
    assert plant.HasModelInstanceNamed("a<b> & 'c\"")


def test_shipped_files_are_up_to_date():
    # Numbers to nine digits: what other processors make of a sum is no reason to fail. Spheres of point contact
    # come from an iterative solver; scipy 1.15 and 1.17 differ by 7e-8 m.
    for path, text in texts().items():
        shipped = path.read_text()
        message = f"run python -m pinwm_drake.systems.sdf.shipped: {path}"
        assert NUMBER.sub("#", shipped) == NUMBER.sub("#", text), message
        numbers = [np.array([float(x) for x in NUMBER.findall(each)]) for each in (shipped, text)]
        atol = 2e-7 if path.stem.endswith("_point") else 2e-9
        np.testing.assert_allclose(*numbers, rtol=1e-8, atol=atol, err_msg=message)
