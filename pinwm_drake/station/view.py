# SPDX-License-Identifier: MIT
"""View of a policy: a pinhole at the camera's own place that looks at a point, without roll or distortion."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.capture.remap import Remap
from pinwm_drake.errors import ParameterError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rigid import apply, from_pose, inverse, rigid, to_pose
from pinwm_drake.station.document import Station
from pinwm_drake.station.lab import ViewDocument

SIZE = (64, 64)  # px, of a view that nobody asked for
_MARGIN = 1.05  # around the workspace in such a view
_WIDEST = 2.6  # rad


@dataclass(frozen=True, eq=False)
class View:
    """View at the camera's place.

    Attributes:
        camera: Pinhole with square pixels.
        X_WV: Its pose, OpenCV axes, q (4,), p (3,) [m].
        remap: Map that turns images of the station's camera into images of the view.
    """

    camera: Camera
    X_WV: Pose
    remap: Remap


def look_at(p_WC: np.ndarray, p_WT: np.ndarray) -> np.ndarray:
    """Pose X_WV (4, 4) of a camera at p_WC (3,) [m] that looks at p_WT (3,) [m] with z of W upwards in the image.

    Raises:
        ParameterError: It would look straight up or down, or at its own place.
    """
    z = np.asarray(p_WT, float) - p_WC
    x = np.cross(z, [0.0, 0.0, 1.0])
    if np.linalg.norm(x) < 1e-3 * max(float(np.linalg.norm(z)), 1e-9):
        raise ParameterError(f"view: got a camera at {list(p_WC)} that looks straight at {list(p_WT)}; allowed: aslant")
    X, x, z = rigid(p_WC), x / np.linalg.norm(x), z / np.linalg.norm(z)
    X[:3, :3] = np.stack([x, np.cross(z, x), z], 1)
    return X


def view_of(station: Station) -> View:
    """View of a station with a fixed camera.

    Raises:
        InputError: The camera is in the hand.
        ParameterError: The station has no view.
    """
    about = station.document.view
    if about is None:
        raise ParameterError(f"{station.path}: no view; allowed: p_WT, fov_y and size under view")
    X_WC = from_pose(station.X_WC)
    X_WV = look_at(X_WC[:3, 3], np.array(about.p_WT))
    camera = Camera.from_field_of_view(*about.size, about.fov_y)
    return View(camera, to_pose(X_WV), Remap(station.lens, camera, X_WC[:3, :3].T @ X_WV[:3, :3]))


def view_around(p_WC: np.ndarray, p_W: np.ndarray, target: np.ndarray) -> ViewDocument:
    """View of default size that shows all points.

    Args:
        p_WC: (3,) m, place of the camera.
        p_W: (N, 3) m, the points.
        target: (3,) m, point that is looked at.
    """
    p_V = apply(inverse(look_at(p_WC, target)), p_W)
    ahead = p_V[p_V[:, 2] > 1e-3]
    half = float(np.abs(ahead[:, :2] / ahead[:, 2:]).max(initial=1e-2))
    x, y, z = target
    fov_y = min(2.0 * float(np.arctan(_MARGIN * half)), _WIDEST)
    return ViewDocument(p_WT=(float(x), float(y), float(z)), fov_y=round(fov_y, 4), size=SIZE)
