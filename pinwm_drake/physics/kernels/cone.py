# SPDX-License-Identifier: MIT
"""The law of a contact, and the linear system of a step with all contacts eliminated (numba).

One world, n = 6 num_bodies + num_joint_rows unknowns x = [xi'; lambda_e]. With J the 3 x 6 Jacobians of a contact in
its frame (normal, two tangents) and eps the compliance, its impulse is a function f(v) of v = J x + bias,

    s_n = v_n + eps lambda_n >= 0   perpendicular to   0 <= lambda_n <= limit,
    s_t = v_t + eps lambda_t,       |lambda_t| <= mu lambda_n,     lambda_t . s_t = -mu lambda_n |s_t|,

which is Coulomb's law with its round cone: lambda_n = -v_n / eps where that is positive, and lambda_t = -v_t / eps
where that lies in the cone (sticking), else -mu lambda_n v_t / |v_t| (sliding). Nothing but x is left to be found,

    M xi' - p - J_e' lambda_e - sum_c J_c' f_c(J_c x + bias_c) = 0,      J_e xi' + bias_e + eps_e lambda_e = 0,

and its derivative is S = [M + sum_c J' G J, -J_e'; J_e, eps_e I] with the 3 x 3 gain G = -df/dv of each contact: the
cost is linear in the number of contacts, and there are no directions of friction to choose.

The compliance eps is a 1e-5th of a body's inverse mass. It picks the least-squares distribution among the infinitely
many contact forces of a face on a face (a rigid plate on equal springs), which makes x', its friction torque and its
gradient unique. It changes velocities by eps lambda, about 1e-7 m/s in a push, and lets a block rest 0.1 nm deep.

Source: PIN-WM eq. 8-9, with the cone in place of its polyhedron; Cline (2002), section 4. The compliance is ours.
"""

import math

from pinwm_drake.jit import small_kernel

# Modes of a contact; the last two press with the largest normal impulse that they have.
OPEN, STICKS, SLIDES, FULL_STICKS, FULL_SLIDES = range(5)
# Columns of the gains: G = [nn, 0, 0; 1n, 11, 12; 2n, 12, 22].
NN, N1, N2, T11, T12, T22 = range(6)
# Columns of work.slip: direction of the friction on A, and what it resists across that direction, N s / (m/s).
ALONG_1, ALONG_2, ACROSS = range(3)
# A normal impulse without a limit, N s.
NO_LIMIT = 1e300


@small_kernel
def slides(mode):
    """Return True for the modes of a contact that slides."""
    return mode in (SLIDES, FULL_SLIDES)


@small_kernel
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


@small_kernel
def contact_velocities(contacts, x, v):
    """Write v = J x + bias (C, 3) of all contacts."""
    bias = contacts.bias
    for c in range(contacts.number[0]):
        jn, j1, j2 = contact_velocity(contacts, c, x)
        v[c, 0], v[c, 1], v[c, 2] = jn + bias[c, 0], j1 + bias[c, 1], j2 + bias[c, 2]


@small_kernel
def set_slip(work, c, most):
    """Slip of contact c that slides at the velocity work.v[c] with a friction of `most`, N s."""
    v, slip = work.v[c], work.slip[c]
    speed = math.sqrt(v[1] * v[1] + v[2] * v[2])
    slip[ALONG_1], slip[ALONG_2], slip[ACROSS] = -v[1] / speed, -v[2] / speed, most / speed


@small_kernel
def set_gain_across(gain, slip):
    """Gain of a contact that slides, across its direction."""
    d1, d2, across = slip[ALONG_1], slip[ALONG_2], slip[ACROSS]
    gain[T11], gain[T12], gain[T22] = across * d2 * d2, -across * d1 * d2, across * d1 * d1


@small_kernel
def set_mode(system, contacts, work, c):
    """Mode and slip of contact c by the law at the velocity work.v[c]."""
    inverse = 1.0 / system.contact_compliance
    v, mu = work.v[c], contacts.mu[c]
    normal = -v[0] * inverse
    if not normal > 0.0:
        work.mode[c] = OPEN
        return
    full = normal > contacts.limit[c]
    most = mu * min(normal, contacts.limit[c])
    speed = math.sqrt(v[1] * v[1] + v[2] * v[2])
    work.mode[c] = FULL_STICKS if full else STICKS
    if mu > 0.0 and speed * inverse > most:
        work.mode[c] = FULL_SLIDES if full else SLIDES
        set_slip(work, c, most)


@small_kernel
def set_gain(system, contacts, work, c):
    """Gain and offset of contact c in its mode, so that its impulse is offset - G v."""
    inverse = 1.0 / system.contact_compliance
    mode, mu, gain, offset = work.mode[c], contacts.mu[c], work.gain[c], work.offset[c]
    for i in range(6):
        gain[i] = 0.0
    offset[0], offset[1], offset[2] = 0.0, 0.0, 0.0
    if mode == OPEN:
        return
    full = mode >= FULL_STICKS
    if full:
        offset[0] = contacts.limit[c]
    else:
        gain[NN] = inverse
    if mu == 0.0:
        return
    if not slides(mode):
        gain[T11], gain[T22] = inverse, inverse
        return
    set_gain_across(gain, work.slip[c])
    d1, d2 = work.slip[c, ALONG_1], work.slip[c, ALONG_2]
    if full:
        offset[1], offset[2] = mu * contacts.limit[c] * d1, mu * contacts.limit[c] * d2
    else:
        gain[N1], gain[N2] = mu * inverse * d1, mu * inverse * d2


@small_kernel
def contact_impulse(work, c):
    """Impulse offset - G v of contact c in its frame, N s: normal and two tangential components."""
    v, gain, offset = work.v[c], work.gain[c], work.offset[c]
    return (
        offset[0] - gain[NN] * v[0],
        offset[1] - gain[N1] * v[0] - gain[T11] * v[1] - gain[T12] * v[2],
        offset[2] - gain[N2] * v[0] - gain[T12] * v[1] - gain[T22] * v[2],
    )


@small_kernel
def assemble(system, contacts, work):
    """Write the derivative S for the gains in `work.gain`."""
    num_bodies, num_rows = system.num_bodies, system.num_rows
    inertia, mass, J_e = system.inertia, system.mass, system.J_e
    bodies, J, S = contacts.dynamic, contacts.J, work.S
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
        if work.mode[c] == OPEN:
            continue
        gain = work.gain[c]
        gnn, g1n, g2n, g11, g12, g22 = gain[NN], gain[N1], gain[N2], gain[T11], gain[T12], gain[T22]
        for left in range(2):
            row = bodies[c, left]
            if row < 0:
                continue
            for i in range(6):
                jn, j1, j2 = J[c, left, 0, i], J[c, left, 1, i], J[c, left, 2, i]
                fn = gnn * jn + g1n * j1 + g2n * j2
                f1, f2 = g11 * j1 + g12 * j2, g12 * j1 + g22 * j2
                for right in range(2):
                    column = bodies[c, right]
                    if column < 0:
                        continue
                    for j in range(6):
                        S[6 * row + i, 6 * column + j] += (
                            fn * J[c, right, 0, j] + f1 * J[c, right, 1, j] + f2 * J[c, right, 2, j]
                        )
    for r in range(num_rows):
        for i in range(size):
            S[size + r, i] = J_e[r, i]
            S[i, size + r] = -J_e[r, i]
        S[size + r, size + r] = system.joint_compliance


@small_kernel
def negative_residual(system, contacts, work, out):
    """Write out = -(M xi' - p - J_e' lambda_e - J' (offset - G v); J_e xi' + bias_e + eps_e lambda_e)."""
    bodies, J, x = contacts.dynamic, contacts.J, work.x
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
        if work.mode[c] == OPEN:
            continue
        fn, f1, f2 = contact_impulse(work, c)
        for side in range(2):
            body = bodies[c, side]
            if body >= 0:
                for i in range(6):
                    out[6 * body + i] += J[c, side, 0, i] * fn + J[c, side, 1, i] * f1 + J[c, side, 2, i] * f2


@small_kernel
def take_impulses(contacts, work):
    """Write the impulses of all contacts at work.v into work.lam (C, 3)."""
    for c in range(contacts.number[0]):
        work.lam[c, 0], work.lam[c, 1], work.lam[c, 2] = contact_impulse(work, c)


@small_kernel
def scales(system, contacts):
    """Impulse [N s] and speed [m/s] scales of a step, by which tolerances are made relative."""
    speed = 1e-6
    total = 0.0
    for b in range(system.num_bodies):
        total += system.mass[b]
        for i in range(3):
            speed = max(speed, abs(system.free[6 * b + 3 + i]))
    for c in range(contacts.number[0]):
        jn, j1, j2 = contact_velocity(contacts, c, system.free)
        for i in range(3):
            speed = max(speed, abs(contacts.bias[c, i]))
        speed = max(speed, max(abs(jn), max(abs(j1), abs(j2))))
    return total * speed / max(contacts.number[0], 1), speed
