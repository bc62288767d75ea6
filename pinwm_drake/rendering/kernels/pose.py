"""Quaternions of any length to rotation matrices, and back for gradients (numba)."""

from pinwm_drake.jit import entry_point
from pinwm_drake.rendering.kernels.project import rotation_columns
from pinwm_drake.rendering.kernels.project_adjoint import quaternion_gradient


@entry_point
def fill_rotations(q, R):
    """Writes rotations R (V, 3, 3) of quaternions q (V, 4), wxyz."""
    for v in range(q.shape[0]):
        columns = rotation_columns(q[v, 0], q[v, 1], q[v, 2], q[v, 3])
        for i in range(3):
            for j in range(3):
                R[v, i, j] = columns[3 * j + i]


@entry_point
def pull_rotations(q, R_bar, q_bar):
    """Gradient q_bar (V, 4) with respect to q, from that with respect to R."""
    for v in range(q.shape[0]):
        first = (R_bar[v, 0, 0], R_bar[v, 1, 0], R_bar[v, 2, 0])
        second = (R_bar[v, 0, 1], R_bar[v, 1, 1], R_bar[v, 2, 1])
        third = (R_bar[v, 0, 2], R_bar[v, 1, 2], R_bar[v, 2, 2])
        q_bar[v] = quaternion_gradient(q[v, 0], q[v, 1], q[v, 2], q[v, 3], first, second, third)
