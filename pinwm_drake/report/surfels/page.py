# SPDX-License-Identifier: MIT
"""Web page that shows surfels: one file, nothing loaded from anywhere, turned with the mouse."""

import base64
from pathlib import Path

import numpy as np

from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.orbit import AZIMUTH, ELEVATION, FIELD_OF_VIEW, Orbit
from pinwm_drake.report.page import write_page


def write_surfel_page(path: Path, surfels: Surfels, *, title: str, up: np.ndarray | None = None) -> None:
    """Write a page that renders surfels as `rendering.render` does, in the browser.

    Args:
        path: File of the page; its folder exists.
        surfels: Surfels, one or more, with one set of colours.
        title: Stands in the page.
        up: (3,), object frame; None for z.

    Raises:
        InputError: The file cannot be written.
        RenderingError: There are no surfels.
    """
    orbit = Orbit.around(surfels, up)
    # p_OS, q_OS, log_scale, logit_opacity and sh, one after the other.
    arrays = [np.ascontiguousarray(value.detach().numpy(), "<f4") for value in surfels.tensors().values()]
    scene = {
        "count": surfels.num_surfels,
        "coefficients": int(surfels.sh.shape[-2]),
        "target": orbit.target.tolist(),
        "axes": orbit.axes().tolist(),
        "distance": orbit.distance,
        "azimuth": AZIMUTH,
        "elevation": ELEVATION,
        "fieldOfView": FIELD_OF_VIEW,
        "data": base64.b64encode(b"".join(array.tobytes() for array in arrays)).decode(),
    }
    write_page(path, "report/surfels/page.html", title=title, scene=scene)
