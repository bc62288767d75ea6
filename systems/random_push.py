"""Draws a straight push for an object where it lies, within the limits of the pusher."""

import numpy as np
from pydrake.math import RigidTransform

from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.systems.crosscheck_pushes import coasting_speed
from pinwm_drake.systems.push_choice import choose_push, pushing_height, upright_shape
from pinwm_drake.systems.pusher_motion import StraightPush
from pinwm_drake.systems.setup import Setup
from pinwm_drake.systems.start import StartDistribution

_DISTANCE = 0.10  # m, that the pusher goes on after it has met the object
_ATTEMPTS = 20


def random_push(setup: Setup, X_WO: RigidTransform, generator: np.random.Generator) -> StraightPush:
    """Draws direction and offset of a push through the object.

    Args:
        setup: Object, pusher and its limits.
        X_WO: Pose of the object, at rest.
        generator: Draws them.

    Returns:
        The push: level, at the height of `scenario.start`, as fast as lets the object slide on by some 20 mm.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The pusher meets no side of the object at that height, or no push stays in the pusher's box.
    """
    limits, theta = setup.scenario.pusher, setup.twin.theta
    mesh_W = load_mesh(setup.twin.mesh_path)
    mesh_W.apply_transform(X_WO.GetAsMatrix4())
    p_WB, shape = mass_properties(mesh_W, mass=1.0).p_com, upright_shape(setup.twin.pusher)
    speed = min(coasting_speed(theta["friction_floor"].value, setup.twin.gravity), limits.max_speed)
    for _ in range(_ATTEMPTS):
        push = choose_push(
            mesh_W,
            p_WB,
            shape,
            generator,
            height=setup.scenario.start.pusher_height,
            speed=speed,
            distance=_DISTANCE,
        )
        ends = np.stack([push.p_WP, push.p_WP + push.distance * push.direction_W])
        if (ends >= limits.low).all() and (ends <= limits.high).all():
            return push
    raise ParameterError(
        f"pusher.low, pusher.high: got {limits.low} and {limits.high} m; allowed: a box with room to push the object "
        f"at {np.round(p_WB, 3).tolist()} m by {_DISTANCE:g} m"
    )


def level_height(setup: Setup) -> float:
    """Height z of a pusher [m, world] that pushes at the height of the centre of mass, or as near as the floor allows.

    Args:
        setup: Of an object that lies as `scenario.start.q_WO` has it.

    Raises:
        InputError: A mesh cannot be used.
    """
    mesh, shape = load_mesh(setup.twin.mesh_path), upright_shape(setup.twin.pusher)
    p_OB_z = (StartDistribution(setup).middle().X_WO @ mass_properties(mesh, mass=1.0).p_com)[2]
    return pushing_height(shape, setup.twin.floor_height, float(p_OB_z))
