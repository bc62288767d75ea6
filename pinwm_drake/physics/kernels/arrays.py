# SPDX-License-Identifier: MIT
"""Arrays that describe a model to the kernels, constant in a rollout."""

from typing import NamedTuple

import numpy as np

from pinwm_drake.geometry.pieces import PieceTable

# Kinds of joint rows.
LINEAR = 0
ANGULAR_LOCKED = 1
ANGULAR_HINGE = 2


class ModelArrays(NamedTuple):
    """Frozen model as arrays and numbers, in the form that the kernels read.

    Bodies are numbered dynamic (0..num_bodies-1), then the pusher if there is one, then the static world.
    """

    num_bodies: int  # dynamic bodies
    num_kinematic: int  # 1 with a pusher, else 0
    floor_height: float  # m, world frame; 0 without a floor
    gravity: np.ndarray  # (3,), m/s^2, world frame
    time_step: float  # h, s; see `step.py` for shorter ones
    # (num_bodies, num_bodies + 2), row of the pair tables for bodies A and B, or -1; the column after the last
    # dynamic body is the pusher, the last one the world
    pair_index: np.ndarray
    num_pairs: int  # rows of the pair tables
    radius: np.ndarray  # (num_bodies + 1,), m, of a sphere about each body's origin that holds it; the pusher's last
    # (num_bodies,), whether a piece is a cylinder, whose rims rest on corners that change, and roll with friction
    has_rims: np.ndarray
    # (num_bodies,), whether floor points come and go as the body turns: rims, points of a face that lies flat, or more
    # than are kept
    floor_changes: np.ndarray
    contact_compliance: float  # epsilon of a contact, (m/s)/(N s), per unit of impulse
    joint_compliance: float  # the same for joint rows
    pusher_force: float  # largest normal force with which the pusher presses on a body, N
    impact_impulse: np.ndarray  # (num_bodies,), impulse that it gives beyond that where it hits the body, N s
    # (num_bodies, 2), metric [kg m^2, kg] of the position correction over the total mass
    stabilisation_weight: np.ndarray
    margin: float  # contacts nearer than this, plus what bodies may travel in a step, take part in it, m
    joint_kind: np.ndarray  # (num_rows,), one of the kinds above
    joint_bodies: np.ndarray  # (num_rows, 2), bodies A and B
    joint_anchor: np.ndarray  # (num_rows, 2, 3), anchors in body frames A and B, m; for hinges the axis in A and B
    joint_direction: np.ndarray  # (num_rows, 3), constrained direction in body frame B
    joint_rotation: np.ndarray  # (num_rows, 3, 3), R_BA to be kept by locked rows
    table: PieceTable  # the convex pieces of the dynamic bodies and the pusher
