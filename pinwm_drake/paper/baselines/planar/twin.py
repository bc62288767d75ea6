"""Twin with what an identification in the plane found; the rest is the prior of an identification from images."""

from collections.abc import Sequence

import numpy as np

from pinwm_drake.capture.episodes import Episode
from pinwm_drake.capture.scene import Capture
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.unknowns import UNKNOWNS
from pinwm_drake.paper.baselines.planar.body import PlanarBody
from pinwm_drake.paper.baselines.planar.identify import PlanarProperties
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.origin import Origin, registration_entry, seen_in
from pinwm_drake.twin.twin import THETA, Estimate, Twin, assemble_twin

_HELD, _SCALED = "held", "of the mesh, scaled by what was found about the vertical"


def planar_twin(
    found: PlanarProperties,
    body: PlanarBody,
    capture: Capture,
    episodes: Sequence[Episode],
    surfels: Surfels,
    camera_offset: tuple[float, float],
    *,
    X_OS: Pose | None = None,
) -> Twin:
    """Twin of an object whose properties were found in the plane.

    Moments of inertia are those of a uniform solid, all scaled alike so that the one about the vertical is as found;
    the centre of mass moves in the plane only. No intervals are known.

    Args:
        found: The properties.
        body: Geometry with which they were found.
        capture: Object, pusher, floor and gravity.
        episodes: The pushes that they were found from.
        surfels: The object's appearance, frame O.
        camera_offset: px, of the principal points of the capture's cameras.
        X_OS: Where the static views have the object, against the pose in `capture.yaml`; None for the latter.

    Returns:
        The twin; its provenance lacks entries that only the caller knows, such as the command.

    Raises:
        InputError: A file of the capture cannot be read.
    """
    solid = mass_properties(load_mesh(capture.object.mesh_path), mass=1.0)
    up = body.R_QO[2]
    moments = solid.inertia.diagonal() * found.inertia / float(up @ solid.inertia @ up)
    moved = np.array([*found.center, 0.0]) - body.R_QO @ solid.p_com * np.array([1.0, 1.0, 0.0])
    values = {
        "mass": found.mass,
        **{f"inertia_{axis * 2}": float(moment) for axis, moment in zip("xyz", moments, strict=True)},
        "friction_floor": found.friction_floor,
        "friction_pusher": found.friction_pusher,
    }
    theta = {}
    for key, unit in THETA.items():
        free = key.startswith("friction")
        note = "" if free else _SCALED if key.startswith("inertia") else _HELD
        value = values[key] if key in values else UNKNOWNS[key].nominal
        theta[key] = Estimate(value, None, free, unit, note)
    center = {
        f"center_{axis}": Estimate(float(value), None, True, "m")
        for axis, value in zip("xyz", body.R_QO.T @ moved, strict=True)
    }
    seen = capture if X_OS is None else seen_in(capture, X_OS)
    return assemble_twin(
        capture,
        surfels,
        camera_offset,
        theta,
        center,
        {
            **Origin.of(capture, episodes).to_provenance(),
            **registration_entry(capture.object.X_WO, seen.object.X_WO),
            "method": "2d-physics",
        },
        lift=0.0,
        time_step=IdentifyOptions().time_step,
    )
