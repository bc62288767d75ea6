# SPDX-License-Identifier: MIT
"""The kernels of contact geometry as Python calls them: each is compiled with all that it calls (numba).

The kernels themselves have no machine code of their own; they are parts of the steps that use them (see `jit`).
"""

from collections.abc import Callable
from typing import Any

from pinwm_drake.geometry import features
from pinwm_drake.geometry.contact import narrowphase
from pinwm_drake.jit import entry_point


def _entry(kernel: Any) -> Callable[..., Any]:
    return entry_point(getattr(kernel, "py_func", kernel))  # a plain function under NUMBA_DISABLE_JIT


collide_bodies, collide_floor = _entry(narrowphase.collide_bodies), _entry(narrowphase.collide_floor)
contact_from_features, contact_adjoint = _entry(features.contact_from_features), _entry(features.contact_adjoint)
tangents, tangents_adjoint = _entry(features.tangents), _entry(features.tangents_adjoint)
