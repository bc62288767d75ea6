# SPDX-License-Identifier: MIT
"""World model."""

import math

import numpy as np
import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.dreamer.episodes import Replay
from pinwm_drake.paper.baselines.dreamer.options import ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.world_model import (
    Cell,
    Decoder,
    Encoder,
    Rssm,
    WorldModel,
    balanced_divergence,
    divergence,
    draw,
    layers,
)
from pinwm_drake.paper.baselines.recording import Episode
from tests.paper.baselines.dreamer.small import SIZES, numbered


@pytest.fixture
def batch():
    return Replay([numbered(9), numbered(9, terminated=True)]).draw(4, 6, np.random.default_rng(0))


def test_terms_are_what_blank_heads_give(batch):
    """Heads that say 0, whatever they see: every term follows from the data."""
    torch.manual_seed(0)
    model, options = WorldModel(8, 2, SIZES), ModelOptions(pusher_std=0.5, reward_std=2.0, free_nats=50.0)
    with torch.no_grad():
        for one in [*model.decoder.parameters(), *model.reward.parameters(), *model.goes_on.parameters()]:
            one.zero_()
    terms = model.loss(batch, options)
    dark = 1.0 - batch.image.float() / 255.0
    steps = batch.first.numel()
    assert terms.image.item() == pytest.approx((0.5 * dark.square().sum() / steps).item(), rel=1e-5)
    assert terms.pusher.item() == pytest.approx((0.5 * (batch.pusher / 0.5).square().sum() / steps).item(), rel=1e-5)
    reward = (batch.reward / 2.0)[~batch.first]
    assert terms.reward.item() == pytest.approx((0.5 * reward.square().sum() / steps).item(), rel=1e-5)
    assert terms.end.item() == pytest.approx(np.log(2.0), rel=1e-5)
    assert terms.divergence.item() == pytest.approx(50.0 * options.kl_scale)
    parts = (terms.image, terms.pusher, terms.reward, terms.end, terms.divergence)
    assert terms.total.item() == pytest.approx(sum(one.item() for one in parts))


def test_every_layer_learns(batch):
    torch.manual_seed(0)
    model = WorldModel(8, 2, SIZES)
    model.loss(batch, ModelOptions(free_nats=0.0)).total.backward()
    assert [name for name, one in model.named_parameters() if one.grad is None or not one.grad.any()] == []


def test_a_model_foresees_what_actions_do():
    """A lamp that actions switch on and off, of which 40 short episodes tell; then the first step alone is seen."""
    random, episodes = np.random.default_rng(0), []
    for _ in range(40):
        on = random.integers(2, size=6)
        images = np.full((7, 8, 8, 3), 255, np.uint8)
        images[1:][on == 1, 2:6, 2:6] = 0
        actions = np.stack([2.0 * on - 1.0, np.zeros(6)], 1).astype(np.float32)
        episodes.append(Episode(images, np.zeros((7, 2), np.float32), actions, on.astype(np.float32), np.array(False)))
    replay = Replay(episodes)
    torch.manual_seed(0)
    model = WorldModel(8, 2, SIZES)
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    for number in range(250):
        optimizer.zero_grad()
        model.loss(replay.draw(16, 7, np.random.default_rng(number)), ModelOptions()).total.backward()
        optimizer.step()
    batch = Replay(episodes[:1]).draw(1, 7, np.random.default_rng(0))
    images, rewards = model.foresee(batch, 1)
    on = batch.action[0, 1:, 0] > 0.0
    seen = images[0, :, :, 2:6, 2:6].mean((1, 2, 3))
    assert images.shape == (1, 6, 3, 8, 8)
    assert ((seen > 0.5) == on).all()
    assert np.corrcoef(rewards[0], on)[0, 1] > 0.9
    # Without draws it says the same again.
    likeliest = [model.foresee(batch, 1, mode=True)[0] for _ in range(2)]
    assert torch.equal(*likeliest)
    assert ((likeliest[0][0, :, :, 2:6, 2:6].mean((1, 2, 3)) > 0.5) == on).all()


FEW = NetworkOptions(deter=6, hidden=5, latents=3, classes=4, depth=2, units=7, layers=1)
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
    rssm = Rssm(2, 9, FEW)
    latent, logits = rssm.observe(torch.randn(4, 7, 2), torch.randn(4, 7, 9), torch.zeros(4, 7, dtype=torch.bool))
    assert latent.deter.shape == (4, 7, 6)
    assert latent.stoch.shape == logits.shape == rssm.prior_logits(latent.deter).shape == (4, 7, 3, 4)
    assert latent.features.shape == (4, 7, FEW.feature_size)
    assert rssm.imagine(rssm.initial(4), torch.zeros(4, 2)).features.shape == (4, FEW.feature_size)


def test_nothing_of_the_episode_before_is_left():
    rssm = Rssm(2, 9, FEW)
    action, embed = torch.randn(1, 6, 2), torch.randn(1, 6, 9)
    first = torch.tensor([[True, False, False, True, False, False]])
    torch.manual_seed(0)
    _, whole = rssm.observe(action, embed, first)
    # Before the first draw the state follows from the observation alone.
    _, rest = rssm.observe(action[:, 3:], embed[:, 3:], first[:, 3:])
    torch.testing.assert_close(whole[:, 3], rest[:, 0])
    _, other = rssm.observe(action, embed, torch.zeros_like(first))
    assert not torch.allclose(whole[:, 3], other[:, 3])


@pytest.mark.parametrize("size", [8, 16, 64])
def test_an_image_goes_in_and_one_of_its_size_comes_out(size):
    encoder, decoder = Encoder(size, 3, 4, 16), Decoder(20, size, 3, 4, 16)
    assert encoder(torch.zeros(5, 3, size, size), torch.zeros(5, 3)).shape == (5, encoder.size)
    image, pusher = decoder(torch.zeros(5, 20))
    assert image.shape == (5, 3, size, size)
    assert pusher.shape == (5, 3)


@pytest.mark.parametrize("size", [4, 48, 65])
def test_other_sizes_are_refused(size):
    with pytest.raises(ParameterError, match=str(size)):
        Encoder(size, 3, 4, 16)


def test_layers_have_the_widths_that_are_told():
    found = [tuple(one.weight.shape) for one in layers(3, 5, 2, 7) if isinstance(one, torch.nn.Linear)]
    assert found == [(5, 3), (5, 5), (7, 5)]
