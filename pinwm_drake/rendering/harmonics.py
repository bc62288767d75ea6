# SPDX-License-Identifier: MIT
"""Real spherical harmonics as 3D Gaussian Splatting orders and signs them."""

import torch
from torch import Tensor

Y0 = 0.28209479177387814
Y1 = 0.4886025119029199
Y2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
Y3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def harmonics(directions: Tensor, degree: int) -> Tensor:
    """Basis functions of the spherical harmonics at unit vectors.

    Args:
        directions: (..., 3), unit.
        degree: 0 to 3.

    Returns:
        (..., (degree + 1)^2).
    """
    x, y, z = directions.unbind(-1)
    basis = [torch.full_like(x, Y0)]
    if degree > 0:
        basis += [-Y1 * y, Y1 * z, -Y1 * x]
    if degree > 1:
        basis += [
            Y2[0] * x * y,
            Y2[1] * y * z,
            Y2[2] * (2.0 * z * z - x * x - y * y),
            Y2[3] * x * z,
            Y2[4] * (x * x - y * y),
        ]
    if degree > 2:
        basis += [
            Y3[0] * y * (3.0 * x * x - y * y),
            Y3[1] * x * y * z,
            Y3[2] * y * (4.0 * z * z - x * x - y * y),
            Y3[3] * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y),
            Y3[4] * x * (4.0 * z * z - x * x - y * y),
            Y3[5] * z * (x * x - y * y),
            Y3[6] * x * (x * x - 3.0 * y * y),
        ]
    return torch.stack(basis, -1)
