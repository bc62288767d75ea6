# SPDX-License-Identifier: MIT
"""The work arrays of one world, made once per rollout so that a step allocates nothing (numba)."""

from typing import NamedTuple

import numpy as np

from pinwm_drake.geometry.features import FEATURE_SIZE
from pinwm_drake.jit import allocating_kernel


class BodyWork(NamedTuple):
    """Poses and velocities at the start of a step: dynamic bodies, then the pusher, then the world."""

    q: np.ndarray  # (N, 4), q_WB, (w, x, y, z)
    R: np.ndarray  # (N, 3, 3), R_WB
    p: np.ndarray  # (N, 3), p_WB, m
    V: np.ndarray  # (N, 6), V_WB, [rad/s; m/s], before the stage
    V_body: np.ndarray  # (nb, 3), angular velocity whose gyroscopic torque the stage takes, body frame, rad/s
    # (2,), s: that of the model or a part of it, see `step.py`, and what that was before a time of impact ended it,
    # for which contacts are selected
    time_step: np.ndarray
    center: np.ndarray  # (N, 3), centre of mass B in the frame of the pieces, m; 0 for the pusher and the world
    place: np.ndarray  # (N, 3), origin of that frame, world frame, m
    spread: np.ndarray  # (nb, 3), factors of the pressure's spread along the axes of B
    offset: np.ndarray  # (num_pairs,), gap at which a pair touches, m


class ContactWork(NamedTuple):
    """The contacts of a step."""

    number: np.ndarray  # (1,), number of contacts
    rows: np.ndarray  # (C, 16), feature pairs
    body: np.ndarray  # (C, 2), bodies A and B in BodyWork's numbering
    dynamic: np.ndarray  # (C, 2), the same, -1 where that side does not move freely
    pair: np.ndarray  # (C,), row of the pair tables
    frame: np.ndarray  # (C, 3, 3), rows nhat_BA_W, t1, t2
    witness: np.ndarray  # (C, 2, 3), surface points on A and B, world frame, m
    lever: np.ndarray  # (C, 2, 3), contact point from the origins of A and B, world frame, m
    gap: np.ndarray  # (C,), m
    J: np.ndarray  # (C, 2, 3, 6), Jacobians in the contact frame, B's with its minus sign
    closed: np.ndarray  # (C,), 1 where the contact touches at the start of the step
    approach: np.ndarray  # (C,), normal relative velocity at the start of the step, m/s
    bias: np.ndarray  # (C, 3), m/s
    # (C, 3), what of it levers and normals that turn make, m/s; in the adjoint its derivative by the length, m/s^2
    curve: np.ndarray
    rebound: np.ndarray  # (C,), speed of a bounce, m/s
    elastic: np.ndarray  # (1,), share of the bounces that is in bias
    mu: np.ndarray  # (C,), friction coefficients
    limit: np.ndarray  # (C,), largest normal impulse, N s


class SystemWork(NamedTuple):
    """The bodies' part of a step; see `cone.py`."""

    num_bodies: int  # dynamic ones
    num_rows: int  # of joints
    contact_compliance: float  # (m/s)/(N s)
    joint_compliance: float  # the same, and its angular likes
    inertia: np.ndarray  # (nb, 3, 3), about the origin, world axes, kg m^2
    mass: np.ndarray  # (nb,), kg
    momentum: np.ndarray  # (6 nb,), right-hand side p = M xi* + h f, [N m s; N s]
    free: np.ndarray  # (6 nb,), velocity without contacts and joints, [rad/s; m/s]
    J_e: np.ndarray  # (nr, 6 nb), joint rows
    bias_e: np.ndarray  # (nr,), of these
    error_e: np.ndarray  # (nr,), joint position errors, m or rad


class SolverWork(NamedTuple):
    """Solution and scratch of a step's solvers and of the stabilisation."""

    x: np.ndarray  # (n,), [xi'; lambda_e]
    v: np.ndarray  # (C, 3), velocity J x + bias of each contact in its frame, m/s
    lam: np.ndarray  # (C, 3), impulse of each contact in its frame, N s
    mode: np.ndarray  # (C,), see `cone.py`
    first: np.ndarray  # (C,), modes of the stage before the velocity stage
    u: np.ndarray  # (6 nb,), velocities of the position stage
    hit: np.ndarray  # (1,), contact whose time of impact ends the step, or -1
    slip: np.ndarray  # (C, 3), direction of friction, and what it resists across that direction
    gain: np.ndarray  # (C, 6), impulse as a function of velocity, see `cone.py`
    offset: np.ndarray  # (C, 3), of that function
    rho: np.ndarray  # (C,), mass that a contact feels along its surface, about, kg
    radius: np.ndarray  # (C,), bounds of friction in `descent.py`, N s
    dv: np.ndarray  # (C, 3), change of v along dx
    dx: np.ndarray  # (n,), right-hand side and step
    kept: np.ndarray  # (n,), a former x
    S: np.ndarray  # (n, n), derivative of the step's equations, then its factors
    pivot: np.ndarray  # (n,), row exchanges of the factors
    lagged: np.ndarray  # (1,), 1 where friction has the bounds of an iteration before; see `solve.py`
    lifts: np.ndarray  # (C,), 1 where a contact pushes in the stabilisation
    delta: np.ndarray  # (6 nb,), correction by the stabilisation
    S_delta: np.ndarray  # (6 nb, 6 nb), its matrix and factors
    pivot_delta: np.ndarray  # (6 nb,), row exchanges of these


class Sweep(NamedTuple):
    """Poses within a step, and the rows that are left out; see `impact.py`."""

    q: np.ndarray  # (N, 4), as in BodyWork
    R: np.ndarray  # (N, 3, 3)
    p: np.ndarray  # (N, 3)
    place: np.ndarray  # (N, 3), as in BodyWork
    rows: np.ndarray  # (C, 16), feature pairs there
    point: np.ndarray  # (3, 3), scratch: normal and witness points
    turns: np.ndarray  # (1,), 1 where a body turns
    out: np.ndarray  # (C,), AWAY or BESIDE where a row is left out


class AdjointWork(NamedTuple):
    """Gradients on their way back through a step; bodies as in BodyWork."""

    pose: np.ndarray  # (N, 6), with respect to poses as [rotation vector; translation], world frame
    V: np.ndarray  # (N, 6), with respect to V_WB
    before: np.ndarray  # (N, 6), scratch: with respect to V_WB before the step, through restitution
    y: np.ndarray  # (n,), adjoint of the step's x
    field: np.ndarray  # (N, 6), velocities whose contact velocities are the adjoint of the contacts' impulses
    pull: np.ndarray  # (N, 6), with respect to velocities before the step, through the share of bounces
    other: np.ndarray  # (n,), scratch: derivative of the bodies' gain of energy, pulled through the step's equations
    middle: np.ndarray  # (N, 6), with respect to poses after half of a step, as pose
    touch: np.ndarray  # (N, 6), derivative of the gap whose time of impact ends the step, as pose
    length: np.ndarray  # (1,), with respect to the length of the velocity stage
    left: np.ndarray  # (1,), with respect to what is left of a step after a part of it
    frame: np.ndarray  # (3, 3), scratch of one contact
    lever: np.ndarray  # (2, 3), scratch of one contact
    J_e: np.ndarray  # (nr, 6 nb), with respect to joint rows
    error_e: np.ndarray  # (nr,)
    center: np.ndarray  # (nb, 3), with respect to that of BodyWork
    spread: np.ndarray  # (nb, 3)
    offset: np.ndarray  # (num_pairs,)
    kept_state: np.ndarray  # (2, N, 6), pose and V before a step that is repeated
    kept: np.ndarray  # (nb, 16), gradients of mass, center, spread and inertia before it
    kept_pairs: np.ndarray  # (num_pairs, 3), of friction, restitution and offset before it
    moved: np.ndarray  # (2, 3), scratch: what a contact's geometry adds to the gradient by the places of its two bodies


@allocating_kernel
def make_adjoint_work(model):
    """Allocates the adjoint's work arrays."""
    nb = model.num_bodies
    nr = model.joint_kind.shape[0]
    return AdjointWork(
        np.zeros((nb + 2, 6)),
        np.zeros((nb + 2, 6)),
        np.zeros((nb + 2, 6)),
        np.zeros(6 * nb + nr),
        np.zeros((nb + 2, 6)),
        np.zeros((nb + 2, 6)),
        np.zeros(6 * nb + nr),
        np.zeros((nb + 2, 6)),
        np.zeros((nb + 2, 6)),
        np.zeros(1),
        np.zeros(1),
        np.zeros((3, 3)),
        np.zeros((2, 3)),
        np.zeros((nr, 6 * nb)),
        np.zeros(nr),
        np.zeros((nb, 3)),
        np.zeros((nb, 3)),
        np.zeros(model.num_pairs),
        np.zeros((2, nb + 2, 6)),
        np.zeros((nb, 16)),
        np.zeros((model.num_pairs, 3)),
        np.zeros((2, 3)),
    )


@allocating_kernel
def make_workspace(model, max_contacts):
    """Allocates the work tuples for a model and at most max_contacts contacts."""
    nb = model.num_bodies
    nr = model.joint_kind.shape[0]
    total = nb + 2
    n = 6 * nb + nr
    m = max_contacts
    bodies = BodyWork(
        np.zeros((total, 4)),
        np.zeros((total, 3, 3)),
        np.zeros((total, 3)),
        np.zeros((total, 6)),
        np.zeros((nb, 3)),
        np.full(2, model.time_step),
        np.zeros((total, 3)),
        np.zeros((total, 3)),
        np.ones((nb, 3)),
        np.zeros(model.num_pairs),
    )
    contacts = ContactWork(
        np.zeros(1, np.int64),
        np.zeros((m, FEATURE_SIZE)),
        np.zeros((m, 2), np.int64),
        np.zeros((m, 2), np.int64),
        np.zeros(m, np.int64),
        np.zeros((m, 3, 3)),
        np.zeros((m, 2, 3)),
        np.zeros((m, 2, 3)),
        np.zeros(m),
        np.zeros((m, 2, 3, 6)),
        np.zeros(m, np.uint8),
        np.zeros(m),
        np.zeros((m, 3)),
        np.zeros((m, 3)),
        np.zeros(m),
        np.ones(1),
        np.zeros(m),
        np.zeros(m),
    )
    system = SystemWork(
        nb,
        nr,
        model.contact_compliance,
        model.joint_compliance,
        np.zeros((nb, 3, 3)),
        np.zeros(nb),
        np.zeros(6 * nb),
        np.zeros(6 * nb),
        np.zeros((nr, 6 * nb)),
        np.zeros(nr),
        np.zeros(nr),
    )
    solver = SolverWork(
        np.zeros(n),
        np.zeros((m, 3)),
        np.zeros((m, 3)),
        np.zeros(m, np.uint8),
        np.zeros(m, np.uint8),
        np.zeros(6 * nb),
        np.full(1, -1),
        np.zeros((m, 3)),
        np.zeros((m, 6)),
        np.zeros((m, 3)),
        np.zeros(m),
        np.zeros(m),
        np.zeros((m, 3)),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(n, np.int64),
        np.zeros(1, np.int64),
        np.zeros(m, np.uint8),
        np.zeros(6 * nb),
        np.zeros((6 * nb, 6 * nb)),
        np.zeros(6 * nb, np.int64),
    )
    sweep = Sweep(
        np.zeros((total, 4)),
        np.zeros((total, 3, 3)),
        np.zeros((total, 3)),
        np.zeros((total, 3)),
        np.zeros((m, FEATURE_SIZE)),
        np.zeros((3, 3)),
        np.zeros(1, np.int64),
        np.zeros(m, np.uint8),
    )
    bodies.q[:, 0] = 1.0
    for b in range(total):
        for i in range(3):
            bodies.R[b, i, i] = sweep.R[b, i, i] = 1.0
    return bodies, contacts, system, solver, sweep
