# SPDX-License-Identifier: MIT
"""Network of diffusion policy."""

import importlib.util
import math

import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.diffusion.network import (
    DiffusionNetwork,
    ImageEncoder,
    Stretch,
    TemporalUnet,
    require_diffusers,
    spatial_softmax,
)
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions

SMALL = NetworkOptions(widths=(16, 24), channels=(8,), keypoints=4, image_features=8, step_features=16)
needs_diffusers = pytest.mark.skipif(importlib.util.find_spec("diffusers") is None, reason="no diffusers here")


def test_a_stretch_goes_from_least_to_largest_and_back():
    torch.manual_seed(0)
    values = torch.rand(50, 3) * torch.tensor([0.2, 1.0, 0.0]) + torch.tensor([0.3, -0.5, 0.7])
    stretch = Stretch(3)
    stretch.fit(values)
    found = stretch(values)
    assert found[:, :2].amin(0).tolist() == pytest.approx([-1.0, -1.0], abs=1e-5)
    assert found[:, :2].amax(0).tolist() == pytest.approx([1.0, 1.0], abs=1e-5)
    assert torch.equal(found[:, 2], torch.zeros(50))  # always the same value
    assert torch.allclose(stretch.back(found), values, atol=1e-6)
    assert set(stretch.state_dict()) == {"middle", "reach"}


class Known(torch.nn.Module):
    """The noise in actions whose clean ones are known."""

    def __init__(self, clean, steps):
        super().__init__()
        angles = (torch.arange(steps + 1) / steps + 0.008) / 1.008 * math.pi / 2
        bars = angles.cos() ** 2  # Nichol and Dhariwal, eq. 17
        betas = (1.0 - bars[1:] / bars[:-1]).clamp(max=0.999)
        self.clean, self.kept = clean, (1.0 - betas).cumprod(0)

    def forward(self, noisy, step, condition):
        kept = self.kept[step][:, None, None]
        return (noisy - kept.sqrt() * self.clean) / (1.0 - kept).sqrt()


@needs_diffusers
def test_the_noise_of_a_known_sequence_is_taken_away():
    torch.manual_seed(0)
    network = DiffusionNetwork(SMALL, 2)
    network.action.fit(torch.tensor([[-0.5, 0.0], [0.5, 0.2]]))
    clean = 2.0 * torch.rand(3, 16, 2) - 1.0
    network.unet = Known(clean, SMALL.diffusion_steps)
    dark, pusher = torch.rand(3, 6, 16, 16), torch.rand(3, 2, 2)
    found = network.sample(dark, pusher, torch.randn(3, 16, 2))
    # DDIM's last step gives the clean sequence that the network has told; float32 beside sqrt(kept) of 0.1 at first.
    assert torch.allclose(found, network.action.back(clean), atol=1e-4)
    # The schedule of the loss is that one too: a network that knows the noise has no loss.
    assert network.loss(dark, pusher, network.action.back(clean)) < 1e-6


@needs_diffusers
def test_a_loss_reaches_every_weight_and_sees_every_input():
    torch.manual_seed(0)
    network = DiffusionNetwork(SMALL, 2)
    dark, pusher, action = torch.rand(4, 6, 16, 16), torch.rand(4, 2, 2), torch.rand(4, 16, 2)
    network.loss(dark, pusher, action).backward()
    assert all(one.grad is not None for one in network.parameters())
    before = network.condition(dark, pusher)
    for k in (0, 3):  # a channel of the older image, and one of the newer
        changed = dark.clone()
        changed[:, k] = 0.0
        assert (network.condition(changed, pusher) - before).abs().amax() > 1e-3
    assert not torch.equal(network.condition(dark, pusher + 0.1), before)


def test_without_diffusers_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ParameterError, match=r'diffusers is not installed; run: .* -e "\.\[paper\]"'):
        require_diffusers()


def test_the_place_of_a_peak_is_found():
    maps = torch.full((2, 3, 5, 9), -50.0)
    maps[0, 1, 4, 2] = 50.0  # row 4 of 0 to 4, column 2 of 0 to 8
    maps[1, 2, 1, 8] = 50.0
    places = spatial_softmax(maps)
    assert places.shape == (2, 3, 2)
    assert places[0, 1].tolist() == pytest.approx([-0.5, 1.0], abs=1e-6)
    assert places[1, 2].tolist() == pytest.approx([1.0, -0.5], abs=1e-6)
    assert places[0, 0].tolist() == pytest.approx([0.0, 0.0], abs=1e-6)  # an even map: its middle


def test_a_side_of_one_pixel_has_its_place_in_the_middle():
    assert torch.equal(spatial_softmax(torch.randn(1, 2, 1, 1)), torch.zeros(1, 2, 2))


@pytest.mark.parametrize("size", [16, 32, 64])
def test_images_of_any_size_become_features(size):
    encoder = ImageEncoder(NetworkOptions(channels=(8, 16), keypoints=5, image_features=12))
    features = encoder(torch.rand(3, 3, size, size))
    assert features.shape == (3, 12)
    features.sum().backward()
    assert all(one.grad is not None for one in encoder.parameters())


@pytest.mark.parametrize(("widths", "horizon", "size"), [((16,), 5, 2), ((16, 24), 8, 3), ((16, 24, 32), 16, 2)])
def test_noise_has_the_shape_of_the_actions(widths, horizon, size):
    options = NetworkOptions(widths=widths, horizon=horizon, actions=2, step_features=16)
    unet = TemporalUnet(options, size, 7)
    noise = unet(torch.randn(4, horizon, size), torch.arange(4), torch.randn(4, 7))
    assert noise.shape == (4, horizon, size)
    noise.square().sum().backward()
    assert all(one.grad is not None and one.grad.abs().sum() > 0 for one in unet.parameters())


def test_each_sequence_is_told_by_its_own_step_and_condition():
    torch.manual_seed(0)
    unet = TemporalUnet(NetworkOptions(widths=(16, 24), step_features=16), 2, 7)
    noisy, step, condition = torch.randn(3, 16, 2), torch.tensor([5, 5, 5]), torch.randn(3, 7)
    before = unet(noisy, step, condition)
    other = condition.clone()
    other[1] += 1.0
    changed = (unet(noisy, step, other) - before).abs().amax((1, 2))
    assert changed[1] > 1e-3
    assert changed[[0, 2]].max() < 1e-5
    changed = (unet(noisy, torch.tensor([5, 5, 60]), condition) - before).abs().amax((1, 2))
    assert changed[2] > 1e-3
    assert changed[:2].max() < 1e-5


def test_a_block_scales_and_shifts_its_channels_by_the_condition():
    torch.manual_seed(0)
    block = TemporalUnet(NetworkOptions(widths=(16,), step_features=16), 2, 7).middle[0]
    x, given = torch.randn(2, 16, 16), torch.randn(2, 23)
    with torch.no_grad():
        block.film[1].weight.zero_()
        block.film[1].bias.copy_(torch.cat([torch.full((16,), 3.0), torch.full((16,), -2.0)]))
    assert torch.allclose(block(x, given), block.second(3.0 * block.first(x) - 2.0) + x, atol=1e-5)
