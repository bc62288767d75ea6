"""One step of one world with its contacts laid open (numba)."""

from pinwm_drake.jit import entry_point
from pinwm_drake.physics.kernels.cone import negative_residual
from pinwm_drake.physics.kernels.step import build_step, solve_step
from pinwm_drake.physics.kernels.workspace import make_workspace


@entry_point
def inspect_step(model, mass, inertia, friction, restitution, center, spread, offset, q, p, V, q_P, p_P, V_P, limit):
    """Builds and solves one step from a state of one world; see `diagnose.inspect`.

    Returns:
        Iterations (-1: not solved), contacts, system and solver work, whose dx is the residual of the solution.
    """
    bodies, contacts, system, solver, sweep = make_workspace(model, limit)
    nb = model.num_bodies
    bodies.offset[:] = offset
    for b in range(nb):
        bodies.center[b] = center[b]
        bodies.spread[b] = spread[b]
        bodies.q[b] = q[b]
        bodies.p[b] = p[b]
        bodies.V[b] = V[b]
    if model.num_kinematic > 0:
        bodies.q[nb] = q_P
        bodies.p[nb] = p_P
        bodies.V[nb] = V_P
    build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
    used = solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep)
    negative_residual(system, contacts, solver, solver.dx)
    return used, contacts, system, solver
