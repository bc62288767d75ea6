# SPDX-License-Identifier: MIT
"""Golden samples of a bundle: inputs, and the policy's answers to them when it was exported."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.learning.contract import ESTIMATE, GOAL, IMAGE, POSITION, TRANSLATION
from pinwm_drake.reading.arrays import parse_npz

TOLERANCE = 1e-5  # m, of each component of a translation
# Of each component of an estimate, relative where it is more than 1: as TOLERANCE, for lengths in units of 0.1 m.
# Single precision rounds to 6e-8; sums of 4096 terms, with random signs, are off by 64 times as much.
ESTIMATE_TOLERANCE = 1e-4
_MOST = 0.5  # share of an image's pixels; more than that is no object, but one of the images of random blocks
_MOST_BYTES = 2**28  # of all arrays
_AS_WRITTEN = "golden samples that `pinwm export` wrote"


@dataclass(frozen=True, eq=False)
class Golden:
    """Golden samples, n of them.

    Attributes:
        images: (n, height, width, 3 k) uint8, RGB: k images each, the oldest first.
        p_WP: (n, pusher_size) float32 m, world: positions of the pusher along the axes of the task, with their history.
        d_W: (n, action_size) float32 m, world: translations that the policy answered, along the same axes.
        estimate: (n, state_size) float32, the policy's estimates of the task's state; None where it gives none.
        goal: (n, goal_size) float32, goals of the episodes; None where they have that of the task.
    """

    images: np.ndarray
    p_WP: np.ndarray
    d_W: np.ndarray
    estimate: np.ndarray | None = None
    goal: np.ndarray | None = None

    def mask_pixels(self) -> tuple[int, int]:
        """Least and largest number of the object's pixels in an image, among the images that a camera has seen.

        Images that are white and those of random blocks do not count; where there are no others, 0 and all pixels.
        """
        numbers, all_pixels = object_pixels(self.images).ravel(), self.images.shape[1] * self.images.shape[2]
        seen = numbers[(numbers > 0) & (numbers <= _MOST * all_pixels)]
        return (int(seen.min()), int(seen.max())) if len(seen) else (0, all_pixels)

    def to_bytes(self) -> bytes:
        """Contents of a compressed npz file; most of an image is white."""
        file = io.BytesIO()
        arrays = {IMAGE: self.images, POSITION: self.p_WP, TRANSLATION: self.d_W, ESTIMATE: self.estimate}
        given = {name: array for name, array in (arrays | {GOAL: self.goal}).items() if array is not None}
        np.savez_compressed(file, allow_pickle=False, **given)
        return file.getvalue()

    @classmethod
    def from_bytes(cls, content: bytes, path: Path, contract: Mapping[str, Any]) -> "Golden":
        """Golden samples from the contents that `to_bytes` made.

        Args:
            content: Contents of the file.
            path: Path that messages name.
            contract: Contract of the bundle, as `make_contract` gives it.

        Raises:
            InputError: It is no such file, or its arrays are not of the shapes and types of the contract.
        """
        arrays = parse_npz(content, path, _AS_WRITTEN, most=_MOST_BYTES)
        entries = (*contract["inputs"], *contract["outputs"])
        kinds = {entry["name"]: (entry["dtype"], tuple(entry["shape"])) for entry in entries}
        if set(arrays) != set(kinds):
            raise InputError(path, value=f"arrays {sorted(arrays)}", allowed=f"arrays {sorted(kinds)}")
        number = len(arrays[IMAGE]) if arrays[IMAGE].ndim else 0
        for name, (dtype, shape) in kinds.items():
            array = arrays[name]
            if array.dtype != dtype or array.shape != (number, *shape) or number < 1:
                given = f"{name} of {array.dtype} {array.shape}"
                wanted = f"{dtype} (n, {', '.join(map(str, shape))}), n of 1 or more, as the contract says"
                raise InputError(path, value=given, allowed=wanted)
        return cls(arrays[IMAGE], arrays[POSITION], arrays[TRANSLATION], arrays.get(ESTIMATE), arrays.get(GOAL))


def object_pixels(images: np.ndarray) -> np.ndarray:
    """Numbers (..., k) of the pixels that are not white in images (..., height, width, 3 k) uint8, RGB."""
    *batch, height, width, channels = images.shape
    shown = (images.reshape(*batch, height, width, channels // 3, 3) < 255).any(-1)
    numbers: np.ndarray = shown.sum(axis=(-3, -2))
    return numbers


def deviation(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference of a component of translations (..., action_size), m; NaN where one of them is NaN."""
    return float(np.abs(np.asarray(found, float) - np.asarray(expected, float)).max())


def estimate_deviation(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference of a component of estimates (..., state_size), relative where it is above 1; NaN as above."""
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    return float((np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)).max())
