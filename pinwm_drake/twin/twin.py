# SPDX-License-Identifier: MIT
"""Twin of an object: geometry, physical parameters with their uncertainty, appearance, and provenance."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.capture.scene import Capture, PusherGeometry
from pinwm_drake.errors import require
from pinwm_drake.geometry.primitive import Primitive
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import Support

SCHEMA_VERSION = 1
TWIN_FILE = "twin.yaml"
SURFELS_FILE = "surfels.ply"
DRAWS_FILE = "draws.npz"

# The physical parameters of a twin, and their units. The moments of inertia are about the centre of mass, along the
# axes of O; the products of inertia are those of the mesh, scaled.
THETA = {
    "mass": "kg",
    "inertia_xx": "kg m^2",
    "inertia_yy": "kg m^2",
    "inertia_zz": "kg m^2",
    "friction_floor": "1",
    "friction_pusher": "1",
    "restitution_floor": "1",
    "restitution_pusher": "1",
}


@dataclass(frozen=True)
class Estimate:
    """Number that was estimated or assumed, with its uncertainty.

    Attributes:
        value: The number, in `unit`.
        interval: Low and high end of its 95 % interval; an end may be infinite. None where none was computed.
        identifiable: Whether the data determine it.
        unit: Unit of the number: that of `THETA` for a physical parameter; free for a nuisance.
        note: Anything to know about it.
    """

    value: float
    interval: tuple[float, float] | None
    identifiable: bool
    unit: str
    note: str = ""


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws from the joint posterior of what belongs to an object: theta, and nuisances that are not of one push."""

    names: list[str]  # of the p quantities, in the units of the estimates of these names
    values: np.ndarray  # (N, p)

    def column(self, name: str) -> np.ndarray:
        """Values (N,) of a quantity."""
        return np.asarray(self.values[:, self.names.index(name)])

    def rows(self, number: int) -> np.ndarray:
        """Rows (m,) of at most so many draws, evenly spaced."""
        return np.linspace(0, len(self.values) - 1, min(number, len(self.values))).round().astype(int)


@dataclass(frozen=True, eq=False)
class Twin:
    """A calibrated twin of one object and of the pusher that pushed it.

    Attributes:
        name: Name of the object.
        mesh_path: The object's mesh, metres, frame O.
        pusher: The pusher's geometry, frame P.
        gravity: Downwards [m/s^2].
        floor_height: z of the floor in the world as the physics uses it [m]: the capture's, plus the lift.
        time_step: Time step of the physics [s].
        support: Points that touch the floor: the mesh's corners, or points of its patch.
        theta: The physical parameters; exactly the keys of `THETA`.
        nuisance: Other estimates. Spread of the pressure, centre of mass, contact offset and lift are of the object,
            start poses, clocks and outlines of the identified pushes.
        camera_offset: Offset to add to cx and cy of the capture's cameras [px].
        surfels: Appearance of the object, frame O.
        provenance: Plain data: capture, its SHA-256, episodes, versions, seeds, losses, timings, options.
        draws: Draws from the posterior; None where there are none.
        acts_as: Primitives with which the object touches, frame O; none for its mesh.
    """

    name: str
    mesh_path: Path
    pusher: PusherGeometry
    gravity: float
    floor_height: float
    time_step: float
    support: Support
    theta: dict[str, Estimate]
    nuisance: dict[str, Estimate]
    camera_offset: tuple[float, float]
    surfels: Surfels
    provenance: dict[str, Any]
    draws: Draws | None = None
    acts_as: tuple[Primitive, ...] = ()

    def with_theta(self, **values: float) -> "Twin":
        """Return the twin with other values of some of `THETA`'s parameters, such as friction_floor=0.1.

        A mass without moments of inertia scales these too: the object keeps its shape. The values have no intervals,
        and the twin has no draws any more.

        Args:
            values: Values by name, in SI units.

        Raises:
            ParameterError: There is no such parameter.
        """
        for name in values:
            require("theta", repr(name), name in THETA, ", ".join(THETA))
        theta, moments = dict(self.theta), [name for name in THETA if name.startswith("inertia")]
        if "mass" in values and not any(name in values for name in moments):
            scale = values["mass"] / theta["mass"].value
            values |= {name: scale * theta[name].value for name in moments}
        for name, value in values.items():
            theta[name] = replace(theta[name], value=float(value), interval=None)
        return replace(self, theta=theta, draws=None if values else self.draws)


def assemble_twin(
    capture: Capture,
    surfels: Surfels,
    camera_offset: tuple[float, float],
    theta: Mapping[str, Estimate],
    nuisance: Mapping[str, Estimate],
    provenance: Mapping[str, Any],
    *,
    lift: float,
    time_step: float,
    draws: Draws | None = None,
    acts_as: tuple[Primitive, ...] = (),
) -> Twin:
    """Twin of a capture's object, whose weight a patch of the floor carries.

    Args:
        capture: Names, meshes, floor and gravity.
        surfels: The object's appearance, frame O.
        camera_offset: px, added to the principal points of the capture's cameras.
        theta: Estimates with the keys of `THETA`.
        nuisance: Other estimates, by name.
        provenance: Plain data.
        lift: Height of the floor over the one that the capture says, m.
        time_step: Time step of the physics that theta was found with, s.
        draws: Draws from the posterior; None where there are none.
        acts_as: Primitives that the physics had in the place of the mesh.
    """
    return Twin(
        name=capture.object.name,
        mesh_path=capture.object.mesh_path,
        pusher=capture.pusher,
        gravity=capture.gravity,
        floor_height=capture.floor_height + lift,
        time_step=time_step,
        support="patch",
        theta=dict(theta),
        nuisance=dict(nuisance),
        camera_offset=camera_offset,
        surfels=surfels,
        provenance=dict(provenance),
        draws=draws,
        acts_as=acts_as,
    )
