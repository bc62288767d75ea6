# SPDX-License-Identifier: MIT
"""Document of a twin, `twin.yaml`: every key and number of it, checked, and its form on disk."""

import math
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, create_model, model_validator

from pinwm_drake.capture.scene import GRAVITIES, UNITS, FloorDocument, PusherDocument
from pinwm_drake.documents import ROUND_CONE, Document, Entry, FromList, Number, Text, finite, in_words, schema_version
from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.primitive import Kind, Primitive
from pinwm_drake.scene import Support
from pinwm_drake.twin.twin import SCHEMA_VERSION, THETA, Estimate, Twin

_LONGEST_STEP = 0.1  # s
_INERTIA = ("inertia_xx", "inertia_yy", "inertia_zz")
_ROUNDING = 1e-9  # relative, of the triangle inequality: what the physics allows
_DEEPEST = 32
_MOST = 100_000  # values; more than that is no provenance but a bomb of YAML aliases
_INTERVAL = "null, or two numbers [low, high] with low <= high"


class _Units(Document):
    mass: Literal["kg"]
    length: Literal["m"]
    angle: Literal["rad"]
    time: Literal["s"]


class _Pusher(PusherDocument):
    @model_validator(mode="after")
    def _require_geometry(self) -> "_Pusher":
        if self.mesh is None and self.shape is None:
            raise ValueError("a mesh or a shape")
        return self


class _Physics(Document):
    time_step: float = in_words(f"above 0, up to {_LONGEST_STEP:g} s", gt=0.0, le=_LONGEST_STEP)
    support: Support = in_words("corners, patch or faces")


_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}
_Vector = Annotated[tuple[Number, Number, Number], FromList]


class _Primitive(Document):
    kind: Kind = in_words("sphere, capsule, cylinder or box")
    size: Annotated[tuple[Number, ...], FromList]
    q: Annotated[tuple[Number, Number, Number, Number], FromList]
    p: _Vector
    deviation: Annotated[float, finite(0.0, math.inf)]
    tolerance: Annotated[float, finite(0.0, math.inf)]
    open_ends: Annotated[tuple[bool, bool], FromList]

    def primitive(self) -> Primitive:
        return Primitive(self.kind, self.size, self.q, self.p, self.deviation, self.open_ends)

    @model_validator(mode="after")
    def _check(self) -> "_Primitive":
        number = _SIZES[self.kind]
        try:
            if len(self.size) != number:
                raise ValueError(f"a {self.kind} with {number} sizes")
            self.primitive().piece()
        except GeometryError as error:
            raise ValueError(f"a primitive: {error}") from error
        return self


def _ordered(interval: tuple[float, float] | None) -> tuple[float, float] | None:
    if interval is not None and interval[0] > interval[1]:
        raise ValueError(_INTERVAL)
    return interval


def _positive(value: float) -> float:
    if value <= 0.0:
        raise ValueError("above 0")
    return value


# .inf where the data say nothing on that side.
_End = Annotated[float, in_words("a finite number", ge=-math.inf, allow_inf_nan=True)]


class _Estimate(Document):
    value: Number
    interval: Annotated[tuple[_End, _End] | None, FromList, AfterValidator(_ordered)] = in_words(_INTERVAL)
    identifiable: bool = in_words("true or false")
    unit: str = in_words("text, which may be empty")
    note: str = in_words("text, which may be empty")

    def estimate(self) -> Estimate:
        return Estimate(self.value, self.interval, self.identifiable, self.unit, self.note)


def _physical(name: str, unit: str) -> Any:
    """Field of an estimate in a unit, whose value a body can have."""
    value: Any = Annotated[float, finite(), AfterValidator(_positive)]
    if name.startswith(("friction", "restitution")):
        value = Annotated[float, finite(0.0, math.inf if name.startswith("friction") else 1.0)]
    only = in_words(f'"{unit}"', pattern=f"^{re.escape(unit)}$")
    return create_model(name, __base__=_Estimate, value=(value, ...), unit=(str, only)), ...


_Theta = create_model("_Theta", __base__=Document, **{key: _physical(key, unit) for key, unit in THETA.items()})


class TwinDocument(Document):
    """Contents of a `twin.yaml`; see `Twin` for their meaning."""

    schema_version: int = schema_version(SCHEMA_VERSION)
    units: _Units
    name: Text
    mesh: Text
    pusher: _Pusher
    gravity: Annotated[float, finite(*GRAVITIES)]
    floor: FloorDocument
    acts_as: Annotated[tuple[_Primitive, ...], FromList] = ()
    physics: _Physics
    theta: _Theta  # type: ignore[valid-type]  # its keys are those of THETA
    nuisance: dict[Annotated[str, Field(min_length=1)], _Estimate]
    camera_offset: Annotated[tuple[Number, Number], FromList]
    provenance: dict[Any, Any]
    sha256: Any = None

    def estimates(self) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
        """Physical parameters in the order of `THETA`, and nuisances."""
        theta = {key: getattr(self.theta, key).estimate() for key in THETA}
        return theta, {key: value.estimate() for key, value in self.nuisance.items()}


def to_document(twin: Twin, mesh: str, pusher_mesh: str | None) -> dict[str, Any]:
    """Plain data for `twin.yaml` in its order, with the meshes' names in the folder; not checked, no hashes."""
    shape = twin.pusher.shape
    return {
        "schema_version": SCHEMA_VERSION,
        "units": {"mass": "kg", **UNITS},
        "name": twin.name,
        "mesh": mesh,
        "pusher": {"mesh": pusher_mesh, "shape": None if shape is None else to_plain(asdict(shape))},
        "gravity": to_plain(twin.gravity),
        "floor": {"height": to_plain(twin.floor_height)},
        "acts_as": [to_plain({**asdict(one), "tolerance": one.tolerance}) for one in twin.acts_as],
        "physics": {"time_step": to_plain(twin.time_step), "support": twin.support},
        "theta": {key: _estimate(value) for key, value in twin.theta.items()},
        "nuisance": {key: _estimate(value) for key, value in twin.nuisance.items()},
        "camera_offset": to_plain(twin.camera_offset),
        "provenance": to_plain(twin.provenance),
    }


def _estimate(one: Estimate) -> dict[str, Any]:
    """Plain data of an estimate; .inf stays in an interval, where it has a meaning."""
    interval = None if one.interval is None else [float(end) for end in one.interval]
    return asdict(one) | {"value": float(one.value), "interval": interval, "identifiable": bool(one.identifiable)}


def read_document(entry: Entry) -> TwinDocument:
    """Check all of a `twin.yaml` but its hashes.

    Raises:
        InputError: A key is missing or unknown, or a value is of the wrong kind or out of range.
    """
    if isinstance(entry.value, dict) and isinstance(entry.value.get("physics"), dict):
        physics = entry["physics"].without("friction_directions", ROUND_CONE).value
        entry = Entry(entry.path, entry.place, entry.value | {"physics": physics})
    document = entry.read(TwinDocument)
    theta, _ = document.estimates()
    low, middle, high = sorted((theta[key].value, key) for key in _INERTIA)
    if low[0] + middle[0] < high[0] * (1.0 - _ROUNDING):
        allowed = f"at most {low[0] + middle[0]:g}, the sum of the other two moments"
        raise entry["theta"][high[1]]["value"].refusal(allowed)
    _require_plain(entry["provenance"])
    return document


def to_plain(value: object) -> Any:
    """Copy of some data in plain Python types.

    NumPy's numbers and arrays become numbers and lists, paths and keys that are numbers become text, and a number that
    is not finite becomes None. What has no plain form stays as it is.
    """
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, np.generic):
        return to_plain(value.item())
    if isinstance(value, Mapping):
        return {str(key) if isinstance(key, (int, float)) else key: to_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def _require_plain(entry: Entry) -> None:
    queue, count = [(entry, 0)], 0
    while queue:
        here, depth = queue.pop()
        value, count = here.value, count + 1
        if depth > _DEEPEST or count > _MOST:
            raise here.refusal(f"at most {_DEEPEST} levels and {_MOST} values", "data nested without end")
        if isinstance(value, dict):
            for key in value:
                if not isinstance(key, str) or not key:
                    raise here.refusal("keys that are text", f"the key {key!r}")
            queue += [(here[key], depth + 1) for key in value]
        elif isinstance(value, list) and value:
            queue += [(part, depth + 1) for part in here.items()]
        elif isinstance(value, float):
            here.number()
        elif not isinstance(value, (str, int, list, type(None))):  # a bool is an int
            raise here.refusal("text, finite numbers, true, false, null, lists and mappings")
