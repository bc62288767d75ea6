"""The narrow phase for many worlds at once, for the torch reference (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point
from pinwm_drake.physics.kernels.detect import select_features
from pinwm_drake.physics.kernels.dynamics import rotation_from_quaternion
from pinwm_drake.physics.kernels.workspace import make_workspace


@entry_point
def select_worlds(model, center, spread, offset, q, p, V, q_P, p_P, V_P, limit):
    """Feature pairs of all worlds, padded to `limit` contacts.

    Args:
        model: ModelArrays.
        center, spread, offset: (W, nb, 3), (W, nb, 3), (W, num_pairs), as in `Parameters`.
        q, p, V: (W, nb, 4 | 3 | 6), states.
        q_P, p_P, V_P: (W, 4 | 3 | 6), the pusher.
        limit: contacts of a world at the most.

    Returns:
        count (W,), rows (W, limit, 16), body (W, limit, 2), pair (W, limit).
    """
    W = q.shape[0]
    nb = model.num_bodies
    count = np.zeros(W, np.int64)
    rows = np.zeros((W, limit, 16))
    body = np.zeros((W, limit, 2), np.int64)
    pair = np.zeros((W, limit), np.int64)
    bodies, contacts, _, _, _ = make_workspace(model, limit)
    for w in range(W):
        bodies.offset[:] = offset[w]
        for b in range(nb):
            bodies.center[b] = center[w, b]
            bodies.spread[b] = spread[w, b]
            bodies.p[b] = p[w, b]
            bodies.V[b] = V[w, b]
            rotation_from_quaternion(q[w, b], bodies.R[b])
        if model.num_kinematic > 0:
            bodies.p[nb] = p_P[w]
            bodies.V[nb] = V_P[w]
            rotation_from_quaternion(q_P[w], bodies.R[nb])
        select_features(model, bodies, contacts)
        count[w] = contacts.number[0]
        rows[w] = contacts.rows
        body[w] = contacts.body
        pair[w] = contacts.pair
    return count, rows, body, pair
