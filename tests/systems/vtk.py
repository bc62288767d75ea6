# SPDX-License-Identifier: MIT
"""Drake's own picture of a mesh, to compare with."""

from pathlib import Path

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    GeometryId,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
)
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo, ImageDepth32F, ImageLabel16I, ImageRgba8U

from pinwm_drake.rendering.camera import Camera

NEAR, FAR = 0.05, 5.0  # m


def picture(visual_path: Path, camera: Camera, X_OC: RigidTransform) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour (H, W, 3) in [0, 1] on white, depth (H, W) [m], and where the mesh is (H, W); one light, the camera's."""
    properties = PerceptionProperties()
    properties.AddProperty("label", "id", RenderLabel(1))
    engine = MakeRenderEngineVtk(RenderEngineVtkParams(default_clear_color=np.ones(3)))
    engine.RegisterVisual(GeometryId.get_new_id(), Mesh(str(visual_path)), properties, RigidTransform(), False)
    engine.UpdateViewpoint(X_OC)
    info = CameraInfo(camera.width, camera.height, *camera.intrinsics.tolist())
    core = RenderCameraCore("vtk", info, ClippingRange(NEAR, FAR), RigidTransform())
    size = (camera.width, camera.height)
    colour, depth, label = ImageRgba8U(*size), ImageDepth32F(*size), ImageLabel16I(*size)
    engine.RenderColorImage(ColorRenderCamera(core, False), colour)
    engine.RenderDepthImage(DepthRenderCamera(core, DepthRange(NEAR, FAR)), depth)
    engine.RenderLabelImage(ColorRenderCamera(core, False), label)
    return colour.data[..., :3] / 255.0, depth.data[..., 0].copy(), label.data[..., 0] == 1
