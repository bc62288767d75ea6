# SPDX-License-Identifier: MIT
"""Budgets of the main demonstration."""

from dataclasses import dataclass, field
from pathlib import Path

from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.models import model_path
from pinwm_drake.rendering.fit_options import FitOptions

# Fewer pixels than the defaults are made for need fewer surfels and steps.
_FIT = FitOptions(iterations=1500, max_surfels=2500, sh_every=400)
_IDENTIFY = IdentifyOptions()


def shipped_capture() -> Path:
    """Return the folder of the capture that ships with the project."""
    return model_path("captures/t_block/capture.yaml").parent


@dataclass(frozen=True)
class DemoOptions:
    """Inputs and budgets of the main demonstration.

    Attributes:
        capture: A capture of two episodes: the first is identified, the second predicted.
        fit: Of the surfels.
        identify: Of the twin's parameters.
        policy: Name of a bundle that ships.
        scene: Name of the scenario in which the policy meets the hydroelastic plant.
        seed: Of the start of the policy's episode.
        max_steps: Actions of it at most; None for the policy's own limit.
    """

    capture: Path = field(default_factory=shipped_capture)
    fit: FitOptions = _FIT
    identify: IdentifyOptions = _IDENTIFY
    policy: str = "push_t"
    scene: str = "push_t"
    seed: int = 0
    max_steps: int | None = None
