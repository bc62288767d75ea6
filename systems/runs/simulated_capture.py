# SPDX-License-Identifier: MIT
"""A simulated capture: a stand-in for a robot that pushes an object in front of a camera."""

import dataclasses
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh
from PIL import Image
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.ground_truth import write_ground_truth
from pinwm_drake.capture.pusher import pusher_surface, pushing_height
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_posed_images
from pinwm_drake.files import appearing, scratch
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.pusher.choice import choose_push, coasting_speed
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.capture_options import SimulateOptions
from pinwm_drake.systems.runs.realism.camera import LabCamera
from pinwm_drake.systems.runs.realism.lamp import glossy_model
from pinwm_drake.systems.runs.realism.mistakes import MARGIN, Realism, late_log, moved_camera, moved_on_floor
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.runs.realism.uneven import uneven_twin
from pinwm_drake.systems.runs.recorder import Rates, Recording, SceneRecorder
from pinwm_drake.systems.runs.rocking import SPEEDS, rocking_poke
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.schema import Physics, Plant, Pusher, Scenario, Shape, Theta
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import on_floor
from pinwm_drake.systems.scenario.viewpoints import around, framed
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.twin.rollout import twin_parameters, twin_scene

CaptureProgress = Callable[[str, float, str], None]
"""Called with "images", the share of them that is written, and their number in words."""

_FIELD_OF_VIEW = math.radians(40)
_STATIC_MARGIN, _EPISODE_MARGIN = 0.12, 0.12  # of the image, free on each side of the object
_PUSHER_LENGTH = 0.06  # m, of the straight part of a capsule or cylinder
_COASTING = 0.012  # m, by which the object slides on after it has left the pusher: what shows its friction
_GRAVITY = 9.81  # m/s^2
_SPEEDS = (0.12, 0.4)  # m/s, of a push whose speed is not given
_ANY_SPEED = (0.05, 0.3)  # m/s, of one in a realistic capture
_FROM_ORIGIN = 0.02  # m, of the object at first, along x and y
_RECORD_RATE = 240.0  # Hz, the lowest of the pusher's log
_LYING = {"mug": "flip_mug", "mug_handle": "flip_mug_handle"}  # scenarios in which objects lie on their side
_LONGEST_STEP = 1 / 3800  # s
_BOUNCING_STEPS = 2  # times more of them where an impact of some 3 ms is to keep its energy
_POKING_STEPS = 4  # times more of them for pokes: Drake takes the friction of a step from the force of the one before


class _Plan:
    """Plan of a capture, which follows from its options.

    Attributes:
        options: The options.
        pusher_friction: Friction coefficient of object and pusher.
        pokes: Flag: the object is poked, so that it slides and rocks, and not pushed.
        push_speed: m/s, speed of the pusher; an object that stops with it shows only that its friction is large enough.
        rates: Rates of pictures, rows of the log, and steps of the plant.
        shape: Shape of the pusher.
    """

    def __init__(self, options: SimulateOptions) -> None:
        self.options = options
        given = options.pusher_friction
        self.pusher_friction = options.friction if given is None else given
        self.pokes = recipe_of(options.task).motion == "poke"
        usual = coasting_speed(options.friction, _GRAVITY, distance=_COASTING, speeds=_SPEEDS)
        self.push_speed = options.speed or (max(SPEEDS) if self.pokes else usual)
        records = math.ceil(_RECORD_RATE / options.rate)
        steps = math.ceil(1 / (options.rate * records * _LONGEST_STEP))
        steps *= (_POKING_STEPS if self.pokes else 1) * (_BOUNCING_STEPS if options.restitution else 1)
        self.rates = Rates(options.rate, records, steps)
        length = 0.0 if options.pusher == "sphere" else _PUSHER_LENGTH
        self.shape = PusherShape(options.pusher, options.pusher_radius, length)

    def scenario(self) -> Scenario:
        """Scenario of the capture, whose pusher may change its speed at every step of the plant."""
        options, step = self.options, self.rates.time_step
        return Scenario(
            name=options.object_name,
            object=options.object_name,
            engine="hydroelastic",
            theta=Theta(options.mass, options.friction, self.pusher_friction, options.restitution),
            pusher=Pusher(shape=Shape(self.shape.kind, self.shape.radius, self.shape.length), period=step),
            physics=Physics(time_step=step),
            plant=Plant(time_step=step, reference_speed=self.push_speed),
            gravity=_GRAVITY,
            seed=options.seed,
        )


def simulate_capture(
    options: SimulateOptions, out: Path, *, progress: CaptureProgress = lambda stage, done, figures: None
) -> None:
    """Simulate a capture and write it.

    Args:
        options: The capture.
        out: Its folder: not there yet, or empty. It appears when all is done.
        progress: Called before the first image and after each.

    Raises:
        PinwmError: An option is refused, or a file cannot be written.
    """
    with appearing(out) as folder, scratch() as models:
        _Capture(folder, options, Path(models)).write(progress)


class _Capture:
    """A capture in the making."""

    def __init__(self, folder: Path, options: SimulateOptions, models: Path) -> None:
        self.folder, self.options, self.plan = folder, options, _Plan(options)
        setup = make_setup(self.plan.scenario())
        self.mesh_path, self.mesh = setup.twin.mesh_path, load_mesh(setup.twin.mesh_path)
        self.generator = np.random.default_rng([options.seed, 0])
        R_WO = self._first_turn()
        station = StandIn() if options.stand_in else None
        # A station has one camera, by which its policies see: where it is believed to be, and where it is.
        self.X_WC_believed = None if station is None else load_setup(recipe_of(options.task).scene).X_WC
        self.X_WC_fixed = None if station is None else station.camera(self.X_WC_believed)
        if options.in_a_lab:
            setup = _uneven_setup(setup, R_WO, options, station, models)
        self.twin, self.shape = setup.twin, self.plan.shape
        self.camera = Camera.from_field_of_view(options.size, options.size, _FIELD_OF_VIEW)
        self.recorder = SceneRecorder(setup, self.plan.rates, self.camera, options.supersampling, forces=options.forces)
        x, y = self.generator.uniform(-_FROM_ORIGIN, _FROM_ORIGIN, 2)
        standing = load_mesh(self.twin.mesh_path).vertices
        self.X_WO = self.recorder.settle(on_floor(standing, R_WO, x, y, 0.0))
        self.mistakes = np.random.default_rng([options.seed, 3])
        self.lab: LabCamera | None = None
        if options.in_a_lab:
            lamp = None if station is None else station.lamp()
            self.lab = LabCamera(self.recorder, Realism(), self.mesh.convex_hull.vertices, self.mistakes, lamp)

    def write(self, progress: CaptureProgress) -> None:
        """Write all files of the capture."""
        total = self.options.static_views + self.options.episodes * self.options.frames
        done = 0

        def advance() -> None:
            nonlocal done
            done += 1
            progress("images", done / total, f"{done}/{total}")

        progress("images", 0.0, "getting ready")
        (self.folder / "meshes").mkdir()
        shutil.copyfile(self.mesh_path, self.folder / "meshes/object.obj")
        write_mesh(self.folder / "meshes/pusher.obj", pusher_surface(PusherGeometry(None, self.shape)))
        write_capture_yaml(
            self.folder,
            name=self.options.object_name,
            mesh="meshes/object.obj",
            mass=None if self.options.forces else self.options.mass,  # the forces are to tell it
            X_WO=to_pose(self._written_start()),
            pusher_mesh="meshes/pusher.obj",
            pusher_shape=self.shape,
            floor_height=self.twin.floor_height,
            gravity=self.twin.gravity,
        )
        self._write_static_views(advance)
        for k in range(self.options.episodes):
            self._write_episode(k, advance)
        scene = twin_scene(self.twin, to_pose(self.X_WO).q)
        write_ground_truth(
            self.folder,
            mass=self.options.mass,
            inertia=twin_parameters(self.twin, scene).inertia[0, 0].numpy(),
            friction_floor=self.options.friction,
            friction_pusher=self.plan.pusher_friction,
            restitution=self.options.restitution,
        )

    def _first_turn(self) -> RotationMatrix:
        """First orientation of the object, turned at random."""
        R_WO = RotationMatrix.MakeZRotation(self.generator.uniform(-math.pi, math.pi))
        options = self.options
        if options.lying or (self.plan.pokes and options.object_name in _LYING):
            lying = load_setup(_LYING[options.object_name]).scenario.start.q_WO
            R_WO = R_WO @ RotationMatrix(Quaternion(np.array(lying) / np.linalg.norm(lying)))
        return R_WO

    def _written_start(self) -> RigidTransform:
        """Pose of the object that the capture tells."""
        if self.lab is None:
            return self.X_WO
        realism = self.lab.realism
        return moved_on_floor(self.X_WO, realism.start_place, realism.start_turn, self.mistakes)

    def _write_static_views(self, advance: Callable[[], None]) -> None:
        folder = self.folder / "static"
        (folder / "images").mkdir(parents=True)
        turn = self.generator.uniform(0, 2 * math.pi)
        reach = float(np.linalg.norm(self.mesh.vertices, axis=1).max())
        distance = reach / (1 - _STATIC_MARGIN) / math.sin(0.5 * _FIELD_OF_VIEW)
        viewpoints = around(self.X_WO.translation(), distance, self.options.static_views, turn)
        if self.lab is None:
            pictures = self.recorder.pictures([self.X_WO] * len(viewpoints), viewpoints)
        else:
            pictures = self.lab.still(self.X_WO, viewpoints)
        frames = []
        for k, (X_WC, picture) in enumerate(zip(viewpoints, pictures, strict=True)):
            name = f"images/{k:05d}.png"
            Image.fromarray(picture).save(folder / name)
            if self.lab is not None:
                realism = self.lab.realism
                X_WC = moved_camera(X_WC, realism.static_place, realism.static_turn, self.mistakes)
            frames.append((name, self.camera, to_pose(X_WC)))
            advance()
        write_posed_images(folder / "transforms.json", frames)

    def _write_episode(self, number: int, advance: Callable[[], None]) -> None:
        options, generator = self.options, np.random.default_rng([self.options.seed, 1, number])
        draw = {"push": self._push, "poke": self._poke}[recipe_of(options.task).motion]
        push, recording = draw(generator)
        side = generator.choice([-1, 1]) * generator.uniform(math.radians(40), math.radians(110))
        angle, level = math.atan2(push.direction_W[1], push.direction_W[0]) + side, generator.uniform(0.6, 0.8)
        flat = math.sqrt(1 - level**2)
        places = np.vstack([self.mesh.vertices @ X.rotation().matrix().T + X.translation() for X in recording.X_WO])
        toward = np.array([flat * math.cos(angle), flat * math.sin(angle), level])
        X_WC = self.X_WC_fixed or framed(places, toward, self.camera, _EPISODE_MARGIN)
        folder = self.folder / "episodes" / f"{number:04d}"
        (folder / "rgb").mkdir(parents=True)
        names = [f"rgb/{k:05d}.png" for k in range(options.frames)]
        log = recording.trajectory
        if self.lab is None:
            pictures = self.recorder.pictures(recording.X_WO, [X_WC] * options.frames, recording.p_WP)
        else:
            pictures = self.lab.film(log.t, recording.logged, log.p_WP, recording.t, X_WC)
        for name, picture in zip(names, pictures, strict=True):
            Image.fromarray(picture).save(folder / name)
            advance()
        if self.lab is not None:
            realism = self.lab.realism
            drawn = moved_camera(X_WC, realism.episode_place, realism.episode_turn, self.mistakes)
            X_WC = self.X_WC_believed or drawn
            log = late_log(log, self.mistakes.uniform(-realism.clock, realism.clock), MARGIN)
        write_episode_tables(folder, self.camera, to_pose(X_WC), names, recording.t, log, recording.object_poses)

    def _push(self, generator: np.random.Generator) -> tuple[StraightPush, Recording]:
        """Return a random push of the object at rest, and what came of it."""
        options, p_WO, mesh_W = self.options, self.X_WO.translation(), self.mesh.copy()
        mesh_W.apply_transform(self.X_WO.GetAsMatrix4())
        speed = self.plan.push_speed * generator.uniform(0.85, 1.15)
        if options.in_a_lab and options.speed is None:
            # A lab does not know the friction when it chooses a speed.
            speed = generator.uniform(*_ANY_SPEED)
        push = choose_push(
            mesh_W,
            p_WO,
            self.shape,
            generator,
            height=pushing_height(self.shape, 0.0, p_WO[2]),
            speed=speed,
            distance=options.distance * generator.uniform(0.85, 1.15),
        )
        return push, self.recorder.push(self.X_WO, push, options.frames)

    def _poke(self, generator: np.random.Generator) -> tuple[StraightPush, Recording]:
        """Return a random poke that rocks the object at rest, and what came of it."""
        given = self.options.speed
        speeds = SPEEDS if given is None else (0.85 * given, 1.15 * given)
        number, rises = self.options.frames, self.options.rise
        return rocking_poke(self.recorder, self.X_WO, self.mesh, self.shape, generator, speeds, number, rises=rises)


def _uneven_setup(
    setup: Setup, R_WO: RotationMatrix, options: SimulateOptions, station: StandIn | None, models: Path
) -> Setup:
    """Return the setup with a lump in the object, feet below it unless it lies, and glossy colours."""
    up = R_WO.matrix()[2]
    if station is not None:
        twin = station.uneven(setup.twin, up, models)
    else:
        generator = np.random.default_rng([options.seed, 2])
        twin = uneven_twin(setup.twin, up, generator, models, feet=not options.lying)
    return dataclasses.replace(
        make_setup(setup.scenario, twin=twin), visual_path=glossy_model(setup.visual_path, models)
    )


def to_pose(X: RigidTransform) -> Pose:
    """Drake's pose as this project's own: q (4,) wxyz, p (3,) [m], float64."""
    q = torch.tensor(X.rotation().ToQuaternion().wxyz(), dtype=torch.float64)
    return Pose(q, torch.tensor(X.translation(), dtype=torch.float64))


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a pusher's surface, m, frame P, as an OBJ file."""
    lines = ["# Metres; frame P.", "o pusher"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
