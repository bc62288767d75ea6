# SPDX-License-Identifier: MIT
"""Drake as an engine: the project's own plants, with hydroelastic contact or that of points."""

import dataclasses
import shutil
import tempfile
from multiprocessing.util import Finalize
from pathlib import Path

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RotationalInertia, SpatialInertia

from benchmarks.next_push.engines.rollout import FLOOR_HEIGHT, GRAVITY, LOG_RATE, Rollout, Theta
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pushes import Push
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.systems.engines.plant.engine import PlantHandle
from pinwm_drake.systems.engines.plant.scene import ScenePlant
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.realism.uneven import write_with_feet
from pinwm_drake.systems.runs.recorder import Rates, SceneRecorder
from pinwm_drake.systems.scenario.schema import Physics, Plant, Pusher, Scenario, Shape
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.sdf.contact import CORNER_RADIUS
from pinwm_drake.twin.twin import THETA, Estimate, Twin

_STEPS_PER_LOG = 16  # 1/3840 s
_NO_PUSHER = PusherShape("sphere", 0.01)
_AWAY = np.array([0.0, 0.0, 50.0])  # m


def make_recorder(
    engine: str,
    thing: Thing,
    theta: Theta,
    shape: PusherShape,
    camera: Camera,
    supersampling: int,
    *,
    seen: Path | None = None,
) -> SceneRecorder:
    """Plant, pusher and camera for an object that does not ship.

    Args:
        engine: Either "hydroelastic" or "point".
        thing: The object.
        theta: The truth about it; its inertia is taken as that of a uniform solid here.
        shape: Shape of the pusher.
        camera: Camera of the pictures.
        supersampling: Rendered pixels for each of a picture, along each side.
        seen: Mesh that is seen; None for that of the object.
    """
    setup = _setup(engine, thing, theta, shape)
    setup = setup if seen is None else dataclasses.replace(setup, visual_path=seen)
    return SceneRecorder(setup, Rates(LOG_RATE, 1, _STEPS_PER_LOG), camera, supersampling)


def _setup(engine: str, thing: Thing, theta: Theta, shape: PusherShape) -> Setup:
    step = 1 / (LOG_RATE * _STEPS_PER_LOG)
    values = {
        "mass": theta.mass,
        **{f"inertia_{2 * axis}": float(theta.inertia[k, k]) for k, axis in enumerate("xyz")},
        "friction_floor": theta.friction_floor,
        "friction_pusher": theta.friction_pusher,
        "restitution_floor": 0.0,
        "restitution_pusher": 0.0,
    }
    twin = Twin(
        name=thing.name,
        mesh_path=_with_feet(thing, theta) if len(theta.feet) else thing.mesh_path,
        pusher=PusherGeometry(None, shape),
        gravity=GRAVITY,
        floor_height=FLOOR_HEIGHT,
        time_step=step,
        support="patch",
        theta={name: Estimate(values[name], None, True, unit, "given") for name, unit in THETA.items()},
        nuisance={},
        camera_offset=(0.0, 0.0),
        surfels=painted_surfels(thing.visual_path, 100),
        provenance={},
    )
    scenario = Scenario(
        name=thing.name,
        twin=thing.name,
        engine=engine,
        pusher=Pusher(shape=Shape(shape.kind, shape.radius, shape.length), period=step),
        physics=Physics(time_step=step),
        plant=Plant(time_step=step),
        gravity=GRAVITY,
    )
    return dataclasses.replace(make_setup(scenario, twin=twin), visual_path=thing.visual_path)


def roll_out(
    engine: str, thing: Thing, theta: Theta, X_WO: RigidTransform, push: Push | None, t: np.ndarray
) -> Rollout:
    """Roll out a push in "hydroelastic" or "point" contact; see `engine` for the other arguments."""
    shape = _NO_PUSHER if push is None else push.shape
    recorder = make_recorder(engine, thing, theta, shape, Camera.from_field_of_view(16, 16, 0.7), 1)
    if engine == "point" and len(theta.feet):
        _stand_on_corners(recorder)
    motion: StraightPush | None = None if push is None else push.motion
    recorder.begin(Place(X_WO, _AWAY if motion is None else motion.p_WP), motion)
    _set_inertia(recorder, theta)
    poses, places = [], []
    for _ in recorder.advance_to(t):
        poses.append(recorder.station.object_pose(recorder.simulator.get_context()))
        places.append(np.array(recorder.evaluate("pusher_state")[:3]))
    return Rollout(np.asarray(t), poses, np.array(places))


def _with_feet(thing: Thing, theta: Theta) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="next_push_"))
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=0)
    return write_with_feet(thing.mesh_path, folder, theta.feet, np.array([0.0, 0.0, 1.0]))


def _plant(recorder: SceneRecorder) -> ScenePlant:
    handle = recorder.station.engine.handle
    assert isinstance(handle, PlantHandle)
    return handle.parts


def _stand_on_corners(recorder: SceneRecorder) -> None:
    """Leaves the object the spheres at its corners only, feet among them: those of a flat face would carry it all."""
    parts = _plant(recorder)
    inspector = parts.scene_graph.model_inspector()
    face = [
        k
        for k in parts.plant.GetCollisionGeometriesForBody(parts.object)
        if isinstance(inspector.GetShape(k), Sphere) and inspector.GetShape(k).radius() > 2 * CORNER_RADIUS
    ]
    floor = parts.plant.GetCollisionGeometriesForBody(parts.plant.GetBodyByName("floor"))
    apart = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(face), GeometrySet(floor))
    parts.scene_graph.collision_filter_manager().Apply(apart)


def _set_inertia(recorder: SceneRecorder, theta: Theta) -> None:
    parts = _plant(recorder)
    context = parts.plant.GetMyMutableContextFromRoot(recorder.simulator.get_mutable_context())
    J = theta.inertia
    about_com = RotationalInertia(*(J[k, k] for k in range(3)), J[0, 1], J[0, 2], J[1, 2])
    spatial = SpatialInertia.MakeFromCentralInertia(theta.mass, theta.p_com, about_com)
    parts.object.SetSpatialInertiaInBodyFrame(context, spatial)
