"""Sliders for theta in Meshcat's panel."""

from collections.abc import Mapping

from pydrake.geometry import Meshcat

from pinwm_drake.errors import ParameterError

# Name in the page, lowest and highest value, step.
_SLIDERS = {
    "mass": ("mass [kg]", 0.01, 10.0, 0.01),
    "friction_floor": ("friction, floor", 0.0, 1.0, 0.001),
    "friction_pusher": ("friction, pusher", 0.0, 1.0, 0.001),
    "restitution": ("restitution", 0.0, 0.9, 0.01),
}


def AddThetaSliders(meshcat: Meshcat, theta: Mapping[str, float]) -> None:
    """Adds a slider for each parameter, or sets those that are there.

    Args:
        meshcat: The server.
        theta: Some of mass [kg], friction_floor, friction_pusher and restitution. A slider rounds to its step, 0.001
            of a friction and 0.01 of the others, and takes no value beyond its ends.

    Raises:
        ParameterError: There is no slider for a name.
    """
    unknown = [name for name in theta if name not in _SLIDERS]
    if unknown:
        raise ParameterError(f"theta: got {', '.join(map(repr, unknown))}; allowed: {', '.join(_SLIDERS)}")
    there = meshcat.GetSliderNames()
    for name, value in theta.items():
        label, low, high, step = _SLIDERS[name]
        if label in there:
            meshcat.SetSliderValue(label, float(value))
        else:
            meshcat.AddSlider(label, low, high, step, float(value))


def ReadThetaSliders(meshcat: Meshcat) -> dict[str, float]:
    """The values of the sliders that `AddThetaSliders` added, by the same names."""
    there = meshcat.GetSliderNames()
    return {name: meshcat.GetSliderValue(label) for name, (label, *_) in _SLIDERS.items() if label in there}
