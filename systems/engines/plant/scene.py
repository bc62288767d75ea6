# SPDX-License-Identifier: MIT
"""Pushing scene as a MultibodyPlant: an object, a floor, and a pusher that follows the velocity that it is given.

Bodies come in through Drake's Parser, from the texts of `systems/sdf/text.py` with the theta of a setup. Contact is
hydroelastic, of a rigid object with a compliant and stiff floor and pusher, or that of points: small spheres carry the
object, and its convex pieces meet the pusher. The discrete approximation is "lagged". The reasons for it and for the
floor, and the accuracy that was measured, are in docs/explanation/hydroelastic.md, "Accuracy of the plants".
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    PerceptionProperties,
    Role,
    SceneGraph,
)
from pydrake.math import RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.files import scratch
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.geometry.stored_pieces import mesh_primitives
from pinwm_drake.models import model_path
from pinwm_drake.systems.cameras.object_camera import OBJECT_LABEL, PUSHER_LABEL
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.collision import EVEN, support_discs, support_spheres
from pinwm_drake.systems.sdf.shipped import piece_uri, shipped_pieces, shipped_support, shipped_supports, shipped_uri
from pinwm_drake.systems.sdf.text import floor_sdf, object_point_sdf, object_sdf
from pinwm_drake.systems.sdf.twin import (
    ContactName,
    object_text,
    pusher_text,
    twin_solid,
    twin_spread,
    twin_surfaces,
)
from pinwm_drake.tasks.registry import recipe_of

_STICTION_SPEED = 1e-5  # m/s, below which friction is viscous
_MODELS = {"hydroelastic": ContactModel.kHydroelastic, "point": ContactModel.kPoint}


@dataclass(frozen=True, eq=False)
class ScenePlant:
    """Parts of a pushing scene in a diagram.

    Attributes:
        setup: Setup that it was made from.
        plant: The plant, with the input port `pusher_desired_state`: p_WP (3) [m], v_WP (3) [m/s].
        scene_graph: The geometries of the plant.
        object: Free body; frame O is its body frame.
        object_instance: Model instance of the object: positions q_WO (4) wxyz, p_WO (3) [m], velocities w_WO (3)
            [rad/s], v_WO (3) [m/s] of O.
        pusher: Body whose frame is P; translates along three axes of the world, unless something else holds it.
        pusher_instance: Model instance of the pusher: positions p_WP (3) [m], velocities v_WP (3) [m/s].
    """

    setup: Setup
    plant: MultibodyPlant
    scene_graph: SceneGraph
    object: RigidBody
    object_instance: ModelInstanceIndex
    pusher: RigidBody
    pusher_instance: ModelInstanceIndex


def MakeScenePlant(
    builder: DiagramBuilder,
    setup: Setup,
    contact: ContactName = "hydroelastic",
    hold: Callable[[MultibodyPlant, RigidBody], None] | None = None,
) -> ScenePlant:
    """Add a finalized plant and its scene graph to a diagram.

    Args:
        builder: Builder of the diagram.
        setup: The scene and its settings.
        contact: The contact model.
        hold: Called with the plant, before it is finalized, and the pusher, which then has no joints of its own: adds
            what holds it. None for a pusher with drives.

    Raises:
        InputError: A mesh cannot be used.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=setup.plant_time_step)
    plant.set_contact_model(_MODELS[contact])
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    plant.set_stiction_tolerance(_STICTION_SPEED)
    bodies = AddSceneBodies(plant, setup, contact, driven=hold is None)
    if hold is not None:
        hold(plant, bodies["pusher"])
    plant.Finalize()
    parts = ScenePlant(setup, plant, scene_graph, **bodies)
    _keep_apart(parts, plant.GetBodyByName("floor"))
    LabelBodies(parts)
    return parts


def AddSceneBodies(plant: MultibodyPlant, setup: Setup, contact: ContactName, *, driven: bool = True) -> dict[str, Any]:
    """Add object, pusher and floor, in this order, to a plant that is not finalized, and set its gravity.

    Args:
        plant: Plant that is registered with a SceneGraph.
        setup: The scene and its settings.
        contact: Contact model, which the object's geometries are for.
        driven: Whether the pusher has joints and drives of its own.

    Returns:
        The attributes of `ScenePlant` that are bodies and model instances, by name. Drake puts floating bodies last:
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
    """SDFormat of object, pusher and floor; meshes that do not ship are written to a folder of this process.

    Arguments and errors are those of `AddSceneBodies`.
    """
    twin, name = setup.twin, setup.scenario.object
    if name is not None and twin.acts_as != mesh_primitives(twin.mesh_path):
        name = None  # the files that ship are of what the mesh acts as
    surfaces = twin_surfaces(twin, setup.scenario.plant.reference_speed)
    down = lying_side(setup)
    folder = _scratch_folder() if name is None or twin.pusher.shape is None else Path()
    prefix = f"file://{folder}/"
    visual = None if setup.visual_path == twin.mesh_path else f"file://{setup.visual_path.resolve()}"
    if name is None:
        pushed = object_text(twin, surfaces, contact, folder, prefix, "Object.", visual=visual, down=down)
    elif contact == "hydroelastic":
        mesh, support = shipped_uri(f"{name}/{name}_contact.obj"), shipped_support(name)
        pushed = object_sdf(name, twin_solid(twin), str(visual), mesh, support, surfaces, "Object.")
    else:
        pieces = shipped_pieces(name)
        spread, solid = twin_spread(twin), load_mesh(twin.mesh_path)
        supports = shipped_supports(name) if spread == EVEN else support_spheres(solid, spread, down, twin.acts_as)
        discs = support_discs(solid, twin.acts_as, spread)
        pushed = object_point_sdf(
            name, twin_solid(twin), str(visual), pieces, partial(piece_uri, name), supports, surfaces, "Object.", discs
        )
    pusher = pusher_text(twin, surfaces, folder, prefix, "Pusher.", driven=driven)
    return pushed, pusher, floor_sdf(surfaces, twin.floor_height, "Floor.")


def lying_side(setup: Setup) -> np.ndarray | None:
    """Outward normal (3,), frame O, of the side on which the object lies; None where the task's motions tip it."""
    if recipe_of(setup.task).check == "pokes":
        return None
    q_WO = np.array(setup.scenario.start.q_WO, float)
    return np.asarray(-RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO))).matrix()[2])


def _scratch_folder() -> Path:
    """Folder that goes when this process ends; Meshcat reads meshes again whenever it shows them."""
    folder = scratch()
    # Unlike atexit, this also works in a worker of a pool.
    Finalize(None, folder.cleanup, exitpriority=0)
    return Path(folder.name)


def _keep_apart(parts: ScenePlant, floor: RigidBody) -> None:
    """Let the floor touch an object's supports only, and the pusher the rest of it."""
    inspector, manager = parts.scene_graph.model_inspector(), parts.scene_graph.collision_filter_manager()
    of_body = parts.plant.GetCollisionGeometriesForBody
    mine, hands, ground = of_body(parts.object), of_body(parts.pusher), of_body(floor)

    def named(start: str) -> list[GeometryId]:
        return [k for k in mine if inspector.GetName(k).split("::")[-1].startswith(start)]

    manager.Apply(
        CollisionFilterDeclaration()
        .ExcludeBetween(GeometrySet(hands), GeometrySet([*ground, *named("support")]))
        .ExcludeBetween(GeometrySet(named("piece")), GeometrySet(ground))
    )


def LabelBodies(parts: ScenePlant) -> None:
    """Has cameras see object and pusher with `OBJECT_LABEL` and `PUSHER_LABEL`."""
    inspector, source = parts.scene_graph.model_inspector(), parts.plant.get_source_id()
    for body, label in ((parts.object, OBJECT_LABEL), (parts.pusher, PUSHER_LABEL)):
        for geometry in parts.plant.GetVisualGeometriesForBody(body):
            properties = PerceptionProperties(inspector.GetPerceptionProperties(geometry))
            properties.UpdateProperty("label", "id", label)
            # A perception role cannot be replaced.
            parts.scene_graph.RemoveRole(source, geometry, Role.kPerception)
            parts.scene_graph.AssignRole(source, geometry, properties)
