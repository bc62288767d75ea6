import math

import pytest
import torch

from pinwm_drake.paper.baselines.dreamer.options import NetworkOptions
from pinwm_drake.paper.baselines.dreamer.rssm import Cell, Rssm, balanced_divergence, divergence, draw

SIZES = NetworkOptions(deter=6, hidden=5, latents=3, classes=4, depth=2, units=7, layers=1)
# Two latents of two classes: p = (3/4, 1/4), (1/2, 1/2); q = (1/2, 1/2), (1/4, 3/4).
P = torch.tensor([[[0.75, 0.25], [0.5, 0.5]]]).log()
Q = torch.tensor([[[0.5, 0.5], [0.25, 0.75]]]).log()
KL = 0.75 * math.log(1.5) + 0.25 * math.log(0.5) + 0.5 * math.log(2.0) + 0.5 * math.log(2.0 / 3.0)


def test_divergence_is_the_sum_over_latents():
    assert divergence(P, Q).item() == pytest.approx(KL, abs=1e-6)
    assert divergence(P, P).item() == pytest.approx(0.0, abs=1e-7)


def test_balance_weights_the_gradients_and_not_the_value():
    posterior, prior = P.clone().requires_grad_(), Q.clone().requires_grad_()
    loss = balanced_divergence(posterior, prior, 0.8, 0.0)
    assert loss.item() == pytest.approx(KL, abs=1e-6)
    loss.backward()
    # d KL / d prior logits = q - p.
    expected = 0.8 * torch.tensor([[[-0.25, 0.25], [-0.25, 0.25]]])
    torch.testing.assert_close(prior.grad, expected)
    # d KL / d posterior logits = p (log(p / q) - KL of that latent).
    first = 0.75 * math.log(1.5) + 0.25 * math.log(0.5)
    expected = 0.2 * 0.75 * (math.log(1.5) - first)
    assert posterior.grad[0, 0].tolist() == pytest.approx([expected, -expected], abs=1e-6)


def test_less_than_the_free_nats_has_no_gradient():
    posterior, prior = P.clone().requires_grad_(), Q.clone().requires_grad_()
    loss = balanced_divergence(posterior, prior, 0.8, 1.0)
    assert loss.item() == 1.0
    loss.backward()
    assert not prior.grad.any()
    assert not posterior.grad.any()


def test_latents_are_one_hot_and_their_gradient_is_that_of_the_probabilities():
    torch.manual_seed(0)
    logits = torch.randn(5, 3, 4, requires_grad=True)
    weight = torch.randn(5, 3, 4)
    drawn = draw(logits)
    torch.testing.assert_close(drawn.sum(-1), torch.ones(5, 3))
    assert drawn.detach().max(-1).values.min() > 0.999
    (found,) = torch.autograd.grad((weight * drawn).sum(), logits)
    (expected,) = torch.autograd.grad((weight * logits.softmax(-1)).sum(), logits)
    torch.testing.assert_close(found, expected)


def test_latents_are_drawn_by_their_probabilities():
    torch.manual_seed(0)
    share = draw(torch.tensor([0.1, 0.2, 0.7]).log().expand(20_000, 3)).mean(0)
    # Three standard deviations of a share of 20,000 draws are 0.01.
    torch.testing.assert_close(share, torch.tensor([0.1, 0.2, 0.7]), atol=0.011, rtol=0.0)


def test_the_mode_is_the_likeliest_class():
    assert draw(torch.tensor([[0.1, 0.5, 0.4]]), mode=True).tolist() == [[0.0, 1.0, 0.0]]


def test_a_cell_mixes_state_and_candidate():
    torch.manual_seed(0)
    cell, inputs, state = Cell(3, 2), torch.randn(4, 3), torch.randn(4, 2)
    parts = cell.norm(torch.cat([inputs, state], 1) @ cell.gates.weight.T + cell.gates.bias)
    reset, candidate, update = parts[:, :2].sigmoid(), parts[:, 2:4], (parts[:, 4:] - 1.0).sigmoid()
    expected = update * (reset * candidate).tanh() + (1.0 - update) * state
    torch.testing.assert_close(cell(inputs, state), expected)


def test_sequences_have_the_shapes_that_are_told():
    rssm = Rssm(2, 9, SIZES)
    latent, logits = rssm.observe(torch.randn(4, 7, 2), torch.randn(4, 7, 9), torch.zeros(4, 7, dtype=torch.bool))
    assert latent.deter.shape == (4, 7, 6)
    assert latent.stoch.shape == logits.shape == rssm.prior_logits(latent.deter).shape == (4, 7, 3, 4)
    assert latent.features.shape == (4, 7, SIZES.feature_size)
    assert rssm.imagine(rssm.initial(4), torch.zeros(4, 2)).features.shape == (4, SIZES.feature_size)


def test_nothing_of_the_episode_before_is_left():
    rssm = Rssm(2, 9, SIZES)
    action, embed = torch.randn(1, 6, 2), torch.randn(1, 6, 9)
    first = torch.tensor([[True, False, False, True, False, False]])
    torch.manual_seed(0)
    _, whole = rssm.observe(action, embed, first)
    # Before the first draw the state follows from the observation alone.
    _, rest = rssm.observe(action[:, 3:], embed[:, 3:], first[:, 3:])
    torch.testing.assert_close(whole[:, 3], rest[:, 0])
    _, other = rssm.observe(action, embed, torch.zeros_like(first))
    assert not torch.allclose(whole[:, 3], other[:, 3])
