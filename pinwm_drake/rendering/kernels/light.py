# SPDX-License-Identifier: MIT
"""Light on images (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point


@entry_point
def relight(image, factors, shade):
    """Change what images (B, height, width, 3 k) uint8 show, in place: brightness by place, then darkness by channel.

    `factors` is (B, 3); `shade` (B, k, s, s) has the brightness from corner to corner, and is linear between.
    """
    height, width, last = image.shape[1], image.shape[2], shade.shape[2] - 1
    for b in range(image.shape[0]):
        for row in range(height):
            y = row * last / max(height - 1, 1)
            top = min(int(y), last - 1)
            y -= top
            for column in range(width):
                x = column * last / max(width - 1, 1)
                left = min(int(x), last - 1)
                x -= left
                for k in range(shade.shape[1]):
                    pixel = image[b, row, column, 3 * k : 3 * k + 3]
                    if pixel[0] & pixel[1] & pixel[2] == 255:
                        continue
                    four = shade[b, k, top : top + 2, left : left + 2]
                    upper = four[0, 0] + x * (four[0, 1] - four[0, 0])
                    lower = four[1, 0] + x * (four[1, 1] - four[1, 0])
                    light = upper + y * (lower - upper)
                    for c in range(3):
                        value = 255.0 - factors[b, c] * (255.0 - light * pixel[c])
                        pixel[c] = np.uint8(min(max(value, 0.0), 255.0) + 0.5)
