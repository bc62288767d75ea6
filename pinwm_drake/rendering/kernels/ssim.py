# SPDX-License-Identifier: MIT
"""The window of SSIM over small images, and its adjoint (numba).

Images are (H, W C) float32, the C channels of a pixel side by side, so that every loop runs over neighbours in memory.
Beyond the border everything is 0, which makes the window its own adjoint.
"""

import numpy as np

from pinwm_drake.jit import entry_point, kernel


@kernel
def _blur_row(source, row, weights, channels, across, target):
    """Write target (W C,), a row of `source` under the window; `across` (W C + 2 radius C,) has zeros at its ends."""
    height, width = source.shape
    radius = weights.shape[0] // 2
    pad = radius * channels
    inner = across[pad : pad + width]
    inner[:] = np.float32(0.0)
    for k in range(max(-radius, -row), min(radius, height - 1 - row) + 1):
        weight = weights[k + radius]
        for i in range(width):
            inner[i] += weight * source[row + k, i]
    target[:] = np.float32(0.0)
    for k in range(2 * radius + 1):
        weight = weights[k]
        shifted = across[k * channels : k * channels + width]
        for i in range(width):
            target[i] += weight * shifted[i]


@entry_point
def blur(source, weights, channels, target):
    """Write target, the source under the separable window `weights` (odd length)."""
    across = np.zeros(source.shape[1] + (weights.shape[0] - 1) * channels, np.float32)
    for row in range(source.shape[0]):
        _blur_row(source, row, weights, channels, across, target[row])


@entry_point
def compare(a, b, weights, channels, mean_b, square_b, c1, c2, grads, sums, first, last):
    """SSIM of the entries of some rows, summed over each, and its derivatives by the blurred a, a^2 and a b.

    Args:
        a, b: (H, W C), the images.
        mean_b, square_b: blurred b and b^2.
        c1, c2: the constants of SSIM.
        grads: (3, H, W C), receives the derivatives by the blurred a, a^2 and a b.
        sums: (H,), receives the sums.
        first, last: the rows, the last not included.
    """
    height, width = a.shape
    radius = weights.shape[0] // 2
    across = np.zeros(width + (weights.shape[0] - 1) * channels, np.float32)
    mean, square, product = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    two = np.float32(2.0)
    low, high = max(first - radius, 0), min(last + radius, height)
    squares = np.empty((2, high - low, width), np.float32)
    for row in range(low, high):
        for i in range(width):
            squares[0, row - low, i] = a[row, i] * a[row, i]
            squares[1, row - low, i] = a[row, i] * b[row, i]
    for row in range(first, last):
        _blur_row(a, row, weights, channels, across, mean)
        _blur_row(squares[0], row - low, weights, channels, across, square)
        _blur_row(squares[1], row - low, weights, channels, across, product)
        part = np.float32(0.0)
        for i in range(width):
            ma, mb = mean[i], mean_b[row, i]
            va, vb = square[i] - ma * ma, square_b[row, i] - mb * mb
            top1, top2 = two * ma * mb + c1, two * (product[i] - ma * mb) + c2
            low1, low2 = ma * ma + mb * mb + c1, va + vb + c2
            scale = np.float32(1.0) / (low1 * low2)
            value = top1 * top2 * scale
            part += value
            # By the variance of a, by the covariance, and by the mean, which both of them hold.
            by_square = -value / low2
            by_product = two * top1 * scale
            grads[1, row, i] = by_square
            grads[2, row, i] = by_product
            grads[0, row, i] = (
                two * mb * top2 * scale - value * two * ma / low1 - two * ma * by_square - mb * by_product
            )
        sums[row] = part


@entry_point
def compare_adjoint(a, b, weights, channels, grads, scale, a_bar, first, last):
    """Write some rows of a_bar, scale times the derivative of the sum of `compare` over all rows by a."""
    width = a.shape[1]
    across = np.zeros(width + (weights.shape[0] - 1) * channels, np.float32)
    by_mean, by_square = np.empty(width, np.float32), np.empty(width, np.float32)
    by_product = np.empty(width, np.float32)
    two = np.float32(2.0)
    for row in range(first, last):
        _blur_row(grads[0], row, weights, channels, across, by_mean)
        _blur_row(grads[1], row, weights, channels, across, by_square)
        _blur_row(grads[2], row, weights, channels, across, by_product)
        for i in range(width):
            a_bar[row, i] = scale * (by_mean[i] + two * a[row, i] * by_square[i] + b[row, i] * by_product[i])
