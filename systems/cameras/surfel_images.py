# SPDX-License-Identifier: MIT
"""Pictures of a twin's worlds: its surfels, and the pusher that hides them."""

import numpy as np
import torch
import trimesh

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.kernels.light import light_surfels
from pinwm_drake.rendering.occluder import mesh_depth
from pinwm_drake.rendering.render import Rendering, narrow_disc, narrow_width, render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_to_matrix
from pinwm_drake.threads import available, share

_NEAR = 1e-3  # m
# Alpha of surfels that is enough to tell their colour. The outline is the mesh's: with 0.5 here, 6 % of a small image's
# outline was missing at corners (IoU 0.93; 0.98 with 0.1).
_LEAST = 0.1
EVEN = np.array([1.0, 0.0, 0.0, 0.0])  # light that leaves colours as they are
_NOTHING = 0x00FFFFFF  # white, alpha 0, as the bytes of a little-endian number


class WorldImages:
    """Cameras that see the objects of W worlds, each with its own pusher.

    Args:
        surfels: Surfels of the object, frame O.
        object_mesh: m, frame O; tells where the object is, and whether the pusher stands before or behind it.
        pusher_mesh: m, frame P.
        camera: Intrinsics (4,).
    """

    def __init__(
        self, surfels: Surfels, object_mesh: trimesh.Trimesh, pusher_mesh: trimesh.Trimesh, camera: Camera
    ) -> None:
        self.surfels, self.camera, self._width = surfels, camera, narrow_width(surfels)
        self._object = np.asarray(object_mesh.vertices), np.asarray(object_mesh.faces)
        self._pusher = np.asarray(pusher_mesh.vertices), np.asarray(pusher_mesh.faces)
        self._p_OS = np.ascontiguousarray(surfels.p_OS.numpy(), np.float32)
        self._n_OS = quaternion_to_matrix(normalize_quaternion(surfels.q_OS))[..., 2].float().contiguous().numpy()

    def take(
        self, object_state: np.ndarray, p_WP: np.ndarray, sh: torch.Tensor, X_CW: np.ndarray, lights: np.ndarray
    ) -> np.ndarray:
        """Take the pictures of W worlds.

        Args:
            object_state: (W, 13), states of the objects, of which the pose counts.
            p_WP: (W, 3) m, positions of the pushers, world.
            sh: (N, K, 3), or (W, N, K, 3) where worlds differ: the surfels' harmonics.
            X_CW: (W, 7), of the cameras, OpenCV axes: q_CW wxyz, p_CW [m].
            lights: (W, 4), a and g, world axes: a surfel with normal n keeps a share a + g n of its colour.

        Returns:
            (W, height, width, 4) uint8, sRGB and alpha: 255 where the object is seen and the pusher does not hide it,
            with the object's colour; white and 0 elsewhere.
        """
        q_CW, p_CW = X_CW[:, :4], X_CW[:, 4:]
        q_CO = _product(q_CW, object_state[:, :4])
        p_CO = _turned(q_CW, object_state[:, None, 4:7])[:, 0] + p_CW
        X_CO = Pose(torch.from_numpy(q_CO), torch.from_numpy(p_CO))
        if (lights != EVEN).any():
            sh = self._lit(sh, q_CO, p_CO, object_state[:, :4], lights)
        surfels = Surfels(self.surfels.p_OS, self.surfels.q_OS, self.surfels.log_scale, self.surfels.logit_opacity, sh)
        disc = narrow_disc(self._width, self.camera, X_CO.p[:, 2])
        image = render(surfels, self.camera, X_CO, full=False, disc=disc)
        return cut_out(image, (image.alpha.numpy() >= _LEAST) & self._visible(q_CO, p_CO, p_WP, X_CW))

    def _lit(
        self, sh: torch.Tensor, q_CO: np.ndarray, p_CO: np.ndarray, q_WO: np.ndarray, lights: np.ndarray
    ) -> torch.Tensor:
        """Harmonics (W, N, K, 3) of the surfels in lights (W, 4), world axes, whose objects have orientations q_WO."""
        given = sh.numpy()[None] if sh.ndim == 3 else sh.numpy()
        lit = np.empty((len(lights), *given.shape[1:]), np.float32)
        lights_O = np.concatenate([lights[:, :1], _turned_back(q_WO, lights[:, 1:])], axis=1, dtype=np.float32)
        eyes = -_turned_back(q_CO, p_CO).astype(np.float32)
        share(light_surfels, (given, self._p_OS, self._n_OS, eyes, lights_O, lit), len(lights), available())
        return torch.from_numpy(lit)

    def _visible(self, q_CO: np.ndarray, p_CO: np.ndarray, p_WP: np.ndarray, X_CW: np.ndarray) -> np.ndarray:
        """Mask (W, height, width) of the object's mesh where the pusher does not stand before it.

        Surfels fade out beyond the border of what they cover; the mesh does not.
        """
        vertices, faces = self._object
        depth = mesh_depth(_turned(q_CO, vertices) + p_CO[:, None], faces, self.camera, _NEAR)
        vertices, faces = self._pusher
        corners = _turned(X_CW[:, :4], vertices + p_WP[:, None]) + X_CW[:, None, 4:]
        return np.asarray(depth < mesh_depth(corners, faces, self.camera, _NEAR))


def cut_out(image: Rendering, shown: np.ndarray) -> np.ndarray:
    """Pictures of an object alone, from a rendering in front of white.

    Args:
        image: V views.
        shown: (V, height, width) bool, where the object is; alpha is above 0 there.

    Returns:
        (V, height, width, 4) uint8, sRGB and alpha: 255 where the object is, with the colour of its surfels; white and
        0 elsewhere.
    """
    pictures = np.full(shown.shape, _NOTHING, "<u4").view(np.uint8).reshape(*shown.shape, 4)
    at = np.flatnonzero(shown)
    # What the surfels add to the white behind them.
    own = 1.0 - (1.0 - image.color.numpy().reshape(-1, 3)[at]) / image.alpha.numpy().reshape(-1)[at][:, None]
    flat = pictures.reshape(-1, 4)
    flat[at, :3] = np.clip(255.0 * own + 0.5, 0.0, 255.0).astype(np.uint8)
    flat[at, 3] = 255
    return pictures


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion products a b of a and b, (W, 4) each, wxyz."""
    w, x, y, z = a.T
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(np.einsum("ijw,wj->wi", left, b))


def _turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors v, (n, 3) or (W, n, 3), turned by quaternions q (W, 4): (W, n, 3)."""
    w, x, y, z = q.T
    # R', row by row; torch's batched conversion takes four times as long for one world.
    R = np.empty((len(q), 3, 3))
    R[:, 0, 0], R[:, 1, 1], R[:, 2, 2] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y)
    R[:, 0, 1], R[:, 1, 0] = 2 * (x * y + w * z), 2 * (x * y - w * z)
    R[:, 0, 2], R[:, 2, 0] = 2 * (x * z - w * y), 2 * (x * z + w * y)
    R[:, 1, 2], R[:, 2, 1] = 2 * (y * z + w * x), 2 * (y * z - w * x)
    return np.asarray(v @ R)


def _turned_back(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors v (W, 3), each turned by the inverse of its quaternion of q (W, 4)."""
    return _turned(q * [1.0, -1.0, -1.0, -1.0], v[:, None])[:, 0]
