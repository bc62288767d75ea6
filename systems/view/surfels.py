# SPDX-License-Identifier: MIT
"""Surfels of a twin as geometry in Meshcat, moved with the object."""

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.surfels.mesh import SurfelMesh
from pinwm_drake.systems.ports import unowned
from pinwm_drake.systems.view.sheets import show_sheets


class MeshcatSurfels(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Publisher that draws the surfels of world 0 as discs, once, and moves them.

                                               ┌────────────────┐
        object_state (13 W): q_WO, p_WO [m] ─► │ MeshcatSurfels │
                                               └────────────────┘

    Published every `period` seconds from t = 0 on, and when a publish is forced.

    Args:
        surfels: Surfels, frame O; one set of colours.
        meshcat: The server.
        num_worlds: Number of worlds W.
        period: Simulated time between publishes, s.
        path: Path of the surfels in Meshcat's tree.
    """

    def __init__(self, surfels: Surfels, meshcat: Meshcat, *, num_worlds: int = 1, period: float, path: str) -> None:
        super().__init__()
        self._meshcat, self._path = meshcat, path
        self._state = self.DeclareVectorInputPort("object_state", 13 * num_worlds)
        show_sheets(meshcat, path, SurfelMesh.from_surfels(surfels).sheets())
        self.DeclarePeriodicPublishEvent(period, 0.0, unowned(self, self._Publish))
        self.DeclareForcedPublishEvent(unowned(self, self._Publish))

    def _Publish(self, context: Context) -> EventStatus:
        q_WO, p_WO = np.split(self._state.Eval(context)[:7], [4])
        X_WO = RigidTransform(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)), p_WO)
        self._meshcat.SetTransform(self._path, X_WO, context.get_time())
        return EventStatus.Succeeded()
