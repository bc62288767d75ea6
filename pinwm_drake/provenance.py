# SPDX-License-Identifier: MIT
"""Provenance of a result: the time at which it was made, and the versions of the libraries."""

import platform
import time
from collections.abc import Sequence
from importlib.metadata import version

import pinwm_drake

_LIBRARIES = ("numba", "numpy", "torch")


def timestamp() -> str:
    """Present time, UTC, as ISO 8601."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def versions(libraries: Sequence[str] = _LIBRARIES) -> dict[str, str]:
    """Return the versions of this package, of Python and of the libraries that results depend on."""
    return {
        "pinwm_drake": pinwm_drake.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in libraries},
    }
