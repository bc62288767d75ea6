# SPDX-License-Identifier: MIT
"""Cameras of an object: Drake's RgbdSensor, and images whose alpha is the visible object."""

import math
import os
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.sensors import CameraInfo, ImageLabel16I, ImageRgba8U, RgbdSensor

from pinwm_drake.errors import StateError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.ports import declare_cache, declare_image, declare_value

_RENDERER = "vtk"
_NEAR, _FAR = 0.05, 20.0  # m
_SIDE_LIGHTS, _ELEVATION = 8, math.radians(20)
_SIDE_INTENSITY, _TOP_INTENSITY = 0.30, 0.10
OBJECT_LABEL, PUSHER_LABEL = RenderLabel(1), RenderLabel(2)


def _lights() -> list[LightParameter]:
    """Lights from above and from all sides, so that an object that turns keeps its colours."""
    directions = [(0.0, 0.0, -1.0, _TOP_INTENSITY)]
    for k in range(_SIDE_LIGHTS):
        angle, level = 2 * math.pi * k / _SIDE_LIGHTS, math.cos(_ELEVATION)
        directions.append((level * math.cos(angle), level * math.sin(angle), -math.sin(_ELEVATION), _SIDE_INTENSITY))
    return [
        LightParameter(
            type="directional", color=Rgba(1, 1, 1), frame="world", intensity=intensity, direction=np.array([x, y, z])
        )
        for x, y, z, intensity in directions
    ]


@dataclass(frozen=True, eq=False)
class CaptureRig:
    """Camera that can be put anywhere.

    Attributes:
        sensor: Drake's sensor, whose ports are `color_image` and `label_image` of the last pose that was set.
        camera: Camera model of its pictures; intrinsics (4,).
        supersampling: So many times more pixels along each side are rendered.
    """

    sensor: RgbdSensor
    camera: Camera
    supersampling: int

    def take(self, context: Context, X_WC: RigidTransform) -> np.ndarray:
        """Take a picture of the scene as it is.

        Args:
            context: Context of the diagram.
            X_WC: Pose of the camera, OpenCV axes.

        Returns:
            (height, width, 4) uint8, sRGB and alpha: 255 where half of the pixel or more shows the object, with the
            colour of that part; white and 0 elsewhere.
        """
        mine = self.sensor.GetMyMutableContextFromRoot(context)
        self.sensor.SetX_PB(mine, X_WC)
        colour = np.asarray(self.sensor.color_image_output_port().Eval(mine).data)[..., :3]
        label = np.asarray(self.sensor.label_image_output_port().Eval(mine).data)[..., 0]
        return downsample(colour, label == int(OBJECT_LABEL), self.supersampling)


def AddCaptureRig(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    camera: Camera,
    supersampling: int,
    X_WC: RigidTransform | None = None,
    query: OutputPort | None = None,
    renderer: RenderEngineVtkParams | None = None,
) -> CaptureRig:
    """Add a camera to a diagram, and a renderer to its scene graph where it has none yet.

    Args:
        builder: Builder of the diagram.
        scene_graph: Geometries that the camera sees.
        camera: Size and intrinsics (4,) of the pictures.
        supersampling: Number of rendered pixels that make one, along each side.
        X_WC: Pose of the camera until another one is set, OpenCV axes; None for the world's.
        query: The scene graph's query port as the diagram has it; None for that of the scene graph itself.
        renderer: Settings of the renderer that is added; None for even light from all sides.
    """
    if not scene_graph.HasRenderer(_RENDERER):
        even = RenderEngineVtkParams(default_clear_color=np.ones(3), lights=_lights())
        scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(renderer or even))
    focal_x, focal_y, centre_x, centre_y = (supersampling * camera.intrinsics).tolist()
    # The engine takes the principal point from the corner of the image, as this project does, although Drake's
    # documentation counts from the middle of the first pixel: measured in tests/systems/cameras/.
    info = CameraInfo(supersampling * camera.width, supersampling * camera.height, focal_x, focal_y, centre_x, centre_y)
    core = RenderCameraCore(_RENDERER, info, ClippingRange(_NEAR, _FAR), RigidTransform())
    sensor = builder.AddSystem(
        RgbdSensor(
            scene_graph.world_frame_id(),
            X_WC or RigidTransform(),
            ColorRenderCamera(core, False),
            DepthRenderCamera(core, DepthRange(_NEAR, _FAR)),
        )
    )
    builder.Connect(query or scene_graph.get_query_output_port(), sensor.query_object_input_port())
    return CaptureRig(sensor, camera, supersampling)


def downsample(colour: np.ndarray, shown: np.ndarray, factor: int) -> np.ndarray:
    """Picture of an object from one with more pixels.

    A pixel shows the object where half of its parts or more do, so that outlines stay where they are on average; its
    colour is the mean of these parts and holds nothing of the background.

    Args:
        colour: (factor height, factor width, 3) uint8.
        shown: (factor height, factor width) bool, where the object is.
        factor: Parts along each side of a pixel.

    Returns:
        (height, width, 4) uint8, alpha 255 on the object; white and 0 elsewhere.
    """
    height, width = shown.shape[0] // factor, shown.shape[1] // factor
    picture = np.full((height, width, 4), (255, 255, 255, 0), np.uint8)
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    if not len(rows):
        return picture
    # Only the box of pixels around the object has to be looked at.
    top, left = rows[0] // factor, columns[0] // factor
    bottom, right = rows[-1] // factor + 1, columns[-1] // factor + 1
    window = np.s_[top * factor : bottom * factor, left * factor : right * factor]
    parts = shown[window].reshape(bottom - top, factor, right - left, factor)
    colours = np.where(parts[..., None], colour[window].reshape(*parts.shape, 3), np.uint8(0))
    number = parts.sum(axis=(1, 3), dtype=np.uint32)
    total = colours.sum(axis=(1, 3), dtype=np.uint32)
    on = 2 * number >= factor**2
    box = picture[top:bottom, left:right]
    box[on, :3] = np.round(total[on] / number[on][:, None]).astype(np.uint8)
    box[on, 3] = 255
    return picture


_renderer_process: int | None = None  # that rendered first, of this one and those that it was forked from


def _require_own_renderer() -> None:
    """Raise StateError where the process was forked after a rendering: Mesa would wait for its parent's threads."""
    global _renderer_process
    if _renderer_process not in (None, os.getpid()):
        raise StateError(
            "camera: got a process that was forked from one that has rendered with Drake; "
            'allowed: context="spawn" or "forkserver" of multiprocessing and AsyncVectorEnv'
        )
    _renderer_process = os.getpid()


class ObjectImage(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Cuts the object out of a camera's picture, and makes one pixel of several.

                                                   ┌─────────────┐
        color_image  ImageRgba8U   (s W x s H) ───►│ ObjectImage │─► rgb  ImageRgba8U (W x H): sRGB, alpha 255 where
        label_image  ImageLabel16I (s W x s H) ───►│             │   the object is seen; white, alpha 0 elsewhere
                                                   │             │─► rgb_batch  Value[array]: the same, (1, H, W, 4)
                                                   └─────────────┘   direct feedthrough

    The picture is made once for both ports. See `downsample`.

    Args:
        width: W, px.
        height: H, px.
        supersampling: Number s of rendered pixels that make one, along each side.
    """

    def __init__(self, width: int, height: int, supersampling: int) -> None:
        super().__init__()
        self._factor = supersampling
        size = (supersampling * width, supersampling * height)
        self._colour = self.DeclareAbstractInputPort("color_image", AbstractValue.Make(ImageRgba8U(*size)))
        self._label = self.DeclareAbstractInputPort("label_image", AbstractValue.Make(ImageLabel16I(*size)))
        inputs = {self._colour.ticket(), self._label.ticket()}
        picture = declare_cache(self, "picture", self._CalcPicture, inputs)
        made = {picture.ticket()}
        declare_image(self, "rgb", (width, height), lambda context: picture.Eval(context), made)
        declare_value(self, "rgb_batch", object(), lambda context: picture.Eval(context)[None], made)

    def _CalcPicture(self, context: Context) -> np.ndarray:
        _require_own_renderer()
        colour = np.asarray(self._colour.Eval(context).data)[..., :3]
        label = np.asarray(self._label.Eval(context).data)[..., 0]
        return downsample(colour, label == int(OBJECT_LABEL), self._factor)


def AddObjectImage(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    camera: Camera,
    supersampling: int,
    X_WC: RigidTransform,
    renderer: RenderEngineVtkParams | None = None,
) -> ObjectImage:
    """Add a camera, and the "object_image" that cuts the object out of its pictures; see `AddCaptureRig`."""
    rig = AddCaptureRig(builder, scene_graph, camera, supersampling, X_WC, renderer=renderer)
    image = builder.AddNamedSystem("object_image", ObjectImage(camera.width, camera.height, supersampling))
    builder.Connect(rig.sensor.color_image_output_port(), image.GetInputPort("color_image"))
    builder.Connect(rig.sensor.label_image_output_port(), image.GetInputPort("label_image"))
    return image
