"""The pushing scene as a MultibodyPlant: an object, a floor, and a pusher that follows what it is told.

Bodies come in through Drake's Parser, from the texts of `sdformat` with the theta of a setup. The discrete
approximation is "lagged": SAP stopped without convergence on the stiff hydroelastic floor, and Drake's documentation
warns of gliding in it and in "similar", which slowed a spinning object in point contact 5 % to 38 % too soon. Measured
with steps of 1/1920 or 1/3840 s:

In hydroelastic contact the object is rigid, floor and pusher are compliant and stiff;

- objects sink by 0.4 to 0.9 µm and creep by less than 1e-6 mm/s, or 0.006 mm/s where they lean on the pusher; a mug
  that lies on a facet sinks by 11 µm and creeps by 0.001 mm/s;
- one that slides stops after v²/(2 μ g) to 0.2 % at μ = 0.03 and 1 % at μ = 0.5 (half of it the step's v h / 2);
- one that spins is slowed by the torque of uniform pressure on its base to 0.9 %;
- the pusher overlaps the object by 0.05 to 0.09 mm in a push and 0.1 mm in an impact;
- restitution 0: the object leaves an impact at 1 % to 1.9 % more than the pusher's speed, 2.3 mm/s at most;
- restitution above 0 is approximate: 0.5 came out as 0.45 at the reference speed with steps of 1/7680 s, and lower at
  higher speeds;
- friction during an impact, some 1 ms, is up to 30 % off: "lagged" takes it from the normal force at the start of a
  step. Steps a quarter as long move the end of a push by 0.2 mm.

In point contact small spheres carry the object, which stands 10 µm above its face on them, and its convex pieces meet
the pusher;

- the spheres of an object at rest sink by 0.8 µm (a lying mug's by 1.5 µm), and it creeps by less than 1e-5 mm/s, also
  where it leans on the pusher;
- one that slides stops after v²/(2 μ g) to 0.01 %, but for the step's v h / 2;
- one that spins is slowed by the torque of uniform pressure to 0.6 %, as near as twelve spheres on a face come to it;
- the pusher overlaps the object by 0.02 mm (μ = 0.1) to 0.1 mm (μ = 0.5) in a push, 0.09 mm in an impact, and 0.4 mm in
  one with restitution 0.5;
- restitution 0: 1.5 % more than the pusher's speed; 0.5 comes out as 0.46;
- friction during an impact is 15 % too much at 0.1 and 11 % at 0.5. A pusher twenty times as stiff made it four times
  too large: Hunt and Crossley's damping at the start of the first step, which "lagged" friction goes by, then exceeds
  what the impact needs.

A compliant half space would be the simpler floor, but Drake 1.51 aborts the process where a corner of the object lies
on its plane to the last bit, so that the floor is a box.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    PerceptionProperties,
    Role,
    SceneGraph,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.models import model_path
from pinwm_drake.systems.cameras.object_camera import OBJECT_LABEL, PUSHER_LABEL
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.shipped import piece_names, shipped_pieces, shipped_supports, shipped_uri
from pinwm_drake.systems.sdf.text import floor_sdf, object_point_sdf, object_sdf
from pinwm_drake.systems.sdf.twin import ContactName, object_text, pusher_text, twin_solid, twin_surfaces

_STICTION_SPEED = 1e-5  # m/s, below which friction is viscous
_MODELS = {"hydroelastic": ContactModel.kHydroelastic, "point": ContactModel.kPoint}


@dataclass(frozen=True, eq=False)
class PushPlant:
    """The parts of a pushing scene in a diagram.

    Attributes:
        setup: What it was made from.
        plant: With the input port `pusher_desired_state`: p_WP (3) [m], v_WP (3) [m/s].
        scene_graph: Its geometries.
        object: Free body; frame O is its body frame.
        object_instance: Its model instance: positions q_WO (4) wxyz, p_WO (3) [m], velocities w_WO (3) [rad/s],
            v_WO (3) [m/s] of O.
        pusher: Body whose frame is P; translates along three axes of the world, unless something else holds it.
        pusher_instance: Its model instance: positions p_WP (3) [m], velocities v_WP (3) [m/s].
    """

    setup: Setup
    plant: MultibodyPlant
    scene_graph: SceneGraph
    object: RigidBody
    object_instance: ModelInstanceIndex
    pusher: RigidBody
    pusher_instance: ModelInstanceIndex


def MakePushPlant(
    builder: DiagramBuilder,
    setup: Setup,
    contact: ContactName = "hydroelastic",
    hold: Callable[[MultibodyPlant, RigidBody], None] | None = None,
) -> PushPlant:
    """Adds a finalized plant and its scene graph to a diagram.

    Args:
        builder: Of the diagram.
        setup: What there is.
        contact: The contact model.
        hold: Called with the plant, before it is finalized, and the pusher, which then has no joints of its own: adds
            what holds it. None for a pusher with drives.

    Returns:
        The parts.

    Raises:
        InputError: A mesh cannot be used.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=setup.plant_time_step)
    plant.set_contact_model(_MODELS[contact])
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    plant.set_stiction_tolerance(_STICTION_SPEED)
    bodies = AddPushBodies(plant, setup, contact, driven=hold is None)
    if hold is not None:
        hold(plant, bodies["pusher"])
    plant.Finalize()
    parts = PushPlant(setup, plant, scene_graph, **bodies)
    _keep_apart(parts, plant.GetBodyByName("floor"))
    LabelBodies(parts)
    return parts


def AddPushBodies(plant: MultibodyPlant, setup: Setup, contact: ContactName, *, driven: bool = True) -> dict[str, Any]:
    """Adds object, pusher and floor, in this order, to a plant that is not finalized, and sets its gravity.

    Args:
        plant: Registered with a SceneGraph.
        setup: What there is.
        contact: Which geometries the object has.
        driven: Whether the pusher has joints and drives of its own.

    Returns:
        The attributes of `PushPlant` that are bodies and model instances, by name. Drake puts floating bodies last:
        the positions of a plant with nothing else are p_WP, q_WO, p_WO.

    Raises:
        InputError: A mesh cannot be used.
    """
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -setup.twin.gravity])
    parser = Parser(plant=plant)
    parser.SetStrictParsing()
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    texts = scene_texts(setup, contact, driven=driven)
    pushed, pusher, _ = (parser.AddModelsFromString(text, "sdf")[0] for text in texts)
    plant.set_gravity_enabled(pusher, False)
    return {
        "object": plant.GetBodyByName("object", pushed),
        "object_instance": pushed,
        "pusher": plant.GetBodyByName("pusher", pusher),
        "pusher_instance": pusher,
    }


def scene_texts(setup: Setup, contact: ContactName, *, driven: bool = True) -> tuple[str, str, str]:
    """The SDFormat of object, pusher and floor; meshes that do not ship are written to a folder of this process.

    Args:
        setup: What there is.
        contact: Which geometries the object has.
        driven: Whether the pusher has joints and drives of its own.

    Raises:
        InputError: A mesh cannot be used.
    """
    twin, name = setup.twin, setup.scenario.object
    surfaces = twin_surfaces(twin, setup.scenario.plant.reference_speed)
    folder = _scratch_folder() if name is None or twin.pusher.shape is None else Path()
    prefix = f"file://{folder}/"
    visual = None if setup.visual_path == twin.mesh_path else f"file://{setup.visual_path.resolve()}"
    if name is None:
        pushed = object_text(twin, surfaces, contact, folder, prefix, "Object.", visual=visual)
    elif contact == "hydroelastic":
        mesh = shipped_uri(f"{name}/{name}_contact.obj")
        pushed = object_sdf(name, twin_solid(twin), str(visual), mesh, surfaces, "Object.")
    else:
        pieces = [shipped_uri(file) for file in piece_names(name, len(shipped_pieces(name)))]
        supports = shipped_supports(name)
        pushed = object_point_sdf(name, twin_solid(twin), str(visual), pieces, supports, surfaces, "Object.")
    pusher = pusher_text(twin, surfaces, folder, prefix, "Pusher.", driven=driven)
    return pushed, pusher, floor_sdf(surfaces, twin.floor_height, "Floor.")


def _scratch_folder() -> Path:
    """A folder that goes when this process ends; Meshcat reads meshes again whenever it shows them."""
    folder = Path(tempfile.mkdtemp(prefix="pinwm_plant_"))
    # Unlike atexit, this also works in a worker of a pool.
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=0)
    return folder


def _keep_apart(parts: PushPlant, floor: RigidBody) -> None:
    """Lets the floor touch an object's supports only, and the pusher the rest of it."""
    inspector, manager = parts.scene_graph.model_inspector(), parts.scene_graph.collision_filter_manager()
    of_body = parts.plant.GetCollisionGeometriesForBody
    mine, hands, ground = of_body(parts.object), of_body(parts.pusher), of_body(floor)

    def named(start: str) -> list[GeometryId]:
        return [k for k in mine if inspector.GetName(k).split("::")[-1].startswith(start)]

    manager.Apply(
        CollisionFilterDeclaration()
        .ExcludeBetween(GeometrySet(hands), GeometrySet([*ground, *named("support_")]))
        .ExcludeBetween(GeometrySet(named("piece_")), GeometrySet(ground))
    )


def LabelBodies(parts: PushPlant) -> None:
    """Has cameras see object and pusher with `OBJECT_LABEL` and `PUSHER_LABEL`."""
    inspector, source = parts.scene_graph.model_inspector(), parts.plant.get_source_id()
    for body, label in ((parts.object, OBJECT_LABEL), (parts.pusher, PUSHER_LABEL)):
        for geometry in parts.plant.GetVisualGeometriesForBody(body):
            properties = PerceptionProperties(inspector.GetPerceptionProperties(geometry))
            properties.UpdateProperty("label", "id", label)
            # A perception role cannot be replaced.
            parts.scene_graph.RemoveRole(source, geometry, Role.kPerception)
            parts.scene_graph.AssignRole(source, geometry, properties)
