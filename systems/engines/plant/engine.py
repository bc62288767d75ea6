# SPDX-License-Identifier: MIT
"""Plant as an engine: a MultibodyPlant with Drake's contact, a velocity-driven pusher, and an RgbdSensor."""

import dataclasses

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, DiagramBuilder

from pinwm_drake.errors import require
from pinwm_drake.systems.cameras.object_camera import AddObjectImage
from pinwm_drake.systems.engines.engine import Engine
from pinwm_drake.systems.engines.plant.forces import PlantForces
from pinwm_drake.systems.engines.plant.scene import MakeScenePlant, ScenePlant
from pinwm_drake.systems.pusher.drive import PusherDrive
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.systems.sdf.twin import ContactName

_SUPERSAMPLING = 3
# By this share the plant's steps are longer, so that a step which ends with a period never, by rounding, ends before
# it: what reads the plant then would find it one step ahead. The clock of a run of 1000 s is off by 1 ns.
_LATER = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class PlantHandle:
    """Handle that puts a plant's object and pusher into place; see `engine.Handle`."""

    parts: ScenePlant
    drive: PusherDrive

    def SetObjectState(self, context: Context, X_WO: RigidTransform, V_WO: np.ndarray, world: int = 0) -> None:
        """Set pose and spatial velocity V_WO (6,): [ω rad/s; v m/s] of the object at O."""
        require("world", world, world == 0, "0, as a plant is one world")
        plant, V = self.parts.plant, np.asarray(V_WO, float)
        mine = plant.GetMyMutableContextFromRoot(context)
        plant.SetFreeBodyPose(mine, self.parts.object, X_WO)
        velocity = SpatialVelocity(V[:3], V[3:])
        plant.SetFreeBodySpatialVelocity(context=mine, body=self.parts.object, V_JpJc=velocity)

    def SetPusherPosition(self, context: Context, p_WP: np.ndarray, world: int = 0) -> None:
        """Put the pusher to p_WP (3,) m; it rests until the next sample of its velocity."""
        require("world", world, world == 0, "0, as a plant is one world")
        plant, instance = self.parts.plant, self.parts.pusher_instance
        mine = plant.GetMyMutableContextFromRoot(context)
        plant.SetPositions(mine, instance, np.asarray(p_WP, float))
        plant.SetVelocities(mine, instance, np.zeros(3))
        self.drive.SetPosition(self.drive.GetMyMutableContextFromRoot(context), p_WP)


def AddPlantEngine(builder: DiagramBuilder, setup: Setup, contact: ContactName) -> Engine:
    """Add plant, pusher's drive and camera; the engine's handle is a PlantHandle.

    By default object and pusher are in the middle of `scenario.start`.

    Args:
        builder: Builder of the diagram.
        setup: The scene and its settings.
        contact: The contact model.

    Raises:
        InputError: A mesh cannot be used.
    """
    step = (1 + _LATER) * setup.plant_time_step
    parts = MakeScenePlant(builder, dataclasses.replace(setup, plant_time_step=step), contact)
    plant, place = parts.plant, StartDistribution(setup).middle()
    plant.SetDefaultFloatingBaseBodyPose(parts.object, place.X_WO)
    plant.SetDefaultPositions(parts.pusher_instance, place.p_WP)
    drive = builder.AddNamedSystem("pusher_drive", PusherDrive(setup.period, step, place.p_WP))
    builder.Connect(drive.get_output_port(), plant.get_desired_state_input_port(parts.pusher_instance))
    image = AddObjectImage(builder, parts.scene_graph, setup.camera, _SUPERSAMPLING, setup.X_WC, setup.renderer)
    forces = builder.AddNamedSystem("plant_forces", PlantForces(parts))
    builder.Connect(plant.get_contact_results_output_port(), forces.get_input_port())
    return Engine(
        name=contact,
        pusher_velocity=drive.get_input_port(),
        object_state=plant.get_state_output_port(parts.object_instance),
        pusher_state=plant.get_state_output_port(parts.pusher_instance),
        rgb=image.GetOutputPort("rgb"),
        rgb_batch=image.GetOutputPort("rgb_batch"),
        contact_forces=forces.get_output_port(),
        scene_graph=parts.scene_graph,
        handle=PlantHandle(parts, drive),
    )
