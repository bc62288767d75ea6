"""One forward step of one world: x' = g(x, a, theta) (numba)."""

from pinwm_drake.jit import kernel
from pinwm_drake.physics.kernels.detect import build_rows, select_features
from pinwm_drake.physics.kernels.dynamics import begin_step, integrate_quaternion
from pinwm_drake.physics.kernels.ghosts import leave_out_ghosts, switch_off, take_back_hits
from pinwm_drake.physics.kernels.joints import build_joints
from pinwm_drake.physics.kernels.solve import solve_lcp
from pinwm_drake.physics.kernels.stabilise import stabilise


@kernel
def build_step(model, mass, inertia, friction, restitution, bodies, contacts, system):
    """Builds a step up to its LCP: dynamics, contacts, joints."""
    begin_step(model, mass, inertia, bodies, system)
    select_features(model, bodies, contacts)
    build_rows(model, friction, restitution, bodies, contacts, system)
    build_joints(model, bodies, system)


@kernel
def recall(contacts, solver, memory):
    """Guesses the active set from the previous step's; False if there was none."""
    if memory.number[0] < 0:
        return False
    width = memory.active.shape[1]
    previous = memory.number[0]
    for c in range(contacts.number[0]):
        A, B = contacts.body[c, 0], contacts.body[c, 1]
        best, found = 1e300, -1
        if previous == contacts.number[0] and memory.body[c, 0] == A and memory.body[c, 1] == B:
            found = c
        else:
            # The set of contacts changed: the nearest former contact of the same bodies, measured on A.
            for other in range(previous):
                if memory.body[other, 0] == A and memory.body[other, 1] == B:
                    distance = 0.0
                    for i in range(1, 4):
                        d = contacts.rows[c, i] - memory.rows[other, i]
                        distance += d * d
                    if distance < best:
                        best, found = distance, other
        for i in range(width):
            solver.active[c, i] = memory.active[found, i] if found >= 0 else 0
    return True


@kernel
def remember(contacts, solver, memory):
    """Keeps the step's active set as a guess for the next."""
    memory.number[0] = contacts.number[0]
    for c in range(contacts.number[0]):
        memory.body[c, 0] = contacts.body[c, 0]
        memory.body[c, 1] = contacts.body[c, 1]
        for i in range(1, 4):
            memory.rows[c, i] = contacts.rows[c, i]
        for i in range(memory.active.shape[1]):
            memory.active[c, i] = solver.active[c, i]


@kernel
def advance(model, bodies, contacts, system, solver):
    """Takes the new velocities from solver.x and moves all poses (semi-implicit Euler, then stabilisation)."""
    h = model.time_step
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


@kernel
def solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep, warm):
    """Solves a step's LCP without contacts that are none; arguments and value as of `solve_lcp`."""
    used = solve_lcp(system, contacts, solver, warm)
    if used < 0 or leave_out_ghosts(model, bodies, contacts, solver, sweep) == 0:
        return used
    again = solve_lcp(system, contacts, solver, True)
    if again >= 0 and take_back_hits(model, bodies, contacts, solver, sweep) > 0:
        build_rows(model, friction, restitution, bodies, contacts, system)
        switch_off(contacts, solver, sweep)
        used += again
        again = solve_lcp(system, contacts, solver, False)
    return used + again if again >= 0 else again


@kernel
def step_world(model, mass, inertia, friction, restitution, bodies, contacts, system, solver, memory, sweep):
    """Advances one world in place; returns interior-point iterations, or -1 if its LCP found no solution."""
    build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
    warm = recall(contacts, solver, memory)
    iterations = solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep, warm)
    if iterations < 0:
        return iterations
    remember(contacts, solver, memory)
    advance(model, bodies, contacts, system, solver)
    return iterations
