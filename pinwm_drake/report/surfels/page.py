"""Web page that shows surfels: one file, nothing loaded from anywhere, turned with the mouse."""

import base64
import html
import json
from pathlib import Path

import numpy as np

from pinwm_drake.files import replacing
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.orbit import AZIMUTH, ELEVATION, FIELD_OF_VIEW, Orbit

_TEMPLATE = Path(__file__).with_name("page.html")


def write_surfel_page(path: Path, surfels: Surfels, *, title: str, up: np.ndarray | None = None) -> None:
    """Writes a page that renders surfels as `rendering.render` does, in the browser.

    Args:
        path: File of the page; its folder exists.
        surfels: Surfels, one or more, with one set of colours.
        title: Stands in the page.
        up: (3,), object frame; None for z.

    Raises:
        InputError: The file cannot be written.
        RenderingError: There are no surfels.
    """
    with replacing(path) as temporary:
        temporary.write_text(_page(surfels, title, Orbit.around(surfels, up)), encoding="utf-8")


def _page(surfels: Surfels, title: str, orbit: Orbit) -> str:
    """Text of the page, in HTML."""
    scene = {
        "count": surfels.num_surfels,
        "coefficients": int(surfels.sh.shape[-2]),
        "target": orbit.target.tolist(),
        "axes": orbit.axes().tolist(),
        "distance": orbit.distance,
        "azimuth": AZIMUTH,
        "elevation": ELEVATION,
        "fieldOfView": FIELD_OF_VIEW,
        # p_OS, q_OS, log_scale, logit_opacity and sh, one after the other.
        "data": base64.b64encode(
            b"".join(_bytes(value.detach().numpy()) for value in surfels.tensors().values())
        ).decode(),
    }
    page = _TEMPLATE.read_text(encoding="utf-8")
    return page.replace("{{scene}}", json.dumps(scene)).replace("{{title}}", html.escape(title))


def _bytes(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values, "<f4").tobytes()
