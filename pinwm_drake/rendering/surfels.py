# SPDX-License-Identifier: MIT
"""The surfels of one object: its appearance alpha, as 2D Gaussian Splatting describes it.

Source: Huang et al., "2D Gaussian Splatting for Geometrically Accurate Radiance Fields", SIGGRAPH 2024, section 4;
Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023, for the spherical harmonics.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import RenderingError

MAX_DEGREE = 3
_BANDS = tuple((degree + 1) ** 2 for degree in range(MAX_DEGREE + 1))

Shaped = Tensor | np.ndarray


@dataclass(frozen=True, eq=False)
class Surfels:
    """N surfels in the frame O of their object, with which they move; all float32, one device.

    Surfel S is an elliptic Gaussian exp(-(u^2 + v^2) / 2) in the plane through its centre that its tangents x and y
    span; u and v count in its two scales. Its colour towards a camera is max(0, 1/2 + sum_k Y_k(d) sh_k), d being the
    unit vector from the camera to the centre, in O. So the harmonics turn with the object.

    Attributes:
        p_OS: (N, 3), centres, m.
        q_OS: (N, 4), orientations wxyz, of any length but 0.
        log_scale: (N, 2), logarithms of the two scales in m.
        logit_opacity: (N,), logits of the opacities.
        sh: (N, K, 3) or, for V views with colours of their own, (V, N, K, 3): harmonics of red, green and blue;
            K = (degree + 1)^2, degree 0 to 3.
    """

    p_OS: Tensor
    q_OS: Tensor
    log_scale: Tensor
    logit_opacity: Tensor
    sh: Tensor

    @property
    def num_surfels(self) -> int:
        """Number of surfels N."""
        return int(self.p_OS.shape[0])

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return round(self.sh.shape[-2] ** 0.5) - 1

    def tensors(self) -> dict[str, Tensor]:
        """Return the five tensors by their names."""
        return dict(vars(self))

    def check_shapes(self) -> None:
        """Raise RenderingError unless shapes and types fit; name the first tensor that does not."""
        tensors = self.tensors()
        require_shapes(*tensors.values())
        for name, value in tensors.items():
            if not value.dtype.is_floating_point:
                raise RenderingError(f"{name} is {value.dtype}; allowed: torch.float32")

    def check(self) -> None:
        """Raise RenderingError unless shapes, types and values fit; name the first bad entry."""
        self.check_shapes()
        for name, value in self.tensors().items():
            finite = torch.isfinite(value.detach())
            if not bool(finite.all()):
                index = tuple(int(i) for i in torch.nonzero(~finite)[0])
                raise RenderingError(f"{name}{list(index)} is {float(value[index])}; allowed: finite numbers")
        turned = self.q_OS.detach().norm(dim=-1) > 0.0
        if not bool(turned.all()):
            row = int(turned.int().argmin())
            raise RenderingError(f"q_OS[{row}] is zero; allowed: quaternions of any length but 0")

    def detach(self) -> "Surfels":
        """Surfels with the same numbers, cut from the graph that autograd keeps."""
        return Surfels(**{name: value.detach() for name, value in self.tensors().items()})

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> "Surfels":
        """Copy of the surfels on another device or with another float type (the torch reference takes float64)."""
        return Surfels(**{name: value.to(device=device, dtype=dtype) for name, value in self.tensors().items()})


def require_shapes(p_OS: Shaped, q_OS: Shaped, log_scale: Shaped, logit_opacity: Shaped, sh: Shaped) -> None:
    """Raise RenderingError unless the tensors or arrays of surfels have shapes that fit together."""
    N = p_OS.shape[0] if len(p_OS.shape) else 0
    for name, value, shape in (
        ("p_OS", p_OS, (N, 3)),
        ("q_OS", q_OS, (N, 4)),
        ("log_scale", log_scale, (N, 2)),
        ("logit_opacity", logit_opacity, (N,)),
    ):
        if value.shape != shape:
            raise RenderingError(f"{name} is {tuple(value.shape)}; allowed: {shape}")
    bands = sh.shape
    if len(bands) not in (3, 4) or bands[-3] != N or bands[-2] not in _BANDS or bands[-1] != 3:
        raise RenderingError(f"sh is {tuple(bands)}; allowed: ({N}, K, 3) or (V, {N}, K, 3) with K in {_BANDS}")
