# SPDX-License-Identifier: MIT
"""Pose of an object in one small picture without a mask, such as a network imagines.

The object was at rest in a known pose, and has moved for a moment. Its new pose is the likeliest one: renderings are
compared with the picture as they are and after averaging over blocks of pixels, as blurred pictures have no outline,
and the way since then is thought to be about half as long as that of the pusher. The search begins in the pose before,
since what is nearly symmetric also fits upside down, and in the best of some guesses. The object's lowest point keeps
its height, since one camera hardly tells how far away a small object is.

Source: Nocedal and Wright, Numerical Optimization, section 10.3 (Gauss-Newton), by scipy's `least_squares`.
"""

import numpy as np
import torch
import trimesh
from scipy.optimize import least_squares
from torch import Tensor
from torch.nn.functional import avg_pool2d

from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.identification.expansion import corrected
from pinwm_drake.identification.image_loss import BLOCKS
from pinwm_drake.identification.pictures import hidden
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose, compose, identity, inverse
from pinwm_drake.spatial.rotations import quaternion_to_matrix

# Rendered pixels along each side of a picture's: the renderer makes no surfel narrower than one of them.
_FINER = 4
_NOISE = 0.05  # of a colour, 0 to 1
# Standard deviation of the object's way along each axis, as a share of the pusher's.
_SHARE = 0.5
# Guesses beside the pose before, how many of them are refined too, and how many are rendered at once.
_GUESSES, _BEST, _TOGETHER = 48, 2, 16
_STEP = 0.25  # px, of the differences that are derivatives
# Columns of `corrected` that are free: of what slides on a floor yaw, x and y; else the turn, x and y.
_LEVEL, _TURNED = [2, 3, 4], [0, 1, 2, 3, 4]
_TOLERANCE, _EVALUATIONS = 1e-3, 25


class PictureReader:
    """Reader of poses of one object of known appearance from pictures of one camera."""

    def __init__(
        self,
        surfels: Surfels,
        camera: Camera,
        X_WC: Pose,
        mesh: trimesh.Trimesh,
        pusher: trimesh.Trimesh,
        *,
        level: bool,
        reach: float,
        num_threads: int | None = None,
    ) -> None:
        """Take over what does not move.

        Args:
            surfels: The object's appearance, frame O.
            camera: Camera with intrinsics (4,).
            X_WC: Its pose, OpenCV axes; q (4,), p (3,) [m].
            mesh: Surface of the object, m, frame O.
            pusher: Surface of the pusher, m, frame P, whose axes are the world's.
            level: Flag: the object slides on the floor and does not tilt.
            reach: m, way of the pusher.
            num_threads: Threads of the renderer; None for one on each core.
        """
        self._surfels, self._camera, self._fine = surfels, camera, camera.scaled(_FINER)
        self._X_CW, self._pusher, self._threads = inverse(X_WC), pusher, num_threads
        self._vertices = torch.from_numpy(np.array(mesh.vertices, float))
        self._free = _LEVEL if level else _TURNED
        radius = half_diagonal(mesh)
        width = _SHARE * reach
        self._width = torch.tensor([width / radius] * 3 + [width] * 3, dtype=torch.float64)[self._free]
        self._pixels = float(camera.intrinsics[0]) * width  # that it takes, by the distance [m]

    @torch.no_grad()
    def read(self, image: np.ndarray, X_WO: Pose, p_WP: np.ndarray, generator: np.random.Generator) -> Pose:
        """Pose of the object in a picture.

        Args:
            image: (height, width, 3), RGB, 0 to 1, white where the object is not.
            X_WO: Pose before the motion; q (4,), p (3,) [m].
            p_WP: (3,) m, world: where the pusher is, which may hide a part.
            generator: Generator of the guesses.

        Returns:
            X_WO in the picture; q (4,), p (3,) [m].
        """
        seen = torch.from_numpy(np.asarray(image, np.float32)).permute(2, 0, 1)
        open_ = torch.from_numpy(~self._hidden(p_WP)).float()
        n = len(self._free)
        step = _STEP * float(compose(self._X_CW, X_WO).p.norm()) / self._pixels
        aside = step * np.eye(n)

        def residuals(x: np.ndarray) -> np.ndarray:
            """Residuals (W, m), each of variance 1, of ways (W, n) in standard deviations."""
            difference = (self._pictures(self._moved(X_WO, x)) - seen) * open_
            parts = [avg_pool2d(difference, block, max(block // 2, 1), ceil_mode=True).flatten(1) for block in BLOCKS]
            return np.hstack([torch.cat(parts, 1).double().numpy() / _NOISE, x])

        def slopes(x: np.ndarray) -> np.ndarray:
            """Return derivatives (m, n), as central differences, which average over the kinks of pixels."""
            sides = residuals(np.concatenate([x + aside, x - aside]))
            found: np.ndarray = (sides[:n] - sides[n:]).T / (2.0 * step)
            return found

        guesses = generator.standard_normal((_GUESSES, n))
        some = [guesses[k : k + _TOGETHER] for k in range(0, len(guesses), _TOGETHER)]
        costs = np.concatenate([np.square(residuals(part)).sum(1) for part in some])
        fits = [
            least_squares(
                lambda x: residuals(x[None])[0], start, slopes, ftol=_TOLERANCE, xtol=_TOLERANCE, max_nfev=_EVALUATIONS
            )
            for start in (np.zeros(n), *guesses[np.argsort(costs)[:_BEST]])
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        found = self._moved(X_WO, best.x[None])
        return Pose(found.q[0], found.p[0])

    def _moved(self, X_WO: Pose, x: np.ndarray) -> Pose:
        """Poses (W,) after ways (W, n) in standard deviations."""
        d = torch.zeros(len(x), 6, dtype=torch.float64)
        d[:, self._free] = torch.from_numpy(x) * self._width
        found = corrected(X_WO, d)
        found.p[:, 2] += self._depth(found.q) - self._depth(X_WO.q)
        return found

    def _depth(self, q_WO: Tensor) -> Tensor:
        """Height (...) [m] of the origin above the lowest point at orientations (..., 4)."""
        return -(self._vertices @ quaternion_to_matrix(q_WO)[..., 2, :, None])[..., 0].amin(-1)

    def _pictures(self, X_WO: Pose) -> Tensor:
        """Pictures (W, 3, height, width) float32 at poses (W,)."""
        X_CO = compose(self._X_CW, X_WO)
        shown = render(self._surfels, self._fine, X_CO, full=False, num_threads=self._threads)
        return avg_pool2d(shown.color.permute(0, 3, 1, 2), _FINER)

    def _hidden(self, p_WP: np.ndarray) -> np.ndarray:
        """Mask (height, width) of the pixels that the pusher may hide a part of."""
        X_WP = Pose(identity().q, torch.from_numpy(np.asarray(p_WP, float)))
        return hidden(self._pusher, self._camera, compose(self._X_CW, X_WP))
