# SPDX-License-Identifier: MIT
"""Random pushes that tell about friction: after each, the object slides on by itself."""

from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from pydrake.math import RigidTransform

from pinwm_drake.capture.pusher import pushing_height, upright_shape
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.scene import Scene, resting_height
from pinwm_drake.systems.pusher.choice import choose_push, coasting_speed
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.twin.rollout import twin_scene

_VARIATION = (0.85, 1.15)  # factors of the speed
_DISTANCES = (0.04, 0.10)  # m, that the pusher goes on after it has met the object
_DELAY = 0.05  # s, in which the object settles


@dataclass(frozen=True, eq=False)
class Trial:
    """A push, and the pose of the object before it.

    Attributes:
        X_WO: Pose of the object, at rest.
        push: Motion of the pusher.
    """

    X_WO: RigidTransform
    push: StraightPush


def draw_trials(setup: Setup, reference: Setup, number: int, seed: int) -> list[Trial]:
    """Draws pushes; trial k does not depend on their number.

    Args:
        setup: The scene of the twin: starts of the object, its mesh and pusher.
        reference: Setup whose friction on the floor sets the speed of the pusher, so that twins that are checked
            against one and the same truth get the same pushes.
        number: Number of pushes.
        seed: Seed of the draw.

    Returns:
        The trials. Pushes are level, at the height of the centre of mass, or as near to it as the floor allows.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The pusher meets no side of the object at its height.
    """
    twin, shape = setup.twin, upright_shape(setup.twin.pusher)
    speed = coasting_speed(reference.twin.theta["friction_floor"].value, reference.twin.gravity)
    # The physics tells which face carries the object by the orientation that the scenario names.
    scene = twin_scene(twin, torch.as_tensor(setup.scenario.start.q_WO, dtype=torch.float64))
    trials = []
    for k in range(number):
        generator = np.random.default_rng([seed, k])
        X_WO, mesh_W, p_WB = draw_object(setup, scene, generator)
        push = choose_push(
            mesh_W,
            p_WB,
            shape,
            generator,
            height=pushing_height(shape, twin.floor_height, p_WB[2]),
            speed=speed * generator.uniform(*_VARIATION),
            distance=generator.uniform(*_DISTANCES),
        )
        trials.append(Trial(X_WO, replace(push, delay=_DELAY)))
    return trials


def draw_object(
    setup: Setup, scene: Scene | None, generator: np.random.Generator
) -> tuple[RigidTransform, trimesh.Trimesh, np.ndarray]:
    """Draws a start of a scene's object, at rest.

    Args:
        setup: The scene of the twin.
        scene: Its physics model, which tells the face that carries the object; None for the face that it starts on.
        generator: Source of randomness.

    Returns:
        Its pose X_WO, its mesh [m, world], and its centre of mass (3,) m, world.
    """
    mesh_W, X_WO = load_mesh(setup.twin.mesh_path), StartDistribution(setup).draw(generator).X_WO
    q_WO = torch.from_numpy(X_WO.rotation().ToQuaternion().wxyz())
    X_WO.set_translation([*X_WO.translation()[:2], resting_height(scene or twin_scene(setup.twin, q_WO), q_WO)])
    p_WB = X_WO @ mass_properties(mesh_W, mass=1.0).p_com
    mesh_W.apply_transform(X_WO.GetAsMatrix4())
    return X_WO, mesh_W, p_WB
