# SPDX-License-Identifier: MIT
"""Specifications of policies: the meaning of a network's inputs and outputs, as plain numbers."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, InstanceOf
from pydantic_core import to_jsonable_python

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.history import history_size
from pinwm_drake.tasks.registry import task_from_document
from pinwm_drake.tasks.task import Task
from pinwm_drake.validation import check_fields, document_of, from_document

Observes = Literal["rgb", "state"]
Head = Literal["levels", "tanh", "dither"]
_Vector = tuple[float, float, float]
_Length = Annotated[float, Field(gt=0, json_schema_extra={"unit": "m"})]
_MOST, _MOST_SEEN = 256, 2**26  # frames or past actions; values of the images that are seen
_Pixels = Annotated[int, Field(ge=1, le=16384, json_schema_extra={"unit": "px"})]
_Count = Annotated[int, Field(ge=1, json_schema_extra={"allowed": "a whole number, 1 or more"})]
_SHA256 = "a SHA-256, 64 digits of 0 to 9 and a to f"
_Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$", json_schema_extra={"allowed": _SHA256})]
_Delay = Annotated[float, Field(ge=0, json_schema_extra={"unit": "s"})]
_LATER = {
    "head": "levels",
    "window": None,
    "width": 256,
    "history": 0,
    "station": None,
    "latency": (0.0, 0.0),
    "lag": (0.0, 0.0),
    "acceleration": None,
}  # fields that came later, as they were before


def _task(value: Any) -> Task:
    return value if isinstance(value, Task) else task_from_document(value)


@dataclass(frozen=True)
class CameraSpec:
    """A pinhole camera without distortion; its pixels' centres lie at half-integers.

    Attributes:
        width, height: px, size of an image.
        fx, fy: px, focal lengths.
        cx, cy: px, principal point.
        p_WC: (3,) m, world: position of the camera.
        q_WC: (4,) wxyz, its orientation in the world; OpenCV axes: x right, y down, z forward.

    Raises:
        ParameterError: A value is not finite, or the size is not positive.
    """

    width: _Pixels
    height: _Pixels
    fx: float
    fy: float
    cx: float
    cy: float
    p_WC: _Vector
    q_WC: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        check_fields(self, "camera.")


@dataclass(frozen=True)
class ObjectSpec:
    """The object that a policy is made for; its frame O has the axes and the origin of the mesh's file.

    Attributes:
        name: Name of the object.
        mesh_sha256: SHA-256 of the bytes of the mesh's file.
        size: (3,) m, extents of the mesh along the axes of O.
        middle: (3,) m, frame O: middle of the box around the mesh, which tells where in it the origin of O is.

    Raises:
        ParameterError: A size is not positive, or the SHA-256 is none.
    """

    name: str
    mesh_sha256: _Sha256
    size: tuple[_Length, _Length, _Length]
    middle: _Vector

    def __post_init__(self) -> None:
        check_fields(self, "scene.object.")


@dataclass(frozen=True)
class PusherSpec:
    """The pusher of a policy; its axis is along z of its frame P, the origin of P its middle.

    Attributes:
        shape: sphere, capsule, cylinder or mesh.
        radius: m, of sphere, caps or cylinder; of a mesh, that of the upright cylinder around it.
        length: m, of the straight part along z, 0 for a sphere; of a mesh, that of the cylinder.
        mesh_sha256: SHA-256 of the bytes of a mesh's file; None for the other shapes.

    Raises:
        ParameterError: There is no such shape, a dimension is out of range, or a mesh has no SHA-256.
    """

    shape: Literal["sphere", "capsule", "cylinder", "mesh"]
    radius: float
    length: float
    mesh_sha256: _Sha256 | None = None

    def __post_init__(self) -> None:
        check_fields(self, "scene.pusher.")
        if self.radius <= 0 or self.length < 0:
            given = f"radius {self.radius} m, length {self.length} m"
            raise ParameterError(f"scene.pusher: got {given}; allowed: more than 0, and 0 or more")
        if (self.mesh_sha256 is not None) != (self.shape == "mesh"):
            given, allowed = ("None", _SHA256) if self.shape == "mesh" else (f"one of a {self.shape}", "none")
            raise ParameterError(f"scene.pusher.mesh_sha256: got {given}; allowed: {allowed}")


@dataclass(frozen=True)
class SceneSpec:
    """The scene that a policy is made for, as far as its task and camera do not tell.

    Attributes:
        object: The object.
        pusher: The pusher.
        floor_height: m, world: z of the floor.
    """

    object: Annotated[ObjectSpec, document_of(ObjectSpec, "scene.object")]
    pusher: Annotated[PusherSpec, document_of(PusherSpec, "scene.pusher")]
    floor_height: float

    def __post_init__(self) -> None:
        check_fields(self, "scene.")


@dataclass(frozen=True)
class PolicySpec:
    """Inputs and outputs of a policy of one task.

    Attributes:
        observes: "rgb": images and the pusher's position; "state": the numbers of `Task.state`.
        frames: Number k of the last images that it sees, the oldest first, one an action; the first image of an episode
            stands for those before it.
        camera: Camera of the images: sRGB of the object where it is seen, white elsewhere.
        horizon: s, duration of an action.
        max_translation: m, longest translation of the pusher in an action, which an action of norm 1 stands for.
        pusher_low, pusher_high: (n,) m, world, along the task's axes: corners of the box that the pusher may be in,
            which -1 and 1 stand for.
        pusher_height: m, world: z of the pusher's frame P at the start; it stays where z is not an axis of the task.
        task: Goal, success, axes of the action and size of the state.
        max_steps: Largest number of actions in an episode.
        scene: Object, pusher and floor; None where nothing is known of them, as in older policies.
        head: "levels", "tanh" or "dither": how the network ends; see `actors`.
        window: px, side of the part of the images that the network sees, around the object; None for all.
        width: Width of the two hidden layers from the state to the action.
        history: Number of the last actions that it sees, each with the state before it (observing "state") or the
            pusher's position (observing "rgb", with an image of each time); see `tasks.history`.
        station: SHA-256 of the `station.yaml` of the station that it is made for; None for none.
        latency: s, least and largest delay of an action in training.
        lag: s, least and largest time constant with which the pusher takes a new velocity in training.
        acceleration: m/s^2, largest one of the pusher in training; None for any.

    Raises:
        ParameterError: A value is not finite, not positive, or not among those allowed.
    """

    observes: Observes
    frames: Annotated[int, Field(ge=1, le=_MOST)]
    camera: Annotated[CameraSpec, document_of(CameraSpec, "camera")]
    horizon: Annotated[float, Field(gt=0)]
    max_translation: Annotated[float, Field(gt=0)]
    pusher_low: tuple[float, ...]
    pusher_high: tuple[float, ...]
    pusher_height: float
    task: Annotated[InstanceOf[Task], BeforeValidator(_task)]
    max_steps: _Count
    scene: Annotated[SceneSpec, document_of(SceneSpec, "scene")] | None = None
    head: Head = "levels"
    window: int | None = None
    width: Annotated[int, Field(ge=1, le=4096)] = 256
    history: int = 0
    station: _Sha256 | None = None
    latency: tuple[_Delay, _Delay] = (0.0, 0.0)
    lag: tuple[_Delay, _Delay] = (0.0, 0.0)
    acceleration: Annotated[float, Field(gt=0, json_schema_extra={"unit": "m/s^2"})] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        most = _MOST if self.observes == "state" else self.frames - 1
        if not 0 <= self.history <= most:
            allowed = f"a whole number, 0 to {_MOST}; of images less than frames"
            raise ParameterError(f"history: got {self.history!r}; allowed: {allowed}")
        low, high = np.array(self.pusher_low), np.array(self.pusher_high)
        shape, axes = (self.action_size,), " and ".join(self.task.axes)
        if low.shape != shape or high.shape != shape or not (low < high).all():
            raise ParameterError(f"pusher_low, pusher_high: got {low} and {high}; allowed: {axes}, m, low below high")
        if math.prod(self.image_shape) > _MOST_SEEN:
            raise ParameterError(f"camera, frames: got images {self.image_shape}; allowed: {_MOST_SEEN} values at most")
        if self.window is not None and not 1 <= self.window <= min(self.camera.width, self.camera.height):
            raise ParameterError(f"window: got {self.window!r}; allowed: 1 to the size of an image")

    @property
    def action_size(self) -> int:
        """Components of an action, one for each of the task's axes."""
        return self.task.action_size

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Shape (height, width, 3 k) of the images that the policy sees, k of them in one stack."""
        return (self.camera.height, self.camera.width, 3 * self.frames)

    @property
    def pusher_size(self) -> int:
        """Number of components of what a policy of images knows of the pusher; see `tasks.history`."""
        return history_size(self.action_size, self.action_size, self.history)

    def pusher_seen(self, metres: np.ndarray) -> np.ndarray:
        """Positions and translations in [-1, 1], as the network sees them; positions are cut at the walls of the box.

        Args:
            metres: (..., pusher_size) m, world: position of the pusher along the task's axes; then, for each of the
                last `history` actions, the newest first, the position before it and the translation asked for.
        """
        middle, reach = self.pusher_scales()
        seen: np.ndarray = np.clip((metres - middle) / reach, -1.0, 1.0)
        return seen

    def pusher_metres(self, seen: np.ndarray) -> np.ndarray:
        """Positions and translations (..., pusher_size) m of those in [-1, 1]; the inverse of `pusher_seen`."""
        middle, reach = self.pusher_scales()
        metres: np.ndarray = middle + reach * seen
        return metres

    def pusher_scales(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (pusher_size,) m that 0 stands for in what a network knows of the pusher, and their way to 1."""
        low, high = np.array(self.pusher_low), np.array(self.pusher_high)
        place = 0.5 * (low + high), 0.5 * (high - low)
        translation = np.zeros(self.action_size), np.full(self.action_size, self.max_translation)
        middle, reach = zip(place, *[place, translation] * self.history, strict=True)
        return np.concatenate(middle), np.concatenate(reach)

    def to_document(self) -> dict[str, Any]:
        """Return the specification as plain data, for YAML; what came later is left out where it is as before."""
        values = asdict(self) | {"task": self.task.to_document()}
        kept = {name: value for name, value in values.items() if name not in _LATER or value != _LATER[name]}
        document: dict[str, Any] = to_jsonable_python(kept)
        return document

    @classmethod
    def from_document(cls, document: Any) -> "PolicySpec":
        """Return the specification that `to_document` described, of this version or an older one.

        Raises:
            ParameterError: A key is missing or unknown, or a value is out of range.
        """
        given = {"scene": None, **_LATER, **document} if isinstance(document, dict) else document
        return from_document(cls, given, "spec")


def seen_parts(observation: Any, *names: str) -> list[np.ndarray]:
    """Entries of an observation, by name.

    Raises:
        ParameterError: The observation is no dict, or lacks one of them.
    """
    if not isinstance(observation, Mapping) or not set(names) <= set(observation):
        given = sorted(observation) if isinstance(observation, Mapping) else type(observation).__name__
        raise ParameterError(f"observation: got {given}; allowed: a dict with {' and '.join(names)}")
    return [np.asarray(observation[name]) for name in names]
