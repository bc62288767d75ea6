# SPDX-License-Identifier: MIT
"""The numba kernels as one node of torch's graph."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.kernels import backward, forward
from pinwm_drake.rendering.kernels.columns import COLUMNS, TILE
from pinwm_drake.rendering.kernels.project import BLOCK, SAME
from pinwm_drake.rendering.surfels import Surfels, require_shapes
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.threads import share

_NOTHING = np.empty((0, 0, 0), np.float32)

# Intrinsics (V, 4), rho (V,) of the discs one pixel from their centres, image size (height, width), background (3,).
_Fixed = tuple[np.ndarray, np.ndarray, tuple[int, int], np.ndarray]

# Pixels and surfels of all views that are worth another thread: below, waking it takes longer.
_WORTH_A_THREAD = 16384


def rasterise(
    surfels: Surfels, camera: Camera, X_CO: Pose, full: bool, background: Tensor, steepness: Tensor, num_threads: int
) -> tuple[Tensor, ...]:
    """Render V views; see `render.render`. Returns color, alpha and, if `full`, depth, normal and distortion."""
    inputs = (*surfels.tensors().values(), X_CO.q, X_CO.p)
    work = X_CO.p.shape[0] * (camera.width * camera.height + surfels.num_surfels)
    num_threads = min(num_threads, work // _WORTH_A_THREAD + 1)
    intrinsics = _array(camera.intrinsics)
    if intrinsics.ndim == 1:
        intrinsics = intrinsics[None].repeat(len(X_CO.p), 0)
    fixed = (intrinsics, _array(steepness), (camera.height, camera.width), _array(background))
    if torch.is_grad_enabled() and any([tensor.requires_grad for tensor in inputs]):  # noqa: C419 (half the time)
        # torch leaves `apply` untyped.
        images = _Rasterise.apply(full, fixed, num_threads, *inputs)  # type: ignore[no-untyped-call]
    else:
        alone = X_CO.p.shape[0] >= num_threads
        arrays = _render(full, fixed, num_threads, inputs) if alone else _forward(full, fixed, num_threads, inputs)[0]
        images = tuple([torch.from_numpy(array) for array in (arrays if full else arrays[:2])])
    if not full:
        return images[:2]
    color, alpha, m1, m2, normal = images
    origin = X_CO.p.detach()[:, 2, None, None].to(alpha.dtype)
    return color, alpha, m1 + origin * alpha, normal, alpha * m2 - m1 * m1


def _array(tensor: Tensor) -> np.ndarray:
    if not tensor.is_cpu:
        raise RenderingError(f"a tensor is on {tensor.device}; allowed: cpu (use backend='torch' elsewhere)")
    return np.ascontiguousarray((tensor.detach() if tensor.requires_grad else tensor).numpy(), np.float32)


def _inputs(inputs: tuple[Tensor, ...], fixed: _Fixed) -> tuple[tuple, np.ndarray, np.ndarray, tuple]:
    """Surfels, their harmonics, q_CO and the views, as the kernels take them."""
    p, q, log_scale, logit_opacity, sh, _, t = (_array(tensor) for tensor in inputs)
    require_shapes(p, q, log_scale, logit_opacity, sh)
    q_CO = np.ascontiguousarray(inputs[5].detach().numpy(), np.float64)
    if not (np.isfinite(q_CO).all() and np.isfinite(t).all()):
        view = int(np.flatnonzero(~(np.isfinite(q_CO).all(-1) & np.isfinite(t).all(-1)))[0])
        raise RenderingError(f"X_CO of view {view} is {q_CO[view]}, {t[view]}; allowed: finite numbers")
    R = np.empty((len(t), 3, 3), np.float32)
    forward.fill_rotations(q_CO, R)
    return (p, q, log_scale, logit_opacity), sh if sh.ndim == 4 else sh[None], q_CO, (R, t, *fixed[:2])


def _prepared(surfels: tuple) -> np.ndarray:
    """Numbers of the surfels that are the same in all views; see `prepare_surfels`."""
    same = np.empty((-(-len(surfels[0]) // BLOCK), SAME, BLOCK), np.float32)
    forward.prepare(surfels, same)
    return same


def _images(V: int, size: tuple[int, int], full: bool) -> tuple[np.ndarray, ...]:
    """Color, alpha, two moments of depth, normal; the last three empty unless `full`."""
    color, alpha = np.empty((V, *size, 3), np.float32), np.empty((V, *size), np.float32)
    if not full:
        return color, alpha, _NOTHING, _NOTHING, _NOTHING[..., None]
    m1, m2, normal = np.empty_like(alpha), np.empty_like(alpha), np.empty_like(color)
    return color, alpha, m1, m2, normal


def _render(full: bool, fixed: _Fixed, num_threads: int, inputs: tuple[Tensor, ...]) -> tuple[np.ndarray, ...]:
    """Return the images of at least as many views as threads, without anything kept for a backward pass."""
    intrinsics, _, size, background = fixed
    surfels, sh, _, view = _inputs(inputs, fixed)
    images = _images(len(intrinsics), size, full)
    arguments = (_prepared(surfels), sh, view, size, background, full, images)
    share(forward.render_views, arguments, len(intrinsics), num_threads)
    return images


def _forward(
    full: bool, fixed: _Fixed, num_threads: int, inputs: tuple[Tensor, ...]
) -> tuple[tuple[np.ndarray, ...], tuple]:
    """Return the images, and what the backward pass needs; threads share the rows of each view."""
    intrinsics, steepness, size, background = fixed
    surfels, sh, q_CO, view = _inputs(inputs, fixed)
    V, N = len(intrinsics), len(surfels[0])
    splats = np.empty((V, N, COLUMNS), np.float32)
    depths = np.empty((V, N), np.float32)
    boxes = np.empty((V, N, 5), np.int32)
    totals = np.empty(V, np.int64)
    share(forward.project_views, (_prepared(surfels), sh, view, size, splats, depths, boxes, totals), V, num_threads)
    rows, columns = -(-size[0] // TILE), -(-size[1] // TILE)
    starts = np.empty((V, rows * columns + 1), np.int64)
    starts[:, 0] = np.cumsum(totals) - totals
    entries = np.empty(int(totals.sum()), np.int32)
    share(forward.bin_views, (size, boxes, depths.view(np.int32), starts, entries), V, num_threads)
    images = _images(V, size, full)
    # Depths are counted from the object's origin.
    scene = (splats, boxes, starts, entries, background, full)
    arguments = (scene, steepness, view[1][:, 2].copy(), images)
    share(forward.blend_rows, arguments, V * rows, num_threads)
    return images, (surfels, sh, q_CO, view, arguments)


def _bands(starts: np.ndarray, rows: int, num_threads: int) -> tuple[np.ndarray, int]:
    """Bands (bands, 3) of tile rows with about equal work, as `backward.pull_rows` takes them, and their parts."""
    V = len(starts)
    parts = max(-(-num_threads // V), 1)
    columns = (starts.shape[1] - 1) // rows
    before = starts[:, ::columns] - starts[:, :1]
    bands = []
    for v in range(V):
        shares = np.arange(1, parts) * (before[v, -1] / parts)
        bounds = [0, *np.searchsorted(before[v], shares), rows]
        bands += [(part, v * rows + bounds[part], v * rows + bounds[part + 1]) for part in range(parts)]
    return np.array(bands, np.int64), parts


class _Rasterise(torch.autograd.Function):
    """Rasterisation as one node of autograd's graph, once differentiable; what is changed in place is an error."""

    @staticmethod
    def forward(ctx: Any, full: bool, fixed: tuple, num_threads: int, *inputs: Tensor) -> tuple[Tensor, ...]:
        images, ctx.saved = _forward(full, fixed, num_threads, inputs)
        ctx.full, ctx.threads = full, num_threads
        ctx.likes = [(tensor.shape, tensor.dtype) for tensor in inputs]
        ctx.set_materialize_grads(False)
        outputs = tuple(torch.from_numpy(image) for image in images)
        ctx.save_for_backward(*inputs, *outputs)  # their memory is that of the arrays in ctx.saved
        return outputs

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors  # raises where one was changed in place
        surfels, sh, q_CO, view, arguments = ctx.saved
        (splats, boxes, starts, *_), _, _, images = arguments
        image_bars = tuple(
            np.zeros(image.shape, np.float32) if gradient is None else _array(gradient)
            for gradient, image in zip(gradients, images, strict=True)
        )
        V, N = boxes.shape[:2]
        rows = -(-images[1].shape[1] // TILE)
        bands, parts = _bands(starts, rows, ctx.threads)
        bars = np.zeros((parts, *splats.shape), np.float32)
        share(backward.pull_rows, (*arguments, image_bars, bars, bands), len(bands), ctx.threads)
        surfel_bars = tuple(np.zeros_like(array) for array in surfels)
        sh_bar = np.zeros_like(sh)
        threads = min(ctx.threads, max(N, 1))
        R_bar, p_bar = np.zeros((threads, V, 3, 3)), np.zeros((threads, V, 3))
        ends = np.linspace(0, N, threads + 1).astype(np.int64)
        pulled = (surfels, sh, view, splats, boxes, bars, surfel_bars, sh_bar, R_bar, p_bar, ends)
        share(backward.pull_surfels, pulled, threads, ctx.threads)
        q_bar = np.empty((V, 4))
        backward.pull_rotations(q_CO, R_bar.sum(0), q_bar)
        results = (*surfel_bars, sh_bar, q_bar, p_bar.sum(0))
        tensors = (
            torch.from_numpy(array).reshape(shape).to(dtype)
            for array, (shape, dtype) in zip(results, ctx.likes, strict=True)
        )
        return (None, None, None, *tensors)
