# SPDX-License-Identifier: MIT
"""View of a station in Meshcat: geometries, floor, camera, contact forces and surfels."""

import math

import numpy as np
from pydrake.geometry import (
    Box,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder, OutputPort

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.view.forces import MeshcatForces
from pinwm_drake.systems.view.surfels import MeshcatSurfels

PERIOD = 1 / 30  # s, of simulated time, between publishes
PREFIX = "/station"
# Opaque: a floor of which one sees through would be mixed with the soft rims of surfels in any order.
_FLOOR_SIDE, _FLOOR_DEPTH, _FLOOR_COLOUR = 1.2, 0.001, Rgba(0.82, 0.83, 0.85)  # m
_FRUSTUM_COLOUR, _FRUSTUM_ABOVE = Rgba(0.15, 0.35, 0.75), 0.001  # m, of its edges above the floor
# The page, whose angle of view is 75 degrees, looks from the camera's right, and from this share of its distance.
_EYE, _EYE_TURN = 0.7, math.radians(50)


def AddSceneView(
    builder: DiagramBuilder,
    engine: str,
    scene_graph: SceneGraph,
    object_state: OutputPort,
    contact_forces: OutputPort,
    meshcat: Meshcat,
    setup: Setup,
    *,
    period: float = PERIOD,
    prefix: str = PREFIX,
) -> MeshcatVisualizer:
    """Add the systems that show an engine in Meshcat to a diagram.

    The surfels are shown with the twin, in place of the object's mesh, and hidden with other engines; the page's
    controls show either. With "lcm" there are none, as nobody knows where the object is. Everything is published every
    `period`, and when a publish is forced.

    Args:
        builder: Builder of the diagram that holds the engine.
        engine: Name of the engine.
        scene_graph: SceneGraph whose geometries are shown.
        object_state: State (13 W) of the objects, as in `Engine`.
        contact_forces: Value[ContactForces].
        meshcat: The server.
        setup: Setup that the engine was built from.
        period: Simulated time between publishes, s.
        prefix: Prefix of all paths in Meshcat's tree; `meshcat.SetTransform(prefix, ...)` puts one station beside
            another.
    """
    meshcat.SetObject(f"{prefix}/floor", Box(_FLOOR_SIDE, _FLOOR_SIDE, _FLOOR_DEPTH), _FLOOR_COLOUR)
    # A little lower, so that faces that lie on it are not mixed with it.
    X_WF = RigidTransform([0.0, 0.0, setup.twin.floor_height - 0.6 * _FLOOR_DEPTH])
    meshcat.SetTransform(f"{prefix}/floor", X_WF)
    for name in ("/Grid", "/Axes"):
        meshcat.SetProperty(name, "visible", False)
    _draw_camera(meshcat, f"{prefix}/camera", setup.camera, setup.X_WC, setup.twin.floor_height)
    # What cameras see. Not deleted when a simulation begins, so that what is hidden stays so.
    params = MeshcatVisualizerParams(
        publish_period=period, role=Role.kPerception, prefix=f"{prefix}/scene", delete_on_initialization_event=False
    )
    visualizer = MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
    if engine != "lcm":
        W = object_state.size() // 13
        surfels = builder.AddNamedSystem(
            "meshcat_surfels",
            MeshcatSurfels(setup.twin.surfels, meshcat, num_worlds=W, period=period, path=f"{prefix}/surfels"),
        )
        builder.Connect(object_state, surfels.get_input_port())
    forces = builder.AddNamedSystem("meshcat_forces", MeshcatForces(meshcat, period=period, path=f"{prefix}/forces"))
    builder.Connect(contact_forces, forces.get_input_port())
    shows_surfels = engine == "twin"
    meshcat.SetProperty(f"{prefix}/surfels", "visible", shows_surfels)
    for path in _object_paths(scene_graph, params.prefix):
        meshcat.SetProperty(path, "visible", not shows_surfels)
    return visualizer


def _object_paths(scene_graph: SceneGraph, prefix: str) -> list[str]:
    """Paths at which MeshcatVisualizer puts the body "object": the parts of a frame's name become a path."""
    inspector = scene_graph.model_inspector()
    names = (inspector.GetName(frame).split("::") for frame in inspector.GetAllFrameIds())
    return ["/".join([prefix, *parts]) for parts in names if parts[-1] == "object"]


def _draw_camera(meshcat: Meshcat, path: str, camera: Camera, X_WC: RigidTransform, floor_height: float) -> None:
    """Draw what a camera sees, down to the floor, and have the page look at the middle of that from aside."""
    p_WC, R_WC = X_WC.translation(), X_WC.rotation().matrix()
    rays_W = R_WC @ _corner_rays(camera)
    fall = (floor_height + _FRUSTUM_ABOVE - p_WC[2]) / np.where(
        rays_W[2] * (p_WC[2] - floor_height) < 0, rays_W[2], np.nan
    )
    # Half a metre, or that of the other corners, where a corner looks past the floor.
    depths = np.nan_to_num(fall, nan=float(np.nanmax(fall)) if np.isfinite(fall).any() else 0.5)
    start, end = frustum(camera, depths)
    meshcat.SetLineSegments(path, start, end, 2.0, _FRUSTUM_COLOUR)
    meshcat.SetTransform(path, X_WC)
    # Where its axis meets the height of the world's origin, if ahead; else half a metre ahead.
    forward = R_WC[:, 2]
    distance = -p_WC[2] / forward[2] if p_WC[2] * forward[2] < 0 else 0.5
    target = p_WC + distance * forward
    side = RotationMatrix.MakeZRotation(_EYE_TURN) @ (p_WC - target)
    meshcat.SetCameraPose(target + _EYE * side, target)


def frustum(camera: Camera, depth: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the pyramid that a camera sees.

    Args:
        camera: Intrinsics (4,).
        depth: m, along its axis; one, or (4,) of the corners.

    Returns:
        Starts and ends (3, 8) of its edges, m, camera frame C: from its centre to the corners of the image (0, 0),
        (W, 0), (W, H), (0, H), and around it.
    """
    corners = depth * _corner_rays(camera)
    start = np.concatenate([np.zeros((3, 4)), corners], axis=1)
    end = np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=1)
    return np.asfortranarray(start), np.asfortranarray(end)


def _corner_rays(camera: Camera) -> np.ndarray:
    """Directions (3, 4) of the image's corners, of depth 1, camera frame C."""
    fx, fy, cx, cy = camera.intrinsics.tolist()
    x, y = np.array([0, camera.width, camera.width, 0]), np.array([0, 0, camera.height, camera.height])
    return np.stack([(x - cx) / fx, (y - cy) / fy, np.ones(4)])
