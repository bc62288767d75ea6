# SPDX-License-Identifier: MIT
"""The network of a bundle in onnxruntime: one thread, on the CPU, and nothing is told to its makers."""

import os
from pathlib import Path
from typing import Any

import numpy as np

# From 1.29 on it sends to Microsoft what it loads and runs, unless this is set before it is imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

import onnxruntime

from pinwm_drake.errors import InputError, StateError
from pinwm_drake.learning.contract import ESTIMATE, GOAL, IMAGE, POSITION, TRANSLATION
from pinwm_drake.reading.network import check_network

_TYPES = {"tensor(uint8)": "uint8", "tensor(float)": "float32"}


class Network:
    """The network of policy.onnx, loaded once."""

    def __init__(self, content: bytes, path: Path, contract: dict[str, Any]) -> None:
        """Load the network, and compare its inputs and outputs with the contract.

        Args:
            content: Contents of policy.onnx.
            path: Path that messages name.
            contract: Contract of the bundle, as `make_contract` gives it.

        Raises:
            InputError: onnxruntime cannot load it, or inputs and outputs are others.
        """
        check_network(content, path)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # errors are raised
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's errors have no base of their own
            allowed = "a network in ONNX, weights included, that onnxruntime loads"
            raise InputError(path, value=f"unreadable contents ({_line(error)})", allowed=allowed) from error
        kinds = (
            ("inputs", self._session.get_inputs(), contract["inputs"]),
            ("outputs", self._session.get_outputs(), contract["outputs"]),
        )
        for what, nodes, entries in kinds:
            found = [(node.name, _TYPES.get(node.type, node.type), list(node.shape)) for node in nodes]
            wanted = [(entry["name"], entry["dtype"], entry["shape"]) for entry in entries]
            if found != wanted:
                allowed = f"{_listed(wanted)}, as the contract says"
                raise InputError(path, value=f"{what} {_listed(found)}", allowed=allowed)
        self._path = path
        self._shapes = {entry["name"]: tuple(entry["shape"]) for entry in contract["inputs"]}
        self._outputs = [entry["name"] for entry in contract["outputs"]]

    @property
    def estimates(self) -> bool:
        """Flag: the network gives its estimate of the task's state."""
        return ESTIMATE in self._outputs

    @property
    def goal_size(self) -> int:
        """Number of components of the goal that the network is told; 0 where it is told none."""
        return self._shapes.get(GOAL, (0,))[0]

    def run(
        self, image: np.ndarray, p_WP: np.ndarray, goal: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the translation d_W (n,) m, world, over the horizon, and the estimate of the state.

        Both are float32. The translation is NaN where the position is NaN; the estimate (state_size,) is None where
        there is none.

        Args:
            image: (height, width, 3 k) uint8, RGB: the last k images, the oldest first.
            p_WP: (spec.pusher_size,) m, world: position of the pusher along the axes of the task, with its history.
            goal: (task.goal_size,) goal of the episode; None where episodes have that of the task.

        Raises:
            StateError: A shape, or the image's type, is another.
            InputError: The parts of the network do not fit each other.
        """
        image, position = np.asarray(image), np.asarray(p_WP, np.float32)
        if image.dtype != np.uint8 or image.shape != self._shapes[IMAGE]:
            raise StateError(f"image: got {image.dtype} {image.shape}; allowed: uint8 {self._shapes[IMAGE]}")
        if position.shape != self._shapes[POSITION]:
            allowed = f"{self._shapes[POSITION]}, along the axes of the task, m"
            raise StateError(f"p_WP: got the shape {position.shape}; allowed: {allowed}")
        inputs = {IMAGE: np.ascontiguousarray(image), POSITION: np.ascontiguousarray(position)}
        if goal is not None:
            inputs[GOAL] = np.ascontiguousarray(goal, np.float32)
        if (shape := self._shapes.get(GOAL)) != (None if goal is None else inputs[GOAL].shape):
            given = "none" if goal is None else f"the shape {inputs[GOAL].shape}"
            raise StateError(f"goal: got {given}; allowed: {'none' if shape is None else shape}, as the contract says")
        try:
            found = self._session.run(self._outputs, inputs)
        except Exception as error:
            value = f"a network that does not run ({_line(error)})"
            raise InputError(self._path, value=value, allowed="one whose parts fit each other") from error
        answers = dict(zip(self._outputs, found, strict=True))
        return answers[TRANSLATION], answers.get(ESTIMATE)


def _line(error: Exception) -> str:
    """Message of onnxruntime, on one line and not too long."""
    return " ".join(str(error).split())[:200]


def _listed(nodes: list[tuple[str, str, list[Any]]]) -> str:
    return ", ".join(f"{name} {kind} {shape}" for name, kind, shape in nodes)
