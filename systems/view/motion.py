# SPDX-License-Identifier: MIT
"""Recorded motions in Meshcat, as a page that needs no server."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Box, Rgba
from pydrake.math import RigidTransform

from pinwm_drake.systems.view.meshcat import make_meshcat

_RATE = 30.0  # frames for each second; between them the page interpolates
_FLOOR_DEPTH, _FLOOR_COLOUR = 0.001, Rgba(0.82, 0.83, 0.85)  # m
_BELOW = 1e-4  # m, of the floor under what lies on it
_EYE = np.array([0.3, -0.9, 0.8])  # direction from the middle of the motions to the eye, world
_MARGIN = 0.15  # m, of the floor around the motions


@dataclass(frozen=True, eq=False)
class Moving:
    """A body that moves.

    Attributes:
        mesh: Surface, m, frame B of the body.
        t: (n,) s, increasing.
        p_WB: (n, 3) m, world.
        q_WB: (n, 4) wxyz.
        colour: RGB, 0 to 1.
        opacity: 0 to 1.
    """

    mesh: trimesh.Trimesh
    t: np.ndarray
    p_WB: np.ndarray
    q_WB: np.ndarray
    colour: tuple[float, float, float]
    opacity: float = 1.0


def motion_page(bodies: Mapping[str, Moving], floor_height: float) -> str:
    """Return Meshcat's page of some motions, which plays when it is opened.

    Args:
        bodies: The bodies by the names that the page's controls show.
        floor_height: m, world.

    Raises:
        ParameterError: No port of this machine is free for the server, which ends with this call.
    """
    meshcat = make_meshcat()
    for name in ("/Grid", "/Axes"):
        meshcat.SetProperty(name, "visible", False)
    ways = np.concatenate([one.p_WB for one in bodies.values()])
    low, high = ways.min(0), ways.max(0)
    middle, extent = 0.5 * (low + high), high - low
    sides = extent[:2] + 2 * _MARGIN
    meshcat.SetObject("floor", Box(*sides, _FLOOR_DEPTH), _FLOOR_COLOUR)
    meshcat.SetTransform("floor", RigidTransform([*middle[:2], floor_height - 0.5 * _FLOOR_DEPTH - _BELOW]))
    meshcat.SetCameraPose(middle + 0.55 * float(np.linalg.norm(sides)) * _EYE, middle)
    begin = min(float(one.t[0]) for one in bodies.values())
    meshcat.StartRecording(_RATE, set_visualizations_while_recording=False)
    for name, body in bodies.items():
        vertices, faces = (np.asfortranarray(array.T) for array in (body.mesh.vertices, body.mesh.faces))
        meshcat.SetTriangleMesh(name, vertices, faces, Rgba(*body.colour, body.opacity))
        frames = np.arange(np.floor((body.t[-1] - body.t[0]) * _RATE) + 1) / _RATE
        for k in np.unique(np.abs(body.t - body.t[0] - frames[:, None]).argmin(1)):
            q_WB = body.q_WB[k] / np.linalg.norm(body.q_WB[k])
            X_WB = RigidTransform(Quaternion(wxyz=q_WB), body.p_WB[k])
            # A little after the frame, which may be found by rounding or by cutting off.
            frame = round((float(body.t[k]) - begin) * _RATE) + 0.25
            meshcat.SetTransform(name, X_WB, frame / _RATE)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return str(meshcat.StaticHtml())
