# SPDX-License-Identifier: MIT
"""Stacks of the last images that each world has seen (numba)."""

from pinwm_drake.jit import entry_point


@entry_point
def roll_in(stack, images, first, last):
    """Drop the oldest image of worlds first..last-1 from their stacks and append the newest, without its alpha.

    Args:
        stack: (W, H, W, 3 k) uint8, the oldest image first; changed in place.
        images: (W, H, W, 4) uint8.
        first, last: range of the worlds.
    """
    _, height, width, channels = stack.shape
    for w in range(first, last):
        for row in range(height):
            for column in range(width):
                for k in range(channels - 3):
                    stack[w, row, column, k] = stack[w, row, column, k + 3]
                for k in range(3):
                    stack[w, row, column, channels - 3 + k] = images[w, row, column, k]
