# SPDX-License-Identifier: MIT
"""A small capture with an episode: a sphere pushes the cube along x."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory, read_episode_image
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion
from tests.capture.cube import HEIGHT, SIDE, cameras, picture, write_mesh, write_views

RADIUS, SPEED, RATE, START = 0.012, 0.16, 24.0, -0.075
SIZE, VIEWS, FRAMES = 64, 8, 10


def X_WO() -> Pose:
    """Where the cube starts."""
    return Pose(torch.tensor([1.0, 0, 0, 0], dtype=torch.float64), torch.tensor([0.0, 0, HEIGHT], dtype=torch.float64))


def pose_of(camera: ViewCamera) -> Pose:
    """Pose of a camera in the world, OpenCV axes."""
    return Pose(matrix_to_quaternion(torch.tensor(camera.R_WC)), torch.tensor(camera.p_WC))


def camera_of(camera: ViewCamera) -> Camera:
    focal, width, height = camera.focal, camera.width, camera.height
    return Camera(width, height, torch.tensor([focal, focal, width / 2, height / 2], dtype=torch.float64))


def times() -> np.ndarray:
    return np.arange(FRAMES) / RATE


def trajectory() -> PusherTrajectory:
    t = times()
    p_WP = np.stack([START + SPEED * t, np.zeros(FRAMES), np.full(FRAMES, HEIGHT)], axis=-1)
    v_WP = np.tile([SPEED, 0.0, 0.0], (FRAMES, 1))
    return PusherTrajectory(t, p_WP, np.tile([1.0, 0, 0, 0], (FRAMES, 1)), v_WP, None)


def poses() -> ObjectPoses:
    """The cube rests until the sphere reaches it, and then moves along."""
    x = np.maximum(trajectory().p_WP[:, 0] + RADIUS + SIDE / 2, 0.0)
    p_WO = np.stack([x, np.zeros(FRAMES), np.full(FRAMES, HEIGHT)], axis=-1)
    return ObjectPoses(times(), p_WO, np.tile([1.0, 0, 0, 0], (FRAMES, 1)))


def write_pushed_cube(folder: Path) -> Path:
    """Writes the capture: 8 static views and one episode of 10 images, 64 x 64 px."""
    write_views(folder / "static", size=SIZE, count=VIEWS)
    write_mesh(folder / "meshes/object.obj")
    shape = PusherShape("sphere", RADIUS)
    write_capture_yaml(
        folder,
        name="cube",
        mesh="meshes/object.obj",
        mass=0.2,
        X_WO=X_WO(),
        pusher_mesh=None,
        pusher_shape=shape,
        floor_height=0.0,
        gravity=9.81,
    )
    view = cameras(SIZE, 3, field_of_view=35.0)[1]
    names = [f"rgb/{k:05}.png" for k in range(FRAMES)]
    episode = folder / "episodes/0000"
    write_episode_tables(episode, camera_of(view), pose_of(view), names, times(), trajectory(), poses())
    (episode / "rgb").mkdir()
    for name, p_WO in zip(names, poses().p_WO, strict=True):
        Image.fromarray(picture(view, float(p_WO[0]))).save(episode / name)
    return folder


def read_frames(episode):
    """Images (n, H, W, 3) and masks (n, H, W) of an episode."""
    pictures = [read_episode_image(episode.folder, name, episode.camera) for name in episode.file_names]
    return tuple(torch.from_numpy(np.stack(parts)) for parts in zip(*pictures, strict=True))
