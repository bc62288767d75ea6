# SPDX-License-Identifier: MIT
"""What levers and normals that turn within a step make of the velocities before it, and its adjoint (numba)."""

from pinwm_drake.geometry.features import contact_from_features
from pinwm_drake.geometry.vectors import cross, norm, rotate
from pinwm_drake.jit import kernel, large_kernel, small_kernel
from pinwm_drake.physics.kernels import triples
from pinwm_drake.physics.kernels.cone import OPEN
from pinwm_drake.physics.kernels.dynamics import integrate_quaternion, rotation_from_quaternion
from pinwm_drake.physics.kernels.geometry_adjoint import geometry_adjoint
from pinwm_drake.physics.kernels.triples import add, rotation_adjoint

# Spins and speeds below this turn no contact, rad/s and m/s.
STILL = 1e-12
# Share of a length over which differences are taken.
_DIFFERENCE = 1e-4


@small_kernel
def point_velocity(V, r):
    """Velocity of the point at lever r of a body with spatial velocity V, m/s."""
    x, y, z = cross(V[0], V[1], V[2], r[0], r[1], r[2])
    return V[3] + x, V[4] + y, V[5] + z


@small_kernel
def relative_velocity(V_A, V_B, p_A, p_B, a, b):
    """Velocity of A against B midway between the witness points a and b, m/s."""
    x, y, z = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
    A = point_velocity(V_A, (x - p_A[0], y - p_A[1], z - p_A[2]))
    B = point_velocity(V_B, (x - p_B[0], y - p_B[1], z - p_B[2]))
    return A[0] - B[0], A[1] - B[1], A[2] - B[2]


@small_kernel
def move_body(bodies, sweep, b, V, h):
    """Pose of body b after h seconds with a velocity V (6,), angular first, rad/s and m/s: in the sweep's R, p, q."""
    q = sweep.q[b]
    for i in range(4):
        q[i] = bodies.q[b, i]
    integrate_quaternion(q, h * V[0], h * V[1], h * V[2])
    rotation_from_quaternion(q, sweep.R[b])
    for i in range(3):
        sweep.p[b, i] = bodies.p[b, i] + h * V[3 + i]


@small_kernel
def move_halfway(model, bodies, sweep, half):
    """Poses after half of a step, of `half` seconds, with the velocities before it, and whether contacts may turn.

    The normal between round shapes turns where they pass each other, though neither spins.
    """
    fastest = 0.0
    for b in range(model.num_bodies + model.num_kinematic):
        V = bodies.V[b]
        fastest = max(fastest, norm(V[0], V[1], V[2]), norm(V[3], V[4], V[5]))
        move_body(bodies, sweep, b, V, half)
    sweep.turns[0] = 1 if fastest > STILL else 0


@small_kernel
def floor_curve(row, V, R, p, frame, lever):
    """Return what the lever of a point over the floor makes of V, m/s, at the pose R, p after half of a step.

    It is `curve` for a row of the features whose normal does not turn; frame and lever are those before the step.
    """
    n = frame[0]
    x, y, z = rotate(R, row[1], row[2], row[3])
    # The contact is in the middle between the point's surface and the floor.
    gap = n[0] * (p[0] + x - row[9]) + n[1] * (p[1] + y - row[10]) + n[2] * (p[2] + z - row[11])
    middle = 0.5 * (gap + row[7])
    x, y, z = x - middle * n[0] - lever[0], y - middle * n[1] - lever[1], z - middle * n[2] - lever[2]
    x, y, z = cross(V[0], V[1], V[2], x, y, z)
    return (
        x * n[0] + y * n[1] + z * n[2],
        x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2],
        x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2],
    )


@kernel
def curve(bodies, contacts, sweep, c):
    """Return what contact c's levers and normal that turn make of the velocities before the step, m/s.

    They are those at the poses of the sweep, less those at the poses before the step: along normal and tangents.
    """
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    V_A, V_B, frame, point = bodies.V[A], bodies.V[B], contacts.frame[c], sweep.point
    x0, y0, z0 = relative_velocity(V_A, V_B, bodies.p[A], bodies.p[B], contacts.witness[c, 0], contacts.witness[c, 1])
    contact_from_features(
        contacts.rows[c], sweep.R[A], sweep.p[A], sweep.R[B], sweep.p[B], point[0], point[1], point[2]
    )
    x, y, z = relative_velocity(V_A, V_B, sweep.p[A], sweep.p[B], point[1], point[2])
    n = x * point[0, 0] + y * point[0, 1] + z * point[0, 2]
    n -= x0 * frame[0, 0] + y0 * frame[0, 1] + z0 * frame[0, 2]
    x, y, z = x - x0, y - y0, z - z0
    return (
        n,
        x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2],
        x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2],
    )


@large_kernel
def curve_slopes(model, bodies, contacts, sweep, mode):
    """Write derivatives of `curve` by the step's length into contacts.curve, m/s^2, where contacts press."""
    half = 0.5 * bodies.time_step[0]
    change = _DIFFERENCE * half
    for side in range(2):
        move_halfway(model, bodies, sweep, half + change - 2.0 * side * change)
        for c in range(contacts.number[0]):
            slope = contacts.curve[c]
            if mode[c] == OPEN:
                continue
            x, y, z = curve(bodies, contacts, sweep, c)
            if side == 0:
                slope[0], slope[1], slope[2] = x, y, z
            else:
                scale = 0.25 / change
                slope[0], slope[1], slope[2] = scale * (slope[0] - x), scale * (slope[1] - y), scale * (slope[2] - z)
    move_halfway(model, bodies, sweep, half)


@small_kernel
def middle_adjoint(model, bodies, adjoint):
    """Adjoint of `move_halfway`: adjoint.middle to poses and velocities before the step."""
    half = 0.5 * bodies.time_step[0]
    for b in range(model.num_bodies + model.num_kinematic):
        V, middle = bodies.V[b], adjoint.middle[b]
        phi_bar, theta_bar = rotation_adjoint(
            (half * V[0], half * V[1], half * V[2]), (middle[0], middle[1], middle[2])
        )
        for i in range(3):
            adjoint.pose[b, i] += theta_bar[i]
            adjoint.pose[b, 3 + i] += middle[3 + i]
            adjoint.before[b, i] += half * phi_bar[i]
            adjoint.before[b, 3 + i] += half * middle[3 + i]


@small_kernel
def curve_adjoint(model, bodies, contacts, sweep, adjoint, c, s_n, s_1, s_2):
    """Adjoint of `curve` with gradients s of the biases: at the start and after half of the step."""
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    frame, lever, point = contacts.frame[c], adjoint.lever, sweep.point
    V_A, V_B = bodies.V[A], bodies.V[B]
    contact_from_features(
        contacts.rows[c], sweep.R[A], sweep.p[A], sweep.R[B], sweep.p[B], point[0], point[1], point[2]
    )
    kept = (lever[0, 0], lever[0, 1], lever[0, 2], lever[1, 0], lever[1, 1], lever[1, 2])
    n, a, b = point[0], point[1], point[2]
    now = relative_velocity(V_A, V_B, bodies.p[A], bodies.p[B], contacts.witness[c, 0], contacts.witness[c, 1])
    then = relative_velocity(V_A, V_B, sweep.p[A], sweep.p[B], a, b)
    side = (s_1 * frame[1, 0] + s_2 * frame[2, 0], s_1 * frame[1, 1] + s_2 * frame[2, 1],
            s_1 * frame[1, 2] + s_2 * frame[2, 2])  # fmt: skip
    before = adjoint.before
    late = (s_n * n[0] + side[0], s_n * n[1] + side[1], s_n * n[2] + side[2])
    early = (-s_n * frame[0, 0] - side[0], -s_n * frame[0, 1] - side[1], -s_n * frame[0, 2] - side[2])
    for i in range(3):
        lever[0, i], lever[1, i] = 0.0, 0.0
    for end in range(2):
        body, sign = (A, 1.0) if end == 0 else (B, -1.0)
        V = bodies.V[body]
        r = (
            0.5 * (a[0] + b[0]) - sweep.p[body, 0],
            0.5 * (a[1] + b[1]) - sweep.p[body, 1],
            0.5 * (a[2] + b[2]) - sweep.p[body, 2],
        )
        add(before[body], 0, sign, triples.cross(r, late))
        add(before[body], 3, sign, late)
        add(lever[end], 0, sign, triples.cross(late, V))
    n_bar = (s_n * then[0], s_n * then[1], s_n * then[2])
    geometry_adjoint(model, contacts, adjoint, c, sweep.R, sweep.p, n, a, b, adjoint.middle, n_bar, 0.0)
    for i in range(3):
        lever[0, i], lever[1, i] = kept[i], kept[3 + i]
        adjoint.frame[0, i] -= s_n * now[i]
        adjoint.frame[1, i] += s_1 * (then[i] - now[i])
        adjoint.frame[2, i] += s_2 * (then[i] - now[i])
    for end in range(2):
        body, sign = (A, 1.0) if end == 0 else (B, -1.0)
        add(before[body], 0, sign, triples.cross(contacts.lever[c, end], early))
        add(before[body], 3, sign, early)
        add(lever[end], 0, sign, triples.cross(early, bodies.V[body]))
