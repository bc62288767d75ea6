"""Where small spheres carry an object in point contact with a floor."""

import numpy as np
import trimesh

from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.geometry.patch import PROTRUSION, resting_points
from pinwm_drake.systems.contact_settings import CORNER_RADIUS, SUPPORT_RADIUS

# Sides of the convex hull whose planes are as near as this are one side: sine of the angle.
_SAME_SIDE = 1e-3


def support_spheres(mesh: trimesh.Trimesh) -> list[tuple[np.ndarray, float]]:
    """The spheres with which an object touches a floor.

    On each flat side that it can rest on they are where `geometry.patch.resting_points` puts uniform pressure, and
    stand out by their radius; the corners of the convex hull have smaller ones, on which it tips, rolls and falls.

    Args:
        mesh: Watertight, m, frame O.

    Returns:
        Centre (3,) [m, frame O] and radius [m] of each.
    """
    spheres = []
    for normal in resting_normals(mesh):
        R_WO = _turned_down(normal)
        points = resting_points(mesh, R_WO)
        if points is None:
            continue
        heights = points @ R_WO[2]
        out = heights < (mesh.vertices @ R_WO[2]).min() - 0.5 * PROTRUSION
        spheres += [(point, SUPPORT_RADIUS) for point in points[out] - PROTRUSION * normal]
    corners = trimesh.convex.convex_hull(mesh.vertices).vertices
    return spheres + [(np.asarray(corner), CORNER_RADIUS) for corner in corners]


def resting_normals(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """The outward normals (3,) of the sides of the convex hull over which the centre of mass stands."""
    hull = trimesh.convex.convex_hull(mesh.vertices)
    p_OB = mass_properties(mesh, mass=1.0).p_com
    found: list[np.ndarray] = []
    for triangle, normal in zip(hull.triangles, hull.face_normals, strict=True):
        a, b, c = triangle - p_OB
        # The centre of mass, moved along the normal into the triangle's plane, lies inside of its edges.
        inside = all(np.cross(v - u, -u) @ normal > -1e-9 for u, v in ((a, b), (b, c), (c, a)))
        if inside and not any(np.linalg.norm(normal - other) < _SAME_SIDE for other in found):
            found.append(np.asarray(normal))
    return found


def _turned_down(normal: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) after which a side with this outward normal lies on the floor."""
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(-normal, across), -normal])
