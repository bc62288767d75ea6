import numpy as np
import pytest
import torch

from pinwm_drake.paper.baselines.dreamer.options import ModelOptions
from pinwm_drake.paper.baselines.dreamer.replay import Episode, Replay
from pinwm_drake.paper.baselines.dreamer.world_model import WorldModel
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
