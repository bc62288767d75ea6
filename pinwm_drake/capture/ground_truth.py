# SPDX-License-Identifier: MIT
"""True parameters of a simulated capture, by which an identification is scored and which it never sees."""

from pathlib import Path

import numpy as np

from pinwm_drake.documents import yaml_text
from pinwm_drake.files import replacing

GROUND_TRUTH_FILE = "ground_truth.yaml"
_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def write_ground_truth(
    folder: Path, *, mass: float, inertia: np.ndarray, friction_floor: float, friction_pusher: float, restitution: float
) -> None:
    """Write the true parameters of a capture into its `ground_truth.yaml`.

    Args:
        folder: The capture.
        mass: kg.
        inertia: (3, 3) kg m^2, about the centre of mass, axes of O.
        friction_floor: Coulomb coefficient of the pair object and floor.
        friction_pusher: Coulomb coefficient of the pair object and pusher.
        restitution: Coefficient of restitution of both pairs.

    Raises:
        InputError: The file cannot be written.
    """
    truth = {
        "mass": mass,
        # Rounded: what is 0 is written as 0.
        **{f"inertia_{'xyz'[i]}{'xyz'[j]}": round(float(inertia[i, j]), 15) + 0.0 for i, j in _ENTRIES},
        "friction_floor": friction_floor,
        "friction_pusher": friction_pusher,
        "restitution": restitution,
    }
    with replacing(folder / GROUND_TRUTH_FILE) as temporary:
        text = "# SI units; inertia about the centre of mass, axes of O. To score with, not to fit.\n"
        temporary.write_text(text + yaml_text(truth), encoding="utf-8")
