# SPDX-License-Identifier: MIT
"""The adjoint of a part of a step of one world (numba).

A part is rebuilt from its saved start and end, its velocities and the modes of its contacts, then differentiated
implicitly at its solutions, the velocity stage first. With the equations F(x; data) = 0 of `cone.py`, the adjoint y
solves the *transposed* system (dF/dx)' y = dL/dx (friction makes it unsymmetric), and dL/ddata = -y . dF/ddata. Contact
points, normals, tangents and gaps depend on the poses; all of those derivatives are kept.

A part that ends when a gap phi closes has a length tau with phi(q'(tau)) = 0, and what follows is shorter by it. With
the gradient tau_bar of its length, less that of what is left, q' gains -tau_bar / (dphi/dtau) dphi/dq'.

Equal steps, at rest, have equal parts: once the state's gradient stays the same, so does what parameters gain.

Source: Amos and Kolter (2017), "OptNet", eq. 7-8; de Avila Belbute-Peres et al. (2018). PIN-WM eq. 10. Zhong, Han, Dey,
Brikis, "Improving gradient computation for differentiable physics simulation with contacts" (2023), for impacts.
"""

from pinwm_drake.jit import kernel, part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import contact_velocity
from pinwm_drake.physics.kernels.contact_adjoint import (
    force_adjoint,
    rows_adjoint,
    share_adjoint,
    stabilisation_adjoint,
)
from pinwm_drake.physics.kernels.curve import middle_adjoint
from pinwm_drake.physics.kernels.dynamics import (
    IMPACT,
    POSITION,
    VELOCITY,
    gyroscopic_acceleration,
    gyroscopic_jacobian,
    solve3,
)
from pinwm_drake.physics.kernels.joints import joints_adjoint
from pinwm_drake.physics.kernels.recall import recall_contacts, recall_stage
from pinwm_drake.physics.kernels.rolling import rolling_adjoint, rolling_torque
from pinwm_drake.physics.kernels.small_matrix import lu_solve_transposed
from pinwm_drake.physics.kernels.stabilise import stabilise
from pinwm_drake.physics.kernels.time_adjoint import time_adjoint
from pinwm_drake.physics.kernels.triples import add, cross, dot, multiply, multiply_transposed, rotation_adjoint

# Change of the state's gradient in a step, relative to it, below which it stays the same.
SETTLED = 1e-11


@small_kernel
def _pose_update_adjoint(model, bodies, solver, adjoint, moved):
    """Adjoint of x' = x + h u + delta, q' = exp(h w + delta) q; leaves delta's gradient in adjoint.y."""
    h = bodies.time_step[0]
    nb = model.num_bodies
    for b in range(nb + model.num_kinematic):
        V = solver.x[6 * b : 6 * b + 6] if b < nb else bodies.V[b]
        phi = (h * V[0], h * V[1], h * V[2])
        if moved and b < nb:
            o = 6 * b
            phi = (phi[0] + solver.delta[o], phi[1] + solver.delta[o + 1], phi[2] + solver.delta[o + 2])
        pose = adjoint.pose[b]
        phi_bar, theta_bar = rotation_adjoint(phi, (pose[0], pose[1], pose[2]))
        if b < nb:
            for i in range(3):
                adjoint.y[6 * b + i] = phi_bar[i]
                adjoint.y[6 * b + 3 + i] = pose[3 + i]
        for i in range(3):
            adjoint.V[b, i] += h * phi_bar[i]
            adjoint.V[b, 3 + i] += h * pose[3 + i]
            pose[i] = theta_bar[i]


@small_kernel
def _momentum_adjoint(model, inertia, inertia_bar, mass_bar, bodies, system, solver, adjoint, b, stage):
    """Adjoint of the momentum balance M x = M xi* + ... of body b, its gyroscopic step and its inertia's rotation."""
    half = 0.5 * bodies.time_step[0]
    o = 6 * b
    R, I_B, V, w = bodies.R[b], inertia[b], bodies.V[b], bodies.V_body[b]
    x, y = solver.x[o : o + 6], adjoint.y[o : o + 6]
    pose = adjoint.pose[b]
    mass = system.mass[b]
    for i in range(3):
        mass_bar[b] += y[3 + i] * (system.free[o + 3 + i] - x[3 + i])
    Iy = multiply(system.inertia[b], y)
    Ix = multiply(system.inertia[b], x)
    add(pose, 0, -1.0, cross(Ix, y))
    add(pose, 0, 1.0, cross(x, Iy))
    add(pose, 0, 1.0, cross(system.momentum[o : o + 3], y))
    y_body, x_body = multiply_transposed(R, y), multiply_transposed(R, x)
    pull = adjoint.pull[b]
    add(pose, 0, 1.0, cross(system.free[o : o + 3], pull))
    bar, pulled = multiply(I_B, y_body), multiply_transposed(R, pull)
    bar = (bar[0] + pulled[0], bar[1] + pulled[1], bar[2] + pulled[2])
    if stage == POSITION:
        w0 = multiply_transposed(R, V)
        a, b_, c, d, e, f, g, k, i_ = gyroscopic_jacobian(I_B, w, half)
        z = solve3((a, d, g, b_, e, k, c, f, i_), bar[0], bar[1], bar[2])
        zw = cross(z, w)
        for i in range(3):
            for j in range(3):
                inertia_bar[b, i, j] += y_body[i] * (w[j] - x_body[j]) - z[i] * (w[j] - w0[j]) - half * zw[i] * w[j]
        w_bar = multiply(R, multiply(I_B, z))
    else:
        z = solve3(
            (
                I_B[0, 0], I_B[0, 1], I_B[0, 2], I_B[1, 0], I_B[1, 1], I_B[1, 2], I_B[2, 0], I_B[2, 1], I_B[2, 2],
            ), bar[0], bar[1], bar[2],
        )  # fmt: skip
        Iw, zw = multiply(I_B, w), cross(z, w)
        turned, pulled = cross(Iw, z), multiply(I_B, zw)
        acceleration = gyroscopic_acceleration(I_B, w)
        adjoint.length[0] -= 0.5 * dot(bar, acceleration)
        for i in range(3):
            for j in range(3):
                after = w[j] - half * acceleration[j]
                inertia_bar[b, i, j] += y_body[i] * (after - x_body[j])
                inertia_bar[b, i, j] += half * (z[i] * acceleration[j] - zw[i] * w[j])
        w_bar = multiply(
            R,
            (
                bar[0] - half * (turned[0] + pulled[0]),
                bar[1] - half * (turned[1] + pulled[1]),
                bar[2] - half * (turned[2] + pulled[2]),
            ),
        )
        adjoint.length[0] += 0.5 * mass * dot(y[3:6], model.gravity)
    add(pose, 0, -1.0, cross(V, w_bar))
    for i in range(3):
        adjoint.V[b, i] = w_bar[i]
        adjoint.V[b, 3 + i] = mass * y[3 + i] + pull[3 + i]
    drag, _, _ = rolling_torque(model, system.mass, bodies, b)
    if half == 0.0 or drag == 0.0:
        return
    torque = (drag * V[0], drag * V[1], 0.0)
    # It is no momentum that turns with the body.
    add(pose, 0, -half, cross(torque, y))
    if stage == VELOCITY:
        adjoint.length[0] += 0.5 * dot(torque, y)
    w_x, w_y = rolling_adjoint(model, system.mass, bodies, adjoint, mass_bar, b, half * y[0], half * y[1])
    adjoint.V[b, 0] += w_x
    adjoint.V[b, 1] += w_y


@part_of_kernel
def step_adjoint(
    model,
    theta,
    theta_bar,
    bodies,
    contacts,
    system,
    solver,
    sweep,
    adjoint,
    start,
    s,
    end,
    at,
    w,
    share,
    later,
    carried,
):
    """Pull the gradient of the state after a part of a step back to the state before it, and to the parameters.

    Args:
        model: as in the forward step.
        theta: mass, inertia, friction and restitution, as there.
        theta_bar: arrays like theta that gain its gradients.
        bodies: the pusher's velocity; all else is loaded and recomputed.
        solver: its u, first and mode are those that the forward step found.
        adjoint: pose and V hold the gradient of the state after the part on entry (V of the pusher: what later
            steps gave, usually 0) and that of the state before it on return; V of the pusher gains the gradient of
            its velocity in this step.
        start, s: states, and the frame before the part.
        end, at: states, and the frame after it.
        w: the world.
        share: length of the part over what was left of the step.
        later: whether other parts of the step came before.
        carried: whether the one before ended with an impact, which then is among its contacts.

    Returns:
        False if a stage's matrix was singular.
    """
    nb, inertia, restitution = model.num_bodies, theta[1], theta[3]
    mass_bar, inertia_bar, friction_bar, restitution_bar = theta_bar
    impact = bodies.time_step[0] == 0.0
    adjoint.length[0] = 0.0
    recall_contacts(model, bodies, contacts, solver, start, s - 1 if impact and carried else s, w)
    for back in range(1 if impact else 2):
        stage = IMPACT if impact else VELOCITY - back
        if not recall_stage(model, theta, bodies, contacts, system, solver, sweep, start, s, end, at, w, stage):
            return False
        adjoint.J_e[:] = 0.0
        adjoint.error_e[:] = 0.0
        adjoint.before[:] = 0.0
        adjoint.middle[:] = 0.0
        if stage == POSITION:
            if later or solver.hit[0] >= 0:
                time_adjoint(model, inertia, bodies, contacts, system, solver, sweep, adjoint, end, at, w, share)
            moved = solver.hit[0] < 0 and stabilise(model, contacts, system, solver)
            _pose_update_adjoint(model, bodies, solver, adjoint, moved)
            if moved:
                stabilisation_adjoint(model, bodies, contacts, system, solver, adjoint)
        for b in range(nb):
            for i in range(6):
                adjoint.y[6 * b + i] = adjoint.V[b, i]
        for r in range(system.num_rows):
            adjoint.y[6 * nb + r] = 0.0
        lu_solve_transposed(6 * nb + system.num_rows, solver.S, solver.pivot, adjoint.y)
        share_adjoint(model, bodies, contacts, system, solver, adjoint)
        for c in range(contacts.number[0]):
            if stage == VELOCITY:
                jn, j1, j2 = contact_velocity(contacts, c, adjoint.y)
                adjoint.length[0] += force_adjoint(model, contacts, solver, c, jn, j1, j2)
            rows_adjoint(
                model,
                friction_bar,
                restitution,
                restitution_bar,
                bodies,
                contacts,
                solver,
                sweep,
                adjoint,
                c,
                stage,
            )
        if system.num_rows > 0:
            joints_adjoint(model, bodies, system, solver, adjoint)
        for b in range(nb):
            _momentum_adjoint(model, inertia, inertia_bar, mass_bar, bodies, system, solver, adjoint, b, stage)
        if stage == POSITION:
            middle_adjoint(model, bodies, adjoint)
        for b in range(nb + model.num_kinematic):
            for i in range(6):
                adjoint.V[b, i] += adjoint.before[b, i] + (adjoint.pull[b, i] if b >= nb else 0.0)
        for i in range(6):
            adjoint.V[nb + 1, i] = 0.0
            adjoint.pose[nb + 1, i] = 0.0
    return True


@kernel
def remember(adjoint, theta_bar):
    """Keep the gradients of the state and of the parameters before a step's adjoint."""
    kept, pairs = adjoint.kept, adjoint.kept_pairs
    mass_bar, inertia_bar, friction_bar, restitution_bar = theta_bar
    for b in range(adjoint.pose.shape[0]):
        for i in range(6):
            adjoint.kept_state[0, b, i], adjoint.kept_state[1, b, i] = adjoint.pose[b, i], adjoint.V[b, i]
    for b in range(kept.shape[0]):
        kept[b, 0] = mass_bar[b]
        for i in range(3):
            kept[b, 1 + i], kept[b, 4 + i] = adjoint.center[b, i], adjoint.spread[b, i]
            for j in range(3):
                kept[b, 7 + 3 * i + j] = inertia_bar[b, i, j]
    for k in range(pairs.shape[0]):
        pairs[k, 0], pairs[k, 1], pairs[k, 2] = friction_bar[k], restitution_bar[k], adjoint.offset[k]


@kernel
def is_settled(adjoint, nb, h):
    """Return whether the state's gradient is that from before the step, of h seconds."""
    pose, V, changed_pose, changed_V = 0.0, 0.0, 0.0, 0.0
    for b in range(nb + 1):
        for i in range(6):
            pose = max(pose, abs(adjoint.pose[b, i]))
            changed_pose = max(changed_pose, abs(adjoint.pose[b, i] - adjoint.kept_state[0, b, i]))
            if b < nb:
                V = max(V, abs(adjoint.V[b, i]))
                changed_V = max(changed_V, abs(adjoint.V[b, i] - adjoint.kept_state[1, b, i]))
    return changed_pose <= SETTLED * pose and changed_V <= SETTLED * (V + h * pose)


@kernel
def go_on(adjoint, theta_bar, times):
    """Add to the parameters' gradients what they gained since `remember`, `times` more times."""
    kept, pairs = adjoint.kept, adjoint.kept_pairs
    mass_bar, inertia_bar, friction_bar, restitution_bar = theta_bar
    for b in range(kept.shape[0]):
        mass_bar[b] += times * (mass_bar[b] - kept[b, 0])
        for i in range(3):
            adjoint.center[b, i] += times * (adjoint.center[b, i] - kept[b, 1 + i])
            adjoint.spread[b, i] += times * (adjoint.spread[b, i] - kept[b, 4 + i])
            for j in range(3):
                inertia_bar[b, i, j] += times * (inertia_bar[b, i, j] - kept[b, 7 + 3 * i + j])
    for k in range(pairs.shape[0]):
        friction_bar[k] += times * (friction_bar[k] - pairs[k, 0])
        restitution_bar[k] += times * (restitution_bar[k] - pairs[k, 1])
        adjoint.offset[k] += times * (adjoint.offset[k] - pairs[k, 2])
