# SPDX-License-Identifier: MIT
"""A cube that is pushed by known physics, filmed by our renderer: a capture whose truth is exact."""

import hashlib
import json
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.ply import write_ply
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import PusherMotion, Scene, make_scene, pusher_motion, resting_height, rollout_poses
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.twin.rollout import pusher_impulses
from tests.rendering.boxes import look_at
from tests.report.samples import picture

SIDE, SPEED, STOP, FRAMES = 0.06, 0.3, 0.25, 12
SIZE = 96  # px
SHAPE = PusherShape("sphere", 0.01)
TRUTH = {"friction_floor": 0.2, "friction_pusher": 0.3}
LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)


def surfels(number=12, seed=0) -> Surfels:
    """The cube's faces, each a grid of surfels with random colours."""
    generator = np.random.default_rng(seed)
    grid = (np.arange(number) + 0.5) / number - 0.5
    u, v = (axis.ravel() * SIDE for axis in np.meshgrid(grid, grid))
    p, q = [], []
    half = np.sqrt(0.5)
    for axis, turn in enumerate([(half, 0.0, half, 0.0), (half, -half, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)]):
        for side in (-0.5, 0.5):
            face = np.insert(np.stack([u, v], -1), axis, side * SIDE, axis=1)
            p.append(face)
            q.append(np.tile(turn, (len(face), 1)))
    p, q = np.concatenate(p), np.concatenate(q)
    # Patches of four by four surfels share a colour, so that there is something to see at few pixels.
    cell = np.floor((p / SIDE + 0.5) * 2.999).astype(int)
    colors = generator.uniform(0.05, 0.95, (4, 4, 4, 3))[tuple(np.clip(cell, 0, 3).T)]
    scale = np.full((len(p), 2), 0.45 * SIDE / number)
    return Surfels(
        p_OS=torch.tensor(p, dtype=torch.float32),
        q_OS=torch.tensor(q, dtype=torch.float32),
        log_scale=torch.tensor(scale, dtype=torch.float32).log(),
        logit_opacity=torch.full((len(p),), 4.0),
        sh=((torch.tensor(colors, dtype=torch.float32) - 0.5) / 0.28209479177387814)[:, None],
    )


def trajectory(offset=0.012, time_shift=0.0) -> PusherTrajectory:
    """A push along x beside the middle, which ends at once; the log is late by `time_shift` [s]."""
    t = np.arange(-10, 200) / 200
    p = np.tile([-SIDE / 2 - 0.012, offset, SIDE / 2], (len(t), 1))
    p[:, 0] += SPEED * np.clip(t, 0.0, STOP)
    v = np.zeros_like(p)
    v[(t >= 0) & (t < STOP), 0] = SPEED
    return PusherTrajectory(t + time_shift, p, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), v, None)


def camera() -> tuple[Camera, Pose]:
    """A camera above, and its pose X_WC."""
    lens = Camera(SIZE, SIZE, torch.tensor([1.5 * SIZE, 1.5 * SIZE, 0.5 * SIZE, 0.5 * SIZE], dtype=torch.float64))
    return lens, inverse(look_at((0.05, -0.2, 0.25), (0.05, 0.0, 0.02)))


def true_poses(mesh: Path, support="patch", offset=0.012, **theta) -> ObjectPoses:
    """Where physics with 8 friction directions has the cube in the frames."""
    scene = make_scene(mesh, PusherGeometry(None, SHAPE), q_WO=LEVEL, gravity=9.81, support=support)
    t = np.arange(FRAMES) / 20
    X_WO = rollout_poses(*_push(scene, offset, t[-1], theta), torch.from_numpy(t))
    return ObjectPoses(t, X_WO.p[:, 0].numpy(), X_WO.q[:, 0].numpy())


def true_force(mesh: Path, offset=0.012) -> np.ndarray:
    """Force (m, 3) N of the cube of 1 kg on the pusher, at the times of its trajectory."""
    scene = make_scene(mesh, PusherGeometry(None, SHAPE), q_WO=LEVEL, gravity=9.81)
    force_W = 240 * pusher_impulses(*_push(scene, offset, FRAMES / 20, {}))[:, 0]
    middle, t = (np.arange(len(force_W)) + 0.5) / 240, trajectory().t
    return np.stack([np.interp(t, middle, force_W[:, axis], left=0.0) for axis in range(3)], -1)


def _push(
    scene: Scene, offset: float, end: float, theta: dict[str, float]
) -> tuple[Scene, Parameters, Pose, PusherMotion]:
    """Scene, parameters, start and motion of a push up to a time [s]."""
    parameters = Parameters.nominal(scene.model, **(TRUTH | theta))
    start = Pose(LEVEL[None], torch.tensor([[0.0, 0.0, resting_height(scene, LEVEL)]], dtype=torch.float64))
    return scene, parameters, start, pusher_motion(trajectory(offset), 0.0, round(end * 240), 1 / 240)


def write_capture(folder: Path, *, time_shift=0.0, support="patch", **theta) -> Path:
    """Writes the capture, without static views."""
    (folder / "meshes").mkdir(parents=True)
    mesh = folder / "meshes/object.obj"
    trimesh.creation.box((SIDE, SIDE, SIDE)).export(mesh)
    write_capture_yaml(
        folder,
        name="cube",
        mesh="meshes/object.obj",
        mass=None,
        X_WO=Pose(LEVEL, torch.tensor([0.0, 0.0, SIDE / 2], dtype=torch.float64)),
        pusher_mesh=None,
        pusher_shape=SHAPE,
        floor_height=0.0,
        gravity=9.81,
    )
    write_episode(folder, folder / "episodes/0000", time_shift=time_shift, support=support, **theta)
    return folder


def write_episode(folder: Path, episode: Path, *, time_shift=0.0, support="patch", offset=0.012, **theta) -> None:
    """Writes a push of the capture's cube beside its middle by `offset` (m)."""
    poses = true_poses(folder / "meshes/object.obj", support, offset, **theta)
    (lens, X_WC), shown = camera(), surfels()
    names = [f"rgb/{k:05}.png" for k in range(FRAMES)]
    write_episode_tables(episode, lens, X_WC, names, poses.t, trajectory(offset, time_shift), poses)
    (episode / "rgb").mkdir(exist_ok=True)
    for k, name in enumerate(names):
        X_WO = Pose(torch.from_numpy(poses.q_WO[k]), torch.from_numpy(poses.p_WO[k]))
        picture(shown, lens, compose(inverse(X_WC), X_WO)).save(episode / name)


def write_appearance(twin: Path) -> None:
    """What `pinwm align` leaves, as far as identification reads it."""
    twin.mkdir(parents=True, exist_ok=True)
    write_ply(twin / "surfels.ply", surfels())
    sha256 = hashlib.sha256((twin / "surfels.ply").read_bytes()).hexdigest()
    (twin / "align.json").write_text(json.dumps({"camera_offset": [0.0, 0.0], "surfels_sha256": sha256}))
