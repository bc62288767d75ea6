# SPDX-License-Identifier: MIT
"""Labs with photos of a ChArUco board, drawn through an exact lens, with noise, blur and JPEG, and a robot with noise.

Table and room have textures. Truth is known, so that a calibration of such a lab can be scored.
"""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import yaml

from pinwm_drake.capture.lens import Lens, LensModel
from pinwm_drake.spatial.rigid import apply, inverse, rigid
from pinwm_drake.station.board import Board
from pinwm_drake.station.lab import Mount

SAMPLES = 2  # along each side of a pixel, on the board
TEXELS = 4000.0  # of the board, per m
LENSES: dict[LensModel, tuple[list[float], list[float]]] = {
    "opencv": ([918.3, 916.9, 652.2, 352.9], [0.12, -0.28, 0.0006, -0.0009, 0.11]),
    "fisheye": ([566.0, 565.2, 645.3, 365.1], [0.025, -0.012, 0.004, -0.001]),
}
MIDDLE = np.array([0.55, 0.0, 0.0])  # of the workspace, m, robot's base
WORKSPACE = {"low": [0.4, -0.2, 0.0], "high": [0.7, 0.2, 0.12]}


@dataclass(eq=False)
class RenderedLab:
    """Truth of a lab, and the settings of its photos.

    Attributes:
        seed: Seed of all that is drawn.
        model: Model of the lens.
        mount: "fixed" or "hand".
        place_noise, turn_noise: Root mean squares of the robot's errors, m and degrees.
        printed: Scale of the print.
        numbers: Photos of the sets lens, robot and table.
        moved: X_CC', by which a fixed camera moves, and the number of its photo (robot, then table) from which on.
    """

    seed: int
    model: LensModel = "opencv"
    mount: Mount = "fixed"
    place_noise: float = 1e-3
    turn_noise: float = 0.1
    printed: float = 1.0
    numbers: tuple[int, int, int] = (12, 20, 4)
    moved: tuple[np.ndarray, int] | None = None
    textured: bool = True
    sigma: float = 3.0  # grey values
    blur: float = 0.7  # px
    board: Board = field(default_factory=Board)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        numbers, distortion = LENSES[self.model]
        scale = 1.0 + 0.03 * self.rng.normal()
        self.lens = Lens(1280, 720, self.model, np.array(numbers) * [scale, scale, 1, 1], np.array(distortion))
        self.tilt = np.radians(self.rng.uniform(-1.0, 1.0, 2))
        self.height = self.rng.uniform(-0.02, 0.02)
        self.X_BT = rigid([0.0, 0.0, self.height], [*self.tilt, 0.0])  # table, z up
        self._near = min(1.0, numbers[0] / LENSES["opencv"][0][0])  # a wider lens stands nearer
        eye = MIDDLE + self._near * (np.array([0.0, -0.75, 0.6]) + self.rng.uniform(-0.1, 0.1, 3))
        aim = MIDDLE + np.array([0.0, 0.0, 0.1]) + self.rng.uniform(-0.05, 0.05, 3)
        self.X_BC = look_at(eye, aim) @ rigid(w=[0.0, 0.0, self.rng.uniform(-0.2, 0.2)])  # fixed
        side = self.board.size
        grip = rigid(self.rng.uniform(-0.05, 0.05, 3), self.rng.uniform(-0.8, 0.8, 3))
        self.X_EM = grip @ rigid([-side[0] / 2, -side[1] / 2, 0.0])  # fixed: the board on the gripper
        self.X_EC = rigid([0.05, 0.02, 0.04], [0.05, -0.1, self.rng.uniform(-1.5, 1.5)])  # hand
        self.X_BM = self._on_table(MIDDLE[:2], self.rng.uniform(-3.0, 3.0))  # hand: the board on the table
        self._rays = self._all_rays()
        self._last: tuple[bytes, np.ndarray] | None = None  # the room of the last photo
        self._texture = self.board.opencv().generateImage(
            tuple(round(TEXELS * side) for side in self.board.size), marginSize=0, borderBits=1
        )
        rough = self.rng.uniform(70, 180, (256, 256)).astype(np.uint8)
        self._ground = cv2.resize(rough, (2048, 2048), interpolation=cv2.INTER_CUBIC)

    def _all_rays(self) -> np.ndarray:
        x, y = np.meshgrid(np.arange(self.lens.width) + 0.5, np.arange(self.lens.height) + 0.5)
        rays = self.lens.rays(np.column_stack([x.ravel(), y.ravel()]))
        return (
            np.column_stack([rays, np.ones(len(rays))]).reshape(self.lens.height, self.lens.width, 3).astype(np.float32)
        )

    def _on_table(self, place: np.ndarray, yaw: float) -> np.ndarray:
        """Pose X_BM (4, 4) of a board that lies on the table with its middle at a place (2,) [m]."""
        side = self.board.size
        flat = rigid([*place, 0.0], [0.0, 0.0, yaw]) @ rigid(w=[np.pi, 0.0, 0.0])
        return self.X_BT @ flat @ rigid([-side[0] / 2, -side[1] / 2, 0.0])

    def _before(self, near: float, far: float) -> np.ndarray:
        """Pose X_CM (4, 4) of a board in view, at a distance [m], tilted by 10 to 40 degrees."""
        rng, side = self.rng, self.board.size
        while True:
            depth = self._near * rng.uniform(near, far)
            centre = self.lens.rays(rng.uniform([0.2, 0.2], [0.8, 0.8], (1, 2)) * [self.lens.width, self.lens.height])
            axis = rng.normal(size=3)
            X = rigid(w=np.radians(rng.uniform(10, 40)) * axis / np.linalg.norm(axis)) @ rigid(
                w=[0.0, 0.0, rng.uniform(-3.1, 3.1)]
            )
            X[:3, 3] = depth * np.array([*centre[0], 1.0]) - X[:3, :3] @ [side[0] / 2, side[1] / 2, 0.0]
            corners = apply(X, self.board.corners_M)
            if corners[:, 2].min() > 0.1:
                pixels = self.lens.project(corners)
                if (pixels > 5).all() and (pixels < [self.lens.width - 5, self.lens.height - 5]).all():
                    return X

    def draw(self, X_CM: np.ndarray, X_BC: np.ndarray) -> np.ndarray:
        """Photo (height, width) uint8 of a board before table and room."""
        key = X_BC.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._room(X_BC)
        image = self._last[1].copy()
        outline = np.array([[0, 0, 0], [self.board.size[0], 0, 0], [*self.board.size, 0], [0, self.board.size[1], 0]])
        edge = np.linspace(outline, np.roll(outline, -1, 0), 9).reshape(-1, 3)
        pixels = self.lens.project(apply(X_CM, edge))
        (x0, y0), (x1, y1) = np.floor(pixels.min(0)).astype(int) - 12, np.ceil(pixels.max(0)).astype(int) + 12
        x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, self.lens.width), min(y1, self.lens.height)
        rays = cv2.resize(self._rays[y0:y1, x0:x1], None, fx=SAMPLES, fy=SAMPLES, interpolation=cv2.INTER_CUBIC)
        R, t = X_CM[:3, :3].astype(np.float32), X_CM[:3, 3].astype(np.float32)
        with np.errstate(divide="ignore"):
            depth = (R[:, 2] @ t) / (rays @ R[:, 2])
        p_M = (depth[..., None] * rays - t) @ R
        place = p_M[..., :2] * np.float32(TEXELS / self.printed) - np.float32(0.5)
        grey = cv2.remap(self._texture, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=255)
        margin, sides = np.float32(0.01), np.float32(np.array(self.board.size) * self.printed)
        on = ((p_M[..., :2] > -margin) & (p_M[..., :2] < sides + margin)).all(-1) & (depth > 0)
        behind = cv2.resize(image[y0:y1, x0:x1], None, fx=SAMPLES, fy=SAMPLES, interpolation=cv2.INTER_NEAREST)
        drawn = np.where(on, 0.8 * grey + 20.0, behind).astype(np.float32)
        image[y0:y1, x0:x1] = cv2.resize(drawn, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        image = cv2.GaussianBlur(image, (0, 0), self.blur) * self.rng.uniform(0.75, 1.1)
        return np.clip(image + self.sigma * self.rng.standard_normal(image.shape, np.float32), 0, 255).astype(np.uint8)

    def _room(self, X_BC: np.ndarray) -> np.ndarray:
        """Table and, above the horizon, walls far away: (height, width) float32."""
        if not self.textured:
            return np.full(self._rays.shape[:2], 120.0, np.float32)
        X_TC = inverse(self.X_BT) @ X_BC
        rays = self._rays @ X_TC[:3, :3].T
        down = rays[..., 2] < -1e-3
        depth = np.where(down, -X_TC[2, 3] / np.where(down, rays[..., 2], 1.0), 0.0)
        ground = (X_TC[:2, 3] + depth[..., None] * rays[..., :2]) * 500.0
        far = np.stack([np.arctan2(rays[..., 1], rays[..., 0]) * 600.0, rays[..., 2] * 300.0], -1)
        near = down & (depth < 3.0)
        place = np.where(near[..., None], ground, far).astype(np.float32) % 2047.0
        return cv2.remap(self._ground, place, None, cv2.INTER_LINEAR).astype(np.float32)

    def write(self, folder: Path) -> Path:
        """Write the lab's folder, photos included, and return it."""
        rng, rows = self.rng, []
        self.grippers: list[np.ndarray] = []  # true X_BE of the photos with poses
        lens, robot, table = self.numbers
        photos: list[tuple[str, np.ndarray, np.ndarray]] = []
        for k in range(lens):
            X_CM = self._before(0.3, 0.8)
            photos.append((f"lens/{k:04}.jpg", X_CM, self.X_BC))
        X_BC = self.X_BC
        for k in range(robot + table):
            if self.moved is not None and k == self.moved[1]:
                X_BC = X_BC @ self.moved[0]
            name = f"robot/{k:04}.jpg" if k < robot else f"table/{k - robot:04}.jpg"
            if k >= robot and self.mount == "fixed":
                X_BM = self._on_table(MIDDLE[:2] + rng.uniform(-0.08, 0.08, 2), rng.uniform(-3.0, 3.0))
                photos.append((name, inverse(X_BC) @ X_BM, X_BC))
                continue
            if self.mount == "fixed":
                X_CM = self._before(0.55, 0.95)
                X_BE = X_BC @ X_CM @ inverse(self.X_EM)
                photos.append((name, X_CM, X_BC))
            else:
                X_BM = self.X_BM if k < robot else self._on_table(MIDDLE[:2] + rng.uniform(-0.08, 0.08, 2), 0.0)
                X_CM = self._before(0.4, 0.7)
                X_BE = X_BM @ inverse(X_CM) @ inverse(self.X_EC)
                photos.append((name, X_CM, X_BE @ self.X_EC))
            error = rigid(
                rng.normal(size=3) * self.place_noise / np.sqrt(3),
                rng.normal(size=3) * np.radians(self.turn_noise) / np.sqrt(3),
            )
            rows.append((name, X_BE @ error))
            self.grippers.append(X_BE)
        self.shown = {name: X_CM for name, X_CM, _ in photos}  # true poses of the board in the camera
        for name, X_CM, X_photo in photos:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / name), self.draw(X_CM, X_photo), [cv2.IMWRITE_JPEG_QUALITY, 92])
        with (folder / "robot.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["file", "x", "y", "z", "rx", "ry", "rz"])
            for name, X in rows:
                turned = cv2.Rodrigues(np.ascontiguousarray(X[:3, :3]))[0].ravel()
                writer.writerow([name, *(f"{v:.6f}" for v in [*(1e3 * X[:3, 3]), *np.degrees(turned)])])
        document = {
            "schema_version": 1,
            "ruler": 0.1 * self.printed,
            "board": {"squares": list(self.board.squares), "square": self.board.square, "marker": self.board.marker},
            "lens": self.model,
            "mount": self.mount,
            "robot": {"length": "mm", "angle": "deg"},
            "workspace": WORKSPACE,
        }
        (folder / "lab.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
        return folder


def look_at(p_BC: np.ndarray, p_BT: np.ndarray) -> np.ndarray:
    """Pose X_BC (4, 4) of a camera at p_BC (3,) [m] that looks at p_BT (3,) [m], without roll."""
    z = (p_BT - p_BC) / np.linalg.norm(p_BT - p_BC)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.stack([x, np.cross(z, x), z], 1), p_BC
    return X
