"""The setup of a cross-check, from a twin's folder or from a scenario."""

import math
from pathlib import Path

from pinwm_drake.capture.scene import read_capture
from pinwm_drake.errors import InputError
from pinwm_drake.systems.scenario import Scenario, Start, load_scenario
from pinwm_drake.systems.setup import Setup, make_setup
from pinwm_drake.twin import Twin, read_twin
from pinwm_drake.twin.origin import Origin

_AROUND = [-0.02, 0.02]  # m, of the origin
_ANY_YAW = [-math.pi, math.pi]


def read_setup(path: str) -> Setup:
    """Reads what is to be cross-checked.

    Args:
        path: The folder of a twin, or a scenario: a file, or a `package://pinwm_models/` URL of one.

    Returns:
        The setup. Of a twin's folder: the object lies as in the capture that it was identified from, or as its mesh
        does where that is gone, at a random yaw.

    Raises:
        InputError: There is nothing of that kind, or a file of it cannot be used.
        ParameterError: Periods and time steps of the scenario do not divide each other.
    """
    folder = Path(path)
    if folder.is_dir():
        twin = read_twin(folder)
        start = Start(x=_AROUND, y=_AROUND, yaw=_ANY_YAW, q_WO=_lies(twin))
        return make_setup(Scenario(name=twin.name, twin=path, start=start))
    if not path.startswith("package://") and not folder.is_file():
        raise InputError(path, value="nothing", allowed="the folder of a twin, or a .scenario.yaml file")
    return make_setup(load_scenario(path))


def _lies(twin: Twin) -> list[float]:
    """q_WO wxyz of the capture that a twin is from."""
    origin = Origin.read(twin)
    if origin is not None:
        try:
            return [float(value) for value in read_capture(origin.path).object.X_WO.q]
        except InputError:  # moved, or changed
            pass
    return [1.0, 0.0, 0.0, 0.0]
