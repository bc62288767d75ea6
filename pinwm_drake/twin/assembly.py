"""Assembly of a twin from a capture and what was found about its object."""

from collections.abc import Mapping
from typing import Any

from pinwm_drake.capture.scene import Capture
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.twin.twin import Draws, Estimate, Twin


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
    )
