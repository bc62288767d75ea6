"""The step's LCP with its contacts eliminated (numba).

One world, `nc` contacts, `n = 6 num_bodies + num_joint_rows` unknowns x = [xi'; lambda_e]. Contact c has the rows
[normal, k friction directions, gamma]; with J its 3 x 6 Jacobians in the contact frame (normal, two tangents), d_i
the friction directions and eps the compliance,

    s_n = (J x)_n + bias_n + eps lambda_n            >= 0  perpendicular to  lambda_n >= 0
    s_i = d_i . ((J x)_t + bias_t) + gamma + eps lambda_i   >= 0  perpendicular to  lambda_i >= 0
    s_g = mu lambda_n - sum_i lambda_i               >= 0  perpendicular to  gamma >= 0.

A Newton step of an interior-point method and a solve on a known active set have the same matrix: per contact an
arrow whose diagonal is d = s / lambda + eps there, and eps (active) or infinity (inactive) here. Eliminating the
contacts leaves a dense system in x alone, so the cost is linear in the number of contacts.

The compliance eps is a 1e-5th of a body's inverse mass. It picks the least-squares distribution among the infinitely
many contact forces of a face on a face (a rigid plate on equal springs), which makes x', its friction torque and its
gradient unique. It changes velocities by eps lambda, about 1e-7 m/s in a push, and lets a block rest 0.1 nm deep.

Source: Cline (2002), section 4; PIN-WM eq. 8-9. The arrow elimination and the compliance are ours.
"""

from pinwm_drake.jit import kernel

# Columns of the `reduced` array: the arrow of one contact, summed over its friction directions.
INV_DN, INV_DELTA, S0, S1, S2, S11, S12, S22 = range(8)


@kernel
def reduce_contact(system, work, c, inv_dn, d_gamma, gamma_fixed):
    """Sums the friction rows of contact c; work.weights[c, i] = 1 / d_i, d_gamma = s_g / gamma, or gamma is 0."""
    weights, reduced, cosines, sines = work.weights, work.reduced, system.cosines, system.sines
    s0, s1, s2, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(cosines)):
        w = weights[c, i]
        wc = w * cosines[i]
        ws = w * sines[i]
        s0 += w
        s1 += wc
        s2 += ws
        s11 += wc * cosines[i]
        s12 += wc * sines[i]
        s22 += ws * sines[i]
    delta = d_gamma + s0
    reduced[c, INV_DN] = inv_dn
    reduced[c, INV_DELTA] = 0.0 if gamma_fixed or delta <= 0.0 else 1.0 / delta
    reduced[c, S0] = s0
    reduced[c, S1] = s1
    reduced[c, S2] = s2
    reduced[c, S11] = s11
    reduced[c, S12] = s12
    reduced[c, S22] = s22


@kernel
def assemble(system, contacts, work):
    """Writes S = [M + sum_c J' W J, -J_e'; J_e, eps_e I] for the weights in `work.reduced`."""
    num_bodies, num_rows = system.num_bodies, system.num_rows
    inertia, mass, J_e = system.inertia, system.mass, system.J_e
    bodies, J, mu, reduced, S = contacts.dynamic, contacts.J, contacts.mu, work.reduced, work.S
    size = 6 * num_bodies
    n = size + num_rows
    for i in range(n):
        for j in range(n):
            S[i, j] = 0.0
    for b in range(num_bodies):
        o = 6 * b
        for i in range(3):
            for j in range(3):
                S[o + i, o + j] = inertia[b, i, j]
            S[o + 3 + i, o + 3 + i] = mass[b]
    for c in range(contacts.number[0]):
        inv_dn = reduced[c, INV_DN]
        if inv_dn == 0.0 and reduced[c, S0] == 0.0:
            continue
        inv_delta, s1, s2 = reduced[c, INV_DELTA], reduced[c, S1], reduced[c, S2]
        k = mu[c] * inv_dn * inv_delta
        w10, w20 = s1 * k, s2 * k
        w11 = reduced[c, S11] - s1 * s1 * inv_delta
        w12 = reduced[c, S12] - s1 * s2 * inv_delta
        w22 = reduced[c, S22] - s2 * s2 * inv_delta
        for right in range(2):
            column = bodies[c, right]
            if column < 0:
                continue
            for j in range(6):
                jn, j1, j2 = J[c, right, 0, j], J[c, right, 1, j], J[c, right, 2, j]
                fn = inv_dn * jn
                f1 = w10 * jn + w11 * j1 + w12 * j2
                f2 = w20 * jn + w12 * j1 + w22 * j2
                for left in range(2):
                    row = bodies[c, left]
                    if row < 0:
                        continue
                    for i in range(6):
                        S[6 * row + i, 6 * column + j] += (
                            J[c, left, 0, i] * fn + J[c, left, 1, i] * f1 + J[c, left, 2, i] * f2
                        )
    for r in range(num_rows):
        for i in range(size):
            S[size + r, i] = J_e[r, i]
            S[i, size + r] = -J_e[r, i]
        S[size + r, size + r] = system.joint_compliance


@kernel
def contact_loads(system, contacts, work, x):
    """Adds the contacts' part J' f0 of the right-hand side work.R to x, and keeps work.gamma0 for `recover`."""
    cosines, sines, bodies, J, mu = system.cosines, system.sines, contacts.dynamic, contacts.J, contacts.mu
    reduced, weights, R, gamma0 = work.reduced, work.weights, work.R, work.gamma0
    k = len(cosines)
    for c in range(contacts.number[0]):
        inv_dn = reduced[c, INV_DN]
        if inv_dn == 0.0 and reduced[c, S0] == 0.0:
            gamma0[c] = 0.0
            continue
        q0, q1, q2 = 0.0, 0.0, 0.0
        for i in range(k):
            q = weights[c, i] * R[c, 1 + i]
            q0 += q
            q1 += q * cosines[i]
            q2 += q * sines[i]
        fn = R[c, 0] * inv_dn
        g = (R[c, k + 1] - mu[c] * fn + q0) * reduced[c, INV_DELTA]
        gamma0[c] = g
        f1 = q1 - reduced[c, S1] * g
        f2 = q2 - reduced[c, S2] * g
        for side in range(2):
            body = bodies[c, side]
            if body >= 0:
                for i in range(6):
                    x[6 * body + i] += J[c, side, 0, i] * fn + J[c, side, 1, i] * f1 + J[c, side, 2, i] * f2


@kernel
def contact_velocity(contacts, c, x):
    """Contact velocity J x of contact c: normal and two tangential components."""
    bodies, J = contacts.dynamic, contacts.J
    jn, j1, j2 = 0.0, 0.0, 0.0
    for side in range(2):
        body = bodies[c, side]
        if body >= 0:
            for i in range(6):
                v = x[6 * body + i]
                jn += J[c, side, 0, i] * v
                j1 += J[c, side, 1, i] * v
                j2 += J[c, side, 2, i] * v
    return jn, j1, j2


@kernel
def recover(system, contacts, work, x, dlam):
    """Contact unknowns dlam (nc, k + 2) that belong to a solution x."""
    cosines, sines, mu = system.cosines, system.sines, contacts.mu
    reduced, weights, R, gamma0 = work.reduced, work.weights, work.R, work.gamma0
    k = len(cosines)
    for c in range(contacts.number[0]):
        inv_dn = reduced[c, INV_DN]
        if inv_dn == 0.0 and reduced[c, S0] == 0.0:
            for i in range(k + 2):
                dlam[c, i] = 0.0
            continue
        jn, j1, j2 = contact_velocity(contacts, c, x)
        g = gamma0[c] + (mu[c] * inv_dn * jn - reduced[c, S1] * j1 - reduced[c, S2] * j2) * reduced[c, INV_DELTA]
        dlam[c, 0] = (R[c, 0] - jn) * inv_dn
        for i in range(k):
            dlam[c, 1 + i] = weights[c, i] * (R[c, 1 + i] - cosines[i] * j1 - sines[i] * j2 - g)
        dlam[c, k + 1] = g


@kernel
def negative_residual(system, contacts, x, lam, out):
    """Writes out = -(M xi' - p - J_e' lambda_e - J' lambda; J_e xi' + bias_e + eps_e lambda_e)."""
    cosines, sines, bodies, J = system.cosines, system.sines, contacts.dynamic, contacts.J
    inertia, mass, momentum, J_e = system.inertia, system.mass, system.momentum, system.J_e
    size = 6 * system.num_bodies
    for b in range(system.num_bodies):
        o = 6 * b
        for i in range(3):
            total = momentum[o + i]
            for j in range(3):
                total -= inertia[b, i, j] * x[o + j]
            out[o + i] = total
            out[o + 3 + i] = momentum[o + 3 + i] - mass[b] * x[o + 3 + i]
    for r in range(system.num_rows):
        total = -system.bias_e[r] - system.joint_compliance * x[size + r]
        for i in range(size):
            total -= J_e[r, i] * x[i]
            out[i] += J_e[r, i] * x[size + r]
        out[size + r] = total
    for c in range(contacts.number[0]):
        f1, f2 = 0.0, 0.0
        for i in range(len(cosines)):
            f1 += cosines[i] * lam[c, 1 + i]
            f2 += sines[i] * lam[c, 1 + i]
        fn = lam[c, 0]
        if fn == 0.0 and f1 == 0.0 and f2 == 0.0:
            continue
        for side in range(2):
            body = bodies[c, side]
            if body >= 0:
                for i in range(6):
                    out[6 * body + i] += J[c, side, 0, i] * fn + J[c, side, 1, i] * f1 + J[c, side, 2, i] * f2


@kernel
def slacks(system, contacts, x, lam, s):
    """The left-hand sides s (nc, k + 2) of all contact rows at x and lam."""
    cosines, sines, compliance = system.cosines, system.sines, system.contact_compliance
    bias, mu = contacts.bias, contacts.mu
    k = len(cosines)
    for c in range(contacts.number[0]):
        jn, j1, j2 = contact_velocity(contacts, c, x)
        v1, v2 = j1 + bias[c, 1], j2 + bias[c, 2]
        g = lam[c, k + 1]
        total = mu[c] * lam[c, 0]
        s[c, 0] = jn + bias[c, 0] + compliance * lam[c, 0]
        for i in range(k):
            s[c, 1 + i] = cosines[i] * v1 + sines[i] * v2 + g + compliance * lam[c, 1 + i]
            total -= lam[c, 1 + i]
        s[c, k + 1] = total
