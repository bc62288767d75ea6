# SPDX-License-Identifier: MIT
"""Film and log of a push, drawn with OpenCV: a rod with a ball at its end pushes a block over a table with texture."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_posed_images
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion
from pinwm_drake.station.clock.patches import PusherFilm, box_of_way

RADIUS, RATE, LOG_RATE = 0.01, 30.0, 125.0
BOUNDS = np.array([[-RADIUS] * 3, [RADIUS] * 3])
_FINE = 4  # drawn pixels for each pixel of an image, along a side
_SIZE = 320, 240


@dataclass(frozen=True, eq=False)
class DrawnPush:
    """Frames (n, H, W, 3) uint8 at times t (n,), and positions p_WP (m, 3) at times log_t (m,) of another clock."""

    frames: np.ndarray
    t: np.ndarray
    log_t: np.ndarray
    p_WP: np.ndarray
    camera: Camera
    X_WC: Pose
    offset: float

    def film(self, which=slice(None), t=None, log=None) -> PusherFilm:
        """The film, or some of its frames, with other times or another log."""
        log_t, p_WP = log or (self.log_t, self.p_WP)
        x, y, width, height = box_of_way(p_WP, self.camera, self.X_WC, BOUNDS)
        frames = [np.ascontiguousarray(frame[y : y + height, x : x + width]) for frame in self.frames[which]]
        t = self.t[which] if t is None else t
        return PusherFilm(frames, t, log_t, p_WP, self.camera.cropped(x, y, width, height), self.X_WC, BOUNDS)


def place(t: np.ndarray, ahead: tuple[float, float] = (0.16, 0.05)) -> np.ndarray:
    """Positions (n, 3) [m] of the pusher: at rest until 0.3 s, then over 0.16 m and 0.05 m with the least jerk."""
    s = np.clip((t - 0.3) / 0.9, 0, 1)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    return np.stack([-0.09 + ahead[0] * way, -0.03 + ahead[1] * way, np.full(len(t), 0.03)], axis=1)


def draw_push(seed: int = 0, offset: float = 0.37, seconds: float = 1.6, noise: float = 3.0) -> DrawnPush:
    """Draw a push; the log's time is that of the film plus `offset` [s]."""
    random = np.random.default_rng(seed)
    eye = ViewCamera.look_at(
        np.array([0.1, -0.45, 0.4]), np.array([0, 0, 0.03]), width=_SIZE[0], height=_SIZE[1], field_of_view=0.5
    )
    lens = torch.tensor([eye.focal, eye.focal, _SIZE[0] / 2, _SIZE[1] / 2], dtype=torch.float64)
    q_WC = matrix_to_quaternion(torch.tensor(np.array(eye.R_WC)))
    table = cv2.GaussianBlur(random.normal(size=(_SIZE[1] * _FINE, _SIZE[0] * _FINE, 3)), (0, 0), 24)
    table = np.clip(150 + 25 * table / table.std(), 0, 255).astype(np.uint8)
    t = np.arange(0, seconds, 1 / RATE)
    frames = [_draw(table, eye, p_WP, random, noise) for p_WP in place(t)]
    log_t = np.arange(-1.0, seconds + 1.0, 1 / LOG_RATE)
    p_WP = place(log_t) + random.normal(0, 1e-4, (len(log_t), 3))
    X_WC = Pose(q_WC, torch.tensor(np.array(eye.p_WC)))
    return DrawnPush(np.array(frames), t, log_t + offset, p_WP, Camera(*_SIZE, lens), X_WC, offset)


def _draw(table, eye: ViewCamera, p_WP: np.ndarray, random: np.random.Generator, noise: float) -> np.ndarray:
    picture = table.copy()

    def pixels(points) -> np.ndarray:
        p_C = (np.atleast_2d(points) - eye.p_WC) @ eye.R_WC
        centre = np.array(_SIZE) / 2
        found = p_C[:, :2] / p_C[:, 2:] * eye.focal + centre
        return np.rint(found * _FINE * 16).astype(np.int32)  # 4 bits of fraction

    shoved = max(p_WP[0] + RADIUS + 0.03, 0.0)
    corners = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]]) + np.array([shoved, 0])
    top = pixels(np.column_stack([corners, np.full(4, 0.05)]))
    cv2.fillConvexPoly(picture, top, (60, 90, 200), cv2.LINE_AA, shift=4)
    depth = float((p_WP - eye.p_WC) @ eye.R_WC[:, 2])
    px = eye.focal / depth * _FINE
    ends = pixels(np.array([p_WP, p_WP + np.array([0, 0, 0.2])]))
    cv2.line(picture, ends[0].tolist(), ends[1].tolist(), (40, 40, 40), round(0.008 * px), cv2.LINE_AA, shift=4)
    cv2.circle(picture, ends[0].tolist(), round(RADIUS * px * 16), (30, 200, 60), -1, cv2.LINE_AA, shift=4)
    small = cv2.resize(picture, _SIZE, interpolation=cv2.INTER_AREA)
    return np.clip(small + random.normal(0, noise, small.shape), 0, 255).astype(np.uint8)


def write_drawn_capture(folder: Path, push: DrawnPush) -> Path:
    """Write a capture without episodes for a push, and its camera as `camera.json` beside `capture.yaml`."""
    (folder / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.06, 0.06, 0.05)).export(folder / "meshes/object.obj")
    X_WO = Pose(torch.tensor([1.0, 0, 0, 0], dtype=torch.float64), torch.tensor([0, 0, 0.025], dtype=torch.float64))
    write_capture_yaml(
        folder,
        name="block",
        mesh="meshes/object.obj",
        mass=None,
        X_WO=X_WO,
        pusher_mesh=None,
        pusher_shape=PusherShape("sphere", RADIUS),
        floor_height=0.0,
        gravity=9.81,
    )
    write_posed_images(folder / "posed.json", [("x.png", push.camera, push.X_WC)])
    posed = json.loads((folder / "posed.json").read_text())
    (folder / "posed.json").unlink()
    frame = posed.pop("frames")[0]
    (folder / "camera.json").write_text(json.dumps({**posed, "transform_matrix": frame["transform_matrix"]}))
    return folder


def write_mp4(path: Path, frames: np.ndarray, rate: float = RATE) -> Path:
    """Write a video with OpenCV's own MPEG-4."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate, frames.shape[2:0:-1])
    assert writer.isOpened()
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()
    return path


def write_csv_log(path: Path, push: DrawnPush, *, epoch: float = 0.0) -> Path:
    """Write the log in milliseconds and millimetres."""
    rows = np.column_stack([1e3 * (push.log_t + epoch), 1e3 * push.p_WP])
    np.savetxt(path, rows, delimiter=",", header="stamp,x,y,z", comments="", fmt="%.4f")
    return path
