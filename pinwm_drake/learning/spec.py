"""Specifications of policies: the meaning of a network's inputs and outputs, as plain numbers."""

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

import numpy as np

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks import DEFAULT_TASK
from pinwm_drake.tasks.registry import task_from_document
from pinwm_drake.tasks.task import Task

Observes = Literal["rgb", "state"]
OBSERVES = ("rgb", "state")
Head = Literal["levels", "tanh", "dither"]
HEADS = ("levels", "tanh", "dither")
PUSHER_SHAPES = ("sphere", "capsule", "cylinder", "mesh")
_FLAT = ("goal", "q_WO", "tolerance", "turn_tolerance")  # in version 1, which knew the push task alone
_LATER = {"head": "levels", "window": None, "width": 256, "history": 0}  # fields that came later, as they were before


@dataclass(frozen=True)
class CameraSpec:
    """A pinhole camera without distortion; its pixels' centres lie at half-integers.

    Attributes:
        width, height: px, size of an image.
        fx, fy: px, focal lengths.
        cx, cy: px, principal point.
        p_WC: (3,) m, world: position of the camera.
        q_WC: (4,) wxyz, its orientation in the world; OpenCV axes: x right, y down, z forward.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    p_WC: tuple[float, float, float]
    q_WC: tuple[float, float, float, float]


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
    mesh_sha256: str
    size: tuple[float, float, float]
    middle: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Checks size and hash."""
        _check_hash("scene.object.mesh_sha256", self.mesh_sha256)
        if not all(0 < value < math.inf for value in self.size):
            raise ParameterError(f"scene.object.size: got {self.size}; allowed: more than 0 m")


@dataclass(frozen=True)
class PusherSpec:
    """The pusher of a policy; its axis is along z of its frame P, the origin of P its middle.

    Attributes:
        shape: One of `PUSHER_SHAPES`.
        radius: m, of sphere, caps or cylinder; of a mesh, that of the upright cylinder around it.
        length: m, of the straight part along z, 0 for a sphere; of a mesh, that of the cylinder.
        mesh_sha256: SHA-256 of the bytes of a mesh's file; None for the other shapes.

    Raises:
        ParameterError: There is no such shape, a dimension is out of range, or a mesh has no SHA-256.
    """

    shape: str
    radius: float
    length: float
    mesh_sha256: str | None = None

    def __post_init__(self) -> None:
        """Checks shape, dimensions and hash."""
        if self.shape not in PUSHER_SHAPES:
            raise ParameterError(f"scene.pusher.shape: got {self.shape!r}; allowed: {', '.join(PUSHER_SHAPES)}")
        if not 0 < self.radius < math.inf or not 0 <= self.length < math.inf:
            given = f"radius {self.radius} m, length {self.length} m"
            raise ParameterError(f"scene.pusher: got {given}; allowed: more than 0, and 0 or more")
        if self.shape == "mesh":
            _check_hash("scene.pusher.mesh_sha256", self.mesh_sha256)
        elif self.mesh_sha256 is not None:
            raise ParameterError(f"scene.pusher.mesh_sha256: got one of a {self.shape}; allowed: none")


@dataclass(frozen=True)
class SceneSpec:
    """The scene that a policy is made for, as far as its task and camera do not tell.

    Attributes:
        object: The object.
        pusher: The pusher.
        floor_height: m, world: z of the floor.
    """

    object: ObjectSpec
    pusher: PusherSpec
    floor_height: float

    @classmethod
    def from_document(cls, document: Any) -> "SceneSpec":
        """The scene as `dataclasses.asdict` gives it; raises ParameterError."""
        values = _values(cls, document, "scene")
        values["object"] = ObjectSpec(**_values(ObjectSpec, values["object"], "scene.object"))
        values["pusher"] = PusherSpec(**_values(PusherSpec, values["pusher"], "scene.pusher"))
        return cls(**values)


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

    Raises:
        ParameterError: A value is not finite, not positive, or not among those allowed.
    """

    observes: Observes
    frames: int
    camera: CameraSpec
    horizon: float
    max_translation: float
    pusher_low: tuple[float, ...]
    pusher_high: tuple[float, ...]
    pusher_height: float
    task: Task
    max_steps: int
    scene: SceneSpec | None = None
    head: Head = "levels"
    window: int | None = None
    width: int = 256
    history: int = 0

    def __post_init__(self) -> None:
        """Checks the values."""
        if self.observes not in OBSERVES:
            raise ParameterError(f"observes: got {self.observes!r}; allowed: {', '.join(OBSERVES)}")
        if self.head not in HEADS:
            raise ParameterError(f"head: got {self.head!r}; allowed: {', '.join(HEADS)}")
        for name in ("frames", "max_steps", "width"):
            if not isinstance(getattr(self, name), int) or getattr(self, name) < 1:
                raise ParameterError(f"{name}: got {getattr(self, name)!r}; allowed: a whole number, 1 or more")
        most = math.inf if self.observes == "state" else self.frames - 1
        if not isinstance(self.history, int) or not 0 <= self.history <= most:
            allowed = "a whole number, 0 or more; of images less than frames"
            raise ParameterError(f"history: got {self.history!r}; allowed: {allowed}")
        for name in ("horizon", "max_translation"):
            if not 0 < getattr(self, name) < math.inf:
                raise ParameterError(f"{name}: got {getattr(self, name)}; allowed: more than 0")
        low, high = np.array(self.pusher_low), np.array(self.pusher_high)
        shape, axes = (self.action_size,), " and ".join(self.task.axes)
        if low.shape != shape or high.shape != shape or not (low < high).all() or not np.isfinite([low, high]).all():
            raise ParameterError(f"pusher_low, pusher_high: got {low} and {high}; allowed: {axes}, m, low below high")
        if self.camera.width < 1 or self.camera.height < 1:
            raise ParameterError(f"camera: got {self.camera.width} by {self.camera.height} px; allowed: 1 or more")
        if self.window is not None:
            whole = isinstance(self.window, int) and 1 <= self.window <= min(self.camera.width, self.camera.height)
            if not whole:
                raise ParameterError(f"window: got {self.window!r}; allowed: 1 to the size of an image")

    @property
    def action_size(self) -> int:
        """Components of an action, one for each of the task's axes."""
        return self.task.action_size

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Shape (height, width, 3 k) of the images that the policy sees, k of them in one stack."""
        return (self.camera.height, self.camera.width, 3 * self.frames)

    def to_document(self) -> dict[str, Any]:
        """The specification as plain data, for YAML; what came later is left out where it is as before."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        for name, before in _LATER.items():
            if values[name] == before:
                del values[name]
        values |= {"camera": asdict(self.camera), "task": self.task.to_document()}
        values["scene"] = None if self.scene is None else asdict(self.scene)
        return {name: _plain(value) for name, value in values.items()}

    @classmethod
    def from_document(cls, document: Any) -> "PolicySpec":
        """The specification that `to_document` described, of this version or an older one.

        Raises:
            ParameterError: A key is missing or unknown, or a value is out of range.
        """
        document = from_version_1(document)
        if isinstance(document, dict):
            document = {"scene": None, **_LATER, **document}
        values = _values(cls, document, "spec")
        values["camera"] = CameraSpec(**_values(CameraSpec, values["camera"], "camera"))
        values["task"] = task_from_document(values["task"])
        values["scene"] = None if values["scene"] is None else SceneSpec.from_document(values["scene"])
        return cls(**values)


def from_version_1(document: Any) -> Any:
    """The document with its task in an entry of its own: in version 1 the push task's fields stood beside the others.

    Any other document is returned as it is.
    """
    if not isinstance(document, dict) or "task" in document or not set(_FLAT) <= set(document):
        return document
    task = {"name": DEFAULT_TASK} | {name: document[name] for name in _FLAT}
    rest = {name: value for name, value in document.items() if name not in _FLAT and name != "max_steps"}
    return rest | {"task": task_from_document(task).to_document(), "max_steps": document.get("max_steps")}


def _values(kind: type, document: Any, name: str) -> dict[str, Any]:
    """The fields of a dataclass, lists as tuples; raises ParameterError."""
    names = [field.name for field in fields(kind)]
    if not isinstance(document, dict) or set(document) != set(names):
        given = sorted(document) if isinstance(document, dict) else document
        raise ParameterError(f"{name}: got {given}; allowed: the keys {', '.join(names)}")
    values = {}
    for field in fields(kind):
        value = document[field.name]
        form = str(field.type)
        if form.startswith("tuple"):
            length = None if "..." in form else form.count("float")
            good = isinstance(value, list | tuple) and len(value) == (len(value) if length is None else length)
            if not good or not all(_number(item) for item in value):
                allowed = f"{'' if length is None else f'{length} '}finite numbers"
                raise ParameterError(f"{name}.{field.name}: got {value!r}; allowed: {allowed}")
            value = tuple(float(item) for item in value)
        elif field.type is float and not _number(value):
            raise ParameterError(f"{name}.{field.name}: got {value!r}; allowed: a finite number")
        elif field.type is int and (not isinstance(value, int) or isinstance(value, bool)):
            raise ParameterError(f"{name}.{field.name}: got {value!r}; allowed: a whole number")
        elif field.type is str and not isinstance(value, str):
            raise ParameterError(f"{name}.{field.name}: got {value!r}; allowed: a text")
        values[field.name] = value
    return values


def _check_hash(name: str, value: Any) -> None:
    if not isinstance(value, str) or re.fullmatch("[0-9a-f]{64}", value) is None:
        raise ParameterError(f"{name}: got {value!r}; allowed: a SHA-256, 64 digits of 0 to 9 and a to f")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return [float(item) for item in value] if isinstance(value, tuple) else value


def seen_parts(observation: Any, *names: str) -> list[np.ndarray]:
    """Entries of an observation, by name.

    Raises:
        ParameterError: The observation is no dict, or lacks one of them.
    """
    if not isinstance(observation, Mapping) or not set(names) <= set(observation):
        given = sorted(observation) if isinstance(observation, Mapping) else type(observation).__name__
        raise ParameterError(f"observation: got {given}; allowed: a dict with {' and '.join(names)}")
    return [np.asarray(observation[name]) for name in names]
