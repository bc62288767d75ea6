# SPDX-License-Identifier: MIT
"""The losses that fit surfels to images.

Source: PIN-WM (Li et al., 2025), eq. 7: L = (1 - lambda) L_1 + lambda L_D-SSIM + w_d L_d + w_n L_n, where L_d is the
depth distortion and L_n the normal consistency of Huang et al. (2024), eq. 13 and 14. Means over the image's pixels.
"""

from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.kernels import ssim as ssim_kernels
from pinwm_drake.rendering.render import Rendering
from pinwm_drake.threads import share

WINDOW, SIGMA = 11, 1.5  # px
C1, C2 = np.float32(0.01**2), np.float32(0.03**2)

# A pixel's depth counts as a surface's from this opacity on: below it, what is blended is mostly background.
_SOLID = 0.5


def window() -> np.ndarray:
    """Gaussian window (11,) float32 of SSIM along one side, of sum 1."""
    offsets = np.arange(WINDOW) - WINDOW // 2
    weights = np.exp(-0.5 * (offsets / SIGMA) ** 2)
    return (weights / weights.sum()).astype(np.float32)


class SsimTarget:
    """An image to compare others with; what SSIM needs of it is computed once."""

    def __init__(self, image: Tensor, num_threads: int = 1) -> None:
        """Keep `image` (H, W, 3), colours from 0 to 1, and the number of threads that compare others with it.

        Raises:
            RenderingError: Another shape.
        """
        if image.ndim != 3 or image.shape[-1] != 3 or image.numel() == 0:
            raise RenderingError(f"an image is {tuple(image.shape)}; allowed: (H, W, 3)")
        self.image, self.num_threads = image.detach(), num_threads
        self.array = _rows(image)
        self.mean, self.square = np.empty_like(self.array), np.empty_like(self.array)
        ssim_kernels.blur(self.array, window(), 3, self.mean)
        ssim_kernels.blur(self.array * self.array, window(), 3, self.square)

    def ssim(self, image: Tensor) -> Tensor:
        """Return the mean structural similarity with `image` (H, W, 3), differentiable in it; 1 where they are equal.

        Raises:
            RenderingError: Images of two shapes.
        """
        if image.shape != self.image.shape:
            raise RenderingError(f"images are {tuple(image.shape)} and {tuple(self.image.shape)}; allowed: one shape")
        # torch leaves `apply` untyped.
        return _Ssim.apply(image, self)  # type: ignore[no-untyped-call]


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Mean structural similarity of two images, differentiable in the first.

    Args:
        a: (H, W, 3) float32, colours from 0 to 1.
        b: the same shape.

    Returns:
        A scalar, 1 for equal images: Gaussian window of 11 px and sigma 1.5 px, black beyond the borders.

    Raises:
        RenderingError: Shapes that do not fit.

    Source:
        Wang et al., "Image quality assessment: from error visibility to structural similarity", 2004, eq. 13.
    """
    return SsimTarget(b).ssim(a)


def photometric(
    color: Tensor, target: Tensor | SsimTarget, *, kind: Literal["l1", "l2"] = "l1", dssim: float = 0.2
) -> Tensor:
    """Photometric loss of a rendered image against a target: (1 - dssim) L_1 + dssim (1 - SSIM) / 2.

    Args:
        color: (H, W, 3), rendered.
        target: (H, W, 3), or an `SsimTarget` of it, which saves time when it is compared often.
        kind: "l1" takes the mean absolute difference of the colours; "l2" the mean of its square.
        dssim: lambda, 0 to 1.

    Returns:
        A scalar.

    Raises:
        RenderingError: Shapes that do not fit, an unknown kind, or dssim outside 0 to 1.
    """
    if kind not in ("l1", "l2"):
        raise RenderingError(f"kind is {kind!r}; allowed: 'l1' or 'l2'")
    if not 0.0 <= dssim <= 1.0:
        raise RenderingError(f"dssim is {dssim}; allowed: 0 to 1")
    image = target.image if isinstance(target, SsimTarget) else target
    if color.shape != image.shape:
        raise RenderingError(f"images are {tuple(color.shape)} and {tuple(image.shape)}; allowed: one shape")
    difference = color - image
    loss = (1.0 - dssim) * (difference.abs().mean() if kind == "l1" else difference.square().mean())
    if dssim > 0.0:
        known = target if isinstance(target, SsimTarget) else SsimTarget(target)
        loss = loss + dssim * 0.5 * (1.0 - known.ssim(color))
    return loss


def distortion_loss(rendering: Rendering, length: float = 1.0) -> Tensor:
    """Return the mean spread of the depths that a pixel blends, over all pixels.

    Args:
        rendering: made with full=True.
        length: m, the unit of depth, such as the object's radius.

    Returns:
        The mean of sum_{i<j} w_i w_j (z_i - z_j)^2 / length^2; no unit.

    Raises:
        RenderingError: A rendering without distortion.
    """
    if rendering.distortion is None:
        raise RenderingError("a rendering without distortion; allowed: one made with full=True")
    return rendering.distortion.mean() / length**2


def normal_consistency(rendering: Rendering, camera: Camera) -> Tensor:
    """Return the normal consistency of the surfels with the rendered depth: the mean of sum_i w_i (1 - n_i . N).

    N, (V, H, W), is the normal of the surface through the points of a pixel's four neighbours, at depth / alpha. Pixels
    with a neighbour of opacity below 1/2 have none, and count as 0.

    Args:
        rendering: made with full=True.
        camera: camera of the rendering.

    Returns:
        A scalar, 0 to 2; differentiable in normal, depth and alpha.

    Raises:
        RenderingError: A rendering without normals and depth, or of another size than the camera's.
    """
    if rendering.normal is None or rendering.depth is None:
        raise RenderingError("a rendering without normals and depth; allowed: one made with full=True")
    V, H, W = rendering.alpha.shape
    if (camera.height, camera.width) != (H, W):
        raise RenderingError(f"a rendering of {W} x {H} px for a camera of {camera.width} x {camera.height} px")
    if H < 3 or W < 3:
        return rendering.normal.sum() * 0.0
    points = _points(rendering.depth / rendering.alpha.clamp_min(_SOLID), camera)
    right = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    down = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    # x right, y down: down x right points to the camera.
    normal = torch.nn.functional.normalize(torch.linalg.cross(down, right), dim=-1, eps=1e-20)
    solid = rendering.alpha.detach() > _SOLID
    sound = solid[:, 1:-1, 2:] & solid[:, 1:-1, :-2] & solid[:, 2:, 1:-1] & solid[:, :-2, 1:-1]
    agreement = (rendering.normal[:, 1:-1, 1:-1] * normal).sum(-1)
    error = torch.where(sound, rendering.alpha[:, 1:-1, 1:-1] - agreement, 0.0)
    return error.sum() / (V * H * W)


def _points(depth: Tensor, camera: Camera) -> Tensor:
    """Points (V, H, W, 3) in C at the depths (V, H, W) of the pixels' centres, m."""
    fx, fy, cx, cy = camera.intrinsics.to(depth).reshape(-1, 4, 1).unbind(1)
    x = (torch.arange(camera.width, dtype=depth.dtype, device=depth.device) + 0.5 - cx) / fx
    y = (torch.arange(camera.height, dtype=depth.dtype, device=depth.device) + 0.5 - cy) / fy
    return torch.stack([x[:, None, :] * depth, y[:, :, None] * depth, depth], -1)


def _rows(image: Tensor) -> np.ndarray:
    return np.ascontiguousarray(image.detach().cpu().numpy(), np.float32).reshape(image.shape[0], -1)


class _Ssim(torch.autograd.Function):
    """The mean SSIM as one node of the graph; its derivative is formed while the images are compared."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: SsimTarget) -> Tensor:
        a, b = _rows(image), target.array
        grads, sums = np.empty((3, *a.shape), np.float32), np.empty(len(a))
        given = (a, b, window(), 3, target.mean, target.square, C1, C2, grads, sums)
        share(ssim_kernels.compare, given, len(a), target.num_threads)
        ctx.saved = (a, b, grads, target.num_threads)
        ctx.save_for_backward(image)
        return image.new_tensor(float(sums.sum()) / a.size)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (image,) = ctx.saved_tensors
        a, b, grads, num_threads = ctx.saved
        a_bar = np.empty_like(a)
        scale = np.float32(gradient.item() / a.size)
        share(ssim_kernels.compare_adjoint, (a, b, window(), 3, grads, scale, a_bar), len(a), num_threads)
        return torch.from_numpy(a_bar).reshape(image.shape).to(image), None
