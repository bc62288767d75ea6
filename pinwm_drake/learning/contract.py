# SPDX-License-Identifier: MIT
"""The contract of a bundle: inputs and outputs of its network, in words and numbers.

All of it follows from the specification, the limits and the golden samples, so that a reader can work it out again and
compare.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from pydantic import Field

from pinwm_drake.errors import require
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.validation import check_fields, from_document

SCHEMA_VERSION = 2
OPSET = 18
IMAGE, POSITION, GOAL = "image", "pusher_position", "goal"
TRANSLATION, ESTIMATE = "pusher_translation", "state_estimate"
FOLLOWED = 0.2  # largest error of a tool that follows
_PROSE = ("notes", "meaning")
_Error = Annotated[float, Field(ge=0, json_schema_extra={"allowed": "a finite number, 0 or more"})]


@dataclass(frozen=True)
class ArmCheck:
    """Check of a simulated arm: whether its tool follows the motions that the policy makes.

    Attributes:
        arm: Name of the arm, as `--arm-model` takes it.
        title: Maker and name.
        follows: Flag: the error is 0.2 at most.
        error: Root mean square of the differences of actions' ways from those of a pusher that the limits of `safety`
            alone hold back, over that of the ways; None where the arm reaches no place that a motion begins at.
        reason: Limits that are less than those of `safety`, or the place that is not reached, in words.

    Raises:
        ParameterError: A value is of another kind, or out of range.
    """

    arm: str
    title: str
    follows: bool
    error: _Error | None
    reason: str

    def __post_init__(self) -> None:
        check_fields(self)
        near = self.error is not None and self.error <= FOLLOWED
        require("follows", f"{self.follows} with error {self.error}", self.follows == near, f"{near}")

    @classmethod
    def from_document(cls, document: Any) -> "ArmCheck":
        """Check that is described as plain data; raises ParameterError where a key or a value is another."""
        return from_document(cls, document, "arms")

    def __str__(self) -> str:
        off = "" if self.error is None else f"the way of an action is off by {self.error:.0%}; "
        return f"{self.title} {'follows' if self.follows else 'does not follow'} the policy: {off}{self.reason}"


def _pusher_in_training(spec: PolicySpec) -> str:
    """How fast the pusher took a new velocity in training."""
    if spec.acceleration is not None:
        return f"the pusher changes its velocity by at most {spec.acceleration:g} m/s^2"
    if any(spec.lag):
        least, most = spec.lag
        return f"the pusher takes a new velocity with a time constant of {least:g} to {most:g} s"
    return "the pusher takes a new velocity at once"


def make_contract(
    spec: PolicySpec,
    limits: SafetyLimits,
    mask_pixels: Sequence[int],
    *,
    estimate: bool = True,
    arms: Sequence[ArmCheck] = (),
) -> dict[str, Any]:
    """Contract of a bundle, as plain data.

    Args:
        spec: Specification of a policy that observes "rgb".
        limits: Limits of the pusher's motion that a controller keeps, whatever the policy asks for.
        mask_pixels: Least and largest number of the object's pixels in an image; see `Golden.mask_pixels`.
        estimate: Flag: the network gives its estimate of the task's state beside the action.
        arms: Checks of arms; none where none was made.
    """
    # Without a delay a policy is trained in an environment that waits for it.
    axes = " and ".join(spec.task.axes)
    latency = list(spec.latency) if any(spec.latency) else 0.0
    often: dict[str, Any] = {"rate": 1.0 / spec.horizon, "period": spec.horizon, "latency": latency}
    past = (
        f"; then for each of the last {spec.history} actions, the newest first, {axes} of P before it and of the "
        "translation asked for: at the start the first place and zeros"
        if spec.history
        else ""
    )
    words, units = zip(*spec.task.state_components(), strict=True)
    told = {
        "name": ESTIMATE,
        "dtype": "float32",
        "shape": [spec.task.state_size],
        "unit": list(units),
        "meaning": list(words),
        **often,
    }
    goal = {
        "name": GOAL,
        "dtype": "float32",
        "shape": [spec.task.goal_size],
        "unit": [unit for _, unit in spec.task.goal_components()],
        "frame": "W",
        "meaning": [meaning for meaning, _ in spec.task.goal_components()],
    }
    return {
        "schema_version": SCHEMA_VERSION,
        "notes": {
            "units": "SI and radians, where no other unit stands; rate in Hz; a unit of 0.1 m means that 1 is 0.1 m",
            "W": "the world, z up",
            "C": "the camera, OpenCV axes: x right, y down, z forward; pixels' centres at half-integers",
            "O": "the object: axes and origin of the coordinates in its mesh's file; spec.scene.object.middle is the "
            "middle of the box around the mesh, in O",
            "P": "the pusher: its middle, axes of W",
            "quaternions": "w, x, y, z; q_WC turns axes of C into W",
            "mask": "a pixel of which half or more shows the object has the object's colour, every other one is white "
            "(255, 255, 255), where the pusher or anything else hides the object too; no shadow, floor or pusher is "
            "left in the image. Of an RGBA image, alpha is 255 on the object and 0 elsewhere. mask.pixels: least and "
            "largest number of pixels that are not white in one of the seen golden images",
            "latency": "s between the moment at which an input holds and the action, as in training: one number, or "
            "least and largest; spec.station: SHA-256 of the station.yaml that it is for; max_latency: s, "
            "age beyond which the controller takes an image for stale",
            "period": "s between one image, position or action and the next",
            "success": "spec.task: tolerance in m, turn_tolerance in rad; at rest below rest_speed in m/s and "
            "rest_turn in rad/s",
            "safety": "kept by the controller, whatever the network asks for; m, m/s, m/s^2 and s",
            "robot": "it has to follow commands up to safety.max_speed and safety.max_acceleration within the box: in "
            f"training {_pusher_in_training(spec)}. One that is slower does other motions than those that "
            "were learned. arms: whether simulated arms follow the motions of the golden samples' episodes. error is "
            "the root mean square by which actions' ways are off, over that of the ways; up to 0.2 counts as following",
        },
        "onnx": {"opset": OPSET},
        "inputs": [
            {
                "name": IMAGE,
                "dtype": "uint8",
                "shape": list(spec.image_shape),
                "unit": "sRGB, 0 to 255",
                "frame": "C",
                "meaning": "the object where it is seen, white elsewhere (notes: mask); RGB of the last images, the "
                "oldest first, one an action; at the start the first image stands for those before it",
                "frames": spec.frames,
                "camera": spec.to_document()["camera"],
                **often,
                "max_latency": limits.max_image_age,
            },
            {
                "name": POSITION,
                "dtype": "float32",
                "shape": [spec.pusher_size],
                "unit": "m",
                "frame": "W",
                "meaning": f"{axes} of the pusher's frame P when the last image was taken{past}",
                **often,
            },
            *([goal] if spec.task.goal_size else []),
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
            },
            *([told] if estimate else []),
        ],
        "mask": {"pixels": [int(value) for value in mask_pixels], "hidden": [255, 255, 255]},
        "safety": limits.to_document(),
        **({"arms": [asdict(one) for one in arms]} if arms else {}),
        "spec": spec.to_document(),
    }


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
