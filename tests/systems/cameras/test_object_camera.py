# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform, RollPitchYaw

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import coverage
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.cameras.object_camera import downsample
from pinwm_drake.systems.runs.recorder import Rates, SceneRecorder
from pinwm_drake.systems.scenario.schema import Scenario
from pinwm_drake.systems.scenario.viewpoints import around, framed, look_at

SIZE = 120
CAMERA = Camera(SIZE, SIZE, torch.tensor([170.0, 175.0, 57.3, 63.1], dtype=torch.float64))
X_WO = RigidTransform(RollPitchYaw(0.3, -0.2, 0.8), [0.01, 0.02, 0.06])


def recorder(supersampling):
    scenario = Scenario(object="t_block", engine="hydroelastic")
    return SceneRecorder(scenario, Rates(24.0, 10, 16), CAMERA, supersampling)


@pytest.fixture(scope="module")
def fine():
    return recorder(3)


def expected(X_WC, supersampling):
    """Where pixel squares are covered by half or more, by this project's own camera and silhouettes."""
    X_CO = X_WC.inverse() @ X_WO
    pose = Pose(torch.tensor(X_CO.rotation().ToQuaternion().wxyz()), torch.tensor(X_CO.translation()))
    mesh = load_mesh(object_model("t_block").mesh_path)
    parts = coverage(mesh, CAMERA.scaled(supersampling), pose).numpy()
    return parts.reshape(SIZE, supersampling, SIZE, supersampling).mean(axis=(1, 3)) >= 0.5


@pytest.mark.parametrize("supersampling", [1, 3])
def test_outlines_are_where_the_intrinsics_say(supersampling, fine):
    # A principal point off by half a pixel would change some hundred pixels without supersampling, and a third of
    # them with 3; rounding changes one or two.
    rig = fine if supersampling == 3 else recorder(1)
    viewpoints = around(X_WO.translation(), 0.3, 3, 0.4)
    for X_WC, picture in zip(viewpoints, rig.pictures([X_WO] * 3, viewpoints), strict=True):
        shown = picture[..., 3] == 255
        assert shown.sum() > 1000
        assert (shown != expected(X_WC, supersampling)).sum() <= 2


def test_alpha_is_whole_or_nothing_and_white_where_nothing_is(fine):
    (picture,) = fine.pictures([X_WO], [look_at(np.array([0.3, 0.1, 0.3]), X_WO.translation())])
    assert set(np.unique(picture[..., 3])) == {0, 255}
    assert (picture[picture[..., 3] == 0][:, :3] == 255).all()
    # Patches of several colours.
    assert len(np.unique(picture[picture[..., 3] == 255] // 32, axis=0)) > 10


def test_the_pusher_hides_the_object(fine):
    X_WC = look_at(np.array([0.3, 0.1, 0.3]), X_WO.translation())
    between = X_WO.translation() + 0.3 * (X_WC.translation() - X_WO.translation())
    (alone,) = fine.pictures([X_WO], [X_WC])
    (hidden,) = fine.pictures([X_WO], [X_WC], between[None])
    gone = (alone[..., 3] == 255) & (hidden[..., 3] == 0)
    assert gone.sum() > 50
    assert not ((alone[..., 3] == 0) & (hidden[..., 3] == 255)).any()
    assert (hidden[gone][:, :3] == 255).all()


def test_an_object_that_turns_keeps_its_colours(fine):
    colours = []
    for yaw in np.linspace(0, 2 * np.pi, 9):
        turned = RigidTransform(RollPitchYaw(0, 0, yaw), [0, 0, 0.025])
        # The camera turns along: only the light does not.
        X_WC = RigidTransform(RollPitchYaw(0, 0, yaw), np.zeros(3)) @ look_at(np.array([0.3, 0.1, 0.2]), np.zeros(3))
        (picture,) = fine.pictures([turned], [X_WC])
        colours.append(picture[picture[..., 3] == 255][:, :3].mean())
    # Eight lights from the sides leave a ripple of 4 % on a vertical face.
    assert np.ptp(colours) < 0.05 * np.mean(colours)


def test_downsampling_keeps_the_background_out_of_the_colour():
    colour = np.full((3, 6, 3), 255, np.uint8)
    shown = np.zeros((3, 6), bool)
    colour[:, 1:4], shown[:, 1:4] = (10, 20, 30), True
    # 6 parts of 9 are on the object in the first pixel, 3 in the second.
    np.testing.assert_array_equal(downsample(colour, shown, 3), [[[10, 20, 30, 255], [255, 255, 255, 0]]])
    assert not downsample(colour, np.zeros_like(shown), 3)[..., 3].any()


def test_a_framed_camera_sees_every_point():
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 3))
    camera = Camera.from_field_of_view(100, 80, 0.7)
    X_WC = framed(points, np.array([1.0, -2.0, 1.5]), camera, 0.1)
    p_C = (points - X_WC.translation()) @ X_WC.rotation().matrix()
    fx, fy, cx, cy = camera.intrinsics.tolist()
    reach = np.abs(p_C[:, :2] / p_C[:, 2:] * [fx, fy]) / [cx, cy]
    assert reach.max() == pytest.approx(0.9)
    # x of the camera is level, and the world's z points up in the image (y down).
    assert X_WC.rotation().matrix()[2, 0] == pytest.approx(0, abs=1e-12)
    assert X_WC.rotation().matrix()[2, 1] < 0
