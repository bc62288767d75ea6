# SPDX-License-Identifier: MIT
"""The adjoint of contacts' rows: to poses, shapes, velocities before the stage, friction and restitution (numba)."""

from pinwm_drake.jit import kernel, small_kernel
from pinwm_drake.physics.kernels.cone import (
    ALONG_1,
    ALONG_2,
    FULL_STICKS,
    N1,
    N2,
    NN,
    OPEN,
    T11,
    T12,
    T22,
    contact_velocity,
    slides,
)
from pinwm_drake.physics.kernels.curve import curve_adjoint, point_velocity
from pinwm_drake.physics.kernels.detect import half_force, rebound
from pinwm_drake.physics.kernels.dynamics import IMPACT, POSITION
from pinwm_drake.physics.kernels.geometry_adjoint import frame_to_pose
from pinwm_drake.physics.kernels.small_matrix import lu_solve, lu_solve_transposed
from pinwm_drake.physics.kernels.stabilise import CONTACT, SLOP, wanted
from pinwm_drake.physics.kernels.triples import add, cross, multiply_transposed


@kernel
def stabilisation_adjoint(model, bodies, contacts, system, solver, adjoint):
    """Adjoint of the position correction; adjoint.y holds delta's gradient on entry."""
    y, delta = adjoint.y, solver.delta
    lu_solve(6 * system.num_bodies, solver.S_delta, solver.pivot_delta, y)
    for c in range(contacts.number[0]):
        if solver.lifts[c] == 0:
            continue
        depth, steep = wanted(contacts, c)
        Jy, Jd = 0.0, 0.0
        for side in range(2):
            body = contacts.dynamic[c, side]
            if body >= 0:
                for i in range(6):
                    Jy += contacts.J[c, side, 0, i] * y[6 * body + i]
                    Jd += contacts.J[c, side, 0, i] * delta[6 * body + i]
        left = depth - Jd
        gap_bar = -CONTACT * Jy * steep
        adjoint.frame[:] = 0.0
        adjoint.lever[:] = 0.0
        n = contacts.frame[c, 0]
        for side in range(2):
            body = contacts.dynamic[c, side]
            if body < 0:
                continue
            sign = 1.0 if side == 0 else -1.0
            o = 6 * body
            p, q = CONTACT * sign * left, -CONTACT * sign * Jy
            w = (p * y[o] + q * delta[o], p * y[o + 1] + q * delta[o + 1], p * y[o + 2] + q * delta[o + 2])
            v = (p * y[o + 3] + q * delta[o + 3], p * y[o + 4] + q * delta[o + 4], p * y[o + 5] + q * delta[o + 5])
            add(adjoint.frame[0], 0, 1.0, v)
            add(adjoint.frame[0], 0, 1.0, cross(w, contacts.lever[c, side]))
            add(adjoint.lever[side], 0, 1.0, cross(n, w))
        frame_to_pose(model, c, bodies, contacts, adjoint, gap_bar)
    for r in range(system.num_rows):
        Jy, Jd = 0.0, 0.0
        for i in range(6 * system.num_bodies):
            Jy += system.J_e[r, i] * y[i]
            Jd += system.J_e[r, i] * delta[i]
        left = -system.error_e[r] - Jd
        for i in range(6 * system.num_bodies):
            adjoint.J_e[r, i] += left * y[i] - Jy * delta[i]
        adjoint.error_e[r] -= Jy


@small_kernel
def gain_transposed(solver, c, jn, j1, j2):
    """Product of the transposed gain of contact c with a contact velocity."""
    gain = solver.gain[c]
    return (
        gain[NN] * jn + gain[N1] * j1 + gain[N2] * j2,
        gain[T11] * j1 + gain[T12] * j2,
        gain[T12] * j1 + gain[T22] * j2,
    )


@kernel
def force_adjoint(model, contacts, solver, c, jn, j1, j2):
    """Gradient of a stage's length through the largest impulse that contact c bears; (jn, j1, j2) as J y."""
    if solver.mode[c] < FULL_STICKS:
        return 0.0
    slip, mu = solver.slip[c], contacts.mu[c]
    along = mu * (slip[ALONG_1] * j1 + slip[ALONG_2] * j2) if slides(solver.mode[c]) else 0.0
    return half_force(model, contacts, c) * (jn + along)


@small_kernel
def _field_velocity(contacts, field, c):
    """Contact velocity of contact c where the bodies have the velocities field (nb + 2, 6)."""
    v = (0.0, 0.0, 0.0)
    for side in range(2):
        J, V = contacts.J[c, side], field[contacts.body[c, side]]
        for i in range(6):
            v = (v[0] + J[0, i] * V[i], v[1] + J[1, i] * V[i], v[2] + J[2, i] * V[i])
    return v


@kernel
def share_adjoint(model, bodies, contacts, system, solver, adjoint):
    """Adjoint of the share of bounces, which is where the contacts' gain of energy E(x, share) is 0.

    With that of the impact's equations, y0 in adjoint.y, the adjoint z of E = 0 and y = y0 - z dE/dx make the
    derivative with respect to the share vanish. As E is the sum of lambda_c . J_c w, with the mean velocities w, its
    derivatives with respect to the contacts' data are those of the equations, for -z w in place of y.

    Leaves y in adjoint.y, y - z w in adjoint.field, and -z dE of the velocities before the impact in adjoint.pull.
    """
    nb, size = model.num_bodies, 6 * system.num_bodies + system.num_rows
    field, pull, other, y = adjoint.field, adjoint.pull, adjoint.other, adjoint.y
    pull[:] = 0.0
    field[:] = 0.0
    z = 0.0
    if 0.0 < contacts.elastic[0] < 1.0:
        other[:] = 0.0
        for b in range(nb + model.num_kinematic):
            for i in range(6):
                field[b, i] = 0.5 * (system.free[6 * b + i] + solver.x[6 * b + i]) if b < nb else bodies.V[b, i]
        steep = 0.0
        for c in range(contacts.number[0]):
            mean = _field_velocity(contacts, field, c)
            g = gain_transposed(solver, c, mean[0], mean[1], mean[2])
            steep += contacts.rebound[c] * g[0]
            for side in range(2):
                body, J = contacts.body[c, side], contacts.J[c, side]
                for i in range(6):
                    for k in range(3):
                        pull[body, i] += solver.lam[c, k] * J[k, i]
                        if contacts.dynamic[c, side] >= 0:
                            other[6 * body + i] -= g[k] * J[k, i]
        for b in range(nb):
            for i in range(6):
                other[6 * b + i] += 0.5 * pull[b, i]
        lu_solve_transposed(size, solver.S, solver.pivot, other)
        sought = 0.0
        for c in range(contacts.number[0]):
            jn, j1, j2 = contact_velocity(contacts, c, y)
            sought += contacts.rebound[c] * gain_transposed(solver, c, jn, j1, j2)[0]
            jn, j1, j2 = contact_velocity(contacts, c, other)
            steep += contacts.rebound[c] * gain_transposed(solver, c, jn, j1, j2)[0]
        if steep != 0.0:
            z = sought / steep
        for i in range(size):
            y[i] -= z * other[i]
    for b in range(nb + model.num_kinematic):
        for i in range(6):
            field[b, i] = (y[6 * b + i] if b < nb else 0.0) - z * field[b, i]
            # The pusher's velocity is the same before and after.
            pull[b, i] *= -0.5 * z if b < nb else -z


@small_kernel
def rows_adjoint(model, friction_bar, restitution, restitution_bar, bodies, contacts, solver, sweep, adjoint, c, stage):
    """Adjoint of the rows of contact c: to poses, velocities before the stage, friction and restitution."""
    field = adjoint.field
    if solver.mode[c] == OPEN:
        return
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    B_moves = contacts.dynamic[c, 1] >= 0
    r_A, r_B = contacts.lever[c, 0], contacts.lever[c, 1]
    # Adjoint of the contact's velocity: G' J y, with the gain of cone.py.
    jn, j1, j2 = _field_velocity(contacts, field, c)
    slip = solver.slip[c]
    y_n, y_1, y_2 = gain_transposed(solver, c, jn, j1, j2)
    lam_n, lam_1, lam_2 = solver.lam[c, 0], solver.lam[c, 1], solver.lam[c, 2]
    if slides(solver.mode[c]):
        friction_bar[contacts.pair[c]] += lam_n * (slip[ALONG_1] * j1 + slip[ALONG_2] * j2)

    xi_A = solver.x[6 * A : 6 * A + 6]
    xi_B = solver.x[6 * B : 6 * B + 6] if B_moves else bodies.V[B]
    y_A, y_B = field[A], field[B]
    v_A, v_B = point_velocity(xi_A, r_A), point_velocity(xi_B, r_B)
    u_A, u_B = point_velocity(y_A, r_A), point_velocity(y_B, r_B)
    frame, lever = adjoint.frame, adjoint.lever
    for i in range(3):
        u, v = u_A[i] - u_B[i], v_A[i] - v_B[i]
        frame[0, i] = lam_n * u - y_n * v
        frame[1, i] = lam_1 * u - y_1 * v
        frame[2, i] = lam_2 * u - y_2 * v
    F = multiply_transposed(contacts.frame[c], (lam_n, lam_1, lam_2))
    Y = multiply_transposed(contacts.frame[c], (y_n, y_1, y_2))
    f, g = cross(F, y_A), cross(Y, xi_A)
    lever[0, 0], lever[0, 1], lever[0, 2] = f[0] - g[0], f[1] - g[1], f[2] - g[2]
    f, g = cross(F, y_B), cross(Y, xi_B)
    lever[1, 0], lever[1, 1], lever[1, 2] = g[0] - f[0], g[1] - f[1], g[2] - f[2]
    if model.num_bodies == B and not B_moves:
        add(adjoint.V[B], 0, 1.0, cross(r_B, Y))
        add(adjoint.V[B], 3, 1.0, Y)

    gap, gap_bar = contacts.gap[c], 0.0
    if stage == POSITION and gap > 0.0:
        gap_bar = -y_n / bodies.time_step[0]
    elif -SLOP < gap <= 0.0:
        gap_bar = -y_n / model.time_step
    if stage == IMPACT:
        e, share = restitution[contacts.pair[c]], contacts.elastic[0]
        _, bounces = rebound(model, contacts, c, e)
        if bounces:
            restitution_bar[contacts.pair[c]] -= y_n * share * contacts.approach[c]
            _velocity_adjoint(bodies, contacts, adjoint, c, -y_n * share * e)
    elif stage == POSITION and sweep.turns[0] == 1:
        curve_adjoint(model, bodies, contacts, sweep, adjoint, c, -y_n, -y_1, -y_2)
    frame_to_pose(model, c, bodies, contacts, adjoint, gap_bar)


@small_kernel
def _velocity_adjoint(bodies, contacts, adjoint, c, bar):
    """Adjoint of the normal velocity before the stage: to normal and levers, and to velocities in adjoint.before."""
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    n, r_A, r_B = contacts.frame[c, 0], contacts.lever[c, 0], contacts.lever[c, 1]
    V_A, V_B = bodies.V[A], bodies.V[B]
    v_A, v_B = point_velocity(V_A, r_A), point_velocity(V_B, r_B)
    for i in range(3):
        adjoint.frame[0, i] += bar * (v_A[i] - v_B[i])
    add(adjoint.lever[0], 0, bar, cross(n, V_A))
    add(adjoint.lever[1], 0, -bar, cross(n, V_B))
    # The velocities before: those of dynamic bodies are added after their rows of adjoint.V are free.
    add(adjoint.before[A], 0, bar, cross(r_A, n))
    add(adjoint.before[A], 3, bar, n)
    add(adjoint.before[B], 0, -bar, cross(r_B, n))
    add(adjoint.before[B], 3, -bar, n)
