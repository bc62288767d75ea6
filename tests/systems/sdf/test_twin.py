# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.systems.sdf.twin import FILES, twin_solid, write_twin_model
from pinwm_drake.twin.twin import Twin
from tests.capture.cube import SIDE
from tests.twin.samples import MASS, cube_twin, estimates

BESIDE = np.array([0.01, -0.02, 0.03])  # m, of the mesh's centre of mass from its origin


@pytest.fixture
def twin(tmp_path) -> Twin:
    """A wedge beside the origin of its mesh, with products of inertia, and a pusher that is a mesh."""
    wedge = trimesh.convex.convex_hull([[0, 0, 0], [0.06, 0, 0], [0, 0.04, 0], [0, 0, 0.05], [0.06, 0.04, 0]])
    wedge.apply_translation(BESIDE - wedge.center_mass)
    wedge.export(tmp_path / "wedge.obj")
    trimesh.creation.box((0.02, 0.03, 0.05)).export(tmp_path / "pusher.obj")
    moments = np.diag(mass_properties(wedge, mass=MASS).inertia) * [1.1, 1.0, 1.05]
    theta = estimates(**{f"inertia_{2 * axis}": float(moment) for axis, moment in zip("xyz", moments, strict=True)})
    return cube_twin(
        tmp_path,
        name="a wedge & <its> pusher",
        mesh_path=tmp_path / "wedge.obj",
        pusher=PusherGeometry(tmp_path / "pusher.obj", None),
        floor_height=0.1,
        theta=theta,
    )


def loaded(*paths):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = Parser(plant=plant)
    parser.SetStrictParsing()
    for path in paths:
        parser.AddModels(str(path))
    plant.Finalize()
    return plant, scene_graph, builder.Build()


def test_the_written_object_has_theta_and_the_mesh(twin, tmp_path):
    assert [path.name for path in write_twin_model(twin, tmp_path / "new/out")] == list(FILES)
    for name in FILES[:2]:
        plant, _, _ = loaded(tmp_path / "new/out" / name)
        inertia = plant.GetBodyByName("object").default_spatial_inertia()
        assert inertia.get_mass() == MASS
        np.testing.assert_allclose(inertia.get_com(), BESIDE, atol=1e-8)
        about_B = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        wanted = [twin.theta[f"inertia_{2 * axis}"].value for axis in "xyz"]
        np.testing.assert_allclose(np.diag(about_B), wanted, rtol=1e-9)
        # The products are those of the mesh, scaled like the moments.
        solid = mass_properties(load_mesh(twin.mesh_path), mass=MASS).inertia
        ratio = about_B[0, 1] / solid[0, 1]
        assert 0.95 < ratio < 1.15
        np.testing.assert_array_equal(about_B, about_B.T)
        np.testing.assert_allclose(about_B, twin_solid(twin).inertia, rtol=1e-9)


@pytest.mark.parametrize("boxed", [False, True])
def test_every_mesh_that_is_written_is_read(twin, tmp_path, boxed):
    paths = write_twin_model(cube_twin(tmp_path) if boxed else twin, tmp_path / "out")
    texts = "".join(path.read_text() for path in [*paths, tmp_path / "out/meshes/visual.obj"])
    written = sorted((tmp_path / "out/meshes").iterdir())
    assert written
    assert [path.name for path in written if path.name not in texts] == []
    # A box needs no hull.
    assert any(path.name == "piece_0.obj" for path in written) is not boxed


def test_a_written_scene_is_whole(twin, tmp_path):
    object_sdf, _, floor, pusher = write_twin_model(twin, tmp_path)
    plant, scene_graph, diagram = loaded(object_sdf, floor, pusher)
    assert (plant.num_positions(), plant.num_velocities()) == (10, 9)
    inspector = scene_graph.model_inspector()
    (ground,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("floor"))
    assert inspector.GetPoseInFrame(ground).translation()[2] == pytest.approx(0.1 - 0.01)
    (hand,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("pusher"))
    hull = inspector.GetShape(hand).GetConvexHull()
    corners = np.array([hull.vertex(k) for k in range(hull.num_vertices())])
    np.testing.assert_allclose(np.abs(corners), [[0.01, 0.015, 0.025]] * 8, atol=1e-9)
    diagram.CreateDefaultContext()


def test_a_model_may_be_moved_and_written_again(twin, tmp_path):
    write_twin_model(twin, tmp_path / "here")
    write_twin_model(twin, tmp_path / "here")
    (tmp_path / "here").rename(tmp_path / "there")
    loaded(*(tmp_path / "there" / name for name in FILES[1:]))


def test_what_cannot_be_used_is_named(twin, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_twin_model(twin, tmp_path / "file")
    with pytest.raises(InputError, match=r"none\.obj"):
        write_twin_model(replace(twin, mesh_path=tmp_path / "none.obj"), tmp_path / "out")


def test_a_plain_cube_is_itself(tmp_path):
    twin = cube_twin(tmp_path)
    solid = twin_solid(twin)
    np.testing.assert_allclose(solid.inertia, MASS * SIDE**2 / 6 * np.eye(3), atol=1e-15)
    np.testing.assert_allclose(solid.p_OB, 0, atol=1e-15)
