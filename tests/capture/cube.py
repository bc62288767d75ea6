# SPDX-License-Identifier: MIT
"""A small capture: a cube with a colour on each face, seen from all around."""

import json
import math
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from pinwm_drake.capture.scene import read_capture_object
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.views import View
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.scene import Surface, draw_triangles

SIDE = 0.06  # m
HEIGHT = 0.5 * SIDE  # of the cube's centre above the floor, m
FACES = np.array([[0.8, 0.2, 0.1], [0.1, 0.5, 0.8], [0.2, 0.7, 0.2], [0.9, 0.8, 0.1], [0.5, 0.2, 0.6], [0.3, 0.3, 0.3]])
CAPTURE = """schema_version: 1
units: {length: m, angle: rad, time: s}
gravity: 9.8
object:
  name: cube
  mesh: meshes/object.obj
  mass: null
  X_WO: {p: [0.0, 0.0, 3e-2], q: [1.0, 0.0, 0.0, 0.0]}
pusher: {mesh: meshes/pusher.obj, shape: null}
floor: {height: 0.0}
"""


def cameras(size: int, count: int, field_of_view: float = 25.0) -> list[ViewCamera]:
    """Cameras on a ring around the cube, at two heights; the angle in degrees."""
    target = np.array([0.0, 0.0, HEIGHT])
    return [
        ViewCamera.look_at(
            target + 0.3 * np.array([math.cos(angle), math.sin(angle), 0.6 + 0.5 * (k % 2)]),
            target,
            width=size,
            height=size,
            field_of_view=math.radians(field_of_view),
        )
        for k, angle in enumerate(2 * math.pi * np.arange(count) / count)
    ]


def picture(camera: ViewCamera, x: float = 0.0) -> np.ndarray:
    """The cube, moved along x [m]: (height, width, 4) uint8, RGBA; each pixel is the mean of 16."""
    cube = trimesh.creation.box((SIDE, SIDE, SIDE))
    surface = Surface.empty(camera.scaled(4))
    for k in range(len(cube.faces)):
        axis = int(np.abs(cube.face_normals[k]).argmax())
        colour = FACES[2 * axis + int(cube.face_normals[k, axis] > 0)]
        corners = cube.triangles[k : k + 1] + np.array([x, 0, HEIGHT])
        draw_triangles(surface, camera.scaled(4), corners, np.repeat(cube.face_normals[k : k + 1, None], 3, 1), colour)
    covered = (surface.inverse_depth > 0)[..., None]
    blocks = np.concatenate((surface.colour * covered, covered), axis=-1)
    mean = blocks.reshape(camera.height, 4, camera.width, 4, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-6)
    return (255 * mean + 0.5).astype(np.uint8)


def write_views(folder: Path, *, size: int = 48, count: int = 8, alpha: bool = True) -> Path:
    """Writes `transforms.json` and images, with alpha or on white."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, camera in enumerate(cameras(size, count)):
        rgba = picture(camera)
        if not alpha:
            share = rgba[..., 3:] / 255
            rgba = (rgba[..., :3] * share + 255 * (1 - share) + 0.5).astype(np.uint8)
        Image.fromarray(rgba).save(folder / f"images/{k:03}.png")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.R_WC @ np.diag([1.0, -1.0, -1.0]), camera.p_WC
        frames.append({"file_path": f"images/{k:03}.png", "transform_matrix": matrix.tolist()})
    focal, centre = cameras(size, 1)[0].focal, size / 2
    head = {"camera_model": "PINHOLE", "w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": centre, "cy": centre}
    (folder / "transforms.json").write_text(json.dumps({**head, "frames": frames}))
    return folder


def write_mesh(path: Path) -> Path:
    """Writes the cube, its origin in the middle."""
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((SIDE, SIDE, SIDE)).export(path)
    return path


def write_capture(folder: Path, **options) -> Path:
    """Writes a capture with static views only."""
    write_views(folder / "static", **options)
    write_mesh(folder / "meshes/object.obj")
    (folder / "capture.yaml").write_text(CAPTURE)
    return folder


def read_static_views(folder: Path) -> list[View]:
    """The static views of a capture, in the order of its file."""
    about = read_capture_object(folder)
    return read_views(folder / "static", about.X_WO, mesh=load_mesh(about.mesh_path))
