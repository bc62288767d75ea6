"""The pushing scene as a MultibodyPlant: an object, a floor, and a pusher that follows what it is told.

Contact is hydroelastic: the object is rigid, floor and pusher are compliant and stiff; the discrete approximation is
"lagged" (SAP stopped without convergence on the stiff floor, and Drake's documentation warns of gliding in it and in
"similar"). Measured in runs with steps of 1/1920 or 1/3840 s:

- objects sink by 0.4 to 0.9 µm and creep by less than 1e-6 mm/s, or 0.006 mm/s where they lean on the pusher;
- one that slides stops after v²/(2 μ g) to 0.2 % at μ = 0.03 and 1 % at μ = 0.5 (half of it the step's v h / 2);
- one that spins is slowed by the torque of uniform pressure on its base to 0.7 %;
- the pusher overlaps the object by 0.05 to 0.08 mm in a push and 0.1 mm in an impact;
- restitution 0: the object leaves an impact at 1 % to 1.6 % more than the pusher's speed, 2 mm/s at most;
- restitution above 0 is approximate: 0.5 came out as 0.45 at the reference speed with steps of 1/7680 s, and lower at
  higher speeds;
- friction during an impact, some 1 ms, is up to 30 % off: "lagged" takes it from the normal force at the start of a
  step. Steps a quarter as long move the end of a push by 0.2 mm.

A compliant half space would be the simpler floor, but Drake 1.51 aborts the process where a corner of the object lies
on its plane to the last bit, so that the floor is a box.
"""

from dataclasses import dataclass

import numpy as np
from pinwm_drake.systems.collision_mesh import drake_shape, fine_mesh
from pinwm_drake.systems.contact import dissipation_of, surface_frictions
from pinwm_drake.systems.push_scene import PushScene
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    CollisionFilterDeclaration,
    GeometryInstance,
    GeometrySet,
    Mesh,
    PerceptionProperties,
    ProximityProperties,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.geometry.meshes import load_mesh, mass_properties

OBJECT_LABEL, PUSHER_LABEL = RenderLabel(1), RenderLabel(2)

_FLOOR_SIDE, _FLOOR_DEPTH = 4.0, 0.02  # m
# m, from the origin: an edge of the floor's tetrahedra, which would divide the contact surface, starts in its middle.
_FLOOR_MIDDLE = (0.9, 0.35)
_FLOOR_MODULUS = 3e7  # Pa, reached half-way down: 3e9 Pa/m
# s/m. More of it brakes a sliding object by the bottom of its front side, which is a micrometre under the floor.
_FLOOR_DISSIPATION = 20.0
_PUSHER_MODULUS = 1e9  # Pa, at its middle
_LONGEST_EDGE = 0.3  # of the object's triangles, for each metre of its smallest extent
_PUSHER_RESOLUTION = 0.002  # m, edges of its tetrahedra
_STICTION_SPEED = 1e-5  # m/s, below which friction is viscous
_PUSHER_MASS = 1.0  # kg
_STIFFNESS, _DAMPING = 1e7, 1e5  # N/m, N s/m, of the drive


@dataclass(frozen=True, eq=False)
class PushPlant:
    """The parts of a pushing scene in a diagram.

    Attributes:
        scene: What it was made from.
        plant: With the input port `<model instance "pusher">_desired_state`: p_WP (3) [m], v_WP (3) [m/s].
        scene_graph: Its geometries.
        object: Free body; frame O is its body frame.
        pusher: Body whose frame is P; translates along three axes of the world.
        pusher_instance: Its model instance: positions p_WP (3) [m], velocities v_WP (3) [m/s].
    """

    scene: PushScene
    plant: MultibodyPlant
    scene_graph: SceneGraph
    object: RigidBody
    pusher: RigidBody
    pusher_instance: ModelInstanceIndex


def MakePushPlant(builder: DiagramBuilder, scene: PushScene) -> PushPlant:
    """Adds a finalized plant and its scene graph to a diagram.

    The floor is the plane z = 0 of the world; it has no visual.

    Args:
        builder: Of the diagram.
        scene: What there is.

    Returns:
        The parts.

    Raises:
        InputError: The object's mesh cannot be used.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=scene.time_step)
    plant.set_contact_model(ContactModel.kHydroelastic)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    plant.set_stiction_tolerance(_STICTION_SPEED)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -scene.gravity])
    mu_object, mu_floor, mu_pusher = surface_frictions(scene.friction_floor, scene.friction_pusher)
    dissipation = dissipation_of(scene.restitution, scene.reference_speed)

    floor = _surface(mu_floor, min(dissipation, _FLOOR_DISSIPATION))
    AddCompliantHydroelasticProperties(_FLOOR_SIDE, _FLOOR_MODULUS, floor)
    plant.RegisterCollisionGeometry(
        plant.world_body(),
        RigidTransform([*_FLOOR_MIDDLE, -0.5 * _FLOOR_DEPTH]),
        Box(_FLOOR_SIDE, _FLOOR_SIDE, _FLOOR_DEPTH),
        "floor",
        floor,
    )
    pushed = _add_object(plant, scene, mu_object)
    pusher, instance = _add_pusher(plant, scene, mu_pusher, dissipation)
    plant.Finalize()
    kept_apart = GeometrySet(
        [
            *plant.GetCollisionGeometriesForBody(plant.world_body()),
            *plant.GetCollisionGeometriesForBody(pusher),
        ]
    )
    scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(kept_apart))
    return PushPlant(scene, plant, scene_graph, pushed, pusher, instance)


def _add_object(plant: MultibodyPlant, scene: PushScene, friction: float) -> RigidBody:
    """The free body, with mass properties of uniform density."""
    mesh = load_mesh(scene.mesh_path)
    about = mass_properties(mesh, mass=scene.mass)
    inertia = about.inertia / about.mass
    moments, products = np.diag(inertia), inertia[[0, 0, 1], [1, 2, 2]]
    central = SpatialInertia(about.mass, np.zeros(3), UnitInertia(*moments, *products))
    body = plant.AddRigidBody("object", central)
    surface = _surface(friction, 0.0)
    AddRigidHydroelasticProperties(surface)
    shape = fine_mesh(mesh, _LONGEST_EDGE * float(mesh.extents.min()))
    plant.RegisterCollisionGeometry(body, RigidTransform(), shape, "object", surface)
    _add_visual(plant, body, Mesh(scene.visual_path), OBJECT_LABEL)
    return body


def _add_pusher(
    plant: MultibodyPlant, scene: PushScene, friction: float, dissipation: float
) -> tuple[RigidBody, ModelInstanceIndex]:
    """A body on three slides, each with a stiff drive that is part of the contact solve and so cannot be late."""
    instance = plant.AddModelInstance("pusher")
    moving = plant.world_body()
    for axis, name in enumerate("xyz"):
        last = axis == 2
        inertia = (
            SpatialInertia.SolidSphereWithMass(_PUSHER_MASS, scene.pusher.radius)
            if last
            else SpatialInertia(0.0, np.zeros(3), UnitInertia(0.0, 0.0, 0.0), skip_validity_check=True)
        )
        body = plant.AddRigidBody("pusher" if last else f"pusher_slide_{name}", instance, inertia)
        joint = plant.AddJoint(
            PrismaticJoint(f"pusher_{name}", moving.body_frame(), body.body_frame(), np.eye(3)[axis])
        )
        plant.AddJointActuator(f"pusher_{name}", joint).set_controller_gains(
            PdControllerGains(p=_STIFFNESS, d=_DAMPING)
        )
        moving = body
    plant.set_gravity_enabled(instance, False)
    surface = _surface(friction, dissipation)
    AddCompliantHydroelasticProperties(_PUSHER_RESOLUTION, _PUSHER_MODULUS, surface)
    shape = drake_shape(scene.pusher)
    plant.RegisterCollisionGeometry(moving, RigidTransform(), shape, "pusher", surface)
    _add_visual(plant, moving, shape, PUSHER_LABEL, Rgba(0.3, 0.3, 0.32, 1.0))
    return moving, instance


def _surface(friction: float, dissipation: float) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(dissipation=dissipation, friction=CoulombFriction(friction, friction), properties=properties)
    return properties


def _add_visual(
    plant: MultibodyPlant, body: RigidBody, shape: object, label: RenderLabel, diffuse: Rgba | None = None
) -> None:
    """What cameras see of a body."""
    properties = PerceptionProperties()
    properties.AddProperty("label", "id", label)
    if diffuse is not None:
        properties.AddProperty("phong", "diffuse", diffuse)
    visual = GeometryInstance(RigidTransform(), shape, body.name())
    visual.set_perception_properties(properties)
    plant.RegisterVisualGeometry(body, visual)
