# SPDX-License-Identifier: MIT
"""The frames of a simulated episode's video: the scene for people, and beside it the station's `rgb`."""

import dataclasses

import cv2
import numpy as np
from pydrake.math import RigidTransform

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.captions import write_caption
from pinwm_drake.report.scene import PLAIN, Actor, Paint, Stage, coloured_actors
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.colours import surface_samples

_HEIGHT = 480  # px, about, of the panels
_PUSHER = (0.10, 0.25, 0.55)  # linear RGB


def object_actors(setup: Setup) -> list[Actor]:
    """Return the surfaces of a setup's object for pictures: in its own colours, or in those of its twin's surfels."""
    if setup.visual_path != setup.twin.mesh_path:
        return coloured_actors(setup.visual_path)
    mesh = load_mesh(setup.twin.mesh_path)
    actor = Actor.from_mesh(mesh, PLAIN, smooth=False)
    triangles, normals, colours = surface_samples(mesh, setup.twin.surfels)
    return [dataclasses.replace(actor, paint=Paint(triangles.mean(axis=1), normals, colours))]


class Film:
    """Draws frames, as many as are wanted.

    Args:
        setup: Object, pusher, floor and camera: people see the scene from where the camera is.
        engine: For the caption.

    Attributes:
        size: (width, height) [px] of a frame, even.
    """

    def __init__(self, setup: Setup, engine: str) -> None:
        camera = setup.camera
        self._engine, self._scale = engine, max(1, round(_HEIGHT / camera.height))
        width, height = self._scale * camera.width, self._scale * camera.height
        focal = self._scale * float(camera.intrinsics[1])
        view = ViewCamera(setup.X_WC.rotation().matrix(), setup.X_WC.translation(), focal, width, height)
        self._stage = Stage(view, setup.twin.floor_height)
        self._object = object_actors(setup)
        self._pusher = Actor.from_mesh(pusher_surface(setup.twin.pusher), _PUSHER, smooth=True)
        self._ways: list[np.ndarray] = []
        self.size = (2 * width // 2 * 2, height // 2 * 2)

    def frame(self, t: float, X_WO: RigidTransform, p_WP: np.ndarray, rgb: np.ndarray) -> np.ndarray:
        """Return the next frame.

        Args:
            t: s.
            X_WO: Pose of the object.
            p_WP: (3,) m, world, of the pusher.
            rgb: (height, width, 4) uint8, as the station's port has it.

        Returns:
            (height, width, 3) uint8, sRGB, of `size`.
        """
        R_WO, p_WO = X_WO.rotation().matrix(), X_WO.translation()
        self._ways.append(np.stack([p_WO[:2], p_WP[:2]]))
        ways = np.array(self._ways)
        scene = self._stage.picture(
            [*((actor, R_WO, p_WO) for actor in self._object), (self._pusher, np.eye(3), p_WP)],
            [(ways[:, 0], PLAIN), (ways[:, 1], _PUSHER)],
        )
        larger = (self._scale * rgb.shape[1], self._scale * rgb.shape[0])
        seen = cv2.resize(rgb[..., :3], larger, interpolation=cv2.INTER_NEAREST)
        whole = np.concatenate([scene, seen], axis=1)
        write_caption(whole, f"{self._engine}  t = {t:.2f} s", f"rgb, {rgb.shape[1]} x {rgb.shape[0]} px")
        return np.ascontiguousarray(whole[: self.size[1], : self.size[0]])
