# SPDX-License-Identifier: MIT
"""Light of a video against that of the static views in which the surfels were fitted.

Cameras expose and balance each video anew, and see faces in another light. What a diffuse surface sends out is smooth
in the direction that it faces, so that each colour of a surfel gets a gain that is a low harmonic of its normal,

    c_i' = c_i g(n_i),   g(n) = sum_k b_k Y_k(n),

with the b_k of least squares where rendering and picture both show nothing but the object, and a ridge around g = 1.

Source: Ramamoorthi and Hanrahan, "An efficient representation for irradiance environment maps", SIGGRAPH 2001.
"""

from dataclasses import replace

import torch
from torch import Tensor

from pinwm_drake.identification.image_loss import rendered
from pinwm_drake.identification.pictures import Pictures, spaced
from pinwm_drake.rendering.harmonics import Y0, harmonics
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import rotate

# Opacity of what is all object, and the fewest such pixels that tell its light.
_OPAQUE, _FEWEST = 0.98, 100
_DEGREE = 2
# Weight of the ridge, as a share of the pixels', and the range of gains.
_RIDGE, _LEAST, _MOST = 0.01, 0.2, 4.0
# Frames that are looked at.
FRAMES = 6


@torch.no_grad()
def lit(pictures: Pictures, surfels: Surfels, X_WO: Pose, *, num_threads: int | None = None) -> Surfels:
    """Surfels in the light of pictures.

    Args:
        pictures: n frames; of many, `FRAMES` are looked at.
        surfels: The object's appearance in the static views, frame O.
        X_WO: Poses of the object in the frames, q (n, 4), p (n, 3) [m].
        num_threads: Threads of the renderer.

    Returns:
        The surfels with other harmonics; as they are where too little of the object is seen.
    """
    chosen = spaced(len(X_WO.p), FRAMES)
    pictures, X = pictures.some(chosen), Pose(X_WO.q[chosen, None], X_WO.p[chosen, None])
    basis = harmonics(_normals(surfels), _DEGREE).to(surfels.sh) / Y0
    one = torch.ones(1, dtype=torch.float64)
    shown = [
        rendered(pictures, brightened(surfels, basis[:, k, None]), X, one, num_threads=num_threads)
        for k in range(basis.shape[1])
    ]
    alpha = shown[0].alpha[:, 0]
    both = (alpha > _OPAQUE) & (pictures.alpha > _OPAQUE) & (pictures.weight > 0.0)
    if int(both.sum()) < _FEWEST:
        return surfels
    # Of a pixel that is not quite covered, the background's share is the same in all of the renderings.
    white = (1.0 - alpha[both]).double()[:, None]
    images = torch.stack([part.color[:, 0][both].double() - white for part in shown], -1)
    wanted = pictures.color[both].double() - white
    gains = []
    for channel in range(3):
        A, b = images[:, channel], wanted[:, channel]
        H = A.T @ A
        # About g = 1, which is the first function alone.
        ridge = _RIDGE * H[0, 0].clamp_min(1e-9) * torch.eye(len(H), dtype=torch.float64)
        start = torch.eye(len(H), dtype=torch.float64)[0]
        gains.append(start + torch.linalg.solve(H + ridge, A.T @ (b - A @ start)))
    gain = (basis.double() @ torch.stack(gains, -1)).clamp(_LEAST, _MOST)
    return brightened(surfels, gain)


def brightened(surfels: Surfels, gain: Tensor) -> Surfels:
    """Surfels whose colours are multiplied by gains (N, 1) or (N, 3)."""
    gain = gain.to(surfels.sh)
    sh = surfels.sh * gain[:, None]
    # A colour is one half and its harmonics.
    sh[:, 0] += 0.5 * (gain - 1.0) / Y0
    return replace(surfels, sh=sh)


def _normals(surfels: Surfels) -> Tensor:
    """Return normals (N, 3), unit, frame O, that point away from the middle of the surfels."""
    q = surfels.q_OS.double()
    z = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    n = rotate(q / q.norm(dim=-1, keepdim=True), z.expand(len(q), 3))
    away = surfels.p_OS.double() - surfels.p_OS.double().mean(0)
    return torch.where((n * away).sum(-1, keepdim=True) < 0.0, -n, n)
