# SPDX-License-Identifier: MIT
"""One forward step of one world, or a part of one: x' = g(x, a, theta) (numba).

A step of length h has two stages, with half of gravity and of the gyroscopic torque in each,

    M (u - V) = h/2 f + J' lambda,       0 <= lambda_n  perpendicular to  gap / h + J u + h/2 (dJ/dt) V >= 0,
    q' = q moved by h u,
    M (V' - u) = h/2 f + J' mu at q',    0 <= mu_n      perpendicular to  J V' >= 0  of what touches,

with friction in both. What is apart at its start and would press ends it when it touches (`impact.py`). There is an
impact then, 0 <= mu_n perpendicular to J V' + e J V >= 0, and another part of the step follows. After several, what is
apart presses where it is.

A step's rows are those of the features at its start. Where a body turns fast, other features come down meanwhile; what
would then be deep in something at the step's end is stepped in two halves instead, and they in halves again.

Source: RATTLE, Andersen, J. Comput. Phys. 52, 1983; with impacts, Acary, Appl. Numer. Math. 62, 2012, and Leyendecker,
Hartmann, Koch, PAMM 12, 2012.
"""

from pinwm_drake.geometry.vectors import norm
from pinwm_drake.jit import kernel, part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import FULL_STICKS, OPEN
from pinwm_drake.physics.kernels.detect import SLOW, build_rows, select_features
from pinwm_drake.physics.kernels.dynamics import IMPACT, POSITION, VELOCITY, begin_stage, integrate_quaternion
from pinwm_drake.physics.kernels.impact import gap_after, presses_apart, stop_at_touch
from pinwm_drake.physics.kernels.joints import build_joints
from pinwm_drake.physics.kernels.restitution import bounce_passively
from pinwm_drake.physics.kernels.solve import solve_contacts
from pinwm_drake.physics.kernels.stabilise import stabilise

# What is deeper than this at a step's end, m, and was not before, is stepped in halves; the shortest, of a step.
DEEP, SHORTEST = 5e-6, 1.0 / 64.0
# Error of a contact's velocity above which a step is taken in halves, m/s: what turns fast about an edge.
BENT = 3e-4
# Times of impact in a step.
MOST_IMPACTS = 8
# What `step_world` returns where it took no step: half of it is to be taken, or there is an impact before it.
HALVE, STRIKE = -2, -3


@small_kernel
def build_stage(model, mass, inertia, friction, restitution, bodies, contacts, system, solver, sweep, stage, select):
    """Build a stage up to its equations: dynamics, contacts, joints; their features are those of the step's start."""
    begin_stage(model, mass, inertia, bodies, system, stage)
    if select:
        select_features(model, bodies, contacts)
    build_rows(model, friction, restitution, bodies, contacts, sweep, solver.first, stage)
    if system.num_rows > 0:
        build_joints(model, bodies, system)


@small_kernel
def advance(model, bodies, contacts, system, solver):
    """Move all poses with the velocities in solver.x, which are then those before the velocity stage.

    In solver.x are then the velocities after the step, if they go on as before.

    What ends with an impact is not stabilised: it has to end there.
    """
    h = bodies.time_step[0]
    nb = model.num_bodies
    for b in range(nb):
        for i in range(6):
            u = solver.u[6 * b + i] = solver.x[6 * b + i]
            solver.x[6 * b + i] = 2.0 * u - bodies.V[b, i]
            bodies.V[b, i] = u
    moved = solver.hit[0] < 0 and stabilise(model, contacts, system, solver)
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


@small_kernel
def is_jammed(contacts, solver):
    """Return True where a contact bears the largest impulse that it has."""
    jammed = False
    for c in range(contacts.number[0]):
        jammed = jammed or solver.first[c] >= FULL_STICKS or solver.mode[c] >= FULL_STICKS
    return jammed


@small_kernel
def add_impulses(contacts, solver, given):
    """Add the contacts' impulses of a stage to those of the pairs, given (num_pairs, 3), on A, world frame, N s."""
    for c in range(contacts.number[0]):
        for i in range(3):
            for j in range(3):
                given[contacts.pair[c], j] += solver.lam[c, i] * contacts.frame[c, i, j]


@kernel
def _bends(bodies, contacts, solver):
    """Return whether what levers that turn do to third order is too much, where contacts press."""
    h = bodies.time_step[0]
    for c in range(contacts.number[0]):
        if solver.mode[c] == OPEN:
            continue
        bent, A, B = contacts.curve[c], contacts.body[c, 0], contacts.body[c, 1]
        V_A, V_B = bodies.V[A], bodies.V[B]
        turn = h * max(norm(V_A[0], V_A[1], V_A[2]), norm(V_B[0], V_B[1], V_B[2]))
        if norm(bent[0], bent[1], bent[2]) * turn > BENT:
            return True
    return False


@kernel
def _turns_into(model, bodies, contacts, solver, sweep):
    """Return True where a body that turns fast would be deep in another at the end, or one with rims in the floor."""
    nb, h = model.num_bodies, bodies.time_step[0]
    if contacts.number[0] == 0:
        return False
    for c in range(contacts.number[0]):
        if solver.mode[c] >= FULL_STICKS:
            return False
    fast, rims = False, False
    for b in range(nb):
        V = bodies.V[b]
        before, after = 0.0, 0.0
        for i in range(3):
            before, after = before + V[i] * V[i], after + solver.x[6 * b + i] * solver.x[6 * b + i]
        fast = fast or 0.5 * h * h * model.radius[b] * max(before, after) > 0.2 * DEEP
        rims = rims or model.has_rims[b]
    if not (fast or rims):
        return False
    allowed = 0.0
    for c in range(contacts.number[0]):
        allowed = min(allowed, contacts.gap[c])
    return gap_after(model, bodies, solver, sweep, fast) < allowed - DEEP


@kernel
def _strikes(contacts):
    """Return whether anything that touches closes."""
    strikes = False
    for c in range(contacts.number[0]):
        strikes = strikes or (contacts.closed[c] == 1 and contacts.approach[c] < -SLOW)
    return strikes


@part_of_kernel
def step_world(
    model,
    mass,
    inertia,
    friction,
    restitution,
    bodies,
    contacts,
    system,
    solver,
    sweep,
    impact,
    carried,
    may_stop,
    may_strike,
    may_halve,
    given,
):
    """Advances one world in place by bodies.time_step, or less, which is there then; or takes an impact.

    Args:
        impact: Flag: velocities change at once, and no time goes by.
        carried: Flag: the impact is one of the contacts of the part before, which it ended.
        may_stop: Flag: the step may end at a time of impact.
        may_strike: Flag: it may ask for an impact before it.
        may_halve: Flag: it may ask for half of its length.
        given: (num_pairs, 3) N s, gains the impulses of the pairs, unless it is empty.

    Returns:
        Iterations; -1 where a number is not finite; HALVE or STRIKE, and nothing has moved.
    """
    contacts.elastic[0] = 1.0
    solver.hit[0] = -1
    total = 0
    for stage in range(IMPACT if impact else POSITION, 3 if impact else 2):
        select = stage == POSITION or (stage == IMPACT and not carried)
        build_stage(model, mass, inertia, friction, restitution, bodies, contacts, system, solver, sweep, stage, select)
        if stage == POSITION and may_strike and _strikes(contacts):
            return STRIKE
        used = solve_contacts(bodies, system, contacts, solver, stage)
        if used >= 0 and stage == IMPACT:
            used = bounce_passively(bodies, system, contacts, solver, used)
        if used >= 0 and stage == POSITION and may_stop and presses_apart(contacts, solver.mode):
            used = stop_at_touch(model, mass, inertia, bodies, contacts, system, solver, sweep)
        if used < 0:
            return used
        total += used
        if stage != VELOCITY:
            for c in range(contacts.number[0]):
                solver.first[c] = solver.mode[c]
        may_halve = may_halve and stage == POSITION
        if may_halve and (_bends(bodies, contacts, solver) or _turns_into(model, bodies, contacts, solver, sweep)):
            return HALVE
        if given.shape[0] > 0:
            add_impulses(contacts, solver, given)
        if stage == POSITION:
            advance(model, bodies, contacts, system, solver)
    for b in range(model.num_bodies):
        for i in range(6):
            bodies.V[b, i] = solver.x[6 * b + i]
    return total
