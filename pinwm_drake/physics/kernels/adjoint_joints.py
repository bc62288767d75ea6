"""The adjoint of a step's joint rows (numba); see `joints.py` and `adjoint.py`."""

import numpy as np

from pinwm_drake.jit import allocating_kernel, kernel
from pinwm_drake.physics.kernels.arrays import LINEAR
from pinwm_drake.physics.kernels.joints import joint_geometry


@kernel
def _add_cross(out, start, scale, a, b):
    out[start] += scale * (a[1] * b[2] - a[2] * b[1])
    out[start + 1] += scale * (a[2] * b[0] - a[0] * b[2])
    out[start + 2] += scale * (a[0] * b[1] - a[1] * b[0])


@allocating_kernel
def joints_adjoint(model, bodies, system, solver, adjoint):
    """Pulls the gradients of J_e, bias_e and error_e back to poses and to the pusher's velocity.

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
                _add_cross(d_bar, 0, 1.0, block, u)
                _add_cross(u_bar, 0, 1.0, d, block)
                _add_cross(pose, 0, 1.0, u, u_bar)
                if body >= nb:
                    _add_cross(adjoint.V[body], 0, -y_e * sign, u, d)
                    for i in range(3):
                        adjoint.V[body, 3 + i] -= y_e * sign * d[i]
            else:
                for i in range(3):
                    d_bar[i] += block[i]
                    pose[i] += sign * error_bar * d[i]
                    if body >= nb:
                        adjoint.V[body, i] -= y_e * sign * d[i]
        _add_cross(adjoint.pose[B], 0, 1.0, d, d_bar)
