# SPDX-License-Identifier: MIT
"""The image I = R(x, alpha) of surfels, differentiable in all of them and in the object's pose."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.rasterise import rasterise
from pinwm_drake.rendering.reference import NEAR, render_reference
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.threads import available

_WHITE = torch.ones(3)
PIXEL_DISC = math.sqrt(0.5)  # px, standard deviation of the low-pass disc of Huang et al. (2024)


@dataclass(frozen=True, eq=False)
class Rendering:
    """Images of V views, each H x W; w_i are the blending weights of the surfels on a pixel's ray.

    Attributes:
        color: (V, H, W, 3), sum w_i color_i + (1 - alpha) background; 1 is white.
        alpha: (V, H, W), sum w_i, 0 to 1.
        depth: (V, H, W), sum w_i z_i, m along the camera's axis; not divided by alpha. None unless `full`.
        normal: (V, H, W, 3), sum w_i n_i, camera frame, turned towards the camera. None unless `full`.
        distortion: (V, H, W), sum_{i<j} w_i w_j (z_i - z_j)^2, m^2. None unless `full`.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor | None = None
    normal: Tensor | None = None
    distortion: Tensor | None = None


def render(
    surfels: Surfels,
    camera: Camera,
    X_CO: Pose,
    *,
    full: bool = True,
    background: Tensor | None = None,
    disc: float | Tensor = PIXEL_DISC,
    backend: Literal["numba", "torch"] = "numba",
    num_threads: int | None = None,
) -> Rendering:
    """Render V views of the surfels; differentiable in every surfel parameter and in X_CO.

    Args:
        surfels: N of them; their sh may be (V, N, K, 3), colours of its own for each view.
        camera: one, or V of them.
        X_CO: pose of the object in the camera frame (OpenCV axes): q (V, 4), p (V, 3), m, or without V for one view.
        full: whether to render depth, normal and distortion too.
        background: (3,), colour behind the surfels; None for white.
        disc: px, standard deviation of the disc around a projected centre, by which a surfel counts where that makes
            it opaquer; a number, or (V,), above 0, without gradient. `narrow_disc` gives it for small images.
        backend: "numba" runs compiled kernels on the CPU; "torch" the dense reference, on the surfels' device.
        num_threads: threads of the numba backend; None for one on each core.

    Returns:
        V views.

    Raises:
        RenderingError: shapes that do not fit, a disc of no size, a tensor that is not on the CPU for "numba", an
            unknown backend, a pose of no finite numbers ("numba"). The surfels' numbers are not looked at here, which
            would take as long as a small image: `Surfels.check` does.
    """
    if backend not in ("numba", "torch"):
        raise RenderingError(f"backend is {backend!r}; allowed: 'numba' or 'torch'")
    q, p = X_CO
    if q.ndim == p.ndim == 1:
        q, p = q[None], p[None]
    V, N = len(p), surfels.num_surfels
    if q.shape != (V, 4) or p.shape != (V, 3) or V == 0:
        raise RenderingError(f"X_CO is {tuple(X_CO.q.shape)}, {tuple(X_CO.p.shape)}; allowed: (V, 4), (V, 3), V >= 1")
    if surfels.sh.ndim == 4 and len(surfels.sh) != V:
        raise RenderingError(f"sh is {tuple(surfels.sh.shape)}; allowed: ({N}, K, 3) or ({V}, {N}, K, 3)")
    if camera.intrinsics.ndim == 2 and len(camera.intrinsics) != V:
        raise RenderingError(f"camera intrinsics are {tuple(camera.intrinsics.shape)}; allowed: (4,) or ({V}, 4)")
    if background is None:
        background = _WHITE
    elif background.shape != (3,):
        raise RenderingError(f"background is {tuple(background.shape)}; allowed: (3,)")
    disc = torch.as_tensor(disc, dtype=torch.float64).detach()
    if disc.shape not in ((), (V,)) or not bool((disc > 0.0).all()):
        raise RenderingError(f"disc is {tuple(disc.shape)}, {disc.tolist()}; allowed: above 0 px, a number or ({V},)")
    steepness = (disc**-2).expand(V)
    if backend == "numba":
        return Rendering(
            *rasterise(surfels, camera, Pose(q, p), full, background, steepness, num_threads or available())
        )
    surfels.check_shapes()
    return Rendering(*render_reference(surfels, camera, Pose(q, p), full, background, steepness))


def narrow_width(surfels: Surfels) -> float:
    """Scale [m] along the narrower tangent that nine in ten surfels have, or a larger one."""
    narrower = surfels.log_scale.detach().amin(-1)
    return float(narrower.kthvalue(-(-len(narrower) // 10)).values.exp())


def narrow_disc(width: float, camera: Camera, depth: Tensor) -> Tensor:
    """Discs (V,) px for `render` that are no wider than surfels are in an image.

    A surfel that is much smaller than a pixel is drawn as wide as one otherwise, and the nearest ones hide what is
    beside them: a small image smears. With this it shows what is seen through the middles of its pixels.

    Args:
        width: m, of the surfels; see `narrow_width`.
        camera: one, or V of them.
        depth: (V,) m, of the object along the camera's axis; not above 0 counts as near.
    """
    focal = camera.intrinsics[..., :2].prod(-1).sqrt()
    away = torch.where(depth > NEAR, depth, NEAR).detach().double()  # NEAR too for what is no number
    return (focal * width / away).clamp(max=PIXEL_DISC)
