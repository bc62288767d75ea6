# SPDX-License-Identifier: MIT
"""Server of Meshcat, on this machine only unless told otherwise; recordings of its scene, and sliders for theta."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

from pinwm_drake.errors import InputError, ParameterError, require
from pinwm_drake.files import replacing

LOCALHOST = "localhost"
# Name in the page, lowest and highest value, step.
_SLIDERS = {
    "mass": ("mass [kg]", 0.01, 10.0, 0.01),
    "friction_floor": ("friction, floor", 0.0, 1.0, 0.001),
    "friction_pusher": ("friction, pusher", 0.0, 1.0, 0.001),
    "restitution": ("restitution", 0.0, 0.9, 0.01),
}


def make_meshcat(host: str = LOCALHOST, port: int | None = None) -> Meshcat:
    """Start Meshcat's server; it ends with the last reference to the object.

    Args:
        host: Address or name of the interface to listen on; "*" for every one of the machine.
        port: Port to listen on; None for the first one that is free from 7000 on.

    Returns:
        The server; `web_url()` is the address of its page.

    Raises:
        ParameterError: The address cannot be listened on, or the port is taken or out of range.
    """
    allowed = "an address of this machine and a free port, 1024 or more"
    require("host, port", f"{host}, {port}", port is None or 1024 <= port <= 65535, allowed)
    log = logging.getLogger("drake")
    before = log.level
    log.setLevel(logging.WARNING)  # it tells the address, which callers do where it matters
    try:
        return Meshcat(MeshcatParams(host=host, port=port, show_stats_plot=False))
    except RuntimeError as error:
        raise ParameterError(f"host, port: got {host}, {port} ({error}); allowed: {allowed}") from error
    finally:
        log.setLevel(before)


@contextmanager
def recorded(meshcat: Meshcat, path: Path, frames_per_second: float = 30.0) -> Iterator[None]:
    """Record the publishes of a simulation in the block, and write them as one HTML file that needs no server.

    The page is as it is, without the sliders.

    Args:
        meshcat: The server.
        path: The file; its folder exists.
        frames_per_second: Frames for each second of simulated time. Between frames the page interpolates.

    Raises:
        InputError: The file cannot be written.
    """
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    meshcat.DeleteRecording()
    meshcat.StartRecording(frames_per_second)
    try:
        yield
    finally:
        meshcat.StopRecording()
    meshcat.PublishRecording()
    with replacing(path) as partial:
        partial.write_text(str(meshcat.StaticHtml()), encoding="utf-8")


def AddThetaSliders(meshcat: Meshcat, theta: Mapping[str, float]) -> None:
    """Add a slider for each parameter, or set those that are there.

    Args:
        meshcat: The server.
        theta: Some of mass [kg], friction_floor, friction_pusher and restitution. A slider rounds to its step, 0.001
            of a friction and 0.01 of the others, and takes no value beyond its ends.

    Raises:
        ParameterError: There is no slider for a name.
    """
    unknown = [name for name in theta if name not in _SLIDERS]
    require("theta", ", ".join(map(repr, unknown)), not unknown, ", ".join(_SLIDERS))
    there = meshcat.GetSliderNames()
    for name, value in theta.items():
        label, low, high, step = _SLIDERS[name]
        if label in there:
            meshcat.SetSliderValue(label, float(value))
        else:
            meshcat.AddSlider(label, low, high, step, float(value))


def ReadThetaSliders(meshcat: Meshcat) -> dict[str, float]:
    """Values of the sliders that `AddThetaSliders` added, by the same names."""
    there = meshcat.GetSliderNames()
    return {name: meshcat.GetSliderValue(label) for name, (label, *_) in _SLIDERS.items() if label in there}
