# SPDX-License-Identifier: MIT
"""Views of a box with six plain colours, without noise: what fits are tried on."""

import numpy as np
import torch
import trimesh

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import coverage
from pinwm_drake.rendering.views import View
from pinwm_drake.spatial.poses import Pose, inverse
from pinwm_drake.spatial.rotations import matrix_to_quaternion

RED, GREEN, BLUE = [0.8, 0.1, 0.1], [0.1, 0.6, 0.2], [0.1, 0.2, 0.7]


def box(extents=(0.10, 0.06, 0.04)):
    return trimesh.creation.box(extents)


def look_at(eye, target=(0.0, 0.0, 0.0)):
    """X_CO of a camera at `eye` that looks at `target`, both in O, with z upwards."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R_OC = np.stack([x, np.cross(z, x), z], -1)
    return inverse(Pose(matrix_to_quaternion(torch.from_numpy(R_OC)), torch.from_numpy(eye)))


def view_of(mesh, name, eye, size=48):
    """The mesh's faces by axis: x red, y green, z blue; drawn back to front, which is right for a convex one."""
    camera = Camera(size, size, torch.tensor([1.6 * size, 1.6 * size, 0.5 * size, 0.5 * size]))
    X_CO = look_at(eye)
    image, mask = torch.ones(size, size, 3), torch.zeros(size, size, dtype=torch.bool)
    for normal, color in zip(np.concatenate([np.eye(3), -np.eye(3)]), [RED, GREEN, BLUE] * 2, strict=True):
        faces = np.flatnonzero(
            (mesh.face_normals @ normal > 0.9) & (((np.asarray(eye) - mesh.triangles_center) @ normal) > 0)
        )
        if len(faces):
            part = coverage(trimesh.Trimesh(mesh.vertices, mesh.faces[faces], process=False), camera, X_CO) > 0.5
            image[part] = torch.tensor(color, dtype=torch.float32)
            mask |= part
    return View(name, camera, X_CO, image, mask)


def views_around(mesh, number=6, size=48, distance=0.3):
    angles = 2.0 * np.pi * (np.arange(number) + 0.3) / number
    eyes = distance * np.stack([0.8 * np.cos(angles), 0.8 * np.sin(angles), np.full(number, 0.6)], -1)
    return [view_of(mesh, f"view {i}", eye, size) for i, eye in enumerate(eyes)]
