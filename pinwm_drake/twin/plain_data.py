"""Plain data, as YAML and JSON hold them, of which provenance is made."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.documents import Entry

_DEEPEST = 32
_MOST = 100_000  # values; more than that is no provenance but a bomb of YAML aliases


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


def read_plain(entry: Entry) -> None:
    """Requires plain data.

    Raises:
        InputError: It holds a number that is not finite, a key that is no text, anything that is not plain, more
            than 32 levels, or itself.
    """
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
