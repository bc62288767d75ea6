# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
import trimesh
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix

from pinwm_drake.errors import ParameterError
from pinwm_drake.models import twin_path
from pinwm_drake.systems.scenario.load import _without_yaw, load_setup
from pinwm_drake.systems.scenario.schema import load_scenario
from pinwm_drake.twin.write import write_twin
from tests.systems.stations import action_setup, scenario, setup_of


@pytest.mark.parametrize(
    "scene", [scenario(), setup_of(), "push_t", "package://pinwm_models/scenarios/push_t.scenario.yaml"]
)
def test_the_state_is_updated_once_an_action(scene):
    setup = action_setup(scene, num_worlds=3)
    assert setup.scenario.physics.steps_per_update == 24
    assert setup.period == pytest.approx(0.1)
    assert setup.scenario.num_worlds == 3
    assert setup.period / setup.plant_time_step == pytest.approx(round(setup.period / setup.plant_time_step))


def test_settings_of_the_physics_and_the_camera():
    setup = action_setup("push_t", time_step=1 / 120, image_size=48)
    assert setup.scenario.physics.steps_per_update == 12
    assert setup.twin.time_step == 1 / 120
    assert (setup.camera.width, setup.camera.height) == (48, 48)
    view = load_scenario("package://pinwm_models/scenarios/push_t.scenario.yaml").camera
    # The same field of view: the focal length shrinks with the image.
    whole = action_setup("push_t").camera
    assert setup.camera.intrinsics[1] / 48 == pytest.approx(whole.intrinsics[1] / view.height)


def test_a_time_step_that_does_not_divide_the_action_is_refused():
    with pytest.raises(ParameterError, match="a whole multiple of the time step"):
        action_setup("push_t", time_step=0.03)


def test_a_twins_folder_is_the_usual_scene_with_the_twin(tmp_path):
    twin = dataclasses.replace(action_setup("push_t").twin, name="mine", time_step=1 / 480)
    write_twin(tmp_path / "twin", twin)
    setup, usual = action_setup(tmp_path / "twin"), action_setup("push_t")
    assert (setup.twin.name, setup.twin.time_step, setup.twin.pusher.shape) == ("mine", 1 / 480, twin.pusher.shape)
    assert setup.scenario.start.x == usual.scenario.start.x
    assert setup.scenario.pusher.low == pytest.approx(usual.scenario.pusher.low)
    assert setup.scenario.start.pusher_height == pytest.approx(0.025, abs=1e-3)
    np.testing.assert_allclose(setup.X_WC.GetAsMatrix4(), usual.X_WC.GetAsMatrix4())


def test_a_twin_that_ships_is_a_scene_by_its_name():
    setup = load_setup("t_block")
    assert setup.scenario.twin == str(twin_path("t_block"))
    assert setup.twin.provenance["episode"] == "0000"


@pytest.mark.parametrize(("size", "away"), [(1.0, 1.0), (1.1, 1.0), (1.4, 1.4)])
def test_the_camera_of_a_twins_scene_is_farther_from_a_large_object(tmp_path, size, away):
    own = load_setup("push_t")
    mesh = trimesh.load_mesh(own.twin.mesh_path)
    mesh.apply_scale(size)
    mesh.export(tmp_path / "large.obj")
    write_twin(tmp_path / "twin", dataclasses.replace(own.twin, mesh_path=tmp_path / "large.obj"))
    found = load_setup(tmp_path / "twin")
    np.testing.assert_allclose(found.X_WC.translation(), away * own.X_WC.translation(), rtol=1e-6)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (1.2, 0.0), (1.0, -0.7)])
def test_the_yaw_of_a_capture_is_taken_off(roll, pitch):
    lying = RollPitchYaw(roll, pitch, 0.0)
    q = lying.ToQuaternion().wxyz()
    turned = RotationMatrix.MakeZRotation(2.1) @ RotationMatrix(lying)
    one, other = (_without_yaw(list(values)) for values in (q, turned.ToQuaternion().wxyz()))
    assert abs(np.dot(one, other)) == pytest.approx(1.0)
    # What is left leads to the same pose up to a turn about z.
    left = RotationMatrix(Quaternion(wxyz=one)).matrix() @ turned.matrix().T
    assert left[2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
