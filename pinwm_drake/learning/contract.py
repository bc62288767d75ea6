"""The contract of a bundle: inputs and outputs of its network, in words and numbers.

All of it follows from the specification and the limits, so that a reader can work it out again and compare.
"""

from typing import Any

from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.learning.spec import PolicySpec, from_version_1

SCHEMA_VERSION, VERSIONS = 2, (1, 2)
OPSET = 18
IMAGE, POSITION, TRANSLATION = "image", "pusher_position", "pusher_translation"
_PROSE = ("notes", "meaning")


def make_contract(spec: PolicySpec, limits: SafetyLimits) -> dict[str, Any]:
    """Contract of a bundle, as plain data.

    Args:
        spec: Specification of a policy that observes "rgb".
        limits: Limits of the pusher's motion that a controller keeps, whatever the policy asks for.
    """
    # Latency is 0: a policy is trained in an environment that waits for it.
    axes = " and ".join(spec.task.axes)
    often: dict[str, Any] = {"rate": 1.0 / spec.horizon, "latency": 0.0}
    return {
        "schema_version": SCHEMA_VERSION,
        "notes": {
            "units": "SI and radians, where no other unit stands; rate in Hz",
            "W": "the world, z up",
            "C": "the camera, OpenCV axes: x right, y down, z forward; pixels' centres at half-integers",
            "latency": "s between the moment at which an input holds and the action, as in training",
            "safety": "kept by the controller, whatever the network asks for",
        },
        "onnx": {"opset": OPSET},
        "inputs": [
            {
                "name": IMAGE,
                "dtype": "uint8",
                "shape": list(spec.image_shape),
                "unit": "sRGB, 0 to 255",
                "frame": "C",
                "meaning": "the object where it is seen, white elsewhere; RGB of the last images, the oldest first, "
                "one an action; at the start the first image stands for those before it",
                "frames": spec.frames,
                "camera": spec.to_document()["camera"],
                **often,
            },
            {
                "name": POSITION,
                "dtype": "float32",
                "shape": [spec.action_size],
                "unit": "m",
                "frame": "W",
                "meaning": f"{axes} of the pusher's frame P when the last image was taken",
                **often,
            },
        ],
        "outputs": [
            {
                "name": TRANSLATION,
                "dtype": "float32",
                "shape": [spec.action_size],
                "unit": "m",
                "frame": "W",
                "meaning": f"{axes} by which the pusher is to move in the horizon, no longer than max_translation; its "
                "other coordinates stay",
                "horizon": spec.horizon,
                "max_translation": spec.max_translation,
                **often,
            }
        ],
        "safety": limits.to_document(),
        "spec": spec.to_document(),
    }


def upgraded(document: dict[str, Any]) -> dict[str, Any]:
    """The contract in the present version: in the first one the push task stood among the specification's keys."""
    if document.get("schema_version") != 1:
        return document
    return {**document, "schema_version": SCHEMA_VERSION, "spec": from_version_1(document.get("spec"))}


def difference(found: Any, expected: Any, name: str = "") -> tuple[str, Any, Any] | None:
    """First difference between two documents; entries that only people read, `notes` and `meaning`, do not count.

    Args:
        found: Plain data.
        expected: Plain data.
        name: Name of the entry that they are; empty for whole documents.

    Returns:
        The entry's name, what was found, and what was expected; None where they are the same.
    """
    if isinstance(found, dict) and isinstance(expected, dict):
        for key in [*expected, *(key for key in found if key not in expected)]:
            if key in _PROSE:
                continue
            inner = f"{name}.{key}" if name else str(key)
            if key not in found or key not in expected:
                return (inner, "no entry", expected[key]) if key in expected else (inner, found[key], "no entry")
            if (differs := difference(found[key], expected[key], inner)) is not None:
                return differs
        return None
    if isinstance(found, list) and isinstance(expected, list) and len(found) == len(expected):
        pairs = (difference(a, b, f"{name}[{k}]") for k, (a, b) in enumerate(zip(found, expected, strict=True)))
        return next((differs for differs in pairs if differs is not None), None)
    same = found == expected and isinstance(found, bool) == isinstance(expected, bool)
    return None if same else (name, found, expected)
