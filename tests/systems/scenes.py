# SPDX-License-Identifier: MIT
"""Pushing scenes for tests, and what is measured in them."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.models import object_model
from pinwm_drake.systems.engines.plant.scene import MakeScenePlant, ScenePlant
from pinwm_drake.systems.pusher.drive import PusherDrive
from pinwm_drake.systems.pusher.motion import ScriptedPush, StraightPush
from pinwm_drake.systems.scenario.schema import Pusher, Scenario, Shape, Theta
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.sdf.collision import divided
from pinwm_drake.twin.twin import Estimate

GRAVITY = 9.81
SPHERE = PusherShape("sphere", 0.01)
AWAY = StraightPush(np.array([0.0, 0.0, 50.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, 1.0, np.inf)


@dataclass(frozen=True, eq=False)
class Bench:
    """A plant with a scripted pusher."""

    diagram: Diagram
    parts: ScenePlant
    script: ScriptedPush
    drive: PusherDrive

    def start(self, X_WO: RigidTransform, V_WO: list[float] | None = None, push: StraightPush = AWAY) -> Simulator:
        context = self.diagram.CreateDefaultContext()
        mine = self.parts.plant.GetMyMutableContextFromRoot(context)
        self.parts.plant.SetFreeBodyPose(mine, self.parts.object, X_WO)
        if V_WO is not None:
            velocity = SpatialVelocity(V_WO[:3], V_WO[3:])
            self.parts.plant.SetFreeBodySpatialVelocity(context=mine, body=self.parts.object, V_JpJc=velocity)
        self.parts.plant.SetPositions(mine, self.parts.pusher_instance, push.p_WP)
        self.drive.SetPosition(self.drive.GetMyMutableContextFromRoot(context), push.p_WP)
        self.script.SetPush(self.script.GetMyMutableContextFromRoot(context), push)
        return Simulator(self.diagram, context)

    def mine(self, context: Context) -> Context:
        return self.parts.plant.GetMyContextFromRoot(context)

    def pose(self, simulator: Simulator) -> RigidTransform:
        return self.parts.object.EvalPoseInWorld(self.mine(simulator.get_context()))

    def velocity(self, simulator: Simulator) -> np.ndarray:
        """(6,): ω [rad/s], v [m/s]."""
        return self.parts.object.EvalSpatialVelocityInWorld(self.mine(simulator.get_context())).get_coeffs()

    def pusher(self, simulator: Simulator) -> np.ndarray:
        """(6,): p [m], v [m/s]."""
        mine, instance = self.mine(simulator.get_context()), self.parts.pusher_instance
        plant = self.parts.plant
        return np.concatenate([plant.GetPositions(mine, instance), plant.GetVelocities(mine, instance)])


def setup_of(
    name: str,
    friction: float,
    *,
    pusher_friction: float | None = None,
    restitution: float = 0.0,
    mass: float = 1.0,
    pusher: PusherShape = SPHERE,
    **options: object,
) -> Setup:
    theta = Theta(mass, friction, friction if pusher_friction is None else pusher_friction, restitution)
    shape = Shape(pusher.kind, pusher.radius, pusher.length)
    return make_setup(Scenario(object=name, theta=theta, pusher=Pusher(shape=shape), **options))


def with_nuisance(setup: Setup, **values: float) -> Setup:
    """The scene with nuisances of the twin's physics: support_* (1), center_* (m), contact_offset (m)."""
    given = {name: Estimate(value, None, True, "1", "given") for name, value in values.items()}
    return replace(setup, twin=replace(setup.twin, nuisance=setup.twin.nuisance | given))


def bench(
    name: str, friction: float, *, contact: str = "hydroelastic", time_step: float = 1 / 3840, **options: object
) -> Bench:
    return bench_of(setup_of(name, friction, **options), contact, time_step)


def bench_of(setup: Setup, contact: str, time_step: float) -> Bench:
    builder = DiagramBuilder()
    parts = MakeScenePlant(builder, replace(setup, plant_time_step=time_step), contact)
    script = builder.AddSystem(ScriptedPush(time_step))
    drive = builder.AddSystem(PusherDrive(time_step, time_step, AWAY.p_WP))
    builder.Connect(script.get_output_port(), drive.get_input_port())
    builder.Connect(drive.get_output_port(), parts.plant.get_desired_state_input_port(parts.pusher_instance))
    return Bench(builder.Build(), parts, script, drive)


def base_of(name: str) -> tuple[float, float, float]:
    """Height of the centre of mass above the base [m], mean distance of the base from the axis [m], I_zz/m [m²]."""
    mesh = load_mesh(object_model(name).mesh_path)
    radius = mean_radius(divided(base_triangles(mesh), 0.002))
    return -mesh.bounds[0, 2], radius, float(mass_properties(mesh, mass=1.0).inertia[2, 2])


def base_triangles(mesh: trimesh.Trimesh) -> np.ndarray:
    """Those (n, 3, 3) on which it stands [m]."""
    found: np.ndarray = mesh.triangles[np.abs(mesh.triangles[:, :, 2] - mesh.bounds[0, 2]).max(axis=1) < 1e-9]
    return found


def mean_radius(triangles: np.ndarray) -> float:
    """Mean distance of triangles (n, 3, 3) from the axis [m], each taken as a point in its centroid."""
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    radius = np.linalg.norm(triangles.mean(axis=1)[:, :2], axis=1)
    return float(area @ radius / area.sum())
