import numpy as np
import pytest
import torch
from scipy.stats import kstest, truncnorm

from pinwm_drake.paper.baselines.dreamer.truncated_normal import TruncatedNormal

CASES = [(0.0, 1.0), (0.9, 0.1), (-1.0, 0.3), (0.3, 2.0)]


def oracle(mean, std):
    return truncnorm((-1.0 - mean) / std, (1.0 - mean) / std, mean, std)


@pytest.mark.parametrize(("mean", "std"), CASES)
def test_entropy_and_samples_are_those_of_scipy(mean, std):
    torch.manual_seed(0)
    one = TruncatedNormal(torch.full((4000, 1), mean), torch.full((4000, 1), std))
    np.testing.assert_allclose(one.entropy().numpy(), oracle(mean, std).entropy(), atol=1e-5)  # of float32
    assert kstest(one.rsample().numpy()[:, 0], oracle(mean, std).cdf).pvalue > 1e-3


def test_components_add_up():
    mean, std = torch.tensor([[0.2, -0.5]]), torch.tensor([[0.4, 1.5]])
    expected = oracle(0.2, 0.4).entropy() + oracle(-0.5, 1.5).entropy()
    assert TruncatedNormal(mean, std).entropy().item() == pytest.approx(expected, abs=1e-5)


def test_gradients_of_samples_are_finite_differences():
    def sample(mean, std):
        torch.manual_seed(3)
        return TruncatedNormal(mean, std).rsample()

    mean, std = (torch.tensor([[a, b]], dtype=torch.float64, requires_grad=True) for a, b in [(0.2, -0.6), (0.3, 0.8)])
    assert torch.autograd.gradcheck(sample, (mean, std))


def test_samples_stay_inside_where_the_mean_is_at_the_border():
    torch.manual_seed(0)
    found = TruncatedNormal(torch.ones(10_000, 1), torch.full((10_000, 1), 0.1)).rsample()
    assert found.abs().max() < 1.0
    assert torch.isfinite(found).all()


@pytest.mark.parametrize("border", [-1.0, 1.0])
@pytest.mark.parametrize("drawn", [0.0, 1.0 - 2.0**-24])
def test_the_least_and_the_largest_draw_are_inside_too(monkeypatch, border, drawn):
    monkeypatch.setattr(torch, "rand_like", lambda x: torch.full_like(x, drawn))
    mean = torch.full((1, 1), border, requires_grad=True)
    found = TruncatedNormal(mean, torch.full((1, 1), 0.1)).rsample()
    found.sum().backward()
    assert found.abs().max() < 1.0
    assert torch.isfinite(mean.grad).all()
