"""Pushing scenes for tests, and what is measured in them."""

from dataclasses import dataclass

import numpy as np
from pinwm_drake.models import object_model
from pinwm_drake.systems.collision_mesh import divided
from pinwm_drake.systems.push_plant import MakePushPlant, PushPlant
from pinwm_drake.systems.push_scene import PushScene
from pinwm_drake.systems.pusher_motion import PusherMotion, StraightPush
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.meshes import load_mesh, mass_properties

GRAVITY = 9.81
SPHERE = PusherShape("sphere", 0.01)
AWAY = StraightPush(np.array([0.0, 0.0, 50.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, 1.0, np.inf)


@dataclass(frozen=True, eq=False)
class Bench:
    """A plant with a scripted pusher."""

    diagram: Diagram
    parts: PushPlant
    motion: PusherMotion

    def start(self, X_WO: RigidTransform, V_WO: list[float] | None = None, push: StraightPush = AWAY) -> Simulator:
        context = self.diagram.CreateDefaultContext()
        mine = self.parts.plant.GetMyMutableContextFromRoot(context)
        self.parts.plant.SetFreeBodyPose(mine, self.parts.object, X_WO)
        if V_WO is not None:
            velocity = SpatialVelocity(V_WO[:3], V_WO[3:])
            self.parts.plant.SetFreeBodySpatialVelocity(context=mine, body=self.parts.object, V_JpJc=velocity)
        self.parts.plant.SetPositions(mine, self.parts.pusher_instance, push.p_WP)
        self.motion.SetPush(self.motion.GetMyMutableContextFromRoot(context), push)
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


def bench(name: str, friction: float, *, pusher_friction: float | None = None, **options: object) -> Bench:
    model = object_model(name)
    scene = PushScene(
        **{
            "mesh_path": model.mesh_path,
            "visual_path": model.visual_path,
            "mass": 1.0,
            "friction_floor": friction,
            "friction_pusher": friction if pusher_friction is None else pusher_friction,
            "restitution": 0.0,
            "pusher": SPHERE,
            **options,
        }
    )
    builder = DiagramBuilder()
    parts = MakePushPlant(builder, scene)
    motion = builder.AddSystem(PusherMotion())
    builder.Connect(motion.get_output_port(), parts.plant.get_desired_state_input_port(parts.pusher_instance))
    return Bench(builder.Build(), parts, motion)


def base_of(name: str) -> tuple[float, float, float]:
    """Height of the centre of mass above the base [m], mean distance of the base from the axis [m], I_zz/m [m²]."""
    mesh = load_mesh(object_model(name).mesh_path)
    low = mesh.bounds[0, 2]
    triangles = divided(mesh.triangles[np.abs(mesh.triangles[:, :, 2] - low).max(axis=1) < 1e-9], 0.002)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    radius = np.linalg.norm(triangles.mean(axis=1)[:, :2], axis=1)
    return -low, float(area @ radius / area.sum()), float(mass_properties(mesh, mass=1.0).inertia[2, 2])
