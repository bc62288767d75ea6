# SPDX-License-Identifier: MIT
import pytest
import torch

from pinwm_drake.identification.sampling import WALKERS, sample


def drawn(objective, covariance, seed=0, moves=50, clamp=lambda z: z):
    generator = torch.Generator().manual_seed(seed)
    means = torch.zeros(1, len(covariance), dtype=torch.float64)
    return sample(objective, means, covariance[None], clamp, generator, moves=moves)


def correlated(p):
    half = torch.randn(p, p, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return half @ half.T / p + 0.1 * torch.eye(p, dtype=torch.float64)


@pytest.mark.parametrize("p", [3, 33])
@pytest.mark.parametrize("guess", [0.7, 1.0, 1.5])
def test_spread_is_that_of_a_gaussian_however_many_unknowns(p, guess):
    truth = correlated(p)
    precision = torch.linalg.inv(truth)
    z, energies = drawn(lambda z: 0.5 * (z @ precision * z).sum(-1), guess**2 * truth)
    white = z @ torch.linalg.inv(torch.linalg.cholesky(truth)).T
    assert float(white.square().mean()) == pytest.approx(1.0, rel=0.12)
    assert float(white.mean(0).square().mean()) < 0.05
    assert float(energies.mean()) == pytest.approx(p / 2, rel=0.15)


def test_a_bent_density_is_followed():
    # x is standard normal and y is x^2 but for 0.2: far from the Gaussian that it begins with.
    def objective(z):
        return 0.5 * z[:, 0].square() + 0.5 * ((z[:, 1] - z[:, 0].square()) / 0.2).square()

    z, _ = drawn(objective, torch.eye(2, dtype=torch.float64), moves=400)
    assert float(z[:, 0].mean()) == pytest.approx(0.0, abs=0.15)
    assert float(z[:, 0].std()) == pytest.approx(1.0, abs=0.12)
    assert float((z[:, 1] - z[:, 0].square()).std()) == pytest.approx(0.2, rel=0.1)


def test_modes_have_their_shares():
    # 30 % of a density that is narrow about 0, and 70 % of one that is wide about 20, in two dimensions.
    widths, shares = torch.tensor([0.2, 1.0], dtype=torch.float64), torch.tensor([0.3, 0.7], dtype=torch.float64)
    means = torch.tensor([[0.0, 0.0], [20.0, 0.0]], dtype=torch.float64)

    def objective(z):
        away = (z[:, None] - means).square().sum(-1)
        return -torch.logsumexp(shares.log() - 2.0 * widths.log() - 0.5 * away / widths.square(), -1)

    covariances = widths.square()[:, None, None] * torch.eye(2, dtype=torch.float64)
    found = []
    for seed in range(8):
        generator = torch.Generator().manual_seed(seed)
        z, _ = sample(objective, means, covariances, lambda z: z, generator, moves=50)
        near = z[:, 0] < 10.0
        found.append(float(near.double().mean()))
        assert float(z[near].std()) == pytest.approx(0.2, rel=0.15)
        assert float(z[~near, 1].std()) == pytest.approx(1.0, rel=0.15)
    assert sum(found) / len(found) == pytest.approx(0.3, abs=0.05)


def test_nothing_is_drawn_where_the_density_is_zero_or_out_of_bounds():
    def objective(z):
        return torch.where(z[:, 0] > 0.0, 0.5 * z.square().sum(-1), torch.inf)

    z, energies = drawn(objective, torch.eye(4, dtype=torch.float64), clamp=lambda z: z.clamp(-1.5, 1.5))
    assert len(z) == 25 * WALKERS
    assert bool((z[1:, 0] >= 0.0).all())
    assert bool(torch.isfinite(energies).all())
    assert float(z.abs().max()) <= 1.5
    assert len(z[:, 1].unique()) > WALKERS
