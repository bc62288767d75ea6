# SPDX-License-Identifier: MIT
import pytest
import torch

from pinwm_drake.identification.discrepancy import LASTING, Marginal, prior_root
from pinwm_drake.spatial.poses import Pose

RADIUS, WALK = 0.05, 8e-3


def straight(n):
    """Poses that move by 0.1 m along x, and their times."""
    p = torch.zeros(n, 3, dtype=torch.float64)
    p[:, 0] = torch.linspace(0.0, 0.1, n, dtype=torch.float64)
    return Pose(torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(n, 4), p), torch.arange(n) * 0.1


def test_corrections_walk_with_the_way():
    X_WO, times = straight(5)
    root = prior_root(X_WO, times, RADIUS, WALK)
    variance = (root @ root.T).diagonal().reshape(5, 6)
    made = X_WO.p[:, 0]
    expected = WALK**2 * made + LASTING**2
    assert variance[:, 3].numpy() == pytest.approx(expected.numpy(), rel=1e-4)
    assert variance[:, 2].numpy() == pytest.approx(expected.numpy() / RADIUS**2, rel=1e-4)
    turning = prior_root(X_WO, times, RADIUS, WALK, 2.0)
    variance = (turning @ turning.T).diagonal().reshape(5, 6)
    assert variance[:, 3].numpy() == pytest.approx(expected.numpy(), rel=1e-4)
    rim = 4.0 * WALK**2 * made + LASTING**2
    assert variance[:, 2].numpy() == pytest.approx(rim.numpy() / RADIUS**2, rel=1e-4)


def images(n, sigma, seed):
    """Gradient (n, 7) and curvature (n, 7, 7) of images that tell each coordinate of a pose to `sigma`."""
    generator = torch.Generator().manual_seed(seed)
    scale = torch.tensor([1.0 / RADIUS] * 3 + [1.0] * 3 + [1.0], dtype=torch.float64) * sigma
    mixed = torch.eye(7, dtype=torch.float64) + 0.2 * torch.rand(7, 7, generator=generator, dtype=torch.float64)
    H = torch.diag(1.0 / scale) @ mixed @ mixed.T @ torch.diag(1.0 / scale)
    d = scale * torch.randn(n, 7, generator=generator, dtype=torch.float64)
    return d @ H, H.expand(n, 7, 7)


def test_corrections_are_integrated_out():
    # Against the joint Gaussian of images and corrections, whose determinant is another way to the same number.
    n = 3
    X_WO, times = straight(n)
    gradient, curvature = images(n, 1e-3, 0)
    prior = prior_root(X_WO, times, RADIUS, WALK)
    found = Marginal.of(gradient, curvature, prior)
    K = prior @ prior.T
    H, g = torch.block_diag(*curvature[:, :6, :6]), gradient[:, :6].reshape(-1)

    def direct(u):
        # -log of the integral of exp(-(u + e)' H (u + e) / 2 - g' (u + e)) N(e; 0, K) over e.
        total = H + torch.linalg.inv(K)
        b = H @ u + g
        quadratic = 0.5 * u @ H @ u + g @ u - 0.5 * b @ torch.linalg.solve(total, b)
        return quadratic + 0.5 * (torch.logdet(total) + torch.logdet(K))

    generator = torch.Generator().manual_seed(1)
    u = 1e-3 * torch.randn(4, 6 * n + 1, generator=generator, dtype=torch.float64)
    u[:, -1] = 0.0
    expected = [float(direct(row[:-1])) for row in u]
    assert found.loss(u).tolist() == pytest.approx(expected, rel=1e-6)


def test_the_likelier_drift_is_the_one_that_was_drawn():
    n = 30
    X_WO, times = straight(n)
    curvature = torch.diag(torch.tensor([1.0 / (2e-4 / RADIUS) ** 2] * 3 + [1.0 / 2e-4**2] * 3 + [1.0]).double())
    curvature = curvature.expand(n, 7, 7)
    walks = (5e-3, 1e-2, 2e-2)
    priors = [prior_root(X_WO, times, RADIUS, walk) for walk in walks]
    hits = 0
    for seed, truth in enumerate(priors * 4):
        generator = torch.Generator().manual_seed(seed)
        e = truth @ torch.randn(6 * n, generator=generator, dtype=torch.float64)
        # The images are quadratic about the true poses, which are away from the model's by e.
        g = -torch.einsum("nij,nj->ni", curvature[:, :6, :6], e.reshape(n, 6))
        gradient = torch.cat([g, torch.zeros(n, 1, dtype=torch.float64)], -1)
        losses = [float(Marginal.of(gradient, curvature, p).loss(torch.zeros(1, 6 * n + 1).double())) for p in priors]
        hits += losses.index(min(losses)) == seed % 3
    assert hits >= 11
