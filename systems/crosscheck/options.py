# SPDX-License-Identifier: MIT
"""Requests of a cross-check: what `pinwm crosscheck` does. Light, as the command line reads it."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

from pydantic import Field

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, FLATTEN, LAB, argument, option, request

PLANTS = ("hydroelastic", "point")


@request
class CrossCheckOptions:
    """Options of a cross-check: engines, pushes, and thresholds of agreement.

    Raises:
        ParameterError: An option is out of range.
    """

    engines: Annotated[
        tuple[str, ...], option("Drake's contact model; repeat it.", "--engine", default="hydroelastic, point")
    ] = PLANTS
    pushes: Annotated[
        int, option("Number of random pushes, or of pokes for a flip.", group=BUDGET, ge=1, le=10_000)
    ] = 20
    processes: Annotated[int | None, Field(ge=1, le=64)] = 1
    threshold_translation: Annotated[
        float, option("Largest median difference of the resting position.", group=LAB, unit="m", gt=0, le=1)
    ] = 3e-3
    threshold_rotation: Annotated[
        float, option("Largest median difference of the resting orientation.", group=LAB, unit="deg", gt=0, le=180)
    ] = 2.0
    seed: Annotated[int, option("Seed of the pushes.", group=ADVANCED, ge=0, lt=2**63, allowed="0 or more")] = 0

    def __post_init__(self) -> None:
        """Check the names of the engines."""
        for name in self.engines:
            if name not in PLANTS:
                raise ParameterError(f"engine: got {name!r}; allowed: {', '.join(PLANTS)}")
        once = bool(self.engines) and len(set(self.engines)) == len(self.engines)
        require("engines", ", ".join(self.engines) or "none", once, "one or more, each once")

    @property
    def limits(self) -> tuple[float, float]:
        """Thresholds of translation [m] and rotation [rad]."""
        return self.threshold_translation, math.radians(self.threshold_rotation)


@request
class CrossCheckRequest:
    """Request of a cross-check of a twin with its files."""

    twin: Annotated[str, argument("Folder of a twin, or a .scenario.yaml file.", "TWIN", completes="scene")]
    more: Annotated[tuple[str, ...], argument("Further engines, as in --engine hydroelastic point.", "ENGINE")] = ()
    options: Annotated[CrossCheckOptions, FLATTEN] = dataclasses.field(default_factory=CrossCheckOptions)
    processes: Annotated[
        int | None, option("Processes that share the pushes.", group=BUDGET, default="one a core, within free memory")
    ] = None
    truth: Annotated[
        Path | None,
        option(
            "File ground_truth.yaml with the parameters of Drake's models.", group=DATA, default="those of the twin"
        ),
    ] = None
    out: Annotated[
        Path | None, option("Folder for crosscheck.csv and crosscheck.png.", "--out", "-o", result="inside")
    ] = None

    def resolved(self) -> CrossCheckOptions:
        """Options with all engines and the number of processes; None for one a core, within free memory."""
        engines = self.options.engines if self.options.engines != PLANTS or not self.more else ()
        return dataclasses.replace(self.options, engines=(*engines, *self.more), processes=self.processes)
