"""One forward step of one world: x' = g(x, a, theta) (numba)."""

from pinwm_drake.jit import part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.detect import build_rows, select_features
from pinwm_drake.physics.kernels.dynamics import begin_step, integrate_quaternion
from pinwm_drake.physics.kernels.ghosts import leave_out_ghosts, switch_off, take_back_hits
from pinwm_drake.physics.kernels.joints import build_joints
from pinwm_drake.physics.kernels.restitution import solve_passively
from pinwm_drake.physics.kernels.stabilise import stabilise


@small_kernel
def build_step(model, mass, inertia, friction, restitution, bodies, contacts, system):
    """Builds a step up to its equations: dynamics, contacts, joints."""
    begin_step(model, mass, inertia, bodies, system)
    select_features(model, bodies, contacts)
    build_rows(model, friction, restitution, bodies, contacts, system)
    if system.num_rows > 0:
        build_joints(model, bodies, system)


@small_kernel
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
            build_rows(model, friction, restitution, bodies, contacts, system)
            switch_off(contacts, sweep)
    return total


@part_of_kernel
def step_world(model, mass, inertia, friction, restitution, bodies, contacts, system, solver, sweep):
    """Advances one world in place; returns iterations, or -1 where a number is not finite."""
    contacts.elastic[0] = 1.0
    build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
    iterations = solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep)
    if iterations < 0:
        return iterations
    advance(model, bodies, contacts, system, solver)
    return iterations
