# SPDX-License-Identifier: MIT
"""Spherical harmonics of one direction, and the derivative of their sum (numba)."""

import numpy as np

from pinwm_drake.jit import kernel
from pinwm_drake.rendering import harmonics as constants

Y0 = np.float32(constants.Y0)
_Y1 = np.float32(constants.Y1)
_A0, _A1, _A2, _A3, _A4 = (np.float32(value) for value in constants.Y2)
_B0, _B1, _B2, _B3, _B4, _B5, _B6 = (np.float32(value) for value in constants.Y3)
MOST_BASIS = 16
_2, _3, _4, _6, _8 = (np.float32(value) for value in (2, 3, 4, 6, 8))


@kernel
def fill_basis(x, y, z, number, basis):
    """Return the first `number` (1, 4, 9 or 16) basis functions at the unit vector (x, y, z)."""
    basis[0] = Y0
    if number > 1:
        basis[1], basis[2], basis[3] = -_Y1 * y, _Y1 * z, -_Y1 * x
    if number > 4:
        basis[4] = _A0 * x * y
        basis[5] = _A1 * y * z
        basis[6] = _A2 * (_2 * z * z - x * x - y * y)
        basis[7] = _A3 * x * z
        basis[8] = _A4 * (x * x - y * y)
    if number > 9:
        basis[9] = _B0 * y * (_3 * x * x - y * y)
        basis[10] = _B1 * x * y * z
        basis[11] = _B2 * y * (_4 * z * z - x * x - y * y)
        basis[12] = _B3 * z * (_2 * z * z - _3 * x * x - _3 * y * y)
        basis[13] = _B4 * x * (_4 * z * z - x * x - y * y)
        basis[14] = _B5 * z * (x * x - y * y)
        basis[15] = _B6 * x * (x * x - _3 * y * y)


@kernel
def basis_gradient(x, y, z, number, s):
    """Gradient of sum_k s_k Y_k with respect to (x, y, z), which are taken as independent."""
    gx, gy, gz = x * np.float32(0.0), y * np.float32(0.0), z * np.float32(0.0)
    if number > 1:
        gx -= _Y1 * s[3]
        gy -= _Y1 * s[1]
        gz += _Y1 * s[2]
    if number > 4:
        gx += _A0 * y * s[4] - _2 * _A2 * x * s[6] + _A3 * z * s[7] + _2 * _A4 * x * s[8]
        gy += _A0 * x * s[4] + _A1 * z * s[5] - _2 * _A2 * y * s[6] - _2 * _A4 * y * s[8]
        gz += _A1 * y * s[5] + _4 * _A2 * z * s[6] + _A3 * x * s[7]
    if number > 9:
        gx += _6 * _B0 * x * y * s[9] + _B1 * y * z * s[10] - _2 * _B2 * x * y * s[11] - _6 * _B3 * x * z * s[12]
        gx += _B4 * (_4 * z * z - _3 * x * x - y * y) * s[13] + _2 * _B5 * x * z * s[14]
        gx += _3 * _B6 * (x * x - y * y) * s[15]
        gy += _3 * _B0 * (x * x - y * y) * s[9] + _B1 * x * z * s[10] + _B2 * (_4 * z * z - x * x - _3 * y * y) * s[11]
        gy -= _6 * _B3 * y * z * s[12] + _2 * _B4 * x * y * s[13] + _2 * _B5 * y * z * s[14] + _6 * _B6 * x * y * s[15]
        gz += _B1 * x * y * s[10] + _8 * _B2 * y * z * s[11] + _3 * _B3 * (_2 * z * z - x * x - y * y) * s[12]
        gz += _8 * _B4 * x * z * s[13] + _B5 * (x * x - y * y) * s[14]
    return gx, gy, gz
