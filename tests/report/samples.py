# SPDX-License-Identifier: MIT
"""A cube that is pushed along x, as a capture and as a twin that was identified from it."""

import math
import shutil
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory, read_episode
from pinwm_drake.capture.scene import PusherGeometry, PusherShape, load_capture
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_pose_table
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.spatial.rotations import matrix_to_quaternion
from pinwm_drake.twin.origin import Origin
from pinwm_drake.twin.twin import Twin
from pinwm_drake.twin.write import write_twin
from tests.capture.cube import SIDE, write_mesh
from tests.rendering.scenes import cloud
from tests.twin.samples import cube_twin

SHAPE = PusherShape("capsule", 0.01, 0.04)
GAP = 0.005  # m, between pusher and cube at the start
SPEED = 0.1  # m/s, of the pusher, along x
SIZE = (48, 36)  # px
NAMES = ("iteration", "loss", "stage", "theta", "names", "start")


def times(frames: int) -> np.ndarray:
    """When the frames are taken [s]."""
    return 0.1 * np.arange(frames)


def moved(frames: int, by: float = 0.0) -> ObjectPoses:
    """Where the cube is when the pusher carries it; `by` m further along y."""
    t = times(frames)
    p = np.tile([0.0, by, SIDE / 2], (frames, 1))
    p[:, 0] = np.maximum(SPEED * t - GAP, 0.0)
    return ObjectPoses(t, p, np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)))


def log(frames: int) -> PusherTrajectory:
    """The pusher, whose surface is the gap away from the cube at first."""
    t = times(frames)
    p = np.tile([-SIDE / 2 - GAP - SHAPE.radius, 0.0, SIDE / 2], (frames, 1))
    p[:, 0] += SPEED * t
    q, v = np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)), np.tile([SPEED, 0.0, 0.0], (frames, 1))
    return PusherTrajectory(t, p, q, v, None)


def camera() -> tuple[Camera, Pose]:
    """A camera that looks down on the push from the side, and its pose X_WC."""
    width, height = SIZE
    view = ViewCamera.look_at(
        np.array([0.05, -0.3, 0.3]),
        np.array([0.01, 0.0, 0.03]),
        width=width,
        height=height,
        field_of_view=math.radians(40),
    )
    intrinsics = torch.tensor([view.focal, view.focal, width / 2, height / 2], dtype=torch.float64)
    q_WC = matrix_to_quaternion(torch.from_numpy(view.R_WC))
    return Camera(width, height, intrinsics), Pose(q_WC, torch.from_numpy(view.p_WC))


def write_push(folder: Path, *, frames: int = 4, truth: bool = True, name: str = "0000") -> Path:
    """Writes a capture with one episode, whose images are renderings; no static views."""
    write_mesh(folder / "meshes/object.obj")
    start = moved(1)
    write_capture_yaml(
        folder,
        name="cube",
        mesh="meshes/object.obj",
        mass=None,
        X_WO=Pose(torch.from_numpy(start.q_WO[0]), torch.from_numpy(start.p_WO[0])),
        pusher_mesh=None,
        pusher_shape=SHAPE,
        floor_height=0.0,
        gravity=9.81,
    )
    episode, (lens, X_WC), poses = folder / "episodes" / name, camera(), moved(frames)
    names = [f"rgb/{k:05}.png" for k in range(frames)]
    write_episode_tables(episode, lens, X_WC, names, poses.t, log(frames), poses if truth else None)
    (episode / "rgb").mkdir(exist_ok=True)
    for k, file_name in enumerate(names):
        X_WO = Pose(torch.from_numpy(poses.q_WO[k]), torch.from_numpy(poses.p_WO[k]))
        picture(surfels(), lens, compose(inverse(X_WC), X_WO)).save(episode / file_name)
    return folder


def surfels() -> Surfels:
    """The cube's appearance."""
    return cloud()


def picture(shown: Surfels, lens: Camera, X_CO: Pose) -> Image.Image:
    """A rendering as an image with alpha, which is all or nothing."""
    rendering = render(shown, lens, X_CO, full=False)
    seen = rendering.alpha[0] > 0.5
    pixels = torch.cat([rendering.color[0].clamp(0, 1), seen[..., None].float()], -1)
    return Image.fromarray((255 * pixels + 0.5).to(torch.uint8).numpy())


def write_identified(folder: Path, capture: Path, *, name: str = "0000", by: float = 0.0, **fields) -> Twin:
    """Writes a twin as `pinwm identify` does, `by` m beside the truth."""
    read = load_capture(capture)
    origin = Origin.of(read, [read_episode(read, name)])
    given = {"pusher": PusherGeometry(None, SHAPE), "surfels": surfels(), "camera_offset": (0.0, 0.0), "nuisance": {}}
    about = {"command": "pinwm identify", "timings": {"align": 1.5, "identify": 3.25}, "losses": {"0": 0.5}}
    twin = cube_twin(folder.parent / "source", **(given | {"provenance": origin.to_provenance() | about} | fields))
    write_twin(folder, twin)
    (folder / "episodes").mkdir(exist_ok=True)
    write_pose_table(folder / f"episodes/{name}.csv", moved(len(read_episode(read, name).t), by))
    write_history(folder / "history.npz")
    return twin


def write_history(path: Path, **arrays: np.ndarray) -> None:
    """Writes a history of two starts with two stages; `arrays` replace some of its own."""
    iteration = np.tile(np.arange(6), 2)
    given = {
        "iteration": iteration,
        "loss": 0.1 + np.exp(-iteration.astype(float)),
        "stage": np.where(iteration < 3, "coarse", "fine"),
        "theta": np.stack([0.3 + 0.1 / (1 + iteration), 1e-3 * iteration], -1),
        "names": np.array(["friction_floor", "lift"]),
        "start": np.repeat([0, 1], 6),
    }
    np.savez(path, **(given | arrays))


def move(folder: Path, to: Path) -> Path:
    """Moves a folder."""
    return Path(shutil.move(folder, to))
