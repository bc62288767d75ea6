# SPDX-License-Identifier: MIT
"""Film and log of a push in a rendered laboratory: an arm with a rod, table, clutter, shadows, and noise."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch
import trimesh
from pydrake.geometry import (
    Box,
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    Mesh,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from pinwm_drake.models import OBJECT_NAMES, object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion
from pinwm_drake.systems.arm.model import ArmModel, add_arm

WIDTH, HEIGHT = 640, 480
RADIUS = 0.01  # m, of the pusher, a sphere at the rod's end
_HIGH = 0.03  # m, of its middle


@dataclass(frozen=True, eq=False)
class FilmedPush:
    """Film and log of a push, and what is true of them.

    Attributes:
        frames: (n, H, W, 3) uint8, sRGB.
        t: (n,) [s], by the film's clock.
        log_t: (m,) [s], by the log's clock.
        p_WP: (m, 3) [m], logged positions of the pusher.
        camera, X_WC: Camera as it is calibrated: about 1 mm and 0.1 degrees off.
        offset: s, time of the log's clock less that of the film's.
        other: Log of another push in the same laboratory: times (k,) [s] and positions (k, 3) [m].
    """

    frames: np.ndarray
    t: np.ndarray
    log_t: np.ndarray
    p_WP: np.ndarray
    camera: Camera
    X_WC: Pose
    offset: float
    other: tuple[np.ndarray, np.ndarray]


def film_push(seed: int) -> FilmedPush:
    """Film a push: object, table, lamps, camera, speeds, rates, noise and clock are drawn from a seed."""
    random = np.random.default_rng(seed)
    focal, offset = random.uniform(480, 760), random.uniform(-1.5, 1.5)
    X_WC = _look_at(_eye(random), np.array([0, 0, 0.02]) + random.normal(0, 0.015, 3), random.normal(0, 0.05))
    camera = Camera(WIDTH, HEIGHT, torch.tensor([focal, focal, WIDTH / 2, HEIGHT / 2], dtype=torch.float64))
    push = _Push(random)
    t = np.arange(0.0, push.duration, 1 / random.choice([15.0, 24.0, 30.0, 60.0]))
    log_t, p_WP = push.log(random)
    other_t, p_WQ = _Push(random).log(random)
    with TemporaryDirectory() as folder:
        laboratory, frames = _Laboratory(random, Path(folder)), []
        for time in t + random.normal(0, 3e-4, len(t)):
            picture = laboratory.picture(push.place(np.array([time]))[0], push.ahead, X_WC, focal)
            frames.append(_noisy(picture, random))
    calibrated = _pose(_shaken(X_WC, random))
    return FilmedPush(np.array(frames), t, log_t + offset, p_WP, camera, calibrated, offset, (other_t + offset, p_WQ))


class _Push:
    """Motion of the pusher along a line, from rest to rest; the film is `duration` [s] long."""

    def __init__(self, random: np.random.Generator) -> None:
        angle = random.uniform(0, 2 * np.pi)
        self.ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
        aside = random.uniform(-0.02, 0.02) * np.array([-self.ahead[1], self.ahead[0], 0.0])
        self.start = aside - self.ahead * random.uniform(0.1, 0.13) + [0, 0, _HIGH]
        still, length, speed = random.uniform(0.05, 0.6), random.uniform(0.1, 0.18), random.uniform(0.08, 0.25)
        kind, moving = random.integers(3), length / speed
        self.duration = min(still + 1.6 * moving + random.uniform(0.1, 0.5), 2.5)
        self._t = np.linspace(-3.0, 8.0, 22001)
        since = self._t - still
        if kind == 0:  # ramps
            up, down = random.uniform(0.05, 0.3, 2)
            v = speed * np.clip(since / up, 0, 1) * np.clip((moving + up - since) / down, 0, 1)
        elif kind == 1:  # least jerk
            s = np.clip(since / (1.5 * moving), 0, 1)
            v = length / (1.5 * moving) * 30 * (s * (1 - s)) ** 2
        else:  # a controller that closes in
            v = np.where(since > 0, length / 0.35 * np.exp(-np.maximum(since, 0) / 0.35), 0.0)
        self._way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(self._t))])

    def place(self, t: np.ndarray) -> np.ndarray:
        """Position (n, 3) [m] at times (n,) [s]."""
        return self.start + np.interp(t, self._t, self._way)[:, None] * self.ahead

    def log(self, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Log with noise: times (m,) [s] from before the film to after it, and positions (m, 3) [m]."""
        before, after = random.uniform(0.1, 2.0, 2)
        t = np.arange(-before, self.duration + after, 1 / random.choice([50.0, 100.0, 125.0, 250.0, 500.0]))
        return t, self.place(t) + random.normal(0, random.choice([3e-5, 1e-4, 3e-4]), (len(t), 3))


class _Laboratory:
    """Drake's scene: table, clutter, object, and the arm with a rod that ends in the pusher."""

    def __init__(self, random: np.random.Generator, folder: Path) -> None:
        builder = DiagramBuilder()
        plant, self._graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        self._graph.AddRenderer(
            "vtk",
            MakeRenderEngineVtk(
                RenderEngineVtkParams(
                    default_clear_color=[0.6, 0.6, 0.62],
                    lights=_lights(random),
                    cast_shadows=True,
                    shadow_map_size=1024,
                )
            ),
        )
        world = plant.world_body()
        table = _sheet(folder, "table", _wood(random), 0.9, 0.0)
        ground = _sheet(folder, "ground", _patches(random), 4.0, -0.75)
        for name, sheet in (("table", table), ("ground", ground)):
            plant.RegisterVisualGeometry(world, RigidTransform(), Mesh(str(sheet)), name, np.ones(4))
        for k in range(6):
            angle, far, size = random.uniform(0, 2 * np.pi), random.uniform(0.28, 0.5), random.uniform(0.02, 0.08, 3)
            place = [far * np.cos(angle), far * np.sin(angle), size[2] / 2]
            X = RigidTransform(RotationMatrix.MakeZRotation(random.uniform(0, 3)), place)
            plant.RegisterVisualGeometry(world, X, Box(*size), f"thing{k}", np.append(random.uniform(0.1, 0.9, 3), 1))
        model = object_model(str(random.choice(OBJECT_NAMES)))
        self._vertices = trimesh.load(model.mesh_path, force="mesh").vertices
        self._body = plant.AddRigidBody("object", SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.05)))
        plant.RegisterVisualGeometry(self._body, RigidTransform(), Mesh(str(model.visual_path)), "object", np.ones(4))
        self._arm, tool = add_arm(plant, 0.0)
        plant.RegisterVisualGeometry(
            tool.body(), tool.GetFixedPoseInBodyFrame(), Sphere(RADIUS), "pusher", np.append(random.uniform(0, 1, 3), 1)
        )
        plant.Finalize()
        self._plant, self._diagram = plant, builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._kinematics = ArmModel(0.0, _HIGH)
        self._yaw, self._turn = random.uniform(-3, 3), random.uniform(-4, 4)

    def picture(self, p_WP: np.ndarray, ahead: np.ndarray, X_WC: RigidTransform, focal: float) -> np.ndarray:
        """Picture (H, W, 3) uint8 with the pusher at p_WP (3,) [m]; it shoves the object along `ahead` and turns it."""
        context = self._plant.GetMyMutableContextFromRoot(self._context)
        V = RotationMatrix.MakeZRotation(self._yaw).matrix() @ self._vertices.T
        face = float((ahead @ V).min())
        pushed = max(float(p_WP @ ahead) + RADIUS - face, 0.0)
        X_WO = RigidTransform(
            RotationMatrix.MakeZRotation(self._yaw + self._turn * pushed), ahead * pushed - [0, 0, V[2].min()]
        )
        self._plant.SetFreeBodyPose(context, self._body, X_WO)
        self._plant.SetPositions(context, self._arm, self._kinematics.positions(p_WP))
        query = self._graph.get_query_output_port().Eval(self._graph.GetMyContextFromRoot(self._context))
        info = CameraInfo(WIDTH, HEIGHT, focal, focal, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5)
        core = RenderCameraCore("vtk", info, ClippingRange(0.02, 20.0), RigidTransform())
        image = query.RenderColorImage(ColorRenderCamera(core, False), self._graph.world_frame_id(), X_WC)
        return np.array(image.data)[..., :3].copy()


def _lights(random: np.random.Generator) -> list[LightParameter]:
    place = np.array([random.uniform(-1, 1), random.uniform(-1, 0.2), random.uniform(1.2, 1.9)])
    common = {"color": Rgba(1, 1, 1), "attenuation_values": [1, 0, 0]}
    return [
        LightParameter(
            type="spot",
            position=place,
            direction=-place / np.linalg.norm(place),
            frame="world",
            intensity=random.uniform(0.5, 0.9),
            cone_angle=60.0,
            **common,
        ),
        LightParameter(type="directional", direction=[0.26, 0.44, -0.86], frame="world", intensity=0.3, **common),
        LightParameter(type="point", position=[0, 0, 0], frame="camera", intensity=0.35, **common),
    ]


def _wood(random: np.random.Generator, side: int = 1024) -> np.ndarray:
    _rows, columns = np.mgrid[0:side, 0:side] / side
    bend = cv2.GaussianBlur(random.normal(size=(side, side)).astype(np.float32), (0, 0), 40)
    grain = 0.1 * np.sin(2 * np.pi * (30 * columns + 0.8 * bend / bend.std())) + random.normal(0, 0.03, (side, side))
    base = np.array([(178, 138, 96), (140, 140, 145), (200, 196, 188), (60, 60, 65)][random.integers(4)])
    return np.clip(base * (1 + grain[..., None]), 0, 255).astype(np.uint8)


def _patches(random: np.random.Generator, side: int = 1024) -> np.ndarray:
    picture = np.full((side, side, 3), random.integers(90, 200, 3), np.uint8)
    for _ in range(60):
        corner = random.integers(0, side, 2)
        cv2.rectangle(
            picture,
            corner.tolist(),
            (corner + random.integers(20, 260, 2)).tolist(),
            random.integers(20, 240, 3).tolist(),
            -1,
        )
    return cv2.GaussianBlur(picture, (0, 0), 2)


def _sheet(folder: Path, name: str, picture: np.ndarray, half: float, height: float) -> Path:
    """Write a level square with a picture on it, of half a side [m] at a height [m]; return its mesh."""
    cv2.imwrite(str(folder / f"{name}.png"), picture)
    (folder / f"{name}.mtl").write_text(f"newmtl m\nKd 1 1 1\nKs 0 0 0\nmap_Kd {name}.png\n")
    corners = "".join(f"v {x * half} {y * half} {height}\n" for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    rest = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nusemtl m\nf 1/1/1 2/2/1 3/3/1 4/4/1\n"
    (folder / f"{name}.obj").write_text(f"mtllib {name}.mtl\n{corners}{rest}")
    return folder / f"{name}.obj"


def _eye(random: np.random.Generator) -> np.ndarray:
    far, up, around = (
        random.uniform(0.5, 0.75),
        np.radians(random.uniform(30, 60)),
        np.radians(random.uniform(-140, -40)),
    )
    return far * np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def _look_at(eye: np.ndarray, target: np.ndarray, roll: float) -> RigidTransform:
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    R = RotationMatrix(np.stack([x, np.cross(z, x), z], axis=1))
    return RigidTransform(R @ RotationMatrix.MakeZRotation(roll), eye)


def _shaken(X_WC: RigidTransform, random: np.random.Generator) -> RigidTransform:
    """Pose that is 1 mm and 0.1 degrees off (rms)."""
    turn = cv2.Rodrigues(random.normal(0, np.radians(0.1) / np.sqrt(3), 3))[0]
    return RigidTransform(
        X_WC.rotation() @ RotationMatrix(turn), X_WC.translation() + random.normal(0, 1e-3 / np.sqrt(3), 3)
    )


def _pose(X: RigidTransform) -> Pose:
    R = torch.tensor(X.rotation().matrix())
    return Pose(matrix_to_quaternion(R), torch.tensor(X.translation()))


def _noisy(picture: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Picture with blur, flicker, noise and JPEG's losses."""
    blurred = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.6) * (1 + random.normal(0, 0.006))
    noisy = np.clip(blurred + random.normal(0, 2.5, picture.shape), 0, 255).astype(np.uint8)
    coded = cv2.imencode(".jpg", noisy[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    return np.ascontiguousarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1])
