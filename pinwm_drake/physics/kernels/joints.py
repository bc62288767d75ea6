"""Joint rows: Jacobians, biases and position errors (numba).

A joint is a set of rows, each along a direction d fixed in body B: a linear row keeps d . (c_A - c_B) at zero for
anchors c_A and c_B, an angular row keeps the relative rotation about d at zero (for a hinge, the misalignment of
the two axes). B may be a dynamic body, the pusher or the world.

Source: Cline (2002), section 2.5.
"""

import numpy as np

from pinwm_drake.jit import allocating_kernel, kernel
from pinwm_drake.physics.kernels.arrays import ANGULAR_HINGE, LINEAR


@kernel
def _rotate(R, v, out):
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


@kernel
def joint_geometry(model, bodies, r, d, u_A, u_B):
    """World-frame direction d and anchors (for hinges: axes) u_A, u_B of row r; each (3,)."""
    A, B = model.joint_bodies[r, 0], model.joint_bodies[r, 1]
    _rotate(bodies.R[B], model.joint_direction[r], d)
    _rotate(bodies.R[A], model.joint_anchor[r, 0], u_A)
    _rotate(bodies.R[B], model.joint_anchor[r, 1], u_B)


@allocating_kernel
def build_joints(model, bodies, system):
    """Fills system.J_e, bias_e (the pusher's share) and error_e."""
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
                row[0], row[1], row[2] = (
                    u[1] * d[2] - u[2] * d[1],
                    u[2] * d[0] - u[0] * d[2],
                    u[0] * d[1] - u[1] * d[0],
                )
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
            error = (
                d[0] * (u_B[1] * u_A[2] - u_B[2] * u_A[1])
                + d[1] * (u_B[2] * u_A[0] - u_B[0] * u_A[2])
                + d[2] * (u_B[0] * u_A[1] - u_B[1] * u_A[0])
            )
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
