"""What `pinwm capture simulate` does: sets the scene up, runs it, and writes the capture."""

import math
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np
import torch
import trimesh
import yaml
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from pinwm_drake.capture.scene import PUSHER_KINDS, PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_transforms
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.models import OBJECT_NAMES, object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.collision_mesh import triangle_mesh
from pinwm_drake.systems.push_choice import choose_push
from pinwm_drake.systems.push_recorder import MakePushRecorder, PushRecorder, Rates
from pinwm_drake.systems.push_scene import PushScene
from pinwm_drake.systems.viewpoints import around, framed

GROUND_TRUTH_FILE = "ground_truth.yaml"
_FIELD_OF_VIEW = math.radians(40)
_STATIC_MARGIN, _EPISODE_MARGIN = 0.12, 0.12  # of the image, free on each side of the object
_PUSHER_LENGTH = 0.06  # m, of the straight part of a capsule or cylinder
_CLEARANCE = 0.004  # m, between floor and pusher
_COASTING = 0.012  # m
_GRAVITY = 9.81  # m/s^2
_SLOWEST, _FASTEST = 0.12, 0.4  # m/s, of a push whose speed is not given
_RECORD_RATE = 240.0  # Hz, the lowest of the pusher's log
_LONGEST_STEP = 1 / 3800  # s
_BOUNCING_STEPS = 2  # times more of them where an impact of some 3 ms is to keep its energy


@dataclass(frozen=True)
class SimulateOptions:
    """The options of `pinwm capture simulate`, named and in units as there.

    Raises:
        ParameterError: One is out of range.
    """

    object_name: str
    friction: float
    pusher_friction: float
    mass: float
    restitution: float
    seed: int
    size: int
    episodes: int
    static_views: int
    frames: int
    rate: float
    speed: float
    distance: float
    pusher: str
    pusher_radius: float
    lying: bool
    supersampling: int

    def __post_init__(self) -> None:
        """Checks what `PushScene` does not."""
        _require("--object", self.object_name, self.object_name in OBJECT_NAMES, ", ".join(OBJECT_NAMES))
        _require("--lying", self.lying, not self.lying or self.object_name == "mug", "with --object mug only")
        _require("--seed", self.seed, 0 <= self.seed < 2**63, "0 or more")
        _require("--size", self.size, 16 <= self.size <= 2048, "16 to 2048 px")
        _require("--episodes", self.episodes, 0 <= self.episodes <= 1000, "0 to 1000")
        _require("--static-views", self.static_views, 1 <= self.static_views <= 1000, "1 to 1000")
        _require("--frames", self.frames, 2 <= self.frames <= 10000, "2 to 10000")
        _require("--rate", self.rate, 1 <= self.rate <= 240, "1 to 240 Hz")
        _require("--speed", self.speed, 0.01 <= self.speed <= 0.5, "0.01 to 0.5 m/s")
        _require("--distance", self.distance, 0.005 <= self.distance <= 0.5, "0.005 to 0.5 m")
        _require("--pusher", self.pusher, self.pusher in PUSHER_KINDS, ", ".join(PUSHER_KINDS))
        _require("--supersampling", self.supersampling, 1 <= self.supersampling <= 8, "1 to 8")

    @property
    def rates(self) -> Rates:
        """How often what happens."""
        records = math.ceil(_RECORD_RATE / self.rate)
        steps = math.ceil(1 / (self.rate * records * _LONGEST_STEP))
        return Rates(self.rate, records, steps if self.restitution == 0 else _BOUNCING_STEPS * steps)

    @property
    def shape(self) -> PusherShape:
        """The pusher's."""
        kind = cast(Literal["sphere", "capsule", "cylinder"], self.pusher)
        return PusherShape(kind, self.pusher_radius, 0.0 if kind == "sphere" else _PUSHER_LENGTH)

    @property
    def scene(self) -> PushScene:
        """What there is."""
        model = object_model(self.object_name)
        return PushScene(
            mesh_path=model.mesh_path,
            visual_path=model.visual_path,
            mass=self.mass,
            friction_floor=self.friction,
            friction_pusher=self.pusher_friction,
            restitution=self.restitution,
            pusher=self.shape,
            time_step=self.rates.time_step,
            reference_speed=self.speed,
        )


def coasting_speed(friction: float) -> float:
    """Speed of a pusher [m/s] after which an object coasts on by v^2 / 2 mu g = 12 mm: what shows its friction.

    An object that stops with the pusher shows only that its friction is large enough.
    """
    return min(max(math.sqrt(2 * max(friction, 0.0) * _GRAVITY * _COASTING), _SLOWEST), _FASTEST)


def run_simulate(out: Path, options: SimulateOptions) -> None:
    """Simulates a capture and writes it.

    Args:
        out: Its folder: not there yet, or empty. It appears when all is done.
        options: What is simulated.

    Raises:
        PinwmError: An option is refused, or a file cannot be written.
    """
    console = Console()
    scene = options.scene
    with _appearing(out) as folder:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as progress:
            total = options.static_views + options.episodes * options.frames
            task = progress.add_task("getting ready", total=total)
            _Capture(folder, options, scene).write(
                lambda what: progress.update(task, description=what), lambda: progress.advance(task)
            )
            progress.update(task, description="images")
    console.print(f"wrote {out}", highlight=False, soft_wrap=True)


class _Capture:
    """A capture in the making."""

    def __init__(self, folder: Path, options: SimulateOptions, scene: PushScene) -> None:
        self.folder, self.options, self.scene = folder, options, scene
        self.mesh = load_mesh(scene.mesh_path)
        focal = 0.5 * options.size / math.tan(0.5 * _FIELD_OF_VIEW)
        middle = 0.5 * options.size
        self.camera = Camera(
            options.size, options.size, torch.tensor([focal, focal, middle, middle], dtype=torch.float64)
        )
        self.recorder: PushRecorder = MakePushRecorder(scene, options.rates, self.camera, options.supersampling)
        self.generator = np.random.default_rng([options.seed, 0])
        self.X_WO = self.recorder.settle(self._first_pose())

    def write(self, describe: Callable[[str], None], advance: Callable[[], None]) -> None:
        """Writes everything; `describe` hears what is being done, `advance` of every image."""
        (self.folder / "meshes").mkdir()
        shutil.copyfile(self.scene.mesh_path, self.folder / "meshes/object.obj")
        _write_mesh(self.folder / "meshes/pusher.obj", triangle_mesh(self.scene.pusher))
        write_capture_yaml(
            self.folder,
            name=self.options.object_name,
            mesh="meshes/object.obj",
            mass=self.options.mass,
            X_WO=_pose(self.X_WO),
            pusher_mesh="meshes/pusher.obj",
            pusher_shape=self.scene.pusher,
            floor_height=0.0,
            gravity=self.scene.gravity,
        )
        describe("static views")
        self._write_static_views(advance)
        for k in range(self.options.episodes):
            describe(f"episode {k:04d}")
            self._write_episode(k, advance)
        self._write_ground_truth()

    def _first_pose(self) -> RigidTransform:
        """Where the object is put: near the origin, turned at random, on the floor."""
        yaw, x, y = self.generator.uniform([-math.pi, -0.02, -0.02], [math.pi, 0.02, 0.02])
        R_WO = RotationMatrix.MakeZRotation(yaw)
        if self.options.lying:
            # Turned by half a facet, the mug lies on a face and not on an edge.
            R_WO = R_WO @ RotationMatrix.MakeYRotation(math.pi / 2) @ RotationMatrix.MakeZRotation(math.pi / 64)
        heights = self.mesh.vertices @ R_WO.matrix()[2]
        return RigidTransform(R_WO, [x, y, -heights.min()])

    def _write_static_views(self, advance: Callable[[], None]) -> None:
        folder = self.folder / "static"
        (folder / "images").mkdir(parents=True)
        turn = self.generator.uniform(0, 2 * math.pi)
        distance = _reach(self.mesh.vertices) / (1 - _STATIC_MARGIN) / math.sin(0.5 * _FIELD_OF_VIEW)
        viewpoints = around(self.X_WO.translation(), distance, self.options.static_views, turn)
        pictures = self.recorder.pictures([self.X_WO] * len(viewpoints), viewpoints)
        frames = []
        for k, (X_WC, picture) in enumerate(zip(viewpoints, pictures, strict=True)):
            name = f"images/{k:05d}.png"
            _write_image(folder / name, picture)
            frames.append((name, _pose(X_WC)))
            advance()
        write_transforms(folder / "transforms.json", self.camera, frames)

    def _write_episode(self, number: int, advance: Callable[[], None]) -> None:
        options, generator = self.options, np.random.default_rng([self.options.seed, 1, number])
        p_WO, mesh_W = self.X_WO.translation(), self.mesh.copy()
        mesh_W.apply_transform(self.X_WO.GetAsMatrix4())
        half = self.scene.pusher.radius if options.pusher == "sphere" else 0.5 * _PUSHER_LENGTH
        half += self.scene.pusher.radius if options.pusher == "capsule" else 0
        push = choose_push(
            mesh_W,
            p_WO,
            self.scene.pusher,
            generator,
            height=max(half + _CLEARANCE, p_WO[2]),
            speed=options.speed * generator.uniform(0.85, 1.15),
            distance=options.distance * generator.uniform(0.85, 1.15),
        )
        side = generator.choice([-1, 1]) * generator.uniform(math.radians(40), math.radians(110))
        angle, level = math.atan2(push.direction_W[1], push.direction_W[0]) + side, generator.uniform(0.6, 0.8)
        flat = math.sqrt(1 - level**2)
        recording = self.recorder.push(self.X_WO, push, options.frames)
        places = np.vstack([self.mesh.vertices @ X.rotation().matrix().T + X.translation() for X in recording.X_WO])
        X_WC = framed(
            places, np.array([flat * math.cos(angle), flat * math.sin(angle), level]), self.camera, _EPISODE_MARGIN
        )
        folder = self.folder / "episodes" / f"{number:04d}"
        (folder / "rgb").mkdir(parents=True)
        names = [f"rgb/{k:05d}.png" for k in range(options.frames)]
        pictures = self.recorder.pictures(recording.X_WO, [X_WC] * options.frames, recording.p_WP)
        for name, picture in zip(names, pictures, strict=True):
            _write_image(folder / name, picture)
            advance()
        poses = recording.object_poses
        write_episode_tables(folder, self.camera, _pose(X_WC), names, recording.t, recording.trajectory, poses)

    def _write_ground_truth(self) -> None:
        """What an identification is scored by, and never sees."""
        inertia = mass_properties(self.mesh, mass=self.options.mass).inertia
        axes = "xyz"
        truth = {
            "mass": self.options.mass,
            **{
                f"inertia_{axes[i]}{axes[j]}": round(float(inertia[i, j]), 15) + 0.0
                for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
            },
            "friction_floor": self.options.friction,
            "friction_pusher": self.options.pusher_friction,
            "restitution": self.options.restitution,
        }
        with replacing(self.folder / GROUND_TRUTH_FILE) as temporary:
            text = "# SI units; inertia about the centre of mass, axes of O. To score with, not to fit.\n"
            temporary.write_text(text + yaml.safe_dump(truth, sort_keys=False), encoding="utf-8")


@contextmanager
def _appearing(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its name when the block ends well, and goes otherwise."""
    if out.is_symlink() or (out.exists() and (not out.is_dir() or any(out.iterdir()))):
        raise InputError(out, value="something there already", allowed="a new or empty folder")
    temporary = out.absolute().with_name(f".{out.absolute().name}.{os.getpid()}")
    try:
        try:
            temporary.mkdir(parents=True)
        except OSError as error:
            raise InputError(out, value=error.strerror, allowed="a folder that can be written to") from error
        yield temporary
        try:
            temporary.replace(out)
        except OSError as error:
            raise InputError(out, value=error.strerror, allowed="a new or empty folder") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _reach(vertices: np.ndarray) -> float:
    """How far the farthest corner is from the origin, m."""
    return float(np.linalg.norm(vertices, axis=1).max())


def _pose(X: RigidTransform) -> Pose:
    q = torch.tensor(X.rotation().ToQuaternion().wxyz(), dtype=torch.float64)
    return Pose(q, torch.tensor(X.translation(), dtype=torch.float64))


def _write_image(path: Path, picture: np.ndarray) -> None:
    Image.fromarray(picture).save(path)


def _write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    lines = ["# Metres; frame P.", "o pusher"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _require(name: str, value: object, allowed: bool, range_in_words: str) -> None:
    if not allowed:
        raise ParameterError(f"{name}: got {value}; allowed: {range_in_words}")
