# SPDX-License-Identifier: MIT
"""Rendered labs: table with grain, room, clutter, lamp with shadow, arm and object, and photos of them with noise.

Cameras are reported 1 mm and 0.1 degrees off. Photos have noise, blur, changing gains and JPEG. Motions of films are
made up: the object slides ahead of the rod and turns. Drake's VTK renderer draws, through the camera of captures.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh
from pydrake.geometry import (
    Box,
    LightParameter,
    Mesh,
    RenderEngineVtkParams,
    Rgba,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.solvers import Solve
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.models import model_path, object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion
from pinwm_drake.systems.cameras.object_camera import AddCaptureRig

logging.getLogger("drake").setLevel(logging.ERROR)  # it tells that meshes with textures keep them
WOOD, STEEL, WHITE = (178, 138, 96), (140, 140, 145), (200, 196, 188)  # colours of tables, sRGB
_LOOKS = {"white": (0.85, 0.85, 0.83), "grey": (0.45, 0.46, 0.48), "blue": (0.15, 0.3, 0.7)}
_PARKED = np.array([0.0, -1.2, 0.0, -1.6, 0.0, 0.8, 0.0])  # rad, joints of the arm
TIP = 0.01  # m, radius
_BASE = RigidTransform([-0.62, 0, 0])  # of the arm
_MIDDLE = (0.0, 0.0, 0.03)  # m, of the object on the table


@dataclass(frozen=True)
class Case:
    """Object, its look ("painted", "table" for the table's colour, or one of `_LOOKS`), the table and a seed."""

    object: str
    look: str
    table: tuple[int, int, int]
    seed: int

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.object}_{self.look}"


CASES = (
    Case("t_block", "painted", WOOD, 0),
    Case("t_block", "blue", STEEL, 1),
    Case("t_block", "table", WOOD, 2),
    Case("mug_handle", "white", WOOD, 3),
    Case("mug_handle", "painted", STEEL, 4),
    Case("mug", "white", STEEL, 5),
    Case("cube", "grey", WOOD, 6),
    Case("cube", "painted", WHITE, 7),
)


def grain(seed: int, base: Sequence[int], size: int = 1024) -> np.ndarray:
    """Picture of a table with grain and joints, (size, size, 3) uint8."""
    rng = np.random.default_rng(seed)
    x = np.mgrid[0:size, 0:size][1] / size
    warp = cv2.GaussianBlur(rng.normal(size=(size, size)).astype(np.float32), (0, 0), 40)
    warp /= warp.std()
    shade = 0.10 * np.sin((30 * x + 0.8 * warp) * 2 * np.pi) + 0.08 * np.sin((7 * x + 0.5 * warp) * 2 * np.pi)
    shade += rng.normal(0, 0.03, (size, size))
    for k in range(8):
        shade[:, k * size // 8 : k * size // 8 + 3] -= 0.25
    return np.clip(np.array(base) * (1 + shade[..., None]), 0, 255).astype(np.uint8)


def clutter(seed: int, size: int = 1024) -> np.ndarray:
    """Picture of rectangles in many colours, (size, size, 3) uint8."""
    rng = np.random.default_rng(seed)
    picture = np.full((size, size, 3), rng.integers(90, 200, 3), np.uint8)
    for _ in range(60):
        colour, corner = rng.integers(20, 240, 3).tolist(), rng.integers(0, size, 2)
        cv2.rectangle(picture, corner.tolist(), (corner + rng.integers(20, 260, 2)).tolist(), colour, -1)
    return cv2.GaussianBlur(picture, (0, 0), 2)


def _quad(path: Path, picture: np.ndarray, corners: Sequence[Sequence[float]]) -> Mesh:
    """Rectangle with a picture, from four corners [m]."""
    cv2.imwrite(str(path.with_suffix(".png")), picture[..., ::-1])
    path.with_suffix(".mtl").write_text(f"newmtl m\nKd 1 1 1\nKs 0 0 0\nmap_Kd {path.stem}.png\n")
    c = np.array(corners, float)
    normal = np.cross(c[1] - c[0], c[2] - c[0])
    normal /= np.linalg.norm(normal)
    lines = [f"mtllib {path.stem}.mtl", *("v {} {} {}".format(*p) for p in c), "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines += ["vn {} {} {}".format(*normal), "usemtl m", "f 1/1/1 2/2/1 3/3/1 4/4/1", ""]
    path.with_suffix(".obj").write_text("\n".join(lines))
    return Mesh(str(path.with_suffix(".obj")))


class Lab:
    """A lab with an object and an arm, in Drake.

    Args:
        case: What stands on the table.
        folder: Folder for meshes and textures.
        camera: Camera of the photos.
        others: Further objects: name, colour and place in the world each.
        sheets: Rectangles with a picture, on the table: name, picture (H, W, 3) uint8, four corners [m] each.
        base: Pose of the arm's base.
        boxes: m, distances of the boxes from the middle of the table.
    """

    def __init__(
        self,
        case: Case,
        folder: Path,
        camera: Camera,
        others: Sequence[tuple[str, str, RigidTransform]] = (),
        *,
        sheets: Sequence[tuple[str, np.ndarray, np.ndarray]] = (),
        base: RigidTransform = _BASE,
        boxes: tuple[float, float] = (0.26, 0.5),
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(case.seed)
        builder = DiagramBuilder()
        self.plant, graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        self.mesh = trimesh.load(object_model(case.object).mesh_path, force="mesh")
        self._fill(case, folder, rng, boxes)
        for name, picture, corners in sheets:
            self._visual(name, _quad(folder / name, picture, corners), RigidTransform())
        self.body = self.plant.AddRigidBody("object", SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.05)))
        self._look(case, folder)
        for k, (name, look, X_WO) in enumerate(others):
            shape = Mesh(str(object_model(name).mesh_path))
            self._visual(f"other{k}", shape, X_WO, _LOOKS[look])
        self.arm = Parser(self.plant).AddModels(str(model_path("arm/iiwa14.sdf")))[0]
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("base", self.arm), base)
        tip = RigidTransform([0, 0, 0.35])
        rod = self.plant.GetBodyByName("rod", self.arm)
        self.plant.RegisterVisualGeometry(rod, tip, Sphere(TIP), "tip", np.array([0.3, 0.3, 0.32, 1.0]))
        self.plant.Finalize()
        self.rig = AddCaptureRig(builder, graph, camera, 1, renderer=_renderer())
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self._plant_context = self.plant.GetMyMutableContextFromRoot(self.context)

    def _visual(self, name: str, shape: object, X_W: RigidTransform, colour: Sequence[float] = (1, 1, 1)) -> None:
        self.plant.RegisterVisualGeometry(self.plant.world_body(), X_W, shape, name, np.array([*colour, 1.0]))

    def _fill(self, case: Case, folder: Path, rng: np.random.Generator, boxes: tuple[float, float]) -> None:
        """Table, floor, walls, and boxes around the object."""
        seed = case.seed
        table = [[-0.9, -0.7, 0], [0.9, -0.7, 0], [0.9, 0.7, 0], [-0.9, 0.7, 0]]
        self._visual("table", _quad(folder / "table", grain(seed, case.table), table), RigidTransform())
        ground = [[-4, -4, -0.75], [4, -4, -0.75], [4, 4, -0.75], [-4, 4, -0.75]]
        self._visual("ground", _quad(folder / "ground", clutter(seed + 50), ground), RigidTransform())
        ends = ((-2, 2), (2, 2), (2, -2), (-2, -2))
        for k in range(4):
            a, b = ends[k], ends[(k + 1) % 4]
            wall = [[*a, -0.75], [*b, -0.75], [*b, 1.8], [*a, 1.8]]
            self._visual(f"wall{k}", _quad(folder / f"wall{k}", clutter(7 * seed + k), wall), RigidTransform())
        for k in range(5):
            angle, far, size = rng.uniform(0, 2 * np.pi), rng.uniform(*boxes), rng.uniform(0.02, 0.08, 3)
            place = [far * np.cos(angle), far * np.sin(angle), size[2] / 2]
            X_W = RigidTransform(RotationMatrix.MakeZRotation(rng.uniform(0, 3)), place)
            self._visual(f"box{k}", Box(*size), X_W, rng.uniform(0.1, 0.9, 3).tolist())

    def _look(self, case: Case, folder: Path) -> None:
        """Register the object, painted or in one colour with flat faces."""
        if case.look == "painted":
            shape, colour = Mesh(str(object_model(case.object).visual_path)), (1.0, 1.0, 1.0)
        else:
            colour = tuple(v / 255 for v in case.table) if case.look == "table" else _LOOKS[case.look]
            corners = self.mesh.vertices[self.mesh.faces].reshape(-1, 3)
            lines = ["v {} {} {}".format(*p) for p in corners] + [
                "vn {} {} {}".format(*n) for n in self.mesh.face_normals
            ]
            lines += [
                f"f {3 * i + 1}//{i + 1} {3 * i + 2}//{i + 1} {3 * i + 3}//{i + 1}" for i in range(len(self.mesh.faces))
            ]
            path = folder / "flat.obj"
            path.write_text("\n".join(lines) + "\n")
            shape = Mesh(str(path))
        self.plant.RegisterVisualGeometry(self.body, RigidTransform(), shape, "object", np.array([*colour, 1.0]))

    def reach(self, p_WP: Sequence[float], guess: np.ndarray) -> np.ndarray:
        """Joint angles (7,) [rad] of the arm with its rod's tip at p_WP [m], pointing down."""
        problem = InverseKinematics(self.plant, True)
        world, tip = self.plant.world_frame(), self.plant.GetFrameByName("tip", self.arm)
        target = np.array(p_WP, float)
        problem.AddPositionConstraint(tip, np.zeros(3), world, target - 5e-5, target + 5e-5)
        problem.AddOrientationConstraint(world, RotationMatrix(), tip, RotationMatrix(), 0.002)
        joints = [self.plant.get_joint(k) for k in self.plant.GetJointIndices(self.arm)]
        rows = [joint.position_start() for joint in joints if joint.num_positions() == 1]
        start = self.plant.GetPositions(self._plant_context).copy()
        start[rows] = guess
        problem.prog().AddQuadraticErrorCost(np.eye(7), guess, problem.q()[rows])
        result = Solve(problem.prog(), start)
        if not result.is_success():
            raise RuntimeError(f"the arm does not reach {p_WP}")
        return result.GetSolution(problem.q())[rows]

    def take(self, X_WO: RigidTransform, X_WC: RigidTransform, joints: np.ndarray = _PARKED) -> tuple[np.ndarray, ...]:
        """Take a picture as `shoot` does, and depth (H, W) float32 [m]."""
        picture, label = self.shoot(X_WO, X_WC, joints)
        mine = self.rig.sensor.GetMyContextFromRoot(self.context)
        return picture, label, np.array(self.rig.sensor.depth_image_32F_output_port().Eval(mine).data)[..., 0]

    def shoot(
        self, X_WO: RigidTransform, X_WC: RigidTransform, joints: np.ndarray = _PARKED
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take a picture: (H, W, 3) uint8, and where the object is (H, W) bool."""
        self.plant.SetPositions(self._plant_context, self.arm, joints)
        self.plant.SetFreeBodyPose(self._plant_context, self.body, X_WO)
        mine = self.rig.sensor.GetMyMutableContextFromRoot(self.context)
        self.rig.sensor.SetX_PB(mine, X_WC)
        colour = np.array(self.rig.sensor.color_image_output_port().Eval(mine).data)[..., :3]
        label = np.asarray(self.rig.sensor.label_image_output_port().Eval(mine).data)[..., 0]
        return colour, label == int(self.body.index())


def _renderer() -> RenderEngineVtkParams:
    """Lamp that throws shadows, light from a window, and light at the camera."""
    lamp, window = np.array([-0.8, 0.6, -1.6]), np.array([0.3, 0.5, -1.0])
    white = Rgba(1, 1, 1)
    lights = [
        LightParameter(
            type="spot", color=white, position=-lamp, direction=lamp / np.linalg.norm(lamp), frame="world",
            intensity=0.85, cone_angle=60.0, attenuation_values=[1, 0, 0],
        ),
        LightParameter(
            type="directional", color=white, direction=window / np.linalg.norm(window), frame="world", intensity=0.25
        ),
        LightParameter(
            type="point", color=white, position=np.zeros(3), frame="camera", intensity=0.35,
            attenuation_values=[1, 0, 0],
        ),
    ]  # fmt: skip
    grey = np.array([0.6, 0.6, 0.62])
    return RenderEngineVtkParams(default_clear_color=grey, lights=lights, cast_shadows=True, shadow_map_size=1024)


def looking(p_WC: Sequence[float], p_WT: Sequence[float], roll: float = 0.0) -> RigidTransform:
    """Pose of a camera (OpenCV axes) that looks at a point."""
    z = np.array(p_WT) - p_WC
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    R_WC = np.stack([x, np.cross(z, x), z], 1) @ RotationMatrix.MakeZRotation(roll).matrix()
    return RigidTransform(RotationMatrix(R_WC), p_WC)


def ring(
    number: int,
    low: float,
    high: float,
    rng: np.random.Generator,
    far: float = 0.45,
    middle: Sequence[float] = _MIDDLE,
) -> list[RigidTransform]:
    """Poses of cameras around a place on the table, between two elevations [deg], as a hand would hold them."""
    poses = []
    for k in range(number):
        elevation = np.radians(low + (high - low) * ((0.618 * k) % 1))
        angle = 2 * np.pi * k / number + rng.normal(0, 0.1)
        out = [np.cos(elevation) * np.cos(angle), np.cos(elevation) * np.sin(angle), np.sin(elevation)]
        at = np.array(middle) + far * (1 + rng.normal(0, 0.04)) * np.array(out)
        poses.append(looking(at, middle + rng.normal(0, 0.012, 3), rng.normal(0, 0.06)))
    return poses


def photo(picture: np.ndarray, rng: np.random.Generator, gain: float = 0.03) -> np.ndarray:
    """Picture (H, W, 3) uint8 with blur, gains of colours and exposure, and noise."""
    soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.6)
    soft *= 1 + 0.4 * rng.normal(0, gain, 3) + rng.normal(0, gain)
    return np.clip(soft + rng.normal(0, 2.5, soft.shape), 0, 255).astype(np.uint8)


def disturbed(X_WC: RigidTransform, rng: np.random.Generator, place: float = 1e-3, turn: float = 0.1) -> RigidTransform:
    """Pose that is off by a place [m] and a turn [deg], root mean squares."""
    turned, _ = cv2.Rodrigues(rng.normal(0, np.radians(turn) / np.sqrt(3), 3))
    moved = X_WC.translation() + rng.normal(0, place / np.sqrt(3), 3)
    return RigidTransform(X_WC.rotation() @ RotationMatrix(turned), moved)


def as_pose(X: RigidTransform) -> Pose:
    """Return a pose of Drake as one of the package."""
    return Pose(matrix_to_quaternion(torch.tensor(X.rotation().matrix())), torch.tensor(X.translation()))
