"""Check of a document against dataclasses whose fields carry bounds; every message names file, key and value."""

import dataclasses
import types
from typing import Any, Union, get_args, get_origin, get_type_hints

from pinwm_drake.documents import Entry
from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.registry import task_from_document

# Keys of ranges [low, high] to draw from; low must not be above high.
_RANGES = ("x", "y", "yaw", "pusher_angle", "pusher_gap")


def check_scenario(entry: Entry, schema: type) -> None:
    """Requires that a document fits `Scenario`.

    Args:
        entry: The whole document.
        schema: The class `Scenario`, which imports this module.

    Raises:
        InputError: A key is unknown, or a value is of the wrong kind, in another unit or out of range.
    """
    _check(entry, schema)
    if ("object" in entry.value and entry["object"].value is not None) == _given(entry, "twin"):
        raise entry.refusal("either an object or a twin", found="both" if _given(entry, "twin") else "neither")
    if _given(entry, "twin") and _given(entry, "theta"):
        raise entry["theta"].refusal("null or nothing beside a twin, which has its own")
    task = entry.find("task")
    if task is not None:
        _check_task(task)
    for key, check in (("pusher", _check_pusher), ("camera", _check_camera), ("start", _check_start)):
        found = entry.find(key)
        if found is not None:
            check(found, getattr(schema(), key))


def _check_task(task: Entry) -> None:
    try:
        task_from_document(task.value)
    except ParameterError as error:
        raise task.refusal(str(error)) from error


def _check_pusher(pusher: Entry, default: Any) -> None:
    shape = pusher.find("shape")
    if shape is not None and shape.value is not None:
        long, length = shape.find("kind"), shape.find("length")
        sphere = long is None or long.value == "sphere"
        value = 0.0 if length is None else length.number()
        if sphere != (value == 0):
            raise (length or shape).refusal("a length of 0 for a sphere, and above 0 for a capsule or a cylinder")
    low, high = _or_default(pusher, "low", default), _or_default(pusher, "high", default)
    if not (low.numbers(3) < high.numbers(3)).all():
        raise low.refusal(f"below `high`, {high.value}, along every axis")


def _check_camera(camera: Entry, default: Any) -> None:
    p_WC, p_WT = _or_default(camera, "p_WC", default), _or_default(camera, "p_WT", default)
    if not (p_WC.numbers(3) != p_WT.numbers(3))[:2].any():
        raise p_WT.refusal("a point that is not right above or below `p_WC`")


def _check_start(start: Entry, default: Any) -> None:
    for key in _RANGES:
        given = start.find(key)
        if given is not None and given.numbers(2)[0] > given.numbers(2)[1]:
            raise given.refusal("[low, high] with low at most high")
    q_WO = start.find("q_WO")
    if q_WO is not None and abs(float((q_WO.numbers(4) ** 2).sum()) - 1) > 1e-3:
        raise q_WO.refusal("a quaternion wxyz of unit norm")
    axis = start.find("roll_axis")
    if axis is not None and not (axis.numbers(3) != 0.0).any():
        raise axis.refusal("an axis that is not zero")


def _or_default(entry: Entry, key: str, default: Any) -> Entry:
    """Entry under a key, or one of the default value where there is none."""
    return entry.find(key) or Entry(entry.path, f"{entry.place}.{key}", getattr(default, key))


def _given(entry: Entry, key: str) -> bool:
    found = entry.find(key)
    return found is not None and found.value is not None


def _check(entry: Entry, schema: type) -> None:
    """Requires the keys and kinds of a dataclass."""
    hints = get_type_hints(schema)
    fields = {item.name: item for item in dataclasses.fields(schema)}
    entry.only(*fields)
    for name, item in fields.items():
        found = entry.find(name)
        if found is not None:
            _check_value(found, hints[name], item.metadata)


def _check_value(entry: Entry, kind: Any, about: Any) -> None:
    """Requires that a value is of a field's kind and within its bounds."""
    if get_origin(kind) in (types.UnionType, Union):
        if entry.value is None:
            return
        kind = next(arg for arg in get_args(kind) if arg is not types.NoneType)
    if get_origin(kind) is dict:
        return  # a task, which `_check_task` looks at
    if dataclasses.is_dataclass(kind):
        _check(entry, kind)  # type: ignore[arg-type]  # a class, as the fields say
    elif kind is str:
        text = entry.text()
        if "allowed" in about and text not in about["allowed"]:
            raise entry.refusal(", ".join(about["allowed"]))
    elif kind is int:
        entry.integer(about["low"], about["high"])
    elif kind is float:
        _check_number(entry, about)
    else:
        entry.numbers(about["length"])
        for number in entry.items():
            _check_number(number, about)


def _check_number(entry: Entry, about: Any) -> None:
    value = entry.value
    low, high, unit = about["low"], about["high"], about["unit"]
    words = f"a number from {low:g} to {high:g}" + ("" if unit == "1" else f" [{unit}]")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise entry.refusal(words)
