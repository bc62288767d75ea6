"""Capsules and hulls against a cylinder (numba)."""

import math

from pinwm_drake.geometry.contact.cylinder_axis import (
    EDGE_RIM,
    EDGE_SIDE,
    FACE_RIM,
    VERTEX_CAP,
    cylinder_axis,
    write_pair,
)
from pinwm_drake.geometry.contact.cylinder_manifold import cap_on_face, segment_along_side, segment_on_cap, side_on_face
from pinwm_drake.geometry.contact.cylinder_parts import radial
from pinwm_drake.geometry.contact.face_clip import DEEPER, MANIFOLD_ANGLE, outside_face
from pinwm_drake.geometry.contact.manifold import aligned_face
from pinwm_drake.geometry.contact.segments import SAME
from pinwm_drake.geometry.pieces import HULL
from pinwm_drake.geometry.rows import dot, inverse_pose, norm, transform, turn, turn_back, xyz
from pinwm_drake.jit import internal_kernel


@internal_kernel
def collide_with_cylinder(table, one, two, X_21, column, margin, rows, count):
    """Appends the contacts of a capsule or hull with a cylinder; arguments of `segments.collide_rounds`."""
    i = table.pieces[one, 1]
    radius = table.vertices[i, 3]
    if table.pieces[one, 0] == HULL:
        face, apart = _best_face(table, one, two, X_21)
        if apart >= margin:
            return count
        # Mostly the contact is on a face, and is then known without a search.
        nx, ny, nz = turn(X_21, *xyz(table.planes, face))
        more, nearest = _on_face(
            table, one, two, X_21, -nx, -ny, -nz, face, apart - DEEPER, column, margin, rows, count
        )
        if nearest <= apart + SAME and (apart >= 0.0 or _holds(table, one, two, X_21, face, apart)):
            return more
    apart, nx, ny, nz, pair, first, second, end = cylinder_axis(table, one, two, X_21, margin + radius)
    apart -= radius
    if apart >= margin:
        return count
    least, nearest, on_face = apart - DEEPER, math.inf, False
    if table.pieces[one, 0] == HULL:
        mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
        face, cosine = aligned_face(table, one, mx, my, mz)
        if pair == FACE_RIM:
            face, cosine = first, 1.0
        if cosine >= math.cos(MANIFOLD_ANGLE):
            before = count
            count, nearest = _on_face(table, one, two, X_21, nx, ny, nz, face, least, column, margin, rows, count)
            on_face = count > before
    if not on_face and pair != FACE_RIM and pair != EDGE_RIM:
        v, w = first, second
        if pair != EDGE_SIDE:
            v, w = _edge_at(table, one, two, X_21, first, pair == VERTEX_CAP)
        if v != w:
            if pair == VERTEX_CAP:
                count, nearest = segment_on_cap(
                    table, v, w, two, X_21, nx, ny, nz, end, least, column, margin, rows, count
                )
            elif _along(table, two, X_21, v, w, False) < MANIFOLD_ANGLE:
                count, nearest = segment_along_side(
                    table, v, w, two, X_21, nx, ny, nz, least, column, margin, rows, count
                )
    if apart < nearest - SAME and count < rows.shape[0]:
        write_pair(table, one, two, X_21, nx, ny, nz, pair, first, second, end, rows, count, column)
        count += 1
    return count


@internal_kernel
def _best_face(table, one, two, X_21):
    """The face of a hull along whose normal a cylinder is separated most, and that separation [m]."""
    X_12 = inverse_pose(X_21)
    ux, uy, uz = turn(X_12, *xyz(table.axes, two))
    cx, cy, cz = transform(X_12, *xyz(table.piece_spheres, two))
    half, radius = 0.5 * table.axes[two, 3], table.vertices[table.pieces[two, 1], 3]
    best, apart = -1, -math.inf
    for f in range(table.pieces[one, 2], table.pieces[one + 1, 2]):
        nx, ny, nz = xyz(table.planes, f)
        along = dot(nx, ny, nz, ux, uy, uz)
        across = math.sqrt(max(1.0 - along * along, 0.0))
        d = dot(nx, ny, nz, cx, cy, cz) - table.planes[f, 3] - half * abs(along) - radius * across
        if d > apart + SAME:
            best, apart = f, d
    return best, apart


@internal_kernel
def _holds(table, one, two, X_21, face, apart):
    """Flag: the least translation out of a slight penetration is along a face's normal, for certain.

    The Minkowski difference has a facet over this face. Where the facet extends by R about the point below
    which the origin lies at depth d, no direction within 168 degrees of the normal leads out sooner if R >=
    10 d; and none of the others does if the middles of the pieces are far enough apart against the normal.
    """
    X_12 = inverse_pose(X_21)
    j = table.pieces[two, 1]
    nx, ny, nz = xyz(table.planes, face)
    ux, uy, uz = turn(X_12, *xyz(table.axes, two))
    ex, ey, ez, across = radial(ux, uy, uz, -nx, -ny, -nz)
    along = dot(nx, ny, nz, ux, uy, uz)
    # The lowest point; on a line of contact the point of it nearest to the middle of the face.
    lower = j + 1 if along < 0.0 else j
    x, y, z = transform(X_12, *xyz(table.vertices, lower))
    radius = table.vertices[j, 3]
    if across > 0.0:
        x, y, z = x + radius * ex, y + radius * ey, z + radius * ez
    mx, my, mz = xyz(table.piece_spheres, one)
    if abs(along) * table.axes[two, 3] < SAME:
        t = dot(mx - x, my - y, mz - z, ux, uy, uz)
        t = min(max(t, 0.0), table.axes[two, 3]) if along >= 0.0 else min(max(t, -table.axes[two, 3]), 0.0)
        x, y, z = x + t * ux, y + t * uy, z + t * uz
    if outside_face(table, face, x, y, z) > 10.0 * apart:
        return False
    cx, cy, cz = transform(X_12, *xyz(table.piece_spheres, two))
    dx, dy, dz = cx - mx, cy - my, cz - mz
    over = dot(nx, ny, nz, dx, dy, dz)
    beside = norm(dx - over * nx, dy - over * ny, dz - over * nz)
    return 0.98 * over - 0.2 * beside >= -apart


@internal_kernel
def _on_face(table, one, two, X_21, kx, ky, kz, face, least, column, margin, rows, count):
    """Appends the manifold of a cylinder on a face where its side or cap is nearly parallel to it."""
    nx, ny, nz = turn(X_21, *xyz(table.planes, face))
    ux, uy, uz = xyz(table.axes, two)
    along = dot(nx, ny, nz, ux, uy, uz)
    if abs(along) < MANIFOLD_ANGLE:
        return side_on_face(table, one, two, X_21, kx, ky, kz, face, least, column, margin, rows, count)
    if abs(along) > math.cos(MANIFOLD_ANGLE):
        end = 1 if along < 0.0 else 0
        return cap_on_face(table, one, two, X_21, kx, ky, kz, face, end, least, column, margin, rows, count)
    return count, math.inf


@internal_kernel
def _along(table, two, X_21, v, w, across):
    """Sine of the angle between the edge from v to w and the axis of a cylinder, or its cosine (`across`)."""
    px, py, pz = turn(X_21, *xyz(table.vertices, v))
    dx, dy, dz = turn(X_21, *xyz(table.vertices, w))
    ux, uy, uz = xyz(table.axes, two)
    dx, dy, dz = dx - px, dy - py, dz - pz
    _, _, _, sine = radial(ux, uy, uz, dx, dy, dz)
    length = norm(dx, dy, dz)
    return abs(dot(ux, uy, uz, dx, dy, dz)) / length if across else sine / length


@internal_kernel
def _edge_at(table, one, two, X_21, v, across):
    """Edge at vertex v that runs along a cylinder, or `across` its axis, within MANIFOLD_ANGLE; else v twice."""
    if table.pieces[one, 0] != HULL:
        i = table.pieces[one, 1]
        return (i, i + 1) if _along(table, two, X_21, i, i + 1, across) < MANIFOLD_ANGLE else (v, v)
    best, w = MANIFOLD_ANGLE, v
    for e in range(table.pieces[one, 3], table.pieces[one + 1, 3]):
        a, b = table.edges[e, 0], table.edges[e, 1]
        if a == v or b == v:
            angle = _along(table, two, X_21, a, b, across)
            if angle < best - SAME:
                best, w = angle, a + b - v
    return min(v, w), max(v, w)
