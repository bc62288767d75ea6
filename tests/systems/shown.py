# SPDX-License-Identifier: MIT
"""A small diagram that Meshcat shows, and what Meshcat was told."""

from dataclasses import dataclass

import numpy as np
import torch
import umsgpack
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    Box,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    Meshcat,
    PerceptionProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from pinwm_drake.models import model_path
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.systems.engines.engine import ContactForces
from pinwm_drake.systems.scenario.viewpoints import look_at
from pinwm_drake.systems.view.scene import AddSceneView

CAMERA = Camera(64, 48, torch.tensor([60.0, 62.0, 30.0, 25.0], dtype=torch.float64))
X_WC = look_at(np.array([0.3, -0.4, 0.5]), np.zeros(3))
X_WO = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.1, 0.2, 0.3])


@dataclass
class SmallTwin:
    surfels: object
    floor_height: float


@dataclass
class SmallSetup:
    twin: SmallTwin
    camera: Camera = CAMERA
    X_WC: RigidTransform = X_WC


def small_setup() -> SmallSetup:
    return SmallSetup(SmallTwin(painted_surfels(model_path("cube/cube_visual.obj"), 200), 0.02))


def station(
    meshcat: Meshcat, setup: SmallSetup, name: str = "twin", forces: ContactForces | None = None, **options: object
) -> Diagram:
    """A diagram that shows a box that stands still, of an engine with two worlds."""
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    source = scene_graph.RegisterSource("test")
    frame: FrameId = scene_graph.RegisterFrame(source, GeometryFrame("box::object"))
    visual = GeometryInstance(RigidTransform(), Box(0.06, 0.06, 0.06), "box")
    visual.set_perception_properties(PerceptionProperties())
    scene_graph.RegisterGeometry(source, frame, visual)
    poses = FramePoseVector()
    poses.set_value(frame, X_WO)
    pose_source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(poses)))
    builder.Connect(pose_source.get_output_port(), scene_graph.get_source_pose_port(source))
    world = np.concatenate([X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation(), np.zeros(6)])
    state = builder.AddSystem(ConstantVectorSource(np.concatenate([world, np.zeros(13)])))
    contact = builder.AddSystem(ConstantValueSource(AbstractValue.Make(forces or ContactForces.none())))
    port = state.get_output_port()
    AddSceneView(builder, name, scene_graph, port, contact.get_output_port(), meshcat, setup, **options)
    return builder.Build()


def matrix(meshcat: Meshcat, path: str) -> np.ndarray:
    message = umsgpack.unpackb(meshcat._GetPackedTransform(path))
    return np.array(message["matrix"]).reshape(4, 4).T


def value(meshcat: Meshcat, path: str, name: str) -> object:
    return umsgpack.unpackb(meshcat._GetPackedProperty(path, name))["value"]
