# SPDX-License-Identifier: MIT
"""What a station shows: its `rgb`, and its SceneGraph, with every engine."""

import cv2
import numpy as np
import pytest
from pydrake.geometry import (
    ClippingRange,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    Role,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.cameras.object_camera import OBJECT_LABEL
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import SceneStation, make_station
from tests.systems.stations import FAR, TURNED, output, setup_of, started, station_of


def outline(X_WO: RigidTransform) -> np.ndarray:
    """Where the object's mesh is in the picture: (height, width) bool, by drawing its triangles large."""
    setup, scale = setup_of(), 8
    mesh = load_mesh(setup.twin.mesh_path)
    p_C = (setup.X_WC.inverse() @ X_WO).multiply(mesh.vertices.T).T
    fx, fy, cx, cy = setup.camera.intrinsics.tolist()
    pixels = np.stack([fx * p_C[:, 0] / p_C[:, 2] + cx, fy * p_C[:, 1] / p_C[:, 2] + cy], -1)
    large = np.zeros((scale * setup.camera.height, scale * setup.camera.width), np.uint8)
    for triangle in np.round(scale * pixels - 0.5).astype(np.int32)[mesh.faces]:
        cv2.fillConvexPoly(large, triangle, 255)
    return cv2.resize(large, (setup.camera.width, setup.camera.height), interpolation=cv2.INTER_AREA) >= 128


@pytest.mark.parametrize("engine", ENGINES)
def test_rgb_shows_the_object_where_it_is(engine):
    setup = setup_of()
    station = station_of(engine)
    context = started(station, TURNED)
    picture = output(station, context, "rgb").data
    shown, expected = picture[..., 3] == 255, outline(TURNED)
    assert expected.sum() > 200
    assert set(np.unique(picture[..., 3])) == {0, 255}
    assert (picture[~shown][:, :3] == 255).all()
    assert np.ptp(picture[shown][:, :3].astype(int), axis=0).min() > 60  # in colours
    where, there = (np.argwhere(mask).mean(axis=0) for mask in (shown, expected))
    assert np.abs(where - there).max() < 0.3  # px
    near = cv2.dilate(expected.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    assert not shown[~near].any()
    assert (shown & expected).sum() > 0.95 * (shown | expected).sum()
    # Between camera and object, the pusher takes pixels away.
    towards = setup.X_WC.translation() - TURNED.translation()
    station.SetPlace(context, Place(TURNED, TURNED.translation() + 0.2 * towards))
    hidden = output(station, context, "rgb").data[..., 3] == 255
    assert not (hidden & ~shown).any()
    assert 9 <= (shown & ~hidden).sum() <= 40


def distance(station: SceneStation, context: Context) -> float:
    """Between the pusher and the object, m, as SceneGraph says."""
    query = output(station, context, "query_object")
    inspector = query.inspector()
    ids = inspector.GetAllGeometryIds(Role.kProximity)
    named = {k: inspector.GetName(inspector.GetFrameId(k)) for k in ids}
    mine = [k for k in ids if named[k].endswith("object")]
    hands = [k for k in ids if named[k].endswith("pusher")]
    assert mine
    assert hands
    return min(query.ComputeSignedDistancePairClosestPoints(a, b).distance for a in mine for b in hands)


@pytest.mark.parametrize("engine", ENGINES)
def test_scene_graph_knows_the_distance(engine):
    context = started(station_of(engine), TURNED, TURNED @ np.array([0.01, -0.055 - 0.01 - 0.012, 0.004]))
    assert distance(station_of(engine), context) == pytest.approx(0.012, abs=1e-6)
    # Beside a corner of the stem, 10 mm and 25 mm away from it.
    station_of(engine).SetPlace(context, Place(TURNED, TURNED @ np.array([0.03, 0.11, 0.0])))
    assert distance(station_of(engine), context) == pytest.approx(np.hypot(0.01, 0.025) - 0.01, abs=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
def test_other_cameras_can_be_added(engine):
    setup = setup_of()
    station, camera = make_station(setup, engine), setup.camera
    station.engine.scene_graph.AddRenderer("mine", MakeRenderEngineVtk(RenderEngineVtkParams()))
    info = CameraInfo(camera.width, camera.height, *camera.intrinsics.tolist())
    core = RenderCameraCore("mine", info, ClippingRange(0.05, 5.0), RigidTransform())
    builder = DiagramBuilder()
    builder.AddSystem(station)
    world = station.engine.scene_graph.world_frame_id()
    sensor = builder.AddSystem(RgbdSensor(world, setup.X_WC, DepthRenderCamera(core, DepthRange(0.05, 5.0))))
    builder.Connect(station.GetOutputPort("query_object"), sensor.query_object_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    station.SetPlace(context, Place(TURNED, FAR))
    mine = sensor.GetMyContextFromRoot(context)
    label = sensor.label_image_output_port().Eval(mine).data[..., 0] == int(OBJECT_LABEL)
    expected = outline(TURNED)
    assert (label & expected).sum() > 0.95 * (label | expected).sum()
    depth = sensor.depth_image_32F_output_port().Eval(mine).data[..., 0]
    # The middle of the bar's upper face.
    p_C = setup.X_WC.inverse() @ TURNED @ np.array([0.0, -0.035, 0.025])
    fx, fy, cx, cy = camera.intrinsics.tolist()
    assert depth[int(fy * p_C[1] / p_C[2] + cy), int(fx * p_C[0] / p_C[2] + cx)] == pytest.approx(p_C[2], abs=0.005)
