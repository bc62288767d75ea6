# SPDX-License-Identifier: MIT
"""Steps of sliding objects (numba): each the minimum of a strictly convex function of the velocity at its end.

That function is the kinetic energy of the change of velocity, the dissipation by friction of each cell, and a potential
of the impulses at the pusher; `residual.step_residual` is its derivative, in torch.

Source: Goyal, Ruina and Papadopoulos, "Planar sliding with dry friction, part 1", Wear 143, 1991, for friction as the
derivative of a dissipation; Castro et al., "An unconstrained convex formulation of compliant contact", T-RO 2022, for
the pusher.
"""

import math

import numpy as np

from pinwm_drake.jit import entry_point, kernel

CONTACTS = 2  # outlines that a pusher can touch at once, as in a concave corner
CREEP = 1e-3  # m/s, slip below which a cell's friction falls off to zero: what is slower creeps to rest
COMPLIANCE = 0.01  # velocity by which a contact gives way, over that at which its impulse would move the whole mass
PARTING = 0.02  # m/s, velocity at which a pusher leaves an outline that it began inside of
_ITERATIONS, _TRIALS = 100, 40
_LEVEL = 0.02  # slope that ends a search along a line, over that at its beginning
_EXACT = 1e-11  # m/s, Newton step that ends the search; of the yaw times the radius of gyration
_SMALLEST = 1e-12  # m, length of an edge; those of repeated corners are shorter


@entry_point
def slide(
    outlines: np.ndarray,
    path: np.ndarray,
    radius: float,
    time_step: float,
    mass: np.ndarray,
    inertia: np.ndarray,
    arm: np.ndarray,
    load: np.ndarray,
    center: np.ndarray,
    friction_pusher: np.ndarray,
    poses: np.ndarray,
    velocities: np.ndarray,
    hessians: np.ndarray,
    first: np.ndarray,
    normal: np.ndarray,
    flat: np.ndarray,
) -> int:
    """Return steps of W objects; arrays of `Sliding` as there, all C order.

    Args:
        outlines: (P, E, 2), m, as in `PlanarBody`.
        path: (T + 1, 2), middles of the pusher, m, world.
        radius: Radius of the pusher, m.
        time_step: s.
        mass, inertia, arm, load, center, friction_pusher: Fields of `Sliding`.
        poses: (T + 1, W, 3), of the centre of mass; row 0 is the start, the others are received.
        velocities: (T + 1, W, 3), m/s and rad/s, axes of the world; likewise.
        hessians: (T, W, 3, 3), receives the derivative of the residual by the velocity, axes of the object.
        first: (T, W, K, 2), receives nearest corners, or first corners of nearest edges, m, frame Q.
        normal: (T, W, K, 2), receives unit normals of these edges.
        flat: (T, W, K), receives whether it is the edge that is nearest.

    Returns:
        -1, or the index of a world with a step that did not converge.
    """
    W, T, K = len(mass), len(path) - 1, first.shape[2]
    at = np.empty(9)
    gaps, points = np.empty(K), np.empty((K, 4))
    V, way, base, before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for w in range(W):
        px, py = center[w, 0], center[w, 1]
        gyration = math.sqrt(inertia[w] / mass[w])
        body = (mass[w], inertia[w], friction_pusher[w])
        for k in range(T):
            x, y, yaw = poses[k, w, 0], poses[k, w, 1], poses[k, w, 2]
            c, s = math.cos(yaw), math.sin(yaw)
            dx, dy = path[k, 0] - x, path[k, 1] - y
            mx, my = c * dx + s * dy + px, c * dy - s * dx + py
            nearest(outlines, mx, my, gaps, first[k, w], normal[k, w], flat[k, w])
            for i in range(K):
                fx, fy = mx - first[k, w, i, 0], my - first[k, w, i, 1]
                nx, ny = normal[k, w, i, 0], normal[k, w, i, 1]
                if not flat[k, w, i]:
                    nx, ny = fx / gaps[i], fy / gaps[i]
                points[i, 0], points[i, 1] = nx, ny
                points[i, 2], points[i, 3] = mx - gaps[i] * nx - px, my - gaps[i] * ny - py
                gaps[i] -= radius
            dx, dy = (path[k + 1, 0] - path[k, 0]) / time_step, (path[k + 1, 1] - path[k, 1]) / time_step
            vx, vy = c * dx + s * dy, c * dy - s * dx
            dx, dy = velocities[k, w, 0], velocities[k, w, 1]
            before[0], before[1], before[2] = c * dx + s * dy, c * dy - s * dx, velocities[k, w, 2]
            V[:] = before
            base[:] = before
            terms(V, before, body, arm[w], load[w], gaps, points, vx, vy, time_step, at)
            done = False
            for _ in range(_ITERATIONS):
                descend(at, way)
                if max(abs(way[0]), abs(way[1]), abs(way[2]) * gyration) < _EXACT:
                    done = True
                    break
                # Along the way the slope grows from below zero: to the whole way, or to where it is zero.
                begin = at[0] * way[0] + at[1] * way[1] + at[2] * way[2]
                low, high, low_slope, high_slope, share = 0.0, 1.0, begin, 0.0, 1.0
                for trial in range(_TRIALS):
                    for i in range(3):
                        V[i] = base[i] + share * way[i]
                    terms(V, before, body, arm[w], load[w], gaps, points, vx, vy, time_step, at)
                    slope = at[0] * way[0] + at[1] * way[1] + at[2] * way[2]
                    if (trial == 0 and slope <= 0.0) or abs(slope) <= -_LEVEL * begin:
                        break
                    if slope < 0.0:
                        low, low_slope = share, slope
                    else:
                        high, high_slope = share, slope
                    share = (low * high_slope - high * low_slope) / (high_slope - low_slope)
                    if trial % 2 == 1:
                        share = 0.5 * (low + high)
                base[:] = V
            if not done:
                return w
            for i in range(3):
                V[i] += way[i]
            h = hessians[k, w]
            h[0, 0], h[1, 1], h[2, 2] = at[3], at[6], at[8]
            h[0, 1] = h[1, 0] = at[4]
            h[0, 2] = h[2, 0] = at[5]
            h[1, 2] = h[2, 1] = at[7]
            velocities[k + 1, w, 0], velocities[k + 1, w, 1] = c * V[0] - s * V[1], s * V[0] + c * V[1]
            velocities[k + 1, w, 2] = V[2]
            for i in range(3):
                poses[k + 1, w, i] = poses[k, w, i] + time_step * velocities[k + 1, w, i]
    return -1


@kernel
def terms(
    V: np.ndarray,
    before: np.ndarray,
    body: tuple[float, float, float],
    arm: np.ndarray,
    load: np.ndarray,
    gaps: np.ndarray,
    points: np.ndarray,
    vx: float,
    vy: float,
    time_step: float,
    out: np.ndarray,
) -> None:
    """Write gradient and upper rows of the Hessian of a step's function at the velocity V to out (9,).

    Args:
        V, before: (3,), velocities at the step's end and beginning, axes of the object.
        body: Mass, inertia, and friction of the pusher.
        arm: (C, 2), cells from the centre of mass, m.
        load: (C,), friction at full slip, N.
        gaps: (K,), m.
        points: (K, 4), normal, and point from the centre of mass [m].
        vx, vy: Velocity of the pusher, m/s, axes of the object.
        time_step: s.
        out: Receives the result.
    """
    mass, inertia, friction = body
    a, b, r = V[0] - before[0], V[1] - before[1], V[2] - before[2]
    g0, g1, g2 = mass * a, mass * b, inertia * r
    h00, h01, h02, h11, h12, h22 = mass, 0.0, 0.0, mass, 0.0, inertia
    for i in range(len(load)):
        x, y = arm[i, 0], arm[i, 1]
        u, w = V[0] - V[2] * y, V[1] + V[2] * x
        slip = math.sqrt(u * u + w * w + CREEP * CREEP)
        k = time_step * load[i] / slip
        turn, bend = x * w - y * u, k / (slip * slip)
        g0, g1, g2 = g0 + k * u, g1 + k * w, g2 + k * turn
        h00, h01, h02 = h00 + k - bend * u * u, h01 - bend * u * w, h02 - k * y - bend * u * turn
        h11, h12 = h11 + k - bend * w * w, h12 + k * x - bend * w * turn
        h22 += k * (x * x + y * y) - bend * turn * turn
    R = COMPLIANCE / mass
    for i in range(len(gaps)):
        nx, ny, x, y = points[i, 0], points[i, 1], points[i, 2], points[i, 3]
        turn_n, turn_t = x * ny - y * nx, x * nx + y * ny
        # Velocities at which the pusher parts from the object, and slides along it to the left of the normal.
        part = nx * (vx - V[0]) + ny * (vy - V[1]) - turn_n * V[2]
        along = nx * (vy - V[1]) - ny * (vx - V[0]) - turn_t * V[2]
        y_n, y_t = (-max(gaps[i] / time_step, -PARTING) - part) / R, -along / R
        size = abs(y_t)
        if y_n <= -friction * size:
            continue
        # Sticking, the impulses are (y_n, y_t); sliding, they are on the edge of the cone.
        e, f, stiff_n, stiff_t = y_n, y_t, 1.0 / R, 1.0 / R
        if size > friction * y_n:
            mu = math.copysign(friction, y_t)
            e = (y_n + friction * size) / (1.0 + friction * friction)
            f = mu * e
            stiff_n, stiff_t = 1.0 / (R * (1.0 + friction * friction)), 0.0
            edge0, edge1, edge2 = nx - mu * ny, ny + mu * nx, turn_n + mu * turn_t
        else:
            edge0, edge1, edge2 = nx, ny, turn_n
        g0, g1, g2 = g0 + e * nx - f * ny, g1 + e * ny + f * nx, g2 + e * turn_n + f * turn_t
        h00, h01 = h00 + stiff_n * edge0 * edge0 + stiff_t * ny * ny, h01 + stiff_n * edge0 * edge1 - stiff_t * ny * nx
        h02, h11 = h02 + stiff_n * edge0 * edge2 - stiff_t * ny * turn_t, h11 + stiff_n * edge1 * edge1
        h11, h12 = h11 + stiff_t * nx * nx, h12 + stiff_n * edge1 * edge2 + stiff_t * nx * turn_t
        h22 += stiff_n * edge2 * edge2 + stiff_t * turn_t * turn_t
    out[0], out[1], out[2] = g0, g1, g2
    out[3], out[4], out[5], out[6], out[7], out[8] = h00, h01, h02, h11, h12, h22


@kernel
def descend(at: np.ndarray, way: np.ndarray) -> None:
    """Write the Newton step to way (3,), from derivatives (9,) as `terms` writes them, by a Cholesky factor."""
    a = math.sqrt(at[3])
    b, c = at[4] / a, at[5] / a
    d = math.sqrt(at[6] - b * b)
    e = (at[7] - b * c) / d
    f = math.sqrt(at[8] - c * c - e * e)
    u = -at[0] / a
    v = (-at[1] - b * u) / d
    way[2] = (-at[2] - c * u - e * v) / (f * f)
    way[1] = (v - e * way[2]) / d
    way[0] = (u - b * way[1] - c * way[2]) / a


@kernel
def nearest(
    outlines: np.ndarray,
    mx: float,
    my: float,
    distances: np.ndarray,
    first: np.ndarray,
    normal: np.ndarray,
    flat: np.ndarray,
) -> None:
    """Find the features of the K nearest outlines.

    Args:
        outlines: (P, E, 2), m, P at least K.
        mx, my: Middle of the pusher, m, frame Q.
        distances: (K,), receives distances, m, negative inside, the nearest first.
        first: (K, 2), receives corners.
        normal: (K, 2), receives normals.
        flat: (K,), receives whether an edge is nearest.
    """
    K, E = len(distances), outlines.shape[1]
    distances[:] = math.inf
    for piece in range(len(outlines)):
        deepest, edge, square, corner, inner = -math.inf, 0, math.inf, 0, False
        for i in range(E):
            j = (i + 1) % E
            x, y = outlines[piece, i, 0], outlines[piece, i, 1]
            u, v = outlines[piece, j, 0] - x, outlines[piece, j, 1] - y
            length = math.sqrt(u * u + v * v)
            if length < _SMALLEST:
                continue
            a, b = mx - x, my - y
            plane = (a * v - b * u) / length
            if plane > deepest:
                deepest, edge = plane, i
            along = a * u + b * v
            if along <= 0.0:
                away, at, within = a * a + b * b, i, False
            elif along >= length * length:
                away, at, within = (a - u) ** 2 + (b - v) ** 2, j, False
            else:
                away, at, within = plane * plane, i, True
            if away < square:
                square, corner, inner = away, at, within
        distance = math.sqrt(square)
        if deepest <= 0.0:
            distance, corner, inner = deepest, edge, True
        place = K
        while place > 0 and distance < distances[place - 1]:
            place -= 1
        if place == K:
            continue
        for i in range(K - 1, place, -1):
            distances[i], flat[i] = distances[i - 1], flat[i - 1]
            for axis in range(2):
                first[i, axis], normal[i, axis] = first[i - 1, axis], normal[i - 1, axis]
        j = (corner + 1) % E
        u, v = outlines[piece, j, 0] - outlines[piece, corner, 0], outlines[piece, j, 1] - outlines[piece, corner, 1]
        length = max(math.sqrt(u * u + v * v), _SMALLEST)
        distances[place], flat[place] = distance, inner
        first[place, 0], first[place, 1] = outlines[piece, corner, 0], outlines[piece, corner, 1]
        normal[place, 0], normal[place, 1] = v / length, -u / length
