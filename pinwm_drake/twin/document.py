"""Document of a twin, `twin.yaml`: every key and number of it, checked, and its form on disk."""

from dataclasses import dataclass
from typing import Any

from pinwm_drake.capture.scene import PusherShape, read_floor, read_gravity, read_shape
from pinwm_drake.documents import ROUND_CONE, Entry
from pinwm_drake.scene import Support
from pinwm_drake.twin.estimates import estimate_to_document, read_nuisance, read_theta
from pinwm_drake.twin.plain_data import read_plain, to_plain
from pinwm_drake.twin.twin import SCHEMA_VERSION, Twin

_UNITS = {"mass": "kg", "length": "m", "angle": "rad", "time": "s"}
_KEYS = ("schema_version", "units", "name", "mesh", "pusher", "gravity", "floor", "physics")
_LATER_KEYS = ("theta", "nuisance", "camera_offset", "provenance")
_LONGEST_STEP = 0.1  # s


@dataclass(frozen=True)
class Document:
    """Contents of `twin.yaml`, checked.

    Attributes:
        mesh: The name of the object's mesh file in the folder.
        pusher_mesh: The name of the pusher's mesh file in the folder, or None.
        pusher_shape: The pusher's shape, or None.
        values: The fields of `Twin` that need no other file.
    """

    mesh: Entry
    pusher_mesh: Entry | None
    pusher_shape: PusherShape | None
    values: dict[str, Any]


def to_document(twin: Twin, mesh: str, pusher_mesh: str | None) -> dict[str, Any]:
    """The plain data of a twin, without the hashes.

    Args:
        twin: The twin.
        mesh: Name of the object's mesh in the folder.
        pusher_mesh: Name of the pusher's, or None where it has none.

    Returns:
        What `twin.yaml` is to hold, in its order; not checked.
    """
    shape = twin.pusher.shape
    pusher = None if shape is None else {"kind": shape.kind, "radius": shape.radius, "length": shape.length}
    return {
        "schema_version": SCHEMA_VERSION,
        "units": dict(_UNITS),
        "name": twin.name,
        "mesh": mesh,
        "pusher": {"mesh": pusher_mesh, "shape": to_plain(pusher)},
        "gravity": to_plain(twin.gravity),
        "floor": {"height": to_plain(twin.floor_height)},
        "physics": {"time_step": to_plain(twin.time_step), "support": twin.support},
        "theta": {key: estimate_to_document(value) for key, value in twin.theta.items()},
        "nuisance": {key: estimate_to_document(value) for key, value in twin.nuisance.items()},
        "camera_offset": to_plain(twin.camera_offset),
        "provenance": to_plain(twin.provenance),
    }


def read_document(entry: Entry) -> Document:
    """Checks all of a `twin.yaml` but its hashes.

    Args:
        entry: The whole document.

    Returns:
        Its contents.

    Raises:
        InputError: A key is missing or unknown, or a value is of the wrong kind or out of range.
    """
    version = entry["schema_version"]
    if version.value != SCHEMA_VERSION or isinstance(version.value, bool):
        raise version.refusal(f"{SCHEMA_VERSION}, the version that this release reads")
    entry.only(*_KEYS, *_LATER_KEYS, "sha256")
    entry["units"].only(*_UNITS)
    for name, unit in _UNITS.items():
        if entry["units"][name].value != unit:
            raise entry["units"][name].refusal(unit)
    pusher = entry["pusher"]
    pusher.only("mesh", "shape")
    mesh, shape = (None if pusher[key].value is None else pusher[key] for key in ("mesh", "shape"))
    if mesh is None and shape is None:
        raise pusher.refusal("a mesh or a shape")
    values = {
        "name": entry["name"].text(),
        "gravity": read_gravity(entry["gravity"]),
        "floor_height": read_floor(entry["floor"]),
        **_read_physics(entry["physics"]),
        "theta": read_theta(entry["theta"]),
        "nuisance": read_nuisance(entry["nuisance"]),
        "camera_offset": tuple(entry["camera_offset"].numbers(2).tolist()),
        "provenance": read_plain(entry["provenance"]),
    }
    return Document(
        mesh=entry["mesh"],
        pusher_mesh=mesh,
        pusher_shape=None if shape is None else read_shape(shape),
        values=values,
    )


def _read_physics(entry: Entry) -> dict[str, Any]:
    """The settings of the physics."""
    entry = entry.without("friction_directions", ROUND_CONE)
    entry.only("time_step", "support")
    step = entry["time_step"]
    if step.number(0.0, _LONGEST_STEP) == 0.0:
        raise step.refusal(f"above 0, up to {_LONGEST_STEP:g} s")
    return {"time_step": step.number(), "support": _read_support(entry["support"])}


def _read_support(entry: Entry) -> Support:
    if entry.value == "corners":
        return "corners"
    if entry.value == "patch":
        return "patch"
    raise entry.refusal("corners or patch")
