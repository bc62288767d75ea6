# SPDX-License-Identifier: MIT
"""Small networks and episodes for the tests of Dreamer V2."""

import numpy as np

from pinwm_drake.paper.baselines.dreamer.options import NetworkOptions
from pinwm_drake.paper.baselines.recording import Episode

SIZES = NetworkOptions(deter=12, hidden=12, latents=4, classes=4, depth=4, units=16, layers=1)


def numbered(length, first=0, size=8, terminated=False):
    """An episode in which values tell the number of a step, counted from `first`."""
    numbers = np.arange(first, first + length + 1)
    images = np.broadcast_to(numbers[:, None, None, None], (length + 1, size, size, 3)).astype(np.uint8)
    actions = np.stack([numbers[:-1], -numbers[:-1]], 1).astype(np.float32) / 100.0
    pusher = np.stack([numbers, numbers], 1).astype(np.float32) / 100.0
    return Episode(images, pusher, actions, numbers[1:].astype(np.float32), np.array(terminated))
