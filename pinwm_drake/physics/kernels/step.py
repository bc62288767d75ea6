# SPDX-License-Identifier: MIT
"""One forward step of one world: x' = g(x, a, theta) (numba).

A step's rows are those of the features at its start, moved along straight lines. Where a body turns fast, other
features come down meanwhile, and points move along arcs; what would then be deep in something at the step's end is
stepped in two halves instead, and they in halves again if need be.
"""

from pinwm_drake.jit import kernel, part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import FULL_STICKS
from pinwm_drake.physics.kernels.detect import build_rows, rebuild_rows, select_features
from pinwm_drake.physics.kernels.dynamics import begin_step, integrate_quaternion
from pinwm_drake.physics.kernels.ghosts import gap_after, leave_out_ghosts, switch_off, take_back_hits
from pinwm_drake.physics.kernels.joints import build_joints
from pinwm_drake.physics.kernels.restitution import solve_passively
from pinwm_drake.physics.kernels.stabilise import stabilise

# What is deeper than this at a step's end, m, and was not before, is stepped in halves; and the most parts of a step.
DEEP, MOST_PARTS = 5e-5, 16
# What `step_world` returns where it took no step, because it is to be taken in halves.
HALVE = -2


@small_kernel
def build_step(model, mass, inertia, friction, restitution, bodies, contacts, system):
    """Build a step up to its equations: dynamics, contacts, joints."""
    begin_step(model, mass, inertia, bodies, system)
    select_features(model, bodies, contacts)
    build_rows(model, friction, restitution, bodies, contacts, system)
    if system.num_rows > 0:
        build_joints(model, bodies, system)


@small_kernel
def advance(model, bodies, contacts, system, solver):
    """Take the new velocities from solver.x and move all poses (semi-implicit Euler, then stabilisation)."""
    h = bodies.time_step[0]
    nb = model.num_bodies
    for b in range(nb):
        for i in range(6):
            bodies.V[b, i] = solver.x[6 * b + i]
    moved = stabilise(model, contacts, system, solver)
    delta = solver.delta
    for b in range(nb + model.num_kinematic):
        V = bodies.V[b]
        x, y, z = h * V[0], h * V[1], h * V[2]
        if moved and b < nb:
            x, y, z = x + delta[6 * b], y + delta[6 * b + 1], z + delta[6 * b + 2]
        for i in range(3):
            bodies.p[b, i] += h * V[3 + i]
            if moved and b < nb:
                bodies.p[b, i] += delta[6 * b + 3 + i]
        integrate_quaternion(bodies.q[b], x, y, z)


@part_of_kernel
def solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep):
    """Solves a step without contacts that are none; returns iterations, or -1 where a number is not finite."""
    total = 0
    for attempt in range(3):
        used = solve_passively(model, bodies, system, contacts, solver)
        if used < 0:
            return used
        total += used
        if attempt == 0 and leave_out_ghosts(model, bodies, contacts, solver, sweep) == 0:
            break
        if attempt == 1:
            if take_back_hits(model, bodies, contacts, solver, sweep) == 0:
                break
            rebuild_rows(model, friction, restitution, bodies, contacts, system)
            switch_off(contacts, sweep)
    return total


@small_kernel
def is_jammed(contacts, solver):
    """Return True where a contact bears the largest impulse that it has."""
    jammed = False
    for c in range(contacts.number[0]):
        jammed = jammed or solver.mode[c] >= FULL_STICKS
    return jammed


@kernel
def _turns_into(model, bodies, contacts, solver, sweep):
    """Return True where a body that turns fast, or has rims, would be deep in another at the step's end."""
    nb, h = model.num_bodies, bodies.time_step[0]
    if contacts.number[0] == 0 or is_jammed(contacts, solver):
        return False
    fast = False
    for b in range(nb):
        V = bodies.V[b]
        before, after = 0.0, 0.0
        for i in range(3):
            before, after = before + V[i] * V[i], after + solver.x[6 * b + i] * solver.x[6 * b + i]
        fast = fast or 0.5 * h * h * model.radius[b] * max(before, after) > 0.2 * DEEP or model.has_rims[b]
    if not fast:
        return False
    allowed = 0.0
    for c in range(contacts.number[0]):
        allowed = min(allowed, contacts.gap[c])
    return gap_after(model, bodies, solver, sweep) < allowed - DEEP


@part_of_kernel
def step_world(model, mass, inertia, friction, restitution, bodies, contacts, system, solver, sweep, may_halve):
    """Advances one world in place by bodies.time_step.

    Returns:
        Iterations; -1 where a number is not finite; HALVE, and nothing has moved, where half the step is to be taken.
    """
    contacts.elastic[0] = 1.0
    build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
    iterations = solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep)
    if iterations < 0:
        return iterations
    if may_halve and _turns_into(model, bodies, contacts, solver, sweep):
        return HALVE
    advance(model, bodies, contacts, system, solver)
    return iterations
