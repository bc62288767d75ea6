# SPDX-License-Identifier: MIT
"""The adjoint of a part's length: of times of impact, and of what is left of a step (numba)."""

from pinwm_drake.geometry.features import contact_from_features
from pinwm_drake.jit import kernel
from pinwm_drake.physics.kernels.cone import OPEN, contact_velocity
from pinwm_drake.physics.kernels.contact_adjoint import force_adjoint, gain_transposed
from pinwm_drake.physics.kernels.curve import curve_slopes, move_halfway
from pinwm_drake.physics.kernels.dynamics import gyroscopic_jacobian, rotation_from_quaternion, solve3
from pinwm_drake.physics.kernels.geometry_adjoint import geometry_adjoint
from pinwm_drake.physics.kernels.impact import GRAZES
from pinwm_drake.physics.kernels.rolling import rolling_torque
from pinwm_drake.physics.kernels.small_matrix import lu_solve_transposed
from pinwm_drake.physics.kernels.triples import add, cross, dot, multiply, multiply_transposed, rotation_adjoint


@kernel
def _length_adjoint(model, inertia, bodies, contacts, system, solver, adjoint, pose, scale):
    """Gradient with respect to the length of the position stage, 1/s, of what follows from it.

    Args:
        pose: (N, 6), gradient with respect to the poses after the stage, as [rotation vector; translation].
        scale: Share that counts of the gradient adjoint.V (N, 6) with respect to the velocities after it.
    """
    nb, h, y = model.num_bodies, bodies.time_step[0], adjoint.other
    total = 0.0
    for b in range(nb + model.num_kinematic):
        V = solver.x[6 * b : 6 * b + 6] if b < nb else bodies.V[b]
        phi_bar, _ = rotation_adjoint((h * V[0], h * V[1], h * V[2]), (pose[b, 0], pose[b, 1], pose[b, 2]))
        for i in range(3):
            total += phi_bar[i] * V[i] + pose[b, 3 + i] * V[3 + i]
            if b < nb:
                y[6 * b + i] = h * phi_bar[i] + scale * adjoint.V[b, i]
                y[6 * b + 3 + i] = h * pose[b, 3 + i] + scale * adjoint.V[b, 3 + i]
    for r in range(system.num_rows):
        y[6 * nb + r] = 0.0
    lu_solve_transposed(6 * nb + system.num_rows, solver.S, solver.pivot, y)
    for b in range(nb):
        R, I_B, w, o = bodies.R[b], inertia[b], bodies.V_body[b], 6 * b
        total += 0.5 * system.mass[b] * dot(y[o + 3 : o + 6], model.gravity)
        bar = multiply(I_B, multiply_transposed(R, y[o : o + 3]))
        a, b_, c, d, e, f, g, k, i_ = gyroscopic_jacobian(I_B, w, 0.5 * h)
        z = solve3((a, d, g, b_, e, k, c, f, i_), bar[0], bar[1], bar[2])
        total -= 0.5 * dot(z, cross(w, multiply(I_B, w)))
        drag, _, _ = rolling_torque(model, system.mass, bodies, b)
        total += 0.5 * drag * (bodies.V[b, 0] * y[o] + bodies.V[b, 1] * y[o + 1])
    for c in range(contacts.number[0]):
        if solver.mode[c] == OPEN:
            continue
        jn, j1, j2 = contact_velocity(contacts, c, y)
        total += force_adjoint(model, contacts, solver, c, jn, j1, j2)
        g = gain_transposed(solver, c, jn, j1, j2)
        # The biases are gap / h, and what levers that turn make.
        apart = max(contacts.gap[c], 0.0) / h
        total += g[0] * apart / h
        for i in range(3):
            total -= g[i] * contacts.curve[c, i]
    return total


@kernel
def _add_gap(model, bodies, contacts, solver, sweep, adjoint, end, at, w, bar):
    """Add `bar` of the gap that closes at the end: to adjoint.touch, for the poses there, and to the shapes."""
    nb, c = model.num_bodies, solver.hit[0]
    q, p, _, q_P, p_P = end
    for b in range(nb + model.num_kinematic):
        rotation_from_quaternion(q[at, w, b] if b < nb else q_P[at, w], sweep.R[b])
        for i in range(3):
            sweep.p[b, i] = p[at, w, b, i] if b < nb else p_P[at, w, i]
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    n, a, b_ = sweep.point[0], sweep.point[1], sweep.point[2]
    contact_from_features(contacts.rows[c], sweep.R[A], sweep.p[A], sweep.R[B], sweep.p[B], n, a, b_)
    adjoint.lever[:] = 0.0
    geometry_adjoint(model, contacts, adjoint, c, sweep.R, sweep.p, n, a, b_, adjoint.touch, (0.0, 0.0, 0.0), bar)


@kernel
def time_adjoint(model, inertia, bodies, contacts, system, solver, sweep, adjoint, end, at, w, share):
    """Adjoint of the length of a part, and of what is left after it; adjoint.pose is that of the poses at its end."""
    curve_slopes(model, bodies, contacts, sweep, solver.mode)
    length = adjoint.length[0]
    length += _length_adjoint(model, inertia, bodies, contacts, system, solver, adjoint, adjoint.pose, 1.0)
    bar = length - adjoint.left[0]
    if solver.hit[0] < 0:
        adjoint.left[0] += share * bar
        return
    adjoint.touch[:] = 0.0
    _add_gap(model, bodies, contacts, solver, sweep, adjoint, end, at, w, 1.0)
    speed = _length_adjoint(model, inertia, bodies, contacts, system, solver, adjoint, adjoint.touch, 0.0)
    scale = -bar / speed if abs(speed) > GRAZES else 0.0
    # What is there once becomes what is there `scale` times.
    _add_gap(model, bodies, contacts, solver, sweep, adjoint, end, at, w, scale - 1.0)
    for b in range(model.num_bodies + model.num_kinematic):
        add(adjoint.pose[b], 0, 1.0, adjoint.touch[b, :3])
        add(adjoint.pose[b], 3, 1.0, adjoint.touch[b, 3:])
    move_halfway(model, bodies, sweep, 0.5 * bodies.time_step[0])
