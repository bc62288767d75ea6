# SPDX-License-Identifier: MIT
"""Segmenters as ONNX files: an image and a prompt in, a mask out."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

# See pinwm_drake/learning/runtime.py: it sends to Microsoft what it runs, unless this is set before it is imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

import onnxruntime

from pinwm_drake.errors import InputError
from pinwm_drake.masks.shots import Shot
from pinwm_drake.reading.contents import guarded, read_bytes
from pinwm_drake.reading.network import SEGMENTER, check_network

_IMAGE, _MASKS, _SCORES = "image", ("mask", "masks"), "iou_predictions"
_POINTS, _LABELS, _BOX = ("points", "point_coords"), ("labels", "point_labels"), "box"
_EMPTY = ("mask_input", "has_mask_input")  # of SAM: no mask is known before
_ON_OBJECT, _CORNERS = 1.0, (2.0, 3.0)  # labels of points, as SAM has them
_ALLOWED = "a network in ONNX, weights included, that onnxruntime loads"


class OnnxSegmenter:
    """Segmenter of one ONNX file, or of several where each takes outputs of those before by their names.

    Inputs are float32 and have fixed shapes. One file takes `image` (1, 3, H, W), RGB from 0 to 1. Optional are
    `points` or `point_coords` (1, n, 2), `labels` or `point_labels` (1, n) and `box` (1, 4), px of that image. n is 1
    for the middle of the object, 2 for the corners of a box, 3 for both. `mask_input` and `has_mask_input` get zeros.
    The output `mask` or `masks` (1, k, h, w) is above 0 on the object; `iou_predictions` (1, k) says which one is best.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        """Load the files.

        Raises:
            InputError: A file is refused, has an input that nothing gives, or none gives a mask or takes an image.
        """
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # errors are raised
        self._sessions = []
        known = {_IMAGE, _BOX, *_POINTS, *_LABELS, *_EMPTY}
        size: list[int] | None = None
        for path in paths:
            content = read_bytes(path)
            check_network(content, path, SEGMENTER)
            with guarded(path, _ALLOWED):
                session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
            for node in session.get_inputs():
                if node.name not in known or node.type != "tensor(float)":
                    raise InputError(
                        path, value=f"an input {node.name}, {node.type}", allowed=f"float32, {sorted(known)}"
                    )
                size = list(node.shape) if node.name == _IMAGE else size
            known |= {node.name for node in session.get_outputs()}
            self._sessions.append(session)
        path = paths[-1]
        if size is None or len(size) != 4 or size[:2] != [1, 3]:
            raise InputError(path, value="no input image (1, 3, H, W)", allowed="one file that takes the image")
        if not known.intersection(_MASKS):
            raise InputError(path, value="no output mask or masks", allowed="a network whose output is called so")
        self._size = size[3], size[2]

    def __call__(self, shot: Shot, point: np.ndarray, box: tuple[float, float, float, float]) -> np.ndarray:
        """Mask (h, w) bool of a photo, from a point (2,) on the object and a box around it [px]."""
        height, width = shot.shape
        scale = np.array([self._size[0] / width, self._size[1] / height])
        image = cv2.resize(shot.image, self._size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        corners = (np.reshape(box, (2, 2)) + 0.0) * scale
        points = np.array([(np.asarray(point) + 0.5) * scale, *corners], np.float32)
        values: dict[str, Any] = {_IMAGE: image.transpose(2, 0, 1)[None], _BOX: corners.reshape(1, 4)}
        for session in self._sessions:
            feed = {node.name: _input(node.name, list(node.shape), values, points) for node in session.get_inputs()}
            names = [node.name for node in session.get_outputs()]
            values |= dict(zip(names, session.run(names, feed), strict=True))
        masks = next(values[name] for name in _MASKS if name in values)
        layers = masks.reshape(-1, *masks.shape[-2:])
        best = int(np.argmax(values[_SCORES])) if _SCORES in values and len(layers) > 1 else 0
        return cv2.resize(layers[best].astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0


def _input(name: str, shape: list[int], values: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """Value of an input; `points` (3, 2) are the middle and the corners of the box."""
    labels = np.array([_ON_OBJECT, *_CORNERS], np.float32)
    rows = {1: [0], 2: [1, 2]}.get(shape[1] if len(shape) > 1 else 0, [0, 1, 2])
    if name in _POINTS:
        return points[rows][None]
    if name in _LABELS:
        return labels[rows][None]
    if name in _EMPTY:
        return np.zeros(shape, np.float32)
    return np.ascontiguousarray(values[name], np.float32)
