# SPDX-License-Identifier: MIT
"""Folders of captures: the poses of an engine, seen by Drake's renderer and written as a robot would record them."""

import math
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pydrake.math import RigidTransform

from benchmarks.next_push.engines.drake import make_recorder
from benchmarks.next_push.engines.rollout import FLOOR_HEIGHT, GRAVITY, LOG_RATE
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.poses import PER_FRAME, PosedCapture
from benchmarks.next_push.specification import CaptureSpec
from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.capture.ground_truth import write_ground_truth
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_posed_images
from pinwm_drake.files import appearing
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.runs.realism.camera import LabCamera
from pinwm_drake.systems.runs.realism.lamp import glossy_model
from pinwm_drake.systems.runs.realism.mistakes import MARGIN, Realism, late_log, moved_camera, moved_on_floor
from pinwm_drake.systems.runs.recorder import SceneRecorder, quaternions
from pinwm_drake.systems.runs.simulated_capture import to_pose, write_mesh
from pinwm_drake.systems.scenario.viewpoints import around, framed

FIELD_OF_VIEW = math.radians(40)
_STATIC_MARGIN, _EPISODE_MARGIN = 0.12, 0.12  # of the image, free on each side of the object
_SUPERSAMPLING, _LAB_SUPERSAMPLING = 3, 2


def write_capture(
    out: Path,
    spec: CaptureSpec,
    thing: Thing,
    posed: PosedCapture,
    realism: Realism | None = None,
    *,
    pixels: int = 400,
    views: int = 12,
) -> dict[str, Any]:
    """Write a capture, a clean one or as a lab has it.

    Args:
        out: Its folder, not there yet; it appears when all is done.
        spec: The capture.
        thing: Its object.
        posed: Its poses; for a realistic capture those of an uneven object.
        realism: How large its mistakes are; None for a clean capture, without shadows of a lamp.
        pixels: Width and height of all images, px.
        views: Number of static views.

    Returns:
        The mistakes that were made: start pose, clocks, cameras; SI units. Empty for a clean capture.
    """
    camera = Camera.from_field_of_view(pixels, pixels, FIELD_OF_VIEW)
    with appearing(out) as folder, tempfile.TemporaryDirectory() as models:
        seen = None if realism is None else glossy_model(thing.visual_path, Path(models))
        finer = _SUPERSAMPLING if realism is None else _LAB_SUPERSAMPLING
        recorder = make_recorder("hydroelastic", thing, posed.theta, spec.shape, camera, finer, seen=seen)
        return _Writer(folder, spec, thing, posed, recorder, realism).write(views)


class _Writer:
    def __init__(
        self,
        folder: Path,
        spec: CaptureSpec,
        thing: Thing,
        posed: PosedCapture,
        recorder: SceneRecorder,
        realism: Realism | None,
    ) -> None:
        self.folder, self.spec, self.thing, self.posed, self.recorder = folder, spec, thing, posed, recorder
        self.realism, self.generator = realism or Realism(), np.random.default_rng([spec.seed, 5])
        self.lab: LabCamera | None = None
        if realism is not None:
            self.lab = LabCamera(recorder, realism, thing.mesh().convex_hull.vertices, self.generator)

    def write(self, views: int) -> dict[str, Any]:
        realism, X_WO = self.realism, self.posed.X_WO
        start = X_WO
        if self.lab is not None:
            start = moved_on_floor(X_WO, realism.start_place, realism.start_turn, self.generator)
        self._write_scene(start)
        self._write_static_views(views)
        episodes = [self._write_episode(k) for k in range(len(self.posed.pushes))]
        if self.lab is None:
            return {}
        turn = (X_WO.rotation().inverse() @ start.rotation()).ToAngleAxis().angle()
        return {
            "start_shift": (start.translation() - X_WO.translation()).tolist(),
            "start_turn": float(turn),
            "wider": self.lab.wider,
            "episodes": episodes,
        }

    def _write_scene(self, X_WO: RigidTransform) -> None:
        """Write `capture.yaml` with a start pose X_WO, the meshes, and the truth."""
        folder, shape, theta = self.folder, self.spec.shape, self.posed.theta
        (folder / "meshes").mkdir()
        shutil.copyfile(self.thing.mesh_path, folder / "meshes/object.obj")
        write_mesh(folder / "meshes/pusher.obj", pusher_surface(PusherGeometry(None, shape)))
        write_capture_yaml(
            folder,
            name=self.spec.thing,
            mesh="meshes/object.obj",
            mass=theta.mass,
            X_WO=to_pose(X_WO),
            pusher_mesh="meshes/pusher.obj",
            pusher_shape=shape,
            floor_height=FLOOR_HEIGHT,
            gravity=GRAVITY,
        )
        write_ground_truth(
            folder,
            mass=theta.mass,
            inertia=theta.inertia,
            friction_floor=theta.friction_floor,
            friction_pusher=theta.friction_pusher,
            restitution=0.0,
        )

    def _write_static_views(self, count: int) -> None:
        views, X_WO = static_viewpoints(self.spec, self.thing, self.posed, count), self.posed.X_WO
        folder, realism = self.folder / "static", self.realism
        (folder / "images").mkdir(parents=True)
        pictures = self.recorder.pictures([X_WO] * count, views) if self.lab is None else self.lab.still(X_WO, views)
        frames = []
        for k, (X_WC, picture) in enumerate(zip(views, pictures, strict=True)):
            name = f"images/{k:05d}.png"
            Image.fromarray(picture).save(folder / name)
            if self.lab is not None:
                X_WC = moved_camera(X_WC, realism.static_place, realism.static_turn, self.generator)
            frames.append((name, self.recorder.rig.camera, to_pose(X_WC)))
        write_posed_images(folder / "transforms.json", frames)

    def _write_episode(self, number: int) -> dict[str, Any]:
        X_WC = X_WC_told = episode_viewpoint(self.spec, self.thing, self.posed, number)
        rollout, motion = self.posed.rollouts[number], self.posed.pushes[number].motion
        folder, realism = self.folder / "episodes" / f"{number:04d}", self.realism
        t, X_WO = rollout.t[::PER_FRAME], rollout.X_WO[::PER_FRAME]
        v_WP = np.array([motion.average_velocity(k, 1 / LOG_RATE) for k in range(len(rollout.t))])
        log = PusherTrajectory(rollout.t, rollout.p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (len(v_WP), 1)), v_WP, None)
        if self.lab is None:
            film = self.recorder.pictures(X_WO, [X_WC] * len(X_WO), rollout.p_WP[::PER_FRAME])
        else:
            film = self.lab.film(rollout.t, rollout.X_WO, rollout.p_WP, t, X_WC)
        (folder / "rgb").mkdir(parents=True)
        names = [f"rgb/{k:05d}.png" for k in range(len(t))]
        for name, picture in zip(names, film, strict=True):
            Image.fromarray(picture).save(folder / name)
        mistakes: dict[str, Any] = {}
        if self.lab is not None:
            X_WC_told = moved_camera(X_WC, realism.episode_place, realism.episode_turn, self.generator)
            late = float(self.generator.uniform(-realism.clock, realism.clock))
            log = late_log(log, late, MARGIN)
            mistakes = {"log_late": late, "camera_shift": (X_WC_told.translation() - X_WC.translation()).tolist()}
        poses = ObjectPoses(t, np.array([X.translation() for X in X_WO]), quaternions(X_WO))
        write_episode_tables(folder, self.recorder.rig.camera, to_pose(X_WC_told), names, t, log, poses)
        return mistakes


def static_viewpoints(spec: CaptureSpec, thing: Thing, posed: PosedCapture, count: int) -> list[RigidTransform]:
    """Poses X_WC of the static cameras, all around the object."""
    turn = np.random.default_rng([spec.seed, 3]).uniform(0, 2 * math.pi)
    vertices = thing.mesh().vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    reach = float(np.linalg.norm(vertices - middle, axis=1).max())
    distance = reach / (1 - _STATIC_MARGIN) / math.sin(0.5 * FIELD_OF_VIEW)
    return around(posed.X_WO @ middle, distance, count, turn)


def episode_viewpoint(spec: CaptureSpec, thing: Thing, posed: PosedCapture, number: int) -> RigidTransform:
    """Pose X_WC of an episode's camera, beside the push, which sees the object in all of its frames."""
    generator = np.random.default_rng([spec.seed, 4, number])
    motion, rollout = posed.pushes[number].motion, posed.rollouts[number]
    side = generator.choice([-1, 1]) * generator.uniform(math.radians(40), math.radians(110))
    angle, level = math.atan2(motion.direction_W[1], motion.direction_W[0]) + side, generator.uniform(0.6, 0.8)
    flat = math.sqrt(1 - level**2)
    vertices = thing.mesh().convex_hull.vertices
    places = np.vstack([vertices @ X.rotation().matrix().T + X.translation() for X in rollout.X_WO])
    camera = Camera.from_field_of_view(400, 400, FIELD_OF_VIEW)
    return framed(places, np.array([flat * math.cos(angle), flat * math.sin(angle), level]), camera, _EPISODE_MARGIN)
