# SPDX-License-Identifier: MIT
"""Twin as an engine: the world model, and a plant of the same scene that lends its geometry to SceneGraph."""

from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from pinwm_drake.systems.engines.engine import Engine
from pinwm_drake.systems.engines.plant.scene import AddSceneBodies, LabelBodies, ScenePlant
from pinwm_drake.systems.engines.twin.world_model import WorldModel
from pinwm_drake.systems.scenario.setup import Setup


def AddTwinEngine(builder: DiagramBuilder, setup: Setup) -> Engine:
    """Add the world model, which is the engine's handle, and a SceneGraph that it poses.

    The plant has no part in the motion: it knows which geometries belong to the object and the pusher, and turns
    their positions into poses of geometries. SceneGraph then serves Meshcat, distance queries and RgbdSensors. It shows
    world 0.

    Args:
        builder: Builder of the diagram.
        setup: The scene and its settings.

    Raises:
        InputError: A mesh cannot be used.
    """
    world = builder.AddNamedSystem("world_model", WorldModel(setup))
    scene_graph = builder.AddNamedSystem("scene_graph", SceneGraph())
    plant = MultibodyPlant(setup.plant_time_step)
    plant.set_name("plant")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    bodies = AddSceneBodies(plant, setup, "hydroelastic")
    plant.Finalize()
    LabelBodies(ScenePlant(setup, plant, scene_graph, **bodies))
    # The world model's port has the plant's order: Drake puts a body that floats behind the joints of the others.
    assert bodies["object"].floating_positions_start() == 3
    poses = builder.AddNamedSystem("plant_poses", MultibodyPositionToGeometryPose(plant))
    poses.plant = plant  # which it refers to and does not keep
    builder.Connect(world.GetOutputPort("plant_positions"), poses.get_input_port())
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(plant.get_source_id()))
    return Engine(
        name="twin",
        pusher_velocity=world.get_input_port(),
        object_state=world.GetOutputPort("object_state"),
        pusher_state=world.GetOutputPort("pusher_state"),
        rgb=world.GetOutputPort("rgb"),
        rgb_batch=world.GetOutputPort("rgb_batch"),
        contact_forces=world.GetOutputPort("contact_forces"),
        scene_graph=scene_graph,
        handle=world,
    )
