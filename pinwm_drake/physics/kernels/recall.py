# SPDX-License-Identifier: MIT
"""A part of a step, built again from what was saved of it (numba)."""

from pinwm_drake.jit import small_kernel
from pinwm_drake.physics.kernels.cone import OPEN
from pinwm_drake.physics.kernels.detect import select_features
from pinwm_drake.physics.kernels.dynamics import POSITION, VELOCITY, rotation_from_quaternion
from pinwm_drake.physics.kernels.newton import recall_solution
from pinwm_drake.physics.kernels.states import load
from pinwm_drake.physics.kernels.step import build_stage


@small_kernel
def recall_contacts(model, bodies, contacts, solver, start, s, w):
    """Select the contacts of a part from the states `start` at frame s, with the modes in solver.mode."""
    load(bodies, model.num_bodies, model.num_kinematic > 0, start, s, w)
    for b in range(model.num_bodies + model.num_kinematic):
        rotation_from_quaternion(bodies.q[b], bodies.R[b])
    select_features(model, bodies, contacts)
    for c in range(contacts.number[0]):
        contacts.closed[c] = 1 if solver.mode[c] != OPEN else 0


@small_kernel
def recall_stage(model, theta, bodies, contacts, system, solver, sweep, start, s, end, at, w, stage):
    """Build a stage of a part and its solution, from states before it (`start`, s) and after it (`end`, at).

    The VELOCITY stage is recalled before the POSITION stage, whose modes take the place of its own.

    Returns:
        False if its matrix is singular.
    """
    nb, has_pusher = model.num_bodies, model.num_kinematic > 0
    mass, inertia, friction, restitution = theta
    load(bodies, nb, has_pusher, end if stage == VELOCITY else start, at if stage == VELOCITY else s, w)
    for b in range(nb):
        for i in range(6):
            solver.x[6 * b + i] = end[2][at, w, b, i] if stage != POSITION else solver.u[6 * b + i]
            if stage == VELOCITY:
                bodies.V[b, i] = solver.u[6 * b + i]
    if stage == POSITION:
        for c in range(contacts.number[0]):
            solver.mode[c] = solver.first[c]
    build_stage(model, mass, inertia, friction, restitution, bodies, contacts, system, solver, sweep, stage, False)
    return recall_solution(system, contacts, solver)
