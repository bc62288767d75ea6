# SPDX-License-Identifier: MIT
"""Rendering loss: the difference of a rendering of the object and the camera's picture.

Source: PIN-WM (Li et al., 2025), eq. 8, which compares whole images. Deviations: opacity is compared beside colour,
pixels that the pusher may hide do not count, the object's outline may be scaled (see `unknowns.py`), and differences
are also compared after averaging over blocks of pixels, so that a rendering that is far off still has a gradient.
"""

from dataclasses import replace

import torch
from torch import Tensor

from pinwm_drake.identification.pictures import Pictures
from pinwm_drake.rendering.camera import Camera, zoomed
from pinwm_drake.rendering.render import Rendering, render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose, compose

# px; sides of the blocks over which differences are averaged in the coarse loss.
BLOCKS = (1, 4, 8, 16)


def rendered(
    pictures: Pictures, surfels: Surfels, X_WO: Pose, outline: Tensor, *, num_threads: int | None = None
) -> Rendering:
    """Return renderings of the object as the pictures' cameras see it.

    Args:
        pictures: n frames.
        surfels: The object's appearance, frame O.
        X_WO: Poses of the object: q (n, W, 4), p (n, W, 3), m; the renderings are differentiable in them.
        outline: (W,), by which outlines are scaled.
        num_threads: Threads of the renderer.

    Returns:
        color (n, W, H, W, 3) and alpha (n, W, H, W), float32.
    """
    n, W = X_WO.p.shape[:2]
    X_CW = pictures.X_CW
    X_CO = compose(Pose(X_CW.q[:, None].expand(n, W, 4), X_CW.p[:, None].expand(n, W, 3)), X_WO)
    intrinsics = zoomed(pictures.camera.intrinsics[:, None], outline[None].detach(), pictures.middle[:, None])
    width, height = pictures.camera.width, pictures.camera.height
    shown = render(
        surfels,
        Camera(width, height, intrinsics.reshape(n * W, 4)),
        Pose(X_CO.q.reshape(n * W, 4), X_CO.p.reshape(n * W, 3)),
        full=False,
        num_threads=num_threads,
    )
    color, alpha = shown.color.reshape(n, W, height, width, 3), shown.alpha.reshape(n, W, height, width)
    return replace(shown, color=color, alpha=alpha)


def difference(
    pictures: Pictures, surfels: Surfels, X_WO: Pose, outline: Tensor, *, num_threads: int | None = None
) -> Tensor:
    """Difference of rendering and picture on the pixels where they can be compared; arguments as for `rendered`.

    Returns:
        (n, W, H, W, 4) float32: differences of red, green, blue and opacity, 0 where the pusher may hide the object.
    """
    shown = rendered(pictures, surfels, X_WO, outline, num_threads=num_threads)
    color = shown.color - pictures.color[:, None]
    alpha = (shown.alpha - pictures.alpha[:, None])[..., None]
    return torch.cat([color, alpha], -1) * pictures.weight[:, None, ..., None]


def squares(difference: Tensor, blocks: tuple[int, ...] = (1,)) -> Tensor:
    """Mean squares of each frame, summed over block sizes.

    Args:
        difference: (n, W, H, W, 4).
        blocks: px; a difference is averaged over blocks of these sides before it is squared.

    Returns:
        (n, W) float64.
    """
    n, W, height, width, channels = difference.shape
    flat = difference.reshape(n * W, height, width, channels)
    total = flat.new_zeros(n * W)
    planes = flat.permute(0, 3, 1, 2) if max(blocks) > 1 else flat
    for block in blocks:
        part = flat if block == 1 else torch.nn.functional.avg_pool2d(planes, block, block // 2, ceil_mode=True)
        total = total + (part * part).mean(dim=(1, 2, 3))
    return total.reshape(n, W).double()
