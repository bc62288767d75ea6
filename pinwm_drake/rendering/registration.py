# SPDX-License-Identifier: MIT
"""Registration of a mesh to the masks of posed images: where the object is that they show."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from scipy.optimize import minimize

from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.rendering.views import View
from pinwm_drake.spatial.poses import Pose, compose, identity
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_log

# Longest side of the masks that are compared, px, and the margin around the object.
_SIZE, _MARGIN = 200, 12
# First steps of the search: m, rad, share of the size; and its precision.
_PLACE, _TURN, _GROWTH = 4e-3, 0.05, 0.03
_PRECISE, _EVALUATIONS = 2e-5, 200
# A pose is left as it is given unless another one takes away so much of the difference of the masks.
_WORTH = 0.2


@dataclass(frozen=True, eq=False)
class Registration:
    """Pose of the object in the views, against the one that was given."""

    X_OS: Pose  # The pose that the images show, in the frame O of the pose that was given; q (4,), p (3,) [m]
    differing: tuple[float, float]  # Shares of the masks' pixels that differ from the mesh's outline, before and after

    @property
    def shift(self) -> float:
        """Distance of the two places of the object's middle, m."""
        return float(self.X_OS.p.norm())

    @property
    def turn(self) -> float:
        """Angle between the two orientations, rad."""
        return float(quaternion_log(self.X_OS.q).norm())


def register(views: Sequence[View], mesh: trimesh.Trimesh, up: np.ndarray) -> Registration:
    """Find where an object on a floor is in posed images: place and yaw for which outlines and masks agree best.

    Args:
        views: The images, with the poses of the object that were given.
        mesh: Surface of the object, m, frame O.
        up: (3,), unit, frame O: the floor's normal.

    Returns:
        The registration; the given pose itself where no other one is clearly better.
    """
    corners = torch.from_numpy(np.array(mesh.vertices))
    small = [view.close_up(corners, _MARGIN, _SIZE) for view in views]
    total = sum(int(view.mask.sum()) for view in small)
    if total == 0:
        return Registration(_moved(np.zeros(3), up), (0.0, 0.0))

    def differing(d: np.ndarray) -> float:
        return _differing(small, mesh, _moved(d * [_PLACE, _PLACE, _TURN], up)) / total

    before = differing(np.zeros(3))
    simplex = np.vstack([np.zeros(3), np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": _PRECISE / _PLACE, "fatol": 1e-5, "maxfev": _EVALUATIONS}
    found = minimize(differing, np.zeros(3), method="Nelder-Mead", options=options)
    if float(found.fun) > (1.0 - _WORTH) * before:
        return Registration(_moved(np.zeros(3), up), (before, before))
    return Registration(_moved(found.x * [_PLACE, _PLACE, _TURN], up), (before, float(found.fun)))


@dataclass(frozen=True)
class Size:
    """Size and height of the object in the views, against those that were given."""

    scale: float  # Length in the masks for each of the mesh
    height: float  # m, along the floor's normal

    def words(self) -> str:
        """Say size and height in words."""
        return f"{self.scale:.2f} times as large and {1e3 * self.height:+.0f} mm in height"


def measure_size(views: Sequence[View], mesh: trimesh.Trimesh, up: np.ndarray) -> Size:
    """Find size and height for which outlines and masks agree best, where the object is registered.

    Args:
        views: The images, with the registered poses of the object.
        mesh: Surface of the object, m, frame O.
        up: (3,), unit, frame O: the floor's normal.

    Returns:
        Size and height; those of the mesh where no other ones are clearly better.
    """
    vertices, normal = np.array(mesh.vertices), torch.as_tensor(up, dtype=torch.float64)
    middle = vertices.mean(axis=0)
    small = [view.close_up(torch.from_numpy(vertices), _MARGIN, _SIZE) for view in views]
    total = sum(int(view.mask.sum()) for view in small)

    def differing(d: np.ndarray) -> float:
        scaled = mesh.copy()
        scaled.vertices = middle + np.exp(d[0] * _GROWTH) * (vertices - middle)
        return _differing(small, scaled, Pose(identity().q, d[1] * _PLACE * normal)) / total

    if total == 0:
        return Size(1.0, 0.0)
    before = differing(np.zeros(2))
    simplex = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-5, "maxfev": _EVALUATIONS}
    found = minimize(differing, np.zeros(2), method="Nelder-Mead", options=options)
    if float(found.fun) > (1.0 - _WORTH) * before:
        return Size(1.0, 0.0)
    return Size(float(np.exp(found.x[0] * _GROWTH)), float(found.x[1] * _PLACE))


def registered(views: Sequence[View], registration: Registration) -> list[View]:
    """View with the object where the registration has it."""
    return [replace(view, X_CO=compose(view.X_CO, registration.X_OS)) for view in views]


def _differing(views: Sequence[View], mesh: trimesh.Trimesh, X_OS: Pose) -> int:
    """Pixels in which masks and outlines differ, all views together."""
    count = 0
    for view in views:
        covered = silhouette(mesh, view.camera, compose(view.X_CO, X_OS))
        shown = view.mask.numpy()
        count += int(shown.sum()) if covered is None else int((covered != shown).sum())
    return count


def _moved(d: np.ndarray, up: np.ndarray) -> Pose:
    """Pose of an object moved by d (3,): place [m] along two axes across `up`, angle [rad] about it."""
    z = torch.as_tensor(up, dtype=torch.float64)
    q = quaternion_exp(float(d[2]) * z)
    # Two axes across the normal: those that turning z upwards makes of x and y.
    side = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    if abs(float(z[0])) > 0.9:
        side = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    across = torch.linalg.cross(z, side)
    across = across / across.norm()
    along = torch.linalg.cross(across, z)
    return Pose(q, float(d[0]) * along + float(d[1]) * across)
