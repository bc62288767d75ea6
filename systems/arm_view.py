"""The simulated arm in Meshcat, with what a station shows of its scene."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.systems.framework import DiagramBuilder, OutputPort

from pinwm_drake.systems.plant_forces import PlantForces
from pinwm_drake.systems.push_plant import PushPlant
from pinwm_drake.systems.scene_view import AddSceneView

_EYE, _TARGET = np.array([1.3, -1.3, 1.0]), np.array([0.0, 0.15, 0.35])  # m, world, of the page's own look


@dataclass(frozen=True, eq=False)
class _Parts:
    """What `AddSceneView` reads of an engine."""

    name: str
    object_state: OutputPort
    contact_forces: OutputPort
    scene_graph: SceneGraph


def AddArmView(builder: DiagramBuilder, parts: PushPlant, meshcat: Meshcat, name: str) -> None:
    """Adds to a diagram what shows arm, object, floor, camera and contact forces.

    Args:
        builder: Of the diagram that holds the plant.
        parts: The plant with the arm.
        meshcat: The server.
        name: Of the contact model.
    """
    forces = builder.AddNamedSystem("plant_forces", PlantForces(parts))
    builder.Connect(parts.plant.get_contact_results_output_port(), forces.get_input_port())
    state = parts.plant.get_state_output_port(parts.object_instance)
    AddSceneView(builder, _Parts(name, state, forces.get_output_port(), parts.scene_graph), meshcat, parts.setup)
    meshcat.SetCameraPose(_EYE, _TARGET)
