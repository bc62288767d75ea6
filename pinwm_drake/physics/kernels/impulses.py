"""Impulses of the contacts in the steps of a rollout (numba)."""

from pinwm_drake.jit import entry_point, kernel
from pinwm_drake.physics.kernels.rollout import drive, load, load_geometry
from pinwm_drake.physics.kernels.step import build_step, solve_step
from pinwm_drake.physics.kernels.workspace import make_workspace


@kernel
def _impulses_of_world(w, model, parameters, V_P, states, impulses, status, work):
    mass, inertia, friction, restitution = parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w]
    bodies, contacts, system, solver, sweep = work
    load_geometry(model, bodies, parameters, w)
    for t in range(V_P.shape[0]):
        load(bodies, model.num_bodies, model.num_kinematic > 0, states, t, w)
        if model.num_kinematic > 0:
            drive(bodies, model.num_bodies, V_P, t, w)
        contacts.elastic[0] = 1.0
        build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
        if solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep) < 0:
            status[w] = -t - 1
            return
        for c in range(contacts.number[0]):
            for i in range(3):
                for j in range(3):
                    impulses[t, w, contacts.pair[c], j] += solver.lam[c, i] * contacts.frame[c, i, j]


@entry_point
def contact_impulses(model, parameters, V_P, states, impulses, status, limit, first, last):
    """Solves every step of worlds first..last-1 from its recorded state, without holding Python's lock.

    Args:
        model: ModelArrays.
        parameters: as in `rollout.rollout_forward`.
        V_P: (T, W, 6), pusher velocities.
        states: q, p, V, q_P and p_P of the T frames or more at which the steps begin, as from `allocate_frames`.
        impulses: (T, W, num_pairs, 3), zeros; receives the sums over the contacts of each pair, on A, world frame, N s.
        status: (W,), receives minus the failed step's number minus one where there was no solution.
        limit: rows of the contact tables.
        first, last: range of worlds.
    """
    for w in range(first, last):
        work = make_workspace(model, limit)
        _impulses_of_world(w, model, parameters, V_P, states, impulses, status, work)
