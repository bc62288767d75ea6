# SPDX-License-Identifier: MIT
"""Registry of policy formats of other methods: entry points in the group "pinwm_drake.policies".

The name of an entry point is the file that tells such a policy's folder from others; it loads a `PolicyFormat`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from pinwm_drake.learning.evaluation import Acts
from pinwm_drake.learning.spec import PolicySpec

GROUP = "pinwm_drake.policies"


class OtherPolicy(Acts, Protocol):
    """Policy of another method."""

    @property
    def spec(self) -> PolicySpec:
        """Specification of its inputs and outputs."""

    @property
    def provenance(self) -> dict[str, Any]:
        """Origin as plain data."""


@dataclass(frozen=True)
class PolicyFormat:
    """Folder format of the policies of a method.

    Attributes:
        weights: Name of the file of weights, which tells two policies apart together with the document.
        read: Reads such a folder; raises PinwmError where it cannot.
    """

    weights: str
    read: Callable[[Path], OtherPolicy]


def find_format(folder: Path) -> tuple[Path, PolicyFormat] | None:
    """Document of a policy of another method, and its format; None where a folder holds none that is registered."""
    for point in entry_points(group=GROUP):
        if (folder / point.name).is_file():
            return folder / point.name, point.load()
    return None
