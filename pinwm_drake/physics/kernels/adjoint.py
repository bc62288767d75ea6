# SPDX-License-Identifier: MIT
"""The adjoint of one step of one world (numba).

A step is rebuilt from its saved start, its velocities and the modes of its contacts, then differentiated implicitly at
its solution. With the equations F(x; data) = 0 of `cone.py`, the adjoint y solves the *transposed* system (dF/dx)' y =
dL/dx (friction makes it unsymmetric), and dL/ddata = -y . dF/ddata. Contact points, normals, tangents and gaps depend
on the poses; all of those derivatives are kept.

Source: Amos and Kolter (2017), "OptNet", eq. 7-8; de Avila Belbute-Peres et al. (2018). PIN-WM eq. 10.
"""

import math

from pinwm_drake.geometry.features import POINT, contact_adjoint, tangents_adjoint
from pinwm_drake.geometry.floor import spread_adjoint
from pinwm_drake.jit import kernel, part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import ALONG_1, ALONG_2, N1, N2, NN, OPEN, T11, T12, T22, contact_velocity, slides
from pinwm_drake.physics.kernels.detect import FADE, rebound
from pinwm_drake.physics.kernels.dynamics import gyroscopic_jacobian, solve3
from pinwm_drake.physics.kernels.joints import joints_adjoint
from pinwm_drake.physics.kernels.newton import recall_solution
from pinwm_drake.physics.kernels.small_matrix import lu_solve, lu_solve_transposed
from pinwm_drake.physics.kernels.stabilise import CONTACT, SLOP, stabilise, wanted
from pinwm_drake.physics.kernels.step import build_step


@kernel
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _add(out, start, scale, v):
    out[start] += scale * v[0]
    out[start + 1] += scale * v[1]
    out[start + 2] += scale * v[2]


@kernel
def _multiply(M, v):
    return _dot(M[0], v), _dot(M[1], v), _dot(M[2], v)


@kernel
def _multiply_transposed(M, v):
    return (
        M[0, 0] * v[0] + M[1, 0] * v[1] + M[2, 0] * v[2],
        M[0, 1] * v[0] + M[1, 1] * v[1] + M[2, 1] * v[2],
        M[0, 2] * v[0] + M[1, 2] * v[1] + M[2, 2] * v[2],
    )


@kernel
def _point_velocity(V, r):
    return (V[3] + V[1] * r[2] - V[2] * r[1], V[4] + V[2] * r[0] - V[0] * r[2], V[5] + V[0] * r[1] - V[1] * r[0])


@kernel
def _rotation_adjoint(phi, bar):
    """Gradients with respect to phi and to R's own rotation vector, from that of R' = exp(phi) R."""
    angle2 = _dot(phi, phi)
    if angle2 < 1e-8:
        sine, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = math.sqrt(angle2)
        sine = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / angle2
        c = (1.0 - sine) / angle2
    u = _cross(phi, bar)
    w = _cross(phi, u)
    # Transposes of J_l = 1 + b [phi]x + c [phi]x^2 and exp(phi) = 1 + sine [phi]x + b [phi]x^2.
    return (
        (bar[0] - b * u[0] + c * w[0], bar[1] - b * u[1] + c * w[1], bar[2] - b * u[2] + c * w[2]),
        (bar[0] - sine * u[0] + b * w[0], bar[1] - sine * u[1] + b * w[1], bar[2] - sine * u[2] + b * w[2]),
    )


@small_kernel
def _pose_update_adjoint(model, bodies, solver, adjoint, moved):
    """Adjoint of x' = x + h v' + delta, q' = exp(h w' + delta) q; leaves delta's gradient in adjoint.y."""
    h = bodies.time_step[0]
    nb = model.num_bodies
    for b in range(nb + model.num_kinematic):
        V = solver.x[6 * b : 6 * b + 6] if b < nb else bodies.V[b]
        phi = (h * V[0], h * V[1], h * V[2])
        if moved and b < nb:
            o = 6 * b
            phi = (phi[0] + solver.delta[o], phi[1] + solver.delta[o + 1], phi[2] + solver.delta[o + 2])
        pose = adjoint.pose[b]
        phi_bar, theta_bar = _rotation_adjoint(phi, (pose[0], pose[1], pose[2]))
        if b < nb:
            for i in range(3):
                adjoint.y[6 * b + i] = phi_bar[i]
                adjoint.y[6 * b + 3 + i] = pose[3 + i]
        for i in range(3):
            adjoint.V[b, i] += h * phi_bar[i]
            adjoint.V[b, 3 + i] += h * pose[3 + i]
            pose[i] = theta_bar[i]


@small_kernel
def _frame_to_pose(model, c, bodies, contacts, adjoint, gap_bar):
    """Adjoint of contact c's geometry: adjoint.frame, adjoint.lever and gap_bar to poses and shapes of its bodies."""
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    frame, lever = adjoint.frame, adjoint.lever
    n = contacts.frame[c, 0]
    gx, gy, gz = tangents_adjoint(n[0], n[1], n[2], contacts.frame[c, 1], frame[1], frame[2])
    n_bar = (frame[0, 0] + gx, frame[0, 1] + gy, frame[0, 2] + gz)
    c_bar = (lever[0, 0] + lever[1, 0], lever[0, 1] + lever[1, 1], lever[0, 2] + lever[1, 2])
    _add(adjoint.pose[A], 3, -1.0, lever[0])
    _add(adjoint.pose[B], 3, -1.0, lever[1])
    moved = adjoint.moved
    for i in range(3):
        moved[0, i], moved[1, i] = -adjoint.pose[A, 3 + i], -adjoint.pose[B, 3 + i]
    R, p, pose = bodies.R, bodies.p, adjoint.pose
    a, b, phi = contacts.witness[c, 0], contacts.witness[c, 1], contacts.gap[c] + bodies.offset[contacts.pair[c]]
    contact_adjoint(contacts.rows[c], R[A], p[A], R[B], p[B], n, a, b, phi, n_bar, c_bar, gap_bar, pose[A], pose[B])
    # A feature moves in its body as it moves with it.
    adjoint.offset[contacts.pair[c]] -= gap_bar
    for side in range(2):
        body = contacts.body[c, side]
        if contacts.dynamic[c, side] < 0:
            continue
        for i in range(3):
            moved[side, i] += adjoint.pose[body, 3 + i]
        g = _multiply_transposed(bodies.R[body], moved[side])
        _add(adjoint.center[body], 0, -1.0, g)
        if model.num_bodies + 1 == B and int(contacts.rows[c, 0]) == POINT:
            spread_adjoint(model.table, int(contacts.rows[c, 4]), g[0], g[1], g[2], adjoint.spread[body])


@kernel
def _stabilisation_adjoint(model, bodies, contacts, system, solver, adjoint):
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
            _add(adjoint.frame[0], 0, 1.0, v)
            _add(adjoint.frame[0], 0, 1.0, _cross(w, contacts.lever[c, side]))
            _add(adjoint.lever[side], 0, 1.0, _cross(n, w))
        _frame_to_pose(model, c, bodies, contacts, adjoint, gap_bar)
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
def _gain_transposed(solver, c, jn, j1, j2):
    """Product of the transposed gain of contact c with a contact velocity."""
    gain = solver.gain[c]
    return (
        gain[NN] * jn + gain[N1] * j1 + gain[N2] * j2,
        gain[T11] * j1 + gain[T12] * j2,
        gain[T12] * j1 + gain[T22] * j2,
    )


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
def _share_adjoint(model, bodies, contacts, system, solver, adjoint):
    """Adjoint of the share of bounces, which is where the bodies' gain of energy E(x, share) is 0.

    With that of the step's equations, y0 in adjoint.y, the adjoint z of E = 0 and y = y0 - z dE/dx make the derivative
    with respect to the share vanish. As E is the sum of lambda_c . J_c w, with the mean velocities w, its derivatives
    with respect to the contacts' data are those of the equations, for -z w in place of y.

    Leaves y in adjoint.y, y - z w in adjoint.field, and -z dE of the velocities before the step in adjoint.pull.

    Returns:
        z, 0 where all of the bounces are there, or none.
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
                before = system.free[6 * b + i] if b < nb and i < 3 else bodies.V[b, i]
                field[b, i] = 0.5 * (before + (solver.x[6 * b + i] if b < nb else bodies.V[b, i]))
        steep = 0.0
        for c in range(contacts.number[0]):
            mean = _field_velocity(contacts, field, c)
            g = _gain_transposed(solver, c, mean[0], mean[1], mean[2])
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
            for i in range(3):
                other[6 * b + 3 + i] -= 0.5 * bodies.time_step[0] * system.mass[b] * model.gravity[i]
        lu_solve_transposed(size, solver.S, solver.pivot, other)
        sought = 0.0
        for c in range(contacts.number[0]):
            jn, j1, j2 = contact_velocity(contacts, c, y)
            sought += contacts.rebound[c] * _gain_transposed(solver, c, jn, j1, j2)[0]
            jn, j1, j2 = contact_velocity(contacts, c, other)
            steep += contacts.rebound[c] * _gain_transposed(solver, c, jn, j1, j2)[0]
        if steep != 0.0:
            z = sought / steep
        for i in range(size):
            y[i] -= z * other[i]
    for b in range(nb + model.num_kinematic):
        for i in range(6):
            field[b, i] = (y[6 * b + i] if b < nb else 0.0) - z * field[b, i]
            # The pusher's velocity is the same before and after.
            pull[b, i] *= -0.5 * z if b < nb else -z
    return z


@small_kernel
def _contact_rows_adjoint(
    model, friction_bar, restitution, restitution_bar, bodies, contacts, system, solver, adjoint, c
):
    """Adjoint of the rows of contact c: to poses, velocities before the step, friction and restitution."""
    field = adjoint.field
    if solver.mode[c] == OPEN:
        return
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    B_moves = contacts.dynamic[c, 1] >= 0
    n, r_A, r_B = contacts.frame[c, 0], contacts.lever[c, 0], contacts.lever[c, 1]
    # Adjoint of the contact's velocity: G' J y, with the gain of cone.py.
    jn, j1, j2 = _field_velocity(contacts, field, c)
    slip = solver.slip[c]
    y_n, y_1, y_2 = _gain_transposed(solver, c, jn, j1, j2)
    lam_n, lam_1, lam_2 = solver.lam[c, 0], solver.lam[c, 1], solver.lam[c, 2]
    if slides(solver.mode[c]):
        friction_bar[contacts.pair[c]] += lam_n * (slip[ALONG_1] * j1 + slip[ALONG_2] * j2)

    xi_A = solver.x[6 * A : 6 * A + 6]
    xi_B = solver.x[6 * B : 6 * B + 6] if B_moves else bodies.V[B]
    y_A, y_B = field[A], field[B]
    v_A, v_B = _point_velocity(xi_A, r_A), _point_velocity(xi_B, r_B)
    u_A, u_B = _point_velocity(y_A, r_A), _point_velocity(y_B, r_B)
    frame, lever = adjoint.frame, adjoint.lever
    for i in range(3):
        u, v = u_A[i] - u_B[i], v_A[i] - v_B[i]
        frame[0, i] = lam_n * u - y_n * v
        frame[1, i] = lam_1 * u - y_1 * v
        frame[2, i] = lam_2 * u - y_2 * v
    F = _multiply_transposed(contacts.frame[c], (lam_n, lam_1, lam_2))
    Y = _multiply_transposed(contacts.frame[c], (y_n, y_1, y_2))
    f, g = _cross(F, y_A), _cross(Y, xi_A)
    lever[0, 0], lever[0, 1], lever[0, 2] = f[0] - g[0], f[1] - g[1], f[2] - g[2]
    f, g = _cross(F, y_B), _cross(Y, xi_B)
    lever[1, 0], lever[1, 1], lever[1, 2] = g[0] - f[0], g[1] - f[1], g[2] - f[2]
    if model.num_bodies == B and not B_moves:
        _add(adjoint.V[B], 0, 1.0, _cross(r_B, Y))
        _add(adjoint.V[B], 3, 1.0, Y)

    # bias_n = keep max(gap, -SLOP) / h - rebound
    e = restitution[contacts.pair[c]]
    closing, gap, approach = contacts.closing[c], contacts.gap[c], contacts.approach[c]
    keep = 1.0 - closing * (1.0 - (1.0 - e) ** FADE)
    gap_bar = -y_n * keep / bodies.time_step[0] if gap > -SLOP else 0.0
    keep_bar = -y_n * max(gap, -SLOP) / bodies.time_step[0]
    restitution_bar[contacts.pair[c]] -= keep_bar * closing * FADE * (1.0 - e) ** (FADE - 1)
    _, bounces = rebound(model, bodies, contacts, c, e)
    share = contacts.elastic[0]
    if bounces:
        restitution_bar[contacts.pair[c]] -= y_n * share * approach
    if bounces and e > 0.0:
        if not B_moves and _dot(n, model.gravity) < 0.0:
            _add(frame[0], 0, y_n * share * bodies.time_step[0], model.gravity)
        a = -y_n * share * e
        V_A, V_B = bodies.V[A], bodies.V[B]
        v_A, v_B = _point_velocity(V_A, r_A), _point_velocity(V_B, r_B)
        for i in range(3):
            frame[0, i] += a * (v_A[i] - v_B[i])
        _add(lever[0], 0, a, _cross(n, V_A))
        _add(lever[1], 0, -a, _cross(n, V_B))
        # The velocities before the step: those of dynamic bodies are added after their rows of adjoint.V are free.
        _add(adjoint.before[A], 0, a, _cross(r_A, n))
        _add(adjoint.before[A], 3, a, n)
        _add(adjoint.before[B], 0, -a, _cross(r_B, n))
        _add(adjoint.before[B], 3, -a, n)
    _frame_to_pose(model, c, bodies, contacts, adjoint, gap_bar)


@small_kernel
def _momentum_adjoint(model, inertia, inertia_bar, mass_bar, bodies, system, solver, adjoint, b):
    """Adjoint of the momentum balance M xi' = M xi* + h f of body b, the gyroscopic step and the inertia's rotation."""
    h = bodies.time_step[0]
    o = 6 * b
    R, I_B, V, w = bodies.R[b], inertia[b], bodies.V[b], bodies.V_body[b]
    x, y = solver.x[o : o + 6], adjoint.y[o : o + 6]
    pose = adjoint.pose[b]
    mass = system.mass[b]
    gain_bar = -adjoint.energy[0]
    for i in range(3):
        mass_bar[b] += y[3 + i] * (system.free[o + 3 + i] - x[3 + i])
        mass_bar[b] += 0.5 * gain_bar * h * model.gravity[i] * (V[3 + i] - x[3 + i])
    Iy = _multiply(system.inertia[b], y)
    Ix = _multiply(system.inertia[b], x)
    _add(pose, 0, -1.0, _cross(Ix, y))
    _add(pose, 0, 1.0, _cross(x, Iy))
    _add(pose, 0, 1.0, _cross(system.momentum[o : o + 3], y))
    y_body, x_body = _multiply_transposed(R, y), _multiply_transposed(R, x)
    w0 = _multiply_transposed(R, V)
    pull = adjoint.pull[b]
    _add(pose, 0, 1.0, _cross(system.free[o : o + 3], pull))
    bar, pulled = _multiply(I_B, y_body), _multiply_transposed(R, pull)
    bar = (bar[0] + pulled[0], bar[1] + pulled[1], bar[2] + pulled[2])
    a, b_, c, d, e, f, g, k, i_ = gyroscopic_jacobian(I_B, w, h)
    z = solve3((a, d, g, b_, e, k, c, f, i_), bar[0], bar[1], bar[2])
    zw = _cross(z, w)
    for i in range(3):
        for j in range(3):
            inertia_bar[b, i, j] += y_body[i] * (w[j] - x_body[j]) - z[i] * (w[j] - w0[j]) - h * zw[i] * w[j]
    w0_bar = _multiply(R, _multiply(I_B, z))
    _add(pose, 0, -1.0, _cross(V, w0_bar))
    for i in range(3):
        adjoint.V[b, i] = w0_bar[i]
        adjoint.V[b, 3 + i] = mass * y[3 + i] + pull[3 + i] + 0.5 * gain_bar * h * mass * model.gravity[i]


@part_of_kernel
def step_adjoint(model, theta, theta_bar, bodies, contacts, system, solver, adjoint):
    """Pull the gradient of the state after a step back to the state before it, and to the parameters.

    Args:
        model: as in the forward step.
        theta: mass, inertia, friction and restitution, as there.
        theta_bar: arrays like theta that gain its gradients.
        bodies: the state before the step and the pusher's velocity; its derived arrays are recomputed.
        solver: its x and mode are those that the forward step found.
        adjoint: pose and V hold the gradient of the state after the step on entry (V of the pusher: what later
            steps gave, usually 0) and that of the state before it on return; V of the pusher gains the gradient of
            its velocity in this step.

    Returns:
        False if the step's matrix was singular.
    """
    nb = model.num_bodies
    mass, inertia, friction, restitution = theta
    mass_bar, inertia_bar, friction_bar, restitution_bar = theta_bar
    build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
    if not recall_solution(system, contacts, solver):
        return False
    adjoint.J_e[:] = 0.0
    adjoint.error_e[:] = 0.0
    adjoint.before[:] = 0.0
    moved = stabilise(model, contacts, system, solver)
    _pose_update_adjoint(model, bodies, solver, adjoint, moved)
    if moved:
        _stabilisation_adjoint(model, bodies, contacts, system, solver, adjoint)
    for b in range(nb):
        for i in range(6):
            adjoint.y[6 * b + i] = adjoint.V[b, i]
    for r in range(system.num_rows):
        adjoint.y[6 * nb + r] = 0.0
    lu_solve_transposed(6 * nb + system.num_rows, solver.S, solver.pivot, adjoint.y)
    adjoint.energy[0] = _share_adjoint(model, bodies, contacts, system, solver, adjoint)
    for c in range(contacts.number[0]):
        _contact_rows_adjoint(
            model, friction_bar, restitution, restitution_bar, bodies, contacts, system, solver, adjoint, c
        )
    if system.num_rows > 0:
        joints_adjoint(model, bodies, system, solver, adjoint)
    for b in range(nb):
        _momentum_adjoint(model, inertia, inertia_bar, mass_bar, bodies, system, solver, adjoint, b)
    for b in range(nb + model.num_kinematic):
        for i in range(6):
            adjoint.V[b, i] += adjoint.before[b, i] + (adjoint.pull[b, i] if b >= nb else 0.0)
    for i in range(6):
        adjoint.V[nb + 1, i] = 0.0
        adjoint.pose[nb + 1, i] = 0.0
    return True
