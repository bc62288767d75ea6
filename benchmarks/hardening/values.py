# SPDX-License-Identifier: MIT
"""What a reader returned, compared: a digest of all values, and the count of numbers that are not finite."""

import dataclasses
import hashlib
import math
from typing import Any

import numpy as np
import torch

_PLAIN = (type(None), bool, int, str, bytes)


def summary(value: object) -> tuple[str, int]:
    """Return SHA-256 of all plain values, arrays, tensors and fields within `value`, and how many are not finite."""
    digest, seen = hashlib.sha256(), set[int]()
    bad = 0
    stack: list[Any] = [value]
    while stack:
        one = stack.pop()
        if isinstance(one, torch.nn.Module):
            one = one.state_dict()
        if isinstance(one, torch.Tensor):
            one = one.detach().numpy()
        if isinstance(one, np.ndarray):
            bad += int((~np.isfinite(one)).sum()) if one.dtype.kind in "fc" else 0
            digest.update(f"{one.dtype} {one.shape}".encode() + np.ascontiguousarray(one).tobytes())
        elif isinstance(one, (float, np.generic)):
            bad += isinstance(one, float) and not math.isfinite(one)
            digest.update(repr(one).encode())
        elif isinstance(one, _PLAIN):
            digest.update(f"{one!r}".encode())
        elif id(one) not in seen:
            seen.add(id(one))
            digest.update(type(one).__name__.encode())
            stack += _parts(one)
    return digest.hexdigest(), bad


def _parts(value: Any) -> list[Any]:
    """Values within a value, in an order that depends on the value alone."""
    if isinstance(value, dict):
        return [part for item in sorted(value.items(), key=lambda item: str(item[0])) for part in item]
    if isinstance(value, (list, tuple)):
        return list(value)
    if dataclasses.is_dataclass(value):
        return [getattr(value, field.name) for field in dataclasses.fields(value)]
    return []
