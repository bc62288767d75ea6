# SPDX-License-Identifier: MIT
"""Scenes that several tests share."""

import numpy as np
import torch

from pinwm_drake.geometry.shapes import box, capsule, sphere
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State

BAR, STEM = (0.1, 0.04, 0.05), (0.04, 0.1, 0.05)
EYE = np.eye(3)


def box_inertia(size, mass):
    x, y, z = size
    return mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])


def t_block(mass=1.0):
    """The task's T: bar and stem of equal mass, the origin in their common centre."""
    pieces, inertia = [], np.zeros((3, 3))
    for size, y in ((BAR, -0.035), (STEM, 0.035)):
        pieces.append(box(size, (EYE, np.array([0.0, y, 0.0]))))
        inertia += box_inertia(size, mass / 2) + mass / 2 * np.diag([y * y, 0.0, y * y])
    return Body("t_block", pieces, mass, inertia)


def cube(name="cube", edge=0.05, mass=0.4):
    return Body(name, [box((edge,) * 3)], mass, box_inertia((edge,) * 3, mass))


def ball(name="ball", radius=0.02, mass=0.3):
    return Body(name, [sphere(radius)], mass, 0.4 * mass * radius**2 * EYE)


def push_model(pusher="sphere", **options):
    pieces = {"sphere": [sphere(0.01)], "capsule": [capsule(0.01, 0.04)]}[pusher]
    return Model(bodies=[t_block()], pusher=pieces, **options)


def push_start(model, num_worlds=1, yaw=0.1):
    """The T on the floor, turned a little so that nothing is aligned, and the pusher just before its bar."""
    return State.at_rest(
        model,
        num_worlds,
        q_WB=(np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)),
        p_WB=(0.0, 0.0, 0.025),
        p_WP=(0.02, -0.066, 0.02),
    )


def straight_push(steps, num_worlds=1, velocity=(0.013, 0.15, 0.0)):
    """V_WP (steps, W, 6) of a pusher that translates."""
    V = torch.zeros(steps, num_worlds, 6, dtype=torch.float64)
    V[..., 3:] = torch.tensor(velocity, dtype=torch.float64)
    return V


def random_quaternion(generator, *shape):
    q = torch.randn(*shape, 4, dtype=torch.float64, generator=generator)
    return q / q.norm(dim=-1, keepdim=True)


def energy(model, parameters, state):
    """Kinetic and potential energy (W,) of the bodies, J."""
    from pinwm_drake.spatial.rotations import quaternion_to_matrix

    R = quaternion_to_matrix(state.q_WB)
    w, v = state.V_WB[..., :3], state.V_WB[..., 3:]
    w_B = (R.mT @ w[..., None])[..., 0]
    spin = 0.5 * (w_B * (parameters.inertia @ w_B[..., None])[..., 0]).sum(-1)
    speed = 0.5 * parameters.mass * (v * v).sum(-1)
    gravity = torch.tensor(model.gravity, dtype=torch.float64)
    return (spin + speed - parameters.mass * (state.p_WB @ gravity)).sum(-1)


def run(stepper, parameters, state, seconds, V_WP=None):
    """Rolls out for a time with a resting (or given, constant) pusher; records every step."""
    steps = round(seconds / stepper.model.time_step)
    V = torch.zeros(steps, state.num_worlds, 6, dtype=torch.float64)
    if V_WP is not None:
        V[:] = V_WP
    return stepper.rollout(parameters, state, V)


def nominal(model, **options):
    return Parameters.nominal(model, **options)
