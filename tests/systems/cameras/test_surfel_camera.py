# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    RenderCameraCore,
    RenderLabel,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.systems.cameras import surfel_camera
from pinwm_drake.systems.cameras.surfel_camera import SurfelCamera
from pinwm_drake.systems.scenario.viewpoints import around, look_at
from tests.systems.vtk import picture

CAMERA = Camera(200, 160, torch.tensor([340.0, 330.0, 105.0, 82.0], dtype=torch.float64))
VISUAL = model_path("t_block/t_block_visual.obj")
IMAGES = ("color_image", "depth_image_32f", "depth_image_16u", "label_image")
EYES = around(np.array([0.05, -0.02, 0.03]), 0.4, 3, 0.3)
X_WO = RigidTransform(RollPitchYaw(0.4, -0.3, 2.0), [0.05, -0.02, 0.03])


@pytest.fixture(scope="module")
def surfels():
    return painted_surfels(VISUAL)


def state(X_WO):
    return np.concatenate([X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation(), np.zeros(6)])


def context_of(camera: SurfelCamera, X_WC: object, states: np.ndarray) -> Context:
    context = camera.CreateDefaultContext()
    camera.GetInputPort("X_WC").FixValue(context, AbstractValue.Make(X_WC))
    camera.GetInputPort("object_state").FixValue(context, states)
    return context


def image(camera, context, name):
    data = np.array(camera.GetOutputPort(name).Eval(context).data)
    return data if name == "color_image" else data[..., 0]


@pytest.fixture
def renderings(monkeypatch):
    """Counts them."""
    calls = []

    def counted(*arguments, **options):
        calls.append(options["full"])
        return render(*arguments, **options)

    render = surfel_camera.render
    monkeypatch.setattr(surfel_camera, "render", counted)
    return calls


def test_images_are_those_of_drakes_renderer(surfels):
    camera = SurfelCamera(surfels, CAMERA, label=RenderLabel(7))
    for X_WC in EYES:
        context = context_of(camera, X_WC, state(X_WO))
        colour, depth, mask = picture(VISUAL, CAMERA, X_WO.inverse() @ X_WC)
        label = image(camera, context, "label_image")
        assert set(np.unique(label)) == {7, int(RenderLabel.kEmpty)}
        both = mask & (label == 7)
        # Measured: 0.979 to 0.983.
        assert both.sum() / (mask | (label == 7)).sum() > 0.95
        found = image(camera, context, "depth_image_32f")
        assert np.isinf(found[label != 7]).all()
        # Measured: medians 0.4 to 0.7 mm, 90 % below 4.1 to 7.8 mm: the far side shines through by a few per cent.
        error = np.abs(found[both] - depth[both])
        assert np.median(error) < 0.001
        assert np.quantile(error, 0.9) < 0.012
        millimetres = image(camera, context, "depth_image_16u")
        assert (millimetres[label != 7] == 65535).all()
        assert np.abs(millimetres[both] - 1000.0 * found[both]).max() <= 1.0
        picture_here = image(camera, context, "color_image")
        np.testing.assert_array_equal(picture_here[..., 3], np.where(label == 7, 255, 0))
        assert (picture_here[label != 7] == (255, 255, 255, 0)).all()
        # Drake's light makes colours darker by the cosine of its angle; which one is the strongest stays: for
        # 92 % to 98 % of the pixels, the others being at the borders of patches.
        vivid = both & (np.ptp(colour, axis=2) > 0.3)
        same = picture_here[vivid][:, :3].argmax(axis=1) == colour[vivid].argmax(axis=1)
        assert same.mean() > 0.9


def test_a_mesh_gives_a_coarse_picture_its_outline(surfels):
    camera, mesh = CAMERA.scaled(0.25), load_mesh(model_path("t_block/t_block.obj"))
    cameras = {"mesh": SurfelCamera(surfels, camera, mesh=mesh), "surfels": SurfelCamera(surfels, camera)}
    for X_WC in EYES:
        mask = picture(VISUAL, camera, X_WO.inverse() @ X_WC)[2]
        found = {}
        for name, system in cameras.items():
            context = context_of(system, X_WC, state(X_WO))
            label = image(system, context, "label_image") == 1
            np.testing.assert_array_equal(image(system, context, "color_image")[..., 3] == 255, label)
            np.testing.assert_array_equal(np.isfinite(image(system, context, "depth_image_32f")), label)
            found[name] = (mask & label).sum() / (mask | label).sum()
        # Surfels drawn as wide as pixels had 0.76 to 0.80.
        assert found["mesh"] > 0.98
        assert 0.93 < found["surfels"] < found["mesh"]


def test_depths_out_of_range_are_marked_as_drake_does(surfels):
    X_WC = look_at(np.array([0.3, 0.2, 0.3]), X_WO.translation())
    whole = SurfelCamera(surfels, CAMERA)
    depth = image(whole, context_of(whole, X_WC, state(X_WO)), "depth_image_32f")
    low, high = np.quantile(depth[np.isfinite(depth)], [0.3, 0.7])
    camera = SurfelCamera(surfels, CAMERA, near=low, far=high)
    context = context_of(camera, X_WC, state(X_WO))
    expected = np.where(depth < np.float32(low), 0, np.where(depth > np.float32(high), np.inf, depth))
    np.testing.assert_array_equal(image(camera, context, "depth_image_32f"), expected)
    millimetres = image(camera, context, "depth_image_16u")
    assert (millimetres[expected == 0] == 0).all()
    assert (millimetres[np.isinf(expected)] == 65535).all()


def test_a_batch_equals_single_images(surfels):
    states = [
        state(X_WO),
        state(RigidTransform([0.03, 0, 0.03])),
        state(RigidTransform(RollPitchYaw(0, 0, 1), [0, 0, 0])),
    ]
    batch = SurfelCamera(surfels, CAMERA, num_worlds=3)
    context = context_of(batch, EYES, np.concatenate(states))
    found = batch.GetOutputPort("color_images").Eval(context)
    assert found.shape == (3, 160, 200, 4)
    assert found.dtype == np.uint8
    single = SurfelCamera(surfels, CAMERA)
    for w in range(3):
        alone = context_of(single, EYES[w], states[w])
        np.testing.assert_array_equal(found[w], image(single, alone, "color_image"))
    for name in IMAGES:
        np.testing.assert_array_equal(
            image(batch, context, name), image(single, context_of(single, EYES[0], states[0]), name)
        )
    assert not single.HasOutputPort("color_images")


def test_worlds_have_colours_of_their_own(surfels):
    colours = torch.stack([surfels.sh, surfels.sh.flip(-1)])
    parts = {**surfels.tensors(), "sh": colours}
    batch = SurfelCamera(type(surfels)(**parts), CAMERA, num_worlds=2)
    context = context_of(batch, EYES[:2], np.tile(state(X_WO), 2))
    context_same = context_of(batch, [EYES[0]] * 2, np.tile(state(X_WO), 2))
    first, second = batch.GetOutputPort("color_images").Eval(context_same)
    np.testing.assert_array_equal(first[..., :3], second[..., 2::-1])
    np.testing.assert_array_equal(image(batch, context, "color_image"), first)
    with pytest.raises(ParameterError, match="colours of 2 worlds; allowed: 3"):
        SurfelCamera(type(surfels)(**parts), CAMERA, num_worlds=3)


def test_nothing_is_rendered_until_an_image_is_evaluated_and_then_once(surfels, renderings):
    camera = SurfelCamera(surfels, CAMERA)
    context = context_of(camera, EYES[0], state(X_WO))
    assert camera.GetOutputPort("body_pose_in_world").Eval(context).IsExactlyEqualTo(EYES[0])
    camera.GetOutputPort("image_time").Eval(context)
    assert renderings == []
    for name in IMAGES:
        camera.GetOutputPort(name).Eval(context)
    context.SetTime(1.5)
    before = image(camera, context, "color_image")
    assert camera.GetOutputPort("image_time").Eval(context) == [1.5]
    assert renderings == [True]
    camera.GetInputPort("object_state").FixValue(context, state(RigidTransform([0.1, 0, 0])))
    after = image(camera, context, "color_image")
    camera.GetInputPort("X_WC").FixValue(context, AbstractValue.Make(EYES[1]))
    assert not np.array_equal(before, after)
    assert not np.array_equal(after, image(camera, context, "color_image"))
    assert renderings == [True] * 3


def test_only_the_batch_is_rendered_when_only_the_batch_is_wanted(surfels, renderings):
    camera = SurfelCamera(surfels, CAMERA, num_worlds=2)
    context = context_of(camera, EYES[:2], np.tile(state(X_WO), 2))
    for _ in range(2):
        camera.GetOutputPort("color_images").Eval(context)
    assert renderings == [False]


def test_images_depend_on_the_inputs_directly_and_the_time_does_not(surfels):
    camera = SurfelCamera(surfels, CAMERA, num_worlds=2)
    names = [camera.get_output_port(k).get_name() for k in range(camera.num_output_ports())]
    inputs = ("X_WC", "object_state")
    pairs = ((o, k) for o in range(len(names)) for k in range(2))
    feedthrough = {(names[o], inputs[k]) for o, k in pairs if camera.HasDirectFeedthrough(k, o)}
    expected = {(name, port) for name in (*IMAGES, "color_images") for port in inputs}
    assert feedthrough == expected | {("body_pose_in_world", "X_WC")}


def test_wrong_numbers_are_refused(surfels):
    with pytest.raises(ParameterError, match=r"num_worlds, near, far: got 1, 0.5, 0.4; allowed"):
        SurfelCamera(surfels, CAMERA, near=0.5, far=0.4)
    camera = SurfelCamera(surfels, CAMERA, num_worlds=2)
    context = context_of(camera, EYES, np.tile(state(X_WO), 2))
    with pytest.raises(StateError, match="X_WC: got 3 values; allowed: 2 RigidTransforms"):
        camera.GetOutputPort("color_images").Eval(context)


def test_ports_have_the_names_and_types_of_an_rgbd_sensor(surfels):
    core = RenderCameraCore("vtk", CameraInfo(200, 160, 1.0), ClippingRange(0.1, 10.0), RigidTransform())
    sensor = RgbdSensor(
        SceneGraph.world_frame_id(),
        RigidTransform(),
        ColorRenderCamera(core, False),
        DepthRenderCamera(core, DepthRange(0.1, 10.0)),
    )
    camera = SurfelCamera(surfels, CAMERA)
    names = [camera.get_output_port(k).get_name() for k in range(camera.num_output_ports())]
    assert set(names) <= {sensor.get_output_port(k).get_name() for k in range(sensor.num_output_ports())}
    for name in names[:-1]:
        theirs, mine = (system.GetOutputPort(name).Allocate().get_value() for system in (sensor, camera))
        assert type(theirs) is type(mine)
        assert name not in IMAGES or theirs.shape == mine.shape
