"""Pictures of a twin's worlds: its surfels, and the pusher that hides them."""

import numpy as np
import torch
import trimesh
from pinwm_drake.rendering.occluder import mesh_depth
from pydrake.math import RigidTransform

from pinwm_drake.rendering import Camera, Surfels, render
from pinwm_drake.spatial.poses import Pose, compose
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_NEAR = 1e-3  # m
_NOTHING = 0x00FFFFFF  # white, alpha 0, as the bytes of a little-endian number


class WorldImages:
    """A camera that stands still and sees the objects of W worlds, each with its own pusher."""

    def __init__(
        self,
        surfels: Surfels,
        object_mesh: trimesh.Trimesh,
        pusher_mesh: trimesh.Trimesh,
        camera: Camera,
        X_WC: RigidTransform,
        num_threads: int | None = None,
    ) -> None:
        """Takes over what does not move.

        Args:
            surfels: Of the object, frame O.
            object_mesh: m, frame O; tells where the object is, and whether the pusher stands before or behind it.
            pusher_mesh: m, frame P.
            camera: Intrinsics (4,).
            X_WC: Its pose, OpenCV axes.
            num_threads: Of the renderer; None for one on each core.
        """
        self.surfels, self.camera = surfels, camera
        self._object, self._pusher = object_mesh, pusher_mesh
        X_CW = X_WC.inverse()
        q_CW = torch.tensor(X_CW.rotation().ToQuaternion().wxyz())
        self._X_CW = Pose(q_CW, torch.tensor(X_CW.translation()))
        self._R_CW, self._p_CW = X_CW.rotation().matrix(), X_CW.translation()
        self._threads = num_threads

    def take(self, object_state: np.ndarray, p_WP: np.ndarray, sh: torch.Tensor) -> np.ndarray:
        """Renders W worlds.

        Args:
            object_state: (W, 13), of which the pose counts.
            p_WP: (W, 3) m.
            sh: (N, K, 3), or (W, N, K, 3) where worlds differ: the surfels' harmonics.

        Returns:
            (W, height, width, 4) uint8, sRGB and alpha: 255 where the object is seen and the pusher does not hide it,
            with the object's colour; white and 0 elsewhere.
        """
        W = len(object_state)
        q, p = torch.from_numpy(object_state[:, :4].copy()), torch.from_numpy(object_state[:, 4:7].copy())
        X_CO = compose(Pose(self._X_CW.q.expand(W, 4), self._X_CW.p.expand(W, 3)), Pose(q, p))
        surfels = Surfels(self.surfels.p_OS, self.surfels.q_OS, self.surfels.log_scale, self.surfels.logit_opacity, sh)
        image = render(surfels, self.camera, X_CO, full=False, num_threads=self._threads)
        color, alpha = image.color.numpy().reshape(-1, 3), image.alpha.numpy()
        shown = (alpha >= 0.5) & self._visible(X_CO, p_WP)
        at = np.flatnonzero(shown)
        weight = alpha.reshape(-1)[at][:, None]
        pictures = np.full(shown.shape, _NOTHING, "<u4").view(np.uint8).reshape(*shown.shape, 4)
        flat = pictures.reshape(-1, 4)
        # What the surfels add to the white behind them.
        own = 1.0 - (1.0 - color[at]) / weight
        flat[at, :3] = np.clip(255.0 * own + 0.5, 0.0, 255.0).astype(np.uint8)
        flat[at, 3] = 255
        return pictures

    def _visible(self, X_CO: Pose, p_WP: np.ndarray) -> np.ndarray:
        """(W, height, width): where the object's mesh is and the pusher does not stand before it.

        Small surfels are drawn wider than they are, by up to a pixel, which is much in a small image; the mesh is not.
        """
        corners = self._object.vertices @ quaternion_to_matrix(X_CO.q).mT.numpy() + X_CO.p.numpy()[:, None]
        depth = mesh_depth(corners, self._object.faces, self.camera, _NEAR)
        p_CP = p_WP @ self._R_CW.T + self._p_CW
        corners = self._pusher.vertices @ self._R_CW.T + p_CP[:, None]
        visible: np.ndarray = depth < mesh_depth(corners, self._pusher.faces, self.camera, _NEAR)
        return visible
