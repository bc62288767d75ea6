# SPDX-License-Identifier: MIT
"""Joint rows: Jacobians, biases and position errors, and their adjoint (numba).

A joint is a set of rows, each along a direction d fixed in body B: a linear row keeps d . (c_A - c_B) at zero for
anchors c_A and c_B, an angular row keeps the relative rotation about d at zero (for a hinge, the misalignment of
the two axes). B may be a dynamic body, the pusher or the world.

Source: Cline (2002), section 2.5.
"""

import numpy as np

from pinwm_drake.geometry.vectors import cross, dot, rotate
from pinwm_drake.jit import allocating_kernel, kernel
from pinwm_drake.physics.kernels.arrays import ANGULAR_HINGE, LINEAR


@kernel
def joint_geometry(model, bodies, r, d, u_A, u_B):
    """World-frame direction d and anchors (for hinges: axes) u_A, u_B of row r; each (3,)."""
    A, B = model.joint_bodies[r, 0], model.joint_bodies[r, 1]
    v, a, b = model.joint_direction[r], model.joint_anchor[r, 0], model.joint_anchor[r, 1]
    d[0], d[1], d[2] = rotate(bodies.R[B], v[0], v[1], v[2])
    u_A[0], u_A[1], u_A[2] = rotate(bodies.R[A], a[0], a[1], a[2])
    u_B[0], u_B[1], u_B[2] = rotate(bodies.R[B], b[0], b[1], b[2])


@allocating_kernel
def build_joints(model, bodies, system):
    """Fill system.J_e, bias_e (the pusher's share) and error_e."""
    nb = model.num_bodies
    d, u_A, u_B, row = np.empty(3), np.empty(3), np.empty(3), np.empty(6)
    for r in range(system.num_rows):
        A, B = model.joint_bodies[r, 0], model.joint_bodies[r, 1]
        joint_geometry(model, bodies, r, d, u_A, u_B)
        for i in range(6 * nb):
            system.J_e[r, i] = 0.0
        system.bias_e[r] = 0.0
        kind = model.joint_kind[r]
        for side in range(2):
            body = A if side == 0 else B
            sign = 1.0 if side == 0 else -1.0
            u = u_A if side == 0 else u_B
            if kind == LINEAR:
                row[0], row[1], row[2] = cross(u[0], u[1], u[2], d[0], d[1], d[2])
                row[3], row[4], row[5] = d[0], d[1], d[2]
            else:
                row[0], row[1], row[2] = d[0], d[1], d[2]
                row[3], row[4], row[5] = 0.0, 0.0, 0.0
            for i in range(6):
                if body < nb:
                    system.J_e[r, 6 * body + i] += sign * row[i]
                else:
                    system.bias_e[r] += sign * row[i] * bodies.V[body, i]
        error = 0.0
        if kind == LINEAR:
            for i in range(3):
                error += d[i] * (bodies.p[A, i] + u_A[i] - bodies.p[B, i] - u_B[i])
        elif kind == ANGULAR_HINGE:
            error = dot(d[0], d[1], d[2], *cross(u_B[0], u_B[1], u_B[2], u_A[0], u_A[1], u_A[2]))
        else:
            # Small rotation of A away from R_WB R_BA: half the antisymmetric part of R_WA R_AB R_BW.
            R_A, R_B, K = bodies.R[A], bodies.R[B], model.joint_rotation[r]
            for i in range(3):
                j, m = (i + 1) % 3, (i + 2) % 3
                forward, backward = 0.0, 0.0
                for p in range(3):
                    for q in range(3):
                        forward += R_A[m, p] * K[q, p] * R_B[j, q]
                        backward += R_A[j, p] * K[q, p] * R_B[m, q]
                error += d[i] * 0.5 * (forward - backward)
        system.error_e[r] = error


@kernel
def _add_cross(out, scale, a, b):
    x, y, z = cross(a[0], a[1], a[2], b[0], b[1], b[2])
    out[0], out[1], out[2] = out[0] + scale * x, out[1] + scale * y, out[2] + scale * z


@allocating_kernel
def joints_adjoint(model, bodies, system, solver, adjoint):
    """Pull the gradients of J_e, bias_e and error_e back to poses and to the pusher's velocity.

    adjoint.J_e and adjoint.error_e hold what the stabilisation gave; the part of the step's equations is added here.
    The derivative of an angular row's error leaves out terms of the size of the joint's drift (below 1e-6).
    """
    nb = model.num_bodies
    size = 6 * nb
    d, u_A, u_B = np.empty(3), np.empty(3), np.empty(3)
    d_bar, u_bar, block = np.empty(3), np.empty(3), np.empty(6)
    for r in range(system.num_rows):
        A, B = model.joint_bodies[r, 0], model.joint_bodies[r, 1]
        linear = model.joint_kind[r] == LINEAR
        joint_geometry(model, bodies, r, d, u_A, u_B)
        y_e, lam_e = adjoint.y[size + r], solver.x[size + r]
        for i in range(size):
            adjoint.J_e[r, i] += lam_e * adjoint.y[i] - y_e * solver.x[i]
        error_bar = adjoint.error_e[r]
        d_bar[:] = 0.0
        for side in range(2):
            body = A if side == 0 else B
            sign = 1.0 if side == 0 else -1.0
            u = u_A if side == 0 else u_B
            pose = adjoint.pose[body]
            for i in range(6):
                # A side that is not dynamic enters through the bias: bias_e = sign row . V.
                block[i] = sign * (adjoint.J_e[r, 6 * body + i] if body < nb else -y_e * bodies.V[body, i])
            u_bar[:] = 0.0
            if linear:
                for i in range(3):
                    d_bar[i] += block[3 + i] + sign * error_bar * (bodies.p[body, i] + u[i])
                    u_bar[i] += sign * error_bar * d[i]
                    pose[3 + i] += sign * error_bar * d[i]
                _add_cross(d_bar, 1.0, block, u)
                _add_cross(u_bar, 1.0, d, block)
                _add_cross(pose, 1.0, u, u_bar)
                if body >= nb:
                    _add_cross(adjoint.V[body], -y_e * sign, u, d)
                    for i in range(3):
                        adjoint.V[body, 3 + i] -= y_e * sign * d[i]
            else:
                for i in range(3):
                    d_bar[i] += block[i]
                    pose[i] += sign * error_bar * d[i]
                    if body >= nb:
                        adjoint.V[body, i] -= y_e * sign * d[i]
        _add_cross(adjoint.pose[B], 1.0, d, d_bar)
