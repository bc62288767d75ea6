"""Folders of captures: the poses of an engine, seen by Drake's renderer and written as a robot would record them."""

import math
import shutil
from dataclasses import dataclass
from pathlib import Path

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
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_transforms
from pinwm_drake.files import appearing
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.runs.recorder import SceneRecorder, quaternions
from pinwm_drake.systems.runs.simulated_capture import to_pose, write_mesh
from pinwm_drake.systems.scenario.viewpoints import around, framed

FIELD_OF_VIEW = math.radians(40)
_STATIC_MARGIN, _EPISODE_MARGIN = 0.12, 0.12  # of the image, free on each side of the object
_SUPERSAMPLING = 3


@dataclass(frozen=True)
class Size:
    """Size of a capture.

    Attributes:
        pixels: Width and height of all images, px.
        views: Number of static views.
    """

    pixels: int = 400
    views: int = 12


def write_capture(out: Path, spec: CaptureSpec, thing: Thing, posed: PosedCapture, size: Size | None = None) -> None:
    """Writes a clean capture.

    Args:
        out: Its folder, not there yet; it appears when all is done.
        spec: The capture.
        thing: Its object.
        posed: Its poses.
        size: Of its pictures; 400 px and 12 views by default.
    """
    size = size or Size()
    camera = Camera.from_field_of_view(size.pixels, size.pixels, FIELD_OF_VIEW)
    recorder = make_recorder("hydroelastic", thing, posed.theta, spec.shape, camera, _SUPERSAMPLING)
    with appearing(out) as folder:
        write_scene(folder, spec, thing, posed, posed.X_WO)
        views = static_viewpoints(spec, thing, posed, size.views)
        _write_static_views(folder, recorder, posed.X_WO, views)
        for k in range(len(posed.pushes)):
            X_WC = episode_viewpoint(spec, thing, posed, k)
            _write_episode(folder / "episodes" / f"{k:04d}", recorder, posed, k, X_WC)


def write_scene(folder: Path, spec: CaptureSpec, thing: Thing, posed: PosedCapture, X_WO: RigidTransform) -> None:
    """Writes `capture.yaml` with a start pose X_WO, the meshes, and the truth."""
    theta = posed.theta
    (folder / "meshes").mkdir()
    shutil.copyfile(thing.mesh_path, folder / "meshes/object.obj")
    write_mesh(folder / "meshes/pusher.obj", pusher_surface(PusherGeometry(None, spec.shape)))
    write_capture_yaml(
        folder,
        name=spec.thing,
        mesh="meshes/object.obj",
        mass=theta.mass,
        X_WO=to_pose(X_WO),
        pusher_mesh="meshes/pusher.obj",
        pusher_shape=spec.shape,
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


def _write_static_views(
    folder: Path, recorder: SceneRecorder, X_WO: RigidTransform, views: list[RigidTransform]
) -> None:
    """Writes static views of an object at X_WO, from camera poses X_WC."""
    (folder / "static/images").mkdir(parents=True)
    names = [f"images/{k:05d}.png" for k in range(len(views))]
    for name, picture in zip(names, recorder.pictures([X_WO] * len(views), views), strict=True):
        Image.fromarray(picture).save(folder / "static" / name)
    frames = [(name, to_pose(X_WC)) for name, X_WC in zip(names, views, strict=True)]
    write_transforms(folder / "static/transforms.json", recorder.rig.camera, frames)


def _write_episode(
    folder: Path, recorder: SceneRecorder, posed: PosedCapture, number: int, X_WC: RigidTransform
) -> None:
    rollout = posed.rollouts[number]
    X_WO, p_WP = rollout.X_WO[::PER_FRAME], rollout.p_WP[::PER_FRAME]
    (folder / "rgb").mkdir(parents=True)
    names = [f"rgb/{k:05d}.png" for k in range(len(X_WO))]
    for name, picture in zip(names, recorder.pictures(X_WO, [X_WC] * len(X_WO), p_WP), strict=True):
        Image.fromarray(picture).save(folder / name)
    log = pusher_log(posed, number)
    write_episode_tables(
        folder, recorder.rig.camera, to_pose(X_WC), names, rollout.t[::PER_FRAME], log, object_poses(posed, number)
    )


def pusher_log(posed: PosedCapture, number: int) -> PusherTrajectory:
    """Log of an episode's pusher."""
    rollout, motion = posed.rollouts[number], posed.pushes[number].motion
    rows = len(rollout.t)
    v_WP = np.array([motion.average_velocity(k, 1 / LOG_RATE) for k in range(rows)])
    return PusherTrajectory(rollout.t, rollout.p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (rows, 1)), v_WP, None)


def object_poses(posed: PosedCapture, number: int) -> ObjectPoses:
    """Poses of an episode's object at the times of the pictures."""
    rollout = posed.rollouts[number]
    X_WO = rollout.X_WO[::PER_FRAME]
    return ObjectPoses(rollout.t[::PER_FRAME], np.array([X.translation() for X in X_WO]), quaternions(X_WO))
