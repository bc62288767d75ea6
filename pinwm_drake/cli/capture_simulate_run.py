"""What `pinwm capture simulate` does: sets the scene up, runs it, and writes the capture."""

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from pinwm_drake.capture.ground_truth import write_ground_truth
from pinwm_drake.capture.pusher import pusher_surface, pushing_height
from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_transforms
from pinwm_drake.files import appearing
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.pusher.choice import choose_push
from pinwm_drake.systems.runs.capture_options import SimulateOptions
from pinwm_drake.systems.runs.recorder import MakePushRecorder, PushRecorder
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.scenario.start import on_floor
from pinwm_drake.systems.scenario.viewpoints import around, framed

_FIELD_OF_VIEW = math.radians(40)
_STATIC_MARGIN, _EPISODE_MARGIN = 0.12, 0.12  # of the image, free on each side of the object


def run_simulate(out: Path, options: SimulateOptions) -> None:
    """Simulates a capture and writes it.

    Args:
        out: Its folder: not there yet, or empty. It appears when all is done.
        options: What is simulated.

    Raises:
        PinwmError: An option is refused, or a file cannot be written.
    """
    console = Console()
    with appearing(out) as folder:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as progress:
            total = options.static_views + options.episodes * options.frames
            task = progress.add_task("getting ready", total=total)
            _Capture(folder, options).write(
                lambda what: progress.update(task, description=what), lambda: progress.advance(task)
            )
            progress.update(task, description="images")
    console.print(f"wrote {out}", highlight=False, soft_wrap=True)


class _Capture:
    """A capture in the making."""

    def __init__(self, folder: Path, options: SimulateOptions) -> None:
        self.folder, self.options = folder, options
        setup = make_setup(options.scenario)
        self.twin, self.shape = setup.twin, options.shape
        self.mesh = load_mesh(self.twin.mesh_path)
        self.camera = Camera.from_field_of_view(options.size, options.size, _FIELD_OF_VIEW)
        self.recorder: PushRecorder = MakePushRecorder(setup, options.rates, self.camera, options.supersampling)
        self.generator = np.random.default_rng([options.seed, 0])
        self.X_WO = self.recorder.settle(self._first_pose())

    def write(self, describe: Callable[[str], None], advance: Callable[[], None]) -> None:
        """Writes everything; `describe` hears what is being done, `advance` of every image."""
        (self.folder / "meshes").mkdir()
        shutil.copyfile(self.twin.mesh_path, self.folder / "meshes/object.obj")
        _write_mesh(self.folder / "meshes/pusher.obj", pusher_surface(PusherGeometry(None, self.shape)))
        write_capture_yaml(
            self.folder,
            name=self.options.object_name,
            mesh="meshes/object.obj",
            mass=self.options.mass,
            X_WO=_pose(self.X_WO),
            pusher_mesh="meshes/pusher.obj",
            pusher_shape=self.shape,
            floor_height=self.twin.floor_height,
            gravity=self.twin.gravity,
        )
        describe("static views")
        self._write_static_views(advance)
        for k in range(self.options.episodes):
            describe(f"episode {k:04d}")
            self._write_episode(k, advance)
        write_ground_truth(
            self.folder,
            mass=self.options.mass,
            inertia=mass_properties(self.mesh, mass=self.options.mass).inertia,
            friction_floor=self.options.friction,
            friction_pusher=self.options.pusher_friction,
            restitution=self.options.restitution,
        )

    def _first_pose(self) -> RigidTransform:
        """Where the object is put: near the origin, turned at random, on the floor."""
        yaw, x, y = self.generator.uniform([-math.pi, -0.02, -0.02], [math.pi, 0.02, 0.02])
        R_WO = RotationMatrix.MakeZRotation(yaw)
        if self.options.lying:
            # Turned by half a facet, the mug lies on a face and not on an edge.
            R_WO = R_WO @ RotationMatrix.MakeYRotation(math.pi / 2) @ RotationMatrix.MakeZRotation(math.pi / 64)
        return on_floor(self.mesh.vertices, R_WO, x, y, 0.0)

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
        push = choose_push(
            mesh_W,
            p_WO,
            self.shape,
            generator,
            height=pushing_height(self.shape, 0.0, p_WO[2]),
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
