# SPDX-License-Identifier: MIT
"""Discrepancy of the physics: what a real push does that no parameters of the model can make it do.

Contact laws of engines and of the world differ, and their difference lasts: it turns the object aside a little on
every millimetre of its way, so that the pose drifts away from the model's as in a random walk. A renderer's and a
segmentation's mistakes last for many frames too. So the pose in frame k is that of the model with a correction

    e ~ N(0, K),  K(k, l) = a² min(s_k, s_l) + b² exp(-|t_k - t_l| / c),

for each of its six components, s being the way that the object has made and a one of those of `twin/drift.py`: how far
an object strays is told by its own video, as far as that can. The corrections are integrated out, which leaves the
images less to say about parameters that only a long drift would tell.

Source: Kennedy and O'Hagan, "Bayesian calibration of computer models", JRSS B 63(3), 2001, section 4.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.drift import drift, per_radius, way
from pinwm_drake.twin.kicks import Kicks

# b and c: m, s.
LASTING, LASTS = 3e-4, 0.3


def prior_root(
    X_WO: Pose, times: Tensor, radius: float, walk: float, turn: float = 1.0, carried: Kicks | None = None
) -> Tensor:
    """Root of the prior of the corrections of n poses, K = root root'.

    Args:
        X_WO: The poses, q (n, 4), p (n, 3) [m].
        times: (n,), s.
        radius: Radius of the object, m.
        walk, turn: Drift of a position after a way of one metre, m, and its factor for a rim that turns.
        carried: What errors of changes of velocity make of the poses, of `kicks.carried_kicks`; None for none.

    Returns:
        (6n, 6n), lower triangular; frame by frame rotation vector [rad], then position [m].
    """
    made, n = way(X_WO, times, radius), len(times)
    common = torch.minimum(made[:, None], made[None])
    lasting = torch.exp(-(times[:, None] - times[None]).abs() / LASTS) + 1e-6 * torch.eye(n, dtype=torch.float64)
    K = torch.zeros(n, 6, n, 6, dtype=torch.float64)
    for axis, (a, b) in enumerate(zip(drift(radius, walk, turn), LASTING * per_radius(radius), strict=True)):
        K[:, axis, :, axis] = float(a) ** 2 * common + float(b) ** 2 * lasting
    K = K.reshape(6 * n, 6 * n)
    if carried is not None:
        root = carried.root(walk)
        K = K + root @ root.T
    return torch.linalg.cholesky(K)


@dataclass(frozen=True, eq=False)
class Marginal:
    """Quadratic loss of one push, u' A u / 2 + b' u + constant, with the corrections integrated out.

    Its argument u holds the deviations of the model's poses (6n) from those of an expansion, frame by frame rotation
    vector [rad] and position [m], and that of the outline's logarithm.
    """

    A: Tensor  # (6n + 1, 6n + 1)
    b: Tensor  # (6n + 1,)
    constant: float  # Loss at u = 0, which is another for each prior of the corrections
    pull: Tensor  # (6n, 6n + 1); the likeliest corrections are -(pull u + shift)
    shift: Tensor  # (6n,)

    @staticmethod
    def of(gradient: Tensor, curvature: Tensor, L: Tensor) -> "Marginal":
        """Marginal loss from the images' gradient (n, 7) and curvature (n, 7, 7), weighted, and the prior's root L."""
        n = len(gradient)
        H = torch.block_diag(*curvature[:, :6, :6])
        cross, outline = curvature[:, :6, 6].reshape(6 * n), curvature[:, 6, 6].sum()
        g = gradient[:, :6].reshape(6 * n)
        inner = torch.eye(6 * n, dtype=torch.float64) + L.T @ H @ L
        # (H + K^-1)^-1
        root = torch.linalg.cholesky(inner)
        M = L @ torch.cholesky_solve(L.T, root)
        full = torch.cat([H, cross[:, None]], -1)
        pull = M @ full
        A = torch.zeros(6 * n + 1, 6 * n + 1, dtype=torch.float64)
        A[:-1, :-1], A[:-1, -1], A[-1, :-1], A[-1, -1] = H, cross, cross, outline
        A = A - full.T @ pull
        shift = M @ g
        b = torch.cat([g, gradient[:, 6].sum()[None]]) - full.T @ shift
        # Half the logarithm of the determinant of I + H K, less what the corrections explain of the gradient.
        constant = float(root.diagonal().log().sum() - 0.5 * g @ shift)
        return Marginal(0.5 * (A + A.T), b, constant, pull, shift)

    def loss(self, u: Tensor) -> Tensor:
        """Losses (W,) of deviations u (W, 6n + 1): minus the log likelihood, up to what all priors share."""
        return 0.5 * (u * (u @ self.A)).sum(-1) + u @ self.b + self.constant

    def corrections(self, u: Tensor) -> Tensor:
        """Return the likeliest corrections (n, 6) where the model deviates by u (6n + 1,)."""
        return -(self.pull @ u + self.shift).reshape(-1, 6)
