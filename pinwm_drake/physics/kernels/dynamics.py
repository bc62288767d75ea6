# SPDX-License-Identifier: MIT
"""Rotations, gyroscopic steps and the right-hand side of the momentum balance (numba)."""

import math

from pinwm_drake.geometry.vectors import cross, rotate, rotate_back
from pinwm_drake.jit import kernel, small_kernel
from pinwm_drake.physics.kernels.rolling import rolling_torque

_NEWTON_STEPS = 8
# Stages: velocities whose positions do not overlap, velocities after a step, and velocities after an impact.
POSITION, VELOCITY, IMPACT = range(3)


@small_kernel
def rotation_from_quaternion(q, R):
    """Write R (3, 3) of a unit quaternion q (w, x, y, z)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    R[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    R[0, 1] = 2.0 * (x * y - w * z)
    R[0, 2] = 2.0 * (x * z + w * y)
    R[1, 0] = 2.0 * (x * y + w * z)
    R[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    R[1, 2] = 2.0 * (y * z - w * x)
    R[2, 0] = 2.0 * (x * z - w * y)
    R[2, 1] = 2.0 * (y * z + w * x)
    R[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@small_kernel
def integrate_quaternion(q, x, y, z):
    """Quaternion update q <- exp([x, y, z]) q, the rotation vector in the world frame, rad; renormalised."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:
        c, s = 1.0 - angle2 / 8.0, 0.5 - angle2 / 48.0
    else:
        angle = math.sqrt(angle2)
        c, s = math.cos(0.5 * angle), math.sin(0.5 * angle) / angle
    x, y, z = s * x, s * y, s * z
    w0, x0, y0, z0 = q[0], q[1], q[2], q[3]
    w1 = c * w0 - x * x0 - y * y0 - z * z0
    x1 = c * x0 + x * w0 + y * z0 - z * y0
    y1 = c * y0 + y * w0 + z * x0 - x * z0
    z1 = c * z0 + z * w0 + x * y0 - y * x0
    s = 1.0 / math.sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    q[0], q[1], q[2], q[3] = s * w1, s * x1, s * y1, s * z1


@kernel
def solve3(A, x, y, z):
    """Solution of the 3 x 3 system A u = (x, y, z), A given as nine numbers by rows (Cramer)."""
    a, b, c, d, e, f, g, h, i = A
    c0, c1, c2 = e * i - f * h, f * g - d * i, d * h - e * g
    s = 1.0 / (a * c0 + b * c1 + c * c2)
    return (
        s * (c0 * x + (c * h - b * i) * y + (b * f - c * e) * z),
        s * (c1 * x + (a * i - c * g) * y + (c * d - a * f) * z),
        s * (c2 * x + (b * g - a * h) * y + (a * e - b * d) * z),
    )


@kernel
def gyroscopic_jacobian(I_B, w, h):
    """Return the derivative of the gyroscopic residual, I_B + h ([w]x I_B - [I w]x), as nine numbers by rows."""
    x, y, z = w[0], w[1], w[2]
    mx, my, mz = rotate(I_B, x, y, z)
    return (
        I_B[0, 0] + h * (y * I_B[2, 0] - z * I_B[1, 0]),
        I_B[0, 1] + h * (y * I_B[2, 1] - z * I_B[1, 1] + mz),
        I_B[0, 2] + h * (y * I_B[2, 2] - z * I_B[1, 2] - my),
        I_B[1, 0] + h * (z * I_B[0, 0] - x * I_B[2, 0] - mz),
        I_B[1, 1] + h * (z * I_B[0, 1] - x * I_B[2, 1]),
        I_B[1, 2] + h * (z * I_B[0, 2] - x * I_B[2, 2] + mx),
        I_B[2, 0] + h * (x * I_B[1, 0] - y * I_B[0, 0] + my),
        I_B[2, 1] + h * (x * I_B[1, 1] - y * I_B[0, 1] - mx),
        I_B[2, 2] + h * (x * I_B[1, 2] - y * I_B[0, 2]),
    )


@small_kernel
def gyroscopic_step(I_B, w0, h, w):
    """Implicit step of torque-free rotation in the body frame: I_B (w - w0) + h w x I_B w = 0, by Newton's method.

    It never adds energy, unlike the explicit term.

    Args:
        I_B: (3, 3), body frame, kg m^2.
        w0: three numbers, rad/s, body frame.
        h: s.
        w: (3,), receives the new angular velocity, rad/s, body frame.

    Source: E. Catto, "Numerical methods", GDC 2015, here iterated to convergence.
    """
    w[0], w[1], w[2] = w0
    for _ in range(_NEWTON_STEPS):
        x, y, z = w[0], w[1], w[2]
        mx, my, mz = rotate(I_B, x, y, z)
        dx, dy, dz = x - w0[0], y - w0[1], z - w0[2]
        rx = I_B[0, 0] * dx + I_B[0, 1] * dy + I_B[0, 2] * dz + h * (y * mz - z * my)
        ry = I_B[1, 0] * dx + I_B[1, 1] * dy + I_B[1, 2] * dz + h * (z * mx - x * mz)
        rz = I_B[2, 0] * dx + I_B[2, 1] * dy + I_B[2, 2] * dz + h * (x * my - y * mx)
        ux, uy, uz = solve3(gyroscopic_jacobian(I_B, w, h), rx, ry, rz)
        w[0], w[1], w[2] = x - ux, y - uy, z - uz
        if abs(ux) + abs(uy) + abs(uz) <= 1e-15 * (abs(x) + abs(y) + abs(z)):
            break


@kernel
def gyroscopic_acceleration(I_B, w):
    """Return I_B^-1 (w x I_B w), rad/s^2, body frame."""
    mx, my, mz = rotate(I_B, w[0], w[1], w[2])
    A = (
        I_B[0, 0], I_B[0, 1], I_B[0, 2], I_B[1, 0], I_B[1, 1], I_B[1, 2], I_B[2, 0], I_B[2, 1], I_B[2, 2],
    )  # fmt: skip
    return solve3(A, *cross(w[0], w[1], w[2], mx, my, mz))


@small_kernel
def begin_stage(model, mass, inertia, bodies, system, stage):
    """Rotations, inertias in world axes, and the velocities and momenta that a stage begins with.

    A stage takes half of the step's gravity and gyroscopic torque: implicitly in the position stage and explicitly in
    the velocity stage, which together are the midpoint rule for a body that turns freely. It keeps energy and spin.
    Half of the rolling friction of rims, by the pose and velocity that the stage begins with, is in the momenta.

    Args:
        mass: (nb,), kg.
        inertia: (nb, 3, 3), about the centre of mass, body frame, kg m^2.
        stage: POSITION, VELOCITY, or IMPACT, in which no time passes.
    """
    half = 0.5 * bodies.time_step[0]
    for b in range(model.num_bodies + model.num_kinematic):
        rotation_from_quaternion(bodies.q[b], bodies.R[b])
    for b in range(model.num_bodies):
        R, I_B, V = bodies.R[b], inertia[b], bodies.V[b]
        w = bodies.V_body[b]
        if stage == POSITION:
            gyroscopic_step(I_B, rotate_back(R, V[0], V[1], V[2]), half, w)
            x, y, z = w[0], w[1], w[2]
        else:
            # Nothing, in an impact: its length is 0.
            x, y, z = rotate_back(R, V[0], V[1], V[2])
            w[0], w[1], w[2] = x, y, z
            ux, uy, uz = gyroscopic_acceleration(I_B, w)
            x, y, z = x - half * ux, y - half * uy, z - half * uz
        o = 6 * b
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    for m in range(3):
                        total += R[i, k] * I_B[k, m] * R[j, m]
                system.inertia[b, i, j] = total
            system.free[o + i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
            system.free[o + 3 + i] = V[3 + i] + half * model.gravity[i]
        system.mass[b] = mass[b]
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += system.inertia[b, i, j] * system.free[o + j]
            system.momentum[o + i] = total
            system.momentum[o + 3 + i] = mass[b] * system.free[o + 3 + i]
        if half > 0.0:
            drag, _, _ = rolling_torque(model, system.mass, bodies, b)
            system.momentum[o] += half * drag * V[0]
            system.momentum[o + 1] += half * drag * V[1]
