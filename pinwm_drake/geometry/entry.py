"""The kernels of contact geometry as Python calls them: each is compiled with all that it calls (numba).

The kernels themselves have no machine code of their own; they are parts of the steps that use them (see `jit`).
"""

from pinwm_drake.geometry import features
from pinwm_drake.geometry.contact import narrowphase
from pinwm_drake.jit import entry_point

_bodies, _floor = narrowphase.collide_bodies, narrowphase.collide_floor
_from_features, _adjoint = features.contact_from_features, features.contact_adjoint
_tangents, _tangents_adjoint = features.tangents, features.tangents_adjoint


@entry_point
def collide_bodies(table, body_A, R_WA, p_WA, body_B, R_WB, p_WB, margin, rows, count):
    """Contacts of two bodies; see `narrowphase.collide_bodies`."""
    return _bodies(table, body_A, R_WA, p_WA, body_B, R_WB, p_WB, margin, rows, count)


@entry_point
def collide_floor(table, body, spread, R_WB, p_WB, floor_height, margin, rows, count):
    """Contacts of a body with the floor; see `floor.collide_floor`."""
    return _floor(table, body, spread, R_WB, p_WB, floor_height, margin, rows, count)


@entry_point
def contact_from_features(row, R_A, p_A, R_B, p_B, n, a, b):
    """Gap, normal and witness points of a feature pair; see `features.contact_from_features`."""
    return _from_features(row, R_A, p_A, R_B, p_B, n, a, b)


@entry_point
def contact_adjoint(row, R_A, p_A, R_B, p_B, n, a, b, phi, nbar, cbar, phibar, twist_A, twist_B):
    """Adjoint of a contact; see `features.contact_adjoint`."""
    _adjoint(row, R_A, p_A, R_B, p_B, n, a, b, phi, nbar, cbar, phibar, twist_A, twist_B)


@entry_point
def tangents(nx, ny, nz):
    """Tangents of a normal; see `features.tangents`."""
    return _tangents(nx, ny, nz)


@entry_point
def tangents_adjoint(nx, ny, nz, t1, t1bar, t2bar):
    """Adjoint of the tangents; see `features.tangents_adjoint`."""
    return _tangents_adjoint(nx, ny, nz, t1, t1bar, t2bar)
