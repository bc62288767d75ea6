# SPDX-License-Identifier: MIT
"""Truth of the example's lab, its photos and films, and the motions of its pushes.

Frames: B is the robot's base, T the table with z up. The object is in T; its motions come from an engine of Drake or
from MuJoCo, with frictions that nobody tells the guide.
"""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from pydrake.math import RigidTransform, RotationMatrix

from benchmarks.next_push.engines import engine
from benchmarks.next_push.engines.rollout import LOG_RATE, Rollout, Theta
from benchmarks.next_push.objects import make_thing
from benchmarks.next_push.pushes import FRAME_RATE, Push
from benchmarks.scenes.lab_scenes import TIP, WOOD, Case, Lab, photo, ring
from benchmarks.scenes.rendered_lab import MIDDLE, TEXELS, RenderedLab
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.rigid import apply, inverse, rigid
from pinwm_drake.systems.pusher.choice import choose_push
from pinwm_drake.systems.pusher.motion import StraightPush

MASS, FRICTION_FLOOR, FRICTION_PUSHER = 0.8, 0.25, 0.2  # kg, 1, 1
WORKSPACE = {"low": [0.40, -0.16, 0.0], "high": [0.72, 0.16, 0.12]}
COLUMNS = "t=stamp[ms],px=x[mm],py=y[mm],pz=z[mm]"
PRINTED = 0.98  # of the board's print
_OBJECT_TURN = 3.0  # rad, largest
_BOARD = np.array([0.25, 0.0])  # m, middle of the board beside the object
_AIM, _FAR = (0.09, 0.0, 0.03), 0.58  # m, of the phone
_BOXES = (0.45, 0.65)  # m, distances of the clutter
_MARGIN = 0.01  # m, white around the board
_ARM_ROOM = 0.3  # m, from the axis of the arm's base, that the phone keeps
_HEIGHT, _SPEED, _DISTANCE, _OFF = 0.025, 0.08, 0.09, 0.012  # m, m/s, m, m: a person's push
_STILL = 0.4  # s, of film before and after the motion
_BEFORE = 0.8  # s, of log before the film and after it
_LOG_NOISE = 5e-5  # m
_GUESS = np.array([0, 0.6, 0, -1.3, 0, 1.2, 0])  # rad
_SHAPE = PusherShape("sphere", TIP)


@dataclass(frozen=True)
class Sizes:
    """Numbers of photos from above, near the table, and of the sets lens, robot and table; width [px] of the phone's.

    `finer` is the number of rendered pixels for each of the fixed camera, along a side.
    """

    above: int = 16
    grazing: int = 8
    board: tuple[int, int, int] = (12, 20, 6)
    phone: int = 2560
    finer: int = 2


class LensCamera:
    """Renderer's pinhole that shows all that a lens sees, and the map from its pictures to those of the lens."""

    def __init__(self, lens: Lens, finer: int = 1) -> None:
        self.lens = lens
        x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
        rays = lens.rays(np.column_stack([x.ravel(), y.ravel()])).reshape(lens.height, lens.width, 2)
        rays = cv2.resize(rays, None, fx=finer, fy=finer, interpolation=cv2.INTER_LINEAR)
        focal = finer * lens.intrinsics[:2]
        low, high = (rays.min((0, 1)) * focal - 2, rays.max((0, 1)) * focal + 2)
        width, height = np.ceil(high - low).astype(int).tolist()
        self.camera = Camera(width, height, torch.tensor([*focal, *-low], dtype=torch.float64))
        self._map = (rays * focal - low - 0.5).astype(np.float32)

    def seen(self, picture: np.ndarray) -> np.ndarray:
        """Picture of the lens from one of the pinhole, both (height, width, channels) uint8."""
        found = cv2.remap(picture, self._map, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        return cv2.resize(found, (self.lens.width, self.lens.height), interpolation=cv2.INTER_AREA)


class ExampleLab:
    """The lab: board, robot and lens of `RenderedLab`, and in Drake's VTK renderer the object, table, room and arm.

    Attributes:
        board: Lab of the board, with the true lens and pose X_BC of the fixed camera.
        X_BT: (4, 4), pose of the table's frame T, in whose middle the object is.
        X_TO: Pose of the object at the start of each push.
        theta: Truth about the object.
    """

    def __init__(self, seed: int, out: Path, sizes: Sizes, engine_name: str = "hydroelastic") -> None:
        self.seed, self.sizes, self.truth, self._engine = seed, sizes, out / "truth", engine_name
        self.board = RenderedLab(seed, printed=PRINTED, numbers=sizes.board)
        self.X_BT = self.board.X_BT @ rigid(MIDDLE)
        self.thing = make_thing("t", self.truth)
        self.mesh = load_mesh(self.thing.mesh_path)
        rng = np.random.default_rng([seed, 1])
        turned = RotationMatrix.MakeZRotation(rng.uniform(-_OBJECT_TURN, _OBJECT_TURN))
        self.X_TO = RigidTransform(turned, [*rng.uniform(-0.01, 0.01, 2), -self.mesh.bounds[0, 2]])
        solid = mass_properties(self.mesh, mass=MASS)
        self.theta = Theta(MASS, FRICTION_FLOOR, FRICTION_PUSHER, solid.p_com, solid.inertia, np.zeros((0, 3)))
        self.fixed = self.board.lens
        width = sizes.phone
        focal, height = 0.953 * width, 3 * width // 4
        self.phone = Lens(
            width,
            height,
            "opencv",
            np.array([focal, 1.001 * focal, 0.503 * width, 0.494 * height]),
            np.array([0.08, -0.15, 0.0004, -0.0003, 0.05]),
        )

    def own_push(self) -> StraightPush:
        """Push that a person chooses: at one side of the object, off its middle, within the workspace."""
        mesh_T = self.mesh.copy()
        mesh_T.apply_transform(self.X_TO.GetAsMatrix4())
        rng, p_com = np.random.default_rng([self.seed, 2]), self.X_TO @ self.theta.p_com
        for _ in range(500):
            push = choose_push(mesh_T, p_com, _SHAPE, rng, height=_HEIGHT, speed=_SPEED, distance=_DISTANCE)
            x, y = push.direction_W[:2]
            aside = abs(float((push.p_WP - p_com)[:2] @ [-y, x]))
            ends = apply(self.X_BT, np.array([push.p_WP, push.p_WP + push.distance * push.direction_W]))
            low, high = WORKSPACE["low"][:2], WORKSPACE["high"][:2]
            if aside > _OFF and (ends[:, :2] > low).all() and (ends[:, :2] < high).all():
                return push
        raise RuntimeError("no push within the workspace")

    def as_told(self, push: dict[str, Any], X_BW: np.ndarray) -> StraightPush:
        """Push that a robot makes in truth when it is told one in the calibrated world W.

        Args:
            push: Its `start` [m] and `direction` in W, `speed` [m/s] and `distance` [m].
            X_BW: (4, 4), by the calibration.
        """
        X_TW = inverse(self.X_BT) @ X_BW
        start, direction = apply(X_TW, np.array(push["start"])), X_TW[:3, :3] @ push["direction"]
        return StraightPush(start, direction, push["speed"], push["distance"], self.own_push().acceleration)

    def write_photos(self, folder: Path) -> None:
        """Write the photos of object and board by the phone, and one by the fixed camera."""
        rng = np.random.default_rng([self.seed, 3])
        margin, side, scale = _MARGIN, np.array(self.board.board.size), self.board.printed
        pixels = tuple(round(TEXELS * s) + 2 * round(TEXELS * margin) for s in side)
        grey = self.board.board.opencv().generateImage(pixels, marginSize=round(TEXELS * margin), borderBits=1)
        grey = np.clip(0.8 * grey + 20.0, 0, 255).astype(np.uint8)
        (x0, y0), (x1, y1) = -np.array([margin, margin]), side + margin
        corners_M = scale * np.array([[x0, y1, 0], [x1, y1, 0], [x1, y0, 0], [x0, y0, 0]])
        X_TM = rigid([*_BOARD, 2e-4], [0, 0, np.pi / 2 + rng.uniform(-0.3, 0.3)]) @ rigid(w=[np.pi, 0, 0])
        corners = apply(X_TM @ rigid([*(-0.5 * scale * side), 0]), corners_M)
        sheet = ("board", cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), corners)
        phone = LensCamera(self.phone)
        lab = self._lab(phone, [sheet])
        sizes, base = self.sizes, inverse(self.X_BT)[:2, 3]
        poses = ring(sizes.above, 30, 65, rng, _FAR, _AIM) + ring(sizes.grazing, 12, 22, rng, _FAR, _AIM)
        poses = [X for X in poses if np.linalg.norm(X.translation()[:2] - base) > _ARM_ROOM]
        for k, X_TC in enumerate(poses):
            self._take(lab, phone, folder / f"{k:04}.jpg", self.X_TO, X_TC, rng, gain=0.03)
        np.save(self.truth / "X_TC.npy", np.array([X.GetAsMatrix4() for X in poses]))
        fixed = self._fixed_eye
        self._take(self._lab(fixed, [sheet]), fixed, folder / "fixed/0000.jpg", self.X_TO, self._X_TC, rng, gain=0.03)

    def write_push(self, number: int, push: StraightPush, folder: Path) -> None:
        """Write film and log of a push, and the truth of both.

        The log is in the robot's base, in mm and ms, and of a clock of its own.
        """
        rng = np.random.default_rng([self.seed, 4, number])
        offset = float(rng.uniform(-1.2, 1.2))
        rollout = self.roll_out(push)
        X_BT, log_t = self.X_BT, rollout.t
        steps = round(_BEFORE * LOG_RATE)
        rest = np.arange(1, steps + 1) / LOG_RATE
        t = np.concatenate([log_t[0] - rest[::-1], log_t, log_t[-1] + rest])
        p_TP = np.concatenate(
            [np.tile(rollout.p_WP[0], (steps, 1)), rollout.p_WP, np.tile(rollout.p_WP[-1], (steps, 1))]
        )
        p_BP = apply(X_BT, p_TP) + rng.normal(0, _LOG_NOISE, p_TP.shape)
        rows = np.column_stack([1e3 * (t + offset + 10.0), 1e3 * p_BP])
        np.savetxt(
            prepare_folder(folder) / "log.csv", rows, delimiter=",", header="stamp,x,y,z", comments="", fmt="%.4f"
        )
        fixed = self._fixed_eye
        lab, joints = self._lab(fixed), _GUESS
        size = self.fixed.width, self.fixed.height
        partial = self.truth / f"film_{number:04}.mp4"  # a run that is killed leaves no half of a film in the lab
        film = cv2.VideoWriter(str(partial), cv2.VideoWriter_fourcc(*"mp4v"), FRAME_RATE, size)  # type: ignore[attr-defined]
        if not film.isOpened():
            raise RuntimeError("OpenCV writes no MPEG-4 here")
        chosen = range(0, len(log_t), LOG_RATE // FRAME_RATE)
        for k in chosen:
            joints = lab.reach(rollout.p_WP[k], joints)
            name = self.truth / f"film_{number:04}/{k * FRAME_RATE // LOG_RATE:05}.png"
            film.write(self._shot(lab, fixed, name, rollout.X_WO[k], self._X_TC, rng, 0.006, joints)[..., ::-1])
        film.release()
        partial.replace(folder / "film.mp4")
        poses = np.array([rollout.X_WO[k].GetAsMatrix4() for k in chosen])
        np.savez(self.truth / f"push_{number:04}.npz", t=log_t[::10], X_TO=poses, offset=offset + 10.0)

    def roll_out(self, push: StraightPush) -> Rollout:
        """Roll out a push in the engine, at the times of the log, with rest before and after the motion."""
        late = dataclasses.replace(push, delay=_STILL)
        frames = int(np.ceil((late.end_time + _STILL) * FRAME_RATE)) + 1
        times = np.arange((frames - 1) * (LOG_RATE // FRAME_RATE) + 1) / LOG_RATE
        return engine(self._engine)(self.thing, self.theta, self.X_TO, Push(_SHAPE, late, frames), times)

    @cached_property
    def _fixed_eye(self) -> LensCamera:
        return LensCamera(self.fixed, self.sizes.finer)

    @property
    def _X_TC(self) -> RigidTransform:
        """Pose of the fixed camera."""
        return RigidTransform(inverse(self.X_BT) @ self.board.X_BC)

    def _lab(self, eye: LensCamera, sheets: list[tuple[str, np.ndarray, np.ndarray]] | None = None) -> Lab:
        case = Case("t_block", "painted", WOOD, self.seed)
        base = RigidTransform(inverse(self.X_BT))
        return Lab(case, self.truth / "scene", eye.camera, sheets=sheets or [], base=base, boxes=_BOXES)

    def _take(
        self,
        lab: Lab,
        eye: LensCamera,
        path: Path,
        X_TO: RigidTransform,
        X_TC: RigidTransform,
        rng: np.random.Generator,
        gain: float,
    ) -> None:
        """Write a photo, and the true mask of the object beside the truth."""
        label = self.truth / path.parent.name / f"{path.stem}.png"
        prepare_folder(path.parent)
        cv2.imwrite(
            str(path), self._shot(lab, eye, label, X_TO, X_TC, rng, gain)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92]
        )

    def _shot(
        self,
        lab: Lab,
        eye: LensCamera,
        label: Path,
        X_TO: RigidTransform,
        X_TC: RigidTransform,
        rng: np.random.Generator,
        gain: float,
        joints: np.ndarray | None = None,
    ) -> np.ndarray:
        """Picture (H, W, 3) uint8 by a lens, with noise; the object's true mask goes to a file."""
        colour, mask = lab.shoot(X_TO, X_TC) if joints is None else lab.shoot(X_TO, X_TC, joints)
        prepare_folder(label.parent)
        cv2.imwrite(str(label), eye.seen(255 * mask.astype(np.uint8)))
        return photo(eye.seen(colour), rng, gain)
