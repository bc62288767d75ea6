# SPDX-License-Identifier: MIT
"""Further cameras on an object made of surfels: in a robot's hand, or a second view."""

import numpy as np
import torch
import trimesh
from pydrake.common.value import AbstractValue
from pydrake.geometry import RenderLabel
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ConvertDepth32FTo16U, ImageDepth16U, ImageDepth32F, ImageLabel16I

from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.occluder import mesh_depth
from pinwm_drake.rendering.render import Rendering, narrow_disc, narrow_width, render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose, compose, inverse, transform
from pinwm_drake.spatial.rotations import normalize_quaternion
from pinwm_drake.systems.cameras.object_camera import OBJECT_LABEL
from pinwm_drake.systems.cameras.surfel_images import cut_out
from pinwm_drake.systems.ports import declare_cache, declare_image, declare_value, declare_vector, unowned

_NEAR = 1e-3  # m, of the mesh
_TOO_CLOSE = 0.0  # as in RgbdSensor's depth images; too far is infinite


class SurfelCamera(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """A camera that sees the objects of W worlds, each alone.

                               ┌──────────────┐
                               │              │─► color_image         ImageRgba8U: sRGB, alpha 255 on the object
        X_WC                   │              │─► depth_image_32f     ImageDepth32F [m], along the camera's axis
        W = 1: RigidTransform  │              │─► depth_image_16u     ImageDepth16U [mm]
        W > 1: list of W ─────►│              │─► label_image         ImageLabel16I: `label`, or RenderLabel.kEmpty
                               │ SurfelCamera │─► body_pose_in_world  RigidTransform: X_WC
        object_state (13 W) ──►│              │─► image_time (1)      s
        q_WO, p_WO [m], V_WO   │              │
                               │              │   only where W > 1, of all worlds:
                               │              │─► color_images        Value[array] (W, height, width, 4) uint8
                               └──────────────┘

    Camera frame C with OpenCV's axes, as RgbdSensor's. Images of one world are those of world 0. The object is where
    surfels cover half of a pixel or more, within the outline of its mesh if there is one; elsewhere a color image is
    white with alpha 0, and depth is infinite (65535 mm), as it is beyond `far`; nearer than `near` it is 0. All images
    but the batch come from one rendering, made when the first of them is evaluated, and kept by Drake until an input
    changes. All outputs but image_time depend on the inputs directly. The pusher is not seen; it is in the `rgb` port
    of WorldModel.

    Args:
        surfels: Surfels of the object, frame O; one set of colours, or one for each world.
        camera: Camera with intrinsics (4,).
        mesh: Mesh of the object, m, frame O, whose outline images have. None takes all that surfels cover, which
            is a little more.
        num_worlds: W.
        near: Least depth, m; depths below it are too close.
        far: Largest depth, m; depths above it are too far.
        label: Label of the object.

    Raises:
        ParameterError: A number is out of range.
        RenderingError: Shapes of the surfels do not fit.
    """

    def __init__(
        self,
        surfels: Surfels,
        camera: Camera,
        *,
        mesh: trimesh.Trimesh | None = None,
        num_worlds: int = 1,
        near: float = 0.02,
        far: float = 10.0,
        label: RenderLabel = OBJECT_LABEL,
    ) -> None:
        super().__init__()
        if num_worlds < 1 or not 0.0 < near < far:
            raise ParameterError(
                f"num_worlds, near, far: got {num_worlds}, {near:g}, {far:g}; allowed: 1 or more, 0 < near < far [m]"
            )
        surfels.check_shapes()
        if surfels.sh.ndim == 4 and len(surfels.sh) != num_worlds:
            raise ParameterError(f"colours of {len(surfels.sh)} worlds; allowed: {num_worlds}, or one set for all")
        self.surfels, self.camera, self.num_worlds = surfels.detach(), camera, num_worlds
        self._width = narrow_width(surfels)
        self._mesh = None if mesh is None else (np.array(mesh.vertices), np.array(mesh.faces))
        self._near, self._far, self._label = near, far, int(label)
        poses = RigidTransform() if num_worlds == 1 else [RigidTransform()] * num_worlds
        self._pose = self.DeclareAbstractInputPort("X_WC", AbstractValue.Make(poses))
        self._state = self.DeclareVectorInputPort("object_state", 13 * num_worlds)
        inputs = {self._pose.ticket(), self._state.ticket()}
        self._view = declare_cache(self, "view", lambda context: self._render(context, 1, full=True), inputs)
        size, shown = (camera.width, camera.height), {self._view.ticket()}
        declare_image(self, "color_image", size, lambda mine: cut_out(*self._view.Eval(mine))[0], shown)
        declare_image(
            self, "depth_image_32f", size, lambda context: self._depth(context)[..., None], shown, ImageDepth32F
        )
        self.DeclareAbstractOutputPort(
            "depth_image_16u", lambda: AbstractValue.Make(ImageDepth16U(*size)), unowned(self, self._CalcDepth16), shown
        )
        declare_image(self, "label_image", size, self._labels, shown, ImageLabel16I)
        pose = {self._pose.ticket()}
        declare_value(self, "body_pose_in_world", RigidTransform(), lambda context: self._poses(context)[0], pose)
        declare_vector(self, "image_time", 1, lambda context: [context.get_time()], {self.time_ticket()})
        if num_worlds > 1:
            batch = declare_cache(
                self, "views", lambda mine: cut_out(*self._render(mine, num_worlds, full=False)), inputs
            )
            declare_value(self, "color_images", object(), lambda context: batch.Eval(context), {batch.ticket()})

    def _poses(self, context: Context) -> list[RigidTransform]:
        poses = self._pose.Eval(context)
        if self.num_worlds == 1:
            return [poses]
        if len(poses) != self.num_worlds or not all(isinstance(pose, RigidTransform) for pose in poses):
            raise StateError(f"X_WC: got {len(poses)} values; allowed: {self.num_worlds} RigidTransforms")
        return list(poses)

    def _render(self, context: Context, worlds: int, *, full: bool) -> tuple[Rendering, np.ndarray]:
        """Images, and the mask (V, height, width) bool of the object."""
        poses = self._poses(context)[:worlds]
        state = torch.tensor(self._state.Eval(context)).reshape(-1, 13)[:worlds]
        X_WC = Pose(
            torch.from_numpy(np.stack([pose.rotation().ToQuaternion().wxyz() for pose in poses])),
            torch.from_numpy(np.stack([pose.translation() for pose in poses])),
        )
        X_CO = compose(inverse(X_WC), Pose(normalize_quaternion(state[:, :4]), state[:, 4:7]))
        surfels = self.surfels
        if surfels.sh.ndim == 4:
            surfels = Surfels(**{**surfels.tensors(), "sh": surfels.sh[:worlds]})
        disc = narrow_disc(self._width, self.camera, X_CO.p[:, 2])
        views = render(surfels, self.camera, X_CO, full=full, disc=disc)
        shown = views.alpha.numpy() >= 0.5
        if self._mesh is not None:
            vertices, faces = self._mesh
            corners = transform(Pose(X_CO.q[:, None], X_CO.p[:, None]), torch.from_numpy(vertices))
            shown &= np.isfinite(mesh_depth(corners, faces, self.camera, _NEAR))
        return views, shown

    def _CalcDepth16(self, context: Context, output: AbstractValue) -> None:
        metres = ImageDepth32F(self.camera.width, self.camera.height)
        metres.mutable_data[..., 0] = self._depth(context)
        ConvertDepth32FTo16U(metres, output.get_mutable_value())

    def _labels(self, context: Context) -> np.ndarray:
        return np.where(self._view.Eval(context)[1][0], self._label, int(RenderLabel.kEmpty))[..., None]

    def _depth(self, context: Context) -> np.ndarray:
        images, shown = self._view.Eval(context)
        alpha = np.maximum(images.alpha[0].numpy(), 0.5)
        depth = np.where(shown[0], images.depth[0].numpy() / alpha, np.inf)
        depth[depth > self._far] = np.inf
        depth[depth < self._near] = _TOO_CLOSE
        return depth.astype(np.float32)
