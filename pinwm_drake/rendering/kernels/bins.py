# SPDX-License-Identifier: MIT
"""Lists of the surfels that touch each tile, front to back (numba).

Indices are unsigned where they come out of arrays: signed ones would first be tried for counting from the end.
"""

import numpy as np

from pinwm_drake.jit import kernel
from pinwm_drake.rendering.kernels.columns import TILE

_DIGIT = 11  # bits of a radix digit
RADIX = 1 << _DIGIT


@kernel
def sort_by_depth(number, keys, order, spare, counts):
    """Stable radix sort of order[:number] by keys[order[i]].

    Args:
        number: number of entries to sort.
        keys: (N,) int32, bits of positive floats, which sort like the floats.
        order: (>=number,) int32, overwritten.
        spare: (>=number,) int32, work.
        counts: (2048,) int32, work.
    """
    least, most = keys[np.uint64(order[0])], keys[np.uint64(order[0])]
    for i in range(1, number):
        least, most = min(least, keys[np.uint64(order[i])]), max(most, keys[np.uint64(order[i])])
    shift = 0
    # The depths of one object differ in few digits.
    while (most - least) >> shift > 0:
        for i in range(RADIX):
            counts[i] = 0
        for i in range(number):
            counts[np.uint64(((keys[np.uint64(order[i])] - least) >> shift) & (RADIX - 1))] += 1
        place = 0
        for i in range(RADIX):
            length = counts[i]
            counts[i] = place
            place += length
        for i in range(number):
            spare[i] = order[i]
        for i in range(number):
            slot = np.uint64(((keys[np.uint64(spare[i])] - least) >> shift) & (RADIX - 1))
            place = counts[slot]
            order[np.uint64(place)] = spare[i]
            counts[slot] = place + 1
        shift += _DIGIT


@kernel
def bin_surfels(v, size, boxes, keys, starts, entries, order, spare, counts):
    """List the surfels of every tile of view v, nearest first.

    Args:
        v: the view.
        size: height and width, px.
        boxes: (V, N, 5), rows of pixels and columns of tiles.
        keys: (V, N) int32, bits of the depths.
        starts: (V, tiles + 1) int64, receives where each tile's list begins in `entries`; starts[v, 0] is given.
        entries: (all,) int32, receives the lists.
        order, spare: (N,) int32; counts: (2048,) int32; work.
    """
    columns = (size[1] + TILE - 1) // TILE
    tiles = starts.shape[1] - 1
    number = 0
    first = starts[v, 0]
    for tile in range(1, tiles + 1):
        starts[v, tile] = 0
    for s in range(boxes.shape[1]):
        if boxes[v, s, 1] > boxes[v, s, 0]:
            order[number] = s
            number += 1
            for row in range(boxes[v, s, 0] // TILE, (boxes[v, s, 1] + TILE - 1) // TILE):
                for column in range(boxes[v, s, 2], boxes[v, s, 3]):
                    starts[v, np.uint64(row * columns + column + 1)] += 1
    # Each list's place, shifted by one tile: filling it moves it to where it belongs.
    place = first
    for tile in range(tiles):
        length = starts[v, tile + 1]
        starts[v, tile + 1] = place
        place += length
    if number > 0:
        sort_by_depth(number, keys[v], order, spare, counts)
    for i in range(number):
        nearest = np.uint64(order[i])
        for row in range(boxes[v, nearest, 0] // TILE, (boxes[v, nearest, 1] + TILE - 1) // TILE):
            for column in range(boxes[v, nearest, 2], boxes[v, nearest, 3]):
                slot = np.uint64(row * columns + column + 1)
                place = starts[v, slot]
                entries[np.uint64(place)] = order[i]
                starts[v, slot] = place + 1
