# SPDX-License-Identifier: MIT
"""Pictures that stay in their place on Meshcat's page, whatever its camera looks at."""

import math

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from pinwm_drake.report.gltf import rectangle
from pinwm_drake.systems.view.sheets import show_sheets

CAMERA = "/Cameras/default/rotated/<object>"
FIELD_OF_VIEW = math.radians(75.0)  # of the page's height
_AWAY, _BEHIND = 0.03, 1.02  # m, from the camera, which sees nothing nearer than 0.01 m; factor


class Board:
    """Picture on the page, which may change.

    Args:
        meshcat: The server.
        name: Name of the board: its path is below the camera's.
        left, top: Place of its upper left corner in units of the page's height, from the page's middle; y upwards.
        pixel: Side of a picture's pixel in the same unit.
        kept: Number of pictures that stay in the page, each shown in a recording as long as it was live; later ones
            are shown live only, as is every one where it is 0.
        sharp: Flag: pixels stay squares where they are enlarged.
        behind: Flag: other boards hide it.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        name: str,
        left: float,
        top: float,
        pixel: float,
        *,
        kept: int = 0,
        sharp: bool = False,
        behind: bool = False,
    ) -> None:
        self.path = f"{CAMERA}/{name}"
        self._meshcat, self._left, self._top, self._pixel = meshcat, left, top, pixel
        self._kept, self._sharp, self._number = kept, sharp, 0
        self._away = _AWAY * (_BEHIND if behind else 1.0)
        meshcat.Delete(self.path)

    def show(self, picture: np.ndarray, time: float) -> None:
        """Show a picture (height, width, 3 or 4) uint8, sRGB, from a time [s] of the simulation on."""
        page = 2 * self._away * math.tan(0.5 * FIELD_OF_VIEW)  # m, height of what is seen there
        height, width = page * self._pixel * np.array(picture.shape[:2])
        path = f"{self.path}/{min(self._number, self._kept)}"
        show_sheets(self._meshcat, path, [rectangle(width, height, picture, sharp=self._sharp)])
        place = [page * self._left + 0.5 * width, page * self._top - 0.5 * height, -self._away]
        self._meshcat.SetTransform(path, RigidTransform(place))
        if self._kept and self._number <= self._kept:
            if self._number:
                self._meshcat.SetProperty(path, "visible", False, 0.0)
                self._meshcat.SetProperty(f"{self.path}/{self._number - 1}", "visible", False, time)
            self._meshcat.SetProperty(path, "visible", True, time)
        self._number += 1
