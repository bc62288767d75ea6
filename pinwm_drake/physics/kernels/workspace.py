"""The work arrays of one world, made once per rollout so that a step allocates nothing (numba)."""

from typing import NamedTuple

import numpy as np

from pinwm_drake.geometry.features import FEATURE_SIZE
from pinwm_drake.jit import allocating_kernel


class BodyWork(NamedTuple):
    """Poses and velocities at the start of a step: dynamic bodies, then the pusher, then the world.

    Attributes:
        q: (N, 4), q_WB, (w, x, y, z).
        R: (N, 3, 3), R_WB.
        p: (N, 3), p_WB, m.
        V: (N, 6), V_WB, [rad/s; m/s].
        V_body: (nb, 3), angular velocity after the gyroscopic step, body frame, rad/s.
        time_step: (1,), s, the model's, or a part of it; see `step.py`.
        center: (N, 3), centre of mass B in the frame of the pieces, m; 0 for the pusher and the world.
        place: (N, 3), origin of that frame, world frame, m.
        spread: (nb, 3), factors of the pressure's spread along the axes of B.
        offset: (num_pairs,), gap at which a pair touches, m.
    """

    q: np.ndarray
    R: np.ndarray
    p: np.ndarray
    V: np.ndarray
    V_body: np.ndarray
    time_step: np.ndarray
    center: np.ndarray
    place: np.ndarray
    spread: np.ndarray
    offset: np.ndarray


class ContactWork(NamedTuple):
    """The contacts of a step.

    Attributes:
        number: (1,), number of contacts.
        rows: (C, 16), feature pairs.
        body: (C, 2), bodies A and B in BodyWork's numbering.
        dynamic: (C, 2), the same, -1 where that side does not move freely.
        pair: (C,), row of the pair tables.
        frame: (C, 3, 3), rows nhat_BA_W, t1, t2.
        witness: (C, 2, 3), surface points on A and B, world frame, m.
        lever: (C, 2, 3), contact point from the origins of A and B, world frame, m.
        gap: (C,), m.
        J: (C, 2, 3, 6), Jacobians in the contact frame, B's with its minus sign.
        approach: (C,), normal relative velocity before the step, m/s.
        closing: (C,), 1 where the contact closes within the step.
        bias: (C, 3), m/s.
        rebound: (C,), speed of a bounce, m/s, of which bias has the share in elastic (1,).
        mu: (C,), friction coefficients.
        limit: (C,), largest normal impulse, N s.
    """

    number: np.ndarray
    rows: np.ndarray
    body: np.ndarray
    dynamic: np.ndarray
    pair: np.ndarray
    frame: np.ndarray
    witness: np.ndarray
    lever: np.ndarray
    gap: np.ndarray
    J: np.ndarray
    approach: np.ndarray
    closing: np.ndarray
    bias: np.ndarray
    rebound: np.ndarray
    elastic: np.ndarray
    mu: np.ndarray
    limit: np.ndarray


class SystemWork(NamedTuple):
    """The bodies' part of a step; see `cone.py`.

    Attributes:
        num_bodies, num_rows: dynamic bodies and joint rows.
        contact_compliance, joint_compliance: (m/s)/(N s) and its angular likes.
        inertia: (nb, 3, 3), about the origin, world axes, kg m^2.
        mass: (nb,), kg.
        momentum: (6 nb,), right-hand side p = M xi* + h f, [N m s; N s].
        free: (6 nb,), velocity without contacts and joints, [rad/s; m/s].
        J_e: (nr, 6 nb), bias_e: (nr,), joint rows.
        error_e: (nr,), joint position errors, m or rad.
    """

    num_bodies: int
    num_rows: int
    contact_compliance: float
    joint_compliance: float
    inertia: np.ndarray
    mass: np.ndarray
    momentum: np.ndarray
    free: np.ndarray
    J_e: np.ndarray
    bias_e: np.ndarray
    error_e: np.ndarray


class SolverWork(NamedTuple):
    """Solution and scratch of a step's solvers and of the stabilisation.

    Attributes:
        x: (n,), [xi'; lambda_e].
        v, lam: (C, 3), velocity J x + bias and impulse of each contact in its frame, m/s and N s.
        mode: (C,), see `cone.py`.
        slip: (C, 3), direction of friction, and what it resists across that direction.
        gain, offset: (C, 6) and (C, 3), impulse as a function of velocity, see `cone.py`.
        radius: (C,), bounds of friction in `descent.py`, N s.
        dv: (C, 3), change of v along dx.
        dx, kept: (n,), right-hand side and step; a former x.
        S, pivot: the derivative of the step's equations and its factors.
        lagged: (1,), 1 where friction has the bounds of an iteration before; see `solve.py`.
        lifts: (C,), 1 where a contact pushes in the stabilisation.
        delta, S_delta, pivot_delta: the same of the stabilisation, of order 6 nb.
    """

    x: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    mode: np.ndarray
    slip: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    radius: np.ndarray
    dv: np.ndarray
    dx: np.ndarray
    kept: np.ndarray
    S: np.ndarray
    pivot: np.ndarray
    lagged: np.ndarray
    lifts: np.ndarray
    delta: np.ndarray
    S_delta: np.ndarray
    pivot_delta: np.ndarray


class Sweep(NamedTuple):
    """Poses within a step, and the rows that are left out; see `ghosts.py`.

    Attributes:
        q: (N, 4), R: (N, 3, 3), p: (N, 3), V: (N, 6), as in BodyWork.
        rows: (C, 16), feature pairs there.
        point: (3, 3), scratch: normal and witness points.
        out: (C,), 1 where a row is left out.
    """

    q: np.ndarray
    R: np.ndarray
    p: np.ndarray
    V: np.ndarray
    rows: np.ndarray
    point: np.ndarray
    out: np.ndarray


class AdjointWork(NamedTuple):
    """Gradients on their way back through a step; bodies as in BodyWork.

    Attributes:
        pose: (N, 6), with respect to poses as [rotation vector; translation], world frame.
        V: (N, 6), with respect to V_WB.
        before: (N, 6), scratch: with respect to V_WB before the step, through restitution.
        y: (n,), adjoint of the step's x.
        field: (N, 6), velocities whose contact velocities are the adjoint of the contacts' impulses.
        pull: (N, 6), with respect to velocities before the step, through the share of bounces.
        other: (n,), scratch: derivative of the bodies' gain of energy, pulled through the step's equations.
        energy: (1,), adjoint z of that gain; see `adjoint._share_adjoint`.
        frame: (3, 3), lever: (2, 3), scratch of one contact.
        J_e: (nr, 6 nb), bias_e: (nr,), error_e: (nr,), joint rows.
        center: (nb, 3), spread: (nb, 3), offset: (num_pairs,), with respect to these of BodyWork.
        moved: (2, 3), scratch: what a contact's geometry adds to the gradient by the places of its two bodies.
    """

    pose: np.ndarray
    V: np.ndarray
    before: np.ndarray
    y: np.ndarray
    field: np.ndarray
    pull: np.ndarray
    other: np.ndarray
    energy: np.ndarray
    frame: np.ndarray
    lever: np.ndarray
    J_e: np.ndarray
    bias_e: np.ndarray
    error_e: np.ndarray
    center: np.ndarray
    spread: np.ndarray
    offset: np.ndarray
    moved: np.ndarray


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
        np.zeros(1),
        np.zeros((3, 3)),
        np.zeros((2, 3)),
        np.zeros((nr, 6 * nb)),
        np.zeros(nr),
        np.zeros(nr),
        np.zeros((nb, 3)),
        np.zeros((nb, 3)),
        np.zeros(model.num_pairs),
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
        np.full(1, model.time_step),
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
        np.zeros(m),
        np.zeros(m),
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
        np.zeros((m, 3)),
        np.zeros((m, 6)),
        np.zeros((m, 3)),
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
        np.zeros((total, 6)),
        np.zeros((m, FEATURE_SIZE)),
        np.zeros((3, 3)),
        np.zeros(m, np.uint8),
    )
    bodies.q[:, 0] = 1.0
    for b in range(total):
        for i in range(3):
            bodies.R[b, i, i] = sweep.R[b, i, i] = 1.0
    return bodies, contacts, system, solver, sweep
